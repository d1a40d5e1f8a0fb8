"""Graph-based pedestrian behavior (section IV-D): people walk, gather and disperse on the Behavior Graph.

People without a goal are first assigned to seats of group nodes, until all are taken; the rest go to random
waypoint nodes, along the cheapest path over waypoints. Whoever reaches a seat stays for a drawn duration. A person who
is still far from their seat loses it to a nearer walker who passes a node, and walks elsewhere. So groups last although
people arrive from afar. With ``routing="edge"`` people choose anew at every node, as in SEAN 2.0's code.
"""

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int

from sean_jax import clock
from sean_jax import navigation as paths
from sean_jax.base import Array, Behavior, Groups, Pedestrians, Scenario, State
from sean_jax.behaviors import graph_goals, starts
from sean_jax.behaviors.graph_goals import ARRIVED, Memory, of_seat
from sean_jax.behaviors.place import Place
from sean_jax.behaviors.walking_groups import (
    WalkingGroups,
    choose_starts,
    count_walking_groups,
    find_spawn_clusters,
    follow_leaders,
    group_speeds,
    leaders,
    walk_abreast,
)
from sean_jax.errors import InputError
from sean_jax.geometry import length
from sean_jax.graph import BehaviorGraph, annotation
from sean_jax.graph.congestion import add_congestion_cost, edge_densities
from sean_jax.graph.formation import formation, reach
from sean_jax.platforms import to_device
from sean_jax.social_forces import draw_traits

SEATED = 0.25  # m from a seat, where the walk ends and the stay begins
SETTLING = 0.5  # s, in which the last steps to a seat are taken


@struct.dataclass
class Tables:
    """What the behavior looks up: the graph, the paths between its nodes, and where people can start."""

    graph: BehaviorGraph
    navigation: paths.Navigation
    next_corners: paths.NextCornerTable  # on the way to each node
    start: Float[Array, "P 2"]  # m, places where somebody can start, none too close to another
    start_node: Int[Array, "P"]  # the node of each
    start_log_chance: Float[Array, "P"]  # log of the chance with which somebody starts there, relative to the others
    congestion_cost: Float[Array, ""] | None  # m2, see ``graph.congestion``; None: none
    spawn_clusters: Int[Array, "C 3"]  # starts beside one another, for walking groups
    walking_groups: WalkingGroups = struct.field(pytree_node=False)  # how many


def build(
    place: Place,
    people: int | None = None,
    *,
    routing: str = "whole",
    congestion_cost: float = 0.0,
    walking_groups: tuple[float, float] = (0.0, 0.0),
) -> Behavior:
    """People walk, gather and disperse on the Behavior Graph of the environment.

    Args:
        place: its folder holds ``graph.yaml``.
        people: how many; as many as the environment says if None.
        routing: a key of ``ROUTINGS``.
        congestion_cost: m2, the share by which an edge costs more for each person per m2 on it.
        walking_groups: shares of the people who walk in pairs and in triples. They walk from waypoint to waypoint and
            take no seats.

    Returns:
        The behavior, which offers "groups" to tasks if the graph has any.

    Raises:
        InputError: there is no graph, it has a mistake, or so many people or walking groups do not fit.
    """
    file = place.folder / "graph.yaml"
    if not file.is_file():
        raise InputError(f"{file}: there is no such file, and behavior 'graph' needs it; write one or choose another.")
    people = place.default_people if people is None else people
    environment, navigation = place.environment, place.navigation
    graph = annotation.read(file, environment)
    position, capacity = np.asarray(graph.position), np.asarray(graph.capacity)
    avoid = [(position[node], reach(int(capacity[node])) + 0.6) for node in np.asarray(graph.groups)]
    start, node = starts.in_discs(environment, navigation, graph.position, graph.radius, graph.spawn, avoid)
    number = count_walking_groups(people, walking_groups)
    max_people = len(start) + min(graph.seat_group.shape[0], people - number.members)
    if people > max_people:
        where = f"on the graph of {environment.name}"
        raise InputError(f"people: {people} do not fit {where}; the most that do is {max_people}.")
    start_chance = np.asarray(graph.spawn)[node] / np.bincount(node, minlength=len(graph.spawn))[node]
    tables = Tables(
        graph=graph,
        navigation=navigation,
        next_corners=paths.build_next_corner_table(navigation, graph.position),
        start=to_device(start),
        start_node=to_device(node.astype(np.int32)),
        start_log_chance=to_device(np.log(start_chance)),
        congestion_cost=to_device(np.asarray(congestion_cost)) if congestion_cost else None,
        spawn_clusters=to_device(find_spawn_clusters(navigation, start, number)),
        walking_groups=number,
    )
    return Behavior(
        data=tables,
        name="graph",
        reset=reset,
        direct=ROUTINGS[routing],
        companions=number.companions(people),
        people=people,
        offers=("groups",) if len(graph.groups) else (),
    )


