"""Many episodes in one compiled call, with what is counted on the way (sections III-A, IV-H).

Episode ``i`` is drawn from ``fold_in(chance.key("run", seed), i)`` alone, so it does not depend on how many others
there are.
"""

import contextlib
import dataclasses
import functools
import gc
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from sean_jax import chance, clock, crowding, geometry, parallel
from sean_jax.base import Array, Frame, Policy, RobotTask, Scenario, State
from sean_jax.graph import graph_of
from sean_jax.scenario import reset, results
from sean_jax.stopping import COMPILER

CHUNK = 100  # control steps between two looks at the progress
KEPT = 4  # episodes of which the frames are kept
# What draws starts runs once a batch, so on a CPU it is compiled quickly rather than to be quick.
ONCE = {"cpu": {"xla_backend_optimization_level": 0}}


@struct.dataclass
class Tally:
    """Running counts over the steps of a batch of B episodes in which an episode was active."""

    heat: Array  # (rows, columns) int32 person-steps per cell of the floor, row 0 lowest
    walks: Array  # (M, M) int32 people who walked the edge from the row's node to the column's
    node: Array  # (B, N) int32 node that each person was at last, -1 before the first
    together: Array  # (2 ** S,) int32 steps per set of situations, situation s is bit s
    penetration: Array  # () m, deepest that a body was in an obstacle or off the floor, negative: closest to it
    group_size: Array  # (G,) int32 most members seen in each group
    steps: Array  # (B,) int32 active steps
    faulty: Array  # (B,) bool, a number was NaN or infinite


@dataclasses.dataclass
class Watch:
    """What is told while it runs; each field is a function."""

    compiling: Callable[[str], None] = lambda what: None
    begun: Callable[[float], None] = lambda total: None  # s to simulate at most, over all episodes
    advanced: Callable[[float, float], None] = lambda simulated, speed: None  # s so far, simulated s per s


@dataclasses.dataclass
class Programs:
    """What is compiled for a batch of B episodes; ``scenarios`` take turns."""

    scenarios: Sequence[Scenario]
    size: int  # B
    policy: Policy
    draw: Callable  # ((scenario, policy), seed, numbers (B,)) -> (states, empty tally)
    advance: Callable  # ((scenario, policy), states, tally, counted) -> (states, tally, frames)
    seconds: float  # s, taken to compile


@dataclasses.dataclass
class Batch:
    """What is left of a batch when it is done, as numpy arrays."""

    completed: np.ndarray  # (B,)
    timed_out: np.ndarray  # (B,)
    metrics: dict[str, np.ndarray]  # (B,) or (B, 1 + S)
    tally: Tally
    frames: list[Frame]  # (T, ...) of the kept episodes
    seconds: float = 0.0  # s, taken to simulate


def prepare(scenarios: Sequence[Scenario], policy: Policy, size: int, watch: Watch) -> Programs:
    """Compile everything for batches of ``size`` episodes."""
    began, first, policy = time.perf_counter(), scenarios[0], parallel.as_argument(policy)
    watch.compiling(f"tracing the starts of {size} episodes")
    numbers = jnp.zeros((size,), jnp.uint32)
    tasks = tuple(scenario.task for scenario in scenarios)
    draw = jax.jit(_drawing(tasks, crowding.grid(first.environment)))
    fixed = first, policy
    with _uncollected():
        traced = draw.trace(fixed, jnp.uint32(0), numbers)
    states, tally = traced.out_info
    starting = _Compiling(traced.lower(), ONCE.get(jax.default_backend(), {}))
    chunk = min(CHUNK, _steps(first))
    watch.compiling(f"compiling the starts, tracing {chunk} steps of {size} episodes")
    advance = jax.jit(_advance(chunk, min(KEPT, size)), donate_argnums=(1, 2))
    with _uncollected():
        lowered = advance.lower(fixed, states, tally, jnp.ones((size,), bool))
    stepping = _Compiling(lowered)
    watch.compiling(f"compiling {chunk} steps of {size} episodes")
    return Programs(scenarios, size, policy, starting.done(), stepping.done(), time.perf_counter() - began)


