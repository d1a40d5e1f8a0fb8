"""A scenario (section IV-B) as three functions: reset, step and observe."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp

from sean_jax.core import clock, random_streams, user_calls
from sean_jax.core.data_types import (
    Array,
    Groups,
    Observation,
    Pedestrians,
    RobotTask,
    Scenario,
    Snapshot,
    State,
    Trajectory,
)
from sean_jax.core.geometry import ground_velocity, length, rotate
from sean_jax.social_forces import individualize
from sean_jax.world import navigation as paths

NOWHERE = 1e4  # m, where the robot is while people warm up
WARM_UP = 1  # folded into the key of an episode after its warm-up


def reset(scenario: Scenario, key: Array) -> State:
    """The state before the first step: people at their starts, who walk for ``scenario.warm_up`` seconds, then a task.

    Args:
        key: () typed PRNG key, the source of all randomness of the episode.

    Source: section IV-B.
    """
    key = random_streams.typed(key)
    people_key, task_key, streams_key = jax.random.split(key, 3)
    begin = scenario.behavior.reset
    people = user_calls.call("behavior", begin, "scenario, key", scenario, people_key)
    if not isinstance(people, tuple) or len(people) != 3:
        raise user_calls.wrong(
            "behavior", begin, user_calls.describe(people), "(pedestrians, groups, memory)", "give all three"
        )
    pedestrians, groups, memory = people
    user_calls.check_type("behavior", begin, pedestrians, Pedestrians, N=scenario.people)
    user_calls.check_type("behavior", begin, groups, Groups)
    pedestrians = individualize(scenario.forces, pedestrians, jax.random.fold_in(key, random_streams.TRAITS))
    state = _begin(scenario, pedestrians, groups, memory, task_key, streams_key)
    if clock.ceil_ticks(scenario.warm_up, scenario.time_step) == 0:
        return state
    return next_task(scenario, warm_up(scenario, state), jax.random.fold_in(key, WARM_UP))


def next_task(scenario: Scenario, state: State, key: Array) -> State:
    """The first state of the robot's next task in the present crowd, as in SEAN 2.0.

    The robot is placed at the start of that task, and time and metrics begin again. ``episodes.init_policy`` renews the
    memory of a policy. People of a recording begin at their first moment again.

    Args:
        key: () typed PRNG key, the source of all further randomness.
    """
    task_key, streams_key = jax.random.split(key)
    return _begin(scenario, state.pedestrians, state.groups, state.memory, task_key, streams_key)


def warm_up(scenario: Scenario, state: State) -> State:
    """The state after people have walked for ``scenario.warm_up`` seconds, with the robot far away."""
    nowhere = jnp.full(2, NOWHERE, state.robot.position.dtype)
    state = replace(state, robot=scenario.robot.place(scenario.robot, nowhere, state.robot.heading))

    def one(state: State, _: None) -> tuple[State, None]:
        key = jax.random.fold_in(state.streams.people, state.tick)
        after = move_pedestrians(scenario, direct_pedestrians(scenario, state, key))
        return replace(after, tick=state.tick + 1), None

    ticks = clock.ceil_ticks(scenario.warm_up, scenario.time_step)
    return jax.lax.scan(one, state, length=ticks)[0]


def _begin(
    scenario: Scenario, pedestrians: Pedestrians, groups: Groups, memory: Any, task_key: Array, streams_key: Array
) -> State:
    """The first state of a task among existing people."""
    names = "scenario, pedestrians, groups, memory, key"
    task = user_calls.call("task", scenario.task, names, scenario, pedestrians, groups, memory, task_key)
    user_calls.check_type("task", scenario.task, task, RobotTask)
    path = task.start, task.start_heading, task.goal, task.paths_to_goal
    task = replace(task, path_rotation=paths.path_rotation(scenario.navigation, *path))
    state = State(
        streams=random_streams.streams(streams_key),
        tick=jnp.zeros((), jnp.int32),
        pedestrians=pedestrians,
        groups=groups,
        robot=scenario.robot.place(scenario.robot, task.start, task.start_heading),
        task=task,
        memory=memory,
        situations=jnp.zeros(len(scenario.situations), bool),
        metrics={},
        ticks_at_goal=jnp.zeros((), jnp.int32),
        completed=jnp.zeros((), bool),
        timed_out=jnp.zeros((), bool),
    )
    state = classify(scenario, state)
    now = snapshot(scenario, state)
    return replace(
        state,
        metrics={name: user_calls.call("metrics", metric.init, "snapshot", now) for name, metric in scenario.metrics},
    )


def step(scenario: Scenario, state: State, action: Array) -> State:
    """The state ``scenario.time_step`` later.

    Args:
        action: (2,) commanded linear [m/s] and angular [rad/s] velocity, or (3,) for an omnidirectional robot, with the
            velocity to the left in the middle; one that is not finite is no new command.

    Source: sections III-A, IV-D, IV-E and IV-H.
    """
    # Reverse mode stores the state and sums over pairs; it computes each stage again.
    key = jax.random.fold_in(state.streams.people, state.tick)
    after = direct_pedestrians(scenario, state, key)
    after = move_pedestrians(scenario, after)
    after = move_robot(scenario, after, action)
    after = replace(after, tick=state.tick + 1)
    after = classify(scenario, after)
    after = measure(scenario, state, after)
    return finish(scenario, state, after)


def teleport(scenario: Scenario, state: State, position: Array, heading: Array) -> State:
    """The state with the robot somewhere else, at rest and without a command, and the situations there.

    The task continues, with its start, goal and distance, and so do metrics, which count this as a step. Shortest
    paths begin at the robot's position. Nobody makes room: people and boxes that overlap push the robot out.
    ``episodes.init_policy`` renews the memory of a policy.

    Args:
        position: (2,) m.
        heading: (2,) of any length; along x if it is zero.
    """
    position, heading = (jnp.asarray(part, state.robot.position.dtype) for part in (position, heading))
    robot = scenario.robot.place(scenario.robot, position, heading)
    return classify(scenario, replace(state, robot=robot, ticks_at_goal=jnp.zeros((), jnp.int32)))


@jax.named_scope("direct_pedestrians")
def direct_pedestrians(scenario: Scenario, state: State, key: Array) -> State:
    """The pedestrian behavior: new desired velocities, members of groups and memory.

    Args:
        key: () typed PRNG key of this tick.

    Source: section IV-D, high level.
    """
    direct = scenario.behavior.direct

    def call(state: State) -> State:
        return user_calls.call("behavior", direct, "scenario, state, key", scenario, state, key)

    after = jax.checkpoint(call, prevent_cse=False)(state)
    user_calls.check_like("behavior", direct, after, state, "a state whose")
    return after


@jax.named_scope("move_pedestrians")
def move_pedestrians(scenario: Scenario, state: State) -> State:
    """The pedestrian model: people one control step later. Source: section IV-D, low level."""
    people = user_calls.call("model", scenario.move, "scenario, state", scenario, state)
    user_calls.check_like("model", scenario.move, people, state.pedestrians, "people whose")
    return replace(state, pedestrians=people)


@jax.named_scope("move_robot")
def move_robot(scenario: Scenario, state: State, action: Array) -> State:
    """The robot's dynamics under a command [m/s, rad/s], among people after their step. Source: Fig. 3."""
    return replace(state, robot=scenario.robot.drive(scenario, state, action))


