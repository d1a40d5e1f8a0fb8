"""Shortest paths around obstacles: one table over the inflated corners of obstacles, looked up inside jit.

A shortest path among boxes bends only at corners. The corners, moved out by the walker's radius, are the via
points of a visibility graph; Dijkstra over it gives the table of distances, and a grid says which via points can
be seen from where. All of that is built once on the host; inside jit a path is a look-up and a minimum.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from sean_jax import environment as environments
from sean_jax.base import Array, Environment, Obstacles
from sean_jax.geometry import angle_between, crosses_box, from_box, length, rotate

CELL = 0.25  # m
MOST_CELLS = 100_000  # of a visibility grid; the cells of larger floors are wider
AT = 0.3  # m: a walker that close to a via point has passed it
MARGIN = 0.05  # m, by which via points stand off farther than the radius
SLIM = 0.7  # of the radius: a box grown by less than 1 / sqrt(2) of it never covers a legal place at its corner
BENDS = 32  # at most, that are counted on a path
PLACES = 1024  # free places kept for drawing starts and goals


@struct.dataclass
class Navigation:
    """Tables of shortest paths for a disc of one radius."""

    via: Array  # (V, 2) m, points where a path can bend
    edge: Array  # (V, V) m, straight from one to another; inf where something is in the way
    distance: Array  # (V, V) m, along the shortest path; inf where there is none
    visible: Array  # (X, Y, V) bool, seen from the middle of the cell
    origin: Array  # (2,) m, lower left corner of the grid
    cell: Array  # () m, side of its cells
    places: Array  # (P, 2) m, uniform over where the disc is free and from where it can go anywhere else
    obstacles: Obstacles
    radius: Array  # () m


def build(environment: Environment, radius: float, cell: float | None = None) -> Navigation:
    """The tables for a disc of that radius [m]; runs on the host, once.

    ``cell`` [m] is the side of the cells of the visibility grid: 0.25 if None, or a multiple of it on large floors.

    Raises:
        ValueError: there is hardly a free place for such a disc.
    """
    boxes = environment.obstacles
    drawn = environments.free_points(environment, radius + 2 * MARGIN, PLACES, seed=1)
    via = _corners(environment, radius + MARGIN, radius)
    via = via if len(via) else drawn[:1]  # an open place: no path bends, but the tables must not be empty
    visible = np.asarray(jax.jit(_sees_all)(via, via, boxes, radius - 1e-3))
    gap = np.linalg.norm(via[:, None] - via[None], axis=-1)
    edge = np.where(visible & (gap > 0), gap, np.inf)
    i, j = np.nonzero(np.isfinite(edge))
    distance = dijkstra(csr_matrix((gap[i, j], (i, j)), shape=gap.shape))
    floor = np.asarray(environment.floor)
    if cell is None:
        area = float(np.prod(floor[2:] - floor[:2]))
        cell = CELL * max(1, math.ceil(math.sqrt(area / MOST_CELLS) / CELL))
    count = np.ceil((floor[2:] - floor[:2]) / cell).astype(int)
    middle = [floor[k] + (np.arange(count[k]) + 0.5) * cell for k in (0, 1)]
    spots = np.stack(np.meshgrid(*middle, indexing="ij"), -1).reshape(-1, 2).astype(np.float32)
    seen = np.asarray(jax.jit(_sees_from_cells)(spots, via, boxes, radius)).reshape(*count, len(via))
    return Navigation(
        via=jnp.asarray(via),
        edge=jnp.asarray(edge, jnp.float32),
        distance=jnp.asarray(distance, jnp.float32),
        visible=jnp.asarray(seen),
        origin=jnp.asarray(floor[:2], jnp.float32),
        cell=jnp.asarray(cell, jnp.float32),
        places=jnp.asarray(_connected(drawn, via, distance, boxes, radius)),
        obstacles=boxes,
        radius=jnp.asarray(radius, jnp.float32),
    )


def sees(boxes: Obstacles, p: Array, q: Array, radius: Array | float) -> Array:
    """() bool: a disc of that radius [m] can move straight from p (2,) to q (2,), exactly."""
    hit = jax.vmap(crosses_box, in_axes=(None, None, None, None, 0, None))(p[0], p[1], q[0], q[1], boxes, radius)
    return ~hit.any()


def seen_from(navigation: Navigation, position: Array) -> Array:
    """(V,) bool: the via points to which the way from the position (2,) [m] is clear."""
    return _sees_from(position, navigation.via, navigation.obstacles, navigation.radius)


def seen_from_cell(navigation: Navigation, position: Array) -> Array:
    """(V,) bool: those seen from the middle of the cell around the position (2,) [m]; a look-up."""
    most = jnp.asarray(navigation.visible.shape[:2], jnp.int32) - 1
    index = jnp.clip(jnp.floor((position - navigation.origin) / navigation.cell).astype(jnp.int32), 0, most)
    return navigation.visible[index[0], index[1]]


def to_goal(navigation: Navigation, goal: Array) -> Array:
    """(V,) length [m] of the shortest path from each via point to a goal (2,) [m]; inf where there is none."""
    open_way = jax.vmap(lambda via: sees(navigation.obstacles, via, goal, navigation.radius * SLIM))(navigation.via)
    last = jnp.where(open_way, _from(navigation.via, goal), jnp.inf)
    return jnp.min(navigation.distance + last[None, :], axis=1)


def geodesic(navigation: Navigation, position: Array, goal: Array, to_goal: Array) -> Array:
    """() length [m] of the shortest path from the position (2,) to the goal (2,), whose ``to_goal`` (V,) is given."""
    ahead = goal - position
    straight = sees(navigation.obstacles, position, goal, navigation.radius * SLIM)
    around = jnp.min(_detour(navigation, position, to_goal))
    return jnp.where(straight, length(ahead[0], ahead[1]), around)


def geodesic_roughly(navigation: Navigation, position: Array, goal: Array, to_goal: Array) -> Array:
    """As ``geodesic``, but within about a cell: cheap enough for many positions at once."""
    ahead = goal - position
    straight = clear_way(navigation.obstacles, position, goal, navigation.radius * SLIM)
    around = jnp.where(seen_from_cell(navigation, position), _from(navigation.via, position) + to_goal, jnp.inf)
    return jnp.where(straight, length(ahead[0], ahead[1]), jnp.min(around))


def next_point(navigation: Navigation, position: Array, goal: Array, to_goal: Array) -> Array:
    """(2,) [m] where the shortest path from the position (2,) bends next, or the goal (2,) if it lies in sight."""
    straight = sees(navigation.obstacles, position, goal, navigation.radius * SLIM)
    detour = _detour(navigation, position, to_goal)
    lost = ~jnp.isfinite(jnp.min(detour))
    first = jnp.argmin(detour).astype(jnp.int32)
    after = _after(navigation, goal, to_goal)[first]
    bend = jnp.where(
        after < navigation.via.shape[0], navigation.via[jnp.minimum(after, navigation.via.shape[0] - 1)], goal
    )
    ahead = navigation.via[first] - position
    away = length(ahead[0], ahead[1])
    open_way = clear_way(navigation.obstacles, position, bend, navigation.radius * SLIM)
    passed = (away < MARGIN) | ((away < AT) & open_way)
    return jnp.where(straight | lost, goal, jnp.where(passed, bend, navigation.via[first]))


def turning(navigation: Navigation, position: Array, heading: Array, goal: Array, to_goal: Array) -> Array:
    """() rad: how much one turns, left and right added up, on the shortest path, beginning with the heading (2,).

    From the position (2,) to the goal (2,) [m], whose ``to_goal`` (V,) is given; no turning at the goal.
    """
    last = navigation.via.shape[0]
    straight = sees(navigation.obstacles, position, goal, navigation.radius * SLIM)
    detour = _detour(navigation, position, to_goal)
    first = jnp.where(straight | ~jnp.isfinite(jnp.min(detour)), last, jnp.argmin(detour).astype(jnp.int32))
    points = jnp.concatenate([navigation.via, goal[None, :], goal[None, :]])  # at the goal, it stays there
    follow = jnp.concatenate([_after(navigation, goal, to_goal), jnp.full(2, last + 1, jnp.int32)])

    def leg(carry: tuple, _) -> tuple:
        place, direction, index, total = carry
        ahead = points[index] - place
        here = length(ahead[0], ahead[1]) < 1e-4
        angle = jnp.where(here, 0.0, jnp.abs(angle_between(direction, ahead)))
        return (points[index], jnp.where(here, direction, ahead), follow[index], total + angle), None

    start = position, heading, first, jnp.zeros((), position.dtype)
    return jax.lax.scan(leg, start, length=BENDS)[0][3]


def towards(navigation: Navigation, points: Array) -> tuple[Array, Array]:
    """Which via point to head for on the way to each of the points (M, 2) [m]; runs on the host, once.

    (X, Y, M) int16 from each cell of 0.25 m, and (V, M) int16 from each via point: an index of a via point, or V
    where the point itself is seen (or cannot be reached).
    """
    goal_side = jax.vmap(to_goal, in_axes=(None, 0))(navigation, points)  # (M, V)
    none, wide = navigation.via.shape[0], round(float(navigation.cell) / CELL)
    cells = tuple(count * wide for count in navigation.visible.shape[:2])
    i, j = jnp.meshgrid(*(jnp.arange(n, dtype=jnp.float32) for n in cells), indexing="ij")
    spots = navigation.origin[None, :] + (jnp.stack([i, j], -1).reshape(-1, 2) + 0.5) * CELL
    direct = jax.jit(_sees_from_cells)(spots, points, navigation.obstacles, navigation.radius)

    def best(case):
        spot, in_sight = case
        first = jnp.where(seen_from(navigation, spot), _from(navigation.via, spot), jnp.inf)
        total = first[None, :] + goal_side
        lost = ~jnp.isfinite(jnp.min(total, axis=1))
        return jnp.where(in_sight | lost, none, jnp.argmin(total, axis=1).astype(jnp.int32)).astype(jnp.int16)

    first = jax.jit(lambda spots, direct: jax.lax.map(best, (spots, direct), batch_size=1024))(spots, direct)
    after = jax.vmap(_after, in_axes=(None, 0, 0), out_axes=1)(navigation, points, goal_side)
    return first.reshape(*cells, points.shape[0]), after.astype(jnp.int16)


def _after(navigation: Navigation, goal: Array, to_goal: Array) -> Array:
    """(V,) index of the via point that follows each one on the way to the goal (2,); V where the goal follows."""
    onward = navigation.edge + to_goal[None, :]
    last = to_goal <= _from(navigation.via, goal) + 1e-4
    return jnp.where(last, navigation.via.shape[0], jnp.argmin(onward, axis=1).astype(jnp.int32))


def clear_way(boxes: Obstacles, p: Array, q: Array, growth: Array | float) -> Array:
    """() bool: the segment from p (2,) to q (2,) misses all boxes grown by so much [m] on each side; cheap."""
    cosine, sine = jnp.cos(boxes.yaw), jnp.sin(boxes.yaw)
    pu, pv = rotate(p[0] - boxes.center[:, 0], p[1] - boxes.center[:, 1], cosine, -sine)
    qu, qv = rotate(q[0] - boxes.center[:, 0], q[1] - boxes.center[:, 1], cosine, -sine)
    hu, hv = boxes.half_extent[:, 0] + growth, boxes.half_extent[:, 1] + growth
    # Separating axes of a segment and a rectangle: its two sides and the segment's own normal.
    mu, mv, du, dv = 0.5 * (pu + qu), 0.5 * (pv + qv), 0.5 * (qu - pu), 0.5 * (qv - pv)
    apart = (jnp.abs(mu) > hu + jnp.abs(du)) | (jnp.abs(mv) > hv + jnp.abs(dv))
    apart |= jnp.abs(mu * dv - mv * du) > hu * jnp.abs(dv) + hv * jnp.abs(du)
    return apart.all()


def _detour(navigation: Navigation, position: Array, to_goal: Array) -> Array:
    """(V,) length [m] of the way to the goal by each via point; inf for those out of sight."""
    return jnp.where(seen_from(navigation, position), _from(navigation.via, position) + to_goal, jnp.inf)


def _from(points: Array, position: Array) -> Array:
    gap = points - position[None, :]
    return length(gap[:, 0], gap[:, 1])


def _sees_all(points: Array, others: Array, boxes: Obstacles, radius: float) -> Array:
    return jax.vmap(lambda p: jax.vmap(lambda q: sees(boxes, p, q, radius))(others))(points)


def _sees_from_cells(spots: Array, points: Array, boxes: Obstacles, radius: float) -> Array:
    """(cells, V) bool: the points that are seen from the middles of cells."""
    return jax.lax.map(lambda spot: _sees_from(spot, points, boxes, radius), spots, batch_size=256)


def _sees_from(spot: Array, points: Array, boxes: Obstacles, radius: Array | float) -> Array:
    """(V,) bool, by boxes grown by less than the radius; a spot inside them is first led out of them."""
    for _ in range(2):
        distance, nx, ny = jax.vmap(from_box, in_axes=(None, None, 0))(spot[0], spot[1], boxes)
        nearest = jnp.argmin(distance)
        out = jnp.maximum(radius - distance[nearest], 0.0)
        spot = spot + out * jnp.stack([nx[nearest], ny[nearest]])
    # Kept apart, or XLA finds the spot anew for each pair of a point and a box, and compiles for minutes.
    spot = jax.lax.optimization_barrier(spot)
    return jax.vmap(lambda point: clear_way(boxes, spot, point, radius * SLIM))(points)


def _corners(environment: Environment, offset: float, radius: float) -> np.ndarray:
    """(V, 2) corners of all boxes moved out by the offset, without those that are off the floor or not free."""
    boxes = environment.obstacles
    cosine, sine = np.cos(boxes.yaw), np.sin(boxes.yaw)
    points = []
    for su in (-1, 1):
        for sv in (-1, 1):
            u, v = su * (boxes.half_extent[:, 0] + offset), sv * (boxes.half_extent[:, 1] + offset)
            points.append(np.stack([cosine * u - sine * v, sine * u + cosine * v], -1) + boxes.center)
    via = np.concatenate(points).astype(np.float32)
    return via[np.asarray(environments.clearance(environment, jnp.asarray(via))) > radius]


def _connected(places: np.ndarray, via: np.ndarray, distance: np.ndarray, boxes: Obstacles, radius: float):
    """The places that see a via point of the largest connected part."""
    reached = np.isfinite(distance)
    largest = reached[np.argmax(reached.sum(1))]
    seen = np.asarray(jax.jit(_sees_all)(places, via, boxes, radius * SLIM))
    return places[(seen & largest).any(1)]
