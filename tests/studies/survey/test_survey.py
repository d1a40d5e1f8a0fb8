"""``sean studio --survey``: orders are balanced, no confirmed answer is lost, nobody sees more than the own page."""

import asyncio
import contextlib
import csv
import html
import io
import itertools
import json
import os
import re
import resource
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
import tracemalloc
from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from rich.console import Console
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

import support.survey
from sean_jax.cli import command_line
from sean_jax.config import StudioConfig, SurveyReportConfig, validate
from sean_jax.core.errors import FileError, InputError, WriteError
from sean_jax.io import writing
from sean_jax.studies import survey
from sean_jax.studies.survey import export, report, server, study, visits
from sean_jax.studies.survey.answers import BROKEN_OFF, FILE, Answers
from sean_jax.web import pages
from support.checkout import ROOT
from support.quick import slow
from support.survey import FILM, STUDY, change, read, reply
from support.web import browse, chromium, get, until

served = support.survey.served  # a fixture

# ------------------------------------------------------------------ the description


@pytest.mark.parametrize("count", range(1, 10))
def test_orders_are_balanced(count):
    """Each trial is as often at each place, and as often after each other one."""
    total = study.rows(count)
    orders = [study.sequence(count, number) for number in range(total)]
    assert all(sorted(order) == list(range(count)) for order in orders)
    for place in range(count):
        assert np.all(np.bincount([order[place] for order in orders], minlength=count) == total / count)
    assert total == {1: 1, 3: 6, 5: 10, 7: 14, 9: 18}.get(count, count)
    pairs = [pair for order in orders for pair in itertools.pairwise(order)]
    counts = [pairs.count(pair) for pair in itertools.permutations(range(count), 2)]
    assert len(set(counts)) <= 1


def test_participants_who_do_not_balance_the_orders_are_told(tmp_path):
    assert read(tmp_path).unbalanced() is None, "sixty are ten times the six orders of three trials"
    few = STUDY.replace("participants: 60", "participants: 8")
    note = "participants: 8 are no multiple of 6, so the orders of 3 trials are not fully balanced."
    assert read(tmp_path, few).unbalanced() == note
    assert read(tmp_path, few + "order: fixed\n").unbalanced() is None


def test_sides_are_balanced_at_each_place(tmp_path):
    made = read(tmp_path)
    places = [(number, step) for number in range(2 * study.rows(3)) for step in made.steps(number)]
    for order in range(study.rows(3)):
        sides = [step.swapped for number, step in places if step.kind == "choose" and number % study.rows(3) == order]
        assert sorted(sides) == [False, True]


MISTAKES = [
    ("drivers: 8", "drivers: 0", r"study.yaml:\d+:10: drivers: 0 is less than 1"),
    ("[navigation]", "[navigaton]", r"study.yaml:6:\d+: questions\[0\]: 'navigaton' is not one of rosas, navigation"),
    ("[navigation]", "[rosas, rosas]", r"questions\[1\]: the name 'rosas' is used twice"),
    ("{seed: 4}", "{seed: 4, view: bird}", r"trials\[1\].drive.view: 'bird' is not one of plan, first_person"),
    ("{seed: 4}", "{sed: 4}", r"trials\[1\].drive: .*sed.*did you mean 'seed'"),
    ("people: 2", "people: -1", r"people: -1 must be from 0"),
    ("choices: [often, never]", "choices: [often]", r"after\[0\]: the question 'car' has 1 choices; give two"),
    ("text: It was easy., ", "", r"the question 'easy' has no text"),
    ("range: [18, 99]", "range: [99, 18]", r"before\[0\].range: \[99.*, 18.*\] must be a lower and a higher"),
    ("watch: {policy: go_to_goal, seed: 3}", "text: nothing", r"the trial 'calm' has no episode; give one of watch"),
    ("title: Robots in a lab", "titel: x", r"titel.*did you mean 'title'"),
    ("drivers: 8", "address: example.org", r"address: 'example.org' is no address; write it as https://"),
    ("drivers: 8", "address: https://example.org/study", r"address: 'https://example.org/study' is no address"),
    ("drivers: 8", "address: 'http://['", r"address: 'http://\[' is no address"),
    ("drivers: 8", "address: https://me:pw@example.org", r"is no address; write it as"),
    ("name: why", "name: choice", r"trials\[2\].questions\[0\].name: 'choice' is the name of the choice"),
    (
        '    questions: [{kind: text, name: why, text: "Why?", required: false}]\n',
        "",
        r"trials\[2\]: the trial 'pair' shows"
        r" two robots, and the questions of the study are about one; add questions: \[\]",
    ),
    (
        "[{kind: text, name: why",
        "[rosas, {kind: text, name: why",
        r"trials\[2\].questions\[0\]: 'rosas' rates one robot",
    ),
    ("range: [18, 99]", "range: [18, .inf]", r"before\[0\].range"),
    ("seed: 3}", f"seed: 3, name: {'x' * 1100}}}", r"trials\[0\].watch: name: 1,100 characters; .* at most 1,000"),
    ("seed: 3}", "seed: 3, name: [a, b]}", r"trials\[0\].watch.name: \['a', 'b'\] is no text; write a name in quotes"),
    ("seed: 3}", "seed: 3, name: ''}", r"trials\[0\].watch.name: '' is no text"),
    ("{policy: expert, seed: 5}", "{policy: expert, seed: 5, name: 7}", r"trials\[2\].choose\[1\].name: 7 is no text"),
    ("It was easy.", '"It was \\x07"', r"trials\[1\].questions\[0\].text: character 0007 cannot be stored; remove it"),
    ("[often, never]", f"[often, {'x' * 1001}]", r"after\[0\].choices\[1\]: has 1,001 characters; write at most 1,000"),
    ("name: mine", "name: before", r"'before' is the name of the questions before the trials"),
]


@pytest.mark.parametrize(("before", "after", "message"), MISTAKES)
def test_mistakes_name_file_line_and_cure(tmp_path, before, after, message):
    assert before in STUDY
    with pytest.raises(FileError, match=message) as raised:
        read(tmp_path, STUDY.replace(before, after))
    assert "study.yaml:" in str(raised.value)


def test_the_example_of_the_page_is_a_study(tmp_path):
    text = (ROOT / "docs" / "survey.md").read_text(encoding="utf-8")
    made = read(tmp_path, re.search(r"```yaml\n(.*?)```", text, re.S)[1])
    assert [trial.kind for trial in made.trials] == ["watch", "watch", "drive", "choose"] and len(made.steps(0)) == 6
    for name, template in study.templates().items():
        items = sum(map(len, template.scales.values()))
        assert re.search(rf"\| `{name}` \| {items} .*\| {template.points} \| {', '.join(template.scales)} \|", text)


def test_code_that_a_study_names_is_not_run(tmp_path):
    (tmp_path / "mine.py").write_text("raise SystemExit('it ran')\n")
    made = read(tmp_path, STUDY.replace("policy: go_to_goal, seed: 3", f"policy: '{tmp_path}/mine.py:go'"))
    with pytest.raises(InputError, match="is code, and .*study.yaml names it, not you"):
        server.Survey(Answers.begin(tmp_path, made), "", tmp_path / "study.yaml")


