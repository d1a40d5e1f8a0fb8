"""The measured rows of ``sean validate``, on models of which it is known what they must find, right or broken."""

import sys

import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import social_forces
from sean_jax.studies.prediction import Scores
from sean_jax.studies.scenes import model
from sean_jax.studies.validation import crowds, individuals
from sean_jax.studies.validation.checks import CHECKS, CheckContext, Skipped
from sean_jax.studies.validation.individuals import fitted_without
from sean_jax.studies.validation.measures import group_occupancy

AREA = crowds.PERIOD * crowds.WIDTH  # m2, of the corridor of the fundamental diagram


def moved(people, velocity, time_step):
    return people.replace(position=people.position + time_step * velocity, velocity=velocity)


def straight(scenario, state):
    """Walks on through everything."""
    people = state.pedestrians
    return moved(people, people.desired_velocity, scenario.time_step)


def shifted(scenario, state):
    """Walks on and to the right by 0.38 m/s."""
    people = state.pedestrians
    speed = jnp.sqrt((people.desired_velocity**2).sum(-1, keepdims=True) + 1e-12)
    right = people.desired_velocity[:, ::-1] * jnp.asarray([[1.0, -1.0]]) / speed
    return moved(people, people.desired_velocity + 0.38 * right, scenario.time_step)


def by_density(scenario, state):
    """Walks as fast as people in Juelich do at the density of everybody, who are there twice: with their images."""
    people = state.pedestrians
    density = people.present.astype(float).sum() / (2.0 * AREA)
    known = np.array([(rho, row[0]) for rho, row in crowds.JUELICH.items()])
    speed = jnp.interp(density, jnp.asarray(known[:, 0]), jnp.asarray(known[:, 1]))
    way = people.desired_velocity / people.preferred_speed[:, None]
    return moved(people, speed * way, scenario.time_step)


def in_lanes(scenario, state):
    """Walks to the right side of the corridor."""
    people = state.pedestrians
    along = people.desired_velocity[:, 0]
    side = jnp.where(along > 0.0, 0.25, 0.75) * crowds.LANE_WIDTH
    side = jnp.clip(side - people.position[:, 1], -0.3, 0.3)
    return moved(people, jnp.stack([along, side], -1), scenario.time_step)


def held_up(scenario, state):
    """Needs thrice the time in doors."""
    people = state.pedestrians
    near = jnp.abs(people.position[:, :1]) < 0.5
    return moved(people, people.desired_velocity * jnp.where(near, 1.0 / 3.0, 1.0), scenario.time_step)


def waiting(scenario, state):
    """Stays where it is."""
    return moved(state.pedestrians, jnp.zeros_like(state.pedestrians.velocity), scenario.time_step)


def context(function, **more):
    return CheckContext(model(function), quick=True, **more)


def test_speeds_of_juelich_pass_and_free_speeds_do_not():
    pytest.importorskip("pedpy")
    found = crowds.corridor_diagram(context(by_density))
    assert found.passed, found.reason
    for density, (speed, _, _) in list(crowds.JUELICH.items())[:5]:
        assert found.numbers[f"speed_{density:g}"] == pytest.approx(speed, rel=0.01)
        assert found.numbers[f"density_{density:g}"] == pytest.approx(density, rel=0.2)
    free = crowds.corridor_diagram(context(straight))
    assert not free.passed and "not falling" in free.measured
    assert free.numbers["speed_1"] == pytest.approx(1.55, abs=0.1)


def test_what_needs_pedpy_is_skipped_without(monkeypatch):
    monkeypatch.setitem(sys.modules, "pedpy", None)
    monkeypatch.setattr(CheckContext, "simulate", lambda *_: pytest.fail("nothing should be simulated first"))
    for check in (crowds.corridor_diagram, crowds.weidmann_diagram):
        with pytest.raises(Skipped, match="pip install"):
            check(context(straight))


def test_a_single_file_that_walks_freely_fails():
    found = crowds.single_file_diagram(context(straight))
    assert not found.passed and found.numbers["speed_1.875"] == pytest.approx(1.34, abs=0.08)


def test_lanes_pass_and_a_mix_does_not():
    found = crowds.lanes(context(in_lanes))
    assert found.passed and min(found.numbers.values()) > 0.99
    mixed = crowds.lanes(context(straight))
    assert not mixed.passed and max(mixed.numbers.values()) < 0.6


def test_doors_pass_whoever_walks_through_and_fail_who_slows_down_or_waits():
    assert crowds.doors(context(straight)).passed
    slow = crowds.doors(context(held_up))
    assert not slow.passed and slow.numbers["least_speed_1.2"] == pytest.approx(1.34 / 3, rel=1e-3)
    shy = crowds.doors(context(waiting))
    assert not shy.passed and not any(shy.numbers[f"through_{width:g}"] for width in crowds.DOORS)


def test_a_crowd_that_walks_through_itself_leaves_a_door_too_fast():
    found = crowds.bottleneck(context(straight))
    assert not found.passed and found.numbers["flow_0.8"] > 5.0


def test_pairs_who_walk_through_each_other_fail_and_who_turn_aside_pass():
    for name in ("pairs-head-on", "pairs-crossing"):
        broken, right = (CHECKS[name].run(context(moved_by)) for moved_by in (straight, shifted))
        assert not broken.passed and broken.numbers["gap"] == pytest.approx(-0.4, abs=1e-3)
        assert broken.numbers["overlapping"] == 1.0  # all would pass within 0.3 m, and bodies are 0.4 m wide
        assert right.passed and right.numbers["gap"] > 0.4


