"""The people and the robot of a bag in one frame, from reset to reset.

Times are those of headers. Messages without one, such as commands, get the time that headers had when they were
received. A bag may go on through resets of a simulation: each reset begins an episode, in which everybody is new.
"""

import dataclasses
from typing import NamedTuple

import numpy as np

from sean_jax.ros.bag_tables import BASES, BagRecording, BagTable
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

    def between(self, begin: int, end: int) -> "BagTrack":
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
        section = Section(recording, reference, begin, end)
        new_goals = section.rows(recording.goals).times
        new_maps = section.rows(recording.maps).times
        evidence = np.concatenate([new_goals, new_maps])
        resets.append(_split_at_jumps(_stretch(section), evidence))
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
    bases = transforms[is_base]
    for rows in (recording.odometry.whole, recording.poses.whole, recording.people.whole, bases):
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
        received = reference[:, 0]
        rows = reference[(received >= begin) & (received < end)]
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
        elapsed = (received - first).astype(float)
        known_elapsed = (self._received - first).astype(float)
        delay = np.interp(elapsed, known_elapsed, self._delays)
        sent = received - self._least - np.round(delay).astype(np.int64)
        return np.where(stamp != 0, stamp, sent)


# ------------------------------------------------------------------ one frame


class TimedRows(NamedTuple):
    """Rows of a table."""

    times: np.ndarray  # (R,) ns, of headers
    whole: np.ndarray  # (R, K) whole numbers
    numbers: np.ndarray  # (R, K) other numbers


class Section:
    """The messages of a bag that were received between two times [ns]."""

    def __init__(self, recording: BagRecording, reference: np.ndarray, begin: int, end: int):
        self.recording = recording
        self.frames = recording.frames.all
        self._clock = Clock(reference, begin, end)
        self._begin = begin
        self._end = end

    def rows(self, table: BagTable) -> TimedRows:
        """The rows of a table."""
        whole = table.whole
        received = whole[:, 0]
        inside = (received >= self._begin) & (received < self._end)
        whole = whole[inside]
        return TimedRows(self._clock.times(whole), whole, table.numbers[inside])

    def static(self) -> TimedRows:
        """All static transforms, which hold at any time."""
        table = self.recording.static
        return TimedRows(self._clock.times(table.whole), table.whole, table.numbers)

    def frames_of(self, rows: TimedRows) -> list[str]:
        """The frame of each row."""
        return [self.frames[number] for number in rows.whole[:, 2]]


def _stretch(section: Section) -> Stretch:
    """The messages of a section in one frame."""
    transforms = _transforms(section)
    robot, speeds, frame = _robot(section, transforms)
    people = section.rows(section.recording.people)
    if len(people.times) and not frame:
        frame = transforms.root(section.frames_of(people)[0])
    commands = section.rows(section.recording.commands)
    goals = section.rows(section.recording.goals)
    goal_poses = np.pad(goals.numbers, ((0, 0), (0, 1)))  # (G, 3) with a yaw of 0
    goal_poses = _in_root(transforms, section.frames_of(goals), goals.times, goal_poses)
    return Stretch(
        frame=frame,
        robot=robot,
        speeds=speeds,
        people=_people(people, section.frames_of(people), transforms),
        commands=_track(commands.times, commands.numbers),
        goals=_track(goals.times, goal_poses[:, :2]),
        situations=_situations(section),
    )


def _transforms(section: Section) -> Transforms:
    """The static transforms, and those of a section."""
    frames = section.frames
    transforms = Transforms()
    for rows in (section.static(), section.rows(section.recording.transforms)):
        for time, (_, _, parent, child), pose in zip(*rows, strict=True):
            transforms.add(frames[parent], frames[child], int(time), PlanarPose(*pose))
    transforms.sort()
    return transforms


def _situations(section: Section) -> dict[str, BagTrack]:
    """Situation -> when it holds."""
    rows = section.rows(section.recording.situations)
    situations = {}
    for number, name in enumerate(section.recording.situation_names.all):
        chosen = rows.whole[:, 2] == number
        situations[name] = _track(rows.times[chosen], rows.numbers[chosen])
    return situations


