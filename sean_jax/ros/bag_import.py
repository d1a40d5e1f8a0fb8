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
from sean_jax.ros.bag_episodes import LONGEST_GAP, Stretch, Track, split
from sean_jax.ros.bag_tables import read
from sean_jax.ros.bag_writing import check_package
from sean_jax.ros.messages import SECOND

PEOPLE, ROBOT = "people.csv", "trajectory.csv"  # of an import
FRAMES = 10  # frame numbers from row to row of people.csv, as in UCY's recordings
MAX_BYTES = 200_000_000  # of all rows
ROW, CELL = 100, 53  # bytes of a row without people, and of a person in a row


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
        people, robot: topics, as of ``bag_tables.read``.

    Raises:
        FileError: the bag cannot be used.
        WriteError: the folder cannot be written.
    """
    check_package()
    check_number("time_step", time_step, 1e-3, 10.0, "s")
    path, folder = Path(path), Path(folder)
    recording = read(path, people, robot)
    episodes, cuts, robot_jumps = split(recording)
    frames = [as_trajectory(each, time_step) for each in check_size(path, episodes, time_step)]
    with_robot = episodes[0].robot is not None
    seen = sum(int(each.present.any(axis=0).sum()) for each in frames)
    if not with_robot and not seen:
        raise files.file_error(path, "has no robot, and nobody at the times of the rows; make --time-step shorter")

    with writing.atomic_folder(folder) as new:
        if seen:
            writing.write(new / PEOPLE, _recording(frames, time_step))
        if with_robot:
            joined = frames[0] if len(frames) == 1 else _joined(frames)
            save_trajectory(joined, new / ROBOT, time_step=time_step, situations=sorted(episodes[0].situations))

    notes = _notes(recording, episodes, frames, seen)
    if cuts:
        notes.append(f"{cuts} times somebody jumped elsewhere at more than 4 m/s, and is a new person there.")
    if robot_jumps:
        notes.append(f"{robot_jumps} times the robot jumped elsewhere at more than 4 m/s; look at its localization.")
    count = sum(len(each.active) for each in frames)
    return Import(folder, count, seen, with_robot, episodes[0].frame, len(episodes), notes)


def _notes(recording: Any, episodes: list[Stretch], frames: list[Trajectory], seen: int) -> list[str]:
    """Sentences on what a bag has and the rows have not."""
    notes = []
    if len(episodes) > 1:
        notes.append(
            f"the bag has {len(episodes) - 1} resets, so there are {len(episodes)} episodes; people are new in each."
        )
    if episodes[0].robot is not None:
        if len(recording.commands) and not _any_in_rows([each.commands for each in episodes], episodes):
            notes.append("no command of the bag falls on a row; its clocks may differ.")
        if len(recording.goals) and not _any_in_rows([each.goals for each in episodes], episodes):
            notes.append("no goal of the bag falls on a row; its clocks may differ.")
    if not seen:
        topic = recording.people_topic
        why = "no topic of people is known; name it by --people-topic" if topic is None else f"{topic} has nobody"
        notes.append(f"there are no people in the rows: {why}.")
    return notes


def _any_in_rows(tracks: list[Track], episodes: list[Stretch]) -> bool:
    """Whether one of the episodes' tracks begins before its last row."""
    return any(
        len(track.times) and track.times[0] <= _span(each)[1] for track, each in zip(tracks, episodes, strict=True)
    )


# ------------------------------------------------------------------ even times


def _span(episode: Stretch) -> tuple[int, int]:
    """The first and the last time [ns] of the robot, or without a robot of the people."""
    tracks = episode.people if episode.robot is None else [episode.robot]
    return int(min(track.times[0] for track in tracks)), int(max(track.times[-1] for track in tracks))


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
    people = max(len(each.people) for each in episodes)
    if len(episodes) * rows * (ROW + CELL * people) > MAX_BYTES:
        size = f"{len(episodes) * rows:,} rows of {people:,} people are more than 200 MB"
        raise files.file_error(path, f"{size}; cut the bag, or make --time-step longer")
    return episodes


