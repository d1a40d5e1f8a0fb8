"""Handcrafted sets (section IV-D): people's loops and groups, and the robot's poses, chosen by hand for a situation.

``annotation`` reads and checks handcrafted.yaml; here it becomes arrays (section IV-E).
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int

from sean_jax.core.data_types import Array, PathsToGoal
from sean_jax.core.devices import to_device
from sean_jax.core.errors import InputError
from sean_jax.io import cache
from sean_jax.people.handcrafted.annotation import ALL, ARRIVED, POSES, Set, read_sets
from sean_jax.world import navigation as paths

__all__ = ["ALL", "ARRIVED", "Sets", "Ways", "build", "read_sets"]


@struct.dataclass
class Ways:
    """Shortest ways around obstacles to the waypoints of all sets, M different ones."""

    navigation: paths.Navigation  # of people
    point: Float[Array, "M 2"]  # m
    paths_to_point: PathsToGoal  # (M, V)
    index: Int[Array, "S L K"]  # of the waypoint in ``point``


@struct.dataclass
class Sets:
    """``S`` sets, padded to ``N`` people, ``G`` groups and ``L`` loops of ``K`` waypoints each."""

    odds: Float[Array, "S 5 5"]  # chance, relative to the others, with which a set is drawn with that start and goal
    start: Float[Array, "S 5 2"]  # m
    start_heading: Float[Array, "S 5 2"]  # unit vector
    start_group: Int[Array, "S 5"]  # group whose open place is the start instead, -1 none
    goal: Float[Array, "S 5 2"]  # m
    goal_heading: Float[Array, "S 5 2"]  # unit vector
    goal_group: Int[Array, "S 5"]  # likewise
    waypoint: Float[Array, "S L K 2"]  # m
    waypoints: Int[Array, "S L"]  # number of waypoints of a loop
    walked: Float[Array, "S L K"]  # m, along the loop from its first waypoint to the end of each leg; inf for padding
    center: Float[Array, "S G 2"]  # m
    capacity: Int[Array, "S G"]  # people of a group, 0 for padding
    group: Int[Array, "S N"]  # group that a person stands in, -1 none
    loop: Int[Array, "S N"]  # loop that a person walks, -1 none
    share: Float[Array, "S N"]  # of its length, at which a person is behind the loop's first one
    way: Int[Array, "S N"]  # 1 forward, -1 backward
    first: Int[Array, "S N"]  # waypoint at which a person starts, -1 for people spread along their loop
    present: Bool[Array, "S N"]
    ways: Ways | None  # None: everybody walks straight from waypoint to waypoint
    names: tuple[str, ...] = struct.field(pytree_node=False)
    situations: tuple[str, ...] = struct.field(pytree_node=False)

    def one(self, number: Int[Array, ""]) -> "Sets":
        """One of the sets, without the axis S and without ``ways``."""
        return jax.tree.map(lambda leaf: leaf[number], replace(self, ways=None))


def build(sets: dict[str, Set], navigation: paths.Navigation | None = None) -> Sets:
    """Arrays of one or more checked sets by name; every start and goal of every set with the same chance.

    Args:
        navigation: of people, for sets in which somebody starts at a waypoint.

    Raises:
        InputError: there is no way from a waypoint to the next one.
    """
    layouts = sets.values()
    walkers = [walkers for layout in layouts for walkers in layout.walkers]
    size = PaddedSize(
        people=max(layout.people for layout in layouts),
        groups=max(1, *(len(layout.groups) for layout in layouts)),  # at least one, for indexing
        loops=max(1, *(len(layout.walkers) for layout in layouts)),
        corners=max((len(party.loop) for party in walkers), default=1),
    )
    rows = [_row(layout, size) for layout in layouts]
    stacked = {name: np.stack([row[name] for row in rows]) for name in sorted(rows[0])}

    # Only people who start at waypoints walk around obstacles.
    ways = None
    at_waypoints = any(party.start == "waypoints" for party in walkers)
    if navigation is not None and at_waypoints:
        ways = _find_ways(sets, navigation, stacked["waypoint"])

    arrays = {name: jnp.asarray(value) for name, value in stacked.items()}
    situations = tuple(layout.situation for layout in layouts)
    return Sets(**arrays, ways=ways, names=tuple(sets), situations=situations)


class PaddedSize(NamedTuple):
    """To which sets are padded."""

    people: int
    groups: int
    loops: int
    corners: int  # waypoints of a loop


class LoopLeg(NamedTuple):
    """From a waypoint of a loop to the next one."""

    set: str
    walkers: int  # index of them in the set
    corner: int  # index of the waypoint in their loop
    start: tuple[float, float]  # m
    end: tuple[float, float]  # m


def _find_ways(sets: dict[str, Set], navigation: paths.Navigation, waypoint: np.ndarray) -> Ways:
    """Ways to the waypoints (S, L, K, 2) [m]; padding has the first waypoint's."""
    legs = []
    for name, layout in sets.items():
        for index, walkers in enumerate(layout.walkers):
            next_places = np.roll(walkers.loop, -1, 0).tolist()
            for corner, (place, next_place) in enumerate(zip(walkers.loop, next_places, strict=True)):
                legs.append(LoopLeg(name, index, corner, place, next_place))
    start = np.array([leg.start for leg in legs], jnp.result_type(float))
    end = np.array([leg.end for leg in legs], jnp.result_type(float))
    point = np.unique(start, axis=0)  # (M, 2)

    key = *paths.inputs(navigation), point, start, end
    code = "people/handcrafted/__init__", *paths.CODE
    table = dict(cache.load_or_build("ways", code, key, lambda: _walks(navigation, point, start, end)))
    walk = table.pop("walk")
    for index in np.flatnonzero(~np.isfinite(walk)):
        leg = legs[index]
        raise InputError(
            f"handcrafted.yaml: there is no way from walkers[{leg.walkers}].loop[{leg.corner}] of set '{leg.set}', "
            f"[{leg.start[0]:g}, {leg.start[1]:g}], to the next waypoint; move one of them."
        )

    is_equal = waypoint[..., None, :].astype(point.dtype) == point
    is_point = is_equal.all(-1)  # (S, L, K, M)
    index = is_point.argmax(-1).astype(np.int32)
    return Ways(
        navigation=navigation,
        point=to_device(point),
        paths_to_point=PathsToGoal(**to_device(table)),
        index=to_device(index),
    )


