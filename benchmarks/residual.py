"""A learned residual on top of the calibrated laws: does it predict scenes better that it has not seen?

python benchmarks/residual.py --data RECORDINGS --out FOLDER

Two terms with some hundred weights, zero at the start: a push by each other person, and a change of the drive. They are
trained without one of eth, hotel and zara01 in turn, through ``predict`` and periodic corridors, by one loss: errors in
shares of constant velocity's, near pairs, and speeds against Juelich's. Constants and habits have not seen the scene
either, as in ``sean validate``. The residual ships only if it is better in every scene left out.
"""

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct
from options import Option, parse
from timing import Stopwatch

from sean_jax import social_forces
from sean_jax.core.data_types import Array, Scenario, State
from sean_jax.core.geometry import rotate
from sean_jax.io import writing
from sean_jax.io.versions import versions
from sean_jax.social_forces.forces import Crowd, Force, Forces, Pair, Walking
from sean_jax.studies.calibration.fitting import Habits, losses
from sean_jax.studies.calibration.windows import Scenes, prediction_scenes
from sean_jax.studies.prediction import evaluate, read_windows
from sean_jax.studies.scenes import Model, scenario_of, stage
from sean_jax.studies.scenes.simulation import advance
from sean_jax.studies.validation.crowds import WIDTH, hermes_speeds, juelich
from sean_jax.studies.validation.guideline_scenes import ring
from sean_jax.studies.validation.individuals import fitted_without

SCENES = "eth", "hotel", "zara01"
CLOCKS = "social_gan", "recorded"  # of the benchmark, which decides, and of the training
MODELS = "constant velocity", "laws", "laws and residual"
MOST = 1.0  # m/s2, of a push, of all pushes together, and of the change of the drive, along and across
HIDDEN, STEEP = 24, 2.0  # units of each term, and the largest singular value of its matrices
REACH, NEAR = 4.0, 0.5  # m: pushes end, and the bearing of a nearer person fades
SPEED, IDLE = 1.5, 0.3  # m/s: a usual one, and a desired one below which the drive hardly changes
DENSITIES, PEOPLE = (0.5, 1.0, 1.5, 2.5), 64  # 1/m2, and in each corridor
SETTLING, RUN, COUNTED = 200, 50, 30  # control steps: by the laws alone, with the residual, of these the last count
JUDGED, HORIZONS = 400, (50, 100)  # control steps of corridors that are judged by their second half, of derivatives
TOLERANCE, CROWD = 0.15, 0.1  # of a speed in a corridor, and the weight of its miss
UPDATES, WINDOWS, RATE, CLIP = 160, 32, 5e-3, 0.1  # updates, windows of a scene in each, of Adam, norm of gradients


@struct.dataclass
class PairResidual:
    """A learned push by each other person, of what the person sees in the frame of the look; bounded in its sum."""

    inner: Array  # (H, 5)
    bias: Array  # (H,)
    outer: Array  # (2, H)

    def gather(self, pair: Pair) -> tuple[Array, Array]:
        """The push by one other along and across the look, in shares of ``MOST``."""
        if pair.is_robot:
            return jnp.zeros_like(pair.dx), jnp.zeros_like(pair.dx)
        frame = pair.look_x, -pair.look_y
        ahead, aside = rotate(-pair.dx, -pair.dy, *frame)
        along, across = rotate(pair.wx - pair.vx, pair.wy - pair.vy, *frame)
        square = ahead * ahead + aside * aside
        apart = jnp.sqrt(square + NEAR * NEAR)
        inputs = jnp.stack([ahead / apart, aside / apart, 1.0 - apart / REACH, along / SPEED, across / SPEED])
        push = jnp.tanh(self.outer @ jnp.tanh(self.inner @ inputs + self.bias))
        weight = jnp.where(pair.standing, 0.0, jnp.maximum(1.0 - square / REACH**2, 0.0) ** 2)
        return weight * push[0], weight * push[1]

    def act(self, crowd: Crowd, along: Array, across: Array) -> Force:
        """The pushes (N,) of all others together [m/s2], shortened smoothly to less than ``MOST``."""
        shorter = MOST * jax.lax.rsqrt(1.0 + along * along + across * across)
        return rotate(shorter * along, shorter * across, crowd.look_x, crowd.look_y)

    def cutoff(self, walking: Walking) -> Array:
        """Where pushes end [m]."""
        return jnp.asarray(REACH, float)


@struct.dataclass
class GoalResidual:
    """A learned change of the drive, of a person's own speed and desired velocity in the frame of the heading."""

    inner: Array  # (H, 3)
    bias: Array  # (H,)
    outer: Array  # (2, H)

    def person(self, crowd: Crowd) -> Force:
        """The changes (N,) [m/s2]."""
        people = crowd.people
        heading_x, heading_y = people.heading.T
        along, across = rotate(*people.desired_velocity.T, heading_x, -heading_y)
        speed, _ = rotate(*people.velocity.T, heading_x, -heading_y)
        inputs = jnp.stack([speed, along, across]) / SPEED
        change = MOST * jnp.tanh(self.outer @ jnp.tanh(self.inner @ inputs + self.bias[:, None]))
        square = along * along + across * across
        weight = square / (square + IDLE * IDLE)
        return rotate(weight * change[0], weight * change[1], heading_x, heading_y)


