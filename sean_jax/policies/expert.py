"""expert: a model-predictive controller that drives as a polite person would; stands in for the human of section V.

The paper's learned policies imitate a human who steers through SEAN. Here a plan of the next seconds is searched for in
every control step: the robot by its limits (``unicycle``), people by the project's social forces (``prediction``), what
is minded in ``manners``, and how far it still is by shortest paths (``outlook``). The search is a sampling one: spread
wide around the last plan and over plain arcs, then narrow around the best, whose weighted mean is driven (G. Williams
et al., "Information theoretic MPC for model-based reinforcement learning", ICRA 2017, with those two rounds). It is
told more than a robot's sensors tell: where people want to go. A control step takes some three million operations.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from sean_jax.base import Array, Driver, Scenario, State
from sean_jax.geometry import length
from sean_jax.policies import manners
from sean_jax.policies.outlook import Outlook, look, onward, remaining
from sean_jax.policies.prediction import nearest_people, predict
from sean_jax.policies.unicycle import backward, constant, over_ground, roll

STEPS, STEP = 16, 0.2  # of a plan, and s of each: 3.2 s ahead
KNOTS = 5  # commands of a plan, joined by straight lines
WIDE, CLOSE = 48, 48  # samples of the two rounds
SPREAD = (0.5, 0.15)  # of the limits: standard deviations in the two rounds
PEOPLE = 8  # that are heeded
QUICK = 2.0  # rad/s, beyond which it does not turn
SWIFT = 1.5  # m/s, beyond which it does not drive among people
LATE = 40.0  # m, for places from where no way is seen
NEARER = 0.3  # m
FIRST = 1e6  # m, more than any way
FORWARD = (-0.4, 0.0, 0.35, 0.7, 1.0)  # of the limits: plain arcs
AROUND = (-1.0, -0.5, -0.2, 0.0, 0.2, 0.5, 1.0)


@struct.dataclass
class Settings:
    """What makes the expert the driver that it is; all leaves are () floats."""

    weights: manners.Weights
    halfway: Array  # 1, weight of the way that is left in the middle of a plan; at its end it is 1
    stop: Array  # m from the goal, where it is reached
    temperature: Array  # of the weighted mean
    patience: Array  # s without getting nearer, after which it asks for half the personal space


class Plan(NamedTuple):
    """What the expert remembers."""

    knots: Array  # (KNOTS, 2) shares of the limits
    follows: Array  # (V,) int32, of ``outlook.onward``
    nearest: Array  # () m, the way that was left when it last got nearer
    waited: Array  # () int32 ticks since then


def settings() -> Settings:
    """The expert's settings."""
    weights = manners.Weights(
        touch=constant(8.0),
        obstacle=constant(0.4),
        personal=constant(1.5),
        o_space=constant(1.0),
        reverse=constant(1.0),
        turning=constant(0.03),
        change=constant(0.02),
        facing=constant(0.3),
    )
    return Settings(
        weights, halfway=constant(0.5), stop=constant(0.2), temperature=constant(0.05), patience=constant(10.0)
    )


def start(scenario: Scenario, data: Settings, state: State) -> Plan:
    """Plans seconds ahead by sampling, politely: people are predicted, and their distances and o-spaces kept."""
    knots = jnp.zeros((KNOTS, 2), float)
    return Plan(knots, onward(scenario, state), jnp.full((), FIRST, float), jnp.zeros((), jnp.int32))


