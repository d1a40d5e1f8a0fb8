"""Which values of a parameter the quick tests try, and which the slow ones; the night tries them all."""

from collections.abc import Iterable
from typing import Any

import pytest


def quick(values: Iterable[Any], *chosen: Any) -> list[Any]:
    """All values for ``pytest.mark.parametrize``, those that are not ``chosen`` marked slow."""
    return [value if value in chosen else _marked(value, pytest.mark.slow) for value in values]


def slow(values: Iterable[Any], *chosen: Any) -> list[Any]:
    """All values for ``pytest.mark.parametrize``: the ``chosen`` are marked slow, the others night."""
    return [_marked(value, pytest.mark.slow if value in chosen else pytest.mark.night) for value in values]


def _marked(value: Any, mark: Any) -> Any:
    several = value if isinstance(value, tuple) else (value,)
    return pytest.param(*several, marks=mark)
