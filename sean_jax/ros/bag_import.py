"""``sean import-bag``: the people of a bag as a recording, and with its robot as a trajectory, at even times."""

from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from sean_jax.core.bounds import MAX_DURATION, check_number
from sean_jax.core.data_types import Trajectory
from sean_jax.io import files, writing
from sean_jax.io.trajectories import save_trajectory
from sean_jax.people.recordings import headings
from sean_jax.ros.bag_episodes import LONGEST_GAP, BagTrack, Resets, Stretch, split_at_resets
from sean_jax.ros.bag_tables import read_bag
from sean_jax.ros.bag_writing import check_package
from sean_jax.ros.messages import SECOND

PEOPLE, ROBOT = "people.csv", "trajectory.csv"  # of an import
FRAMES = 10  # frame numbers from row to row of people.csv, as in UCY's recordings
MAX_BYTES = 200_000_000  # of all rows
ROW, CELL = 100, 53  # bytes of a row without people, and of a person in a row


class SampledWalk(NamedTuple):
    """A person, or N people, at the times of a grid: (T, ...) or (T, N, ...)."""

    position: np.ndarray  # (..., 2) m; 0 where absent
    velocity: np.ndarray  # (..., 2) m/s; 0 where absent
    heading: np.ndarray  # (..., 2); of a person NaN if not known
    present: np.ndarray
    group: np.ndarray  # -1: none


class Import(NamedTuple):
    """Result of an import."""

    folder: Path
    frames: int  # of all episodes
    people: int  # likewise
    robot: bool
    frame: str  # of the positions
    episodes: int
    notes: list[str]  # sentences on what is not there, or was changed


def import_bag(
    path: Path | str, folder: Path | str, time_step: float = 0.1, people: str | None = None, robot: str | None = None
) -> Import:
    """Write the people of a bag as a recording, and with its robot as a trajectory.

    Args:
        folder: new or empty; ``people.csv`` is for playback and ``recordings.read`` with ``FRAMES`` / time_step frames
            a second, ``trajectory.csv`` for ``load_trajectory``.
        time_step: s between rows, between which the bag's positions are interpolated; 0.4 makes people.csv a
            recording in the format of ETH and UCY.
        people, robot: topics, as of ``read_bag``.

    Raises:
        FileError: the bag cannot be used.
        WriteError: the folder cannot be written.
    """
    check_package()
    check_number("time_step", time_step, 1e-3, 10.0, "s")
    path = Path(path)
    folder = Path(folder)
    recording = read_bag(path, people, robot)
    resets = split_at_resets(recording)
    episodes = check_size(path, resets.episodes, time_step)
    frames = [as_trajectory(episode, time_step) for episode in episodes]
    with_robot = episodes[0].robot is not None
    seen = sum(int(episode.present.any(axis=0).sum()) for episode in frames)
    if not with_robot and not seen:
        raise files.file_error(path, "has no robot, and nobody at the times of the rows; make --time-step shorter")

    with writing.atomic_folder(folder) as new:
        if seen:
            writing.write(new / PEOPLE, _recording(frames, time_step))
        if with_robot:
            joined = frames[0] if len(frames) == 1 else _joined(frames)
            save_trajectory(joined, new / ROBOT, time_step=time_step, situations=sorted(episodes[0].situations))

    count = sum(len(episode.active) for episode in frames)
    notes = _notes(recording, resets, seen)
    return Import(folder, count, seen, with_robot, episodes[0].frame, len(episodes), notes)


def _notes(recording: Any, resets: Resets, seen: int) -> list[str]:
    """Sentences on what a bag has and the rows have not."""
    notes = []
    episodes = resets.episodes
    if len(episodes) > 1:
        notes.append(
            f"the bag has {len(episodes) - 1} resets, so there are {len(episodes)} episodes; people are new in each."
        )
    if episodes[0].robot is not None:
        if len(recording.commands) and not _any_in_rows([episode.commands for episode in episodes], episodes):
            notes.append("no command of the bag falls on a row; its clocks may differ.")
        if len(recording.goals) and not _any_in_rows([episode.goals for episode in episodes], episodes):
            notes.append("no goal of the bag falls on a row; its clocks may differ.")
    if not seen and recording.people_topic is None:
        notes.append("there are no people in the rows: no topic of people is known; name it by --people-topic.")
    elif not seen:
        notes.append(f"there are no people in the rows: {recording.people_topic} has nobody.")
    if resets.cuts:
        notes.append(f"{resets.cuts} times somebody jumped elsewhere at more than 4 m/s, and is a new person there.")
    if resets.robot_jumps:
        notes.append(
            f"{resets.robot_jumps} times the robot jumped elsewhere at more than 4 m/s; look at its localization."
        )
    return notes


def _any_in_rows(tracks: list[BagTrack], episodes: list[Stretch]) -> bool:
    """Whether one of the episodes' tracks begins before its last row."""
    for track, episode in zip(tracks, episodes, strict=True):
        last_row = _span(episode)[1]
        if len(track.times) and track.times[0] <= last_row:
            return True
    return False


