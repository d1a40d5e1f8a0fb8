"""The options of every command, as pydantic models."""

from sean_jax.config.commands import DoctorConfig, ListConfig, SchemaConfig
from sean_jax.config.commands.bench import BenchConfig
from sean_jax.config.commands.benchmark import BenchmarkConfig, BenchmarkRankConfig, BenchmarkVerifyConfig
from sean_jax.config.commands.bridge import TRANSPORTS, BridgeConfig, outside
from sean_jax.config.commands.calibrate import CalibrateConfig
from sean_jax.config.commands.collect import CollectConfig
from sean_jax.config.commands.compare import CompareConfig
from sean_jax.config.commands.draw import DrawConfig
from sean_jax.config.commands.experiment import (
    AblationConfig,
    ExperimentConfig,
    Figure4Config,
    LearnedConfig,
    LearningCurveConfig,
    SituationConfig,
    Table1Config,
)
from sean_jax.config.commands.export import (
    ExportAgentConfig,
    ExportBagConfig,
    ExportConfig,
    ExportLeRobotConfig,
    ExportMapConfig,
    ExportOnnxConfig,
)
from sean_jax.config.commands.fit_graph import FitGraphConfig
from sean_jax.config.commands.imports import ImportBagConfig, ImportMapConfig, ImportRobotConfig
from sean_jax.config.commands.replay import ReplayConfig
from sean_jax.config.commands.run import RunConfig
from sean_jax.config.commands.studio import StudioConfig
from sean_jax.config.commands.survey import SurveyExportConfig, SurveyRatingsConfig, SurveyReportConfig
from sean_jax.config.commands.train import (
    METHODS,
    APGConfig,
    DaggerConfig,
    ImitationConfig,
    PPOConfig,
    ReinforcementConfig,
)
from sean_jax.config.commands.validate import ValidateConfig
from sean_jax.config.commands.worlds import WorldsConfig
from sean_jax.config.components import (
    Bounds,
    Component,
    Config,
    Family,
    Named,
    OwnPart,
    Value,
    aliases,
    families,
    family_of,
    gather,
    is_own_part,
    validate,
    with_defaults,
)
from sean_jax.config.mdp_options import OBSERVED, EnvConfig
from sean_jax.config.option_types import (
    MAX_HOURS,
    MAX_PIXELS,
    MAX_RATE,
    MAX_SHARD,
    MAX_SIDE,
    Number,
    Option,
    Range,
    Text,
)
from sean_jax.config.scenario_options import (
    DEFAULT_FORCES,
    PRESETS,
    USUAL_TASKS,
    CustomTask,
    GraphBehavior,
    HandcraftedBehavior,
    PlaybackBehavior,
    RandomBehavior,
    RobotPart,
    ScenarioConfig,
)

GROUPS = {
    "train": "Train a network, by imitation or by reinforcement learning.",
    "experiment": "Reproduce Table I or Figure 4 of the paper, or vary them.",
    "export": "Write datasets, agents, episodes and environments in the formats of other projects.",
    "benchmark": "Drive fixed tracks with a policy, rank such results, or verify them.",
    "survey": "Export or report the answers of a study that `sean studio --survey` has run, or published ratings.",
}
"""Word of the command line that needs a second word -> its summary."""

COMMANDS: dict[str, type[Config]] = {
    "run": RunConfig,
    "collect": CollectConfig,
    **{f"train {name}": options for name, options in METHODS.items()},
    "experiment table1": Table1Config,
    "experiment ablation": AblationConfig,
    "experiment figure4": Figure4Config,
    "experiment learning_curve": LearningCurveConfig,
    "export lerobot": ExportLeRobotConfig,
    "export agent": ExportAgentConfig,
    "export onnx": ExportOnnxConfig,
    "export bag": ExportBagConfig,
    "export map": ExportMapConfig,
    "fit-graph": FitGraphConfig,
    "calibrate": CalibrateConfig,
    "draw": DrawConfig,
    "replay": ReplayConfig,
    "studio": StudioConfig,
    "bridge": BridgeConfig,
    "survey export": SurveyExportConfig,
    "survey report": SurveyReportConfig,
    "survey ratings": SurveyRatingsConfig,
    "compare": CompareConfig,
    "import-map": ImportMapConfig,
    "import-bag": ImportBagConfig,
    "import-robot": ImportRobotConfig,
    "worlds": WorldsConfig,
    "benchmark run": BenchmarkConfig,
    "benchmark rank": BenchmarkRankConfig,
    "benchmark verify": BenchmarkVerifyConfig,
    "bench": BenchConfig,
    "validate": ValidateConfig,
    "doctor": DoctorConfig,
    "list": ListConfig,
    "schema": SchemaConfig,
}
"""Words of the command line -> their options."""
