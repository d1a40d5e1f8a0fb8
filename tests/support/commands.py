"""Programs that tests start in processes of their own, and waiting for what others do."""

import os
import subprocess
import sys
import time


def output(*command: object, env: dict[str, str] | None = None, **options) -> str:
    """What a program prints; if it fails the test does, with what both streams say. ``env`` is added to the usual."""
    words = [str(word) for word in command]
    options = {"timeout": 900, **options}
    done = subprocess.run(words, env={**os.environ, **(env or {})}, capture_output=True, text=True, **options)
    assert done.returncode == 0, f"{' '.join(words)[:500]}\n{done.stdout[-4000:]}\n{done.stderr[-4000:]}"
    return done.stdout


def python(*words: object, **options) -> str:
    """What this Python prints: of ``-c TEXT``, ``-m sean_jax ...`` or a file."""
    return output(sys.executable, *words, **options)


def cpu_devices(count: int, flags: str = "") -> dict[str, str]:
    """Variables with which JAX has so many CPU devices, and more flags of XLA."""
    return {"XLA_FLAGS": f"--xla_force_host_platform_device_count={count} {flags}", "JAX_PLATFORMS": "cpu"}


def wait(condition, seconds: float = 60.0) -> None:
    """Until the condition holds; the test fails where it does not in time."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"it does not happen within {seconds} s"
        time.sleep(0.005)
