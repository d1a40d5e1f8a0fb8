"""Lanes: people who walk in two directions sort themselves (D. Helbing & P. Molnar, Phys. Rev. E 51, 4282 (1995)).

[J] Bidirectional runs of project Hermes (doi 10.34735/ped.2009.13) in a corridor of 3.6 m, with free choice of the
side: order 0.97 to 1.0 in its middle 4 m.
"""

import numpy as np

from sean_jax.recordings import Tracks, read_juelich
from sean_jax.studies.scenes import Gate, Scene, corridor, join, spread, walkers
from sean_jax.studies.validation.check import Check, Curve, Finding, Laboratory, judge
from sean_jax.studies.validation.diagrams import hermes_speeds
from sean_jax.studies.validation.measures import lane_order

DENSITIES = 0.5, 1.0, 1.5  # 1/m2
RECORDED = {0.47: 1.0, 0.55: 1.0, 0.85: 1.0, 1.59: 1.0, 1.99: 0.97}  # 1/m2 -> order [J]
WANTED = 0.9
PERIOD, WIDTH = 10.0, 3.6  # m
SECONDS = 120.0
SHARE = 0.4  # of the time, at its end, that counts


def mixed_corridor(density: float, seed: int, seconds: float = SECONDS) -> Scene:
    """A periodic corridor in which half of the people, drawn at random, walk the other way.

    Args:
        density: 1/m2.

    Returns:
        The scene; the first half of the people walk along x.
    """
    number = round(density * PERIOD * WIDTH)
    there = number // 2
    start = spread((0.0, 0.3), (PERIOD, WIDTH - 0.3), number, seed)
    start = np.random.default_rng([seed, 23]).permutation(start)
    speed = hermes_speeds(number, seed)
    people = join(
        walkers(start[:there], route=(0,), speed=speed[:there]),
        walkers(start[there:], route=(1,), speed=speed[there:]),
    )
    ends = Gate((1e4, WIDTH), (1e4, 0.0)), Gate((-1e4, 0.0), (-1e4, WIDTH))
    return Scene(corridor(PERIOD, WIDTH, PERIOD / 2), people, ends, seconds, PERIOD)


def lanes(laboratory: Laboratory) -> Finding:
    """The order of lanes that form out of a random mix."""
    seeds = range(1 if laboratory.quick else 5)
    scenes = [mixed_corridor(density, seed) for density in DENSITIES for seed in seeds]
    captions = [f"{density:g} people/m²" if seed == 0 else "" for density in DENSITIES for seed in seeds]
    recorded = laboratory.simulate(scenes, captions)
    order = np.stack([_order(tracks) for tracks in recorded]).reshape(len(DENSITIES), len(seeds), -1)
    last = order[..., int((1.0 - SHARE) * order.shape[-1]) :].mean((1, 2))
    time = 0.1 * np.arange(order.shape[-1])
    every = slice(None, None, 20)
    return judge(
        bool((last >= WANTED).all()),
        ", ".join(f"{value:.2f}" for value in last) + " at " + ", ".join(f"{rho:g}" for rho in DENSITIES) + " /m²",
        f"{WANTED:g} or more",
        numbers={f"order_{rho:g}": float(value) for rho, value in zip(DENSITIES, last, strict=True)},
        curves=(
            *(
                Curve(f"{rho:g} people/m²", tuple(time[every]), tuple(rows.mean(0)[every]))
                for rho, rows in zip(DENSITIES, order, strict=True)
            ),
            Curve("wanted", (time[int((1.0 - SHARE) * len(time))], time[-1]), (WANTED, WANTED), reference=True),
            *_recorded_runs(laboratory, time[-1]),
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
    """The order in a recording along y: in the middle 4 m, from 30 to 80 % of its time.

    Args:
        tracks: of people who walk along y, either way.
    """
    position, present = np.asarray(tracks.position), np.asarray(tracks.present)
    own, last = np.arange(present.shape[1]), len(present) - 1 - present[::-1].argmax(0)
    direction = np.sign(position[last, own, 1] - position[present.argmax(0), own, 1])
    rows = slice(int(0.3 * len(present)), int(0.8 * len(present)))
    inside = present & (np.abs(position[..., 1]) < 2.0)
    return float(np.nanmean(lane_order(position[rows, :, 0], direction, inside[rows])))


def _recorded_runs(laboratory: Laboratory, until: float) -> tuple[Curve, ...]:
    """The recordings at hand, measured by the same function."""
    if laboratory.data is None:
        return ()
    return tuple(
        Curve(f"recording {path.stem.split('_')[0]}", (0.0, until), (recorded_order(read_juelich(path)),) * 2, True)
        for path in sorted((laboratory.data / "juelich").glob("bo-360-*.csv"))
    )


CHECKS = (
    Check(
        name="lanes",
        title="Two directions form lanes",
        setup="Periodic corridor of 10 by 3.6 m, 0.5, 1 and 1.5 people/m² in a random mix, half of them each way, "
        "whose free speed is 1.55 ± 0.18 m/s; 5 seeds (1 with --quick).",
        measure="mean over people of ((same - opposite) / n)² among the n people within 0.3 m across the corridor, "
        "along all of it, over the last 40 % of 120 s",
        criterion="0.9 or more at each density",
        source="project Hermes (doi 10.34735/ped.2009.13), bo runs: 0.97 to 1.0 over 4 m of the corridor",
        function=lanes,
    ),
)
