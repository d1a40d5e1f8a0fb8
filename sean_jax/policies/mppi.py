"""mppi: model predictive path integral control among the people that the robot knows.

G. Williams et al., "Information theoretic MPC for model-based reinforcement learning", ICRA 2017: one round of samples
around the last plan, and their mean, weighted by exp(-cost / temperature). Plans, prediction of the robot and costs are
those of ``expert``, which samples in two rounds and adds constant arcs; people walk on at constant velocity.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Float

from sean_jax.core.data_types import Array, Policy, Scenario, State
from sean_jax.core.devices import parameter
from sean_jax.policies.expert import (
    MAX_PEOPLE,
    STEPS,
    TIME_STEP,
    ExpertParams,
    begin_search,
    expert,
    follow_plan,
    importance,
    plan_costs,
)
from sean_jax.policies.known_people import Sight, as_known, known_people, nobody
from sean_jax.policies.prediction import nearest_people, predict_straight
from sean_jax.policies.sensing_expert import SensingMemory

SAMPLES = 256


@struct.dataclass
class MppiParams(Sight):
    """Parameters of the controller; all leaves are () floats."""

    search: ExpertParams = struct.field(default_factory=ExpertParams)  # costs and temperature
    deviation: Float[Array, ""] = parameter(0.4)  # 1, of the samples, in shares of the limits
    control_cost: Float[Array, ""] = parameter(0.015)  # gamma of the paper; of Nav2's MPPI


def init(scenario: Scenario, params: MppiParams, state: State) -> SensingMemory:
    """Plans by model predictive path integral control (Williams et al., 2017), among visible people."""
    return SensingMemory(expert.init(scenario, params.search, state), nobody(state))


def apply(
    scenario: Scenario, params: MppiParams, state: State, key: Array
) -> tuple[Float[Array, "command"], SensingMemory]:
    """The command [m/s, rad/s] of the weighted mean of sampled plans, and the new memory."""
    memory: SensingMemory = state.policy_state
    people = known_people(scenario, params, state, memory.people)
    state = replace(as_known(state, people), policy_state=memory.search)
    motion = predict_straight(nearest_people(state, MAX_PEOPLE), STEPS, TIME_STEP)
    search = begin_search(scenario, params.search, state, motion)
    last = search.last_knots
    noise = params.deviation * jax.random.normal(key, (SAMPLES, *last.shape), float)
    plans = jnp.clip(last[None] + noise, -1.0, 1.0)
    mean = weighted_mean(params, last, plans, plan_costs(search, plans))
    command, search_memory = follow_plan(search, mean)
    return command, SensingMemory(search_memory, people)


def weighted_mean(
    params: MppiParams, last: Float[Array, "knots command"], plans: Float[Array, "P knots command"], costs: Array
) -> Float[Array, "knots command"]:
    """The mean of plans, weighted by their costs (P,) and the control cost gamma u S^-1 e of noise e around plan u."""
    noise = plans - last[None]
    control = params.control_cost * (last[None] * noise).sum((1, 2)) / jnp.square(params.deviation)
    weights = importance(costs + control, params.search.temperature)
    return last + (weights[:, None, None] * noise).sum(0)


mppi = Policy(params=MppiParams(), name="mppi", init=init, apply=apply, sensing="tracks")
"""The controller with its usual parameters; others by ``replace(mppi, params=...)``."""
