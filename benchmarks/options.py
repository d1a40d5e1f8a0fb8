"""The command line of the programs beside this file: options by their defaults."""

import argparse
from collections.abc import Callable
from typing import Any, NamedTuple


class Option(NamedTuple):
    """An option with more than a default."""

    default: Any = None
    help: str | None = None
    kind: Callable[[str], Any] | None = None  # makes a value; that of the default if None
    choices: Any = None
    metavar: str | None = None
    required: bool = False


def parse(description: str | None, **options: Any) -> argparse.Namespace:
    """The options of the command line; the description is the docstring of the program."""
    return parser(description, **options).parse_args()


def parser(description: str | None, **options: Any) -> argparse.ArgumentParser:
    """A parser that shows the description as it stands, with options as ``add_options``."""
    command = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_options(command, **options)
    return command


def add_options(command: argparse.ArgumentParser, **options: Any) -> None:
    """Add options by their defaults or as an ``Option``, such as ``people=62`` for ``--people N``.

    The default False makes a flag, and a list takes several values.
    """
    for name, default in options.items():
        option = default if isinstance(default, Option) else Option(default)
        flag = f"--{name.replace('_', '-')}"
        if isinstance(option.default, bool):
            command.add_argument(flag, action="store_true", help=option.help)
            continue

        several = isinstance(option.default, list)
        values = option.default if several else [option.default]
        usual = type(values[0]) if values and values[0] is not None else str
        settings = option._asdict() | {"type": option.kind or usual, "nargs": "+" if several else None}
        del settings["kind"]
        command.add_argument(flag, **settings)
