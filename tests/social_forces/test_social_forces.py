"""Social forces: against a float64 loop, potentials and closed forms; walls that hold; gradients that are finite."""

import functools
import pickle
import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct
from scipy import stats

import sean_jax
from sean_jax import social_forces
from sean_jax.cli.bench import workload
from sean_jax.core import gpu_kernels
from sean_jax.core.data_types import Groups, Pedestrians, Robot
from sean_jax.core.errors import InputError
from sean_jax.social_forces import Pair, kernel, model, terms
from sean_jax.social_forces.model import move
from support import crowds, float64, programs, trees
from support.checkout import ROOT
from support.forces import STEP, crowd, felt, pair_pushes, scene, walk
from support.quick import quick

PRESETS = list(social_forces.PRESETS)


def clearance(position, boxes) -> np.ndarray:
    """(...,) signed distance to the nearest of the boxes, in float64."""
    center, half, yaw = boxes
    offset = np.asarray(position, float)[..., None, :] - center
    cosine, sine = np.cos(yaw), np.sin(yaw)
    u = cosine * offset[..., 0] + sine * offset[..., 1]
    v = cosine * offset[..., 1] - sine * offset[..., 0]
    over = np.abs(np.stack([u, v], -1)) - half
    outside = np.linalg.norm(np.maximum(over, 0), axis=-1)
    return np.where((over < 0).all(-1), over.max(-1), outside).min(-1)


def constants(name: str, changes: dict[str, Any]) -> social_forces.Forces:
    return social_forces.build(social_forces.preset(name).tree_replace(changes))


def between(dx, dy, wx, wy, vx, vy, radii=0.4, **more) -> Pair:
    return Pair(dx, dy, wx, wy, vx, vy, 1.0, 0.0, radii, **more)


@pytest.mark.parametrize("preset", PRESETS)
def test_step_equals_the_float64_loop(preset):
    """As printed, one person at a time, with code and arithmetic that share nothing with the package."""
    number, walls = 20, 8
    p, state, boxes = float64.crowd(number, walls, preset)
    people, table, _ = workload.crowd(number, walls)
    after = walk(social_forces.preset(preset), people, table, steps=20)
    started = state[0]
    for step in range(20):
        state = float64.step(*state, boxes, p, STEP) + state[3:]
        if step in (0, 19):
            limit = 1e-5 if step == 0 else 1e-3
            for name, theirs in zip(("position", "velocity", "heading"), state[:3], strict=True):
                ours = np.asarray(getattr(after, name)[step])
                assert np.linalg.norm(ours - theirs) <= limit * np.linalg.norm(theirs), (name, step)
    assert np.linalg.norm(state[0] - started, axis=1).mean() > 0.3
    apart = np.linalg.norm(started[:, None] - started, axis=-1) + 9 * np.eye(number)
    assert apart.min() < 2.0 and clearance(state[0], boxes).min() < 1.0  # they had something to feel


@pytest.mark.night
def test_the_forms_for_a_gpu_give_the_same(monkeypatch):
    """Kernels; without them others two by two or four by four, obstacles one by one, bodies in them; derivatives."""
    helbing, calibrated = social_forces.preset("helbing2000"), social_forces.preset("calibrated")
    rubbing = calibrated.tree_replace({"contact.friction": float(helbing.contact.friction)})
    parameters = social_forces.build([*rubbing, helbing.sidestep])
    people, table, _ = workload.crowd(21, 12)
    center = jnp.asarray(workload.boxes(21, 12)[0], jnp.float32)[6]
    people = replace(people, position=people.position.at[0].set(center + 0.1))

    def size(parameters, people):
        x, y = felt(parameters, people)
        return (x * x + y * y).sum()

    def compute(people):
        after = social_forces.integrate(parameters, people, table, None, None, STEP)
        return after, jax.grad(size, (0, 1), allow_int=True)(parameters, people)

    forms = []

    def chosen(*given, cpu, default):
        forms.append(default)
        return default(*given)

    cpu, cpu_slopes = jax.jit(lambda people: compute(people))(people)
    monkeypatch.setattr(jax.lax, "platform_dependent", chosen)
    for call in "_call", "_call_obstacles":
        monkeypatch.setattr(kernel, call, functools.partial(getattr(kernel, call), interpret=True))
    for kernels in (True, False):
        monkeypatch.setattr(gpu_kernels, "available", lambda kernels=kernels: kernels)
        forms.clear()
        gpu, gpu_slopes = jax.jit(lambda people: compute(people))(people)
        assert len(forms) >= 5, "pairs, wall forces, keeping out; pairs and the way back"
        trees.assert_close(gpu, cpu, rtol=1e-5, atol=1e-5)
        for ours, theirs in zip(jax.tree.leaves(gpu_slopes), jax.tree.leaves(cpu_slopes), strict=True):
            if ours.dtype == theirs.dtype == jnp.float32:
                np.testing.assert_allclose(ours, theirs, rtol=1e-3, atol=1e-4 * max(1.0, float(jnp.abs(theirs).max())))


