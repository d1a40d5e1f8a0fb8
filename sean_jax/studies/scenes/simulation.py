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

        def part(share: float, before: int = len(tracks_of), number: int = len(group)) -> None:
            if report is not None:
                report((before + share * number) / len(several))

        tracks_of |= zip(group, _together([several[index] for index in group], chosen, part), strict=True)
    return [tracks_of[index] for index in range(len(several))]


def advance(scenario: Scenario, state: State) -> State:
    """The state one control step (0.1 s) later: people move, a robot goes straight on."""
    key = jax.random.fold_in(state.streams.people, state.tick)
    state = steps.direct_pedestrians(scenario, state, key)
    state = steps.move_pedestrians(scenario, state)
    robot = state.robot
    robot = replace(robot, position=robot.position + scenario.time_step * robot.speed * robot.heading)
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
        kind = size, scene.period is None, bool(scene.exits), late, company, many, index if size >= LARGE else -1
        kinds.setdefault(kind, []).append(index)
    batches = []
    for (size, *_), members in kinds.items():
        most = max(each for each in BATCHES if each == 1 or each * size <= MAX_TOGETHER)
        batches += [members[k : k + most] for k in range(0, len(members), most)]
    return batches


def _together(scenes: list[Scene], chosen: Model, report: Callable[[float], None]) -> list[Tracks]:
    """Scenes of one size, in parallel."""
    # A batch needs equal shapes in all leaves; the size of the crowd alone does not ensure it.
    scenarios = [scenario_of(scene, chosen) for scene in scenes]
    shapes = {tuple(np.shape(leaf) for leaf in jax.tree.leaves(each)) for each in scenarios}
    if len(shapes) > 1:  # of plans with few and with many walls
        return [_together([scene], chosen, lambda share: None)[0] for scene in scenes]
    states = [stage(scenario, scene) for scenario, scene in zip(scenarios, scenes, strict=True)]
    if len(scenes) == 1:
        return [_one(scenes[0], scenarios[0], states[0], report)]

    # Filled up with copies of the first scene, whose results are dropped: few sizes, few programs.
    number = next(each for each in BATCHES if each >= len(scenes))
    filled = [*range(len(scenes)), *([0] * (number - len(scenes)))]
    scenario, state = (
        jax.tree.map(lambda *rows: _stack(rows), *[parts[k] for k in filled]) for parts in (scenarios, states)
    )

    # Spans are short programs: a batch ends early when everybody has left.
    frames = [_snapshot(state)]
    seconds = max(scene.seconds for scene in scenes)
    for number in range(_spans(seconds)):
        state, span = _side_by_side(scenario, state)
        report((number + 1) / _spans(seconds))
        frames += [tuple(np.moveaxis(np.asarray(part), 1, 0) for part in span)]
        if not _left(state):
            break

    # Moments of all spans, of scene k the first N columns: the others are padding.
    parts = [np.concatenate([frame[k] for frame in frames]) for k in range(3)]
    return [
        _tracks(scene, *(part[:, k, : len(scene.walkers.start)] for part in parts)) for k, scene in enumerate(scenes)
    ]


def _one(scene: Scene, scenario: Scenario, state: State, report: Callable[[float], None]) -> Tracks:
    """One scene, whose crowd shrinks as people leave."""
    number = len(scene.walkers.start)
    columns = np.arange(scenario.people)
    frames = [tuple(part[:, :number] for part in _snapshot(state))]
    for turn in range(_spans(scene.seconds)):
        state, span = _alone(scenario, state)
        report((turn + 1) / _spans(scene.seconds))
        index = np.flatnonzero(columns < number)
        position, facing = (np.repeat(part[-1:], SPAN, axis=0) for part in frames[-1][:2])
        frames.append((position, facing, np.zeros((SPAN, number), bool)))
        for whole, part in zip(frames[-1], span, strict=True):
            whole[:, columns[index]] = np.asarray(part)[:, index]
        if not _left(state):
            break
        scenario, state, columns = _shrunk(scene, scenario, state, columns)
    return _tracks(scene, *(np.concatenate(part) for part in zip(*frames, strict=True)))


def _shrunk(scene: Scene, scenario: Scenario, state: State, columns: np.ndarray) -> tuple[Scenario, State, np.ndarray]:
    """Without people who have left, if the crowd then fits the next smaller size."""
    number = len(scene.walkers.start)
    late = columns < number
    gone = np.asarray(state.memory.entered) & ~np.asarray(state.pedestrians.present)
    keep = np.flatnonzero(late & ~gone)
    size = next((each for each in SMALLER if each >= len(keep)), len(columns))
    if len(columns) < LARGE or size >= len(columns) or scenario.behavior.companions is not None:
        return scenario, state, columns
    fill = np.flatnonzero(~(late & ~gone))[: size - len(keep)]
    chosen = np.concatenate([keep, fill])
    take = lambda tree: jax.tree.map(lambda leaf: _take(leaf, chosen), tree)  # noqa: E731
    plan = scenario.behavior.data
    behavior = replace(scenario.behavior, data=replace(plan, walkers=take(plan.walkers)), people=size)
    state = replace(state, pedestrians=take(state.pedestrians), memory=take(state.memory))
    left = np.where(np.isin(np.arange(size), np.arange(len(keep))), columns[chosen], number)
    return replace(scenario, behavior=behavior, people=size), state, left


def _take(leaf: Array, rows: np.ndarray) -> Any:
    return jax.device_put(np.asarray(leaf)[rows])


def _stack(rows: tuple) -> Any:
    if jnp.issubdtype(rows[0].dtype, jax.dtypes.prng_key):
        return jnp.stack(rows)
    return jax.device_put(np.stack([np.asarray(row) for row in rows]))


def _moment(state: State) -> tuple[Array, Array, Array]:
    """Positions (N, 2), looks (N, 2) and presence (N,) of people."""
    people = state.pedestrians
    return people.position, jnp.stack(look_direction(people), -1), people.present


def _snapshot(state: State) -> tuple[np.ndarray, ...]:
    """(1, B, N, 2), (1, B, N, 2), (1, B, N): as a span of one moment."""
    moment = _moment if state.pedestrians.present.ndim == 1 else jax.vmap(_moment)
    return tuple(np.asarray(part)[None] for part in moment(state))


def _left(state: State) -> bool:
    """Whether people are present or still to come."""
    coming = ~np.asarray(state.memory.entered) & (np.asarray(state.memory.gate) >= 0)
    return bool((np.asarray(state.pedestrians.present) | coming).any())


def _spans(seconds: float) -> int:
    return int(np.ceil(seconds / (SPAN * TIME_STEP) - 1e-9))


def _tracks(scene: Scene, position: np.ndarray, facing: np.ndarray, present: np.ndarray) -> Tracks:
    """The recording of a scene, no longer than the scene lasts."""
    last = min(len(position), int(round(scene.seconds / TIME_STEP)) + 1)
    position, facing, present = position[:last], facing[:last], present[:last]
    number = np.broadcast_to(np.arange(present.shape[1], dtype=np.int32), present.shape)
    fields: Any = dict(
        position=position,
        facing=facing,
        group=np.full(present.shape, -1, np.int32),
        present=present,
        person=np.where(present, number, -1),
        frame=np.arange(last, dtype=np.int32),
    )
    return Tracks(**fields, time_step=TIME_STEP)