Residual = tuple[PairResidual, GoalResidual]


def residual(seed: int = 0, outer: float = 0.0) -> Residual:
    """Both terms; outputs are zero, or normal with a deviation of ``outer``."""
    draw, terms = np.random.default_rng([seed, 23]), []
    for kind, inputs in (PairResidual, 5), (GoalResidual, 3):
        inner = draw.normal(size=(HIDDEN, inputs)) / np.sqrt(inputs)
        terms.append(kind(inner, np.zeros(HIDDEN), outer * draw.normal(size=(2, HIDDEN))))
    return bounded(jax.tree.map(lambda leaf: jnp.asarray(leaf, float), tuple(terms)))


def bounded(terms: Residual) -> Residual:
    """The terms with matrices whose singular values are at most ``STEEP``."""
    shorten = lambda matrix: matrix / jnp.maximum(jnp.linalg.norm(matrix, 2) / STEEP, 1.0)  # noqa: E731
    return tuple(replace(term, inner=shorten(term.inner), outer=shorten(term.outer)) for term in terms)  # pyright: ignore


def corridors(forces: Forces) -> tuple[Scenario, State]:
    """Periodic corridors of ``DENSITIES`` with ``PEOPLE`` people each, stacked, at their random starts."""
    model = Model("laws", forces, social_forces.move)
    starts = []
    for seed, density in enumerate(DENSITIES):
        length, speed = PEOPLE / density / WIDTH, hermes_speeds(PEOPLE, seed)
        scene = ring(length, WIDTH, PEOPLE, 0.1 * JUDGED, speed, seed, inset=0.25)
        scenario = scenario_of(scene, model)
        starts.append((scenario, stage(scenario, scene)))
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *starts)


def walked(scenario: Scenario, state: State, steps: int) -> tuple[State, Array]:
    """The state some control steps later, and the mean speeds (T,) m/s along the corridor."""

    @jax.checkpoint
    def turn(state: State, _: None) -> tuple[State, Array]:
        state = advance(scenario, state)
        return state, state.pedestrians.velocity[:, 0].mean()

    return jax.lax.scan(turn, state, length=steps)


