"""The people and the robot of a bag in one frame, from reset to reset.

Times are those of headers. Messages without one, such as commands, get the time that headers had when they were
received. A bag may go on through resets of a simulation: each reset begins an episode, in which everybody is new.
"""

import dataclasses
from typing import NamedTuple

import numpy as np

from sean_jax.ros.bag_tables import BASES, Recording, Table
from sean_jax.ros.messages import SECOND
from sean_jax.ros.transforms import Pose, Transforms

LONGEST_GAP = 2.0  # s: a person without messages for longer has left
FASTEST = 4.0  # m/s: who is faster was put elsewhere ...
LEAST_JUMP = 1.0  # m, and has moved at least so far, as trackers jitter
TOGETHER = 0.5  # s, within which a new goal or map belongs to a jump
BACK = 1.0  # s, by which time goes back at a reset, as messages may overtake each other


class Track(NamedTuple):
    """M rows of one person or of the robot in the order of time, each at another time."""

    times: np.ndarray  # (M,) int64 ns
    values: np.ndarray  # (M, K) x, y and others

    def between(self, begin: int, end: int) -> "Track":
        """The rows from a time on until another [ns]."""
        first, last = np.searchsorted(self.times, [begin, end])
        return Track(self.times[first:last], self.values[first:last])


@dataclasses.dataclass
class Stretch:
    """What a bag says while time goes on. Positions are in one frame."""

    frame: str
    robot: Track | None  # x, y, yaw
    speeds: Track | None  # m/s ahead and to the left
    people: list[Track]  # x, y, vx, vy, yaw, group; NaN: not known, group -1: none
    commands: Track  # m/s, rad/s
    goals: Track  # x, y
    situations: dict[str, Track]


class Resets(NamedTuple):
    """The episodes of a bag, and what was done to have them."""

    episodes: list[Stretch]
    cuts: int  # people who jumped elsewhere and were made new
    robot_jumps: int  # of the robot, at which nothing else speaks of a reset


def split(recording: Recording) -> Resets:
    """The episodes of a bag. Those in which there is neither the robot nor a person are left out."""
    episodes, cuts, robot_jumps = [], 0, 0
    for begin, end in _stretches(_reference(recording)):
        clock = Clock(_reference(recording), begin, end)
        stretch = _stretch(recording, clock, begin, end)
        new_places = _rows(recording.goals, begin, end), _rows(recording.maps, begin, end)
        evidence = np.concatenate([clock.times(rows) for rows, _ in new_places])
        parts, cut, left = _split_at_jumps(stretch, evidence)
        episodes += parts
        cuts += cut
        robot_jumps += left
    return Resets(episodes, cuts, robot_jumps)


# ------------------------------------------------------------------ time


def _reference(recording: Recording) -> np.ndarray:
    """(R, 2) receipt and stamp of the topic by which time is told; without rows if none has stamps."""
    frames = recording.frames.all
    transforms = recording.transforms.whole
    of_base = transforms[[frames[child] in BASES for child in transforms[:, 3]]] if len(transforms) else transforms
    for rows in (recording.odometry.whole, recording.poses.whole, recording.people.whole, of_base):
        stamped = rows[rows[:, 1] != 0]
        if len(stamped):
            return stamped[:, :2]
    return np.zeros((0, 2), np.int64)


