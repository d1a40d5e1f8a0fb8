"""Robots: their files, how they move, stop and touch; the MJX robot against its twin, C MuJoCo and differences."""

import contextlib
import functools
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from importlib import import_module
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

import sean_jax
from sean_jax import robots
from sean_jax.core.data_types import Obstacles
from sean_jax.core.errors import FileError
from sean_jax.robots import drive, kernel
from sean_jax.robots.drive import coordinates
from sean_jax.robots.dynamics import Surroundings, diagonal
from support import programs, trees
from support.driving import (
    BATCH,
    CLUTTER,
    PERSON_RADIUS,
    RADIUS,
    STEPS,
    TIME_STEP,
    WALL,
    advance,
    batched,
    leaves,
    rollout,
    run,
    world,
)
from support.quick import quick
from support.robot_files import BASE, urdf

mujoco: Any = import_module("mujoco")  # which has no type stubs


@pytest.fixture(scope="module")
def kuri():
    return robots.load("kuri", "mjx")


@pytest.fixture(scope="module")
def twin():
    return robots.load("kuri", "twin")


@pytest.fixture(scope="module")
def wild():
    """Commands far beyond the limits that change all the time, and starts among walls and people."""
    random = np.random.default_rng(0)
    actions = random.uniform(-1.0, 1.0, (BATCH, STEPS // 4, 2)).repeat(4, 1) * [1.0, 6.0]
    starts = random.uniform(-0.5, 0.5, (BATCH, 3)) * [1.0, 1.0, 6.0]
    return jnp.asarray(starts, jnp.float32), jnp.asarray(actions, jnp.float32)


@pytest.mark.parametrize(
    ("place", "steps", "near"), [(world(), 200, 1e-5), (CLUTTER, 40, 1e-4)], ids=["free", "clutter"]
)
def test_twin_equals_mjx(kuri, twin, wild, place, steps, near):
    """To rounding; among people for as long as gliding off a disc, which is unstable, has not amplified that."""
    mjx_robot, _ = batched(kuri, leaves(place), *wild)
    twin_robot, _ = batched(twin, leaves(place), *wild)
    for name in ("position", "heading", "speed", "turn_rate"):
        ours, theirs = getattr(mjx_robot, name)[:, :steps], getattr(twin_robot, name)[:, :steps]
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=near, err_msg=name)
    travelled = np.abs(np.diff(np.asarray(mjx_robot.position), axis=1)).sum((1, 2))
    assert (travelled > 1.0).all()


def test_the_kernel_for_a_gpu_moves_robots_as_the_loop(monkeypatch):
    """Among people and at obstacles, from random states; also without either. On a CPU XLA runs the kernel."""
    monkeypatch.setattr(kernel, "_call", functools.partial(kernel._call, interpret=True))
    models, random = robots.alike([robots.load("kuri"), robots.load("jackal")]), np.random.default_rng(5)
    loop, launch = (jax.jit(functools.partial(form, 5)) for form in (drive._simulate_twin, kernel.simulate))
    for people, boxes in ((6, 5), (6, 5), (6, 5), (6, 5), (0, 3), (3, 0), (0, 0)):
        obstacles = Obstacles(
            center=random.uniform(-2.0, 2.0, (boxes, 2)).astype(np.float32),
            half_extent=random.uniform(0.1, 0.6, (boxes, 2)).astype(np.float32),
            yaw=random.uniform(-3.0, 3.0, boxes).astype(np.float32),
            height=np.ones(boxes, np.float32),
        )
        around = Surroundings(
            obstacles,
            random.normal(size=(people, 2)).astype(np.float32),
            random.normal(size=(people, 2)).astype(np.float32),
            random.random(people) < 0.8,
            np.float32(0.3),
        )
        start = [*random.normal(size=2), random.uniform(-3.0, 3.0), 0.0, 0.0], random.normal(size=5) * [1, 1, 2, 5, 5]
        motion = tuple(np.asarray(part, np.float32) for part in start)
        targets = (random.normal(size=2) * 6).astype(np.float32)
        for model in models:
            ours, theirs = (form(model, around, motion, targets) for form in (launch, loop))
            trees.assert_close(ours, theirs, rtol=1e-5, atol=2e-5)


def test_limits_hold_under_wild_commands(kuri, wild):
    robot, _ = batched(kuri, leaves(world()), *wild)
    speed, turn_rate = np.asarray(robot.speed), np.asarray(robot.turn_rate)
    assert np.abs(speed).max() == pytest.approx(0.5, rel=0.01)
    assert np.abs(turn_rate).max() == pytest.approx(3.0, rel=0.01)
    assert np.abs(np.diff(speed)).max() <= 5.0 * TIME_STEP * 1.02
    assert np.abs(np.diff(turn_rate)).max() <= 10.0 * TIME_STEP * 1.02
    np.testing.assert_allclose(np.linalg.norm(robot.heading, axis=-1), 1.0, atol=1e-5)


def test_wheels_equal_c_mujoco(kuri):
    """Without grip, the file as C MuJoCo steps it must give the same wheels; likewise with other parameters."""
    other = kuri.replace(wheel_inertia=kuri.wheel_inertia + 0.002, servo_gain=kuri.servo_gain * 0.5)
    assert float(diagonal(other)[3]) == pytest.approx(0.0060613, rel=1e-4)
    for model, armature, gain in ((kuri, 0.004, 0.2), (other, 0.006, 0.1)):
        actions = np.array([[0.5, 0.0]] * 8 + [[0.0, 1.0]] * 8)
        robot, _ = run(model.replace(friction=jnp.zeros(())), actions)
        position, velocity = jax.tree.map(np.asarray, jax.vmap(coordinates, (None, 0))(model, robot))
        oracle = mujoco.MjModel.from_xml_path(str(robots.ROBOTS["kuri"]))
        oracle.dof_armature[3:] = armature
        oracle.actuator_gainprm[:, 0], oracle.actuator_biasprm[:, 2] = gain, -gain
        data = mujoco.MjData(oracle)
        for i, (speed, turn) in enumerate(actions):
            data.ctrl[:] = np.array([speed - 0.0875 * turn, speed + 0.0875 * turn]) / 0.035
            mujoco.mj_step(oracle, data, 5)
            np.testing.assert_allclose(velocity[i], data.qvel, rtol=1e-5, atol=1e-5)
            difference = position[i] - data.qpos
            np.testing.assert_allclose(difference - 2 * np.pi * np.round(difference / (2 * np.pi)), 0.0, atol=1e-4)


@pytest.mark.parametrize("yaw", [0.0, 0.6])
@pytest.mark.parametrize("boxes", [[WALL], [(1.5, y, 0.5, 0.8, 0.0) for y in (-0.5, 0.9, 2.4)]])
def test_wall_stops_the_robot_that_glides_along_it(kuri, boxes, yaw):
    """One box or three that overlap: no bounce, no ghost bump at the joints."""
    robot, _ = run(kuri, [[0.5, 0.0]] * 60, world(boxes), (0.0, 0.0, yaw))
    gap = 1.0 - RADIUS - robot.position[:, 0]
    assert gap.min() > -0.001 and abs(gap[-1]) < 0.001
    velocity = np.asarray(jax.vmap(coordinates, (None, 0))(kuri, robot)[1])
    assert velocity[:, 0].min() > -0.01
    if yaw:
        assert robot.position[-1, 1] > 0.9 and velocity[-1, 1] > 0.1
    else:
        np.testing.assert_allclose(robot.position[-1], robot.position[-2], atol=1e-5)


def test_corner_holds_the_robot(kuri):
    robot, _ = run(kuri, [[0.5, 0.0]] * 80, world([WALL, (0.0, 1.5, 3.0, 0.5, 0.0)]), (0.0, 0.0, 0.8))
    assert robot.position.max() < 1.0 - RADIUS + 0.001
    np.testing.assert_allclose(robot.position[-1], 1.0 - RADIUS, atol=0.001)


@pytest.mark.parametrize("offset", [0.0, 0.05])
def test_person_is_not_pushed_through(kuri, offset):
    robot, people = run(kuri, [[0.5, 0.0]] * 60, world(people=[(1.0, offset)]))
    gap = np.linalg.norm(robot.position - people[:, 0], axis=1) - RADIUS - PERSON_RADIUS
    assert gap.min() > -0.001
    assert (abs(gap[-1]) < 0.001) == (offset == 0.0)


def test_absent_person_is_no_obstacle(kuri):
    place = world(people=[(1.0, 0.0)])
    place.present = jnp.zeros((2,), bool)
    robot, _ = run(kuri, [[0.5, 0.0]] * 40, place)
    assert robot.position[-1, 0] > 1.9


def test_person_who_walks_into_the_robot_pushes_it_but_not_into_a_wall(kuri):
    walks = world(people=[(1.5, 0.0)], velocity=[(-1.3, 0.0), (0.0, 0.0)])
    robot, people = run(kuri, [[0.0, 0.0]] * 20, walks)
    gap = np.linalg.norm(robot.position - people[:, 0], axis=1) - RADIUS - PERSON_RADIUS
    assert gap.min() > -0.001 and robot.position[-1, 0] < -0.5
    squeezed = world([(-1.0, 0.0, 0.5, 3.0, 0.0)], [(1.5, 0.0)], [(-1.3, 0.0), (0.0, 0.0)])
    robot, _ = run(kuri, [[0.0, 0.0]] * 20, squeezed)
    assert robot.position[:, 0].min() > -0.5 + RADIUS - 0.001


def test_overlap_at_the_start_is_undone_gently(kuri):
    robot, _ = run(kuri, [[0.0, 0.0]] * 20, world([WALL]), (0.95, 0.0, 0.0))
    assert robot.position[-1, 0] == pytest.approx(1.0 - RADIUS, abs=0.001)
    assert np.abs(robot.speed).max() <= 0.501


def test_command_holds_until_its_timeout_and_then_the_robot_stops(kuri):
    """0.25 s are two steps of 0.1 s more; an action of which a part is not finite is no new command."""
    held, _ = run(kuri, [[0.5, 0.5]] * 5 + [[np.nan, np.nan]] * 10)
    told, _ = run(kuri, [[0.5, 0.5]] * 7 + [[0.0, 0.0]] * 8)
    np.testing.assert_array_equal(held.position, told.position)
    np.testing.assert_allclose(held.speed[5:7], 0.5, rtol=0.01)
    assert abs(held.speed[-1]) < 1e-3 and abs(held.turn_rate[-1]) < 1e-3
    np.testing.assert_array_equal(held.drive_state.age[4:9], range(5))
    often, _ = run(kuri, [[0.5, 0.5], [np.nan, np.inf], [0.1, np.nan]] * 5)
    always, _ = run(kuri, [[0.5, 0.5]] * 15)
    np.testing.assert_array_equal(often.position, always.position)
    never, _ = run(kuri, [[np.nan, np.nan]] * 5)
    np.testing.assert_array_equal(never.position, 0.0)
    longer, _ = run(kuri.replace(command_timeout=jnp.float32(0.55)), [[0.5, 0.5]] * 5 + [[np.nan, np.nan]] * 10)
    told, _ = run(kuri, [[0.5, 0.5]] * 10 + [[0.0, 0.0]] * 5)
    np.testing.assert_array_equal(longer.position, told.position)


def test_one_trace_strong_types_and_vmap_equals_a_loop(kuri, wild):
    @programs.jit_once
    def once(model, place, start, action):
        robot = model.place(model, start[:2], jnp.stack([jnp.cos(start[2]), jnp.sin(start[2])]))
        return advance(model, place, robot, place[1], action)

    starts, actions = wild
    together, _ = batched(kuri, leaves(CLUTTER), starts, actions)
    for i, model in enumerate((kuri, kuri, robots.load("kuri", "mjx"))):
        robot = once(model, leaves(CLUTTER), starts[i], actions[i, 0])
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b[i, 0], atol=2e-6), robot, together)  # noqa: B023
    assert all(leaf.dtype in (jnp.float32, jnp.int32) and not leaf.weak_type for leaf in jax.tree.leaves(robot))
    placed = kuri.place(kuri, jnp.zeros((2,)), jnp.array([0.6, 0.8]))
    assert jax.tree.map(lambda leaf: leaf.shape, placed) == jax.tree.map(lambda leaf: leaf.shape, robot)
    np.testing.assert_allclose(coordinates(kuri, placed)[0][2], np.arctan2(0.8, 0.6), rtol=1e-6)