@pytest.mark.parametrize("preset", ["helbing1995", "helbing2000"])
def test_walking_groups_in_a_crush_at_a_wall_equal_the_float64_loop(preset):
    """Eleven people who overlap, two of them in the wall as well: cohesion, contact, friction of bodies and walls."""
    parameters = social_forces.preset(preset)
    walking_groups = [[0, 1], [3, 6, 7], [10, 4]]
    companions = np.full((11, 2), -1, np.int32)
    for walking_group in walking_groups:
        for one in walking_group:
            others = [other for other in walking_group if other != one]
            companions[one, : len(others)] = others
    random = np.random.default_rng(4)
    x = np.stack(np.meshgrid(np.arange(4), np.arange(3)), -1).reshape(-1, 2)[:11] * 0.37
    x = x + random.uniform(-0.02, 0.02, x.shape)
    desired = np.array([0.6, -1.0]) + random.normal(size=x.shape) * 0.3
    walking_group = np.array([next((min(one) for one in walking_groups if k in one), -1) for k in range(11)], np.int32)
    people = crowd(x, desired, random.normal(size=x.shape), np.full(11, 1.3), walking_group=walking_group)
    table, boxes = scene((0.5, -0.68, 2.0, 0.5, 3.0))
    state = tuple(np.asarray(part, float) for part in vars(people).values())[:4]
    state = state[0], state[1], state[2], state[3], np.full(11, 1.3)
    p = float64.constants(parameters)
    one = jax.jit(
        lambda people: social_forces.integrate(parameters, people, table, None, None, 0.01, companions=companions)
    )
    for step in range(10):
        people = one(people)
        state = float64.step(*state, boxes, p, 0.01, walking_groups) + state[3:]
        limit = 1e-5 if step == 0 else 2e-4
        for name, theirs in zip(("position", "velocity", "heading"), state[:3], strict=True):
            ours = np.asarray(getattr(people, name))
            assert np.linalg.norm(ours - theirs) <= limit * np.linalg.norm(theirs), (name, step)
    apart = np.linalg.norm(x[:, None] - x, axis=-1) + 9 * np.eye(11)
    assert apart.min() < 0.37 and clearance(x, boxes).min() < 0.19


@pytest.mark.parametrize("own_motion", [0.0, 1.0])
def test_elliptical_repulsion_is_the_gradient_of_its_potential(own_motion):
    """V(b) = A B exp(-b / B), 2 b = sqrt((|d| + |d - y|)^2 - |y|^2): eq. (3) and (4) of Helbing & Molnar (1995)."""
    strength, reach_of, ahead = 7.0, 0.3, 2.0
    random = np.random.default_rng(0)
    d, w, v = random.normal(size=(3, 200, 2)) * [[[0.8]], [[0.7]], [[0.7]]]
    y = (w - own_motion * v) * ahead

    def potential(d):
        far = np.linalg.norm(d, axis=-1) + np.linalg.norm(d - y, axis=-1)
        b = 0.5 * np.sqrt(far**2 - (y**2).sum(-1))
        return strength * reach_of * np.exp(-b / reach_of)

    change = 1e-5
    numeric = -np.stack([(potential(d + e) - potential(d - e)) / (2 * change) for e in change * np.eye(2)], -1)
    with jax.enable_x64(True):
        p = SimpleNamespace(strength=strength, range=reach_of, reach=0.0, anticipation=ahead, own_motion=own_motion)
        parts = [jnp.asarray(part) for vectors in (d, w, v) for part in vectors.T]
        ours = np.stack(jax.jit(lambda *parts: terms.elliptical(p, between(*parts)))(*parts), -1)
    cross = np.abs(d[:, 0] * y[:, 1] - d[:, 1] * y[:, 0])
    smooth = cross >= 1e-2 * np.linalg.norm(y, axis=1)  # on the other's way b has a kink
    np.testing.assert_allclose(ours[smooth], numeric[smooth], rtol=1e-4, atol=1e-6)
    assert smooth.sum() > 150 and np.abs(numeric).max() > 1.0


def test_members_of_one_group_do_not_push_one_another_apart_from_contact():
    people = crowd([(0, 0), (0.6, 0), (0, 0.7)], np.zeros((3, 2)), group=np.array([1, 1, 2], np.int32))
    forces = np.asarray(pair_pushes(social_forces.preset("helbing1995"), people))
    only_third = crowd([(0, 0), (0, 0.7)], np.zeros((2, 2)))
    pair = np.asarray(pair_pushes(social_forces.preset("helbing1995"), only_third))
    np.testing.assert_allclose(forces[0], pair[0], rtol=1e-5, atol=1e-6)
    assert forces[2, 1] > 0.5
    strangers = replace(people, group=jnp.full(3, -1, jnp.int32))
    assert pair_pushes(social_forces.preset("helbing1995"), strangers)[0, 0] < -0.5
    overlapping = crowd([(0, 0), (0.3, 0)], np.zeros((2, 2)), group=np.array([1, 1], np.int32))
    forces = pair_pushes(social_forces.preset("helbing1995"), overlapping)
    np.testing.assert_allclose(forces, [[-200.0 * 0.1, 0.0], [200.0 * 0.1, 0.0]], rtol=1e-4)


def test_one_walker_takes_up_the_preferred_speed():
    """v = v0 (1 - (1 - dt / tau)^n), the discrete form of v0 (1 - exp(-t / tau))."""
    people = crowd([(0.0, 0.0)], [(0.8, -1.0)], [(0.0, 0.0)])
    after = walk(social_forces.preset("helbing1995"), people, steps=200)
    speed = np.linalg.norm(after.velocity[:, 0], axis=1)
    wanted = np.hypot(0.8, 1.0)
    np.testing.assert_allclose(speed, wanted * (1 - (1 - STEP / 0.5) ** np.arange(1, 201)), rtol=1e-5)
    np.testing.assert_allclose(after.position[-1, 0], np.asarray(after.velocity[:, 0], float).sum(0) * STEP, rtol=1e-5)
    assert speed[-1] == pytest.approx(wanted, rel=1e-6)


def test_speed_and_turning_are_limited():
    people = crowd([(0.0, 0.0)], [(-3.0, 0.1)], [(2.0, 0.0)], preferred=[1.0])
    people = replace(people, heading=jnp.array([[1.0, 0.0]]))
    for preset, ratio, rate in (("helbing1995", 1.3, 2 * np.pi), ("sean2", 1.0, np.deg2rad(120))):
        after = walk(social_forces.preset(preset), people, steps=40)
        assert np.linalg.norm(after.velocity, axis=-1).max() <= ratio * 1.00001
        angle = np.unwrap(np.arctan2(after.heading[:, 0, 1], after.heading[:, 0, 0]))
        assert np.abs(np.diff(angle)).max() == pytest.approx(rate * STEP, rel=1e-3)
        np.testing.assert_allclose(np.linalg.norm(after.heading, axis=-1), 1.0, atol=1e-5)
        assert angle[-1] == pytest.approx(np.pi, abs=0.05)


