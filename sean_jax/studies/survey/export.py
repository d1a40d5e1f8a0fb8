"""The tables of a study: participants, trials with metrics, answers with scores, and trajectories of drives."""

from __future__ import annotations

import csv
import datetime
import functools
import io
import unicodedata
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sean_jax.core.errors import InputError, WriteError
from sean_jax.io import writing
from sean_jax.studies.survey.answers import MOMENT, Answers
from sean_jax.studies.survey.study import CHOICE, Step, templates
from sean_jax.web import replay

Row = dict[str, Any]
FORMULAS = "=+-@"  # how one begins
LINE_ENDS = "\t\r\n"  # or of a cell
COLUMNS = ("participant", "place", "trial", "kind", "policy", "drive", "outcome", "chosen", "began", "ended", "shown",
           "done")  # of trials.csv, before those of metrics  # fmt: skip
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
    drives, steps = _drives(answers), _steps(answers)
    for participant, visits in answers.all_visits().items():
        for number, visit in sorted(visits.items()):
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


def _drives(answers: Answers) -> dict[tuple[int, int], list[Row]]:
    """(participant, step) -> drives in the order of time."""
    drives: dict[tuple[int, int], list[Row]] = {}
    for drive in answers.drives():
        drives.setdefault((drive["participant"], drive["step"]), []).append(drive)
    return drives


def _steps(answers: Answers) -> dict[tuple[int, int], Row]:
    """(participant, step) -> when it was shown and done."""
    return {(row["participant"], row["step"]): row for row in answers.all_steps()}


def trials(answers: Answers) -> list[Row]:
    """A row for each episode of a trial that a participant has watched or driven, with its metrics.

    A trial with a choice has two rows, of which one is ``chosen``. ``drive`` counts the drives of a trial; a drive
    that was broken off has no metrics.
    """
    films = answers.episodes()
    values = {(row["participant"], row["step"], row["question"]): row["value"] for row in answers.all_answers()}
    drives, steps, rows = _drives(answers), _steps(answers), list[Row]()
    for participant, number in sorted({*steps, *drives}):
        step, times = answers.steps(participant)[number], steps.get((participant, number), {})
        if step.trial is None:
            continue
        if step.kind == "drive":
            episodes = [_driven(drive, count) for count, drive in enumerate(drives.get((participant, number), ()), 1)]
        else:
            episodes = _watched(answers, films, step, values.get((participant, number, CHOICE)))
        head = {"participant": participant + 1, "place": number + 1, "trial": step.name, "kind": step.kind}
        pages = {"shown": _time(times.get("shown")), "done": _time(times.get("done"))}
        rows += [head | episode | pages | _metrics(metrics) for episode, metrics in episodes]
    return rows


def _driven(drive: Row, count: int) -> tuple[Row, dict[str, float]]:
    """The columns of a participant's drive, and its metrics."""
    columns = {"policy": "participant", "drive": count, "outcome": drive["outcome"] or "", "chosen": ""}
    times = {"began": _time(drive["began"]), "ended": _time(drive["ended"])}
    return columns | times, drive["metrics"] or {}


def _watched(
    answers: Answers, films: dict[tuple[int, int], Row], step: Step, choice: Any
) -> list[tuple[Row, dict[str, float]]]:
    """The columns of each episode of a trial, and its metrics.

    Args:
        films: (trial, side) -> an episode to watch.
        choice: the answer A or B, if there is one.
    """
    sides, rows = {"A": int(step.swapped), "B": int(not step.swapped)}, []
    assert step.trial is not None
    for side in range(len(answers.study.trials[step.trial].episodes)):
        episode = films.get((step.trial, side))
        if episode is None:
            raise answers.wrong("episodes", f"there is no episode {side + 1} of the trial '{step.name}'")
        chosen = "" if step.kind != "choose" or choice not in sides else int(sides[choice] == side)
        columns = {"policy": episode["policy"], "drive": "", "outcome": episode["outcome"], "chosen": chosen}
        rows.append((columns | {"began": "", "ended": ""}, episode["metrics"]))
    return rows


