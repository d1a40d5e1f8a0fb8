"""Many robots at once: hours without a break as chains of episodes (Table I), or numbered episodes (Figure 4).

The streams of the protocol (section V-B) differ in what a reset draws, and in nothing that a step reads. So their
episodes begin apart and then go on in one batch.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding, PartitionSpec

from sean_jax import chance, devices, parallel, restarts
from sean_jax.base import Array, Policy, RobotTask, Scenario, State
from sean_jax.learning.protocol import Stream
from sean_jax.scenario import reset, results

MINUTE = 60  # s, of a block of the bootstrap
LEAD = 1  # minutes that a chain has gone on for before it counts, since all begin with the start of an episode
CHUNK = 10  # s, between two looks at whether all episodes have ended


@dataclasses.dataclass
class Episodes:
    """E numbered episodes, each until its end."""

    completed: np.ndarray  # (E,) bool
    seconds: np.ndarray  # (E,)
    metrics: dict[str, np.ndarray]  # (E,) or (E, 1 + S)


class Chains:
    """Episodes that follow one another, a minute of all chains in one call."""

    def __init__(self, tasks: Sequence[Callable], policy: Policy):
        self.over, self.policy = devices.mesh(), parallel.as_argument(policy)
        self.pool = jax.jit(functools.partial(_pool, tuple(tasks)), static_argnums=4)
        self.stack = jax.jit(_stacked)
        self.begin = devices.spread(self.over, _begin)
        self.run = devices.spread(self.over, _minute, donate=True)

    def minutes(
        self,
        streams: Sequence[Stream],
        seed: int,
        chains: int,
        minutes: int,
        starts: int,
        watch: Callable[[float], None],
    ) -> tuple[np.ndarray, np.ndarray]:
        """What ``chains`` of each of C streams see in so many minutes, after LEAD: (C chains, minutes, 60, S) bool.

        These are the situations once a second; the other array, (2,), is how many episodes were completed, and not.
        Chains restart from ``starts`` of their stream. ``watch(share)`` is told how far they are. Raises
        FloatingPointError if somebody is nowhere.
        """
        number, scenario = chains * len(streams), streams[0].scenario
        size = -(-number // self.over.size) * self.over.size
        key, pool_key = (chance.key(use, seed) for use in ("table1", "table1 starts"))
        pools = [
            self.pool(each.scenario, self.policy, jnp.int32(each.turn), jax.random.fold_in(pool_key, index), starts)
            for index, each in enumerate(streams)
        ]
        fixed = devices.everywhere(self.over, (scenario, self.policy, self.stack(pools)))
        stream = np.minimum(np.arange(size) // chains, len(streams) - 1)
        carry = self.begin(fixed, devices.keys(self.over, key, size), jnp.asarray(stream, jnp.int32))
        kept, ended = [], np.zeros(2, int)
        for minute in range(LEAD + minutes):
            carry, flags, over, sound = self.run(fixed, carry)
            if not bool(np.asarray(sound).all()):
                raise FloatingPointError("a robot's or a person's place is not finite; nothing more is written.")
            if minute >= LEAD:
                kept.append(np.asarray(flags)[:number])
                ended += np.asarray(over)[:number].sum(0)
            watch((minute + 1) / (LEAD + minutes))
        return np.stack(kept, 1), ended


def _pool(tasks: tuple, scenario: Scenario, policy: Policy, turn: Array, key: Array, size: int) -> State:
    return restarts.pool(_with_turn(scenario, tasks, turn), key, size, policy).starts


def _stacked(pools: list[State]) -> State:
    """(C, K, ...) the starts of each stream."""
    return jax.tree.map(lambda *each: jnp.stack(each), *pools)


def _begin(fixed: tuple, key: Array, stream: Array) -> tuple[Array, State]:
    return stream, _start(fixed[2], stream, key)


def _start(starts: State, stream: Array, key: Array) -> State:
    """A start of the stream's pool, with chance of its own."""
    choice_key, streams_key = jax.random.split(key)
    chosen = jax.random.randint(choice_key, (), 0, starts.tick.shape[1], jnp.int32)
    fresh = jax.tree.map(lambda leaf: leaf[stream, chosen], starts)
    return dataclasses.replace(fresh, streams=chance.streams(streams_key))


def _minute(fixed: tuple, carry: tuple[Array, State]) -> tuple:
    """As ``restarts.endless`` with the pool of the stream."""
    scenario, policy, starts = fixed
    stream, state = carry
    ticks = round(1.0 / scenario.time_step)

    def tick(before: State, _) -> tuple[State, Array]:
        after, _ = parallel.advance(scenario, policy, before)
        key = jax.random.fold_in(after.streams.restart, after.tick)
        fresh, over = _start(starts, stream, key), after.completed | after.timed_out
        ended = jnp.stack([after.completed, after.timed_out])
        return jax.tree.map(lambda old, new: jnp.where(over, new, old), after, fresh), ended

    def second(state: State, _) -> tuple:
        state, ended = jax.lax.scan(tick, state, length=ticks)
        return state, (state.situations, ended.sum(0, dtype=jnp.int32))

    state, (flags, ended) = jax.lax.scan(second, state, length=MINUTE)
    sound = jnp.isfinite(state.robot.position).all() & jnp.isfinite(state.pedestrians.position).all()
    return (stream, state), flags, ended.sum(0, dtype=jnp.int32), sound


