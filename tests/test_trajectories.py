"""Trajectories in files: what is read is what was saved, and other programs read it too."""

import csv
from typing import Any

import jax
import numpy as np
import pytest

import sean_jax
from sean_jax.base import Trajectory
from sean_jax.errors import InputError
from sean_jax.trajectories import COLUMNS, load_trajectory, save_trajectory, trajectory_writer

NAMES = ("cross_path", "down_path", "mine")


def random_trajectory(seed: int, episodes: int | None) -> Trajectory:
    """Frames of people who come and go; those who are absent are at (0, 0)."""
    random = np.random.default_rng(seed)
    lead = (int(random.integers(1, 9)),) if episodes is None else (episodes, int(random.integers(1, 9)))
    people = int(random.integers(0, 4))

    def floats(*shape):
        return random.normal(0, 10.0 ** random.integers(-3, 4), (*lead, *shape)).astype(np.float32)

    present = random.uniform(size=(*lead, people)) < 0.7
    there = present[..., None]
    arrays: Any = dict(
        position=floats(2), heading=floats(2), velocity=floats(2), action=floats(2),
        people=np.where(there, floats(people, 2), np.float32(0)),
        people_velocity=np.where(there, floats(people, 2), np.float32(0)),
        people_heading=np.where(there, floats(people, 2), np.float32(0)),
        group=np.where(present, random.integers(-1, 3, (*lead, people)), -1).astype(np.int32),
        present=present, goal=floats(2), situations=random.uniform(size=(*lead, 3)) < 0.5,
        active=random.uniform(size=lead) < 0.9,
    )  # fmt: skip
    return Trajectory(**arrays)


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".zarr"])
@pytest.mark.parametrize("episodes", [None, 1, 3])
@pytest.mark.parametrize("seed", range(4))
def test_what_is_read_is_what_was_saved(tmp_path, suffix, episodes, seed):
    if suffix == ".parquet":
        pytest.importorskip("pyarrow")
    if suffix == ".zarr":
        pytest.importorskip("tensorstore")
    given = random_trajectory(seed, episodes)
    path = tmp_path / f"walk{suffix}"
    save_trajectory(given, path, time_step=0.2, situations=NAMES)
    found = load_trajectory(path)
    for name, values in vars(given).items():
        got = getattr(found, name)
        assert got.shape == values.shape and got.dtype == values.dtype, name
        np.testing.assert_array_equal(got, values, err_msg=name)


def test_a_rollout_is_a_table_for_other_programs(tmp_path):
    """A row for the robot and for each person in each frame, in the columns that are documented."""
    scenario = sean_jax.make("lab", people=3, dynamics="twin")
    policy = sean_jax.POLICIES["go_to_goal"]
    _, frames = jax.jit(lambda key: sean_jax.rollout(scenario, policy, key, steps=5))(jax.random.key(0))
    names = [name for name, _ in scenario.situations]
    sean_jax.save_trajectory(frames, tmp_path / "walk.csv", time_step=scenario.time_step, situations=names)
    text = (tmp_path / "walk.csv").read_text().splitlines()
    assert text[0].startswith("# sean_jax {")
    rows = list(csv.DictReader(text[1:]))
    documented = [name for name in COLUMNS if name not in ("episode", "situation_NAME")]
    assert list(rows[0]) == [*documented, *(f"situation_{name}" for name in names)]
    assert len(rows) == 5 * 4 and [row["id"] for row in rows[:4]] == ["-1", "0", "1", "2"]
    for row in rows:
        t, who = int(row["frame"]), int(row["id"])
        place = frames.position[t] if who < 0 else frames.people[t, who]
        assert float(row["time"]) == pytest.approx(0.1 * (t + 1))
        np.testing.assert_array_equal(np.asarray([row["x"], row["y"]], np.float32), place)
        assert (row["goal_x"] == "") == (who >= 0)
    pandas = pytest.importorskip("pandas")
    table = pandas.read_csv(tmp_path / "walk.csv", comment="#")
    assert len(table) == 20 and table[table.id >= 0].goal_x.isna().all()


def test_pedpy_takes_the_people(tmp_path):
    pedpy, pandas = pytest.importorskip("pedpy"), pytest.importorskip("pandas")
    save_trajectory(random_trajectory(1, None), tmp_path / "walk.csv", situations=NAMES)
    table = pandas.read_csv(tmp_path / "walk.csv", comment="#")
    people = table[table.id >= 0][["id", "frame", "x", "y"]]
    data = pedpy.TrajectoryData(people, frame_rate=10.0)
    assert len(data.data) == len(people)


def test_bad_files_are_refused_in_a_sentence(tmp_path):
    given = random_trajectory(0, None)
    with pytest.raises(InputError, match="must end in .csv, .parquet, .zarr"):
        save_trajectory(given, tmp_path / "walk.json")
    with pytest.raises(InputError, match="2 names for 3 situations"):
        save_trajectory(given, tmp_path / "walk.csv", situations=("a", "b"))
    with pytest.raises(InputError, match="there is no such file"):
        load_trajectory(tmp_path / "walk.csv")
    for text, said in (
        ("", "other numbers of cells"),
        ("frame,id\n1\n", "other numbers of cells"),
        ("frame,id\n1,2\n", "has no column group"),
        ("frame,id\n1,you\n", "could not convert"),
        ("# sean_jax {\nframe,id\n", "first line is damaged"),
    ):
        (tmp_path / "bad.csv").write_text(text)
        with pytest.raises(InputError, match=said):
            load_trajectory(tmp_path / "bad.csv")
    (tmp_path / "half.zarr").mkdir()
    with pytest.raises(InputError, match="holds no zarr.json"):
        load_trajectory(tmp_path / "half.zarr")


def test_a_writer_that_fails_leaves_an_earlier_folder_of_zarr(tmp_path):
    pytest.importorskip("tensorstore")
    path = tmp_path / "walk.zarr"
    path.mkdir()
    (path / "earlier").write_text("kept")
    with pytest.raises(RuntimeError), trajectory_writer(
        path, situations=[], people=2, steps=3, count=1
    ):  # fmt: skip
        raise RuntimeError
    assert (path / "earlier").read_text() == "kept" and list(tmp_path.iterdir()) == [path]
