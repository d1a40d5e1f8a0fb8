"""Rows and examples: what is recorded of a demonstration, and what the network learns from it (section V-B).

A **row** is recorded once a second, or at a higher rate. An **example** is made of several rows a second apart, so that
the store holds a depth image once and not five times.

The paper's example has 5 depth images, a local plan of 5 points of the expert's most recent trajectory, 10 points of
the global plan and a flag for each situation, at 1 Hz. The network of [50] *predicts* the local plan. The most recent
trajectory at the end of five seconds lay ahead at their beginning, so the local planner's target is the places of the
next five seconds, in the robot's present frame. The places of the past five seconds are part of the example as well.
"""

from types import ModuleType

import jax.numpy as jnp
from flax import struct
from jaxtyping import Float, Int, UInt16

from sean_jax import navigation, sensors
from sean_jax.base import Array, Scenario, State
from sean_jax.geometry import rotate

SECONDS = 5  # of depth images, and of the local plan
POINTS = 10  # of the global plan
SPACING = 0.5  # m, minimum distance between two points of the global plan
MILLIMETRES = 1000.0  # in a metre


@struct.dataclass
class Row:
    """One moment of a demonstration. A whole recording has one leading axis, or two."""

    depth: Array  # (H, W) uint16 mm, along the direction of view; the camera's far limit where nothing is visible
    plan: Array  # (10, 2) m, the next points of the shortest path, in the robot's frame
    pose: Array  # (4,) m, m, then the unit vector of the heading
    velocity: Array  # (2,) m/s along the heading, rad/s
    command: Array  # (2,) m/s, rad/s, the command of the policy
    situations: Array  # (S,) bool


@struct.dataclass
class Recording:
    """Demonstrations, one after the other."""

    rows: Row  # (R, ...)
    first: Array  # (R,) int32, the first row of the episode of each row
    end: Array  # (R,) int32, one more than its last row
    rate: int = struct.field(pytree_node=False, default=1)  # rows a second


@struct.dataclass
class Example:
    """What the network receives and what it learns to answer, at one row."""

    images: Array  # (5, H, W) uint16 mm, oldest first, present last; before the episode's first row, that row's image
    plan: Array  # (10, 2) m, global plan in the robot's frame
    situations: Array  # (S,) bool
    past: Array  # (5, 2) m, where the robot was 5 to 1 s ago, in its present frame
    future: Array  # (5, 2) m, where it will be in 1 to 5 s: the target of the local planner
    future_valid: Array  # (5,) bool, whether the episode lasted until then
    command: Array  # (2,) m/s, rad/s, the target of the controller


def row(
    scenario: Scenario,
    state: State,
    command: Float[Array, "2"],
    camera: sensors.Camera,
    last_arc: Int[Array, "V"],
) -> Row:
    """Make the row of a state.

    Args:
        command: (2,) m/s, rad/s, what the policy commands in that state.
        last_arc: (V,) ``navigation.last_arc_to_goal`` of the goal of the task.
    """
    robot = state.robot
    return Row(
        depth=depth_image(scenario, state, camera),
        plan=plan_ahead(scenario, state, last_arc),
        pose=jnp.concatenate([robot.position, robot.heading]),
        velocity=jnp.stack([robot.speed, robot.turn_rate]),
        command=command,
        situations=state.situations,
    )


def depth_image(scenario: Scenario, state: State, camera: sensors.Camera) -> UInt16[Array, "H W"]:
    """Take a depth image.

    Returns:
        (H, W) uint16 mm.
    """
    metres = sensors.depth(scenario, state, camera)
    return jnp.clip(jnp.round(MILLIMETRES * metres), 0.0, 65535.0).astype(jnp.uint16)


def plan_ahead(scenario: Scenario, state: State, last_arc: Int[Array, "V"]) -> Float[Array, "10 2"]:
    """Find the next points of the shortest path to the goal.

    Args:
        last_arc: (V,) ``navigation.last_arc_to_goal`` of the goal of the task.

    Returns:
        (10, 2) m, in the robot's frame.
    """
    robot, task = state.robot, state.task
    where = robot.position, task.goal, task.paths_to_goal, last_arc
    ahead = navigation.plan(scenario.navigation, *where, points=POINTS, apart=SPACING) - robot.position[None, :]
    return jnp.stack(rotate(ahead[:, 0], ahead[:, 1], robot.heading[0], -robot.heading[1]), -1)


def example(recording: Recording, index: Int[Array, "*batch"], xp: ModuleType = jnp) -> Example:
    """Make examples of a recording.

    Args:
        index: () or (B,) the rows at which the examples are.
        xp: ``numpy`` if the recording consists of numpy arrays.

    Returns:
        The example, with a leading axis B if the index has one.
    """
    rows, first, last = recording.rows, recording.first[index][..., None], recording.end[index][..., None] - 1
    ages = xp.arange(SECONDS, dtype=xp.int32).reshape((1,) * (first.ndim - 1) + (SECONDS,))
    present = index[..., None]
    second = recording.rate  # in rows
    visible = xp.maximum(present + second * (ages - (SECONDS - 1)), first)
    before = xp.maximum(present + second * (ages - SECONDS), first)
    after = present + second * (1 + ages)
    pose = rows.pose[index]
    return Example(
        images=rows.depth[visible],
        plan=rows.plan[index],
        situations=rows.situations[index],
        past=in_frame(pose, rows.pose[before, :2], xp),
        future=in_frame(pose, rows.pose[xp.minimum(after, last), :2], xp),
        future_valid=after <= last,
        command=rows.command[index],
    )


def in_frame(
    pose: Float[Array, "*batch 4"], places: Float[Array, "*batch K 2"], xp: ModuleType = jnp
) -> Float[Array, "*batch K 2"]:
    """Transform places on the floor to the frame of a robot.

    Args:
        pose: (..., 4) m, m, and the unit vector of the heading.
        places: (..., K, 2) m.
        xp: ``numpy`` for numpy arrays.

    Returns:
        (..., K, 2) m, x ahead and y to the left.
    """
    dx, dy = places[..., 0] - pose[..., 0:1], places[..., 1] - pose[..., 1:2]
    return xp.stack(rotate(dx, dy, pose[..., 2:3], -pose[..., 3:4]), -1)
