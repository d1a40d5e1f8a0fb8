"""Measures of recorded or simulated tracks: crossings and flow, density and speed, lanes, approaches, overlap, waves.

Density and speed of an area are from Voronoi cells, by PedPy (extra ``validation``): B. Steffen & A. Seyfried,
Physica A 389, 1902 (2010).
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.lib.stride_tricks import sliding_window_view

from sean_jax.people.recordings import Tracks
from sean_jax.social_forces.forces import Walking
from sean_jax.studies.scenes import Gate
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


def crossing_times(tracks: Tracks, gate: Gate) -> Float[np.ndarray, "N"]:
    """(N,) s when each person first crosses a gate in its direction, interpolated between moments; inf if never.

    People who leave there cross at that time.
    """
    position, present = np.asarray(tracks.position, float), np.asarray(tracks.present)
    left, right = np.asarray(gate.left, float), np.asarray(gate.right, float)
    side = right - left
    wide = np.hypot(*side)
    ux, uy = side / wide
    gap = position - left
    behind = gap[..., 1] * ux - gap[..., 0] * uy  # (T, N) m
    along = gap[..., 0] * ux + gap[..., 1] * uy
    step = (behind[:-1] <= 0.0) & (behind[1:] > 0.0) & present[:-1]
    step &= (along[1:] > -0.5) & (along[1:] < wide + 0.5)
    first = np.where(step.any(0), step.argmax(0), -1)
    own = np.arange(position.shape[1])
    before, after = behind[first, own], behind[np.minimum(first + 1, len(behind) - 1), own]
    share = np.where(first >= 0, -before / np.where(after > before, after - before, 1.0), 0.0)
    return np.where(first >= 0, (first + share) * tracks.time_step, np.inf)


def vanishing_times(tracks: Tracks) -> Float[np.ndarray, "N"]:
    """(N,) s when each person vanishes for good; inf if present at the end, or never."""
    present = np.asarray(tracks.present)
    last = len(present) - 1 - present[::-1].argmax(0)
    return np.where(present.any(0) & ~present[-1], (last + 1) * tracks.time_step, np.inf)


def flow(times: Float[np.ndarray, "N"]) -> float:
    """The mean flow [people/s] from 20 to 80 % of the crossing times (N,) s, inf of none; NaN with fewer than 3."""
    crossed = np.sort(times[np.isfinite(times)])
    if len(crossed) < 3:
        return float("nan")
    first, last = (int(round(share * (len(crossed) - 1))) for share in (0.2, 0.8))
    return (last - first) / max(float(crossed[last] - crossed[first]), 1e-9)


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

    position, present = np.asarray(tracks.position, float), np.asarray(tracks.present)
    person = np.asarray(tracks.person).astype(int)
    if period is not None:
        around = np.abs(np.diff(position[..., 0], axis=0)) > period / 2
        rounds = np.concatenate([np.zeros((1, person.shape[1]), int), np.cumsum(around, 0)])
        person = person + rounds * (int(person.max(initial=0)) + 1)
    time, column = np.nonzero(present)
    table = pandas.DataFrame(
        {
            "id": person[time, column],
            "frame": time,
            "x": position[time, column, 0],
            "y": position[time, column, 1],
        }
    )
    return pedpy().TrajectoryData(data=table, frame_rate=1.0 / tracks.time_step)


def speeds(tracks: Tracks) -> np.ndarray:
    """(T - 1, N) m/s between moments, NaN where a person is absent at one of both; not of a periodic scene."""
    position, present = np.asarray(tracks.position), np.asarray(tracks.present)
    step = np.linalg.norm(np.diff(position, axis=0), axis=-1) / tracks.time_step
    return np.where(present[1:] & present[:-1], step, np.nan)


def steps_along(x: np.ndarray, period: float) -> np.ndarray:
    """(T - 1, N) m along x between moments, from positions (T, N) m in a periodic scene."""
    step = np.diff(x, axis=0)
    return step - period * np.round(step / period)


def area_means(
    tracks: Tracks, floor: Bounds, area: Bounds, rows: slice = slice(None), period: float | None = None
) -> tuple[float, float]:
    """Voronoi density [1/m2] and speed [m/s] in an area, means over the moments of ``area_series``; speed NaN if empty.

    Raises:
        Skipped: PedPy is not installed.
    """
    density, speed = area_series(tracks, floor, area, rows, period).T
    return float(density.mean()), float(np.nanmean(speed)) if np.isfinite(speed).any() else float("nan")


def area_series(
    tracks: Tracks, floor: Bounds, area: Bounds, rows: slice = slice(None), period: float | None = None
) -> Float[np.ndarray, "K 2"]:
    """(K, 2) Voronoi density [1/m2] and speed [m/s] in an area at each moment of ``rows``; speed NaN without people.

    Args:
        floor: to which cells are cut; people off it are left out.

    Raises:
        Skipped: PedPy is not installed.
    """
    package, everybody = pedpy(), trajectory_data(tracks, period)
    frame_rate, table = everybody.frame_rate, everybody.data
    x0, y0, x1, y1 = floor
    on_floor = (table.x > x0) & (table.x < x1) & (table.y > y0) & (table.y < y1)
    chosen = range(*rows.indices(len(tracks.present)))
    counted = table[on_floor & table.frame.isin(chosen)]
    if not len(counted):
        return np.stack([np.zeros(len(chosen)), np.full(len(chosen), np.nan)], 1)
    speed = package.compute_individual_speed(
        traj_data=everybody,
        frame_step=max(1, round(SPEED_SPAN * frame_rate)),
        speed_calculation=package.SpeedCalculation.BORDER_SINGLE_SIDED,
    )
    within = package.MeasurementArea(_corners(area))
    at_rows = package.TrajectoryData(counted[["id", "frame", "x", "y"]], frame_rate=frame_rate)
    cells = package.compute_individual_voronoi_polygons(
        traj_data=at_rows, walkable_area=package.WalkableArea(_corners(floor))
    )
    density, parts = package.compute_voronoi_density(individual_voronoi_data=cells, measurement_area=within)
    speeds = package.compute_voronoi_speed(
        traj_data=at_rows, individual_voronoi_intersection=parts, individual_speed=speed, measurement_area=within
    )
    density, speeds = (part.reset_index().set_index("frame") for part in (density, speeds))
    density, speeds = density.density.reindex(chosen, fill_value=0.0), speeds.speed.reindex(chosen)
    return np.stack([density, speeds.where(density > 0.0)], 1).astype(float)


def densities(tracks: Tracks, lower: tuple[float, float], upper: tuple[float, float]) -> Float[np.ndarray, "T"]:
    """(T,) 1/m2: people in a rectangle from ``lower`` to ``upper`` [m], over its area."""
    position, present = np.asarray(tracks.position), np.asarray(tracks.present)
    inside = present & (position >= np.asarray(lower)).all(-1) & (position <= np.asarray(upper)).all(-1)
    return inside.sum(1) / ((upper[0] - lower[0]) * (upper[1] - lower[1]))


def peak(values: Float[np.ndarray, "T"], span: int) -> float:
    """The largest mean of ``span`` values in sequence, or of all if they are fewer."""
    span = min(span, len(values))
    total = np.concatenate([[0.0], np.cumsum(values)])
    return float((total[span:] - total[:-span]).max() / span)


def lane_order(
    across: Float[np.ndarray, "T N"],
    direction: Float[np.ndarray, "N"],
    present: Bool[np.ndarray, "T N"],
    width: float = LANE,
) -> Float[np.ndarray, "T"]:
    """(T,) from 0 to 1: order of the lanes of people in two directions; NaN without people.

    The mean over people of ((s - o) / n)^2, where of the n people within ``width`` m across the corridor, themselves
    included, s walk in their direction and o in the other. It is 1 in lanes, and about 1 / n in a random mix.

    Args:
        across: (T, N) m, position across the corridor.
        direction: (N,) +1 or -1.

    Source:
        S. Nowak & A. Schadschneider, Phys. Rev. E 85, 066128 (2012), who count in the lanes of a lattice.
    """
    across, direction, present = np.asarray(across, float), np.asarray(direction, float), np.asarray(present, bool)
    order = np.full(len(across), np.nan)
    for t, (y, there) in enumerate(zip(across, present, strict=True)):
        if there.any():
            near = np.abs(y[there, None] - y[None, there]) < width
            order[t] = np.mean((near @ direction[there] / near.sum(1)) ** 2)
    return order


def separation(
    one: Float[np.ndarray, "T *shape 2"], other: Float[np.ndarray, "T *shape 2"]
) -> Float[np.ndarray, "*shape"]:
    """(...) m: the least distance of two bodies (T, ..., 2) m; between moments both move straight on."""
    gap = np.asarray(one, float) - np.asarray(other, float)
    step = np.diff(gap, axis=0)
    squared = (step**2).sum(-1)
    share = np.clip(-(gap[:-1] * step).sum(-1) / np.where(squared > 0.0, squared, 1.0), 0.0, 1.0)
    nearest = gap[:-1] + share[..., None] * step
    return np.asarray(np.sqrt((nearest**2).sum(-1)).min(0))


def overlap(
    position: Float[np.ndarray, "T N 2"],
    facing: Float[np.ndarray, "T N 2"],
    present: Bool[np.ndarray, "T N"],
    walking: Walking,
    group: Int[np.ndarray, "T N"] | None = None,
) -> float:
    """The largest depth [m] to which two bodies overlap at any moment; 0 if none do.

    Args:
        position: m.
        facing: unit vectors, across which shoulders are.
        group: the group of each person, -1 none; then only bodies of one group count.
    """
    moments, number = np.shape(present)
    span, nearest = max(1, PAIRS // max(number * number, 1)), np.inf
    for first in range(0, moments, span):
        some = slice(first, first + span)
        x, y = np.moveaxis(np.asarray(position[some], np.float32), -1, 0)
        look_x, look_y = np.moveaxis(np.asarray(facing[some], np.float32), -1, 0)[..., None]
        both = present[some, :, None] & present[some, None, :] & ~np.eye(number, dtype=bool)
        if group is not None:
            both &= (group[some, :, None] == group[some, None, :]) & (group[some, :, None] >= 0)
        dx, dy = x[:, :, None] - x[:, None, :], y[:, :, None] - y[:, None, :]
        shape = walking.shape(look_x, look_y)
        both_shapes = None if shape is None else tuple(part + part.swapaxes(1, 2) for part in shape)
        gap = np.sqrt(dx * dx + dy * dy) - np.asarray(walking.radii(dx, dy, both_shapes))
        nearest = min(nearest, float(gap.min(where=both, initial=np.inf)))
    return max(0.0, -nearest)


def deviation_in_time(speed: Float[np.ndarray, "T N"]) -> float:
    """The standard deviation [m/s] of a person's speed in time: of speeds (T, N) m/s, root mean square over people."""
    return float(np.sqrt(np.nanmean(np.nanvar(speed, axis=0))))


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
    change = speed - speed.mean(0)
    if deviation_in_time(speed) < STEADY:
        return Wave(np.nan, np.nan, np.nan)
    behind = np.roll(change, BEHIND, axis=1)
    shared = []
    for delay in range(round(LATEST / time_step) + 1):
        one, other = change[: len(change) - delay], behind[delay:]
        shared.append((one * other).sum() / np.sqrt((one**2).sum() * (other**2).sum()))
    best = int(np.argmax(shared))
    later = best * time_step
    gap = BEHIND * period / speed.shape[1]
    across = float(speed.mean()) - gap / later if best else np.nan
    return Wave(float(shared[best]), later / BEHIND, across)


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
    place, there = np.asarray(position, float), np.asarray(present)
    reach = len(PARABOLA) // 2
    smooth, whole = np.zeros_like(place), np.zeros_like(there)
    if len(place) >= len(PARABOLA):
        smooth[reach:-reach] = np.einsum("tncw,w->tnc", sliding_window_view(place, len(PARABOLA), axis=0), PARABOLA)
        whole[reach:-reach] = sliding_window_view(there, len(PARABOLA), axis=0).all(-1)
    return smooth, whole


