"""Stacks of floors: the same results as each floor alone, tables that are not copied, sets of worlds by name."""

import csv
import dataclasses
import json
import signal
import typing

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import registry, reset, step
from sean_jax.cli import command_line
from sean_jax.config import EnvConfig, PPOConfig, RunConfig, ScenarioConfig, validate
from sean_jax.core import devices, gpu_kernels, padding
from sean_jax.core.data_types import FAR, ObstacleGrid, Obstacles, PathsToGoal, Solids
from sean_jax.core.errors import InputError
from sean_jax.evaluation import run_folder, run_plan
from sean_jax.graph import BehaviorGraph
from sean_jax.learning import rollouts
from sean_jax.learning.policy import load_policy
from sean_jax.people.behaviors import graph_behavior, random_behavior
from sean_jax.policies import POLICIES, go_to_goal
from sean_jax.simulation import episode_runner, making, scenario_stack
from sean_jax.world import environment, generated
from sean_jax.world.navigation import Navigation, draw_places
from sean_jax.world.navigation.arcs import CornerArcs
from support import trees
from support.replays import played
from support.runs import at_second_batch

SET = "worlds:passages,aisles,square:3"


def options(**more) -> ScenarioConfig:
    return validate(ScenarioConfig, {"environment": SET, "people": 20, "task": "join_group", **more})


CHEAP = {"metrics": "none", "dynamics": "kinematic", "forces": "helbing1995"}  # compiled sooner than the usual ones


def build(config: ScenarioConfig) -> scenario_stack.Stack:
    return making.build(making.plan_scenario(config))[0]


@pytest.fixture(scope="module")
def floors() -> scenario_stack.Stack:
    return build(options(**CHEAP))


def drive(scenario, key):
    def one(state, _):
        state = step(scenario, state, jnp.array([0.4, 0.2]))
        return state, (state.pedestrians.position, state.robot.position, state.metrics)

    return jax.lax.scan(one, reset(scenario, key), length=60)


RANDOM = {"behavior": "random", "task": "random_ab_nav"}
COMPARED = [
    pytest.param(CHEAP, [1], id="graph"),
    pytest.param(CHEAP | RANDOM, [1], marks=pytest.mark.night, id="random"),
    pytest.param({}, [0, 1, 2], marks=pytest.mark.night, id="all"),
]


@pytest.mark.slow
@pytest.mark.parametrize("more, alone_too", COMPARED)
def test_each_floor_is_as_it_is_alone(more, alone_too):
    """Tasks, people, robots and metrics, from equal keys, with other numbers of obstacles, arcs, nodes and seats."""
    floors, folders = build(options(**more)), generated.find(SET)
    keys = jax.random.split(jax.random.key(1), 6)
    state, (people, robots, measured) = jax.jit(lambda floors, keys: floors.vmap(drive)(keys))(floors, keys)
    near = 1e-3 if "behavior" in more else 1e-4  # m, for rounding grows in encounters
    for number in alone_too:
        rows = slice(2 * number, 2 * number + 2)
        alone = sean_jax.make(str(folders[number]), **{"people": 20, "task": "join_group", **more})
        assert alone.environment.obstacles.yaw.shape <= floors.member.environment.obstacles.yaw.shape
        last, (each_people, each_robots, each_metrics) = jax.jit(jax.vmap(drive, (None, 0)))(alone, keys[rows])
        np.testing.assert_allclose(last.task.goal, state.task.goal[rows], atol=1e-5)
        np.testing.assert_allclose(last.task.geodesic, state.task.geodesic[rows], rtol=1e-5)
        np.testing.assert_allclose(each_people, people[rows], atol=near)
        np.testing.assert_allclose(each_robots, robots[rows], atol=1e-4)
        trees.assert_close(
            each_metrics, jax.tree.map(lambda leaf, rows=rows: leaf[rows], measured), rtol=1e-3, atol=1e-3
        )
    assert np.abs(np.diff(people, axis=1)).max() > 0.01


