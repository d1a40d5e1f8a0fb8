"""Fundamental diagrams: how fast people walk at a density, in a corridor and in a single file.

[J] Unidirectional runs of project Hermes (Forschungszentrum Juelich, doi 10.34735/ped.2009.13 and .14) through a
corridor of 1.8 m, measured with PedPy. [W93] U. Weidmann, Transporttechnik der Fussgaenger, ETH Zuerich (1993). [SF] 26
single-file experiments of the SingleFileComparator of Forschungszentrum Juelich, each with the same weight.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sean_jax.recordings import read_juelich
from sean_jax.studies.scenes import Gate, Scene, corridor, spread, walkers
from sean_jax.studies.validation.check import Check, Curve, Finding, Laboratory, judge
from sean_jax.studies.validation.crossings import pedpy
from sean_jax.studies.validation.measures import AreaMeans, area_means, single_file

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
    """Free speeds of people as those of project Hermes.

    Returns:
        (N,) m/s.
    """
    draw = np.random.default_rng([seed, 19]).standard_normal(number)
    return HERMES[0] + HERMES[1] * np.clip(draw, -2.5, 2.5)


def weidmann(density: np.ndarray | float) -> np.ndarray:
    """The speed at a density [W93].

    Args:
        density: 1/m2, above 0.

    Returns:
        m/s.
    """
    return 1.34 * (1.0 - np.exp(-1.913 * (1.0 / np.asarray(density, float) - 1.0 / 5.4)))


def in_corridor(
    laboratory: Laboratory,
    densities: tuple[float, ...],
    speeds: Callable[[int, int], np.ndarray | None],
    seconds: float,
    draws: int,
) -> list[list[AreaMeans]]:
    """Density and speed in the middle of a periodic corridor, over the second half of the time.

    Args:
        densities: 1/m2.
        speeds: of (number, seed), the preferred speeds [m/s]; None for those that are usual.

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
    recorded = laboratory.simulate(scenes, captions)
    floor, area = (0.0, 0.0, PERIOD, WIDTH), (PERIOD / 2 - 2.0, 0.0, PERIOD / 2 + 2.0, WIDTH)
    rows = slice(round(seconds * 5), None, 10)  # the second half, every second
    found = [area_means(tracks, floor, area, rows, PERIOD) for tracks in recorded]
    return [found[first : first + draws] for first in range(0, len(found), draws)]


def corridor_diagram(laboratory: Laboratory) -> Finding:
    """Speeds in a corridor against those measured in Juelich."""
    densities = DENSITIES if laboratory.quick else (*DENSITIES, 3.0)
    seconds, draws = (40.0, 2) if laboratory.quick else (60.0, DRAWS)
    found = in_corridor(laboratory, densities, hermes_speeds, seconds, draws)
    curves = tuple(
        Curve(f"Juelich{part}", tuple(JUELICH), tuple(row[k] for row in JUELICH.values()), reference=True)
        for k, part in enumerate(("", ", 10 %", ", 90 %"))
    )
    known = np.array([JUELICH[density][0] for density in densities])
    return _compared(found, densities, known, TOLERANCE, (*curves, *_recorded_runs(laboratory)))


def weidmann_diagram(laboratory: Laboratory) -> Finding:
    """Speeds in a corridor against Weidmann's formula."""
    found = in_corridor(laboratory, DENSITIES, lambda number, seed: None, 60.0, DRAWS)
    dense = np.linspace(0.25, 3.5, 27)
    curve = Curve("Weidmann 1993", tuple(dense), tuple(weidmann(dense)), reference=True)
    finding = _compared(found, DENSITIES, weidmann(np.array(DENSITIES)), WIDE_TOLERANCE, (curve,))
    if finding.passed:
        return finding
    known = f"people in Juelich, whose free speed is 1.55 m/s, have {JUELICH[2.5][0]:.2f} m/s at 2.5 /m²"
    return replace(finding, reason=f"{finding.reason}; {known}")


