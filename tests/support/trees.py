"""Comparisons of pytrees, leaf by leaf: what differs is named by its path."""

import jax
import numpy as np


def assert_equal(one, other) -> None:
    """Both have the same numbers."""
    for path, first, second in _pairs(one, other):
        np.testing.assert_array_equal(first, second, err_msg=path)


def assert_close(one, other, **tolerances) -> None:
    """Numbers of the first are those of the second within ``rtol`` and ``atol``, as of ``assert_allclose``."""
    for path, first, second in _pairs(one, other):
        np.testing.assert_allclose(first, second, err_msg=path, **tolerances)


def _pairs(one, other):
    leaves, others = jax.tree.leaves_with_path(one), jax.tree.leaves(other)
    for (path, first), second in zip(leaves, others, strict=True):
        yield jax.tree_util.keystr(path), first, second
