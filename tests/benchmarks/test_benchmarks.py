"""The benchmark programs run, at toy size, and print the table that they promise."""

import argparse
import dataclasses
import functools
import importlib
import importlib.util
import json
import re
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from sean_jax.config import Figure4Config
from sean_jax.config.workspace import Workspace
from sean_jax.core import random_streams
from sean_jax.learning.policy import load_policy
from sean_jax.simulation.episode_runner import Record, Runner
from sean_jax.studies.experiments import figure4
from support import trees
from support.checkout import ROOT, benchmark
from support.commands import python
from support.files import write_all

pytestmark = pytest.mark.form


def run(*arguments: str) -> list[str]:
    """Lines that a program prints; it is run from the checkout, so its own folder is where it imports from."""
    return python(*arguments, cwd=ROOT).splitlines()


@pytest.mark.night
def test_crowd():
    lines = run("benchmarks/crowd.py", "--sizes", "1x12", "2x12", "--walls", "0", "8", "--presets", "helbing1995")
    assert lines[1].split()[:3] == ["preset", "B", "N"] and lines[-1].startswith("peak resident memory")
    rows = [line.split() for line in lines[2:-1]]
    assert [row[:4] for row in rows] == [["helbing1995", b, "12", w] for b in "12" for w in "08"]
    for row in rows:
        assert float(row[4]) > 0 and float(row[5]) > 0
    for row in rows[:2]:  # errors against the float64 loop after 1 and 20 steps
        assert float(row[-2]) <= 1e-5 and float(row[-1]) <= 1e-3
    assert all(row[-3:] == ["-"] * 3 for row in rows[2:])


@pytest.mark.night
def test_floors(tmp_path):
    short = "--environments", "lab", "--routings", "trips", "--seconds", "10", "--door-draws", "2"
    lines = run("benchmarks/floors.py", *short, "--out", str(tmp_path / "floors.json"))
    figures = json.loads((tmp_path / "floors.json").read_text())
    assert [line.split()[0] for line in lines] == ["lab", "robot", "nobody"]
    assert figures["lab trips"]["walking_minutes"] >= 0.0
    assert len(figures["door"]["robot"]["longest"]) == len(figures["door"]["nobody"]["passes"]) == 2


@pytest.mark.night
def test_adapters():
    pytest.importorskip("gymnasium")
    small = "--name", "Lab-Random-RandomAbNav-v0", "--rows", "2", "--seconds", "0.01"
    first, second = run("benchmarks/adapters.py", *small)
    assert "one environment" in first and second.split()[:2] == ["2", "rows"] and second.endswith("steps/s")


@pytest.mark.night
@pytest.mark.parametrize("observe", ["none", "depth"])
def test_worlds(observe):
    """Two floors, in one program and alone."""
    first, last = run("benchmarks/worlds.py", "worlds:passages:2", "--batches", "4", "--observe", observe)
    assert "2 floors in" in first and first.endswith(f"observations: {observe}")
    together, alone, ratio = re.fullmatch(r"4: (\S+) steps/s, alone (\S+), ratio (\S+)", last).groups()
    assert 0.01 < float(first.split(" MB each")[0].split()[-1]) < 1.0
    assert float(together) > 0 and float(ratio) == pytest.approx(float(together) / float(alone), rel=0.01)


@pytest.mark.night
def test_rays_on_host():
    small = "--environment", "lab", "--batches", "2", "--people", "4", "--dynamics", "twin", "--seconds", "0.01"
    lines = run("benchmarks/rays_on_host.py", *small)
    assert "100.000 % of the pixels are equal" in lines[1]  # on a CPU both forms are the same
    rows = [line.split() for line in lines[-3:-1]]
    assert [row[:2] for row in rows] == [["2", "loops"], ["2", "kernel"]]
    assert all(float(number) > 0 for row in rows for number in row[2:])


