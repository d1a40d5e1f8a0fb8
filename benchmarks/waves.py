"""social_costmap and move_base on a GPU, with the kernel of their waves and with loops of XLA.

    python benchmarks/waves.py                              # on a GPU
    python benchmarks/waves.py --batches 2 --steps 1 --windows 2

First the waves of both forms are compared, in windows of random costs. On a CPU both are the same sweeps.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from options import Option, parse
from timing import device, least

import sean_jax
from sean_jax.policies import POLICIES, costmap, wave_kernel
from sean_jax.simulation.episodes import init_policy, simulate

SUPPORTS = wave_kernel.supports
FORMS = "loops", "kernel"


def choose(form: str) -> None:
    """Use this form of waves on a GPU in all programs traced from now on."""
    jax.clear_caches()
    wave_kernel.supports = SUPPORTS if form == "kernel" else lambda wave: False


def compare(count: int) -> None:
    """Print times and differences of the waves in windows of which a fifth is obstacles."""
    random, shape = np.random.default_rng(0), (count, costmap.WINDOW, costmap.WINDOW)
    costs = jnp.asarray(np.where(random.random(shape) < 0.2, 254, random.integers(0, 120, shape)), float)
    start = jnp.full(shape, costmap.UNREACHED).at[:, 32, 32].set(0.0)
    waves = {
        "potentials": (costmap.potentials, jax.vmap(costmap.resistance)(costs)),
        "steps": (costmap.steps_from, costs < costmap.INSCRIBED),
    }
    for name, (wave, cells) in waves.items():
        results, times = [], []
        for form in FORMS:
            choose(form)
            run = jax.jit(jax.vmap(wave))
            results.append(np.asarray(run(start, cells)))
            times.append(least(partial(run, start, cells)))
        apart = np.abs(results[0] - results[1])
        print(
            f"{name} of {count} windows: {1e3 * times[0]:.2f} ms by loops, {1e3 * times[1]:.2f} ms by the kernel; "
            f"{100 * (apart == 0).mean():.1f} % of the cells are equal, "
            f"the others differ by at most {(apart / np.maximum(results[0], 1.0)).max():.1e} of themselves",
            flush=True,
        )


def main() -> None:
    """Print the tables."""
    chosen = parse(
        __doc__,
        batches=[1024, 4096],
        steps=50,
        windows=Option(4096, "that are compared"),
        policies=Option(["social_costmap", "move_base"], choices=list(POLICIES)),
    )
    print(f"{device()}")
    compare(chosen.windows)
    scenario = sean_jax.make("warehouse", behavior="graph", task="join_group")
    print(f"{'policy':>16} {'episodes':>9} {'waves by':>9} {'steps/s':>10} {'ms a step':>10}")
    for name in chosen.policies:
        policy = POLICIES[name]
        for batch in chosen.batches:
            keys = jax.random.split(jax.random.key(0), batch)
            draw = jax.jit(jax.vmap(lambda key: init_policy(scenario, policy, sean_jax.reset(scenario, key))))  # noqa: B023
            states = draw(keys)
            for form in FORMS:
                choose(form)
                drive = lambda state: simulate(scenario, policy, state, chosen.steps, lambda *_: ())[0].robot.position  # noqa: B023, E731
                run = jax.jit(jax.vmap(drive)).lower(states).compile()
                spent = least(partial(run, states)) / chosen.steps
                print(f"{name:>16} {batch:>9} {form:>9} {batch / spent:>10,.0f} {1e3 * spent:>10.2f}", flush=True)


if __name__ == "__main__":
    main()
