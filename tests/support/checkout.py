"""The checkout: its root, what tests read from files, and the programs of ``benchmarks/``."""

import ast
import functools
import importlib.util
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


def callers(picks) -> set[str]:
    """FILE FUNCTION of each call in the package that ``picks`` picks; of a method also its class, of a module ""."""
    return {place for place, call in package_calls() if picks(call)}


@functools.cache
def package_calls() -> list[tuple[str, ast.Call]]:
    """All calls in the package, each with its FILE FUNCTION."""
    calls = []

    def visit(node: ast.AST, file: str, names: tuple[str, ...]) -> None:
        if isinstance(node, ast.Call):
            calls.append((f"{file} {'.'.join(names)}", node))
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            names = (*names, node.name)
        for child in ast.iter_child_nodes(node):
            visit(child, file, names)

    for path in sorted((ROOT / "sean_jax").rglob("*.py")):
        visit(ast.parse(path.read_text(encoding="utf-8")), path.relative_to(ROOT / "sean_jax").as_posix(), ())
    return calls


def module_of(path: Path) -> ModuleType:
    """A file that is in no package, as a module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made