def test_scores_are_means_of_items():
    rosas, own = study.templates()["rosas"], study.templates()["navigation"]
    assert {name: len(items) for name, items in rosas.scales.items()} == dict.fromkeys(
        ("warmth", "competence", "discomfort"), 6
    )
    values = {f"rosas.{item}": k + 1 for k, item in enumerate(rosas.scales["warmth"])}
    assert export.scores(values) == {"rosas.warmth": 3.5}
    values = {f"navigation.{item}": 2 for item in own.scales["legibility"]}
    assert export.scores(values) == {"navigation.legibility": (2 + 6) / 2}  # one of the two is reversed
    assert not export.scores({"navigation.safe": 2})
    assert {item for scale in own.scales.values() for item in scale} >= set(own.reversed)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--survey study.yaml", "--out"),
        ("--out x", "--survey"),
        ("--survey study.yaml --out x --people 3", "people: a study has its own options"),
    ],
)
def test_a_study_has_its_own_options(words, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert command_line.main(["studio", *words.split()]) == 2
    assert message in capsys.readouterr().err


# ------------------------------------------------------------------ the file


def test_a_study_goes_on_with_the_same_links(tmp_path):
    made = read(tmp_path)
    answers = Answers.begin(tmp_path, made)
    secrets, researcher = answers.secrets(), answers.researcher
    assert len(set(secrets.values())) == 60 and min(map(len, secrets.values())) >= 20
    answers.consent(7)
    for value in (33, 44, None, 55):
        answers.answer(7, 0, "age", value)
    drive = answers.begin_drive(7, 1)
    answers.close()
    more = made.model_copy(update={"drivers": 3})
    answers = Answers.begin(tmp_path, more)
    assert (answers.secrets(), answers.researcher, answers.study.drivers) == (secrets, researcher, 3)
    assert answers.answers_of(7, 0) == {"age": 55} and answers.progress(7) == (True, 0, False)
    answers.recover()
    assert [row["outcome"] for row in answers.drives() if row["id"] == drive] == [BROKEN_OFF]
    with pytest.raises(InputError, match="has a study with other title; choose another folder"):
        Answers.begin(tmp_path, made.model_copy(update={"title": "other"}))
    (tmp_path / "other").mkdir()
    with pytest.raises(FileError, match="holds no study.sqlite"):
        Answers(tmp_path / "other" / FILE)
    (tmp_path / "other" / FILE).write_text("nonsense" * 100)
    with pytest.raises(FileError, match="cannot be read: it is damaged; restore"):
        Answers(tmp_path / "other" / FILE)


@pytest.mark.parametrize(
    ("question", "good", "bad"),
    [
        ({"kind": "likert", "points": 5}, [1, 5], [0, 6, 1.5, "1", True, [1], float("nan"), 10**400]),
        ({"kind": "choice", "choices": ["a", "b"]}, ["a"], ["c", 1, ["a"]]),
        ({"kind": "text"}, ["x" * 2000], ["x" * 2001, 3]),
        ({"kind": "number", "range": None}, [0, -1e300], [10**400, -(10**400), float("nan"), "[", {}]),
        ({"kind": "number", "range": [0.0, 1.0]}, [0, 0.5], [2, "0", float("inf"), 10**400]),
    ],
)
def test_answers_are_checked(question, good, bad):
    question = {"name": "one"} | question
    for value in good:
        assert study.checked(question, value) == value
    for value in bad:
        with pytest.raises(InputError, match="one: "):
            study.checked(question, value)
    assert study.checked(question, None) is None and server.checked(question, "") is None


# ------------------------------------------------------------------ the server


def test_a_new_folder_is_its_owners_and_another_stays_as_it_is(tmp_path, monkeypatch):
    monkeypatch.setattr(survey, "_serve", lambda *_: None)
    read(tmp_path)
    for name, before, after in (("new", None, 0o700), ("there", 0o755, 0o755)):
        if before is not None:
            (tmp_path / name).mkdir()
            (tmp_path / name).chmod(before)
        survey.run(SimpleNamespace(survey=tmp_path / "study.yaml", out=tmp_path / name), Console())
        assert (tmp_path / name).stat().st_mode & 0o777 == after


def test_a_page_gets_only_what_it_may_ask_for(tmp_path):
    """Before consent nothing is stored, nor an answer of another page or of a film that has not been seen."""
    answers, shown = Answers.begin(tmp_path, read(tmp_path)), []

    async def show(tab):
        shown.append(tab.participant)

    study_open = SimpleNamespace(answers=answers, _steps=[answers.steps(0)], _show=show)

    def ask(participant, **request):
        asyncio.run(server.Survey._handle(study_open, server.Tab(None, participant), request))

    age = {"do": "answer", "step": 0, "question": "age", "value": 30}
    with pytest.raises(InputError, match="the researcher's page only shows the study"):
        ask(None, **age)
    ask(0, **age)
    assert shown == [0] and not answers.all_answers()
    ask(0, do="consent")
    ask(0, **age | {"step": 1})
    assert shown == [0] * 3 and not answers.all_answers()
    ask(0, **age)
    assert [(row["question"], row["value"]) for row in answers.all_answers()] == [("age", 30)]
    ask(0, do="done", step=0)
    question = answers.steps(0)[1].questions[0]
    with pytest.raises(InputError, match="does not belong to this page"):
        ask(0, do="answer", step=1, question=question["name"], value=reply(question, np.random.default_rng(0)))
    assert len(answers.all_answers()) == 1
    answers.close()


def tab_of(link, origin=None):
    base, query = link.split("/?")
    return connect(f"{base.replace('http', 'ws')}/socket?{query}", origin=origin or base, compression=None)


async def send(tab, word, **more):
    await tab.send(json.dumps({"do": word, **more}))


async def take_part(link, draw, sent, stop_after=None):
    """Go through a study; ``sent`` gets each answer that the server has confirmed."""
    async with tab_of(link) as tab:
        page = await until(tab, "consent", "step", "end")
        if page["kind"] == "consent":
            await send(tab, "consent")
            page = await until(tab, "step")
        while page["kind"] == "step":
            number = page["number"]
            if not page["shown"] and page["what"] == "drive":
                assert page["rules"] == {"limit": 1.5, "hold": 5.0}  # s
                await send(tab, "start", step=number)
                await until(tab, "go")
                driving = asyncio.ensure_future(until(tab, "over"))
                while not driving.done():
                    await send(tab, "command", ahead=float(draw.uniform(-1, 1)), left=float(draw.uniform(-1, 1)))
                    await asyncio.sleep(0.05)
                assert driving.result()["content"] in ("completed", "timed out")
            elif not page["shown"]:
                await send(tab, "began", step=number)
                await send(tab, "shown", step=number)
                while (news := await until(tab, "shown", "early"))["kind"] == "early":
                    await asyncio.sleep(news["content"])
                    await send(tab, "shown", step=number)
            for question in page["questions"]:
                value = reply(question, draw)
                await send(tab, "answer", step=number, question=question["name"], value=value)
                assert (await until(tab, "stored", "error"))["kind"] == "stored"
                sent[number, question["name"]] = value
                if stop_after is not None and len(sent) >= stop_after:
                    return page
            await send(tab, "done", step=number)
            page = await until(tab, "step", "end")
        return page


@pytest.mark.night
def test_links_open_the_own_page_alone(served):
    mine, researcher = served.links()[0], served.researcher_link
    base, secret = mine.split("/?participant=")
    assert get(mine) == get(researcher) == (200, "<p>the page</p>")
    for wrong in ("participant=no", f"participant={secret[:-1]}", f"researcher={secret}", f"token={secret}"):
        assert get(f"{base}/?{wrong}")[0] == 403
    assert get(base)[0] == 403
    assert get(mine, Host="evil.example")[0] == 403
    for name in export.TABLES:
        assert get(f"{base}/{name}?participant={secret}")[0] == 404
        status, text = get(f"{base}/{name}?{researcher.split('?')[1]}")
        assert status == 200 and (name != "participants.csv" or len(list(csv.DictReader(io.StringIO(text)))) == 60)

    async def refused(link, **more):
        with pytest.raises(InvalidStatus) as raised:
            await tab_of(link, **more).__aenter__()
        return raised.value.response.status_code

    async def sockets():
        assert await refused(mine, origin="http://evil.example") == 403
        assert await refused(f"{base}/?participant=wrong") == 403

    asyncio.run(sockets())


def test_a_page_has_nothing_of_policies_metrics_and_others(served):
    """Also not in the recordings that it plays."""

    async def go():
        async with tab_of(served.links()[1]) as tab:
            texts = [await tab.recv()]
            await send(tab, "consent")
            texts.append(await tab.recv())
            return texts

    texts = "".join(asyncio.run(go()))
    secrets = served.answers.secrets()
    for private in ("go_to_goal", "expert", "policy", "intimate", "lab", "kuri", *list(secrets.values())):
        assert private not in texts.replace("Robots in a lab", ""), private
    for place in served.answers.episodes():
        text = json.dumps(content := served.answers.film(*place))
        assert "go_to_goal" not in text and "expert" not in text and content["situations"] == content["curves"] == []


def test_a_reload_goes_on_and_a_second_tab_takes_over(served):
    link, sent, draw = served.links()[2], {}, np.random.default_rng(2)

    async def go():
        stopped = await take_part(link, draw, sent, stop_after=4)
        async with tab_of(link) as one:
            page = await until(one, "step")
            assert page["number"] == stopped["number"] and page["shown"] == (page["what"] != "drive")
            assert page["answers"] == {
                name: value for (number, name), value in sent.items() if number == page["number"]
            }
            await send(one, "answer", step=page["number"] + 1, question="easy", value=1)  # of a page that is ahead
            assert (await until(one, "step"))["number"] == page["number"]
            await send(one, "done", step=page["number"])
            assert (await until(one, "missing"))["content"]
            for bad in ("x", "[]", '{"do": 3}', '{"do": "fly"}', b"\x00"):
                await one.send(bad)
                assert (await until(one, "error", "step"))["kind"]
            async with tab_of(link) as two:
                assert (await until(two, "step"))["number"] == page["number"]
                with pytest.raises(ConnectionClosed) as raised:
                    while True:
                        await asyncio.wait_for(one.recv(), 10)
                assert raised.value.rcvd.code == server.REPLACED
        return await take_part(link, draw, sent)

    assert asyncio.run(go())["kind"] == "end"
    stored = {(row["step"], row["question"]): row["value"] for row in served.answers.all_answers()
              if row["participant"] == 2}  # fmt: skip
    assert stored == sent


def test_a_drive_that_is_broken_off_begins_anew_and_can_be_simulated_again(served):
    number = 3
    steps = served.study.steps(number)
    link, sent, draw = served.links()[number], {}, np.random.default_rng(3)
    place = next(k for k, step in enumerate(steps) if step.kind == "drive")

    async def go():
        before = sum(len(step.questions) for step in steps[:place])
        await take_part(link, draw, sent, stop_after=before)
        async with tab_of(link) as tab:
            page = await until(tab, "step")
            await send(tab, "done", step=page["number"])
            assert (await until(tab, "step"))["what"] == "drive"
            await send(tab, "start", step=place)
            await until(tab, "go")
            for _ in range(6):
                await send(tab, "command", ahead=1.0, left=0.2)
                await until(tab, "frames")
        return await take_part(link, draw, sent)

    assert asyncio.run(go())["kind"] == "end"
    first, second = (row for row in served.answers.drives() if row["participant"] == number)
    assert first["outcome"] == BROKEN_OFF and first["metrics"] is None and len(served.answers.moments(first["id"])) >= 5
    assert second["outcome"] == "timed out" and second["metrics"]["seconds"] == pytest.approx(1.5)
    moments = np.array(served.answers.moments(second["id"]))
    assert moments.shape == (15, 5) and np.ptp(moments[:, 0]) > 0
    session = served._session(steps[place].trial)
    for row in moments:
        session._advance(jnp.asarray(row[:2]))
    np.testing.assert_allclose(np.asarray(session.state.robot.position), moments[-1, 2:4], atol=1e-4)
    assert session.metrics() == second["metrics"]
    assert served.answers.recording(second["id"])["episodes"][0]["frames"] == 16


def test_drivers_wait_for_a_place(served, monkeypatch):
    monkeypatch.setattr(served, "_places", asyncio.Semaphore(1))
    numbers = 57, 59
    places = [[step.kind for step in served.study.steps(number)].index("drive") for number in numbers]
    for number, place in zip(numbers, places, strict=True):  # as if all before it were answered
        served.answers.consent(number)
        for step in range(place):
            served.answers.finish(number, step, False)

    async def go():
        async with tab_of(served.links()[numbers[1]]) as two:
            async with tab_of(served.links()[numbers[0]]) as one:
                await send(one, "start", step=places[0])
                await until(one, "go")
                await send(two, "start", step=places[1])
                assert (await until(two, "wait", "go"))["content"] == server.WAIT
            assert (await until(two, "go"))["content"] == 0.1  # the first page is closed

    asyncio.run(go())


def test_an_answer_that_cannot_be_stored_is_not_confirmed(served, monkeypatch):
    def full(*_):
        raise WriteError("study.sqlite: cannot be written: the disk is full; free some space.")

    async def go():
        async with tab_of(served.links()[58]) as tab:
            await send(tab, "consent")
            page = await until(tab, "step")
            monkeypatch.setattr(served.answers, "answer", full)
            await send(tab, "answer", step=page["number"], question="age", value=20)
            assert (await until(tab, "stored", "error"))["content"] == server.NOT_STORED
            monkeypatch.undo()
            await send(tab, "answer", step=page["number"], question="age", value=21)
            assert (await until(tab, "stored", "error"))["kind"] == "stored"

    asyncio.run(go())


def test_too_many_and_too_large_messages_close_the_tab(served):
    async def go():
        for count, text in ((1000, '{"do": "command", "ahead": 0, "left": 0}'), (1, "x" * 1_000_000)):
            async with tab_of(served.links()[4]) as tab:
                with pytest.raises(ConnectionClosed):
                    for _ in range(count):
                        await tab.send(text)
                    while True:
                        await asyncio.wait_for(tab.recv(), 20)
        async with tab_of(served.links()[4]) as tab:
            await until(tab, "consent")

    asyncio.run(go())


def test_the_researcher_sees_progress(served):
    async def go():
        async with tab_of(served.researcher_link) as page, tab_of(served.links()[5]) as tab:
            assert (await until(page, "study"))["links"] == served.links()
            await send(page, "consent")
            assert "only shows the study" in (await until(page, "error"))["content"]
            await send(tab, "consent")
            while True:
                row = (await until(page, "progress"))["content"][5]
                if row["consented"]:
                    return row

    row = asyncio.run(go())
    assert row["open"] and not row["finished"] and (row["done"], row["steps"]) == (0, 5)


@pytest.mark.parametrize("numbers", slow([range(6, 16), range(16, 60)], range(6, 16)))
def test_many_participants_lose_nothing(served, numbers):
    """At once, with more drivers than places."""
    sent = {number: {} for number in numbers}

    async def go():
        links = served.links()
        parts = [take_part(links[k], np.random.default_rng(k), sent[k]) for k in numbers]
        return await asyncio.wait_for(asyncio.gather(*parts), 400)

    assert all(page["kind"] == "end" for page in asyncio.run(go()))
    stored = {number: {} for number in numbers}
    for row in served.answers.all_answers():
        if row["participant"] in stored:
            stored[row["participant"]][row["step"], row["question"]] = row["value"]
    assert stored == sent and {len(each) for each in sent.values()} == {14}
    drives = [row for row in served.answers.drives() if row["participant"] in stored]
    assert len(drives) == len(numbers) and all(len(served.answers.moments(row["id"])) == 15 for row in drives)
    rows = [row for row in export.participants(served.answers) if row["participant"] - 1 in stored]
    assert all(row["finished"] for row in rows)


# ------------------------------------------------------------------ tables and report


def simulated(folder, participants=24, seed=0):
    """A file with answers that follow one metric of four episodes, and one rating of chance."""
    text = STUDY.split("questions:")[0].replace("participants: 60", f"participants: {participants}")
    trials = "".join(f"\n  - {{name: t{k}, watch: {{seed: {k}}}}}" for k in range(6))
    questions = "[{kind: likert, name: near, text: Near it., points: 11}, {kind: likert, name: luck, text: Luck.}]"
    answers = Answers.begin(folder, read(folder, f"{text}questions: {questions}\ntrials:{trials}\n"))
    draw = np.random.default_rng(seed)
    for k in range(6):
        answers.add_episode(k, 0, "go_to_goal", "completed", {"path_length": float(k), "min_distance": 1.0}, FILM)
    for number in range(participants):
        offset = draw.normal(0, 1.5)
        for place, step in enumerate(answers.study.steps(number)):
            near = int(np.clip(round(3 + step.trial + offset + draw.normal(0, 0.7)), 1, 11))
            answers.show(number, place)
            answers.answer(number, place, "near", near)
            answers.answer(number, place, "luck", int(draw.integers(1, 8)))
            answers.finish(number, place, place == 5)
    return answers


def test_ratings_join_metrics(tmp_path, capsys):
    answers = simulated(tmp_path)
    rows = report.rated(answers)
    assert len(rows) == 24 * 6
    found = {(each.rating, each.metric): each for each in report.correlations(rows)}
    assert set(found) == {("near", "path_length"), ("luck", "path_length")}  # a constant metric has none
    for (rating, metric), each in found.items():
        pairs = [(row["ratings"][rating], row["metrics"][metric]) for row in rows]
        assert each.value == pytest.approx(scipy.stats.spearmanr(*zip(*pairs, strict=True)).statistic)
        assert each.low < each.value < each.high and (each.pairs, each.participants) == (144, 24)
    assert found["near", "path_length"].p < 0.001 and found["near", "path_length"].low > 0.4
    assert found["luck", "path_length"].p > 0.05
    for each in report.means(rows):
        values = [row["ratings"][each.rating] for row in rows if row["trial"] == each.trial]
        assert each.value == pytest.approx(np.mean(values)) and each.low <= each.value <= each.high
    answers.close()
    assert command_line.main(["survey", "report", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "2 correlations were computed" in " ".join(printed.split())
    assert "after Holm's correction" in html.unescape((tmp_path / "report.html").read_text())
    assert command_line.main(["survey", "export", str(tmp_path)]) == 0
    table = list(csv.DictReader((tmp_path / "tables" / "answers.csv").open()))
    assert len(table) == 24 * 6 * 2 and {row["kind"] for row in table} == {"likert"}


def test_participants_are_the_units_of_the_interval():
    """Equal trials of a participant, many times, do not make the interval narrower."""
    draw = np.random.default_rng(1)
    rows = [{"participant": k, "trial": "one", "ratings": {"a": draw.normal()}, "metrics": {"b": draw.normal()}}
            for k in range(20)]  # fmt: skip
    (one,), (many,) = report.correlations(rows), report.correlations(rows * 9)
    assert many.pairs == 9 * one.pairs and many.high - many.low == pytest.approx(one.high - one.low, rel=0.05)


@pytest.mark.parametrize("seed", range(8))
def test_weighted_correlations_are_those_of_repeated_pairs(seed):
    draw = np.random.default_rng(seed)
    one, other = draw.integers(1, 8, 30).astype(float), draw.normal(size=30).round(1)
    weights = draw.integers(0, 4, (5, 30))
    for row, value in zip(weights, report.spearman(one, other, weights), strict=True):
        expected = scipy.stats.spearmanr(np.repeat(one, row), np.repeat(other, row)).statistic
        assert value == pytest.approx(expected, abs=1e-9)


def test_choices_have_shares(served):
    for each in report.preferences(served.answers):
        assert each.policies == ("go_to_goal", "expert") and 0.0 <= each.low <= each.value <= each.high <= 1.0
    rows = [row for row in export.trials(served.answers) if row["kind"] == "choose" and row["chosen"] != ""]
    assert rows and all(a["chosen"] + b["chosen"] == 1 for a, b in zip(rows[::2], rows[1::2], strict=True))
    step = {row["participant"]: served.study.steps(row["participant"] - 1)[row["place"] - 1] for row in rows}
    answers = [row for row in export.answers_table(served.answers) if row["question"] == "choice"]
    values = {row["participant"]: row["value"] for row in answers}
    for first in rows[::2]:  # of the file's first episode, which is on the right if swapped
        side = "B" if step[first["participant"]].swapped else "A"
        assert first["chosen"] == (values[first["participant"]] == side)


def test_a_study_without_ratings_has_no_report(tmp_path):
    answers = Answers.begin(tmp_path, read(tmp_path))
    with pytest.raises(InputError, match="has no ratings yet"):
        report.run(answers, SurveyReportConfig(folder=tmp_path), Console(quiet=True))


def test_formulas_of_participants_stay_text():
    formulas = ["=1+1", "@x", "+1", "-1", "\n=1+1", " =1+1", "\t=1", "\r\n+1", "\uff1d1+1", "\u3000\uff20x", "\ufeff=1",
                "\u00a0-1", "\tx", "'=1"[1:]]  # fmt: skip
    assert [export._guarded(value) for value in formulas] == [f"'{value}" for value in formulas]
    plain = ["plain", -3, 2.5, "", " ", "a=1", "1+1", "\u00fc", "'=1"]
    assert [export._guarded(value) for value in plain] == plain


# ------------------------------------------------------------------ the command


def start(folder):
    """`sean studio --survey` in a process of its own, and the links that it prints."""
    words = [sys.executable, "-u", "-m", "sean_jax", "studio", "--survey", "study.yaml", "--out", "out"]
    process = subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                               env=os.environ)  # fmt: skip
    links = []
    for line in process.stdout:
        if found := re.search(r"(participant \d+|researcher): (\S+)", line):
            links.append(found.group(2))
        if "researcher: " in line:
            return process, links
    raise AssertionError("it ended")


@pytest.mark.night
def test_a_killed_study_loses_no_stored_answer(tmp_path):
    """kill -9 while six participants answer and drive; the same links go on."""
    read(tmp_path)
    process, links = start(tmp_path)
    sent = [{} for _ in range(6)]

    async def go():
        parts = [asyncio.ensure_future(take_part(links[k], np.random.default_rng(k), sent[k])) for k in range(6)]
        while sum(map(len, sent)) < 40:
            await asyncio.sleep(0.01)
        process.send_signal(signal.SIGKILL)
        await asyncio.gather(*parts, return_exceptions=True)

    asyncio.run(go())
    process.wait(10)
    answers = Answers(tmp_path / "out" / FILE)
    for number, values in enumerate(sent):
        steps = {step for step, _ in values}
        stored = {(step, name): value for step in steps for name, value in answers.answers_of(number, step).items()}
        assert values.items() <= stored.items()
    answers.close()
    process, again = start(tmp_path)
    assert again == links
    assert asyncio.run(take_part(again[0], np.random.default_rng(9), {}))["kind"] == "end"
    process.terminate()
    process.communicate(timeout=60)
    assert process.returncode == 0


@pytest.mark.web
@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "width"), [("light", "1100"), ("dark", "420")])
def test_a_browser_goes_through_a_study(tmp_path, scheme, width):
    """Watch, drive, choose, answer, reload; without serious findings of axe and without another address."""
    chromium()
    read(tmp_path, STUDY.replace("time_limit: 1.5", "time_limit: 8"))
    process, links = start(tmp_path)
    try:
        seen = json.loads(browse("test/survey.mjs", links[0], tmp_path, scheme, width))
    finally:
        process.terminate()
        process.communicate(timeout=120)
    assert seen["errors"] == seen["findings"] == seen["wide"] == []
    assert set(seen["hosts"]) == {links[0].split("/")[2]}
    assert seen["steps"] == 5 and seen["kept"] == "33" and "no answer yet" in seen["missing"]
    assert seen["early"] == "One moment, please."  # a film that was played at 16 times its speed
    assert seen["rules"] == (
        "You have 8 seconds. The drive ends when the robot has stayed at the goal for 5 seconds without a break, "
        "or when the time is over."
    )
    assert seen["outcomes"] == ["The time is over."] and seen["broken"] > 5
    drives = Answers(tmp_path / "out" / FILE).drives()
    assert [row["outcome"] for row in drives] == [BROKEN_OFF, "timed out"]


