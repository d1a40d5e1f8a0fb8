"""The YAML loader: every error at once, each at its place, with its cure."""

from pathlib import Path
from typing import Annotated, Literal

import pydantic
import pytest

from sean_jax import files
from sean_jax.errors import FileError

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
        (
            "things:\n  a: [1\nwords: []\n",
            ":3:6: is not YAML: while parsing a flow sequence that begins in line 2",
        ),
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
