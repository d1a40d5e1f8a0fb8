"""People and what a situation or a metric sees of them, made of the few numbers that a test cares about."""

import jax
import numpy as np

from sean_jax.core.data_types import Pedestrians, Snapshot

INTEGERS, TRUTHS = {"group", "walking_group", "start_group", "goal_group", "tick"}, {"present", "situations"}


def people_at(position, **fields) -> Pedestrians:
    """People (..., N) at places (..., N, 2) [m] who stand, look along x and have no group, but for ``fields``."""
    shape = np.shape(position)[:-1]
    still = np.zeros((*shape, 2))
    usual = {
        "velocity": still,
        "heading": still + [1.0, 0.0],
        "desired_velocity": still,
        "group": np.full(shape, -1),
        "walking_group": np.full(shape, -1),
        "present": np.ones(shape, bool),
        "preferred_speed": np.ones(shape),
        "robot_distance": np.zeros(shape),
    }
    return Pedestrians(**_typed(usual | {"position": position} | fields))


def snapshot_of(people: Pedestrians, position=(0.0, 0.0), **fields) -> Snapshot:
    """Snapshots (...) of a robot at ``position`` (..., 2) [m] that stands, looks along x and is on no way."""
    shape = np.shape(position)[:-1]
    still = np.zeros((*shape, 2))
    usual = {
        "heading": still + [1.0, 0.0],
        "velocity": still,
        "start": still,
        "goal": still,
        "start_group": np.full(shape, -1),
        "goal_group": np.full(shape, -1),
        "geodesic": np.ones(shape),
        "situations": np.zeros((*shape, 5), bool),
        "tick": np.zeros(shape),
        "robot_radius": np.full(shape, 0.16),
        "person_radius": np.full(shape, 0.2),
    }
    time_step = fields.pop("time_step", 0.1)
    return Snapshot(people=people, **_typed(usual | {"position": position} | fields), time_step=time_step)


def _typed(fields: dict) -> dict:
    kinds = {name: np.int32 if name in INTEGERS else bool if name in TRUTHS else np.float32 for name in fields}
    return {
        name: jax.tree.map(lambda leaf, kind=kinds[name]: np.array(leaf, kind), value, is_leaf=_is_array)
        for name, value in fields.items()
    }


def _is_array(value) -> bool:
    return isinstance(value, tuple | list | int | float)
