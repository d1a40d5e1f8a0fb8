"""How full conversational groups are, and how long people stay in them (section IV-D).

The paper's Behavior Graph "maintains" group formations while people move in and out. Who is in which group at each step
is all that this takes, so it measures recorded people as well as simulated ones.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True)
class GroupOccupancy:
    """Occupancy of G groups over time, and the stays that ended."""

    mean: Float[np.ndarray, "G"]  # members over capacity, from 0 to 1
    full: Float[np.ndarray, "G"]  # share of the time with all members
    empty: Float[np.ndarray, "G"]  # share of the time without any
    largest: Int[np.ndarray, "G"]  # most members at once
    stays: tuple[Float[np.ndarray, "K"], ...]  # s, of each group: stays that began and ended in what is measured


def group_occupancy(
    group: Int[np.ndarray, "*B T N"],
    capacity: Int[np.ndarray, "G"],
    time_step: float,
    warm_up: float = 20.0,
) -> GroupOccupancy:
    """Measure how full groups are, and how long their members stay.

    Args:
        group: (..., T, N) the group in which each person is at each step, -1 none; of one or more episodes.
        capacity: (G,) people that each group is for.
        time_step: s, between two steps.
        warm_up: s, at the beginning of each episode, that do not count.
    """
    group = np.asarray(group)
    group = group.reshape(-1, *group.shape[-2:])[:, round(warm_up / time_step) :]
    capacity = np.asarray(capacity)
    members = np.stack([(group == g).sum(-1) for g in range(len(capacity))], -1).reshape(-1, len(capacity))
    return GroupOccupancy(
        mean=members.mean(0) / capacity,
        full=(members >= capacity).mean(0),
        empty=(members == 0).mean(0),
        largest=members.max(0),
        stays=tuple(_stays(group == g) * time_step for g in range(len(capacity))),
    )


def _stays(inside: np.ndarray) -> np.ndarray:
    """(K,) steps of each stay of (B, T, N) who is inside, but for those that are cut by the beginning or the end."""
    outside = np.zeros((len(inside), 1, inside.shape[-1]), bool)
    padded = np.concatenate([outside, inside, outside], axis=1).swapaxes(1, 2)  # (B, N, T + 2)
    change = np.diff(padded.astype(np.int8), axis=-1)
    began, ended = np.nonzero(change == 1)[-1], np.nonzero(change == -1)[-1]  # in pairs, as people come in their order
    whole = (began > 0) & (ended < inside.shape[1])
    return (ended - began)[whole]
