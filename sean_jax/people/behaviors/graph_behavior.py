"""Graph-based pedestrian behavior (section IV-D): people walk, gather and disperse on the Behavior Graph.

People are first assigned to free seats of group nodes; the others go to random waypoint nodes, along the cheapest path
over waypoints. A person at a seat stays for a random duration, and a successor is sent to arrive when it ends
(``graph_choices``). So groups last while their members change. People make trips, with errands at their goals
(``trips``); with ``routing="whole"`` they walk from goal to goal, and with ``routing="edge"`` they choose at every
node, as in SEAN 2.0's code. With ``group_membership="permanent"`` people who start in a group stay there.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int

from sean_jax.core import clock
from sean_jax.core.data_types import FAR, Array, Behavior, Groups, Pedestrians, Robot, Scenario, State
from sean_jax.core.devices import to_device
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import length
from sean_jax.graph import BehaviorGraph, annotation
from sean_jax.graph.behavior_graph import add_congestion_cost, add_tastes, edge_densities
from sean_jax.graph.formation import formation, reach
from sean_jax.people.behaviors import graph_choices, trips
from sean_jax.people.behaviors.graph_choices import ARRIVED, Draws, GraphMemory, Seats, of_seat, seats_of
from sean_jax.people.behaviors.starts import (
    Place,
    WalkingGroups,
    choose_starts,
    count_walking_groups,
    find_spawn_clusters,
    follow_leaders,
    group_speeds,
    in_discs,
    leaders,
    present_people,
    walk_abreast,
)
from sean_jax.social_forces import draw_traits
from sean_jax.social_forces.forces import components, turn_heading
from sean_jax.world import navigation as paths

SEATED = 0.25  # m from a seat, where the walk ends and the stay begins
SETTLING = 0.5  # s, in which the last steps to a seat are taken


@struct.dataclass
class GraphTables:
    """The tables of the behavior: the graph, the paths between its nodes, and possible starts."""

    graph: BehaviorGraph
    navigation: paths.Navigation
    next_corners: paths.NextCornerTable  # on the way to each node
    # m from each node to each group, along the cheapest path
    walk: Float[Array, "M G"] = struct.field(metadata={"pad": np.inf})
    patience: Int[Array, "Q"]  # ticks for which the holder of a seat waits for a successor
    start: Float[Array, "P 2"] = struct.field(metadata={"pad": FAR})  # m, possible starts, none too close to another
    start_node: Int[Array, "P"]  # the node of each
    # log of its chance, relative to the others
    start_log_chance: Float[Array, "P"] = struct.field(metadata={"pad": -np.inf})
    congestion_cost: Float[Array, ""] | None  # m2, see ``add_congestion_cost``; None: none
    temperature: Float[Array, ""] | None  # m, see ``graph_choices``; None: people take the cheapest way
    bearings: trips.Bearings | None  # of trips
    spawn_clusters: Int[Array, "C 3"] = struct.field(metadata={"pad": -1})  # neighboring starts, for walking groups
    first_seats: Int[Array, "F"]  # seats at which people start
    seated: Int[Array, ""]  # number of these
    permanent: bool = struct.field(pytree_node=False)  # whether they stay there
    walking_groups: WalkingGroups = struct.field(pytree_node=False)  # their numbers


def build(
    place: Place,
    people: int | None = None,
    *,
    routing: str = "trips",
    group_membership: str = "turnover",
    congestion_cost: float = 0.0,
    temperature: float = 0.0,
    taste: float = 0.0,
    walking_groups: tuple[float, float] = (0.0, 0.0),
) -> Behavior:
    """People walk, gather and disperse on the Behavior Graph of the environment.

    Needs ``graph.yaml``.

    Args:
        people: the environment's number if None.
        routing: a key of ``ROUTINGS``.
        group_membership: "turnover": all members of groups come and go; "permanent": people start at all seats of a
            group but one and never leave, and others visit the free seat.
        congestion_cost: m2, increase of the cost of an edge, as a share, for each person per m2 on it.
        temperature: m, softmax temperature over costs of routes; 0: the cheapest one.
        taste: on trips, standard deviation of the log of the factors by which people's costs of an edge differ.
        walking_groups: shares of the people who walk in pairs and in triples. They walk from waypoint to waypoint and
            take no seats.

    Raises:
        InputError: there is no graph, it has a mistake, or so many people or walking groups do not fit.
    """
    # Environments without groups or walkers have no graph, so the message names the cure.
    file = place.folder / "graph.yaml"
    if not file.is_file():
        raise InputError(
            f"{place.folder / 'graph.yaml'}: there is no such file, and behavior 'graph' needs it; write one or "
            "choose another."
        )
    people = place.default_people if people is None else people

    # No two people share a start or a seat, so their number bounds the crowd; walking groups take no seats.
    graph = annotation.read_graph(file, place.environment, trips=routing == "trips")
    if routing == "trips":
        graph = replace(graph, stay=graph.visit)
        graph = add_tastes(graph, taste) if taste else graph
    start, node = _starts(place, graph)
    groups = count_walking_groups(people, walking_groups)
    permanent = group_membership == "permanent"
    first_seats = _first_seats(np.asarray(graph.seat_group), permanent)
    seated = min(len(first_seats), people - groups.members)
    max_people = len(start) + seated
    if people > max_people:
        raise InputError(
            f"people: {people} do not fit on the graph of {place.environment.name}; the most that do is {max_people}."
        )

    # The chance of a node is shared by its starts. People at seats have rows too, which nobody draws.
    spawn = np.asarray(graph.spawn)
    n_starts = np.bincount(node, minlength=len(spawn))  # of each node
    log_chance = np.log(spawn[node] / n_starts[node])

    # Everybody draws a start, those at seats too; padding has no chance (-inf), so it is drawn last.
    missing = max(people - len(start), 0)
    tables = GraphTables(
        graph=graph,
        navigation=place.navigation,
        next_corners=paths.build_next_corner_table(place.navigation, graph.position),
        walk=to_device(graph_choices.walking_lengths(graph, place.navigation)),
        patience=to_device(_patience(graph, routing, place.time_step)),
        start=to_device(np.pad(start, [(0, missing), (0, 0)])),
        start_node=to_device(np.pad(node.astype(np.int32), (0, missing))),
        start_log_chance=to_device(np.pad(log_chance, (0, missing), constant_values=-np.inf)),
        # None leaves a term out of the compiled program, which a value of 0 would not.
        congestion_cost=to_device(np.asarray(congestion_cost)) if congestion_cost else None,
        temperature=to_device(np.asarray(temperature)) if temperature else None,
        bearings=jax.jit(trips.bearings)(graph) if routing == "trips" else None,
        spawn_clusters=to_device(find_spawn_clusters(place.navigation, start, groups)),
        walking_groups=groups,
        first_seats=to_device(np.array(first_seats, np.int32)),
        seated=to_device(np.array(seated, np.int32)),
        permanent=permanent,
    )

    # Tasks ask what a behavior offers: Join and Leave Group need groups.
    return Behavior(
        data=tables,
        name="graph",
        reset=reset,
        direct=ROUTINGS[routing],
        companions=groups.companions(people),
        people=people,
        offers=("groups",) if len(graph.groups) else (),
    )


def _starts(place: Place, graph: BehaviorGraph) -> tuple[np.ndarray, np.ndarray]:
    """Starts (P, 2) [m] in the discs of nodes, away from groups, and the node (P,) of each."""
    position = np.asarray(graph.position)
    capacity = np.asarray(graph.capacity)
    avoid = []
    for node in np.asarray(graph.groups):
        radius = reach(int(capacity[node])) + 0.6
        avoid.append((position[node], radius))
    return in_discs(place.environment, place.navigation, graph.position, graph.radius, graph.spawn, avoid)


def reset(scenario: Scenario, key: Array) -> tuple[Pedestrians, Groups, GraphMemory]:
    """People at their starts: seats of groups first, then places of waypoint nodes drawn by their spawn chance."""
    tables: GraphTables = scenario.behavior.data
    graph = tables.graph
    form_key, trait_key, place_key, stay_key, turn_key, taste_key = jax.random.split(key, 6)

    # All seats get a place, taken or not: successors and the robot need the free ones later.
    center = graph.position[graph.groups]  # (G, 2) m
    capacity = graph.capacity[graph.groups]
    seat_position, seat_heading, radius, opening = formation(form_key, capacity, center, graph.seat_group)
    groups = Groups(center=center, radius=radius, opening=opening, present=graph.groups >= 0)

    # The first people sit, whether present or not; an absent person has no seat.
    sits, seat, index = _assign_seats(tables, scenario.people)
    start = _choose_starts(scenario, place_key, index)
    present = present_people(scenario)
    seat_of_present = jnp.where(present, seat, -1)
    position = jnp.where(sits[:, None], of_seat(seat_position, seat), tables.start[start])  # (N, 2) m

    # Indexed as the starts, so the number of people at seats does not change where others look.
    angles = jax.random.uniform(turn_key, (scenario.people,), float, 0.0, 2 * jnp.pi)
    angle = angles[index]
    facing = jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1)  # (N, 2)
    seat_heading_of_present = of_seat(seat_heading, seat_of_present)
    heading = jnp.where(sits[:, None], seat_heading_of_present, facing)
    group_of_present = of_seat(graph.seat_group, seat_of_present)

    # One speed for a walking group, its leader's: at speeds of their own the members would drift apart.
    walking_group = leaders(scenario.behavior.companions, scenario.people)
    preferred_speed, robot_distance = draw_traits(scenario.forces, trait_key, scenario.people)
    pedestrians = Pedestrians(
        position=position,
        velocity=jnp.zeros_like(position),
        heading=heading,
        desired_velocity=jnp.zeros_like(position),
        group=jnp.where(seat_of_present >= 0, group_of_present, -1),
        walking_group=walking_group,
        present=present,
        preferred_speed=group_speeds(scenario, walking_group, preferred_speed),
        robot_distance=robot_distance,
    )

    # A person's first goal is the node they stand at, so the first step chooses the next one.
    node = jnp.where(sits, of_seat(graph.seat_node, seat), tables.start_node[start])
    stay = _first_stay(scenario, stay_key, seat_of_present)
    memory = GraphMemory(node, node, node, position, seat_of_present, stay, seat_position, seat_heading)

    # The log chances of all choices sum up over the episode: the score function's gradient needs them.
    if tables.temperature is not None:
        memory = memory._replace(log_chance=jnp.zeros((), float))

    if scenario.behavior.direct == direct_trips:
        trip = trips.begin(graph, memory, scenario.people, taste_key)
        memory = memory._replace(trip=trip, passengers=jnp.zeros_like(graph.timetable.people))

    # Edge by edge nobody is sent ahead of time. Else a first stay may end before anyone could be there.
    if scenario.behavior.direct != direct_edge_by_edge:
        memory = _send_at_start(scenario, pedestrians, memory)
    return pedestrians, groups, memory


def _assign_seats(tables: GraphTables, people: int) -> tuple[Bool[Array, "N"], Int[Array, "N"], Int[Array, "N"]]:
    """Whether each person starts at a seat, which seat or -1, and the index among those who do not."""
    person = jnp.arange(people, dtype=jnp.int32)
    sits = person < tables.seated
    seat = jnp.where(sits, of_seat(tables.first_seats, person), -1)
    return sits, seat, jnp.maximum(person - tables.seated, 0)


def _choose_starts(scenario: Scenario, key: Array, index: Int[Array, "N"]) -> Int[Array, "N"]:
    """The start of each person, by the index among those who do not sit; of walking groups by their own indices."""
    tables: GraphTables = scenario.behavior.data
    people = scenario.people
    log_chance = tables.start_log_chance
    score = log_chance + jax.random.gumbel(key, log_chance.shape, float)
    chosen = choose_starts(score, tables.spawn_clusters, people, tables.walking_groups)
    person = jnp.arange(people, dtype=jnp.int32)
    alone = person < people - tables.walking_groups.members
    return chosen[jnp.where(alone, index, person)]


def _first_stay(scenario: Scenario, key: Array, seat: Int[Array, "N"]) -> Int[Array, "N"]:
    """The remaining stay at the seat in ticks, as if the episode had begun long before; 0 without a seat."""
    tables: GraphTables = scenario.behavior.data
    node = of_seat(tables.graph.seat_node, seat)
    chance = jax.random.uniform(key, (scenario.people, 2), float)
    time = _residual_stay(tables.graph.stay[node], chance)  # (N,) s
    if tables.permanent:
        time = jnp.full_like(time, jnp.inf)
    stay = _stay(scenario, time)
    stay = jnp.where(stay > 0, stay + of_seat(tables.patience, seat), 0)
    return jnp.where(seat >= 0, stay, 0)


def _first_seats(seat_group: np.ndarray, permanent: bool) -> tuple[int, ...]:
    """The seats at which people start: all, without the last of each group if that is for visitors."""
    if not permanent:
        return tuple(range(len(seat_group)))
    return tuple(seat for seat, group in enumerate(seat_group) if group in seat_group[seat + 1 :])


def _patience(graph: BehaviorGraph, routing: str, time_step: float) -> np.ndarray:
    """(Q,) ticks for which the holder of a seat waits; 0 where successors are not sent ahead of time."""
    seat_node = np.asarray(graph.seat_node)
    longest = np.asarray(graph.stay)[seat_node, 1]
    wait = np.minimum(longest, graph_choices.MAX_WAIT)
    if routing == "edge":
        wait = np.zeros_like(longest)
    return np.floor(wait / time_step + 1e-3).astype(np.int32)


def _residual_stay(limits: Float[Array, "K 2"], chance: Float[Array, "K 2"]) -> Float[Array, "K"]:
    """Remaining stay times [s], drawn from the stationary residual distribution."""
    low, high = components(limits)
    ratio_square = (low / jnp.maximum(high, 1e-6)) ** 2
    whole = high * jnp.sqrt(ratio_square + chance[:, 0] * (1.0 - ratio_square))
    return chance[:, 1] * whole


def _send_at_start(scenario: Scenario, people: Pedestrians, memory: GraphMemory) -> GraphMemory:
    """Successors for the first stays, as if the episode had begun long before."""
    tables: GraphTables = scenario.behavior.data
    arrival = graph_choices.arrival_times(tables.graph, tables.walk, people, memory)
    seekers = people.present & (people.walking_group < 0)
    n_seats = (tables.graph.seat_node >= 0).sum(dtype=jnp.int32)

    def send_once(turn: Array, memory: GraphMemory) -> GraphMemory:
        seats = seats_of(memory, tables.patience, scenario.time_step)
        after, _ = graph_choices.send(tables.graph, arrival, memory, seats, seekers)
        return jax.tree.map(lambda old, new: jnp.where(turn < n_seats, new, old), memory, after)

    return jax.lax.fori_loop(0, min(tables.patience.shape[0], scenario.people), send_once, memory)


def direct(scenario: Scenario, state: State, key: Array) -> State:
    """People keep a goal until they are there, along the cheapest path to it, as in the paper."""
    return _direct(True, scenario, state, key)


def direct_edge_by_edge(scenario: Scenario, state: State, key: Array) -> State:
    """People choose again at every node and walk one edge of the path, as in SEAN 2.0's code."""
    return _direct(False, scenario, state, key)


