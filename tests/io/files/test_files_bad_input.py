"""Files and numbers that no one means are refused at once, in a sentence with file, line, value and cure."""

import json
import os
import warnings
import zlib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import robots
from sean_jax.cli import command_line
from sean_jax.core import bounds
from sean_jax.core.errors import FileError, InputError
from sean_jax.core.geometry import MAX_ROWS, nearby_obstacles
from sean_jax.io.files import mjcf
from sean_jax.learning.dataset import open_dataset
from sean_jax.learning.networks import read_network_config
from sean_jax.people import recordings
from sean_jax.world import environment, navigation, ros_map
from support import trees
from support.fuzzing import BOMB, MERGES, check_error, hall, image, walks
from support.mjcf import DOCUMENT_TYPE, UNSAFE, box, lines_of, picture_scene, side_scene
from support.scenes import room

MAP = "image: map.png\nresolution: 0.1\norigin: [0, 0, 0]\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"


def write(folder: Path, changed: dict | None = None) -> Path:
    """Files of every kind, some of them replaced, by other content or by nothing."""
    given = {**hall(), "people.csv": walks(), "map.yaml": MAP.encode(), "map.png": image(), "dataset.json": b"{}",
             "config.json": b"{}", "robot.xml": robots.ROBOTS["kuri"].read_bytes()}  # fmt: skip
    for name, content in {**given, **(changed or {})}.items():
        if content is not None:
            (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder


READERS = {
    "environment.yaml": environment.load,
    "scene.xml": environment.load,
    "robot.xml": lambda folder: robots.load(folder / "robot.xml", "twin"),
    "people.csv": lambda folder: recordings.read(folder / "people.csv", "eth_ucy"),
    "map.yaml": lambda folder: ros_map.read_map(folder / "map.yaml"),
    "map.png": lambda folder: ros_map.read_map(folder / "map.yaml"),
    "dataset.json": open_dataset,
    "config.json": lambda folder: read_network_config(folder / "config.json"),
}


def refusal(folder: Path, name: str) -> str:
    with pytest.raises(ValueError) as caught:
        READERS[name](folder)
    check_error(caught.value, name.split(".")[0])
    return str(caught.value)


@pytest.mark.parametrize("name", READERS)
def test_no_reader_waits_for_a_pipe_or_reads_a_device_or_a_giant(tmp_path, name):
    if not hasattr(os, "mkfifo"):
        pytest.skip("this system has no pipes")
    write(tmp_path, {name: None})
    os.mkfifo(tmp_path / name)
    assert "it is a pipe; give a file" in refusal(tmp_path, name) or name in ("environment.yaml", "robot.xml")
    (tmp_path / name).unlink()
    (tmp_path / name).symlink_to("/dev/zero")
    assert "it is a device; give a file" in refusal(tmp_path, name) or name in ("environment.yaml", "robot.xml")
    (tmp_path / name).unlink()
    with (tmp_path / name).open("wb") as stream:
        stream.truncate(10**12)  # a hole, which takes no room on the disk
    assert "1,000,000,000,000 bytes" in refusal(tmp_path, name)
    if name != "map.png":
        (tmp_path / name).write_bytes(b"\xff\xfe" + b"a\n" * 10)
        assert ":1: byte 0 is not UTF-8 text; save the file as UTF-8" in refusal(tmp_path, name)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("!!binary aGVsbG8=", "tags such as '!!binary' mean nothing here; remove it"),
        ("!!set {a, b}", "'!!set'"),
        ("!!timestamp 2001-01-01", "'!!timestamp'"),
        ("!!bool abc", "'!!bool'"),
        ("!thing 1", "'!thing'"),
        ("!!str {b: c}", "tags such as '!!str' mean nothing here; remove it"),
        ("!!str [1, 2]", "'!!str'"),
        ("[" * 3000, "nested deeper than 60 levels"),
        ("9" * 5000, "a number has 5000 characters"),
        ('"\\ud800"', "half a character"),
        ('"\\UFFFFFFFF"', "is not YAML"),
        (".nan", "is not a finite number"),
        ("1e39", "1e+39 is more than 10000, the most allowed"),
        ("1e999", "is not a finite number"),
        ("3000, -4, 9000", "is 6000 by 8 m, and 4000 m is the longest side"),
    ],
)
def test_values_of_yaml(tmp_path, value, words):
    text = f"name: hall\nfloor: [-5, -4, {value}, 4]\npeople: 4\n".replace("9000, 4]", "9000, 4]")
    if value.startswith("3000"):
        text = "name: hall\nfloor: [-3000, -4, 3000, 4]\npeople: 4\n"
    write(tmp_path, {"environment.yaml": text})
    said = refusal(tmp_path, "environment.yaml")
    assert "environment.yaml:2:" in said and words in said and "\n" not in said


