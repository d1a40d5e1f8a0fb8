"""Options of ``sean run``, ``replay`` and ``compare``."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

import pydantic

from sean_jax.config.core import Config, Named
from sean_jax.config.fields import BatchSize, EpisodeCount, EpisodeNumber, Names, Option, Out, Quiet, Seed, Text
from sean_jax.config.scenario import Part, ScenarioConfig


class RunConfig(ScenarioConfig):
    """Simulate a batch of episodes and write a table, a report and an animation. `sean list` names the choices."""

    policy: Part = Named(kind="go_to_goal")
    """Policy of the robot: a name, or a folder of `sean train` or `sean export agent`."""
    episodes: EpisodeCount = 64
    """Number of episodes."""
    seed: Seed = 0
    """The same seed gives the same episodes."""
    batch: BatchSize = 1024
    """Largest number of episodes that are simulated at once."""
    camera: Annotated[Text | None, Option(affects_results=False)] = None
    """Also write camera.gif, the first episode as first_person, third_person, overhead or depth sees it."""
    trajectories: Literal["csv", "parquet"] | None = None
    """Also write the frames of all episodes, robot and people, as trajectories.csv or .parquet."""
    live: Annotated[bool, Option(affects_results=False)] = False
    """Serve a page on this computer that plays the first episode during its simulation."""
    name: Annotated[str, Option(affects_results=False)] = ""
    """Name of the run, the end of the folder's name; by default the environment and the behavior."""
    out: Out = None
    """Folder to write, runs/<date>-<time>-<name> by default: new, empty, or with an unfinished run of the same options,
    which is resumed."""
    quiet: Quiet = False

    @pydantic.model_validator(mode="before")
    @classmethod
    def _drop_renderer(cls, data: object) -> object:
        """Files of version 0.2 may name a renderer of camera.gif: rays, or one that is gone."""
        if not isinstance(data, Mapping) or "renderer" not in data:
            return data
        if data["renderer"] not in (None, "rays"):
            raise ValueError("renderer: there is only one, which draws camera.gif by rays; leave the option out")
        return {name: value for name, value in data.items() if name != "renderer"}

    @pydantic.model_validator(mode="after")
    def _check_live(self) -> "RunConfig":
        if self.live and self.quiet:
            raise ValueError("live: its address is printed, which --quiet forbids; leave one of the two out")
        return self

    def folder(self, now: str) -> Path:
        """The folder to write: ``out``, or one in runs/ whose name begins with ``now``."""
        name = self.name or f"{Path(self.environment).name}-{Path(self.behavior.kind).stem}"
        label = "".join(c if c.isalnum() or c in "-_." else "-" for c in name)
        return self.out or Path("runs") / f"{now}-{label}"


class ReplayConfig(Config):
    """Write a page that plays episodes of a run, a dataset or a training, or tests of a validation: they are simulated
    again with the options in the folder."""

    folder: Annotated[Path, Option(positional=True)]
    """Folder of `sean run`, `collect`, `train` or `validate`."""
    episodes: Annotated[tuple[EpisodeNumber, ...], pydantic.Field(min_length=1)] = (0,)
    """Numbers of episodes, from 0: of a run as in episodes.csv, of a dataset in the order of their recording, of a
    training those of its evaluations, which alternate between its environments."""
    only: Names | None = None
    """Tests of a validation, separated by commas, such as rimea-6,imo-1; by default its first."""
    out: Path | None = None
    """File to write, replay.html in the folder by default."""
    quiet: Quiet = False


class CompareConfig(Config):
    """Compare two runs: differences in the episodes that both have, with intervals, and their replays side by side."""

    first: Annotated[Path, Option(positional=True)]
    """Folder of a run."""
    second: Annotated[Path, Option(positional=True)]
    """Folder of another run."""
    out: Path | None = None
    """Page to write, compare-FIRST-SECOND.html by default."""
    quiet: Quiet = False
