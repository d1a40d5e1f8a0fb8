"""Inputs that were made wrong at random, and what reads them: run as a program, this file is the worker of test_fuzz.

    python tests/support/fuzzing.py SEED FIRST COUNT FOLDER

prints a line of JSON before and after each mutant. A mutant that takes more than 5 s of processor time, or waits for
more than a minute, ends the process, as an abort inside of MuJoCo does; the test sees who it was and goes on.
"""

import copy
import functools
import io
import json
import os
import random
import re
import resource
import shutil
import signal
import sys
import traceback
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import yaml

HANG, WAIT = 5.0, 60.0  # s of processor time, and of waiting
MEMORY = 10**9  # bytes that a mutant may take
INFINITE = ("walked", "cost", "distance", "arrival_angle")  # fields in which inf stands for what is not there
UNSAID = re.compile(  # how Python's and other packages' own words begin
    "Traceback|pydantic|invalid literal|could not convert|cannot convert|not supported between|object is not"
    "|has no attribute|unexpected keyword|out of range|out of bounds|cannot reshape|broadcast|shape mismatch|zero-size"
    "|unhashable|recursion"
)
NASTY = [
    "nan", ".nan", "inf", "-inf", ".inf", "1e39", "-1e39", "1e300", "1e999", "1e-50", "0", "-1", "-0.0", "1e6", "2.5",
    "99999999999999999999", "9" * 5000, "4294967296", "true", "null", "~", "''", "[]", "{}", "[1, 2]", "{a: b}",
    "!!binary aGVsbG8=", "!!set {a, b}", "!!timestamp 2001-01-01", "!!bool abc", "!!int abc", "!!float x", "!!str 3",
    "!!str {b: c}", "!!str [1, 2]",
    "[" * 3000, "&a [*a]", "<<", "*nobody", "0x10", "1_000", "60000", "100000", "\"\\ud800\"", "\"\\UFFFFFFFF\"",
    "ümläut 漢字", "x" * 3000, "a" * 200_000, "\x00", "\t", "%", "#", "@", "-", "../../etc/passwd", "all", "nobody",
    "1 2 3 4 5 6 7", "0 0 0", "NaN", "Infinity", "1e1000000", "-", "1,2", "'", '"', "<", ">", "&amp;", "&lt;", "]]>",
]  # fmt: skip
BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{chr(98 + k)}: &{chr(98 + k)} [{', '.join(['*' + chr(97 + k)] * 9)}]\n" for k in range(9)
)
MERGES = "a: &a {k: 1, l: 2}\n" + "".join(
    f"{chr(98 + k)}: &{chr(98 + k)} {{<<: [{', '.join(['*' + chr(97 + k)] * 9)}]}}\n" for k in range(12)
)


GATE = (
    "load", "read_yaml", "read_json", "read_json_lines", "read_text", "read_bytes", "read_rows", "read_arrays",
    "open_file", "check_json", "parse_json", "parse_file_json", "Database", "xml_tree", "vertices", "open_bag",
)  # fmt: skip
"""Functions of ``sean_jax.io.files``, and of bags, through which all that comes from outside is read."""

READERS = {
    "environment": ("world/environment.py _settings",),
    "scene": ("world/environment.py _settings",),
    "graph": ("graph/annotation.py read_graph",),
    "handcrafted": ("people/handcrafted/annotation.py read_sets",),
    "recording": ("people/recordings/reading.py column_names", "people/recordings/reading.py _read_columns"),
    "companions": ("people/recordings/reading.py read_companions",),
    "trajectory": ("studies/survey/ratings.py read",),
    "ratings": ("studies/survey/ratings.py read_answers",),
    "variants": ("studies/survey/ratings.py _variants",),
    "study": ("studies/survey/study.py read",),
    "map": ("world/ros_map.py read_map", "world/ros_map.py _is_image", "world/ros_map.py _image"),
    "manifest": ("learning/dataset.py open_dataset", "learning/dataset.py check_manifest"),
    "policy": ("learning/networks.py read_network_config", "learning/networks.py read_method"),
    "agent": ("learning/policy.py read_options", "learning/policy.py _read_packed"),
    "log": ("learning/trainer.py read_metrics",),
    "config": ("evaluation/run_folder.py read_config",),
    "code": ("config/user_parts.py _bytes",),
    "training": ("evaluation/run_folder.py read_config", "config/mdp_options.py EnvConfig.identity"),
    "csv": ("io/trajectories.py _Csv.read", "io/trajectories.py _header"),
    "parquet": (
        "io/trajectories.py _Parquet.read",
        "io/trajectories.py _Parquet.read.blocks",
        "io/trajectories.py _header",
    ),
    "batch": ("evaluation/batches.py RunFolder.load",),
    "cache": ("io/cache.py _read",),
    "result": ("studies/experiments/benchmark.py _read_content", "studies/experiments/benchmark.py read_track"),
    "run": (
        "evaluation/compare.py _own_figures",
        "evaluation/compare.py _replay",
        "evaluation/run_folder.py read_episodes",
    ),
    "forces": ("social_forces/presets.py read_constants",),
    "randomization": ("mdp/randomization.py as_randomization",),
    "sensor": ("sensors/sensor_settings.py as_sensor",),
    "import": ("robots/importing.py _read", "robots/urdf_reading.py read_urdf"),
    "mesh": ("robots/urdf_reading.py _shape",),
    "identity": ("config/workspace.py read_identity",),
    "row": ("studies/validation/checks.py load",),
    "trial": ("web/studio/trial.py read_trial", "web/studio/trial.py _parsed", "web/studio/trial.py _recover_file"),
    "answers": ("studies/survey/answers.py Answers.__init__",),
    "rosbag metadata": (
        "ros/bag_opening.py BoundedFile.__init__",
        "ros/bag_opening.py BoundedPath.read_text",
        "ros/bag_opening.py _files",
        "ros/bag_opening.py open_bag",
        "ros/bag_tables.py read_bag",
    ),
}
"""Kind -> the functions that read it, as FILE FUNCTION. (Robots and bodies are read in ``files`` itself.)"""

ELSEWHERE = {
    "web/local_server.py parse": "messages of test_hostile",
    "ros/rosbridge.py Server._handle": "messages of test_hostile",
    "web/studio/editor.py Editor._take": "a graph or sets, as load_graph and load_handcrafted",
    "web/studio/address.py recall": "an address that others cannot write: test_studio",
    "learning/policy.py demonstration_config": "the config.json of load_policy",
    "learning/policy.py describe_agent": "the config.json of load_agent",
    "learning/policy.py pack": "the config.json of load_agent",
    "studies/inverse_graph/__init__.py _words": "a graph as in load_graph",
    "studies/validation/replay.py _read_results": "results.json: test_validate",
    "config/workspace.py Workspace.load": "parts whose readers look at them",
}
"""Readers of outside data without a kind of their own -> what tries them."""

OWN = {
    "simulation/making.py _made",
    "io/cache.py source",
    "config/user_parts.py digest",
    "evaluation/run_plan.py _read_inputs",
    "studies/inverse_graph/__init__.py run",
    "studies/validation/checks.py _code",
    "web/studio/editor.py Editor.__init__",
    "web/studio/editor.py Editor.save",
    # data of the package, and of the machine
    "config/components.py aliases",
    "cli/doctor.py _memory",
    "evaluation/bag_command.py write",
    "evaluation/list_command.py ",
    "evaluation/list_command.py _environment",
    "evaluation/list_command.py _robot",
    "evaluation/table.py ",
    "learning/lerobot.py ",
    "metrics/__init__.py _read_metrics",
    "web/replay/__init__.py script",
    "social_forces/presets.py _read_presets",
    "studies/calibration/fitting.py ",
    "studies/calibration/loss.py ",
    "studies/experiments/benchmark.py _read_tracks",
    "studies/experiments/benchmark.py protocol_digest",
    "studies/experiments/benchmark.py device",
    "studies/experiments/measures.py ",
    "studies/experiments/page.py ",
    "studies/validation/checks.py ",
    "web/studio/__init__.py serve",
    "web/studio/address.py _place",
    "studies/survey/__init__.py _serve",
    "studies/survey/study.py templates",
    "io/trajectories.py ",
    "io/trajectories.py save_trajectory",
}
"""Who reads bytes that are only copied or digested, or data of the package itself."""


def readers() -> set[str]:
    """FILE FUNCTION of each function of the package that calls one of ``GATE``, from its source; "" is a module."""
    import ast

    from support.checkout import callers

    def of_the_gate(call: ast.Call) -> bool:
        if isinstance(call.func, ast.Attribute):
            return call.func.attr in GATE and ast.unparse(call.func.value) == "files"
        return isinstance(call.func, ast.Name) and call.func.id in GATE and call.func.id != "load"

    return {place for place in callers(of_the_gate) if not place.startswith("io/files/")}


class Refused(Exception):
    """The program has done without the input, and said so where it should."""


class Kind:
    """A kind of input: the files that it starts from, the one that is made wrong, and who reads it."""

    def __init__(self, files: dict[str, bytes], wrong: tuple[str, ...], load: Callable[[Path], Any], share: int):
        self.files, self.wrong, self.load, self.share = files, wrong, load, share


def hall() -> dict[str, bytes]:
    """A small environment."""
    from support.mjcf import HALL

    settings = "name: hall\nfloor: [-5, -4, 5, 4]  # m\npeople: 4\nsource: made up\n"
    return {"environment.yaml": settings.encode(), "scene.xml": HALL.encode()}


