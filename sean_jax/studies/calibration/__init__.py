"""``sean calibrate``: the constants of the social forces, by one loss of crowds and of recorded people, or of intent.

One fit is to all scenes. Each other one leaves out a scene of prediction, which tests it. The loss has its rows and
their sources in targets.yaml. Importing this imports no JAX.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sean_jax.config import CalibrateConfig
from sean_jax.config.workspace import Workspace, identity
from sean_jax.core.errors import InputError
from sean_jax.io import writing
from sean_jax.io.files import listed, unknown_name
from sean_jax.io.progress import progress
from sean_jax.io.versions import versions

if TYPE_CHECKING:
    from rich.console import Console

    from sean_jax.studies.calibration.intent import IntentJudge
    from sean_jax.studies.calibration.search import Judge, Search

__all__ = ["run"]

OPTIONS, UNFINISHED, RESULTS, REPORT = "calibration.json", "unfinished.npz", "results.json", "report.html"
FORCES = "forces.yaml"
INTENT = "intent"  # as the constants to fit: those of intent, which no force has
EVERY = 10.0  # s between two savings of an unfinished fit


def run(options: CalibrateConfig, console: Console | None = None) -> Path:
    """Fit, and write forces.yaml, one such file for each scene left out, results.json and report.html.

    An unfinished fit is saved every 10 s, and the same command resumes it.

    Raises:
        InputError: there are no recordings, a name does not exist, or the folder holds something else.
        WriteError: the folder cannot be written.
    """
    folder = options.folder
    if options.in_crowd and listed(options.fit) != [INTENT]:
        raise InputError("in_crowd: is of intent; give --fit intent, or leave it out.")
    with _workspace(options).open() as work, progress(console) as bar:
        bar.stage("reading the recordings")
        if listed(options.fit) == [INTENT]:
            return _run_intent(options, work, bar)
        from sean_jax.social_forces import build
        from sean_jax.studies.calibration import page, windows
        from sean_jax.studies.calibration.fitting import names_of
        from sean_jax.studies.calibration.search import Judge

        forces = build(options.forces)
        names = names_of(forces, listed(options.fit))
        prediction, corridors = windows.find(options.data)
        left_out = _left_out(options, list(prediction))
        kinds = [windows.prediction_scenes(prediction)] if prediction else []
        kinds += [windows.corridor_scenes(corridors)] if corridors else []
        writing.write(folder / OPTIONS, {**work.identity, "versions": versions()})
        bar.stage("preparing the crowds")
        judge = Judge(forces, names, kinds, options.draws, options.quick)
        search = _search(judge, options, left_out, work, bar)
        bar.stage("judging by all windows")
        results = _evaluate(judge, search, left_out, prediction)
        for what, values in results["parameters"].items():
            if what != "before":
                file = FORCES if what == "all" else f"forces-without-{what}.yaml"
                writing.write(folder / file, _constants(options, what, values, results))
        writing.write(folder / RESULTS, results)
        writing.write(folder / REPORT, page.html(options, results))
        (folder / UNFINISHED).unlink(missing_ok=True)
    return folder


def _run_intent(options: CalibrateConfig, work: Workspace, bar: Any) -> Path:
    """Fit the constants of intent, and write results.json and report.html."""
    from sean_jax.studies.calibration import page
    from sean_jax.studies.calibration.intent import IntentJudge, recorded_scenes
    from sean_jax.studies.scenes import model

    folder = options.folder
    scenes = recorded_scenes(options.data, options.quick)
    left_out = _left_out(options, list(scenes))
    writing.write(folder / OPTIONS, {**work.identity, "versions": versions()})
    judge = IntentJudge(scenes, model(options.forces) if options.in_crowd else None, seed=options.seed)
    search = _search(judge, options, left_out, work, bar)
    results = _evaluate_intent(judge, search, left_out)
    writing.write(folder / RESULTS, results)
    writing.write(folder / REPORT, page.html(options, results))
    (folder / UNFINISHED).unlink(missing_ok=True)
    return folder


def _evaluate_intent(judge: IntentJudge, search: Search, left_out: list) -> dict[str, Any]:
    """The best constants of each fit, and the loss of each scene with them and before."""
    import numpy as np

    from sean_jax.studies.calibration.fitting import BOUNDS, from_free
    from sean_jax.studies.calibration.loss import total

    labels = ["all" if name is None else name for name in left_out]
    tried, rows, chosen = _choose(judge, search, labels, left_out)
    values = np.asarray(from_free(judge.names, tried))
    loss = total(rows)
    return {
        "names": list(judge.names),
        "bounds": {name: BOUNDS[name] for name in judge.names},
        "parameters": {label: _floats(judge.names, values[index]) for label, index in chosen.items()},
        "habits": {},
        "loss": {label: float(loss[index]) for label, index in chosen.items()},
        "rows": _row_results(rows, chosen),
        "scores": {},
        "losses": {label: [losses[k].tolist() for losses in search.losses] for k, label in enumerate(labels)},
    }


def _left_out(options: CalibrateConfig, scenes: list[str]) -> list[str | None]:
    """The scene that each fit leaves out; the first none."""
    chosen = listed(options.leave_out)
    if chosen == ["none"]:
        return [None]
    for name in chosen:
        if name not in scenes:
            raise InputError(unknown_name("leave_out", name, scenes))
    return [None, *(chosen or scenes if len(scenes) > 1 else [])]


def _search(judge: Judge | IntentJudge, options: CalibrateConfig, left_out: list, work: Workspace, bar: Any) -> Search:
    """All searches to their ends, from where an earlier command of the same options was stopped."""
    from sean_jax.studies.calibration.search import Search

    search = Search(judge.rows, judge.start, left_out, options.population, options.seed)
    _resume(search, work)
    bar.start("compiling and searching", options.generations)
    saved = time.monotonic()
    try:
        while len(search.losses) < options.generations:
            losses = search.generation()
            bar.update(len(search.losses), f"loss {losses[0].min():.3f}")
            if time.monotonic() - saved > EVERY:
                _save(search, work)
                saved = time.monotonic()
    except KeyboardInterrupt:
        _save(search, work)
        raise
    return search


def _evaluate(judge: Judge, search: Search, left_out: list, recordings: dict[str, Path]) -> dict[str, Any]:
    """The best constants of each fit, all rows of the loss with them and before, and how well they predict."""
    from sean_jax.studies.calibration.fitting import BOUNDS, parts_of, values_of
    from sean_jax.studies.calibration.loss import total

    labels = ["all" if name is None else name for name in left_out]
    tried, rows, chosen = _choose(judge, search, labels, left_out)
    fits = {label: parts_of(judge.forces, judge.names, tried[index]) for label, index in chosen.items()}
    habits = {label: habits for label, (_, habits) in fits.items() if label != "before"}
    loss = total(rows)
    return {
        "names": list(judge.names),
        "bounds": {name: BOUNDS[name] for name in judge.names},
        "parameters": {
            label: _floats(judge.names, values_of(forces, judge.names)) for label, (forces, _) in fits.items()
        },
        "habits": {label: _floats(values._fields, values) for label, values in habits.items()},
        "loss": {label: float(loss[index]) for label, index in chosen.items()},
        "rows": _row_results(rows, chosen),
        "scores": _scores(judge.forces, fits, recordings),
        "losses": {label: [losses[k].tolist() for losses in search.losses] for k, label in enumerate(labels)},
    }


def _choose(
    judge: Judge | IntentJudge, search: Search, labels: list[str], left_out: list
) -> tuple[Any, dict[str, Any], dict[str, int]]:
    """Free parameters (K, P), their rows (K,), and which of them each fit takes.

    "before" takes the start, and a fit the better one of the mean of its search and its best candidate.
    """
    import numpy as np

    from sean_jax.studies.calibration.loss import total
    from sean_jax.studies.calibration.search import left_out_rows

    best = search.best()
    tried = np.concatenate([judge.start[None], best.reshape(-1, best.shape[-1])])
    rows = judge.rows(tried)
    chosen = {"before": 0}
    for k, (label, scene) in enumerate(zip(labels, left_out, strict=True)):
        pair = [1 + 2 * k, 2 + 2 * k]
        chosen[label] = pair[int(total(rows, left_out_rows(scene))[pair].argmin())]
    return tried, rows, chosen


def _row_results(rows: dict[str, Any], chosen: dict[str, int]) -> dict[str, Any]:
    """Of each row its target, its values by the fits, and how far they miss the target."""
    from sean_jax.studies.calibration.loss import misses, target_of

    missed = misses(rows)
    results: dict[str, Any] = {}
    for row, values in rows.items():
        target = target_of(row)
        results[row] = {
            "target": None if target is None else target._asdict(),
            **{label: float(values[index]) for label, index in chosen.items()},
            "miss": {label: float(missed[row][index]) for label, index in chosen.items()} if target else None,
        }
    return results


def _scores(before: Any, fits: dict[str, Any], recordings: dict[str, Path]) -> dict[str, Any]:
    """Errors of prediction over all windows, by constants fitted with and without the scene."""
    from sean_jax.studies.prediction import evaluate, read_windows

    scores: dict[str, Any] = {}
    for scene, file in recordings.items():
        for clock in ("social_gan", "recorded"):
            windows = read_windows(file, clock)
            table = {"constant velocity": evaluate("constant_velocity", windows), "before": evaluate(before, windows)}
            for name, label in (("all scenes", "all"), ("left out", scene)):
                if label in fits:
                    forces, habits = fits[label]
                    weights = habits.persistence[None]
                    straight = evaluate("constant_velocity", windows, weights=weights)
                    table[name] = evaluate(forces, windows, settled=habits.settled, weights=weights)
                    table[f"constant velocity, habits of {name}"] = straight
            scores[f"{scene} ({clock})"] = {name: errors._asdict() for name, errors in table.items()}
    return scores


def _constants(options: CalibrateConfig, what: str, values: dict[str, float], results: dict[str, Any]) -> str:
    """The file of constants of a fit; on top of a file, all that it has."""
    from sean_jax.config.flags import command
    from sean_jax.social_forces import presets

    name, others = options.forces, {}
    if presets.is_file(name):
        file = presets.read_constants(name)
        name, others = file.preset, file.parameters
    rows = [row for row in results["rows"] if row not in (f"prediction {what}",) and results["rows"][row]["target"]]
    provenance = {
        "fitted by": command("calibrate", options),
        "fitted to": ", ".join(rows),
        "versions": ", ".join(f"{package} {version}" for package, version in versions().items()),
    }
    return presets.text(name, {**others, **values}, provenance)


def _floats(names: Any, values: Any) -> dict[str, float]:
    return {name: float(value) for name, value in zip(names, values, strict=True)}


# ------------------------------------------------------------------ the folder


def _workspace(options: CalibrateConfig) -> Workspace:
    """The folder of a fit; only an unfinished one needs the same versions."""
    about = identity(options)
    if not (options.folder / UNFINISHED).exists():
        del about["versions"]
    return Workspace(options.folder, about, OPTIONS)


def _save(search: Search, work: Workspace) -> None:
    import numpy as np

    if search.losses:
        work.save(UNFINISHED, {"tried": np.stack(search.tried), "losses": np.stack(search.losses)})


def _resume(search: Search, work: Workspace) -> None:
    """The search after the saved generations; from its start without a file."""
    try:
        if (arrays := work.load(UNFINISHED)) is not None:
            search.resume(arrays["tried"], arrays["losses"])
    except (ValueError, KeyError, TypeError, AssertionError):
        raise InputError(f"{work.folder / UNFINISHED} is damaged; remove it to start again.") from None
