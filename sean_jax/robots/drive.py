"""One control step of a differential-drive robot (Fig. 3): command (v, omega), limits, physics, odometry.

The default is the closed-form twin. The robot in MJX has the same law and differs only in the physics step.
Derivatives through it are from the twin, in forward and in reverse mode: they agree to rounding and cost a fraction.
The kinematic robot has no inertia: within its limits it has the speeds of the command.

``motion`` is a pair: generalised coordinates (5,), x, y [m], yaw, left and right wheel angle [rad], and their rates.
"""

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int

from sean_jax import clock
from sean_jax.base import Array, Robot, RobotModel, Scenario, State
from sean_jax.devices import by_platform
from sean_jax.errors import InputError
from sean_jax.geometry import rotate, unit_vectors
from sean_jax.robots import kernel
from sean_jax.robots.dynamics import Motion, Surroundings, kinematic_move, mjx_substep, twin_substep


class DriveState(NamedTuple):
    """``Robot.drive_state``: all state of the robot's motion besides pose, speed and turn rate."""

    wheels: Float[Array, "2"]  # rad, angles of the left and the right wheel
    slip: Float[Array, "2"]  # rad/s, wheel speeds minus the speeds of rolling without slip
    sideways: Float[Array, ""]  # m/s, velocity to the left: zero unless the robot is pushed
    command: Float[Array, "2"]  # m/s and rad/s, the last finite command
    age: Int[Array, ""]  # control steps since that command


def place(model: RobotModel, position: Float[Array, "2"], heading: Float[Array, "2"]) -> Robot:
    """A robot at rest at a position [m], without a command; a zero heading counts as the x axis."""
    pair = jnp.zeros((2,), position.dtype)
    drive_state = DriveState(pair, pair, pair[0], pair, jnp.zeros((), jnp.int32))
    return Robot(position, _direction(heading), pair[0], pair[0], drive_state)


def coordinates(model: RobotModel, robot: Robot) -> tuple[Float[Array, "5"], Float[Array, "5"]]:
    """Generalised coordinates (5,), x, y [m], yaw, left and right wheel angle [rad], and their rates."""
    cosine, sine = _direction(robot.heading)
    velocity = jnp.stack([*rotate(robot.speed, robot.drive_state.sideways, cosine, sine), robot.turn_rate])
    position = jnp.append(robot.position, jnp.arctan2(sine, cosine))
    wheel_rates = _rolling(model, robot.speed, robot.turn_rate) + robot.drive_state.slip
    return jnp.append(position, robot.drive_state.wheels), jnp.append(velocity, wheel_rates)


def _rolling(model: RobotModel, speed: Array, turn_rate: Array) -> Array:
    """(2,) rad/s of the left and the right wheel when they roll without slip."""
    rim = 0.5 * model.track * turn_rate
    return jnp.stack([speed - rim, speed + rim]) / model.wheel_radius


def _direction(heading: Array) -> Array:
    return unit_vectors(heading, jnp.asarray([1.0, 0.0], heading.dtype))


def drive_mjx(scenario: Scenario, state: State, action: Float[Array, "2"]) -> Robot:
    """The robot one control step later, simulated by MJX.

    Args:
        state: people are where it has them at the end of the control step; they came there at their velocities.
        action: m/s and rad/s. If it is not finite, the last command holds until ``command_timeout``; then the robot
            stops.

    Raises:
        InputError: the control step is no multiple of the physics step.
    """
    return _drive(_physics, scenario, state, action)


def drive_twin(scenario: Scenario, state: State, action: Float[Array, "2"]) -> Robot:
    """The robot one control step later, simulated by the closed-form twin; otherwise as ``drive_mjx``."""
    return _drive(_twin, scenario, state, action)


def drive_kinematic(scenario: Scenario, state: State, action: Float[Array, "2"]) -> Robot:
    """The robot one control step later, which has the speeds of the command at once, as in SEAN 2.0.

    Its limits of speed, turn rate and acceleration hold. Obstacles and people in its way stop it. Wheels are not moved.
    Arguments and errors as in ``drive_mjx``.

    Source: SEAN 2.0, Control/VelocityController.cs; the limits are from its ROS controllers.
    """
    model, robot, step = scenario.robot, state.robot, scenario.time_step
    command, age = active_command(model, robot.drive_state, action, step)
    speed, turn_rate = limit_command(model, robot.speed, robot.turn_rate, (command[0], command[1]), step)
    heading = _direction(robot.heading)
    steps, surroundings = physics_steps(model, step), _surroundings(scenario, state)
    way = kinematic_move(steps, model, surroundings, robot.position, heading, speed, turn_rate)
    still = jnp.zeros_like(robot.position)
    drive_state = DriveState(still, still, way.sideways, command, age)
    return Robot(way.position, _turned(heading, step * turn_rate), way.speed, turn_rate, drive_state)


