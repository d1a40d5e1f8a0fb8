"""Variety: noise, traits, headway and bounded accelerations, on random and on degenerate states."""

import functools
from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import sean_jax
from sean_jax import social_forces
from sean_jax.core import random_streams
from sean_jax.core.data_types import Groups, Robot, Traits
from sean_jax.social_forces import Headway, Noise, individualize, model
from sean_jax.social_forces.forces import Crowd, look_direction
from sean_jax.studies.scenes import model as model_of
from sean_jax.studies.scenes import simulate
from sean_jax.studies.validation import crowds, measures
from support import float64, programs
from support.forces import STEP, crowd, scene, walk

CALIBRATED = social_forces.preset("calibrated")
DEVIATIONS = ("walking.relaxation_deviation", "headway.deviation", "evasion.width_deviation", "evasion.side_deviation")
WALKING_GROUPS, STANDING = [[0, 1], [3, 6, 7]], [9, 10]
GROUPS = Groups(jnp.array([[0.4, 0.2]]), jnp.full(1, 0.5), jnp.zeros((1, 2)), jnp.ones(1, bool))
HEADING = np.array([0.6, 0.8])
BOXES = (0.0, 2.3, 3.0, 0.5, 4.0), (-2.2, 0.0, 0.3, 1.0, 10.0)


def companions(people: int) -> np.ndarray:
    """(N, 2) indices, of ``WALKING_GROUPS``."""
    rows = np.full((people, 2), -1, np.int32)
    for walking_group in WALKING_GROUPS:
        for one in walking_group:
            others = [other for other in walking_group if other != one]
            rows[one, : len(others)] = others
    return rows


def traits_of(random, people: int) -> Traits:
    return Traits(*(np.asarray(random.normal(size=people), np.float32) for _ in fields(Traits)))


def throng(seed: int, people: int = 14):
    """People close together with all that the law knows: groups that walk and stand, traits, noise; and a robot."""
    random = np.random.default_rng(seed)
    x, desired = random.uniform(-1.7, 1.7, (people, 2)), random.normal(size=(people, 2))
    desired[2] = 0.0
    group = np.full(people, -1, np.int32)
    group[STANDING] = 0
    walking_group = np.full(people, -1, np.int32)
    for number, members in enumerate(WALKING_GROUPS):
        walking_group[members] = number
    angle = random.uniform(0.0, 2 * np.pi, people)
    everybody = crowd(
        x,
        desired,
        random.normal(size=(people, 2)),
        random.uniform(0.8, 1.6, people),
        heading=np.float32(np.stack([np.cos(angle), np.sin(angle)], -1)),
        group=group,
        walking_group=walking_group,
        robot_distance=np.float32(random.uniform(-0.2, 0.3, people)),
        traits=traits_of(random, people),
        noise=np.float32(random.normal(size=(people, 2))),
    )
    place = np.float32(random.uniform(-1, 1, 2))
    return everybody, Robot(place, np.float32(HEADING), np.float32(0.5), np.float32(0.0), ())


def as_doubles(people, robot) -> tuple[tuple, dict]:
    """The state of the float64 loop, and what else it takes."""
    names = "position", "velocity", "heading", "desired_velocity", "preferred_speed"
    state = tuple(np.asarray(getattr(people, name), float) for name in names)
    return state, dict(
        group=np.asarray(people.group),
        groups=[(np.asarray(GROUPS.center[0], float), 0.5)],
        traits={one.name: np.asarray(getattr(people.traits, one.name), float) for one in fields(Traits)},
        noise=np.asarray(people.noise, float),
        robot=(np.asarray(robot.position, float), float(robot.speed) * HEADING, 0.16),
        extra=np.asarray(people.robot_distance, float),
    )


def stack(trees):
    return jax.tree.map(lambda *leaves: np.stack(leaves), *trees)


@functools.partial(jax.jit, static_argnums=4)
def step_with_all(forces, people, robot, table, length=STEP):
    """Throngs (S, 14) and robots (S,) after a step, among groups that stand and walk."""

    def step(people, robot):
        return social_forces.integrate(forces, people, table, GROUPS, robot, length, 0.16, companions(14))

    return jax.vmap(step)(people, robot)


