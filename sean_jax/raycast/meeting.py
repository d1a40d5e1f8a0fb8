"""Which body each ray of a bundle meets first (section IV-F), exactly, and without asking about bodies out of sight.

For each tile of rays the bodies within its sector, reach and slopes are counted. A loop then goes through all of them,
tile after tile, so it takes as long as there is work. It has no gradient and needs none: ``surface`` computes the
distance to the body that was found anew.
"""

from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp

from sean_jax.base import Array
from sean_jax.geometry import length
from sean_jax.raycast import laws
from sean_jax.raycast.rays import Beams, Rays
from sean_jax.raycast.view import View

Row = Array | tuple[Array, ...]  # a table's columns, each of which broadcasts against rays (T, P)
Law = Callable[[Row, Beams], Array]  # (T, P) m along the beams to the bodies of those rows

CHUNK = 4  # bodies of a task
SHARE = 2  # tiles for each task of a turn
TALLEST = laws.HEAD + laws.HEAD_RADIUS  # m, of people


def nearest(view: View, rays: Rays) -> Array:
    """(T, P) m the distance along each ray to the first body that it meets, ``laws.MISS`` where it meets none."""
    beams = Beams.of(rays)
    found = laws.ground(view.height, beams.direction[2], beams.inverse_rise)
    for _, table, law, in_sight in _families(view, rays):
        if table.shape[0]:
            found = _nearest(law, table, in_sight, beams, found)
    return found


def search(view: View, rays: Rays) -> tuple[Array, Array]:
    """As ``nearest``, and (T, P) int32 the number of that body."""
    beams, floor = Beams.of(rays), _starts(view)[4]
    distance = laws.ground(view.height, beams.direction[2], beams.inverse_rise)
    found = distance, jnp.where(distance < laws.MISS, floor, floor + 1).astype(jnp.int32)
    for start, table, law, in_sight in _families(view, rays):
        if table.shape[0]:
            found = _first(law, table, in_sight, start, beams, found)
    return found


def _starts(view: View) -> tuple[int, int, int, int, int]:
    """The number of the first body of each family, and of the floor."""
    boxes, cylinders, spheres, people = view.counts
    return 0, boxes, boxes + cylinders, boxes + cylinders + spheres, boxes + cylinders + spheres + people


def _families(view: View, rays: Rays) -> Iterator[tuple[int, Array, Law, Array]]:
    """(number of the first, table (K, F), law of rows (F of (T, 1)), which tiles have it in sight (T, K))."""
    first_of = _starts(view)
    boxes, cylinders, spheres, people = view.boxes, view.cylinders, view.spheres, view.people

    def edge_of_box(x, y):  # (T, K) m, how far the box stands out in a direction
        cosine, sine = boxes[None, :, 6], boxes[None, :, 7]
        return jnp.abs(x * cosine + y * sine) * boxes[None, :, 3] + jnp.abs(y * cosine - x * sine) * boxes[None, :, 4]

    u = boxes[:, 6] * boxes[:, 0] + boxes[:, 7] * boxes[:, 1]
    v = boxes[:, 6] * boxes[:, 1] - boxes[:, 7] * boxes[:, 0]
    zero = jnp.zeros((), float)
    away = length(jnp.maximum(jnp.abs(u) - boxes[:, 3], zero), jnp.maximum(jnp.abs(v) - boxes[:, 4], zero))
    yield first_of[0], boxes, _box, _in_sight(rays, boxes, edge_of_box, away, boxes[:, 2] + boxes[:, 5])

    flat = length(cylinders[:, 3], cylinders[:, 4]) * cylinders[:, 7]
    out = cylinders[:, 6] + flat
    top = cylinders[:, 2] + jnp.abs(cylinders[:, 5]) * cylinders[:, 7] + cylinders[:, 6]
    yield first_of[1], cylinders, _cylinder, _round_in_sight(rays, cylinders, out, top)

    out = spheres[:, 3]
    yield first_of[2], spheres, _sphere, _round_in_sight(rays, spheres, out, spheres[:, 2] + out)

    out = jnp.broadcast_to(view.radius, people.shape[:1])
    yield first_of[3], people, _person(rays.low, view), _round_in_sight(rays, people, out, TALLEST - view.height)


def _round_in_sight(rays: Rays, table: Array, radius: Array, top: Array) -> Array:
    away = jnp.maximum(length(table[:, 0], table[:, 1]) - radius, 0.0)
    return _in_sight(rays, table, lambda x, y: radius[None, :], away, jnp.broadcast_to(top, away.shape))


