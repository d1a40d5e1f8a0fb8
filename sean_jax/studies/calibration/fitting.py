"""The fit: errors of predicted people as a loss, minimized from many starts in parallel.

Each of F fits leaves other scenes out; each has K starts. All descend together, by one program, on the same windows:
the first start from the preset's constants, the others drawn within the bounds.
"""

import operator
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct
from jaxtyping import Float, Int

from sean_jax import files, prng
from sean_jax.base import Array, ObstacleGrid
from sean_jax.errors import InputError
from sean_jax.files import unknown_name
from sean_jax.geometry import length
from sean_jax.social_forces import Forces
from sean_jax.social_forces.forces import term_name
from sean_jax.studies.calibration.windows import Scenes
from sean_jax.studies.prediction import predict
from sean_jax.studies.prediction.forecast import grid_around

_TABLE: Any = files.read_yaml(Path(__file__).with_name("bounds.yaml"))[1]
BOUNDS: dict[str, tuple[float, float]] = {name: (low, high) for name, (low, high) in _TABLE.items()}
"""term.parameter -> the least and the greatest value"""

INERT = {"circular": {"repulsion.anticipation", "repulsion.own_motion"}}
"""name of a law of repulsion -> parameters that it does not read"""

EDGE = 1e-3  # share of the scale, next to a bound, in which no fit starts


def names_of(forces: Forces, chosen: Sequence[str] = ()) -> list[str]:
    """The parameters to be fitted: names of ``BOUNDS``; all that the forces have and read if ``chosen`` is empty.

    Raises:
        InputError: a name is not in the table, or the forces have no such term.
    """
    there = {term_name(term): term for term in forces}
    law = getattr(getattr(there.get("repulsion"), "law", None), "__name__", "")
    for name in chosen:
        if name not in BOUNDS:
            raise InputError(unknown_name("fit", name, BOUNDS))
        if name.partition(".")[0] not in there:
            raise InputError(f"fit: the forces have no {name}; there are the terms {', '.join(sorted(there))}.")
    usual = [name for name in BOUNDS if name.partition(".")[0] in there and name not in INERT.get(law, ())]
    return [name for name in BOUNDS if name in chosen] if chosen else usual


def values_of(forces: Forces, names: Sequence[str]) -> Float[Array, "P"]:
    """(P,) parameters of forces, each in its unit."""
    return jnp.stack([jnp.asarray(operator.attrgetter(name)(forces), float) for name in names])


def to_free(names: Sequence[str], values: Float[Array, "*batch P"]) -> Float[Array, "*batch P"]:
    """Parameters (..., P) as unbounded numbers; values outside their bounds are moved to them first."""
    low, high, logarithmic = _scales(names, values.ndim)
    safe = jnp.where(logarithmic, low, 1.0)
    by_logarithm = jnp.log(jnp.maximum(values, 1e-9) / safe) / jnp.log(jnp.where(logarithmic, high / safe, 2.0))
    share = jnp.where(logarithmic, by_logarithm, (values - low) / (high - low))
    share = jnp.clip(share, EDGE, 1.0 - EDGE)
    return jnp.log(share) - jnp.log1p(-share)


def from_free(names: Sequence[str], free: Float[Array, "*batch P"]) -> Float[Array, "*batch P"]:
    """The inverse of ``to_free``: (..., P) parameters within their bounds."""
    low, high, logarithmic = _scales(names, free.ndim)
    share = jax.nn.sigmoid(free)
    ratio = jnp.where(logarithmic, high / jnp.where(logarithmic, low, 1.0), 1.0)
    return jnp.where(logarithmic, low * ratio**share, low + (high - low) * share)


def _scales(names: Sequence[str], ndim: int) -> tuple[Array, Array, Array]:
    """Bounds (1, ..., P), and whether the scale is logarithmic."""
    bounds = np.array([BOUNDS[name] for name in names]).T.reshape((2,) + (1,) * (ndim - 1) + (-1,))
    return jnp.asarray(bounds[0], float), jnp.asarray(bounds[1], float), jnp.asarray(bounds[0] > 0.0)


# ------------------------------------------------------------------ the fit

MARGIN = 0.4  # m: a predicted pair nearer than this costs something, quadratically
COLLISIONS = 1.0  # weight of that cost, in shares of the error of constant velocity
LEARNING_RATE = 0.08
SMOOTH = 1e-3  # m2: errors are differentiable where they vanish
EMPTY = -1  # in place of a window


class Habits(NamedTuple):
    """Desired velocities, which recordings do not have; fitted along."""

    speed: Float[Array, ""]  # m/s, in corridors, where the direction is known
    persistence: Float[Array, ""]  # fraction of the last observed velocity that people desire in other scenes
    settled: Float[Array, ""]  # fraction of the model's force that is already part of that velocity


HABITS = Habits((1.1, 1.7), (0.94, 1.02), (0.0, 1.0))  # type: ignore[arg-type]  # bounds; fits begin in the middle


