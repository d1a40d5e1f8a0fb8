"""Tables and figures of a study against what was stored, cell by cell: whose it is, on which page, in which order."""

import contextlib
import csv
import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.stats
import yaml

from sean_jax.core.errors import FileError, InputError
from sean_jax.studies.survey import export, report, server
from sean_jax.studies.survey.answers import BROKEN_OFF, FILE, Answers
from sean_jax.studies.survey.drive import Drive
from sean_jax.studies.survey.study import checked
from support.survey import FILM, STUDY, change, read, reply

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
        assert (row["film_s"], row["watched_s"] != "") == (pytest.approx(1.5) if film else "", film)
        assert row["began"] or row["kind"] != "drive"


def test_the_last_page_has_no_row(tmp_path):
    answers = Answers.begin(tmp_path, read(tmp_path))
    answers.consent(0)
    for word in ("opened", *(f"page {number}" for number in range(len(answers.steps(0)) + 1)), "closed"):
        answers.event(0, word)
    assert [row["place"] for row in export.pages(answers)] == list(range(1, len(answers.steps(0)) + 1))
    answers.close()


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


def test_a_robot_that_drives_sideways_has_a_command_more(tmp_path):
    """Its drives are stored, exported and shown on the page as those of any other."""
    answers = Answers.begin(tmp_path, read(tmp_path))
    places = [[step.kind for step in answers.steps(number)].index("drive") for number in range(2)]
    rows = [[0.1, -0.2, 0.3, 1.0, 2.0, 0.5]] * 12
    answers.add_moments(answers.begin_drive(0, places[0]), 0, [row[:1] + row[2:] for row in rows])
    answers.add_moments(drive := answers.begin_drive(1, places[1]), 0, rows)
    answers.end_drive(drive, "timed out", {"path_length": 1.0}, FILM)
    text = export.table(answers, "trajectories.csv")
    head, first, *_, last = text.split()
    assert head.endswith("step,speed_command,sideways_command,turn_command,x,y,heading")
    assert first.endswith(",1,0.1,,0.3,1.0,2.0,0.5") and last.endswith(",12,0.1,-0.2,0.3,1.0,2.0,0.5")
    assert export.export(answers, tmp_path / "tables")[-1].name == "participant-2-mine.html"
    answers.add_moments(drive, 12, [rows[0][1:]])
    with pytest.raises(FileError, match="steps with and without a sideways command"):
        answers.moments(drive)
    answers.close()


def test_names_of_metrics_are_neither_formulas_nor_other_columns(tmp_path):
    """A user's own metric may have any name."""
    answers = Answers.begin(tmp_path, read(tmp_path))
    values = {'=HYPERLINK("http://a")': 1.5, "participant": 7.0, "done": 3.0, "metric_done": 4.0}
    answers.add_episode(0, 0, "expert", "completed", values, FILM)
    place = next(k for k, step in enumerate(answers.steps(3)) if step.kind == "watch")
    answers.show(3, place)
    (row,) = csv.DictReader(export.table(answers, "trials.csv").splitlines())
    assert row["participant"] == "4" and row["done"] == "" and row["metric_participant"] == "7.0"
    assert row['\'=HYPERLINK("http://a")'] == "1.5" and not any(name.startswith("=") for name in row)
    assert (row["metric_done"], row["metric_metric_done"]) == ("4.0", "3.0")
    answers.close()


WORDS = {"trial": "t" * 40, "name": "n" * 1000, "question": "q" * 40, "choice": "c" * 1000, "end": "e" * 10_000}
HARD = "\U0001f916", "\u200b\ufeff", "'\"\\\\", "a\tb\nc", "\u2028", "=1+1", "\ue000", "<b>%s{}", "\uffff", "e\u0301"


