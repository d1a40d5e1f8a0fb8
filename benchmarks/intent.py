"""Two habits of recorded people that lead them to their goals, fitted with one scene left out each time and with all.

python benchmarks/intent.py --data RECORDINGS --out benchmarks/results/intent.json

A person keeps a share of the difference between the speed of the first 2 s and the usual one of the scene, and the
wanted direction turns to the goal in some time. Errors are mean distances of people who walk alone, as shares of those
at the first speed straight to the goal. ``studies/validation/recorded.py`` has the constants.
"""

import json
from pathlib import Path

import numpy as np
from options import Option, parse
from scipy.optimize import minimize

from sean_jax.studies.validation import recorded
from sean_jax.studies.validation.streets import TIME_STEP, Street, streets

STEP = 0.1  # s
SUBSTEPS = round(TIME_STEP / STEP)
ARRIVED = 0.1  # m
START = (0.8, 1.0)  # of the fit


def distances(street: Street, share: float, turn_time: float, usual: float, counted: np.ndarray) -> np.ndarray:
    """(K,) m between people who walk alone and recorded ones, at the people and moments that count."""
    person = np.arange(street.present.shape[1])
    first = street.present.argmax(0)
    place = street.position[first, person].copy()
    velocity = street.velocity
    if velocity is None:
        velocity = (street.position[first + 1, person] - place) / TIME_STEP
    direction = _unit(velocity)
    speed = usual + share * (street.speed - usual)
    turned = min(STEP / turn_time, 1.0) if turn_time > 0.0 else 1.0

    gaps = []
    arrived = np.zeros(len(person), bool)
    for moment, chosen in enumerate(counted):
        gaps.append(np.linalg.norm(place - street.position[moment], axis=-1)[chosen])
        for _ in range(SUBSTEPS):
            walks = (first <= moment) & ~arrived
            way = street.goal - place
            wanted = _unit(direction + turned * (_unit(way) - direction))
            direction = np.where(walks[:, None], wanted, direction)
            step = np.where(walks, speed * STEP, 0.0)
            place = place + direction * step[:, None]
            arrived |= walks & (np.linalg.norm(street.goal - place, axis=-1) < np.maximum(step, ARRIVED))
    return np.concatenate(gaps)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)


def error(scene: list[tuple[Street, np.ndarray]], share: float, turn_time: float) -> float:
    """The mean distance [m] in all windows of a scene."""
    usual = np.median(np.concatenate([street.speed for street, _ in scene]))
    gaps = [distances(street, share, turn_time, usual, counted) for street, counted in scene]
    return float(np.concatenate(gaps).mean())


def read_scenes(folder: Path) -> dict[str, list[tuple[Street, np.ndarray]]]:
    """The streets of each recording, with the people and moments that count."""
    scenes = {}
    for path in sorted((folder / "grand_central").glob("*.csv")):
        street = recorded.clip(path)
        scenes[path.stem] = [(street, street.present)]
    for name in ("eth", "hotel", "zara01"):
        windows = [recorded.with_first_speeds(street) for street in streets(folder / "eth_ucy" / f"{name}.csv")]
        scenes[name] = [(street, recorded.counted(street)) for street in windows]
    return scenes


def fit(scenes: dict, straight: dict[str, float]) -> tuple[float, float]:
    """The share and the time [s] with the least mean of the scenes' relative errors."""

    def loss(habits: np.ndarray) -> float:
        share, turn_time = habits
        return float(
            np.mean([error(scene, share, max(turn_time, 0.0)) / straight[name] for name, scene in scenes.items()])
        )

    found = minimize(loss, START, method="Nelder-Mead", options={"xatol": 0.01, "fatol": 1e-4, "maxiter": 60})
    share, turn_time = found.x
    return float(share), float(turn_time)


def main() -> None:
    """Print the habits, and the relative error of each scene without and with it in the fit."""
    options = parse(__doc__, data=Option(None, kind=Path, required=True), out=Option(None, kind=Path))
    scenes = read_scenes(options.data)
    straight = {name: error(scene, 1.0, 0.0) for name, scene in scenes.items()}
    results = {}
    for left_out in (None, *scenes):
        share, turn_time = fit({name: scene for name, scene in scenes.items() if name != left_out}, straight)
        relative = {name: round(error(scene, share, turn_time) / straight[name], 3) for name, scene in scenes.items()}
        results[left_out or "all"] = {"share": round(share, 3), "turn_time": round(turn_time, 3), "error": relative}
        print(left_out or "all", json.dumps(results[left_out or "all"]))
    if options.out is not None:
        options.out.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