@jax.named_scope("classify")
def classify(scenario: Scenario, state: State) -> State:
    """The state with the social situations (S,) that occur now. Source: section III-A."""
    now = snapshot(scenario, state)
    return replace(state, situations=jnp.stack([holds(now, scenario.thresholds) for _, holds in scenario.situations]))


@jax.named_scope("measure")
def measure(scenario: Scenario, before: State, after: State) -> State:
    """``after`` with new metrics; they do not change once the episode has ended. Source: section IV-H."""
    done = before.completed | before.timed_out

    def update(before: State, after: State) -> dict[str, Any]:
        earlier, now = snapshot(scenario, before), snapshot(scenario, after)
        return {
            name: user_calls.call("metrics", metric.update, "value, before, after", before.metrics[name], earlier, now)
            for name, metric in scenario.metrics
        }

    values = jax.checkpoint(update, prevent_cse=False)(before, after)
    for name, metric in scenario.metrics:
        user_calls.check_like("metrics", metric.update, values[name], before.metrics[name], "a value that is")
    values = jax.tree.map(lambda old, new: jnp.where(done, old, new), before.metrics, values)
    return replace(after, metrics=values)


def finish(scenario: Scenario, before: State, after: State) -> State:
    """``after`` with ``completed`` (hold time reached), ``timed_out`` and ``ticks_at_goal``; the first two are latched.

    Source: section IV-E.
    """
    gap = after.robot.position - after.task.goal
    inside = length(gap[0], gap[1]) <= scenario.goal_radius
    ticks_at_goal = jnp.where(inside, before.ticks_at_goal + 1, 0)
    needed = clock.to_ticks(scenario.hold_time, scenario.time_step)
    last = clock.ceil_ticks(scenario.time_limit, scenario.time_step)
    completed = before.completed | (~before.timed_out & inside & (ticks_at_goal.astype(needed.dtype) >= needed))
    timed_out = before.timed_out | (~completed & (after.tick >= last))
    return replace(after, ticks_at_goal=ticks_at_goal, completed=completed, timed_out=timed_out)