def reset(scenario: Scenario, key: Array) -> tuple[Pedestrians, Groups, Memory]:
    """People at their starts: seats of groups first, then places of waypoint nodes drawn by their spawn chance.

    Args:
        scenario: of this behavior.
        key: of the draws.

    Returns:
        N people, the G groups of the graph, and where each person is on it.
    """
    tables: Tables = scenario.behavior.data
    graph, people = tables.graph, scenario.people
    form_key, trait_key, place_key, stay_key, turn_key = jax.random.split(key, 5)
    center = graph.position[graph.groups]
    seat_position, seat_heading, radius, opening = formation(
        form_key, graph.capacity[graph.groups], center, graph.seat_group
    )
    seated = min(people - tables.walking_groups.members, graph.seat_group.shape[0])
    log_chance = tables.start_log_chance
    score = log_chance + jax.random.gumbel(place_key, log_chance.shape, float)
    chosen = choose_starts(score, tables.spawn_clusters, people - seated, tables.walking_groups)
    walking_group = leaders(scenario.behavior.companions, people)
    angle = jax.random.uniform(turn_key, (people - seated,), float, 0.0, 2 * jnp.pi)
    facing = jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1)
    position = jnp.concatenate([seat_position[:seated], tables.start[chosen]])
    node = jnp.concatenate([graph.seat_node[:seated], tables.start_node[chosen]])
    seat = jnp.concatenate([jnp.arange(seated, dtype=jnp.int32), jnp.full(people - seated, -1, jnp.int32)])
    limits = graph.stay[graph.seat_node[:seated]]
    share = jax.random.uniform(stay_key, (2, seated), float)
    stay = share[1] * (limits[:, 0] + share[0] * (limits[:, 1] - limits[:, 0]))  # some have been there for a while
    preferred_speed, robot_distance = draw_traits(scenario.forces, trait_key, people)
    pedestrians = Pedestrians(
        position=position,
        velocity=jnp.zeros_like(position),
        heading=jnp.concatenate([seat_heading[:seated], facing]),
        desired_velocity=jnp.zeros_like(position),
        group=jnp.where(seat >= 0, of_seat(graph.seat_group, seat), -1),
        walking_group=walking_group,
        present=jnp.ones(people, bool),
        preferred_speed=group_speeds(scenario, walking_group, preferred_speed),
        robot_distance=robot_distance,
    )
    groups = Groups(center=center, radius=radius, opening=opening, present=jnp.ones(radius.shape, bool))
    stay = jnp.concatenate([_stay(scenario, stay), jnp.zeros(people - seated, jnp.int32)])
    memory = Memory(node, node, node, position, seat, stay, seat_position, seat_heading)
    return pedestrians, groups, memory


def direct(scenario: Scenario, state: State, key: Array) -> State:
    """People keep a goal until they are there, along the cheapest path to it, as in the paper.

    Args:
        scenario: of this behavior.
        state: before the step.
        key: of the draws.

    Returns:
        The state with new desired velocities, group members and memory.
    """
    return _directed(graph_goals.whole, scenario, state, key)


def direct_edge_by_edge(scenario: Scenario, state: State, key: Array) -> State:
    """People choose anew at every node and walk one edge of the path, as in SEAN 2.0's code.

    Args:
        scenario: of this behavior.
        state: before the step.
        key: of the draws.

    Returns:
        The state with new desired velocities, group members and memory.
    """
    return _directed(graph_goals.edge, scenario, state, key)


ROUTINGS = {"whole": direct, "edge": direct_edge_by_edge}
"""name -> how much of a path people are bound to: ``direct`` of the behavior"""


