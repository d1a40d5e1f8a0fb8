"""``sean survey ratings``: published ratings of robots' trajectories against metrics, in the format of SocNav3.

Source: P. Bachiller-Burgos et al., "Towards Data-Driven Metrics for Social Robot Navigation Benchmarking", arXiv
2509.01251 (2025), and the JSON Schema of its repository.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pydantic
from jaxtyping import Float
from rich.console import Console
from rich.text import Text

from sean_jax.config import SurveyRatingsConfig
from sean_jax.core.bounds import MAX_OBSTACLES, Coordinate, Radius, parse_digits
from sean_jax.core.data_types import Array, Obstacles
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import length
from sean_jax.core.padding import pad
from sean_jax.io import files, writing
from sean_jax.io.files import Problem
from sean_jax.metrics import METRICS
from sean_jax.people import recordings
from sean_jax.people.recordings.reading import LONGEST_GAP, ROUNDING, Tracks
from sean_jax.studies.survey import export, report
from sean_jax.web import pages

TIME_STEP = 0.1  # s between snapshots, as in the simulator
MAX_SECONDS = 3600.0  # of a trajectory
MEASURED = {name: metric for name, metric in METRICS.items() if name != "success_by_time"}
"""The metrics of a trajectory. The file does not state the top speed that ``success_by_time`` needs."""
VARIANTS = "trajectory_variants.json"
RATING = "rating"

Angle = Annotated[float, pydantic.Field(ge=-1000, le=1000)]  # rad, counter-clockwise from the x axis
Size = Annotated[float, pydantic.Field(ge=0, le=100)]  # m


class Pose(pydantic.BaseModel):
    """Of a robot, a person, an object or a goal; further keys of the file, such as speeds, are ignored."""

    x: Coordinate
    y: Coordinate
    angle: Angle


class Shape(pydantic.BaseModel):
    """A disc, or a rectangle whose length lies along the angle of its pose."""

    type: Literal["circle", "rectangle"]
    width: Size  # of a circle its diameter
    length: Size


class Body(Pose):
    """A robot or an object."""

    shape: Shape


class Person(Pose):
    """A person."""

    id: Annotated[float, pydantic.Field(allow_inf_nan=False)]


class Goal(Pose):
    """A goal that the robot goes to; the metrics are of no other task."""

    type: Literal["go-to"]
    pos_threshold: Radius | None = None  # m


class Frame(pydantic.BaseModel):
    """All at one time."""

    timestamp: Annotated[float, pydantic.Field(allow_inf_nan=False)]  # s
    robot: Body
    goal: Goal
    people: list[Person]
    objects: list[Body]


class Recorded(pydantic.BaseModel):
    """A file with a trajectory. Its occupancy grid is ignored, as in the metrics of its authors."""

    walls: Annotated[list[tuple[Coordinate, Coordinate, Coordinate, Coordinate]], pydantic.Field(max_length=1000)]
    sequence: Annotated[list[Frame], pydantic.Field(min_length=2)]


class RatingAnswers(pydantic.BaseModel):
    """A file with the ratings of a person: ``answers[k]`` rates the trajectory of number ``indices[k]``."""

    indices: list[int]
    answers: dict[str, Annotated[float, pydantic.Field(ge=0, le=1)]]


class Variants(pydantic.RootModel[dict[str, list[str]]]):
    """Variant -> the names of files that differ in the walls alone."""


class RatedEpisode(NamedTuple):
    """A robot, column 0 of the tracks, among people and obstacles."""

    tracks: Tracks
    goal: Float[Array, " 2"]  # m
    goal_radius: Float[Array, ""]  # m
    robot_radius: Float[Array, ""]  # m
    obstacles: Obstacles


def run(options: SurveyRatingsConfig, console: Console) -> Path:
    """Measure the rated trajectories, print the correlations and write the folder: two tables and a page.

    Raises:
        InputError: a file is missing or malformed, or there are too few ratings.
    """
    rows = rated(options.trajectories, options.ratings, console)
    found = report.correlations(rows, ("participant", "trial"))
    if not found:
        least = report.MIN_PARTICIPANTS
        raise InputError(f"ratings: {options.ratings} rates too little; give {least} raters and {least} trajectories.")
    title = "Correlations of ratings with metrics"
    head, cells = report.correlation_table(found)
    report.print_table(console, title, head, cells)
    note = (
        f"{report.counted(found)} Correlations are Spearman's over ratings. The variance of Fisher's z is that of a "
        "bootstrap over raters plus that over trajectories, less that over pairs of both; variants of a trajectory "
        "count as one. Raters read different contexts, which no metric knows. A correlation is no cause."
    )
    console.print(Text(note, "dim"), soft_wrap=True)
    numbers = {"raters": "participant", "trajectories": "trajectory", "trajectories without their variants": "trial"}
    facts = {"ratings": len(rows)}
    for word, key in numbers.items():
        facts[word] = len({row[key] for row in rows})

    sections = [
        pages.section(title, pages.table(head, cells)),
        pages.section("How to read it", pages.note(note)),
        pages.section("Data", pages.facts(facts)),
    ]
    page = pages.page("Ratings and metrics", "sean_jax · ratings", sections)
    with writing.atomic_folder(options.out) as folder:
        writing.write(folder / "correlations.csv", export.to_csv([each._asdict() for each in found]))
        writing.write(folder / "trajectories.csv", export.to_csv(by_trajectory(rows)))
        writing.write(folder / "report.html", page)
    return options.out / "report.html"


def rated(trajectories: Path, ratings: Path, console: Console) -> list[dict[str, Any]]:
    """A row for each rating: ``participant``, ``trajectory``, ``trial`` (its variant), ``ratings`` and ``metrics``.

    Args:
        trajectories: a folder with files such as ``000000123.json``, in folders of any depth.
        ratings: a folder with a file for each rater.

    Raises:
        FileError: a file is missing or malformed.
        InputError: there is none.
    """
    paths = _numbered(trajectories)
    variants = _variants(trajectories)
    rows = []
    for path in sorted(ratings.glob("*.json")):
        answers = read_answers(path, paths)
        for place, value in answers.answers.items():
            number = answers.indices[int(place)]
            trial = variants.get(number, str(number))
            ratings_by_name = {RATING: value}
            row = {"participant": path.stem, "trajectory": number, "trial": trial, "ratings": ratings_by_name}
            rows.append(row)
    if not rows:
        raise InputError(f"ratings: {ratings} has no file *.json with answers; give the folder with a file per rater.")
    rated_ones = sorted({row["trajectory"] for row in rows})
    metrics = {}
    with console.status("") as status:
        for count, number in enumerate(rated_ones, 1):
            status.update(f"measuring trajectory {count} of {len(rated_ones)}")
            metrics[number] = measure(read(paths[number]))
    return [row | {"metrics": metrics[row["trajectory"]]} for row in rows]


def read_answers(path: Path, trajectories: Mapping[int, Any]) -> RatingAnswers:
    """The ratings of a person, of numbered trajectories; FileError if a value is wrong."""

    def known(answers: RatingAnswers) -> Iterator[Problem]:
        for place in answers.answers:
            index = parse_digits(place)
            if index is None or index >= len(answers.indices):
                yield ("answers", place), f"is no place in the {len(answers.indices)} indices; remove the answer"
            elif (number := answers.indices[index]) not in trajectories:
                yield ("indices", index), f"{number} has no file {number:09}.json; add it or remove the answer"

    return files.check_json(path, files.read_json(path, strict=False), RatingAnswers, known)


def by_trajectory(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row for each trajectory: number of ratings, their mean, and the metrics."""
    values: dict[int, list[float]] = {}
    first = {}
    for row in rows:
        values.setdefault(row["trajectory"], []).append(row["ratings"][RATING])
        first.setdefault(row["trajectory"], row)
    table = []
    for number, ratings in sorted(values.items()):
        row = first[number]
        summary = {
            "trajectory": number,
            "variant": row["trial"],
            "ratings": len(ratings),
            "mean_rating": np.mean(ratings),
        }
        table.append(summary | row["metrics"])
    return table


