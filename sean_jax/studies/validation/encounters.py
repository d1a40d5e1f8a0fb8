"""Encounters: two people who meet or cross, and a person who crosses the way of a robot that does not react.

[V17] C. Vassallo et al., Gait & Posture 51, 97 (2017): people pass a robot that crosses their way at 0.83 ± 0.27 m.
"""

import itertools
from dataclasses import replace

import numpy as np

from sean_jax.recordings import Tracks
from sean_jax.robots import load
from sean_jax.studies.scenes import Gate, Moving, Scene, join, spread, walkers
from sean_jax.studies.validation.check import Check, Curve, Finding, Laboratory, judge
from sean_jax.studies.validation.measures import separation

BEFORE = 4.0  # s, after which two would be nearest if they went straight on
SPEEDS = (1.34, 1.34), (0.9, 1.7), (1.55, 1.2)  # m/s
OFFSETS = 0.0, 0.02, 0.1, -0.1, 0.2, 0.3, -0.3  # m, at which they would then pass
ANGLES = 45.0, 60.0, 90.0, 120.0, 135.0  # degrees between the ways of those who cross
TOLERANCE = 1e-3  # m, of bodies that touch
ROBOT_SPEED = 1.0  # m/s
MISS = 0.6  # m, within which person and robot would pass
CLEARANCE = 0.83, 0.27  # m [V17]
TOUCHED = 0.05
STREAM, STREAM_DENSITY = (16.0, 5.0), 0.35  # m along and across, 1/m2
NO_WALLS = np.zeros((0, 5))
FAR = 1e4  # m


def two(angle: float, offset: float, speeds: tuple[float, float]) -> Scene:
    """Two who would pass each other at an offset.

    Args:
        angle: between their ways [rad]; pi if they meet head-on.
        offset: m; positive if each would pass on the right of the other.
        speeds: of both [m/s].

    Returns:
        The scene, without walls, twice as long as it takes them to meet.
    """
    ways = np.array([[1.0, 0.0], [np.cos(angle), np.sin(angle)]])
    drift = speeds[0] * ways[0] - speeds[1] * ways[1]
    aside = np.array([drift[1], -drift[0]]) / np.hypot(*drift)
    start = -BEFORE * np.array(speeds)[:, None] * ways + 0.5 * offset * np.array([aside, -aside])
    both = [walkers(start[k : k + 1], route=(k,), speed=speeds[k], velocity=tuple(speeds[k] * ways[k])) for k in (0, 1)]
    return Scene(NO_WALLS, join(*both), tuple(_far(way) for way in ways), 2.0 * BEFORE + 2.0)


def _far(way: np.ndarray) -> Gate:
    """A gate so far away and so wide that whoever walks to it walks straight on."""
    middle, left = FAR * way, FAR * np.array([-way[1], way[0]])
    return Gate(tuple(middle + left), tuple(middle - left))


def pairs(laboratory: Laboratory, angles: tuple[float, ...], name: str) -> Finding:
    """Whether the bodies of two people ever overlap.

    Args:
        angles: between their ways [degrees].
    """
    cases = list(itertools.product(angles, OFFSETS, SPEEDS))
    scenes = [two(np.deg2rad(angle), offset, speeds) for angle, offset, speeds in cases]
    shown = {(angle, OFFSETS[1], SPEEDS[0]): f"{name}, {angle:g} degrees" for angle in angles}
    recorded = laboratory.simulate(scenes, [shown.get(case, "") for case in cases])
    bodies = 2.0 * float(laboratory.model.forces.walking.radius)
    positions = [np.asarray(tracks.position) for tracks in recorded]
    gap = np.array([separation(each[:, 0], each[:, 1]) for each in positions]) - bodies
    late = np.array([_lost(scene, tracks) for scene, tracks in zip(scenes, recorded, strict=True)])
    worst = int(gap.argmin())
    by_angle = gap.reshape(len(angles), -1).min(1)
    angle, offset, speeds = cases[worst]
    return judge(
        bool((gap >= -TOLERANCE).all()),
        f"least gap of bodies {100 * gap[worst]:.0f} cm (at {angle:g} degrees, {offset:g} m aside, {speeds[0]:g} and "
        f"{speeds[1]:g} m/s); at most {late.max():.1f} s lost",
        "bodies never overlap",
        numbers={"gap": float(gap.min()), "lost": float(late.max()), "overlapping": float((gap < -TOLERANCE).mean())},
        curves=(
            Curve("model", angles, tuple(by_angle), points=len(angles) == 1),
            Curve("bodies touch", (min(angles) - 5.0, max(angles) + 5.0), (0.0, 0.0), reference=True),
        ),
        axes=("angle between the ways [degrees]", "least gap of bodies [m]"),
    )


