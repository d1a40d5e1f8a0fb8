"""The measured rows of ``sean validate``, on models of which it is known what they must find, right or broken."""

import sys

import jax.numpy as jnp
import numpy as np
import pytest

import support.tracks
from sean_jax import social_forces
from sean_jax.studies.prediction import HABITS, Scores, predict
from sean_jax.studies.scenes import model
from sean_jax.studies.validation import crowds, doors, groups, individuals, streets
from sean_jax.studies.validation.checks import CHECKS, CheckContext, Skipped
from sean_jax.studies.validation.groups import group_occupancy
from sean_jax.studies.validation.individuals import fitted_without
from sean_jax.studies.validation.measures import Motion, accelerations, motion
from support.tracks import moved, straight

street = support.tracks.street  # a fixture

AREA = crowds.PERIOD * crowds.WIDTH  # m2, of the corridor of the fundamental diagram


def shifted(scenario, state):
    """Walks on and to the right by 0.38 m/s."""
    people = state.pedestrians
    speed = jnp.sqrt((people.desired_velocity**2).sum(-1, keepdims=True) + 1e-12)
    right = people.desired_velocity[:, ::-1] * jnp.asarray([[1.0, -1.0]]) / speed
    return moved(people, people.desired_velocity + 0.38 * right, scenario.time_step)


def by_density(spread):
    """Walks as fast as people in Juelich do at the density of everybody, faster and slower by turns in 5 s.

    Speeds spread so many times as much as theirs. People are there twice: with their images.
    """

    def walks(scenario, state):
        people = state.pedestrians
        density = people.present.astype(float).sum() / (2.0 * AREA)
        speed, low, high = (
            jnp.interp(density, jnp.asarray([*known]), jnp.asarray([*known.values()]))
            for known in (crowds.JUELICH[what] for what in ("speed", "percentile_10", "percentile_90"))
        )
        phase = 2.0 * jnp.pi * state.tick.astype(float) * scenario.time_step / 5.0
        speed = speed + spread * (high - low) / 1.8 * jnp.sin(phase)
        way = people.desired_velocity / people.preferred_speed[:, None]
        return moved(people, speed * way, scenario.time_step)

    return walks


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


def test_speeds_of_juelich_pass_and_free_speeds_do_not(monkeypatch):
    pytest.importorskip("pedpy")
    monkeypatch.setattr(crowds, "FEW", (0.5, 1.0, 1.5))
    found = crowds.corridor_diagram(context(by_density(1.0)))
    assert found.passed, found.reason
    monkeypatch.setattr(crowds, "FEW", (1.0, 1.5))
    for spread in (0.5, 2.0):  # means are the same
        other = crowds.corridor_diagram(context(by_density(spread)))
        assert not other.passed and other.numbers["speed_1"] == pytest.approx(crowds.juelich([1.0])[0], rel=0.01)
    for density in crowds.FEW:
        assert found.numbers[f"speed_{density:g}"] == pytest.approx(crowds.juelich([density])[0], rel=0.01)
        assert found.numbers[f"density_{density:g}"] == pytest.approx(density, rel=0.2)
    assert found.numbers["rows_2"] == pytest.approx(1.0, abs=0.01)
    free = crowds.corridor_diagram(context(straight))
    assert not free.passed and "not falling" in free.measured
    assert free.numbers["speed_1"] == pytest.approx(1.55, abs=0.1)


def test_densities_and_interpolated_speeds_of_juelich():
    assert crowds.DENSITIES == tuple(np.arange(0.5, 3.75, 0.25)) and crowds.DRAWS >= 10
    expected = crowds.juelich(crowds.DENSITIES)
    assert (np.diff(expected) < 0.0).all() and expected[1] == pytest.approx((1.376 + 1.254) / 2)
    assert crowds.juelich([2.0], "percentile_90") > crowds.juelich([2.0]) > crowds.juelich([2.0], "percentile_10")


def test_an_interval_holds_the_mean_of_draws_as_often_as_it_says():
    values = np.full((1, 10, 3, 2), 1.0)
    inside = []
    for seed in range(400):
        values[0, :, :, 1] = np.random.default_rng(seed).normal(1.0, 0.1, (10, 1))
        made = crowds.compare(values, (1.0,), np.ones(1), 0.5, []).numbers
        inside.append(abs(made["speed_1"] - 1.0) <= made["interval_1"])
    assert np.mean(inside) == pytest.approx(0.95, abs=0.04)


