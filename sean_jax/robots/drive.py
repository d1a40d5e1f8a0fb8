"""One control step of a robot (Fig. 3): command, limits, physics, odometry, by the law of its drive (``LAWS``).

Commands are (2,) speed [m/s] and turn rate [rad/s] of a differential drive and of a car, and (3,) speed ahead, speed to
the left [m/s] and turn rate [rad/s] of an omnidirectional robot. A car steers to the angle that gives this turn rate at
this speed.

The default is the closed-form twin. The robot in MJX has the same law and differs only in the physics step.
Derivatives through it are from the twin, in forward and in reverse mode: they agree to rounding and cost a fraction.
The kinematic robot has no inertia: within its limits it has the speeds of the command.

``motion`` is a pair: generalised coordinates and their rates. Those of a differential drive are (5,): x, y [m], yaw,
left and right wheel angle [rad].
"""

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int

from sean_jax.core import clock
from sean_jax.core.data_types import Array, Robot, RobotModel, Scenario, State
from sean_jax.core.devices import by_platform
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import ground_velocity, rotate, unit_vectors
from sean_jax.robots import ackermann, kernel, omnidirectional
from sean_jax.robots.dynamics import Motion, Surroundings, kinematic_move, mjx_substep, touching, twin_substep


class DriveState(NamedTuple):
    """``Robot.drive_state``: all state of the robot's motion besides pose, speed and turn rate."""

    wheels: Float[Array, "wheels"]  # rad, angles of the left and the right wheel, of the rear wheels of a car, or none
    slip: Float[Array, "wheels"]  # rad/s, wheel speeds minus the speeds of rolling without slip
    sideways: Float[Array, ""] | None  # m/s to the left, zero unless the robot is pushed; None: Robot.sideways
    command: Float[Array, "command"]  # m/s and rad/s, the last finite command
    age: Int[Array, ""]  # control steps since that command
    steering: Float[Array, ""] | None = None  # rad, the steering angle of a car


Speeds = tuple[Array, ...]
"""What limits of acceleration act on: speed, for an omnidirectional robot speed to the left, and turn rate; for a car
speed and steering angle [m/s, rad/s, rad]."""


class Law(NamedTuple):
    """How the robots of one drive move."""

    command_size: int
    speeds: Callable  # (model, robot) -> Speeds now
    limit: Callable  # (model, speeds, command, time_step) -> Speeds nearest to the command after that time [s]
    velocity: Callable  # (model, speeds) -> speed ahead, speed to the left or None [m/s], turn rate [rad/s]
    targets: Callable  # (model, speeds) -> array, of the servos
    coordinates: Callable  # (model, robot) -> motion
    odometry: Callable  # (model, motion, heading, command, age) -> Robot
    twin: Callable  # the physics step of the closed form
    mjx: Callable  # the physics step by MJX
    wheels: int  # numbers of ``DriveState.wheels``


def place(model: RobotModel, position: Float[Array, "2"], heading: Float[Array, "2"]) -> Robot:
    """A robot at rest at a position [m], without a command; a zero heading counts as the x axis."""
    law = LAWS[model.drive_type]
    is_differential = model.drive_type == "differential"
    zeros = functools.partial(jnp.zeros, dtype=position.dtype)
    drive_state = DriveState(
        wheels=zeros(law.wheels),
        slip=zeros(law.wheels),
        sideways=zeros(()) if is_differential else None,
        command=zeros(law.command_size),
        age=jnp.zeros((), jnp.int32),
        steering=None if model.steering is None else zeros(()),
    )
    sideways = None if is_differential else zeros(())
    return Robot(position, _direction(heading), zeros(()), zeros(()), drive_state, sideways)


def command_size(model: RobotModel) -> int:
    """Numbers of a command: 3 for an omnidirectional robot, else 2."""
    return LAWS[model.drive_type].command_size


def require(model: RobotModel, drives: tuple[str, ...], what: str) -> None:
    """InputError unless the robot has one of these drives; ``what`` begins the sentence, as "orca steers"."""
    if model.drive_type not in drives:
        kinds = " and ".join(drives)
        kind = model.drive_type
        raise InputError(f"{what} {kinds} robots, but the drive of {model.name} is {kind}; choose another of the two.")


# --- the law of each drive ---


