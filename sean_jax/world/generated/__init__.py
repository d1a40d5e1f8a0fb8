"""Worlds without end: floors of families such as rooms or aisles, as functions of a seed and a few words.

Each world is an ordinary environment with a Behavior Graph: nodes that people and robots reach, groups with room for
their members, people that fit.
"""

import contextlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from scipy import ndimage

from sean_jax.core import bounds
from sean_jax.core.data_types import Environment
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import signed_distances_on_host
from sean_jax.core.messages import shorten
from sean_jax.graph import annotation
from sean_jax.graph.annotation import Annotation, Edge, Node
from sean_jax.graph.formation import reach
from sean_jax.io import cache, files, writing
from sean_jax.world import environment as environments
from sean_jax.world.generated.floor_families import (
    ENTRANCES,
    FAMILIES,
    LIMITS,
    MAX_AREA,
    MAX_THINGS,
    OPEN_AIR,
    SIZE,
    WALL_HEIGHT,
    Floor,
    TooManyThings,
    kind_of,
)
from sean_jax.world.generated.graph_proposal import propose
from sean_jax.world.navigation.arcs import pairs_are_free

__all__ = [
    "FAMILIES",
    "SIZE",
    "World",
    "WorldSet",
    "count",
    "find",
    "generate",
    "in_processes",
    "parse",
    "parse_set",
    "save",
]

PACKAGE = Path(__file__).parents[2] / "__init__.py"
ROBOT = 0.4  # m, radius of the widest robot that passes everything
CELL = 0.1  # m, in which the floor is looked at
POCKETS = 0.02  # share of the free floor that may be out of reach
MAX_DRAWS = 50  # of a floor, until one is valid
MAX_WORK = 500_000  # things times m2, over all draws; what follows takes about 10 us for each
COMPARISONS = 10  # of things, that take as long as one of these
AREA_PER_PERSON = (8.0, 25.0)  # m2 of free floor
MAX_PEOPLE = 40
MAX_WORLDS = 100_000
SHARE = 16  # floors, at least, for a process of its own
CANDIDATES = 256  # places that are tried for groups
GROUP_AREA = 60.0  # m2 of free floor for each group, at least
ENTRANCE_MARGIN = 0.8  # m, from an entrance to the edge of the floor
GROUP_GAP = 3.5  # m, between two groups
GROUP_SIGHT = 6.0  # m, to the waypoint from which a group is reached
FLOWS = ("medium", "high", "low"), (0.7, 0.15, 0.15)  # of edges, and their chances


class World(NamedTuple):
    """A floor with its graph and people."""

    family: str
    seed: int
    words: dict[str, float]
    settings: environments.Settings
    boxes: np.ndarray  # (W, 6) as of ``environment.write``
    colors: np.ndarray  # (W, 3)
    graph: Annotation

    @property
    def environment(self) -> Environment:
        """The floor with its obstacles."""
        return environments.of_boxes(self.settings, self.boxes)


def generate(family: str, seed: int, words: Mapping[str, float | tuple[float, float]] | None = None) -> World:
    """The world of a family and a seed. The same arguments give the same world.

    Args:
        family: a key of ``FAMILIES``.
        words: values, or ranges to draw from, of ``width`` and ``depth`` [m] of the floor and of the family's words;
            the others are drawn from the ranges of ``SIZE`` and ``FAMILIES``.

    Raises:
        InputError: there is no such family or word, or no floor of these words lets everybody pass.
    """
    if family not in FAMILIES:
        raise InputError(
            f"worlds: '{shorten(family)}' is not one of {', '.join(FAMILIES)}{files.suggest(family, FAMILIES)}"
        )
    ranges = _ranges(family, words or {})
    generator = np.random.default_rng([list(FAMILIES).index(family), seed])
    work = 0.0
    draws = 0
    has_many_things = False
    while draws < MAX_DRAWS and work < MAX_WORK:
        draws += 1
        parameters = {word: float(generator.uniform(*limits)) for word, limits in ranges.items()}
        floor = Floor(generator, parameters["width"], parameters["depth"])
        try:
            _furnish(family, floor, parameters)
        except TooManyThings:
            has_many_things = True
            continue
        except ValueError:  # words do not go together, such as a door that is wider than its room
            continue
        finally:
            work += floor.compared / COMPARISONS
        work += len(floor.things) * floor.width * floor.depth
        world = _world(family, seed, parameters, floor, generator)
        if world is not None:
            return world

    text = ", ".join(f"{word} {low:g} to {high:g}" for word, (low, high) in ranges.items())
    if has_many_things:
        raise InputError(
            f"worlds: none of {draws} floors of {family} with {text} has at most {MAX_THINGS} things; widen the ranges."
        )
    raise InputError(f"worlds: none of {draws} floors of {family} with {text} lets everybody pass; widen the ranges.")


