"""Configuration of XLA by the command line, before JAX is imported. Settings of the user's stay as they are."""

import importlib.metadata
import os

from sean_jax import cache

LOOPS = "--xla_cpu_use_fusion_emitters"  # a flag of jaxlib 0.10; later versions refuse it


def configure() -> None:
    """Set the environment variables of JAX's compilation cache, and a flag of XLA.

    Programs are cached in the user's cache folder. Loops for a CPU are emitted by the older of two emitters, which
    compiles the step in two thirds of the time, to a program that is as fast.
    """
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache.folder() / "xla"))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")
    flags = os.environ.get("XLA_FLAGS", "")
    if importlib.metadata.version("jaxlib").startswith("0.10.") and LOOPS not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {LOOPS}=false".strip()
