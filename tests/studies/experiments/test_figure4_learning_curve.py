"""The learning curve of policy G: what is compared, verdicts against closed forms, and a report at toy size."""

import itertools
import json
import shutil

import numpy as np
import pytest

import sean_jax
from sean_jax.cli import command_line
from sean_jax.config import Figure4Config, LearningCurveConfig
from sean_jax.config.workspace import Workspace
from sean_jax.core.errors import InputError
from sean_jax.learning.dataset import open_dataset
from sean_jax.learning.policy import AGENTS, check_policy
from sean_jax.studies import experiments
from sean_jax.studies.experiments import figure4, learning_curve
from sean_jax.studies.experiments.learning_curve import KEYS, Variant, comparisons
from sean_jax.studies.experiments.results_table import estimate, join, rows
from sean_jax.studies.experiments.shares import BEHAVIORS

ASKED = LearningCurveConfig()
WORK = Workspace(ASKED.folder, {})


def test_what_is_compared():
    asked = learning_curve.variants(ASKED)
    assert [each.name for each in asked] == ["1h", "10h", "100h", "1h-10hz", "1h-flags"]
    pairs = [(one.name, other.name) for one, other in comparisons(asked)]
    assert pairs == [("10h", "1h"), ("100h", "10h"), ("1h-10hz", "1h"), ("1h-10hz", "10h"), ("1h-flags", "1h")]
    others = ASKED.replace(demonstration_hours=(3.0, 0.5, 3.0), rates=(1, 2, 5))
    names = ["0.5h", "3h", "3h-2hz", "3h-5hz", "3h-flags"]
    assert [each.name for each in learning_curve.variants(others)] == names
    assert [each.title for each in asked][-2:] == ["1 h at 10 Hz", "1 h with flags"]


def test_the_first_variant_is_column_g_of_figure_4():
    """The same demonstrations and the same network, but for names of folders."""
    paper = figure4.learner(Figure4Config(out=ASKED.folder), WORK, "G")
    taught = {each.name: learning_curve.variant_learner(ASKED, WORK, each) for each in learning_curve.variants(ASKED)}
    one = taught["1h"]
    assert one.experiment.datasets == 3 and len(one.networks) == 3
    assert one.data.identity() == paper.data.identity() and (one.data.hours, paper.data.hours) == (3.0, 10.0)
    ours, theirs = one.training((1, 0)), paper.training((1, 0))
    assert (ours.part, theirs.part) == ((2, 3), (2, 10)), "an hour each"
    assert ours.replace(part=(1, 1)).identity() == theirs.replace(part=(1, 1)).identity()
    assert ours.epochs == theirs.epochs and ours.patience == theirs.patience
    assert taught["1h-flags"].data == one.data and taught["1h-flags"].training((0, 0)).flags
    assert taught["1h-10hz"].data.rate == 10
    assert {each.data.seed for each in taught.values()} == {0}
    folders = [each.training(network).folder for each in taught.values() for network in each.networks]
    assert len(set(folders)) == 15