def snapshot(scenario: Scenario, state: State) -> Snapshot:
    """What situations and metrics read of a state."""
    robot = state.robot
    task = state.task
    return Snapshot(
        people=state.pedestrians,
        position=robot.position,
        heading=robot.heading,
        velocity=ground_velocity(robot),
        start=task.start,
        goal=task.goal,
        start_group=task.start_group,
        goal_group=task.goal_group,
        geodesic=task.geodesic,
        situations=state.situations,
        tick=state.tick,
        robot_radius=scenario.robot.radius,
        person_radius=scenario.forces.walking.radius,
        time_step=scenario.time_step,
        obstacles=scenario.environment.obstacles,
        path_rotation=task.path_rotation,
        goal_radius=scenario.goal_radius,
        robot_top_speed=scenario.robot.max_speed,
        robots=_discs(scenario, state),
        to_surface=scenario.to_surface,
    )


def _discs(scenario: Scenario, state: State) -> Array | None:
    """(R, 3) m, x, y and radius of the other robots of a team; None without a team."""
    if state.others is None or scenario.others is None:
        return None
    return jnp.concatenate([state.others.position, scenario.others.radius[:, None]], 1)


def results(scenario: Scenario, state: State) -> dict[str, Array]:
    """The metrics of the episode so far: name -> () or (1 + S,), the overall value first, then each situation.

    Source: section IV-H.
    """
    return {
        name: user_calls.call("metrics", metric.compute, "value", state.metrics[name])
        for name, metric in scenario.metrics
    }


def observe(scenario: Scenario, state: State) -> Observation:
    """The robot's observation in its own frame; separate from the step, which does not need it."""
    robot = state.robot
    people = state.pedestrians
    hx, hy = robot.heading[0], robot.heading[1]

    def in_frame(vectors: Array) -> Array:
        return jnp.stack(rotate(vectors[..., 0], vectors[..., 1], hx, -hy), -1)

    ahead = paths.next_point(scenario.navigation, robot.position, state.task.goal, state.task.paths_to_goal)
    return Observation(
        goal=in_frame(state.task.goal - robot.position),
        goal_heading=in_frame(state.task.goal_heading),
        path=in_frame(ahead - robot.position),
        speed=robot.speed,
        turn_rate=robot.turn_rate,
        people=in_frame(people.position - robot.position[None, :]),
        people_velocity=in_frame(people.velocity),
        people_present=people.present,
        situations=state.situations,
    )


def frame(before: State, after: State, action: Array) -> Trajectory:
    """The record of a step, after the command [m/s, rad/s] that led there."""
    robot = after.robot
    people = after.pedestrians
    others = None
    if after.others is not None and after.goals_of_others is not None:
        others = jnp.concatenate([after.others.position, after.others.heading, after.goals_of_others], -1)
    return Trajectory(
        position=robot.position,
        heading=robot.heading,
        velocity=ground_velocity(robot),
        action=action,
        people=people.position,
        people_velocity=people.velocity,
        people_heading=people.heading,
        group=people.group,
        present=people.present,
        goal=after.task.goal,
        situations=after.situations,
        active=~(before.completed | before.timed_out),
        robots=others,
    )
