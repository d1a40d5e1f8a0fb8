"""Optimal reciprocal collision avoidance (ORCA) among people (section IV-D, low level).

J. van den Berg, S. J. Guy, M. Lin & D. Manocha, "Reciprocal n-body collision avoidance", Robotics Research (2011).
``orca_solver`` has the half-planes and the best velocity in them.
"""

from functools import partial, reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from sean_jax.core.data_types import Array, Pedestrians, Scenario, State
from sean_jax.core.geometry import ground_velocity
from sean_jax.people.constant_velocity import walk
from sean_jax.people.orca_solver import UNBOUNDED, VelocityProgram, best_velocity, half_plane
from sean_jax.social_forces.walls import distances

HORIZON = 3.0  # s, without a collision with people and the robot; ours
WALL_HORIZON = 0.5  # s, likewise with obstacles; ours
NEIGHBORS = 8  # the nearest people that are avoided; ours
WALLS = 4  # the nearest obstacles that are avoided; ours
RANGE = 10.0  # m, nobody farther away is avoided
SPACE = 0.1  # m, kept between two bodies; ours


def orca(scenario: Scenario, state: State) -> Pedestrians:
    """Each person takes the velocity nearest to the desired one that avoids everybody in time.

    Each neighbor allows a half-plane of velocities, n . v >= c with a unit normal n = (nx, ny); the velocity lies in
    all of them. People share the avoidance of one another equally. They avoid the robot and obstacles wholly, because
    these need not reciprocate.
    """
    people = state.pedestrians
    px, py, vx, vy = jnp.concatenate([people.position, people.velocity], 1).T[:, None]  # (1, N)
    soft = _planes_of_others(scenario, state, px, py, vx, vy)
    hard = _planes_of_walls(scenario, px[0], py[0])

    n_soft = len(soft.c)
    n_planes = n_soft + len(hard.c)
    any_numbers = jnp.broadcast_to(px, (n_planes, px.shape[1]))
    nx = _join(any_numbers, soft.nx, hard.nx)
    ny = _join(any_numbers, soft.ny, hard.ny)
    c = _join(any_numbers, soft.c, hard.c)
    is_hard = jnp.arange(len(c), dtype=jnp.int32) >= n_soft

    ratio = scenario.forces.walking.speed_ratio
    limit = jnp.maximum(ratio * people.preferred_speed, 0.0)
    desired_x, desired_y = people.desired_velocity.T
    program = VelocityProgram(nx, ny, c, is_hard, desired_x, desired_y, limit)
    x, y = best_velocity(program)
    velocity = jnp.stack([x, y], -1)
    return walk(scenario, people, velocity)


class Planes(NamedTuple):
    """K half-planes of velocities v, n . v >= c, for each of N people."""

    nx: Float[Array, "K N"]
    ny: Float[Array, "K N"]
    c: Float[Array, "K N"]  # m/s, bounds


def _join(
    any_numbers: Float[Array, "M N"], soft: Float[Array, "K N"], hard: Float[Array, "L N"]
) -> Float[Array, "M N"]:
    """Rows of soft half-planes and then of hard ones.

    They are written over any numbers that are no constant. If they were concatenated or written over zeros, XLA on a
    CPU would compute the half-planes row by row, with a condition for each number.
    """
    n_soft = len(soft)
    with_soft = any_numbers.at[:n_soft].set(soft)
    return with_soft.at[n_soft:].set(hard)


def _planes_of_others(
    scenario: Scenario,
    state: State,
    px: Float[Array, "1 N"],
    py: Float[Array, "1 N"],
    vx: Float[Array, "1 N"],
    vy: Float[Array, "1 N"],
) -> Planes:
    """The half-planes that the nearest people and the robots allow people at (px, py) [m], with (vx, vy) [m/s]."""
    people = state.pedestrians
    robot = state.robot
    n_robots = robot.speed.size  # 1, or of a team
    others, is_robot = _others(people, n_robots)  # (K, N), (K, 1)

    # Places and velocities of the others, (K, N).
    velocity = ground_velocity(robot)
    other_x = jnp.append(px, robot.position[..., 0])[others]
    other_y = jnp.append(py, robot.position[..., 1])[others]
    other_vx = jnp.append(vx, velocity[..., 0])[others]
    other_vy = jnp.append(vy, velocity[..., 1])[others]

    # Robots are avoided at any distance.
    dx = other_x - px
    dy = other_y - py
    is_near = dx * dx + dy * dy < RANGE * RANGE
    avoided = is_robot | (_avoids(people, others) & is_near)

    radius = scenario.forces.walking.radius
    radius_of_people = jnp.full(len(others) - n_robots, radius)
    other_radius = jnp.append(radius_of_people, scenario.robot.radius)  # (K,)
    radii = radius + other_radius[:, None] + SPACE

    person = jnp.arange(px.shape[1], dtype=jnp.int32)[None]
    first = person < others  # breaks the tie of two people at one place
    relative_vx = vx - other_vx
    relative_vy = vy - other_vy
    nx, ny, out = half_plane(dx, dy, relative_vx, relative_vy, radii, HORIZON, scenario.time_step, first)

    # People do half of what avoids another person, and all of what avoids a robot.
    share = jnp.where(is_robot, 1.0, 0.5)
    along_normal = nx * vx + ny * vy
    c = along_normal + share * out
    c = jnp.where(avoided, c, UNBOUNDED)
    return Planes(nx, ny, c)


