"""Checks of crowds: fundamental diagrams in a corridor and in a single file, stop-and-go waves, and lanes.

[J] Project Hermes (Forschungszentrum Juelich, doi 10.34735/ped.2009.13 and .14): unidirectional runs through a corridor
of 1.8 m, measured with PedPy; bidirectional runs in a corridor of 3.6 m with free choice of the side, order 0.97 to 1.0
in its middle 4 m. [W93] U. Weidmann, Transporttechnik
der Fussgaenger, ETH Zuerich (1993). Measured values are in published.yaml.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import stats

from sean_jax.people.recordings import Tracks, read
from sean_jax.studies.scenes import Scene, join, spread, walkers
from sean_jax.studies.validation import guideline_scenes
from sean_jax.studies.validation.checks import (
    PUBLISHED,
    CheckContext,
    CheckResult,
    Curve,
    by_name,
    curve,
    level,
    listing,
    reference,
    result,
)
from sean_jax.studies.validation.measures import (
    area_means,
    area_series,
    deviation_in_time,
    first_and_last,
    lane_order,
    pedpy,
    spans_of_pairs,
    steps_along,
    wave,
)

HERMES = 1.55, 0.18  # m/s, free speed of these people, mean and deviation
DENSITIES = tuple(0.25 * k for k in range(2, 15))  # 1/m2
FEW = 0.5, 1.0, 1.5, 2.0, 2.5  # 1/m2
JUELICH: dict[str, dict[float, float]] = PUBLISHED["corridor"]
DRAWS = 10  # of people at each density
WEIDMANN_DRAWS = 5  # likewise
SPREAD = 0.7, 1.3  # times the measured range from the 10th to the 90th percentile, least and most
ROWS = 2, 3  # of people who start in straight rows
ROWS_DENSITY = 1.5  # 1/m2
TOLERANCE = 0.15
WIDE_TOLERANCE = 0.25  # of a formula that was fitted to many kinds of places
PERIOD = 20.0  # m
WIDTH = 1.8  # m
FLOOR = 0.0, 0.0, PERIOD, WIDTH
AREA = PERIOD / 2 - 2.0, 0.0, PERIOD / 2 + 2.0, WIDTH
STEADY: dict[str, list[int]] = PUBLISHED["steady"]
LOOP = 32.0  # m, of the single file
FILE_WIDTH = 0.6  # m
ENVELOPE: dict[float, list[float]] = PUBLISHED["single_file"]
WAVES: dict[int, list[float]] = PUBLISHED["stop_and_go"]
WAVE_LOOP = 25.71  # m, where they were measured
WAVE_SECONDS = 100.0  # s
WAVE_COUNTED = 60.0  # s, at the end
WAVE_TOLERANCE = 0.3  # share of the deviation; ours
WAVE_SPEED_TOLERANCE = 0.2  # m/s, of the speed of the wave; ours
DELAY_TOLERANCE = 0.3  # share of the delay from one person to the next; ours
STEP = 4  # moments, over which speeds are measured as in recordings


def hermes_speeds(number: int, seed: int) -> np.ndarray:
    """(N,) m/s, free speeds of people as in project Hermes."""
    draw = np.random.default_rng([seed, 19]).standard_normal(number)
    return HERMES[0] + HERMES[1] * np.clip(draw, -2.5, 2.5)


def weidmann(density: np.ndarray | float) -> np.ndarray:
    """The speed [m/s] at a density above 0 [1/m2] [W93]."""
    area = 1.0 / np.asarray(density, float)  # m2 of each person
    return 1.34 * (1.0 - np.exp(-1.913 * (area - 1.0 / 5.4)))


def juelich_recordings(context: CheckContext, pattern: str) -> list[Path]:
    """The recordings of Juelich in the folder of recordings, measured by the same functions as the model."""
    if context.data is None:
        return []
    return sorted((context.data / "juelich").glob(pattern))


def juelich(density: Sequence[float], what: str = "speed") -> np.ndarray:
    """(D,) m/s, the measured speed at densities [1/m2], or its ``percentile_10`` or ``percentile_90``; interpolated."""
    known = JUELICH[what]
    return np.interp(density, [*known], [*known.values()])


def in_corridor(context: CheckContext, scenes: Sequence[Scene], captions: Sequence[str]) -> np.ndarray:
    """(S, K, 2) density [1/m2] and speed [m/s] in the middle of periodic corridors, each second of the second half.

    Raises:
        Skipped: PedPy is not installed.
    """
    pedpy()  # before what takes long
    rows = slice(round(scenes[0].seconds * 5), None, 10)
    recorded = context.simulate(scenes, captions)
    return np.stack([area_series(tracks, FLOOR, AREA, rows, PERIOD) for tracks in recorded])


def corridors(
    densities: Sequence[float], draws: int, seconds: float, speeds: Callable[[int, int], np.ndarray] | None
) -> tuple[list[Scene], list[str]]:
    """Periodic corridors with people at random places, and captions for the first of each density.

    Args:
        speeds: preferred speeds [m/s] by (number, seed); None for the usual ones.
    """
    scenes = []
    captions = []
    for seed, (density, draw) in enumerate(itertools.product(densities, range(draws))):
        number = round(density * PERIOD * WIDTH)
        preferred = None if speeds is None else speeds(number, seed)
        scenes.append(guideline_scenes.ring(PERIOD, WIDTH, number, seconds, preferred, seed, inset=0.25))
        captions.append(f"{density:g} people/m²" if draw == 0 else "")
    return scenes, captions


def in_rows(rows: int, seconds: float, seed: int) -> Scene:
    """A periodic corridor with people in straight rows along it, at ``ROWS_DENSITY``."""
    number = round(ROWS_DENSITY * PERIOD * WIDTH)
    person = np.arange(number)
    across = (person % rows + 0.5) * WIDTH / rows
    start = np.stack([person * PERIOD / number, across], 1)
    people = walkers(start, route=(0,), speed=hermes_speeds(number, seed))
    return guideline_scenes.periodic(PERIOD, WIDTH, people, seconds)


def corridor_diagram(context: CheckContext) -> CheckResult:
    """Speeds in a corridor against measurements in Juelich: means, their spread, and a start in straight rows."""
    # The fundamental diagram: speed falls with density. Periodic, so that a density stays as it was set.
    densities: tuple[float, ...] = DENSITIES
    seconds = 60.0
    draws = DRAWS
    row_draws = 3
    if context.quick:
        densities = FEW
        seconds = 40.0
        draws = 3
        row_draws = 1
    scenes, captions = corridors(densities, draws, seconds, hermes_speeds)

    # People in straight rows may walk on as one block, without the reactions that slow a crowd down.
    straight = [in_rows(rows, seconds, seed) for rows in ROWS for seed in range(row_draws)]
    values = in_corridor(context, scenes + straight, captions)  # (S, K, 2)
    random = values[: len(scenes)].reshape(len(densities), draws, -1, 2)  # (D, draws, K, 2)
    in_straight_rows = values[len(scenes) :].reshape(len(ROWS), -1, 2)  # (rows, K, 2)

    means = compare(random, densities, juelich(densities), TOLERANCE, _juelich_curves(context))

    # How wide speeds spread over draws and moments, and how fast people are who start in straight rows.
    low, high = np.nanquantile(random[..., 1], [0.1, 0.9], axis=(1, 2))  # (D,)
    share = (high - low) / (juelich(densities, "percentile_90") - juelich(densities, "percentile_10"))
    by_rows = np.nanmean(in_straight_rows[..., 1], 1) / means.numbers[f"speed_{ROWS_DENSITY:g}"]
    known = np.isin(densities, [*JUELICH["percentile_10"]])  # other percentiles are interpolated
    least, most = SPREAD
    unlike = bool(((share < least) | (share > most))[known].any())
    slow = bool((np.abs(by_rows - 1.0) > TOLERANCE).any())

    measured = (
        f"{means.measured}; 10 to 90 % of speeds {listing(share)} times as wide as measured; from "
        f"{' and '.join(map(str, ROWS))} straight rows {listing(by_rows)} times as fast"
    )
    wanted = (
        f"within {100 * TOLERANCE:.0f} % of {listing(juelich(densities))} m/s, falling; {least:g} to {most:g} times as "
        f"wide at {listing(np.array(densities)[known], form='g')} /m²; from rows within {100 * TOLERANCE:.0f} % of "
        "random starts"
    )
    numbers = means.numbers | by_name("spread_", densities, share) | by_name("rows_", ROWS, by_rows)
    passed = means.passed and not unlike and not slow
    return result(passed, measured, wanted, numbers=numbers, curves=means.curves, axes=means.axes)


def _juelich_curves(context: CheckContext) -> list[Curve]:
    """The measured speeds, their 10th and 90th percentiles, and recordings if there are any."""
    curves = []
    for table, suffix in (("speed", ""), ("percentile_10", ", 10 %"), ("percentile_90", ", 90 %")):
        curves.append(reference(f"Juelich{suffix}", JUELICH[table], JUELICH[table].values()))
    recorded = []
    for run, steady in STEADY.items():
        recorded += [_recorded(path, steady) for path in juelich_recordings(context, f"{run}*.csv")]
    if recorded:
        curves.append(reference("recordings", *zip(*recorded, strict=True), points=True))
    return curves


def _recorded(path: Path, steady: list[int]) -> tuple[float, float]:
    """Density [1/m2] and speed [m/s] of a recording between its steady frames."""
    tracks = read(path, "juelich")
    begin, end = np.searchsorted(np.asarray(tracks.frame), steady)
    moments = slice(int(begin), int(end), 4)
    return area_means(tracks, (0.0, -4.0, 1.8, 4.0), (0.0, -2.0, 1.8, 0.0), moments)


def weidmann_diagram(context: CheckContext) -> CheckResult:
    """Speeds in a corridor against Weidmann's formula."""
    values = in_corridor(context, *corridors(FEW, WEIDMANN_DRAWS, 60.0, None))
    dense = np.linspace(0.25, 3.5, 27)
    known = reference("Weidmann 1993", dense, weidmann(dense))
    values = values.reshape(len(FEW), WEIDMANN_DRAWS, -1, 2)
    comparison = compare(values, FEW, weidmann(np.array(FEW)), WIDE_TOLERANCE, [known])
    if comparison.passed:
        return comparison
    expected = f"people in Juelich, whose free speed is 1.55 m/s, have {juelich([2.5])[0]:.2f} m/s at 2.5 /m²"
    return replace(comparison, reason=f"{comparison.reason}; {expected}")


