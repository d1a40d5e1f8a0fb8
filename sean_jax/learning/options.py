"""What learning is told: the options of ``sean collect``, ``sean train`` and ``sean export`` (section V).

Nothing here imports JAX, so that ``sean --help`` answers at once.
"""

import dataclasses
import shlex
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

DRIVER = "expert"  # who drives unless told otherwise

# behavior -> its tasks in the paper's protocol (section V-B)
TASKS = {"graph": "join_group,leave_group", "random": "random_ab_nav", "handcrafted": "handcrafted"}


class Refused(ValueError):
    """What was asked for cannot be done; the message is one sentence that says what to do instead."""


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
        named = TASKS.get(self.behavior, "random_ab_nav") if self.task is None else self.task
        return tuple(part.strip() for part in named.split(",") if part.strip())

    def fixed(self) -> dict[str, Any]:
        """All that decides what is recorded, but for how long and the batch."""
        loose = ("out", "hours", "quiet", "batch")
        told = {name: value for name, value in dataclasses.asdict(self).items() if name not in loose}
        return told | {"parties": list(self.parties)}  # as it is read back

    def check(self) -> None:
        """Raises Refused for what nothing could be recorded with."""
        for option, least in (("people", 1), ("batch", 1), ("width", 8), ("height", 8)):
            value = getattr(self, option)
            if value is not None and value < least:
                raise Refused(f"--{option} is {value}, but must be at least {least}.")
        if not 0 < self.hours < 1e7:
            raise Refused(f"--hours is {self.hours:g}, but must be above zero (1 is the default).")
        if not 1 <= self.time_limit < 1e5:
            raise Refused(f"--time-limit is {self.time_limit:g} s, but must be at least 1 (120 is the default).")
        if not 0 <= self.seed < 2**32:
            raise Refused(f"--seed is {self.seed}, but must lie between 0 and {2**32 - 1}.")
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

    def check(self) -> None:
        """Raises Refused for what nothing could be learned with."""
        for option, least in (("width", 1), ("batch", 1), ("patience", 1), ("epochs", 1)):
            value = getattr(self, option)
            if value < least:
                raise Refused(f"--{option} is {value}, but must be at least {least}.")
        if not 0 < self.learning_rate < 1:
            raise Refused(f"--learning-rate is {self.learning_rate:g}, but must lie between 0 and 1 (try 0.001).")
        if not 0 < self.validation < 1:
            raise Refused(f"--validation is {self.validation:g}, but must lie between 0 and 1 (try 0.1).")
        if not 0 <= self.weight_decay < 1:
            raise Refused(f"--weight-decay is {self.weight_decay:g}, but must be at least 0 and below 1 (try 0.01).")
        if not 0 <= self.seed < 2**32:
            raise Refused(f"--seed is {self.seed}, but must lie between 0 and {2**32 - 1}.")


@dataclasses.dataclass(frozen=True)
class Export:
    """Write a dataset in another project's format."""

    format: Annotated[Literal["lerobot"], tyro.conf.Positional]
    """Which: lerobot is LeRobotDataset v3.0."""
    dataset: Annotated[Path, tyro.conf.Positional]
    """Folder that `sean collect` has written."""
    out: Path
    """Folder to write; it must not exist or be empty."""
    quiet: bool = False
    """Say nothing but errors."""

    @property
    def folder(self) -> Path:
        """The folder to write."""
        return self.out


def command(word: str, fixed: dict[str, Any]) -> str:
    """The command that gives these results again."""
    words = ["sean", *word.split()]
    for name, value in fixed.items():
        flag = "--" + name.replace("_", "-")
        if value is True:
            words.append(flag)
        elif value is not None and value is not False:
            values = value if isinstance(value, list) else [value]
            words += [flag, *(f"{each:g}" if isinstance(each, float) else str(each) for each in values)]
    return shlex.join(words)
