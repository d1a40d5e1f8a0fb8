"""The documentation site: every page is in its menu, every option on its page, and the tutorial runs as it stands."""

import inspect
import os
import pkgutil
import re
import sys
from pathlib import Path

import pytest
import yaml

import sean_jax
from sean_jax.config import COMMANDS
from support.checkout import ROOT, module_of, repository_files
from support.commands import output

pytestmark = pytest.mark.form
DOCS = ROOT / "docs"
SMALLER = {
    "--episodes 32": "--episodes 2",
    "--episodes 16": "--episodes 2",
    "--episodes 64": "--episodes 2",
    "--episodes 3 17": "--episodes 1",
}


def pages(menu) -> list[str]:
    if isinstance(menu, str):
        return [menu]
    return [page for part in (menu.values() if isinstance(menu, dict) else menu) for page in pages(part)]


def test_the_menu_has_every_page():
    menu = yaml.safe_load((ROOT / "mkdocs.yml").read_text())["nav"]
    assert sorted(pages(menu)) == sorted(path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md"))


def links(page: Path, text: str) -> list[Path]:
    """The files that a page leads to or shows. HTML is not changed by mkdocs, whose page.md is served as page/."""
    markdown = re.findall(r"\]\(\s*<?([^)>#\s]+)", text) + re.findall(r"^\[[^\]]+\]:\s*<?([^>#\s]+)", text, re.M)
    html = re.findall(r"<[^>]*\b(?:src|href|poster|data)\s*=\s*[\"']?([^\"'#\s>]+)", text)
    served = page.parent if page.stem in ("index", "README") else page.with_suffix("")
    found = [(page.parent, link) for link in markdown] + [(served, link) for link in html]
    outside = re.compile(r"\w+://|mailto:|data:")
    return [Path(os.path.normpath(folder / link)) for folder, link in found if not outside.match(link)]


def test_links_and_pictures_are_there():
    for path in [*ROOT.glob("*.md"), *DOCS.rglob("*.md")]:
        text = re.sub(r"^```.*?^```|`[^`\n]*`", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
        for file in links(path, text):
            assert file.exists(), f"{path.name}: {file}"
    text = "[a](b.md#c) ![d](<e.png>) <img width=5 src='no.png'> <a href=\"../f.md\"> [x](https://y)\n[g]: h.md"
    found = [file.relative_to(DOCS).as_posix() for file in links(DOCS / "some/page.md", text)]
    assert found == ["some/b.md", "some/e.png", "some/h.md", "some/page/no.png", "some/f.md"]


def test_files_with_results_are_in_the_repository():
    """Ignored files are on the machine of a measurement alone."""
    names = {name for path in DOCS.rglob("*.md") for name in re.findall(r"benchmarks/[\w/]+\.\w+", path.read_text())}
    assert {"benchmarks/results/ppo_lidar.json", "benchmarks/worlds.py"} <= names
    files = {path.relative_to(ROOT).as_posix() for path in repository_files()}
    assert names <= files


def anchors(page: Path) -> set[str]:
    """Where links into a page may lead: its headings, as mkdocs names them."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    plain = [re.sub(r"[^\w\s-]", "", line).strip().lower() for line in re.findall(r"^#+ (.+)$", text, re.MULTILINE)]
    return {re.sub(r"[-\s]+", "-", words) for words in plain}


@pytest.mark.parametrize("page", sorted([*ROOT.glob("*.md"), *DOCS.rglob("*.md")]), ids=lambda path: path.name)
def test_links_lead_to_headings(page):
    for target, anchor in re.findall(r"\]\(([^)#\s]*)#([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if target.endswith(".md") and "://" not in target or not target:
            where = page.parent / target if target else page
            assert anchor in anchors(where), f"{page.name}: {target}#{anchor}"


def test_lists_and_tables_begin_after_an_empty_line():
    """Python-Markdown makes one paragraph of them otherwise, unlike GitHub."""
    for path in DOCS.rglob("*.md"):
        text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
        joined = re.search(r"^(?!- |#|\||<|\d+\. |\s|$).*\n(?:- |1\. |\|)", text, re.MULTILINE)
        assert not joined, f"{path.name}: {joined[0]}"


def test_the_reference_has_every_public_name_once():
    pages = [path.read_text(encoding="utf-8") for path in (DOCS / "reference").glob("*.md")]
    names = [name for text in pages for name in re.findall(r"^::: (\S+)$", text, re.M)]
    assert len(names) == len(set(names))
    assert not {f"sean_jax.{name}" for name in sean_jax.__all__} - set(names)
    for name in names:
        assert inspect.getdoc(pkgutil.resolve_name(name)), name


def test_the_gallery_shows_every_picture():
    shown = set(re.findall(r"\(pictures/([^)]+\.png)\)", (DOCS / "gallery.md").read_text()))
    assert shown == {path.name for path in (DOCS / "pictures").glob("*.png")}


def test_every_option_is_on_its_page():
    text = (DOCS / "options.md").read_text(encoding="utf-8")
    sections = {section.split("\n")[0]: section for section in text.split("\n## ")}
    for word, model in COMMANDS.items():
        section = sections[f"sean {word}"]
        for shared in ("The scenario", "Observations and rewards"):
            if f"[{shared.lower()}]" in section.lower():
                section += sections[shared]
        for name, field in model.model_fields.items():
            assert not field.description or f"| `{name}` |" in section, (word, name)
    assert module_of(DOCS / "options.py").fill(text) == text, "run: python docs/options.py"


def test_files_beside_the_pages_are_named_and_not_linked():
    hooks = module_of(DOCS / "hooks.py")
    assert hooks.name_outside("see [it](../a/b.md)", "page.md") == "see it (`a/b.md`)"
    assert hooks.name_outside("see [it](../../a/b.md)", "results/page.md") == "see it (`a/b.md`)"
    for inside in ("see [it](../a.md#b)", "![it](../pictures/a.png)", "see [it](a.md)"):
        assert hooks.name_outside(inside, "results/page.md") == inside


@pytest.mark.night
def test_the_tutorial_runs(tmp_path):
    """All commands but those that install, with fewer episodes, and but the training, which tests of its own run."""
    text = (DOCS / "tutorial.md").read_text(encoding="utf-8").split("## 5.")[0]
    script = "\n".join(re.findall(r"```bash\n(.*?)```", text, re.S))
    for long, short in SMALLER.items():
        script = script.replace(long, short)
    script = re.sub(r"^pip .*$", "", script, flags=re.M)
    head = f'set -eu\nsean() {{ {sys.executable} -m sean_jax "$@"; }}\n'
    environment = {"PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"}
    output("bash", "-c", head + script, cwd=tmp_path, env=environment, timeout=1500)
    for name in (
        "runs/go/report.html",
        "runs/shy/replay.html",
        "compare-go-orca.html",
        "compare-go-shy.html",
        "yard.png",
    ):
        assert (tmp_path / name).is_file(), name
    assert list((tmp_path / "runs").glob("*/summary.json"))
