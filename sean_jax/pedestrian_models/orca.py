"""Optimal reciprocal collision avoidance: velocities that lead to no collision within a time horizon.

J. van den Berg, S. J. Guy, M. Lin & D. Manocha, "Reciprocal n-body collision avoidance", Robotics Research (2011).
Each neighbour leaves a half-plane of velocities, of which people take the one nearest to their desired velocity.
People share the avoidance equally; the robot is avoided wholly, for it need not reciprocate; so are obstacles.
"""

import jax
import jax.numpy as jnp

from sean_jax.base import Array, Pedestrians, Scenario, State
from sean_jax.geometry import length, unit
from sean_jax.pedestrian_models.constant_velocity import walk
from sean_jax.pedestrian_models.half_planes import NEVER, best_velocity
from sean_jax.social_forces.walls import distances

HORIZON = 3.0  # s, without a collision with people and the robot; ours
WALL_HORIZON = 0.5  # s, likewise with obstacles; ours
NEIGHBORS = 8  # the nearest people that are heeded; ours
WALLS = 4  # the nearest obstacles that are heeded; ours
RANGE = 10.0  # m, who is farther away is not
SPACE = 0.1  # m, kept between two bodies; ours


def orca(scenario: Scenario, state: State) -> Pedestrians:
    """Each takes the velocity nearest to the desired one that avoids everybody in time.

    People one control step later.
    """
    people, parameters, robot = state.pedestrians, scenario.forces, state.robot
    px, py = people.position[:, 0], people.position[:, 1]
    vx, vy = people.velocity[:, 0], people.velocity[:, 1]
    others = _neighbors(people)
    half_planes = jax.vmap(half_plane, in_axes=(0, 0, 0, 0, None, None, None, 0))
    each = jax.vmap(half_planes, in_axes=(0, 0, 0, 0, None, None, None, 0))
    index = jnp.arange(px.shape[0], dtype=jnp.int32)
    first = index[:, None] < others  # which of two people at one place goes which way
    nx, ny, c = each(
        px[others] - px[:, None],
        py[others] - py[:, None],
        vx[:, None] - vx[others],
        vy[:, None] - vy[others],
        2.0 * parameters.radius + SPACE,
        HORIZON,
        scenario.time_step,
        first,
    )
    c = nx * vx[:, None] + ny * vy[:, None] + 0.5 * c
    heeded = _heeded(people, others)

    robot_x, robot_y = robot.speed * robot.heading[0], robot.speed * robot.heading[1]
    rx, ry, rc = half_planes(
        robot.position[0] - px,
        robot.position[1] - py,
        vx - robot_x,
        vy - robot_y,
        parameters.radius + scenario.robot.radius + SPACE,
        HORIZON,
        scenario.time_step,
        jnp.ones_like(people.present),
    )
    rc = rx * vx + ry * vy + rc

    gap, wx, wy = distances(px, py, scenario.environment.nearby)
    least, nearest = jax.lax.top_k(-gap, min(WALLS, gap.shape[1]))
    wx, wy = jnp.take_along_axis(wx, nearest, 1), jnp.take_along_axis(wy, nearest, 1)
    wall = -jnp.maximum(-least - parameters.radius, 0.0) / WALL_HORIZON

    normal_x = jnp.concatenate([nx, rx[:, None], wx], 1)
    normal_y = jnp.concatenate([ny, ry[:, None], wy], 1)
    bound = jnp.concatenate([jnp.where(heeded, c, NEVER), rc[:, None], wall], 1)
    hard = jnp.arange(bound.shape[1]) >= others.shape[1] + 1
    desired, limit = people.desired_velocity, parameters.speed_ratio * people.preferred_speed
    x, y = jax.vmap(best_velocity, in_axes=(0, 0, 0, None, 0, 0, 0))(
        normal_x, normal_y, bound, hard, desired[:, 0], desired[:, 1], limit
    )
    return walk(scenario, people, jnp.stack([x, y], -1))


def half_plane(
    dx: Array, dy: Array, vx: Array, vy: Array, reach: Array, horizon: float, time_step: float, first: Array
) -> tuple[Array, Array, Array]:
    """Unit normal (nx, ny) out of the velocity obstacle of another disc, and u: how far [m/s] out of it that leads.

    ``d`` [m] leads to the other, ``v`` [m/s] is the velocity relative to it and ``reach`` [m] the sum of both radii.
    The obstacle holds the relative velocities with which discs touch within ``horizon`` [s]: a cone with a round
    tip. u is the way from ``v`` to its border along the normal there, negative if ``v`` lies outside. Discs
    that overlap are to part within ``time_step`` [s]; ``first`` decides which way if they are at one place.
    """
    distance = length(dx, dy)
    ex, ey = unit(dx, dy)
    ex = jnp.where((ex == 0.0) & (ey == 0.0), jnp.where(first, 1.0, -1.0), ex)
    apart = distance > reach
    within = jnp.where(apart, horizon, time_step)
    # Along the line to the other and across it, mirrored so that the velocity lies to the left of the line.
    along, across = vx * ex + vy * ey - distance / within, vy * ex - vx * ey
    side = jnp.where(across > 0.0, 1.0, -1.0)
    across = across * side
    inverse = jnp.where(apart, 1.0 / jnp.where(apart, distance, 1.0), 0.0)
    beyond = jnp.where(apart, (distance - reach) * (distance + reach), 1.0)  # positive, however little they are apart
    sine, cosine = reach * inverse, jnp.where(apart, jnp.sqrt(beyond) * inverse, 1.0)
    leg = apart & (along * cosine + across * sine > 0.0)
    size = length(along, across)
    tip_a, tip_b = unit(along, across)
    tip_a = jnp.where(size == 0.0, -1.0, tip_a)
    na, nb = jnp.where(leg, -sine, tip_a), jnp.where(leg, cosine, tip_b)
    out = reach / within - jnp.where(leg, across * cosine - along * sine, size)
    nb = nb * side
    return na * ex - nb * ey, na * ey + nb * ex, out


def _neighbors(people: Pedestrians) -> Array:
    """(N, K) int32 the nearest others of each person."""
    x, y = people.position[:, 0], people.position[:, 1]
    dx, dy = x[:, None] - x[None, :], y[:, None] - y[None, :]
    square = jnp.where(people.present[None, :], dx * dx + dy * dy, jnp.inf)
    square = jnp.where(jnp.eye(x.shape[0], dtype=bool), jnp.inf, square)
    return jax.lax.top_k(-square, min(NEIGHBORS, x.shape[0]))[1].astype(jnp.int32)


def _heeded(people: Pedestrians, others: Array) -> Array:
    """(N, K) bool: somebody else, who is there and near, and does not stand in the same group."""
    x, y, group = people.position[:, 0], people.position[:, 1], people.group
    dx, dy = x[others] - x[:, None], y[others] - y[:, None]
    together = (group[:, None] >= 0) & (group[others] == group[:, None])
    itself = others == jnp.arange(x.shape[0], dtype=jnp.int32)[:, None]
    return people.present[others] & ~itself & ~together & (dx * dx + dy * dy < RANGE * RANGE)
