"""The people and the robot of a bag in one frame, from reset to reset.

Times are those of headers. Messages without one, such as commands, get the time that headers had when they were
received. A bag may go on through resets of a simulation: each reset begins an episode, in which everybody is new.
"""

import dataclasses
from typing import NamedTuple

import numpy as np

from sean_jax.ros.bag_tables import BASES, BagRecording, Table
from sean_jax.ros.messages import SECOND
from sean_jax.ros.transforms import PlanarPose, Transforms

LONGEST_GAP = 2.0  # s: a person without messages for longer has left
FASTEST = 4.0  # m/s: who is faster was put elsewhere ...
LEAST_JUMP = 1.0  # m, and has moved at least so far, as trackers jitter
TOGETHER = 0.5  # s, within which a new goal or map belongs to a jump
FIRST_TIME, LAST_TIME = -(2**63), 2**63 - 1  # ns
BACK = 1.0  # s, by which time goes back at a reset, as messages may overtake each other


class BagTrack(NamedTuple):
    """M rows of one person or of the robot in the order of time, each at another time."""

    times: np.ndarray  # (M,) int64 ns
    values: np.ndarray  # (M, K) x, y and others

    def between(self, begin: int, end: int) -> "Track":
        """The rows from a time on until another [ns]."""
        first, last = np.searchsorted(self.times, [begin, end])
        return BagTrack(self.times[first:last], self.values[first:last])


@dataclasses.dataclass
class Stretch:
    """What a bag says while time goes on. Positions are in one frame."""

    frame: str
    robot: BagTrack | None  # x, y, yaw
    speeds: BagTrack | None  # m/s ahead and to the left
    people: list[BagTrack]  # x, y, vx, vy, yaw, group; NaN: not known, group -1: none
    commands: BagTrack  # m/s, rad/s
    goals: BagTrack  # x, y
    situations: dict[str, BagTrack]


class Resets(NamedTuple):
    """The episodes of a bag, and what was done to have them."""

    episodes: list[Stretch]
    cuts: int  # people who jumped elsewhere and were made new
    robot_jumps: int  # of the robot, at which nothing else speaks of a reset


def split_at_resets(recording: BagRecording) -> Resets:
    """The episodes of a bag. Those in which there is neither the robot nor a person are left out."""
    reference = _reference(recording)
    resets = []
    for begin, end in _stretches(reference):
        clock = Clock(reference, begin, end)
        stretch = _stretch(recording, clock, begin, end)
        goals, _ = _rows(recording.goals, begin, end)
        maps, _ = _rows(recording.maps, begin, end)
        evidence = np.concatenate([clock.times(goals), clock.times(maps)])
        resets.append(_split_at_jumps(stretch, evidence))
    return Resets(
        episodes=[episode for reset in resets for episode in reset.episodes],
        cuts=sum(reset.cuts for reset in resets),
        robot_jumps=sum(reset.robot_jumps for reset in resets),
    )


# ------------------------------------------------------------------ time


def _reference(recording: BagRecording) -> np.ndarray:
    """(R, 2) receipt and stamp of the topic by which time is told; without rows if none has stamps."""
    frames = recording.frames.all
    transforms = recording.transforms.whole
    is_base = np.array([frames[child] in BASES for child in transforms[:, 3]], bool)
    for rows in (recording.odometry.whole, recording.poses.whole, recording.people.whole, transforms[is_base]):
        stamped = rows[rows[:, 1] != 0]
        if len(stamped):
            return stamped[:, :2]
    return np.zeros((0, 2), np.int64)


