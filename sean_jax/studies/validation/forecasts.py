"""Prediction: how far recorded people are from where a model predicts them, and how often predicted people collide.

[G18] A. Gupta et al., "Social GAN", CVPR 2018: windows, errors. [S20] C. Schoeller et al., IEEE RA-L 5(2), 2020:
constant velocity.
"""

from pathlib import Path

import numpy as np

from sean_jax.social_forces import move
from sean_jax.studies.prediction import HABITS, evaluate, read_windows
from sean_jax.studies.prediction.benchmark import Scores
from sean_jax.studies.prediction.left_out import fitted_without
from sean_jax.studies.validation.check import Check, Curve, Finding, Laboratory, Skipped, judge

FEWER = 50.0  # times fewer collisions than with constant velocity


def prediction(laboratory: Laboratory) -> Finding:
    """Errors and collisions of each recorded scene, beside those of constant velocity.

    Raises:
        Skipped: there are no recordings.
    """
    paths = _scenes(laboratory.recordings())
    if not paths:
        raise Skipped("no recordings in eth_ucy; give a folder with eth_ucy/eth.csv and others with --data.")
    model = laboratory.model
    own: dict[str, Scores] = {}
    mark: dict[str, Scores] = {}
    slower: dict[str, Scores] = {}
    for done, path in enumerate(paths):
        windows = read_windows(path)
        if model.move is move:
            forces, habits = fitted_without(path.stem, model.forces) or (model.forces, HABITS)
            own[path.stem] = evaluate(forces, windows, **habits)
        else:
            own[path.stem] = evaluate(model.move, windows)
        mark[path.stem] = evaluate("constant_velocity", windows)
        slower[path.stem] = evaluate("constant_velocity", windows, weights=HABITS["weights"])
        if laboratory.tell is not None:
            laboratory.tell((done + 1) / len(paths))
    return compare(own, mark, slower)


def compare(own: dict[str, Scores], mark: dict[str, Scores], slower: dict[str, Scores]) -> Finding:
    """The finding of the errors of a model.

    Args:
        mark: of constant velocity in the same scenes.
        slower: likewise, of people who get slower by the habit that social forces are given.
    """
    worse = [
        name
        for name, each in own.items()
        if any(each.ade > other[name].ade or each.fde > other[name].fde for other in (mark, slower))
    ]
    collisions, usual = (np.mean([each.collisions for each in scores.values()]) for scores in (own, mark))
    words = "; ".join(
        f"{name} {each.ade:.3f}/{each.fde:.3f} (constant velocity {mark[name].ade:.3f}/{mark[name].fde:.3f}, "
        f"times {HABITS['weights'][0]:g} {slower[name].ade:.3f}/{slower[name].fde:.3f})"
        for name, each in own.items()
    )
    numbers = {f"{key}_{name}": float(getattr(each, key)) for name, each in own.items() for key in Scores._fields[:3]}
    number = tuple(float(k) for k in range(1, len(own) + 1))
    return judge(
        not worse and bool(collisions * FEWER <= usual),
        f"{words}; {100 * collisions:.2f} % of tracks collide (constant velocity {100 * usual:.2f} %)",
        f"at most the errors of both constant velocities{' (worse: ' + ', '.join(worse) + ')' if worse else ''}, "
        f"{FEWER:g} times fewer collisions",
        numbers=numbers,
        curves=(
            Curve("ADE", number, tuple(each.ade for each in own.values())),
            Curve("FDE", number, tuple(each.fde for each in own.values())),
            Curve("ADE, constant velocity", number, tuple(each.ade for each in mark.values()), reference=True),
            Curve("FDE, constant velocity", number, tuple(each.fde for each in mark.values()), reference=True),
        ),
        axes=("scene: " + ", ".join(f"{k + 1} {name}" for k, name in enumerate(own)), "error [m]"),
    )


def _scenes(folder: Path) -> list[Path]:
    return sorted((folder / "eth_ucy").glob("*.csv"))


CHECKS = (
    Check(
        name="prediction",
        title="Recorded people are predicted, without collisions",
        setup="All recordings in eth_ucy of the folder of --data, in windows of 8 seen and 12 predicted moments 0.4 s "
        "apart; people go on as in their last step, without walls, by social forces with the habits of "
        "sean_jax.studies.prediction. For `calibrated`, constants and habits are those that were fitted without "
        "the scene; for any other model, its own.",
        measure="mean distance over all predicted moments (ADE) and at the last one (FDE); share of tracks in which a "
        "predicted pair comes within 0.2 m",
        criterion="ADE and FDE at most those of constant velocity and of 0.98 times it, the habit of "
        "sean_jax.studies.prediction, in every scene, and 50 times fewer collisions",
        source="A. Gupta et al., CVPR 2018; C. Schoeller et al., IEEE RA-L 5(2), 2020",
        function=prediction,
    ),
)
