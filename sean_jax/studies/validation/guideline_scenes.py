"""The scenes of the guidelines: corridors, a corner, cabins, rooms with doors, and their people.

RiMEA, IMO, NIST and ISO share most of these, with these dimensions.
"""

import numpy as np

from sean_jax.studies.scenes import Gate, Scene, box, corridor, join, room, spread, walkers, wall
from sean_jax.studies.scenes.walkers import Walkers

BEYOND = 1e4  # m, where people in a periodic corridor aim
EXITS = (((4.0, 20.0), (5.0, 20.0)), ((25.0, 20.0), (26.0, 20.0)), ((5.0, 0.0), (4.0, 0.0)), ((26.0, 0.0), (25.0, 0.0)))
"""The doors of the hall of 30 by 20 m, two in the upper wall and two in the lower, 4 m from the corners"""
SECONDARY = 4, 5, 10, 11  # cabins whose people leave by the secondary exit: 5, 6, 11 and 12


def one_walker(speed: float, length: float = 40.0) -> Scene:
    """One person of a preferred speed [m/s] in a corridor 2 m wide, from x = 0 to ``length`` [m]."""
    gate = Gate((length, 2.0), (length, 0.0))
    people = walkers(np.array([[0.0, 1.0]]), route=(0,), speed=speed)
    return Scene(walls=corridor(length, 2.0, 10.0), gates=(gate,), walkers=people, seconds=120.0)


def periodic(length: float, width: float, people: Walkers, seconds: float) -> Scene:
    """A periodic corridor (length, width in m), in which people of route 0 walk along x and people of route 1 back."""
    gates = Gate((BEYOND, width), (BEYOND, 0.0)), Gate((-BEYOND, 0.0), (-BEYOND, width))
    return Scene(corridor(length, width, length / 2), people, gates, seconds, length)


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
    return periodic(length, width, walkers(start, route=(0,), speed=speed, seed=seed), seconds)


def reactions() -> Scene:
    """A room of 8 by 5 m with ten people, who begin to walk after 10 to 100 s."""
    door = Gate((8.0, 3.0), (8.0, 2.0))
    start = np.stack([np.tile(np.arange(5) * 1.2 + 0.8, 2), np.repeat([1.2, 3.8], 5)], 1)
    reaction = np.random.default_rng([0, 5]).uniform(10.0, 100.0, 10)
    people = walkers(start, route=(0,), speed=1.33, reaction_time=reaction)
    return Scene(walls=room((0.0, 0.0), (8.0, 5.0), [door]), gates=(door,), walkers=people, seconds=130.0)


def corner() -> Scene:
    """Twenty people walk around a left-hand corner of a corridor 2 m wide, with x 0 to 10, y 2 to 12 m inside."""
    walls = [box((-1.0, 2.0), (10.0, 12.0)), box((-1.0, -0.5), (12.0, 0.0)), box((12.0, -0.5), (12.5, 12.0))]
    gates = Gate((10.0, 2.0), (12.0, 0.0)), Gate((10.0, 12.0), (12.0, 12.0))
    people = walkers(spread((0.3, 0.3), (5.7, 1.7), 20), route=(0, 1))
    return Scene(np.concatenate(walls), people, gates, seconds=60.0)


def population(speed: np.ndarray) -> Scene:
    """People of preferred speeds (N,) m/s who walk 40 m side by side, two metres apart, without walls."""
    number = len(speed)
    start = np.stack([np.zeros(number), 2.0 * np.arange(number)], 1)
    gate = Gate((40.0, 2.0 * number), (40.0, -2.0))
    return Scene(walls=np.zeros((0, 5)), gates=(gate,), walkers=walkers(start, route=(0,), speed=speed), seconds=100.0)


