// The theme of the page around this one, where this one is a frame: a site, a notebook. Without one, that of the system.

type Theme = "light" | "dark";

/** The theme that a page's elements declare; null if they declare none. */
function declared(root: HTMLElement, body: HTMLElement | null): Theme | null {
  const site = body?.dataset.mdColorScheme; // mkdocs-material
  if (site) return site === "slate" ? "dark" : "light";
  const lab = body?.dataset.jpThemeLight; // JupyterLab
  if (lab) return lab === "false" ? "dark" : "light";
  if (body?.matches(".vscode-dark, .vscode-high-contrast:not(.vscode-high-contrast-light)")) return "dark"; // VS Code
  if (body?.matches(".vscode-light, .vscode-high-contrast-light")) return "light";
  const colab = root.getAttribute("theme");
  return colab === "dark" || colab === "light" ? colab : null;
}

/** The documents around this one, the nearest first; those of another origin cannot be read. */
function documents(): Document[] {
  const all = [document];
  try {
    for (let page: Window = window; page.parent !== page; page = page.parent) all.push(page.parent.document);
  } catch {
    // another origin
  }
  return all;
}

/** Follow the theme; `changed` is called after each change. */
export function followTheme(changed: () => void): void {
  const pages = documents();
  const apply = (): void => {
    const themes = pages.map((page) => declared(page.documentElement, page.body));
    document.documentElement.style.colorScheme = themes.find((theme) => theme) ?? "";
    changed();
  };
  const observer = new MutationObserver(apply);
  const attributeFilter = ["class", "theme", "data-md-color-scheme", "data-jp-theme-light"];
  for (const page of pages) {
    for (const element of [page.documentElement, page.body]) if (element) observer.observe(element, { attributeFilter });
  }
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", changed);
  apply();
}
