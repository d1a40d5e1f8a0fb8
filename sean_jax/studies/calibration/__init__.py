"""``sean calibrate``: the constants of the social forces, fitted by gradient to recorded people.

One fit is to all scenes. Each other one leaves out a scene of prediction, which tests it. Measurements of crowds
(fundamental diagrams, flows, lanes) are not fitted: ``sean validate`` tests them. Importing this imports no JAX.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sean_jax import writing
from sean_jax.config import CalibrateConfig
from sean_jax.errors import InputError
from sean_jax.files import listed, unknown_name
from sean_jax.progress import progress
from sean_jax.versions import versions
from sean_jax.workspace import Workspace, identity

if TYPE_CHECKING:
    import numpy as np
    from rich.console import Console

    from sean_jax.studies.calibration.fitting import Descent, Fit

__all__ = ["run"]

OPTIONS, UNFINISHED, RESULTS, REPORT = "calibration.json", "unfinished.npz", "results.json", "report.html"
FORCES = "forces.yaml"
EVERY = 10.0  # s between two savings of an unfinished fit


def run(options: CalibrateConfig, console: Console | None = None) -> Path:
    """Fit, and write forces.yaml, one such file for each scene left out, results.json and report.html.

    An unfinished fit is saved every 10 s, and the same command resumes it.

    Raises:
        InputError: there are no recordings, a name does not exist, or the folder holds something else.
        WriteError: the folder cannot be written.
    """
    folder = options.folder
    with _workspace(options).open() as work, progress(console) as bar:
        bar.stage("reading the recordings")
        from sean_jax.social_forces import build
        from sean_jax.studies.calibration import page, windows
        from sean_jax.studies.calibration.fitting import Fit, names_of

        forces = build(options.forces)
        names = names_of(forces, listed(options.fit))
        prediction, corridors = windows.find(options.data)
        left_out = _left_out(options, list(prediction))
        kinds = [windows.prediction_scenes(prediction)] if prediction else []
        kinds += [windows.corridor_scenes(corridors)] if corridors else []
        writing.write(folder / OPTIONS, {**work.identity, "versions": versions()})
        fit = Fit(forces, names, kinds, options.steps, options.batch)
        descent, history = _descend(fit, options, left_out, work, bar)
        bar.stage("judging by all windows")
        results = _evaluate(fit, descent, left_out, history, prediction)
        for what, values in results["parameters"].items():
            if what != "before":
                file = FORCES if what == "all" else f"forces-without-{what}.yaml"
                writing.write(folder / file, _constants(options, what, values, results))
        writing.write(folder / RESULTS, results)
        writing.write(folder / REPORT, page.html(options, results))
        (folder / UNFINISHED).unlink(missing_ok=True)
    return folder


def _left_out(options: CalibrateConfig, scenes: list[str]) -> list[str | None]:
    """The scene that each fit leaves out; the first none."""
    chosen = listed(options.leave_out)
    if chosen == ["none"]:
        return [None]
    for name in chosen:
        if name not in scenes:
            raise InputError(unknown_name("leave_out", name, scenes))
    return [None, *(chosen or scenes if len(scenes) > 1 else [])]


def _descend(
    fit: Fit, options: CalibrateConfig, left_out: list, work: Workspace, bar: Any
) -> tuple[Descent, np.ndarray]:
    """All fits to their ends, from where an earlier command of the same options was stopped."""
    import numpy as np

    weights = np.array([[float(name != scene) for scene in fit.scenes] for name in left_out])
    descent, history = _resume(fit.start(len(left_out), options.starts, options.seed), work)
    bar.start("compiling and fitting", options.steps)
    saved = time.monotonic()
    try:
        while len(history) < options.steps:
            descent, loss = fit.descend(descent, weights, fit.rows(options.seed, len(history)))
            history.append(np.asarray(loss))
            bar.update(len(history), f"loss {history[-1][0].min():.4f}")
            if time.monotonic() - saved > EVERY:
                _save(descent, history, work)
                saved = time.monotonic()
    except KeyboardInterrupt:
        _save(descent, history, work)
        raise
    return descent, np.stack(history)


def _evaluate(
    fit: Fit, descent: Descent, left_out: list, history: np.ndarray, recordings: dict[str, Path]
) -> dict[str, Any]:
    """The best start of each fit, and how good its constants are in all scenes."""
    import numpy as np

    from sean_jax.studies.calibration.fitting import BOUNDS, COLLISIONS, parts_of, values_of
    from sean_jax.studies.prediction import evaluate, read_windows

    error, near = fit.errors(descent.mean)  # (F, K, E), (F, K)
    weights = np.array([[float(name != scene) for scene in fit.scenes] for name in left_out])
    total = (error * weights[:, None]).sum(-1) / weights.sum(-1)[:, None] + COLLISIONS * near
    best = np.nanargmin(total, 1)
    chosen = np.asarray(descent.mean)[np.arange(len(best)), best]
    before, _ = fit.errors(fit.start(1, 1, 0).free[0])
    labels = ["all" if name is None else name for name in left_out]
    fits = {label: parts_of(fit.forces, fit.names, each) for label, each in zip(labels, chosen, strict=True)}
    forces_of = {"before": fit.forces} | {label: forces for label, (forces, _) in fits.items()}
    errors = {"before": before[0]} | {label: error[k, best[k]] for k, label in enumerate(labels)}
    scores: dict[str, Any] = {}
    for scene, file in recordings.items():
        for clock in ("social_gan", "recorded"):
            windows = read_windows(file, clock)
            own = {
                "constant velocity": evaluate("constant_velocity", windows),
                "before": evaluate(fit.forces, windows),
            }
            for name, label in (("all scenes", "all"), ("left out", scene)):
                if label in fits:
                    forces, habits = fits[label]
                    own[name] = evaluate(forces, windows, weights=habits.persistence[None], settled=habits.settled)
            scores[f"{scene} ({clock})"] = {name: each._asdict() for name, each in own.items()}
    return {
        "names": list(fit.names),
        "bounds": {name: BOUNDS[name] for name in fit.names},
        "parameters": {what: _floats(fit.names, values_of(each, fit.names)) for what, each in forces_of.items()},
        "habits": {label: _floats(habits._fields, habits) for label, (_, habits) in fits.items()},
        "errors": {what: _floats(fit.scenes, values) for what, values in errors.items()},
        "scores": scores,
        "losses": {label: history[:, k].tolist() for k, label in enumerate(labels)},
        "best_start": dict(zip(labels, best.tolist(), strict=True)),
    }


def _constants(options: CalibrateConfig, what: str, values: dict[str, float], results: dict[str, Any]) -> str:
    """The file of constants of a fit; on top of a file, all that it has."""
    from sean_jax.flags import command
    from sean_jax.social_forces import presets

    name, others = options.forces, {}
    if presets.is_file(name):
        file = presets.read(name)
        name, others = file.preset, file.parameters
    scenes = [scene for scene in results["errors"]["all"] if scene != what]
    provenance = {
        "fitted by": command("calibrate", options),
        "fitted to": ", ".join(scenes),
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


def _save(descent: Descent, history: list, work: Workspace) -> None:
    import jax
    import numpy as np

    leaves: dict[str, Any] = {f"leaf{index}": np.asarray(leaf) for index, leaf in enumerate(jax.tree.leaves(descent))}
    work.save(UNFINISHED, {"history": np.stack(history) if history else np.zeros(0), **leaves})


def _resume(descent: Descent, work: Workspace) -> tuple[Descent, list]:
    """The saved descent and its history; the start without a file."""
    import jax
    import jax.numpy as jnp

    leaves, structure = jax.tree.flatten(descent)
    try:
        if (arrays := work.load(UNFINISHED)) is None:
            return descent, []
        restored = [arrays[f"leaf{index}"] for index in range(len(leaves))]
        history = list(arrays["history"])
        if [each.shape for each in restored] != [leaf.shape for leaf in leaves]:
            raise ValueError
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{work.folder / UNFINISHED} is damaged; remove it to start again.") from None
    same = [jnp.asarray(each, leaf.dtype) for each, leaf in zip(restored, leaves, strict=True)]
    return structure.unflatten(same), history
