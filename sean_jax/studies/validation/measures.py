"""Measures of recorded or simulated tracks: crossings and flow, density and speed, lanes, approaches, group occupancy.

Density and speed of an area are from Voronoi cells, by PedPy (extra ``validation``): B. Steffen & A. Seyfried,
Physica A 389, 1902 (2010).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from sean_jax.recordings import Tracks
from sean_jax.studies.scenes import Gate
from sean_jax.studies.validation.checks import Skipped

LANE = 0.3  # m, people within that distance across a corridor walk in one lane
SPEED_SPAN = 0.5  # s before and after, over which a speed is a difference of positions

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
    """Voronoi density [1/m2] and speed [m/s] in an area, means over moments.

    The speed is over frames with people in the area; NaN without any.

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
        return 0.0, float("nan")
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
    return float(density.mean()), float(speeds[density > 0.0].mean())


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


def _corners(bounds: Bounds) -> list[tuple[float, float]]:
    x0, y0, x1, y1 = bounds
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


@dataclass(frozen=True)
class GroupOccupancy:
    """Occupancy of G conversational groups (section IV-D) over time, and the stays that ended."""

    mean: Float[np.ndarray, "G"]  # members over capacity, from 0 to 1
    full: Float[np.ndarray, "G"]  # share of the time with all members
    empty: Float[np.ndarray, "G"]  # share of the time without any
    largest: Int[np.ndarray, "G"]  # most members at once
    stays: tuple[Float[np.ndarray, "K"], ...]  # s, of each group: stays that were measured as a whole


def group_occupancy(
    group: Int[np.ndarray, "*B T N"],
    capacity: Int[np.ndarray, "G"],
    time_step: float,
    warm_up: float = 20.0,
) -> GroupOccupancy:
    """Occupancy of groups, and stays of their members.

    Args:
        group: (..., T, N) the group in which each person is at each step, -1 none; of one or more episodes.
        capacity: (G,) people that each group is for.
        warm_up: s, at the beginning of each episode, that do not count.
    """
    group = np.asarray(group)
    group = group.reshape(-1, *group.shape[-2:])[:, round(warm_up / time_step) :]
    capacity = np.asarray(capacity)
    members = np.stack([(group == g).sum(-1) for g in range(len(capacity))], -1).reshape(-1, len(capacity))
    return GroupOccupancy(
        mean=members.mean(0) / capacity,
        full=(members >= capacity).mean(0),
        empty=(members == 0).mean(0),
        largest=members.max(0),
        stays=tuple(_stays(group == g) * time_step for g in range(len(capacity))),
    )


def _stays(inside: np.ndarray) -> np.ndarray:
    """(K,) steps of each whole stay in (B, T, N); stays cut by the beginning or the end do not count."""
    outside = np.zeros((len(inside), 1, inside.shape[-1]), bool)
    padded = np.concatenate([outside, inside, outside], axis=1).swapaxes(1, 2)  # (B, N, T + 2)
    change = np.diff(padded.astype(np.int8), axis=-1)
    began, ended = np.nonzero(change == 1)[-1], np.nonzero(change == -1)[-1]  # in pairs, as people come in their order
    complete = (began > 0) & (ended < inside.shape[1])
    return (ended - began)[complete]
