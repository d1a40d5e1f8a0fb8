"""Doors: how many people a second get through one, and whether one person alone passes it as if it were wide.

[J] Bottlenecks of project Hermes (doi 10.34735/ped.2009.13): 1.9 people a second for each metre, from 0.7 to 2 m.
"""

import numpy as np

from sean_jax.recordings import read_juelich
from sean_jax.studies.scenes import Gate, Scene, room, spread, walkers
from sean_jax.studies.validation.check import Check, Curve, Finding, Laboratory, judge
from sean_jax.studies.validation.crossings import crossing_times, flow
from sean_jax.studies.validation.diagrams import hermes_speeds

FLOW = 1.9  # 1/(s m) [J]
TOLERANCE = 0.15
WIDTHS = 0.8, 1.0, 1.2, 1.6, 2.0, 2.4  # m, of bottlenecks
RECORDED = {0.70: 1.61, 0.95: 1.76, 1.2: 2.26, 1.3: 2.72, 1.6: 3.12, 2.0: 3.85}  # m -> 1/s, 20 to 80 % [J]
PEOPLE, SEEDS = 100, 5  # one crowd alone leaves by up to 5 % faster or slower than the mean
DOORS = 0.6, 0.7, 0.8, 0.9, 1.0, 1.2  # m
PASSABLE, SWIFT = 0.7, 1.0  # m: from where on one gets through, and nearly as fast as outside
SHARE = 0.8  # of the free speed
FREE = 1.34  # m/s
ASIDE = 0.0, 0.3, -0.3  # m, from the middle of the door, where somebody starts 4 m before it


def before_door(width: float, start: np.ndarray, speed: np.ndarray | float, seconds: float, **more) -> Scene:
    """A room of 8 by 8 m with a door in the middle of its right wall, at x = 0, behind which all is open.

    Args:
        width: of the door [m].
        start: (N, 2) places of people [m].
        speed: preferred speed [m/s], one for all or (N,).
        **more: of ``walkers``.

    Returns:
        The scene; people vanish 3 m behind the door.
    """
    door, behind = Gate((0.0, width / 2), (0.0, -width / 2)), Gate((3.0, 6.0), (3.0, -6.0))
    walls = room((-8.0, -4.0), (0.0, 4.0), [(door.left, door.right)])
    return Scene(walls, walkers(start, route=(0, 1), speed=speed, **more), (door, behind), seconds)


def bottleneck(laboratory: Laboratory) -> Finding:
    """The flow of 100 people through doors."""
    widths = (0.8, 1.2, 2.4) if laboratory.quick else WIDTHS
    seeds = range(SEEDS)
    scenes = [
        before_door(width, spread((-7.5, -3.5), (-1.0, 3.5), PEOPLE, seed), hermes_speeds(PEOPLE, seed), 150.0)
        for width in widths
        for seed in seeds
    ]
    recorded = laboratory.simulate(
        scenes, ["" if k % len(seeds) else f"{scenes[k].gates[0].left[1] * 2:g} m" for k in range(len(scenes))]
    )
    flows = np.array([_flow(scene, tracks) for scene, tracks in zip(scenes, recorded, strict=True)])
    flows = flows.reshape(len(widths), -1).mean(1)
    known = FLOW * np.array(widths)
    off = np.abs(flows / known - 1.0)
    return judge(
        bool((off <= TOLERANCE).all()),
        ", ".join(f"{value:.2f}" for value in flows) + " people/s at " + ", ".join(f"{width:g}" for width in widths)
        + f" m (off by {100 * off.max():.0f} % at most)",
        f"within {100 * TOLERANCE:.0f} % of {', '.join(f'{value:.2f}' for value in known)} people/s",
        numbers={f"flow_{width:g}": float(value) for width, value in zip(widths, flows, strict=True)},
        curves=(
            Curve("model", widths, tuple(flows)),
            Curve("1.9 w", widths, tuple(known), reference=True),
            Curve("Juelich", tuple(RECORDED), tuple(RECORDED.values()), reference=True, points=True),
            *_recorded_runs(laboratory),
        ),
        axes=("width of the door [m]", "flow [people/s]"),
    )  # fmt: skip


