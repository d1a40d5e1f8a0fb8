"""Writes the table of checks of docs/validation.md from the checks of `sean validate`: python docs/validation.py.

The table stands between the lines `<!-- checks -->` and `<!-- end -->`.
"""

import re
from pathlib import Path

from sean_jax.studies.validation.checks import CHECKS

PAGE = Path(__file__).parent / "validation.md"
HEAD = "| check | geometry and people | measured, and when it passes | data | source |\n|---|---|---|---|---|\n"


def table() -> str:
    """A row for each check."""
    rows = (
        f"| `{name}` | {check.setup} | {check.measure}: {check.criterion} | {check.data} | {check.source} |\n"
        for name, check in CHECKS.items()
    )
    return HEAD + "".join(rows)


def fill(text: str) -> str:
    """The page with the table of today."""
    return re.sub(
        r"(<!-- checks -->\n).*?(<!-- end -->)", lambda match: match[1] + table() + match[2], text, flags=re.S
    )


if __name__ == "__main__":
    PAGE.write_text(fill(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