def direct_trips(scenario: Scenario, state: State, key: Array) -> State:
    """People have an errand at each goal, come and leave at entrances, and turn in curves: see ``trips``."""
    # Scenarios may have no people, and argmax of nothing is an error.
    if scenario.people == 0:
        return state

    tables: GraphTables = scenario.behavior.data
    key, draws = _split_draws(tables, scenario.people, key)
    chance = trips.draw(key, scenario.people)

    # Who leaves in this step does not come in at once.
    outside = ~state.pedestrians.present
    people = trips.leave(tables.graph, state.pedestrians, state.memory)
    state = replace(state, pedestrians=people)
    people, memory = trips.come_in(scenario, tables.graph, state, outside, chance.arrival)
    state = replace(state, pedestrians=people, memory=memory)
    graph = _graph_with_congestion(tables, state)

    # Stays and errands come first: whoever is free chooses a goal in the same step.
    # Nobody begins a stay and an errand in one step, so one number is enough for both.
    memory, rises = _stay_or_leave(scenario, people, memory, chance.duration, draws)
    memory, done = trips.advance_errands(graph, people, state.robot, memory, chance.duration, scenario.time_step)
    seats = seats_of(memory, tables.patience, scenario.time_step)
    state = replace(state, memory=memory)
    memory = _choose_trips(scenario, graph, state, seats, rises | done, chance, draws)
    memory = _follow_choices(scenario, people, memory)

    # What people want changes gradually, so their ways are curves.
    pace = graph_choices.pace(graph, tables.walk, people, memory, seats)
    gap, speed = _way(tables, people, memory, seats, pace)
    if scenario.behavior.companions is not None:
        gap = walk_abreast(people, gap)
    speed = trips.held_up_speed(people, memory, speed)
    memory, intent = trips.change_intent(memory, gap, speed, scenario.time_step)
    memory, intent = trips.stop_before_walls(scenario, people, memory, intent)
    people = replace(people, desired_velocity=intent)

    # Bodies turn into seats as fast as people can turn.
    max_angle = scenario.forces.walking.turn_rate * scenario.time_step
    seat_heading = turn_heading(people.heading, of_seat(memory.seat_heading, memory.seat), max_angle)
    people = _stand_in_groups(graph, people, memory, seat_heading)
    return replace(state, pedestrians=people, memory=memory)


