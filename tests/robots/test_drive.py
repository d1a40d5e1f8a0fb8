"""Drives: omnidirectional robots and cars by MJX, by the closed form, and by plain float64 loops of numpy."""

import functools
import re
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import mdp, robots
from sean_jax.core import geometry
from sean_jax.core.data_types import Trajectory
from sean_jax.core.errors import FileError, InputError
from sean_jax.io import trajectories
from sean_jax.learning.policy import load_policy
from sean_jax.policies import POLICIES
from sean_jax.robots import drive
from sean_jax.simulation import episodes
from support import driving, scenes
from support.driving import TIME_STEP

STEPS = 200
ROBOT_OF = {"omnidirectional": "hsr", "ackermann": "f1tenth"}
FIGURES = {  # mass, radius, greatest speed, acceleration; then greatest speed to the left, or wheelbase and angle
    "a1": (12.45, 0.29, 1.0, 3.0, 1.0),
    "hsr": (37.0, 0.215, 0.22, 0.5, 0.22),
    "f1tenth": (3.74, 0.33, 2.0, 3.0, 0.3302, 0.4189),
}


def advance(model, robot, action, boxes):
    """One control step without people."""
    nobody = jnp.zeros((0, 2))
    return driving.drive(model, robot, action, boxes, nobody, nobody, jnp.zeros(0, bool))


@jax.jit
def rollout(model, boxes, start, actions):
    def one(robot, action):
        robot = advance(model, robot, action, boxes)
        return robot, robot

    robot = model.place(model, start[:2], jnp.stack([jnp.cos(start[2]), jnp.sin(start[2])]))
    return jax.lax.scan(one, robot, actions)[1]


def run(model, actions, walls=(), start=(0.3, -0.2, 0.7)):
    """Robots after each of at most STEPS actions, as numpy arrays; at most one wall (x, y, half extents)."""
    boxes = driving.obstacles([(*wall, 0.0) for wall in walls], 2)
    actions, number = np.asarray(actions), jnp.result_type(float)
    padded = np.concatenate([actions, np.repeat(actions[-1:], STEPS - len(actions), 0)])
    robots_after = rollout(model, boxes, np.asarray(start, number), padded.astype(number))
    return jax.tree.map(lambda leaf: np.asarray(leaf)[: len(actions)], robots_after)