@pytest.mark.parametrize("bomb", [BOMB, MERGES], ids=["aliases", "merges"])
def test_bombs_are_not_unfolded(tmp_path, bomb):
    write(tmp_path, {"environment.yaml": bomb})
    assert "aliases unfold to more than 50,000 values; write fewer" in refusal(tmp_path, "environment.yaml")


@pytest.mark.parametrize(("text", "words"), UNSAFE)
def test_scenes_are_looked_through_before_mujoco_compiles_them(tmp_path, text, words):
    write(tmp_path, {"scene.xml": lines_of(text)})
    os.mkfifo(tmp_path / "pipe")
    said = refusal(tmp_path, "scene.xml")
    assert words in said and "\n" not in said and ("scene.xml:3" in said or "pipe" in said)


@pytest.mark.parametrize(
    ("compiler", "file"),
    [
        ('<compiler texturedir="pictures"/>', "large.png"),
        ('<compiler assetdir="nowhere"/><compiler assetdir="pictures"/>', "large.png"),
        ('<compiler texturedir="pictures" strippath="true"/>', "elsewhere/large.png"),
        ('<compiler texturedir="pictures" strippath="true"/>', "C:\\elsewhere\\large.png"),
    ],
)
@pytest.mark.parametrize("after", [False, True])
def test_pictures_are_measured_wherever_the_compiler_says_they_are(tmp_path, compiler, file, after):
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "large.png").write_bytes(giant(6_000))
    write(tmp_path, {"scene.xml": picture_scene(compiler, file, compiler_last=after)})
    said = refusal(tmp_path, "scene.xml")
    assert f"scene.xml:{2 if after else 3}: textures have more than 25 million pixels" in said


def test_a_picture_without_a_grid_is_on_all_sides_of_a_cube(tmp_path):
    (tmp_path / "side.png").write_bytes(giant(3_000))
    for more, refused in (('type="cube"', True), ('type="2d"', False), ('type="cube" gridsize="3 4"', False)):
        (tmp_path / "scene.xml").write_text(side_scene(more))
        with pytest.raises(FileError) as caught:
            mjcf.read(tmp_path / "scene.xml")
        assert ("25 million pixels" in str(caught.value)) == refused, more  # else MuJoCo finds that it is cut off


def test_a_hundred_errors_of_a_file_are_told_and_the_others_counted(tmp_path):
    keys = "".join(f"key_{k}: 1\n" for k in range(5_000))
    write(tmp_path, {"environment.yaml": "name: hall\nfloor: [-5, -4, 5, 4]\npeople: 4\n" + keys})
    said = refusal(tmp_path, "environment.yaml").split("\n")
    assert len(said) == 101 and "environment.yaml:4:1: key_0: 'key_0' is not a known key" in said[0]
    assert said[-1].endswith("environment.yaml: there are 4,900 more errors; mend these first.")
    twins = "".join(f"key_{k % 1_000}: 1\n" for k in range(2_000))
    write(tmp_path, {"environment.yaml": twins})
    said = refusal(tmp_path, "environment.yaml").split("\n")
    assert len(said) == 101 and said[-1].endswith("there are 900 more errors; mend these first.")