def _split_draws(tables: GraphTables, people: int, key: Array) -> tuple[Array, Draws | None]:
    """A key for the other choices, and the draws of a step with a temperature.

    The key is split only with a temperature, so episodes without one do not depend on it.
    """
    if tables.temperature is None:
        return key, None
    key, draw_key = jax.random.split(key)
    n_seats = tables.graph.seat_group.shape[0]
    return key, graph_choices.draw(draw_key, tables.temperature, people, n_seats)


def _follow_choices(scenario: Scenario, people: Pedestrians, memory: GraphMemory) -> GraphMemory:
    """The memory, in which a walking group has one goal: its members copy the leader's choice, and errand."""
    if scenario.behavior.companions is None:
        return memory
    rows = memory.goal, memory.hop, memory.origin, memory.target
    goal, hop, origin, target = follow_leaders(people.walking_group, *rows)
    memory = memory._replace(goal=goal, hop=hop, origin=origin, target=target)
    if memory.trip is None:
        return memory
    (errand,) = follow_leaders(people.walking_group, memory.trip.errand)
    return memory.with_trip(errand=errand)


def _stand_in_groups(
    graph: BehaviorGraph, people: Pedestrians, memory: GraphMemory, seat_heading: Float[Array, "N 2"]
) -> Pedestrians:
    """People as members of the groups in which they stand.

    Heading follows motion, and who stands has none: it is ``seat_heading``, but only once the walk has ended.
    """
    standing = memory.stay > 0
    settled = standing & (graph_choices.target_distance(people, memory) < SEATED)
    group = of_seat(graph.seat_group, memory.seat)
    return replace(
        people,
        group=jnp.where(standing, group, -1),
        heading=jnp.where(settled[:, None], seat_heading, people.heading),
    )