# ------------------------------------------------------------------ even times


def _span(episode: Stretch) -> tuple[int, int]:
    """The first and the last time [ns] of the robot, or without a robot of the people."""
    tracks = episode.people if episode.robot is None else [episode.robot]
    first = min(track.times[0] for track in tracks)
    last = max(track.times[-1] for track in tracks)
    return int(first), int(last)


def check_size(path: Path, episodes: list[Stretch], time_step: float) -> list[Stretch]:
    """The episodes; FileError if there are none, or their rows would take too much memory."""
    if not episodes:
        raise files.file_error(path, "has neither a pose of a robot nor a person; name others by --robot-topic")
    rows = 0
    for episode in episodes:
        first, last = _span(episode)
        if last - first > MAX_DURATION * SECOND:
            hours = (last - first) / SECOND / 3600
            raise files.file_error(path, f"lasts {hours:,.0f} h, and at most 24 are read; a stamp is wrong, or cut it")
        rows = max(rows, int((last - first) / SECOND / time_step) + 1)
    rows *= len(episodes)  # as all have the length of the longest
    people = max(len(episode.people) for episode in episodes)
    if rows * (ROW + CELL * people) > MAX_BYTES:
        raise files.file_error(
            path, f"{rows:,} rows of {people:,} people are more than 200 MB; cut the bag, or make --time-step longer"
        )
    return episodes


