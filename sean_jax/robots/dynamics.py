"""The physics of a robot (Fig. 3): tyres and contacts, the closed-form twin, the kinematic robot, the MJX robot.

Generalised coordinates are x, y [m], yaw, left and right wheel angle [rad]. Impulses follow from predicted velocities
(velocity-implicit). A force from the slip or the approach speed at the start of a step would overshoot and oscillate
at time steps of practical size.
"""

import contextlib
import functools
import io
from collections.abc import Callable
from types import ModuleType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Bool, Float

from sean_jax.core.data_types import Array, Obstacles, RobotModel
from sean_jax.core.geometry import from_box, from_rectangle, length, rotate, unit

GRAVITY = 9.81  # m/s2
CORNER = 2  # walls that a robot can touch at once
RECOVERY = 0.2  # share of an overlap that one physics step undoes (Baumgarte 1972); a larger one bounces

Motion = tuple[Float[Array, "5"], Float[Array, "5"]]
"""Generalised coordinates of a robot and their rates."""
Five = tuple[Array, ...]
"""The five generalised coordinates, velocities or impulses as scalars."""
Touch = Callable[..., tuple[Array, Array]]
"""``touch(position, vx, vy)`` gives the velocity (x, y) [m/s] that contacts leave, as ``touching``."""
UNBOUNDED = 1e3  # m/s, faster than anything that a contact allows
OVERLAP = 1e-4  # m, maximum penetration of an obstacle by a robot; a step beyond it is not taken


class RobotBody(NamedTuple):
    """What the physics of a robot depend on: fields of ``RobotModel``."""

    mass: Array
    inertia: Array
    wheel_radius: Array
    wheel_inertia: Array
    track: Array
    friction: Array
    servo_gain: Array
    servo_torque: Array
    max_speed: Array
    radius: Array
    time_step: Array | float


@struct.dataclass
class Surroundings:
    """Everything that a robot can touch during one control step."""

    obstacles: Obstacles
    position: Float[Array, "N 2"]  # m, of people at the end of the control step
    velocity: Float[Array, "N 2"]  # m/s
    present: Bool[Array, "N"]
    person_radius: Float[Array, ""]  # m


# --- tyres and contacts ---


def impulse(model: RobotModel, touch: Touch, motion: Motion, velocity: Float[Array, "5"]) -> Float[Array, "5"]:
    """Generalised impulse (5,) [N s, N m s] of the ground and of all contacts.

    The tyres act first, then people, then obstacles, so that no wall is ever passed.

    Args:
        velocity: rates at the end of the physics step, if there were no impulse.
    """
    position, _ = motion
    tyres, vx, vy = tyre_impulse(model, tuple(position), tuple(velocity))
    after = touch(position, vx, vy)
    return jnp.stack(add_contacts(model, tyres, (vx, vy), after))


def tyre_impulse(model: RobotModel | RobotBody, position: Five, velocity: Five) -> tuple[Five, Array, Array]:
    """The impulse of the tyres, and the velocity (x, y) [m/s] of the base that it leaves."""
    middle = position[2] + 0.5 * model.time_step * velocity[2]  # yaw halfway through the step: else turning would slip
    tyres = _tyres(model, jnp.cos(middle), jnp.sin(middle), velocity)
    return tyres, velocity[0] + tyres[0] / model.mass, velocity[1] + tyres[1] / model.mass


def add_contacts(
    model: RobotModel | RobotBody, tyres: Five, start: tuple[Array, Array], after: tuple[Array, Array]
) -> Five:
    """The impulse of tyres and contacts, from the velocities [m/s] without and with contacts."""
    jx = model.mass * (after[0] - start[0])
    jy = model.mass * (after[1] - start[1])
    return tyres[0] + jx, tyres[1] + jy, *tyres[2:]


