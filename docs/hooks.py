"""What mkdocs does not do by itself: links to files beside the pages, and the page of options from their schema."""

import re
import typing
from typing import Any

UPWARDS = re.compile(r"\[([^\]]+)\]\(((?:\.\./)+)([^)\s]+)\)")
OPTIONS = "<!-- options -->"


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Change a page before it is turned into HTML.

    Args:
        markdown: of the page.
        page: of mkdocs.

    Returns:
        Markdown.
    """
    if page.file.src_uri == "options.md":
        markdown = markdown.replace(OPTIONS, options())
    return name_outside(markdown, page.file.src_uri)


def name_outside(markdown: str, place: str) -> str:
    """Name files outside of the pages instead of linking them: the site stands without the repository.

    Args:
        markdown: of a page.
        place: of the page in docs/.

    Returns:
        Markdown.
    """

    def name(link: re.Match) -> str:
        return f"{link[1]} (`{link[3]}`)" if link[2].count("/") > place.count("/") else link[0]

    return UPWARDS.sub(name, markdown)


def options() -> str:
    """Tables of the options of all commands.

    Returns:
        Markdown.
    """
    from sean_jax.config import COMMANDS

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
        table = "\n".join(["| option | default | meaning |", "|---|---|---|", *rows]) if rows else ""
        sections.append(f"## sean {word}\n\n{_cell(about)}\n\n{table}")
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
