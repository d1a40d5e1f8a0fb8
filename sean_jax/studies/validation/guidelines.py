"""The tests of the guidelines RiMEA, IMO, NIST and ISO: one function for each kind of test."""

from collections.abc import Sequence

import numpy as np
from scipy import stats

from sean_jax.geometry import signed_distances_on_host
from sean_jax.recordings import Tracks
from sean_jax.studies.scenes import Gate, Scene, environment
from sean_jax.studies.validation import crowds, plans
from sean_jax.studies.validation.check import CheckContext, CheckResult, Curve, result
from sean_jax.studies.validation.measures import crossing_times, flow, speeds, vanishing_times

AGES = {"under 30": (0.58, 1.61), "30 to 50": (1.41, 1.54), "over 50": (0.68, 1.41), "limited": (0.46, 0.76)}
"""age -> lowest and highest speed [m/s]: RiMEA, test 7"""
PENETRATION = 1e-3  # m, NIST TN 1822
KEPT = 0.05  # m/s, by which a free speed may differ from the preferred one
EVACUATED = 1.7, 2.3  # times as long with half the doors: "about double", the limits are ours
SLACK = 0.03  # m/s, by which a mean speed may seem to rise from one density to the next; ours
JAM = 0.5  # share of the speed at the lowest density that is left at the highest, at most; ours
OCCUPIED = 4.0  # m2, of the squares in which density is measured


def walk_time(context: CheckContext, speed: float, shortest: float, longest: float) -> CheckResult:
    """The time in which one person of a preferred speed [m/s] walks 40 m, with bounds [s]."""
    (tracks,) = context.simulate(plans.one_walker(speed), f"one person at {speed:g} m/s")
    time = float(vanishing_times(tracks)[0])
    passed = shortest <= time <= longest
    return result(passed, f"{time:.1f} s", f"{shortest:g} to {longest:g} s", numbers={"time": time})


def free_speed(context: CheckContext) -> CheckResult:
    """The speed of one person over 40 m, with 10 m before and behind."""
    (tracks,) = context.simulate(plans.one_walker(1.0, 0.0, 60.0), "one person at 1 m/s")
    begin, end = (crossing_times(tracks, Gate((x, 2.0), (x, 0.0)))[0] for x in (10.0, 50.0))
    speed = 40.0 / float(end - begin) if np.isfinite(end) else 0.0
    return result(abs(speed - 1.0) <= KEPT, f"{speed:.3f} m/s", "1.0 ± 0.05 m/s", numbers={"speed": speed})


