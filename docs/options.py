"""Writes the tables of docs/options.md from the classes that validate options: python docs/options.py.

They stand between the lines `<!-- options -->` and `<!-- end -->`.
"""

import typing
from pathlib import Path
from typing import Any

from sean_jax.config import COMMANDS

PAGE = Path(__file__).parent / "options.md"


def tables() -> str:
    """Options of all commands."""
    sections = []
    for word, model in COMMANDS.items():
        rows = []
        for name, field in model.model_fields.items():
            text = " ".join((field.description or "").split())
            if not text:
                continue
            default = "" if field.is_required() else _default(field.get_default(call_default_factory=True))
            rows.append(f"| `{name}` | {default} | {_cell(text)} |")
        about = " ".join((model.__doc__ or "").split())
        sections.append(f"## sean {word}\n\n{_cell(about)}")
        if rows:
            sections.append("\n".join(["| option | default | meaning |", "|---|---|---|", *rows]))
    return "\n\n".join(sections)


def _default(value: Any) -> str:
    if value is None or value == () or value == "":
        return ""
    if isinstance(value, tuple):
        return " ".join(_default(each) for each in value)
    kind = getattr(value, "kind", None)
    return f"`{kind if kind is not None else value}`" if not isinstance(value, typing.Mapping) else ""


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("<", "&lt;")


def fill(text: str) -> str:
    """The page with the options of today."""
    begin, end = text.index("<!-- options -->\n"), text.index("<!-- end -->")
    return f"{text[:begin]}<!-- options -->\n\n{tables()}\n\n{text[end:]}"


if __name__ == "__main__":
    PAGE.write_text(fill(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
