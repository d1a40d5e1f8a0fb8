"""social_costmap: the paper's navigation stack with social cost layers, as SEAN 2.0 configures it for Kuri [49].

move_base in three parts: a cost map with a proxemic layer (``costmap``), a global plan on it (``wavefront``) and a
local planner that drives along the plan (``dynamic_window``); and turning on the spot where these fail for 5 seconds.

What differs from ROS: the global plan is renewed every half second and not 20 times a second, on 32 x 32 cells of
0.2 m around the robot and not on the whole map with 0.05 m; the local map has 32 x 32 cells of 0.05 m or, for a
quicker robot, as much as two seconds of it need. Maps hold the people's places now, without the errors of a lidar. It
does not drive backward but to get out of what it touches (SEAN's -1.0 m/s would let it drive faster backward than
ahead). A control step takes some three million operations, most of them for the two maps.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from sean_jax import clock
from sean_jax.base import Array, Driver, Scenario, State
from sean_jax.geometry import length
from sean_jax.policies import costmap, dynamic_window, wavefront
from sean_jax.policies.costmap import Window
from sean_jax.policies.outlook import look, onward
from sean_jax.policies.prediction import nearest_people
from sean_jax.policies.unicycle import constant

CELLS, CELL = 32, 0.2  # of the window in which it plans, and m
LOCAL, FINE = 32, 0.05  # of the window in which it drives, and m at least
PERIOD, SWEEPS = 5, 12  # control steps in which a plan is made, the first before it moves; cells in each of them
POINTS = 20  # of a plan
NEAR_POINTS = 8  # that the local planner looks at
PEOPLE = 10  # the nearest that are on the maps


@struct.dataclass
class Settings:
    """What SEAN 2.0 configures; leaves are () floats."""

    layers: costmap.Layers
    scores: dynamic_window.Scores
    reached: Array  # m from the goal, where it stops (xy_goal_tolerance)
    patience: Array  # s without a way, after which it turns on the spot
    spin: Array  # rad/s, at which it does, once around


class Memory(NamedTuple):
    """What the driver remembers."""

    follows: Array  # (V,) int32, of ``outlook.onward``
    over: Window  # of the plan in the making
    resisting: Array  # (CELLS, CELLS), what a metre there is worth
    wave: Array  # (CELLS, CELLS) m
    path: Array  # (2, POINTS) m, x and y of the plan that is followed
    planned: Array  # () bool, whether that leads to the goal
    waited: Array  # () int32 ticks without a way; less than zero while it turns


def settings(top_speed: float = 0.6, covariance: float = 0.1) -> Settings:
    """SEAN's settings: at most that share of the robot's top speed, and that covariance [m2] of personal space."""
    return Settings(
        costmap.Layers(
            amplitude=constant(77.0),
            cutoff=constant(10.0),
            covariance=constant(covariance),
            factor=constant(5.0),
            inflation=constant(0.3),
            decay=constant(10.0),
        ),
        dynamic_window.Scores(
            top_speed=constant(top_speed),
            least_spin=constant(0.5),
            path=constant(0.75),
            goal=constant(1.0),
            obstacle=constant(0.1),
        ),
        reached=constant(0.35),
        patience=constant(5.0),
        spin=constant(1.0),
    )


def start(scenario: Scenario, data: Settings, state: State) -> Memory:
    """Plans on a cost map with personal spaces and drives by dynamic windows, as the paper's navigation stack."""
    here = jnp.broadcast_to(state.robot.position[:, None], (2, POINTS))
    cells = jnp.full((CELLS, CELLS), wavefront.FAR, float)
    over = Window(jnp.zeros(2, float), jnp.ones((), float))
    waited = jnp.zeros((), jnp.int32)
    return Memory(onward(scenario, state), over, cells, cells, here, jnp.zeros((), bool), waited)