def test_straight_rows_have_their_number_and_density():
    for rows in crowds.ROWS:
        start = np.asarray(crowds.in_rows(rows, 1.0, 0).walkers.start)
        assert len(np.unique(start[:, 1])) == rows
        assert len(start) == round(crowds.ROWS_DENSITY * AREA)
        gap = np.linalg.norm(start[:, None] - start[None], axis=-1) + 9 * np.eye(len(start))
        assert gap.min() > 0.42


def test_speeds_that_change_as_recorded_pass_and_a_lattice_does_not():
    def in_waves(delayed):
        def swinging(scenario, state):
            """Slows down and speeds up by turns in about 8 s, as much as is recorded at their density.

            Everybody does what the one in front did, a share of the recorded delay ago.
            """
            people = state.pedestrians
            number = people.present.astype(float).sum() / 2.0  # with their images
            table = jnp.asarray([[number, *row] for number, row in crowds.WAVES.items()])
            mean, deviation, delay = (jnp.interp(number, table[:, 0], table[:, k]) for k in (1, 2, 3))
            rank = (jnp.arange(len(people.present)) % number.astype(jnp.int32)).astype(float)
            period = delay * number / jnp.round(delay * number / 8.0)  # of whole waves around the loop
            phase = 2.0 * jnp.pi * (state.tick.astype(float) * scenario.time_step + delayed * delay * rank) / period
            speed = mean + jnp.sqrt(2.0) * deviation * jnp.sin(phase)
            way = people.desired_velocity / people.preferred_speed[:, None]
            return moved(people, speed[:, None] * way, scenario.time_step)

        return swinging

    found = crowds.stop_and_go(context(in_waves(1.0)))
    assert found.passed, found.measured
    assert found.numbers["deviation_40"] == pytest.approx(0.141, rel=0.05)
    assert found.numbers["speed_40"] == pytest.approx(0.442, rel=0.05)
    assert found.numbers["wave_40"] == pytest.approx(0.09, abs=0.05)
    together = crowds.stop_and_go(context(in_waves(0.0)))  # without a wave from one to the next
    assert not together.passed and together.numbers["deviation_40"] == pytest.approx(0.141, rel=0.05)
    lattice = crowds.stop_and_go(context(straight))
    assert not lattice.passed and "no wave" in lattice.measured


def test_draws_without_a_wave_do_not_count_in_the_wave_of_the_others(monkeypatch):
    def stop_and_go(still, late=1.0):
        """The check on the recorded motions; draws of these indices have no wave, delays are so many times as long."""
        draws = iter([draw for _ in crowds.WAVES for draw in range(4)])

        def file_motion(scene):
            speed, deviation, delay, wave = crowds.WAVES[len(scene.walkers.start)]
            draw = next(draws)
            moved = [np.nan] * 3 if draw in still else [0.5, late * delay + 0.1 * draw, wave]
            return np.full((5, 3), speed), crowds.FileMotion(speed, deviation, *moved)

        monkeypatch.setattr(CheckContext, "simulate", lambda self, scenes, captions: scenes)
        monkeypatch.setattr(crowds, "_file_motion", file_motion)
        return crowds.stop_and_go(CheckContext(model(straight)))

    found = stop_and_go({1})
    assert found.passed, found.measured
    assert found.measured.count("in 3 of 4 draws") == len(crowds.WAVES)
    assert found.numbers["wave_45"] == pytest.approx(crowds.WAVES[45][3])
    assert found.numbers["delay_45"] == pytest.approx(crowds.WAVES[45][2] + 0.1 * (0 + 2 + 3) / 3)

    for late in (0.5, 1.4):
        assert not stop_and_go(set(), late).passed
    everywhere, nowhere = stop_and_go(set()), stop_and_go({0, 1, 2, 3})
    assert everywhere.passed and "draws" not in everywhere.measured
    assert not nowhere.passed and "no wave in all draws" in nowhere.measured and np.isnan(nowhere.numbers["wave_45"])


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
    orders = [found.numbers[f"order_{density:g}"] for density in crowds.LANE_DENSITIES]
    assert found.passed and min(orders) > 0.99
    assert 0.0 < found.numbers["time_1"] < 20.0
    mixed = crowds.lanes(context(straight))
    assert not mixed.passed and max(mixed.numbers[f"order_{density:g}"] for density in crowds.LANE_DENSITIES) < 0.6
    assert np.isinf(mixed.numbers["time_1"])


