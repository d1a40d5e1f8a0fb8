"""The options of ``sean replay``."""

from pathlib import Path
from typing import Annotated

import pydantic

from sean_jax.config import option_types
from sean_jax.config.components import Config
from sean_jax.config.option_types import Option


class ReplayConfig(Config):
    """Write a page that plays episodes of a run, a dataset or a training, or tests of a validation. They are simulated
    again with the options in the folder."""

    folder: Annotated[Path, Option(positional=True)]
    """Folder of `sean run`, `collect`, `train` or `validate`."""
    episodes: Annotated[tuple[option_types.EpisodeNumber, ...], pydantic.Field(min_length=1)] = (0,)
    """Numbers of episodes, from 0: of a run as in episodes.csv, of a dataset in the order of their recording, of a
    training the episodes of its evaluations, which alternate between its environments."""
    only: option_types.Names | None = None
    """Tests of a validation, separated by commas, such as rimea-6,imo-1; by default its first."""
    out: Path | None = None
    """File to write, replay.html in the folder by default."""
    quiet: option_types.Quiet = False
