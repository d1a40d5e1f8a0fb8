"""The physics of a car: a bicycle with a driven rear wheel and a steered front wheel.

Generalised coordinates are x, y [m], yaw, the angle of the rear wheels and the steering angle [rad]. The position lies
between the axles, where the centre of mass is. Tyres do not slip within the friction circle of their axle. The steering
follows its target at a limited rate and without inertia, so that it is no joint of MJX.

Source: the bicycle law (kinematic single-track model) as in R. Rajamani, "Vehicle Dynamics and Control", 2012, 2.2.
"""

import functools

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
    (position, velocity), mass = motion, diagonal(model)
    servo = jnp.clip(model.servo_gain * (targets[0] - velocity[3]), -model.servo_torque, model.servo_torque)
    free = velocity[:4].at[3].add(model.time_step * servo / model.wheel_inertia)
    angle, rate = _steer(model, position[4], targets[1])
    velocity = free + ground_impulse(model, touch, position, angle, free) / mass
    return jnp.append(position[:4] + model.time_step * velocity, angle), jnp.append(velocity, rate)


def mjx_substep(model: RobotModel, touch: Touch, motion: Motion, targets: Float[Array, "2"]) -> Motion:
    """One physics step by MJX; arguments as of ``twin_substep``."""
    position, velocity = motion
    angle, rate = _steer(model, position[4], targets[1])
    ground = functools.partial(ground_impulse, model, touch, position, angle)
    servo = model.servo_gain, model.servo_torque
    joints = position[:4], velocity[:4]
    position, velocity = mjx_advance(model, diagonal(model), servo, joints, targets[:1], ground)
    return jnp.append(position, angle), jnp.append(velocity, rate)


def _steer(model: RobotModel, angle: Array, target: Array) -> tuple[Array, Array]:
    """Steering angle [rad] and its rate [rad/s] after one physics step."""
    most = steering(model).max_rate
    rate = jnp.clip((target - angle) / model.time_step, -most, most)
    return angle + model.time_step * rate, rate


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
    shape, mass = steering(model), model.mass
    rear, front = shape.rear_axle, shape.wheelbase - shape.rear_axle
    middle = position[2] + 0.5 * model.time_step * free[2]  # yaw halfway through the step
    cosine, sine = jnp.cos(middle), jnp.sin(middle)
    along, across = rotate(free[0], free[1], cosine, -sine)
    c, s = jnp.cos(angle), jnp.sin(angle)
    # Slip [m/s]: of the rear tyre ahead and sideways, of the front tyre across the wheel.
    ahead, aside = along - model.wheel_radius * free[3], across - rear * free[2]
    cross = c * (across + front * free[2]) - s * along
    # The slip that a unit of each impulse removes.
    own_ahead = 1.0 / mass + model.wheel_radius * model.wheel_radius / model.wheel_inertia
    own_aside = 1.0 / mass + rear * rear / model.inertia
    own_cross = s * s / mass + c * c * (1.0 / mass + front * front / model.inertia)
    ahead_cross, aside_cross = -s / mass, c * (1.0 / mass - rear * front / model.inertia)
    left = own_cross - ahead_cross * ahead_cross / own_ahead - aside_cross * aside_cross / own_aside
    steer = (-cross + ahead_cross * ahead / own_ahead + aside_cross * aside / own_aside) / left
    push, hold = (-ahead - ahead_cross * steer) / own_ahead, (-aside - aside_cross * steer) / own_aside
    grip = model.friction * mass * GRAVITY * model.time_step / shape.wheelbase  # N s a metre: axles share the weight
    push, hold = clip_length(push, hold, grip * front)
    steer = jnp.clip(steer, -grip * rear, grip * rear)
    jx, jy = rotate(push - s * steer, hold + c * steer, cosine, sine)
    vx, vy = free[0] + jx / mass, free[1] + jy / mass
    x, y = touch(position, vx, vy)
    turn, wheel = front * c * steer - rear * hold, -model.wheel_radius * push
    return jnp.stack([jx + mass * (x - vx), jy + mass * (y - vy), turn, wheel])


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
    shape = steering(model)
    most = jnp.tan(shape.max_angle)
    rate = shape.wheelbase * turn_rate
    inside = jnp.abs(rate) < most * jnp.abs(speed)
    side = jnp.where(speed < 0.0, -1.0, 1.0) * jnp.sign(rate)
    tangent = jnp.where(inside, rate / jnp.where(inside, speed, 1.0), side * most)
    return jnp.where((speed == 0.0) & (turn_rate == 0.0), hold, jnp.arctan(tangent))


def turn_rate_of(
    model: RobotModel, speed: Float[Array, "*shape"], angle: Float[Array, "*shape"]
) -> Float[Array, "*shape"]:
    """The turn rate [rad/s] at a speed [m/s] and a steering angle [rad]: the bicycle law."""
    return speed * jnp.tan(angle) / steering(model).wheelbase
