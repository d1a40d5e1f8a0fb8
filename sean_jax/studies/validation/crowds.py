"""Checks of crowds: fundamental diagrams in a corridor and in a single file, flow through doors, and lanes.

[J] Project Hermes (Forschungszentrum Juelich, doi 10.34735/ped.2009.13 and .14): unidirectional runs through a corridor
of 1.8 m, measured with PedPy; bottlenecks from 0.7 to 2 m, 1.9 people a second for each metre; bidirectional runs in a
corridor of 3.6 m with free choice of the side, order 0.97 to 1.0 in its middle 4 m. [W93] U. Weidmann, Transporttechnik
der Fussgaenger, ETH Zuerich (1993). Measured values are in published.yaml.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from sean_jax.recordings import Tracks, read
from sean_jax.studies.scenes import Gate, Scene, join, room, spread, walkers
from sean_jax.studies.validation import plans
from sean_jax.studies.validation.checks import PUBLISHED, CheckContext, CheckResult, Curve, by_name, listing, result
from sean_jax.studies.validation.measures import area_means, crossing_times, flow, lane_order, pedpy, steps_along

HERMES = 1.55, 0.18  # m/s, free speed of these people, mean and deviation
DENSITIES = 0.5, 1.0, 1.5, 2.0, 2.5  # 1/m2
JUELICH: dict[float, list[float]] = PUBLISHED["corridor"]
DRAWS = 5  # of people at each density
TOLERANCE = 0.15
WIDE_TOLERANCE = 0.25  # of a formula that was fitted to many kinds of places
PERIOD, WIDTH = 20.0, 1.8  # m
STEADY: dict[str, list[int]] = PUBLISHED["steady"]
LOOP = 32.0  # m, of the single file
ENVELOPE: dict[float, list[float]] = PUBLISHED["single_file"]


def hermes_speeds(number: int, seed: int) -> np.ndarray:
    """(N,) m/s, free speeds of people as in project Hermes."""
    draw = np.random.default_rng([seed, 19]).standard_normal(number)
    return HERMES[0] + HERMES[1] * np.clip(draw, -2.5, 2.5)


def weidmann(density: np.ndarray | float) -> np.ndarray:
    """The speed [m/s] at a density above 0 [1/m2] [W93]."""
    return 1.34 * (1.0 - np.exp(-1.913 * (1.0 / np.asarray(density, float) - 1.0 / 5.4)))


def _juelich(context: CheckContext, pattern: str) -> list[Path]:
    """The recordings of Juelich in the folder of recordings, measured by the same functions as the model."""
    return [] if context.data is None else sorted((context.data / "juelich").glob(pattern))


def in_corridor(
    context: CheckContext,
    densities: tuple[float, ...],
    speeds: Callable[[int, int], np.ndarray] | None,
    seconds: float,
    draws: int,
) -> np.ndarray:
    """(densities, draws, 2) density [1/m2] and speed [m/s] in the middle of a periodic corridor, in the second half.

    Args:
        speeds: preferred speeds [m/s] by (number, seed); None for the usual ones.

    Raises:
        Skipped: PedPy is not installed.
    """
    pedpy()  # before what takes long
    scenes = []
    for seed, density in enumerate(np.repeat(densities, draws).tolist()):
        number = round(density * PERIOD * WIDTH)
        own = None if speeds is None else speeds(number, seed)
        scenes.append(plans.ring(PERIOD, WIDTH, number, seconds, own, seed, inset=0.25))
    captions = [f"{density:g} people/m²" if draw == 0 else "" for density in densities for draw in range(draws)]
    floor, area = (0.0, 0.0, PERIOD, WIDTH), (PERIOD / 2 - 2.0, 0.0, PERIOD / 2 + 2.0, WIDTH)
    rows = slice(round(seconds * 5), None, 10)  # the second half, every second
    means = [area_means(tracks, floor, area, rows, PERIOD) for tracks in context.simulate(scenes, captions)]
    return np.array(means).reshape(len(densities), draws, 2)


def corridor_diagram(context: CheckContext) -> CheckResult:
    """Speeds in a corridor against measurements in Juelich."""
    densities = DENSITIES if context.quick else (*DENSITIES, 3.0)
    seconds, draws = (40.0, 2) if context.quick else (60.0, DRAWS)
    measured = in_corridor(context, densities, hermes_speeds, seconds, draws)
    curves = [
        Curve(f"Juelich{part}", tuple(JUELICH), tuple(row[k] for row in JUELICH.values()), reference=True)
        for k, part in enumerate(("", ", 10 %", ", 90 %"))
    ]
    recorded = []
    for run, (first, last) in STEADY.items():
        for path in _juelich(context, f"{run}*.csv")[:1]:
            tracks = read(path, "juelich")
            begin, end = np.searchsorted(np.asarray(tracks.frame), (first, last))
            rows = slice(int(begin), int(end), 4)
            recorded.append(area_means(tracks, (0.0, -4.0, 1.8, 4.0), (0.0, -2.0, 1.8, 0.0), rows))
    if recorded:
        curves.append(Curve("recordings", *zip(*recorded, strict=True), reference=True, points=True))
    expected = np.array([JUELICH[density][0] for density in densities])
    return _compared(measured, densities, expected, TOLERANCE, curves)


def weidmann_diagram(context: CheckContext) -> CheckResult:
    """Speeds in a corridor against Weidmann's formula."""
    measured = in_corridor(context, DENSITIES, None, 60.0, DRAWS)
    dense = np.linspace(0.25, 3.5, 27)
    curve = Curve("Weidmann 1993", tuple(dense), tuple(weidmann(dense)), reference=True)
    comparison = _compared(measured, DENSITIES, weidmann(np.array(DENSITIES)), WIDE_TOLERANCE, [curve])
    if comparison.passed:
        return comparison
    expected = f"people in Juelich, whose free speed is 1.55 m/s, have {JUELICH[2.5][0]:.2f} m/s at 2.5 /m²"
    return replace(comparison, reason=f"{comparison.reason}; {expected}")


