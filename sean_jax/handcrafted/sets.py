"""Handcrafted sets as arrays that a simulation looks up (sections IV-D and IV-E)."""

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int

from sean_jax.base import Array
from sean_jax.handcrafted.annotation import POSES, Set


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
    waypoints: Int[Array, "S L"]  # how many a loop has
    walked: Float[Array, "S L K"]  # m, along the loop from its first waypoint to the end of each leg; inf for padding
    center: Float[Array, "S G 2"]  # m
    capacity: Int[Array, "S G"]  # people of a group, 0 for padding
    group: Int[Array, "S N"]  # group that a person stands in, -1 none
    loop: Int[Array, "S N"]  # loop that a person walks, -1 none
    share: Float[Array, "S N"]  # of its length, at which a person is behind the loop's first one
    way: Int[Array, "S N"]  # 1 forward, -1 backward
    present: Bool[Array, "S N"]
    names: tuple[str, ...] = struct.field(pytree_node=False)
    situations: tuple[str, ...] = struct.field(pytree_node=False)


def build(sets: dict[str, Set]) -> Sets:
    """Arrays of sets, one row each; every start and goal of every set with the same chance.

    Args:
        sets: name -> checked set, at least one.

    Returns:
        S sets.
    """
    rows = list(sets.values())
    loops = max(1, *(len(each.walkers) for each in rows))
    corners = max((len(walkers.loop) for each in rows for walkers in each.walkers), default=1)
    groups = max(1, *(len(each.groups) for each in rows))  # one at least, so that there is something to index
    people = max(each.people for each in rows)
    stacked = jax.tree.map(lambda *row: np.stack(row), *(_row(each, people, groups, loops, corners) for each in rows))
    arrays = {name: jnp.asarray(value) for name, value in stacked.items()}
    return Sets(**arrays, names=tuple(sets), situations=tuple(each.situation for each in rows))


def _row(each: Set, people: int, groups: int, loops: int, corners: int) -> dict[str, np.ndarray]:
    waypoint, walked = np.zeros((loops, corners, 2)), np.full((loops, corners), np.inf)
    waypoints = np.ones(loops, np.int32)
    who = {name: np.full(people, -1, np.int32) for name in ("group", "loop")}
    share, way = np.zeros(people), np.ones(people, np.int32)
    first = 0
    for index, group in enumerate(each.groups.values()):
        who["group"][first : first + group.people] = index
        first += group.people
    for index, walkers in enumerate(each.walkers):
        loop, some = np.array(walkers.loop, jnp.result_type(float)), slice(first, first + walkers.people)
        waypoint[index, : len(loop)], waypoints[index] = loop, len(loop)
        walked[index, : len(loop)] = np.cumsum(np.linalg.norm(np.roll(loop, -1, axis=0) - loop, axis=-1))
        who["loop"][some] = index
        share[some] = np.arange(walkers.people) / walkers.people
        way[some] = 1 - 2 * (np.arange(walkers.people) % 2) if walkers.way == "both" else 1
        first += walkers.people
    center, capacity = np.zeros((groups, 2)), np.zeros(groups, np.int32)
    for index, group in enumerate(each.groups.values()):
        center[index], capacity[index] = group.center, group.people
    poses = {}
    for word, chosen in (("start", each.starts), ("goal", each.goals)):
        poses |= _poses(word, chosen, list(each.groups), center)
    return poses | who | dict(
        odds=np.ones((POSES, POSES)), waypoint=waypoint, waypoints=waypoints, walked=walked,
        center=center, capacity=capacity, share=share, way=way, present=np.arange(people) < first,
    )  # fmt: skip


def _poses(word: str, poses: list, names: list[str], center: np.ndarray) -> dict[str, np.ndarray]:
    """Places, headings and groups of five poses; where one is in a group, the group's centre stands for the place."""
    index = [names.index(pose) if isinstance(pose, str) else -1 for pose in poses]
    place = [center[k] if k >= 0 else np.array(pose[:2]) for k, pose in zip(index, poses, strict=True)]
    angle = np.deg2rad([0.0 if isinstance(pose, str) else pose[2] for pose in poses])
    return {
        word: np.array(place),
        word + "_heading": np.stack([np.cos(angle), np.sin(angle)], -1),
        word + "_group": np.array(index, np.int32),
    }
