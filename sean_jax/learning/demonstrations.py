"""Demonstrations by simulation: a batch of numbered episodes, recorded once a second until all have ended.

Episode ``i`` is drawn from ``fold_in(chance.key("collect", seed), i)`` alone, so it does not depend on what else is
simulated, and an interrupted collection goes on where it stopped. Outside, recordings are numpy arrays (B, T, ...):
what comes after the end of an episode is zero.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh

from sean_jax import chance, devices, navigation, parallel, sensors
from sean_jax.base import Array, Policy, RobotTask, Scenario, State
from sean_jax.learning.rows import Row, row
from sean_jax.scenario import reset

CHUNK = 10  # s, between two looks at whether all have ended


@dataclasses.dataclass
class Batch:
    """B episodes of at most T rows."""

    rows: dict[str, np.ndarray]  # field of Row -> (B, T, ...)
    lengths: np.ndarray  # (B,) rows of each episode
    completed: np.ndarray  # (B,) bool


@dataclasses.dataclass
class Programs:
    """What is compiled for batches of B episodes."""

    seconds: int  # T
    draw: Callable  # ((scenario, policy, seed, turn), numbers (B,)) -> carry
    advance: Callable  # ((scenario, policy, ...), carry) -> (carry, (rows (B, CHUNK, ...), active (B, CHUNK)))
    over: Mesh
    policy: Policy


def prepare(
    scenario: Scenario, tasks: Sequence[Callable], policy: Policy, eye: sensors.Camera, over: Mesh | None = None
) -> Programs:
    """Programs for episodes of the scenario, whose task is one of those given; compiled at first use.

    Args:
        eye: the depth camera.
        over: devices that share the work; the first one alone if None.
    """
    over = devices.mesh(jax.devices()[:1]) if over is None else over
    draw, advance = functools.partial(_draw, tuple(tasks)), functools.partial(_advance, eye)
    policy = parallel.as_argument(policy)
    seconds = math.ceil(scenario.time_limit - 1e-6)
    return Programs(seconds, devices.spread(over, draw), devices.spread(over, advance, donate=True), over, policy)


def simulate(
    programs: Programs,
    scenario: Scenario,
    seed: int,
    turn: int,
    numbers: np.ndarray,
    watch: Callable[[int], None] | None = None,
) -> Batch:
    """The episodes of those numbers (B,), whose task has the index ``turn``.

    ``watch(seconds)`` is told how far they are. Raises FloatingPointError naming episodes with numbers that are not
    finite.
    """
    fixed = devices.everywhere(programs.over, (scenario, programs.policy, jnp.uint32(seed), jnp.int32(turn)))
    carry = programs.draw(fixed, jnp.asarray(numbers, jnp.uint32))
    made: dict[str, np.ndarray] = {}
    lengths, waiting = np.zeros(len(numbers), np.int64), []

    def settle() -> None:
        for begin, (rows, active) in waiting:
            lengths[:] += _keep(made, rows, np.asarray(active), begin, programs.seconds)
        waiting.clear()

    for done in range(0, programs.seconds, CHUNK):
        if bool(np.asarray(carry[0].completed | carry[0].timed_out).all()):
            break
        carry, chunk = programs.advance(fixed[:2], carry)
        settle()  # what came before, while the device goes on
        waiting.append((done, chunk))
        if watch is not None:
            watch(done)
    settle()
    _refuse_nan(made, numbers)
    return Batch(made, lengths, np.asarray(carry[0].completed))


def _keep(made: dict[str, np.ndarray], rows: Row, active: np.ndarray, begin: int, seconds: int) -> np.ndarray:
    """Put rows (B, CHUNK, ...) from the second ``begin`` on into arrays (B, T, ...); how many each episode has, (B,).

    What comes after an episode's end stays zero.
    """
    end = min(begin + active.shape[1], seconds)
    active = active[:, : end - begin]
    for field in _fields():
        values = np.asarray(getattr(rows, field.name))
        if field.name not in made:
            made[field.name] = np.zeros((len(values), seconds, *values.shape[2:]), values.dtype)
        shown = active.reshape(*active.shape, *(1,) * (values.ndim - 2))
        np.copyto(made[field.name][:, begin:end], values[:, : end - begin], where=shown)
    return active.sum(1)


def _fields() -> tuple:
    return dataclasses.fields(Row)  # pyright: ignore[reportArgumentType]


def _draw(tasks: tuple[Callable, ...], fixed: tuple, number: Array) -> tuple:
    """An episode before its first step, the way to its goal, and no command yet."""
    scenario, policy, seed, turn = fixed

    def task(scenario: Scenario, *others: Any) -> RobotTask:
        return jax.lax.switch(turn, [functools.partial(each, scenario) for each in tasks], *others)

    key = jax.random.fold_in(chance.key("collect", seed), number)
    state = reset(dataclasses.replace(scenario, task=task), key)
    last = navigation.bend_to_goal(scenario.navigation, state.task.goal)
    return parallel.begin(scenario, policy, state), last, jnp.zeros(2, float)


def _advance(eye: sensors.Camera, fixed: tuple, carry: tuple) -> tuple:
    """CHUNK seconds more, and the rows at their beginnings, with whether the episode had not ended by then."""
    scenario, policy, *_ = fixed
    ticks = round(1.0 / scenario.time_step)

    def second(carry: tuple, _) -> tuple:
        before, last, held = carry
        after, actions = jax.lax.scan(tick, before, length=ticks)
        given = jnp.isfinite(actions).all(-1)
        command = jnp.where(given[0], actions[0], held)  # a command that is not finite is no new one
        newest = jnp.max(jnp.where(given, jnp.arange(ticks, dtype=jnp.int32), -1))
        held = jnp.where(newest >= 0, actions[newest], held)
        active = ~(before.completed | before.timed_out)
        return (after, last, held), (row(scenario, before, command, eye, last), active)

    def tick(state: State, _) -> tuple[State, Array]:
        return parallel.advance(scenario, policy, state)

    return jax.lax.scan(second, carry, length=CHUNK)


def _refuse_nan(fields: dict[str, np.ndarray], numbers: np.ndarray) -> None:
    floats = [values for values in fields.values() if values.dtype.kind == "f"]
    faulty = np.any([~np.isfinite(values.reshape(len(values), -1)).all(1) for values in floats], 0)
    if faulty.any():
        listed = ", ".join(map(str, np.asarray(numbers)[faulty][:8]))
        raise FloatingPointError(f"episodes hold numbers that are not finite: {listed}.")
