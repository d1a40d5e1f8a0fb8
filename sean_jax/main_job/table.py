"""The table of a run: which rows it has, what they mean, and how it looks in a terminal."""

import dataclasses
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from sean_jax.drawing.colors import situation_colors

_BY_ROBOT = "Times an episode that the robot, by its own motion, came within {} of a person."
_BY_PERSON = "Times an episode that a person, by their own motion, came within {} of the robot."
DEFINITIONS = {  # name: (title, unit, digits, definition)
    "share": (
        "share of robot time", "%", 1,
        "Time in the situation over the time that the episodes lasted; situations may overlap.",
    ),
    "completed": (
        "completed", "%", 1,
        "The robot came to its goal within the time limit; by situation: of the episodes in which it occurred.",
    ),
    "seconds": ("duration", "s", 1, "Until the goal or the time limit."),
    "path_efficiency": (
        "path efficiency", "", 2,
        "Travelled over shortest distance from start to goal, of completed episodes: 1 is a shortest path.",
    ),
    "time_not_moving": ("time not moving", "s", 1, "Time that the robot stood, per episode."),
    "intimate_robot_on_person": ("intimate, robot on person", "", 2, _BY_ROBOT.format("0.45 m")),
    "intimate_person_on_robot": ("intimate, person on robot", "", 2, _BY_PERSON.format("0.45 m")),
    "personal_robot_on_person": ("personal, robot on person", "", 2, _BY_ROBOT.format("1.2 m")),
    "personal_person_on_robot": ("personal, person on robot", "", 2, _BY_PERSON.format("1.2 m")),
    "collision_robot_on_person": ("collision, robot on person", "", 2, _BY_ROBOT.format("touch")),
    "collision_person_on_robot": ("collision, person on robot", "", 2, _BY_PERSON.format("touch")),
    "path_length": ("path length", "m", 1, "Distance that the robot travelled, per episode."),
    "path_irregularity": ("path irregularity", "rad", 2, "Rotation in excess of that of the shortest path."),
    "min_distance_to_people": ("least distance to people", "m", 2, "From the robot to the nearest person."),
    "min_distance_to_goal": ("least distance to goal", "m", 2, "From the robot to its goal."),
    "final_distance_to_goal": ("final distance to goal", "m", 2, "From the robot to its goal, at the end."),
    "collision_with_obstacle": ("collision with an obstacle", "", 2, "Times an episode that the robot touched one."),
    "min_distance_to_obstacles": ("least distance to obstacles", "m", 2, "From the robot's centre to their surface."),
    "reached_goal": ("ended at the goal", "%", 1, "The robot's last position is within the goal radius."),
    "success_by_path_length": (
        "success by path length (SPL)", "", 2, "Shortest over travelled distance if it ended at the goal, else 0.",
    ),
    "success_by_time": (
        "success by time (STL)", "", 2,
        "Time of the shortest path at top speed over the time taken if it ended at the goal, else 0.",
    ),
    "personal_space_compliance": (
        "personal space compliance", "%", 1, "Time in which everybody is 0.5 m or farther away from the robot.",
    ),
    "min_time_to_collision": (
        "least time to collision", "s", 2, "If the robot and the people kept their velocities; at most 30 s.",
    ),
    "social_work": ("social-force work", "m/s", 2, "Social forces between robot and people, summed over time."),
    "time_looked_at": ("time looked at", "s", 1, "Somebody within 3.6 m faces the robot to within 5 degrees."),
    "mean_speed": ("mean speed", "m/s", 2, "Of the robot."),
    "mean_acceleration": ("mean acceleration", "m/s²", 2, "Of the robot's velocity vector."),
    "mean_jerk": ("mean jerk", "m/s³", 2, "Change of that acceleration over time."),
    "max_speed": ("greatest speed", "m/s", 2, "Of the robot, per episode."),
    "max_acceleration": ("greatest acceleration", "m/s²", 2, "Of the robot's velocity vector, per episode."),
    "max_jerk": ("greatest jerk", "m/s³", 2, "Of the robot, per episode."),
}  # fmt: skip
GAP = 3  # characters between columns
FIRST = (
    "completed",
    "path_efficiency",
    "time_not_moving",
    "intimate_robot_on_person",
    "intimate_person_on_robot",
    "personal_robot_on_person",
    "personal_person_on_robot",
    "collision_robot_on_person",
    "collision_person_on_robot",
)


