"""A driver beside whom another one says what should be done: the labels of DAgger.

The robot goes where the driver takes it, so the states are the driver's own, mistakes included; what is recorded is the
other's command. (S. Ross et al., "A reduction of imitation learning and structured prediction to no-regret online
learning", AISTATS 2011.)
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Float, PyTree

from sean_jax.base import Array, Policy, PolicyLike, Scenario, State, as_policy


@struct.dataclass
class LabelledState:
    """What both remember of an episode, and the latest label."""

    driver: PyTree
    labeller: PyTree
    label: Float[Array, "2"]  # m/s, rad/s


def labelled(driver: PolicyLike, labeller: PolicyLike) -> Policy:
    """A policy that drives, with another one that labels.

    Args:
        driver: whose commands the robot takes.
        labeller: whose commands are the labels.

    Returns:
        The policy, named after the driver.
    """
    both = as_policy(driver), as_policy(labeller)
    return Policy(params=both, name=both[0].name, init=_init, apply=_apply)


def label(state: State) -> Float[Array, "2"]:
    """What the labeller would have done in the step that led to a state.

    Args:
        state: after a step of a ``labelled`` policy.

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
    command, driving = driver.apply(scenario, driver.params, of_driver, key)
    wanted, labelling = labeller.apply(scenario, labeller.params, of_labeller, label_key)
    return command, LabelledState(driving, labelling, jnp.asarray(wanted, state.robot.position.dtype))