def _lost(scene: Scene, tracks: Tracks) -> float:
    """By how many seconds the later of two is late at the end."""
    position, speed = np.asarray(tracks.position), np.asarray(scene.walkers.preferred_speed)
    way = np.asarray(scene.walkers.velocity) / speed[:, None]
    gone = ((position[-1] - position[0]) * way).sum(-1)
    return float((tracks.time_step * (len(position) - 1) - gone / speed).max())


def head_on(laboratory: Laboratory) -> Finding:
    """Two people who meet head-on."""
    return pairs(laboratory, (180.0,), "head-on")


def crossing(laboratory: Laboratory) -> Finding:
    """Two people whose ways cross."""
    return pairs(laboratory, (60.0, 90.0, 120.0) if laboratory.quick else ANGLES, "crossing")


def passing_scenes(number: int, seed: int = 0) -> list[Scene]:
    """Encounters of a person with a robot that crosses their way at a right angle, from the right.

    Args:
        seed: of the draws: speed of the person from N(1.34, 0.26) m/s, and by how much the two would miss each other.

    Returns:
        The scenes; the robot's place and velocity are its own, whatever people do.
    """
    random = np.random.default_rng([seed, 29])
    scenes = []
    for k in range(number):
        speed = float(np.clip(random.normal(1.34, 0.26), 0.5, 2.2))
        drift = np.array([speed, -ROBOT_SPEED])
        aside = np.array([-drift[1], drift[0]]) / np.hypot(*drift)
        start = np.array([-BEFORE * speed, 0.0]) + random.uniform(-MISS, MISS) * aside
        person = walkers(start[None], route=(0,), speed=speed, velocity=(speed, 0.0))
        robot = (0.0, -BEFORE * ROBOT_SPEED), (0.0, ROBOT_SPEED)
        scenes.append(Scene(NO_WALLS, person, (_far(np.array([1.0, 0.0])),), 2.0 * BEFORE, robot=robot, seed=k))
    return scenes


def passing_a_robot(laboratory: Laboratory) -> Finding:
    """How far a person keeps from a robot that crosses their way and does not react, and how often it touches them."""
    scenes = passing_scenes(64 if laboratory.quick else 256)
    recorded = laboratory.simulate(scenes, [f"encounter {k + 1}" for k in range(3)] + [""] * (len(scenes) - 3))
    nearest = [_nearest(scene, tracks)[0] for scene, tracks in zip(scenes, recorded, strict=True)]
    return _clearance(laboratory, np.array(nearest))


def stream_scenes(number: int, seed: int = 0) -> list[Scene]:
    """A robot that walks through a stream of people, across it."""
    people, robot = round(STREAM_DENSITY * STREAM[0] * STREAM[1]), ((STREAM[0] / 2, -3.0), (0.0, ROBOT_SPEED))
    scenes = []
    for k in range(seed, seed + number):
        start = spread((0.0, 0.0), STREAM, people, k, apart=0.8)
        crowd = walkers(start, route=(0,), seed=k)
        crowd = replace(crowd, velocity=np.asarray(crowd.preferred_speed)[:, None] * np.array([1.0, 0.0]))
        gate = _far(np.array([1.0, 0.0]))
        scenes.append(Scene(NO_WALLS, crowd, (gate,), STREAM[1] + 6.0, STREAM[0], robot=robot, seed=k))
    return scenes


def passing_in_a_stream(laboratory: Laboratory) -> Finding:
    """How far people in a stream keep from a robot that crosses it, and how often it touches them.

    Those count whom it would miss by less than ``MISS`` if all went straight on.
    """
    scenes = stream_scenes(16 if laboratory.quick else 64)
    recorded = laboratory.simulate(scenes, ["a stream"])
    found = []
    for scene, tracks in zip(scenes, recorded, strict=True):
        start, velocity = np.asarray(scene.walkers.start), np.asarray(scene.walkers.velocity)
        straight = replace(tracks, position=start + _times(tracks)[:, None, None] * velocity)
        found.append(_nearest(scene, tracks)[_nearest(scene, straight) < MISS])
    return _clearance(laboratory, np.concatenate(found))