def test_a_robot_touches_whoever_does_not_give_way():
    broken = individuals.passing_a_robot(context(straight))
    assert not broken.passed
    assert broken.numbers["touched"] == pytest.approx(0.36 / individuals.MISS, abs=0.15)
    assert broken.numbers["clearance"] == pytest.approx(individuals.MISS / 2, abs=0.06)
    right = individuals.passing_a_robot(context(shifted))
    assert right.passed and right.numbers["touched"] < 0.05


def test_a_robot_in_a_stream_touches_as_many_as_geometry_says():
    """Of people whom it would miss by less than 0.6 m, if nobody gives way; across the seam of the stream as well."""
    broken = individuals.passing_in_a_stream(context(straight))
    assert not broken.passed
    assert broken.numbers["touched"] == pytest.approx(0.36 / individuals.MISS, abs=0.2)
    assert broken.numbers["clearance"] == pytest.approx(individuals.MISS / 2, abs=0.08)
    assert individuals.passing_in_a_stream(context(waiting)).numbers["clearance"] > 0.8


def test_predictions_pass_only_with_small_errors_in_every_scene_and_few_collisions():
    mark = {"one": Scores(0.5, 1.2, 0.04, 900), "two": Scores(0.3, 0.6, 0.02, 400)}
    good = {"one": Scores(0.49, 1.19, 0.0, 900), "two": Scores(0.3, 0.6, 0.0006, 400)}
    assert individuals.compare_scores(good, mark, mark).passed
    assert individuals.compare_scores(mark, mark, mark).reason  # as many collisions
    worse = good | {"two": Scores(0.2, 0.61, 0.0, 400)}
    found = individuals.compare_scores(worse, mark, mark)
    assert not found.passed and "worse: two" in found.reason
    slower = mark | {"one": Scores(0.48, 1.17, 0.04, 900)}  # the habit alone is better
    assert "worse: one" in individuals.compare_scores(good, mark, slower).reason


def test_prediction_needs_recordings(tmp_path):
    with pytest.raises(Skipped, match="--data"):
        individuals.prediction(context(straight))
    with pytest.raises(Skipped, match="eth_ucy"):
        individuals.prediction(context(straight, data=tmp_path))


def test_prediction_row_is_the_benchmark_of_recordings(recordings):
    found = individuals.prediction(context("constant_velocity", data=recordings))
    assert not found.passed and "worse: eth, hotel, zara01" in found.reason  # than constant velocity times 0.98
    assert found.numbers["ade_hotel"] == pytest.approx(0.323, abs=0.01)
    assert found.numbers["fde_hotel"] == pytest.approx(0.617, abs=0.01)


def test_a_scene_judges_constants_that_have_not_seen_it():
    forces = social_forces.preset("calibrated")
    for scene in ("eth", "hotel", "zara01"):
        others, habits = fitted_without(scene, forces)
        assert others.repulsion.strength != forces.repulsion.strength and others.headway == forces.headway
        assert 0.9 < habits["weights"][0] < 1.0 and 0.0 < habits["settled"] < 1.0
    assert fitted_without("univ", forces) is None  # nothing was fitted to it
    assert fitted_without("eth", forces.tree_replace({"repulsion.strength": 5.0})) is None
    assert fitted_without("eth", social_forces.preset("helbing1995")) is None


@pytest.mark.slow
def test_the_default_crowd_predicts_as_well_as_constant_velocity(recordings):
    """Without the habit of slowing down; with it, see docs/validation.md."""
    found = individuals.prediction(context("calibrated", data=recordings))
    for ours, mark in zip(found.curves[:2], found.curves[2:], strict=True):
        assert all(own <= other for own, other in zip(ours.y, mark.y, strict=True)), found.measured


def test_groups_pass_that_are_full_and_whose_members_change():
    """A group of two places for 160 s: one place is taken by 20 people in turn, the other by some of 20 more."""
    drawn = np.array([[5.0, 10.0]])

    def found(*seats):
        group = np.full((1600, 20 * len(seats)), -1)
        for k, times in enumerate(seats):
            for number, (begin, end) in enumerate(times):
                group[begin:end, 20 * k + number] = 0
        return individuals.compare_occupancy({"here": (group_occupancy(group, np.array([2]), 0.1, warm_up=0.0), drawn)})

    stays = [(k, k + 80) for k in range(0, 1600, 80)]
    right = found(stays, [(begin + 15, end) for begin, end in stays])
    assert right.passed and right.numbers["full_here 1"] == pytest.approx(65 / 80)
    assert right.numbers["stay_here 1"] == pytest.approx(7.2, abs=0.1)
    assert not found(stays, [(begin + 45, end) for begin, end in stays]).passed  # seldom full
    assert not found([(0, 1600)], [(20, 1590)]).passed  # nobody comes and goes
    short = [(begin, begin + 40) for begin, _ in stays], [(begin + 40, end) for begin, end in stays]
    assert not found(*short, *short).passed  # full, but they leave too soon


def test_weidmann_is_a_formula_of_its_own():
    density = np.array([0.5, 1.0, 2.0, 3.0, 4.0, 5.0])
    known = [1.298, 1.058, 0.606, 0.331, 0.156, 0.037]  # of the printed table
    np.testing.assert_allclose(crowds.weidmann(density), known, atol=2e-3)
    assert crowds.weidmann(5.4) == pytest.approx(0.0, abs=1e-9)