def test_order_is_reached_when_it_stays():
    order = np.where(np.arange(600) < 300, 0.5, 0.95)
    order[100] = 1.0  # a moment alone does not count
    # 5 s in a row have a mean of .9 if .5 s of them are before the change.
    assert crowds.time_until(order, 0.9) == pytest.approx(29.5)
    order[200:245] = 1.0  # 4.5 s are no 5 s, with .5 before and after
    assert crowds.time_until(order, 0.96) == np.inf and crowds.time_until(order, 0.95) == pytest.approx(20.0 - 0.5)
    assert np.isinf(crowds.time_until(order, 0.96))


def test_doors_pass_whoever_walks_through_and_fail_who_slows_down_or_waits():
    assert doors.doors(context(straight)).passed
    slow = doors.doors(context(held_up))
    assert not slow.passed and slow.numbers["least_speed_1.2"] == pytest.approx(1.34 / 3, rel=1e-3)
    shy = doors.doors(context(waiting))
    assert not shy.passed and not any(shy.numbers[f"through_{width:g}"] for width in doors.DOORS)


def test_a_crowd_that_walks_through_itself_leaves_a_door_too_fast():
    found = doors.bottleneck(context(straight))
    assert not found.passed and found.numbers["flow_0.2_0.8"] > 5.0 and found.numbers["inside_2.8_0.8"] == 0.0
    stuck = doors.bottleneck(context(waiting))
    assert not stuck.passed and stuck.numbers["inside_2.8_0.8"] == 100.0 and stuck.numbers["flow_0.2_0.8"] == 0.0


def test_a_crowd_that_walks_through_itself_overlaps_and_does_not_saturate():
    found = doors.press(context(straight))
    assert not found.passed and found.numbers["overlap_1.34"] > 0.3
    assert found.numbers["flow_4"] == pytest.approx(found.numbers["flow_2"] * 2.0, rel=0.05)
    assert not doors.press(context(waiting)).passed


def test_a_passage_has_its_length_and_a_large_crowd_its_density():
    scene = doors.before_door(1.0, np.zeros((1, 2)), 1.0, 9.0, passage=2.8)
    in_passage = [(0.1, 0.0), (2.7, 0.45)]
    in_walls = [(0.1, 0.6), (2.7, -0.6)]

    def walled(place):
        gap = np.abs(np.asarray(scene.walls)[:, :2] - place)
        return bool((gap <= np.asarray(scene.walls)[:, 2:4]).all(1).any())

    assert not any(map(walled, in_passage)) and all(map(walled, in_walls)) and not walled((2.9, 0.6))
    start = np.asarray(doors.crowd_before_bottleneck(350, 2.4).walkers.start)
    reach = np.hypot(*start.T).max()
    assert len(start) == 350 and (start[:, 0] < 0.0).all()
    assert 350 / (0.5 * np.pi * reach**2) == pytest.approx(3.0, rel=0.06)


def test_pairs_who_walk_through_each_other_fail_and_who_turn_aside_pass():
    for name in ("pairs-head-on", "pairs-crossing"):
        broken, right = (CHECKS[name].run(context(moved_by)) for moved_by in (straight, shifted))
        assert not broken.passed and broken.numbers["gap"] == pytest.approx(-0.4, abs=1e-3)
        assert broken.numbers["overlapping"] == 1.0  # all would pass within 0.3 m, and bodies are 0.4 m wide
        assert right.passed and right.numbers["gap"] > 0.4


