"""Playback (section IV-D): recorded people walk as they did, and the robot moves among them.

They follow nobody's model: forces do not move them and they do not see the robot. They enter and leave as in the
recording, of which an episode is a part that begins at a random moment.
"""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp

from sean_jax import clock
from sean_jax import navigation as paths
from sean_jax.base import Array, Behavior, Environment, Groups, Pedestrians, Scenario, State
from sean_jax.behaviors.random_behavior import no_groups
from sean_jax.behaviors.tracks import Tracks, read
from sean_jax.recordings.lines import check_clock
from sean_jax.social_forces import draw_traits


class Memory(NamedTuple):
    first: Array  # () int32 moment of the recording at which the episode begins


def build(
    folder: Path,
    environment: Environment,
    navigation: paths.Navigation,
    people: int,
    recording: str | Path | None = None,
    frame_rate: float | None = None,
    time_step: float = 0.1,
    kind: str | None = None,
) -> Behavior:
    """Recorded people walk as they did.

    The recording is a CSV file with the columns frame, id, x and y [m], and ``kind`` its format, a key of
    ``recordings.READERS``, whose clock counts without a ``frame_rate`` [1/s]. ``people`` is not read: there are as many
    as are recorded at once.

    Raises:
        ValueError: there is no recording, or it cannot be used.
    """
    if recording is None:
        raise ValueError("behavior: 'playback' needs a recording; give the path of a CSV file: frame, id, x, y.")
    check_clock(kind, frame_rate)
    tracks = jax.tree.map(jnp.asarray, read(recording, frame_rate, time_step, kind))
    return Behavior(data=tracks, name="playback", reset=reset, direct=direct)


def most_people(behavior: Behavior) -> int:
    """How many people are in the recording at once."""
    return behavior.data.present.shape[1]


def reset(scenario: Scenario, key: Array) -> tuple[Pedestrians, Groups, Memory]:
    """Who is there at a random moment, after which the recording lasts for an episode if it can; else at its start."""
    tracks: Tracks = scenario.behavior.data
    begin_key, trait_key = jax.random.split(key)
    steps = clock.ticks(scenario.time_limit, scenario.time_step)
    latest = max(tracks.present.shape[0] - 1 - steps, 0)
    first = jax.random.randint(begin_key, (), 0, latest + 1, jnp.int32)
    preferred_speed, robot_distance = draw_traits(scenario.forces, trait_key, scenario.people)
    position, velocity, heading, present = _at(tracks, first)
    people = Pedestrians(
        position=position,
        velocity=velocity,
        heading=heading,
        desired_velocity=velocity,
        group=jnp.full(scenario.people, -1, jnp.int32),
        party=jnp.full(scenario.people, -1, jnp.int32),
        present=present,
        preferred_speed=preferred_speed,
        robot_distance=robot_distance,
    )
    return people, no_groups(), Memory(first)


def direct(scenario: Scenario, state: State, key: Array) -> State:
    """Desired velocities are the recorded ones."""
    velocity = _at(scenario.behavior.data, state.memory.first + state.tick + 1)[1]
    return replace(state, pedestrians=replace(state.pedestrians, desired_velocity=velocity))


def follow(scenario: Scenario, state: State) -> Pedestrians:
    """The pedestrian model of playback: everybody is where they were recorded, or absent; the robot moves nobody."""
    position, velocity, heading, present = _at(scenario.behavior.data, state.memory.first + state.tick + 1)
    return replace(state.pedestrians, position=position, velocity=velocity, heading=heading, present=present)


def _at(tracks: Tracks, moment: Array) -> tuple[Array, Array, Array, Array]:
    """Position, velocity, heading (N, 2) and presence (N,) at that moment () of the recording; nobody after its end."""
    last = tracks.present.shape[0] - 1
    index = jnp.minimum(moment, last)
    there = tracks.present[index] & (moment <= last)
    velocity = jnp.where(there[:, None], tracks.velocity[index], 0.0)
    return tracks.position[index], velocity, tracks.heading[index], there
