"""Rewards of the agent: terms, each a number of one step with a weight.

A term is a ``RewardTerm``, or a plain function (scenario, before, after) -> number of weight 1. A reward is a dict of
terms: names of ``REWARDS`` with their weights, and your own terms. The reward of a step is the sum of
weight times value. Terms that use what no sensor of a robot measures, such as hidden people, are
``privileged``: a simulator may use them to train, and a robot could not compute them.
"""

import dataclasses
import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Float

from sean_jax import metrics
from sean_jax.core import user_calls
from sean_jax.core.data_types import Array, Scenario, State
from sean_jax.core.errors import InputError, PartError
from sean_jax.core.geometry import length
from sean_jax.io import files
from sean_jax.metrics import proximity
from sean_jax.metrics.proximity import PERSONAL
from sean_jax.simulation.scenario import snapshot
from sean_jax.world import navigation

Reward = Callable[[Scenario, State, State], Array]  # (scenario, before, after) -> () number of the step
Potential = Callable[[Scenario, State], Array]  # (scenario, state) -> () number


@dataclasses.dataclass(frozen=True)
class RewardTerm:
    """A part of a reward: either a reward of each step, or a potential.

    Args:
        step: ``(scenario, before, after) -> number`` of a step.
        potential: ``(scenario, state) -> number``: the reward of a step is its increase. It is computed once per
            step, and does not change the optimal policy, except for the discount
            (A. Ng et al., "Policy invariance under reward transformations", ICML 1999).
        weight: factor of the number.
        privileged: it uses what the robot's sensors do not measure.
        definition: one sentence; from the function's docstring if empty.
    """

    step: Reward | None = None
    potential: Potential | None = None
    weight: float = 1.0
    privileged: bool = False
    definition: str = ""

    def __post_init__(self) -> None:
        if (self.step is None) == (self.potential is None):
            raise InputError("rewards: a term has either a reward of each step or a potential; give one of them.")
        if not self.definition:
            object.__setattr__(self, "definition", inspect.getdoc(self.step or self.potential) or "")


RewardLike = RewardTerm | Reward | float
"""A ``RewardTerm``, a function, or the weight of the term of that name."""

Terms = tuple[tuple[str, RewardTerm], ...]
"""Name and term, of each part of a reward."""


# ------------------------------------------------------------------ the task


def _minus_distance(scenario: Scenario, state: State) -> Array:
    """How much shorter the path that is left becomes, in metres along the shortest one."""
    left = navigation.geodesic(scenario.navigation, state.robot.position, state.task.goal, state.task.paths_to_goal)
    return -jnp.where(jnp.isfinite(left), left, 0.0)


def _completed(scenario: Scenario, before: State, after: State) -> Array:
    """One at the step that completes the task: the hold time has passed."""
    return (after.completed & ~before.completed).astype(float)


def _at_goal(scenario: Scenario, before: State, after: State) -> Array:
    """Seconds spent within the goal's radius."""
    return jnp.where(after.ticks_at_goal > 0, scenario.time_step, 0.0)


def _time(scenario: Scenario, before: State, after: State) -> Array:
    """Seconds that pass; give it a negative weight."""
    return jnp.asarray(scenario.time_step, float)


# ------------------------------------------------------------------ motion


def _acceleration(scenario: Scenario, before: State, after: State) -> Array:
    """Squared change of the speed, as a share of the top speed."""
    change = (after.robot.speed - before.robot.speed) / scenario.robot.max_speed
    return change * change


def _turn_acceleration(scenario: Scenario, before: State, after: State) -> Array:
    """Squared change of the turn rate, as a share of the greatest."""
    change = (after.robot.turn_rate - before.robot.turn_rate) / scenario.robot.max_turn_rate
    return change * change


def _reverse(scenario: Scenario, before: State, after: State) -> Array:
    """Metres that the robot drives backward."""
    return jnp.maximum(-after.robot.speed, 0.0) * scenario.time_step


# ------------------------------------------------------------------ people


def _personal_space(scenario: Scenario, before: State, after: State) -> Array:
    """Seconds within 1.2 m of people, each counted by the square of how deep: 1 at no distance, 0 at 1.2 m."""
    people = after.pedestrians
    x, y = (people.position - after.robot.position[None, :]).T
    depth = jnp.maximum(1.0 - length(x, y) / PERSONAL, 0.0)
    return jnp.where(people.present, depth * depth, 0.0).sum() * scenario.time_step