@pytest.mark.parametrize(
    ("preset", "changes"),
    [
        ("calibrated", {}),
        ("calibrated", {"walking.depth": 0.12, "headway.length": -0.1, "walking.acceleration": 2.0}),
        ("sean2", {"walking.acceleration": 3.0, "walking.relaxation_deviation": 0.3, "walking.depth": 0.15}),
        ("helbing2000", {"walking.acceleration": 30.0}),
        ("johansson2007", {}),
    ],
)
def test_everything_together_equals_the_float64_loop(preset, changes):
    """Random throngs with robot, walls, groups that walk and stand, traits and noise, as printed, one by one."""
    forces = social_forces.build(social_forces.preset(preset).tree_replace(changes))
    table, boxes = scene(*BOXES)
    both = [throng(seed) for seed in range(6)]
    p = float64.constants(forces)
    ours = step_with_all(forces, *(stack(part) for part in zip(*both, strict=True)), table, 0.02)
    for k, (people, robot) in enumerate(both):
        state, others = as_doubles(people, robot)
        theirs = float64.step(*state, boxes, p, 0.02, WALKING_GROUPS, **others)
        for name, exact in zip(("position", "velocity", "heading"), theirs, strict=True):
            np.testing.assert_allclose(getattr(ours, name)[k], exact, atol=2e-4, err_msg=f"{name}, throng {k}")


# --- noise ---


def test_noise_has_unit_variance_and_the_correlation_of_its_time():
    """Ornstein-Uhlenbeck of 4096 people over 400 steps: normal, exp(-t / time), both parts independent."""
    noise = CALIBRATED.noise.replace(time=jnp.float32(2.5))
    key, step = jax.random.key(0), 0.1
    start = jax.random.normal(jax.random.key(1), (4096, 2), float)

    @jax.jit
    def run(start):
        def one(now, tick):
            now = noise.advance(now, jax.random.fold_in(key, tick), step)
            return now, now

        return jax.lax.scan(one, start, jnp.arange(400, dtype=jnp.int32))[1]

    series = np.asarray(run(start), float)
    assert series[200:].mean() == pytest.approx(0.0, abs=0.02)
    np.testing.assert_allclose((series**2).mean((1, 2)), 1.0, atol=0.08)
    assert (series**2).mean() == pytest.approx(1.0, abs=0.02)
    for lag in (1, 5, 25, 50, 100):
        correlation = (series[lag:] * series[:-lag]).mean()
        assert correlation == pytest.approx(np.exp(-lag * step / 2.5), abs=0.02), lag
    assert (series[..., 0] * series[..., 1]).mean() == pytest.approx(0.0, abs=0.02)
    one, other = series[200:, :2048].ravel(), series[200:, 2048:].ravel()
    assert np.corrcoef(one, other)[0, 1] == pytest.approx(0.0, abs=0.01)
    assert stats.kurtosis(series[200:], None) == pytest.approx(0.0, abs=0.1)
    ends = np.asarray(run(jnp.zeros_like(start)), float)[[0, 24, 399]]
    np.testing.assert_allclose((ends**2).mean((1, 2)), 1 - np.exp(-2 * step * np.array([1, 25, 400]) / 2.5), atol=0.03)


def moment(forces, people, seed: int = 0, tick: int = 0, time_step: float = 0.1) -> tuple[Any, Any]:
    """The least scenario and state that ``model.move`` reads."""
    substeps = social_forces.substeps(forces, time_step)
    scenario = SimpleNamespace(
        time_step=time_step, forces=forces, environment=SimpleNamespace(obstacle_grid=None), substeps=substeps,
        robot=SimpleNamespace(radius=0.16), behavior=SimpleNamespace(companions=None),
    )  # fmt: skip
    streams = random_streams.streams(jax.random.key(seed))
    return scenario, SimpleNamespace(pedestrians=people, groups=None, robot=None, streams=streams, tick=tick)


