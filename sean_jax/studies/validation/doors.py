"""Checks of doors: the flow of crowds through bottlenecks, their density and press before them, and one person alone.

[J] Project Hermes (Forschungszentrum Juelich, doi 10.34735/ped.2009.13): bottlenecks from 0.7 to 2 m, 1.9 people a
second for each metre. [S09] A. Seyfried et al., Transp. Sci. 43, 395 (2009): a passage of 2.8 m. Measured values are in
published.yaml.
"""

import itertools

import numpy as np

from sean_jax.people.recordings import Tracks, read
from sean_jax.studies.scenes import Gate, Scene, box, room, spread, walkers
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
from sean_jax.studies.validation.crowds import TOLERANCE, hermes_speeds, juelich_recordings
from sean_jax.studies.validation.guideline_scenes import gate_right
from sean_jax.studies.validation.measures import crossing_times, densities, first_gate_times, flow, overlap, peak

FLOW = 1.9  # 1/(s m) [J]
WIDTHS = 0.8, 1.0, 1.2, 1.6, 2.0, 2.4  # m, of bottlenecks
PASSAGES = 0.2, 1.0, 2.8  # m, their lengths
WITHIN = 90.0  # s, in which all have to be out
BOTTLENECKS: dict[float, float] = PUBLISHED["bottlenecks"]
RUNS = "uo-*-180-*_4of16fps.csv"
PEOPLE = 100
SEEDS = 3  # one crowd alone leaves by up to 5 % faster or slower than the mean
BEFORE = (-2.6, -1.0), (-0.6, 1.0)  # m, square before the door in which density is measured, as in Hermes
PEAK = 10.0  # s, over which the largest density is a mean
HURRIES = 1.34, 2.0, 3.0, 4.0  # m/s, preferred speeds
SATURATED = 1.1  # times the flow at the last but one of these speeds, the most at the last one
DEPTH = 0.01  # m, by which two bodies overlap at most ...
APART = 2.0  # s, ... from then on: bodies whose drawn places overlap part first
CROWD: dict[str, float] = PUBLISHED["wide_bottleneck"]
DENSE = 4.5  # people/m2 before it, at least
DOORS = 0.6, 0.7, 0.8, 0.9, 1.0, 1.2  # m
PASSABLE = 0.7  # m, from where on one gets through
SWIFT = 1.0  # m, from where on one is nearly as fast as outside
SWIFT_SHARE = 0.8  # of the free speed
FREE = 1.34  # m/s
ASIDE = 0.0, 0.3, -0.3  # m, from the middle of the door, of a person who starts 4 m before it


def before_door(
    width: float, start: np.ndarray, speed: np.ndarray | float, seconds: float, passage: float = 0.2, **more
) -> Scene:
    """A room of 8 by 8 m with a door in the middle of its right wall, at x = 0; people vanish 3 m behind the passage.

    Args:
        width: of the door [m].
        start: (N, 2) m.
        speed: preferred speed [m/s], one for all or (N,).
        passage: its length [m], at least that of the wall, 0.2 m.
        **more: of ``walkers``.
    """
    door = gate_right(0.0, -width / 2, width / 2)
    behind = gate_right(3.0 + passage, -6.0, 6.0)
    walls = [room((-8.0, -4.0), (0.0, 4.0), [door])]
    if passage > 0.2:
        walls += _both_sides(passage, width / 2, width / 2 + 0.2)
    people = walkers(start, route=(0, 1), speed=speed, **more)
    return Scene(np.concatenate(walls), people, (door, behind), seconds)


def _both_sides(length: float, inner: float, outer: float) -> list[np.ndarray]:
    """The walls of a passage from x = 0 on, from ``inner`` to ``outer`` [m] on both sides of y = 0."""
    upper = box((0.0, inner), (length, outer))
    return [upper, upper * [1.0, -1.0, 1.0, 1.0, 1.0]]


def crowd_in_room(seed: int) -> np.ndarray:
    """(N, 2) m, the places of the crowd in the room before a door."""
    return spread((-7.5, -3.5), (-1.0, 3.5), PEOPLE, seed)