def wild(model, seed=0):
    """Random commands beyond all limits, each for some steps; some are not finite, and some are rest."""
    generator = np.random.default_rng(seed)
    size = drive.command_size(model)
    most = [
        float(model.max_speed),
        *([float(model.lateral.max_speed)] if size == 3 else []),
        float(model.max_turn_rate),
    ]
    actions = np.repeat(1.3 * generator.uniform(-1, 1, (STEPS // 4, size)) * most, 4, 0)
    actions[40:46] = 0.0
    actions[90:100] = np.nan
    actions[120:124, -1] = 0.0
    return actions


def by_hand(model, actions, start=(0.3, -0.2, 0.7), inertia=True):
    """(T, 3) x, y, yaw, and (T, 3) speed ahead, to the left and turn rate, of a numpy loop in float64."""
    loop = omni_by_hand if drive.command_size(model) == 3 else car_by_hand
    return loop(model, actions, np.array(start, float), inertia)


def active(model, actions):
    """Finite commands: the last one for its time, then rest."""
    limit = float(model.command_timeout) / TIME_STEP + 1e-4  # whole control steps that fit
    last, age = np.zeros(actions.shape[1]), 0
    for action in actions:
        if np.isfinite(action).all():
            last, age = action, 0
        else:
            age += 1
        yield last if age <= limit else np.zeros_like(last)


def turned(vector, angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])


def clip_length(vector, limit):
    return vector * min(1.0, limit / max(np.linalg.norm(vector), 1e-30))


def omni_by_hand(model, actions, pose, inertia):
    lateral = model.lateral
    top = np.array([model.max_speed, lateral.max_speed, model.max_turn_rate], float)
    change = TIME_STEP * np.array(
        [model.max_acceleration, lateral.max_acceleration, model.max_turn_acceleration], float
    )
    gain = np.array([model.servo_gain, model.servo_gain, lateral.turn_gain], float)
    force = np.array([model.servo_torque, model.servo_torque, lateral.turn_torque], float)
    mass = np.array([model.mass, model.mass, model.inertia], float)
    step, grip = model.time_step, float(model.friction) * 9.81 * model.time_step
    own, world, out = np.zeros(3), np.zeros(3), []
    for command in active(model, actions):
        target = np.clip(np.clip(command, own - change, own + change), -top, top)
        for index in range(5):
            if not inertia:
                chord = target[:2] * np.sinc(step * target[2] / 2 / np.pi)
                pose[:2] += step * turned(chord, pose[2] + (index + 0.5) * step * target[2])
                continue
            here = np.append(turned(world[:2], -pose[2]), world[2])
            push = np.clip(gain * (target - here), -force, force)
            free = world + step * np.append(turned(push[:2], pose[2]), push[2]) / mass
            carried = turned(free[:2], 0.5 * step * (world[2] + free[2]))
            world = np.append(world[:2] + clip_length(carried - world[:2], grip), free[2])
            pose = pose + step * world
        if inertia:
            own = np.append(turned(world[:2], -pose[2]), world[2])
        else:
            own, pose[2] = target, pose[2] + TIME_STEP * target[2]
        out.append((*pose, *own))
    return np.split(np.array(out), 2, axis=1)


def car_by_hand(model, actions, pose, inertia):
    shape = model.steering
    base, rear, most, rate = (float(x) for x in (shape.wheelbase, shape.rear_axle, shape.max_angle, shape.max_rate))
    top, back = float(model.max_speed), float(model.max_reverse_speed)
    mass, turning, radius, wheel = (
        float(x) for x in (model.mass, model.inertia, model.wheel_radius, model.wheel_inertia)
    )
    gain, torque, step = float(model.servo_gain), float(model.servo_torque), model.time_step
    grip = float(model.friction) * mass * 9.81 * step / base
    speed, angle, world, out = 0.0, 0.0, np.zeros(4), []
    for command in active(model, actions):
        wanted = np.clip(command[0], -back, top)
        turn = np.clip(command[1], -float(model.max_turn_rate), float(model.max_turn_rate))
        if wanted == 0.0 and turn == 0.0:
            aim = angle
        elif wanted == 0.0:
            aim = np.copysign(most, turn)
        else:
            aim = np.clip(np.arctan(base * turn / wanted), -most, most)
        change = float(model.max_acceleration) * TIME_STEP
        target = np.clip(wanted, speed - change, speed + change)
        aim = np.clip(aim, angle - rate * TIME_STEP, angle + rate * TIME_STEP)
        for index in range(5):
            if not inertia:
                spin = target * np.tan(aim) / base
                chord = np.array([target, rear * spin]) * np.sinc(step * spin / 2 / np.pi)
                pose[:2] += step * turned(chord, pose[2] + (index + 0.5) * step * spin)
                continue
            angle += np.clip(aim - angle, -rate * step, rate * step)
            free = world.copy()
            free[3] += step * np.clip(gain * (target / radius - free[3]), -torque, torque) / wheel
            yaw = pose[2] + 0.5 * step * free[2]
            # Rows: slip of the rear tyre ahead and aside, and of the front tyre across, in the rates of the car.
            ahead, left = turned((1.0, 0.0), yaw), turned((0.0, 1.0), yaw)
            across = turned((0.0, 1.0), yaw + angle)
            slip = np.array([
                (*ahead, 0.0, -radius),
                (*left, -rear, 0.0),
                (*across, (base - rear) * np.cos(angle), 0.0),
            ])  # fmt: skip
            inverse = np.diag(1.0 / np.array([mass, mass, turning, wheel]))
            push = np.linalg.solve(slip @ inverse @ slip.T, -slip @ free)
            push[:2] = clip_length(push[:2], grip * (base - rear))
            push[2] = np.clip(push[2], -grip * rear, grip * rear)
            world = free + inverse @ slip.T @ push
            pose = pose + step * world[:3]
        if inertia:
            ahead, left = turned(world[:2], -pose[2])
            speed = ahead
            out.append((*pose, ahead, left, world[2]))
        else:
            speed, angle = target, aim
            spin = speed * np.tan(angle) / base
            pose[2] += TIME_STEP * spin
            out.append((*pose, speed, rear * spin, spin))
    return np.split(np.array(out), 2, axis=1)


def parts(out):
    """Pose but for the heading, heading, and velocities of robots."""
    velocity = np.stack([out.speed, out.sideways, out.turn_rate], -1)
    return out.position, out.heading, velocity


@pytest.mark.parametrize("dynamics", ["twin", "kinematic"])
@pytest.mark.parametrize("name", FIGURES)
def test_a_robot_moves_as_a_plain_float64_loop(name, dynamics):
    with jax.enable_x64(True):
        model = robots.load(name, dynamics)
        for seed in range(3):
            actions = wild(model, seed)
            position, heading, velocity = parts(run(model, actions))
            pose, expected = by_hand(model, actions, inertia=dynamics == "twin")
            np.testing.assert_allclose(position, pose[:, :2], atol=1e-8)
            np.testing.assert_allclose(heading, np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], -1), atol=1e-8)
            np.testing.assert_allclose(velocity, expected, atol=1e-8)
            assert np.ptp(position, 0).min() > 0.2


