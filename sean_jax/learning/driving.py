"""An agent of reinforcement learning as a policy that drives in the simulator: the mean of its actions.

The policy's memory holds that of the observation, so that delays and stacks are as in training, and the network's.
"""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Float, PyTree

from sean_jax.base import Array, Policy, Scenario, State
from sean_jax.learning.actor_critic import ActorCritic, Agent, answer
from sean_jax.mdp import observations, to_command


@struct.dataclass
class DriverParams:
    """Parameters of the policy: the agent's are leaves, so ``grad`` and ``vmap`` reach them."""

    agent: Agent
    network: ActorCritic = struct.field(pytree_node=False)
    terms: observations.Terms = struct.field(pytree_node=False)


@struct.dataclass
class DriverState:
    """What the policy remembers of an episode."""

    observed: PyTree  # of ``observations.observe``
    memory: Float[Array, "M"]  # of the network
    start: Array  # () bool, before the first step


def policy(network: ActorCritic, agent: Agent, terms: observations.Terms, name: str = "agent") -> Policy:
    """Make a policy of an agent.

    Returns:
        A policy for ``rollout``.
    """
    return Policy(params=DriverParams(agent, network, terms), name=name, init=init, apply=apply)


def init(scenario: Scenario, params: DriverParams, state: State) -> DriverState:
    """Begin an episode."""
    key = jax.random.fold_in(state.streams.policy, 2**31 - 1)  # above any tick
    _, observed = observations.begin(params.terms, scenario, state, key)
    return DriverState(observed, jnp.zeros(params.network.memory_size, jnp.float32), jnp.ones((), bool))


def apply(scenario: Scenario, params: DriverParams, state: State, key: Array) -> tuple[Float[Array, "2"], DriverState]:
    """Drive one control step.

    Args:
        key: unused; the mean of the actions is not drawn.

    Returns:
        (2,) m/s, rad/s, the command, and the new memory.
    """
    before: DriverState = state.policy_state
    seen, observed = observations.observe(params.terms, scenario, state, before.observed)
    vector = observations.flatten(params.terms, seen).astype(jnp.float32)
    vector = jnp.pad(vector, (0, params.network.private))  # of what the critic alone sees; it is not asked
    images = {name: seen[name].astype(params.network.image_dtype) for name in params.network.images}
    said = answer(params.network, params.agent, vector, images, before.memory, before.start)
    after = DriverState(observed, said.memory, jnp.zeros((), bool))
    return to_command(scenario.robot, said.mean.astype(state.robot.position.dtype)), after
