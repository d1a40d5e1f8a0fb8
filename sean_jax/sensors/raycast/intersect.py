"""The first body that each ray of a bundle meets (section IV-F), exact, without testing bodies out of sight.

For each tile of rays, the bodies within its sector, reach and slopes are candidates. On a CPU one loop goes through the
candidates of all tiles, so it takes as long as there is work; on a GPU each tile has its own loop, in one kernel
(``raycast.kernel``). The search has no gradient and needs none: ``surface`` computes the distance to the first body
again.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from sean_jax.core import gpu_kernels
from sean_jax.core.data_types import Array
from sean_jax.core.devices import by_platform
from sean_jax.core.geometry import length
from sean_jax.sensors.raycast import kernel, shapes
from sean_jax.sensors.raycast.kernel import BodyFamily
from sean_jax.sensors.raycast.shapes import Row
from sean_jax.sensors.raycast.vectors import Vector, to_frame
from sean_jax.sensors.raycast.view import HEAD, HEAD_RADIUS, MISS, Beams, Rays, View, ground

DistanceLaw = Callable[[Row, Beams], Array]  # (tiles, rays) m along the beams to the bodies of these rows
Hit = tuple[Array, Array]  # (tiles, rays) each: distance [m] along the ray to a body, and the body's number

CHUNK = 4  # bodies tested in a task
SHARE = 2  # tiles per task of one iteration
PERSON_HEIGHT = HEAD + HEAD_RADIUS  # m


def nearest(view: View, rays: Rays) -> Float[Array, "tiles rays"]:
    """The distance [m] along each ray to the first body, ``MISS`` without one."""
    loops = partial(_nearest_of_all, rays)
    on_gpu = partial(_in_a_kernel, rays, 1)
    (distance,) = by_platform(loops, on_gpu)(view)
    return distance


def search(view: View, rays: Rays) -> tuple[Float[Array, "tiles rays"], Int[Array, "tiles rays"]]:
    """The distance [m] along each ray to the first body, ``MISS`` without one; and its number in the view."""
    loops = partial(_first_of_all, rays)
    on_gpu = partial(_in_a_kernel, rays, 2)
    return by_platform(loops, on_gpu)(view)


def search_behind(view: View, rays: Rays) -> tuple[Array, Array, Array, Array]:
    """Distances [m] and numbers of ``search``, then those of the first body that is no person; (tiles, rays) each."""
    loops = partial(_first_of_all, rays, behind=True)
    on_gpu = partial(_in_a_kernel, rays, 4)
    return by_platform(loops, on_gpu)(view)


def distance(view: View, rays: Rays) -> Float[Array, "tiles rays"]:
    """The distance of ``search`` [m], with the gradient of ``surface``: exact within outlines, finite on edges."""
    return _distance(rays, view)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def attach(rays: Rays, view: View, distance: Array, number: Array) -> Array:
    """The distance of ``search`` along each ray to the body of a number, with the gradient of ``surface``."""
    return distance


@attach.defjvp
def _attach_jvp(rays: Rays, primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    view, distance, number = primals
    view_tangent, _, _ = tangents
    return distance, _surface_derivative(rays, number, (view,), (view_tangent,))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _distance(rays: Rays, view: View) -> Array:
    return nearest(view, rays)


@_distance.defjvp
def _distance_jvp(rays: Rays, primals: tuple[View], tangents: tuple[View]) -> tuple[Array, Array]:
    fixed_view = jax.lax.stop_gradient(primals[0])
    distances, number = search(fixed_view, rays)
    return distances, _surface_derivative(rays, number, primals, tangents)


def _surface_derivative(rays: Rays, number: Array, primals: tuple[View], tangents: tuple[View]) -> Array:
    """(tiles, rays) change of the distance to the bodies of these numbers while the view changes."""

    def to_bodies(view: View) -> Array:
        distance, _ = surface(view, rays, number)
        return distance

    _, tangent = jax.jvp(to_bodies, primals, tangents)
    return tangent


# --- search on a CPU or a GPU ---


def _nearest_of_all(rays: Rays, view: View) -> tuple[Array]:
    """``nearest`` in loops of XLA's, for CPUs."""
    beams = Beams.of(rays)
    distance = ground(view.height, beams.direction.z, beams.inverse_rise)
    for family in families(view, rays):
        law = _distance_law(family, view)
        distance = _nearest(law, family.table, family.in_sight, beams, distance)
    return (distance,)


