"""Optimal reciprocal collision avoidance (ORCA) among people (section IV-D, low level).

J. van den Berg, S. J. Guy, M. Lin & D. Manocha, "Reciprocal n-body collision avoidance", Robotics Research (2011).
``orca_solver`` has the half-planes and the best velocity in them.
"""

from functools import partial, reduce

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
    walking = scenario.forces.walking
    px, py, vx, vy = jnp.concatenate([people.position, people.velocity], 1).T[:, None]  # (1, N)
    nx, ny, c = _planes_of_others(scenario, state, px, py, vx, vy)  # (K, N)
    wall_x, wall_y, wall_c = _planes_of_walls(scenario, px[0], py[0])  # (L, N)

    # Written over any numbers that are no constant: concatenated or written over zeros, XLA on a CPU would compute the
    # half-planes row by row, with a condition for each number.
    empty = jnp.broadcast_to(px, (len(c) + len(wall_c), px.shape[1]))
    pairs = (nx, wall_x), (ny, wall_y), (c, wall_c)
    normal_x, normal_y, bound = (empty.at[: len(c)].set(a).at[len(c) :].set(b) for a, b in pairs)
    hard = jnp.arange(bound.shape[0], dtype=jnp.int32) >= len(c)

    limit = jnp.maximum(walking.speed_ratio * people.preferred_speed, 0.0)
    desired_x, desired_y = people.desired_velocity.T
    x, y = best_velocity(VelocityProgram(normal_x, normal_y, bound, hard, desired_x, desired_y, limit))
    return walk(scenario, people, jnp.stack([x, y], -1))


Planes = tuple[Float[Array, "K N"], Float[Array, "K N"], Float[Array, "K N"]]  # nx, ny, c [m/s]


def _planes_of_others(scenario: Scenario, state: State, px: Array, py: Array, vx: Array, vy: Array) -> Planes:
    """The half-planes that the nearest people and the robots allow people of position and velocity (1, N)."""
    people = state.pedestrians
    robot = state.robot
    n_robots = robot.speed.size  # 1, or of a team
    others, is_robot = _others(people, n_robots)  # (K, N), (K, 1)

    velocity = ground_velocity(robot)
    ox = jnp.append(px, robot.position[..., 0])[others]
    oy = jnp.append(py, robot.position[..., 1])[others]
    ovx = jnp.append(vx, velocity[..., 0])[others]
    ovy = jnp.append(vy, velocity[..., 1])[others]
    dx, dy = ox - px, oy - py
    is_near = dx * dx + dy * dy < RANGE * RANGE
    avoided = is_robot | (_avoids(people, others) & is_near)

    radius = scenario.forces.walking.radius
    other_radius = jnp.append(jnp.full(len(others) - n_robots, radius), scenario.robot.radius)
    radii = radius + other_radius[:, None] + SPACE
    person = jnp.arange(px.shape[1], dtype=jnp.int32)[None]
    first = person < others  # breaks the tie of two people at one place
    nx, ny, out = half_plane(dx, dy, vx - ovx, vy - ovy, radii, HORIZON, scenario.time_step, first)

    # People do half of what avoids another person, and all of what avoids a robot.
    share = jnp.where(is_robot, 1.0, 0.5)
    c = nx * vx + ny * vy + share * out
    return nx, ny, jnp.where(avoided, c, UNBOUNDED)


def _others(people: Pedestrians, n_robots: int) -> tuple[Int[Array, "K N"], Bool[Array, "K 1"]]:
    """The nearest people of each person and then all robots, which follow the people; and which are robots."""
    n_people = people.present.shape[0]
    nearest = _neighbors(people)
    robots = n_people + jnp.arange(n_robots, dtype=jnp.int32)[:, None]
    others = jnp.concatenate([nearest, jnp.broadcast_to(robots, (n_robots, n_people))])
    return others, jnp.arange(len(others), dtype=jnp.int32)[:, None] >= len(nearest)


