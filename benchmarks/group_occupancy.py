"""Occupancy of the groups of the Behavior Graph, and stays of people.

python benchmarks/group_occupancy.py
python benchmarks/group_occupancy.py --environment warehouse --people 20 62 100 --routing edge

For people without a robot, over episodes of five minutes without the first 20 s: the members of each group over its
capacity, the shares of the time in which it is full and empty, its capacity in the first 20 s, and the stays that began
and ended: number per minute, mean, shortest and longest, and the shortest and longest possible draw.
"""

import argparse

import jax
import numpy as np

import sean_jax
from sean_jax.config import GraphBehavior
from sean_jax.simulation import scenario as stages
from sean_jax.studies.validation.groups import group_occupancy

WARM_UP = 20.0  # s


def simulate(scenario, episodes: int, steps: int) -> np.ndarray:
    """(B, T, N) group of each person."""

    def step(state, _):
        after = stages.direct_pedestrians(scenario, state, jax.random.fold_in(state.streams.people, state.tick))
        after = stages.move_pedestrians(scenario, after).replace(tick=state.tick + 1)
        return after, after.pedestrians.group

    run = jax.jit(jax.vmap(lambda key: jax.lax.scan(step, sean_jax.reset(scenario, key), length=steps)[1]))
    return np.asarray(run(jax.random.split(jax.random.key(0), episodes)))


def main() -> None:
    """Print the table."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--environment", nargs="+", default=["lab", "outdoor", "warehouse"])
    arguments.add_argument("--people", nargs="+", type=int, default=[None])
    arguments.add_argument("--routing", choices=("whole", "edge"), default="whole")
    arguments.add_argument("--group-membership", choices=("turnover", "permanent"), default="turnover")
    arguments.add_argument("--forces", default=None)
    arguments.add_argument("--episodes", type=int, default=16)
    arguments.add_argument("--steps", type=int, default=3000)
    options = arguments.parse_args()
    print(
        "environment people group           mean  full empty | 20 s: mean  full | stays/min  mean  least  most  drawn"
    )
    for name in options.environment:
        for people in options.people:
            scenario = sean_jax.make(
                name,
                behavior=GraphBehavior(routing=options.routing, group_membership=options.group_membership),
                people=people,
                task="random_ab_nav",
                **({} if options.forces is None else {"forces": options.forces}),
            )
            graph = jax.tree.map(np.asarray, scenario.behavior.data.graph)
            group = simulate(scenario, options.episodes, options.steps)
            capacity, begun = graph.capacity[graph.groups], round(WARM_UP / scenario.time_step)
            found = group_occupancy(group, capacity, scenario.time_step, WARM_UP)
            first = group_occupancy(group[:, :begun], capacity, scenario.time_step, 0.0)
            minutes = options.episodes * (options.steps - begun) * scenario.time_step / 60
            for g, node in enumerate(graph.groups):
                stays = found.stays[g] if len(found.stays[g]) else np.full(1, np.nan)
                shares = f"{found.mean[g]:5.2f} {found.full[g]:5.2f} {found.empty[g]:5.2f} | {first.mean[g]:11.2f}"
                lasted = f"{stays.mean():5.1f} {stays.min():6.1f} {stays.max():5.1f}"
                drawn = f"{graph.stay[node, 0]:g} to {graph.stay[node, 1]:g}"
                row = f"{name:11s} {scenario.people:6d} {graph.names[node]:14s} {shares} {first.full[g]:5.2f}"
                print(f"{row} | {len(found.stays[g]) / minutes:9.1f} {lasted}  {drawn}", flush=True)


if __name__ == "__main__":
    main()
