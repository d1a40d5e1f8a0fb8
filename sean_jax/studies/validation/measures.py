"""Measures of recorded or simulated tracks: crossings and flow, density and speed, lanes, approaches, overlap, waves.

``sean validate`` measures recorded tracks by them, in numpy; ``sean calibrate`` simulated ones, in JAX. Functions that
both use return arrays of the kind that they take. Density and speed of an area are from Voronoi cells, by PedPy (extra
``validation``): B. Steffen & A. Seyfried, Physica A 389, 1902 (2010).
"""

from collections.abc import Iterator, Sequence
from types import ModuleType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.lib.stride_tricks import sliding_window_view

from sean_jax.people.recordings import Tracks
from sean_jax.social_forces.forces import Walking
from sean_jax.studies.scenes import Gate, Scene
from sean_jax.studies.validation.checks import Skipped

LANE = 0.3  # m, people within that distance across a corridor walk in one lane
SPEED_SPAN = 0.5  # s before and after, over which a speed is a difference of positions
BEHIND = 4  # places in a single file, over which a wave is followed
LATEST = 10.0  # s, of a wave over these places
STEADY = 0.01  # m/s
PAIRS = 4_000_000  # distances at a time
WALKS = 0.5  # m/s; the direction of slower people does not count
LONG = 3.0  # m, of a way whose sideways deviation counts

Bounds = tuple[float, float, float, float]  # m: x_min, y_min, x_max, y_max


def namespace(array: Any) -> ModuleType:
    """``jax.numpy`` for an array of JAX, ``numpy`` for any other."""
    if isinstance(array, jax.Array):
        return jnp
    return np


def crossing_times(tracks: Tracks, gate: Gate) -> Float[np.ndarray, "N"]:
    """(N,) s when each person first crosses a gate in its direction, interpolated between moments; inf if never.

    People who leave there cross at that time.
    """
    position = np.asarray(tracks.position, float)
    present = np.asarray(tracks.present)
    left = np.asarray(gate.left, float)
    side = np.asarray(gate.right, float) - left
    width = np.hypot(*side)
    ux, uy = side / width
    gap = position - left
    behind = gap[..., 1] * ux - gap[..., 0] * uy  # (T, N) m
    along = gap[..., 0] * ux + gap[..., 1] * uy

    # People cross between a moment on this side and one behind the line, at most 0.5 m beside its ends.
    passes_line = (behind[:-1] <= 0.0) & (behind[1:] > 0.0)
    within = (along[1:] > -0.5) & (along[1:] < width + 0.5)
    crosses = passes_line & within & present[:-1]  # (T - 1, N)
    has_crossed = crosses.any(0)
    moment = np.where(has_crossed, crosses.argmax(0), -1)

    # The share of the step until the line.
    people = np.arange(position.shape[1])
    next_moment = np.minimum(moment + 1, len(behind) - 1)
    before = behind[moment, people]
    step = behind[next_moment, people] - before
    share = -before / np.where(step > 0.0, step, 1.0)
    share = np.where(has_crossed, share, 0.0)
    return np.where(has_crossed, (moment + share) * tracks.time_step, np.inf)


def first_gate_times(scenes: Sequence[Scene], recorded: Sequence[Tracks]) -> list[np.ndarray]:
    """The ``crossing_times`` of each scene's first gate."""
    return [crossing_times(tracks, scene.gates[0]) for scene, tracks in zip(scenes, recorded, strict=True)]


def first_and_last(present: Bool[np.ndarray, "T N"]) -> tuple[Int[np.ndarray, "N"], Int[np.ndarray, "N"]]:
    """The first and the last moment of each person; 0 and T - 1 of those who are never present."""
    return present.argmax(0), len(present) - 1 - present[::-1].argmax(0)


def vanishing_times(tracks: Tracks) -> Float[np.ndarray, "N"]:
    """(N,) s when each person vanishes for good; inf if present at the end, or never."""
    present = np.asarray(tracks.present)
    _, last = first_and_last(present)
    vanishes = present.any(0) & ~present[-1]
    return np.where(vanishes, (last + 1) * tracks.time_step, np.inf)


