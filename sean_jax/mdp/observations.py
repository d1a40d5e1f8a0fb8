"""Observations of the agent: terms, each an array with bounds, in the robot's frame.

A term is an ``ObservationTerm``, or a plain function (scenario, state) -> array without bounds. An
observation is a dict of terms: names of ``OBSERVATIONS``, and your own terms. ``delayed`` delays a
term, and ``stacked`` gives its last readings together.
"""

import dataclasses
import functools
import inspect
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int, PyTree

from sean_jax import sensors
from sean_jax.core import user_calls
from sean_jax.core.data_types import SENSING, Array, Scenario, Sensor, State
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import from_rectangle, length, nearby_obstacles, rotate
from sean_jax.io import files
from sean_jax.mdp.spaces import Box
from sean_jax.robots.drive import max_reverse_speed
from sean_jax.world import navigation

NEAREST = 12  # people of the term "people"
REACH = 8.0  # m, range of the observation
SURFACES, NEAR = 3, 3.0  # of obstacles of the term "obstacles"; and m, within which they are shown
PLAN_POINTS, SPACING = 10, 0.5  # of the term "plan"; and m, at least, from one point to the next
MAX_SPEED = 3.0  # m/s, of people in an observation
FAR_GOAL = 30.0  # m, beyond which a goal looks as if it were so far
UNBOUNDED = 1e3  # bounds of a term that states none
IMAGE = {"width": 64, "height": 48}  # pixels, of images
FAR_DEPTH, FAR_LIDAR = 10.0, 6.0  # m, beyond which depth camera and lidar see nothing
RAYS = 72  # of the lidar


def _nothing(scenario: Scenario, state: State) -> tuple:
    return ()


@dataclasses.dataclass(frozen=True)
class ObservationTerm:
    """A part of an observation.

    Args:
        read: ``(scenario, state, prepared) -> array``, clipped to the bounds.
        low: least number of the array.
        high: greatest number of the array.
        prepare: ``(scenario, state) -> prepared``, computed once at the start of an episode.
        delay: of readings in steps of control, (least, most), drawn for each episode.
        stack: number of readings of different steps in an observation, newest first, along a first axis; 0 for one
            without that axis.
        every: steps of control from one reading of a stack to the next.
        people: whether it contains positions of people, for tables of agents.
        image: whether it is a picture, (height, width) or with colors, which ``flatten`` leaves out.
        sensing: knowledge of people that it needs, one of ``data_types.SENSING``.
    """

    read: Callable[[Scenario, State, Any], Array]
    low: float = -UNBOUNDED
    high: float = UNBOUNDED
    prepare: Callable[[Scenario, State], PyTree] = _nothing
    delay: tuple[int, int] = (0, 0)
    stack: int = 0
    every: int = 1
    people: bool = False
    image: bool = False
    sensing: str = "all-knowing"

    @property
    def definition(self) -> str:
        """One sentence about it."""
        return inspect.getdoc(getattr(self.read, "func", getattr(self.read, "function", self.read))) or ""

    @property
    def readings(self) -> int:
        """The number of readings that are stored."""
        return self.delay[1] + self.span

    @property
    def span(self) -> int:
        """The number of readings from the newest to the oldest of an observation."""
        return (max(self.stack, 1) - 1) * self.every + 1


ObservationLike = ObservationTerm | Callable[[Scenario, State], Array] | str
"""An ``ObservationTerm``, a function, or a name in ``OBSERVATIONS``."""


# ------------------------------------------------------------------ terms


def _in_frame(state: State, vectors: Array) -> Array:
    hx, hy = state.robot.heading[0], state.robot.heading[1]
    return jnp.stack(rotate(vectors[..., 0], vectors[..., 1], hx, -hy), -1)


def _shortened(vector: Array) -> Array:
    """A vector (2,) that is no longer than ``FAR_GOAL``."""
    distance = jnp.maximum(length(vector[0], vector[1]), FAR_GOAL)
    return vector * (FAR_GOAL / distance)


def _goal(scenario: Scenario, state: State, prepared: tuple) -> Array:
    """Where the goal is: (2,) m."""
    return _shortened(_in_frame(state, state.task.goal - state.robot.position))


def _goal_heading(scenario: Scenario, state: State, prepared: tuple) -> Array:
    """How the robot shall look at the goal: (2,) unit vector."""
    return _in_frame(state, state.task.goal_heading)


