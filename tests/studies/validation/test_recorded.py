"""Whole scenes that are simulated again: their measures, against formulas in 64 bits and other algorithms."""

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import support.tracks
from sean_jax.people.intent import Intent
from sean_jax.people.recordings import Tracks
from sean_jax.studies.scenes import Gate, Scene, model, simulate, walkers
from sean_jax.studies.validation import recorded, streets
from sean_jax.studies.validation.checks import CheckContext, Skipped
from sean_jax.studies.validation.streets import NO_WALLS
from support.tracks import straight

street = support.tracks.street  # a fixture

STRAIGHT = Intent(speed_share=1.0, turn_time=0.0).average()
points = np.random.default_rng(3).normal(0.0, 2.0, (4, 6, 2))


def test_transport_is_the_best_of_all_assignments():
    one, other = points[0], points[1]
    costs = [np.square(one - other[list(order)]).sum(-1).mean() for order in itertools.permutations(range(6))]
    assert recorded.transport(one, other) == pytest.approx(min(costs))
    assert recorded.transport(one, one[::-1]) == 0.0


def test_discrepancy_is_the_mean_of_kernels():
    one, other = points[0], points[1, :4]
    both = [*one, *other]
    usual = np.mean([np.square(a - b).sum() for i, a in enumerate(both) for j, b in enumerate(both) if i != j])

    def kernel(left, right):
        widths = [usual / 4 * 2**k for k in range(5)]
        return np.mean([sum(np.exp(-np.square(a - b).sum() / each) for each in widths) for a in left for b in right])

    expected = kernel(one, one) + kernel(other, other) - 2.0 * kernel(one, other)
    assert recorded.discrepancy(one, other) == pytest.approx(expected)
    assert recorded.discrepancy(one, one[::-1]) == pytest.approx(0.0, abs=1e-12)
    assert recorded.discrepancy(one[:1], one[:1]) == 0.0


def test_warping_is_the_best_of_all_alignments():
    one, other = points[0, :4], points[1, :3]

    def least(i, j):
        if i < 0 or j < 0:
            return np.inf
        before = 0.0 if i == j == 0 else min(least(i - 1, j), least(i, j - 1), least(i - 1, j - 1))
        return np.linalg.norm(one[i] - other[j]) + before

    assert recorded.warping(one, other) == pytest.approx(least(3, 2))
    slow = np.repeat(one, 2, axis=0)
    assert recorded.warping(one, slow) == pytest.approx(0.0, abs=1e-12)


def test_errors_count_who_and_when_they_should():
    place = np.zeros((3, 3, 2))
    place[:, 1, 0], place[:, 2, 0] = 4.0, 8.0
    moved = place.copy()
    moved[:, 0, 0] += 0.3
    moved[:, 1, 0] = 8.2  # beside the third
    counted = np.array([[True, True, False], [True, True, True], [False, False, True]])
    own = recorded.errors(moved, place, counted)
    assert own.mae == pytest.approx((2 * 0.3 + 2 * 4.2) / 6)
    assert own.dtw == pytest.approx((0.3 + 4.2) / 3)
    assert own.collisions == pytest.approx(2 / 6)  # at one moment both count
    squares = [(0.09 + 4.2**2) / 2, (0.09 + 0.2**2 + 4.0**2) / 3]
    assert own.ot == pytest.approx(np.mean(squares))
    assert recorded.errors(place, place, counted) == (0.0, 0.0, pytest.approx(0.0, abs=1e-12), 0.0, 0.0)


def test_scenes_count_by_their_people():
    one, other = recorded.Errors(1.0, 1.0, 1.0, 1.0, 0.0), recorded.Errors(4.0, np.nan, 4.0, 4.0, 0.3)
    assert recorded.mean_errors([one, other], [2, 1]) == pytest.approx((2.0, 1.0, 2.0, 2.0, 0.1))


def test_who_has_left_stays_where_they_left():
    place = np.arange(9.0)[:, None, None] * np.ones((1, 2, 2))
    seconds = np.zeros((9, 2))
    rest: Any = place, seconds, seconds, seconds, seconds[:, 0]
    tracks = Tracks(place, *rest, time_step=0.1)  # pyright: ignore[reportArgumentType]
    assert recorded.positions(tracks, 5)[:, 0, 0].tolist() == [0.0, 4.0, 8.0, 8.0, 8.0]


@pytest.fixture
def without_intent(monkeypatch):
    """People keep the speed of their first 2 s, and turn to their goal at once."""
    monkeypatch.setattr(recorded, "INTENT", STRAIGHT)


def test_people_come_to_walk_as_usual(street):
    windows = [recorded.with_first_speeds(window) for window in streets.streets(street / "eth_ucy" / "made.csv")]
    (scene,) = recorded.intended_scenes(windows, replace(STRAIGHT, speed_share=0.6))
    np.testing.assert_allclose(scene.walkers.preferred_speed, [1.25, 1.25, 1.25 + 0.6 * 0.25], atol=1e-6)


def test_people_turn_to_their_gate_in_some_time():
    """From 1.2 m/s along x to a goal along y, as a loop over the steps has it."""
    gate = (Gate((-9.0, 30.0), (9.0, 30.0)),)
    people = walkers(np.zeros((1, 2)), route=(0,), speed=1.2, velocity=(1.2, 0.0))
    scene = Scene(NO_WALLS, people, gate, 4.0, intent=replace(STRAIGHT, turn_time=1.5))
    walked = np.asarray(simulate(scene, model("constant_velocity"))[0].position)[:, 0]
    place, direction = np.zeros(2), np.array([1.0, 0.0])
    for moment in walked[1:]:
        way = np.array([np.clip(place[0], -9.0, 9.0), 30.0]) - place
        direction = direction + 0.1 / 1.5 * (way / np.hypot(*way) - direction)
        direction = direction / np.hypot(*direction)
        place = place + 0.12 * direction
        np.testing.assert_allclose(moment, place, atol=0.02)
    assert place[0] > 1.0 and direction[1] > 0.8


