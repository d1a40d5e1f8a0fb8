"""gymnax's interface (version 1): ``reset`` and ``step`` of one environment, with ``EnvParams`` beside the state.

gymnax's own ``step`` computes a whole reset each time; this one takes the starts of ``Env.with_pool``, if it has them.
"""

# pyright: reportMissingImports=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportInvalidTypeArguments=false

from dataclasses import replace
from typing import Any

import gymnax
import jax
from flax import struct
from gymnax.environments import spaces

from sean_jax import mdp, registry
from sean_jax.base import Array
from sean_jax.mdp import EnvState

gymnax_environment = gymnax.environments.environment


@struct.dataclass
class EnvParams(gymnax_environment.EnvParams):
    """The environment itself, whose leaves can be swept."""

    env: Any = None


class SocialNavigation(gymnax_environment.Environment[EnvState, EnvParams]):
    """A scenario as an environment of gymnax."""

    _supports_transition_gradients = True

    def __init__(self, env: mdp.Env | str, **config: Any):
        """Make the environment.

        Args:
            env: of ``make_env``, or a name of ``registry.ALL_ENVS``.
            config: of a name, fields of its description.

        Raises:
            InputError: one sentence that names the value and the cure.
        """
        self.env = registry.load(env, config_overrides=config) if isinstance(env, str) else env

    @property
    def default_params(self) -> EnvParams:
        """The environment, and its time limit in steps."""
        scenario = self.env.scenario
        return EnvParams(max_steps_in_episode=round(scenario.time_limit / scenario.time_step), env=self.env)

    def reset_env(self, key: Array, params: EnvParams) -> tuple[Any, EnvState]:
        """Begin an episode.

        Args:
            key: () PRNG key, typed or not.
            params: the environment.

        Returns:
            The observation and the state.
        """
        return params.env.reset(_typed(key))

    def step(
        self, key: Array, state: EnvState, action: Array, params: EnvParams | None = None
    ) -> tuple[Any, EnvState, Array, Array, Array, dict[Any, Any]]:
        """One step of control; what it gives at the end of an episode is the beginning of the next.

        Args:
            key: () PRNG key, typed or not.
            state: before the step.
            action: (2,) from -1 to 1.
            params: the environment.

        Returns:
            As ``Env.step``.
        """
        env = (params or self.default_params).env
        env = replace(env, transition_gradients=self.transition_gradients_enabled)
        observation, state, reward, terminated, truncated, info = env.step(_typed(key), state, action)
        return observation, state, reward, terminated, truncated, info | _ends(terminated, truncated)

    def step_env(
        self, key: Array, state: EnvState, action: Array, params: EnvParams
    ) -> tuple[Any, EnvState, Array, Array, dict[Any, Any]]:
        """One step of control without a reset.

        Args:
            key: unused; all chance comes from the state.
            state: before the step.
            action: (2,) from -1 to 1.
            params: the environment.

        Returns:
            The observation, the state, the reward, whether the episode is terminated, and a dict.
        """
        state, observation, reward, terminated, truncated, info = params.env.advance(state, action)
        return observation, state, reward, terminated, info | _ends(terminated, truncated)

    def is_truncated(self, state: EnvState, params: EnvParams) -> Array:
        """Whether the time limit has passed.

        Args:
            state: any.
            params: the environment.

        Returns:
            () bool.
        """
        return state.simulation.timed_out

    def is_terminated(self, state: EnvState, params: EnvParams) -> Array:
        """Whether the task is completed.

        Args:
            state: any.
            params: the environment.

        Returns:
            () bool.
        """
        return state.simulation.completed

    @property
    def num_actions(self) -> int:
        """Numbers of an action."""
        return 2

    def action_space(self, params: EnvParams | None = None) -> spaces.Box:
        """The values that actions may have.

        Args:
            params: unused.

        Returns:
            A box of (2,) from -1 to 1.
        """
        return spaces.Box(-1.0, 1.0, (2,))

    def observation_space(self, params: EnvParams | None = None) -> spaces.Dict:
        """The values that observations may have.

        Args:
            params: unused.

        Returns:
            A box for each term.
        """
        boxes = self.env.observation_space.items()
        return spaces.Dict({name: spaces.Box(box.low, box.high, box.shape) for name, box in boxes})


def _typed(key: Array) -> Array:
    return key if jax.numpy.issubdtype(key.dtype, jax.dtypes.prng_key) else jax.random.wrap_key_data(key)


def _ends(terminated: Array, truncated: Array) -> dict[str, Array]:
    return {"terminated": terminated, "truncated": truncated}