class Losses(NamedTuple):
    """Of some windows, by scene (E,): sums, and what to divide them by."""

    error: Float[Array, "E"]  # in shares of the error of constant velocity
    weight: Float[Array, "E"]
    collisions: Float[Array, ""]
    pairs: Float[Array, ""]


@struct.dataclass
class Descent:
    """Where all fits are; F fits, K starts, P parameters."""

    free: Float[Array, "F K P"]
    mean: Float[Array, "F K P"]  # of the last steps
    optimizer: optax.OptState
    step: Int[Array, ""]


def losses(scenes: Scenes, rows: Int[Array, "W"], grid: ObstacleGrid | None, forces: Forces, habits: Habits) -> Losses:
    """The errors of predictions of the windows ``rows`` (W,), ``EMPTY`` for none."""
    there = rows != EMPTY
    pick = lambda leaf: jnp.asarray(leaf)[jnp.maximum(rows, 0)]  # noqa: E731
    observed, known, after, counted = map(pick, (scenes.observed, scenes.known, scenes.after, scenes.counted))
    counted = counted & there[:, None, None]
    wish = None if scenes.direction is None else pick(scenes.direction) * habits.speed
    predicted = predict(
        forces, observed, scenes.time_step, after.shape[1], present=known, walls=grid, desired_velocity=wish,
        others=None if scenes.others is None else pick(scenes.others), weights=habits.persistence[None],
        settled=habits.settled,
    )  # fmt: skip
    dx, dy = predicted[..., 0] - after[..., 0], predicted[..., 1] - after[..., 1]
    away = jnp.sqrt(dx * dx + dy * dy + SMOOTH) - SMOOTH**0.5
    away, ends = jnp.where(counted, away, 0.0), counted[:, -1].astype(float)
    scene, number = pick(scenes.scene), len(scenes.names)
    total = partial(jax.ops.segment_sum, segment_ids=scene, num_segments=number)
    reference = jnp.asarray(scenes.reference, float)
    count, last = total(counted.astype(float).sum((1, 2))), total(ends.sum(1))
    mean_error = total(away.sum((1, 2))) / reference[:, 0]
    last_error = total(away[:, -1].sum(1)) / reference[:, 1]
    share = jnp.where(last > 0.0, count / jnp.where(last > 0.0, last, 1.0), 0.0)
    gap = length(
        predicted[:, :, :, None, 0] - predicted[:, :, None, :, 0],
        predicted[:, :, :, None, 1] - predicted[:, :, None, :, 1],
    )
    both = known[:, -1][:, :, None] & known[:, -1][:, None, :] & there[:, None, None]
    both = (both & ~jnp.eye(known.shape[2], dtype=bool)[None])[:, None]
    near = jnp.where(both, jnp.maximum(1.0 - gap / MARGIN, 0.0), 0.0) ** 2
    people = jnp.where(there[:, None], known[:, -1], False).astype(float).sum()
    return Losses(0.5 * (mean_error + share * last_error), count, near.max(1).sum(), people)


def objective(
    free: Float[Array, "P"],
    weights: Float[Array, "E"],
    parts: Sequence[Callable[[Forces, Habits], Losses]],
    forces: Forces,
    names: Sequence[str],
) -> Float[Array, ""]:
    """The loss of one fit, by its parameters (P,), the three habits at the end.

    Args:
        parts: the losses of scenes of one shape each, by forces and habits.
        weights: (E,) of all scenes, 0 for the scene that is left out.
    """
    constants = parts_of(forces, names, free)
    losses_of = [part(*constants) for part in parts]
    error = jnp.concatenate([each.error / jnp.maximum(each.weight, 1.0) for each in losses_of])
    counted = jnp.concatenate([(each.weight > 0.0).astype(float) for each in losses_of]) * weights
    collisions = sum(each.collisions / jnp.maximum(each.pairs, 1.0) for each in losses_of)
    return (counted * error).sum() / jnp.maximum(counted.sum(), 1e-9) + COLLISIONS * collisions


def parts_of(forces: Forces, names: Sequence[str], free: Float[Array, "*batch P"]) -> tuple[Forces, Habits]:
    """Forces and habits of unbounded parameters (P,), the three habits at the end."""
    number = len(HABITS)
    values = from_free(names, free[..., :-number])
    shares = jax.nn.sigmoid(free[..., -number:])
    habits = Habits(*(low + (high - low) * shares[..., k] for k, (low, high) in enumerate(HABITS)))
    return forces.tree_replace({name: values[..., k] for k, name in enumerate(names)}), habits


