"""Families of floors: walls, furniture and stalls as upright boxes, drawn from a few words.

A gap between two boxes, and between a box and the edge of the floor, is nothing or at least ``GAP``. So whoever passes
the doors passes everything.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

GAP = 1.0  # m, between things; more than the widest robot of the package needs
TOUCH = 0.02  # m, up to which two boxes count as one
WALL = 0.12  # m, thickness
TRIES = 40  # places that are tried for a thing
MAX_THINGS = 300  # on a floor

# Heights [m].
WALL_HEIGHT = 2.5
SHELF = 2.0
SCREEN = 1.4
COUNTER = 1.1
POST = 0.95
DESK = 0.75

# Colors.
WALL_COLOR = (0.85, 0.84, 0.80)
WOOD = (0.62, 0.48, 0.33)
METAL = (0.45, 0.50, 0.56)
STONE = (0.66, 0.64, 0.62)
CLOTH = (0.36, 0.45, 0.58)


class Thing(NamedTuple):
    """An upright box."""

    x: float  # m, its center
    y: float
    hx: float  # m, half extents
    hy: float
    yaw: float  # rad
    height: float  # m
    color: tuple[float, float, float]


def kind_of(height: float, color: Sequence[float]) -> str:
    """What a box of a height [m] and a color is: ``wall``, ``shelf`` or ``box``."""
    if np.allclose(color, WALL_COLOR):
        return "wall"
    if np.isclose(height, SHELF) and np.allclose(color, METAL):
        return "shelf"
    return "box"


class TooManyThings(ValueError):
    """A floor has more than ``MAX_THINGS``."""


class Floor:
    """A floor from (0, 0) to (width, depth) [m] while things are put on it."""

    def __init__(self, generator: np.random.Generator, width: float, depth: float) -> None:
        self.generator = generator
        self.width = width
        self.depth = depth
        self.things: list[Thing] = []
        self.clear: list[tuple[float, float, float]] = []  # x, y, radius [m] of places that stay free, such as doors
        self.compared = 0  # pairs of things

    def add(self, x: float, y: float, hx: float, hy: float, height: float, color: tuple, yaw: float = 0.0) -> None:
        """Put a box there, whatever stands beside it; TooManyThings if there are as many as a floor may have."""
        if len(self.things) == MAX_THINGS:
            raise TooManyThings
        self.things.append(Thing(x, y, hx, hy, yaw, height, color))

    def wall(self, x0: float, y0: float, x1: float, y1: float, height: float = WALL_HEIGHT) -> None:
        """A wall along x or y between two points."""
        x = (x0 + x1) / 2
        y = (y0 + y1) / 2
        hx = abs(x1 - x0) / 2 + WALL / 2
        hy = abs(y1 - y0) / 2 + WALL / 2
        self.add(x, y, hx, hy, height, WALL_COLOR)

    def wall_with_doors(self, along_x: bool, across: float, start: float, end: float, doors: list, door: float) -> None:
        """A wall along x or y, at ``across`` of the other, with doors, whose middles are given in rising order."""

        def point(along: float) -> tuple[float, float]:
            if along_x:
                return along, across
            return across, along

        for middle in doors:
            self._wall_between(point, start, middle - door / 2)
            x, y = point(middle)
            self.clear.append((x, y, 0.5 * door + GAP))
            start = middle + door / 2
        self._wall_between(point, start, end)

    def _wall_between(self, point: Callable, start: float, end: float) -> None:
        """A piece of a wall, if it is longer than it is thick."""
        if end - start <= WALL:
            return
        x0, y0 = point(start + WALL / 2)
        x1, y1 = point(end - WALL / 2)
        self.wall(x0, y0, x1, y1)

    def fits(self, x: float, y: float, hx: float, hy: float, yaw: float = 0.0, gap: float = GAP) -> bool:
        """Whether a box has a gap of nothing or at least ``gap`` to all others and to the edges, and blocks nothing."""
        self.compared += len(self.things)
        reach_x, reach_y = _reach(hx, hy, yaw)

        # The edges of the floor.
        to_edges = x - reach_x, y - reach_y, self.width - x - reach_x, self.depth - y - reach_y
        for distance in to_edges:
            if abs(distance) > TOUCH and distance < gap:
                return False

        # Places that stay free.
        for clear_x, clear_y, radius in self.clear:
            dx = abs(clear_x - x) - reach_x
            dy = abs(clear_y - y) - reach_y
            if _outside(dx, dy) < radius:
                return False

        # The other things.
        for other in self.things:
            other_x, other_y = _reach(other.hx, other.hy, other.yaw)
            dx = abs(other.x - x) - reach_x - other_x
            dy = abs(other.y - y) - reach_y - other_y
            overlaps = max(dx, dy) < -TOUCH
            if overlaps or TOUCH < _outside(dx, dy) < gap:
                return False
        return True

    def put(self, low: tuple, high: tuple, size: Callable, height: float, color: tuple, gap: float = GAP) -> bool:
        """Put a box of ``size()``, half extents and yaw, where it fits between two corners; False without a place."""
        for _ in range(TRIES):
            hx, hy, yaw = size()
            x, y = self.generator.uniform(low, high).tolist()
            if self.fits(x, y, hx, hy, yaw, gap):
                self.add(x, y, hx, hy, height, color, yaw)
                return True
        return False

    def furnish(self, low: tuple, high: tuple, density: float) -> None:
        """Tables and cabinets, against walls or free, until they cover that share of a room between two corners."""
        draw = self.generator
        x0, y0 = low
        x1, y1 = high
        max_covered = density * ((x1 - x0) * (y1 - y0))
        covered = 0.0
        while covered < max_covered:
            height, color = (SHELF, METAL) if draw.random() < 0.4 else (DESK, WOOD)
            hx = draw.uniform(0.4, 0.8)
            hy = draw.uniform(0.2, 0.4)
            if draw.random() >= 0.5:
                hx, hy = hy, hx
            place = self._furniture_place((x0 + hx, y0 + hy), (x1 - hx, y1 - hy), hx, hy)
            if place is None:
                return
            self.add(*place, hx, hy, height, color)
            covered += 4 * hx * hy

    def _furniture_place(self, low: tuple, high: tuple, hx: float, hy: float) -> tuple[float, float] | None:
        """A place between two corners where a box fits, against one of four walls or free."""
        if low[0] >= high[0] or low[1] >= high[1]:
            return None
        for _ in range(TRIES):
            place = self.generator.uniform(low, high)  # (2,) m
            side = self.generator.integers(5)
            if side < 4:
                axis = side % 2
                wall = (low, high)[side // 2]
                place[axis] = wall[axis]
            x, y = place.tolist()
            if self.fits(x, y, hx, hy):
                return x, y
        return None


def _reach(hx: float, hy: float, yaw: float) -> tuple[float, float]:
    """Half extents [m] along x and y of a turned box."""
    cosine = abs(math.cos(yaw))
    sine = abs(math.sin(yaw))
    reach_x = cosine * hx + sine * hy
    reach_y = sine * hx + cosine * hy
    return reach_x, reach_y


def _outside(dx: float, dy: float) -> float:
    """Distance [m] from a box that a place is beyond by dx and dy [m], which are negative inside."""
    return math.hypot(max(dx, 0.0), max(dy, 0.0))


def rooms(floor: Floor, corridor: float, door: float, room: float, furniture: float) -> None:
    """Rooms of about ``room`` [m] on both sides of a corridor, each with a door."""
    if corridor >= floor.depth:
        raise ValueError("there is no place for rooms")
    draw = floor.generator
    lower = (floor.depth - corridor) / 2
    upper = (floor.depth + corridor) / 2
    for low, high, wall in ((0.0, lower, lower), (upper, floor.depth, upper)):
        # The walls between rooms, up to the corridor's.
        count = max(2, round(floor.width / room))
        cuts = np.linspace(0.0, floor.width, count + 1)
        cuts[1:-1] += draw.uniform(-0.15, 0.15, count - 1) * room
        inner_low = low
        inner_high = high
        if wall == high:
            inner_high = high - WALL / 2
        else:
            inner_low = low + WALL / 2
        for x in cuts[1:-1].tolist():
            floor.wall(x, inner_low, x, inner_high)

        # A door of each room to the corridor.
        ends = list(itertools.pairwise(cuts))
        doors = [draw.uniform(left + 0.4 + door / 2, right - 0.4 - door / 2) for left, right in ends]
        floor.wall_with_doors(True, wall, 0.0, floor.width, doors, door)
        for left, right in ends:
            inner_left, inner_right = _between_walls(floor, left, right)
            floor.furnish((inner_left, inner_low), (inner_right, inner_high), furniture)


def _between_walls(floor: Floor, left: float, right: float) -> tuple[float, float]:
    """From wall to wall, where walls stand at both x but at the edges of the floor."""
    if left > 0:
        left = left + WALL / 2
    if right < floor.width:
        right = right - WALL / 2
    return left, right


def office(floor: Floor, aisle: float, desks: float, furniture: float) -> None:
    """An open-plan office: double desks with a screen between them in rows, ``desks`` of the places taken."""
    half = 0.8  # m, of a double desk
    step = 2 * half + aisle
    columns = int((floor.width - aisle) / step)
    rows = int((floor.depth - aisle) / step)
    left = (floor.width - columns * step + aisle) / 2 + half
    low = (floor.depth - rows * step + aisle) / 2 + half
    half_screen = WALL / 2
    for i in range(columns):
        for j in range(rows):
            if floor.generator.random() >= desks:
                continue
            x = left + i * step
            y = low + j * step
            for side in (-1, 1):
                desk_y = y + side * (half + half_screen) / 2
                floor.add(x, desk_y, half, (half - half_screen) / 2, DESK, WOOD)
            floor.add(x, y, half, half_screen, SCREEN, CLOTH)
    floor.furnish((0.0, 0.0), (floor.width, floor.depth), furniture)


def aisles(floor: Floor, aisle: float, cross: float, shelf: float) -> None:
    """Shelves in rows, of ``shelf`` [m] each, with aisles between the rows and cross aisles between the shelves."""
    half = 0.45
    width = floor.width - cross
    columns = max(1, int(width / (shelf + cross)))
    length = width / columns - cross
    rows = max(1, int((floor.depth - aisle) / (2 * half + aisle)))
    apart = (floor.depth - rows * 2 * half) / (rows + 1)
    draw = floor.generator
    for i in range(columns):
        for j in range(rows):
            # Some shelves are shorter, on the left or on the right.
            missing = 0.0
            if draw.random() < 0.3:
                missing = length * draw.uniform(0.0, 0.5)
            left = cross + i * (length + cross) + missing * draw.integers(2)
            half_length = (length - missing) / 2
            y = apart + half + j * (2 * half + apart)
            floor.add(left + half_length, y, half_length, half, SHELF, METAL)


def lobby(floor: Floor, lane: float, columns: float, furniture: float) -> None:
    """A hall with a counter, lanes of posts before it where people queue, columns and benches."""
    draw = floor.generator
    width = floor.width
    depth = floor.depth
    half = draw.uniform(1.5, 0.2 * width)
    middle = draw.uniform(half + 2.0, width - half - 2.0)
    top = depth - draw.uniform(1.5, 2.2)
    floor.add(middle, top, half, 0.35, COUNTER, WOOD)

    # Posts from the counter, and columns.
    length = draw.uniform(1.5, 0.3 * depth)
    posts_y = top - 0.35 - lane - length / 2
    for x in np.arange(middle - half, middle + half + 1e-6, lane).tolist():
        floor.add(x, posts_y, 0.04, length / 2, POST, METAL)
    if columns >= 1.0:  # none are nearer
        for x in np.arange(columns, width - 2.0, columns).tolist():
            for y in np.arange(columns, depth - 2.0, columns).tolist():
                if floor.fits(x, y, 0.25, 0.25):
                    floor.add(x, y, 0.25, 0.25, WALL_HEIGHT, STONE)
    floor.furnish((0.0, 0.0), (width, depth), furniture)


def square(floor: Floor, stalls: float, passage: float) -> None:
    """An open square with market stalls, ``stalls`` for each 100 m2, at least ``passage`` [m] apart."""
    draw = floor.generator

    def size() -> tuple[float, float, float]:
        hx = draw.uniform(0.8, 1.5)
        hy = draw.uniform(0.5, 1.0)
        return hx, hy, float(draw.choice([0.0, np.pi / 2]))

    count = round(stalls * floor.width * floor.depth / 100)
    for _ in range(count):
        height = draw.uniform(0.9, 2.2)
        floor.put((0.0, 0.0), (floor.width, floor.depth), size, height, CLOTH, passage)


def passages(floor: Floor, door: float, walls: float, furniture: float) -> None:
    """A hall that ``walls`` divide, each with one or two doors: bottlenecks."""
    draw = floor.generator
    count = max(1, round(walls))
    steps = np.arange(1, count + 1) + draw.uniform(-0.15, 0.15, count)
    cuts = (steps * floor.width / (count + 1)).tolist()
    middle = floor.depth / 2
    for x in cuts:
        pieces = [(0.0, floor.depth)]
        if draw.random() < 0.5:
            pieces = [(0.0, middle), (middle, floor.depth)]
        doors = [draw.uniform(low + 0.6 + door, high - 0.6 - door) for low, high in pieces]
        floor.wall_with_doors(False, x, 0.0, floor.depth, doors, door)
    for left, right in itertools.pairwise([0.0, *cuts, floor.width]):
        inner_left, inner_right = _between_walls(floor, left, right)
        floor.furnish((inner_left, 0.0), (inner_right, floor.depth), furniture)


def clutter(floor: Floor, density: float) -> None:
    """Boxes of all sizes and directions, until they cover that share of the floor."""
    draw = floor.generator

    def size() -> tuple[float, float, float]:
        hx = draw.uniform(0.15, 0.9)
        hy = draw.uniform(0.15, 0.9)
        return hx, hy, draw.uniform(0.0, np.pi)

    covered = 0.0
    while covered < density * floor.width * floor.depth:
        color = (WOOD, METAL, STONE, CLOTH)[draw.integers(4)]
        height = draw.uniform(0.4, 1.9)
        if not floor.put((0.0, 0.0), (floor.width, floor.depth), size, height, color):
            return
        thing = floor.things[-1]
        covered += 4 * thing.hx * thing.hy


SIZE = {"width": (14.0, 24.0), "depth": (10.0, 18.0)}  # m
FAMILIES: dict[str, tuple[Callable[..., None], dict[str, tuple[float, float]]]] = {
    "rooms": (rooms, {"corridor": (1.8, 3.0), "door": (1.0, 1.4), "room": (4.0, 6.5), "furniture": (0.0, 0.1)}),
    "office": (office, {"aisle": (1.3, 2.2), "desks": (0.5, 0.9), "furniture": (0.0, 0.04)}),
    "aisles": (aisles, {"aisle": (1.6, 3.0), "cross": (1.8, 3.0), "shelf": (4.0, 9.0)}),
    "lobby": (lobby, {"lane": (1.1, 1.5), "columns": (4.0, 7.0), "furniture": (0.0, 0.06)}),
    "square": (square, {"stalls": (3.0, 8.0), "passage": (1.4, 2.4)}),
    "passages": (passages, {"door": (1.0, 1.8), "walls": (1.0, 3.0), "furniture": (0.0, 0.08)}),
    "clutter": (clutter, {"density": (0.03, 0.12)}),
}
"""Name -> the family, and the range of each of its words."""
SIDES = (0.0, 0.5), (1.0, 0.5)
ALL_SIDES = *SIDES, (0.5, 0.0), (0.5, 1.0)
ENTRANCES: dict[str, tuple[tuple[float, float], ...]] = {
    "rooms": SIDES,  # the ends of the corridor
    "office": SIDES,
    "aisles": ((0.0, 0.0), (1.0, 1.0)),  # the ends of two cross aisles
    "lobby": ((0.5, 0.0), (0.0, 1.0), (1.0, 1.0)),  # the street, and the ways on behind the counter
    "square": ALL_SIDES,
    "passages": SIDES,
    "clutter": ALL_SIDES,
}
"""Name of a family -> where people come in and leave, as shares of its floor's width and depth."""
LIMITS = {
    "width": (4.0, 100.0), "depth": (4.0, 100.0), "corridor": (0.5, 20.0), "door": (0.5, 10.0), "room": (2.0, 50.0),
    "furniture": (0.0, 0.5), "aisle": (0.5, 20.0), "desks": (0.0, 1.0), "cross": (0.5, 20.0), "shelf": (0.5, 50.0),
    "lane": (0.5, 10.0), "columns": (0.0, 50.0), "stalls": (0.0, 50.0), "passage": (0.0, 20.0), "walls": (1.0, 20.0),
    "density": (0.0, 0.5),
}  # fmt: skip
"""Word -> its least and greatest value, m, or a number or share as in ``FAMILIES``."""
MAX_AREA = 1_000.0  # m2 of a floor
OPEN_AIR = "square", "clutter"  # families without a ceiling