def _path(scenario: Scenario, state: State, prepared: tuple) -> Array:
    """The next corner of the shortest path, or the goal: (2,) m."""
    robot = state.robot
    task = state.task
    ahead = navigation.next_point(scenario.navigation, robot.position, task.goal, task.paths_to_goal)
    return _shortened(_in_frame(state, ahead - robot.position))


def _distance(scenario: Scenario, state: State, prepared: tuple) -> Array:
    """Length of the shortest path that is left: (1,) m."""
    robot = state.robot
    task = state.task
    remaining = navigation.geodesic(scenario.navigation, robot.position, task.goal, task.paths_to_goal)
    return remaining[None]


def _speeds(scenario: Scenario, state: State, prepared: tuple) -> Array:
    """The robot's speed and turn rate: (2,) m/s, rad/s; (3,) with the speed to the left of an omnidirectional robot in
    the middle, or with the steering angle [rad] of a car at the end.
    """
    robot = state.robot
    if scenario.robot.lateral is not None and robot.sideways is not None:
        return jnp.stack([robot.speed, robot.sideways, robot.turn_rate])
    if scenario.robot.steering is not None:
        return jnp.stack([robot.speed, robot.turn_rate, robot.drive_state.steering])
    return jnp.stack([robot.speed, robot.turn_rate])


def _robot(scenario: Scenario, state: State, prepared: tuple) -> Array:
    """The robot's radius, top speeds ahead and backward, acceleration, deceleration, top turn rate and turn
    acceleration: (7,) m, m/s, m/s2, rad/s, rad/s2.
    """
    model = scenario.robot
    radius = jnp.asarray(model.radius, float)
    reverse = max_reverse_speed(model)
    deceleration = model.max_acceleration if model.max_deceleration is None else model.max_deceleration
    driving = model.max_speed, reverse, model.max_acceleration, deceleration
    turning = model.max_turn_rate, model.max_turn_acceleration
    return jnp.stack([radius, *driving, *turning])


def _time(scenario: Scenario, state: State, prepared: tuple) -> Array:
    """Share of the time limit that has passed, and of the hold at the goal: (2,)."""
    time_step = scenario.time_step
    passed = state.tick.astype(float) * time_step / scenario.time_limit
    hold_time = jnp.maximum(scenario.hold_time, time_step)
    hold = state.ticks_at_goal.astype(float) * time_step / hold_time
    return jnp.stack([passed, hold])


def _hold(scenario: Scenario, state: State, prepared: tuple) -> Array:
    """Share of the hold time at the goal that has passed: (1,)."""
    return _time(scenario, state, prepared)[1:]


def _situations(scenario: Scenario, state: State, prepared: tuple) -> Array:
    """Which social situations occur: (S,) 0 or 1."""
    return state.situations.astype(float)


def people(nearest: int = NEAREST, reach: float = REACH, visible: bool = False) -> ObservationTerm:
    """The nearest people, the nearest first, within ``reach`` m.

    A term of (nearest, 5): a person's place (x ahead, y to the left) [m], velocity over the ground [m/s], and 1; all 0
    for nobody.

    Args:
        visible: leave out people to whom the straight line from the robot crosses an obstacle.
    """
    if visible:
        read, sensing = _visible_people, "tracks"
    else:
        read, sensing = _people, "all-knowing"
    read = functools.partial(read, nearest, reach)
    return ObservationTerm(read, -reach, reach, people=True, sensing=sensing)


def _visible_people(nearest: int, reach: float, scenario: Scenario, state: State, prepared: tuple) -> Array:
    """The nearest people without those behind obstacles: where, how fast and whether there is one, (k, 5) m, m/s and
    0 or 1.
    """
    rows = _people(nearest, reach, scenario, state, prepared)
    position = state.robot.position
    heading = state.robot.heading
    x, y = rotate(rows[:, 0], rows[:, 1], heading[0], heading[1])

    # The barrier keeps the places of people out of the loop over obstacles.
    ends = jax.lax.stop_gradient((position, position[0] + x, position[1] + y))
    position, x, y = jax.lax.optimization_barrier(ends)
    free = navigation.segments_are_free(scenario.environment.obstacles, position, x, y, 0.0)
    return jnp.where(free[:, None], rows, 0.0)


