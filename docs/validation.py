"""Writes the table of checks of docs/validation.md from the checks of `sean validate`: python docs/validation.py.

The table stands between the lines `<!-- checks -->` and `<!-- end -->`.
"""

import re
from pathlib import Path

from sean_jax.studies.validation.checks import CHECKS

PAGE = Path(__file__).parent / "validation.md"
STANDARD = r"(RiMEA|IMO|NIST|ISO) .*, test [\d.]+"
HEAD = "| check | geometry and people | measured, and when it passes | data | source |\n|---|---|---|---|---|\n"


def table() -> str:
    """A row for each check; checks that differ in their name and source alone share a row."""
    same: dict[tuple[str, ...], list[str]] = {}
    for name, check in CHECKS.items():
        same.setdefault((check.setup, check.measure, check.criterion, check.data), []).append(name)
    return HEAD + "".join(row(names) for names in same.values())


def row(names: list[str]) -> str:
    """The row of one check, or of checks that are equal; a test of a standard has its source in its name."""
    check = CHECKS[names[0]]
    called = ", ".join(f"`{name}`" for name in names)
    source = "" if re.fullmatch(STANDARD, check.source) else check.source
    return f"| {called} | {check.setup} | {check.measure}: {check.criterion} | {check.data} | {source} |\n"


def fill(text: str) -> str:
    """The page with the table of today."""
    return re.sub(
        r"(<!-- checks -->\n).*?(<!-- end -->)", lambda match: match[1] + table() + match[2], text, flags=re.S
    )


if __name__ == "__main__":
    PAGE.write_text(fill(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
