"""Arrays of different sizes padded to common ones, so that scenarios of different floors have equal shapes.

Large tables are not padded: one array has the tables of all floors, one after the other (``FlatTable``).

The letters of the annotations say which axes are alike. Padding has no effect: obstacles lie far away, arcs of shortest
paths have no place that a path could touch, nodes have no edges. The numbers of what is there stay the same. What
fills an array stands at its field, as ``struct.field(metadata={"pad": -1})``; without it 0 does.
"""

import dataclasses
import typing
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Int, Shaped

from sean_jax.core.data_types import Array
from sean_jax.core.devices import to_device
from sean_jax.core.errors import InputError

MULTIPLES = {"V": 64, "W": 32}  # of arcs and of obstacles in programs for the host
MAX_NUMBERS = 2**31 - 1  # of the tables of all floors, counted in int32
EDGE = "X", "Y"  # axes of grids: places off the floor have the last cell on it

Sizes = dict[tuple[str, str], int]
"""(class, letter of an axis) -> its size."""


@struct.dataclass
class FlatTable:
    """A table of one floor, in an array that has such tables of many floors: looked up by indices of all its axes."""

    values: Shaped[Array, "_"]  # of all floors
    start: Int[Array, ""]  # where the table of this floor begins
    shape: Int[Array, "_"]  # of the table

    def __getitem__(self, index: tuple[Array, ...]) -> Shaped[Array, "..."]:
        return jnp.asarray(self.values).at[self._place(index)].get(mode="promise_in_bounds")

    def row(self, index: tuple[Array, ...], size: int) -> Shaped[Array, "{size}"]:
        """So many numbers along the last axis; those after the end of the row may be any."""
        begin = self._place((*index, jnp.zeros((), jnp.int32)))
        return jax.lax.dynamic_slice(self.values, (begin,), (size,))

    def on_host(self) -> np.ndarray:
        """The table as an array of numpy."""
        shape = np.asarray(self.shape)
        start = int(self.start)
        end = start + int(np.prod(shape))
        return np.asarray(self.values)[start:end].reshape(shape)

    def _place(self, index: tuple[Array, ...]) -> Array:
        """Where the number at an index is in ``values``."""
        offset, *others = (jnp.asarray(axis_index, jnp.int32) for axis_index in index)
        for axis, axis_index in enumerate(others, 1):
            offset = offset * self.shape[axis] + axis_index
        return self.start + offset


def flat_table(array: np.ndarray) -> FlatTable:
    """The flat table of an array, on the default device."""
    start = np.zeros((), np.int32)
    shape = np.asarray(array.shape, np.int32)
    return FlatTable(*to_device((np.ravel(array), start, shape)))


def join_tables(trees: Sequence[Any]) -> list[Any]:
    """Trees of one structure in which the ``FlatTable`` of each position get one array of values, on the host.

    Raises:
        InputError: the tables of a position have too many numbers for an index.
    """
    flattened = [jax.tree.flatten(tree, is_leaf=_is_table) for tree in trees]
    memo: dict[tuple[int, ...], np.ndarray] = {}  # ids of the tables' values -> joined values
    for index, tables in enumerate(zip(*(leaves for leaves, _ in flattened), strict=True)):
        if not _is_table(tables[0]):
            continue
        key = tuple(id(table.values) for table in tables)
        sizes = [int(np.prod(table.shape)) for table in tables]
        if key not in memo:
            memo[key] = _joined_values(tables, sizes)
        starts = np.cumsum([0, *sizes[:-1]]).astype(np.int32)
        for (leaves, _), table, start in zip(flattened, tables, starts, strict=True):
            leaves[index] = dataclasses.replace(table, values=memo[key], start=start, shape=np.asarray(table.shape))
    return [jax.tree.unflatten(structure, leaves) for leaves, structure in flattened]


def _joined_values(tables: Sequence[FlatTable], sizes: Sequence[int]) -> np.ndarray:
    """The values of tables, one after the other, and room behind the last row.

    Raises:
        InputError: there are too many.
    """
    longest = max(int(table.shape[-1]) for table in tables)  # rows of all floors are read in this length
    if sum(sizes) + longest > MAX_NUMBERS:
        raise InputError(
            f"environment: tables of {len(tables)} floors have {sum(sizes):,} numbers, and {MAX_NUMBERS:,} are the "
            "most; take fewer or smaller floors."
        )
    values = [np.asarray(table.values) for table in tables]
    return np.concatenate([*values, np.zeros(longest, values[0].dtype)])


def _is_table(value: Any) -> bool:
    return isinstance(value, FlatTable)


def common_sizes(trees: Iterable[Any]) -> Sizes:
    """The greatest size of each axis among trees of dataclasses."""
    sizes: Sizes = {}
    for tree in trees:
        for name, value, axes in _arrays(tree):
            for axis, size in zip(axes, np.shape(value), strict=True):
                sizes[name, axis] = max(size, sizes.get((name, axis), 0))
    return sizes


