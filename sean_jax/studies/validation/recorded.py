"""Closed loop: whole recorded scenes simulated again from starts and goals, and how far the crowd is from the recorded.

The measures are those of simulators that learn from recordings: [Z22] G. Zhang, Z. Yu, D. Jin & Y. Li,
"Physics-infused machine learning for crowd simulation", KDD 2022, and [C24] H. Chen et al., "Social physics informed
diffusion model for crowd simulation", AAAI 2024 (arXiv 2402.06680), as the evaluation code of [C24] defines them.
They compare everybody with themselves, and the best guess is an average person without noise. [B25] I. Bae, J. Lee &
H.-G. Jeon, "Continuous locomotive crowd behavior generation", CVPR 2025 (arXiv 2504.04756), compares distributions:
there people differ and have noise.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import linear_sum_assignment
from scipy.stats import wasserstein_distance

from sean_jax import social_forces
from sean_jax.core.data_types import Pedestrians, Scenario, State
from sean_jax.people.intent import Intent, lasting_speed
from sean_jax.people.recordings import Tracks
from sean_jax.people.recordings.reading import read
from sean_jax.studies.prediction import HABITS, evaluate, evaluate_samples, read_windows
from sean_jax.studies.scenes import Scene, model
from sean_jax.studies.validation.checks import CheckContext, CheckResult, Skipped, result
from sean_jax.studies.validation.measures import first_and_last
from sean_jax.studies.validation.streets import STRIDE, TIME_STEP, Street, walked_again, windows_by_recording

OBSERVED = 5  # moments (2 s) of each person that are known: their mean speed is preferred, and they are not counted
INTENT = Intent()
SAMPLES = 20
CLIP_RATE = 12.5  # frames per second of a clip
TOUCH = 0.5  # m, between centers: nearer people collide [C24]
CELLS = 10  # along x and y, in which [B25] divides a scene
KERNELS = 0.25, 0.5, 1.0, 2.0, 4.0  # of the mean squared distance, widths of the kernels of the discrepancy


class Errors(NamedTuple):
    """How far simulated people are from recorded ones; lower is better."""

    mae: float  # m, mean distance over all people and moments
    ot: float  # m2, optimal transport with squared distances, mean over moments
    mmd: float  # maximum mean discrepancy with five Gaussian kernels, mean over moments
    dtw: float  # m, dynamic time warping per moment, mean over people
    collisions: float  # share of people and moments with somebody nearer than 0.5 m


class Differences(NamedTuple):
    """How far distributions of simulated people are from recorded ones: earth mover's distances; lower is better."""

    population: float  # 1, of the number of people at a moment over its recorded mean; of the density, too
    coverage: float  # 1, of the share of the scene's 10 by 10 cells with somebody in them
    speed: float  # 1, of everybody's mean speed over the recorded mean


@dataclass(frozen=True)
class Average:
    """A pedestrian model whose people are alike and have no noise; equal for equal models, as ``Periodic``."""

    move: Callable[[Scenario, State], Pedestrians]

    def __call__(self, scenario: Scenario, state: State) -> Pedestrians:
        """N people one control step later."""
        people = state.pedestrians
        alike = replace(people, traits=None, noise=None)
        after = self.move(scenario, replace(state, pedestrians=alike))
        return replace(after, traits=people.traits, noise=people.noise)


def errors(
    simulated: Float[np.ndarray, "T N 2"], recorded: Float[np.ndarray, "T N 2"], counted: Bool[np.ndarray, "T N"]
) -> Errors:
    """The errors of a simulated scene, at T moments of N people of whom ``counted`` ones count.

    Of moments with one person the distributions are not compared; NaN without any.
    """
    simulated = np.asarray(simulated, float)
    recorded = np.asarray(recorded, float)

    # At each moment, the places of everybody are compared as two distributions.
    near = []
    distances = []
    discrepancies = []
    for moment, chosen in enumerate(counted):
        if chosen.sum() > 1:
            walked = simulated[moment, chosen]  # (K, 2) m
            known = recorded[moment, chosen]
            near.append(_nearest(walked) < TOUCH)
            distances.append(transport(walked, known))
            discrepancies.append(discrepancy(walked, known))

    # Each person's track is compared with their own.
    warpings = []
    for person, chosen in enumerate(counted.T):
        if chosen.any():
            least = warping(simulated[chosen, person], recorded[chosen, person])
            warpings.append(least / chosen.sum())

    mae = np.nan
    if counted.any():
        distance = np.linalg.norm(simulated - recorded, axis=-1)  # (T, N) m
        mae = float(distance[counted].mean())
    collisions = 0.0
    if near:
        collisions = float(np.concatenate(near).sum() / counted.sum())
    return Errors(mae, _mean(distances), _mean(discrepancies), _mean(warpings), collisions)


