"""Environments for Stable-Baselines3, which has its own vector environments: ``VecEnv``.

Rows are scenarios of ``adapters.gymnasium``, which step together in one compiled call. What an algorithm reads when an
episode ends is there under the names it knows: ``terminal_observation``, ``TimeLimit.truncated`` (so that values are
bootstrapped at the time limit) and ``is_success``.
"""

# The package is a further extra, which the type checker may not have.
# pyright: reportMissingImports=false

from collections.abc import Sequence
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from sean_jax import mdp
from sean_jax.adapters.gymnasium import VectorSocialNavigation


class VecSocialNavigation(VecEnv):
    """Many scenarios that step together, for ``PPO("MultiInputPolicy", VecSocialNavigation(...))``."""

    def __init__(self, env: mdp.Env | str, num_envs: int = 1, **config: Any):
        """Environments of ``make_env``, or of a name of ``registry.ALL_ENVS`` with fields of its description.

        Raises:
            InputError: one sentence that names the value and the cure.
        """
        self.rows = VectorSocialNavigation(env, num_envs, **config)
        self.render_mode = None
        super().__init__(num_envs, self.rows.single_observation_space, self.rows.single_action_space)
        self._actions = np.zeros((num_envs, *self.rows.env.action_space.shape), np.float32)

    def reset(self) -> dict[str, np.ndarray]:
        """The first observations (B, ...) of an episode in each row, with the seeds of ``seed`` if there were any."""
        seeds = self._seeds if any(seed is not None for seed in self._seeds) else None
        observation, _ = self.rows.reset(seed=seeds)
        self._reset_seeds()
        return observation

    def step_async(self, actions: np.ndarray) -> None:
        """Store the actions from -1 to 1 for ``step_wait``."""
        self._actions = actions

    def step_wait(self) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """One step of control in each row: observations, rewards, whether an episode ended (B, ...), and a dict for
        each row.
        """
        observation, reward, terminated, truncated, info = self.rows.step(self._actions)
        done = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for row in np.flatnonzero(done):
            infos[row] = {
                "terminal_observation": {name: term[row] for name, term in info["final_obs"].items()},
                "TimeLimit.truncated": bool(truncated[row] and not terminated[row]),
                "is_success": bool(info["completed"][row]),
            }
        return observation, reward, done, infos

    def close(self) -> None:
        """Nothing is to be freed."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute, which all rows share."""
        return [getattr(self.rows, attr_name)] * len(self._rows(indices))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: the rows are one program.

        Raises:
            NotImplementedError: always.
        """
        raise NotImplementedError("rows of one program have no separate attributes; make another environment.")

    def env_method(self, method_name: str, *arguments: Any, indices: Any = None, **named: Any) -> list[Any]:
        """Refused: the rows are one program.

        Raises:
            NotImplementedError: always.
        """
        raise NotImplementedError("rows of one program have no separate methods; call the methods of .rows.")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """False for each row."""
        return [False] * len(self._rows(indices))

    def _rows(self, indices: int | Sequence[int] | None) -> Sequence[int]:
        if indices is None:
            return range(self.num_envs)
        return [indices] if isinstance(indices, int) else indices
