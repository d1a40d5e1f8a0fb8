"""What the main job is told: the options of ``sean run`` (section IV-B names the parts of a scenario).

Nothing here imports JAX, so that ``sean --help`` answers at once.
"""

import dataclasses
import shlex
from pathlib import Path


class BadInput(ValueError):
    """What the user asked for cannot be done; the message is one sentence that says what to do instead."""


@dataclasses.dataclass(frozen=True)
class Options:
    """Simulate a batch of episodes and write a table, a report and an animation. `sean list` names the choices."""

    environment: str = "warehouse"
    """Physical environment: a name, or the folder of your own."""
    behavior: str = "graph"
    """Pedestrian behavior: who goes where."""
    task: str = "join_group,leave_group"
    """Robot task; several, separated by commas, take turns."""
    paths: str | None = None
    """Of the behavior graph: whole, the way to a goal is kept, by default; or edge, people choose anew at each node."""
    spreading: float | None = None
    """Of the behavior graph: how much people avoid crowded edges, 0 by default; try 10."""
    recording: str | None = None
    """Of the behavior playback: a CSV file with the columns frame, id, x and y in metres."""
    frame_rate: float | None = None
    """Of the recording in frames a second, 25 by default."""
    handcrafted: str | None = None
    """Of the behavior handcrafted: a set, a situation whose sets take part, or all, the default."""
    start: tuple[float, ...] | None = None
    """Of the task custom: x and y in metres, and a heading in degrees if you like."""
    goal: tuple[float, ...] | None = None
    """Likewise."""
    robot: str = "kuri"
    """Robot."""
    policy: str = "go_to_goal"
    """Who drives the robot: a name, or the folder that `sean train` has written."""
    people: int | None = None
    """Number of people; the environment's own number by default (62 in the warehouse)."""
    parties: tuple[float, float] = (0.0, 0.0)
    """Shares of the people who walk in pairs and in triples."""
    model: str = "social_forces"
    """How people move."""
    forces: str = "helbing1995"
    """Constants of the social forces."""
    situations: str = "paper"
    """Which social situations are told apart."""
    dynamics: str = "mjx"
    """How the robot moves: mjx, or its closed-form twin, which is faster."""
    episodes: int = 64
    """Number of episodes."""
    seed: int = 0
    """The same seed gives the same episodes."""
    time_limit: float = 120.0
    """Longest duration of an episode in seconds."""
    batch: int = 1024
    """Most episodes that are simulated at once."""
    camera: str | None = None
    """Also write camera.gif, the first episode as first_person, third_person, overhead or depth sees it."""
    renderer: str = "rays"
    """What draws camera.gif: rays, or mujoco, which needs OpenGL."""
    name: str = ""
    """Name of the run, environment and behavior by default: the end of the folder's name."""
    out: str = ""
    """Folder to write, runs/<date>-<time>-<name> by default; it must not exist or be empty."""
    quiet: bool = False
    """Say nothing but errors."""

    @property
    def tasks(self) -> tuple[str, ...]:
        return tuple(part.strip() for part in self.task.split(",") if part.strip())

    @property
    def command(self) -> str:
        """The command that gives these results again, in full."""
        words = ["sean", "run"]
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name not in ("name", "out", "quiet", "batch") and value is not None:
                values = value if isinstance(value, tuple) else (value,)
                written = (f"{value:g}" if isinstance(value, float) else str(value) for value in values)
                words += ["--" + field.name.replace("_", "-"), *written]
        return shlex.join(words)

    def folder(self, now: str) -> Path:
        """The folder to write; ``now`` is the date and time in its name."""
        return Path(self.out) if self.out else Path("runs") / f"{now}-{self.label}"

    @property
    def label(self) -> str:
        kept = self.name or f"{Path(self.environment).name}-{self.behavior}"
        return "".join(c if c.isalnum() or c in "-_." else "-" for c in kept)

    def check(self) -> None:
        """Raises BadInput for what no scenario could run with."""
        for option, least in (("people", 1), ("episodes", 1), ("batch", 1)):
            value = getattr(self, option)
            if value is not None and value < least:
                raise BadInput(f"--{option} is {value}, but must be at least {least}.")
        if not 0 < self.time_limit < 1e6:
            raise BadInput(f"--time-limit is {self.time_limit:g} s, but must be above zero (120 is the default).")
        if not 0 <= self.seed < 2**32:
            raise BadInput(f"--seed is {self.seed}, but must lie between 0 and {2**32 - 1}.")
        if not self.tasks:
            raise BadInput("--task names no task, try --task join_group; `sean list` shows them all.")
