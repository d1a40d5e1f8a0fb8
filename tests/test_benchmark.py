"""``sean benchmark``: its protocol is frozen, its figures are means, and a result that was changed is refused."""

import json
import shutil

import numpy as np
import pytest

from sean_jax import cli, prng
from sean_jax.config import BenchmarkConfig, CollectConfig
from sean_jax.errors import InputError
from sean_jax.experiments import benchmark, tracks


def test_the_protocol_is_frozen():
    """Where this fails, episodes are others than those of published results: raise ``tracks.VERSION``."""
    assert (tracks.VERSION, tracks.content(), tracks.EPISODES, tracks.SEED) == (1, tracks.CONTENT, 8_400, 20_260)
    assert len(tracks.TRACKS) == 12 and len(tracks.TRACKS) * tracks.EPISODES >= 100_000
    for track in tracks.TRACKS:
        asked = tracks.description(track)
        left = set(CollectConfig.model_fields) - set(tracks.TRACKS[track])
        decisive = {name for name in left if name in asked.decisive()}
        # What is left to defaults decides nothing of an episode, or is what the benchmark sets by itself.
        assert decisive <= {"policy", "labels", "width", "height", "seed", "sensors", "thresholds", "substeps", "batch"}
        assert asked.replace(**tracks.TRACKS[track]) == asked


def columns(random: np.random.Generator, number: int) -> benchmark.Columns:
    time = random.uniform(1.0, 9.0, (number, 6))
    time[:, 0] = 40.0
    counts = {name: random.poisson(0.2, (number, 6)).astype(np.float32) for name in benchmark.COUNTED}
    rest = {"time_not_moving": time[:, :1], "path_efficiency": time[:, :1], "seconds": random.uniform(20, 30, number)}
    return {"completed": random.uniform(size=number) < 0.8, "time_in_situation": time, **counts, **rest}


def test_figures_are_means_over_all_tracks():
    random = np.random.default_rng(0)
    measured = {"a": columns(random, 300), "b": columns(random, 300)}
    found = benchmark.scores(measured)
    both = {name: np.concatenate([measured["a"][name], measured["b"][name]]) for name in measured["a"]}
    good = [both["completed"][i] and not any(both[name][i, 0] for name in benchmark.ROBOTS_FAULT) for i in range(600)]
    assert found.figures["polite"].mean == pytest.approx(100 * np.mean(good))
    assert found.figures["seconds"].mean == pytest.approx(both["seconds"].mean())
    np.testing.assert_allclose(found.shares.mean, both["time_in_situation"][:, 1:].sum(0) / (600 * 40.0))
    events, minutes = both["intimate_robot_on_person"][:, 1:].sum(0), both["time_in_situation"][:, 1:].sum(0) / 60
    np.testing.assert_allclose(found.violations.mean, events / minutes)
    for each in (*found.figures.values(), found.shares, found.violations):
        assert (each.low <= each.mean + 1e-9).all() and (each.mean <= each.high + 1e-9).all()
    error = 1.96 * both["seconds"].std() / 600**0.5
    assert found.figures["seconds"].high - found.figures["seconds"].low == pytest.approx(2 * error, rel=0.15)


def test_a_package_of_another_protocol_runs_nothing(monkeypatch, tmp_path):
    monkeypatch.setattr(tracks, "CONTENT", "0" * 16)
    with pytest.raises(InputError, match="have the digest .* and protocol 1 has 0000"):
        benchmark.run(BenchmarkConfig(policy="go_to_goal", out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_episodes_have_a_stream_of_their_own():
    assert "benchmark" in prng.USES


@pytest.mark.slow
def test_a_benchmark(tmp_path, monkeypatch, capsys):
    """Written, continued, checked, ranked; and refused where somebody changed it."""
    monkeypatch.setattr(tracks, "TRACKS", {name: tracks.TRACKS[name] for name in ("lab-join_group", "lab-handcrafted")})
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
    monkeypatch.setattr(tracks, "EPISODES", 6)
    with pytest.raises(InputError, match="too few to rank it"):
        benchmark.ranking([out])

    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    result["scores"]["figures"]["polite"]["mean"] = 100.0
    changed = tmp_path / "changed"
    shutil.copytree(out, changed)
    (changed / "result.json").write_text(json.dumps(result), encoding="utf-8")
    with pytest.raises(InputError, match="was changed after it was written"):
        benchmark.check(changed)
    result["seal"] = benchmark.seal(result)
    (changed / "result.json").write_text(json.dumps(result), encoding="utf-8")
    with pytest.raises(InputError, match="does not follow from its episodes"):
        benchmark.check(changed)
    shutil.copy(out / "lab-handcrafted.npz", changed / "lab-join_group.npz")
    with pytest.raises(InputError, match="is not the file of the result"):
        benchmark.check(changed)
