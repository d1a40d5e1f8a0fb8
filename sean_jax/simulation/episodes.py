"""Whole episodes in one call (section IV): a scan over steps, to be vmapped over keys or states.

Episodes end (``rollout``, ``simulate``) or restart (``rollout_autoreset``). A reset inside
every step would run for every scenario at every step, and make stepping three times slower. So an ended episode is
replaced by a copy of one of the starts of a pool. Its streams come from the episode that ended, so no two episodes are
equal although two may begin alike.
"""

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
from flax import struct
from jax.flatten_util import ravel_pytree
from jaxtyping import Float, PyTree

from sean_jax.core import random_streams, user_calls
from sean_jax.core.data_types import Array, Policy, PolicyLike, Scenario, State, as_policy, no_memory
from sean_jax.core.errors import InputError
from sean_jax.robots.drive import command_size
from sean_jax.robots.teammates import with_bodies
from sean_jax.simulation.scenario import frame, reset, step


def rollout(
    scenario: Scenario,
    policy: PolicyLike,
    key: Array,
    steps: int,
    record: Callable = frame,
    *,
    checkpoint_every: int | None = None,
    between: Callable[[State], State] | None = None,
) -> tuple[State, PyTree]:
    """An episode from its reset.

    Args:
        key: () typed PRNG key of the episode.
        steps: number of control steps; static.
        record: (before, after, action) -> the record of a step, a pytree; ``data_types.Trajectory`` by default.
        checkpoint_every: steps of a block of which reverse mode keeps only the first state; best a divisor of ``steps``
            near their root. None: reverse mode keeps something of every step, and computes each once.
        between: state -> state after each step, such as ``gradients.truncate``, ``damp`` and ``clip``.

    Returns:
        The last state, and the records, stacked (steps, ...). After its end an episode continues with constant metrics:
        ``Trajectory.active`` is false then.

    Raises:
        InputError: ``checkpoint_every`` is no positive number.
    """
    state = init_policy(scenario, policy, reset(scenario, key))
    return simulate(scenario, policy, state, steps, record, checkpoint_every=checkpoint_every, between=between)


def simulate(
    scenario: Scenario,
    policy: PolicyLike,
    state: State,
    steps: int,
    record: Callable = frame,
    *,
    checkpoint_every: int | None = None,
    between: Callable[[State], State] | None = None,
) -> tuple[State, PyTree]:
    """As ``rollout``, from a state that has the memory of the policy (``init_policy``)."""
    policy = as_policy(policy)
    numbers, forces = ravel_pytree(scenario.forces)  # reverse mode adds up one array, not one for each number

    def one(before: State, _) -> tuple[State, PyTree]:
        after, action = policy_step(replace(scenario, forces=forces(numbers)), policy, before)
        return after if between is None else between(after), record(before, after, action)

    return _scan(one, state, steps, checkpoint_every)


def init_policy(scenario: Scenario, policy: PolicyLike, state: State) -> State:
    """The state with a new ``policy_state``: the initial memory of a policy, at the start of an episode or later."""
    policy = as_policy(policy)
    view = with_bodies(scenario, state)
    memory = user_calls.call("policy", policy.init, "scenario, params, state", view[0], policy.params, view[1])
    return replace(state, policy_state=memory)


def policy_step(scenario: Scenario, policy: PolicyLike, state: State) -> tuple[State, Array]:
    """One control step with the command of a policy: the state, and the command [m/s, rad/s].

    Args:
        state: with the memory of the policy (``init_policy``). The policy's randomness is a stream of the episode.
    """
    policy = as_policy(policy)
    key = jax.random.fold_in(state.streams.policy, state.tick)
    action, memory = command(scenario, policy, state, key)
    return step(scenario, replace(state, policy_state=memory), action), action


def command(scenario: Scenario, policy: Policy, state: State, key: Array) -> tuple[Float[Array, "command"], PyTree]:
    """The command [m/s, rad/s] of a policy, and its new memory.

    Raises:
        PartError: a policy of the user's own raised an exception, or gives no such command or another memory.
    """
    apply = policy.apply
    scenario, state = with_bodies(scenario, state)
    output = user_calls.call("policy", apply, "scenario, params, state, key", scenario, policy.params, state, key)
    size = command_size(scenario.robot)
    names = "speed, turn_rate" if size == 2 else "speed, speed_to_the_left, turn_rate"
    cure = f"give jnp.stack([{names}]), in m/s and rad/s"
    if not isinstance(output, tuple) or len(output) != 2:
        got = user_calls.describe(output)
        raise user_calls.wrong(
            "policy", apply, got, "(command, memory)", "give both; the memory is () if there is none"
        )
    user_calls.check_array("policy", apply, output[0], float, (size,), cure)
    if policy.init is not no_memory:
        user_calls.check_like("policy", apply, output[1], state.policy_state, "a memory that is")
    return jnp.asarray(output[0], state.robot.position.dtype), output[1]


