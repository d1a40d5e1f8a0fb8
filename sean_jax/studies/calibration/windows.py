"""Recorded scenes as windows: forces are fitted to predict their later moments from the first ones.

Scenes are of two kinds. *Prediction*: ETH and UCY, people in the open who keep their last velocity
(``sean_jax.studies.prediction``). *Corridors*: unidirectional and bidirectional runs of Forschungszentrum Juelich
(HERMES 2009), whose walls and walking direction are known; people who enter later are replayed.
"""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float

from sean_jax.core.data_types import Obstacles
from sean_jax.core.errors import InputError
from sean_jax.people.recordings import read
from sean_jax.people.recordings.reading import NEEDED, column_names
from sean_jax.studies.prediction import SEEN, TIME_STEP, read_windows
from sean_jax.studies.validation.measures import first_and_last

RUN = re.compile(r"(uo|bo)-(\d{3})-(\d{3})-(\d{3})")  # direction, widths of entrance, corridor and exit in cm
LENGTH = 8.0  # m, of a corridor, from y = -4 to 4
CORRIDOR_STEP = 0.5  # s between moments
CORRIDOR_SEEN, CORRIDOR_STEPS = 2, 6  # observed frames, the last of which is the start, and compared frames
STRIDE = 4  # moments from the beginning of a window to the beginning of the next
NEARBY = 1.0  # m beyond the ends, within which people are replayed
APART = 40.0  # m between two runs, which lie side by side on one floor
HABIT = np.linspace(0.9, 1.02, 13)  # shares of the last observed speed that constant velocity may have
WALL = 0.3  # m, thickness
EXIT = 0.3  # m beyond the exit line, where people head for
BODY = 0.25  # m, by which their way keeps off the posts of the exit
WINDOW_FIELDS = "observed", "known", "after", "counted", "scene", "direction", "others"  # of ``Scenes``, by window


@struct.dataclass
class Scenes:
    """B windows of some scenes, of up to N predicted people and M replayed ones."""

    observed: Float[np.ndarray, "B T N 2"]  # m
    known: Bool[np.ndarray, "B T N"]
    after: Float[np.ndarray, "B S N 2"]  # m, where people really were
    counted: Bool[np.ndarray, "B S N"]  # people observed at that time
    scene: np.ndarray  # (B,) index of the window's scene among ``names``
    direction: Float[np.ndarray, "B N 2"] | None  # unit vector of the desired velocity where it is known
    others: Float[np.ndarray, "B moments M 2"] | None  # m, NaN where absent
    walls: Obstacles | None
    reference: Float[np.ndarray, "E 2"]  # m, mean and last error of constant velocity with the best habit
    names: tuple[str, ...] = struct.field(pytree_node=False)
    time_step: float = struct.field(pytree_node=False)  # s


