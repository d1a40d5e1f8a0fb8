"""What ``sean validate`` shows: a line for each row, the gates, a page with set-up, paths, curves and verdicts, and the
page of ``sean replay`` that plays scenes of its tests."""

import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from sean_jax import drawing
from sean_jax.config import ReplayConfig, ValidateConfig, flags
from sean_jax.core.data_types import Environment, Obstacles, Trajectory
from sean_jax.core.errors import InputError
from sean_jax.drawing import colors
from sean_jax.drawing.svg import svg
from sean_jax.io import files, writing
from sean_jax.io.files import listed
from sean_jax.io.progress import progress
from sean_jax.io.versions import versions
from sean_jax.people.recordings import Tracks
from sean_jax.studies.scenes import Model, Scene
from sean_jax.studies.validation.checks import (
    CHECKS,
    FAILS,
    GATES,
    PASSES,
    RESULTS,
    SKIPPED,
    Check,
    CheckContext,
    Curve,
    Row,
    Skipped,
    matches,
    models_of,
)
from sean_jax.web import pages
from sean_jax.web import replay as player

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

PATHS = 60  # maximum number of drawn people
STRIDE = 5  # moments between two points of a path
RADIUS = 0.2  # m, of the discs at the last moment that is drawn
BORDER = 1.5  # m of floor around people
DATA = "Fitted: the loss of sean calibrate has the same measurement, so a fit should pass. Held out: it has not."
NEAR = 3.0  # m from people within which corners of walls are shown
WIDTH, TALLEST = 6.4, 6.4  # inches
HEIGHT = 2.0  # m, of walls in a replay; a plan has none


def line(row: Row, checks: Sequence[Check], models: Sequence[Model]) -> str:
    """A row for the terminal; a single model is not named."""
    wide = max(len(check.name) for check in checks)
    (data,) = (check.data for check in checks if check.name == row.check)
    model = f"{row.model:<{max(len(each.name) for each in models)}}  " if len(models) > 1 else ""
    return f"{row.check:<{wide}}  {model}{row.verdict:<7}  {data:<8}  {row.reason or row.measured}"


def gate_lines(rows: Sequence[Row], model: Model) -> list[str]:
    """A heading and a line for each gate of which something was checked, for the terminal; or nothing."""
    table = [(title, verdict, why) for title, _, verdict, why in gates(rows, model.name) if verdict != SKIPPED or why]
    if not table:
        return []
    wide = max(len(title) for title, *_ in table)
    return [f"gates of {model.name}:"] + [f"  {title:<{wide}}  {verdict:<7}  {why}" for title, verdict, why in table]


def gates(rows: Sequence[Row], model: str) -> list[tuple[str, str, str, str]]:
    """Each gate's title, promise, verdict, and the measurement or the failed checks.

    The verdict is passes, fails, partly if a part was skipped or left out, or skipped.
    """
    of_model = {row.check: row for row in rows if row.model == model}
    table = []
    for gate in GATES:
        names = [name for pattern in gate.checks for name in matches(pattern)]
        done = [of_model[name] for name in names if name in of_model]
        failing = [row for row in done if row.verdict == FAILS]
        passing = [row for row in done if row.verdict == PASSES]
        if failing:
            which = f"{len(failing)} of {len(names)}: {', '.join(row.check for row in failing)}"
            verdict, why = FAILS, which if len(names) > 1 else failing[0].reason
        elif names and len(passing) == len(names):
            verdict, why = PASSES, f"all {len(names)}" if len(names) > 1 else passing[0].measured
        elif passing:
            verdict, why = "partly", f"{len(passing)} of {len(names)} done, all pass"
        else:
            verdict, why = SKIPPED, "; ".join(dict.fromkeys(row.reason for row in done))
        table.append((gate.title, gate.promise, verdict, why))
    return table


def markdown(checks: Sequence[Check], models: Sequence[Model], rows: Sequence[Row]) -> str:
    """The table as docs/validation.md has it, and one of the gates of the first model."""
    by_name = {(row.check, row.model): row for row in rows}
    names = [model.name for model in models]
    lines = ["| check | data | " + " | ".join(names) + " |", "|---" * (2 + len(names)) + "|"]
    for check in checks:
        cells = (by_name[check.name, name] for name in names)
        texts = (f"{row.verdict}: {row.reason or row.measured}".replace("|", "/") for row in cells)
        lines.append(f"| {check.name} | {check.data} | " + " | ".join(texts) + " |")
    lines += ["", f"| gate | promise | {names[0]} |", "|---|---|---|"]
    for title, promise, verdict, why in gates(rows, names[0]):
        lines.append(f"| {title} | {promise} | {verdict}{why and ': ' + why} |")
    return "\n".join(lines) + "\n"