def _tyres(model: RobotModel | RobotBody, cosine: Array, sine: Array, velocity: Five) -> Five:
    """The impulses of two tyres that end all slip, each within its friction circle.

    The longitudinal impulses solve a symmetric 2x2 system, because a push on one wheel also moves the other.
    """
    half_track = 0.5 * model.track
    ahead, aside = rotate(velocity[0], velocity[1], cosine, -sine)
    turning = half_track * velocity[2]  # m/s, of the wheels while the robot turns
    slip_left = ahead - turning - model.wheel_radius * velocity[3]
    slip_right = ahead + turning - model.wheel_radius * velocity[4]

    # The slip that a unit of a wheel's impulse removes: its own, and that of the other wheel.
    linear = 1.0 / model.mass
    angular = half_track * half_track / model.inertia
    own = linear + angular + model.wheel_radius * model.wheel_radius / model.wheel_inertia
    other = linear - angular
    determinant = own * own - other * other
    left = (other * slip_right - own * slip_left) / determinant
    right = (other * slip_left - own * slip_right) / determinant

    sideways = -0.5 * model.mass * aside  # of each tyre: they share it
    limit = 0.5 * model.friction * model.mass * GRAVITY * model.time_step
    left, left_side = clip_length(left, sideways, limit)
    right, right_side = clip_length(right, sideways, limit)
    jx, jy = rotate(left + right, left_side + right_side, cosine, sine)
    return jx, jy, half_track * (right - left), -model.wheel_radius * left, -model.wheel_radius * right


def clip_length(x: Array, y: Array, limit: Array) -> tuple[Array, Array]:
    """(x, y), shortened to the length ``limit`` if it is longer: the friction circle."""
    size = length(x, y)
    over = size > limit
    scale = jnp.where(over, limit / jnp.where(over, size, 1.0), 1.0)
    return x * scale, y * scale