L_CORRIDOR = [  # 2 m wide: from (-9, 0) to (0, 0), and on to (0, 9)
    (-4, -1.1, 6, 0.1, 0),
    (1.1, 4, 0.1, 5.2, 0),
    (-5.5, 1.1, 4.5, 0.1, 0),
    (-1.1, 5.5, 0.1, 4.5, 0),
    (-9.5, 0, 0.1, 1.2, 0),
]


@pytest.mark.parametrize(("preset", "changes"), [
    ("helbing1995", {}), ("helbing1995", {"walls.strength": 0.0}), ("sean2", {})
])  # fmt: skip
def test_twenty_people_round_a_corner_stay_in_the_corridor(preset, changes):
    """RiMEA test 6 and NIST verification 2.3, also where nothing but the guarantee keeps people off the walls."""
    parameters = constants(preset, changes)
    table, boxes = scene(*L_CORRIDOR)
    random = np.random.default_rng(1)
    x = np.stack(np.meshgrid(np.linspace(-8.5, -1.5, 10), [-0.4, 0.4]), -1).reshape(-1, 2)
    x = x + random.uniform(-0.1, 0.1, x.shape)
    speed = np.full(20, 0.6) if preset == "sean2" else random.uniform(1.0, 1.6, 20)

    @jax.jit
    def run(people):
        def one(people, _):
            turned = people.position[:, 0] > -0.6
            aim = jnp.where(turned[:, None], jnp.array([[0.0, 8.0]]), jnp.array([[0.0, 0.0]])) - people.position
            way = aim / jnp.linalg.norm(aim, axis=1, keepdims=True)
            people = replace(people, desired_velocity=way * people.preferred_speed[:, None])
            people = social_forces.integrate(parameters, people, table, None, None, STEP)
            return people, people.position

        return jax.lax.scan(one, people, length=400)[1]

    path = np.asarray(run(crowd(x, speed[:, None] * np.array([[1.0, 0.0]]))))
    assert clearance(path, boxes).min() > 0.2 - 0.001
    inside = (path[..., 0] < 1) & (path[..., 1] > -1)
    assert (inside | (path[..., 1] > 9.2)).all()  # where it ends, people may leave it to the side
    rounded = (path[-1, :, 1] > 1.5).sum()
    assert rounded >= (10 if preset == "helbing1995" else 3)


@pytest.mark.parametrize("wall_strength", [50.0, 0.0])
def test_fast_walkers_stop_at_walls_and_in_corners(wall_strength):
    """2.8 m/s straight into 0.2 m of wall, into an inner corner, and into wedges of 60 and 30 degrees."""
    parameters = constants("helbing1995", {"walls.strength": wall_strength})
    cases = [
        ([(2, 0, 0.1, 3, 0)], (0, 0), (2.8, 0)),
        ([(2, 0, 0.1, 3, 0), (0, 2, 3, 0.1, 0)], (0, 0), (1.98, 1.98)),
        ([(0, 2, 5, 0.5, -30), (0, -2, 5, 0.5, 30)], (-1, 0), (2.8, 0)),
        ([(0, 1, 5, 0.5, -15), (0, -1, 5, 0.5, 15)], (-3, 0), (2.8, 0)),
        ([(2, 1, 0.1, 1, 0), (2, -1, 0.1, 1, 0), (2, 3, 0.1, 1, 0)], (0, 0.01), (2.8, 0)),
    ]
    for boxes, start, velocity in cases:
        boxes = boxes + [(9.0, 9.0, 0.1, 0.1, 0.0)] * (3 - len(boxes))
        table, exact_boxes = scene(*boxes)
        rows = jnp.pad(table.rows, ((0, 0), (0, 0), (0, 3 - table.rows.shape[2]), (0, 0)), mode="edge")
        after = walk(parameters, crowd([start], [velocity]), replace(table, rows=rows), steps=100)
        gap = clearance(after.position[:, 0], exact_boxes) - 0.2
        assert gap.min() > -0.001, boxes
        drift = np.linalg.norm(np.asarray(after.position[-1, 0] - after.position[-21, 0]))  # m in the last second
        assert gap[-1] < 0.4 and drift < 0.2, boxes  # they got there, and stand
        assert np.asarray(after.position[-1, 0, 0]) < 2.1


def test_a_wall_lets_people_walk_along_it():
    """Pressed against it at a slant, on one box and across the joint of two, without a wall force."""
    parameters = constants("helbing1995", {"walls.strength": 0.0})
    table, boxes = scene((-4, 1, 4, 0.5, 0), (4, 1, 4, 0.5, 0))
    after = walk(parameters, crowd([(-6.0, 0.3)], [(1.0, 0.4)]), table, steps=200)
    assert clearance(after.position, boxes).min() > 0.2 - 0.001
    np.testing.assert_allclose(after.velocity[20:, 0, 0], 1.0, atol=0.05)  # at the joint, its corner is felt


def test_who_starts_inside_an_obstacle_is_led_out():
    table, boxes = scene((0, 0, 1, 1, 20))
    after = walk(social_forces.preset("helbing1995"), crowd([(0.8, 0.1)], [(-1.0, 0.0)]), table, steps=40)
    assert clearance(after.position[-1], boxes)[0] > 0.199
    assert np.isfinite(after.position).all()


@pytest.mark.parametrize("preset", PRESETS)
def test_head_on_people_pass_on_the_preferred_side(preset):
    people = crowd([(-3.0, 0.0), (3.0, 0.0)], [(1.2, 0.0), (-1.2, 0.0)])
    side = "evasion.side" if preset == "calibrated" else "sidestep.preference"
    for preference in (0.6, -0.6):
        parameters = constants(preset, {side: preference, "walking.perception": 10.0})
        after = walk(parameters, people, steps=200)
        x, y = np.asarray(after.position[..., 0]), np.asarray(after.position[..., 1])
        met = np.argmax(x[:, 0] > x[:, 1])
        assert x[-1, 0] > x[-1, 1], "they have passed"
        right = y[met, 0] < y[met, 1]  # the one who walks along +x has the right hand at -y
        assert right == (preference > 0)
        assert np.linalg.norm(after.position[:, 0] - after.position[:, 1], axis=1).min() > 0.3
    term, name = side.split(".")
    assert (float(getattr(getattr(social_forces.preset(preset), term), name)) < 0) == (preset == "sean2")


