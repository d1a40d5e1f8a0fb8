"""The options of ``sean collect``."""

from pathlib import Path
from typing import Annotated

import pydantic

from sean_jax.config import option_types
from sean_jax.config.components import Named
from sean_jax.config.option_types import NO_EFFECT
from sean_jax.config.scenario_options import Part, ScenarioConfig


class CollectConfig(ScenarioConfig):
    """Record demonstrations: observations and commands of a policy. An unfinished folder is resumed."""

    metrics: Annotated[tuple[Named, ...], NO_EFFECT] = ()
    """Nothing is measured while demonstrations are recorded."""
    policy: Part = Named(kind="expert")
    """Policy of the robot: a name, or a folder of `sean train`."""
    labels: Part | None = None
    """Policy whose commands are recorded instead of the driving policy's commands."""
    noise: option_types.Noise | None = None
    """Standard deviation of noise on the executed commands, as a share of the robot's limits, so that demonstrations
    show recovery from deviations. Commands are recorded without it."""
    hours: Annotated[option_types.Hours, NO_EFFECT] = 1.0
    """Hours of demonstrations, divided equally among tasks, or among the five situations of handcrafted people."""
    rate: option_types.Rate = 1
    """Examples per second: 1, or another divisor of the control steps per second. Images and positions
    within an example are a second apart at any rate."""
    width: option_types.Side = 64
    """Width of the depth images in pixels."""
    height: option_types.Side = 48
    """Height of the depth images in pixels."""
    batch: Annotated[option_types.ShardSize | None, NO_EFFECT] = None
    """Episodes per batch, which is stored in one file; by default chosen for the device and the hours."""
    seed: option_types.Seed = 0
    """The same seed gives the same demonstrations."""
    out: option_types.Out = None
    """Folder of the dataset, runs/demonstrations-<environment>-<behavior>-<policy>-<seed> by default. A dataset of the
    same options is resumed."""
    quiet: option_types.Quiet = False

    @pydantic.field_validator("metrics", mode="before")
    @classmethod
    def _no_metrics(cls, value: object) -> object:
        if value not in (None, "none", [], ["none"], ()):
            raise ValueError("nothing is measured while demonstrations are recorded; leave the option out")
        return ()

    @pydantic.model_validator(mode="after")
    def _check_recorded(self) -> "CollectConfig":
        if self.width * self.height > option_types.MAX_PIXELS:
            raise ValueError(
                f"width: {self.width} times {self.height} are more than {option_types.MAX_PIXELS:,} pixels; "
                "ask for fewer"
            )
        if self.behavior.kind == "playback":
            raise ValueError("behavior: playback is not recorded; choose behavior graph, random or handcrafted")
        if any(task.kind == "custom" for task in self.tasks):
            raise ValueError("task: custom is not recorded; choose another task")
        steps = round(1.0 / self.time_step)
        if steps % self.rate:
            raise ValueError(
                f"rate: {self.rate} examples a second do not divide its {steps} steps of control; choose a divisor"
            )
        return self

    @property
    def folder(self) -> Path:
        """The folder of the dataset."""
        environment, behavior = Path(self.environment).name, Path(self.behavior.kind).stem
        name = f"demonstrations-{environment}-{behavior}-{Path(self.policy.kind).stem}-{self.seed}"
        return self.out or Path("runs") / name