def _metrics(values: dict[str, float]) -> Row:
    """Metrics by column: one with the name of another column, such as participant, becomes metric_participant."""
    found = Row()
    for name, value in values.items():
        column = name
        while column in COLUMNS or (column != name and column in values):
            column = f"metric_{column}"
        found[column] = value
    return found


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
    driven = [(drive, answers.moments(drive["id"])) for drive in answers.drives()]
    names = ("speed_command", "turn_command", "x", "y", "heading")
    sideways = (names[0], "sideways_command", *names[1:])  # to the left
    columns = dict.fromkeys(sideways if any(len(row) > MOMENT for _, rows in driven for row in rows[:1]) else names, "")
    found = []
    for drive, rows in driven:
        step = answers.steps(drive["participant"])[drive["step"]]
        head = {"participant": drive["participant"] + 1, "trial": step.name, "began": _time(drive["began"])}
        for k, row in enumerate(rows):
            values = dict(zip(sideways if len(row) > MOMENT else names, row, strict=True))
            found.append(head | {"step": k + 1} | columns | values)
    return found


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
    stream, columns = io.StringIO(), list(dict.fromkeys(key for row in rows for key in row))
    writer = csv.writer(stream)
    writer.writerow(map(_guarded, columns))
    writer.writerows([_guarded(row.get(key, "")) for key in columns] for row in rows)
    return stream.getvalue()


def export(answers: Answers, folder: Path) -> list[Path]:
    """Write the tables, and a page for each drive that came to its end; their files.

    What fails keeps nothing else from being written.

    Raises:
        WriteError: the folder is a link.
        InputError: some files are not written; a line for each cause, and what is written.
    """
    _check_no_link(folder)
    folder.mkdir(parents=True, exist_ok=True)
    contents: dict[Path, Callable[[], str | None]] = {
        folder / name: functools.partial(table, answers, name) for name in TABLES
    }
    files, failed = list[Path](), dict[str, list[str]]()  # sentence -> what is not written
    try:
        contents |= _replays(answers, folder / "drives")
    except InputError as error:
        failed[str(error)] = ["replays"]
    for file, content in contents.items():
        try:
            if (text := content()) is None:
                continue
            _write(file, text)
            files.append(file)
        except InputError as error:
            failed.setdefault(str(error), []).append(file.name)
        except OSError as error:
            failed.setdefault(f"{writing.reason(error)}; choose another folder with --out.", []).append(file.name)
    if failed:
        lines = [f"{', '.join(sorted(names))}: not written: {text}" for text, names in failed.items()]
        raise InputError("\n".join([*lines, f"The other files, {len(files)}, are written to {folder}."]))
    return files


def _write(file: Path, text: str) -> None:
    _check_no_link(file.parent)
    if file.is_dir():
        raise WriteError(f"{file} is a folder; remove it, or choose another place with --out.")
    file.parent.mkdir(exist_ok=True)
    writing.write(file, text)


def _replays(answers: Answers, folder: Path) -> dict[Path, Callable[[], str | None]]:
    """File -> what makes the page of a drive."""
    found: dict[Path, Callable[[], str | None]] = {}
    for drive in answers.drives():
        if drive["metrics"] is not None:  # it came to its end
            name = answers.steps(drive["participant"])[drive["step"]].name
            title = f"participant-{drive['participant'] + 1}-{name}"
            found[folder / f"{title}.html"] = functools.partial(_replay, answers, drive["id"], title)
    return found


def _replay(answers: Answers, drive: int, title: str) -> str | None:
    """The page of a drive; None if its film was too large to be stored."""
    content = answers.recording(drive)
    return None if content is None else replay.html(content | {"title": title})


def _check_no_link(folder: Path) -> None:
    """Refuse a folder that leads elsewhere: whoever has made it may have sent it."""
    if folder.is_symlink():
        raise WriteError(f"{folder} is a link, through which nothing is written; remove it, or give the folder itself.")


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
