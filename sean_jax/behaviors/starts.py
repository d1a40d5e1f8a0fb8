"""Where people can start: places in discs that are free, and far enough apart for any choice of them to be valid."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from sean_jax import cache
from sean_jax.base import Array, Environment, Scenario
from sean_jax.geometry import signed_distances_on_host
from sean_jax.navigation import CODE, Navigation, build_paths_to_goal, geodesic, inputs

MIN_DISTANCE = 0.55  # m between two places: bodies of 0.2 m and some room
TRIES = 40  # candidates for each place that would fit
FLOOR_TRIES = 10  # likewise, where a whole floor is filled
MAX_TRIES = 500_000  # candidates in all


def who_is_there(scenario: Scenario) -> Bool[Array, "N"]:
    """Who of the people is present: the first ``people_present``, as if the scenario was made with so many.

    Returns:
        (N,) true for everybody if the scenario does not say how many.
    """
    if scenario.people_present is None:
        return jnp.ones(scenario.people, bool)
    return jnp.arange(scenario.people, dtype=jnp.int32) < scenario.people_present


def in_discs(
    environment: Environment,
    navigation: Navigation,
    center: Float[Array, "M 2"],
    radius: Float[Array, "M"],
    chance: Float[Array, "M"],
    avoid: list[tuple[np.ndarray, float]],
    seed: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Places in discs, no two nearer than 0.55 m, by dart throwing on the host.

    Uniform candidates are kept if they are farther from obstacles than the navigation's radius, outside the discs to
    avoid and not too near to another place.

    Args:
        center: (M, 2) m, of the discs.
        radius: (M,) m, of the discs.
        chance: (M,) of each disc; those with 0 get no places.
        avoid: centre (2,) m and radius m of discs without places.

    Returns:
        Places (P, 2) m, and the disc (P,) of each.
    """
    generator = np.random.default_rng(seed)
    middle, size, odds = (np.asarray(part, float) for part in (center, radius, chance))
    number = np.ceil(TRIES * size**2 / MIN_DISTANCE**2).astype(int) * (odds > 0)
    if number.sum() > MAX_TRIES:  # larger discs share these by their areas
        number = np.ceil(number * (MAX_TRIES / number.sum())).astype(int)
    disc = np.repeat(np.arange(len(size)), number)
    distance = size[disc] * np.sqrt(generator.uniform(size=len(disc)))
    angle = generator.uniform(0, 2 * np.pi, len(disc))
    spots = middle[disc] + distance[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    free = np.minimum(*signed_distances_on_host(environment, spots)) > float(navigation.radius)
    for other, reach in avoid:
        free &= np.linalg.norm(spots - np.asarray(other, float), axis=-1) > reach
    spots, disc = spots[free], disc[free]
    chosen = apart(spots, generator)
    return spots[chosen], disc[chosen]


def anywhere(
    environment: Environment, navigation: Navigation, people: int, seed: int = 0, dense: bool = False
) -> np.ndarray:
    """Places all over where one can walk, no two nearer than 0.55 m.

    The navigation's own free places are enough for most numbers of people. For more, the whole floor is filled.

    Args:
        people: how many places there shall be at least, if they fit.

    Returns:
        (P, 2) m, float32.
    """
    generator = np.random.default_rng(seed)
    spots = np.asarray(navigation.places)
    chosen = apart(spots, generator)
    if len(chosen) >= people and not dense:
        return spots[chosen]
    floor = np.asarray(environment.floor, float)
    number = min(int(FLOOR_TRIES * np.prod(floor[2:] - floor[:2]) / MIN_DISTANCE**2), MAX_TRIES)
    spots = generator.uniform(floor[:2], floor[2:], (number, 2)).astype(np.float32)
    spots = spots[np.minimum(*signed_distances_on_host(environment, spots)) > float(navigation.radius)]
    code = *CODE, "behaviors/starts"
    table = cache.load_or_build(
        "reached", code, [*inputs(navigation), spots], lambda: {"reachable": _reached(navigation, spots)}
    )
    spots = spots[table["reachable"]]
    return spots[apart(spots, generator)]


def _reached(navigation: Navigation, spots: np.ndarray) -> np.ndarray:
    """(P,) bool: from which of the spots (P, 2) [m] one can walk to the navigation's places."""
    aim = navigation.places[0]
    walk = jax.jit(lambda spots, row: jax.lax.map(lambda p: geodesic(navigation, p, aim, row), spots, batch_size=1024))
    return np.isfinite(np.asarray(walk(jnp.asarray(spots, float), build_paths_to_goal(navigation, aim))))


def apart(spots: np.ndarray, generator: np.random.Generator) -> list[int]:
    """A random choice of spots of which no two are nearer than 0.55 m, and to which no further spot could be added.

    Args:
        spots: (P, 2) m.
    """
    chosen: list[int] = []
    by_cell: dict[tuple[int, int], list[int]] = {}  # by cell of that size, so that only neighbours are compared
    for index in generator.permutation(len(spots)):
        i, j = (int(part) for part in np.floor(spots[index] / MIN_DISTANCE))
        near = [k for a in (i - 1, i, i + 1) for b in (j - 1, j, j + 1) for k in by_cell.get((a, b), [])]
        if not near or np.linalg.norm(spots[near] - spots[index], axis=-1).min() >= MIN_DISTANCE:
            by_cell.setdefault((i, j), []).append(index)
            chosen.append(index)
    return chosen
