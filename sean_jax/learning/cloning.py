"""What an agent learns from another policy before it learns from rewards: to act as that one would.

In the first half of the updates the other drives, in the second half the agent, and the other says what it would do
there. So the agent also learns the way back from states to which only its own errors lead.

Source: S. Ross, G. Gordon & J. Bagnell, "A reduction of imitation learning and structured prediction to no-regret
online learning", AISTATS 2011.
"""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import optax
from jaxtyping import PyTree

from sean_jax import mdp
from sean_jax.base import Array, Policy
from sean_jax.config import ReinforcementConfig
from sean_jax.episodes import init_policy
from sean_jax.learning import ppo, rollouts
from sean_jax.learning.actor_critic import ActorCritic, Agent, update_statistics
from sean_jax.learning.rollouts import Rows, Seen, say, unroll, vectors

UPDATES = 100
EPOCHS = 4


def clone(
    options: ReinforcementConfig, env: mdp.Env, network: ActorCritic, agent: Agent, teacher: Policy, key: Array
) -> tuple[Agent, Array]:
    """Let an agent act as a policy does.

    Args:
        options: sizes, as of the training that follows.
        env: what is trained on; the pool of it is drawn anew.
        network: whose parameters the agent has.
        agent: what learns.
        teacher: who is imitated.
        key: () typed PRNG key.

    Returns:
        The agent, and (UPDATES,) the mean squared difference of actions in each update.
    """
    pool_key, rows_key, key = jax.random.split(key, 3)
    remember = jax.vmap(lambda state: init_policy(env.scenario, teacher, state))
    env = env.with_pool(pool_key, options.pool)
    assert env.pool is not None
    starts = replace(env.pool.states, simulation=remember(env.pool.states.simulation))
    env = replace(env, pool=replace(env.pool, states=starts))
    rows = rollouts.begin(env, network, rows_key, options.scenarios)
    rows = replace(rows, envs=replace(rows.envs, simulation=remember(rows.envs.simulation)))

    def one(carry: tuple[Agent, optax.OptState, Rows], number: Array) -> tuple[tuple, Array]:
        agent, optimizer, rows = carry
        memory, turn = rows.memory, jax.random.fold_in(key, number)
        rows, seen = _drive(env, network, agent, teacher, rows, options.horizon, turn, number >= UPDATES // 2)
        agent, optimizer, error = _imitate(options, network, agent, optimizer, seen, memory, turn)
        statistics = update_statistics(agent.statistics, seen.vector.reshape(-1, seen.vector.shape[-1]))
        return (replace(agent, statistics=statistics), optimizer, rows), error

    carry = agent, ppo.init(agent), rows
    (agent, _, _), errors = jax.lax.scan(one, carry, jnp.arange(UPDATES, dtype=jnp.int32))
    return agent, errors


def _drive(
    env: mdp.Env, network: ActorCritic, agent: Agent, teacher: Policy, rows: Rows, steps: int, key: Array, alone: Array
) -> tuple[Rows, Seen]:
    """Steps that the teacher drives, or the agent if it is ``alone``; the actions that are told are the teacher's."""

    def one(rows: Rows, tick: Array) -> tuple[Rows, Seen]:
        said = say(network, agent, env.observations, rows.observation, rows.memory, rows.start)

        def ask(state: Any) -> tuple[Array, PyTree]:
            chance = jax.random.fold_in(state.streams.policy, state.tick)
            command, memory = teacher.apply(env.scenario, teacher.params, state, chance)
            return mdp.to_action(env.scenario.robot, command), memory

        wanted, memory = jax.vmap(ask)(rows.envs.simulation)
        wanted = wanted.astype(jnp.float32)
        envs = replace(rows.envs, simulation=replace(rows.envs.simulation, policy_state=memory))
        keys = jax.random.split(jax.random.fold_in(key, tick), rows.start.shape[0])
        action = jnp.where(alone, said.mean, wanted)
        following, envs, _, terminated, truncated, _ = jax.vmap(env.step)(keys, envs, action)
        nothing = jnp.zeros(rows.start.shape, jnp.float32)
        seen = Seen(
            vector=vectors(env.observations, rows.observation),
            images={name: rows.observation[name].astype(network.image_dtype) for name in network.images},
            start=rows.start,
            action=wanted,
            log_density=nothing,
            value=nothing,
            reward=nothing,
            over=terminated | truncated,
            final_value=nothing,
            told={},
        )
        return Rows(envs, following, said.memory, terminated | truncated), seen

    return jax.lax.scan(one, rows, jnp.arange(steps, dtype=jnp.int32))


def _imitate(
    options: ReinforcementConfig,
    network: ActorCritic,
    agent: Agent,
    optimizer: optax.OptState,
    seen: Seen,
    memory: Array,
    key: Array,
) -> tuple[Agent, optax.OptState, Array]:
    """Steps of the optimizer over minibatches of whole scenarios, and the mean squared difference of actions."""

    def loss(parameters: PyTree, part: Seen, memory: Array) -> Array:
        said = unroll(network, replace(agent, parameters=parameters), part, memory)
        return ((said.mean - part.action) ** 2).mean()

    def step(carry: tuple, rows: Array) -> tuple[tuple, Array]:
        parameters, optimizer = carry
        part = jax.tree.map(lambda leaf: leaf[:, rows], seen)
        error, gradient = jax.value_and_grad(loss)(parameters, part, memory[rows])
        rate = jnp.asarray(options.learning_rate, jnp.float32)
        return ppo.descend(ppo.OPTIMIZER, rate, parameters, optimizer, gradient), error

    def epoch(carry: tuple, key: Array) -> tuple[tuple, Array]:
        order = jax.random.permutation(key, options.scenarios).reshape(options.minibatches, -1)
        return jax.lax.scan(step, carry, order)

    keys = jax.random.split(jax.random.fold_in(key, 2**31 - 1), EPOCHS)
    (parameters, optimizer), errors = jax.lax.scan(epoch, (agent.parameters, optimizer), keys)
    return replace(agent, parameters=parameters), optimizer, errors.mean()
