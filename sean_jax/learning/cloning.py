"""What an agent learns from another policy before it learns from rewards: to act as that one would.

In the first half of the updates the other drives, in the second half the agent, and the other says what it would do
there. So the agent also learns the way back from states to which only its own errors lead.

Source: S. Ross, G. Gordon & J. Bagnell, "A reduction of imitation learning and structured prediction to no-regret
online learning", AISTATS 2011.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import optax

from sean_jax import mdp
from sean_jax.base import Array, Policy
from sean_jax.config import ReinforcementConfig
from sean_jax.episodes import command, init_policy
from sean_jax.learning import ppo, rollouts
from sean_jax.learning.actor_critic import ActorCritic, Agent, Answer, update_statistics
from sean_jax.learning.descent import Descent, learn
from sean_jax.learning.rollouts import Rows, Seen, gather, say, step

UPDATES = 100
EPOCHS = 4


def clone(
    options: ReinforcementConfig,
    envs: tuple[mdp.Env, ...],
    network: ActorCritic,
    agent: Agent,
    teachers: tuple[Policy, ...],
    key: Array,
) -> tuple[Agent, Array]:
    """Let an agent act as a policy does.

    Args:
        key: () typed PRNG key.

    Returns:
        The agent, and (UPDATES,) the mean squared difference of actions in each update.
    """
    pool_key, rows_key, key = jax.random.split(key, 3)
    pool_keys = pool_key, *(jax.random.fold_in(key, 2**31 - turn) for turn in range(1, len(envs)))

    def remember(env: mdp.Env, teacher: Policy, states: mdp.EnvState) -> mdp.EnvState:
        begun = jax.vmap(lambda state: init_policy(env.scenario, teacher, state))(states.simulation)
        return replace(states, simulation=begun)

    def with_pool(env: mdp.Env, teacher: Policy, key: Array) -> mdp.Env:
        env = env.with_pool(key, options.pool)
        assert env.pool is not None
        return replace(env, pool=replace(env.pool, states=remember(env, teacher, env.pool.states)))

    envs = tuple(map(with_pool, envs, teachers, pool_keys))
    rows = rollouts.begin(envs, network, rows_key, options.scenarios)
    rows = replace(rows, envs=tuple(map(remember, envs, teachers, rows.envs)))
    rate = jnp.asarray(options.learning_rate, jnp.float32)
    descent = Descent(ppo.OPTIMIZER, rate, EPOCHS, options.minibatches)

    def one(carry: tuple[Agent, optax.OptState, Rows], number: Array) -> tuple[tuple, Array]:
        agent, optimizer, rows = carry
        memory, turn = rows.memory, jax.random.fold_in(key, number)
        rows, seen = _drive(envs, network, agent, teachers, rows, options.horizon, turn, number >= UPDATES // 2)
        agent, optimizer, error = learn(descent, _difference, network, agent, optimizer, (seen,), memory, turn)
        statistics = update_statistics(agent.statistics, seen.vector.reshape(-1, seen.vector.shape[-1]))
        return (replace(agent, statistics=statistics), optimizer, rows), error

    carry = agent, ppo.init(agent), rows
    (agent, _, _), errors = jax.lax.scan(one, carry, jnp.arange(UPDATES, dtype=jnp.int32))
    return agent, errors


def _difference(said: Answer, steps: Seen) -> tuple[Array, Array]:
    """Mean squared difference of actions, as the loss and for the log."""
    error = ((said.mean - steps.action) ** 2).mean()
    return error, error


def _drive(
    envs: tuple[mdp.Env, ...],
    network: ActorCritic,
    agent: Agent,
    teachers: tuple[Policy, ...],
    rows: Rows,
    steps: int,
    key: Array,
    alone: Array,
) -> tuple[Rows, Seen]:
    """Steps that the teacher drives, or the agent if it is ``alone``; the actions that are told are the teacher's."""

    def ask(env: mdp.Env, teacher: Policy, before: mdp.EnvState) -> tuple[Array, mdp.EnvState]:
        state = before.simulation
        chance = jax.random.fold_in(state.streams.policy, state.tick)
        wanted, memory = command(env.scenario, teacher, state, chance)
        asked = replace(before, simulation=replace(state, policy_state=memory))
        return mdp.to_action(env.scenario.robot, wanted).astype(jnp.float32), asked

    def one(rows: Rows, tick: Array) -> tuple[Rows, Seen]:
        said = say(network, agent, envs[0].observations, rows)
        each = [jax.vmap(ask, (None, None, 0))(*given) for given in zip(envs, teachers, rows.envs, strict=True)]
        wanted, asked = gather([wanted for wanted, _ in each]), tuple(states for _, states in each)
        action = jnp.where(alone, said.mean, wanted)
        turn = jax.random.fold_in(key, tick)
        rows, seen = step(envs, network, agent, replace(rows, envs=asked), said, action, turn)
        return rows, seen._replace(action=wanted, told={})

    return jax.lax.scan(one, rows, jnp.arange(steps, dtype=jnp.int32))
