"""What is measured of tracks, against closed forms, loops, and figures published of recordings."""

import csv
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import preset
from sean_jax.people import recordings as recorded
from sean_jax.studies.scenes import Gate
from sean_jax.studies.validation import crowds, measures
from sean_jax.studies.validation.crowds import recorded_order
from sean_jax.studies.validation.measures import crossing_times, flow, smoothed
from support.tracks import tracks_of

DOOR = Gate((0.0, 0.6), (0.0, -0.6))  # crossed along +x


def walkers(start, velocity, rows=81, step=0.1):
    """(T, N, 2) of people who walk straight on."""
    time = step * np.arange(rows)[:, None, None]
    return np.asarray(start, float) + time * np.asarray(velocity, float)


def test_crossings_are_counted_one_way_and_between_moments():
    rng = np.random.default_rng(0)
    start = rng.uniform([-4, -0.3], [1, 0.3], (300, 2))
    velocity = rng.uniform([-1, -0.02], [2, 0.02], (300, 2))
    position = walkers(start, velocity)
    when = -start[:, 0] / velocity[:, 0]
    through = (velocity[:, 0] > 0) & (start[:, 0] <= 0) & (when < 8)
    assert 50 < through.sum() < 250
    times = crossing_times(tracks_of(position), DOOR)
    np.testing.assert_allclose(times, np.where(through, when, np.inf), atol=1e-6)
    mirrored = crossing_times(tracks_of(position * [-1, 1]), Gate(*DOOR[::-1]))
    np.testing.assert_allclose(mirrored, times, atol=1e-6)
    away = crossing_times(tracks_of(position + [0.0, 5.0]), DOOR)
    assert np.isinf(away).all()


def test_flow_is_that_of_the_middle_of_the_crossings():
    steady = 3.0 + 0.4 * np.arange(101)
    assert flow(steady) == pytest.approx(2.5)
    late = steady.copy()
    late[:15], late[90:] = 1.0, late[90:] + 20.0  # a rush at first and stragglers at last do not count
    assert flow(late) == pytest.approx(2.5)
    assert flow(np.append(late, np.inf)) == pytest.approx(2.5)


def test_lanes_are_in_order_and_a_random_mix_is_not():
    rng = np.random.default_rng(1)
    direction = np.where(rng.random(60) < 0.5, 1.0, -1.0)
    present = rng.random((40, 60)) < 0.8
    mixed = rng.uniform(0, 3.6, (40, 60))
    lanes = np.where(direction > 0, rng.uniform(0, 1.6, (40, 60)), rng.uniform(2.0, 3.6, (40, 60)))
    np.testing.assert_allclose(measures.lane_order(lanes, direction, present), 1.0)
    order = measures.lane_order(mixed, direction, present)
    for t in (0, 17, 39):
        own = []
        for i in np.flatnonzero(present[t]):
            near = [j for j in np.flatnonzero(present[t]) if abs(mixed[t, i] - mixed[t, j]) < 0.3]
            same = sum(direction[j] == direction[i] for j in near)
            own.append(((2 * same - len(near)) / len(near)) ** 2)
        assert order[t] == pytest.approx(np.mean(own))
    assert 0.02 < order.mean() < 0.3
    assert np.isnan(measures.lane_order(mixed[:1], direction, present[:1] & False)).all()


def test_separation_is_exact_between_rows():
    rng = np.random.default_rng(2)
    start, velocity = rng.normal(0, 3, (2, 200, 2)), rng.normal(0, 1.3, (2, 200, 2))
    one, other = walkers(start[0], velocity[0], 9, 1.0), walkers(start[1], velocity[1], 9, 1.0)
    gap, drift = start[0] - start[1], velocity[0] - velocity[1]
    when = np.clip(-(gap * drift).sum(-1) / (drift**2).sum(-1), 0.0, 8.0)
    exact = np.hypot(*(gap + when[:, None] * drift).T)
    np.testing.assert_allclose(measures.separation(one, other), exact, atol=1e-9)
    at_rows = np.hypot(*np.moveaxis(one - other, -1, 0)).min(0)
    assert (at_rows > exact + 0.1).mean() > 0.1  # rows alone would miss many of these encounters
    np.testing.assert_array_equal(measures.separation(one, one), 0.0)


