"""Playback (section IV-D): recorded people walk as they did, and the robot moves among them.

No model moves them, and they do not see the robot. They enter and leave as in the recording. An episode is a part of it
that begins at a random moment.
"""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Bool, Float, Int

from sean_jax.core import clock
from sean_jax.core.data_types import Array, Behavior, Groups, Pedestrians, Scenario, State
from sean_jax.core.errors import InputError
from sean_jax.people.behaviors.starts import Place, no_groups
from sean_jax.people.recordings import check_clock, motion_between_rows, read
from sean_jax.social_forces import draw_traits


@struct.dataclass
class RecordedMotion:
    """T moments, one control step apart, of N people at once; a column serves one person after the other."""

    position: Float[Array, "T N 2"]  # m; of absent people the last or next position of the column
    velocity: Float[Array, "T N 2"]  # m/s, that led to the position; zero of absent people
    heading: Float[Array, "T N 2"]  # unit vector
    present: Bool[Array, "T N"]


class PlaybackMemory(NamedTuple):
    """The part of the recording that the episode plays."""

    first: Int[Array, ""]  # moment of the recording at which the episode begins


def build(
    place: Place,
    people: int | None = None,
    *,
    recording: str | Path | None = None,
    recording_format: str | None = None,
    frame_rate: float | None = None,
) -> Behavior:
    """Recorded people walk as they did.

    Args:
        people: None, or the most people in a frame.
        recording: a CSV file with the columns frame, id, x and y in metres.
        recording_format: one of ``recordings.FORMATS``; detected if None.
        frame_rate: frames per second; the format's if None.

    Raises:
        InputError: no recording, an unusable recording, or another number of people.
    """
    if recording is None:
        raise InputError("behavior: 'playback' needs a recording; give the path of a CSV file: frame, id, x, y.")
    check_clock(recording_format, frame_rate)
    tracks = read(recording, recording_format, frame_rate, place.time_step)
    velocity, heading = motion_between_rows(tracks)
    motion = RecordedMotion(tracks.position, velocity, heading, tracks.present)  # pyright: ignore[reportArgumentType]
    count = tracks.present.shape[1]
    if people not in (None, count):
        raise InputError(f"people: {people}, but {count} are there at once in the recording; leave people out.")
    data = jax.tree.map(jnp.asarray, motion)
    return Behavior(data=data, name="playback", reset=reset, direct=direct, people=count, move=follow)


def reset(scenario: Scenario, key: Array) -> tuple[Pedestrians, Groups, PlaybackMemory]:
    """People at a random time that leaves time for an episode, or at the start of a shorter recording."""
    motion: RecordedMotion = scenario.behavior.data
    begin_key, trait_key = jax.random.split(key)
    steps = clock.ceil_ticks(scenario.time_limit, scenario.time_step)
    latest = max(motion.present.shape[0] - 1 - steps, 0)
    first = jax.random.randint(begin_key, (), 0, latest + 1, jnp.int32)
    preferred_speed, robot_distance = draw_traits(scenario.forces, trait_key, scenario.people)
    position, velocity, heading, present = _at(motion, first)
    people = Pedestrians(
        position=position,
        velocity=velocity,
        heading=heading,
        desired_velocity=velocity,
        group=jnp.full(scenario.people, -1, jnp.int32),
        walking_group=jnp.full(scenario.people, -1, jnp.int32),
        present=present,
        preferred_speed=preferred_speed,
        robot_distance=robot_distance,
    )
    return people, no_groups(), PlaybackMemory(first)


def direct(scenario: Scenario, state: State, key: Array) -> State:
    """Desired velocities are the recorded ones."""
    velocity = _at(scenario.behavior.data, state.memory.first + state.tick + 1)[1]
    return replace(state, pedestrians=replace(state.pedestrians, desired_velocity=velocity))


def follow(scenario: Scenario, state: State) -> Pedestrians:
    """The pedestrian model of playback: people as recorded, or absent; the robot moves nobody."""
    position, velocity, heading, present = _at(scenario.behavior.data, state.memory.first + state.tick + 1)
    return replace(state.pedestrians, position=position, velocity=velocity, heading=heading, present=present)


def _at(
    motion: RecordedMotion, moment: Int[Array, ""]
) -> tuple[Float[Array, "N 2"], Float[Array, "N 2"], Float[Array, "N 2"], Bool[Array, "N"]]:
    """Position [m], velocity [m/s], heading and presence at a moment of the recording; nobody after its end."""
    last = motion.present.shape[0] - 1
    index = jnp.minimum(moment, last)
    there = motion.present[index] & (moment <= last)
    velocity = jnp.where(there[:, None], motion.velocity[index], 0.0)
    return motion.position[index], velocity, motion.heading[index], there
