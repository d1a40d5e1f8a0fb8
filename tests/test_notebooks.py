"""Notebooks run from top to bottom, are what their sources say, and are kept without outputs."""

import base64
import io
import re
import subprocess
import sys
import types

import jupytext
import nbformat
import numpy as np
import pytest
from PIL import Image

from support.checkout import ROOT

FOLDER = ROOT / "notebooks"
SOURCES = sorted(FOLDER.glob("*.py"))
INSTALL = "On Colab, clone the repository first; the next cell then installs it."


def cells(notebook) -> list[tuple[str, str]]:
    return [(cell.cell_type, cell.source) for cell in notebook.cells]


def test_every_notebook_has_a_source():
    assert SOURCES and {path.stem for path in SOURCES} == {path.stem for path in FOLDER.glob("*.ipynb")}


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)
def test_notebook_equals_its_source_and_has_no_outputs(source):
    notebook = nbformat.read(source.with_suffix(".ipynb"), as_version=4)
    nbformat.validate(notebook)
    assert cells(notebook) == cells(jupytext.read(source)), f"run: jupytext --update --to ipynb notebooks/{source.name}"
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert 0 < len(code) < 15
    assert all(not cell.outputs and cell.execution_count is None for cell in code)


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)
def test_first_cell_installs_on_colab_and_there_alone(source, monkeypatch):
    first = next(cell.source for cell in jupytext.read(source).cells if cell.cell_type == "code")
    assert INSTALL in jupytext.read(source).cells[0].source
    calls = []
    monkeypatch.setattr(subprocess, "run", lambda command, check: calls.append((command, check)))
    exec(first, {})
    assert not calls
    monkeypatch.setitem(sys.modules, "google.colab", types.ModuleType("google.colab"))
    exec(first, {})
    ((command, check),) = calls
    assert check and command[:4] == [sys.executable, "-m", "pip", "install"]
    (package,) = (word for word in command if word.startswith("./sean_jax") and "constraints" not in word)
    needs_learning = "learning" in "".join(line for line in source.read_text().splitlines() if "import" in line)
    assert package == ("./sean_jax[learning]" if needs_learning else "./sean_jax")
    assert (
        command[command.index("-c") + 1] == "./sean_jax/constraints.txt"
        and (FOLDER.parent / "constraints.txt").exists()
    )


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)
def test_compiled_programs_are_kept_from_the_start(source):
    text = source.read_text()
    assert 0 < text.index("\ncompiler.configure()") < text.index("\nimport jax")


def test_every_page_is_in_the_readme():
    readme = (FOLDER.parent / "README.md").read_text()
    assert re.findall(r"\(notebooks/(\w+)\.ipynb\)", readme) == [path.stem for path in SOURCES]


def test_every_notebook_asserts_what_it_says():
    for source in SOURCES:
        assert re.search(r"^ *assert ", source.read_text(), re.M), f"{source.name}: no statement of it is checked"


@pytest.mark.slow
def test_constants_of_a_crowd_are_recovered():
    """Notebook 5 at full size, as far as its headline."""
    (source,) = FOLDER.glob("5_*.py")
    text = source.read_text()
    headline = text[: text.index("figure, (left, right)")]
    assert "the constants were not recovered" in headline
    exec(headline.replace("compiler.configure()", ""), {})


@pytest.mark.night
@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)
def test_notebook_runs_and_its_statements_hold(source, tmp_path):
    """At full size: each notebook asserts what it says."""
    from nbclient import NotebookClient

    notebook = nbformat.read(source.with_suffix(".ipynb"), as_version=4)
    NotebookClient(notebook, timeout=1200, kernel_name="python3", resources={"metadata": {"path": tmp_path}}).execute()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    pictures = [output.data["image/png"] for output in outputs if "image/png" in output.get("data", {})]
    assert len(set(pictures)) >= 2, "fewer than two pictures"
    for data in pictures:
        image = np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"))
        assert min(image.shape[:2]) > 100 and len(np.unique(image.reshape(-1, 3), axis=0)) > 4, "an empty picture"
    printed = "".join(output.get("text", "") for output in outputs)
    assert not re.search(r"\b(nan|inf)\b", printed)
