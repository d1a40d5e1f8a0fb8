"""The options of ``sean run``."""

from pathlib import Path
from typing import Annotated, Literal

import pydantic

from sean_jax.config import option_types
from sean_jax.config.components import Component, Named
from sean_jax.config.option_types import Option
from sean_jax.config.scenario_options import Part, ScenarioConfig
from sean_jax.core.messages import listed


class RunConfig(ScenarioConfig):
    """Simulate a batch of episodes and write a table, a report and an animation. `sean list` names the choices."""

    policy: Annotated[Part, pydantic.BeforeValidator(option_types.join_names)] = Named(kind="go_to_goal")
    """Policy of the robot: a name, or a folder of `sean train` or `sean export agent`."""
    robots: Annotated[option_types.Text | None, pydantic.BeforeValidator(option_types.join_names)] = None
    """Several robots at once, each with its own task, separated by commas, such as kuri,kuri; without it, one robot.
    The policy is that of all, or as many policies, separated by commas."""
    episodes: option_types.EpisodeCount = 64
    """Number of episodes."""
    seed: option_types.Seed = 0
    """The same seed gives the same episodes."""
    batch: option_types.BatchSize = 1024
    """Largest number of episodes per batch."""
    camera: Annotated[option_types.Text | None, Option(affects_results=False)] = None
    """Also write camera.gif, the first episode as first_person, third_person, overhead or depth sees it."""
    trajectories: Literal["csv", "parquet"] | None = None
    """Also write the frames of all episodes, robot and people, as trajectories.csv or .parquet."""
    baseline: Annotated[Path | None, Option(affects_results=False)] = None
    """Folder of another run, with which the report compares its headline figures."""
    live: Annotated[bool, Option(affects_results=False)] = False
    """Serve a page on this computer that plays the first episode during its simulation."""
    name: Annotated[str, Option(affects_results=False)] = ""
    """Name of the run, the end of the folder's name; by default the environment and the behavior."""
    out: option_types.Out = None
    """Folder to write, runs/<date>-<time>-<name> by default: new, empty, or with an unfinished run of the same options,
    which is resumed."""
    quiet: option_types.Quiet = False

    @property
    def team(self) -> list[str]:
        """The robots of a team; empty without one."""
        return [] if self.robots is None else listed(self.robots)

    @property
    def policies(self) -> list[Component]:
        """The policies of the robots, or the one of all."""
        several = self.team and isinstance(self.policy, Named) and "," in self.policy.kind
        return [Named(kind=name) for name in listed(self.policy.kind)] if several else [self.policy]

    @pydantic.model_validator(mode="after")
    def _check_team(self) -> "RunConfig":
        if self.robots is None:
            return self
        if "robot" in self.model_fields_set and self.robot != Named(kind="kuri"):
            raise ValueError("robots: a robot is given as well; leave one of the two out")
        if not self.team:
            raise ValueError("robots: there is none; give names, separated by commas, such as kuri,kuri")
        if len(self.policies) not in (1, len(self.team)):
            raise ValueError(
                f"policy: {len(self.policies)} policies for {len(self.team)} robots; give one of all, or one for each"
            )
        for name in ("live", "camera", "trajectories"):
            if getattr(self, name):
                raise ValueError(f"{name}: is for one robot, not for a team; leave it out")
        return self

    @pydantic.model_validator(mode="after")
    def _check_live(self) -> "RunConfig":
        if self.live and self.quiet:
            raise ValueError("live: its address is printed, which --quiet forbids; leave one of the two out")
        return self

    def folder(self, now: str) -> Path:
        """The folder to write: ``out``, or one in runs/ whose name begins with ``now``."""
        name = self.name or f"{Path(self.environment).name}-{Path(self.behavior.kind).stem}"
        label = "".join(c if c.isalnum() or c in "-_." else "-" for c in name)
        return self.out or Path("runs") / f"{now}-{label}"