def _walks(
    navigation: paths.Navigation, point: np.ndarray, start: np.ndarray, end: np.ndarray
) -> dict[str, np.ndarray]:
    """The fields (M, V) of ``PathsToGoal`` of the points (M, 2) [m], and the lengths [m] of the ways between places."""

    def to_point(place: Array) -> PathsToGoal:
        return paths.build_paths_to_goal(navigation, place)

    def length(ends: tuple[Array, Array]) -> Array:
        start, end = ends
        return paths.geodesic(navigation, start, end, to_point(end))

    tables = jax.jit(lambda places: jax.lax.map(to_point, places, batch_size=32))
    lengths = jax.jit(lambda ends: jax.lax.map(length, ends, batch_size=32))
    table = tables(jnp.asarray(point))
    walk = lengths(to_device((start, end)))
    return {
        "distance": np.asarray(table.distance),
        "departure_angle": np.asarray(table.departure_angle),
        "walk": np.asarray(walk),
    }


def _row(layout: Set, size: PaddedSize) -> dict[str, np.ndarray]:
    """The arrays of one set: first people of groups, then walkers."""
    # All sets have the size of the largest, so that an episode draws one by its index under jit; -1 is nobody.
    index = {name: np.full(size.people, -1, np.int32) for name in ("group", "loop", "first")}

    # Members of a group come one after another, so a slice of the people is a group.
    center = np.zeros((size.groups, 2))
    capacity = np.zeros(size.groups, np.int32)
    begin = 0
    for number, group in enumerate(layout.groups.values()):
        center[number] = group.center
        capacity[number] = group.people
        index["group"][begin : begin + group.people] = number
        begin += group.people

    # ``walked`` is the way up to the end of each leg; padding is inf, an end that nobody reaches.
    waypoint = np.zeros((size.loops, size.corners, 2))
    walked = np.full((size.loops, size.corners), np.inf)
    waypoints = np.ones(size.loops, np.int32)
    share = np.zeros(size.people)
    way = np.ones(size.people, np.int32)
    for number, walkers in enumerate(layout.walkers):
        loop = np.array(walkers.loop, jnp.result_type(float))
        to_next = np.roll(loop, -1, axis=0) - loop  # (K, 2) m
        legs = np.linalg.norm(to_next, axis=-1)
        count = len(loop)
        waypoint[number, :count] = loop
        walked[number, :count] = np.cumsum(legs)
        waypoints[number] = count

        # Even shares of the length keep walkers of a loop apart, and opposite ways make them meet.
        members = slice(begin, begin + walkers.people)
        person = np.arange(walkers.people)
        index["loop"][members] = number
        if walkers.start == "waypoints":
            index["first"][members] = walkers.first_waypoints()
        share[members] = person / walkers.people
        if walkers.way == "both":
            way[members] = 1 - 2 * (person % 2)
        begin += walkers.people

    # The robot's poses, which may be in groups.
    names = list(layout.groups)
    poses = _poses("start", layout.starts, names, center) | _poses("goal", layout.goals, names, center)

    # All pairs of start and goal are equally likely until a user chooses one.
    return poses | index | dict(
        odds=np.ones((POSES, POSES)), waypoint=waypoint, waypoints=waypoints, walked=walked,
        center=center, capacity=capacity, share=share, way=way, present=np.arange(size.people) < begin,
    )  # fmt: skip


def _poses(word: str, poses: list, names: list[str], center: np.ndarray) -> dict[str, np.ndarray]:
    """Places, headings and groups of five poses; the place of a pose in a group is the group's center."""
    place = []  # m
    degrees = []
    group = []
    for pose in poses:
        if isinstance(pose, str):
            index = names.index(pose)
            place.append(center[index])
            degrees.append(0.0)
            group.append(index)
        else:
            place.append(pose[:2])
            degrees.append(pose[2])
            group.append(-1)

    angle = np.deg2rad(degrees)
    return {
        word: np.array(place),
        word + "_heading": np.stack([np.cos(angle), np.sin(angle)], -1),
        word + "_group": np.array(group, np.int32),
    }
