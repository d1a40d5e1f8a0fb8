"""Checks of individuals: pairs of people, a robot that does not react, and prediction.

[V17] C. Vassallo et al., Gait & Posture 51, 97 (2017): people pass a robot that crosses their way at 0.83 ± 0.27 m,
and give way even if they would pass first.
[G18] A. Gupta et al., "Social GAN", CVPR 2018: windows, errors. [S20] C. Schoeller et al., IEEE RA-L 5(2), 2020:
constant velocity.
"""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sean_jax.core.data_types import Pedestrians, Scenario, State
from sean_jax.io.versions import fingerprint
from sean_jax.people.constant_velocity import constant_velocity
from sean_jax.people.recordings import Tracks
from sean_jax.robots import load
from sean_jax.social_forces import Cohesion, Forces, move, preset
from sean_jax.studies.prediction import HABITS, Predictable, Scores, evaluate, read_windows
from sean_jax.studies.scenes import Gate, Scene, join, spread, walkers
from sean_jax.studies.validation.checks import (
    PUBLISHED,
    CheckContext,
    CheckResult,
    curve,
    level,
    numbered,
    reference,
    result,
)
from sean_jax.studies.validation.measures import least_speed_share, separation, steps_along

BEFORE = 4.0  # s, after which two would be nearest if they went straight on
SPEEDS = (1.34, 1.34), (0.9, 1.7), (1.55, 1.2)  # m/s
OFFSETS = 0.0, 0.02, 0.1, -0.1, 0.2, 0.3, -0.3  # m, at which they would then pass
TOLERANCE = 1e-3  # m, of bodies that touch
ROBOT_SPEED = 1.0  # m/s
MISS = 0.6  # m, within which person and robot would pass
CLEARANCE = 0.83  # m [V17]
FROM_THE_RIGHT = 0.0, 1.0  # the robot's way, where people walk along x
HEAD_ON = -1.0, 0.0
NEARBY = 2.0  # m from a robot, where slowing counts
STREAM = 16.0, 5.0  # m along and across
STREAM_DENSITY = 0.35  # 1/m2
NO_WALLS = np.zeros((0, 5))
FAR = 1e4  # m


def two(angle: float, offset: float, speeds: tuple[float, float]) -> Scene:
    """Two people who would pass each other at an offset [m], positive on the right; the angle [rad] of their ways.

    Speeds are in m/s. The scene has no walls, and lasts twice as long as it takes them to meet.
    """
    ways = np.array([[1.0, 0.0], [np.cos(angle), np.sin(angle)]])
    drift = speeds[0] * ways[0] - speeds[1] * ways[1]
    aside = np.array([drift[1], -drift[0]]) / np.hypot(*drift)
    before = -BEFORE * np.array(speeds)[:, None] * ways
    start = before + 0.5 * offset * np.array([aside, -aside])  # (2, 2) m

    people = []
    gates = []
    for k, (speed, way) in enumerate(zip(speeds, ways, strict=True)):
        velocity = tuple(speed * way)
        people.append(walkers(start[k : k + 1], route=(k,), speed=speed, velocity=velocity))
        gates.append(_far(way))
    return Scene(NO_WALLS, join(*people), tuple(gates), 2.0 * BEFORE + 2.0)


def _far(way: np.ndarray) -> Gate:
    """A gate so far away and so wide that people walk straight on to it."""
    middle = FAR * way
    left = FAR * np.array([-way[1], way[0]])
    return Gate(tuple(middle + left), tuple(middle - left))


