"""The kinematic robot: arcs in closed form within its limits, stopped by what is in its way, with derivatives."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import robots
from support.driving import CLUTTER, PERSON_RADIUS, WALL, advance, batched, leaves, rollout, world

STEP = 0.1


@pytest.fixture(scope="module")
def kuri():
    return robots.load("kuri", "kinematic")


def by_hand(model, start, actions):
    """Pose, speed and turn rate after each action: one command at a time, exact arcs, in double precision."""
    top, turn, rise, spin = (
        float(getattr(model, f"max_{name}")) for name in ("speed", "turn_rate", "acceleration", "turn_acceleration")
    )
    reverse = top if model.max_reverse_speed is None else float(model.max_reverse_speed)
    fall = rise if model.max_deceleration is None else float(model.max_deceleration)
    x, y, yaw = map(float, start)
    v, w, last, age, out = 0.0, 0.0, (0.0, 0.0), 0, []
    for action in np.asarray(actions, float):
        finite = np.isfinite(action).all()
        last, age = (tuple(action), 0) if finite else (last, age + 1)
        wanted = (0.0, 0.0) if age * STEP > float(model.command_timeout) + 1e-6 else last
        v = min(max(min(max(wanted[0], v - fall * STEP), v + rise * STEP), -reverse), top)
        w = min(max(min(max(wanted[1], w - spin * STEP), w + spin * STEP), -turn), turn)
        if abs(w) > 1e-9:
            x, y = (
                x + v / w * (math.sin(yaw + w * STEP) - math.sin(yaw)),
                y - v / w * (math.cos(yaw + w * STEP) - math.cos(yaw)),
            )
        else:
            x, y = x + v * STEP * math.cos(yaw), y + v * STEP * math.sin(yaw)
        yaw += w * STEP
        out.append((x, y, math.cos(yaw), math.sin(yaw), v, w))
    return np.array(out)


@pytest.mark.parametrize("name", [name for name in robots.ROBOTS if name not in ("a1", "f1tenth", "hsr")])
def test_random_commands_give_arcs_within_the_limits(name):
    """Far beyond the limits, with pauses shorter and longer than the timeout, straight ahead and on the spot."""
    model, random = robots.load(name, "kinematic"), np.random.default_rng(2)
    size = [3.0 * float(model.max_speed), 2.0 * float(model.max_turn_rate)]
    actions = random.uniform(-1.0, 1.0, (8, 30, 2)) * size
    actions[0, :, 1] = 0.0
    actions[1, :, 0] = 0.0
    actions[5] = size
    actions[2:5][random.random((3, 30)) < 0.7] = np.nan
    starts = random.uniform(-3.0, 3.0, (8, 3))
    robot, _ = batched(model, leaves(world()), jnp.asarray(starts, float), jnp.asarray(actions, float))
    expected = np.stack([by_hand(model, *case) for case in zip(starts, actions, strict=True)])
    ours = np.concatenate([robot.position, robot.heading, robot.speed[..., None], robot.turn_rate[..., None]], -1)
    np.testing.assert_allclose(ours, expected, atol=2e-4 * max(1.0, size[0] / 3.0))
    assert (np.abs(expected[..., 4]).max() > 0.9 * float(model.max_speed)) and (expected[2:5, :, 4] == 0.0).any()
    speed = np.asarray(robot.speed)
    moved = np.diff(speed[0], prepend=0.0)
    assert np.abs(moved).max() <= STEP * float(model.max_acceleration) * 1.00001


def test_it_has_the_speeds_of_the_command_at_once(kuri):
    """Where the others take a step to get there: 0.3 m/s and 0.9 rad/s are within what 0.1 s may change."""
    robot = kuri.place(kuri, jnp.zeros(2), jnp.asarray([1.0, 0.0]))
    after = jax.jit(lambda robot, action: advance(kuri, leaves(world()), robot, world().people, action))(
        robot, jnp.asarray([0.3, 0.9])
    )
    assert float(after.speed) == np.float32(0.3) and float(after.turn_rate) == np.float32(0.9)
    straight = 2.0 * 0.3 / 0.9 * math.sin(0.045)
    np.testing.assert_allclose(after.position, straight * np.array([math.cos(0.045), math.sin(0.045)]), rtol=1e-5)


def clearance(position, boxes):
    """(...,) m to the nearest of the boxes, in double precision; negative inside."""
    center, half, yaw = (np.asarray(part, float) for part in (boxes.center, boxes.half_extent, boxes.yaw))
    gap = np.asarray(position, float)[..., None, :] - center
    u = np.abs(np.cos(yaw) * gap[..., 0] + np.sin(yaw) * gap[..., 1]) - half[:, 0]
    v = np.abs(np.cos(yaw) * gap[..., 1] - np.sin(yaw) * gap[..., 0]) - half[:, 1]
    return np.where(np.maximum(u, v) < 0, np.maximum(u, v), np.hypot(np.maximum(u, 0), np.maximum(v, 0))).min(-1)


WEDGE = world([(2.0, 0.75, 2.0, 0.5, -0.25), (2.0, -0.75, 2.0, 0.5, 0.25)], [(-0.8, 0.0)], [(1.2, 0.0), (0.0, 0.0)])


@pytest.mark.parametrize("place", [CLUTTER, WEDGE], ids=["clutter", "wedge"])
@pytest.mark.parametrize("name", ["kuri", "pioneer3dx", "jackal"])
def test_it_never_enters_an_obstacle(name, place):
    """Not in a wedge either, nor if a person who never gives way walks into its back."""
    model, random = robots.load(name, "kinematic"), np.random.default_rng(0)
    actions = random.uniform(-1.0, 1.0, (8, 50, 2)).repeat(4, 1) * [2.0, 6.0] + [0.6, 0.0]
    starts = random.uniform(-0.2, 0.2, (8, 3)) * [1.0, 1.0, 6.0]
    actions[0], starts[0] = [1.0, 0.0], 0.0
    robot, _ = batched(model, leaves(place), jnp.asarray(starts, float), jnp.asarray(actions, float))
    away = clearance(robot.position, place.obstacles) - model.radius
    assert away.min() > -1.1e-4 and away.min() < 5e-3  # it came there
    assert np.isfinite(np.asarray(robot.speed)).all()
    assert np.abs(robot.speed).max() <= 1.0001 * float(model.max_speed) + 1.2  # a person's push on top


def test_a_wall_stops_it_and_it_slides_along(kuri):
    place = leaves(world([WALL]))
    starts = jnp.asarray([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5]])
    actions = jnp.tile(jnp.asarray([0.5, 0.0]), (2, 60, 1))
    robot, _ = batched(kuri, place, starts, actions)
    x, y = np.moveaxis(np.asarray(robot.position), -1, 0)
    np.testing.assert_allclose(x[:, -1], 1.0 - 0.16, atol=2e-4)
    assert abs(float(robot.speed[0, -1])) < 1e-4 and abs(y[0, -1]) < 1e-4
    np.testing.assert_allclose(np.diff(y[1])[-20:], 0.05 * math.sin(0.5), rtol=1e-3)
    np.testing.assert_allclose(robot.speed[1, -1], 0.5 * math.sin(0.5) ** 2, rtol=1e-3)
    assert (clearance(robot.position, place[0]) >= 0.16 - 1.1e-4).all()


def test_a_person_stops_it_and_who_walks_into_it_pushes_it(kuri):
    reach = PERSON_RADIUS + 0.16
    there, coming = world(people=[(0.8, 0.0)]), world(people=[(0.8, 0.0)], velocity=[(-0.4, 0.0), (0.0, 0.0)])
    ahead, still = jnp.tile(jnp.asarray([0.5, 0.0]), (1, 40, 1)), jnp.zeros((1, 40, 2))
    robot, _ = batched(kuri, leaves(there), jnp.zeros((1, 3)), ahead)
    assert float(robot.position[0, -1, 0]) == pytest.approx(0.8 - reach, abs=1e-3)
    robot, people = batched(kuri, leaves(coming), jnp.zeros((1, 3)), still)
    gap = np.asarray(people[0, :, 0, 0] - robot.position[0, :, 0])
    assert gap.min() > reach - 0.01 and float(robot.position[0, -1, 0]) < -0.4


@pytest.mark.slow
def test_gradients_equal_differences():
    """In both modes, free, gliding along a wall and held by a person, against central differences in float64."""
    steps, change = 8, 1e-6
    with jax.enable_x64(True):
        model = robots.load("kuri", "kinematic")
        place = leaves(world([(1.0, 0.0, 0.5, 3.0, 0.4)], [(0.48, -0.46)]))

        def loss(actions, start):
            robot, _ = rollout(model, place, start, actions)
            return jnp.sum((robot.position - 0.3) ** 2) + robot.heading[-1, 1] * robot.speed[-1]

        values = jax.jit(jax.vmap(loss))
        both = jax.jit(jax.vmap(lambda *at: (jax.grad(loss)(*at), jax.jacfwd(loss)(*at))))
        random = np.random.default_rng(3)
        actions = random.uniform(-1.0, 1.0, (3, steps, 2)) * [0.15, 0.3] + [0.33, -0.2]
        actions = np.concatenate([actions, np.zeros((1, steps, 2))])  # the last one stands
        starts = np.array([[0.1, 0.0, 0.0], [-9.0, 0.0, 1.0], [0.12, -0.3, -0.8], [0.0, 0.0, 0.0]])
        backward, forward = both(jnp.asarray(actions), jnp.asarray(starts))
        assert np.isfinite(backward).all() and np.isfinite(forward).all()
        np.testing.assert_allclose(backward, forward, rtol=1e-9, atol=1e-12)
        shifts = change * np.eye(2 * steps).reshape(-1, steps, 2)
        for k in range(3):
            batch = jnp.asarray(np.concatenate([actions[k] + shifts, actions[k] - shifts]))
            value = np.asarray(values(batch, jnp.broadcast_to(jnp.asarray(starts[k]), (len(batch), 3))))
            differences = (value[: 2 * steps] - value[2 * steps :]).reshape(steps, 2) / (2 * change)
            assert np.abs(differences).max() > 0.01
            np.testing.assert_allclose(backward[k], differences, rtol=1e-3, atol=1e-6)