def test_absent_people_push_nobody_and_stay():
    parameters = social_forces.preset("helbing1995")
    x, desired = [(0, 0), (0.5, 0.1), (0.5, 0.1), (2.0, 0.0)], [(1.0, 0), (-1.0, 0), (-1.0, 0), (-1.2, 0)]
    present = np.array([True, False, False, True])
    many = walk(parameters, crowd(x, desired, present=present), steps=30)
    moved = crowd([x[0], (40, 40), (-40, 40), x[3]], desired, present=present)
    np.testing.assert_allclose(many.position[:, [0, 3]], walk(parameters, moved, steps=30).position[:, [0, 3]])
    np.testing.assert_array_equal(many.position[-1, 1], np.float32([0.5, 0.1]))
    np.testing.assert_array_equal(many.velocity[-1, 1], 0.0)
    there = walk(parameters, crowd(x, desired), steps=30)
    assert np.abs(there.position[-1, 0] - many.position[-1, 0]).max() > 0.05


def test_jit_traces_once_and_types_are_strong():
    @programs.jit_once
    def once(people, table, groups, robot):
        return social_forces.integrate(social_forces.preset("sean2"), people, table, groups, robot, STEP, 0.16)

    table, _ = scene((0, 3, 1, 1, 0))
    groups = Groups(jnp.zeros((1, 2)), jnp.ones(1), jnp.zeros((1, 2)), jnp.ones(1, bool))
    robot = Robot(jnp.ones(2), jnp.array([1.0, 0.0]), jnp.zeros(()), jnp.zeros(()), ())
    people = crowd([(0, 0), (1, 1)], [(1, 0), (0, 1)])
    for _ in range(3):
        people = once(people, table, groups, robot)
    assert not any(leaf.weak_type for leaf in jax.tree.leaves(people))


def test_vmap_equals_a_loop():
    parameters = social_forces.preset("helbing1995")
    table, _ = scene((0, 1.5, 1, 0.3, 10), (0, -1.5, 1, 0.3, -10))
    random = np.random.default_rng(2)
    crowds = [crowd(random.uniform(-2, 2, (4, 2)), random.normal(size=(4, 2))) for _ in range(5)]
    together = jax.tree.map(lambda *leaves: np.stack(leaves), *crowds)
    batch = jax.jit(jax.vmap(lambda people: walk(parameters, people, table, steps=5)))(together)
    for k, people in enumerate(crowds):
        alone = walk(parameters, people, table, steps=5)
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b[k], atol=1e-5), alone, batch)  # noqa: B023


BOX = (0.0, 2.0, 1.0, 0.5, 0.0)  # its lower face is y = 1.5
DEGENERATE = {
    "apart": [(0, 0), (2, 0)],
    "coincident": [(0, 0), (0, 0)],
    "nearly coincident": [(0, 0), (1e-12, 0)],
    "on a wall": [(0, 1.5), (0, 1.3)],
    "on a corner": [(1, 1.5), (-1, 1.5)],
    "inside a wall": [(0, 2.0), (0.3, 1.9)],
    "on the robot and in the middle of a group": [(-3, 0), (-3, -3)],
}
SPEEDS = {"zero": (0.0, 0.0), "dying away": (1e-22, 3e-23), "slow": (1e-13, 0.0), "walking": (1.0, 0.2)}


# The quick tests of gradients try random and degenerate states of every preset elsewhere (test_gradients_swept.py).
COMPANIONS = {"alone": None, "together": [[1, -1], [0, -1]], "with who is absent": [[1, 2], [0, 2], [0, 1]]}


@pytest.mark.night
@pytest.mark.parametrize(
    ("preset", "companions"),
    [("helbing2000", name) for name in COMPANIONS],
)
def test_gradients_are_finite_in_degenerate_cases(preset, companions):
    """Of two steps, with respect to positions, velocities, wishes and every constant."""
    walks_with = None if COMPANIONS[companions] is None else jnp.array(COMPANIONS[companions], jnp.int32)
    absent = 1 if companions == "with who is absent" else 0
    table, _ = scene(BOX)
    robot = Robot(jnp.array([-3.0, 0.0]), jnp.array([1.0, 0.0]), jnp.asarray(0.3), jnp.zeros(()), ())
    groups = Groups(jnp.array([[-3.0, -3.0]]), jnp.ones(1), jnp.zeros((1, 2)), jnp.ones(1, bool))

    def loss(parameters, position, velocity, desired, heading):
        present = np.arange(2 + absent) < 2 - absent
        people = crowd(np.zeros((2 + absent, 2)), np.ones((2 + absent, 2)), present=present)
        fill = jnp.zeros((absent, 2))
        position, velocity, desired, heading = (
            jnp.concatenate([part, fill]) for part in (position, velocity, desired, heading)
        )
        people = replace(people, position=position, velocity=velocity, desired_velocity=desired, heading=heading)
        if walks_with is not None:
            people = replace(people, walking_group=jnp.zeros(2 + absent, jnp.int32))
        people = jax.tree.map(
            lambda leaf: leaf[-1], walk(parameters, people, table, groups, robot, walks_with, steps=2)
        )
        return jnp.sum(people.position * jnp.array([[1.0, 2.0]])) + jnp.sum(people.velocity) + people.heading[0, 1]

    cases = [(np.array(x), np.array([v, v])) for x in DEGENERATE.values() for v in SPEEDS.values()]
    x, v = (jnp.asarray(np.stack(part), jnp.float32) for part in zip(*cases, strict=True))
    heading = jnp.broadcast_to(jnp.array([0.6, 0.8]), x.shape)
    slope = jax.jit(jax.vmap(jax.grad(loss, (0, 1, 2, 3)), (None, 0, 0, 0, None)))
    gradient = slope(social_forces.preset(preset), x, v, v[:, ::-1], heading[0])
    names = [f"{one}, {speed}" for one in DEGENERATE for speed in SPEEDS]
    for path, leaf in jax.tree_util.tree_leaves_with_path(gradient):
        bad = ~np.isfinite(np.asarray(leaf)).reshape(len(names), -1).all(1)
        assert not bad.any(), (jax.tree_util.keystr(path), [names[k] for k in np.flatnonzero(bad)])
    assert np.abs(gradient[1]).max() > 0.1


