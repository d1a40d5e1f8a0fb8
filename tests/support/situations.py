"""A robot that looks along x with people around it, and which of the paper's situations occur."""

import jax
import numpy as np

from sean_jax import classifiers
from sean_jax.classifiers import SITUATIONS
from support.people import people_at, snapshot_of

NAMES = tuple(SITUATIONS)

classify = jax.jit(lambda snapshot: classifiers.classify(snapshot, classifiers.thresholds()))


def turned(degrees, length=1.0):
    return (length * np.cos(np.deg2rad(degrees)), length * np.sin(np.deg2rad(degrees)))


def snapshot(
    agents=(), position=(0.0, 0.0), goal=(9.0, 0.0), start_group=-1, goal_group=-1, heading=(1.0, 0.0), slots=4
):
    """A robot that looks along x, and agents (position, heading, speed along it, group); spare slots are absent."""
    spare = ((0.0, 0.1), (1.0, 0.0), 0.0, 0)  # would be down path and member of group 0, if it were there
    rows = [*agents, *[spare] * (slots - len(agents))]
    places, headings, speeds, groups = (np.array(part, float) for part in zip(*rows, strict=True))
    persons = people_at(
        places,
        velocity=headings * speeds[:, None],
        heading=headings,
        group=groups,
        present=np.arange(slots) < len(agents),
    )
    others = {"goal": goal, "start_group": start_group, "goal_group": goal_group}
    return jax.device_put(snapshot_of(persons, position, heading=heading, **others))


def occurring(*args, **kwargs) -> set[str]:
    flags = np.asarray(classify(snapshot(*args, **kwargs)))
    return {name for name, flag in zip(NAMES, flags, strict=True) if flag}


AHEAD, LEFT, BACK = turned(0), turned(90), turned(180)