def touching(
    model: RobotModel,
    surroundings: Surroundings,
    time_left: Float[Array, ""],
    position: Float[Array, "..."] | Five,
    vx: Float[Array, ""],
    vy: Float[Array, ""],
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """The velocity (x, y) [m/s] that contacts leave the robot's disc, of the velocity (vx, vy) [m/s] without contacts.

    A contact limits the approach speed to the gap per physics step, so that the robot comes
    to rest at the surface. It undoes a share of an overlap. There is no friction: the robot slides along.
    Deep overlaps, also several, do not make the robot faster than its top speed.

    Args:
        time_left: s, from the start of this physics step to the end of the control step.
        position: its first two are x and y [m].
    """
    x = position[0]
    y = position[1]
    people = *surroundings.position.T, *surroundings.velocity.T, surroundings.present
    if surroundings.present.shape[0]:
        person = functools.partial(person_contact, model, surroundings.person_radius, time_left)
        vx, vy = _touch(person, people, 1, x, y, vx, vy)
    if surroundings.obstacles.yaw.shape[0]:
        obstacle = functools.partial(obstacle_contact, model)
        vx, vy = _touch(obstacle, rectangles(surroundings.obstacles), CORNER, x, y, vx, vy)
    return vx, vy


def person_contact(
    model: RobotModel | RobotBody, person_radius: Array, time_left: Array, x: Array, y: Array, person: tuple[Array, ...]
) -> tuple[Array, Array, Array, Array]:
    """The contact of a robot at (x, y) with a person: x, y, velocities, present.

    Normal (x, y), allowed approach speed, and the speed [m/s] beyond which no contact pushes the robot while this one
    lasts. A person pushes the robot along from outside; the motion of one who is deep inside it does not push it.
    """
    px, py, ux, uy, present = person
    dx = x - (px - ux * time_left)
    dy = y - (py - uy * time_left)
    nx, ny = unit(dx, dy)
    gap = length(dx, dy) - (person_radius + model.radius)
    approach = _approach(model, gap)
    deep = approach <= -model.max_speed
    push = ux * nx + uy * ny
    push = jnp.where(deep, jnp.minimum(push, 0.0), push)
    bound = jnp.where(present & deep, model.max_speed, UNBOUNDED)
    return nx, ny, jnp.where(present, approach - push, jnp.inf), bound


def obstacle_contact(
    model: RobotModel | RobotBody, x: Array, y: Array, rectangle: tuple[Array, ...]
) -> tuple[Array, Array, Array, Array]:
    """The contact of a robot at (x, y) with one of ``rectangles``; see ``person_contact``."""
    distance, nx, ny = from_rectangle(x, y, *rectangle)
    gap = distance - model.radius
    return nx, ny, _approach(model, gap), jnp.where(gap < -OVERLAP, model.max_speed, UNBOUNDED)


def rectangles(obstacles: Obstacles) -> tuple[Float[Array, "K"], ...]:
    """Centre x and y [m], half extents [m], cosine and sine of the yaw of obstacles."""
    return *obstacles.center.T, *obstacles.half_extent.T, jnp.cos(obstacles.yaw), jnp.sin(obstacles.yaw)


def _approach(model: RobotModel | RobotBody, gap: Array) -> Array:
    """Maximum approach speed [m/s] at a contact with this gap [m]; negative for an overlap, where bodies separate.

    The speed of separation is limited to the robot's top speed, so that a deep overlap does not throw the robot out.
    """
    share = jnp.where(gap > 0.0, 1.0, RECOVERY)
    return jnp.maximum(share * gap / model.time_step, -model.max_speed)


def after_push(vx: Array, vy: Array, push: Array, nx: Array, ny: Array, bound: Array) -> tuple[Array, Array]:
    """(vx, vy) after a push along a normal, which does not make them longer than the bound [m/s]."""
    before = length(vx, vy)
    return clip_length(vx + push * nx, vy + push * ny, jnp.maximum(bound, before))


def _touch(contact: Callable, bodies: Any, times: int, x: Array, y: Array, vx: Array, vy: Array) -> tuple[Array, Array]:
    """(vx, vy) of a robot at (x, y) after the most violated contact was enforced, ``times`` times.

    ``contact(x, y, bodies) -> normal x, normal y, allowed approach speed, bound``. One contact at a time, because a
    wall of several boxes would otherwise throw the robot back once for each box. The choice of the contact has no
    gradient, so that reverse mode stores and visits this one only.
    """
    stop = jax.lax.stop_gradient
    all_nx, all_ny, all_allowed, bounds = contact(stop(x), stop(y), stop(bodies))
    bound = bounds.min()
    for _ in range(times):
        excess = -(stop(vx) * all_nx + stop(vy) * all_ny) - all_allowed
        strongest = jnp.argmax(excess)
        body = jax.tree.map(lambda leaf: leaf[strongest], bodies)  # noqa: B023
        nx, ny, allowed, _ = contact(x, y, body)
        push = jnp.maximum(-(vx * nx + vy * ny) - allowed, 0.0)
        vx, vy = after_push(vx, vy, push, nx, ny, bound)
    return vx, vy


# --- the closed-form twin ---


def _same(function: Callable) -> Callable:
    return function


def twin_substep(model: RobotModel, touch: Touch, motion: Motion, targets: Float[Array, "2"]) -> Motion:
    """One physics step of the closed-form twin, by semi-implicit Euler.

    The equations of motion are the MJX robot's: a planar base whose centre of mass lies above the middle of the
    axle has a diagonal, constant mass matrix and no forces that depend on the velocity.

    Args:
        targets: rad/s, the wheel speeds that the servos aim at.
    """
    position, velocity = twin_step(model, touch, tuple(motion[0]), tuple(motion[1]), (targets[0], targets[1]))
    return jnp.stack(position), jnp.stack(velocity)


def twin_step(
    model: RobotModel | RobotBody,
    touch: Touch,
    position: Five,
    velocity: Five,
    targets: tuple[Array, Array],
    form: Callable = _same,
) -> tuple[Five, Five]:
    """``twin_substep`` in scalars.

    Args:
        form: makes the functions that are evaluated, such as ``gpu_kernels.scalars``.
    """
    free, tyres, vx, vy = form(_without_contacts)(model, position, velocity, targets)
    return form(_advance)(model, position, free, tyres, (vx, vy), touch(position, vx, vy))


def _without_contacts(
    model: RobotModel | RobotBody, position: Five, velocity: Five, targets: tuple[Array, Array]
) -> tuple[Five, Five, Array, Array]:
    """Velocities after the servos, impulse of the tyres, and the base's velocity after both."""
    wheels = [_servo(model, rate, target) for rate, target in zip(velocity[3:], targets, strict=True)]
    free = *velocity[:3], *wheels
    return free, *tyre_impulse(model, position, free)


def _servo(model: RobotModel | RobotBody, rate: Array, target: Array) -> Array:
    """The rate [rad/s] of a wheel after a physics step of its servo."""
    torque = jnp.clip(model.servo_gain * (target - rate), -model.servo_torque, model.servo_torque)
    return rate + model.time_step * torque / model.wheel_inertia


def _advance(
    model: RobotModel | RobotBody,
    position: Five,
    free: Five,
    tyres: Five,
    start: tuple[Array, Array],
    after: tuple[Array, Array],
) -> tuple[Five, Five]:
    """Coordinates and velocities at the end of a physics step."""
    masses = model.mass, model.mass, model.inertia, model.wheel_inertia, model.wheel_inertia
    impulses = add_contacts(model, tyres, start, after)
    velocity = tuple(rate + impulse / mass for rate, impulse, mass in zip(free, impulses, masses, strict=True))
    position = tuple(value + model.time_step * rate for value, rate in zip(position, velocity, strict=True))
    return position, velocity


def diagonal(model: RobotModel) -> Float[Array, "5"]:
    """The diagonal of the mass matrix: kg, kg, kg m2, kg m2, kg m2."""
    return jnp.stack([model.mass, model.mass, model.inertia, model.wheel_inertia, model.wheel_inertia])


# --- the kinematic robot ---


class Way(NamedTuple):
    """The robot's position and velocity after a control step."""

    position: Float[Array, "2"]  # m
    speed: Float[Array, ""]  # m/s along its heading: less than commanded where something is in the way
    sideways: Float[Array, ""]  # m/s to the left, from contacts


# Reverse mode computes the way again rather than store it.
@functools.partial(jax.checkpoint, static_argnums=0, prevent_cse=False)
def kinematic_move(
    steps: int,
    model: RobotModel,
    surroundings: Surroundings,
    position: Float[Array, "2"],
    heading: Float[Array, "2"],
    speed: Float[Array, ""],
    turn_rate: Float[Array, ""],
    sideways: Float[Array, ""] | None = None,
) -> Way:
    """The result of a control step at constant speed [m/s] and turn rate [rad/s] from a position [m], without inertia.

    ``sideways`` is the speed [m/s] to the left of a robot that is no differential drive.

    SEAN sets the velocity of the robot's body in each step of physics, and bodies in its way stop it. Here the way is
    the arc of these speeds in closed form, and contacts are the same as for other robots (``touching``).
    """
    # The chord of an arc is its length times sinc of half its angle, so a free robot goes the exact arc.
    turn = model.time_step * turn_rate  # rad in a step of physics
    share = jnp.sinc(turn / (2.0 * jnp.pi))
    chord = speed * share  # m/s, along the straight line between the ends of its arc

    def substep(carry: tuple[Way, Array], index: Array) -> tuple[tuple[Way, Array], None]:
        way, gap = carry
        # A chord has the heading of the middle of its arc.
        angle = (index + 0.5) * turn
        cosine, sine = rotate(heading[0], heading[1], jnp.cos(angle), jnp.sin(angle))
        if sideways is None:
            vx = chord * cosine
            vy = chord * sine
        else:
            vx, vy = rotate(chord, sideways * share, cosine, sine)

        # Contacts act on the velocity over the ground, as of robots with inertia.
        time_left = model.time_step * (steps - index)
        free_vx, free_vy = touching(model, surroundings, time_left, way.position, vx, vy)

        # Several contacts may contradict each other: a step farther into an obstacle is not taken.
        after = way.position + model.time_step * jnp.stack([free_vx, free_vy])
        gap_after = _gap(model, surroundings, after)
        is_free = gap_after >= jnp.minimum(gap, -OVERLAP)

        # Speeds are in the robot's axes: the commanded ones, and what contacts take or give.
        ahead, aside = rotate(free_vx - vx, free_vy - vy, cosine, -sine)
        ahead = speed + ahead
        if sideways is not None:
            aside = sideways + aside
        way = Way(
            position=jnp.where(is_free, after, way.position),
            speed=jnp.where(is_free, ahead, 0.0),
            sideways=jnp.where(is_free, aside, 0.0),
        )
        return (way, jnp.where(is_free, gap_after, gap)), None

    start = Way(position, speed, jnp.zeros_like(speed))
    carry = start, _gap(model, surroundings, position)
    (way, _), _ = jax.lax.scan(substep, carry, jnp.arange(steps).astype(position.dtype))
    return way


def _gap(model: RobotModel, surroundings: Surroundings, place: Array) -> Array:
    """() m to the nearest obstacle, negative inside, without a gradient; infinite if there is none."""
    x, y = jax.lax.stop_gradient((place[0], place[1]))
    boxes = jax.lax.stop_gradient(surroundings.obstacles)
    return from_box(x, y, boxes)[0].min(initial=jnp.inf) - model.radius


# --- the MJX robot: MuJoCo XLA computes mass matrix, bias and servo forces; the ground acts as an applied force ---
# Only those stages of ``mjx.step`` run that a base without constraints needs: no collision, no solver (reverse mode
# refuses its loop), no sensors, and no factorization, because loading has checked that the mass matrix is diagonal.


@functools.cache
def mjx() -> ModuleType:
    """The module ``mujoco.mjx``. Imported here, since that takes a second and prints a message about Warp."""
    with contextlib.redirect_stdout(io.StringIO()):
        import mujoco.mjx as module
    return module


def mjx_data(model: Any, mass: Float[Array, "dof"]) -> tuple:
    """``RobotModel.data`` of the MJX robot of a ``mujoco.MjModel``."""
    return mjx().put_model(model, impl="jax"), mass


def mjx_substep(model: RobotModel, touch: Touch, motion: Motion, targets: Float[Array, "2"]) -> Motion:
    """One physics step by MJX; arguments as of ``twin_substep``."""
    ground = functools.partial(impulse, model, touch, motion)
    return mjx_advance(model, diagonal(model), (model.servo_gain, model.servo_torque), motion, targets, ground)


def mjx_advance(
    model: RobotModel,
    diagonal: Float[Array, "dof"],
    servo: tuple[Array, Array],
    motion: tuple[Float[Array, "dof"], Float[Array, "dof"]],
    targets: Float[Array, "targets"],
    ground: Callable,
) -> tuple[Float[Array, "dof"], Float[Array, "dof"]]:
    """One physics step by MJX.

    Args:
        diagonal: kg, kg m2, of the mass matrix.
        servo: gain and maximum force of the actuators: one for all, or one for each.
        ground: ``ground(velocity)`` gives the generalised impulse of ground and contacts.
    """
    # MJX mixes ranks and dtypes on purpose; a caller may have forbidden that for its own code.
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        physics = _parametrized(model, diagonal, *servo)
        data = mjx().make_data(physics, impl="jax").replace(qpos=motion[0], qvel=motion[1], ctrl=targets)
        for stage in ("kinematics", "com_pos", "crb", "transmission", "fwd_velocity", "fwd_actuation"):
            data = getattr(mjx(), stage)(physics, data)
        mass = jnp.diagonal(mjx().full_m(physics, data))
        free = (data.qfrc_actuator + data.qfrc_passive - data.qfrc_bias) / mass
        impulse = ground(data.qvel + model.time_step * free)
        data = data.replace(qacc=free + impulse / (model.time_step * mass))
        data = mjx().euler(physics, data)
        return data.qpos, data.qvel


def _parametrized(model: RobotModel, diagonal: Array, gain: Array, torque: Array) -> Any:
    """The MJX model with the parameters of the robot model, which may differ from its file.

    An armature is an inertia added to one joint. It changes the mass matrix without changing the geometry.
    """
    physics, mass = model.data
    force_range = jnp.stack([-torque, torque], -1)
    return physics.replace(
        dof_armature=physics.dof_armature + (diagonal - mass),
        actuator_gainprm=physics.actuator_gainprm.at[:, 0].set(gain),
        actuator_biasprm=physics.actuator_biasprm.at[:, 2].set(-gain),
        actuator_forcerange=jnp.broadcast_to(force_range, physics.actuator_forcerange.shape),
    )
