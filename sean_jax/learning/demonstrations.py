"""Demonstrations by simulation: rows of numbered episodes, recorded at a rate until all have ended.

Episode ``i`` is drawn from ``fold_in(prng.key("collect", seed), i)`` alone, so it does not depend on what else is
simulated, and an interrupted collection goes on where it stopped. Outside, recordings are numpy arrays (B, T, ...):
what comes after the end of an episode is zero.
"""

import dataclasses
import functools
import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import navigation, sensors
from sean_jax.base import Array, Scenario, State
from sean_jax.learning.examples import Row, row
from sean_jax.runner import Callbacks, Record, Runner, not_finite


@dataclasses.dataclass
class Batch:
    """B episodes of at most T rows."""

    rows: dict[str, np.ndarray]  # field of Row -> (B, T, ...)
    lengths: np.ndarray  # (B,) rows of each episode
    completed: np.ndarray  # (B,) bool


def record(
    scenario: Scenario, camera: sensors.Camera, command: Callable[[State], Array] | None = None, rate: int = 1
) -> Record:
    """What a collection keeps of episodes: rows.

    Args:
        command: tells the command that is recorded, from the state after a step; the one that was given if None.
        rate: rows a second.

    Returns:
        The record for a ``Runner``.
    """
    return Record(_init, functools.partial(_update, camera), steps_of_row(scenario, rate), command)


def steps_of_row(scenario: Scenario, rate: int) -> int:
    """How many steps of control there are from one row to the next.

    Args:
        rate: rows a second, a divisor of the steps in a second.
    """
    return round(1.0 / scenario.time_step) // rate


def simulate(runner: Runner, seed: int, shard: int, stream: int, watch: Callable[[int], None] | None = None) -> Batch:
    """A shard: the episodes from number ``shard * runner.size`` on, all of one stream.

    Args:
        runner: whose record is that of ``record``.
        watch: is told the seconds that are simulated.

    Raises:
        FloatingPointError: a number is not finite; the message names the episodes.
    """
    told = Callbacks(advanced=lambda seconds, simulated: watch(round(seconds)) if watch is not None else None)
    first = shard * runner.size
    batch = runner.run(seed, first, index=np.full(runner.size, stream), callbacks=told)
    scenario = runner.scenarios[0]
    rate = round(1.0 / scenario.time_step) // runner.record.every
    most = rate * math.ceil(scenario.time_limit - 1e-6)
    rows: dict[str, np.ndarray] = {}
    lengths = np.zeros(runner.size, np.int64)
    begin = 0
    for values, active in batch.rows:
        lengths += _put(rows, values, active, begin, most)
        begin += len(active)
    floats = [values for values in rows.values() if values.dtype.kind == "f"]
    faulty = np.any([~np.isfinite(values.reshape(len(values), -1)).all(1) for values in floats], 0)
    if faulty.any():
        raise FloatingPointError(not_finite(first + np.flatnonzero(faulty), runner.size))
    return Batch(rows, lengths, np.asarray(batch.states.completed))


def _put(made: dict[str, np.ndarray], rows: Row, active: np.ndarray, begin: int, most: int) -> np.ndarray:
    """Put rows (C, B, ...) from row ``begin`` on into arrays (B, most, ...); how many each episode has, (B,)."""
    end = min(begin + len(active), most)
    active = active[: end - begin].T
    for field in dataclasses.fields(Row):  # pyright: ignore[reportArgumentType]
        values = np.swapaxes(np.asarray(getattr(rows, field.name)), 0, 1)
        if field.name not in made:
            made[field.name] = np.zeros((len(values), most, *values.shape[2:]), values.dtype)
        where = active.reshape(*active.shape, *(1,) * (values.ndim - 2))
        np.copyto(made[field.name][:, begin:end], values[:, : end - begin], where=where)
    return active.sum(1)


def _init(scenario: Scenario, states: State) -> tuple[Array, Array]:
    """The way to the goal of each episode, and no command yet."""
    last = jax.vmap(lambda goal: navigation.last_arc_to_goal(scenario.navigation, goal))(states.task.goal)
    return last, jnp.zeros((*states.tick.shape, 2), float)


def _update(
    camera: sensors.Camera, scenario: Scenario, before: State, after: State, actions: Array, active: Array, total: tuple
) -> tuple[tuple[Array, Array], tuple[Row, Array]]:
    """The rows before the latest steps, with whether the episodes had not ended by then."""

    def one(before: State, actions: Array, last: Array, latest: Array) -> tuple[Array, Row]:
        given = jnp.isfinite(actions).all(-1)
        command = jnp.where(given[0], actions[0], latest)  # a command that is not finite is no new one
        newest = jnp.max(jnp.where(given, jnp.arange(len(actions), dtype=jnp.int32), -1))
        latest = jnp.where(newest >= 0, actions[newest], latest)
        return latest, row(scenario, before, command, camera, last)

    last, latest = total
    latest, rows = jax.vmap(one, (0, 1, 0, 0))(before, actions, last, latest)
    return (last, latest), (rows, active)
