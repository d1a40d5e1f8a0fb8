"""Time of reinforcement learning: microseconds per step of each part of an update, and scenario-steps/s.

python benchmarks/training.py --scenarios 8192 --pool 4096
python benchmarks/training.py collect,update --scenarios 8192 --observations goal,path,distance,speeds,depth --bfloat16

Options are the options of ``sean train ppo``. Each part is one compiled call of ``--horizon`` steps:
``simulate`` is ``sean_jax.step``, alone, with the observation, and with the reward; ``advance`` has both; ``step`` adds
automatic restarts, ``collect`` the network, and ``update`` learning.
"""

import sys
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from timing import median

import sean_jax
from sean_jax import mdp
from sean_jax.config import PPOConfig, flags
from sean_jax.core.errors import InputError
from sean_jax.learning import reinforcement, rollouts
from sean_jax.learning.networks import init_agent
from sean_jax.mdp import observations, rewards
from sean_jax.simulation.scenario_stack import Stack

COMMAND = 0.3, 0.1  # m/s, rad/s
Step = Callable[[mdp.Env, mdp.EnvState], tuple[mdp.EnvState, Any]]  # the next state, and what is computed beside it


def repeated(step: Step, env: Stack[mdp.Env], states: mdp.EnvState, steps: int) -> Callable[[], Any]:
    """A call of so many steps of the batch; their results are summed, so that all are computed."""

    def run(env: Stack[mdp.Env], states: mdp.EnvState) -> tuple:
        def turn(carry: tuple, _: None) -> tuple[tuple, None]:
            states, total = carry
            states, results = env.vmap(step)(states)
            return (states, total + sum(leaf.sum(dtype=jnp.float32) for leaf in jax.tree.leaves(results))), None

        return jax.lax.scan(turn, (states, jnp.zeros(())), length=steps)[0]

    compiled = jax.jit(run)
    return lambda: compiled(env, states)


def simulated(env: mdp.Env, state: mdp.EnvState) -> mdp.EnvState:
    """The state of ``sean_jax.step`` alone."""
    after = sean_jax.step(env.scenario, state.simulation, jnp.array(COMMAND))
    return state.replace(simulation=after)  # pyright: ignore[reportAttributeAccessIssue]


def simulate(env: mdp.Env, state: mdp.EnvState) -> tuple[mdp.EnvState, Any]:
    """A step of the simulation."""
    return simulated(env, state), ()


def observe(env: mdp.Env, state: mdp.EnvState) -> tuple[mdp.EnvState, Any]:
    """A step of the simulation, and its observation."""
    after = simulated(env, state)
    observation, _ = observations.observe(env.observations, env.scenario, after.simulation, state.observed)
    return after, observation


def reward(env: mdp.Env, state: mdp.EnvState) -> tuple[mdp.EnvState, Any]:
    """A step of the simulation, and its reward."""
    after = simulated(env, state)
    now = rewards.potentials(env.rewards, env.scenario, after.simulation)
    step = state.simulation, after.simulation
    return after, rewards.of_step(env.rewards, env.scenario, *step, state.potentials, now)


def advance(env: mdp.Env, state: mdp.EnvState) -> tuple[mdp.EnvState, Any]:
    """A step with observation and reward."""
    state, observation, reward, *_ = env.advance(state, jnp.array(COMMAND))
    return state, (observation, reward)


def restart(env: mdp.Env, state: mdp.EnvState) -> tuple[mdp.EnvState, Any]:
    """A step with observation, reward and automatic restart."""
    observation, state, reward, *_ = env.step(jax.random.key(3), state, jnp.array(COMMAND))
    return state, (observation, reward)


def main(names: list[str], options: PPOConfig) -> None:
    """Print the table, of all parts or of some."""
    _, (env, *others), network = reinforcement.build(options)
    if others:
        raise InputError("environment: parts are timed in one environment; name one.")
    batch, steps = options.scenarios, options.horizon
    env = jax.jit(rollouts.with_pool, static_argnums=2)(env, jax.random.key(0), options.pool)
    agent = init_agent(network, env.member.observations, env.member.observation_space, jax.random.key(1))
    rows = jax.jit(rollouts.reset_envs, static_argnums=(1, 3))((env,), network, jax.random.key(2), batch)
    gather = jax.jit(rollouts.rollout, static_argnums=(1, 4))
    run = reinforcement.programs(options, network, reinforcement.device_layout(1))
    state = run.begin((env,), jax.tree.map(lambda part: part[None], agent))

    def update() -> Any:
        nonlocal state
        state, metrics = run.update((env,), state)
        return metrics

    stages = {
        "simulate": simulate,
        "simulate, observe": observe,
        "simulate, reward": reward,
        "advance": advance,
        "step": restart,
    }
    parts = {name: repeated(step, env, rows.envs[0], steps) for name, step in stages.items()}
    parts["collect"] = lambda: gather((env,), network, agent, rows, steps, jax.random.key(4))
    parts["update"] = update
    observed = ", ".join(dict(env.member.observations))
    print(f"{jax.devices()[0].device_kind}, {batch} scenarios, {steps} steps, {observed}")
    for name in names or parts:
        seconds = median(parts[name])
        print(f"{name:20} {1e6 * seconds / steps:9.0f} us a step {batch * steps / seconds / 1e6:7.2f} M/s", flush=True)


if __name__ == "__main__":
    words = sys.argv[1:]
    chosen = words.pop(0).split(",") if words and not words[0].startswith("-") else []
    main(chosen, flags.read(PPOConfig, flags.parse("train", PPOConfig, ["ppo", *words])))
