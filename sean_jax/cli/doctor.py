"""``sean doctor``: versions, devices and folders, and cures for slow or missing parts of this machine."""

import importlib.util
import os
import shutil
from collections import Counter
from pathlib import Path
from typing import NamedTuple

from sean_jax.core.errors import InputError
from sean_jax.io import cache, files
from sean_jax.io.versions import versions

EXTRAS = {
    "learning": "orbax.checkpoint",
    "lerobot": "pyarrow",
    "export": "onnx",
    "ros": "rosbags",
    "gymnasium": "gymnasium",
    "adapters": "brax",
    "stable-baselines3": "stable_baselines3",
    "notebooks": "ipykernel",
}
"""Extra -> a module that it brings."""

NVIDIA = Path("/proc/driver/nvidia/version")
LOW_MEMORY, LOW_DISK = 4.0, 2.0  # GB


class Finding(NamedTuple):
    """A fact about this machine."""

    what: str
    value: str
    cure: str = ""  # what to do; "" if nothing is wrong


def examine() -> list[Finding]:
    """Facts about this machine, in order of importance."""
    packages = [Finding(name, version) for name, version in versions().items()]
    return [*packages, _extras(), _devices(), *_machine(), _cache()]


def _extras() -> Finding:
    present = [extra for extra, module in EXTRAS.items() if importlib.util.find_spec(module.partition(".")[0])]
    missing = [extra for extra in EXTRAS if extra not in present]
    text = ", ".join(present) or "none"
    return Finding("extras", f"{text}; without {', '.join(missing)}" if missing else text)


def _devices() -> Finding:
    import jax

    try:
        devices = jax.devices()
    except RuntimeError as error:
        cure = "unset JAX_PLATFORMS, or set it to cpu"
        return Finding("devices", f"JAX finds none: {str(error).splitlines()[0]}", cure)
    kinds = Counter(device.device_kind for device in devices)
    text = ", ".join(f"{count} x {kind}" for kind, count in kinds.items())

    # A GPU without jax's plugin, or one that JAX_PLATFORMS excludes.
    cure = ""
    if jax.default_backend() == "cpu" and (NVIDIA.exists() or shutil.which("nvidia-smi")):
        cure = 'a GPU is here and JAX does not use it: pip install "sean_jax[cuda13]"'
        if platforms := os.environ.get("JAX_PLATFORMS", ""):
            cure = f"a GPU is here and JAX_PLATFORMS={platforms} keeps JAX from it: unset it"
    digits = f"{8 * jax.numpy.ones(()).dtype.itemsize} bits"
    return Finding("devices", f"{text} ({jax.default_backend()}), {digits}", cure)


def _machine() -> list[Finding]:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    findings = [Finding("cores", str(cores), "" if cores > 1 else "compiling takes twice as long on one core")]

    memory = _memory()
    if memory is not None:
        cure = f"compiling takes up to {LOW_MEMORY:.0f} GB; close other programs" if memory < LOW_MEMORY else ""
        findings.append(Finding("free memory", f"{memory:.1f} GB", cure))

    free = shutil.disk_usage(Path.cwd()).free / 1e9
    cure = "results may not fit; free some, or choose another disk with --out" if free < LOW_DISK else ""
    return [*findings, Finding("free disk", f"{free:.1f} GB here", cure)]


def _memory() -> float | None:
    """Free memory in GB; None if unknown."""
    try:
        lines = files.read_text(Path("/proc/meminfo")).splitlines()
        return next(float(line.split()[1]) / 1e6 for line in lines if line.startswith("MemAvailable"))
    except (InputError, OSError, StopIteration, ValueError, IndexError):
        return None


def _cache() -> Finding:
    folder = cache.folder()
    nearest = next(path for path in (folder, *folder.parents) if path.exists())
    if not os.access(nearest, os.W_OK):
        return Finding("cache", str(folder), "it cannot be written, so each start compiles anew: set XDG_CACHE_HOME")
    programs = [file for file in (folder / "xla").glob("*") if file.is_file()]
    if not programs:
        return Finding("cache", f"{folder}, empty: the first run of a kind compiles")
    size = sum(file.stat().st_size for file in programs) / 1e6
    return Finding("cache", f"{folder}, {len(programs)} compiled programs, {size:.0f} MB")