def test_noise_is_a_function_of_key_and_tick():
    people = replace(throng(0)[0], group=jnp.full(14, -1, jnp.int32))

    @jax.jit
    def moved(seed, tick):
        return model.move(*moment(CALIBRATED, people, seed, tick))

    seeds, ticks = np.int32([0, 0, 1, 0]), np.int32([3, 3, 3, 4])
    once, again, other_key, other_tick = (moved(seed, tick) for seed, tick in zip(seeds, ticks, strict=True))
    jax.tree.map(np.testing.assert_array_equal, once, again)
    for different in (other_key, other_tick):
        assert np.abs(different.noise - once.noise).min(0).max() > 0.0
        assert np.abs(different.position - once.position).max() > 1e-5
    key = jax.random.fold_in(random_streams.streams(jax.random.key(0)).noise, 3)
    np.testing.assert_allclose(once.noise, CALIBRATED.noise.advance(people.noise, key, 0.1), rtol=1e-6)


def test_streams_of_an_episode_are_those_without_noise():
    key = jax.random.key(7)
    streams = random_streams.as_numbers(random_streams.streams(key))
    before = jax.random.key_data(jax.random.split(key, 4))
    for name, exact in zip(("people", "policy", "sensors", "restart"), before, strict=True):
        np.testing.assert_array_equal(getattr(streams, name), exact)
    assert len({tuple(np.asarray(one).tolist()) for one in vars(streams).values()}) == 5


@pytest.mark.night
def test_noise_and_traits_change_no_other_draw_and_traits_last_an_episode():
    usual = sean_jax.make("lab", people=4, dynamics="twin", forces="calibrated")
    plain = [term for term in CALIBRATED.tree_replace(dict.fromkeys(DEVIATIONS)) if not isinstance(term, Noise)]
    alike = usual.replace(forces=social_forces.build(plain))
    lively, calm = (jax.jit(sean_jax.reset)(one, jax.random.key(3)) for one in (usual, alike))
    assert lively.pedestrians.traits is not None and lively.pedestrians.noise is not None
    assert calm.pedestrians.traits is None and calm.pedestrians.noise is None
    without = replace(lively.pedestrians, traits=None, noise=None)
    ours, theirs = (random_streams.as_numbers(one) for one in (replace(lively, pedestrians=without), calm))
    jax.tree.map(np.testing.assert_array_equal, ours, theirs)

    @jax.jit
    def later(people):
        def one(people, tick):
            return model.move(*moment(usual.forces, people, 3, tick)), None

        return jax.lax.scan(one, people, jnp.arange(20, dtype=jnp.int32))[0]

    people = later(lively.pedestrians)
    jax.tree.map(np.testing.assert_array_equal, people.traits, lively.pedestrians.traits)
    assert np.abs(people.noise - lively.pedestrians.noise).min() > 0.0


def test_without_noise_the_term_pushes_nobody():
    """It has no effect on people who have none, and on people of noise zero; those who stand feel nothing."""
    people, _ = throng(1)
    noise = CALIBRATED.noise.replace(speed=jnp.float32(0.3), side=jnp.float32(0.2))
    forces = CALIBRATED.replace(noise=noise)

    def push(people):
        force = noise.person(Crowd(forces, people, *look_direction(people), None, None, None, 0.0, None))
        return None if force is None else np.stack(force, -1)

    assert push(replace(people, noise=None)) is None
    np.testing.assert_array_equal(push(replace(people, noise=jnp.zeros((14, 2)))), 0.0)
    pushed = push(people)
    np.testing.assert_array_equal(pushed[2], 0.0)
    assert np.abs(np.delete(pushed, 2, 0)).min(0).max() > 1e-3


# --- traits ---