@dataclasses.dataclass
class Row:
    name: str
    title: str
    unit: str
    definition: str
    cells: list[str]  # overall, then each situation; "" where there is nothing to say
    intervals: list[str]  # 95 %, likewise


def rows(summary: dict[str, Any], complete: bool = False) -> list[Row]:
    """The rows of the terminal's table, or of every metric if ``complete``."""
    shares = {"overall": {"mean": 1.0, "interval": [1.0, 1.0]}, **summary["situations"]}
    measured = summary["metrics"]
    later = [name for name in measured if name not in FIRST and name != "time_in_situation"] if complete else []
    columns = list(shares)
    return [
        _row("share", shares, columns),
        *(_row(name, measured[name], columns) for name in (*FIRST, *later) if name in measured),
    ]


def _row(name: str, values: dict[str, Any], columns: list[str]) -> Row:
    title, unit, digits, definition = DEFINITIONS.get(name, (name.replace("_", " "), "", 2, "Mean over episodes."))
    scale = 100.0 if unit == "%" else 1.0
    cells, intervals = [], []
    for column in columns:
        value = values.get(column)
        cells.append("" if value is None else f"{scale * value['mean']:.{digits}f}")
        low_high = (f"{scale * end:.{digits}f}" for end in value["interval"]) if value else ()
        intervals.append(" to ".join(low_high))
    return Row(name, title, unit, definition, cells, intervals)


def print_table(console: Console, summary: dict[str, Any], title: str) -> None:
    """The table in the terminal; where it is too narrow for all situations, the others follow below."""
    names = list(summary["situations"])
    shades = situation_colors(tuple(names))
    measured = rows(summary)
    beside = 1 + max(len(f"{row.title} {row.unit}".strip()) for row in measured)
    for first, last in _blocks(names, console.width - beside):
        table = Table(box=box.SIMPLE_HEAD, title=Text(title), title_justify="left", title_style="bold", pad_edge=False)
        table.add_column("", no_wrap=True)
        if first == 0:
            table.add_column("overall", justify="right", style="bold", no_wrap=True)
        for name, color in zip(names[first:last], shades[first:last], strict=True):
            table.add_column(Text(name.replace("_", "\n"), style=f"bold {color}"), justify="right", no_wrap=True)
        group, title = "", ""
        for row in measured:
            begin = row.name.split("_")[0]
            if begin in ("intimate", "collision") and begin != group:
                table.add_section()
            group = begin
            head = Text.assemble(row.title, (f" {row.unit}" if row.unit else "", "dim"))
            cells = row.cells[first + (first > 0) : last + 1]
            table.add_row(head, *(Text(cell) if cell else Text("–", "dim") for cell in cells))
        console.print(table)
    console.print(
        "[dim]Violations and collisions are times per episode; 95 % intervals are in summary.json.[/]", soft_wrap=True
    )


def _blocks(names: list[str], width: int) -> list[tuple[int, int]]:
    """(first, last) of the situations that stand beside each other in ``width`` characters, at least one each."""
    blocks, first, left = [], 0, width - len("overall") - GAP
    for k, name in enumerate(names):
        needed = GAP + max(5, *(len(word) for word in name.split("_")))  # a number has up to 5 characters
        if needed > left and k > first:
            blocks.append((first, k))
            first, left = k, width
        left -= needed
    return [*blocks, (first, len(names))]