def walks() -> bytes:
    """Three people who walk at 1.2 m/s, as ETH is recorded, with groups and facing."""
    lines = ["frame,ped_id,x_m,y_m,vx_mps,vy_mps,theta_rad,group_id"]
    lines += [
        f"{780 + 6 * k},{person},{0.48 * k + 0.3 * person:.3f},{person},1.2,0.0,{0.1 * person},{person % 2 - 1}"
        for k in range(12)
        for person in range(3)
    ]
    return ("\n".join(lines) + "\n").encode()


def robot_among_people() -> bytes:
    """A robot that passes a person and a table, in the format of SocNav3."""
    goal = {"type": "go-to", "human": None, "x": 2.0, "y": 0.0, "angle": 0.0, "pos_threshold": 0.3}
    disc = {"type": "circle", "width": 0.6, "length": 0.6}
    table = {"id": 1, "type": "table", "x": 1.0, "y": 2.0, "angle": 0.5, "shape": {**disc, "type": "rectangle"}}
    sequence = [
        {"timestamp": 0.2 * k, "robot": {"shape": disc, "x": 0.1 * k, "y": 0.0, "angle": 0.0}, "goal": goal,
         "people": [{"id": 4, "x": 2.0 - 0.2 * k, "y": 1.0, "angle": 3.1}], "objects": [table]}
        for k in range(12)
    ]  # fmt: skip
    return json.dumps({"walls": [[-1.0, -2.0, 5.0, -2.0]], "sequence": sequence}, indent=1).encode()


def image(form: str = "PNG") -> bytes:
    """A map of 40 x 30 cells with walls and a pillar."""
    import numpy as np
    from PIL import Image

    shades = np.full((30, 40), 254, np.uint8)
    shades[[0, -1]] = shades[:, [0, -1]] = 0
    shades[10:14, 20:26] = 0
    stream = io.BytesIO()
    Image.fromarray(shades).save(stream, form)
    return stream.getvalue()


def dataset(folder: Path) -> dict[str, bytes]:
    """Two shards of two episodes of nothing."""
    import numpy as np

    from sean_jax.learning import dataset

    manifest = {
        "command": "sean collect", "options": {"seed": 0}, "hours": 0.01, "batch": 2, "seconds": 6,
        "streams": ["join_group", "leave_group"], "situations": ["empty", "cross_path"], "rate": 1.0,
        "camera": {"width": 8, "height": 6, "fovy": 60.0, "far": 10.0}, "robot": {"name": "kuri", "max_speed": 0.5},
    }  # fmt: skip
    made = dataset.create_dataset(folder, manifest)
    for stream in (0, 1):
        rows = {name: np.zeros((2, 6, *shape), kind) for name, (shape, kind) in made.fields.items()}
        made.commit(stream, dataset.EpisodeBatch(rows, np.array([6, 4]), np.array([True, False])))
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def policy(folder: Path) -> dict[str, bytes]:
    """A network as training keeps it."""
    import jax
    import jax.numpy as jnp
    import optax

    from sean_jax.learning.checkpoints import Checkpoints
    from sean_jax.learning.networks import describe_imitation, read_network_config
    from sean_jax.learning.trainer import TrainState, begin_best

    config = {"width": 8, "flags": True, "image": [12, 16], "situations": list(names()), "seed": 0, "epochs": 2}
    folder.mkdir(parents=True)
    (folder / "config.json").write_text(json.dumps(config, indent=1))
    description = describe_imitation(read_network_config(folder / "config.json"), time_step=0.1)
    agent = description.init(jax.random.key(0))
    optimizer = optax.sgd(0.1).init(agent.parameters)
    state = TrainState(agent, optimizer, begin_best(agent, ()), jnp.ones((), jnp.int32))
    keeper = Checkpoints(folder)
    keeper.save(jax.tree.map(lambda leaf: leaf[None], state), 1, 1.0)
    keeper.wait()
    keeper.manager.close()
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def names() -> tuple[str, ...]:
    from sean_jax.classifiers import SITUATION_SETS

    return tuple(SITUATION_SETS["paper"])


@functools.cache
def lab() -> Any:
    from sean_jax.world import environment

    return environment.load("lab")


def timetable(graph: bytes) -> bytes:
    """The lab's graph.yaml with intervals of an entrance, and a bus."""
    times = b"entrance: {rate: 0.1, times: [[0, 300], [900, 1200]]}"
    bus = b"{entrance: {bus: {every: 120, people: 8, first: 20}}, kind: waypoint, position: [0, -0.9]"
    for old, new in ((b"entrance: 0.1", times), (b"{kind: waypoint, position: [0, -0.9]", bus)):
        assert graph.count(old) == 1
        graph = graph.replace(old, new)
    return graph


def load_graph(folder: Path) -> Any:
    from sean_jax.graph import annotation

    return annotation.read_graph(folder / "graph.yaml", lab(), trips=True)


def load_handcrafted(folder: Path) -> Any:
    from sean_jax.people.handcrafted import build, read_sets

    return build(read_sets(folder, lab()).sets)


def load_environment(folder: Path) -> Any:
    from sean_jax.world import environment

    place = environment.load(folder)
    return place, environment.default_people(folder)


def load_robot(folder: Path) -> Any:
    from sean_jax import robots

    return robots.load(folder / "robot.xml", "twin")


def load_body(folder: Path) -> Any:
    from sean_jax import robots

    def controller(command: Any, data: Any, memory: Any) -> Any:
        return data.ctrl, memory

    return robots.articulated(folder / "body.xml", controller, radius=0.3, max_speed=1.0, max_turn_rate=1.0)


def load_recording(folder: Path) -> Any:
    from sean_jax.people import recordings

    path, found = folder / "people.csv", []
    readers: list = [
        lambda path, name=name: recordings.read(path, name, 1.0 if name == "csv" else None)
        for name in recordings.FORMATS
    ]
    readers.append(lambda path: recordings.read(path, time_step=0.1))
    refused = None
    for reader in readers:  # who needs a column more may refuse, and the others read
        try:
            found.append(reader(path))
        except ValueError as error:
            check_error(error, "people.csv")
            refused = error
    if not found and refused is not None:
        raise refused
    return found


def load_trajectory(folder: Path) -> Any:
    from sean_jax.studies.survey import ratings

    episode = ratings.read(folder / "trajectory.json")
    return episode._asdict(), ratings.measure(episode)


def load_ratings(folder: Path) -> Any:
    from sean_jax.studies.survey import ratings

    return ratings.read_answers(folder / "ratings.json", {1: None, 2: None}).model_dump()


def load_map(folder: Path) -> Any:
    from sean_jax.world import environment, ros_map

    made = folder / "made"
    try:
        ros_map.import_map(folder / "map.yaml", made)
        return environment.load(made)
    finally:
        shutil.rmtree(made, ignore_errors=True)


def load_dataset(folder: Path) -> Any:
    from sean_jax.learning import dataset

    data = dataset.open_dataset(folder)
    data.fingerprint()
    lost = data.damaged_shards()
    return data.recording(data.episodes) if not lost else (data.example_count, data.stream_rows, data.row_bytes)


def load_policy(folder: Path) -> Any:
    import dataclasses

    from sean_jax import robots
    from sean_jax.core.data_types import Scenario
    from sean_jax.learning.policy import load

    told = tuple((name, None) for name in names())
    nothing: dict[str, Any] = dict.fromkeys(field.name for field in dataclasses.fields(Scenario))
    looked_at = {"situations": told, "robot": robots.load("kuri", "twin"), "time_step": 0.1}
    scenario = Scenario(**nothing | looked_at)
    return load(folder, scenario).params


def walk(folder: Path, name: str) -> dict[str, bytes]:
    """Two episodes of a robot and two people, one of whom comes late, as a table."""
    from sean_jax.io.trajectories import save_trajectory

    save_trajectory(frames(), folder / name, time_step=0.1, situations=("empty", "cross_path"))
    return {name: (folder / name).read_bytes()}


def frames() -> Any:
    import jax
    import numpy as np

    from sean_jax.core.data_types import Trajectory

    t = np.arange(1, 9, dtype=np.float32) / 10
    there = np.stack([t > 0, t > 0.4], -1)
    along, ahead = np.stack([0.5 * t, t], -1), np.tile(np.float32([0.6, 0.8]), (8, 1))
    both = lambda values: np.where(there[..., None], np.stack([values, values + 1], 1), np.float32(0))  # noqa: E731
    whole: dict[str, Any] = dict(
        position=along, heading=ahead, velocity=ahead / 2, action=ahead / 3, goal=ahead * 4, people=both(along),
        people_velocity=both(ahead), people_heading=np.where(there[..., None], ahead[:, None], np.float32(0)),
        group=np.where(there, [0, -1], -1).astype(np.int32), present=there,
        situations=np.stack([t > 0.2, t < 0.2], -1), active=t < 0.75,
    )  # fmt: skip
    return jax.tree.map(lambda leaf: np.stack([leaf, leaf]), Trajectory(**whole))


