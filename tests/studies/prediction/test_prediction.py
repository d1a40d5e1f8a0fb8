"""Prediction of recorded people by pedestrian models, and the benchmark of it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import InputError, preset
from sean_jax.core.data_types import Obstacles
from sean_jax.studies.prediction import cut_windows, evaluate, forecast, observed_people, predict, read_windows, score
from support.forces import plain

rng = np.random.default_rng(3)
STEP = 0.4


def straight(velocity, start, moments=8):
    """(moments, N, 2) of people who walk straight."""
    return np.asarray(start) + np.arange(moments)[:, None, None] * STEP * np.asarray(velocity)


ALONE = straight([[1.3, 0.2], [-0.9, 0.7], [0.0, 0.0]], [[0.0, 0.0], [60.0, 0.0], [0.0, 60.0]])
FORCES = plain()
HEAD_ON = straight([[1.3, 0.0], [-1.3, 0.0]], [[0.0, 0.0], [11.44, 0.05]])


@pytest.mark.parametrize("model", ["helbing1995", "constant_velocity", "orca"])
def test_people_who_are_far_from_others_go_straight_on(model):
    found = predict(model, ALONE, STEP, 12)
    expected = straight(np.diff(ALONE, axis=0)[0] / STEP, ALONE[-1], 13)[1:]
    np.testing.assert_allclose(found, expected, atol=2e-3)


def test_forces_and_orca_keep_apart_whom_constant_velocity_lets_collide():
    gap = {
        model: float(np.linalg.norm(np.diff(predict(model, HEAD_ON, STEP, 12), axis=1), axis=-1).min())
        for model in ("constant_velocity", "helbing1995", "orca")
    }
    assert gap["constant_velocity"] < 0.3 < min(gap["helbing1995"], gap["orca"]), gap


def test_a_model_of_ones_own_and_terms_of_ones_own_are_taken():
    def stand(scenario, state):
        return state.pedestrians

    np.testing.assert_allclose(predict(stand, ALONE, STEP, 3), np.broadcast_to(ALONE[-1], (3, 3, 2)), atol=1e-5)
    terms = [preset("helbing1995").walking]
    np.testing.assert_allclose(
        predict(terms, HEAD_ON, STEP, 12), predict("constant_velocity", HEAD_ON, STEP, 12), atol=1e-3
    )
    with pytest.raises(InputError, match="model: 'helbing1996' .*helbing1995"):
        predict("helbing1996", ALONE, STEP, 3)


def test_who_is_not_seen_at_the_last_moment_stays_unknown_and_moves_nobody():
    observed = np.concatenate([HEAD_ON, HEAD_ON[:, :1] + [[2.0, 0.1]]], 1)
    hidden = observed.copy()
    hidden[-1, 2] = np.nan
    found = np.asarray(predict(FORCES, hidden, STEP, 12))
    assert np.isnan(found[:, 2]).all()
    np.testing.assert_allclose(found[:, :2], predict(FORCES, HEAD_ON, STEP, 12), atol=1e-4)
    present = np.isfinite(hidden).all(-1)
    masked = predict(FORCES, np.nan_to_num(hidden, nan=7.0), STEP, 12, present=present)
    np.testing.assert_allclose(masked[:, :2], found[:, :2], atol=1e-4)


def test_batches_are_scenes_of_their_own_and_padding_changes_nothing():
    scenes = rng.uniform(-2.0, 2.0, (3, 1, 4, 2)) + np.cumsum(rng.normal(0.0, 0.3, (3, 8, 4, 2)), axis=1)
    together = predict(FORCES, scenes, STEP, 5)
    alone = np.stack([predict(FORCES, scene, STEP, 5) for scene in scenes])
    np.testing.assert_allclose(together, alone, atol=1e-3)
    padded = np.pad(scenes, ((0, 0), (0, 0), (0, 2), (0, 0)))
    present = np.broadcast_to(np.arange(6) < 4, padded.shape[:3])
    np.testing.assert_allclose(predict(FORCES, padded, STEP, 5, present=present)[:, :, :4], together, atol=1e-3)


def test_the_desired_velocity_is_the_weighted_mean_of_the_steps_that_were_seen():
    observed = np.cumsum(rng.normal(size=(6, 3, 2)), axis=0)
    present = np.ones((6, 3), bool)
    present[3, 1] = False  # neither the step to it nor that from it is known
    present[:-1, 2] = False
    weights = (0.5, 0.3, 0.2)
    people = observed_people(observed, present, STEP, weights)
    steps = np.diff(observed, axis=0) / STEP
    np.testing.assert_allclose(people.velocity[0], 0.5 * steps[4, 0] + 0.3 * steps[3, 0] + 0.2 * steps[2, 0], atol=1e-4)
    np.testing.assert_allclose(people.velocity[1], steps[4, 1], atol=1e-4)
    np.testing.assert_allclose(people.velocity[2], 0.0)
    assert people.present.tolist() == [True, True, True]
    slow = observed_people(observed * 0.001, present, STEP, least_speed=0.5)
    np.testing.assert_allclose(slow.preferred_speed, 0.5)


def test_walls_hold_predicted_people():
    wall = Obstacles(
        center=jnp.asarray([[4.0, 0.0]]), half_extent=jnp.asarray([[0.2, 3.0]]),
        yaw=jnp.zeros(1), height=jnp.full(1, 2.0),
    )  # fmt: skip
    observed = straight([[1.3, 0.0]], [[0.0, 0.3]])
    through = np.asarray(predict("helbing1995", observed, STEP, 12))
    held = np.asarray(predict("helbing1995", observed, STEP, 12, walls=wall))
    assert through[-1, 0, 0] > 5.0 and held[..., 0].max() < 3.8
    held = np.asarray(predict("constant_velocity", observed, STEP, 12, walls=wall))
    assert held[..., 0].max() < 3.61


def test_predictions_can_be_differentiated_by_the_parameters_of_forces():
    def gap(strength):
        mine = FORCES.tree_replace({"repulsion.strength": strength})
        return jnp.diff(predict(mine, HEAD_ON, STEP, 8), axis=1)[-1, 0, 1]

    both = jax.jit(jax.value_and_grad(gap))
    (value, slope), (other, _) = both(jnp.asarray(2.0)), both(jnp.asarray(2.02))
    assert np.isfinite(slope) and abs(slope) > 1e-4
    np.testing.assert_allclose((other - value) / 0.02, slope, rtol=0.1)


def brute_scores(predicted, recorded, present):
    """Errors and share of colliding tracks, person by person."""
    errors, touched = [], []
    for window in range(len(predicted)):
        for one in np.flatnonzero(present[window]):
            away = [
                np.hypot(*(predicted[window, t, one] - recorded[window, t, one])) for t in range(predicted.shape[1])
            ]
            errors.append((np.mean(away), away[-1]))
            gaps = [
                np.hypot(*(predicted[window, t, one] - predicted[window, t, other]))
                for other in np.flatnonzero(present[window])
                for t in range(predicted.shape[1])
                if other != one
            ]
            touched.append(min(gaps, default=9.0) < 0.2)
    return *np.mean(errors, 0), np.mean(touched), len(errors)


def test_scores_are_means_over_tracks():
    predicted, recorded = rng.normal(size=(2, 7, 5, 4, 2))
    present = rng.random((7, 4)) < 0.7
    np.testing.assert_allclose(score(predicted, recorded, present), brute_scores(predicted, recorded, present))


def test_windows_hold_those_who_are_there_throughout():
    there = rng.random((60, 5)) < 0.93
    place = rng.normal(size=(60, 5, 2))
    windows = cut_windows(np.where(there[..., None], place, np.nan), 6)
    expected = [(t, np.flatnonzero(there[t : t + 6].all(0))) for t in range(55) if there[t : t + 6].all(0).sum() >= 2]
    assert len(expected) == len(windows.position) > 3
    for window, present, (t, columns) in zip(windows.position, windows.present, expected, strict=True):
        assert present.sum() == len(columns)
        np.testing.assert_array_equal(window[:, : len(columns)], place[t : t + 6, columns])


def write_recording(path, last=26):
    """Three people, of whom one enters between two multiples of ten frames; all walk straight."""
    lines = ["frame,ped_id,x_m,y_m"]
    for person, first, count, speed in ((1, 0, 30, 1.0), (2, 40, last, -1.2), (3, 57, 4, 1.1)):
        for k in range(count):
            lines.append(f"{first + 10 * k},{person},{speed * 0.4 * k:.4f},{person}.0")
    path.write_text("\n".join(lines) + "\n")
    return path


def test_moments_are_ten_frames_apart_and_chunks_change_nothing(tmp_path):
    windows = read_windows(write_recording(tmp_path / "scene.csv"))
    assert windows.position.shape == (7, 20, 2, 2) and windows.present.all()  # from frame 40 to 290
    np.testing.assert_allclose(windows.position[0, :, 0, 0], 0.4 * (4 + np.arange(20)), atol=1e-6)
    whole = evaluate("constant_velocity", windows)
    assert whole.tracks == 14 and whole.ade < 1e-3 and whole.collisions == 0.0
    np.testing.assert_allclose(evaluate("constant_velocity", windows, chunk=4), whole, atol=1e-6)
    with pytest.raises(InputError, match="never are two people there"):
        read_windows(write_recording(tmp_path / "short.csv", 18))
    with pytest.raises(InputError, match="clock: 'sgan' is not one of"):
        read_windows(tmp_path / "scene.csv", "sgan")


def test_known_figures_of_constant_velocity(recordings):
    """Against docs of others: S-GAN's hotel has 301 windows, 1053 tracks and .323/.617, from places rounded to 1 cm."""
    windows = read_windows(recordings / "eth_ucy" / "hotel.csv")
    found = evaluate("constant_velocity", windows)
    assert len(windows.position) == 301 and found.tracks == 1053
    np.testing.assert_allclose([found.ade, found.fde], [0.323, 0.617], atol=0.004)
    assert 0.03 < found.collisions < 0.05