def facing(angle, scale=1.0):
    return jnp.asarray([scale * np.cos(angle), scale * np.sin(angle)], jnp.float32)


@pytest.mark.parametrize("dynamics", ["twin", "kinematic", pytest.param("mjx", marks=pytest.mark.slow)])
def test_physics_go_on_from_a_pose_that_is_replaced(dynamics):
    """At rest it equals a robot reset there; on the move only the pose differs; headings count by their direction."""
    model, random = robots.load("kuri", dynamics), np.random.default_rng(5)
    steps = jax.jit(lambda robot, action: advance(model, leaves(CLUTTER), robot, CLUTTER.people, action))
    for _ in range(20):
        spot, angle = jnp.asarray(random.uniform(-0.5, 0.5, 2), jnp.float32), random.uniform(-3.1, 3.1)
        action = jnp.asarray(random.uniform(-1, 1, 2), jnp.float32)
        there = model.place(model, spot, facing(angle))
        elsewhere = model.place(model, spot + 0.3, facing(angle + 2.0))
        for scale in (1.0, 0.2, 7.0):
            moved = replace(elsewhere, position=spot, heading=facing(angle, scale))
            jax.tree.map(
                functools.partial(np.testing.assert_allclose, atol=1e-5), steps(moved, action), steps(there, action)
            )
        going = steps(steps(there, action), action)
        given = dict(position=spot + 50.0, heading=facing(-angle), speed=jnp.float32(0.4), turn_rate=jnp.float32(0.0))
        moved = steps(replace(going, **given), jnp.asarray([0.4, 0.0]))
        travelled = np.asarray(moved.position - spot - 50.0)
        np.testing.assert_allclose(travelled, 0.04 * np.asarray(facing(-angle)), atol=1e-3)  # wheels and all
        np.testing.assert_allclose(np.linalg.norm(moved.heading), 1.0, atol=1e-6)


