"""One control step of a differential-drive robot (Fig. 3): a command (v, omega), its limits, the physics, the odometry.

The MJX robot and its closed-form twin differ in nothing but the physics step. Derivatives through the MJX robot are
those of its twin, forward and reverse, which agree with them to rounding and cost a fraction.
"""

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp

from sean_jax import clock
from sean_jax.base import Array, Robot, RobotModel, Scenario, State
from sean_jax.geometry import rotate, unit_vectors
from sean_jax.robots import mjx_dynamics, twin
from sean_jax.robots.ground import Surroundings


class Body(NamedTuple):
    """What a robot's future depends on beyond its pose, its speed and its turn rate, which ``Robot`` has alone."""

    wheels: Array  # (2,) rad, angles of the left and the right wheel
    slip: Array  # (2,) rad/s, by which they turn faster than they would roll
    sideways: Array  # () m/s, to the left: zero unless it is pushed
    command: Array  # (2,) m/s and rad/s, the last that was given
    age: Array  # () int32, control steps since then


def place(model: RobotModel, position: Array, heading: Array) -> Robot:
    """A robot at rest at ``position`` (2,) m that looks along ``heading`` (2,) of any length, along x if it is zero."""
    pair = jnp.zeros((2,), position.dtype)
    body = Body(pair, pair, pair[0], pair, jnp.zeros((), jnp.int32))
    return Robot(position=position, heading=_direction(heading), speed=pair[0], turn_rate=pair[0], body=body)


def coordinates(model: RobotModel, robot: Robot) -> tuple[Array, Array]:
    """Generalised coordinates (5,): x, y [m], yaw, left and right wheel angle [rad]; and their rates (5,)."""
    cosine, sine = _direction(robot.heading)
    velocity = jnp.stack([*rotate(robot.speed, robot.body.sideways, cosine, sine), robot.turn_rate])
    position = jnp.append(robot.position, jnp.arctan2(sine, cosine))
    rates = _rolling(model, robot.speed, robot.turn_rate) + robot.body.slip
    return jnp.append(position, robot.body.wheels), jnp.append(velocity, rates)


def _rolling(model: RobotModel, speed: Array, turn_rate: Array) -> Array:
    """(2,) rad/s of the left and the right wheel that roll without slip."""
    rim = 0.5 * model.track * turn_rate
    return jnp.stack([speed - rim, speed + rim]) / model.wheel_radius


def _direction(heading: Array) -> Array:
    return unit_vectors(heading, jnp.asarray([1.0, 0.0], heading.dtype))


def drive_mjx(scenario: Scenario, state: State, action: Array) -> Robot:
    """The robot one control step after the command ``action`` (2,): m/s and rad/s, simulated by MJX.

    An action that is not finite is no new command: the last one holds until ``command_timeout``, then the robot stops.
    People are where ``state`` has them at the end of the control step, and came there at their velocity.
    Raises ValueError if the control step is no multiple of the physics step.
    """
    return _drive(_physics, scenario, state, action)


def drive_twin(scenario: Scenario, state: State, action: Array) -> Robot:
    """As ``drive_mjx``, simulated by the closed-form twin."""
    return _drive(_simulate_twin, scenario, state, action)


def wheel_speeds(model: RobotModel, robot: Robot, action: Array, time_step: float) -> Array:
    """(2,) rad/s, left and right, for the command within the limits that is nearest to ``action`` (2,) m/s, rad/s.

    Acceleration is limited against the speeds as they are, over one control step. As in the controllers of ROS,
    deceleration is what makes the speed along the heading fall, in braking and in speeding up backward.
    """
    fall = model.max_acceleration if model.max_deceleration is None else model.max_deceleration
    backward = model.max_speed if model.max_reverse_speed is None else model.max_reverse_speed
    change = model.max_turn_acceleration * time_step
    ahead = robot.speed - fall * time_step, robot.speed + model.max_acceleration * time_step
    speed = jnp.clip(jnp.clip(action[0], *ahead), -backward, model.max_speed)
    turn_rate = jnp.clip(action[1], robot.turn_rate - change, robot.turn_rate + change)
    turn_rate = jnp.clip(turn_rate, -model.max_turn_rate, model.max_turn_rate)
    return _rolling(model, speed, turn_rate)


