"""Which body each ray of a bundle meets first (section IV-F), exactly, and without asking about bodies out of sight.

For each tile of rays the bodies within its sector, reach and slopes are counted; a loop then takes them one after the
other, as many as the fullest tile has. The loop has no gradient and needs none: ``surface`` computes the distance to
the body that was found anew.
"""

from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp

from sean_jax.base import Array
from sean_jax.geometry import length
from sean_jax.raycast import laws
from sean_jax.raycast.rays import Rays
from sean_jax.raycast.view import View

Row = Array | tuple[Array, ...]  # a table's columns, each of which broadcasts against rays (T, P)
Law = Callable[[Row], Array]  # (T, P) m to the bodies of those rows

CHUNK, FEW = 4, 8  # bodies that one turn of the loop takes; of few bodies, or for numbers as well, it takes one
TALLEST = laws.HEAD + laws.HEAD_RADIUS  # m, of people


def nearest(view: View, rays: Rays) -> Array:
    """(T, P) m the distance along each ray to the first body that it meets, ``laws.MISS`` where it meets none."""
    return _search(view, rays, (laws.ground(view.height, *_rises(rays)),))[0]


def search(view: View, rays: Rays) -> tuple[Array, Array]:
    """As ``nearest``, and (T, P) int32 the number of that body, which costs as much memory again."""
    floor = _starts(view)[4]
    distance = laws.ground(view.height, *_rises(rays))
    number = jnp.where(distance < laws.MISS, floor, floor + 1).astype(jnp.int32)
    distance, number = _search(view, rays, (distance, number))
    return distance, number


def _search(view: View, rays: Rays, found: tuple[Array, ...]) -> tuple[Array, ...]:
    for start, table, law, in_sight in _families(view, rays):
        if table.shape[0]:
            found = _nearest(law, table, in_sight, start, found)
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
    zero = jnp.zeros((), jnp.float32)
    away = length(jnp.maximum(jnp.abs(u) - boxes[:, 3], zero), jnp.maximum(jnp.abs(v) - boxes[:, 4], zero))
    yield first_of[0], boxes, _box(rays), _in_sight(rays, boxes, edge_of_box, away, boxes[:, 2] + boxes[:, 5])

    flat = length(cylinders[:, 3], cylinders[:, 4]) * cylinders[:, 7]
    out = cylinders[:, 6] + flat
    top = cylinders[:, 2] + jnp.abs(cylinders[:, 5]) * cylinders[:, 7] + cylinders[:, 6]
    yield first_of[1], cylinders, _cylinder(rays), _round_in_sight(rays, cylinders, out, top)

    out = spheres[:, 3]
    yield first_of[2], spheres, _sphere(rays), _round_in_sight(rays, spheres, out, spheres[:, 2] + out)

    out = jnp.broadcast_to(view.radius, people.shape[:1])
    yield first_of[3], people, _person(rays, view), _round_in_sight(rays, people, out, TALLEST - view.height)


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


def _nearest(law: Law, table: Array, in_sight: Array, start: int, found: tuple[Array, ...]) -> tuple[Array, ...]:
    """Distances (T, P), and numbers if ``found`` has them, after the bodies of a table (K, F) were met as well."""
    count = table.shape[0]
    small = jnp.uint8 if count < 256 else jnp.int32  # the table of counts is read again and again
    ends = jnp.cumsum(in_sight, axis=1, dtype=small)
    padded = jnp.concatenate([table, table[-1:]])  # a row for tiles that have no more; what it gives is not used
    chunk = CHUNK if count > FEW and len(found) == 1 else 1  # each more is compiled anew, and saves a turn on a GPU
    turns = (ends[:, -1].max().astype(jnp.int32) + (chunk - 1)) // chunk

    def take(carry: tuple[Array, tuple[Array, ...]]) -> tuple[Array, tuple[Array, ...]]:
        turn, found = carry
        for more in range(chunk):
            passed = ends <= (chunk * turn + more).astype(small)
            chosen = passed.sum(1, dtype=jnp.int32)  # the next that the tile has in sight
            new = law(padded[chosen].T[:, :, None])
            nearer = (new < found[0]) & (chosen < count)[:, None]
            values = new, start + chosen[:, None]
            found = tuple(jnp.where(nearer, value, old) for value, old in zip(values, found, strict=False))
        return turn + 1, found

    # Turns are counted by one: XLA for CPUs counted those of a step of 4 wrong (docs/architecture.md, Traps).
    return jax.lax.while_loop(lambda carry: carry[0] < turns, take, (jnp.zeros((), jnp.int32), found))[1]


