"""The constants of people's intent in the closed loop: recorded scenes walked again in several draws.

sean calibrate --data RECORDINGS --fit intent --out runs/intent
python benchmarks/intent.py --data RECORDINGS --fits runs/intent/results.json --out benchmarks/results/intent.json

Each scene is walked at constant velocity, by two habits alone, by the constants of all scenes, and by those that have
not seen it. Of draws the file has the energy score, the mean errors and the error of the mean path; of average
people, who have no noise, the errors. Sideways deviations are those of the check motion.
"""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from options import Option, parse

from sean_jax.people.intent import Intent
from sean_jax.studies.calibration.intent import (
    FIELDS,
    RecordedScene,
    Walks,
    energy_score,
    recorded_scenes,
    walk_alone,
    walks_of,
)
from sean_jax.studies.scenes import Model, model, simulate
from sean_jax.studies.validation import recorded
from sean_jax.studies.validation.measures import sideways
from sean_jax.studies.validation.streets import STRIDE, streets, walked_again

STRAIGHT = Intent(speed_share=1.0, turn_time=0.0).average()
ALONE_DRAWS = 16
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


def of_average(scene: RecordedScene, intent: Intent | None, people: Model) -> dict[str, float]:
    """The errors of average people."""
    if intent is not None:
        intent = intent.average()
    alike = replace(people, move=recorded.Average(people.move))
    (walked,) = walk(scene, intent, alike, 1)
    return _errors(scene, walked)


def of_draws(scene: RecordedScene, intent: Intent, people: Model, draws: int) -> dict[str, float]:
    """The energy score [m] of several draws, their mean errors, and the error of their mean path."""
    place = _in_one_array([street.position for street in scene.windows])
    counted = _in_one_array(scene.counted)
    drawn = walk(scene, intent, people, draws)
    score, _ = energy_score(jnp.asarray(drawn), jnp.asarray(place))
    mean_path = np.linalg.norm(drawn.mean(0) - place, axis=-1)
    values = {
        "energy_score": float(np.asarray(score)[counted].mean()),
        "mean_path_mae": float(mean_path[counted].mean()),
    }
    single = [_errors(scene, one) for one in drawn]
    return values | {name: float(np.mean([one[name] for one in single])) for name in single[0]}


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


def of_people_alone(scenes: dict[str, RecordedScene], fits: dict[str, Intent]) -> dict[str, dict[str, float]]:
    """Of each scene the mean error of average people and the energy score of draws [m], where nobody meets anybody.

    Draws are by the constants that have not seen the scene: with all of them, with those of speed, and of routes.
    """
    walks = walks_of(scenes)
    kinds = {"constant velocity": STRAIGHT, "habits, average": HABITS, "all, average": fits["all"].average()}
    values = {name: {} for name in scenes}
    for kind, intent in kinds.items():
        for name, error in zip(scenes, alone_scores(walks, intent, 1, len(scenes)), strict=True):
            values[name][kind] = error
    for number, name in enumerate(scenes):
        values[name]["left out, average"] = alone_scores(walks, fits[name].average(), 1, len(scenes))[number]
        only_speed = replace(fits[name], route_deviation=0.0)
        only_route = replace(fits[name], speed_deviation=0.0)
        for kind, intent in {"draws": fits[name], "draws of speed": only_speed, "draws of route": only_route}.items():
            values[name][f"left out, {kind}"] = alone_scores(walks, intent, ALONE_DRAWS, len(scenes))[number]
    return values


def alone_scores(walks: list[Walks], intent: Intent, draws: int, scenes: int) -> list[float]:
    """The energy score [m] of each scene of draws who walk alone; of one draw the mean distance."""
    intent = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), intent)
    keys = jax.random.split(jax.random.key(1), draws)
    sums = np.sum([np.asarray(_sums_alone(intent, part, keys, scenes)) for part in walks], axis=0)
    return (sums[0] / sums[1]).tolist()


@partial(jax.jit, static_argnums=3)
def _sums_alone(intent: Intent, walks: Walks, keys: jax.Array, scenes: int) -> jax.Array:
    """(2, E) of each scene the sum of the scores [m], and the number of people and moments."""
    drawn = jax.vmap(partial(walk_alone, intent, walks))(keys)
    score, _ = energy_score(drawn, walks.place)
    each = jnp.stack([jnp.where(walks.counted, score, 0.0).sum(0), walks.counted.astype(float).sum(0)])
    return jax.vmap(lambda row: jax.ops.segment_sum(row, walks.scene, scenes))(each)


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


def half(intent: Intent) -> Intent:
    """People who differ half as much: in the crowd, noise and differences of the forces spread them, too."""
    return replace(intent, speed_deviation=0.5 * intent.speed_deviation, route_deviation=0.5 * intent.route_deviation)


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
        draws=2,
        scenes=[],
        parts=["alone", "sideways", "scenes"],
        out=Option(None, kind=Path),
    )
    people = model()
    fits = intents(options.fits)
    results: dict[str, Any] = {"draws": options.draws, "constants": {}, "alone": {}, "sideways": {}, "scenes": {}}
    for label, intent in fits.items():
        results["constants"][label] = rounded({field: getattr(intent, field) for field in FIELDS})

    def keep(kind: str, name: str, values: dict[str, Any]) -> None:
        results[kind][name] = rounded(values)
        print(name, json.dumps(results[kind][name]), flush=True)
        if options.out is not None:
            options.out.write_text(json.dumps(results, indent=1) + "\n")

    all_scenes = recorded_scenes(options.data)
    if "alone" in options.parts:
        for name, values in of_people_alone(all_scenes, fits).items():
            keep("alone", name, values)

    for name in STREET_NAMES if "sideways" in options.parts else ():
        path = options.data / "eth_ucy" / f"{name}.csv"
        of_kinds = {"without": deviations(path, None, people), "all": deviations(path, fits["all"], people)}
        keep("sideways", name, of_kinds)

    for name, scene in all_scenes.items():
        if "scenes" not in options.parts or (options.scenes and name not in options.scenes):
            continue
        values = {
            "constant velocity": of_average(scene, None, model("constant_velocity")),
            "habits, average": of_average(scene, HABITS, people),
            "all, average": of_average(scene, fits["all"], people),
        }
        keep("scenes", name, values)
        values["habits, draws"] = of_draws(scene, HABITS, people, options.draws)
        values["left out, draws"] = of_draws(scene, fits[name], people, options.draws)
        values["left out, half, draws"] = of_draws(scene, half(fits[name]), people, options.draws)
        keep("scenes", name, values)


if __name__ == "__main__":
    main()