def check_policy(scenario: Scenario, policy: PolicyLike) -> None:
    """Try a policy with the shapes of its values alone, without compiling.

    Raises:
        PartError: one sentence with file and line of the user's, and the cure.
    """

    def try_policy(scenario: Scenario, policy: Policy, state: State, key: Array) -> PyTree:
        return command(scenario, policy, init_policy(scenario, policy, state), key)

    key = jax.eval_shape(jax.random.key, 0)
    jax.eval_shape(try_policy, scenario, as_policy(policy), _reset.eval_shape(scenario, key), key)


_reset = jax.jit(reset)  # whose shapes are traced once for a scenario


@struct.dataclass
class ResetPool:
    """Starts from which ended episodes restart."""

    starts: State  # (K, ...), or (C, K, ...) of C streams


def reset_pool(scenario: Scenario, key: Array, size: int, policy: PolicyLike | None = None) -> ResetPool:
    """A pool of starts; wrap it in ``jax.jit`` with ``size`` static.

    Args:
        policy: the driver, if it has memory: each start holds it.
    """

    def one(key: Array) -> State:
        state = reset(scenario, key)
        return state if policy is None else init_policy(scenario, policy, state)

    return ResetPool(jax.vmap(one)(jax.random.split(key, size)))


def autoreset(pool: ResetPool, state: State, stream: Array | None = None) -> State:
    """The state; or, if its episode has ended, one of the pool's starts with new streams (``draw_start``)."""
    choice_key, streams_key = jax.random.split(jax.random.fold_in(state.streams.restart, state.tick))
    fresh = draw_start(pool, choice_key, streams_key, stream)
    over = state.completed | state.timed_out
    return jax.tree.map(lambda old, new: jnp.where(over, new, old), state, fresh)


def draw_start(pool: ResetPool, choice_key: Array, streams_key: Array, stream: Array | None = None) -> State:
    """One of the pool's starts, with new streams.

    Args:
        choice_key: () typed PRNG key that chooses the start.
        streams_key: () typed PRNG key of the episode's streams.
        stream: () int32, whose starts are drawn, if the pool has several streams.
    """
    chosen = jax.random.randint(choice_key, (), 0, pool.starts.tick.shape[-1], jnp.int32)
    index = chosen if stream is None else (stream, chosen)
    start = jax.tree.map(lambda leaf: leaf[index], pool.starts)
    return replace(start, streams=random_streams.streams(streams_key))


def rollout_autoreset(
    scenario: Scenario,
    policy: PolicyLike,
    pool: ResetPool,
    state: State,
    steps: int,
    record: Callable = frame,
    *,
    checkpoint_every: int | None = None,
    between: Callable[[State], State] | None = None,
) -> tuple[State, PyTree]:
    """As ``simulate``, but ended episodes restart, for training.

    ``record`` sees the last step of an episode before the reset, so ``after`` tells how it ended; ``Trajectory.active``
    is true throughout.
    """

    def following(after: State) -> State:
        state = autoreset(pool, after)
        return state if between is None else between(state)

    return simulate(scenario, policy, state, steps, record, checkpoint_every=checkpoint_every, between=following)


def _scan(one: Callable, state: State, steps: int, checkpoint_every: int | None) -> tuple[State, PyTree]:
    """``jax.lax.scan`` of (state, None) -> (state, record), in blocks that reverse mode computes again."""
    if checkpoint_every is None:
        return jax.lax.scan(one, state, length=steps)
    if checkpoint_every < 1:
        raise InputError(f"checkpoint_every: {checkpoint_every} must be a number of steps, 1 or more.")

    def block(length: int) -> Callable:
        return jax.checkpoint(lambda state, _: jax.lax.scan(one, state, length=length), prevent_cse=False)

    blocks, rest = divmod(steps, checkpoint_every)
    state, record = jax.lax.scan(block(checkpoint_every), state, length=blocks)
    record = jax.tree.map(lambda leaf: leaf.reshape(blocks * checkpoint_every, *leaf.shape[2:]), record)
    if rest:
        state, last = block(rest)(state, None)
        record = jax.tree.map(lambda *parts: jnp.concatenate(parts), record, last)
    return state, record
