"""rsl_rl's interface: its ``VecEnv``, whose tensors of PyTorch share memory with jax by DLPack.

Observations are a ``TensorDict``: ``policy`` is one vector, and images are beside it by their names. Row ``k`` with
seed ``s`` is the environment of ``adapters.gymnasium`` with seed ``s + k``; or it takes starts of ``Env.with_pool``.
"""

# The packages are a further extra, which the type checker may not have.
# pyright: reportMissingImports=false

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import torch
from jaxtyping import PyTree
from tensordict import TensorDict

from sean_jax import mdp
from sean_jax.adapters import load
from sean_jax.core import clock
from sean_jax.core.data_types import Array
from sean_jax.mdp import observations

Rows = tuple[mdp.EnvState, Array]
"""States (B, ...) and the number of each row's next episode."""


class VecSocialNavigation:
    """Many scenarios that step together, for ``OnPolicyRunner(VecSocialNavigation(...), config)``."""

    num_actions = 2

    def __init__(self, env: mdp.Env | str, num_envs: int = 1, seed: int = 0, **config: Any):
        """An environment of ``make_env``, or a name of ``registry.ALL_ENVS`` with fields of its description.

        Raises:
            InputError: one sentence that names the value and the cure.
        """
        self.env = load(env, config)
        self.num_envs = num_envs
        self.cfg = config
        scenario = self.env.scenario
        self.max_episode_length = clock.ceil_ticks(scenario.time_limit, scenario.time_step)
        self._keys = jax.vmap(jax.random.key)(seed + jnp.arange(num_envs, dtype=jnp.uint32))
        self._begin = jax.jit(self._first)
        self._advance = jax.jit(self._next)
        self._episodes = jnp.zeros(num_envs, jnp.int32)
        self.reset()
        self.device = self._observation["policy"].device

    def _first(self, keys: Array, episodes: Array) -> tuple[Rows, dict[str, Array]]:
        episode_keys = jax.vmap(jax.random.fold_in)(keys, episodes)
        observation, states = jax.vmap(self.env.reset)(episode_keys)
        return (states, episodes + 1), self._groups(observation)

    def _next(self, keys: Array, rows: Rows, actions: Array) -> tuple[Rows, dict[str, Array], dict[str, Array]]:
        states, episodes = rows
        next_keys = jax.vmap(jax.random.fold_in)(keys, episodes)
        observation, states, reward, terminated, truncated, info = jax.vmap(self.env.step)(next_keys, states, actions)
        done = terminated | truncated
        results = {
            "reward": reward.astype(jnp.float32),
            "done": done,
            "truncated": truncated,
            "completed": info["completed"].astype(jnp.float32),
        }
        return (states, episodes + done.astype(jnp.int32)), self._groups(observation), results

    def _groups(self, observation: dict[str, Array]) -> dict[str, Array]:
        """Observations (B, ...) as one vector, ``policy``, and images by their names."""
        terms = self.env.observations
        vector = jax.vmap(lambda row: observations.flatten(terms, row))(observation)
        groups = {"policy": vector.astype(jnp.float32)}
        for name, term in terms:
            if term.image:
                groups[name] = observation[name].astype(jnp.float32)
        return groups

    def reset(self) -> TensorDict:
        """The first observations (B, ...) of the next episode in each row."""
        (self._states, self._episodes), observation = self._begin(self._keys, self._episodes)
        self._observation = TensorDict(_tensors(observation), batch_size=[self.num_envs])
        return self._observation

    def get_observations(self) -> TensorDict:
        """The latest observations (B, ...)."""
        return self._observation

    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """One step of control in each row, of actions (B, 2) from -1 to 1.

        Returns:
            The observations, of the next episode where one ended; rewards and whether an episode ended (B,); and a
            dict: whether by its time limit, ``time_outs`` (B,), and in ``log`` the share of completed ones.
        """
        actions = jax.dlpack.from_dlpack(actions.detach().contiguous())
        rows = self._states, self._episodes
        (self._states, self._episodes), observation, results = self._advance(self._keys, rows, actions)
        self._observation = TensorDict(_tensors(observation), batch_size=[self.num_envs])
        results = _tensors(results)
        extras = {"time_outs": results["truncated"], "log": {"/completed": results["completed"][results["done"]]}}
        return self._observation, results["reward"], results["done"], extras

    @property
    def episode_length_buf(self) -> torch.Tensor:
        """(B,) steps of each row's episode so far; set, they count towards its time limit."""
        return torch.from_dlpack(self._states.simulation.tick)

    @episode_length_buf.setter
    def episode_length_buf(self, steps: torch.Tensor) -> None:
        tick = jnp.asarray(jax.dlpack.from_dlpack(steps.contiguous()), jnp.int32)
        simulation = replace(self._states.simulation, tick=tick)
        self._states = replace(self._states, simulation=simulation, episode_length=tick)


def _tensors(arrays: PyTree) -> PyTree:
    return jax.tree.map(torch.from_dlpack, arrays)
