"""What is measured of tracks besides crossings: density and speed of an area, lanes, single files, closest approaches.

Recorded and simulated people are measured by the same functions. Density and speed of an area are those of Voronoi
cells, by PedPy (extra ``validation``): B. Steffen & A. Seyfried, Physica A 389, 1902 (2010).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from sean_jax.recordings import Tracks
from sean_jax.studies.validation.crossings import pedpy, trajectory_data

LANE = 0.3  # m, people within that distance across a corridor walk in one lane
SPEED_SPAN = 0.5  # s before and after, over which a speed is a difference of positions

Bounds = tuple[float, float, float, float]  # m: x_min, y_min, x_max, y_max


class AreaMeans(NamedTuple):
    """Density and speed in an area, averaged over moments."""

    density: float  # 1/m2
    speed: float  # m/s; NaN if nobody is there


def area_means(
    tracks: Tracks, floor: Bounds, area: Bounds, rows: slice = slice(None), period: float | None = None
) -> AreaMeans:
    """Voronoi density and speed in an area.

    Args:
        floor: to which cells are cut; who is off it is left out.

    Returns:
        Means over the moments; the speed over those with somebody in the area.

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
        return AreaMeans(0.0, float("nan"))
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
    return AreaMeans(float(density.mean()), float(speeds[density > 0.0].mean()))


def lane_order(
    across: Float[np.ndarray, "T N"],
    direction: Float[np.ndarray, "N"],
    present: Bool[np.ndarray, "T N"],
    width: float = LANE,
) -> Float[np.ndarray, "T"]:
    """How well people who walk in two directions are sorted into lanes.

    The mean over people of ((s - o) / n)^2, where of the n people within ``width`` across the corridor, themselves
    included, s walk in their direction and o in the other. It is 1 in lanes, and about 1 / n in a random mix.

    Args:
        across: (T, N) m, position across the corridor.
        direction: (N,) +1 or -1.
        present: (T, N) who is there.
        width: m.

    Returns:
        (T,) from 0 to 1; NaN where nobody is.
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


def single_file(
    along: Float[np.ndarray, "T N"], velocity: Float[np.ndarray, "T N"], length: float
) -> tuple[Float[np.ndarray, "T N"], Float[np.ndarray, "T N"]]:
    """Density and speed of everybody in a single file around a loop: Voronoi cells in one dimension.

    Args:
        along: (T, N) m, position along the loop.
        velocity: (T, N) m/s along the loop.
        length: m, of the loop.

    Returns:
        (T, N) 1/m, one over half the distance from who walks ahead to who walks behind; and (T, N) m/s; both in the
        order along the loop.
    """
    along = np.asarray(along, float) % length
    order = np.argsort(along, axis=1)
    ahead = np.diff(np.take_along_axis(along, order, 1), axis=1, append=0.0)
    ahead[:, -1] = length - ahead[:, :-1].sum(1)
    cell = 0.5 * (ahead + np.roll(ahead, 1, axis=1))
    return 1.0 / np.maximum(cell, 1e-6), np.take_along_axis(np.asarray(velocity, float), order, 1)


def separation(
    one: Float[np.ndarray, "T *shape 2"], other: Float[np.ndarray, "T *shape 2"]
) -> Float[np.ndarray, "*shape"]:
    """How near two bodies come to each other; between moments both move straight on.

    Args:
        one: (T, ..., 2) m.
        other: (T, ..., 2) m.

    Returns:
        (...) m, the least distance of their middles.
    """
    gap = np.asarray(one, float) - np.asarray(other, float)
    step = np.diff(gap, axis=0)
    squared = (step**2).sum(-1)
    share = np.clip(-(gap[:-1] * step).sum(-1) / np.where(squared > 0.0, squared, 1.0), 0.0, 1.0)
    nearest = gap[:-1] + share[..., None] * step
    return np.asarray(np.sqrt((nearest**2).sum(-1)).min(0))


def _corners(bounds: Bounds) -> list[tuple[float, float]]:
    x0, y0, x1, y1 = bounds
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
