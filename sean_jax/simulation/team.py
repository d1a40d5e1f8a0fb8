"""A team: several robots in one scenario, each with its task, policy, sensors and metrics, among the same people.

A team of M robots is a stack of M scenarios that differ in their robot. Its state has a leading axis M on each leaf:
an ordinary ``State`` of each robot, all with the same people at the same time. So functions of a scenario and a state,
such as policies, sensors, observations and metrics, hold for each robot of a team (``Stack.over_members``).

People are moved once, by all robots. A robot whose episode has ended stands there until all have ended.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int, PyTree

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
    robots = members.size
    first = members.member
    if robots > MAX_ROBOTS:
        raise InputError(f"robots: {robots} are more than {MAX_ROBOTS}; give fewer.")
    if jax.tree.leaves(first.robot.data):
        raise InputError("dynamics: MJX moves one robot in a program, not a team; choose twin or kinematic.")
    every_robot = members.over_members(lambda member: member.robot)()
    models = models_of_others(every_robot, robots)
    indices = of_arrays(jnp.arange(robots, dtype=jnp.int32))

    # Metrics of teams that the scenario does not have yet.
    names = [name for name, _ in first.metrics]
    more = [(name, metric) for name, metric in metrics.OF_TEAMS.items() if name not in names]
    members = members.map_member(lambda member: replace(member, metrics=(*member.metrics, *more)))
    return members.with_fields(others=of_arrays(models), robot_number=indices)


def reset(team: Stack[Scenario], key: Array) -> State:
    """The states (M, ...) before the first step: people as in ``scenario.reset``, and a task for each robot.

    The first robot begins as alone. The task of each other one is drawn anew, 16 times at most, until its start is
    clear of the robots before it.

    Args:
        key: () typed PRNG key, the source of all randomness of the episode.
    """
    first = scenario.reset(team.member, key)
    robots = team.size
    radii = _radii(team)
    starts = jnp.zeros((robots, 2), first.robot.position.dtype)
    starts = starts.at[0].set(first.task.start)
    robot_key = jax.random.fold_in(key, random_streams.TEAM)

    # A task of each further robot, in order, as it depends on the starts before it.
    states = jax.tree.map(lambda leaf: leaf[None], first)
    if robots > 1:
        among = jax.lax.stop_gradient(first)
        begin = functools.partial(_begin_clear, team, radii, among, robot_key)
        indices = jnp.arange(1, robots, dtype=jnp.int32)
        _, others = jax.lax.scan(begin, jax.lax.stop_gradient(starts), indices)
        states = jax.tree.map(lambda leaf, more: jnp.concatenate([leaf, more]), states, others)

    # All robots are among the people of the first.
    def share(state: State) -> State:
        streams = replace(state.streams, people=first.streams.people, noise=first.streams.noise)
        return replace(state, streams=streams, pedestrians=first.pedestrians, groups=first.groups, memory=first.memory)

    def init_metrics(member: Scenario, state: State) -> State:
        now = scenario.snapshot(member, state)
        return replace(state, metrics={name: metric.init(now) for name, metric in member.metrics})

    states = meet(jax.vmap(share)(states))
    return team.over_members(init_metrics)(states)


def _begin_clear(
    team: Stack[Scenario],
    radii: Float[Array, "M"],
    among: State,
    robot_key: Array,
    starts: Float[Array, "M 2"],
    index: Int[Array, ""],
) -> tuple[Float[Array, "M 2"], State]:
    """The starts with that of a robot, clear of those before it if a draw is; and its first state."""
    member = jax.lax.stop_gradient(team.at(index))
    own_key = jax.random.fold_in(robot_key, index)
    earlier = jnp.arange(team.size, dtype=jnp.int32) < index  # (M,)

    def draw(carry: tuple[Array, Array, State]) -> tuple[Array, Array, State]:
        attempt, _, _ = carry
        state = scenario.next_task(member, among, jax.random.fold_in(own_key, attempt))
        gap = starts - state.task.start[None, :]  # (M, 2)
        distance = length(gap[:, 0], gap[:, 1])
        is_near = distance < radii + radii[index] + CLEARANCE
        is_clear = ~(is_near & earlier).any()
        return attempt + 1, is_clear, state

    def is_wanted(carry: tuple[Array, Array, State]) -> Array:
        attempt, is_clear, _ = carry
        return ~is_clear & (attempt < ATTEMPTS)

    start = jnp.zeros((), jnp.int32), jnp.zeros((), bool), among
    _, _, state = jax.lax.while_loop(is_wanted, draw, start)
    return starts.at[index].set(state.task.start), state


def step(team: Stack[Scenario], states: State, actions: Float[Array, "M command"]) -> State:
    """The states (M, ...) of a team ``scenario.time_step`` later.

    Args:
        actions: the command [m/s, rad/s] of each robot, as in ``scenario.step``; one that is not finite is no new
            command. A robot whose episode has ended stands.
    """
    # People are moved once, among the bodies of all robots.
    first = jax.tree.map(lambda leaf: leaf[0], states)
    robots = replace(team.member.robot, radius=_radii(team))
    crowd = replace(team.member, robot=robots)
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

    def step_and_record(before: State, _: None) -> tuple[State, PyTree]:
        after, actions = policy_step(team, policy, before)
        return after, jax.vmap(record)(before, after, actions)

    return jax.lax.scan(step_and_record, init_policy(team, policy, reset(team, key)), length=steps)


def results(team: Stack[Scenario], states: State) -> dict[str, Array]:
    """The metrics of each robot so far: name -> (M,) or (M, 1 + S)."""
    return team.over_members(scenario.results)(states)


def is_over(states: State) -> Array:
    """() bool, whether the episodes of all robots (M, ...) have ended."""
    return (states.completed | states.timed_out).all()


def one_each(policies: Sequence[PolicyLike]) -> Policy:
    """The policy of a team whose robots have these, in order; all of them are computed for each robot."""
    several = tuple(map(as_policy, policies))
    names = ",".join(policy.name for policy in several)
    static = tuple(replace(policy, params=()) for policy in several)
    params = tuple(policy.params for policy in several)
    return Policy(params, names, _OfEach("init", static), _OfEach("apply", static))


@dataclass(frozen=True)
class _OfEach:
    """``Policy.init`` or ``Policy.apply`` of robots with policies of their own."""

    name: str
    policies: tuple[Policy, ...]  # without parameters

    def __call__(self, scenario: Scenario, params: tuple, state: State, *key: Array) -> Any:
        if self.name == "init":
            pairs = zip(self.policies, params, strict=True)
            return tuple(policy.init(scenario, own_params, state) for policy, own_params in pairs)
        actions = []
        memories = []
        for policy, own_params, memory in zip(self.policies, params, state.policy_state, strict=True):
            own_state = replace(state, policy_state=memory)
            action, memory = policy.apply(scenario, own_params, own_state, *key)
            actions.append(action)
            memories.append(memory)
        index = jnp.asarray(0, jnp.int32) if scenario.robot_number is None else scenario.robot_number
        return jnp.stack(actions)[index], tuple(memories)


def _radii(team: Stack[Scenario]) -> Float[Array, "M"]:
    return team.over_members(lambda member: jnp.asarray(member.robot.radius, float))()
