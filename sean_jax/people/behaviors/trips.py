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

from sean_jax.core import clock
from sean_jax.core.data_types import Array, Pedestrians, Robot, Scenario, State
from sean_jax.core.geometry import length, unit
from sean_jax.graph import BehaviorGraph
from sean_jax.people.behaviors import graph_choices
from sean_jax.people.behaviors.graph_choices import ARRIVED, GraphMemory, TripMemory, first_above, next_nodes, taste_of
from sean_jax.people.behaviors.starts import follow_leaders
from sean_jax.social_forces.forces import components
from sean_jax.social_forces.walls import limit_approach

CHANGE = 0.28  # m/s2, at which the velocity that people want changes
MAX_CHANGE = 0.55  # m/s2, the same in a tight curve, and where people have to slow down
STOPPING_TIME = 1.25  # s before a wall, from where people do not want to go on towards it
MAX_LEAD = 0.25  # m/s, by which people want to be faster than they get on ...
MIN_PUSH = 0.6  # m/s, ... but in a crowd at least this fast
MIN_GAP = 0.3  # m, shortest distance for which a curve is computed
BRAKING = 0.32  # m/s2, at which people slow down towards a place where they stop
RETREAT = 1.5  # m, at least, that people who give up go back
PATIENCE = 2.0  # s, after which people who do not get on give their goal up ...
PATIENCE_AT_ROBOT = 1.0  # s, ... and beside a robot
AHEAD_PENALTY = 1e4  # m, added to the distance of waypoints ahead of people who go back, and of the one given up ...
ELSEWHERE_PENALTY = 1e3  # m, ... and of those without an edge to the last node, which may lie beyond a wall
MIN_WANTED = 0.3  # m/s; people who want to be slower wait
MIN_PROGRESS = 0.3  # of the speed that people want; slower ones do not get on
AT_ERRAND = 0.4  # m from the place of an errand
BESIDE_ROBOT = 1.5  # m from a robot, where nobody has an errand
HURRY_TIME = 1.0  # s, in which an errand ends if a robot comes
CROWDED_OUT = 0.3  # m/s, a slower person within ARRIVED of the place has the errand here, because somebody is there
MIN_COSINE = -0.3  # between the present and the next direction, below which a person would turn back
RECENT_ODDS = 1e-3  # of one of the last two goals, or of a waypoint without errands, relative to others
TURN_BACK_ODDS = 1e-6  # of a goal for which a person would turn back, relative to others
MAX_CUT = 2.5  # m before a node, where a person who turns there turns at the earliest
MAX_GROUP = 3  # people of a walking group
ENTRANCE_GAP = 0.6  # m, to others, of a person who comes in
BUS_STOP = 30.0  # s, for which the passengers of a bus try to come in
MISSED = 3.0  # m from a place that a person has passed by
MISSED_BEHIND = 0.5  # m, at least, that this place lies behind
MIN_CHOOSERS = 5  # people who choose in one step
PEOPLE_PER_CHOOSER = 8  # in larger crowds
CHOICES = "goal", "hop", "origin", "target", "seat"  # fields of ``GraphMemory`` that people choose
TRIP_CHOICES = "errand", "visited", "blocked"  # fields of ``TripMemory`` that change with a choice
CANDIDATES = 5  # places of a node, of which a person takes the one on the way; a GPU takes longer for 4


class Chances(NamedTuple):
    """Uniform numbers from 0 to 1 of one step."""

    duration: Float[Array, "N"]  # of a stay or an errand that begins
    goal: Float[Array, "K"]  # of people who choose
    place: Float[Array, "K"]  # at their next node
    back: Float[Array, "K"]  # place of people who give up
    arrival: Float[Array, "4"]  # whether somebody comes, who, at which entrance and where there


def draw(key: Array, people: int) -> Chances:
    """The numbers of one step."""
    # One call, because each call is a program of its own on a GPU.
    limit = max_choosers(people)
    numbers = jax.random.uniform(key, (people + 3 * limit + 4,), float)
    ends = people, people + limit, people + 2 * limit, people + 3 * limit
    return Chances(*jnp.split(numbers, ends))