def _nearest(scene: Scene, tracks: Tracks) -> np.ndarray:
    """(N,) m, how near the robot of a scene comes to each person; in a periodic scene, any image of it."""
    assert scene.robot is not None
    position, robot = np.asarray(tracks.position), Moving(*scene.robot).at(_times(tracks))[:, None]
    if scene.period is None:
        return separation(position, np.broadcast_to(robot, position.shape))
    step = np.diff(position[..., 0], axis=0)
    step -= scene.period * np.round(step / scene.period)
    x = np.concatenate([position[:1, :, 0], position[:1, :, 0] + np.cumsum(step, 0)])
    position = np.stack([x, position[..., 1]], -1)
    images = range(int(np.floor(x.min() / scene.period)) - 1, int(np.ceil(x.max() / scene.period)) + 1)
    moved = [np.broadcast_to(robot + np.array([k * scene.period, 0.0]), position.shape) for k in images]
    return np.min([separation(position, each) for each in moved], axis=0)


def _clearance(laboratory: Laboratory, nearest: np.ndarray) -> Finding:
    """The finding of the least distances in encounters of a person and a robot."""
    bodies = float(laboratory.model.forces.walking.radius) + load("kuri", "twin").radius
    touched, clearance = float((nearest < bodies).mean()), float(nearest.mean())
    low, high = CLEARANCE[0] - CLEARANCE[1], CLEARANCE[0] + CLEARANCE[1]
    ranked = np.sort(nearest)
    return judge(
        touched <= TOUCHED and low <= clearance <= high,
        f"touched in {100 * touched:.1f} % of {len(nearest)}; nearest {clearance:.2f} ± {nearest.std():.2f} m",
        f"touched in {100 * TOUCHED:.0f} % at most; nearest {CLEARANCE[0]:g} ± {CLEARANCE[1]:g} m on average",
        numbers={"touched": touched, "clearance": clearance, "clearance_deviation": float(nearest.std())},
        curves=(
            Curve("model", tuple(ranked), tuple((np.arange(len(ranked)) + 1.0) / len(ranked))),
            Curve("bodies touch", (bodies, bodies), (0.0, 1.0), reference=True),
            Curve("people, 0.83 m", (CLEARANCE[0],) * 2, (0.0, 1.0), reference=True),
        ),
        axes=("least distance of the middles [m]", "share of encounters"),
    )


def _times(tracks: Tracks) -> np.ndarray:
    return tracks.time_step * np.arange(len(tracks.present))


CHECKS = (
    Check(
        name="pairs-head-on",
        title="Two people who meet head-on",
        setup="Two people in the open who would pass 0 to 0.3 m from each other; 7 offsets, 3 pairs of speeds.",
        measure="least distance of their middles without both radii, between moments as well",
        criterion="bodies never overlap",
        source="people walk around each other; M. Huber et al., PLoS ONE 9, e89589 (2014)",
        function=head_on,
    ),
    Check(
        name="pairs-crossing",
        title="Two people whose ways cross",
        setup="Two people in the open who would pass 0 to 0.3 m from each other; 5 angles from 45 to 135 degrees (3 "
        "with --quick), 7 offsets, 3 pairs of speeds.",
        measure="least distance of their middles without both radii, between moments as well",
        criterion="bodies never overlap",
        source="people walk around each other; M. Huber et al., PLoS ONE 9, e89589 (2014)",
        function=crossing,
    ),
    Check(
        name="passing-robot",
        title="A robot that does not react crosses people's way",
        setup="One person, preferred speed N(1.34, 0.26) m/s, and Kuri at 1 m/s at a right angle; 256 encounters (64 "
        "with --quick) in which both would pass within 0.6 m.",
        measure="least distance of the middles of both; touched: below the sum of both radii",
        criterion="touched in 5 % at most, 0.83 ± 0.27 m on average",
        source="C. Vassallo et al., Gait & Posture 51, 97 (2017)",
        function=passing_a_robot,
    ),
    Check(
        name="passing-robot-stream",
        title="A robot that does not react crosses a stream of people",
        setup="Stream 5 m wide, 0.35 people/m², preferred speed N(1.34, 0.26) m/s, and Kuri at 1 m/s across it, 64 "
        "times (16 with --quick). People count whom it would miss by less than 0.6 m if all went straight on.",
        measure="least distance of the middles of both; touched: below the sum of both radii",
        criterion="touched in 5 % at most, 0.83 ± 0.27 m on average",
        source="C. Vassallo et al., Gait & Posture 51, 97 (2017)",
        function=passing_in_a_stream,
    ),
)