@pytest.mark.night
def test_peers(tmp_path):
    """The project's rows, and those of a peer that a path names; ratios are of the two."""
    peer = tmp_path / "slowpoke.py"
    peer.write_text(
        "def simulator(hall):\n"
        "    assert len(hall.starts) == len(hall.goals) == 12 and len(hall.segments) in (0, 36)\n"
        "    return lambda: lambda steps: sum(range(20000 * steps)), 'counts'\n"
    )
    arguments = "--people", "12", "--batches", "1", "2", "--repeats", "1", "--seconds", "0.05", "--simulator", str(peer)
    lines = run("benchmarks/peers.py", *arguments)
    if not importlib.util.find_spec("rvo2"):
        assert any(line.startswith("rvo2: not installed; pip install") for line in lines)
    rows = [line.split() for line in lines if line.split()[0] in ("open", "walls")]
    assert sum(row[3] == "orca," for row in rows) == 4
    assert [row[0] for row in rows if "slowpoke" in row] == ["open", "walls"]
    best = {hall: max(float(r[6]) for r in rows if r[0] == hall and r[2] == "sean_jax,") for hall in ("open", "walls")}
    for row in rows:
        if "slowpoke" in row:
            assert float(row[4].rstrip("x")) == pytest.approx(best[row[0]] / float(row[3]), rel=0.02)


@pytest.mark.night
def test_causes(tmp_path):
    """The parts of the protocol, of experiments with known numbers."""
    for behavior, parts in (("handcrafted", 5), ("graph", 2)):
        flags = np.zeros((1, 2 * parts, 60, 5), bool)
        flags[0, -2:, :30, 0] = flags[0, -2:, :15, 1] = True  # of the last part: across, and half of it along as well
        for driver in ("go_to_goal", "social_costmap", "expert"):
            np.savez(tmp_path / f"{behavior}-{driver}.npz", flags=np.packbits(flags, axis=-1))
    harm = [[0.0] * 6, [2.0] * 6, [0.0] * 6, [1.0] * 6]
    told = {"completed": [1.0, 0.0, 1.0, 1.0], "seconds": [30.0, 120.0, 30.0, 60.0], "intimate_robot_on_person": harm}
    told |= {"time_not_moving": [1.0, 97.0, 1.0, 1.0], "intimate_person_on_robot": [[0.0] * 6] * 4}
    (tmp_path / "episodes-G-graph.json").write_text(json.dumps(told))
    folders = "--table1", str(tmp_path), "--figure4", str(tmp_path)
    lines = run("benchmarks/causes.py", "--only", "fifths", "episodes", *folders)
    rows = {line[:46].strip(): line[46:].split() for line in lines}
    assert rows["handcrafted, expert, cross_path"] == ["37.5", "12.5", "0.0", "0.0", "0.0", "50.0"]
    assert rows["graph, go_to_goal, join_group"] == ["0.0"] * 5 + ["100.0"]
    assert "G, graph: 97 % of the time not moving is in episodes that were not completed" in lines
    join, leave = (line.split() for line in lines[-2:])
    assert join == ["join_group", "0", "of", "2", "0.0", "0.00"]
    assert leave == ["leave_group", "1", "of", "2", "97.0", "1.00"]


def test_curriculum(tmp_path, capsys):
    """The worst situation is the one with the most violations a minute, and what is said follows the intervals."""
    program = benchmark("curriculum")
    names, minutes = ["overall", "often", "seldom", "never"], np.tile([1.0, 0.5, 0.25, 0.0], (40, 1))

    def episodes(often: float, seldom: float) -> dict:
        events = np.zeros((40, 4))
        events[: round(40 * often), 1] = events[: round(40 * seldom), 2] = 1.0
        events[:, 0] = events.sum(1)
        return {"violations": events, "minutes": minutes, "completed": np.ones(40)}

    before = episodes(0.5, 0.5)
    assert program.worst_situation(names, before) == 2  # as many violations in half the time
    with pytest.raises(SystemExit, match="nothing to mend"):
        program.worst_situation(names, episodes(0.0, 0.0))
    chosen = argparse.Namespace(episodes=40, seeds=2, curriculum="situations", out=tmp_path)
    trained = {"none": [episodes(0.5, 0.1)] * 2, "situations": [episodes(0.5, 0.0), episodes(0.5, 0.2)]}
    program.report(chosen, names, 2, {"before": [before]} | trained)
    lines = capsys.readouterr().out.splitlines()
    row = next(line for line in lines if line.startswith("seldom *"))
    assert [part.split()[-1] for part in row.split("(")[:-1]] == ["2.00", "0.40", "0.40", "-1.60", "+0.00"]
    said = "fewer violations than before, no decided difference from without a curriculum"
    assert lines[-2] == f"seldom after training with curriculum situations: {said}"
    kept = json.loads((tmp_path / "situations.json").read_text())
    assert kept["worst"] == "seldom" and kept["situations"]["by seed"] == pytest.approx([0.0, 0.8])
    assert (tmp_path / "situations.png").stat().st_size > 0


