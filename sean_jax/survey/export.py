"""The tables of a study: participants, trials with metrics, answers with scores, and trajectories of drives."""

from __future__ import annotations

import csv
import datetime
import io
import unicodedata
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sean_jax import replay, writing
from sean_jax.survey.answers import Answers
from sean_jax.survey.study import CHOICE, templates

Row = dict[str, Any]
FORMULAS = "=+-@"  # how one begins
LINE_ENDS = "\t\r\n"  # or of a cell
BLANK = "".join(map(chr, range(33))) + "\x7f\x85\xa0\u200b\u2028\u2029\ufeff"  # what may stand before it


def participants(answers: Answers) -> list[Row]:
    """A row for each participant, numbered from 1 on."""
    return [
        {"participant": row["id"] + 1, "consented": _time(row["consented"]), "finished": _time(row["finished"]),
         "steps_done": row["done"], "steps": len(answers.steps(row["id"]))}
        for row in answers.participants()
    ]  # fmt: skip


def pages(answers: Answers) -> list[Row]:
    """A row for each page that a participant has opened: when, and how long it was open and its film in sight."""
    lengths, rows = answers.film_lengths(), list[Row]()
    drives: dict[tuple[int, int], list[Row]] = {}
    for drive in answers.drives():
        drives.setdefault((drive["participant"], drive["step"]), []).append(drive)
    steps = {(row["participant"], row["step"]): row for row in answers.all_steps()}
    for participant, found in answers.all_visits().items():
        for number, visit in sorted(found.items()):
            if number >= len(answers.steps(participant)):
                continue  # the last page, which asks nothing
            step, times = answers.steps(participant)[number], steps.get((participant, number), {})
            driven = drives.get((participant, number), ())
            is_film = step.kind in ("watch", "choose")
            rows.append({
                "participant": participant + 1, "place": number + 1, "trial": step.name, "kind": step.kind,
                "opened": _time(visit.opened),
                "began": _time(driven[0]["began"] if driven else visit.began),
                "shown": _time(times.get("shown")),
                "done": _time(times.get("done")),
                "film_s": _seconds(lengths.get(step.trial)) if is_film and step.trial is not None else "",
                "watched_s": _seconds(visit.watched) if is_film else "",
                "dwell_s": _seconds(visit.dwell),
                "hidden_s": _seconds(visit.hidden),
                "reloads": visit.reloads,
                "too_early": visit.early,
            })  # fmt: skip
    return rows


def trials(answers: Answers) -> list[Row]:
    """A row for each episode of a trial that a participant has watched or driven, with its metrics.

    A trial with a choice has two rows, of which one is ``chosen``. ``drive`` counts the drives of a trial; a drive
    that was broken off has no metrics.
    """
    study, episodes, rows = answers.study, answers.episodes(), list[Row]()
    values = {(each["participant"], each["step"], each["question"]): each["value"] for each in answers.all_answers()}
    drives: dict[tuple[int, int], list[Row]] = {}
    for drive in answers.drives():
        drives.setdefault((drive["participant"], drive["step"]), []).append(drive)
    steps = {(row["participant"], row["step"]): row for row in answers.all_steps()}
    for participant, number in sorted({*steps, *drives}):
        step, times = answers.steps(participant)[number], steps.get((participant, number), {})
        if step.trial is None:
            continue
        shared = {"participant": participant + 1, "place": number + 1, "trial": step.name, "kind": step.kind}
        pages = {"shown": _time(times.get("shown")), "done": _time(times.get("done"))}
        if step.kind == "drive":
            for count, drive in enumerate(drives.get((participant, number), ()), 1):
                more = {"policy": "participant", "drive": count, "outcome": drive["outcome"] or "", "chosen": ""}
                ends = {"began": _time(drive["began"]), "ended": _time(drive["ended"])}
                rows.append(shared | more | ends | pages | (drive["metrics"] or {}))
            continue
        sides = {"A": int(step.swapped), "B": int(not step.swapped)}
        choice = values.get((participant, number, CHOICE))
        for side in range(len(study.trials[step.trial].episodes)):
            episode = episodes.get((step.trial, side))
            if episode is None:
                raise answers.wrong("episodes", f"there is no episode {side + 1} of the trial '{step.name}'")
            chosen = "" if step.kind != "choose" or choice not in sides else int(sides[choice] == side)
            more = {"policy": episode["policy"], "drive": "", "outcome": episode["outcome"], "chosen": chosen}
            rows.append(shared | more | {"began": "", "ended": ""} | pages | episode["metrics"])
    return rows


