"""The YAML loader: every error at once, each at its place, with its cure."""

import io
import os
import zipfile
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pydantic
import pytest

from sean_jax.core.errors import FileError
from sean_jax.io import files
from sean_jax.io.files import meshes, reading

STRICT = pydantic.ConfigDict(extra="forbid", allow_inf_nan=False)


class Thing(pydantic.BaseModel):
    """An entry of the sample file."""

    model_config = STRICT
    kind: Literal["waypoint", "group"]
    radius: Annotated[float, pydantic.Field(gt=0)]
    position: tuple[float, float] = (0.0, 0.0)
    size: int | None = None


class Sample(pydantic.BaseModel):
    """A file with every sort of value."""

    model_config = STRICT
    things: dict[str, Thing]
    words: list[str] = []
    on: bool = True


def write(folder: Path, text: str) -> Path:
    path = folder / "place" / "sample.yaml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def errors(folder: Path, text: str, *checks) -> list[str]:
    with pytest.raises(FileError) as caught:
        files.load(write(folder, text), Sample, *checks)
    return str(caught.value).splitlines()


def test_good_file(tmp_path):
    text = "things:\n  no: {kind: group, radius: 1e-1, position: [1, -2.5]}\nwords: [off, 12:30, 2020-01-01]\n"
    sample = files.load(write(tmp_path, text), Sample)
    assert sample.things["no"] == Thing(kind="group", radius=0.1, position=(1.0, -2.5))
    assert sample.words == ["off", "12:30", "2020-01-01"]  # words that YAML 1.1 would change


def test_all_errors_at_once_each_with_place_value_and_cure(tmp_path):
    text = """\
things:
  dock:
    kind: gruop
    radius: -1
    positoin: [0, 0]
  aisle:
    kind: group
    position: [0, wide]
  hall: {kind: group, radius: yes, size: 2.5}
  room: {kind: group, radius: .nan, position: [0, 1, 2]}
words: one
extra: 1
"""
    assert errors(tmp_path, text) == [
        "place/sample.yaml:3:11: things.dock.kind: 'gruop' is not one of waypoint, group; did you mean 'group'?",
        "place/sample.yaml:4:13: things.dock.radius: -1 is not greater than 0.",
        "place/sample.yaml:5:5: things.dock.positoin: 'positoin' is not a known key; did you mean 'position'?",
        "place/sample.yaml:6:3: things.aisle.radius: is missing; add it.",
        "place/sample.yaml:8:19: things.aisle.position[1]: 'wide' is not a number.",
        "place/sample.yaml:9:31: things.hall.radius: 'yes' is not a number.",
        "place/sample.yaml:9:42: things.hall.size: 2.5 is not a whole number.",
        "place/sample.yaml:10:31: things.room.radius: nan is not a finite number.",
        "place/sample.yaml:10:47: things.room.position: [0, 1, 2] has 3 values, 2 are allowed.",
        "place/sample.yaml:11:8: words: 'one' is not a list, such as [a, b].",
        "place/sample.yaml:12:1: extra: 'extra' is not a known key; there are things, words, on.",
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", ":1:1: the file is empty."),
        ("- a\n", ":1:1: ['a'] is not a mapping, which has lines 'key: value'."),
        ("things:\n  a: [1\nwords: []\n", ":3:6: is not YAML: while parsing a flow sequence that begins in line 2"),
        ("things: !!python/name:os.system\n", ":1:9: is not YAML: "),
        ("things: {}\nwords: []\nthings: {}\n", ":3:1: things: the key was used in line 1; remove or rename one."),
        ("things: {}\nwords: &w [*w]\n", ":2:8: an alias stands inside of its own anchor; remove it."),
        ("things:\n", ":1:1: things: an empty value is not a mapping, which has lines 'key: value'."),
        ("things: {a: {kind: group, radius: 010, position: [1]}}\n", "position[1]: one value more is needed."),
        ("things: {}\non: 1\n", ":2:5: on: 1 is not true or false."),
        ("\x07", "character 0 is not allowed in YAML; remove it."),
    ],
)
def test_unusable_files(tmp_path, text, message):
    found = errors(tmp_path, text)
    assert len(found) == 1 and found[0].startswith("place/sample.yaml:") and message in found[0]


def test_missing_and_binary_files(tmp_path):
    write(tmp_path, "things: {}")
    with pytest.raises(FileError, match=r"sampel.yaml: there is no such file; did you mean 'sample.yaml'\?$"):
        files.load(tmp_path / "place" / "sampel.yaml", Sample)
    with pytest.raises(FileError, match="cannot be read: it is a folder"):
        files.load(tmp_path, Sample)
    (tmp_path / "binary.yaml").write_bytes(b"name: \xff")
    with pytest.raises(FileError, match="byte 6 is not UTF-8 text"):
        files.load(tmp_path / "binary.yaml", Sample)


