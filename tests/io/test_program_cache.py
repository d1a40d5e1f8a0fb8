"""Compiled programs are kept for Python users, never over a setting of theirs."""

import json
import os
import subprocess
import sys

import pytest

PROGRAM = """
import json, os, sys, jax
{before}
jax.jit(lambda x: x + 1)(1.0)  # the user's own program comes first
import sean_jax
sean_jax.make("lab", people=2)
jax.jit(lambda x: jax.numpy.sin(x).sum())(jax.numpy.ones(3))
names = "jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs"
print(json.dumps([getattr(jax.config, name) for name in names]))
"""


def run(tmp_path, before="", **environment):
    """The folder and the least time of JAX's cache after ``make``, and the number of programs kept there."""
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    settings = {**inherited, "XDG_CACHE_HOME": str(tmp_path / "home"), **environment}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(before=before)], env=settings, capture_output=True, text=True, check=True
    )
    assert "Error" not in done.stderr and "writing" not in done.stderr
    folder, least = json.loads(done.stdout.splitlines()[-1])
    kept = sum(1 for name in os.listdir(folder) if name.endswith("-cache")) if folder and os.path.isdir(folder) else 0
    return folder, least, kept


def test_programs_are_kept_without_being_asked(tmp_path):
    folder, least, kept = run(tmp_path, JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS="0")
    assert folder == str(tmp_path / "home" / "sean_jax" / "xla") and least == 0.0 and kept > 0


def test_the_users_least_time_stays(tmp_path):
    _, least, _ = run(tmp_path, "jax.config.update('jax_persistent_cache_min_compile_time_secs', 7.0)")
    assert least == 7.0


@pytest.mark.parametrize(
    "before, environment, expected",
    [
        ("jax.config.update('jax_compilation_cache_dir', '{own}')", {}, "{own}"),
        ("", {"JAX_COMPILATION_CACHE_DIR": "{own}"}, "{own}"),
        ("jax.config.update('jax_enable_compilation_cache', False)", {}, None),
        ("", {"XDG_CACHE_HOME": "/dev/null"}, None),
    ],
    ids=["own folder", "own variable", "turned off", "no folder"],
)
def test_the_users_settings_stay(tmp_path, before, environment, expected):
    own = str(tmp_path / "own")
    environment = {name: value.format(own=own) for name, value in environment.items()}
    folder, _, _ = run(tmp_path, before.format(own=own), **environment)
    assert folder == (expected and expected.format(own=own))