def _numbered(folder: Path) -> dict[int, Path]:
    paths: dict[int, Path] = {}
    for path in sorted(folder.rglob("*.json")):
        if path.stem.isdecimal():
            other = paths.setdefault(int(path.stem), path)
            if other != path:
                raise files.file_error(path, f"has the number of {other}; keep one of them")
    if not paths:
        text = f"trajectories: {folder} has no file such as 000000001.json; give the folder of unlabeled trajectories."
        raise InputError(text)
    return paths


def _variants(folder: Path) -> dict[int, str]:
    """Number of a trajectory -> its variant, if the folder says so."""
    path = folder / VARIANTS
    if not path.is_file():
        return {}
    groups = files.check_json(path, files.read_json(path), Variants).root
    variants = {}
    for variant, names in groups.items():
        for name in names:
            stem, _, _ = name.partition(".")
            number = parse_digits(stem)
            if number is not None:
                variants[number] = f"variant {variant}"
    return variants


# ------------------------------------------------------------------ a trajectory


def read(path: Path) -> RatedEpisode:
    """The trajectory of a file, at steps of 0.1 s between which positions and angles are interpolated linearly.

    The sizes are powers of two, so that few programs are compiled: rows after the end have nobody present, not even
    the robot. A person is absent in a gap of more than 2 s. Objects stand where they are in the first frame.

    Raises:
        FileError: it cannot be read, or a value is wrong.
    """
    recorded = files.check_json(path, files.read_json(path), Recorded, _times, _people, _boxes)
    last_goal = recorded.sequence[-1].goal
    goal: Any = np.array([last_goal.x, last_goal.y], np.float32)
    radius = last_goal.pos_threshold
    if radius is None:
        radius = 1.2  # SEAN's
    goal_radius: Any = np.float32(radius)

    shape = recorded.sequence[0].robot.shape
    robot_radius: Any = np.float32(max(shape.width, shape.length) / 2)
    return RatedEpisode(_tracks(recorded), goal, goal_radius, robot_radius, _obstacles(recorded))


