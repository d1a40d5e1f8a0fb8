"""Steps per second on many floors in one program, beside the harmonic mean of some of these floors alone.

    python benchmarks/worlds.py worlds:all:128 --batches 65536 8192
    python benchmarks/worlds.py worlds:all:128 --batches 8192 --depth

A floor alone is padded to the same sizes, so both programs do the same work. The ratio is 1 if nothing is lost.
"""

import argparse
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import assembly, reset, step
from sean_jax.base import Scenario, State
from sean_jax.config import ScenarioConfig, validate
from sean_jax.mdp.observations import OBSERVATIONS
from sean_jax.stack import Stack

STEPS, REPEATS, FLOORS = 16, 4, 12  # of a call; calls; floors that run alone
COMMAND = (0.3, 0.1)  # m/s, rad/s


def program(depth: bool) -> Callable[..., Any]:
    """``STEPS`` steps of all scenarios, with a depth image of each step if asked for."""

    def one(scenario: Scenario, state: State) -> tuple[State, jax.Array]:
        after = step(scenario, state, jnp.array(COMMAND))
        shown = OBSERVATIONS["depth"].read(scenario, after, ()).sum() if depth else jnp.zeros(())
        return after, shown

    def run(floors: Stack[Scenario], states: State) -> tuple[State, jax.Array]:
        def turn(states: State, _: None) -> tuple[State, jax.Array]:
            states, shown = floors.vmap(one)(states)
            return states, shown.sum()

        return jax.lax.scan(turn, states, length=STEPS)

    return jax.jit(run, donate_argnums=1)


def rate(compiled: Any, floors: Stack[Scenario], states: State, batch: int) -> float:
    """Scenario-steps per second, the best of some calls."""
    best = 0.0
    for _ in range(REPEATS):
        start = time.perf_counter()
        states, _ = jax.block_until_ready(compiled(floors, states))
        best = max(best, batch * STEPS / (time.perf_counter() - start))
    return best


def main() -> None:
    """Print a line for each batch."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("floors", help="a set of floors, such as worlds:all:128")
    parser.add_argument("--batches", type=int, nargs="+", default=[65536])
    parser.add_argument("--depth", action="store_true", help="with a depth image of 64 x 48 pixels")
    options = parser.parse_args()
    config = validate(ScenarioConfig, {"environment": options.floors, "task": "random_ab_nav", "metrics": "none"})
    begun = time.perf_counter()
    floors = assembly.build_stack(config).map_member(lambda scenario: assembly.with_tasks(config, scenario)[0])
    size = sum(values.nbytes for values in {id(each): each for each in floors.own.values()}.values()) / floors.size
    text = f"{floors.size} floors in {time.perf_counter() - begun:.0f} s, {size / 1e6:.2f} MB each"
    print(f"{jax.devices()[0].device_kind}, {text}, {floors.member.people} people at most", flush=True)
    host, device = jax.devices("cpu")[0], jax.devices()[0]
    with jax.default_device(host):  # a reset compiles faster there
        draw = jax.jit(lambda floors, keys: floors.over_members(reset)(keys))
        starts = draw(jax.device_put(floors, host), jax.random.split(jax.random.key(0), floors.size))
    floors, starts = jax.device_put((floors, starts), device)
    for batch in options.batches:
        states = jax.tree.map(lambda leaf: jnp.repeat(leaf, batch // floors.size, axis=0), starts)  # noqa: B023
        together = rate(program(options.depth).lower(floors, states).compile(), floors, states, batch)
        alone, compiled = [], None
        for index in np.linspace(0, floors.size - 1, FLOORS).astype(int):
            one = Stack(jax.tree.map(jnp.asarray, floors.at(int(index))), {})
            states = jax.tree.map(lambda leaf: jnp.repeat(leaf[index][None], batch, axis=0), starts)  # noqa: B023
            compiled = compiled or program(options.depth).lower(one, states).compile()
            alone.append(rate(compiled, one, states, batch))
        mean = FLOORS / sum(1.0 / each for each in alone)
        print(f"{batch}: {together:.4g} steps/s, alone {mean:.4g}, ratio {together / mean:.3f}", flush=True)


if __name__ == "__main__":
    main()
