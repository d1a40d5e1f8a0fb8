"""Scenes simulated: the two people stages of the ordinary step, in spans that all scenes of one size share.

Small scenes run in parallel. People who have left a large crowd are dropped between two spans, so that the rest costs
no more than a small crowd.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax.core.data_types import Array, Scenario, State
from sean_jax.people.recordings import Tracks
from sean_jax.simulation import scenario as steps
from sean_jax.social_forces.forces import look_direction
from sean_jax.studies.scenes.scene import TIME_STEP, Model, Scene, model, scenario_of, stage
from sean_jax.studies.scenes.walkers import GATES, padded_size

SPAN = 50  # control steps in one call
BATCHES = 1, 4, 16, 64  # sizes to which numbers of parallel scenes are padded
MAX_TOGETHER = 2048  # people in parallel scenes
LARGE = 256  # people, from which scenes run one after the other
SMALLER = 64, 256, 512, 1024, 2048  # sizes to which a large crowd shrinks


def simulate(
    scenes: Scene | Sequence[Scene],
    moved_by: Model | str | None = None,
    report: Callable[[float], None] | None = None,
) -> list[Tracks]:
    """Simulate scenes until everybody has left or their time is over; scenes of one size run in parallel.

    Args:
        moved_by: the default forces if None.
        report: called with the finished share.

    Returns:
        For each scene T moments 0.1 s apart, from the start on, of its N people, as numpy arrays. Groups are -1, a
        person's number is the column. In a periodic scene x is from 0 to the period.
    """
    chosen = moved_by if isinstance(moved_by, Model) else model(moved_by)
    several = [scenes] if isinstance(scenes, Scene) else list(scenes)
    tracks_of: dict[int, Tracks] = {}
    for group in _batches(several):
        # Shares of a batch are shares of all scenes; scenes of the batches before are done.
        def part(share: float, before: int = len(tracks_of), number: int = len(group)) -> None:
            if report is not None:
                report((before + share * number) / len(several))

        batch = [several[index] for index in group]
        tracks = _together(batch, chosen, part)
        tracks_of |= zip(group, tracks, strict=True)
    return [tracks_of[index] for index in range(len(several))]


def advance(scenario: Scenario, state: State) -> State:
    """The state one control step (0.1 s) later: people move, a robot goes straight on."""
    key = jax.random.fold_in(state.streams.people, state.tick)
    state = steps.direct_pedestrians(scenario, state, key)
    state = steps.move_pedestrians(scenario, state)
    robot = state.robot
    position = robot.position + scenario.time_step * robot.speed * robot.heading
    robot = replace(robot, position=position)
    return replace(state, robot=robot, tick=state.tick + 1)


def _span(scenario: Scenario, state: State) -> tuple[State, tuple[Array, Array, Array]]:
    def turn(state: State, _: None) -> tuple[State, tuple[Array, Array, Array]]:
        state = advance(scenario, state)
        return state, _moment(state)

    return jax.lax.scan(turn, state, length=SPAN)


_alone = jax.jit(_span)
_side_by_side = jax.jit(jax.vmap(_span))


def _batches(scenes: list[Scene]) -> list[list[int]]:
    """Indices of scenes that run in parallel: of one size and kind."""
    kinds: dict[Any, list[int]] = {}
    for index, scene in enumerate(scenes):
        size = padded_size(len(scene.walkers.start))
        late = bool((np.asarray(scene.walkers.entry_time) > 0.0).any())
        company = bool((np.asarray(scene.walkers.companion) >= 0).any())
        many = len(scene.gates) > GATES[0]
        alone = index if size >= LARGE else -1
        choice = bool(scene.exits)
        kind = size, scene.period is None, choice, late, company, many, scene.intent is None, alone
        kinds.setdefault(kind, []).append(index)

    batches = []
    for (size, *_), members in kinds.items():
        allowed = [number for number in BATCHES if number == 1 or number * size <= MAX_TOGETHER]
        most = max(allowed)
        for first in range(0, len(members), most):
            batches.append(members[first : first + most])
    return batches


def _together(scenes: list[Scene], chosen: Model, report: Callable[[float], None]) -> list[Tracks]:
    """Scenes of one size, in parallel."""
    # A batch needs equal shapes in all leaves; the size of the crowd alone does not ensure it.
    scenarios = [scenario_of(scene, chosen) for scene in scenes]
    shapes = set()
    for scenario in scenarios:
        shapes.add(tuple(np.shape(leaf) for leaf in jax.tree.leaves(scenario)))
    if len(shapes) > 1:  # of plans with few and with many walls
        return [_together([scene], chosen, lambda share: None)[0] for scene in scenes]
    states = [stage(scenario, scene) for scenario, scene in zip(scenarios, scenes, strict=True)]
    if len(scenes) == 1:
        return [_one(scenes[0], scenarios[0], states[0], report)]

    # Filled up with copies of the first scene, whose results are dropped: few sizes, few programs.
    number = next(size for size in BATCHES if size >= len(scenes))
    missing = number - len(scenes)
    scenario = stacked(scenarios + [scenarios[0]] * missing)
    state = stacked(states + [states[0]] * missing)

    # Spans are short programs: a batch ends early when everybody has left.
    frames = [_snapshot(state)]
    spans = _spans(max(scene.seconds for scene in scenes))
    for turn in range(spans):
        state, span = _side_by_side(scenario, state)
        report((turn + 1) / spans)
        frames.append(tuple(np.moveaxis(np.asarray(part), 1, 0) for part in span))
        if not _left(state):
            break

    # Moments of all spans, of scene k the first N columns: the others are padding.
    parts = _joined(frames)
    tracks = []
    for k, scene in enumerate(scenes):
        people = len(scene.walkers.start)
        of_scene = [part[:, k, :people] for part in parts]
        tracks.append(_tracks(scene, *of_scene))
    return tracks


def _one(scene: Scene, scenario: Scenario, state: State, report: Callable[[float], None]) -> Tracks:
    """One scene, whose crowd shrinks as people leave."""
    number = len(scene.walkers.start)
    columns = np.arange(scenario.people)
    frames = [tuple(part[:, :number] for part in _snapshot(state))]
    spans = _spans(scene.seconds)
    for turn in range(spans):
        state, span = _alone(scenario, state)
        report((turn + 1) / spans)

        # People who were dropped stay where they were, and are absent.
        position, facing, _ = frames[-1]
        position = np.repeat(position[-1:], SPAN, axis=0)
        facing = np.repeat(facing[-1:], SPAN, axis=0)
        present = np.zeros((SPAN, number), bool)
        frame = position, facing, present

        # The others are in the columns of the scene that they had before the crowd shrank.
        index = np.flatnonzero(columns < number)
        for whole, part in zip(frame, span, strict=True):
            whole[:, columns[index]] = np.asarray(part)[:, index]
        frames.append(frame)
        if not _left(state):
            break
        scenario, state, columns = _shrunk(scene, scenario, state, columns)

    return _tracks(scene, *_joined(frames))


def _shrunk(scene: Scene, scenario: Scenario, state: State, columns: np.ndarray) -> tuple[Scenario, State, np.ndarray]:
    """Without people who have left, if the crowd then fits the next smaller size."""
    number = len(scene.walkers.start)
    entered = np.asarray(state.memory.entered)
    gone = entered & ~np.asarray(state.pedestrians.present)
    counts = (columns < number) & ~gone
    keep = np.flatnonzero(counts)

    # Companions are indices, which would have to change with the columns.
    size = next((size for size in SMALLER if size >= len(keep)), len(columns))
    in_company = scenario.behavior.companions is not None
    if len(columns) < LARGE or size >= len(columns) or in_company:
        return scenario, state, columns

    # People who have left fill the crowd up to the size; their columns are none of the tracks.
    fill = np.flatnonzero(~counts)[: size - len(keep)]
    rows = np.concatenate([keep, fill])
    columns = columns[rows]
    columns[len(keep) :] = number

    plan = scenario.behavior.data
    plan = replace(plan, walkers=_take(plan.walkers, rows))
    behavior = replace(scenario.behavior, data=plan, people=size)
    scenario = replace(scenario, behavior=behavior, people=size)
    people = _take(state.pedestrians, rows)
    memory = _take(state.memory, rows)
    return scenario, replace(state, pedestrians=people, memory=memory), columns


def _take(tree: Any, rows: np.ndarray) -> Any:
    """These rows of all leaves."""
    return jax.tree.map(lambda leaf: jax.device_put(np.asarray(leaf)[rows]), tree)


def stacked(trees: Sequence[Any]) -> Any:
    """Trees of equal shapes as one, along a first axis."""
    return jax.tree.map(lambda *rows: _stack(rows), *trees)


def _stack(rows: tuple) -> Any:
    if jnp.issubdtype(rows[0].dtype, jax.dtypes.prng_key):
        return jnp.stack(rows)
    leaves = [np.asarray(row) for row in rows]
    return jax.device_put(np.stack(leaves))


def _moment(state: State) -> tuple[Array, Array, Array]:
    """Positions (N, 2), looks (N, 2) and presence (N,) of people."""
    people = state.pedestrians
    looks = jnp.stack(look_direction(people), -1)
    return people.position, looks, people.present


def _snapshot(state: State) -> tuple[np.ndarray, ...]:
    """(1, B, N, 2), (1, B, N, 2), (1, B, N): as a span of one moment."""
    moment = _moment
    if state.pedestrians.present.ndim == 2:
        moment = jax.vmap(_moment)
    return tuple(np.asarray(part)[None] for part in moment(state))


def _joined(frames: Sequence[tuple[np.ndarray, ...]]) -> list[np.ndarray]:
    """Positions, looks and presence of all spans, one after the other."""
    return [np.concatenate(part) for part in zip(*frames, strict=True)]


def _left(state: State) -> bool:
    """Whether people are present or still to come."""
    has_gate = np.asarray(state.memory.gate) >= 0
    coming = ~np.asarray(state.memory.entered) & has_gate
    present = np.asarray(state.pedestrians.present)
    return bool((present | coming).any())


def _spans(seconds: float) -> int:
    number = seconds / (SPAN * TIME_STEP)
    return int(np.ceil(number - 1e-9))


def _tracks(scene: Scene, position: np.ndarray, facing: np.ndarray, present: np.ndarray) -> Tracks:
    """The recording of a scene, no longer than the scene lasts."""
    moments = int(round(scene.seconds / TIME_STEP)) + 1
    last = min(len(position), moments)
    present = present[:last]
    column = np.arange(present.shape[1], dtype=np.int32)
    fields: Any = dict(
        position=position[:last],
        facing=facing[:last],
        group=np.full(present.shape, -1, np.int32),
        present=present,
        person=np.where(present, column, -1),
        frame=np.arange(last, dtype=np.int32),
    )
    return Tracks(**fields, time_step=TIME_STEP)
