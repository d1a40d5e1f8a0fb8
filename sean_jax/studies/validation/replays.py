"""``sean replay`` of a validation: the scenes of its tests once more, people alone, on a page that plays them."""

import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from sean_jax import drawing, files, flags, replay, writing
from sean_jax.base import Environment, Obstacles, Trajectory
from sean_jax.config import ReplayConfig, ValidateConfig
from sean_jax.errors import InputError
from sean_jax.files import listed
from sean_jax.progress import progress
from sean_jax.recordings import Tracks
from sean_jax.studies.scenes import Scene
from sean_jax.studies.validation.check import CheckContext, Skipped, models_of
from sean_jax.studies.validation.checks import CHECKS
from sean_jax.studies.validation.results import RESULTS

if TYPE_CHECKING:
    from rich.console import Console

NEAR, BORDER = 3.0, 1.5  # m from people within which walls are shown; of floor around them
HEIGHT = 2.0  # m, drawn as that of walls, which a plan does not have


def write(options: ReplayConfig, console: "Console") -> Path:
    """Simulate the scenes that the report shows of some tests, moved by the first model, and write the page.

    Raises:
        InputError: the folder has no such test, or nothing of it can be played.
    """
    folder = options.folder
    content: Any = files.read_json(folder / RESULTS)
    try:
        done = list(dict.fromkeys(str(row["check"]) for row in content["rows"]))
        words = shlex.split(content["command"])
    except (KeyError, TypeError, ValueError):
        raise InputError(
            f"{folder / RESULTS}: holds no rows; give a folder that `sean validate` has written."
        ) from None
    if words[:2] != ["sean", "validate"]:
        raise InputError(f"{folder / RESULTS}: was not made by `sean validate`; give a folder that it has written.")
    path = options.out or folder / "replay.html"
    writing.check_file(path, (".html",))
    known = [name for name in done if name in CHECKS]
    names = listed(options.only) or known[:1]
    for name in names:
        if name not in known:
            raise InputError(f"only: '{name}' is none of the tests in {folder}: {', '.join(known)}.")
    command_options = flags.read(ValidateConfig, flags.parse("validate", ValidateConfig, words[2:]))
    model = models_of(command_options.models, folder / RESULTS)[0]
    players: list[tuple[str, dict[str, Any]]] = []
    with progress(console) as bar:
        for number, name in enumerate(names):
            bar.start(name, len(names))
            context = CheckContext(model, command_options.data, command_options.quick)
            try:
                CHECKS[name].function(context)
            except Skipped as error:
                raise InputError(f"{name}: {error}") from None
            bar.update(number + 1, context.model.name)
            if not context.pictures:
                raise InputError(f"{name}: shows no scene, only figures; they are in {folder / 'report.html'}.")
            players += [
                (f"{name} · {caption}", recording(scene, tracks)) for caption, scene, tracks in context.pictures
            ]
    writing.write(path, replay.html_of_several(players, folder.resolve().name))
    return path


def recording(scene: Scene, tracks: Tracks) -> dict[str, Any]:
    """A scene as ``replay.recording``; without a robot, unless the scene has one."""
    frames = trajectory(scene, tracks)
    episode = replay.Episode(frames, "scene")
    where = place(scene, frames)
    return replay.recording([episode], where, situations=(), time_step=tracks.time_step, robot=scene.robot is not None)


def trajectory(scene: Scene, tracks: Tracks) -> Trajectory:
    """People of a scene as frames (T, ...); whoever goes around a periodic scene is absent for a moment."""
    people, present = np.asarray(tracks.position, float), np.array(tracks.present)
    if scene.period is not None:
        around = np.abs(np.diff(people[..., 0], axis=0)) > scene.period / 2.0
        present[:-1] &= ~around
    count = len(people)
    start, velocity = (np.asarray(part, float) for part in scene.robot or ((0.0, 0.0), (0.0, 0.0)))
    way = start + tracks.time_step * np.arange(count)[:, None] * velocity
    speed = float(np.hypot(*velocity))
    facing = velocity / speed if speed > 0.0 else np.array([1.0, 0.0])
    steps = np.diff(people, axis=0, append=people[-1:]) / tracks.time_step
    arrays: dict[str, Any] = dict(
        position=way,
        heading=np.tile(facing, (count, 1)),
        velocity=np.tile(velocity, (count, 1)),
        action=np.zeros((count, 2)),
        people=people,
        people_velocity=steps,
        people_heading=np.asarray(tracks.facing, float),
        group=np.full(present.shape, -1),
        present=present,
        goal=np.broadcast_to(way[-1:], way.shape),
        situations=np.zeros((count, 0), bool),
        active=np.ones(count, bool),
    )
    return Trajectory(**arrays)


def place(scene: Scene, frames: Trajectory) -> Environment:
    """The floor around a scene's people, with the walls near them."""
    seen = np.asarray(frames.people)[np.asarray(frames.present)]
    if scene.robot is not None:
        seen = np.concatenate([seen, np.asarray(frames.position)])
    lower, upper = (seen.min(0), seen.max(0)) if len(seen) else (np.zeros(2), np.ones(2))
    walls = np.asarray(scene.walls, float).reshape(-1, 5)
    cosine, sine = np.abs(np.cos(walls[:, 4])), np.abs(np.sin(walls[:, 4]))
    reach = np.stack([walls[:, 2] * cosine + walls[:, 3] * sine, walls[:, 2] * sine + walls[:, 3] * cosine], 1)
    near = ((walls[:, :2] + reach > lower - NEAR) & (walls[:, :2] - reach < upper + NEAR)).all(1)
    walls = walls[near]
    floor = np.concatenate([lower - BORDER, upper + BORDER])
    obstacles = Obstacles(
        center=jnp.asarray(walls[:, :2], float),
        half_extent=jnp.asarray(walls[:, 2:4], float),
        yaw=jnp.asarray(walls[:, 4], float),
        height=jnp.full(len(walls), HEIGHT, float),
    )
    return replace(drawing.empty_floor(frames), floor=jnp.asarray(floor, float), obstacles=obstacles, name="scene")
