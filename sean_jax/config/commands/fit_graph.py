"""The options of ``sean fit-graph``."""

from pathlib import Path
from typing import Annotated, Self

import pydantic

from sean_jax.config import option_types
from sean_jax.config.components import Config
from sean_jax.config.option_types import Option


class FitGraphConfig(Config):
    """Propose a behavior graph for an environment, or fit one to recorded or simulated people."""

    environment: Annotated[option_types.EnvironmentName, Option(positional=True)]
    recording: Path | None = None
    """People to fit to: a CSV file with the columns frame, id, x and y in metres."""
    recording_format: option_types.RecordingFormat = None
    frame_rate: option_types.RecordingRate = None
    simulate: bool = False
    """Fit to people simulated on the environment's own graph, to test whether the fit recovers it."""
    propose: bool = False
    """Propose nodes and edges even if the environment has a graph; without people to fit to, do only that."""
    graph: Path | None = None
    """A graph.yaml with the nodes and edges; the environment's own by default."""
    people: option_types.People | None = None
    """Number of simulated people; the environment's own number by default."""
    routing: option_types.Routing = "whole"
    minutes: option_types.Minutes = 20.0
    """Minutes to simulate for the fit, and again for its test."""
    temperature: option_types.Temperature = 0.25
    """Softmax temperature in metres over the costs of routes."""
    seed: option_types.Seed = 0
    """The same seed gives the same results."""
    out: option_types.Out = None
    """Folder to write, runs/graph-ENVIRONMENT by default; it must be new or empty. The folder is an environment."""
    quiet: option_types.Quiet = False

    @pydantic.model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.recording is not None and self.simulate:
            raise ValueError("simulate: --simulate and --recording exclude each other; choose one")
        return self

    @property
    def folder(self) -> Path:
        """The folder to write."""
        return self.out or Path("runs") / f"graph-{Path(self.environment).name}"
