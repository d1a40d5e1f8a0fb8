"""Changes of an environment's files by the studio: texts keep all that is not changed, and files are checked."""

import copy
import functools
import random
import re
import shutil
import tempfile
import xml.etree.ElementTree as ElementTree
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import yaml

from sean_jax.config import StudioConfig, validate
from sean_jax.core.errors import InputError
from sean_jax.simulation import making
from sean_jax.web.studio import editor, scene_text, yaml_text
from sean_jax.web.studio.editor import Editor
from sean_jax.world import environment
from support import mjcf, trees
from support.checkout import ROOT
from support.mjcf import HANDWRITTEN

ENVS = ROOT / "envs"
load = functools.partial(yaml.load, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
BLOCK = """\
# a graph in another style
version: 1
c_min: 0.2
c_max: 100
nodes:
  # the first place
  west:  # with a remark
    kind: waypoint
    position:
      - -4.5  # x
      - 0
    radius: &wide 1.0
    spawn: 1

  # the second place
  "east":
    kind: waypoint
    position: [4.5, 0]
    radius: *wide
    spawn: 2   # often
  north: {kind: waypoint,
          position: [0, 2.5], radius: 1, spawn: 1}  # of two lines
# here are the edges
edges:
- between: [west, east]   # not indented
  weights: [1, 100]
# the last one
- {between: [east, north]}
"""


def text_of(place, name):
    return (ENVS / place / name).read_text()


def comments(text):
    return re.findall(r"(?<!\S)#.*|<!--.*?-->", text, re.DOTALL if "<!--" in text else 0)


def added_and_removed(before, after):
    old, new = Counter(before.split("\n")), Counter(after.split("\n"))
    return list((new - old).elements()), list((old - new).elements())


# ------------------------------------------------------------------ YAML


def random_change(draw, data):
    """A change of a graph, and the plain data after it."""
    names, data = list(data["nodes"]), copy.deepcopy(data)
    name, other = draw.sample(names, 2)
    node = data["nodes"][name]
    pair = next((edge for edge in data["edges"] if set(edge["between"]) == {name, other}), None)
    kind = draw.choice(["position", "number", "add", "remove", "flow", "no edge"])
    number = round(draw.uniform(0.1, 9.0), 3)
    if kind == "position":
        node["position"] = [number, -number]
        return {"node": name, "position": [number, -number]}, data
    if kind == "number":
        key = draw.choice(["radius", "spawn", "weight"])
        node[key] = number
        return {"node": name, key: number}, data
    if kind == "add":
        new = f"new_{draw.randrange(10**6)}"
        data["nodes"][new] = {"kind": "waypoint", "position": [number, 1], "radius": 0.5, "spawn": 1}
        data["edges"].append({"between": [name, new], "flow": "medium"})
        return {"node": new, "add": "waypoint", "position": [number, 1], "edge": name}, data
    if kind == "remove":
        if len(names) < 4:
            return random_change(draw, data)
        del data["nodes"][name]
        data["edges"] = [edge for edge in data["edges"] if name not in edge["between"]]
        return {"node": name, "remove": True}, data
    if kind == "flow":
        flow = draw.choice(["low", "high", "forward"])
        if pair is None:
            data["edges"].append({"between": [name, other], "flow": flow})
        else:
            pair.pop("weights", None)
            pair["flow"] = flow
        return {"edge": [name, other], "flow": flow}, data
    if pair is None:
        return random_change(draw, data)
    data["edges"].remove(pair)
    return {"edge": [name, other], "flow": None}, data


@pytest.mark.parametrize("seed", range(6))
def test_random_changes_of_a_graph(seed):
    """The text is that of a document that is edited on its own; comments of other lines, and these lines, stay."""
    draw = random.Random(seed)
    text = BLOCK.replace("radius: *wide", "radius: 1.0") if seed % 3 == 0 else text_of(
        ["lab", "warehouse", "outdoor"][seed % 3], "graph.yaml")  # fmt: skip
    for _ in range(12):
        change, data = random_change(draw, load(text))
        new = editor.changed_graph(text, change)
        assert load(new) == data, change
        lines, old = added_and_removed(text, new)
        kept = [line for line in old if "#" in line and not change.get("remove") and change.get("flow", "") is not None]
        for line in kept:  # the comment of a line that is changed
            assert any(other.endswith(line[line.index("#") :]) for other in lines), (change, line)
        assert all(line.strip() not in comments(text) for line in old)
        assert not ({*lines, *old} & {""})
        text = new


def test_comments_and_styles_of_a_graph_stay():
    changed = editor.changed_graph(BLOCK, {"node": "west", "position": [-4.25, 0.5]})
    assert changed == BLOCK.replace("- -4.5  # x\n      - 0\n", "- -4.25  # x\n      - 0.5\n")
    changed = editor.changed_graph(BLOCK, {"node": "west", "radius": 2})  # the anchor, which the other one shares
    assert changed == BLOCK.replace("&wide 1.0", "&wide 2")
    changed = editor.changed_graph(BLOCK, {"edge": ["east", "west"], "flow": "low"})
    assert changed == BLOCK.replace("- between: [west, east]   # not indented\n  weights: [1, 100]\n",
                                    "- flow: low\n  between: [west, east]   # not indented\n")  # fmt: skip
    changed = editor.changed_graph(BLOCK, {"node": "north", "remove": True})
    start, end = BLOCK.index("  north:"), BLOCK.index("# here are")
    assert changed == (BLOCK[:start] + BLOCK[end:]).replace("- {between: [east, north]}\n", "")
    one = editor.changed_graph(changed, {"edge": ["east", "west"], "flow": None})
    assert load(one)["edges"] == [] and "# here are the edges\n" in one
    again = editor.changed_graph(one, {"edge": ["east", "west"], "flow": "high"})
    assert load(again)["edges"] == [{"between": ["east", "west"], "flow": "high"}]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"node": "a b", "add": "waypoint", "position": [0, 0], "edge": "west"}, "'a b' is no name for a node"),
        ({"node": "null", "add": "waypoint", "position": [0, 0], "edge": "west"}, "'null' is no name"),
        ({"node": 3, "add": "waypoint", "position": [0, 0], "edge": "west"}, "3 is no name"),
        ({"node": "east", "add": "waypoint", "position": [0, 0], "edge": "west"}, "there is a node 'east' already"),
        ({"node": "new", "add": "waypoint", "position": [0], "edge": "west"}, "position has two numbers"),
        ({"node": "new", "add": "waypoint", "position": [0, 0], "edge": None}, "are no two nodes"),
        ({"node": "nobody", "remove": True}, "there is no node 'nobody'"),
        ({"edge": ["west", "north"], "flow": None}, "there is no edge between west and north"),
    ],
)
def test_changes_that_mean_nothing(change, message):
    with pytest.raises(InputError, match=message):
        editor.changed_graph(BLOCK, change)


