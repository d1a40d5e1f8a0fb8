"""The one runner of episodes: batches of numbered episodes, each until its end, of scenarios in turn (section V).

Episode ``i`` is drawn from ``fold_in(prng.key(use, seed), i)`` alone, so it does not depend on the number of episodes,
the number of devices or an interruption. A ``Record`` defines what is stored of the steps.
"""

import contextlib
import dataclasses
import functools
import gc
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import PyTree

from sean_jax.core import clock, devices, random_streams
from sean_jax.core.data_types import Array, Policy, PolicyLike, RobotTask, Scenario, State, as_policy
from sean_jax.io import interrupts
from sean_jax.simulation import team
from sean_jax.simulation.episodes import init_policy, policy_step
from sean_jax.simulation.scenario import reset, results
from sean_jax.simulation.scenario_stack import Stack, as_stacks, select
from sean_jax.tasks import choose

CHUNK = 10.0  # s, between two looks at the progress
MAX_BATCH, MAX_BATCH_CPU = 4_200, 64  # default episodes per batch
# The program that draws starts runs once a batch, so a CPU compiles it without optimizing.
QUICK_COMPILE = {"cpu": {"xla_backend_optimization_level": 0}}


batch_results = jax.jit(jax.vmap(results, (None, 0)))
"""The ``results`` of states (B, ...) of a scenario; without jit each operation of each metric is a program."""


class Record(NamedTuple):
    """The record of a batch of B episodes: a total over steps, and rows that are stacked over time.

    ``init(floors, states)`` is the total before the first step; ``update(floors, before, after, actions, active,
    total)`` gives the new total and a row, every ``every`` steps of control. ``floors.vmap`` maps over rows. ``before``
    and ``after`` are states (B, ...), ``actions`` the commands (every, B, 2) in between, ``active`` (B,) whether an
    episode had not yet ended. ``command(state)``, with the state after a step, replaces the command of that step in
    ``actions``.
    """

    init: Callable[[Stack[Scenario], State], PyTree]
    update: Callable[[Stack[Scenario], State, State, Array, Array, PyTree], tuple[PyTree, PyTree]]
    every: int = 1
    command: Callable[[State], Array] | None = None


NO_RECORD = Record(lambda *_: (), lambda *_: ((), ()))
"""Keeps nothing."""


@struct.dataclass
class LoopState:
    """The carry of the loop over the steps of B episodes."""

    states: State  # (B, ...)
    steps: Array  # (B,) int32, before the episode ended
    faulty: Array  # (B,) bool, a number was NaN or infinite
    total: PyTree  # of the record


@dataclasses.dataclass
class Callbacks:
    """Functions that a runner calls while episodes run."""

    compiling: Callable[[str], None] = lambda what: None
    advanced: Callable[[float, float], None] = lambda seconds, simulated: None  # s of each episode, s of all together
    rows: Callable[[PyTree], None] | None = None  # the record's rows of a chunk, as numpy arrays (T, ...)
    drive: Callable[[int, State], Policy] | None = None  # number of the first episode, states (B, ...) -> the policy
    # of the next chunk, in place of the runner's, from which it differs in its leaves alone


class Batch(NamedTuple):
    """The end of a batch, of its first ``count`` episodes."""

    states: State  # (count, ...), at the end
    steps: np.ndarray  # (count,)
    total: PyTree  # of the record, as numpy arrays
    rows: list[PyTree]  # of the record, for each chunk of time, as numpy arrays (T, ...)


class Fixed(NamedTuple):
    """What all steps of a batch have in common."""

    floors: Stack[Scenario]
    varying: dict[int, Array]  # of ``varying_leaves``
    policy: PyTree


class _Receiver:
    """Copies the record's rows of each chunk to the host, one chunk later."""

    def __init__(self, hand_on: Callable[[PyTree], None] | None, keep: bool) -> None:
        self.hand_on = hand_on
        self.keep = keep
        self.kept: list[PyTree] = []
        self._waiting: PyTree = None  # rows that the device computes

    def receive(self, rows: PyTree) -> None:
        """Take the rows that the device has begun to compute, and copy those before them."""
        self.finish()
        if self.keep or self.hand_on is not None:
            self._waiting = rows

    def finish(self) -> None:
        """Copy the rows that wait."""
        if self._waiting is None:
            return
        rows = jax.tree.map(np.asarray, self._waiting)
        self._waiting = None
        if self.hand_on is not None:
            self.hand_on(rows)
        if self.keep:
            self.kept.append(rows)


