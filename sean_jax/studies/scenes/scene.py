"""Scenes: floor plans, walls, gates, walkers and duration; with a model of people a scene is a scenario without a task.

A floor plan is an array (W, 5) with a row for each box: center x and y, half extents along and across [m], yaw [rad].
Plans are joined by ``np.concatenate``.
"""

import functools
import itertools
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from sean_jax import robots, social_forces
from sean_jax.config import DEFAULT_FORCES
from sean_jax.core import random_streams
from sean_jax.core.data_types import (
    Array,
    Environment,
    ObstacleGrid,
    Obstacles,
    Pedestrians,
    Robot,
    RobotModel,
    Scenario,
    State,
)
from sean_jax.core.devices import to_device
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import build_obstacle_grid
from sean_jax.io.files import unknown_name
from sean_jax.people import pedestrian_models
from sean_jax.people.intent import Intent
from sean_jax.social_forces import presets
from sean_jax.social_forces.forces import Forces, Term
from sean_jax.studies.scenes.walkers import AWAY, NEVER, Gate, Point, Walkers, padded_size, walkers_behavior
from sean_jax.world.environment import plain_scenery

THIN = 0.02  # m, thickness of a wall that is drawn as a segment
THICK = 0.2  # m, of the walls around rooms and corridors, which lie outside them
HEIGHT = 2.5  # m
MARGIN = 1.0  # m of floor around the boxes
CELLS = 64  # of the grid along x and y: the same for all plans, so that they share programs
SIZES = (8, 16), (32, 128)  # obstacles near a cell, and obstacles: plans are padded to the first pair that is enough
FAR = 1e4  # m, where padding lies


def box(lower: Point, upper: Point) -> Float[np.ndarray, "1 5"]:
    """A box along x and y, from the corner with the smallest coordinates to the corner with the largest [m]."""
    low = np.asarray(lower, float)
    high = np.asarray(upper, float)
    center = (low + high) / 2
    half = (high - low) / 2
    return np.array([[*center, *half, 0.0]])


def wall(*points: Point) -> Float[np.ndarray, "W 5"]:
    """A thin wall (0.02 m) along a line of two or more points [m], a box for each segment."""
    rows = []
    for begin, end in itertools.pairwise(np.asarray(points, float)):
        center = (begin + end) / 2
        dx, dy = end - begin
        rows.append([*center, np.hypot(dx, dy) / 2, THIN / 2, np.arctan2(dy, dx)])
    return np.array(rows).reshape(-1, 5)


def room(lower: Point, upper: Point, doors: Iterable[tuple[Point, Point]] = ()) -> Float[np.ndarray, "W 5"]:
    """The four walls around a rectangle from ``lower`` to ``upper`` [m], with doors in them.

    Args:
        doors: the two ends of each opening, on a side of the rectangle [m].

    Raises:
        InputError: a door lies on no side.
    """
    x0, y0 = lower
    x1, y1 = upper

    # Walls lie outside of the rectangle, so that its free space is as large as asked for.
    sides = {
        ("x", x0): (x0 - THICK, x0),
        ("x", x1): (x1, x1 + THICK),
        ("y", y0): (y0 - THICK, y0),
        ("y", y1): (y1, y1 + THICK),
    }

    # A door belongs to a side by equal coordinates: rounded ones are refused, not moved.
    openings: dict[tuple[str, float], list[tuple[float, float]]] = {side: [] for side in sides}
    for (ax, ay), (bx, by) in doors:
        if ("x", ax) in openings and ax == bx:
            openings["x", ax].append((min(ay, by), max(ay, by)))
        elif ("y", ay) in openings and ay == by:
            openings["y", ay].append((min(ax, bx), max(ax, bx)))
        else:
            raise InputError(f"doors: {((ax, ay), (bx, by))} lies on no side of the room from {lower} to {upper}.")

    # Walls are what is left of a side between doors; the two along y have the corners as well.
    plan = []
    for (axis, coordinate), (inner, outer) in sides.items():
        begin = x0
        last = x1
        if axis == "x":
            begin = y0 - THICK
            last = y1 + THICK

        # A wall begins at the farthest end of the doors before it, because doors may overlap.
        for end, next_begin in [*sorted(openings[axis, coordinate]), (last, last)]:
            if end > begin and axis == "x":
                plan.append(box((inner, begin), (outer, end)))
            elif end > begin:
                plan.append(box((begin, inner), (end, outer)))
            begin = max(begin, next_begin)
    return np.concatenate(plan)