@pytest.mark.parametrize("hard", ["", *HARD])
def test_what_a_study_accepts_its_file_accepts(tmp_path, hard):
    """Each text of a study at its greatest length, with characters of all kinds: stored, read again and exported."""
    texts = WORDS | {key: (hard * 1000)[: len(WORDS[key])] for key in ("name", "choice", "end") if hard}
    text = yaml.safe_dump({
        "title": texts["end"], "consent": texts["end"], "thanks": texts["end"], "participants": 1,
        "options": {"environment": "lab", "people": 2},
        "questions": ["rosas"],
        "before": [{"kind": "text", "name": texts["question"], "text": texts["end"]}],
        "trials": [{"name": texts["trial"], "text": texts["end"], "watch": {"name": texts["name"], "seed": 1}}],
        "after": [
            {"kind": "choice", "name": "one", "text": "x", "choices": [texts["choice"], "other"]},
            {"kind": "likert", "name": texts["question"], "text": "x", "ends": [texts["end"], texts["end"]]},
        ],
    }, allow_unicode=False)  # fmt: skip
    study = read(tmp_path, text)
    Answers.begin(tmp_path, study).close()
    answers = Answers.begin(tmp_path, study)
    answers.add_episode(0, 0, texts["name"], "completed", {}, FILM)
    answers.consent(0)
    for place, step in enumerate(answers.steps(0)):
        answers.event(0, f"page {place}")
        answers.show(0, place)
        for question in step.questions:
            value = {"text": texts["end"][:2000], "choice": texts["choice"], "likert": 1}[question["kind"]]
            answers.answer(0, place, question["name"], checked(question, value))
        answers.finish(0, place, place == 2)
    assert len(export.export(answers, tmp_path / "tables")) == len(export.TABLES)
    assert {row["policy"] for row in answers.episodes().values()} == {texts["name"]}
    message = {"do": "answer", "step": 999, "question": texts["question"], "value": texts["choice"]}
    assert len(json.dumps(message, ensure_ascii=False).encode()) <= server.LONGEST
    answers.close()


@pytest.mark.parametrize("key", ["title", "consent", "text", "choices", "ends", "policy", "name"])
@pytest.mark.parametrize("half", ["\\ud83d", "\\x00", "\\x85"])
def test_what_no_file_can_hold_is_refused_in_a_study(tmp_path, key, half):
    places = {
        "title": ("Robots in a lab", f'"a{half}"'), "consent": ("You may stop at any time.", f'"{half}"'),
        "text": ("It was easy.", f'"{half}"'), "choices": ("[often, never]", f'[often, "{half}"]'),
        "ends": ("points: 5", f'ends: ["{half}", b]'), "policy": ("policy: expert", f'policy: "{half}"'),
        "name": ("seed: 3", f'seed: 3, name: "{half}"'),
    }  # fmt: skip
    assert places[key][0] in STUDY
    with pytest.raises(FileError, match=r"study.yaml:\d+:\d+: .*"):
        read(tmp_path, STUDY.replace(*places[key]))


def test_the_file_refuses_no_more_of_films_than_is_written(tmp_path, monkeypatch):
    """All of them together, too."""
    monkeypatch.setattr("sean_jax.studies.survey.answers.MAX_FILMS", 3 * len(json.dumps(FILM)) - 1)
    answers = Answers.begin(tmp_path, read(tmp_path))
    answers.add_episode(0, 0, "expert", "completed", {}, FILM)
    answers.add_episode(2, 0, "expert", "completed", {}, FILM)
    with pytest.raises(InputError, match="leave some trials out"):
        answers.add_episode(2, 1, "expert", "completed", {}, FILM)
    assert len(answers.episodes()) == 2
    monkeypatch.setattr("sean_jax.studies.survey.answers.MAX_FILM", 30)
    drive = answers.begin_drive(0, [step.kind for step in answers.steps(0)].index("drive"))
    answers.end_drive(drive, "timed out", {"path_length": 1.0}, FILM)
    assert answers.recording(drive) is None and answers.drives()[0]["metrics"] == {"path_length": 1.0}
    answers.close()


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