def test_straight_walkers_are_where_they_were(street, without_intent):
    numbers = recorded.closed_loop(CheckContext(model(straight), quick=True, data=street)).numbers
    assert numbers["mae_made"] < 0.05 and numbers["dtw_made"] < 0.05 and numbers["mmd_made"] < 1e-3
    assert numbers["collisions_made"] == 0.0


def test_errors_of_constant_velocity_are_the_limit_in_every_scene():
    mark = recorded.Errors(0.5, 0.1, 0.02, 0.2, 0.0)
    far, unlike = mark._replace(mae=0.51), mark._replace(mmd=0.021)
    for own, passed in ((mark, True), (mark._replace(mae=0.4), True), (far, False), (unlike, False)):
        several = {"eth": mark, "hotel": own}
        none = dict.fromkeys(several, recorded.Differences(0.0, 0.0, 0.0))
        found = recorded.compare_errors(several, dict.fromkeys(several, mark), dict.fromkeys(several, 0.0), none)
        assert found.passed is passed and ("(not: hotel)" in found.reason) is not passed


def test_constant_velocity_is_as_near_as_itself(street, without_intent):
    found = recorded.closed_loop(CheckContext(model("constant_velocity"), quick=True, data=street))
    assert found.passed and found.numbers["mae_made"] == found.numbers["mae_constant_velocity_made"]


def test_people_of_a_clip_are_free_after_two_seconds(tmp_path):
    """Three people, one of whom turns after what is given; a fourth is there for too short a time."""
    (tmp_path / "grand_central").mkdir()
    lines = ["frame,id,x,y"]
    for frame in range(250):
        time = 0.08 * frame
        lines += [f"{frame},1,{1.2 * time:.4f},0", f"{frame},2,{30 - time:.4f},6"]
        lines.append(f"{frame},3,{min(time, 4.0):.4f},{12 + max(0.0, time - 4.0):.4f}")
        if frame < 30:
            lines.append(f"{frame},4,5,{-9 - time:.4f}")
    (tmp_path / "grand_central" / "made.csv").write_text("\n".join(lines) + "\n")

    street = recorded.clip(tmp_path / "grand_central" / "made.csv")
    assert street.present.shape[1] == 3 and street.present.argmax(0).tolist() == [5, 5, 5]
    np.testing.assert_allclose(street.speed, [1.2, 1.0, 1.0], atol=1e-2)
    np.testing.assert_allclose(street.velocity, [[1.2, 0.0], [-1.0, 0.0], [1.0, 0.0]], atol=1e-2)
    np.testing.assert_allclose(street.goal[2], [4.0, 12 + 0.08 * 249 - 4.0], atol=1e-3)

    numbers = recorded.clips(CheckContext(model("constant_velocity"), data=tmp_path)).numbers
    path = street.position[5:, 2]
    straight_way = street.position[5, 2] + np.linspace(0, 1, len(path))[:, None] * (path[-1] - street.position[5, 2])
    most = np.linalg.norm(path - straight_way, axis=-1).mean()
    assert 0.1 < numbers["mae_made"] <= most, "one of three goes round a corner"
    with pytest.raises(Skipped, match="grand_central"):
        recorded.clips(CheckContext(model("constant_velocity"), data=tmp_path / "grand_central"))


def test_distributions_differ_by_their_earth_movers_distance():
    step = 0.4 * np.arange(6.0)[:, None, None] * np.array([1.0, 0.0])
    place = step + np.array([[0.0, 0.0], [0.0, 10.0]])  # two people at 1 m/s
    both, first = np.ones((6, 2), bool), np.ones((6, 2), bool) & [True, False]
    known = [(place, both)]
    assert recorded.differences(known, known) == pytest.approx((0.0, 0.0, 0.0))
    assert recorded.differences([(place, first)], known) == pytest.approx((0.5, 0.01, 0.0))
    assert recorded.differences([(1.5 * place, both)], known).speed == pytest.approx(0.5)


def test_average_people_walk_without_noise_and_differences():
    scene = Scene(NO_WALLS, walkers(np.zeros((1, 2)), route=(0,), speed=1.3), (Gate((9.0, 1.0), (9.0, -1.0)),), 4.0)
    chosen = model("calibrated")
    alike = replace(chosen, move=recorded.Average(chosen.move))
    assert alike.move == recorded.Average(chosen.move)
    one, other = (simulate(replace(scene, seed=seed), alike)[0].position for seed in (0, 1))
    np.testing.assert_array_equal(one, other)
    np.testing.assert_allclose(one[-1, 0], [1.3 * 4.0, 0.0], atol=0.5)
    assert (simulate(scene, chosen)[0].position[:, 0, 1] != 0.0).any() and (one[:, 0, 1] == 0.0).all()


def test_whole_scenes_need_recordings(tmp_path):
    with pytest.raises(Skipped, match="--data"):
        recorded.closed_loop(CheckContext(model(straight)))
    with pytest.raises(Skipped, match="eth_ucy"):
        recorded.closed_loop(CheckContext(model(straight), data=tmp_path))
