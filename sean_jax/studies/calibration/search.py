"""The search: one CMA-ES for all scenes and one for each scene left out, generation by generation, side by side.

N. Hansen & A. Ostermeier, Evolutionary Computation 9(2), 159 (2001), by the package ``cmaes``.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from cmaes import CMA
from jaxtyping import Float

from sean_jax.core import random_streams
from sean_jax.social_forces import Forces
from sean_jax.studies.calibration.crowds import Crowds
from sean_jax.studies.calibration.families import Rows, families
from sean_jax.studies.calibration.fitting import (
    HABITS,
    WINDOWS,
    Recordings,
    parts_of,
    to_free,
    values_of,
)
from sean_jax.studies.calibration.floor import CrowdedFloor
from sean_jax.studies.calibration.loss import total
from sean_jax.studies.calibration.windows import Scenes

SIGMA = 0.2  # of the first generation, in free parameters: a share of the scale from .45 to .55 around its middle
QUICK_WINDOWS = 4  # of each recorded scene


class Judge:
    """All rows of the loss by free parameters: crowds, and recorded people."""

    def __init__(self, forces: Forces, names: Sequence[str], kinds: Sequence[Scenes], draws: int, quick: bool):
        self.forces, self.names = forces, tuple(names)
        self.scenes = tuple(name for kind in kinds for name in kind.names)
        self._recordings = Recordings(forces, self.names, kinds, QUICK_WINDOWS if quick else WINDOWS)
        crowds = families(forces, draws, quick) if names else []  # habits do not move crowds
        forces_of = lambda free: parts_of(forces, self.names, free)[0]  # noqa: E731
        self._crowds = Crowds(crowds, forces, forces_of)
        self._floor = CrowdedFloor(forces, forces_of) if names and not quick else None

    @property
    def start(self) -> Float[np.ndarray, "P"]:
        """The constants of the forces as free parameters, and the middle of the habits."""
        return np.append(np.asarray(to_free(self.names, values_of(self.forces, self.names))), np.zeros(len(HABITS)))

    def rows(self, free: Float[np.ndarray, "L P"]) -> Rows:
        """The measured rows (L,) of L candidates."""
        values = jnp.asarray(free, float)
        rows = self._recordings.rows(values) | self._crowds.rows(values)
        return rows if self._floor is None else rows | self._floor.rows(values)


def left_out_rows(scene: str | None) -> tuple[str, ...]:
    """The rows without which constants are fitted that have not seen a scene."""
    return () if scene is None else (f"prediction {scene}", f"intent {scene}")


class Search:
    """F searches, each for the loss without one scene or with all.

    Args:
        rows: measures L candidates (L, P), such as ``Judge.rows``.
        start: (P,) free parameters.
        left_out: F scenes, None for none.
    """

    def __init__(
        self,
        rows: Callable[[np.ndarray], Rows],
        start: Float[np.ndarray, "P"],
        left_out: Sequence[str | None],
        population: int,
        seed: int,
    ):
        self._rows, self._left_out, self._population = rows, tuple(left_out), population
        seeds = random_streams.generator("calibrate", seed).integers(2**31, size=len(left_out))
        mean = np.asarray(start, float)
        self._strategies: list[Any] = [
            CMA(mean=mean, sigma=SIGMA, seed=int(number), population_size=population) for number in seeds
        ]
        self.tried: list[np.ndarray] = []  # generations of (F, L, P)
        self.losses: list[np.ndarray] = []  # generations of (F, L)

    def resume(self, tried: Float[np.ndarray, "G F L P"], losses: Float[np.ndarray, "G F L"]) -> None:
        """Go on after G generations: they are drawn again, for the random numbers, and not measured again."""
        for candidates, known in zip(np.asarray(tried), np.asarray(losses), strict=True):
            self._ask()
            self._tell(candidates, known)

    def generation(self) -> Float[np.ndarray, "F L"]:
        """The losses of one more generation."""
        candidates = self._ask()  # (F, L, P)
        measured = self._rows(candidates.reshape(-1, candidates.shape[-1]))
        losses = np.zeros(candidates.shape[:2])
        for k, scene in enumerate(self._left_out):
            losses[k] = total(measured, left_out_rows(scene)).reshape(losses.shape)[k]
        self._tell(candidates, losses)
        return self.losses[-1]

    def best(self) -> Float[np.ndarray, "F 2 P"]:
        """Of each search the mean of the distribution, and the best candidate so far."""
        tried, losses = np.stack(self.tried), np.stack(self.losses)
        chosen = []
        for k, strategy in enumerate(self._strategies):
            generation, row = np.unravel_index(losses[:, k].argmin(), losses[:, k].shape)
            chosen.append((strategy.mean, tried[generation, k, row]))
        return np.array(chosen)

    def _ask(self) -> np.ndarray:
        return np.array([[strategy.ask() for _ in range(self._population)] for strategy in self._strategies])

    def _tell(self, candidates: np.ndarray, losses: np.ndarray) -> None:
        for strategy, tried, values in zip(self._strategies, candidates, losses, strict=True):
            strategy.tell(list(zip(tried, values.tolist(), strict=True)))
        self.tried.append(candidates)
        self.losses.append(losses)