def test_a_pose_is_stored_once(twin):
    """What is beside the pose is not the pose once more."""
    robot, action = twin.place(twin, jnp.zeros(2), jnp.asarray([1.0, 0.0])), jnp.asarray([0.3, 0.5])
    after = jax.tree.map(np.asarray, advance(twin, leaves(world()), robot, world().people, action))
    lengths = {name: np.size(value) for name, value in after.drive_state._asdict().items() if value is not None}
    assert lengths == {"wheels": 2, "slip": 2, "sideways": 1, "command": 2, "age": 1}
    for name in ("position", "heading", "speed", "turn_rate"):
        value = getattr(after, name)
        assert not any(np.array_equal(value, leaf) for leaf in jax.tree.leaves(after.drive_state)), name


def test_a_robot_at_rest_keeps_its_heading_and_turning_does_not_wear_it(twin):
    """Six minutes at rest change no bit; after six minutes of turning the heading is the turn rate's integral."""
    starts = jnp.asarray(np.random.default_rng(6).uniform(-3.1, 3.1, 8), jnp.float32)

    @jax.jit
    @jax.vmap
    def minutes(angle):
        def one(robot, action):
            return advance(twin, leaves(world()), robot, world().people, action), None

        robot = twin.place(twin, jnp.zeros(2), jnp.stack([jnp.cos(angle), jnp.sin(angle)]))
        rest = jax.lax.scan(one, robot, jnp.zeros((3600, 2)))[0]
        turning = jax.lax.scan(one, robot, jnp.tile(jnp.asarray([0.0, 1.3]), (20, 1)))[0]
        turned = jax.lax.scan(one, turning, jnp.tile(jnp.asarray([0.0, 1.3]), (3600, 1)))[0]
        return robot.heading, rest.heading, turning, turned

    placed, rested, turning, turned = jax.tree.map(np.asarray, minutes(starts))
    np.testing.assert_array_equal(placed, rested)
    np.testing.assert_array_equal(turning.turn_rate, turned.turn_rate)
    ends = [np.arctan2(*robot.heading.astype(float).T[::-1]) for robot in (turning, turned)]
    off = ends[1] - ends[0] - 360.0 * turned.turn_rate.astype(float)
    assert (
        np.abs(off - 2 * np.pi * np.round(off / (2 * np.pi))).max() < 3600 * 5 * 1.2e-7
    )  # half a unit in the last place