def transport(a: Float[np.ndarray, "K 2"], b: Float[np.ndarray, "K 2"]) -> float:
    """Optimal transport between as many points [m2]: the least mean squared distance of an assignment."""
    cost = np.square(a[:, None] - b[None]).sum(-1)  # (K, K) m2
    assigned = linear_sum_assignment(cost)
    return float(cost[assigned].mean())


def discrepancy(a: Float[np.ndarray, "K 2"], b: Float[np.ndarray, "L 2"]) -> float:
    """Squared maximum mean discrepancy between points, biased, summed over Gaussian kernels of ``KERNELS`` widths."""
    points = np.concatenate([a, b])
    square = np.square(points[:, None] - points[None]).sum(-1)
    mean = square.sum() / (len(points) * (len(points) - 1))
    if mean == 0.0:
        return 0.0

    weight_a = np.full(len(a), 1.0 / len(a))
    weight_b = np.full(len(b), -1.0 / len(b))
    weight = np.concatenate([weight_a, weight_b])
    total = 0.0
    for width in KERNELS:
        kernel = np.exp(-square / (width * mean))
        total += weight @ kernel @ weight
    return float(total)


def warping(a: Float[np.ndarray, "S 2"], b: Float[np.ndarray, "U 2"]) -> float:
    """Dynamic time warping [m]: the least sum of distances of a monotone alignment of two tracks."""
    distances = np.linalg.norm(a[:, None] - b[None], axis=-1).tolist()
    before = [0.0] + [np.inf] * len(b)
    for row in distances:
        sums = [np.inf]
        for k, distance in enumerate(row):
            sums.append(distance + min(before[k], before[k + 1], sums[k]))
        before = sums
    return float(before[-1])


def differences(
    simulated: list[tuple[Float[np.ndarray, "T N 2"], Bool[np.ndarray, "T N"]]],
    recorded: list[tuple[Float[np.ndarray, "T N 2"], Bool[np.ndarray, "T N"]]],
) -> Differences:
    """The differences between the windows of a scene, each positions [m] and presence, 0.4 s apart."""
    places = np.concatenate([position[present] for position, present in recorded])
    low = places.min(0)
    size = np.maximum(np.ptp(places, axis=0), 1e-9)
    walked = _distributions(simulated, low, size)
    known = _distributions(recorded, low, size)

    scales = np.mean(known[0]), 1.0, np.mean(known[2])
    distances = []
    for values, known_values, scale in zip(walked, known, scales, strict=True):
        distances.append(float(wasserstein_distance(values, known_values) / scale))
    return Differences(*distances)


def _distributions(
    windows: list[tuple[Float[np.ndarray, "T N 2"], Bool[np.ndarray, "T N"]]], low: np.ndarray, size: np.ndarray
) -> tuple[list[float], list[float], list[float]]:
    """People and shares of cells with people of all moments, and mean steps of all people.

    Args:
        low, size: (2,) m, the lower corner of the cells, and the extent of all together.
    """
    population = []
    coverage = []
    step_length = []
    for position, present in windows:
        population += present.sum(1).tolist()

        column_row = np.clip(np.floor((position - low) / size * CELLS), 0, CELLS - 1)  # (T, N, 2)
        cell = column_row @ np.array([1, CELLS])
        for moment, chosen in enumerate(present):
            occupied = np.unique(cell[moment, chosen])
            coverage.append(len(occupied) / CELLS**2)

        walks = present[1:] & present[:-1]
        step = np.linalg.norm(np.diff(position, axis=0), axis=-1) * walks  # (T - 1, N) m
        mean_step = step.sum(0) / np.maximum(walks.sum(0), 1)
        step_length += mean_step[walks.any(0)].tolist()
    return population, coverage, step_length


def closed_loop(context: CheckContext) -> CheckResult:
    """The errors of recorded scenes that are simulated again, against those of constant velocity in the same scenes.

    Raises:
        Skipped: there are no recordings.
    """
    recordings = {}
    moments = {}
    for name, windows in windows_by_recording(context).items():
        recordings[name] = [with_first_speeds(street) for street in windows]
        moments[name] = [counted(street) for street in windows]
    return _walk_again(context, recordings, moments)


def clips(context: CheckContext) -> CheckResult:
    """The errors of clips of a station by the protocol of [C24]: 2 s of each person are given, then the person is free.

    Raises:
        Skipped: there are no clips.
    """
    paths = sorted((context.recordings() / "grand_central").glob("*.csv"))
    if not paths:
        raise Skipped("no clips in grand_central; give a folder with grand_central/gc_2104-2164.csv with --data.")
    recordings = {path.stem: [clip(path)] for path in paths}
    moments = {name: [street.present for street in streets] for name, streets in recordings.items()}
    return _walk_again(context, recordings, moments)


