"""Teams in other projects' interfaces for several agents: PettingZoo's and JaxMARL's, with the real packages."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax.adapters.multi_agent import TeamEnv
from sean_jax.core.data_types import Scenario
from sean_jax.simulation.scenario_stack import Stack


@pytest.fixture(scope="module")
def members() -> Stack[Scenario]:
    return sean_jax.make_team("lab", robots="kuri,kuri", behavior="random", people=4, time_limit=3.0)


@pytest.fixture(scope="module")
def env(members: Stack[Scenario]) -> TeamEnv:
    return TeamEnv(members)


@pytest.mark.night
def test_rewards_and_observations_are_of_each_robot(env: TeamEnv) -> None:
    """One robot drives and one stands; a robot moved before another one is among the people that this one observes."""
    step, state = env.jitted_step, env.jitted_reset(jax.random.key(1))
    observation = np.asarray(state.observation)
    assert observation.shape == (2, len(env.low))
    assert (np.asarray(env.low)[None] <= observation).all() and (observation <= np.asarray(env.high)[None]).all()
    total = np.zeros(2)
    for _ in range(10):
        state, result = step(state, jnp.array([[1.0, 0.0], [0.0, 0.0]]))
        total += np.asarray(result.reward)
    assert abs(float(state.states.robot.speed[0])) > 0.1 > abs(float(state.states.robot.speed[1]))
    assert total[0] != total[1]
    near = state.states.robot.position[0] + 0.9 * state.states.robot.heading[0]
    robot = state.states.robot.replace(position=state.states.robot.position.at[1].set(near))
    moved = state.replace(states=sean_jax.team.meet(state.states.replace(robot=robot)))
    shown, _ = step(moved, jnp.zeros((2, 2)))
    names = [name for name, _ in env.observations]
    assert "people" in names
    assert not np.allclose(shown.observation[0], step(state, jnp.zeros((2, 2)))[0].observation[0], atol=0.05)


def test_pettingzoo(env: TeamEnv) -> None:
    pytest.importorskip("pettingzoo")
    from pettingzoo.test import parallel_api_test, parallel_seed_test

    from sean_jax.adapters.pettingzoo import SocialNavigation

    shared, env = env, SocialNavigation(env, seed=0)
    parallel_api_test(env, num_cycles=70)
    parallel_seed_test(lambda: SocialNavigation(shared), num_cycles=20)
    first, _ = env.reset(seed=3)
    later, _ = env.reset()
    again, _ = env.reset(seed=3)
    assert env.agents == ["kuri_0", "kuri_1"]
    np.testing.assert_array_equal(first["kuri_1"], again["kuri_1"])
    assert not np.array_equal(first["kuri_1"], later["kuri_1"])
    cycles = 0
    while env.agents:
        *_, truncations, infos = env.step({name: env.action_space(name).sample() for name in env.agents})
        cycles += 1
    assert cycles == 30 and all(truncations.values()) and not infos["kuri_0"]["completed"]


def test_jaxmarl(members: Stack[Scenario]) -> None:
    pytest.importorskip("jaxmarl", exc_type=ImportError)
    from jaxmarl.environments.multi_agent_env import MultiAgentEnv
    from jaxmarl.wrappers.baselines import LogWrapper

    from sean_jax.adapters.jaxmarl import SocialNavigation

    env = SocialNavigation(members)
    assert isinstance(env, MultiAgentEnv) and env.num_agents == 2 and env.agents == ["kuri_0", "kuri_1"]
    wrapped = LogWrapper(env)
    keys = jax.random.split(jax.random.key(0), 3)
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        _, states = jax.vmap(wrapped.reset)(keys)

    def one(carry: tuple, key: jax.Array) -> tuple[tuple, tuple]:
        (state,) = carry
        actions = {name: env.action_space(name).sample(jax.random.fold_in(key, k)) for k, name in enumerate(env.agents)}
        observations, state, rewards, dones, infos = wrapped.step(key, state, actions)
        return (state,), (observations, rewards, dones, infos["returned_episode"])

    def episodes(state: object, key: jax.Array) -> tuple:
        return jax.lax.scan(one, (state,), jax.random.split(key, 65))[1]

    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):  # as the wrapper needs
        observations, rewards, dones, returned = jax.jit(jax.vmap(episodes))(states, keys)
    assert observations["kuri_0"].shape == (3, 65, *env.observation_space("kuri_0").shape)
    assert np.isfinite(rewards["kuri_1"]).all()
    np.testing.assert_array_equal(np.flatnonzero(dones["__all__"][0]), [29, 59])  # new episodes begin by themselves
    np.testing.assert_array_equal(dones["__all__"], dones["kuri_0"] & dones["kuri_1"])
    assert returned.any()