@pytest.mark.slow
def test_a_member_is_its_floor(floors):
    for number, name in enumerate(floors.names):
        member = floors.at(number)
        alone = sean_jax.make(str(generated.find(SET)[number]), people=20, task="join_group", **CHEAP)
        count = alone.environment.obstacles.yaw.shape[0]
        np.testing.assert_array_equal(member.environment.obstacles.center[:count], alone.environment.obstacles.center)
        assert (np.asarray(member.environment.obstacles.center[count:]) == FAR).all() and name in str(
            generated.find(SET)
        )
    some = floors.take(np.array([2, 0, 2]))
    np.testing.assert_array_equal(some.at(1).environment.floor, floors.at(0).environment.floor)
    np.testing.assert_array_equal(some.member.environment.floor, floors.at(2).environment.floor)


def test_people_who_are_not_there_stay_away():
    """Without a number of people each floor has its own, and places for as many as the most crowded."""
    floors = build(options(people=None, metrics="none"))
    there = jax.jit(lambda floors, keys: floors.vmap(lambda floor, key: reset(floor, key).pedestrians.present)(keys))
    present = there(floors, jax.random.split(jax.random.key(0), 3))
    own = [sean_jax.make(str(folder), **CHEAP).people for folder in generated.find(SET)]
    assert floors.member.people == max(own) and len(set(own)) > 1
    np.testing.assert_array_equal(present.sum(1), own)


def test_padding_keeps_numbers_and_fills_the_rest():
    boxes = Obstacles(jnp.ones((2, 2)), jnp.ones((2, 2)), jnp.zeros(2), jnp.ones(2))
    sizes = padding.common_sizes([boxes, Obstacles(jnp.ones((5, 2)), jnp.ones((5, 2)), jnp.zeros(5), jnp.ones(5))])
    padded = padding.pad((boxes, {"again": boxes}), sizes)
    assert padded[0].center.shape == (5, 2) and (padded[0].center[2:] == FAR).all()
    assert padded[1]["again"].center is padded[0].center


FILLED = (
    *(Obstacles, ObstacleGrid, Solids, PathsToGoal, CornerArcs, Navigation, BehaviorGraph),
    *(graph_behavior.GraphTables, random_behavior.RandomTables),
)
"""Classes with fields that 0 does not fill."""


@pytest.mark.parametrize("kind", FILLED, ids=lambda kind: f"{kind.__module__}.{kind.__name__}")
def test_padding_fills_an_array_with_what_its_field_says(kind):
    """Each axis with a letter grows from 2 to 4, but for the axes of grids."""
    fields = [field for field in dataclasses.fields(kind) if "pad" in field.metadata]
    assert fields
    axes = {field.name: typing.get_args(field.type)[0].dim_str.split() for field in fields}
    shapes = {name: [int(axis) if axis.isdigit() else 2 for axis in each] for name, each in axes.items()}
    nothing = {field.name: None for field in dataclasses.fields(kind)}
    tree = kind(**nothing | {name: np.full(shape, 7.0) for name, shape in shapes.items()})

    letters = {axis for each in axes.values() for axis in each if not axis.isdigit()} - {*padding.EDGE}
    padded = padding.pad(tree, {(kind.__name__, axis): 4 for axis in letters})

    for field in fields:
        array = getattr(padded, field.name)
        expected = np.array(np.broadcast_to(np.asarray(field.metadata["pad"], float), array.shape))
        expected[tuple(slice(size) for size in shapes[field.name])] = 7.0
        assert array.size > np.prod(shapes[field.name])
        np.testing.assert_array_equal(array, expected)