def load_walk(folder: Path) -> Any:
    """The arrays, held against the file as Python's and Arrow's own readers have it."""
    import csv

    import numpy as np

    from sean_jax.io.trajectories import load_trajectory

    path = next((path for path in folder.iterdir() if path.stem == "walk"), folder / "walk.csv")
    found = load_trajectory(path)
    if path.suffix == ".csv":
        lines = path.read_text(encoding="utf-8-sig").splitlines()
        rows = list(csv.DictReader(lines[1:]))
        header = json.loads(lines[0][len("# sean_jax ") :])
    else:
        import pyarrow.parquet

        table = pyarrow.parquet.read_table(path)
        rows, header = table.to_pylist(), json.loads(table.schema.metadata[b"sean_jax"])
    episode = [int(float(row.get("episode", 0))) for row in rows]
    frame, who = ([int(float(row[name])) for row in rows] for name in ("frame", "id"))
    shape = (max(episode) + 1, max(frame) + 1, header["people"])
    lead = shape[:2] if "episode" in rows[0] else shape[1:2]
    assert found.present.shape == (*lead, shape[2]) and found.situations.shape == (*lead, len(header["situations"]))
    assert len({*zip(episode, frame, who, strict=True)}) == len(rows), "somebody is twice in a frame"
    assert found.present.sum() == sum(each >= 0 for each in who)
    for row, e, t, k in zip(rows, episode, frame, who, strict=True):
        at = (e, t) if "episode" in row else (t,)
        place = found.position[at] if k < 0 else found.people[(*at, k)]
        faces = found.heading[at] if k < 0 else found.people_heading[(*at, k)]
        assert np.float32(row["x"]) == place[0] and np.float32(row["y"]) == place[1], "another place"
        assert np.abs(place).max() <= 1e4 and abs(float(row["time"]) - header["time_step"] * (t + 1)) < 1e-5 * (t + 1)
        assert abs(np.hypot(*faces) - 1) < 2e-3 or not faces.any(), "no unit vector"
        if k < 0:
            assert float(row["active"]) in (0, 1) and float(row["active"]) == found.active[at]
    return found.replace(action=np.zeros(2))


def batch(folder: Path) -> dict[str, bytes]:
    """A finished batch of two episodes of a run."""
    import jax
    import numpy as np

    from sean_jax.config import RunConfig
    from sean_jax.evaluation.batches import FinishedBatch, RunFolder, Totals
    from sean_jax.evaluation.run_plan import identity_of

    counts = np.arange(6, dtype=np.int32).reshape(2, 3)
    both = Totals(counts, np.eye(2, dtype=np.int32), counts[:, :2], np.arange(4, dtype=np.int32), np.float32(0.1),
                 np.ones(1, np.int32))  # fmt: skip
    metrics = {"path_length": np.ones(2, np.float32), "time_in_situation": np.ones((2, 3), np.float32)}
    ended = np.array([True, False]), np.array([False, True]), np.array([8, 7], np.int32)
    shown = [jax.tree.map(lambda leaf: leaf[k], frames()) for k in range(2)]  # noqa: B023
    RunFolder(folder, identity_of(RunConfig())).save(0, FinishedBatch(*ended, metrics, both, shown, 1.5))
    return {"batch.npz": (folder / "unfinished" / "batch-00000000-2.npz").read_bytes()}


def load_batch(folder: Path) -> Any:
    import numpy as np

    from sean_jax.config import RunConfig
    from sean_jax.evaluation.batches import PLACE, RunFolder
    from sean_jax.evaluation.run_plan import identity_of

    (folder / PLACE).mkdir(exist_ok=True)
    shutil.copytree(folder, run := folder / "run", ignore=shutil.ignore_patterns(PLACE, "batch.npz"))
    kept = RunFolder(run, identity_of(RunConfig()))
    kept.place.mkdir()
    if os.path.lexists(folder / "batch.npz"):
        (folder / "batch.npz").rename(kept._file(0, 2))
    found = kept.load(0, 2)
    if found is None:  # nothing is there, and so it is made anew
        raise Refused("there is none")
    assert found.completed.shape == found.timed_out.shape == found.steps.shape == (2,)
    assert found.completed.dtype == found.timed_out.dtype == bool and (found.steps >= 0).all() and found.seconds >= 0
    assert all(len(values) == 2 for values in found.metrics.values()) and (found.totals.heat >= 0).all()
    for each in found.frames:
        steps, people = each.present.shape
        assert each.people.shape == (steps, people, 2) and each.position.shape == (steps, 2) == each.action.shape
        assert each.active.shape == (steps,) and each.active.dtype == bool and each.group.dtype.kind == "i"
    return [each.replace(action=np.zeros(2)) for each in found.frames], found.totals


def table(folder: Path) -> dict[str, bytes]:
    """A table in the user's cache."""
    os.environ["XDG_CACHE_HOME"] = str(folder)
    from sean_jax.io import cache

    cache.load_or_build("numbers", (), [1.0], lambda: NUMBERS)
    (path,) = (folder / "sean_jax" / "tables").iterdir()
    return {"table.npz": path.read_bytes(), "name": path.name.encode()}


NUMBERS: dict[str, Any] = {}


def load_table(folder: Path) -> Any:
    """What is damaged is made anew, and nobody notices; the tables of other kinds stay as they are."""
    from unittest import mock

    from sean_jax.io import cache

    environ = mock.patch.dict(os.environ, XDG_CACHE_HOME=str(folder / "cache"))
    with environ, mock.patch.object(cache, "_recent", type(cache._recent)()):
        return load_own_table(folder)


def load_own_table(folder: Path) -> Any:
    """The table in a cache of its own."""
    import numpy as np

    from sean_jax.io import cache

    place = folder / "cache" / "sean_jax" / "tables" / (folder / "name").read_text()
    place.parent.mkdir(parents=True)
    if os.path.lexists(folder / "table.npz"):
        (folder / "table.npz").rename(place)
    built = []
    found = cache.load_or_build("numbers", (), [1.0], lambda: built.append(1) or NUMBERS)
    for name, values in NUMBERS.items():
        np.testing.assert_array_equal(found[name], values)
    if built:
        raise Refused("it was made anew")
    return found


def run(folder: Path) -> dict[str, bytes]:
    """What `sean compare` reads of a run of four episodes."""
    from sean_jax.web import replay

    page = replay.element({"title": "mine", "episodes": [{"frames": 3}]})
    head = "episode,task,completed,timed_out,seconds,path_length,intimate_robot_on_person,near,path_length__empty"
    rows = [
        f"{k},join_group,{'True,False' if k % 2 else 'False,True'},{20 + k}.000,5.{k},{k},.{k},1.5" for k in range(4)
    ]
    given = {"episodes.csv": "\n".join([head, *rows, ""]), "report.html": f"<html>{page}</html>"}
    own = {"title": "near", "unit": "s", "digits": 2, "definition": "Near.", "better": "lower", "completed_only": False}
    given["summary.json"] = json.dumps({"own_metrics": {"near": own}})
    return {"config.yaml": described(), **{name: text.encode() for name, text in given.items()}}


def load_run(folder: Path) -> Any:
    import csv

    from sean_jax.evaluation import compare

    found = compare.read_run(folder)
    rows = list(csv.DictReader((folder / "episodes.csv").read_text(encoding="utf-8-sig").splitlines()))
    assert [int(float(row["episode"])) for row in rows] == list(range(len(found.tasks)))
    for row, seconds, done in zip(rows, found.columns["seconds"], found.columns["completed"], strict=True):
        assert 0 <= float(row["seconds"]) == seconds <= 86_400 and done in (0, 1)
    assert (found.replay is None) == bool(found.no_replay)
    compare.page(compare.differences([found, found]), [found, found], compare.summarize([found, found]))
    if found.no_replay:
        raise Refused(found.no_replay)
    return None


def result(folder: Path) -> dict[str, bytes]:
    """A complete result of a protocol of two tracks of 20 episodes."""
    import pytest

    from support.benchmark_results import place, smaller

    smaller(pytest.MonkeyPatch())  # to the end of this process
    made = place(folder, "go_to_goal", 20, 0)
    return {path.name: path.read_bytes() for path in made.iterdir() if path.suffix in (".json", ".npz")}


def load_result(folder: Path) -> Any:
    """What is changed has the checksum and the digests of the change, as an author would write them."""
    from sean_jax.config import user_parts
    from sean_jax.studies.experiments import benchmark

    file = folder / "result.json"
    try:
        content = json.loads(file.read_bytes()) if file.is_file() else None
        for track in benchmark.TRACKS:
            if content["files"].get(track) and (folder / f"{track}.npz").is_file():
                content["files"][track] = user_parts.digest(folder / f"{track}.npz")
        content["checksum"] = benchmark.checksum(content)
        file.write_text(json.dumps(content), encoding="utf-8")
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        pass  # it is read as it is
    found = benchmark.check(folder)
    assert (found.policy != "orca") and found.episodes == 20 and found.tracks.keys() == benchmark.TRACKS.keys()
    for name, figure in found.scores.figures.items():
        assert figure.low <= figure.mean <= figure.high, name
    benchmark.table(found)
    return None


def load_forces(folder: Path) -> Any:
    """Constants, with which two people and a robot take a step."""
    import jax

    from sean_jax.social_forces import build

    forces = build(str(folder / "forces.yaml"))
    scenario, state = _start()
    return forces, jax.jit(_lab_step())(scenario.replace(forces=forces), state).pedestrians


def load_randomization(folder: Path) -> Any:
    """Bounds, with which a scenario is randomized."""
    import jax

    from sean_jax.mdp import as_randomization

    randomization, (scenario, _) = as_randomization(str(folder / "my.yaml")), _start()
    assert randomization is not None
    return randomization.apply(randomization.draw(jax.random.key(0), scenario), scenario).robot


@functools.cache
def _start() -> Any:
    import jax

    import sean_jax

    return _lab(), sean_jax.reset(_lab(), jax.random.key(0))


@functools.cache
def _lab_step() -> Any:
    import jax
    import jax.numpy as jnp

    import sean_jax

    return jax.jit(lambda scenario, state: sean_jax.step(scenario, state, jnp.zeros(2)))


def load_agent(folder: Path) -> Any:
    from sean_jax.learning import policy

    return policy.load_agent(folder, _lab())[1]