def compare(
    values: np.ndarray, densities: Sequence[float], expected: np.ndarray, tolerance: float, curves: list[Curve]
) -> CheckResult:
    """The result of densities and speeds (densities, draws, K, 2): means over draws with intervals of 95 %."""
    by_draw = np.nanmean(values, axis=2)  # (densities, draws, 2)
    density, speed = np.moveaxis(by_draw.mean(1), -1, 0)
    draws = by_draw.shape[1]
    deviation = by_draw[..., 1].std(1, ddof=1)
    interval = stats.t.ppf(0.975, draws - 1) * deviation / np.sqrt(draws)

    off = np.abs(speed / expected - 1.0)
    off_draw = np.abs(by_draw[..., 1] / expected[:, None] - 1.0).max()
    falling = bool((np.diff(speed) < 0.0).all())
    falls = "" if falling else ", not falling"

    words = []
    for mean, half in zip(speed, interval, strict=True):
        words.append(f"{mean:.2f} ± {half:.2f}")
    numbers = by_name("speed_", densities, speed)
    numbers |= by_name("interval_", densities, interval)
    numbers |= by_name("density_", densities, density)
    return result(
        bool((off <= tolerance).all()) and falling,
        f"{', '.join(words)} m/s at {listing(densities, form='g')} /m² (off by {100 * off.max():.0f} % at most, one "
        f"draw by {100 * off_draw:.0f} %{falls})",
        f"within {100 * tolerance:.0f} % of {listing(expected)} m/s, falling",
        numbers=numbers,
        curves=(curve("model", densities, speed), *curves),
        axes=("density [1/m²]", "speed [m/s]"),
    )