def pad(tree: Any, sizes: Sizes) -> Any:
    """A tree of dataclasses whose arrays have these sizes, as arrays on the host. Other arrays stay as they are.

    An array that is in several places stays one array.
    """
    return _pad(tree, sizes, {})


def _pad(tree: Any, sizes: Sizes, memo: dict[tuple, np.ndarray]) -> Any:
    if isinstance(tree, tuple | list):
        values = [_pad(value, sizes, memo) for value in tree]
        if hasattr(tree, "_fields"):
            return type(tree)(*values)
        return type(tree)(values)
    if isinstance(tree, dict):
        return {key: _pad(value, sizes, memo) for key, value in tree.items()}
    if not dataclasses.is_dataclass(tree) or isinstance(tree, type | FlatTable):
        return tree

    name = type(tree).__name__
    changed: dict[str, Any] = {}
    for field, value, axes in _fields(tree):
        if axes is None:
            changed[field.name] = _pad(value, sizes, memo)
            continue
        shape: tuple[int, ...] = value.shape
        target = tuple(sizes.get((name, axis), size) for axis, size in zip(axes, shape, strict=True))
        if any((name, axis) in sizes for axis in axes):
            key = id(value), target  # an array that is in several places stays one
            if key not in memo:
                memo[key] = _padded(np.asarray(value), target, axes, field.metadata.get("pad", 0))
            changed[field.name] = memo[key]
    if name == "Solids" and ("Solids", "solids") in sizes:
        changed["color"] = _colors(tree, sizes)
    return dataclasses.replace(tree, **changed)


def in_programs(tables: Any) -> Any:
    """Tables with obstacles and arcs padded to a multiple, so that programs for the host serve many floors."""
    sizes = {}
    for (name, axis), size in common_sizes([tables]).items():
        if axis in MULTIPLES:
            sizes[name, axis] = _next_multiple(size, MULTIPLES[axis])
    padded = jax.tree.map(_with_room, pad(tables, sizes), is_leaf=_is_table)
    return jax.tree.map(lambda leaf: leaf.astype(float) if leaf.dtype.kind == "f" else leaf, padded)


def _next_multiple(size: Any, multiple: int) -> Any:
    return -(-size // multiple) * multiple


def _with_room(table: Any) -> Any:
    """A flat table of arcs with room for a multiple of arcs along each axis; anything else as it is."""
    if not _is_table(table):
        return table
    values = np.asarray(table.values)
    size = np.prod(_next_multiple(np.asarray(table.shape), MULTIPLES["V"]))
    return dataclasses.replace(table, values=np.pad(values, (0, int(size - len(values)))))


def _padded(array: np.ndarray, target: tuple[int, ...], axes: tuple[str, ...], fill: Any) -> np.ndarray:
    """An array of the target's shape with the array in its corner, and the fill elsewhere."""
    repeats = []
    for size, old, axis in zip(target, array.shape, axes, strict=True):
        repeats.append((0, size - old) if axis in EDGE else (0, 0))
    array = np.pad(array, repeats, mode="edge")
    result = np.empty(target, array.dtype)
    result[...] = fill
    result[tuple(slice(size) for size in array.shape)] = array
    return result


def _colors(solids: Any, sizes: Sizes) -> np.ndarray:
    """The colors of padded bodies: of boxes, then cylinders, then spheres."""
    colors = np.asarray(solids.color)  # (S, 3)
    padded = []
    start = 0
    for kind in ("boxes", "cylinders", "spheres"):
        end = start + len(getattr(solids, kind))
        missing = sizes.get(("Solids", kind), end - start) - (end - start)
        padded.append(np.pad(colors[start:end], [(0, missing), (0, 0)]))
        start = end
    return np.concatenate(padded)


def _arrays(tree: Any) -> Iterator[tuple[str, Any, tuple[str, ...]]]:
    """Class, array and letters of its axes, of all arrays in a tree of dataclasses."""
    if isinstance(tree, tuple | list | dict):
        for value in tree.values() if isinstance(tree, dict) else tree:
            yield from _arrays(value)
    elif dataclasses.is_dataclass(tree) and not isinstance(tree, type | FlatTable):
        for _, value, axes in _fields(tree):
            if axes is None:
                yield from _arrays(value)
            else:
                yield type(tree).__name__, value, axes


def _fields(tree: Any) -> Iterator[tuple[dataclasses.Field, Any, tuple[str, ...] | None]]:
    """Each field that is a node of the pytree, its value and letters of its axes; None for those of a tree.

    Axes before the annotated ones have the letters batch0, batch1 and so on.
    """
    for field in dataclasses.fields(tree):
        value = getattr(tree, field.name)
        if value is None or not field.metadata.get("pytree_node", True):
            continue
        kinds = [field.type, *typing.get_args(field.type)]
        letters = next((kind.dim_str.split() for kind in kinds if hasattr(kind, "dim_str")), None)
        if letters is None or not hasattr(value, "shape"):
            yield field, value, None
            continue
        batch_axes = [f"batch{i}" for i in range(value.ndim - len(letters))]
        yield field, value, (*batch_axes, *letters)
