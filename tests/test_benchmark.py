"""``sean benchmark``: its protocol is frozen, its figures are means, and a result that was changed is refused."""

import copy
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from sean_jax import cli, prng
from sean_jax.config import BenchmarkConfig, CollectConfig
from sean_jax.errors import IncompleteError, InputError
from sean_jax.studies.experiments import benchmark, measures


def test_the_protocol_is_frozen():
    """Where this fails, episodes are others than those of published results: raise ``benchmark.VERSION``."""
    assert (benchmark.VERSION, benchmark.protocol_digest(), benchmark.EPISODES, benchmark.SEED) == (
        2,
        benchmark.CONTENT,
        8_400,
        20_260,
    )
    assert len(benchmark.TRACKS) == 12 and len(benchmark.TRACKS) * benchmark.EPISODES >= 100_000
    for track in benchmark.TRACKS:
        asked = benchmark.description(track)
        left = set(CollectConfig.model_fields) - set(benchmark.TRACKS[track])
        decisive = {name for name in left if name in asked.identity()}
        # What is left to defaults decides nothing of an episode, or is what the benchmark sets by itself.
        assert decisive <= {"policy", "labels", "width", "height", "seed", "sensors", "thresholds", "substeps", "batch"}
        assert asked.replace(**benchmark.TRACKS[track]) == asked


def columns(random: np.random.Generator, number: int) -> measures.Arrays:
    time = random.uniform(1.0, 9.0, (number, 6))
    time[:, 0] = random.uniform(20, 30, number)
    counts = {name: random.poisson(0.2, (number, 6)).astype(np.float32) for name in benchmark.COUNTED}
    for count in counts.values():
        count[:, 0] = count.sum(1)
    rest = {"time_not_moving": time / 2, "path_efficiency": time[:, 1], "seconds": time[:, 0]}
    return {"completed": random.uniform(size=number) < 0.8, "time_in_situation": time, **counts, **rest}


def test_figures_are_means_over_all_tracks():
    random = np.random.default_rng(0)
    measured = {"a": columns(random, 300), "b": columns(random, 300)}
    found = benchmark.scores(measured)
    both = {name: np.concatenate([measured["a"][name], measured["b"][name]]) for name in measured["a"]}
    good = [both["completed"][i] and not any(both[name][i, 0] for name in measures.ROBOTS_FAULT) for i in range(600)]
    assert found.figures["polite"].mean == pytest.approx(100 * np.mean(good))
    assert found.figures["seconds"].mean == pytest.approx(both["seconds"].mean())
    whole = both["seconds"].sum()
    np.testing.assert_allclose(found.shares.mean, both["time_in_situation"][:, 1:].sum(0) / whole)
    events, minutes = both["intimate_robot_on_person"][:, 1:].sum(0), both["time_in_situation"][:, 1:].sum(0) / 60
    np.testing.assert_allclose(found.violations.mean, events / minutes)
    for each in (*found.figures.values(), found.shares, found.violations):
        assert (each.low <= each.mean + 1e-9).all() and (each.mean <= each.high + 1e-9).all()
    error = 1.96 * both["seconds"].std() / 600**0.5
    assert found.figures["seconds"].high - found.figures["seconds"].low == pytest.approx(2 * error, rel=0.15)


