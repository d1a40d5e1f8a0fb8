"""Notebooks run from top to bottom, assert what they say, and are kept without outputs."""

import base64
import io
import re
import subprocess
import sys
import types
from pathlib import Path

import nbformat
import numpy as np
import pytest
from PIL import Image

from support.checkout import ROOT

pytestmark = pytest.mark.form
FOLDER = ROOT / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
each_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
INSTALL = "On Colab, clone the repository first; the next cell then installs it."


def read(path: Path) -> nbformat.NotebookNode:
    return nbformat.read(path, as_version=4)


def code_cells(path: Path) -> list[str]:
    """Texts of the cells with code, lines of IPython as comments."""
    return [re.sub(r"^%", "# %", cell.source, flags=re.M) for cell in read(path).cells if cell.cell_type == "code"]


@each_notebook
def test_it_is_kept_without_outputs(path):
    notebook = read(path)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert 0 < len(code) < 15
    assert all(not cell.outputs and cell.execution_count is None for cell in code), f"clear the outputs of {path.name}"


@each_notebook
def test_first_cell_installs_on_colab_and_there_alone(path, monkeypatch):
    first, *others = code_cells(path)
    assert INSTALL in read(path).cells[0].source
    calls = []
    monkeypatch.setattr(subprocess, "run", lambda command, check: calls.append((command, check)))
    exec(first, {})
    assert not calls
    monkeypatch.setitem(sys.modules, "google.colab", types.ModuleType("google.colab"))
    exec(first, {})
    ((command, check),) = calls
    assert check and command[:4] == [sys.executable, "-m", "pip", "install"]
    (package,) = (word for word in command if word.startswith("./sean_jax") and "constraints" not in word)
    needs_learning = any("import" in line and "learning" in line for cell in others for line in cell.splitlines())
    assert package == ("./sean_jax[learning]" if needs_learning else "./sean_jax")
    assert (
        command[command.index("-c") + 1] == "./sean_jax/constraints.txt"
        and (FOLDER.parent / "constraints.txt").exists()
    )


@each_notebook
def test_compiled_programs_are_kept_from_the_start(path):
    text = "\n".join(code_cells(path))
    assert 0 < text.index("\nxla_flags.configure()") < text.index("\nimport jax")


def test_every_page_is_in_the_readme():
    readme = (FOLDER.parent / "README.md").read_text()
    assert re.findall(r"\(notebooks/(\w+)\.ipynb\)", readme) == [path.stem for path in NOTEBOOKS]


def test_every_notebook_asserts_what_it_says():
    for path in NOTEBOOKS:
        assert re.search(r"^ *assert ", "\n".join(code_cells(path)), re.M), (
            f"{path.name}: no statement of it is checked"
        )


@pytest.mark.night
def test_constants_of_a_crowd_are_recovered():
    """Notebook 5 at full size, as far as its headline."""
    (path,) = FOLDER.glob("5_*.ipynb")
    text = "\n".join(code_cells(path))
    headline = text[: text.index("figure, (left, right)")]
    assert "the constants were not recovered" in headline
    exec(headline.replace("compiler.configure()", ""), {})


@pytest.mark.night
@each_notebook
def test_notebook_runs_and_its_statements_hold(path, tmp_path):
    """At full size: each notebook asserts what it says."""
    from nbclient import NotebookClient

    notebook = read(path)
    NotebookClient(notebook, timeout=1200, kernel_name="python3", resources={"metadata": {"path": tmp_path}}).execute()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    pictures = [output.data["image/png"] for output in outputs if "image/png" in output.get("data", {})]
    assert len(set(pictures)) >= 2, "fewer than two pictures"
    for data in pictures:
        image = np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"))
        assert min(image.shape[:2]) > 100 and len(np.unique(image.reshape(-1, 3), axis=0)) > 4, "an empty picture"
    printed = "".join(output.get("text", "") for output in outputs)
    assert not re.search(r"\b(nan|inf)\b", printed)