def pairs(context: CheckContext, name: str, angles: Sequence[float], quick: Sequence[float]) -> CheckResult:
    """Whether the bodies of two people ever overlap, at some angles between their ways [degrees].

    Args:
        quick: the angles with ``--quick``.
    """
    angles = tuple(quick if context.quick else angles)

    # Offsets include 0: two who meet head-on have no side to evade to, unless the model breaks the symmetry.
    cases = list(itertools.product(angles, OFFSETS, SPEEDS))

    # The film of an angle has an offset of 2 cm, because nobody meets others exactly head-on.
    scenes = []
    captions = []
    for angle, offset, speeds in cases:
        scenes.append(two(np.deg2rad(angle), offset, speeds))
        shown = offset == OFFSETS[1] and speeds == SPEEDS[0]
        captions.append(f"{name}, {angle:g} degrees" if shown else "")

    # People who stand still do not overlap, either: the time that they lose is told besides.
    bodies = 2.0 * float(context.model.forces.walking.radius)
    recorded = context.simulate(scenes, captions)
    gaps = []
    delays = []
    for scene, tracks in zip(scenes, recorded, strict=True):
        position = np.asarray(tracks.position)
        gaps.append(separation(position[:, 0], position[:, 1]) - bodies)
        delays.append(_lost(scene, tracks))

    # The least gap of all cases decides, as bodies are solid at every angle.
    gap = np.array(gaps)  # (C,) m
    lost = max(delays)
    worst = int(gap.argmin())
    angle, offset, speeds = cases[worst]
    by_angle = gap.reshape(len(angles), -1).min(1)

    # A tolerance of 1 mm allows for bodies that touch; one angle alone is a point and not a curve.
    overlapping = gap < -TOLERANCE
    return result(
        bool((gap >= -TOLERANCE).all()),
        f"least gap of bodies {100 * gap[worst]:.0f} cm (at {angle:g} degrees, {offset:g} m aside, {speeds[0]:g} and "
        f"{speeds[1]:g} m/s); at most {lost:.1f} s lost",
        "bodies never overlap",
        numbers={"gap": float(gap.min()), "lost": lost, "overlapping": float(overlapping.mean())},
        curves=(
            curve("model", angles, by_angle, points=len(angles) == 1),
            level("bodies touch", (min(angles) - 5.0, max(angles) + 5.0), 0.0),
        ),
        axes=("angle between the ways [degrees]", "least gap of bodies [m]"),
    )


def _lost(scene: Scene, tracks: Tracks) -> float:
    """Delay [s] of the later of two people at the end."""
    position = np.asarray(tracks.position)
    speed = np.asarray(scene.walkers.preferred_speed)
    way = np.asarray(scene.walkers.velocity) / speed[:, None]

    gone = ((position[-1] - position[0]) * way).sum(-1)  # (2,) m
    time = tracks.time_step * (len(position) - 1)
    return float((time - gone / speed).max())


def passing_scenes(number: int, way: tuple[float, float] = FROM_THE_RIGHT) -> list[Scene]:
    """Encounters of a person who walks along x with a robot on another way (a unit vector) that does not react.

    Drawn: the speed of the person from N(1.34, 0.26) m/s, and the distance by which the two would miss each other.
    """
    random = np.random.default_rng([0, 29])
    velocity = ROBOT_SPEED * way[0], ROBOT_SPEED * way[1]
    robot = (-BEFORE * velocity[0], -BEFORE * velocity[1]), velocity
    ahead = _far(np.array([1.0, 0.0]))
    scenes = []
    for k in range(number):
        speed = float(np.clip(random.normal(1.34, 0.26), 0.5, 2.2))
        drift = np.array([speed - velocity[0], -velocity[1]])
        aside = np.array([-drift[1], drift[0]]) / np.hypot(*drift)
        miss = random.uniform(-MISS, MISS)
        start = np.array([-BEFORE * speed, 0.0]) + miss * aside
        person = walkers(start[None], route=(0,), speed=speed, velocity=(speed, 0.0))
        scenes.append(Scene(NO_WALLS, person, (ahead,), 2.0 * BEFORE, robot=robot, seed=k))
    return scenes


def passing_a_robot(context: CheckContext, **limits: Any) -> CheckResult:
    """Clearance of a person from a crossing robot that does not react, and the share of contacts.

    Args:
        **limits: of ``compare_clearance``.
    """
    scenes = passing_scenes(64 if context.quick else 256)
    recorded = context.simulate(scenes, ["encounter 1", "encounter 2", "encounter 3"])
    nearest = []
    for scene, tracks in zip(scenes, recorded, strict=True):
        nearest.append(_nearest(scene, tracks)[0])
    return compare_clearance(context, np.array(nearest), **limits)


