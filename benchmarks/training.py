"""Time of reinforcement learning: microseconds per step of each part of an update, and scenario-steps/s.

python benchmarks/training.py --scenarios 8192 --pool 4096
python benchmarks/training.py collect,update --scenarios 8192 --observations goal,path,distance,speeds,depth --bfloat16

Options are the options of ``sean train ppo``. Each part is one compiled call of ``--horizon`` steps:
``simulate`` is ``sean_jax.step``, alone, with the observation, and with the reward; ``advance`` has both; ``step`` adds
automatic restarts, ``collect`` the network, and ``update`` learning.
"""

import sys
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

import sean_jax
from sean_jax import mdp
from sean_jax.config import PPOConfig, flags
from sean_jax.core.errors import InputError
from sean_jax.learning import reinforcement, rollouts
from sean_jax.learning.networks import init_agent
from sean_jax.mdp import observations, rewards
from sean_jax.simulation.scenario_stack import Stack


def seconds(call: Callable[[], Any], times: int = 3) -> float:
    """Median of several calls after compilation."""
    jax.block_until_ready(call())
    found = []
    for _ in range(times):
        begun = time.perf_counter()
        jax.block_until_ready(call())
        found.append(time.perf_counter() - begun)
    return sorted(found)[times // 2]


def main(names: list[str], options: PPOConfig) -> None:
    """Print the table, of all parts or of some."""
    _, (env, *others), network = reinforcement.build(options)
    if others:
        raise InputError("environment: parts are timed in one environment; name one.")
    batch, steps = options.scenarios, options.horizon
    env = jax.jit(rollouts.with_pool, static_argnums=2)(env, jax.random.key(0), options.pool)
    agent = init_agent(network, env.member.observations, env.member.observation_space, jax.random.key(1))
    rows = jax.jit(rollouts.reset_envs, static_argnums=(1, 3))((env,), network, jax.random.key(2), batch)
    keys = jax.random.split(jax.random.key(3), batch)
    command = jnp.array([0.3, 0.1])

    def repeated(one: Callable[[mdp.Env, mdp.EnvState], tuple[mdp.EnvState, Any]]) -> Callable[[], Any]:
        """``steps`` steps of the batch; their results are summed, so that all are computed."""

        def turn(env: Stack[mdp.Env], carry: tuple, key: Any) -> tuple[tuple, None]:
            state, given = env.vmap(one)(carry[0])
            return (state, carry[1] + sum(leaf.sum(dtype=jnp.float32) for leaf in jax.tree.leaves(given))), None

        def whole(env: Stack[mdp.Env], state: mdp.EnvState) -> tuple:
            return jax.lax.scan(lambda carry, key: turn(env, carry, key), (state, jnp.zeros(())), length=steps)[0]

        run = jax.jit(whole)
        return lambda: run(env, rows.envs[0])

    def simulate(env: mdp.Env, state: mdp.EnvState, of: str = "") -> tuple[mdp.EnvState, Any]:
        before, given = state.simulation, ()
        after = sean_jax.step(env.scenario, before, command)
        if of == "observation":
            given, _ = observations.observe(env.observations, env.scenario, after, state.observed)
        if of == "reward":
            now = rewards.potentials(env.rewards, env.scenario, after)
            given = rewards.of_step(env.rewards, env.scenario, before, after, state.potentials, now)
        return state.replace(simulation=after), given  # pyright: ignore[reportAttributeAccessIssue]

    def advance(env: mdp.Env, state: mdp.EnvState) -> tuple[mdp.EnvState, Any]:
        state, observation, reward, *_ = env.advance(state, command)
        return state, (observation, reward)

    def step(env: mdp.Env, state: mdp.EnvState) -> tuple[mdp.EnvState, Any]:
        observation, state, reward, *_ = env.step(keys[0], state, command)
        return state, (observation, reward)

    gather = jax.jit(rollouts.rollout, static_argnums=(1, 4))
    run = reinforcement.programs(options, network, reinforcement.device_layout(1))
    state = run.begin((env,), jax.tree.map(lambda part: part[None], agent))

    def update() -> Any:
        nonlocal state
        state, told = run.update((env,), state)
        return told

    parts = {
        "simulate": repeated(simulate),
        "simulate, observe": repeated(lambda env, state: simulate(env, state, "observation")),
        "simulate, reward": repeated(lambda env, state: simulate(env, state, "reward")),
        "advance": repeated(advance),
        "step": repeated(step),
        "collect": lambda: gather((env,), network, agent, rows, steps, jax.random.key(4)),
        "update": update,
    }
    print(
        f"{jax.devices()[0].device_kind}, {batch} scenarios, {steps} steps, {', '.join(dict(env.member.observations))}"
    )
    for name in names or parts:
        call = parts[name]
        took = seconds(call)
        print(f"{name:20} {1e6 * took / steps:9.0f} us a step {batch * steps / took / 1e6:7.2f} M/s", flush=True)


if __name__ == "__main__":
    words = sys.argv[1:]
    chosen = words.pop(0).split(",") if words and not words[0].startswith("-") else []
    main(chosen, flags.read(PPOConfig, flags.parse("train", PPOConfig, ["ppo", *words])))
