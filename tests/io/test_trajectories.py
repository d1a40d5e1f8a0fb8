"""Trajectories in files: what is read is what was saved, and other programs read it too."""

import csv
import re
from typing import Any

import jax
import numpy as np
import pytest

from sean_jax.config import RunConfig
from sean_jax.core.data_types import Trajectory
from sean_jax.core.errors import FileError, InputError
from sean_jax.io.files.reading import MAX_BYTES
from sean_jax.io.trajectories import BLOCK_ROWS, COLUMNS, load_trajectory, save_trajectory, trajectory_writer

NAMES = ("cross_path", "down_path", "mine")


def random_trajectory(
    seed: int, episodes: int | None, steps: int | None = None, people: int | None = None
) -> Trajectory:
    """Frames of people who come and go; those who are absent are at (0, 0)."""
    random = np.random.default_rng(seed)
    steps = int(random.integers(1, 9)) if steps is None else steps
    people = int(random.integers(0, 4)) if people is None else people
    lead = (steps,) if episodes is None else (episodes, steps)

    def floats(*shape):
        return (random.uniform(-1, 1, (*lead, *shape)) * 10.0 ** random.integers(-3, 5)).astype(np.float32)

    def headings(*shape):
        angle = random.uniform(-np.pi, np.pi, (*lead, *shape))
        return np.stack([np.cos(angle), np.sin(angle)], -1).astype(np.float32)

    present = random.uniform(size=(*lead, people)) < 0.7
    there = present[..., None]
    arrays: Any = dict(
        position=floats(2), heading=headings(), velocity=floats(2), action=floats(2),
        people=np.where(there, floats(people, 2), np.float32(0)),
        people_velocity=np.where(there, floats(people, 2), np.float32(0)),
        people_heading=np.where(there, headings(people), np.float32(0)),
        group=np.where(present, random.integers(-1, 3, (*lead, people)), -1).astype(np.int32),
        present=present, goal=floats(2), situations=random.uniform(size=(*lead, 3)) < 0.5,
        active=random.uniform(size=lead) < 0.9,
    )  # fmt: skip
    return Trajectory(**arrays)


def check_equal(found: Trajectory, given: Trajectory) -> None:
    for name, values in vars(given).items():
        got = getattr(found, name)
        if values is None:
            assert got is None, name
            continue
        assert got.shape == values.shape and got.dtype == values.dtype, name
        np.testing.assert_array_equal(got, values, err_msg=name)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("episodes", [None, 1, 3])
@pytest.mark.parametrize("seed", range(4))
def test_what_is_read_is_what_was_saved(tmp_path, suffix, episodes, seed):
    if suffix == ".parquet":
        pytest.importorskip("pyarrow")
    given = random_trajectory(seed, episodes)
    path = tmp_path / f"walk{suffix}"
    save_trajectory(given, path, time_step=0.2, situations=NAMES)
    check_equal(load_trajectory(path), given)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_what_an_episode_of_a_default_run_writes_is_read(tmp_path, suffix):
    """1,800 frames with 50 people, in more rows than are read at once: above what a file of people's own may have."""
    if suffix == ".parquet":
        pytest.importorskip("pyarrow")
    config = RunConfig()
    given = random_trajectory(0, 1, round(config.time_limit / 0.1), 100)
    path = tmp_path / f"walk{suffix}"
    with trajectory_writer(path, situations=NAMES, people=100, steps=10_000) as writer:
        writer.add(jax.tree.map(lambda leaf: leaf[0], given))
    assert path.stat().st_size > MAX_BYTES and given.present.sum() > BLOCK_ROWS
    check_equal(load_trajectory(path), given)


def test_a_trajectory_is_a_table_for_other_programs(tmp_path):
    """A row for the robot and for each person in each frame, in the columns that are documented."""
    frames = random_trajectory(0, None, steps=5, people=3)
    frames.present[:] = True
    save_trajectory(frames, tmp_path / "walk.csv", time_step=0.1, situations=NAMES)
    text = (tmp_path / "walk.csv").read_text().splitlines()
    assert text[0].startswith("# sean_jax {")
    rows = list(csv.DictReader(text[1:]))
    documented = [name for name in COLUMNS if name not in ("episode", "command_left", "situation_NAME")]
    assert list(rows[0]) == [*documented, *(f"situation_{name}" for name in NAMES)]
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


