"""``sean benchmark``: its protocol is frozen, a result that was changed is refused, ranks have ties, samples verify."""

import copy
import json
import shutil
import typing
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import sean_jax
from sean_jax.cli import command_line
from sean_jax.config import BenchmarkConfig, BenchmarkRankConfig, BenchmarkVerifyConfig, ScenarioConfig
from sean_jax.core import random_streams
from sean_jax.core.data_types import SENSING, Policy, as_policy
from sean_jax.core.errors import IncompleteError, InputError
from sean_jax.learning.policy import AGENTS, load_policy
from sean_jax.mdp import observations
from sean_jax.metrics.differences import holm
from sean_jax.policies import POLICIES
from sean_jax.simulation import episode_runner, making
from sean_jax.studies.experiments import benchmark, ranking, ranks, scores, shares, verification
from sean_jax.world import environment, generated
from support.benchmark_results import columns, entry, place, smaller


def test_the_protocol_is_frozen(tmp_path):
    """Where this fails, episodes are others than those of published results: raise ``benchmark.VERSION``."""
    assert (benchmark.VERSION, benchmark.protocol_digest(), benchmark.EPISODES, benchmark.SEED) == (
        4,
        benchmark.CONTENT,
        5_040,
        20_260,
    )
    assert len(benchmark.TRACKS) == 20 and len(benchmark.TRACKS) * benchmark.EPISODES >= 100_000
    groups = ["floor", "density", "narrow", "attention", "law", "world", "recorded"]
    assert list(benchmark.members()) == groups and sum(map(len, benchmark.members().values())) == 20
    for name in benchmark.recorded().values():
        (tmp_path / name).write_text("frame,id,x,y\n1,1,0,0\n7,1,0.5,0\n")
    for name, track in benchmark.TRACKS.items():
        asked = benchmark.description(name, tmp_path)
        left = {each for each in set(ScenarioConfig.model_fields) - set(track.options) if each in asked.identity()}
        # What is left to defaults decides nothing of an episode, or is what the benchmark sets by itself.
        assert left <= {"metrics", "sensors", "thresholds", "substeps"}
        behavior = set(track.options["behavior"]) | ({"recording"} if track.recording else set())
        assert behavior == set(type(asked.behavior).model_fields), name
        if place := generated.parse_set(track.options["environment"]):
            assert place.seed >= benchmark.FIRST_SEED
        changed = {"reactions": 0.6, "walking": 1.8}
        for key, value in track.parameters.items():
            assert changed[key.partition(".")[0]] == value
            built = making.plan_scenario(asked).forces
            found = getattr(getattr(built, key.partition(".")[0]), key.partition(".")[2])
            assert float(found) == pytest.approx(value)


def test_tracks_of_recorded_people_need_their_recording(tmp_path):
    with pytest.raises(InputError, match="recordings: None has no eth.csv; give a folder with eth.csv, zara01.csv"):
        benchmark.description("eth")
    options = BenchmarkConfig(policy="go_to_goal", recordings=tmp_path, out=tmp_path / "out")
    with pytest.raises(InputError, match="has no eth.csv"):
        benchmark.run(options)
    assert not (tmp_path / "out").exists()
    assert benchmark.skipped(benchmark.TRACKS) == ""
    text = benchmark.skipped([name for name in benchmark.TRACKS if name not in ("eth", "zara01")])
    assert text == "Without eth, zara01, which need the recordings eth.csv, zara01.csv (--recordings)."