def test_a_robot_touches_whoever_does_not_give_way():
    broken = CHECKS["passing-robot"].run(context(straight))
    assert not broken.passed
    assert broken.numbers["touched"] == pytest.approx(0.36 / individuals.MISS, abs=0.15)
    assert broken.numbers["clearance"] == pytest.approx(individuals.MISS / 2, abs=0.06)
    assert CHECKS["passing-robot"].run(context(shifted)).numbers["touched"] < 0.05


def test_people_have_to_slow_down_for_a_robot_that_comes_at_them_but_not_to_stop():
    def braking(share):
        def walk(scenario, state):
            away = jnp.linalg.norm(state.pedestrians.position - state.robot.position[None], axis=-1)
            stepped = shifted(scenario, state)
            speed = jnp.where(away < 2.5, share, 1.0)[:, None]
            return moved(state.pedestrians, speed * stepped.velocity, scenario.time_step)

        return walk

    found = {share: CHECKS["approached"].run(context(braking(share))) for share in (1.0, 0.8, 0.3)}
    assert [one.passed for one in found.values()] == [False, True, False]
    for share, one in found.items():
        assert one.numbers["slowest"] == pytest.approx(share, abs=0.01) and one.numbers["touched"] < 0.02
    broken = CHECKS["approached"].run(context(straight))
    assert not broken.passed and broken.numbers["touched"] == pytest.approx(0.36 / individuals.MISS, abs=0.15)


def test_clearances_pass_with_the_mean_and_the_spread_of_people():
    limits = CHECKS["passing-robot"].arguments
    usual = np.random.default_rng(4).normal(0.83, 0.26, 4000).clip(0.4)

    def passed(nearest):
        return individuals.compare_clearance(context(straight), nearest, **limits).passed

    assert passed(usual)
    assert (
        not passed(usual + 0.15) and not passed(0.83 + 0.3 * (usual - 0.83)) and not passed(0.83 + 2 * (usual - 0.83))
    )
    touching = np.where(np.arange(4000) % 20 == 0, 0.2, usual)  # in 5 %
    assert not passed(touching)


def test_a_robot_in_a_stream_touches_as_many_as_geometry_says():
    """Of people whom it would miss by less than 0.6 m, if nobody gives way; across the seam of the stream as well."""
    check = CHECKS["passing-robot-stream"]
    broken = check.run(context(straight))
    assert not broken.passed
    assert broken.numbers["touched"] == pytest.approx(0.36 / individuals.MISS, abs=0.2)
    assert broken.numbers["clearance"] == pytest.approx(individuals.MISS / 2, abs=0.08)
    assert check.run(context(waiting)).numbers["clearance"] > 0.8


def test_predictions_pass_only_two_percent_better_in_every_scene_with_few_collisions():
    mark = {"one": Scores(0.5, 1.2, 0.04, 900), "two": Scores(0.3, 0.6, 0.02, 400)}
    good = {"one": Scores(0.489, 1.19, 0.0, 900), "two": Scores(0.29, 0.6, 0.0006, 400)}
    assert individuals.compare_scores(good, mark, mark).passed
    assert individuals.compare_scores(mark, mark, mark).reason  # as many collisions
    for worse in (Scores(0.2, 0.61, 0.0, 400), Scores(0.297, 0.5, 0.0, 400)):
        found = individuals.compare_scores(good | {"two": worse}, mark, mark)
        assert not found.passed and "(not: two)" in found.reason
    habits = mark | {"one": Scores(0.48, 1.17, 0.04, 900)}  # constant velocity with the same habits is as good
    found = individuals.compare_scores(good, habits, mark)
    assert "(not: one)" in found.reason and "without 0.500/1.200" in found.measured


def test_prediction_needs_recordings(tmp_path):
    with pytest.raises(Skipped, match="--data"):
        individuals.prediction(context(straight))
    with pytest.raises(Skipped, match="eth_ucy"):
        individuals.prediction(context(straight, data=tmp_path))


def test_prediction_row_is_the_benchmark_of_recordings(recordings):
    found = individuals.prediction(context("constant_velocity", data=recordings))
    assert not found.passed and "(not: eth, hotel, zara01)" in found.reason  # it is not better than itself
    assert found.numbers["ade_hotel"] == pytest.approx(0.323, abs=0.01)
    assert found.numbers["fde_hotel"] == pytest.approx(0.617, abs=0.01)