def html(options: ValidateConfig, checks: Sequence[Check], models: Sequence[Model], rows: Sequence[Row]) -> str:
    """The report."""
    by_name = {(row.check, row.model): row for row in rows}
    verdicts = []
    for check in checks:
        cells = [
            _verdict(row.verdict, row.reason or row.measured) for row in (by_name[check.name, m.name] for m in models)
        ]
        verdicts.append([pages.Cell(check.name, check.title), check.data, check.criterion, *cells])
    promises = [
        [title, promise, _verdict(verdict, why)] for title, promise, verdict, why in gates(rows, models[0].name)
    ]
    head = ["", "data", "criterion", *(model.name for model in models)]
    sections = [
        pages.section("Verdicts", pages.table(head, verdicts, "words"), pages.note(DATA)),
        pages.section(f"Gates of {models[0].name}", pages.table([], promises, "words")),
        *(_check(check, [by_name[check.name, model.name] for model in models]) for check in checks),
        pages.origin(flags.command("validate", options), versions()),
    ]
    return pages.page("Validation of the people", "sean_jax · sean validate", sections)


def _verdict(verdict: str, reason: str) -> pages.Cell:
    return pages.Cell(verdict, reason, verdict)


def _check(check: Check, rows: Sequence[Row]) -> str:
    """The section of a check, with a row for each model."""
    facts = {
        "set-up": check.setup,
        "measured": check.measure,
        "passes if": check.criterion,
        "source": check.source,
        "data": check.data,
    }
    facts |= {row.model: f"{row.verdict}: {row.reason or row.measured}" for row in rows}
    pictures = [pages.figure(picture, f"{row.model}: {caption}") for row in rows for caption, picture in row.pictures]
    curves = {}
    for row in rows:
        several = len({one.name for one in row.curves if not one.reference}) > 1
        for curve in row.curves:
            name = curve.name if curve.reference else f"{row.model}: {curve.name}" if several else row.model
            curves[name, curve.reference] = replace(curve, name=name)
    if curves:
        drawing = svg(plot(list(curves.values()), rows[0].axes), f"{check.name}-curves")
        pictures.append(pages.figure(drawing))
    parts = [pages.facts(facts), pages.grid(pictures)] if pictures else [pages.facts(facts)]
    return pages.section(f"{check.name} · {check.title}", *parts)


# ------------------------------------------------------------------ pictures


