"""The constants of people's intent in the closed loop: recorded scenes walked again in several draws.

sean calibrate --data RECORDINGS --fit intent --out runs/intent
python benchmarks/intent.py --data RECORDINGS --fits runs/intent/results.json --out benchmarks/results/intent.json

Each scene is walked by four kinds of people: at constant velocity, by the two habits of average people alone, by the
constants of all scenes, and by those that have not seen it. Of draws the file has the energy score, the mean errors
and the error of the mean path, and of average people the errors. Sideways deviations are those of the check motion.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from options import Option, parse

from sean_jax.people.intent import Intent
from sean_jax.studies.calibration.intent import FIELDS, RecordedScene, energy_score, recorded_scenes
from sean_jax.studies.scenes import Model, model, simulate
from sean_jax.studies.validation import recorded
from sean_jax.studies.validation.measures import sideways
from sean_jax.studies.validation.streets import STRIDE, streets, walked_again

HABITS = Intent(speed_share=0.9, turn_time=1.1).average()  # of the scenes with all, by the error of average people
STREET_NAMES = "eth", "hotel", "zara01"


def walk(scene: RecordedScene, intent: Intent | None, moved_by: Model, draws: int) -> np.ndarray:
    """Positions (K, T, N, 2) m of several draws of each window of a scene, one window after the other along N.

    Moments and people of shorter windows are filled up with zeros, as by ``_in_one_array``.
    """
    several = []
    for draw in range(draws):
        if intent is None:
            scenes = [walked_again(street) for street in scene.windows]
        else:
            scenes = recorded.intended_scenes(scene.windows, intent)
        scenes = [replace(one, seed=draws * number + draw) for number, one in enumerate(scenes)]
        several += scenes
    tracks = simulate(several, moved_by)
    positions = [
        recorded.positions(one, len(street.position)) for one, street in zip(tracks, scene.windows * draws, strict=True)
    ]
    number = len(scene.windows)
    rows = [_in_one_array(positions[draw * number : (draw + 1) * number]) for draw in range(draws)]
    return np.stack(rows)


def _in_one_array(windows: list[np.ndarray]) -> np.ndarray:
    """Arrays (T, N, ...) side by side, with zeros after the last moment of each."""
    moments = max(len(window) for window in windows)
    rows = []
    for window in windows:
        after = [(0, moments - len(window))] + [(0, 0)] * (window.ndim - 1)
        rows.append(np.pad(window, after))
    return np.concatenate(rows, axis=1)


def scores(scene: RecordedScene, intent: Intent | None, people: Model, draws: int) -> dict[str, float]:
    """The errors of average people and of draws; constant velocity without intent."""
    place = _in_one_array([street.position for street in scene.windows])
    counted = _in_one_array(scene.counted)
    if intent is None:
        (alone,) = walk(scene, None, model("constant_velocity"), 1)
        return _errors(scene, alone)

    alike = replace(people, move=recorded.Average(people.move))
    (average,) = walk(scene, intent.average(), alike, 1)
    drawn = walk(scene, intent, people, draws)
    score, _ = energy_score(jnp.asarray(drawn), jnp.asarray(place))
    single = [_errors(scene, one) for one in drawn]
    mean_path = np.linalg.norm(drawn.mean(0) - place, axis=-1)

    values = {"energy_score": float(np.asarray(score)[counted].mean())}
    values |= {f"average_{name}": value for name, value in _errors(scene, average).items()}
    values |= {f"draws_{name}": float(np.mean([one[name] for one in single])) for name in single[0]}
    return values | {"mean_path_mae": float(mean_path[counted].mean())}


def _errors(scene: RecordedScene, positions: np.ndarray) -> dict[str, float]:
    """MAE, OT and MMD of one draw of a scene, by windows."""
    parts = []
    weights = []
    before = 0
    for street, counted in zip(scene.windows, scene.counted, strict=True):
        moments, people = counted.shape
        window = positions[:moments, before : before + people]
        before += people
        parts.append(recorded.errors(window, street.position, counted))
        weights.append(counted.sum())
    mean = recorded.mean_errors(parts, weights)
    return {"mae": mean.mae, "ot": mean.ot, "mmd": mean.mmd}


def deviations(path: Path, intent: Intent | None, people: Model) -> dict[str, float]:
    """Median and 90th percentile [m] of how far people of the streets of a recording come off their straight way."""
    windows = streets(path)
    scenes = [replace(walked_again(street, intent), seed=number) for number, street in enumerate(windows)]
    tracks = simulate(scenes, people)
    walked = [sideways(np.asarray(one.position)[::STRIDE], np.asarray(one.present)[::STRIDE]) for one in tracks]
    known = [sideways(street.position, street.present) for street in windows]
    return _quantiles("", walked) | _quantiles("recorded_", known)


def _quantiles(name: str, values: list[np.ndarray]) -> dict[str, float]:
    median, high = np.nanquantile(np.concatenate(values), (0.5, 0.9))
    return {f"{name}median": float(median), f"{name}p90": float(high)}


def intents(fits: Path) -> dict[str, Intent]:
    """The intent of each fit of ``sean calibrate --fit intent``."""
    found = {}
    for label, values in json.loads(fits.read_text())["parameters"].items():
        found[label] = Intent(**{field: values[f"intent.{field}"] for field in FIELDS})
    return found


def rounded(values: Any) -> Any:
    """The same with three or four digits."""
    if isinstance(values, dict):
        return {name: rounded(value) for name, value in values.items()}
    return float(f"{values:.4g}")


def main() -> None:
    """Print the scores of each scene, and write them."""
    options = parse(
        __doc__,
        data=Option(None, kind=Path, required=True),
        fits=Option(None, kind=Path, required=True),
        draws=Option(8, kind=int),
        out=Option(None, kind=Path),
    )
    people = model()
    fits = intents(options.fits)
    results: dict[str, Any] = {"draws": options.draws, "constants": {}, "scenes": {}, "sideways": {}}
    for label, intent in fits.items():
        results["constants"][label] = rounded({field: getattr(intent, field) for field in FIELDS})

    def keep(kind: str, name: str, values: dict[str, dict[str, float]]) -> None:
        results[kind][name] = rounded(values)
        print(name, json.dumps(results[kind][name]), flush=True)
        if options.out is not None:
            options.out.write_text(json.dumps(results, indent=1) + "\n")

    for name in STREET_NAMES:
        path = options.data / "eth_ucy" / f"{name}.csv"
        of_kinds = {"without": deviations(path, None, people), "all": deviations(path, fits["all"], people)}
        keep("sideways", name, of_kinds)

    for name, scene in recorded_scenes(options.data).items():
        kinds = {"constant_velocity": None, "habits": HABITS, "all": fits["all"]}
        if name in fits:
            kinds["left_out"] = fits[name]
        keep("scenes", name, {kind: scores(scene, intent, people, options.draws) for kind, intent in kinds.items()})


if __name__ == "__main__":
    main()
