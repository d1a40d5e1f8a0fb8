"""Short-horizon actor-critic: the actor follows derivatives of the reward through the simulator, and a critic tells
what follows after some steps.

The derivative goes through the robot and what is seen of it, and through people if asked: a crowd makes it longer to
compute and noisier (docs/gradients.md). Rewards that count events have no derivative, so it is potentials and smooth
costs from which the actor learns.

Source: J. Xu et al., "Accelerated policy learning with parallel differentiable simulation", ICLR 2022.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import optax
from flax import struct
from flax.typing import VariableDict
from jaxtyping import PyTree

from sean_jax import mdp
from sean_jax.base import Array, Pedestrians, Scenario, State
from sean_jax.config import APGConfig
from sean_jax.learning.networks import ActorCritic, Agent, NetworkOutput, draw_action, update_statistics
from sean_jax.learning.rollouts import (
    EnvBatch,
    Optimization,
    Transition,
    advantages,
    apply_gradient,
    episode_means,
    forward,
    optimize,
    step,
)

MAX_GRADIENT_NORM = 1.0

ACTOR = optax.chain(optax.clip_by_global_norm(MAX_GRADIENT_NORM), optax.scale_by_adam(b1=0.7, b2=0.95))
CRITIC = optax.chain(optax.clip_by_global_norm(MAX_GRADIENT_NORM), optax.scale_by_adam(b1=0.7, b2=0.95))


@struct.dataclass
class Optimizers:
    """What is kept between updates beside the agent."""

    actor: optax.OptState
    critic: optax.OptState
    target: VariableDict  # parameters whose critic tells what follows


@dataclasses.dataclass(frozen=True)
class StopGradient:
    """A pedestrian model through which no derivative goes; equal for equal models."""

    move: Callable[[Scenario, State], Pedestrians]

    def __call__(self, scenario: Scenario, state: State) -> Pedestrians:
        """People one control step later."""
        return jax.lax.stop_gradient(self.move(scenario, state))


def init(agent: Agent) -> Optimizers:
    """The optimizers before the first update."""
    parameters = agent.parameters
    return Optimizers(ACTOR.init(parameters), CRITIC.init(parameters), jax.tree.map(jnp.array, parameters))


def update(
    options: APGConfig,
    numbers: dict[str, Array],
    envs: tuple[mdp.Env, ...],
    network: ActorCritic,
    agent: Agent,
    optimizer: Optimizers,
    rows: EnvBatch,
    key: Array,
) -> tuple[Agent, Optimizers, EnvBatch, Transition, dict[str, Any]]:
    """Let the agent drive, improve the actor by the derivative of what it got, and then the critic.

    Args:
        numbers: what an agent of a sweep has for itself, of the names in ``APGConfig.SWEPT``; the learning rate is that
            of this update.
        envs: what is trained on, with pools; scenarios are shared out equally.
        key: () typed PRNG key of this update.

    Returns:
        The agent, the optimizers, the scenarios, what was seen, and numbers for the log.
    """
    envs = tuple(env.with_transition_gradients() for env in envs)
    if not options.through_people:
        held = (replace(env.scenario, move=StopGradient(env.scenario.move)) for env in envs)
        envs = tuple(replace(env, scenario=scenario) for env, scenario in zip(envs, held, strict=True))
    memory = rows.memory
    judge = replace(agent, parameters=optimizer.target)

    def lost(parameters: PyTree) -> tuple[Array, tuple[EnvBatch, Transition]]:
        acting = replace(agent, parameters=parameters)
        return _loss(envs, network, acting, judge, rows, options.horizon, key, numbers["discount"])

    (loss, (rows, seen)), gradient = jax.value_and_grad(lost, has_aux=True)(agent.parameters)
    rows, seen = jax.lax.stop_gradient((rows, seen))
    norm = optax.tree.norm(gradient)
    finite = jnp.isfinite(norm)
    gradient = jax.tree.map(lambda part: jnp.where(finite, part, 0.0), gradient)
    parameters, actor = apply_gradient(ACTOR, numbers["learning_rate"], agent.parameters, optimizer.actor, gradient)
    agent = replace(agent, parameters=parameters)

    last = forward(network, judge, envs[0].observations, rows)
    advantage = advantages(seen, last.value, numbers["discount"], numbers["advantage_decay"])

    def critic_loss(said: NetworkOutput, steps: Transition, wanted: Array) -> tuple[Array, Array]:
        error = 0.5 * ((said.value - wanted) ** 2).mean()
        return error, error

    descent = Optimization(CRITIC, numbers["learning_rate"], options.critic_epochs, options.minibatches)
    data = seen._replace(told={}), advantage + seen.value
    agent, critic, error = optimize(descent, critic_loss, network, agent, optimizer.critic, data, memory, key)
    share = options.target_share
    target = jax.tree.map(lambda old, new: old + share * (new - old), optimizer.target, agent.parameters)
    told = {
        "train": {
            "loss": loss,
            "critic": error,
            "gradient": jnp.where(finite, norm, jnp.inf),
            "lost": 1.0 - finite.astype(jnp.float32),
        },
        "episodes": episode_means(seen),
        "rewards": {name: part.mean() for name, part in seen.told["rewards"].items()},
    }
    statistics = update_statistics(agent.statistics, seen.vector.reshape(-1, seen.vector.shape[-1]))
    return replace(agent, statistics=statistics), Optimizers(actor, critic, target), rows, seen, told


def _loss(
    envs: tuple[mdp.Env, ...],
    network: ActorCritic,
    agent: Agent,
    judge: Agent,
    rows: EnvBatch,
    steps: int,
    key: Array,
    discount: Array,
) -> tuple[Array, tuple[EnvBatch, Transition]]:
    """Minus the discounted reward of some steps and the value of what follows, a step; the scenarios afterwards."""
    terms = envs[0].observations

    @jax.checkpoint  # what a step needs on the way back is computed again
    def one(carry: tuple[EnvBatch, Array], tick: Array) -> tuple[tuple[EnvBatch, Array], tuple[Array, Transition]]:
        rows, weight = carry
        action_key, next_key = jax.random.split(jax.random.fold_in(key, tick))
        said, value = forward(network, agent, terms, rows), forward(network, judge, terms, rows).value
        rows, seen = step(envs, network, judge, rows, said, draw_action(said, action_key), next_key)
        gain = weight * (seen.reward + jnp.where(seen.over, discount * seen.final_value, 0.0))
        return (rows, jnp.where(seen.over, 1.0, weight * discount)), (gain, seen._replace(value=value))

    carry = rows, jnp.ones(rows.start.shape, jnp.float32)
    (rows, weight), (gains, seen) = jax.lax.scan(one, carry, jnp.arange(steps, dtype=jnp.int32))
    last = forward(network, judge, terms, rows).value
    gain = gains.sum(0) + jnp.where(rows.start, 0.0, weight * last)
    return -gain.mean() / steps, (rows, seen)