@functools.cache
def _lab() -> Any:
    import sean_jax

    return sean_jax.make("lab", behavior="random", people=2, dynamics="twin")


RATINGS = {
    "indices": [1, 2, 1],
    "descriptions": ["A robot."] * 3,
    "answers": {"0": 0.5, "1": 0.25, "2": 1},
    "age": "30",
}
OPTIONS = {
    "time_step": 0.1, "time_limit": 60.0, "goal_radius": 1.2, "hold_time": 5.0, "task_distance": [1.0, 6.0],
    "people": 4, "walking_groups": [0.5, 0.0], "congestion_cost": 1.0, "substeps": 2,
}  # fmt: skip


def load_options(folder: Path) -> Any:
    """The numbers that ``make`` is given; words are the command line's to check, and no file is."""
    from sean_jax.io import files
    from sean_jax.simulation import making

    given = files.read_json(folder / "options.json")
    if not isinstance(given, dict):
        raise Refused("options: no mapping")
    told: Any = {
        name: tuple(value) if isinstance(value, list) else value for name, value in given.items() if name in OPTIONS
    }
    return making.make("lab", task="join_group", dynamics="twin", **told)


def described() -> bytes:
    """The config.yaml of a run."""
    from sean_jax.config import GraphBehavior, RunConfig

    behavior = GraphBehavior(routing="edge", walking_groups=(0.5, 0.0), congestion_cost=1.0)
    run = RunConfig(environment="lab", behavior=behavior, people=4, time_limit=60.0, thresholds={"walking": 0.5})
    content = {"command": "sean run", "config": json.loads(json.dumps(run.identity()))}
    content |= {"copies": {"lab": "environment/lab"}, "sha256": {}}
    return yaml.safe_dump(content, sort_keys=False).encode()


def load_config(folder: Path) -> Any:
    """What `sean run --config` understands; parts are not made, for a file may name a program."""
    from sean_jax.cli import command_line
    from sean_jax.config import RunConfig, flags

    words = ["--config", str(folder / "config.yaml")]
    return command_line._read(RunConfig, flags.parse("run", RunConfig, words, configurable=True)).identity()


CODE = """import helper


def act(scenario, state, key):
    return helper.command(state)
"""
DEEP = [
    b"x=" + b"-" * 9000 + b"1", b"x=1" + b"+1" * 9000, b"x=x" + b"[0]" * 9000, b"(" * 9000, b"a;" * 900_000,
    b"import deep\n" * 9000, b"from . import deep\n", b"from ..... import x\n", b"# coding: nothing\n", b"\x00",
]  # fmt: skip


def load_code(folder: Path) -> Any:
    """A run whose policy is code that its file names, with its digest or that of ``CODE``: it is only read."""
    import hashlib

    from sean_jax import config
    from sean_jax.config import user_parts
    from sean_jax.core.errors import InputError
    from sean_jax.evaluation.run_folder import read_config

    file = folder / "deep.py"
    digest = hashlib.sha256(file.read_bytes() if file.is_file() else b"").hexdigest()
    if digest[0] in "01234567":  # somebody has changed the file
        digest = hashlib.sha256(CODE.encode()).hexdigest()
    (folder / "config.yaml").write_text(f"config: {{policy: 'deep.py:act'}}\nsha256: {{deep.py: {digest}}}\n")
    given = read_config(folder / "config.yaml").description
    try:
        user_parts.check_trust(config.validate(config.RunConfig, given, source=folder / "config.yaml"))
    except InputError as error:
        assert "is code, and" in str(error), error
    else:
        raise AssertionError("it is trusted")


def load_import(folder: Path) -> Any:
    from sean_jax.robots import importing

    file = folder / "cart.urdf"
    importing._Base(file, importing._read(file), importing.ImportSettings()).mjcf("cart")


def wheel() -> dict[str, bytes]:
    """A tetrahedron in each format of meshes."""
    import numpy as np

    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], "<f4")
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    triangles = np.zeros((4, 50), np.uint8)
    triangles[:, 12:48] = corners[faces].reshape(4, 9).view(np.uint8)
    stl = b"a wheel".ljust(80) + len(faces).to_bytes(4, "little") + triangles.tobytes()
    points = "\n".join(f"v {x:g} {y:g} {z:g}" for x, y, z in corners)
    obj = f"# a wheel\no wheel\n{points}\n" + "\n".join(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces) + "\n"
    return {"wheel.stl": stl, "wheel.obj": obj.encode(), "wheel.dae": COLLADA.encode()}


COLLADA = """<COLLADA version="1.4.1">
  <asset><unit name="centimeter" meter="0.01"/><up_axis>Z_UP</up_axis></asset>
  <library_geometries>
    <geometry id="wheel"><mesh>
      <source id="corners"><float_array id="numbers" count="12">0 0 0 10 0 0 0 10 0 0 0 10</float_array></source>
      <vertices id="vertices"><input semantic="POSITION" source="#corners"/></vertices>
    </mesh></geometry>
  </library_geometries>
  <library_visual_scenes><visual_scene id="scene">
    <node><translate>1 2 3</translate><rotate>0 0 1 90</rotate><scale>1 1 2</scale>
      <node><matrix>1 0 0 5 0 1 0 0 0 0 1 0 0 0 0 1</matrix><instance_geometry url="#wheel"/></node>
    </node>
  </visual_scene></library_visual_scenes>
</COLLADA>
"""


def load_mesh(folder: Path) -> Any:
    """The corners of each mesh, and a robot that wears them all."""
    from sean_jax.io.files import meshes
    from sean_jax.robots import importing
    from support.robot_files import CART

    worn = "".join(
        f'<collision><geometry><mesh filename="wheel{ending}"/></geometry></collision>' for ending in meshes.MESHES
    )
    file = folder / "cart.urdf"
    file.write_text(CART.replace('<link name="caster">', f'<link name="caster">{worn}'))
    found = [meshes.vertices(folder / f"wheel{ending}") for ending in meshes.MESHES]
    return found, importing._Base(file, importing._read(file), importing.ImportSettings()).mjcf("cart")


# Words of generated floors


WORDS = "rooms\n7\nwidth=16,depth=12,door=1.0:1.2\n"


def load_world(folder: Path) -> Any:
    """The floor of a family, a seed and words, each on a line, as ``sean worlds`` is told them."""
    from sean_jax.world import generated

    file = folder / "world.txt"
    if not file.is_file():
        raise Refused("world: no words")
    family, seed, words, *_ = [*file.read_bytes()[:20_000].decode("utf-8", "replace").split("\n"), "", "", ""]
    if not re.fullmatch("[0-9]{1,9}", seed):
        raise Refused("world: no seed")
    floor = generated.generate(family, int(seed), generated.parse(words))
    return floor.words, floor.environment


# A study: its description, and its file


STUDY = """title: Robots in a lab
consent: You may stop.
participants: 3
options: {environment: lab, people: 2, time_limit: 3, warm_up: 1}
questions: [navigation]
before:
  - {kind: number, name: age, text: "How old are you?", range: [18, 99], required: false}
trials:
  - {name: calm, watch: {policy: go_to_goal, seed: 3}}
  - {name: mine, drive: {seed: 4, view: plan}}
  - name: pair
    choose: [{policy: go_to_goal, seed: 5}, {policy: expert, seed: 5, name: careful}]
    questions: [{kind: text, name: why, text: "Why?", required: false}]
after:
  - {kind: choice, name: car, text: "Do you drive a car?", choices: [often, never]}
drivers: 8
address: https://study.example.org
"""


def answered(folder: Path) -> dict[str, bytes]:
    """The file of a study in which everybody has watched, driven, chosen and answered."""
    from unittest import mock

    from sean_jax.studies.survey import study
    from sean_jax.studies.survey.answers import FILE

    folder.mkdir()
    (folder / "study.yaml").write_text(STUDY)
    described = study.read(folder / "study.yaml")
    links = mock.patch(
        "sean_jax.studies.survey.answers.secrets.token_urlsafe", side_effect=(f"{k:022}" for k in range(10))
    )
    clock = mock.patch("sean_jax.studies.survey.answers.time.time", side_effect=(1.7e9 + k for k in range(10_000)))
    with links, clock:  # so that the bytes are the same again
        fill(folder, described)
    return {FILE: (folder / FILE).read_bytes()}


def fill(folder: Path, described: Any) -> None:
    """Begin a study, and let everybody take part."""
    from sean_jax.studies.survey.answers import Answers

    answers = Answers.begin(folder, described)
    film = {"timeStep": 0.1, "title": "", "episodes": [{"frames": 31, "title": "", "outcome": ""}]}
    for trial, side in ((0, 0), (2, 0), (2, 1)):
        answers.add_episode(trial, side, "expert", "completed", {"path_length": 3.0 + trial}, film)
    for participant in range(3):
        answers.consent(participant)
        answers.event(participant, "opened")
        for place, step in enumerate(answers.steps(participant)):
            for word in ("page", "began") if step.kind == "watch" else ("page",):
                answers.event(participant, f"{word} {place}")
            if step.kind == "drive":
                drive = answers.begin_drive(participant, place)
                answers.add_moments(drive, 0, [[0.5, 0.1, 1.0, 2.0, 0.3]] * 10)
                answers.end_drive(drive, "timed out", {"path_length": 3.0}, film)
            answers.show(participant, place)
            for question in step.questions:
                values = {"likert": 3, "choice": question.get("choices", ("",))[0], "number": 40, "text": "ü, =1"}
                answers.answer(participant, place, question["name"], values[question["kind"]])
            answers.finish(participant, place, place == 4)
        answers.event(participant, "closed")
    answers.close()