def _ranges(family: str, words: Mapping[str, float | tuple[float, float]]) -> dict[str, tuple[float, float]]:
    """The range of each word of a family, with the checked values of ``generate``."""
    _, ranges = FAMILIES[family]
    ranges = {**SIZE, **ranges}
    for word, value in words.items():
        if word not in ranges:
            raise InputError(f"worlds: {family} has no word '{shorten(word)}'; its words are {', '.join(ranges)}.")
        low, high = (value, value) if isinstance(value, int | float) else value
        least, most = LIMITS[word]
        bounds.check_number(f"worlds: {word}", high, least, most)
        bounds.check_number(f"worlds: {word}", low, least, high)
        ranges[word] = (float(low), float(high))

    _, width = ranges["width"]
    _, depth = ranges["depth"]
    if width * depth > MAX_AREA:
        raise InputError(
            f"worlds: width {width:g} by depth {depth:g} m are {width * depth:,.0f} m2, and at most {MAX_AREA:,.0f} "
            "are made; give less."
        )
    return ranges


def _furnish(family: str, floor: Floor, parameters: dict[str, float]) -> None:
    """Put the things of a family on a floor."""
    build, _ = FAMILIES[family]
    build(floor, **{word: value for word, value in parameters.items() if word not in SIZE})


def parse(text: str) -> dict[str, tuple[float, float]]:
    """Words from a text such as ``width=16,door=1.0:1.2``.

    Raises:
        InputError: a part of the text is no word with a number or a range.
    """
    words = {}
    for part in text.split(","):
        word, _, value = part.partition("=")
        low, _, high = value.partition(":")
        if word.strip() in words:
            raise InputError(
                f"words: '{shorten(word.strip())}' is there twice; give it once, or a range such as door=1.0:1.2."
            )
        try:
            words[word.strip()] = float(low), float(high or low)
        except ValueError:
            raise InputError(
                f"words: '{shorten(part)}' is no word with a number or a range; give door=1.2 or door=1.0:1.2."
            ) from None
    return words


def save(world: World, folder: Path | str) -> None:
    """Write the world as a new environment folder: environment.yaml, scene.xml and graph.yaml.

    Raises:
        WriteError: the folder is not empty or cannot be written.
    """
    with writing.atomic_folder(Path(folder)) as new_folder:
        kinds = [kind_of(box[5], color) for box, color in zip(world.boxes, world.colors, strict=True)]
        environments.write(new_folder, world.settings, world.boxes, world.colors, kinds)
        writing.write(new_folder / "graph.yaml", annotation.to_yaml(world.graph))


# ------------------------------------------------------------------ sets of worlds


class WorldSet(NamedTuple):
    """Worlds of families in turn, with consecutive seeds."""

    families: tuple[str, ...]
    number: int
    seed: int


def parse_set(name: str) -> WorldSet | None:
    """The set of a name such as ``worlds:rooms,aisles:512`` or, with the first seed, ``worlds:all:512:1000``; None for
    another environment.

    Raises:
        InputError: there is no such family, or no number.
    """
    word, *parts = name.split(":")
    if word != "worlds":
        return None
    number, seed = (bounds.parse_digits(part) for part in (*parts[1:], "0", "0")[:2])
    if len(parts) not in (2, 3) or number is None or seed is None:
        raise InputError(
            f"environment: '{shorten(name)}' is no set of worlds; give worlds:FAMILIES:NUMBER or "
            "worlds:FAMILIES:NUMBER:SEED, such as worlds:rooms,aisles:512."
        )
    families = tuple(FAMILIES) if parts[0] == "all" else tuple(parts[0].split(","))
    for family in families:
        if family not in FAMILIES:
            hint = files.suggest(family, FAMILIES)
            raise InputError(
                f"environment: '{shorten(family)}' in {shorten(name)} is not one of all, {', '.join(FAMILIES)}{hint}"
            )
    bounds.check_number(f"environment: number in {shorten(name)}", number, 1, MAX_WORLDS)
    bounds.check_number(f"environment: seed in {name}", seed, 0, 2**31)
    return WorldSet(families, number, seed)


def count(name: str) -> int:
    """The number of floors of a name, as of ``find``.

    Raises:
        InputError: there is no such environment.
    """
    worlds = parse_set(name)
    return len(find(name)) if worlds is None else worlds.number