def _people(nearest: int, reach: float, scenario: Scenario, state: State, prepared: tuple) -> Array:
    """The nearest people: where, how fast and whether there is one, (k, 5) m, m/s and 0 or 1."""
    persons = state.pedestrians
    gap = persons.position - state.robot.position[None, :]  # (N, 2)
    square = jnp.where(persons.present, (gap * gap).sum(1), jnp.inf)
    count = min(nearest, square.shape[0])
    _, index = jax.lax.top_k(-square, count)
    visible = square[index] <= reach * reach

    # Rows beyond the reach, and those for which there is nobody, are 0.
    velocity = _in_frame(state, persons.velocity[index])
    velocity = jnp.clip(velocity, -MAX_SPEED, MAX_SPEED)
    position = _in_frame(state, gap[index])
    presence = jnp.ones((count, 1), float)
    rows = jnp.concatenate([position, velocity, presence], 1)  # (count, 5)
    rows = jnp.where(visible[:, None], rows, 0.0)
    return jnp.pad(rows, ((0, nearest - count), (0, 0)))


def _obstacles(scenario: Scenario, state: State, prepared: tuple) -> Array:
    """The nearest obstacles within 3 m: direction (0 for none) and distance of each, (3, 3) of a unit vector and m."""
    x, y = state.robot.position[0], state.robot.position[1]
    rectangles = nearby_obstacles(scenario.environment.obstacle_grid, x, y)  # (R, 6)
    columns = (rectangles[:, column] for column in range(6))
    distance, nx, ny = from_rectangle(x, y, *columns)
    count = min(SURFACES, len(distance))
    negative, index = jax.lax.top_k(-distance, count)
    visible = -negative < NEAR

    normal = jnp.stack([nx[index], ny[index]], -1)  # which points to the robot
    direction = _in_frame(state, -normal)
    direction = jnp.where(visible[:, None], direction, 0.0)
    shown_distance = jnp.minimum(-negative, NEAR)
    rows = jnp.concatenate([direction, shown_distance[:, None]], 1)
    missing = jnp.tile(jnp.array([[0.0, 0.0, NEAR]], float), (SURFACES - count, 1))
    return jnp.concatenate([rows, missing])


def plan_ahead(scenario: Scenario, state: State, last_arc: Int[Array, "V"]) -> Float[Array, "10 2"]:
    """The next points of the shortest path, as a global planner gives them (section V-B): (10, 2) m.

    Args:
        last_arc: ``navigation.last_arc_to_goal`` of the goal of the task.
    """
    where = state.robot.position, state.task.goal, state.task.paths_to_goal, last_arc
    ahead = navigation.plan(scenario.navigation, *where, points=PLAN_POINTS, apart=SPACING)
    return _in_frame(state, ahead - state.robot.position[None, :])


def _last_arc(scenario: Scenario, state: State) -> Array:
    return navigation.last_arc_to_goal(scenario.navigation, state.task.goal)


def sensor(name: str, low: float, high: float, image: bool = False) -> ObservationTerm:
    """The reading of one of ``scenario.sensors``, with its noise."""
    return ObservationTerm(functools.partial(_sensor, name), low, high, image=image, sensing="raw")


def _sensor(name: str, scenario: Scenario, state: State, prepared: tuple) -> Array:
    """The reading of a sensor of the scenario."""
    devices = {device.name: device for device in scenario.sensors}
    if name not in devices:
        names = ", ".join(devices) or "none"
        raise InputError(f"observations: the scenario has no sensor '{name}', but {names}; give make that sensor.")
    return _reading(scenario, state, devices[name])


def _reading(scenario: Scenario, state: State, device: Sensor) -> Array:
    return sensors.sense(dataclasses.replace(scenario, sensors=(device,)), state)[device.name]


def _depth(scenario: Scenario, state: State, prepared: tuple) -> Array:
    """The robot's depth camera, with the scenario's errors: (height, width) m."""
    camera = sensors.camera(scenario, "depth", **IMAGE, far=FAR_DEPTH)
    return _reading(scenario, state, sensors.depth_sensor(camera))


def _rgb(scenario: Scenario, state: State, prepared: tuple) -> Array:
    """The robot's color camera that looks ahead: (height, width, 3) from 0 to 1."""
    return sensors.render(scenario, state, sensors.camera(scenario, "first_person", **IMAGE)).rgb


def _lidar(scenario: Scenario, state: State, prepared: tuple) -> Array:
    """The robot's lidar, with the scenario's errors: (rays,) m."""
    return _reading(scenario, state, sensors.lidar_sensor(sensors.lidar(scenario, count=RAYS, far=FAR_LIDAR)))