def test_a_package_of_another_protocol_runs_nothing(monkeypatch, tmp_path):
    monkeypatch.setattr(benchmark, "CONTENT", "0" * 16)
    with pytest.raises(InputError, match="have the digest .* and protocol 2 has 0000"):
        benchmark.run(BenchmarkConfig(policy="go_to_goal", out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_episodes_have_a_stream_of_their_own():
    assert "benchmark" in prng.USES


def place(folder: Path, policy: str, episodes: int, seed: int) -> Path:
    """A complete result with episodes by chance."""
    folder.mkdir()
    random = np.random.default_rng(seed)
    measured = {track: columns(random, episodes) for track in benchmark.TRACKS}
    for track, values in measured.items():
        np.savez_compressed(folder / f"{track}.npz", **values)
    benchmark.write(BenchmarkConfig(policy=policy, episodes=episodes, out=folder), measured)
    return folder


def smaller(patch: pytest.MonkeyPatch) -> None:
    """A protocol of two tracks of 20 episodes."""
    patch.setattr(benchmark, "EPISODES", 20)
    patch.setattr(benchmark, "TRACKS", {name: benchmark.TRACKS[name] for name in ("lab-join_group", "lab-handcrafted")})


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


def test_results_are_ranked(ranked):
    best, other = benchmark.ranking(ranked)
    assert best["scores"]["figures"]["polite"]["mean"] >= other["scores"]["figures"]["polite"]["mean"]
    assert {best["policy"], other["policy"]} == {"go_to_goal", "orca"}
    assert [line.split(" ")[0] for line in map(benchmark.table, (best, other))] == [best["policy"], other["policy"]]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda content: content["files"].pop(list(benchmark.TRACKS)[1]), "files lack, or should not have, "),
        (lambda content: content["tracks"].pop(list(benchmark.TRACKS)[1]), "tracks lack, or should not have, "),
        (lambda content: content["files"].update({"../ranked": "0"}), r"should not have, \.\./ranked"),
        (lambda content: content["files"].update(moon=next(iter(content["files"].values()))), "should not have, moon"),
        (of("files", {}), "files lack"),
        (of("episodes", 8_400), r"is damaged .*\(20,\), not bool \(8400,\)"),
        (of("episodes", 19), r"is damaged .*\(20,\), not bool \(19,\)"),
        (of("episodes", 8_401), "episodes: 8401 must be from 1 to 8,400"),
        (of("episodes", "20"), "episodes: '20' is not a whole number"),
        (of("complete", False), "does not follow from its episodes"),
        (of("policy", "orca"), "orca of this package has another digest"),
        (of("policy", "ppo"), "ppo of this package has another digest"),
        (of("policy", ["ppo"]), "policy: .* is not text"),
        (of("scores", 3), "scores: 3 is not a mapping"),
        (of("protocol", 3), r"is of protocol 3 \(.*\), not 2"),
        (of("author", "somebody"), "'author' is not a known key"),
        (without("episodes"), "episodes: is missing"),
        (without("versions"), "versions: is missing"),
        (without("scores"), "scores: is missing"),
        (lambda content: content["scores"]["figures"]["polite"].update(mean=100.0), "does not follow"),
        (lambda content: content["tracks"].update({name: {} for name in content["tracks"]}), "does not follow"),
        (lambda content: content["scores"]["figures"].pop("polite"), "does not follow"),
    ],
)
def test_a_result_that_is_not_whole_is_refused_with_its_right_checksum(ranked, change, text, tmp_path):
    with pytest.raises((InputError, IncompleteError), match=text):
        benchmark.ranking([changed(ranked[0], tmp_path / "changed", change), ranked[1]])


@pytest.mark.parametrize(
    "text", ["[]", "3", '"x"', "null", "{", "{}", '{"checksum": 1e999}', '{"episodes": NaN}', "[" * 9_999]
)
def test_what_is_no_result_is_refused(text, tmp_path):
    (tmp_path / "result.json").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="result.json"):
        benchmark.check(tmp_path)


def test_two_results_of_one_driver_or_of_one_name_are_refused(ranked, tmp_path):
    again = changed(ranked[0], tmp_path / "again", lambda content: None)
    with pytest.raises(InputError, match="have the same driver"):
        benchmark.ranking([ranked[0], ranked[1], again])
    mine = [
        changed(
            folder,
            tmp_path / digest,
            lambda content, digest=digest: content.update(policy="runs/a", policy_digest=digest),
        )
        for folder, digest in zip(ranked, ("0" * 16, "1" * 16), strict=True)
    ]
    assert len(benchmark.ranking(mine[:1])) == 1
    with pytest.raises(InputError, match="have the same name, runs/a"):
        benchmark.ranking(mine)


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

    every = [path for path in places(whole) if path[0] not in ("checksum", "versions")]
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


@pytest.mark.slow
def test_a_benchmark(tmp_path, monkeypatch, capsys):
    """Written, continued, checked, ranked; and refused where somebody changed it."""
    monkeypatch.setattr(
        benchmark, "TRACKS", {name: benchmark.TRACKS[name] for name in ("lab-join_group", "lab-handcrafted")}
    )
    out = tmp_path / "result"
    words = ["benchmark", "go_to_goal", "--episodes", "6", "--out", str(out)]
    assert cli.main(words) == 0
    assert "not ranked: the protocol has 8400 episodes a track" in capsys.readouterr().out
    content = benchmark.check(out)
    assert content["policy"] == "go_to_goal" and not content["complete"]
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "lab-handcrafted" in page and "src=" not in page
    before = (out / "lab-join_group.npz").read_bytes()
    (out / "lab-join_group.npz").unlink()
    assert cli.main(words) == 0
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
    shutil.copy(out / "lab-handcrafted.npz", changed / "lab-join_group.npz")
    with pytest.raises(InputError, match="is not the file of the result"):
        benchmark.check(changed)
