"""The options of ``sean validate``."""

from pathlib import Path
from typing import Annotated

from sean_jax.config import option_types
from sean_jax.config.components import Config
from sean_jax.config.option_types import Option


class ValidateConfig(Config):
    """Compare simulated people with measurements: standards, measured diagrams, recordings."""

    quick: bool = False
    """Five minutes on a CPU: fewer seeds, and without the checks of a thousand people."""
    only: option_types.Names | None = None
    """Checks, separated by commas; rimea-* selects all with this prefix. All by default."""
    models: option_types.Names | None = None
    """Models of people, separated by commas: presets of forces, files of constants, pedestrian models, or FILE.py:NAME;
    by default the default forces."""
    data: Path | None = None
    """Folder of recordings; without it, checks that need them are skipped."""
    strict: Annotated[bool, Option(affects_results=False)] = False
    """Exit code 1 if a check fails."""
    out: option_types.Out = None
    """Folder for the results, runs/validate by default. Existing results of the same checks and models are kept."""
    quiet: option_types.Quiet = False

    @property
    def folder(self) -> Path:
        """The folder of the results."""
        return self.out or Path("runs") / ("validate-quick" if self.quick else "validate")