def test_an_alias_at_the_end_of_an_entry_is_left_to_the_author():
    text = "one: &one [1, 2]\nb:\n  c: 3\n  d: *one\n"
    with pytest.raises(InputError, match="has a form that the page cannot change"):
        yaml_text.extended(text, ["b"], "e: 4")


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("place", ["lab", "warehouse", "outdoor"])
def test_random_changes_of_sets(place, seed):
    """A point moves in its set and in those that share it, and nothing else changes."""
    draw, text = random.Random(seed), text_of(place, "handcrafted.yaml")
    sets = editor.annotation.Annotation.model_validate(load(text), strict=False)
    for _ in range(6):
        data = load(text)  # lists that sets share are one object
        where, label, one = draw.choice(list(sets.each()))
        points = [
            [key, k] for key in ("starts", "goals") for k in range(5) if not isinstance(getattr(one, key)[k], str)
        ]
        points += [["walkers", w, "loop", k] for w, each in enumerate(one.walkers) for k in range(len(each.loop))]
        points += [["groups", name, "center"] for name in one.groups]
        point = draw.choice(points)
        value = data
        for key in (*where, *point):
            value = value[key]
        x, y = round(draw.uniform(-9, 9), 3), round(draw.uniform(-9, 9), 3)
        value[:2] = [x, y]
        change = {"set": label, "point": point, "position": [x, y]}
        if point[0] in ("starts", "goals"):
            value[2] = change["heading"] = draw.randrange(360)
        new = editor.changed_sets(text, sets, change)
        assert load(new) == data
        assert comments(new) == comments(text) and len(added_and_removed(text, new)[0]) <= 1
        text = new
    for point in (["starts", 5], ["starts", "0"], ["walkers"], ["groups", "nobody", "center"], None, ["situation", 0]):
        with pytest.raises(InputError, match="there is no point"):
            editor.changed_sets(text, sets, {"set": label, "point": point, "position": [0, 0]})


# ------------------------------------------------------------------ MJCF


def tree(text):
    """Names and attributes of the elements, in their order."""
    return [(each.tag, dict(each.attrib)) for each in ElementTree.fromstring(text).iter()]