def _first_of_all(rays: Rays, view: View, behind: bool = False) -> tuple[Array, ...]:
    """``search``, or ``search_behind``, in loops of XLA's, for CPUs."""
    beams = Beams.of(rays)
    *_, floor = _first_numbers(view)
    sky = floor + 1
    distance = ground(view.height, beams.direction.z, beams.inverse_rise)
    number = jnp.where(distance < MISS, floor, sky).astype(jnp.int32)
    hit = distance, number
    scenery_hit = hit
    for family in families(view, rays):  # people come last, so a hit of scenery is before any of theirs
        law = _distance_law(family, view)
        hit = _first(law, family.table, family.in_sight, family.start, beams, hit)
        if family.scenery:
            scenery_hit = hit
    if behind:
        return (*hit, *scenery_hit)
    return hit


def _in_a_kernel(rays: Rays, results: int, view: View) -> tuple[Array, ...]:
    """``nearest`` (1 result), ``search`` (2) or ``search_behind`` (4), for GPUs."""
    double = any(leaf.dtype.itemsize > 4 for leaf in jax.tree.leaves(view))
    if double or not gpu_kernels.available():
        if results == 1:
            return _nearest_of_all(rays, view)
        return _first_of_all(rays, view, results == 4)
    *_, floor = _first_numbers(view)
    bodies = list(families(view, rays))
    return kernel.first(rays, bodies, view.radius, view.height, floor, results)


def _first_numbers(view: View) -> tuple[int, int, int, int, int]:
    """The number of the first body of each family, and the number of the floor."""
    boxes, cylinders, spheres, people = np.cumsum(view.counts).tolist()
    return 0, boxes, cylinders, spheres, people


def _distance_law(family: BodyFamily, view: View) -> DistanceLaw:
    return lambda row, beams: family.law(row, beams, view.radius, view.height)


# --- bodies in sight ---


def families(view: View, rays: Rays) -> Iterator[BodyFamily]:
    """The kinds of bodies that are there."""
    first_box, first_cylinder, first_sphere, first_person, _ = _first_numbers(view)
    reach = _reach(view, rays)
    if len(view.boxes):
        in_sight = _boxes_in_sight(view.boxes, rays, reach)
        yield BodyFamily(first_box, view.boxes, shapes.box_distance, in_sight)

    if len(view.cylinders):
        in_sight = _cylinders_in_sight(view.cylinders, rays, reach)
        yield BodyFamily(first_cylinder, view.cylinders, shapes.cylinder_distance, in_sight)

    if len(view.spheres):
        radius = view.spheres[:, 3]
        top = view.spheres[:, 2] + radius
        in_sight = _round_in_sight(reach, rays, view.spheres, radius, top)
        yield BodyFamily(first_sphere, view.spheres, shapes.sphere_distance, in_sight)

    if len(view.people):
        radius = jnp.broadcast_to(view.radius, view.people.shape[:1])
        top = PERSON_HEIGHT - view.height
        in_sight = _round_in_sight(reach, rays, view.people, radius, top)
        law = _person_law(rays)
        yield BodyFamily(first_person, view.people, law, in_sight, scenery=False)


def _person_law(rays: Rays) -> shapes.ShapeLaw:
    if rays.low:
        return shapes.low_person_distance
    return shapes.person_distance


def _boxes_in_sight(boxes: Array, rays: Rays, reach: Array) -> Array:
    def extent(nx: Array, ny: Array) -> Array:  # (tiles, K) m, of each box in a direction
        u, v = to_frame(nx, ny, boxes[None, :, 6], boxes[None, :, 7])
        half_u = boxes[None, :, 3]
        half_v = boxes[None, :, 4]
        return jnp.abs(u) * half_u + jnp.abs(v) * half_v

    # From the sensor, at the origin, to the outline on the floor.
    u, v = to_frame(boxes[:, 0], boxes[:, 1], boxes[:, 6], boxes[:, 7])
    zero = jnp.zeros((), float)
    beyond_u = jnp.maximum(jnp.abs(u) - boxes[:, 3], zero)
    beyond_v = jnp.maximum(jnp.abs(v) - boxes[:, 4], zero)
    away = length(beyond_u, beyond_v)
    top = boxes[:, 2] + boxes[:, 5]
    return _in_sight(reach, rays, boxes, extent, away, top)


def _cylinders_in_sight(cylinders: Array, rays: Rays, reach: Array) -> Array:
    radius = cylinders[:, 6]
    half_length = cylinders[:, 7]
    over_ground = length(cylinders[:, 3], cylinders[:, 4]) * half_length  # m, of half the axis
    top = cylinders[:, 2] + jnp.abs(cylinders[:, 5]) * half_length + radius
    return _round_in_sight(reach, rays, cylinders, radius + over_ground, top)


def _round_in_sight(reach: Array, rays: Rays, table: Array, radius: Array, top: Array) -> Array:
    """``_in_sight`` of bodies within a radius (K,) m around their middle."""
    to_middle = length(table[:, 0], table[:, 1])
    away = jnp.maximum(to_middle - radius, 0.0)
    top = jnp.broadcast_to(top, away.shape)
    return _in_sight(reach, rays, table, lambda x, y: radius[None, :], away, top)