def test_traits_are_truncated_normal_and_independent():
    number = 20_000
    people = jax.jit(lambda key: individualize(CALIBRATED, blank(number), key))(jax.random.key(5))
    drawn = np.stack([np.asarray(getattr(people.traits, one.name), float) for one in fields(Traits)])
    for row in drawn:
        assert np.abs(row).max() <= model.MOST_UNLIKE
        assert stats.kstest(row, stats.truncnorm(-model.MOST_UNLIKE, model.MOST_UNLIKE).cdf).pvalue > 1e-3
    every = np.concatenate([drawn, np.asarray(people.noise, float).T])
    correlation = np.corrcoef(every) - np.eye(len(every))
    assert np.abs(correlation).max() < 0.03
    assert stats.kstest(every[-2], stats.norm.cdf).pvalue > 1e-3


def blank(number: int):
    return crowd(np.zeros((number, 2)), np.ones((number, 2)))


def test_traits_and_noise_are_absent_where_no_term_has_a_use_for_them():
    key = jax.random.key(0)
    for name in social_forces.PRESETS:
        people = individualize(social_forces.preset(name), blank(3), key)
        assert (people.traits is None) == (people.noise is None) == (name != "calibrated")
    alike = CALIBRATED.tree_replace(dict.fromkeys(DEVIATIONS))
    people = individualize(alike, blank(3), key)
    assert people.traits is None and people.noise is not None
    for name in DEVIATIONS:
        assert individualize(alike.tree_replace({name: 0.1}), blank(3), key).traits is not None, name


def test_deviations_of_zero_are_people_who_do_not_differ():
    people, robot = throng(2)
    forces = CALIBRATED.tree_replace(dict.fromkeys(DEVIATIONS, 0.0))
    apart, alike = (walk(forces, each, robot=robot) for each in (people, replace(people, traits=None)))
    np.testing.assert_allclose(apart.velocity, alike.velocity, atol=1e-5)
    lively = walk(forces.tree_replace(dict.fromkeys(DEVIATIONS, 0.3)), people, robot=robot)
    assert np.abs(lively.velocity - alike.velocity).max() > 0.01


# --- headway ---

FREE = 1.4  # m/s


GAPS = 85


def queue(gap, other_speed, deviation=0.0, headway=0.0, noise=0.0, sign=1.0):
    """(G,) m/s, the speed that a person takes up at once behind (sign -1: before) one other at so many gaps [m]."""
    walking = social_forces.preset("helbing1995").walking.replace(relaxation_time=STEP)
    term = Headway(length=0.05, time=0.7, width=0.4, ramp=0.1, deviation=deviation, noise=0.3)
    forces = social_forces.build([walking, term])
    people = crowd(np.zeros((2, 2)), [(FREE, 0), (other_speed, 0)], [(0, 0), (other_speed, 0)], [FREE, FREE])
    people = replace(people, traits=Traits(*[np.full(2, headway, np.float32)] * 4))
    people = replace(people, noise=np.full((2, 2), noise, np.float32))
    position = np.zeros((GAPS, 2, 2), np.float32)
    position[:, 1, 0] = sign * (gap + 0.4)
    batch = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (GAPS, *leaf.shape)), people)
    return np.asarray(step_each(forces, replace(batch, position=position)).velocity[:, 0, 0], float)


@jax.jit
def step_each(forces, people):
    """Crowds (S, N) after a step."""
    return jax.vmap(lambda people: social_forces.integrate(forces, people, None, None, None, STEP))(people)


def test_speed_behind_one_person_is_the_least_of_desired_speed_and_time_headway():
    gap = np.linspace(-0.2, 4.0, GAPS)
    limit = np.maximum(gap - 0.05, 0.01) / 0.7
    for other_speed in (0.0, 1.0):
        speed = queue(gap, other_speed)
        sharp = np.minimum(limit, FREE)
        assert (speed <= sharp * (1 + 1e-4)).all() and (speed >= 2**-0.25 * sharp * (1 - 1e-4)).all()
        far = (limit > 2 * FREE) | (limit < FREE / 2)
        np.testing.assert_allclose(speed[far], sharp[far], rtol=0.016)
        np.testing.assert_allclose(speed, FREE * (1 + (FREE / limit) ** 4) ** -0.25, rtol=1e-3)
        assert (np.diff(speed[gap > 0.07]) > 0).all()
    stopped = queue(gap, 0.0)[gap <= 0.05]
    assert (stopped >= 0.0).all() and (stopped <= 0.01 / 0.7 * 1.001).all()


