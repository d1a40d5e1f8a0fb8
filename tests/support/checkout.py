"""The checkout: its root, what tests read from files, and the programs of ``benchmarks/``."""

import functools
import importlib
import subprocess
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]
WEB = ROOT / "web"
DATA = Path(__file__).with_name("data")


@functools.cache
def benchmark(name: str) -> ModuleType:
    """A program of ``benchmarks/``; while it is imported it finds its neighbors, as when Python runs it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "benchmarks")
        return importlib.import_module(name)


def repository_files() -> list[Path]:
    """All files that git tracks or would track."""
    done = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard", "-z"], capture_output=True, text=True, cwd=ROOT, check=False
    )
    if done.returncode != 0:
        pytest.skip("not a git checkout")
    return [ROOT / name for name in done.stdout.split("\0") if name and (ROOT / name).is_file()]
