"""sean_jax: social robot navigation as pure JAX functions (SEAN 2.0, Tsoi et al. 2022)."""

import os
import sys
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sean_jax import sensors
    from sean_jax.assembly import make
    from sean_jax.classifiers import SITUATIONS
    from sean_jax.crowding import congestion
    from sean_jax.drawing import view
    from sean_jax.metrics import aggregate
    from sean_jax.parallel import rollout, simulate
    from sean_jax.scenario import observe, place, reset, results, step

__version__ = "0.1.0"

# Where each public name lives; read on first use, so that `sean --help` need not import JAX.
_HOMES = {
    "make": "assembly",
    "SITUATIONS": "classifiers",
    "congestion": "crowding",
    "view": "drawing",
    "aggregate": "metrics",
    "rollout": "parallel",
    "simulate": "parallel",
    "observe": "scenario",
    "place": "scenario",
    "reset": "scenario",
    "results": "scenario",
    "step": "scenario",
}

_ROOMS = ("sensors",)  # public as a whole

__all__ = [
    "SITUATIONS",
    "aggregate",
    "congestion",
    "make",
    "observe",
    "place",
    "reset",
    "results",
    "rollout",
    "sensors",
    "simulate",
    "step",
    "view",
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
        return import_module(f"{__name__}.{name}")
    if name in _HOMES:
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES, *_ROOMS})