@pytest.mark.parametrize("place", ["lab", "warehouse", "outdoor"])
def test_random_changes_of_boxes(place, tmp_path):
    """Boxes are where they were put; all other geoms, comments and lines stay."""
    draw, file = random.Random(place), tmp_path / "scene.xml"
    text = text_of(place, "scene.xml")
    for number in range(12):
        file.write_text(text)
        boxes = scene_text.boxes(file, text)
        name, kind = draw.choice(list(boxes)), draw.choice(["position", "size", "height", "turn", "add", "remove"])
        x, y = round(draw.uniform(-5, 5), 3), round(draw.uniform(-5, 5), 3)
        expected = dict(boxes)
        box = expected[name]
        if kind == "position":
            change, expected[name] = {"position": [x, y]}, box._replace(center=(x, y, box.center[2]))
        elif kind == "size":
            half = (abs(x) / 2 + 0.1, 0.5, box.half[2])
            change, expected[name] = {"size": [2 * half[0], 1]}, box._replace(half=half)
        elif kind == "height":
            high = (*box.center[:2], 0.75), (*box.half[:2], 0.75)
            change, expected[name] = {"height": 1.5}, box._replace(center=high[0], half=high[1])
        elif kind == "turn":
            change, expected[name] = {"turn": 30 * number - 90}, box._replace(yaw=30.0 * number - 90)
        elif kind == "add":
            name, change = f"new_{number}", {"add": True, "position": [x, y]}
            expected[name] = scene_text.Box((x, y, 0.5), (0.4, 0.4, 0.5), 0.0)
        else:
            change = {"remove": True}
            del expected[name]
        new = editor.changed_scene(text, boxes, {"box": name, **change})
        file.write_text(new)
        after = scene_text.boxes(file, new)
        assert list(after) == list(expected), change
        for key, box in expected.items():
            found = after[key]
            np.testing.assert_allclose(found.center + found.half, box.center + box.half, atol=1e-3)
            assert abs((found.yaw - box.yaw + 180) % 360 - 180) < 1e-3
        others = [[each for each in tree(some) if each[1].get("name") != name] for some in (text, new)]
        assert others[0] == others[1] and comments(text) == comments(new)
        lines, old = added_and_removed(text, new)
        assert len(lines) <= (kind != "remove") and len(old) <= (kind != "add") and (new == text) == (expected == boxes)
        text = new


def test_styles_of_a_scene_stay(tmp_path):
    file = tmp_path / "scene.xml"
    file.write_text(HANDWRITTEN)
    boxes = scene_text.boxes(file, HANDWRITTEN)
    assert list(boxes) == ["quoted", "beside"]  # neither decoration, nor geoms in bodies or without a name
    turned = editor.changed_scene(HANDWRITTEN, boxes, {"box": "quoted", "turn": 90})
    assert turned == HANDWRITTEN.replace(' quat="1 0 0 0" />', ' euler="0 0 1.5708" />')
    assert editor.changed_scene(HANDWRITTEN, boxes, {"box": "beside", "position": [3, 1]}) == HANDWRITTEN.replace(
        '"3 0 1', '"3 1 1'
    )
    gone = editor.changed_scene(HANDWRITTEN, boxes, {"box": "beside", "remove": True})
    assert gone == HANDWRITTEN.replace(mjcf.BESIDE, "")
    for name in ("inner", "lamp", "floor", "nobody"):
        with pytest.raises(InputError, match="there is no box"):
            editor.changed_scene(HANDWRITTEN, boxes, {"box": name, "remove": True})
    for name, message in (("inner", "there is a geom 'inner' already"), ('a"b', "no name for a box")):
        with pytest.raises(InputError, match=message):
            editor.changed_scene(HANDWRITTEN, boxes, {"box": name, "add": True, "position": [0, 0]})
    other = HANDWRITTEN.replace('angle="radian"', 'eulerseq="zyx"')
    with pytest.raises(InputError, match="turn the box in the file"):
        editor.changed_scene(other, boxes, {"box": "quoted", "turn": 10})


# ------------------------------------------------------------------ files


def begin(folder, behavior, place="lab"):
    """An editor of a copy of an environment, and its scenario."""
    shutil.copytree(ENVS / place, folder)
    config = validate(StudioConfig, {"environment": str(folder), "behavior": behavior})
    return Editor(config), making.scenarios(config)[0]


