"""Interfaces of other projects to the same environments, each in its module, which imports that project's package."""

from collections.abc import Hashable, Mapping
from typing import Any

import jax
import numpy as np

from sean_jax import mdp
from sean_jax.core import random_streams
from sean_jax.core.data_types import Array
from sean_jax.core.errors import InputError
from sean_jax.drawing import view
from sean_jax.io.versions import fingerprint
from sean_jax.mdp import observations, registry
from sean_jax.simulation.scenario import frame

NAMESPACE = "sean"
"""What stands before the names of ``registry.ALL_ENVS`` in other projects' registries."""


def identity(env: mdp.Env) -> Hashable:
    """A hashable value that is equal for environments of the same parts and numbers, and for no others."""
    return jax.tree.structure(env), fingerprint(random_streams.as_numbers(env))


def load(env: mdp.Env | str, config: Mapping[str, Any]) -> mdp.Env:
    """An environment of ``make_env`` itself, or that of a name of ``registry.ALL_ENVS`` with fields of its description.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    if isinstance(env, str):
        return registry.load(env, config_overrides=config)
    if config:
        raise InputError(f"{next(iter(config))}: the environment is made already; give its name, or leave this out.")
    return env


class Functional:
    """Base of environments whose ``reset`` and ``step`` are pure functions of a state."""

    def __init__(self, env: mdp.Env | str, flat: bool = False, **config: Any):
        """An environment of ``make_env``, or a name of ``registry.ALL_ENVS`` with fields of its description.

        Args:
            flat: give observations as one vector, without images.

        Raises:
            InputError: one sentence that names the value and the cure.
        """
        self.env = load(env, config)
        self.flat = flat

    def _shown(self, observation: dict[str, Array]) -> Any:
        return observations.flatten(self.env.observations, observation) if self.flat else observation


def picture(env: mdp.Env, state: mdp.EnvState) -> np.ndarray:
    """A picture (height, width, 3) uint8 of the scenario from above."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    shown = frame(state.simulation, state.simulation, state.commands[0])
    canvas = FigureCanvasAgg(view(jax.tree.map(lambda leaf: leaf[None], shown), env.scenario))
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