@pytest.mark.parametrize("term", ["headway", "evasion"])
def test_a_ramp_without_length_is_a_switch_and_a_width_of_zero_nobody(term):
    """On random crowds, in which some stand exactly beside others, where a division by the ramp has no value."""
    draw, usual = np.random.default_rng(0), social_forces.preset("calibrated")
    place, desired = draw.uniform(0.0, 4.0, (16, 20, 2)), draw.normal(0.0, 1.0, (16, 20, 2))
    desired[:, :4], place[:, 1] = [1.0, 0.0], place[:, 0] + [0.0, 0.6]
    crowds = [crowd(each, wanted, velocity=wanted) for each, wanted in zip(place, desired, strict=True)]
    people = jax.tree.map(lambda *leaves: np.stack(leaves), *crowds)

    def pushed(forces):
        return jax.vmap(lambda one: jnp.stack(felt(forces, one), -1))(people)

    @jax.jit
    @functools.partial(jax.grad, argnums=(0, 1), has_aux=True)
    def slopes(ramp, width):
        pushes = pushed(usual.tree_replace({f"{term}.ramp": ramp, f"{term}.width": width}))
        return jnp.sum(jnp.sin(pushes)), pushes

    width = float(getattr(usual, term).width)
    (slope, switch), (_, steep), (slope_of_none, none) = (
        slopes(*both) for both in ((0.0, width), (1e-4, width), (0.1, 0.0))
    )
    np.testing.assert_allclose(switch, steep, rtol=1e-5, atol=1e-5)
    without = social_forces.build([each for each in usual if each is not getattr(usual, term)])
    missing = jax.jit(pushed)(without)
    np.testing.assert_allclose(none, missing, rtol=1e-4, atol=1e-4)
    assert np.abs(switch - missing).max() > 0.1
    assert np.isfinite([*slope, *slope_of_none]).all()


def test_one_person_alone_and_gradients_without_obstacles():
    people = crowd([(0.0, 0.0)], [(0.0, 0.0)])
    parameters = social_forces.preset("helbing1995")
    slope = jax.jit(jax.grad(lambda x: walk(parameters, replace(people, position=x)).position.sum()))
    np.testing.assert_allclose(slope(people.position), 1.0)
    none = crowd(np.zeros((0, 2)), np.zeros((0, 2)))
    assert walk(social_forces.preset("helbing1995"), none).position.shape == (1, 0, 2)


def test_move_takes_substeps_of_at_most_a_twentieth_of_a_second():
    people = crowd([(0, 0), (1, 0.2)], [(1.0, 0), (-1.0, 0)])
    parameters = alone(Magnet(0.8, 2.0))
    state: Any = SimpleNamespace(pedestrians=people, groups=None, robot=None)
    for time_step, substeps in ((0.1, 2), (0.05, 1), (0.02, 1), (0.07, 2)):
        assert social_forces.substeps(parameters, time_step) == substeps
    for time_step, substeps in ((STEP, 1), (2 * STEP, 2)):
        scenario: Any = SimpleNamespace(
            time_step=time_step, forces=parameters, environment=SimpleNamespace(obstacle_grid=None), substeps=substeps,
            robot=SimpleNamespace(radius=0.16), behavior=SimpleNamespace(companions=None),
        )  # fmt: skip
        by_hand = walk(parameters, people, steps=2).position[substeps - 1]
        moved = jax.jit(lambda scenario=scenario: move(scenario, state))()
        np.testing.assert_allclose(moved.position, by_hand, atol=1e-6)


def test_traits_are_drawn_as_told():
    number = 40_000
    draw = jax.jit(social_forces.draw_traits, static_argnums=2)
    speed, extra = (
        np.asarray(part, float) for part in draw(social_forces.preset("helbing1995"), jax.random.key(0), number)
    )
    expected = stats.truncnorm((0.5 - 1.34) / 0.26, (2.2 - 1.34) / 0.26, 1.34, 0.26)
    assert speed.mean() == pytest.approx(1.34, abs=5 * 0.26 / np.sqrt(number))
    assert speed.std() == pytest.approx(0.26, rel=0.02)
    assert speed.min() >= 0.5 and speed.max() <= 2.2
    assert stats.kstest(speed, expected.cdf).pvalue > 1e-3
    factor = np.exp(extra / 0.3)
    assert factor.min() >= 0.999 and factor.max() <= 8.001
    assert stats.kstest(factor, stats.uniform(1, 7).cdf).pvalue > 1e-3
    assert abs(np.corrcoef(speed, extra)[0, 1]) < 0.02
    narrow = constants("helbing1995", {"walking.speed_min": 1.2, "walking.speed_max": 1.4})
    speed = np.asarray(draw(narrow, jax.random.key(1), number))
    assert 1.2 <= speed[0].min() < 1.201 and 1.399 < speed[0].max() <= 1.4


def test_sean2_draws_one_speed_and_shorter_robot_distances():
    speed, extra = social_forces.draw_traits(social_forces.preset("sean2"), jax.random.key(2), 2000)
    np.testing.assert_array_equal(speed, np.float32(0.6))
    least = 0.16 * np.log(0.5)
    assert least - 1e-6 <= float(extra.min()) < 0.95 * least and -0.01 < float(extra.max()) <= 0.0


