"""Crowd speed: agent-steps per second of the social force step, and of the same law in a float64 numpy loop.

python benchmarks/crowd.py                        (1, 62), (256, 62) and (1, 1000) people, open and with walls
python benchmarks/crowd.py --sizes 8192x62        any B x N
"""

import resource

import jax
import numpy as np
from options import Option, parse
from timing import device, import_from_tests, stopwatch

from sean_jax import social_forces
from sean_jax.cli.bench import programs, workload

import_from_tests()  # the oracle is that of the tests
from support import float64  # noqa: E402

STEP = 0.05  # s


def measure(batch: int, people: int, walls: int, preset: str) -> dict:
    """Speed, compile time and peak temporary memory of one size."""
    turns = int(np.clip(4e8 / (batch * people * (min(people, 100) + walls)), 50, 1000))  # fewer would time dispatch
    return programs.measure(programs.crowd(people, batch, turns, walls, preset), 5, 0.1)


def loop(people: int, walls: int, preset: str, steps: int = 2) -> float:
    """Agent-steps per second of the float64 loop."""
    p, state, boxes = float64.crowd(people, walls, preset)
    with stopwatch() as watch:
        for _ in range(steps):
            state = float64.step(*state, boxes, p, STEP) + state[3:]
    return people * steps / watch.seconds


def errors(people: int, walls: int, preset: str, steps: int) -> float:
    """Relative error of positions and velocities against the loop after a number of steps."""
    p, state, boxes = float64.crowd(people, walls, preset)
    crowd, grid, _ = workload.crowd(people, walls)
    parameters = social_forces.preset(preset)
    integrate = jax.jit(lambda c: social_forces.integrate(parameters, c, grid, None, None, STEP))
    for _ in range(steps):
        state = float64.step(*state, boxes, p, STEP) + state[3:]
        crowd = integrate(crowd)
    ours = np.concatenate([crowd.position, crowd.velocity])
    theirs = np.concatenate(state[:2])
    return float(np.linalg.norm(ours - theirs) / np.linalg.norm(theirs))


def main() -> None:
    """Print the table."""
    chosen = parse(
        __doc__,
        sizes=Option(["1x62", "256x62", "1x1000"], metavar="BxN"),
        walls=[0, 32],
        presets=["calibrated", "helbing1995", "sean2"],
        no_loop=Option(False, "leave out the float64 loop"),
    )
    print(f"{device()}, step {STEP} s")
    print(f"{'preset':>13} {'B':>6} {'N':>6} {'walls':>5} {'agent-steps/s':>14} {'us/step':>10} "
          f"{'compile s':>9} {'MiB':>9} {'loop /s':>9} {'error 1':>9} {'error 20':>9}")  # fmt: skip
    for preset in chosen.presets:
        for size in chosen.sizes:
            batch, people = (int(part) for part in size.split("x"))
            for walls in chosen.walls:
                row = measure(batch, people, walls, preset)
                extra = f"{'-':>9} {'-':>9} {'-':>9}"
                if not chosen.no_loop and batch == 1 and people <= 1000:
                    twenty = f"{errors(people, walls, preset, 20):9.1e}" if people <= 100 else f"{'-':>9}"
                    extra = f"{loop(people, walls, preset):9.3g} {errors(people, walls, preset, 1):9.1e} {twenty}"
                figures = f"{row['per_second']:14.3g} {row['microseconds']:10.1f} {row['compile_seconds']:9.2f}"
                mib = row["bytes"] / 2**20
                print(f"{preset:>13} {batch:6d} {people:6d} {walls:5d} {figures} {mib:9.1f} {extra}", flush=True)
    print(f"peak resident memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GiB")


if __name__ == "__main__":
    main()