def test_a_document_type_is_refused(tmp_path):
    write(tmp_path, {"scene.xml": DOCUMENT_TYPE})
    assert "scene.xml:1: has a document type" in refusal(tmp_path, "scene.xml")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('timestep="0.02"', 'timestep="0"', "the timestep of its <option> is 0, but must be from 0.001 to 1 s"),
        ('kv="0.2"', 'kv="-0.2"', "its servo gain is -0.2, but must be from"),
        ('armature="0.004"', 'armature="-1"', "robot.xml: "),
        ('data="0.5"', 'data="inf"', 'robot.xml:9: data="inf" holds a number that is not finite'),
        ('data="0.5"', 'data="1e9"', "the numeric max_speed is 1e+09, but must be from 0.01 to 30 m/s"),
        ('data="0.8"', 'data="nan"', 'robot.xml:15: data="nan" holds a number that is not finite'),
        ('pos="0.05 0 0.264"', 'pos="nan 0 0.264"', 'robot.xml:48: pos="nan 0 0.264" holds a number that is not'),
        ('pos="0 0 0.214"', 'pos="0 0 1e5"', "the largest coordinate of its mount 'lidar' is 100000"),
        ('forcerange="-1.25 1.25"', 'forcerange="-1e9 1e9"', "its servo torque is 1e+09"),
    ],
)
def test_robots_of_impossible_numbers(tmp_path, monkeypatch, old, new, words):
    text = robots.ROBOTS["kuri"].read_text()
    assert old in text
    write(tmp_path, {"robot.xml": text.replace(old, new, 1)})
    monkeypatch.chdir(tmp_path)
    assert words in refusal(tmp_path, "robot.xml")
    assert not Path("MUJOCO_LOG.TXT").exists()


HEAD = "frame,id,x,y\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (HEAD + "1,1,0,0\n2,1,1e300,0\n", ":3: x is 1e+300, which is beyond 10,000"),
        (HEAD + "1,1,0,0\n2,1,1e6,0\n", ":3: x is 1e+06, which is beyond 10,000"),
        (HEAD + "".join(f"{k},1,{k * 0.1},0\n" for k in range(400)) + "400,1,70,0\n", ":402: the person is 30.1 m"),
        (HEAD + "1,1,0,0\n2,1,0.1,0\n1000000000,1,0,0\n", ":4: the frame is 1e+08 s from others"),
        (HEAD + "1,1,0,0\n3000000000,1,0.1,0\n", ":3: frame is 3e+09, which is beyond 2,147,483,647"),
        (HEAD + f"1,1,{'a' * 200_000},0\n", ":2: is not CSV: field larger than field limit"),
        (HEAD + "1,1,\x00,0\n", ":2: is no"),
        (HEAD + "1,,0,0\n", ":2: the person is ''"),
        ("frame;id;x;y\n1;1;0;0\n", ":1: has no column frame but frame;id;x;y"),
    ],
)
def test_recordings_of_impossible_numbers(tmp_path, text, words):
    (tmp_path / "people.csv").write_text(text)
    said = []
    for read in (
        lambda path: recordings.read(path, frame_rate=10.0),
        lambda path: recordings.read(path, frame_rate=10.0, time_step=0.1),
    ):
        with pytest.raises(FileError) as caught:
            read(tmp_path / "people.csv")
        check_error(caught.value, "people")
        said.append(str(caught.value))
    assert words in said[0] and said[0] == said[1] and len(said[0]) < 300


