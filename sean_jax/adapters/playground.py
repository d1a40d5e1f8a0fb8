"""MuJoCo Playground's interface: ``load(name) -> MjxEnv``, for its wrappers, and for Brax's trainers with them.

Once this is imported, ``mujoco_playground.registry.load("sean/Lab-Random-RandomAbNav-v0")`` makes
``registry.ALL_ENVS``, too. The scenario stands for the MJX model, which a domain randomizer changes, and the state of
an episode for the MJX data. As in ``adapters.brax`` the time limit is left to the wrapper's ``episode_length``. The
wrapper repeats the start of each row; with ``full_reset=True`` episodes have new ones.
"""

# pyright: reportMissingImports=false, reportArgumentType=false, reportAttributeAccessIssue=false

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import jax
import mujoco
import numpy as np
from brax.envs import base
from ml_collections import ConfigDict
from mujoco_playground import MjxEnv, State, dm_control_suite

from sean_jax import adapters, mdp, robots
from sean_jax.adapters import brax
from sean_jax.core import clock
from sean_jax.core.data_types import Array, Scenario
from sean_jax.core.random_streams import typed
from sean_jax.mdp import registry
from sean_jax.robots import description

OF_TRAINERS = ("episode_length", "action_repeat", "impl")
"""Fields of a config that Playground's training scripts read or set, and that change no environment."""


def get_default_config(name: str) -> ConfigDict:
    """The options of an environment, one of ``registry.ALL_ENVS``, and its time limit in steps, ``episode_length``.

    Raises:
        InputError: there is no such name.
    """
    config = registry.get_default_config(name)
    length = clock.ceil_ticks(config.time_limit, config.time_step)
    return ConfigDict(config.model_dump(mode="json") | {"episode_length": length, "action_repeat": 1, "impl": "jax"})


class SocialNavigation(MjxEnv):
    """A scenario as an environment of MuJoCo Playground, with observations as one vector, without images."""

    def __init__(
        self,
        env: mdp.Env | str,
        config: ConfigDict | None = None,
        config_overrides: Mapping[str, Any] | None = None,
    ):
        """An environment of ``make_env``, or a name of ``registry.ALL_ENVS`` with its config.

        Args:
            config: of ``get_default_config``.
            config_overrides: field -> value, as of ``registry.load``.

        Raises:
            InputError: one sentence that names the value and the cure.
        """
        fields = ({} if config is None else config.to_dict()) | dict(config_overrides or {})
        self.env = adapters.load(env, {name: value for name, value in fields.items() if name not in OF_TRAINERS})
        self._mjx_model = self.env.scenario
        self._ctrl_dt = self._mjx_model.time_step
        self._sim_dt = self._mjx_model.robot.time_step

    @property
    def _brax(self) -> brax.SocialNavigation:
        return brax.SocialNavigation(replace(self.env, scenario=self._mjx_model))  # which the wrapper may have changed

    def reset(self, rng: Array) -> State:
        """Begin an episode; the PRNG key may be typed or not."""
        state = self._brax.reset(rng)
        return State(state.pipeline_state, state.obs, state.reward, state.done, state.metrics, state.info)

    def step(self, state: State, action: Array) -> State:
        """The state after a control step, with all keys of ``metrics`` and ``info`` of the previous state."""
        before = base.State(state.data, state.obs, state.reward, state.done, state.metrics, state.info)
        after = self._brax.step(before, action)
        return State(after.pipeline_state, after.obs, after.reward, after.done, after.metrics, after.info)

    @property
    def action_size(self) -> int:
        """The size of an action."""
        return 2

    @property
    def xml_path(self) -> str:
        """The robot's MJCF file."""
        return str(robots.find(self.env.scenario.robot.name))

    @property
    def mj_model(self) -> mujoco.MjModel:
        """The robot's MuJoCo model."""
        return description.read_robot(robots.find(self.env.scenario.robot.name))[0]

    @property
    def mjx_model(self) -> Scenario:
        """The scenario, which a domain randomizer changes."""
        return self._mjx_model

    def render(
        self, trajectory: Sequence[State] | State, height: int = 240, width: int = 320, *_: Any, **unused: Any
    ) -> list[np.ndarray] | np.ndarray:
        """Pictures from above, each (height, width, 3) uint8 but of a size of their own, of unbatched states."""
        if isinstance(trajectory, State):
            return adapters.picture(self.env, trajectory.data)
        return [adapters.picture(self.env, state.data) for state in trajectory]


def get_domain_randomizer(name: str) -> Callable[[Scenario, Array], tuple[Scenario, Scenario]]:
    """A function (scenario, PRNG keys (B,)) -> (B scenarios, their axes for ``vmap``) for Playground's
    ``randomization_fn``: people behave differently in each row, as of ``mdp.RANDOMIZATIONS``.

    Raises:
        InputError: there is no such name.
    """
    registry.get_default_config(name)
    return _randomize


def _randomize(model: Scenario, rng: Array) -> tuple[Scenario, Scenario]:
    randomization = mdp.RANDOMIZATIONS["behavior"]

    def draw(key: Array) -> Scenario:
        return randomization.apply(randomization.draw(key, model), model)

    keys = typed(rng)
    same = {id(leaf) for leaf in jax.tree.leaves(model)}
    axes = jax.tree.map(lambda leaf: None if id(leaf) in same else 0, draw(keys[0]))
    return jax.vmap(draw, out_axes=axes)(keys), axes


def load(name: str, config: ConfigDict | None = None, config_overrides: Mapping[str, Any] | None = None) -> MjxEnv:
    """An environment by its name, one of ``registry.ALL_ENVS``; as ``SocialNavigation``."""
    return SocialNavigation(name, config, config_overrides)


for _name in registry.ALL_ENVS:
    dm_control_suite.register_environment(  # its other suites download their robots first
        f"{adapters.NAMESPACE}/{_name}",
        functools.partial(SocialNavigation, _name),
        functools.partial(get_default_config, _name),
    )
