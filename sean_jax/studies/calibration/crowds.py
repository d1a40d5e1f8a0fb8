"""Crowds of many candidate constants at once: one compiled program for all scenes of a family that have one size.

Scenes lie side by side, candidates likewise, as many as fit ``PAIRS``. The steps are one scan, and only sums leave it.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from sean_jax.core.data_types import Array, Scenario
from sean_jax.social_forces import Forces, move
from sean_jax.studies.calibration.families import Family, Rows
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

    def __init__(self, families: Sequence[Family], forces: Forces, forces_of: Callable[[Array], Forces]):
        self._families, self._programs = list(families), []
        for family in families:
            scenes = [case.scene for case in family.cases]
            scenarios = [scenario_of(scene, Model("crowds", forces, move)) for scene in scenes]
            shapes = [tuple(np.shape(leaf) for leaf in jax.tree.leaves(each)) for each in scenarios]
            parts = []
            for shape in dict.fromkeys(shapes):
                own = [k for k, each in enumerate(shapes) if each == shape]
                parts.append((own, _Program(family, [scenes[k] for k in own], [scenarios[k] for k in own], forces_of)))
            self._programs.append(parts)

    @property
    def steps(self) -> int:
        """Steps of people of all scenes of one candidate, each with all others: people^2 x control steps."""
        return sum(program.pairs * family.ticks for family, program in self._each())

    def rows(self, values: Float[Array, "L P"]) -> Rows:
        """The measured rows (L,) of L candidates."""
        rows: Rows = {}
        for family, parts in zip(self._families, self._programs, strict=True):
            kept: dict[str, Any] = {}
            for own, program in parts:
                for name, part in program(values).items():
                    part = np.asarray(part)
                    whole = kept.setdefault(name, np.zeros((len(part), len(family.cases), *part.shape[2:])))
                    whole[:, own] = part
            rows |= family.rows(kept)
        return rows

    def _each(self) -> list[tuple[Family, Any]]:
        return [
            (family, program)
            for family, parts in zip(self._families, self._programs, strict=True)
            for _, program in parts
        ]


class _Program:
    """What a family keeps (L, S, ...) of S scenes of one size, by the parameters (L, P) of L candidates."""

    def __init__(
        self, family: Family, scenes: list[Scene], scenarios: list[Scenario], forces_of: Callable[[Array], Forces]
    ):
        periodic = scenes[0].period is not None
        self.pairs = len(scenes) * (scenarios[0].people * (2 if periodic else 1)) ** 2
        self._batch = max(1, PAIRS // self.pairs)
        self._scenario: Any = jax.tree.map(lambda *leaves: jnp.stack(leaves), *scenarios)
        robots = [scene.robot or ((AWAY, AWAY), (0.0, 0.0)) for scene in scenes]
        seeds = jnp.asarray([scene.seed for scene in scenes], jnp.uint32)
        self._starts = seeds, *(jnp.asarray(part, float) for part in zip(*robots, strict=True))

        def walk(scenario: Scenario, start: tuple[Array, ...], forces: Forces) -> dict[str, Array]:
            scenario = replace(scenario, forces=forces)
            seed, *robot = start
            state: Any = stage(scenario, replace(scenes[0], seed=seed, robot=tuple(robot)))

            def turn(carry: tuple, _: None) -> tuple[tuple, None]:
                state, sums = carry
                after = advance(scenario, state)
                return (after, family.count(scenario, state, after, sums)), None

            _, sums = jax.lax.scan(turn, (state, family.begin(state)), length=family.ticks)[0]
            return family.end(sums)

        def all_of_them(scenario: Scenario, starts: tuple, values: Array) -> dict[str, Array]:
            def one(values: Array) -> dict[str, Array]:
                return jax.vmap(walk, (0, 0, None))(scenario, starts, forces_of(values))

            return jax.lax.map(one, values, batch_size=self._batch)

        self._run = jax.jit(all_of_them)

    def __call__(self, values: Float[Array, "L P"]) -> dict[str, Array]:
        return self._run(self._scenario, self._starts, values)