def surface(view: View, rays: Rays, number: Array) -> tuple[Array, Array, Array, Array]:
    """Distance (T, P) m along each ray to the body with that number (T, P), and the outward normal's x, y, z there.

    Differentiable in the view. Where the number is the sky's, or the ray passes the body by a rounding error, the
    distance is ``laws.MISS``.
    """
    first_of = _starts(view)
    dx, dy, dz = _directions(rays)
    distance = laws.ground(view.height, *_rises(rays))
    distance = jnp.where(number == first_of[4], distance, laws.MISS)
    nx, ny, nz = jnp.zeros_like(dx * distance), jnp.zeros_like(distance), jnp.ones_like(distance)
    families = (
        (view.boxes, _box(rays), _normal_of_box),
        (view.cylinders, _cylinder(rays), _normal_of_cylinder),
        (view.spheres, _sphere(rays), _normal_of_sphere),
        (view.people, _person(rays, view), lambda row, x, y, z: _normal_of_person(row, x, y, z, view)),
    )
    for start, (table, law, normal) in zip(first_of[:4], families, strict=True):
        if not table.shape[0]:
            continue
        mine = (number >= start) & (number < start + table.shape[0])
        index = jnp.clip(number - start, 0, table.shape[0] - 1)
        row = tuple(column[index] for column in table.T)
        there = law(row)
        distance = jnp.where(mine, there, distance)
        at = jnp.where(mine & (there < laws.MISS), there, 1.0)
        facing = normal(row, *along(rays, at))
        nx, ny, nz = (jnp.where(mine, new, old) for new, old in zip(facing, (nx, ny, nz), strict=True))
    return distance, nx, ny, nz


def _directions(rays: Rays) -> tuple[Array, Array, Array]:
    return jnp.asarray(rays.direction[0]), jnp.asarray(rays.direction[1]), jnp.asarray(rays.direction[2])


def _rises(rays: Rays) -> tuple[Array, Array]:
    return jnp.asarray(rays.direction[2]), jnp.asarray(rays.inverse_rise)


def along(rays: Rays, distance: Array) -> tuple[Array, Array, Array]:
    """x, y, z [m] from the sensor, (T, P) each, of the places so far along the rays."""
    x, y, z = (distance * part for part in _directions(rays))
    if rays.offset is None:
        return x, y, z
    return x + rays.offset[0], y + rays.offset[1], z + rays.offset[2]


def _from_ray(rays: Rays, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
    """What lies at (x, y, z) from the sensor, from where each ray begins."""
    if rays.offset is None:
        return x, y, z
    return x - rays.offset[0], y - rays.offset[1], z - rays.offset[2]


def _box(rays: Rays) -> Law:
    (dx, dy, dz), inverse_dz = _directions(rays), jnp.asarray(rays.inverse_rise)

    def law(row: Row) -> Array:
        x, y, z = _from_ray(rays, row[0], row[1], row[2])
        return laws.box(x, y, z, row[3], row[4], row[5], row[6], row[7], dx, dy, dz, inverse_dz)

    return law


def _cylinder(rays: Rays) -> Law:
    dx, dy, dz = _directions(rays)

    def law(row: Row) -> Array:
        x, y, z = _from_ray(rays, row[0], row[1], row[2])
        return laws.cylinder(x, y, z, row[3], row[4], row[5], row[6], row[7], dx, dy, dz)

    return law


def _sphere(rays: Rays) -> Law:
    dx, dy, dz = _directions(rays)

    def law(row: Row) -> Array:
        x, y, z = _from_ray(rays, row[0], row[1], row[2])
        return laws.sphere(x, y, z, row[3], dx, dy, dz)

    return law


def _person(rays: Rays, view: View) -> Law:
    (dx, dy, dz), inverse_run = _directions(rays), jnp.asarray(rays.inverse_run)
    shape = laws.legs if rays.low else laws.person

    def law(row: Row) -> Array:
        x, y, z = _from_ray(rays, row[0], row[1], jnp.broadcast_to(-view.height, row[0].shape))
        return shape(x, y, z, view.radius, dx, dy, dz, inverse_run)

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
