"""Metrics (section IV-H): values that are updated in each step of a robot's task, in constant memory.

Most metrics are one line, a constructor of this module around a function of a snapshot:

    def close(snapshot):
        x, y = (snapshot.people.position - snapshot.position[None, :]).T
        return (snapshot.people.present & (length(x, y) < 0.6)).any()

    time_close = duration(close, title="time close to people")
    times_close = count_onsets(close)

A metric that has to remember more gives ``Metric`` its own ``init``, ``update`` and ``compute``.

Figures that are split by situation have one axis, "columns": overall first, then each situation, 1 + S in all. An
amount counts overall and in every situation that occurs at the end of the step. The keywords of all constructors are
fields of ``Metric``; without a definition, the first line of the function's docstring is taken.
"""

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, TypedDict, Unpack

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, PyTree

from sean_jax.core import clock, user_calls
from sean_jax.core.data_types import Array, Snapshot
from sean_jax.core.errors import InputError

MEAN = "Mean over episodes."  # the definition of a metric that has none
CURE = "give a Metric, a condition snapshot -> bool, or an amount (before, after) -> number."
RESERVED = ("episode", "task", "completed", "timed_out", "seconds", "share")  # columns of every episodes.csv
UNSET = float(np.finfo(np.float32).max)  # no value yet; finite, like everything in a state

Condition = Callable[[Snapshot], Array]  # snapshot -> () bool
Quantity = Callable[[Snapshot], Array]  # snapshot -> () number
Amount = Callable[[Snapshot, Snapshot], Array]  # (before, after) -> () number


# Equal by identity: metrics are hashed at each call of a compiled function, so that has to be quick.
@dataclass(frozen=True, eq=False)
class Metric:
    """A streaming metric, and how the table and the report show it.

    ``compute`` gives () or, where the metric can be split by situation, (1 + S,) with the overall figure first. A mean
    or an extreme over a situation that never occurred is NaN there, since no number would be true; sums are zero.

    Args:
        init: ``snapshot -> value``, the running value, any pytree, before the first step.
        update: ``(value, before, after) -> value``, the running value one step later. It keeps shapes and types.
        compute: ``value -> array``, the figure so far.
        unit: "1" for pure numbers.
        title: of the row in the table; the metric's name if empty.
        definition: one sentence.
        digits: after the decimal point.
        kind: "count" of events, "share" from 0 to 1, shown in percent, else "number".
        completed_only: means leave out episodes that were not completed.
        headline: the table in the terminal has it; the report and episodes.csv have every metric.
        better: "lower" or "higher" values are better; "" if neither is, as of a speed.
        best: the best value: values beyond it are no better. A number, or "goal_radius" for the scenario's.
    """

    init: Callable[[Snapshot], PyTree]
    update: Callable[[PyTree, Snapshot, Snapshot], PyTree]
    compute: Callable[[PyTree], Array]
    unit: str = "1"
    title: str = ""
    definition: str = ""
    digits: int = 2
    kind: Literal["number", "count", "share"] = "number"
    completed_only: bool = False
    headline: bool = True
    better: Literal["lower", "higher", ""] = ""
    best: float | Literal["goal_radius"] | None = None


def as_metric(value: Metric | Callable, name: str = "") -> Metric:
    """A ``Metric`` unchanged, or the metric of a function; equal arguments give the same metric, so it compiles once.

    A function of one snapshot is a condition: the metric is the time [s] during which it holds. A function of two
    snapshots, before and after a step, is an amount: the metric is its sum over the steps.

    Raises:
        InputError: it is none of these, or results have another column of that name.
    """
    if name in RESERVED:
        raise InputError(f"metrics: '{name}' is a column of episodes.csv already; choose another name.")
    if not isinstance(value, Metric) and not callable(value):
        raise InputError(f"metrics: {name or 'a metric'} is {value!r}; {CURE}")
    return _as_metric(value, name)


@functools.cache
def _as_metric(value: Metric | Callable, name: str) -> Metric:
    metric = value if isinstance(value, Metric) else _from_function(value, name)
    title = metric.title or name.replace("_", " ")
    definition = metric.definition or MEAN
    unchanged = (title, definition) == (metric.title, metric.definition)
    return metric if unchanged else replace(metric, title=title, definition=definition)