@pytest.mark.slow
def test_gradients_equal_differences_of_the_mjx_robot():
    """The gradient of the twin, against central differences in double precision of what MJX computes."""
    steps, change = 10, 1e-6
    with jax.enable_x64(True):
        model = robots.load("kuri", "mjx")
        place = leaves(world([(1.0, 0.0, 0.5, 3.0, 0.4)], [(0.48, -0.46)]))
        target = jnp.array([[0.3, 0.4]])

        def loss(actions, start):
            robot, _ = rollout(model, place, start, actions)
            return jnp.sum((robot.position - target) ** 2) + robot.heading[-1, 1] * robot.speed[-1]

        both = jax.jit(jax.vmap(jax.value_and_grad(loss)))
        random = np.random.default_rng(3)
        # Meets the wall, glides along it, and is held by the person in the end.
        actions = random.uniform(-1.0, 1.0, (steps, 2)) * [0.15, 0.3] + [0.33, -0.2]
        shifts = change * np.eye(2 * steps).reshape(-1, steps, 2)
        still = np.zeros((1, steps, 2))
        batch = np.concatenate([[actions], still, still, actions + shifts, actions - shifts])
        starts = np.zeros((len(batch), 3)) + [0.12, 0.0, 0.0]
        starts[2, 0] = 0.3  # the third touches the wall
        values, gradients = both(jnp.asarray(batch), jnp.asarray(starts))
        values, gradients = np.asarray(values), np.asarray(gradients)
    assert np.isfinite(gradients).all()
    differences = (values[3 : 3 + 2 * steps] - values[3 + 2 * steps :]).reshape(steps, 2) / (2 * change)
    assert np.abs(differences).max() > 0.01
    np.testing.assert_allclose(gradients[0], differences, rtol=1e-3, atol=1e-6)


@pytest.mark.night
def test_forward_mode_equals_reverse_mode(kuri):
    """Through MJX, by the command, the start and a constant of the robot; touching somebody, and free."""
    place = leaves(world([WALL], [(0.46, 0.1)]))

    def end(action, start, friction):
        model = kuri.replace(friction=friction)
        robot = model.place(model, start[:2], jnp.stack([jnp.cos(start[2]), jnp.sin(start[2])]))
        after = advance(model, place, robot, place[1], action)
        return jnp.concatenate([after.position, after.heading, after.speed[None]])

    both = jax.jit(jax.vmap(lambda *at: (jax.jacfwd(end, (0, 1, 2))(*at), jax.jacrev(end, (0, 1, 2))(*at))))
    at = [[0.3, 0.2], [0.5, -1.0], [9.0, 0.0]], [[0.0, 0.05, 0.1], [-3.0, 0.0, 0.0], [0.02, 0.1, 0.0]], [0.1, 1.0, 0.05]
    forward, backward = both(*(jnp.asarray(part, jnp.float32) for part in at))
    for one, other in zip(forward, backward, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-5)
        assert np.isfinite(one).all() and np.abs(one).max() > 1e-3


FIGURES = {  # mass, wheel radius, track; greatest speed, turn rate, acceleration, turn acceleration; radius
    "fetch": (121.3, 0.0613, 0.37476, 1.0, 1.5, 0.75, 3.0, 0.29),
    "jackal": (18.431, 0.098, 0.37559, 0.5, 8.0, 5.0, 25.0, 0.27),
    "kuri": (6.0, 0.035, 0.175, 0.5, 3.0, 5.0, 10.0, 0.16),
    "pioneer3dx": (9.0, 0.0975, 0.33, 1.2, 5.24, 1.0, 5.0, 0.25),
    "turtlebot3": (1.0, 0.033, 0.16, 1.0, 1.7, 0.8, 1.5, 0.11),
    "warthog": (260.0, 0.3, 1.08, 5.0, 4.0, 5.0, 10.0, 0.95),
}


@pytest.fixture(
    scope="module",
    params=[
        *(pytest.param((name, "twin"), id=name) for name in FIGURES),
        *(pytest.param((name, "mjx"), id=f"{name}-mjx", marks=pytest.mark.slow) for name in FIGURES),
    ],
)
def every(request):
    """Each robot by its twin, which compiles sooner, and in the slow tests by MJX."""
    return robots.load(*request.param)


def backward(model):
    """Greatest speed backward and greatest fall of the speed: those ahead, unless the robot has its own."""
    speed = model.max_speed if model.max_reverse_speed is None else model.max_reverse_speed
    fall = model.max_acceleration if model.max_deceleration is None else model.max_deceleration
    return float(speed), float(fall)


def by_hand(model, commands):
    """Speed, turn rate, way and turn in each control step of commands (T, 2), of a robot whose wheels do not slip.

    A change of speed of the base is one of the wheels' too, so that half of m r2 joins the inertia of each wheel; for
    turning it is half of I (2 r / track)2.
    """
    figures = {name: float(getattr(model, name)) for name in ("mass", "inertia", "wheel_radius", "wheel_inertia")}
    mass, inertia, radius, wheel = figures.values()
    arm = float(model.track) / 2
    gain, torque = float(model.servo_gain), float(model.servo_torque)
    most = float(model.max_acceleration), float(model.max_turn_acceleration)
    top = float(model.max_speed), float(model.max_turn_rate)
    reverse, fall = backward(model)
    least, down = (reverse, top[1]), (fall, most[1])
    now, out = [0.0, 0.0], []
    for command in commands:
        target = [
            np.clip(np.clip(command[k], now[k] - 0.1 * down[k], now[k] + 0.1 * most[k]), -least[k], top[k])
            for k in (0, 1)
        ]
        gone = [0.0, 0.0]
        for _ in range(5):
            ahead, turn = target[0] - now[0], target[1] - now[1]
            left = np.clip(gain * (ahead - arm * turn) / radius, -torque, torque)
            right = np.clip(gain * (ahead + arm * turn) / radius, -torque, torque)
            now[0] += 0.02 * (left + right) / radius / (mass + 2 * wheel / radius**2)
            now[1] += 0.02 * (right - left) * arm / radius / (inertia + 2 * wheel * (arm / radius) ** 2)
            gone = [gone[k] + 0.02 * now[k] for k in (0, 1)]
        out.append((*now, *gone))
    return np.array(out)