def approached(context: CheckContext, most_touched: float, slowest: Sequence[float]) -> CheckResult:
    """How much people slow down for a robot that comes at them head-on, and the share of contacts.

    Args:
        most_touched: share of encounters.
        slowest: smallest and largest median of the least speed within ``NEARBY``, over the first.
    """
    scenes = passing_scenes(64 if context.quick else 256, HEAD_ON)
    recorded = context.simulate(scenes, ["head-on 1", "head-on 2", "head-on 3"])
    shares = []
    nearest = []
    for scene, tracks in zip(scenes, recorded, strict=True):
        robot = scene.robot_path(_times(tracks))
        shares.append(float(least_speed_share(np.asarray(tracks.position), robot, NEARBY)[0]))
        nearest.append(_nearest(scene, tracks)[0])
    touched = float((np.array(nearest) < _bodies(context)).mean())
    clearance = float(np.mean(nearest))

    # Whoever turned back before the robot was near kept no speed at all.
    ranked = np.sort(np.nan_to_num(shares))
    quarter, median = np.quantile(ranked, (0.25, 0.5)).tolist()
    least, most = slowest
    return result(
        bool(touched <= most_touched and least <= median <= most),
        f"slowest {median:.2f} of the first speed within {NEARBY:g} m (a quarter below {quarter:.2f}); touched in "
        f"{100 * touched:.1f} % of {len(scenes)}; nearest {clearance:.2f} m",
        f"median of {least:g} to {most:g} of the first speed; touched in {100 * most_touched:.0f} % at most",
        numbers={"slowest": median, "slowest_quarter": quarter, "touched": touched, "clearance": clearance},
        curves=(
            curve("model", ranked, _cumulative(ranked)),
            reference("allowed, median", slowest, (0.5, 0.5)),
        ),
        axes=("least over first speed", "share of encounters"),
    )


def stream_scenes(number: int) -> list[Scene]:
    """A robot that walks through a stream of people, across it."""
    length, width = STREAM
    people = round(STREAM_DENSITY * length * width)
    robot = (length / 2, -3.0), (0.0, ROBOT_SPEED)
    ahead = np.array([1.0, 0.0])
    gates = (_far(ahead),)
    scenes = []
    for k in range(number):
        start = spread((0.0, 0.0), STREAM, people, k, apart=0.8)
        crowd = walkers(start, route=(0,), seed=k)
        velocity = np.asarray(crowd.preferred_speed)[:, None] * ahead
        crowd = replace(crowd, velocity=velocity)
        scenes.append(Scene(NO_WALLS, crowd, gates, width + 6.0, length, robot=robot, seed=k))
    return scenes


def passing_in_a_stream(context: CheckContext, **limits: Any) -> CheckResult:
    """Clearance of people in a stream from a crossing robot, and the share of contacts.

    People count if the robot would miss them by less than ``MISS`` with everybody going straight on.

    Args:
        **limits: of ``compare_clearance``.
    """
    scenes = stream_scenes(16 if context.quick else 64)
    recorded = context.simulate(scenes, ["a stream"])
    nearest = []
    for scene, tracks in zip(scenes, recorded, strict=True):
        start = np.asarray(scene.walkers.start)
        velocity = np.asarray(scene.walkers.velocity)
        way = _times(tracks)[:, None, None] * velocity  # (T, N, 2) m
        straight = replace(tracks, position=start + way)
        counts = _nearest(scene, straight) < MISS
        nearest.append(_nearest(scene, tracks)[counts])
    return compare_clearance(context, np.concatenate(nearest), **limits)


