"""Articulated bodies: against plain MuJoCo under the same controller; walls, people, falls, refusals, programs."""

from dataclasses import replace
from importlib import import_module
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sean_jax
from sean_jax import robots, sensors
from support import driving, robot_files
from support.driving import PERSON_RADIUS, TIME_STEP
from support.robot_files import CRAWLER, LEGS, ROVER

mujoco: Any = import_module("mujoco")  # which has no type stubs
RADIUS = 0.3


def wheels(command, data, memory):
    """Wheel speeds of a differential drive, and an arm that swings; the memory counts the calls."""
    rim = 0.16 * command[1]
    arm = 0.8 * jnp.sin(3.0 * data.time)
    return jnp.stack([(command[0] - rim) / 0.1, (command[0] + rim) / 0.1, arm]), memory + 1


def trot(command, data, memory):
    """An open-loop gait: diagonal legs swing together; the stride is proportional to the speed ahead."""
    phase = 2.0 * jnp.pi * 2.0 * data.time
    ctrl = []
    for name, (_, y) in LEGS.items():
        own = phase + (0.0 if name in ("fl", "rr") else jnp.pi)
        ctrl += [jnp.sign(y) * 2.0 * command[0] * jnp.cos(own), 0.5 * jnp.maximum(jnp.sin(own), 0.0)]
    return jnp.stack(ctrl), memory


def write(folder, text, name="body.xml"):
    path = folder / name
    path.write_text(text)
    return path


def rover_of(folder, text=ROVER, **options):
    given = {"radius": RADIUS, "max_speed": 1.0, "max_turn_rate": 2.0, "memory": 0, **options}
    return robots.articulated(write(folder, text), wheels, **given)


@pytest.fixture(scope="module")
def rover(tmp_path_factory):
    return rover_of(tmp_path_factory.mktemp("rover"))


def obstacles(*boxes):
    """Two boxes (x, y, half extents, yaw), the missing ones far away."""
    return driving.obstacles(boxes, 2)


def rollout(model, boxes, person, walk, robot, actions):
    """Robots after each action (T, 2 or 3), with one person at a place who walks at a velocity."""
    TRACES.append(model.name)

    def one(carry, action):
        robot, place = carry
        place = place + TIME_STEP * walk
        robot = driving.drive(model, robot, action, boxes, place[None], walk[None], jnp.ones(1, bool))
        return (robot, place), (robot, place)

    return jax.lax.scan(one, (robot, person), actions)[1]


TRACES: list[str] = []
program = jax.jit(jax.vmap(rollout, (None, None, None, None, None, 0)))  # of three sequences of actions
STEPS, COMMAND = 30, jnp.asarray([0.5, 0.8])
place = jax.jit(lambda model, position, heading: model.place(model, position, heading))


def placed(model, x=0.0, y=0.0, yaw=0.0):
    return place(model, jnp.asarray([x, y], float), jnp.asarray([np.cos(yaw), np.sin(yaw)], float))


def run(model, command, boxes=None, person=(80.0, 80.0), walk=(0.0, 0.0), start=None):
    """Robots and the person after each of 30 steps, as numpy arrays; one command, or (30, n)."""
    actions = jnp.broadcast_to(jnp.asarray(command, float), (3, STEPS, len(np.asarray(command).T)))
    spot, velocity = (jnp.asarray(each, float) for each in (person, walk))
    out = program(model, boxes or obstacles(), spot, velocity, start or placed(model), actions)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[0], out)


def in_mujoco(text, controller, targets, memory=()):
    """qpos (T, nq) and qvel of C MuJoCo after each control step under the commands (T, n) of the controller."""
    model = mujoco.MjModel.from_xml_string(text)
    data, result = mujoco.MjData(model), []
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    for target in targets:
        for index in range(round(TIME_STEP / model.opt.timestep)):
            mujoco.mj_step1(model, data)
            if index % 4 == 0:  # each 0.02 s
                data.ctrl[:], memory = controller(target, data, memory)
            mujoco.mj_step2(model, data)
        result.append((data.qpos.copy(), data.qvel.copy()))
    return tuple(map(np.array, zip(*result, strict=True)))