def _o_space(scenario: Scenario, before: State, after: State) -> Array:
    """Seconds inside the o-space of groups that the task has nothing to do with, by how deep."""
    groups = after.groups
    task = after.task
    x, y = (groups.center - after.robot.position[None, :]).T
    depth = jnp.maximum(1.0 - length(x, y) / jnp.maximum(groups.radius, 0.1), 0.0)
    number = jnp.arange(groups.present.shape[0], dtype=jnp.int32)
    other = groups.present & (number != task.start_group) & (number != task.goal_group)
    return jnp.where(other, depth, 0.0).sum() * scenario.time_step


def of_metric(name: str) -> RewardTerm:
    """Increase of a metric in a step: a term for counts and sums. It is privileged, since metrics read
    all people.

    Args:
        name: of a metric in ``METRICS``.

    Raises:
        InputError: there is no metric of that name.
    """
    if name in metrics.OF_TEAMS:
        return _of(metrics.OF_TEAMS[name])
    if name not in metrics.METRICS:
        hint = files.suggest(name, metrics.METRICS) or "."
        raise InputError(f"rewards: '{name}' is no metric, of {', '.join(metrics.METRICS)}{hint}")
    return _of(metrics.METRICS[name])


def _of(metric: metrics.Metric) -> RewardTerm:
    return RewardTerm(step=_Growth(metric), privileged=True, definition=metric.definition)


@dataclasses.dataclass(frozen=True)
class _Growth:
    """``RewardTerm.step`` of a metric; equal for equal metrics."""

    metric: metrics.Metric

    def __call__(self, scenario: Scenario, before: State, after: State) -> Array:
        then, now = snapshot(scenario, before), snapshot(scenario, after)
        zero = self.metric.init(then)
        growth = self.metric.compute(self.metric.update(zero, then, now)) - self.metric.compute(zero)
        return growth.reshape(-1)[0]


def in_situations(term: RewardTerm, names: Sequence[str]) -> RewardTerm:
    """A term that counts only at steps that end in one of some social situations.

    Raises:
        InputError: the term has a potential, which cannot be counted at times.
    """
    if term.step is None:
        raise InputError("in_situations: a potential cannot count at times; give a term of each step.")
    return dataclasses.replace(term, step=_InSituations(term.step, tuple(names)), privileged=True)


@dataclasses.dataclass(frozen=True)
class _InSituations:
    step: Reward
    names: tuple[str, ...]

    def __call__(self, scenario: Scenario, before: State, after: State) -> Array:
        known = [name for name, _ in scenario.situations]
        for name in self.names:
            if name not in known:
                listed = ", ".join(known)
                raise InputError(f"in_situations: '{name}' is not one of {listed}{files.suggest(name, known) or '.'}")
        occurs = jnp.stack([after.situations[known.index(name)] for name in self.names]).any()
        return jnp.where(occurs, self.step(scenario, before, after), 0.0)


REWARDS: dict[str, RewardTerm] = {
    "progress": RewardTerm(potential=_minus_distance),
    "completed": RewardTerm(step=_completed),
    "at_goal": RewardTerm(step=_at_goal),
    "time": RewardTerm(step=_time),
    "acceleration": RewardTerm(step=_acceleration),
    "turn_acceleration": RewardTerm(step=_turn_acceleration),
    "reverse": RewardTerm(step=_reverse),
    "personal_space": RewardTerm(step=_personal_space, privileged=True),
    "o_space": RewardTerm(step=_o_space, privileged=True),
    "contact_time": _of(proximity.CONTACT_TIME),
    "obstacle_time": _of(proximity.OBSTACLE_TIME),
    "intimate_time": _of(proximity.INTIMATE_TIME),
    **{name: of_metric(name) for name, metric in metrics.METRICS.items() if metric.kind == "count"},
}
"""Terms of rewards by name; a term that counts has the name of the metric that counts the same."""

