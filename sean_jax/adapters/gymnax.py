"""gymnax's interface (version 1): ``reset`` and ``step`` of one environment, with ``EnvParams`` beside the state.

Once this is imported, ``gymnax.make("sean/Lab-Random-RandomAbNav-v0")`` makes ``registry.ALL_ENVS``, too.
Observations are dicts, or with ``flat=True`` vectors, which gymnax's ``FlattenObservationWrapper`` needs. gymnax's own
``step`` computes a whole reset each time; this one takes the starts of ``Env.with_pool``, if it has them.
"""

# pyright: reportMissingImports=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportInvalidTypeArguments=false

import functools
from collections.abc import Hashable
from dataclasses import replace
from typing import Any

import gymnax
import jax
import numpy as np
from flax import struct
from gymnax.environments import spaces

from sean_jax.adapters import NAMESPACE, Functional, identity
from sean_jax.core.data_types import Array
from sean_jax.core.random_streams import typed
from sean_jax.mdp import EnvState, registry

gymnax_environment = gymnax.environments.environment


@struct.dataclass
class EnvParams(gymnax_environment.EnvParams):
    """The environment itself, whose leaves can be swept."""

    env: Any = None


class SocialNavigation(Functional, gymnax_environment.Environment[EnvState, EnvParams]):
    """A scenario as an environment of gymnax. Equal ones share the programs that gymnax compiles for each instance."""

    _supports_transition_gradients = True

    @functools.cached_property
    def _identity(self) -> Hashable:
        return identity(self.env)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SocialNavigation) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def _key(self) -> tuple:
        return type(self), self._identity, self.flat, self.transition_gradients_enabled

    @property
    def default_params(self) -> EnvParams:
        """The environment, and its time limit in steps."""
        scenario = self.env.scenario
        return EnvParams(max_steps_in_episode=round(scenario.time_limit / scenario.time_step), env=self.env)

    def reset_env(self, key: Array, params: EnvParams) -> tuple[Any, EnvState]:
        """Begin an episode; the PRNG key may be typed or not."""
        observation, state = params.env.reset(typed(key))
        return self._shown(observation), state

    @functools.partial(jax.jit, static_argnames=("self",))
    def step(
        self, key: Array, state: EnvState, action: Array, params: EnvParams | None = None
    ) -> tuple[Any, EnvState, Array, Array, Array, dict[Any, Any]]:
        """As ``Env.step``; the PRNG key may be typed or not."""
        env = (params or self.default_params).env
        env = replace(env, transition_gradients=self.transition_gradients_enabled)
        observation, state, reward, terminated, truncated, info = env.step(typed(key), state, action)
        info |= {"final_observation": self._shown(info["final_observation"]), **_ends(terminated, truncated)}
        return self._shown(observation), state, reward, terminated, truncated, info

    def step_env(
        self, key: Array, state: EnvState, action: Array, params: EnvParams
    ) -> tuple[Any, EnvState, Array, Array, dict[Any, Any]]:
        """One step of control without a reset: observation, state, reward, ``terminated``, and a dict."""
        state, observation, reward, terminated, truncated, info = params.env.advance(state, action)
        return self._shown(observation), state, reward, terminated, info | _ends(terminated, truncated)

    def is_truncated(self, state: EnvState, params: EnvParams) -> Array:
        """Whether the time limit has passed, () bool."""
        return state.simulation.timed_out

    def is_terminated(self, state: EnvState, params: EnvParams) -> Array:
        """Whether the task is completed, () bool."""
        return state.simulation.completed

    @property
    def num_actions(self) -> int:
        """The size of an action."""
        return self.env.action_space.shape[0]

    def action_space(self, params: EnvParams | None = None) -> spaces.Box:
        """A box from -1 to 1."""
        return spaces.Box(-1.0, 1.0, self.env.action_space.shape)

    def observation_space(self, params: EnvParams | None = None) -> spaces.Dict | spaces.Box:
        """A box for each term, or one box for a flat observation."""
        boxes = self.env.observation_space.items()
        if not self.flat:
            return spaces.Dict({name: spaces.Box(box.low, box.high, box.shape) for name, box in boxes})
        low = self._shown({name: np.full(box.shape, box.low) for name, box in boxes})
        high = self._shown({name: np.full(box.shape, box.high) for name, box in boxes})
        return spaces.Box(low, high, low.shape)


def _ends(terminated: Array, truncated: Array) -> dict[str, Array]:
    return {"terminated": terminated, "truncated": truncated}


for _name in registry.ALL_ENVS:
    if f"{NAMESPACE}/{_name}" not in gymnax.registered_envs:
        gymnax.register(f"{NAMESPACE}/{_name}", functools.partial(SocialNavigation, _name))