def test_checks_between_fields_are_reported_at_their_places(tmp_path):
    text = "things:\n  dock: {kind: group, radius: 1}\nwords: [dock, dokc]\n"

    def known(sample: Sample):
        for index, word in enumerate(sample.words):
            if word not in sample.things:
                yield ("words", index), f"there is no '{word}'{files.suggest(word, sample.things)}"

    def sized(sample: Sample):
        return [(("things", name, "size"), "is missing") for name, thing in sample.things.items() if not thing.size]

    assert errors(tmp_path, text, known, sized) == [
        "place/sample.yaml:2:3: things.dock.size: is missing.",
        "place/sample.yaml:3:15: words[1]: there is no 'dokc'; did you mean 'dock'?",
    ]


def test_suggestions():
    assert files.suggest("Warehose", ["lab", "warehouse"]) == "; did you mean 'warehouse'?"
    assert files.suggest("xyz", ["lab", "warehouse"]) == ""


def test_a_damaged_file_of_arrays_is_read_or_refused_in_a_sentence(tmp_path):
    """Any of its bytes changed, or cut after it."""
    path, whole = tmp_path / "a.npz", io.BytesIO()
    given = {"a": np.arange(40), "b": np.array("word"), "c": np.zeros((0, 3), np.float16), "d": np.ones(3, bool)}
    np.savez_compressed(whole, **given)
    content, random, refused = whole.getvalue(), np.random.default_rng(0), 0
    for place in range(len(content)):
        damaged = bytearray(content)
        damaged[place] ^= int(random.integers(1, 256))
        for broken in (bytes(damaged), content[:place]):
            path.write_bytes(broken)
            try:
                found = files.read_arrays(path)
            except FileError as error:
                assert str(error).startswith(f"{tmp_path.name}/a.npz: "), error
                refused += 1
            else:
                for name in found.keys() & given.keys():
                    np.testing.assert_array_equal(found[name], given[name])
    assert refused > 1.5 * len(content)


