"""Experiments: counting and intervals against closed forms, resuming, refusals, and both reports at toy size."""

import dataclasses
import functools
import gc
import json
import shutil
import threading
import time
import weakref
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax.classifiers import MORE_SITUATIONS
from sean_jax.cli import command_line
from sean_jax.config import AblationConfig, CollectConfig, Figure4Config, Table1Config, validate
from sean_jax.config.workspace import Workspace, identity
from sean_jax.core import random_streams
from sean_jax.core.data_types import as_policy
from sean_jax.core.errors import FileError, InputError
from sean_jax.learning.collection import Recorder, record, streams
from sean_jax.metrics import METRICS
from sean_jax.metrics.bootstrap import resamples
from sean_jax.policies import POLICIES, go_to_goal
from sean_jax.simulation import episode_runner as runners
from sean_jax.simulation import episodes
from sean_jax.simulation.episode_runner import Runner, even_batch
from sean_jax.simulation.scenario import results
from sean_jax.studies import experiments
from sean_jax.studies.experiments import demonstrations, figure4, measures, shares, table1
from sean_jax.studies.experiments.measures import MEASURES, WAITING, has_learned
from sean_jax.studies.experiments.results_table import ALL, Table, join, rows
from sean_jax.studies.experiments.shares import BEHAVIORS
from support import learning_data
from support.files import write


@pytest.fixture(autouse=True, scope="module")
def frozen_heap():
    """What is there before is not looked through for cycles after each part."""
    gc.freeze()
    yield
    gc.unfreeze()


def test_entropy_is_that_of_the_papers_rows():
    """Of Table I, natural logarithms over ln 5: 0.562, 0.388 and 0.958."""
    found = {name: shares.normalised_entropy(row) for name, row in shares.paper().items()}
    np.testing.assert_allclose([found[name] for name in BEHAVIORS], [0.562, 0.388, 0.958], atol=6e-4)
    np.testing.assert_allclose(shares.normalised_entropy(np.full((2, 5), 0.2)), 1.0)
    assert shares.normalised_entropy(np.array([0.0, 0, 0, 0, 3])) == 0 == shares.normalised_entropy(np.zeros(5))


def test_ways_of_counting():
    flags = np.zeros((2, 4, 5), bool)
    flags[0, 0, :2] = True  # cross and down path together
    flags[0, 1, 4] = flags[0, 2, 4] = flags[1, 0, 4] = True

    def samples(flags: np.ndarray) -> np.ndarray:
        (found,) = shares.chain_shares(cell(flags), [], draw=lambda sizes: resamples(2)).values()
        return found

    found = samples(flags)
    counts = np.array([1, 1, 0, 0, 3])
    for counting, whole in {"flags": 5, "flags_and_none": 9, "examples": 8, "situated_examples": 4}.items():
        np.testing.assert_allclose(shares.counted(found, counting)[0], counts / whole)
    assert set(shares.COUNTINGS) == {"flags", "flags_and_none", "examples", "situated_examples"}
    assert cell(flags).where(measure=shares.EXAMPLES).value.sum() == 8 and found[0, 5] == 0.5
    low, high = shares.interval(found)
    assert (low <= found[0]).all() and (found[0] <= high).all()
    nothing = samples(np.zeros((2, 4, 5), bool))
    assert all(np.all(shares.counted(nothing, counting) == 0.0) for counting in shares.COUNTINGS)
    assert np.all(nothing[:, 5] == 1.0)


def cell(flags: np.ndarray, streams: int = 1) -> Table:
    """The rows of chains (C, seconds, 5) at one walking speed."""
    labels = {"policy": "go_to_goal", "behavior": "graph", "people": 9}
    return shares.chain_rows(flags[None], flags, np.array([1, 0]), streams, [""], **labels)


def chains(random: np.random.Generator, streams: int, number: int, minutes: int) -> Table:
    """Chains of random people: minutes are random as a whole, and join group occurs in the last stream alone."""
    rates = random.beta(2.0, 4.0, (streams, number, 1))  # successive minutes of a chain are alike
    flags = random.random((streams, number, minutes)) < rates
    several = np.zeros((1, streams, number, 60 * minutes, 5), bool)
    several[0, ..., 4] = np.repeat(flags, 60, axis=-1)
    several[0, -1, ..., 2] = True
    return cell(several.reshape(streams * number, 60 * minutes, 5), streams)


