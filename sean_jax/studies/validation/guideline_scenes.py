"""The scenes of the guidelines: corridors, a corner, cabins, rooms with doors, and their people.

RiMEA, IMO, NIST and ISO share most of these, with these dimensions.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from sean_jax.studies.scenes import Gate, Scene, box, corridor, join, room, spread, walkers, wall
from sean_jax.studies.scenes.walkers import Walkers

BEYOND = 1e4  # m, where people in a periodic corridor aim
SECONDARY = 4, 5, 10, 11  # cabins whose people leave by the secondary exit: 5, 6, 11 and 12
ORIGIN = 0.0, 0.0
HALL = 30.0, 20.0  # m
ROOM_8_BY_5 = 8.0, 5.0  # m
ROOM_10_BY_10 = 10.0, 10.0  # m
NO_WALLS = np.zeros((0, 5))


def gate_right(x: float, low: float, high: float) -> Gate:
    """A gate from y = ``low`` to ``high`` [m], through which people walk along x."""
    return Gate((x, high), (x, low))


def gate_left(x: float, low: float, high: float) -> Gate:
    """A gate from y = ``low`` to ``high`` [m], through which people walk against x."""
    return Gate((x, low), (x, high))


def gate_up(y: float, left: float, right: float) -> Gate:
    """A gate from x = ``left`` to ``right`` [m], through which people walk along y."""
    return Gate((left, y), (right, y))


def gate_down(y: float, left: float, right: float) -> Gate:
    """A gate from x = ``left`` to ``right`` [m], through which people walk against y."""
    return Gate((right, y), (left, y))


def abreast(number: int, spacing: float, first: float = 0.0) -> Float[np.ndarray, "N 2"]:
    """Places side by side at x = 0, from y = ``first`` on [m]."""
    y = spacing * np.arange(number) + first
    return np.stack([np.zeros(number), y], 1)


# ------------------------------------------------------------------ corridors


def one_walker(speed: float, length: float = 40.0) -> Scene:
    """One person of a preferred speed [m/s] in a corridor 2 m wide, from x = 0 to ``length`` [m]."""
    walls = corridor(length, 2.0, 10.0)
    end = gate_right(length, 0.0, 2.0)
    people = walkers(abreast(1, 0.0, 1.0), route=(0,), speed=speed)
    return Scene(walls, people, (end,), seconds=120.0)


def periodic(length: float, width: float, people: Walkers, seconds: float) -> Scene:
    """A periodic corridor (length, width in m), in which people of route 0 walk along x and people of route 1 back."""
    walls = corridor(length, width, length / 2)
    ahead = gate_right(BEYOND, 0.0, width)
    back = gate_left(-BEYOND, 0.0, width)
    return Scene(walls, people, (ahead, back), seconds, length)


def ring(
    length: float,
    width: float,
    number: int,
    seconds: float,
    speed: float | np.ndarray | None = None,
    seed: int = 0,
    inset: float = 0.22,
) -> Scene:
    """A periodic corridor in which all walk the same way, at first ``inset`` m from the walls; speed as ``walkers``."""
    start = spread((0.0, inset), (length, width - inset), number, seed)
    people = walkers(start, route=(0,), speed=speed, seed=seed)
    return periodic(length, width, people, seconds)


def group() -> Scene:
    """Five people who walk together from one end of a corridor 4 m wide to the other: one at .5 m/s, four at 1.25.

    The walls are far: only the group itself keeps it together.
    """
    walls = corridor(40.0, 4.0, 2.0)
    end = gate_right(40.0, 0.0, 4.0)
    speed = np.array([1.25, 1.25, 0.5, 1.25, 1.25])
    people = walkers(abreast(5, 0.8, 0.4), route=(0,), speed=speed, together=True)
    return Scene(walls, people, (end,), seconds=120.0)


def population(speed: np.ndarray) -> Scene:
    """People of preferred speeds (N,) m/s who walk 40 m side by side, two metres apart, without walls."""
    number = len(speed)
    people = walkers(abreast(number, 2.0), route=(0,), speed=speed)
    end = gate_right(40.0, -2.0, 2.0 * number)
    return Scene(NO_WALLS, people, (end,), seconds=100.0)


def corner() -> Scene:
    """Twenty people walk around a left-hand corner of a corridor 2 m wide, with x 0 to 10, y 2 to 12 m inside."""
    walls, diagonal, end = _around_corner(10.0, 2.0, 12.0, 12.0)
    start = spread((0.3, 0.3), (5.7, 1.7), 20)
    people = walkers(start, route=(0, 1))
    return Scene(walls, people, (diagonal, end), seconds=60.0)


def _around_corner(x: float, y: float, right: float, top: float) -> tuple[np.ndarray, Gate, Gate]:
    """The walls of a corridor that turns left around (x, y), a gate across its corner, and one at its end.

    It is as wide as ``y`` until the corner, and ends at y = ``top`` [m].
    """
    inner = box((-1.0, y), (x, top))
    lower = box((-1.0, -0.5), (right, 0.0))
    outer = box((right, -0.5), (right + 0.5, top))
    walls = np.concatenate([inner, lower, outer])

    diagonal = Gate((x, y), (right, 0.0))
    end = gate_up(top, x, right)
    return walls, diagonal, end


def wide_ways() -> dict[str, Scene]:
    """Ways 20 m wide for 500 people, who begin in the first 6 m: a short one, one around a corner, a long one."""
    start = spread((0.3, 0.3), (5.7, 19.7), 500)
    short = _straight_way(start, 50.0)
    around = _way_with_corner(start)
    long = _straight_way(start, 81.4)
    return {"short": short, "corner": around, "long": long}


def _straight_way(start: np.ndarray, length: float) -> Scene:
    walls = corridor(length, 20.0, 1.0)
    end = gate_right(length, 0.0, 20.0)
    people = walkers(start, route=(0,))
    return Scene(walls, people, (end,), seconds=250.0)


def _way_with_corner(start: np.ndarray) -> Scene:
    walls, diagonal, end = _around_corner(20.0, 20.0, 40.0, 50.0)

    # Until the first gate they walk side by side, as along a straight way.
    straight = gate_right(20.0, 0.0, 20.0)
    people = walkers(start, route=(0, 1, 2))
    return Scene(walls, people, (straight, diagonal, end), seconds=250.0)


# ------------------------------------------------------------------ rooms


def reactions() -> Scene:
    """A room of 8 by 5 m with ten people, who begin to walk after 10 to 100 s."""
    columns = np.tile(np.arange(5) * 1.2 + 0.8, 2)
    rows = np.repeat([1.2, 3.8], 5)
    start = np.stack([columns, rows], 1)  # (10, 2) m
    reaction = np.random.default_rng([0, 5]).uniform(10.0, 100.0, 10)
    people = walkers(start, route=(0,), speed=1.33, reaction_time=reaction)

    door = gate_right(8.0, 2.0, 3.0)
    walls = room(ORIGIN, ROOM_8_BY_5, [door])
    return Scene(walls, people, (door,), seconds=130.0)


def full_room(door: float = 1.0) -> Scene:
    """A room of 8 by 5 m with 100 people, a door (width in m) in the middle of a 5 m wall; they vanish 0.7 m behind."""
    through = gate_right(8.0, 2.5 - door / 2, 2.5 + door / 2)
    behind = gate_right(8.7, 1.0, 4.0)
    walls = room(ORIGIN, ROOM_8_BY_5, [through])

    start = spread((0.3, 0.3), (7.5, 4.7), 100)
    people = walkers(start, route=(0, 1))
    return Scene(walls, people, (through, behind), seconds=300.0)


def hall(number: int, doors: int) -> Scene:
    """A hall of 30 by 20 m with 4 doors of 1 m, or 2 in the upper wall; people start 2 m from the walls, and choose."""
    # Two doors are in the upper wall and two in the lower, 4 m from the corners.
    upper = gate_up(20.0, 4.0, 5.0), gate_up(20.0, 25.0, 26.0)
    lower = gate_down(0.0, 4.0, 5.0), gate_down(0.0, 25.0, 26.0)
    gates = (upper + lower)[:doors]
    walls = room(ORIGIN, HALL, gates)

    # All choose the nearest door.
    start = spread((2.0, 2.0), (28.0, 18.0), number)
    middle = np.mean(gates, axis=1)  # (doors, 2) m
    nearest = np.linalg.norm(start[:, None] - middle[None], axis=-1).argmin(1)
    speed = np.asarray(walkers(start).preferred_speed)
    crowds = []
    for door in range(doors):
        chosen = nearest == door
        crowds.append(walkers(start[chosen], route=(door,), speed=speed[chosen]))
    exits = tuple(range(doors))
    return Scene(walls, join(*crowds), gates, seconds=900.0, exits=exits)


def two_exits(number: int) -> Scene:
    """A hall of 30 by 20 m, people on the left, two exits of 1 m in the upper wall; all begin towards the nearer."""
    gates = gate_up(20.0, 17.0, 18.0), gate_up(20.0, 26.0, 27.0)
    walls = room(ORIGIN, HALL, gates)
    start = spread((1.0, 1.0), (13.0, 19.0), number)
    people = walkers(start, route=(0,))
    return Scene(walls, people, gates, seconds=900.0, exits=(0, 1))


def equal_exits(number: int) -> Scene:
    """A room of 20 by 10 m with people in the middle, exits of 1 m in both short walls; all begin towards the left."""
    gates = gate_left(0.0, 4.5, 5.5), gate_right(20.0, 4.5, 5.5)
    walls = room(ORIGIN, (20.0, 10.0), gates)
    start = spread((5.0, 1.0), (15.0, 9.0), number)
    people = walkers(start, route=(0,))
    return Scene(walls, people, gates, seconds=300.0, exits=(0, 1))


def two_rooms(passage: float, seed: int = 0) -> Scene:
    """Two rooms of 10 by 10 m, a passage of a width [m] 5 m long between them, 150 people in the first, an exit of 1 m.

    Gate 0 is the beginning of the passage, gate 1 its end, gate 2 the exit.
    """
    low = 5.0 - passage / 2
    high = 5.0 + passage / 2
    begin = gate_right(10.0, low, high)
    end = gate_right(15.0, low, high)
    exit_gate = gate_right(25.0, 4.5, 5.5)
    walls = _rooms_and_passage(15.0, low, high, [begin], [end, exit_gate])

    start = spread((0.3, 0.3), (5.0, 9.7), 150, seed)
    people = walkers(start, route=(0, 1, 2), seed=seed)
    return Scene(walls, people, (begin, end, exit_gate), seconds=400.0, seed=seed)


def _rooms_and_passage(
    end: float, low: float, high: float, first_doors: Sequence[Gate], second_doors: Sequence[Gate]
) -> Float[np.ndarray, "W 5"]:
    """The walls of two rooms of 10 by 10 m, from x = 0 and from x = ``end`` on, and of a passage between them [m]."""
    first = room(ORIGIN, ROOM_10_BY_10, first_doors)
    second = room((end, 0.0), (end + 10.0, 10.0), second_doors)
    below = box((10.0, low - 0.2), (end, low))
    above = box((10.0, high), (end, high + 0.2))
    return np.concatenate([first, second, below, above])


def counterflow(against: int) -> Scene:
    """Two rooms of 10 by 10 m, a corridor of 10 by 2 m between them; 100 people go from the first to the second.

    The 100 are the first people; all vanish at the far walls. Gate 1 is the end of the corridor for the 100.
    """
    to_second = gate_right(10.0, 4.0, 6.0), gate_right(20.0, 4.0, 6.0), gate_right(29.0, 0.0, 10.0)
    to_first = gate_left(20.0, 4.0, 6.0), gate_left(10.0, 4.0, 6.0), gate_left(1.0, 0.0, 10.0)

    walls = _rooms_and_passage(20.0, 4.0, 6.0, to_second[:1], to_second[1:2])

    start = spread((0.3, 0.3), (9.0, 9.7), 100)
    people: Walkers = walkers(start, route=(0, 1, 2))
    if against:
        start = spread((21.0, 0.3), (29.7, 9.7), against, seed=1)
        people = join(people, walkers(start, route=(3, 4, 5), seed=1))
    return Scene(walls, people, to_second + to_first, seconds=400.0)


def cabins() -> Scene:
    """Twelve cabins of 3 by 5 m on both sides of a corridor 1.2 m wide, with 23 people.

    People of cabins 5, 6, 11 and 12 are to leave by the secondary exit (gate 13) at the right end, the others by the
    main one (gate 12) at the left. Cabins 1 to 6 lie above the corridor and 7 to 12 below it, from left to right.
    """
    wide = 3.0
    deep = 5.0
    way = 1.2
    length = 6 * wide
    top = way + deep

    upper = wall((0.0, way), (0.0, top), (length, top), (length, way))
    lower = wall(ORIGIN, (0.0, -deep), (length, -deep))
    right = wall((length, -deep), (length, 0.0))
    walls = [upper, lower, right]

    gates = []
    people = []
    for cabin in range(12):
        left = (cabin % 6) * wide
        if cabin < 6:
            front = way
            back = top
            inward = 1.0
        else:
            front = 0.0
            back = -deep
            inward = -1.0
        cabin_walls, door = _cabin(left, wide, front, back)
        walls += cabin_walls
        gates.append(door)

        # Two people stand in each cabin, and one in the last.
        nearer = [left + 1.0, front + inward * 3.0]
        farther = [left + 2.0, front + inward * 3.5]
        start = [nearer] if cabin == 11 else [nearer, farther]

        exit_gate = 13 if cabin in SECONDARY else 12
        people.append(walkers(np.array(start), route=(cabin, exit_gate), seed=cabin))

    main = gate_left(0.0, 0.0, way)
    secondary = gate_right(length, 0.0, way)
    gates += [main, secondary]
    return Scene(np.concatenate(walls), join(*people), tuple(gates), seconds=120.0)


def _cabin(left: float, wide: float, front: float, back: float) -> tuple[list[np.ndarray], Gate]:
    """The front wall of a cabin, its wall to the cabin on its left, and its door, a gate to the corridor.

    Args:
        left: m, the lowest x of the cabin.
        front: m, y of the wall to the corridor.
        back: m, y of the opposite wall.
    """
    door_left = left + 0.5 * wide - 0.45
    door_right = left + 0.5 * wide + 0.45
    before_door = wall((left, front), (door_left, front))
    behind_door = wall((door_right, front), (left + wide, front))

    walls = [before_door, behind_door]
    if left > 0.0:
        walls.append(wall((left, front), (left, back)))

    # The gate is in the corridor; farther in people swing into the cabin on the other side.
    if back > front:
        return walls, gate_down(front - 0.05, door_left, door_right)
    return walls, gate_up(front + 0.05, door_left, door_right)
