"""The physics of a car: a bicycle with a driven rear wheel and a steered front wheel.

Generalised coordinates are x, y [m], yaw, the angle of the rear wheels and the steering angle [rad]. The position lies
between the axles, where the centre of mass is. Tyres do not slip within the friction circle of their axle. The steering
follows its target at a limited rate and without inertia, so that it is no joint of MJX.

Source: the bicycle law (kinematic single-track model) as in R. Rajamani, "Vehicle Dynamics and Control", 2012, 2.2.
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from sean_jax.core.data_types import Array, RobotModel, Steering
from sean_jax.core.geometry import rotate
from sean_jax.robots.dynamics import GRAVITY, Motion, Touch, clip_length, mjx_advance


def twin_substep(model: RobotModel, touch: Touch, motion: Motion, targets: Float[Array, "2"]) -> Motion:
    """One physics step of the closed form, by semi-implicit Euler.

    Args:
        targets: rad/s of the rear wheels, and the steering angle [rad].
    """
    position, velocity = motion
    torque = model.servo_gain * (targets[0] - velocity[3])
    torque = jnp.clip(torque, -model.servo_torque, model.servo_torque)
    change = model.time_step * torque / model.wheel_inertia
    free = velocity[:4].at[3].add(change)
    angle, rate = _steer(model, position[4], targets[1])

    # The ground and the contacts act on the velocity that the servo alone would give.
    impulse = ground_impulse(model, touch, position, angle, free)
    velocity = free + impulse / diagonal(model)
    position = position[:4] + model.time_step * velocity
    return jnp.append(position, angle), jnp.append(velocity, rate)


def mjx_substep(model: RobotModel, touch: Touch, motion: Motion, targets: Float[Array, "2"]) -> Motion:
    """One physics step by MJX; arguments as of ``twin_substep``."""
    position, velocity = motion
    angle, rate = _steer(model, position[4], targets[1])
    ground = functools.partial(ground_impulse, model, touch, position, angle)
    servo = model.servo_gain, model.servo_torque
    joints = position[:4], velocity[:4]
    inertia = diagonal(model)
    position, velocity = mjx_advance(model, inertia, servo, joints, targets[:1], ground)
    return jnp.append(position, angle), jnp.append(velocity, rate)


def _steer(model: RobotModel, angle: Array, target: Array) -> tuple[Array, Array]:
    """Steering angle [rad] and its rate [rad/s] after one physics step."""
    max_rate = steering(model).max_rate
    rate = jnp.clip((target - angle) / model.time_step, -max_rate, max_rate)
    angle = angle + model.time_step * rate
    return angle, rate


def ground_impulse(
    model: RobotModel,
    touch: Touch,
    position: Float[Array, "5"],
    angle: Float[Array, ""],
    free: Float[Array, "4"],
) -> Float[Array, "4"]:
    """Generalised impulse (4,) [N s, N s, N m s, N m s] of the tyres and of all contacts.

    Three impulses end all slip: of the rear tyre ahead and sideways, and of the front tyre across the wheel. The front
    one follows after the other two are eliminated.

    Args:
        angle: rad, of the steering.
        free: rates at the end of the physics step, if there were no impulse.
    """
    car = steering(model)
    mass = model.mass
    to_rear = car.rear_axle  # m, from the middle
    to_front = car.wheelbase - car.rear_axle

    # The tyres slip in the frame of the car, halfway through the step.
    yaw = position[2] + 0.5 * model.time_step * free[2]
    cosine = jnp.cos(yaw)
    sine = jnp.sin(yaw)
    velocity = rotate(free[0], free[1], cosine, -sine)
    slip = _slip(model, angle, velocity, free)
    drive, hold, steer = _impulses_against(model, angle, slip)

    # The axles share the weight, and each has its friction circle.
    grip = model.friction * mass * GRAVITY * model.time_step / car.wheelbase  # N s a metre
    drive, hold = clip_length(drive, hold, grip * to_front)
    max_steer = grip * to_rear
    steer = jnp.clip(steer, -max_steer, max_steer)

    # Contacts act after the tyres.
    wheel_cosine = jnp.cos(angle)
    wheel_sine = jnp.sin(angle)
    ahead = drive - wheel_sine * steer
    left = hold + wheel_cosine * steer
    jx, jy = rotate(ahead, left, cosine, sine)
    vx = free[0] + jx / mass
    vy = free[1] + jy / mass
    touched_vx, touched_vy = touch(position, vx, vy)

    turn = to_front * wheel_cosine * steer - to_rear * hold
    jx = jx + mass * (touched_vx - vx)
    jy = jy + mass * (touched_vy - vy)
    wheel = -model.wheel_radius * drive
    return jnp.stack([jx, jy, turn, wheel])


class Slip(NamedTuple):
    """Velocities [m/s] of the tyres over the ground, in the directions in which they do not roll."""

    rear_ahead: Array
    rear_aside: Array
    front_across: Array  # across the steered wheel


def _slip(model: RobotModel, angle: Array, velocity: tuple[Array, Array], free: Array) -> Slip:
    """The slip at a velocity (ahead, left) of the middle, and the rates of yaw and wheel among ``free``."""
    car = steering(model)
    ahead, left = velocity
    to_front = car.wheelbase - car.rear_axle
    turn_rate = free[2]
    wheel_rate = free[3]
    front_left = left + to_front * turn_rate
    return Slip(
        rear_ahead=ahead - model.wheel_radius * wheel_rate,
        rear_aside=left - car.rear_axle * turn_rate,
        front_across=jnp.cos(angle) * front_left - jnp.sin(angle) * ahead,
    )


def _impulses_against(model: RobotModel, angle: Array, slip: Slip) -> tuple[Array, Array, Array]:
    """The impulses [N s] that end all slip: of the rear tyre ahead and sideways, of the front tyre across the wheel.

    They solve a symmetric 3x3 system, whose first two unknowns do not act on each other's slip.
    """
    car = steering(model)
    mass = model.mass
    to_rear = car.rear_axle
    to_front = car.wheelbase - car.rear_axle
    cosine = jnp.cos(angle)
    sine = jnp.sin(angle)

    # The slip that a unit of each impulse removes: its own, and that of the other tyre.
    ahead = 1.0 / mass + model.wheel_radius * model.wheel_radius / model.wheel_inertia
    aside = 1.0 / mass + to_rear * to_rear / model.inertia
    front_aside = 1.0 / mass + to_front * to_front / model.inertia
    across = sine * sine / mass + cosine * cosine * front_aside
    ahead_across = -sine / mass
    aside_across = cosine * (1.0 / mass - to_rear * to_front / model.inertia)

    # The first two are eliminated.
    pivot = across - ahead_across * ahead_across / ahead
    pivot = pivot - aside_across * aside_across / aside
    remaining = -slip.front_across + ahead_across * slip.rear_ahead / ahead
    remaining = remaining + aside_across * slip.rear_aside / aside
    steer = remaining / pivot

    # They follow from the third.
    drive = (-slip.rear_ahead - ahead_across * steer) / ahead
    hold = (-slip.rear_aside - aside_across * steer) / aside
    return drive, hold, steer


def diagonal(model: RobotModel) -> Float[Array, "4"]:
    """The diagonal of the mass matrix: kg, kg, kg m2, kg m2."""
    return jnp.stack([model.mass, model.mass, model.inertia, model.wheel_inertia])


def steering(model: RobotModel) -> Steering:
    """The steering of a car."""
    assert isinstance(model.steering, Steering)
    return model.steering


def steering_angle(
    model: RobotModel, speed: Float[Array, "*shape"], turn_rate: Float[Array, "*shape"], hold: Float[Array, "*shape"]
) -> Float[Array, "*shape"]:
    """The steering angle [rad] of a speed [m/s] and a turn rate [rad/s] by the bicycle law, within its limit.

    A speed of 0 with a turn rate steers as far as possible to that side. Without both the steering stays.

    Args:
        hold: rad, the angle now.
    """
    car = steering(model)
    max_tangent = jnp.tan(car.max_angle)
    rise = car.wheelbase * turn_rate  # the tangent is rise / speed
    within = jnp.abs(rise) < max_tangent * jnp.abs(speed)
    divisor = jnp.where(within, speed, 1.0)
    direction = jnp.where(speed < 0.0, -1.0, 1.0)
    side = direction * jnp.sign(rise)
    tangent = jnp.where(within, rise / divisor, side * max_tangent)
    stands = (speed == 0.0) & (turn_rate == 0.0)
    return jnp.where(stands, hold, jnp.arctan(tangent))


def turn_rate_of(
    model: RobotModel, speed: Float[Array, "*shape"], angle: Float[Array, "*shape"]
) -> Float[Array, "*shape"]:
    """The turn rate [rad/s] at a speed [m/s] and a steering angle [rad]: the bicycle law."""
    car = steering(model)
    return speed * jnp.tan(angle) / car.wheelbase