def run_batch(programs: Programs, seed: int, base: int, kept: int, advanced: Callable[[float, float], None]) -> Batch:
    """The episodes from number ``base`` on until all have ended; the first ``kept`` count, the rest fill the batch.

    ``advanced(seconds, simulated)`` is told how far each episode is and how much robot time is simulated.
    """
    first, size = programs.scenarios[0], programs.size
    fixed, numbers = (first, programs.policy), jnp.asarray(np.arange(base, base + size), jnp.uint32)
    states, tally = programs.draw(fixed, jnp.uint32(seed), numbers)
    counted, frames = jnp.arange(size) < kept, []
    chunk = min(CHUNK, _steps(first))
    for done in range(chunk, _steps(first) + chunk, chunk):
        states, tally, shown = programs.advance(fixed, states, tally, counted)
        if base == 0:
            frames.append(jax.tree.map(np.asarray, shown))
        over = bool(np.all(np.asarray(states.completed | states.timed_out)))
        simulated = float(np.asarray(tally.steps).sum()) * first.time_step
        advanced(first.time_limit if over else min(done * first.time_step, first.time_limit), simulated)
        if over:
            break
    measured = jax.vmap(results, (None, 0))(first, states)
    ended = (states.completed, states.timed_out, measured, (tally.steps, tally.faulty))
    completed, timed_out, measured, (steps, faulty) = jax.tree.map(lambda leaf: np.asarray(leaf)[:kept], ended)
    tally = dataclasses.replace(jax.tree.map(np.asarray, tally), steps=steps, faulty=faulty)
    return Batch(completed, timed_out, measured, tally, _episodes(frames, min(KEPT, kept)) if frames else [])