def test_headway_turns_nobody_back_in_any_throng():
    """Alone with ``Walking`` it takes from the desired velocity at most all of it, however many are in the way."""
    walking = social_forces.preset("helbing1995").walking.replace(relaxation_time=STEP)
    forces = social_forces.build([walking, CALIBRATED.headway])

    people = stack([throng(seed)[0] for seed in range(20)])
    people = replace(people, position=np.float32(0.3) * people.position, velocity=0 * people.velocity)
    people = replace(people, group=np.full_like(people.group, -1), preferred_speed=np.full((20, 14), 9, np.float32))
    velocity, desired = step_each(forces, people).velocity, people.desired_velocity
    along = (velocity * desired).sum(-1) / np.maximum((desired**2).sum(-1), 1e-6)
    assert along.min() >= -1e-5 and along.max() <= 1.0 + 1e-5
    assert along.min() < 0.05 and along.max() > 0.3


# --- bounds ---


@jax.jit
@functools.partial(jax.vmap, in_axes=(None, 0, 0))
def pushes_of(forces, people, robot):
    look = look_direction(people)
    return model.pair_forces(Crowd(forces, people, *look, None, GROUPS, robot, 0.16, companions(14)))[0]


@pytest.mark.parametrize("bound", [1.0, 3.5])
def test_what_people_do_on_purpose_is_bounded(bound):
    """All but pushes of people: walls, robot, groups, companions, drive, evasion and noise in swept throngs."""
    changes = {"acceleration": bound, "speed_ratio": 100.0, "relaxation_time": 0.2}
    changes = {f"walking.{name}": value for name, value in changes.items()} | {"walls.strength": 50.0}
    forces = social_forces.build(CALIBRATED.tree_replace(changes))
    table, _ = scene((0.0, 2.5, 6.0, 0.3, 0.0))  # nobody reaches it in a step
    people, robots = (stack(part) for part in zip(*(throng(seed) for seed in range(30)), strict=True))
    after = step_with_all(forces, people, robots, table, 1e-3)
    acceleration = (after.velocity - people.velocity) / 1e-3 - np.stack(pushes_of(forces, people, robots), -1)
    size = np.linalg.norm(acceleration, axis=-1)
    assert size.max() <= bound + 0.02  # rounding of a difference of velocities
    assert np.quantile(size, 0.9) > 0.95 * bound


def test_small_accelerations_are_not_shortened_and_large_ones_only_shortened():
    random = np.random.default_rng(0)
    a = jnp.asarray(random.normal(size=(2, 500)) * 10.0 ** random.uniform(-4, 8, 500), float)
    walking = CALIBRATED.walking.replace(acceleration=jnp.float32(3.5))
    b = np.stack(jax.jit(walking.bound)(*a)).astype(float)
    before, after = np.linalg.norm(np.asarray(a, float), axis=0), np.linalg.norm(b, axis=0)
    np.testing.assert_allclose(after, before / (1 + (before / 3.5) ** 4) ** 0.25, rtol=1e-4)
    np.testing.assert_allclose(a[0] * b[1], a[1] * b[0], rtol=1e-4)
    free = social_forces.preset("helbing1995").walking
    np.testing.assert_array_equal(np.stack(free.bound(*a))[:, before < 1e6], np.asarray(a)[:, before < 1e6])


# --- programs ---


def test_traits_and_noise_under_jit_and_vmap():
    @programs.jit_once
    def once(people, robot):
        return social_forces.integrate(CALIBRATED, people, None, GROUPS, robot, STEP, 0.16)

    everybody, robot = throng(3)
    people = everybody
    for _ in range(3):
        people = once(people, robot)
    assert not any(leaf.weak_type for leaf in jax.tree.leaves(people))
    jax.tree.map(np.testing.assert_array_equal, people.traits, everybody.traits)
    both = [throng(seed) for seed in range(4)]
    together = jax.jit(jax.vmap(once))(*(stack(part) for part in zip(*both, strict=True)))
    for k, each in enumerate(both):
        alone = once(*each)
        np.testing.assert_allclose(together.velocity[k], alone.velocity, atol=1e-4)


