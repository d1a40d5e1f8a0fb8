"""Randomization of episodes: parameters drawn for each episode, and the scenario with them.

Parameters are leaves of the state of an episode, so they can be inspected and mutated (``learning.curriculum``). A YAML
file, or a mapping, has the bounds of some of ``PARAMETERS``:

    people: [0.25, 1.0]
    robot.max_speed: [0.6, 1.2]
    sensors.drop_out: [0.0, 0.05]
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import pydantic
from jaxtyping import Float, PyTree

from sean_jax.config import Bounds, Range
from sean_jax.core import user_calls
from sean_jax.core.data_types import Array, Scenario
from sean_jax.core.errors import InputError
from sean_jax.graph import graph_of
from sean_jax.io import files
from sean_jax.sensors import DistanceErrors
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


RandomizationLike = Randomization | Callable[[Array, Scenario], Scenario] | Mapping[str, Any] | str | Path
"""A ``Randomization``, a function (key, scenario) -> scenario, bounds by name, a YAML file of them, or a name."""


@dataclass(frozen=True)
class OfKey:
    """A function (key, scenario) -> scenario: its parameter is the key, and a mutation is another key."""

    function: Callable[[Array, Scenario], Scenario]

    def draw(self, key: Array, scenario: Scenario) -> Array:
        """The key itself."""
        return key

    def apply(self, parameters: Array, scenario: Scenario) -> Scenario:
        """The function's scenario, of a key as parameters."""
        return user_calls.call("randomization", self.function, "key, scenario", parameters, scenario)

    def mutate(self, key: Array, parameters: Array, scenario: Scenario) -> Array:
        """Another key."""
        return key


# ------------------------------------------------------------------ parameters


class Parameter(NamedTuple):
    """A number that may differ between episodes."""

    apply: Callable[[Scenario, Array], Scenario]
    least: float = 0.0  # what bounds may be
    most: float = float("inf")
    ratio: bool = True  # drawn evenly in the logarithm
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


INSTEAD = {"max_deceleration": "max_acceleration", "max_reverse_speed": "max_speed"}  # of robots without the first


def _of_robot(name: str, scenario: Scenario, value: Array) -> Scenario:
    """Factor of a number of the robot."""
    model = scenario.robot
    usual = getattr(model, name) if getattr(model, name) is not None else getattr(model, INSTEAD[name])
    return replace(scenario, robot=replace(model, **{name: value * usual}))


def _of_sensors(name: str, scenario: Scenario, value: Array) -> Scenario:
    """An error of all sensors that measure distances."""
    none = jnp.zeros_like(value)
    change = {name: value}
    common = scenario.sensor_errors or DistanceErrors(none, none, none)
    sensors = tuple(
        replace(each, params=replace(each.params, **change)) if isinstance(each.params, DistanceErrors) else each
        for each in scenario.sensors
    )
    return replace(scenario, sensor_errors=replace(common, **change), sensors=sensors)


def _robot(name: str) -> Parameter:
    return Parameter(partial(_of_robot, name), least=0.05, most=20.0)


def _sensors(name: str, most: float) -> Parameter:
    return Parameter(partial(_of_sensors, name), most=most, ratio=False)


PARAMETERS: Mapping[str, Parameter] = MappingProxyType({
    "people": Parameter(_people, most=1.0, ratio=False),
    "speed": Parameter(_speed, least=0.05, most=4.0),
    "repulsion_strength": Parameter(_repulsion_strength),
    "repulsion_range": Parameter(_repulsion_range, least=0.1),
    "evasion": Parameter(_evasion),
    "side": Parameter(_side, least=float("-inf"), ratio=False),
    "robot_distance": Parameter(_robot_distance, ratio=False),
    "stay": Parameter(_stay),
    "waypoints": Parameter(_waypoints, of_waypoints=True),
    "robot.max_reverse_speed": _robot("max_reverse_speed"),  # before the numbers that stand in for it
    "robot.max_speed": _robot("max_speed"),
    "robot.max_turn_rate": _robot("max_turn_rate"),
    "robot.max_deceleration": _robot("max_deceleration"),
    "robot.max_acceleration": _robot("max_acceleration"),
    "robot.max_turn_acceleration": _robot("max_turn_acceleration"),
    "robot.radius": Parameter(partial(_of_robot, "radius"), least=0.05, most=1.0),  # paths are for its own width
    "robot.friction": _robot("friction"),
    "robot.servo_gain": _robot("servo_gain"),
    "robot.servo_torque": _robot("servo_torque"),
    "sensors.min_deviation": _sensors("min_deviation", 10.0),  # m
    "sensors.growth": _sensors("growth", 10.0),  # 1/m
    "sensors.drop_out": _sensors("drop_out", 1.0),  # share
})  # fmt: skip
"""Parameters by name, in the order in which they are applied: factors of the scenario's numbers, and the errors of
sensors themselves.

Contact between bodies is none of them: the time step of forces was chosen for it.
"""