def _rings(scenario: Scenario, state: State, prepared: tuple) -> Array:
    """The robot's lidar with the rings of a VLP-16, with the scenario's errors: (16, 72) m."""
    device = sensors.lidar(scenario, count=RAYS, far=FAR_LIDAR, elevations=sensors.VLP16["elevations"])
    return _reading(scenario, state, sensors.lidar_sensor(device))


def _lidar_stack(scenario: Scenario, state: State, prepared: tuple) -> Array:
    """The last four scans of the robot's lidar, the newest first, with the scenario's errors: (4, rays) m."""
    return _lidar(scenario, state, prepared)


_sensed = functools.partial(ObservationTerm, sensing="raw")

OBSERVATIONS: dict[str, ObservationTerm] = {
    "goal": _sensed(_goal, -FAR_GOAL, FAR_GOAL),
    "goal_heading": _sensed(_goal_heading, -1.0, 1.0),
    "path": _sensed(_path, -FAR_GOAL, FAR_GOAL),
    "distance": _sensed(_distance, 0.0, 10 * FAR_GOAL),
    "speeds": _sensed(_speeds, -10.0, 10.0),
    "robot": _sensed(_robot, 0.0, 100.0),
    "time": _sensed(_time, 0.0, 1.0),
    "hold": _sensed(_hold, 0.0, 1.0),
    "situations": ObservationTerm(_situations, 0.0, 1.0),
    "people": people(),
    "visible_people": people(visible=True),
    "obstacles": _sensed(_obstacles, -NEAR, NEAR),
    "plan": _sensed(plan_ahead, -PLAN_POINTS * SPACING, PLAN_POINTS * SPACING, prepare=_last_arc),
    "lidar": _sensed(_lidar, 0.0, FAR_LIDAR),
    "lidar_rings": _sensed(_rings, 0.0, FAR_LIDAR),
    "lidar_stack": _sensed(_lidar_stack, 0.0, FAR_LIDAR, stack=4),
    "depth": _sensed(_depth, 0.0, FAR_DEPTH, image=True),
    "rgb": _sensed(_rgb, 0.0, 1.0, image=True),
}
"""Terms of observations by name."""


# ------------------------------------------------------------------ dicts of terms

Terms = tuple[tuple[str, ObservationTerm], ...]
"""Name and term, of each part of an observation."""


def sensing(terms: Terms) -> str:
    """The class of a policy that reads these terms, one of ``data_types.SENSING``."""
    needed = {term.sensing for _, term in terms}
    return next(knowledge for knowledge in SENSING if knowledge == "raw" or knowledge in needed)


def delayed(term: ObservationLike, least: int, most: int | None = None) -> ObservationTerm:
    """A term with delayed readings, ``least`` to ``most`` steps of control, drawn for each episode; ``least`` if
    ``most`` is None.

    Raises:
        InputError: it would show the future.
    """
    most = least if most is None else most
    if not 0 <= least <= most:
        raise InputError(f"delay: {least} to {most} steps must be a lesser and a greater number, 0 or more.")
    return dataclasses.replace(as_term(term), delay=(least, most))


def with_delays(terms: Terms, delays: Mapping[str, tuple[int, int]]) -> Terms:
    """Terms of which some are ``delayed``: name -> least and largest delay.

    Raises:
        InputError: a name is of none of the terms.
    """
    for name in delays:
        if name not in dict(terms):
            raise InputError(files.unknown_name("observation_delay", name, dict(terms)))
    return tuple((name, delayed(term, *delays[name]) if name in delays else term) for name, term in terms)


def stacked(term: ObservationLike, number: int) -> ObservationTerm:
    """A term of the last readings together, (number, ...), newest first.

    Raises:
        InputError: there is no reading.
    """
    if number < 1:
        raise InputError(f"stack: {number} readings show nothing; give 1 or more.")
    return dataclasses.replace(as_term(term), stack=number)


def as_term(value: ObservationLike) -> ObservationTerm:
    """The term of a value: an ``ObservationTerm``, a function (scenario, state) -> array, or a name in
    ``OBSERVATIONS``.

    Raises:
        InputError: it is none of these.
    """
    if isinstance(value, ObservationTerm):
        return value
    if isinstance(value, str):
        if value in OBSERVATIONS:
            return OBSERVATIONS[value]
        known = ", ".join(OBSERVATIONS)
        raise InputError(f"observations: '{value}' is not one of {known}{files.suggest(value, OBSERVATIONS) or '.'}")
    if callable(value):
        return ObservationTerm(_Plain(value))
    raise InputError(f"observations: {value!r:.60} must be a term, a function (scenario, state), or a name.")