HEAD = '# sean_jax {"time_step": 0.1, "situations": [], "people": 1}'
NAMED = "frame,time,id,x,y,vx,vy,heading_x,heading_y,group,goal_x,goal_y,command_speed,command_turn_rate,active"
ROBOTS = "0,0.1,-1,1,2,0,0,1,0,-1,5,5,0,0,1"
PERSONS = "0,0.1,0,3,4,0,0,1,0,-1,,,,,"
GOOD = f"{HEAD}\n{NAMED}\n{ROBOTS}\n{PERSONS}\n"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (GOOD, "", "does not begin with '# sean_jax '"),
        (HEAD, "", "does not begin with '# sean_jax '"),
        (HEAD, "# sean_jax {", "its header is damaged"),
        (HEAD, "# sean_jax " + "[" * 100_000, "its header is damaged"),
        ('"people": 1', '"people": 4000000000', "people: 4000000000 is more than 100000"),
        ('"people": 1', '"people": 0', "id: 0 is none of the 0 people"),
        ('"people": 1', '"people": 99999999999999999999', "people: "),
        ('"time_step": 0.1', '"time_step": NaN', "its header is damaged: NaN is not JSON"),
        ('"time_step": 0.1', '"time_step": 0.2', "time: 0.1 does not match its frame"),
        ('"situations": []', '"situations": ["a"]', "has no column situation_a"),
        (PERSONS, "0,0.1,0,3", "walk.csv:4: has 4 cells and there are 15 columns"),
        (",group,", ",gruop,", "has no column group"),
        (",group,", ",x,", "names a column twice"),
        ("frame,", '"frame,', "is no row of CSV"),
        (",3,4,", ",three,4,", "row 2: 'three' is no number"),
        (",3,4,", ",1_0,4,", "row 2: '1_0' is no number"),
        (",3,4,", ",nan,4,", "row 2: x: nothing is not from -10,000.0 to 10,000.0"),
        (",3,4,", ",inf,4,", "row 2: x: inf is not"),
        (",3,4,", ",1e39,4,", "row 2: x: 1e\\+39 is not"),
        (",3,4,0,0,1,0", ",3,4,0,0,2,0", "row 2: heading_x: 2 belongs to no unit vector"),
        (",3,4,0,0,1,0,-1", ",3,4,0,0,1,0,-2", "row 2: group: -2 is not"),
        ("0,0.1,0,", "0,0.1,1e9,", "row 2: id: 1e\\+09 is not"),
        ("0,0.1,0,", "0,0.1,0.5,", "row 2: id: 0.5 is no whole number"),
        ("0,0.1,0,", "0,0.1,1,", "id: 1 is none of the 1 people"),
        ("0,0.1,0,", "1,0.2,0,", "2 rows lack one of the robot"),
        ("0,0.1,-1,", "1,0.2,-1,", "2 rows lack one of the robot"),
        ("0,0.1,-1,", "99999999,10000000,-1,", "2 rows are too few for 1 episodes of 100,000,000 frames with 1 people"),
        (PERSONS, f"{PERSONS}\n{PERSONS}", "3 rows have a person twice"),
        (",5,5,0,0,1", ",5,5,0,0,2", "row 1: active: 2 is not 0 or 1"),
        (",5,5,0,0,1", ",5,,0,0,1", "row 1: goal_y: nothing is not"),
        (",,,,,", ",,,,,1", "row 2: active: 1 stands in the row of a person"),
        (f"{ROBOTS}\n{PERSONS}\n", "", "holds no frame"),
        ("0.1,-1", "0.1," + "9" * 2_000_000, "more than 1,000,000 characters"),
        ("0.1,-1", "0.1," + "9" * 200_000, "is no row of CSV"),
        ("0.1,-1", "0.1,\x00", "is no number"),
    ],
)
def test_a_csv_that_is_not_what_was_saved_is_refused_in_a_sentence(tmp_path, old, new, words):
    path = tmp_path / "walk.csv"
    path.write_text(GOOD)
    assert load_trajectory(path).people.shape == (1, 1, 2)
    assert GOOD.count(old) >= 1
    path.write_text(GOOD[: GOOD.rindex(old)] + new + GOOD[GOOD.rindex(old) + len(old) :])
    with pytest.raises(FileError, match=words) as refused:
        load_trajectory(path)
    assert str(refused.value).startswith(f"{tmp_path.name}/walk.csv") and "\n" not in str(refused.value)


