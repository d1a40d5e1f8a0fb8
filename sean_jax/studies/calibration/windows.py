"""Recorded scenes as windows: forces are fitted to predict their later moments from the first ones.

Scenes are of two kinds. *Prediction*: ETH and UCY, people in the open who keep their last velocity
(``sean_jax.studies.prediction``). *Corridors*: unidirectional and bidirectional runs of Forschungszentrum Juelich
(HERMES 2009), whose walls and walking direction are known; people who enter later are replayed.
"""

import re
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float

from sean_jax.core.data_types import Obstacles
from sean_jax.core.errors import InputError
from sean_jax.people.recordings import read
from sean_jax.people.recordings.reading import NEEDED, column_names
from sean_jax.studies.prediction import SEEN, TIME_STEP, read_windows

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
        what = "recordings of ETH or UCY (frame, ped_id, x_m, y_m, vx_mps, vy_mps) or runs like uo-180-180-180"
        raise InputError(f"data: {folder} has no {what}; give another folder.")
    return prediction, corridors


def prediction_scenes(files: dict[str, Path]) -> Scenes:
    """The windows of ETH and UCY, 8 observed moments and 12 to compare, 0.4 s apart in real time."""
    windows = [read_windows(file, "recorded") for file in files.values()]
    people = max(each.present.shape[1] for each in windows)
    position = np.concatenate([_pad(each.position, 2, people) for each in windows])
    present = np.concatenate([_pad(each.present, 1, people) for each in windows])
    there = np.broadcast_to(present[:, None], position.shape[:3])
    scene = np.repeat(np.arange(len(windows)), [len(each.position) for each in windows])
    return _with_reference(Scenes(
        observed=position[:, :SEEN], known=there[:, :SEEN], after=position[:, SEEN:], counted=there[:, SEEN:],
        scene=scene, direction=None, others=None, walls=None, reference=np.zeros((len(windows), 2)), names=tuple(files),
        time_step=TIME_STEP,
    ))  # fmt: skip


def corridor_scenes(files: dict[str, Path]) -> Scenes:
    """Windows of 3 s of Juelich's runs; each run lies at its own place on one floor, between its own walls."""
    parts, boxes = [], []
    for number, (name, file) in enumerate(files.items()):
        match = RUN.match(name)
        assert match is not None
        width, exit_width = int(match[3]) / 100.0, int(match[4]) / 100.0
        one_way = match[1] == "uo"
        place = np.array([APART * number, 0.0])
        boxes += [(*(np.array(box[:2]) + place), *box[2:]) for box in _walls(width, exit_width if one_way else width)]
        tracks = read(file, "juelich")
        skip = round(CORRIDOR_STEP / tracks.time_step)
        there = np.asarray(tracks.present)[::skip]
        places = np.where(there[..., None], np.asarray(tracks.position, float)[::skip], np.nan)
        parts += [(number, *window) for window in _corridor_windows(places, width, exit_width, one_way, place)]
    people, others = (max(part[index].shape[-2] for part in parts) for index in (1, 4))
    observed, after = (np.stack([_pad(part[index], 1, people, np.nan) for part in parts]) for index in (1, 2))
    known, counted = (np.asarray(np.isfinite(each).all(-1)) for each in (observed, after))
    sizes = np.array(boxes)[:, :2], np.array(boxes)[:, 2:], np.zeros(len(boxes)), np.full(len(boxes), 2.0)
    return _with_reference(Scenes(
        observed=np.nan_to_num(observed), known=known, after=np.nan_to_num(after), counted=counted,
        scene=np.array([part[0] for part in parts]),
        direction=np.stack([_pad(part[3], 0, people) for part in parts]),
        others=np.stack([_pad(part[4], 1, others, np.nan) for part in parts]),
        walls=Obstacles(*(jnp.asarray(each, float) for each in sizes)),
        reference=np.zeros((len(files), 2)), names=tuple(files), time_step=CORRIDOR_STEP,
    ))  # fmt: skip


