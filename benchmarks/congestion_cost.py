"""Effect of ``congestion_cost`` on congestion on the Behavior Graph, and its cost in time.

python benchmarks/congestion_cost.py
python benchmarks/congestion_cost.py --people 120 --routing edge

For people without a robot, over episodes of five minutes: the people per m2 on the fullest edge (mean over time), the
maximum density of walkers in a minute in cells of 0.25 m2 (mean over minutes), walks along edges per minute, people in
groups, walkers' speed, and the time that one step of one episode takes.
"""

import jax
import jax.numpy as jnp
import numpy as np
from options import Option, parse
from timing import stopwatch

import sean_jax
from sean_jax.graph.behavior_graph import edge_densities
from sean_jax.simulation import scenario as stages


def measure(scenario, key, steps: int) -> tuple:
    """The five figures of an episode."""
    graph = scenario.behavior.data.graph

    def step(state, _):
        after = stages.direct_pedestrians(scenario, state, jax.random.fold_in(state.streams.people, state.tick))
        after = stages.move_pedestrians(scenario, after).replace(tick=state.tick + 1)
        memory, people = after.memory, after.pedestrians
        walking = memory.stay == 0
        fullest = edge_densities(graph, memory.origin, memory.hop, walking).max()
        speed = jnp.linalg.norm(people.velocity, axis=-1).mean(where=walking)
        return after, (stages.frame(state, after, jnp.zeros(2)), fullest, (~walking).sum(), speed)

    frames, fullest, seated, speed = jax.lax.scan(step, sean_jax.reset(scenario, key), length=steps)[1]
    walkers = frames.replace(present=frames.present & (frames.group < 0))
    of_walkers = sean_jax.congestion(scenario, walkers, span=60.0)
    flow = sean_jax.congestion(scenario, frames, span=60.0).flow
    return fullest.mean(), of_walkers.density.max((1, 2)).mean(), flow.sum((1, 2)).mean(), seated.mean(), speed.mean()


def main() -> None:
    """Print the table."""
    options = parse(
        __doc__,
        environment="warehouse",
        people=Option(None, kind=int),
        routing="whole",
        congestion_cost=[0.0, 5.0, 20.0, 100.0],
        episodes=8,
        steps=3000,
    )
    print("congestion_cost  fullest edge /m2  densest cell /m2  walks/min  in groups  speed m/s  us/step")
    for cost in options.congestion_cost:
        scenario = sean_jax.make(
            options.environment,
            people=options.people,
            routing=options.routing,
            congestion_cost=cost,
        )
        keys = jax.random.split(jax.random.key(0), options.episodes)
        run = jax.jit(jax.vmap(lambda key, scenario=scenario: measure(scenario, key, options.steps)))
        run = run.lower(keys).compile()
        with stopwatch() as watch:
            figures = jax.block_until_ready(run(keys))
        fullest, densest, walks, seated, speed = (float(np.mean(figure)) for figure in figures)
        step = 1e6 * watch.seconds / options.steps / options.episodes
        print(f"{cost:15g}  {fullest:16.3f}  {densest:16.2f}  {walks:9.1f}  {seated:9.1f}  {speed:9.3f}  {step:7.1f}")


if __name__ == "__main__":
    main()
