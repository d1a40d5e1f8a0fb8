"""How much ``spreading`` lowers congestion on the Behavior Graph, and what it costs.

python benchmarks/spreading.py
python benchmarks/spreading.py --people 120 --paths edge

Of people alone, over some episodes of five minutes: the people per m2 on the fullest edge (mean over time), the
densest cell of 0.25 m2 by walkers in a minute (mean over minutes), walks along edges a minute, people in groups,
walkers' speed, and the time that one step of one episode takes.
"""

import argparse
import time

import jax
import jax.numpy as jnp
import numpy as np

import sean_jax
from sean_jax import scenario as stages
from sean_jax.graph.spreading import crowds


def measured(scenario, key, steps: int) -> tuple:
    """The five figures of an episode."""
    graph = scenario.behavior.data.graph

    def one(state, _):
        after = stages.direct_pedestrians(scenario, state, jax.random.fold_in(state.streams.people, state.tick))
        after = stages.move_pedestrians(scenario, after).replace(tick=state.tick + 1)
        memory, people = after.memory, after.pedestrians
        walking = memory.stay == 0
        fullest = crowds(graph, memory.origin, memory.hop, walking).max()
        speed = jnp.linalg.norm(people.velocity, axis=-1).mean(where=walking)
        return after, (stages.frame(state, after, jnp.zeros(2)), fullest, (~walking).sum(), speed)

    frames, fullest, seated, speed = jax.lax.scan(one, sean_jax.reset(scenario, key), length=steps)[1]
    walkers = frames.replace(present=frames.present & (frames.group < 0))
    walked = sean_jax.congestion(scenario, walkers, span=60.0)
    flow = sean_jax.congestion(scenario, frames, span=60.0).flow
    return fullest.mean(), walked.density.max((1, 2)).mean(), flow.sum((1, 2)).mean(), seated.mean(), speed.mean()


def main() -> None:
    """Print the table."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--environment", default="warehouse")
    arguments.add_argument("--people", type=int)
    arguments.add_argument("--paths", default="whole")
    arguments.add_argument("--spreading", nargs="+", type=float, default=[0.0, 5.0, 20.0, 100.0])
    arguments.add_argument("--episodes", type=int, default=8)
    arguments.add_argument("--steps", type=int, default=3000)
    given = arguments.parse_args()
    print("spreading  fullest edge /m2  densest cell /m2  walks/min  in groups  speed m/s  us/step")
    for spreading in given.spreading:
        scenario = sean_jax.make(
            given.environment, people=given.people, paths=given.paths, spreading=spreading, dynamics="twin"
        )
        keys = jax.random.split(jax.random.key(0), given.episodes)
        run = jax.jit(jax.vmap(lambda key, scenario=scenario: measured(scenario, key, given.steps)))
        run = run.lower(keys).compile()
        began = time.perf_counter()
        fullest, densest, walks, seated, speed = (float(np.mean(part)) for part in jax.block_until_ready(run(keys)))
        each = 1e6 * (time.perf_counter() - began) / given.steps / given.episodes
        print(
            f"{spreading:9g}  {fullest:16.3f}  {densest:16.2f}  {walks:9.1f}  {seated:9.1f}  {speed:9.3f}  {each:7.1f}"
        )


if __name__ == "__main__":
    main()
