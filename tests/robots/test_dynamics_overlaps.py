"""Robots that start inside people and walls leave at their top speed at most; who comes from outside pushes them."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import robots
from sean_jax.core.data_types import Obstacles
from sean_jax.robots.dynamics import person_contact
from sean_jax.simulation import making
from support.driving import PERSON_RADIUS, RADIUS, TIME_STEP, rollout, run, world

LANES, PEOPLE, STEPS = 24, 16, 12
REACH = RADIUS + PERSON_RADIUS
WALLS = ((0.3, 0.0, 0.25, 1.0, 0.2), (0.0, 0.35, 1.0, 0.3, 0.0), (0.2, -0.3, 0.1, 0.1, 0.7))


def boxes(rows) -> Obstacles:
    numbers = jnp.asarray(rows, jnp.float32)
    return Obstacles(numbers[:, :2], numbers[:, 2:4], numbers[:, 4], jnp.ones(len(rows)))


@functools.partial(jax.jit, static_argnums=0)
def stood(drive, model, obstacles, *places):
    """(LANES, STEPS, 2) m, places of a robot that is told to stand."""

    def one(*place):
        return rollout(model, (obstacles, *place), jnp.zeros(3), jnp.zeros((STEPS, 2)))[0].position

    return jax.vmap(one)(*places)


def speeds_after(model, obstacles, people, velocity, present):
    """(LANES, STEPS) m/s, mean speed of the robot in each control step, and its places."""
    arrays = (jnp.asarray(people, jnp.float32), jnp.asarray(velocity, jnp.float32), jnp.asarray(present))
    places = np.asarray(stood(model.drive, model, obstacles, *arrays), float)
    assert np.isfinite(places).all()
    steps = np.diff(np.concatenate([np.zeros((LANES, 1, 2)), places], 1), axis=1)
    return np.hypot(*np.moveaxis(steps, -1, 0)) / TIME_STEP, places


@pytest.mark.parametrize("dynamics", ["twin", "kinematic"])
def test_nobody_inside_throws_the_robot_out(dynamics):
    """People on the robot, some still and some on their way through its middle, without walls and with walls."""
    random, model = np.random.default_rng(0), robots.load("kuri", dynamics)
    angle = random.uniform(-np.pi, np.pi, (LANES, PEOPLE, 1))
    outward = np.concatenate([np.cos(angle), np.sin(angle)], -1)
    people = random.uniform(0.0, REACH - 0.03, (LANES, PEOPLE, 1)) * outward
    speed = random.uniform(0.6, 2.5, (LANES, PEOPLE, 1)) * (np.arange(LANES) % 3 > 0)[:, None, None]
    present = random.random((LANES, PEOPLE)) < random.uniform(0.1, 1.0, (LANES, 1))
    top = float(model.max_speed)
    for walls in (world().obstacles, boxes(WALLS)):
        speeds, places = speeds_after(model, walls, people, -speed * outward, present)
        assert speeds.max() <= 1.01 * top, speeds.max(1)
        assert (speeds.max(1) > 0.95 * top).sum() > LANES // 3, "deep overlaps are undone at top speed"


def test_overlaps_end():
    """Two people who stand on the robot: it leaves them, and stops."""
    random, model = np.random.default_rng(1), robots.load("kuri", "twin")
    angle = random.uniform(-0.8, 0.8, (LANES, PEOPLE))
    people = np.stack([np.cos(angle), np.sin(angle)], -1) * random.uniform(0.3, REACH, (LANES, PEOPLE, 1))
    present = np.arange(PEOPLE)[None] < 2 + np.zeros((LANES, 1), int)
    _, places = speeds_after(model, world().obstacles, people, np.zeros_like(people), present)
    gaps = np.hypot(*np.moveaxis(people - places[:, -1:], -1, 0)) - REACH
    assert np.where(present, gaps, 1.0).min() > -0.006
    assert np.hypot(*(places[:, -1] - places[:, -3]).T).max() < 0.05


def test_a_contact_is_where_the_person_is_at_that_time():
    """The person has reached (1, 2) when the control step ends, and came from the left at 1.2 m/s."""
    model = robots.load("kuri", "twin")
    number = jnp.float32
    for left, behind in ((0.0, 0.0), (0.05, 0.06), (0.1, 0.12)):
        person = (number(1.0), number(2.0), number(1.2), number(0.0), jnp.bool_(True))
        nx, ny, allowed, bound = person_contact(
            model, number(PERSON_RADIUS), number(left), number(3.0), number(2.0), person
        )
        gap = 2.0 + behind - REACH
        assert (float(nx), float(ny)) == pytest.approx((1.0, 0.0)) and float(bound) > 100.0
        assert float(allowed) == pytest.approx(gap / float(model.time_step) - 1.2, rel=1e-5)
    # Deep inside, they are left at the top speed, whatever they do; and no faster if they go away by themselves.
    top = float(model.max_speed)
    for speed, allowed in ((0.0, -top), (2.0, -top), (-0.3, 0.3 - top)):
        inside = (number(1.0), number(2.0), number(speed), number(0.0), jnp.bool_(True))
        contact = person_contact(model, number(PERSON_RADIUS), number(0.0), number(1.2), number(2.0), inside)
        assert (float(contact[2]), float(contact[3])) == pytest.approx((allowed, top))
    absent = (*person[:4], jnp.bool_(False))
    assert np.isinf(float(person_contact(model, number(0.3), number(0.0), number(3.0), number(2.0), absent)[2]))


def test_who_comes_from_outside_pushes_the_robot_as_fast_as_they_walk():
    """It touches their front, from the moment that they reach it."""
    twin = robots.load("kuri", "twin")
    robot, people = run(twin, [[0.0, 0.0]] * 20, world(people=[(1.5, 0.0)], velocity=[(-1.3, 0.0), (0.0, 0.0)]))
    gap = np.linalg.norm(robot.position - people[:, 0], axis=1) - REACH
    reached = 1.5 - REACH - 1.3 * TIME_STEP * np.arange(1, 21)  # of their front, if the robot were not there
    np.testing.assert_allclose(gap, np.maximum(reached, 0.0), atol=0.003)
    moved = np.diff(robot.position[:, 0])[reached[1:] < -0.3]
    np.testing.assert_allclose(moved, -1.3 * TIME_STEP, atol=0.003)


@pytest.mark.night
@pytest.mark.parametrize("dynamics", ["twin", "kinematic"])
def test_a_crowd_on_the_robot_moves_it_no_faster_than_it_drives_or_than_those_who_touch_it_walk(dynamics):
    """Sixteen people in one heap with the robot drive one another apart, and some of them against the robot."""
    scenario = making.make("lab", behavior="random", people=16, dynamics=dynamics, metrics="none")
    model, lanes = scenario.robot, 16
    random = np.random.default_rng(3)
    angle, distance = random.uniform(-np.pi, np.pi, (lanes, 16)), random.uniform(0.0, 0.4, (lanes, 16))
    heap = jnp.asarray(distance[..., None] * np.stack([np.cos(angle), np.sin(angle)], -1), jnp.float32)

    @jax.jit
    @jax.vmap
    def run(key, offsets):
        """Places of the robot, places and speeds of the people, after each of 30 steps."""
        state = sean_jax.reset(scenario, key)
        people = replace(state.pedestrians, position=state.robot.position[None] + offsets)
        start = replace(state, pedestrians=people)

        def step(state, _):
            state = sean_jax.step(scenario, state, jnp.zeros(2))
            crowd = state.pedestrians
            return state, (state.robot.position, crowd.position, jnp.hypot(*crowd.velocity.T))

        first = start.robot.position, start.pedestrians.position
        return first, jax.lax.scan(step, start, length=30)[1]

    first, (robot, people, walked) = jax.tree.map(np.asarray, run(jax.random.split(jax.random.key(0), lanes), heap))
    robot = np.concatenate([first[0][:, None], robot], 1)
    people = np.concatenate([first[1][:, None], people], 1)
    speed = np.hypot(*np.moveaxis(np.diff(robot, axis=1), -1, 0)) / TIME_STEP
    gap = np.hypot(*np.moveaxis(people - robot[:, :, None], -1, 0)) - (float(model.radius) + PERSON_RADIUS)
    touched = np.minimum(gap[:, :-1], gap[:, 1:]) < 0.02
    fastest = np.where(touched, walked, 0.0).max(-1)
    top = float(model.max_speed)
    assert (speed <= 1.03 * np.maximum(top, fastest) + 0.01).all()
    assert (speed[:, 0] <= 1.01 * top).all() and (speed > 1.1 * top).mean() < 0.05
