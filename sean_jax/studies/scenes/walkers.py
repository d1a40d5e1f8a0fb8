"""Walkers: people who start at a place and a time, pass one gate after the other, and leave.

A pedestrian behavior (section IV-D, high level) of a few arrays. A source is a number of walkers who enter as soon as
it is their time and there is room; a sink is the last gate of a route. People with a choice of exits take the one
through which they expect to be out first.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int

from sean_jax.core import random_streams
from sean_jax.core.data_types import Array, Behavior, Groups, Pedestrians, Scenario, State
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import length, unit
from sean_jax.people.intent import Intent, Latents, advance, draw, wanted_velocity
from sean_jax.people.pedestrian_models import pedestrians_at
from sean_jax.social_forces import draw_traits

Point = tuple[float, float]  # m

MARGIN = 0.3  # m from the ends of a gate, nobody aims at a point nearer to them: a body and some room
AHEAD = 0.3  # m behind the line of a gate, where people aim
DEPTH = 2.0  # m behind the line, within which a gate counts as passed
ROOM = 0.5  # m, free radius around the place of an entering person
EXIT_FLOW = 1.9  # people/s/m through a door: Juelich bottlenecks, Seyfried et al., Transp. Sci. 43, 395 (2009)
PATIENCE = 0.8  # share of the expected time that another exit must promise, for people to turn to it
TURNS = 10  # ticks in which everybody looks once at the other exits
SPEED = 1.34, 0.26  # m/s, mean and deviation: Helbing & Molnar, Phys. Rev. E 51, 4282 (1995)
TRIES = 20_000  # places tried by ``spread`` at a time
NEVER = 1e9  # s, entry time of padding
PEOPLE = 16, 64, 128, 256, 512, 1024, 2048, 4096  # sizes to which crowds are padded
GATES = 32, 256  # sizes to which gates are padded
LEGS = 8  # size to which the gates of one route are padded
AWAY = 1e3  # m, where absent people are, and the robot of a scene without one


class Gate(NamedTuple):
    """A line to walk through, with the ends on the left and on the right hand."""

    left: Point
    right: Point


@struct.dataclass
class Walkers:
    """N people and their routes; numpy arrays in a ``Scene``."""

    start: Float[Array, "N 2"]  # m
    velocity: Float[Array, "N 2"]  # m/s, when they enter
    preferred_speed: Float[Array, "N"]  # m/s
    entry_time: Float[Array, "N"]  # s, from which they enter, as soon as there is room
    reaction_time: Float[Array, "N"]  # s, from which they walk
    route: Int[Array, "N R"]  # indices of gates, in their order, -1 none; after the last one they vanish
    companion: Int[Array, "N 2"]  # indices of whom each walks with, -1 none


@struct.dataclass
class Plan:
    """The tables of the behavior."""

    walkers: Walkers
    gates: Float[Array, "G 2 2"]  # m, left and right end
    is_exit: Bool[Array, "G"]  # whether people choose between this gate and the others of which that is true
    period: Float[Array, ""]  # m along x, of a periodic scene
    intent: Intent | None  # None: people turn to their gate at once, at their preferred speed
    sources: bool = struct.field(pytree_node=False)  # whether people enter later than at the start
    choice: bool = struct.field(pytree_node=False)  # whether there are exits to choose between


class Memory(NamedTuple):
    """How far each person is."""

    leg: Int[Array, "N"]  # number of gates passed
    gate: Int[Array, "N"]  # to which they walk, -1 none is left
    entered: Bool[Array, "N"]
    latents: Latents | None = None  # None without intent


def walkers(
    start: Float[np.ndarray, "N 2"],
    *,
    route: Sequence[int] = (),
    speed: float | Float[np.ndarray, "N"] | None = None,
    seed: int = 0,
    velocity: Point = (0.0, 0.0),
    entry_time: float | Float[np.ndarray, "N"] = 0.0,
    reaction_time: float | Float[np.ndarray, "N"] = 0.0,
    together: bool = False,
) -> Walkers:
    """People of one route, who start at (N, 2) m, such as ``spread`` draws.

    Args:
        route: indices of gates, in their order; people vanish at the last one. Without a route they stand.
        speed: preferred speed [m/s], one for all or (N,); drawn from N(1.34, 0.26) if None.
        velocity: at the start [m/s].
        entry_time: s, one for all or (N,); likewise ``reaction_time``.
        together: whether they are a walking group: each walks beside the one before and the one after, and all prefer
            the speed of the slowest.
    """
    start = np.asarray(start, float).reshape(-1, 2)
    number = len(start)
    if speed is None:
        drawn = np.random.default_rng([seed, 7]).normal(*SPEED, number)
        speed = np.clip(drawn, 0.5, 2.2)
    companion = np.full((number, 2), -1, np.int32)
    if together:
        speed = float(np.min(speed))
        companion[1:, 0] = np.arange(number - 1)
        companion[:-1, 1] = np.arange(1, number)
    fields: Any = dict(
        start=start,
        velocity=_broadcast(velocity, number, 2),
        preferred_speed=_broadcast(speed, number),
        entry_time=_broadcast(entry_time, number),
        reaction_time=_broadcast(reaction_time, number),
        route=np.broadcast_to(np.asarray(route, np.int32), (number, len(route))),
        companion=companion,
    )
    return Walkers(**fields)


def _broadcast(value: Any, *shape: int) -> np.ndarray:
    return np.broadcast_to(np.asarray(value, float), shape)


def join(*parts: Walkers) -> Walkers:
    """People of several routes, as one crowd."""
    legs = max(part.route.shape[1] for part in parts)
    crowds: list[Walkers] = []
    before = 0
    for part in parts:
        missing = legs - part.route.shape[1]
        route = np.pad(np.asarray(part.route), ((0, 0), (0, missing)), constant_values=-1)

        # Companions are indices in the part, and then in the crowd.
        companion = np.asarray(part.companion)
        companion = np.where(companion >= 0, companion + before, -1)
        crowds.append(replace(part, route=route, companion=companion))
        before += len(part.start)
    return jax.tree.map(lambda *rows: np.concatenate(rows), *crowds)


def source(
    gate: Gate, number: int, rate: float, *, route: Sequence[int], speed: float | None = None, seed: int = 0
) -> Walkers:
    """People who enter through a gate one after the other, ``rate`` per second, at first straight across it.

    Args:
        speed: preferred speed [m/s]; drawn if None.
    """
    generator = np.random.default_rng([seed, 11])
    left = np.asarray(gate.left, float)
    right = np.asarray(gate.right, float)
    width = max(np.hypot(*(left - right)), 1e-9)
    inset = min(MARGIN / width, 0.5)
    share = generator.uniform(inset, 1.0 - inset, (number, 1))
    place = left + share * (right - left)  # (N, 2) m
    people = walkers(place, route=route, speed=speed, seed=seed, entry_time=np.arange(number) / rate)

    across = np.array([left[1] - right[1], right[0] - left[0]])
    across = across / max(np.hypot(*across), 1e-9)
    velocity = across * np.asarray(people.preferred_speed)[:, None]
    return replace(people, velocity=velocity)


def spread(lower: Point, upper: Point, number: int, seed: int = 0, apart: float = 0.42) -> Float[np.ndarray, "N 2"]:
    """(N, 2) m: random places in a rectangle from ``lower`` to ``upper`` [m], at least ``apart`` m from each other.

    If the rectangle is too full for a random draw, places are a grid with random displacements, nearer if need be.
    """
    generator = np.random.default_rng([seed, 3])
    low = np.asarray(lower, float)
    high = np.asarray(upper, float)
    size = high - low
    chosen = np.zeros((0, 2))
    if number * apart**2 < 0.5 * float(np.prod(size)):
        for point in generator.uniform(low, high, (TRIES, 2)):
            if len(chosen) == number:
                break
            square = np.square(chosen - point).sum(1)  # m2
            if square.min(initial=np.inf) >= apart**2:
                chosen = np.concatenate([chosen, point[None]])
    if len(chosen) < number:
        return _displaced_grid(generator, low, size, number, apart)
    return chosen


def _displaced_grid(
    generator: np.random.Generator, low: np.ndarray, size: np.ndarray, number: int, apart: float
) -> np.ndarray:
    """(N, 2) m: random cells of a grid, displaced as far as the distance ``apart`` allows."""
    width, height = size
    columns = np.sqrt(number * width / max(height, 1e-9))
    columns = max(1, int(np.ceil(columns)))
    rows = int(np.ceil(number / columns))
    step = size / (columns, rows)

    cells = generator.permutation(columns * rows)[:number]
    column_row = np.stack([cells % columns, cells // columns], 1)  # (N, 2)
    center = low + (column_row + 0.5) * step
    room = np.maximum(step - apart, 0.0) / 2
    displacement = generator.uniform(-1.0, 1.0, (number, 2)) * room
    return center + displacement


def padded_size(number: int) -> int:
    """The size to which a crowd is padded with absent people."""
    return next((size for size in PEOPLE if size >= number), number)


def walkers_behavior(
    people: Walkers,
    gates: Sequence[Gate],
    *,
    exits: Sequence[int] = (),
    period: float = 0.0,
    intent: Intent | None = None,
) -> Behavior:
    """The behavior of walkers, padded to shared sizes; its companions are None if nobody walks in company.

    Args:
        exits: indices of gates between which people choose.
        period: m along x, of a periodic scene.
        intent: of all people.

    Raises:
        InputError: a route names a gate that does not exist, or there are too many gates.
    """
    # Tables of gates have few sizes, since every new shape compiles again.
    route = np.asarray(people.route)
    number = len(gates)
    padded = next((size for size in GATES if size >= number), None)
    if padded is None or route.shape[1] > LEGS:
        raise InputError(f"gates: {number}, of a route {route.shape[1]}; {GATES[-1]} and {LEGS} are the most.")
    if route.max(initial=-1) >= number:
        raise InputError(f"route: names gate {route.max()}, but there are {number} gates.")
    table = np.zeros((padded, 2, 2))
    ends = np.asarray([tuple(gate) for gate in gates], float)
    table[:number] = ends.reshape(-1, 2, 2)
    is_exit = np.isin(np.arange(padded), np.asarray(exits, int))
    sources = bool((np.asarray(people.entry_time) > 0.0).any())

    # People beyond the last one fill the crowd up to a size that others have, too.
    size = padded_size(len(people.start))
    people = _padded(people, size)
    companions = None
    if (people.companion >= 0).any():
        companions = jnp.asarray(people.companion, jnp.int32)

    # Constants of intent are leaves, with a type of their own, so that other values compile nothing again.
    intent = jax.tree.map(lambda leaf: np.asarray(leaf, float), intent)
    arrays = jax.device_put((people, table, is_exit, np.asarray(period, float), intent))
    arrays = jax.tree.map(lambda leaf: leaf.astype(float) if leaf.dtype.kind == "f" else leaf, arrays)
    plan = Plan(*arrays, sources=sources, choice=bool(is_exit.any()))
    return Behavior(
        data=plan,
        name="walkers",
        reset=reset,
        direct=direct,
        companions=companions,
        people=size,
    )


def _padded(people: Walkers, size: int) -> Walkers:
    """``size`` walkers; walkers beyond N never enter."""
    number = len(people.start)
    more = size - number
    along_x = 2.0 * np.arange(more)[:, None] * np.array([1.0, 0.0])  # nobody stands on another
    fill: dict[str, Any] = dict(
        start=AWAY + along_x,
        velocity=np.zeros((more, 2)),
        preferred_speed=np.ones(more),
        entry_time=np.full(more, NEVER),
        reaction_time=np.zeros(more),
        companion=np.full((more, 2), -1, np.int32),
    )
    fields: dict[str, Any] = {}
    for name, rows in fill.items():
        present = np.asarray(getattr(people, name))
        fields[name] = np.concatenate([present, rows])
    route = np.full((size, LEGS), -1, np.int32)
    route[:number, : people.route.shape[1]] = people.route
    return Walkers(**fields, route=route)  # pyright: ignore[reportArgumentType]


def reset(scenario: Scenario, key: Array) -> tuple[Pedestrians, Groups, Memory]:
    """N people at the start, present if they enter at once, no groups, and the memory of their routes."""
    plan: Plan = scenario.behavior.data
    people = plan.walkers
    number = people.start.shape[0]
    present = people.entry_time <= 0.0
    heading = _heading(plan)
    speed = people.preferred_speed
    pedestrians = pedestrians_at(people.start, people.velocity, preferred_speed=speed, present=present, heading=heading)

    companions = scenario.behavior.companions
    if companions is None:
        leader = jnp.full(number, -1, jnp.int32)
    else:
        leader = _leaders(companions)
    distance = draw_traits(scenario.forces, key, number)[1]
    pedestrians = replace(pedestrians, robot_distance=distance, walking_group=leader)

    # Walkers stand in no groups.
    pairs = jnp.zeros((0, 2), float)
    groups = Groups(center=pairs, radius=jnp.zeros(0, float), opening=pairs, present=jnp.zeros(0, bool))
    leg = jnp.zeros(number, jnp.int32)
    latents = None
    if plan.intent is not None:
        latents = draw(plan.intent, jax.random.fold_in(key, random_streams.INTENT), number)
    memory = Memory(leg, people.route[:, 0], present, latents)
    return pedestrians, groups, memory


def direct(scenario: Scenario, state: State, key: Array) -> State:
    """Send people from gate to gate: they vanish at their last one, and enter when they are due."""
    plan: Plan = scenario.behavior.data
    people = state.pedestrians
    memory = state.memory
    table = plan.walkers
    time = state.tick.astype(float) * scenario.time_step

    # Who has crossed a gate goes to the next one, or vanishes.
    walks = people.present & (memory.gate >= 0)
    ends = _ends(plan, memory.gate)  # (N, 2, 2) m
    crossed = walks & passed(ends, people.position)

    # A route is a list of gates; -1 fills it, and stands for the end of it.
    leg = memory.leg + crossed.astype(jnp.int32)
    legs = table.route.shape[1]
    index = _indices(leg.shape[0])
    next_gate = table.route[index, jnp.minimum(leg, legs - 1)]
    next_gate = jnp.where(leg < legs, next_gate, -1)
    gate = jnp.where(crossed, next_gate, memory.gate)
    vanishes = crossed & (gate < 0)
    people = replace(people, present=people.present & ~vanishes)

    # The choice comes after the next gate, so that it sees who waits where at this moment.
    if plan.choice:
        gate = choose_exit(plan, people, gate, state.tick)

    # A place of entry may be taken: then a person enters later, as soon as it is free.
    entered = memory.entered
    if plan.sources:
        enters = _enters(table, people, entered, time)
        position = jnp.where(enters[:, None], table.start, people.position)
        velocity = jnp.where(enters[:, None], table.velocity, people.velocity)
        wanted = jnp.where(enters[:, None], table.velocity, people.desired_velocity)
        people = replace(
            people,
            present=people.present | enters,
            position=position,
            velocity=velocity,
            desired_velocity=wanted,
        )
        entered = entered | enters

    # People walk to their gate, once they have reacted: straight there, or as they intend to.
    ends = _ends(plan, gate)
    to_gate = aim_at(ends, people.position) - people.position
    walks = (gate >= 0) & (time >= table.reaction_time) & people.present
    speed = jnp.where(walks, people.preferred_speed, 0.0)
    latents = memory.latents
    if plan.intent is None or latents is None:
        velocity = jnp.stack(_unit_of(to_gate), -1) * speed[:, None]
    else:
        moved = advance(plan.intent, latents, jax.random.fold_in(key, random_streams.INTENT), scenario.time_step)
        latents = moved._replace(speed=jnp.where(people.present, moved.speed, 0.0))
        wanted = people.desired_velocity
        velocity = wanted_velocity(plan.intent, latents, wanted, to_gate, speed, scenario.time_step)
    people = replace(people, desired_velocity=velocity)
    return replace(state, pedestrians=people, memory=Memory(leg, gate, entered, latents))


def passed(gate: Float[Array, "N 2 2"], position: Float[Array, "N 2"]) -> Bool[Array, "N"]:
    """(N,) whether people are behind the line of their gate (N, 2, 2) m, by its width and ``MARGIN`` to both sides."""
    along, behind, width = _in_frame_of(gate, position)
    is_behind = (behind > 0.0) & (behind < DEPTH)
    return is_behind & (along > -MARGIN) & (along < width + MARGIN)


def aim_at(gate: Float[Array, "N 2 2"], position: Float[Array, "N 2"]) -> Float[Array, "N 2"]:
    """(N, 2) m: the nearest point of each gate (N, 2, 2) m, ``AHEAD`` behind its line and ``MARGIN`` from its ends."""
    along, _, width = _in_frame_of(gate, position)
    margin = jnp.minimum(MARGIN, 0.5 * width)
    along = jnp.clip(along, margin, width - margin)

    side_x = gate[:, 1, 0] - gate[:, 0, 0]
    side_y = gate[:, 1, 1] - gate[:, 0, 1]
    ux, uy = unit(side_x, side_y)
    x = gate[:, 0, 0] + along * ux - AHEAD * uy
    y = gate[:, 0, 1] + along * uy + AHEAD * ux
    return jnp.stack([x, y], -1)


def choose_exit(plan: Plan, people: Pedestrians, gate: Int[Array, "N"], tick: Int[Array, ""]) -> Int[Array, "N"]:
    """(N,) the exit through which each expects to be out first: by the walk, or by the queue of people nearer to it.

    Everybody looks once in ``TURNS`` ticks, and changes only for a clear gain, so that crowds do not oscillate. Only
    people on their way to an exit choose.
    """
    # Each person against each gate, as N times G rows of one function.
    number = gate.shape[0]
    gates = plan.gates.shape[0]
    index = _indices(number)
    all_gates = jnp.broadcast_to(plan.gates[None], (number, gates, 2, 2))
    position = jnp.repeat(people.position, gates, axis=0)  # (N G, 2)
    aim = aim_at(all_gates.reshape(-1, 2, 2), position)
    aim = aim.reshape(number, gates, 2)  # (N, G, 2)
    gap = aim - people.position[:, None]
    distance = length(gap[..., 0], gap[..., 1])  # (N, G)

    # A queue is the people on their way to a gate; those who are nearer to it go first.
    is_to_gate = gate[:, None] == _indices(gates)[None]  # (N, G)
    chosen = is_to_gate & people.present[:, None]
    queue = jnp.where(chosen, distance, jnp.inf)
    queue = jnp.sort(queue, axis=0)  # (N, G)
    ahead = jax.vmap(lambda row, own: jnp.searchsorted(row, own), in_axes=1, out_axes=1)(queue, distance)

    # The time to be out is that of the walk or of the queue.
    side = plan.gates[:, 1] - plan.gates[:, 0]
    width = length(side[:, 0], side[:, 1])  # (G,)
    walk_time = distance / jnp.maximum(people.preferred_speed, 1e-3)[:, None]  # (N, G) s
    people_ahead = ahead.astype(float)
    rate = EXIT_FLOW * jnp.maximum(width, 1e-3)  # (G,) people/s
    time = jnp.maximum(walk_time, people_ahead / rate[None])
    time = jnp.where(plan.is_exit[None], time, jnp.inf)

    # Hysteresis and turns: if all looked at once, all would go to the empty exit, and back.
    best = jnp.argmin(time, axis=1).astype(jnp.int32)
    current = time[index, jnp.maximum(gate, 0)]  # (N,) s
    has_turn = index % TURNS == tick % TURNS
    to_exit = plan.is_exit[jnp.maximum(gate, 0)]
    looks = has_turn & (gate >= 0) & to_exit
    gains = time[index, best] < PATIENCE * current
    return jnp.where(looks & gains, best, gate)


def _indices(number: int) -> Int[Array, "N"]:
    return jnp.arange(number, dtype=jnp.int32)


def _ends(plan: Plan, gate: Int[Array, "N"]) -> Float[Array, "N 2 2"]:
    """The ends [m] of the gate of each person; of any gate where there is none."""
    return plan.gates[jnp.maximum(gate, 0)]


def _unit_of(vector: Float[Array, "N 2"]) -> tuple[Array, Array]:
    """The components (N,) of unit vectors along vectors."""
    return unit(vector[:, 0], vector[:, 1])


def _in_frame_of(gate: Array, position: Array) -> tuple[Array, Array, Array]:
    """(N,) along each gate from its left end, and behind its line; and its width [m]."""
    left = gate[:, 0]
    side = gate[:, 1] - left
    gap = position - left
    ux, uy = _unit_of(side)
    along = gap[:, 0] * ux + gap[:, 1] * uy
    behind = gap[:, 1] * ux - gap[:, 0] * uy
    width = length(side[:, 0], side[:, 1])
    return along, behind, width


def _heading(plan: Plan) -> Array:
    """(N, 2) along the velocity at the start; of standing people, towards the first gate."""
    people = plan.walkers
    first_gate = people.route[:, 0]
    along_x = jnp.asarray([[1.0, 0.0]], float)
    ends = _ends(plan, first_gate)
    to_gate = aim_at(ends, people.start) - people.start
    moving = (people.velocity != 0.0).any(-1)[:, None]
    of_standing = jnp.where(first_gate[:, None] >= 0, to_gate, along_x)
    x, y = _unit_of(jnp.where(moving, people.velocity, of_standing))
    is_zero = (x == 0.0) & (y == 0.0)
    heading = jnp.stack([x, y], -1)
    return jnp.where(is_zero[:, None], along_x, heading)


def _enters(table: Walkers, people: Pedestrians, entered: Array, time: Array) -> Array:
    """(N,) whether people enter now: they are due, nobody is there and nobody before them waits for the place."""
    due = ~entered & (table.entry_time <= time)
    taken = people.present[None] & _within_room(table.start, people.position)

    # Of people who wait for one place, the one with the lowest index enters.
    own = _indices(due.shape[0])
    earlier = due[None] & (own[None] < own[:, None])
    before = earlier & _within_room(table.start, table.start)
    waits = (taken | before).any(1)
    return due & ~waits


def _within_room(place: Array, others: Array) -> Array:
    """(N, M) whether the others (M, 2) m are within ``ROOM`` of each place (N, 2) m."""
    gap_x = place[:, None, 0] - others[None, :, 0]
    gap_y = place[:, None, 1] - others[None, :, 1]
    return gap_x * gap_x + gap_y * gap_y < ROOM * ROOM


def _leaders(companions: Array) -> Array:
    """(N,) the lowest index of each chain of companions, -1 alone."""
    number = companions.shape[0]
    own = _indices(number)
    lowest = jnp.where((companions >= 0).any(1), own, number)

    def spread_lowest(_, lowest):
        of_companions = lowest[jnp.maximum(companions, 0)]  # (N, 2)
        near = jnp.where(companions >= 0, of_companions, number).min(1)
        return jnp.minimum(lowest, near)

    lowest = jax.lax.fori_loop(0, number, spread_lowest, lowest)
    return jnp.where(lowest < number, lowest, -1)