def _from_function(function: Callable, name: str) -> Metric:
    """A metric of a function of one or two snapshots."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except ValueError:  # a builtin without a signature
        parameters = ()
    number = sum(parameter.default is parameter.empty for parameter in parameters)
    if number not in (1, 2):
        raise InputError(f"metrics: {name or 'a metric'} is {function!r}; {CURE}")
    return duration(function) if number == 1 else total(function)


# --- constructors of the common kinds ---


class Words(TypedDict, total=False):
    """Fields of ``Metric`` that every constructor takes."""

    title: str
    definition: str
    digits: int
    headline: bool
    better: Literal["lower", "higher", ""]
    best: float | Literal["goal_radius"] | None


class WordsAndUnit(Words, total=False):
    """Fields of ``Metric`` that the constructors for numbers take."""

    unit: str


def duration(condition: Condition, **words: Unpack[Words]) -> Metric:
    """Time [s] during which a condition holds, overall and in each situation: the steps at whose end it does."""

    def update(value: Duration, before: Snapshot, after: Snapshot) -> Duration:
        weights = situation_weights(after)
        return value._replace(steps=value.steps + jnp.where(_truth(condition, after), weights, 0.0))

    return _metric(condition, zero_duration, update, in_seconds, unit="s", **{"digits": 1, **words})


def share_of_time(condition: Condition, **words: Unpack[Words]) -> Metric:
    """Share of the time, from 0 to 1, during which a condition holds, overall and in each situation."""

    def update(value: Ratio, before: Snapshot, after: Snapshot) -> Ratio:
        weights = situation_weights(after)
        return Ratio(value.amount + jnp.where(_truth(condition, after), weights, 0.0), value.weight + weights)

    return _metric(condition, zero_ratio, update, ratio, kind="share", **{"digits": 1, **words})


def count_onsets(condition: Condition, among: Condition | None = None, **words: Unpack[Words]) -> Metric:
    """Number of onsets of a condition, overall and in each situation: it holds after a step and not before it.

    Args:
        condition: ``snapshot -> () bool``, or (N,) bool if each of N people counts by themselves.
        among: of the same shape: the events that count, as of the snapshot after the step; all if None.
    """

    def update(value: Array, before: Snapshot, after: Snapshot) -> Array:
        onset = _truth(condition, after, ndim=None) & ~_truth(condition, before, ndim=None)
        if among is not None:
            onset = onset & _truth(among, after, ndim=None)
        return value + jnp.where(onset, 1.0, 0.0).sum() * situation_weights(after)

    return _metric(condition, zeros, update, identity, kind="count", **words)


def total(amount: Amount, **words: Unpack[WordsAndUnit]) -> Metric:
    """Sum over the steps of an amount ``(before, after) -> () number``, overall and in each situation."""

    def update(value: Array, before: Snapshot, after: Snapshot) -> Array:
        return value + _number(amount, before, after) * situation_weights(after)

    return _metric(amount, zeros, update, identity, **words)


def mean(amount: Amount, **words: Unpack[WordsAndUnit]) -> Metric:
    """Mean over the steps of an amount ``(before, after) -> () number``, overall and in each situation."""

    def update(value: Ratio, before: Snapshot, after: Snapshot) -> Ratio:
        weights = situation_weights(after)
        return Ratio(value.amount + _number(amount, before, after) * weights, value.weight + weights)

    return _metric(amount, zero_ratio, update, ratio, **words)


def minimum(quantity: Quantity, *, by_situation: bool = True, **words: Unpack[WordsAndUnit]) -> Metric:
    """Minimum of a quantity ``snapshot -> () number`` from the first snapshot on; () unless ``by_situation``."""
    return _extreme(quantity, jnp.minimum, UNSET, by_situation, words)


def maximum(quantity: Quantity, *, by_situation: bool = True, **words: Unpack[WordsAndUnit]) -> Metric:
    """Maximum of a quantity ``snapshot -> () number`` from the first snapshot on; () unless ``by_situation``."""
    return _extreme(quantity, jnp.maximum, -UNSET, by_situation, words)


def final(
    quantity: Quantity, *, kind: Literal["number", "count", "share"] = "number", **words: Unpack[WordsAndUnit]
) -> Metric:
    """Value () of a quantity ``snapshot -> () number`` at the end."""

    def init(snapshot: Snapshot) -> Array:
        return _number(quantity, snapshot)

    return _metric(quantity, init, lambda value, before, after: init(after), identity, kind=kind, **words)


def _extreme(quantity: Quantity, choose: Callable, unset: float, by_situation: bool, words: WordsAndUnit) -> Metric:
    def now(snapshot: Snapshot) -> Array:
        value = _number(quantity, snapshot)
        return jnp.where(situation_weights(snapshot) > 0.0, value, unset) if by_situation else value

    def compute(value: Array) -> Array:
        return jnp.where(value == unset, jnp.nan, value) if by_situation else value

    return _metric(quantity, now, lambda value, before, after: choose(value, now(after)), compute, **words)


def _metric(function: Callable, init: Callable, update: Callable, compute: Callable, **fields: Any) -> Metric:
    """A metric with the first line of the function's docstring as its definition, if the fields have none."""
    metric = Metric(init, update, compute, **fields)
    text = inspect.getdoc(function) if inspect.isroutine(function) else None
    return replace(metric, definition=text.splitlines()[0]) if text and not metric.definition else metric


