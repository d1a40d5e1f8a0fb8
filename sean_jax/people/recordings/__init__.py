"""Recorded people: motion from noisy positions, and snapshots that classifiers can read (section III).

A recording (``reading``) serves as evidence for the situations of section III, which speak of positions, orientations
and velocities "provided in simulation or estimated in the real world". A straight line is fitted to each stretch of a
track. SEAN 2.0 does the same for its classifiers, by ordinary least squares over a pedestrian's last poses. Here the
stretch lies around the time, so that nothing lags. In a snapshot one of the people, or a given path, plays the robot
among the others. Snapshots have a leading axis T: ``jax.vmap(holds, in_axes=(0, None))(snapshots, thresholds)``
classifies them all.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from sean_jax.core.data_types import Array, Obstacles, Pedestrians, Snapshot
from sean_jax.core.geometry import length
from sean_jax.people.recordings.reading import FORMATS, Tracks, check_clock, read, read_companions

__all__ = ["FORMATS", "Tracks", "check_clock", "read", "read_companions"]
__all__ += ["fit_motion", "headings", "motion_between_rows", "snapshots_along", "snapshots_of"]

BODY = 0.2  # m, radius of a person
STILL = 0.1  # m/s, at or below which the direction of motion is unknown
GOAL_GROUP, START_GROUP = 0, 1  # names of the groups that the robot's goal and start belong to


def fit_motion(
    position: Float[Array, "T N 2"], present: Bool[Array, "T N"], time_step: float, window: int = 2
) -> tuple[Float[Array, "T N 2"], Float[Array, "T N 2"]]:
    """Least-squares line through each person's positions at the 2 window + 1 times around each.

    Times at which the person is absent are left out. With a single time, the position stays and the velocity is zero.

    Args:
        position: (T, N, 2) m.
        time_step: s between rows.

    Returns:
        Position [m] on the line, and velocity [m/s]; where absent, the argument's and zero.
    Source: SEAN 2.0's classifiers, which fit a line to a person's last poses.
    """
    # Sums over the times of 1, t and t^2, of the offsets x, and of t x.
    zero = jnp.zeros((), position.dtype)
    count, first, second, value, product = zero, zero, zero, zero, zero
    for shift in range(-window, window + 1):
        weight = _shifted(present, shift, False).astype(position.dtype)
        offset = (_shifted(position, shift, 0.0) - position) * weight[..., None]
        count = count + weight
        first = first + weight * shift
        second = second + weight * shift**2
        value = value + offset
        product = product + offset * shift

    determinant = count * second - first * first
    usable = present & (determinant > 0.5)  # it is a whole number
    divisor = jnp.where(usable, determinant, 1.0)
    inverse = jnp.where(usable, 1.0 / divisor, 0.0)

    # The sums of times are scalars, those of offsets are vectors.
    count, first, second, inverse = (values[..., None] for values in (count, first, second, inverse))
    slope = (count * product - first * value) * inverse
    middle = (second * value - first * product) * inverse
    return position + middle, slope / time_step


def headings(velocity: Float[Array, "T N 2"], present: Bool[Array, "T N"]) -> Float[Array, "T N 2"]:
    """The direction of motion (velocities in m/s); of a standing person the last one before, or else the next one.

    People who never move faster than ``STILL`` look along x.
    """
    square = (velocity * velocity).sum(-1)
    speed = jnp.sqrt(jnp.maximum(square, 1e-12))
    moving = present & (speed > STILL)
    direction = jnp.where(moving[..., None], velocity / speed[..., None], 0.0)

    def carry_on(last, row):
        moving, direction = row
        last = jnp.where(moving[:, None], direction, last)
        return last, last

    unknown = jnp.zeros_like(direction[0])
    _, forward = jax.lax.scan(carry_on, unknown, (moving, direction))
    _, backward = jax.lax.scan(carry_on, unknown, (moving, direction), reverse=True)
    direction = jnp.where(_is_known(forward), forward, backward)
    ever_moves = _is_known(direction)
    along_x = jnp.zeros_like(direction).at[..., 0].set(1.0)
    return jnp.where(ever_moves, direction, along_x)


def _is_known(direction: Float[Array, "T N 2"]) -> Bool[Array, "T N 1"]:
    """Whether a direction is a unit vector, not zero."""
    return (direction * direction).sum(-1, keepdims=True) > 0.5


def motion_between_rows(tracks: Tracks) -> tuple[np.ndarray, np.ndarray]:
    """Velocity (T, N, 2) [m/s] from the row before, and heading (T, N, 2): the last direction of walking.

    Runs on the host, in the precision of the positions. In a column, a row without anybody separates each person from
    the next, as in a sampled recording. An absent person has zero velocity and the heading of the next person; the
    velocity in a person's first row equals the second row's.
    """
    position = np.asarray(tracks.position)
    present = np.asarray(tracks.present)
    velocity = np.zeros_like(position)
    heading = np.zeros_like(position)
    absent = np.zeros((1, present.shape[1]), bool)
    padded = np.concatenate([absent, present, absent])
    change = np.diff(padded.astype(np.int8), axis=0)  # 1 where somebody comes, -1 where somebody leaves
    for n, column in enumerate(change.T):
        before = 0
        begins = np.flatnonzero(column > 0)
        ends = np.flatnonzero(column < 0)
        for begin, end in zip(begins, ends, strict=True):
            steps = np.diff(position[begin:end, n], axis=0) / tracks.time_step
            if len(steps):
                velocity[begin:end, n] = np.concatenate([steps[:1], steps])
            heading[before:end, n] = _last_directions(velocity[before:end, n])
            before = end
        heading[before:, n] = heading[before - 1, n] if before else (1.0, 0.0)
    return velocity, heading


def _last_directions(velocity: np.ndarray) -> np.ndarray:
    """(T, 2) direction of the last velocity that was fast enough, or of the first one, or along x."""
    speed = np.linalg.norm(velocity, axis=-1)
    fast = np.flatnonzero(speed > STILL)
    if not len(fast):
        return np.tile([1.0, 0.0], (len(velocity), 1))
    rows = np.arange(len(velocity))
    latest = np.searchsorted(fast, rows, side="right") - 1
    index = fast[np.maximum(latest, 0)]
    return velocity[index] / speed[index, None]


def _shifted(rows: Shaped[Array, "T ..."], shift: int, fill: float | bool) -> Shaped[Array, "T ..."]:
    """The rows ``shift`` later, ``fill`` beyond the ends."""
    if shift == 0:
        return rows
    n_filling = min(abs(shift), len(rows))
    filling = jnp.full((n_filling, *rows.shape[1:]), fill, rows.dtype)
    if shift > 0:
        return jnp.concatenate([rows[shift:], filling])
    return jnp.concatenate([filling, rows[:shift]])


def snapshots_of(
    tracks: Tracks, robot: Int[Array, ""] | int, group: Int[Array, "T N"] | None = None
) -> tuple[Snapshot, Bool[Array, "T"]]:
    """Snapshots (T, ...) with a recorded person as the robot, from the first recorded position to the last.

    Args:
        robot: () int32 column of that person; may be traced.
        group: (T, N) int32 group of each person, -1 none; the recording's if None. Without annotation,
            ``classifiers.o_space_groups`` of each row gives them.

    Returns:
        Snapshots, and (T,) whether the robot was recorded; other snapshots are meaningless.
    """
    index = jnp.asarray(robot, jnp.int32)
    everybody = jnp.arange(tracks.present.shape[1], dtype=jnp.int32)
    people = _people(tracks)
    group = tracks.group if group is None else group
    recorded = tracks.present[:, index]
    is_other = everybody != index
    others = replace(people, present=people.present & is_other[None, :])
    motion = people.position[:, index], people.velocity[:, index], people.heading[:, index]
    snapshots = _snapshots(tracks, others, group, group[:, index], *motion, recorded, None)
    return snapshots, recorded


def snapshots_along(
    tracks: Tracks, path: Float[Array, "T 2"], *, obstacles: Obstacles | None = None, window: int = 2
) -> Snapshot:
    """Snapshots (T, ...) of a robot on a path (T, 2) [m] among recorded people, who ignore it. It is in no group.

    Args:
        obstacles: W boxes, if known.
        window: as of ``fit_motion``.
    """
    present = jnp.ones((path.shape[0], 1), bool)
    _, velocity = fit_motion(path[:, None, :], present, tracks.time_step, window)
    heading = headings(velocity, present)[:, 0]
    nobody = jnp.full(path.shape[:1], -1, jnp.int32)
    motion = path, velocity[:, 0], heading
    people = _people(tracks, window)
    return _snapshots(tracks, people, tracks.group, nobody, *motion, present[:, 0], obstacles)


def _people(tracks: Tracks, window: int = 2) -> Pedestrians:
    """The recorded people, fields (T, N, ...)."""
    position, velocity = fit_motion(tracks.position, tracks.present, tracks.time_step, window)
    speed = length(velocity[..., 0], velocity[..., 1])
    count = jnp.maximum(tracks.present.sum(0, dtype=jnp.int32), 1)
    total_speed = jnp.where(tracks.present, speed, 0.0).sum(0)
    mean_speed = total_speed / count.astype(speed.dtype)
    nobody = jnp.full(tracks.present.shape, -1, jnp.int32)
    return Pedestrians(
        position=position,
        velocity=velocity,
        heading=headings(velocity, tracks.present),
        desired_velocity=velocity,
        group=nobody,
        walking_group=nobody,
        present=tracks.present,
        preferred_speed=jnp.broadcast_to(mean_speed[None, :], tracks.present.shape),
        robot_distance=jnp.zeros_like(speed),
    )


def _snapshots(
    tracks: Tracks,
    people: Pedestrians,
    group: Int[Array, "T N"],
    robot_group: Int[Array, "T"],
    position: Float[Array, "T 2"],
    velocity: Float[Array, "T 2"],
    heading: Float[Array, "T 2"],
    recorded: Bool[Array, "T"],
    obstacles: Obstacles | None,
) -> Snapshot:
    """Snapshots of a robot. ``group`` (T, N) and ``robot_group`` (T,) name groups per row, except start and goal.

    People with whom the robot stood at its goal are ``GOAL_GROUP``, those at its start alone ``START_GROUP``, in every
    row in which they stand with anybody; one person cannot be both.
    """
    # A robot may be there in some rows only: argmax of booleans is the first that is true, backwards the last.
    times = recorded.shape[0]
    first = jnp.argmax(recorded)
    last = times - 1 - jnp.argmax(recorded[::-1])
    group_at_start = robot_group[first]
    group_at_goal = robot_group[last]

    # Numbers of groups may change from row to row, so the people of the first and last group carry the name.
    starts_in_group = group_at_start >= 0
    ends_in_group = group_at_goal >= 0
    with_start = starts_in_group & (group[first] == group_at_start)  # (N,)
    with_goal = ends_in_group & (group[last] == group_at_goal)
    name = jnp.where(with_start, START_GROUP, -1)
    name = jnp.where(with_goal, GOAL_GROUP, name).astype(jnp.int32)
    named_group = jnp.where(group >= 0, name[None, :], -1)  # (T, N)

    # Start and goal with the same people are one group: the robot neither leaves it nor joins it.
    unchanged = starts_in_group & ends_in_group & (with_start == with_goal).all()
    name_of_start = jnp.where(unchanged, GOAL_GROUP, START_GROUP)
    start_group = jnp.where(starts_in_group, name_of_start, -1)
    goal_group = jnp.where(ends_in_group, GOAL_GROUP, -1)

    # A recording has no task and often no map: start and goal are the ends, and the way between is straight.
    start = position[first]
    goal = position[last]
    straight = length(goal[0] - start[0], goal[1] - start[1])

    def always(value: Array) -> Array:
        return jnp.broadcast_to(value[None], (times, *value.shape))

    # The robot is a person here, or as wide as one.
    return Snapshot(
        people=replace(people, group=named_group),
        position=position,
        heading=heading,
        velocity=velocity,
        start=always(start),
        goal=always(goal),
        start_group=always(start_group.astype(jnp.int32)),
        goal_group=always(goal_group.astype(jnp.int32)),
        geodesic=always(straight),
        situations=jnp.zeros((times, 0), bool),
        tick=jnp.arange(times, dtype=jnp.int32),
        robot_radius=jnp.full(times, BODY, float),
        person_radius=jnp.full(times, BODY, float),
        time_step=tracks.time_step,
        obstacles=jax.tree.map(always, obstacles),
    )