def _choose_trips(
    scenario: Scenario,
    graph: BehaviorGraph,
    state: State,
    seats: Seats,
    free: Bool[Array, "N"],
    chance: trips.Chances,
    draws: Draws | None,
) -> GraphMemory:
    """Next goals of people who are free or give theirs up, and next nodes of those who pass one.

    Seats without a successor come first, then waypoints by their weights. Nobody is sent back the way they come from.

    Args:
        free: who has no goal.
    """
    people = state.pedestrians
    memory, gives_up = trips.wait(people, state.robot, state.memory, scenario.time_step)
    onward = free | trips.passes(graph, people, memory)

    # A few people choose in a step. A successor whose seat another person got is among them, now or later. Members of
    # a walking group copy the choice of their leader.
    has_lost_seat = graph.is_group[memory.goal] & (memory.seat < 0) & (memory.stay == 0)
    person = jnp.arange(scenario.people, dtype=jnp.int32)
    follows = (people.walking_group >= 0) & (people.walking_group != person)
    candidates = (onward | gives_up | has_lost_seat) & people.present & ~follows
    few = trips.choosers(candidates)
    goes_on = few.exists & few.rows(onward)
    if draws is not None:
        draws = draws._replace(hop=few.rows(draws.hop), seat=few.rows(draws.seat))

    # Seats come first.
    before = memory.of_people(few.person)
    bearing = _bearings(scenario.behavior.data, graph)
    seekers = goes_on & few.rows(people.walking_group < 0)
    barred = trips.barred_groups(graph, before, bearing)
    seat, assigned, log_chance = _seats_for(scenario, graph, people, memory, seats, few, seekers, barred, draws)
    memory, loses = graph_choices.lose_seats(memory, assigned)
    chosen = graph_choices.take_seats(graph, memory.of_people(few.person), seat)
    if draws is not None:
        chosen = chosen.with_choices(log_chance)
    chosen = trips.remember(chosen, before.goal, seat >= 0)

    # Who has no seat goes to a waypoint.
    is_free = few.rows(free | has_lost_seat | loses)
    aimless = few.exists & is_free & (chosen.seat < 0)
    odds = trips.goal_odds(graph, chosen, bearing)
    waypoint = graph_choices.draw_waypoint(graph, odds, chance.goal)
    if draws is not None:
        log_chance = graph_choices.log_waypoint_chance(graph, odds, waypoint)
        log_chance = jnp.where(aimless, log_chance, 0.0)
        chosen = chosen.with_choices(jnp.sum(log_chance))
    chosen = chosen._replace(goal=jnp.where(aimless, waypoint, chosen.goal))
    chosen = trips.remember(chosen, before.goal, aimless)

    # The way there, or back.
    position = few.rows(people.position)
    chosen = _set_out_on_trips(graph, position, state.robot, chosen, goes_on, chance.place, draws)
    chosen = trips.turn_round(graph, position, chosen, chance.back, few.rows(gives_up))
    return few.update(memory, chosen)


