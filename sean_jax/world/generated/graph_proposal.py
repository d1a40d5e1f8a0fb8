"""A graph for an environment that has none: nodes where there is room and sight, edges that people can walk straight.

Nodes are places of greatest clearance, one after the other: the points of the medial axis from which most of the floor
that no node sees yet is near and in sight. Then places are added until the floor that a person can reach is one
piece of the graph. An edge joins two nodes if a person can walk straight from one to the other and no third node lies
between (both of its edges would be shorter): the relative neighborhood graph.

Source: H. Blum, A transformation for extracting new descriptors of shape, 1967 (medial axis); G. T. Toussaint, The
relative neighbourhood graph of a finite planar set, Pattern Recognition 12(4), 1980.
"""

import math

import numpy as np
from jaxtyping import Float
from scipy.sparse.csgraph import connected_components

from sean_jax.core.data_types import Environment
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import signed_distances_on_host
from sean_jax.graph.annotation import NODE_CLEARANCE, PERSON, Annotation, Edge, Entrance, Node
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
END = "end_"  # of the name of a node where people come from and go to
C_MIN = 0.2  # as in the shipped graphs
C_MAX = 100.0


def propose(environment: Environment, ends: Float[np.ndarray, "K 2"] | None = None) -> Annotation:
    """A graph of waypoints for an environment.

    Args:
        ends: (K, 2) m, where people come from and go to, if known: where many are, there is a node that is an entrance.

    Raises:
        InputError: there is no room for a person, or the floor is too winding.
    """
    floor = _Floor(environment)
    graph = _Graph(floor)

    # Where people come from and go to, and then where most of the floor is out of sight.
    if ends is not None:
        for end in _clusters(np.asarray(ends, float)):
            distance = np.linalg.norm(floor.cells - end, axis=-1)
            graph.add(int(np.argmin(distance)))
    n_ends = len(graph.nodes)
    while len(unseen := graph.unseen()) > UNSEEN * len(floor.cells):
        clearance = floor.clearance[unseen]
        room = np.minimum(clearance, MAX_RADIUS) + 1e-2 * clearance
        graph.add(int(unseen[np.argmax(room)]))

    # Nodes join what the first ones leave apart, and then as few as possible stay.
    connected = _connect(graph)
    chosen = _needed(graph, connected, n_ends)
    cells = [graph.nodes[k] for k in chosen]
    position = floor.cells[cells]  # (M, 2) m
    clearance = floor.clearance[cells]
    sees = np.array([graph.sights[k][cells] for k in chosen])  # (M, M)
    visible = sees | sees.T
    n_chosen_ends = sum(k < n_ends for k in chosen)
    names = [f"{END}{k + 1}" for k in range(n_chosen_ends)]
    names += [f"place_{k + 1}" for k in range(len(chosen) - n_chosen_ends)]
    return _annotation(environment, names, position, clearance, visible)


class _Floor:
    """The cells of an environment in which a node can be."""

    def __init__(self, environment: Environment) -> None:
        self.environment = environment
        self.cells, self.clearance, self.neighbors = _cells(environment)
        x0, y0, x1, y1 = np.asarray(environment.floor, float)
        side = math.sqrt((x1 - x0) * (y1 - y0))  # m, of a square floor of this area
        self.sight = max(SIGHT, SIGHT_SHARE * side)  # m