def test_bad_files_are_refused_in_a_sentence(tmp_path):
    given = random_trajectory(0, None)
    with pytest.raises(InputError, match="must end in .csv, .parquet"):
        save_trajectory(given, tmp_path / "walk.zarr")
    with pytest.raises(InputError, match="2 names for 3 situations"):
        save_trajectory(given, tmp_path / "walk.csv", situations=("a", "b"))
    for path in ("walk.csv", "walk.parquet"):
        with pytest.raises(InputError, match="there is no such file"):
            load_trajectory(tmp_path / path)
    wrong = Trajectory(**{**vars(given), "velocity": np.full_like(given.velocity, np.nan)})
    with pytest.raises(InputError, match="row 1: vx: nothing is not from"):
        save_trajectory(wrong, tmp_path / "walk.csv")
    assert not list(tmp_path.iterdir())


def test_a_parquet_that_is_not_what_was_saved_is_refused_in_a_sentence(tmp_path):
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "walk.parquet"
    save_trajectory(random_trajectory(2, 3), path, situations=NAMES)
    table = pq.read_table(path)
    header = table.schema.metadata

    def refused(made: Any, words: str) -> None:
        pq.write_table(made, path)
        with pytest.raises(FileError, match=words):
            load_trajectory(path)

    refused(table.replace_schema_metadata({}), "its header is damaged")
    refused(table.replace_schema_metadata({b"sean_jax": b"[1]"}), "is not a mapping")
    refused(table.drop_columns(["x"]), "has no column x")
    refused(table.set_column(4, "x", pa.array(["a"] * len(table))), "'x' is no column of numbers")
    refused(table.append_column("x", table["x"]), "names a column twice")
    zeros = {name: np.zeros(5_000_000, np.int32) for name in table.column_names}
    refused(pa.table(zeros).replace_schema_metadata(header), "5,000,000 rows in .* bytes are too many")
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(FileError, match="is damaged; give a file that save_trajectory has written"):
        load_trajectory(path)


@pytest.mark.night
def test_what_the_largest_run_of_the_docs_writes_is_read(tmp_path):
    """64 episodes of the default length, as `sean run --trajectories csv` writes them: about 400 MB."""
    config = RunConfig()
    given = random_trajectory(0, 1, round(config.time_limit / 0.1), 60)
    path = tmp_path / "walk.csv"
    with trajectory_writer(path, situations=NAMES, people=60, steps=10_000) as writer:
        writer.add(jax.tree.map(lambda leaf: leaf[0], given))
    head, names, rows = path.read_text().split("\n", 2)
    with path.open("w") as stream:  # which is quicker than to write so many numbers
        stream.write(f"{head}\n{names}\n")
        for episode in range(config.episodes):
            stream.write(re.sub("(?m)^0,", f"{episode},", rows))
    assert path.stat().st_size > 300e6
    found = load_trajectory(path)
    check_equal(found, jax.tree.map(lambda leaf: np.repeat(leaf, config.episodes, 0), given))


def test_a_writer_that_fails_leaves_an_earlier_file(tmp_path):
    path = tmp_path / "walk.csv"
    path.write_text("kept")
    with pytest.raises(RuntimeError), trajectory_writer(path, situations=[], people=2, steps=3):
        raise RuntimeError
    assert path.read_text() == "kept" and list(tmp_path.iterdir()) == [path]


def test_who_comes_in_where_somebody_has_left_is_another_person(tmp_path):
    """Tracks of one id have no gaps, so speeds over gaps are of nobody; loaded, all are where they were."""
    frames = random_trajectory(3, None, steps=6, people=2)
    frames.present[:] = [[1, 0], [1, 0], [0, 1], [1, 1], [1, 0], [1, 1]]
    save_trajectory(frames, tmp_path / "walk.csv", situations=NAMES)
    text = (tmp_path / "walk.csv").read_text()
    rows = list(csv.DictReader(text.splitlines()[1:]))
    ids = [[int(row["id"]) for row in rows if row["frame"] == str(t) and row["id"] != "-1"] for t in range(6)]
    assert ids == [[0], [0], [1], [2, 1], [2], [2, 3]]
    np.testing.assert_array_equal(load_trajectory(tmp_path / "walk.csv").present, frames.present)
    lines = text.splitlines()
    cells = lines[-1].split(",")
    column = lines[1].split(",").index("id")
    assert cells[column] == "3"
    cells[column] = "5"
    (tmp_path / "walk.csv").write_text("\n".join([*lines[:-1], ",".join(cells)]) + "\n")
    with pytest.raises(InputError, match="frame 5: id: 5 is none of the 2 people, nor of those who have come in"):
        load_trajectory(tmp_path / "walk.csv")
