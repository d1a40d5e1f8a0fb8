"""Configuration of XLA by the command line, before JAX is imported. The user's own settings stay."""

import importlib.metadata
import os

from sean_jax.io import program_cache

LOOPS = "--xla_cpu_use_fusion_emitters"  # a flag of jaxlib 0.10; later versions refuse it


def configure() -> None:
    """Set the environment variables of JAX's compilation cache, in the user's cache folder, and of XLA.

    The flag chooses the older of two emitters of loops for a CPU, which compiles the step in two thirds of the time, to
    an equally fast program. The log level keeps XLA's alarms off the terminal: a page of text, as an error, for each
    program that is slow to compile. Real failures are raised.
    """
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(program_cache.folder()))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")
    flags = os.environ.get("XLA_FLAGS", "")
    if importlib.metadata.version("jaxlib").startswith("0.10.") and LOOPS not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {LOOPS}=false".strip()
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
