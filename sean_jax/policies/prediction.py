"""Where people near the robot will be: the project's own social forces, run ahead of time (section IV-D)."""

from dataclasses import replace

import jax
import jax.numpy as jnp

from sean_jax.base import Array, Groups, Pedestrians, Scenario, State
from sean_jax.social_forces import advance

UNSEEN = 1e3  # m, how far away who is absent counts as being
SAME = 0.1  # m, a third of a body's radius: nobody comes as near to another, but who was put there


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

    Derivatives are exact but for people within 0.1 m of one another, whose middles are as good as in one place: where a
    push would turn round, it has none. Over all these steps it would grow by a factor of thousands in each, beyond what
    single precision holds.
    """
    forces, nearby = scenario.forces, scenario.environment.nearby

    def one(people: Pedestrians, _) -> tuple[Pedestrians, tuple]:
        held = jnp.where(_in_one_place(people)[:, None], jax.lax.stop_gradient(people.position), people.position)
        after = advance(forces, replace(people, position=held), nearby, groups, None, time_step)
        after = replace(after, position=after.position + (people.position - held))  # 0, but for derivatives
        return after, (*after.position.T, *after.velocity.T)

    _, (px, py, vx, vy) = jax.lax.scan(one, people, length=steps)
    here = people.present[None, :]
    return jnp.where(here, px, UNSEEN), jnp.where(here, py, UNSEEN), vx, vy


def _in_one_place(people: Pedestrians) -> Array:
    """(K,) bool: within ``SAME`` of somebody else who is present."""
    x, y = jax.lax.stop_gradient(people.position).T
    dx, dy = x[:, None] - x[None, :], y[:, None] - y[None, :]
    other = people.present[None, :] & ~jnp.eye(people.present.shape[0], dtype=bool)
    return (other & (dx * dx + dy * dy < SAME * SAME)).any(1)
