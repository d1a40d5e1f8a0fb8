"""Random pedestrian behavior (section IV-D): people walk from anywhere to anywhere, alone or in walking groups.

Starts and goals are uniform on the navigable plane, paths lead around obstacles, and people who arrive draw a new goal.
There are no conversational groups. Paths to all possible goals are tabulated, so that a new goal costs a look-up.
"""

import functools
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Float, Int

from sean_jax.core.data_types import FAR, Array, Behavior, Groups, PathsToGoal, Pedestrians, Scenario, State
from sean_jax.core.devices import to_device
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import length
from sean_jax.core.padding import FlatTable, flat_table
from sean_jax.io import cache
from sean_jax.people.behaviors.starts import (
    Place,
    WalkingGroups,
    anywhere,
    choose_starts,
    count_walking_groups,
    find_spawn_clusters,
    follow_leaders,
    group_speeds,
    leaders,
    no_groups,
    present_people,
    walk_abreast,
)
from sean_jax.social_forces import draw_traits
from sean_jax.world import navigation as paths

ARRIVED = 1.0  # m from the goal (SEAN 2.0)


@struct.dataclass
class RandomTables:
    """The tables of the behavior."""

    navigation: paths.Navigation
    start: Float[Array, "P 2"] = struct.field(metadata={"pad": FAR})  # m, possible starts, none too close to another
    distance: FlatTable  # (P, V) m, of ``PathsToGoal``, to each of the navigation's places
    departure_angle: FlatTable  # (P, V) rad, likewise
    spawn_clusters: Int[Array, "C 3"] = struct.field(metadata={"pad": -1})  # neighboring starts, for walking groups
    walking_groups: WalkingGroups = struct.field(pytree_node=False)  # their numbers


class RandomMemory(NamedTuple):
    """The goal of each person."""

    goal: Int[Array, "N"]  # index of a place of the navigation


def build(place: Place, people: int | None = None, *, walking_groups: tuple[float, float] = (0.0, 0.0)) -> Behavior:
    """People walk from anywhere to anywhere, alone, in pairs or in triples.

    Args:
        people: the environment's number if None.
        walking_groups: shares of the people who walk in pairs and in triples.

    Raises:
        InputError: so many people or walking groups do not fit.
    """
    people = place.default_people if people is None else people
    navigation = place.navigation
    groups = count_walking_groups(people, walking_groups)
    start = anywhere(place.environment, navigation, people, dense=groups.number > 0)
    if people > len(start):
        raise InputError(f"people: {people} do not fit in {place.environment.name}; the most that do is {len(start)}.")

    code = *paths.CODE, "people/behaviors/random_behavior"
    table = cache.load_or_build("goals", code, paths.inputs(navigation), lambda: _paths_to_places(navigation))
    tables = RandomTables(
        navigation=navigation,
        start=to_device(start),
        **{name: flat_table(values) for name, values in table.items()},
        spawn_clusters=to_device(find_spawn_clusters(navigation, start, groups)),
        walking_groups=groups,
    )
    companions = groups.companions(people)
    return Behavior(data=tables, name="random", reset=reset, direct=direct, companions=companions, people=people)


def paths_to_place(tables: RandomTables, index: Int[Array, ""]) -> PathsToGoal:
    """The shortest paths to one of the navigation's places; those from arcs that are padding may be any."""
    n_arcs = tables.navigation.arcs.side.shape[0]
    distance = tables.distance.row((index,), n_arcs)
    departure_angle = tables.departure_angle.row((index,), n_arcs)
    return PathsToGoal(distance, departure_angle)


def _paths_to_places(navigation: paths.Navigation) -> dict[str, np.ndarray]:
    """The fields (P, V) of ``PathsToGoal`` for each of the navigation's places."""
    paths_to_goal = functools.partial(paths.build_paths_to_goal, navigation)
    to_places = jax.jit(lambda places: jax.lax.map(paths_to_goal, places, batch_size=32))(navigation.places)
    return {"distance": np.asarray(to_places.distance), "departure_angle": np.asarray(to_places.departure_angle)}


def reset(scenario: Scenario, key: Array) -> tuple[Pedestrians, Groups, RandomMemory]:
    """People at uniformly drawn starts, each with a uniformly drawn goal."""
    tables: RandomTables = scenario.behavior.data
    people = scenario.people
    place_key, goal_key, trait_key, turn_key = jax.random.split(key, 4)
    score = jax.random.uniform(place_key, tables.start.shape[:1], float)
    score = jnp.where(tables.start[:, 0] < FAR, score, -jnp.inf)  # not of padding
    chosen = choose_starts(score, tables.spawn_clusters, people, tables.walking_groups)
    walking_group = leaders(scenario.behavior.companions, people)
    angle = jax.random.uniform(turn_key, (people,), float, 0.0, 2 * jnp.pi)
    preferred_speed, robot_distance = draw_traits(scenario.forces, trait_key, people)
    position = tables.start[chosen]
    pedestrians = Pedestrians(
        position=position,
        velocity=jnp.zeros_like(position),
        heading=jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1),
        desired_velocity=jnp.zeros_like(position),
        group=jnp.full(people, -1, jnp.int32),
        walking_group=walking_group,
        present=present_people(scenario),
        preferred_speed=group_speeds(scenario, walking_group, preferred_speed),
        robot_distance=robot_distance,
    )
    groups = no_groups()
    goal = paths.draw_places(tables.navigation, goal_key, people)
    return pedestrians, groups, RandomMemory(*follow_leaders(walking_group, goal))


def direct(scenario: Scenario, state: State, key: Array) -> State:
    """A new goal for people who have arrived; desired velocities along the shortest paths."""
    tables: RandomTables = scenario.behavior.data
    people, places = state.pedestrians, tables.navigation.places
    gap = places[state.memory.goal] - people.position
    arrived = length(gap[:, 0], gap[:, 1]) < ARRIVED
    goal = jnp.where(arrived, paths.draw_places(tables.navigation, key, scenario.people), state.memory.goal)
    if scenario.behavior.companions is not None:
        (goal,) = follow_leaders(people.walking_group, goal)

    next_points = jax.vmap(paths.next_point_approx, in_axes=(None, 0, 0, 0))
    paths_to_goals = jax.vmap(functools.partial(paths_to_place, tables))(goal)
    ahead = next_points(tables.navigation, people.position, places[goal], paths_to_goals)
    gap = ahead - people.position
    speed = people.preferred_speed / jnp.maximum(length(gap[:, 0], gap[:, 1]), 1e-6)
    velocity = gap * speed[:, None]
    if scenario.behavior.companions is not None:
        velocity = walk_abreast(people, velocity)
    return replace(state, pedestrians=replace(people, desired_velocity=velocity), memory=RandomMemory(goal))