def _seats_for(
    scenario: Scenario,
    graph: BehaviorGraph,
    people: Pedestrians,
    memory: GraphMemory,
    seats: Seats,
    few: trips.Choosers,
    seekers: Bool[Array, "K"],
    barred: Bool[Array, "K G"],
    draws: Draws | None,
) -> tuple[Int[Array, "K"], Bool[Array, "Q"], Float[Array, ""]]:
    """``offer_seats`` to choosers, so that arrival times are computed for these and present successors alone."""
    # Graphs may have no groups, and argmin of nothing is an error.
    n_seats = seats.holder.shape[0]
    if n_seats == 0:
        return jnp.full(seekers.shape, -1, jnp.int32), jnp.zeros(0, bool), jnp.zeros((), float)
    walk = scenario.behavior.data.walk

    def arrival_of(person: Array, group: Array | None) -> Array:
        some_people = jax.tree.map(lambda values: values[person], people)
        return graph_choices.arrival_times(graph, walk, some_people, memory.of_people(person), group)

    arrival = arrival_of(few.person, None)  # (K, G) s
    successor = jnp.maximum(seats.successor, 0)
    arrival_of_successor = arrival_of(successor, graph.seat_group[:, None])[:, 0]  # (Q,) s
    limit = graph_choices.largest_misfit(memory, seats, arrival_of_successor)
    some_memory = memory.of_people(few.person)
    return graph_choices.offer_seats(graph, arrival, some_memory, seats, limit, seekers, draws, barred)