def test_figures_are_means_over_all_tracks():
    random = np.random.default_rng(0)
    measured = {"a": columns(random, 300), "b": columns(random, 300)}
    found = scores.scores(scores.track_table(measured))
    both = {name: np.concatenate([measured["a"][name], measured["b"][name]]) for name in measured["a"]}
    good = [both["completed"][i] and not any(both[name][i, 0] for name in scores.ROBOTS_FAULT) for i in range(600)]
    assert found["polite", ""].mean == pytest.approx(100 * np.mean(good))
    assert found["seconds", ""].mean == pytest.approx(both["seconds"].mean())
    whole = both["seconds"].sum()
    np.testing.assert_allclose(
        [found[scores.SHARE_OF_TIME, name].mean for name in shares.NAMES],
        both["time_in_situation"][:, 1:].sum(0) / whole,
    )
    events, minutes = both["intimate_robot_on_person"][:, 1:].sum(0), both["time_in_situation"][:, 1:].sum(0) / 60
    np.testing.assert_allclose([found[scores.PER_MINUTE, name].mean for name in shares.NAMES], events / minutes)
    for each in found.values():
        assert (each.low <= each.mean + 1e-9).all() and (each.mean <= each.high + 1e-9).all()
    error = 1.96 * both["seconds"].std() / 600**0.5
    assert found["seconds", ""].high - found["seconds", ""].low == pytest.approx(2 * error, rel=0.15)