def clip(path: Path) -> Street:
    """The people of a clip from 2 s after they come on, with the mean speed and the last velocity of these 2 s.

    Raises:
        FileError: the file cannot be read.
    """
    tracks = read(path, "csv", CLIP_RATE)
    every = round(TIME_STEP * CLIP_RATE)
    position = np.asarray(tracks.position, float)
    present = np.asarray(tracks.present)

    # The goal is the very last place, which may lie between two of the moments that are compared.
    people = np.arange(present.shape[1])
    _, last = first_and_last(present)
    goal = position[last, people]  # (N, 2) m
    position = position[::every]
    present = present[::every]
    long_enough = present.sum(0) > OBSERVED + 2
    position = position[:, long_enough]
    present = present[:, long_enough]

    # What is known: the first 2 s.
    first, _ = first_and_last(present)
    person = np.arange(present.shape[1])
    known = [position[first + k, person] for k in range(OBSERVED + 1)]
    step = np.linalg.norm(np.diff(known, axis=0), axis=-1)  # (OBSERVED, N) m
    return Street(
        position=position,
        present=present & (np.cumsum(present, 0) > OBSERVED),
        goal=goal[long_enough],
        speed=step.mean(0) / TIME_STEP,
        group=np.full(len(person), -1),
        velocity=(known[-1] - known[-2]) / TIME_STEP,
    )


def _walk_again(
    context: CheckContext,
    recordings: dict[str, list[Street]],
    moments_that_count: dict[str, list[np.ndarray]],
) -> CheckResult:
    """The errors of streets by name that are walked again, with the people and moments (T, N) that count.

    Constant velocity, the mark, keeps the speed of a person's first 2 s, and turns to the goal at once.
    """
    # All windows are simulated together: average people, people who differ and have noise, and the mark.
    average = replace(context, model=replace(context.model, move=Average(context.model.move)))
    straight = replace(context, model=model("constant_velocity"))
    average_scenes = []
    scenes = []
    straight_scenes = []
    for windows in recordings.values():
        average_scenes += intended_scenes(windows, INTENT.average())
        scenes += intended_scenes(windows, INTENT)
        straight_scenes += [walked_again(street) for street in windows]
    average_tracks = iter(average.simulate(average_scenes))
    drawn_tracks = iter(context.simulate(scenes))
    straight_tracks = iter(straight.simulate(straight_scenes))

    # Tracks come in the order of the windows.
    measured = {}
    straight_errors = {}
    collisions = {}
    distances = {}
    for name, windows in recordings.items():
        walked = []
        mark = []
        known = []
        drawn = []
        weights = []
        for street, chosen in zip(windows, moments_that_count[name], strict=True):
            moments = len(street.position)
            average_walk = positions(next(average_tracks), moments)
            straight_walk = positions(next(straight_tracks), moments)
            walked.append(errors(average_walk, street.position, chosen))
            mark.append(errors(straight_walk, street.position, chosen))
            known.append(errors(street.position, street.position, chosen))
            drawn.append(_sampled(next(drawn_tracks), moments))
            weights.append(chosen.sum())

        # Windows of one recording count by their people and moments.
        measured[name] = mean_errors(walked, weights)
        straight_errors[name] = mean_errors(mark, weights)
        collisions[name] = mean_errors(known, weights).collisions
        recorded = [(street.position, street.present) for street in windows]
        distances[name] = differences(drawn, recorded)
    return compare_errors(measured, straight_errors, collisions, distances)


def prediction_samples(context: CheckContext) -> CheckResult:
    """The best of 20 predictions of each track, and how likely what was recorded is among them.

    Raises:
        Skipped: there are no recordings.
    """
    paths = context.eth_ucy()
    chosen = context.model
    mover = chosen.forces if chosen.move is social_forces.move else chosen.move
    words = []
    numbers = {}
    better = True
    for path in context.progress(paths):
        scene = path.stem
        windows = read_windows(path)
        single = evaluate(mover, windows, **HABITS)
        samples = evaluate_samples(mover, windows, SAMPLES, **HABITS)
        better = better and samples.best_ade < single.ade and samples.best_fde < single.fde

        values = samples._asdict() | {"ade": single.ade, "fde": single.fde}
        for name, value in values.items():
            numbers[f"{name}_{scene}"] = float(value)
        words.append(
            f"{scene} {samples.best_ade:.3f}/{samples.best_fde:.3f}, likelihood {samples.nll:.2f}, one average "
            f"person {single.ade:.3f}/{single.fde:.3f}"
        )
    return result(better, "; ".join(words), "the best sample better than the average person", numbers=numbers)


