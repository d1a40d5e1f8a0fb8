"""The one runner of batches: which episodes, of which scenario, what is kept of them, and which of them are faulty."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax.core import random_streams
from sean_jax.core.data_types import Policy
from sean_jax.simulation.episode_runner import Record, Runner
from sean_jax.simulation.scenario import reset
from support.commands import cpu_devices, python
from support.draws import noisy, still

SIZE = 8


@pytest.fixture(scope="module")
def quiet(scenario):
    """Five steps in which nothing happens, but that the robot's speed becomes the goal's radius, or NaN."""

    def drive(scenario, state, action):
        faulty = state.task.start[0] > 0.7
        return dataclasses.replace(state.robot, speed=jnp.where(faulty, jnp.nan, scenario.goal_radius))

    made = still(scenario)
    return made.replace(robot=made.robot.replace(drive=drive), time_limit=0.5)


def sound(quiet):
    """The scenario with a robot whose numbers are finite."""
    drive = lambda scenario, state, action: dataclasses.replace(state.robot, speed=scenario.goal_radius)  # noqa: E731
    return quiet.replace(robot=quiet.robot.replace(drive=drive))


def test_faulty_episodes_are_named(quiet):
    """Those that count, and no others, by the numbers by which they are drawn."""
    runner, numbers = Runner(quiet, noisy, SIZE, "run"), np.arange(16, 16 + SIZE)
    keys = jax.vmap(jax.random.fold_in, (None, 0))(random_streams.key("run", 3), numbers)
    starts = jax.jit(jax.vmap(lambda key: reset(quiet, key).task.start[0]))(keys)
    faulty = numbers[np.asarray(starts) > 0.7]
    assert 0 < len(faulty) < SIZE
    for count in (SIZE, int(faulty[0]) - 16 + 1):
        named = [str(number) for number in faulty if number < 16 + count]
        with pytest.raises(FloatingPointError) as error:
            runner.run(3, 16, count)
        assert str(error.value) == (
            f"{len(named)} of {count} episodes hold numbers that are not finite: {', '.join(named)}."
        )
    if faulty[0] > 16:
        assert len(runner.run(3, 16, int(faulty[0]) - 16).steps) == faulty[0] - 16


def test_scenarios_take_turns_and_a_record_keeps_what_it_is_asked_for(quiet):
    """By number, or as told; a row every two steps, of which the last goes beyond the end of the episodes."""
    first = sound(quiet)
    second = first.replace(goal_radius=first.goal_radius * 2.0)
    radii = np.asarray([first.goal_radius, second.goal_radius])

    def init(floors, states):
        return jnp.zeros((), jnp.int32)

    def update(floors, before, after, actions, active, total):
        assert actions.shape == (2, SIZE, 2)
        return total + active.sum(dtype=jnp.int32), (before.tick, active, after.robot.speed)

    runner = Runner([first, second], noisy, SIZE, "collect", Record(init, update, every=2), chunk=0.2)
    batch = runner.run(0, first=3, count=5)
    np.testing.assert_allclose(batch.states.robot.speed, radii[np.arange(3, 8) % 2])
    assert batch.steps.tolist() == [5] * 5 and batch.states.tick.shape == (5,)
    ticks, active, speed = (np.concatenate(rows) for rows in zip(*batch.rows, strict=True))
    assert ticks[:, 0].tolist() == [0, 2, 4] and speed.shape == (3, SIZE)
    np.testing.assert_array_equal(active, np.broadcast_to(np.arange(SIZE) < 5, (3, SIZE)))
    assert int(batch.total) == 15, "what fills the batch does not count"
    told = runner.run(0, first=3, index=np.array([1, 1, 1, 0]))
    np.testing.assert_allclose(told.states.robot.speed, radii[[1, 1, 1, 0] * 2])
    assert not runner.run(0, first=3, keep_rows=False).rows


def test_drivers_that_share_a_batch_drive_as_each_alone(quiet):
    """Among scenarios of one kind and of two; each driver has a number, its share of the episodes and its memory."""

    def begin(scenario, params, state):
        return params * 10.0

    def apply(scenario, params, state, key):
        memory = state.policy_state
        return jnp.stack([params, state.task.start[1] * 0.01]), memory + 1.0

    def drive(scenario, state, action):
        return dataclasses.replace(state.robot, speed=action[0] * scenario.goal_radius, turn_rate=action[1])

    first = quiet.replace(robot=quiet.robot.replace(drive=drive))
    second = first.replace(goal_radius=first.goal_radius * 2.0)
    strengths = jnp.array([0.05, 0.15], jnp.float32)
    one = Policy(params=strengths[0], name="number", init=begin, apply=apply)
    shared = Runner([first, second], one.replace(params=strengths), SIZE, "run", drivers=2).run(4, first=5)
    alone = Runner([first, second], one, SIZE // 2, "run")
    for share, strength in enumerate(strengths):
        alone.policy = one.replace(params=strength)
        states = alone.run(4, first=5 + share * SIZE // 2).states
        part = jax.tree.map(lambda leaf: leaf[share * SIZE // 2 :][: SIZE // 2], shared.states)  # noqa: B023
        for name in ("robot.speed", "robot.turn_rate", "policy_state", "pedestrians.position"):
            drawn, expected = (functools.reduce(getattr, name.split("."), each) for each in (part, states))
            np.testing.assert_allclose(drawn, expected, rtol=1e-6, err_msg=name)
    assert len(set(np.asarray(shared.states.robot.speed).round(4).tolist())) == 4, "two drivers in two scenarios"


def test_scenarios_of_different_shapes_are_refused(quiet):
    with pytest.raises(ValueError, match="their static structure differs"):
        Runner([quiet, quiet.replace(people=3)], noisy, SIZE, "run")
    with pytest.raises(TypeError, match="must be a Policy or a function"):
        Runner(quiet, "nobody", SIZE, "run")  # pyright: ignore[reportArgumentType]


TWO = """
import jax, numpy as np, sean_jax
from sean_jax.core import devices; from sean_jax.simulation import scenario_stack
from sean_jax.evaluation import batches
from sean_jax.simulation.episode_runner import Runner, Callbacks
assert len(jax.devices()) == 2
asked = dict(people=2, dynamics="twin", behavior="random", time_limit=1.0)
scenarios = [sean_jax.make("lab", task=task, **asked) for task in ("random_ab_nav", "busy_ab_nav")]
drive = lambda scenario, state, key: jax.numpy.asarray([0.2, 0.1])
found = []
for mesh in (devices.mesh(jax.devices()[:1]), devices.mesh()):
    runner = Runner(scenarios, drive, 3, "run", batches.record(scenario_stack.as_stacks(scenarios)[0], 3), mesh)
    runner.compile(Callbacks())
    found.append([runner.run(1, first, count) for first, count in ((0, 3), (3, 2))])
for one, two in zip(*found):
    np.testing.assert_allclose(one.states.robot.position, two.states.robot.position, atol=1e-5)
    assert (one.steps == two.steps).all() and runner.size == 4
    for name in ("heat", "together", "group_size"):
        np.testing.assert_array_equal(getattr(one.total, name), getattr(two.total, name))
"""


@pytest.mark.night
def test_two_devices_run_what_one_does():
    """Also numbers of episodes that do not spread evenly, and programs that are compiled ahead."""
    python("-c", TWO, env=cpu_devices(2, "--xla_backend_optimization_level=0"))
