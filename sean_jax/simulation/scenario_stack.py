"""A stack of scenarios that differ in numbers alone, such as different floors, for one program.

A batch has as many rows of each member of the stack, one member after the other or in turn. Tables of floors are not
copied for each row: the program maps over the members, and for each member over its rows.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Generic, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Int, PyTree

from sean_jax.core.data_types import Array, Scenario
from sean_jax.core.devices import to_device
from sean_jax.core.padding import common_sizes, join_tables, pad
from sean_jax.graph import graph_of

T = TypeVar("T")


@struct.dataclass
class Stack(Generic[T]):
    """K pytrees of one structure."""

    member: T  # the first
    own: dict[int, Array]  # index of a leaf -> its values (K, ...), of leaves in which members differ
    size: int = struct.field(pytree_node=False, default=1)  # K
    names: tuple[str, ...] = struct.field(pytree_node=False, default=())  # of the members
    turn: int = struct.field(pytree_node=False, default=0)  # rows of a member until the next one's turn; 0: all of them

    def at(self, index: Int[Array, ""] | int) -> T:
        """One member."""
        return select(self.member, self.own, index)

    def take(self, index: np.ndarray) -> "Stack[T]":
        """The stack of some members, in that order."""
        names = tuple(self.names[k] for k in index) if self.names else ()
        own = {leaf: values[jnp.asarray(index)] for leaf, values in self.own.items()}
        first = select(self.member, own, 0)
        return replace(self, member=first, own=own, size=len(index), names=names)

    def over_members(self, function: Callable[..., PyTree]) -> Callable[..., PyTree]:
        """``function(member, *values)`` of each member, with values (K, ...); results (K, ...)."""

        def call(own: dict[int, Array], *values: PyTree) -> PyTree:
            return function(_with_leaves(self.member, own), *values)

        return lambda *values: jax.vmap(call, axis_size=self.size)(self.own, *values)

    def vmap(self, function: Callable[..., PyTree]) -> Callable[..., PyTree]:
        """``function(member, *row)`` of rows (B, ...), of which each member has B / K."""
        if self.size == 1:
            return jax.vmap(functools.partial(function, self.member))

        def map_rows(member: T, *rows: PyTree) -> PyTree:
            return jax.vmap(functools.partial(function, member))(*rows)

        def call(*rows: PyTree) -> PyTree:
            results = self.over_members(map_rows)(*jax.tree.map(self._split, rows))
            return jax.tree.map(self._join, results)

        return call

    def _split(self, rows: Array) -> Array:
        """Rows (B, ...) by member: (K, B / K, ...)."""
        count, *shape = rows.shape
        rows_of_member = count // self.size
        turn = self.turn or rows_of_member
        turns = rows.reshape(count // turn // self.size, self.size, turn, *shape)
        by_member = turns.swapaxes(0, 1)
        return by_member.reshape(self.size, rows_of_member, *shape)

    def _join(self, rows: Array) -> Array:
        """The inverse of ``_split``."""
        _, count, *shape = rows.shape
        turn = self.turn or count
        by_member = rows.reshape(self.size, count // turn, turn, *shape)
        turns = by_member.swapaxes(0, 1)
        return turns.reshape(self.size * count, *shape)

    def paired(self, values: PyTree) -> "Stack[tuple[T, PyTree]]":
        """The stack of pairs of a member and its row of arrays (K, ...)."""
        count = len(jax.tree.leaves(self.member))
        own = self.own | dict(enumerate(jax.tree.leaves(values), start=count))
        first = jax.tree.map(lambda leaf: leaf[0], values)
        return replace(self, member=(self.member, first), own=own)  # pyright: ignore

    def map_member(self, function: Callable[[T], Any]) -> "Stack":
        """The stack whose members have other static fields, by ``function(member)``."""
        return replace(self, member=function(self.member))

    def with_fields(self, **fields: Any) -> "Stack":
        """The stack with other fields of the members: values for all, or a stack of K values."""
        # Leaves are marked by where they come from, to find the values of members after fields are replaced.
        first: dict[str, Any] = {}
        marks: dict[str, PyTree] = {}
        sources = _by_mark("", self.own)
        for name, value in fields.items():
            if isinstance(value, Stack):
                sources |= _by_mark(name, value.own)
                value = value.member
            first[name] = value
            marks[name] = _marked(name, value)
        leaves = jax.tree.leaves(replace(_marked("", self.member), **marks))  # pyright: ignore[reportArgumentType]
        own = {index: sources[mark] for index, mark in enumerate(leaves) if mark in sources}
        return replace(self, member=replace(self.member, **first), own=own)  # pyright: ignore


def _marked(field: str, tree: PyTree) -> PyTree:
    """The tree with a mark of field and index in place of each leaf."""
    structure = jax.tree.structure(tree)
    return jax.tree.unflatten(structure, [f"{field} {index}" for index in range(structure.num_leaves)])


def _by_mark(field: str, own: dict[int, Array]) -> dict[str, Array]:
    return {f"{field} {index}": values for index, values in own.items()}


def select(tree: T, varying: dict[int, Array], index: Int[Array, ""] | int) -> T:
    """The pytree with one of several values in some leaves: index of a leaf -> its values (K, ...)."""
    return _with_leaves(tree, {leaf: values[index] for leaf, values in varying.items()})


def _with_leaves(tree: T, values: dict[int, Array]) -> T:
    """The pytree with other leaves: index of a leaf -> its value."""
    leaves, structure = jax.tree.flatten(tree)
    for leaf, value in values.items():
        leaves[leaf] = value
    return jax.tree.unflatten(structure, leaves)


def of_arrays(values: PyTree) -> Stack:
    """The stack of the K rows of arrays (K, ...)."""
    leaves = jax.tree.leaves(values)
    first = jax.tree.map(lambda leaf: leaf[0], values)
    return Stack(first, dict(enumerate(leaves)), leaves[0].shape[0])


def as_stacks(scenarios: Scenario | Stack[Scenario] | Sequence[Scenario | Stack[Scenario]]) -> list[Stack[Scenario]]:
    """The stacks of scenarios that take turns; a scenario has one floor."""
    if isinstance(scenarios, Scenario | Stack):
        scenarios = [scenarios]
    return [part if isinstance(part, Stack) else Stack(part, {}) for part in scenarios]


def stack(members: Sequence[T], names: tuple[str, ...] = ()) -> Stack[T]:
    """The stack of pytrees of one structure, such as scenarios of floors after ``with_common_shapes``.

    Raises:
        ValueError: the structure or a shape differs.
    """
    first, tree = jax.tree.flatten(members[0])
    if any(jax.tree.structure(member) != tree for member in members):
        raise ValueError("stack: the static structure of members differs; run them separately.")
    own: dict[int, Array] = {}
    stacked: dict[tuple[int, ...], Any] = {}  # members have one array in several places, such as obstacles
    for index, leaves in enumerate(zip(*map(jax.tree.leaves, members), strict=True)):
        is_equal = all(leaf is leaves[0] or np.array_equal(leaf, leaves[0]) for leaf in leaves)
        if is_equal and not (isinstance(leaves[0], np.ndarray) and leaves[0].ndim):
            continue
        key = tuple(map(id, leaves[:1] if is_equal else leaves))
        if key not in stacked:
            stacked[key] = _on_device(leaves[0]) if is_equal else _stacked(leaves)
        (first if is_equal else own)[index] = stacked[key]
    return Stack(jax.tree.unflatten(tree, first), own, len(members), names)


def _stacked(leaves: Sequence[Any]) -> Any:
    """Arrays of the host stacked there and copied to the device; others on the device."""
    if isinstance(leaves[0], np.ndarray):
        return _on_device(np.stack(leaves))
    return jnp.stack(leaves)


def _on_device(array: Any) -> Any:
    return to_device(array) if isinstance(array, np.ndarray) else array


def with_common_shapes(scenarios: Sequence[Scenario], name: str) -> list[Scenario]:
    """The scenarios with arrays padded to common sizes, on the host, and ``name`` as the name of their environment.

    Each has as many people as the most crowded, and those are present that were there. Large tables are not padded:
    all have the same array with the tables of all.

    Raises:
        InputError: the tables are too large.
    """
    people = max(scenario.people for scenario in scenarios)
    equal = all(scenario.people == people for scenario in scenarios)

    # Robots have their own sizes.
    without_robots = (replace(scenario, robot=()) for scenario in scenarios)
    sizes = common_sizes(without_robots)
    sizes["Tables", "P"] = max(people, sizes.get(("Tables", "P"), 0))
    padded = []
    for scenario in scenarios:
        behavior = scenario.behavior
        graph = graph_of(scenario)
        if graph is not None:
            data = replace(behavior.data, graph=replace(graph, names=()))
            behavior = replace(behavior, data=data)
        present = scenario.people_present
        if not equal and present is None:
            present = np.asarray(scenario.people, np.int32)
        others = replace(
            scenario,
            robot=(),  # pyright: ignore[reportArgumentType]
            environment=replace(scenario.environment, name=name),
            behavior=replace(behavior, people=None if behavior.people is None else people),
            people=people,
            people_present=present,  # pyright: ignore[reportArgumentType]
        )
        others = pad(others, sizes)
        padded.append(replace(others, robot=scenario.robot))
    return join_tables(padded)
