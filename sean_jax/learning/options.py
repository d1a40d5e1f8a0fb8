"""What learning is told: the options of ``sean collect``, ``sean train`` and ``sean export`` (section V).

Nothing here imports JAX, so that ``sean --help`` answers at once.
"""

import dataclasses
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from sean_jax.options import BadInput, check_limits, check_new_folder, command

DRIVER = "expert"  # who drives unless told otherwise

# behavior -> its tasks in the paper's protocol (section V-B)
TASKS = {"graph": "join_group,leave_group", "random": "random_ab_nav", "handcrafted": "handcrafted"}


# The most that datasets and networks may hold: options go no further, and files that do are refused.
MOST_HOURS = 1e6
MOST_BATCH = 100_000  # episodes in a shard
MOST_SIDE = 4_096  # pixels of a depth image's side, and the width of a network
MOST_PIXELS = 4_000_000  # of a depth image

Refused = BadInput  # as learning calls it


def check_image(width: int, height: int) -> None:
    """Raises BadInput for a depth image of more pixels than a dataset may have."""
    if width * height > MOST_PIXELS:
        raise Refused(f"--width {width} times --height {height} are more than {MOST_PIXELS:,} pixels; ask for fewer.")


def tasks_of(behavior: str, task: str | None) -> tuple[str, ...]:
    """The names in ``task``, which commas separate; the paper's tasks for that behavior if None."""
    named = TASKS.get(behavior, "random_ab_nav") if task is None else task
    return tuple(part.strip() for part in named.split(",") if part.strip())


class Failed(RuntimeError):
    """Something broke midway; the message is one sentence that says what is left and what to do."""


@dataclasses.dataclass(frozen=True)
class Collect:
    """Record demonstrations: what a driver sees and does, once a second. A folder that has some is continued."""

    behavior: str = "graph"
    """Pedestrian behavior."""
    task: str | None = None
    """Robot task; several, separated by commas, get the same time. As in the paper by default: join_group,leave_group
    with behavior graph, random_ab_nav with random, and handcrafted, the time being that of five situations."""
    hours: float = 1.0
    """Hours of demonstrations."""
    driver: str = DRIVER
    """Who drives: a policy of `sean list`."""
    environment: str = "warehouse"
    """Physical environment: a name, or the folder of your own."""
    handcrafted: str | None = None
    """Of the behavior handcrafted: a set, a situation, or all; the five situations in equal parts by default."""
    paths: str | None = None
    """Of the behavior graph: whole, the way to a goal is kept, by default; or edge, people choose anew at each node."""
    spreading: float | None = None
    """Of the behavior graph: how much people avoid crowded edges, 0 by default; try 10."""
    robot: str = "kuri"
    """Robot."""
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
    time_limit: float = 120.0
    """Longest duration of an episode in seconds."""
    width: int = 64
    """Width of the depth images in pixels."""
    height: int = 48
    """Height of the depth images in pixels."""
    batch: int | None = None
    """Episodes that are simulated at once and stored in one file; by the device and the time asked for by default."""
    seed: int = 0
    """The same seed gives the same demonstrations."""
    out: Path | None = None
    """Folder of the dataset, runs/demonstrations-<environment>-<behavior>-<driver>-<seed> by default. If it holds one
    of the same options, that is continued."""
    quiet: bool = False
    """Say nothing but errors."""

    @property
    def folder(self) -> Path:
        """The folder of the dataset."""
        named = (Path(self.environment).name, self.behavior, self.driver, str(self.seed))
        return self.out or Path("runs") / "-".join(("demonstrations", *named))

    @property
    def tasks(self) -> tuple[str, ...]:
        """The names in ``task``, or the default's."""
        return tasks_of(self.behavior, self.task)

    def fixed(self) -> dict[str, Any]:
        """All that decides what is recorded, but for how long and the batch."""
        loose = ("out", "hours", "quiet", "batch")
        told = {name: value for name, value in dataclasses.asdict(self).items() if name not in loose}
        return told | {"parties": list(self.parties)}  # as it is read back

    @property
    def command(self) -> str:
        """The command that gives this dataset again, in full; the batch belongs to it where it was chosen."""
        return command("collect", self, leave_out=("out", "quiet"))

    def check(self) -> None:
        """Raises BadInput for what nothing could be recorded with."""
        sides: dict[str, tuple[float, float]] = {"width": (8, MOST_SIDE), "height": (8, MOST_SIDE)}
        check_limits(self, {"hours": (1e-6, MOST_HOURS), "batch": (1, MOST_BATCH), **sides})
        check_image(self.width, self.height)
        if self.behavior == "playback" or "custom" in self.tasks:
            what = "--behavior playback" if self.behavior == "playback" else "--task custom"
            raise Refused(f"{what} is not recorded; choose behavior graph, random or handcrafted and one of its tasks.")
        if not self.tasks:
            raise Refused("--task names no task, try --task join_group; `sean list` shows them all.")


