"""Cost of a gradient of final positions by force constants: time relative to the forward run, and memory.

python benchmarks/gradients.py --batch 16 --steps 16                on a CPU
python benchmarks/gradients.py --batch 4096 --steps 64              on a GPU
python benchmarks/gradients.py --batch 64 --steps 1000 --only "step in blocks"
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp

import sean_jax
from sean_jax.simulation import scenario as stages

COMMAND = (0.3, 0.1)  # m/s and rad/s


def parts(chosen: argparse.Namespace) -> dict[str, Callable]:
    """name -> (scenario, state) -> last state after the steps: the whole and each stage separately."""
    command = jnp.asarray(COMMAND, float)

    def scan(one: Callable) -> Callable:
        return lambda scenario, state: jax.lax.scan(
            lambda state, _: (replace(one(scenario, state), tick=state.tick + 1), None), state, length=chosen.steps
        )[0]

    def episode(**options: Any) -> Callable:
        def policy(scenario: Any, state: Any, key: Any) -> Any:
            return command

        return lambda scenario, state: sean_jax.simulate(
            scenario, policy, state, chosen.steps, lambda *_: (), **options
        )[0]

    def direct(scenario: Any, state: Any) -> Any:
        key = jax.random.fold_in(state.streams.people, state.tick)
        people = stages.direct_pedestrians(scenario, state, key).pedestrians
        rate = scenario.time_step / scenario.forces.walking.relaxation_time
        return replace(state, pedestrians=replace(people, position=people.position + rate * people.desired_velocity))

    def robot(scenario: Any, state: Any) -> Any:
        shift = scenario.forces.walking.relaxation_time * 1e-3
        people = replace(state.pedestrians, position=state.pedestrians.position + shift)
        return stages.move_robot(scenario, replace(state, pedestrians=people), command)

    return {
        "step": episode(),
        "step again": episode(checkpoint_every=1),
        "step in blocks": episode(checkpoint_every=chosen.checkpoint_every),
        "move people": scan(stages.move_pedestrians),
        "direct people": scan(direct),
        "move robot": scan(robot),
    }


def compiled(function: Callable, *arguments: Any) -> tuple[Any, float]:
    """The compiled function and the compile time [s]."""
    start = time.perf_counter()
    return jax.jit(function).lower(*arguments).compile(), time.perf_counter() - start


def seconds(function: Any, *arguments: Any, times: int = 3) -> float:
    """The shortest time of a call."""
    jax.block_until_ready(function(*arguments))
    best = float("inf")
    for _ in range(times):
        start = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        best = min(best, time.perf_counter() - start)
    return best


def main() -> None:
    """Print the table."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--batch", type=int, default=16)
    arguments.add_argument("--steps", type=int, default=16)
    arguments.add_argument("--people", type=int, default=62)
    arguments.add_argument("--forces", default="calibrated")
    arguments.add_argument("--dynamics", default="twin")
    arguments.add_argument("--checkpoint-every", type=int, default=8)
    arguments.add_argument("--only", nargs="+", default=None, help="names of parts")
    chosen = arguments.parse_args()
    scenario = sean_jax.make(
        "warehouse", behavior="graph", people=chosen.people, dynamics=chosen.dynamics, forces=chosen.forces
    )
    keys = jax.random.split(jax.random.key(0), chosen.batch)
    states = jax.jit(jax.vmap(lambda key: sean_jax.reset(scenario, key)))(keys)
    print(f"{jax.devices()[0].device_kind}, jax {jax.__version__}: {chosen}")
    print(f"{'part':>15} {'forward s':>10} {'reverse s':>10} {'times':>6} {'MiB':>9} {'kB/step':>9} {'compile s':>9}")
    for name, part in parts(chosen).items():
        if chosen.only and name not in chosen.only:
            continue

        def total(forces: Any, states: Any, part: Callable = part) -> Any:
            last = jax.vmap(part, (None, 0))(scenario.replace(forces=forces), states)
            return last.pedestrians.position.sum() + last.robot.position.sum()

        forward, _ = compiled(total, scenario.forces, states)
        reverse, took = compiled(jax.value_and_grad(total), scenario.forces, states)
        times = seconds(forward, scenario.forces, states), seconds(reverse, scenario.forces, states)
        memory = reverse.memory_analysis().temp_size_in_bytes
        each = memory / chosen.batch / chosen.steps / 1e3
        ratio = times[1] / times[0]
        print(
            f"{name:>15} {times[0]:10.4f} {times[1]:10.4f} {ratio:6.1f} {memory / 2**20:9.1f} {each:9.1f} {took:9.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
