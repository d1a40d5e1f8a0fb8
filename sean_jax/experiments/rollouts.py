"""Many robots at once: an hour without a break as chains of episodes (Table I), or numbered episodes (Figure 4)."""

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import devices, parallel, restarts
from sean_jax.base import Array, Policy, RobotTask, Scenario, State
from sean_jax.scenario import reset, results

MINUTE = 60  # s, of a block of the bootstrap
CHUNK = 10  # s, between two looks at whether all episodes have ended
STARTS = 64  # in the pool that the chains of a stream restart from


@dataclasses.dataclass
class Episodes:
    """E numbered episodes, each until its end."""

    completed: np.ndarray  # (E,) bool
    seconds: np.ndarray  # (E,)
    metrics: dict[str, np.ndarray]  # (E,) or (E, 1 + S)


class Chains:
    """Episodes that follow one another, a minute of all chains in one call; compiled once for each number of chains."""

    def __init__(self, tasks: Sequence[Callable], policy: Policy):
        self.over, self.policy = devices.mesh(), parallel.as_argument(policy)
        self.pool = jax.jit(functools.partial(_pool, tuple(tasks)))
        self.begin = devices.spread(self.over, _begin)
        self.run = devices.spread(self.over, _minute, donate=True)

    def minutes(
        self, scenario: Scenario, turn: int, seed: int, chains: int, minutes: int, watch: Callable[[int], None]
    ) -> tuple[np.ndarray, np.ndarray]:
        """(chains, minutes, 60, S) bool situations once a second; (2,) how many episodes were completed, and not.

        ``watch(minutes)`` is told how far they are. Raises FloatingPointError if a robot is nowhere.
        """
        size = -(-chains // self.over.size) * self.over.size
        key = jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), turn), 1)
        starts = self.pool(scenario, self.policy, jnp.int32(turn), key)
        fixed = devices.everywhere(self.over, (scenario, self.policy, starts))
        states = self.begin(fixed, devices.keys(self.over, jax.random.fold_in(key, 2), size))
        kept, ended = [], np.zeros(2, int)
        for minute in range(minutes):
            states, flags, over, sound = self.run(fixed, states)
            if not bool(np.asarray(sound).all()):
                raise FloatingPointError("a robot's or a person's place is not finite; nothing more is written.")
            kept.append(np.asarray(flags)[:chains])
            ended += np.asarray(over)[:chains].sum(0)
            watch(minute + 1)
        return np.stack(kept, 1), ended


def _pool(tasks: tuple, scenario: Scenario, policy: Policy, turn: Array, key: Array) -> restarts.Pool:
    return restarts.pool(_with_turn(scenario, tasks, turn), key, STARTS, policy)


def _begin(fixed: tuple, key: Array) -> State:
    """A start of the pool with a key of its own."""
    *_, starts = fixed
    chosen = jax.random.randint(key, (), 0, starts.starts.tick.shape[0], jnp.int32)
    return dataclasses.replace(jax.tree.map(lambda leaf: leaf[chosen], starts.starts), key=jax.random.fold_in(key, 1))


def _minute(fixed: tuple, state: State) -> tuple:
    scenario, policy, starts = fixed
    ticks = round(1.0 / scenario.time_step)

    def second(state: State, _) -> tuple:
        over: Any
        state, over = restarts.endless(scenario, policy, starts, state, ticks, _ended)
        return state, (state.situations, over.sum(0, dtype=jnp.int32))

    state, (flags, over) = jax.lax.scan(second, state, length=MINUTE)
    sound = jnp.isfinite(state.robot.position).all() & jnp.isfinite(state.pedestrians.position).all()
    return state, flags, over.sum(0, dtype=jnp.int32), sound


def _ended(before: State, after: State, action: Array) -> Array:
    return jnp.stack([after.completed & ~before.completed, after.timed_out & ~before.timed_out])


def _with_turn(scenario: Scenario, tasks: tuple, turn: Array) -> Scenario:
    """The scenario whose task is that of the index."""

    def task(scenario: Scenario, *others: Any) -> RobotTask:
        return jax.lax.switch(turn, [functools.partial(each, scenario) for each in tasks], *others)

    return dataclasses.replace(scenario, task=task)


class Numbered:
    """Programs for numbered episodes; drivers that differ in their data alone share what is compiled."""

    def __init__(self, tasks: Sequence[Callable]):
        self.over = devices.mesh()
        self.draw = devices.spread(self.over, functools.partial(_draw, tuple(tasks)))
        self.advance = devices.spread(self.over, _advance, donate=True)

    def episodes(
        self,
        policy: Policy,
        scenario: Scenario,
        seed: int,
        turn: int,
        numbers: np.ndarray,
        watch: Callable[[float], None],
    ) -> Episodes:
        """The episodes of those numbers (E,), whose task has the index ``turn``, each until its end.

        ``watch(seconds)`` is told how far they are.
        """
        size = -(-len(numbers) // self.over.size) * self.over.size
        fixed = scenario, parallel.as_argument(policy), jnp.uint32(seed), jnp.int32(turn)
        fixed = devices.everywhere(self.over, fixed)
        states = self.draw(fixed, jnp.asarray(np.resize(np.asarray(numbers, np.uint32), size)))
        lived = jnp.zeros(size, jnp.int32)
        for done in range(CHUNK, math.ceil(scenario.time_limit) + CHUNK, CHUNK):
            states, lived = self.advance(fixed, states, lived)
            watch(done)
            if bool(np.asarray(states.completed | states.timed_out).all()):
                break
        measured = jax.tree.map(np.asarray, jax.vmap(results, (None, 0))(scenario, states))
        kept = slice(len(numbers))
        found = {name: values[kept] for name, values in measured.items()}
        return Episodes(np.asarray(states.completed)[kept], np.asarray(lived)[kept] * scenario.time_step, found)


def _draw(tasks: tuple, fixed: tuple, number: Array) -> State:
    scenario, policy, seed, turn = fixed
    key = jax.random.fold_in(jax.random.key(seed), number)
    return parallel.begin(scenario, policy, reset(_with_turn(scenario, tasks, turn), key))


def _advance(fixed: tuple, state: State, lived: Array) -> tuple[State, Array]:
    """CHUNK seconds more, and how many steps the episode has lived."""
    scenario, policy, *_ = fixed

    def one(carry: tuple, _) -> tuple:
        before, lived = carry
        after, _ = parallel.advance(scenario, policy, before)
        return (after, lived + (~(before.completed | before.timed_out)).astype(jnp.int32)), None

    return jax.lax.scan(one, (state, lived), length=CHUNK * round(1.0 / scenario.time_step))[0]
