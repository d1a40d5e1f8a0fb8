"""What the main job is told: the options of ``sean run`` (section IV-B names the parts of a scenario).

Nothing here imports JAX, so that ``sean --help`` answers at once.
"""

import dataclasses
from pathlib import Path

from sean_jax.learning.options import tasks_of
from sean_jax.options import BadInput, check_limits, command

__all__ = ["BadInput", "Options"]


@dataclasses.dataclass(frozen=True)
class Options:
    """Simulate a batch of episodes and write a table, a report and an animation. `sean list` names the choices."""

    environment: str = "warehouse"
    """Physical environment: a name, or the folder of your own."""
    behavior: str = "graph"
    """Pedestrian behavior: who goes where."""
    task: str | None = None
    """Robot task; several, separated by commas, take turns. By default join_group,leave_group with behavior graph,
    handcrafted with handcrafted, custom if a start and a goal are given, else random_ab_nav."""
    paths: str | None = None
    """Of the behavior graph: whole, the way to a goal is kept, by default; or edge, people choose anew at each node."""
    spreading: float | None = None
    """Of the behavior graph: how much people avoid crowded edges, 0 by default; try 10."""
    recording: str | None = None
    """Of the behavior playback: a CSV file with the columns frame, id, x and y in metres."""
    recording_format: str | None = None
    """Of the recording: eth_ucy, juelich, groups or csv; recognised by default if it tells velocities."""
    frame_rate: float | None = None
    """Of the recording in frames a second; that of its format by default."""
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
    renderer: str | None = None
    """What draws camera.gif: rays, the default, or mujoco, which needs OpenGL."""
    name: str = ""
    """Name of the run, environment and behavior by default: the end of the folder's name."""
    out: Path | None = None
    """Folder to write, runs/<date>-<time>-<name> by default: a new or an empty one, or one that holds an unfinished run
    of the same options, which goes on."""
    quiet: bool = False
    """Say nothing but errors."""

    @property
    def tasks(self) -> tuple[str, ...]:
        """The names in ``task``, or the default's."""
        if self.task is None and self.start is not None and self.goal is not None:
            return ("custom",)
        return tasks_of(self.behavior, self.task)

    @property
    def command(self) -> str:
        """The command that gives these results again, in full.

        The batch belongs to it: XLA rounds otherwise for another number of episodes at once.
        """
        return command("run", self, leave_out=("name", "out", "quiet"))

    def folder(self, now: str) -> Path:
        """The folder to write; ``now`` is the date and time in its name."""
        return self.out or Path("runs") / f"{now}-{self.label}"

    @property
    def label(self) -> str:
        kept = self.name or f"{Path(self.environment).name}-{self.behavior}"
        return "".join(c if c.isalnum() or c in "-_." else "-" for c in kept)

    def check(self) -> None:
        """Raises BadInput for what no scenario could run with."""
        check_limits(self, {"time_limit": (0.1, 1e6)})
        for name, pose in (("start", self.start), ("goal", self.goal)):
            if pose is not None and len(pose) not in (2, 3):
                raise BadInput(f"--{name} has {len(pose)} numbers; give x and y, and a heading in degrees if you like.")
        if not self.tasks:
            raise BadInput("--task names no task, try --task join_group; `sean list` shows them all.")
        if self.renderer is not None and self.camera is None:
            raise BadInput("--renderer draws camera.gif, which needs a camera: add --camera first_person.")
