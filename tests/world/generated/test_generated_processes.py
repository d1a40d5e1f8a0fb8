"""Other processes of the package import nothing of the current folder, and tell why they fail."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

from sean_jax.world import generated

PACKAGE = generated.PACKAGE.parent
STARTS = {
    ("subprocess", name)
    for name in ("run", "Popen", "call", "check_call", "check_output", "getoutput", "getstatusoutput")
} | {
    ("os", "system"),
    ("os", "popen"),
    ("os", "fork"),
    ("os", "posix_spawn"),
    ("runpy", "run_path"),
    ("runpy", "run_module"),
}
MODULES = ("multiprocessing", "pty", "concurrent.futures.process")


def starts(tree: ast.AST):
    """Calls and imports of a module that start a process or another program."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            place = (ast.unparse(node.func.value), node.func.attr)
            if place in STARTS or node.func.attr.startswith(("execv", "execl", "spawnv", "spawnl")):
                yield node
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import | ast.ImportFrom) else []
        names += [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
        if any(name.startswith(MODULES) or name == "ProcessPoolExecutor" for name in names):
            yield node


def test_one_place_starts_processes_and_keeps_the_current_folder_off_the_path():
    found = [
        (path.relative_to(PACKAGE).as_posix(), node)
        for path in sorted(PACKAGE.rglob("*.py"))
        for node in starts(ast.parse(path.read_text(encoding="utf-8")))
    ]
    assert [file for file, _ in found] == ["world/generated/__init__.py"]
    assert 'command = [sys.executable, "-P", ' in (PACKAGE / "world/generated/__init__.py").read_text(encoding="utf-8")


@pytest.fixture
def shared(tmp_path, monkeypatch):
    """A folder with modules that are called like Python's own, and work for two processes."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONPATH", raising=False)  # in which somebody may have named the current folder
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    for name in ("tempfile", "json", "shutil", "numpy", "sean_jax"):
        (tmp_path / f"{name}.py").write_text("open('ran', 'a').write(__name__ + ' ')\n")
    return [tmp_path / f"square_{number}" for number in range(2 * generated.SHARE)]


def test_modules_of_the_current_folder_are_not_imported(shared, capfd):
    """The function only prints its arguments, so that the test is quick; all modules of the package are imported."""
    generated.in_processes("sean_jax.world.generated", "print", [], shared)
    assert "has no attribute 'print'" in capfd.readouterr().err
    assert not Path("ran").exists()


def test_a_process_that_fails_says_why(shared, capfd):
    generated.in_processes("sean_jax.core.errors", "nothing", [], shared)
    said = capfd.readouterr().err
    assert said.count("\n") == 1
    assert "2 of 2 processes failed (AttributeError: module 'sean_jax.core.errors' has no attribute 'nothing'" in said


def test_a_program_with_the_current_folder_on_the_path_would_import_them(shared):
    """So that the tests above are none of nothing."""
    subprocess.run([sys.executable, "-c", "import tempfile"], check=False, capture_output=True)
    assert Path("ran").read_text() == "tempfile "