def test_a_package_of_another_protocol_runs_nothing(monkeypatch, tmp_path):
    monkeypatch.setattr(benchmark, "CONTENT", "0" * 16)
    with pytest.raises(InputError, match="have the digest .* and protocol 4 has 0000"):
        benchmark.run(BenchmarkConfig(policy="go_to_goal", out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_episodes_have_a_stream_of_their_own():
    assert "benchmark" in random_streams.USES


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Two complete results of a smaller protocol."""
    with pytest.MonkeyPatch.context() as patch:
        smaller(patch)
        folder = tmp_path_factory.mktemp("ranked")
        return [place(folder / policy, policy, 20, seed) for seed, policy in enumerate(("go_to_goal", "orca"))]


@pytest.fixture
def ranked(results, monkeypatch):
    """The same, where that is the protocol."""
    smaller(monkeypatch)
    return results


def changed(folder: Path, to: Path, change) -> Path:
    """A copy whose result.json says something else, with a checksum of that."""
    shutil.copytree(folder, to)
    content = json.loads((to / "result.json").read_text(encoding="utf-8"))
    change(content)
    content["checksum"] = benchmark.checksum(content)
    (to / "result.json").write_text(json.dumps(content), encoding="utf-8")
    return to


def without(name: str):
    return lambda content: content.pop(name)


def of(name: str, value: object):
    return lambda content: content.update({name: value})


def test_results_are_ranked(ranked, tmp_path, capsys):
    out = tmp_path / "ranking"
    assert command_line.main(["benchmark", "rank", *map(str, ranked), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    found = ranking.rank(ranked)
    assert {row.entry.name for row in found.rows} == {"go_to_goal", "orca"} and len(found.pairs) == 1
    assert list(found.by_class()) == ["all-knowing"] and "all-knowing · politely completed %" in said
    for row in found.rows:
        result = benchmark.check(ranked[row.entry.name == "orca"])
        assert float(row.of["all"].mean) == pytest.approx(result.scores.figures["polite"].mean, abs=1e-4)
        np.testing.assert_allclose(row.violations.mean, result.scores.violations_per_minute.mean, atol=1e-4)
        assert benchmark.table(result).startswith(f"{row.entry.name} · all-knowing · protocol 4 · 2 tracks x 20")
    rows = (out / "ranking.csv").read_text(encoding="utf-8").splitlines()
    assert rows[0] == "class,first_rank,last_rank,policy,results,tracks,polite_percent,low,high"
    assert len(rows) == 1 + 2 * 2 and {row.split(",")[5] for row in rows[1:]} == {"all", "floor"}
    assert (out / "differences.csv").read_text(encoding="utf-8").startswith("class,first,second,difference_percent,low")
    assert (out / "situations-all-knowing.png").read_bytes().startswith(b"\x89PNG")
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "all-knowing" in page and "<svg" in page and "src=" not in page
    assert BenchmarkRankConfig(results=tuple(ranked)).folder == Path("runs/ranking")


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda content: content["files"].pop(list(benchmark.TRACKS)[1]), "files lack, or should not have, "),
        (lambda content: content["tracks"].pop(list(benchmark.TRACKS)[1]), "tracks lack, or should not have, "),
        (lambda content: content["files"].update({"../ranked": "0"}), r"should not have, \.\./ranked"),
        (lambda content: content["files"].update(moon=next(iter(content["files"].values()))), "should not have, moon"),
        (of("files", {}), "files lack"),
        (of("episodes", 5_040), r"is damaged .*\(20,\), not bool \(5040,\)"),
        (of("episodes", 19), r"is damaged .*\(20,\), not bool \(19,\)"),
        (of("episodes", 5_041), "episodes: 5041 must be from 1 to 5,040"),
        (of("episodes", "20"), "episodes: '20' is not a whole number"),
        (of("complete", False), "does not follow from its episodes"),
        (of("policy", "orca"), "policy_digest .* is not that of orca of this package"),
        (of("policy", "ppo"), "policy_digest .* is not that of ppo of this package"),
        (of("policy", ["ppo"]), "policy: .* is not text"),
        (of("scores", 3), "scores: 3 is not a mapping"),
        (of("protocol", 3), r"is of protocol 3 \(.*\), not 4"),
        (of("sensing", "tracks"), "sensing tracks is not that of go_to_goal of this package, all-knowing"),
        (of("sensing", "eyes"), "sensing: 'eyes' is not one of"),
        (of("recordings", {"eth.csv": "0" * 64}), "recordings lack, or should not have, eth.csv"),
        (without("device"), "device: is missing"),
        (lambda content: content["groups"].pop("floor"), "groups lack, or should not have, floor"),
        (of("author", "somebody"), "'author' is not a known key"),
        (without("episodes"), "episodes: is missing"),
        (without("versions"), "versions: is missing"),
        (without("scores"), "scores: is missing"),
        (lambda content: content["scores"]["figures"]["polite"].update(mean=100.0), "does not follow"),
        (lambda content: content["scores"]["figures"]["polite"].update(mean="x"), "polite.mean: 'x' is not a number"),
        (lambda content: content["tracks"].update({name: {} for name in content["tracks"]}), "figures: is missing"),
        (lambda content: content["scores"]["figures"].pop("polite"), "does not follow"),
    ],
)
def test_a_result_that_is_not_whole_is_refused_with_its_right_checksum(ranked, change, text, tmp_path):
    with pytest.raises((InputError, IncompleteError), match=text):
        ranking.rank([changed(ranked[0], tmp_path / "changed", change), ranked[1]])


@pytest.mark.parametrize(
    "text", ["[]", "3", '"x"', "null", "{", "{}", '{"checksum": 1e999}', '{"episodes": NaN}', "[" * 9_999]
)
def test_what_is_no_result_is_refused(text, tmp_path):
    (tmp_path / "result.json").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="result.json"):
        benchmark.check(tmp_path)


def test_results_of_one_policy_are_refused_and_of_one_name_are_seeds(ranked, tmp_path):
    again = changed(ranked[0], tmp_path / "again", lambda content: None)
    with pytest.raises(InputError, match="have the same policy"):
        ranking.rank([ranked[0], ranked[1], again])

    def named(folder: Path, number: int, **others) -> Path:
        values = {"policy": f"runs/{number}", "policy_digest": f"{number}" * 16, "name": "mine", **others}
        return changed(folder, tmp_path / f"{number}{len(others)}", lambda content: content.update(values))

    mine = [named(folder, number) for number, folder in enumerate(ranked)]
    assert len(ranking.rank(mine[:1]).rows) == 1
    with pytest.raises(InputError, match="have the same name, mine, but are no trainings"):
        ranking.rank(mine)
    seeds = [named(folder, number, trained=True) for number, folder in enumerate(ranked)]
    (row,) = ranking.rank(seeds).rows
    assert (row.entry.name, row.seeds) == ("mine", "2 of 3")
    other = named(ranked[1], 2, trained=True, sensing="raw")
    with pytest.raises(InputError, match="have the same name, mine, but their sensing is all-knowing and raw"):
        ranking.rank([seeds[0], other])


def test_no_change_of_a_result_is_a_traceback_or_accepted(ranked, tmp_path):
    """Every value of result.json left out or replaced by another kind of value, with the checksum of that."""
    whole = json.loads((ranked[0] / "result.json").read_text(encoding="utf-8"))
    to = changed(ranked[0], tmp_path / "changed", lambda content: None)
    random = np.random.default_rng(0)

    def places(value, *path):
        if path:
            yield path
        inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        for key, each in inner:
            yield from places(each, *path, key)

    free = "checksum", "versions", "device", "name"  # texts that nothing of the episodes tells
    every = [path for path in places(whole) if path[0] not in free]
    for number in random.choice(len(every), 60, replace=False):
        *above, last = every[number]
        content = copy.deepcopy(whole)
        at = content
        for key in above:
            at = at[key]
        other = [None, "x", -1.0, 1e308, [], {}, ["a"], {"a": 1}, 10**30][random.integers(9)]
        if random.integers(4) == 0:
            del at[last]
        else:
            at[last] = other
        content["checksum"] = benchmark.checksum(content)
        (to / "result.json").write_text(json.dumps(content), encoding="utf-8")
        with pytest.raises((InputError, IncompleteError)) as caught:
            benchmark.check(to)
        assert str(to) in str(caught.value) and str(caught.value).count("\n") == 0, every[number]


@pytest.mark.parametrize(
    ("name", "change", "text"),
    [
        ("completed", lambda values: values.astype(float), "completed is float64"),
        ("seconds", lambda values: values * np.nan, "negative or not finite"),
        ("seconds", lambda values: values * 10, "at most 120"),
        ("seconds", lambda values: values * 0.5, "time_in_situation differs from seconds"),
        ("seconds", lambda values: values[:1], r"seconds is float64 \(1,\)"),
        ("time_in_situation", lambda values: values[:, :3], "time_in_situation is"),
        ("time_in_situation", lambda values: values * [1, 9, 9, 9, 9, 9], "time_in_situation is longer"),
        ("time_not_moving", lambda values: values * 3, "time_not_moving is longer"),
        ("intimate_robot_on_person", lambda values: -values - 1, "negative"),
        ("intimate_robot_on_person", lambda values: values + 0.5, "whole numbers"),
        ("collision_with_obstacle", lambda values: values * [0, 1, 1, 1, 1, 1], "no situation has more"),
    ],
)
def test_episodes_that_cannot_be_are_refused(name, change, text):
    random = np.random.default_rng(3)
    good = columns(random, 50)
    benchmark.check_columns(good, 50, 120.1)
    with pytest.raises(ValueError, match=text):
        benchmark.check_columns(good | {name: np.asarray(change(good[name]))}, 50, 120.1)
    with pytest.raises(ValueError, match=f"not the columns of a track: {name}"):
        benchmark.check_columns({each: values for each, values in good.items() if each != name}, 50, 120.1)
    with pytest.raises(ValueError, match="not the columns of a track: more"):
        benchmark.check_columns(good | {"more": good["seconds"]}, 50, 120.1)


def test_an_agent_that_knows_the_floors_is_refused(tmp_path):
    """By the options of its training alone."""
    content = json.loads((AGENTS["ppo_lidar"] / "config.json").read_text(encoding="utf-8"))
    for name, known in (("worlds:rooms:8", False), ("warehouse,worlds:all:100:1999999901", True)):
        (tmp_path / "config.json").write_text(json.dumps(content | {"environment": name}), encoding="utf-8")
        if not known:
            benchmark.check_training("runs/a", tmp_path)
            continue
        with pytest.raises(InputError, match="runs/a was trained on worlds:all:100:1999999901, and seeds from 2,000"):
            benchmark.check_training("runs/a", tmp_path)
    benchmark.check_training("learned", tmp_path / "none")  # a network that imitates


# ------------------------------------------------------------------ classes of sensing


def test_policies_say_what_they_sense():
    scenario = sean_jax.make("lab", people=3)
    found = {name: load_policy(name, scenario).sensing for name in (*POLICIES, *AGENTS)}
    tracks = dict.fromkeys(("sensing_expert", "dwa", "social_force", "mppi"), "tracks")
    classes = {"move_base": "raw", "ppo_lidar": "raw", **tracks}
    assert found == {name: classes.get(name, "all-knowing") for name in found}


@pytest.mark.parametrize(
    ("names", "sensing"),
    [
        (["goal", "path", "obstacles", "lidar", "depth"], "raw"),
        (["goal", "visible_people", "lidar"], "tracks"),
        (["goal", "visible_people", "people"], "all-knowing"),
        (["goal", "situations"], "all-knowing"),
    ],
)
def test_the_class_of_an_agent_is_that_of_its_observations(names, sensing):
    assert observations.sensing(observations.as_terms(names)) == sensing
    mine = {**dict.fromkeys(names), "mine": lambda scenario, state: state.robot.position}
    assert observations.sensing(observations.as_terms({name: value or name for name, value in mine.items()})) == (
        "all-knowing"
    )


OWN = """
import jax.numpy as jnp

def drive(scenario, state, key):
    return jnp.zeros(2)

def sees(scenario, state, key):
    return jnp.zeros(2)

sees.sensing = "tracks"

def wrong(scenario, state, key):
    return jnp.zeros(2)

wrong.sensing = "eyes"
"""


def test_the_class_of_a_policy_of_ones_own_is_its_attribute_or_an_option(tmp_path):
    file = tmp_path / "my.py"
    file.write_text(OWN)

    def describe(policy, sensing=None):
        return benchmark.describe(benchmark.read_policy(policy, typed=True), sensing)

    found = [describe(f"{file}:{name}").sensing for name in ("drive", "sees")]
    assert found == ["all-knowing", "tracks"]
    assert describe(f"{file}:drive", "raw").sensing == "raw"
    assert describe("ros1:", "raw")[1:] == ("raw", False)
    with pytest.raises(InputError, match=r"sensing of wrong, 'eyes', is not one of all-knowing, tracks, raw"):
        describe(f"{file}:wrong")
    with pytest.raises(InputError, match="sensing: ppo says itself what it senses; leave raw out"):
        describe("ppo", "raw")
    option = typing.get_args(typing.get_args(BenchmarkConfig.model_fields["sensing"].annotation)[0])
    assert set(option) == set(SENSING) and Policy((), "a", drive, drive).sensing == "all-knowing"


def drive(scenario, state, key):
    """Stands."""


# ------------------------------------------------------------------ ranks


def test_equal_policies_share_a_rank_and_others_do_not():
    random = np.random.default_rng(0)
    lots = random.uniform(size=(1, 3, 400))
    shares = {"a": 0.8, "b": 0.8, "c": 0.5, "d": 0.2}
    noise = {"b": random.uniform(size=lots.shape) < 0.1}  # b differs from a in some episodes
    polite = {name: (lots < share) ^ (noise.get(name, False) & (random.uniform(size=lots.shape) < 0.05))
              for name, share in shares.items()}  # fmt: skip
    groups = {"one": ["0"], "others": ["1", "2"]}
    found = ranks.rank([entry(name, each) for name, each in polite.items()], groups, [])
    assert {row.entry.name: row.rank for row in found.rows} == {"a": "1-2", "b": "1-2", "c": "3", "d": "4"}
    for row in found.rows:
        values = 100.0 * polite[row.entry.name][0]
        assert float(row.of["all"].mean) == pytest.approx(values.mean())
        assert float(row.of["others"].mean) == pytest.approx(values[1:].mean())
        error = 1.96 * np.sqrt(values.var(1).mean() / values.size)
        assert float(row.of["all"].high - row.of["all"].low) == pytest.approx(2 * error, rel=0.15)
    for pair in found.pairs:
        gaps = 100.0 * (polite[pair.second][0].astype(float) - polite[pair.first][0])
        error = 1.96 * np.sqrt(gaps.var(1).mean() / gaps.size)  # within tracks, as episodes are drawn
        assert pair.difference[0] == pytest.approx(gaps.mean())
        assert pair.difference[2] - pair.difference[1] == pytest.approx(2 * error, rel=0.15)


def test_holm_corrects_all_pairs_and_classes_are_apart():
    random = np.random.default_rng(1)
    entries = [entry(f"{k}", random.uniform(size=(1, 2, 100)) < 0.5 + 0.05 * k, "raw") for k in range(4)]
    entries += [entry("knows", np.ones((1, 2, 100), bool), "all-knowing")]
    found = ranks.rank(entries, {"one": ["0", "1"]}, [])
    assert len(found.pairs) == 6 and list(found.by_class()) == ["all-knowing", "raw"]
    assert next(row.first for row in found.rows if row.entry.name == "0") >= 1
    each = []
    for pair in found.pairs:
        one, other = (np.stack([columns["completed"] for columns in next(
            entry for entry in entries if entry.name == name).measured[0].values()]) for name in pair[1:3])  # fmt: skip
        gaps = other.astype(float) - one
        z = abs(gaps.mean()) / np.sqrt(gaps.var(1).mean() / gaps.size)
        each.append(2 * stats.norm.sf(z))
    np.testing.assert_allclose([pair.p for pair in found.pairs], holm(each), rtol=0.35, atol=0.01)


def test_policies_that_are_equal_are_seldom_separated():
    """The probability of any false separation is about 5 %: at most 12 of 100 with a probability of 99.9 %."""
    random, false = np.random.default_rng(2), 0
    for _ in range(100):
        entries = [entry(f"{k}", random.uniform(size=(1, 2, 60)) < 0.7) for k in range(4)]
        false += any(row.first > 1 for row in ranks.rank(entries, {"one": ["0", "1"]}, []).rows)
    assert false <= 12


def test_intervals_over_seeds_are_students():
    random = np.random.default_rng(3)
    shares = [0.5, 0.6, 0.8]
    seeds = np.concatenate([random.uniform(size=(1, 2, 500)) < share for share in shares])
    same = np.repeat(random.uniform(size=(1, 2, 500)) < 0.5, 3, 0)  # seeds that differ in nothing
    agent, fixed = entry("agent", seeds, trained=True), entry("fixed", same[:1])
    found = ranks.rank([agent, fixed], {"one": ["0", "1"]}, [])
    row = next(row for row in found.rows if row.entry.name == "agent")
    means = 100.0 * seeds.mean((1, 2))
    low, high = stats.t.interval(0.95, 2, means.mean(), stats.sem(means))
    np.testing.assert_allclose([float(row.of["all"].low), float(row.of["all"].high)], [low, min(high, 100.0)])
    assert high > 100.0 and row.seeds == "3"
    assert found.rows[0].rank == found.rows[1].rank == "1-2"  # three seeds that vary tell little
    (pair,) = found.pairs
    assert pair.difference[1] < 0 < pair.difference[2] and pair.difference[0] == pytest.approx(
        100.0 * same.mean() - means.mean()
    )
    few = ranks.rank([entry("agent", seeds[:1], trained=True), fixed], {"one": ["0", "1"]}, ["a note"])
    assert few.notes == ["Fewer than 3 training seeds: agent.", "a note"]


# ------------------------------------------------------------------ verification


def sample(now: scores.Arrays, had: scores.Arrays) -> verification.Sample:
    return verification.Sample("lab", range(10, 10 + len(had["seconds"])), had, now)


def test_a_sample_is_compared_within_a_tolerance_and_by_intervals():
    had = columns(np.random.default_rng(0), 60)
    rounded = had | {"seconds": had["seconds"] * (1 + 1e-6)}
    assert sample(rounded, had).equal() == 60 and not verification.unequal([sample(rounded, had)])
    fewer = had | {"completed": had["completed"].copy()}
    fewer["completed"][:3] ^= True
    assert sample(fewer, had).equal() == 57
    assert verification.unequal([sample(fewer, had)]) == ["completed of 3 of 60 episodes of lab"]
    assert verification.significant([sample(fewer, had)]) == []  # by chance, as episodes that diverge
    other = columns(np.random.default_rng(1), 60)  # other episodes of the same policy
    assert sample(other, had).equal() < 60 and verification.significant([sample(other, had)]) == []
    worse = other | {"completed": np.zeros(60, bool)}
    (text,) = verification.significant([sample(worse, had)])
    assert text.startswith("completed of lab by -0.")


def test_only_a_result_of_the_policy_is_verified(ranked, tmp_path):
    with pytest.raises(InputError, match="expert has the digest .* give the place of that policy"):
        verification.verify(BenchmarkVerifyConfig(result=ranked[0], policy="expert"))
    values = {"policy": "my.py:f", "policy_digest": "0" * 16}
    mine = changed(ranked[0], tmp_path / "mine", lambda content: content.update(values))
    with pytest.raises(InputError, match="my.py:f is code, and .*result.json names it, not you"):
        verification.verify(BenchmarkVerifyConfig(result=mine))
    outside = changed(ranked[0], tmp_path / "outside", lambda content: content.update(values | {"policy": "ros1:"}))
    with pytest.raises(InputError, match="ros1: is a controller outside"):
        verification.verify(BenchmarkVerifyConfig(result=outside))
    (mine / "lab-join_group.npz").unlink()
    with pytest.raises(InputError, match="lab-join_group.npz"):
        verification.verify(BenchmarkVerifyConfig(result=mine))


def test_the_schema_names_each_key():
    schema = benchmark.Result.model_json_schema()
    assert set(schema["required"]) == set(benchmark.Result.model_fields) == set(schema["properties"])
    assert schema["additionalProperties"] is False and "TrackFigure" in schema["$defs"]
    assert all(each.get("description") for name, each in schema["properties"].items())


@pytest.mark.night
def test_a_benchmark(tmp_path, monkeypatch, capsys):
    """Written, continued, checked, ranked; and refused where somebody changed it."""
    monkeypatch.setattr(benchmark, "TRACKS", {name: shorter(name) for name in ("lab-join_group", "doors", "eth")})
    monkeypatch.setattr(episode_runner, "MAX_BATCH_CPU", 4)  # several batches, and floors within them
    out = tmp_path / "result"
    words = ["benchmark", "run", "go_to_goal", "--episodes", "6", "--out", str(out)]
    assert command_line.main(words) == 0
    said = capsys.readouterr().out
    assert "not ranked: the protocol has 5040 episodes a track" in said and "Without eth, which need" in said
    content = benchmark.check(out)
    assert content.policy == "go_to_goal" and not content.complete and content.recordings == {}
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "lab-join_group" in page and "Without eth" in page and "src=" not in page
    before = (out / "lab-join_group.npz").read_bytes()
    (out / "lab-join_group.npz").unlink()
    assert command_line.main(words) == 0
    assert (out / "lab-join_group.npz").read_bytes() == before and benchmark.check(out) == content
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    result["scores"]["figures"]["polite"]["mean"] -= 1.0
    changed = tmp_path / "changed"
    shutil.copytree(out, changed)
    (changed / "result.json").write_text(json.dumps(result), encoding="utf-8")
    with pytest.raises(InputError, match="was changed after it was written"):
        benchmark.check(changed)
    result["checksum"] = benchmark.checksum(result)
    (changed / "result.json").write_text(json.dumps(result), encoding="utf-8")
    with pytest.raises(InputError, match="does not follow from its episodes"):
        benchmark.check(changed)
    shutil.copy(out / "doors.npz", changed / "lab-join_group.npz")
    with pytest.raises(InputError, match="is not the file of the result"):
        benchmark.check(changed)

    verify = ["benchmark", "verify", str(out), "--tracks", "2", "--seed", "3"]
    assert command_line.main(verify) == 0
    said = capsys.readouterr().out
    assert said.count("3 of 3 are equal") == 2 and "verified: equal in each measure" in said
    forged = benchmark.read_track(out, "doors", 6)
    forged["completed"] = ~forged["completed"]
    measured = {"lab-join_group": benchmark.read_track(out, "lab-join_group", 6), "doors": forged}
    options = BenchmarkConfig(policy="go_to_goal", episodes=6, out=out)
    np.savez_compressed(out / "doors.npz", **forged)
    benchmark.write(options, measured, benchmark.describe_of_package("go_to_goal"))
    assert command_line.main(verify) == 1
    assert "the sample differs from the result: completed of 3 of 3 episodes of doors" in capsys.readouterr().err


def shorter(name: str) -> benchmark.Track:
    """A track with a time limit of 15 s."""
    track = benchmark.TRACKS[name]
    return track._replace(options=track.options | {"time_limit": 15.0})


@pytest.mark.night
def test_a_controller_outside_is_connected_to_each_floor(tmp_path, monkeypatch):
    """It gets the episodes of the same policy inside, on the right floors."""
    monkeypatch.setattr(benchmark, "TRACKS", {name: shorter(name) for name in ("lab-random_ab_nav", "doors")})
    floors = []

    class Outside:
        policy = as_policy(POLICIES["go_to_goal"])

        def __init__(self, scenario):
            floors.append(np.asarray(scenario.environment.floor).tolist())

        def __call__(self, scenario, number, states):
            return self.policy

        def close(self):
            floors.append("closed")

    for name, connect in (("inside", None), ("outside", Outside)):
        options = BenchmarkConfig(policy="go_to_goal", episodes=3, out=tmp_path / name)
        benchmark.run(options, connect=connect)
    folders = [environment.find("lab"), *generated.find("worlds:passages:3:2000000000")]
    places = [np.asarray(environment.load(folder).floor).tolist() for folder in folders]
    assert sorted(floors[0::2]) == sorted(places) and floors[1::2] == ["closed"] * 4
    for track in benchmark.TRACKS:
        ours, theirs = (benchmark.read_track(tmp_path / name, track, 3) for name in ("inside", "outside"))
        for name in ours:  # a batch of one may round differently
            np.testing.assert_allclose(ours[name], theirs[name], rtol=1e-3, atol=1e-3, err_msg=f"{track} {name}")


@pytest.mark.night
def test_recorded_people_walk_on_a_track(tmp_path, monkeypatch):
    """As two people do who cross the floor; the result names the recording."""
    monkeypatch.setattr(benchmark, "TRACKS", {name: shorter(name) for name in ("lab-random_ab_nav", "zara01")})
    rows = [f"{10 * k + 1},{i},{-4 + 2 * i},{6 + 0.5 * k:.1f}" for k in range(25) for i in range(2)]
    (tmp_path / "zara01.csv").write_text("\n".join(["frame,id,x,y", *rows]) + "\n")
    options = BenchmarkConfig(policy="go_to_goal", episodes=2, recordings=tmp_path, out=tmp_path / "out")
    result = benchmark.check(benchmark.run(options))
    assert result.recordings.keys() == {"zara01.csv"} and list(result.groups) == ["floor", "recorded"]
    assert result.tracks["zara01"].share_of_time.mean[4] > 0  # empty
    (tmp_path / "zara01.csv").write_text("\n".join(["frame,id,x,y", *rows[2:]]) + "\n")
    with pytest.raises(InputError, match="zara01.csv is not the recording of the result"):
        verification.verify(BenchmarkVerifyConfig(result=tmp_path / "out", recordings=tmp_path))