def test_goldens(tmp_path, monkeypatch, capsys):
    """Equal records give exit code 0; a changed, missing or further one gives 1, with what changed."""
    program = benchmark("goldens")

    def compared(*after: dict[str, str]) -> tuple[int, str]:
        for name, texts in zip(("before", "after"), after, strict=True):
            monkeypatch.setitem(program.WRITERS, "schema", lambda _, texts=texts: texts)
            monkeypatch.setitem(program.WRITERS, "jaxprs", lambda _, texts=texts: {"step": texts["a b"]})
            program.write(tmp_path / name, ["schema", "jaxprs"])
        capsys.readouterr()
        monkeypatch.setattr("sys.argv", ["goldens.py", "compare", str(tmp_path / "before"), str(tmp_path / "after")])
        return program.main(), capsys.readouterr().out

    first = {"a b": "one\ntwo\n", "c": "three\n"}
    assert compared(first, first) == (0, "jaxprs: 0 of 1 differ\nschema: 0 of 2 differ\n")
    code, said = compared(first, first | {"a b": "one\n2\n"})
    assert code == 1 and said.count("a b: differs") == said.count("step: differs") == 1
    assert said.count("    -two\n    +2\n") == 2 and "schema: 1 of 2 differ" in said
    code, said = compared(first, {"a b": first["a b"]})
    assert code == 1 and f"c: not in {tmp_path / 'after'}" in said
    kept = tmp_path / "before" / "goldens.json"
    assert program.compare(kept, kept) == 0 and program.compare(kept, tmp_path / "after") == 1
    assert len({program.file_of(tmp_path, "bad_input", line) for line in program.CASES["bad_input"].splitlines()}) > 60


def test_goldens_of_a_program():
    """Names of functions do not matter, their operations and constants do."""
    program = benchmark("goldens")

    def one(x):
        return jnp.where(x > 0, x, 2.0) + jnp.arange(20.0)

    def two(x):
        return jnp.where(x > 0, x, 3.0) + jnp.arange(20.0)

    def other(name, function):
        function.__name__ = name
        return program.program(jax.make_jaxpr(jax.jit(function))(1.0))

    assert other("same", one) == other("another", one) != other("same", two)
    assert "another" not in other("another", one) and "0x" not in other("same", one)


@pytest.mark.parametrize("name", sorted(path.stem for path in (ROOT / "benchmarks").glob("*.py")))
def test_programs_name_what_exists(name):
    """Each imports what it needs of the package; their figures are for people to read."""
    assert benchmark(name).__doc__


def refusal(program, *arguments: object) -> str:
    """The sentence with which a program ends."""
    with pytest.raises(SystemExit) as caught:
        program.main([str(argument) for argument in arguments])
    return str(caught.value)


def test_move_base_refusals(tmp_path, monkeypatch):
    """One sentence each without a checkout, a package, a build or ROS, and the last lines of a build that fails."""
    program = benchmark("move_base")
    places = "--sources", tmp_path / "sources", "--workspace", tmp_path / "workspace"
    drive = ("drive", *places, "--out", tmp_path / "logs")
    said = refusal(program, "build", *places)
    assert "sources/navigation is missing; git clone https://github.com/ros-planning/navigation" in said
    for name, packages in program.ROS_PACKAGES.items():
        for package in packages.split():
            file = tmp_path / "sources" / name / package / "CMakeLists.txt"
            file.parent.mkdir(parents=True)
            file.write_text("-Wall;-Werror")
    assert "social_sim_ros is missing; git clone" in refusal(program, "build", *places)
    (tmp_path / "sources" / "social_sim_ros").mkdir()
    assert "move_base is missing; build it" in refusal(program, *drive)

    monkeypatch.setattr(program, "DEBIAN_PACKAGES", ["no-such-package"])
    said = refusal(program, "build", *places)
    assert said.endswith("apt-get install --no-install-recommends no-such-package") or "needs Debian 12" in said
    monkeypatch.setattr(program, "check_debian", lambda: None)
    monkeypatch.setattr(program, "SYSTEM_PATH", f"{tmp_path}:/usr/bin:/bin")
    maker = tmp_path / "catkin_make"
    maker.write_text("#!/bin/sh\necho '[ 40%] costmap_2d'\necho no compiler\nexit 3\n")
    maker.chmod(0o755)
    said = refusal(program, "build", *places)
    assert "catkin_make failed (3)" in said and said.endswith("no compiler")
    copies = sorted((tmp_path / "workspace" / "src").glob("*/CMakeLists.txt"))
    assert len(copies) == sum(len(packages.split()) for packages in program.ROS_PACKAGES.values())
    assert {copy.parent.name for copy in copies if "Werror" not in copy.read_text()} == {"social_navigation_layers"}

    binary = tmp_path / "workspace" / "devel" / "lib" / "move_base" / "move_base"
    binary.parent.mkdir(parents=True)
    binary.touch()
    monkeypatch.setitem(sys.modules, "rospy", None)
    monkeypatch.setattr("sean_jax.ros.ros1.DEBIAN", str(tmp_path))
    assert "rospy cannot be imported" in refusal(program, *drive)
    subprocess.run(["git", "init", "-q", str(tmp_path / "sources" / "people")], check=True)
    assert "people is at no commit; git -C" in refusal(program, "build", *places)