def trajectories(scene: Scene, tracks: Tracks) -> "Figure":
    """Walls, gates, the paths of some people, and everybody half way through the time."""
    from matplotlib.collections import EllipseCollection, LineCollection, PolyCollection
    from matplotlib.figure import Figure

    position, present = np.asarray(tracks.position, float), np.asarray(tracks.present)
    places = position[present]
    lower, upper = (places.min(0), places.max(0)) if len(places) else (np.zeros(2), np.ones(2))
    boxes = np.asarray(scene.walls).reshape(-1, 5)
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * boxes[:, None, 2:4]
    cosine, sine = np.cos(boxes[:, None, 4]), np.sin(boxes[:, None, 4])
    x, y = corners[..., 0] * cosine - corners[..., 1] * sine, corners[..., 0] * sine + corners[..., 1] * cosine
    corners = np.stack([x, y], -1) + boxes[:, None, :2]
    near = corners[((corners > lower - NEAR) & (corners < upper + NEAR)).all(-1)]
    lower, upper = lower - BORDER, upper + BORDER
    lower, upper = np.min([lower, *near], axis=0), np.max([upper, *near], axis=0)
    wide, tall = upper - lower
    height = min(max(WIDTH * tall / wide, 0.8), TALLEST)
    figure = Figure(figsize=(WIDTH, height), facecolor=colors.PAPER)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_xlim(lower[0], upper[0])
    axes.set_ylim(lower[1], upper[1])
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.add_collection(PolyCollection(list(corners), facecolors=colors.OBSTACLE))
    gates = [gate for gate in scene.gates if np.abs(np.asarray(gate)).max() < 1e3]
    axes.add_collection(LineCollection(gates, colors=colors.FLOW, linewidths=1.6, linestyles="dashed", zorder=2))
    shown = np.linspace(0, present.shape[1] - 1, min(PATHS, present.shape[1])).astype(int)
    for person in shown:
        path = position[:, person].copy()
        path[~present[:, person]] = np.nan
        path = path[::STRIDE]
        jump = np.linalg.norm(np.diff(path, axis=0, prepend=path[:1]), axis=1) > STRIDE  # around a period
        path[jump] = np.nan
        axes.plot(*path.T, color=colors.TRAIL, linewidth=0.9, alpha=0.7, zorder=3, rasterized=True)
    there = present.any(1)
    moment = int(np.flatnonzero(there)[there.sum() // 2]) if there.any() else 0
    spots = position[moment][present[moment]]
    size = np.full(len(spots), 2 * RADIUS)
    discs = EllipseCollection(
        size, size, np.zeros_like(size), units="xy", offsets=spots, offset_transform=axes.transData,
        facecolors=colors.PERSON, edgecolors=colors.PERSON_EDGE, linewidths=0.6, zorder=4,
    )  # fmt: skip
    axes.add_collection(discs)
    if scene.robot is not None:
        path = scene.robot_path(np.array([0.0, (len(position) - 1) * tracks.time_step]))
        axes.plot(*path.T, color=colors.ROBOT, linewidth=2.0, zorder=5)
    return figure


def plot(curves: Sequence[Curve], axes: tuple[str, str]) -> "Figure":
    """Curves of all models, and in grey reference curves, with the quantities and units of both axes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, 3.6), layout="constrained", facecolor=colors.PAPER)
    axis = figure.add_subplot()
    names = list(dict.fromkeys(curve.name for curve in curves if not curve.reference))
    shades = dict(zip(names, colors.policy_colors(names), strict=True))
    for curve in curves:
        color = colors.MUTED if curve.reference else shades[curve.name]
        axis.plot(
            curve.x,
            curve.y,
            color=color,
            linestyle="none" if curve.points else "--" if curve.reference else "-",
            marker="o" if curve.points or not curve.reference else "",
            markersize=4,
            linewidth=1.6,
            label=curve.name,
        )
    axis.set_xlabel(axes[0], color=colors.MUTED)
    axis.set_ylabel(axes[1], color=colors.MUTED)
    axis.tick_params(colors=colors.MUTED)
    axis.set_facecolor(colors.PAPER)
    axis.grid(True, color="#e4e8ef", linewidth=0.8)
    axis.set_axisbelow(True)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    axis.legend(frameon=False)
    return figure


# ------------------------------------------------------------------ replay


def write_replay(options: ReplayConfig, console: "Console") -> Path:
    """Simulate the scenes that the report shows of some tests, moved by the first model, and write the page.

    Raises:
        InputError: the folder has no such test, or nothing of it can be played.
    """
    folder, file = options.folder, options.folder / RESULTS
    content: Any = files.read_json(file)
    try:
        done = list(dict.fromkeys(str(row["check"]) for row in content["rows"]))
        words = shlex.split(content["command"])
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{file}: holds no rows; give a folder that `sean validate` has written.") from None
    if words[:2] != ["sean", "validate"]:
        raise InputError(f"{file}: was not made by `sean validate`; give a folder that it has written.")
    path = options.out or folder / "replay.html"
    writing.check_file(path, (".html",))
    known = [name for name in done if name in CHECKS]
    names = listed(options.only) or known[:1]
    for name in names:
        if name not in known:
            raise InputError(f"only: '{name}' is none of the tests in {folder}: {', '.join(known)}.")
    command_options = flags.read(ValidateConfig, flags.parse("validate", ValidateConfig, words[2:]))
    model = models_of(command_options.models, file)[0]
    players: list[tuple[str, dict[str, Any]]] = []
    with progress(console) as bar:
        for number, name in enumerate(names):
            bar.start(name, len(names))
            context = CheckContext(model, command_options.data, command_options.quick)
            try:
                CHECKS[name].run(context)
            except Skipped as error:
                raise InputError(f"{name}: {error}") from None
            bar.update(number + 1, context.model.name)
            if not context.pictures:
                raise InputError(f"{name}: shows no scene, only figures; they are in {folder / 'report.html'}.")
            players += [
                (f"{name} · {caption}", recording(scene, tracks)) for caption, scene, tracks in context.pictures
            ]
    writing.write(path, player.html_of_several(players, folder.resolve().name))
    return path


def recording(scene: Scene, tracks: Tracks) -> dict[str, Any]:
    """A scene as ``replay.recording``; without a robot, unless the scene has one."""
    frames = trajectory(scene, tracks)
    episodes, robot = [player.Episode(frames, "scene")], scene.robot is not None
    return player.recording(episodes, place(scene, frames), situations=(), time_step=tracks.time_step, robot=robot)


def trajectory(scene: Scene, tracks: Tracks) -> Trajectory:
    """People of a scene as frames (T, ...); a person who goes around a periodic scene is absent for a frame."""
    people, present = np.asarray(tracks.position, float), np.array(tracks.present)
    if scene.period is not None:
        around = np.abs(np.diff(people[..., 0], axis=0)) > scene.period / 2.0
        present[:-1] &= ~around
    count = len(people)
    way = scene.robot_path(tracks.time_step * np.arange(count))
    velocity = np.asarray(scene.robot[1] if scene.robot else (0.0, 0.0), float)
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
    places = np.asarray(frames.people)[np.asarray(frames.present)]
    if scene.robot is not None:
        places = np.concatenate([places, np.asarray(frames.position)])
    lower, upper = (places.min(0), places.max(0)) if len(places) else (np.zeros(2), np.ones(2))
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
