"""People of a scenario by themselves, as long as one likes: no robot is near, and nothing but their places is kept.

On a Behavior Graph it is also counted how they were called to groups, which nobody sees from where they are.
"""

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Bool, Float, PyTree

from sean_jax import prng
from sean_jax import scenario as stages
from sean_jax.base import Array, Scenario, State
from sean_jax.behaviors.graph_choices import Memory
from sean_jax.graph import BehaviorGraph

FAR = 1e3  # m, at which the robot stands


@struct.dataclass
class Calls:
    """How often people at each of M nodes were called to each of G groups. Two of them add up to that of both."""

    asked: Float[Array, "M"]  # people who went on from there and were not on the way to a group
    sent: Float[Array, "M G"]  # those of them who were sent to a group
    kept: Float[Array, "M G"]  # people who went on from there to the group to which they were on the way
    replaced: Float[Array, "M G"]  # people on the way there in whose place somebody else is sent

    def __add__(self, other: "Calls") -> "Calls":
        return jax.tree.map(jnp.add, self, other)

    @property
    def chance_sent(self) -> Float[Array, "M G"]:
        """(M, G) with what chance somebody at a node is sent to a group."""
        return self.sent / jnp.maximum(self.asked, 1.0)[:, None]

    @property
    def chance_replaced(self) -> Float[Array, "M G"]:
        """(M, G) with what chance somebody who comes to a node on the way to a group is not wanted there any more."""
        return self.replaced / jnp.maximum(self.kept + self.replaced, 1.0)


def people_alone(
    scenario: Scenario, key: Array, steps: int, every: int = 1
) -> tuple[Float[Array, "T N 2"], Bool[Array, "T N"]]:
    """Where people are, in an episode in which nobody but people moves.

    Args:
        every: how many of them pass from one row to the next.

    Returns:
        Positions (T, N, 2) m, and who is present (T, N), in ``steps / every`` rows.
    """

    position, present, _ = _simulate(scenario, key, steps, every, lambda before, after: None)
    return position, present


def people_called(
    scenario: Scenario, graph: BehaviorGraph, key: Array, steps: int, every: int = 1
) -> tuple[Float[Array, "T N 2"], Bool[Array, "T N"], Calls]:
    """As ``people_alone``, and how people were called to groups.

    Args:
        every: how many of them pass from one row to the next.

    Returns:
        Positions (T, N, 2) m, who is present (T, N), in ``steps / every`` rows, and the calls in all steps.
    """
    count, groups = graph.radius.shape[0], graph.groups.shape[0]
    group_of = jnp.full(count, groups).at[graph.groups].set(jnp.arange(groups))  # of a node; G is none

    def calls(before: Memory, after: Memory) -> Calls:
        onward = after.hop != before.hop
        target = jnp.where(before.stay > 0, groups, group_of[before.goal])
        heads, same = target < groups, after.goal == before.goal

        def counted(who: Bool[Array, "N"], group: Array) -> Array:
            return jnp.zeros((count, groups + 1)).at[before.hop, group].add(who.astype(float))

        return Calls(
            asked=counted(onward & ~heads, target)[:, groups],
            sent=counted(onward & ~heads, group_of[after.goal])[:, :groups],
            kept=counted(onward & heads & same, target)[:, :groups],
            replaced=counted(heads & ~same, target)[:, :groups],
        )

    position, present, counted = _simulate(scenario, key, steps, every, calls)
    return position, present, jax.tree.map(lambda part: part.sum((0, 1)), counted)


def _simulate(
    scenario: Scenario, key: Array, steps: int, every: int, look: Callable
) -> tuple[Float[Array, "T N 2"], Bool[Array, "T N"], PyTree]:
    """Positions and who is present in rows, and ``look(memory before, memory after)`` of all steps, by row."""

    def one(state: State, _: None) -> tuple[State, PyTree]:
        before = state.memory
        state = stages.direct_pedestrians(scenario, state, jax.random.fold_in(state.streams.people, state.tick))
        seen = look(before, state.memory)
        return replace(stages.move_pedestrians(scenario, state), tick=state.tick + 1), seen

    def row(state: State, _: None) -> tuple[State, tuple]:
        state, seen = jax.lax.scan(one, state, length=every)
        return state, (state.pedestrians.position, state.pedestrians.present, seen)

    return jax.lax.scan(row, begin_alone(scenario, key), length=steps // every)[1]


def begin_alone(scenario: Scenario, key: Array) -> State:
    """A state with people at their starts and the robot far away, without a task, which would take long to compile."""
    blank = jax.eval_shape(lambda key: stages.reset(scenario, key), key)
    state = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), blank.replace(streams=None))
    pedestrians, groups, memory = scenario.behavior.reset(scenario, key)
    robot = state.robot.replace(position=jnp.full(2, FAR), heading=jnp.asarray([1.0, 0.0]))
    return state.replace(streams=prng.streams(key), pedestrians=pedestrians, groups=groups, memory=memory, robot=robot)