def flow(times: Float[Any, "*batch N"], shortest: float = 1e-9) -> Float[Any, "*batch"]:
    """The mean flow [people/s] from 20 to 80 % of the crossing times (..., N) s, inf of none; NaN with fewer than 3.

    Args:
        shortest: s, the shortest time that the crossings take.
    """
    crosses = np.isfinite(times)
    crossings = crosses.sum(-1)
    ordered = np.sort(times, axis=-1)
    ordered = np.where(np.isfinite(ordered), ordered, 0.0)  # (..., N) s

    intervals = np.maximum(crossings - 1, 0)
    first = np.round(0.2 * intervals).astype(int)
    last = np.round(0.8 * intervals).astype(int)
    begin = np.take_along_axis(ordered, first[..., None], -1)[..., 0]
    end = np.take_along_axis(ordered, last[..., None], -1)[..., 0]
    rate = (last - first) / np.maximum(end - begin, shortest)
    return np.where(crossings < 3, np.nan, rate)[()]


def pedpy() -> Any:
    """The package PedPy.

    Raises:
        Skipped: it is not installed.
    """
    try:
        import pedpy
    except ImportError:
        raise Skipped('PedPy is not installed; pip install "sean_jax[validation]".') from None
    return pedpy


def trajectory_data(tracks: Tracks, period: float | None = None) -> Any:
    """``pedpy.TrajectoryData`` of tracks, with the columns id, frame, x and y [m].

    Args:
        period: m along x, of a periodic scene: a person who comes around counts as another person.

    Raises:
        Skipped: PedPy is not installed.
    """
    import pandas

    position = np.asarray(tracks.position, float)
    present = np.asarray(tracks.present)
    person = np.asarray(tracks.person).astype(int)
    if period is not None:
        goes_around = np.abs(np.diff(position[..., 0], axis=0)) > period / 2  # (T - 1, N)
        no_round = np.zeros((1, person.shape[1]), int)
        rounds = np.concatenate([no_round, np.cumsum(goes_around, 0)])
        number = int(person.max(initial=0)) + 1
        person = person + rounds * number

    moment, column = np.nonzero(present)
    x, y = position[moment, column].T
    table = pandas.DataFrame({"id": person[moment, column], "frame": moment, "x": x, "y": y})
    return pedpy().TrajectoryData(data=table, frame_rate=1.0 / tracks.time_step)


def speeds(tracks: Tracks) -> np.ndarray:
    """(T - 1, N) m/s between moments, NaN where a person is absent at one of both; not of a periodic scene."""
    position = np.asarray(tracks.position)
    present = np.asarray(tracks.present)
    speed = np.linalg.norm(np.diff(position, axis=0), axis=-1) / tracks.time_step
    return np.where(present[1:] & present[:-1], speed, np.nan)


def steps_along(x: Float[Any, "T N"], period: Float[Any, ""] | float) -> Float[Any, "S N"]:
    """(T - 1, N) m along x between moments, from positions (T, N) m in a periodic scene; arrays of numpy or JAX."""
    xp = namespace(x)
    step = xp.diff(x, axis=0)
    return step - period * xp.round(step / period)


def area_means(
    tracks: Tracks, floor: Bounds, area: Bounds, rows: slice = slice(None), period: float | None = None
) -> tuple[float, float]:
    """Voronoi density [1/m2] and speed [m/s] in an area, means over the moments of ``area_series``; speed NaN if empty.

    Raises:
        Skipped: PedPy is not installed.
    """
    density, speed = area_series(tracks, floor, area, rows, period).T
    mean_speed = float("nan")
    if np.isfinite(speed).any():
        mean_speed = float(np.nanmean(speed))
    return float(density.mean()), mean_speed


