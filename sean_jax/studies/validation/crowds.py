"""Checks of crowds: fundamental diagrams in a corridor and in a single file, flow through doors, and lanes.

[J] Project Hermes (Forschungszentrum Juelich, doi 10.34735/ped.2009.13 and .14): unidirectional runs through a corridor
of 1.8 m, measured with PedPy; bottlenecks from 0.7 to 2 m, 1.9 people a second for each metre; bidirectional runs in a
corridor of 3.6 m with free choice of the side, order 0.97 to 1.0 in its middle 4 m. [W93] U. Weidmann, Transporttechnik
der Fussgaenger, ETH Zuerich (1993). [SF] 26 single-file experiments of the SingleFileComparator of Forschungszentrum
Juelich, each with the same weight.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sean_jax.recordings import Tracks, read
from sean_jax.studies.scenes import Gate, Scene, corridor, join, room, spread, walkers
from sean_jax.studies.validation.check import CheckContext, CheckResult, Curve, result
from sean_jax.studies.validation.measures import (
    AreaMeans,
    area_means,
    crossing_times,
    flow,
    lane_order,
    pedpy,
    single_file,
)

HERMES = 1.55, 0.18  # m/s, free speed of these people, mean and deviation
DENSITIES = 0.5, 1.0, 1.5, 2.0, 2.5  # 1/m2
JUELICH = {  # 1/m2 -> m/s, mean and 10th and 90th percentile [J]
    0.5: (1.376, 1.24, 1.51),
    1.0: (1.254, 1.17, 1.42),
    1.5: (1.017, 0.92, 1.15),
    2.0: (0.678, 0.49, 0.92),
    2.5: (0.402, 0.34, 0.44),
    3.0: (0.311, 0.28, 0.35),
}
DRAWS = 5  # of people at each density
TOLERANCE = 0.15
WIDE_TOLERANCE = 0.25  # of a formula that was fitted to many kinds of places
PERIOD, WIDTH = 20.0, 1.8  # m
STEADY = {  # the frames, of 16 a second, in which their authors found the runs steady
    "uo-050-180-180": (211, 800),
    "uo-070-180-180": (203, 1113),
    "uo-180-180-180": (400, 1284),
    "uo-180-180-095": (400, 1350),
}
LOOP = 32.0  # m, of the single file
ENVELOPE = {  # 1/m, middle of a bin of 0.25 -> m/s, 10th percentile, mean and 90th percentile [SF]
    0.375: (0.75, 1.15, 1.46),
    0.625: (0.73, 1.06, 1.33),
    0.875: (0.54, 0.87, 1.19),
    1.125: (0.38, 0.65, 1.00),
    1.375: (0.20, 0.43, 0.66),
    1.625: (0.11, 0.32, 0.56),
    1.875: (0.05, 0.22, 0.43),
}


def hermes_speeds(number: int, seed: int) -> np.ndarray:
    """(N,) m/s, free speeds of people as in project Hermes."""
    draw = np.random.default_rng([seed, 19]).standard_normal(number)
    return HERMES[0] + HERMES[1] * np.clip(draw, -2.5, 2.5)


def weidmann(density: np.ndarray | float) -> np.ndarray:
    """The speed [m/s] at a density above 0 [1/m2] [W93]."""
    return 1.34 * (1.0 - np.exp(-1.913 * (1.0 / np.asarray(density, float) - 1.0 / 5.4)))


def in_corridor(
    context: CheckContext,
    densities: tuple[float, ...],
    speeds: Callable[[int, int], np.ndarray | None],
    seconds: float,
    draws: int,
) -> list[list[AreaMeans]]:
    """Density and speed in the middle of a periodic corridor, over the second half of the time, by density and draw.

    Args:
        speeds: preferred speeds [m/s] by (number, seed); None for the usual ones.

    Raises:
        Skipped: PedPy is not installed.
    """
    pedpy()  # before what takes long
    scenes = []
    for seed, density in enumerate(np.repeat(densities, draws).tolist()):
        number = round(density * PERIOD * WIDTH)
        start = spread((0.0, 0.25), (PERIOD, WIDTH - 0.25), number, seed)
        people = walkers(start, route=(0,), speed=speeds(number, seed), seed=seed)
        far = Gate((1e4, WIDTH), (1e4, 0.0))
        scenes.append(Scene(corridor(PERIOD, WIDTH, PERIOD / 2), people, (far,), seconds, PERIOD))
    captions = [f"{density:g} people/m²" if draw == 0 else "" for density in densities for draw in range(draws)]
    tracks_of = context.simulate(scenes, captions)
    floor, area = (0.0, 0.0, PERIOD, WIDTH), (PERIOD / 2 - 2.0, 0.0, PERIOD / 2 + 2.0, WIDTH)
    rows = slice(round(seconds * 5), None, 10)  # the second half, every second
    means = [area_means(tracks, floor, area, rows, PERIOD) for tracks in tracks_of]
    return [means[first : first + draws] for first in range(0, len(means), draws)]


def corridor_diagram(context: CheckContext) -> CheckResult:
    """Speeds in a corridor against measurements in Juelich."""
    densities = DENSITIES if context.quick else (*DENSITIES, 3.0)
    seconds, draws = (40.0, 2) if context.quick else (60.0, DRAWS)
    measured = in_corridor(context, densities, hermes_speeds, seconds, draws)
    curves = tuple(
        Curve(f"Juelich{part}", tuple(JUELICH), tuple(row[k] for row in JUELICH.values()), reference=True)
        for k, part in enumerate(("", ", 10 %", ", 90 %"))
    )
    expected = np.array([JUELICH[density][0] for density in densities])
    return _compared(measured, densities, expected, TOLERANCE, (*curves, *_recorded_corridors(context)))


def weidmann_diagram(context: CheckContext) -> CheckResult:
    """Speeds in a corridor against Weidmann's formula."""
    measured = in_corridor(context, DENSITIES, lambda number, seed: None, 60.0, DRAWS)
    dense = np.linspace(0.25, 3.5, 27)
    curve = Curve("Weidmann 1993", tuple(dense), tuple(weidmann(dense)), reference=True)
    comparison = _compared(measured, DENSITIES, weidmann(np.array(DENSITIES)), WIDE_TOLERANCE, (curve,))
    if comparison.passed:
        return comparison
    expected = f"people in Juelich, whose free speed is 1.55 m/s, have {JUELICH[2.5][0]:.2f} m/s at 2.5 /m²"
    return replace(comparison, reason=f"{comparison.reason}; {expected}")