def load_study(folder: Path) -> Any:
    """A study, and each page that the server would send."""
    from sean_jax.studies.survey import study

    found = study.read(folder / "study.yaml")
    for participant in range(found.participants):
        json.dumps([step.model_dump() for step in found.steps(participant)], allow_nan=False)
    return None


def load_answers(folder: Path) -> Any:
    """All tables of a study's file, as bytes; each cell is read as the study has it."""
    import csv

    from sean_jax.studies.survey import export, report
    from sean_jax.studies.survey.answers import FILE, Answers

    answers = Answers(folder / FILE)
    try:
        rows = {}
        for name in export.TABLES:
            text = export.table(answers, name).encode()
            rows[name] = list(csv.DictReader(io.StringIO(text.decode(), newline="")))
        for drive in answers.drives():
            answers.recording(drive["id"])
        report.means(report.rated(answers))
        answers.secrets()
    finally:
        answers.close()
    for row in rows["answers.csv"]:
        assert 1 <= int(row["participant"]) <= answers.study.participants and 1 <= int(row["place"]) <= 5
        if row["kind"] == "likert":
            assert 1 <= int(row["value"]) <= 11
        if row["kind"] == "number":
            assert 18 <= float(row["value"]) <= 99
    for row in rows["pages.csv"]:
        assert float(row["dwell_s"]) >= float(row["hidden_s"]) >= 0 and int(row["reloads"]) >= 0
    return [float(row[name]) for row in rows["trajectories.csv"] for name in ("x", "y", "heading")]


CELLS = [
    None, "", "x", -1, 0, 2, 99, 10**12, 2**63 - 1, 1.5, -1.0, 1e300, float("inf"), b"", b"\x00\xff", "9" * 400,
    "[" * 3000, '"\\ud83d"', '"x"', "[]", "{}", "[[1, 2, 3, 4, 5]]", "[[1, 2]]", "[[NaN, 1, 1, 1, 1]]",
    '{"a": 1e999}', '{"a": "b"}', "NaN", "page 1", "page 99999", "early 1", "visible", "completed", "x" * 200_000,
]  # fmt: skip
ENDLESS = "WITH RECURSIVE n(a) AS (SELECT 1 UNION ALL SELECT a FROM n) SELECT a AS id, a AS step FROM n"
SCHEMES = [
    "DROP TABLE {0}", "ALTER TABLE {0} RENAME TO old", "ALTER TABLE {0} ADD COLUMN more", "CREATE TABLE more (a)",
    "CREATE INDEX more ON {0} (rowid)", "CREATE TRIGGER more AFTER INSERT ON {0} BEGIN DELETE FROM {0}; END",
    "CREATE VIEW more AS SELECT 1", "DELETE FROM {0}", "INSERT INTO {0} SELECT * FROM {0}",
    "UPDATE sqlite_master SET rootpage = rootpage + 1 WHERE name = '{0}'",
    "UPDATE sqlite_master SET sql = replace(sql, 'NOT NULL', '') WHERE name = '{0}'",
    "UPDATE sqlite_master SET sql = replace(sql, 'data BLOB NOT NULL', 'data BLOB AS (zeroblob(999999000))')",
    "UPDATE sqlite_master SET type = 'view', rootpage = 0,"
    f" sql = 'CREATE VIEW {{0}} AS {ENDLESS}' WHERE name = '{{0}}'",
]  # fmt: skip


