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
from sean_jax.sensors.raycast.view import MISS, Beams, Rays, ground

BITS = 32  # bodies in a word; a bit is set if the tile has the body in sight


class Family(NamedTuple):
    """Bodies of one kind."""

    start: int  # number of the first
    table: Array  # (K, F), one row for each body
    law: Callable  # (row, beams, (radius, height) of the view) -> distances
    in_sight: Bool[Array, "tiles K"]
    scenery: bool = True  # whether they are no people


class _Shape(NamedTuple):
    """Static parameters of a kernel."""

    rays: Rays
    laws: tuple[tuple[int, int, Callable, bool], ...]  # first number, columns of the table, law, scenery of each family
    floor: int  # number of the floor
    results: int  # of a ray: its distance; the number of the body; distance and number of the first of the scenery
    parts: int  # programs of a tile


def first(
    rays: Rays, families: Sequence[Family], radius: Array, height: Array, floor: int, results: int
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
    parts = -(-count // WIDTH)
    fixed = tuple((family.start, family.table.shape[1], family.law, family.scenery) for family in families)
    shape = _Shape(rays, fixed, floor, results, parts)
    operands = [_beams(shape), jnp.stack([radius, height])[None]]
    for family in families:
        operands += [family.table.reshape(1, -1), _words(family.in_sight).reshape(1, -1)]
    return tuple(
        out.reshape(tiles, parts * WIDTH)[:, :count] for out in batch(partial(_call, shape), results)(*operands)
    )


def _beams(shape: _Shape) -> Array:
    """(1, tiles * parts * columns * WIDTH) of the rays; the last is repeated up to the width."""
    rays = shape.rays
    columns = [*rays.direction, rays.inverse_rise, rays.inverse_run, *(() if rays.offset is None else rays.offset)]
    tiles, count = columns[0].shape
    more = np.pad(np.stack(columns, 1), ((0, 0), (0, 0), (0, shape.parts * WIDTH - count)), mode="edge")
    apart = more.reshape(tiles, len(columns), shape.parts, WIDTH).swapaxes(1, 2)
    return jnp.asarray(apart.reshape(1, -1), float)


def _words(in_sight: Array) -> Array:
    """(tiles, words) int32, a bit for each body (tiles, K) in sight."""
    tiles, count = in_sight.shape
    padded = jnp.pad(in_sight, ((0, 0), (0, -count % BITS))).reshape(tiles, -1, BITS)
    bit = jax.lax.bitcast_convert_type(np.uint32(1) << np.arange(BITS, dtype=np.uint32), jnp.int32)
    return jnp.where(padded, bit[None, None, :], 0).sum(-1, dtype=jnp.int32)


def _call(shape: _Shape, *operands: Array, interpret: bool = False) -> tuple[Array, ...]:
    """The kernel, for operands of ``kernels.Call``."""
    grid = max(operand.shape[0] for operand in operands), shape.rays.tiles * shape.parts
    kinds = ((operands[0].dtype, jnp.int32) * 2)[: shape.results]
    out = tuple(jax.ShapeDtypeStruct((grid[0], grid[1] * WIDTH), kind) for kind in kinds)
    return launch(partial(_kernel, shape), "raycast", grid, out, *operands, interpret=interpret)


def _kernel(shape: _Shape, index: Callable[[int], Any], *references: Any) -> None:
    """One program: up to ``WIDTH`` rays of one tile of one scenario."""
    from jax.experimental import pallas

    scenario, program = index(0), index(1)
    scenarios = references[-1].shape[0]
    inputs = [each.at[row(each, scenario, scenarios)] for each in references[: 2 + 2 * len(shape.laws)]]
    beams_of, numbers_of, *bodies = inputs
    radius, height = numbers_of[0], numbers_of[1]
    columns = 5 if shape.rays.offset is None else 8
    parts = [beams_of[pallas.ds((program * columns + column) * WIDTH, WIDTH)] for column in range(columns)]
    beams = Beams(tuple(parts[:3]), parts[3], parts[4], tuple(parts[5:]) or None)
    distance = ground(height, beams.direction[2], beams.inverse_rise)
    number = shape.floor + (distance >= MISS).astype(jnp.int32)
    first = of_scenery = (distance, number)[: shape.results]
    for (start, columns, law, scenery), table, words_of in zip(shape.laws, bodies[::2], bodies[1::2], strict=True):
        words = words_of.shape[0] // shape.rays.tiles

        def test(carry: tuple, word: Any, start=start, columns=columns, law=law, table=table) -> tuple:
            bits, *first = carry
            body = word * BITS + (BITS - 1) - jax.lax.clz(bits & -bits)  # the body of the lowest bit
            numbers = tuple(table[body * columns + column] for column in range(columns))
            return bits & (bits - 1), *_nearer(tuple(first), law(numbers, beams, radius, height), start + body)

        def of_word(word: Any, first: tuple, words_of=words_of, words=words, test=test) -> tuple:
            bits = words_of[program // shape.parts * words + word]
            return jax.lax.while_loop(lambda carry: carry[0] != 0, partial(test, word=word), (bits, *first))[1:]

        first = jax.lax.fori_loop(0, words, of_word, first)
        of_scenery = first if scenery else of_scenery
    results = (*first, *of_scenery)[: shape.results]
    for result, values in zip(references[2 + 2 * len(shape.laws) :], results, strict=True):
        result.at[scenario][pallas.ds(program * WIDTH, WIDTH)] = values


def _nearer(first: tuple[Array, ...], distance: Array, number: Any) -> tuple[Array, ...]:
    if len(first) == 1:
        return (jnp.minimum(first[0], distance),)
    return jnp.minimum(first[0], distance), jnp.where(distance >= first[0], first[1], number)
