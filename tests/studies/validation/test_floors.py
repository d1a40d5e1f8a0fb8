"""The measures of people on floors see what was put in, and recorded people are calm."""

import numpy as np
import pytest

from sean_jax.people.recordings.reading import read
from sean_jax.studies.validation.checks import PUBLISHED
from sean_jax.studies.validation.floor_measures import (
    GatheredPeople,
    Observed,
    group_life,
    liveliness,
    longest_near,
    passes,
    used_cells,
)
from sean_jax.studies.validation.floors import DoorDraws, compare_doors, compare_groups

STEP = 0.1


def seen(position, heading=None, standing=None):
    """One person who was there all the time."""
    position = np.asarray(position, float)[:, None]
    present = np.ones(position.shape[:2], bool)
    standing = np.zeros_like(present) if standing is None else np.asarray(standing, bool)[:, None]
    return Observed(position, present, standing, None if heading is None else np.asarray(heading)[:, None], STEP)


def there_and_back(speed=1.0, seconds=20.0):
    along = speed * STEP * np.arange(round(seconds / STEP))
    half = len(along) // 2
    x = np.where(np.arange(len(along)) < half, along, 2 * along[half] - along)
    return np.stack([x, np.zeros_like(x)], -1)


def test_a_half_turn_is_one_event():
    values = liveliness(seen(there_and_back()))
    assert values.half_turns * values.walking_minutes == pytest.approx(1.0)
    assert liveliness(seen(there_and_back(), standing=np.ones(200))).walking_minutes == 0.0
    assert liveliness(seen(there_and_back(0.4))).half_turns != 1.0  # too slow to count


def test_a_circle_has_its_acceleration_and_turn_rate():
    radius, speed = 4.0, 1.2
    angle = speed / radius * STEP * np.arange(600)
    values = liveliness(seen(radius * np.stack([np.cos(angle), np.sin(angle)], -1)))
    assert values.acceleration_p95 == pytest.approx(speed**2 / radius, rel=0.05)
    assert values.turn_rate_p95 == pytest.approx(speed / radius, rel=0.05)
    assert values.half_turns == 0.0


def test_heads_that_snap_and_bodies_that_spin_are_counted():
    place = np.zeros((100, 2))
    angle = np.zeros(100)
    angle[50:] = np.pi
    values = liveliness(seen(place, np.stack([np.cos(angle), np.sin(angle)], -1)))
    assert values.heading_jumps * 100 * STEP / 60 == pytest.approx(1.0)
    angle = 3.0 * STEP * np.arange(100)
    values = liveliness(seen(place, np.stack([np.cos(angle), np.sin(angle)], -1)))
    assert values.spins > 0.0 and values.heading_jumps == 0.0


def test_standstill_is_told_from_standing():
    place = np.zeros((300, 2))
    values = liveliness(seen(place))
    assert values.stuck_share == values.slow_share == 1.0
    assert values.longest_standstill == pytest.approx(30.0, abs=0.2)
    assert liveliness(seen(place, standing=np.ones(300))).stuck_share == 0.0


def test_people_who_vanish_and_return_elsewhere_do_not_jump():
    position = np.concatenate([np.zeros((50, 1, 2)), np.full((50, 1, 2), 30.0)])
    present = np.ones((100, 1), bool)
    present[49] = False
    values = liveliness(Observed(position, present, np.zeros_like(present), None, STEP))
    assert values.hard_accelerations == 0.0
    present[49] = True
    values = liveliness(Observed(position, present, np.zeros_like(present), None, STEP))
    assert values.hard_accelerations > 0.0


def test_the_floor_that_is_used():
    assert used_cells(seen(there_and_back())) == {(x, 0) for x in range(11)}  # 10 m there, and back


def gathered(stay, way=None, seconds=300.0):
    """A group of two, of whom one stays a while from 20 s on, the next one likewise; and a third who walks a way."""
    moments = round(seconds / STEP)
    group = np.full((moments, 4), -1)
    group[:, 0] = 0  # always there
    for turn in range(2):
        begin = 20.0 + turn * (stay + 10.0)
        group[round(begin / STEP) : round((begin + stay) / STEP), 1 + turn] = 0
    position = np.zeros((moments, 4, 2))
    position[:, 0, 0], position[:, 1:3, 1] = 1.0, 1.0  # on a ring of 1 m, or beside it
    position[:, 3] = (9.0, 9.0) if way is None else way
    present = np.ones(group.shape, bool)
    seen = Observed(position, present, group >= 0, None, STEP)
    visit = np.array([[60.0, 100.0]])
    return group_life(seen, GatheredPeople(group, np.zeros((1, 2)), np.ones(1), visit))