def test_arrays_of_jax_are_measured_as_those_of_numpy():
    random = np.random.default_rng(0)
    place = np.cumsum(random.normal(0.1, 0.05, (30, 7, 2)), axis=0).astype(np.float32)
    present = random.random((30, 7)) < 0.8
    facing = np.broadcast_to(np.array([0.6, 0.8], np.float32), place.shape)
    direction = np.where(np.arange(7) < 3, 1.0, -1.0).astype(np.float32)
    bodies = preset("calibrated").walking
    calls = {
        measures.lane_order: (place[..., 1], direction, present),
        measures.separation: (place, place[:, ::-1] + np.float32(0.5)),
        measures.deviation_in_time: (place[..., 0],),
        functools.partial(measures.steps_along, period=2.0): (place[..., 0] % np.float32(2.0),),
        functools.partial(measures.accelerations, time_step=0.1): (place,),
        functools.partial(measures.densities, lower=(0.5, 0.5), upper=(2.0, 2.0)): (place, present),
        functools.partial(measures.body_gaps, walking=bodies): (place, facing, present),
    }
    for function, arrays in calls.items():
        by_numpy, by_jax = function(*arrays), jax.jit(function)(*map(jnp.asarray, arrays))
        assert not isinstance(by_numpy, jax.Array) and isinstance(by_jax, jax.Array)
        np.testing.assert_allclose(by_jax, by_numpy, rtol=1e-5, atol=1e-5)


def test_bodies_overlap_by_a_known_depth_and_only_in_one_group_if_asked():
    """Discs of .2 m; then shoulders of .2 m, and .1 m from back to front."""
    discs, bodies = (preset("calibrated").tree_replace({"walking.depth": depth}).walking for depth in (0.2, 0.1))
    place, facing = np.zeros((3000, 4, 2)), np.zeros((3000, 4, 2))
    place[:, :, 0], facing[..., 0] = [0.0, 1.0, 2.0, 3.0], 1.0
    present = np.ones((3000, 4), bool)
    assert measures.overlap(place, facing, present, discs) == 0.0
    place[1234, 1, 0] = 0.37  # 3 cm into the first
    place[2345, 2, 0] = 2.65  # 5 cm into the last
    assert measures.overlap(place, facing, present, discs) == pytest.approx(0.05, abs=1e-6)
    group = np.broadcast_to([0, 0, 1, -1], present.shape)
    assert measures.overlap(place, facing, present, discs, group) == pytest.approx(0.03, abs=1e-6)
    assert measures.overlap(place, facing, present, bodies) == 0.0  # one behind the other
    aside = facing[..., ::-1]
    assert measures.overlap(place, aside, present, bodies) == pytest.approx(0.05, abs=1e-6)


def test_densities_count_people_in_a_square_and_a_peak_is_a_mean():
    place = np.zeros((100, 8, 2))
    place[:40, 2:] = 9.0  # two people in the square at first, then all
    density = measures.densities(place, np.ones(place.shape[:2], bool), (-1.0, -1.0), (1.0, 1.0))
    np.testing.assert_allclose(density, np.where(np.arange(100) < 40, 0.5, 2.0))
    assert measures.peak(density, 20) == pytest.approx(2.0)
    assert measures.peak(density, 80) == pytest.approx((60 * 2.0 + 20 * 0.5) / 80)
    assert measures.peak(density, 500) == pytest.approx(density.mean())


def test_a_lattice_has_no_deviation_in_time_and_no_wave():
    speed = np.broadcast_to(np.linspace(0.3, 0.5, 20), (150, 20))  # each has an own speed that stays
    assert measures.deviation_in_time(speed) == pytest.approx(0.0, abs=1e-12)
    assert np.isnan(measures.wave(speed, 20.0, 0.4)).all()
    swing = 0.4 + 0.1 * np.sin(np.arange(1000) / 10.0)[:, None] * np.ones(20)
    assert measures.deviation_in_time(swing) == pytest.approx(0.1 / np.sqrt(2.0), rel=0.02)