class _Graph:
    """Nodes in cells of a floor, and the cells that each sees."""

    def __init__(self, floor: _Floor) -> None:
        self.floor = floor
        self.nodes: list[int] = []  # cells
        self.sights: list[np.ndarray] = []  # of each node, (cells,) whether it sees them
        self.near: list[np.ndarray] = []  # of each node, cells that it sees and is near to

    def add(self, cell: int) -> None:
        """Add a node; InputError if there are ``MAX_NODES``."""
        floor = self.floor
        if len(self.nodes) == MAX_NODES:
            raise InputError(
                f"environment '{floor.environment.name}' is so winding that {MAX_NODES} nodes do not see all of it; "
                "write a graph.yaml for it by hand."
            )
        place = floor.cells[cell]
        start = np.broadcast_to(place, floor.cells.shape)
        sight = np.asarray(pairs_are_free(floor.environment.obstacles, PERSON, start, floor.cells))
        sight[cell] = True
        distance = np.linalg.norm(floor.cells - place, axis=-1)
        self.nodes.append(cell)
        self.sights.append(sight)
        self.near.append(sight & (distance < floor.sight))

    def unseen(self) -> np.ndarray:
        """The cells that no node sees and is near to."""
        if self.near:
            return np.flatnonzero(~np.any(self.near, axis=0))
        return np.arange(len(self.floor.cells))

    def components(self, among: list[int] | None = None) -> list[list[int]]:
        """The nodes, or some among them, that are joined by sight, component by component."""
        if among is None:
            index = np.arange(len(self.nodes))
        else:
            index = np.sort(among)
        cells = np.asarray(self.nodes)[index]
        visible = np.array([self.sights[k][cells] for k in index])
        visible = visible.reshape(len(index), len(index))  # without nodes, too
        count, label = connected_components(visible, directed=False)
        return [index[label == component].tolist() for component in range(count)]