def test_others_walk_as_recorded_and_are_given_way_to():
    observed = straight([[1.3, 0.0]], [[0.0, 0.0]])
    path = np.arange(13)[:, None, None] * STEP * np.array([-1.0, 0.0]) + observed[-1, 0] + [4.0, 0.1]
    path[:3] = np.nan  # they come later
    free = np.asarray(predict(FORCES, observed, STEP, 12))
    found = np.asarray(predict(FORCES, observed, STEP, 12, others=path))
    assert found.shape == (12, 1, 2) and np.abs(found - free)[..., 1].max() > 0.1
    near = lambda tracks: np.linalg.norm(tracks[3:, 0] - path[4:, 0], axis=-1).min()  # noqa: E731
    assert near(free) < 0.4 < near(found)
    batch = predict(FORCES, np.stack([observed, observed]), STEP, 12, others=np.stack([path, path * np.nan]))
    np.testing.assert_allclose(batch[:, :, 0], np.stack([found[:, 0], free[:, 0]]), atol=1e-4)


def test_a_desired_velocity_that_is_known_is_taken_up():
    wish = np.array([[1.0, 0.5], [0.0, -1.2], [0.7, 0.0]])
    found = np.asarray(predict(FORCES, ALONE, STEP, 10, desired_velocity=wish))
    np.testing.assert_allclose(np.diff(found, axis=0)[-1] / STEP, wish, atol=1e-2)