def coordinates(model: RobotModel, robot: Robot) -> tuple[Float[Array, "5"], Float[Array, "5"]]:
    """Generalised coordinates (5,), x, y [m], yaw, left and right wheel angle [rad], and their rates."""
    cosine, sine = _direction(robot.heading)
    vx, vy = rotate(robot.speed, robot.drive_state.sideways, cosine, sine)
    velocity = jnp.stack([vx, vy, robot.turn_rate])
    position = jnp.append(robot.position, jnp.arctan2(sine, cosine))
    wheel_rates = _rolling(model, robot.speed, robot.turn_rate) + robot.drive_state.slip
    return jnp.append(position, robot.drive_state.wheels), jnp.append(velocity, wheel_rates)


def _rolling(model: RobotModel, speed: Array, turn_rate: Array) -> Array:
    """(2,) rad/s of the left and the right wheel when they roll without slip."""
    difference = 0.5 * model.track * turn_rate  # m/s, from the middle to a wheel
    return jnp.stack([speed - difference, speed + difference]) / model.wheel_radius


def _odometry(model: RobotModel, motion: Motion, heading: Array, command: Array, age: Array) -> Robot:
    position, velocity = motion
    cosine, sine = heading
    wheels = _whole_turns_removed(position[3:])
    speed, sideways = rotate(velocity[0], velocity[1], cosine, -sine)
    slip = velocity[3:] - _rolling(model, speed, velocity[2])
    drive_state = DriveState(wheels, slip, sideways, command, age)
    return Robot(position[:2], jnp.stack([cosine, sine]), speed, velocity[2], drive_state)


def _whole_turns_removed(wheels: Array) -> Array:
    """Angles [rad] of wheels that stay exact in single precision."""
    return wheels - 2.0 * jnp.pi * jnp.round(wheels / (2.0 * jnp.pi))


def _omni_coordinates(model: RobotModel, robot: Robot) -> omnidirectional.Motion:
    cosine, sine = heading = _direction(robot.heading)
    velocity = jnp.append(ground_velocity(replace(robot, heading=heading)), robot.turn_rate)
    return jnp.append(robot.position, jnp.arctan2(sine, cosine)), velocity


def _omni_odometry(
    model: RobotModel, motion: omnidirectional.Motion, heading: Array, command: Array, age: Array
) -> Robot:
    position, velocity = motion
    speed, sideways = rotate(velocity[0], velocity[1], heading[0], -heading[1])
    no_wheels = jnp.zeros((0,), speed.dtype)
    drive_state = DriveState(no_wheels, no_wheels, None, command, age)
    return Robot(position[:2], heading, speed, velocity[2], drive_state, sideways)


def _car_coordinates(model: RobotModel, robot: Robot) -> Motion:
    state = robot.drive_state
    position, velocity = _omni_coordinates(model, robot)
    wheel_rate = robot.speed / model.wheel_radius + state.slip[0]
    position = jnp.concatenate([position, state.wheels, state.steering[None]])
    rates = jnp.stack([wheel_rate, jnp.zeros_like(wheel_rate)])
    return position, jnp.concatenate([velocity, rates])


def _car_odometry(model: RobotModel, motion: Motion, heading: Array, command: Array, age: Array) -> Robot:
    position, velocity = motion
    speed, sideways = rotate(velocity[0], velocity[1], heading[0], -heading[1])
    slip = velocity[3:4] - speed / model.wheel_radius
    drive_state = DriveState(_whole_turns_removed(position[3:4]), slip, None, command, age, position[4])
    return Robot(position[:2], heading, speed, velocity[2], drive_state, sideways)


def _car_velocity(model: RobotModel, speeds: Speeds) -> tuple[Array, Array, Array]:
    turn_rate = ackermann.turn_rate_of(model, *speeds)
    return speeds[0], ackermann.steering(model).rear_axle * turn_rate, turn_rate


def _direction(heading: Array) -> Array:
    return unit_vectors(heading, jnp.asarray([1.0, 0.0], heading.dtype))


def drive_mjx(scenario: Scenario, state: State, action: Float[Array, "command"]) -> Robot:
    """The robot one control step later, simulated by MJX.

    Args:
        state: people are where it has them at the end of the control step; they came there at their velocities.
        action: m/s and rad/s. If it is not finite, the last command holds until ``command_timeout``; then the robot
            stops.

    Raises:
        InputError: the control step is no multiple of the physics step.
    """
    return _drive(_physics, scenario, state, action)