def _reach(view: View, rays: Rays) -> Float[Array, "tiles"]:
    """The maximum horizontal distance [m] that the rays of each tile go, until they meet the floor."""
    falls = rays.slope_max < 0.0
    slope = np.where(falls, np.maximum(-rays.slope_max, 1e-9), 1.0)
    to_floor = jnp.where(falls, view.height / slope, MISS)
    return jnp.minimum(to_floor, rays.reach) + rays.spread


def _in_sight(reach: Array, rays: Rays, table: Array, extent: Callable, away: Array, top: Array) -> Array:
    """(tiles, K) bool: the body may meet a ray of the tile.

    Args:
        extent: of each body in a direction (x, y), m.
        away: (K,) m, minimum horizontal distance.
        top: (K,) m, of the highest point above the sensor.
    """
    x = table[None, :, 0]
    y = table[None, :, 1]
    away = away[None, :]
    possible = reach[:, None] >= away
    for normal in (rays.left, rays.right):
        nx = normal[:, :1]
        ny = normal[:, 1:]
        farthest = nx * x + ny * y + extent(nx, ny)  # m, of the body within the sector's side
        possible &= farthest >= 0.0
    slope_min = rays.slope_min[:, None]
    lowest = slope_min * away  # m, of the tile's rays at that distance
    return possible & ((slope_min <= 0.0) | (top[None, :] >= lowest))


# --- loops over the bodies in sight, for CPUs ---


class Tasks(NamedTuple):
    """The work of ``_nearest``: of each tile its bodies in sight, ``CHUNK`` in a task; tile after tile."""

    ends: Array  # (tiles, K) of ``_ends``
    count: Array  # (tiles,) int32
    last: Array  # (tiles,) int32, number of tasks of this tile and of those before


def _tasks(in_sight: Array) -> Tasks:
    ends = _ends(in_sight)
    bodies = ends[:, -1].astype(jnp.int32)
    count = (bodies + (CHUNK - 1)) // CHUNK
    return Tasks(ends, count, jnp.cumsum(count))