def area_series(
    tracks: Tracks, floor: Bounds, area: Bounds, rows: slice = slice(None), period: float | None = None
) -> Float[np.ndarray, "K 2"]:
    """(K, 2) Voronoi density [1/m2] and speed [m/s] in an area at each moment of ``rows``; speed NaN without people.

    Args:
        floor: to which cells are cut; people off it are left out.

    Raises:
        Skipped: PedPy is not installed.
    """
    package = pedpy()
    everybody = trajectory_data(tracks, period)
    frame_rate = everybody.frame_rate
    table = everybody.data

    # Speeds are of everybody, density is of people on the floor at the moments alone.
    x0, y0, x1, y1 = floor
    within_x = (table.x > x0) & (table.x < x1)
    within_y = (table.y > y0) & (table.y < y1)
    on_floor = within_x & within_y
    frames = range(*rows.indices(len(tracks.present)))
    counted = table[on_floor & table.frame.isin(frames)]
    if not len(counted):
        no_density = np.zeros(len(frames))
        no_speed = np.full(len(frames), np.nan)
        return np.stack([no_density, no_speed], 1)

    individual_speed = package.compute_individual_speed(
        traj_data=everybody,
        frame_step=max(1, round(SPEED_SPAN * frame_rate)),
        speed_calculation=package.SpeedCalculation.BORDER_SINGLE_SIDED,
    )
    measured = package.TrajectoryData(counted[["id", "frame", "x", "y"]], frame_rate=frame_rate)
    walkable_area = package.WalkableArea(_corners(floor))
    cells = package.compute_individual_voronoi_polygons(traj_data=measured, walkable_area=walkable_area)
    measurement_area = package.MeasurementArea(_corners(area))
    density, intersection = package.compute_voronoi_density(
        individual_voronoi_data=cells, measurement_area=measurement_area
    )
    speed = package.compute_voronoi_speed(
        traj_data=measured,
        individual_voronoi_intersection=intersection,
        individual_speed=individual_speed,
        measurement_area=measurement_area,
    )

    density = density.reset_index().set_index("frame").density.reindex(frames, fill_value=0.0)
    speed = speed.reset_index().set_index("frame").speed.reindex(frames)
    speed = speed.where(density > 0.0)
    return np.stack([density, speed], 1).astype(float)


def densities(
    position: Float[Any, "*T N 2"],
    present: Bool[Any, "*T N"],
    lower: tuple[float, float],
    upper: tuple[float, float],
) -> Float[Any, "*T"]:
    """(...) 1/m2: people in a rectangle from ``lower`` to ``upper`` [m], over its area; arrays of numpy or JAX."""
    x = position[..., 0]
    y = position[..., 1]
    within_x = (x >= lower[0]) & (x <= upper[0])
    within_y = (y >= lower[1]) & (y <= upper[1])
    number = (within_x & within_y & present).sum(-1)
    area = (upper[0] - lower[0]) * (upper[1] - lower[1])
    return number.astype(float) / area


def peak(values: Float[Any, "*batch T"], span: int) -> Float[Any, "*batch"]:
    """The largest mean of ``span`` values in sequence, or of all if they are fewer."""
    span = min(span, np.shape(values)[-1])
    total = np.cumsum(values, axis=-1, dtype=float)
    total = np.concatenate([np.zeros_like(total[..., :1]), total], axis=-1)
    sums = total[..., span:] - total[..., :-span]
    return sums.max(-1) / span


def lane_order(
    across: Float[Any, "*T N"],
    direction: Float[Any, "*T N"] | Float[Any, "N"],
    present: Bool[Any, "*T N"],
    width: float = LANE,
) -> Float[Any, "*T"]:
    """(...) from 0 to 1: order of the lanes of people in two directions; NaN without people.

    The mean over people of ((s - o) / n)^2, where of the n people within ``width`` m across the corridor, themselves
    included, s walk in their direction and o in the other. It is 1 in lanes, and about 1 / n in a random mix.

    Args:
        across: (..., N) m, position across the corridor; arrays of numpy or JAX.
        direction: (..., N) or (N,) +1 or -1.

    Source:
        S. Nowak & A. Schadschneider, Phys. Rev. E 85, 066128 (2012), who count in the lanes of a lattice.
    """
    xp = namespace(across)
    across = xp.asarray(across, float)
    direction = xp.asarray(direction, float)
    gap = xp.abs(across[..., :, None] - across[..., None, :])
    in_lane = (gap < width) & present[..., None, :]
    in_lane = in_lane.astype(float)  # (..., N, N)

    surplus = (in_lane @ direction[..., None])[..., 0]
    number = xp.maximum(in_lane.sum(-1), 1.0)
    order = (surplus / number) ** 2

    people = present.sum(-1).astype(float)
    total = xp.where(present, order, 0.0).sum(-1)
    mean = total / xp.maximum(people, 1.0)
    return xp.where(people > 0.0, mean, xp.nan)