def _compared(
    measured: list[list[AreaMeans]],
    densities: tuple[float, ...],
    expected: np.ndarray,
    tolerance: float,
    curves: tuple[Curve, ...],
) -> CheckResult:
    """The result of mean speeds over draws; up to 2.5 people/m2 they have to be right."""
    each, counted = np.array([[means.speed for means in draws] for draws in measured]), len(DENSITIES)
    speed, deviation = each.mean(1), each.std(1, ddof=1)
    far = np.abs(each[:counted] / expected[:counted, None] - 1.0).max()
    off = np.abs(speed[:counted] / expected[:counted] - 1.0)
    falling = bool((np.diff(speed[:counted]) < 0.0).all())
    words = (
        ", ".join(f"{v:.2f} ± {d:.2f}" for v, d in zip(speed, deviation, strict=True))
        + " m/s at "
        + ", ".join(f"{rho:g}" for rho in densities)
    )
    return result(
        bool((off <= tolerance).all()) and falling,
        f"{words} /m² (off by {100 * off.max():.0f} % at most, one draw by {100 * far:.0f} %"
        f"{'' if falling else ', not falling'})",
        f"within {100 * tolerance:.0f} % of {', '.join(f'{value:.2f}' for value in expected[:counted])} m/s, falling",
        numbers={f"speed_{rho:g}": float(value) for rho, value in zip(densities, speed, strict=True)}
        | {f"deviation_{rho:g}": float(value) for rho, value in zip(densities, deviation, strict=True)}
        | {
            f"density_{rho:g}": float(np.mean([means.density for means in draws]))
            for rho, draws in zip(densities, measured, strict=True)
        },
        curves=(Curve("model", densities, tuple(speed)), *curves),
        axes=("density [1/m²]", "speed [m/s]"),
    )


