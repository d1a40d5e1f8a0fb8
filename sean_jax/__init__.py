"""sean_jax: social robot navigation as pure JAX functions (SEAN 2.0, Tsoi et al. 2022)."""

import ast
import os
import pkgutil
import sys
from importlib import import_module

__version__ = "0.2.0"

_PACKAGES = (__name__, f"{__name__}.studies")  # some of whose modules are public as a whole
_RENAMED = {"Moment": "Snapshot", "TrainConfig": "ImitationConfig", "place": "teleport"}  # former name -> name


def _homes() -> dict[str, str]:
    """Public name -> its module, as the stub lists them for type checkers."""
    stub = ast.parse(pkgutil.get_data(__name__, "__init__.pyi") or b"")
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    return {alias.name: str(node.module) for node in imports for alias in node.names}


_HOMES = _homes()  # whose modules are imported at first use, so that `sean --help` imports no JAX
__all__ = sorted(_HOMES)  # pyright: ignore[reportUnsupportedDunderAll]


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


def __getattr__(name: str):
    home = _HOMES.get(name)
    if home in _PACKAGES:
        return import_module(f"{home}.{name}")
    if home is not None:
        return getattr(import_module(home), name)
    cure = f"; it is called {_RENAMED[name]} now" if name in _RENAMED else ""
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}{cure}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
