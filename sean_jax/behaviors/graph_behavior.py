"""Graph-based pedestrian behavior (section IV-D): people walk, gather and disperse on the Behavior Graph.

People without a goal are first assigned to seats of group nodes, until all are taken; the rest go to random
waypoint nodes, along the cheapest path over waypoints. Whoever reaches a seat stays for a drawn duration. A seat
that somebody is still far from goes to a nearer walker who passes a node, and the farther one walks elsewhere: so
groups last although people arrive from afar. ``paths="edge"`` chooses anew at every node, as SEAN 2.0's code does.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from sean_jax import clock
from sean_jax import navigation as paths
from sean_jax.base import Array, Behavior, Environment, Groups, Pedestrians, Scenario, State
from sean_jax.behaviors import graph_goals, parties, starts
from sean_jax.behaviors.graph_goals import ARRIVED, Memory, of_seat
from sean_jax.geometry import length
from sean_jax.graph import BehaviorGraph, annotation
from sean_jax.graph.formation import formation, reach
from sean_jax.graph.spreading import crowds, spread
from sean_jax.platforms import put
from sean_jax.social_forces import draw_traits

SEATED = 0.25  # m from a seat, where the walk ends and the stay begins
SETTLING = 0.5  # s, in which the last steps to a seat are taken


@struct.dataclass
class Tables:
    """What the behavior looks up: the graph, the ways between its nodes, and where people can start."""

    graph: BehaviorGraph
    navigation: paths.Navigation
    ways: paths.Towards  # to the nodes
    start: Array  # (P, 2) m, places where somebody can start, none too close to another
    start_node: Array  # (P,) int32, the node of each
    start_weight: Array  # (P,) log of the chance
    spreading: Array | None  # () m2, how much dearer crowded edges are; None: not at all
    clumps: Array  # (C, 3) int32 starts beside one another, for parties
    together: parties.Parties = struct.field(pytree_node=False)  # how many


def build(
    folder: Path,
    environment: Environment,
    navigation: paths.Navigation,
    people: int,
    choice: str = "whole",
    spreading: float = 0.0,
    shares: tuple[float, float] = (0.0, 0.0),
) -> Behavior:
    """People walk, gather and disperse on the Behavior Graph of the environment.

    The graph is that of graph.yaml in the folder, ``choice`` a key of ``PATHS``. ``spreading`` [m2] is by how much of
    its cost an edge gets dearer for each person per m2 on it. These shares of the people walk in pairs and in triples,
    from waypoint to waypoint: parties take no seats.

    Raises:
        ValueError: the annotation has a mistake, or so many people or parties do not fit.
    """
    file = folder / "graph.yaml"
    if not file.is_file():
        raise ValueError(f"{file}: there is no such file, and behavior 'graph' needs it; write one or choose another.")
    graph = annotation.read(file, environment)
    position, capacity = np.asarray(graph.position), np.asarray(graph.capacity)
    avoid = [(position[node], reach(int(capacity[node])) + 0.6) for node in np.asarray(graph.groups)]
    start, node = starts.places(environment, navigation, graph.position, graph.radius, graph.spawn, avoid)
    groups = parties.parties(people, shares)
    most = len(start) + min(graph.seat_group.shape[0], people - groups.members)
    if people > most:
        raise ValueError(f"people: {people} do not fit on the graph of {environment.name}; the most that do is {most}.")
    weight = np.asarray(graph.spawn)[node] / np.bincount(node, minlength=len(graph.spawn))[node]
    tables = Tables(
        graph=graph,
        navigation=navigation,
        ways=paths.towards(navigation, graph.position),
        start=put(start),
        start_node=put(node.astype(np.int32)),
        start_weight=put(np.log(weight)),
        spreading=put(np.asarray(spreading)) if spreading else None,
        clumps=put(parties.clumps(navigation, start, groups)),
        together=groups,
    )
    return Behavior(data=tables, name="graph", reset=reset, direct=PATHS[choice], companions=groups.companions(people))


def reset(scenario: Scenario, key: Array) -> tuple[Pedestrians, Groups, Memory]:
    """People at their starts: seats of groups first, then places of waypoint nodes drawn by their spawn weight."""
    tables: Tables = scenario.behavior.data
    graph, people = tables.graph, scenario.people
    form_key, trait_key, place_key, stay_key, turn_key = jax.random.split(key, 5)
    center = graph.position[graph.groups]
    seat_position, seat_heading, radius, opening = formation(
        form_key, graph.capacity[graph.groups], center, graph.seat_group
    )
    seated = min(people - tables.together.members, graph.seat_group.shape[0])
    chance = tables.start_weight + jax.random.gumbel(place_key, tables.start_weight.shape, float)
    chosen = parties.places(chance, tables.clumps, people - seated, tables.together)
    party = parties.leaders(scenario.behavior.companions, people)
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
        party=party,
        present=jnp.ones(people, bool),
        preferred_speed=parties.speeds(scenario, party, preferred_speed),
        robot_distance=robot_distance,
    )
    groups = Groups(center=center, radius=radius, opening=opening, present=jnp.ones(radius.shape, bool))
    stay = jnp.concatenate([_stay(scenario, stay), jnp.zeros(people - seated, jnp.int32)])
    memory = Memory(node, node, node, position, seat, stay, seat_position, seat_heading)
    return pedestrians, groups, memory


def direct(scenario: Scenario, state: State, key: Array) -> State:
    """People keep a goal until they are there, along the cheapest path to it, as in the paper."""
    return _directed(graph_goals.whole, scenario, state, key)


def direct_edge_by_edge(scenario: Scenario, state: State, key: Array) -> State:
    """People choose anew at every node and walk one edge of the path, as in SEAN 2.0's code."""
    return _directed(graph_goals.edge, scenario, state, key)


