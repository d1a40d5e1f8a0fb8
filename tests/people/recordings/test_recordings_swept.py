"""Lines and groups of recordings against plain loops, on drawn people, and each column's limits."""

from types import SimpleNamespace

import networkx
import numpy as np
import pytest

from sean_jax.core.errors import FileError
from sean_jax.people import recordings
from sean_jax.people.recordings import reading
from support.files import write

HEAD = "frame,id,x,y\n"


@pytest.mark.parametrize("seed", range(6))
def test_companions_are_connected_people(tmp_path, seed):
    """Lines that share a person are one group, named by its first column; whoever has no companion is alone."""
    random = np.random.default_rng(seed)
    numbers = random.choice(100, 12, replace=False)
    lines = [random.choice(numbers, random.integers(1, 4), replace=False) for _ in range(5)]
    graph = networkx.Graph()
    graph.add_nodes_from(range(12))
    for line in lines:
        columns = [numbers.tolist().index(number) for number in line]
        graph.add_edges_from((columns[0], column) for column in columns)
    expected = np.full(12, -1)
    for part in networkx.connected_components(graph):
        expected[list(part)] = min(part) if len(part) > 1 else -1
    file = write(tmp_path / "groups.txt", "\n\n".join(" ".join(map(str, line)) for line in lines) + "\n")
    tracks = SimpleNamespace(person=np.where(random.random((30, 12)) < 0.5, numbers, -1))
    tracks.person[random.integers(0, 30, 12), range(12)] = numbers
    found = recordings.read_companions(file, tracks)
    assert found.dtype == np.int32 and found.tolist() == expected.tolist()
    assert 1 < len(set(expected.tolist())), "drawn so that there are groups"


@pytest.mark.parametrize("seed", range(4))
def test_directions_are_those_of_the_last_motion(seed):
    random = np.random.default_rng(seed)
    velocity = random.normal(0.0, 1.0, (40, 2)) * (random.random((40, 1)) < 0.4)
    velocity[: random.integers(1, 5)] = 0.0
    fast = [k for k, one in enumerate(velocity) if np.hypot(*one) > recordings.STILL]
    found = recordings._last_directions(velocity)
    for k, direction in enumerate(found):
        latest = max((j for j in fast if j <= k), default=fast[0])
        np.testing.assert_allclose(direction, velocity[latest] / np.hypot(*velocity[latest]))
    np.testing.assert_array_equal(recordings._last_directions(np.zeros((3, 2))), [[1.0, 0.0]] * 3)


def test_labels_of_groups_begin_at_zero(tmp_path):
    """Each moment's groups are named by their first column; -1 is alone."""
    random = np.random.default_rng(5)
    labels = random.integers(-1, 3, (9, 6))
    rows = [f"{t},{n},{n},{t},{labels[t, n]}" for t in range(9) for n in range(6)]
    text = "frame,ped_id,x_m,y_m,group_id\n" + "\n".join(random.permutation(rows)) + "\n"
    tracks = recordings.read(write(tmp_path / "talk.csv", text), "groups")
    assert tracks.time_step == 1.0, "a moment a second unless a rate is given"
    for t in range(9):
        expected = [-1 if label < 0 else labels[t].tolist().index(label) for label in labels[t]]
        assert tracks.group[t].tolist() == expected


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("1,a,0,0\n2,,0,0\n", ":3: the person is ''; give a name or a whole number"),
        (f"1,{2**31},0,0\n", f":2: the person is '{2**31}'; give a name"),
        (f"{2**31},1,0,0\n", ":2: frame is .*, which is beyond 2,147,483,647; leave the line out"),
        ("2000000,1,0,0\n2000001,1,0,0\n0,1,0,0\n2000002,1,0,0\n", ":4: the frame is 2e[+]06 s from others"),
        ("0,1,0,0\n2000000,1,0,0\n1,1,0,0\n2,1,0,0\n", ":3: the frame is 2e[+]06 s from others"),
    ],
)
def test_lines_that_cannot_be_are_named(tmp_path, rows, words):
    with pytest.raises(FileError, match=words):
        reading.read_lines(write(tmp_path / "a.csv", HEAD + rows), frame_rate=1.0)


def test_the_largest_numbers_are_read(tmp_path):
    most = 2**31 - 1
    found = reading.read_lines(write(tmp_path / "a.csv", f"{HEAD}{most},{most},0,0\n"), frame_rate=1.0)
    assert found.number.tolist() == [most] and found.values["frame"].tolist() == [most]
    with pytest.raises(FileError, match="does not tell how many frames a second it has"):
        reading.read_lines(write(tmp_path / "a.csv", HEAD + "1,1,0,0\n"))


def test_recorded_snapshots_have_no_situations(tmp_path):
    """They are found afterwards; the robot has a row for each moment."""
    tracks = recordings.read(write(tmp_path / "a.csv", HEAD + "0,1,0,0\n1,1,1,0\n2,1,2,0\n0,2,5,5\n"), frame_rate=1.0)
    snapshots, there = recordings.snapshots_of(tracks, 0)
    assert snapshots.situations.shape == (3, 0) and there.tolist() == [True] * 3
    assert (np.asarray(snapshots.people.walking_group) < 0).all()