def gap(position, box):
    """m from the disc at each position (T, 2) to an upright box."""
    outside = np.maximum(np.abs(position - np.array(box[:2])) - np.array(box[2:4]), 0.0)
    return np.linalg.norm(outside, axis=1) - RADIUS


@pytest.mark.night
def test_a_body_moves_as_in_mujoco(tmp_path):
    commands = np.repeat([[0.5, 0.0], [0.8, 1.5], [-0.4, -1.0]], STEPS // 3, 0)
    with jax.enable_x64(True):
        moved, _ = run(rover_of(tmp_path), commands)
        qpos, qvel = in_mujoco(ROVER, wheels, moved.drive_state.target, 0)
    np.testing.assert_allclose(moved.drive_state.physics["qpos"], qpos, atol=1e-10)
    np.testing.assert_allclose(moved.position, qpos[:, :2], atol=1e-10)
    base = Rotation.from_quat(qpos[:, 3:7], scalar_first=True)
    ahead = base.apply([1.0, 0.0, 0.0])[:, :2]
    ahead /= np.linalg.norm(ahead, axis=1)[:, None]
    np.testing.assert_allclose(moved.heading, ahead, atol=1e-10)
    np.testing.assert_allclose(moved.speed, (qvel[:, :2] * ahead).sum(1), atol=1e-9)
    np.testing.assert_allclose(moved.turn_rate, base.apply(qvel[:, 3:6])[:, 2], atol=1e-9)
    assert moved.speed[9] == pytest.approx(0.5, abs=0.05)
    assert moved.drive_state.memory.tolist() == [5 * step for step in range(1, STEPS + 1)]
    assert not moved.drive_state.fallen.any()


@pytest.mark.slow
def test_the_position_is_that_of_mujoco_in_single_precision_too(rover):
    moved, _ = run(rover, (0.5, 0.8))
    qpos, _ = in_mujoco(ROVER, wheels, moved.drive_state.target, 0)
    np.testing.assert_allclose(moved.position, qpos[:, :2], atol=2e-4)


@pytest.mark.slow
def test_the_command_stays_within_the_limits_and_ends_at_its_timeout(rover):
    commands = np.full((STEPS, 2), np.nan)
    commands[:6] = 5.0, 9.0
    target = run(rover, commands)[0].drive_state.target
    change = np.diff(target, axis=0, prepend=0.0) / TIME_STEP
    assert (np.abs(change) <= np.array([2.0, 4.0]) + 1e-4).all()
    np.testing.assert_allclose(target[5:8], [[1.0, 2.0]] * 3, atol=1e-6)  # 0.25 s are two control steps
    np.testing.assert_allclose(target[-1], 0.0, atol=1e-6)


def test_a_wall_stops_the_body_which_slides_along_it(rover):
    wall = (1.3, 0.0, 0.5, 5.0, 0.0)  # its face is x = 0.8
    straight, _ = run(rover, (0.6, 0.0), obstacles(wall))
    assert gap(straight.position, wall).min() > -1e-4
    np.testing.assert_allclose(straight.position[-1], [0.5, 0.0], atol=0.02)
    oblique, _ = run(rover, (0.6, 0.0), obstacles(wall), start=placed(rover, yaw=0.9))
    assert gap(oblique.position, wall).min() > -1e-4
    assert oblique.position[-1, 1] > 0.8


def test_a_person_is_not_pushed_and_pushes_the_body_but_not_into_a_wall(rover):
    there = (1.0, 0.1)
    moved, person = run(rover, (0.6, 0.0), person=there)
    np.testing.assert_array_equal(person, np.broadcast_to(np.asarray(there, person.dtype), person.shape))
    assert np.linalg.norm(moved.position - person, axis=1).min() > RADIUS + PERSON_RADIUS - 1e-3
    wall = (-1.0, 0.0, 0.5, 5.0, 0.0)
    pushed, _ = run(rover, (0.0, 0.0), obstacles(wall), person=(1.5, 0.0), walk=(-0.8, 0.0))
    assert pushed.position[:, 0].min() < -0.15
    assert gap(pushed.position, wall).min() > -1e-4
    assert not pushed.drive_state.fallen.any()


def test_a_body_that_falls_stays_where_it_lies(tmp_path):
    model = rover_of(tmp_path, robot_files.ROVER_WITH_CASTER_UP, max_tilt=0.3)
    moved, _ = run(model, (0.8, 0.5), person=(0.6, 0.0), walk=(-0.5, 0.0))
    fallen = moved.drive_state.fallen
    first = int(fallen.argmax())
    assert fallen.any() and fallen[first:].all()
    up = 1.0 - 2.0 * (moved.drive_state.physics["qpos"][:, 4:6] ** 2).sum(1)
    assert (up[:first] >= np.cos(0.3)).all() and up[first] < np.cos(0.3)
    for leaf in jax.tree.leaves((moved.position, moved.heading, moved.drive_state.physics)):
        np.testing.assert_array_equal(leaf[first:], np.broadcast_to(leaf[first], leaf[first:].shape))
    assert not moved.speed[first:].any() and not moved.turn_rate[first:].any()


@pytest.mark.night
def test_a_body_whose_physics_diverge_has_fallen_and_stays_finite(rover):
    robot = placed(rover)
    physics = {**robot.drive_state.physics, "qvel": robot.drive_state.physics["qvel"].at[8].set(1e30)}
    moved, _ = run(rover, (0.5, 0.0), start=replace(robot, drive_state=robot.drive_state._replace(physics=physics)))
    assert moved.drive_state.fallen.all() and not moved.speed.any()
    for leaf in jax.tree.leaves(moved):
        assert np.isfinite(leaf).all()


@pytest.mark.night
def test_physics_go_on_from_a_pose_that_is_replaced_in_the_same_program(rover):
    """A body turned and shifted halfway moves on as before, turned and shifted."""
    first, _ = run(rover, COMMAND)
    half = jax.tree.map(lambda leaf: jnp.asarray(leaf[9]), first)
    turn, there = np.array([[0.0, -1.0], [1.0, 0.0]]), np.array([3.0, 2.0])
    shifted = replace(half, position=jnp.asarray(there, float), heading=jnp.asarray(turn @ half.heading, float))
    traces = len(TRACES)
    one, other = run(rover, COMMAND, start=half)[0], run(rover, COMMAND, start=shifted)[0]
    assert len(TRACES) == traces
    np.testing.assert_allclose(one.position[:20], first.position[10:], atol=1e-3)
    moved = (one.position - np.asarray(half.position)) @ turn.T
    np.testing.assert_allclose((other.position - there)[:20], moved[:20], atol=1e-3)
    np.testing.assert_allclose(other.heading[:20], (one.heading @ turn.T)[:20], atol=2e-3)
    quicker = replace(half, speed=jnp.asarray(0.9, float))
    assert run(rover, COMMAND, start=quicker)[0].position[0] @ half.heading > one.position[0] @ half.heading + 0.01


def test_rows_of_a_batch_are_as_each_alone(rover):
    random, wall = np.random.default_rng(0), obstacles((1.3, 0.0, 0.5, 5.0, 0.0))
    actions = jnp.asarray(random.uniform(-1.0, 1.0, (3, STEPS // 10, 2)).repeat(10, 1) * [1.0, 2.0], float)
    traces, away, still = len(TRACES), jnp.asarray([80.0, 80.0], float), jnp.zeros(2, float)
    batch, _ = program(rover, wall, away, still, placed(rover), actions)
    alone, _ = run(rover, actions[1], wall)
    np.testing.assert_allclose(batch.position[1], alone.position, atol=1e-3)
    np.testing.assert_allclose(batch.heading[1], alone.heading, atol=5e-3)
    assert len(TRACES) == traces and np.ptp(batch.position[:, -1], axis=0).max() > 0.1


@pytest.mark.night
def test_derivatives_are_finite_and_those_through_mjx_are_zero(rover):
    def end(place, command):
        start, away = replace(placed(rover), position=place), jnp.full(2, 80.0)
        moved, _ = rollout(rover, obstacles(), away, jnp.zeros(2, float), start, command[None])
        return moved.position[-1].sum()

    place, command = jax.jit(jax.grad(end, (0, 1)))(jnp.zeros(2, float), COMMAND)
    np.testing.assert_allclose(place, 1.0, atol=1e-5)
    np.testing.assert_array_equal(command, 0.0)


@pytest.mark.night
def test_a_scenario_with_policy_sensors_and_metrics(rover):
    scenario = sean_jax.make("lab", people=4, robot=rover, sensors=["lidar"], metrics=["path_length"], time_limit=10.0)
    evaluation = sean_jax.evaluate(scenario, "go_to_goal", episodes=2, seed=0)
    assert "completed" in evaluation.table()
    assert (np.asarray(evaluation.metrics["path_length"])[:, 0] > 1.0).all()  # m, in all of the time
    state = jax.jit(sean_jax.reset)(scenario, jax.random.key(1))
    assert np.isfinite(jax.jit(sensors.sense)(scenario, state)["lidar"]).all()


@pytest.mark.night
def test_a_crawler_walks_as_in_mujoco(tmp_path):
    path = write(tmp_path, CRAWLER)
    limits = {"max_speed": 0.2, "max_lateral_speed": 0.1, "max_turn_rate": 1.0}
    with jax.enable_x64(True):
        moved, _ = run(robots.articulated(path, trot, radius=0.25, **limits), (0.2, 0.0, 0.0))
        qpos, _ = in_mujoco(robot_files.CRAWLER_ON_THE_GROUND, trot, moved.drive_state.target)
    np.testing.assert_allclose(moved.drive_state.physics["qpos"], qpos, atol=1e-8)
    assert moved.position[-1, 0] > 0.3
    assert not moved.drive_state.fallen.any()


@pytest.mark.parametrize(("text", "words"), robot_files.REFUSED_ROVERS)
def test_bad_files_are_refused_in_one_sentence(tmp_path, text, words):
    with pytest.raises(ValueError, match=words) as caught:
        rover_of(tmp_path, text)
    assert str(tmp_path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"control_period": 0.012}, "control_period: 0.012 s is no multiple of the timestep"),
        ({"radius": 0.0}, "radius"),
        ({"memory": {"step": 0}, "controller": lambda command, data, memory: (jnp.zeros(3), 0)}, "a memory that is"),
        ({"controller": lambda command, data, memory: (command, memory)}, r"float32 \(2,\), not float \(3,\)"),
        ({"controller": lambda command, data, memory: command}, "not a control and a memory"),
    ],
)
def test_bad_arguments_are_refused_in_one_sentence(tmp_path, options, words):
    given = {"controller": wheels, "radius": 0.3, "max_speed": 1.0, "max_turn_rate": 1.0, "memory": 0} | options
    with pytest.raises(ValueError, match=words):
        robots.articulated(write(tmp_path, ROVER), **given)


def test_a_ground_is_added_where_there_is_none(rover, tmp_path):
    model = rover_of(tmp_path, robot_files.ROVER_IN_THE_AIR)
    np.testing.assert_allclose(run(model, (0.5, 0.3))[0].position, run(rover, (0.5, 0.3))[0].position, atol=1e-4)


def test_a_mesh_without_contacts_is_left_out_so_its_file_may_be_missing(tmp_path):
    assert rover_of(tmp_path, robot_files.ROVER_OF_A_MESH).mass == pytest.approx(7.3)
    with pytest.raises(ValueError, match="none.stl"):
        rover_of(tmp_path, robot_files.ROVER_OF_A_TOUCHING_MESH)
