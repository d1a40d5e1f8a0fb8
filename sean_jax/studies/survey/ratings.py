"""``sean survey ratings``: published ratings of robots' trajectories against metrics, in the format of SocNav3.

Source: P. Bachiller-Burgos et al., "Towards Data-Driven Metrics for Social Robot Navigation Benchmarking", arXiv
2509.01251 (2025), and the JSON Schema of its repository.
"""

from __future__ import annotations

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
    title, (head, cells) = "Correlations of ratings with metrics", report.correlation_table(found)
    report.print_table(console, title, head, cells)
    note = (
        f"{report.counted(found)} Correlations are Spearman's over ratings. The variance of Fisher's z is that of a "
        "bootstrap over raters plus that over trajectories, less that over pairs of both; variants of a trajectory "
        "count as one. Raters read different contexts, which no metric knows. A correlation is no cause."
    )
    console.print(Text(note, "dim"), soft_wrap=True)
    numbers = {"raters": "participant", "trajectories": "trajectory", "trajectories without their variants": "trial"}
    facts = {"ratings": len(rows), **{word: len({row[key] for row in rows}) for word, key in numbers.items()}}
    parts = (pages.section(title, pages.table(head, cells)), pages.section("How to read it", pages.note(note)))
    page = pages.page("Ratings and metrics", "sean_jax · ratings", [*parts, pages.section("Data", pages.facts(facts))])
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
            row = {"participant": path.stem, "trajectory": number, "trial": trial, "ratings": {RATING: value}}
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
    return [
        {"trajectory": number, "variant": first[number]["trial"], "ratings": len(some), "mean_rating": np.mean(some)}
        | first[number]["metrics"]
        for number, some in sorted(values.items())
    ]


def _numbered(folder: Path) -> dict[int, Path]:
    paths: dict[int, Path] = {}
    for path in sorted(folder.rglob("*.json")):
        if path.stem.isdecimal():
            if (other := paths.setdefault(int(path.stem), path)) != path:
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
    stems = {name.partition(".")[0]: variant for variant, names in groups.items() for name in names}
    numbers = {parse_digits(stem): f"variant {variant}" for stem, variant in stems.items()}
    return {number: variant for number, variant in numbers.items() if number is not None}


# ------------------------------------------------------------------ a trajectory


def read(path: Path) -> RatedEpisode:
    """The trajectory of a file, at steps of 0.1 s between which positions and angles are interpolated linearly.

    The sizes are powers of two, so that few programs are compiled: rows after the end have nobody present, not even
    the robot. A person is absent in a gap of more than 2 s. Objects stand where they are in the first frame.

    Raises:
        FileError: it cannot be read, or a value is wrong.
    """
    recorded = files.check_json(path, files.read_json(path), Recorded, _times, _people, _boxes)
    first, last = recorded.sequence[0], recorded.sequence[-1]
    radius = 1.2 if last.goal.pos_threshold is None else last.goal.pos_threshold  # SEAN's
    goal: Any = np.array([last.goal.x, last.goal.y], np.float32)
    goal_radius: Any = np.float32(radius)
    robot_radius: Any = np.float32(max(first.robot.shape.width, first.robot.shape.length) / 2)
    return RatedEpisode(_tracks(recorded), goal, goal_radius, robot_radius, _obstacles(recorded))