def motion(position: Float[np.ndarray, "T N 2"], present: Bool[np.ndarray, "T N"], time_step: float) -> Motion:
    """Accelerations, jerk and turn rates, as differences of positions (T, N, 2) m, ``time_step`` s apart."""
    place = np.where(np.asarray(present)[..., None], np.asarray(position, float), np.nan)
    velocity = np.diff(place, axis=0) / time_step
    acceleration = np.diff(velocity, axis=0) / time_step
    size = lambda vector: np.linalg.norm(vector, axis=-1)  # noqa: E731
    walks = (size(velocity[1:]) > WALKS) & (size(velocity[:-1]) > WALKS)
    turned = np.diff(np.arctan2(velocity[..., 1], velocity[..., 0]), axis=0)
    turned = np.abs((turned + np.pi) % (2.0 * np.pi) - np.pi) / time_step
    values = size(acceleration), size(np.diff(acceleration, axis=0) / time_step), np.where(walks, turned, np.nan)
    return Motion(*(each[np.isfinite(each)] for each in values))


def sideways(position: Float[np.ndarray, "T N 2"], present: Bool[np.ndarray, "T N"]) -> Float[np.ndarray, "N"]:
    """(N,) m, the largest distance of people (T, N, 2) m from the line from their first to their last place.

    NaN of those whose line is shorter than ``LONG``.
    """
    position, present = np.asarray(position, float), np.asarray(present)
    own, last = np.arange(present.shape[1]), len(present) - 1 - present[::-1].argmax(0)
    first = position[present.argmax(0), own]
    line = position[last, own] - first
    far = np.linalg.norm(line, axis=-1)
    gap = position - first
    off = np.abs(gap[..., 0] * line[:, 1] - gap[..., 1] * line[:, 0]) / np.where(far > 0.0, far, 1.0)
    return np.where(far >= LONG, np.where(present, off, 0.0).max(0), np.nan)


