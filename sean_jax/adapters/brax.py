"""Brax's interface: ``reset(rng) -> State`` and ``step(State, action) -> State``, for its wrappers and trainers.

A completed or terminated episode has ``done`` and waits for a wrapper to reset it. The time limit is left to Brax's
``EpisodeWrapper``, whose trainers else would not bootstrap there: give them ``episode_length=env.episode_length``. A
longer episode is ``done`` in the step after. Observations are vectors, or with ``flat=False`` dicts.
"""

# pyright: reportMissingImports=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportInvalidTypeArguments=false

import warnings
from typing import Any

import jax
import jax.numpy as jnp
from brax.envs import base
from brax.training import pmap

from sean_jax import mdp, robots
from sean_jax.adapters import Functional
from sean_jax.core import clock
from sean_jax.core.data_types import Array
from sean_jax.core.random_streams import typed

REPLICATE = "device_put_replicated"
if REPLICATE in pmap.bcast_local_devices.__code__.co_names and not hasattr(jax, REPLICATE):
    warnings.warn(
        f"Brax's trainers PPO, SAC and APG call jax.{REPLICATE}, which jax {jax.__version__} does not have; "
        'docs/training.md, "Other projects", has the line that replaces it.',
        stacklevel=2,
    )


class SocialNavigation(Functional, base.Env):
    """A scenario as an environment of Brax."""

    def __init__(self, env: mdp.Env | str, flat: bool = True, **config: Any):
        """As ``Functional``, but observations are vectors, which Brax's networks take."""
        super().__init__(env, flat, **config)

    def reset(self, rng: Array) -> base.State:
        """Begin an episode; the PRNG key may be typed or not."""
        observation, state = self.env.reset(typed(rng))
        zero = jnp.zeros((), jnp.float32)
        metrics = {f"reward/{name}": zero for name, _ in self.env.rewards}
        metrics["completed"] = zero
        return base.State(state, self._shown(observation), zero, zero, metrics, {"truncation": zero})

    def step(self, state: base.State, action: Array) -> base.State:
        """The state after a control step, with all keys of ``metrics`` and ``info`` of the previous state."""
        before = state.pipeline_state
        after, observation, reward, terminated, truncated, info = self.env.advance(before, action)
        metrics = dict(state.metrics)
        for name, reward_term in info["rewards"].items():
            metrics[f"reward/{name}"] = reward_term.astype(jnp.float32)
        metrics["completed"] = info["completed"].astype(jnp.float32)
        return state.replace(
            pipeline_state=after,
            obs=self._shown(observation),
            reward=reward.astype(jnp.float32),
            done=(terminated | before.simulation.timed_out).astype(jnp.float32),
            metrics=metrics,
            info=state.info | {"truncation": truncated.astype(jnp.float32)},
        )

    @property
    def episode_length(self) -> int:
        """The time limit in steps."""
        return clock.ceil_ticks(self.env.scenario.time_limit, self.env.scenario.time_step)

    @property
    def observation_size(self) -> Any:
        """The size of an observation, or the shapes of its parts."""
        shapes = jax.eval_shape(self.reset, jax.random.key(0)).obs
        return shapes.shape[-1] if self.flat else {name: term.shape for name, term in shapes.items()}

    @property
    def action_size(self) -> int:
        """The size of an action."""
        return 2

    @property
    def backend(self) -> str:
        """The dynamics of the robot: twin, mjx or kinematic; own for a function of your own."""
        drive = self.env.scenario.robot.drive
        return next((name for name, dynamics in robots.DYNAMICS.items() if dynamics is drive), "own")
