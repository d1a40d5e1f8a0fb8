"""Trips on the Behavior Graph: people have an errand at each goal, come in and leave at entrances, and turn in curves.

A trip is a sequence of goals. At a waypoint a person stands for an errand, in a group for a visit of minutes, and at
an entrance the person leaves. The next goal is drawn by the weights of waypoints. It is hardly ever one of the last
two, and a walking person does not turn back for it. Where a graph has no entrance, people tour its waypoints and
groups.

The velocity that people want changes gradually. So their ways are curves, they set out and stop gently, and they turn
before they are at a node. Recorded people walk in this way (``sean validate``, checks *floors*).
"""

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Bool, Float, Int, Shaped

from sean_jax.core.data_types import Array, Pedestrians, Robot, Scenario
from sean_jax.core.geometry import length, unit
from sean_jax.graph import BehaviorGraph
from sean_jax.people.behaviors.graph_choices import ARRIVED, GraphMemory, TripMemory, first_above

CHANGE = 0.4  # m/s2, at which the velocity that people want changes
MAX_CHANGE = 0.8  # m/s2, the same in a tight curve, and where people have to slow down
MIN_GAP = 0.3  # m
BRAKING = 0.4  # m/s2, at which people slow down towards a place where they stop
PATIENCE = 3.0  # s, after which people who do not get on give their goal up
AHEAD = 1e4  # m, added to the distance of waypoints ahead of people who go back
MIN_WANTED = 0.3  # m/s; people who want to be slower wait
PROGRESS = 0.3  # of the speed that people want; slower ones do not get on
AT_ERRAND = 0.4  # m from the place of an errand
BESIDE_ROBOT = 1.5  # m from a robot, where nobody has an errand
HURRY = 3.0  # s, in which an errand ends if a robot comes
CROWDED_OUT = 0.3  # m/s, a slower person within ARRIVED of the place has the errand here, because somebody is there
BACK = -0.3  # cosine between the present and the next direction, below which a person would turn back
RECENT = 1e-3  # odds of one of the last two goals, relative to others
TURNS_BACK = 1e-6  # odds of a goal for which a person would turn back
MAX_CUT = 2.5  # m before a node, where a person who turns there turns at the earliest
ENTRANCE_GAP = 0.6  # m, to others, of a person who comes in
MISSED = 3.0  # m from a place that a person has passed by
OF_PERSON = "goal", "hop", "origin", "target", "seat", "stay"  # fields of ``GraphMemory`` with a row a person
MIN_CHOOSERS = 8  # people who choose in one step
PEOPLE_PER_CHOOSER = 8  # in larger crowds
CANDIDATES = 4  # places of a node, of which a person takes the one on the way


class Choosers(NamedTuple):
    """The people who choose in a step: a few, so that nothing is computed for those who only walk."""

    person: Int[Array, "K"]
    exists: Bool[Array, "K"]  # fewer people may choose; the other rows are of anybody
    row: Int[Array, "N"]  # of each person among the choosers
    chooses: Bool[Array, "N"]

    def rows(self, values: Shaped[Array, "N *shape"]) -> Shaped[Array, "K *shape"]:
        """The values of the choosers."""
        return values[self.person]

    def memory(self, memory: GraphMemory) -> GraphMemory:
        """The memory of the choosers."""
        assert memory.trip is not None
        people = {name: self.rows(getattr(memory, name)) for name in OF_PERSON}
        return memory._replace(**people, trip=jax.tree.map(self.rows, memory.trip))

    def update(self, memory: GraphMemory, chosen: GraphMemory) -> GraphMemory:
        """The memory of all people, with that of the choosers."""

        def new(rows: Array, old: Array) -> Array:
            chooses = self.chooses.reshape((-1,) + (1,) * (old.ndim - 1))
            return jnp.where(chooses, rows[self.row], old)

        people = {name: new(getattr(chosen, name), getattr(memory, name)) for name in OF_PERSON}
        trip = jax.tree.map(new, chosen.trip, memory.trip)
        return memory._replace(**people, trip=trip, log_chance=chosen.log_chance)


