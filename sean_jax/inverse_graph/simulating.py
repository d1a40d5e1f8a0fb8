"""People of a scenario by themselves, as long as one likes: no robot is near, and nothing but their places is kept."""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from sean_jax import prng
from sean_jax import scenario as stages
from sean_jax.base import Array, Scenario, State

FAR = 1e3  # m, at which the robot stands


def people_alone(
    scenario: Scenario, key: Array, steps: int, every: int = 1
) -> tuple[Float[Array, "T N 2"], Bool[Array, "T N"]]:
    """Where people are, in an episode in which nobody but people moves.

    Args:
        scenario: N people.
        key: of the episode.
        steps: of control.
        every: how many of them pass from one row to the next.

    Returns:
        Positions (T, N, 2) m, and who is present (T, N), in ``steps / every`` rows.
    """

    def one(state: State, _: None) -> tuple[State, None]:
        state = stages.direct_pedestrians(scenario, state, jax.random.fold_in(state.streams.people, state.tick))
        return replace(stages.move_pedestrians(scenario, state), tick=state.tick + 1), None

    def row(state: State, _: None):
        state = jax.lax.scan(one, state, length=every)[0]
        return state, (state.pedestrians.position, state.pedestrians.present)

    return jax.lax.scan(row, begin_alone(scenario, key), length=steps // every)[1]


def begin_alone(scenario: Scenario, key: Array) -> State:
    """A state with people at their starts and the robot far away, without a task, which would take long to compile.

    Args:
        scenario: N people.
        key: of the episode.

    Returns:
        The state.
    """
    blank = jax.eval_shape(lambda key: stages.reset(scenario, key), key)
    state = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), blank.replace(streams=None))
    pedestrians, groups, memory = scenario.behavior.reset(scenario, key)
    robot = state.robot.replace(position=jnp.full(2, FAR), heading=jnp.asarray([1.0, 0.0]))
    return state.replace(streams=prng.streams(key), pedestrians=pedestrians, groups=groups, memory=memory, robot=robot)