def test_every_robot_is_its_figures(every):
    figures = (every.mass, every.wheel_radius, every.track, every.max_speed, every.max_turn_rate,
               every.max_acceleration, every.max_turn_acceleration, every.radius)  # fmt: skip
    np.testing.assert_allclose([float(figure) for figure in figures], FIGURES[every.name], rtol=1e-6)
    assert float(every.command_timeout) == 0.25 and every.time_step == 0.02
    assert float(every.servo_gain) * every.time_step <= float(every.wheel_inertia)  # or a wheel off the ground swings


def test_every_robot_answers_a_step_as_its_equation_says(every):
    """Speed up, stop; turn up, stop; back up, stop: first-order servos, torque limits and acceleration limits."""
    top, turn = float(every.max_speed), 0.8 * float(every.max_turn_rate)
    for command in ((top, 0.0), (0.0, turn), (0.4 * top, 0.3 * turn), (-backward(every)[0], 0.0)):
        commands = [command] * 30 + [(0.0, 0.0)] * 30
        robot, _ = run(every, commands)
        expected = by_hand(every, commands)
        np.testing.assert_allclose(robot.speed, expected[:, 0], atol=1e-3 * max(0.2, top))  # a turn within a step
        np.testing.assert_allclose(robot.turn_rate, expected[:, 1], atol=2e-3)
        assert robot.speed[29] == pytest.approx(command[0], rel=0.01, abs=1e-4)
        assert robot.turn_rate[29] == pytest.approx(command[1], rel=0.01, abs=1e-4)
        assert abs(robot.speed[-1]) < 1e-3 and abs(robot.turn_rate[-1]) < 1e-3


def test_every_robot_backs_up_and_brakes_within_its_own_limits(every):
    """Far beyond them: TurtleBot3's are 0.5 m/s backward, and 0.4 m/s2 downward but 0.8 m/s2 upward, in SEAN 2.0."""
    top, rise = float(every.max_speed), float(every.max_acceleration)
    reverse, fall = backward(every)
    assert (reverse, fall) == pytest.approx({"turtlebot3": (0.5, 0.4)}.get(every.name, (top, rise)))
    commands = [(99.0, 0.0)] * 40 + [(-99.0, 0.0)] * 60 + [(99.0, 0.0)] * 40
    robot, _ = run(every, commands)
    speed = robot.speed.astype(float)
    assert speed[39] == pytest.approx(top, rel=0.01) and speed[99] == pytest.approx(-reverse, rel=0.01)
    change = np.diff(speed, prepend=0.0) / TIME_STEP
    assert change.max() <= 1.02 * rise and change.min() >= -1.02 * fall
    np.testing.assert_allclose(speed, by_hand(every, commands)[:, 0], atol=1e-3 * max(0.2, top))
    if every.name == "turtlebot3":  # slow enough for the limits, and not the servos, to decide
        assert change[45:55].mean() == pytest.approx(-0.4, rel=0.05)
        assert change[103:110].mean() == pytest.approx(0.8, rel=0.05)


def test_limits_backward_follow_those_ahead_unless_given(twin):
    """A sweep over the top speed reaches both directions; a limit of its own is a leaf as well."""
    slow = twin.replace(max_speed=jnp.float32(0.2))
    assert run(slow, [(-1.0, 0.0)] * 20)[0].speed[-1] == pytest.approx(-0.2, rel=0.01)
    crawling = slow.replace(max_reverse_speed=jnp.float32(0.05))
    assert run(crawling, [(-1.0, 0.0)] * 20)[0].speed[-1] == pytest.approx(-0.05, rel=0.01)
    assert run(crawling, [(1.0, 0.0)] * 20)[0].speed[-1] == pytest.approx(0.2, rel=0.01)


def test_every_robot_drives_a_circle_of_its_radius(every):
    speed, turn_rate = 0.5 * float(every.max_speed), 0.3 * float(every.max_turn_rate)
    robot, _ = run(every, [[speed, turn_rate]] * 120)
    x, y = robot.position[40:].T.astype(float)
    a, b, c = np.linalg.lstsq(np.stack([2 * x, 2 * y, np.ones_like(x)], 1), x * x + y * y, rcond=None)[0]
    assert np.sqrt(c + a * a + b * b) == pytest.approx(speed / turn_rate, rel=0.01)
    angle = np.unwrap(np.arctan2(y - b, x - a))
    assert (angle[-1] - angle[0]) / (79 * TIME_STEP) == pytest.approx(turn_rate, rel=0.01)


def test_every_robot_drives_a_square(every):
    """Four sides, and quarter turns at the rate which by hand gives a right angle: corners where they should be."""
    forward = [(0.32 * float(every.max_speed), 0.0)] * 16 + [(0.0, 0.0)] * 9

    def corner(rate):
        return [(0.0, rate)] * 16 + [(0.0, 0.0)] * 9

    rate = scipy.optimize.brentq(lambda rate: by_hand(every, corner(rate))[:, 3].sum() - np.pi / 2, 0.5, 1.6)
    edge = by_hand(every, forward)[:, 2].sum()
    robot, _ = run(every, (forward + corner(rate)) * 4)
    corners = robot.position[[50 * k + 24 for k in range(4)]]
    np.testing.assert_allclose(corners, edge * np.array([[1, 0], [1, 1], [0, 1], [0, 0]]), atol=0.005 * edge)
    np.testing.assert_allclose(robot.position[-1], 0.0, atol=0.005 * edge)
    np.testing.assert_allclose(robot.heading[-1], [1.0, 0.0], atol=0.01)