def test_move_base_parameters(tmp_path):
    """The layers are added to both maps, and the files are not changed otherwise."""
    program = benchmark("move_base")
    assert program.patch("f_ = boost::bind(&Layer::set, this, _1, _2);\n") == (
        "#include <boost/bind/bind.hpp>\n"
        "f_ = boost::bind(&Layer::set, this, boost::placeholders::_1, boost::placeholders::_2);\n"
    )
    folder = tmp_path / "social_sim_ros" / "social_sim_ros" / "params" / "kuri"
    files = {
        "costmap_common_params.yaml": "plugins: [{name: static_layer}]\ninflation_radius: 0.5\n",
        "map_nav_params/local_costmap_params.yaml": "local_costmap: {obstacles_layer: {enabled: false, rays: 360}}\n",
        "map_nav_params/global_costmap_params.yaml": "global_costmap: {inflation_radius: 0.3}\n",
        "base_local_planner_params.yaml": "TrajectoryPlannerROS: {sim_time: 2.0}\n",
    }
    write_all(folder, files)
    with pytest.raises(program.InputError, match=r"move_base_params.yaml is missing"):
        program.parameters(tmp_path, [])
    (folder / "move_base_params.yaml").write_text("controller_frequency: 10.0\n")
    local = {"plugins": [{"name": "static_layer"}], "inflation_radius": 0.5}
    local["obstacles_layer"] = {"enabled": False, "rays": 360}
    whole = {"plugins": [{"name": "static_layer"}], "inflation_radius": 0.3}
    tree = program.parameters(tmp_path, [])
    assert tree == {"local_costmap": local, "global_costmap": whole, "controller_frequency": 10.0,
                    "TrajectoryPlannerROS": {"sim_time": 2.0}}  # fmt: skip
    tree = program.parameters(tmp_path, ["social", "lidar"])
    for costmap in (tree["local_costmap"], tree["global_costmap"]):
        assert [plugin["name"] for plugin in costmap["plugins"]] == ["static_layer", "social_layer"]
        assert costmap["obstacles_layer"] == {"enabled": True, "rays": 360}