def drive(scenario: Scenario, data: Settings, state: State, key: Array) -> tuple[Array, Plan]:
    """The command (2,) [m/s, rad/s] with which the best plan begins, and that plan."""
    most = limits(scenario)
    last = _later(state.driver.knots, scenario.time_step)
    moved = _moved(scenario, state, last[None], most)
    people = predict(scenario, nearest_people(state, PEOPLE), state.groups, STEPS, STEP)
    here = state.robot.position
    spots = [jnp.append(here[axis], moved[axis][STEPS // 4 - 1 :: STEPS // 4, 0]) for axis in (0, 1)]
    outlook = look(scenario, state, state.driver.follows, *spots)
    nearest, waited = _waited(scenario, data, state, outlook)
    pushing = data.weights.personal * data.patience / (data.patience + scenario.time_step * waited.astype(here.dtype))
    data = replace(data, weights=replace(data.weights, personal=pushing))

    def cost(knots: Array) -> Array:
        return _cost(scenario, data, state, outlook, people, _moved(scenario, state, knots, most))

    noise = jax.random.normal(key, (WIDE + CLOSE, KNOTS, 2), float)
    wide = jnp.clip(last[None] + SPREAD[0] * noise[:WIDE], -1.0, 1.0)
    wide = jnp.concatenate([last[None], wide, jnp.asarray(ARCS, float)])
    best = wide[jnp.argmin(cost(wide))]
    close = jnp.clip(best[None] + SPREAD[1] * noise[WIDE:], -1.0, 1.0)
    close = jnp.concatenate([best[None], close])
    price = cost(close)
    weight = jax.nn.softmax(-(price - jnp.min(price)) / data.temperature)
    knots = (weight[:, None, None] * close).sum(0)
    return _commands(knots[0], most), Plan(knots, state.driver.follows, nearest, waited)


def _waited(scenario: Scenario, data: Settings, state: State, outlook: Outlook) -> tuple[Array, Array]:
    """() m left when it last got nearer, by NEARER at least, and () int32 ticks since then, none at the goal.

    Two who are polite would else wait for each other for ever.
    """
    before, here = state.driver, state.robot.position
    left = jax.lax.stop_gradient(remaining(scenario, state, outlook, here[:1], here[1:])[0])
    left = jnp.where(jnp.isfinite(left), left, before.nearest)
    nearer = (left < before.nearest - NEARER) | (left < data.stop + NEARER)
    nearest = jnp.where(nearer, left, before.nearest)
    return nearest, jnp.where(nearer, 0, before.waited + 1)


def limits(scenario: Scenario) -> tuple[Array, Array, Array]:
    """() m/s ahead, () m/s backward and () rad/s that plans keep to."""
    model = scenario.robot
    ahead = jnp.minimum(model.max_speed, SWIFT)
    return ahead, jnp.minimum(backward(model), ahead), jnp.minimum(model.max_turn_rate, QUICK)


def _arcs() -> np.ndarray:
    """(A, KNOTS, 2) plain arcs, and turns on the spot after which it goes straight ahead."""
    arcs = [np.tile([ahead, turn], (KNOTS, 1)) for ahead in FORWARD for turn in AROUND]
    for turn in AROUND:
        first = np.tile([1.0, 0.0], (KNOTS, 1))
        first[:2] = 0.0, turn
        arcs.append(first)
    return np.stack(arcs)


ARCS = _arcs()
BETWEEN = np.stack([np.interp(np.arange(STEPS) * STEP, np.linspace(0, STEPS * STEP, KNOTS), one)
                    for one in np.eye(KNOTS)], -1)  # fmt: skip


def _later(knots: Array, seconds: float) -> Array:
    """The plan as it is when so much of it is over; its last command goes on."""
    share = seconds * (KNOTS - 1) / (STEPS * STEP)
    return knots + share * jnp.diff(knots, axis=0, append=knots[-1:])


def _commands(shares: Array, most: tuple) -> Array:
    """(..., 2) m/s and rad/s of the shares (..., 2) of the limits."""
    ahead, back, turn = most
    speed = jnp.where(shares[..., 0] > 0.0, ahead, back) * shares[..., 0]
    return jnp.stack([speed, turn * shares[..., 1]], -1)


def _moved(scenario: Scenario, state: State, knots: Array, most: tuple) -> tuple[Array, ...]:
    """x, y [m], yaw [rad] on the floor, speed [m/s] and turn rate [rad/s], (T, P), of plans (P, KNOTS, 2)."""
    commands = _commands(jnp.einsum("tk,pkc->tpc", jnp.asarray(BETWEEN), knots), most)
    robot = state.robot
    x, y, yaw, speed, turn = roll(
        scenario.robot, robot.speed, robot.turn_rate, (commands[..., 0], commands[..., 1]), STEP
    )
    x, y = over_ground(robot.position, robot.heading, x, y)
    return x, y, yaw + jnp.arctan2(robot.heading[1], robot.heading[0]), speed, turn


def _cost(scenario: Scenario, data: Settings, state: State, outlook: Outlook, people: tuple, moved: tuple) -> Array:
    """(P,) of trajectories (T, P): the way that is left, and what is minded on the way."""
    x, y, yaw, speed, turn = moved
    weights = data.weights
    rate = manners.obstacle_rate(scenario, weights, x, y) + manners.people_rate(scenario, weights, x, y, people)
    rate = rate + manners.group_rate(state, weights, x, y)
    rate = rate + manners.comfort_rate(weights, speed, turn, (state.robot.speed, state.robot.turn_rate), STEP)
    ends = [jnp.concatenate([part[STEPS // 2 - 1], part[-1]]) for part in (x, y)]
    left = remaining(scenario, state, outlook, *ends)
    left = jnp.maximum(jnp.where(jnp.isfinite(left), left, LATE) - data.stop, 0.0)
    half, end = jnp.split(left, 2)
    goal, look_at = state.task.goal, state.task.goal_heading
    near = jnp.clip(1.0 - length(goal[0] - x[-1], goal[1] - y[-1]) / 0.6, 0.0, 1.0)
    facing = 1.0 - (jnp.cos(yaw[-1]) * look_at[0] + jnp.sin(yaw[-1]) * look_at[1])
    return STEP * rate.sum(0) + data.halfway * half + end + weights.facing * near * facing


expert = Driver(data=settings(), name="expert", start=start, drive=drive)
"""The expert with its usual settings; others by ``replace(expert, data=...)``."""
