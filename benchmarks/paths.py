"""Shortest paths: their excess length, and the clearance of discs that follow them.

python benchmarks/paths.py --pairs 1000
python benchmarks/paths.py --pairs 100 --environments lab --radii 0.25

For random pairs of a free start and goal, the length from the tables, and the length of paths walked along the next
points, from point to point and in strides of 0.1 m, are compared with a visibility graph in float64
(tests/support/shortest_paths.py).
"""

import argparse
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from sean_jax.world import environment as environments  # noqa: E402
from sean_jax.world import navigation  # noqa: E402
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
    start_time = time.perf_counter()
    tables = jax.block_until_ready(navigation.build(place, radius))
    seconds = time.perf_counter() - start_time
    boxes = oracle.boxes_of(place)
    truth = oracle.geodesics(boxes, radius, start.astype(float), goal.astype(float))
    found = np.asarray(oracle.lengths(tables, start, goal), float)
    there = np.isfinite(truth)
    if (there != np.isfinite(found)).any():
        raise RuntimeError(
            f"{name}, {radius} m: {(there != np.isfinite(found)).sum()} paths were not found, or do not exist"
        )
    start, goal, truth, found = start[there], goal[there], truth[there], found[there]
    excess, nearest = [found / truth - 1], []
    longest = int(np.ceil(1.1 * truth.max() / STRIDE)) + 200
    for stride, count in ((np.inf, 200), (STRIDE, longest)):
        path = np.asarray(oracle.follow(tables, start, goal, jnp.asarray(stride, jnp.float32), count), float)
        path = np.concatenate([start[:, None], path], 1)
        if np.abs(path[:, -1] - goal).max() > 1e-3:
            raise RuntimeError(f"{name}, {radius} m: a disc did not arrive")
        excess.append(np.linalg.norm(np.diff(path, axis=1), axis=-1).sum(1) / truth - 1)
        nearest.append(oracle.walked_clearance(path, boxes) - radius)
    worst = "".join(f"{100 * part.max():9.3f} {100 * part.mean():7.4f}" for part in excess)
    near = "".join(f"{1e3 * part:8.2f}" for part in nearest)
    return f"{name:>10} {radius:6.2f} {len(truth):6d}{worst}{near} {seconds:8.1f} {megabytes(tables):6.1f}"


def main() -> None:
    """Print the table."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--pairs", type=int, default=100)
    arguments.add_argument(
        "--radii", nargs="+", type=float, default=[0.16, 0.25, 0.95], help="m: Kuri, people, Warthog"
    )
    arguments.add_argument("--environments", nargs="+", default=environments.available())
    arguments.add_argument("--seed", type=int, default=0)
    chosen = arguments.parse_args()
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