def _compared(
    measured: np.ndarray, densities: tuple[float, ...], expected: np.ndarray, tolerance: float, curves: list[Curve]
) -> CheckResult:
    """The result of densities and speeds (densities, draws, 2); mean speeds up to 2.5 people/m2 have to be right."""
    density, each = measured[..., 0].mean(1), measured[..., 1]
    speed, deviation, counted = each.mean(1), each.std(1, ddof=1), len(DENSITIES)
    far = np.abs(each[:counted] / expected[:counted, None] - 1.0).max()
    off = np.abs(speed[:counted] / expected[:counted] - 1.0)
    falling = bool((np.diff(speed[:counted]) < 0.0).all())
    words = ", ".join(f"{v:.2f} ± {d:.2f}" for v, d in zip(speed, deviation, strict=True))
    return result(
        bool((off <= tolerance).all()) and falling,
        f"{words} m/s at {listing(densities, form='g')} /m² (off by {100 * off.max():.0f} % at most, one draw by "
        f"{100 * far:.0f} %{'' if falling else ', not falling'})",
        f"within {100 * tolerance:.0f} % of {listing(expected[:counted])} m/s, falling",
        numbers=by_name("speed_", densities, speed)
        | by_name("deviation_", densities, deviation)
        | by_name("density_", densities, density),
        curves=(Curve("model", densities, tuple(speed)), *curves),
        axes=("density [1/m²]", "speed [m/s]"),
    )


