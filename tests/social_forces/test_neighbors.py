"""Neighbors in large crowds: nobody near is missed, and forces and gradients are those of all pairs."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import social_forces
from sean_jax.cli.bench import workload
from sean_jax.core import gpu_kernels
from sean_jax.social_forces import Crowd, Pair, kernel, model, neighbors
from sean_jax.social_forces.forces import look_direction
from sean_jax.social_forces.neighbors import sum_pairs
from support import trees
from support.quick import quick

NUMBER = 303  # enough that neighbors are looked for, and no multiple of the blocks
find = jax.jit(neighbors.find)


def pair_forces(forces, people, near=None):
    """What people feel from one another: pushes of pair terms and acts of gather terms."""
    crowd = Crowd(forces, people, *look_direction(people), None, None, None, 0.0, None)
    parts = [part for part in model.pair_forces(crowd, near) if part is not None]
    return sum(part[0] for part in parts), sum(part[1] for part in parts)


def places(kind: str) -> np.ndarray:
    """(N, 2) m."""
    random = np.random.default_rng(3)
    spread = random.uniform(-30.0, 30.0, (NUMBER, 2))
    if kind == "one spot":
        return np.full((NUMBER, 2), 4.0)
    if kind == "a line":
        return spread * [1.0, 0.0]
    if kind == "a column":
        return spread * [0.0, 1.0]
    if kind == "a throng":
        return np.where(np.arange(NUMBER)[:, None] < 200, 0.05 * spread, spread)
    return spread


def crowd(density: float = 0.3):
    """People on their way through a square hall, every seventh of them absent and far away."""
    people = workload.crowd(NUMBER, 0)[0]
    present = jnp.arange(NUMBER) % 7 != 0
    position = people.position * float(np.sqrt(workload.DENSITY / density))
    return replace(people, position=jnp.where(present[:, None], position, 1e7), present=present)


@pytest.mark.parametrize("kind", ["anywhere", "one spot", "a line", "a column", "a throng"])
@pytest.mark.parametrize("within", [0.5, 7.0, 1e6])
def test_nobody_near_is_missed(kind, within):
    position = places(kind).astype(np.float32)
    present = np.arange(NUMBER) % 5 != 0
    near = find(jnp.asarray(np.where(present[:, None], position, 1e8)), jnp.asarray(present), jnp.float32(within))
    order, place = np.asarray(near.order), np.asarray(near.by_parts)
    by_parts, first, last = order[place], np.asarray(near.first)[place], np.asarray(near.last)[place]
    np.testing.assert_array_equal(np.sort(order), np.arange(NUMBER))
    np.testing.assert_array_equal(by_parts[np.asarray(near.rank)], np.arange(NUMBER))
    longest = -(-(last - first).max(1) // neighbors.PART)
    assert (longest[1:] <= longest[:-1]).all()
    index = np.arange(NUMBER)[None, None, :]
    found = ((index >= first[:, :, None]) & (index < last[:, :, None])).sum(1)
    assert found[present[by_parts]].max() == 1, "somebody is in two runs"
    feel, felt = position[by_parts].astype(np.float64), position[order].astype(np.float64)
    apart = np.linalg.norm(feel[:, None] - felt[None], axis=-1)
    wanted = (apart <= within) & present[by_parts][:, None] & present[order][None]
    assert (found[wanted] == 1).all()
    if kind == "anywhere" and within == 7.0:
        assert found.sum() < 0.4 * NUMBER**2


def forces_and_slopes(parameters, few: bool):
    """Forces (2, N) of few or of all pairs, and slopes by parameters, positions and velocities."""
    people = crowd()

    @jax.jit
    @partial(jax.grad, argnums=(0, 1, 2), has_aux=True)
    def slopes(parameters, position, velocity):
        moved = replace(people, position=position, velocity=velocity)
        near = model.neighbors(parameters, moved, 0.1) if few else None
        assert (near is not None) == few
        x, y = jnp.where(people.present, jnp.stack(pair_forces(parameters, moved, near)), 0.0)
        return jnp.sum(jnp.sin(x)) + jnp.sum(jnp.cos(2.0 * y)), (x, y)

    return slopes(parameters, people.position, people.velocity)


@pytest.mark.night
@pytest.mark.parametrize("preset", quick(social_forces.PRESETS, "helbing1995"))
def test_forces_and_gradients_are_those_of_all_pairs(preset, monkeypatch):
    """On a CPU, and in the form of the sums for older GPUs."""
    parameters, present = social_forces.preset(preset), np.arange(NUMBER) % 7 != 0
    exact_slopes, exact = forces_and_slopes(parameters, few=False)
    assert np.abs(exact).max() > 0.01
    for on in ("cpu", "older gpu"):
        if on == "older gpu":
            monkeypatch.setattr(gpu_kernels, "available", lambda: False)
            monkeypatch.setattr(jax.lax, "platform_dependent", lambda *given, cpu, default: default(*given))
        slopes, forces = forces_and_slopes(parameters, few=True)
        np.testing.assert_allclose(forces, exact, atol=2e-3, rtol=1e-5)  # of 300 that push by less than 1e-4 m/s2 each
        for ours, theirs in zip(slopes[1:], exact_slopes[1:], strict=True):
            size = 1e-3 + np.linalg.norm(theirs[present])
            assert np.linalg.norm(np.asarray(ours - theirs)[present]) < 2e-3 * size, on
        trees.assert_close(slopes[0], exact_slopes[0], rtol=2e-2, atol=2e-2)


def pull(strength, own, other):
    """A law of a pair that is quickly compiled: none beyond 3 m."""
    dx, dy = own[0] - other[0], own[1] - other[1]
    size = strength * jnp.maximum(9.0 - dx * dx - dy * dy, 0.0) * other[2]
    return size * dx, size * dy


def test_sums_have_forward_mode_too():
    """Jacobians of both modes are equal; with respect to what is felt, who feels, and what all share."""
    people = crowd()
    near = find(people.position, people.present, jnp.float32(3.0))
    places = jnp.where(people.present, people.position.T, 0.0)
    weight = people.present.astype(jnp.float32)

    def sums(shift, strength):
        own, other = tuple(places.at[:, 1].add(shift[0])), (*places.at[:, 2].add(shift[1]), weight)
        return jnp.stack(sum_pairs(pull, near, jnp.float32(3.0), strength, own, other))

    at = jnp.zeros((2, 2), jnp.float32), jnp.float32(0.5)
    both = jax.jit(lambda *at: (jax.jacfwd(sums, (0, 1))(*at), jax.jacrev(sums, (0, 1))(*at)))
    for forward, backward in zip(*both(*at), strict=True):
        np.testing.assert_allclose(forward, backward, atol=1e-4, rtol=1e-4)
        assert np.abs(forward).max() > 0.1


def test_both_forms_of_going_back_agree():
    """The one that stores all pairs, on CPUs, and the two sums of other devices."""
    random = np.random.default_rng(2)
    own = tuple(jnp.asarray(random.normal(size=(2, 9)), jnp.float32))
    other = (*own, jnp.asarray(random.random(9), jnp.float32))
    pulls = tuple(jnp.asarray(random.normal(size=(2, 9)), jnp.float32))
    both = [jax.jit(partial(form, pull)) for form in (neighbors._pull_back_at_once, neighbors._pull_back_in_two)]
    stored, summed = (form(jnp.float32(0.5), own, other, pulls) for form in both)
    assert jax.tree.structure(stored) == jax.tree.structure(summed)
    for one, two in zip(jax.tree.leaves(stored), jax.tree.leaves(summed), strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-4, atol=1e-4)
        assert np.abs(one).max() > 0.1


@pytest.mark.night
def test_forward_mode_equals_reverse_mode_also_twice():
    """Among 303 people: the Jacobian of forces by three places and a constant, and second derivatives of all pairs."""
    parameters, people = social_forces.preset("helbing1995"), crowd()
    at = people.position[1:4], parameters.repulsion.strength

    def forces(places, strength, few=True):
        moved = replace(people, position=people.position.at[1:4].set(places))
        near = model.neighbors(parameters, moved, 0.1) if few else None
        x, y = pair_forces(parameters.tree_replace({"repulsion.strength": strength}), moved, near)
        return jnp.where(people.present, jnp.stack([x, y]), 0.0)[:, :8]

    both = jax.jit(lambda *at: (jax.jacfwd(forces, (0, 1))(*at), jax.jacrev(forces, (0, 1))(*at)))
    for forward, backward in zip(*both(*at), strict=True):
        np.testing.assert_allclose(forward, backward, atol=1e-5, rtol=1e-4)
        assert np.abs(forward).max() > 0.1

    def bend(places, few):
        slope = jax.grad(lambda places: jnp.sin(forces(places, parameters.repulsion.strength, few)).sum())
        return jax.jvp(slope, (places,), (jnp.ones_like(places),))[1]

    ours, exact = jax.jit(lambda places: (bend(places, True), bend(places, False)))(at[0])
    np.testing.assert_allclose(ours, exact, atol=1e-4, rtol=1e-3)


def test_who_is_farther_than_felt_pushes_by_less_than_said():
    for name in social_forces.PRESETS:
        parameters = social_forces.preset(name)
        reach = float(model.cutoff(parameters))
        angle = np.linspace(0.0, 2 * np.pi, 73, dtype=np.float32)
        top = float(parameters.walking.speed_ratio * parameters.walking.speed_max)
        dx = jnp.full(73, min(reach, 1e3) * 1.001, jnp.float32)
        wx, wy = jnp.asarray(top * np.cos(angle)), jnp.asarray(top * np.sin(angle))
        x, y = parameters.repulsion.law(parameters.repulsion, Pair(dx, 0.0 * dx, wx, wy, -wx, -wy, 1.0, 0.0, 0.4))
        assert float(jnp.max(jnp.hypot(x, y))) < 1.5e-4 or reach == float(parameters.walking.perception)


def test_neighbors_hold_for_all_steps_between_two_looks():
    """Everybody runs to the middle at top speed for the time given; those found before include all who are felt."""
    parameters, people = social_forces.preset("sean2"), crowd(1.0)
    time = 1.0
    near = model.neighbors(parameters, people, time)
    heading = -people.position / jnp.linalg.norm(people.position, axis=1, keepdims=True)
    step = parameters.walking.speed_ratio * people.preferred_speed[:, None] * time
    moved = replace(people, position=people.position + heading * step)
    here = np.asarray(people.present)
    old, exact = jax.jit(lambda near: (pair_forces(parameters, moved, near), pair_forces(parameters, moved)))(near)
    for one, other in zip(old, exact, strict=True):
        np.testing.assert_allclose(np.asarray(one)[here], np.asarray(other)[here], rtol=1e-4, atol=1e-3)


def test_a_batch_is_its_crowds_and_a_law_of_ones_own_sees_all():
    parameters, people = social_forces.preset("helbing1995"), crowd()
    two = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf[::-1]]), people)
    integrate = jax.jit(jax.vmap(lambda people: social_forces.integrate(parameters, people, None, None, None, 0.05)))
    after = integrate(two)
    here = np.asarray(people.present)
    np.testing.assert_allclose(after.velocity[0][here], after.velocity[1][::-1][here], atol=1e-4)
    own = parameters.tree_replace({"repulsion.law": lambda *arguments: parameters.repulsion.law(*arguments)})
    assert model.neighbors(own, people, 0.1) is None
    assert model.neighbors(parameters, jax.tree.map(lambda leaf: leaf[:62], people), 0.1) is None


@pytest.mark.parametrize(
    ("preset", "number", "density"),
    [
        ("helbing1995", 9, 2.0),
        *(pytest.param(name, 70, 0.3, marks=pytest.mark.slow) for name in social_forces.PRESETS),
        *(pytest.param("helbing1995", *case, marks=pytest.mark.slow) for case in ((1, 1.0), (2, 7.0), (32, 3.0))),
    ],
)
def test_the_kernel_sums_what_all_pairs_sum(preset, number, density, on_a_gpu, monkeypatch):
    """Forces, and derivatives of both modes, by everything that the sums depend on."""
    parameters, people = social_forces.preset(preset), workload.crowd(300, 0)[0]
    people = jax.tree.map(lambda leaf: leaf[:number], people)
    present = jnp.arange(number) % 7 != 6
    position = people.position * float(np.sqrt(workload.DENSITY / density))
    position = jnp.where(present[:, None], position, 1e7).at[number // 2].set(position[0])  # two at one place
    people = replace(people, position=position, present=present)

    def forces(parameters, position, velocity):
        now = replace(people, position=position, velocity=velocity)
        x, y = pair_forces(parameters, now, model.neighbors(parameters, now, 0.1))
        return jnp.where(present, jnp.stack([x, y]), 0.0)

    random = np.random.default_rng(number)
    weights = jnp.asarray(random.normal(size=(2, number)), jnp.float32)

    def loss(*at):
        return (weights * forces(*at)).sum()

    def compute(at):
        return forces(*at), jax.jvp(forces, at, change)[1], jax.grad(loss, (0, 1, 2))(*at)

    at = parameters, people.position, people.velocity
    change = jax.tree.map(lambda leaf: jnp.asarray(random.normal(size=leaf.shape), leaf.dtype), at)
    launches = []
    monkeypatch.setattr(kernel, "_call", partial(lambda call, *a: launches.append(1) or call(*a), kernel._call))
    ours, *our_derivatives = jax.jit(compute)(at)
    assert launches
    monkeypatch.setattr(kernel, "trace", lambda *_: None)
    exact, *derivatives = jax.jit(lambda at: compute(at))(at)
    np.testing.assert_allclose(ours, exact, rtol=1e-5, atol=1e-5 * (1.0 + np.abs(exact).max()))
    for one, other in zip(jax.tree.leaves(our_derivatives), jax.tree.leaves(derivatives), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-4 * (1.0 + np.abs(other).max()))