# ------------------------------------------------------------------ single file


def in_file(number: int, length: float, seconds: float, seed: int = 0, jitter: float = 0.0) -> Scene:
    """A closed single file: people one behind the other in a loop [m] in which nobody can pass.

    Args:
        jitter: share of the gap by which people start off an even distance.
    """
    gap = length / number
    moved = jitter * gap * np.random.default_rng([seed, 31]).uniform(-1.0, 1.0, number)
    x = (np.arange(number) + 0.5) * gap + moved
    y = np.full(number, FILE_WIDTH / 2)
    people = walkers(np.stack([x, y], 1), route=(0,), seed=seed)
    return guideline_scenes.periodic(length, FILE_WIDTH, people, seconds)


def single_file_diagram(context: CheckContext) -> CheckResult:
    """Speeds of people who cannot pass each other, against 26 experiments."""
    densities = tuple(ENVELOPE)
    low, mean, high = zip(*ENVELOPE.values(), strict=True)
    scenes = [in_file(round(density * LOOP), LOOP, 60.0) for density in densities]
    recorded = context.simulate(scenes, [f"{density:g} people/m" for density in densities])
    means = []
    for tracks in recorded:
        step = steps_along(np.asarray(tracks.position)[..., 0], LOOP)  # (T - 1, N) m
        speed = np.asarray(step / tracks.time_step, float)
        means.append(float(speed[len(speed) // 2 :].mean()))

    inside = bool((np.greater_equal(means, low) & np.less_equal(means, high)).all())
    words = []
    for least, most in zip(low, high, strict=True):
        words.append(f"{least:.2f} to {most:.2f}")
    ranges = ", ".join(words)
    return result(
        inside and bool((np.diff(means) < 0.0).all()),
        f"{listing(means)} m/s at {listing(densities, form='g')} /m",
        f"between the 10th and 90th percentile of the experiments, {ranges} m/s, and falling",
        numbers=by_name("speed_", densities, means),
        curves=(
            curve("model", densities, means),
            reference("10 % of experiments", densities, low),
            reference("experiments", densities, mean),
            reference("90 % of experiments", densities, high),
        ),
        axes=("density [1/m]", "speed [m/s]"),
    )


class FileMotion(NamedTuple):
    """How people in a single file move, in one draw or on average."""

    speed: float  # m/s
    deviation: float  # m/s, of a person in time
    correlation: float  # of the wave
    delay: float  # s, of the wave from one person to the next
    wave: float  # m/s, speed of the wave; NaN without one


def stop_and_go(context: CheckContext) -> CheckResult:
    """How much a person's speed changes in time in a single file, against a recording, and the wave that it makes."""
    # Models easily have the right mean speed without stop-and-go waves, so waves are measured in time.
    seeds = range(1 if context.quick else 4)
    cases = list(itertools.product(WAVES, seeds))
    scenes = [in_file(number, WAVE_LOOP, WAVE_SECONDS, seed, 0.2) for number, seed in cases]
    recorded = context.simulate(scenes, ["" if seed else f"{number} people" for number, seed in cases])

    # The curve of each density is that of its first draw; numbers are means of all draws.
    motions: dict[int, list[FileMotion]] = {}
    curves: dict[int, Curve] = {}
    for (number, _), tracks in zip(cases, recorded, strict=True):
        speed, moved = _file_motion(tracks)
        motions.setdefault(number, []).append(moved)
        curves.setdefault(number, curve(f"{number} people", *_ranked(speed)))

    words = []
    numbers = {}
    passed = []
    for number, draws in motions.items():
        mean, waves = _mean_motion(draws)
        known_speed, known_deviation, known_delay, known_wave = WAVES[number]
        as_wide = abs(mean.deviation / known_deviation - 1.0) <= WAVE_TOLERANCE

        # The recorded wave is by the same correlation; the jams that its authors follow move backwards at 0.4 m/s.
        # Without a wave both are NaN, and neither is as recorded.
        as_fast = abs(mean.wave - known_wave) <= WAVE_SPEED_TOLERANCE
        as_late = abs(mean.delay / known_delay - 1.0) <= DELAY_TOLERANCE
        passed.append(as_wide and as_fast and as_late)
        numbers[number] = mean._asdict()

        wave_words = "no wave in all draws"
        if waves:
            wave_words = (
                f"a wave of {mean.wave:.2f} m/s (recorded {known_wave:.2f}), {mean.delay:.1f} s from one to the next "
                f"(recorded {known_delay:.1f})"
            )
        if 0 < waves < len(draws):
            wave_words += f", in {waves} of {len(draws)} draws"

        words.append(
            f"{number / WAVE_LOOP:.2f} /m: {mean.deviation:.3f} m/s (recorded {known_deviation:.3f}), mean "
            f"{mean.speed:.2f} m/s (recorded {known_speed:.2f}), {wave_words}"
        )

    # The curves are distributions of speeds: with waves some people stand while others walk.
    names = ("speed", "deviation", "correlation", "delay", "wave")
    return result(
        all(passed),
        f"deviation in time at {'; '.join(words)}",
        f"within {100 * WAVE_TOLERANCE:.0f} % of the recorded deviations, waves within {WAVE_SPEED_TOLERANCE:g} m/s of "
        f"the recorded, delays within {100 * DELAY_TOLERANCE:.0f} %",
        numbers={f"{name}_{number:g}": numbers[number][name] for name in names for number in WAVES},
        curves=tuple(curves.values()),
        axes=("speed [m/s]", "share of people and moments"),
    )


def _file_motion(tracks: Tracks) -> tuple[np.ndarray, FileMotion]:
    """Speeds (S, N) m/s in the counted time of a single file, and their motion."""
    time_step = STEP * tracks.time_step
    moments = round(WAVE_COUNTED / tracks.time_step)
    x = np.asarray(tracks.position)[-moments::STEP, :, 0]
    speed = np.asarray(steps_along(x, WAVE_LOOP) / time_step, float)
    motion = FileMotion(speed.mean(), deviation_in_time(speed), *wave(speed, WAVE_LOOP, time_step))
    return speed, motion


def _mean_motion(draws: list[FileMotion]) -> tuple[FileMotion, int]:
    """The mean over draws, and how many draws have a wave.

    Only draws with a wave count in the means of the wave, which are NaN if there is none.
    """
    motions = np.array(draws, float)  # (draws, 5)
    has_wave = np.isfinite(motions[:, -1])
    mean = motions.mean(axis=0)
    mean[2:] = np.nan
    if has_wave.any():
        mean[2:] = motions[has_wave, 2:].mean(axis=0)
    return FileMotion(*mean.tolist()), int(has_wave.sum())


def _ranked(speed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Speeds at a hundred shares of all, and these shares."""
    shares = np.linspace(0.005, 0.995, 100)
    return np.quantile(speed, shares), shares


# ------------------------------------------------------------------ lanes

LANE_DENSITIES = 0.5, 1.0, 1.5  # 1/m2
LANE_ORDER = 0.9
LANE_PERIOD = 10.0  # m
LANE_WIDTH = 3.6  # m
LANE_SECONDS = 120.0
LANE_SHARE = 0.4  # of the time, at its end, that counts


def mixed_corridor(density: float, seed: int) -> Scene:
    """A periodic corridor with people at random places; the first half walks along x, the others against it."""
    number = round(density * LANE_PERIOD * LANE_WIDTH)
    start = spread((0.0, 0.3), (LANE_PERIOD, LANE_WIDTH - 0.3), number, seed)
    start = np.random.default_rng([seed, 23]).permutation(start)
    speed = hermes_speeds(number, seed)
    half = number // 2
    along = walkers(start[:half], route=(0,), speed=speed[:half])
    against = walkers(start[half:], route=(1,), speed=speed[half:])
    return guideline_scenes.periodic(LANE_PERIOD, LANE_WIDTH, join(along, against), LANE_SECONDS)


def lanes(context: CheckContext) -> CheckResult:
    """The order of lanes that form out of a random mix (D. Helbing & P. Molnar, Phys. Rev. E 51, 4282 (1995))."""
    # Lanes are not in the model: they form as people avoid those who come towards them.
    seeds = range(1 if context.quick else 5)
    cases = list(itertools.product(LANE_DENSITIES, seeds))
    scenes = [mixed_corridor(density, seed) for density, seed in cases]
    captions = ["" if seed else f"{density:g} people/m²" for density, seed in cases]
    recorded = context.simulate(scenes, captions)
    order = np.stack([_order(tracks) for tracks in recorded])
    order = order.reshape(len(LANE_DENSITIES), len(seeds), -1)  # (D, draws, T)

    # The begin is left out, in which people are still mixed; the time until then is shown.
    moments = order.shape[-1]
    begin = int((1.0 - LANE_SHARE) * moments)
    last = order[..., begin:].mean((1, 2))  # (D,)
    until = []
    for draws in order:
        times = [time_until(series, LANE_ORDER) for series in draws]
        until.append(float(np.mean(times)))

    # Moments are 0.1 s apart; the plot has one in 2 s.
    end = 0.1 * (moments - 1)
    time = (0.1 * np.arange(moments))[::20]

    curves = []
    for density, mean in zip(LANE_DENSITIES, order.mean(1), strict=True):
        curves.append(curve(f"{density:g} people/m²", time, mean[::20]))
    curves.append(level("wanted", (0.1 * begin, end), LANE_ORDER))

    # Recordings of real people do not decide: their order is over the middle 4 m, not over the whole corridor.
    for path in juelich_recordings(context, "bo-360-*.csv"):
        known = recorded_order(read(path, "juelich"))
        run = path.stem.split("_")[0]
        curves.append(level(f"recording {run}", (0.0, end), known))

    return result(
        bool((last >= LANE_ORDER).all()),
        f"{listing(last)} at {listing(LANE_DENSITIES, form='g')} /m², {LANE_ORDER:g} after "
        f"{listing(until, form='.0f')} s",
        f"{LANE_ORDER:g} or more",
        numbers=by_name("order_", LANE_DENSITIES, last) | by_name("time_", LANE_DENSITIES, until),
        curves=tuple(curves),
        axes=("time [s]", "order"),
    )


def time_until(order: np.ndarray, wanted: float) -> float:
    """When the order (T,), 0.1 s apart, first is as wanted for 5 s on average [s]; inf if never."""
    total = np.concatenate([[0.0], np.cumsum(order)])
    reached = (total[50:] - total[:-50]) / 50 >= wanted
    if not reached.any():
        return float("inf")
    return 0.1 * float(reached.argmax())


def _order(tracks: Tracks) -> np.ndarray:
    """(T,) of everybody in the corridor."""
    position = np.asarray(tracks.position)
    present = np.asarray(tracks.present)
    number = position.shape[1]
    direction = np.where(np.arange(number) < number // 2, 1.0, -1.0)
    return lane_order(position[..., 1], direction, present)


def recorded_order(tracks: Tracks) -> float:
    """The order in a recording of people who walk along y: in the middle 4 m, from 30 to 80 % of its time."""
    position = np.asarray(tracks.position)
    present = np.asarray(tracks.present)
    people = np.arange(present.shape[1])
    first, last = first_and_last(present)
    way = position[last, people, 1] - position[first, people, 1]
    direction = np.sign(way)

    moments = slice(int(0.3 * len(present)), int(0.8 * len(present)))
    across = position[moments, :, 0]
    inside = (present & (np.abs(position[..., 1]) < 2.0))[moments]
    order = [lane_order(across[some], direction, inside[some]) for some in spans_of_pairs(inside)]
    return float(np.nanmean(np.concatenate(order)))