@pytest.mark.parametrize("on", ["cpu", "gpu"])
def test_large_crowds_have_traits_noise_and_shoulders_too(on, request):
    """Sums over the neighbors among 260 people are those over all pairs, in groups of both kinds."""
    if on == "gpu":
        request.getfixturevalue("on_a_gpu")
    number, group, walking_group = 260, np.full(260, -1, np.int32), np.full(260, -1, np.int32)
    group[20:26], walking_group[:8] = [0, 0, 1, 1, 2, 2], [0, 0, 1, 1, 2, 2, 3, 3]
    walks_with = np.full((number, 2), -1, np.int32)
    walks_with[:8, 0] = [1, 0, 3, 2, 5, 4, 7, 6]
    random = np.random.default_rng(0)
    x, desired = random.uniform(-9, 9, (number, 2)), random.normal(size=(number, 2))
    people = crowd(x, desired, random.normal(size=(number, 2)), np.full(number, 1.3), group=group,
                   walking_group=walking_group, traits=traits_of(random, number),
                   noise=np.float32(random.normal(size=(number, 2))))  # fmt: skip

    @jax.jit
    def both(people):
        seen = Crowd(CALIBRATED, people, *look_direction(people), None, None, None, 0.0, jnp.asarray(walks_with))
        near = model.neighbors(CALIBRATED, people, 0.1)
        assert near is not None
        return model.pair_forces(seen, near), model.pair_forces(seen)

    near, every = (jax.tree.map(np.asarray, part) for part in both(people))
    for ours, exact in zip(jax.tree.leaves(near), jax.tree.leaves(every), strict=True):
        np.testing.assert_allclose(ours, exact, atol=5e-3, rtol=1e-4)
        assert np.abs(exact).max() > 0.5


def test_a_tick_is_traced_once_for_all_ticks():
    people = replace(throng(4)[0], group=jnp.full(14, -1, jnp.int32))

    @programs.jit_once
    def moved(people, tick):
        return model.move(*moment(CALIBRATED, people, 0, tick))

    for tick in range(3):
        people = moved(people, jnp.int32(tick))
    assert not any(leaf.weak_type for leaf in jax.tree.leaves(people))


DEGENERATE = {
    "coincident": [(0, 0), (0, 0)],
    "nearly coincident": [(0, 0), (1e-12, 0)],
    "no gap": [(0, 0), (0.4, 0)],
    "no gap of depths": [(0, 0), (2 * float(CALIBRATED.walking.depth), 0)],
    "beside": [(0, 0), (0, 0.4)],
    "at the edge of the headway": [(0, 0), (1.0, float(CALIBRATED.headway.width))],
    "on the robot": [(-3, 0), (-3, -3)],
    "before the robot": [(-4, 0.1), (-5, 0)],
}
MOTIONS = {"none": (0.0, 0.0), "dying away": (1e-22, 3e-23), "slow": (1e-13, 0.0), "walking": (1.0, 0.2)}