def test_presets_have_their_published_constants():
    helbing, sean = social_forces.preset("helbing1995"), social_forces.preset("sean2")
    assert float(helbing.repulsion.strength * helbing.repulsion.range) == pytest.approx(2.1)  # V0 m2/s2
    assert float(helbing.walls.strength * helbing.walls.range) == pytest.approx(10.0)  # U0 m2/s2
    assert float(sean.repulsion.strength) == pytest.approx(6.25) and float(sean.walls.strength) == pytest.approx(100.0)
    with pytest.raises(ValueError, match="did you mean 'helbing1995'"):
        social_forces.preset("helbing1996")
    for name in PRESETS:
        assert all(
            leaf.dtype == jnp.float32 and leaf.shape == () for leaf in jax.tree.leaves(social_forces.preset(name))
        )


def packed(overlap: float) -> tuple[Pedestrians, int]:
    """Thirty-seven bodies of 0.2 m in the densest packing, and how many they are."""
    rows = [(q, r) for q in range(-3, 4) for r in range(-3, 4) if abs(q + r) <= 3]
    x = np.array([(q + r / 2, r * np.sqrt(3) / 2) for q, r in rows]) * (0.4 - overlap)
    people = crowd(x, np.zeros((len(x), 2)), preferred=np.full(len(x), 9.0))
    return people, len(x)


@pytest.mark.parametrize(("preset", "overlaps"), [("helbing1995", [1e-4]), ("helbing2000", [1e-4, 0.01])])
def test_touching_bodies_are_stable_up_to_the_longest_step(preset, overlaps):
    """Eigenvalues of one step, linearised: an error that changes sign and grows at each step has one below -1."""
    changes = {"walking.speed_ratio": 100.0, "walking.relaxation_time": 100.0}
    usual = constants(preset, changes)
    parameters = social_forces.build([usual.walking, usual.contact])
    (people, number), longest = packed(0.0), social_forces.longest_step(usual)

    @jax.jit
    @jax.jacfwd
    def step(state, length):
        moved = replace(people, position=state[0], velocity=state[1])
        after = social_forces.integrate(parameters, moved, None, None, None, length)
        return jnp.stack([after.position, after.velocity])

    def least(overlap, length):
        people = packed(overlap)[0]
        state = np.stack([people.position, people.velocity])
        matrix = np.asarray(step(state, length), float).reshape(4 * number, 4 * number)
        return np.linalg.eigvals(matrix).real.min()

    for overlap in overlaps:
        assert least(overlap, longest) > -1.0
        assert least(overlap, 2.0 * (2.0 / np.sqrt(6 * float(parameters.contact.stiffness)))) < -1.0


def test_friction_of_a_wall_takes_its_share_of_the_speed_along_it():
    """Pressed with 1 m/s2 for a step of 0.05 s: along the wall 1 / (1 + kappa / k * 0.05 m/s) is left of the speed."""
    table, _ = scene((0, 1, 4, 0.5, 0))
    people = crowd([(0.0, 0.3)], [(1.0, 0.1)], velocity=[(1.0, 0.0)], preferred=[1.0])
    people = replace(people, desired_velocity=jnp.array([[1.0, 0.5]]))
    for friction, left in ((None, 1.0), (0.0, 1.0), (400.0, 1 / (1 + 2.0 * 0.05))):
        usual = constants("helbing1995", {"contact.friction": friction})
        after = walk(social_forces.build([usual.walking, usual.contact]), people, table)
        np.testing.assert_allclose(after.velocity[0, 0], [left, 0.0], atol=1e-5)


def test_what_is_off_is_not_computed():
    people = crowd([(0, 0), (1, 1), (2, 0)], np.ones((3, 2)))

    def size(parameters, companions):
        program = jax.make_jaxpr(lambda p: social_forces.integrate(p, people, None, None, None, STEP, 0.0, companions))
        return str(program(parameters)).count("\n")

    usual = social_forces.preset("helbing1995")
    plain = social_forces.build([usual.walking, usual.contact, usual.cohesion])
    rubbing = plain.tree_replace({"contact.friction": 0.0})
    together = jnp.array([[1, -1], [0, -1], [-1, -1]], jnp.int32)
    assert size(plain, None) < size(rubbing, None) and size(plain, None) < size(plain, together)
    after = [walk(parameters, people, steps=3) for parameters in (plain, rubbing)]
    np.testing.assert_allclose(after[0].position, after[1].position, atol=1e-6)


# --- terms of one's own ---


@struct.dataclass
class Wind:
    """The same acceleration of everybody."""

    x: jax.Array  # m/s2
    y: jax.Array

    def person(self, crowd):
        return jnp.broadcast_to(self.x, crowd.look_x.shape), jnp.broadcast_to(self.y, crowd.look_y.shape)


@struct.dataclass
class Magnet:
    """A pull between people that ends linearly at a distance; not between people and the robot."""

    strength: jax.Array  # m/s2
    distance: jax.Array  # m

    def pair(self, pair):
        if pair.is_robot:
            return jnp.zeros_like(pair.dx), jnp.zeros_like(pair.dx)
        apart = jnp.sqrt(pair.dx * pair.dx + pair.dy * pair.dy + 1e-6)
        size = -self.strength * jnp.maximum(1.0 - apart / self.distance, 0.0) / apart
        return size * pair.dx, size * pair.dy


@struct.dataclass
class NearMagnet(Magnet):
    """The same, which says how far it reaches."""

    def cutoff(self, walking):
        return self.distance


def alone(*terms) -> social_forces.Forces:
    """People whom nothing but these terms accelerates."""
    walking = social_forces.preset("helbing1995").walking
    return social_forces.build([walking.replace(relaxation_time=1e9), *terms])


def test_a_persons_term_of_ones_own_adds_its_acceleration():
    people = crowd([(0.0, 0.0), (1.0, 0.5)], [(0.5, 0.0), (0.0, -0.4)], preferred=[2.0, 2.0])
    after = walk(alone(Wind(0.3, -0.2)), people).velocity[0]
    np.testing.assert_allclose(after - people.velocity, [[0.3 * STEP, -0.2 * STEP]] * 2, rtol=1e-4)
    usual = social_forces.preset("helbing1995")
    both = social_forces.build([*usual, Wind(0.3, -0.2)])
    change = walk(both, people).velocity[0] - walk(usual, people).velocity[0]
    np.testing.assert_allclose(change, [[0.3 * STEP, -0.2 * STEP]] * 2, rtol=1e-3)
    assert both.wind.x == jnp.float32(0.3) and len(both) == len(usual) + 1


