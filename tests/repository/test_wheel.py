"""The installed wheel works from an empty folder: what a user gets, not what a checkout happens to have."""

import zipfile
from pathlib import Path

import pytest

from support.checkout import ROOT
from support.commands import python

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """The wheel, built from the checkout without network access."""
    folder = tmp_path_factory.mktemp("wheel")
    python("-m", "build", "--wheel", "--no-isolation", "--outdir", folder, ROOT)
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory) -> Path:
    """A folder that holds the installed wheel and nothing else; its dependencies stay where they are."""
    target = tmp_path_factory.mktemp("installed")
    python("-m", "pip", "install", "--quiet", "--no-index", "--no-deps", "--target", target, wheel)
    return target


def environment(installed: Path) -> dict[str, str]:
    """Environment variables under which only the installed wheel is found."""
    return {"PYTHONPATH": str(installed)}


def test_wheel_holds_the_package_and_its_environments_and_no_more(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    data = {"environment.yaml", "scene.xml", "graph.yaml"}
    assert {f"sean_jax/envs/warehouse/{name}" for name in data} <= names
    assert {f"sean_jax/learning/agents/ppo/{name}" for name in ("config.json", "weights.npz")} <= names
    assert {"sean_jax/envs/robots/kuri.xml", "sean_jax/py.typed", "sean_jax/cli/command_line.py"} <= names
    files = [path for path in (ROOT / "sean_jax").rglob("*") if path.is_file() and path.suffix != ".pyc"]
    sources = {path.relative_to(ROOT).as_posix() for path in files}
    assert sources <= names
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"sean_jax"}
    assert not [name for name in names if "__pycache__" in name or "/tests/" in name]
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in names)


def test_installed_wheel_is_what_runs(installed, tmp_path):
    where = python("-c", "import sean_jax; print(sean_jax.__file__)", cwd=tmp_path, env=environment(installed))
    assert Path(where.strip()).is_relative_to(installed)
    listed = python("-m", "sean_jax", "list", cwd=tmp_path, env=environment(installed))
    for name in ("warehouse", "graph", "join_group", "leave_group", "kuri", "go_to_goal"):
        assert name in listed


def test_installed_wheel_runs_the_main_job_from_an_empty_folder(installed, tmp_path):
    command = "run", "--people", 8, "--episodes", 2, "--time-limit", 3
    python("-m", "sean_jax", *command, cwd=tmp_path, env=environment(installed))
    (folder,) = (tmp_path / "runs").iterdir()
    written = {path.name for path in folder.iterdir()}
    assert {"config.yaml", "episodes.csv", "summary.json", "report.html", "episode.gif"} <= written
    assert len((folder / "episodes.csv").read_text(encoding="utf-8").splitlines()) == 3
    assert [path.name for path in tmp_path.iterdir()] == ["runs"]
