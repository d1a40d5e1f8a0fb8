"""Floor plans in memory: walls of boxes, segments, rooms with doors and corridors become an environment.

A plan is an array (W, 5) with a row for each box: center x and y, half extents along and across [m], yaw [rad]. Plans
are joined by ``np.concatenate``.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from jaxtyping import Float

from sean_jax.base import Environment, ObstacleGrid, Obstacles
from sean_jax.devices import to_device
from sean_jax.environment import plain_scenery
from sean_jax.errors import InputError
from sean_jax.geometry import build_obstacle_grid

Point = tuple[float, float]  # m

THIN = 0.02  # m, thickness of a wall that is drawn as a segment
THICK = 0.2  # m, of the walls around rooms and corridors, which lie outside them
HEIGHT = 2.5  # m
MARGIN = 1.0  # m of floor around the boxes
CELLS = 64  # of the grid along x and y: the same for all plans, so that they share programs
SIZES = (8, 16), (32, 128)  # obstacles near a cell, and obstacles: plans are padded to the first pair that is enough
FAR = 1e4  # m, where padding lies


def box(lower: Point, upper: Point) -> Float[np.ndarray, "1 5"]:
    """A box along x and y, from the corner with the smallest coordinates to the corner with the largest [m]."""
    low, high = np.asarray(lower, float), np.asarray(upper, float)
    return np.array([[*(low + high) / 2, *(high - low) / 2, 0.0]])


def wall(*points: Point) -> Float[np.ndarray, "W 5"]:
    """A thin wall (0.02 m) along a line of two or more points [m], a box for each segment."""
    rows = []
    for begin, end in zip(points, points[1:], strict=False):
        begin, end = np.asarray(begin, float), np.asarray(end, float)
        along = end - begin
        rows.append([*(begin + end) / 2, np.hypot(*along) / 2, THIN / 2, np.arctan2(along[1], along[0])])
    return np.array(rows).reshape(-1, 5)


def room(lower: Point, upper: Point, doors: Iterable[tuple[Point, Point]] = ()) -> Float[np.ndarray, "W 5"]:
    """The four walls around a rectangle from ``lower`` to ``upper`` [m], with doors in them.

    Args:
        doors: the two ends of each opening, on a side of the rectangle [m].

    Raises:
        InputError: a door lies on no side.
    """
    (x0, y0), (x1, y1) = lower, upper
    sides = {("x", x0): (x0 - THICK, x0), ("x", x1): (x1, x1 + THICK)}
    sides |= {("y", y0): (y0 - THICK, y0), ("y", y1): (y1, y1 + THICK)}
    openings: dict[tuple[str, float], list[tuple[float, float]]] = {side: [] for side in sides}
    for (ax, ay), (bx, by) in doors:
        side = ("x", ax) if ax == bx else ("y", ay)
        if side not in openings:
            raise InputError(f"doors: {((ax, ay), (bx, by))} lies on no side of the room from {lower} to {upper}.")
        openings[side].append((min(ay, by), max(ay, by)) if ax == bx else (min(ax, bx), max(ax, bx)))
    plan = []
    for side, (inner, outer) in sides.items():
        first, last = (y0 - THICK, y1 + THICK) if side[0] == "x" else (x0, x1)
        ends = [first, *(end for opening in sorted(openings[side]) for end in opening), last]
        for begin, end in zip(ends[::2], ends[1::2], strict=True):
            if end > begin:
                plan.append(box((inner, begin), (outer, end)) if side[0] == "x" else box((begin, inner), (end, outer)))
    return np.concatenate(plan)


def corridor(length: float, width: float, margin: float = 0.0) -> Float[np.ndarray, "2 5"]:
    """The two walls of a corridor along x from (0, 0), y from 0 to the width [m], with open ends.

    Args:
        margin: by which the walls go on at both ends [m]; half a period of a periodic corridor.
    """
    return np.concatenate(
        [box((-margin, -THICK), (length + margin, 0.0)), box((-margin, width), (length + margin, width + THICK))]
    )


def environment(plan: Float[np.ndarray, "W 5"], name: str = "scene") -> Environment:
    """The environment of a plan (W, 5), open at its edges, on the default device.

    Arrays are padded with obstacles far away, so that most plans have equal shapes.

    Raises:
        InputError: there are too many boxes, in all or near one place.
    """
    plan = np.asarray(plan, float).reshape(-1, 5)
    cosine, sine = np.abs(np.cos(plan[:, 4])), np.abs(np.sin(plan[:, 4]))
    reach = np.stack([plan[:, 2] * cosine + plan[:, 3] * sine, plan[:, 2] * sine + plan[:, 3] * cosine], 1)
    corners = np.concatenate([plan[:, :2] - reach, plan[:, :2] + reach, np.zeros((1, 2))])
    floor = np.concatenate([corners.min(0) - MARGIN, corners.max(0) + MARGIN])
    grid = _grid(plan, floor)
    number = next((walls for near, walls in SIZES if near == grid.rows.shape[2] and walls >= len(plan)), None)
    if number is None:
        raise InputError(f"walls: {len(plan)} boxes are more than {SIZES[-1][1]}; use fewer and larger boxes.")
    rows = np.zeros((number, 5))
    rows[:, :2], rows[:, 2:4] = FAR, 1.0
    rows[: len(plan)] = plan
    obstacles = Obstacles(*to_device((rows[:, :2], rows[:, 2:4], rows[:, 4], np.full(number, HEIGHT))))
    return Environment(
        floor=to_device(floor),
        obstacles=obstacles,
        obstacle_grid=grid,
        scenery=plain_scenery(obstacles),
        name=name,
        open=True,
    )


def _grid(plan: np.ndarray, floor: Any) -> ObstacleGrid:
    """The grid of obstacles with ``CELLS`` by ``CELLS`` cells and a padded number of rows in each."""
    obstacles = Obstacles(plan[:, :2], plan[:, 2:4], plan[:, 4], np.full(len(plan), HEIGHT))  # pyright: ignore
    cell = max(1.0, float((floor[2:] - floor[:2]).max()) / CELLS + 1e-6)
    grid = build_obstacle_grid(obstacles, floor, cell)
    rows = np.asarray(grid.rows)
    near = next((near for near, walls in SIZES if near >= rows.shape[2] and walls >= len(plan)), None)
    if near is None:
        raise InputError(f"walls: {rows.shape[2]} boxes of {len(plan)} lie near one place; use fewer and larger boxes.")
    padded = np.zeros((*rows.shape[:2], near, 6))
    padded[..., 0], padded[..., 1], padded[..., 4] = FAR, FAR, 1.0
    padded[:, :, : rows.shape[2]] = rows
    missing = [(0, CELLS - count) for count in rows.shape[:2]]
    padded = np.pad(padded, [*missing, (0, 0), (0, 0)], mode="edge")  # places off the floor have the rows of its edge
    return ObstacleGrid(*to_device((padded, np.asarray(grid.origin), np.asarray(grid.cell))))
