"""go_to_goal: the shortest path around obstacles by pure pursuit, giving way to people."""

import jax.numpy as jnp

from sean_jax.base import Array, Scenario, State
from sean_jax.geometry import angle_between, length
from sean_jax.scenario import observe

TURN_GAIN = 2.0  # 1/s
STOP = 0.55  # m between centres: nobody ahead may be nearer
SLOW = 1.2  # m, from where the robot slows down
AROUND = 0.7  # m, by which the robot passes beside somebody who stands in its way
ARRIVED = 0.1  # m from the goal, where it turns to the goal's heading


def go_to_goal(scenario: Scenario, state: State, key: Array) -> Array:
    """Drives along the shortest path around obstacles, giving way to people.

    Gives the (2,) command [m/s, rad/s]. Heads for where the path bends next. If a person is near in that direction,
    it aims beside them, on the side that is nearer; it drives as fast as the room ahead allows, and turns on the
    spot where there is none.
    """
    seen = observe(scenario, state)
    to_path = length(seen.path[0], seen.path[1])
    bearing = jnp.arctan2(seen.path[1], jnp.where(to_path > 0.0, seen.path[0], 1.0))

    distance = length(seen.people[:, 0], seen.people[:, 1])
    direction = jnp.arctan2(seen.people[:, 1], jnp.where(distance > 0.0, seen.people[:, 0], 1.0))
    off = _wrapped(direction - bearing)
    span = _half_width(distance)
    in_way = seen.people_present & (distance < jnp.minimum(2.0, to_path + 0.3)) & (jnp.abs(off) < span)
    aim = bearing
    if in_way.shape[0]:
        nearest = jnp.argmin(jnp.where(in_way, distance, jnp.inf))
        side = jnp.where(off[nearest] > 0.0, -1.0, 1.0)
        aside = direction[nearest] + side * span[nearest]
        aim = _wrapped(jnp.where(in_way.any(), aside, bearing))

    ahead = seen.people_present & (jnp.abs(direction) < jnp.pi / 3)
    closing = jnp.maximum(-seen.people_velocity[:, 0], 0.0)  # somebody who comes along needs more room
    room = jnp.min(jnp.where(ahead, distance - STOP - 0.3 * closing, SLOW), initial=SLOW)
    share = jnp.clip(room / (SLOW - STOP), 0.0, 1.0) * jnp.clip(jnp.cos(aim), 0.0, 1.0)
    speed = scenario.robot.max_speed * share * jnp.clip(length(seen.goal[0], seen.goal[1]) / 0.5, 0.0, 1.0)

    arrived = length(seen.goal[0], seen.goal[1]) < ARRIVED
    forward = jnp.asarray([1.0, 0.0], float)
    turn = jnp.where(arrived, angle_between(forward, seen.goal_heading), aim)
    most = scenario.robot.max_turn_rate
    return jnp.stack([jnp.where(arrived, 0.0, speed), jnp.clip(TURN_GAIN * turn, -most, most)])


def _half_width(distance: Array) -> Array:
    """The angle [rad] from the middle of a disc of radius ``AROUND``, so far away [m], to its edge; inside, pi / 2."""
    beyond = distance * distance - AROUND * AROUND
    outside = beyond > 0.0
    return jnp.where(outside, jnp.arctan2(AROUND, jnp.sqrt(jnp.where(outside, beyond, 1.0))), 0.5 * jnp.pi)


def _wrapped(angle: Array) -> Array:
    """The angle [rad] in [-pi, pi)."""
    return (angle + jnp.pi) % (2 * jnp.pi) - jnp.pi
