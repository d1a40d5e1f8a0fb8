"""A scenario whose parts draw numbers and do nothing else: quick to compile."""

import dataclasses

import jax
import jax.numpy as jnp

from sean_jax.core.data_types import Behavior, PathsToGoal, Pedestrians, RobotTask
from sean_jax.people.behaviors.starts import no_groups


def draws(key, *shape):
    return jax.random.uniform(key, shape, float)


def still(scenario):
    """The scenario with parts that draw numbers and do nothing else: quick to compile."""
    people = 2
    pair, none = jnp.zeros((people, 2)), jnp.full(people, -1, jnp.int32)

    def reset(scenario, key):
        there = Pedestrians(draws(key, people, 2), pair, pair, pair, none, none, none == -1, pair[:, 0], pair[:, 0])
        return there, no_groups(), ()

    def direct(scenario, state, key):
        return dataclasses.replace(
            state, pedestrians=dataclasses.replace(state.pedestrians, position=draws(key, people, 2))
        )

    def task(scenario, people, groups, memory, key):
        index, zero = jnp.full((), -1, jnp.int32), jnp.zeros(())
        ways = PathsToGoal(*jnp.zeros((2, scenario.navigation.arcs.side.shape[0])))
        return RobotTask(draws(key, 2), pair[0], pair[0] + 9.0, pair[0], index, index, zero, ways)

    robot = dataclasses.replace(scenario.robot, drive=lambda scenario, state, action: state.robot)
    return dataclasses.replace(
        scenario,
        behavior=Behavior(data=(), name="still", reset=reset, direct=direct),
        task=task,
        robot=robot,
        move=lambda scenario, state: state.pedestrians,
        metrics=(),
        situations=(("never", lambda snapshot, thresholds: jnp.zeros((), bool)),),
        people=people,
        time_limit=0.2,
    )


def noisy(scenario, state, key):
    return jax.random.normal(key, (2,), state.robot.position.dtype)