def _nearest(scene: Scene, tracks: Tracks) -> np.ndarray:
    """(N,) m, distance of closest approach of the robot to each person; in a periodic scene, of any image of it."""
    position = np.asarray(tracks.position)
    robot = scene.robot_path(_times(tracks))[:, None]  # (T, 1, 2)
    if scene.period is None:
        return separation(position, np.broadcast_to(robot, position.shape))

    # People walk on beyond the period, past the images of the robot there.
    step = steps_along(position[..., 0], scene.period)
    first_x = position[:1, :, 0]
    x = np.concatenate([first_x, first_x + np.cumsum(step, 0)])
    position = np.stack([x, position[..., 1]], -1)
    first = int(np.floor(x.min() / scene.period)) - 1
    last = int(np.ceil(x.max() / scene.period))
    distances = []
    for k in range(first, last + 1):
        image = robot + np.array([k * scene.period, 0.0])
        distances.append(separation(position, np.broadcast_to(image, position.shape)))
    return np.min(distances, axis=0)


def compare_clearance(
    context: CheckContext,
    nearest: np.ndarray,
    most_touched: float,
    within: float,
    deviation: Sequence[float] = (0.0, np.inf),
) -> CheckResult:
    """The result of the least distances in encounters of a person and a robot.

    Args:
        most_touched: share of encounters.
        within: m, from the measured mean.
        deviation: m, smallest and largest standard deviation.
    """
    bodies = _bodies(context)
    touched = float((nearest < bodies).mean())
    clearance = float(nearest.mean())
    spread_out = float(nearest.std())

    least, most = deviation
    wanted = ""
    if np.isfinite(most):
        wanted = f", with a deviation of {least:g} to {most:g} m"

    # The curve is the distribution of distances.
    ranked = np.sort(nearest)

    as_near = abs(clearance - CLEARANCE) <= within
    as_wide = least <= spread_out <= most
    return result(
        touched <= most_touched and as_near and as_wide,
        f"touched in {100 * touched:.1f} % of {len(nearest)}; nearest {clearance:.2f} ± {spread_out:.2f} m",
        f"touched in {100 * most_touched:.0f} % at most; nearest {CLEARANCE:g} ± {within:g} m on average{wanted}",
        numbers={"touched": touched, "clearance": clearance, "clearance_deviation": spread_out},
        curves=(
            curve("model", ranked, _cumulative(ranked)),
            reference("bodies touch", (bodies, bodies), (0.0, 1.0)),
            reference("people, 0.83 m", (CLEARANCE, CLEARANCE), (0.0, 1.0)),
        ),
        axes=("least distance of the middles [m]", "share of encounters"),
    )


def _bodies(context: CheckContext) -> float:
    """The distance [m] at which a person and Kuri touch."""
    return float(context.model.forces.walking.radius) + float(load("kuri").radius)


def _cumulative(ranked: np.ndarray) -> np.ndarray:
    """The share of encounters up to each of them."""
    return (np.arange(len(ranked)) + 1.0) / len(ranked)


def _times(tracks: Tracks) -> np.ndarray:
    return tracks.time_step * np.arange(len(tracks.present))


# ------------------------------------------------------------------ prediction

FEWER = 50.0  # times fewer collisions than with constant velocity
BETTER = 0.02  # share of the mean error of constant velocity with all habits


def with_companions(scenario: Scenario, state: State) -> Pedestrians:
    """Constant velocity, at the mean of the desired velocities of oneself and one's companions."""
    people = state.pedestrians
    companions = scenario.behavior.companions
    assert companions is not None, "predicted people have companions, or -1"
    desired = people.desired_velocity
    present = (companions >= 0) & people.present[companions]
    present = present[..., None].astype(desired.dtype)  # (N, 2, 1)
    mean = (desired + (present * desired[companions]).sum(1)) / (1.0 + present.sum(1))
    people = replace(people, desired_velocity=mean)
    after = constant_velocity(scenario, replace(state, pedestrians=people))
    return replace(after, desired_velocity=desired)


def habits_of_constant_velocity(forces: Forces, habits: dict[str, Any]) -> tuple[Predictable, dict[str, Any]]:
    """Constant velocity with all habits of social forces: weights, and companions' mean velocity.

    It needs no ``settled``: it has no acceleration that the observed velocity could contain already.
    """
    cohesion = forces.get(Cohesion)
    habits = {"weights": habits["weights"]}
    if cohesion is not None and cohesion.alignment is not None:
        return with_companions, habits
    return "constant_velocity", habits


