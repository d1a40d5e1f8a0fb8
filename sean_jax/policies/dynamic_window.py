"""The dynamic window approach as ROS's TrajectoryPlanner samples and scores it (D. Fox, W. Burgard & S. Thrun, 1997).

Numbers are SEAN 2.0's for Kuri: 20 speeds by 40 turn rates of what can be reached in one control step, each driven for
two seconds on the cost map; path distance counts .75 and goal distance 1 for each cell of 0.05 m, a cost .1.
"""

import jax
import jax.numpy as jnp
from flax import struct

from sean_jax.base import Array, RobotModel
from sean_jax.geometry import length
from sean_jax.policies.costmap import TOUCHES, Window, cell_of
from sean_jax.policies.unicycle import over_ground

SPEEDS, TURNS = 20, 40  # samples
POINTS = 10  # of a trajectory, at which costs are looked up
SECONDS = 2.0  # of a trajectory
GRAIN = 0.05  # m, the cell in which distances are counted
ESCAPE = -0.1  # m/s, out of what is touched
LOOK = 0.325  # m ahead, by which turns on the spot are compared


@struct.dataclass
class Scores:
    """Limits and weights of the local planner; all leaves are () floats."""

    top_speed: Array  # 1, of the robot's own: 0.3 of 0.5 m/s
    least_spin: Array  # rad/s, of a turn on the spot
    path: Array  # per cell of 0.05 m from the plan (pdist_scale)
    goal: Array  # per cell of 0.05 m from where the plan leaves the map (gdist_scale)
    obstacle: Array  # per cost (occdist_scale)


def samples(model: RobotModel, scores: Scores, speed: Array, turn: Array, time_step: float) -> tuple[Array, Array]:
    """(P,) m/s and (P,) rad/s: the 20 x 40 commands from a speed and turn rate () and (), straight ahead among them.

    The last one backs out of what is touched.
    """
    fall = model.max_acceleration if model.max_deceleration is None else model.max_deceleration
    top = scores.top_speed * model.max_speed
    low = jnp.clip(speed - fall * time_step, 0.0, top)
    high = jnp.clip(speed + model.max_acceleration * time_step, low, top)
    change = model.max_turn_acceleration * time_step
    right = jnp.clip(turn - change, -model.max_turn_rate, model.max_turn_rate)
    left = jnp.clip(turn + change, -model.max_turn_rate, model.max_turn_rate)
    share = jnp.linspace(0.0, 1.0, SPEEDS, dtype=float)
    share_turn = jnp.linspace(0.0, 1.0, TURNS - 1, dtype=float)
    ahead = jnp.repeat(low + (high - low) * share, TURNS)
    turns = jnp.concatenate([jnp.zeros(1, float), right + (left - right) * share_turn])
    turns = jnp.tile(turns, SPEEDS)
    spin = jnp.where(turns < 0.0, -1.0, 1.0) * jnp.maximum(jnp.abs(turns), scores.least_spin)
    turns = jnp.where((ahead < 1e-3) & (turns != 0.0), spin, turns)
    return jnp.append(ahead, jnp.asarray(ESCAPE, float)), jnp.append(turns, jnp.asarray(0.0, float))


def arcs(speed: Array, turn: Array) -> tuple[Array, Array, Array]:
    """x, y [m] and yaw [rad], (POINTS, P), in the robot's frame, of the commands (P,) [m/s] and (P,) [rad/s]."""
    time = jnp.linspace(SECONDS / POINTS, SECONDS, POINTS, dtype=float)[:, None]
    yaw = time * turn[None, :]
    half = 0.5 * yaw
    flat = jnp.abs(half) < 1e-3
    chord = time * speed[None, :] * jnp.where(flat, 1.0, jnp.sin(half) / jnp.where(flat, 1.0, half))
    return chord * jnp.cos(half), chord * jnp.sin(half), yaw


def choose(
    model: RobotModel,
    scores: Scores,
    robot: tuple,
    over: Window,
    costs: Array,
    path: tuple[Array, Array],
    time_step: float,
) -> tuple[Array, Array]:
    """The best command (2,) [m/s, rad/s], and () bool whether any does not touch anything.

    ``robot`` is its position (2,), heading (2,), speed () and turn rate (); ``costs`` (C, C) is the map and ``path``
    (L,), (L,) [m] the plan inside it. If all touch something, the best is one that ends where nothing is touched, or
    to stand.
    """
    position, heading, speed, turn = robot
    ahead, turns = samples(model, scores, speed, turn, time_step)
    x, y, yaw = arcs(ahead, turns)
    gx, gy = over_ground(position, heading, x, y)
    met = costs[cell_of(over, costs.shape[0], gx, gy)]
    most = jnp.max(met, 0)
    clear = (most < TOUCHES) & (ahead >= 0.0)
    way_out = met[-1] < TOUCHES
    still = jnp.abs(ahead) < 1e-3
    angle = yaw[-1] + jnp.arctan2(heading[1], heading[0])
    end_x = gx[-1] + jnp.where(still, LOOK * jnp.cos(angle), 0.0)
    end_y = gy[-1] + jnp.where(still, LOOK * jnp.sin(angle), 0.0)
    goal_x, goal_y = path[0][-1], path[1][-1]
    looked = length(end_x - goal_x, end_y - goal_y)
    to_goal = jnp.where(still, length(position[0] - goal_x, position[1] - goal_y) + 1e-3 * looked, looked)
    to_path = jnp.where(still, from_path(gx[-1], gy[-1], *path), from_path(end_x, end_y, *path))
    score = (scores.path * to_path + scores.goal * to_goal) / GRAIN + scores.obstacle * most
    any_clear = clear.any()
    allowed = jnp.where(any_clear, clear, way_out)
    best = jnp.argmin(jnp.where(allowed, score, jnp.inf))
    command = jnp.stack([ahead[best], turns[best]])
    return jnp.where(allowed.any(), command, 0.0), any_clear


def from_path(x: Array, y: Array, path_x: Array, path_y: Array) -> Array:
    """(P,) m from places (P,), (P,) to the nearest of the path's pieces between its points (L,), (L,)."""

    def piece(ax: Array, ay: Array, bx: Array, by: Array) -> Array:
        dx, dy = bx - ax, by - ay
        square = dx * dx + dy * dy
        along = ((x - ax) * dx + (y - ay) * dy) / jnp.maximum(square, 1e-9)
        along = jnp.clip(along, 0.0, 1.0)
        return length(x - ax - along * dx, y - ay - along * dy)

    return jnp.min(jax.vmap(piece)(path_x[:-1], path_y[:-1], path_x[1:], path_y[1:]), 0)