def _robot(section: Section, transforms: Transforms) -> tuple[BagTrack | None, BagTrack | None, str]:
    """Poses and speeds of the robot, and the frame of the poses ("" without a robot)."""
    recording = section.recording
    has_speeds = len(recording.odometry) > 0
    base = next((name for name in BASES if name in transforms.parent), None)
    if not has_speeds and not recording.robot_topic and base is not None:
        times = np.array(transforms.times(base), np.int64)
        poses = np.array([transforms.pose(base, int(time)) for time in times])
        return _track(times, poses), None, transforms.root(base)

    rows = section.rows(recording.odometry if has_speeds else recording.poses)
    if not len(rows.times):
        return None, None, ""
    frames = section.frames_of(rows)
    poses = _in_root(transforms, frames, rows.times, rows.numbers[:, :3])
    robot = _track(rows.times, poses)
    speeds = _track(rows.times, rows.numbers[:, 3:]) if has_speeds else None
    return robot, speeds, transforms.root(frames[0])


def _people(rows: TimedRows, frames: list[str], transforms: Transforms) -> list[BagTrack]:
    """A track of each person in the root of the frames."""
    poses = _in_root(transforms, frames, rows.times, rows.numbers[:, [0, 1, 4]])  # (R, 3)
    velocity = rows.numbers[:, 2:4].copy()
    for k, frame in enumerate(frames):
        if frame in transforms.parent:
            pose = transforms.pose(frame, int(rows.times[k]))
            velocity[k] = pose.turn(*velocity[k])
    person = rows.whole[:, 3]
    group = rows.whole[:, 4]
    values = np.column_stack([poses[:, :2], velocity, poses[:, 2], group])

    # Rows of a person after those of another, by the number of the name.
    order = np.argsort(person, kind="stable")
    borders = np.flatnonzero(np.diff(person[order])) + 1
    tracks = []
    for index in np.split(order, borders):
        if len(index):
            tracks.append(_track(rows.times[index], values[index]))
    return tracks


def _in_root(transforms: Transforms, frames: list[str], times: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """(R, 3) poses of frames at times, in the root of the frames."""
    moved = poses.copy()
    for k, frame in enumerate(frames):
        if frame in transforms.parent:
            pose = transforms.pose(frame, int(times[k]))
            moved[k] = pose.then(PlanarPose(*poses[k]))
    return moved


def _track(times: np.ndarray, values: np.ndarray) -> BagTrack:
    """Rows in the order of time; of several at one time the last one."""
    order = np.argsort(times, kind="stable")
    times = times[order]
    values = values[order]
    keep = np.append(np.diff(times) > 0, True) if len(times) else np.zeros(0, bool)
    return BagTrack(times[keep], values[keep])


# ------------------------------------------------------------------ resets


def jumps(track: BagTrack) -> np.ndarray:
    """Indices of the rows at which somebody is where nobody can have walked to."""
    seconds = np.diff(track.times) / SECOND
    steps = np.diff(track.values[:, :2], axis=0)  # (M - 1, 2) m
    distance = np.hypot(steps[:, 0], steps[:, 1])
    is_jump = (distance > LEAST_JUMP) & (distance > FASTEST * seconds)
    return np.flatnonzero(is_jump) + 1


class Jump(NamedTuple):
    """A jump of a person or of the robot."""

    before: np.int64  # ns
    after: np.int64  # ns
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
        for k in jumps(track):
            before, after = track.times[k - 1], track.times[k]
            moves.append(Jump(np.int64(before), np.int64(after), index))
    moves.sort(key=lambda move: move.after)

    # Jumps within half a second belong together.
    borders = []
    single = []
    while moves:
        end = moves[0].after + TOGETHER * SECOND
        cluster = [move for move in moves if move.after <= end]
        moves = moves[len(cluster) :]
        if _is_reset(cluster, tracks, evidence):
            borders.append(int(cluster[0].after))
        else:
            single += cluster
    robot_jumps = sum(has_robot and move.track == 0 for move in single)

    episodes = []
    for begin, end in _spans(borders):
        episode = _episode(stretch, begin, end)
        is_there = episode.robot is not None if has_robot else episode.people
        if is_there:
            episodes.append(episode)
    return Resets(episodes, len(single) - robot_jumps, robot_jumps)


def _is_reset(cluster: list[Jump], tracks: list[BagTrack], evidence: np.ndarray) -> bool:
    """Whether jumps are a reset: a goal or a map is new, or half of all that is there jumps."""
    slack = TOGETHER * SECOND
    begin = min(jump.before for jump in cluster)
    end = max(jump.after for jump in cluster)
    is_near = (evidence >= begin - slack) & (evidence <= end + slack)
    if is_near.any():
        return True
    present = 0
    for track in tracks:
        present += bool(track.times[0] < end and track.times[-1] >= cluster[0].after)
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