def active_command(
    model: RobotModel, drive_state: DriveState, action: Float[Array, "2"], time_step: float
) -> tuple[Float[Array, "2"], Int[Array, ""]]:
    """The command [m/s, rad/s] that acts now, and its age in control steps of ``time_step`` [s].

    It is the action if that is finite, else the last command, or after ``model.command_timeout`` a stop.
    """
    finite = jnp.isfinite(action).all()
    age = jnp.where(finite, 0, drive_state.age + 1)
    limit = clock.to_ticks(model.command_timeout, time_step)
    late = age.astype(limit.dtype) > limit
    return jnp.where(finite, action, jnp.where(late, 0.0, drive_state.command)), age


def _drive(physics: Callable, scenario: Scenario, state: State, action: Array) -> Robot:
    model, robot = scenario.robot, state.robot
    command, age = active_command(model, robot.drive_state, action, scenario.time_step)
    speeds = limit_command(model, robot.speed, robot.turn_rate, (command[0], command[1]), scenario.time_step)
    targets = _rolling(model, *speeds)
    before = coordinates(model, robot)
    steps, surroundings = physics_steps(model, scenario.time_step), _surroundings(scenario, state)
    position, velocity = physics(steps, model, surroundings, before, targets)
    cosine, sine = _turned(_direction(robot.heading), position[2] - before[0][2])
    # Whole turns of the wheels are removed, so that the angles stay exact in single precision.
    wheels = position[3:] - 2.0 * jnp.pi * jnp.round(position[3:] / (2.0 * jnp.pi))
    speed, sideways = rotate(velocity[0], velocity[1], cosine, -sine)
    slip = velocity[3:] - _rolling(model, speed, velocity[2])
    drive_state = DriveState(wheels, slip, sideways, command, age)
    return Robot(position[:2], jnp.stack([cosine, sine]), speed, velocity[2], drive_state)


def _surroundings(scenario: Scenario, state: State) -> Surroundings:
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
    return _direction(jnp.stack(rotate(heading[0], heading[1], jnp.cos(rotation), jnp.sin(rotation))))


def _simulate(
    substep: Callable, steps: int, model: RobotModel, surroundings: Surroundings, motion: Motion, targets: Array
) -> Motion:
    def one(motion: Motion, index: Array) -> tuple[Motion, None]:
        return substep(model, surroundings, model.time_step * (steps - index), motion, targets), None

    # Reverse mode would store a hundred numbers of each step in arrays of their own.
    one = jax.checkpoint(one, prevent_cse=False)
    return jax.lax.scan(one, motion, jnp.arange(steps).astype(motion[0].dtype))[0]


def _simulate_twin(steps: int, model: RobotModel, surroundings: Surroundings, motion: Motion, targets: Array) -> Motion:
    """The motion after that many steps of the twin. Reverse mode computes them again rather than store all of them."""
    simulate = jax.checkpoint(functools.partial(_simulate, twin_substep, steps), prevent_cse=False)
    return simulate(model, surroundings, motion, targets)


def _twin(steps: int, model: RobotModel, surroundings: Surroundings, motion: Motion, targets: Array) -> Motion:
    """``_simulate_twin``, on a GPU in one kernel; derivatives are XLA's."""
    loop = functools.partial(_simulate_twin, steps)
    if not kernel.supports(model, surroundings, motion):
        return loop(model, surroundings, motion, targets)
    one = functools.partial(kernel.simulate, steps)
    return by_platform(loop, one)(replace(model, data=()), surroundings, motion, targets)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _physics(steps: int, model: RobotModel, surroundings: Surroundings, motion: Motion, targets: Array) -> Motion:
    """The motion after that many physics steps of MJX."""
    return _simulate(mjx_substep, steps, model, surroundings, motion, targets)


@_physics.defjvp
def _physics_jvp(steps: int, primals: tuple, tangents: tuple) -> tuple:
    values, changes = ((replace(model, data=()), *rest) for model, *rest in (primals, tangents))  # MJX's is constant
    return _physics(steps, *primals), jax.jvp(functools.partial(_simulate_twin, steps), values, changes)[1]


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
    fall = model.max_acceleration if model.max_deceleration is None else model.max_deceleration
    change = model.max_turn_acceleration * time_step
    return Reach(
        speed - fall * time_step, speed + model.max_acceleration * time_step, turn_rate - change, turn_rate + change
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