@pytest.mark.parametrize("backwards", [-0.5, -0.2, 0.1])
def test_a_wave_in_a_single_file_has_its_speed(backwards):
    """Speeds by the place in a wave of one length around the loop."""
    loop, number, step = 25.0, 40, 0.02
    x, rows = np.arange(number) * loop / number, []
    for k in range(6000):
        speed = 0.4 + 0.15 * np.sin(2.0 * np.pi * (x - backwards * step * k) / loop)
        rows.append(speed)
        x = x + step * speed
    made = measures.wave(np.array(rows)[::20], loop, 0.4)
    assert made.speed == pytest.approx(backwards, abs=0.06) and made.correlation > 0.9
    gap = loop / number
    assert made.delay == pytest.approx(gap / (np.mean(rows) - backwards), rel=0.2)


def test_people_on_a_circle_accelerate_jerk_and_turn_as_geometry_says():
    speed, radius, step = 1.2, 3.0, 0.1
    angle = speed / radius * step * np.arange(200)[:, None]
    place = radius * np.stack([np.cos(angle), np.sin(angle)], -1)
    present = np.ones((200, 1), bool)
    made = measures.motion(place, present, step)
    np.testing.assert_allclose(made.acceleration, speed**2 / radius, rtol=1e-3)
    np.testing.assert_allclose(made.jerk, speed**3 / radius**2, rtol=1e-3)
    np.testing.assert_allclose(made.turn_rate, speed / radius, rtol=1e-3)
    present[100] = False  # nothing is measured across a gap
    assert len(measures.motion(place, present, step).acceleration) == 198 - 3
    assert len(measures.motion(0.2 * place, present, step).turn_rate) == 0  # slower than people walk


def test_a_parabola_through_five_moments_keeps_parabolas_and_their_people():
    time = np.arange(9.0)
    place = np.stack([np.stack([time, 0.3 * time**2 - time], -1), np.zeros((9, 2))], 1)
    present = np.ones((9, 2), bool)
    present[4, 1] = False  # who is away is in no parabola
    smooth, whole = smoothed(place, present)
    assert whole[:, 0].tolist() == [False] * 2 + [True] * 5 + [False] * 2 and not whole[:, 1].any()
    np.testing.assert_allclose(smooth[whole], place[2:-2, 0], atol=1e-9)
    for number in (0, 4):
        assert not smoothed(place[:number], present[:number])[1].any()


def test_ways_aside_and_slowest_steps():
    along = np.linspace(0.0, 10.0, 51)
    aside = 0.7 * np.sin(np.pi * along / 10.0)
    slow = np.concatenate([np.linspace(0.0, 5.0, 26), np.linspace(5.1, 7.6, 25)])
    place = np.stack([np.stack([along, aside], -1), np.stack([slow, 0 * slow], -1), np.zeros((51, 2))], 1)
    present = np.ones((51, 3), bool)
    np.testing.assert_allclose(measures.sideways(place, present), [0.7, 0.0, np.nan], atol=1e-3)
    least = measures.slowest(place, present)
    assert least[1] == pytest.approx(0.5) and np.isnan(least[2])
    present[:, 1] = np.arange(51) < 20
    assert measures.slowest(place, present)[1] == pytest.approx(1.0)


def test_pairs_walk_side_by_side_or_one_behind_the_other():
    beside = walkers([[0.0, 0.0], [0.0, 0.8], [0.0, 5.0], [1.1, 5.0]], [1.0, 0.0])
    there = np.ones(beside.shape[:2], bool)
    made = measures.company(beside, there, np.array([[0, 1], [2, 3]]), 0.1)
    np.testing.assert_allclose(np.unique(made.spacing.round(6)), [0.8, 1.1])
    assert made.beside.mean() == pytest.approx(0.5) and made.beside[made.spacing < 1.0].all()
    still = np.broadcast_to(beside[:1], beside.shape)
    assert not len(measures.company(still, there, np.array([[0, 1]]), 0.1).spacing)


