"""Speed of a control step and of its stages, in scenario-steps per second.

python benchmarks/step.py --batches 64 256                  on a CPU
python benchmarks/step.py --batches 1024 8192 32768         on a GPU
python benchmarks/step.py --dynamics twin --routing trips whole edge --only direct_pedestrians step
"""

import itertools
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from options import Option, parse
from timing import compiled, device, median, temporary

import sean_jax
from sean_jax.core.data_types import State
from sean_jax.policies import go_to_goal
from sean_jax.simulation import scenario as stages


def parts(scenario) -> dict:
    """name -> (state -> state): each stage of the step, the whole step, and the step with the policy."""
    command = jnp.asarray([0.4, 0.3], jnp.float32)

    def people_key(state):
        return jax.random.fold_in(state.streams.people, state.tick)

    def step_with_policy(state):
        return stages.step(scenario, state, go_to_goal(scenario, state, state.streams.policy))

    def step_without_metrics(state):
        after = stages.step(replace(scenario, metrics=()), replace(state, metrics={}), command)
        return replace(after, metrics=state.metrics)

    def policy(state):
        action = go_to_goal(scenario, state, state.streams.policy)
        return replace(state, robot=replace(state.robot, speed=state.robot.speed + 1e-6 * action[0]))

    def classify(state):
        state = stages.classify(scenario, state)
        position = state.robot.position + 1e-6 * state.situations.astype(jnp.float32).sum()
        return replace(state, robot=replace(state.robot, position=position))

    def measure(state):
        robot = replace(state.robot, position=state.robot.position + 1e-4)
        after = replace(state, tick=state.tick + 1, robot=robot)
        return stages.measure(scenario, state, after)

    return {
        "direct_pedestrians": lambda s: replace(stages.direct_pedestrians(scenario, s, people_key(s)), tick=s.tick + 1),
        "move_pedestrians": lambda s: stages.move_pedestrians(scenario, s),
        "move_robot": lambda s: stages.move_robot(scenario, s, command),
        "classify": classify,
        "measure": measure,
        "step": lambda s: stages.step(scenario, s, command),
        "step, metrics none": step_without_metrics,
        "policy go_to_goal": policy,
        "step + policy": step_with_policy,
    }


def repeated(part: Callable[[State], State], steps: int, states: State) -> State:
    """So many steps of a part, in all scenarios."""
    return jax.lax.scan(lambda states, _: (jax.vmap(part)(states), None), states, length=steps)[0]


def main() -> None:
    """Print the table."""
    chosen = parse(
        __doc__,
        batches=[64],
        people=62,
        dynamics=["twin", "mjx"],
        routing=["trips"],
        forces="calibrated",
        only=Option([], "names of parts"),
    )
    print(f"{device()}, {chosen.people} people, {chosen.forces}")
    heads = f"{'robot':>5} {'routing':>7} {'B':>6} {'part':>20}"
    print(f"{heads} {'us/step':>10} {'steps/s':>12} {'compile s':>9} {'temp MiB':>9}")
    for dynamics, routing in itertools.product(chosen.dynamics, chosen.routing):
        scenario = sean_jax.make(
            "warehouse", people=chosen.people, dynamics=dynamics, forces=chosen.forces, routing=routing
        )
        for batch in chosen.batches:
            keys = jax.random.split(jax.random.key(0), batch)
            states = jax.jit(jax.vmap(lambda key: sean_jax.reset(scenario, key)))(keys)  # noqa: B023
            for name, part in parts(scenario).items():
                if chosen.only and name not in chosen.only:
                    continue
                steps = int(np.clip(4e5 / batch, 4, 200))
                run, compiling = compiled(partial(repeated, part, steps), states)
                seconds = median(partial(run, states), 5) / steps
                print(
                    f"{dynamics:>5} {routing:>7} {batch:6d} {name:>20} {1e6 * seconds:10.1f} {batch / seconds:12.0f} "
                    f"{compiling:9.1f} {temporary(run):9.1f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