def test_a_pair_term_of_ones_own_acts_between_people_and_may_leave_the_robot_out():
    people = crowd([(0.0, 0.0), (1.0, 0.0), (9.0, 0.0)], np.zeros((3, 2)), preferred=np.ones(3))
    forces, push = alone(Magnet(0.8, 2.0)), 0.8 * (1 - 1.0 / 2.0) * STEP
    after = walk(forces, people)
    np.testing.assert_allclose(after.velocity[0], [[push, 0.0], [-push, 0.0], [0.0, 0.0]], rtol=1e-4, atol=1e-7)
    robot = Robot(jnp.array([0.0, 0.7]), jnp.array([1.0, 0.0]), jnp.zeros(()), jnp.zeros(()), ())
    minds = social_forces.preset("helbing1995")
    there, without = (
        walk(social_forces.build(terms), people, robot=robot).velocity
        for terms in ([*forces, minds.robot_repulsion], forces)
    )
    np.testing.assert_array_equal(there, without)
    push = social_forces.build([*forces, minds.contact, minds.repulsion, minds.robot_repulsion])
    assert walk(push, people, robot=robot).velocity[0, 0, 1] < -0.01


def test_terms_of_ones_own_differentiate_and_batch():
    """Gradients by every parameter equal central differences; a row of a batch does not depend on the others."""
    random = np.random.default_rng(5)
    people = crowd(random.uniform(-2, 2, (6, 2)), random.normal(size=(6, 2)))
    usual = social_forces.preset("johansson2007")
    forces = social_forces.build([usual.walking, usual.repulsion, Wind(0.1, 0.2), Magnet(0.5, 3.0)])
    names, place = ("wind.x", "magnet.strength", "magnet.distance"), np.array([0.1, 0.5, 3.0], np.float32)

    @jax.jit
    @jax.vmap
    @jax.value_and_grad
    def far(values):
        changed = forces.tree_replace(dict(zip(names, values, strict=True)))
        return jnp.sum(walk(changed, people, steps=10).position[-1] * jnp.arange(12.0).reshape(6, 2))

    changes = 1e-2 * np.eye(3, dtype=np.float32)
    batch = np.concatenate([[place], place + changes, place - changes, [2 * place, place / 2]])
    value, slope = map(np.asarray, far(batch))
    np.testing.assert_allclose(slope[0], (value[1:4] - value[4:7]) / 2e-2, rtol=3e-2, atol=5e-3)
    assert np.abs(slope[0]).min() > 1e-2 and np.isfinite(slope).all()
    np.testing.assert_allclose(far(batch[::-1])[0][::-1], value, rtol=1e-5)


def test_large_crowds_sum_a_term_of_ones_own_over_all_pairs_unless_it_has_a_cutoff():
    people, _, _ = workload.crowd(300, 0)
    usual = social_forces.preset("helbing1995")
    assert model.cutoff(social_forces.build([*usual, Magnet(0.5, 3.0)])) is None
    near = social_forces.build([*usual, NearMagnet(0.5, 3.0)])
    assert model.cutoff(near) == model.cutoff(usual)
    assert float(model.cutoff(near.tree_replace({"near_magnet.distance": 50.0}))) == 50.0

    def slopes(forces):
        velocity = walk(forces, people).velocity
        return jnp.sin(velocity).sum(), velocity

    # Two programs: to jax's cache the trees of a class and of its subclass are equal.
    near, every = alone(NearMagnet(0.5, 3.0)), alone(Magnet(0.5, 3.0))
    by_near, ours = jax.jit(jax.grad(lambda forces: slopes(forces), has_aux=True))(near)
    by_every, exact = jax.jit(jax.grad(lambda forces: slopes(forces), has_aux=True))(every)
    np.testing.assert_allclose(ours, exact, atol=2e-3)
    strength = float(by_near.near_magnet.strength), float(by_every.magnet.strength)
    assert strength[0] == pytest.approx(strength[1], rel=1e-2) and abs(strength[0]) > 1e-4


def test_a_term_that_is_left_out_is_not_felt():
    """Without the term of the robot, of walls, of groups: as if they were not there, but nobody enters a wall."""
    people = crowd([(0.0, 1.0), (0.6, 0.0)], [(0.3, 0.0), (-0.3, 0.0)])
    table, boxes = scene(BOX)
    groups = Groups(jnp.array([[0.3, 0.8]]), jnp.ones(1), jnp.zeros((1, 2)), jnp.ones(1, bool))
    robot = Robot(jnp.array([0.5, 0.7]), jnp.array([1.0, 0.0]), jnp.asarray(0.3), jnp.zeros(()), ())
    minds = social_forces.preset("helbing1995")
    usual = [minds.walking, minds.repulsion, minds.robot_repulsion, minds.group_space, minds.walls]

    def after(left_out, table, groups, robot):
        forces = social_forces.build([term for term in usual if not isinstance(term, left_out)])
        return walk(forces, people, table, groups, robot).velocity

    felt_all = after((), table, groups, robot)
    for kind, given in {
        social_forces.RobotRepulsion: (table, groups, None),
        social_forces.GroupSpace: (table, None, robot),
        social_forces.Walls: (None, groups, robot),
    }.items():
        left_out = after(kind, table, groups, robot)
        np.testing.assert_allclose(left_out, after((), *given), atol=1e-6)
        assert np.abs(left_out - felt_all).max() > 1e-3
    wild = crowd([(0.0, 1.0)], [(0.0, 2.0)])
    path = walk(alone(), wild, table, steps=40).position
    assert clearance(path, boxes).min() > 0.2 - 0.001


