"""Steps per second of one Gymnasium environment, and of a vector environment.

python benchmarks/adapters.py
python benchmarks/adapters.py --rows 1 64 --name Lab-Random-RandomAbNav-v0
"""

import numpy as np
from options import Option, parse
from timing import stopwatch

from sean_jax.adapters.gymnasium import SocialNavigation, VectorSocialNavigation

SEEN = ["goal", "path", "speeds", "people"]


def rate(step, seconds: float, turns: int = 5) -> float:
    """Calls per second: the best of several runs."""
    step()
    best = 0.0
    for _ in range(turns):
        calls = 0
        with stopwatch() as watch:
            while watch.seconds < seconds:
                step()
                calls += 1
        best = max(best, calls / watch.seconds)
    return best


def main() -> None:
    """Print the table."""
    chosen = parse(
        __doc__,
        name="Warehouse-Graph-Mixed-v0",
        seconds=Option(1.0, "of each of five runs"),
        rows=[1, 16, 64],
    )
    action = np.array([0.5, 0.1], np.float32)
    env = SocialNavigation(chosen.name, observations=SEEN)
    env.reset(seed=0)

    def step() -> None:
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()

    print(f"{chosen.name}: one environment {rate(step, chosen.seconds):8,.0f} steps/s")
    for rows in chosen.rows:
        many = VectorSocialNavigation(chosen.name, rows, observations=SEEN)
        many.reset(seed=0)
        actions = np.tile(action, (rows, 1))
        rates = rate(lambda many=many, actions=actions: many.step(actions), chosen.seconds)
        print(f"{rows:6} rows {rows * rates:8,.0f} steps/s")


if __name__ == "__main__":
    main()
