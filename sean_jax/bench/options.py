"""What ``sean bench`` is told. Nothing here imports JAX, so that ``sean --help`` answers at once."""

import dataclasses
import datetime
from pathlib import Path

from sean_jax.options import LIMITS, BadInput, check_limits, check_new_folder, command

PARTS = ("step", "depth", "images", "pictures", "crowd", "compile", "devices")


@dataclasses.dataclass(frozen=True)
class Options:
    """Measure speed on this machine and write it as a table, as JSON and as a picture."""

    environment: str = "warehouse"
    """Physical environment: a name, or the folder of your own."""
    people: int | None = None
    """Number of people; the environment's own number by default (62 in the warehouse)."""
    robot: str = "kuri"
    """Robot."""
    dynamics: str = "mjx"
    """How the robot moves: mjx, or its closed-form twin."""
    only: str = ",".join(PARTS)
    """Parts to measure, separated by commas."""
    batches: tuple[int, ...] = ()
    """Numbers of scenarios at once; by default 1 to 256 on a CPU and 1 to 65536 on a GPU."""
    repeats: int = 5
    """Times that each is timed, of which the median counts."""
    seconds: float = 1.0
    """About how long one timing takes."""
    out: Path | None = None
    """Folder to write, by default sean-bench-DATE-TIME."""
    quiet: bool = False
    """Print nothing but errors."""

    @property
    def parts(self) -> list[str]:
        """The names in ``only``."""
        return [part.strip() for part in self.only.split(",") if part.strip()]

    def check(self) -> None:
        """Raise BadInput for what cannot be measured."""
        for part in self.parts or ["nothing"]:
            if part not in PARTS:
                raise BadInput(f"--only: {part!r} is not one of {', '.join(PARTS)}.")
        check_limits(self, {"batches": LIMITS["batch"], "repeats": (1, 10**6), "seconds": (1e-6, 1e5)})
        if self.out is not None:
            check_new_folder(self.out)

    @property
    def command(self) -> str:
        """The command that measures this again, in full."""
        return command("bench", self, leave_out=("out", "quiet"))

    def folder(self) -> Path:
        """Where the results go."""
        return self.out or Path(f"sean-bench-{datetime.datetime.now():%Y%m%d-%H%M%S}")