@pytest.mark.parametrize(("terms", "message"), [
    ([], "no Walking term"),
    ([Wind(0.1, 0.2)], "no Walking term"),
    (Wind(0.1, 0.2), "a list of terms"),
    (7.0, "a list of terms"),
    (["helbing1995"], "'helbing1995' is no term"),
    ([*social_forces.PRESETS["sean2"], Wind], "is no term"),
    ([*social_forces.PRESETS["sean2"], lambda crowd: None], "is no term"),
    ([*social_forces.PRESETS["sean2"], *social_forces.PRESETS["helbing1995"]], "'walking' stands twice"),
    ([*social_forces.PRESETS["sean2"], Wind(0.1, float("nan"))], r"forces.wind.y: nan must be finite"),
    ([*social_forces.PRESETS["sean2"], SimpleNamespace(person=lambda crowd: None)], "flax.struct.dataclass"),
])  # fmt: skip
def test_what_makes_no_forces_is_refused_in_one_sentence(terms, message):
    with pytest.raises(ValueError, match=message) as caught:
        social_forces.build(terms)
    assert str(caught.value).startswith("forces") and "\n" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("preset", quick(["calibrated", "helbing1995", "helbing2000"], "calibrated", "helbing2000"))
def test_what_lies_within_the_limits_of_a_parameter_moves_people_by_finite_numbers(preset):
    """Each parameter at its least, its greatest and between, the others as they are, in a crowd."""
    usual, draw = social_forces.PRESETS[preset], np.random.default_rng(0)
    varied, names = [], []
    for term in usual:
        for field, (low, high) in getattr(term, "limits", {}).items():
            if getattr(term, field) is None:
                continue
            between = [low + (high - low) * 10.0 ** -draw.uniform(0, 6) for _ in range(6)]
            for value in (low, high, *between):
                name = f"{social_forces.forces.term_name(term)}.{field}"
                try:
                    varied.append(constants(preset, {name: value}))
                    names.append(f"{name} = {value:g}")
                except InputError as error:  # two that do not go together
                    assert "change one of the two" in str(error)
    assert len(varied) > 100
    table, _ = scene((0, 3, 1, 1, 0))
    groups = Groups(jnp.array([[0.3, 0.8]]), jnp.ones(1), jnp.zeros((1, 2)), jnp.ones(1, bool))
    robot = Robot(jnp.array([0.5, 0.7]), jnp.array([1.0, 0.0]), jnp.asarray(0.3), jnp.zeros(()), ())
    companions = jnp.full((12, 2), -1, jnp.int32).at[:2, 0].set(jnp.array([1, 0]))
    people = crowd(draw.uniform(-1, 2, (12, 2)), draw.normal(0, 1, (12, 2)))
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *varied)
    after = jax.jit(jax.vmap(lambda forces: walk(forces, people, table, groups, robot, companions, 4)))(stacked)
    finite = np.isfinite(after.position).all((1, 2, 3)) & np.isfinite(after.velocity).all((1, 2, 3))
    assert finite.all(), [names[k] for k in np.flatnonzero(~finite)]


def test_parameters_are_replaced_by_name():
    forces = social_forces.preset("helbing2000")
    changed = forces.tree_replace(
        {"repulsion.strength": 3, "repulsion.range": jnp.float32(0.1), "contact.friction": None}
    )
    assert changed.repulsion.strength.dtype == float, "or sums with it would be integers, or be refused"
    assert float(changed.repulsion.strength) == 3.0 and float(changed.repulsion.range) == pytest.approx(0.1)
    assert changed.contact.friction is None and changed.walking is forces.walking
    assert float(changed.replace(walls=forces.walls.replace(strength=1.0)).walls.strength) == 1.0
    with pytest.raises(ValueError, match=r"forces.repulsion.strenght: .* did you mean 'strength'"):
        forces.tree_replace({"repulsion.strenght": 1.0})
    with pytest.raises(AttributeError, match="did you mean 'walls'"):
        forces.wall  # noqa: B018
    with pytest.raises(AttributeError, match="no term 'wind'"):
        forces.replace(wind=Wind(0.0, 0.0))
    names = [jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(forces)]
    assert ".walls.strength" in names and len(names) == len(set(names))
    assert [type(term) for term in pickle.loads(pickle.dumps(jax.device_get(forces)))] == [
        type(term) for term in forces
    ]


@pytest.mark.night
def test_terms_of_ones_own_move_people_of_a_scenario():
    terms = [*social_forces.preset("helbing1995"), Wind(0.0, 0.6), Magnet(0.2, 3.0)]
    make = functools.partial(sean_jax.make, "lab", people=4, dynamics="twin")
    calm, windy = make(forces=terms[:-2]), make(forces=terms)

    def people(scenario, forces):
        return crowds.walk(scenario.replace(forces=forces), jax.random.key(1), 10)[0].position[-1]

    drift = np.asarray(jax.jit(people)(windy, windy.forces) - jax.jit(people)(calm, calm.forces))[:, 1]
    assert drift.mean() > 0.05
    slope = jax.jit(jax.grad(lambda forces: people(windy, forces)[:, 1].sum()))(windy.forces)
    assert float(slope.wind.y) > 0.1 and np.isfinite(float(slope.magnet.strength)) and float(slope.magnet.strength)


@pytest.mark.night
def test_the_terms_in_the_documents_work(scenario):
    """Each block of docs/social_forces.md, with a small scenario."""
    text = (ROOT / "docs" / "social_forces.md").read_text(encoding="utf-8")
    names = {"scenario": scenario, "sean_jax": sean_jax}
    for block in re.findall(r"```python\n(.*?)```", text, re.S):
        exec(block.replace("sean_jax.make(", "sean_jax.make('lab', people=2, dynamics='twin', "), names)
    assert float(names["scenario"].forces.distancing.strength) == 2.0
    drawn = social_forces.build([*social_forces.preset("sean2"), names["Exit"](x=5.0, y=0.0, strength=0.1)])
    people = crowd([(0.0, 0.0)], [(0.0, 0.3)], preferred=[0.6])
    assert float(walk(drawn, people, steps=5).position[-1, 0, 0]) > 0.001