def corridor(length: float, width: float, margin: float = 0.0) -> Float[np.ndarray, "2 5"]:
    """The two walls of a corridor along x from (0, 0), y from 0 to the width [m], with open ends.

    Args:
        margin: extension of the walls at both ends [m]; half a period of a periodic corridor.
    """
    end = length + margin
    right = box((-margin, -THICK), (end, 0.0))
    left = box((-margin, width), (end, width + THICK))
    return np.concatenate([right, left])


def environment(plan: Float[np.ndarray, "W 5"]) -> Environment:
    """The environment of a plan (W, 5), open at its edges, on the default device.

    Arrays are padded with obstacles far away, so that most plans have equal shapes.

    Raises:
        InputError: there are too many boxes, in all or near one place.
    """
    plan = np.asarray(plan, float).reshape(-1, 5)

    # Half extents of the box around a rotated one: |R| times its own half extents.
    center = plan[:, :2]
    along, across, yaw = plan[:, 2:].T
    cosine = np.abs(np.cos(yaw))
    sine = np.abs(np.sin(yaw))
    reach_x = along * cosine + across * sine
    reach_y = along * sine + across * cosine
    reach = np.stack([reach_x, reach_y], 1)  # (W, 2) m

    # The origin is a point, too, so that a plan without boxes has a floor.
    origin = np.zeros((1, 2))
    corners = np.concatenate([center - reach, center + reach, origin])  # (2 W + 1, 2) m
    floor = np.concatenate([corners.min(0) - MARGIN, corners.max(0) + MARGIN])  # (4,) m
    grid = _grid(plan, floor)

    # Sizes go in steps, because every new shape of arrays compiles the simulation again.
    number = next((walls for near, walls in SIZES if near == grid.rows.shape[2] and walls >= len(plan)), None)
    if number is None:
        raise InputError(f"walls: {len(plan)} boxes are more than {SIZES[-1][1]}; use fewer and larger boxes.")

    # Padding lies so far away that no force and no ray reaches it.
    rows = np.zeros((number, 5))
    rows[:, :2] = FAR
    rows[:, 2:4] = 1.0
    rows[: len(plan)] = plan
    height = np.full(number, HEIGHT)
    arrays = to_device((rows[:, :2], rows[:, 2:4], rows[:, 4], height))
    obstacles = Obstacles(*arrays)

    # Plans have no outer walls: people may leave over the edge of the floor.
    return Environment(
        floor=to_device(floor),
        obstacles=obstacles,
        obstacle_grid=grid,
        scenery=plain_scenery(obstacles),
        name="scene",
        open=True,
    )


def _grid(plan: np.ndarray, floor: Any) -> ObstacleGrid:
    """The grid of obstacles with ``CELLS`` by ``CELLS`` cells and a padded number of rows in each."""
    height = np.full(len(plan), HEIGHT)
    obstacles = Obstacles(plan[:, :2], plan[:, 2:4], plan[:, 4], height)  # pyright: ignore
    cell = max(1.0, float((floor[2:] - floor[:2]).max()) / CELLS + 1e-6)
    grid = build_obstacle_grid(obstacles, floor, cell)
    rows = np.asarray(grid.rows)
    near = next((near for near, walls in SIZES if near >= rows.shape[2] and walls >= len(plan)), None)
    if near is None:
        raise InputError(f"walls: {rows.shape[2]} boxes of {len(plan)} lie near one place; use fewer and larger boxes.")
    padded = np.zeros((*rows.shape[:2], near, 6))
    padded[..., :2] = FAR
    padded[..., 4] = 1.0
    padded[:, :, : rows.shape[2]] = rows
    missing = [(0, CELLS - count) for count in rows.shape[:2]]
    padded = np.pad(padded, [*missing, (0, 0), (0, 0)], mode="edge")  # places off the floor have the rows of its edge
    return ObstacleGrid(*to_device((padded, np.asarray(grid.origin), np.asarray(grid.cell))))


# ------------------------------------------------------------------ scenes

TIME_STEP = 0.1  # s