def zipped(*members: tuple[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as parts:
        for name, content in members:
            parts.writestr(name, content)
    return stream.getvalue()


def npy(shape: tuple[int, ...], kind: str, content: bytes = b"") -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": kind, "fortran_order": False, "shape": shape})
    return stream.getvalue() + content


@pytest.mark.parametrize(
    ("members", "words"),
    [
        ([("a.npy", npy((10**12,), "<f8"))], "is damaged"),
        ([("a.npy", npy((10**12, 10**12, 10**12), "<f8"))], "is damaged"),
        ([("a.npy", npy((-1,), "<f8", bytes(8)))], "is damaged"),
        ([("a.npy", npy((2,), "<f8", bytes(24)))], "is damaged"),
        ([("a.npy", npy((1,), "|O", b"cos\nsystem\n."))], "is damaged"),
        ([("a.npy", npy((1,), "<c16", bytes(16)))], "is damaged"),
        ([("a.txt", b"words")], "is damaged"),
        ([("a.npy", bytes(3_000_000))], "unpacks to 3,000,000 bytes and at most 1,000,000 are read"),
        ([(f"{k}.npy", npy((50_000,), "<f8", bytes(400_000))) for k in range(3)], "unpacks to 1,200,"),
    ],
)
def test_sizes_are_taken_from_heads_before_there_is_room_for_them(tmp_path, members, words):
    path = tmp_path / "a.npz"
    path.write_bytes(zipped(*members))
    assert path.stat().st_size < 10_000
    with pytest.raises(FileError, match=f"a.npz: {words}.*; remove it") as refused:
        files.read_arrays(path, 1_000_000)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("place", ["pipe", "folder", "device", "missing"])
def test_what_is_no_file_is_refused_at_once(tmp_path, place):
    path = tmp_path / "a"
    if place == "pipe":
        os.mkfifo(path)
    elif place == "folder":
        path.mkdir()
    elif place == "device":
        path.symlink_to("/dev/zero")
    for read in (files.read_arrays, files.read_bytes, files.read_json, lambda path: list(files.read_rows(path))):
        with pytest.raises(FileError, match="there is no such file|cannot be read: it is a"):
            read(path)


def test_rows_are_those_of_a_table(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(b'\xef\xbb\xbf# said, "so"\r\na,b\r\n\r\n1,"2,\r\n3"\r\n')
    assert [*files.read_rows(path)] == [['# said, "so"'], ["a", "b"], ["1", "2,\r\n3"]]
    for content, words in (
        (b"a,b\n1,2\n1\n", "a.csv:3: has 1 cells and there are 2 columns"),
        (b"# x\na,b\n1,2\n1\n", "a.csv:4: has 1 cells"),
        (b"a,a\n", "a.csv:1: names a column twice"),
        (b'a,b\n1,"2\n', "a.csv:2: is no row of CSV"),
        (b"a,b\n1,\xff\n", "is not UTF-8 text"),
    ):
        path.write_bytes(content)
        with pytest.raises(FileError, match=words):
            list(files.read_rows(path))
    path.write_bytes(b"")
    assert [*files.read_rows(path)] == []


def test_levels_of_a_file_are_counted_from_one(tmp_path):
    """As many lists in one another as are allowed are read, and one more is refused."""
    for deeper in (0, 1):
        file = write(tmp_path, "[" * (files.MAX_DEPTH - 1 + deeper) + "word" + "]" * (files.MAX_DEPTH - 1 + deeper))
        if deeper:
            with pytest.raises(FileError, match=f"nested deeper than {files.MAX_DEPTH} levels"):
                files.read_yaml(file)
        else:
            assert files.read_yaml(file)[1]


def test_values_of_json_are_checked_as_those_of_yaml(tmp_path):
    data = {"things": {"door": {"kind": "group", "radius": 2, "position": [1, 2.5]}}, "words": ["a"]}
    found = files.check_json(tmp_path / "x.json", data, Sample, lambda sample: ())
    assert found.things["door"].position == (1.0, 2.5) and found.words == ["a"] and found.on
    with pytest.raises(FileError, match=r"x.json: things.door.radius: 'two' is not a number"):
        files.check_json("x.json", {"things": {"door": {"kind": "group", "radius": "two"}}}, Sample)
    with pytest.raises(FileError, match="x.json: words: there are none"):
        files.check_json("x.json", data | {"words": []}, Sample, lambda sample: [(("words",), "there are none")])


def test_the_last_line_of_a_log_may_lack_its_end(tmp_path):
    """Each line with an end is read; what a kill has left after it is not."""
    log = tmp_path / "log.jsonl"
    for text, expected in (
        ("", []),
        ("1", []),
        ("1\n", [1]),
        ("1\n[2]\n{", [1, [2]]),
        ('1\n[2]\n"c"\n', [1, [2], "c"]),
    ):
        log.write_text(text)
        assert list(reading.read_json_lines(log)) == expected
    log.write_text("1\n{\n3\n")
    with pytest.raises(FileError, match="log.jsonl:2: is not JSON"):
        list(reading.read_json_lines(log))


def test_xml_has_a_limit_of_depth_and_of_elements(tmp_path, monkeypatch):
    file, deep = tmp_path / "x.xml", files.MAX_DEPTH
    monkeypatch.setattr(meshes, "MAX_ELEMENTS", 2 * deep)
    for levels, more, fine in ((deep, 0, True), (deep + 1, 0, False), (deep, deep, True), (deep, deep + 1, False)):
        file.write_text("<a>" * levels + "</a>" * (levels - 1) + "<b/>" * more + "</a>")
        if fine:
            assert len(meshes.xml_tree(file)) == min(levels - 1, 1) + more
        else:
            with pytest.raises(FileError, match="too many or nested too deep"):
                meshes.xml_tree(file)


@pytest.mark.parametrize(("value", "number"), [("{}", 2_100_000), ("[]", 2_100_000), ("1", 4_100_000)])
def test_a_json_file_of_many_values_is_refused_before_they_are_made(tmp_path, value, number):
    (tmp_path / "a.json").write_text(f"[{','.join([value] * number)}]")
    with pytest.raises(FileError, match="it has more than 4,000,000 values; make it smaller"):
        files.read_json(tmp_path / "a.json")
    (tmp_path / "a.json").write_text(f"[{','.join([value] * 100_000)}]")
    assert len(files.read_json(tmp_path / "a.json")) == 100_000


class Walker(pydantic.BaseModel):
    x: float
    y: float
    z: float


class Walkers(pydantic.RootModel[list[Walker]]):
    pass


def test_errors_of_a_file_are_bounded(tmp_path):
    """Each takes a kilobyte, and a value of three characters may be wrong in several ways."""
    with pytest.raises(FileError, match="has more than 500,000 values; make it smaller"):
        files.check_json(tmp_path / "a.json", [{}] * 260_000, Walkers)
    with pytest.raises(FileError, match="a.json: has 60,000 errors; give a file of the form that is read"):
        files.check_json(tmp_path / "a.json", [{}] * 20_000, Walkers)


def test_arrays_of_a_file_are_bounded_and_have_elements_of_a_size(tmp_path):
    def write(header, size):
        with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as parts:
            text = header.ljust(117) + "\n"
            begin = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode()
            parts.writestr("a.npy", begin + bytes(size))

    write("{'descr': '<U0', 'fortran_order': False, 'shape': (999999999999,), }", 0)
    with pytest.raises(FileError, match="is damaged"):
        files.read_arrays(tmp_path / "a.npz")
    write("{'descr': '<f4', 'fortran_order': False, 'shape': (1000,), }", 4000)
    assert files.read_arrays(tmp_path / "a.npz")["a"].shape == (1000,)
    with pytest.raises(FileError, match="unpacks to 4,128 bytes and at most 4,000 are read"):
        files.read_arrays(tmp_path / "a.npz", 4_000)
    assert files.MAX_RECORD * 4 < 1e9 and files.reading.MAX_ARRAYS <= 5e8
