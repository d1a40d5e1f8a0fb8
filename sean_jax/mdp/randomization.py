"""Randomization of episodes: parameters drawn for each episode, and the scenario with them.

Parameters are leaves of the state of an episode, so they can be inspected and mutated (``learning.curriculum``).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Float, PyTree

from sean_jax import calls, files
from sean_jax.base import Array, Scenario
from sean_jax.errors import InputError
from sean_jax.graph import graph_of
from sean_jax.social_forces import Evasion, Repulsion, RobotRepulsion, Sidestep

MUTATION = 0.15  # of a parameter's range, standard deviation of a mutation


@runtime_checkable
class Randomization(Protocol):
    """Parameters of episodes, and how they change a scenario. It is static: equal ones have to compare equal."""

    def draw(self, key: Array, scenario: Scenario) -> PyTree:
        """The parameters of an episode."""
        ...

    def apply(self, parameters: PyTree, scenario: Scenario) -> Scenario:
        """The scenario of an episode with parameters of ``draw``; rebuilt in each step, so that a state need not hold
        it.
        """
        ...

    def mutate(self, key: Array, parameters: PyTree, scenario: Scenario) -> PyTree:
        """Parameters near others, which ``draw`` could have drawn."""
        ...


RandomizationLike = Randomization | Callable[[Array, Scenario], Scenario]
"""A ``Randomization``, or a function (key, scenario) -> scenario."""


@dataclass(frozen=True)
class OfKey:
    """A function (key, scenario) -> scenario: its parameter is the key, and a mutation is another key."""

    function: Callable[[Array, Scenario], Scenario]

    def draw(self, key: Array, scenario: Scenario) -> Array:
        """The key itself."""
        return key

    def apply(self, parameters: Array, scenario: Scenario) -> Scenario:
        """The function's scenario, of a key as parameters."""
        return calls.call("randomization", self.function, "key, scenario", parameters, scenario)

    def mutate(self, key: Array, parameters: Array, scenario: Scenario) -> Array:
        """Another key."""
        return key


# ------------------------------------------------------------------ how people behave


class Parameter(NamedTuple):
    """A parameter of how people behave."""

    apply: Callable[[Scenario, Array], Scenario]
    low: float
    high: float
    ratio: bool = True  # drawn evenly in the logarithm
    least: float = 0.0  # what bounds may be
    most: float = float("inf")
    of_waypoints: bool = False  # one number for each waypoint of the Behavior Graph


def _people(scenario: Scenario, value: Array) -> Scenario:
    """Share of the scenario's people who are present, at least one person."""
    people = jnp.asarray(scenario.people if scenario.people_present is None else scenario.people_present, jnp.int32)
    number = jnp.ceil(value * jnp.asarray(people, value.dtype) - 1e-4).astype(jnp.int32)
    return replace(scenario, people_present=jnp.clip(number, jnp.minimum(1, people), people))


def _speed(scenario: Scenario, value: Array) -> Scenario:
    """Factor of the speeds that people prefer."""
    names = ("speed_mean", "speed_deviation", "speed_min", "speed_max")
    walking = scenario.forces.walking
    changed = {name: value * getattr(walking, name) for name in names}
    return replace(scenario, forces=scenario.forces.replace(walking=replace(walking, **changed)))


def _repulsion_strength(scenario: Scenario, value: Array) -> Scenario:
    """Factor of the strength of repulsion between people."""
    return _scaled(scenario, Repulsion, "strength", value)


def _repulsion_range(scenario: Scenario, value: Array) -> Scenario:
    """Factor of the distance at which they do."""
    return _scaled(scenario, Repulsion, "range", value)


def _evasion(scenario: Scenario, value: Array) -> Scenario:
    """Factor of the strength with which people step out of each other's way."""
    return _scaled(scenario, Evasion, "strength", value)


def _side(scenario: Scenario, value: Array) -> Scenario:
    """Factor of people's side preference; the other side if it is negative."""
    return _scaled(_scaled(scenario, Evasion, "side", value), Sidestep, "preference", value)


def _robot_distance(scenario: Scenario, value: Array) -> Scenario:
    """Factor of the distance that people add for a moving robot; 0: it is to them like a person."""
    term = scenario.forces.get(RobotRepulsion)
    if term is None:
        return scenario
    changed = {name: jnp.maximum(getattr(term, name), 1.0) ** value for name in ("factor_min", "factor_max")}
    return replace(scenario, forces=scenario.forces.replace(robot_repulsion=replace(term, **changed)))


def _stay(scenario: Scenario, value: Array) -> Scenario:
    """Factor of people's stays in groups of the Behavior Graph."""
    graph = graph_of(scenario)
    return scenario if graph is None else _with_graph(scenario, replace(graph, stay=value * graph.stay))


def _waypoints(scenario: Scenario, value: Float[Array, "Mw"]) -> Scenario:
    """Factors of the weights of waypoints of the Behavior Graph as goals."""
    graph = graph_of(scenario)
    if graph is None:
        return scenario
    node = jnp.where(graph.waypoints >= 0, graph.waypoints, graph.weight.shape[0])  # padding is dropped
    return _with_graph(scenario, replace(graph, weight=graph.weight.at[node].multiply(value, mode="drop")))


def _scaled(scenario: Scenario, kind: type, name: str, value: Array) -> Scenario:
    term = scenario.forces.get(kind)
    if term is None:
        return scenario
    changed = replace(term, **{name: value * getattr(term, name)})
    return replace(scenario, forces=scenario.forces.replace(**{kind.__name__.lower(): changed}))


