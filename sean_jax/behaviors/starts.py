"""Where people can start: places in discs that are free, and far enough apart for any choice of them to be valid."""

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import cache
from sean_jax.base import Environment
from sean_jax.geometry import room_on_host
from sean_jax.navigation import CODE, Navigation, geodesic, inputs, to_goal

APART = 0.55  # m between two places: bodies of 0.2 m and some room
TRIES = 40  # candidates for each place that would fit
FILLING = 10  # likewise, where a whole floor is filled
MOST_TRIES = 500_000  # candidates in all


def places(
    environment: Environment, navigation: Navigation, center, radius, weight, avoid: list, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """(P, 2) places [m] and (P,) the disc of each, of discs (M, 2), (M,) [m] with a positive weight (M,).

    Dart throwing on the host: uniform candidates are kept if they are clear of obstacles by the navigation's
    radius, outside the discs to ``avoid`` [(center (2,), radius)], and no nearer than 0.55 m to another.
    """
    generator = np.random.default_rng(seed)
    center, radius, weight = (np.asarray(part, float) for part in (center, radius, weight))
    number = np.ceil(TRIES * radius**2 / APART**2).astype(int) * (weight > 0)
    if number.sum() > MOST_TRIES:  # larger discs share these by their areas
        number = np.ceil(number * (MOST_TRIES / number.sum())).astype(int)
    disc = np.repeat(np.arange(len(radius)), number)
    distance = radius[disc] * np.sqrt(generator.uniform(size=len(disc)))
    angle = generator.uniform(0, 2 * np.pi, len(disc))
    spots = center[disc] + distance[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    free = np.minimum(*room_on_host(environment, spots)) > float(navigation.radius)
    for middle, reach in avoid:
        free &= np.linalg.norm(spots - np.asarray(middle, float), axis=-1) > reach
    spots, disc = spots[free], disc[free]
    kept = apart(spots, generator)
    return spots[kept], disc[kept]


def uniform(
    environment: Environment, navigation: Navigation, people: int, seed: int = 0, dense: bool = False
) -> np.ndarray:
    """(P, 2) float32 places [m] all over where one can walk, no two nearer than 0.55 m: ``people`` or more if they fit.

    The navigation's own free places do for most numbers of people; for more, and if ``dense``, the floor is filled.
    """
    generator = np.random.default_rng(seed)
    spots = np.asarray(navigation.places)
    kept = apart(spots, generator)
    if len(kept) >= people and not dense:
        return spots[kept]
    floor = np.asarray(environment.floor, float)
    number = min(int(FILLING * np.prod(floor[2:] - floor[:2]) / APART**2), MOST_TRIES)
    spots = generator.uniform(floor[:2], floor[2:], (number, 2)).astype(np.float32)
    spots = spots[np.minimum(*room_on_host(environment, spots)) > float(navigation.radius)]
    code = *CODE, "behaviors/starts"
    made = cache.kept("reached", code, [*inputs(navigation), spots], lambda: {"there": _reached(navigation, spots)})
    spots = spots[made["there"]]
    return spots[apart(spots, generator)]


def _reached(navigation: Navigation, spots: np.ndarray) -> np.ndarray:
    """(P,) bool: from which of the spots (P, 2) [m] one can walk to the navigation's places."""
    aim = navigation.places[0]
    walk = jax.jit(lambda spots, row: jax.lax.map(lambda p: geodesic(navigation, p, aim, row), spots, batch_size=1024))
    return np.isfinite(np.asarray(walk(jnp.asarray(spots, float), to_goal(navigation, aim))))


def apart(spots: np.ndarray, generator: np.random.Generator) -> list[int]:
    """Indices of a random choice of the spots (P, 2) [m], to which none can be added that is 0.55 m from all of it."""
    kept: list[int] = []
    taken: dict[tuple[int, int], list[int]] = {}  # by cell of that size, so that only neighbours are compared
    for index in generator.permutation(len(spots)):
        i, j = (int(part) for part in np.floor(spots[index] / APART))
        near = [k for a in (i - 1, i, i + 1) for b in (j - 1, j, j + 1) for k in taken.get((a, b), [])]
        if not near or np.linalg.norm(spots[near] - spots[index], axis=-1).min() >= APART:
            taken.setdefault((i, j), []).append(index)
            kept.append(index)
    return kept