def test_every_robot_stops_at_a_wall_and_does_not_push_through_a_person(every):
    fast = float(every.max_speed)
    robot, _ = run(every, [[fast, 0.0]] * 60, world([WALL]), (-2.0, 0.0, 0.0))
    gap = 1.0 - every.radius - robot.position[:, 0]
    assert gap.min() > -0.001 and abs(gap[-1]) < 0.001
    np.testing.assert_allclose(robot.position[-1], robot.position[-2], atol=1e-4)
    robot, people = run(every, [[fast, 0.0]] * 60, world(people=[(1.0, 0.0)]), (-2.0, 0.0, 0.0))
    gap = np.linalg.norm(robot.position - people[:, 0], axis=1) - every.radius - PERSON_RADIUS
    assert gap.min() > -0.001 and abs(gap[-1]) < 0.001 and robot.position[-1, 0] < 1.0


OTHERS = quick([name for name in FIGURES if name != "kuri"], "jackal")


@pytest.mark.parametrize("name", OTHERS)
def test_every_other_twin_equals_its_mjx_robot(name, wild):
    """In free space and among walls and people, to rounding, which grows among sliding tyres."""
    model, other = robots.load(name, "mjx"), robots.load(name)
    starts, actions = wild
    actions = actions * jnp.stack([model.max_speed, model.max_turn_rate])[None, None, :]
    for place, steps in ((world(), 60), (CLUTTER, 20)):
        ours, _ = batched(model, leaves(place), starts, actions)
        theirs, _ = batched(other, leaves(place), starts, actions)
        for field in ("position", "heading", "speed", "turn_rate"):
            one, two = getattr(ours, field)[:, :steps], getattr(theirs, field)[:, :steps]
            near = 2e-4 * max(1.0, float(model.max_speed))
            np.testing.assert_allclose(one, two, rtol=0, atol=near, err_msg=field)


@pytest.mark.parametrize(("name", "radius"), quick([("jackal", 0.27), ("warthog", 0.95)], ("jackal", 0.27)))
def test_robot_wider_than_people_walk_has_its_own_paths(name, radius):
    """They stand off from obstacles by its radius, while people keep theirs."""
    crowd = {"behavior": "random", "task": "random_ab_nav", "people": 2}
    scenario = sean_jax.make("lab", robot=name, **crowd, metrics="none", dynamics="twin")
    assert float(scenario.navigation.radius) == pytest.approx(radius)
    assert float(programs.clearance(scenario.environment, scenario.navigation.places).min()) > radius
    state = programs.reset(scenario, jax.random.key(0))
    assert float(programs.clearance(scenario.environment, state.robot.position[None, :])[0]) > radius


@pytest.mark.parametrize("path", robots.ROBOTS.values(), ids=list(robots.ROBOTS))
def test_robot_files_open_in_mujoco_and_carry_the_sensor_mounts(path):
    model = mujoco.MjModel.from_xml_path(str(path))
    assert not model.geom_contype.any() and not model.geom_conaffinity.any()
    assert model.site("lidar").pos[2] > 0.0
    mounts = {model.camera(i).name for i in range(model.ncam)}
    assert mounts == {"depth", "first_person", "third_person", "overhead"}
    assert robots.load(path, "twin").name == path.stem