def drive_twin(scenario: Scenario, state: State, action: Float[Array, "command"]) -> Robot:
    """The robot one control step later, simulated by the closed-form twin; otherwise as ``drive_mjx``."""
    return _drive(_twin, scenario, state, action)


def drive_kinematic(scenario: Scenario, state: State, action: Float[Array, "command"]) -> Robot:
    """The robot one control step later, which has the speeds of the command at once, as in SEAN 2.0.

    Its limits of speed, turn rate and acceleration hold. Obstacles and people in its way stop it. Wheels are not moved.
    Arguments and errors as in ``drive_mjx``.

    Source: SEAN 2.0, Control/VelocityController.cs; the limits are from its ROS controllers.
    """
    model = scenario.robot
    robot = state.robot
    step = scenario.time_step
    law = LAWS[model.drive_type]
    command, age = active_command(model, robot.drive_state, action, step)
    speeds = law.limit(model, law.speeds(model, robot), _numbers(law, command), step)
    speed, sideways, turn_rate = law.velocity(model, speeds)
    heading = _direction(robot.heading)
    steps = physics_steps(model, step)
    surroundings = surroundings_of(scenario, state)
    way = kinematic_move(steps, model, surroundings, robot.position, heading, speed, turn_rate, sideways)

    # A differential drive moves to the left only if it is pushed.
    is_differential = sideways is None
    still = jnp.zeros_like(robot.drive_state.wheels)
    drive_state = DriveState(
        wheels=still,
        slip=still,
        sideways=way.sideways if is_differential else None,
        command=command,
        age=age,
        steering=None if model.steering is None else speeds[1],
    )
    sideways = None if is_differential else way.sideways
    return Robot(way.position, _turned(heading, step * turn_rate), way.speed, turn_rate, drive_state, sideways)


def active_command(
    model: RobotModel, drive_state: DriveState, action: Float[Array, "command"], time_step: float
) -> tuple[Float[Array, "command"], Int[Array, ""]]:
    """The command [m/s, rad/s] that acts now, and its age in control steps of ``time_step`` [s].

    It is the action if that is finite, else the last command, or after ``model.command_timeout`` a stop.
    """
    size = command_size(model)
    shape = jnp.shape(action)
    if shape != (size,):
        if size == 2:
            raise InputError(f"action: its shape is {shape}; {model.name} takes ({size},), speed and turn rate.")
        raise InputError(
            f"action: its shape is {shape}; {model.name} takes ({size},), speed, speed to the left and turn rate."
        )
    is_finite = jnp.isfinite(action).all()
    age = jnp.where(is_finite, 0, drive_state.age + 1)
    timeout = clock.to_ticks(model.command_timeout, time_step)
    is_late = age.astype(timeout.dtype) > timeout
    last_or_stop = jnp.where(is_late, 0.0, drive_state.command)
    return jnp.where(is_finite, action, last_or_stop), age


def _drive(physics: Callable, scenario: Scenario, state: State, action: Array) -> Robot:
    model = scenario.robot
    robot = state.robot
    law = LAWS[model.drive_type]
    command, age = active_command(model, robot.drive_state, action, scenario.time_step)
    speeds = law.limit(model, law.speeds(model, robot), _numbers(law, command), scenario.time_step)
    targets = law.targets(model, *speeds)
    before = law.coordinates(model, robot)
    steps = physics_steps(model, scenario.time_step)
    motion = physics(steps, model, surroundings_of(scenario, state), before, targets)
    heading = _turned(_direction(robot.heading), motion[0][2] - before[0][2])
    return law.odometry(model, motion, heading, command, age)


def _numbers(law: Law, command: Array) -> Speeds:
    return tuple(command[index] for index in range(law.command_size))


def surroundings_of(scenario: Scenario, state: State) -> Surroundings:
    """Obstacles and people of a scenario, as robots touch them."""
    people = state.pedestrians
    return Surroundings(
        obstacles=scenario.environment.obstacles,
        position=people.position,
        velocity=people.velocity,
        present=people.present,
        person_radius=scenario.forces.walking.radius,
    )