class Runner:
    """Programs for batches of ``size`` episodes, compiled at first use or by ``compile``."""

    def __init__(
        self,
        scenarios: Scenario | Stack[Scenario] | Sequence[Scenario | Stack[Scenario]],
        policy: PolicyLike,
        size: int,
        use: str,
        record: Record = NO_RECORD,
        mesh: Mesh | None = None,
        chunk: float = CHUNK,
        drivers: int | None = None,
    ):
        """Scenarios take turns; they may differ in leaves and in their task, and in nothing else.

        Floors of a stack take turns as well: episode i is on floor (i // scenarios) % floors. Of a team of M robots
        (``team.of_scenarios``), rows i M to i M + M - 1 are the robots of episode i, and "episodes" are rows here.

        Args:
            policy: one policy, or ``drivers`` of them along a leading axis of its leaves.
            size: episodes at once, rounded up to a multiple of the devices and drivers (``batch_size``).
            use: of the seed, one of ``random_streams.USES``.
            mesh: devices that share the work; all if None.
            chunk: s between two looks at the progress.
            drivers: number of policies, each of which drives an equal share of a batch, one after the other.

        Raises:
            ValueError: the static structure of the scenarios differs.
        """
        stacks = as_stacks(scenarios)
        is_team = stacks[0].member.others is not None
        self.robots = stacks[0].size if is_team else 1
        self.scenarios = [part.member for part in stacks]
        self.floors = replace(stacks[0], names=(), turn=1 if is_team else len(stacks))
        self.policy = as_policy(policy)
        self.use = use
        self.record = record
        self.mesh = devices.mesh() if mesh is None else mesh
        self.size = batch_size(size, self.floors, self.robots * math.lcm(self.mesh.size, drivers or 1))
        self.compile_seconds = 0.0

        # A chunk of time is a whole number of rows of the record.
        first = self.scenarios[0]
        self._steps = clock.ceil_ticks(first.time_limit, first.time_step)
        rows = max(1, round(chunk / first.time_step / record.every))
        self.chunk = min(rows * record.every, -(-self._steps // record.every) * record.every)

        self._varying = varying_leaves(self.scenarios)
        begin = functools.partial(_begin, record, drivers)
        advance = functools.partial(_advance, record, self.chunk // record.every, drivers)
        tasks = tuple(each.task for each in self.scenarios)
        jitted = self._on_one_device if self.mesh.size == 1 else self._on_several_devices
        self._draw, self._begin, self._advance = jitted(tasks, begin, advance)

    def _on_one_device(self, tasks: tuple, begin: Callable, advance: Callable) -> tuple[Any, Any, Any]:
        """The programs."""
        leaves, structure = jax.tree.flatten(self._places(0))
        shapes = tuple((jnp.shape(leaf), jnp.result_type(leaf)) for leaf in leaves)
        draw = _drawing(tasks, self.use, structure, shapes)
        return draw, jax.jit(begin, donate_argnums=1), jax.jit(advance, donate_argnums=1)

    def _on_several_devices(self, tasks: tuple, begin: Callable, advance: Callable) -> tuple[Any, Any, Any]:
        """The programs; arrays with an axis B are split over the devices."""
        split = NamedSharding(self.mesh, PartitionSpec(devices.AXIS))
        whole = NamedSharding(self.mesh, PartitionSpec())

        def sharding(leaf: jax.ShapeDtypeStruct) -> NamedSharding:
            return split if leaf.ndim and leaf.shape[0] == self.size else whole

        draw = functools.partial(_draw, tasks, self.use)
        seed, numbers, index = self._arguments()
        states = jax.eval_shape(draw, self._places(0), seed, numbers, index)
        running = jax.eval_shape(begin, self._fixed(0), states, index)
        states_split, running_split = (jax.tree.map(sharding, shapes) for shapes in (states, running))
        return (
            jax.jit(draw, in_shardings=(whole, whole, split, split), out_shardings=states_split),
            jax.jit(begin, in_shardings=(whole, states_split, split), out_shardings=running_split, donate_argnums=1),
            jax.jit(
                advance,
                in_shardings=(whole, running_split, split, split),
                out_shardings=(running_split, None),
                donate_argnums=1,
            ),
        )

    def _arguments(self) -> tuple[Array, Array, Array]:
        """Seed, numbers and scenario of each episode, of the right shapes."""
        return jnp.uint32(0), jnp.zeros((self.size,), jnp.uint32), jnp.zeros((self.size,), jnp.int32)

    def _fixed(self, first: int) -> Fixed:
        """What the steps of a batch have in common that begins with an episode of that number."""
        return Fixed(*self._places(first), self.policy)

    def _places(self, first: int) -> tuple[Stack[Scenario], dict[int, Array]]:
        return self._floors_from(first), self._varying

    def _floors_from(self, first: int) -> Stack[Scenario]:
        """The floors of a batch that begins with an episode of that number; each once, if their turns fill it.

        Raises:
            ValueError: the batch begins within the turn of a floor.
        """
        if self.floors.size == 1:
            return self.floors
        turn = self.floors.turn
        count = self.floors.size
        if first % turn:
            raise ValueError(f"first: {first} is no multiple of the {turn} scenarios, which share a floor.")
        index = self.floor_indices(first)[::turn]
        if self.size % (count * turn) == 0:
            index = index[:count]
        return self.floors if np.array_equal(index, np.arange(count)) else self.floors.take(index)

    def floor_indices(self, first: int) -> np.ndarray:
        """(B,) index of the floor of each episode of a batch that begins with an episode of that number."""
        return np.arange(first, first + self.size) // self.floors.turn % self.floors.size

    def compile(self, callbacks: Callbacks) -> None:
        """Compile everything now, in a thread that Ctrl-C need not wait for."""
        start = time.perf_counter()
        callbacks.compiling(f"tracing the starts of {self.size} episodes")
        seed, numbers, index = self._arguments()
        counted = jnp.ones((self.size,), bool)
        with _uncollected():
            draw = self._draw.trace(self._places(0), seed, numbers, index)

        # The starts compile in a thread while the steps are traced.
        quickly = QUICK_COMPILE.get(jax.default_backend(), {}) if self.scenarios[0].warm_up == 0.0 else {}
        compiling_draw = _Compiling(draw.lower(), quickly)
        callbacks.compiling(f"compiling the starts, tracing {self.chunk} steps of {self.size} episodes")
        with _uncollected():
            begin = self._begin.trace(self._fixed(0), draw.out_info, index)
            advance = self._advance.lower(self._fixed(0), begin.out_info, index, counted)
        compiling_advance = _Compiling(advance)
        compiling_begin = _Compiling(begin.lower(), quickly)

        callbacks.compiling(f"compiling {self.chunk} steps of {self.size} episodes")
        self._draw = compiling_draw.result()
        self._begin = compiling_begin.result()
        self._advance = compiling_advance.result()
        self.compile_seconds = time.perf_counter() - start

    def run(
        self,
        seed: int,
        first: int,
        count: int | None = None,
        index: np.ndarray | None = None,
        callbacks: Callbacks | None = None,
        keep_rows: bool = True,
        turn: int | None = None,
    ) -> Batch:
        """The episodes from number ``first`` on until all have ended.

        Args:
            count: episodes that count, the others fill the batch; all if None.
            index: (B,) index of each episode's scenario; they take turns by number if None.
            turn: number of the episode on whose floor the first one is; its own if None.

        Raises:
            FloatingPointError: a number is not finite; the message names the episodes.
        """
        callbacks = callbacks or Callbacks()
        count = self.size if count is None else count
        fixed = self._fixed(first if turn is None else turn)
        fixed = fixed if self.mesh.size == 1 else devices.replicate(self.mesh, fixed)
        running, turns = self._start(fixed, seed, first, index)
        counted = jnp.asarray(np.arange(self.size) < count)

        # Rows of a chunk are copied to the host while the device computes the next chunk.
        receiver = _Receiver(callbacks.rows, keep_rows)
        for done in range(self.chunk, self._steps + self.chunk, self.chunk):
            if callbacks.drive is not None:
                fixed = fixed._replace(policy=callbacks.drive(first, running.states))
            running, rows = self._advance(fixed, running, turns, counted)
            receiver.receive(rows)
            over = bool(np.all(np.asarray(running.states.completed | running.states.timed_out)))
            self._tell(callbacks, running, self._steps if over else done)
            if over:
                break
        receiver.finish()

        steps, faulty = (np.asarray(part)[:count] for part in (running.steps, running.faulty))
        if faulty.any():
            raise FloatingPointError(not_finite(first, faulty, self.robots))
        states = running.states if count == self.size else jax.tree.map(lambda leaf: leaf[:count], running.states)
        return Batch(states, steps, jax.tree.map(np.asarray, running.total), receiver.kept)

    def _start(self, fixed: Fixed, seed: int, first: int, index: np.ndarray | None) -> tuple[LoopState, Array]:
        """The episodes before their first step, and the (B,) index of each one's scenario."""
        numbers = np.arange(first, first + self.size)
        index = numbers // self.robots % len(self.scenarios) if index is None else np.resize(index, self.size)
        indices = jnp.asarray(index, jnp.int32)
        places = fixed.floors, fixed.varying
        states = self._draw(places, jnp.uint32(seed), jnp.asarray(numbers, jnp.uint32), indices)
        return self._begin(fixed, states, indices), indices

    def _tell(self, callbacks: Callbacks, running: LoopState, steps: int) -> None:
        """Call ``advanced`` after so many steps of each episode."""
        scenario = self.scenarios[0]
        simulated = float(np.asarray(running.steps).sum()) * scenario.time_step
        seconds = scenario.time_limit if steps >= self._steps else min(steps * scenario.time_step, scenario.time_limit)
        callbacks.advanced(seconds, simulated)

    def measure(
        self,
        seed: int,
        first: int,
        count: int,
        tell: Callable[[float], None],
        drive: Callable[[int, State], Policy] | None = None,
    ) -> dict[str, np.ndarray]:
        """Results of numbered episodes, in as many batches as they need; ``tell`` is called with the finished share.

        ``drive`` is as in ``Callbacks``.

        Returns:
            ``completed``, ``seconds`` [s], and the metrics by name, (count, ...) each.

        Raises:
            FloatingPointError: a number is not finite; the message names the episodes.
        """
        scenario = self.scenarios[0]
        batches = []
        starts = range(first, first + count, self.size)
        for index, start in enumerate(starts):

            def advanced(seconds: float, _: float, index: int = index) -> None:
                tell((index + seconds / scenario.time_limit) / len(starts))

            callbacks = Callbacks(advanced=advanced, drive=drive)
            batch = self.run(seed, start, min(self.size, first + count - start), callbacks=callbacks)
            ended = {"completed": batch.states.completed, "seconds": batch.steps * scenario.time_step}
            batches.append(ended | batch_results(scenario, batch.states))
        return {name: np.concatenate([np.asarray(batch[name]) for batch in batches]) for name in batches[0]}


def batch_size(size: int, floors: Stack[Scenario], shares: int = 1) -> int:
    """The size of a batch, rounded up to a multiple of ``shares``, and of the floors' turns if that is near.

    Otherwise a batch has tables of its own for each turn, which take more memory.
    """
    if floors.size == 1:
        return -(-size // shares) * shares
    shares = math.lcm(shares, floors.turn)
    period = math.lcm(shares, floors.turn * floors.size)
    size, even = (-(-size // part) * part for part in (shares, period))
    return even if even <= 1.25 * size else size


def max_batch() -> int:
    """Most episodes at once on this kind of device."""
    return MAX_BATCH_CPU if jax.default_backend() == "cpu" else MAX_BATCH


def even_batch(count: int) -> int:
    """The size of equal batches that together have ``count`` episodes or a few more."""
    return math.ceil(count / math.ceil(count / max_batch()))


def not_finite(first: int, faulty: np.ndarray, robots: int = 1) -> str:
    """The sentence on faulty episodes, by their rows from number ``first`` on, ``robots`` for each episode."""
    episodes = np.any(faulty.reshape(-1, robots), 1, keepdims=True)[:, 0]
    numbers = first // robots + np.flatnonzero(episodes)
    count = len(episodes)
    names = ", ".join(map(str, numbers[:8]))
    if len(numbers) > 8:
        names += f" and {len(numbers) - 8} more"
    return f"{len(numbers)} of {count} episodes hold numbers that are not finite: {names}."


def varying_leaves(scenarios: Sequence[Scenario]) -> dict[int, Array]:
    """The leaves in which C scenarios differ: index of the leaf -> its values (C, ...).

    Raises:
        ValueError: the scenarios differ in more.
    """
    without_tasks = [replace(scenario, task=None, task_name="") for scenario in scenarios]
    first_structure, *structures = map(jax.tree.structure, without_tasks)
    if any(structure != first_structure for structure in structures):
        raise ValueError("scenarios: their static structure differs; run them separately.")
    varying = {}
    for index, leaves in enumerate(zip(*map(jax.tree.leaves, without_tasks), strict=True)):
        if not all(leaf is leaves[0] or np.array_equal(np.asarray(leaf), np.asarray(leaves[0])) for leaf in leaves):
            varying[index] = jnp.stack([jnp.asarray(leaf) for leaf in leaves])
    return varying


def _of_each_driver(function: Callable, floors: Stack[Scenario], drivers: int | None) -> Callable:
    """(policy, rows (B, ...), ...) -> ``function(policy, scenario, row, ...)`` of each row, with the policy of its
    share.
    """
    if drivers is None:
        return lambda policy, *rows: floors.vmap(functools.partial(function, policy))(*rows)

    def shared(policy: PyTree, *rows: PyTree) -> PyTree:
        size = jax.tree.leaves(rows)[0].shape[0]
        rows = jax.tree.map(lambda leaf: leaf.reshape(drivers, size // drivers, *leaf.shape[1:]), rows)
        found = jax.vmap(_of_each_driver(function, floors, None))(policy, *rows)
        return jax.tree.map(lambda leaf: leaf.reshape(size, *leaf.shape[2:]), found)

    return shared


def first_state(tasks: tuple, scenario: Scenario, varying: dict[int, Array], index: Array, key: Array) -> State:
    """The first state of an episode of the scenario at ``index``, in one program for all scenarios.

    ``varying`` are the ``varying_leaves`` of all, ``key`` a () typed PRNG key.
    """

    def task(scenario: Scenario, *others: PyTree) -> RobotTask:
        return choose(index, [each(scenario, *others) for each in tasks])

    return reset(replace(select(scenario, varying, index), task=task), key)


@functools.lru_cache(8)  # bounded, so that a long session does not keep all programs
def _drawing(tasks: tuple, use: str, structure: Any, shapes: tuple) -> Any:
    """One program for all runners of the same scenarios, since a reset compiles as slowly as a step."""
    return jax.jit(functools.partial(_draw, tasks, use))


def _draw(tasks: tuple, use: str, places: tuple, seed: Array, numbers: Array, index: Array) -> State:
    """The reset episodes of these numbers (B,), without the policy's memory."""
    floors, varying = places
    if floors.member.others is not None:
        return _draw_team(tasks, use, floors, seed, numbers, index)

    def draw(scenario: Scenario, number: Array, turn: Array) -> State:
        return first_state(tasks, scenario, varying, turn, jax.random.fold_in(random_streams.key(use, seed), number))

    return floors.vmap(draw)(numbers, index)


def _draw_team(tasks: tuple, use: str, floors: Stack[Scenario], seed: Array, numbers: Array, index: Array) -> State:
    """The reset episodes of a team: a row for each of its robots."""

    def draw(number: Array, turn: Array) -> State:
        def task(scenario: Scenario, *others: PyTree) -> RobotTask:
            return choose(turn, [each(scenario, *others) for each in tasks])

        members = floors.map_member(lambda member: replace(member, task=task))
        return team.reset(members, jax.random.fold_in(random_streams.key(use, seed), number))

    robots = floors.size
    return _rows_of_teams(jax.vmap(draw)(numbers[::robots] // robots, index[::robots]))


def _begin(record: Record, drivers: int | None, fixed: Fixed, states: State, index: Array) -> LoopState:
    """Episodes before their first step."""

    def init(policy: PyTree, scenario: Scenario, state: State, turn: Array) -> State:
        return init_policy(select(scenario, fixed.varying, turn), policy, state)

    states = _of_each_driver(init, fixed.floors, drivers)(fixed.policy, states, index)
    steps = jnp.zeros(index.shape, jnp.int32)  # (B,)
    faulty = jnp.zeros(index.shape, bool)
    return LoopState(states, steps, faulty, record.init(fixed.floors, states))


def _advance(
    record: Record, rows: int, drivers: int | None, fixed: Fixed, running: LoopState, index: Array, counted: Array
) -> tuple[LoopState, PyTree]:
    """The state ``rows * record.every`` steps later, and the rows of the record, (rows, ...).

    Args:
        index: (B,) int32 scenario of each episode.
        counted: (B,) bool, whether an episode counts; the others fill the batch.
    """

    def tick(carry: tuple[State, Array, Array], _: None) -> tuple[tuple[State, Array, Array], Array]:
        before, steps, faulty = carry
        states, actions = _step(record, drivers, fixed, before, index)
        active = _active(before, counted)
        steps = steps + active.astype(jnp.int32)
        faulty = faulty | (~_sound(states) & active)
        return (states, steps, faulty), actions

    def advance_row(running: LoopState, _: None) -> tuple[LoopState, PyTree]:
        before = running.states
        active = _active(running.states, counted)
        carry = before, running.steps, running.faulty
        if record.every == 1:
            (states, steps, faulty), actions = tick(carry, None)
            actions = actions[None]  # (1, B, 2)
        else:
            (states, steps, faulty), actions = jax.lax.scan(tick, carry, length=record.every)
        total, row = record.update(fixed.floors, before, states, actions, active, running.total)
        return LoopState(states, steps, faulty, total), row

    if rows > 1:
        return jax.lax.scan(advance_row, running, length=rows)
    return _once(advance_row, running, counted)


def _active(states: State, counted: Array) -> Array:
    """(B,) bool: an episode counts and has not ended."""
    return ~(states.completed | states.timed_out) & counted


def _step(record: Record, drivers: int | None, fixed: Fixed, states: State, index: Array) -> tuple[State, Array]:
    """A control step of B episodes: the states, and the recorded commands (B, command)."""
    if fixed.floors.member.others is not None:
        return _step_teams(record, fixed, states)

    def step(policy: PyTree, scenario: Scenario, state: State, turn: Array | None = None) -> tuple[State, Array]:
        own = scenario if turn is None else select(scenario, fixed.varying, turn)
        after, action = policy_step(own, policy, state)
        return after, action if record.command is None else record.command(after)

    rows = (states, index) if fixed.varying else (states,)  # an index that is the same for all needs no axis
    return _of_each_driver(step, fixed.floors, drivers)(fixed.policy, *rows)


def _step_teams(record: Record, fixed: Fixed, states: State) -> tuple[State, Array]:
    """A control step of teams of M robots, whose rows (B, ...) are one after the other."""

    def step_team(states: State) -> tuple[State, Array]:
        after, actions = team.policy_step(fixed.floors, fixed.policy, states)
        return after, actions if record.command is None else jax.vmap(record.command)(after)

    robots = fixed.floors.size
    teams = jax.tree.map(lambda leaf: leaf.reshape(leaf.shape[0] // robots, robots, *leaf.shape[1:]), states)
    return _rows_of_teams(jax.vmap(step_team)(teams))


def _rows_of_teams(teams: PyTree) -> PyTree:
    """Rows (B, ...) of arrays (teams, robots, ...)."""
    return jax.tree.map(lambda leaf: leaf.reshape(leaf.shape[0] * leaf.shape[1], *leaf.shape[2:]), teams)


def _once(advance_row: Callable, running: LoopState, counted: Array) -> tuple[LoopState, PyTree]:
    """As a scan of one step, in a loop that the compiler keeps: so a step is rounded as in a scan of many.

    The compiler cannot know that the loop runs once, as an episode that counts, of (B,), is what it depends on.
    """
    _, row = jax.eval_shape(advance_row, running, None)
    rows = jax.tree.map(lambda leaf: jnp.zeros((1, *leaf.shape), leaf.dtype), row)

    def body(index: Array, carry: tuple) -> tuple:
        running, row = advance_row(carry[0], None)
        write = jax.lax.dynamic_update_index_in_dim
        return running, jax.tree.map(lambda rows, leaf: write(rows, leaf, index, 0), carry[1], row)

    return jax.lax.fori_loop(jnp.int32(0), counted.any().astype(jnp.int32), body, (running, rows))


def _sound(states: State) -> Array:
    """(B,) bool: places and velocities are finite."""
    people = states.pedestrians
    robot = states.robot
    sound = jnp.isfinite(people.velocity).all((1, 2)) & jnp.isfinite(robot.speed)
    sound = sound & jnp.isfinite(robot.heading).all(-1)
    sound = sound & jnp.isfinite(people.position).all((1, 2))
    return sound & jnp.isfinite(robot.position).all(-1)


@contextlib.contextmanager
def _uncollected() -> Iterator[None]:
    """Without garbage collection, which takes a fifth of the time of tracing and finds nothing."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


class _Compiling:
    """A program that is compiled in a separate thread, so that Ctrl-C need not wait for the compiler."""

    def __init__(self, lowered: Any, options: dict[str, Any] | None = None) -> None:
        self._outcome: Any = None
        self._thread = interrupts.compile_in_thread(functools.partial(self._work, lowered, options))

    def _work(self, lowered: Any, options: dict[str, Any] | None) -> None:
        try:
            self._outcome = lowered.compile(compiler_options=options or None)
        except Exception as error:  # raised again in the waiting thread
            self._outcome = error

    def result(self) -> Callable:
        """The program, when it is compiled."""
        while self._thread.is_alive():
            time.sleep(0.02)
        if isinstance(self._outcome, Exception):
            raise self._outcome
        return self._outcome
