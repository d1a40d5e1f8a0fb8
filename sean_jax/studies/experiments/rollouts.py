"""Chains of episodes without a break, many at once (Table I).

The streams of the protocol (section V-B) differ in what a reset draws, but not in what a step reads. So each stream has
its own resets, and all streams are stepped in one batch.
"""

import dataclasses
import functools
import threading
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import devices, episodes, prng, runner
from sean_jax.base import Array, Policy, Scenario, State
from sean_jax.classifiers import Situation, classify
from sean_jax.scenario import moment

MINUTE = 60  # s, of a block of the bootstrap
LEAD = 1  # min of each chain that do not count, since all chains begin with the start of an episode


class Streams:
    """Scenarios that differ in their resets only, with starts of their episodes, which all who drive there share.

    Args:
        scenarios: of the C streams.
        seed: of all that happens in them.
        size: K starts of each stream, from which its chains restart.
    """

    def __init__(self, scenarios: Sequence[Scenario], seed: int, size: int):
        self.scenarios, self.seed, self.size = list(scenarios), seed, size
        self._lock, self._starts = threading.Lock(), None

    def starts(self) -> State:
        """(C, K, ...) before anybody drives. They are drawn once: to compile a reset takes as long as a step."""
        with self._lock:
            if self._starts is None:
                key, number = prng.key("table1 starts", self.seed), len(self.scenarios)
                keys = jnp.stack([jax.random.split(jax.random.fold_in(key, c), self.size) for c in range(number)])
                draw = jax.jit(functools.partial(_starts, tuple(each.task for each in self.scenarios)))
                self._starts = draw(self.scenarios[0], runner.varying_leaves(self.scenarios), keys)
            return self._starts


def _starts(tasks: tuple, scenario: Scenario, varying: dict[int, Array], keys: Array) -> State:
    def stream(given: tuple[Array, Array]) -> State:
        index, keys = given
        return jax.vmap(lambda key: runner.first_state(tasks, scenario, varying, index, key))(keys)

    return jax.lax.map(stream, (jnp.arange(len(tasks), dtype=jnp.int32), keys))


class Chains:
    """Episodes that follow one another. One call simulates a minute of all chains.

    Args:
        policy: drives the robot.
        further: names and functions of situations that are noted besides those of the scenario.
    """

    def __init__(self, policy: Policy, further: tuple[tuple[str, Situation], ...] = ()):
        self.over, self.policy = devices.mesh(), policy
        self.remember = jax.jit(_remembered)
        self.begin = devices.shard(self.over, _begin)
        self.run = devices.shard(self.over, functools.partial(_minute, further), donate=True)

    def minutes(
        self, streams: Streams, chains: int, minutes: int, watch: Callable[[float], None]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Situations once a second, after ``LEAD`` minutes that do not count.

        Args:
            watch: called with the finished share, from 0 to 1.

        Returns:
            Whether each situation holds, the scenario's before the further ones, (C * chains, minutes, 60, S) bool; and
            the numbers of episodes that were completed and that were not, (2,).

        Raises:
            FloatingPointError: the position of a robot or a person is not finite.
        """
        number, scenario = chains * len(streams.scenarios), streams.scenarios[0]
        size = -(-number // self.over.size) * self.over.size
        starts = self.remember(scenario, self.policy, streams.starts())
        fixed = devices.replicate(self.over, (scenario, self.policy, starts))
        stream = np.minimum(np.arange(size) // chains, len(streams.scenarios) - 1)
        keys = devices.keys(self.over, prng.key("table1", streams.seed), size)
        carry = self.begin(fixed, keys, jnp.asarray(stream, jnp.int32))
        situations, ended = [], np.zeros(2, int)
        for minute in range(LEAD + minutes):
            carry, flags, over, sound = self.run(fixed, carry)
            if not bool(np.asarray(sound).all()):
                raise FloatingPointError("a robot's or a person's place is not finite; nothing more is written.")
            if minute >= LEAD:
                situations.append(np.asarray(flags)[:number])
                ended += np.asarray(over)[:number].sum(0)
            watch((minute + 1) / (LEAD + minutes))
        return np.stack(situations, 1), ended


def _remembered(scenario: Scenario, policy: Policy, starts: State) -> State:
    """(C, K, ...) starts with the policy's memory."""
    return jax.vmap(jax.vmap(lambda state: episodes.init_policy(scenario, policy, state)))(starts)


def _begin(fixed: tuple, key: Array, stream: Array) -> tuple[Array, State]:
    return stream, _start(fixed[2], stream, key)


def _start(starts: State, stream: Array, key: Array) -> State:
    """A random start of the stream's pool, with random streams of its own."""
    choice_key, streams_key = jax.random.split(key)
    index = jax.random.randint(choice_key, (), 0, starts.tick.shape[1], jnp.int32)
    fresh = jax.tree.map(lambda leaf: leaf[stream, index], starts)
    return dataclasses.replace(fresh, streams=prng.streams(streams_key))


def _minute(further: tuple[tuple[str, Situation], ...], fixed: tuple, carry: tuple[Array, State]) -> tuple:
    """One minute of a chain: ``episodes.rollout_autoreset`` with the pool of the chain's stream."""
    scenario, policy, starts = fixed
    stream, state = carry
    ticks = round(1.0 / scenario.time_step)

    def tick(before: State, _) -> tuple[State, Array]:
        after, _ = episodes.policy_step(scenario, policy, before)
        key = jax.random.fold_in(after.streams.restart, after.tick)
        fresh, over = _start(starts, stream, key), after.completed | after.timed_out
        ended = jnp.stack([after.completed, after.timed_out])
        return jax.tree.map(lambda old, new: jnp.where(over, new, old), after, fresh), ended

    def second(state: State, _) -> tuple:
        state, ended = jax.lax.scan(tick, state, length=ticks)
        found = state.situations
        if further:  # once a second is as often as they are read
            found = jnp.concatenate([found, classify(moment(scenario, state), scenario.thresholds, further)])
        return state, (found, ended.sum(0, dtype=jnp.int32))

    state, (flags, ended) = jax.lax.scan(second, state, length=MINUTE)
    sound = jnp.isfinite(state.robot.position).all() & jnp.isfinite(state.pedestrians.position).all()
    return (stream, state), flags, ended.sum(0, dtype=jnp.int32), sound