def _stretches(reference: np.ndarray) -> list[tuple[int, int]]:
    """Times of receipt [ns] from which on until which the stamps go on."""
    received = reference[:, 0]
    stamp = reference[:, 1]
    borders = []
    latest = stamp[0] if len(stamp) else 0
    for k in range(1, len(stamp)):
        if stamp[k] < latest - BACK * SECOND:
            pause = received[k] - received[k - 1]
            borders.append(int(received[k - 1] + pause // 2) + 1)
            latest = stamp[k]
        latest = max(latest, stamp[k])
    return _spans(borders)


def _spans(borders: list[int]) -> list[tuple[int, int]]:
    """The times [ns] between borders, from the first that there is to the last."""
    return list(zip([FIRST_TIME, *borders], [*borders, LAST_TIME], strict=True))


class Clock:
    """The stamps that headers had at times of receipt.

    What was received between two messages of the reference lies between their stamps, however fast time went by.
    """

    def __init__(self, reference: np.ndarray, begin: int, end: int):
        """A clock of the messages that were received between two times [ns]."""
        rows = reference[(reference[:, 0] >= begin) & (reference[:, 0] < end)]
        self._received = rows[:, 0]
        delay = rows[:, 0] - rows[:, 1]
        self._least = delay.min() if len(delay) else 0
        self._delays = (delay - self._least).astype(float)

    def times(self, rows: np.ndarray) -> np.ndarray:
        """(R,) ns of rows that begin with their receipt and their stamp: the stamp if they have one."""
        received = rows[:, 0]
        stamp = rows[:, 1]
        if not len(self._received):
            return np.where(stamp != 0, stamp, received)

        # Floats hold times since the first message, and the delays beyond the least one, to the nanosecond.
        first = self._received[0]
        delay = np.interp((received - first).astype(float), (self._received - first).astype(float), self._delays)
        sent = received - self._least - np.round(delay).astype(np.int64)
        return np.where(stamp != 0, stamp, sent)


# ------------------------------------------------------------------ one frame


def _rows(table: Table, begin: int, end: int) -> tuple[np.ndarray, np.ndarray]:
    """The whole and the other numbers of the rows that were received between two times [ns]."""
    whole = table.whole
    keep = (whole[:, 0] >= begin) & (whole[:, 0] < end)
    return whole[keep], table.numbers[keep]


def _stretch(recording: BagRecording, clock: Clock, begin: int, end: int) -> Stretch:
    """The messages between two times of receipt [ns], in one frame."""
    frames = recording.frames.all
    transforms = _transforms(recording, clock, begin, end)
    robot, speeds, frame = _robot(recording, clock, transforms, begin, end)
    whole, numbers = _rows(recording.people, begin, end)
    if len(whole) and not frame:
        frame = transforms.root(frames[whole[0, 2]])

    # What the robot was told, and what was said about its surroundings.
    commands, velocities = _rows(recording.commands, begin, end)
    goals, points = _rows(recording.goals, begin, end)
    goal_times = clock.times(goals)
    poses = np.pad(points, ((0, 0), (0, 1)))  # (G, 3) with a yaw of 0
    poses = _in_root(transforms, [frames[k] for k in goals[:, 2]], goal_times, poses)
    return Stretch(
        frame=frame,
        robot=robot,
        speeds=speeds,
        people=_people(whole, numbers, clock, transforms, frames),
        commands=_track(clock.times(commands), velocities),
        goals=_track(goal_times, poses[:, :2]),
        situations=_situations(recording, clock, begin, end),
    )


def _transforms(recording: BagRecording, clock: Clock, begin: int, end: int) -> Transforms:
    """The static transforms, and those between two times of receipt [ns]."""
    frames = recording.frames.all
    static = recording.static.whole, recording.static.numbers
    transforms = Transforms()
    for whole, numbers in (static, _rows(recording.transforms, begin, end)):
        for time, (_, _, parent, child), pose in zip(clock.times(whole), whole, numbers, strict=True):
            transforms.add(frames[parent], frames[child], int(time), PlanarPose(*pose))
    transforms.sort()
    return transforms


def _situations(recording: BagRecording, clock: Clock, begin: int, end: int) -> dict[str, BagTrack]:
    """Situation -> when it holds, between two times of receipt [ns]."""
    rows, holds = _rows(recording.situations, begin, end)
    situations = {}
    for number, name in enumerate(recording.situation_names.all):
        chosen = rows[:, 2] == number
        situations[name] = _track(clock.times(rows[chosen]), holds[chosen])
    return situations


def _robot(
    recording: BagRecording, clock: Clock, transforms: Transforms, begin: int, end: int
) -> tuple[BagTrack | None, BagTrack | None, str]:
    """Poses and speeds of the robot, and the frame of the poses ("" without a robot)."""
    base = next((name for name in BASES if name in transforms.parent), None)
    if len(recording.odometry) == 0 and not recording.robot_topic and base is not None:
        times = np.array(transforms.times(base), np.int64)
        poses = np.array([transforms.pose(base, int(time)) for time in times])
        return _track(times, poses), None, transforms.root(base)
    has_speeds = len(recording.odometry) > 0
    whole, numbers = _rows(recording.odometry if has_speeds else recording.poses, begin, end)
    if not len(whole):
        return None, None, ""
    frames = [recording.frames.all[k] for k in whole[:, 2]]
    times = clock.times(whole)
    robot = _track(times, _in_root(transforms, frames, times, numbers[:, :3]))
    speeds = _track(times, numbers[:, 3:]) if has_speeds else None
    return robot, speeds, transforms.root(frames[0])


def _people(
    whole: np.ndarray, numbers: np.ndarray, clock: Clock, transforms: Transforms, frames: list[str]
) -> list[BagTrack]:
    """A track of each person in the root of the frames."""
    times = clock.times(whole)
    frame_names = [frames[k] for k in whole[:, 2]]
    poses = _in_root(transforms, frame_names, times, numbers[:, [0, 1, 4]])  # (R, 3)
    velocity = numbers[:, 2:4].copy()
    for k, frame in enumerate(frame_names):
        if frame in transforms.parent:
            velocity[k] = transforms.pose(frame, int(times[k])).turn(*velocity[k])
    values = np.column_stack([poses[:, :2], velocity, poses[:, 2], whole[:, 4]])

    # Rows of a person after those of another, by the number of the name.
    person = whole[:, 3]
    order = np.argsort(person, kind="stable")
    borders = np.flatnonzero(np.diff(person[order])) + 1
    return [_track(times[rows], values[rows]) for rows in np.split(order, borders) if len(rows)]


def _in_root(transforms: Transforms, frames: list[str], times: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """(R, 3) poses of frames at times, in the root of the frames."""
    moved = poses.copy()
    for k, frame in enumerate(frames):
        if frame in transforms.parent:
            moved[k] = transforms.pose(frame, int(times[k])).then(PlanarPose(*poses[k]))
    return moved


def _track(times: np.ndarray, values: np.ndarray) -> BagTrack:
    """Rows in the order of time; of several at one time the last one."""
    order = np.argsort(times, kind="stable")
    times, values = times[order], values[order]
    keep = np.append(np.diff(times) > 0, True) if len(times) else np.zeros(0, bool)
    return BagTrack(times[keep], values[keep])


# ------------------------------------------------------------------ resets


def jumps(track: BagTrack) -> np.ndarray:
    """Indices of the rows at which somebody is where nobody can have walked to."""
    seconds = np.diff(track.times) / SECOND
    steps = np.diff(track.values[:, :2], axis=0)  # (M - 1, 2) m
    distance = np.hypot(steps[:, 0], steps[:, 1])
    return np.flatnonzero((distance > LEAST_JUMP) & (distance > FASTEST * seconds)) + 1


class Jump(NamedTuple):
    """A jump of a person or of the robot."""

    before: int  # ns
    after: int  # ns
    track: int  # index among the tracks


def _split_at_jumps(stretch: Stretch, evidence: np.ndarray) -> Resets:
    """The episodes of a stretch, and the jumps that begin none.

    Args:
        evidence: (G,) ns, at which there was a new goal or map.
    """
    has_robot = stretch.robot is not None
    tracks = [stretch.robot, *stretch.people] if stretch.robot is not None else stretch.people
    moves = []
    for index, track in enumerate(tracks):
        moves += [Jump(track.times[k - 1], track.times[k], index) for k in jumps(track)]
    moves.sort(key=lambda move: move.after)

    # Jumps within half a second belong together.
    borders, single = [], []
    while moves:
        end = moves[0].after + TOGETHER * SECOND
        cluster = [move for move in moves if move.after <= end]
        moves = moves[len(cluster) :]
        if _is_reset(cluster, tracks, evidence):
            borders.append(int(cluster[0].after))
        else:
            single += cluster
    robot_jumps = sum(has_robot and move.track == 0 for move in single)

    episodes = [_episode(stretch, begin, end) for begin, end in _spans(borders)]
    episodes = [episode for episode in episodes if (episode.robot is not None if has_robot else episode.people)]
    return Resets(episodes, len(single) - robot_jumps, robot_jumps)


def _is_reset(cluster: list[Jump], tracks: list[BagTrack], evidence: np.ndarray) -> bool:
    """Whether jumps are a reset: a goal or a map is new, or half of all that is there jumps."""
    slack = TOGETHER * SECOND
    begin = min(jump.before for jump in cluster)
    end = max(jump.after for jump in cluster)
    if ((evidence >= begin - slack) & (evidence <= end + slack)).any():
        return True
    present = sum(track.times[0] < end and track.times[-1] >= cluster[0].after for track in tracks)
    jumped = len({jump.track for jump in cluster})
    return jumped >= 2 and 2 * jumped >= present


def _episode(stretch: Stretch, begin: int, end: int) -> Stretch:
    """The episode between two times [ns]. Goals stay until there is another one."""
    robot = None if stretch.robot is None else stretch.robot.between(begin, end)
    people = []
    for track in stretch.people:
        inside = track.between(begin, end)
        pieces = np.split(np.arange(len(inside.times)), jumps(inside))
        people += [BagTrack(inside.times[piece], inside.values[piece]) for piece in pieces if len(piece)]
    last_goal = end if end == LAST_TIME else end - int(TOGETHER * SECOND)  # a later one belongs to the next episode
    return dataclasses.replace(
        stretch,
        robot=None if robot is None or not len(robot.times) else robot,
        speeds=None if stretch.speeds is None else stretch.speeds.between(begin, end),
        people=people,
        commands=stretch.commands.between(begin, end),
        goals=stretch.goals.between(FIRST_TIME, last_goal),
        situations={name: track.between(begin, end) for name, track in stretch.situations.items()},
    )
