"""Cost of a gradient of final positions by force constants: time relative to the forward run, and memory.

python benchmarks/gradients.py --batch 16 --steps 16                on a CPU
python benchmarks/gradients.py --batch 4096 --steps 64              on a GPU
python benchmarks/gradients.py --batch 64 --steps 1000 --only "step in blocks"
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from options import Option, parse
from timing import compiled, device, least, temporary

import sean_jax
from sean_jax.simulation import scenario as stages

COMMAND = (0.3, 0.1)  # m/s and rad/s


def parts(chosen: argparse.Namespace) -> dict[str, Callable]:
    """name -> (scenario, state) -> last state after the steps: the whole and each stage separately."""
    command = jnp.asarray(COMMAND, float)

    def scan(stage: Callable) -> Callable:
        return lambda scenario, state: jax.lax.scan(
            lambda state, _: (replace(stage(scenario, state), tick=state.tick + 1), None), state, length=chosen.steps
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


def main() -> None:
    """Print the table."""
    chosen = parse(
        __doc__,
        batch=16,
        steps=16,
        people=62,
        forces="calibrated",
        dynamics="twin",
        checkpoint_every=8,
        only=Option([], "names of parts"),
    )
    scenario = sean_jax.make(
        "warehouse", behavior="graph", people=chosen.people, dynamics=chosen.dynamics, forces=chosen.forces
    )
    keys = jax.random.split(jax.random.key(0), chosen.batch)
    states = jax.jit(jax.vmap(lambda key: sean_jax.reset(scenario, key)))(keys)
    print(f"{device()}: {chosen}")
    print(f"{'part':>15} {'forward s':>10} {'reverse s':>10} {'times':>6} {'MiB':>9} {'kB/step':>9} {'compile s':>9}")
    for name, part in parts(chosen).items():
        if chosen.only and name not in chosen.only:
            continue

        def total(forces: Any, states: Any, part: Callable = part) -> Any:
            last = jax.vmap(part, (None, 0))(scenario.replace(forces=forces), states)
            return last.pedestrians.position.sum() + last.robot.position.sum()

        forward, _ = compiled(total, scenario.forces, states)
        reverse, compiling = compiled(jax.value_and_grad(total), scenario.forces, states)
        one_way = least(partial(forward, scenario.forces, states))
        both_ways = least(partial(reverse, scenario.forces, states))
        seconds = f"{one_way:10.4f} {both_ways:10.4f} {both_ways / one_way:6.1f}"

        memory = temporary(reverse)
        per_step = memory * 2**20 / chosen.batch / chosen.steps / 1e3
        print(f"{name:>15} {seconds} {memory:9.1f} {per_step:9.1f} {compiling:9.1f}", flush=True)


if __name__ == "__main__":
    main()