def test_move_base_summary(tmp_path, capsys):
    """Means, and where the robot stood with which commands."""
    program = benchmark("move_base")

    def episode(number: int, still: float, rows: list) -> dict:
        names = ("intimate", "personal")
        counts = {f"{name}_{side}": [1.0] for name in names for side in ("robot_on_person", "person_on_robot")}
        results = counts | {"time_not_moving": [still], "collision_robot_on_person": [0.0]}
        return {"episode": number, "completed": still < 10, "seconds": len(rows) / 10, "rtf": 0.5, "silent": 6,
                "plans_per_s": 16.0, "recovery": [[3.0, "rotate_recovery"]] * number,
                "result": [[1.0, 2, ""], [5.0, 4, ""]], "results": results, "log": rows}  # fmt: skip

    walk = [[k / 10, 0.03 * k, 0.0, 0.0, 0.3, 0.0, 1, 1, 2.0, 3] for k in range(40)]
    wait = [[4 + k / 10, 1.2, 0.0, 0.0, 0.0, 0.0, 1, 1, 2.0, 3] for k in range(100)]
    for row in wait[10:30]:
        row[4:6] = None, None
    for row in wait[30:40]:
        row[5] = -1.0
    content = {"options": {"task": "join_group"}, "versions": {}, "columns": program.COLUMNS}
    content["episodes"] = [episode(0, 0.0, walk), episode(1, 10.0, walk + wait)]
    file = tmp_path / "drives.json"
    file.write_text(json.dumps(content))
    program.main(["summary", str(file), "--out", str(tmp_path / "summary.json")])
    assert "still s: 0 10" in capsys.readouterr().out
    (row,) = json.loads((tmp_path / "summary.json").read_text())["conditions"]
    assert row["still_mean"] == 5.0 and row["completed"] == 0.5 and row["silent"] == pytest.approx(12 / 180)
    assert (row["recoveries"], row["aborts"], row["personal"]) == (1, 2, 2.0)
    assert sum(row["stop_seconds"].values()) == pytest.approx(10.0, abs=0.01)
    (stop,) = row["stops"]
    assert stop["episode"] == 1 and stop["seconds"] == 10.0 and stop["place"] == [1.2, 0.0]
    assert stop["none"] == pytest.approx(20 / 99, abs=1e-3) and stop["turn"] == pytest.approx(10 / 99, abs=1e-3)
    assert stop["zero"] == pytest.approx(69 / 99, abs=1e-3)
    file.write_text("[]")
    assert "no episodes that `drive` wrote" in refusal(program, "summary", str(file))


@pytest.mark.night
@pytest.mark.parametrize("behavior", ["graph", "handcrafted"])
def test_move_base_drives_the_episodes_of_figure4(behavior, tmp_path, monkeypatch):
    """Starts, people and streams of each numbered episode are those of the experiment, to the bit."""
    program = benchmark("move_base")
    chosen = argparse.Namespace(figure4=behavior, environment="warehouse", people=62, seed=0, out=tmp_path)
    options = Figure4Config(preset="sean2", out=tmp_path)
    starts = []

    class Watched(Runner):
        def __init__(self, scenarios, policy, size, use, drivers=None):
            record = Record(lambda floors, states: random_streams.as_numbers(states), lambda *args: (args[-1], ()))
            super().__init__(scenarios, policy, size, use, record, drivers=drivers)

        def run(self, *args, **named):
            starts.append(super().run(*args, **named))
            return starts[-1]

    monkeypatch.setattr(figure4, "Runner", Watched)
    kinds = [dataclasses.replace(kind, time_limit=1.0) for kind in figure4.scenarios(options)[behavior]]
    drivers = {"still": [functools.partial(load_policy, "go_to_goal")]}
    figure4.drive(drivers, Workspace(tmp_path, {}), behavior, kinds, options.seed, 6, lambda share: None)
    (batch,) = starts
    world = program.World(chosen)
    for number in range(6):
        mine = world.reset(number)[0]
        theirs = jax.tree.map(lambda leaf, number=number: leaf[number], batch.total)
        theirs = dataclasses.replace(theirs, policy_state=mine.policy_state, metrics=mine.metrics)
        trees.assert_equal(random_streams.as_numbers(mine), theirs)
    state = world.reset(5)[0]
    (x, y), geodesic = map(float, state.robot.position), float(state.task.geodesic)
    same = {"episode": 5, "start": [x, y, 0.0], "geodesic": geodesic}
    program.check_starts(world, [same], tmp_path)
    for other in ({"start": [x + 1.0, y, 0.0]}, {"geodesic": geodesic + 1.0}):  # another start, another goal
        with pytest.raises(program.InputError, match="episode 5 began at"):
            program.check_starts(world, [same | other], tmp_path)


