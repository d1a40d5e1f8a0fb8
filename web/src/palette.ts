// The colors of the page, light or dark, from the variables of its style.

const NAMES = [
  "paper", "floor", "ink", "muted", "line", "trail", "faint", "obstacle",
  "robot", "robot-edge", "person", "member", "yielding", "none",
] as const;

type Names = (typeof NAMES)[number];

export type Palette = Record<Names, string>;

export function palette(element: Element): Palette {
  const probe = document.createElement("i"); // a color of a variable is one of two until an element has it
  probe.hidden = true;
  element.append(probe);
  const style = getComputedStyle(probe);
  const color = (name: Names): [Names, string] => {
    probe.style.color = `var(--${name})`;
    return [name, style.color];
  };
  const colors = Object.fromEntries(NAMES.map(color)) as Palette;
  probe.remove();
  return colors;
}