def physics_steps(model: RobotModel, time_step: float) -> int:
    """Number of physics steps in a control step of ``time_step`` [s].

    Raises:
        InputError: the control step is no multiple of the physics step.
    """
    steps = round(time_step / model.time_step)
    if abs(steps * model.time_step - time_step) > 1e-6:
        raise InputError(f"time_step: {time_step:g} s is no multiple of {model.name}'s step of {model.time_step:g} s.")
    return steps


def _turned(heading: Array, rotation: Array) -> Array:
    """(2,) the heading (2,) turned by that angle [rad].

    It is rotated, not computed from the yaw: so a robot that does not turn keeps it to the bit, and it stays exact in
    single precision after many turns.
    """
    x, y = rotate(heading[0], heading[1], jnp.cos(rotation), jnp.sin(rotation))
    return _direction(jnp.stack([x, y]))


def _simulate(
    substep: Callable, steps: int, model: RobotModel, surroundings: Surroundings, motion: Motion, targets: Array
) -> Motion:
    def advance(motion: Motion, index: Array) -> tuple[Motion, None]:
        time_left = model.time_step * (steps - index)
        touch = functools.partial(touching, model, surroundings, time_left)
        return substep(model, touch, motion, targets), None

    # Reverse mode would store a hundred numbers of each step in arrays of their own.
    advance = jax.checkpoint(advance, prevent_cse=False)
    motion, _ = jax.lax.scan(advance, motion, jnp.arange(steps).astype(motion[0].dtype))
    return motion


def _simulate_twin(steps: int, model: RobotModel, surroundings: Surroundings, motion: Motion, targets: Array) -> Motion:
    """The motion after that many steps of the twin. Reverse mode computes them again rather than store all of them."""
    simulate = jax.checkpoint(functools.partial(_simulate, LAWS[model.drive_type].twin, steps), prevent_cse=False)
    return simulate(model, surroundings, motion, targets)


def _twin(steps: int, model: RobotModel, surroundings: Surroundings, motion: Motion, targets: Array) -> Motion:
    """``_simulate_twin``, on a GPU in one kernel; derivatives are XLA's."""
    loop = functools.partial(_simulate_twin, steps)
    if model.drive_type != "differential" or not kernel.supports(model, surroundings, motion):
        return loop(model, surroundings, motion, targets)
    in_a_kernel = functools.partial(kernel.simulate, steps)
    return by_platform(loop, in_a_kernel)(replace(model, data=()), surroundings, motion, targets)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _physics(steps: int, model: RobotModel, surroundings: Surroundings, motion: Motion, targets: Array) -> Motion:
    """The motion after that many physics steps of MJX."""
    return _simulate(LAWS[model.drive_type].mjx, steps, model, surroundings, motion, targets)


@_physics.defjvp
def _physics_jvp(steps: int, primals: tuple, tangents: tuple) -> tuple:
    # MJX's data are constant.
    twin_primals = replace(primals[0], data=()), *primals[1:]
    twin_tangents = replace(tangents[0], data=()), *tangents[1:]
    _, change = jax.jvp(functools.partial(_simulate_twin, steps), twin_primals, twin_tangents)
    return _physics(steps, *primals), change


# --- limits: top speeds, and speeds that a robot can reach in one step ---
# As in the controllers of ROS, deceleration limits the fall of the speed along the heading, in braking and in speeding
# up backward.


class Reach(NamedTuple):
    """The speeds that a robot can reach in one step, before its top speeds are taken into account."""

    speed_min: Float[Array, "..."]  # m/s
    speed_max: Float[Array, "..."]  # m/s
    turn_rate_min: Float[Array, "..."]  # rad/s
    turn_rate_max: Float[Array, "..."]  # rad/s


def max_reverse_speed(model: RobotModel) -> Float[Array, ""]:
    """Top speed backward [m/s], positive; the top speed ahead if the robot has no other backward."""
    return model.max_speed if model.max_reverse_speed is None else model.max_reverse_speed


def reachable(
    model: RobotModel, speed: Float[Array, "*shape"], turn_rate: Float[Array, "*shape"], time_step: float
) -> Reach:
    """The speeds that the limits of acceleration allow one step [s] after a speed [m/s] and a turn rate [rad/s]."""
    deceleration = model.max_acceleration if model.max_deceleration is None else model.max_deceleration
    turn_change = model.max_turn_acceleration * time_step
    return Reach(
        speed_min=speed - deceleration * time_step,
        speed_max=speed + model.max_acceleration * time_step,
        turn_rate_min=turn_rate - turn_change,
        turn_rate_max=turn_rate + turn_change,
    )


