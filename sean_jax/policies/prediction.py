"""Where people near the robot will be: the project's own social forces, run ahead of time (section IV-D)."""

from dataclasses import replace

import jax
import jax.numpy as jnp

from sean_jax.base import Array, Pedestrians, Scenario, State
from sean_jax.social_forces import advance

UNSEEN = 1e3  # m, how far away who is absent counts as being


def nearest_people(state: State, count: int) -> Pedestrians:
    """The ``count`` people nearest to the robot, or all if there are fewer; rows keep whether somebody is present."""
    people = state.pedestrians
    gap = people.position - state.robot.position[None, :]
    square = jnp.where(people.present, gap[:, 0] * gap[:, 0] + gap[:, 1] * gap[:, 1], jnp.inf)
    _, index = jax.lax.top_k(-jax.lax.stop_gradient(square), min(count, square.shape[0]))
    return jax.tree.map(lambda part: part[index], people)


def predict(
    scenario: Scenario, state: State, people: Pedestrians, x: Array, y: Array, yaw: Array, speed: Array, time_step: float
) -> tuple[Array, Array, Array, Array]:
    """Positions x, y [m] and velocities x, y [m/s] of the people (K), each (T, K), after each ``time_step`` [s].

    They want to go where they want to go now, heed one another, obstacles and groups, and give way to a robot that
    drives through the places x, y (T,) [m] with that yaw (T,) [rad] and speed (T,) [m/s]. Who is absent is far away.
    """
    forces, nearby, groups = scenario.forces, scenario.environment.nearby, state.groups

    def one(people: Pedestrians, robot: tuple) -> tuple[Pedestrians, tuple]:
        px, py, angle, ahead = robot
        there = replace(
            state.robot,
            position=jnp.stack([px, py]),
            heading=jnp.stack([jnp.cos(angle), jnp.sin(angle)]),
            speed=ahead,
        )
        after = advance(forces, people, nearby, groups, there, time_step, scenario.robot.radius)
        return after, (*after.position.T, *after.velocity.T)

    _, (px, py, vx, vy) = jax.lax.scan(one, people, (x, y, yaw, speed))
    here = people.present[None, :]
    return jnp.where(here, px, UNSEEN), jnp.where(here, py, UNSEEN), vx, vy