def test_intervals_of_the_mean_and_of_an_hour_hold_as_often_as_they_say():
    """The share of empty is 1/3 of the examples, of two streams of half an hour; join group never varies."""
    random, mean, hour = np.random.default_rng(0), [], []
    for _ in range(300):
        measured = chains(random, 2, 25, 6)
        (of_mean,) = shares.chain_shares(measured, []).values()
        (of_hour,) = shares.chain_shares(measured, [], draw=functools.partial(shares._of_an_hour, measured)).values()
        another = chains(random, 2, 5, 6).where(measure=shares.SHARE, situation="empty").value.mean()
        for found, truth, inside in ((of_mean, 1 / 3, mean), (of_hour, another, hour)):
            low, high = shares.interval(found)
            inside.append(low[4] <= truth <= high[4])
            assert low[2] == pytest.approx(0.5) == high[2]
    assert 0.92 <= np.mean(mean) <= 0.98 and 0.92 <= np.mean(hour) <= 0.98


def test_the_papers_hour_is_tested_against_an_hour():
    """A figure of the paper within our hours fits, another does not; Holm's correction is of one policy's figures."""
    random = np.random.default_rng(1)
    tests = shares.hours(chains(random, 2, 50, 6))
    assert [test["figure"] for test in tests] == [*shares.NAMES, "entropy"]
    by = {test["figure"]: test for test in tests}
    assert by["empty"]["low"] < by["empty"]["paper"] < by["empty"]["high"] and by["empty"]["p"] > 0.05
    assert by["cross_path"]["p"] == pytest.approx(2 / 2001) and by["cross_path"]["holm"] < 0.05
    assert by["cross_path"]["holm"] == pytest.approx(6 * by["cross_path"]["p"], rel=0.7)
    assert all(test["holm"] >= test["p"] for test in tests)


def row(*percent: float) -> np.ndarray:
    """Shares of a behavior known exactly, in all examples and in two resamples."""
    return np.tile([*(value / 100 for value in percent), 0.0], (3, 1))


def test_the_papers_own_table_has_the_papers_orderings():
    told = shares.orderings({name: row(*values) for name, values in shares.PAPER.items()})
    assert [each["name"] for each in told] == [f"T{k}" for k in range(1, 11)]
    assert all(each["holds"] and each["share"] == 1.0 for each in told)


def test_other_tables_have_not():
    same = row(20, 20, 20, 20, 20)
    told = {each["name"]: each["holds"] for each in shares.orderings(dict.fromkeys(BEHAVIORS, same))}
    assert told["T8"] and told["T10"] and not any(told[name] for name in ("T1", "T2", "T3", "T4", "T5", "T6", "T7"))