def bottleneck(context: CheckContext) -> CheckResult:
    """The flow of 100 people through doors and passages, and how many are out in time."""
    # Flow through a door is linear in its width (Juelich); short and long passages are as in the experiments.
    widths: tuple[float, ...] = WIDTHS
    passages: tuple[float, ...] = PASSAGES
    seeds = SEEDS
    if context.quick:
        widths = (0.8, 1.2, 2.4)
        passages = (0.2, 2.8)
        seeds = 2

    # Each seed is another crowd: one crowd alone leaves by up to 5 % faster or slower than the mean.
    scenes = []
    captions = []
    for passage, width, seed in itertools.product(passages, widths, range(seeds)):
        start = crowd_in_room(seed)
        speed = hermes_speeds(PEOPLE, seed)
        scenes.append(before_door(width, start, speed, WITHIN, passage))
        captions.append("" if seed else f"{width:g} m wide, {passage:g} m long")
    recorded = context.simulate(scenes, captions)

    # Of each passage and width: flow, 0 where too few come through, people left inside, and density before the door.
    shape = len(passages), len(widths), seeds
    times = first_gate_times(scenes, recorded)
    flows = [flow(crossings) for crossings in times]
    flows = np.nan_to_num(flows).reshape(shape).mean(2)  # (passages, widths)
    inside = [np.isinf(crossings).sum() for crossings in times]
    inside = np.reshape(inside, shape).max(2)
    crowded = [_density(tracks) for tracks in recorded]
    crowded = np.reshape(crowded, shape).mean(2)

    known = FLOW * np.array(widths)
    numbers: dict[str, float] = {}
    words = []
    curves = []
    for passage, rates, remaining, density in zip(passages, flows, inside, crowded, strict=True):
        for name, values in (("flow", rates), ("inside", remaining), ("density", density)):
            numbers |= by_name(f"{name}_{passage:g}_", widths, values)
        curves.append(curve(f"model, {passage:g} m long", widths, rates))

        words.append(
            f"passage of {passage:g} m: {listing(rates)} people/s, {int(remaining.max())} left inside at most, "
            f"{listing(density, form='.1f')} people/m² before it"
        )

    # Measured flows are drawn besides the line: they deviate from it, too.
    curves.append(reference("1.9 w", widths, known))
    curves.append(reference("Juelich", BOTTLENECKS, BOTTLENECKS.values(), points=True))
    curves += _recorded_flows(context)

    # Whoever is left inside fails the check: arches that never break are a known flaw of force models.
    off = np.abs(flows / known - 1.0)
    as_known = (off <= TOLERANCE).all()
    all_out = (inside == 0).all()
    return result(
        bool(as_known and all_out),
        f"{'; '.join(words)}; at {listing(widths, form='g')} m (off by {100 * off.max():.0f} % at most)",
        f"within {100 * TOLERANCE:.0f} % of {listing(known)} people/s, all out",
        numbers=numbers,
        curves=tuple(curves),
        axes=("width of the door [m]", "flow [people/s]"),
    )


def _density(tracks: Tracks) -> float:
    """The largest density [1/m2] in the square before the door, a mean over ``PEAK``."""
    density = densities(np.asarray(tracks.position), np.asarray(tracks.present), *BEFORE)  # (T,)
    span = round(PEAK / tracks.time_step)
    return float(peak(density, span))


def _recorded_flows(context: CheckContext) -> list[Curve]:
    """The flow of recordings, measured by the same function; none without recordings."""
    line = Gate((1.8 + 0.5, -4.0), (-0.5, -4.0))
    widths = []
    flows = []
    for path in juelich_recordings(context, RUNS):
        run = path.name.split("_")[0]
        width = int(run.split("-")[3]) / 100
        if width < 1.8:  # else the corridor ends without a door
            times = crossing_times(read(path, "juelich"), line)
            widths.append(width)
            flows.append(flow(times))
    if not widths:
        return []
    return [reference("recordings", widths, flows, points=True)]


def _overlap(context: CheckContext, tracks: Tracks) -> float:
    """The depth [m] to which bodies overlap, once bodies whose drawn places overlap have parted."""
    later = slice(round(APART / tracks.time_step), None)
    position = np.asarray(tracks.position)[later]
    facing = np.asarray(tracks.facing)[later]
    present = np.asarray(tracks.present)[later]
    return overlap(position, facing, present, context.model.forces.walking)


def press(context: CheckContext) -> CheckResult:
    """How deep bodies overlap in a crowd before a door, and its flow, from a walk to a rush."""
    seeds = range(1 if context.quick else SEEDS)
    cases = list(itertools.product(HURRIES, seeds))
    scenes = [before_door(1.0, crowd_in_room(seed), speed, 150.0) for speed, seed in cases]
    captions = ["" if seed else f"{speed:g} m/s" for speed, seed in cases]
    recorded = context.simulate(scenes, captions)

    # Of each speed: the deepest overlap of all crowds, and their mean flow.
    depths = [_overlap(context, tracks) for tracks in recorded]
    depths = np.reshape(depths, (len(HURRIES), -1)).max(1)
    flows = [flow(times) for times in first_gate_times(scenes, recorded)]
    rates = np.nan_to_num(flows).reshape(len(HURRIES), -1).mean(1)

    saturated = rates[-1] <= SATURATED * rates[-2]
    passes_through = rates.min() > 0.0
    return result(
        bool(depths[0] <= DEPTH and saturated and passes_through),
        f"bodies overlap by {listing(1000 * depths, form='.0f')} mm at most, {listing(rates)} people/s at "
        f"{listing(HURRIES, form='g')} m/s",
        f"{1000 * DEPTH:g} mm at most at {HURRIES[0]:g} m/s; at {HURRIES[-1]:g} m/s at most {SATURATED:g} times the "
        f"flow at {HURRIES[-2]:g} m/s",
        numbers=by_name("overlap_", HURRIES, depths) | by_name("flow_", HURRIES, rates),
        curves=(curve("model", HURRIES, rates), level("1.9 w", HURRIES, FLOW)),
        axes=("preferred speed [m/s]", "flow [people/s]"),
    )