def find(name: str | Path, limit: int | None = None) -> list[Path]:
    """The environment folders of a name: a set of worlds, a folder of environments, or one environment.

    Worlds are generated into the user's cache.

    Args:
        limit: maximum number of folders; the first ones.

    Raises:
        InputError: there is no such environment.
    """
    worlds = parse_set(str(name))
    if worlds is None:
        folder = Path(name).expanduser()
        parts = sorted(path.parent for path in folder.glob(f"*/{environments.SETTINGS}"))
        is_set = parts and not (folder / environments.SETTINGS).is_file()
        return parts[:limit] if is_set and str(name) not in environments.available() else [environments.find(name)]
    source = cache.source(
        "world/generated", "world/environment", "core/geometry", "graph/annotation", "graph/formation"
    )
    place = cache.folder() / "worlds" / source[:16]
    families = len(worlds.families)
    folders = [
        place / f"{worlds.families[turn % families]}_{worlds.seed + turn // families}"
        for turn in range(worlds.number)[:limit]
    ]
    missing = [folder for folder in folders if not folder.is_dir()]
    in_processes("sean_jax.world.generated", "save_all", [], missing)
    save_all(*(str(folder) for folder in missing if not folder.is_dir()))
    return folders


def save_all(*folders: str) -> None:
    """Write worlds whose folders are named FAMILY_SEED, as ``save``; an existing folder stays as it is."""
    for folder in map(Path, folders):
        family, _, seed = folder.name.rpartition("_")
        world = generate(family, int(seed))
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".", dir=folder.parent) as own:
            save(world, Path(own) / folder.name)
            try:
                (Path(own) / folder.name).rename(folder)
            except OSError:
                if not folder.is_dir():
                    raise


CHILD = """
import importlib.util, os, sys
os.environ["JAX_PLATFORMS"] = "cpu"
place, module, function, *arguments = sys.argv[1:]
spec = importlib.util.spec_from_file_location("sean_jax", place)
sys.modules["sean_jax"] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(sys.modules["sean_jax"])
getattr(importlib.import_module(module), function)(*arguments)
"""
"""The program of a process: this very package by its place, so that no folder has to be on the path."""