def _compared(
    found: list[list[AreaMeans]],
    densities: tuple[float, ...],
    known: np.ndarray,
    tolerance: float,
    curves: tuple[Curve, ...],
) -> Finding:
    """The finding of speeds at densities, the means over draws; those of up to 2.5 people/m2 have to be right."""
    each, gated = np.array([[means.speed for means in draws] for draws in found]), len(DENSITIES)
    speed, deviation = each.mean(1), each.std(1, ddof=1)
    far = np.abs(each[:gated] / known[:gated, None] - 1.0).max()
    off = np.abs(speed[:gated] / known[:gated] - 1.0)
    falling = bool((np.diff(speed[:gated]) < 0.0).all())
    words = (
        ", ".join(f"{v:.2f} ± {d:.2f}" for v, d in zip(speed, deviation, strict=True))
        + " m/s at "
        + ", ".join(f"{rho:g}" for rho in densities)
    )
    return judge(
        bool((off <= tolerance).all()) and falling,
        f"{words} /m² (off by {100 * off.max():.0f} % at most, one draw by {100 * far:.0f} %"
        f"{'' if falling else ', not falling'})",
        f"within {100 * tolerance:.0f} % of {', '.join(f'{value:.2f}' for value in known[:gated])} m/s, falling",
        numbers={f"speed_{rho:g}": float(value) for rho, value in zip(densities, speed, strict=True)}
        | {f"deviation_{rho:g}": float(value) for rho, value in zip(densities, deviation, strict=True)}
        | {
            f"density_{rho:g}": float(np.mean([means.density for means in draws]))
            for rho, draws in zip(densities, found, strict=True)
        },
        curves=(Curve("model", densities, tuple(speed)), *curves),
        axes=("density [1/m²]", "speed [m/s]"),
    )


def _recorded_runs(laboratory: Laboratory) -> tuple[Curve, ...]:
    """The recordings at hand, measured by the same function."""
    if laboratory.data is None:
        return ()
    found = []
    for run, (first, last) in STEADY.items():
        for path in sorted((laboratory.data / "juelich").glob(f"{run}*.csv"))[:1]:
            tracks = read_juelich(path)
            begin, end = np.searchsorted(np.asarray(tracks.frame), (first, last))
            rows = slice(int(begin), int(end), 4)
            found.append(area_means(tracks, (0.0, -4.0, 1.8, 4.0), (0.0, -2.0, 1.8, 0.0), rows))
    density, speed = (tuple(means[k] for means in found) for k in (0, 1))
    return (Curve("recordings", density, speed, reference=True, points=True),) if found else ()


def single_file_diagram(laboratory: Laboratory) -> Finding:
    """Speeds of people who cannot pass each other, against 26 experiments."""
    seconds, width, seed = 60.0, 0.6, 0
    scenes = []
    for density in ENVELOPE:
        number = round(density * LOOP)
        start = np.stack([(np.arange(number) + 0.5) * LOOP / number, np.full(number, width / 2)], 1)
        people = walkers(start, route=(0,), seed=seed)
        far = Gate((1e4, width), (1e4, 0.0))
        scenes.append(Scene(corridor(LOOP, width, LOOP / 2), people, (far,), seconds, LOOP))
    recorded = laboratory.simulate(scenes, [f"{density:g} people/m" for density in ENVELOPE])
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
    return judge(
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


CHECKS = (
    Check(
        name="fundamental-diagram",
        title="Speed falls with density as in Juelich",
        setup="Periodic corridor of 20 by 1.8 m, 0.5 to 2.5 people/m² (without --quick 3 as well), whose free speed "
        "is 1.55 ± 0.18 m/s; 5 draws of each (2 with --quick).",
        measure="Voronoi density and speed in the middle 4 m, by PedPy, over the second half of 60 s (of 40 s with "
        "--quick)",
        criterion="means over the draws within 15 % of 1.38, 1.25, 1.02, 0.68, 0.40 m/s at 0.5, 1, 1.5, 2, 2.5 people/"
        "m², and falling",
        source="project Hermes (doi 10.34735/ped.2009.13), measured with PedPy",
        function=corridor_diagram,
    ),
    Check(
        name="weidmann",
        title="Speed falls with density as in Weidmann's formula",
        setup="Periodic corridor of 20 by 1.8 m, 0.5 to 2.5 people/m², whose free speed is N(1.34, 0.26) m/s; "
        "5 draws of each.",
        measure="Voronoi density and speed in the middle 4 m, by PedPy, over the second half of 60 s",
        criterion="means over the draws within 25 % of 1.34 (1 - exp(-1.913 (1 / density - 1 / 5.4))) m/s, and falling",
        source="U. Weidmann, Transporttechnik der Fussgänger, ETH Zürich (1993); the tolerance is ours",
        function=weidmann_diagram,
        quick=False,
    ),
    Check(
        name="rimea-16",
        title="Speed falls with density in a single file",
        setup="Loop of 32 m, 0.6 m wide, so that nobody can pass, 0.375 to 1.875 people/m, whose free speed is "
        "N(1.34, 0.26) m/s.",
        measure="mean speed over the second half of 60 s",
        criterion="between the 10th and the 90th percentile of 26 experiments, and falling",
        source="RiMEA guideline 4.1.1 (2025), test 16, with the experiments of the SingleFileComparator",
        function=single_file_diagram,
    ),
)
