"""The checks of shapes check: annotations of functions under every transformation, and the fields of data types."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct
from jaxtyping import Bool, Float, Int, TypeCheckError

import sean_jax
from sean_jax import sensors
from sean_jax.core import geometry
from sean_jax.core.data_types import Array
from sean_jax.simulation.scenario import snapshot
from sean_jax.world import navigation
from support import shapes


@shapes.checked
def shift(points: Float[Array, "N 2"], by: Float[Array, "2"] | float, count: int) -> Float[Array, "N 2"]:
    return points + jnp.broadcast_to(by, points.shape)


@shapes.checked
def wrong(points: Float[Array, "N 2"]) -> Float[Array, "N"]:
    return points


def test_shapes_are_checked_under_every_transformation():
    points = jnp.ones((3, 2))
    for call in (shift, jax.jit(shift, static_argnums=2), jax.grad(lambda p, by, n: shift(p, by, n).sum())):
        assert call(points, jnp.zeros(2), 1).shape == (3, 2)
    assert jax.vmap(shift, (0, None, None))(jnp.ones((5, 3, 2)), 1.0, 1).shape == (5, 3, 2)
    assert shift(np.ones((3, 2)), 0.0, "of no shape, so unchecked").shape == (3, 2)  # type: ignore
    for call in (shift, jax.jit(shift, static_argnums=2)):
        with pytest.raises(TypeCheckError):
            call(jnp.ones((3, 3)), jnp.zeros(2), 1)
    with pytest.raises(TypeCheckError, match="return"):
        wrong(points)


def test_the_package_is_checked():
    with pytest.raises(TypeCheckError, match="points"):
        geometry.signed_distances(None, jnp.ones((4, 3)))  # type: ignore
    with pytest.raises(TypeCheckError, match="distance"):
        sensors.drop_outs(jax.random.key(0), jnp.ones(4, jnp.int32), 0.5, 1.0)


def test_fields_of_states_and_scenarios(scenario):
    """Each letter is one number in all of a state; every field of a state that is an array names its shape."""
    state = jax.jit(sean_jax.reset)(scenario, jax.random.key(0))
    assert shapes.check_fields(state) > 25
    assert shapes.check_fields(snapshot(scenario, state)) > 20
    assert shapes.check_fields(sean_jax.observe(scenario, state)) == 9
    assert shapes.check_fields(scenario.navigation) > 15
    assert shapes.check_fields(scenario.robot) > 15
    assert shapes.check_fields(scenario.environment) > 15
    assert isinstance(scenario.navigation, navigation.Navigation)
    crowd = dataclasses.replace(state.pedestrians, present=state.pedestrians.present[:-1])
    with pytest.raises(AssertionError, match="pedestrians.present is bool"):
        shapes.check_fields(dataclasses.replace(state, pedestrians=crowd))


def test_making_a_data_type_checks_nothing():
    """JAX makes them of axes, None and strings as well."""

    @struct.dataclass
    class Pair:
        left: Float[Array, "N"]
        right: Int[Array, "N"]
        both: Bool[Array, ""] | None = None

    pair = Pair(jnp.ones(3), jnp.ones(3, jnp.int32))
    assert shapes.check_fields(pair) == 3
    axes = jax.tree.map(lambda _: 0, pair)
    assert jax.vmap(lambda each: each.left + 1.0, (axes,))(pair).shape == (3,)
    with pytest.raises(AssertionError, match="Pair.right is int32"):
        shapes.check_fields(dataclasses.replace(pair, right=jnp.ones(4, jnp.int32)))
