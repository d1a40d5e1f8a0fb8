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
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import linear_sum_assignment
from scipy.stats import wasserstein_distance

from sean_jax import social_forces
from sean_jax.core.data_types import Pedestrians, Scenario, State
from sean_jax.people.recordings import Tracks
from sean_jax.studies.prediction import HABITS, evaluate, evaluate_samples, read_windows
from sean_jax.studies.scenes import Scene, model
from sean_jax.studies.validation.checks import CheckContext, CheckResult, result
from sean_jax.studies.validation.streets import STRIDE, TIME_STEP, Street, walked_again, windows_by_recording

OBSERVED = 5  # moments (2 s) of each person that are known: their mean speed is preferred, and they are not counted
SAMPLES = 20
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
        after = self.move(scenario, replace(state, pedestrians=replace(people, traits=None, noise=None)))
        return replace(after, traits=people.traits, noise=people.noise)


def errors(
    simulated: Float[np.ndarray, "T N 2"], recorded: Float[np.ndarray, "T N 2"], counted: Bool[np.ndarray, "T N"]
) -> Errors:
    """The errors of a simulated scene, at T moments of N people of whom ``counted`` ones count.

    Of moments with one person the distributions are not compared; NaN without any.
    """
    simulated, recorded = np.asarray(simulated, float), np.asarray(recorded, float)
    several = [(simulated[t, own], recorded[t, own]) for t, own in enumerate(counted) if own.sum() > 1]
    people = [(simulated[own, k], recorded[own, k]) for k, own in enumerate(counted.T) if own.any()]
    near = [_nearest(one) < TOUCH for one, _ in several]
    away = np.linalg.norm(simulated - recorded, axis=-1)
    return Errors(
        float(away[counted].mean()) if counted.any() else np.nan,
        _mean([transport(*pair) for pair in several]),
        _mean([discrepancy(*pair) for pair in several]),
        _mean([warping(*pair) / len(pair[0]) for pair in people]),
        float(np.concatenate(near).sum() / counted.sum()) if near else 0.0,
    )


def transport(one: Float[np.ndarray, "K 2"], other: Float[np.ndarray, "K 2"]) -> float:
    """Optimal transport between as many points [m2]: the least mean squared distance of an assignment."""
    cost = np.square(one[:, None] - other[None]).sum(-1)
    return float(cost[linear_sum_assignment(cost)].mean())


def discrepancy(one: Float[np.ndarray, "K 2"], other: Float[np.ndarray, "L 2"]) -> float:
    """Squared maximum mean discrepancy between points, biased, summed over Gaussian kernels of ``KERNELS`` widths."""
    both = np.concatenate([one, other])
    gap = np.square(both[:, None] - both[None]).sum(-1)
    usual = gap.sum() / (len(both) * (len(both) - 1))
    if usual == 0.0:
        return 0.0
    weight = np.concatenate([np.full(len(one), 1.0 / len(one)), np.full(len(other), -1.0 / len(other))])
    return float(sum(weight @ np.exp(-gap / (width * usual)) @ weight for width in KERNELS))


def warping(one: Float[np.ndarray, "S 2"], other: Float[np.ndarray, "U 2"]) -> float:
    """Dynamic time warping [m]: the least sum of distances of a monotone alignment of two tracks."""
    gap = np.linalg.norm(one[:, None] - other[None], axis=-1).tolist()
    before = [0.0] + [np.inf] * len(other)
    for row in gap:
        line = [np.inf]
        for k, distance in enumerate(row):
            line.append(distance + min(before[k], before[k + 1], line[k]))
        before = line
    return float(before[-1])


def differences(
    simulated: list[tuple[Float[np.ndarray, "T N 2"], Bool[np.ndarray, "T N"]]],
    recorded: list[tuple[Float[np.ndarray, "T N 2"], Bool[np.ndarray, "T N"]]],
) -> Differences:
    """The differences between the windows of a scene, each positions [m] and presence, 0.4 s apart."""
    inside = np.concatenate([place[present] for place, present in recorded])
    low, size = inside.min(0), np.maximum(np.ptp(inside, axis=0), 1e-9)

    def values(windows):
        population, coverage, speed = [], [], []
        for place, present in windows:
            cell = np.clip(np.floor((place - low) / size * CELLS), 0, CELLS - 1) @ np.array([1, CELLS])
            population += present.sum(1).tolist()
            coverage += [len(np.unique(row[own])) / CELLS**2 for row, own in zip(cell, present, strict=True)]
            both = present[1:] & present[:-1]
            step = np.linalg.norm(np.diff(place, axis=0), axis=-1) * both
            speed += (step.sum(0) / np.maximum(both.sum(0), 1))[both.any(0)].tolist()
        return population, coverage, speed

    own, known = values(simulated), values(recorded)
    scale = np.mean(known[0]), 1.0, np.mean(known[2])
    return Differences(*(float(wasserstein_distance(*pair) / by) for *pair, by in zip(own, known, scale, strict=True)))