def _stretches(reference: np.ndarray) -> list[tuple[int, int]]:
    """Times of receipt [ns] from which on until which the stamps go on."""
    received, stamp = reference[:, 0], reference[:, 1]
    borders = []
    latest = stamp[0] if len(stamp) else 0
    for k in range(1, len(stamp)):
        if stamp[k] < latest - BACK * SECOND:
            borders.append(int(received[k - 1] + (received[k] - received[k - 1]) // 2) + 1)
            latest = stamp[k]
        latest = max(latest, stamp[k])
    least, most = -(2**63), 2**63 - 1
    return list(zip([least, *borders], [*borders, most], strict=True))


class Clock:
    """The stamps that headers had at times of receipt.

    What was received between two messages of the reference lies between their stamps, however fast time went by.
    """

    def __init__(self, reference: np.ndarray, begin: int, end: int):
        """A clock of the messages that were received between two times [ns]."""
        rows = reference[(reference[:, 0] >= begin) & (reference[:, 0] < end)]
        self._received, delay = rows[:, 0], rows[:, 0] - rows[:, 1]
        self._least = delay.min() if len(delay) else 0
        self._delays = (delay - self._least).astype(float)

    def times(self, rows: np.ndarray) -> np.ndarray:
        """(R,) ns of rows that begin with their receipt and their stamp: the stamp if they have one."""
        received, stamp = rows[:, 0], rows[:, 1]
        if not len(self._received):
            return np.where(stamp != 0, stamp, received)
        first = self._received[0]
        delay = np.interp((received - first).astype(float), (self._received - first).astype(float), self._delays)
        return np.where(stamp != 0, stamp, received - self._least - np.round(delay).astype(np.int64))


# ------------------------------------------------------------------ one frame


def _rows(table: Table, begin: int, end: int) -> tuple[np.ndarray, np.ndarray]:
    """The whole and the other numbers of the rows that were received between two times [ns]."""
    whole = table.whole
    keep = (whole[:, 0] >= begin) & (whole[:, 0] < end)
    return whole[keep], table.numbers[keep]


def _stretch(recording: Recording, clock: Clock, begin: int, end: int) -> Stretch:
    """The messages between two times of receipt [ns], in one frame."""
    frames = recording.frames.all
    transforms = Transforms()
    static = recording.static.whole, recording.static.numbers
    for whole, numbers in (static, _rows(recording.transforms, begin, end)):
        for time, (_, _, parent, child), pose in zip(clock.times(whole), whole, numbers, strict=True):
            transforms.add(frames[parent], frames[child], int(time), Pose(*pose))
    transforms.sort()

    robot, speeds, frame = _robot(recording, clock, transforms, begin, end)
    whole, numbers = _rows(recording.people, begin, end)
    if len(whole) and not frame:
        frame = transforms.root(frames[whole[0, 2]])
    people = _people(whole, numbers, clock, transforms, frames)

    goals, places = _rows(recording.goals, begin, end)
    times = clock.times(goals)
    places = _in_root(transforms, [frames[k] for k in goals[:, 2]], times, np.pad(places, ((0, 0), (0, 1))))
    situations = {}
    rows, holds = _rows(recording.situations, begin, end)
    for number, name in enumerate(recording.situation_names.all):
        mine = rows[:, 2] == number
        situations[name] = _track(clock.times(rows[mine]), holds[mine])
    commands, values = _rows(recording.commands, begin, end)
    return Stretch(
        frame, robot, speeds, people, _track(clock.times(commands), values), _track(times, places[:, :2]), situations
    )


def _robot(
    recording: Recording, clock: Clock, transforms: Transforms, begin: int, end: int
) -> tuple[Track | None, Track | None, str]:
    """Poses and speeds of the robot, and the frame of the poses ("" without a robot)."""
    base = next((name for name in BASES if name in transforms.parent), None)
    if len(recording.odometry) == 0 and not recording.robot_topic and base is not None:
        times = np.array(transforms.times(base), np.int64)
        poses = np.array([transforms.pose(base, int(time)) for time in times])
        return _track(times, poses), None, transforms.root(base)
    of_odometry = len(recording.odometry) > 0
    whole, numbers = _rows(recording.odometry if of_odometry else recording.poses, begin, end)
    if not len(whole):
        return None, None, ""
    frames, times = [recording.frames.all[k] for k in whole[:, 2]], clock.times(whole)
    robot = _track(times, _in_root(transforms, frames, times, numbers[:, :3]))
    return robot, _track(times, numbers[:, 3:]) if of_odometry else None, transforms.root(frames[0])


def _people(
    whole: np.ndarray, numbers: np.ndarray, clock: Clock, transforms: Transforms, frames: list[str]
) -> list[Track]:
    """A track of each person in the root of the frames."""
    times, of_rows = clock.times(whole), [frames[k] for k in whole[:, 2]]
    poses = _in_root(transforms, of_rows, times, numbers[:, [0, 1, 4]])
    flow = numbers[:, 2:4].copy()
    for k, frame in enumerate(of_rows):
        if frame in transforms.parent:
            flow[k] = transforms.pose(frame, int(times[k])).turn(*flow[k])
    values = np.column_stack([poses[:, :2], flow, poses[:, 2], whole[:, 4]])
    order = np.argsort(whole[:, 3], kind="stable")
    borders = np.flatnonzero(np.diff(whole[order, 3])) + 1
    return [_track(times[mine], values[mine]) for mine in np.split(order, borders) if len(mine)]


def _in_root(transforms: Transforms, frames: list[str], times: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """(R, 3) poses of frames at times, in the root of the frames."""
    moved = poses.copy()
    for k, frame in enumerate(frames):
        if frame in transforms.parent:
            moved[k] = transforms.pose(frame, int(times[k])).then(Pose(*poses[k]))
    return moved


def _track(times: np.ndarray, values: np.ndarray) -> Track:
    """Rows in the order of time; of several at one time the last one."""
    order = np.argsort(times, kind="stable")
    times, values = times[order], values[order]
    keep = np.append(np.diff(times) > 0, True) if len(times) else np.zeros(0, bool)
    return Track(times[keep], values[keep])


# ------------------------------------------------------------------ resets


def jumps(track: Track) -> np.ndarray:
    """Indices of the rows at which somebody is where nobody can have walked to."""
    seconds = np.diff(track.times) / SECOND
    way = np.hypot(*np.diff(track.values[:, :2], axis=0).T)
    return np.flatnonzero((way > LEAST_JUMP) & (way > FASTEST * seconds)) + 1


def _split_at_jumps(stretch: Stretch, evidence: np.ndarray) -> tuple[list[Stretch], int, int]:
    """The episodes of a stretch, the number of people who were cut elsewhere, and of jumps of the robot likewise.

    Args:
        evidence: (G,) ns, at which there was a new goal or map.
    """
    robot = [] if stretch.robot is None else [stretch.robot]
    moves = []  # (ns before a jump, ns after it, number of the track)
    for number, track in enumerate([*robot, *stretch.people]):
        moves += [(track.times[k - 1], track.times[k], number) for k in jumps(track)]
    moves.sort(key=lambda move: move[1])

    borders, alone, k = [], [], 0
    while k < len(moves):
        cluster = [move for move in moves[k:] if move[1] <= moves[k][1] + TOGETHER * SECOND]
        k += len(cluster)
        if _is_reset(cluster, [*robot, *stretch.people], evidence):
            borders.append(int(cluster[0][1]))
        else:
            alone += cluster
    robot_jumps = sum(bool(robot) and number == 0 for *_, number in alone)

    least, most = -(2**63), 2**63 - 1
    parts = [_part(stretch, *span) for span in zip([least, *borders], [*borders, most], strict=True)]
    parts = [part for part in parts if part.robot is not None or (part.people and stretch.robot is None)]
    return parts, len(alone) - robot_jumps, robot_jumps


def _is_reset(cluster: list[tuple], tracks: list[Track], evidence: np.ndarray) -> bool:
    """Whether jumps are a reset: a goal or a map is new, or half of all that is there jumps."""
    before, after = min(move[0] for move in cluster), max(move[1] for move in cluster)
    slack = TOGETHER * SECOND
    if ((evidence >= before - slack) & (evidence <= after + slack)).any():
        return True
    there = sum(track.times[0] < after and track.times[-1] >= cluster[0][1] for track in tracks)
    jumped = len({number for *_, number in cluster})
    return jumped >= 2 and 2 * jumped >= there


def _part(stretch: Stretch, begin: int, end: int) -> Stretch:
    """The episode between two times [ns]. Goals stay until there is another one."""
    robot = None if stretch.robot is None else stretch.robot.between(begin, end)
    people = []
    for track in stretch.people:
        inside = track.between(begin, end)
        pieces = np.split(np.arange(len(inside.times)), jumps(inside))
        people += [Track(inside.times[piece], inside.values[piece]) for piece in pieces if len(piece)]
    until = end if end == 2**63 - 1 else end - int(TOGETHER * SECOND)
    return dataclasses.replace(
        stretch,
        robot=None if robot is None or not len(robot.times) else robot,
        speeds=None if stretch.speeds is None else stretch.speeds.between(begin, end),
        people=people,
        commands=stretch.commands.between(begin, end),
        goals=stretch.goals.between(-(2**63), until),
        situations={name: track.between(begin, end) for name, track in stretch.situations.items()},
    )
