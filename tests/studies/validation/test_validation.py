"""``sean validate``: descriptions that hold together, measures of motion that is known, models that are broken."""

import json
import re
from dataclasses import replace
from importlib import import_module

import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import InputError
from sean_jax.cli import command_line
from sean_jax.config import ValidateConfig
from sean_jax.studies import validation
from sean_jax.studies.calibration.loss import GROUPS
from sean_jax.studies.scenes import Gate, model
from sean_jax.studies.validation import checks, crowds, guideline_scenes, guidelines, individuals, page, pictures
from sean_jax.studies.validation.checks import CHECKS, GATES, CheckContext, CheckResult, CheckRow, Curve
from sean_jax.studies.validation.measures import crossing_times, flow, trajectory_data, vanishing_times
from support.checkout import ROOT, module_of
from support.checks import made_check
from support.tracks import moved, tracks_of


def straight(scenario, state, share: float = 1.0):
    """Everybody as desired, through everybody and every wall."""
    people = state.pedestrians
    velocity = jnp.where(people.present[:, None], share * people.desired_velocity, 0.0)
    return moved(people, velocity, scenario.time_step)


def half(scenario, state):
    """Half as fast as desired."""
    return straight(scenario, state, 0.5)


def still(scenario, state):
    """Nobody moves."""
    return straight(scenario, state, 0.0)


def eager(scenario, state):
    """Everybody walks to the right from the start, whatever is desired."""
    people = state.pedestrians
    velocity = jnp.where(people.present[:, None], jnp.asarray([[1.33, 0.0]]), 0.0)
    return moved(people, velocity, scenario.time_step)


def finding(name: str, moved_by) -> CheckResult:
    return CHECKS[name].run(CheckContext(model(moved_by), quick=True))


# ------------------------------------------------------------------ descriptions


def test_every_check_is_described_and_belongs_to_a_gate():
    for name, check in CHECKS.items():
        assert name == check.name and " " not in name
        for text in (check.title, check.setup, check.measure, check.criterion, check.source):
            assert text and text == text.strip(), name
        module, function = check.function.split(".")
        assert callable(getattr(import_module(f"sean_jax.studies.validation.{module}"), function))
    found = [name for gate in GATES for pattern in gate.checks for name in checks.matches(pattern)]
    assert len(found) == len(set(found))
    for gate in GATES:
        assert gate.title and gate.promise and any(checks.matches(pattern) for pattern in gate.checks), gate.title


def test_the_tests_of_the_guidelines_are_all_there():
    wanted = {f"rimea-{number}" for number in (1, 4, 5, 6, 7, 9, 10, 11, 12, 14, 15, 16)}
    wanted |= {f"imo-{number}" for number in (1, 4, 5, 6, 7, 8, 9, 10)} | {f"iso-{number}" for number in (12, 13, 16)}
    wanted |= {f"nist-{number}" for number in ("2.1", "2.3", "2.4", "2.8", "2.9", "3.1", "5.1", "5.2")}
    assert wanted <= set(CHECKS)


def test_fitted_checks_are_those_that_the_loss_of_calibrations_measures():
    in_loss = {name for group in GROUPS.values() for name in group["checks"]}
    assert in_loss == {name for name, check in CHECKS.items() if check.fitted} and len(in_loss) > 14
    assert CHECKS["stop-and-go"].data == "fitted" and CHECKS["prediction"].data == "held out"


def test_criteria_tell_every_rule():
    """Of checks in which everybody has to arrive, or a difference may be of some size."""
    for name in ("rimea-9", "rimea-11", "rimea-14", "imo-4", "nist-5.2", "iso-16", "bottleneck", "bottleneck-crowd"):
        assert "all out" in CHECKS[name].criterion, name
    for name in ("imo-8", "nist-2.8", "nist-5.1"):
        assert "all get through" in CHECKS[name].criterion, name
    for name, words in (
        ("rimea-4", f"{guidelines.SLACK:g}".lstrip("0")),
        ("pairs-crossing", f"{1000 * individuals.TOLERANCE:g} mm"),
        ("stop-and-go", f"{crowds.WAVE_SPEED_TOLERANCE:g} m/s"),
        ("prediction", "companions"),
        ("closed-loop", "constant velocity"),
    ):
        assert words in CHECKS[name].criterion, name