def test_a_scene_judges_constants_that_have_not_seen_it():
    forces = social_forces.preset("calibrated")
    for scene in ("eth", "hotel", "zara01"):
        others, habits = fitted_without(scene, forces)
        assert others.repulsion.strength != forces.repulsion.strength and others.cohesion == forces.cohesion
        assert 0.9 < habits["weights"][0] < 1.0 and 0.0 < habits["settled"] < 1.0
    assert fitted_without("univ", forces) == (forces, HABITS)  # nothing was fitted to it
    for other in (forces.tree_replace({"repulsion.strength": 5.0}), social_forces.preset("helbing1995")):
        same, habits = fitted_without("eth", other)
        assert same is other and habits["weights"] != HABITS["weights"]  # habits have not seen it either


def test_constant_velocity_has_the_habits_of_the_model(recordings, tmp_path):
    (tmp_path / "eth_ucy").mkdir()
    (tmp_path / "eth_ucy" / "hotel.csv").symlink_to(recordings / "eth_ucy" / "hotel.csv")
    asked = []

    def evaluated(mover, windows, **options):
        asked.append((mover, options.get("weights")))
        return Scores(1.0, 1.0, 0.0, 1)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(individuals, "evaluate", evaluated)
        individuals.prediction(context("calibrated", data=tmp_path))
        individuals.prediction(context(straight, data=tmp_path))
        individuals.prediction(context("helbing1995", data=tmp_path))
    weights = fitted_without("hotel", social_forces.preset("calibrated"))[1]["weights"]
    assert [each for _, each in asked[:3]] == [weights, None, weights]
    assert asked[2][0] is individuals.with_companions  # `calibrated` walks at the companions' mean
    assert [each for _, each in asked[3:6]] == [None] * 3  # a function has no habits
    assert asked[5][0] == asked[8][0] == "constant_velocity"  # nor have others the companions' mean


def test_constant_velocity_walks_at_the_mean_velocity_of_companions():
    start = np.array([[0.0, 0.0], [0.0, 0.8], [5.0, 5.0]])
    velocity = np.array([[1.15, 0.05], [1.05, -0.05], [0.0, 1.3]])
    observed = start + 0.4 * np.arange(8)[:, None, None] * velocity
    predicted = predict(individuals.with_companions, observed, 0.4, 3)
    mean = np.array([[1.1, 0.0], [1.1, 0.0], [0.0, 1.3]])
    expected = observed[-1] + 0.4 * np.arange(1, 4)[:, None, None] * mean
    np.testing.assert_allclose(predicted, expected, atol=1e-4)


@pytest.mark.slow
def test_the_default_crowd_predicts_as_well_as_constant_velocity(recordings):
    """With all habits; 2 % better is the gate, see docs/validation.md."""
    numbers = individuals.prediction(context("calibrated", data=recordings)).numbers
    for scene in ("eth", "hotel", "zara01"):
        assert numbers[f"ade_{scene}"] <= 1.001 * numbers[f"ade_constant_velocity_{scene}"], scene


def test_groups_pass_that_are_full_and_whose_members_change():
    """A group of two places for 160 s: one place is taken by 20 people in turn, the other by some of 20 more."""
    drawn = np.array([[5.0, 10.0]])

    def found(*seats):
        group = np.full((1600, 20 * len(seats)), -1)
        for k, times in enumerate(seats):
            for number, (begin, end) in enumerate(times):
                group[begin:end, 20 * k + number] = 0
        return groups.compare_occupancy({"here": (group_occupancy(group, np.array([2]), 0.1, warm_up=0.0), drawn)})

    stays = [(k, k + 80) for k in range(0, 1600, 80)]
    right = found(stays, [(begin + 15, end) for begin, end in stays])
    assert right.passed and right.numbers["full_here 1"] == pytest.approx(65 / 80)
    assert right.numbers["stay_here 1"] == pytest.approx(7.2, abs=0.1)
    assert not found(stays, [(begin + 45, end) for begin, end in stays]).passed  # seldom full
    assert not found([(0, 1600)], [(20, 1590)]).passed  # nobody comes and goes
    short = [(begin, begin + 40) for begin, _ in stays], [(begin + 40, end) for begin, end in stays]
    assert not found(*short, *short).passed  # full, but they leave too soon