def _others(people: Pedestrians, n_robots: int) -> tuple[Int[Array, "K N"], Bool[Array, "K 1"]]:
    """The nearest people of each person and then all robots, which follow the people; and which are robots."""
    n_people = len(people.present)
    nearest = _neighbors(people)
    robot = n_people + jnp.arange(n_robots, dtype=jnp.int32)[:, None]
    robots = jnp.broadcast_to(robot, (n_robots, n_people))
    others = jnp.concatenate([nearest, robots])
    is_robot = jnp.arange(len(others), dtype=jnp.int32)[:, None] >= len(nearest)
    return others, is_robot


def _planes_of_walls(scenario: Scenario, px: Float[Array, "N"], py: Float[Array, "N"]) -> Planes:
    """The half-planes that the nearest obstacles allow people at (px, py) [m]: no collision in ``WALL_HORIZON``."""
    obstacles = distances(px, py, scenario.environment.obstacle_grid)
    gap, nx, ny = (rows.T for rows in obstacles)  # (W, N)
    nearest = smallest(jnp.maximum(gap, 0.0), WALLS)
    gap, nx, ny = (jnp.take_along_axis(rows, nearest, 0) for rows in (gap, nx, ny))

    radius = scenario.forces.walking.radius
    room = jnp.maximum(gap - radius, 0.0)
    return Planes(nx, ny, c=-room / WALL_HORIZON)


def _neighbors(people: Pedestrians) -> Int[Array, "K N"]:
    """The nearest others of each person."""
    position = jax.lax.stop_gradient(people.position)
    x, y = position.T
    dx = x[:, None] - x[None]  # (N, N)
    dy = y[:, None] - y[None]
    square = dx * dx + dy * dy

    present = people.present[:, None]
    itself = jnp.eye(len(x), dtype=bool)
    other = present & ~itself
    square = jnp.where(other, square, jnp.inf)
    return smallest(square, NEIGHBORS)


def smallest(values: Float[Array, "J N"], count: int) -> Int[Array, "K N"]:
    """The indices of the smallest values of each column, ascending; no value is negative.

    On a CPU, values that differ by less than J / 2^23 of themselves may change places.
    """
    values = jax.lax.stop_gradient(values)
    if len(values) <= count:
        index = jnp.arange(len(values), dtype=jnp.int32)
        return jnp.broadcast_to(index[:, None], values.shape)

    by_key = partial(_smallest_by_key, count)
    by_sort = partial(_smallest_by_sort, count)
    return jax.lax.platform_dependent(values, cpu=by_key, default=by_sort)


def _smallest_by_sort(count: int, values: Array) -> Array:
    _, index = jax.lax.top_k(-values.T, count)
    return index.astype(jnp.int32).T


def _smallest_by_key(count: int, values: Array) -> Array:
    """The minima of whole numbers in the order of the values, with the index of each value in their last bits."""
    n_values = len(values)
    dtype = jnp.dtype(f"uint{8 * values.dtype.itemsize}")
    bits = (n_values - 1).bit_length()  # of an index
    mask = np.array((1 << bits) - 1, dtype)
    index = jnp.arange(n_values, dtype=dtype)[:, None]
    whole_numbers = jax.lax.bitcast_convert_type(values, dtype)
    keys = whole_numbers & ~mask | index

    # In eight parts, whose minimum uses vector instructions.
    rows = -(-n_values // 8)
    shape = 8 * rows, values.shape[1]
    largest = np.iinfo(dtype).max
    padded = jnp.full(shape, largest, dtype)
    padded = padded.at[:n_values].set(keys)

    def next_smallest(lower: Array, _: None) -> tuple[Array, Array]:
        # Of the keys from ``lower`` on, the smallest is next: smaller keys wrap around to large differences.
        difference = padded - lower[None]
        parts = difference.reshape(8, rows, -1)
        smallest_of_parts = reduce(jnp.minimum, [parts[k] for k in range(8)])
        key = lower + smallest_of_parts.min(0)
        return key + np.array(1, dtype), key

    zeros = jnp.zeros(values.shape[1], dtype)
    _, smallest_keys = jax.lax.scan(next_smallest, zeros, length=count)
    return (smallest_keys & mask).astype(jnp.int32)


def _avoids(people: Pedestrians, others: Int[Array, "K N"]) -> Bool[Array, "K N"]:
    """Whether an other is present, somebody else and not in the same standing group; the number N is nobody."""
    # Groups and presence are in one array, so that one gather is enough.
    n_people = len(people.present)
    alone, absent, nobody = -1, -2, -3
    group = jnp.maximum(people.group, alone)
    group = jnp.where(people.present, group, absent)
    group = jnp.append(group, jnp.full(1, nobody, jnp.int32))
    index = jnp.minimum(others, n_people)
    other_group = group[index]  # (K, N)
    present = other_group >= alone

    own_group = people.group[None]
    itself = others == jnp.arange(n_people, dtype=jnp.int32)[None]
    apart = (own_group < 0) | (other_group != own_group)
    return present & ~itself & apart
