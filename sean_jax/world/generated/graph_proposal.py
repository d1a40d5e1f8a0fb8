"""A graph for an environment that has none: nodes where there is room and sight, edges that people can walk straight.

Nodes are places of greatest clearance, one after the other: the points of the medial axis from which most of the floor
that no node sees yet is near and in sight. Then places are added until the floor that a person can reach is one
piece of the graph. An edge joins two nodes if a person can walk straight from one to the other and no third node lies
between (both of its edges would be shorter): the relative neighborhood graph.

Source: H. Blum, A transformation for extracting new descriptors of shape, 1967 (medial axis); G. T. Toussaint, The
relative neighbourhood graph of a finite planar set, Pattern Recognition 12(4), 1980.
"""

import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.sparse.csgraph import connected_components

from sean_jax.core.data_types import Environment
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import signed_distances_on_host
from sean_jax.graph.annotation import NODE_CLEARANCE, PERSON, Annotation, Edge, Node
from sean_jax.world.navigation.arcs import pairs_are_free

CELL = 0.25  # m, side of the cells in which the floor is looked at
MAX_CELLS = 40_000  # on larger floors cells are wider
MAX_RADIUS = 2.5  # m, of a node's disc; in SEAN's warehouse they are 1.6 to 3.2 m
SIGHT = 8.0  # m, range of sight from a node; larger on larger floors ...
SIGHT_SHARE = 0.12  # ... than this share of the root of their area
UNSEEN = 0.02  # share of the floor that no node has to see: corners
MAX_NODES = 120
ROOM = 0.05  # m, by which nodes are farther from obstacles than they have to be
MERGE = 2.5  # m, within which ends of people's ways are one
MIN_SHARE = 0.04  # of all ends, from which they are a node
C_MIN, C_MAX = 0.2, 100.0  # as in the shipped graphs


def propose(environment: Environment, ends: Float[np.ndarray, "K 2"] | None = None) -> Annotation:
    """A graph of waypoints for an environment.

    Args:
        ends: (K, 2) m, where people come from and go to, if known: where many are, there is a node.

    Raises:
        InputError: there is no room for a person, or the floor is too winding.
    """
    cells, clearance, beside = _cells(environment)
    x0, y0, x1, y1 = np.asarray(environment.floor, float)
    sight = max(SIGHT, SIGHT_SHARE * math.sqrt((x1 - x0) * (y1 - y0)))
    nodes: list[int] = []  # cells
    sights: list[np.ndarray] = []  # of each node, (cells,) whether it sees them
    near: list[np.ndarray] = []  # of each node, cells that it sees and is near to

    def add(cell: int) -> None:
        if len(nodes) == MAX_NODES:
            what = f"is so winding that {MAX_NODES} nodes do not see all of it"
            raise InputError(f"environment '{environment.name}' {what}; write a graph.yaml for it by hand.")
        start = np.broadcast_to(cells[cell], cells.shape)
        sights.append(np.asarray(pairs_are_free(environment.obstacles, PERSON, start, cells)))
        sights[-1][cell] = True
        near.append(sights[-1] & (np.linalg.norm(cells - cells[cell], axis=-1) < sight))
        nodes.append(cell)

    named = _clusters(np.zeros((0, 2)) if ends is None else np.asarray(ends, float))
    for end in named:
        add(int(np.argmin(np.linalg.norm(cells - end, axis=-1))))
    while len(rest := np.flatnonzero(~np.any(near, axis=0) if near else np.ones(len(cells), bool))) > (
        UNSEEN * len(cells)
    ):
        add(int(rest[np.argmax(np.minimum(clearance[rest], MAX_RADIUS) + 1e-2 * clearance[rest])]))
    chosen = _connect(clearance, beside, nodes, sights, add)
    chosen = _needed(chosen, len(named), clearance, nodes, sights, near)
    position = cells[[nodes[k] for k in chosen]]
    ends_first = sum(k < len(named) for k in chosen)
    names = [f"end_{k + 1}" if k < ends_first else f"place_{k + 1 - ends_first}" for k in range(len(chosen))]
    visible = np.array([[sights[a][nodes[b]] or sights[b][nodes[a]] for b in chosen] for a in chosen])
    return _annotation(environment, names, position, clearance[[nodes[k] for k in chosen]], visible)