def _corridor_windows(places: np.ndarray, width: float, exit_width: float, one_way: bool, place: np.ndarray):
    """Of each window: positions before and after, directions, and tracks of replayed people."""
    half = 0.5 * LENGTH
    places = places[:, np.isfinite(places).any((0, 2))]
    y = places[..., 1]
    first, last = (np.array([column[np.isfinite(column)][end] for column in y.T]) for end in (0, -1))
    sign = np.where(one_way, -1.0, np.sign(last - first))
    inside = (places[..., 0] > 0.0) & (places[..., 0] < width) & (np.abs(y) < half)
    total = CORRIDOR_SEEN + CORRIDOR_STEPS
    for begin in range(0, len(places) - total + 1, STRIDE):
        window = places[begin : begin + total]
        now = CORRIDOR_SEEN - 1
        chosen = np.flatnonzero(np.isfinite(window[: now + 1]).all((0, 2)) & inside[begin + now])
        if len(chosen) < 2:
            continue
        rest = np.setdiff1d(np.arange(places.shape[1]), chosen)
        near = np.abs(window[now:, rest, 1]) < half + NEARBY
        tracks = np.where(near[..., None], window[now:, rest], np.nan)
        tracks = _share_columns(tracks)
        start = window[now, chosen]
        to = (
            np.stack([start[:, 0], np.full(len(chosen), sign[chosen] * (half + EXIT))], -1)
            if not one_way
            else np.stack([_through(start[:, 0], width, exit_width), np.full(len(chosen), -half - EXIT)], -1)
        )
        way = to - start
        after = np.where(inside[begin + now + 1 : begin + total][:, chosen, None], window[now + 1 :, chosen], np.nan)
        yield (
            window[: now + 1, chosen] + place,
            after + place,
            way / np.linalg.norm(way, axis=1)[:, None],
            tracks + place,
        )


def _share_columns(tracks: np.ndarray) -> np.ndarray:
    """Tracks (S, M, 2), NaN where absent, in few columns: one serves several people one after the other."""
    there = np.asarray(np.isfinite(tracks).all(-1))
    columns: list[np.ndarray] = []
    for person in np.flatnonzero((there[1:] & there[:-1]).any(0)):
        own = np.flatnonzero(there[:, person])
        for column in columns:
            last = np.flatnonzero(np.isfinite(column).all(-1))[-1]
            if last + 1 < own[0]:  # a moment between two people, or one would seem to become the other
                break
        else:
            columns.append(column := np.full((len(tracks), 2), np.nan))
        column[own] = tracks[own, person]
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
    own = [np.flatnonzero(scenes.scene == index) for index in range(len(scenes.names))]
    rows = np.concatenate([each[np.linspace(0, len(each) - 1, min(most, len(each))).astype(int)] for each in own])
    fields = "observed", "known", "after", "counted", "scene", "direction", "others"
    chosen = {name: None if (part := getattr(scenes, name)) is None else part[rows] for name in fields}
    return _with_reference(replace(scenes, **chosen))


def _with_reference(scenes: Scenes) -> Scenes:
    """The scenes with the errors of constant velocity, of the share of the last speed that is best in each."""
    observed, after, counted = (np.asarray(part) for part in (scenes.observed, scenes.after, scenes.counted))
    steps = np.arange(1, after.shape[1] + 1)[:, None, None]
    rows = np.full((len(scenes.names), 2), np.inf)
    for share in HABIT:
        guess = observed[:, -1][:, None] + share * steps * (observed[:, -1] - observed[:, -2])[:, None]
        away = np.linalg.norm(guess - after, axis=-1)
        for index in range(len(scenes.names)):
            own = scenes.scene == index
            end = counted[own][:, -1]
            errors = away[own][counted[own]].mean(), away[own][:, -1][end].mean() if end.any() else 1.0
            rows[index] = min(rows[index], errors, key=sum)
    return replace(scenes, reference=rows)


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
