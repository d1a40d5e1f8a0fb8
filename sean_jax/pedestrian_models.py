"""Pedestrian models (section IV-D, low level): how people move to the goals of their behavior.

Beside the social forces: constant velocity, and optimal reciprocal collision avoidance (ORCA) of J. van den Berg, S. J.
Guy, M. Lin & D. Manocha, "Reciprocal n-body collision avoidance", Robotics Research (2011).
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from sean_jax import social_forces
from sean_jax.base import Array, Pedestrians, Scenario, State
from sean_jax.errors import InputError
from sean_jax.geometry import length, unit
from sean_jax.social_forces.forces import turn
from sean_jax.social_forces.walls import distances, project_velocity

HORIZON = 3.0  # s, without a collision with people and the robot; ours
WALL_HORIZON = 0.5  # s, likewise with obstacles; ours
NEIGHBORS = 8  # the nearest people that are avoided; ours
WALLS = 4  # the nearest obstacles that are avoided; ours
RANGE = 10.0  # m, nobody farther away is avoided
SPACE = 0.1  # m, kept between two bodies; ours
PARALLEL = 1e-6  # sine of the angle below which two borders count as parallel
TOLERANCE = 1e-5  # m/s
FORBIDDEN = 1e6  # times what is above the top speed or violates a hard half-plane counts as a violation
UNBOUNDED = -1e6  # m/s: c of a half-plane that holds every velocity
PREFERRED_SPEED = 1.34  # m/s, Helbing & Molnar, Phys. Rev. E 51, 4282 (1995)


def constant_velocity(scenario: Scenario, state: State) -> Pedestrians:
    """People take their desired velocity at once, through one another and the robot, but not into obstacles.

    The simplest baseline of trajectory prediction (Schoeller et al., IEEE RA-L 5(2), 2020, found it hard to beat).
    """
    return walk(scenario, state.pedestrians, state.pedestrians.desired_velocity)


def walk(scenario: Scenario, people: Pedestrians, velocity: Float[Array, "N 2"]) -> Pedestrians:
    """People one step later with these velocities [m/s], as far as speed limit and obstacles allow."""
    walking, (px, py) = scenario.forces.walking, people.position.T
    vx, vy = walking.limit_speed(velocity[:, 0], velocity[:, 1], people.preferred_speed)
    vx, vy = project_velocity(px, py, vx, vy, scenario.environment.obstacle_grid, walking.radius, scenario.time_step)
    velocity = jnp.where(people.present[:, None], jnp.stack([vx, vy], -1), 0.0)
    heading = turn(people, velocity, walking.turn_rate * scenario.time_step)
    return replace(people, position=people.position + velocity * scenario.time_step, velocity=velocity, heading=heading)


def orca(scenario: Scenario, state: State) -> Pedestrians:
    """Each person takes the velocity nearest to the desired one that avoids everybody in time.

    Each neighbor allows a half-plane of velocities, n . v >= c with a unit normal n = (nx, ny); the velocity lies in
    all of them. People share the avoidance of one another equally. They avoid the robot and obstacles wholly, because
    these need not reciprocate.
    """
    people, walking, robot = state.pedestrians, scenario.forces.walking, state.robot
    px, py = people.position[:, 0], people.position[:, 1]
    vx, vy = people.velocity[:, 0], people.velocity[:, 1]
    others = _neighbors(people)
    half_planes = jax.vmap(half_plane, in_axes=(0, 0, 0, 0, None, None, None, 0))
    each = jax.vmap(half_planes, in_axes=(0, 0, 0, 0, None, None, None, 0))
    index = jnp.arange(px.shape[0], dtype=jnp.int32)
    first = index[:, None] < others  # breaks the tie of two people at one place
    nx, ny, c = each(
        px[others] - px[:, None],
        py[others] - py[:, None],
        vx[:, None] - vx[others],
        vy[:, None] - vy[others],
        2.0 * walking.radius + SPACE,
        HORIZON,
        scenario.time_step,
        first,
    )
    c = nx * vx[:, None] + ny * vy[:, None] + 0.5 * c
    avoided = _avoided(people, others)

    robot_x, robot_y = robot.speed * robot.heading[0], robot.speed * robot.heading[1]
    rx, ry, rc = half_planes(
        robot.position[0] - px,
        robot.position[1] - py,
        vx - robot_x,
        vy - robot_y,
        walking.radius + scenario.robot.radius + SPACE,
        HORIZON,
        scenario.time_step,
        jnp.ones_like(people.present),
    )
    rc = rx * vx + ry * vy + rc

    gap, wx, wy = distances(px, py, scenario.environment.obstacle_grid)
    closeness, nearest = jax.lax.top_k(-gap, min(WALLS, gap.shape[1]))
    wx, wy = jnp.take_along_axis(wx, nearest, 1), jnp.take_along_axis(wy, nearest, 1)
    wall = -jnp.maximum(-closeness - walking.radius, 0.0) / WALL_HORIZON

    normal_x = jnp.concatenate([nx, rx[:, None], wx], 1)
    normal_y = jnp.concatenate([ny, ry[:, None], wy], 1)
    bound = jnp.concatenate([jnp.where(avoided, c, UNBOUNDED), rc[:, None], wall], 1)
    hard = jnp.arange(bound.shape[1]) >= others.shape[1] + 1
    desired, limit = people.desired_velocity, jnp.maximum(walking.speed_ratio * people.preferred_speed, 0.0)
    program = VelocityProgram(normal_x, normal_y, bound, hard, desired[:, 0], desired[:, 1], limit)
    x, y = jax.vmap(best_velocity, in_axes=(VelocityProgram(0, 0, 0, None, 0, 0, 0),))(program)  # pyright: ignore[reportArgumentType]
    return walk(scenario, people, jnp.stack([x, y], -1))


def half_plane(
    dx: Float[Array, "..."],
    dy: Float[Array, "..."],
    vx: Float[Array, "..."],
    vy: Float[Array, "..."],
    radii: Float[Array, "..."] | float,
    horizon: float,
    time_step: float,
    first: Bool[Array, "..."] | bool,
) -> tuple[Float[Array, "..."], Float[Array, "..."], Float[Array, "..."]]:
    """The way out of the velocity obstacle of another disc: unit normal (nx, ny) and distance [m/s] of its border.

    The obstacle holds the relative velocities with which the discs touch within the horizon: a cone with a round tip.
    Normal and distance are those of the border's point nearest to the velocity; outside the distance is negative.

    Args:
        dx, dy: m, to the other.
        vx, vy: m/s, relative to the other.
        radii: m, sum of both radii.
        horizon: s.
        time_step: s, within which overlapping discs are to part.
        first: breaks the tie of two people at one place.
    """
    distance = length(dx, dy)
    ex, ey = unit(dx, dy)
    ex = jnp.where((ex == 0.0) & (ey == 0.0), jnp.where(first, 1.0, -1.0), ex)
    apart = distance > radii
    within = jnp.where(apart, horizon, time_step)
    # Along the line to the other and across it, mirrored so that the velocity lies to the left of the line.
    along, across = vx * ex + vy * ey - distance / within, vy * ex - vx * ey
    side = jnp.where(across > 0.0, 1.0, -1.0)
    across = across * side
    inverse = jnp.where(apart, 1.0 / jnp.where(apart, distance, 1.0), 0.0)
    beyond = jnp.where(apart, (distance - radii) * (distance + radii), 1.0)  # positive, however small the gap
    sine, cosine = radii * inverse, jnp.where(apart, jnp.sqrt(beyond) * inverse, 1.0)
    leg = apart & (along * cosine + across * sine > 0.0)
    size = length(along, across)
    tip_a, tip_b = unit(along, across)
    tip_a = jnp.where(size == 0.0, -1.0, tip_a)
    na, nb = jnp.where(leg, -sine, tip_a), jnp.where(leg, cosine, tip_b)
    out = radii / within - jnp.where(leg, across * cosine - along * sine, size)
    nb = nb * side
    return na * ex - nb * ey, na * ey + nb * ex, out


class VelocityProgram(NamedTuple):
    """The choice of a velocity v in M half-planes, n . v >= c, nearest to a preferred one."""

    nx: Float[Array, "M"]
    ny: Float[Array, "M"]
    c: Float[Array, "M"]  # m/s, bounds
    hard: Bool[Array, "M"]  # never violated; these must contain the zero velocity
    px: Float[Array, ""]  # m/s, the preferred velocity
    py: Float[Array, ""]
    limit: Float[Array, ""]  # m/s, the top speed


def nearest(program: VelocityProgram) -> tuple[Float[Array, ""], Float[Array, ""], Bool[Array, ""]]:
    """The velocity (x, y) [m/s] in all half-planes that is nearest to the preferred one, and whether there is one.

    It is the preferred one, or lies on the border of some half-plane. So there is one candidate for each border: the
    nearest point of its segment that the other half-planes allow. If there is none, (x, y) has no meaning.
    """
    nx, ny, c, _, px, py, limit = program
    speed = length(px, py)
    slower = jnp.where(speed > limit, limit / jnp.where(speed > limit, speed, 1.0), 1.0)
    free_x, free_y = px * slower, py * slower
    is_free = (nx * free_x + ny * free_y >= c - TOLERANCE).all()

    lower, upper, possible = _border_segments(program)
    t = jnp.clip(px * -ny + py * nx, lower, jnp.maximum(lower, upper))
    x, y = c * nx - t * ny, c * ny + t * nx
    away = jnp.where(possible, (x - px) ** 2 + (y - py) ** 2, jnp.inf)
    best = jnp.argmin(away)
    return jnp.where(is_free, free_x, x[best]), jnp.where(is_free, free_y, y[best]), is_free | (away[best] < jnp.inf)


def _border_segments(
    program: VelocityProgram,
) -> tuple[Float[Array, "M"], Float[Array, "M"], Bool[Array, "M"]]:
    """The segment (from t, to t) of each border that other half-planes and top speed allow, and whether there is one.

    A point of border i is c n + t (-ny, nx).
    """
    nx, ny, c, _, _, _, limit = program
    low, high = _chord(c, limit)
    # There, half-plane j is rate t >= rest.
    rate = ny[None, :] * nx[:, None] - nx[None, :] * ny[:, None]  # (i, j)
    rest = c[None, :] - c[:, None] * (nx[:, None] * nx[None, :] + ny[:, None] * ny[None, :])
    itself = jnp.eye(c.shape[0], dtype=bool)
    slope = jnp.abs(rate) > PARALLEL
    bound = rest / jnp.where(slope, rate, 1.0)
    lower = jnp.where(slope & (rate > 0.0) & ~itself, bound, -jnp.inf).max(1)
    upper = jnp.where(slope & (rate < 0.0) & ~itself, bound, jnp.inf).min(1)
    lower, upper = jnp.maximum(lower, low), jnp.minimum(upper, high)
    return lower, upper, (high > 0.0) & (lower <= upper + TOLERANCE) & (slope | itself | (rest <= TOLERANCE)).all(1)


def _chord(c: Float[Array, "*M"], limit: Float[Array, ""]) -> tuple[Float[Array, "*M"], Float[Array, "*M"]]:
    """The segment of a border within the top speed, from t to t; both are zero where there is none."""
    square = limit * limit - c * c
    half = jnp.where(square > 0.0, jnp.sqrt(jnp.where(square > 0.0, square, 1.0)), 0.0)
    return -half, half


def best_velocity(program: VelocityProgram) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """As ``nearest``; if there is none, the velocity [m/s] whose largest violation of a half-plane is smallest."""
    free_x, free_y, exists = nearest(program)

    def violation(i: Array, j: Array) -> Array:
        fixed = jax.lax.stop_gradient(program)
        nx, ny, c, hard, _, _, limit = fixed
        x, y, opposite = _least_violating(i, j, fixed)
        each = c - nx * x - ny * y
        forbidden = jnp.maximum(jnp.where(hard, each, UNBOUNDED).max(), length(x, y) - limit)
        largest = jnp.where(hard, UNBOUNDED, each).max() + FORBIDDEN * jnp.maximum(forbidden - TOLERANCE, 0.0)
        return largest - jnp.where(opposite, TOLERANCE, 0.0)  # other velocities are ends of the segment of these

    first, second = (jnp.asarray(index, jnp.int32) for index in np.triu_indices(program.c.shape[0]))
    least = jnp.argmin(jax.vmap(violation)(first, second))
    x, y, _ = _least_violating(first[least], second[least], program)
    return jnp.where(exists, free_x, x), jnp.where(exists, free_y, y)


def _least_violating(
    i: Int[Array, ""], j: Int[Array, ""], program: VelocityProgram
) -> tuple[Float[Array, ""], Float[Array, ""], Bool[Array, ""]]:
    """The velocity with the least equal violation of half-planes i and j and no larger one of others; if i opposes j.

    Three dimensions, the velocity and the violation, have three bounds at their optimum: two half-planes and a third or
    the top speed, or one and the top speed (i = j). If i and j oppose each other, all velocities of a segment are
    equally good; the result is the one nearest to the preferred. If there is no such velocity, the result has no
    meaning. A hard half-plane is not violated, but met on its border.
    """
    nx, ny, c, hard, px, py, limit = program
    i, j = jnp.where(hard[i], j, i), jnp.where(hard[i], i, j)
    # Half-plane k is violated by no more than i, where m . v >= b.
    mx, my = nx - jnp.where(hard, 0.0, nx[i]), ny - jnp.where(hard, 0.0, ny[i])
    b = c - jnp.where(hard, 0.0, c[i])
    size = length(mx[j], my[j])
    ax, ay = unit(mx[j], my[j])
    offset = jnp.where(size > 0.0, b[j] / jnp.where(size > 0.0, size, 1.0), 0.0)
    lower, upper = _chord(offset, limit)
    rate, rest = my * ax - mx * ay, b - offset * (mx * ax + my * ay)  # there, t rate >= rest
    others = (jnp.abs(rate) > PARALLEL) & (jnp.arange(c.shape[0], dtype=jnp.int32) != j)
    bound = rest / jnp.where(others, rate, 1.0)
    lower = jnp.maximum(lower, jnp.where(others & (rate > 0.0), bound, -jnp.inf).max())
    upper = jnp.maximum(lower, jnp.minimum(upper, jnp.where(others & (rate < 0.0), bound, jnp.inf).min()))
    gain = ny[i] * ax - nx[i] * ay
    opposite = (jnp.abs(gain) <= PARALLEL) & (i != j)
    t = jnp.where(opposite, jnp.clip(py * ax - px * ay, lower, upper), jnp.where(gain > 0.0, upper, lower))
    x, y = offset * ax - t * ay, offset * ay + t * ax
    return jnp.where(i == j, limit * nx[i], x), jnp.where(i == j, limit * ny[i], y), opposite


def _neighbors(people: Pedestrians) -> Array:
    """(N, K) the nearest others of each person."""
    x, y = people.position[:, 0], people.position[:, 1]
    dx, dy = x[:, None] - x[None, :], y[:, None] - y[None, :]
    square = jnp.where(people.present[None, :], dx * dx + dy * dy, jnp.inf)
    square = jnp.where(jnp.eye(x.shape[0], dtype=bool), jnp.inf, square)
    return jax.lax.top_k(-square, min(NEIGHBORS, x.shape[0]))[1].astype(jnp.int32)


def _avoided(people: Pedestrians, others: Array) -> Array:
    """(N, K) whether an other is present, near and not in the same standing group."""
    x, y, group = people.position[:, 0], people.position[:, 1], people.group
    dx, dy = x[others] - x[:, None], y[others] - y[:, None]
    together = (group[:, None] >= 0) & (group[others] == group[:, None])
    itself = others == jnp.arange(x.shape[0], dtype=jnp.int32)[:, None]
    return people.present[others] & ~itself & ~together & (dx * dx + dy * dy < RANGE * RANGE)


MODELS = {"social_forces": social_forces.move, "constant_velocity": constant_velocity, "orca": orca}
"""name -> (scenario, state) -> Pedestrians one control step later"""


def pedestrians_at(
    position: Float[Array, "N 2"],
    velocity: Float[Array, "N 2"] | None = None,
    *,
    goal: Float[Array, "N 2"] | Float[Array, "2"] | None = None,
    desired_velocity: Float[Array, "N 2"] | None = None,
    preferred_speed: Float[Array, "N"] | Float[Array, ""] | float | None = None,
    heading: Float[Array, "N 2"] | None = None,
    present: Bool[Array, "N"] | None = None,
) -> Pedestrians:
    """People at these positions, in no group, each walking alone. To direct them later, replace ``desired_velocity``.

    People with a goal desire to walk straight to it at their preferred speed; people without one keep their velocity.

    Args:
        position: m.
        velocity: m/s; the desired velocity if None.
        goal: m, or (2,) one for all; excludes ``desired_velocity``.
        desired_velocity: m/s.
        preferred_speed: m/s, or one for all; if None, the speed of ``desired_velocity``, and 1.34 for people with a
            goal or who stand (top speed is a multiple of it, so 0 would freeze them).
        heading: unit vectors; if None, along the velocity, else along the desired one, else (1, 0).
        present: all if None.

    Raises:
        InputError: both a goal and a desired velocity are given.
    """
    if goal is not None and desired_velocity is not None:
        raise InputError("goal: a desired velocity is given as well; give one of the two.")
    position = jnp.asarray(position, float)
    number = position.shape[0]
    if goal is not None:
        speed = PREFERRED_SPEED if preferred_speed is None else preferred_speed
        preferred_speed = jnp.broadcast_to(jnp.asarray(speed, float), (number,))
        way = jnp.asarray(goal, float).reshape(-1, 2) - position
        desired = jnp.stack(unit(way[:, 0], way[:, 1]), -1) * preferred_speed[:, None]
    else:
        desired = velocity if desired_velocity is None else desired_velocity
        desired = jnp.zeros_like(position) if desired is None else jnp.asarray(desired, float)
    velocity = desired if velocity is None else jnp.asarray(velocity, float)
    if preferred_speed is None:
        speed = length(desired[:, 0], desired[:, 1])
        preferred_speed = jnp.where(speed > 0.0, speed, PREFERRED_SPEED)
    if heading is None:
        moves = ((velocity != 0.0).any(-1))[:, None]
        along = jnp.where(moves, velocity, desired)
        along = jnp.where((along != 0.0).any(-1)[:, None], along, jnp.asarray([[1.0, 0.0]], float))
        heading = jnp.stack(unit(along[:, 0], along[:, 1]), -1)
    return Pedestrians(
        position=position,
        velocity=velocity,
        heading=jnp.asarray(heading, float),
        desired_velocity=desired,
        group=jnp.full(number, -1, jnp.int32),
        walking_group=jnp.full(number, -1, jnp.int32),
        present=jnp.ones(number, bool) if present is None else jnp.asarray(present, bool),
        preferred_speed=jnp.broadcast_to(jnp.asarray(preferred_speed, float), (number,)),
        robot_distance=jnp.zeros(number, float),
    )