def _tracks(recorded: Recorded) -> Tracks:
    """The robot, and after it people, at the steps of a grid."""
    frames = recorded.sequence

    # The metrics need equal steps; recorded frames come at whatever rate a robot has.
    times = np.array([frame.timestamp for frame in frames]) - frames[0].timestamp
    grid = np.arange(int((times[-1] + ROUNDING) / TIME_STEP) + 1) * TIME_STEP  # (T,) s

    poses: dict[float | None, list[tuple[float, Pose]]] = {None: []}  # of the robot, and then of people
    for time, frame in zip(times, frames, strict=True):
        poses[None].append((time, frame.robot))
        for person in frame.people:
            poses.setdefault(person.id, []).append((time, person))

    # After the end, and in columns without a person, nobody is present.
    rows, columns, end = _power(len(grid), 64), _power(len(poses), 4), len(grid)
    position, facing = np.zeros((rows, columns, 2), np.float32), np.zeros((rows, columns, 2), np.float32)
    present = np.zeros((rows, columns), bool)
    facing[..., 0] = 1.0
    for column, poses_of_body in enumerate(poses.values()):
        # Angles are unwrapped first: from 179 to -179 degrees is a turn of 2 and not of 358.
        known = np.array([time for time, _ in poses_of_body])
        x, y, angle = np.array([(pose.x, pose.y, pose.angle) for _, pose in poses_of_body]).T
        angle = np.interp(grid, known, np.unwrap(angle))
        position[:end, column] = np.stack([np.interp(grid, known, x), np.interp(grid, known, y)], -1)
        facing[:end, column] = np.stack([np.cos(angle), np.sin(angle)], -1)
        present[:end, column] = _is_present(known, grid, always=column == 0)

    # Such recordings name no groups: -1 is "not known".
    nobody = np.full((rows, columns), -1, np.int32)
    steps = np.arange(rows, dtype=np.int32)
    return Tracks(position, facing, nobody, present, nobody, steps, TIME_STEP)  # pyright: ignore[reportArgumentType]


def _is_present(known: np.ndarray, grid: np.ndarray, always: bool) -> np.ndarray:
    """Whether a body is there at the times of a grid: between known times that are not too far apart.

    Args:
        always: whether it is there in every gap.
    """
    inside = (grid >= known[0] - ROUNDING) & (grid <= known[-1] + ROUNDING)
    if always:
        return inside
    later = np.clip(np.searchsorted(known, grid - ROUNDING), 0, len(known) - 1)
    gap = np.where(np.abs(known[later] - grid) <= ROUNDING, 0.0, known[later] - known[np.maximum(later - 1, 0)])
    return inside & (gap <= LONGEST_GAP + ROUNDING)


def _times(recorded: Recorded) -> Iterator[Problem]:
    times = [frame.timestamp for frame in recorded.sequence]
    for k, (before, after) in enumerate(zip(times[:-1], times[1:], strict=True), 1):
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
        if (size := np.hypot(x2 - x1, y2 - y1)) > 0:
            rows.append(((x1 + x2) / 2, (y1 + y2) / 2, size / 2, 0.0, np.arctan2(y2 - y1, x2 - x1)))
    for body in recorded.sequence[0].objects:
        rows.append((body.x, body.y, body.shape.length / 2, body.shape.width / 2, body.angle))
    table = np.array(rows, np.float32).reshape(-1, 5)
    obstacles: Any = Obstacles(table[:, :2], table[:, 2:4], table[:, 4], np.ones(len(table), np.float32))  # pyright: ignore[reportArgumentType]
    return pad(obstacles, {("Obstacles", "W"): _power(len(table), 16)})


def _power(number: int, least: int) -> int:
    return max(least, 1 << (number - 1).bit_length()) if number else least


def measure(episode: RatedEpisode) -> dict[str, float]:
    """The metrics ``MEASURED`` of a trajectory by name; without those of completed episodes if it ends elsewhere.

    The shortest path is the straight line from start to goal, and people have the radius ``recordings.BODY``.
    """
    values = {name: float(value) for name, value in _measure(episode).items()}
    reached = values["reached_goal"] == 1.0
    return {name: value for name, value in values.items() if reached or not MEASURED[name].completed_only}


@jax.jit
def _measure(episode: RatedEpisode) -> dict[str, Array]:
    tracks = jax.tree.map(jnp.asarray, episode.tracks)
    snapshots, recorded = recordings.snapshots_of(tracks, 0, tracks.group)

    def always(value: Array) -> Array:
        return jnp.broadcast_to(value, (recorded.shape[0], *jnp.shape(value)))

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
        (before, values), (after, there) = carry, row
        new = {name: metric.update(values[name], before, after) for name, metric in MEASURED.items()}
        return (after, jax.tree.map(lambda new, old: jnp.where(there, new, old), new, values)), None

    begin = first, {name: metric.init(first) for name, metric in MEASURED.items()}
    (_, values), _ = jax.lax.scan(update, begin, jax.tree.map(lambda leaf: leaf[1:], (snapshots, recorded)))
    return {name: jnp.ravel(metric.compute(values[name]))[0] for name, metric in MEASURED.items()}
