"""The first body that each ray meets, on a GPU: one kernel, written in Pallas (Mosaic GPU).

Each program of the kernel has up to ``WIDTH`` rays of one tile, one a thread, goes through the bodies that the tile has
in sight, and writes its result once. So the loops end on the GPU. A loop of XLA's whose end depends on data ends on the
host, which reads a flag after every turn: a busy host then holds up the card.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from sean_jax.core.data_types import Array
from sean_jax.core.gpu_kernels import WIDTH, batch, launch, row
from sean_jax.sensors.raycast.vectors import Vector
from sean_jax.sensors.raycast.view import MISS, Beams, Rays, ground

BITS = 32  # bodies in a word; a bit is set if the tile has the body in sight


class BodyFamily(NamedTuple):
    """Bodies of one kind."""

    start: int  # number of the first
    table: Array  # (K, F), one row for each body
    law: Callable  # of ``raycast.shapes``: distances along the beams to the bodies of these rows
    in_sight: Bool[Array, "tiles K"]
    scenery: bool = True  # whether they are no people


class StaticFamily(NamedTuple):
    """What is fixed of a ``BodyFamily``."""

    start: int  # number of the first body
    columns: int  # of the table
    law: Callable
    scenery: bool


class KernelShape(NamedTuple):
    """Static parameters of a kernel."""

    rays: Rays
    families: tuple[StaticFamily, ...]
    floor: int  # number of the floor
    results: int  # of a ray: its distance; the number of the body; distance and number of the first of the scenery
    programs: int  # of a tile, up to ``WIDTH`` rays each

    @property
    def ray_columns(self) -> int:
        """Numbers of a ray: direction, inverse rise and run, and the start if there is one."""
        if self.rays.offset is None:
            return 5
        return 8


def first(
    rays: Rays, families: Sequence[BodyFamily], radius: Array, height: Array, floor: int, results: int
) -> tuple[Array, ...]:
    """The distance [m] along each ray to the first body, ``MISS`` without one; its number; and both of the scenery.

    Args:
        families: the bodies, none of them empty.
        radius: m, of a person's body.
        height: m, of the sensor above the floor.
        floor: the number of the floor; the sky has the next.
        results: how many of these: 1, 2 or 4.
    """
    tiles, count = rays.direction.shape[1:]
    programs = -(-count // WIDTH)
    static = tuple(StaticFamily(family.start, family.table.shape[1], family.law, family.scenery) for family in families)
    shape = KernelShape(rays, static, floor, results, programs)

    # The kernel's operands: rays, numbers of the view, then two of each family.
    operands = [_ray_table(shape), jnp.stack([radius, height])[None]]
    for family in families:
        words = _words(family.in_sight)
        operands.append(family.table.reshape(1, -1))
        operands.append(words.reshape(1, -1))

    call = batch(partial(_call, shape), results)
    outputs = call(*operands)
    return tuple(output.reshape(tiles, programs * WIDTH)[:, :count] for output in outputs)


def _ray_table(shape: KernelShape) -> Array:
    """(1, tiles * programs * columns * WIDTH) of the rays; the last is repeated up to the width."""
    rays = shape.rays
    offset = () if rays.offset is None else rays.offset
    columns = np.stack([*rays.direction, rays.inverse_rise, rays.inverse_run, *offset], 1)  # (tiles, columns, rays)
    tiles, width, count = columns.shape
    padding = (0, shape.programs * WIDTH - count)
    padded = np.pad(columns, ((0, 0), (0, 0), padding), mode="edge")
    by_column = padded.reshape(tiles, width, shape.programs, WIDTH)
    by_program = by_column.swapaxes(1, 2)
    return jnp.asarray(by_program.reshape(1, -1), float)


def _words(in_sight: Array) -> Array:
    """(tiles, words) int32, a bit for each body (tiles, K) in sight."""
    tiles, count = in_sight.shape
    padded = jnp.pad(in_sight, ((0, 0), (0, -count % BITS)))
    padded = padded.reshape(tiles, -1, BITS)
    unsigned = np.uint32(1) << np.arange(BITS, dtype=np.uint32)
    bit = jax.lax.bitcast_convert_type(unsigned, jnp.int32)
    bits = jnp.where(padded, bit[None, None, :], 0)
    return bits.sum(-1, dtype=jnp.int32)


def _call(shape: KernelShape, *operands: Array, interpret: bool = False) -> tuple[Array, ...]:
    """The kernel, for operands of ``gpu_kernels.Call``."""
    scenarios = max(operand.shape[0] for operand in operands)
    programs = shape.rays.tiles * shape.programs
    dtypes = ((operands[0].dtype, jnp.int32) * 2)[: shape.results]
    out = tuple(jax.ShapeDtypeStruct((scenarios, programs * WIDTH), dtype) for dtype in dtypes)
    kernel = partial(_kernel, shape)
    return launch(kernel, "raycast", (scenarios, programs), out, *operands, interpret=interpret)


def _kernel(shape: KernelShape, index: Callable[[int], Any], *references: Any) -> None:
    """One program: up to ``WIDTH`` rays of one tile of one scenario."""
    from jax.experimental import pallas

    scenario = index(0)
    program = index(1)
    scenarios = references[-1].shape[0]
    inputs = 2 + 2 * len(shape.families)
    ray_table, view, *bodies = [operand.at[row(operand, scenario, scenarios)] for operand in references[:inputs]]
    outputs = references[inputs:]

    radius = view[0]
    height = view[1]
    beams = _beams_of_program(shape, ray_table, program)
    distance = ground(height, beams.direction.z, beams.inverse_rise)
    number = shape.floor + (distance >= MISS).astype(jnp.int32)
    hit = scenery_hit = (distance, number)[: shape.results]
    for family, table, words in zip(shape.families, bodies[::2], bodies[1::2], strict=True):
        tile_words = words.shape[0] // shape.rays.tiles
        first_word = program // shape.programs * tile_words
        test = partial(_test_body, family, table, beams, radius, height)
        test_word = partial(_test_word, test, words, first_word)
        hit = jax.lax.fori_loop(0, tile_words, test_word, hit)
        if family.scenery:
            scenery_hit = hit

    results = (*hit, *scenery_hit)[: shape.results]
    for output, values in zip(outputs, results, strict=True):
        output.at[scenario][pallas.ds(program * WIDTH, WIDTH)] = values


def _beams_of_program(shape: KernelShape, ray_table: Any, program: Any) -> Beams:
    """The rays of a program, one a thread."""
    from jax.experimental import pallas

    first = program * shape.ray_columns
    columns = [ray_table[pallas.ds((first + column) * WIDTH, WIDTH)] for column in range(shape.ray_columns)]
    x, y, z, inverse_rise, inverse_run, *offset = columns
    return Beams(Vector(x, y, z), inverse_rise, inverse_run, Vector(*offset) if offset else None)


def _test_word(test: Callable, words: Any, first_word: Any, word: Any, hit: tuple) -> tuple:
    """The first hit after the bodies of a word, which has a bit for each body in sight."""
    bits = words[first_word + word]
    test_body = partial(test, word)
    _, *hit_after = jax.lax.while_loop(lambda carry: carry[0] != 0, test_body, (bits, *hit))
    return tuple(hit_after)


def _test_body(
    family: StaticFamily, table: Any, beams: Beams, radius: Array, height: Array, word: Any, carry: tuple
) -> tuple:
    """The bits without the lowest one, and the first hit after that body."""
    bits, *hit = carry
    body = word * BITS + (BITS - 1) - jax.lax.clz(bits & -bits)
    body_row = tuple(table[body * family.columns + column] for column in range(family.columns))
    distance = family.law(body_row, beams, radius, height)
    other_bits = bits & (bits - 1)
    return other_bits, *_nearer(tuple(hit), distance, family.start + body)


def _nearer(hit: tuple[Array, ...], distance: Array, number: Any) -> tuple[Array, ...]:
    nearest, *numbers = hit
    new = jnp.minimum(nearest, distance)
    if not numbers:
        return (new,)
    return new, jnp.where(distance >= nearest, numbers[0], number)