def test_tables_of_floors_lie_one_after_the_other():
    """Elements and rows are those of each floor, and an array that is in two places stays one."""
    each = [np.arange(6.0).reshape(2, 3), 10.0 + np.arange(20.0).reshape(4, 5)]
    flat = [padding.flat_table(table) for table in each]
    joined = padding.join_tables([(table, {"again": table}) for table in flat])
    for table, (first, more) in zip(each, joined, strict=True):
        assert first.values is more["again"].values is joined[0][0].values
        np.testing.assert_array_equal(first.on_host(), table)
        i, j = np.indices(table.shape)
        np.testing.assert_array_equal(first[i, j], table)
        for row in range(len(table)):
            np.testing.assert_array_equal(first.row((row,), 5)[: table.shape[1]], table[row])


def test_places_of_padding_are_not_drawn(floors):
    navigation, key = floors.member.navigation, jax.random.key(0)
    fewer = navigation.replace(places=np.asarray(navigation.places)[:10])
    padded = padding.pad(fewer, padding.common_sizes([navigation, fewer]))
    assert padded.places.shape == navigation.places.shape
    np.testing.assert_array_equal(draw_places(padded, key, 99), draw_places(fewer, key, 99))


def test_fields_of_a_stack_are_replaced():
    two = scenario_stack.stack([Obstacles(*(jnp.full(3, float(k)) for k in (i, 5, 6, 7))) for i in range(2)])
    assert list(two.own) == [0]
    changed = two.with_fields(yaw=scenario_stack.of_arrays(jnp.arange(6.0).reshape(2, 3)), height=jnp.zeros(1))
    np.testing.assert_array_equal(changed.at(1).center, [1.0, 1.0, 1.0])
    np.testing.assert_array_equal(changed.at(1).yaw, [3.0, 4.0, 5.0])
    np.testing.assert_array_equal(changed.vmap(lambda one, x: one.yaw[0] + x)(jnp.arange(4.0)), [0.0, 1.0, 5.0, 6.0])
    assert changed.vmap(lambda one, x: x)(jnp.zeros((4, 0))).shape == (4, 0)


def test_rows_of_a_stack_take_turns():
    """Rows of members in turn, two of each, and pairs with other rows."""
    three = scenario_stack.of_arrays(jnp.asarray([10.0, 20.0, 30.0]))
    rows = jnp.arange(12.0)
    np.testing.assert_array_equal(three.vmap(jnp.add)(rows), rows + np.repeat([10.0, 20.0, 30.0], 4))
    in_turn = three.replace(turn=2)
    np.testing.assert_array_equal(in_turn.vmap(jnp.add)(rows), rows + np.tile(np.repeat([10.0, 20.0, 30.0], 2), 2))
    assert in_turn.take(np.array([2, 0])).turn == 2
    pairs = three.paired(jnp.asarray([1.0, 2.0, 3.0]))
    np.testing.assert_array_equal(pairs.vmap(lambda pair, x: pair[0] * pair[1] + x)(jnp.zeros(3)), [10.0, 40.0, 90.0])


def test_batches_have_whole_turns_of_floors_where_they_are_near(floors):
    """Each floor once if its turns fill the batch, else a floor for each turn; two tasks share a floor."""
    one = devices.mesh(jax.devices()[:1])
    edges = np.stack([floors.at(number).environment.floor for number in range(3)])
    for asked, size, members in [(6, 6, 3), (11, 12, 3), (2, 2, 1), (7, 8, 4), (25, 30, 3)]:
        running = episode_runner.Runner([floors, floors], go_to_goal, asked, "run", mesh=one)
        assert (running.size, running._floors_from(0).size) == (size, members)
        assert episode_runner.batch_size(size, running.floors) == size
        for first in (0, 2, 8):
            in_turn = np.arange(first, first + size) // 2 % 3
            rows = running._floors_from(first).vmap(lambda floor, _: floor.environment.floor)(jnp.zeros(size))
            np.testing.assert_array_equal(rows, edges[in_turn])
            np.testing.assert_array_equal(running.floor_indices(first), in_turn)
        with pytest.raises(ValueError, match="first: 3 is no multiple of the 2 scenarios"):
            running._floors_from(3)