class Choosers(NamedTuple):
    """The K people who choose in a step: a few of all N, so that nothing is computed for those who only walk."""

    person: Int[Array, "K"]
    exists: Bool[Array, "K"]  # fewer people may choose; the other rows are of anybody
    row: Int[Array, "N"]  # of each person among the choosers
    chooses: Bool[Array, "N"]

    def rows(self, values: Shaped[Array, "N *shape"]) -> Shaped[Array, "K *shape"]:
        """The values of the choosers."""
        return values[self.person]

    def update(self, memory: GraphMemory, chosen: GraphMemory) -> GraphMemory:
        """The memory of all people, with what the choosers have chosen."""
        assert memory.trip is not None and chosen.trip is not None
        choices = self._updated(memory, chosen, CHOICES)
        trip_choices = self._updated(memory.trip, chosen.trip, TRIP_CHOICES)
        return memory._replace(**choices, log_chance=chosen.log_chance).with_trip(**trip_choices)

    def _updated(self, memory: NamedTuple, chosen: NamedTuple, names: tuple[str, ...]) -> dict[str, Array]:
        """Fields of a memory of all people, with the rows of the choosers."""
        fields = {}
        for name in names:
            values = getattr(memory, name)
            shape = (-1,) + (1,) * (values.ndim - 1)
            chooses = self.chooses.reshape(shape)
            fields[name] = jnp.where(chooses, getattr(chosen, name)[self.row], values)
        return fields


