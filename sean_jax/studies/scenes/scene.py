"""A scene: walls, gates, walkers and how long; together with a model of people it is a scenario without a task."""

import functools
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import pedestrian_models, prng, robots, social_forces
from sean_jax.base import Array, Pedestrians, Robot, RobotModel, Scenario, State
from sean_jax.config import DEFAULT_FORCES
from sean_jax.errors import InputError
from sean_jax.files import unknown_name
from sean_jax.social_forces import presets
from sean_jax.social_forces.forces import Forces, Term
from sean_jax.studies.scenes.floor_plan import environment
from sean_jax.studies.scenes.walkers import NEVER, Gate, Walkers, walkers_behavior

TIME_STEP = 0.1  # s
AWAY = 1e3  # m, where the robot of a scene without one stands
PEOPLE = 16, 64, 128, 256, 512, 1024, 2048, 4096  # sizes to which crowds are padded
GATES, LEGS = 32, 8  # sizes to which gates, and gates of one route, are padded


@dataclass(frozen=True)
class Scene:
    """What is simulated: a plan, people on it, and for how long."""

    walls: np.ndarray  # (W, 5) of ``floor_plan``
    walkers: Walkers  # N people
    gates: tuple[Gate, ...] = ()
    seconds: float = 60.0  # at most; it ends when everybody has vanished
    period: float | None = None  # m along x, of a periodic scene
    exits: tuple[int, ...] = ()  # gates between which people choose
    robot: tuple[tuple[float, float], tuple[float, float]] | None = None  # place [m] and velocity [m/s], constant
    seed: int = 0  # of what the simulation draws

    def robot_path(self, time: np.ndarray) -> np.ndarray:
        """(T, 2) m, where the robot is at times (T,) s; the origin without one."""
        place, velocity = (np.asarray(part, float) for part in self.robot or ((0.0, 0.0), (0.0, 0.0)))
        return place + np.asarray(time)[:, None] * velocity


@dataclass(frozen=True)
class Model:
    """How people move: forces, and the pedestrian model that uses them."""

    name: str
    forces: Forces
    move: Callable[[Scenario, State], Pedestrians]


def model(what: Any = None, name: str | None = None) -> Model:
    """A model of people by its name, of forces or of a function.

    Args:
        what: a key of ``PRESETS`` or of ``MODELS``, a YAML file of constants, terms, or a function (scenario, state) ->
            Pedestrians; the default forces if None. A function has the radii of the default forces.
        name: of the column in tables; by default that of the model.

    Raises:
        InputError: there is none of that name, or the terms do not make forces.
    """
    if what is None:
        what = DEFAULT_FORCES
    if isinstance(what, Model):
        return what
    if isinstance(what, str):
        if what in social_forces.PRESETS or presets.is_file(what):
            return Model(name or what, social_forces.build(what), social_forces.move)
        if what not in pedestrian_models.MODELS:
            raise InputError(unknown_name("model", what, {**social_forces.PRESETS, **pedestrian_models.MODELS}))
        return Model(name or what, social_forces.preset(DEFAULT_FORCES), pedestrian_models.MODELS[what])
    if isinstance(what, Iterable):
        terms: Iterable[Term] = what
        return Model(name or "forces", social_forces.build(terms), social_forces.move)
    if callable(what):
        function: Any = what
        return Model(name or getattr(what, "__name__", "model"), social_forces.preset(DEFAULT_FORCES), function)
    raise InputError(f"model: {what!r:.60} is no name, no list of terms and no function (scenario, state).")


@dataclass(frozen=True)
class Periodic:
    """A pedestrian model in a world that is periodic along x; equal for equal models, so that programs are shared.

    Each person has an image one period away, across the nearer seam: two people see each other over the shorter way if
    that is less than half a period. People are at x from 0 to the period; walls must go on for half a period at both
    ends.
    """

    move: Callable[[Scenario, State], Pedestrians]

    def __call__(self, scenario: Scenario, state: State) -> Pedestrians:
        """N people one control step later, none of whom walks in company."""
        people, period = state.pedestrians, scenario.behavior.data.period
        number = people.group.shape[0]
        side = jnp.where(people.position[:, 0] < 0.5 * period, period, -period)
        images = replace(people, position=people.position.at[:, 0].add(side))
        both = jax.tree.map(lambda one, other: jnp.concatenate([one, other]), people, images)
        after = self.move(replace(scenario, people=2 * number), replace(state, pedestrians=both))
        after = jax.tree.map(lambda leaf: leaf[:number], after)
        x = after.position[:, 0]
        return replace(after, position=after.position.at[:, 0].set(x - period * jnp.floor(x / period)))


