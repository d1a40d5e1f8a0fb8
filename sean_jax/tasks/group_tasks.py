"""Join Group and Leave Group (section IV-E): the robot's goal, or its start, is a member's place in a group."""

from typing import Any

import jax
import jax.numpy as jnp

from sean_jax.base import Array, Groups, Pedestrians, RobotTask, Scenario
from sean_jax.geometry import unit_vectors
from sean_jax.tasks.places import far_place
from sean_jax.tasks.task import build_task, requires


@requires("groups")
def join_group(scenario: Scenario, pedestrians: Pedestrians, groups: Groups, memory: Any, key: Array) -> RobotTask:
    """The robot goes to the open place of a random group, from a drawn distance away."""
    group, opening, inward, away, facing = _poses(scenario, pedestrians, groups, key)
    return build_task(scenario, away, opening, start_heading=facing, goal_heading=inward, goal_group=group)


@requires("groups")
def leave_group(scenario: Scenario, pedestrians: Pedestrians, groups: Groups, memory: Any, key: Array) -> RobotTask:
    """The robot goes from the open place of a random group to a place a drawn distance away."""
    group, opening, inward, away, facing = _poses(scenario, pedestrians, groups, key)
    return build_task(scenario, opening, away, start_heading=inward, goal_heading=facing, start_group=group)


def _poses(scenario: Scenario, pedestrians: Pedestrians, groups: Groups, key: Array) -> tuple:
    """A group's index (), its opening (2,) with the heading into it, and a far place (2,) with a random heading."""
    group_key, place_key, turn_key = jax.random.split(key, 3)
    chance = jnp.where(groups.present, jax.random.uniform(group_key, groups.radius.shape, float), -1.0)
    group = jnp.argmax(chance).astype(jnp.int32)
    opening = groups.opening[group]
    inward = unit_vectors(groups.center[group] - opening, jnp.asarray([1.0, 0.0], float))
    angle = jax.random.uniform(turn_key, (), float, 0.0, 2 * jnp.pi)
    away = far_place(scenario, pedestrians, opening, place_key)
    return group, opening, inward, away, jnp.stack([jnp.cos(angle), jnp.sin(angle)])
