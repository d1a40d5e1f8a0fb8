"""Rows: what is recorded of a demonstration once a second (section V-B), as arrays.

An example is made of several rows (``examples``): depth images of five seconds are kept once and not five times.
"""

import jax.numpy as jnp
from flax import struct

from sean_jax import navigation, sensors
from sean_jax.base import Array, Scenario, State
from sean_jax.geometry import rotate

POINTS = 10  # of the global plan
APART = 0.5  # m, between them at least
MILLIMETRES = 1000.0  # in a metre


@struct.dataclass
class Row:
    """One second of a demonstration. With a leading axis, or two: a whole recording."""

    depth: Array  # (H, W) uint16 mm, along the direction of view; the camera's far where nothing is seen
    plan: Array  # (10, 2) m, the next points of the shortest path, in the robot's frame
    pose: Array  # (4,) m, m, then the unit vector of the heading
    velocity: Array  # (2,) m/s along the heading, rad/s
    command: Array  # (2,) m/s, rad/s, what the driver commands now
    situations: Array  # (S,) bool


def row(scenario: Scenario, state: State, command: Array, eye: sensors.Camera, last: Array) -> Row:
    """The row of a state in which the driver gives that command (2,).

    ``last`` (V,) is the ``navigation.bend_to_goal`` of the task's goal.
    """
    robot = state.robot
    return Row(
        depth=depth_image(scenario, state, eye),
        plan=plan_ahead(scenario, state, last),
        pose=jnp.concatenate([robot.position, robot.heading]),
        velocity=jnp.stack([robot.speed, robot.turn_rate]),
        command=command,
        situations=state.situations,
    )


def depth_image(scenario: Scenario, state: State, eye: sensors.Camera) -> Array:
    """(H, W) uint16 mm: what the depth camera sees."""
    metres = sensors.depth(scenario, state, eye)
    return jnp.clip(jnp.round(MILLIMETRES * metres), 0.0, 65535.0).astype(jnp.uint16)


def plan_ahead(scenario: Scenario, state: State, last: Array) -> Array:
    """(10, 2) m: the global plan in the robot's frame."""
    robot, task = state.robot, state.task
    where = robot.position, task.goal, task.to_goal, last
    ahead = navigation.plan(scenario.navigation, *where, points=POINTS, apart=APART) - robot.position[None, :]
    return jnp.stack(rotate(ahead[:, 0], ahead[:, 1], robot.heading[0], -robot.heading[1]), -1)