def separation(a: Float[Any, "T *shape 2"], b: Float[Any, "T *shape 2"]) -> Float[Any, "*shape"]:
    """(...) m: the least distance of two bodies (T, ..., 2) m; between moments both move straight on."""
    xp = namespace(a)
    gap = xp.asarray(a, float) - xp.asarray(b, float)
    step = xp.diff(gap, axis=0)
    squared = (step * step).sum(-1)

    # The share of each step at which the line from moment to moment is nearest.
    towards = -(gap[:-1] * step).sum(-1)
    share = towards / xp.where(squared > 0.0, squared, 1.0)
    share = xp.clip(share, 0.0, 1.0)
    nearest = gap[:-1] + share[..., None] * step
    distance = xp.sqrt((nearest * nearest).sum(-1))
    return distance.min(0)


def least_speed_share(
    position: Float[np.ndarray, "T N 2"], other: Float[np.ndarray, "T 2"], within: float
) -> Float[np.ndarray, "N"]:
    """(N,) the least speed of people nearer than ``within`` [m] to another body, over their first speed; NaN if never.

    Both are at the same moments, and a speed is a step between two.
    """
    steps = np.linalg.norm(np.diff(position, axis=0), axis=-1)  # (T - 1, N) m
    distance = np.linalg.norm(position - other[:, None], axis=-1)  # (T, N) m
    near = np.minimum(distance[1:], distance[:-1]) < within
    least = np.where(near, steps, np.inf).min(0)
    return np.where(near.any(0), least, np.nan) / steps[0]


def body_gaps(
    position: Float[Any, "*T N 2"],
    facing: Float[Any, "*T N 2"],
    present: Bool[Any, "*T N"],
    walking: Walking,
    group: Int[Any, "*T N"] | None = None,
) -> Float[Any, "*T N N"]:
    """(..., N, N) m between the surfaces of bodies, negative if they overlap; inf to oneself and to who does not count.

    Args:
        position: m; arrays of numpy or JAX.
        facing: unit vectors, across which shoulders are.
        group: the group of each person, -1 none; then only bodies of one group count.
    """
    xp = namespace(position)
    dx = position[..., :, None, 0] - position[..., None, :, 0]  # (..., N, N)
    dy = position[..., :, None, 1] - position[..., None, :, 1]

    shape = walking.shape(facing[..., 0], facing[..., 1])
    pair_shape = None
    if shape is not None:
        pair_shape = tuple(part[..., :, None] + part[..., None, :] for part in shape)
    distance = xp.sqrt(dx * dx + dy * dy)
    gap = distance - xp.asarray(walking.radii(dx, dy, pair_shape))

    people = present.shape[-1]
    others = xp.broadcast_to(~xp.eye(people, dtype=bool), (*present.shape, people))
    counts = present[..., :, None] & present[..., None, :] & others
    if group is not None:
        own = group[..., :, None]
        counts = counts & (own == group[..., None, :]) & (own >= 0)
    return xp.where(counts, gap, xp.inf)


def overlap(
    position: Float[np.ndarray, "T N 2"],
    facing: Float[np.ndarray, "T N 2"],
    present: Bool[np.ndarray, "T N"],
    walking: Walking,
    group: Int[np.ndarray, "T N"] | None = None,
) -> float:
    """The largest depth [m] to which two bodies overlap at any moment; 0 if none do.

    The arguments are those of ``body_gaps``.
    """
    position = np.asarray(position, np.float32)
    facing = np.asarray(facing, np.float32)
    nearest = np.inf
    for some in spans_of_pairs(present):
        members = None
        if group is not None:
            members = group[some]
        gap = body_gaps(position[some], facing[some], present[some], walking, members)
        nearest = min(nearest, float(gap.min(initial=np.inf)))
    return max(0.0, -nearest)


