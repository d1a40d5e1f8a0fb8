"""What a sensor of a scenario has before it: the scenery, the people, and the robot if the sensor sees it."""

import dataclasses

import jax.numpy as jnp

from sean_jax.base import Array, Scenario, Solids, State
from sean_jax.raycast import Rays, View, look


def sight(scenario: Scenario, state: State, rays: Rays, with_robot: bool = False) -> View:
    """The bodies around a sensor of the robot, in the robot's frame."""
    people, robot = state.pedestrians, state.robot
    solids = scenario.environment.scenery.solids
    view = look(
        solids, people.position, people.present, scenario.forces.radius, robot.position, robot.heading, rays.origin
    )
    return _with_robot(view, scenario.robot.solids, rays.origin) if with_robot else view


def _with_robot(view: View, solids: Solids, origin) -> View:
    """The bodies of the robot, which are the last of each kind; its frame is that of the view but for the origin."""
    place = jnp.asarray(origin, float)

    def moved(table: Array) -> Array:
        return table.at[:, :3].add(-place[None, :])

    return dataclasses.replace(
        view,
        boxes=jnp.concatenate([view.boxes, moved(solids.boxes)]),
        cylinders=jnp.concatenate([view.cylinders, moved(solids.cylinders)]),
        spheres=jnp.concatenate([view.spheres, moved(solids.spheres)]),
    )
