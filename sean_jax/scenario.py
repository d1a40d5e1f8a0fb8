"""A scenario (section IV-B) as three functions: reset, step and observe."""

from dataclasses import replace

import jax
import jax.numpy as jnp

from sean_jax import chance, clock
from sean_jax import navigation as paths
from sean_jax.base import Array, Frame, Moment, Scenario, State
from sean_jax.geometry import length, rotate
from sean_jax.observation import Observation


def reset(scenario: Scenario, key: Array) -> State:
    """The state before the first step: people at their starts, then a task for the robot among them.

    Args:
        key: () typed PRNG key, all that the episode's chance comes from.
    """
    people_key, task_key, streams_key = jax.random.split(key, 3)
    pedestrians, groups, memory = scenario.behavior.reset(scenario, people_key)
    task = scenario.task(scenario, pedestrians, groups, memory, task_key)
    path = task.start, task.start_heading, task.goal, task.to_goal
    task = replace(task, turning=paths.turning(scenario.navigation, *path))
    state = State(
        streams=chance.streams(streams_key),
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
    now = moment(scenario, state)
    return replace(state, metrics={name: metric.start(now) for name, metric in scenario.metrics})


def step(scenario: Scenario, state: State, action: Array) -> State:
    """The state one control step later.

    Args:
        action: (2,) linear [m/s] and angular [rad/s] velocity that the robot is told to take.
    """
    key = jax.random.fold_in(state.streams.people, state.tick)
    after = direct_pedestrians(scenario, state, key)
    after = move_pedestrians(scenario, after)
    after = move_robot(scenario, after, action)
    after = replace(after, tick=state.tick + 1)
    after = classify(scenario, after)
    after = measure(scenario, state, after)
    return finish(scenario, state, after)


def place(scenario: Scenario, state: State, position: Array, heading: Array) -> State:
    """The state with the robot put somewhere else, at rest and without a command; situations are those there.

    The task stays as it was, with its start, its goal and how far that was, and so do metrics, for which this is a
    step of the path. Shortest paths are found from wherever the robot is. Nobody makes room: what the robot overlaps
    with pushes it out. A policy that remembers (``base.Driver``) is begun again by ``parallel.begin``.

    Args:
        position: (2,) m.
        heading: (2,) where it looks, of any length; along x if it is zero.
    """
    there, looking = (jnp.asarray(part, state.robot.position.dtype) for part in (position, heading))
    robot = scenario.robot.place(scenario.robot, there, looking)
    return classify(scenario, replace(state, robot=robot, ticks_at_goal=jnp.zeros((), jnp.int32)))


@jax.named_scope("direct_pedestrians")
def direct_pedestrians(scenario: Scenario, state: State, key: Array) -> State:
    """Section IV-D, high level: who goes where."""
    return scenario.behavior.direct(scenario, state, key)


@jax.named_scope("move_pedestrians")
def move_pedestrians(scenario: Scenario, state: State) -> State:
    """Section IV-D, low level: how they get there."""
    return replace(state, pedestrians=scenario.move(scenario, state))


@jax.named_scope("move_robot")
def move_robot(scenario: Scenario, state: State, action: Array) -> State:
    """Fig. 3: the robot's dynamics, with people where they are after their step."""
    return replace(state, robot=scenario.robot.drive(scenario, state, action))


@jax.named_scope("classify")
def classify(scenario: Scenario, state: State) -> State:
    """Section III-A: the social situations that occur now."""
    now = moment(scenario, state)
    return replace(state, situations=jnp.stack([holds(now, scenario.thresholds) for _, holds in scenario.situations]))


@jax.named_scope("measure")
def measure(scenario: Scenario, before: State, after: State) -> State:
    """Section IV-H: metrics, which stand still once the episode has ended."""
    then, now = moment(scenario, before), moment(scenario, after)
    over = before.completed | before.timed_out
    folded = {name: metric.fold(before.metrics[name], then, now) for name, metric in scenario.metrics}
    kept = jax.tree.map(lambda old, new: jnp.where(over, old, new), before.metrics, folded)
    return replace(after, metrics=kept)


def finish(scenario: Scenario, before: State, after: State) -> State:
    """Whether the task is completed, the goal having been held, or the time is over; both stay once they are."""
    gap = after.robot.position - after.task.goal
    inside = length(gap[0], gap[1]) <= scenario.goal_radius
    held = jnp.where(inside, before.ticks_at_goal + 1, 0)
    wanted = clock.in_ticks(scenario.hold_time, scenario.time_step)
    last = clock.ticks(scenario.time_limit, scenario.time_step)
    completed = before.completed | (~before.timed_out & inside & (held.astype(wanted.dtype) >= wanted))
    timed_out = before.timed_out | (~completed & (after.tick >= last))
    return replace(after, ticks_at_goal=held, completed=completed, timed_out=timed_out)


def moment(scenario: Scenario, state: State) -> Moment:
    """What situations and metrics read of a state."""
    robot, task = state.robot, state.task
    return Moment(
        people=state.pedestrians,
        position=robot.position,
        heading=robot.heading,
        velocity=robot.speed * robot.heading,
        start=task.start,
        goal=task.goal,
        start_group=task.start_group,
        goal_group=task.goal_group,
        geodesic=task.geodesic,
        situations=state.situations,
        tick=state.tick,
        robot_radius=jnp.asarray(scenario.robot.radius, float),
        person_radius=scenario.forces.radius,
        time_step=scenario.time_step,
        obstacles=scenario.environment.obstacles,
        turning=task.turning,
        goal_radius=scenario.goal_radius,
        robot_top_speed=scenario.robot.max_speed,
    )


def results(scenario: Scenario, state: State) -> dict[str, Array]:
    """The metrics of the episode so far: () each, or (1 + S,) with the overall figure before those by situation."""
    return {name: metric.result(state.metrics[name]) for name, metric in scenario.metrics}


def observe(scenario: Scenario, state: State) -> Observation:
    """What the robot perceives and plans with, in its own frame; kept apart from the step, so that it can be unused."""
    robot, people = state.robot, state.pedestrians
    hx, hy = robot.heading[0], robot.heading[1]

    def in_frame(vectors: Array) -> Array:
        return jnp.stack(rotate(vectors[..., 0], vectors[..., 1], hx, -hy), -1)

    ahead = paths.next_point(scenario.navigation, robot.position, state.task.goal, state.task.to_goal)
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


def frame(before: State, after: State, action: Array) -> Frame:
    """What a rollout keeps of a step."""
    robot, people = after.robot, after.pedestrians
    return Frame(
        position=robot.position,
        heading=robot.heading,
        velocity=robot.speed * robot.heading,
        action=action,
        people=people.position,
        people_velocity=people.velocity,
        people_heading=people.heading,
        group=people.group,
        present=people.present,
        goal=after.task.goal,
        situations=after.situations,
        active=~(before.completed | before.timed_out),
    )