def test_checks_are_chosen_by_name_and_by_the_beginning_of_a_name():
    assert [check.name for check in checks.select("nist-2.1,rimea-1")] == ["rimea-1", "nist-2.1"]
    assert {check.name for check in checks.select("iso-*")} == {"iso-12", "iso-13", "iso-16"}
    quick = {check.name for check in checks.select(None, True)}
    assert quick < set(CHECKS) and "rimea-9" not in quick
    assert "rimea-9" not in {check.name for check in checks.select("rimea-*", True)}
    assert [check.name for check in checks.select("rimea-9", True)] == ["rimea-9"]
    with pytest.raises(InputError, match="--only: 'rimea-99'"):
        checks.select("rimea-99")


def test_plans_have_the_people_and_doors_that_they_say():
    scene = guideline_scenes.cabins()
    assert len(scene.walkers.start) == 23
    # IMO's test 10: cabins 5, 6, 11 and 12 leave by the secondary exit; 1 to 6 lie above, from left to right.
    x, y = np.asarray(scene.walkers.start).T
    cabin = 1 + (x // 3.0).astype(int) + np.where(y > 1.2, 0, 6)
    door, leaves_by = np.asarray(scene.walkers.route).T
    np.testing.assert_array_equal(cabin, door + 1)
    np.testing.assert_array_equal(leaves_by == 13, np.isin(cabin, [5, 6, 11, 12]))
    np.testing.assert_array_equal(np.bincount(cabin)[1:], [2] * 11 + [1])
    ends = [np.mean([gate.left, gate.right], 0) for gate in (scene.gates[12], scene.gates[13])]
    assert [tuple(end) for end in ends] == [(0.0, 0.6), (18.0, 0.6)], "the main exit is at the left"
    for number, doors in ((1000, 4), (400, 2)):
        hall = guideline_scenes.hall(number, doors)
        start, route = np.asarray(hall.walkers.start), np.asarray(hall.walkers.route)[:, 0]
        assert len(start) == number and set(route) == set(range(doors))
        middle = np.array([np.mean(gate, axis=0) for gate in hall.gates])
        gaps = np.linalg.norm(start[:, None] - middle[None], axis=-1)
        np.testing.assert_array_equal(gaps.argmin(1), route)
    assert len(guideline_scenes.counterflow(50).walkers.start) == 150
    for density in (0.5, 3.0, 6.0):
        start = np.asarray(guideline_scenes.ring(26.0, 2.0, round(52 * density), 1.0).walkers.start)
        gap = np.linalg.norm(start[:, None] - start[None], axis=-1) + 9 * np.eye(len(start))
        assert gap.min() > 0.25, density


# ------------------------------------------------------------------ measures


def test_crossings_of_people_who_walk_evenly():
    draw = np.random.default_rng(0)
    speed, begin = draw.uniform(0.5, 2.0, 40), draw.uniform(-9.0, -1.0, 40)
    time = np.arange(300)[:, None] * 0.1
    position = np.stack([begin + speed * time, np.broadcast_to(draw.uniform(0.1, 1.9, 40), (300, 40))], -1)
    gate = Gate((2.0, 2.0), (2.0, 0.0))
    expected = (2.0 - begin) / speed
    np.testing.assert_allclose(crossing_times(tracks_of(position), gate), expected, atol=1e-6)
    assert np.isinf(crossing_times(tracks_of(position), Gate(gate.right, gate.left))).all()
    assert np.isinf(crossing_times(tracks_of(position + [0.0, 5.0]), gate)).all()
    present = time < 0.5 * expected.max()
    present = np.broadcast_to(present, position.shape[:2])
    found = crossing_times(tracks_of(position, present), gate)
    np.testing.assert_array_equal(np.isfinite(found), expected <= present[:, 0].sum() * 0.1)
    np.testing.assert_allclose(vanishing_times(tracks_of(position, present)), present[:, 0].sum() * 0.1)


def test_flow_is_people_over_time_without_those_who_never_come():
    times = np.concatenate([np.arange(101) / 2.5, [np.inf] * 7])
    assert flow(np.random.default_rng(1).permutation(times)) == pytest.approx(2.5)
    assert np.isnan(flow(np.array([1.0, 2.0, np.inf])))


def test_speeds_and_densities_of_an_even_stream():
    x = (np.arange(52)[None] * 0.5 + 0.9 * np.arange(400)[:, None] * 0.1) % 26.0
    tracks = tracks_of(np.stack([x, np.ones_like(x)], -1))
    assert guidelines.speed_in_squares(tracks, 26.0) == pytest.approx(0.9)
    assert guidelines.speed_in_zone(tracks, 26.0) == pytest.approx(0.9)
    assert guidelines.density(tracks, (4.0, 0.0), (14.0, 2.0), np.linspace(0.0, 40.0, 9)) == pytest.approx(
        1.0, rel=0.02
    )


def test_trajectories_for_pedpy_begin_anew_where_people_come_around():
    pytest.importorskip("pedpy")
    x = np.array([[9.0], [9.8], [0.6], [1.4]])
    table = trajectory_data(tracks_of(np.stack([x, 0 * x], -1)), 10.0)
    assert table.frame_rate == pytest.approx(10.0)
    assert table.data.id.tolist() == [0, 0, 1, 1] and table.data.x.tolist() == x[:, 0].tolist()
    assert trajectory_data(tracks_of(np.stack([x, 0 * x], -1))).data.id.tolist() == [0] * 4


def test_bodies_inside_walls_are_found():
    scene = guideline_scenes.corner()
    place = np.array([[[5.0, 1.0], [9.9, 1.85]]])
    assert guidelines.penetration(scene, tracks_of(place[:, :1]), 0.2) < 0.0
    assert guidelines.penetration(scene, tracks_of(place), 0.2) == pytest.approx(0.05, abs=1e-4)


def test_a_picture_has_the_room_around_people_but_no_wall_far_away():
    away = np.array([[60.0, 60.0, 1.0, 1.0, 0.0]])
    room = guideline_scenes.full_room()
    scene = replace(room, walls=np.concatenate([np.asarray(room.walls), away]))
    path = np.linspace([1.0, 1.0], [7.0, 4.0], 30)[:, None]
    (axes,) = pictures.trajectories(scene, tracks_of(path)).axes
    outer = np.abs(np.asarray(room.walls)[:, :2]).max() + np.asarray(room.walls)[:, 2:4].max()
    lower, upper = np.transpose([axes.get_xlim(), axes.get_ylim()])
    assert (lower < 0.0).all() and (upper > [8.0, 5.0]).all() and (upper < outer + 3.0).all()


# ------------------------------------------------------------------ models that are right or broken


def test_who_walks_as_desired_passes_what_one_person_can_show():
    for name in ("rimea-1", "imo-1", "nist-2.1", "rimea-5", "rimea-7", "nist-2.4", "rimea-10", "nist-2.9"):
        assert finding(name, straight).passed, finding(name, straight)


def test_who_walks_half_as_fast_fails_on_speed():
    for name in ("rimea-1", "imo-1", "nist-2.1", "rimea-7", "nist-2.4"):
        made = finding(name, half)
        assert not made.passed and "wanted" in made.reason, name
    assert finding("nist-2.1", half).numbers["speed"] == pytest.approx(0.5, rel=0.01)


def test_who_walks_through_walls_fails_at_a_corner():
    for moved_by in (straight, eager):
        made = finding("rimea-6", moved_by)
        assert not made.passed and made.numbers["penetration"] > 0.1
    assert finding("rimea-6", "constant_velocity").passed


def test_who_heeds_nobody_is_as_fast_in_a_crowd():
    made = finding("rimea-4", straight)
    assert not made.passed and made.numbers["speed at 4"] == pytest.approx(made.numbers["speed at 0.5"], rel=0.1)
    assert finding("iso-13", straight).passed


@pytest.mark.night
def test_who_does_not_wait_or_does_not_go_fails():
    assert not finding("rimea-5", eager).passed
    for name in ("rimea-1", "rimea-5", "rimea-6", "rimea-10", "nist-2.9", "nist-5.2", "iso-12"):
        made = finding(name, still)
        assert not made.passed and made.reason, name


# ------------------------------------------------------------------ the command


@pytest.fixture
def table(monkeypatch) -> dict[str, list[str]]:
    """Three checks in place of all: one passes, one fails, one cannot be done; and who was asked, by model."""
    asked: dict[str, list[str]] = {}

    def passes(context):
        asked.setdefault("rimea-1", []).append(context.model.name)
        (tracks,) = context.simulate(replace(guideline_scenes.one_walker(1.0), seconds=1.0), "a <step>")
        curve = Curve("speed", (0.0, 1.0), (1.0, float("nan")))
        return CheckResult(
            True, "fine", numbers={"rows": float(len(tracks.frame)), "none": float("inf")}, curves=(curve,)
        )

    def fails(context):
        asked.setdefault("rimea-4", []).append(context.model.name)
        return CheckResult(False, "3 m", "3 m & more")

    def cannot(context):
        asked.setdefault("prediction", []).append(context.model.name)
        context.recordings()

    made = {
        check.name: check for check in map(made_check, ("rimea-1", "rimea-4", "prediction"), (passes, fails, cannot))
    }
    monkeypatch.setattr(checks, "CHECKS", made)
    return asked


OWN = """
def straight(scenario, state):
    people = state.pedestrians
    step = people.desired_velocity * people.present[:, None].astype(float)
    return people.replace(position=people.position + scenario.time_step * step, velocity=step)
"""


def test_a_run_keeps_its_rows_and_does_only_what_is_missing(table, tmp_path, monkeypatch, capsys):
    (tmp_path / "own.py").write_text(OWN)
    own = f"{tmp_path / 'own.py'}:straight"
    options = ValidateConfig(models=own, out=tmp_path / "out")
    assert validation.run(options) == ["rimea-4"]
    content = json.loads((tmp_path / "out" / "results.json").read_text())
    assert [row["verdict"] for row in content["rows"]] == ["passes", "fails", "skipped"]
    assert [row["data"] for row in content["rows"]] == ["held out"] * 3
    assert content["rows"][0]["numbers"] == {"rows": 11.0, "none": None}
    assert "--data" in content["rows"][2]["reason"] and own in content["command"]
    text = (tmp_path / "out" / "report.html").read_text()
    for word in ("Title &lt;b&gt;", "3 m &amp; more", "a &lt;step&gt;", "straight", "<svg", "RiMEA, IMO, NIST, ISO"):
        assert word in text, word
    assert "http" not in text.replace("https://", "") or "src=" not in text

    table_text = (tmp_path / "out" / "table.md").read_text()
    assert "| check | data | straight |" in table_text and "| rimea-1 | held out | passes: fine |" in table_text
    assert "| RiMEA, IMO, NIST, ISO | all pass | fails: 1 of 2: rimea-4 |" in table_text

    validation.run(options.replace(models=f"{own},constant_velocity"))
    assert table["rimea-1"] == ["straight", "constant_velocity"]  # the first was kept
    assert table["prediction"] == ["straight", "straight", "constant_velocity"]  # what was skipped is tried again
    monkeypatch.setattr(checks, "_code", lambda: "other")
    validation.run(options)
    assert table["rimea-1"][-1] == "straight" and len(table["rimea-1"]) == 3


def test_a_file_of_constants_in_another_folder_moves_people(table, tmp_path):
    (tmp_path / "mine.yaml").write_text("preset: calibrated\nparameters:\n  repulsion.strength: 4.0\n")
    options = ValidateConfig(models=str(tmp_path / "mine.yaml"), out=tmp_path / "out")
    assert validation.run(options) == validation.run(options)
    assert len(table["rimea-1"]) == 1  # kept, whatever the path


def test_a_stopped_run_goes_on(table, tmp_path, monkeypatch):
    def stop(context):
        raise KeyboardInterrupt

    whole = dict(checks.CHECKS)
    monkeypatch.setitem(checks.CHECKS, "rimea-4", made_check("rimea-4", stop))
    arguments = ["validate", "--models", "constant_velocity", "--out", str(tmp_path / "out"), "--quiet"]
    assert command_line.main(arguments) == 130
    monkeypatch.setattr(checks, "CHECKS", whole)
    assert command_line.main(arguments) == 0
    assert command_line.main([*arguments, "--strict"]) == 1
    assert len(table["rimea-1"]) == 1


def test_guidelines_that_share_a_test_share_its_simulation(table, tmp_path, monkeypatch):
    monkeypatch.setitem(checks.CHECKS, "imo-1", replace(checks.CHECKS["rimea-1"], name="imo-1"))
    validation.run(ValidateConfig(models="constant_velocity", out=tmp_path / "out"))
    assert table["rimea-1"] == ["constant_velocity"]
    rows = json.loads((tmp_path / "out" / "results.json").read_text())["rows"]
    assert [row["check"] for row in rows if row["measured"] == "fine"] == ["rimea-1", "imo-1"]


def test_gates_are_what_their_checks_are(monkeypatch):
    names = ("rimea-1", "rimea-4", "doors")
    monkeypatch.setattr(checks, "CHECKS", {name: made_check(name, None) for name in names})

    def verdicts(**kinds: str) -> dict[str, str]:
        rows = [
            CheckRow(name.replace("_", "-"), "m", verdict, "1 m", "why", {}, (), ("", ""), (), 0.0)
            for name, verdict in kinds.items()
        ]
        return {title: verdict for title, _, verdict, _ in page.gates(rows, "m")}

    standards, doors = "RiMEA, IMO, NIST, ISO", "one person, doors of .7 m and wider"
    found = verdicts(rimea_1="passes", rimea_4="passes", doors="fails")
    assert found[standards] == "passes" and found[doors] == "fails" and found["group occupancy"] == "skipped"
    assert verdicts(rimea_1="passes")[standards] == "partly"
    assert verdicts(rimea_1="passes", rimea_4="fails")[standards] == "fails"
    assert verdicts(rimea_1="skipped", rimea_4="skipped")[standards] == "skipped"


def test_the_page_of_the_docs_has_every_check_and_only_those():
    text = (ROOT / "docs" / "validation.md").read_text(encoding="utf-8")
    heads = re.findall(r"^\| (`[a-z0-9.-]+`(?:, `[a-z0-9.-]+`)*) \|", text, re.M)
    described = [name for head in heads for name in re.findall(r"`([a-z0-9.-]+)`", head)]
    assert sorted(described) == sorted(CHECKS)
    assert module_of(ROOT / "docs" / "validation.py").fill(text) == text, "run: python docs/validation.py"
    slow = {name for name, check in CHECKS.items() if not check.quick}
    left_out = re.search(r"leaves out (.*?)\.\s", text, re.S)
    assert left_out and set(re.findall(r"`([a-z0-9.-]+)`", left_out[1])) == slow


@pytest.mark.night
def test_the_quick_suite_of_the_default_people(tmp_path):
    """Whatever a gate promises is kept, or its row says why not; and no check breaks."""
    validation.run(ValidateConfig(quick=True, out=tmp_path / "out"))
    rows = json.loads((tmp_path / "out" / "results.json").read_text())["rows"]
    assert [row["check"] for row in rows] == [check.name for check in checks.select(None, True)]
    for row in rows:
        assert row["measured"] or row["verdict"] == "skipped", row
        assert row["verdict"] == "passes" or row["reason"], row
