"""Which values of a parameter the quick tests try; the slow ones try them all."""

from collections.abc import Iterable
from typing import Any

import pytest


def quick(values: Iterable[Any], *chosen: Any) -> list[Any]:
    """All values for ``pytest.mark.parametrize``, those that are not ``chosen`` marked slow."""
    return [value if value in chosen else _slow(value) for value in values]


def _slow(value: Any) -> Any:
    several = value if isinstance(value, tuple) else (value,)
    return pytest.param(*several, marks=pytest.mark.slow)
