"""Writes the table of checks of docs/validation.md from the checks of `sean validate`: python docs/validation.py.

The table stands between the lines `<!-- checks -->` and `<!-- end -->`.
"""

import re
from pathlib import Path

from sean_jax.studies.validation.checks import CHECKS

PAGE = Path(__file__).parent / "validation.md"
STANDARD = r"(RiMEA|IMO|NIST|ISO) .*, test [\d.]+"
HEAD = "| check | what | measured, and when it passes | data | source |\n|---|---|---|---|---|\n"


def table() -> str:
    """A row for each check; checks with the same measurement, criterion and data share a row."""
    same: dict[tuple[str, ...], list[str]] = {}
    for name, check in CHECKS.items():
        title = check.title if re.fullmatch(STANDARD, check.source) else ""
        same.setdefault((title, check.measure, check.criterion, check.data), []).append(name)
    return HEAD + "".join(row(names) for names in same.values())


def row(names: list[str]) -> str:
    """The row of one check, or of several; a test of a standard has its source in its name."""
    check = CHECKS[names[0]]
    called = ", ".join(f"`{name}`" for name in names)
    titles = list(dict.fromkeys(CHECKS[name].title for name in names))
    what = titles[0] if len(titles) == 1 else "; ".join(dict.fromkeys(title.split(",")[0] for title in titles))
    source = "" if re.fullmatch(STANDARD, check.source) or "that of" in check.measure else check.source
    return f"| {called} | {what} | {check.measure}: {check.criterion} | {check.data} | {source} |\n"


def fill(text: str) -> str:
    """The page with the table of today."""
    return re.sub(
        r"(<!-- checks -->\n).*?(<!-- end -->)", lambda match: match[1] + table() + match[2], text, flags=re.S
    )


if __name__ == "__main__":
    PAGE.write_text(fill(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
