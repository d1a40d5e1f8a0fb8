"""All policies over the same episodes: tasks completed, collisions, social distances, comfort, and steps per second.

    python benchmarks/policies.py             # 62 people in the warehouse: the graph, at random, handcrafted
    python benchmarks/policies.py --quick     # a few short episodes on the graph

Every policy has the same starts, tasks and people (same keys). Counts are means over episodes, each until its end.
`fault` is the robot's by SEAN's rule (it moved towards the person), else the person's. `social_costmap 0.5` is
social_costmap at the robot's own top speed of 0.5 m/s in place of SEAN's 0.3. Steps are whole steps of the simulation
with the policy; the first row of each table is a standing robot.
"""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from options import Option, parse
from timing import compiled, device, stopwatch

import sean_jax
from sean_jax.policies import POLICIES, social_costmap
from sean_jax.policies.ros_move_base import default_params
from sean_jax.simulation.episodes import init_policy, simulate

CONDITIONS: dict[str, dict[str, Any]] = {
    "graph, join_group": {"behavior": "graph", "task": "join_group"},
    "graph, leave_group": {"behavior": "graph", "task": "leave_group"},
    "random, random_ab_nav": {"behavior": "random", "task": "random_ab_nav"},
    "handcrafted": {"behavior": "handcrafted", "task": "handcrafted", "sets": "staged"},
}
COLUMNS = {
    "collision_robot_on_person": "touch: fault",
    "collision_person_on_robot": "person's",
    "collision_with_obstacle": "obstacle",
    "intimate_robot_on_person": "0.45m: fault",
    "intimate_person_on_robot": "person's",
    "personal_robot_on_person": "1.2m: fault",
    "personal_person_on_robot": "person's",
    "time_not_moving": "still s",
    "path_irregularity": "irreg. rad",
    "path_efficiency": "path/geod.",
}


def stand(scenario, state, key):
    """The robot stands."""
    return jnp.zeros(2, jnp.float32)


def measure(scenario, policy, episodes: int, seconds: float, seed: int) -> tuple[dict[str, np.ndarray], dict]:
    """(E,) figures of the episodes by name, and the costs in time."""
    steps = round(seconds / scenario.time_step)
    keys = jax.random.split(jax.random.key(seed), episodes)
    draw = jax.jit(jax.vmap(lambda key: init_policy(scenario, policy, sean_jax.reset(scenario, key))))
    states = draw(keys)

    def episode(state):
        last, frames = simulate(scenario, policy, state, steps, lambda before, after, action: after.completed)
        completed: Any = frames
        return sean_jax.results(scenario, last), last.completed, steps - completed.sum(dtype=jnp.int32)

    run, compiling = compiled(jax.vmap(episode), states)
    with stopwatch() as watch:
        results, completed, duration = jax.block_until_ready(run(states))
    figures = {name: np.asarray(results[name]).reshape(episodes, -1)[:, 0] for name in COLUMNS}
    figures |= {"completed": np.asarray(completed, float), "seconds": np.asarray(duration) * scenario.time_step}
    return figures, {"compile": compiling, "steps_per_second": episodes * steps / watch.seconds}


def show(name: str, figures: dict[str, np.ndarray], cost: dict) -> None:
    """Print one row."""
    done = figures["completed"] > 0.0
    duration = f"{figures['seconds'][done].mean():8.1f}" if done.any() else f"{'-':>8}"
    cells = " ".join(f"{figures[column].mean():{len(head)}.2f}" for column, head in COLUMNS.items())
    print(f"{name:>18} {100 * done.mean():6.1f} {duration} {cells} {cost['compile']:9.1f} "
          f"{cost['steps_per_second']:8.0f}", flush=True)  # fmt: skip


def main() -> None:
    """Print the tables."""
    chosen = parse(
        __doc__,
        episodes=64,
        seconds=120.0,
        seed=0,
        environment="warehouse",
        robot="kuri",
        dynamics="twin",
        conditions=Option(list(CONDITIONS), choices=list(CONDITIONS)),
        policies=Option([], choices=["stand", *POLICIES, "social_costmap 0.5"]),
        quick=Option(False, "8 episodes of 40 s on the graph"),
    )
    if chosen.quick:
        chosen.episodes, chosen.seconds, chosen.conditions = 8, 40.0, ["graph, join_group"]
    faster = replace(social_costmap, params=default_params(top_speed=1.0))
    policies = {"stand": stand, **POLICIES, "social_costmap 0.5": faster}
    print(f"{device()}, {chosen.environment}, {chosen.robot}, "
          f"{chosen.episodes} episodes of {chosen.seconds:g} s, seed {chosen.seed}")  # fmt: skip
    for condition in chosen.conditions:
        scenario = sean_jax.make(
            chosen.environment, robot=chosen.robot, dynamics=chosen.dynamics, **CONDITIONS[condition]
        )
        print(f"\n{condition}, {scenario.people} people at most")
        heads = " ".join(COLUMNS.values())
        print(f"{'policy':>18} {'done %':>6} {'after s':>8} {heads} {'compile s':>9} {'steps/s':>8}")
        for name, policy in policies.items():
            if chosen.policies and name not in chosen.policies:
                continue
            show(name, *measure(scenario, policy, chosen.episodes, chosen.seconds, chosen.seed))


if __name__ == "__main__":
    main()