@pytest.mark.parametrize(
    ("wrong", "dynamics", "message"),
    [
        ("zzz", "mjx", "warthog. The path of an MJCF file works as well as a name.$"),
        ("kurri", "mjx", "did you mean 'kuri'"),
        ("zzz", "mjx", "there are: a1, f1tenth"),
        ("nowhere/kuri.xml", "mjx", "no robot file 'nowhere/kuri.xml'"),
        ("kuri", "twinn", "did you mean 'twin'"),
    ],
)
def test_unknown_names(wrong, dynamics, message):
    with pytest.raises(ValueError, match=message):
        robots.load(wrong, dynamics)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('<numeric name="friction"', '<numeric name="frictoin"', 'bad.xml: <custom> lacks <numeric name="friction"'),
        ('name="radius" data="0.16"', 'name="radius" data="-1"', "bad.xml: the numeric radius is -1"),
        ("</custom>", '<numeric name="max_deceleration" data="-2"/></custom>', "the numeric max_deceleration is -2"),
        ("</worldbody>", "", r"bad.xml:68:3: is not XML: mismatched tag\.$"),
        ('pos="0 0 0.405"', 'pos="0.1 0 0.405"', "bad.xml: the centre of mass"),
        (
            '<joint name="y" type="slide"',
            '<joint name="y" type="hinge"',
            r"bad.xml: a robot must be a base with .*, but joint 'y' is a hinge and not a slide \(see .*\)\.$",
        ),
        ('kv="0.2"', 'kv="0.2" gear="2"', r"but the gear of an actuator is not 1 \(see"),
        ('kv="0.2"', 'kv="0.2" ctrlrange="-1 1"', r"but its actuators have a ctrlrange, .*; use the numeric max_speed"),
        ("<velocity name", '<general biastype="none" dyntype="filter" name', "but its actuators are no"),
        ("<velocity name", '<general gainprm="0.2" biasprm="0 0 -0.2" biastype="affine" dyntype="filter" '
         'dynprm="1" name', "but its actuators are not of the kind that <velocity> makes"),
        ("<velocity name", '<general gainprm="0.2" biasprm="0 0 -0.2" biastype="affine" gaintype="affine" name',
         "but its actuators are not of the kind that <velocity> makes"),
        ("<velocity name", '<general gainprm="0.2" biasprm="0 0 -0.2" biastype="none" name',
         "but its actuators are not of the kind that <velocity> makes"),
        ('<joint name="x" type', '<joint name="x" actuatorfrcrange="-1 1" type', "joint 'x' has an actuatorfrcrange"),
        ('<body name="base">', '<body name="base" gravcomp="1">', "but one of its bodies has a gravcomp"),
        ("<option ", '<option density="1.2" ', "but its <option> has a density"),
        ("<option ", '<option viscosity="1e-5" ', "but its <option> has a viscosity"),
        ('type="cylinder" size="0.035 0.01" zaxis="0 1 0" mass="0.1"', 'type="box" size="0.05 0.01 0.05" mass="0.1"',
         "first geom of its left wheel is a box and not a cylinder or a sphere, the first .* right wheel is a box"),
        ('<geom name="right_wheel"/>', '<geom name="right_wheel" size="0.04 0.01"/>',
         "but the radii of its wheels are 0.035 m and 0.04 m, not the same"),
        ('<geom name="right_wheel"/>', '<inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/>',
         "but its right wheel has no geom"),
        ('pos="0 0.0875 0.035"', 'pos="0.02 0.0875 0.035"', "its wheels lie 0.02 m and 0 m ahead of the base's hinge"),
        ('pos="0 0.0875 0.035"', 'pos="0 0.0875 99"', "its left wheel begins 98.97 m above the floor"),
        ('0.0875 0.035"', '5 0.035"', "its left wheel is 5 m from the base's hinge, beyond its radius of 0.16 m, "),
        ('<geom name="left_wheel"/>', '<geom name="left_wheel" pos="0 0 0.3"/>', "wheel is not round about its hinge"),
        ('zaxis="0 1 0" mass', 'zaxis="1 0 0" mass', "first geom of its left wheel is not round about its hinge"),
        ('zaxis="0 1 0" mass="0.1"', 'zaxis="0 1 0" mass="1e-9"', "its left wheel has 1e-09 kg, less than 0.001 kg"),
        ('mass="', 'mass="1e-6" user="', "its base has 7e-06 kg, less than 0.001 kg, its left wheel has 1e-06 kg"),
        ('mass="', 'mass="0" user="', "mass and inertia of moving bodies must be larger"),
        ('data="0.5"', 'data="0.5 7 9"', 'the numeric max_speed is "0.5 7 9", 3 numbers; give one'),
        ('data="0.5"', 'data="0.5" size="2"', 'the numeric max_speed is "0.5 0", 2 numbers; give one'),
        ('0 0.9962" fovy="60"', '0 0.9962" fovy="-60"', "fovy of camera 'depth' is -60, but must be more than 0"),
        ('fovy="81.2"', 'fovy="180"', "fovy too large in camera 'overhead'"),
        ('<joint name="x" type', '<joint name="x" damping="1" type', r"but joint 'x' has a damping \(see"),
        ('<body name="base">', '<body name="base" euler="0 0.1 0">', r"but its base is tilted by 5.73 degrees \(see"),
        (
            '<joint name="y" type="slide" axis="0 1 0"',
            '<joint name="y" type="slide" axis="0 0 1"',
            r"the axis of joint 'y' is \(0 0 1\), not y \(see",
        ),
    ],
)  # fmt: skip
def test_bad_files_are_refused_in_one_sentence(tmp_path, old, new, message):
    text = robots.ROBOTS["kuri"].read_text()
    assert old in text
    path = tmp_path / "bad.xml"
    path.write_text(text.replace(old, new))
    with pytest.raises(ValueError, match=message) as error:
        robots.load(path)
    assert "\n" not in str(error.value)


def test_a_urdf_file_is_refused_as_one(tmp_path):
    (tmp_path / "box.urdf").write_text(urdf(BASE))
    with pytest.raises(
        FileError, match=r"box.urdf:2: is URDF and not MJCF; sean import-robot makes a robot file of it\.$"
    ):
        robots.load(tmp_path / "box.urdf")


def test_wheels_are_accepted_where_they_stand_between_the_base_and_the_floor_and_nowhere_else(tmp_path):
    """Random places, against what the places themselves say."""
    random, text, accepted = np.random.default_rng(0), robots.ROBOTS["kuri"].read_text(), 0
    for _ in range(200):
        half, radius = random.uniform(0.02, 0.3), random.uniform(0.02, 0.1)
        lowest = random.choice([0.0, random.uniform(-0.02, 0.02)])
        changed = text.replace('0.0875 0.035"', f'{half} {radius + lowest}"').replace(
            'size="0.035 ', f'size="{radius} '
        )
        (tmp_path / "own.xml").write_text(changed)
        right = half <= 0.16 and abs(lowest) <= 5e-3
        with contextlib.nullcontext() if right else pytest.raises(FileError, match="its (left|right) wheel"):
            robots.load(tmp_path / "own.xml", "twin")
        accepted += right
    assert 30 < accepted < 170