def _planes_of_walls(scenario: Scenario, px: Array, py: Array) -> Planes:
    """The half-planes that the nearest obstacles allow people at (N,) [m]: none is reached within ``WALL_HORIZON``."""
    gap, nx, ny = (rows.T for rows in distances(px, py, scenario.environment.obstacle_grid))
    near = smallest(jnp.maximum(gap, 0.0), WALLS)
    gap, nx, ny = (jnp.take_along_axis(rows, near, 0) for rows in (gap, nx, ny))
    room = jnp.maximum(gap - scenario.forces.walking.radius, 0.0)
    return nx, ny, -room / WALL_HORIZON


def _neighbors(people: Pedestrians) -> Int[Array, "K N"]:
    """The nearest others of each person."""
    x, y = jax.lax.stop_gradient(people.position).T
    dx = x[:, None] - x[None]
    dy = y[:, None] - y[None]
    itself = jnp.eye(x.shape[0], dtype=bool)
    other = people.present[:, None] & ~itself
    square = jnp.where(other, dx * dx + dy * dy, jnp.inf)
    return smallest(square, NEIGHBORS)


def smallest(values: Float[Array, "J N"], count: int) -> Int[Array, "K N"]:
    """The indices of the smallest values of each column, ascending; no value is negative.

    On a CPU, values that differ by less than J / 2^23 of themselves may change places.
    """
    values = jax.lax.stop_gradient(values)
    if len(values) <= count:
        return jnp.broadcast_to(jnp.arange(len(values), dtype=jnp.int32)[:, None], values.shape)
    by_key = partial(_smallest_by_key, count)
    by_sort = partial(_smallest_by_sort, count)
    return jax.lax.platform_dependent(values, cpu=by_key, default=by_sort)


def _smallest_by_sort(count: int, values: Array) -> Array:
    return jax.lax.top_k(-values.T, count)[1].astype(jnp.int32).T


def _smallest_by_key(count: int, values: Array) -> Array:
    """The minima of whole numbers in the order of the values, with the index of each value in their last bits."""
    dtype = jnp.dtype(f"uint{8 * values.dtype.itemsize}")
    bits = (len(values) - 1).bit_length()  # of an index
    mask = np.array((1 << bits) - 1, dtype)
    index = jnp.arange(len(values), dtype=dtype)[:, None]
    keys = jax.lax.bitcast_convert_type(values, dtype) & ~mask | index

    # In eight parts, whose minimum uses vector instructions.
    rows = -(-len(values) // 8)
    padded = jnp.full((8 * rows, values.shape[1]), np.iinfo(dtype).max, dtype)
    padded = padded.at[: len(values)].set(keys)

    def next_smallest(lower: Array, _: None) -> tuple[Array, Array]:
        # Of the keys from ``lower`` on, the smallest is next: smaller keys wrap around to large differences.
        parts = (padded - lower[None]).reshape(8, rows, -1)
        key = lower + reduce(jnp.minimum, [parts[k] for k in range(8)]).min(0)
        return key + np.array(1, dtype), key

    _, smallest_keys = jax.lax.scan(next_smallest, jnp.zeros(values.shape[1], dtype), length=count)
    return (smallest_keys & mask).astype(jnp.int32)


def _avoids(people: Pedestrians, others: Int[Array, "K N"]) -> Bool[Array, "K N"]:
    """Whether an other is present, somebody else and not in the same standing group; the number N is nobody."""
    n_people = people.present.shape[0]
    alone, absent, nobody = -1, -2, -3  # one gather
    group = jnp.where(people.present, jnp.maximum(people.group, alone), absent)
    group = jnp.append(group, jnp.full(1, nobody, jnp.int32))
    other_group = group[jnp.minimum(others, n_people)]
    own_group = people.group[None]
    itself = others == jnp.arange(n_people, dtype=jnp.int32)[None]
    return (other_group >= alone) & ~itself & ((own_group < 0) | (other_group != own_group))
