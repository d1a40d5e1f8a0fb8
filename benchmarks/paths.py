"""Shortest paths: their excess length, and the clearance of discs that follow them.

python benchmarks/paths.py --pairs 1000
python benchmarks/paths.py --pairs 100 --environments lab --radii 0.25

For random pairs of a free start and goal, the length from the tables, and the length of paths walked along the next
points, from point to point and in strides of 0.1 m, are compared with a visibility graph in float64
(tests/support/shortest_paths.py).
"""

import jax
import jax.numpy as jnp
import numpy as np
from options import Option, parse
from timing import import_from_tests, stopwatch

from sean_jax.world import environment as environments
from sean_jax.world import navigation

import_from_tests()
from support import shortest_paths as oracle  # noqa: E402

STRIDE = 0.1  # m


def megabytes(tables) -> float:
    """Megabytes of all arrays."""
    return sum(leaf.nbytes for leaf in jax.tree.leaves(tables)) / 1e6


def measure(name: str, radius: float, pairs: int, seed: int) -> str:
    """A row of the table; raises ValueError if the disc does not fit."""
    place = environments.load(name)
    points = environments.free_points(place, radius, 2 * pairs, seed)
    start, goal = points[:pairs], points[pairs:]
    with stopwatch() as watch:
        tables = jax.block_until_ready(navigation.build(place, radius))

    boxes = oracle.boxes_of(place)
    shortest = oracle.geodesics(boxes, radius, start.astype(float), goal.astype(float))
    length = np.asarray(oracle.lengths(tables, start, goal), float)
    reachable = np.isfinite(shortest)
    wrong = int((reachable != np.isfinite(length)).sum())
    if wrong:
        raise RuntimeError(f"{name}, {radius} m: {wrong} paths were not found, or do not exist")
    start, goal, shortest = start[reachable], goal[reachable], shortest[reachable]

    # Lengths from the tables, and of walks from point to point and in strides.
    excess, clearance = [length[reachable] / shortest - 1], []
    for stride, steps in ((np.inf, 200), (STRIDE, int(np.ceil(1.1 * shortest.max() / STRIDE)) + 200)):
        path = np.asarray(oracle.follow(tables, start, goal, jnp.asarray(stride, jnp.float32), steps), float)
        path = np.concatenate([start[:, None], path], 1)  # (pairs, steps + 1, 2)
        if np.abs(path[:, -1] - goal).max() > 1e-3:
            raise RuntimeError(f"{name}, {radius} m: a disc did not arrive")
        excess.append(np.linalg.norm(np.diff(path, axis=1), axis=-1).sum(1) / shortest - 1)
        clearance.append(oracle.walked_clearance(path, boxes) - radius)
    worst = "".join(f"{100 * share.max():9.3f} {100 * share.mean():7.4f}" for share in excess)
    near = "".join(f"{1e3 * gap:8.2f}" for gap in clearance)
    return f"{name:>10} {radius:6.2f} {len(shortest):6d}{worst}{near} {watch.seconds:8.1f} {megabytes(tables):6.1f}"


def main() -> None:
    """Print the table."""
    chosen = parse(
        __doc__,
        pairs=100,
        radii=Option([0.16, 0.25, 0.95], "m: Kuri, people, Warthog"),
        environments=environments.available(),
        seed=0,
    )
    print("excess over the shortest path in %, worst and mean: of the length, and walked from point to point and in")
    print(
        "strides of 0.1 m; least clearance of these two, less the radius, in mm; seconds to build the tables; their MB"
    )
    head = (
        f"{'place':>10} {'radius':>6} {'pairs':>6} {'length':>8} {'mean':>7} {'points':>8} {'mean':>7} {'strides':>8} "
    )
    print(head + f"{'mean':>7} {'points':>7} {'strides':>7} {'build':>8} {'MB':>6}")
    for name in chosen.environments:
        for radius in chosen.radii:
            try:
                print(measure(name, radius, chosen.pairs, chosen.seed), flush=True)
            except ValueError as error:
                print(f"{name:>10} {radius:6.2f} {error}")


if __name__ == "__main__":
    main()