def with_first_speeds(street: Street) -> Street:
    """The street, with the mean speed of everybody's first 2 s, which people prefer in [C24]."""
    speed = np.zeros(street.present.shape[1])
    for person, present in enumerate(street.present.T):
        observed = street.position[present, person][: OBSERVED + 1]
        step = np.linalg.norm(np.diff(observed, axis=0), axis=-1)
        speed[person] = step.mean() / TIME_STEP
    return replace(street, speed=speed)


def intended_scenes(windows: list[Street], intent: Intent) -> list[Scene]:
    """The scenes of the windows of one recording, whose first speeds are known, with an intent; draws differ."""
    usual = usual_speed(windows)
    scenes = []
    for number, street in enumerate(windows):
        speed = np.asarray(lasting_speed(intent, jnp.asarray(street.speed), usual), float)
        scene = walked_again(replace(street, speed=speed), intent)
        scenes.append(replace(scene, seed=number))
    return scenes


def usual_speed(windows: list[Street]) -> float:
    """The median speed [m/s] of people in the windows of one recording."""
    return float(np.median(np.concatenate([street.speed for street in windows])))


def counted(street: Street) -> Bool[np.ndarray, "T N"]:
    """(T, N) the recorded people and moments that count: those after a person's first 2 s."""
    return street.present & (np.cumsum(street.present, 0) > OBSERVED)


def mean_errors(parts: list[Errors], weights: list[float]) -> Errors:
    """Mean errors of several scenes, weighted by their people and moments; scenes without any do not count."""
    values = np.asarray(parts, float)  # (scenes, errors)
    share = np.where(np.isfinite(values), np.asarray(weights, float)[:, None], 0.0)
    total = np.where(share > 0.0, share * values, 0.0).sum(0)
    mean = total / np.maximum(share.sum(0), 1e-9)
    return Errors(*mean.tolist())


def compare_errors(
    measured: dict[str, Errors],
    straight: dict[str, Errors],
    collisions: dict[str, float],
    distances: dict[str, Differences],
) -> CheckResult:
    """The result of the errors of several scenes, with the share of recorded people who are as near.

    It passes if neither MAE nor MMD is above that of constant velocity.

    Args:
        straight: of constant velocity in the same scenes.
        collisions: of the recorded people.
        distances: of the distributions of simulated and recorded people.
    """
    farther = []
    words = []
    numbers = {}
    for name, simulated in measured.items():
        known = straight[name]
        apart = distances[name]._asdict()
        if simulated.mae > known.mae or simulated.mmd > known.mmd:
            farther.append(name)

        numbers |= {f"{word}_{name}": value for word, value in simulated._asdict().items()}
        numbers |= {f"{word}_{name}": value for word, value in apart.items()}
        numbers |= {f"{word}_constant_velocity_{name}": value for word, value in known._asdict().items()}
        apart_words = ", ".join(f"{word} {value:.3f} apart" for word, value in apart.items())
        words.append(
            f"{name}: MAE {simulated.mae:.2f} m, OT {simulated.ot:.2f} m², MMD {simulated.mmd:.3f}, "
            f"DTW {simulated.dtw:.2f} m (constant velocity {known.mae:.2f}, {known.ot:.2f}, {known.mmd:.3f}, "
            f"{known.dtw:.2f}), nearer than {TOUCH:g} m {100 * simulated.collisions:.1f} % (recorded "
            f"{100 * collisions[name]:.1f} %), {apart_words}"
        )

    criterion = "MAE and MMD not above those of constant velocity"
    if farther:
        criterion += f" (not: {', '.join(farther)})"
    return result(not farther, "; ".join(words), criterion, numbers=numbers)


def positions(tracks: Tracks, moments: int) -> Float[np.ndarray, "T N 2"]:
    """(T, N, 2) m at the moments of a recording; who has left stays, and everybody when nobody is left."""
    place = np.asarray(tracks.position, float)
    return place[np.minimum(STRIDE * np.arange(moments), len(place) - 1)]


def _sampled(tracks: Tracks, moments: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions (T, N, 2) m and presence (T, N) at the moments of a recording; nobody after the last of the tracks."""
    present = np.asarray(tracks.present)[::STRIDE][:moments]
    present = np.pad(present, ((0, moments - len(present)), (0, 0)))
    return positions(tracks, moments), present


def _nearest(place: np.ndarray) -> np.ndarray:
    gap = np.linalg.norm(place[:, None] - place[None], axis=-1)
    return (gap + np.diag(np.full(len(gap), np.inf))).min(1)


def _mean(values: list[float]) -> float:
    if not values:
        return np.nan
    return float(np.mean(values))
