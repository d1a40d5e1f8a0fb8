"""Where people near the robot will be: the project's own social forces, run ahead of time (section IV-D)."""

import jax
import jax.numpy as jnp

from sean_jax.base import Array, Groups, Pedestrians, Scenario, State
from sean_jax.social_forces import advance

UNSEEN = 1e3  # m, how far away who is absent counts as being


def nearest_people(state: State, count: int) -> Pedestrians:
    """The ``count`` people nearest to the robot, or all if there are fewer; rows keep whether somebody is present."""
    people = state.pedestrians
    gap = people.position - state.robot.position[None, :]
    square = jnp.where(people.present, gap[:, 0] * gap[:, 0] + gap[:, 1] * gap[:, 1], jnp.inf)
    _, index = jax.lax.top_k(-jax.lax.stop_gradient(square), min(count, square.shape[0]))
    return jax.tree.map(lambda part: part[index], people)


def predict(scenario: Scenario, people: Pedestrians, groups: Groups, steps: int, time_step: float) -> tuple[Array, ...]:
    """Positions x, y [m] and velocities x, y [m/s] of the people (K), each (T, K), after each ``time_step`` [s].

    They want to go where they want to go now, and heed one another, obstacles and groups, but not the robot: who counts
    on others to give way pushes them. Who is absent is far away.
    """
    forces, nearby = scenario.forces, scenario.environment.nearby

    def one(people: Pedestrians, _) -> tuple[Pedestrians, tuple]:
        after = advance(forces, people, nearby, groups, None, time_step)
        return after, (*after.position.T, *after.velocity.T)

    _, (px, py, vx, vy) = jax.lax.scan(one, people, length=steps)
    here = people.present[None, :]
    return jnp.where(here, px, UNSEEN), jnp.where(here, py, UNSEEN), vx, vy
