"""The options of ``sean worlds``."""

from pathlib import Path
from typing import Annotated

from sean_jax.config import option_types
from sean_jax.config.components import Config
from sean_jax.config.option_types import Option, Text


class WorldsConfig(Config):
    """Make floors of a family, with Behavior Graphs and people, as environment folders."""

    family: Annotated[str, Option(positional=True)]
    """Family: aisles, clutter, lobby, office, passages, rooms or square."""
    out: Path
    """Folder to write; it must be new or empty. A folder in it then serves as --environment."""
    number: option_types.Count = 12
    """Number of floors."""
    seed: option_types.Seed = 0
    """Seed of the first floor; the others follow it."""
    words: Text | None = None
    """Words of the family, separated by commas: values, or ranges to draw from, such as width=16,door=1.0:1.2."""
