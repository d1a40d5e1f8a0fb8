"""Tables and figures of a study against what was stored, cell by cell: whose it is, on which page, in which order."""

import contextlib
import csv
import math
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.stats
from test_survey import FILM, change, read, reply

from sean_jax.errors import FileError
from sean_jax.survey import export, report, server
from sean_jax.survey.answers import BROKEN_OFF, FILE, Answers
from sean_jax.survey.drive import Drive

TAKING_PART = 0, 3, 7  # numbers of participants, from 0
EPISODES = {(0, 0): "expert", (2, 0): "orca", (2, 1): "go_to_goal"}  # trial, side -> policy
KINDS = {"calm": "watch", "mine": "drive", "pair": "choose"}


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """The answers of three participants who have driven twice, and what was stored: values, and moments of drives."""
    folder, draw = tmp_path_factory.mktemp("stored"), np.random.default_rng(4)
    answers = Answers.begin(folder, read(folder))
    for (trial, side), policy in EPISODES.items():
        answers.add_episode(trial, side, policy, "completed", {"path_length": 3.0 + trial + side}, FILM)
    values, moments = {}, {}
    for number in TAKING_PART:
        answers.consent(number)
        for place, step in enumerate(answers.steps(number)):
            answers.event(number, f"page {place}")
            answers.show(number, place)
            for count, outcome in enumerate((BROKEN_OFF, "timed out") if step.kind == "drive" else ()):
                drive = answers.begin_drive(number, place)
                rows = moments[number, place, count] = draw.normal(size=(12 + 3 * count, 5)).round(4).tolist()
                answers.add_moments(drive, 0, rows[:10])
                answers.add_moments(drive, 10, rows[10:])
                answers.end_drive(drive, outcome, *([{"path_length": 10.0 + number}, FILM] if count else []))
            for question in step.questions:
                value = values[number, place, question["name"]] = reply(question, draw)
                answers.answer(number, place, question["name"], value)
            answers.finish(number, place, place + 1 == len(answers.steps(number)))
    yield answers, values, moments
    answers.close()


def test_participants_and_pages(stored):
    answers, _, _ = stored
    rows = export.participants(answers)
    assert [row["participant"] for row in rows] == list(range(1, 61))
    for k, row in enumerate(rows):
        there = k in TAKING_PART
        assert (row["steps_done"], row["steps"]) == (5 * there, 5)
        assert bool(row["consented"]) == bool(row["finished"]) == there
    rows = export.pages(answers)
    assert [(row["participant"], row["place"], row["trial"]) for row in rows] == [
        (k + 1, place + 1, answers.steps(k)[place].name) for k in TAKING_PART for place in range(5)
    ]
    for row in rows:
        assert row["opened"] <= row["shown"] <= row["done"] and row["reloads"] == row["too_early"] == 0
        film = row["kind"] in ("watch", "choose")
        assert (row["film_s"], row["watched_s"] != "") == (pytest.approx(3.0) if film else "", film)
        assert row["began"] or row["kind"] != "drive"


def test_trials(stored):
    answers, values, _ = stored
    expected = []
    for number in TAKING_PART:
        for place, step in enumerate(answers.steps(number)):
            head = number + 1, place + 1, step.name, step.kind
            if step.kind == "drive":
                expected += [(*head, "participant", 1, BROKEN_OFF, "", None)]
                expected += [(*head, "participant", 2, "timed out", "", 10.0 + number)]
            elif step.kind == "watch":
                expected += [(*head, "expert", "", "completed", "", 3.0)]
            elif step.kind == "choose":
                first = (values[number, place, "choice"] == "A") != step.swapped
                expected += [(*head, "orca", "", "completed", int(first), 5.0)]
                expected += [(*head, "go_to_goal", "", "completed", int(not first), 6.0)]
    columns = "participant place trial kind policy drive outcome chosen path_length".split()
    rows = export.trials(answers)
    assert [tuple(row.get(name) for name in columns) for row in rows] == expected
    assert {row["trial"]: row["kind"] for row in rows} == KINDS
    assert all(row["began"] <= row["ended"] != "" for row in rows if row["kind"] == "drive")


def test_answers_and_scores(stored):
    answers, values, _ = stored
    rows = export.answers_table(answers)
    given = {(row["participant"] - 1, row["place"] - 1, row["question"]): row for row in rows if row["kind"] != "scale"}
    assert {key: row["value"] for key, row in given.items()} == values
    assert all(row["trial"] == answers.steps(number)[place].name for (number, place, _), row in given.items())
    assert {row["question"]: row["kind"] for row in given.values() if "." not in row["question"]} == {
        "age": "number", "easy": "likert", "why": "text", "choice": "choice", "car": "choice"
    }  # fmt: skip
    assert [row["participant"] for row in rows] == sorted(row["participant"] for row in rows)


def test_trajectories(stored):
    answers, _, moments = stored
    names = "speed_command turn_command x y heading".split()
    found = [(row["participant"], row["trial"], row["step"], [row[name] for name in names])
             for row in export.trajectories(answers)]  # fmt: skip
    expected = [(number + 1, "mine", k + 1, row) for (number, _, _), rows in moments.items()
                for k, row in enumerate(rows)]  # fmt: skip
    assert found == expected