def _truth(condition: Condition, snapshot: Snapshot, ndim: int | None = 0) -> Array:
    """The condition's value, checked while the program is traced."""
    value = user_calls.call("metrics", condition, "snapshot", snapshot)
    user_calls.check_array("metrics", condition, value, None, None, "compare numbers")
    value = jnp.asarray(value)
    if value.dtype != bool or value.ndim > (1 if ndim is None else ndim):
        if ndim is None:
            raise InputError(
                f"metrics: {_name(condition)}(snapshot) gives {value.dtype} {value.shape}, not () bool or (N,) bool; "
                "for numbers take metrics.total, mean, minimum, maximum or final."
            )
        raise InputError(
            f"metrics: {_name(condition)}(snapshot) gives {value.dtype} {value.shape}, not () bool; for numbers "
            "take metrics.total, mean, minimum, maximum or final."
        )
    return value


def _number(function: Callable, *snapshots: Snapshot) -> Array:
    """The function's value as a () float, checked while the program is traced."""
    value = user_calls.call("metrics", function, "snapshot" if len(snapshots) == 1 else "before, after", *snapshots)
    user_calls.check_array("metrics", function, value, None, None, "give one number")
    value = jnp.asarray(value)
    if value.ndim:
        if len(snapshots) == 1:
            raise InputError(
                f"metrics: {_name(function)}(snapshot) gives an array {value.shape}, not one number (); reduce it with "
                "sum, min or mean."
            )
        raise InputError(
            f"metrics: {_name(function)}(before, after) gives an array {value.shape}, not one number (); reduce it "
            "with sum, min or mean."
        )
    return value.astype(float)


def _name(function: Callable) -> str:
    return getattr(function, "__name__", repr(function))


# --- running values, split by situation ---


class Duration(NamedTuple):
    """A time as a number of steps: a sum of rounded steps would drift."""

    steps: Float[Array, " columns"]
    step: Float[Array, ""]  # s


class Ratio(NamedTuple):
    """A sum and the sum of its weights."""

    amount: Float[Array, " columns"]
    weight: Float[Array, " columns"]


def situation_weights(snapshot: Snapshot) -> Float[Array, " columns"]:
    """(1 + S,) 1 overall, then 1 for each situation that occurs at that moment, else 0."""
    return jnp.concatenate([jnp.ones(1, float), snapshot.situations.astype(float)])


def zeros(snapshot: Snapshot) -> Float[Array, " columns"]:
    """(1 + S,) zeros, the initial value of a sum."""
    return jnp.zeros_like(situation_weights(snapshot))


def zero_duration(snapshot: Snapshot) -> Duration:
    """The initial value of a time."""
    return Duration(zeros(snapshot), jnp.asarray(snapshot.time_step, float))


def zero_ratio(snapshot: Snapshot) -> Ratio:
    """The initial value of a ratio."""
    return Ratio(zeros(snapshot), zeros(snapshot))


def in_seconds(value: Duration) -> Float[Array, " columns"]:
    """A time in seconds."""
    return value.steps * value.step


def ratio(value: Ratio) -> Float[Array, " columns"]:
    """A sum divided by its weight: 0 overall while there is nothing, NaN for situations that did not occur."""
    none = value.weight == 0.0
    quotient = jnp.where(none, 0.0, value.amount / jnp.where(none, 1.0, value.weight))
    return jnp.concatenate([quotient[:1], jnp.where(none[1:], jnp.nan, quotient[1:])])


def identity(value: Array) -> Array:
    """``compute`` of metrics whose running value is the figure."""
    return value


# --- samples at 1 Hz, as SEAN 2.0 takes them of the path ---


def second_has_passed(snapshot: Snapshot) -> Bool[Array, ""]:
    """Whether a whole second has passed within the last step, when SEAN samples its path metrics.

    At 0.1 s that is every tenth tick; at 0.15 s the ticks 7, 14, 20, 27, ... of 1.05, 2.1, 3.0, 4.05 s.
    """
    return _whole_seconds(snapshot, snapshot.tick) > _whole_seconds(snapshot, snapshot.tick - 1)


def time_since_sample(snapshot: Snapshot) -> Float[Array, ""]:
    """Time [s] since the last sample before this tick: 1 where seconds are whole steps, else about that."""
    over, under = clock.events_per_tick(snapshot.time_step)
    sampled = -(
        (-_whole_seconds(snapshot, snapshot.tick - 1) * under) // over
    )  # the first tick at or after that second
    return (snapshot.tick - sampled).astype(float) * snapshot.time_step


def _whole_seconds(snapshot: Snapshot, tick: Int[Array, ""]) -> Int[Array, ""]:
    """Whole seconds that have passed at a tick, exact: a product in float32 would miss some."""
    over, under = clock.events_per_tick(snapshot.time_step)
    return tick * over // under