@dataclass(frozen=True)
class Scene:
    """A simulation: a plan, people on it, and a duration."""

    walls: np.ndarray  # (W, 5) floor plan
    walkers: Walkers  # N people
    gates: tuple[Gate, ...] = ()
    seconds: float = 60.0  # at most; it ends when everybody has vanished
    period: float | None = None  # m along x, of a periodic scene
    exits: tuple[int, ...] = ()  # gates between which people choose
    robot: tuple[tuple[float, float], tuple[float, float]] | None = None  # place [m] and velocity [m/s], constant
    seed: int = 0  # of the random numbers of the simulation
    intent: Intent | None = None  # of all people; None: they turn to their gates at once

    def robot_path(self, time: np.ndarray) -> np.ndarray:
        """(T, 2) m, where the robot is at times (T,) s; the origin without one."""
        place, velocity = self.robot or ((0.0, 0.0), (0.0, 0.0))
        way = np.asarray(time)[:, None] * np.asarray(velocity, float)
        return np.asarray(place, float) + way


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
        name: of the column in tables; by default the model's.

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
    that is less than half a period. People are at x from 0 to the period; walls must extend by half a period at both
    ends.
    """

    move: Callable[[Scenario, State], Pedestrians]

    def __call__(self, scenario: Scenario, state: State) -> Pedestrians:
        """N people one control step later, none of whom walks in company."""
        people = state.pedestrians
        period = scenario.behavior.data.period
        number = people.group.shape[0]
        side = jnp.where(people.position[:, 0] < 0.5 * period, period, -period)
        images = replace(people, position=people.position.at[:, 0].add(side))
        both = jax.tree.map(lambda one, other: jnp.concatenate([one, other]), people, images)
        state = replace(state, pedestrians=both)
        after = self.move(replace(scenario, people=2 * number), state)

        # The images are dropped; who has left at one end comes in at the other.
        after = jax.tree.map(lambda leaf: leaf[:number], after)
        x = after.position[:, 0]
        x = x - period * jnp.floor(x / period)
        return replace(after, position=after.position.at[:, 0].set(x))


@functools.cache
def _robot(x64: bool) -> RobotModel:
    return robots.load("kuri")


def scenario_of(scene: Scene, moved_by: Model | None = None) -> Scenario:
    """The scenario of a scene: people alone, without task, situations and metrics, padded to shared sizes.

    Args:
        moved_by: the default forces if None.

    Raises:
        InputError: a route names a gate that does not exist, or there are too many walls, gates or people.
    """
    chosen = model() if moved_by is None else moved_by
    behavior = walkers_behavior(
        scene.walkers, scene.gates, exits=scene.exits, period=scene.period or 0.0, intent=scene.intent
    )
    move = chosen.move if scene.period is None else Periodic(chosen.move)
    forces = chosen.forces
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
        move=move,
        situations=(),
        metrics=(),
        time_step=TIME_STEP,
        time_limit=NEVER,
        people=padded_size(len(scene.walkers.start)),
        substeps=social_forces.substeps(forces, TIME_STEP),
        task_name="",
    )


def stage(scenario: Scenario, scene: Scene) -> State:
    """The first state of a scene in its scenario, without a robot task."""
    place, velocity = scene.robot or ((AWAY, AWAY), (0.0, 0.0))
    key = random_streams.key("scene", scene.seed)
    return first_state(scenario, key, jnp.asarray(place, float), jnp.asarray(velocity, float))


@jax.jit
def first_state(scenario: Scenario, key: Array, place: Array, velocity: Array) -> State:
    """The first state with a robot at a place [m], at a velocity [m/s]."""
    pedestrians, groups, memory = scenario.behavior.reset(scenario, key)
    traits_key = jax.random.fold_in(key, random_streams.TRAITS)
    pedestrians = social_forces.individualize(scenario.forces, pedestrians, traits_key)

    # A robot that stands looks along x.
    speed = jnp.sqrt((velocity * velocity).sum())
    direction = velocity / jnp.where(speed > 0.0, speed, 1.0)
    heading = jnp.where(speed > 0.0, direction, jnp.asarray([1.0, 0.0], float))
    robot: Robot = scenario.robot.place(scenario.robot, place, heading)
    robot = replace(robot, speed=speed)
    nothing: Any = None
    return State(
        streams=random_streams.streams(key),
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


def _no_task(*_: Any) -> None:
    raise InputError("task: a scene has none; a scenario of `make` has.")
