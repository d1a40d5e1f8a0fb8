"""What a run, a dataset or a network was made with."""

import contextlib
import hashlib
import importlib.metadata
import platform
from collections.abc import Mapping
from typing import Any

PACKAGES = ("sean-jax", "jax", "jaxlib", "flax", "optax", "mujoco", "mujoco-mjx", "numpy", "tensorstore")


def versions() -> dict[str, str]:
    """Name to version."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[package] = importlib.metadata.version(package)
    return found


def differing(had: Any) -> str | None:
    """A package that has another version now than in ``had``, in words; None if there is none that both know."""
    for name, version in versions().items() if isinstance(had, Mapping) else ():
        if had.get(name, version) != version:
            return f"{name} {had[name]}, not {version}"
    return None


def content(*trees: Any) -> str:
    """Of all numbers in scenarios and drivers: whoever has the same ones has the same 16 letters."""
    import jax
    import numpy as np

    digest = hashlib.sha256()
    for leaf in jax.tree.leaves(trees):
        values = np.asarray(leaf)
        digest.update(f"{values.dtype}{values.shape}".encode() + values.tobytes())
    return digest.hexdigest()[:16]