class Fit:
    """A descent on some scenes."""

    def __init__(self, forces: Forces, names: Sequence[str], kinds: Sequence[Scenes], steps: int, batch: int):
        self.forces, self.names, self.kinds, self.steps, self.batch = forces, tuple(names), tuple(kinds), steps, batch
        self.scenes = tuple(name for kind in self.kinds for name in kind.names)
        self.grids = [None if kind.walls is None else grid_around(kind.walls) for kind in self.kinds]
        self.optimizer = optax.adam(optax.cosine_decay_schedule(LEARNING_RATE, steps, 0.05))
        self._step = jax.jit(self._descend)
        self._losses = jax.jit(self._losses_of, static_argnums=2)

    def start(self, fits: int, starts: int, seed: int) -> Descent:
        """The start of F fits with K starts each: the first from the constants, the others drawn within the bounds."""
        random = prng.generator("calibrate", seed)
        first = np.append(np.asarray(to_free(self.names, values_of(self.forces, self.names))), np.zeros(len(HABITS)))
        free = np.where(
            np.arange(starts)[None, :, None] == 0, first, random.normal(0.0, 1.2, (fits, starts, len(first)))
        )
        free = jnp.asarray(free, float)
        with jax.numpy_dtype_promotion("standard"):
            state = jax.vmap(jax.vmap(self.optimizer.init))(free)
        return Descent(free=free, mean=free, optimizer=state, step=jnp.zeros((), jnp.int32))

    def rows(self, seed: int, step: int) -> list[np.ndarray]:
        """Random windows of a step, equally many of each scene."""
        random = prng.generator("calibrate windows", seed, step)
        batches = []
        for kind in self.kinds:
            each = max(1, self.batch // (1 if kind.walls is None else 16))
            own = [np.flatnonzero(kind.scene == index) for index in range(len(kind.names))]
            batches.append(np.concatenate([random.choice(rows, each, len(rows) < each) for rows in own]))
        return batches

    def descend(self, descent: Descent, weights: np.ndarray, rows: list[np.ndarray]) -> tuple[Descent, np.ndarray]:
        """One step of all fits.

        Args:
            weights: (F, E) of the scenes in each fit.

        Returns:
            The descent after it, and the losses (F, K) before it.
        """
        indices = [jnp.asarray(each, jnp.int32) for each in rows]
        return self._step(descent, jnp.asarray(weights, float), indices)

    def errors(self, free: Float[Array, "*fits P"], most: int = 64, chunk: int = 32) -> tuple[np.ndarray, np.ndarray]:
        """The errors of all scenes, over many of their windows.

        Args:
            most: windows of a scene, evenly spaced in time; a quarter of that in corridors.

        Returns:
            (..., E) errors relative to constant velocity, and (...) cost of near pairs.
        """
        totals: list[Losses] = []
        for index, kind in enumerate(self.kinds):
            crowded = kind.walls is not None
            each, size = max(1, most // (4 if crowded else 1)), max(1, chunk // (8 if crowded else 1))
            own = [np.flatnonzero(kind.scene == scene) for scene in range(len(kind.names))]
            order = np.concatenate(
                [rows[np.linspace(0, len(rows) - 1, min(each, len(rows))).astype(int)] for rows in own]
            )
            order = np.pad(order, (0, -len(order) % size), constant_values=EMPTY)
            parts = [self._losses(free, jnp.asarray(rows, jnp.int32), index) for rows in order.reshape(-1, size)]
            totals.append(jax.tree.map(lambda *leaves: sum(leaves), *parts))
        error = np.concatenate([np.asarray(each.error / jnp.maximum(each.weight, 1.0)) for each in totals], -1)
        return error, np.asarray(sum(each.collisions / jnp.maximum(each.pairs, 1.0) for each in totals))

    def _descend(self, descent: Descent, weights: Array, rows: list[Array]) -> tuple[Descent, Array]:
        kinds = zip(self.kinds, rows, self.grids, strict=True)
        parts = [partial(losses, kind, own, grid) for kind, own, grid in kinds]

        def one(free: Array, state: optax.OptState, weights: Array) -> tuple:
            loss, slope = jax.value_and_grad(objective)(free, weights, parts, self.forces, self.names)
            slope = jnp.where(jnp.isfinite(slope).all(), slope, 0.0)
            with jax.numpy_dtype_promotion("standard"):  # optax raises floats to integer powers
                change, state = self.optimizer.update(slope, state)
            return loss, optax.apply_updates(free, change), state

        each = jax.vmap(jax.vmap(one, (0, 0, None)))
        loss, free, state = each(descent.free, descent.optimizer, weights)
        share = 1.0 / jnp.maximum(descent.step.astype(float) - 0.7 * self.steps + 1.0, 1.0)
        mean = descent.mean + share * (free - descent.mean)
        return Descent(free=free, mean=mean, optimizer=state, step=descent.step + 1), loss

    def _losses_of(self, free: Array, rows: Array, kind: int) -> Losses:
        def one(free: Array) -> Losses:
            return losses(self.kinds[kind], rows, self.grids[kind], *parts_of(self.forces, self.names, free))

        for _ in range(free.ndim - 1):
            one = jax.vmap(one)
        return one(free)
