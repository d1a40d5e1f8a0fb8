"""The public names of sean_jax and their modules: type checkers read them here, and `lazy_loader` too."""

from . import mdp as mdp, sensors as sensors
from .core import gradients as gradients
from .mdp import registry as registry
from .simulation import team as team
from .simulation.making import make as make, make_team as make_team, with_task as with_task
from .core.data_types import (
    Behavior as Behavior,
    Environment as Environment,
    Groups as Groups,
    Observation as Observation,
    Pedestrians as Pedestrians,
    Policy as Policy,
    Robot as Robot,
    RobotModel as RobotModel,
    RobotTask as RobotTask,
    Scenario as Scenario,
    Sensor as Sensor,
    Snapshot as Snapshot,
    State as State,
    Trajectory as Trajectory,
    as_policy as as_policy,
)
from .people.behaviors import BEHAVIORS as BEHAVIORS, Place as Place
from .classifiers import SITUATIONS as SITUATIONS, SITUATION_SETS as SITUATION_SETS, Thresholds as Thresholds
from .config.user_parts import trust as trust
from .config import (
    APGConfig as APGConfig,
    CollectConfig as CollectConfig,
    CustomTask as CustomTask,
    EnvConfig as EnvConfig,
    GraphBehavior as GraphBehavior,
    HandcraftedBehavior as HandcraftedBehavior,
    ImitationConfig as ImitationConfig,
    PPOConfig as PPOConfig,
    PlaybackBehavior as PlaybackBehavior,
    RandomBehavior as RandomBehavior,
    RunConfig as RunConfig,
    ScenarioConfig as ScenarioConfig,
)
from .people.density import congestion as congestion
from .simulation.episodes import (
    ResetPool as ResetPool,
    autoreset as autoreset,
    init_policy as init_policy,
    policy_step as policy_step,
    reset_pool as reset_pool,
    rollout as rollout,
    rollout_autoreset as rollout_autoreset,
    simulate as simulate,
)
from .core.errors import (
    FileError as FileError,
    IncompleteError as IncompleteError,
    InputError as InputError,
    SeanError as SeanError,
    WriteError as WriteError,
)
from .evaluation import Evaluation as Evaluation, evaluate as evaluate
from .mdp import Env as Env, EnvState as EnvState, make_env as make_env
from .metrics import METRICS as METRICS, Metric as Metric, aggregate as aggregate
from .people.pedestrian_models import MODELS as MODELS
from .people.pedestrian_models import pedestrians_at as pedestrians_at
from .policies import POLICIES as POLICIES
from .web.replay import view as view
from .robots import ROBOTS as ROBOTS
from .simulation.episode_runner import Record as Record, Runner as Runner
from .simulation.scenario import (
    next_task as next_task,
    observe as observe,
    reset as reset,
    results as results,
    step as step,
    teleport as teleport,
)
from .sensors import SENSORS as SENSORS, sense as sense
from .social_forces import Forces as Forces, PRESETS as PRESETS, preset as preset
from .studies import inverse_graph as inverse_graph, scenes as scenes
from .studies.prediction import predict as predict
from .tasks import TASKS as TASKS, build_task as build_task
from .io.trajectories import load_trajectory as load_trajectory, save_trajectory as save_trajectory

__version__: str
