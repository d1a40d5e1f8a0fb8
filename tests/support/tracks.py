"""People who walk by the simplest rules, and recorded tracks of such people."""

import numpy as np
import pytest

from sean_jax.people import recordings as recorded
from support.files import write


def moved(people, velocity, time_step):
    """People one step later at a velocity (N, 2)."""
    return people.replace(position=people.position + time_step * velocity, velocity=velocity)


def straight(scenario, state):
    """Walks on through everything."""
    people = state.pedestrians
    return moved(people, people.desired_velocity, scenario.time_step)


@pytest.fixture
def street(tmp_path):
    """A folder with a recording: two walk side by side, one comes against them 4 s later, and one stands."""
    lines = []
    for k in range(40):
        lines += [(k, 1, 0.5 * k, 0.0), (k, 2, 0.5 * k, 0.8)]
        lines += [(k, 4, 10.0, 9.0)]
        lines += [(k, 3, 20.0 - 0.6 * (k - 10), 3.0)] if 10 <= k < 40 else []
    text = "".join(f"{10 * k},{number},{x},{y},0,0\n" for k, number, x, y in lines)
    write(tmp_path / "eth_ucy" / "made.csv", "frame,ped_id,x_m,y_m,vx_mps,vy_mps\n" + text)
    write(tmp_path / "eth_ucy" / "made.groups.txt", "2 1\n")
    return tmp_path


def tracks_of(position, present=None, step=0.1) -> recorded.Tracks:
    """People at these places (T, N, 2), who look along x."""
    shape = position.shape[:2]
    present = np.ones(shape, bool) if present is None else present
    return recorded.Tracks(
        position=position,
        facing=np.broadcast_to(np.array([1.0, 0.0]), position.shape),
        group=np.full(shape, -1, np.int32),
        present=present,
        person=np.where(present, np.arange(shape[1], dtype=np.int32), -1).astype(np.int32),
        frame=np.arange(shape[0], dtype=np.int32),
        time_step=step,
    )
