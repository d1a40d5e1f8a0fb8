"""What a run, a dataset or a network was made with."""

import contextlib
import importlib.metadata
import platform

PACKAGES = ("sean-jax", "jax", "jaxlib", "flax", "optax", "mujoco", "mujoco-mjx", "numpy", "tensorstore")


def versions() -> dict[str, str]:
    """Name to version."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[package] = importlib.metadata.version(package)
    return found