def _tracks(recorded: Recorded) -> Tracks:
    """The robot, and after it people, at the steps of a grid."""
    frames = recorded.sequence

    # The metrics need equal steps; recorded frames come at whatever rate a robot has.
    times = np.array([frame.timestamp for frame in frames]) - frames[0].timestamp
    steps = int((times[-1] + ROUNDING) / TIME_STEP)
    grid = np.arange(steps + 1) * TIME_STEP  # (T,) s

    poses: dict[float | None, list[tuple[float, Pose]]] = {None: []}  # of the robot, and then of people
    for time, frame in zip(times, frames, strict=True):
        poses[None].append((time, frame.robot))
        for person in frame.people:
            poses.setdefault(person.id, []).append((time, person))

    # After the end, and in columns without a person, nobody is present.
    end = len(grid)
    rows = _power(end, 64)
    columns = _power(len(poses), 4)
    position = np.zeros((rows, columns, 2), np.float32)
    facing = np.zeros((rows, columns, 2), np.float32)
    facing[..., 0] = 1.0
    present = np.zeros((rows, columns), bool)
    for column, poses_of_body in enumerate(poses.values()):
        known = np.array([time for time, _ in poses_of_body])
        components = np.array([(pose.x, pose.y, pose.angle) for _, pose in poses_of_body])
        x, y, angle = components.T
        position[:end, column, 0] = np.interp(grid, known, x)
        position[:end, column, 1] = np.interp(grid, known, y)

        # Angles are unwrapped first: from 179 to -179 degrees is a turn of 2 and not of 358.
        angle = np.interp(grid, known, np.unwrap(angle))
        facing[:end, column, 0] = np.cos(angle)
        facing[:end, column, 1] = np.sin(angle)
        present[:end, column] = _is_present(known, grid, always=column == 0)

    # Such recordings name no groups: -1 is "not known".
    nobody = np.full((rows, columns), -1, np.int32)
    frame = np.arange(rows, dtype=np.int32)
    return Tracks(position, facing, nobody, present, nobody, frame, TIME_STEP)  # pyright: ignore[reportArgumentType]


def _is_present(known: np.ndarray, grid: np.ndarray, always: bool) -> np.ndarray:
    """Whether a body is there at the times of a grid: between known times that are not too far apart.

    Args:
        always: whether it is there in every gap.
    """
    has_begun = grid >= known[0] - ROUNDING
    inside = has_begun & (grid <= known[-1] + ROUNDING)
    if always:
        return inside
    later = np.searchsorted(known, grid - ROUNDING)
    later = np.clip(later, 0, len(known) - 1)
    earlier = np.maximum(later - 1, 0)
    is_known = np.abs(known[later] - grid) <= ROUNDING
    gap = np.where(is_known, 0.0, known[later] - known[earlier])
    return inside & (gap <= LONGEST_GAP + ROUNDING)


