"""Short-horizon actor-critic: the actor follows derivatives of the reward through the simulator for some steps, and a
critic estimates the return after them.

The derivative goes through the robot and its observations, and optionally through people: a crowd makes it slower and
noisier (docs/gradients.md). Rewards that count events have no derivative: the actor learns from potentials and smooth
costs.

Source: J. Xu et al., "Accelerated policy learning with parallel differentiable simulation", ICLR 2022.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from flax import struct
from flax.typing import VariableDict
from jaxtyping import Float

from sean_jax import mdp
from sean_jax.config import APGConfig
from sean_jax.core.data_types import Array, Pedestrians, Scenario, State
from sean_jax.learning import networks, rollouts
from sean_jax.learning.networks import ActorCritic, Agent, NetworkOutput, draw_action
from sean_jax.learning.rollouts import EnvBatch, Envs, Optimization, Transition

MAX_GRADIENT_NORM = 1.0

_ADAM = optax.chain(optax.clip_by_global_norm(MAX_GRADIENT_NORM), optax.scale_by_adam(b1=0.7, b2=0.95))
ACTOR = optax.partition({"actor": _ADAM, "critic": optax.set_to_zero()}, networks.owners)
CRITIC = optax.partition({"actor": optax.set_to_zero(), "critic": _ADAM}, networks.owners)


@struct.dataclass
class Optimizers:
    """The state between updates besides the agent. Checkpoints have these field names."""

    actor: optax.OptState
    critic: optax.OptState
    target: VariableDict  # parameters of the target critic


@dataclasses.dataclass(frozen=True)
class StopGradient:
    """A pedestrian model through which no derivative goes; equal for equal models."""

    move: Callable[[Scenario, State], Pedestrians]

    def __call__(self, scenario: Scenario, state: State) -> Pedestrians:
        """People one control step later."""
        return jax.lax.stop_gradient(self.move(scenario, state))


def _without_people(env: mdp.Env) -> mdp.Env:
    scenario = env.scenario
    return replace(env, scenario=replace(scenario, move=StopGradient(scenario.move)))


def init(agent: Agent) -> Optimizers:
    """The optimizers before the first update."""
    parameters = agent.parameters
    return Optimizers(ACTOR.init(parameters), CRITIC.init(parameters), jax.tree.map(jnp.array, parameters))


def update(
    options: APGConfig,
    hyperparameters: dict[str, Array],
    envs: Envs,
    network: ActorCritic,
    agent: Agent,
    optimizer: Optimizers,
    batch: EnvBatch,
    key: Array,
) -> tuple[Agent, Optimizers, EnvBatch, Transition, dict[str, Any]]:
    """The agent, optimizers and scenarios after a rollout, a step of the actor along its gradient, and the critic's
    epochs; the transitions; and numbers for the log.

    Args:
        hyperparameters: this agent's values of ``APGConfig.SWEPT``; the learning rate is this update's, and
            ``actor_rate`` the actor's.
        envs: with pools; scenarios are shared out equally.
        key: () typed PRNG key of this update.
    """
    envs = tuple(env.map_member(mdp.Env.with_transition_gradients) for env in envs)
    if not options.through_people:
        envs = tuple(env.map_member(_without_people) for env in envs)

    # The target critic values the end of the horizon: it changes slowly, so the actor chases no moving goal.
    memory = batch.memory
    discount = hyperparameters["discount"]
    target_critic = replace(agent, parameters=optimizer.target)

    # The actor makes one step along the gradient through the simulator.
    horizon = Horizon(envs, network, target_critic, batch, options.horizon, key, discount)
    (loss, (batch, transitions)), gradient = jax.value_and_grad(
        lambda parameters: _actor_loss(horizon, replace(agent, parameters=parameters)), has_aux=True
    )(agent.parameters)
    batch, transitions = jax.lax.stop_gradient((batch, transitions))

    # A crowd in contact can make a gradient infinite: such an update moves the actor nowhere, and is counted.
    norm = optax.tree.norm(gradient)
    finite = jnp.isfinite(norm)
    gradient = jax.tree.map(lambda leaf: jnp.where(finite, leaf, 0.0), gradient)
    actor_rate = hyperparameters["actor_rate"]
    parameters, actor = rollouts.apply_gradient(ACTOR, actor_rate, agent.parameters, optimizer.actor, gradient)
    agent = replace(agent, parameters=parameters)

    # The critic learns the returns of the rollout, as the target critic estimates them.
    last = rollouts.forward(network, target_critic, envs[0].member.observations, batch)
    advantage = rollouts.advantages(transitions, last.value, discount, hyperparameters["advantage_decay"])

    # Its minibatches are of the rollout alone: old transitions would be of another policy.
    rate = hyperparameters["learning_rate"]
    optimization = Optimization(CRITIC, rate, options.critic_epochs, options.minibatches)
    data = transitions._replace(info={}), advantage + transitions.value
    learner = network, agent, optimizer.critic
    agent, critic, error = rollouts.optimize(optimization, critic_loss, *learner, data, memory, key)

    # The target critic follows it slowly.
    share = options.target_share
    target = jax.tree.map(lambda old, new: old + share * (new - old), optimizer.target, agent.parameters)

    # The log has the norm before the clip, infinite where it was lost.
    losses = {
        "loss": loss,
        "critic": error,
        "gradient": jnp.where(finite, norm, jnp.inf),
        "lost": 1.0 - finite.astype(jnp.float32),  # updates whose gradient was not finite
    }
    metrics = {"train": losses, **rollouts.log_numbers(transitions)}
    agent = rollouts.with_statistics(agent, transitions)
    return agent, Optimizers(actor, critic, target), batch, transitions, metrics


def critic_loss(output: NetworkOutput, transitions: Transition, target: Float[Array, "T B"]) -> tuple[Array, Array]:
    """Half the mean squared error of the value, as the loss and for the log."""
    error = 0.5 * ((output.value - target) ** 2).mean()
    return error, error


class Horizon(NamedTuple):
    """The steps through which the derivative goes."""

    envs: Envs  # with pools
    network: ActorCritic
    target_critic: Agent
    batch: EnvBatch  # at the beginning
    steps: int
    key: Array  # () typed PRNG key of the update
    discount: Float[Array, ""]


def _actor_loss(horizon: Horizon, actor: Agent) -> tuple[Array, tuple[EnvBatch, Transition]]:
    """Minus the discounted reward of some steps and the value after them, divided by the steps; the scenarios then."""
    envs, network, target_critic, batch, steps, key, discount = horizon
    terms = envs[0].member.observations

    @jax.checkpoint  # a step is recomputed in the backward pass
    def advance(carry: tuple[EnvBatch, Array], tick: Array) -> tuple[tuple[EnvBatch, Array], tuple[Array, Transition]]:
        batch, weight = carry
        action_key, next_key = jax.random.split(jax.random.fold_in(key, tick))
        output = rollouts.forward(network, actor, terms, batch)
        value = rollouts.forward(network, target_critic, terms, batch).value
        action = draw_action(output, action_key)
        batch, transition = rollouts.step(envs, network, target_critic, batch, output, action, next_key)

        # An episode that ends here is worth the value of its last state; the next one begins undiscounted.
        final_value = jnp.where(transition.done, discount * transition.final_value, 0.0)
        gain = weight * (transition.reward + final_value)
        weight = jnp.where(transition.done, 1.0, weight * discount)
        return (batch, weight), (gain, transition._replace(value=value))

    carry = batch, jnp.ones(batch.start.shape, jnp.float32)
    (batch, weight), (gains, transitions) = jax.lax.scan(advance, carry, jnp.arange(steps, dtype=jnp.int32))
    last = rollouts.forward(network, target_critic, terms, batch).value
    gain = gains.sum(0) + jnp.where(batch.start, 0.0, weight * last)
    return -gain.mean() / steps, (batch, transitions)
