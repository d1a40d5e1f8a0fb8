"""The page of ``sean replay`` that plays the scenes of tests of ``sean validate``."""

import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from sean_jax import drawing
from sean_jax.config import ReplayConfig, ValidateConfig, flags
from sean_jax.core.data_types import Environment, Obstacles, Trajectory
from sean_jax.core.errors import InputError
from sean_jax.io import files, writing
from sean_jax.io.files import listed
from sean_jax.io.progress import progress
from sean_jax.people.recordings import Tracks
from sean_jax.studies.scenes import Model, Scene
from sean_jax.studies.validation.checks import CHECKS, RESULTS, CheckContext, Skipped, models_of
from sean_jax.studies.validation.pictures import BORDER, NEAR, extent, wall_corners
from sean_jax.web import replay as player

if TYPE_CHECKING:
    from rich.console import Console

HEIGHT = 2.0  # m, of walls; a plan has none


def write_replay(options: ReplayConfig, console: "Console") -> Path:
    """Simulate the scenes that the report shows of some tests, moved by the first model, and write the page.

    Raises:
        InputError: the folder has no such test, or nothing of it can be played.
    """
    folder = options.folder
    tests, validation = _read_results(folder)
    path = options.out or folder / "replay.html"
    writing.check_file(path, (".html",))
    names = _chosen_tests(folder, tests, options.only)
    model = models_of(validation.models, folder / RESULTS)[0]

    players: list[tuple[str, dict[str, Any]]] = []
    with progress(console) as bar:
        for number, name in enumerate(names):
            bar.start(name, len(names))
            pictures = _scenes(name, model, validation, folder)
            bar.update(number + 1, model.name)
            players += [(f"{name} · {caption}", recording(scene, tracks)) for caption, scene, tracks in pictures]
    writing.write(path, player.html_of_several(players, folder.resolve().name))
    return path


def _read_results(folder: Path) -> tuple[list[str], ValidateConfig]:
    """The tests of a folder of ``sean validate``, and the options of that command."""
    file = folder / RESULTS
    content: Any = files.read_json(file)
    try:
        tests = list(dict.fromkeys(str(row["check"]) for row in content["rows"]))
        words = shlex.split(content["command"])
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{file}: holds no rows; give a folder that `sean validate` has written.") from None
    if words[:2] != ["sean", "validate"]:
        raise InputError(f"{file}: was not made by `sean validate`; give a folder that it has written.")
    return tests, flags.read(ValidateConfig, flags.parse("validate", ValidateConfig, words[2:]))


def _chosen_tests(folder: Path, tests: list[str], only: str | None) -> list[str]:
    """The tests that the option names; the first one by default."""
    known = [name for name in tests if name in CHECKS]
    names = listed(only) or known[:1]
    for name in names:
        if name not in known:
            raise InputError(f"only: '{name}' is none of the tests in {folder}: {', '.join(known)}.")
    return names


def _scenes(name: str, model: Model, options: ValidateConfig, folder: Path) -> list[tuple[str, Scene, Tracks]]:
    """The scenes that a test shows, simulated again."""
    context = CheckContext(model, options.data, options.quick)
    try:
        CHECKS[name].run(context)
    except Skipped as error:
        raise InputError(f"{name}: {error}") from None
    if not context.pictures:
        raise InputError(f"{name}: shows no scene, only figures; they are in {folder / 'report.html'}.")
    return context.pictures


def recording(scene: Scene, tracks: Tracks) -> dict[str, Any]:
    """A scene as ``replay.recording``; without a robot, unless the scene has one."""
    frames = trajectory(scene, tracks)
    episodes, robot = [player.ReplayEpisode(frames, "scene")], scene.robot is not None
    return player.recording(episodes, place(scene, frames), situations=(), time_step=tracks.time_step, robot=robot)


def trajectory(scene: Scene, tracks: Tracks) -> Trajectory:
    """People of a scene as frames (T, ...); a person who goes around a periodic scene is absent for a frame."""
    people, present = np.asarray(tracks.position, float), np.array(tracks.present)
    if scene.period is not None:
        around = np.abs(np.diff(people[..., 0], axis=0)) > scene.period / 2.0
        present[:-1] &= ~around

    moments = len(people)
    robot = scene.robot_path(tracks.time_step * np.arange(moments))  # (T, 2) m
    velocity = np.asarray(scene.robot[1] if scene.robot else (0.0, 0.0), float)
    speed = float(np.hypot(*velocity))
    heading = velocity / speed if speed > 0.0 else np.array([1.0, 0.0])
    arrays: dict[str, Any] = dict(
        position=robot,
        heading=np.tile(heading, (moments, 1)),
        velocity=np.tile(velocity, (moments, 1)),
        action=np.zeros((moments, 2)),
        people=people,
        people_velocity=np.diff(people, axis=0, append=people[-1:]) / tracks.time_step,
        people_heading=np.asarray(tracks.facing, float),
        group=np.full(present.shape, -1),
        present=present,
        goal=np.broadcast_to(robot[-1:], robot.shape),
        situations=np.zeros((moments, 0), bool),
        active=np.ones(moments, bool),
    )
    return Trajectory(**arrays)


def place(scene: Scene, frames: Trajectory) -> Environment:
    """The floor around a scene's people, with the walls near them."""
    places = np.asarray(frames.people)[np.asarray(frames.present)]
    if scene.robot is not None:
        places = np.concatenate([places, np.asarray(frames.position)])
    lower, upper = extent(places)

    corners = wall_corners(scene.walls)
    near = (corners.max(1) > lower - NEAR) & (corners.min(1) < upper + NEAR)  # (W, 2)
    walls = np.asarray(scene.walls, float).reshape(-1, 5)[near.all(1)]
    obstacles = Obstacles(
        center=jnp.asarray(walls[:, :2], float),
        half_extent=jnp.asarray(walls[:, 2:4], float),
        yaw=jnp.asarray(walls[:, 4], float),
        height=jnp.full(len(walls), HEIGHT, float),
    )
    floor = jnp.asarray(np.concatenate([lower - BORDER, upper + BORDER]), float)
    return replace(drawing.empty_floor(frames), floor=floor, obstacles=obstacles, name="scene")
