"""Writes the tables of docs/options.md from the classes that validate options: python docs/options.py.

They stand between the lines `<!-- options -->` and `<!-- end -->`.
"""

from pathlib import Path
from typing import Any

from pydantic_core import PydanticUndefined

from sean_jax.config import COMMANDS, Component, Config, EnvConfig, ScenarioConfig, family_of, flags

PAGE = Path(__file__).parent / "options.md"


SHARED = {"The scenario": ScenarioConfig, "Observations and rewards": EnvConfig}
"""Heading -> class of options that several commands embed."""


def tables() -> str:
    """Options that commands have in common, then the options of each command."""
    sections = []
    for heading, model in SHARED.items():
        topic = flags.topics(model)[-1]
        about = f"Options of {topic.subject}. `--help-{topic.word}` of a command prints them."
        sections += [f"## {heading}", about, _table(model, topic.word)]
    for word, model in COMMANDS.items():
        sections += [f"## sean {word}", _cell(model.__doc__)]
        for heading, shared in SHARED.items():
            if issubclass(model, shared):
                sections.append(f"It also has the options of [{heading}](#{heading.lower().replace(' ', '-')}).")
        sections.append(_table(model))
    return "\n\n".join(filter(None, sections))


def _table(model: type[Config], topic: str = "") -> str:
    """The options of a class that belong to a topic; nothing if there is none."""
    rows = []
    for name, field in model.model_fields.items():
        if flags.topic_of(model, name) != topic or not field.description:
            continue
        rows.append(_row(name, field.get_default(call_default_factory=True), field.description))

        # Options of components stand below the field of their component.
        family = family_of(field)
        for option, variants in family.options().items() if family is not None else ():
            about = flags.option_text(name, option, variants)
            rows.append(_row(option, variants[0].model_fields[option].default, about))
    return "\n".join(["| option | default | meaning |", "|---|---|---|", *rows]) if rows else ""


def _row(name: str, default: Any, about: str) -> str:
    return f"| `{name}` | {_default(default)} | {_cell(about)} |"


def _default(value: Any) -> str:
    if value in (None, (), "", PydanticUndefined):
        return ""
    if isinstance(value, tuple):
        return " ".join(map(_default, value))
    return f"`{value.kind if isinstance(value, Component) else value}`"


def _cell(text: str | None) -> str:
    return flags.joined(text).replace("|", "\\|").replace("<", "&lt;")


def fill(text: str) -> str:
    """The page with the options of today."""
    begin, end = text.index("<!-- options -->\n"), text.index("<!-- end -->")
    return f"{text[:begin]}<!-- options -->\n\n{tables()}\n\n{text[end:]}"


if __name__ == "__main__":
    PAGE.write_text(fill(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