def max_choosers(people: int) -> int:
    """How many people choose in one step at most."""
    limit = max(MIN_CHOOSERS, people // PEOPLE_PER_CHOOSER)
    return min(people, limit)


def choosers(candidates: Bool[Array, "N"]) -> Choosers:
    """The first candidates. Others choose in the next step."""
    limit = max_choosers(candidates.shape[0])
    rank = jnp.cumsum(candidates, dtype=jnp.int32) - 1  # (N,)
    chooses = candidates & (rank < limit)
    row = jnp.clip(rank, 0, max(limit - 1, 0))

    # The person of row k is the first with rank k, so the index is the number of people with a lower rank. Rows that
    # nobody has are of the last person.
    rows = jnp.arange(limit, dtype=jnp.int32)
    is_before = rank[None, :] < rows[:, None]  # (K, N)
    n_before = is_before.sum(1, dtype=jnp.int32)
    exists = n_before < candidates.shape[0]
    person = jnp.minimum(n_before, max(candidates.shape[0] - 1, 0))
    return Choosers(person, exists, row, chooses)


def begin(graph: BehaviorGraph, memory: GraphMemory, people: int, key: Array) -> TripMemory:
    """The memory at the start of an episode: people without a seat choose a goal in the first step."""
    errand = jnp.where(memory.seat < 0, 1, 0)
    taste = None
    if graph.tastes is not None:
        n_tastes = graph.tastes.factor.shape[0]
        taste = jax.random.randint(key, (people,), 0, n_tastes, jnp.int32)
    return TripMemory(
        errand=errand.astype(jnp.int32),
        visited=jnp.full((people, 2), -1, jnp.int32),
        intent=jnp.zeros((people, 2), float),
        blocked=jnp.zeros(people, float),
        taste=taste,
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
    errand = memory.trip.errand  # (N,) ticks
    done = errand == 1

    # Where another person stands at the place, an errand is done next to it. Who has left has none: a walking group
    # would copy it from its leader, and stand for ever.
    distance = graph_choices.target_distance(people, memory)
    speed = length(*components(people.velocity))
    is_crowded_out = (distance < ARRIVED) & (speed < CROWDED_OUT)
    is_there = (distance < AT_ERRAND) | is_crowded_out
    walks_to_waypoint = (memory.seat < 0) & (memory.hop == memory.goal) & (errand == 0)
    begins = walks_to_waypoint & is_there & people.present

    # A new errand takes one tick or more, uniform between the limits of its waypoint.
    shortest, longest = components(graph.errand[memory.goal])  # (N,) s
    duration = shortest + chance * (longest - shortest)
    new_errand = jnp.ceil(duration / time_step).astype(jnp.int32)
    new_errand = jnp.maximum(new_errand, 1)
    ticks_left = jnp.maximum(errand - 1, 1)
    ticks_left = jnp.where(errand > 0, ticks_left, 0)
    errand = jnp.where(begins, new_errand, ticks_left)

    # Who stands beside a robot hurries.
    hurried = jnp.minimum(errand, round(HURRY_TIME / time_step))
    errand = jnp.where(_is_beside(robot, people.position), hurried, errand)
    return memory.with_trip(errand=errand), done


def end_errands(memory: GraphMemory, goes_on: Bool[Array, "N"]) -> GraphMemory:
    """The memory without the errands of people who go on."""
    assert memory.trip is not None
    errand = jnp.where(goes_on, 0, memory.trip.errand)
    return memory.with_trip(errand=errand)


def _is_beside(robot: Robot, points: Float[Array, "*batch 2"]) -> Bool[Array, "*batch"]:
    """Whether points [m] are so near to a robot that nobody stops there."""
    batch = (1,) * (points.ndim - 1)
    robots = jnp.reshape(robot.position, (*batch, -1, 2))  # (..., M, 2) m
    gap = points[..., None, :] - robots
    is_near = length(*components(gap)) < BESIDE_ROBOT
    return is_near.any(-1)


def passes(graph: BehaviorGraph, people: Pedestrians, memory: GraphMemory) -> Bool[Array, "N"]:
    """Whether people turn towards the node after the next: as far before it as their curve begins."""
    gap = memory.target - people.position  # (N, 2) m
    distance = length(*components(gap))
    onward = graph.position[_node_after_hop(graph, memory)] - memory.target  # (N, 2) m
    onward_x, onward_y = unit(*components(onward))
    direction_x, direction_y = unit(*components(gap))

    # A curve of radius r that turns by an angle begins r tan(angle / 2) before the corner.
    cosine = direction_x * onward_x + direction_y * onward_y
    tangent_square = jnp.maximum(1.0 - cosine, 0.0) / jnp.maximum(1.0 + cosine, 0.1)
    radius = people.preferred_speed * people.preferred_speed / CHANGE
    curve_begin = radius * jnp.sqrt(tangent_square)
    curve_begin = jnp.clip(curve_begin, ARRIVED, MAX_CUT)  # m before the target

    # Who was pushed aside does not go back to a place that lies behind.
    ahead = gap[:, 0] * onward_x + gap[:, 1] * onward_y  # m
    has_missed = (distance < MISSED) & (ahead < -MISSED_BEHIND)
    turns = (distance < curve_begin) | has_missed
    return turns & (memory.hop != memory.goal)


def _node_after_hop(graph: BehaviorGraph, memory: GraphMemory) -> Int[Array, "N"]:
    """The node after the next, or the next one if that is the goal."""
    node = next_nodes(graph, memory, memory.hop, memory.goal)
    return jnp.where(node >= 0, node, memory.hop)


@struct.dataclass
class Bearings:
    """Directions from each node to the first node on the way to others, unit vectors."""

    to_waypoints: Float[Array, "T M Mw 2"]  # by each taste, or with T = 1 on the cheapest path
    to_groups: Float[Array, "T M G 2"]


def bearings(graph: BehaviorGraph) -> Bearings:
    """The directions in which people set out."""
    to_waypoints = _bearings_to(graph, graph.waypoints)
    to_groups = _bearings_to(graph, graph.groups)
    return Bearings(to_waypoints, to_groups)


def _bearings_to(graph: BehaviorGraph, goals: Int[Array, "K"]) -> Float[Array, "T M K 2"]:
    """Unit vectors from each node to the first node on the way to each goal."""
    next_hop = graph.next_hop[None] if graph.tastes is None else graph.tastes.next_hop
    first = next_hop[:, :, goals]  # (T, M, K)
    first = jnp.where(first >= 0, first, goals[None, None, :])
    way = graph.position[first] - graph.position[None, :, None]  # (T, M, K, 2) m
    return jnp.stack(unit(*components(way)), -1)


def turns_back(memory: GraphMemory, bearing: Float[Array, "T M K 2"]) -> Bool[Array, "N K"]:
    """Whether people would turn back at their next node to go to each of some nodes. Who stands may go anywhere.

    Args:
        bearing: unit vectors from each node towards these nodes, see ``Bearings``.
    """
    assert memory.trip is not None
    intent_x, intent_y = components(memory.trip.intent)
    x, y = unit(intent_x, intent_y)
    taste = taste_of(memory)
    taste = jnp.zeros_like(memory.hop) if taste is None else taste
    way_x, way_y = components(bearing[taste, memory.hop])  # (N, K)
    cosine = x[:, None] * way_x + y[:, None] * way_y

    # Who rises from a seat has neither a stay nor an errand any more, and stands at the goal.
    rises = (memory.hop == memory.goal) & (length(intent_x, intent_y) < MIN_WANTED)
    walks = (memory.trip.errand == 0) & (memory.stay == 0) & ~rises
    return walks[:, None] & (cosine < MIN_COSINE)


def barred_groups(graph: BehaviorGraph, memory: GraphMemory, bearing: Bearings) -> Bool[Array, "N G"]:
    """The groups that people have just visited, or for which they would turn back."""
    return _is_recent(memory, graph.groups) | turns_back(memory, bearing.to_groups)


def _is_recent(memory: GraphMemory, nodes: Int[Array, "K"]) -> Bool[Array, "N K"]:
    """Whether each of some nodes is one of the last two goals of each person."""
    assert memory.trip is not None
    is_goal = memory.trip.visited[:, :, None] == nodes[None, None, :]  # (N, 2, K)
    return is_goal.any(1)


def goal_odds(graph: BehaviorGraph, memory: GraphMemory, bearing: Bearings) -> Float[Array, "N Mw"]:
    """The odds with which people draw each waypoint as their next goal."""
    odds = graph_choices.waypoint_odds(graph, memory.hop)

    # Waypoints for which people hardly ever have a reason, then those that do not lie on their way.
    has_errand = (graph.errand[:, 1] > 0.0) | (graph.entrance > 0.0)  # (M,)
    odds = jnp.where(has_errand[graph.waypoints][None, :], odds, RECENT_ODDS * odds)
    odds = jnp.where(_is_recent(memory, graph.waypoints), RECENT_ODDS * odds, odds)
    return jnp.where(turns_back(memory, bearing.to_waypoints), TURN_BACK_ODDS * odds, odds)


def remember(memory: GraphMemory, goal: Int[Array, "N"], changed: Bool[Array, "N"]) -> GraphMemory:
    """The memory with former goals of people whose goal has changed."""
    assert memory.trip is not None
    last_goal = memory.trip.visited[:, 0]
    visited = jnp.stack([goal, last_goal], -1)  # (N, 2)
    visited = jnp.where(changed[:, None], visited, memory.trip.visited)
    return memory.with_trip(visited=visited)


def place_on_the_way(
    graph: BehaviorGraph,
    position: Float[Array, "N 2"],
    robot: Robot,
    memory: GraphMemory,
    chance: Float[Array, "N"],
) -> Float[Array, "N 2"]:
    """Of a few places [m] of the next node's disc the one with the shortest way over it; at a goal any place.

    At a goal no place beside a robot is taken if there is another.

    Args:
        position: m.
        chance: uniform from 0 to 1.
    """
    places = _some_places(graph, memory.hop, chance)  # (N, K, 2) m
    to_place = places - position[:, None]
    node_after = _node_after_hop(graph, memory)
    from_place = graph.position[node_after][:, None] - places
    detour = length(*components(to_place)) + length(*components(from_place))  # (N, K) m

    # At a goal nothing lies beyond, so the first place is as good as any.
    shortest = jnp.argmin(detour, axis=1)
    first_without_robot = jnp.argmin(_is_beside(robot, places), axis=1)
    index = jnp.where(memory.hop == memory.goal, first_without_robot, shortest)
    return _place_of_each(places, index)


def _place_of_each(places: Float[Array, "N K 2"], index: Int[Array, "N"]) -> Float[Array, "N 2"]:
    """The place [m] of each person with that person's index."""
    return jnp.take_along_axis(places, index[:, None, None], axis=1)[:, 0]


def _some_places(graph: BehaviorGraph, node: Int[Array, "N"], chance: Float[Array, "N"]) -> Float[Array, "N K 2"]:
    """``CANDIDATES`` places [m] of the disc of each person's node, the first by a uniform number from 0 to 1."""
    n_places = graph.places.shape[1]
    first = (chance * n_places).astype(jnp.int32)
    stride = n_places // CANDIDATES + 1
    offset = jnp.arange(CANDIDATES, dtype=jnp.int32) * stride
    index = (first[:, None] + offset[None, :]) % n_places  # (N, K)
    return graph.places[node[:, None], index]


def change_intent(
    memory: GraphMemory, gap: Float[Array, "N 2"], speed: Float[Array, "N"], time_step: float
) -> tuple[GraphMemory, Float[Array, "N 2"]]:
    """The memory with velocities [m/s] that have changed gradually, and these velocities.

    People slow down before a curve that is too tight for their speed.

    Args:
        gap: m, to where people want to go next.
        speed: m/s, at which they want to go there.
        time_step: s, of control.
    """
    assert memory.trip is not None
    x, y = components(memory.trip.intent)
    present_speed = length(x, y)
    ahead_x, ahead_y = unit(x, y)
    way_x, way_y = unit(*components(gap))

    # A tight curve is walked slowly.
    curvature = _curvature(memory.trip.intent, gap)  # (N,) 1/m
    curve_speed = jnp.sqrt(CHANGE / jnp.maximum(curvature, 1e-3))
    speed = jnp.minimum(speed, curve_speed)
    change_x = speed * way_x - x
    change_y = speed * way_y - y

    # Along the present direction and across it, to the left: who has to may brake and turn harder.
    along = change_x * ahead_x + change_y * ahead_y
    along = jnp.clip(along, -MAX_CHANGE * time_step, CHANGE * time_step)
    across = change_y * ahead_x - change_x * ahead_y
    max_across = jnp.clip(curvature * present_speed * present_speed, CHANGE, MAX_CHANGE) * time_step
    across = jnp.clip(across, -max_across, max_across)
    turned_x = along * ahead_x - across * ahead_y
    turned_y = along * ahead_y + across * ahead_x

    # Who stands has no direction and sets out towards the goal.
    change = length(change_x, change_y)
    share = jnp.minimum(CHANGE * time_step / jnp.maximum(change, 1e-6), 1.0)
    stands = present_speed < 1e-3
    x = x + jnp.where(stands, share * change_x, turned_x)
    y = y + jnp.where(stands, share * change_y, turned_y)
    intent = jnp.stack([x, y], -1)
    return memory.with_trip(intent=intent), intent


def held_up_speed(people: Pedestrians, memory: GraphMemory, speed: Float[Array, "N"]) -> Float[Array, "N"]:
    """Speeds [m/s] that people want, lower for those whom others hold up: then they set out gently when they are free.

    Args:
        speed: m/s, that they want alone.
    """
    assert memory.trip is not None
    ahead_x, ahead_y = unit(*components(memory.trip.intent))
    velocity_x, velocity_y = components(people.velocity)
    progress = velocity_x * ahead_x + velocity_y * ahead_y
    limit = jnp.maximum(progress + MAX_LEAD, MIN_PUSH)
    return jnp.minimum(speed, limit)


def stop_before_walls(
    scenario: Scenario, people: Pedestrians, memory: GraphMemory, intent: Float[Array, "N 2"]
) -> tuple[GraphMemory, Float[Array, "N 2"]]:
    """The memory, and velocities [m/s] that do not approach an obstacle on the way faster than its gap allows.

    A curve that is as wide as people want it may not fit into the room.
    """
    position_x, position_y = components(people.position)
    intent_x, intent_y = components(intent)
    grid = scenario.environment.obstacle_grid
    radius = scenario.forces.walking.radius
    x, y = limit_approach(position_x, position_y, intent_x, intent_y, grid, radius, STOPPING_TIME)
    intent = jnp.stack([x, y], -1)
    return memory.with_trip(intent=intent), intent


def _curvature(intent: Float[Array, "N 2"], gap: Float[Array, "N 2"]) -> Float[Array, "N"]:
    """Curvatures [1/m] of the circles that lead from velocities [m/s] over gaps [m]: 2 sin(angle) / distance.

    A point behind has the curvature of a point beside; who stands needs no curve.
    """
    ahead_x, ahead_y = unit(*components(intent))
    way_x, way_y = unit(*components(gap))
    cosine = ahead_x * way_x + ahead_y * way_y
    sine = jnp.abs(ahead_x * way_y - ahead_y * way_x)

    walks = length(*components(intent)) > 0.0
    sine_behind = jnp.where(walks, 1.0, 0.0)
    sine = jnp.where(cosine > 0.0, sine, sine_behind)
    distance = jnp.maximum(length(*components(gap)), MIN_GAP)
    return 2.0 * sine / distance


def wait(
    people: Pedestrians, robot: Robot, memory: GraphMemory, time_step: float
) -> tuple[GraphMemory, Bool[Array, "N"]]:
    """The memory with the time for which people have not got on, and whether they give their goal up.

    Args:
        time_step: s, of control.
    """
    assert memory.trip is not None
    x, y = components(memory.trip.intent)
    velocity_x, velocity_y = components(people.velocity)
    wanted_speed = length(x, y)
    speed_ahead = (velocity_x * x + velocity_y * y) / jnp.maximum(wanted_speed, 1e-6)
    walks = (memory.stay == 0) & (memory.trip.errand == 0) & people.present

    # Time without progress counts, and is forgotten twice as fast.
    is_held_up = walks & (wanted_speed > MIN_WANTED) & (speed_ahead < MIN_PROGRESS * wanted_speed)
    change = jnp.where(is_held_up, time_step, -2.0 * time_step)
    blocked = jnp.maximum(memory.trip.blocked + change, 0.0)
    patience = jnp.where(_is_beside(robot, people.position), PATIENCE_AT_ROBOT, PATIENCE)
    gives_up = walks & (blocked > patience)
    return memory.with_trip(blocked=blocked), gives_up


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
    node = _waypoint_behind(graph, position, memory.trip.intent, memory)
    places = _some_places(graph, node, chance)  # (N, K, 2) m
    gap = places - position[:, None]
    farthest = jnp.argmax(length(*components(gap)), axis=1)
    place = _place_of_each(places, farthest)

    # The goal that is given up counts as visited, so it is hardly ever the next one.
    blocked = jnp.where(gives_up, 0.0, memory.trip.blocked)
    memory = remember(memory, memory.goal, gives_up).with_trip(blocked=blocked)
    return memory._replace(
        goal=jnp.where(gives_up, node, memory.goal),
        hop=jnp.where(gives_up, node, memory.hop),
        target=jnp.where(gives_up[:, None], place, memory.target),
        seat=jnp.where(gives_up, -1, memory.seat),
    )


def _waypoint_behind(
    graph: BehaviorGraph, position: Float[Array, "N 2"], intent: Float[Array, "N 2"], memory: GraphMemory
) -> Int[Array, "N"]:
    """The nearest waypoint that does not lie ahead of people who want a velocity [m/s]; the nearest if all do.

    A waypoint within ``RETREAT`` is too near what is in the way. The last node and its neighbors come first: others
    may lie beyond a wall, and the way there through what is in the way. So may the goal that people give up.
    """
    waypoints = graph.waypoints
    gap = graph.position[waypoints][None, :] - position[:, None]  # (N, Mw, 2) m
    gap_x, gap_y = components(gap)
    intent_x, intent_y = components(intent[:, None])
    distance = length(gap_x, gap_y)
    is_ahead = (gap_x * intent_x + gap_y * intent_y > 0.0) | (distance < RETREAT)
    is_given_up = waypoints[None, :] == memory.goal[:, None]
    is_origin = waypoints[None, :] == memory.origin[:, None]
    is_near_origin = is_origin | jnp.isfinite(graph.edge_cost[memory.origin][:, waypoints])
    distance = jnp.where(is_near_origin, distance, distance + ELSEWHERE_PENALTY)
    distance = jnp.where(is_ahead | is_given_up, distance + AHEAD_PENALTY, distance)
    distance = jnp.where(waypoints >= 0, distance, jnp.inf)
    nearest = jnp.argmin(distance, axis=1)
    return waypoints[nearest]


def braking_speed(distance: Float[Array, "N"]) -> Float[Array, "N"]:
    """The speed [m/s] from which people stop gently within a distance [m]."""
    return jnp.sqrt(2.0 * BRAKING * jnp.maximum(distance, 1e-6))


def leave(graph: BehaviorGraph, people: Pedestrians, memory: GraphMemory) -> Pedestrians:
    """People, of whom those have left who are at an entrance that is their goal. A walking group leaves together."""
    assert memory.trip is not None
    walks_to_waypoint = (memory.hop == memory.goal) & (memory.seat < 0)
    is_there = walks_to_waypoint & (graph_choices.target_distance(people, memory) < ARRIVED)

    # Who has just come in has not had a goal yet.
    had_goal = memory.trip.visited[:, 0] >= 0
    is_entrance = graph.entrance[memory.goal] > 0.0
    leaves = is_there & had_goal & is_entrance
    (leaves,) = follow_leaders(people.walking_group, leaves)
    velocity = jnp.where(leaves[:, None], 0.0, people.velocity)
    return replace(people, present=people.present & ~leaves, velocity=velocity)


class Arrival(NamedTuple):
    """Who comes to an entrance in a step: somebody or nobody, on foot or from a bus."""

    node: Int[Array, ""]  # the entrance
    exists: Bool[Array, ""]
    passengers: Int[Array, "B"]  # who have still to come in
    of_bus: Bool[Array, "B"]  # from which the person comes, of none on foot


def arrival(
    graph: BehaviorGraph,
    memory: GraphMemory,
    tick: Float[Array, ""],
    time_step: float,
    chance: Float[Array, "2"],
) -> Arrival:
    """Who comes to which entrance. Those on foot are a Poisson process; in other steps passengers get off.

    Args:
        tick: of the episode.
        time_step: s, of control.
        chance: uniform from 0 to 1.
    """
    assert memory.passengers is not None  # of routing="trips"
    arrival_chance, node_chance = chance
    rates = _rates(graph, tick * time_step)  # (M,) people/s
    rate = jnp.sum(rates)
    exists = (rate > 0.0) & (arrival_chance < 1.0 - jnp.exp(-rate * time_step))
    cumulative = jnp.cumsum(rates)[None, :]  # (1, M)
    node = first_above(cumulative, node_chance[None], rates.shape[0])[0]
    n_buses = memory.passengers.shape[0]
    if n_buses == 0:
        return Arrival(node, exists, memory.passengers, jnp.zeros(0, bool))

    # Of several buses one whose passengers still have to get off.
    passengers = _passengers(graph, memory.passengers, tick, time_step)
    cumulative = jnp.cumsum(passengers.astype(float))[None, :]  # (1, B)
    bus = first_above(cumulative, node_chance[None], n_buses)[0]
    gets_off = ~exists & (passengers[bus] > 0)
    is_bus = jnp.arange(n_buses, dtype=jnp.int32) == bus
    node = jnp.where(gets_off, graph.timetable.bus_node[bus], node)
    return Arrival(node, exists | gets_off, passengers, is_bus & gets_off)


def _rates(graph: BehaviorGraph, time: Float[Array, ""]) -> Float[Array, "M"]:
    """People/s who come to each entrance on foot at a time [s] of the episode."""
    table = graph.timetable
    if table.open_node.shape[0] + table.bus_node.shape[0] == 0:
        return graph.entrance
    node = jnp.arange(graph.entrance.shape[0], dtype=jnp.int32)[:, None]
    is_of_node = table.open_node[None, :] == node  # (M, I)
    begin, end = components(table.open)
    is_now = (begin <= time) & (time < end)
    is_open = ~is_of_node.any(1) | (is_of_node & is_now[None, :]).any(1)
    has_bus = (table.bus_node[None, :] == node).any(1)
    return jnp.where(is_open & ~has_bus, graph.entrance, 0.0)


def _passengers(
    graph: BehaviorGraph, passengers: Int[Array, "B"], tick: Float[Array, ""], time_step: float
) -> Int[Array, "B"]:
    """How many people of each bus have still to come in; those of a new bus are all, and none long after it."""
    table = graph.timetable
    every = clock.to_ticks(table.every, time_step)
    first = clock.to_ticks(table.first, time_step)

    def count(tick: Array) -> Array:
        """How many buses have come up to a tick."""
        return jnp.maximum(jnp.floor((tick - first) / every) + 1.0, 0.0)

    n_buses = count(tick)
    passengers = jnp.where(n_buses > count(tick - 1.0), table.people, passengers)

    # Before the first bus there is none, as in an episode that follows a warm-up.
    since = tick - first - (n_buses - 1.0) * every
    stops = (n_buses > 0.0) & (since * time_step < BUS_STOP)
    return jnp.where(stops, passengers, 0)


def come_in(
    scenario: Scenario,
    graph: BehaviorGraph,
    state: State,
    outside: Bool[Array, "N"],
    chance: Float[Array, "4"],
) -> tuple[Pedestrians, GraphMemory]:
    """People, one of whom or one walking group may come in at an entrance.

    Who finds the floor full, or somebody in the entrance or a robot beside it, goes away. Passengers of a bus try again
    for ``BUS_STOP`` seconds.

    Args:
        outside: who may come in.
        chance: uniform from 0 to 1.
    """
    # Where somebody arrives in this step, if anybody does.
    people, memory = state.pedestrians, state.memory
    arrival_chance, person_chance, node_chance, place_chance = chance
    tick = state.tick.astype(float)
    arrives = arrival(graph, memory, tick, scenario.time_step, jnp.stack([arrival_chance, node_chance]))
    places = _some_places(graph, arrives.node[None], place_chance[None])[0]  # (K, 2) m

    # The numbers of people who are never present are the last ones.
    person = jnp.arange(scenario.people, dtype=jnp.int32)
    limit = scenario.people if scenario.people_present is None else scenario.people_present
    may_come = outside & (person < limit)

    # One of these comes in, or a walking group from its leader on.
    start = (person_chance * scenario.people).astype(jnp.int32)
    turn = (person - start) % scenario.people
    first = jnp.argmin(jnp.where(may_come, turn, scenario.people)).astype(jnp.int32)
    first = jnp.where(people.walking_group[first] >= 0, people.walking_group[first], first)
    is_new = may_come & (person == first)
    spots = places[:1]  # (S, 2) m
    if scenario.behavior.companions is not None:
        is_new = is_new | (may_come & (people.walking_group == first))
        spots = _apart(places)
    index = jnp.clip(person - first, 0, spots.shape[0] - 1)

    # Unless somebody stands in the way of one of them.
    is_taken = _is_taken(people, state.robot, spots)
    comes = arrives.exists & ~(is_new & is_taken[index]).any()

    # Nor does a walking group get off a bus that has fewer passengers.
    n_new = jnp.where(comes, is_new.sum(dtype=jnp.int32), 0)
    comes = comes & ~(arrives.of_bus & (n_new > arrives.passengers)).any()
    n_new = jnp.where(comes & arrives.of_bus, n_new, 0)  # (B,)
    memory = memory._replace(passengers=arrives.passengers - n_new)
    return _place_new(people, memory, comes & is_new, arrives.node, spots[index])


def _is_taken(people: Pedestrians, robot: Robot, places: Float[Array, "K 2"]) -> Bool[Array, "K"]:
    """Whether somebody stands at places [m], or a robot is beside them."""
    gap = people.position[:, None] - places[None, :]  # (N, K, 2) m
    is_near = length(*components(gap)) < ENTRANCE_GAP
    has_person = (people.present[:, None] & is_near).any(0)
    return has_person | _is_beside(robot, places)


def _apart(places: Float[Array, "K 2"]) -> Float[Array, "3 2"]:
    """The first place [m], and others far from it and from each other, for a walking group."""
    chosen = [places[0]]
    for _ in range(MAX_GROUP - 1):
        gap = places[:, None] - jnp.stack(chosen)[None, :]  # (K, C, 2)
        nearest = jnp.min(length(*components(gap)), axis=1)
        chosen.append(places[jnp.argmax(nearest)])
    return jnp.stack(chosen)


def _place_new(
    people: Pedestrians, memory: GraphMemory, is_new: Bool[Array, "N"], node: Int[Array, ""], place: Float[Array, "N 2"]
) -> tuple[Pedestrians, GraphMemory]:
    """People, the new ones of whom stand at places [m] of a node and have done their errand there."""
    assert memory.trip is not None
    column = is_new[:, None]
    people = replace(
        people,
        present=people.present | is_new,
        position=jnp.where(column, place, people.position),
        velocity=jnp.where(column, 0.0, people.velocity),
        desired_velocity=jnp.where(column, 0.0, people.desired_velocity),
    )
    trip = memory.trip._replace(
        errand=jnp.where(is_new, 1, memory.trip.errand),
        visited=jnp.where(column, -1, memory.trip.visited),
        intent=jnp.where(column, 0.0, memory.trip.intent),
        blocked=jnp.where(is_new, 0.0, memory.trip.blocked),
    )
    memory = memory._replace(
        goal=jnp.where(is_new, node, memory.goal),
        hop=jnp.where(is_new, node, memory.hop),
        origin=jnp.where(is_new, node, memory.origin),
        target=jnp.where(column, place, memory.target),
        seat=jnp.where(is_new, -1, memory.seat),
        stay=jnp.where(is_new, 0, memory.stay),
        trip=trip,
    )
    return people, memory