def speeds(forces: Forces) -> list[float]:
    """Mean speeds [m/s] at ``DENSITIES`` over the second half of ``JUDGED`` steps."""
    run = jax.jit(jax.vmap(lambda *start: walked(*start, JUDGED)[1]))
    return run(*corridors(forces))[:, JUDGED // 2 :].mean(1).tolist()


def growth(forces: Forces) -> list[float]:
    """Norms of derivatives of positions [m] by the relaxation time [s] after ``HORIZONS``; medians of corridors."""

    def places(scenario: Scenario, state: State, value: Array) -> list[Array]:
        changed = replace(scenario, forces=forces.tree_replace({"walking.relaxation_time": value}))
        return [walked(changed, state, steps)[0].pedestrians.position for steps in HORIZONS]

    slopes = jax.jit(jax.vmap(jax.jacfwd(places, 2), (0, 0, None)))(*corridors(forces), forces.walking.relaxation_time)
    return [float(np.median(jnp.linalg.norm(slope, axis=(1, 2)))) for slope in slopes]


class Task(NamedTuple):
    """What the terms are trained with: recorded scenes and corridors, in which the laws and habits are fixed."""

    scenes: Scenes
    forces: Forces  # laws and residual
    habits: Habits
    corridors: tuple[Scenario, State]  # of ``DENSITIES``, stacked
    speeds: Array  # m/s, measured in them


def with_terms(task: Task, terms: Residual) -> Forces:
    """The forces with these terms."""
    return task.forces.replace(pair_residual=terms[0], goal_residual=terms[1])


def prediction_loss(terms: Residual, task: Task, rows: Array) -> Array:
    """Errors in shares of constant velocity's in windows ``rows``, and near pairs."""
    sums = losses(task.scenes, rows, None, with_terms(task, terms), task.habits)
    return (sums.error / sums.weight).mean() + sums.collisions / sums.pairs


def corridor_loss(terms: Residual, task: Task, which: Array) -> Array:
    """The miss of the speed in one of the corridors."""
    scenario, state = jax.tree.map(lambda leaf: leaf[which], task.corridors)
    speed = walked(replace(scenario, forces=with_terms(task, terms)), state, RUN)[1][-COUNTED:].mean()
    miss = (speed / task.speeds[which] - 1.0) / TOLERANCE
    return CROWD * (jnp.sqrt(1.0 + miss * miss) - 1.0)


def train(scenes: Scenes, forces: Forces, habits: Habits, updates: int, seed: int = 0) -> tuple[Residual, list[float]]:
    """The terms after training on some scenes, and the loss of each update."""
    terms = residual(seed)
    whole = social_forces.build([*forces, *terms])
    scenarios, starts = corridors(whole)
    settled = jax.jit(jax.vmap(lambda *start: walked(*start, SETTLING)[0]))(scenarios, starts)
    task = Task(scenes, whole, habits, (scenarios, settled), jnp.asarray(juelich(DENSITIES), float))

    adam = optax.adam(optax.cosine_decay_schedule(RATE, updates, 0.05))
    clip = optax.clip_by_global_norm(CLIP)  # each part: dense corridors have gradients a hundred times as large

    @jax.jit
    def update(terms: Residual, optimizer: Any, rows: Array, which: Array) -> tuple[Residual, Any, Array]:
        prediction, prediction_slope = jax.value_and_grad(prediction_loss)(terms, task, rows)
        corridor, corridor_slope = jax.value_and_grad(corridor_loss)(terms, task, which)
        slopes = [clip.update(slope, clip.init(terms))[0] for slope in (prediction_slope, corridor_slope)]
        change, optimizer = adam.update(jax.tree.map(jnp.add, *slopes), optimizer)
        return bounded(optax.apply_updates(terms, change)), optimizer, prediction + corridor

    draw, values = np.random.default_rng([seed, 29]), []
    optimizer = adam.init(terms)
    windows = [np.flatnonzero(scenes.scene == k) for k in range(len(scenes.names))]
    for number in range(updates):
        rows = np.concatenate([draw.choice(scene_windows, WINDOWS, replace=False) for scene_windows in windows])
        which = jnp.int32(number % len(DENSITIES))
        terms, optimizer, value = update(terms, optimizer, jnp.asarray(rows, jnp.int32), which)
        values.append(float(value))
    return terms, values


def fold(folder: Path, scene: str, updates: int, judged: tuple[str, ...]) -> dict[str, Any]:
    """Training without a scene, and what the terms are worth in all that are judged."""
    watch = Stopwatch()
    forces, arguments = fitted_without(scene, social_forces.preset("calibrated"))
    habits = Habits(*(jnp.asarray(value, float) for value in (1.34, *arguments["weights"], arguments["settled"])))
    scenes = prediction_scenes({name: folder / f"{name}.csv" for name in SCENES if name != scene})
    terms, values = train(scenes, forces, habits, updates)

    with_residual = social_forces.build([*forces, *terms])
    scores = {}
    for name, clock in itertools.product(judged, CLOCKS):
        windows = read_windows(folder / f"{name}.csv", clock)
        errors = [
            evaluate("constant_velocity", windows, weights=arguments["weights"]),
            evaluate(forces, windows, **arguments),
            evaluate(with_residual, windows, **arguments),
        ]
        scores[f"{name} ({clock})"] = {model: e._asdict() for model, e in zip(MODELS, errors, strict=True)}
    return {
        "scores": scores,
        "speeds": {MODELS[1]: speeds(forces), MODELS[2]: speeds(with_residual)},
        "derivatives": {MODELS[1]: growth(forces), MODELS[2]: growth(with_residual)},
        "losses": [float(np.mean(part)) for part in np.array_split(values, min(10, updates))],
        "seconds": watch.seconds,
    }


def better(scene: str, result: dict[str, Any]) -> bool:
    """Whether the residual lowers both errors of the scene left out, with no more collisions."""
    before, after = (result["scores"][f"{scene} ({CLOCKS[0]})"][name] for name in MODELS[1:])
    return after["ade"] < before["ade"] and after["fde"] < before["fde"] and after["collisions"] <= before["collisions"]


def main() -> None:
    """Train, judge, print the table and write residual.json."""
    chosen = parse(
        __doc__,
        data=Option(None, "folder with eth.csv, hotel.csv and zara01.csv", kind=Path, required=True),
        quick=Option(False, "three updates, without eth alone"),
        out=Option(None, "folder of residual.json", kind=Path, required=True),
    )
    updates, scenes = (3, SCENES[:1]) if chosen.quick else (UPDATES, SCENES)
    results: dict[str, Any] = {"updates": updates, "weights": sum(leaf.size for leaf in jax.tree.leaves(residual()))}
    results |= {"densities": DENSITIES, "measured": juelich(DENSITIES).tolist(), "horizons": HORIZONS, "without": {}}
    print("without  error, collisions: constant velocity, laws, with residual  better  speeds: laws, with residual")
    for scene in scenes:
        fold_result = results["without"][scene] = fold(chosen.data, scene, updates, scenes)
        several = fold_result["scores"][f"{scene} ({CLOCKS[0]})"].values()
        errors = "  ".join("{ade:.4f}/{fde:.4f} {collisions:.4f}".format(**scores) for scores in several)
        pace = "  ".join(" ".join(f"{v:.2f}" for v in scores) for scores in fold_result["speeds"].values())
        print(f"{scene:7}  {errors}  {better(scene, fold_result)!s:5}  {pace}", flush=True)
    results["ships"] = all(better(scene, fold_result) for scene, fold_result in results["without"].items())
    print("ships" if results["ships"] else "does not ship: not better in every scene left out")
    writing.write(chosen.out / "residual.json", {**results, "versions": versions()})


if __name__ == "__main__":
    main()