PATHS = {"whole": direct, "edge": direct_edge_by_edge}
"""name -> how much of a path people are bound to: ``direct`` of the behavior"""


def _directed(choose: Callable, scenario: Scenario, state: State, key: Array) -> State:
    """Goals, hops and desired velocities; who stands at a seat is a member of its group."""
    tables: Tables = scenario.behavior.data
    graph, people, memory = tables.graph, state.pedestrians, state.memory
    if tables.spreading is not None:
        walking = people.present & (memory.stay == 0)
        graph = spread(graph, crowds(graph, memory.origin, memory.hop, walking), tables.spreading)
    chance = jax.random.uniform(key, (3, scenario.people), float)
    memory, free = _stay_or_leave(scenario, people, memory, graph, chance[0])
    memory = choose(graph, people, memory, free, chance[1:])
    if scenario.behavior.companions is not None:
        led = parties.follow(people.party, memory.goal, memory.hop, memory.origin, memory.target)
        memory = memory._replace(goal=led[0], hop=led[1], origin=led[2], target=led[3])
    desired_velocity = _desired_velocity(tables, people, memory)
    if scenario.behavior.companions is not None:
        desired_velocity = parties.abreast(people, desired_velocity)
    standing = memory.stay > 0
    people = replace(
        people,
        desired_velocity=desired_velocity,
        group=jnp.where(standing, of_seat(graph.seat_group, memory.seat), -1),
        heading=jnp.where(standing[:, None], of_seat(memory.seat_heading, memory.seat), people.heading),
    )
    return replace(state, pedestrians=people, memory=memory)


def _stay_or_leave(scenario, people, memory, graph, chance) -> tuple[Memory, Array]:
    """Stays that begin, go on or end; and who is (N,) bool without a goal now."""
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


def _stay(scenario: Scenario, time: Array) -> Array:
    """(N,) int32 ticks that a stay of so many seconds (N,) lasts."""
    return jnp.ceil(jnp.minimum(clock.in_ticks(time, scenario.time_step), 1e9)).astype(jnp.int32)


def _desired_velocity(tables: Tables, people: Pedestrians, memory: Memory) -> Array:
    """(N, 2) m/s: at the preferred speed to the target, or to where the way to its node bends; slower into a seat."""

    def ahead(position: Array, target: Array, hop: Array) -> Array:
        return _ahead(tables, position, target, hop) - position

    gap = jax.vmap(ahead)(people.position, memory.target, memory.hop)
    distance = length(gap[:, 0], gap[:, 1])
    at_last = (memory.seat >= 0) & (memory.hop == memory.goal)
    speed = jnp.where(at_last, jnp.minimum(people.preferred_speed, distance / SETTLING), people.preferred_speed)
    return gap * (speed / jnp.maximum(distance, 1e-6))[:, None]


def _ahead(tables: Tables, position: Array, target: Array, hop: Array) -> Array:
    """(2,) m: the target if the way to it is clear, else ahead on the way to its node."""
    navigation = tables.navigation
    clear = paths.sees(navigation.obstacles, position, target, navigation.radius * paths.CLOSE)
    return jnp.where(clear, target, paths.ahead(navigation, tables.ways, position, hop))
