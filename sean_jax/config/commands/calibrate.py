"""The options of ``sean calibrate``."""

from pathlib import Path
from typing import Annotated

from sean_jax.config import option_types
from sean_jax.config.components import Config
from sean_jax.config.option_types import Number
from sean_jax.config.scenario_options import DEFAULT_FORCES


class CalibrateConfig(Config):
    """Fit the constants of the social forces to crowds and to recorded people. An unfinished fit is resumed."""

    data: Path
    """Folder of recordings: scenes of ETH and UCY, runs of Juelich's corridors."""
    forces: option_types.Text = DEFAULT_FORCES
    """Start of the fit: a preset of social forces, or a YAML file of constants."""
    fit: option_types.Names | None = None
    """Constants to fit, separated by commas, such as repulsion.range; by default all that have bounds. none: the habits
    of prediction alone, without crowds. intent: how people walk to their goals, alone."""
    in_crowd: bool = False
    """Fit intent to people who meet others in the ordinary simulator, not to people who walk alone; slow on a CPU."""
    leave_out: option_types.Names | None = None
    """Scenes of prediction, separated by commas, for leave-one-out fits, each judged by the scene that it lacks; all by
    default, or none."""
    generations: option_types.Count = 60
    """Generations of the search (CMA-ES)."""
    population: Annotated[int, Number(4, 4096)] = 32
    """Candidates in a generation of each fit."""
    draws: Annotated[int, Number(1, 100)] = 2
    """Draws of people in each corridor, file and mix; half as many at each door."""
    quick: bool = False
    """A minute on a CPU: few crowds and windows, to try the command."""
    seed: option_types.Seed = 0
    """The same seed gives the same constants."""
    out: option_types.Out = None
    """Folder for the results, runs/calibration or runs/calibration-quick by default."""
    quiet: option_types.Quiet = False

    @property
    def folder(self) -> Path:
        """The folder of the results."""
        return self.out or Path("runs") / ("calibration-quick" if self.quick else "calibration")