def _recorded_corridors(context: CheckContext) -> tuple[Curve, ...]:
    """The recordings in the folder, measured by the same function."""
    if context.data is None:
        return ()
    means_of = []
    for run, (first, last) in STEADY.items():
        for path in sorted((context.data / "juelich").glob(f"{run}*.csv"))[:1]:
            tracks = read(path, "juelich")
            begin, end = np.searchsorted(np.asarray(tracks.frame), (first, last))
            rows = slice(int(begin), int(end), 4)
            means_of.append(area_means(tracks, (0.0, -4.0, 1.8, 4.0), (0.0, -2.0, 1.8, 0.0), rows))
    density, speed = (tuple(means[k] for means in means_of) for k in (0, 1))
    return (Curve("recordings", density, speed, reference=True, points=True),) if means_of else ()


def single_file_diagram(context: CheckContext) -> CheckResult:
    """Speeds of people who cannot pass each other, against 26 experiments."""
    seconds, width, seed = 60.0, 0.6, 0
    scenes = []
    for density in ENVELOPE:
        number = round(density * LOOP)
        start = np.stack([(np.arange(number) + 0.5) * LOOP / number, np.full(number, width / 2)], 1)
        people = walkers(start, route=(0,), seed=seed)
        far = Gate((1e4, width), (1e4, 0.0))
        scenes.append(Scene(corridor(LOOP, width, LOOP / 2), people, (far,), seconds, LOOP))
    recorded = context.simulate(scenes, [f"{density:g} people/m" for density in ENVELOPE])
    means = []
    for tracks in recorded:
        along = np.asarray(tracks.position)[..., 0]
        step = np.diff(along, axis=0)
        step -= LOOP * np.round(step / LOOP)
        _, speed = single_file(along[1:], step / tracks.time_step, LOOP)
        means.append(float(speed[len(speed) // 2 :].mean()))
    inside = [low <= mean <= high for mean, (low, _, high) in zip(means, ENVELOPE.values(), strict=True)]
    falling = bool((np.diff(means) < 0.0).all())
    densities = tuple(ENVELOPE)
    return result(
        all(inside) and falling,
        ", ".join(f"{mean:.2f}" for mean in means) + " m/s at " + ", ".join(f"{rho:g}" for rho in densities) + " /m",
        "between the 10th and 90th percentile of the experiments, "
        + ", ".join(f"{low:.2f} to {high:.2f}" for low, _, high in ENVELOPE.values())
        + " m/s, and falling",
        numbers={f"speed_{rho:g}": mean for rho, mean in zip(densities, means, strict=True)},
        curves=(
            Curve("model", densities, tuple(means)),
            *(
                Curve(name, densities, tuple(row[k] for row in ENVELOPE.values()), reference=True)
                for k, name in ((0, "10 % of experiments"), (1, "experiments"), (2, "90 % of experiments"))
            ),
        ),
        axes=("density [1/m]", "speed [m/s]"),
    )


# ------------------------------------------------------------------ doors

DOOR_FLOW = 1.9  # 1/(s m) [J]
DOOR_WIDTHS = 0.8, 1.0, 1.2, 1.6, 2.0, 2.4  # m, of bottlenecks
BOTTLENECKS = {0.70: 1.61, 0.95: 1.76, 1.2: 2.26, 1.3: 2.72, 1.6: 3.12, 2.0: 3.85}  # m -> 1/s, 20 to 80 % [J]
PEOPLE, SEEDS = 100, 5  # one crowd alone leaves by up to 5 % faster or slower than the mean
DOORS = 0.6, 0.7, 0.8, 0.9, 1.0, 1.2  # m
PASSABLE, SWIFT = 0.7, 1.0  # m: from where on one gets through, and nearly as fast as outside
SWIFT_SHARE = 0.8  # of the free speed
FREE = 1.34  # m/s
ASIDE = 0.0, 0.3, -0.3  # m, from the middle of the door, where somebody starts 4 m before it


def before_door(width: float, start: np.ndarray, speed: np.ndarray | float, seconds: float, **more) -> Scene:
    """A room of 8 by 8 m with a door in the middle of its right wall, at x = 0; people vanish 3 m behind it.

    Args:
        width: of the door [m].
        start: (N, 2) m.
        speed: preferred speed [m/s], one for all or (N,).
        **more: of ``walkers``.
    """
    door, behind = Gate((0.0, width / 2), (0.0, -width / 2)), Gate((3.0, 6.0), (3.0, -6.0))
    walls = room((-8.0, -4.0), (0.0, 4.0), [(door.left, door.right)])
    return Scene(walls, walkers(start, route=(0, 1), speed=speed, **more), (door, behind), seconds)


def bottleneck(context: CheckContext) -> CheckResult:
    """The flow of 100 people through doors."""
    widths = (0.8, 1.2, 2.4) if context.quick else DOOR_WIDTHS
    seeds = range(SEEDS)
    scenes = [
        before_door(width, spread((-7.5, -3.5), (-1.0, 3.5), PEOPLE, seed), hermes_speeds(PEOPLE, seed), 150.0)
        for width in widths
        for seed in seeds
    ]
    recorded = context.simulate(
        scenes, ["" if k % len(seeds) else f"{scenes[k].gates[0].left[1] * 2:g} m" for k in range(len(scenes))]
    )
    flows = np.array([_flow(scene, tracks) for scene, tracks in zip(scenes, recorded, strict=True)])
    flows = flows.reshape(len(widths), -1).mean(1)
    known = DOOR_FLOW * np.array(widths)
    off = np.abs(flows / known - 1.0)
    return result(
        bool((off <= TOLERANCE).all()),
        ", ".join(f"{value:.2f}" for value in flows) + " people/s at " + ", ".join(f"{width:g}" for width in widths)
        + f" m (off by {100 * off.max():.0f} % at most)",
        f"within {100 * TOLERANCE:.0f} % of {', '.join(f'{value:.2f}' for value in known)} people/s",
        numbers={f"flow_{width:g}": float(value) for width, value in zip(widths, flows, strict=True)},
        curves=(
            Curve("model", widths, tuple(flows)),
            Curve("1.9 w", widths, tuple(known), reference=True),
            Curve("Juelich", tuple(BOTTLENECKS), tuple(BOTTLENECKS.values()), reference=True, points=True),
            *_recorded_bottlenecks(context),
        ),
        axes=("width of the door [m]", "flow [people/s]"),
    )  # fmt: skip


def _flow(scene: Scene, tracks) -> float:
    """The flow [people/s] of the middle 60 %; 0 if too few came through."""
    times = crossing_times(tracks, scene.gates[0])
    measured = flow(times)
    return 0.0 if np.isnan(measured) else measured


def _recorded_bottlenecks(context: CheckContext) -> tuple[Curve, ...]:
    """The recordings in the folder, measured by the same function."""
    if context.data is None:
        return ()
    runs = []
    for path in sorted((context.data / "juelich").glob("uo-*-180-*_4of16fps.csv")):
        width = int(path.name.split("_")[0].split("-")[3]) / 100
        if width < 1.8:  # else the corridor ends without a door
            times = crossing_times(read(path, "juelich"), Gate((1.8 + 0.5, -4.0), (-0.5, -4.0)))
            runs.append((width, flow(times)))
    if not runs:
        return ()
    widths, flows = zip(*runs, strict=True)
    return (Curve("recordings", widths, flows, reference=True, points=True),)


def doors(context: CheckContext) -> CheckResult:
    """One person alone walks through a door."""
    cases = [(width, aside) for width in DOORS for aside in ASIDE]
    scenes = [before_door(width, np.array([[-4.0, aside]]), FREE, 12.0, velocity=(FREE, 0.0)) for width, aside in cases]
    recorded = context.simulate(scenes, ["" if aside else f"{width:g} m" for width, aside in cases])
    least = {width: 1.0 for width in DOORS}
    through = {width: True for width in DOORS}
    for (width, _), tracks in zip(cases, recorded, strict=True):
        position, present = np.asarray(tracks.position)[:, 0], np.asarray(tracks.present)[:, 0]
        step = np.linalg.norm(np.diff(position, axis=0), axis=-1)[present[1:]] / tracks.time_step
        near = position[1:][present[1:], 0] < 1.0
        least[width] = min(least[width], float((step[near] / FREE).min()))
        through[width] &= bool((position[present, 0] > 0.5).any())
    blocked = [width for width in DOORS if not through[width]]
    slow = [width for width in DOORS if width >= SWIFT and least[width] < SWIFT_SHARE]
    words = "through " + ("all" if not blocked else f"all but {', '.join(f'{width:g}' for width in blocked)} m")
    speeds = ", ".join(f"{100 * least[width]:.0f}" for width in DOORS)
    return result(
        not slow and all(width < PASSABLE for width in blocked),
        f"{words}; at {', '.join(f'{width:g}' for width in DOORS)} m never below {speeds} % of the free speed",
        f"through from {PASSABLE:g} m on, never below {100 * SWIFT_SHARE:.0f} % of the free speed from {SWIFT:g} m on",
        numbers={f"least_speed_{width:g}": FREE * least[width] for width in DOORS}
        | {f"through_{width:g}": float(through[width]) for width in DOORS},
        curves=(
            Curve("model", DOORS, tuple(least.values())),
            Curve("criterion", (SWIFT, DOORS[-1]), (SWIFT_SHARE, SWIFT_SHARE), True),
        ),
        axes=("width of the door [m]", "least speed / free speed"),
    )


# ------------------------------------------------------------------ lanes

LANE_DENSITIES = 0.5, 1.0, 1.5  # 1/m2
HERMES_ORDER = {0.47: 1.0, 0.55: 1.0, 0.85: 1.0, 1.59: 1.0, 1.99: 0.97}  # 1/m2 -> order [J]
LANE_ORDER = 0.9
LANE_PERIOD, LANE_WIDTH = 10.0, 3.6  # m
LANE_SECONDS = 120.0
LANE_SHARE = 0.4  # of the time, at its end, that counts


def mixed_corridor(density: float, seed: int, seconds: float = LANE_SECONDS) -> Scene:
    """A periodic corridor with people at random places; the first half walks along x, the others against it."""
    number = round(density * LANE_PERIOD * LANE_WIDTH)
    there = number // 2
    start = spread((0.0, 0.3), (LANE_PERIOD, LANE_WIDTH - 0.3), number, seed)
    start = np.random.default_rng([seed, 23]).permutation(start)
    speed = hermes_speeds(number, seed)
    people = join(
        walkers(start[:there], route=(0,), speed=speed[:there]),
        walkers(start[there:], route=(1,), speed=speed[there:]),
    )
    ends = Gate((1e4, LANE_WIDTH), (1e4, 0.0)), Gate((-1e4, 0.0), (-1e4, LANE_WIDTH))
    return Scene(corridor(LANE_PERIOD, LANE_WIDTH, LANE_PERIOD / 2), people, ends, seconds, LANE_PERIOD)


def lanes(context: CheckContext) -> CheckResult:
    """The order of lanes that form out of a random mix (D. Helbing & P. Molnar, Phys. Rev. E 51, 4282 (1995))."""
    seeds = range(1 if context.quick else 5)
    scenes = [mixed_corridor(density, seed) for density in LANE_DENSITIES for seed in seeds]
    captions = [f"{density:g} people/m²" if seed == 0 else "" for density in LANE_DENSITIES for seed in seeds]
    recorded = context.simulate(scenes, captions)
    order = np.stack([_order(tracks) for tracks in recorded]).reshape(len(LANE_DENSITIES), len(seeds), -1)
    last = order[..., int((1.0 - LANE_SHARE) * order.shape[-1]) :].mean((1, 2))
    time = 0.1 * np.arange(order.shape[-1])
    every = slice(None, None, 20)
    return result(
        bool((last >= LANE_ORDER).all()),
        ", ".join(f"{value:.2f}" for value in last) + " at " + ", ".join(f"{rho:g}" for rho in LANE_DENSITIES) + " /m²",
        f"{LANE_ORDER:g} or more",
        numbers={f"order_{rho:g}": float(value) for rho, value in zip(LANE_DENSITIES, last, strict=True)},
        curves=(
            *(
                Curve(f"{rho:g} people/m²", tuple(time[every]), tuple(rows.mean(0)[every]))
                for rho, rows in zip(LANE_DENSITIES, order, strict=True)
            ),
            Curve(
                "wanted",
                (time[int((1.0 - LANE_SHARE) * len(time))], time[-1]),
                (LANE_ORDER, LANE_ORDER),
                reference=True,
            ),
            *_recorded_lanes(context, time[-1]),
        ),
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


def _recorded_lanes(context: CheckContext, until: float) -> tuple[Curve, ...]:
    """The recordings in the folder, measured by the same function."""
    if context.data is None:
        return ()
    return tuple(
        Curve(f"recording {path.stem.split('_')[0]}", (0.0, until), (recorded_order(read(path, "juelich")),) * 2, True)
        for path in sorted((context.data / "juelich").glob("bo-360-*.csv"))
    )