def _bearings(tables: GraphTables, graph: BehaviorGraph) -> trips.Bearings:
    """The directions in which people set out: those of the tables, unless congestion changes the paths."""
    if tables.bearings is None or tables.congestion_cost is not None:
        return trips.bearings(graph)
    return tables.bearings


def _set_out_on_trips(
    graph: BehaviorGraph,
    position: Float[Array, "K 2"],
    robot: Robot,
    memory: GraphMemory,
    onward: Bool[Array, "K"],
    chance: Float[Array, "K"],
    draws: Draws | None,
) -> GraphMemory:
    """The choosers' memory with the next nodes of their paths, and places there that lie on the way.

    Args:
        position: m.
        onward: who leaves a node.
        chance: uniform from 0 to 1.
    """
    memory = graph_choices.set_out(graph, memory, onward, chance, draws)

    # A seat is a place already.
    place = trips.place_on_the_way(graph, position, robot, memory, chance)
    to_seat = (memory.seat >= 0) & (memory.hop == memory.goal)
    takes_place = onward & ~to_seat
    target = jnp.where(takes_place[:, None], place, memory.target)
    return trips.end_errands(memory._replace(target=target), onward)


def _way(
    tables: GraphTables, people: Pedestrians, memory: GraphMemory, seats: Seats, pace: Float[Array, "N"]
) -> tuple[Float[Array, "N 2"], Float[Array, "N"]]:
    """The way [m] to the target or the next corner, and a speed [m/s], slower towards a place where a person stops.

    On the way to that place people slow down at corners, too: who takes them at full speed comes off the way.
    """
    gap = _gaps_ahead(tables, people, memory)
    distance = length(*components(gap))

    # An early successor stands by while somebody has the seat.
    stops = memory.hop == memory.goal
    occupied = (seats.holder >= 0) & (seats.time_left > 0.0)
    early = stops & (memory.seat >= 0) & (memory.stay == 0) & of_seat(occupied, memory.seat)
    remaining = distance - jnp.where(early, graph_choices.STAND_BY, 0.0)
    speed = people.preferred_speed * pace
    stopping_speed = jnp.minimum(speed, trips.braking_speed(remaining))
    speed = jnp.where(stops, stopping_speed, speed)

    # Who stands at a seat takes the last steps, and who has an errand does not walk.
    settling_speed = jnp.minimum(speed, distance / SETTLING)
    speed = jnp.where(memory.stay > 0, settling_speed, speed)
    speed = jnp.where(trips.at_errand(memory), 0.0, speed)
    return gap, speed


ROUTINGS = {"trips": direct_trips, "whole": direct, "edge": direct_edge_by_edge}
"""name -> ``direct`` of the behavior: trips with errands, or walks bound to the whole path to a goal or to one edge"""


