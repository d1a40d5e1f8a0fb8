"""A team: several robots in one scenario, each with its task, policy, sensors and metrics, among the same people.

A team of M robots is a stack of M scenarios that differ in their robot. Its state has a leading axis M on each leaf:
an ordinary ``State`` of each robot, all with the same people at the same time. So functions of a scenario and a state,
such as policies, sensors, observations and metrics, hold for each robot of a team (``Stack.over_members``).

People are moved once, by all robots. A robot whose episode has ended stands there until all have ended.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Float, PyTree

from sean_jax import metrics
from sean_jax.core import random_streams
from sean_jax.core.data_types import Array, Policy, PolicyLike, Scenario, State, as_policy
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import length
from sean_jax.robots.teammates import models_of_others, others_of, with_contacts
from sean_jax.simulation import episodes, scenario
from sean_jax.simulation.scenario_stack import Stack, of_arrays

CLEARANCE = 0.3  # m, between the bodies of two robots at their starts
ATTEMPTS = 16  # draws of a task, until its start is clear of the other robots
MAX_ROBOTS = 32


def of_scenarios(members: Stack[Scenario]) -> Stack[Scenario]:
    """The team of M scenarios that differ in their robot alone.

    Raises:
        InputError: there are too many robots, or MJX moves one.
    """
    number, first = members.size, members.member
    if number > MAX_ROBOTS:
        raise InputError(f"robots: {number} are more than {MAX_ROBOTS}; give fewer.")
    if jax.tree.leaves(first.robot.data):
        raise InputError("dynamics: MJX moves one robot in a program, not a team; choose twin or kinematic.")
    models = models_of_others(members.over_members(lambda member: member.robot)(), number)
    more = [(name, metric) for name, metric in metrics.OF_TEAMS.items() if name not in dict(first.metrics)]
    members = members.map_member(lambda member: replace(member, metrics=(*member.metrics, *more)))
    return members.with_fields(others=of_arrays(models), robot_number=of_arrays(jnp.arange(number, dtype=jnp.int32)))


def reset(team: Stack[Scenario], key: Array) -> State:
    """The states (M, ...) before the first step: people as in ``scenario.reset``, and a task for each robot.

    The first robot begins as alone. The task of each other one is drawn anew, 16 times at most, until its start is
    clear of the robots before it.

    Args:
        key: () typed PRNG key, the source of all randomness of the episode.
    """
    first = scenario.reset(team.member, key)
    number, radii = team.size, _radii(team)
    starts = jnp.zeros((number, 2), first.robot.position.dtype).at[0].set(first.task.start)
    robot_key = jax.random.fold_in(key, random_streams.TEAM)

    def one(starts: Array, index: Array) -> tuple[Array, State]:
        member = jax.lax.stop_gradient(team.at(index))
        own_key = jax.random.fold_in(robot_key, index)
        earlier = jnp.arange(number, dtype=jnp.int32) < index

        def draw(carry: tuple) -> tuple:
            attempt = carry[0]
            state = scenario.next_task(member, first_fixed, jax.random.fold_in(own_key, attempt))
            gap = starts - state.task.start[None, :]
            near = length(gap[:, 0], gap[:, 1]) < radii + radii[index] + CLEARANCE
            return attempt + 1, ~(near & earlier).any(), state

        def again(carry: tuple) -> Array:
            return ~carry[1] & (carry[0] < ATTEMPTS)

        state = jax.lax.while_loop(again, draw, (jnp.zeros((), jnp.int32), jnp.zeros((), bool), first_fixed))[2]
        return starts.at[index].set(state.task.start), state

    first_fixed = jax.lax.stop_gradient(first)
    states = jax.tree.map(lambda leaf: leaf[None], first)
    if number > 1:
        _, rest = jax.lax.scan(one, jax.lax.stop_gradient(starts), jnp.arange(1, number, dtype=jnp.int32))
        states = jax.tree.map(lambda leaf, more: jnp.concatenate([leaf, more]), states, rest)

    def share(state: State) -> State:
        streams = replace(state.streams, people=first.streams.people, noise=first.streams.noise)
        return replace(state, streams=streams, pedestrians=first.pedestrians, groups=first.groups, memory=first.memory)

    states = meet(jax.vmap(share)(states))

    def measured(member: Scenario, state: State) -> State:
        now = scenario.snapshot(member, state)
        return replace(state, metrics={name: metric.init(now) for name, metric in member.metrics})

    return team.over_members(measured)(states)


def step(team: Stack[Scenario], states: State, actions: Float[Array, "M command"]) -> State:
    """The states (M, ...) of a team ``scenario.time_step`` later.

    Args:
        actions: the command [m/s, rad/s] of each robot, as in ``scenario.step``; one that is not finite is no new
            command. A robot whose episode has ended stands.
    """
    first = jax.tree.map(lambda leaf: leaf[0], states)
    crowd = team.member
    crowd = replace(crowd, robot=replace(crowd.robot, radius=_radii(team)))
    moved = replace(first, robot=states.robot, others=None)
    key = jax.random.fold_in(first.streams.people, first.tick)
    moved = scenario.direct_pedestrians(crowd, moved, key)
    moved = scenario.move_pedestrians(crowd, moved)

    def drive(member: Scenario, before: State, action: Array) -> State:
        over = before.completed | before.timed_out
        action = jnp.where(over, jnp.zeros_like(action), action)
        after = replace(before, pedestrians=moved.pedestrians, groups=moved.groups, memory=moved.memory)
        robot = scenario.move_robot(member, with_contacts(member, after), action).robot
        return replace(after, robot=robot, tick=before.tick + 1)

    after = meet(team.over_members(drive)(states, actions))

    def finish(member: Scenario, before: State, after: State) -> State:
        after = scenario.measure(member, before, scenario.classify(member, after))
        return scenario.finish(member, before, after)

    return team.over_members(finish)(states, after)


def meet(states: State) -> State:
    """The states (M, ...) in which each robot has the others where they are, after robots were moved by hand."""

    def of_others(values: PyTree) -> PyTree:
        return jax.tree.map(lambda leaf: leaf[others_of(len(leaf))], values)

    return replace(states, others=of_others(states.robot), goals_of_others=of_others(states.task.goal))


def init_policy(team: Stack[Scenario], policy: PolicyLike, states: State) -> State:
    """The states (M, ...) with a new memory of the policy of each robot."""
    return team.over_members(lambda member, state: episodes.init_policy(member, policy, state))(states)


def policy_step(team: Stack[Scenario], policy: PolicyLike, states: State) -> tuple[State, Float[Array, "M command"]]:
    """One control step with the commands of a policy of all robots: the states, and the commands [m/s, rad/s].

    A policy meets the other robots as moving bodies (``teammates.with_bodies``).
    """
    policy = as_policy(policy)

    def command(member: Scenario, state: State) -> tuple[Array, PyTree]:
        key = jax.random.fold_in(state.streams.policy, state.tick)
        return episodes.command(member, policy, state, key)

    actions, memory = team.over_members(command)(states)
    return step(team, replace(states, policy_state=memory), actions), actions


def rollout(
    team: Stack[Scenario], policy: PolicyLike, key: Array, steps: int, record: Callable = scenario.frame
) -> tuple[State, PyTree]:
    """An episode of a team from its reset.

    Args:
        key: () typed PRNG key of the episode.
        steps: number of control steps; static.
        record: (before, after, action) -> the record of a step of one robot; ``data_types.Trajectory`` by default.

    Returns:
        The last states (M, ...), and the records (steps, M, ...).
    """

    def one(before: State, _: None) -> tuple[State, PyTree]:
        after, actions = policy_step(team, policy, before)
        return after, jax.vmap(record)(before, after, actions)

    return jax.lax.scan(one, init_policy(team, policy, reset(team, key)), length=steps)


def results(team: Stack[Scenario], states: State) -> dict[str, Array]:
    """The metrics of each robot so far: name -> (M,) or (M, 1 + S)."""
    return team.over_members(scenario.results)(states)


def is_over(states: State) -> Array:
    """() bool, whether the episodes of all robots (M, ...) have ended."""
    return (states.completed | states.timed_out).all()


def one_each(policies: Sequence[PolicyLike]) -> Policy:
    """The policy of a team whose robots have these, in order; all of them are computed for each robot."""
    each = tuple(map(as_policy, policies))
    names = ",".join(policy.name for policy in each)
    parts = tuple(replace(policy, params=()) for policy in each)
    return Policy(tuple(policy.params for policy in each), names, _OfEach("init", parts), _OfEach("apply", parts))


class _OfEach:
    """``Policy.init`` or ``Policy.apply`` of robots with policies of their own."""

    def __init__(self, name: str, policies: tuple[Policy, ...]):
        self.name, self.policies = name, policies

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _OfEach) and (self.name, self.policies) == (other.name, other.policies)

    def __hash__(self) -> int:
        return hash((self.name, tuple((policy.init, policy.apply) for policy in self.policies)))

    def __call__(self, scenario: Scenario, params: tuple, state: State, *key: Array) -> Any:
        if self.name == "init":
            each = zip(self.policies, params, strict=True)
            return tuple(policy.init(scenario, own, state) for policy, own in each)
        results = [
            policy.apply(scenario, own, replace(state, policy_state=memory), *key)
            for policy, own, memory in zip(self.policies, params, state.policy_state, strict=True)
        ]
        actions = jnp.stack([action for action, _ in results])
        number = jnp.asarray(0, jnp.int32) if scenario.robot_number is None else scenario.robot_number
        return actions[number], tuple(memory for _, memory in results)


def _radii(team: Stack[Scenario]) -> Float[Array, "M"]:
    return team.over_members(lambda member: jnp.asarray(member.robot.radius, float))()
