"""Constant velocity: people take their desired velocity at once (section IV-D, low level)."""

from dataclasses import replace

import jax.numpy as jnp
from jaxtyping import Float

from sean_jax.core.data_types import Array, Pedestrians, Scenario, State
from sean_jax.social_forces.forces import turn
from sean_jax.social_forces.walls import project_velocity


def constant_velocity(scenario: Scenario, state: State) -> Pedestrians:
    """People take their desired velocity at once, through one another and the robot, but not into obstacles.

    The simplest baseline of trajectory prediction (Schoeller et al., IEEE RA-L 5(2), 2020, found it hard to beat).
    """
    return walk(scenario, state.pedestrians, state.pedestrians.desired_velocity)


def walk(scenario: Scenario, people: Pedestrians, velocity: Float[Array, "N 2"]) -> Pedestrians:
    """People one step later with these velocities [m/s], as far as speed limit and obstacles allow."""
    walking = scenario.forces.walking
    time_step = scenario.time_step
    px, py = people.position.T
    vx, vy = walking.limit_speed(velocity[:, 0], velocity[:, 1], people.preferred_speed)
    vx, vy = project_velocity(px, py, vx, vy, scenario.environment.obstacle_grid, walking.radius, time_step)
    velocity = jnp.where(people.present[:, None], jnp.stack([vx, vy], -1), 0.0)

    heading = turn(people, velocity, walking.turn_rate * time_step)
    position = people.position + velocity * time_step
    return replace(people, position=position, velocity=velocity, heading=heading)
