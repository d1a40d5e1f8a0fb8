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
from jaxtyping import Float, PyTree

from sean_jax import mdp
from sean_jax.base import Array, Pedestrians, Scenario, State
from sean_jax.config import APGConfig
from sean_jax.learning.actor_critic import ActorCritic, Agent, update_statistics
from sean_jax.learning.ppo import descend
from sean_jax.learning.rollouts import TOLD, Rows, Seen, advantages, of_episodes, say, unroll, vectors

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
class Held:
    """A pedestrian model through which no derivative goes; equal for equal models."""

    move: Callable[[Scenario, State], Pedestrians]

    def __call__(self, scenario: Scenario, state: State) -> Pedestrians:
        """People one control step later.

        Args:
            scenario: what is simulated.
            state: before the step.

        Returns:
            The people, as constants.
        """
        return jax.lax.stop_gradient(self.move(scenario, state))


def init(agent: Agent) -> Optimizers:
    """The optimizers before the first update.

    Args:
        agent: what is trained.

    Returns:
        Their states.
    """
    parameters = agent.parameters
    return Optimizers(ACTOR.init(parameters), CRITIC.init(parameters), jax.tree.map(jnp.array, parameters))


def update(
    options: APGConfig,
    numbers: dict[str, Array],
    env: mdp.Env,
    network: ActorCritic,
    agent: Agent,
    optimizer: Optimizers,
    rows: Rows,
    key: Array,
) -> tuple[Agent, Optimizers, Rows, Seen, dict[str, Any]]:
    """Let the agent drive, improve the actor by the derivative of what it got, and then the critic.

    Args:
        options: sizes.
        numbers: what an agent of a sweep has for itself, of the names in ``APGConfig.SWEPT``; the learning rate is that
            of this update.
        env: what is trained on, with a pool.
        network: whose parameters the agent has.
        agent: what is trained.
        optimizer: of the actor and the critic.
        rows: the scenarios.
        key: () typed PRNG key of this update.

    Returns:
        The agent, the optimizers, the scenarios, what was seen, and numbers for the log.
    """
    env = env.with_transition_gradients()
    if not options.through_people:
        env = replace(env, scenario=replace(env.scenario, move=Held(env.scenario.move)))
    memory = rows.memory
    judge = replace(agent, parameters=optimizer.target)

    def lost(parameters: PyTree) -> tuple[Array, tuple[Rows, Seen]]:
        acting = replace(agent, parameters=parameters)
        return _lost(env, network, acting, judge, rows, options.horizon, key, numbers["discount"])

    (loss, (rows, seen)), gradient = jax.value_and_grad(lost, has_aux=True)(agent.parameters)
    rows, seen = jax.lax.stop_gradient((rows, seen))
    norm = optax.tree.norm(gradient)
    finite = jnp.isfinite(norm)
    gradient = jax.tree.map(lambda part: jnp.where(finite, part, 0.0), gradient)
    parameters, actor = descend(ACTOR, numbers["learning_rate"], agent.parameters, optimizer.actor, gradient)
    agent = replace(agent, parameters=parameters)

    last = say(network, judge, env.observations, rows.observation, rows.memory, rows.start)
    advantage = advantages(seen, last.value, numbers["discount"], numbers["advantage_decay"])
    agent, critic, error = _judge_better(
        options, numbers, network, agent, optimizer.critic, seen, memory, advantage, key
    )
    share = options.target_share
    target = jax.tree.map(lambda old, new: old + share * (new - old), optimizer.target, agent.parameters)
    told = {
        "train": {
            "loss": loss,
            "critic": error,
            "gradient": jnp.where(finite, norm, jnp.inf),
            "lost": 1.0 - finite.astype(jnp.float32),
        },
        "episodes": of_episodes(seen),
        "rewards": {name: part.mean() for name, part in seen.told["rewards"].items()},
    }
    statistics = update_statistics(agent.statistics, seen.vector.reshape(-1, seen.vector.shape[-1]))
    return replace(agent, statistics=statistics), Optimizers(actor, critic, target), rows, seen, told