def test_the_page_has_its_program():
    assert (pages.PACKAGE / "studies/survey/page.min.js").stat().st_size < 60_000
    assert validate(StudioConfig, {"survey": "a.yaml", "out": "b"}).survey == Path("a.yaml")


# ------------------------------------------------------------------ a file that is damaged, full or made to do harm


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """The folder of a study in which one participant has watched, driven, chosen and answered."""
    folder = tmp_path_factory.mktemp("original")
    answers = Answers.begin(folder, read(folder))
    for trial, side in ((0, 0), (2, 0), (2, 1)):
        answers.add_episode(trial, side, "expert", "completed", {"path_length": 3.0}, FILM)
    answers.consent(0)
    for place, step in enumerate(answers.steps(0)):
        answers.event(0, f"page {place}")
        answers.show(0, place)
        if step.kind == "drive":
            drive = answers.begin_drive(0, place)
            answers.add_moments(drive, 0, [[0.5, 0.1, 1.0, 2.0, 0.3]] * 10)
            answers.end_drive(drive, "timed out", {"path_length": 3.0})
        for question in step.questions:
            answers.answer(0, place, question["name"], reply(question, np.random.default_rng(place)))
        answers.finish(0, place, place == 4)
    answers.close()
    change(folder)
    return folder


def damaged(original, folder, *statements):
    shutil.copy(original / FILE, folder / FILE)
    change(folder, *statements)
    return folder


