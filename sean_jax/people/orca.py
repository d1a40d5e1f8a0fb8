"""Optimal reciprocal collision avoidance (ORCA) among people (section IV-D, low level).

J. van den Berg, S. J. Guy, M. Lin & D. Manocha, "Reciprocal n-body collision avoidance", Robotics Research (2011).
``orca_solver`` has the half-planes and the best velocity in them.
"""

from functools import reduce

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
    people, walking, robot = state.pedestrians, scenario.forces.walking, state.robot
    robots = robot.speed.size  # 1, or of a team
    px, py, vx, vy = jnp.concatenate([people.position, people.velocity], 1).T[:, None]  # (1, N)
    number = px.shape[1]
    others = _neighbors(people)
    # The robots are the last of the bodies and, for everybody, the last of the others.
    is_robot = jnp.arange(len(others) + robots, dtype=jnp.int32)[:, None] >= len(others)
    last = number + jnp.arange(robots, dtype=jnp.int32)[:, None]
    others = jnp.concatenate([others, jnp.broadcast_to(last, (robots, number))])
    over_ground = ground_velocity(robot)
    bodies = (
        (px, robot.position[..., 0]),
        (py, robot.position[..., 1]),
        (vx, over_ground[..., 0]),
        (vy, over_ground[..., 1]),
    )
    ox, oy, ovx, ovy = (jnp.append(part, of_robot)[others] for part, of_robot in bodies)
    dx, dy = ox - px, oy - py
    avoided = is_robot | (_avoids(people, others) & (dx * dx + dy * dy < RANGE * RANGE))
    radius = jnp.append(jnp.full(len(others) - robots, walking.radius), scenario.robot.radius)[:, None]
    radii = walking.radius + radius + SPACE
    first = jnp.arange(number, dtype=jnp.int32)[None] < others  # breaks the tie of two people at one place
    nx, ny, out = half_plane(dx, dy, vx - ovx, vy - ovy, radii, HORIZON, scenario.time_step, first)
    c = nx * vx + ny * vy + jnp.where(is_robot, 1.0, 0.5) * out

    gap, wx, wy = (part.T for part in distances(px[0], py[0], scenario.environment.obstacle_grid))
    near = smallest(jnp.maximum(gap, 0.0), WALLS)
    gap, wx, wy = (jnp.take_along_axis(part, near, 0) for part in (gap, wx, wy))
    wall = -jnp.maximum(gap - walking.radius, 0.0) / WALL_HORIZON

    # Written over any numbers that are no constant: concatenated or written over zeros, XLA on a CPU would compute the
    # half-planes row by row, with a condition for each number.
    empty = jnp.broadcast_to(px, (len(others) + len(near), number))
    pairs = (nx, wx), (ny, wy), (jnp.where(avoided, c, UNBOUNDED), wall)
    normal_x, normal_y, bound = (empty.at[: len(others)].set(a).at[len(others) :].set(b) for a, b in pairs)
    hard = jnp.arange(bound.shape[0], dtype=jnp.int32) >= len(others)
    limit = jnp.maximum(walking.speed_ratio * people.preferred_speed, 0.0)
    desired_x, desired_y = people.desired_velocity.T
    x, y = best_velocity(VelocityProgram(normal_x, normal_y, bound, hard, desired_x, desired_y, limit))
    return walk(scenario, people, jnp.stack([x, y], -1))


def _neighbors(people: Pedestrians) -> Int[Array, "K N"]:
    """The nearest others of each person."""
    x, y = jax.lax.stop_gradient(people.position).T
    dx, dy = x[:, None] - x[None], y[:, None] - y[None]
    other = people.present[:, None] & ~jnp.eye(x.shape[0], dtype=bool)
    return smallest(jnp.where(other, dx * dx + dy * dy, jnp.inf), NEIGHBORS)


def smallest(values: Float[Array, "J N"], count: int) -> Int[Array, "K N"]:
    """The numbers of the smallest values of each column, ascending; no value is negative.

    On a CPU, values that differ by less than J / 2^23 of themselves may change places.
    """
    values = jax.lax.stop_gradient(values)
    if len(values) <= count:
        return jnp.broadcast_to(jnp.arange(len(values), dtype=jnp.int32)[:, None], values.shape)

    def by_key(values: Array) -> Array:
        # Whole numbers in the order of the values, with the number of each value in their last bits. Of the numbers
        # from ``next`` on, the smallest is next: others wrap around to large ones.
        whole = jnp.dtype(f"uint{8 * values.dtype.itemsize}")
        last = np.array((1 << (len(values) - 1).bit_length()) - 1, whole)
        keys = jax.lax.bitcast_convert_type(values, whole) & ~last | jnp.arange(len(values), dtype=whole)[:, None]
        rows = -(-len(values) // 8)
        filled = jnp.full((8 * rows, values.shape[1]), np.iinfo(whole).max, whole).at[: len(values)].set(keys)

        def turn(after: Array, _: None) -> tuple[Array, Array]:
            parts = (filled - after[None]).reshape(8, rows, -1)
            found = after + reduce(jnp.minimum, [parts[part] for part in range(8)]).min(0)
            return found + np.array(1, whole), found

        found = jax.lax.scan(turn, jnp.zeros(values.shape[1], whole), length=count)[1]
        return (found & last).astype(jnp.int32)

    def by_sort(values: Array) -> Array:
        return jax.lax.top_k(-values.T, count)[1].astype(jnp.int32).T

    return jax.lax.platform_dependent(values, cpu=by_key, default=by_sort)


def _avoids(people: Pedestrians, others: Int[Array, "K N"]) -> Bool[Array, "K N"]:
    """Whether an other is present, somebody else and not in the same standing group; the number N is nobody."""
    number = people.present.shape[0]
    alone, absent, nobody = -1, -2, -3  # one gather
    group = jnp.where(people.present, jnp.maximum(people.group, alone), absent)
    theirs = jnp.append(group, jnp.full(1, nobody, jnp.int32))[jnp.minimum(others, number)]
    own = people.group[None]
    itself = others == jnp.arange(number, dtype=jnp.int32)[None]
    return (theirs >= alone) & ~itself & ((own < 0) | (theirs != own))
