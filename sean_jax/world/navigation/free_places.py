"""Free places, from which starts and goals are drawn: uniformly, or as SEAN 2.0 draws points of its navigation mesh.

SEAN takes a point between two random vertices of the mesh's triangles, which lies the more often in the middle of a
floor and on lines between corners. It draws from the list of triangles, three vertices each, so a vertex is the more
likely, the more triangles it has. Unity's meshes of SEAN's scenes are binary files: here the floor is triangulated.
"""

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int
from scipy.spatial import KDTree

from sean_jax.core.data_types import FAR, Array, Environment
from sean_jax.core.devices import to_device
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import signed_distances_on_host
from sean_jax.io import cache
from sean_jax.world.navigation.arcs import SLACK, pairs_are_free
from sean_jax.world.navigation.tables import CODE, Navigation, inputs
from sean_jax.world.navigation.triangulation import free_triangles

MESH_RADIUS = 0.5  # m, distance of edges of SEAN's mesh from obstacles; a larger robot's radius instead
MESH_EDGE = 0.25  # m, from a point to the nearest edge of the mesh, at least (SEAN 2.0)
MESH_SHARE = 0.05, 0.95  # of the way from the first vertex to the second (SEAN 2.0)
MESH_DRAWS = 65_536  # points that are tabulated, 64 for each place
NEAREST = 8  # candidates for the place of a point: the nearest visible place


def draw_places(navigation: Navigation, key: Array, number: int) -> Int[Array, "{number}"]:
    """Draw indices of ``navigation.places``, with replacement."""
    if navigation.mesh_places is None:
        return draw_uniform_places(navigation, key, number)
    index = jax.random.randint(key, (number,), 0, navigation.mesh_places.shape[0], jnp.int32)
    return navigation.mesh_places[index]


def draw_uniform_places(navigation: Navigation, key: Array, number: int) -> Int[Array, "{number}"]:
    """Draw indices of ``navigation.places``, each as likely."""
    count = (navigation.places[:, 0] < FAR).sum(dtype=jnp.int32)  # without padding
    return jax.random.randint(key, (number,), 0, count, jnp.int32)


def uniform_places(environment: Environment, navigation: Navigation) -> Navigation:
    """All free places are equally likely."""
    return replace(navigation, mesh_places=None)


def mesh_places(environment: Environment, navigation: Navigation) -> Navigation:
    """Places are as likely as points that SEAN 2.0 draws on its navigation mesh are near to them.

    A point lies between two random vertices of the triangles of the free floor whose whole metres differ in x and in y,
    at least 0.25 m from the nearest edge. The nearest visible free place replaces it.

    Raises:
        InputError: hardly any such point is free.

    Source: SEAN 2.0, Util/Navmesh.cs, and the radius of the mesh in Warehouse.unity.
    """
    key = [*inputs(navigation), environment.floor]
    table = cache.load_or_build("mesh_places", CODE, key, lambda: {"place": _nearest_to_draws(environment, navigation)})
    return replace(navigation, mesh_places=to_device(table["place"]))


PLACES: dict[str, Callable[[Environment, Navigation], Navigation]] = {"uniform": uniform_places, "mesh": mesh_places}
"""How starts and goals are drawn from the free places."""


def _nearest_to_draws(environment: Environment, navigation: Navigation) -> np.ndarray:
    """(M,) int32, for each of many points of the mesh the nearest free place in sight."""
    generator = np.random.default_rng(2)
    radius = max(float(navigation.radius), MESH_RADIUS)
    vertices = free_triangles(environment, radius).reshape(-1, 2)
    places = np.asarray(navigation.places, float)
    tree = KDTree(places)

    nearest: list[np.ndarray] = []
    n_places = 0
    n_draws = 0
    while n_places < MESH_DRAWS:
        points = _points_between(vertices, generator)
        points = points[np.minimum(*signed_distances_on_host(environment, points)) >= radius + MESH_EDGE]
        place = _nearest_in_sight(environment, navigation, places, tree, points)
        nearest.append(place[place >= 0])
        n_places += len(nearest[-1])
        n_draws += MESH_DRAWS
        if n_places * 2000 < n_draws:
            raise InputError(
                f"places: of points between corners of '{environment.name}', hardly any is {radius + MESH_EDGE:g} m "
                "from obstacles, as on SEAN's navigation mesh; choose uniform."
            )
    return np.concatenate(nearest)[:MESH_DRAWS].astype(np.int32)


def _nearest_in_sight(
    environment: Environment, navigation: Navigation, places: np.ndarray, tree: KDTree, points: np.ndarray
) -> np.ndarray:
    """(P,) int: of each point (P, 2) [m] the nearest place in sight among ``NEAREST``, or -1."""
    free_radius = max(float(navigation.radius) - SLACK, 0.0)
    n_candidates = min(NEAREST, len(places))
    candidates = tree.query(points, n_candidates)[1].reshape(len(points), n_candidates)
    chosen = np.full(len(points), -1)
    for candidate in candidates.T:
        remaining = np.flatnonzero(chosen < 0)
        if len(remaining) == 0:
            break
        place = candidate[remaining]
        clear = pairs_are_free(environment.obstacles, free_radius, points[remaining], places[place])
        chosen[remaining[clear]] = place[clear]
    return chosen


def _points_between(vertices: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Points (P, 2) [m] between two of the vertices (K, 2) [m] that differ in the whole metres of x and of y."""
    if len(vertices) == 0:
        return np.zeros((0, 2))
    ends = vertices[generator.integers(len(vertices), size=(2, MESH_DRAWS))]  # (2, MESH_DRAWS, 2)
    differ = (np.trunc(ends[0]) != np.trunc(ends[1])).all(1)
    first, second = ends[:, differ]
    share = generator.uniform(*MESH_SHARE, (len(first), 1))
    return first + share * (second - first)
