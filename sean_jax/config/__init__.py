"""The options of every command, as pydantic models."""

from sean_jax.config.core import (
    OWN_PART,
    RENAMED,
    Component,
    Config,
    Described,
    Family,
    Named,
    OwnPart,
    Value,
    aliases,
    did_you_mean,
    family_of,
    gather,
    is_own_part,
    present_names,
    validate,
    with_defaults,
)
from sean_jax.config.fields import MAX_HOURS, MAX_PIXELS, MAX_RATE, MAX_SHARD, MAX_SIDE, Number, Option, Text
from sean_jax.config.learning import (
    METHODS,
    OBSERVED,
    APGConfig,
    CollectConfig,
    DaggerConfig,
    EnvConfig,
    ExportConfig,
    ImitationConfig,
    PPOConfig,
    ReinforcementConfig,
)
from sean_jax.config.scenario import (
    DEFAULT_FORCES,
    PRESETS,
    USUAL_TASKS,
    CompareConfig,
    CustomTask,
    GraphBehavior,
    HandcraftedBehavior,
    PlaybackBehavior,
    RandomBehavior,
    ReplayConfig,
    RunConfig,
    ScenarioConfig,
    usual,
)
from sean_jax.config.studies import (
    EXPERIMENTS,
    AblationConfig,
    BenchmarkConfig,
    CalibrateConfig,
    ExperimentConfig,
    Figure4Config,
    FitGraphConfig,
    LearnedConfig,
    LearningCurveConfig,
    SituationConfig,
    Table1Config,
    ValidateConfig,
)
from sean_jax.config.tools import (
    BenchConfig,
    DoctorConfig,
    DrawConfig,
    ImportMapConfig,
    ListConfig,
    SchemaConfig,
)

GROUPS = {
    "train": "Train a network, by imitation or by reinforcement learning.",
    "experiment": "Reproduce Table I or Figure 4 of the paper, or vary them.",
}
"""Word of the command line that needs a second one -> its summary."""

COMMANDS: dict[str, type[Config]] = {
    "run": RunConfig,
    "collect": CollectConfig,
    **{f"train {name}": options for name, options in METHODS.items()},
    **{f"experiment {name}": options for name, options in EXPERIMENTS.items()},
    "export": ExportConfig,
    "fit-graph": FitGraphConfig,
    "calibrate": CalibrateConfig,
    "draw": DrawConfig,
    "replay": ReplayConfig,
    "compare": CompareConfig,
    "import-map": ImportMapConfig,
    "benchmark": BenchmarkConfig,
    "bench": BenchConfig,
    "validate": ValidateConfig,
    "doctor": DoctorConfig,
    "list": ListConfig,
    "schema": SchemaConfig,
}
"""Words of the command line -> their options."""
