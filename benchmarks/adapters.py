"""Steps per second of one Gymnasium environment, and of a vector environment.

python benchmarks/adapters.py
python benchmarks/adapters.py --rows 1 64 --name Lab-Random-RandomAbNav-v0
"""

import argparse
import time

import numpy as np

from sean_jax.adapters.gymnasium import SocialNavigation, VectorSocialNavigation

SEEN = ["goal", "path", "speeds", "people"]


def rate(step, seconds: float, turns: int = 5) -> float:
    """Calls per second: the best of several runs."""
    step()
    best = 0.0
    for _ in range(turns):
        calls, begun = 0, time.perf_counter()
        while (took := time.perf_counter() - begun) < seconds:
            step()
            calls += 1
        best = max(best, calls / took)
    return best


def main() -> None:
    """Print the table."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--name", default="Warehouse-Graph-Mixed-v0")
    arguments.add_argument("--seconds", type=float, default=1.0, help="of each of five runs")
    arguments.add_argument("--rows", nargs="+", type=int, default=[1, 16, 64])
    chosen = arguments.parse_args()
    action = np.array([0.5, 0.1], np.float32)
    one = SocialNavigation(chosen.name, observations=SEEN)
    one.reset(seed=0)

    def step() -> None:
        _, _, terminated, truncated, _ = one.step(action)
        if terminated or truncated:
            one.reset()

    print(f"{chosen.name}: one environment {rate(step, chosen.seconds):8,.0f} steps/s")
    for rows in chosen.rows:
        many = VectorSocialNavigation(chosen.name, rows, observations=SEEN)
        many.reset(seed=0)
        actions = np.tile(action, (rows, 1))
        rates = rate(lambda many=many, actions=actions: many.step(actions), chosen.seconds)
        print(f"{rows:6} rows {rows * rates:8,.0f} steps/s")


if __name__ == "__main__":
    main()