def _direct(whole: bool, scenario: Scenario, state: State, key: Array) -> State:
    """Goals, hops and desired velocities, by whole paths or edge by edge. People at a seat are members of its group."""
    tables: GraphTables = scenario.behavior.data
    graph = _graph_with_congestion(tables, state)
    people = state.pedestrians

    key, draws = _split_draws(tables, scenario.people, key)
    chance = jax.random.uniform(key, (3, scenario.people), float)  # (3, N)

    # Stays come first: whoever leaves a seat or reaches a waypoint chooses a goal in the same step.
    memory, leaves = _stay_or_leave(scenario, people, state.memory, chance[0], draws)
    free = leaves | _at_waypoint(people, state.memory)
    seats = seats_of(memory, tables.patience, scenario.time_step)

    # Arrival times can be planned only by people who keep a goal, so edge by edge nobody slows down to be on time.
    choice = chance[1:]
    if whole:
        arrival = graph_choices.arrival_times(graph, tables.walk, people, memory)
        memory = graph_choices.choose_whole(graph, people, memory, seats, arrival, free, choice, draws)
        pace = graph_choices.pace(graph, tables.walk, people, memory, seats)
    else:
        memory = graph_choices.choose_edge(graph, people, memory, free, choice, draws)
        pace = jnp.ones_like(people.preferred_speed)

    memory = _follow_choices(scenario, people, memory)

    # A switch of target is a jump; with a temperature a blend keeps positions differentiable across it.
    desired_velocity = _desired_velocity(tables, people, memory, seats, pace)
    if draws is not None:
        desired_velocity = _blend(scenario, people, state.memory, memory, seats, desired_velocity)

    # Members of a walking group that all headed for one target would arrive in single file.
    if scenario.behavior.companions is not None:
        desired_velocity = walk_abreast(people, desired_velocity)

    people = replace(people, desired_velocity=desired_velocity)
    seat_heading = of_seat(memory.seat_heading, memory.seat)
    people = _stand_in_groups(graph, people, memory, seat_heading)
    return replace(state, pedestrians=people, memory=memory)


def _graph_with_congestion(tables: GraphTables, state: State) -> BehaviorGraph:
    """The graph, on which crowded edges cost more if there is a congestion cost."""
    if tables.congestion_cost is None:
        return tables.graph
    memory = state.memory
    standing = (memory.stay > 0) | trips.at_errand(memory)
    walking = state.pedestrians.present & ~standing
    density = edge_densities(tables.graph, memory.origin, memory.hop, walking)
    return add_congestion_cost(tables.graph, density, tables.congestion_cost)


def _stay_or_leave(
    scenario: Scenario, people: Pedestrians, memory: GraphMemory, chance: Float[Array, "N"], draws: Draws | None
) -> tuple[GraphMemory, Bool[Array, "N"]]:
    """Stays that begin, continue or end; and whether people leave their seat now.

    A stay ends when its time is over and a successor is near, whose own stay begins then, or after some waiting.
    """
    tables: GraphTables = scenario.behavior.data

    # A stay's ticks include the patience at its end, in which the holder only waits for a successor.
    patience = of_seat(tables.patience, memory.seat)
    distance = graph_choices.target_distance(people, memory)
    was_standing = memory.stay > 0

    # A holder rises if a successor is near, or when the waiting is over.
    seats = seats_of(memory, tables.patience, scenario.time_step)
    comes = ~was_standing & (memory.seat >= 0) & (memory.hop == memory.goal)
    is_near = comes & (distance < graph_choices.HAND_OVER)
    successor_is_near = _of_person(is_near, seats.successor)  # (Q,)
    stay = jnp.maximum(memory.stay - 1, 0)
    hands_over = of_seat(successor_is_near, memory.seat) & (stay <= patience)
    rises = was_standing & ((stay == 0) | hands_over)

    # Holder and successor change in one step, so a seat never has two people or none in between.
    given_up = _of_person(rises, seats.holder)  # (Q,)
    at_empty_seat = of_seat(seats.holder < 0, memory.seat) & (distance < SEATED)
    takes_over = of_seat(given_up & successor_is_near, memory.seat)
    sits_down = comes & (at_empty_seat | takes_over)

    # Stays are uniform between the limits of their group; with a temperature tails make limits differentiable.
    node = of_seat(tables.graph.seat_node, memory.seat)
    limits = tables.graph.stay[node]  # (N, 2) s
    shortest, longest = components(limits)
    time = shortest + chance * (longest - shortest)
    new_stay = _stay(scenario, time)
    if draws is not None:
        both = jnp.stack([chance, draws.stay])
        new_stay, log_chance = graph_choices.sample_stay(limits, both, draws.temperature, scenario.time_step)
        log_chance = jnp.where(sits_down, log_chance, 0.0)
        memory = memory.with_choices(jnp.sum(log_chance))
    new_stay = jnp.where(new_stay > 0, new_stay + patience, 0)

    # A seat with a stay of 0 means "on the way there", so a stay that takes no time must give up the seat.
    leaves = rises | (sits_down & (new_stay == 0))  # at once, if the new stay takes no time
    stay = jnp.where(rises, 0, stay)
    stay = jnp.where(sits_down, new_stay, stay)
    seat = jnp.where(leaves, -1, memory.seat)
    return memory._replace(stay=stay, seat=seat), leaves


