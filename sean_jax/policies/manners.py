"""What the expert minds (sections IV-G, IV-H): obstacles, social distances, o-spaces, comfort, all as rates per second.

One unit is what a metre of way is worth. Each rate is an array of the shape of the trajectories, (T, P), to be added
up over time. People come as predicted, (T, K).
"""

import jax.numpy as jnp
from flax import struct

from sean_jax.base import Array, Nearby, Scenario, State
from sean_jax.geometry import from_rectangle, length, to_border
from sean_jax.metrics.proximity import INTIMATE, PERSONAL
from sean_jax.nearby import around


@struct.dataclass
class Weights:
    """How much the expert minds what; all leaves are () floats."""

    touch: Array  # 1/s, of an obstacle or of intimacy
    obstacle: Array  # 1/s, where it is as near as can be
    personal: Array  # 1/s, in the middle of a personal space
    o_space: Array  # 1/s, in the middle of a group that the task has nothing to do with
    reverse: Array  # 1/m, of driving backward
    turning: Array  # s/rad2, of the square of the turn rate
    change: Array  # s3/m2, of the square of acceleration
    facing: Array  # 1, of facing backward at the goal


SPARE = 0.03  # m, kept from obstacles by all means
ROOM = 0.15  # m, wished for beyond that
MARGIN = 0.07  # m, by which predictions may be wrong: added to intimacy and to touching
AHEAD = 0.7  # s, by which the speed of people stretches their personal space ahead


def to_obstacles(nearby: Nearby, x: Array, y: Array) -> Array:
    """Distance [m] from each of the places x, y [m] to the nearest obstacle that is near; of their shape."""
    rows = around(nearby, x, y)
    return jnp.min(from_rectangle(x[..., None], y[..., None], *(rows[..., part] for part in range(6)))[0], -1)


def obstacle_rate(scenario: Scenario, weights: Weights, x: Array, y: Array) -> Array:
    """(T, P) 1/s at places x, y (T, P) [m]: beside obstacles and the edge of the floor."""
    edge = to_border(scenario.environment, x, y)
    gap = jnp.minimum(to_obstacles(scenario.environment.nearby, x, y), edge) - scenario.robot.radius - SPARE
    near = jnp.clip(1.0 - gap / ROOM, 0.0, 1.0)
    inside = jnp.clip(-gap / SPARE, 0.0, 10.0)
    return weights.obstacle * near * near + weights.touch * (inside + jnp.where(gap < 0.0, 1.0, 0.0))


def people_rate(scenario: Scenario, weights: Weights, x: Array, y: Array, people: tuple[Array, ...]) -> Array:
    """(T, P) 1/s at places x, y (T, P) [m] among people: positions x, y [m], velocities x, y [m/s], each (T, K).

    Nobody shall come nearer than 0.45 m, or touch. Personal space, of 1.2 m, reaches farther ahead of who walks.
    """
    px, py, vx, vy = (part[:, None, :] for part in people)
    dx, dy = x[..., None] - px, y[..., None] - py
    away = length(dx, dy)
    least = jnp.maximum(INTIMATE, scenario.robot.radius + scenario.forces.radius) + MARGIN
    speed = length(vx, vy)
    ahead = (dx * vx + dy * vy) / jnp.maximum(speed, 0.1)
    shrink = 1.0 - 1.0 / (1.0 + AHEAD * speed)
    stretched = jnp.where(ahead > 0.0, away - shrink * ahead, away)
    reach = jnp.maximum(PERSONAL, least + 0.4)
    personal = jnp.clip(1.0 - stretched / reach, 0.0, 1.0)
    inside = jnp.clip((least - away) / 0.2, 0.0, 3.0)
    rates = weights.personal * personal * personal + weights.touch * (inside + jnp.where(away < least, 1.0, 0.0))
    return rates.sum(-1)


def group_rate(state: State, weights: Weights, x: Array, y: Array) -> Array:
    """(T, P) 1/s at places x, y (T, P) [m]: in o-spaces, but those of the groups that the task joins or leaves."""
    groups, task = state.groups, state.task
    index = jnp.arange(groups.radius.shape[0], dtype=jnp.int32)
    own = (index == task.goal_group) | (index == task.start_group)
    cx, cy = groups.center[None, None, :, 0], groups.center[None, None, :, 1]
    away = length(x[..., None] - cx, y[..., None] - cy)
    size = jnp.where(own, 0.5, 1.2) * jnp.maximum(groups.radius, 1e-3)
    deep = jnp.clip(1.0 - away / size[None, None, :], 0.0, 1.0)
    return weights.o_space * jnp.where(groups.present[None, None, :], deep, 0.0).sum(-1)


def comfort_rate(weights: Weights, speed: Array, turn: Array, before: tuple[Array, Array], time_step: float) -> Array:
    """(T, P) 1/s of speeds [m/s] and turn rates [rad/s], (T, P); ``before`` () and () are those of now."""
    faster = jnp.diff(speed, axis=0, prepend=jnp.full_like(speed[:1], before[0])) / time_step
    quicker = jnp.diff(turn, axis=0, prepend=jnp.full_like(turn[:1], before[1])) / time_step
    swing = weights.turning * (turn * turn + 0.05 * quicker * quicker)
    return weights.reverse * jnp.maximum(-speed, 0.0) + swing + weights.change * faster * faster
