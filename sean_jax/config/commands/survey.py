"""The options of ``sean survey``, which evaluates the answers to a study of ``sean studio --survey``."""

from pathlib import Path
from typing import Annotated, Literal

from sean_jax.config import option_types
from sean_jax.config.components import Config
from sean_jax.config.option_types import Option


class SurveyExportConfig(Config):
    """Write the answers of a study as CSV files, and its drives as pages that replay them."""

    what: Annotated[Literal["export"], Option(positional=True)] = "export"
    """Tables and replays."""
    folder: Annotated[Path, Option(positional=True)]
    """Folder of `sean studio --survey`."""
    out: Path | None = None
    """Folder to write, tables in the study's folder by default; files of the same names are replaced."""


class SurveyReportConfig(Config):
    """Compare the ratings of a study with the metrics of its episodes: correlations and means, with intervals."""

    what: Annotated[Literal["report"], Option(positional=True)] = "report"
    """Correlations and means."""
    folder: Annotated[Path, Option(positional=True)]
    """Folder of `sean studio --survey`."""
    out: Path | None = None
    """Page to write, report.html in the study's folder by default."""
    quiet: option_types.Quiet = False


class SurveyRatingsConfig(Config):
    """Compare ratings of recorded robots, in the format of SocNav3, with the metrics of their trajectories."""

    what: Annotated[Literal["ratings"], Option(positional=True)] = "ratings"
    """Correlations of ratings from elsewhere."""
    trajectories: Annotated[Path, Option(positional=True)]
    """Folder of trajectories, one JSON file each."""
    ratings: Annotated[Path, Option(positional=True)]
    """Folder of ratings, a JSON file for each rater."""
    out: Path
    """Folder to write; it must be new or empty."""
    quiet: option_types.Quiet = False
