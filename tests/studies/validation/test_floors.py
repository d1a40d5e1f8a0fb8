"""The measures of people on floors see what was put in, and recorded people are calm."""

import numpy as np
import pytest

from sean_jax.people.recordings.reading import read
from sean_jax.studies.validation.checks import PUBLISHED
from sean_jax.studies.validation.floor_measures import Observed, liveliness, used_cells

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