def hall(number: int, doors: int) -> Scene:
    """A hall of 30 by 20 m with 4 doors of 1 m, or 2 in the upper wall; people start 2 m from the walls, and choose."""
    gates = tuple(Gate(*ends) for ends in EXITS[:doors])
    start = spread((2.0, 2.0), (28.0, 18.0), number)
    middle = np.array([np.mean(gate, axis=0) for gate in gates])
    nearest = np.linalg.norm(start[:, None] - middle[None], axis=-1).argmin(1)
    speed = np.asarray(walkers(start).preferred_speed)
    own = [nearest == door for door in range(doors)]
    crowd = join(*(walkers(start[mine], route=(door,), speed=speed[mine]) for door, mine in enumerate(own)))
    return Scene(room((0.0, 0.0), (30.0, 20.0), gates), crowd, gates, seconds=900.0, exits=tuple(range(doors)))


def two_exits(number: int) -> Scene:
    """A hall of 30 by 20 m, people on the left, two exits of 1 m in the upper wall; all begin towards the nearer."""
    gates = Gate((17.0, 20.0), (18.0, 20.0)), Gate((26.0, 20.0), (27.0, 20.0))
    people = walkers(spread((1.0, 1.0), (13.0, 19.0), number), route=(0,))
    return Scene(room((0.0, 0.0), (30.0, 20.0), gates), people, gates, seconds=900.0, exits=(0, 1))


def equal_exits(number: int) -> Scene:
    """A room of 20 by 10 m with people in the middle, exits of 1 m in both short walls; all begin towards the left."""
    gates = Gate((0.0, 4.5), (0.0, 5.5)), Gate((20.0, 5.5), (20.0, 4.5))
    people = walkers(spread((5.0, 1.0), (15.0, 9.0), number), route=(0,))
    return Scene(room((0.0, 0.0), (20.0, 10.0), gates), people, gates, seconds=300.0, exits=(0, 1))


def cabins() -> Scene:
    """Twelve cabins of 3 by 5 m on both sides of a corridor 1.2 m wide, with 23 people.

    People of cabins 5, 6, 11 and 12 are to leave by the secondary exit (gate 13) at the right end, the others by the
    main one (gate 12) at the left. Cabins 1 to 6 lie above the corridor and 7 to 12 below it, from left to right.
    """
    wide, deep, way, half = 3.0, 5.0, 1.2, 0.45
    long, top = 6 * wide, way + deep
    parts = [wall((0.0, way), (0.0, top), (long, top), (long, way)), wall((0.0, 0.0), (0.0, -deep), (long, -deep))]
    parts.append(wall((long, -deep), (long, 0.0)))
    gates, people = [], []
    for cabin in range(12):
        above, column = cabin < 6, cabin % 6
        left, middle = column * wide, (column + 0.5) * wide
        side, back, sign = (way, top, 1.0) if above else (0.0, -deep, -1.0)
        parts += [wall((left, side), (middle - half, side)), wall((middle + half, side), (left + wide, side))]
        if column:
            parts.append(wall((left, side), (left, back)))
        inside = side - sign * 0.05  # in the corridor; farther in people swing into the cabin on the other side
        ends = (middle + half, inside), (middle - half, inside)
        gates.append(Gate(*ends) if above else Gate(*ends[::-1]))
        number = 1 if cabin == 11 else 2
        spots = np.array([[left + 1.0, side + sign * 3.0], [left + 2.0, side + sign * 3.5]])[:number]
        people.append(walkers(spots, route=(cabin, 13 if cabin in SECONDARY else 12), seed=cabin))
    gates += [Gate((0.0, 0.0), (0.0, way)), Gate((long, way), (long, 0.0))]
    return Scene(walls=np.concatenate(parts), gates=tuple(gates), walkers=join(*people), seconds=120.0)


def two_rooms(passage: float, seed: int = 0) -> Scene:
    """Two rooms of 10 by 10 m, a passage of a width [m] 5 m long between them, 150 people in the first, an exit of 1 m.

    Gate 0 is the beginning of the passage, gate 1 its end, gate 2 the exit.
    """
    low, high = 5.0 - passage / 2, 5.0 + passage / 2
    gates = Gate((10.0, high), (10.0, low)), Gate((15.0, high), (15.0, low)), Gate((25.0, 5.5), (25.0, 4.5))
    rooms = room((0.0, 0.0), (10.0, 10.0), gates[:1]), room((15.0, 0.0), (25.0, 10.0), gates[1:])
    walls = np.concatenate([*rooms, box((10.0, low - 0.2), (15.0, low)), box((10.0, high), (15.0, high + 0.2))])
    people = walkers(spread((0.3, 0.3), (5.0, 9.7), 150, seed), route=(0, 1, 2), seed=seed)
    return Scene(walls, people, gates, seconds=400.0, seed=seed)