def choosers(candidates: Bool[Array, "N"]) -> Choosers:
    """The first candidates. Others choose in the next step."""
    people = candidates.shape[0]
    limit = min(people, max(MIN_CHOOSERS, people // PEOPLE_PER_CHOOSER))
    rank = jnp.cumsum(candidates, dtype=jnp.int32) - 1
    chooses = candidates & (rank < limit)
    row = jnp.clip(rank, 0, max(limit - 1, 0))
    is_chooser = chooses[None, :] & (rank[None, :] == jnp.arange(limit, dtype=jnp.int32)[:, None])  # (K, N)
    person = jnp.argmax(is_chooser, axis=1).astype(jnp.int32)
    return Choosers(person, is_chooser.any(1), row, chooses)


def begin(memory: GraphMemory, people: int) -> TripMemory:
    """People who choose a goal in the first step."""
    nowhere = jnp.full((people, 2), -1, jnp.int32)
    return TripMemory(
        errand=jnp.where(memory.seat < 0, 1, 0).astype(jnp.int32),
        visited=nowhere,
        intent=jnp.zeros((people, 2), float),
        blocked=jnp.zeros(people, float),
    )


def at_errand(memory: Any) -> Bool[Array, "N"] | bool:
    """Whether people have an errand, from the memory of any behavior; false for all if it has no trips."""
    trip = getattr(memory, "trip", None)
    return False if trip is None else trip.errand > 0


def advance_errands(
    graph: BehaviorGraph,
    people: Pedestrians,
    robot: Robot,
    memory: GraphMemory,
    chance: Float[Array, "N"],
    time_step: float,
) -> tuple[GraphMemory, Bool[Array, "N"]]:
    """Errands that begin, go on or end; and whether people have done theirs. Beside a robot nobody has one for long.

    The last tick of an errand lasts until the person chooses a goal.

    Args:
        chance: uniform from 0 to 1.
        time_step: s, of control.
    """
    assert memory.trip is not None  # of routing="trips"
    errand = memory.trip.errand
    done = errand == 1

    # Where another person stands at the place, an errand is done next to it.
    gap = memory.target - people.position  # (N, 2) m
    distance = length(gap[:, 0], gap[:, 1])
    speed = length(people.velocity[:, 0], people.velocity[:, 1])
    is_there = (distance < AT_ERRAND) | ((distance < ARRIVED) & (speed < CROWDED_OUT))
    walks_to_waypoint = (memory.seat < 0) & (memory.hop == memory.goal) & (errand == 0)
    begins = walks_to_waypoint & is_there

    limits = graph.errand[memory.goal]  # (N, 2) s
    duration = limits[:, 0] + chance * (limits[:, 1] - limits[:, 0])
    ticks = jnp.maximum(jnp.ceil(duration / time_step).astype(jnp.int32), 1)
    waiting = jnp.where(errand > 0, jnp.maximum(errand - 1, 1), 0)
    errand = jnp.where(begins, ticks, waiting)
    soon = round(HURRY / time_step)
    errand = jnp.where(_beside(people.position, robot), jnp.minimum(errand, soon), errand)
    return memory._replace(trip=memory.trip._replace(errand=errand)), done


def end_errands(memory: GraphMemory, goes_on: Bool[Array, "N"]) -> GraphMemory:
    """The memory without the errands of people who go on."""
    assert memory.trip is not None
    errand = jnp.where(goes_on, 0, memory.trip.errand)
    return memory._replace(trip=memory.trip._replace(errand=errand))


def _beside(points: Float[Array, "*batch 2"], robot: Robot) -> Bool[Array, "*batch"]:
    """Whether points [m] are so near to a robot that nobody stops there."""
    robots = jnp.reshape(robot.position, (*(1,) * (points.ndim - 1), -1, 2))  # (..., M, 2) m
    gap = points[..., None, :] - robots
    return (length(gap[..., 0], gap[..., 1]) < BESIDE_ROBOT).any(-1)


def passes(graph: BehaviorGraph, people: Pedestrians, memory: GraphMemory) -> Bool[Array, "N"]:
    """Whether people turn towards the node after the next: as far before it as their curve begins."""
    gap = memory.target - people.position  # (N, 2) m
    distance = length(gap[:, 0], gap[:, 1])
    onward = graph.position[_next_node(graph, memory)] - memory.target  # (N, 2) m
    ahead_x, ahead_y = unit(onward[:, 0], onward[:, 1])
    here_x, here_y = unit(gap[:, 0], gap[:, 1])

    # A curve of radius r that turns by an angle begins r tan(angle / 2) before the corner.
    speed_square = people.preferred_speed * people.preferred_speed
    cosine = here_x * ahead_x + here_y * ahead_y
    tangent = jnp.sqrt(jnp.maximum(1.0 - cosine, 0.0) / jnp.maximum(1.0 + cosine, 0.1))
    before = jnp.clip(speed_square / CHANGE * tangent, ARRIVED, MAX_CUT)

    # Who was pushed aside does not go back to a place that lies behind.
    missed = (distance < MISSED) & (gap[:, 0] * ahead_x + gap[:, 1] * ahead_y < -0.5)
    return ((distance < before) | missed) & (memory.hop != memory.goal)


def _next_node(graph: BehaviorGraph, memory: GraphMemory) -> Int[Array, "N"]:
    """The node after the next, or the next one if that is the goal."""
    node = graph.next_hop[memory.hop, memory.goal]
    return jnp.where(node >= 0, node, memory.hop)


@struct.dataclass
class Bearings:
    """Directions from each node to the first node on the way to others, unit vectors."""

    to_waypoints: Float[Array, "M Mw 2"]
    to_groups: Float[Array, "M G 2"]


def bearings(graph: BehaviorGraph) -> Bearings:
    """The directions in which people set out."""

    def to(goals: Int[Array, "K"]) -> Float[Array, "M K 2"]:
        first = graph.next_hop[:, goals]  # (M, K)
        first = jnp.where(first >= 0, first, goals[None, :])
        way = graph.position[first] - graph.position[:, None]  # (M, K, 2) m
        return jnp.stack(unit(way[..., 0], way[..., 1]), -1)

    return Bearings(to(graph.waypoints), to(graph.groups))


def turns_back(memory: GraphMemory, bearing: Float[Array, "M K 2"]) -> Bool[Array, "N K"]:
    """Whether people would turn back at their next node to go to each of some nodes. Who stands may go anywhere."""
    assert memory.trip is not None
    x, y = unit(memory.trip.intent[:, 0], memory.trip.intent[:, 1])
    way = bearing[memory.hop]  # (N, K, 2)
    walks = (memory.trip.errand == 0) & (memory.stay == 0)
    return walks[:, None] & (x[:, None] * way[..., 0] + y[:, None] * way[..., 1] < BACK)


def barred_groups(graph: BehaviorGraph, memory: GraphMemory, bearing: Bearings) -> Bool[Array, "N G"]:
    """The groups that people have just visited, or for which they would turn back."""
    assert memory.trip is not None
    recent = (memory.trip.visited[:, :, None] == graph.groups[None, None, :]).any(1)
    return recent | turns_back(memory, bearing.to_groups)


def goal_odds(graph: BehaviorGraph, memory: GraphMemory, bearing: Bearings) -> Float[Array, "N Mw"]:
    """The odds with which people draw each waypoint as their next goal."""
    assert memory.trip is not None
    waypoints = graph.waypoints[None, :]
    other = ((waypoints != memory.hop[:, None]) & (waypoints >= 0)).astype(float)
    weight = jnp.maximum(graph.weight[graph.waypoints], 1e-6)[None, :]
    recent = (memory.trip.visited[:, :, None] == waypoints[:, None, :]).any(1)
    odds = other * weight
    has_errand = (graph.errand[:, 1] > 0.0) | (graph.entrance > 0.0)
    odds = jnp.where(has_errand[graph.waypoints][None, :], odds, RECENT * odds)
    odds = jnp.where(recent, RECENT * odds, odds)
    return jnp.where(turns_back(memory, bearing.to_waypoints), TURNS_BACK * odds, odds)


def draw_goal(
    graph: BehaviorGraph, odds: Float[Array, "N Mw"], chance: Float[Array, "N"]
) -> tuple[Int[Array, "N"], Float[Array, "N"]]:
    """A waypoint by its odds, and the log of its chance."""
    n_waypoints = (graph.waypoints >= 0).sum(dtype=jnp.int32)
    index = first_above(jnp.cumsum(odds, axis=1), chance, n_waypoints)
    chosen = jnp.take_along_axis(odds, index[:, None], axis=1)[:, 0]
    return graph.waypoints[index], jnp.log(jnp.maximum(chosen / jnp.maximum(jnp.sum(odds, axis=1), 1e-30), 1e-30))


def remember(memory: GraphMemory, goal: Int[Array, "N"], changed: Bool[Array, "N"]) -> GraphMemory:
    """The memory with former goals of people whose goal has changed."""
    assert memory.trip is not None
    visited = jnp.stack([goal, memory.trip.visited[:, 0]], -1)
    visited = jnp.where(changed[:, None], visited, memory.trip.visited)
    return memory._replace(trip=memory.trip._replace(visited=visited))


def place_on_the_way(
    graph: BehaviorGraph,
    position: Float[Array, "N 2"],
    robot: Robot,
    memory: GraphMemory,
    chance: Float[Array, "N"],
) -> Float[Array, "N 2"]:
    """Of a few places [m] of the next node's disc the one with the shortest way over it; at a goal any place.

    At a goal no place beside a robot is taken if there is another.
    """
    places = _some_places(graph, memory.hop, chance)  # (N, K, 2) m

    # At a goal nothing lies beyond, so the first place is as good as any.
    to_place = places - position[:, None]
    beyond = graph.position[_next_node(graph, memory)][:, None] - places
    detour = length(to_place[..., 0], to_place[..., 1]) + length(beyond[..., 0], beyond[..., 1])
    beside = jnp.argmin(_beside(places, robot), axis=1)  # the first place that is not
    best = jnp.where(memory.hop == memory.goal, beside, jnp.argmin(detour, axis=1))
    return jnp.take_along_axis(places, best[:, None, None], axis=1)[:, 0]


def _some_places(graph: BehaviorGraph, node: Int[Array, "N"], chance: Float[Array, "N"]) -> Float[Array, "N K 2"]:
    """``CANDIDATES`` places [m] of the disc of each person's node."""
    n_places = graph.places.shape[1]
    first = (chance * n_places).astype(jnp.int32)
    stride = jnp.arange(CANDIDATES, dtype=jnp.int32) * (n_places // CANDIDATES + 1)
    index = (first[:, None] + stride[None, :]) % n_places  # (N, K)
    return graph.places[node[:, None], index]


def change_intent(
    memory: GraphMemory, gap: Float[Array, "N 2"], speed: Float[Array, "N"], time_step: float
) -> tuple[GraphMemory, Float[Array, "N 2"]]:
    """The memory with velocities [m/s] that have changed gradually, and these velocities.

    People slow down before a curve that is too tight for their speed.

    Args:
        gap: m, to where people want to go next.
        speed: m/s, at which they want to go there.
    """
    assert memory.trip is not None
    x, y = memory.trip.intent[:, 0], memory.trip.intent[:, 1]
    before = length(x, y)
    ahead_x, ahead_y = unit(x, y)
    way_x, way_y = unit(gap[:, 0], gap[:, 1])
    distance = jnp.maximum(length(gap[:, 0], gap[:, 1]), MIN_GAP)

    # The circle that leads from the present direction to a point has the curvature 2 sin(angle) / distance.
    cosine = ahead_x * way_x + ahead_y * way_y
    sine = jnp.where(cosine > 0.0, jnp.abs(ahead_x * way_y - ahead_y * way_x), jnp.where(before > 0.0, 1.0, 0.0))
    curvature = 2.0 * sine / distance  # 1/m
    speed = jnp.minimum(speed, jnp.sqrt(CHANGE / jnp.maximum(curvature, 1e-3)))

    # Along the way and across it: who has to may brake and turn harder.
    change_x, change_y = speed * way_x - x, speed * way_y - y
    along = change_x * ahead_x + change_y * ahead_y
    across = change_y * ahead_x - change_x * ahead_y
    most_across = jnp.clip(curvature * before * before, CHANGE, MAX_CHANGE) * time_step
    along = jnp.clip(along, -MAX_CHANGE * time_step, CHANGE * time_step)
    across = jnp.clip(across, -most_across, most_across)

    # Who stands has no direction and sets out towards the goal.
    size = length(change_x, change_y)
    start = jnp.minimum(CHANGE * time_step / jnp.maximum(size, 1e-6), 1.0)
    stands = before < 1e-3
    x = x + jnp.where(stands, start * change_x, along * ahead_x - across * ahead_y)
    y = y + jnp.where(stands, start * change_y, along * ahead_y + across * ahead_x)
    intent = jnp.stack([x, y], -1)
    return memory._replace(trip=memory.trip._replace(intent=intent)), intent


def wait(people: Pedestrians, memory: GraphMemory, time_step: float) -> tuple[GraphMemory, Bool[Array, "N"]]:
    """The memory with the time for which people have not got on, and whether they give their goal up."""
    assert memory.trip is not None
    intent = memory.trip.intent
    wanted = length(intent[:, 0], intent[:, 1])
    progress = (people.velocity * intent).sum(-1) / jnp.maximum(wanted, 1e-6)
    walks = (memory.stay == 0) & (memory.trip.errand == 0) & people.present
    is_held_up = walks & (wanted > MIN_WANTED) & (progress < PROGRESS * wanted)
    change = jnp.where(is_held_up, time_step, -2.0 * time_step)
    blocked = jnp.maximum(memory.trip.blocked + change, 0.0)
    return memory._replace(trip=memory.trip._replace(blocked=blocked)), walks & (blocked > PATIENCE)


def turn_round(
    graph: BehaviorGraph,
    position: Float[Array, "N 2"],
    memory: GraphMemory,
    chance: Float[Array, "N"],
    gives_up: Bool[Array, "N"],
) -> GraphMemory:
    """People who give up go to the nearest waypoint behind, for an errand as far as possible from what is in the way.

    Args:
        position: m.
        chance: uniform from 0 to 1.
    """
    assert memory.trip is not None
    node = _waypoint_behind(graph, position, memory.trip.intent)
    places = _some_places(graph, node, chance)  # (N, K, 2) m
    gap = places - position[:, None]
    farthest = jnp.argmax(length(gap[..., 0], gap[..., 1]), axis=1)
    place = jnp.take_along_axis(places, farthest[:, None, None], axis=1)[:, 0]
    memory = remember(memory, memory.goal, gives_up)
    assert memory.trip is not None
    return memory._replace(
        goal=jnp.where(gives_up, node, memory.goal),
        hop=jnp.where(gives_up, node, memory.hop),
        target=jnp.where(gives_up[:, None], place, memory.target),
        seat=jnp.where(gives_up, -1, memory.seat),
        trip=memory.trip._replace(blocked=jnp.where(gives_up, 0.0, memory.trip.blocked)),
    )


def _waypoint_behind(
    graph: BehaviorGraph, position: Float[Array, "N 2"], intent: Float[Array, "N 2"]
) -> Int[Array, "N"]:
    """The nearest waypoint that does not lie ahead of people who want a velocity [m/s]; the nearest if all do."""
    gap = graph.position[graph.waypoints][None, :] - position[:, None]  # (N, Mw, 2) m
    distance = length(gap[..., 0], gap[..., 1])
    ahead = (gap * intent[:, None]).sum(-1) > 0.0
    distance = jnp.where(ahead, distance + AHEAD, distance)
    return graph.waypoints[jnp.argmin(jnp.where(graph.waypoints >= 0, distance, jnp.inf), axis=1)]


def braking_speed(distance: Float[Array, "N"]) -> Float[Array, "N"]:
    """The speed [m/s] from which people stop gently within a distance [m]."""
    return jnp.sqrt(2.0 * BRAKING * jnp.maximum(distance, 1e-6))


def leave(graph: BehaviorGraph, people: Pedestrians, memory: GraphMemory) -> Pedestrians:
    """People, of whom those have left who are at an entrance that is their goal."""
    assert memory.trip is not None
    gap = memory.target - people.position  # (N, 2) m
    is_there = (memory.hop == memory.goal) & (memory.seat < 0) & (length(gap[:, 0], gap[:, 1]) < ARRIVED)

    # Who has just come in has not had a goal yet.
    had_goal = memory.trip.visited[:, 0] >= 0
    leaves = is_there & had_goal & (graph.entrance[memory.goal] > 0.0)
    velocity = jnp.where(leaves[:, None], 0.0, people.velocity)
    return replace(people, present=people.present & ~leaves, velocity=velocity)


def come_in(
    scenario: Scenario,
    graph: BehaviorGraph,
    people: Pedestrians,
    memory: GraphMemory,
    outside: Bool[Array, "N"],
    key: Array,
) -> tuple[Pedestrians, GraphMemory]:
    """People, one of whom may come in at an entrance. Arrivals are a Poisson process.

    Who finds the floor full, or somebody in the entrance, goes away.

    Args:
        outside: who may come in.
    """
    arrive_key, node_key, place_key = jax.random.split(key, 3)
    rate = jnp.sum(graph.entrance)  # people/s
    arrives = jax.random.uniform(arrive_key, (), float) < 1.0 - jnp.exp(-rate * scenario.time_step)
    share = jax.random.uniform(node_key, (1,), float)
    node = first_above(jnp.cumsum(graph.entrance)[None, :], share, graph.entrance.shape[0])[0]
    index = jax.random.randint(place_key, (), 0, graph.places.shape[1], jnp.int32)
    place = graph.places[node, index]  # (2,) m

    # The numbers of people who are never present are the last ones.
    person = jnp.arange(scenario.people, dtype=jnp.int32)
    limit = scenario.people if scenario.people_present is None else scenario.people_present
    may_come = outside & (person < limit)
    gap = people.position - place[None, :]
    is_near = people.present & (length(gap[:, 0], gap[:, 1]) < ENTRANCE_GAP)
    comes = arrives & (rate > 0.0) & may_come.any() & ~is_near.any()
    is_new = comes & (person == jnp.argmax(may_come))
    return _place(people, memory, is_new, node, place)


def _place(
    people: Pedestrians, memory: GraphMemory, is_new: Bool[Array, "N"], node: Int[Array, ""], place: Float[Array, "2"]
) -> tuple[Pedestrians, GraphMemory]:
    """People, the new ones of whom stand at a place [m] of a node and choose a goal in the next step."""
    assert memory.trip is not None
    column = is_new[:, None]
    people = replace(
        people,
        present=people.present | is_new,
        position=jnp.where(column, place[None, :], people.position),
        velocity=jnp.where(column, 0.0, people.velocity),
        desired_velocity=jnp.where(column, 0.0, people.desired_velocity),
    )
    trip = TripMemory(
        errand=jnp.where(is_new, 1, memory.trip.errand),
        visited=jnp.where(column, -1, memory.trip.visited),
        intent=jnp.where(column, 0.0, memory.trip.intent),
        blocked=jnp.where(is_new, 0.0, memory.trip.blocked),
    )
    return people, memory._replace(
        goal=jnp.where(is_new, node, memory.goal),
        hop=jnp.where(is_new, node, memory.hop),
        origin=jnp.where(is_new, node, memory.origin),
        target=jnp.where(column, place[None, :], memory.target),
        seat=jnp.where(is_new, -1, memory.seat),
        stay=jnp.where(is_new, 0, memory.stay),
        trip=trip,
    )