def test_the_least_speed_counts_only_near_the_other():
    """Of three people who brake to 0.4 m/s for a second: beside the other, far from it, and not at all near it."""
    speed = np.full((40, 3), 1.0)
    speed[20:30, 0] = speed[5:9, 1] = 0.4
    x = np.concatenate([np.zeros((1, 3)), np.cumsum(0.1 * speed, axis=0)])
    position = np.stack([x, np.broadcast_to([0.0, 1.0, 5.0], x.shape)], -1)
    share = measures.least_speed_share(position, np.broadcast_to([2.5, 0.0], (41, 2)), 2.0)
    np.testing.assert_allclose(share[:2], [0.4, 1.0], rtol=1e-6)
    assert np.isnan(share[2])


def test_steps_go_the_shorter_way_around_a_period():
    walked = np.cumsum(np.random.default_rng(3).uniform(-1.0, 1.0, (50, 9)), axis=0)
    np.testing.assert_allclose(measures.steps_along(walked % 24.0, 24.0), np.diff(walked, axis=0), atol=1e-9)


def test_a_lattice_that_moves_has_its_density_and_speed():
    pytest.importorskip("pedpy")
    x, y = np.meshgrid(np.arange(10) + 0.5, np.arange(4) * 0.5 + 0.25)
    start = np.stack([x.ravel(), y.ravel()], -1)
    position = walkers(start, [0.8, 0.0], rows=60)
    position[..., 0] %= 10.0  # a periodic corridor: everybody is set back once or not at all
    floor, area = (0.0, 0.0, 10.0, 2.0), (3.0, 0.0, 7.0, 2.0)
    means = measures.area_means(tracks_of(position), floor, area, slice(20, 40, 5), period=10.0)
    np.testing.assert_allclose(means, (2.0, 0.8), rtol=1e-3)
    lower = np.broadcast_to(np.arange(40) < 20, (60, 40))
    half = measures.area_means(tracks_of(position, lower), (0.0, 0.0, 10.0, 1.0), (3.0, 0.0, 7.0, 1.0), period=10.0)
    np.testing.assert_allclose(half, (2.0, 0.8), rtol=1e-3)
    density, speed = measures.area_means(tracks_of(position, lower & False), floor, area)
    assert density == 0.0 and np.isnan(speed)


@pytest.mark.parametrize("run", crowds.STEADY)
def test_recorded_corridors_have_their_published_density_and_speed(recordings, run):
    """PedPy's figures of the same runs at 16 frames a second; here there are 4."""
    pytest.importorskip("pedpy")
    tracks = read(recordings, run)
    with (recordings / "fundamental_diagram" / "fd_means_uo180.csv").open() as file:
        known = next(row for row in csv.DictReader(file) if row["exp"] == run)
    rows = slice(*np.searchsorted(np.asarray(tracks.frame), crowds.STEADY[run]))
    density, speed = measures.area_means(tracks, (0.0, -4.0, 1.8, 4.0), (0.0, -2.0, 1.8, 0.0), rows)
    assert density == pytest.approx(float(known["rho"]), rel=0.01)
    assert speed == pytest.approx(float(known["v"]), rel=0.04)


@pytest.mark.parametrize(("run", "known"), [("uo-180-180-095", 1.76), ("uo-180-180-180", 2.84)])
def test_recorded_exits_have_their_published_flow(recordings, run, known):
    """Through an exit of 0.95 m, with a jam before it, and out of a corridor of 1.8 m without one."""
    times = crossing_times(read(recordings, run), Gate((2.3, -4.0), (-0.5, -4.0)))
    assert flow(times) == pytest.approx(known, rel=0.03)


@pytest.mark.parametrize("run", ["bo-360-090-090", "bo-360-160-160"])
def test_recorded_lanes_are_in_order(recordings, run):
    tracks = read(recordings, run)
    assert recorded_order(tracks) > 0.95
    position = np.asarray(tracks.position).copy()
    odd = np.arange(position.shape[1]) % 2 == 1
    position[:, odd] *= [1.0, -1.0]  # every second person walks the other way instead
    assert recorded_order(tracks.replace(position=position)) < 0.7


def read(folder, run):
    return recorded.read(next((folder / "juelich").glob(f"{run}_4of16fps.csv")), "juelich")