def drive(scenario: Scenario, data: Settings, state: State, key: Array) -> tuple[Array, Memory]:
    """The command (2,) [m/s, rad/s] along the plan, and the next plan a few cells further."""
    memory: Memory = state.driver
    first, last = state.tick % PERIOD == 0, state.tick % PERIOD == PERIOD - 1
    begun = _begin(scenario, data, state, memory.follows)
    over, resisting, wave = _either(first, begun, (memory.over, memory.resisting, memory.wave))
    wave = jax.lax.scan(lambda now, _: (wavefront.sweep(now, resisting, over.cell), None), wave, length=SWEEPS)[0]
    path, planned = _either(last, _path(state, over, wave), (memory.path, memory.planned))
    robot = state.robot
    command, clear = dynamic_window.choose(
        scenario.robot,
        data.scores,
        (robot.position, robot.heading, robot.speed, robot.turn_rate),
        *_local(scenario, data, state),
        _ahead(path, robot.position),
        scenario.time_step,
    )
    command = jnp.where(planned, command, 0.0)
    command, waited = _recover(scenario, data, memory.waited, command, clear & planned)
    gap = state.task.goal - robot.position
    arrived = length(gap[0], gap[1]) < data.reached
    command, waited = jnp.where(arrived, 0.0, command), jnp.where(arrived, 0, waited)
    return command, Memory(memory.follows, over, resisting, wave, path, planned, waited)


def _begin(scenario: Scenario, data: Settings, state: State, follows: Array) -> tuple[Window, Array, Array]:
    """The window around the robot now, its resistance, and the wave before the first sweep."""
    cell = jnp.full((), max(CELL, 0.5 * scenario.robot.radius), float)
    here = state.robot.position
    over = costmap.window(here, cell, CELLS)
    x, y = costmap.middles(over, CELLS)
    costs = costmap.costs(scenario, data.layers, nearest_people(state, PEOPLE), x, y)
    reach = 0.5 * (CELLS - 1) * cell
    spots = [here[axis] + reach * jnp.asarray(SPOTS[axis], float) for axis in (0, 1)]
    outlook = look(scenario, state, follows, *spots)
    return over, wavefront.resistance(costs), wavefront.begin(scenario, state, outlook, over, costs)


SPOTS = np.asarray([(0, 1, 1, 0, -1, -1, -1, 0, 1), (0, 0, 1, 1, 1, 0, -1, -1, -1)], float)


def _either(first: Array, one: Any, other: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(first, a, b), one, other)


def _path(state: State, over: Window, wave: Array) -> tuple[Array, Array]:
    """(2, POINTS) m the plan from where the robot is, and () bool whether the wave has come there."""
    x, y = wavefront.descend(wave, over, state.robot.position[0], state.robot.position[1], POINTS)
    end = wave[costmap.cell_of(over, CELLS, x[0], y[0])]
    path = jnp.stack([jnp.append(state.robot.position[axis], part)[:POINTS] for axis, part in enumerate((x, y))])
    for _ in range(2):  # grid paths have corners
        path = path.at[:, 1:-1].set(0.25 * (path[:, :-2] + path[:, 2:]) + 0.5 * path[:, 1:-1])
    return path, end < 0.5 * wavefront.FAR


def _local(scenario: Scenario, data: Settings, state: State) -> tuple[Window, Array]:
    """The window in which it drives, and its costs."""
    reach = dynamic_window.SECONDS * data.scores.top_speed * scenario.robot.max_speed + 0.1
    over = costmap.window(state.robot.position, jnp.maximum(2.0 * reach / LOCAL, FINE), LOCAL)
    people = nearest_people(state, PEOPLE)
    return over, costmap.costs(scenario, data.layers, people, *costmap.middles(over, LOCAL))


def _ahead(path: Array, here: Array) -> tuple[Array, Array]:
    """(NEAR_POINTS,) m and m: the plan from its point that is nearest to a place (2,) on."""
    nearest = jnp.argmin(length(path[0] - here[0], path[1] - here[1])).astype(jnp.int32)
    index = jnp.minimum(nearest + jnp.arange(NEAR_POINTS, dtype=jnp.int32), POINTS - 1)
    return path[0][index], path[1][index]


def _recover(scenario: Scenario, data: Settings, waited: Array, command: Array, way: Array) -> tuple[Array, Array]:
    """The command, or turning on the spot when there has been no way for too long; and the ticks without one."""
    turning, longer = waited < 0, jnp.where(way, 0, waited + 1)
    patience, around = (clock.in_ticks(time, scenario.time_step) for time in (data.patience, 2.0 * jnp.pi / data.spin))
    lost = longer.astype(patience.dtype) > patience
    after = jnp.where(turning, waited + 1, jnp.where(lost, -jnp.ceil(around).astype(jnp.int32), longer))
    spin = jnp.stack([jnp.zeros((), float), jnp.minimum(data.spin, scenario.robot.max_turn_rate)])
    return jnp.where(turning, spin, command), after


social_costmap = Driver(data=settings(), name="social_costmap", start=start, drive=drive)
"""The stack as SEAN 2.0 configures it; otherwise by ``replace(social_costmap, data=settings(top_speed=1.0))``."""
