"""How full groups are and how long people stay, counted person by person."""

import numpy as np

from sean_jax.studies.validation.groups import group_occupancy


def test_occupancy_and_stays_are_those_of_a_loop_over_people():
    draw = np.random.default_rng(0)
    held = np.repeat(draw.integers(-1, 3, (3, 40, 7)), draw.integers(1, 4), axis=1)
    capacity, step, warm_up = np.array([2, 3, 4]), 0.5, 5.0
    found = group_occupancy(held, capacity, step, warm_up)
    counted = held[:, 10:]
    for g in range(3):
        count = (counted == g).sum(2)
        assert found.mean[g] == count.mean() / capacity[g] and found.largest[g] == count.max()
        assert found.full[g] == np.mean(count >= capacity[g]) and found.empty[g] == np.mean(count == 0)
        lasted = []
        for episode in counted:
            for person in episode.T:
                runs = np.split(person, np.flatnonzero(np.diff(person)) + 1)
                lasted += [len(run) * step for run in runs[1:-1] if run[0] == g]
        assert sorted(found.stays[g].tolist()) == sorted(lasted) and len(lasted) > 10


def test_one_episode_and_nobody():
    found = group_occupancy(np.full((50, 4), -1), np.array([2]), 0.1, warm_up=0.0)
    assert found.mean == 0 and found.full == 0 and found.empty == 1 and len(found.stays[0]) == 0