def test_the_optimizer_makes_no_more_steps_than_asked_for():
    for variant, updates in itertools.product(learning_curve.variants(ASKED), (1, 500, 20_000)):
        training = learning_curve.variant_learner(ASKED.replace(updates=updates), WORK, variant).training((0, 0))
        steps = int(np.ceil(0.9 * 3600 * variant.hours * variant.rate / 1024))
        assert training.epochs == max(1, min(1000, updates // steps))
    assert training.epochs == 1000, "an hour stops by itself"


def test_verdicts_are_those_of_known_episodes():
    """Four episodes of each of two networks. What is better in each episode is surely better, and in some perhaps."""
    asked = (Variant(1.0), Variant(10.0), Variant(1.0, flags=True))
    random = np.random.default_rng(0)
    base = random.random(8)

    def cell(percent, waiting, violations) -> dict:
        measures = {"completed": percent / 100.0, "time_not_moving": waiting}
        return measures | {"violations": violations, "collisions": 0.0 * base}

    mixed = base + np.array([1.0, -1.0] * 4)
    values = {
        "1h": {b: cell(50 * base, base, base) for b in BEHAVIORS},
        "10h": {b: cell(50 * base + k, base - 1.0, base + 0.5) for k, b in enumerate(BEHAVIORS, 1)},
        "1h-flags": {b: cell(50 * base, mixed, base) for b in BEHAVIORS},
    }
    table = learning_curve.with_means(join([
        rows(value, measure=measure, policy=name, behavior=b, dataset=np.arange(8) // 4)
        for name, by_behavior in values.items()
        for b, measures in by_behavior.items()
        for measure, value in measures.items()
    ]))  # fmt: skip
    verdicts = learning_curve.verdicts(table, asked)
    told = {(row["variant"], row["measure"]): row for row in verdicts}
    assert len(told) == len(verdicts) == 6
    more = [told["10 h", measure] for measure in ("completed", "time_not_moving", "violations")]
    assert [row["holds"] for row in more] == [True, True, False] and [row["share"] for row in more] == [1.0, 1.0, 0.0]
    np.testing.assert_allclose([row["difference"].mean for row in more], [2.0, -1.0, 0.5], atol=1e-9)
    np.testing.assert_allclose(more[0]["difference"][1:3], 2.0, atol=1e-9)
    perhaps = told["1 h with flags", "time_not_moving"]
    assert 0.05 < perhaps["share"] < 0.95 and perhaps["difference"].low < 0 < perhaps["difference"].high
    assert not told["1 h with flags", "completed"]["holds"], "equally many are not more"
    apart = learning_curve.differences(table, asked[1], asked[0])
    np.testing.assert_allclose([apart[b, "completed"].mean for b in (*BEHAVIORS, "mean")], [1, 2, 3, 2])
    assert estimate(table, KEYS)["1h", "graph", "completed"].mean == pytest.approx(50 * base.mean())


def test_options_of_the_curve_are_its_own(tmp_path):
    assert not {"demonstration_hours", "rates", "updates"} & set(Figure4Config.model_fields)
    sizes = ASKED.demonstration_hours, ASKED.rates, ASKED.datasets, ASKED.trainings
    assert sizes == ((1.0, 10.0, 100.0), (10,), 3, 1)
    with pytest.raises(InputError, match="rate: 3 examples a second do not divide its 10 steps"):
        learning_curve.run_learning_curve(LearningCurveConfig(rates=(3,), out=tmp_path / "out"))
    preset = LearningCurveConfig(preset="sean2")
    assert learning_curve.variant_collection(preset, Variant(1.0, 10)).dynamics == "kinematic"
    assert not list(tmp_path.iterdir())


SMALL = "--environment lab --people 4 --quick --time-limit 20 --quiet"


@pytest.mark.night
def test_learning_curve(tmp_path, monkeypatch):
    """With three parts at once, and what is missing one by one, to the same bytes."""
    monkeypatch.setattr(experiments, "workers", lambda: 3)
    out = tmp_path / "curve"
    given = f"{SMALL} --demonstrator go_to_goal --demonstration-hours 0.0167 0.04 --rates 10 --trainings 2".split()
    given += f"--episodes 5 --epochs 2 --out {out}".split()
    assert command_line.main(["experiment", "learning_curve", *given]) == 0
    names = ["0.0167h", "0.04h", "0.0167h-10hz", "0.0167h-flags"]
    rows = [line.split(",") for line in (out / "learning_curve.csv").read_text(encoding="utf-8").splitlines()[1:]]
    assert list(dict.fromkeys(row[0] for row in rows)) == names and {row[4] for row in rows} == {*BEHAVIORS, "mean"}
    for name, measure in itertools.product(names, ("completed", "time_not_moving", "violations")):
        cells = {row[4]: [float(value) for value in row[6:]] for row in rows if (row[0], row[5]) == (name, measure)}
        assert cells["mean"][0] == pytest.approx(np.mean([cells[b][0] for b in BEHAVIORS]), abs=1e-4)
        assert all(low - 1e-5 <= mean <= high + 1e-5 for mean, low, high in cells.values())
    slow, fast = (open_dataset(out / f"demonstrations-0.0167h{end}") for end in ("", "-10hz"))
    assert (slow.rate, fast.rate, fast.example_count) == (1, 10, 10 * slow.example_count)
    trained = json.loads((out / "trained-0.0167h-flags-0-1.json").read_text(encoding="utf-8"))
    assert trained["examples"] == slow.example_count and trained["epochs"] == 2
    assert json.loads((out / "policy-0.0167h-flags-0-1" / "config.json").read_text(encoding="utf-8"))["flags"]
    text = (out / "report.html").read_text(encoding="utf-8")
    assert "0.0167 h at 10 Hz better than 0.0167 h" in text and (out / "learning_curve.png").is_file()
    verdicts = (out / "verdicts.csv").read_text(encoding="utf-8").splitlines()
    assert len(verdicts) == 1 + 3 * 3, "more hours, a higher rate, flags; by three measures"
    before = {path.name: path.read_bytes() for path in out.glob("*.csv")}
    for missing in ("trained-0.04h-0-1.json", "episodes-0.04h-graph.json", "episodes-0.0167h-flags-random.json"):
        (out / missing).unlink()
    for missing in ("demonstrations-0.04h", "policy-0.04h-0-1"):
        shutil.rmtree(out / missing)
    monkeypatch.setattr(experiments, "workers", lambda: 1)
    assert command_line.main(["experiment", "learning_curve", *given]) == 0
    assert {path.name: path.read_bytes() for path in out.glob("*.csv")} == before


@pytest.mark.night
def test_a_column_of_figure_4_is_the_folder_of_another_training(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(AGENTS["ppo"], "runs/mine")
    options = Figure4Config(quick=True, environment="lab", people=4, dynamics="twin", time_limit=3.0, episodes=3,
        baselines="runs/mine", out=tmp_path / "figure4",
    )  # fmt: skip
    assert figure4.baselines(options) == ["runs/mine"]
    description = figure4.collection(options, "random", options.hours)
    check_policy("runs/mine", description, "--baselines")
    places = dict.fromkeys(BEHAVIORS, list(figure4.streams(description).values()))
    parts = {part.name: part for part in figure4._parts(options, Workspace(options.folder, {}), places, {})}
    options.folder.mkdir()
    columns = parts["runs/mine in random"].work(lambda share: None)["runs/mine"]
    assert len(columns["completed"]) == 3 and max(columns["seconds"]) <= 3.0 + 1e-3
    assert (options.folder / "episodes-runs-mine-random.json").is_file()
    assert figure4.file_name("./my.py:drive") == "my.py-drive" and sean_jax.POLICIES.get("runs/mine") is None