@pytest.mark.parametrize("name", ["hsr", "f1tenth", pytest.param("a1", marks=pytest.mark.slow)])
def test_mjx_equals_the_closed_form(name):
    with jax.enable_x64(True):
        twin, mjx = robots.load(name, "twin"), robots.load(name, "mjx")
        actions = wild(twin)
        for one, other in zip(parts(run(twin, actions)), parts(run(mjx, actions)), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-5)


@pytest.mark.parametrize("dynamics", ["twin", pytest.param("kinematic", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["hsr", "f1tenth"])
def test_gradients_are_finite_at_rest_straight_and_at_every_limit(name, dynamics):
    """In all dynamics but MJX, whose derivatives are those of the closed form."""
    model = robots.load(name, dynamics)
    size = drive.command_size(model)

    def end(action, start):
        robot = model.place(model, start, jnp.asarray([1.0, 0.0]))
        robot = advance(model, robot, action, driving.obstacles([], 1))
        return robot.position.sum() + robot.heading[1] + robot.speed + robot.turn_rate + robot.sideways

    slopes = jax.jit(jax.vmap(jax.grad(end, (0, 1)), (0, None)))
    edges = np.array(np.meshgrid(*[[-9.0, -0.1, 0.0, 0.1, 9.0]] * size)).reshape(size, -1).T
    actions = np.concatenate([edges, [[0.02] * size]])  # the last one is within all limits
    by_action, by_start = slopes(jnp.asarray(actions, float), jnp.zeros(2))
    assert np.isfinite(by_action).all() and np.isfinite(by_start).all()
    assert (np.abs(by_action[-1]) > 1e-6).all()


@pytest.mark.parametrize("dynamics", ["twin", "kinematic"])
@pytest.mark.parametrize("name", ["hsr", "f1tenth"])
def test_a_wall_stops_the_robot_which_never_enters_it(name, dynamics):
    model = robots.load(name, dynamics)
    fast = [float(model.max_speed), *[0.0] * (drive.command_size(model) - 1)]
    out = run(model, [fast] * 100, walls=[(2.0, 0.0, 0.5, 3.0)], start=(0.0, 0.0, 0.3))
    gap = 1.5 - out.position[:, 0] - float(model.radius)
    assert gap.min() > -1e-3 and gap[-1] < 0.02 and out.position[-1, 1] > 0.2


def test_an_omnidirectional_robot_drives_sideways_and_a_car_does_not_turn_on_the_spot():
    hsr, car = robots.load("hsr"), robots.load("f1tenth")
    out = run(hsr, [[0.0, 0.2, 0.0]] * 30, start=(0.0, 0.0, 0.0))
    assert out.position[-1, 1] > 0.5 and abs(out.position[-1, 0]) < 1e-3
    out = run(car, [[0.0, 2.0]] * 30)
    assert np.ptp(out.position, 0).max() < 1e-6 and np.ptp(out.heading, 0).max() < 1e-6
    np.testing.assert_allclose(out.drive_state.steering[-1], car.steering.max_angle, rtol=1e-6)


def test_a_car_drives_the_circle_of_its_steering_angle():
    """The middle of its rear axle is on a circle of the radius wheelbase / tan(angle)."""
    model = robots.load("f1tenth")
    angle, speed = 0.3, 0.8
    radius = float(model.steering.wheelbase) / np.tan(angle)
    out = run(model, [[speed, speed / radius]] * 120)
    position, heading = out.position[20:].astype(float), out.heading[20:].astype(float)
    rear = position - float(model.steering.rear_axle) * heading
    matrix = np.column_stack([2 * rear, np.ones(len(rear))])
    x, y, rest = np.linalg.lstsq(matrix, (rear**2).sum(1), rcond=None)[0]
    np.testing.assert_allclose(np.sqrt(rest + x * x + y * y), radius, rtol=0.005)
    np.testing.assert_allclose(out.drive_state.steering[-1], angle, rtol=1e-4)


@pytest.mark.parametrize("name", ["kuri", *FIGURES])
def test_actions_are_shares_of_the_limits(name):
    """Commands keep to the limits, and the action of a command is the one that it came from."""
    model = robots.load(name)
    assert mdp.action_space(model).shape == (3 if name in ("hsr", "a1") else 2,)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (50, drive.command_size(model)))
    commands = np.stack([mdp.to_command(model, jnp.asarray(action)) for action in actions])
    back = np.stack([mdp.to_action(model, jnp.asarray(command)) for command in commands])
    np.testing.assert_allclose(back, actions, atol=2e-5)
    assert (np.abs(commands[:, 0]) <= float(model.max_speed)).all()
    assert (np.abs(commands[:, -1]) <= float(model.max_turn_rate) + 1e-6).all()
    if model.steering is not None:
        angle = np.arctan(float(model.steering.wheelbase) * commands[:, 1] / commands[:, 0])
        np.testing.assert_allclose(angle, actions[:, 1] * float(model.steering.max_angle), atol=1e-5)


def test_figures_of_the_robots():
    for name, (mass, radius, speed, acceleration, *others) in FIGURES.items():
        model = robots.load(name)
        parts = model.mass, model.radius, model.max_speed, model.max_acceleration
        np.testing.assert_allclose([float(part) for part in parts], (mass, radius, speed, acceleration), rtol=1e-6)
        shape = model.steering
        rest = [model.lateral.max_speed] if shape is None else [shape.wheelbase, shape.max_angle]
        np.testing.assert_allclose([float(part) for part in rest], others, rtol=1e-6)
    np.testing.assert_allclose(float(robots.load("f1tenth").inertia), 0.04712, rtol=1e-4)


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("hsr", 'data="omnidirectional"', 'data="mecanum"', 'the text drive is "mecanum"'),
        ("hsr", 'gear="0 1 0 0 0 0"', 'gear="0 2 0 0 0 0"', "gears of its actuators"),
        ("hsr", 'name="max_lateral_speed"', 'name="other"', "max_lateral_speed"),
        ("hsr", 'site name="drive" pos="0 0 0.05"', 'site name="drive" pos="0.1 0 0.05"', "is not at the base's hinge"),
        ("f1tenth", 'name="wheelbase" data="0.3302"', 'name="wheelbase" data="0.1"', "less than the wheelbase"),
        (
            "f1tenth",
            'name="max_steering_angle" data="0.4189"',
            'name="max_steering_angle" data="2"',
            "from 0.01 to 1.5",
        ),
        ("f1tenth", 'data="ackermann"', 'data="differential"', "4 joints and not 5"),
        ("f1tenth", '<inertial pos="0.020533 0 0.08"', '<inertial pos="0.1 0 0.08"', "centre of mass"),
    ],
)
def test_bad_files_are_refused_in_one_sentence(tmp_path, name, old, new, words):
    text = robots.ROBOTS[name].read_text()
    assert old in text
    path = tmp_path / "robot.xml"
    path.write_text(text.replace(old, new))
    with pytest.raises(FileError, match=re.escape(words)) as caught:
        robots.load(path)
    assert "\n" not in str(caught.value)