def _at_waypoint(people: Pedestrians, before: GraphMemory) -> Bool[Array, "N"]:
    """Whether people without a seat are at the waypoint that was their goal."""
    walks_there = (before.stay == 0) & (before.seat < 0) & (before.hop == before.goal)
    return walks_there & (graph_choices.target_distance(people, before) < ARRIVED)


def _of_person(values: Bool[Array, "N"], person: Int[Array, "Q"]) -> Bool[Array, "Q"]:
    """The values of the people of seats, false where there is nobody."""
    if values.shape[0] == 0:
        return jnp.zeros(person.shape, bool)
    return (person >= 0) & values[jnp.maximum(person, 0)]


def _stay(scenario: Scenario, time: Float[Array, "*shape"]) -> Int[Array, "*shape"]:
    """Ticks of stay times [s]."""
    ticks = clock.to_ticks(time, scenario.time_step)
    ticks = jnp.minimum(ticks, 1e9)
    return jnp.ceil(ticks).astype(jnp.int32)


def _desired_velocity(
    tables: GraphTables, people: Pedestrians, memory: GraphMemory, seats: Seats, pace: Float[Array, "N"]
) -> Float[Array, "N 2"]:
    """Velocities [m/s] at the preferred speed to the target, or the next corner on the way; slower into a seat."""
    gap = _gaps_ahead(tables, people, memory)
    distance = length(*components(gap))
    speed = people.preferred_speed * pace

    # On the last edge to a seat people slow down, and stand by while somebody stands there.
    to_seat = (memory.seat >= 0) & (memory.hop == memory.goal)
    occupied = (seats.holder >= 0) & (seats.time_left > 0.0)
    early = (memory.stay == 0) & of_seat(occupied, memory.seat)
    stop = jnp.where(early, graph_choices.STAND_BY, 0.0)  # m before the seat
    remaining = jnp.maximum(distance - stop, 0.0)
    settling_speed = jnp.minimum(speed, remaining / SETTLING)
    speed = jnp.where(to_seat, settling_speed, speed)
    rate = speed / jnp.maximum(distance, 1e-6)  # 1/s
    return gap * rate[:, None]


def _gaps_ahead(tables: GraphTables, people: Pedestrians, memory: GraphMemory) -> Float[Array, "N 2"]:
    """Vectors [m] from people to their targets, or to the next corners on the way."""

    def gap_ahead(position: Array, target: Array, hop: Array) -> Array:
        return _aim(tables, position, target, hop) - position

    return jax.vmap(gap_ahead)(people.position, memory.target, memory.hop)


def _blend(
    scenario: Scenario,
    people: Pedestrians,
    before: GraphMemory,
    memory: GraphMemory,
    seats: Seats,
    desired_velocity: Float[Array, "N 2"],
) -> Float[Array, "N 2"]:
    """Velocities [m/s], partly towards the old target for people who reach it in this step: ``switched_share``."""
    gap = before.target - people.position
    distance = length(*components(gap))
    approach_speed = jnp.sum(gap * people.velocity, axis=1) / jnp.maximum(distance, 1e-6)
    closer = approach_speed * scenario.time_step  # m, in one step
    share = graph_choices.switched_share(distance, closer, ARRIVED)
    turns = (before.stay == 0) & (before.target != memory.target).any(1)
    share = jnp.where(turns & (distance < ARRIVED), share, 1.0)
    share = share[:, None]
    full_pace = jnp.ones_like(distance)
    old_velocity = _desired_velocity(scenario.behavior.data, people, before, seats, full_pace)
    return share * desired_velocity + (1.0 - share) * old_velocity


def _aim(
    tables: GraphTables, position: Float[Array, "2"], target: Float[Array, "2"], hop: Int[Array, ""]
) -> Float[Array, "2"]:
    """The target [m] if the way to it is clear, else the next corner on the way to its node."""
    navigation = tables.navigation
    clear = paths.segment_is_free(navigation.obstacles, position, target, navigation.radius * paths.CLOSE)
    return jnp.where(clear, target, paths.next_corner(navigation, tables.next_corners, position, hop))
