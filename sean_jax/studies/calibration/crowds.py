"""Crowds of many candidate constants at once: one compiled program for all scenes of a family that have one size.

Scenes lie side by side, candidates likewise, as many as fit ``PAIRS``. The steps are one scan; its records are measured
on the device.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from sean_jax.core.data_types import Array, Scenario, State
from sean_jax.social_forces import Forces, move
from sean_jax.studies.calibration.families import Rows, SceneFamily
from sean_jax.studies.scenes import Model, Scene, scenario_of, stage
from sean_jax.studies.scenes.simulation import advance
from sean_jax.studies.scenes.walkers import AWAY

PAIRS = 30_000_000  # pairs of people at a time: a few GB


class Crowds:
    """The crowds of a fit, measured with other constants of the forces.

    Args:
        forces_of: the forces by parameters (P,).
        forces: with which scenes are prepared.
    """

    def __init__(self, families: Sequence[SceneFamily], forces: Forces, forces_of: Callable[[Array], Forces]):
        self._batches = [batch for family in families for batch in _batches(family, forces, forces_of)]
        self._families = list(families)

    @property
    def steps(self) -> int:
        """Steps of people of all scenes of one candidate, each with all others: people^2 x control steps."""
        return sum(batch.pairs * batch.family.ticks for batch in self._batches)

    def rows(self, parameters: Float[Array, "L P"]) -> Rows:
        """The measured rows (L,) of L candidates."""
        rows: Rows = {}
        for family in self._families:
            values: dict[str, np.ndarray] = {}
            for batch in self._batches:
                if batch.family == family:
                    batch.measure_into(values, parameters)
            rows |= family.rows(values)
        return rows


def _batches(family: SceneFamily, forces: Forces, forces_of: Callable[[Array], Forces]) -> list["_Batch"]:
    """The scenes of a family by their size."""
    scenarios = [scenario_of(case.scene, Model("crowds", forces, move)) for case in family.cases]
    by_shape: dict[tuple, list[int]] = {}
    for index, scenario in enumerate(scenarios):
        shape = tuple(np.shape(leaf) for leaf in jax.tree.leaves(scenario))
        by_shape.setdefault(shape, []).append(index)
    return [_Batch(family, indices, [scenarios[k] for k in indices], forces_of) for indices in by_shape.values()]


class _Batch:
    """S scenes of one size, cases ``indices`` of a family, and the program that measures them."""

    def __init__(
        self, family: SceneFamily, indices: list[int], scenarios: list[Scenario], forces_of: Callable[[Array], Forces]
    ):
        scenes = [family.cases[k].scene for k in indices]
        periodic = scenes[0].period is not None
        self.family = family
        self.pairs = len(scenes) * (scenarios[0].people * (2 if periodic else 1)) ** 2
        self._indices = indices
        self._scenario: Any = jax.tree.map(lambda *leaves: jnp.stack(leaves), *scenarios)

        seeds = jnp.asarray([scene.seed for scene in scenes], jnp.uint32)
        robots = [scene.robot or ((AWAY, AWAY), (0.0, 0.0)) for scene in scenes]
        positions, velocities = zip(*robots, strict=True)
        self._starts = seeds, jnp.asarray(positions, float), jnp.asarray(velocities, float)

        together = max(1, PAIRS // self.pairs)
        self._run = jax.jit(partial(_measure, family, scenes[0], forces_of, together))

    def measure_into(self, values: dict[str, np.ndarray], parameters: Float[Array, "L P"]) -> None:
        """Set the values (L, S, ...) of these scenes among those of all scenes of the family."""
        for name, measured in self._run(self._scenario, self._starts, parameters).items():
            shape = len(parameters), len(self.family.cases), *measured.shape[2:]
            values.setdefault(name, np.zeros(shape))[:, self._indices] = np.asarray(measured)


def _measure(
    family: SceneFamily,
    scene: Scene,
    forces_of: Callable[[Array], Forces],
    together: int,
    scenarios: Scenario,
    starts: tuple[Array, ...],
    parameters: Float[Array, "L P"],
) -> dict[str, Array]:
    """The values (L, S, ...) of S scenes by the parameters of L candidates, ``together`` at a time."""
    walk = jax.vmap(partial(_walk, family, scene), (None, 0, 0))
    measure = lambda candidate: walk(forces_of(candidate), scenarios, starts)  # noqa: E731
    return jax.lax.map(measure, parameters, batch_size=together)


def _walk(
    family: SceneFamily, scene: Scene, forces: Forces, scenario: Scenario, start: tuple[Array, ...]
) -> dict[str, Array]:
    """The values of one scene, which differs from ``scene`` by its scenario, seed and robot."""
    scenario = replace(scenario, forces=forces)
    seed, position, velocity = start
    first: Any = stage(scenario, replace(scene, seed=seed, robot=(position, velocity)))

    def turn(state: State, _: None) -> tuple[State, dict[str, Array]]:
        state = advance(scenario, state)
        return state, family.record(scenario, state)

    _, records = jax.lax.scan(turn, first, length=family.ticks)
    at_start = family.record(scenario, first)
    records = {name: jnp.concatenate([at_start[name][None], later]) for name, later in records.items()}
    return family.measure(scenario, records)
