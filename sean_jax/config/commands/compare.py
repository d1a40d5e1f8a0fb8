"""The options of ``sean compare``."""

from pathlib import Path
from typing import Annotated

from sean_jax.config import option_types
from sean_jax.config.components import Config
from sean_jax.config.option_types import Option


class CompareConfig(Config):
    """Compare runs with the first of them: differences of all figures, and replays on one clock."""

    runs: Annotated[tuple[Path, ...], Option(positional=True)]
    """Folders of two or more runs."""
    situation: option_types.Text = "overall"
    """Situation whose table is printed; the page has all of them."""
    out: Path | None = None
    """Page to write, compare-FIRST-SECOND.html by default."""
    quiet: option_types.Quiet = False
