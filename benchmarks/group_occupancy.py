"""Occupancy of the groups of the Behavior Graph, and stays of people.

python benchmarks/group_occupancy.py
python benchmarks/group_occupancy.py --environment warehouse --people 20 62 100 --routing edge

For people without a robot, over episodes of five minutes without the first 20 s: the members of each group over its
capacity, the shares of the time in which it is full and empty, its capacity in the first 20 s, and the stays that began
and ended: number per minute, mean, shortest and longest, and the shortest and longest possible draw.
"""

import jax
import numpy as np
from options import Option, parse

import sean_jax
from sean_jax.config import GraphBehavior
from sean_jax.studies.scenes.simulation import advance
from sean_jax.studies.validation.groups import group_occupancy

WARM_UP = 20.0  # s


def simulate(scenario, episodes: int, steps: int) -> np.ndarray:
    """(B, T, N) group of each person."""

    def step(state, _):
        after = advance(scenario, state)
        return after, after.pedestrians.group

    run = jax.jit(jax.vmap(lambda key: jax.lax.scan(step, sean_jax.reset(scenario, key), length=steps)[1]))
    return np.asarray(run(jax.random.split(jax.random.key(0), episodes)))


def main() -> None:
    """Print the table."""
    options = parse(
        __doc__,
        environment=["lab", "outdoor", "warehouse"],
        people=Option([None], kind=int),
        routing=Option("whole", choices=("whole", "edge")),
        group_membership=Option("turnover", choices=("turnover", "permanent")),
        forces=None,
        episodes=16,
        steps=3000,
    )
    print(
        "environment people group           mean  full empty | 20 s: mean  full | stays/min  mean  least  most  drawn"
    )
    behavior = GraphBehavior(routing=options.routing, group_membership=options.group_membership)
    forces = {} if options.forces is None else {"forces": options.forces}
    for name in options.environment:
        for people in options.people:
            scenario = sean_jax.make(name, behavior=behavior, people=people, task="random_ab_nav", **forces)
            show(name, scenario, simulate(scenario, options.episodes, options.steps))


def show(name: str, scenario: sean_jax.Scenario, group: np.ndarray) -> None:
    """Print a row for each group, by the group (B, T, N) of each person."""
    graph = jax.tree.map(np.asarray, scenario.behavior.data.graph)
    capacity, warm_up = graph.capacity[graph.groups], round(WARM_UP / scenario.time_step)
    occupied = group_occupancy(group, capacity, scenario.time_step, WARM_UP)
    first = group_occupancy(group[:, :warm_up], capacity, scenario.time_step, 0.0)
    minutes = len(group) * (group.shape[1] - warm_up) * scenario.time_step / 60
    for k, node in enumerate(graph.groups):
        stays = occupied.stays[k] if len(occupied.stays[k]) else np.full(1, np.nan)
        number = len(occupied.stays[k]) / minutes
        shares = f"{occupied.mean[k]:5.2f} {occupied.full[k]:5.2f} {occupied.empty[k]:5.2f}"
        first_shares = f"{first.mean[k]:11.2f} {first.full[k]:5.2f}"
        lengths = f"{stays.mean():5.1f} {stays.min():6.1f} {stays.max():5.1f}"
        drawn = f"{graph.stay[node, 0]:g} to {graph.stay[node, 1]:g}"
        row = f"{name:11s} {scenario.people:6d} {graph.names[node]:14s} {shares} | {first_shares}"
        print(f"{row} | {number:9.1f} {lengths}  {drawn}", flush=True)


if __name__ == "__main__":
    main()
