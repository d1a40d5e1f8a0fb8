"""Chains of episodes without a break, many at once (Table I).

The streams of the protocol (section V-B) differ in what a reset draws, but not in what a step reads. So each stream has
its own pool of starts, and all streams are stepped in one batch.
"""

import functools
import threading
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import devices, episodes, prng, runner
from sean_jax.base import Array, Policy, Scenario, State
from sean_jax.classifiers import Situation, classify
from sean_jax.episodes import ResetPool
from sean_jax.scenario import snapshot

MINUTE = 60  # s, of a block of the bootstrap
LEAD = 1  # min at the start of each chain that are not counted, since all chains begin with a start of an episode


class Streams:
    """C scenarios that differ in their resets alone, with ``size`` starts of each that all policies share."""

    def __init__(self, scenarios: Sequence[Scenario], seed: int, size: int):
        self.scenarios, self.seed, self.size = list(scenarios), seed, size
        self._lock, self._starts = threading.Lock(), None

    def starts(self) -> State:
        """(C, K, ...) without a policy's memory; drawn once, since a reset compiles as long as a step."""
        with self._lock:
            if self._starts is None:
                key, number = prng.key("table1 starts", self.seed), len(self.scenarios)
                keys = jnp.stack([jax.random.split(jax.random.fold_in(key, c), self.size) for c in range(number)])
                draw = jax.jit(functools.partial(_starts, tuple(each.task for each in self.scenarios)))
                self._starts = draw(self.scenarios[0], runner.varying_leaves(self.scenarios), keys)
            return self._starts


def _starts(tasks: tuple, scenario: Scenario, varying: dict[int, Array], keys: Array) -> State:
    def stream(index_and_keys: tuple[Array, Array]) -> State:
        index, keys = index_and_keys
        return jax.vmap(lambda key: runner.first_state(tasks, scenario, varying, index, key))(keys)

    return jax.lax.map(stream, (jnp.arange(len(tasks), dtype=jnp.int32), keys))


class Chains:
    """Episodes of a policy that follow one another. One call simulates a minute of all chains.

    ``more`` are situations that are noted besides those of the scenario.
    """

    def __init__(self, policy: Policy, more: tuple[tuple[str, Situation], ...] = ()):
        self.mesh, self.policy = devices.mesh(), policy
        self.init_policy = jax.jit(_init_policy)
        self.begin = devices.shard(self.mesh, _begin)
        self.run = devices.shard(self.mesh, functools.partial(_minute, more), donate=True)

    def minutes(
        self, streams: Streams, chains: int, minutes: int, tell: Callable[[float], None]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Situations once a second, after ``LEAD`` minutes; ``tell`` is called with the finished share.

        Returns:
            Whether each situation holds, (C * chains, minutes, 60, S) bool, the scenario's before ``more``; and the
            numbers of completed and other episodes, (2,).

        Raises:
            FloatingPointError: the position of a robot or a person is not finite.
        """
        number, scenario = chains * len(streams.scenarios), streams.scenarios[0]
        size = -(-number // self.mesh.size) * self.mesh.size
        pool = ResetPool(self.init_policy(scenario, self.policy, streams.starts()))
        fixed = devices.replicate(self.mesh, (scenario, self.policy, pool))
        stream = np.minimum(np.arange(size) // chains, len(streams.scenarios) - 1)
        keys = devices.keys(self.mesh, prng.key("table1", streams.seed), size)
        carry = self.begin(fixed, keys, jnp.asarray(stream, jnp.int32))
        situations, ended = [], np.zeros(2, int)
        for minute in range(LEAD + minutes):
            carry, flags, ends, finite = self.run(fixed, carry)
            if not bool(np.asarray(finite).all()):
                raise FloatingPointError("a robot's or a person's place is not finite; nothing more is written.")
            if minute >= LEAD:
                situations.append(np.asarray(flags)[:number])
                ended += np.asarray(ends)[:number].sum(0)
            tell((minute + 1) / (LEAD + minutes))
        return np.stack(situations, 1), ended


def _init_policy(scenario: Scenario, policy: Policy, starts: State) -> State:
    """(C, K, ...) starts with the policy's memory."""
    return jax.vmap(jax.vmap(lambda state: episodes.init_policy(scenario, policy, state)))(starts)


def _begin(fixed: tuple, key: Array, stream: Array) -> tuple[Array, State]:
    choice_key, streams_key = jax.random.split(key)
    return stream, episodes.draw_start(fixed[2], choice_key, streams_key, stream)


def _minute(more: tuple[tuple[str, Situation], ...], fixed: tuple, carry: tuple[Array, State]) -> tuple:
    """One minute of a chain: ``episodes.rollout_autoreset`` with the pool of the chain's stream."""
    scenario, policy, pool = fixed
    stream, state = carry
    ticks = round(1.0 / scenario.time_step)

    def tick(before: State, _) -> tuple[State, Array]:
        after, _ = episodes.policy_step(scenario, policy, before)
        return episodes.autoreset(pool, after, stream), jnp.stack([after.completed, after.timed_out])

    def second(state: State, _) -> tuple:
        state, ended = jax.lax.scan(tick, state, length=ticks)
        situations = state.situations
        if more:  # evaluated once a second, as often as they are read
            situations = jnp.concatenate([situations, classify(snapshot(scenario, state), scenario.thresholds, more)])
        return state, (situations, ended.sum(0, dtype=jnp.int32))

    state, (flags, ended) = jax.lax.scan(second, state, length=MINUTE)
    finite = jnp.isfinite(state.robot.position).all() & jnp.isfinite(state.pedestrians.position).all()
    return (stream, state), flags, ended.sum(0, dtype=jnp.int32), finite