def _with_turn(scenario: Scenario, tasks: tuple, turn: Array) -> Scenario:
    """The scenario whose task is that of the index."""

    def task(scenario: Scenario, *others: Any) -> RobotTask:
        return jax.lax.switch(turn, [functools.partial(each, scenario) for each in tasks], *others)

    return dataclasses.replace(scenario, task=task)


class Numbered:
    """Programs for numbered episodes; drivers that differ in their data alone share what is compiled."""

    def __init__(self, tasks: Sequence[Callable]):
        self.over = devices.mesh()
        split = NamedSharding(self.over, PartitionSpec(devices.AXIS))
        self.draw = jax.jit(jax.vmap(functools.partial(_draw, tuple(tasks)), (None, 0)))
        self.take_turns = jax.jit(_taken_in_turns, static_argnums=1, out_shardings=split)
        self.advance = devices.spread(self.over, _advance, donate=True)
        self.results = jax.jit(jax.vmap(results, (None, 0)))

    def episodes(
        self,
        policy: Policy,
        streams: Sequence[Stream],
        seed: int,
        number: int,
        most: int,
        watch: Callable[[float], None],
    ) -> Episodes:
        """The first ``number`` episodes, each until its end; of C streams in turns, about ``most`` at once.

        Episode ``i`` is drawn from ``fold_in(chance.key("figure4", seed), i)`` and of stream ``i % C``.
        ``watch(share)`` is told how far they are.
        """
        rows = math.ceil(number / len(streams))  # a row has one episode of each stream
        batches = math.ceil(rows * len(streams) / most)
        at_once = math.ceil(rows / batches)
        scenario = streams[0].scenario
        policy = parallel.as_argument(policy)
        found = []
        for batch in range(batches):
            first = np.arange(batch * at_once, (batch + 1) * at_once) * len(streams)
            states = [
                self.draw(
                    (each.scenario, policy, jnp.uint32(seed), jnp.int32(each.turn)),
                    jnp.asarray(first + index, jnp.uint32),
                )
                for index, each in enumerate(streams)
            ]
            tell = functools.partial(_tell, watch, batch, batches)
            found.append(self._until_the_end(policy, scenario, states, tell))
        completed, seconds, metrics = jax.tree.map(lambda *each: np.concatenate(each)[:number], *found)
        return Episodes(completed, seconds, metrics)

    def _until_the_end(self, policy: Policy, scenario: Scenario, drawn: list[State], tell: Callable):
        number = len(drawn) * drawn[0].tick.shape[0]
        size = -(-number // self.over.size) * self.over.size
        fixed = devices.everywhere(self.over, (scenario, policy))
        states, lived = self.take_turns(drawn, size)
        chunks = math.ceil(scenario.time_limit / CHUNK)
        for chunk in range(chunks):
            states, lived = self.advance(fixed, states, lived)
            tell((chunk + 1) / chunks)
            if bool(np.asarray(states.completed | states.timed_out).all()):
                break
        ends = states.completed, lived, self.results(scenario, states)
        completed, lived, measured = jax.tree.map(lambda values: np.asarray(values)[:number], ends)
        return completed, lived * scenario.time_step, measured


def _tell(watch: Callable[[float], None], batch: int, batches: int, share: float) -> None:
    watch((batch + share) / batches)


def _draw(tasks: tuple, fixed: tuple, number: Array) -> State:
    scenario, policy, seed, turn = fixed
    key = jax.random.fold_in(chance.key("figure4", seed), number)
    return parallel.begin(scenario, policy, reset(_with_turn(scenario, tasks, turn), key))


def _taken_in_turns(drawn: list[State], size: int) -> tuple[State, Array]:
    """(size, ...) of lists (rows, ...): the first of each, then the second of each, ...; and steps lived, zeros."""

    def taken(*leaves: Array) -> Array:
        whole = jnp.stack(leaves, 1).reshape(len(leaves) * leaves[0].shape[0], *leaves[0].shape[1:])
        return whole[np.arange(size) % whole.shape[0]]

    return jax.tree.map(taken, *drawn), jnp.zeros(size, jnp.int32)


def _advance(fixed: tuple, state: State, lived: Array) -> tuple[State, Array]:
    """CHUNK seconds more, and how many steps the episode has lived."""
    scenario, policy = fixed

    def one(carry: tuple, _) -> tuple:
        before, lived = carry
        after, _ = parallel.advance(scenario, policy, before)
        return (after, lived + (~(before.completed | before.timed_out)).astype(jnp.int32)), None

    return jax.lax.scan(one, (state, lived), length=CHUNK * round(1.0 / scenario.time_step))[0]
