"""Draws pictures/gradients-horizon.png and prints the tables of docs/results/gradients.md: python docs/gradients.py.

The derivative of people's positions by constants of the social forces, in forward mode, at each step: as it is, with
the gradient stopped at one stage, and with the remedies of rollouts. Takes minutes on two cores, compilation included.
Other places and other numbers of people (``--environment``, ``--people``) leave the picture as it is.
"""

import argparse
import operator
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
from matplotlib import pyplot as plt

import sean_jax
from sean_jax import gradients
from sean_jax.social_forces import model

PICTURE = Path(__file__).parent / "pictures" / "gradients-horizon.png"
CONSTANTS = ("repulsion.strength", "repulsion.range", "walking.relaxation_time")
COMMAND = (0.3, 0.1)  # m/s and rad/s, of the robot
AS_IT_IS = {"directing": 1.0, "pairs": 1.0, "robot": 1.0, "damping": 1.0, "every": 1e6}
CURVES = {
    "as it is": {},
    "desired velocities held": {"directing": 0.0},
    "robot held": {"robot": 0.0},
    "pairs held": {"pairs": 0.0},
    "truncated every 50 steps": {"every": 50.0},
    "damped by 0.98 a step": {"damping": 0.98},
    "damped by 0.95 a step": {"damping": 0.95},
}
HORIZONS = (50, 100, 200, 400, 600, 1200)
COMPARED = 100  # steps, at which the table compares gradients with differences
CHANGE = 0.05  # of a constant, of the central differences


@jax.custom_jvp
def scaled(value: Any, factor: Any) -> Any:
    """The value, with its derivative times a factor."""
    return value


@scaled.defjvp
def _(primals: tuple, tangents: tuple) -> tuple:
    return primals[0], primals[1] * tangents[0]


def held(function: Any, factor: Any) -> Any:
    """The function, with the derivative of all its results times a factor."""

    def scale(leaf: Any) -> Any:
        return scaled(leaf, factor) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf

    return lambda *arguments: jax.tree.map(scale, function(*arguments))


def walk(scenario: Any, steps: int, factors: dict, constants: Any, key: Any) -> tuple[Any, Any]:
    """People's positions (steps, N, 2), and their mean distance (steps,) from where they began."""

    forces = scenario.forces.tree_replace(dict(zip(CONSTANTS, constants, strict=True)))
    behavior, robot = scenario.behavior, scenario.robot

    def direct(scenario: Any, state: Any, key: Any) -> Any:
        after = behavior.direct(scenario, state, key)
        people = after.pedestrians
        desired = scaled(people.desired_velocity, factors["directing"])
        return replace(after, pedestrians=replace(people, desired_velocity=desired))

    changed = scenario.replace(
        forces=forces,
        behavior=replace(behavior, direct=direct),
        robot=replace(robot, drive=held(robot.drive, factors["robot"])),
    )

    def between(state: Any) -> Any:
        return gradients.damp(gradients.truncate(state, factors["every"].astype(jnp.int32)), factors["damping"])

    start = sean_jax.reset(scenario, key)
    plain = model.sum_pairs
    model.sum_pairs = held(plain, factors["pairs"])
    try:
        _, positions = sean_jax.simulate(
            changed,
            lambda scenario, state, key: jnp.asarray(COMMAND, float),
            start,
            steps,
            lambda before, after, action: after.pedestrians.position,
            between=between,
        )
    finally:
        model.sum_pairs = plain
    gap = positions - start.pedestrians.position
    return positions, jnp.sqrt((gap * gap).sum(-1) + 1e-9).mean(-1)


def measured(scenario: Any, steps: int) -> Any:
    """(factors, constants, keys) -> norms (B, steps) of d positions; slopes (B, steps, 3) and values of distances."""

    def one(factors: dict, constants: Any, key: Any) -> tuple[Any, Any, Any]:
        def both(constants: Any) -> tuple[Any, Any]:
            positions, distance = walk(scenario, steps, factors, constants, key)
            return (positions, distance), distance

        (moves, slopes), values = jax.jacfwd(both, has_aux=True)(constants)
        size = jnp.abs(moves).max((1, 2, 3), keepdims=True) + 1e-30  # squares of chaos are no numbers any more
        return size[:, 0, 0, 0] * jnp.sqrt(jnp.square(moves / size).sum((1, 2, 3))), slopes, values

    return jax.jit(jax.vmap(one, (None, None, 0)))


def main() -> None:
    """Print the tables and draw the picture."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--steps", type=int, default=1200)
    arguments.add_argument("--seeds", type=int, default=16)
    arguments.add_argument("--pairs-of-differences", type=int, default=64, help="seeds to compare; 0 for none")
    arguments.add_argument("--forces", default="calibrated")
    arguments.add_argument("--environment", default="warehouse")
    arguments.add_argument("--people", type=int)
    chosen = arguments.parse_args()
    matplotlib.use("Agg")
    crowd = {} if chosen.people is None else {"people": chosen.people}
    scenario = sean_jax.make(chosen.environment, behavior="graph", forces=chosen.forces, **crowd)
    constants = jnp.stack([operator.attrgetter(name)(scenario.forces) for name in CONSTANTS])
    keys = jax.random.split(jax.random.key(0), chosen.seeds)
    run = measured(scenario, chosen.steps)
    factors = {name: {k: jnp.asarray(v, float) for k, v in (AS_IT_IS | cut).items()} for name, cut in CURVES.items()}
    figure, panel = plt.subplots(figsize=(7, 4), layout="constrained")
    print(f"{'median norm of d positions after':>34} " + " ".join(f"{h:>8}" for h in HORIZONS))
    for name, cut in factors.items():
        norms = np.asarray(run(cut, constants, keys)[0])
        at = [f"{np.median(norms[:, h - 1]):8.3g}" if h <= chosen.steps else " " * 8 for h in HORIZONS]
        print(
            f"{name:>34} " + " ".join(at) + f"   finite: {int(np.isfinite(norms).all(1).sum())}/{len(norms)}",
            flush=True,
        )
        panel.semilogy(0.1 * np.arange(1, chosen.steps + 1), np.median(norms, 0), label=name)
    panel.set(xlabel="horizon [s]", ylabel="median norm of d positions / d constants", ylim=(1, 1e12))
    panel.legend(fontsize=8)
    if chosen.environment == "warehouse" and chosen.people is None:
        figure.savefig(PICTURE, dpi=150)
    if not chosen.pairs_of_differences:
        return

    keys = jax.random.split(jax.random.key(1), chosen.pairs_of_differences)
    run = measured(scenario, COMPARED)
    print(f"\nmean distance walked in {COMPARED} steps, by {', '.join(CONSTANTS)}:")
    ends = []
    for k in range(len(CONSTANTS)):
        shift = CHANGE * constants * jnp.eye(len(CONSTANTS))[k]
        up, down = (np.asarray(run(factors["as it is"], constants + s, keys)[2])[:, -1] for s in (shift, -shift))
        ends.append((up - down) / (2.0 * float(shift[k])))
    rows = {"central differences": np.stack(ends, 1)}
    rows |= {name: np.asarray(run(cut, constants, keys)[1])[:, -1] for name, cut in factors.items()}
    for name, found in rows.items():
        mean, error = found.mean(0), found.std(0) / np.sqrt(len(found))
        print(f"{name:>34} " + "  ".join(f"{m:8.3f} +- {e:6.3f}" for m, e in zip(mean, error, strict=True)), flush=True)


if __name__ == "__main__":
    main()