def prediction(context: CheckContext) -> CheckResult:
    """Errors and collisions in each recorded scene, against constant velocity with the same habits.

    Raises:
        Skipped: there are no recordings.
    """
    model = context.model
    scores: dict[str, Scores] = {}
    straight: dict[str, Scores] = {}
    plain: dict[str, Scores] = {}
    for path in context.progress(context.eth_ucy()):
        scene = path.stem
        windows = read_windows(path)
        mover, habits = model.move, {}
        straight_mover, straight_habits = "constant_velocity", {}
        if mover is move:
            mover, habits = fitted_without(scene, model.forces)
            straight_mover, straight_habits = habits_of_constant_velocity(mover, habits)

        scores[scene] = evaluate(mover, windows, **habits)
        plain[scene] = evaluate("constant_velocity", windows)
        straight[scene] = evaluate(straight_mover, windows, **straight_habits)
    return compare_scores(scores, straight, plain)


def compare_scores(scores: dict[str, Scores], straight: dict[str, Scores], plain: dict[str, Scores]) -> CheckResult:
    """The result of the errors of a model in several scenes.

    Args:
        straight: of constant velocity with the same habits in the same scenes.
        plain: likewise, of constant velocity without habits.
    """
    # Constant velocity is hard to beat in these recordings (Schoeller et al., RA-L 2020): it is the measure.
    worse = []
    words = []
    for scene, errors in scores.items():
        known = straight[scene]
        usual = plain[scene]

        # With the same habits, so that slowing down alone, which any model may do, is not an advantage.
        if errors.ade > (1.0 - BETTER) * known.ade or errors.fde > known.fde:
            worse.append(scene)

        words.append(
            f"{scene} {errors.ade:.3f}/{errors.fde:.3f} (constant velocity with the same habits {known.ade:.3f}/"
            f"{known.fde:.3f}, without {usual.ade:.3f}/{usual.fde:.3f})"
        )

    # Displacement errors do not see collisions, so they are counted besides; few have to remain.
    collisions = np.mean([errors.collisions for errors in scores.values()])
    straight_collisions = np.mean([errors.collisions for errors in straight.values()])

    numbers = {}
    for suffix, table in (("", scores), ("_constant_velocity", straight)):
        for scene, errors in table.items():
            for name in Scores._fields[:3]:
                numbers[f"{name}{suffix}_{scene}"] = float(getattr(errors, name))

    # Without habits is shown for the reader, and does not decide.
    number, scenes = numbered(scores)
    not_all = f" (not: {', '.join(worse)})" if worse else ""

    # ADE is the mean distance over all predicted moments, FDE that at the last one [G18].
    return result(
        not worse and bool(collisions * FEWER <= straight_collisions),
        f"{'; '.join(words)}; {100 * collisions:.2f} % of tracks collide (constant velocity "
        f"{100 * straight_collisions:.2f} %)",
        f"ADE {100 * BETTER:g} % below constant velocity with the same habits and FDE not above it{not_all}, "
        f"{FEWER:g} times fewer collisions",
        numbers=numbers,
        curves=(
            curve("ADE", number, [errors.ade for errors in scores.values()]),
            curve("FDE", number, [errors.fde for errors in scores.values()]),
            reference("ADE, constant velocity", number, [errors.ade for errors in straight.values()]),
            reference("FDE, constant velocity", number, [errors.fde for errors in straight.values()]),
        ),
        axes=(f"scene: {scenes}", "error [m]"),
    )


def fitted_without(scene: str, forces: Forces) -> tuple[Forces, dict[str, Any]]:
    """Forces and arguments of ``predict`` that have not seen a scene such as eth.

    Constants are replaced in ``calibrated`` only, habits of all forces. Scenes that were not fitted to have the habits
    of all the others. docs/calibration.md has the commands.
    """
    habits = PUBLISHED["left_out"]["habits"].get(scene)
    if habits is None:
        return forces, HABITS
    if fingerprint(forces) == fingerprint(preset("calibrated")):
        forces = forces.tree_replace(PUBLISHED["left_out"]["constants"])
    return forces, {"weights": tuple(habits["weights"]), "settled": habits["settled"]}
