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
        leaves, tree = jax.tree.flatten(self.member)
        for place, values in self.own.items():
            leaves[place] = values[index]
        return jax.tree.unflatten(tree, leaves)

    def take(self, index: np.ndarray) -> "Stack[T]":
        """The stack of some members, in that order."""
        names = tuple(self.names[k] for k in index) if self.names else ()
        own = {place: values[jnp.asarray(index)] for place, values in self.own.items()}
        return replace(self, member=replace(self, own=own).at(0), own=own, size=len(index), names=names)

    def over_members(self, function: Callable[..., PyTree]) -> Callable[..., PyTree]:
        """``function(member, *values)`` of each member, with values (K, ...); results (K, ...)."""
        leaves, tree = jax.tree.flatten(self.member)

        def one(own: dict[int, Array], *values: PyTree) -> PyTree:
            return function(
                jax.tree.unflatten(tree, [own.get(place, leaf) for place, leaf in enumerate(leaves)]), *values
            )

        return lambda *values: jax.vmap(one, axis_size=self.size)(self.own, *values)

    def vmap(self, function: Callable[..., PyTree]) -> Callable[..., PyTree]:
        """``function(member, *row)`` of rows (B, ...), of which each member has B / K."""
        if self.size == 1:
            return jax.vmap(functools.partial(function, self.member))

        def split(leaf: Array) -> Array:  # (B, ...) -> (K, B / K, ...)
            turn = self.turn or len(leaf) // self.size
            each = leaf.reshape(len(leaf) // turn // self.size, self.size, turn, *leaf.shape[1:])
            return each.swapaxes(0, 1).reshape(self.size, len(leaf) // self.size, *leaf.shape[1:])

        def join(leaf: Array) -> Array:
            turn = self.turn or leaf.shape[1]
            each = leaf.reshape(self.size, leaf.shape[1] // turn, turn, *leaf.shape[2:])
            return each.swapaxes(0, 1).reshape(len(leaf) * leaf.shape[1], *leaf.shape[2:])

        def of_member(member: T, *rows: PyTree) -> PyTree:
            return jax.vmap(functools.partial(function, member))(*rows)

        def call(*rows: PyTree) -> PyTree:
            return jax.tree.map(join, self.over_members(of_member)(*jax.tree.map(split, rows)))

        return call

    def paired(self, values: PyTree) -> "Stack[tuple[T, PyTree]]":
        """The stack of pairs of a member and its row of arrays (K, ...)."""
        leaves, count = jax.tree.leaves(values), len(jax.tree.leaves(self.member))
        own = self.own | {count + number: leaf for number, leaf in enumerate(leaves)}
        return replace(self, member=(self.member, jax.tree.map(lambda leaf: leaf[0], values)), own=own)  # pyright: ignore

    def map_member(self, function: Callable[[T], Any]) -> "Stack":
        """The stack whose members have other static fields, by ``function(member)``."""
        return replace(self, member=function(self.member))

    def with_fields(self, **fields: Any) -> "Stack":
        """The stack with other fields of the members: values for all, or a stack of K values."""
        marks = jax.tree.unflatten(jax.tree.structure(self.member), range(len(jax.tree.leaves(self.member))))
        first, sources = {}, {}
        for name, value in fields.items():
            first[name] = value.member if isinstance(value, Stack) else value
            marked = [f"{name} {number}" for number in range(len(jax.tree.leaves(first[name])))]
            sources |= {f"{name} {number}": own for number, own in getattr(value, "own", {}).items()}
            fields[name] = jax.tree.unflatten(jax.tree.structure(first[name]), marked)
        sources |= self.own
        places = jax.tree.leaves(replace(marks, **fields))  # pyright: ignore[reportArgumentType]
        own = {place: sources[mark] for place, mark in enumerate(places) if mark in sources}
        return replace(self, member=replace(self.member, **first), own=own)  # pyright: ignore


def of_arrays(values: PyTree) -> Stack:
    """The stack of the K rows of arrays (K, ...)."""
    leaves = jax.tree.leaves(values)
    first = jax.tree.map(lambda leaf: leaf[0], values)
    return Stack(first, dict(enumerate(leaves)), leaves[0].shape[0])


def as_stacks(scenarios: Scenario | Stack[Scenario] | Sequence[Scenario | Stack[Scenario]]) -> list[Stack[Scenario]]:
    """The stacks of scenarios that take turns; a scenario has one floor."""
    each = [scenarios] if isinstance(scenarios, Scenario | Stack) else scenarios
    return [part if isinstance(part, Stack) else Stack(part, {}) for part in each]


def stack(members: Sequence[T], names: tuple[str, ...] = ()) -> Stack[T]:
    """The stack of pytrees of one structure, such as scenarios of floors after ``with_common_shapes``.

    Raises:
        ValueError: the structure or a shape differs.
    """
    first, *others = (jax.tree.flatten(member) for member in members)
    if any(tree != first[1] for _, tree in others):
        raise ValueError("stack: the static structure of members differs; run them separately.")
    own: dict[int, Array] = {}
    moved: dict[tuple[int, ...], Any] = {}  # members have one array in several places, such as obstacles
    for place, leaves in enumerate(zip(first[0], *(each for each, _ in others), strict=True)):
        equal = all(leaf is leaves[0] or np.array_equal(leaf, leaves[0]) for leaf in leaves)
        on_host = isinstance(leaves[0], np.ndarray)
        if equal and not (on_host and leaves[0].ndim):
            continue
        key = tuple(map(id, leaves[:1] if equal else leaves))
        if key not in moved:
            array: Any = leaves[0] if equal else np.stack(leaves) if on_host else jnp.stack(leaves)
            moved[key] = to_device(array) if on_host else array
        (first[0] if equal else own)[place] = moved[key]
    return Stack(jax.tree.unflatten(first[1], first[0]), own, len(members), names)


def with_common_shapes(scenarios: Sequence[Scenario], name: str) -> list[Scenario]:
    """The scenarios with arrays padded to common sizes, on the host, and ``name`` as the name of their environment.

    Each has as many people as the most crowded, and those are present that were there. Large tables are not padded:
    all have the same array with the tables of all.

    Raises:
        InputError: the tables are too large.
    """
    people = max(scenario.people for scenario in scenarios)
    equal = all(scenario.people == people for scenario in scenarios)
    sizes = common_sizes(replace(scenario, robot=()) for scenario in scenarios)  # robots have their own sizes
    sizes["Tables", "P"] = max(people, sizes.get(("Tables", "P"), 0))
    padded = []
    for scenario in scenarios:
        behavior, graph = scenario.behavior, graph_of(scenario)
        if graph is not None:
            behavior = replace(behavior, data=replace(behavior.data, graph=replace(graph, names=())))
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
        padded.append(replace(pad(others, sizes), robot=scenario.robot))
    return join_tables(padded)
