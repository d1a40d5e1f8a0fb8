"""The options of ``sean studio``."""

from pathlib import Path
from typing import Annotated, Literal

import pydantic

from sean_jax.config import option_types
from sean_jax.config.components import Named
from sean_jax.config.option_types import Option
from sean_jax.config.scenario_options import Part, ScenarioConfig


class StudioConfig(ScenarioConfig):
    """Serve a page on this computer for driving the robot among the people of a scenario, and for recording drives."""

    policy: Part = Named(kind="go_to_goal")
    """Policy that drives while no person does: a name, or a folder of `sean train` or `sean export agent`."""
    seed: option_types.Seed = 0
    """The same seed gives the same episodes."""
    warm_up: option_types.Duration = 5.0
    """Seconds for which people walk before a task begins."""
    record: option_types.Out = None
    """Folder for recorded drives: their commands in trials/, and demonstrations for `sean train imitation`."""
    demonstrations: Annotated[Literal["person", "all"], Option(affects_results=False)] = "person"
    """Steps of recorded drives that become demonstrations: those that a person drove in completed drives, or `all`,
    which has those of the policy and of drives that were stopped, too."""
    port: Annotated[int, option_types.Number(0, 65535), Option(affects_results=False)] = 0
    """Port of the page on 127.0.0.1; 0 for a free one."""
    survey: Annotated[Path | None, Option(affects_results=False)] = None
    """Study to run with participants: a study.yaml, which has all options of its episodes. Needs --out."""
    out: option_types.Out = None
    """Folder for the answers to --survey: new, or with the same study, which goes on."""

    @pydantic.model_validator(mode="after")
    def _check_survey(self) -> "StudioConfig":
        if self.survey is None:
            if self.out is not None:
                raise ValueError("survey: out needs it, too; add --survey")
            return self
        if self.out is None:
            raise ValueError("out: survey needs it, too; add --out")
        for name in sorted(self.model_fields_set - {"survey", "out", "port"}):
            raise ValueError(f"{name}: a study has its own options; write it into {self.survey}")
        return self