def test_all_that_is_missing_is_said_at_once(tmp_path):
    text = robots.ROBOTS["kuri"].read_text()
    for name in ("friction", "max_speed"):
        text = text.replace(f'<numeric name="{name}"', f'<numeric name="no_{name}"')
    text = text.replace('<joint name="y" type="slide"', '<joint name="y" type="hinge"')
    path = tmp_path / "bad.xml"
    path.write_text(text.replace('<joint name="x" type="slide"', '<joint name="x" type="hinge"'))
    with pytest.raises(ValueError) as error:
        robots.load(path)
    said = str(error.value)
    figures = '<numeric name="max_speed" data="..."/> and <numeric name="friction" data="..."/>, which'
    for words in (figures, "joint 'x' is a hinge", "joint 'y' is a hinge"):
        assert words in said, said
    assert "\n" not in said


def moved(text, generator, nested):
    """The robot of an MJCF file with its base body raised, shifted and turned, its sensors on bodies on the base.

    All else is lowered by as much as the base is raised, so it is the same robot.
    """
    flat, tree = mujoco.MjModel.from_xml_string(text), ElementTree.fromstring(text)
    base = next(body for body in tree.iter("body") if body.get("name") == "base")
    raised, turn = generator.uniform(-0.5, 0.5), generator.uniform(-np.pi, np.pi)
    for part in base:
        if part.tag in ("geom", "body", "site", "camera", "inertial"):
            place = np.array(part.get("pos", "0 0 0").split(), float) - [0.0, 0.0, raised]
            part.set("pos", " ".join(map(repr, place.tolist())))
    x, y = generator.uniform(-2.0, 2.0, 2)
    base.set("pos", f"{x} {y} {raised}")
    base.set("quat", f"{np.cos(turn / 2)} 0 0 {np.sin(turn / 2)}")
    if not nested:
        return ElementTree.tostring(tree, "unicode")
    for number, part in enumerate([part for part in base if part.tag in ("site", "camera")]):
        item = flat.site(part.get("name")) if part.tag == "site" else flat.camera(part.get("name"))
        base.remove(part)
        at, quat = generator.uniform(-0.3, 0.3, 3), generator.normal(size=4)
        quat /= np.linalg.norm(quat)
        place, inverse, turned = np.zeros(3), np.zeros(4), np.zeros(4)
        mujoco.mju_negQuat(inverse, quat)
        mujoco.mju_rotVecQuat(place, item.pos - [0.0, 0.0, raised] - at, inverse)
        mujoco.mju_mulQuat(turned, inverse, item.quat)
        for key in ("euler", "xyaxes", "zaxis", "axisangle", "quat"):
            part.attrib.pop(key, None)
        part.set("pos", " ".join(map(repr, place.tolist())))
        part.set("quat", " ".join(map(repr, turned.tolist())))
        words = [" ".join(map(repr, values.tolist())) for values in (at, quat)]
        mast = ElementTree.SubElement(base, "body", name=f"mast_{number}", pos=words[0], quat=words[1])
        mast.append(part)
    return ElementTree.tostring(tree, "unicode")


@pytest.mark.parametrize("name", robots.ROBOTS)
def test_a_raised_base_and_nested_bodies_make_the_same_robot(name, tmp_path):
    """Sensors, looks and figures are those of the flat file, wherever in it the base body and the mounts stand."""
    generator, text = np.random.default_rng(5), robots.ROBOTS[name].read_text()
    flat = robots.load(name, "twin")
    for turn in range(4):
        path = tmp_path / f"{name}.xml"
        path.write_text(moved(text, generator, nested=turn % 2 == 1))
        other = robots.load(path, "twin")
        assert {mount.name for mount in other.mounts} == {mount.name for mount in flat.mounts}
        for mount in other.mounts:
            same = next(each for each in flat.mounts if each.name == mount.name)
            np.testing.assert_allclose(mount.origin, same.origin, atol=1e-6)
            np.testing.assert_allclose(mount.axes, same.axes, atol=1e-6)
            assert mount.fovy == same.fovy
        trees.assert_close(other, flat, rtol=1e-5, atol=2e-6)


def test_a_site_is_where_and_as_it_is_turned_and_never_on_a_wheel(tmp_path):
    text = robots.ROBOTS["kuri"].read_text()
    turned = text.replace('<site name="lidar"', '<site name="lidar" euler="0 0.3 0.5"')
    assert turned != text
    path = tmp_path / "turned.xml"
    path.write_text(turned)
    (mount,) = [mount for mount in robots.load(path, "twin").mounts if mount.name == "lidar"]
    wanted = mujoco.MjModel.from_xml_string(turned)
    data = mujoco.MjData(wanted)
    mujoco.mj_forward(wanted, data)
    np.testing.assert_allclose(mount.axes, data.site("lidar").xmat, atol=1e-6)
    np.testing.assert_allclose(mount.origin, data.site("lidar").xpos, atol=1e-6)
    path.write_text(text.replace("</worldbody>", '<site name="beacon" pos="1 0 1"/></worldbody>'))
    with pytest.raises(ValueError, match="site 'beacon' must be on the base, not on a wheel or in the world"):
        robots.load(path)


def test_control_step_must_be_a_multiple_of_the_physics_step(twin):
    with pytest.raises(ValueError, match="no multiple"):
        run(twin.replace(time_step=0.03), [[0.1, 0.0]])


@pytest.mark.slow
def test_mjx_is_imported_only_for_an_mjx_robot():
    code = """
import sys
import jax, sean_jax
from sean_jax import robots
scenario = sean_jax.make("lab", people=2, behavior="random", task="random_ab_nav", metrics="none")
state = jax.eval_shape(sean_jax.reset, scenario, jax.random.key(0))
jax.eval_shape(sean_jax.step, scenario, state, jax.ShapeDtypeStruct((2,), "float32"))
assert "mujoco.mjx" not in sys.modules
robots.load("kuri", "mjx")
assert "mujoco.mjx" in sys.modules
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
