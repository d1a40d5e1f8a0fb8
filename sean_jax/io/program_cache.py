"""JAX's cache of compiled programs in the user's cache folder: a program is compiled once for all processes."""

import os
from pathlib import Path

from sean_jax.io import cache

MIN_COMPILE_TIME = 0.2  # s, of a program that is kept in Python; the command line keeps all
JAX_MIN_COMPILE_TIME = 1.0  # s, JAX's own default
TIME_SETTING = "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"


def folder() -> Path:
    """The folder of compiled programs, which need not exist."""
    return cache.folder() / "xla"


def keep_programs() -> None:
    """Let JAX keep compiled programs in ``folder``, unless the user has set one or has turned the cache off.

    ``jax.config.update("jax_enable_compilation_cache", False)`` turns it off.
    """
    import jax  # here, for the command line configures XLA before it is imported

    has_folder = jax.config.values["jax_compilation_cache_dir"] is not None
    is_on = jax.config.values["jax_enable_compilation_cache"]
    if has_folder or not is_on or not _can_write(folder()):
        return
    jax.config.update("jax_compilation_cache_dir", str(folder()))
    is_default = jax.config.values[TIME_SETTING.lower()] == JAX_MIN_COMPILE_TIME
    if is_default and TIME_SETTING not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", MIN_COMPILE_TIME)

    # JAX has decided against a cache when the user's first program was compiled.
    from jax.experimental.compilation_cache import compilation_cache

    compilation_cache.reset_cache()


def _can_write(path: Path) -> bool:
    """Whether a folder exists or can be made, and can be written to: or JAX would warn at each program."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(path, os.W_OK)