def test_both_readers_take_marks_cases_and_any_order(tmp_path):
    rows = [(frame, person, 0.1 * frame + k, 2.0 * k) for frame in range(30) for k, person in enumerate(("7", "12"))]
    forms = {
        "plain.csv": ("frame,id,x,y", "{0},{1},{2},{3}"),
        "other.csv": ("\ufeff Y_M , PED_ID,Note,Frame,X_m", "{3},{1},nothing,{0},{2}"),
    }
    read = {}
    for name, (header, line) in forms.items():
        text = "\n".join([header, *(line.format(*row) for row in rows)]) + "\n"
        (tmp_path / name).write_text(text, encoding="utf-8")
        sampled = recordings.read(tmp_path / name, frame_rate=10.0, time_step=0.1)
        read[name] = recordings.read(tmp_path / name, frame_rate=10.0), sampled
    trees.assert_equal(*read.values())
    assert read["plain.csv"][0].person.tolist() == [[7, 12]] * 30
    played, seen = read["plain.csv"][1], read["plain.csv"][0]
    np.testing.assert_allclose(played.position, seen.position, atol=1e-5)
    for field in ("present", "person", "frame"):
        np.testing.assert_array_equal(getattr(played, field), getattr(seen, field))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("[]", "is not a mapping"),
        ('{"format": "1"}', "is missing; add it"),
        ('{"format": 1, "batch": 2}', "is missing; add it"),
        ("[" * 100_000, "nested too deeply"),
        ('{"format": NaN}', "NaN is not JSON"),
        ('{"format": ' + "9" * 5000 + "}", "dataset"),
    ],
)
def test_manifests_and_configurations(tmp_path, content, words):
    write(tmp_path, {"dataset.json": content, "config.json": content})
    with pytest.raises(InputError, match="restore it or collect again"):
        open_dataset(tmp_path)
    assert words in refusal(tmp_path, "dataset.json")
    refusal(tmp_path, "config.json")


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("width", -1, "width: -1 is less than 1"),
        ("width", "wide", "width: 'wide' is not a whole number"),
        ("flags", 1, "flags: 1 is not true or false"),
        ("image", [10**6, 10**6], "image[0]: 1000000 is more than 4096"),
        ("situations", None, "situations: an empty value is not a list"),
    ],
)
def test_a_policy_of_nonsense(tmp_path, key, value, words):
    good = {"width": 8, "flags": False, "image": [12, 16], "situations": ["empty"]}
    (tmp_path / "config.json").write_text(json.dumps(good))
    assert read_network_config(tmp_path / "config.json").width == 8
    (tmp_path / "config.json").write_text(json.dumps({**good, key: value}))
    assert words in refusal(tmp_path, "config.json")


def giant(side: int) -> bytes:
    """A PNG that says it has so many rows and columns, and is cut off."""
    header = b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR" + side.to_bytes(4, "big") * 2 + b"\x08\x00\x00\x00\x00"
    header += zlib.crc32(header[12:]).to_bytes(4, "big")
    data = zlib.compress(b"\x00" * 1000)
    chunk = len(data).to_bytes(4, "big") + b"IDAT" + data + zlib.crc32(b"IDAT" + data).to_bytes(4, "big")
    return header + chunk + b"\x00\x00\x00\x00IEND\xaeB`\x82"


def test_an_image_is_measured_before_it_is_unpacked(tmp_path):
    write(tmp_path, {"map.png": giant(60_000)})
    assert "has more than 16 million cells; cut it out or lower its resolution" in refusal(tmp_path, "map.png")
    assert mjcf._pixels((tmp_path / "map.png").read_bytes()) == 60_000**2
    write(tmp_path, {"map.png": giant(10_000)})  # of which Pillow warns, and which it opens
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        assert "has more than 16 million cells" in refusal(tmp_path, "map.png")
    assert not told


def test_a_floor_of_kilometres_has_a_table_of_bounded_size(tmp_path):
    text = "name: field\nfloor: [-2000, -2000, 2000, 2000]\npeople: 4\n"
    table = environment.load(write(tmp_path, {"environment.yaml": text})).obstacle_grid
    assert table.rows.size <= 6 * MAX_ROWS and float(table.cell) > 1.0
    x, y = jnp.float32(1.5), jnp.float32(0.9)  # within the box in the middle, whose row must be among those near
    found = np.asarray(nearby_obstacles(table, x, y))
    assert (np.abs(found[:, :2] - [1.0, 0.0]).max(-1) < 1e-6).any()


def test_paths_are_not_planned_around_thousands_of_corners(tmp_path):
    spots = [(2.0 * i - 19.0, 2.0 * j - 19.0) for i in range(20) for j in range(20)]
    posts = [box(spot, (0.2, 0.2)) for spot in spots]
    place = environment.load(room(tmp_path, (-20, -20, 20, 20), posts, 4, name="posts"))
    with pytest.raises(ValueError, match="environment 'posts' has 3,200 arcs around corners"):
        navigation.build(place, 0.25)