def falling_speed(context: CheckContext) -> CheckResult:
    """Speed against density in a periodic corridor of 26 by 2 m, in three squares of 4 m2, after the first 10 s."""
    densities = (0.5, 1.0, 2.0, 4.0) if context.quick else (0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    scenes = [plans.ring(26.0, 2.0, round(52 * density), 70.0) for density in densities]
    captions = [f"{density:g} people/m²" for density in densities[:3]]
    means = [speed_in_squares(tracks, 26.0) for tracks in context.simulate(scenes, captions)]
    rises = max(after - before for before, after in zip(means, means[1:], strict=False))
    measured = ", ".join(f"{speed:.2f} at {density:g}" for density, speed in zip(densities, means, strict=True))
    return result(
        rises <= SLACK and means[-1] <= JAM * means[0] and min(means) >= -SLACK,
        f"{measured} /m²",
        "falling, to half or less, and nobody pushed backwards",
        numbers={f"speed at {density:g}": speed for density, speed in zip(densities, means, strict=True)},
        curves=(Curve("speed", densities, tuple(means)), _weidmann()),
        axes=("density [1/m²]", "mean speed [m/s]"),
    )


def _weidmann() -> Curve:
    """The fundamental diagram of Weidmann (1993), from 0.25 to 5.25 people/m2."""
    density = np.arange(0.25, 5.3, 0.25)
    return Curve("Weidmann 1993", tuple(density.tolist()), tuple(crowds.weidmann(density).tolist()), reference=True)


def speed_in_squares(tracks: Tracks, period: float, first: float = 10.0) -> float:
    """The mean speed [m/s] along x in three squares of 2 by 2 m, spread over a periodic corridor, after ``first`` s."""
    begin = int(first / tracks.time_step)
    x, present = np.asarray(tracks.position, float)[begin:, :, 0], np.asarray(tracks.present)[begin:]
    step = np.diff(x, axis=0)
    step -= period * np.round(step / period)
    inside = np.zeros(step.shape, bool)
    for middle in (0.25 * period, 0.5 * period, 0.75 * period):
        inside |= np.abs(x[:-1] - middle) < 1.0
    speed = step[inside & present[:-1]] / tracks.time_step
    return float(speed.mean()) if len(speed) else 0.0


def reaction_times(context: CheckContext) -> CheckResult:
    """How far from their own reaction time ten people begin to walk."""
    scene = plans.reactions()
    (tracks,) = context.simulate(scene, "ten people with reaction times")
    walking = speeds(tracks) >= 0.5 * np.asarray(scene.walkers.preferred_speed)[None]
    begin = np.where(walking.any(0), walking.argmax(0) * tracks.time_step, np.inf)
    late = begin - np.asarray(scene.walkers.reaction_time)
    worst = float(np.abs(late).max())
    numbers = {"largest difference": worst}
    return result(worst <= 0.5, f"within {worst:.2f} s of their reaction times", "within 0.5 s", numbers=numbers)


def around_a_corner(context: CheckContext) -> CheckResult:
    """Whether twenty people get around a corner, and how deep bodies enter walls on the way."""
    scene = plans.corner()
    (tracks,) = context.simulate(scene, "twenty people around a corner")
    deepest = penetration(scene, tracks, float(context.model.forces.walking.radius))
    through = int(np.isfinite(vanishing_times(tracks)).sum())
    return result(
        deepest <= PENETRATION and through == 20,
        f"{through} of 20 through, bodies at most {1000 * max(deepest, 0.0):.2f} mm inside a wall",
        "all 20, at most 1 mm",
        numbers={"through": float(through), "penetration": deepest},
    )


def penetration(scene: Scene, tracks: Tracks, radius: float) -> float:
    """How deep a body of a radius [m] was inside a wall [m]; negative if nobody touched one."""
    places = np.asarray(tracks.position)[np.asarray(tracks.present)]
    distance = np.asarray(signed_distances_on_host(environment(scene.walls), places)[0])
    return float(radius - distance.min(initial=np.inf))


def free_speeds(context: CheckContext) -> CheckResult:
    """Free speeds of fifty people of four ages, and their preferred ones."""
    generator = np.random.default_rng(7)
    groups = list(AGES.values()) * 13
    preferred = np.array([generator.uniform(low, high) for low, high in groups[:50]])
    walked = _walked(context, preferred, "fifty people of four ages")
    worst = float(np.abs(walked - preferred).max())
    measured = ", ".join(f"{age} {walked[k::4].min():.2f} to {walked[k::4].max():.2f}" for k, age in enumerate(AGES))
    return result(
        worst <= KEPT,
        f"{measured} m/s, {worst:.3f} from their own at most",
        "within 0.05 m/s of their own",
        numbers={"largest difference": worst},
        curves=(Curve("people", tuple(preferred.tolist()), tuple(walked.tolist()), points=True),),
        axes=("preferred speed [m/s]", "walked [m/s]"),
    )


def normal_speeds(context: CheckContext) -> CheckResult:
    """Free speeds of a hundred people whose preferred ones are normal, with mean 1.2 and deviation 0.2 m/s."""
    preferred = np.random.default_rng(7).permutation(stats.norm(1.2, 0.2).ppf((np.arange(100) + 0.5) / 100))
    walked = _walked(context, preferred, "a hundred people")
    mean, deviation = float(walked.mean()), float(walked.std())
    likely = float(stats.kstest(walked, stats.norm(1.2, 0.2).cdf).pvalue)
    return result(
        likely > 0.05,
        f"mean {mean:.3f}, deviation {deviation:.3f} m/s, Kolmogorov-Smirnov p = {likely:.2f}",
        "p > 0.05",
        numbers={"mean": mean, "deviation": deviation, "p": likely},
    )


def _walked(context: CheckContext, preferred: np.ndarray, caption: str) -> np.ndarray:
    """(N,) m/s between x = 10 and 30 m; 0 of people who did not get there."""
    (tracks,) = context.simulate(plans.population(preferred), caption)
    ends = (1e3, -1e3)
    begin, end = (crossing_times(tracks, Gate((x, ends[0]), (x, ends[1]))) for x in (10.0, 30.0))
    return np.where(np.isfinite(end), 20.0 / np.where(np.isfinite(end), end - begin, 1.0), 0.0)


def half_the_doors(context: CheckContext) -> CheckResult:
    """How much longer 1000 people take to leave a hall through two doors than through four."""
    four, two = context.simulate(
        [plans.hall(1000, 4), plans.hall(1000, 2)], ["1000 people, four doors", "1000 people, two doors"]
    )
    times = [float(vanishing_times(tracks).max()) for tracks in (four, two)]
    inside = [int(np.asarray(tracks.present)[-1].sum()) for tracks in (four, two)]
    if any(inside):
        what = f"{inside[0]} and {inside[1]} people are still inside after 900 s"
        return CheckResult(False, what, f"with four and two doors {what}")
    ratio = times[1] / times[0]
    return result(
        EVACUATED[0] <= ratio <= EVACUATED[1],
        f"{times[0]:.0f} s with four doors, {times[1]:.0f} s with two: {ratio:.2f} times",
        "about twice, 1.7 to 2.3 times",
        numbers={"four": times[0], "two": times[1], "ratio": ratio},
        curves=(_leaving("four doors", four), _leaving("two doors", two)),
        axes=("time [s]", "people inside"),
    )


def _leaving(name: str, tracks: Tracks) -> Curve:
    inside = np.asarray(tracks.present).sum(1)[::20]
    return Curve(name, tuple((np.arange(len(inside)) * 20 * tracks.time_step).tolist()), tuple(inside.tolist()))


def assigned_exits(context: CheckContext) -> CheckResult:
    """How many of 23 people in twelve cabins leave by the exit that they are assigned."""
    scene = plans.cabins()
    (tracks,) = context.simulate(scene, "twelve cabins")
    out = np.isfinite(vanishing_times(tracks))
    to_main = np.asarray(tracks.position)[-1, :, 0] < 9.0
    right = int((out & (to_main == (np.asarray(scene.walkers.route)[:, 1] == 12))).sum())
    return result(right == len(out), f"{right} of {len(out)} as assigned", "all", numbers={"right": float(right)})


def exit_choice(context: CheckContext, numbers: Sequence[int], fewest: float, most: float) -> CheckResult:
    """The share of people who take the nearer of two exits, with bounds."""
    exits = ((17.0, 18.0), (26.0, 27.0))
    scenes = [plans.two_exits(number, exits) for number in numbers]
    shares = []
    for number, tracks in zip(
        numbers, context.simulate(scenes, [f"{number} people" for number in numbers]), strict=True
    ):
        out = np.isfinite(vanishing_times(tracks))
        near = out & (np.asarray(tracks.position)[-1, :, 0] < 22.0)
        shares.append(float(near.sum() / max(out.sum(), 1)))
        if not out.all():
            what = f"{int((~out).sum())} of {number} people are still inside after 900 s"
            return CheckResult(False, what, what)
    parts = zip(shares, numbers, strict=True)
    measured = ", ".join(f"{100 * share:.0f} % of {number} took the nearer exit" for share, number in parts)
    criterion = f"{100 * fewest:.0f} to {100 * most:.0f} % of {numbers[-1]}"
    named = {f"share of {number}": share for share, number in zip(shares, numbers, strict=True)}
    return result(fewest <= shares[-1] <= most, measured, criterion, numbers=named)


def equal_exits(context: CheckContext) -> CheckResult:
    """The share of people who take the left of two equal exits, beginning in the middle."""
    (tracks,) = context.simulate(plans.equal_exits(200), "200 people, two equal exits")
    out = np.isfinite(vanishing_times(tracks))
    share = float((out & (np.asarray(tracks.position)[-1, :, 0] < 10.0)).sum() / max(out.sum(), 1))
    measured = f"{100 * share:.0f} % took the left one, {int((~out).sum())} are still inside"
    return result(
        bool(out.all()) and abs(share - 0.5) <= 0.1, measured, "40 to 60 %, all out", numbers={"share": share}
    )


def one_after_another(context: CheckContext) -> CheckResult:
    """Flow into a passage and out of the room behind it, and where people queue."""
    widths = (0.8, 1.0, 1.2)
    scenes = [plans.two_rooms(width) for width in widths]
    recorded = context.simulate(scenes, [f"passage of {width:g} m" for width in widths])
    into, out, first, second = [], [], [], []
    for scene, tracks in zip(scenes, recorded, strict=True):
        times = crossing_times(tracks, scene.gates[0])
        into.append(flow(times))
        out.append(flow(vanishing_times(tracks)))
        middle = (
            np.nanquantile(np.where(np.isfinite(times), times, np.nan), [0.2, 0.8]) if into[-1] == into[-1] else None
        )
        span = (0.0, 1e9) if middle is None else (float(middle[0]), float(middle[1]))
        first.append(density(tracks, (8.0, 4.0), (10.0, 6.0), span))
        second.append(density(tracks, (23.0, 4.0), (25.0, 6.0), span))
    flows = ", ".join(f"{a:.2f} in and {b:.2f} out at {w:g} m" for w, a, b in zip(widths, into, out, strict=True))
    queues = f"{max(first):.1f} people/m² before the passage, {max(second):.1f} before the exit"
    rises = all(after > before for before, after in zip(into, into[1:], strict=False))
    steady = all(b <= a + 0.05 for a, b in zip(into, out, strict=True))
    calm = all(b < a for a, b in zip(first, second, strict=True))
    return result(
        rises and steady and calm,
        f"flow {flows} people/s; {queues}",
        "flow rises with the width, at most .05 more comes out than goes in, and people queue in the first room alone",
        numbers={f"flow at {width:g}": value for width, value in zip(widths, into, strict=True)},
        curves=(
            Curve("into the passage", widths, tuple(into)),
            Curve("1.9 w (Juelich)", widths, tuple(1.9 * width for width in widths), reference=True),
        ),
        axes=("width [m]", "flow [people/s]"),
    )


def density(tracks: Tracks, lower: tuple[float, float], upper: tuple[float, float], span: tuple[float, float]) -> float:
    """The mean density [1/m2] in a rectangle from ``lower`` to ``upper`` [m], over a span of time [s]."""
    position, present = np.asarray(tracks.position), np.asarray(tracks.present)
    inside = present & (position >= np.asarray(lower)).all(-1) & (position <= np.asarray(upper)).all(-1)
    time = np.arange(len(present)) * tracks.time_step
    chosen = inside[(time >= span[0]) & (time <= span[1])]
    area = (upper[0] - lower[0]) * (upper[1] - lower[1])
    return float(chosen.sum(1).mean() / area) if len(chosen) else 0.0


def ways(context: CheckContext) -> CheckResult:
    """How long 500 people take along a short way, around a corner and along a long way."""
    scenes = plans.wide_ways()
    names = ("short", "corner", "long")
    recorded = context.simulate([scenes[name] for name in names], names)
    times = [float(vanishing_times(tracks).max()) for tracks in recorded]
    measured = ", ".join(f"{name} {time:.1f} s" for name, time in zip(names, times, strict=True))
    passed = times[0] < times[1] < times[2] < np.inf
    return result(passed, measured, "short before corner before long", numbers=dict(zip(names, times, strict=True)))


def against(context: CheckContext) -> CheckResult:
    """How long 100 people take through a corridor against 0, 10, 50 and 100 others."""
    others = (0, 10, 50, 100)
    scenes = [plans.counterflow(number) for number in others]
    recorded = context.simulate(scenes, [f"against {number}" for number in others])
    crossings = [crossing_times(tracks, scene.gates[1])[:100] for scene, tracks in zip(scenes, recorded, strict=True)]
    times = [float(times.max()) for times in crossings]
    words = [f"{time:.0f} s" if np.isfinite(time) else "stuck" for time in times]
    measured = ", ".join(f"{word} against {number}" for word, number in zip(words, others, strict=True))
    passed = all(before < after for before, after in zip(times, times[1:], strict=False)) and times[-1] < np.inf
    return result(
        passed,
        measured,
        "all through, later the more there are",
        numbers={f"against {number}": time for number, time in zip(others, times, strict=True)},
        curves=(Curve("time", tuple(map(float, others)), tuple(times)),),
        axes=("people against", "time [s]"),
    )


def most_flow(context: CheckContext) -> CheckResult:
    """The flow of 100 people out of a room of 8 by 5 m through a door of 1 m."""
    scene = plans.full_room()
    (tracks,) = context.simulate(scene, "100 people, a door of 1 m")
    out = crossing_times(tracks, scene.gates[0])
    rate, left = flow(out), int((~np.isfinite(out)).sum())
    if left:
        return CheckResult(
            False, f"{left} of 100 are still inside", f"{left} of 100 people are still inside after 300 s"
        )
    reason = "" if rate <= 1.33 else "; recordings of people have 1.9 per second and metre (Seyfried 2009)"
    criterion = f"1.33 people/s at most{reason}"
    return result(rate <= 1.33, f"{rate:.2f} people/s", criterion, numbers={"flow": rate})


def rising_flow(context: CheckContext) -> CheckResult:
    """Flow through doors of 1.0 to 1.8 m."""
    widths = (1.0, 1.2, 1.4, 1.6, 1.8)
    scenes = [plans.full_room(width) for width in widths]
    recorded = context.simulate(scenes, [f"door of {widths[0]:g} m"])
    rates = [flow(crossing_times(tracks, scene.gates[0])) for scene, tracks in zip(scenes, recorded, strict=True)]
    slope = float(np.polyfit(widths, np.nan_to_num(rates), 1)[0])
    measured = ", ".join(f"{rate:.2f} at {width:g} m" for rate, width in zip(rates, widths, strict=True))
    return result(
        slope > 0.0 and bool(np.isfinite(rates).all()),
        f"{measured}: {slope:.2f} people/s/m",
        "flow that rises with the width",
        numbers={"slope": slope},
        curves=(
            Curve("flow", widths, tuple(rates)),
            Curve("1.9 w (Juelich)", widths, tuple(1.9 * width for width in widths), reference=True),
        ),
        axes=("width [m]", "flow [people/s]"),
    )


def slower_in_crowds(context: CheckContext) -> CheckResult:
    """Speed in a zone of a corridor of 60 by 2 m with 60 to 480 people, who would all walk at 1.2 m/s if alone."""
    free = 1.2
    numbers = (60, 120, 240) if context.quick else (60, 120, 240, 360, 480)
    scenes = [plans.ring(60.0, 2.0, number, 60.0, speed=free) for number in numbers]
    means = [speed_in_zone(tracks, 60.0) for tracks in context.simulate(scenes, [f"{numbers[0]} people"])]
    densities = tuple(number / 120.0 for number in numbers)
    measured = ", ".join(f"{speed:.2f} at {density:g}" for speed, density in zip(means, densities, strict=True))
    return result(
        max(means) <= free + KEPT,
        f"{measured} /m²",
        "never above 1.25 m/s",
        numbers={f"speed at {density:g}": speed for density, speed in zip(densities, means, strict=True)},
        curves=(Curve("speed", densities, tuple(means)), _weidmann()),
        axes=("density [1/m²]", "mean speed [m/s]"),
    )


def speed_in_zone(tracks: Tracks, period: float, first: float = 10.0) -> float:
    """The mean speed [m/s] along x in the middle third of a periodic corridor, after ``first`` s."""
    begin = int(first / tracks.time_step)
    x = np.asarray(tracks.position, float)[begin:, :, 0]
    step = np.diff(x, axis=0)
    step -= period * np.round(step / period)
    return float(step[np.abs(x[:-1] - period / 2) < period / 6].mean() / tracks.time_step)


def group_together(context: CheckContext) -> CheckResult:
    """How far apart in time the members of a group of five arrive, one of whom is slow."""
    (tracks,) = context.simulate(plans.group(), "a group of five")
    times = vanishing_times(tracks)
    apart = float(times.max() - times.min()) if np.isfinite(times).all() else float("inf")
    return result(apart <= 10.0, f"{apart:.1f} s between first and last", "10 s at most", numbers={"apart": apart})


def queue(context: CheckContext) -> CheckResult:
    """Where people queue before a passage: in the room before it, not in the passage or behind it."""
    scene = plans.two_rooms(1.0)
    (tracks,) = context.simulate(scene, "150 people before a passage of 1 m")
    times = crossing_times(tracks, scene.gates[0])
    out = np.isfinite(times)
    span = tuple(np.quantile(times[out], [0.2, 0.8]).tolist()) if out.any() else (0.0, 1e9)
    before = density(tracks, (8.0, 4.0), (10.0, 6.0), span)
    inside = density(tracks, (10.5, 4.5), (14.5, 5.5), span)
    behind = density(tracks, (15.0, 4.0), (17.0, 6.0), span)
    measured = f"{before:.1f} people/m² before the passage, {inside:.1f} in it, {behind:.1f} behind it"
    numbers = {"before": before, "inside": inside, "behind": behind}
    passed = bool(out.all()) and before > inside and before > behind
    return result(passed, measured, "more before it than in it and behind it, and all through", numbers=numbers)