def test_stays_are_those_that_the_graph_has():
    as_drawn = gathered(80.0)
    assert as_drawn.stays == 2 and as_drawn.mean_stay == pytest.approx(80.0)  # the first one is never whole
    assert as_drawn.unlike_graph == as_drawn.short_stays == 0.0
    assert as_drawn.changes == pytest.approx(2 / 5)
    assert compare_groups({"floor": as_drawn}).passed
    for stay, short in ((8.0, 1.0), (59.0, 0.0), (106.0, 0.0)):
        life = gathered(stay)
        assert life.unlike_graph == 1.0 and life.short_stays == short
        assert not compare_groups({"floor": as_drawn, "other": life}).passed
    assert gathered(104.0).unlike_graph == 0.0  # waits for a successor
    nobody_leaves = gathered(500.0)
    assert nobody_leaves.stays == 0 and not compare_groups({"floor": nobody_leaves}).passed


def test_walks_through_a_group_count_as_long_as_they_last():
    moments = 3000
    x = np.full(moments, 9.0)
    x[1000:1400] = np.linspace(-4.0, 4.0, 400)  # 0.2 m/s through 1.4 m of o-space, while both are there
    through = gathered(200.0, np.stack([x, np.zeros(moments)], -1))
    assert through.intruded == pytest.approx(7.0 / 270.0, rel=0.1)
    beside = gathered(200.0, np.stack([x, np.full(moments, 0.75)], -1))
    assert beside.intruded == 0.0 and compare_groups({"floor": beside._replace(unlike_graph=0.0)}).passed
    stands = gathered(80.0, np.zeros((moments, 2)))
    assert stands.intruded == 1.0 and not compare_groups({"floor": stands}).passed


def test_who_is_stuck_at_a_robot_and_who_passes_a_door():
    assert longest_near(seen(there_and_back()), np.array([10.0, 0.5]), 1.0) == pytest.approx(1.8, abs=0.2)
    assert longest_near(seen(np.zeros((300, 2))), np.array([0.5, 0.0]), 1.0) == pytest.approx(30.0)
    ends = np.array([[5.05, -1.0], [5.05, 1.0]])
    walk = seen(there_and_back(seconds=30.0))
    assert passes(walk, *ends) == passes(walk, *ends[::-1]) == (2, 0)
    assert passes(walk, *(ends + [0.0, 2.0])) == (0, 0)
    assert passes(walk, *(ends + [6.0, 0.0])) == (0, 1)  # back after 8 s

    usual = DoorDraws([2.0] * 20, [10] * 20, [0] * 20)
    once = DoorDraws([2.0] * 19 + [30.0], [9] * 20, [0] * 20)
    assert compare_doors({"robot": once, "nobody": usual}).passed
    twice = DoorDraws([2.0] * 18 + [30.0] * 2, [9] * 20, [0] * 20)
    few, many = DoorDraws([2.0] * 20, [7] * 20, [0] * 20), DoorDraws([2.0] * 20, [13] * 20, [0] * 20)
    for draws in (twice, few, many):
        assert not compare_doors({"robot": draws, "nobody": usual}).passed


@pytest.mark.parametrize("name", ["eth", "hotel", "zara01"])
def test_recorded_people_are_as_published(recordings, name):
    tracks = read(recordings / "eth_ucy" / f"{name}.csv", None, None, STEP)
    position, present = np.asarray(tracks.position), np.asarray(tracks.present)
    values = liveliness(Observed(position, present, np.zeros_like(present), None, STEP))
    column = ["eth", "hotel", "zara01"].index(name)
    for measure, recorded in PUBLISHED["floors"]["recorded"].items():
        assert getattr(values, measure) == pytest.approx(recorded[column], abs=2e-3), measure
    for measure in ("half_turns", "acceleration_p95", "acceleration_p99", "turn_rate_p95"):
        assert getattr(values, measure) <= PUBLISHED["floors"]["limits"][measure]
