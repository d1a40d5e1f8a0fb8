"""Weak scaling: scenario-steps per second on some devices of this machine, with restarts from a pool.

python benchmarks/devices.py --devices 1 2 --batch 32768      on GPUs
XLA_FLAGS=--xla_force_host_platform_device_count=2 python benchmarks/devices.py --devices 1 2 --batch 16
"""

import argparse
import time

import jax
import jax.numpy as jnp
import numpy as np

import sean_jax
from sean_jax import devices, restarts

STEPS = 10  # in one call


def drive(scenario, state, key):
    """A constant command."""
    return jnp.asarray([0.4, 0.3], jnp.float32)


def nothing(before, after, action):
    """No frames are kept."""
    return ()


def main() -> None:
    """Print the table."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--devices", nargs="+", type=int, default=[1])
    arguments.add_argument("--batch", type=int, default=64, help="scenarios on each device")
    arguments.add_argument("--people", type=int, default=62)
    arguments.add_argument("--dynamics", default="mjx")
    chosen = arguments.parse_args()
    print(f"{jax.devices()[0].device_kind}, jax {jax.__version__}, {chosen.people} people, {chosen.dynamics}")
    print(f"{'devices':>7} {'B each':>7} {'us/step':>9} {'steps/s':>12} {'compile s':>9}")
    scenario = sean_jax.make("warehouse", people=chosen.people, dynamics=chosen.dynamics)
    starts = jax.jit(restarts.pool, static_argnums=2)(scenario, jax.random.key(1), min(1024, chosen.batch))
    for number in chosen.devices:
        over = devices.mesh(jax.devices()[:number])
        fixed = devices.everywhere(over, (scenario, starts))
        keys = devices.keys(over, jax.random.key(0), chosen.batch * number)
        states = devices.spread(over, lambda fixed, key: sean_jax.reset(fixed[0], key))(fixed, keys)
        run = devices.spread(
            over, lambda fixed, state: restarts.endless(fixed[0], drive, fixed[1], state, STEPS, nothing)[0]
        )
        begun = time.perf_counter()
        states = jax.block_until_ready(run(fixed, states))
        compiling = time.perf_counter() - begun
        spent = []
        for _ in range(5):
            begun = time.perf_counter()
            states = jax.block_until_ready(run(fixed, states))
            spent.append((time.perf_counter() - begun) / STEPS)
        each = float(np.median(spent))
        total = chosen.batch * number / each
        print(f"{number:7d} {chosen.batch:7d} {1e6 * each:9.0f} {total:12.0f} {compiling:9.1f}", flush=True)


if __name__ == "__main__":
    main()