def held(model: RobotModel, body: Body, action: Array, time_step: float) -> tuple[Array, Array]:
    """The command (2,) that acts now, and its age () in control steps: ``action`` if it is finite, else the last one.

    A command that is older than the robot's timeout has become (0, 0).
    """
    given = jnp.isfinite(action).all()
    age = jnp.where(given, 0, body.age + 1)
    limit = clock.in_ticks(model.command_timeout, time_step)
    late = age.astype(limit.dtype) > limit
    return jnp.where(given, action, jnp.where(late, 0.0, body.command)), age


def _drive(physics: Callable, scenario: Scenario, state: State, action: Array) -> Robot:
    model, people = scenario.robot, state.pedestrians
    around = Surroundings(
        obstacles=scenario.environment.obstacles,
        position=people.position,
        velocity=people.velocity,
        present=people.present,
        person_radius=scenario.forces.radius,
    )
    robot = state.robot
    command, age = held(model, robot.body, action, scenario.time_step)
    targets = wheel_speeds(model, robot, command, scenario.time_step)
    steps = round(scenario.time_step / model.time_step)
    if abs(steps * model.time_step - scenario.time_step) > 1e-6:
        raise ValueError(f"the step {scenario.time_step} s is no multiple of {model.name}'s step {model.time_step} s")
    before = coordinates(model, robot)
    position, velocity = physics(steps, model, around, before, targets)
    # The heading is turned rather than made from the yaw: it is kept to the bit by a robot that does not turn, and no
    # less exact in single precision after many turns. Whole turns of the wheels are taken off for the same reason.
    turned = position[2] - before[0][2]
    cosine, sine = _direction(robot.heading)
    cosine, sine = _direction(jnp.stack(rotate(cosine, sine, jnp.cos(turned), jnp.sin(turned))))
    wheels = position[3:] - 2.0 * jnp.pi * jnp.round(position[3:] / (2.0 * jnp.pi))
    speed, sideways = rotate(velocity[0], velocity[1], cosine, -sine)
    slip = velocity[3:] - _rolling(model, speed, velocity[2])
    body = Body(wheels, slip, sideways, command, age)
    return Robot(position[:2], jnp.stack([cosine, sine]), speed, velocity[2], body)


def _simulate(substep: Callable, steps: int, model: RobotModel, around: Surroundings, body: tuple, targets: Array):
    def one(body: tuple, done: Array) -> tuple:
        return substep(model, around, model.time_step * (steps - done), body, targets), None

    return jax.lax.scan(one, body, jnp.arange(steps).astype(body[0].dtype))[0]


def _simulate_twin(steps: int, model: RobotModel, around: Surroundings, body: tuple, targets: Array) -> tuple:
    return _simulate(twin.substep, steps, model, around, body, targets)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _physics(steps: int, model: RobotModel, around: Surroundings, body: tuple, targets: Array) -> tuple:
    """``body`` after that many physics steps of MJX."""
    return _simulate(mjx_dynamics.substep, steps, model, around, body, targets)


@_physics.defjvp
def _physics_move(steps: int, primals: tuple, tangents: tuple) -> tuple:
    # The MJX model itself is a constant. Reverse mode computes the twin anew rather than keep all of its physics steps.
    values, changes = ((replace(model, data=()), *rest) for model, *rest in (primals, tangents))
    twin_of_it = jax.checkpoint(functools.partial(_simulate_twin, steps), prevent_cse=False)
    return _physics(steps, *primals), jax.jvp(twin_of_it, values, changes)[1]
