"""The annotation of handcrafted sets (sections IV-D and IV-E): the content of handcrafted.yaml, and its checks.

Checks: fields that fit together, and room for people and robot.
"""

import math
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, get_args

import jax
import numpy as np
import pydantic
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from sean_jax.core.bounds import Coordinate, Degrees
from sean_jax.core.data_types import Array, Environment
from sean_jax.core.devices import to_device
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import crosses_box, signed_distances_on_host
from sean_jax.graph.annotation import PERSON
from sean_jax.graph.formation import reach
from sean_jax.io import cache, files

FILE = "handcrafted.yaml"
ALL = "all"  # any of the sets, without further collections
POSES = 5  # starts, and as many goals, of a set (SEAN 2.0)
ARRIVED = 1.0  # m from a waypoint, where it counts as reached (SEAN 2.0)
POSE_CLEARANCE = 0.3  # m, from the robot's poses to obstacles and to the floor's edge
APART = 0.6  # m, from people to others of another loop or group and to the robot's poses
SPACING = 0.55  # m, between people who start on one loop, wherever on it they are
MAX_LOOP = 1_000.0  # m
STRIDE = 0.1  # m, between the points of a loop at which distances are measured
STRICT = pydantic.ConfigDict(extra="forbid", allow_inf_nan=False)
Place = tuple[Coordinate, Coordinate]  # m
Situation = Literal["empty", "join_group", "leave_group", "down_path", "cross_path"]


def _kind(pose: Any) -> str:
    """The form of a pose, so that a mistake in it is reported once and not for each form."""
    return "group" if isinstance(pose, str) else "pose"


Pose = Annotated[
    Annotated[tuple[Coordinate, Coordinate, Degrees], pydantic.Tag("pose")] | Annotated[str, pydantic.Tag("group")],
    pydantic.Discriminator(_kind),
]  # x [m], y [m], heading [degrees]; or the name of a group: its open place, facing its centre
Poses = Annotated[list[Pose], pydantic.Field(min_length=POSES, max_length=POSES)]