def test_a_kernel_gets_a_row_for_each_floor():
    """Rows of floors are not copied for each scenario, under nested maps in either order."""
    shapes = []

    def call(*operands):
        shapes.append([each.shape[0] for each in operands])
        total = max(shapes[-1])
        scenarios = jax.lax.iota(jnp.int32, total)
        return (
            sum(jax.vmap(lambda i, each=each: each[gpu_kernels.row(each, i, total)])(scenarios) for each in operands),
        )

    def one(floor, lane, shared):
        return gpu_kernels.batch(call, 1)(floor[None, None], lane[None, None], shared[None, None])[0][0, 0]

    floor, lane, shared = jnp.arange(3.0), jnp.arange(12.0).reshape(3, 4), jnp.asarray(100.0)
    found = jax.vmap(jax.vmap(one, (None, 0, None)), (0, 0, None))(floor, lane, shared)
    np.testing.assert_array_equal(found, floor[:, None] + lane + 100.0)
    assert shapes[-1] == ([3, 12, 1] if jax.device_count() == 1 else [12, 12, 1])
    found = jax.vmap(jax.vmap(one, (0, 0, None)), (None, 1, None))(floor, lane, shared)
    np.testing.assert_array_equal(found, (floor[:, None] + lane + 100.0).T)


@pytest.mark.night
def test_a_runner_takes_floors_in_turn(floors):
    """Episode i is on floor i modulo their number, wherever a batch begins."""
    short = floors.map_member(lambda scenario: scenario.replace(time_limit=1.0))
    running = episode_runner.Runner(short, go_to_goal, 6, "run")
    several, later = running.run(3, first=0), running.run(3, first=4, count=2)
    np.testing.assert_allclose(later.states.robot.position, several.states.robot.position[4:], atol=1e-5)
    edges = np.asarray(floors.own[0] if 0 in floors.own else [floors.at(k).environment.floor for k in range(3)])[:, 2:]
    inside = np.asarray(several.states.robot.position) <= np.tile(edges, (2, 1))
    assert inside.all()


def test_sets_are_named():
    assert generated.parse_set("lab") is None
    assert generated.parse_set("worlds:all:7:30") == (tuple(generated.FAMILIES), 7, 30)
    for name, message in [
        ("worlds:rooms", "worlds:FAMILIES:NUMBER"),
        ("worlds:roms:3", "'roms' in worlds:roms:3 is not one of .*rooms"),
        ("worlds:rooms:0", "number in worlds:rooms:0"),
        (f"worlds:rooms:3:{'9' * 5000}", "is no set of worlds"),
    ]:
        with pytest.raises(InputError, match=message):
            generated.parse_set(name)
    names = [folder.name for folder in generated.find("worlds:passages,aisles:3:5")]
    assert names == ["passages_5", "aisles_5", "passages_6"]
    assert [folder.name for folder in generated.find("worlds:passages,aisles:9:5", 2)] == names[:2]
    assert generated.count("worlds:passages,aisles:9:5") == 9 and generated.count("lab") == 1
    with pytest.raises(InputError, match="is 3 floors; this takes one"):
        sean_jax.make(SET)
    with pytest.raises(InputError, match="handcrafted' is not for several"):
        making.build(making.plan_scenario(options(behavior="handcrafted", people=None, task="handcrafted")))
    with pytest.raises(InputError, match="people: 5000 do not fit on a floor of"):
        making.build(making.plan_scenario(options(people=5000)))
    with pytest.raises(InputError, match="'custom' has places on one floor"):
        making.build(making.plan_scenario(options(task=[{"kind": "custom", "start": (1.0, 1.0), "goal": (2.0, 2.0)}])))


