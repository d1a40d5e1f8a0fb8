"""JaxMARL's interface: a team of robots as a ``MultiAgentEnv``, whose ``reset`` and ``step`` can be jitted and vmapped.

members = sean_jax.make_team("lab", robots="kuri,kuri", behavior="random")
env = SocialNavigation(members)
observations, state = env.reset(jax.random.key(0))
observations, state, rewards, dones, infos = env.step(key, state, actions)
"""

# pyright: reportMissingImports=false, reportIncompatibleMethodOverride=false

import functools
from typing import Any

import jax
from jaxmarl.environments.multi_agent_env import MultiAgentEnv
from jaxmarl.environments.spaces import Box

from sean_jax.adapters.multi_agent import TeamEnv, TeamState
from sean_jax.core.data_types import Array, Scenario
from sean_jax.core.random_streams import typed
from sean_jax.simulation.scenario_stack import Stack


class SocialNavigation(MultiAgentEnv):
    """A team as an environment of JaxMARL; ``step`` begins a new episode when those of all robots have ended."""

    def __init__(self, members: Stack[Scenario], **options: Any):
        """An environment of ``make_team``; ``observations`` and ``rewards`` are the options of ``TeamEnv``.

        Raises:
            InputError: one sentence that names the value and the cure.
        """
        self.env = TeamEnv(members, **options)
        super().__init__(num_agents=members.size)
        self.agents = self.env.agents
        self.observation_spaces = {
            name: Box(self.env.low, self.env.high, self.env.low.shape, self.env.low.dtype) for name in self.agents
        }
        self.action_spaces = {name: Box(-1.0, 1.0, self.env.action_space.shape) for name in self.agents}

    @property
    def name(self) -> str:
        """The name of the environment."""
        return "sean"

    @property
    def agent_classes(self) -> dict[str, list[str]]:
        """The agents, all of one class."""
        return {"robots": list(self.agents)}

    @functools.partial(jax.jit, static_argnums=0)
    def reset(self, key: Array) -> tuple[dict[str, Array], TeamState]:
        """Begin an episode; the PRNG key may be typed or not."""
        state = self.env.reset(typed(key))
        return self.get_obs(state), state

    def step_env(
        self, key: Array, state: TeamState, actions: dict[str, Array]
    ) -> tuple[dict[str, Array], TeamState, dict[str, Array], dict[str, Array], dict[str, Any]]:
        """One step of control without a reset; the chance of an episode comes from its state, not from the key."""
        state, result = self.env.step(state, self.env.rows(actions))
        over = result.terminated | result.truncated
        dones = self.env.by_agent(over) | {"__all__": over.all()}
        infos = {name: self.env.by_agent(values) for name, values in result.info.items()}
        return self.get_obs(state), state, self.env.by_agent(result.reward), dones, infos

    def get_obs(self, state: TeamState) -> dict[str, Array]:
        """The observation of each agent."""
        return self.env.by_agent(state.observation)

    def observation_space(self, agent: str) -> Box:
        """A box of the size of an observation."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Box:
        """A box from -1 to 1, of the size of ``mdp.action_space``."""
        return self.action_spaces[agent]
