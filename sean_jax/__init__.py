"""sean_jax: social robot navigation as pure JAX functions (SEAN 2.0, Tsoi et al. 2022)."""

import os
import sys
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sean_jax import gradients, mdp, registry, sensors
    from sean_jax.assembly import make, with_task
    from sean_jax.base import (
        Behavior,
        Environment,
        Groups,
        Observation,
        Pedestrians,
        Policy,
        Robot,
        RobotModel,
        RobotTask,
        Scenario,
        Sensor,
        Snapshot,
        State,
        Trajectory,
        as_policy,
    )
    from sean_jax.behaviors import BEHAVIORS, Place
    from sean_jax.classifiers import SITUATION_SETS, SITUATIONS, Thresholds
    from sean_jax.components import trust
    from sean_jax.config import (
        APGConfig,
        CollectConfig,
        CustomTask,
        EnvConfig,
        GraphBehavior,
        HandcraftedBehavior,
        ImitationConfig,
        PlaybackBehavior,
        PPOConfig,
        RandomBehavior,
        RunConfig,
        ScenarioConfig,
    )
    from sean_jax.crowding import congestion
    from sean_jax.episodes import (
        ResetPool,
        autoreset,
        init_policy,
        policy_step,
        reset_pool,
        rollout,
        rollout_autoreset,
        simulate,
    )
    from sean_jax.errors import FileError, IncompleteError, InputError, SeanError, WriteError
    from sean_jax.evaluation import Evaluation, evaluate
    from sean_jax.mdp import Env, EnvState, make_env
    from sean_jax.metrics import METRICS, Metric, aggregate
    from sean_jax.pedestrian_models import MODELS, pedestrians_at
    from sean_jax.policies import POLICIES
    from sean_jax.replay import view
    from sean_jax.robots import ROBOTS
    from sean_jax.runner import Record, Runner
    from sean_jax.scenario import next_task, observe, reset, results, step, teleport
    from sean_jax.sensors import SENSORS, sense
    from sean_jax.social_forces import PRESETS, Forces, preset
    from sean_jax.studies import inverse_graph, scenes
    from sean_jax.studies.prediction import predict
    from sean_jax.tasks import TASKS, build_task
    from sean_jax.trajectories import load_trajectory, save_trajectory

__version__ = "0.2.0"

# Where each public name lives; read on first use, so that `sean --help` need not import JAX.
_PUBLIC = {
    "assembly": "make with_task",
    "base": "Behavior Environment Groups Observation Pedestrians Policy Robot RobotModel RobotTask "
    "Scenario Sensor Snapshot State Trajectory as_policy",
    "behaviors": "BEHAVIORS Place",
    "classifiers": "SITUATIONS SITUATION_SETS Thresholds",
    "components": "trust",
    "config": "APGConfig CollectConfig CustomTask EnvConfig GraphBehavior HandcraftedBehavior ImitationConfig "
    "PPOConfig PlaybackBehavior RandomBehavior RunConfig ScenarioConfig",
    "crowding": "congestion",
    "episodes": "ResetPool autoreset init_policy policy_step reset_pool rollout rollout_autoreset simulate",
    "errors": "FileError IncompleteError InputError SeanError WriteError",
    "evaluation": "Evaluation evaluate",
    "mdp": "Env EnvState make_env",
    "metrics": "METRICS Metric aggregate",
    "pedestrian_models": "MODELS pedestrians_at",
    "policies": "POLICIES",
    "replay": "view",
    "robots": "ROBOTS",
    "runner": "Record Runner",
    "scenario": "next_task observe reset results step teleport",
    "sensors": "SENSORS sense",
    "social_forces": "Forces PRESETS preset",
    "studies.prediction": "predict",
    "tasks": "TASKS build_task",
    "trajectories": "load_trajectory save_trajectory",
}
_HOMES = {name: module for module, names in _PUBLIC.items() for name in names.split()}

_RENAMED = {"Moment": "Snapshot", "TrainConfig": "ImitationConfig", "place": "teleport"}  # former name -> name

_ROOMS = {  # public as a whole
    **{name: name for name in ("gradients", "mdp", "registry", "sensors")},
    **{name: f"studies.{name}" for name in ("inverse_graph", "scenes")},
}

__all__ = [
    "APGConfig",
    "BEHAVIORS",
    "Behavior",
    "CollectConfig",
    "CustomTask",
    "Env",
    "EnvConfig",
    "EnvState",
    "Environment",
    "Evaluation",
    "FileError",
    "Forces",
    "Groups",
    "GraphBehavior",
    "HandcraftedBehavior",
    "ImitationConfig",
    "IncompleteError",
    "InputError",
    "METRICS",
    "MODELS",
    "Metric",
    "Observation",
    "POLICIES",
    "PPOConfig",
    "PRESETS",
    "Pedestrians",
    "Place",
    "PlaybackBehavior",
    "Policy",
    "ROBOTS",
    "RandomBehavior",
    "Record",
    "ResetPool",
    "Robot",
    "RobotModel",
    "RobotTask",
    "RunConfig",
    "Runner",
    "SENSORS",
    "SITUATIONS",
    "SITUATION_SETS",
    "Scenario",
    "ScenarioConfig",
    "SeanError",
    "Sensor",
    "Snapshot",
    "State",
    "TASKS",
    "Thresholds",
    "Trajectory",
    "WriteError",
    "aggregate",
    "as_policy",
    "autoreset",
    "build_task",
    "congestion",
    "evaluate",
    "gradients",
    "init_policy",
    "inverse_graph",
    "load_trajectory",
    "make",
    "make_env",
    "mdp",
    "next_task",
    "observe",
    "pedestrians_at",
    "policy_step",
    "predict",
    "preset",
    "registry",
    "reset",
    "reset_pool",
    "results",
    "rollout",
    "rollout_autoreset",
    "save_trajectory",
    "scenes",
    "sense",
    "sensors",
    "simulate",
    "step",
    "teleport",
    "trust",
    "view",
    "with_task",
]


def _silence_alarms() -> None:
    """Keep XLA's alarms off the terminal: a page of text, as an error, for each program that is slow to compile.

    What really fails is raised. Who sets ``TF_CPP_MIN_LOG_LEVEL`` otherwise than JAX does gets what they asked for.
    """
    if os.environ.get("TF_CPP_MIN_LOG_LEVEL", "1") != "1":  # "1" is what JAX sets itself
        return
    os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"
    if "jaxlib" in sys.modules:  # it has read the variable already
        utils = import_module("jaxlib.utils")
        getattr(utils, "absl_set_min_log_level", lambda level: None)(3)


_silence_alarms()


def __getattr__(name: str):
    if name in _ROOMS:
        return import_module(f"{__name__}.{_ROOMS[name]}")
    if name in _HOMES:
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    cure = f"; it is called {_RENAMED[name]} now" if name in _RENAMED else ""
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}{cure}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES, *_ROOMS})