DAMAGES = {
    "a word for a time": ("UPDATE answers SET time = 'x'", "table participants: seen: 'x' is not a number"),
    "no time at all": ("UPDATE drives SET began = 9e999", "table drives: began: inf is more than"),
    "bytes for a text": ("UPDATE answers SET value = x'00ff'", "table answers: value: "),
    "no JSON": ("UPDATE answers SET value = '{'", "table answers: value: '{' is not JSON"),
    "a number of 400 digits": (f"UPDATE answers SET value = '{'9' * 400}'", "table answers: value: .*is not JSON"),
    "brackets": (f"UPDATE answers SET value = '{'[' * 5000}'", "table answers: value: .*is not JSON"),
    "an answer of another kind": ("UPDATE answers SET value = '99'", "table answers: .*is no answer|must be from"),
    "another participant": ("UPDATE answers SET participant = 60", "no page 1 of participant 61"),
    "a negative page": ("UPDATE steps SET step = -1 WHERE step = 0", "table steps: step: -1 is less than 0"),
    "a page too far": ("UPDATE steps SET step = 99 WHERE step = 0", "no page 100 of participant 1"),
    "a drive of no drive": ("UPDATE drives SET step = 0", "table drives: page 1 of participant 1 is none"),
    "a missing trial": ("DELETE FROM episodes WHERE trial = 0", "there is no episode 1 of the trial 'calm'"),
    "metrics of words": ("""UPDATE episodes SET metrics = '{"a": "b"}'""", "table episodes: metrics"),
    "an endless film": ("UPDATE episodes SET recording = '{}'", "recording of trial 1 has no frames"),
    "moments of two numbers": ("UPDATE moments SET moments = '[[1, 2]]'", "table moments: moments"),
    "infinite moments": ("UPDATE moments SET moments = '[[1, 2, 3, 4, 1e999]]'", "table moments: moments"),
    "fewer participants": ("DELETE FROM participants WHERE id = 3", "does not hold 60 participants"),
    "an event of no kind": ("UPDATE events SET what = 'page x'", "table events: what"),
    "a port that is none": ("INSERT OR REPLACE INTO study VALUES ('port', '65536')", "table study: is not what"),
    "another version": ("UPDATE study SET value = '9' WHERE name = 'version'", "has version 9 of the format, not 1"),
    "no link of the researcher": ("UPDATE study SET value = '' WHERE name = 'researcher'", "table study: is not what"),
    "no study": ("UPDATE study SET value = '{}' WHERE name = 'study'", "table study: is not what this program writes"),
    "an unknown questionnaire": (
        """UPDATE study SET value = replace(value, '"navigation"', '"nothing"') WHERE name = 'study'""",
        "table study: 'nothing' is not one of rosas",
    ),
    "a missing table": ("DROP TABLE moments", "its tables are not those"),
    "a trigger": (
        "CREATE TRIGGER t AFTER INSERT ON answers BEGIN DELETE FROM answers; END",
        "its tables are not those",
    ),
    "an endless view": (
        "DROP TABLE answers; CREATE VIEW answers AS WITH RECURSIVE n(participant) AS "
        "(SELECT 1 UNION ALL SELECT participant FROM n) SELECT participant FROM n",
        "its tables are not those",
    ),
    "an index in another's place": (
        "UPDATE sqlite_master SET rootpage = "
        "(SELECT rootpage FROM sqlite_master WHERE name = 'sqlite_autoindex_steps_1')"
        " WHERE name = 'sqlite_autoindex_answers_1'",
        "it is damaged; restore the file from a copy",
    ),
    "a table in another's place": (
        "UPDATE sqlite_master SET rootpage = (SELECT rootpage FROM sqlite_master WHERE name = 'steps') "
        "WHERE name = 'answers'",
        "it is damaged; restore the file from a copy",
    ),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_study_is_refused_in_a_sentence(original, tmp_path, capfd, name):
    statements, message = DAMAGES[name]
    damaged(original, tmp_path, *statements.split("; " if "VIEW" in statements else "\0"))
    assert command_line.main(["survey", "export", str(tmp_path)]) == 2
    said = capfd.readouterr().err
    assert re.search(message, said) and "study.sqlite: " in said and "Traceback" not in said, said
    *lines, last = said.strip().splitlines()
    if lines:  # some tables are written; of the others, each cause has a sentence
        assert all("study.sqlite: " in line for line in lines)
        written = {file.name for file in (tmp_path / "tables").iterdir()}
        assert last.startswith(f"The other files, {len(written)}, are written to")
        assert not any(name in line for name in written for line in lines)
    else:
        assert not (tmp_path / "tables").exists()


def test_an_unchanged_study_is_exported(original, tmp_path):
    assert command_line.main(["survey", "export", str(damaged(original, tmp_path))]) == 0
    rows = list(csv.DictReader((tmp_path / "tables" / "pages.csv").open()))
    assert len(rows) == 5 and {row["reloads"] for row in rows} == {"0"}
    drive = next(row for row in csv.DictReader((tmp_path / "tables" / "trials.csv").open()) if row["kind"] == "drive")
    assert drive["began"] <= drive["ended"] != ""


def test_one_faulty_table_keeps_no_other_from_being_written(original, tmp_path, capfd):
    damaged(original, tmp_path, "UPDATE moments SET moments = '[[1, 2]]'")
    assert command_line.main(["survey", "export", str(tmp_path)]) == 2
    tables = tmp_path / "tables"
    assert {file.name for file in tables.iterdir()} == {*export.TABLES} - {"trajectories.csv"}
    said = capfd.readouterr().err
    assert "trajectories.csv: not written: " in said and "participants.csv" not in said
    (tables / "answers.csv").unlink()
    (tables / "answers.csv").mkdir()
    (tables / "pages.csv").unlink()
    damaged(original, tmp_path)
    assert command_line.main(["survey", "export", str(tmp_path)]) == 2
    said = capfd.readouterr().err
    assert "answers.csv is a folder; remove it" in said and "The other files, 4, are written to" in said
    assert "nothing was written" not in said and (tables / "pages.csv").is_file()


@pytest.mark.parametrize("link", ["tables", "tables/drives"])
def test_no_table_is_written_through_a_link(original, tmp_path, link, capfd):
    """A folder that somebody sent may lead elsewhere."""
    (tmp_path / "out").mkdir()
    (tmp_path / "study").mkdir()
    film = json.dumps(FILM | {"situations": [], "curves": []})
    folder = damaged(original, tmp_path / "study", f"UPDATE drives SET recording = '{film}'")
    (folder / link).parent.mkdir(exist_ok=True)
    (folder / link).symlink_to(tmp_path / "out")
    assert command_line.main(["survey", "export", str(folder)]) == 2
    said = capfd.readouterr().err
    assert "is a link, through which nothing is written; remove it" in " ".join(said.split())
    assert not list((tmp_path / "out").iterdir())


def test_a_large_film_is_neither_read_nor_written(original, tmp_path, capfd):
    """Parsed JSON takes 40 times the memory of its text."""
    large, many = (json.dumps(FILM | {"more": [[]] * count}) for count in (4_000_000, 300_000))
    causes = {large: "bytes and at most 8,000,000 are read", many: "values and at most 500,000 are read"}
    for text, message in causes.items():
        folder = tmp_path / str(len(text))
        folder.mkdir()
        shutil.copy(original / FILE, folder / FILE)
        with contextlib.closing(sqlite3.connect(folder / FILE)) as base:
            base.execute("UPDATE episodes SET recording = ?", (text,))
            base.commit()
        tracemalloc.start()
        assert command_line.main(["survey", "export", str(folder)]) == 2
        assert tracemalloc.get_traced_memory()[1] < 100_000_000
        tracemalloc.stop()
        said = capfd.readouterr().err
        assert message in said and (folder / "tables" / "answers.csv").is_file()
        answers = Answers(original / FILE)
        with pytest.raises(InputError, match="the film of 'calm' has .*; choose a shorter time_limit"):
            answers.add_episode(0, 0, "expert", "completed", {}, json.loads(many))
        answers.close()


@pytest.mark.parametrize("stored", ['"\\ud83d"', '"a\\ud83db"', b'"\xed\xa0\xbd"'])
def test_half_a_surrogate_is_exported(original, tmp_path, stored):
    cell = f"CAST(x'{stored.hex()}' AS TEXT)" if isinstance(stored, bytes) else f"'{stored}'"
    damaged(original, tmp_path, f"UPDATE answers SET value = {cell} WHERE question = 'why'")
    assert command_line.main(["survey", "export", str(tmp_path)]) == 0
    rows = list(csv.DictReader((tmp_path / "tables" / "answers.csv").open(encoding="utf-8")))
    (value,) = (row["value"] for row in rows if row["question"] == "why")
    assert "\\ud83d" in value if isinstance(stored, str) else "\N{REPLACEMENT CHARACTER}" in value
    answers = Answers(tmp_path / FILE)
    assert "why" in export.table(answers, "answers.csv").encode().decode()  # as the researcher's page gets it
    assert report.rated(answers)
    answers.close()


def test_a_file_holds_half_a_surrogate_as_it_is_written_in_json(tmp_path):
    writing.write(tmp_path / "a.txt", "a \ud83d b")
    assert (tmp_path / "a.txt").read_text() == "a \\ud83d b"


@pytest.mark.parametrize("text", ["\ud83d", "a\udc00b", "\x00", "\x1b[2J", "\x85", "x\x7f"])
def test_text_that_no_file_can_hold_is_refused(text):
    with pytest.raises(InputError, match=r"^why: character [0-9a-f]{4} cannot be stored; type the text again\.$"):
        study.checked({"kind": "text", "name": "why"}, text)
    for good in ("two\nlines\tand\r\nmore", "ü 漢字 🤖 e\u0301"):
        assert study.checked({"kind": "text", "name": "why"}, good) == good


@contextlib.contextmanager
def full_disk(size):
    """No file may become larger than so many bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("size", [0, 4096, 20_000])
def test_a_full_disk_at_the_start_is_one_sentence_and_leaves_nothing(tmp_path, size):
    made = read(tmp_path)
    (tmp_path / "out").mkdir()
    with full_disk(size), pytest.raises(WriteError, match=r"study.sqlite: cannot be written: the disk is full.*; free"):
        Answers.begin(tmp_path / "out", made)
    assert not list((tmp_path / "out").iterdir())


def test_a_full_disk_keeps_what_was_confirmed(tmp_path):
    answers = Answers.begin(tmp_path, read(tmp_path))
    confirmed = {}
    with full_disk(150_000), pytest.raises(WriteError, match="disk is full"):
        for number in range(60):
            answers.answer(number, 4, "car", "often")
            answers.answer(number, 2, "why", "x" * 2000)
            confirmed[number] = "often"
    answers.answer(59, 4, "car", "never")  # there is room again
    answers.close()
    answers = Answers(tmp_path / FILE)
    stored = {row["participant"]: row["value"] for row in answers.all_answers() if row["question"] == "car"}
    assert len(confirmed) > 5 and {**confirmed, 59: "never"}.items() <= stored.items()
    answers.close()


def test_half_a_transaction_is_none(original, tmp_path):
    answers = Answers(damaged(original, tmp_path) / FILE)
    with pytest.raises(ZeroDivisionError), answers._base.transaction() as execute:
        execute("DELETE FROM answers")
        _ = 1 / 0
    answers.answer(1, 4, "car", "never")
    assert len(answers.all_answers()) == 13 + 1 + 1
    answers.close()


def test_only_the_owner_may_read_a_study(tmp_path, monkeypatch):
    """It holds everybody's link; a copy that others can read becomes private, too."""
    read(tmp_path)
    permissions = {}

    def serve(config, answers, console):
        answers.consent(0)
        permissions.update({path.name: path.stat().st_mode & 0o777 for path in (tmp_path / "out").iterdir()})

    monkeypatch.setattr(survey, "_serve", serve)
    config = validate(StudioConfig, {"survey": str(tmp_path / "study.yaml"), "out": str(tmp_path / "out")})
    before = os.umask(0o022)
    try:
        for _ in "ab":
            survey.run(config, Console(quiet=True))
            assert (tmp_path / "out").stat().st_mode & 0o777 == 0o700
            assert {permissions[name] for name in permissions if name.startswith(FILE)} == {0o600}
            assert {FILE, f"{FILE}-wal"} <= permissions.keys()
            (tmp_path / "out" / FILE).chmod(0o644)
    finally:
        os.umask(before)


def test_no_device_is_opened_for_a_study(tmp_path):
    os.mkfifo(tmp_path / FILE)
    with pytest.raises(FileError, match="is no regular file"):
        Answers(tmp_path / FILE)


# ------------------------------------------------------------------ attention


def test_visits_are_told_from_events():
    """Open, hidden and watched are counted by the times of the events alone."""
    events = [(0.0, "opened"), (0.0, "page 0"), (3.0, "began 0"), (5.0, "hidden"), (15.0, "visible"), (16.0, "early 0"),
              (17.0, "closed"), (27.0, "page 0"), (28.0, "began 0"), (29.0, "shown 0"), (30.0, "page 1"),
              (31.0, "closed")]  # fmt: skip
    first, second = visits.visits(events, now=100.0).values()
    assert (first.opened, first.began, first.dwell, first.hidden) == (0.0, 3.0, 20.0, 10.0)
    assert (first.watched, first.reloads, first.early) == (5.0, 1, 1), "neither hidden nor closed, and from began on"
    assert (second.opened, second.began, second.dwell, second.watched) == (30.0, None, 1.0, 0.0)
    back = [(100.0, "page 0"), (100.0, "began 0"), (40.0, "visible")]  # a clock that is set back adds nothing
    assert visits.visits(back, now=42.0)[0].watched == 2.0


@pytest.mark.parametrize(
    ("events", "watched"),
    [
        ([(4, "closed"), (12, "opened"), (12, "page 0")], 4),  # a film stands while its tab is closed
        ([(4, "closed"), (7, "opened"), (7, "page 0"), (7, "began 0")], 16),  # the connection was lost for 3 s
        ([(4, "closed"), (5, "page 0"), (6, "closed"), (7, "opened"), (7, "page 0"), (7, "began 0")], 16),
        ([(4, "closed"), (7, "opened"), (7, "page 0")], 4),  # and the page is another one
        ([(4, "closed"), (12, "opened"), (12, "page 0"), (12, "began 0")], 8),
        ([(3, "hidden"), (4, "closed"), (6, "opened"), (6, "page 0"), (6, "began 0")], 13),
        ([(4, "closed"), (6, "opened"), (6, "page 0"), (6, "hidden"), (6, "began 0")], 4),
        ([(12, "opened"), (12, "page 0"), (13, "began 0")], 3),  # the server was killed
        ([(1, "early 0"), (2, "opened"), (2, "page 0"), (2, "began 0")], 15),
        ([(4, "page 0"), (6, "began 0"), (8, "shown 0"), (9, "began 0")], 6),  # nothing after its end
    ],
)  # fmt: skip
def test_a_film_stands_while_its_tab_is_closed(events, watched):
    """But for a few seconds in which the connection was lost."""
    found = visits.visits([(0, "opened"), (0, "page 0"), (0, "began 0"), *events], now=16)[0]
    assert found.watched == pytest.approx(watched)


def test_the_time_that_a_server_was_down_is_none():
    """A killed one notes no end: a page was open until the last event."""
    events = [(0, "opened"), (0, "page 0"), (3, "began 0"), (25, "opened"), (25, "page 0"), (27, "closed")]
    found = visits.visits(events)[0]
    assert (found.dwell, found.reloads, found.watched) == (5, 1, 0)
    events = [(0, "opened"), (0, "page 0"), (3, "hidden"), (25, "opened"), (25, "page 0"), (27, "began 0")]
    found = visits.visits([*events, (28, "closed")])[0]
    assert (found.dwell, found.hidden, found.watched) == (6, 0, 1)


def test_a_hidden_tab_stays_hidden_on_the_next_page():
    """Pages say when this changes, and nothing at a page that follows."""
    events = [(0, "opened"), (0, "page 0"), (1, "hidden"), (2, "page 1"), (2, "began 1"), (9, "visible")]
    second = visits.visits([*events, (11, "closed")])[1]
    assert (second.dwell, second.hidden, second.watched) == (9, 7, 2)


def watching(served, number):
    """The link of a participant who is about to watch, and the number of the page."""
    place = next(k for k, step in enumerate(served.study.steps(number)) if step.kind == "watch")
    served.answers.consent(number)
    for step in range(place):
        served.answers.finish(number, step, False)
    return served.links()[number], place


def test_a_film_is_not_watched_before_its_end(served, monkeypatch):
    """Neither at once nor a second too early, nor in a hidden tab; a reload in between changes nothing."""
    link, place = watching(served, 40)
    seconds = 1.5
    monkeypatch.setattr(served, "_lengths", dict.fromkeys(served._lengths, seconds + server.TOLERANCE))

    async def go():
        async with tab_of(link) as tab:
            await until(tab, "step")
            for _ in range(3):  # it has not even begun
                await send(tab, "shown", step=place)
                assert (await until(tab, "early", "shown"))["content"] == pytest.approx(seconds, abs=0.3)
            await send(tab, "answer", step=place, question="navigation.safe", value=3)
            assert "does not belong" in (await until(tab, "stored", "error"))["content"]
            await send(tab, "began", step=place)
            await send(tab, "shown", step=place)
            assert (await until(tab, "early", "shown"))["kind"] == "early"
            await send(tab, "hidden")
            await asyncio.sleep(1.0)
            await send(tab, "visible")
        async with tab_of(link) as tab:
            await until(tab, "step")
            await send(tab, "began", step=place)
            await send(tab, "shown", step=place)
            left = (await until(tab, "early", "shown"))["content"]
            assert 0.5 < left <= seconds
            await asyncio.sleep(left)
            await send(tab, "shown", step=place)
            assert (await until(tab, "early", "shown"))["kind"] == "shown"

    asyncio.run(go())
    row = next(row for row in export.pages(served.answers) if (row["participant"], row["place"]) == (41, place + 1))
    assert row["opened"] <= row["began"] < row["shown"] and row["film_s"] == pytest.approx(1.5)
    assert seconds <= row["watched_s"] < row["dwell_s"]
    assert row["too_early"] == 5 and row["reloads"] == 1 and 0.9 < row["hidden_s"] < 2.0 <= row["dwell_s"]


def test_a_film_is_not_watched_in_a_closed_or_hidden_tab(served, monkeypatch):
    """Closed for longer than a lost connection; hidden on the page before, which the page says once."""
    link, place = watching(served, 44)
    monkeypatch.setattr(visits, "GRACE", 0.3)
    monkeypatch.setattr(served, "_lengths", dict.fromkeys(served._lengths, 1.0 + server.TOLERANCE))

    async def go():
        async with tab_of(link) as tab:
            await until(tab, "step")
            await send(tab, "began", step=place)
            await send(tab, "hidden")
            await send(tab, "visible")
        await asyncio.sleep(1.5)
        async with tab_of(link) as tab:
            await until(tab, "step")
            await send(tab, "shown", step=place)
            assert (await until(tab, "early", "shown"))["content"] > 0.7
            assert served.answers.watched(44, place) < 0.3
            served.answers.show(44, place)
            served.answers.finish(44, place, False)
            await send(tab, "hidden")
            await send(tab, "done", step=place)  # of the page before
            number = (await until(tab, "step"))["number"]
            await asyncio.sleep(0.3)
            await send(tab, "visible")
            await send(tab, "done", step=place)
            await until(tab, "step")
        return number

    number = asyncio.run(go())
    assert served.answers.all_visits()[44][number].hidden > 0.2


# ------------------------------------------------------------------ hostile messages

HOSTILE = {
    "400 digits": '{"do": "answer", "step": %d, "question": "age", "value": ' + "9" * 400 + "}",
    "400 digits of a step": '{"do": "answer", "step": ' + "9" * 400 + ', "question": "age", "value": 20}',
    "4,000 digits": '{"do": "answer", "step": %d, "question": "age", "value": ' + "9" * 5000 + "}",
    "brackets": "[" * 4000,
    "brackets in a value": '{"do": "answer", "step": %d, "question": "age", "value": ' + "[" * 2000 + "]" * 2000 + "}",
    "infinity": '{"do": "answer", "step": %d, "question": "age", "value": 1e999}',
    "no number": '{"do": "answer", "step": %d, "question": "age", "value": NaN}',
    "a list": '{"do": "answer", "step": %d, "question": ["age"], "value": {}}',
    "a list for a choice": '{"do": "answer", "step": %d, "question": {"a": []}, "value": [1]}',
    "half a character": '{"do": "answer", "step": %d, "question": "\\ud83d", "value": "\\ud83d"}',
    "a command of 400 digits": '{"do": "command", "ahead": ' + "9" * 400 + ', "left": 0}',
    "a page that is not there": '{"do": "began", "step": %d}',
    "no request": '{"do": ["answer"]}',
    "bytes": b"\xff\xfe\x00",
}


def test_hostile_messages_are_one_sentence_and_at_most_one_line(served, capfd):
    """The tab stays, and an answer is stored afterwards."""

    async def go():
        async with tab_of(served.links()[41]) as tab:
            await send(tab, "consent")
            page = await until(tab, "step")
            for name, message in HOSTILE.items():
                text = message.replace("%d", str(page["number"])) if isinstance(message, str) else message
                await tab.send(text)
                news = None
                if "command" not in name:
                    news = await until(tab, "error", "step")
                await send(tab, "answer", step=page["number"], question="age", value=20)
                assert (await until(tab, "stored"))["content"] == "age", (name, news)

    asyncio.run(go())
    said = capfd.readouterr().err
    assert "Traceback" not in said and len(said.splitlines()) <= len(HOSTILE), said


def test_a_page_that_does_not_read_is_closed_without_a_word(served, capfd):
    async def go():
        tab = await tab_of(served.links()[42]).__aenter__()
        tab.transport.pause_reading()
        with contextlib.suppress(ConnectionClosed):
            for _ in range(60):
                for _ in range(90):
                    await send(tab, "done", step=7)
                await asyncio.sleep(0.05)
        tab.transport.abort()
        async with tab_of(served.links()[42]) as again:
            await until(again, "consent")

    asyncio.run(go())
    assert "Traceback" not in capfd.readouterr().err


def test_a_drive_whose_end_cannot_be_stored_says_so(served, monkeypatch, capfd):
    number = 43
    place = [step.kind for step in served.study.steps(number)].index("drive")
    served.answers.consent(number)
    for step in range(place):
        served.answers.finish(number, step, False)

    def full(*_):
        raise WriteError("study.sqlite: cannot be written: the disk is quite full.")

    async def go():
        async with tab_of(served.links()[number]) as tab:
            await send(tab, "start", step=place)
            await until(tab, "go")
            monkeypatch.setattr(served.answers, "end_drive", full)
            assert (await until(tab, "over", "error"))["content"] == server.NOT_STORED

    asyncio.run(go())
    said = capfd.readouterr().err
    assert said == "sean: study.sqlite: cannot be written: the disk is quite full.\n"


def test_a_wrong_link_of_any_bytes_is_refused(served, capfd):
    for path in (b"/?researcher=\xff", b"/?participant=%ff%00", b"/answers.csv?researcher="):
        with socket.create_connection(("127.0.0.1", served.port), timeout=5) as wire:
            wire.sendall(b"GET " + path + b" HTTP/1.1\r\nHost: 127.0.0.1:%d\r\n\r\n" % served.port)
            assert b" 200 " not in wire.recv(1000).partition(b"\r\n")[0]
    assert "Traceback" not in capfd.readouterr().err
