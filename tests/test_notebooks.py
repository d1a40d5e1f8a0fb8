"""Notebooks run from top to bottom, are what their sources say, and are kept without outputs."""

import re
from pathlib import Path

import jupytext
import nbformat
import pytest

FOLDER = Path(__file__).resolve().parent.parent / "notebooks"
SOURCES = sorted(FOLDER.glob("*.py"))
SMALL = {"PEOPLE": 8, "EPISODES": 2, "STEPS": 20}
SMALL_TOO = {"MINUTES": 2, "EPOCHS": 2, "UPDATES": 2}  # of some notebooks


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


@pytest.mark.slow
@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)
def test_notebook_runs(source, tmp_path):
    from nbclient import NotebookClient

    notebook = nbformat.read(source.with_suffix(".ipynb"), as_version=4)
    for cell in notebook.cells:
        for name, value in (SMALL | SMALL_TOO).items():
            cell.source = re.sub(rf"^{name} = \d+", f"{name} = {value}", cell.source, flags=re.M)
    text = "\n".join(source for _, source in cells(notebook))
    assert all(f"\n{name} = {value}" in text for name, value in SMALL.items())
    NotebookClient(notebook, timeout=600, kernel_name="python3", resources={"metadata": {"path": tmp_path}}).execute()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert any("image/png" in output.get("data", {}) for output in outputs), "no picture"
    printed = "".join(output.get("text", "") for output in outputs)
    assert not re.search(r"\b(nan|inf)\b", printed)