def slowest(position: Float[np.ndarray, "T N 2"], present: Bool[np.ndarray, "T N"]) -> Float[np.ndarray, "N"]:
    """(N,) the slowest step of each person over the first one; NaN of those with fewer than 5 steps."""
    place = np.where(np.asarray(present)[..., None], np.asarray(position, float), np.nan)
    step = np.linalg.norm(np.diff(place, axis=0), axis=-1)
    there = np.isfinite(step)
    first = step[there.argmax(0), np.arange(step.shape[1])]
    least = step.min(0, where=there, initial=np.inf)
    return np.where((there.sum(0) >= 5) & (first > 0.0), least / np.where(first > 0.0, first, 1.0), np.nan)


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
    place = np.where(np.asarray(present)[..., None], np.asarray(position, float), np.nan)
    one, other = (place[:, np.asarray(pairs, int)[:, k]] for k in (0, 1))
    way = np.diff(0.5 * (one + other), axis=0)
    gap = (other - one)[:-1]
    apart, far = np.linalg.norm(gap, axis=-1), np.linalg.norm(way, axis=-1)
    along = np.abs((gap * way).sum(-1)) / np.where(apart * far > 0.0, apart * far, 1.0)
    both = np.isfinite(along) & (far > WALKS * time_step)
    return Company(apart[both], along[both] < 0.5)


def _corners(bounds: Bounds) -> list[tuple[float, float]]:
    x0, y0, x1, y1 = bounds
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