def _in_sight(rays: Rays, table: Array, edge: Callable, away: Array, top: Array) -> Array:
    """(T, K) bool: the body may meet a ray of the tile. ``away`` (K,) m is its least distance over the ground."""
    x, y = table[None, :, 0], table[None, :, 1]
    seen = rays.reach[:, None] >= away[None, :]
    for normal in (rays.left, rays.right):
        nx, ny = normal[:, :1], normal[:, 1:]
        seen &= nx * x + ny * y + edge(nx, ny) >= 0.0
    return seen & ((rays.lowest[:, None] <= 0.0) | (top[None, :] >= rays.lowest[:, None] * away[None, :]))


def _nearest(law: Law, table: Array, in_sight: Array, beams: Beams, found: Array) -> Array:
    """Distances (T, P) after the bodies of a table (K, F) were met as well.

    The work is a list of tasks, each up to ``CHUNK`` bodies of one tile, so empty tiles do not wait for full ones. Two
    tasks of a turn may be of one tile: the least is taken of integers, which a GPU does without waiting and in
    whatever order, and distances, none of which is negative, are in the order of their bits.
    """
    tiles, count = in_sight.shape
    real = found.dtype
    whole = jnp.int64 if real == jnp.float64 else jnp.int32  # as many bits
    ends = _ends(in_sight)
    padded = jnp.concatenate([table, table[-1:]])  # a row for tiles that have no more; what it gives is not used
    tasks = (ends[:, -1].astype(jnp.int32) + (CHUNK - 1)) // CHUNK
    last = jnp.cumsum(tasks)
    many = max(1, tiles // SHARE)  # tasks of a turn
    turns = _most((last[-1] + (many - 1)) // many)

    def take(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        turn, found = carry
        task = turn * many + jnp.arange(many, dtype=jnp.int32)
        tile = (last[None, :] <= task[:, None]).sum(1, dtype=jnp.int32)
        there = jnp.minimum(tile, tiles - 1)
        begin = CHUNK * (task - (last - tasks)[there])
        own, of_tile = ends[there], beams.of_tiles(there)
        new = jnp.full((many, found.shape[1]), laws.MISS, real)
        for more in range(CHUNK):
            chosen = (own <= (begin + more).astype(own.dtype)[:, None]).sum(1, dtype=jnp.int32)
            meets = law(padded[chosen].T[:, :, None], of_tile)
            new = jnp.minimum(new, jnp.where((chosen < count)[:, None], meets, laws.MISS))
        bits = jax.lax.bitcast_convert_type(new, whole)
        return turn + 1, found.at[tile].min(bits, mode="drop")

    bits = jax.lax.bitcast_convert_type(found, whole)
    bits = jax.lax.while_loop(lambda carry: carry[0] < turns, take, (jnp.zeros((), jnp.int32), bits))[1]
    return jax.lax.bitcast_convert_type(bits, real)


def _first(
    law: Law, table: Array, in_sight: Array, start: int, beams: Beams, found: tuple[Array, Array]
) -> tuple[Array, Array]:
    """Distances and numbers (T, P) after the bodies of a table (K, F) were met as well, one of each tile in a turn."""
    count = table.shape[0]
    ends = _ends(in_sight)
    padded = jnp.concatenate([table, table[-1:]])
    turns = _most(ends[:, -1].max().astype(jnp.int32))

    def take(carry: tuple[Array, tuple[Array, Array]]) -> tuple[Array, tuple[Array, Array]]:
        turn, (distance, number) = carry
        chosen = (ends <= turn.astype(ends.dtype)).sum(1, dtype=jnp.int32)  # the next that the tile has in sight
        new = law(padded[chosen].T[:, :, None], beams)
        nearer = (new < distance) & (chosen < count)[:, None]
        found = jnp.where(nearer, new, distance), jnp.where(nearer, start + chosen[:, None], number)
        return turn + 1, found

    return jax.lax.while_loop(lambda carry: carry[0] < turns, take, (jnp.zeros((), jnp.int32), found))[1]


@jax.custom_batching.custom_vmap
def _most(turns: Array) -> Array:
    """The turns () that a loop takes; of a batch the most, for its end shall be one for all.

    XLA would otherwise keep what every turn was given, to undo the turn where the loop is over already.
    """
    return turns


@_most.def_vmap
def _most_of_all(size: int, batched: list[bool], turns: Array) -> tuple[Array, bool]:
    return _most(turns.max()), False


def _ends(in_sight: Array) -> Array:
    """(T, K) how many of the first bodies a tile has in sight."""
    small = jnp.uint8 if in_sight.shape[1] < 256 else jnp.int32  # it is read again and again
    return jnp.cumsum(in_sight, axis=1, dtype=small)


def surface(view: View, rays: Rays, number: Array) -> tuple[Array, Array, Array, Array]:
    """Distance (T, P) m along each ray to the body with that number (T, P), and the outward normal's x, y, z there.

    Differentiable in the view. Where the number is the sky's, or the ray passes the body by a rounding error, the
    distance is ``laws.MISS``.
    """
    first_of, beams = _starts(view), Beams.of(rays)
    dx, dy, dz = beams.direction
    distance = laws.ground(view.height, dz, beams.inverse_rise)
    distance = jnp.where(number == first_of[4], distance, laws.MISS)
    nx, ny, nz = jnp.zeros_like(dx * distance), jnp.zeros_like(distance), jnp.ones_like(distance)
    families = (
        (view.boxes, _box, _normal_of_box),
        (view.cylinders, _cylinder, _normal_of_cylinder),
        (view.spheres, _sphere, _normal_of_sphere),
        (view.people, _person(rays.low, view), lambda row, x, y, z: _normal_of_person(row, x, y, z, view)),
    )
    for start, (table, law, normal) in zip(first_of[:4], families, strict=True):
        if not table.shape[0]:
            continue
        mine = (number >= start) & (number < start + table.shape[0])
        index = jnp.clip(number - start, 0, table.shape[0] - 1)
        row = tuple(column[index] for column in table.T)
        there = law(row, beams)
        distance = jnp.where(mine, there, distance)
        at = jnp.where(mine & (there < laws.MISS), there, 1.0)
        facing = normal(row, *along(rays, at))
        nx, ny, nz = (jnp.where(mine, new, old) for new, old in zip(facing, (nx, ny, nz), strict=True))
    return distance, nx, ny, nz


def along(rays: Rays, distance: Array) -> tuple[Array, Array, Array]:
    """x, y, z [m] from the sensor, (T, P) each, of the places so far along the rays."""
    x, y, z = (distance * jnp.asarray(part) for part in rays.direction)
    if rays.offset is None:
        return x, y, z
    return x + rays.offset[0], y + rays.offset[1], z + rays.offset[2]


def _from_ray(beams: Beams, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
    """What lies at (x, y, z) from the sensor, from where each ray begins."""
    if beams.offset is None:
        return x, y, z
    return x - beams.offset[0], y - beams.offset[1], z - beams.offset[2]


def _box(row: Row, beams: Beams) -> Array:
    x, y, z = _from_ray(beams, row[0], row[1], row[2])
    return laws.box(x, y, z, row[3], row[4], row[5], row[6], row[7], *beams.direction, beams.inverse_rise)


def _cylinder(row: Row, beams: Beams) -> Array:
    x, y, z = _from_ray(beams, row[0], row[1], row[2])
    return laws.cylinder(x, y, z, row[3], row[4], row[5], row[6], row[7], *beams.direction)


def _sphere(row: Row, beams: Beams) -> Array:
    x, y, z = _from_ray(beams, row[0], row[1], row[2])
    return laws.sphere(x, y, z, row[3], *beams.direction)


def _person(low: bool, view: View) -> Law:
    shape = laws.legs if low else laws.person

    def law(row: Row, beams: Beams) -> Array:
        x, y, z = _from_ray(beams, row[0], row[1], jnp.broadcast_to(-view.height, row[0].shape))
        return shape(x, y, z, view.radius, *beams.direction, beams.inverse_run)

    return law


def _normal_of_box(row, x, y, z):
    u, v = row[6] * (x - row[0]) + row[7] * (y - row[1]), row[6] * (y - row[1]) - row[7] * (x - row[0])
    w = z - row[2]
    over = jnp.abs(u) - row[3], jnp.abs(v) - row[4], jnp.abs(w) - row[5]
    by_u, by_v = (over[0] >= over[1]) & (over[0] >= over[2]), over[1] >= over[2]
    nu = jnp.where(by_u, jnp.sign(u), 0.0)
    nv = jnp.where(~by_u & by_v, jnp.sign(v), 0.0)
    return row[6] * nu - row[7] * nv, row[7] * nu + row[6] * nv, jnp.where(by_u | by_v, 0.0, jnp.sign(w))


def _normal_of_cylinder(row, x, y, z):
    x, y, z = x - row[0], y - row[1], z - row[2]
    along = row[3] * x + row[4] * y + row[5] * z
    at_end = jnp.abs(along) >= row[7] * (1.0 - 1e-4)
    out = tuple(part - along * axis for part, axis in zip((x, y, z), row[3:6], strict=True))
    return tuple(
        jnp.where(at_end, jnp.sign(along) * axis, part / row[6]) for part, axis in zip(out, row[3:6], strict=True)
    )


def _normal_of_sphere(row, x, y, z):
    return (x - row[0]) / row[3], (y - row[1]) / row[3], (z - row[2]) / row[3]


def _normal_of_person(row, x, y, z, view: View):
    x, y, up = x - row[0], y - row[1], z + view.height
    in_head = up > 0.5 * (laws.SHOULDER + view.radius + laws.HEAD - laws.HEAD_RADIUS)
    size = jnp.where(in_head, laws.HEAD_RADIUS, view.radius)
    z = jnp.where(in_head, up - laws.HEAD, jnp.maximum(up - laws.SHOULDER, 0.0))
    return x / size, y / size, z / size