def test_sets_are_changed_checked_and_saved(tmp_path):
    edited, scenario = begin(tmp_path / "mine", "handcrafted")
    before, file = edited.texts["handcrafted.yaml"], tmp_path / "mine" / "handcrafted.yaml"
    goal = {"set": "empty_1", "point": ["goals", 0], "position": [2.7, -0.2]}
    after = edited.change(goal, scenario)
    row = after.behavior.data.names.index("empty_1")
    np.testing.assert_allclose(after.behavior.data.goal[row, 0], [2.7, -0.2], rtol=1e-6)
    assert editor.same_shapes(scenario.behavior.data, after.behavior.data)
    text = edited.texts["handcrafted.yaml"]
    for point, place, message in (
        (["goals", 0], [-6.3, 0], r"handcrafted.yaml:\d+:\d+: sets.empty_1.goals\[0\]: .* is inside an obstacle"),
        (["walkers", 0, "loop", 1], [3.0, -1.0], "handcrafted.yaml:.*obstacle"),
        (["walkers", 0, "loop", 1], [-5.7, -2.3], "the next waypoint is only"),
        (["goals", 0], [20, 0], "is not on the floor"),
    ):
        with pytest.raises(InputError, match=message):
            edited.change({"set": "empty_1", "point": point, "position": place}, after)
        assert edited.texts["handcrafted.yaml"] == text == Path(edited._scratch.name, "handcrafted.yaml").read_text()
    for change, message in (({"node": "door", "radius": 1}, "has no graph"), ({}, "it names no node")):
        with pytest.raises(InputError, match=message):
            edited.change(change, after)
    page = edited.of_page(after)
    assert page["graph"] is None and page["sets"]["empty_1"]["goals"][0] == (2.7, -0.2, 0) and page["changes"] == 1
    edited.save()
    assert file.read_text() == text and comments(text) == comments(before)
    after = edited.undo(after)
    assert edited.texts["handcrafted.yaml"] == before
    np.testing.assert_array_equal(after.behavior.data.goal, scenario.behavior.data.goal)
    file.write_text(text + "# a colleague\n")
    with pytest.raises(InputError, match="has changed meanwhile"):
        edited.save()
    assert file.read_text().endswith("# a colleague\n")


def test_obstacles_are_changed_checked_and_saved_with_the_graph(tmp_path):
    """One list of changes over the files; the floor is that of an environment that is loaded from the saved files."""
    edited, scenario = begin(tmp_path / "mine", "graph")
    saved = dict(edited.texts)
    after = edited.change({"box": "screen", "position": [1.9, 2.0], "turn": 5}, scenario)
    after = edited.change({"node": "door", "position": [-2.9, -0.7]}, after)
    texts = dict(edited.texts)
    for change, message in (
        ({"box": "screen", "position": [-2.9, -0.7]}, "graph.yaml:.*nodes.door.position: .* inside an obstacle"),
        ({"box": "screen", "height": -1}, "scene.xml.*size"),
        ({"box": "screen", "size": [1e-5, 1]}, "scene.xml.*screen"),
        ({"box": "screen", "turn": None}, "turn: None is no number"),
        ({"box": "screen", "position": [float("nan"), 0]}, "is no number"),
        ({"node": "door", "position": [1.9, 2.0]}, "nodes.door.position: .* inside an obstacle"),
    ):
        with pytest.raises(InputError, match=message):
            edited.change(change, after)
        assert edited.texts == texts
    assert edited.difference().count("+++") == 2
    assert len(edited.save()) == 2
    loaded = environment.load(tmp_path / "mine")
    trees.assert_equal(loaded, after.environment)
    while edited.history:
        after = edited.undo(after)
    assert edited.texts == saved
    for name in ("graph.yaml", "scene.xml"):
        assert Path(edited._scratch.name, name).read_text() == saved[name] == text_of("lab", name)


def test_only_files_of_the_folder_are_copied(tmp_path):
    """Those that the scene reads, and not recordings beside it; nothing is written elsewhere."""
    folder = tmp_path / "mine"
    shutil.copytree(ENVS / "lab", folder)
    scene = (folder / "scene.xml").read_text()
    (folder / "parts").mkdir()
    for name in ("mine/parts/inner.xml", "outer.xml"):
        (tmp_path / name).write_text(mjcf.scene())
    (folder / "recording.npz").write_bytes(b"0" * 1000)
    (folder / "scene.xml").write_text(mjcf.with_includes(scene, "parts/inner.xml", "../outer.xml"))
    before = set(Path(tempfile.gettempdir()).glob("outer.xml"))
    edited = Editor(validate(StudioConfig, {"environment": str(folder)}))
    with pytest.raises(InputError, match="outer.xml.*no such file"):
        edited.change({"box": "screen", "position": [1.9, 2.0]}, None)
    copies = {str(path.relative_to(edited._scratch.name)) for path in Path(edited._scratch.name).rglob("*.*")}
    assert copies == {"environment.yaml", "graph.yaml", "handcrafted.yaml", "scene.xml", "parts/inner.xml"}
    assert set(Path(tempfile.gettempdir()).glob("outer.xml")) == before


def test_obstacles_of_the_package_and_of_worlds_stay():
    edited = Editor(validate(StudioConfig, {"environment": "lab"}))
    scenario = making.scenarios(edited.config)[0]
    with pytest.raises(InputError, match="an environment of the package; copy the folder"):
        edited.change({"box": "screen", "position": [1.9, 2.0]}, scenario)
    assert edited.of_page(scenario)["boxes"] is None
    edited = Editor(validate(StudioConfig, {"environment": "worlds:rooms:1"}))
    with pytest.raises(InputError, match="is made from a seed; copy the folder"):
        edited.save()
