"""HTML pages of one file each, which need no network: a base template, one stylesheet, tables, figures and sections.

Templates lie beside the module that fills them, and are named by their path in the package. All texts are escaped.
"""

import functools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from jinja2 import Environment

PACKAGE = Path(__file__).parents[2]


class Cell(NamedTuple):
    """A cell of a table."""

    text: str
    small: str = ""  # in small print, below the text
    kind: str = ""  # class of the stylesheet: ours, none, text, passes, fails, skipped or partly


@functools.cache
def _environment() -> "Environment":
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    return Environment(
        loader=FileSystemLoader(PACKAGE),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def render(template: str, **values: Any) -> str:
    """A page of a template, such as ``evaluation/run.html``."""
    return _environment().get_template(template).render(**values)


def macro(template: str, name: str, *values: Any, **options: Any) -> str:
    """The HTML of a template's macro, which other templates do not escape again."""
    return getattr(_environment().get_template(template).module, name)(*values, **options)


def page(title: str, kicker: str, sections: Iterable[str]) -> str:
    """A page of sections.

    Args:
        kicker: the small line above the title.
        sections: of ``section``.
    """
    return render("web/pages/sections.html", title=title, kicker=kicker, sections=sections)


def section(title: str, *parts: str) -> str:
    """A titled box; parts that no function of this module has made are escaped."""
    return macro("web/pages/parts.html", "section", title, parts)


def table(head: Sequence[str], rows: Iterable[Sequence[str | Cell]], kind: str = "") -> str:
    """A table; the first cell of each row is its name.

    Args:
        kind: class of the stylesheet: ``words`` for sentences, ``units`` for names with units in small print.
    """
    return macro("web/pages/parts.html", "table", head, list(rows), kind)


def figure(picture: str, caption: str = "", narrow: bool = False) -> str:
    """A picture, as HTML, with a caption."""
    return macro("web/pages/parts.html", "figure", picture, caption, narrow)


def grid(figures: Sequence[str]) -> str:
    """Figures side by side."""
    return macro("web/pages/parts.html", "grid", figures)


def legend(colors: Mapping[str, str]) -> str:
    """The color of each name."""
    return macro("web/pages/parts.html", "legend", colors)


def note(text: str) -> str:
    """A paragraph in small print."""
    return macro("web/pages/parts.html", "note", text)


def heading(text: str) -> str:
    """A heading inside a section."""
    return macro("web/pages/parts.html", "heading", text)


def facts(rows: Mapping[str, Any]) -> str:
    """A list of names and values."""
    return macro("web/pages/parts.html", "facts", rows)


def origin(command: str, versions: Mapping[str, Any]) -> str:
    """The section with the command and the versions that reproduce a page."""
    return macro("web/pages/parts.html", "origin", command, versions)