@dataclasses.dataclass(frozen=True)
class _Plain:
    """``ObservationTerm.read`` of a function of two arguments; equal for equal functions."""

    function: Callable[[Scenario, State], Array]
    arguments = "scenario, state"

    def __call__(self, scenario: Scenario, state: State, prepared: tuple) -> Array:
        return self.function(scenario, state)


def as_terms(values: Mapping[str, ObservationLike] | tuple[str, ...] | list[str]) -> Terms:
    """The terms of name -> term, or of names in ``OBSERVATIONS``, in the same order.

    Raises:
        InputError: there is none, or one is refused by ``as_term``.
    """
    named = values.items() if isinstance(values, Mapping) else [(name, name) for name in values]
    terms = tuple((name, as_term(value)) for name, value in named)
    if not terms:
        raise InputError("observations: there is none; give at least one, such as 'goal'.")
    return terms


def begin(terms: Terms, scenario: Scenario, state: State, key: Array) -> tuple[dict[str, Array], PyTree]:
    """The first observation of an episode, and the memory for ``observe``; the key draws the delays. Earlier readings
    are taken to be the first one.
    """
    prepared = {name: term.prepare(scenario, state) for name, term in terms}
    readings = {name: _read(term, scenario, state, prepared[name]) for name, term in terms}

    # A term with earlier readings has a line of them, newest first, and a delay for the episode.
    lines = {}
    delays = {}
    for number, (name, term) in enumerate(terms):
        if term.readings > 1:
            least, most = term.delay
            reading = readings[name]
            lines[name] = jnp.broadcast_to(reading[None], (term.readings, *reading.shape))
            term_key = jax.random.fold_in(key, number)
            delays[name] = jax.random.randint(term_key, (), least, most + 1, jnp.int32)
    memory = prepared, lines, delays
    return _shown(terms, readings, memory), memory


def observe(terms: Terms, scenario: Scenario, state: State, memory: PyTree) -> tuple[dict[str, Array], PyTree]:
    """The observation of a later state, and its memory, from the memory of the observation before."""
    prepared, lines, delays = memory
    readings = {name: _read(term, scenario, state, prepared[name]) for name, term in terms}
    lines = {name: jnp.concatenate([readings[name][None], line[:-1]]) for name, line in lines.items()}
    memory = prepared, lines, delays
    return _shown(terms, readings, memory), memory


def _shown(terms: Terms, readings: dict[str, Array], memory: PyTree) -> dict[str, Array]:
    """The observation of readings, and of lines of earlier ones."""
    _, lines, delays = memory
    observation = {}
    for name, term in terms:
        if name in lines:
            observation[name] = _of_line(term, lines[name], delays[name])
        else:
            observation[name] = readings[name][None] if term.stack == 1 else readings[name]
    return observation


def _read(term: ObservationTerm, scenario: Scenario, state: State, prepared: PyTree) -> Array:
    value = user_calls.call("observations", term.read, "scenario, state, prepared", scenario, state, prepared)
    user_calls.check_array("observations", term.read, value, None, None, "give an array, such as jnp.stack([a, b])")
    return jnp.clip(jnp.asarray(value, float), term.low, term.high)


def _of_line(term: ObservationTerm, line: Array, delay: Array) -> Array:
    """The part of an observation for a term with a line of readings."""
    part = jax.lax.dynamic_slice_in_dim(line, delay, term.span, 0)
    if term.every > 1:
        part = part[:: term.every]
    return part if term.stack else part[0]


def space(terms: Terms, scenario: Scenario, state: State) -> dict[str, Box]:
    """Name -> bounds and shape of each term; ``state`` may be the shapes of one."""

    def first_observation(scenario: Scenario, state: State) -> dict[str, Array]:
        observation, _ = begin(terms, scenario, state, jax.random.key(0))
        return observation

    shapes = jax.eval_shape(first_observation, scenario, state)
    return {name: Box(term.low, term.high, shapes[name].shape) for name, term in terms}


def flatten(terms: Terms, observation: Mapping[str, Float[Array, "..."]]) -> Float[Array, "size"]:
    """The parts of an observation that are no images, as one vector (size,), in the order of the terms."""
    parts = [jnp.ravel(observation[name]) for name, term in terms if not term.image]
    return jnp.concatenate(parts) if parts else jnp.zeros(0, float)
