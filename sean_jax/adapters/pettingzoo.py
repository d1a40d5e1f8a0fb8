"""PettingZoo's parallel interface: a team of robots as a ``ParallelEnv`` of numpy arrays.

Episode ``n`` after ``reset(seed=s)`` is drawn from ``fold_in(key(s), n)``. An agent is left out of ``agents`` once its
episode has ended; its robot stands until the episodes of all have ended.
"""

# pyright: reportMissingImports=false

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
from gymnasium import spaces
from pettingzoo.utils.env import ParallelEnv

from sean_jax.adapters.multi_agent import TeamEnv, TeamState
from sean_jax.core.data_types import Scenario
from sean_jax.core.errors import InputError
from sean_jax.simulation.scenario_stack import Stack


class SocialNavigation(ParallelEnv[str, np.ndarray, np.ndarray]):
    """A team as a parallel environment of PettingZoo."""

    metadata = {"name": "sean_v0", "render_modes": []}
    render_mode = None

    def __init__(self, members: Stack[Scenario] | TeamEnv, seed: int | None = None, **options: Any):
        """An environment of ``make_team``; ``observations`` and ``rewards`` are the options of ``TeamEnv``.

        Environments of one ``TeamEnv`` share its compiled programs.

        Args:
            seed: until ``reset`` gets one; drawn if None.

        Raises:
            InputError: one sentence that names the value and the cure.
        """
        self.env = members if isinstance(members, TeamEnv) else TeamEnv(members, **options)
        self.possible_agents = list(self.env.agents)
        self.agents: list[str] = []
        self.observation_spaces = {}
        self.action_spaces = {}
        for name in self.possible_agents:
            low = np.asarray(self.env.low, np.float32)
            high = np.asarray(self.env.high, np.float32)
            self.observation_spaces[name] = spaces.Box(low, high)
            self.action_spaces[name] = spaces.Box(-1.0, 1.0, self.env.action_space.shape, np.float32)
        self._seed = int(np.random.default_rng(seed).integers(2**31)) if seed is None else seed
        self._episode = 0
        self._state: TeamState | None = None

    def observation_space(self, agent: str) -> spaces.Space[np.ndarray]:
        """A box of the size of an observation."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[np.ndarray]:
        """A box from -1 to 1, of the size of ``mdp.action_space``."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, dict]]:
        """Begin an episode: the next one, or the first one of a seed."""
        if seed is not None:
            self._seed = seed
            self._episode = 0
        state = self.env.jitted_reset(jax.random.fold_in(jax.random.key(self._seed), self._episode))
        self._state = state
        self._episode += 1
        self.agents = list(self.possible_agents)
        observations = dict(zip(self.agents, np.asarray(state.observation, np.float32), strict=True))
        return observations, {name: {} for name in self.agents}

    def step(self, actions: Mapping[str, np.ndarray]) -> tuple[dict, dict, dict, dict, dict]:
        """One step of control: observations, rewards, terminations, truncations and infos by agent.

        Raises:
            InputError: no episode has begun.
        """
        if self._state is None:
            raise InputError("step: no episode has begun; call reset first.")
        rows = np.zeros((len(self.possible_agents), *self.env.action_space.shape), np.float32)
        for number, name in enumerate(self.possible_agents):
            if name in actions and name in self.agents:
                rows[number] = actions[name]
        state, result = self.env.jitted_step(self._state, rows)
        self._state = state

        # Only agents whose episode goes on, or ends with this step, have results.
        observation, (reward, terminated, truncated, info) = jax.tree.map(np.asarray, (state.observation, result))
        observations: dict[str, np.ndarray] = {}
        rewards: dict[str, float] = {}
        terminations: dict[str, bool] = {}
        truncations: dict[str, bool] = {}
        infos: dict[str, dict[str, Any]] = {}
        for number, name in enumerate(self.possible_agents):
            if name in self.agents:
                observations[name] = observation[number].astype(np.float32)
                rewards[name] = float(reward[number])
                terminations[name] = bool(terminated[number])
                truncations[name] = bool(truncated[number])
                infos[name] = {key: value[number] for key, value in info.items()}
        self.agents = [name for name in observations if not (terminations[name] or truncations[name])]
        return observations, rewards, terminations, truncations, infos

    def render(self) -> None:
        """Nothing is drawn."""

    def close(self) -> None:
        """Nothing is open."""