@pytest.mark.parametrize(
    "arguments",
    [
        {"time_step": float("nan")}, {"time_step": 5.0}, {"time_step": 1e-9}, {"time_step": "0.1"}, {"time_step": 0.03},
        {"time_limit": float("inf")}, {"time_limit": 1e39}, {"goal_radius": 1e39}, {"goal_radius": float("nan")},
        {"hold_time": float("nan")}, {"hold_time": 1e300}, {"task_distance": (0.0, float("nan"))},
        {"task_distance": (0.0, 1e39)}, {"task_distance": 4.0}, {"substeps": 10**9}, 
        {"substeps": 2.5}, {"people": 2.5}, {"congestion_cost": float("nan")},
        {"people": 10**9}, {"walking_groups": (float("nan"), 0.0)}, {"forces": "nan"}, {"thresholds": "nan"},
        {"task": "custom", "start": (1e39, 0.0), "goal": (0.0, 1.0)},
        {"task": "custom", "start": (0.0, 1.0), "goal": (0.0, "1")},
    ],
    ids=str,
)  # fmt: skip
def test_make_refuses_numbers_that_make_no_world(arguments):
    """Before tables are made: each takes a moment."""
    name = [*arguments][-1] if "task" not in arguments else ("start" if arguments["start"][0] > 1 else "goal")
    given = dict(arguments)
    if name == "forces":
        given["forces"] = sean_jax.social_forces.preset("sean2").tree_replace({"walking.radius": np.float32("nan")})
    if name == "thresholds":
        usual = sean_jax.classifiers.thresholds()
        given["thresholds"] = jax.tree.map(lambda leaf: leaf * np.float32("inf"), usual)
    with pytest.raises(ValueError, match=rf"^((behavior|task)\.)?{name}") as caught:
        sean_jax.make(**{"environment": "lab", "people": 2, "dynamics": "twin", **given})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1: 2", "the key 1 is not text; put it in quotes"),
        ("behavior: {kind: graph, 3: 4}", "behavior: the key 3 is not text; put it in quotes"),
        ("thresholds: near", "thresholds: 'near' is not a mapping"),
        ("task_distance: [1, 2, 3]", "task_distance: [1, 2, 3] has 3 values, 2 are allowed"),
        ("behavior: {kind: graph, walking_groups: 3}", "behavior.walking_groups: 3 is not a list"),
        ("name: 3", "name: 3 is not text"),
        ("out: [3]", "out: [3] is not a path"),
        ("quiet: 3", "quiet: 3 is not true or false"),
        ("robot: {kind: value}", "robot: was a Python value, which no file holds"),
        (f"{'x' * 900}: 3", "is not a known key; there are environment"),
    ],
)
def test_a_configuration_of_nonsense(tmp_path, capsys, text, words):
    (tmp_path / "config.yaml").write_text(f"config:\n  {text}\n")
    assert command_line.main(["run", "--config", str(tmp_path / "config.yaml")]) == 2
    said = capsys.readouterr().err
    assert "config.yaml: " in said and words in said and len(said.splitlines()) == 1 and len(said) < 600


@pytest.mark.parametrize("radius", [0.0, -0.2, 11.0])
def test_bodies_have_a_size(radius):
    forces = sean_jax.social_forces.preset("sean2").tree_replace({"walking.radius": np.float32(radius)})
    for people in (None, 2):
        with pytest.raises(ValueError, match=r"^forces.walking.radius: .* must be from 0.01 to 10"):
            sean_jax.make("lab", people=people, forces=forces, dynamics="twin")


def test_numbers_that_are_checked_are_given_back():
    assert bounds.check_number("time_step", 0.1, *bounds.TIME_STEP_RANGE) == 0.1
    for value in (True, None, "1", [1], float("nan"), np.float32("inf"), 10**400):
        with pytest.raises(ValueError, match="^time_step: .* must be from 0.001 to 1 s.$"):
            bounds.check_number("time_step", value, *bounds.TIME_STEP_RANGE, "s")