DEFAULT = {
    "progress": 1.0,
    "completed": 10.0,
    "time": -0.1,
    "acceleration": -0.1,
    "turn_acceleration": -0.05,
    "personal_space": -1.0,
    "o_space": -0.5,
    "intimate_robot_on_person": -20.0,
    "intimate_person_on_robot": -10.0,
    "collision_robot_on_person": -20.0,
    "collision_with_obstacle": -10.0,
    "contact_time": -10.0,
    "obstacle_time": -5.0,
    "intimate_time": -5.0,
}
"""The weights of the default reward: of contacts their number, and their time, so that none is worth keeping up."""


def as_terms(values: Mapping[str, RewardLike]) -> Terms:
    """The terms of a dict, in the same order.

    Args:
        values: name -> weight of the term of that name in ``REWARDS``, a ``RewardTerm``, or a function
            (scenario, before, after) -> number.

    Raises:
        InputError: there is none, or a value is none of these.
    """
    terms = tuple((name, _as_term(name, value)) for name, value in values.items())
    if not terms:
        raise InputError("rewards: there is none; give at least one, such as progress.")
    return terms


def _as_term(name: str, value: RewardLike) -> RewardTerm:
    if isinstance(value, RewardTerm):
        return value
    if isinstance(value, int | float) and not isinstance(value, bool):
        if name not in REWARDS:
            hint = files.suggest(name, REWARDS) or "."
            raise InputError(f"rewards: '{name}' is not one of {', '.join(REWARDS)}{hint}")
        return dataclasses.replace(REWARDS[name], weight=float(value))
    if callable(value):
        return RewardTerm(step=value)
    raise InputError(f"rewards: {name} is {value!r:.60}; give a weight, a RewardTerm, or a function.")


def weighted(values: Mapping[str, RewardLike], weights: Mapping[str, float]) -> Terms:
    """The terms of a dict, some with other weights; a weight of another term of ``REWARDS`` adds that term.

    Raises:
        InputError: as of ``as_terms``.
    """
    terms = dict(as_terms(values))
    for name, weight in weights.items():
        terms[name] = dataclasses.replace(terms.get(name) or _as_term(name, 1.0), weight=weight)
    return tuple(terms.items())


def reweighted(terms: Terms, weights: Mapping[str, Float[Array, ""] | float]) -> Terms:
    """The terms with other weights, which may be arrays inside a traced function.

    Raises:
        InputError: there is no such term.
    """
    for name in weights:
        if name not in dict(terms):
            raise InputError(f"rewards: '{name}' is not one of {', '.join(dict(terms))}; add it to the rewards first.")
    return tuple((name, dataclasses.replace(term, weight=weights.get(name, term.weight))) for name, term in terms)


def potentials(terms: Terms, scenario: Scenario, state: State) -> dict[str, Float[Array, ""]]:
    """Name -> potential () of a state, of the terms that have one."""
    return {
        name: _number(term.potential, "scenario, state", scenario, state)
        for name, term in terms
        if term.potential is not None
    }


def call(part: str, function: Callable, arguments: str, scenario: Scenario, *states: State) -> Any:
    """As ``user_calls.call``, of a function that may read a metric that the scenario leaves out."""
    try:
        return user_calls.call(part, function, arguments, scenario, *states)
    except PartError as error:
        missing = error.__cause__
        known = metrics.METRICS.keys() - dict(scenario.metrics).keys()
        if not isinstance(missing, KeyError) or missing.args[0] not in known:
            raise
        raise PartError(
            f"{str(error).removesuffix('.')}, a metric that is not measured here; "
            f"take mdp.of_metric('{missing.args[0]}')."
        ) from missing


def _number(function: Callable, arguments: str, scenario: Scenario, *states: State) -> Array:
    value = call("rewards", function, arguments, scenario, *states)
    user_calls.check_array("rewards", function, value, None, (), "give one number, by sum(), mean() or an index")
    return value


def of_step(
    terms: Terms, scenario: Scenario, before: State, after: State, then: dict[str, Array], now: dict[str, Array]
) -> dict[str, Float[Array, ""]]:
    """Name -> weight times number () of a step; their sum is the reward."""
    with jax.named_scope("reward"):
        numbers = {
            name: now[name] - then[name]
            if term.step is None
            else _number(term.step, "scenario, before, after", scenario, before, after)
            for name, term in terms
        }
        return {name: term.weight * jnp.asarray(numbers[name], float) for name, term in terms}
