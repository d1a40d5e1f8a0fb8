"""What experiments are told: the options of ``sean experiment`` (section V).

Nothing here imports JAX, so that ``sean --help`` answers at once.
"""

import dataclasses
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from sean_jax.learning.options import MOST_HOURS, Refused
from sean_jax.options import LIMITS, check_limits, command

BEHAVIORS = ("random", "handcrafted", "graph")  # in the order of Table I
OTHERS = {"table1": ("driver", "episodes", "epochs"), "figure4": ("drivers", "seeds", "speeds", "crowds")}
"""experiment -> the options that are for the other one"""


@dataclasses.dataclass(frozen=True)
class Experiment:
    """Table I or Figure 4 of the paper, beside its own numbers, as a report. A folder that has a part is continued."""

    which: Annotated[Literal["table1", "figure4"], tyro.conf.Positional]
    """table1: how much of the time the robot is in each social situation. figure4: four policies in three scenarios."""
    quick: bool = False
    """Small enough for a CPU and ten minutes: less time, fewer seeds and episodes, smaller images."""
    environment: str = "warehouse"
    """Physical environment: a name, or the folder of your own."""
    drivers: str = "go_to_goal,social_costmap,expert"
    """Of table1: who drives, separated by commas."""
    driver: str = "expert"
    """Of figure4: who demonstrates."""
    hours: float | None = None
    """Hours for each behavior, 1 by default: of each seed in table1, of demonstrations in figure4."""
    seeds: int | None = None
    """Of table1: how many times, 10 by default."""
    speeds: tuple[float, ...] = (1.4, 1.2, 1.0, 0.8, 0.6, 0.4)
    """Of table1: who is faster counts as walking, V in m/s; the first is that of the table."""
    crowds: tuple[int, ...] | None = None
    """Of table1: other numbers of people to try, 10, 20, 40 and 100 by default."""
    episodes: int | None = None
    """Of figure4: for each policy in each scenario, 123 by default."""
    people: int | None = None
    """Number of people of random and graph; the environment's own by default (62 in the warehouse)."""
    robot: str = "kuri"
    """Robot."""
    dynamics: str = "mjx"
    """How the robot moves: mjx, or its closed-form twin, which is faster."""
    time_limit: float = 120.0
    """Longest duration of an episode in seconds."""
    epochs: int | None = None
    """Of figure4: most epochs of training, 1000 by default."""
    seed: int = 0
    """The same seed gives the same results."""
    out: Path | None = None
    """Folder for the results, runs/EXPERIMENT by default. If it holds a part of the same options, that is continued."""
    quiet: bool = False
    """Say nothing but errors."""

    @property
    def folder(self) -> Path:
        """Where the results go."""
        return self.out or Path("runs") / (self.which + ("-quick" if self.quick else ""))

    def settled(self) -> "Experiment":
        """With numbers for what was left open. Raises Refused for what cannot be."""
        full: dict[str, Any] = dict(hours=1.0, seeds=10, episodes=123, epochs=1000, crowds=(10, 20, 40, 100))
        quick: dict[str, Any] = dict(hours=0.05, seeds=2, episodes=12, epochs=30, crowds=())
        given = {k: v if (now := getattr(self, k)) is None else now for k, v in (quick if self.quick else full).items()}
        settled = dataclasses.replace(self, **given)
        check_limits(settled, {
            "hours": (0.0166, MOST_HOURS), "seeds": (1, 10**6), "speeds": (0.0, 100.0), "crowds": LIMITS["people"],
            "epochs": (1, 10**9),
        })  # fmt: skip
        if self.which == "table1" and not [name for name in self.drivers.split(",") if name.strip()]:
            raise Refused("--drivers names nobody, try --drivers go_to_goal.")
        if not settled.speeds:
            raise Refused("--speeds names none; give at least one, such as 1.4 0.4.")
        return settled

    def check(self) -> None:
        """Raises Refused for what nothing could be tried with."""
        self.settled()

    @property
    def command(self) -> str:
        """The command that gives these results again, in full."""
        return command("experiment", self, ("which",), (*OTHERS[self.which], "out", "quiet"))

    def lasting(self) -> dict:
        """All that decides the results, for the record and for finding out whether a folder has the same."""
        loose = ("out", "quiet")
        return {name: _plain(value) for name, value in dataclasses.asdict(self).items() if name not in loose}


def _plain(value):
    return list(value) if isinstance(value, tuple) else value
