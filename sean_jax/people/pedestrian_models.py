"""Pedestrian models (section IV-D, low level): how people move to the goals of their behavior.

Beside the social forces: constant velocity, and optimal reciprocal collision avoidance (ORCA) of J. van den Berg, S. J.
Guy, M. Lin & D. Manocha, "Reciprocal n-body collision avoidance", Robotics Research (2011).
"""

from dataclasses import replace
from functools import reduce

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from sean_jax import social_forces
from sean_jax.core.data_types import Array, Pedestrians, Scenario, State
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import ground_velocity, length, unit
from sean_jax.people.orca_solver import UNBOUNDED, VelocityProgram, best_velocity, half_plane
from sean_jax.social_forces.forces import turn
from sean_jax.social_forces.walls import distances, project_velocity

HORIZON = 3.0  # s, without a collision with people and the robot; ours
WALL_HORIZON = 0.5  # s, likewise with obstacles; ours
NEIGHBORS = 8  # the nearest people that are avoided; ours
WALLS = 4  # the nearest obstacles that are avoided; ours
RANGE = 10.0  # m, nobody farther away is avoided
SPACE = 0.1  # m, kept between two bodies; ours
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