def find(folder: str | Path) -> tuple[dict[str, Path], dict[str, Path]]:
    """The recordings of pedestrians in the open, and of corridors, in a folder.

    Raises:
        InputError: there is no such folder, or no such recording in it.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"data: {folder} is no folder; give the folder of the recordings.")
    prediction, corridors = {}, {}
    for file in sorted(folder.rglob("*.csv")):
        if (match := RUN.match(file.stem)) is not None:
            corridors.setdefault(match.group(), file)
        elif _has_velocities(file):
            prediction.setdefault(file.stem, file)
    if not prediction and not corridors:
        raise InputError(
            f"data: {folder} has no recordings of ETH or UCY (frame, ped_id, x_m, y_m, vx_mps, vy_mps) or runs like "
            "uo-180-180-180; give another folder."
        )
    return prediction, corridors


def prediction_scenes(files: dict[str, Path]) -> Scenes:
    """The windows of ETH and UCY, 8 observed moments and 12 to compare, 0.4 s apart in real time."""
    windows = [read_windows(file, "recorded") for file in files.values()]
    people = max(part.present.shape[1] for part in windows)
    position = np.concatenate([_pad(part.position, 2, people) for part in windows])  # (B, T, N, 2)
    present = np.concatenate([_pad(part.present, 1, people) for part in windows])
    present = np.broadcast_to(present[:, None], position.shape[:3])
    scenes = Scenes(
        observed=position[:, :SEEN],
        known=present[:, :SEEN],
        after=position[:, SEEN:],
        counted=present[:, SEEN:],
        scene=np.repeat(np.arange(len(windows)), [len(part.position) for part in windows]),
        direction=None,
        others=None,
        walls=None,
        reference=np.zeros((len(windows), 2)),
        names=tuple(files),
        time_step=TIME_STEP,
    )
    return _with_reference(scenes)


class RecordedWindow(NamedTuple):
    """A window of a run: S observed and A later moments of N predicted people, and M replayed ones."""

    observed: Float[np.ndarray, "S N 2"]  # m
    after: Float[np.ndarray, "A N 2"]  # m, NaN of people who have left
    direction: Float[np.ndarray, "N 2"]  # unit vectors
    others: Float[np.ndarray, "moments M 2"]  # m, NaN where absent


class Run(NamedTuple):
    """A run of Juelich: its corridor, and whether all walk one way."""

    width: float  # m
    exit_width: float  # m
    one_way: bool


def corridor_scenes(files: dict[str, Path]) -> Scenes:
    """Windows of 3 s of Juelich's runs; each run lies at its own place on one floor, between its own walls."""
    # Runs lie far apart on one floor, so that one program with one grid of obstacles serves all of them.
    windows: list[RecordedWindow] = []
    scene, boxes = [], []
    for number, (name, file) in enumerate(files.items()):
        run = _run_of(name)
        place = np.array([APART * number, 0.0])  # (2,) m
        for box in _walls(run.width, run.exit_width if run.one_way else run.width):
            boxes.append([*(np.array(box[:2]) + place), *box[2:]])
        for window in _corridor_windows(_read_positions(file), run):
            windows.append(window._replace(
                observed=window.observed + place, after=window.after + place, others=window.others + place
            ))  # fmt: skip
            scene.append(number)

    # Windows of a batch have equal shapes; NaN marks people whom a window does not have.
    people = max(len(window.direction) for window in windows)
    replayed = max(window.others.shape[1] for window in windows)
    observed = np.stack([_pad(window.observed, 1, people, np.nan) for window in windows])  # (B, S, N, 2) m
    after = np.stack([_pad(window.after, 1, people, np.nan) for window in windows])  # (B, A, N, 2) m

    # Boxes need no yaw: the files have x across the corridor and y along it.
    walls = np.array(boxes)  # (W, 4)
    obstacles = Obstacles(
        center=jnp.asarray(walls[:, :2], float),
        half_extent=jnp.asarray(walls[:, 2:], float),
        yaw=jnp.zeros(len(walls), float),
        height=jnp.full(len(walls), 2.0, float),
    )

    # NaN would spoil gradients even where it is masked, so masks go beside zeros.
    scenes = Scenes(
        observed=np.nan_to_num(observed),
        known=np.asarray(np.isfinite(observed).all(-1)),
        after=np.nan_to_num(after),
        counted=np.asarray(np.isfinite(after).all(-1)),
        scene=np.array(scene),
        direction=np.stack([_pad(window.direction, 0, people) for window in windows]),
        others=np.stack([_pad(window.others, 1, replayed, np.nan) for window in windows]),
        walls=obstacles,
        reference=np.zeros((len(files), 2)),
        names=tuple(files),
        time_step=CORRIDOR_STEP,
    )

    # The errors of constant velocity make scenes with slow and with fast people comparable.
    return _with_reference(scenes)


def _run_of(name: str) -> Run:
    """The corridor of a run by its name, such as uo-180-180-090."""
    match = RUN.match(name)
    assert match is not None
    return Run(width=int(match[3]) / 100.0, exit_width=int(match[4]) / 100.0, one_way=match[1] == "uo")


def _read_positions(file: Path) -> Float[np.ndarray, "T N 2"]:
    """Positions [m] in a run, ``CORRIDOR_STEP`` apart; NaN of absent people."""
    tracks = read(file, "juelich")
    skip = round(CORRIDOR_STEP / tracks.time_step)
    present = np.asarray(tracks.present)[::skip]
    return np.where(present[..., None], np.asarray(tracks.position, float)[::skip], np.nan)


def _corridor_windows(positions: Float[np.ndarray, "T N 2"], run: Run) -> Iterator[RecordedWindow]:
    """The windows of a run with two or more people who are inside at the start."""
    # The frame of a run: x across the corridor from 0 to its width, y along it, 0 in the middle [m].
    half = 0.5 * LENGTH
    positions = positions[:, np.isfinite(positions).any((0, 2))]
    x, y = positions[..., 0], positions[..., 1]
    inside = (x > 0.0) & (x < run.width) & (np.abs(y) < half)
    along = _directions_along(y, run.one_way)  # (N,) 1 or -1

    # Windows overlap by half, to use more of the few runs; people inside at the start are predicted.
    now, moments = CORRIDOR_SEEN - 1, CORRIDOR_SEEN + CORRIDOR_STEPS
    for begin in range(0, len(positions) - moments + 1, STRIDE):
        window, stays = positions[begin : begin + moments], inside[begin : begin + moments]  # (S + A, N, 2), (S + A, N)
        chosen = np.flatnonzero(np.isfinite(window[:CORRIDOR_SEEN]).all((0, 2)) & stays[now])
        if len(chosen) < 2:
            continue

        # People who are near without being predicted are replayed.
        others = window[now:, np.setdiff1d(np.arange(positions.shape[1]), chosen)]
        near = np.abs(others[..., 1]) < half + NEARBY
        others = _share_columns(np.where(near[..., None], others, np.nan))

        # The goal is known, unlike that of people in a street: straight on, or through the exit.
        start = window[now, chosen]  # (N, 2)
        goal_x = _through(start[:, 0], run.width, run.exit_width) if run.one_way else start[:, 0]
        way = np.stack([goal_x, along[chosen] * (half + EXIT)], -1) - start  # (N, 2)

        # Who has left is not compared: behind the exit nobody knows where people go.
        yield RecordedWindow(
            observed=window[:CORRIDOR_SEEN, chosen],
            after=np.where(stays[CORRIDOR_SEEN:, chosen, None], window[CORRIDOR_SEEN:, chosen], np.nan),
            direction=way / np.linalg.norm(way, axis=1)[:, None],
            others=others,
        )