def as_trajectory(episode: Stretch, time_step: float) -> Trajectory:
    """The people and the robot of an episode at even times, (T, ...) numpy arrays.

    Rows begin with the robot's first pose, or without a robot with the first person. Without one, the robot stands at
    the origin.
    """
    step = round(time_step * SECOND)
    first, last = _span(episode)
    count = int((last - first + step // 1000) // step) + 1  # clocks may be short of a row by a thousandth of a step
    grid = first + step * np.arange(count)
    position, heading, velocity = _robot_rows(episode, grid, time_step)
    people = _people(episode, grid, time_step)
    situations = []
    for _, track in sorted(episode.situations.items()):
        situations.append(_latest(grid, track, [0.0])[:, 0] > 0.5)
    return _trajectory(
        position=position,
        heading=heading,
        velocity=velocity,
        action=_latest(grid, episode.commands, np.zeros(2)),
        people=people.position,
        people_velocity=people.velocity,
        people_heading=people.heading,
        group=people.group,
        present=people.present,
        goal=_latest(grid, episode.goals, position[-1]),
        situations=_stacked(situations, (count, 0)).astype(bool),
        active=np.ones(count, bool),
    )


def _people(episode: Stretch, grid: np.ndarray, time_step: float) -> SampledWalk:
    """All people at the times of the grid, (T, N, ...); who has no heading looks along the velocity."""
    walks = [_walk(track, grid, time_step) for track in episode.people]
    count = len(grid)
    velocity = _stacked([walk.velocity for walk in walks], (count, 0, 2))
    heading = _stacked([walk.heading for walk in walks], (count, 0, 2))
    present = _stacked([walk.present for walk in walks], (count, 0)).astype(bool)
    unknown = present & np.isnan(heading[..., 0])
    if unknown.any():
        along = np.asarray(headings(jnp.asarray(velocity), jnp.asarray(present)), float)
        heading = np.where(unknown[..., None], along, heading)
    return SampledWalk(
        position=_stacked([walk.position for walk in walks], (count, 0, 2)),
        velocity=velocity,
        heading=np.where(present[..., None], heading, 0.0),
        present=present,
        group=_stacked([walk.group for walk in walks], (count, 0)).astype(np.int32),
    )


def _trajectory(**arrays: Any) -> Trajectory:
    """A trajectory of numpy arrays."""
    return Trajectory(**arrays)


def _stacked(columns: list[np.ndarray], empty: tuple[int, ...]) -> np.ndarray:
    """Arrays (T, ...) along a second axis; of shape ``empty`` if there are none."""
    return np.stack(columns, 1) if columns else np.zeros(empty)


def _robot_rows(episode: Stretch, grid: np.ndarray, time_step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, heading and velocity of the robot at the times of the grid."""
    count = len(grid)
    if episode.robot is None:
        return np.zeros((count, 2)), np.tile([1.0, 0.0], (count, 1)), np.zeros((count, 2))
    times = episode.robot.times
    x, y, yaw = episode.robot.values.T
    position = _interpolated(grid, times, x, y)
    (angle,) = _interpolated(grid, times, np.unwrap(yaw)).T
    heading = np.stack([np.cos(angle), np.sin(angle)], -1)
    if episode.speeds is None:
        return position, heading, _difference(position, time_step)
    speeds = _interpolated(grid, episode.speeds.times, *episode.speeds.values.T)  # (T, 2) ahead and to the left
    side = np.stack([-heading[:, 1], heading[:, 0]], -1)
    return position, heading, speeds[:, :1] * heading + speeds[:, 1:] * side


def _difference(position: np.ndarray, time_step: float) -> np.ndarray:
    """(T, 2) m/s of positions; 0 for one row."""
    return np.gradient(position, time_step, axis=0) if len(position) > 1 else np.zeros_like(position)


def _interpolated(grid: np.ndarray, times: np.ndarray, *columns: np.ndarray) -> np.ndarray:
    """(T, K) values of K columns at the times of the grid [ns], exact where the times agree."""
    rows = (grid - grid[0]).astype(float)
    known = (times - grid[0]).astype(float)
    return np.stack([np.interp(rows, known, values) for values in columns], -1)


def _latest(grid: np.ndarray, track: BagTrack, default: Any) -> np.ndarray:
    """(T, K) the last values until each time of the grid, or the default before the first."""
    default = np.asarray(default, float)
    if not len(track.times):
        return np.tile(default, (len(grid), 1))
    index = np.searchsorted(track.times, grid, side="right") - 1
    return np.where((index >= 0)[:, None], track.values[np.maximum(index, 0)], default)


def _walk(track: BagTrack, grid: np.ndarray, time_step: float) -> SampledWalk:
    """The person of a track at the times of the grid [ns]."""
    times, values = track
    x, y, vx, vy, yaw, group = values.T

    # Present at a message, and between two of them that are not far apart.
    index = np.searchsorted(times, grid, side="right") - 1
    before = np.clip(index, 0, len(times) - 1)
    after = np.clip(index + 1, 0, len(times) - 1)
    inside = (index >= 0) & (grid <= times[-1])
    connected = (times[before] == grid) | (times[after] - times[before] <= LONGEST_GAP * SECOND)
    present = inside & connected

    position = _interpolated(grid, times, x, y)
    if np.isnan(values[:, 2:4]).any():
        velocity = _difference(position, time_step)
    else:
        velocity = _interpolated(grid, times, vx, vy)
    angle = yaw[before]
    return SampledWalk(
        position=np.where(present[:, None], position, 0.0),
        velocity=np.where(present[:, None], velocity, 0.0),
        heading=np.stack([np.cos(angle), np.sin(angle)], -1),
        present=present,
        group=group[before].astype(np.int32),
    )


# ------------------------------------------------------------------ files


def _recording(episodes: list[Trajectory], time_step: float) -> str:
    """The people of episodes as a recording, one episode after the other.

    Velocities are those of the positions, as some trackers send zeros.
    """
    lines = ["frame,id,x_m,y_m,vx_mps,vy_mps,theta_rad,group_id,episode"]
    first_row = 0
    first_person = 0
    for episode, frames in enumerate(episodes):
        present = np.asarray(frames.present)
        position = np.asarray(frames.people)
        group = np.asarray(frames.group)
        heading = np.asarray(frames.people_heading, float)
        yaw = np.arctan2(heading[..., 1], heading[..., 0])
        velocity = _velocities(position, present, time_step)
        for t, n in np.argwhere(present):
            row = first_row + FRAMES * t
            person = first_person + n
            numbers = ",".join(repr(float(value)) for value in (*position[t, n], *velocity[t, n], yaw[t, n]))
            lines.append(f"{row},{person},{numbers},{group[t, n]},{episode}")
        first_row += FRAMES * len(present)
        first_person += present.shape[1]
    return "\n".join(lines) + "\n"


def _velocities(position: np.ndarray, present: np.ndarray, time_step: float) -> np.ndarray:
    """(T, N, 2) m/s from the row before, or in somebody's first row to the next one."""
    velocity = np.zeros(position.shape)
    stayed = present[1:] & present[:-1]  # in a row and in the one before
    velocity[1:][stayed] = (np.diff(position, axis=0) / time_step)[stayed]
    first = stayed & ~np.concatenate([np.zeros_like(stayed[:1]), stayed[:-1]])
    velocity[:-1][first] = velocity[1:][first]
    return velocity


OF_PEOPLE = {"people": 0.0, "people_velocity": 0.0, "people_heading": 0.0, "group": -1, "present": False}
"""Array with an axis of people -> what stands for those who are missing."""


def _joined(episodes: list[Trajectory]) -> Trajectory:
    """(E, T, ...) episodes of different lengths and numbers of people; rows behind the end are not active."""
    rows = max(len(episode.active) for episode in episodes)
    people = max(episode.present.shape[1] for episode in episodes)
    joined = {}
    for name, value in vars(episodes[0]).items():
        if value is not None:
            joined[name] = np.stack([_padded(name, vars(episode)[name], rows, people) for episode in episodes])
    return Trajectory(**joined)


def _padded(name: str, values: Any, rows: int, people: int) -> np.ndarray:
    """An array of a trajectory with so many rows and people; behind its end all is as in its last row."""
    array = np.asarray(values)
    if name in OF_PEOPLE:
        missing = [(0, 0), (0, people - array.shape[1]), *[(0, 0)] * (array.ndim - 2)]
        array = np.pad(array, missing, constant_values=OF_PEOPLE[name])
    missing = [(0, rows - len(array)), *[(0, 0)] * (array.ndim - 1)]
    if name in ("present", "active"):
        return np.pad(array, missing)
    return np.pad(array, missing, mode="edge")