def test_move_base_compare(tmp_path, monkeypatch, capsys):
    """Means and paired differences equal those of numpy and scipy; an episode with another start here has no pair."""
    program, random = benchmark("move_base"), np.random.default_rng(0)
    monkeypatch.setattr(program.figure4, "scenarios", lambda options: dict.fromkeys(program.measures.BEHAVIORS, ()))
    monkeypatch.setattr(program, "World", lambda chosen: chosen.figure4)
    monkeypatch.setattr(program, "elsewhere", lambda world, episodes: {4: [0.0, 0.0]} if world == "random" else {})
    metrics = [name for name in program.measures.METRIC_NAMES if name in program.metrics.METRICS]
    truth = {}

    def numbers(name: str, count: int) -> np.ndarray:
        return random.exponential(20, count) if name == "time_not_moving" else random.poisson(0.5, count).astype(float)

    for behavior, count in (("random", 12), ("handcrafted", 9), ("graph", 15)):
        for driver, size in (("real", count), ("N", 20), ("move_base", 20)):
            columns = {name: np.tile(numbers(name, size)[:, None], 6) for name in metrics}
            columns |= {"completed": random.integers(0, 2, size), "seconds": np.full(size, 120.0)}
            driven = [k for k in range(count) if (behavior, k) != ("graph", 3)]
            truth[driver, behavior] = {name: values[driven] for name, values in columns.items()}
            if driver != "real":
                file = tmp_path / f"episodes-{driver}-{behavior}.json"
                file.write_text(json.dumps({name: values.tolist() for name, values in columns.items()}))
                continue
            episodes = [
                {"episode": k, "silent": 12, "rtf": 1.0, "recovery": [], "seconds": 120.0,
                 "completed": bool(columns["completed"][k]),
                 "results": {name: columns[name][k].tolist() for name in metrics}}
                for k in driven
            ]  # fmt: skip
            file = tmp_path / f"{behavior}-social_lidar-0.json"
            file.write_text(json.dumps({"options": {}, "episodes": episodes}))
    program.main(["compare", str(tmp_path)])
    text = capsys.readouterr().out
    assert "graph: 14 episodes, 1.0 % of commands missing in 14 without recoveries, 1.00 x" in text
    assert "random: 1 of 12 episodes begin elsewhere here" in text
    tables = {}
    for name in ("figure4", "contrasts"):
        lines = (tmp_path / f"{name}.csv").read_text().splitlines()
        tables[name] = [dict(zip(lines[0].split(","), line.split(","), strict=True)) for line in lines[1:]]

    def violations(columns: dict) -> np.ndarray:
        return columns["intimate_robot_on_person"][:, 0] + columns["intimate_person_on_robot"][:, 0]

    ways = {"time_not_moving": lambda columns: columns["time_not_moving"][:, 0], "violations": violations,
            "completed": lambda columns: columns["completed"].astype(float)}  # fmt: skip
    for behavior in ("random", "handcrafted", "graph"):
        for measure, take in ways.items():
            place = {"behavior": behavior, "measure": measure}
            mine = take(truth["real", behavior])
            (cell,) = [row for row in tables["figure4"] if row.items() >= (place | {"policy": "real"}).items()]
            assert int(cell["episodes"]) == len(mine)
            assert float(cell["mean"]) == pytest.approx(mine.mean(), abs=1e-4)
            for other in ("N", "move_base"):
                theirs, same = take(truth[other, behavior]), np.arange(len(mine)) != (4 if behavior == "random" else -1)
                (row,) = [row for row in tables["contrasts"] if row.items() >= (place | {"other": other}).items()]
                assert int(row["episodes"]) == same.sum()
                assert float(row["difference"]) == pytest.approx((mine - theirs)[same].mean(), abs=1e-4)
                if measure == "time_not_moving":
                    p = scipy.stats.ttest_rel(mine[same], theirs[same]).pvalue
                    assert float(row["p"]) == pytest.approx(p, abs=1e-4)
    place = {"random": [0, 1, 2, 5, 6, 7, 8], "handcrafted": [0, 1, 2, 5, 6, 7, 8], "graph": [0, 1, 2, 4, 5, 6, 7]}
    gaps = [ways["time_not_moving"](truth["real", b])[k] - ways["time_not_moving"](truth["N", b])[k]
            for b in place for k in (list(place[b]),)]  # fmt: skip
    (row,) = [row for row in tables["contrasts"] if (row["other"], row["behavior"], row["measure"])
              == ("N", "mean", "time_not_moving")]  # fmt: skip
    assert int(row["episodes"]) == 7 and float(row["difference"]) == pytest.approx(np.mean(gaps), abs=1e-4)
    (tmp_path / "graph-social_lidar-0.json").unlink()
    assert "graph-social_lidar-0.json has no episodes that `drive` wrote" in refusal(program, "compare", tmp_path)