def in_database(chance: random.Random, given: bytes) -> bytes:
    """A database with another cell, row, table, view or trigger."""
    import contextlib
    import sqlite3
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.sqlite"
        path.write_bytes(given)
        with contextlib.closing(sqlite3.connect(path, isolation_level=None)) as base:
            base.execute("PRAGMA writable_schema=ON")
            tables = [name for (name,) in base.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
            for _ in range(chance.choice((1, 1, 1, 3))):
                with contextlib.suppress(sqlite3.Error):  # a rule of the table refuses the change
                    base.execute(*another_row(chance, base, chance.choice(tables)))
            with contextlib.suppress(sqlite3.Error):
                base.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        return path.read_bytes()


def another_row(chance: random.Random, base: Any, table: str) -> tuple[str, tuple[Any, ...]]:
    """A statement that changes a cell, a row or the whole table, and its values."""
    columns = [row[1] for row in base.execute(f"PRAGMA table_info({table})")]
    where = f"rowid = (SELECT rowid FROM {table} ORDER BY rowid LIMIT 1 OFFSET {chance.randrange(12)})"
    how = chance.random()
    if how < 0.2 or not columns:
        return chance.choice(SCHEMES).format(table), ()
    if how < 0.3:
        return f"DELETE FROM {table} WHERE {where}", ()
    if how < 0.4:
        return f"UPDATE {table} SET {chance.choice(columns)} = {chance.choice(columns)} WHERE {where}", ()
    return f"UPDATE {table} SET {chance.choice(columns)} = ? WHERE {where}", (chance.choice(CELLS),)


def studies(folder: Path) -> dict[str, Kind]:
    """The kinds of a study."""
    return {
        "study": Kind({"study.yaml": STUDY.encode()}, ("study.yaml",), load_study, 10),
        "answers": Kind(answered(folder / "study"), ("study.sqlite",), load_answers, 10),
    }


def recorded_drive() -> bytes:
    """Three seconds that a person and a policy have driven, with a way back, as the studio records them."""
    lines: list[Any] = [{"version": 2, "options": {"environment": "lab", "people": 3, "seed": 0}, "episode": 4}]
    for second in range(3):
        commands = [[0.1 * second, -0.2 + 0.01 * step] for step in range(10)]
        lines.append({"commands": commands, "by_person": [step < 5 for step in range(10)]})
    lines += [{"rewind": 24}, {"commands": [[0.5, 0.0]], "by_person": [True]}, {"end": "completed"}]
    return "".join(json.dumps(line) + "\n" for line in lines).encode()


def load_trial(folder: Path) -> Any:
    """A drive, and what the page lists of it; another program's file in its folder is told."""
    import numpy as np

    from sean_jax.web.studio import trial

    path, place = folder / "000000.jsonl", folder / "drives" / trial.TRIALS
    place.mkdir(parents=True)
    if os.path.lexists(path):
        shutil.copy(path, place, follow_symlinks=False) if path.is_file() else os.rename(path, place / path.name)
    listed, told = trial.rows_of_page(folder / "drives"), trial.recover(folder / "drives")
    json.dumps(listed, allow_nan=False)
    assert all("Traceback" not in text and len(text) < 1000 for text in told), told
    drive = trial.read_trial(path if path.is_file() else place / path.name)
    assert drive.commands.ndim == 2 and drive.commands.shape[1] in (2, 3)
    assert (np.abs(drive.commands) <= trial.MAX_COMMAND).all()
    assert len(drive.by_person) == len(drive.commands)
    assert 0 <= drive.episode < 2**32 and isinstance(drive.options, dict)
    return drive.commands, drive.by_person


def in_json_lines(chance: random.Random, given: bytes) -> bytes:
    """A line that is wrong as a tree."""
    lines = given.split(b"\n")
    place = chance.randrange(max(1, len(lines) - 1))
    lines[place] = in_tree(chance, lines[place])
    return b"\n".join(lines)


TRAINING = """environment: lab
people: 4
scenarios: 8
steps: 1000
observations: [goal, people]
rewards: [default]
randomization: {kind: bounds, people: [0.5, 1.0]}
learning_rate: 0.001
sweep: ["learning_rate=0.001,0.0003"]
imitate: expert
"""
LOG = "".join(f'{{"epoch": {k}, "time": {k}.5, "return": -1.0, "completed": 0.5}}\n' for k in range(5))
SENSOR = "kind: depth\nname: eye\nwidth: 32\nheight: 24\nfar: 8\nerrors: {drop_out: 0.1}\n"
VARIANTS = '{"1": ["000000001.json"], "2": ["000000002.json"]}'


def load_companions(folder: Path) -> Any:
    from sean_jax.people import recordings

    tracks = recordings.read(folder / "people.csv", "csv", 1.0)
    return recordings.read_companions(folder / "groups.txt", tracks)


def load_training(folder: Path) -> Any:
    from sean_jax.cli import command_line
    from sean_jax.config import PPOConfig, flags

    words = ["ppo", "--config", str(folder / "config.yaml")]
    command_line._read(PPOConfig, flags.parse("train", PPOConfig, words, configurable=True)).identity()


def load_log(folder: Path) -> Any:
    from sean_jax.learning import trainer

    lines = trainer.read_metrics(folder)
    for line in lines:
        assert isinstance(line["epoch"], int) and line["time"] >= 0
    if len(lines) < LOG.count("\n"):
        raise Refused("it ends before a damaged line")


def load_identity(folder: Path) -> Any:
    from sean_jax.config import workspace

    workspace.difference(workspace.read_identity(folder / "identity.json") or {}, json.loads(IDENTITY))


IDENTITY = '{"options": {"seed": 0, "people": 4}, "versions": {"jax": "0.10"}, "parts": {"my.py": "abc"}}'


def load_sensor(folder: Path) -> Any:
    from sean_jax import robots, sensors

    sensors.as_sensor(str(folder / "eye.yaml"), robots.load("kuri", "twin"))


def load_variants(folder: Path) -> Any:
    from sean_jax.studies.survey import ratings

    if os.path.lexists(folder / "variants.json"):
        (folder / "variants.json").rename(folder / ratings.VARIANTS)
    ratings._variants(folder)


def load_row(folder: Path) -> Any:
    """A row that is not as it was saved is measured again, without a word."""
    from sean_jax.config import ValidateConfig
    from sean_jax.studies.validation import checks

    model, check = checks.model(), next(iter(checks.CHECKS.values()))
    place = checks._part(folder, check, model)
    place.parent.mkdir(parents=True, exist_ok=True)
    if os.path.lexists(folder / "row.json"):
        (folder / "row.json").rename(place)
    checks._provenance, before = (lambda model, options: {}), checks._provenance
    try:
        found = checks.load(folder, check, model, ValidateConfig())
    finally:
        checks._provenance = before
    if found is None:
        raise Refused("it is measured anew")


ROW = {
    "made_with": {},
    "check": "a",
    "model": "b",
    "verdict": "passes",
    "measured": "1",
    "reason": "",
    "numbers": {"x": 1.0},
    "curves": [],
    "axes": ["x", "y"],
    "pictures": [["a", "<svg/>"]],
    "seconds": 1.0,
}


def kinds(folder: Path) -> dict[str, Kind]:
    """Every kind of input, each with how many of a hundred mutants are of it."""
    import numpy as np

    from sean_jax.learning.policy import AGENTS
    from sean_jax.world.environment import ENVS
    from support.robot_files import CART, ROVER

    NUMBERS.update(ranges=np.arange(40.0).reshape(5, 8), marks=np.array([True, False]))
    constants = "preset: calibrated\nparameters:\n  repulsion.range: 0.1\n  walking.relaxation_time: 0.3\n"
    constants += "  headway.time: 0.7\n  evasion.horizon: 2.0\nprovenance: {fitted by: nobody}\n"
    bounds = "people: [0.25, 1.0]\nspeed: [0.6, 1.4]\nrobot.max_speed: [0.6, 1.2]\nsensors.drop_out: [0.0, 0.05]\n"
    agent = {name: (AGENTS["ppo"] / name).read_bytes() for name in ("config.json", "weights.npz")}
    read = lambda *names: {name: (ENVS / "lab" / name).read_bytes() for name in names}  # noqa: E731
    settings = "image: map.png\nresolution: 0.1\norigin: [-2.0, -1.5, 0.0]\nnegate: 0\noccupied_thresh: 0.65\n"
    chart = {"map.yaml": f"{settings}free_thresh: 0.196\nmode: trinary\n".encode(), "map.png": image()}
    trained = policy(folder / "policy")
    kept = sorted((name for name in trained if name.startswith("checkpoints")), key=lambda name: len(trained[name]))
    for name in ("walks", "cache", "run"):
        (folder / name).mkdir()
    measured, ranked = run(folder), result(folder / "ranked")
    return {
        "environment": Kind(hall(), ("environment.yaml",), load_environment, 10),
        "scene": Kind(hall(), ("scene.xml",), load_environment, 14),
        "graph": Kind({"graph.yaml": timetable(read("graph.yaml")["graph.yaml"])}, ("graph.yaml",), load_graph, 13),
        "handcrafted": Kind(read("handcrafted.yaml"), ("handcrafted.yaml",), load_handcrafted, 10),
        "robot": Kind({"robot.xml": (ENVS / "robots/kuri.xml").read_bytes()}, ("robot.xml",), load_robot, 14),
        "body": Kind({"body.xml": ROVER.encode()}, ("body.xml",), load_body, 6),
        "recording": Kind({"people.csv": walks()}, ("people.csv",), load_recording, 14),
        "trajectory": Kind({"trajectory.json": robot_among_people()}, ("trajectory.json",), load_trajectory, 8),
        "ratings": Kind({"ratings.json": json.dumps(RATINGS, indent=1).encode()}, ("ratings.json",), load_ratings, 6),
        "map": Kind(chart, ("map.yaml", "map.yaml", "map.png"), load_map, 10),
        **{
            f"map {ending}": Kind(
                {
                    "map.yaml": chart["map.yaml"].replace(b"map.png", b"map." + ending.encode()),
                    f"map.{ending}": image(form),
                },
                (f"map.{ending}",),
                load_map,
                4,
            )
            for ending, form in (("gif", "GIF"), ("tiff", "TIFF"), ("pgm", "PPM"), ("bmp", "BMP"), ("jpg", "JPEG"))
        },
        "mesh": Kind(wheel(), tuple(wheel()), load_mesh, 12),
        "world": Kind({"world.txt": WORDS.encode()}, ("world.txt",), load_world, 10),
        "manifest": Kind(dataset(folder / "dataset"), ("dataset.json",), load_dataset, 9),
        "policy": Kind(trained, ("config.json",), load_policy, 6),
        "agent": Kind(agent, ("config.json", "weights.npz"), load_agent, 6),
        "config": Kind({"config.yaml": described()}, ("config.yaml",), load_config, 6),
        "code": Kind({"deep.py": CODE.encode()}, ("deep.py",), load_code, 5),
        "options": Kind({"options.json": json.dumps(OPTIONS, indent=1).encode()}, ("options.json",), load_options, 6),
        "csv": Kind(walk(folder / "walks", "walk.csv"), ("walk.csv",), load_walk, 16),
        "parquet": Kind(walk(folder / "walks", "walk.parquet"), ("walk.parquet",), load_walk, 12),
        "batch": Kind(batch(folder / "run"), ("batch.npz",), load_batch, 12),
        "cache": Kind(table(folder / "cache"), ("table.npz",), load_table, 6),
        "checkpoint": Kind(trained, tuple(kept), load_policy, 10),
        "result": Kind(ranked, ("result.json", *(name for name in ranked if name.endswith(".npz"))), load_result, 10),
        "run": Kind(measured, ("episodes.csv", "episodes.csv", "report.html", "summary.json"), load_run, 12),
        "forces": Kind({"forces.yaml": constants.encode()}, ("forces.yaml",), load_forces, 10),
        "trial": Kind({"000000.jsonl": recorded_drive()}, ("000000.jsonl",), load_trial, 10),
        "randomization": Kind({"my.yaml": bounds.encode()}, ("my.yaml",), load_randomization, 6),
        **studies(folder),
        "companions": Kind({"people.csv": walks(), "groups.txt": b"0 2\n1\n"}, ("groups.txt",), load_companions, 6),
        "training": Kind({"config.yaml": TRAINING.encode()}, ("config.yaml",), load_training, 8),
        "log": Kind({"metrics.jsonl": LOG.encode()}, ("metrics.jsonl",), load_log, 6),
        "identity": Kind({"identity.json": IDENTITY.encode()}, ("identity.json",), load_identity, 6),
        "sensor": Kind({"eye.yaml": SENSOR.encode()}, ("eye.yaml",), load_sensor, 8),
        "variants": Kind({"variants.json": VARIANTS.encode()}, ("variants.json",), load_variants, 6),
        "row": Kind({"row.json": json.dumps(ROW, indent=1).encode()}, ("row.json",), load_row, 6),
        "import": Kind({"cart.urdf": CART.encode()}, ("cart.urdf",), load_import, 14),
        **bags(folder),
    }


# Bags of ROS messages


def drive() -> list[tuple[str, str, int, dict[str, Any]]]:
    """Topic, type, time [ns] and message: a robot, two people, commands and a goal for two seconds."""
    from sean_jax.ros import messages

    rows: list[tuple[str, str, int, dict[str, Any]]] = []
    for k in range(20):
        time = (10 + k) * messages.SECOND // 10
        head = messages.header("map", time)
        place = lambda x, y, k=k: {"position": messages.vector(x + 0.05 * k, y), "orientation": messages.NO_ROTATION}  # noqa: E731
        twist = messages.twist(0.3, 0.0, 0.1)
        links = [messages.transform("world", "map", time, messages.vector(1.0, 0.0), messages.NO_ROTATION)]
        people = [{"name": name, "position": messages.vector(0.1 * k, y)} for name, y in (("a", 1.0), ("b", 2.0))]
        odometry = {"header": head, "pose": {"pose": place(0.0, 0.0)}, "twist": {"twist": twist}}
        rows.append(("/tf", "tf2_msgs/msg/TFMessage", time, {"transforms": links}))
        rows.append(("/odom", "nav_msgs/msg/Odometry", time, odometry))
        rows.append(("/people", "people_msgs/msg/People", time, {"header": head, "people": people}))
        rows.append(("/cmd_vel", "geometry_msgs/msg/Twist", time, twist))
        if k == 0:
            rows.append(("/goal", "geometry_msgs/msg/PoseStamped", time, {"header": head, "pose": place(4.0, 0.0)}))
    return rows


def bag(folder: Path, form: str) -> dict[str, bytes]:
    """The files of the drive as a bag: ``bag`` of rosbag 1, or the folder of a rosbag2 with ``mcap`` or ``db3``."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2

    from sean_jax.ros import messages

    store, connections = messages.typestore(1 if form == "bag" else 2), {}
    path = folder / ("drive.bag" if form == "bag" else f"drive_{form}")
    plugin = StoragePlugin.SQLITE3 if form == "db3" else StoragePlugin.MCAP
    with Writer1(path) if form == "bag" else Writer2(path, version=9, storage_plugin=plugin) as writer:
        pack = store.serialize_ros1 if form == "bag" else store.serialize_cdr
        for topic, kind, time, message in drive():
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], time, pack(messages.fill(store, kind, message), kind))
    files = [path] if form == "bag" else sorted(path.iterdir())
    return {f"drive{file.suffix}" if file.suffix != ".yaml" else file.name: file.read_bytes() for file in files}


def load_bag(folder: Path) -> Any:
    """The trajectory and the recording of a bag, as they are read again."""
    from sean_jax.io import trajectories
    from sean_jax.people import recordings
    from sean_jax.ros import bag_import

    if (folder / "metadata.yaml").is_symlink() or (folder / "metadata.yaml").exists():
        path = folder
    else:
        path = next((each for each in folder.iterdir() if each.stem == "drive"), folder / "drive.bag")
    out = folder.parent / f"{folder.name}_imported"
    shutil.rmtree(out, ignore_errors=True)
    bag_import.import_bag(path, out)
    found = []
    if (out / bag_import.PEOPLE).exists():
        try:
            found.append(recordings.read(out / bag_import.PEOPLE, frame_rate=100.0))
        except ValueError as error:  # people who walk as nobody does
            check_error(error, bag_import.PEOPLE)
    if (out / bag_import.ROBOT).exists():
        found.append(trajectories.load_trajectory(out / bag_import.ROBOT))
    return found


def bags(folder: Path) -> dict[str, Kind]:
    """Kinds of bags, each with how many mutants are of it."""
    (folder / "bags").mkdir(parents=True)
    found = {}
    for form in ("bag", "mcap", "db3"):
        given = bag(folder / "bags", form)
        if form != "bag":  # the names that metadata.yaml has
            given = {name.replace("drive", f"drive_{form}"): content for name, content in given.items()}
        wrong = next(name for name in given if name.endswith(form))
        found[f"rosbag {form}"] = Kind(given, (wrong,), load_bag, 8)
        if form == "db3":
            found["rosbag metadata"] = Kind(given, ("metadata.yaml",), load_bag, 8)
    return found


# Mutations


def mutated(chance: random.Random, name: str, given: bytes) -> bytes | Path | None:
    """The content of that file made wrong; a path to stand in its place, or None, nothing at all."""
    if chance.random() < 0.03:
        return chance.choice([None, Path("pipe"), Path("folder"), Path("/dev/zero"), Path("/dev/null"), Path("itself")])
    if chance.random() < 0.06:
        whole = [b"", b"\xef\xbb\xbf" + given, given.decode("latin-1").encode("utf-16"), b"\x00" * 1000, b"[" * 3000,
                 b"[" * 200_000, given * 50, b" " * 20_000_000, given + b"\xff", BOMB.encode(), MERGES.encode(),
                 given + b"\n" + BOMB.encode(), b"<" * 1000, b"<a>" * 3000, b"{" * 100_000, b"a: " * 2000,
                 given.replace(b"\n", b"\r\n"), given.replace(b"\n", b"\r"),
                 b"[" + b"{}," * 8_000_000 + b"0]", b"[" + b"{}," * 240_000 + b"0]"]  # fmt: skip
        return chance.choice(whole)
    if name.endswith(".py") and chance.random() < 0.5:
        return chance.choice(DEEP)
    if name.endswith(".db3") and chance.random() < 0.4:
        return in_database(chance, given)
    if name.endswith(".npz"):
        return in_arrays(chance, given) if chance.random() < 0.7 else in_bytes(chance, given)
    if name.endswith(".sqlite"):
        return in_database(chance, given) if chance.random() < 0.75 else in_bytes(chance, given)
    if name.endswith(".parquet"):
        return in_columns(chance, given) if chance.random() < 0.6 else in_bytes(chance, given)
    if (
        name.endswith((".png", ".gif", ".tiff", ".pgm", ".bmp", ".jpg", ".stl", ".bag", ".mcap", ".db3"))
        or "checkpoints/" in name
    ):
        return in_bytes(chance, given) if chance.random() < 0.8 else in_values(chance, given)
    result = given
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        how = chance.choice((in_lines, in_values, in_values, in_values, in_bytes, structured(name), structured(name)))
        try:
            result = how(chance, result)
        except Exception:  # what is wrong already may have no structure left
            result = in_values(chance, result)
    return result


def in_lines(chance: random.Random, given: bytes) -> bytes:
    """Lines that are gone, twice there, or elsewhere."""
    lines = given.split(b"\n")
    first = chance.randrange(len(lines))
    many = chance.choice((1, 1, 2, 5))
    block = lines[first : first + many]
    how = chance.randrange(5)
    if how == 0:
        del lines[first : first + many]
    elif how == 1:
        lines[first:first] = block
    elif how == 2:
        other = chance.randrange(len(lines))
        lines[first], lines[other] = lines[other], lines[first]
    elif how == 3:
        lines[first] = chance.choice((b"  ", b"\t", b"# ", b"- ", b" ")) + lines[first]
    else:
        lines[first:first] = block * chance.choice((3, 100))
    return b"\n".join(lines)


def in_values(chance: random.Random, given: bytes) -> bytes:
    """A number or a word replaced by something nasty."""
    places = list(re.finditer(rb"[-+]?[0-9][0-9.eE+-]*|[A-Za-z_][A-Za-z0-9_]*", given))
    if not places:
        return given
    if chance.random() < 0.6:
        places = [place for place in places if place.group()[:1] in b"+-0123456789"] or places
    place = chance.choice(places)
    if chance.random() < 0.3 and place.group().isdigit():
        new = str(int(place.group()[:15]) * chance.choice((-1, 10, 1000, 10**9))).encode()
    else:
        new = chance.choice(NASTY).encode("utf-8", "surrogatepass")
    return given[: place.start()] + new + given[place.end() :]


def in_bytes(chance: random.Random, given: bytes) -> bytes:
    """Bytes flipped, put in, or cut off."""
    if not given:
        return given
    at, how = chance.randrange(len(given)), chance.randrange(4)
    if how == 0:
        return given[:at] + bytes([given[at] ^ (1 << chance.randrange(8))]) + given[at + 1 :]
    if how == 1:
        return given[:at] + bytes(chance.randrange(256) for _ in range(chance.choice((1, 4, 40)))) + given[at:]
    return given[:at] if how == 2 else given[:at] + given[at + chance.choice((1, 10, 100)) :]


def structured(name: str) -> Callable[[random.Random, bytes], bytes]:
    """The mutation that knows the format."""
    ways = {
        ".jsonl": in_json_lines,
        ".yaml": in_tree,
        ".json": in_tree,
        ".xml": in_elements,
        ".urdf": in_elements,
        ".dae": in_elements,
        ".csv": in_cells,
    }
    return ways.get(Path(name).suffix, in_values)


TREE = [
    None,
    True,
    [],
    {},
    "x",
    "",
    0,
    -1,
    1.5,
    1e39,
    float("nan"),
    float("inf"),
    -1e300,
    10**30,
    [[[]]],
    {"a": {}},
    1e-50,
]


def in_tree(chance: random.Random, given: bytes) -> bytes:
    """A key or an item that is gone, another value, another's value, or one level deeper."""
    root = yaml.safe_load(given)
    spots = []

    def visit(value: Any) -> None:
        for key in list(value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()):
            spots.append((value, key))
            if len(spots) > 20_000:  # aliases of aliases
                raise ValueError("too much to be visited")
            visit(value[key])

    visit(root)
    if not spots:
        return given
    holder, key = chance.choice(spots)
    how = chance.randrange(6)
    if how == 0:
        del holder[key]
    elif how == 1:
        other, place = chance.choice(spots)
        holder[key] = json.loads(json.dumps(other[place]))
    elif how == 2 and isinstance(holder, list):
        holder.extend([holder[key]] * chance.choice((1, 30, 3000)))
    elif how == 3:
        holder[key] = [holder[key]] if chance.random() < 0.5 else {"x": holder[key]}
    elif how == 4 and isinstance(holder[key], (int, float)):
        holder[key] = holder[key] * chance.choice((-1, 0, 1e-3, 1e3, 1e6, 1e30)) + chance.choice((0, 0.5, 3))
    else:
        holder[key] = chance.choice(TREE)
    return (json.dumps(root) if given.lstrip()[:1] == b"{" else yaml.safe_dump(root, sort_keys=False)).encode()


def in_elements(chance: random.Random, given: bytes) -> bytes:
    """An element or attribute of XML that is gone, twice there, elsewhere, or another."""
    root = ElementTree.fromstring(given)
    pairs = [(above, element) for above in root.iter() for element in above]
    above, element = chance.choice(pairs)
    how = chance.randrange(8)
    if how == 0:
        above.remove(element)
    elif how == 1:
        above.append(element)
    elif how == 2:
        chance.choice(pairs)[0].append(copy.deepcopy(element))  # itself would close a circle
    elif how == 3:
        many = ElementTree.SubElement(above, "replicate", count=chance.choice(("3", "1000", "100000", "-1", "1e9")))
        many.append(copy.deepcopy(element))
    elif how == 4:
        extra = [("composite", {"type": "grid", "count": "9999 9999 1"}), ("include", {"file": "scene.xml"}),
                 ("texture", {"name": "x", "type": "2d", "builtin": "flat", "width": "60000", "height": "60000"}),
                 ("hfield", {"name": "x", "nrow": "60000", "ncol": "60000", "size": "1 1 1 1"}),
                 ("size", {"memory": "900G"}), ("size", {"nuser_geom": "1000000000"}), ("freejoint", {}),
                 ("geom", {"type": "mesh", "mesh": "none"}), ("geom", {"size": "1"}), ("body", {"pos": "1 1 1"}),
                 ("option", {"timestep": "0"}), ("numeric", {"name": "radius", "data": "1"}), ("joint", {}),
                 ("include", {"file": "/dev/zero"}), ("mesh", {"name": "x", "file": "pipe"})]  # fmt: skip
        ElementTree.SubElement(above, *chance.choice(extra))
    elif element.attrib:
        key = chance.choice(list(element.attrib))
        if how == 5:
            del element.attrib[key]
        elif how == 6:
            words = element.attrib[key].split() or [""]
            words[chance.randrange(len(words))] = chance.choice([word for word in NASTY if "\x00" not in word])
            element.attrib[key] = " ".join(words)
        else:
            other = chance.choice(pairs)[1]
            if other.attrib:
                place = chance.choice(list(other.attrib))
                element.attrib[place] = other.attrib[place]
    return ElementTree.tostring(root)


def in_cells(chance: random.Random, given: bytes) -> bytes:
    """A cell or a whole column of CSV that is another."""
    rows = [line.split(",") for line in given.decode().split("\n")]
    row, how = chance.choice(rows), chance.randrange(5)
    column = chance.randrange(len(rows[0]))
    if how == 0:
        for each in rows:
            del each[column : column + 1]
    elif how == 1:
        scale = chance.choice((1e-9, 10, 100, 1e6, 1e9, -1))
        for each in rows[1:]:
            if len(each) > column:
                each[column] = f"{float(each[column]) * scale:g}"
    elif how == 2:
        rows.insert(1, ["1000000000" if k == 0 else cell for k, cell in enumerate(rows[1])])
    elif how == 3:
        rows[0][column] = chance.choice((rows[0][column].upper(), " " + rows[0][column], "x", "frame", ""))
    elif len(row) > column:
        row[column] = chance.choice(NASTY)
    return "\n".join(",".join(each) for each in rows).encode("utf-8", "surrogatepass")


def in_arrays(chance: random.Random, given: bytes) -> bytes:
    """An array of .npz that is gone, twice as long, of another shape or kind, or has another number."""
    import numpy as np

    with np.load(io.BytesIO(given)) as opened:
        arrays: dict[str, Any] = {name: opened[name] for name in opened.files}
    name, how = chance.choice(list(arrays)), chance.randrange(10)
    values = arrays[name]
    if how == 0:
        del arrays[name]
    elif how == 1:
        arrays[chance.choice(("x", f"{name}2", "metrics:x", ""))] = values
    elif how == 2:
        arrays[name] = values.reshape(-1)[: max(0, values.size - 1)]
    elif how == 3:
        arrays[name] = np.concatenate([values, values]) if values.ndim else np.stack([values, values])
    elif how == 4:
        arrays[name] = values[None]
    elif how == 5:
        kinds = ("U9", "S3") if values.dtype.kind == "U" else ("U9", "c16", "f2", "f8", "i1", "u8", "?", "S3")
        arrays[name] = values.astype(chance.choice(kinds))
    elif how == 6 and values.size and values.dtype.kind in "fi":
        wrong = values.reshape(-1).copy()
        wrong[chance.randrange(wrong.size)] = chance.choice((-1, -7) if values.dtype.kind == "i" else (np.nan, np.inf))
        arrays[name] = wrong.reshape(values.shape)
    elif how == 7:
        arrays = dict(reversed(arrays.items()))
    elif how == 8:
        arrays[name] = np.zeros(chance.choice(((0,), (30_000_000,), (2, 0))), np.uint8)
    else:
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as parts:  # a head that says more than there is
            form, shape = chance.choice(("<f8", "<U0")), chance.choice(((10**12,), (-1,), (2**62, 4)))
            described = {"descr": form, "fortran_order": False, "shape": shape}
            np.lib.format.write_array_header_1_0(head := io.BytesIO(), described)
            parts.writestr(f"{name}.npy", head.getvalue() + bytes(0 if form == "<U0" else 80))
        return stream.getvalue()
    stream = io.BytesIO()
    np.savez_compressed(stream, **{str(key): value for key, value in arrays.items()})
    return stream.getvalue()


def in_columns(chance: random.Random, given: bytes) -> bytes:
    """A column of Parquet that is gone, another, twice there or of another kind; another number, or another header."""
    import numpy as np
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pq.read_table(io.BytesIO(given))
    metadata, names, how = table.schema.metadata, table.column_names, chance.randrange(8)
    k = chance.randrange(len(names))
    if how == 0:
        table = table.remove_column(k)
    elif how == 1:
        table = table.append_column(chance.choice((names[k], "x2")), table[names[k]])
    elif how == 2:
        kinds = [["a"] * len(table), [True] * len(table), [None] * len(table), [[1.0]] * len(table)]
        table = table.set_column(k, names[k], pa.array(chance.choice(kinds)))
    elif how < 6:
        values = table[names[k]].to_numpy().astype(float)
        wrong = chance.choice((-1e9, -2, 0.5, 7, 3e4, 1e9, 1e39, np.nan, np.inf, 2.0**62))
        values[chance.randrange(len(values))] = wrong
        table = table.set_column(k, names[k], pa.array(values))
    elif how == 6:
        row = chance.randrange(len(table))
        table = pa.concat_tables([table, table.slice(row, chance.choice((1, 5)))])
    else:
        text = in_tree(chance, metadata[b"sean_jax"])
        metadata = {b"sean_jax": text}
    pq.write_table(table.replace_schema_metadata(metadata), stream := io.BytesIO())
    return stream.getvalue()


# The worker


def place(target: Path, content: bytes | Path | None) -> None:
    """Write what stands in a file's place."""
    if content is None:
        return
    if isinstance(content, bytes):
        target.write_bytes(content)
    elif str(content) == "pipe":
        os.mkfifo(target)
    elif str(content) == "folder":
        target.mkdir()
    else:
        target.symlink_to(target if str(content) == "itself" else content)


def check_error(error: BaseException, *names: str) -> None:
    """AssertionError unless it is one of the package's own, raised there, in sentences that name one of the files."""
    from sean_jax.core.errors import SeanError

    where = traceback.extract_tb(error.__traceback__)[-1].filename
    own = isinstance(error, SeanError) or type(error) is ValueError
    assert own and "sean_jax" in where, f"{type(error).__name__} from {where}"
    lines = str(error).split("\n")
    assert all(line.strip() for line in lines), "an empty line"
    assert any(Path(name).stem in lines[0] for name in names), f"does not name the file: {lines[0][:200]}"
    assert not UNSAID.search(str(error)), f"another's words: {str(error)[:300]}"
    assert all(len(line) < 1000 for line in lines), f"too long: {str(error)[:300]}"


def check_finite(found: Any) -> None:
    """AssertionError for a leaf that holds NaN, or inf where it means nothing."""
    import jax
    import numpy as np

    for path, leaf in jax.tree_util.tree_leaves_with_path(found):
        values = np.asarray(leaf)
        if values.dtype.kind == "f":
            field = jax.tree_util.keystr(path)
            assert not np.isnan(values).any(), f"{field} is not a number"
            allowed = any(name in field for name in INFINITE)
            assert allowed or (np.abs(values) < 1e12).all(), f"{field} is not finite"


def attempt(kind: Kind, folder: Path, name: str) -> tuple[str, str]:
    """("accepted" or "refused" or "wrong", what was said)."""
    try:
        found = kind.load(folder)
    except Refused as error:
        return "refused", str(error)
    except Exception as error:  # whatever it is, it is looked at
        try:
            known = {"map": "map", "batch.npz": "batch", "report.html": "report.html"}
            check_error(
                error,
                known.get(name[:3], known.get(name, name)),
                "policy",
                "agent",
                "checkpoint",
                "rosbag",
                "words",
                *OPTIONS,
            )
        except AssertionError as wrong:
            return "wrong", f"{wrong}\n{''.join(traceback.format_exception(error))}"
        return "refused", str(error)
    try:
        check_finite(found)
    except AssertionError as wrong:
        return "wrong", str(wrong)
    return "accepted", ""


def prepare(kind: Kind, folder: Path, name: str, content: bytes | Path | None) -> None:
    """The files of a kind in a folder, the one of that name replaced."""
    shutil.rmtree(folder, ignore_errors=True)
    for other, given in kind.files.items():
        if other != name:
            (folder / other).parent.mkdir(parents=True, exist_ok=True)
            (folder / other).write_bytes(given)
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    place(folder / name, content)


def main(seed: int, first: int, count: int, folder: Path, only: str = "") -> None:
    """Mutants ``first`` to ``first + count`` of a seed; each is the same whoever comes before it."""
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no answer
    every = kinds(folder / "originals")
    chosen_kinds = only.split(",") if only else list(every)
    for name, kind in (
        (name, every[name]) for name in chosen_kinds
    ):  # as it is, each is accepted; compiles what is shared
        prepare(kind, folder / name, "", None)
        answer = attempt(kind, folder / name, kind.wrong[0])
        assert answer[0] == "accepted", (name, answer)
    status = Path("/proc/self/status").read_text() if Path("/proc/self/status").exists() else ""
    if used := re.search(r"VmData:\s*(\d+) kB", status):
        most = int(used.group(1)) * 1024 + MEMORY
        resource.setrlimit(resource.RLIMIT_DATA, (most, most))
    for number in range(first, first + count):
        chance = random.Random(f"{seed} {number}")
        chosen = chance.choices(list(every), [kind.share for kind in every.values()])[0]
        kind = every[chosen]
        name = chance.choice(kind.wrong)
        content = mutated(chance, name, kind.files[name])
        if chosen not in chosen_kinds:
            continue
        prepare(kind, folder / chosen, name, content)
        print(json.dumps({"number": number, "kind": chosen}), file=out, flush=True)
        signal.setitimer(signal.ITIMER_PROF, HANG)
        signal.setitimer(signal.ITIMER_REAL, WAIT)
        result, said = attempt(kind, folder / chosen, name)
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        print(json.dumps({"number": number, "kind": chosen, "result": result, "said": said}), file=out, flush=True)


if __name__ == "__main__":
    sys.path[0] = str(Path(__file__).parents[1])  # tests/, of which `support` is a part
    main(int(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4]), *sys.argv[5:6])