@dataclasses.dataclass(frozen=True)
class Train:
    """Train a network on a dataset. A folder that has a training of the same options is continued."""

    method: Annotated[Literal["imitation"], tyro.conf.Positional]
    """How: imitation of what the demonstrations do."""
    dataset: Annotated[Path, tyro.conf.Positional]
    """Folder that `sean collect` has written."""
    flags: bool = False
    """Let the network know which social situations occur."""
    balance: bool = False
    """Draw examples so that all social situations are as frequent as one another."""
    width: int = 64
    """Of the encodings and hidden layers."""
    batch: int = 1024
    """Examples in a step."""
    learning_rate: float = 1e-3
    """Of AdamW."""
    weight_decay: float = 0.01
    """Of AdamW."""
    patience: int = 50
    """Epochs without a lesser loss in validation, after which training stops."""
    epochs: int = 1000
    """Most epochs."""
    validation: float = 0.1
    """Share of the episodes that validate."""
    on_device: float = 0.6
    """Share of the device's memory that a dataset may fill; a larger one is read from disk again and again."""
    seed: int = 0
    """The same seed gives the same network."""
    out: Path | None = None
    """Folder for checkpoints and metrics, runs/imitation-<dataset>-<seed> by default. If it holds a training of the
    same options, that is continued."""
    quiet: bool = False
    """Say nothing but errors."""

    @property
    def folder(self) -> Path:
        """The folder for checkpoints and metrics."""
        return self.out or Path("runs") / f"imitation-{self.dataset.resolve().name}-{self.seed}"

    def fixed(self) -> dict[str, Any]:
        """All that decides what the network becomes, but for when it stops."""
        loose = ("method", "dataset", "out", "patience", "epochs", "on_device", "quiet")
        return {name: value for name, value in dataclasses.asdict(self).items() if name not in loose}

    @property
    def command(self) -> str:
        """The command that gives this network again, in full."""
        return command("train", self, positional=("method", "dataset"), leave_out=("out", "quiet"))

    def check(self) -> None:
        """Raises BadInput for what nothing could be learned with."""
        check_limits(self, {
            "width": (1, MOST_SIDE), "patience": (1, 10**9), "epochs": (1, 10**9), "learning_rate": (1e-12, 1.0),
            "weight_decay": (0.0, 1.0), "validation": (1e-6, 1 - 1e-6), "on_device": (0.0, 1.0),
        })  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Export:
    """Write a dataset in another project's format."""

    format: Annotated[Literal["lerobot"], tyro.conf.Positional]
    """Which: lerobot is LeRobotDataset v3.0."""
    dataset: Annotated[Path, tyro.conf.Positional]
    """Folder that `sean collect` has written."""
    out: Path
    """Folder to write; it must be new or empty."""
    quiet: bool = False
    """Say nothing but errors."""

    @property
    def folder(self) -> Path:
        """The folder to write."""
        return self.out

    def check(self) -> None:
        """Raises BadInput for a folder that cannot be written."""
        check_new_folder(self.out)
