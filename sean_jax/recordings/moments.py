"""Moments from a recording (section III): one of its people, or a given path, plays the robot among the others.

A moment here has a leading axis T: ``jax.vmap(holds, in_axes=(0, None))(moments, thresholds)`` classifies them all.
"""

from dataclasses import replace

import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from sean_jax.base import Array, Moment, Obstacles, Pedestrians
from sean_jax.geometry import length
from sean_jax.recordings.motion import fit_motion, headings
from sean_jax.recordings.tracks import Tracks

BODY = 0.2  # m, radius of a person
GOAL_GROUP, START_GROUP = 0, 1  # names of the groups that the robot's goal and start belong to


def moments_of(
    tracks: Tracks,
    robot: Int[Array, ""] | int,
    *,
    group: Int[Array, "T N"] | None = None,
    facing: Float[Array, "T N 2"] | None = None,
    obstacles: Obstacles | None = None,
    window: int = 2,
    still: float = 0.1,
) -> tuple[Moment, Bool[Array, "T"]]:
    """Moments in which a recorded person is the robot, from where they are first seen to where last.

    Args:
        robot: () int32 column of that person; may be traced.
        group: (T, N) int32 group of each person, -1 none; those of the recording if None. Where nobody
            annotated them, ``classifiers.o_space_groups`` of each row gives them.
        facing: (T, N, 2) unit headings; directions of motion if None.
        obstacles: W boxes, if known.
        still: m/s, below which the direction of motion says nothing.

    Returns:
        Moments (T, ...), and (T,) whether the robot was recorded. Elsewhere the moment says nothing.
    """
    index = jnp.asarray(robot, jnp.int32)
    everybody = jnp.arange(tracks.present.shape[1], dtype=jnp.int32)
    people, group = _people(tracks, group, facing, window, still)
    recorded = tracks.present[:, index]
    others = replace(people, present=people.present & (everybody != index)[None, :])
    own = group[:, index]
    return _moments(
        tracks, others, group, own, people.position[:, index], people.velocity[:, index], people.heading[:, index],
        recorded, obstacles,
    ), recorded  # fmt: skip


def moments_along(
    tracks: Tracks,
    path: Float[Array, "T 2"],
    *,
    group: Int[Array, "T N"] | None = None,
    facing: Float[Array, "T N 2"] | None = None,
    obstacles: Obstacles | None = None,
    window: int = 2,
    still: float = 0.1,
) -> Moment:
    """Moments in which a robot goes along a path among recorded people, who do not react to it. It is in no group.

    Args:
        path: (T, 2) m, of the robot.
        group: (T, N) group of each person, -1 none; those of the recording if None.
        facing: (T, N, 2) unit headings; directions of motion if None.
        obstacles: W boxes, if known.
        still: m/s, below which the direction of motion says nothing.

    Returns:
        Moments (T, ...).
    """
    people, group = _people(tracks, group, facing, window, still)
    there = jnp.ones((path.shape[0], 1), bool)
    _, velocity = fit_motion(path[:, None, :], there, tracks.time_step, window)
    heading = headings(velocity, there, still)[:, 0]
    nobody = jnp.full(path.shape[:1], -1, jnp.int32)
    return _moments(tracks, people, group, nobody, path, velocity[:, 0], heading, there[:, 0], obstacles)


def _people(
    tracks: Tracks,
    group: Int[Array, "T N"] | None,
    facing: Float[Array, "T N 2"] | None,
    window: int,
    still: float,
) -> tuple[Pedestrians, Int[Array, "T N"]]:
    """The recorded people, fields (T, N, ...), and their groups as the file or the caller has them."""
    position, velocity = fit_motion(tracks.position, tracks.present, tracks.time_step, window)
    speed, count = length(velocity[..., 0], velocity[..., 1]), jnp.maximum(tracks.present.sum(0, dtype=jnp.int32), 1)
    usual = jnp.where(tracks.present, speed, 0.0).sum(0) / count.astype(speed.dtype)
    people = Pedestrians(
        position=position,
        velocity=velocity,
        heading=headings(velocity, tracks.present, still) if facing is None else facing,
        desired_velocity=velocity,
        group=jnp.full(tracks.present.shape, -1, jnp.int32),
        walking_group=jnp.full(tracks.present.shape, -1, jnp.int32),
        present=tracks.present,
        preferred_speed=jnp.broadcast_to(usual[None, :], tracks.present.shape),
        robot_distance=jnp.zeros_like(speed),
    )
    return people, tracks.group if group is None else group


def _moments(
    tracks: Tracks,
    people: Pedestrians,
    group: Int[Array, "T N"],
    own: Int[Array, "T"],
    position: Float[Array, "T 2"],
    velocity: Float[Array, "T 2"],
    heading: Float[Array, "T 2"],
    recorded: Bool[Array, "T"],
    obstacles: Obstacles | None,
) -> Moment:
    """``group`` (T, N) and ``own`` (T,) name groups anew in each row, but the robot's start and goal stay.

    So whom it stood with at its goal are ``GOAL_GROUP`` and whom at its start alone ``START_GROUP``, in every row in
    which they stand with anybody; one person cannot be both.
    """
    times = recorded.shape[0]
    first = jnp.argmax(recorded)
    last = times - 1 - jnp.argmax(recorded[::-1])
    with_start = (own[first] >= 0) & (group[first] == own[first])
    with_goal = (own[last] >= 0) & (group[last] == own[last])
    joined = jnp.where(with_goal, GOAL_GROUP, jnp.where(with_start, START_GROUP, -1)).astype(jnp.int32)
    named = jnp.where(group >= 0, joined[None, :], -1)
    unchanged = (own[first] >= 0) & (own[last] >= 0) & (with_start == with_goal).all()
    start_group = jnp.where(own[first] >= 0, jnp.where(unchanged, GOAL_GROUP, START_GROUP), -1)
    goal_group = jnp.where(own[last] >= 0, GOAL_GROUP, -1)
    start, goal = position[first], position[last]
    straight = length(goal[0] - start[0], goal[1] - start[1])

    def always(value: Array) -> Array:
        return jnp.broadcast_to(value[None], (times, *value.shape))

    boxes = None
    if obstacles is not None:
        fields = (obstacles.center, obstacles.half_extent, obstacles.yaw, obstacles.height)
        boxes = Obstacles(*(always(field) for field in fields))
    return Moment(
        people=replace(people, group=named),
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
        obstacles=boxes,
    )