def test_files_of_tables(stored, tmp_path):
    """In a folder that is missing, with the folders that it is in; a second time over the first."""
    for _ in range(2):
        files = export.export(stored[0], tmp_path / "a" / "b")
        pages = [f"drives/participant-{number + 1}-mine.html" for number in TAKING_PART]
        assert [str(file.relative_to(tmp_path / "a" / "b")) for file in files] == [*export.TABLES, *pages]
        assert all(file.is_file() for file in files) and "participant-4-mine" in files[-2].read_text()
    rows = list(csv.DictReader((tmp_path / "a" / "b" / "trajectories.csv").open()))
    assert [float(row["x"]) for row in rows] == [row["x"] for row in export.trajectories(stored[0])]


def test_ratings_and_preferences(stored):
    """Ratings are likert questions of one's own and scores of scales; here a choice is not rated."""
    answers, values, _ = stored
    rows = report.rated(answers)
    scales = {row["question"] for row in export.answers_table(answers) if row["kind"] == "scale"}
    assert scales and {name for row in rows for name in row["ratings"]} <= scales | {"easy"}
    rated = {(row["participant"] - 1, row["trial"]): row for row in rows}
    assert set(rated) == {(number, trial) for number in TAKING_PART for trial in ("calm", "mine")}
    for (number, trial), row in rated.items():
        place = next(k for k, step in enumerate(answers.steps(number)) if step.name == trial)
        assert row["ratings"].get("easy") == values.get((number, place, "easy"))
        assert row["metrics"] == {"path_length": 3.0 if trial == "calm" else 10.0 + number}
    (found,) = report.preferences(answers)
    first = [row["chosen"] for row in export.trials(answers) if row["policy"] == "orca"]
    ends = scipy.stats.binomtest(sum(first), 3).proportion_ci(0.95, "wilson")
    assert (found.trial, found.policies, found[-1]) == ("pair", ("orca", "go_to_goal"), 3)
    assert (found.value, found.low, found.high) == pytest.approx((sum(first) / 3, ends.low, ends.high), abs=1e-6)


def test_small_p_values_in_the_table():
    """Below .001 no digits, from there on three of them; below the level they are marked."""
    shown = {0.0002: "< 0.001", 0.00099: "< 0.001", 0.001: "0.001", 0.0013: "0.001", 0.049: "0.049", 0.051: "0.051"}
    found = [report.Correlation("easy", "path_length", 0.5, 0.2, 0.7, 30, 10, p) for p in shown]
    _, rows = report.correlation_table(found)
    assert [row[4].text for row in rows] == list(shown.values())
    assert [bool(row[4].kind) for row in rows] == [p < 0.05 for p in shown]


def test_a_page_after_the_last_is_refused(stored, tmp_path):
    folder = tmp_path / "study"
    folder.mkdir()
    Answers.begin(folder, read(folder)).close()
    change(folder, "INSERT INTO answers (participant, step, question, value, time) VALUES (2, 5, 'age', '20', 1.0)")
    with contextlib.closing(Answers(folder / FILE)) as answers:
        with pytest.raises(FileError, match="no page 6 of participant 3"):
            answers.all_answers()


@pytest.mark.parametrize(("time_step", "sizes"), [(0.1, [10, 10, 3]), (0.25, [4] * 5 + [3]), (2.0, [1] * 23)])
def test_moments_of_a_drive_are_stored_each_second(time_step, sizes):
    """A kill loses a second at most; what is left when a drive is broken off is stored too."""
    written = []
    answers = SimpleNamespace(
        begin_drive=lambda participant, step: (participant, step),
        add_moments=lambda *given: written.append(given),
        end_drive=lambda *given: written.append(given),
    )
    session = SimpleNamespace(
        scenario=SimpleNamespace(time_step=time_step), commands=[], drive=bool, run=None, close=lambda: None
    )
    drive = Drive(answers, session, 4, 2)
    rows = []
    for k in range(23):
        session.commands.append([0.1 * k, -0.2])
        heading = np.array([math.cos(0.1 * k), math.sin(0.1 * k)])
        drive._note(SimpleNamespace(trajectory=SimpleNamespace(position=np.array([k, -k]), heading=heading)))
        rows.append([0.1 * k, -0.2, float(k), float(-k), round(0.1 * k, 4)])
    drive.close()
    *parts, end = written
    assert end == ((4, 2), BROKEN_OFF) and [len(part[2]) for part in parts] == sizes
    assert [part[:2] for part in parts] == [((4, 2), sum(sizes[:k])) for k in range(len(sizes))]
    np.testing.assert_allclose([row for part in parts for row in part[2]], rows, atol=1e-9)


@pytest.mark.parametrize(
    ("given", "told"), [(None, "http://127.0.0.1:4321"), ("https://lab.org/it", "https://lab.org/it")]
)
def test_the_address_of_links_is_the_studys_if_it_has_one(given, told):
    survey = SimpleNamespace(study=SimpleNamespace(address=given), port=4321)
    assert server.Survey.address.fget(survey) == told