@dataclass(frozen=True)
class ParameterRandomization:
    """Numbers of ``PARAMETERS`` are drawn between bounds for each episode. ``as_randomization`` makes one."""

    bounds: tuple[tuple[str, float, float], ...]  # name, least and greatest value, in the order of ``PARAMETERS``

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


class _File(pydantic.RootModel[dict[str, Range]]):
    """The content of a YAML file."""


def _problems(bounds: Mapping[str, Range]) -> Iterable[files.Problem]:
    """Unknown names and impossible bounds."""
    if not bounds:
        yield (), "there are no bounds; give some, such as people: [0.5, 1.0]"
    for name, (low, high) in bounds.items():
        if name not in PARAMETERS:
            yield (name,), f"is not one of {', '.join(PARAMETERS)}{files.suggest(name, PARAMETERS)}"
        elif not PARAMETERS[name].least <= low <= high <= PARAMETERS[name].most:
            limits = f"{PARAMETERS[name].least:g} to {PARAMETERS[name].most:g}"
            yield (name,), f"[{low:g}, {high:g}] must be a lesser and a greater number within {limits}"


def _of_bounds(bounds: Mapping[str, Range]) -> ParameterRandomization:
    pairs = ((name, bounds[name]) for name in PARAMETERS if name in bounds)
    return ParameterRandomization(tuple((name, float(low), float(high)) for name, (low, high) in pairs))


RANDOMIZATIONS: Mapping[str, ParameterRandomization] = MappingProxyType({
    "behavior": _of_bounds({
        "people": (0.25, 1.0),
        "speed": (0.6, 1.4),
        "repulsion_strength": (0.5, 2.0),
        "repulsion_range": (0.7, 1.5),
        "evasion": (0.2, 1.5),
        "side": (-2.0, 2.0),
        "robot_distance": (0.0, 1.5),
        "stay": (0.3, 3.0),
        "waypoints": (0.2, 5.0),
    }),
})  # fmt: skip
"""Randomizations by name: behavior, of how many people there are and how they behave."""


def as_randomization(value: RandomizationLike | Bounds | None) -> Randomization | None:
    """The randomization of a value: a ``Randomization``, a function (key, scenario) -> scenario, bounds by the names of
    ``PARAMETERS`` such as ``{"speed": (0.5, 2.0)}``, the path of a YAML file of them, a name, or None.

    Numbers are drawn evenly between their bounds, most of the factors in the logarithm.

    Raises:
        InputError: it is none of these, or bounds are impossible.
    """
    if isinstance(value, str | Path):
        if str(value) in RANDOMIZATIONS:
            return RANDOMIZATIONS[str(value)]
        if Path(value).suffix not in (".yaml", ".yml"):
            known = ", ".join(RANDOMIZATIONS)
            raise InputError(f"randomization: '{value}' is not one of {known}, nor a .yaml file with bounds.")
        return _of_bounds(files.load(Path(value), _File, lambda file: _problems(file.root)).root)
    if isinstance(value, Mapping):
        try:
            value = Bounds(**value)
        except InputError as error:
            raise InputError(f"randomization.{error}") from None
    if isinstance(value, Bounds):
        for keys, text in _problems(value.bounds):
            end = "" if text.endswith("?") else "."
            raise InputError(f"{'.'.join(('randomization', *map(str, keys)))}: {text}{end}")
        return _of_bounds(value.bounds)
    if value is None or isinstance(value, Randomization):
        return value
    if callable(value):
        return OfKey(value)
    raise InputError(f"randomization: {value!r:.60} is no function (key, scenario) -> scenario; give one.")