@jax.named_scope("nearest")
def _nearest(law: DistanceLaw, table: Array, in_sight: Array, beams: Beams, distance: Array) -> Array:
    """The minimum of distances (tiles, rays) and those to the bodies of a table (K, F).

    The work is a list of tasks, each up to ``CHUNK`` bodies of one tile, so that empty tiles do not wait for full ones.
    Two tasks of one iteration may be of the same tile. So the minimum is taken of integers, which a GPU does atomically
    in any order; the bits of distances, none of which is negative, have the order of the distances.
    """
    real = distance.dtype
    whole = jnp.int32  # as many bits
    if real == jnp.float64:
        whole = jnp.int64
    tasks = _tasks(in_sight)
    padded = _with_spare_row(table)
    width = max(1, len(in_sight) // SHARE)  # tasks of an iteration
    iterations = _max_of_batch((tasks.last[-1] + (width - 1)) // width)

    def run(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        iteration, nearest_bits = carry
        task = iteration * width + jnp.arange(width, dtype=jnp.int32)
        tile, new = _run_tasks(law, padded, tasks, beams, task)
        bits = jax.lax.bitcast_convert_type(new, whole)
        nearest_bits = nearest_bits.at[tile].min(bits, mode="drop")
        return iteration + 1, nearest_bits

    bits = jax.lax.bitcast_convert_type(distance, whole)
    start = jnp.zeros((), jnp.int32), bits
    _, bits = jax.lax.while_loop(lambda carry: carry[0] < iterations, run, start)
    return jax.lax.bitcast_convert_type(bits, real)


def _run_tasks(law: DistanceLaw, table: Array, tasks: Tasks, beams: Beams, task: Array) -> tuple[Array, Array]:
    """The tiles (tasks,) of tasks, and the minimum distances (tasks, rays) [m] to their bodies."""
    tiles, bodies = tasks.ends.shape
    tile = (tasks.last[None, :] <= task[:, None]).sum(1, dtype=jnp.int32)
    clipped = jnp.minimum(tile, tiles - 1)
    first_tasks = tasks.last - tasks.count  # of the tiles
    first_task = first_tasks[clipped]
    begin = CHUNK * (task - first_task)  # rank of the task's first body in the tile
    tile_ends = tasks.ends[clipped]
    tile_beams = beams.of_tiles(clipped)

    new = jnp.full((len(task), beams.inverse_rise.shape[1]), MISS, beams.inverse_rise.dtype)
    for offset in range(CHUNK):
        rank = (begin + offset).astype(tile_ends.dtype)
        body = (tile_ends <= rank[:, None]).sum(1, dtype=jnp.int32)
        distance = law(table[body].T[:, :, None], tile_beams)
        exists = (body < bodies)[:, None]
        distance = jnp.where(exists, distance, MISS)
        new = jnp.minimum(new, distance)
    return tile, new


@jax.named_scope("first")
def _first(law: DistanceLaw, table: Array, in_sight: Array, start: int, beams: Beams, hit: Hit) -> Hit:
    """The first of a hit and the bodies of a table (K, F), whose numbers begin at ``start``: one per tile at a time."""
    bodies = len(table)
    ends = _ends(in_sight)
    padded = _with_spare_row(table)
    iterations = _max_of_batch(ends[:, -1].max().astype(jnp.int32))

    def test(carry: tuple[Array, Hit]) -> tuple[Array, Hit]:
        iteration, (distance, number) = carry
        body = (ends <= iteration.astype(ends.dtype)).sum(1, dtype=jnp.int32)  # the next that the tile has in sight
        new = law(padded[body].T[:, :, None], beams)
        nearer = (new < distance) & (body < bodies)[:, None]
        distance = jnp.where(nearer, new, distance)
        number = jnp.where(nearer, start + body[:, None], number)
        return iteration + 1, (distance, number)

    start_carry = jnp.zeros((), jnp.int32), hit
    _, hit = jax.lax.while_loop(lambda carry: carry[0] < iterations, test, start_carry)
    return hit


def _with_spare_row(table: Array) -> Array:
    """The table with a row for tiles without further bodies; its result is not used."""
    return jnp.concatenate([table, table[-1:]])


@jax.custom_batching.custom_vmap
def _max_of_batch(iterations: Array) -> Array:
    """The number () of iterations of a loop; in a batch the maximum, so that all loops end together.

    With separate ends, XLA stores the input of every iteration, to undo it where a loop has ended already.
    """
    return iterations


@_max_of_batch.def_vmap
def _max_of_batch_vmap(size: int, batched: list[bool], iterations: Array) -> tuple[Array, bool]:
    return _max_of_batch(iterations.max()), False


def _ends(in_sight: Array) -> Array:
    """(tiles, K) number of the first bodies in sight of a tile."""
    dtype = jnp.int32
    if in_sight.shape[1] < 256:  # small, for it is read again and again
        dtype = jnp.uint8
    return jnp.cumsum(in_sight, axis=1, dtype=dtype)


# --- surfaces ---


def surface(view: View, rays: Rays, number: Int[Array, "tiles rays"]) -> tuple[Float[Array, "tiles rays"], Vector]:
    """The distance [m] along each ray to the body of a number, and the normal there. Differentiable in the view.

    The distance is ``MISS`` for the sky and where rounding lets a ray miss the body.
    """
    # Without a body it is the floor, whose normal points up, or the sky.
    first_box, first_cylinder, first_sphere, first_person, floor = _first_numbers(view)
    beams = Beams.of(rays)
    distance = ground(view.height, beams.direction.z, beams.inverse_rise)
    distance = jnp.where(number == floor, distance, MISS)
    horizontal = jnp.zeros_like(beams.direction.x * distance)
    normal = Vector(horizontal, jnp.zeros_like(distance), jnp.ones_like(distance))
    kinds = (
        (first_box, view.boxes, shapes.box_distance, shapes.box_normal),
        (first_cylinder, view.cylinders, shapes.cylinder_distance, shapes.cylinder_normal),
        (first_sphere, view.spheres, shapes.sphere_distance, shapes.sphere_normal),
        (first_person, view.people, _person_law(rays), shapes.person_normal),
    )
    for start, table, law, normal_law in kinds:
        count = len(table)
        if not count:
            continue

        # Rays to other kinds of bodies take any row, and keep what they have.
        end = start + count
        is_kind = (number >= start) & (number < end)
        index = jnp.clip(number - start, 0, count - 1)
        row = tuple(column[index] for column in table.T)

        to_body = law(row, beams, view.radius, view.height)
        distance = jnp.where(is_kind, to_body, distance)

        # A point of the surface, at any finite distance where there is none.
        to_point = jnp.where(is_kind & (to_body < MISS), to_body, 1.0)
        point = along(rays, to_point)
        body_normal = normal_law(row, point, view.radius, view.height)
        components = zip(body_normal, normal, strict=True)
        normal = Vector(*(jnp.where(is_kind, new, old) for new, old in components))
    return distance, normal


def along(rays: Rays, distance: Float[Array, "tiles rays"]) -> Vector:
    """Points [m] from the sensor at a distance [m] along each ray."""
    x, y, z = (distance * jnp.asarray(component, float) for component in rays.direction)
    if rays.offset is None:
        return Vector(x, y, z)
    offset_x, offset_y, offset_z = rays.offset
    return Vector(x + offset_x, y + offset_y, z + offset_z)