class LoopWalkers(pydantic.BaseModel):
    """People who walk a closed loop of waypoints, and start spread along it or at its waypoints.

    People who start at waypoints take the shortest way to the next one, so the straight way may be blocked.
    """

    model_config = STRICT

    people: Annotated[int, pydantic.Field(ge=1, le=32)]
    loop: Annotated[list[Place], pydantic.Field(min_length=3, max_length=100)]  # m
    way: Literal["forward", "both"] = "forward"  # both: every second person walks the loop backwards
    start: Literal["spread", "waypoints"] = "spread"  # spread: evenly by length, from a random place on

    def first_waypoints(self) -> list[int]:
        """The index of each person's first waypoint, spaced evenly: 5 people of 10 waypoints start at every second."""
        count = len(self.loop)
        waypoints = []
        for person in range(self.people):
            rounded_up = -(-person * count // self.people)
            waypoints.append(rounded_up % count)
        return waypoints


class Group(pydantic.BaseModel):
    """People who stand and talk."""

    model_config = STRICT

    center: Place  # m
    people: Annotated[int, pydantic.Field(ge=2, le=32)]


class Set(pydantic.BaseModel):
    """One handcrafted set: the people, and where the robot starts and goes among them."""

    model_config = STRICT

    situation: Situation
    starts: Poses
    goals: Poses
    walkers: Annotated[list[LoopWalkers], pydantic.Field(max_length=32)] = []
    groups: Annotated[dict[str, Group], pydantic.Field(max_length=32)] = {}

    @property
    def people(self) -> int:
        """The number of people, walkers and members of groups."""
        return sum(party.people for party in (*self.walkers, *self.groups.values()))


class Collection(pydantic.BaseModel):
    """Sets that ``all`` does not include; chosen by the collection's name."""

    model_config = STRICT

    source: str = ""
    sets: Annotated[dict[str, Set], pydantic.Field(min_length=1, max_length=200)]


class HandcraftedAnnotation(pydantic.BaseModel):
    """The content of handcrafted.yaml."""

    model_config = STRICT

    version: Literal[1]
    source: str = ""
    sets: Annotated[dict[str, Set], pydantic.Field(min_length=1, max_length=200)]
    further: Annotated[dict[str, Collection], pydantic.Field(max_length=20)] = {}

    def each(self) -> Iterator[tuple[files.Location, str, Set]]:
        """All sets with their location in the file and their name, ``COLLECTION_SET`` for further collections."""
        for name, layout in self.sets.items():
            yield ("sets", name), name, layout
        for collection, further in self.further.items():
            for name, layout in further.sets.items():
                yield ("further", collection, "sets", name), f"{collection}_{name}", layout

    def chosen(self, name: str) -> dict[str, Set]:
        """The sets of a name: of a set, a situation or ``all``; ``COLLECTION``, ``COLLECTION_SITUATION`` or
        ``COLLECTION_SET``.

        Raises:
            InputError: there is no such set, situation or collection.
        """
        sets_of: dict[str, dict[str, Set]] = {}  # by each name
        for location, label, layout in self.each():
            if location[0] == "further":
                names = str(location[1]), f"{location[1]}_{layout.situation}", label
            else:
                names = ALL, layout.situation, label
            for key in names:
                sets = sets_of.setdefault(key, {})
                sets[label] = layout
        if name not in sets_of:
            raise InputError(files.unknown_name("sets", name, sets_of))
        return sets_of[name]


def read_sets(folder: Path, environment: Environment) -> HandcraftedAnnotation:
    """The checked ``handcrafted.yaml`` of an environment's folder.

    Raises:
        InputError: there is no such file.
        FileError: lists all mistakes of the file, with line, key and cure.
    """
    file = folder / FILE
    if not file.is_file():
        raise InputError(f"{file}: there is no such file, and behavior 'handcrafted' needs it; write one.")
    return files.load(file, HandcraftedAnnotation, check, lambda sets: check_against(sets, environment))


def check(annotation: HandcraftedAnnotation) -> Iterator[files.Problem]:
    """Mistakes in the fields of an annotation, wherever its places lie."""
    group_names = {ALL, *get_args(Situation)}  # each names several sets
    for collection in annotation.further:
        if collection in group_names or collection in annotation.sets:
            yield ("further", collection), f"'{collection}' stands for other sets; give the collection another name"
            continue
        group_names |= {collection, *(f"{collection}_{situation}" for situation in get_args(Situation))}
    names = set()
    for location, name, layout in annotation.each():
        if name in group_names:
            key = location[-1]
            yield location, f"'{key}' stands for several sets; give the set a name of its own, such as '{key}_1'"
        elif name in names:
            yield location, f"'{name}' is the name of another set too; rename one"
        names.add(name)
        if layout.people == 0 and layout.situation != "empty":
            yield location, "there is nobody; give the set walkers or groups, or make its situation empty"
        if layout.situation in ("down_path", "cross_path") and not layout.walkers:
            yield location, f"nobody walks, without which {layout.situation} does not occur; give the set walkers"
        yield from _check_poses(location, layout)
        yield from check_apart(location, layout)


def _check_poses(location: files.Location, layout: Set) -> Iterator[files.Problem]:
    """Poses in groups belong to join_group, as goals, and to leave_group, as starts."""
    for key, poses, situation in (("starts", layout.starts, "leave_group"), ("goals", layout.goals, "join_group")):
        for index, pose in enumerate(poses):
            pose_location = (*location, key, index)
            is_group = isinstance(pose, str)
            if is_group and pose not in layout.groups:
                hint = files.suggest(pose, layout.groups) or "; add it to groups or give x, y and a heading"
                yield pose_location, f"there is no group '{pose}'{hint}"
            elif is_group and layout.situation != situation:
                yield (
                    pose_location,
                    f"only {key} of {situation} lie in a group and this is {layout.situation}; give x, y and a heading",
                )
            elif not is_group and layout.situation == situation:
                yield pose_location, f"{key} of {situation} lie in a group; give the name of one instead of a place"


def trace(loop: list[tuple[float, float]]) -> np.ndarray:
    """Points (P, 2) [m] along a closed loop of waypoints [m], at most 0.1 m from one to the next."""
    corners = np.array(loop, float)
    pieces = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        leg = end - start
        strides = int(np.ceil(np.linalg.norm(leg) / STRIDE))
        share = np.linspace(0.0, 1.0, max(2, strides + 1))
        share = share[:-1]  # the last point is the first one of the next leg
        pieces.append(start + share[:, None] * leg)
    return np.concatenate(pieces)


def check_apart(location: files.Location, layout: Set) -> Iterator[files.Problem]:
    """Mistakes in the distances within a set, without regard to obstacles."""
    loops = [np.array(walkers.loop, float) for walkers in layout.walkers]
    legs = [np.linalg.norm(np.roll(loop, -1, axis=0) - loop, axis=-1) for loop in loops]
    too_long = False
    for index, lengths in enumerate(legs):
        total = lengths.sum()
        if total > MAX_LOOP:
            too_long = True
            yield (*location, "walkers", index, "loop"), f"is {total:,.0f} m long; {MAX_LOOP:,g} m are the most"
    if too_long:
        return

    traces = [trace(walkers.loop) for walkers in layout.walkers]
    for index, walkers in enumerate(layout.walkers):
        yield from _check_walkers((*location, "walkers", index), walkers, legs[index], traces[index])
    starts = []  # of people of each loop
    for walkers, loop, points in zip(layout.walkers, loops, traces, strict=True):
        if walkers.start == "waypoints":
            points = loop[walkers.first_waypoints()]
        starts.append(points)
    yield from _check_starts(location, starts)
    yield from _check_groups(location, layout, traces)
    yield from _check_robot(location, layout, starts)


def _check_starts(location: files.Location, starts: list[np.ndarray]) -> Iterator[files.Problem]:
    """Loops on which people could start in one place."""
    for (i, points), (j, others) in combinations(enumerate(starts), 2):
        gap = _gap(points, others)
        if gap < APART:
            yield (
                (*location, "walkers", j, "loop"),
                f"comes within {gap:.2f} m of the loop of walkers[{i}], where people could start in one place; keep "
                f"{APART:g} m or more",
            )


def _check_groups(location: files.Location, layout: Set, traces: list[np.ndarray]) -> Iterator[files.Problem]:
    """Groups that are too near to a loop, or to a group before them."""
    rings = []  # name, center and radius of groups so far
    for name, group in layout.groups.items():
        center = np.array([group.center])  # (1, 2) m
        radius = reach(group.people)
        group_location = (*location, "groups", name, "center")
        for i, points in enumerate(traces):
            gap = _gap(points, center) - radius
            if gap < APART:
                yield (
                    group_location,
                    f"people of walkers[{i}] would walk through the group; move the group by {APART - gap:.2f} m or "
                    "more",
                )
        for other, other_center, other_radius in rings:
            gap = _gap(other_center, center) - radius - other_radius
            if gap < APART:
                yield (
                    group_location,
                    f"leaves too little room to the group '{other}'; move one by {APART - gap:.2f} m or more",
                )
        rings.append((name, center, radius))


def _check_robot(location: files.Location, layout: Set, starts: list[np.ndarray]) -> Iterator[files.Problem]:
    """Poses of the robot where people start or stand."""
    occupied = []  # points, radius and name
    for index, (walkers, points) in enumerate(zip(layout.walkers, starts, strict=True)):
        place = "the loop" if walkers.start == "spread" else "where somebody starts"
        occupied.append((points, 0.0, f"{place} of walkers[{index}]"))
    for name, group in layout.groups.items():
        center = np.array([group.center])
        occupied.append((center, reach(group.people), f"the group '{name}'"))

    for pose_location, pose in _places(location, layout):
        point = np.array([pose[:2]])  # (1, 2) m
        for points, radius, name in occupied:
            gap = _gap(points, point) - radius
            if gap < APART:
                yield pose_location, f"is {max(gap, 0.0):.2f} m from {name}; keep {APART:g} m or more"


def _places(location: files.Location, layout: Set) -> Iterator[tuple[files.Location, tuple[float, float, float]]]:
    """The robot's poses that are no groups, with their locations in the file."""
    for key, poses in (("starts", layout.starts), ("goals", layout.goals)):
        for index, pose in enumerate(poses):
            if not isinstance(pose, str):
                yield (*location, key, index), pose


def _check_walkers(
    location: files.Location, walkers: LoopWalkers, legs: np.ndarray, points: np.ndarray
) -> Iterator[files.Problem]:
    """Mistakes in the distances along a loop, of legs (K,) [m] and traced by points (P, 2) [m]."""
    for corner in np.flatnonzero(legs < ARRIVED):
        yield (
            (*location, "loop", int(corner)),
            f"the next waypoint is only {legs[corner]:.2f} m away, as close as people come to a waypoint before they "
            f"go on, {ARRIVED:g} m; move one of them",
        )
    if walkers.start == "spread":
        max_people = _max_people(points, walkers.people)
        if max_people < walkers.people:
            yield (*location, "people"), f"{walkers.people} do not fit on the loop; the most that do is {max_people}"
        return
    if walkers.people > len(legs):
        yield (
            (*location, "people"),
            f"{walkers.people} have only {len(legs)} waypoints to start at; give more, or choose start spread",
        )
        return
    for i, j in combinations(walkers.first_waypoints(), 2):
        gap = math.dist(walkers.loop[i], walkers.loop[j])
        if gap < SPACING:
            yield (
                (*location, "loop", j),
                f"is {gap:.2f} m from waypoint {i}, where somebody starts as well; keep {SPACING:g} m or more",
            )


class RequiredRoom(NamedTuple):
    """A place of a set that needs room."""

    location: files.Location
    point: tuple[float, float]  # m
    needed: float  # m, from obstacles and edges of the floor
    user: str  # who is there


class WalkedLine(NamedTuple):
    """A straight line on which people of a set walk."""

    location: files.Location
    start: Any  # (2,) m
    end: Any  # (2,) m
    name: str


def check_against(annotation: HandcraftedAnnotation, environment: Environment) -> Iterator[files.Problem]:
    """Mistakes in where the sets lie: off the floor, in obstacles, without room or with loops that are blocked."""
    spots = []
    lines = []
    for location, _, layout in annotation.each():
        spots += _spots(location, layout)
        for index, walkers in enumerate(layout.walkers):
            if walkers.start == "spread":  # others look for a way around obstacles
                lines += _lines((*location, "walkers", index, "loop"), walkers)

    points = np.array([spot.point for spot in spots], float).reshape(-1, 2)
    to_box, to_edge = signed_distances_on_host(environment, points)
    without_room = set()
    for spot, box, edge in zip(spots, to_box, to_edge, strict=True):
        text = _fault(environment, spot, box, edge)
        if text:
            without_room.add(spot.location)
            yield spot.location, text

    for line, blocked in zip(lines, _are_blocked(environment, lines), strict=True):
        if blocked and line.location not in without_room:  # a waypoint in an obstacle is reported already
            text = f"{line.name} goes through an obstacle or closer than {PERSON:g} m past one; move a waypoint"
            yield line.location, text


def _spots(location: files.Location, layout: Set) -> Iterator[RequiredRoom]:
    for pose_location, pose in _places(location, layout):
        yield RequiredRoom(pose_location, pose[:2], POSE_CLEARANCE, "the robot")
    for name, group in layout.groups.items():
        needed = reach(group.people) + PERSON
        yield RequiredRoom((*location, "groups", name, "center"), group.center, needed, f"a group of {group.people}")
    for index, walkers in enumerate(layout.walkers):
        for k, corner in enumerate(walkers.loop):
            yield RequiredRoom((*location, "walkers", index, "loop", k), corner, PERSON, "somebody")


def _fault(environment: Environment, spot: RequiredRoom, box: float, edge: float) -> str:
    """What is wrong with a spot at that distance [m] from the nearest box and edge; empty if nothing is."""
    point = f"[{spot.point[0]:g}, {spot.point[1]:g}]"
    if edge < 0:
        floor = ", ".join(f"{value:g}" for value in np.asarray(environment.floor))
        return f"{point} is not on the floor [{floor}]; move it"
    if box <= 0:
        return f"{point} is inside an obstacle; move it by {spot.needed - box:.2f} m or more"
    room = min(box, edge)
    if room < spot.needed:
        return f"{point} has {room:.2f} m of room where {spot.user} needs {spot.needed:.2f} m; move it"
    return ""


def _are_blocked(environment: Environment, lines: list[WalkedLine]) -> Bool[np.ndarray, "L"]:
    if not lines:
        return np.zeros(0, bool)
    boxes = environment.obstacles
    ends = np.array([[line.start, line.end] for line in lines], float)

    def test() -> dict[str, np.ndarray]:
        blocked = jax.jit(_blocked)(environment, to_device(ends))
        return {"blocked": np.asarray(blocked)}

    key = boxes.center, boxes.half_extent, boxes.yaw, ends
    code = "people/handcrafted/annotation", "graph/annotation", "core/geometry"
    table = cache.load_or_build("legs", code, key, test)
    return table["blocked"]


def _lines(location: files.Location, walkers: LoopWalkers) -> Iterator[WalkedLine]:
    """Lines to the next waypoint of a loop, also if people turn a metre early."""
    corners = np.array(walkers.loop, float)
    count = len(corners)
    for k, corner in enumerate(corners):
        before = corners[k - 1]
        after = corners[(k + 1) % count]
        corner_location = (*location, k)
        yield WalkedLine(corner_location, corner, after, "the way from here to the next waypoint")
        turns = [(before, after)]
        if walkers.way == "both":
            turns.append((after, before))
        for origin, following in turns:
            back = origin - corner
            early = corner + ARRIVED * back / max(np.linalg.norm(back), ARRIVED)
            yield WalkedLine(corner_location, early, following, f"cutting the corner here by {ARRIVED:g} m")


def _blocked(environment: Environment, ends: Float[Array, "L 2 2"]) -> Bool[Array, "L"]:
    """Whether a person cannot walk a leg [m] straight."""
    cross_boxes = jax.vmap(crosses_box, in_axes=(None, None, None, None, 0, None))
    legs_cross = jax.vmap(cross_boxes, in_axes=(0, 0, 0, 0, None, None))
    px = ends[:, 0, 0]
    py = ends[:, 0, 1]
    qx = ends[:, 1, 0]
    qy = ends[:, 1, 1]
    crosses = legs_cross(px, py, qx, qy, environment.obstacles, PERSON)  # (L, W)
    return crosses.any(1)


def _max_people(points: np.ndarray, people: int) -> int:
    """Maximum number, at most this many, of people spread along a traced loop, for any position of the first."""
    step = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=-1)
    along = np.concatenate([[0.0], np.cumsum(step)])
    closed = np.concatenate([points, points[:1]])
    for count in range(people, 1, -1):
        first = np.linspace(0.0, 1.0 / count, 60)
        behind = np.arange(count) / count
        share = behind[:, None] + first[None, :]  # (count, 60)
        walked = (share % 1.0) * along[-1]
        place = np.stack([np.interp(walked, along, closed[:, k]) for k in (0, 1)], -1)
        gaps = np.linalg.norm(place[:, None] - place[None, :], axis=-1)  # (count, count, 60)
        gaps = gaps[np.triu_indices(count, 1)]
        if gaps.min() >= SPACING:
            return count
    return 1


def _gap(points: np.ndarray, others: np.ndarray) -> float:
    """Minimum distance [m] between points (P, 2) and (Q, 2)."""
    distance, _ = KDTree(points).query(others)
    return float(distance.min())