def crowd_before_bottleneck(number: int, width: float) -> Scene:
    """A crowd in a half circle at 3 people/m² before an open bottleneck 1 m long, as in project Hermes."""
    density = CROWD["density_at_start"]
    reach = np.sqrt(2.0 * number / (np.pi * density))
    square = spread((-reach, -reach), (-0.2, reach), round(2.0 * reach**2 * density))
    distance = np.hypot(*square.T)
    start = square[np.argsort(distance)[:number]]

    entry = gate_right(0.0, -width / 2, width / 2)
    behind = gate_right(4.0, -6.0, 6.0)
    walls = np.concatenate(_both_sides(1.0, width / 2, reach + 4.0))
    people = walkers(start, route=(0, 1), speed=hermes_speeds(len(start), 0))
    return Scene(walls, people, (entry, behind), 150.0)


def crowd(context: CheckContext) -> CheckResult:
    """The density of a large crowd before a wide bottleneck, and its flow."""
    scene = crowd_before_bottleneck(round(CROWD["people"]), CROWD["width"])
    (tracks,) = context.simulate(scene, f"{CROWD['people']:g} people")
    density = _density(tracks)
    deep = _overlap(context, tracks)
    times = crossing_times(tracks, scene.gates[0])
    rate = float(np.nan_to_num(flow(times)))
    inside = int(np.isinf(times).sum())
    return result(
        density >= DENSE and inside == 0,
        f"{density:.1f} people/m² before the bottleneck, {rate:.2f} people/s (measured {CROWD['density']:g} and "
        f"{CROWD['flow']:g}), {inside} left inside; bodies overlap by {1000 * deep:.0f} mm at most",
        f"{DENSE:g} people/m² or more, all out",
        numbers={"density": density, "flow": rate, "inside": float(inside), "overlap": deep},
    )


def doors(context: CheckContext) -> CheckResult:
    """One person alone walks through a door."""
    # A person in the middle sees posts of equal force; one aside has to walk around a post.
    cases = list(itertools.product(DOORS, ASIDE))
    scenes = []
    captions = []
    for width, aside in cases:
        start = np.array([[-4.0, aside]])
        scenes.append(before_door(width, start, FREE, 12.0, velocity=(FREE, 0.0)))
        captions.append("" if aside else f"{width:g} m")
    recorded = context.simulate(scenes, captions)

    # The worst of the starts decides for each width.
    least = dict.fromkeys(DOORS, 1.0)
    through = dict.fromkeys(DOORS, True)
    for (width, _), tracks in zip(cases, recorded, strict=True):
        share, passed = _walk_through(tracks)
        least[width] = min(least[width], share)
        through[width] &= passed

    # Doors from 1.3 shoulder widths on cost people 0.12 to 0.16 m/s (K. Wilmut & A. Barnett); bodies block others.
    blocked = [width for width in DOORS if not through[width]]
    slow = [width for width in DOORS if width >= SWIFT and least[width] < SWIFT_SHARE]

    words = "through all"
    if blocked:
        words = f"through all but {listing(blocked, form='g')} m"
    shares = listing([100 * share for share in least.values()], form=".0f")
    speeds = [FREE * share for share in least.values()]
    criterion = level("criterion", (SWIFT, DOORS[-1]), SWIFT_SHARE)

    # A model may refuse the narrowest doors, but no door that people pass every day.
    return result(
        not slow and all(width < PASSABLE for width in blocked),
        f"{words}; at {listing(DOORS, form='g')} m never below {shares} % of the free speed",
        f"through from {PASSABLE:g} m on, never below {100 * SWIFT_SHARE:.0f} % of the free speed from {SWIFT:g} m on",
        numbers=by_name("least_speed_", DOORS, speeds) | by_name("through_", DOORS, through.values()),
        curves=(curve("model", DOORS, least.values()), criterion),
        axes=("width of the door [m]", "least speed / free speed"),
    )


def _walk_through(tracks: Tracks) -> tuple[float, bool]:
    """The least speed of one person until 1 m behind the door, over the free speed, and whether they got through."""
    position = np.asarray(tracks.position)[:, 0]  # (T, 2) m
    present = np.asarray(tracks.present)[:, 0]  # (T,)

    moments = present[1:]
    step = np.linalg.norm(np.diff(position, axis=0), axis=-1)
    speed = step[moments] / tracks.time_step
    near = position[1:][moments, 0] < 1.0
    least = float((speed[near] / FREE).min())
    through = bool((position[present, 0] > 0.5).any())
    return least, through