def test_accelerations_are_of_each_person_and_control_step():
    velocity = np.zeros((2, 10, 3, 2))
    velocity[1, 5:, 2] = [0.6, 0.8]
    made = accelerations(velocity, 0.1)
    assert made.shape == (2, 9, 3) and made[1, 4, 2] == pytest.approx(10.0) and made.sum() == pytest.approx(10.0)


def test_a_street_has_who_walks_where_they_enter_and_with_whom(street):
    (window,) = streets.streets(street / "eth_ucy" / "made.csv")
    assert window.present.sum(0).tolist() == [40, 40, 30]  # who stands is left out
    np.testing.assert_allclose(window.speed, [1.25, 1.25, 1.5], rtol=1e-6)
    assert window.pairs().tolist() == [[0, 1]]
    scene = streets.walked_again(window)
    people = scene.walkers
    np.testing.assert_allclose(people.entry_time, [0.0, 0.0, 4.0], atol=1e-6)
    np.testing.assert_allclose(people.velocity, [[1.25, 0.0], [1.25, 0.0], [-1.5, 0.0]], atol=1e-5)
    assert people.companion.tolist() == [[-1, 1], [0, -1], [-1, -1]]
    for gate, goal in zip(scene.gates, window.goal, strict=True):
        np.testing.assert_allclose(np.mean(gate, axis=0), goal, atol=1e-9)


def test_a_street_of_straight_walkers_is_walked_again_by_straight_walkers(street):
    found = streets.walk_again(context(straight, data=street))
    numbers = found.numbers
    assert numbers["spacing_made"] == pytest.approx(0.8, abs=0.03) == numbers["spacing_made_recorded"]
    assert numbers["beside_made"] == numbers["beside_made_recorded"] == 1.0
    assert numbers["sideways_made"] < 0.02 and numbers["slowest_made"] == pytest.approx(1.0, abs=0.01)


def test_recorded_and_simulated_motion_is_smoothed_alike():
    """Errors of positions that differ from moment to moment hardly count, on whichever side they are."""
    time = 0.4 * np.arange(150)
    place = np.stack([1.3 * time, 0.3 * np.sin(0.5 * time)], -1)[:, None]
    rough = place + np.random.default_rng(0).normal(0.0, 0.03, place.shape)
    there, nobody = np.ones((150, 1), bool), np.zeros((0, 2), int)
    known, seen = (streets.summary(streets.measure([(each, there, nobody)])) for each in (place, rough))
    plain = np.quantile(motion(rough, there, 0.4).acceleration, 0.95)
    assert known["acceleration"] == pytest.approx(0.3 * 0.5**2, rel=0.1)
    assert seen["acceleration"] < 0.5 * plain


def test_motion_passes_near_the_recording_only():
    def walk(size):
        values = np.abs(np.random.default_rng(0).normal(0.0, 1.0, 2000))
        rest = np.ones(5)
        return streets.Walk(Motion(size * values, size * values, size * values), rest, rest, rest, rest > 0)

    def compared(*sizes):
        return streets.compare_walks({f"{k}": (walk(1.0), walk(size)) for k, size in enumerate(sizes)})

    assert compared(1.2).passed and compared(0.8).passed and compared(0.5, 1.9).passed
    assert not compared(1.3).passed and not compared(0.7).passed
    assert compared(0.7).numbers["ratio_jerk"] == pytest.approx(0.7)


def test_motion_needs_recordings(tmp_path):
    with pytest.raises(Skipped, match="--data"):
        streets.walk_again(context(straight))
    with pytest.raises(Skipped, match="eth_ucy"):
        streets.walk_again(context(straight, data=tmp_path))


def test_weidmann_is_a_formula_of_its_own():
    density = np.array([0.5, 1.0, 2.0, 3.0, 4.0, 5.0])
    known = [1.298, 1.058, 0.606, 0.331, 0.156, 0.037]  # of the printed table
    np.testing.assert_allclose(crowds.weidmann(density), known, atol=2e-3)
    assert crowds.weidmann(5.4) == pytest.approx(0.0, abs=1e-9)
