"""What tests share to run programs: one that may be traced once fails as soon as it is traced again."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support import programs


def test_a_second_trace_fails_and_says_for_what():
    double = programs.jit_once(lambda x: 2 * x)
    for value in (jnp.ones(3), jnp.zeros(3)):
        np.testing.assert_array_equal(double(value), 2 * value)
    np.testing.assert_array_equal(jax.vmap(double)(jnp.ones((2, 3))), 2.0)
    with pytest.raises(AssertionError, match=r"traced again, for .*float32\[4\].* after .*float32\[3\]"):
        double(jnp.ones(4))
