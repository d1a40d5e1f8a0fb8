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
    others = state.others
    models = scenario.others

    # A body of a person's radius stands nearer to the robot by what the other robot is larger.
    dx, dy = (others.position - state.robot.position[None, :]).T
    excess = models.radius - scenario.forces.walking.radius
    shift = jnp.minimum(excess, length(dx, dy))  # (R,) m
    direction = jnp.stack(unit(dx, dy), -1)
    position = others.position - shift[:, None] * direction
    people = _append(state.pedestrians, position, ground_velocity(others), others.heading)

    # Rays meet the shapes of the other robots.
    environment = scenario.environment
    solids = _join(environment.scenery.solids, _on_floor(models.solids, others))
    scenery = replace(environment.scenery, solids=solids)
    environment = replace(environment, scenery=scenery)
    return replace(scenario, environment=environment), replace(state, pedestrians=people)


def with_contacts(scenario: Scenario, state: State) -> State:
    """The state with the other robots as bodies that stop this one, at the end of a control step.

    Two robots that touch take the common speed of both along the line between them, that of their center of mass: an
    inelastic impact without friction. Each uses its share of the gap, by the mass of the other.
    """
    if state.others is None or scenario.others is None:
        return state
    robot = state.robot
    model = scenario.robot
    others = state.others
    models = scenario.others
    place = robot.position[None, :]
    x, y = (place - others.position).T  # (R,) m each
    nx, ny = unit(x, y)  # from the other to this robot
    gap = length(x, y) - models.radius - model.radius
    mass = models.mass + model.mass
    share = models.mass / mass

    # The other robot's velocity, changed to the common speed along the normal.
    other_vx, other_vy = ground_velocity(others).T
    vx, vy = ground_velocity(robot)
    relative_vx = vx - other_vx
    relative_vy = vy - other_vy
    approach = relative_vx * nx + relative_vy * ny
    change = (1.0 - share) * approach
    common_vx = other_vx + change * nx
    common_vy = other_vy + change * ny
    velocity = jnp.stack([common_vx, common_vy], -1)

    # A body of a person's radius with this robot's share of the gap.
    own_gap = share * gap
    distance = scenario.forces.walking.radius + model.radius + own_gap
    normal = jnp.stack([nx, ny], -1)
    start = place - distance[:, None] * normal
    position = start + scenario.time_step * velocity
    people = _append(state.pedestrians, position, velocity, others.heading)
    return replace(state, pedestrians=people)


def _append(people: Pedestrians, position: Array, velocity: Array, heading: Array) -> Pedestrians:
    """People and bodies after them, in no group."""
    count = position.shape[0]

    def zeros_like_people(leaf: Array) -> Array:
        return jnp.zeros((count, *leaf.shape[1:]), leaf.dtype)

    zeros = jax.tree.map(zeros_like_people, people)
    alone = jnp.full(count, -1, jnp.int32)
    present = jnp.ones(count, bool)
    speed = length(velocity[:, 0], velocity[:, 1])
    bodies = replace(
        zeros,
        position=position,
        velocity=velocity,
        heading=heading,
        desired_velocity=velocity,
        group=alone,
        walking_group=alone,
        present=present,
        preferred_speed=speed,
    )
    if bodies.reaction is not None:
        alert = replace(bodies.reaction, alertness=jnp.ones(count, float))
        bodies = replace(bodies, reaction=alert)
    return jax.tree.map(lambda people, bodies: jnp.concatenate([people, bodies]), people, bodies)


def _on_floor(solids: Solids, robots: Robot) -> Solids:
    """The solids (R, ...) of robots, from their own frames to the floor, in one list."""
    move = jax.vmap(_move_solids)
    by_robot = move(solids, robots.position, robots.heading)
    color = jnp.concatenate([_flat(table) for table in _colors(by_robot)])
    boxes = _flat(by_robot.boxes)
    cylinders = _flat(by_robot.cylinders)
    spheres = _flat(by_robot.spheres)
    return Solids(boxes, cylinders, spheres, color=color)


def _move_solids(solids: Solids, position: Float[Array, "2"], heading: Float[Array, "2"]) -> Solids:
    """The solids of a robot from its own frame to the floor."""

    def move(table: Array) -> list[Array]:  # the columns of a table
        x, y = rotate(table[:, 0], table[:, 1], heading[0], heading[1])
        x = x + position[0]
        y = y + position[1]
        return [x, y, *table[:, 2:].T]

    *box, cosine, sine = move(solids.boxes)
    yaw = rotate(cosine, sine, heading[0], heading[1])
    boxes = jnp.stack([*box, *yaw], -1)

    # The axis of a cylinder turns with the robot.
    x, y, z, axis_x, axis_y, *cylinder = move(solids.cylinders)
    axis = rotate(axis_x, axis_y, heading[0], heading[1])
    cylinders = jnp.stack([x, y, z, *axis, *cylinder], -1)
    spheres = jnp.stack(move(solids.spheres), -1)
    return Solids(boxes, cylinders, spheres, color=solids.color)


def _flat(table: Array) -> Array:
    """(R, K, columns) as (R * K, columns)."""
    robots, bodies, columns = table.shape
    return table.reshape(robots * bodies, columns)


def _join(first: Solids, second: Solids) -> Solids:
    """The bodies of both."""
    pairs = zip(_colors(first), _colors(second), strict=True)
    colors = [jnp.concatenate(pair) for pair in pairs]
    return Solids(
        boxes=jnp.concatenate([first.boxes, second.boxes]),
        cylinders=jnp.concatenate([first.cylinders, second.cylinders]),
        spheres=jnp.concatenate([first.spheres, second.spheres]),
        color=jnp.concatenate(colors),
    )


def _colors(solids: Solids) -> list[Array]:
    """The colors of boxes, of cylinders and of spheres."""
    color = jnp.asarray(solids.color)
    boxes_end = solids.boxes.shape[-2]
    cylinders_end = boxes_end + solids.cylinders.shape[-2]
    return jnp.split(color, [boxes_end, cylinders_end], axis=-2)


def models_of_others(models: RobotModel, number: int) -> RobotModel:
    """The models (M, R, ...) of the other robots of each robot, of the models (M, ...) of a team."""
    others = others_of(number)
    return jax.tree.map(lambda leaf: leaf[others], models)


def others_of(number: int) -> Int[np.ndarray, "M R"]:
    """The numbers of the other robots of each robot of a team."""
    index = np.arange(number, dtype=np.int32)
    others = [np.delete(index, robot) for robot in index]
    return np.array(others, np.int32)
