"""The annotation of handcrafted sets (sections IV-D and IV-E): the content of handcrafted.yaml, and its checks.

Checks: fields that fit together, and room for people and robot.
"""

import math
from collections.abc import Iterator
from itertools import combinations, product
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

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


class Walkers(pydantic.BaseModel):
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
        return [-(-person * count // self.people) % count for person in range(self.people)]


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
    walkers: Annotated[list[Walkers], pydantic.Field(max_length=32)] = []
    groups: Annotated[dict[str, Group], pydantic.Field(max_length=32)] = {}

    @property
    def people(self) -> int:
        """The number of people, walkers and members of groups."""
        return sum(some.people for some in (*self.walkers, *self.groups.values()))


class Collection(pydantic.BaseModel):
    """Sets that ``all`` does not include; chosen by the collection's name."""

    model_config = STRICT

    source: str = ""
    sets: Annotated[dict[str, Set], pydantic.Field(min_length=1, max_length=200)]


class Annotation(pydantic.BaseModel):
    """The content of handcrafted.yaml."""

    model_config = STRICT

    version: Literal[1]
    source: str = ""
    sets: Annotated[dict[str, Set], pydantic.Field(min_length=1, max_length=200)]
    further: Annotated[dict[str, Collection], pydantic.Field(max_length=20)] = {}

    def each(self) -> Iterator[tuple[files.Location, str, Set]]:
        """All sets with their location in the file and their name, ``COLLECTION_SET`` for further collections."""
        for name, one in self.sets.items():
            yield ("sets", name), name, one
        for collection, further in self.further.items():
            for name, one in further.sets.items():
                yield ("further", collection, "sets", name), f"{collection}_{name}", one

    def chosen(self, name: str) -> dict[str, Set]:
        """The sets of a name: of a set, a situation or ``all``; ``COLLECTION``, ``COLLECTION_SITUATION`` or
        ``COLLECTION_SET``.

        Raises:
            InputError: there is no such set, situation or collection.
        """
        words: dict[str, dict[str, Set]] = {}
        for where, label, one in self.each():
            collection = where[1] if where[0] == "further" else None
            situation = one.situation if collection is None else f"{collection}_{one.situation}"
            for word in (ALL if collection is None else str(collection), situation, label):
                words.setdefault(word, {})[label] = one
        if name not in words:
            raise InputError(files.unknown_name("sets", name, words))
        return words[name]


def read(folder: Path, environment: Environment) -> Annotation:
    """The checked ``handcrafted.yaml`` of an environment's folder.

    Raises:
        InputError: there is no such file.
        FileError: lists all mistakes of the file, with line, key and cure.
    """
    file = folder / FILE
    if not file.is_file():
        raise InputError(f"{file}: there is no such file, and behavior 'handcrafted' needs it; write one.")
    return files.load(file, Annotation, check, lambda sets: check_against(sets, environment))


def check(annotation: Annotation) -> Iterator[files.Problem]:
    """Mistakes in the fields of an annotation, wherever its places lie."""
    group_names = {ALL, *get_args(Situation)}  # each names several sets
    for collection in annotation.further:
        if collection in group_names or collection in annotation.sets:
            yield ("further", collection), f"'{collection}' stands for other sets; give the collection another name"
            continue
        group_names |= {collection, *(f"{collection}_{situation}" for situation in get_args(Situation))}
    known = set()
    for here, name, each in annotation.each():
        if name in group_names:
            word = here[-1]
            yield here, f"'{word}' stands for several sets; give the set a name of its own, such as '{word}_1'"
        elif name in known:
            yield here, f"'{name}' is the name of another set too; rename one"
        known.add(name)
        if each.people == 0 and each.situation != "empty":
            yield here, "there is nobody; give the set walkers or groups, or make its situation empty"
        if each.situation in ("down_path", "cross_path") and not each.walkers:
            yield here, f"nobody walks, without which {each.situation} does not occur; give the set walkers"
        yield from _check_poses(here, each)
        yield from check_apart(here, each)


def _check_poses(place: files.Location, each: Set) -> Iterator[files.Problem]:
    """Poses in groups belong to join_group, as goals, and to leave_group, as starts."""
    for key, poses, situation in (("starts", each.starts, "leave_group"), ("goals", each.goals, "join_group")):
        for number, pose in enumerate(poses):
            here = (*place, key, number)
            if isinstance(pose, str) and pose not in each.groups:
                hint = files.suggest(pose, each.groups) or "; add it to groups or give x, y and a heading"
                yield here, f"there is no group '{pose}'{hint}"
            elif isinstance(pose, str) and each.situation != situation:
                cure = "give x, y and a heading"
                yield here, f"only {key} of {situation} lie in a group and this is {each.situation}; {cure}"
            elif not isinstance(pose, str) and each.situation == situation:
                yield here, f"{key} of {situation} lie in a group; give the name of one instead of a place"


def trace(loop: list[tuple[float, float]]) -> np.ndarray:
    """Points (P, 2) [m] along a closed loop of waypoints [m], at most 0.1 m from one to the next."""
    corners = np.array(loop, float)
    pieces = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        share = np.linspace(0.0, 1.0, max(2, int(np.ceil(np.linalg.norm(b - a) / STRIDE)) + 1))[:-1]
        pieces.append(a + share[:, None] * (b - a))
    return np.concatenate(pieces)


def check_apart(here: files.Location, each: Set) -> Iterator[files.Problem]:
    """Mistakes in the distances within a set, without regard to obstacles."""
    loops = [np.array(walkers.loop, float) for walkers in each.walkers]
    legs = [np.linalg.norm(np.roll(loop, -1, axis=0) - loop, axis=-1) for loop in loops]
    long = [number for number, lengths in enumerate(legs) if lengths.sum() > MAX_LOOP]
    for number in long:
        text = f"is {legs[number].sum():,.0f} m long; {MAX_LOOP:,g} m are the most"
        yield (*here, "walkers", number, "loop"), text
    if long:
        return
    traces = [trace(walkers.loop) for walkers in each.walkers]
    begins = [  # possible starts of people
        loop[walkers.first_waypoints()] if walkers.start == "waypoints" else points
        for walkers, loop, points in zip(each.walkers, loops, traces, strict=True)
    ]
    for number, walkers in enumerate(each.walkers):
        yield from _check_walkers((*here, "walkers", number), walkers, legs[number], traces[number])
    for (i, one), (j, other) in combinations(enumerate(begins), 2):
        gap = _gap(one, other)
        if gap < APART:
            why = f"where people could start in one place; keep {APART:g} m or more"
            yield (*here, "walkers", j, "loop"), f"comes within {gap:.2f} m of the loop of walkers[{i}], {why}"
    rings = {name: (np.array([group.center]), reach(group.people)) for name, group in each.groups.items()}
    for number, (name, (spot, ring)) in enumerate(rings.items()):
        place = (*here, "groups", name, "center")
        for i, points in enumerate(traces):
            gap = _gap(points, spot) - ring
            if gap < APART:
                move = f"move the group by {APART - gap:.2f} m or more"
                yield place, f"people of walkers[{i}] would walk through the group; {move}"
        for other, (center, size) in list(rings.items())[:number]:
            gap = _gap(center, spot) - ring - size
            if gap < APART:
                move = f"move one by {APART - gap:.2f} m or more"
                yield place, f"leaves too little room to the group '{other}'; {move}"
    words = ["the loop" if walkers.start == "spread" else "where somebody starts" for walkers in each.walkers]
    around = [(points, 0.0, f"{words[i]} of walkers[{i}]") for i, points in enumerate(begins)]
    around += [(center, size, f"the group '{name}'") for name, (center, size) in rings.items()]
    for (place, pose), (points, size, what) in product(_places(here, each), around):
        gap = _gap(points, np.array([pose[:2]])) - size
        if gap < APART:
            yield place, f"is {max(gap, 0.0):.2f} m from {what}; keep {APART:g} m or more"


def _places(here: files.Location, each: Set) -> Iterator[tuple[files.Location, tuple[float, float, float]]]:
    """The robot's poses that are no groups, with their locations in the file."""
    for key, poses in (("starts", each.starts), ("goals", each.goals)):
        yield from (((*here, key, number), pose) for number, pose in enumerate(poses) if not isinstance(pose, str))


def _check_walkers(
    place: files.Location, walkers: Walkers, legs: np.ndarray, points: np.ndarray
) -> Iterator[files.Problem]:
    """Mistakes in the distances along a loop, of legs (K,) [m] and traced by points (P, 2) [m]."""
    for corner in np.flatnonzero(legs < ARRIVED):
        why = f"as close as people come to a waypoint before they go on, {ARRIVED:g} m"
        text = f"the next waypoint is only {legs[corner]:.2f} m away, {why}; move one of them"
        yield (*place, "loop", int(corner)), text
    if walkers.start == "spread":
        max_people = _max_people(points, walkers.people)
        if max_people < walkers.people:
            yield (*place, "people"), f"{walkers.people} do not fit on the loop; the most that do is {max_people}"
    elif walkers.people > len(legs):
        most = f"only {len(legs)} waypoints to start at; give more, or choose start spread"
        yield (*place, "people"), f"{walkers.people} have {most}"
    else:
        for (i, one), (j, other) in combinations([(k, walkers.loop[k]) for k in walkers.first_waypoints()], 2):
            gap = math.dist(one, other)
            if gap < SPACING:
                why = f"where somebody starts as well; keep {SPACING:g} m or more"
                yield (*place, "loop", j), f"is {gap:.2f} m from waypoint {i}, {why}"


def check_against(annotation: Annotation, environment: Environment) -> Iterator[files.Problem]:
    """Mistakes in where the sets lie: off the floor, in obstacles, without room or with loops that are blocked."""
    spots, legs = [], []
    for here, _, each in annotation.each():
        spots += [(place, pose[:2], POSE_CLEARANCE, "the robot") for place, pose in _places(here, each)]
        for label, group in each.groups.items():
            needed = reach(group.people) + PERSON
            spots.append(((*here, "groups", label, "center"), group.center, needed, f"a group of {group.people}"))
        for number, walkers in enumerate(each.walkers):
            place = (*here, "walkers", number, "loop")
            spots += [((*place, k), corner, PERSON, "somebody") for k, corner in enumerate(walkers.loop)]
            if walkers.start == "spread":  # others look for a way around obstacles
                legs += [((*place, k), *leg) for k, leg in _legs(walkers.loop, walkers.way == "both")]
    points = np.array([spot for _, spot, _, _ in spots], float).reshape(-1, 2)
    to_box, to_edge = signed_distances_on_host(environment, points)
    blamed = set()
    for (place, spot, needed, who), box, edge in zip(spots, to_box, to_edge, strict=True):
        at = f"[{spot[0]:g}, {spot[1]:g}]"
        if min(box, edge) < needed:
            blamed.add(place)
        if edge < 0:
            floor = ", ".join(f"{value:g}" for value in np.asarray(environment.floor))
            yield place, f"{at} is not on the floor [{floor}]; move it"
        elif box <= 0:
            yield place, f"{at} is inside an obstacle; move it by {needed - box:.2f} m or more"
        elif min(box, edge) < needed:
            yield place, f"{at} has {min(box, edge):.2f} m of room where {who} needs {needed:.2f} m; move it"
    if legs:
        ends = np.array([[a, b] for _, a, b, _ in legs], float)
        boxes = environment.obstacles
        inputs = boxes.center, boxes.half_extent, boxes.yaw, ends
        make = lambda: {"blocked": np.asarray(jax.jit(_blocked)(environment, to_device(ends)))}  # noqa: E731
        code = "people/handcrafted/annotation", "graph/annotation", "core/geometry"
        blocked = cache.load_or_build("legs", code, inputs, make)["blocked"]
        for (place, _, _, what), hit in zip(legs, blocked, strict=True):
            if hit and place not in blamed:  # a waypoint in an obstacle is reported already
                yield place, f"{what} goes through an obstacle or closer than {PERSON:g} m past one; move a waypoint"


def _legs(loop: list[tuple[float, float]], both: bool) -> Iterator[tuple[int, tuple]]:
    """(waypoint, (from, to, description)): lines to the next waypoint, also if people turn a metre early."""
    count = len(loop)
    corners = np.array(loop, float)
    for k in range(count):
        here, following = corners[k], corners[(k + 1) % count]
        yield k, (here, following, "the way from here to the next waypoint")
        for before, after in ((k - 1, k + 1), (k + 1, k - 1)) if both else ((k - 1, k + 1),):
            back = corners[before % count] - here
            early = here + ARRIVED * back / max(np.linalg.norm(back), ARRIVED)
            yield k, (early, corners[after % count], f"cutting the corner here by {ARRIVED:g} m")


def _blocked(environment: Environment, ends: Float[Array, "L 2 2"]) -> Bool[Array, "L"]:
    """Whether a person cannot walk a leg [m] straight."""
    each_box = jax.vmap(crosses_box, in_axes=(None, None, None, None, 0, None))
    each_leg = jax.vmap(each_box, in_axes=(0, 0, 0, 0, None, None))
    px, py, qx, qy = ends[:, 0, 0], ends[:, 0, 1], ends[:, 1, 0], ends[:, 1, 1]
    return each_leg(px, py, qx, qy, environment.obstacles, PERSON).any(1)


def _max_people(points: np.ndarray, people: int) -> int:
    """Maximum number, at most this many, of people spread along a traced loop, for any position of the first."""
    step = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=-1)
    along = np.concatenate([[0.0], np.cumsum(step)])
    closed = np.concatenate([points, points[:1]])
    for number in range(people, 1, -1):
        share = (np.arange(number) / number)[:, None] + np.linspace(0.0, 1.0 / number, 60)[None, :]
        place = np.stack([np.interp((share % 1.0) * along[-1], along, closed[:, k]) for k in (0, 1)], -1)
        gaps = np.linalg.norm(place[:, None] - place[None, :], axis=-1)[np.triu_indices(number, 1)]
        if gaps.min() >= SPACING:
            return number
    return 1


def _gap(one: np.ndarray, other: np.ndarray) -> float:
    """Minimum distance [m] between points (P, 2) and (Q, 2)."""
    return float(KDTree(one).query(other)[0].min())
