"""The options of ``sean export``."""

from pathlib import Path
from typing import Annotated, Literal

import pydantic

from sean_jax.config import option_types
from sean_jax.config.components import Config
from sean_jax.config.option_types import Number, Option


class ExportConfig(Config):
    """Options of exports of datasets and agents."""

    format: Annotated[str, Option(positional=True)]
    """Format."""
    source: Annotated[Path, Option(positional=True)]
    """Folder of `sean train ppo`."""
    out: Path
    """Folder to write, which must be new or empty."""
    quiet: option_types.Quiet = False

    @property
    def folder(self) -> Path:
        """The folder to write."""
        return self.out


class ExportLeRobotConfig(ExportConfig):
    """Write a dataset as LeRobotDataset v3.0."""

    format: Annotated[Literal["lerobot"], Option(positional=True)] = "lerobot"  # pyright: ignore
    """A dataset as LeRobotDataset v3.0."""
    source: Annotated[Path, Option(positional=True)]
    """Folder of `sean collect`."""


class ExportAgentConfig(ExportConfig):
    """Write the best agent of a training as two small files."""

    format: Annotated[Literal["agent"], Option(positional=True)] = "agent"  # pyright: ignore
    """A trained agent in two small files."""


class ExportOnnxConfig(ExportConfig):
    """Write the best agent of a training as an ONNX model, which needs neither jax nor this package."""

    format: Annotated[Literal["onnx"], Option(positional=True)] = "onnx"  # pyright: ignore
    """A trained agent as an ONNX model."""
    source: Annotated[Path, Option(positional=True)]
    """Folder of `sean train ppo`, or the name of an agent."""
    out: Path
    """File to write, which ends in .onnx."""


class ExportBagConfig(ExportConfig):
    """Write episodes of a run, a dataset or a training as bags of ROS messages. They are simulated again."""

    format: Annotated[Literal["bag"], Option(positional=True)] = "bag"  # pyright: ignore
    """Bags of ROS messages."""
    source: Annotated[Path, Option(positional=True)]
    """Folder of `sean run`, `collect` or `train`."""
    episodes: Annotated[tuple[option_types.EpisodeNumber, ...], pydantic.Field(min_length=1)] = (0,)
    """Numbers of episodes, as of `sean replay`; each becomes a bag."""
    ros: Literal["both", "1", "2"] = "both"
    """1: files of rosbag 1 (Noetic); 2: folders of rosbag2 with MCAP (Jazzy)."""
    naming: Literal["ros", "sean"] = "ros"
    """Names of topics: ros as in Nav2 and move_base; sean as in SEAN 2.0, with its own topics."""
    sensors: option_types.Names | None = None
    """Sensors to add to those of the run, separated by commas: names or YAML files; by default the robot's lidar, with
    none nothing."""


class ExportMapConfig(ExportConfig):
    """Write the map of an environment for a ROS map_server: a YAML file and its image."""

    format: Annotated[Literal["map"], Option(positional=True)] = "map"  # pyright: ignore
    """A map of map_server."""
    source: Annotated[Path, Option(positional=True)]
    """Environment: a name, or a folder."""
    out: Path
    """File to write, which ends in .yaml; the image lies beside it."""
    resolution: Annotated[float, Number(0.001, 0.5, "m")] = 0.05
    """Side of a cell in metres."""
    height: Annotated[float, Number(0.0, 100.0, "m")] = 0.0
    """Least height in metres of the obstacles on the map. SEAN's short map has all, its tall map those of 1 m."""