def _lost(
    env: mdp.Env, network: ActorCritic, agent: Agent, judge: Agent, rows: Rows, steps: int, key: Array, discount: Array
) -> tuple[Array, tuple[Rows, Seen]]:
    """Minus the discounted reward of some steps and the value of what follows, a step; the scenarios afterwards."""
    terms = env.observations

    @jax.checkpoint  # what a step needs on the way back is computed again
    def one(carry: tuple[Rows, Array], tick: Array) -> tuple[tuple[Rows, Array], tuple[Array, Seen]]:
        rows, weight = carry
        action_key, next_key = jax.random.split(jax.random.fold_in(key, tick))
        said = say(network, agent, terms, rows.observation, rows.memory, rows.start)
        action = said.mean + jnp.exp(said.log_std) * jax.random.normal(action_key, said.mean.shape, said.mean.dtype)
        keys = jax.random.split(next_key, rows.start.shape[0])
        following, envs, reward, terminated, truncated, info = jax.vmap(env.step)(keys, rows.envs, action)
        over = terminated | truncated
        final = say(network, judge, terms, info["final_observation"], said.memory, jnp.zeros_like(over))
        reward, follows = reward.astype(jnp.float32), jnp.where(truncated, final.value, 0.0)
        gain = weight * (reward + jnp.where(over, discount * follows, 0.0))
        seen = Seen(
            vector=vectors(terms, rows.observation),
            images={name: rows.observation[name].astype(network.image_dtype) for name in network.images},
            start=rows.start,
            action=action,
            log_density=jnp.zeros_like(reward),
            value=say(network, judge, terms, rows.observation, rows.memory, rows.start).value,
            reward=reward,
            over=over,
            final_value=follows,
            told={name: info[name] for name in TOLD},
        )
        rows = Rows(envs, following, said.memory, over)
        return (rows, jnp.where(over, 1.0, weight * discount)), (gain, seen)

    carry = rows, jnp.ones(rows.start.shape, jnp.float32)
    (rows, weight), (gains, seen) = jax.lax.scan(one, carry, jnp.arange(steps, dtype=jnp.int32))
    last = say(network, judge, terms, rows.observation, rows.memory, rows.start).value
    gain = gains.sum(0) + jnp.where(rows.start, 0.0, weight * last)
    return -gain.mean() / steps, (rows, seen)


def _judge_better(
    options: APGConfig,
    numbers: dict[str, Array],
    network: ActorCritic,
    agent: Agent,
    optimizer: optax.OptState,
    seen: Seen,
    memory: Float[Array, "B M"],
    advantage: Float[Array, "T B"],
    key: Array,
) -> tuple[Agent, optax.OptState, Array]:
    """Steps of the critic's optimizer over minibatches of whole scenarios, and its mean loss."""
    data = seen._replace(told={}), advantage + seen.value

    def loss(parameters: PyTree, part: tuple[Seen, Array], memory: Array) -> Array:
        steps, wanted = part
        said = unroll(network, replace(agent, parameters=parameters), steps, memory)
        return 0.5 * ((said.value - wanted) ** 2).mean()

    def step(carry: tuple, rows: Array) -> tuple[tuple, Array]:
        parameters, optimizer = carry
        part = jax.tree.map(lambda leaf: leaf[:, rows], data)
        error, gradient = jax.value_and_grad(loss)(parameters, part, memory[rows])
        return descend(CRITIC, numbers["learning_rate"], parameters, optimizer, gradient), error

    def epoch(carry: tuple, key: Array) -> tuple[tuple, Array]:
        order = jax.random.permutation(key, options.scenarios).reshape(options.minibatches, -1)
        return jax.lax.scan(step, carry, order)

    keys = jax.random.split(jax.random.fold_in(key, 2**31 - 1), options.critic_epochs)
    (parameters, optimizer), errors = jax.lax.scan(epoch, (agent.parameters, optimizer), keys)
    return replace(agent, parameters=parameters), optimizer, errors.mean()