def _directed(choose: Callable, scenario: Scenario, state: State, key: Array) -> State:
    """Goals, hops and desired velocities. Whoever stands at a seat is a member of its group."""
    tables: Tables = scenario.behavior.data
    graph, people, memory = tables.graph, state.pedestrians, state.memory
    if tables.congestion_cost is not None:
        walking = people.present & (memory.stay == 0)
        density = edge_densities(graph, memory.origin, memory.hop, walking)
        graph = add_congestion_cost(graph, density, tables.congestion_cost)
    chance = jax.random.uniform(key, (3, scenario.people), float)
    memory, free = _stay_or_leave(scenario, people, memory, graph, chance[0])
    memory = choose(graph, people, memory, free, chance[1:])
    if scenario.behavior.companions is not None:
        goal, hop, origin, target = follow_leaders(
            people.walking_group, memory.goal, memory.hop, memory.origin, memory.target
        )
        memory = memory._replace(goal=goal, hop=hop, origin=origin, target=target)
    desired_velocity = _desired_velocity(tables, people, memory)
    if scenario.behavior.companions is not None:
        desired_velocity = walk_abreast(people, desired_velocity)
    standing = memory.stay > 0
    people = replace(
        people,
        desired_velocity=desired_velocity,
        group=jnp.where(standing, of_seat(graph.seat_group, memory.seat), -1),
        heading=jnp.where(standing[:, None], of_seat(memory.seat_heading, memory.seat), people.heading),
    )
    return replace(state, pedestrians=people, memory=memory)


def _stay_or_leave(
    scenario: Scenario, people: Pedestrians, memory: Memory, graph: BehaviorGraph, chance: Float[Array, "N"]
) -> tuple[Memory, Bool[Array, "N"]]:
    """Stays that begin, go on or end; and (N,) who has no goal now."""
    gap = memory.target - people.position
    distance = length(gap[:, 0], gap[:, 1])
    was_standing = memory.stay > 0
    stay = jnp.maximum(memory.stay - 1, 0)
    at_last = memory.hop == memory.goal
    sits_down = ~was_standing & (memory.seat >= 0) & at_last & (distance < SEATED)
    limits = graph.stay[of_seat(graph.seat_node, memory.seat)]
    drawn = _stay(scenario, limits[:, 0] + chance * (limits[:, 1] - limits[:, 0]))
    stay = jnp.where(sits_down, drawn, stay)
    leaves = (was_standing | sits_down) & (stay == 0)  # at once, if the stay that was drawn takes no time
    at_waypoint = ~was_standing & (memory.seat < 0) & at_last & (distance < ARRIVED)
    return memory._replace(stay=stay), leaves | at_waypoint


def _stay(scenario: Scenario, time: Float[Array, "*shape"]) -> Int[Array, "*shape"]:
    """Ticks (...) of stays of so many seconds (...)."""
    return jnp.ceil(jnp.minimum(clock.to_ticks(time, scenario.time_step), 1e9)).astype(jnp.int32)


def _desired_velocity(tables: Tables, people: Pedestrians, memory: Memory) -> Float[Array, "N 2"]:
    """(N, 2) m/s at the preferred speed to the target, or to the next corner on the way there; slower into a seat."""

    def gap_ahead(position: Array, target: Array, hop: Array) -> Array:
        return _aim(tables, position, target, hop) - position

    gap = jax.vmap(gap_ahead)(people.position, memory.target, memory.hop)
    distance = length(gap[:, 0], gap[:, 1])
    at_last = (memory.seat >= 0) & (memory.hop == memory.goal)
    speed = jnp.where(at_last, jnp.minimum(people.preferred_speed, distance / SETTLING), people.preferred_speed)
    return gap * (speed / jnp.maximum(distance, 1e-6))[:, None]


def _aim(
    tables: Tables, position: Float[Array, "2"], target: Float[Array, "2"], hop: Int[Array, ""]
) -> Float[Array, "2"]:
    """(2,) m: the target if the way to it is clear, else the next corner on the way to its node."""
    navigation = tables.navigation
    clear = paths.segment_is_free(navigation.obstacles, position, target, navigation.radius * paths.CLOSE)
    return jnp.where(clear, target, paths.next_corner(navigation, tables.next_corners, position, hop))