@pytest.mark.night
def test_tables_of_wide_robots_are_computed_by_the_other_processes(monkeypatch, tmp_path):
    """They leave nothing to this process but to read: the paths of people and those of each wide robot."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    before = []

    def in_this_process(module, function, arguments, folders):
        if function == "make_tables":
            making.make_tables(*arguments, *map(str, folders))
            before.extend(tables())

    def tables():
        return sorted(path for path in (tmp_path / "sean_jax" / "tables").iterdir() if path.suffix != ".made")

    monkeypatch.setattr(generated, "in_processes", in_this_process)
    options = {"environment": "worlds:passages:2", "robot": "kuri,jackal", "task": "random_ab_nav"}
    making.build_members(making.plan_scenario(validate(ScenarioConfig, options)))
    assert tables() == before != []


def test_a_folder_of_environments_is_a_set(tmp_path):
    for seed in (1, 2):
        generated.save(generated.generate("passages", seed), tmp_path / f"hall_{seed}")
    assert generated.find(tmp_path) == [tmp_path / "hall_1", tmp_path / "hall_2"]
    assert generated.find(tmp_path / "hall_1") == [tmp_path / "hall_1"]
    assert generated.find(tmp_path, 1) == [tmp_path / "hall_1"] and generated.count(str(tmp_path)) == 2
    plan = run_plan.plan_run(RunConfig(environment=str(tmp_path)))
    copies = [f"environment/{tmp_path.name}/hall_{k}/{name}" for k in (1, 2) for name in ("graph.yaml", "scene.xml")]
    assert set(copies) < set(plan.files.content) and plan.description["environment"] == str(tmp_path)
    (tmp_path / "run").mkdir()
    run_plan.write_config(tmp_path / "run", {"people": 4, "versions": {}}, plan)
    saved = run_folder.read_config(tmp_path / "run" / "config.yaml").description
    folder = tmp_path / "run" / "environment" / tmp_path.name
    assert saved["environment"] == str(folder) and generated.find(folder) == [folder / "hall_1", folder / "hall_2"]
    assert not run_plan.plan_run(RunConfig(environment="worlds:passages:2")).files.content


def test_trainings_name_sets_beside_others():
    config = PPOConfig(environment="lab,worlds:rooms,aisles:512,warehouse", scenarios=24)
    assert sorted(config.environments) == ["lab", "warehouse", "worlds:rooms,aisles:512"]
    assert ":" not in config.folder.name


def test_environments_of_a_set_share_their_parts():
    options = {"environment": SET, "people": 4, "observations": ["goal", "path"], "metrics": "none"}
    config = validate(EnvConfig, options)
    envs = registry.build(config)
    shown, _ = jax.eval_shape(lambda envs, keys: envs.vmap(type(envs.member).reset)(keys), envs,
                              jax.eval_shape(lambda: jax.random.split(jax.random.key(0), 6)))  # fmt: skip
    assert shown["goal"].shape == (6, 2) and envs.size == 3


@pytest.mark.night
def test_one_agent_learns_on_several_floors(tmp_path):
    """Restarts stay on their floor; the best agent is loaded for another floor; its evaluation is replayed."""
    from sean_jax import learning
    from sean_jax.evaluation import replay_command
    from sean_jax.learning import reinforcement

    config = PPOConfig(
        method="ppo", environment=SET, people=3, task="random_ab_nav", observations=["goal", "path"], scenarios=6,
        minibatches=2, horizon=8, steps=96, width=8, layers=1, pool=6, time_limit=0.5, evaluation_episodes=6,
        out=tmp_path,
    )  # fmt: skip
    state = reinforcement.train(config)
    rows = jax.tree.map(lambda leaf: leaf[0], state.rows).envs[0].simulation
    floors = making.build_members(making.plan_scenario(options(people=3)))
    for row, position in enumerate(np.asarray(rows.robot.position)):
        x0, y0, x1, y1 = np.asarray(floors.at(row // 2).environment.floor)
        assert x0 <= position[0] <= x1 and y0 <= position[1] <= y1
    assert np.isfinite(np.asarray(state.best.value)).all()
    driver = learning.load(tmp_path, sean_jax.make("lab", people=3))
    assert driver.name
    source = replay_command._of_training(tmp_path, [4, 5])
    assert [source.place(number) for number in (4, 5)] == [1, 2] and len(source.floors) == 1
    np.testing.assert_array_equal(source.floors[0].at(2).environment.floor, floors.at(2).environment.floor)


TWO = "worlds:passages:2"
SMALL = f"--environment {TWO} --behavior random --task random_ab_nav --people 2 --time-limit 0.5".split()


@pytest.mark.parametrize("command", ["run", "collect", "bench"])
@pytest.mark.parametrize(
    "name, message", [("worlds:roms:3", "'roms'"), ("worlds:rooms:0", "number in"), ("worlds:rooms", "no set")]
)
def test_mistakes_in_the_name_of_a_set_are_told_at_once(monkeypatch, tmp_path, capsys, command, name, message):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(generated, "generate", None)
    assert command_line.main([command, "--environment", name]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.night
@pytest.mark.parametrize("name", [name for name in POLICIES if name != "move_base"])
def test_policies_drive_on_floors_of_a_set_as_on_each_alone(name):
    """The same episodes by number, of the second floor."""
    config = options(environment=TWO, behavior="random", task="random_ab_nav", people=4, time_limit=2.0)
    stacks = making.build(making.plan_scenario(config))
    policy = load_policy(name, stacks[0].member)
    several = episode_runner.Runner(stacks, policy, 4, "run").run(3, first=0)
    alone = sean_jax.make(config.replace(environment=str(generated.find(TWO)[1])))
    states = episode_runner.Runner(alone, policy, 4, "run").run(3, first=0).states
    found = several.states
    for one, other in ((found.robot.position, states.robot.position), (found.task.goal, states.task.goal)):
        np.testing.assert_allclose(one[1::2], other[1::2], atol=1e-3)
    measured = episode_runner.batch_results(alone, states)
    for key, values in episode_runner.batch_results(stacks[0].member, found).items():
        np.testing.assert_allclose(values[1::2], measured[key][1::2], rtol=1e-2, atol=1e-2, err_msg=key)
    assert np.abs(np.asarray(found.robot.position - found.task.start)).max() > 0.05


@pytest.mark.night
def test_a_run_of_a_set_is_resumed_and_names_its_floors(monkeypatch, tmp_path):
    """Of three episodes on two floors; batches of one; the second batch is interrupted."""
    monkeypatch.chdir(tmp_path)
    words = ["run", *SMALL, "--episodes", "3", "--batch", "1", "--trajectories", "csv", "--quiet"]
    assert command_line.main([*words, "--out", "whole"]) == 0
    with monkeypatch.context() as patched:
        at_second_batch(patched, lambda _: signal.raise_signal(signal.SIGTERM))
        assert command_line.main([*words, "--out", "made"]) == 143
    assert (tmp_path / "made" / "unfinished").is_dir()
    assert command_line.main([*words, "--out", "made"]) == 0
    for name in ("episodes.csv", "trajectories.csv", "episode.gif"):
        assert (tmp_path / "made" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    rows = list(csv.DictReader((tmp_path / "made" / "episodes.csv").open()))
    assert [row["environment"] for row in rows] == ["passages_0", "passages_1", "passages_0"]
    summary = json.loads((tmp_path / "made" / "summary.json").read_text())
    assert (summary["floors"], summary["set_floors"]) == (2, 2) and "largest_groups" not in summary["checks"]
    assert summary["environments"] == ["passages_0", "passages_1"]
    report = (tmp_path / "made" / "report.html").read_text()
    assert "Episode 0 · passages 0 · random ab nav" in report and "Where people were" not in report
    assert command_line.main(["compare", "made", "whole", "--quiet"]) == 0
    assert command_line.main(["replay", "made", "--episodes", "0", "1", "2", "--quiet"]) == 0
    first, second = played(tmp_path / "made" / "replay.html")
    assert [each["title"] for each in first["episodes"]] == [f"episode {k} · random ab nav" for k in (0, 2)]
    for page, folder in zip((first, second), generated.find(TWO), strict=True):
        alone = environment.load(folder)
        np.testing.assert_allclose(page["place"]["floor"], alone.floor, atol=1e-3)
        assert len(page["place"]["obstacles"]) == len(alone.obstacles.yaw)
        assert not any("in the run" in each["outcome"] for each in page["episodes"])


@pytest.mark.night
def test_evaluate_takes_floors():
    """In Python; two episodes on the first floors of three, padded and with frames on their own floors."""
    config = options(time_limit=0.5, people=2, task=["join_group", "leave_group"])
    floors = making.build(making.plan_scenario(config))
    made = sean_jax.evaluate(floors, episodes=4)
    assert list(made.floors) == ["passages_0", "passages_0", "aisles_0", "aisles_0"]
    assert made.tasks == ["join_group", "leave_group"] * 2 and made.set_floors == 3
    np.testing.assert_array_equal(made.place(2).environment.floor, floors[0].at(1).environment.floor)
    assert "on 2 floors" in made.title and made.summary()["floors"] == 2
    (only,) = making.build(making.plan_scenario(config.replace(task="join_group")), limit=1)
    assert only.size == 1 and only.names == ("passages_0",)


@pytest.mark.night
def test_demonstrations_of_a_set_name_the_floor_of_each_episode(monkeypatch, tmp_path, capsys):
    """An extended collection equals one at once; an episode is driven again on its floor."""
    pytest.importorskip("tensorstore")
    from sean_jax.learning import dataset

    monkeypatch.chdir(tmp_path)
    words = ["collect", *SMALL, "--width", "16", "--height", "12", "--quiet"]
    assert command_line.main([*words, "--batch", "9", "--out", "uneven"]) == 2
    assert "9 episodes do not spread evenly over 2 floors; take 10" in capsys.readouterr().err
    for hours in ("0.001", "0.002"):
        assert command_line.main([*words, "--batch", "2", "--hours", hours, "--out", "data"]) == 0
    manifest = json.loads((tmp_path / "data" / "dataset.json").read_text())
    assert manifest["environments"] == ["passages_0", "passages_1"] and len(manifest["shards"]) == 4
    assert all(shard["floors"] == [0, 1] for shard in manifest["shards"])
    assert command_line.main(["replay", "data", "--episodes", "3", "--quiet"]) == 0
    (page,) = played(tmp_path / "data" / "replay.html")
    np.testing.assert_allclose(page["place"]["floor"], environment.load(generated.find(TWO)[1]).floor, atol=1e-3)
    (episode,), data = page["episodes"], dataset.open_dataset(tmp_path / "data")
    rows = data.read([each for each in data.episodes if each.number == 3])
    np.testing.assert_allclose(episode["columns"]["robot x"][0], rows["pose"][0, 0], atol=0.1)
    assert "in the dataset" not in episode["outcome"]


@pytest.mark.night
def test_a_set_is_timed_as_one_program(tmp_path):
    words = f"bench --environment {TWO} --people 2 --only step --batches 1 3 --seconds 0.01 --repeats 1 --quiet --out"
    assert command_line.main([*words.split(), str(tmp_path / "made")]) == 0
    found = json.loads((tmp_path / "made" / "bench.json").read_text())
    assert found["floors"] == 2 and [row["batch"] for row in found["rows"]] == [1, 4]
    assert all(row["per_second"] > 0 for row in found["rows"])


@pytest.mark.night
def test_starts_of_several_tasks_do_not_copy_the_tables():
    """With 2 or 8 floors as much memory for as many starts."""
    memory = {}
    for floors in (2, 8):
        options = {"environment": f"worlds:rooms,aisles:{floors}", "task": ["join_group", "leave_group"]}
        env = registry.build(validate(EnvConfig, options | {"observations": ["goal"], "metrics": "none"}))
        draw = jax.jit(lambda env, key: rollouts.draw_pool(env, key, 128))
        memory[floors] = draw.lower(env, jax.random.key(0)).compile().memory_analysis().temp_size_in_bytes
    assert memory[8] < 2.5 * memory[2], memory  # 3.9 times with a copy for each start
