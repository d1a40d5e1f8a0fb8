"""Versions and fingerprints of the software and numbers behind a result."""

import contextlib
import hashlib
import importlib.metadata
import platform
from collections.abc import Mapping
from typing import Any

from sean_jax import __version__

PACKAGES = ("jax", "jaxlib", "flax", "optax", "mujoco", "mujoco-mjx", "numpy", "tensorstore", "pedpy")


def versions() -> dict[str, str]:
    """Name -> version, of Python and of sean_jax and the packages that results depend on."""
    result = {"python": platform.python_version(), "sean-jax": __version__}
    for package in PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            result[package] = importlib.metadata.version(package)
    return result


def version_mismatch(saved: Any) -> str | None:
    """The first difference from the current versions, such as "jax 0.9.0, not 0.10.0"; None if there is none.

    Args:
        saved: as from ``versions``, from a file; anything but a mapping has no difference.
    """
    for name, version in versions().items() if isinstance(saved, Mapping) else ():
        if saved.get(name, version) != version:
            return f"{name} {saved[name]}, not {version}"
    return None


def fingerprint(*trees: Any) -> str:
    """A digest of 16 letters of all shapes, types and numbers in pytrees, such as scenarios."""
    import jax
    import numpy as np

    digest = hashlib.sha256()
    for leaf in jax.tree.leaves(trees):
        values = np.asarray(leaf)
        digest.update(f"{values.dtype}{values.shape}".encode() + values.tobytes())
    return digest.hexdigest()[:16]