def _directions_along(y: Float[np.ndarray, "T N"], one_way: bool) -> Float[np.ndarray, "N"]:
    """Whether people walk along y (1) or against it (-1), as all do in runs of one way."""
    if one_way:
        return np.full(y.shape[1], -1.0)
    first, last = first_and_last(np.isfinite(y))
    people = np.arange(y.shape[1])
    return np.sign(y[last, people] - y[first, people])


def _share_columns(tracks: np.ndarray) -> np.ndarray:
    """Tracks (S, M, 2), NaN where absent, in few columns: one serves several people one after the other."""
    present = np.asarray(np.isfinite(tracks).all(-1))
    columns: list[np.ndarray] = []
    for person in np.flatnonzero((present[1:] & present[:-1]).any(0)):
        moments = np.flatnonzero(present[:, person])
        for column in columns:
            last = np.flatnonzero(np.isfinite(column).all(-1))[-1]
            if last + 1 < moments[0]:  # a moment between two people, or one would seem to become the other
                break
        else:
            columns.append(column := np.full((len(tracks), 2), np.nan))
        column[moments] = tracks[moments, person]
    return np.stack(columns, 1) if columns else np.full((len(tracks), 1, 2), np.nan)


def _through(x: np.ndarray, width: float, exit_width: float) -> np.ndarray:
    """Where people pass the exit: straight ahead if that is open."""
    room = max(0.5 * exit_width - BODY, 0.0)
    return np.clip(x, 0.5 * width - room, 0.5 * width + room) if exit_width < width else x


def _walls(width: float, exit_width: float) -> list[tuple[float, float, float, float]]:
    """Boxes (center x, y, half extent x, y) beside a corridor, and beside an exit that is narrower."""
    half, thick = 0.5 * LENGTH, 0.5 * WALL
    boxes = [(-thick, 0.0, thick, half), (width + thick, 0.0, thick, half)]
    post = 0.5 * (width - exit_width)
    if post > 0.0:
        boxes += [
            (0.5 * post, -half - thick, 0.5 * post, thick),
            (width - 0.5 * post, -half - thick, 0.5 * post, thick),
        ]
    return boxes


def thinned(scenes: Scenes, most: int) -> Scenes:
    """At most so many windows of each scene, evenly spaced in time, with the errors of constant velocity in these."""
    rows = []
    for index in range(len(scenes.names)):
        windows = np.flatnonzero(scenes.scene == index)
        chosen = np.linspace(0, len(windows) - 1, min(most, len(windows))).astype(int)
        rows.append(windows[chosen])
    order = np.concatenate(rows)

    fields = {name: getattr(scenes, name) for name in WINDOW_FIELDS}
    return _with_reference(replace(scenes, **{name: None if a is None else a[order] for name, a in fields.items()}))


def _with_reference(scenes: Scenes) -> Scenes:
    """The scenes with the errors of constant velocity, of the share of the last speed that is best in each."""
    observed, after, counted = (np.asarray(part) for part in (scenes.observed, scenes.after, scenes.counted))
    last = observed[:, -1][:, None]
    step = (observed[:, -1] - observed[:, -2])[:, None]
    steps = np.arange(1, after.shape[1] + 1)[:, None, None]
    reference = np.full((len(scenes.names), 2), np.inf)
    for share in HABIT:
        distance = np.linalg.norm(last + share * steps * step - after, axis=-1)  # (B, S, N)
        for index in range(len(scenes.names)):
            windows = scenes.scene == index
            errors = _mean_and_last(distance[windows], counted[windows])
            reference[index] = min(reference[index], errors, key=sum)
    return replace(scenes, reference=reference)


def _mean_and_last(distance: Float[np.ndarray, "B S N"], counted: Bool[np.ndarray, "B S N"]) -> tuple[float, float]:
    """The mean error [m], and the one at the last moment; 1 if nobody counts then."""
    end = counted[:, -1]
    return distance[counted].mean(), distance[:, -1][end].mean() if end.any() else 1.0


def _pad(array: np.ndarray, axis: int, size: int, value: float = 0.0) -> np.ndarray:
    """With further people, so that there are ``size``."""
    array = np.asarray(array)
    widths = [(0, 0)] * array.ndim
    widths[axis] = (0, size - array.shape[axis])
    return np.pad(array, widths, constant_values=value if array.dtype.kind == "f" else 0)


def _has_velocities(file: Path) -> bool:
    try:
        return {*NEEDED, "vx", "vy"} <= column_names(file)
    except InputError:
        return False