def test_robots_of_two_drives_are_no_one_program():
    with pytest.raises(InputError, match="differential and omnidirectional; robots of one program need the same drive"):
        robots.alike([robots.load("kuri"), robots.load("hsr")])


@pytest.mark.parametrize("name", ["orca", "dwa", "social_force", "social_costmap", "move_base", "ppo"])
def test_a_policy_that_cannot_drive_a_car_says_so(name, room):
    scenario, state = room("f1tenth")
    with pytest.raises(InputError, match="the drive of f1tenth is ackermann"):
        policy = load_policy(name, scenario)
        begin = functools.partial(episodes.init_policy, scenario, policy)
        jax.eval_shape(lambda state: episodes.simulate(scenario, policy, begin(state), 1), state)


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """A function: name of a robot -> it alone in a room of 10 x 8 m, with random tasks; the shapes of its states."""
    folder = scenes.room(tmp_path_factory.mktemp("room"), (-5, -4, 5, 4), [scenes.box((4.7, 3.7), (0.2, 0.2))])

    @functools.cache
    def make(name):
        scenario = sean_jax.make(folder, behavior="random", task="random_ab_nav", people=1, robot=name, dynamics="twin")
        empty = jnp.zeros((), jnp.int32)
        alone = replace(scenario, people_present=empty, metrics=(), situations=scenario.situations[-1:])
        return alone, jax.eval_shape(functools.partial(sean_jax.reset, alone), jax.random.key(0))

    return make


