"""Handcrafted sets (section IV-D): people's loops and groups, and the robot's poses, chosen by hand for a situation.

``annotation`` reads and checks handcrafted.yaml; here it becomes arrays (section IV-E).
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int

from sean_jax.core.data_types import Array, PathsToGoal
from sean_jax.core.devices import to_device
from sean_jax.core.errors import InputError
from sean_jax.io import cache
from sean_jax.people.handcrafted.annotation import ALL, ARRIVED, POSES, Set, read
from sean_jax.world import navigation as paths

__all__ = ["ALL", "ARRIVED", "Sets", "Ways", "build", "read"]


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
    rows = list(sets.values())
    loops = max(1, *(len(each.walkers) for each in rows))
    corners = max((len(walkers.loop) for each in rows for walkers in each.walkers), default=1)
    groups = max(1, *(len(each.groups) for each in rows))  # at least one, for indexing
    people = max(each.people for each in rows)
    stacked = jax.tree.map(lambda *row: np.stack(row), *(_row(each, people, groups, loops, corners) for each in rows))
    arrays = {name: jnp.asarray(value) for name, value in stacked.items()}
    at_waypoints = any(walkers.start == "waypoints" for each in rows for walkers in each.walkers)
    ways = None if navigation is None or not at_waypoints else _find_ways(sets, navigation, stacked["waypoint"])
    return Sets(**arrays, ways=ways, names=tuple(sets), situations=tuple(each.situation for each in rows))


def _find_ways(sets: dict[str, Set], navigation: paths.Navigation, waypoint: np.ndarray) -> Ways:
    """Ways to the waypoints (S, L, K, 2) [m]; padding has the first waypoint's."""
    legs = [
        (name, number, k, loop[k], loop[(k + 1) % len(loop)])
        for name, each in sets.items()
        for number, loop in enumerate(walkers.loop for walkers in each.walkers)
        for k in range(len(loop))
    ]
    from_each, to_each = (np.array([leg[k] for leg in legs], jnp.result_type(float)) for k in (3, 4))
    point = np.unique(from_each, axis=0)
    inputs = *paths.inputs(navigation), point, from_each, to_each
    code = "people/handcrafted/__init__", *paths.CODE
    table = dict(cache.load_or_build("ways", code, inputs, lambda: _walks(navigation, point, from_each, to_each)))
    for number in np.flatnonzero(~np.isfinite(table.pop("walk"))):
        name, walkers, k, place, _ = legs[number]
        which = f"walkers[{walkers}].loop[{k}] of set '{name}', [{place[0]:g}, {place[1]:g}],"
        raise InputError(f"handcrafted.yaml: there is no way from {which} to the next waypoint; move one of them.")
    equal = (waypoint[..., None, :].astype(point.dtype) == point).all(-1)  # (S, L, K, M)
    return Ways(
        navigation=navigation,
        point=to_device(point),
        paths_to_point=PathsToGoal(**to_device(table)),
        index=to_device(equal.argmax(-1).astype(np.int32)),
    )


def _walks(
    navigation: paths.Navigation, point: np.ndarray, from_each: np.ndarray, to_each: np.ndarray
) -> dict[str, np.ndarray]:
    """The fields (M, V) of ``PathsToGoal`` of the points (M, 2) [m], and the lengths [m] of the ways between places."""

    def to_point(place: Array) -> PathsToGoal:
        return paths.build_paths_to_goal(navigation, place)

    def length(ends: tuple[Array, Array]) -> Array:
        return paths.geodesic(navigation, *ends, to_point(ends[1]))

    table = jax.jit(lambda places: jax.lax.map(to_point, places, batch_size=32))(jnp.asarray(point))
    walk = jax.jit(lambda ends: jax.lax.map(length, ends, batch_size=32))(to_device((from_each, to_each)))
    return {
        "distance": np.asarray(table.distance),
        "departure_angle": np.asarray(table.departure_angle),
        "walk": np.asarray(walk),
    }


def _row(each: Set, people: int, groups: int, loops: int, corners: int) -> dict[str, np.ndarray]:
    waypoint, walked = np.zeros((loops, corners, 2)), np.full((loops, corners), np.inf)
    waypoints = np.ones(loops, np.int32)
    index_of = {name: np.full(people, -1, np.int32) for name in ("group", "loop", "first")}
    share, way = np.zeros(people), np.ones(people, np.int32)
    first = 0
    for index, group in enumerate(each.groups.values()):
        index_of["group"][first : first + group.people] = index
        first += group.people
    for index, walkers in enumerate(each.walkers):
        loop, members = np.array(walkers.loop, jnp.result_type(float)), slice(first, first + walkers.people)
        waypoint[index, : len(loop)], waypoints[index] = loop, len(loop)
        walked[index, : len(loop)] = np.cumsum(np.linalg.norm(np.roll(loop, -1, axis=0) - loop, axis=-1))
        index_of["loop"][members] = index
        share[members] = np.arange(walkers.people) / walkers.people
        index_of["first"][members] = walkers.first_waypoints() if walkers.start == "waypoints" else -1
        way[members] = 1 - 2 * (np.arange(walkers.people) % 2) if walkers.way == "both" else 1
        first += walkers.people
    center, capacity = np.zeros((groups, 2)), np.zeros(groups, np.int32)
    for index, group in enumerate(each.groups.values()):
        center[index], capacity[index] = group.center, group.people
    poses = {}
    for word, chosen in (("start", each.starts), ("goal", each.goals)):
        poses |= _poses(word, chosen, list(each.groups), center)
    return poses | index_of | dict(
        odds=np.ones((POSES, POSES)), waypoint=waypoint, waypoints=waypoints, walked=walked,
        center=center, capacity=capacity, share=share, way=way, present=np.arange(people) < first,
    )  # fmt: skip


def _poses(word: str, poses: list, names: list[str], center: np.ndarray) -> dict[str, np.ndarray]:
    """Places, headings and groups of five poses; the place of a pose in a group is the group's center."""
    index = [names.index(pose) if isinstance(pose, str) else -1 for pose in poses]
    place = [center[k] if k >= 0 else np.array(pose[:2]) for k, pose in zip(index, poses, strict=True)]
    angle = np.deg2rad([0.0 if isinstance(pose, str) else pose[2] for pose in poses])
    return {
        word: np.array(place),
        word + "_heading": np.stack([np.cos(angle), np.sin(angle)], -1),
        word + "_group": np.array(index, np.int32),
    }
