"""The people whom a robot knows: people in its depth image, and people who were in it in the last seconds.

Policies of the class ``tracks`` know people in this way. They know the map, their pose and the goal, as a navigation
stack does.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Bool, Float, Int

from sean_jax import sensors
from sean_jax.core.clock import to_ticks
from sean_jax.core.data_types import Array, Scenario, State
from sean_jax.core.devices import parameter

WIDTH, HEIGHT = 64, 48  # pixels of the depth image that shows people, each a bit more than a degree


@struct.dataclass
class Sight:
    """Parameters of the knowledge of people; all leaves are () floats."""

    min_pixels: Float[Array, ""] = parameter(1.0)  # of the 64 x 48, in which a person is visible; 0: all are
    memory_time: Float[Array, ""] = parameter(2.0)  # s, for which people out of sight are remembered


class KnownPeople(NamedTuple):
    """The robot's knowledge of people."""

    position: Float[Array, "N 2"]  # m, where they are, or would be if they had walked on
    velocity: Float[Array, "N 2"]  # m/s, when they were last visible
    group: Int[Array, "N"]  # of then, -1 none
    unseen_ticks: Int[Array, "N"]  # since then
    known: Bool[Array, "N"]  # visible or remembered


def nobody(state: State) -> KnownPeople:
    """The knowledge at the beginning of an episode."""
    people = state.pedestrians
    zeros = jnp.zeros_like(people.position)
    known = jnp.zeros(people.group.shape, bool)
    return KnownPeople(
        position=zeros,
        velocity=zeros,
        group=jnp.full_like(people.group, -1),
        unseen_ticks=known.astype(jnp.int32),
        known=known,
    )


@jax.named_scope("known_people")
def known_people(scenario: Scenario, sight: Sight, state: State, before: KnownPeople) -> KnownPeople:
    """The known people: exact for people in the depth image, others from memory.

    Positions and velocities of visible people are exact, and identities are never confused.
    """
    people = state.pedestrians
    time_step = scenario.time_step
    eye = sensors.camera(scenario, "depth", width=WIDTH, height=HEIGHT)
    pixels = sensors.pixels_of_people(scenario, state, eye)
    visible = people.present & (pixels.astype(people.position.dtype) >= sight.min_pixels)
    if state.others is not None:  # robots of a team know where the others are
        visible = visible | (jnp.arange(visible.shape[0], dtype=jnp.int32) >= scenario.people)
    unseen_ticks = jnp.where(visible, 0, before.unseen_ticks + 1)
    fresh = unseen_ticks.astype(people.position.dtype) <= to_ticks(sight.memory_time, time_step)
    return KnownPeople(
        position=jnp.where(visible[:, None], people.position, before.position + time_step * before.velocity),
        velocity=jnp.where(visible[:, None], people.velocity, before.velocity),
        group=jnp.where(visible, people.group, before.group),
        unseen_ticks=unseen_ticks,
        known=visible | (before.known & fresh),
    )


def as_known(state: State, people: KnownPeople) -> State:
    """The state with the known people and the groups that have a known member; all others are absent."""
    groups = state.groups
    index = jnp.arange(groups.present.shape[0], dtype=people.group.dtype)
    has_known = (people.known[:, None] & (people.group[:, None] == index[None, :])).any(0)
    crowd = replace(
        state.pedestrians,
        position=people.position,
        velocity=people.velocity,
        desired_velocity=people.velocity,
        group=people.group,
        present=people.known,
    )
    return replace(state, pedestrians=crowd, groups=replace(groups, present=groups.present & has_known))
