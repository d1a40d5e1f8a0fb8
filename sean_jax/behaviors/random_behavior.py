"""Random pedestrian behavior (section IV-D): everybody walks from anywhere to anywhere, alone or in a party.

Starts and goals are uniform on the navigable plane, ways lead around obstacles, and whoever arrives draws a new
goal. There are no groups. Goals are drawn from places for which the lengths of all ways are tabulated, so that a
new goal costs a look-up.
"""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from sean_jax import cache
from sean_jax import navigation as paths
from sean_jax.base import Array, Behavior, Environment, Groups, Pedestrians, Scenario, State
from sean_jax.behaviors import parties, starts
from sean_jax.geometry import length
from sean_jax.platforms import put
from sean_jax.social_forces import draw_traits

ARRIVED = 1.0  # m from the goal (SEAN 2.0)


@struct.dataclass
class Tables:
    """What the behavior looks up."""

    navigation: paths.Navigation
    start: Array  # (Q, 2) m, places where somebody can start, none too close to another
    to_goal: Array  # (P, 2, V) ways from each bend to each of the navigation's places
    clumps: Array  # (C, 3) int32 starts beside one another, for parties
    together: parties.Parties = struct.field(pytree_node=False)  # how many


class Memory(NamedTuple):
    goal: Array  # (N,) int32 index of a place of the navigation


def build(
    folder: Path,
    environment: Environment,
    navigation: paths.Navigation,
    people: int,
    shares: tuple[float, float] = (0.0, 0.0),
) -> Behavior:
    """People walk from anywhere to anywhere, alone or, by these shares, in pairs and in triples.

    Raises:
        ValueError: so many people or parties do not fit.
    """
    groups = parties.parties(people, shares)
    start = starts.uniform(environment, navigation, people, dense=groups.number > 0)
    if people > len(start):
        raise ValueError(f"people: {people} do not fit in {environment.name}; the most that do is {len(start)}.")
    code = *paths.CODE, "behaviors/random_behavior"
    made = cache.kept("goals", code, paths.inputs(navigation), lambda: {"to_goal": _ways(navigation)})
    tables = Tables(
        navigation=navigation,
        start=put(start),
        to_goal=put(made["to_goal"]),
        clumps=put(parties.clumps(navigation, start, groups)),
        together=groups,
    )
    return Behavior(data=tables, name="random", reset=reset, direct=direct, companions=groups.companions(people))


def _ways(navigation: paths.Navigation) -> np.ndarray:
    """(P, 2, V) ``to_goal`` of each of the navigation's places."""
    rows = jax.jit(lambda places: jax.lax.map(lambda p: paths.to_goal(navigation, p), places, batch_size=32))
    return np.asarray(rows(navigation.places))


def reset(scenario: Scenario, key: Array) -> tuple[Pedestrians, Groups, Memory]:
    """People at uniformly drawn starts, each with a uniformly drawn goal."""
    tables: Tables = scenario.behavior.data
    people = scenario.people
    place_key, goal_key, trait_key, turn_key = jax.random.split(key, 4)
    chance = jax.random.uniform(place_key, tables.start.shape[:1], float)
    chosen = parties.places(chance, tables.clumps, people, tables.together)
    party = parties.leaders(scenario.behavior.companions, people)
    angle = jax.random.uniform(turn_key, (people,), float, 0.0, 2 * jnp.pi)
    preferred_speed, robot_distance = draw_traits(scenario.forces, trait_key, people)
    position = tables.start[chosen]
    pedestrians = Pedestrians(
        position=position,
        velocity=jnp.zeros_like(position),
        heading=jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1),
        desired_velocity=jnp.zeros_like(position),
        group=jnp.full(people, -1, jnp.int32),
        party=party,
        present=jnp.ones(people, bool),
        preferred_speed=parties.speeds(scenario, party, preferred_speed),
        robot_distance=robot_distance,
    )
    return pedestrians, no_groups(), Memory(*parties.follow(party, _draw(tables, goal_key, people)))


def direct(scenario: Scenario, state: State, key: Array) -> State:
    """A new goal for who has arrived; desired velocities along the shortest ways."""
    tables: Tables = scenario.behavior.data
    people, places = state.pedestrians, tables.navigation.places
    gap = places[state.memory.goal] - people.position
    arrived = length(gap[:, 0], gap[:, 1]) < ARRIVED
    goal = jnp.where(arrived, _draw(tables, key, scenario.people), state.memory.goal)
    if scenario.behavior.companions is not None:
        (goal,) = parties.follow(people.party, goal)
    ahead = jax.vmap(paths.next_point_roughly, in_axes=(None, 0, 0, 0))(
        tables.navigation, people.position, places[goal], tables.to_goal[goal]
    )
    gap = ahead - people.position
    speed = people.preferred_speed / jnp.maximum(length(gap[:, 0], gap[:, 1]), 1e-6)
    velocity = gap * speed[:, None]
    if scenario.behavior.companions is not None:
        velocity = parties.abreast(people, velocity)
    return replace(state, pedestrians=replace(people, desired_velocity=velocity), memory=Memory(goal))


def no_groups() -> Groups:
    """Groups of which there are none (G = 0)."""
    pairs, none = jnp.zeros((0, 2), float), jnp.zeros(0, float)
    return Groups(center=pairs, radius=none, opening=pairs, present=jnp.zeros(0, bool))


def _draw(tables: Tables, key: Array, people: int) -> Array:
    return jax.random.randint(key, (people,), 0, tables.navigation.places.shape[0], jnp.int32)
