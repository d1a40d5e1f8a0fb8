"""The tests of the guidelines RiMEA, IMO, NIST and ISO: one function for each kind of test."""

import itertools
from collections.abc import Sequence

import numpy as np
from scipy import stats

from sean_jax.core.geometry import signed_distances_on_host
from sean_jax.people.recordings import Tracks
from sean_jax.studies.scenes import Scene, environment
from sean_jax.studies.validation import crowds, guideline_scenes
from sean_jax.studies.validation.checks import (
    CheckContext,
    CheckResult,
    Curve,
    by_name,
    curve,
    listing,
    reference,
    result,
)
from sean_jax.studies.validation.guideline_scenes import gate_right
from sean_jax.studies.validation.measures import (
    crossing_times,
    densities,
    first_gate_times,
    flow,
    speeds,
    steps_along,
    vanishing_times,
)

AGES = {"under 30": (0.58, 1.61), "30 to 50": (1.41, 1.54), "over 50": (0.68, 1.41), "limited": (0.46, 0.76)}
"""age -> lowest and highest speed [m/s]: RiMEA, test 7"""
PENETRATION = 1e-3  # m, NIST TN 1822
KEPT = 0.05  # m/s, by which a free speed may differ from the preferred one
EVACUATED = 1.7, 2.3  # times as long with half the doors: "about double", the limits are ours
SLACK = 0.03  # m/s, by which a mean speed may seem to rise from one density to the next; ours
DRAWS = 5  # of people in two rooms
QUEUES = ((8.0, 4.0), (10.0, 6.0)), ((23.0, 4.0), (25.0, 6.0))  # m, squares before the passage and before the exit
JAM = 0.5  # share of the speed at the lowest density that is left at the highest, at most; ours


def walk_time(context: CheckContext, speed: float, shortest: float, longest: float) -> CheckResult:
    """The time in which one person of a preferred speed [m/s] walks 40 m, with bounds [s]."""
    (tracks,) = context.simulate(guideline_scenes.one_walker(speed), f"one person at {speed:g} m/s")
    time = float(vanishing_times(tracks)[0])
    passed = shortest <= time <= longest
    return result(passed, f"{time:.1f} s", f"{shortest:g} to {longest:g} s", numbers={"time": time})


def free_speed(context: CheckContext) -> CheckResult:
    """The speed of one person over 40 m, with 10 m before and behind."""
    (tracks,) = context.simulate(guideline_scenes.one_walker(1.0, 60.0), "one person at 1 m/s")
    begin = crossing_times(tracks, gate_right(10.0, 0.0, 2.0))[0]
    end = crossing_times(tracks, gate_right(50.0, 0.0, 2.0))[0]
    speed = 0.0
    if np.isfinite(end):
        speed = 40.0 / float(end - begin)
    return result(abs(speed - 1.0) <= KEPT, f"{speed:.3f} m/s", "1.0 ± 0.05 m/s", numbers={"speed": speed})


