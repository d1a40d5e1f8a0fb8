"""The constants that a fit may change, as free parameters, and the errors of predicted people by them."""

import operator
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from sean_jax.core.data_types import Array, ObstacleGrid
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import length
from sean_jax.io import files
from sean_jax.io.files import unknown_name
from sean_jax.social_forces import Forces
from sean_jax.social_forces.forces import term_name
from sean_jax.studies.calibration.windows import Scenes, thinned
from sean_jax.studies.prediction import predict
from sean_jax.studies.prediction.forecast import grid_around

_TABLE: Any = files.read_yaml(Path(__file__).with_name("bounds.yaml"))[1]
BOUNDS: dict[str, tuple[float, float]] = {name: (low, high) for name, (low, high) in _TABLE.items()}
"""term.parameter -> the least and the greatest value"""

NO_ELLIPSE = {"repulsion.anticipation", "repulsion.own_motion"}
INERT = {"circular": NO_ELLIPSE, "surface": NO_ELLIPSE, "all_round": {"repulsion.back_weight"}}
"""name of a law or of a sight of repulsion -> parameters that it does not read"""

EDGE = 0.02  # share of the scale, next to a bound, in which no fit starts
OFF = 1e5  # a constant as large switches something off, and is fitted only if it is chosen


def names_of(forces: Forces, chosen: Sequence[str] = ()) -> list[str]:
    """The parameters to be fitted: names of ``BOUNDS``; all that the forces have and read if ``chosen`` is empty.

    ``["none"]`` are none: a fit of the habits alone.

    Raises:
        InputError: a name is not in the table, or the forces have no such parameter.
    """
    terms = {term_name(term): term for term in forces}
    values = {name: _value(terms, name) for name in BOUNDS}
    if list(chosen) == ["none"]:
        return []
    for name in chosen:
        if name not in BOUNDS:
            raise InputError(unknown_name("fit", name, BOUNDS))
        if values[name] is None:
            raise InputError(f"fit: the forces have no {name}; there are the terms {', '.join(sorted(terms))}.")
    if chosen:
        return [name for name in BOUNDS if name in chosen]
    inert = _inert(terms.get("repulsion"))
    present = {name: value for name, value in values.items() if value is not None and name not in inert}
    return [name for name, value in present.items() if float(value) < OFF]


def _inert(repulsion: Any) -> set[str]:
    """Parameters that the law and the sight of a repulsion do not read."""
    inert: set[str] = set()
    for part in ("law", "sight"):
        function = getattr(repulsion, part, None)
        name = getattr(function, "__name__", "")
        inert |= INERT.get(name, set())
    return inert


def _value(terms: dict[str, Any], name: str) -> Any:
    """A parameter of the terms; None if they lack it."""
    term, _, field = name.partition(".")
    return getattr(terms.get(term), field, None)


def values_of(forces: Forces, names: Sequence[str]) -> Float[Array, "P"]:
    """(P,) parameters of forces, each in its unit."""
    return jnp.asarray([operator.attrgetter(name)(forces) for name in names], float)


def to_free(names: Sequence[str], values: Float[Array, "*batch P"]) -> Float[Array, "*batch P"]:
    """Parameters (..., P) as unbounded numbers; values outside their bounds are moved to them first."""
    low, high, logarithmic = _scales(names, values.ndim)
    safe = jnp.where(logarithmic, low, 1.0)
    ratio = jnp.maximum(values, 1e-9) / safe
    by_logarithm = jnp.log(ratio) / jnp.log(jnp.where(logarithmic, high / safe, 2.0))
    share = jnp.where(logarithmic, by_logarithm, (values - low) / (high - low))
    share = jnp.clip(share, EDGE, 1.0 - EDGE)
    return jnp.log(share) - jnp.log1p(-share)


def from_free(names: Sequence[str], free: Float[Array, "*batch P"]) -> Float[Array, "*batch P"]:
    """The inverse of ``to_free``: (..., P) parameters within their bounds."""
    low, high, logarithmic = _scales(names, free.ndim)
    share = jax.nn.sigmoid(free)
    ratio = high / jnp.where(logarithmic, low, 1.0)
    ratio = jnp.where(logarithmic, ratio, 1.0)
    geometric = low * ratio**share
    linear = low + (high - low) * share
    return jnp.where(logarithmic, geometric, linear)


def _scales(names: Sequence[str], ndim: int) -> tuple[Array, Array, Array]:
    """Bounds (1, ..., P), and whether the scale is logarithmic."""
    bounds = np.array([BOUNDS[name] for name in names], float).reshape(-1, 2)  # (P, 2)
    batch = (1,) * (ndim - 1)
    low, high = bounds.T.reshape(2, *batch, len(names))
    return jnp.asarray(low, float), jnp.asarray(high, float), jnp.asarray(low > 0.0)


# ------------------------------------------------------------------ predictions

MARGIN = 0.4  # m: a predicted pair nearer than this costs something, quadratically
WINDOWS = 64  # of a scene, evenly spaced in time; a quarter in corridors
TOGETHER = 32  # windows at a time; an eighth in corridors
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


