"""Automatic restarts: an episode that has ended goes on as another one, drawn from a pool of starts.

A reset inside every step would be computed for every scenario at every step, and make stepping three times slower; a
start of the pool is only copied. Its chance is its own: the streams of the restarted episode come from the one that
ended, so no two episodes are equal although two may begin alike.
"""

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
from flax import struct

from sean_jax import chance
from sean_jax.base import Array, Frame, Policy, Scenario, State
from sean_jax.parallel import advance, begin
from sean_jax.scenario import frame, reset


@struct.dataclass
class Pool:
    """Starts to restart from."""

    starts: State  # (K, ...)


def pool(scenario: Scenario, key: Array, size: int, policy: Policy | None = None) -> Pool:
    """A pool of ``size`` starts drawn with a key; wrap it in ``jax.jit``, with ``size`` static.

    A ``policy`` that is a ``Driver`` has to be named, for each start holds its memory.
    """

    def one(key: Array) -> State:
        state = reset(scenario, key)
        return state if policy is None else begin(scenario, policy, state)

    return Pool(jax.vmap(one)(jax.random.split(key, size)))


def restart(starts: Pool, state: State) -> State:
    """The state; or, if its episode has ended, one of the pool's starts with streams of its own."""
    choice_key, streams_key = jax.random.split(jax.random.fold_in(state.streams.restart, state.tick))
    chosen = jax.random.randint(choice_key, (), 0, starts.starts.tick.shape[0], jnp.int32)
    fresh = jax.tree.map(lambda leaf: leaf[chosen], starts.starts)
    fresh = replace(fresh, streams=chance.streams(streams_key))
    over = state.completed | state.timed_out
    return jax.tree.map(lambda old, new: jnp.where(over, new, old), state, fresh)


def endless(
    scenario: Scenario, policy: Policy, starts: Pool, state: State, steps: int, record: Callable = frame
) -> tuple[State, Frame]:
    """As ``parallel.simulate``, but episodes follow one another: who trains a policy steps like this.

    ``record(before, after, action)`` sees the last step of an episode before it is restarted, so ``after`` tells how it
    ended; ``Frame.active`` is true throughout.
    """

    def one(before: State, _) -> tuple[State, Frame]:
        after, action = advance(scenario, policy, before)
        return restart(starts, after), record(before, after, action)

    return jax.lax.scan(one, state, length=steps)