def single_file_diagram(context: CheckContext) -> CheckResult:
    """Speeds of people who cannot pass each other, against 26 experiments."""
    scenes, width = [], 0.6
    for density in ENVELOPE:
        number = round(density * LOOP)
        start = np.stack([(np.arange(number) + 0.5) * LOOP / number, np.full(number, width / 2)], 1)
        scenes.append(plans.periodic(LOOP, width, walkers(start, route=(0,)), 60.0))
    means = []
    for tracks in context.simulate(scenes, [f"{density:g} people/m" for density in ENVELOPE]):
        speed = np.asarray(steps_along(np.asarray(tracks.position)[..., 0], LOOP) / tracks.time_step, float)
        means.append(float(speed[len(speed) // 2 :].mean()))
    densities, (low, mean, high) = tuple(ENVELOPE), zip(*ENVELOPE.values(), strict=True)
    inside = bool((np.greater_equal(means, low) & np.less_equal(means, high)).all())
    ranges = ", ".join(f"{least:.2f} to {most:.2f}" for least, most in zip(low, high, strict=True))
    return result(
        inside and bool((np.diff(means) < 0.0).all()),
        f"{listing(means)} m/s at {listing(densities, form='g')} /m",
        f"between the 10th and 90th percentile of the experiments, {ranges} m/s, and falling",
        numbers=by_name("speed_", densities, means),
        curves=(
            Curve("model", densities, tuple(means)),
            Curve("10 % of experiments", densities, low, reference=True),
            Curve("experiments", densities, mean, reference=True),
            Curve("90 % of experiments", densities, high, reference=True),
        ),
        axes=("density [1/m]", "speed [m/s]"),
    )


# ------------------------------------------------------------------ doors

DOOR_FLOW = 1.9  # 1/(s m) [J]
DOOR_WIDTHS = 0.8, 1.0, 1.2, 1.6, 2.0, 2.4  # m, of bottlenecks
BOTTLENECKS: dict[float, float] = PUBLISHED["bottlenecks"]
BOTTLENECK_RUNS = "uo-*-180-*_4of16fps.csv"
PEOPLE, SEEDS = 100, 5  # one crowd alone leaves by up to 5 % faster or slower than the mean
DOORS = 0.6, 0.7, 0.8, 0.9, 1.0, 1.2  # m
PASSABLE, SWIFT = 0.7, 1.0  # m: from where on one gets through, and nearly as fast as outside
SWIFT_SHARE = 0.8  # of the free speed
FREE = 1.34  # m/s
ASIDE = 0.0, 0.3, -0.3  # m, from the middle of the door, of a person who starts 4 m before it


def before_door(width: float, start: np.ndarray, speed: np.ndarray | float, seconds: float, **more) -> Scene:
    """A room of 8 by 8 m with a door in the middle of its right wall, at x = 0; people vanish 3 m behind it.

    Args:
        width: of the door [m].
        start: (N, 2) m.
        speed: preferred speed [m/s], one for all or (N,).
        **more: of ``walkers``.
    """
    door, behind = Gate((0.0, width / 2), (0.0, -width / 2)), Gate((3.0, 6.0), (3.0, -6.0))
    walls = room((-8.0, -4.0), (0.0, 4.0), [door])
    return Scene(walls, walkers(start, route=(0, 1), speed=speed, **more), (door, behind), seconds)


def bottleneck(context: CheckContext) -> CheckResult:
    """The flow of 100 people through doors."""
    widths = (0.8, 1.2, 2.4) if context.quick else DOOR_WIDTHS
    scenes = [
        before_door(width, spread((-7.5, -3.5), (-1.0, 3.5), PEOPLE, seed), hermes_speeds(PEOPLE, seed), 150.0)
        for width in widths
        for seed in range(SEEDS)
    ]
    recorded = context.simulate(scenes, ["" if seed else f"{width:g} m" for width in widths for seed in range(SEEDS)])
    each = [flow(crossing_times(tracks, scene.gates[0])) for scene, tracks in zip(scenes, recorded, strict=True)]
    flows = np.nan_to_num(each).reshape(len(widths), SEEDS).mean(1)  # 0 where too few come through
    known = DOOR_FLOW * np.array(widths)
    off = np.abs(flows / known - 1.0)
    curves = [
        Curve("model", widths, tuple(flows)),
        Curve("1.9 w", widths, tuple(known), reference=True),
        Curve("Juelich", tuple(BOTTLENECKS), tuple(BOTTLENECKS.values()), reference=True, points=True),
    ]
    line = Gate((1.8 + 0.5, -4.0), (-0.5, -4.0))
    runs = {path: int(path.name.split("_")[0].split("-")[3]) / 100 for path in _juelich(context, BOTTLENECK_RUNS)}
    runs = {path: width for path, width in runs.items() if width < 1.8}  # else the corridor ends without a door
    if runs:
        out = tuple(flow(crossing_times(read(path, "juelich"), line)) for path in runs)
        curves.append(Curve("recordings", tuple(runs.values()), out, reference=True, points=True))
    return result(
        bool((off <= TOLERANCE).all()),
        f"{listing(flows)} people/s at {listing(widths, form='g')} m (off by {100 * off.max():.0f} % at most)",
        f"within {100 * TOLERANCE:.0f} % of {listing(known)} people/s",
        numbers=by_name("flow_", widths, flows),
        curves=tuple(curves),
        axes=("width of the door [m]", "flow [people/s]"),
    )


def doors(context: CheckContext) -> CheckResult:
    """One person alone walks through a door."""
    cases = [(width, aside) for width in DOORS for aside in ASIDE]
    scenes = [before_door(width, np.array([[-4.0, aside]]), FREE, 12.0, velocity=(FREE, 0.0)) for width, aside in cases]
    least, through = dict.fromkeys(DOORS, 1.0), dict.fromkeys(DOORS, True)
    recorded = context.simulate(scenes, ["" if aside else f"{width:g} m" for width, aside in cases])
    for (width, _), tracks in zip(cases, recorded, strict=True):
        position, present = np.asarray(tracks.position)[:, 0], np.asarray(tracks.present)[:, 0]
        step = np.linalg.norm(np.diff(position, axis=0), axis=-1)[present[1:]] / tracks.time_step
        near = position[1:][present[1:], 0] < 1.0
        least[width] = min(least[width], float((step[near] / FREE).min()))
        through[width] &= bool((position[present, 0] > 0.5).any())
    blocked = [width for width in DOORS if not through[width]]
    slow = [width for width in DOORS if width >= SWIFT and least[width] < SWIFT_SHARE]
    words = "through " + (f"all but {listing(blocked, form='g')} m" if blocked else "all")
    shares = listing([100 * share for share in least.values()], form=".0f")
    return result(
        not slow and all(width < PASSABLE for width in blocked),
        f"{words}; at {listing(DOORS, form='g')} m never below {shares} % of the free speed",
        f"through from {PASSABLE:g} m on, never below {100 * SWIFT_SHARE:.0f} % of the free speed from {SWIFT:g} m on",
        numbers=by_name("least_speed_", DOORS, [FREE * share for share in least.values()])
        | by_name("through_", DOORS, through.values()),
        curves=(
            Curve("model", DOORS, tuple(least.values())),
            Curve("criterion", (SWIFT, DOORS[-1]), (SWIFT_SHARE, SWIFT_SHARE), True),
        ),
        axes=("width of the door [m]", "least speed / free speed"),
    )


# ------------------------------------------------------------------ lanes

LANE_DENSITIES = 0.5, 1.0, 1.5  # 1/m2
LANE_ORDER = 0.9
LANE_PERIOD, LANE_WIDTH = 10.0, 3.6  # m
LANE_SECONDS = 120.0
LANE_SHARE = 0.4  # of the time, at its end, that counts


def mixed_corridor(density: float, seed: int) -> Scene:
    """A periodic corridor with people at random places; the first half walks along x, the others against it."""
    number = round(density * LANE_PERIOD * LANE_WIDTH)
    start = spread((0.0, 0.3), (LANE_PERIOD, LANE_WIDTH - 0.3), number, seed)
    start = np.random.default_rng([seed, 23]).permutation(start)
    speed = hermes_speeds(number, seed)
    halves = slice(number // 2), slice(number // 2, None)
    people = join(*(walkers(start[own], route=(way,), speed=speed[own]) for way, own in enumerate(halves)))
    return plans.periodic(LANE_PERIOD, LANE_WIDTH, people, LANE_SECONDS)


def lanes(context: CheckContext) -> CheckResult:
    """The order of lanes that form out of a random mix (D. Helbing & P. Molnar, Phys. Rev. E 51, 4282 (1995))."""
    seeds = range(1 if context.quick else 5)
    scenes = [mixed_corridor(density, seed) for density in LANE_DENSITIES for seed in seeds]
    captions = [f"{density:g} people/m²" if seed == 0 else "" for density in LANE_DENSITIES for seed in seeds]
    recorded = context.simulate(scenes, captions)
    order = np.stack([_order(tracks) for tracks in recorded]).reshape(len(LANE_DENSITIES), len(seeds), -1)
    begin = int((1.0 - LANE_SHARE) * order.shape[-1])
    last = order[..., begin:].mean((1, 2))
    time, mean = (0.1 * np.arange(order.shape[-1]))[::20], order.mean(1)[:, ::20]
    end = 0.1 * (order.shape[-1] - 1)
    rows = zip(LANE_DENSITIES, mean, strict=True)
    curves = [Curve(f"{density:g} people/m²", tuple(time), tuple(row)) for density, row in rows]
    curves.append(Curve("wanted", (0.1 * begin, end), (LANE_ORDER, LANE_ORDER), reference=True))
    for path in _juelich(context, "bo-360-*.csv"):
        name = f"recording {path.stem.split('_')[0]}"
        curves.append(Curve(name, (0.0, end), (recorded_order(read(path, "juelich")),) * 2, reference=True))
    return result(
        bool((last >= LANE_ORDER).all()),
        f"{listing(last)} at {listing(LANE_DENSITIES, form='g')} /m²",
        f"{LANE_ORDER:g} or more",
        numbers=by_name("order_", LANE_DENSITIES, last),
        curves=tuple(curves),
        axes=("time [s]", "order"),
    )


def _order(tracks: Tracks) -> np.ndarray:
    """(T,) of everybody in the corridor."""
    position, present = np.asarray(tracks.position), np.asarray(tracks.present)
    number = position.shape[1]
    direction = np.where(np.arange(number) < number // 2, 1.0, -1.0)
    return lane_order(position[..., 1], direction, present)


def recorded_order(tracks: Tracks) -> float:
    """The order in a recording of people who walk along y: in the middle 4 m, from 30 to 80 % of its time."""
    position, present = np.asarray(tracks.position), np.asarray(tracks.present)
    own, last = np.arange(present.shape[1]), len(present) - 1 - present[::-1].argmax(0)
    direction = np.sign(position[last, own, 1] - position[present.argmax(0), own, 1])
    rows = slice(int(0.3 * len(present)), int(0.8 * len(present)))
    inside = present & (np.abs(position[..., 1]) < 2.0)
    return float(np.nanmean(lane_order(position[rows, :, 0], direction, inside[rows])))
