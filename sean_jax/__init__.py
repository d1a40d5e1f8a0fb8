"""sean_jax: social robot navigation as pure JAX functions (SEAN 2.0, Tsoi et al. 2022)."""

import os
import sys
from importlib import import_module

import lazy_loader

__version__ = "0.2.0"

# Modules are imported at first use of a name, so that `sean --help` imports no JAX.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def _silence_alarms() -> None:
    """Keep XLA's alarms off the terminal: a page of text, as an error, for each program that is slow to compile.

    Real failures are raised. A ``TF_CPP_MIN_LOG_LEVEL`` of the user, other than JAX's own "1", stays.
    """
    if os.environ.get("TF_CPP_MIN_LOG_LEVEL", "1") != "1":  # "1" is what JAX sets itself
        return
    os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"
    if "jaxlib" in sys.modules:  # it has read the variable already
        utils = import_module("jaxlib.utils")
        getattr(utils, "absl_set_min_log_level", lambda level: None)(3)


_silence_alarms()