@functools.cache
def _robot(x64: bool) -> RobotModel:
    return robots.load("kuri", "twin")


def scenario_of(scene: Scene, moved_by: Model | None = None, people: int | None = None) -> Scenario:
    """The scenario of a scene: people alone, without task, situations and metrics, padded to shared sizes.

    Args:
        moved_by: the default forces if None.
        people: N, to which the crowd is padded with absent people; the next of ``PEOPLE`` if None.

    Raises:
        InputError: a route names a gate that does not exist, or there are too many walls, gates or people.
    """
    chosen = model() if moved_by is None else moved_by
    number = len(scene.walkers.start)
    size = people or next((each for each in PEOPLE if each >= number), number)
    gates, table = np.zeros((GATES, 2, 2)), np.asarray([tuple(gate) for gate in scene.gates], float)
    route = np.asarray(scene.walkers.route)
    if len(scene.gates) > GATES or route.shape[1] > LEGS:
        raise InputError(f"gates: {len(scene.gates)}, of a route {route.shape[1]}; {GATES} and {LEGS} are the most.")
    if route.max(initial=-1) >= len(scene.gates):
        raise InputError(f"route: names gate {route.max()}, but there are {len(scene.gates)} gates.")
    gates[: len(table)] = table.reshape(-1, 2, 2)
    behavior = walkers_behavior(
        _padded(scene.walkers, size),
        gates,
        exits=scene.exits,
        period=scene.period or 0.0,  # pyright: ignore
    )
    forces, move = chosen.forces, chosen.move
    one: Any = jax.device_put(np.asarray(1.0, float))
    return Scenario(
        environment=environment(scene.walls),
        navigation=None,
        behavior=behavior,
        forces=forces,
        thresholds=None,
        goal_radius=one,
        hold_time=one,
        task_distance=one,
        robot=_robot(bool(jax.config.jax_enable_x64)),  # pyright: ignore[reportAttributeAccessIssue]
        task=_no_task,
        move=move if scene.period is None else Periodic(move),
        situations=(),
        metrics=(),
        time_step=TIME_STEP,
        time_limit=NEVER,
        people=size,
        substeps=social_forces.substeps(forces, TIME_STEP),
        task_name="",
    )


def stage(scenario: Scenario, scene: Scene) -> State:
    """The first state of a scene in its scenario, without a robot task."""
    place, velocity = scene.robot or ((AWAY, AWAY), (0.0, 0.0))
    return _first_state(
        scenario, prng.key("scene", scene.seed), jnp.asarray(place, float), jnp.asarray(velocity, float)
    )


@jax.jit
def _first_state(scenario: Scenario, key: Array, place: Array, velocity: Array) -> State:
    pedestrians, groups, memory = scenario.behavior.reset(scenario, key)
    speed = jnp.sqrt((velocity * velocity).sum())
    heading = jnp.where(speed > 0.0, velocity / jnp.where(speed > 0.0, speed, 1.0), jnp.asarray([1.0, 0.0], float))
    robot: Robot = replace(scenario.robot.place(scenario.robot, place, heading), speed=speed)
    nothing: Any = None
    return State(
        streams=prng.streams(key),
        tick=jnp.zeros((), jnp.int32),
        pedestrians=pedestrians,
        groups=groups,
        robot=robot,
        task=nothing,
        memory=memory,
        situations=jnp.zeros(0, bool),
        metrics={},
        ticks_at_goal=jnp.zeros((), jnp.int32),
        completed=jnp.zeros((), bool),
        timed_out=jnp.zeros((), bool),
    )


def _padded(people: Walkers, size: int) -> Walkers:
    """``size`` walkers; walkers beyond N never enter."""
    number = len(people.start)
    more = size - number
    if more < 0:
        raise InputError(f"people: {number} are more than {size}.")
    apart = AWAY + 2.0 * np.arange(more)[:, None] * np.array([1.0, 0.0])
    fill: dict[str, Any] = dict(
        start=apart,
        velocity=np.zeros((more, 2)),
        preferred_speed=np.ones(more),
        entry_time=np.full(more, NEVER),
        reaction_time=np.zeros(more),
        companion=np.full((more, 2), -1, np.int32),
    )
    parts = {name: np.concatenate([np.asarray(getattr(people, name)), rows]) for name, rows in fill.items()}
    route = np.full((size, LEGS), -1, np.int32)
    route[:number, : people.route.shape[1]] = people.route
    return Walkers(**parts, route=route)  # pyright: ignore[reportArgumentType]


def _no_task(*_: Any) -> None:
    raise InputError("task: a scene has none; a scenario of `make` has.")
