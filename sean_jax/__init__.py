"""sean_jax: social robot navigation as pure JAX functions (SEAN 2.0, Tsoi et al. 2022)."""

import ast
import pkgutil
from importlib import import_module

__version__ = "0.2.0"

_PACKAGES = (__name__, f"{__name__}.studies")  # some of whose modules are public as a whole


def _homes() -> dict[str, str]:
    """Public name -> its module, as the stub lists them for type checkers."""
    stub = ast.parse(pkgutil.get_data(__name__, "__init__.pyi") or b"")
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    return {alias.name: str(node.module) for node in imports for alias in node.names}


_HOMES = _homes()  # whose modules are imported at first use, so that `sean --help` imports no JAX
__all__ = sorted(_HOMES)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str):
    home = _HOMES.get(name)
    if home in _PACKAGES:
        return import_module(f"{home}.{name}")
    if home is not None:
        return getattr(import_module(home), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