POLICIES_OF = [
    pytest.param("f1tenth", "go_to_goal", marks=pytest.mark.slow),
    pytest.param("hsr", "go_to_goal", marks=pytest.mark.slow),
    pytest.param("a1", "orca", marks=pytest.mark.night),
    pytest.param("a1", "sensing_expert", marks=pytest.mark.slow),
    pytest.param("a1", "expert", marks=pytest.mark.night),
    pytest.param("f1tenth", "expert", marks=pytest.mark.night),
    pytest.param("a1", "dwa", marks=pytest.mark.night),
    pytest.param("a1", "social_force", marks=pytest.mark.night),
    pytest.param("a1", "mppi", marks=pytest.mark.night),
    pytest.param("f1tenth", "mppi", marks=pytest.mark.night),
]


@pytest.mark.parametrize(("robot", "name"), POLICIES_OF)
def test_goals_everywhere_are_reached_from_any_heading(robot, name, room):
    """In an empty room; goals lie behind and beside the robot as often as ahead."""
    (scenario, _), policy = room(robot), POLICIES[name]
    episodes_, steps = (60, 700) if robot == "hsr" else (32, 400) if name == "go_to_goal" else (16, 400)

    @jax.jit
    @jax.vmap
    def one(key):
        state = episodes.init_policy(scenario, policy, sean_jax.reset(scenario, key))
        last, frames = episodes.simulate(scenario, policy, state, steps)
        gap, heading = state.task.goal - state.robot.position, state.robot.heading
        return last.completed, gap @ heading, frames.action

    completed, ahead, actions = one(jax.random.split(jax.random.key(5), episodes_))
    assert (np.asarray(ahead) < 0.0).mean() > 0.25
    assert np.asarray(completed).mean() > 0.95
    if robot == "f1tenth":
        assert (np.asarray(actions)[..., 0] < 0.0).any()  # it backs up


def test_tables_keep_the_commands_of_an_omnidirectional_robot(tmp_path):
    random, ahead = np.random.default_rng(0), np.tile(np.array([1.0, 0.0], np.float32), (4, 1))
    frames = Trajectory(
        position=random.normal(size=(4, 2)).astype(np.float32),
        heading=ahead,
        velocity=ahead,
        action=random.normal(size=(4, 3)).astype(np.float32),
        people=np.zeros((4, 1, 2), np.float32),
        people_velocity=np.zeros((4, 1, 2), np.float32),
        people_heading=ahead[:, None],
        group=np.full((4, 1), -1),
        present=np.ones((4, 1), bool),
        goal=ahead,
        situations=np.zeros((4, 1), bool),
        active=np.ones(4, bool),
    )
    trajectories.save_trajectory(frames, tmp_path / "walk.csv")
    again = trajectories.load_trajectory(tmp_path / "walk.csv")
    for name in ("action", "position", "goal"):
        np.testing.assert_array_equal(getattr(again, name), getattr(frames, name))


def test_velocity_over_the_ground_counts_the_sideways_part():
    hsr = robots.load("hsr")
    out = jax.tree.map(lambda leaf: leaf[-1], run(hsr, [[0.1, 0.2, 0.0]] * 30, start=(0.0, 0.0, 0.7)))
    expected = turned((0.1, 0.2), 0.7)
    np.testing.assert_allclose(geometry.ground_velocity(out), expected, atol=1e-4)


@pytest.mark.parametrize(("name", "shape"), [("kuri", (3,)), ("hsr", (2,)), ("f1tenth", (3,))])
def test_an_action_of_another_shape_is_refused(name, shape):
    model = robots.load(name, "twin")
    with pytest.raises(InputError, match=f"action: its shape is .*{name} takes"):
        robot = model.place(model, jnp.zeros(2), jnp.asarray([1.0, 0.0]))
        advance(model, robot, jnp.zeros(shape), driving.obstacles([], 1))
