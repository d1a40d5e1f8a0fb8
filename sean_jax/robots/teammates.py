"""The other robots of a team as bodies around one robot: for its policy, its sensors and its contacts.

The people of a scenario come first, the other robots after them. A body of those has the radius of a person and stands
where its surface is as near to the robot as that of the other robot, so laws of people hold for robots of any size.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from sean_jax.core.data_types import Array, Pedestrians, Robot, RobotModel, Scenario, Solids, State
from sean_jax.core.geometry import ground_velocity, length, rotate, unit


def with_bodies(scenario: Scenario, state: State) -> tuple[Scenario, State]:
    """The scenario and the state with the other robots as moving bodies; both unchanged without a team.

    They come after the people, and with their solids among those that rays meet.
    """
    if state.others is None or scenario.others is None:
        return scenario, state
    others, models = state.others, scenario.others
    velocity = ground_velocity(others)
    dx, dy = (others.position - state.robot.position[None, :]).T
    ux, uy = unit(dx, dy)
    shift = jnp.minimum(models.radius - scenario.forces.walking.radius, length(dx, dy))
    position = others.position - shift[:, None] * jnp.stack([ux, uy], -1)
    solids = _join(scenario.environment.scenery.solids, _placed(models.solids, others))
    scenery = replace(scenario.environment.scenery, solids=solids)
    scenario = replace(scenario, environment=replace(scenario.environment, scenery=scenery))
    return scenario, replace(state, pedestrians=_append(state.pedestrians, position, velocity, others.heading))


def with_contacts(scenario: Scenario, state: State) -> State:
    """The state with the other robots as bodies that stop this one, at the end of a control step.

    Two robots that touch take the common speed of both along the line between them, that of their center of mass: an
    inelastic impact without friction. Each uses its share of the gap, by the mass of the other.
    """
    if state.others is None or scenario.others is None:
        return state
    robot, model, others, models = state.robot, scenario.robot, state.others, scenario.others
    x, y = (robot.position[None, :] - others.position).T
    nx, ny = unit(x, y)  # from the other to this robot
    gap = length(x, y) - models.radius - model.radius
    share = models.mass / (models.mass + model.mass)
    (wx, wy), (vx, vy) = ground_velocity(others).T, ground_velocity(robot)
    change = (1.0 - share) * ((vx - wx) * nx + (vy - wy) * ny)  # m/s, of the other's speed to the common one
    velocity = jnp.stack([wx + change * nx, wy + change * ny], -1)
    away = scenario.forces.walking.radius + model.radius + share * gap
    place = robot.position[None, :] - away[:, None] * jnp.stack([nx, ny], -1)
    position = place + scenario.time_step * velocity
    return replace(state, pedestrians=_append(state.pedestrians, position, velocity, others.heading))


def _append(people: Pedestrians, position: Array, velocity: Array, heading: Array) -> Pedestrians:
    """People and bodies after them, in no group."""
    number = position.shape[0]
    rows = jax.tree.map(lambda leaf: jnp.zeros((number, *leaf.shape[1:]), leaf.dtype), people)
    alone = jnp.full(number, -1, jnp.int32)
    rows = replace(
        rows,
        position=position,
        velocity=velocity,
        heading=heading,
        desired_velocity=velocity,
        group=alone,
        walking_group=alone,
        present=jnp.ones(number, bool),
        preferred_speed=length(velocity[:, 0], velocity[:, 1]),
    )
    if rows.reaction is not None:
        rows = replace(rows, reaction=replace(rows.reaction, alertness=jnp.ones(number, float)))
    return jax.tree.map(lambda one, more: jnp.concatenate([one, more]), people, rows)


def _placed(solids: Solids, robots: Robot) -> Solids:
    """The solids (R, ...) of robots, from their own frames to the floor, in one list."""

    def one(solids: Solids, position: Float[Array, "2"], heading: Float[Array, "2"]) -> Solids:
        boxes, cylinders, spheres = solids.boxes, solids.cylinders, solids.spheres

        def place(table: Array) -> list[Array]:
            x, y = rotate(table[:, 0], table[:, 1], heading[0], heading[1])
            return [x + position[0], y + position[1], *table[:, 2:].T]

        bx, by, bz, ex, ey, ez, cosine, sine = place(boxes)
        cosine, sine = rotate(cosine, sine, heading[0], heading[1])
        cx, cy, cz, ax, ay, *rest = place(cylinders)
        ax, ay = rotate(ax, ay, heading[0], heading[1])
        return Solids(
            boxes=jnp.stack([bx, by, bz, ex, ey, ez, cosine, sine], -1),
            cylinders=jnp.stack([cx, cy, cz, ax, ay, *rest], -1),
            spheres=jnp.stack(place(spheres), -1),
            color=solids.color,
        )

    each = jax.vmap(one)(solids, robots.position, robots.heading)

    def flat(table: Array) -> Array:
        return table.reshape(table.shape[0] * table.shape[1], table.shape[2])

    color = jnp.concatenate(list(map(flat, _colors(each))))
    return Solids(*map(flat, (each.boxes, each.cylinders, each.spheres)), color=color)


def _join(first: Solids, second: Solids) -> Solids:
    """The bodies of both."""
    tables = (
        jnp.concatenate([getattr(first, name), getattr(second, name)]) for name in ("boxes", "cylinders", "spheres")
    )
    colors = [jnp.concatenate(pair) for pair in zip(_colors(first), _colors(second), strict=True)]
    return Solids(*tables, color=jnp.concatenate(colors))


def _colors(solids: Solids) -> list[Array]:
    """The colors of boxes, of cylinders and of spheres."""
    boxes, cylinders = solids.boxes.shape[-2], solids.cylinders.shape[-2]
    return jnp.split(jnp.asarray(solids.color), [boxes, boxes + cylinders], axis=-2)


def models_of_others(models: RobotModel, number: int) -> RobotModel:
    """The models (M, R, ...) of the other robots of each robot, of the models (M, ...) of a team."""
    return jax.tree.map(lambda leaf: leaf[others_of(number)], models)


def others_of(number: int) -> Int[np.ndarray, "M R"]:
    """The numbers of the other robots of each robot of a team."""
    index = np.arange(number, dtype=np.int32)
    return np.array([np.delete(index, own) for own in index], np.int32)