def in_processes(module: str, function: str, arguments: Sequence[str], folders: Sequence[Path]) -> None:
    """Call a function with many folders in several processes without a GPU, if that is faster.

    A process that fails leaves its folders to the caller, and the terminal shows why.
    """
    number = min(os.cpu_count() or 1, len(folders) // SHARE)
    if number < 2:
        return
    # -P: otherwise modules of the current folder, such as a tempfile.py, would be imported in place of Python's own.
    command = [sys.executable, "-P", "-c", CHILD, str(PACKAGE), module, function, *arguments]
    with contextlib.ExitStack() as stack:
        logs = [stack.enter_context(tempfile.TemporaryFile()) for _ in range(number)]
        processes = [
            subprocess.Popen([*command, *map(str, folders[turn::number])], stderr=log) for turn, log in enumerate(logs)
        ]
        for process in processes:
            stack.callback(process.kill)
        for process in processes:
            process.wait()
        failed = [log for process, log in zip(processes, logs, strict=True) if process.returncode != 0]
        if failed:
            print(
                f"{len(failed)} of {number} processes failed ({_last_line(failed[0])}); one goes on.", file=sys.stderr
            )


def _last_line(log: BinaryIO) -> str:
    """What a process said last, which is its error."""
    log.seek(0)
    lines = log.read().decode(errors="replace").split("\n")
    return next((line.strip()[:200] for line in reversed(lines) if line.strip()), "without a word")


def _world(
    family: str, seed: int, words: dict[str, float], floor: Floor, generator: np.random.Generator
) -> World | None:
    """The world of a floor; None if somebody cannot pass everywhere or has no room."""
    things = floor.things
    boxes = np.array([thing[:6] for thing in things], float).reshape(-1, 6)
    colors = np.array([thing.color for thing in things], float).reshape(-1, 3)
    size = 0.0, 0.0, round(floor.width, 3), round(floor.depth, 3)
    ceiling = None if family in OPEN_AIR else WALL_HEIGHT
    settings = environments.Settings(name=f"{family}_{seed}", floor=size, people=0, ceiling=ceiling)
    environment = environments.of_boxes(settings, boxes)
    free = _free_area(environment)
    if free is None:
        return None
    try:
        graph = _with_groups(environment, propose(environment, _entrances(family, floor)), free, generator)
    except InputError:
        return None
    people = min(MAX_PEOPLE, max(3, round(free / generator.uniform(*AREA_PER_PERSON))))
    text = ", ".join(f"{word} {value:.3g}" for word, value in words.items())
    source = f"sean_jax worlds: {family}, seed {seed}, {text}"
    settings = settings.model_copy(update={"people": people, "source": source})
    return World(family, seed, words, settings, boxes, colors, graph.model_copy(update={"source": source}))


def _entrances(family: str, floor: Floor) -> np.ndarray:
    """Places (K, 2) [m] a step inside the floor where people come in and leave, each twice: two make a node."""
    corner = np.array([floor.width, floor.depth])
    places = np.clip(np.array(ENTRANCES[family]) * corner, ENTRANCE_MARGIN, corner - ENTRANCE_MARGIN)
    return np.repeat(places, 2, axis=0)


def _free_area(environment: Environment) -> float | None:
    """The floor [m2] where a person has room; None if the widest robot cannot go from everywhere to everywhere."""
    x0, y0, x1, y1 = np.asarray(environment.floor, float)
    x = np.arange(x0 + CELL / 2, x1, CELL)
    y = np.arange(y0 + CELL / 2, y1, CELL)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    clearance = np.minimum(*signed_distances_on_host(environment, points)).reshape(len(x), len(y))
    passable = clearance >= ROBOT + CELL / 2
    label = np.asarray(ndimage.label(passable)[0])  # pyright: ignore[reportIndexIssue]
    sizes = np.bincount(label[passable], minlength=2)[1:]
    if not passable.any() or sizes.max() < (1.0 - POCKETS) * passable.sum():
        return None
    return float((clearance >= annotation.PERSON).sum()) * CELL**2


def _with_groups(
    environment: Environment, graph: Annotation, free: float, generator: np.random.Generator
) -> Annotation:
    """The graph with flows drawn for its edges, and groups where there is room."""
    nodes = dict(graph.nodes)
    names = list(nodes)

    # Flows are drawn per edge, so people prefer some ways over others of the same length.
    categories, chances = FLOWS
    edges = []
    for edge in graph.edges:
        flow: Any = categories[generator.choice(len(categories), p=chances)]
        edges.append(Edge(between=edge.between, flow=flow))

    # A group must leave its waypoints and other groups alone: the ring, bodies and a margin have to fit in.
    waypoints = np.array([node.position for node in nodes.values()])  # (W, 2) m
    centers: list[np.ndarray] = []
    seed = int(generator.integers(2**31))
    candidates = environments.free_points(environment, annotation.NODE_CLEARANCE, CANDIDATES, seed).astype(float)
    clearance = np.minimum(*signed_distances_on_host(environment, candidates))
    for center, room in zip(candidates, clearance.tolist(), strict=True):
        if len(centers) >= max(1, free / GROUP_AREA):
            break

        # Two to five seats, sizes for which formations were measured (``graph.formation``).
        capacity = int(generator.integers(2, 6))
        gap = np.linalg.norm(waypoints - center, axis=1)  # (W,) m
        if room < reach(capacity) + annotation.PERSON + 0.3 or gap.min() < reach(capacity) + 0.8:
            continue
        if centers and np.linalg.norm(np.array(centers) - center, axis=1).min() < GROUP_GAP:
            continue

        # People walk straight to a group, so its edge has to be free for a body.
        starts = np.broadcast_to(center, waypoints.shape)
        in_sight = np.asarray(pairs_are_free(environment.obstacles, annotation.PERSON, starts, waypoints))
        if not (in_sight & (gap < GROUP_SIGHT)).any():
            continue

        # A group has one edge, to the nearest waypoint in sight, so no route of others leads through it.
        name = f"group_{len(centers) + 1}"
        nearest = int(np.argmin(np.where(in_sight, gap, np.inf)))
        nodes[name] = _group_node(center, room, capacity, generator)
        edges.append(Edge(between=(names[nearest], name)))
        centers.append(center)

    # Join and Leave Group need a group in every world.
    if not centers:
        raise InputError("worlds: there is no room for a group.")
    return graph.model_copy(update={"nodes": nodes, "edges": edges})


def _group_node(center: np.ndarray, room: float, capacity: int, generator: np.random.Generator) -> Node:
    x, y = center.tolist()
    shorter, longer = sorted(float(generator.integers(60, 240)) for _ in range(2))
    return Node(
        kind="group",
        position=(round(x, 3), round(y, 3)),
        radius=round(min(1.0, room - annotation.PERSON), 2),
        spawn=1,
        capacity=capacity,
        stay=(shorter, longer),
    )
