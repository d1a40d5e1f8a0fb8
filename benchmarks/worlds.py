"""Steps per second on many floors in one program, beside the harmonic mean of some of these floors alone.

    python benchmarks/worlds.py worlds:all:128 --batches 65536 8192
    python benchmarks/worlds.py worlds:all:128 --batches 8192 --observe depth

With ``--observe`` a step has observations and rewards as in a training, with the nearest people or a depth image of
64 x 48 pixels. A floor alone is padded to the same sizes, so both programs do the same work. The ratio is 1 if nothing
is lost.
"""

import argparse
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import mdp, registry, reset, step
from sean_jax.config import EnvConfig, validate
from sean_jax.core.data_types import Scenario, State
from sean_jax.simulation import making
from sean_jax.simulation.scenario_stack import Stack

STEPS, REPEATS, FLOORS = 16, 4, 12  # of a call; calls; floors that run alone
COMMAND, ACTION = (0.3, 0.1), (0.6, 0.1)  # m/s, rad/s; shares of the top speeds
OBSERVATIONS = {"people": ("goal", "path", "people"), "depth": ("goal", "path", "depth")}


def moved(scenario: Scenario, state: State) -> tuple[State, jax.Array]:
    """A step without observations."""
    return step(scenario, state, jnp.array(COMMAND)), jnp.zeros(())


def observed(env: mdp.Env, state: mdp.EnvState) -> tuple[mdp.EnvState, jax.Array]:
    """A step with observations and rewards, which are added up so that they are computed."""
    state, observation, reward, *_ = env.advance(state, jnp.array(ACTION))
    return state, reward + sum(term.sum() for term in observation.values())


def program(one: Callable[..., Any]) -> Callable[..., Any]:
    """``STEPS`` steps of all scenarios."""

    def run(floors: Stack, states: Any) -> tuple[Any, jax.Array]:
        def turn(states: Any, _: None) -> tuple[Any, jax.Array]:
            states, shown = floors.vmap(one)(states)
            return states, shown.sum()

        return jax.lax.scan(turn, states, length=STEPS)

    return jax.jit(run, donate_argnums=1)


def rate(compiled: Any, floors: Stack, states: Any, batch: int) -> float:
    """Scenario-steps per second, the best of some calls."""
    best = 0.0
    for _ in range(REPEATS):
        start = time.perf_counter()
        states, _ = jax.block_until_ready(compiled(floors, states))
        best = max(best, batch * STEPS / (time.perf_counter() - start))
    return best


def size(floors: Stack) -> float:
    """Bytes for each floor: of what is its own, and its share of what all have."""
    own = {id(each): each for place, each in enumerate(jax.tree.leaves(floors.member)) if place not in floors.own}
    own |= {id(each): each for each in floors.own.values()}
    return sum(np.asarray(each).nbytes for each in own.values()) / floors.size


def main() -> None:
    """Print a line for each batch."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("floors", help="a set of floors, such as worlds:all:128")
    parser.add_argument("--batches", type=int, nargs="+", default=[65536])
    parser.add_argument(
        "--observe", choices=["none", *OBSERVATIONS], default="none", help="an image has 64 x 48 pixels"
    )
    options = parser.parse_args()
    words = {"environment": options.floors, "task": "random_ab_nav", "metrics": "none"}
    config = validate(EnvConfig, {**words, "observations": OBSERVATIONS.get(options.observe, ("goal",))})
    begun = time.perf_counter()
    if options.observe == "none":
        floors, start, one = making.build(making.plan_scenario(config))[0], reset, moved
    else:
        floors, start, one = registry.build(config), lambda env, key: env.reset(key)[1], observed
    text = f"{floors.size} floors in {time.perf_counter() - begun:.0f} s, {size(floors) / 1e6:.2f} MB each"
    print(f"{jax.devices()[0].device_kind}, {text}, observations: {options.observe}", flush=True)
    host, device = jax.devices("cpu")[0], jax.devices()[0]
    with jax.default_device(host):  # a reset compiles faster there
        draw = jax.jit(lambda floors, keys: floors.over_members(start)(keys))
        starts = draw(jax.device_put(floors, host), jax.random.split(jax.random.key(0), floors.size))
    floors, starts = jax.device_put((floors, starts), device)
    for batch in options.batches:
        states = jax.tree.map(lambda leaf: jnp.repeat(leaf, batch // floors.size, axis=0), starts)  # noqa: B023
        together = rate(program(one).lower(floors, states).compile(), floors, states, batch)
        alone, compiled = [], None
        for index in np.linspace(0, floors.size - 1, FLOORS).astype(int):
            floor = Stack(jax.tree.map(jnp.asarray, floors.at(int(index))), {})
            states = jax.tree.map(lambda leaf: jnp.repeat(leaf[index][None], batch, axis=0), starts)  # noqa: B023
            compiled = compiled or program(one).lower(floor, states).compile()
            alone.append(rate(compiled, floor, states, batch))
        mean = FLOORS / sum(1.0 / each for each in alone)
        print(f"{batch}: {together:.4g} steps/s, alone {mean:.4g}, ratio {together / mean:.3f}", flush=True)


if __name__ == "__main__":
    main()
