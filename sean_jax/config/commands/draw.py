"""The options of ``sean draw``."""

from pathlib import Path

from sean_jax.config import option_types
from sean_jax.config.components import Config


class DrawConfig(Config):
    """Draw the behavior graphs of the environments, or their handcrafted sets."""

    graph: bool = False
    """The behavior graph, with its groups seated."""
    handcrafted: bool = False
    """The handcrafted sets, one panel each."""
    sets: option_types.Text = "all"
    """Which handcrafted sets, as in sean run."""
    environment: option_types.Text | None = None
    """Environment: a name, or the folder of your own; by default all of the package."""
    out: Path | None = None
    """File to write, such as sheet.png or sheet.svg; with several environments, the name of each is added."""