def falling_speed(context: CheckContext) -> CheckResult:
    """Speed against density in a periodic corridor of 26 by 2 m, in three squares of 4 m2, after the first 10 s."""
    densities = (0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    if context.quick:
        densities = (0.5, 1.0, 2.0, 4.0)
    scenes = [guideline_scenes.ring(26.0, 2.0, round(52 * density), 70.0) for density in densities]
    captions = [f"{density:g} people/m²" for density in densities[:3]]
    recorded = context.simulate(scenes, captions)
    means = [speed_in_squares(tracks, 26.0) for tracks in recorded]

    falls = np.diff(means).max() <= SLACK
    jams = means[-1] <= JAM * means[0]
    forwards = min(means) >= -SLACK
    passed = falls and jams and forwards
    return _by_density(passed, densities, means, "falling, to half or less, and nobody pushed backwards")


def _by_density(passed: bool, densities: Sequence[float], means: list[float], criterion: str) -> CheckResult:
    """The result of mean speeds [m/s] at densities [1/m2], against the fundamental diagram of Weidmann (1993)."""
    known = np.arange(0.25, 5.3, 0.25)
    weidmann = reference("Weidmann 1993", known.tolist(), crowds.weidmann(known).tolist())
    return result(
        passed,
        f"{listing(means, densities)} /m²",
        criterion,
        numbers=by_name("speed at ", densities, means),
        curves=(curve("speed", densities, means), weidmann),
        axes=("density [1/m²]", "mean speed [m/s]"),
    )


def speed_in_squares(tracks: Tracks, period: float) -> float:
    """The mean speed [m/s] along x in three squares of 2 by 2 m, spread over a periodic corridor, after 10 s."""
    middles = 0.25 * period, 0.5 * period, 0.75 * period
    step = _steps_near(tracks, period, middles, 1.0)
    if not len(step):
        return 0.0
    return float((step / tracks.time_step).mean())


def speed_in_zone(tracks: Tracks, period: float) -> float:
    """The mean speed [m/s] along x in the middle third of a periodic corridor, after 10 s."""
    step = _steps_near(tracks, period, (period / 2,), period / 6)
    return float(step.mean() / tracks.time_step)


def _steps_near(tracks: Tracks, period: float, middles: Sequence[float], reach: float) -> np.ndarray:
    """(K,) m along x between two moments, after 10 s, of people within a reach of one of the middles [m]."""
    begin = round(10.0 / tracks.time_step)
    x = np.asarray(tracks.position, float)[begin:, :, 0]
    present = np.asarray(tracks.present)[begin:]
    inside = np.zeros(x[:-1].shape, bool)  # (T - 1, N)
    for middle in middles:
        inside |= np.abs(x[:-1] - middle) < reach
    return steps_along(x, period)[inside & present[:-1]]


def reaction_times(context: CheckContext) -> CheckResult:
    """How far from their own reaction time ten people begin to walk."""
    scene = guideline_scenes.reactions()
    (tracks,) = context.simulate(scene, "ten people with reaction times")

    # Some begin right behind others who still wait, and walk slowly until they are past them.
    walking = speeds(tracks) >= 0.25 * np.asarray(scene.walkers.preferred_speed)[None]  # (T - 1, N)
    begin = np.where(walking.any(0), walking.argmax(0) * tracks.time_step, np.inf)
    late = begin - np.asarray(scene.walkers.reaction_time)
    worst = float(np.abs(late).max())
    numbers = {"largest difference": worst}
    return result(worst <= 0.5, f"within {worst:.2f} s of their reaction times", "within 0.5 s", numbers=numbers)


def around_a_corner(context: CheckContext) -> CheckResult:
    """Whether twenty people get around a corner, and how deep bodies enter walls on the way."""
    scene = guideline_scenes.corner()
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
    places = np.asarray(tracks.position)[np.asarray(tracks.present)]  # (K, 2) m
    walls = environment(scene.walls)
    distance = np.asarray(signed_distances_on_host(walls, places)[0])
    return float(radius - distance.min(initial=np.inf))


def free_speeds(context: CheckContext) -> CheckResult:
    """Free speeds of fifty people of four ages, and their preferred ones."""
    generator = np.random.default_rng(7)
    ages = list(AGES.values()) * 13
    low, high = np.transpose(ages[:50])
    preferred = generator.uniform(low, high)
    walked = _walked(context, preferred, "fifty people of four ages")
    worst = float(np.abs(walked - preferred).max())
    words = []
    for k, age in enumerate(AGES):
        of_age = walked[k::4]
        words.append(f"{age} {of_age.min():.2f} to {of_age.max():.2f}")
    return result(
        worst <= KEPT,
        f"{', '.join(words)} m/s, {worst:.3f} from their own at most",
        "within 0.05 m/s of their own",
        numbers={"largest difference": worst},
        curves=(curve("people", preferred.tolist(), walked.tolist(), points=True),),
        axes=("preferred speed [m/s]", "walked [m/s]"),
    )


def normal_speeds(context: CheckContext) -> CheckResult:
    """Free speeds of a hundred people whose preferred ones are normal, with mean 1.2 and deviation 0.2 m/s."""
    normal = stats.norm(1.2, 0.2)
    quantiles = normal.ppf((np.arange(100) + 0.5) / 100)
    preferred = np.random.default_rng(7).permutation(quantiles)
    walked = _walked(context, preferred, "a hundred people")
    mean = float(walked.mean())
    deviation = float(walked.std())
    likely = float(stats.kstest(walked, normal.cdf).pvalue)
    return result(
        likely > 0.05,
        f"mean {mean:.3f}, deviation {deviation:.3f} m/s, Kolmogorov-Smirnov p = {likely:.2f}",
        "p > 0.05",
        numbers={"mean": mean, "deviation": deviation, "p": likely},
    )


def _walked(context: CheckContext, preferred: np.ndarray, caption: str) -> np.ndarray:
    """(N,) m/s between x = 10 and 30 m; 0 of people who did not get there."""
    (tracks,) = context.simulate(guideline_scenes.population(preferred), caption)
    begin = crossing_times(tracks, gate_right(10.0, -1e3, 1e3))
    end = crossing_times(tracks, gate_right(30.0, -1e3, 1e3))
    arrived = np.isfinite(end)
    return np.where(arrived, 20.0 / np.where(arrived, end - begin, 1.0), 0.0)


def half_the_doors(context: CheckContext) -> CheckResult:
    """How much longer 1000 people take to leave a hall through two doors than through four."""
    scenes = [guideline_scenes.hall(1000, doors) for doors in (4, 2)]
    captions = ["1000 people, four doors", "1000 people, two doors"]
    four, two = context.simulate(scenes, captions)
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
    time = np.arange(len(inside)) * 20 * tracks.time_step
    return curve(name, time.tolist(), inside.tolist())


def assigned_exits(context: CheckContext) -> CheckResult:
    """How many of 23 people in twelve cabins leave by the exit that they are assigned."""
    scene = guideline_scenes.cabins()
    (tracks,) = context.simulate(scene, "twelve cabins")
    out = np.isfinite(vanishing_times(tracks))
    to_main = np.asarray(tracks.position)[-1, :, 0] < 9.0
    assigned_main = np.asarray(scene.walkers.route)[:, 1] == 12
    right = int((out & (to_main == assigned_main)).sum())
    people = len(out)
    return result(right == people, f"{right} of {people} as assigned", "all", numbers={"right": float(right)})


def exit_choice(context: CheckContext, numbers: Sequence[int], fewest: float, most: float) -> CheckResult:
    """The share of people who take the nearer of two exits, with bounds."""
    scenes = [guideline_scenes.two_exits(number) for number in numbers]
    recorded = context.simulate(scenes, [f"{number} people" for number in numbers])
    shares = []
    for number, tracks in zip(numbers, recorded, strict=True):
        out = np.isfinite(vanishing_times(tracks))
        if not out.all():
            inside = f"{int((~out).sum())} of {number} people are still inside after 900 s"
            return CheckResult(False, inside, inside)
        nearer = np.asarray(tracks.position)[-1, :, 0] < 22.0
        shares.append(float(nearer.mean()))

    words = []
    for share, number in zip(shares, numbers, strict=True):
        words.append(f"{100 * share:.0f} % of {number} took the nearer exit")
    criterion = f"{100 * fewest:.0f} to {100 * most:.0f} % of {numbers[-1]}"
    passed = fewest <= shares[-1] <= most
    return result(passed, ", ".join(words), criterion, numbers=by_name("share of ", numbers, shares))


def equal_exits(context: CheckContext) -> CheckResult:
    """The share of people who take the left of two equal exits, beginning in the middle."""
    (tracks,) = context.simulate(guideline_scenes.equal_exits(200), "200 people, two equal exits")
    out = np.isfinite(vanishing_times(tracks))
    to_left = np.asarray(tracks.position)[-1, :, 0] < 10.0
    share = float((out & to_left).sum() / max(out.sum(), 1))
    measured = f"{100 * share:.0f} % took the left one, {int((~out).sum())} are still inside"
    passed = bool(out.all()) and abs(share - 0.5) <= 0.1
    return result(passed, measured, "40 to 60 %, all out", numbers={"share": share})


def one_after_another(context: CheckContext) -> CheckResult:
    """Flow into a passage and out of the room behind it, and where people queue."""
    widths = (0.8, 1.0, 1.2)
    seeds = range(1 if context.quick else DRAWS)
    cases = list(itertools.product(widths, seeds))
    scenes = [guideline_scenes.two_rooms(width, seed) for width, seed in cases]
    captions = [f"passage of {width:g} m" if seed == 0 else "" for width, seed in cases]
    recorded = context.simulate(scenes, captions)

    # Of each width, means of all draws: flows, and densities before the passage and before the exit.
    rows = []
    for scene, tracks in zip(scenes, recorded, strict=True):
        times = crossing_times(tracks, scene.gates[0])
        in_first, in_second = (density(tracks, *square, times) for square in QUEUES)
        rows.append((flow(times), flow(vanishing_times(tracks)), in_first, in_second))
    means = np.reshape(rows, (len(widths), len(seeds), 4)).mean(1)
    into, out, first, second = means.T

    rises = bool((np.diff(into) > 0.0).all())
    steady = bool((out <= into + 0.05).all())
    queues_first = bool((second < first).all())

    words = []
    for width, rate_in, rate_out in zip(widths, into, out, strict=True):
        words.append(f"{rate_in:.2f} in and {rate_out:.2f} out at {width:g} m")
    queues = f"{max(first):.1f} people/m² before the passage, {max(second):.1f} before the exit"
    return _by_width(
        rises and steady and queues_first,
        f"flow {', '.join(words)} people/s; {queues}",
        "flow rises with the width, at most .05 more comes out than goes in, and people queue in the first room alone",
        by_name("flow at ", widths, into),
        curve("into the passage", widths, into),
    )


def _by_width(passed: bool, measured: str, criterion: str, numbers: dict[str, float], flows: Curve) -> CheckResult:
    """The result of a flow [people/s] by width [m], against bottlenecks in Juelich."""
    known = reference("1.9 w (Juelich)", flows.x, [1.9 * width for width in flows.x])
    axes = ("width [m]", "flow [people/s]")
    return result(passed, measured, criterion, numbers=numbers, curves=(flows, known), axes=axes)


def density(tracks: Tracks, lower: tuple[float, float], upper: tuple[float, float], times: np.ndarray) -> float:
    """The mean density [1/m2] in a rectangle from ``lower`` to ``upper`` [m] during the middle 60 % of crossings.

    Args:
        times: (N,) s of the crossings, inf of none; if there are none at all, the whole time counts.
    """
    crossed = times[np.isfinite(times)]
    begin = 0.0
    end = np.inf
    if len(crossed):
        begin, end = np.quantile(crossed, [0.2, 0.8])
    time = np.arange(len(tracks.present)) * tracks.time_step
    series = densities(np.asarray(tracks.position), np.asarray(tracks.present), lower, upper)
    during = (time >= begin) & (time <= end)
    chosen = series[during]
    if not len(chosen):
        return 0.0
    return float(chosen.mean())


def ways(context: CheckContext) -> CheckResult:
    """How long 500 people take along a short way, around a corner and along a long way."""
    scenes = guideline_scenes.wide_ways()
    recorded = context.simulate([*scenes.values()], [*scenes])
    times = {}
    for name, tracks in zip(scenes, recorded, strict=True):
        times[name] = float(vanishing_times(tracks).max())
    measured = ", ".join(f"{name} {time:.1f} s" for name, time in times.items())
    passed = times["short"] < times["corner"] < times["long"] < np.inf
    return result(passed, measured, "short before corner before long", numbers=times)


def against(context: CheckContext) -> CheckResult:
    """How long 100 people take through a corridor against 0, 10, 50 and 100 others."""
    others = (0, 10, 50, 100)
    scenes = [guideline_scenes.counterflow(number) for number in others]
    recorded = context.simulate(scenes, [f"against {number}" for number in others])
    times = []
    for scene, tracks in zip(scenes, recorded, strict=True):
        crossings = crossing_times(tracks, scene.gates[1])[:100]
        times.append(float(crossings.max()))

    words = []
    for time, number in zip(times, others, strict=True):
        duration = f"{time:.0f} s" if np.isfinite(time) else "stuck"
        words.append(f"{duration} against {number}")
    rises = all(before < after for before, after in itertools.pairwise(times))
    return result(
        rises and times[-1] < np.inf,
        ", ".join(words),
        "all through, later the more there are",
        numbers=by_name("against ", others, times),
        curves=(curve("time", map(float, others), times),),
        axes=("people against", "time [s]"),
    )


def most_flow(context: CheckContext) -> CheckResult:
    """The flow of 100 people out of a room of 8 by 5 m through a door of 1 m."""
    scene = guideline_scenes.full_room()
    (tracks,) = context.simulate(scene, "100 people, a door of 1 m")
    times = crossing_times(tracks, scene.gates[0])
    rate = float(flow(times))
    inside = int((~np.isfinite(times)).sum())
    if inside:
        reason = f"{inside} of 100 people are still inside after 300 s"
        return CheckResult(False, f"{inside} of 100 are still inside", reason)
    reason = "" if rate <= 1.33 else "; recordings of people have 1.9 per second and metre (Seyfried 2009)"
    criterion = f"1.33 people/s at most{reason}"
    return result(rate <= 1.33, f"{rate:.2f} people/s", criterion, numbers={"flow": rate})


def rising_flow(context: CheckContext) -> CheckResult:
    """Flow through doors of 1.0 to 1.8 m."""
    widths = (1.0, 1.2, 1.4, 1.6, 1.8)
    scenes = [guideline_scenes.full_room(width) for width in widths]
    recorded = context.simulate(scenes, [f"door of {widths[0]:g} m"])
    rates = [flow(times) for times in first_gate_times(scenes, recorded)]
    line = np.polyfit(widths, np.nan_to_num(rates), 1)
    slope = float(line[0])
    return _by_width(
        slope > 0.0 and bool(np.isfinite(rates).all()),
        f"{listing(rates, widths, unit=' m')}: {slope:.2f} people/s/m",
        "flow that rises with the width",
        {"slope": slope},
        curve("flow", widths, rates),
    )


def slower_in_crowds(context: CheckContext) -> CheckResult:
    """Speed in a zone of a corridor of 60 by 2 m with 60 to 480 people, who would all walk at 1.2 m/s if alone."""
    free = 1.2
    numbers = (60, 120, 240, 360, 480)
    if context.quick:
        numbers = (60, 120, 240)
    scenes = [guideline_scenes.ring(60.0, 2.0, number, 60.0, speed=free) for number in numbers]
    recorded = context.simulate(scenes, [f"{numbers[0]} people"])
    means = [speed_in_zone(tracks, 60.0) for tracks in recorded]
    densities = [number / 120.0 for number in numbers]
    return _by_density(max(means) <= free + KEPT, densities, means, "never above 1.25 m/s")


def group_together(context: CheckContext) -> CheckResult:
    """How far apart in time the members of a group of five arrive, one of whom is slow."""
    (tracks,) = context.simulate(guideline_scenes.group(), "a group of five")
    times = vanishing_times(tracks)
    apart = float("inf")
    if np.isfinite(times).all():
        apart = float(times.max() - times.min())
    return result(apart <= 10.0, f"{apart:.1f} s between first and last", "10 s at most", numbers={"apart": apart})


def queue(context: CheckContext) -> CheckResult:
    """Where people queue before a passage: in the room before it, not in the passage or behind it."""
    scene = guideline_scenes.two_rooms(1.0)
    (tracks,) = context.simulate(scene, "150 people before a passage of 1 m")
    times = crossing_times(tracks, scene.gates[0])
    before = density(tracks, (8.0, 4.0), (10.0, 6.0), times)
    inside = density(tracks, (10.5, 4.5), (14.5, 5.5), times)
    behind = density(tracks, (15.0, 4.0), (17.0, 6.0), times)
    measured = f"{before:.1f} people/m² before the passage, {inside:.1f} in it, {behind:.1f} behind it"
    numbers = {"before": before, "inside": inside, "behind": behind}
    passed = bool(np.isfinite(times).all()) and before > inside and before > behind
    return result(passed, measured, "more before it than in it and behind it, and all through", numbers=numbers)