def driven(values: dict, violations: dict | None = None, networks: tuple[int, int] = (1, 1)) -> Table:
    """The rows of policy -> behavior -> measure -> (E,), and of violations (E, 5) of each policy in each situation."""
    tables = []
    for policy, by_behavior in values.items():
        for behavior, cell in by_behavior.items():
            datasets, trainings = networks if has_learned(policy) else (1, 1)
            count = len(cell["completed"])
            network = np.arange(count) // (count // (datasets * trainings))
            labels = {"policy": policy, "behavior": behavior}
            labels |= {"dataset": network // trainings, "seed": network % trainings}
            waiting = {WAITING: cell["time_not_moving"] * cell["completed"]}
            tables += [rows(value, measure=name, **labels) for name, value in (cell | waiting).items()]
            by_situation = np.zeros((count, 5)) if violations is None else violations[policy]
            tables.append(rows(by_situation, shares.NAMES, measure="violations", **labels))
    return join(tables)


def test_claims_of_figure_4():
    def cell(wait: float, harm: float, done: float) -> dict:
        names = ("completed", done), ("time_not_moving", wait), ("violations", harm), ("collisions", 0.0)
        return {name: np.full(10, value) for name, value in names}

    waits = {"G": 11.0, "R": 16.3, "H": 25.0, "B": 11.0, "N": 28.7, "E": 5.0}
    harms = {"random": 1.9, "handcrafted": 1.0, "graph": 2.5}
    values = {p: {b: cell(waits[p], harms[b], 0.9) for b in BEHAVIORS} for p in waits}
    by = {p: np.tile([1.0, 1.0, 0.2, 0.2, 0.1], (10, 1)) for p in waits} | {"B": np.full((10, 5), 0.1)}
    told = measures.claims(driven(values, by))
    assert all(test["holds"] and test["share"] == 1.0 for test in told)
    values["G"] = {b: cell(30.0, harms[b], 0.5) for b in BEHAVIORS}
    told = {test["statement"]: test["holds"] for test in measures.claims(driven(values, by))}
    assert not told["N stands longest, s"] and not told["G stands less than R, s"]
    assert not told["the learned complete 80 % of what the demonstrator does"]

    found = measures.figure4_estimates(driven(values, by))
    assert found["R", "graph", "completed", ALL].mean == pytest.approx(90.0)
    assert found["R", "mean", "completed", ALL].mean == pytest.approx(90.0)
    assert found["B-G", "mean", "time_not_moving", ALL].mean == pytest.approx(11.0 - 30.0)
    assert found["B-G", "graph", "violations", "cross_path"].mean == pytest.approx(-0.9)
    assert found["GRHN", "random", "violations", ALL].mean == pytest.approx(1.9)
    some = {name: value.copy() for name, value in values["G"]["graph"].items()}
    some["completed"], some["time_not_moving"] = np.repeat([1.0, 0.0], 5), np.repeat([2.0, 90.0], 5)
    values["G"] = {b: some for b in BEHAVIORS}
    found = measures.figure4_estimates(driven(values, by))
    assert found["G", "graph", "time_not_moving", ALL].mean == pytest.approx(46.0)
    assert found["G", "graph", WAITING, ALL].mean == pytest.approx(2.0), "of the completed alone"
    some["completed"][:] = 0.0
    assert measures.figure4_estimates(driven(values, by))["G", "graph", WAITING, ALL].episodes == 0


def test_balanced_odds_make_situations_equally_frequent():
    from sean_jax.learning.examples import balanced_probabilities

    random = np.random.default_rng(0)
    flags = random.random((2000, 5)) < [0.15, 0.25, 0.08, 0.1, 0.0]
    flags[~flags.any(1) & (random.random(2000) < 0.6), 4] = True  # empty, and nothing else
    p = balanced_probabilities(flags)
    assert p.min() >= 0 and p.sum() == pytest.approx(1.0, abs=1e-5)
    shared = p @ (flags / np.maximum(flags.sum(1, keepdims=True), 1))
    assert shares.normalised_entropy(shared) >= 0.98 > shares.normalised_entropy(flags.mean(0))
    none = ~flags.any(1)
    assert p[none].sum() == pytest.approx(none.mean(), abs=1e-5)
    without = balanced_probabilities(flags & np.array([True, True, True, True, False]))
    np.testing.assert_allclose(without.sum(), 1.0, atol=1e-5)
    np.testing.assert_allclose(balanced_probabilities(np.zeros((4, 5), bool)), 0.25)


def test_a_folder_of_another_experiment_is_refused(tmp_path):
    options = Table1Config(quick=True, out=tmp_path / "here")
    work = Workspace(options.folder, identity(options))
    assert not work.begun()
    with work.open():
        work.begin()
    assert work.begun()
    other = Table1Config(quick=True, seed=1, out=tmp_path / "here")
    with pytest.raises(InputError, match="was begun with --seed 0, not 1; ask for the same or choose another --out"):
        Workspace(other.folder, identity(other)).begun()
    before = work.load(work.file)
    work.save(work.file, {**before, "versions": {**before["versions"], "jax": "0.1"}})
    with pytest.raises(InputError, match="was begun with jax 0.1, not .*; ask for the same"):
        work.begun()
    write(tmp_path / "full" / "letter.txt", "dear")
    with pytest.raises(InputError, match="holds something else"):
        Workspace(tmp_path / "full", identity(options)).begun()
    for content in ("{", '{"options": []}'):
        (tmp_path / "here" / work.file).write_text(content)
        with pytest.raises(InputError, match="damaged"):
            work.begun()


def test_a_damaged_cell_is_named(tmp_path):
    options, unasked = Table1Config(quick=True, out=tmp_path), cast(Any, None)
    (tmp_path / "random-expert.npz").write_text("half of it")
    with pytest.raises(FileError, match="random-expert.npz: is damaged; remove it, and the same command"):
        table1.cell(options, Workspace(tmp_path, {}), "random-expert", "random", "expert", unasked, unasked)


def test_parts_wait_for_what_they_need_and_are_the_same_in_threads(monkeypatch):
    order, made, both = [], [], threading.Barrier(2, timeout=20)
    shared = experiments.cached(lambda name: made.append(name) or object())

    def work(name: str, meet: bool, tell):
        if meet:
            both.wait()  # passes if two parts are at work at once, and only then
        order.append(name)
        tell(0.5)
        return name, shared("place")

    def parts(meet: bool) -> list:
        alone = [experiments.ExperimentPart(name, functools.partial(work, name, meet)) for name in "ab"]
        return [*alone, experiments.ExperimentPart("c", functools.partial(work, "c", False), ("a", "b"))]

    monkeypatch.setattr(experiments, "workers", lambda: 3)
    found = experiments.run_parts(parts(True), None, "at work")
    assert order[2] == "c" and made == ["place"]
    monkeypatch.setattr(experiments, "workers", lambda: 1)
    assert experiments.run_parts(parts(False), None, "at work") == found and order[3:] == ["a", "b", "c"]


@pytest.mark.parametrize("error", [FloatingPointError, KeyboardInterrupt])
def test_a_failure_stops_the_other_parts_and_is_raised(error, monkeypatch):
    began, stopped, never = threading.Event(), [], []

    def lasting(tell):
        began.set()
        try:
            for _ in range(2000):
                time.sleep(0.01)
                tell(0.1)
        except experiments.Stopped:
            stopped.append(True)
            raise

    def failing(tell):
        began.wait(20)
        raise error("a robot is nowhere")

    parts = [experiments.ExperimentPart("lasting", lasting), experiments.ExperimentPart("failing", failing)]
    parts.append(experiments.ExperimentPart("after", never.append, ("failing",)))
    monkeypatch.setattr(experiments, "workers", lambda: 2)
    with pytest.raises(error, match="nowhere"):
        experiments.run_parts(parts, None, "at work")
    assert stopped == [True] and not never


@pytest.mark.parametrize(
    "message",
    ["RESOURCE_EXHAUSTED: Out of memory while trying to allocate 6.60GiB.", "INTERNAL: out of memory [jit_bitwise_or]"],
)
def test_parts_that_are_out_of_memory_run_again_beside_fewer(monkeypatch, message):
    lock, running, failures, gone = threading.Lock(), set(), [], []

    class Array:
        """What a part has on the device."""

    def work(name: str, fitting: int, tell) -> str:
        array = Array()
        weakref.finalize(array, gone.append, name)
        with lock:
            running.add(name)
            full = len(running) > fitting
        try:
            if full:
                failures.append(name)
                raise jax.errors.JaxRuntimeError(message)
            if name == "last":
                assert set(gone) >= set(failures)
            for _ in range(5):
                time.sleep(0.01)
                tell(0.5)
            return name
        finally:
            with lock:
                running.remove(name)

    def parts(fitting: int) -> list:
        own = [experiments.ExperimentPart(name, functools.partial(work, name, fitting)) for name in "abcdef"]
        return [*own, experiments.ExperimentPart("last", functools.partial(work, "last", fitting), tuple("abcdef"))]

    monkeypatch.setattr(experiments, "workers", lambda: 4)
    results = experiments.run_parts(parts(2), None, "at work")
    assert results == {name: name for name in [*"abcdef", "last"]} and failures and not running
    with pytest.raises(jax.errors.JaxRuntimeError, match="emory"):  # a part that does not fit alone
        experiments.run_parts(parts(0), None, "at work")


def test_several_devices_or_few_cores_work_one_by_one(monkeypatch):
    monkeypatch.setattr(experiments.os, "sched_getaffinity", lambda _: set(range(16)), raising=False)
    monkeypatch.setattr(experiments.os, "sysconf", {"SC_PHYS_PAGES": 64_000_000, "SC_PAGE_SIZE": 1000}.get)
    assert experiments.workers() == 8
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert experiments.workers() == 16
    monkeypatch.setattr(experiments.os, "sysconf", {"SC_PHYS_PAGES": 16_000_000, "SC_PAGE_SIZE": 1000}.get)
    assert experiments.workers() == 5
    monkeypatch.setattr(jax, "default_backend", lambda: "cpu")
    monkeypatch.setattr(experiments.os, "sched_getaffinity", lambda _: {0, 1}, raising=False)
    assert experiments.workers() == 1
    monkeypatch.setattr(experiments.os, "sched_getaffinity", lambda _: set(range(16)), raising=False)
    monkeypatch.setattr(jax, "devices", lambda: ["one", "another"])
    assert experiments.workers() == 1


@pytest.mark.night
def test_numbered_episodes_are_those_of_their_streams(monkeypatch):
    """Of five streams in one batch: as rolled out alone, from the key of the number, with the stream's scenario."""
    # Three seconds: later on, rounding decides who gives way to whom.
    asked = CollectConfig(behavior="handcrafted", environment="lab", dynamics="twin", time_limit=3.0)
    metrics = (("path_length", METRICS["path_length"]),)
    kinds = [dataclasses.replace(kind, metrics=metrics) for kind in streams(asked).values()]
    told = []
    monkeypatch.setattr(runners, "max_batch", lambda: 5)
    runner = Runner(kinds, go_to_goal, even_batch(7), "figure4")
    found = runner.measure(3, 0, 7, told.append)
    assert len(found["seconds"]) == 7 and 0 < found["seconds"].min() and found["seconds"].max() <= 3.0 + 1e-3
    assert told == sorted(told) and told[-1] <= 1.0

    @jax.jit
    def alone(scenario, number):
        key = jax.random.fold_in(random_streams.key("figure4", 3), number)
        state, _ = episodes.rollout(scenario, go_to_goal, key, 30)
        return results(scenario, state), state.completed

    for number in range(7):
        measured, completed = alone(kinds[number % 5], jnp.uint32(number))
        assert bool(completed) == found["completed"][number]
        assert found["path_length"][number][0] == pytest.approx(float(measured["path_length"][0]), abs=0.05)


@pytest.mark.night
def test_chains_restart_from_their_own_stream():
    asked = CollectConfig(behavior="handcrafted", environment="lab", dynamics="twin", time_limit=20.0)
    kinds = list(streams(asked).values())
    there = table1.ProtocolStreams(kinds, 3, 2, 3)
    pools = there.starts()
    assert there.starts() is pools
    for index, (kind, seed) in enumerate((kind, seed) for kind in range(5) for seed in (3, 4)):
        key = jax.random.fold_in(
            random_streams.key("table1 starts", seed), kind
        )  # as each stream and seed alone would draw them
        alone = jax.jit(episodes.reset_pool, static_argnums=2)(kinds[kind], key, 3).starts
        np.testing.assert_allclose(pools.robot.position[index], alone.robot.position, atol=1e-5)
        np.testing.assert_allclose(pools.pedestrians.position[index], alone.pedestrians.position, atol=1e-5)

    def starts(pools, stream, key):
        return episodes.draw_start(episodes.ResetPool(pools), *jax.random.split(key), stream)

    starts = jax.vmap(starts, (None, 0, 0))
    stream = jnp.repeat(jnp.arange(10, dtype=jnp.int32), 4)
    drawn = starts(pools, stream, jax.random.split(jax.random.key(1), 40))
    for each, place in zip(np.asarray(stream), np.asarray(drawn.robot.position), strict=True):
        assert (np.asarray(pools.robot.position[each]) == place).all(-1).any()
    assert len(np.unique(np.asarray(jax.random.key_data(drawn.streams.people)), axis=0)) == 40


@pytest.mark.night
def test_chains_of_a_seed_do_not_depend_on_other_seeds_and_further_situations():
    """Those of the scenario stay as they are, and a further one that is one of them equals it in every second."""
    asked = CollectConfig(behavior="random", environment="lab", dynamics="twin", time_limit=20.0, people=6)
    kinds = list(streams(asked).values())
    further = tuple(kinds[0].situations[::2])

    def minutes(seed, seeds, *more):
        there = table1.ProtocolStreams(kinds, seed, seeds, 4)
        return table1.simulate_chains(as_policy(go_to_goal), there, 2, 1, lambda _: None, *more)

    alone, ended = minutes(5, 1)
    several, _ = minutes(4, 2)
    np.testing.assert_array_equal(several.reshape(len(kinds), 2, 2, 1, 60, 5)[:, 1].reshape(alone.shape), alone)
    both, again = minutes(5, 1, further)
    assert alone.shape == (2 * len(kinds), 1, 60, 5) and both.shape == (*alone.shape[:3], 8)
    np.testing.assert_array_equal(both[..., :5], alone)
    np.testing.assert_array_equal(both[..., 5:], alone[..., ::2])
    np.testing.assert_array_equal(ended, again)
    assert alone.any()


SMALL = "--environment lab --quick --people 4 --time-limit 20 --quiet"


@pytest.mark.night
def test_table1(tmp_path, monkeypatch):
    """With three parts at once, and what is missing one by one, to the same bytes."""
    monkeypatch.setattr(experiments, "workers", lambda: 3)
    out = tmp_path / "table1"
    given = f"{SMALL} --hours 0.0167 --seeds 1 --policies go_to_goal --out {out}".split()
    assert command_line.main(["experiment", "table1", *given]) == 0
    text = (out / "report.html").read_text(encoding="utf-8")
    assert "62.90" in text and "src=" not in text and "http" not in text.replace("http://www.w3.org", "")
    rows = [line.split(",") for line in (out / "shares.csv").read_text(encoding="utf-8").splitlines()[1:]]
    groups = [float(r[6]) for r in rows if r[1] == "random" and r[5] in ("join_group", "leave_group")]
    assert groups and not any(groups)
    # Who walks more slowly counts as well at a lower V, so cross path cannot get rarer.
    cross = {
        b: [float(r[6]) for r in rows if r[1] == b and r[4] == "examples" and r[5] == "cross_path"] for b in BEHAVIORS
    }
    for values in cross.values():
        assert len(values) == 6 and all(one <= other + 1e-9 for one, other in zip(values, values[1:], strict=False))
    further = [line.split(",") for line in (out / "more.csv").read_text(encoding="utf-8").splitlines()[1:]]
    names = list(MORE_SITUATIONS)
    assert [row[3] for row in further] == 3 * names and {row[1] for row in further} == set(BEHAVIORS)
    for behavior in BEHAVIORS:
        with np.load(out / f"{behavior}-go_to_goal-4.npz") as cell:
            told = np.unpackbits(cell["more"], axis=-1, count=len(names)).reshape(-1, len(names)).mean(0)
            assert len(cell["more"]) == cell["flags"].shape[1], "once, and not for each V"
        ours = [(float(row[4]), float(row[5]), float(row[6])) for row in further if row[1] == behavior]
        np.testing.assert_allclose([share for share, _, _ in ours], told, atol=1e-5)
        assert all(low <= share + 1e-9 <= high + 2e-9 for share, low, high in ours) and told.any()
    assert "activity space" in text
    before = {path.name: path.read_bytes() for path in out.iterdir() if path.suffix == ".csv"}
    (out / "random-go_to_goal-4.npz").unlink()
    old = out / "graph-go_to_goal-4.npz"  # of a version that did not write the number of chains
    with np.load(old) as cell:
        kept = {name: cell[name] for name in cell if name != "chains"}
    np.savez_compressed(old, **kept)
    monkeypatch.setattr(experiments, "workers", lambda: 1)
    assert command_line.main(["experiment", "table1", *given]) == 0
    after = {path.name: path.read_bytes() for path in out.iterdir() if path.suffix == ".csv"}
    assert all(before[name] == content for name, content in after.items())


@pytest.mark.night
def test_demonstrations_in_table1(tmp_path):
    """Each example counts once, in the rows of its behavior and driver; a recorder's and a collection's alike."""
    collected = learning_data.write(tmp_path / "collected")
    studio = tmp_path / "drives" / "demonstrations"
    scenario = learning_data.setting()[0]["join_group"]
    record(Recorder(studio, scenario, width=16, height=12), lambda _: (0.5, 0.2), 2)
    given = ["--policies", "none", "--demonstrations", str(tmp_path / "drives"), str(collected.folder)]
    assert command_line.main(["experiment", "table1", *given, "--out", str(tmp_path / "out")]) == 0
    lines = (tmp_path / "out" / "demonstrations.csv").read_text(encoding="utf-8").splitlines()[1:]
    rows = [line.split(",") for line in lines]
    both = [demonstrations.open_datasets([folder]) for folder in (studio, collected.folder)]
    flags = np.concatenate([data.read(data.episodes, ("situations",))["situations"] for data in both])
    ours = {row[-4]: float(row[-3]) for row in rows if row[-5] == "examples"}
    assert ours == pytest.approx(dict(zip(both[0].manifest["situations"], flags.mean(0), strict=True)), abs=1e-5)
    assert f"human, {collected.manifest['policy']}" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_demonstrations_of_other_scenarios_are_refused(tmp_path):
    collected = learning_data.write_fine(tmp_path / "collected")
    data = demonstrations.read([collected.folder])
    assert list(data) == ["graph"]
    scenario = learning_data.setting()[0]["join_group"]
    demonstrations.check(data, "graph", scenario)
    demonstrations.check(data, "random", scenario)
    longer = dataclasses.replace(scenario, time_limit=30.0)
    with pytest.raises(InputError, match="has time_limit 20, and the experiment 30; give the experiment --time-limit"):
        demonstrations.check(data, "graph", longer)
    with pytest.raises(InputError, match="has no dataset.json"):
        demonstrations.read([tmp_path])
    options = validate(Figure4Config, {"demonstrations": (collected.folder,), "out": tmp_path / "out", "datasets": 2})
    with pytest.raises(InputError, match="--datasets: all demonstrations of a behavior are one dataset"):
        figure4.run_figure4(options)
    lab = {"environment": "lab", "people": 4, "time_limit": 30.0}
    options = validate(Figure4Config, {"demonstrations": (collected.folder,), "out": tmp_path / "out", **lab})
    with pytest.raises(InputError, match="has time_limit 20, and the experiment 30"):
        figure4.run_figure4(options)
    assert not (tmp_path / "out").exists()


def test_demonstrations_in_figure4(tmp_path):
    """G and B learn from them; R and H from the demonstrator, in images of the same size."""
    data = learning_data.write_fine(tmp_path / "collected")
    options = validate(Figure4Config, {"demonstrations": (data.folder,), "out": tmp_path / "out"})
    datasets, work = demonstrations.read(options.demonstrations), Workspace(options.folder, identity(options))
    learners = {policy: figure4.learner(options, work, policy, datasets) for policy in "GRHB"}
    parts = [part.name for part in figure4.learning_parts(learners)[0]]
    assert [name for name in parts if name.startswith("demon")] == [
        "demonstrations-random",
        "demonstrations-handcrafted",
    ]
    for policy in "GB":
        training = learners[policy].training((0, 1))
        assert (training.dataset, training.part, training.balance) == (data.folder, (1, 1), policy == "B")
        assert figure4._examples(training)["examples"] == data.example_count
    collected = learners["R"].data
    assert (collected.width, collected.height, collected.rate) == (16, 12, 10)
    assert learners["R"].training((0, 1)).dataset == collected.folder


@pytest.mark.night
def test_figure4(tmp_path, monkeypatch):
    """With four parts at once, and some of it anew one by one, to the same bytes."""
    monkeypatch.setattr(experiments, "workers", lambda: 4)
    out = tmp_path / "figure4"
    given = f"{SMALL} --hours 0.0167 --episodes 5 --epochs 2 --demonstrator go_to_goal --trainings 2".split()
    given += f"--baselines mine --out {out}".split()
    for name in ("social_costmap", "mine"):  # whose programs XLA has compiled already
        monkeypatch.setitem(POLICIES, name, POLICIES["go_to_goal"])
    assert command_line.main(["experiment", "figure4", *given]) == 0
    rows = [line.split(",") for line in (out / "figure4.csv").read_text(encoding="utf-8").splitlines()[1:]]
    assert {r[0] for r in rows} == {*"GRHBNE", "mine", "B-G", "GRHN"} and {r[1] for r in rows} == {*BEHAVIORS, "mean"}
    done = [float(r[3]) for r in rows if r[2] == "completed" and r[1] != "mean" and r[0] != "B-G"]
    means = {r[0]: float(r[3]) for r in rows if r[2] == "completed" and r[1] == "mean"}
    assert means["B-G"] == pytest.approx(means["B"] - means["G"], abs=1e-4)
    assert len(done) == 21 and all(0 <= value <= 100 for value in done) and max(done) > 0
    episodes = json.loads((out / "episodes-E-handcrafted.json").read_text(encoding="utf-8"))
    assert len(episodes["completed"]) == 6 and max(episodes["seconds"]) <= 20.0 + 1e-3
    assert "Figure 4" in (out / "report.html").read_text(encoding="utf-8")
    before = {name: (out / name).read_bytes() for name in ("figure4.csv", "claims.csv")}
    for missing in ("trained-random-0-1.json", "episodes-R-random.json", *before):
        (out / missing).unlink()
    shutil.rmtree(out / "policy-random-0-1")
    monkeypatch.setattr(experiments, "workers", lambda: 1)
    assert command_line.main(["experiment", "figure4", *given]) == 0
    assert all((out / name).read_bytes() == content for name, content in before.items())


def test_contrasts_of_figure_4():
    """Networks are compared by datasets and other policies by episodes, as scipy does; Holm's correction is of all."""
    from scipy import stats

    random = np.random.default_rng(2)
    shifts = {"G": 0.0, "R": 2.0, "H": 0.5, "B": 0.0, "N": 1.0, "E": 3.0}

    def cell(policy: str) -> dict:
        own = random.normal(shifts[policy], 0.5, (5, 1)) if has_learned(policy) else np.full((5, 1), shifts[policy])
        cells = {name: (own + random.normal(0.0, 1.0, (5, 16))).ravel() for name in MEASURES}
        return {**cells, "completed": (cells["completed"] > 0.0).astype(float)}

    values = {policy: {b: cell(policy) for b in BEHAVIORS} for policy in shifts}
    table = driven(values, networks=(5, 2))
    tests = {(test["one"], test["other"], test["measure"]): test for test in measures.contrasts(table)}
    assert len(tests) == 7 * len(MEASURES) and tests["G", "R", "violations"]["holm"] < 0.05
    for one, other, units in ("G", "R", 5), ("G", "N", 5), ("E", "N", 80):
        ours, theirs = (np.mean([values[p][b]["violations"] for b in BEHAVIORS], 0) for p in (one, other))
        gaps = (ours - theirs).reshape(units, -1).mean(1)
        row, student = tests[one, other, "violations"], stats.ttest_1samp(gaps, 0.0)
        assert row["p"] == pytest.approx(student.pvalue)
        assert row["effect"] == pytest.approx(gaps.mean() / gaps.std(ddof=1))
        estimate, ends = row["difference"], student.confidence_interval()
        assert estimate.mean == pytest.approx(gaps.mean())
        np.testing.assert_allclose([estimate.low, estimate.high], ends, atol=0.1 * (ends[1] - ends[0]))
        assert row["holm"] >= row["p"]
    found = measures.figure4_estimates(table)["E", "graph", "violations", ALL]
    assert found.high - found.low < 0.6


def test_worlds_of_the_ablation_differ_in_one_switch_each():
    options = AblationConfig(environment="lab", quick=True)
    described = {
        world: {behavior: table1.world_description(options, world, behavior).identity() for behavior in BEHAVIORS}
        for world in table1.WORLDS
    }
    default, whole = described["default"], described["sean2"]
    assert len(table1.WORLDS) == 2 + 2 * len(table1.SWITCHES)
    for world in table1.SWITCHES:  # the same values are changed from the default and changed back from sean2
        missing = described[f"sean2-without-{world}"]
        for behavior in BEHAVIORS:
            changed = [name for name, value in missing[behavior].items() if value != whole[behavior][name]]
            assert changed == [n for n, v in described[world][behavior].items() if v != default[behavior][n]]
            simulated = table1.simulated_world(options, f"sean2-without-{world}", behavior)
            assert simulated == (f"sean2-without-{world}" if changed else "sean2")
    assert default["graph"]["dynamics"] == "twin" and whole["graph"]["dynamics"] == "kinematic"
    for world in table1.SWITCHES:
        for behavior in BEHAVIORS:
            one, usual, all_of_them = described[world][behavior], default[behavior], whole[behavior]
            changed = [name for name in one if one[name] != usual[name]]
            within_people = world in ("routing", "group_membership")
            assert changed == (
                ["behavior"] if within_people and behavior == "graph" else [] if within_people else [world]
            )
            assert within_people or one[world] == all_of_them[world]
            assert table1.simulated_world(options, world, behavior) == (world if changed else "default")
    assert CollectConfig(preset="sean2", behavior="graph", environment="lab", dynamics="mjx").identity() == {
        **whole["graph"], "dynamics": "mjx"
    }  # fmt: skip
    assert table1.world_description(options.replace(dynamics="mjx"), "sean2", "graph").dynamics == "mjx"


def test_further_drivers_of_figure_4():
    asked = Figure4Config()
    assert figure4.baselines(asked) == ["move_base", "ppo", "ppo_lidar", "sensing_expert"]
    assert figure4.baselines(asked.replace(quick=True)) == [] == figure4.baselines(asked.replace(baselines="none"))
    assert figure4.baselines(asked.replace(baselines="orca,ppo")) == ["orca", "ppo"]
    with pytest.raises(InputError, match="baselines: 'orca' is listed twice"):
        asked.replace(baselines="orca,ppo,orca")
    with pytest.raises(InputError, match="--baselines: 'N' is a column of the figure already"):
        figure4.baselines(asked.replace(baselines="N"))


def test_the_preset_reaches_both_experiments():
    table = Table1Config(environment="lab", preset="sean2")
    assert table.speeds[0] == 0.4 and Table1Config(preset="sean2", speeds=[1.0]).speeds == (1.0,)
    figure = table1.description(Figure4Config(environment="lab", preset="sean2"), "graph", None)
    for asked in (table1.description(table, "graph", None), figure):
        assert (asked.behavior.routing, asked.dynamics, asked.warm_up) == ("edge", "kinematic", 120.0)
    with pytest.raises(InputError, match="speeds"):
        Table1Config(speeds=())
    with pytest.raises(InputError, match="'preset' is not a known key"):
        validate(AblationConfig, {"preset": "sean2"})


@pytest.mark.night
def test_ablation(tmp_path, monkeypatch):
    monkeypatch.setattr(table1, "WORLDS", {name: table1.WORLDS[name] for name in ("default", "goal_sampling", "sean2")})
    out = tmp_path / "ablation"
    given = f"{SMALL} --hours 0.0167 --seeds 1 --policies go_to_goal --out {out}".split()
    assert command_line.main(["experiment", "ablation", *given]) == 0
    rows = [line.split(",") for line in (out / "ablation.csv").read_text(encoding="utf-8").splitlines()[1:]]
    assert {row[0] for row in rows} == {"default", "goal_sampling", "sean2"} and {row[2] for row in rows} == set(
        BEHAVIORS
    )
    flags = {}
    for world, _, behavior, counting, _, share, low, high in rows:
        assert float(low) - 1e-6 <= float(share) <= float(high) + 1e-6
        if counting == "flags":
            flags[world, behavior] = flags.get((world, behavior), 0.0) + float(share)
    assert all(total == pytest.approx(1.0, abs=1e-4) for total in flags.values())
    entropies = [line.split(",") for line in (out / "entropies.csv").read_text(encoding="utf-8").splitlines()[1:]]
    assert {(world, behavior) for world, _, behavior, *_ in entropies} == set(flags)
    for *_, mean, low, high in entropies:  # resamples of a minute have fewer different chains, so less entropy
        assert 0.0 <= float(low) <= float(mean) <= float(high) + 0.01 and float(high) <= 1.0
    text = (out / "report.html").read_text(encoding="utf-8")
    assert all(world in text for world in ("goal_sampling", "sean2")) and (out / "ablation.png").is_file()
    before = (out / "ablation.csv").read_bytes()
    (out / "sean2-graph-go_to_goal.npz").unlink()
    assert command_line.main(["experiment", "ablation", *given]) == 0
    assert (out / "ablation.csv").read_bytes() == before
