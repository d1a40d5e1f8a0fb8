"""Whole episodes in one call: a scan over steps, to be vmapped over keys or states."""

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp

from sean_jax.base import Array, Driver, Frame, Policy, Scenario, State
from sean_jax.scenario import frame, reset, step


def rollout(
    scenario: Scenario, policy: Policy, key: Array, steps: int, record: Callable = frame
) -> tuple[State, Frame]:
    """An episode from its reset: the last state, and what ``record`` keeps of each step, stacked (steps, ...).

    ``record(before, after, action)`` gives a pytree; ``base.Frame`` unless told otherwise. An episode that has
    ended goes on with its metrics standing still: ``Frame.active`` tells.
    """
    return simulate(scenario, policy, begin(scenario, policy, reset(scenario, key)), steps, record)


def simulate(
    scenario: Scenario, policy: Policy, state: State, steps: int, record: Callable = frame
) -> tuple[State, Frame]:
    """As ``rollout``, from a state, which holds the memory of the policy if that is a ``Driver`` (``begin``)."""

    def one(before: State, _) -> tuple[State, Frame]:
        after, action = advance(scenario, policy, before)
        return after, record(before, after, action)

    return jax.lax.scan(one, state, length=steps)


def as_argument(policy: Policy) -> Policy:
    """The policy as a pytree, to be an argument of a jitted function.

    What a driver has learned would otherwise be constants of the program, which take long to compile.
    """
    return policy if isinstance(policy, Driver) else jax.tree_util.Partial(policy)


def begin(scenario: Scenario, policy: Policy, state: State) -> State:
    """The state with the memory of the policy at the beginning of an episode; as it is for a mere function."""
    if not isinstance(policy, Driver):
        return state
    return replace(state, driver=policy.start(scenario, policy.data, state))


def advance(scenario: Scenario, policy: Policy, state: State) -> tuple[State, Array]:
    """One step with the command (2,) of a policy, whose chance is a stream of the episode's own."""
    key = jax.random.fold_in(state.streams.policy, state.tick)
    if isinstance(policy, Driver):
        action, memory = policy.drive(scenario, policy.data, state, key)
        state = replace(state, driver=memory)
    else:
        action = policy(scenario, state, key)
    action = jnp.asarray(action, state.robot.position.dtype)
    return step(scenario, state, action), action
