"""Predictions for planners: the robot by its limits (Fig. 3), people by the social forces (section IV-D).

The robot is its closed-form twin without contact and without slip, which planners avoid.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from sean_jax.core.data_types import Array, Groups, Pedestrians, RobotModel, Scenario, State
from sean_jax.core.geometry import rotate
from sean_jax.robots.drive import LAWS, Speeds
from sean_jax.social_forces import integrate

ABSENT_DISTANCE = 1e3  # m, distance of absent people
COINCIDENT_DISTANCE = 0.1  # m, a third of a body's radius; the simulation keeps people farther apart


class RobotMotion(NamedTuple):
    """Predicted motion of a robot along P plans, after each of T steps."""

    x: Float[Array, "T P"]  # m
    y: Float[Array, "T P"]  # m
    yaw: Float[Array, "T P"]  # rad
    speed: Float[Array, "T P"]  # m/s
    turn_rate: Float[Array, "T P"]  # rad/s


class PeopleMotion(NamedTuple):
    """Predicted motion of K people, after each of T steps."""

    x: Float[Array, "T K"]  # m
    y: Float[Array, "T K"]  # m
    vx: Float[Array, "T K"]  # m/s
    vy: Float[Array, "T K"]  # m/s


def predict_robot(
    model: RobotModel,
    speeds: Speeds,
    commands: tuple[Float[Array, "T P"], ...],
    time_step: float,
) -> RobotMotion:
    """The motion of a robot, in its frame of now, after each of T commands of P plans.

    Each step is the chord of an arc, with the heading at its middle.

    Args:
        speeds: of now, as the law of the robot's drive has them.
        commands: the numbers of the commands [m/s, rad/s].
        time_step: s, between two commands.
    """
    law = LAWS[model.drive_type]
    start = tuple(jnp.full(commands[0].shape[1:], speed) for speed in speeds)

    def step(before: Speeds, command: Speeds) -> tuple[Speeds, Speeds]:
        after = law.limit(model, before, command, time_step)
        return after, after

    _, limited = jax.lax.scan(step, start, commands)
    ahead, left, turn_rate = law.velocity(model, limited)
    rotation = time_step * turn_rate
    yaw = jnp.cumsum(rotation, axis=0)
    middle_yaw = yaw - 0.5 * rotation
    if left is None:
        dx = time_step * ahead * jnp.cos(middle_yaw)
        dy = time_step * ahead * jnp.sin(middle_yaw)
    else:
        dx, dy = rotate(time_step * ahead, time_step * left, jnp.cos(middle_yaw), jnp.sin(middle_yaw))
    return RobotMotion(jnp.cumsum(dx, axis=0), jnp.cumsum(dy, axis=0), yaw, ahead, turn_rate)


def to_world(
    position: Float[Array, "2"], heading: Float[Array, "2"], x: Float[Array, "*shape"], y: Float[Array, "*shape"]
) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
    """Places (x ahead, y left) [m] in the frame of a robot at a position [m] as places (x, y) [m] on the floor."""
    world_x, world_y = rotate(x, y, heading[0], heading[1])
    return position[0] + world_x, position[1] + world_y


def nearest_people(state: State, count: int) -> Pedestrians:
    """The ``count`` people nearest to the robot, or all; absent people come last, with ``present`` False."""
    people = state.pedestrians
    gap = people.position - state.robot.position[None, :]
    square = gap[:, 0] * gap[:, 0] + gap[:, 1] * gap[:, 1]  # (N,) m2
    square = jnp.where(people.present, square, jnp.inf)
    count = min(count, len(square))
    _, index = jax.lax.top_k(-jax.lax.stop_gradient(square), count)
    return jax.tree.map(lambda leaf: leaf[index], people)


def predict_people(
    scenario: Scenario, people: Pedestrians, groups: Groups, steps: int, time_step: float
) -> PeopleMotion:
    """The motion of people after each of several steps of ``time_step`` [s], by the social forces.

    They keep their desired velocity and react to people, obstacles and groups, but not to the robot: a planner
    that counts on people to give way pushes them. Absent people are far away.

    Derivatives are exact except within 0.1 m of another person, where centers nearly coincide: where a force would
    change its direction, it has no derivative. Over all these steps it would grow by a factor of thousands in each,
    beyond what single precision holds.
    """
    forces = scenario.forces
    grid = scenario.environment.obstacle_grid

    def step(people: Pedestrians, _: None) -> tuple[Pedestrians, tuple]:
        coincident = _coincident(people)[:, None]
        fixed = jnp.where(coincident, jax.lax.stop_gradient(people.position), people.position)
        after = integrate(forces, replace(people, position=fixed), grid, groups, None, time_step)
        after = replace(after, position=after.position + (people.position - fixed))  # 0, except for derivatives
        return after, (*after.position.T, *after.velocity.T)

    _, (px, py, vx, vy) = jax.lax.scan(step, people, length=steps)
    return PeopleMotion(*_absent_far_away(people, px, py), vx, vy)


def _absent_far_away(people: Pedestrians, x: Array, y: Array) -> tuple[Array, Array]:
    """Places (T, K) [m] of people, and others for those who are absent."""
    present = people.present[None, :]
    x = jnp.where(present, x, ABSENT_DISTANCE)
    y = jnp.where(present, y, ABSENT_DISTANCE)
    return x, y


def predict_straight(people: Pedestrians, steps: int, time_step: float) -> PeopleMotion:
    """The motion of people at constant velocity, for people with unknown goals; steps of ``time_step`` [s]."""
    number = jnp.arange(steps, dtype=people.position.dtype) + 1.0
    seconds = time_step * number[:, None]  # (T, 1)
    x, y = people.position.T[:, None, :]  # (1, K) each
    vx, vy = people.velocity.T[:, None, :]
    x, y = _absent_far_away(people, x + seconds * vx, y + seconds * vy)  # (T, K)
    vx = jnp.broadcast_to(vx, x.shape)
    vy = jnp.broadcast_to(vy, x.shape)
    return PeopleMotion(x, y, vx, vy)


def _coincident(people: Pedestrians) -> Bool[Array, "K"]:
    """Whether each person is within ``COINCIDENT_DISTANCE`` of another person who is present."""
    x, y = jax.lax.stop_gradient(people.position).T
    dx = x[:, None] - x[None, :]  # (K, K)
    dy = y[:, None] - y[None, :]
    is_other = people.present[None, :] & ~jnp.eye(people.present.shape[0], dtype=bool)
    coincides = dx * dx + dy * dy < COINCIDENT_DISTANCE * COINCIDENT_DISTANCE
    return (is_other & coincides).any(1)