def counterflow(against: int) -> Scene:
    """Two rooms of 10 by 10 m, a corridor of 10 by 2 m between them; 100 people go from the first to the second.

    The 100 are the first people; all vanish at the far walls. Gate 1 is the end of the corridor for the 100.
    """
    left, right = ((10.0, 6.0), (10.0, 4.0)), ((20.0, 6.0), (20.0, 4.0))
    there = Gate(*left), Gate(*right), Gate((29.0, 10.0), (29.0, 0.0))
    back = Gate(*right[::-1]), Gate(*left[::-1]), Gate((1.0, 0.0), (1.0, 10.0))
    rooms = room((0.0, 0.0), (10.0, 10.0), [left]), room((20.0, 0.0), (30.0, 10.0), [right])
    walls = np.concatenate([*rooms, box((10.0, 3.8), (20.0, 4.0)), box((10.0, 6.0), (20.0, 6.2))])
    people: Walkers = walkers(spread((0.3, 0.3), (9.0, 9.7), 100), route=(0, 1, 2))
    if against:
        others = spread((21.0, 0.3), (29.7, 9.7), against, seed=1)
        people = join(people, walkers(others, route=(3, 4, 5), seed=1))
    return Scene(walls, people, there + back, seconds=400.0)


def full_room(door: float = 1.0) -> Scene:
    """A room of 8 by 5 m with 100 people, a door (width in m) in the middle of a 5 m wall; they vanish 0.7 m behind."""
    gates = Gate((8.0, 2.5 + door / 2), (8.0, 2.5 - door / 2)), Gate((8.7, 4.0), (8.7, 1.0))
    people = walkers(spread((0.3, 0.3), (7.5, 4.7), 100), route=(0, 1))
    return Scene(room((0.0, 0.0), (8.0, 5.0), gates[:1]), people, gates, seconds=300.0)


def wide_ways() -> dict[str, Scene]:
    """Ways 20 m wide for 500 people, who begin in the first 6 m: a short one, one around a corner, a long one."""
    start, wide = spread((0.3, 0.3), (5.7, 19.7), 500), 20.0

    def straight(length: float) -> Scene:
        gate = Gate((length, wide), (length, 0.0))
        return Scene(corridor(length, wide, 1.0), walkers(start, route=(0,)), (gate,), seconds=250.0)

    inner = box((-1.0, wide), (20.0, wide + 30.0))
    walls = np.concatenate([inner, box((-1.0, -0.5), (40.0, 0.0)), box((40.0, -0.5), (40.5, wide + 30.0))])
    before = Gate((20.0, wide), (20.0, 0.0))  # until there they walk side by side, as along a straight way
    gates = before, Gate((20.0, wide), (40.0, 0.0)), Gate((20.0, wide + 30.0), (40.0, wide + 30.0))
    corner = Scene(walls, walkers(start, route=(0, 1, 2)), gates, seconds=250.0)
    return {"short": straight(50.0), "corner": corner, "long": straight(81.4)}


def group() -> Scene:
    """Five people who walk together from one end of a corridor 4 m wide to the other: one at .5 m/s, four at 1.25.

    The walls are far: only the group itself keeps it together.
    """
    start = np.stack([np.zeros(5), 0.8 * np.arange(5) + 0.4], 1)
    speed = np.array([1.25, 1.25, 0.5, 1.25, 1.25])
    gate = Gate((40.0, 4.0), (40.0, 0.0))
    people = walkers(start, route=(0,), speed=speed, together=True)
    return Scene(corridor(40.0, 4.0, 2.0), people, (gate,), seconds=120.0)
