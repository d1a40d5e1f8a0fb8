"""Table I of real people: situations in recordings, each of whose people in turn plays the robot (section III).

The predicates read positions, orientations and velocities "provided in simulation or estimated in the real world". A
recording has no robot, so its people are asked what they meet themselves. Every row in which a person is there is an
example. Intervals are from a bootstrap over those who play the robot. A robot walks alone; so where companions are
annotated, examples are counted without them as well.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import classifiers, recordings
from sean_jax.classifiers import MORE_SITUATIONS, OBJECT_SITUATIONS, SITUATIONS
from sean_jax.studies.experiments import shares
from sean_jax.studies.experiments.shares import Shares

if TYPE_CHECKING:
    from sean_jax.base import Array
    from sean_jax.classifiers import Situation
    from sean_jax.recordings import Tracks

GROUPS = "join_group", "leave_group"  # which nobody can tell where groups are not annotated


@dataclasses.dataclass
class Recorded:
    """The examples of one recording."""

    name: str
    person: np.ndarray  # (E,) int, who plays the robot
    flags: np.ndarray  # (V, E, 5) bool
    more: np.ndarray  # (E, M) bool
    known: frozenset[str]  # situations that the recording can tell

    @property
    def people(self) -> int:
        """How many play the robot."""
        return len(np.unique(self.person))

    def shares(self, speed: int = 0) -> Shares:
        """Shares of the paper's situations."""
        return shares.count_by_person(self.flags[speed], self.person)

    def further(self) -> Shares:
        """Shares of the situations beyond the paper's five."""
        return shares.count_by_person(self.more, self.person)


class People(NamedTuple):
    """A recording, and whom of its people the robot does not meet."""

    tracks: Tracks
    companions: np.ndarray  # (N,) int32, people of one number do not meet one another; -1 meets everybody


def read(paths: Sequence[str], frame_rate: float | None = None) -> dict[str, People]:
    """The recordings in files. Where NAME.groups.txt is beside NAME.csv, it tells who walks together.

    Args:
        frame_rate: frames a second; those of their formats if None.

    Returns:
        Name -> recording: the files' names, or their paths where two have one name; and those without companions.

    Raises:
        FileError: one sentence that names the file and the cure.
    """
    found = {}
    stems = [Path(path).stem for path in paths]
    names = [stem if stems.count(stem) == 1 else path for stem, path in zip(stems, paths, strict=True)]
    for name, path in zip(names, paths, strict=True):
        tracks = recordings.read(path, frame_rate=frame_rate)
        found[name] = People(tracks, np.full(tracks.present.shape[1], -1, np.int32))
        groups = Path(path).with_suffix(".groups.txt")
        if groups.is_file():
            found[f"{name} without companions"] = People(tracks, recordings.read_companions(groups, tracks))
    return found


def count(
    name: str,
    people: People,
    speeds: Sequence[float],
    watch: Callable[[float], None] = lambda _: None,
    kind: str = "paper",
) -> Recorded:
    """The situations of everybody in a recording.

    Args:
        people: T times, N people, and who does not meet whom.
        speeds: walking speeds V, m/s.
        watch: called with the finished share.
        kind: of the five situations, a key of ``SITUATION_SETS``: paper or sean2.

    Returns:
        The examples, one for each person and row in which they are there.
    """
    tracks = people.tracks
    present = np.asarray(tracks.present)
    robots = np.flatnonzero(present.any(0))
    values, longest = jnp.asarray(speeds, float), int(present.sum(0).max())  # rows of one person
    flags, more, person = [], [], []
    for index, robot in enumerate(robots):
        rows = np.flatnonzero(present[:, robot])
        padded = np.pad(rows, (0, longest - len(rows)), "edge").astype(np.int32)
        five, further = _flags(kind, people, np.int32(robot), padded, values)
        flags.append(np.asarray(five)[:, : len(rows)])
        more.append(np.asarray(further)[: len(rows)])
        person.append(np.full(len(rows), robot))
        watch((index + 1) / len(robots))
    untold = {*OBJECT_SITUATIONS, *(() if (np.asarray(tracks.group) >= 0).any() else GROUPS)}
    known = frozenset({*SITUATIONS, *MORE_SITUATIONS} - untold)
    return Recorded(name, np.concatenate(person), np.concatenate(flags, 1), np.concatenate(more), known)


@functools.partial(jax.jit, static_argnums=0)
def _flags(kind: str, people: People, robot: Array, rows: Array, speeds: Array) -> tuple[Array, Array]:
    """(V, K, 5) and (K, M) situations of one who plays the robot, in K rows."""
    moments, _ = recordings.moments_of(people.tracks, robot)
    moments = jax.tree.map(lambda leaf: leaf[rows], moments)
    own = people.companions[robot]
    met = ~((people.companions == own) & (own >= 0))
    others = dataclasses.replace(moments.people, present=moments.people.present & met[None, :])
    moments = dataclasses.replace(moments, people=others)
    usual = classifiers.THRESHOLD_SETS[kind]()

    def at(situations: dict[str, Situation], speed: Array) -> Array:
        rules = functools.partial(classifiers.classify, situations=tuple(situations.items()))
        return jax.vmap(rules, (0, None))(moments, dataclasses.replace(usual, walking=speed))

    five = jax.vmap(functools.partial(at, classifiers.SITUATION_SETS[kind]))(speeds)
    return five, at(MORE_SITUATIONS, usual.walking)
