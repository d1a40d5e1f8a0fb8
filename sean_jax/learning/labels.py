"""What should be done, where the robot does something else: labels of DAgger and of noisy demonstrations.

With ``labelled`` the robot goes where one driver takes it, so the states are that driver's own, mistakes included; what
is recorded is another's command (S. Ross et al., "A reduction of imitation learning and structured prediction to
no-regret online learning", AISTATS 2011). With ``disturbed`` a driver's commands reach the robot with noise, so it is
led astray and the driver shows the way back; what is recorded is the command without noise (M. Laskey et al., "DART:
Noise injection for robust imitation learning", CoRL 2017).
"""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Float, PyTree

from sean_jax import episodes
from sean_jax.base import Array, Policy, PolicyLike, Scenario, State, as_policy


@struct.dataclass
class LabelledState:
    """What both remember of an episode, and the latest label."""

    driver: PyTree
    labeller: PyTree
    label: Float[Array, "2"]  # m/s, rad/s


def labelled(driver: PolicyLike, labeller: PolicyLike) -> Policy:
    """A policy that drives, with another one that labels."""
    both = as_policy(driver), as_policy(labeller)
    return Policy(params=both, name=both[0].name, init=_init, apply=_apply)


def label(state: State) -> Float[Array, "2"]:
    """What should have been done in the step that led to a state.

    Args:
        state: after a step of a ``labelled`` or ``disturbed`` policy.

    Returns:
        (2,) m/s, rad/s.
    """
    return state.policy_state.label


def _init(scenario: Scenario, params: tuple[Policy, Policy], state: State) -> LabelledState:
    driver, labeller = (policy.init(scenario, policy.params, state) for policy in params)
    return LabelledState(driver, labeller, jnp.zeros(2, float))


def _apply(
    scenario: Scenario, params: tuple[Policy, Policy], state: State, key: Array
) -> tuple[Float[Array, "2"], LabelledState]:
    (driver, labeller), memory = params, state.policy_state
    of_driver, of_labeller = replace(state, policy_state=memory.driver), replace(state, policy_state=memory.labeller)
    label_key = jax.random.fold_in(key, 1)
    command, driving = episodes.command(scenario, driver, of_driver, key)
    wanted, labelling = episodes.command(scenario, labeller, of_labeller, label_key)
    return command, LabelledState(driving, labelling, wanted)


NOISE_TIME = 0.5  # s, for which the noise of commands stays about the same: shorter ones hardly move the robot


@struct.dataclass
class DisturbedState:
    """What the driver remembers of an episode, the noise, and the latest command without it."""

    driver: PyTree
    noise: Float[Array, "2"]  # of the robot's limits, in standard deviations
    label: Float[Array, "2"]  # m/s, rad/s


def disturbed(driver: PolicyLike, deviation: float) -> Policy:
    """A policy whose commands reach the robot with noise.

    Args:
        deviation: of the noise, as a share of the top speed and of the greatest turn rate.
    """
    one = as_policy(driver)
    params = one, jnp.asarray(deviation, float)
    return Policy(params=params, name=one.name, init=_init_disturbed, apply=_apply_disturbed)


def _init_disturbed(scenario: Scenario, params: tuple[Policy, Array], state: State) -> DisturbedState:
    driver, _ = params
    return DisturbedState(driver.init(scenario, driver.params, state), jnp.zeros(2, float), jnp.zeros(2, float))


def _apply_disturbed(
    scenario: Scenario, params: tuple[Policy, Array], state: State, key: Array
) -> tuple[Float[Array, "2"], DisturbedState]:
    (driver, deviation), memory = params, state.policy_state
    command, driving = episodes.command(scenario, driver, replace(state, policy_state=memory.driver), key)
    stays = math.exp(-scenario.time_step / NOISE_TIME)
    fresh = jax.random.normal(jax.random.fold_in(key, 1), (2,), memory.noise.dtype)
    noise = stays * memory.noise + math.sqrt(1.0 - stays * stays) * fresh
    limits = jnp.stack([scenario.robot.max_speed, scenario.robot.max_turn_rate]).astype(command.dtype)
    return command + deviation * limits * noise, DisturbedState(driving, noise, command)
