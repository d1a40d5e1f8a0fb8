"""The options of ``sean benchmark``."""

from pathlib import Path
from typing import Annotated, Literal

import pydantic

from sean_jax.config import option_types
from sean_jax.config.components import Config
from sean_jax.config.option_types import Number, Option


class BenchmarkConfig(Config):
    """Drive the fixed tracks of the benchmark with a policy: tables by track and social situation, and a result for the
    ranking. An unfinished folder is resumed."""

    which: Annotated[Literal["run"], Option(positional=True)] = "run"
    """Result of a policy."""
    policy: Annotated[option_types.Text, Option(positional=True)]
    """Policy: a name, a folder of `sean train` or `sean export agent`, or FILE.py:NAME."""
    quick: bool = False
    """Minutes on a CPU, with few episodes: such a result shows whether a policy works, and is not ranked."""
    episodes: option_types.EpisodeCount | None = None
    """Episodes of each track, by default the protocol's number; a result with fewer is not ranked."""
    recordings: Annotated[Path | None, Option(affects_results=False)] = None  # their content does
    """Folder with the recorded people of the tracks eth and zara01, eth.csv and zara01.csv, which are skipped without
    it."""
    sensing: Literal["all-knowing", "tracks", "raw"] | None = None
    """Class of a policy of your own or of a controller outside: all-knowing, tracks (of visible people) or raw
    (sensors). By default the policy's attribute sensing, else all-knowing; policies of the package and agents have
    theirs."""
    name: Annotated[option_types.Text | None, Option(affects_results=False)] = None
    """Entry of the ranking, the policy by default. Results of one name are the training seeds of one agent."""
    out: option_types.Out = None
    """Folder for the result, runs/benchmark-POLICY by default. An unfinished benchmark of the same options is
    resumed."""
    quiet: option_types.Quiet = False

    @property
    def folder(self) -> Path:
        """The folder of the result."""
        name = Path(self.policy.replace(":", "-")).name
        return self.out or Path("runs") / f"benchmark-{name}{'-quick' if self.quick else ''}"


class BenchmarkRankConfig(Config):
    """Rank results of the benchmark by class of sensing, with ties."""

    which: Annotated[Literal["rank"], Option(positional=True)] = "rank"
    """Ranking of results."""
    results: Annotated[tuple[Path, ...], Option(positional=True), pydantic.Field(min_length=1)]
    """Folders of `sean benchmark run`; folders of one --name are one entry."""
    out: option_types.Out = None
    """Folder for the ranking, runs/ranking by default; files of the same names are replaced."""
    quiet: option_types.Quiet = False

    @property
    def folder(self) -> Path:
        """The folder of the ranking."""
        return self.out or Path("runs") / "ranking"


class BenchmarkVerifyConfig(Config):
    """Simulate a random sample of a result's episodes again, and compare each measure."""

    which: Annotated[Literal["verify"], Option(positional=True)] = "verify"
    """Check of a result."""
    result: Annotated[Path, Option(positional=True)]
    """Folder of `sean benchmark run`."""
    policy: option_types.Text | None = None
    """The result's policy, where it has another place here; its digest must be that of the result."""
    recordings: Path | None = None
    """Folder with the result's recordings; without it, tracks of recorded people are not in the sample."""
    tracks: Annotated[int, Number(1, 1_000)] = 4
    """Number of tracks in the sample, with a batch of episodes of each."""
    seed: option_types.Seed | None = None
    """Seed of the sample; by default it is drawn, and printed."""
    quiet: option_types.Quiet = False