def _with_graph(scenario: Scenario, graph: PyTree) -> Scenario:
    behavior = scenario.behavior
    data = replace(behavior.data, graph=graph) if hasattr(behavior.data, "graph") else graph
    return replace(scenario, behavior=replace(behavior, data=data))


PARAMETERS: Mapping[str, Parameter] = MappingProxyType({
    "people": Parameter(_people, 0.25, 1.0, ratio=False, most=1.0),
    "speed": Parameter(_speed, 0.6, 1.4, least=0.05, most=4.0),
    "repulsion_strength": Parameter(_repulsion_strength, 0.5, 2.0),
    "repulsion_range": Parameter(_repulsion_range, 0.7, 1.5, least=0.1),
    "evasion": Parameter(_evasion, 0.2, 1.5),
    "side": Parameter(_side, -2.0, 2.0, ratio=False, least=float("-inf")),
    "robot_distance": Parameter(_robot_distance, 0.0, 1.5, ratio=False),
    "stay": Parameter(_stay, 0.3, 3.0),
    "waypoints": Parameter(_waypoints, 0.2, 5.0, of_waypoints=True),
})  # fmt: skip
"""Parameters of people's behavior by name: factors of the scenario's values, with their usual bounds.

Contact between bodies is none of them: the time step of forces was chosen for it.
"""


@dataclass(frozen=True)
class BehaviorRandomization:
    """People behave differently in each episode. Made by ``randomize_behavior``."""

    bounds: tuple[tuple[str, float, float], ...]  # name in ``PARAMETERS``, least and greatest value

    def draw(self, key: Array, scenario: Scenario) -> dict[str, Array]:
        """Name -> number (), or (Mw,) of the waypoints."""
        drawn = {}
        for index, (name, low, high) in enumerate(self.bounds):
            at = jax.random.uniform(jax.random.fold_in(key, index), _shape(name, scenario), float)
            drawn[name] = _between(name, low, high, at)
        return drawn

    def apply(self, parameters: dict[str, Array], scenario: Scenario) -> Scenario:
        """The scenario of an episode; factors of missing parts have no effect."""
        for name, _, _ in self.bounds:
            scenario = PARAMETERS[name].apply(scenario, parameters[name])
        return scenario

    def mutate(self, key: Array, parameters: dict[str, Array], scenario: Scenario) -> dict[str, Array]:
        """Each parameter moves by a share of its range, and is reflected at its bounds."""
        mutated = {}
        for index, (name, low, high) in enumerate(self.bounds):
            shape = _shape(name, scenario)
            step = MUTATION * jax.random.normal(jax.random.fold_in(key, index), shape, float)
            at = jnp.abs(_share(name, low, high, parameters[name]) + step)
            mutated[name] = _between(name, low, high, jnp.clip(1.0 - jnp.abs(1.0 - at), 0.0, 1.0))
        return mutated


def _shape(name: str, scenario: Scenario) -> tuple[int, ...]:
    graph = graph_of(scenario)
    if not PARAMETERS[name].of_waypoints:
        return ()
    return (0 if graph is None else graph.waypoints.shape[0],)


def _logarithmic(name: str, low: float) -> bool:
    return PARAMETERS[name].ratio and low > 0.0


def _between(name: str, low: float, high: float, at: Array) -> Array:
    """The value at a share of the range."""
    value = low * (high / low) ** at if _logarithmic(name, low) else low + at * (high - low)
    return jnp.clip(value, low, high)


def _share(name: str, low: float, high: float, value: Array) -> Array:
    """The share of the range at a value."""
    if high == low:
        return jnp.zeros_like(value)
    if _logarithmic(name, low):
        return jnp.log(value / low) / jnp.log(high / low)
    return (value - low) / (high - low)


def randomize_behavior(**bounds: tuple[float, float]) -> BehaviorRandomization:
    """People behave differently in each episode: how many, how fast, how far from others and from the robot.

    Numbers are factors of the scenario's values: ``randomize_behavior(speed=(0.5, 2.0))``. They are drawn evenly
    between their bounds, most of them in the logarithm.

    Args:
        bounds: name in ``PARAMETERS`` -> least and greatest value; all of them with their usual bounds by default.

    Raises:
        InputError: there is no parameter of a name, or bounds are impossible.
    """
    ranges = bounds or {name: (each.low, each.high) for name, each in PARAMETERS.items()}
    for name, (low, high) in ranges.items():
        if name not in PARAMETERS:
            hint = files.suggest(name, PARAMETERS) or "."
            raise InputError(f"randomize_behavior: '{name}' is not one of {', '.join(PARAMETERS)}{hint}")
        least, most = PARAMETERS[name].least, PARAMETERS[name].most
        if not least <= low <= high <= most or not abs(low) + abs(high) < float("inf"):
            limits = f"{least:g} to {most:g}"
            raise InputError(f"randomize_behavior: {name} {low:g} to {high:g} must be a range within {limits}.")
    return BehaviorRandomization(tuple((name, float(low), float(high)) for name, (low, high) in ranges.items()))


RANDOMIZATIONS: Mapping[str, Randomization] = MappingProxyType({"behavior": randomize_behavior()})
"""Randomizations by name."""


def as_randomization(value: RandomizationLike | None) -> Randomization | None:
    """The randomization of a value: a ``Randomization``, a function (key, scenario) -> scenario, or None.

    Raises:
        InputError: it is none of these.
    """
    if value is None or isinstance(value, Randomization):
        return value
    if callable(value):
        return OfKey(value)
    raise InputError(f"randomization: {value!r:.60} is no function (key, scenario) -> scenario; give one.")