def spans_of_pairs(present: Bool[np.ndarray, "T N"]) -> Iterator[slice]:
    """Moments at a time at which all pairs of people fit into memory."""
    moments, people = np.shape(present)
    span = max(1, PAIRS // max(people * people, 1))
    for first in range(0, moments, span):
        yield slice(first, first + span)


def deviation_in_time(speed: Float[Any, "*batch T N"]) -> Float[Any, "*batch"]:
    """The standard deviation [m/s] of a person's speed (..., T, N) m/s in time, root mean square over people.

    NaN does not count; arrays of numpy or JAX.
    """
    xp = namespace(speed)
    variance = xp.nanvar(speed, axis=-2)  # (..., N)
    return xp.sqrt(xp.nanmean(variance, axis=-1))


def accelerations(velocity: Float[Any, "*batch T N 2"], time_step: float) -> Float[Any, "*batch R N"]:
    """(..., T - 1, N) m/s2, from velocities (..., T, N, 2) m/s at moments ``time_step`` s apart; of numpy or JAX."""
    xp = namespace(velocity)
    change = xp.diff(velocity, axis=-3)
    return xp.sqrt((change * change).sum(-1)) / time_step


class Wave(NamedTuple):
    """A wave of speeds in a single file; NaN if speeds change by less than ``STEADY``."""

    correlation: float  # of speeds with those ``BEHIND`` places behind, a delay later
    delay: float  # s from one person to the next, at which that is largest
    speed: float  # m/s along the file, negative upstream


def wave(speed: Float[np.ndarray, "T N"], period: float, time_step: float) -> Wave:
    """The wave of speeds in a single file that is closed.

    Args:
        speed: (T, N) m/s along the file, of people in their order: each walks behind the next, the last behind the
            first.
        period: m, length of the file.
        time_step: s between moments.
    """
    speed = np.asarray(speed, float)
    if deviation_in_time(speed) < STEADY:
        return Wave(np.nan, np.nan, np.nan)

    # Speeds of each person, and those of the person BEHIND places behind, a delay later.
    ahead = speed - speed.mean(0)
    behind = np.roll(ahead, BEHIND, axis=1)
    correlations = []
    for delay in range(round(LATEST / time_step) + 1):
        now = ahead[: len(ahead) - delay]
        later = behind[delay:]
        scale = np.sqrt((now**2).sum() * (later**2).sum())
        correlations.append((now * later).sum() / scale)

    # Speeds that change everywhere at once are no wave.
    best = int(np.argmax(correlations))
    delay = best * time_step
    wave_speed = np.nan
    if best:
        gap = BEHIND * period / speed.shape[1]
        wave_speed = float(speed.mean()) - gap / delay
    return Wave(float(correlations[best]), delay / BEHIND, wave_speed)


class Motion(NamedTuple):
    """How smoothly people move: magnitudes at all moments of all people."""

    acceleration: Float[np.ndarray, "K"]  # m/s2
    jerk: Float[np.ndarray, "J"]  # m/s3
    turn_rate: Float[np.ndarray, "I"]  # rad/s, where people walk


PARABOLA = np.array([-3.0, 12.0, 17.0, 12.0, -3.0]) / 35.0
"""Weights of five moments: the middle of a parabola of least squares (A. Savitzky & M. Golay, Anal. Chem. 36, 1627
(1964))"""


def smoothed(
    position: Float[np.ndarray, "T N 2"], present: Bool[np.ndarray, "T N"]
) -> tuple[Float[np.ndarray, "T N 2"], Bool[np.ndarray, "T N"]]:
    """Positions [m] of parabolas through five moments each, and who is there for all five: two fewer at both ends."""
    position = np.asarray(position, float)
    present = np.asarray(present)
    smooth = np.zeros_like(position)
    whole = np.zeros_like(present)
    span = len(PARABOLA)
    reach = span // 2
    if len(position) >= span:
        windows = sliding_window_view(position, span, axis=0)  # (T - 4, N, 2, 5)
        smooth[reach:-reach] = np.einsum("tncw,w->tnc", windows, PARABOLA)
        whole[reach:-reach] = sliding_window_view(present, span, axis=0).all(-1)
    return smooth, whole


def motion(position: Float[np.ndarray, "T N 2"], present: Bool[np.ndarray, "T N"], time_step: float) -> Motion:
    """Accelerations, jerk and turn rates, as differences of positions (T, N, 2) m, ``time_step`` s apart."""
    position = _where_present(position, present)
    velocity = np.diff(position, axis=0) / time_step
    acceleration = np.diff(velocity, axis=0) / time_step
    jerk = np.diff(acceleration, axis=0) / time_step
    jerk = np.linalg.norm(jerk, axis=-1)

    # The way back of a half turn is as long, so angles are from -pi to pi.
    speed = np.linalg.norm(velocity, axis=-1)
    walks = (speed[1:] > WALKS) & (speed[:-1] > WALKS)
    heading = np.arctan2(velocity[..., 1], velocity[..., 0])
    angle = np.diff(heading, axis=0)
    angle = np.abs((angle + np.pi) % (2.0 * np.pi) - np.pi)
    turn_rate = np.where(walks, angle / time_step, np.nan)

    magnitudes = accelerations(velocity, time_step), jerk, turn_rate
    finite = [values[np.isfinite(values)] for values in magnitudes]
    return Motion(*finite)


def sideways(position: Float[np.ndarray, "T N 2"], present: Bool[np.ndarray, "T N"]) -> Float[np.ndarray, "N"]:
    """(N,) m, the largest distance of people (T, N, 2) m from the line from their first to their last place.

    NaN of those whose line is shorter than ``LONG``.
    """
    position = np.asarray(position, float)
    present = np.asarray(present)
    people = np.arange(present.shape[1])
    first, last = first_and_last(present)
    start = position[first, people]
    line = position[last, people] - start  # (N, 2) m
    length = np.linalg.norm(line, axis=-1)

    # The distance from a line is the cross product over its length.
    gap = position - start  # (T, N, 2) m
    cross = gap[..., 0] * line[:, 1] - gap[..., 1] * line[:, 0]
    distance = np.abs(cross) / np.where(length > 0.0, length, 1.0)
    largest = np.where(present, distance, 0.0).max(0)
    return np.where(length >= LONG, largest, np.nan)


def slowest(position: Float[np.ndarray, "T N 2"], present: Bool[np.ndarray, "T N"]) -> Float[np.ndarray, "N"]:
    """(N,) the slowest step of each person over the first one; NaN of those with fewer than 5 steps."""
    place = _where_present(position, present)
    step = np.linalg.norm(np.diff(place, axis=0), axis=-1)  # (T - 1, N) m
    walks = np.isfinite(step)
    first = step[walks.argmax(0), np.arange(step.shape[1])]
    least = step.min(0, where=walks, initial=np.inf)

    enough = walks.sum(0) >= 5
    moves = first > 0.0
    share = least / np.where(moves, first, 1.0)
    return np.where(enough & moves, share, np.nan)


def _where_present(position: Float[np.ndarray, "T N 2"], present: Bool[np.ndarray, "T N"]) -> np.ndarray:
    """(T, N, 2) m, NaN of people who are absent."""
    return np.where(np.asarray(present)[..., None], np.asarray(position, float), np.nan)


class Company(NamedTuple):
    """How people who walk together walk: values of all pairs at all moments."""

    spacing: Float[np.ndarray, "K"]  # m
    beside: Bool[np.ndarray, "K"]  # whether the other is more than 60 degrees off the way of both


def company(
    position: Float[np.ndarray, "T N 2"],
    present: Bool[np.ndarray, "T N"],
    pairs: Int[np.ndarray, "P 2"],
    time_step: float,
) -> Company:
    """The company of pairs, at moments at which they walk.

    Args:
        position: (T, N, 2) m, ``time_step`` s apart.
        pairs: (P, 2) columns of two who walk together.
    """
    place = _where_present(position, present)
    pairs = np.asarray(pairs, int)
    first = place[:, pairs[:, 0]]  # (T, P, 2) m
    second = place[:, pairs[:, 1]]
    step = np.diff(0.5 * (first + second), axis=0)  # (T - 1, P, 2)
    gap = (second - first)[:-1]

    # The cosine of the angle between the way of a pair and the line from one to the other.
    spacing = np.linalg.norm(gap, axis=-1)
    length = np.linalg.norm(step, axis=-1)
    scale = spacing * length
    cosine = np.abs((gap * step).sum(-1)) / np.where(scale > 0.0, scale, 1.0)
    walks = np.isfinite(cosine) & (length > WALKS * time_step)
    beside = cosine < 0.5
    return Company(spacing[walks], beside[walks])


def _corners(bounds: Bounds) -> list[tuple[float, float]]:
    x0, y0, x1, y1 = bounds
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