def clip_speeds(
    model: RobotModel, speed: Float[Array, "*shape"], turn_rate: Float[Array, "*shape"]
) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
    """Clip speeds [m/s] and turn rates [rad/s] to the robot's maxima."""
    return jnp.clip(speed, -max_reverse_speed(model), model.max_speed), clip_turn_rate(model, turn_rate)


def clip_turn_rate(model: RobotModel, turn_rate: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Clip turn rates [rad/s] to the robot's maximum."""
    return jnp.clip(turn_rate, -model.max_turn_rate, model.max_turn_rate)


def limit_command(
    model: RobotModel,
    speed: Float[Array, "*shape"],
    turn_rate: Float[Array, "*shape"],
    command: tuple[Float[Array, "*shape"], Float[Array, "*shape"]],
    time_step: float,
) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
    """Speed [m/s] and turn rate [rad/s] within all limits that are nearest to a command, after one step [s]."""
    reach = reachable(model, speed, turn_rate, time_step)
    ahead = jnp.clip(command[0], reach.speed_min, reach.speed_max)
    turn = jnp.clip(command[1], reach.turn_rate_min, reach.turn_rate_max)
    return clip_speeds(model, ahead, turn)


def _limit(model: RobotModel, speeds: Speeds, command: Speeds, time_step: float) -> Speeds:
    return limit_command(model, speeds[0], speeds[1], (command[0], command[1]), time_step)


def _omni_limit(model: RobotModel, speeds: Speeds, command: Speeds, time_step: float) -> Speeds:
    ahead, turn_rate = limit_command(model, speeds[0], speeds[2], (command[0], command[2]), time_step)
    assert model.lateral is not None
    change = model.lateral.max_acceleration * time_step
    max_speed = model.lateral.max_speed
    left = jnp.clip(command[1], speeds[1] - change, speeds[1] + change)
    return ahead, jnp.clip(left, -max_speed, max_speed), turn_rate


def _car_limit(model: RobotModel, speeds: Speeds, command: Speeds, time_step: float) -> Speeds:
    """Limited speed and steering; the path has the curvature of the command also while the speed still changes."""
    car = ackermann.steering(model)
    speed, angle = speeds
    target_speed, target_turn_rate = clip_speeds(model, *command)
    target_angle = ackermann.steering_angle(model, target_speed, target_turn_rate, angle)

    reach = reachable(model, speed, target_turn_rate, time_step)
    ahead = jnp.clip(target_speed, reach.speed_min, reach.speed_max)
    ahead = jnp.clip(ahead, -max_reverse_speed(model), model.max_speed)
    change = car.max_rate * time_step
    angle = jnp.clip(target_angle, angle - change, angle + change)
    return ahead, jnp.clip(angle, -car.max_angle, car.max_angle)


LAWS = {
    "differential": Law(
        command_size=2,
        speeds=lambda model, robot: (robot.speed, robot.turn_rate),
        limit=_limit,
        velocity=lambda model, speeds: (speeds[0], None, speeds[1]),
        targets=_rolling,
        coordinates=coordinates,
        odometry=_odometry,
        twin=twin_substep,
        mjx=mjx_substep,
        wheels=2,
    ),
    "omnidirectional": Law(
        command_size=3,
        speeds=lambda model, robot: (robot.speed, robot.sideways, robot.turn_rate),
        limit=_omni_limit,
        velocity=lambda model, speeds: speeds,
        targets=lambda model, *speeds: jnp.stack(speeds),
        coordinates=_omni_coordinates,
        odometry=_omni_odometry,
        twin=omnidirectional.twin_substep,
        mjx=omnidirectional.mjx_substep,
        wheels=0,
    ),
    "ackermann": Law(
        command_size=2,
        speeds=lambda model, robot: (robot.speed, robot.drive_state.steering),
        limit=_car_limit,
        velocity=_car_velocity,
        targets=lambda model, speed, angle: jnp.stack([speed / model.wheel_radius, angle]),
        coordinates=_car_coordinates,
        odometry=_car_odometry,
        twin=ackermann.twin_substep,
        mjx=ackermann.mjx_substep,
        wheels=1,
    ),
}
"""Type of a drive -> its law."""
