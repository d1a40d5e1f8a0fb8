"""What the options of all commands share: the command that repeats them, limits of numbers, and places to write.

Nothing here imports JAX, so that ``sean --help`` answers at once, and a mistake is told before anything is compiled.
"""

import dataclasses
import os
import shlex
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from sean_jax import writing

LIMITS = {
    "people": (0, 100_000),
    "parties": (0.0, 1.0),
    "spreading": (0.0, 1e6),  # m2
    "frame_rate": (0.001, 1e4),  # 1/s
    "start": (-1e6, 1e6),  # m, m, degrees
    "goal": (-1e6, 1e6),
    "batch": (1, 2**24),
    "episodes": (1, 2**31 - 1),
    "time_limit": (1.0, 1e5),  # s
    "seed": (0, 2**32 - 1),
}
"""least and greatest value of what several commands ask for"""


class BadInput(ValueError):
    """What the user asked for cannot be done; the message is one sentence that says what to do instead."""


def command(word: str, options: Any, positional: Collection[str] = (), leave_out: Collection[str] = ()) -> str:
    """The command that gives these options again, to the bit: of a number the shortest text that is read as the same.

    Args:
        word: the command, such as ``run``.
        options: an instance of its dataclass; what is None, or a switch that is off, is not named.
        positional: fields that stand right after the word, in this order.
        leave_out: fields that decide nothing of the results.
    """
    words = ["sean", word, *(str(getattr(options, name)) for name in positional)]
    for field in dataclasses.fields(options):
        value = getattr(options, field.name)
        if field.name in (*positional, *leave_out) or value is None or value is False:
            continue
        values = [] if value is True else [written(each) for each in (value if isinstance(value, tuple) else (value,))]
        if isinstance(value, str | Path) and values[0].startswith("-"):  # else it would be read as an option
            words.append(f"{flag(field.name)}={values[0]}")
        else:
            words += [flag(field.name), *values]
    return shlex.join(words)


def flag(name: str) -> str:
    """The option of a field: ``time_limit`` is ``--time-limit``."""
    return "--" + name.replace("_", "-")


def written(value: Any) -> str:
    """A value as the command line takes it: 120.0 is 120, and a float is read back as the same float."""
    return repr(float(value)).removesuffix(".0") if isinstance(value, float) else str(value)


def check_limits(options: Any, own: Mapping[str, tuple[float, float]]) -> None:
    """Refuse a number that is not finite or beyond its limits, alone or in a tuple.

    The limits are ``LIMITS`` and a command's ``own``, name -> (least, greatest); None is in order. Raises BadInput,
    which names the option, the value and the limits.
    """
    limits = {**LIMITS, **own}
    for field in dataclasses.fields(options):
        value = getattr(options, field.name)
        if field.name not in limits or value is None:
            continue
        least, most = limits[field.name]
        for each in value if isinstance(value, tuple) else (value,):
            if not least <= each <= most:
                usual = field.default
                hint = f" ({written(usual)} is the default)" if isinstance(usual, int | float) else ""
                within = f"must lie between {written(least)} and {written(most)}"
                raise BadInput(f"{flag(field.name)} is {written(each)}, but {within}{hint}.")


def check_new_folder(folder: Path, option: str = "--out") -> None:
    """Refuse a folder that cannot be made: one that holds something, or is no folder.

    Raises BadInput, which names the option, the folder and the cure.
    """
    if folder.exists() and not folder.is_dir():
        raise BadInput(f"{option}: {folder} is a file or a device; give the name of a new folder.")
    if writing.contents(folder):
        raise BadInput(f"{option}: the folder {folder} is not empty; give the name of a new folder.")
    if folder.exists() and os.path.samefile(folder, "."):
        raise BadInput(f"{option}: {folder} is the folder that you are in; give the name of a new folder.")


def check_file(path: Path, suffixes: Collection[str], option: str = "--out") -> None:
    """Refuse a file that cannot be written, or whose name ends in no known way; one that is there is written anew.

    Raises BadInput, which names the option, the file and the cure.
    """
    if path.is_dir():
        raise BadInput(f"{option}: {path} is a folder; give the name of a file, such as {path / 'picture.png'}.")
    if path.exists() and not path.is_file():
        raise BadInput(f"{option}: {path} is a device or a pipe; give the name of a file, such as picture.png.")
    if path.suffix.lower() not in suffixes:
        ending = f"ends in {path.suffix}" if path.suffix else "has no ending"
        raise BadInput(f"{option}: {path} {ending}, but must end in one of {', '.join(suffixes)}.")
    if not path.parent.is_dir():
        raise BadInput(f"{option}: there is no folder {path.parent} to write {path.name} to; make it first.")
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise BadInput(f"{option}: {path} cannot be written: permission denied; choose another place.")
