"""Bounds of physical quantities in a world of people on foot, and checks of numbers against them.

All numbers are finite and the same in single precision, which resolves a millimetre up to 10 km from the origin.
"""

import math
from numbers import Integral
from typing import Annotated, Any

import pydantic

from sean_jax.core.errors import InputError
from sean_jax.core.messages import shorten

MAX_COORDINATE = 10_000.0  # m from the origin, in x and in y
MAX_FLOOR_SIDE = 4_000.0  # m
MAX_MAGNITUDE = 1e9  # of a constant of the forces or a threshold
MAX_DURATION = 86_400.0  # s: a day
TIME_STEP_RANGE = (0.001, 1.0)  # s, of control or of a robot's physics
MAX_PEOPLE = 100_000
MAX_OBSTACLES = 1_500

Coordinate = Annotated[float, pydantic.Field(ge=-MAX_COORDINATE, le=MAX_COORDINATE)]  # m
Duration = Annotated[float, pydantic.Field(ge=0, le=MAX_DURATION)]  # s
RelativeChance = Annotated[float, pydantic.Field(ge=0, le=1e6)]  # relative to others of its kind
Radius = Annotated[float, pydantic.Field(ge=1e-3, le=100)]  # m
Degrees = Annotated[float, pydantic.Field(ge=-3600, le=3600)]


def parse_digits(text: str) -> int | None:
    """The number of a text of at most 18 decimal digits; None for any other text. (``int`` refuses 4,301 digits.)"""
    if text.isdecimal() and len(text) <= 18:
        return int(text)
    return None


def check_number(name: str, value: Any, minimum: float, maximum: float, unit: str = "") -> Any:
    """The value, if it is a number in a range.

    Raises:
        InputError: it is no number, or out of range.
    """
    try:
        number = math.nan if isinstance(value, (bool, str)) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not minimum <= number <= maximum:
        limits = f"{minimum:,g} to {maximum:,g}{unit and ' ' + unit}"
        raise InputError(f"{name}: {shorten(repr(value))} must be from {limits}.")
    return value


def check_integer(name: str, value: Any, minimum: int, maximum: int) -> int:
    """The value, if it is a whole number in a range.

    Raises:
        InputError: it is no whole number, or out of range.
    """
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise InputError(f"{name}: {shorten(repr(value))} must be a whole number from {minimum:,} to {maximum:,}.")
    return check_number(name, value, minimum, maximum)


def check_leaves(name: str, tree: Any) -> None:
    """Check that all numbers of a pytree are finite and not too large; tracers are not checked.

    Raises:
        InputError: a number is not, in a sentence that names the leaf.
    """
    import jax.core
    import jax.tree_util
    import numpy as np

    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        if not isinstance(leaf, jax.core.Tracer) and not (np.abs(np.asarray(leaf)) <= MAX_MAGNITUDE).all():
            where = f"{name}{jax.tree_util.keystr(path)}"
            raise InputError(f"{where}: {leaf} must be finite, and at most {MAX_MAGNITUDE:g}.")