@contextlib.contextmanager
def _uncollected() -> Iterator[None]:
    """Tracing makes millions of objects that stay; to look for cycles among them takes a fifth of its time."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


def _steps(scenario: Scenario) -> int:
    return clock.ticks(scenario.time_limit, scenario.time_step)


class _Compiling:
    """A program that is compiled in a thread of its own, so that Ctrl-C is not kept waiting by the compiler."""

    def __init__(self, lowered: Any, options: dict[str, Any] | None = None) -> None:
        self._outcome: Any = None
        self._thread = threading.Thread(target=self._work, args=(lowered, options), name=COMPILER, daemon=True)
        self._thread.start()

    def _work(self, lowered: Any, options: dict[str, Any] | None) -> None:
        try:
            self._outcome = lowered.compile(compiler_options=options or None)
        except Exception as error:  # carried over to the thread that waits
            self._outcome = error

    def done(self) -> Callable:
        """The program, when it is compiled."""
        while self._thread.is_alive():
            time.sleep(0.02)
        if isinstance(self._outcome, Exception):
            raise self._outcome
        return self._outcome


def _drawing(tasks: tuple[Callable, ...], cells: tuple[int, int]) -> Callable:
    """((scenario, policy), seed, numbers (B,)) -> the starts of those episodes, which take turns at ``tasks``."""

    def draw(fixed: tuple[Scenario, Policy], seed: Array, numbers: Array) -> tuple[State, Tally]:
        scenario, policy = fixed

        def one(number: Array) -> State:
            turn = (number % len(tasks)).astype(jnp.int32)

            def task(scenario: Scenario, *others: Any) -> RobotTask:
                return jax.lax.switch(turn, [functools.partial(each, scenario) for each in tasks], *others)

            key = jax.random.fold_in(chance.key("run", seed), number)
            return parallel.begin(scenario, policy, reset(dataclasses.replace(scenario, task=task), key))

        states = jax.vmap(one)(numbers)
        return states, _empty_tally(scenario, states, cells)

    return draw


def _empty_tally(scenario: Scenario, states: State, cells: tuple[int, int]) -> Tally:
    size, graph = states.tick.shape[0], graph_of(scenario)
    nodes = 0 if graph is None else len(graph.names)
    return Tally(
        heat=jnp.zeros(cells, jnp.int32),
        walks=jnp.zeros((nodes, nodes), jnp.int32),
        node=jnp.full((size, scenario.people), crowding.NOWHERE, jnp.int32),
        together=jnp.zeros((2 ** len(scenario.situations),), jnp.int32),
        penetration=jnp.full((), -1e9, float),
        group_size=jnp.zeros(states.groups.radius.shape[-1:], jnp.int32),
        steps=jnp.zeros((size,), jnp.int32),
        faulty=jnp.zeros((size,), bool),
    )


def _advance(steps: int, kept: int) -> Callable:
    """((scenario, policy), states, tally, counted) -> (states, tally, frames (steps, kept, ...)), ``steps`` later."""

    def advance(fixed: tuple[Scenario, Policy], states: State, tally: Tally, counted: Array):
        scenario, policy = fixed

        def one(carry, _):
            before, tally = carry
            states, frames = jax.vmap(lambda state: parallel.simulate(scenario, policy, state, 1))(before)
            frames = jax.tree.map(lambda leaf: leaf[:, 0], frames)
            tally = _count(scenario, tally, frames, states.pedestrians.present, frames.active & counted)
            return (states, tally), jax.tree.map(lambda leaf: leaf[:kept], frames)

        (states, tally), frames = jax.lax.scan(one, (states, tally), None, length=steps)
        return states, tally, frames

    return advance


def _count(scenario: Scenario, tally: Tally, frames: Frame, present: Array, active: Array) -> Tally:
    """One more step of B episodes: ``frames`` (B, ...), people ``present`` (B, N), ``active`` (B,)."""
    here = present & active[:, None]
    x, y = frames.people[..., 0], frames.people[..., 1]
    rows, columns = tally.heat.shape
    cell = crowding.cell_of(scenario.environment, (rows, columns), frames.people)
    node, walks = tally.node, tally.walks
    if (graph := graph_of(scenario)) is not None:
        node, walked = jax.vmap(crowding.follow, (None, 0, 0, 0))(graph, tally.node, frames.people, present)
        walks = walks.at[tally.node, node].add((walked & active[:, None]).astype(jnp.int32))
    distance, _, _ = jax.vmap(geometry.from_box, (None, None, 0))(x, y, scenario.environment.obstacles)
    edge = geometry.to_border(scenario.environment, x, y)
    nearest = jnp.minimum(jnp.min(distance, 0, initial=jnp.inf), edge)
    inside = jnp.where(here, scenario.forces.radius - nearest, -jnp.inf)
    bits = jnp.asarray(2 ** np.arange(frames.situations.shape[-1]), jnp.int32)
    held = jnp.sum(jnp.where(frames.situations, bits[None, :], 0), -1)
    index = jnp.arange(tally.group_size.shape[0], dtype=jnp.int32)
    members = jnp.sum((frames.group[..., None] == index[None, None, :]) & here[..., None], 1, dtype=jnp.int32)
    sound = jnp.isfinite(frames.people).all((1, 2)) & jnp.isfinite(frames.position).all(-1)
    sound &= jnp.isfinite(frames.people_velocity).all((1, 2)) & jnp.isfinite(frames.velocity).all(-1)
    return dataclasses.replace(
        tally,
        heat=tally.heat.ravel().at[cell].add(here.astype(jnp.int32)).reshape(rows, columns),
        walks=walks,
        node=node,
        together=tally.together.at[held].add(active.astype(jnp.int32)),
        penetration=jnp.maximum(tally.penetration, jnp.max(inside, initial=-jnp.inf)),
        group_size=jnp.maximum(tally.group_size, jnp.max(members, 0)),
        steps=tally.steps + active.astype(jnp.int32),
        faulty=tally.faulty | (~sound & active),
    )


def _episodes(chunks: list[Frame], kept: int) -> list[Frame]:
    """The frames (T, ...) of each kept episode, cut after its last active step."""
    frames = jax.tree.map(lambda *xs: np.concatenate(xs), *chunks)
    lengths = [max(1, int(frames.active[:, i].sum())) for i in range(kept)]
    return [jax.tree.map(lambda leaf: leaf[:n, i], frames) for i, n in enumerate(lengths)]  # noqa: B023