def as_trajectory(episode: Stretch, time_step: float) -> Trajectory:
    """The people and the robot of an episode at even times, (T, ...) numpy arrays.

    Rows begin with the robot's first pose, or without a robot with the first person. Without one, the robot stands at
    the origin.
    """
    step = round(time_step * SECOND)
    first, last = _span(episode)
    count = int((last - first + step // 1000) // step) + 1
    grid = first + step * np.arange(count)
    position, heading, velocity = _robot_rows(episode, grid, time_step)

    shape = (count, len(episode.people))
    people, flow, facing = (np.zeros((*shape, 2)) for _ in range(3))
    present, group = np.zeros(shape, bool), np.full(shape, -1, np.int32)
    for n, track in enumerate(episode.people):
        people[:, n], flow[:, n], facing[:, n], present[:, n], group[:, n] = _walk(track, grid, time_step)
    blind = present & np.isnan(facing[..., 0])
    if blind.any():
        along = np.asarray(headings(jnp.asarray(flow), jnp.asarray(present)), float)
        facing = np.where(blind[..., None], along, facing)

    names = sorted(episode.situations)
    situations = [_latest(grid, episode.situations[name], [0.0])[:, 0] > 0.5 for name in names]
    return Trajectory(
        **{
            "position": position,
            "heading": heading,
            "velocity": velocity,
            "action": _latest(grid, episode.commands, np.zeros(2)),
            "people": people,
            "people_velocity": flow,
            "people_heading": np.where(present[..., None], facing, 0.0),
            "group": group,
            "present": present,
            "goal": _latest(grid, episode.goals, position[-1]),
            "situations": np.stack(situations, -1) if situations else np.zeros((count, 0), bool),
            "active": np.ones(count, bool),
        }
    )


def _robot_rows(episode: Stretch, grid: np.ndarray, time_step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, heading and velocity of the robot at the times of the grid."""
    count = len(grid)
    if episode.robot is None:
        return np.zeros((count, 2)), np.tile([1.0, 0.0], (count, 1)), np.zeros((count, 2))
    times, (x, y, yaw) = episode.robot.times, episode.robot.values.T
    position = np.stack([_interpolated(grid, times, values) for values in (x, y)], -1)
    angle = _interpolated(grid, times, np.unwrap(yaw))
    heading = np.stack([np.cos(angle), np.sin(angle)], -1)
    if episode.speeds is not None:
        ahead, left = (_interpolated(grid, episode.speeds.times, values) for values in episode.speeds.values.T)
        side = np.stack([-heading[:, 1], heading[:, 0]], -1)
        return position, heading, ahead[:, None] * heading + left[:, None] * side
    velocity = np.gradient(position, time_step, axis=0) if count > 1 else np.zeros_like(position)
    return position, heading, velocity


def _interpolated(grid: np.ndarray, times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values at the times of the grid [ns], exact where the times agree."""
    begin = grid[0]
    return np.interp((grid - begin).astype(float), (times - begin).astype(float), values)


def _latest(grid: np.ndarray, track: Track, default: Any) -> np.ndarray:
    """(T, K) the last values until each time of the grid, or the default before the first."""
    default = np.asarray(default, float)
    if not len(track.times):
        return np.tile(default, (len(grid), 1))
    index = np.searchsorted(track.times, grid, side="right") - 1
    return np.where((index >= 0)[:, None], track.values[np.maximum(index, 0)], default)


def _walk(track: Track, grid: np.ndarray, time_step: float) -> tuple[np.ndarray, ...]:
    """Position, velocity, heading (NaN if not known), presence and group of a person at the times of the grid."""
    times, values = track
    index = np.searchsorted(times, grid, side="right") - 1
    inside = (index >= 0) & (grid <= times[-1])
    before, after = np.clip(index, 0, len(times) - 1), np.clip(index + 1, 0, len(times) - 1)
    exact = times[before] == grid
    present = inside & (exact | (times[after] - times[before] <= LONGEST_GAP * SECOND))
    place = np.stack([_interpolated(grid, times, values[:, k]) for k in (0, 1)], -1)
    if np.isnan(values[:, 2:4]).any():
        flow = np.gradient(place, time_step, axis=0) if len(grid) > 1 else np.zeros_like(place)
    else:
        flow = np.stack([_interpolated(grid, times, values[:, k]) for k in (2, 3)], -1)
    yaw = values[before, 4]
    facing = np.stack([np.cos(yaw), np.sin(yaw)], -1)
    shown = present[:, None]
    return np.where(shown, place, 0.0), np.where(shown, flow, 0.0), facing, present, values[before, 5].astype(np.int32)


# ------------------------------------------------------------------ files


def _recording(episodes: list[Trajectory], time_step: float) -> str:
    """The people of episodes as a recording, one episode after the other.

    Velocities are those of the positions, as some trackers send zeros.
    """
    lines = ["frame,id,x_m,y_m,vx_mps,vy_mps,theta_rad,group_id,episode"]
    first_row, first_person = 0, 0
    for episode, frames in enumerate(episodes):
        present, place, group = (np.asarray(part) for part in (frames.present, frames.people, frames.group))
        yaw = np.arctan2(*np.moveaxis(np.asarray(frames.people_heading, float), -1, 0)[::-1])
        flow = _velocities(place, present, time_step)
        for t, n in np.argwhere(present):
            numbers = ",".join(repr(float(value)) for value in (*place[t, n], *flow[t, n], yaw[t, n]))
            row, person = first_row + FRAMES * t, first_person + n
            lines.append(f"{row},{person},{numbers},{group[t, n]},{episode}")
        first_row += FRAMES * len(present)
        first_person += present.shape[1]
    return "\n".join(lines) + "\n"


def _velocities(place: np.ndarray, present: np.ndarray, time_step: float) -> np.ndarray:
    """(T, N, 2) m/s from the row before, or in somebody's first row to the next one."""
    flow = np.zeros(place.shape)
    both = present[1:] & present[:-1]
    flow[1:][both] = (np.diff(place, axis=0) / time_step)[both]
    first = both & ~np.concatenate([np.zeros_like(both[:1]), both[:-1]])
    flow[:-1][first] = flow[1:][first]
    return flow


def _joined(episodes: list[Trajectory]) -> Trajectory:
    """(E, T, ...) episodes of different lengths and numbers of people; rows behind the end are not active."""
    rows = max(len(each.active) for each in episodes)
    people = max(each.present.shape[1] for each in episodes)
    of_people = {"people": 0.0, "people_velocity": 0.0, "people_heading": 0.0, "group": -1, "present": False}
    joined = {}
    for name, value in vars(episodes[0]).items():
        if value is None:
            continue
        parts = []
        for each in episodes:
            part = np.asarray(getattr(each, name))
            if name in of_people:
                missing = [(0, 0), (0, people - part.shape[1]), *[(0, 0)] * (part.ndim - 2)]
                part = np.pad(part, missing, constant_values=of_people[name])
            rest = [(0, rows - len(part)), *[(0, 0)] * (part.ndim - 1)]
            if name in ("present", "active"):
                part = np.pad(part, rest)
            else:
                part = np.pad(part, rest, mode="edge")
            parts.append(part)
        joined[name] = np.stack(parts)
    return Trajectory(**joined)