def test_gradients_are_finite_in_degenerate_cases():
    """Of two steps by places, motions, traits, noise and every constant; also with noise and traits of zero.

    Terms in which people are alike are left out: test_scenario_gradients_swept.py has them.
    """
    alike = social_forces.Walls, social_forces.GroupSpace, social_forces.Cohesion
    usual = social_forces.build([term for term in CALIBRATED if not isinstance(term, alike)])
    robot = Robot(jnp.array([-3.0, 0.0]), jnp.array([1.0, 0.0]), jnp.asarray(0.3), jnp.zeros(()), ())
    start = crowd(np.zeros((2, 2)), np.ones((2, 2)))
    group = jnp.array([-1, -1], jnp.int32)

    def loss(forces, position, velocity, desired, traits, noise):
        people = replace(start, position=position, velocity=velocity, desired_velocity=desired, group=group)
        people = replace(people, traits=Traits(*traits), noise=noise)
        people = jax.tree.map(lambda leaf: leaf[-1], walk(forces, people, robot=robot, steps=2))
        return jnp.sum(people.position * jnp.array([[1.0, 2.0]])) + jnp.sum(people.velocity) + people.heading[0, 1]

    names = [(one, motion, size) for one in DEGENERATE for motion in MOTIONS for size in (0.0, 1.0)]
    x = jnp.asarray([DEGENERATE[one] for one, _, _ in names], float)
    v = jnp.asarray([[MOTIONS[motion]] * 2 for _, motion, _ in names], float)
    size = jnp.asarray([size for _, _, size in names], float)[:, None, None]
    traits, noise = size * jnp.array([[[0.5, -0.7]] * 4]), size * jnp.array([[[0.3, -0.4], [1.0, 0.2]]])
    slope = jax.jit(jax.vmap(jax.grad(loss, tuple(range(6))), (None, 0, 0, 0, 0, 0)))
    gradient = slope(usual, x, v, v[:, ::-1], traits, noise)
    for path, leaf in jax.tree_util.tree_leaves_with_path(gradient):
        bad = ~np.isfinite(np.asarray(leaf)).reshape(len(names), -1).all(1)
        assert not bad.any(), (jax.tree_util.keystr(path), [names[k] for k in np.flatnonzero(bad)])
    for name in DEVIATIONS:
        term, field = name.split(".")
        assert np.abs(getattr(getattr(gradient[0], term), field)).max() > 0.0, name
    assert np.abs(gradient[4]).max() > 1e-3 and np.abs(gradient[5]).max() > 1e-3


# --- crowds ---

SHORT, FEW = 16.0, 24  # m, people: 1.5/m


def single_file(forces) -> float:
    """m/s, the deviation in time of the speeds of people who cannot pass each other, as recordings measure it."""
    (tracks,) = simulate([crowds.in_file(FEW, SHORT, 60.0, 0, 0.2)], model_of(forces))
    x = np.asarray(tracks.position)[300 :: crowds.STEP, :, 0]
    return measures.deviation_in_time(measures.steps_along(x, SHORT) / (crowds.STEP * tracks.time_step))


@pytest.mark.night
def test_people_in_a_single_file_stop_and_go():
    """Recorded deviations are .1 m/s and more; without noise and with people who are all alike there is none."""
    assert single_file("calibrated") > 0.05
    alike = CALIBRATED.tree_replace(dict.fromkeys((*DEVIATIONS, "walking.speed_deviation"), 0.0))
    assert single_file([term for term in alike if not isinstance(term, Noise)]) < 0.01


def across(scenes) -> tuple[np.ndarray, np.ndarray]:
    """Each person's deviation [m] across the corridor in time (S, N), and the mean speeds [m/s] of the scenes (S,)."""
    paths = [np.asarray(tracks.position, float)[200 :: crowds.STEP] for tracks in simulate(scenes, "calibrated")]
    steps = [measures.steps_along(path[..., 0], crowds.PERIOD) for path in paths]
    return np.stack([path[..., 1].std(0) for path in paths]), np.array([step.mean() for step in steps]) / 0.4


@pytest.mark.night
def test_people_in_a_corridor_do_not_crystallise():
    """At 1.5/m2, from random places and from straight rows: people change their place across, and rows dissolve."""
    random, _ = crowds.corridors([crowds.ROWS_DENSITY], 2, 40.0, crowds.hermes_speeds)
    moved, speed = across(random)
    in_rows, speed_of_rows = across([crowds.in_rows(rows, 40.0, 0) for rows in crowds.ROWS])
    assert (np.median(moved, 1) > 0.03).all() and (np.sqrt((moved**2).mean(1)) > 0.07).all()
    assert (np.sqrt((in_rows**2).mean(1)) > 0.07).all()
    np.testing.assert_allclose(speed_of_rows, speed.mean(), rtol=0.2)
    assert np.abs(np.sort(moved[0]) - np.sort(moved[1])).max() > 0.01, "two draws differ"