def _times(recorded: Recorded) -> Iterator[Problem]:
    times = [frame.timestamp for frame in recorded.sequence]
    for k, (before, after) in enumerate(itertools.pairwise(times), 1):
        if after <= before:
            yield ("sequence", k, "timestamp"), f"{after:g} s is not after {before:g} s; put the frames in order"
    span = times[-1] - times[0]
    if not TIME_STEP - ROUNDING <= span <= MAX_SECONDS:
        where = ("sequence", len(times) - 1, "timestamp")
        yield where, f"the trajectory takes {span:g} s; give one of {TIME_STEP:g} to {MAX_SECONDS:g} s"


def _people(recorded: Recorded) -> Iterator[Problem]:
    for k, frame in enumerate(recorded.sequence):
        seen = set[float]()
        for j, number in enumerate(person.id for person in frame.people):
            if number in seen:
                yield ("sequence", k, "people", j, "id"), f"{number:g} is there twice; give each person an id"
            seen.add(number)


def _boxes(recorded: Recorded) -> Iterator[Problem]:
    number = len(recorded.walls) + len(recorded.sequence[0].objects)
    if number > MAX_OBSTACLES:
        yield ("walls",), f"{number:,} walls and objects are more than {MAX_OBSTACLES:,}; leave some out"


def _obstacles(recorded: Recorded) -> Obstacles:
    """Walls, without thickness, and objects; a round object is the square around it. Walls of no length are none."""
    rows = []
    for x1, y1, x2, y2 in recorded.walls:
        dx = x2 - x1
        dy = y2 - y1
        size = np.hypot(dx, dy)
        if size > 0:
            rows.append(((x1 + x2) / 2, (y1 + y2) / 2, size / 2, 0.0, np.arctan2(dy, dx)))
    for body in recorded.sequence[0].objects:
        shape = body.shape
        rows.append((body.x, body.y, shape.length / 2, shape.width / 2, body.angle))

    table: Any = np.array(rows, np.float32).reshape(-1, 5)  # (W, 5)
    height: Any = np.ones(len(table), np.float32)
    obstacles: Any = Obstacles(table[:, :2], table[:, 2:4], table[:, 4], height)
    return pad(obstacles, {("Obstacles", "W"): _power(len(table), 16)})


def _power(number: int, least: int) -> int:
    if not number:
        return least
    return max(least, 1 << (number - 1).bit_length())


def measure(episode: RatedEpisode) -> dict[str, float]:
    """The metrics ``MEASURED`` of a trajectory by name; without those of completed episodes if it ends elsewhere.

    The shortest path is the straight line from start to goal, and people have the radius ``recordings.BODY``.
    """
    values = {name: float(value) for name, value in _measure(episode).items()}
    if values["reached_goal"] == 1.0:
        return values
    return {name: value for name, value in values.items() if not MEASURED[name].completed_only}


@jax.jit
def _measure(episode: RatedEpisode) -> dict[str, Array]:
    tracks = jax.tree.map(jnp.asarray, episode.tracks)
    snapshots, recorded = recordings.snapshots_of(tracks, 0, tracks.group)

    def always(value: Array) -> Array:
        return jnp.broadcast_to(value, (recorded.shape[0], *jnp.shape(value)))

    # A recording says nothing about the task: each snapshot gets goal, way and obstacles of the file.
    gap = episode.goal - snapshots.start[0]
    snapshots = replace(
        snapshots,
        people=replace(snapshots.people, heading=tracks.facing),
        heading=tracks.facing[:, 0],
        goal=always(episode.goal),
        goal_radius=always(episode.goal_radius),
        geodesic=always(length(gap[0], gap[1])),
        robot_radius=always(episode.robot_radius),
        obstacles=jax.tree.map(always, episode.obstacles),
    )
    first = jax.tree.map(lambda leaf: leaf[0], snapshots)

    def update(carry: tuple, row: tuple) -> tuple[tuple, None]:
        # After the end of the trajectory the values stay as they are.
        before, values = carry
        after, is_recorded = row
        updated = {name: metric.update(values[name], before, after) for name, metric in MEASURED.items()}
        values = jax.tree.map(lambda new, old: jnp.where(is_recorded, new, old), updated, values)
        return (after, values), None

    begin = first, {name: metric.init(first) for name, metric in MEASURED.items()}
    rest = jax.tree.map(lambda leaf: leaf[1:], (snapshots, recorded))
    (_, values), _ = jax.lax.scan(update, begin, rest)

    # Of metrics of several numbers, the first one counts.
    metrics = {}
    for name, metric in MEASURED.items():
        value = metric.compute(values[name])
        metrics[name] = jnp.ravel(value)[0]
    return metrics
