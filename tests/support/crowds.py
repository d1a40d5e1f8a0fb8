"""People of a scenario alone: they choose and walk, and the robot is far away, without a task that takes to compile."""

import jax

from sean_jax.simulation import scenario as stages
from sean_jax.studies.inverse_graph.measuring import begin_alone


def people_step(scenario, state):
    """The state after a control step of people."""
    state = stages.direct_pedestrians(scenario, state, jax.random.fold_in(state.streams.people, state.tick))
    return stages.move_pedestrians(scenario, state).replace(tick=state.tick + 1)


def walk(scenario, start, steps: int, record=lambda before, after: (after.pedestrians, after.memory)):
    """What is recorded of each of so many steps, from a state or from the beginning of an episode of that key."""

    def one(state, _):
        after = people_step(scenario, state)
        return after, record(state, after)

    is_key = isinstance(start, jax.Array)
    return jax.lax.scan(one, begin_alone(scenario, start) if is_key else start, length=steps)[1]
