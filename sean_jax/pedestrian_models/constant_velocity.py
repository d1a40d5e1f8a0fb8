"""Constant velocity: people take their desired velocity at once and heed nobody; only obstacles stop them.

The plainest baseline of trajectory prediction (Schoeller et al., IEEE RA-L 5(2), 2020, found it hard to beat).
"""

from dataclasses import replace

import jax.numpy as jnp

from sean_jax.base import Array, Pedestrians, Scenario, State
from sean_jax.geometry import length
from sean_jax.social_forces.model import turn
from sean_jax.social_forces.walls import keep_out


def constant_velocity(scenario: Scenario, state: State) -> Pedestrians:
    """Everybody walks as desired, through one another and the robot, but not into obstacles."""
    return walk(scenario, state.pedestrians, state.pedestrians.desired_velocity)


def walk(scenario: Scenario, people: Pedestrians, velocity: Array) -> Pedestrians:
    """People one control step later at these velocities (N, 2) [m/s], as far as speed limit and obstacles allow."""
    parameters = scenario.forces
    vx, vy = velocity[:, 0], velocity[:, 1]
    speed, greatest = length(vx, vy), parameters.speed_ratio * people.preferred_speed
    slower = jnp.where(speed > greatest, greatest / jnp.where(speed > greatest, speed, 1.0), 1.0)
    (px, py), nearby = people.position.T, scenario.environment.nearby
    vx, vy = keep_out(px, py, vx * slower, vy * slower, nearby, parameters.radius, scenario.time_step)
    velocity = jnp.where(people.present[:, None], jnp.stack([vx, vy], -1), 0.0)
    heading = turn(people, velocity, parameters.turn_rate * scenario.time_step)
    return replace(people, position=people.position + velocity * scenario.time_step, velocity=velocity, heading=heading)