def answers_table(answers: Answers) -> list[Row]:
    """A row for each answer, and for each score of a scale whose items are all answered; its kind is ``scale``."""
    rows, items = list[Row](), dict[tuple[int, int], dict[str, Any]]()
    for each in answers.all_answers():
        place = each["participant"], each["step"]
        step = answers.steps(each["participant"])[each["step"]]
        question = step.question(each["question"])
        kind = "" if question is None else question["kind"]
        rows.append(_answer(place, step.name, each["question"], kind, each["value"], each["time"]))
        if kind == "likert":
            items.setdefault(place, {})[each["question"]] = each["value"]
    for place, values in items.items():
        name = answers.steps(place[0])[place[1]].name
        rows += [_answer(place, name, scale, "scale", value, None) for scale, value in scores(values).items()]
    return sorted(rows, key=lambda row: (row["participant"], row["place"]))


def _answer(place: tuple[int, int], trial: str, question: str, kind: str, value: Any, when: float | None) -> Row:
    return {"participant": place[0] + 1, "place": place[1] + 1, "trial": trial, "question": question, "kind": kind,
            "value": value, "time": _time(when)}  # fmt: skip


def scores(values: dict[str, Any]) -> dict[str, float]:
    """Scale -> score, from question -> answer; scales with a missing item are left out."""
    found = {}
    for name, template in templates().items():
        items = {key.partition(".")[2]: value for key, value in values.items() if key.startswith(f"{name}.")}
        for scale in template.scales:
            if (score := template.score(scale, items)) is not None:
                found[f"{name}.{scale}"] = score
    return found


def trajectories(answers: Answers) -> list[Row]:
    """A row for each control step of each drive: m, rad, m/s and rad/s."""
    rows = []
    for drive in answers.drives():
        step = answers.steps(drive["participant"])[drive["step"]]
        head = {"participant": drive["participant"] + 1, "trial": step.name, "began": _time(drive["began"])}
        names = ("speed_command", "turn_command", "x", "y", "heading")
        moments = answers.moments(drive["id"])
        rows += [head | {"step": k + 1} | dict(zip(names, moment, strict=True)) for k, moment in enumerate(moments)]
    return rows


TABLES: dict[str, Callable[[Answers], list[Row]]] = {
    "participants.csv": participants,
    "pages.csv": pages,
    "trials.csv": trials,
    "answers.csv": answers_table,
    "trajectories.csv": trajectories,
}


def table(answers: Answers, name: str) -> str:
    """A table as CSV."""
    return to_csv(TABLES[name](answers))


def to_csv(rows: list[Row]) -> str:
    """Rows as CSV, with a column for each key of any row."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, list(dict.fromkeys(key for row in rows for key in row)), restval="")
    writer.writeheader()
    writer.writerows({key: _guarded(value) for key, value in row.items()} for row in rows)
    return stream.getvalue()


def export(answers: Answers, folder: Path) -> list[Path]:
    """Write the tables, and a page for each drive that came to its end; their files."""
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / name for name in TABLES]
    for file in files:
        writing.write(file, table(answers, file.name))
    return [*files, *_replays(answers, folder)]


def _replays(answers: Answers, folder: Path) -> list[Path]:
    files = list[Path]()
    for drive in answers.drives():
        if (content := answers.recording(drive["id"])) is not None:
            name = f"participant-{drive['participant'] + 1}-{answers.steps(drive['participant'])[drive['step']].name}"
            files.append(folder / "drives" / f"{name}.html")
            files[-1].parent.mkdir(exist_ok=True)
            writing.write(files[-1], replay.html(content | {"title": name}))
    return files


def _time(seconds: float | None) -> str:
    """ISO 8601, UTC."""
    if seconds is None:
        return ""
    return datetime.datetime.fromtimestamp(seconds, datetime.UTC).isoformat(timespec="milliseconds")


def _seconds(duration: float | None) -> float | str:
    return "" if duration is None else round(duration, 2)


def _guarded(value: Any) -> Any:
    """A text that no spreadsheet takes for a formula: spreadsheets skip what is blank, and know full-width signs."""
    if not isinstance(value, str):
        return value
    if value[:1] in LINE_ENDS and value:
        return f"'{value}"
    start = unicodedata.normalize("NFKC", value).lstrip(BLANK)
    return f"'{value}" if start[:1] in FORMULAS and start else value
