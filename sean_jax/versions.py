"""Versions and fingerprints: what a run, a dataset or a network was made with."""

import contextlib
import hashlib
import importlib.metadata
import platform
import sys
from collections.abc import Mapping
from typing import Any

PACKAGES = ("sean-jax", "jax", "jaxlib", "flax", "optax", "mujoco", "mujoco-mjx", "numpy", "tensorstore", "pedpy")


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that results depend on.

    Returns:
        Name to version, without packages that are not installed; a checkout says its own.
    """
    own = sys.modules[__name__.partition(".")[0]].__version__
    found = {"python": platform.python_version(), "sean-jax": own}
    for package in PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[package] = importlib.metadata.version(package)
    return found


def version_mismatch(saved: Any) -> str | None:
    """Compare saved versions with the current ones.

    Args:
        saved: a mapping as of ``versions``, from a file; anything else mismatches in nothing.

    Returns:
        The first difference in words, such as "jax 0.9.0, not 0.10.0"; None if all that both know are equal.
    """
    for name, version in versions().items() if isinstance(saved, Mapping) else ():
        if saved.get(name, version) != version:
            return f"{name} {saved[name]}, not {version}"
    return None


def fingerprint(*trees: Any) -> str:
    """A digest of all numbers in pytrees, such as scenarios and the parameters of policies.

    Returns:
        16 letters, equal for equal shapes, types and numbers.
    """
    import jax
    import numpy as np

    digest = hashlib.sha256()
    for leaf in jax.tree.leaves(trees):
        values = np.asarray(leaf)
        digest.update(f"{values.dtype}{values.shape}".encode() + values.tobytes())
    return digest.hexdigest()[:16]
