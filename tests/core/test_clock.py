"""Durations end at the tick that exact arithmetic says, however many steps they have."""

import dataclasses
import functools
import math
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import robots, sensors
from sean_jax.core import clock
from sean_jax.people.behaviors import graph_behavior
from sean_jax.robots.drive import active_command
from sean_jax.simulation.scenario import finish
from support import programs
from support.quick import quick

STEPS = ("0.01", "0.02", "0.03", "0.05", "0.07", "0.1", "0.125", "0.15", "0.2", "0.25")
TIMES = [f"{hundredths / 100:.2f}" for hundredths in (*range(1, 1000), *range(1000, 60001, 25))]


def exact(step: str) -> list[Fraction]:
    return [Fraction(time) / Fraction(step) for time in TIMES]


@pytest.mark.parametrize("step", STEPS)
def test_durations_are_as_many_ticks_as_exact_arithmetic_says(step):
    found = np.asarray(clock.to_ticks(jnp.asarray([float(time) for time in TIMES], jnp.float32), float(step)))
    wanted = exact(step)
    np.testing.assert_array_equal(np.ceil(found), [math.ceil(ticks) for ticks in wanted])
    np.testing.assert_array_equal(np.floor(found), [math.floor(ticks) for ticks in wanted])
    assert [clock.ceil_ticks(float(time), float(step)) for time in TIMES] == [math.ceil(ticks) for ticks in wanted]


@pytest.fixture(scope="module")
def at_goal(scenario):
    state = programs.reset(scenario, jax.random.key(0))
    return dataclasses.replace(state, robot=dataclasses.replace(state.robot, position=state.task.goal))


@pytest.mark.parametrize("step", quick(("0.05", "0.1", "0.15"), "0.1"))
def test_goals_are_held_for_as_long_as_asked(scenario, at_goal, step):
    """Ticks until ``finish`` completes the task of a robot that stays at its goal; 50, 60 and 100 s are among them."""
    patient = scenario.replace(time_step=float(step), time_limit=1000.0)
    times = [*TIMES[:20], *TIMES[100:1000:60], "50.00", "60.00", "100.00"]

    @jax.jit
    @functools.partial(jax.vmap, in_axes=0)
    def completed(hold):
        def one(state, _):
            after = dataclasses.replace(state, tick=state.tick + 1)
            after = finish(patient.replace(hold_time=hold), state, after)
            return after, after.completed

        return jax.lax.scan(one, at_goal, length=math.ceil(101 / float(step)))[1]

    first = np.asarray(completed(jnp.asarray([float(time) for time in times], jnp.float32))).argmax(1) + 1
    assert first.tolist() == [max(1, math.ceil(Fraction(time) / Fraction(step))) for time in times]


@pytest.mark.parametrize("limit", ("0.7", "1.1", "0.25", "60"))
def test_episodes_last_for_their_time_limit(scenario, at_goal, limit):
    """The least number of steps that last so long: 0.25 s are three of 0.1 s, everywhere."""
    short, last = scenario.replace(time_limit=float(limit), hold_time=jnp.float32(1e6)), math.ceil(Fraction(limit) * 10)
    for tick in (last - 1, last):
        after = finish(short, at_goal, dataclasses.replace(at_goal, tick=jnp.asarray(tick, jnp.int32)))
        assert bool(after.timed_out) == (tick == last)


@pytest.mark.parametrize("step", ("0.02", "0.1"))
def test_commands_wait_for_their_timeout(step):
    model, whole = robots.load("kuri", "twin"), Fraction(step)
    none, start = jnp.full(2, jnp.nan), robots.place(model, jnp.zeros(2), jnp.asarray([1.0, 0.0]))
    body = start.drive_state._replace(command=jnp.ones(2))

    @jax.jit
    def waits(timeout):
        slow = dataclasses.replace(model, command_timeout=timeout)

        def one(body, _):
            command, age = active_command(slow, body, none, float(step))
            return body._replace(age=age), command[0] > 0

        return jax.lax.scan(one, body, length=700)[1].sum()

    for time in ("0.06", "0.25", "0.30", "1.10", "5.00", "10.00"):
        assert int(waits(jnp.float32(time))) == min(math.floor(Fraction(time) / whole), 700)


def test_stays_are_whole_ticks(scenario):
    times = ["0", "0.04", *TIMES[::40]]
    found = graph_behavior._stay(scenario, jnp.asarray([float(time) for time in times], jnp.float32))
    assert found.tolist() == [math.ceil(Fraction(time) * 10) for time in times]
    assert int(graph_behavior._stay(scenario, jnp.float32(3e38))) >= 10**9  # for ever, in practice


@pytest.mark.parametrize(("step", "rate"), (("0.1", 3), ("0.1", 15), ("0.03", 7), ("0.05", 0.5)))
def test_sensors_are_due_after_days_as_at_the_start(step, rate):
    ticks = np.concatenate([np.arange(1, 1000), np.arange(10**7, 10**7 + 1000)])
    due = jax.jit(jax.vmap(lambda tick: sensors.due(tick, float(step), rate)))(jnp.asarray(ticks, jnp.int32))
    share = Fraction(step) * Fraction(rate)
    assert np.asarray(due).tolist() == [math.floor(t * share) > math.floor((t - 1) * share) for t in map(int, ticks)]