def _cells(environment: Environment) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centers (K, 2) m of possible cells of nodes, their clearance (K,) m, and pairs (L, 2) of neighboring cells."""
    x0, y0, x1, y1 = np.asarray(environment.floor, float)
    size = CELL * max(1.0, math.sqrt((x1 - x0) * (y1 - y0) / CELL**2 / MAX_CELLS))
    shape = max(1, round((x1 - x0) / size)), max(1, round((y1 - y0) / size))
    x = x0 + (np.arange(shape[0]) + 0.5) * (x1 - x0) / shape[0]
    y = y0 + (np.arange(shape[1]) + 0.5) * (y1 - y0) / shape[1]
    middle = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    clearance = np.minimum(*signed_distances_on_host(environment, middle))
    free = clearance >= NODE_CLEARANCE + ROOM
    if not free.any():
        raise InputError(f"environment '{environment.name}' has no room for a node; look at its floor and scene.xml.")
    number = np.where(free, np.cumsum(free) - 1, -1).reshape(shape)
    pairs = [np.stack([number[1:].ravel(), number[:-1].ravel()], -1)]
    pairs.append(np.stack([number[:, 1:].ravel(), number[:, :-1].ravel()], -1))
    beside = np.concatenate(pairs)
    return middle[free], clearance[free], beside[(beside >= 0).all(1)]


def _clusters(ends: np.ndarray) -> list[np.ndarray]:
    """(2,) m the middle of each place where many of the ends (K, 2) [m] are, the fullest first."""
    middles, rest = [], ends
    while len(rest) and len(middles) < MAX_NODES // 2:
        near = np.linalg.norm(rest[:, None] - rest[None, :], axis=-1) < MERGE
        fullest = near[np.argmax(near.sum(1))]
        if fullest.sum() < max(2, MIN_SHARE * len(ends)):
            break
        middles.append(rest[fullest].mean(0))
        rest = rest[np.linalg.norm(rest - middles[-1], axis=-1) >= MERGE]
    return middles


def _connect(
    clearance: np.ndarray, beside: np.ndarray, nodes: list[int], sights: list[np.ndarray], add: Callable[[int], None]
) -> list[int]:
    """The nodes of the largest piece of the graph, after nodes were added that join all pieces that can be joined.

    Where two pieces see the same cells, the node is the roomiest of them. Else one piece is led on around the corner:
    to the roomiest cell that it sees beside one that it does not.
    """
    closed: set[int] = set()  # pieces, by their first node, that see all that can be reached from them
    while True:
        pieces = _pieces(nodes, sights)
        views = [np.any([sights[k] for k in piece], axis=0) for piece in pieces]
        largest = int(np.argmax([view.sum() for view in views]))
        growing = [k for k in range(len(pieces)) if pieces[k][0] not in closed]
        if len(pieces) == 1 or not growing:
            return pieces[largest]
        one = growing[0]
        others = np.any([view for k, view in enumerate(views) if k != one], axis=0)
        candidates = np.flatnonzero(views[one] & others)
        if len(candidates) == 0:
            a, b = views[one][beside].T
            candidates = np.unique(np.concatenate([beside[a & ~b, 0], beside[~a & b, 1]]))
        candidates = candidates[~np.isin(candidates, nodes)]
        if len(candidates) == 0:
            closed.add(pieces[one][0])
        else:
            add(int(candidates[np.argmax(clearance[candidates])]))


def _needed(
    chosen: list[int],
    named: int,
    clearance: np.ndarray,
    nodes: list[int],
    sights: list[np.ndarray],
    near: list[np.ndarray],
) -> list[int]:
    """The nodes without redundant ones, the narrowest first: others see the same cells and join the same nodes."""
    views = np.sum([near[k] for k in chosen], axis=0)
    spare = UNSEEN * len(clearance) - np.sum(views == 0)
    for k in sorted(chosen, key=lambda k: clearance[nodes[k]]):
        rest = [other for other in chosen if other != k]
        unseen = int(np.sum(near[k] & (views == 1)))
        if k >= named and rest and unseen <= spare and len(_pieces(nodes, sights, rest)) == 1:
            chosen, views, spare = rest, views - near[k], spare - unseen
    return chosen


def _pieces(nodes: list[int], sights: list[np.ndarray], among: list[int] | None = None) -> list[list[int]]:
    """The nodes, or some among them, that are joined by sight, piece by piece."""
    own = np.arange(len(nodes)) if among is None else np.sort(among)
    visible = np.array([sights[k][np.asarray(nodes)[own]] for k in own]).reshape(len(own), len(own))
    number, label = connected_components(visible, directed=False)
    return [own[label == piece].tolist() for piece in range(number)]


def _annotation(
    environment: Environment, names: list[str], position: np.ndarray, clearance: np.ndarray, visible: np.ndarray
) -> Annotation:
    """The annotation of nodes at (M, 2) m with a clearance (M,) m, of which pairs (M, M) see each other."""
    gap = np.linalg.norm(position[:, None] - position[None, :], axis=-1)
    apart = np.min(gap + np.where(np.eye(len(gap), dtype=bool), np.inf, 0.0), axis=1, initial=np.inf)
    radius = np.clip(np.minimum(clearance - PERSON, 0.45 * apart), PERSON, MAX_RADIUS)
    nodes = {
        name: Node(
            kind="waypoint", position=(round(float(x), 3), round(float(y), 3)), radius=round(float(r), 2), spawn=1
        )
        for name, (x, y), r in zip(names, position, radius, strict=True)
    }
    reach = np.where(visible, gap, np.inf)
    edges = []
    for a, b in np.argwhere(np.triu(visible, 1)):
        if not (np.maximum(reach[a], reach[b]) < gap[a, b] - 1e-9).any():
            edges.append(Edge(between=(names[a], names[b])))
    source = f"proposed for the environment '{environment.name}' from its clearance and sight"
    return Annotation(version=1, source=source, c_min=C_MIN, c_max=C_MAX, nodes=nodes, edges=edges)