def _cells(environment: Environment) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centers (K, 2) m of possible cells of nodes, their clearance (K,) m, and pairs (L, 2) of neighboring cells."""
    x0, y0, x1, y1 = np.asarray(environment.floor, float)
    width = x1 - x0
    depth = y1 - y0
    excess = width * depth / CELL**2 / MAX_CELLS  # of cells, over the maximum
    size = CELL * max(1.0, math.sqrt(excess))
    columns = max(1, round(width / size))
    rows = max(1, round(depth / size))

    # Their middles.
    column = np.arange(columns)
    row = np.arange(rows)
    x = x0 + (column + 0.5) * width / columns
    y = y0 + (row + 0.5) * depth / rows
    grid = np.meshgrid(x, y, indexing="ij")
    middle = np.stack(grid, -1).reshape(-1, 2)  # (columns * rows, 2) m

    # Cells of nodes are clear of obstacles and edges.
    to_obstacle, to_edge = signed_distances_on_host(environment, middle)
    clearance = np.minimum(to_obstacle, to_edge)
    free = clearance >= NODE_CLEARANCE + ROOM
    if not free.any():
        raise InputError(f"environment '{environment.name}' has no room for a node; look at its floor and scene.xml.")

    # Pairs of cells beside each other in x, and in y.
    index = np.where(free, np.cumsum(free) - 1, -1)
    index = index.reshape(columns, rows)
    in_x = np.stack([index[1:], index[:-1]], -1).reshape(-1, 2)
    in_y = np.stack([index[:, 1:], index[:, :-1]], -1).reshape(-1, 2)
    neighbors = np.concatenate([in_x, in_y])
    both_free = (neighbors >= 0).all(1)
    neighbors = neighbors[both_free]
    return middle[free], clearance[free], neighbors


def _clusters(ends: np.ndarray) -> list[np.ndarray]:
    """(2,) m the middle of each place where many of the ends (K, 2) [m] are, the fullest first."""
    middles = []
    remaining = ends
    min_ends = max(2, MIN_SHARE * len(ends))
    while len(remaining) and len(middles) < MAX_NODES // 2:
        gaps = remaining[:, None] - remaining[None, :]
        near = np.linalg.norm(gaps, axis=-1) < MERGE
        counts = near.sum(1)
        fullest = near[np.argmax(counts)]
        if fullest.sum() < min_ends:
            break
        middle = remaining[fullest].mean(0)
        middles.append(middle)
        distance = np.linalg.norm(remaining - middle, axis=-1)
        remaining = remaining[distance >= MERGE]
    return middles


def _connect(graph: _Graph) -> list[int]:
    """The nodes of the largest component, after nodes were added that join all components that can be joined.

    Where two components see the same cells, the node is the roomiest of them. Else one component is led on around the
    corner: to the roomiest cell that it sees beside one that it does not.
    """
    clearance = graph.floor.clearance
    closed: set[int] = set()  # components, by their first node, that see all that can be reached from them
    while True:
        components = graph.components()
        views = np.array([_view(graph, component) for component in components])  # (components, K)
        largest = int(np.argmax(views.sum(1)))
        growing = [k for k, component in enumerate(components) if component[0] not in closed]
        if len(components) == 1 or not growing:
            return components[largest]

        # The first component that can grow, towards what others see.
        grown = growing[0]
        view = views[grown]
        other_views = np.delete(views, grown, 0)
        other_view = np.any(other_views, axis=0)
        candidates = np.flatnonzero(view & other_view)
        if len(candidates) == 0:
            candidates = _border(view, graph.floor.neighbors)
        is_node = np.isin(candidates, graph.nodes)
        candidates = candidates[~is_node]
        if len(candidates) == 0:
            closed.add(components[grown][0])
        else:
            roomiest = candidates[np.argmax(clearance[candidates])]
            graph.add(int(roomiest))


def _view(graph: _Graph, nodes: list[int]) -> np.ndarray:
    """(K,) bool, the cells that some of these nodes see."""
    sights = [graph.sights[k] for k in nodes]
    return np.any(sights, axis=0)


def _border(view: np.ndarray, neighbors: np.ndarray) -> np.ndarray:
    """The cells of a view (K,) beside a cell that is not in it."""
    first_seen, second_seen = view[neighbors].T
    first, second = neighbors.T
    only_first = first[first_seen & ~second_seen]
    only_second = second[~first_seen & second_seen]
    return np.unique(np.concatenate([only_first, only_second]))


def _needed(graph: _Graph, chosen: list[int], n_ends: int) -> list[int]:
    """The nodes without redundant ones, the narrowest first: others see the same cells and join the same nodes."""
    clearance = graph.floor.clearance
    n_views = np.sum([graph.near[k] for k in chosen], axis=0)  # by how many nodes a cell is seen
    may_be_unseen = UNSEEN * len(clearance) - np.sum(n_views == 0)
    for k in sorted(chosen, key=lambda k: clearance[graph.nodes[k]]):
        others = [other for other in chosen if other != k]
        near = graph.near[k]
        only_here = near & (n_views == 1)
        unseen = int(np.sum(only_here))
        if k < n_ends or not others or unseen > may_be_unseen:
            continue
        if len(graph.components(others)) > 1:
            continue
        chosen = others
        n_views = n_views - near
        may_be_unseen -= unseen
    return chosen


def _annotation(
    environment: Environment, names: list[str], position: np.ndarray, clearance: np.ndarray, visible: np.ndarray
) -> Annotation:
    """The annotation of nodes at (M, 2) m with a clearance (M,) m, of which pairs (M, M) see each other."""
    gap = np.linalg.norm(position[:, None] - position[None, :], axis=-1)
    itself = np.eye(len(gap), dtype=bool)
    to_others = gap + np.where(itself, np.inf, 0.0)
    nearest = np.min(to_others, axis=1, initial=np.inf)
    radii = np.minimum(clearance - PERSON, 0.45 * nearest)
    radii = np.clip(radii, PERSON, MAX_RADIUS)
    nodes = {}
    for name, (x, y), radius in zip(names, position.tolist(), radii.tolist(), strict=True):
        place = round(x, 3), round(y, 3)
        entrance = Entrance() if name.startswith(END) else None
        nodes[name] = Node(kind="waypoint", position=place, radius=round(radius, 2), spawn=1, entrance=entrance)

    # The relative neighborhood graph: no third node is nearer to both.
    length = np.where(visible, gap, np.inf)
    edges = []
    for a, b in np.argwhere(np.triu(visible, 1)):
        longer = np.maximum(length[a], length[b])  # of both edges by each third node
        is_between = longer < gap[a, b] - 1e-9
        if not is_between.any():
            edges.append(Edge(between=(names[a], names[b])))
    source = f"proposed for the environment '{environment.name}' from its clearance and sight"
    return Annotation(version=1, source=source, c_min=C_MIN, c_max=C_MAX, nodes=nodes, edges=edges)