def closed_loop(context: CheckContext) -> CheckResult:
    """The errors of recorded scenes that are simulated again, against those of constant velocity in the same scenes.

    Raises:
        Skipped: there are no recordings.
    """
    several = windows_by_recording(context)
    scenes = [again(street) for windows in several.values() for street in windows]
    alike = replace(context, model=replace(context.model, move=Average(context.model.move)))
    straight = replace(context, model=model("constant_velocity"))
    simulated, drawn = iter(alike.simulate(scenes)), iter(context.simulate(scenes))
    on_straight_ways = iter(straight.simulate(scenes))
    measured, mark, known, apart = {}, {}, {}, {}
    for name, windows in several.items():
        parts = [
            (positions(next(simulated), len(street.position)), street.position, counted(street)) for street in windows
        ]
        weights = [part[2].sum() for part in parts]
        straight_on = [positions(next(on_straight_ways), len(street.position)) for street in windows]
        measured[name] = mean_errors([errors(*part) for part in parts], weights)
        mark[name] = mean_errors(
            [errors(place, *part[1:]) for place, part in zip(straight_on, parts, strict=True)], weights
        )
        known[name] = mean_errors([errors(part[1], *part[1:]) for part in parts], weights)
        walked = [_sampled(next(drawn), len(street.position)) for street in windows]
        apart[name] = differences(walked, [(street.position, street.present) for street in windows])
    return compare_errors(measured, mark, {name: each.collisions for name, each in known.items()}, apart)


def prediction_samples(context: CheckContext) -> CheckResult:
    """The best of 20 predictions of each track, and how likely what was recorded is among them.

    Raises:
        Skipped: there are no recordings.
    """
    paths = context.eth_ucy()
    chosen = context.model
    own = chosen.forces if chosen.move is social_forces.move else chosen.move
    words, numbers = [], {}
    for path in context.progress(paths):
        windows = read_windows(path)
        single, several = evaluate(own, windows, **HABITS), evaluate_samples(own, windows, SAMPLES, **HABITS)
        words.append(
            f"{path.stem} {several.best_ade:.3f}/{several.best_fde:.3f}, likelihood {several.nll:.2f}, one average "
            f"person {single.ade:.3f}/{single.fde:.3f}"
        )
        values = several._asdict() | {"ade": single.ade, "fde": single.fde}
        numbers |= {f"{what}_{path.stem}": float(value) for what, value in values.items()}
    better = all(
        numbers[f"best_{what}_{path.stem}"] < numbers[f"{what}_{path.stem}"]
        for path in paths
        for what in ("ade", "fde")
    )
    return result(better, "; ".join(words), "the best sample better than the average person", numbers=numbers)


def again(street: Street) -> Scene:
    """The scene of a street whose people prefer the mean speed of their first 2 s, as [C24] has it."""
    number = street.present.shape[1]
    speed = np.zeros(number)
    for k in range(number):
        own = street.position[street.present[:, k], k][: OBSERVED + 1]
        speed[k] = np.linalg.norm(np.diff(own, axis=0), axis=-1).mean() / TIME_STEP
    return walked_again(replace(street, speed=speed))


def counted(street: Street) -> Bool[np.ndarray, "T N"]:
    """(T, N) the recorded people and moments that count: those after a person's first 2 s."""
    return street.present & (np.cumsum(street.present, 0) > OBSERVED)


def mean_errors(parts: list[Errors], weights: list[float]) -> Errors:
    """Mean errors of several scenes, weighted by their people and moments; scenes without any do not count."""
    values, share = np.asarray(parts, float), np.asarray(weights, float)[:, None]
    share = np.where(np.isfinite(values), share, 0.0)
    return Errors(*(np.where(share > 0.0, share * values, 0.0).sum(0) / np.maximum(share.sum(0), 1e-9)).tolist())


def compare_errors(
    measured: dict[str, Errors], mark: dict[str, Errors], collisions: dict[str, float], apart: dict[str, Differences]
) -> CheckResult:
    """The result of the errors of several scenes, with the share of recorded people who are as near.

    It passes if neither MAE nor MMD is above that of constant velocity.

    Args:
        mark: of constant velocity in the same scenes.
    """
    farther, words, numbers = [], [], {}
    for name, own in measured.items():
        straight = mark[name]
        if own.mae > straight.mae or own.mmd > straight.mmd:
            farther.append(name)
        numbers |= {f"{what}_{name}": value for what, value in (own._asdict() | apart[name]._asdict()).items()}
        numbers |= {f"{what}_constant_velocity_{name}": value for what, value in straight._asdict().items()}
        words.append(
            f"{name}: MAE {own.mae:.2f} m, OT {own.ot:.2f} m², MMD {own.mmd:.3f}, DTW {own.dtw:.2f} m (constant "
            f"velocity {straight.mae:.2f}, {straight.ot:.2f}, {straight.mmd:.3f}, {straight.dtw:.2f}), nearer than "
            f"{TOUCH:g} m {100 * own.collisions:.1f} % (recorded {100 * collisions[name]:.1f} %), "
            + ", ".join(f"{what} {value:.3f} apart" for what, value in apart[name]._asdict().items())
        )
    which = f" (not: {', '.join(farther)})" if farther else ""
    criterion = f"MAE and MMD not above those of constant velocity{which}"
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
    return float(np.mean(values)) if values else np.nan
