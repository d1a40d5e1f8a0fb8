"""The options of ``sean bench``."""

import datetime
from pathlib import Path

import pydantic

from sean_jax.config import option_types
from sean_jax.config.components import Config, Named
from sean_jax.config.scenario_options import RobotPart
from sean_jax.core.messages import listed, suggest


class BenchConfig(Config):
    """Measure speed on this machine and write it as a table, as JSON and as a picture."""

    environment: option_types.EnvironmentName = "warehouse"
    people: option_types.PeopleOrDefault = None
    robot: RobotPart = Named(kind="kuri")
    dynamics: option_types.Dynamics = "twin"
    only: option_types.Names = "step,depth,images,pictures,crowd,compile,devices"
    """Measurements, separated by commas."""
    batches: tuple[option_types.BatchSize, ...] = ()
    """Numbers of scenarios at once; by default 1 to 256 on a CPU and 1 to 65536 on a GPU."""
    repeats: option_types.Count = 5
    """Timings of each measurement, of which the median counts."""
    seconds: option_types.TimingSeconds = 1.0
    """Approximate duration of one timing."""
    out: option_types.Out = None
    """Folder to write, by default sean-bench-DATE-TIME."""
    quiet: option_types.Quiet = False

    @pydantic.field_validator("only")
    @classmethod
    def _known(cls, value: str) -> str:
        known = listed(cls.model_fields["only"].default)
        for part in listed(value) or ["nothing"]:
            if part not in known:
                raise ValueError(f"{part!r} is not one of {', '.join(known)}{suggest(part, known)}")
        return value

    @property
    def parts(self) -> list[str]:
        """The names in ``only``."""
        return listed(self.only)

    def folder(self) -> Path:
        """The folder of the results."""
        return self.out or Path(f"sean-bench-{datetime.datetime.now():%Y%m%d-%H%M%S}")