def test_people_who_are_settled_go_on_as_they_were_seen():
    """One who follows another closely falls back, unless the headway is taken to be why he is not faster."""
    observed = straight([[1.2, 0.0], [1.2, 0.0]], [[0.0, 0.0], [1.3, 0.0]])  # farther apart than companions
    gaps = [
        float(np.diff(predict(FORCES, observed, STEP, 12, settled=share)[-1], axis=0)[0, 0])
        for share in (0.0, 0.5, 1.0)
    ]
    assert gaps[0] > gaps[1] > gaps[2], gaps
    slower = np.asarray(predict("constant_velocity", ALONE, STEP, 10, weights=(0.9,), settled=0.5))
    np.testing.assert_allclose(np.diff(slower, axis=0)[-1], 0.9 * np.diff(ALONE, axis=0)[-1], atol=1e-3)


def test_walking_companions_are_those_who_stay_near_and_walk_alike():
    """Three abreast, of whom the outer two are linked by the one between; a follower far behind; one who meets them."""
    time = np.arange(8)[:, None] * STEP
    starts = np.array([[0.0, 0.0], [0.0, 0.8], [0.0, 1.6], [-3.0, 0.0], [6.0, 0.4], [0.5, 5.0], [0.7, 5.3]])
    speeds = np.array([1.2, 1.25, 1.2, 1.2, -1.2, 0.0, 0.0])
    observed = starts[None] + np.stack([time * speeds, 0.0 * time * speeds], -1)
    label, companions = forecast.walking_companions(jnp.asarray(observed), jnp.ones(observed.shape[:2], bool), STEP)
    np.testing.assert_array_equal(label, [0, 0, 0, -1, -1, -1, -1])
    np.testing.assert_array_equal(companions[:3], [[1, 2], [0, 2], [0, 1]])
    np.testing.assert_array_equal(companions[3:], -1)
    hidden = jnp.ones(observed.shape[:2], bool).at[2:, 2].set(False)
    assert forecast.walking_companions(jnp.asarray(observed), hidden, STEP)[0].tolist() == [0, 0, -1, -1, -1, -1, -1]


def test_a_walking_group_is_a_chain_of_four_links_at_most():
    """Six abreast, each near to the next alone: the sixth is five links from the first."""
    abreast = straight([[1.2, 0.0]] * 6, [[0.0, 0.8 * person] for person in range(6)])
    label, companions = forecast.walking_companions(jnp.asarray(abreast), jnp.ones(abreast.shape[:2], bool), STEP)
    np.testing.assert_array_equal(label, [0, 0, 0, 0, 0, 1])
    np.testing.assert_array_equal(companions[-1], [1, 2])


def test_companions_are_not_pushed_apart():
    abreast = np.stack([np.stack([np.arange(8) * 0.5, np.full(8, side)], -1) for side in (0.0, 0.5)], 1)
    ahead = np.asarray(predict("calibrated", abreast, STEP, 12))
    np.testing.assert_allclose(ahead[-1, :, 1], [0.0, 0.5], atol=1e-3)
    met = np.asarray(predict("calibrated", abreast[-2:], STEP, 12))  # too short to know
    assert np.ptp(met[-1, :, 1]) > 0.55
