"""What numbers can be in a world of people on foot: finite, physical, and the same in single precision.

Single precision still tells millimetres apart at 10 km from the origin, and no farther.
"""

import math
from numbers import Integral
from typing import Annotated, Any

import jax.core
import jax.tree_util
import numpy as np
import pydantic

FARTHEST = 10_000.0  # m from the origin, in x and in y
LARGEST_FLOOR = 4_000.0  # m, of a side
LARGEST = 1e9  # of a constant of the forces or a threshold
LONGEST = 86_400.0  # s: a day
STEPS = (0.001, 1.0)  # s, least and greatest step of control or of a robot's physics
MOST_PEOPLE = 100_000
MOST_OBSTACLES = 1_500

Coordinate = Annotated[float, pydantic.Field(ge=-FARTHEST, le=FARTHEST)]  # m
Duration = Annotated[float, pydantic.Field(ge=0, le=LONGEST)]  # s
Weight = Annotated[float, pydantic.Field(ge=0, le=1e6)]  # 1, beside others of its kind
Radius = Annotated[float, pydantic.Field(ge=1e-3, le=100)]  # m
Degrees = Annotated[float, pydantic.Field(ge=-3600, le=3600)]


def check(name: str, value: Any, least: float, most: float, unit: str = "") -> Any:
    """The number ``value`` as it is, if it is one from ``least`` to ``most``.

    Raises:
        ValueError: it is not, in a sentence that begins with the name.
    """
    try:
        number = math.nan if isinstance(value, (bool, str)) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not least <= number <= most:
        raise ValueError(f"{name}: {shown(value)} must be from {least:,g} to {most:,g}{unit and ' ' + unit}.")
    return value


def check_whole(name: str, value: Any, least: int, most: int) -> int:
    """The number as ``check`` gives it, if it is a whole one. Raises ValueError."""
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise ValueError(f"{name}: {shown(value)} must be a whole number from {least:,} to {most:,}.")
    return check(name, value, least, most)


def shown(value: Any) -> str:
    """A value as messages give it: not too long."""
    said = repr(value)
    return said if len(said) <= 60 else said[:57] + "..."


def check_leaves(name: str, tree: Any) -> None:
    """Raises ValueError, which names the leaf, if a number in a tree of arrays is not finite or too large."""
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        if not isinstance(leaf, jax.core.Tracer) and not (np.abs(np.asarray(leaf)) <= LARGEST).all():
            raise ValueError(f"{name}{jax.tree_util.keystr(path)}: {leaf} must be finite, and at most {LARGEST:g}.")