def _flow(scene: Scene, tracks) -> float:
    """Of the middle 60 % of everybody: people/s; if too few came through, of those who did."""
    times = crossing_times(tracks, scene.gates[0])
    measured = flow(times)
    return 0.0 if np.isnan(measured) else measured


def _recorded_runs(laboratory: Laboratory) -> tuple[Curve, ...]:
    """The recordings at hand, measured by the same function."""
    if laboratory.data is None:
        return ()
    found = []
    for path in sorted((laboratory.data / "juelich").glob("uo-*-180-*_4of16fps.csv")):
        width = int(path.name.split("_")[0].split("-")[3]) / 100
        if width < 1.8:  # else the corridor ends without a door
            times = crossing_times(read_juelich(path), Gate((1.8 + 0.5, -4.0), (-0.5, -4.0)))
            found.append((width, flow(times)))
    if not found:
        return ()
    widths, flows = zip(*found, strict=True)
    return (Curve("recordings", widths, flows, reference=True, points=True),)


def doors(laboratory: Laboratory) -> Finding:
    """One person alone walks through a door."""
    cases = [(width, aside) for width in DOORS for aside in ASIDE]
    scenes = [before_door(width, np.array([[-4.0, aside]]), FREE, 12.0, velocity=(FREE, 0.0)) for width, aside in cases]
    recorded = laboratory.simulate(scenes, ["" if aside else f"{width:g} m" for width, aside in cases])
    least = {width: 1.0 for width in DOORS}
    through = {width: True for width in DOORS}
    for (width, _), tracks in zip(cases, recorded, strict=True):
        position, present = np.asarray(tracks.position)[:, 0], np.asarray(tracks.present)[:, 0]
        step = np.linalg.norm(np.diff(position, axis=0), axis=-1)[present[1:]] / tracks.time_step
        near = position[1:][present[1:], 0] < 1.0
        least[width] = min(least[width], float((step[near] / FREE).min()))
        through[width] &= bool((position[present, 0] > 0.5).any())
    blocked = [width for width in DOORS if not through[width]]
    slow = [width for width in DOORS if width >= SWIFT and least[width] < SHARE]
    words = "through " + ("all" if not blocked else f"all but {', '.join(f'{width:g}' for width in blocked)} m")
    speeds = ", ".join(f"{100 * least[width]:.0f}" for width in DOORS)
    return judge(
        not slow and all(width < PASSABLE for width in blocked),
        f"{words}; at {', '.join(f'{width:g}' for width in DOORS)} m never below {speeds} % of the free speed",
        f"through from {PASSABLE:g} m on, never below {100 * SHARE:.0f} % of the free speed from {SWIFT:g} m on",
        numbers={f"least_speed_{width:g}": FREE * least[width] for width in DOORS}
        | {f"through_{width:g}": float(through[width]) for width in DOORS},
        curves=(
            Curve("model", DOORS, tuple(least.values())),
            Curve("wanted", (SWIFT, DOORS[-1]), (SHARE, SHARE), True),
        ),
        axes=("width of the door [m]", "least speed / free speed"),
    )


CHECKS = (
    Check(
        name="bottleneck",
        title="A crowd leaves through a door as fast as in Juelich",
        setup="100 people whose free speed is 1.55 ± 0.18 m/s in a room of 8 by 8 m, a door of 0.8 to 2.4 m in the "
        "middle of one wall; each width with 5 seeds (with --quick three widths).",
        measure="flow through the door between 20 and 80 % of the crossings",
        criterion="within 15 % of 1.9 people/s for each metre",
        source="project Hermes (doi 10.34735/ped.2009.13), uo runs; A. Seyfried et al., Transp. Sci. 43, 395 (2009)",
        function=bottleneck,
    ),
    Check(
        name="doors",
        title="One person walks through a door",
        setup="One person who prefers 1.34 m/s, 4 m before a door of 0.6 to 1.2 m, straight ahead of it and 0.3 m "
        "aside.",
        measure="whether they get through within 12 s, and their least speed on the way",
        criterion="through from 0.7 m on; from 1.0 m on never below 80 % of the free speed",
        source="doors that people pass every day; at 1.3 shoulder widths or more they lose 0.12 to 0.16 m/s: "
        "K. Wilmut & A. Barnett, as collected in robot_sf's validation",
        function=doors,
    ),
)
