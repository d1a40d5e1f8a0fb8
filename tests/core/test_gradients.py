"""Rollouts and long horizons of derivatives: blocks that are computed again, truncation, damping, clipping.

The step is a small nonlinear map of a real state, so that derivatives over any number of steps are known by hand.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import gradients
from sean_jax.simulation import episodes
from support import programs, trees

STEPS = 11
POLICY = lambda scenario, state, key: jnp.asarray([0.1, 0.0], float)  # noqa: E731


@pytest.fixture(scope="module")
def scenario(whole_scenario):
    """People walk along whole paths."""
    return whole_scenario


def toy(scenario, state, action):
    """Positions are multiplied by a constant that stands in the forces, and bent a little; the robot moves along."""
    people, robot, growth = state.pedestrians, state.robot, scenario.forces.walking.speed_ratio
    position = growth * people.position + 0.1 * jnp.sin(people.velocity)
    velocity = jnp.cos(position) * people.preferred_speed[:, None]
    return replace(
        state,
        pedestrians=replace(people, position=position, velocity=velocity),
        robot=replace(robot, position=growth * robot.position + 0.01 * action[0]),
        tick=state.tick + 1,
    )


@pytest.fixture(scope="module")
def start(scenario):
    return programs.reset(scenario, jax.random.key(0))


@pytest.fixture(scope="module")
def run(scenario, start):
    """(growth, shift of positions, of preferred speeds) -> last people's and robot's positions, and the record."""

    def run(growth, shift, speed, steps=STEPS, **options):
        forces = scenario.forces.tree_replace({"walking.speed_ratio": growth})
        people = start.pedestrians
        people = replace(people, position=people.position + shift, preferred_speed=people.preferred_speed + speed)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(episodes, "step", toy)
            state, record = sean_jax.simulate(
                scenario.replace(forces=forces), POLICY, replace(start, pedestrians=people), steps, **options
            )
        return state.pedestrians.position, state.robot.position, record

    return run


AT = jnp.float32(1.05), jnp.float32(0.2), jnp.float32(0.1)


def slopes(run, **options):
    """Gradients of the sum of all last positions, in reverse and in forward mode; and what is run."""

    def total(*at):
        values = run(*at, **options)
        return sum(part.sum() for part in values[:2]), values

    @jax.jit
    def compute(*at):
        reverse, values = jax.grad(total, (0, 1, 2), has_aux=True)(*at)
        return jnp.stack(reverse), jnp.stack(jax.jacfwd(total, (0, 1, 2), has_aux=True)(*at)[0]), values

    return compute(*AT)


@pytest.fixture(scope="module")
def plain(run):
    """Without options."""
    return slopes(run)


@pytest.mark.parametrize("every", [1, 4, STEPS, 20])
def test_blocks_change_no_value_no_record_and_no_gradient(run, plain, every):
    blocks = slopes(run, checkpoint_every=every)
    trees.assert_close(blocks[2], plain[2], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(blocks[:2], plain[:2], rtol=1e-4)


def test_blocks_keep_less(run):
    def kept(**options):
        total = lambda *at: run(*at, steps=400, record=lambda *_: (), **options)[0].sum()  # noqa: E731
        return jax.jit(jax.grad(total)).lower(*AT).compile().memory_analysis().temp_size_in_bytes

    assert kept(checkpoint_every=20) < 0.3 * kept()


def test_no_blocks_of_no_steps(run):
    with pytest.raises(sean_jax.InputError, match="checkpoint_every: 0 "):
        run(*AT, checkpoint_every=0)


@pytest.mark.parametrize(
    "between",
    [
        partial(gradients.truncate, every=4),
        partial(gradients.damp, factor=0.7),
        partial(gradients.clip, limit=0.5),
        lambda state: gradients.clip(gradients.damp(state, 0.9), 2.0),
    ],
)
def test_states_stay_what_they_are(run, plain, between):
    trees.assert_close(jax.jit(lambda *at: run(*at, between=between))(*AT), plain[2], rtol=1e-6)


def test_truncation_ends_derivatives_and_leaves_constants(run, plain):
    whole = plain[0]
    reverse, forward, _ = slopes(run, between=partial(gradients.truncate, every=4))
    np.testing.assert_allclose(reverse, forward, rtol=1e-4)
    assert reverse[1] == 0.0 and whole[1] != 0.0  # the start lies before the last end, three steps back
    assert 0.0 < abs(reverse[0]) < abs(whole[0])
    assert reverse[2] != 0.0  # preferred speeds are constants that the state carries
    np.testing.assert_allclose(
        slopes(run, between=partial(gradients.truncate, every=STEPS + 1))[:2], (whole, whole), rtol=1e-4
    )


def test_damping_is_a_factor_for_each_step(scenario, start, monkeypatch):
    """Of a linear map: d last / d first = (growth factor) ** steps, in both modes."""
    monkeypatch.setattr(
        episodes,
        "step",
        lambda scenario, state, action: replace(
            state,
            pedestrians=replace(state.pedestrians, position=1.1 * state.pedestrians.position),
            tick=state.tick + 1,
        ),
    )

    def last(shift, factor):
        people = replace(start.pedestrians, position=start.pedestrians.position + shift)
        between = lambda state: gradients.damp(state, factor)  # noqa: E731
        state, _ = sean_jax.simulate(scenario, POLICY, replace(start, pedestrians=people), STEPS, between=between)
        return state.pedestrians.position[0, 0]

    for mode in (jax.grad, jax.jacfwd):
        slope = jax.jit(mode(last))
        for factor in (1.0, 0.8, 0.0):
            assert float(slope(jnp.float32(0.0), factor)) == pytest.approx((1.1 * factor) ** STEPS, rel=1e-5)


def _no_pull(leaf):
    """The zero cotangent of an array."""
    return np.zeros(leaf.shape, leaf.dtype if jnp.issubdtype(leaf.dtype, jnp.floating) else jax.dtypes.float0)


def test_clipping_bounds_each_body_and_leaves_forward_mode(run, plain, start):
    limit = 0.3
    state = start

    def pulled(state_cotangent):
        _, pull = jax.vjp(lambda people: gradients.clip(replace(state, pedestrians=people), limit).pedestrians, people)
        return pull(state_cotangent)[0]

    people = state.pedestrians
    random = np.random.default_rng(0)
    size = random.choice([0.0, 1e-20, 1e-3, 1.0, 1e15], len(people.position))[:, None]
    pull = jax.tree.map(_no_pull, people)
    floats = {
        name: jnp.asarray(
            random.normal(size=getattr(people, name).shape) * size.reshape(-1, *[1] * (getattr(people, name).ndim - 1)),
            jnp.float32,
        )
        for name in (*gradients.MOVING, "preferred_speed", "robot_distance")
    }
    found = pulled(replace(pull, **floats))
    before, after = (
        np.concatenate([np.asarray(getattr(one, name)) for name in gradients.MOVING], 1)
        for one in (replace(pull, **floats), found)
    )
    norms = np.linalg.norm(before, axis=1)
    np.testing.assert_allclose(np.linalg.norm(after, axis=1), np.minimum(norms, limit), rtol=1e-4)
    cosine = (before * after).sum(1) / np.maximum(norms * np.linalg.norm(after, axis=1), 1e-30)
    assert (cosine[norms > 1e-6] > 0.999).all()
    np.testing.assert_array_equal(found.preferred_speed, floats["preferred_speed"])
    whole = plain[0]
    reverse, forward, _ = slopes(run, between=partial(gradients.clip, limit=limit))
    np.testing.assert_allclose(forward, whole, rtol=1e-4)
    assert abs(reverse[0]) < abs(whole[0])