def losses(scenes: Scenes, rows: Int[Array, "W"], grid: ObstacleGrid | None, forces: Forces, habits: Habits) -> Losses:
    """The errors of predictions of the windows ``rows`` (W,), ``EMPTY`` for none."""
    filled = rows != EMPTY

    def pick(leaf: Any) -> Array:
        return jnp.asarray(leaf)[jnp.maximum(rows, 0)]

    observed = pick(scenes.observed)
    known = pick(scenes.known)
    after = pick(scenes.after)
    counted = pick(scenes.counted) & filled[:, None, None]  # (W, S, N)
    desired = None
    if scenes.direction is not None:
        desired = pick(scenes.direction) * habits.speed
    others = None
    if scenes.others is not None:
        others = pick(scenes.others)
    predicted = predict(
        forces,
        observed,
        scenes.time_step,
        after.shape[1],
        present=known,
        walls=grid,
        desired_velocity=desired,
        others=others,
        weights=habits.persistence[None],
        settled=habits.settled,
    )  # (W, S, N, 2)

    error, weight = _scene_errors(scenes, pick(scenes.scene), predicted - after, counted)
    present = known[:, -1] & filled[:, None]  # (W, N)
    return Losses(error, weight, _collisions(predicted, present), present.astype(float).sum())


def _scene_errors(
    scenes: Scenes, scene: Int[Array, "W"], error: Float[Array, "W S N 2"], counted: Bool[Array, "W S N"]
) -> tuple[Float[Array, "E"], Float[Array, "E"]]:
    """Of each scene the mean and last errors, in shares of those of constant velocity, and how many count."""
    total = partial(jax.ops.segment_sum, segment_ids=scene, num_segments=len(scenes.names))
    reference = jnp.asarray(scenes.reference, float)
    distance = jnp.where(counted, length(error[..., 0], error[..., 1]), 0.0)
    ends = counted[:, -1].astype(float)

    weight = total(counted.astype(float).sum((1, 2)))  # (E,)
    end_weight = total(ends.sum(1))
    mean_error = total(distance.sum((1, 2))) / reference[:, 0]
    last_error = total(distance[:, -1].sum(1)) / reference[:, 1]

    # A scene has several moments for each end: both errors get the same weight.
    share = weight / jnp.where(end_weight > 0.0, end_weight, 1.0)
    share = jnp.where(end_weight > 0.0, share, 0.0)
    return 0.5 * (mean_error + share * last_error), weight


def _collisions(predicted: Float[Array, "W S N 2"], present: Bool[Array, "W N"]) -> Float[Array, ""]:
    """The cost of predicted people nearer than ``MARGIN``: of each pair when they are nearest."""
    x = predicted[..., 0]
    y = predicted[..., 1]
    dx = x[..., :, None] - x[..., None, :]  # (W, S, N, N)
    dy = y[..., :, None] - y[..., None, :]
    gap = length(dx, dy)

    both = present[:, :, None] & present[:, None, :]
    others = ~jnp.eye(present.shape[1], dtype=bool)[None]
    pairs = both & others
    near = jnp.maximum(1.0 - gap / MARGIN, 0.0)
    near = jnp.where(pairs[:, None], near, 0.0) ** 2
    return near.max(1).sum()


def parts_of(forces: Forces, names: Sequence[str], free: Float[Array, "*batch P"]) -> tuple[Forces, Habits]:
    """Forces and habits of unbounded parameters (P,), the three habits at the end."""
    values = from_free(names, free[..., : -len(HABITS)])
    fitted = forces.tree_replace({name: values[..., k] for k, name in enumerate(names)})
    shares = jax.nn.sigmoid(free[..., -len(HABITS) :])
    habits = []
    for k, (low, high) in enumerate(HABITS):
        habits.append(low + (high - low) * shares[..., k])
    return fitted, Habits(*habits)


class Recordings:
    """Recorded people, predicted by candidate constants.

    Args:
        forces: with the constants that are not fitted.
        windows: of each scene.
    """

    def __init__(self, forces: Forces, names: Sequence[str], kinds: Sequence[Scenes], windows: int = WINDOWS):
        self._kinds: list[Scenes] = []
        self._batches: list[list[tuple[Callable, Array]]] = []
        for kind in kinds:
            number = windows
            size = TOGETHER
            if kind.walls is not None:  # in corridors
                number = windows // 4
                size = TOGETHER // 8
            scenes = thinned(kind, max(1, number))
            program = _program(forces, names, scenes)
            order = np.arange(len(scenes.scene))
            padded = np.pad(order, (0, -len(order) % size), constant_values=EMPTY)
            batches = padded.reshape(-1, size)
            self._kinds.append(scenes)
            self._batches.append([(program, jnp.asarray(rows, jnp.int32)) for rows in batches])

    def rows(self, free: Float[Array, "L P"]) -> dict[str, np.ndarray]:
        """The errors (L,) of each scene by the free parameters of L candidates, and the cost of near pairs."""
        rows = {}
        near = np.zeros(len(free))
        for kind, batches in zip(self._kinds, self._batches, strict=True):
            parts = [program(free, rows) for program, rows in batches]
            sums = jax.tree.map(lambda *leaves: np.sum([np.asarray(leaf) for leaf in leaves], axis=0), *parts)
            error = sums.error / np.maximum(sums.weight, 1.0)
            group = "prediction" if kind.walls is None else "replay"
            rows |= {f"{group} {name}": error[:, k] for k, name in enumerate(kind.names)}
            near = near + sums.collisions / np.maximum(sums.pairs, 1.0)
        return rows | {"near pairs": near}


def _program(forces: Forces, names: Sequence[str], kind: Scenes) -> Callable[[Array, Array], Losses]:
    """The losses (L,) of some windows of one kind, by the free parameters (L, P) of L candidates."""
    grid = None if kind.walls is None else grid_around(kind.walls)

    def candidate_losses(free: Array, rows: Array) -> Losses:
        return losses(kind, rows, grid, *parts_of(forces, names, free))

    return jax.jit(jax.vmap(candidate_losses, (0, None)))
