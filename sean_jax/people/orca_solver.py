"""Half-planes of velocities without a collision, and the best velocity in them.

ORCA: J. van den Berg, S. Guy, M. Lin & D. Manocha, "Reciprocal n-body collision avoidance", Robotics Research (2011).
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int, Shaped

from sean_jax.core.data_types import Array
from sean_jax.core.geometry import length, unit

TOGETHER = 32, 128  # agents whose least violating velocities a CPU searches at once: in small and in large batches
PARALLEL = 1e-6  # sine of the angle below which two borders count as parallel
TOLERANCE = 1e-5  # m/s
FORBIDDEN = 1e6  # times what is above the top speed or violates a hard half-plane counts as a violation
UNBOUNDED = -1e6  # m/s: c of a half-plane that holds every velocity


def half_plane(
    dx: Float[Array, "..."],
    dy: Float[Array, "..."],
    vx: Float[Array, "..."],
    vy: Float[Array, "..."],
    radii: Float[Array, "..."] | float,
    horizon: float,
    time_step: float,
    first: Bool[Array, "..."] | bool,
) -> tuple[Float[Array, "..."], Float[Array, "..."], Float[Array, "..."]]:
    """The way out of the velocity obstacle of another disc: unit normal (nx, ny) and distance [m/s] of its border.

    The obstacle holds the relative velocities with which the discs touch within the horizon: a cone with a round tip.
    Normal and distance are those of the border's point nearest to the velocity; outside the distance is negative.

    Args:
        dx, dy: m, to the other.
        vx, vy: m/s, relative to the other.
        radii: m, sum of both radii.
        horizon: s.
        time_step: s, within which overlapping discs are to part.
        first: breaks the tie of two people at one place.
    """
    # Two discs at one place have no direction between them; ``first`` sends them apart along x.
    distance = length(dx, dy)
    ex, ey = unit(dx, dy)
    together = (ex == 0.0) & (ey == 0.0)
    ex = jnp.where(together, jnp.where(first, 1.0, -1.0), ex)

    # Discs that overlap have to part within a step: with the horizon they could take seconds (as in RVO2).
    apart = distance > radii
    within = jnp.where(apart, horizon, time_step)

    # Along the line to the other and across it, mirrored so that the velocity lies to its left: one leg is enough.
    along = vx * ex + vy * ey - distance / within
    across = vy * ex - vx * ey
    side = jnp.where(across > 0.0, 1.0, -1.0)
    across = across * side

    # The cone's half angle. Its legs begin where they touch the tip, a circle about the end of ``along``.
    inverse = jnp.where(apart, 1.0 / jnp.where(apart, distance, 1.0), 0.0)
    square = jnp.where(apart, (distance - radii) * (distance + radii), 1.0)  # positive, however small the gap
    sine = radii * inverse
    cosine = jnp.where(apart, jnp.sqrt(square) * inverse, 1.0)
    on_leg = apart & (along * cosine + across * sine > 0.0)

    # The normal is (na, nb) along the line and across it. In the middle of the tip it points away from the other.
    from_tip = length(along, across)
    tip_a, tip_b = unit(along, across)
    tip_a = jnp.where(from_tip == 0.0, -1.0, tip_a)
    na = jnp.where(on_leg, -sine, tip_a)
    nb = jnp.where(on_leg, cosine, tip_b)

    # ``out`` is positive inside the obstacle; the normal is mirrored and turned back to the floor's axes.
    out = radii / within - jnp.where(on_leg, across * cosine - along * sine, from_tip)
    nb = nb * side
    return na * ex - nb * ey, na * ey + nb * ex, out


class HalfPlanes(NamedTuple):
    """M half-planes of velocities v, n . v >= c, for each agent."""

    nx: Float[Array, "M *agents"]
    ny: Float[Array, "M *agents"]
    c: Float[Array, "M *agents"]  # m/s, bounds
    hard: Bool[Array, "M *agents"]  # never violated


class VelocityProgram(NamedTuple):
    """The choice of a velocity v in M half-planes, n . v >= c, nearest to a preferred one, for each agent."""

    nx: Float[Array, "M *agents"]
    ny: Float[Array, "M *agents"]
    c: Float[Array, "M *agents"]  # m/s, bounds
    hard: Bool[Array, "M"]  # never violated; these must contain the zero velocity
    px: Float[Array, "*agents"]  # m/s, the preferred velocity
    py: Float[Array, "*agents"]
    limit: Float[Array, "*agents"]  # m/s, the top speed


def best_velocity(program: VelocityProgram) -> tuple[Float[Array, "*agents"], Float[Array, "*agents"]]:
    """The velocity (x, y) [m/s] in all half-planes that is nearest to the preferred one.

    If there is none, the velocity whose largest violation of a half-plane is smallest. The choice of the half-planes
    that decide has no derivative, their velocity has one.
    """
    nx, ny, c, hard, px, py, limit = program
    px, py, limit = (jnp.broadcast_to(values, c.shape[1:]) for values in (px, py, limit))
    if not px.size:
        return px, py
    numbers = jnp.arange(c.shape[0], dtype=jnp.int32).reshape(-1, *(1 for _ in px.shape))
    planes = HalfPlanes(nx, ny, c, jnp.broadcast_to(hard.reshape(numbers.shape), c.shape))

    # The agents are the last axis, and the only one but that of the half-planes.
    columns = [rows.reshape(-1, px.size) for rows in planes]
    agents = [values.reshape(-1) for values in (px, py, limit)]
    deciding = _deciding(*jax.lax.stop_gradient((*columns, *agents)))
    i, j, exists = (values.reshape(px.shape) for values in deciding)

    x, y = _on_line(numbers, i, j, exists, planes, px, py, limit)
    slower = _slower(px, py, limit)
    free = i == c.shape[0]
    return jnp.where(free, px * slower, x), jnp.where(free, py * slower, y)


def _slower(px: Array, py: Array, limit: Array) -> Array:
    """The factor that brings a velocity to the top speed, if it is faster."""
    speed = length(px, py)
    too_fast = speed > limit
    return jnp.where(too_fast, limit / jnp.where(too_fast, speed, 1.0), 1.0)


@jax.custom_batching.custom_vmap
def _deciding(
    nx: Float[Array, "M A"],
    ny: Float[Array, "M A"],
    c: Float[Array, "M A"],
    hard: Bool[Array, "M A"],
    px: Float[Array, "A"],
    py: Float[Array, "A"],
    limit: Float[Array, "A"],
) -> tuple[Int[Array, "A"], Int[Array, "A"], Bool[Array, "A"]]:
    """The two half-planes (i, j) that decide, and whether a velocity in all of them exists.

    If so, i = j has the velocity on its border, or i = M: the preferred one is allowed. Under ``vmap`` all agents of
    the batch are one row.
    """
    slower = _slower(px, py, limit)
    free = nx * (px * slower)[None] + ny * (py * slower)[None] >= c - TOLERANCE  # (M, A)
    operands = free.all(0), nx, ny, c, hard, px, py, limit
    default = partial(_search, find_least_violating=lambda exists, *operands: _least_violating(*operands))
    return jax.lax.platform_dependent(*operands, cpu=_search_on_cpu, default=default)


def _search_on_cpu(free: Array, *operands: Array) -> tuple[Array, Array, Array]:
    """``_search``, if the preferred velocity of an agent is not ``free`` (A,)."""
    c = operands[2]

    def all_free(free: Array, *_: Array) -> tuple[Array, Array, Array]:
        preferred = jnp.full(free.shape, len(c), jnp.int32)
        return preferred, preferred, free

    search = partial(_search, find_least_violating=_least_violating_of_few)
    return jax.lax.cond(free.all(), all_free, search, free, *operands)


def _search(free: Array, *operands: Array, find_least_violating: Callable) -> tuple[Array, Array, Array]:
    """The results of ``_deciding``, where the preferred velocities of some agents are ``free`` (A,)."""
    nx, ny, c, _, px, py, limit = operands
    best, exists = _nearest(nx, ny, c, px, py, limit)
    best = jnp.where(free, len(c), best)
    exists = free | exists
    pair = find_least_violating(exists, *operands)
    i = pair % len(c)
    j = (pair + pair // len(c)) % len(c)
    return jnp.where(exists, best, i), jnp.where(exists, best, j), exists


@_deciding.def_vmap
def _deciding_vmap(size: int, batched: list[bool], *operands: Array) -> tuple[tuple[Array, ...], tuple[bool, ...]]:
    rows = []
    for operand, is_batched in zip(operands, batched, strict=True):
        if is_batched:
            operand = jnp.moveaxis(operand, 0, -2)
        else:
            operand = jnp.repeat(operand[..., None, :], size, -2)
        rows.append(operand.reshape(*operand.shape[:-2], -1))
    return tuple(values.reshape(size, -1) for values in _deciding(*rows)), (True, True, True)


def _nearest(nx: Array, ny: Array, c: Array, px: Array, py: Array, limit: Array) -> tuple[Array, Array]:
    """The half-plane (A,) whose border has the nearest velocity in all of them, and whether there is such a velocity.

    It is the preferred velocity, M, or lies on a border: on each there is one candidate, the nearest point of the
    segment that the others allow. A point of border i is c n + t (-ny, nx); there, half-plane j is rate t >= bound.
    """
    lower, upper = _chord(c, limit[None])
    possible = upper > 0.0
    rate = ny[None] * nx[:, None] - nx[None] * ny[:, None]  # (i, j, A)
    inverse = 1.0 / jnp.where(jnp.abs(rate) > PARALLEL, rate, jnp.inf)
    for j in range(len(c)):  # sums of this loop over an array (i, j, A) would not use vector instructions of a CPU
        bound = c[j, None] - c * (nx * nx[j, None] + ny * ny[j, None])
        possible = possible & ((inverse[:, j] != 0.0) | (bound <= TOLERANCE))
        lower, upper = _cut(lower, upper, bound, inverse[:, j])
    possible = possible & (lower <= upper + TOLERANCE)

    preferred = py[None] * nx - px[None] * ny
    t = jnp.clip(preferred, lower, jnp.maximum(lower, upper))
    x = c * nx - t * ny
    y = c * ny + t * nx
    square = (x - px[None]) ** 2 + (y - py[None]) ** 2

    # The square root is for XLA: it computes one only once, and would repeat all above in both reductions.
    best, smallest = _argmin(jnp.sqrt(jnp.where(possible, square, jnp.inf)))
    return best, smallest < jnp.inf


def _argmin(values: Float[Array, "M A"]) -> tuple[Int[Array, "A"], Float[Array, "A"]]:
    """The index of the first smallest value of each column, and the value; on a CPU quicker than ``jnp.argmin``."""
    smallest = values.min(0)
    index = jnp.arange(len(values), dtype=jnp.int32)[:, None]
    return jnp.where(values <= smallest[None], index, len(values)).min(0), smallest


def _cut(lower: Array, upper: Array, bound: Array, inverse: Array) -> tuple[Array, Array]:
    """The part of a segment where t / inverse >= bound; all of it where inverse is 0."""
    t = bound * inverse
    raises = (inverse > 0.0) & (t > lower)  # comparisons are quicker than ``maximum``, which passes NaN on
    lowers = (inverse < 0.0) & (t < upper)
    return jnp.where(raises, t, lower), jnp.where(lowers, t, upper)


def _chord(c: Float[Array, "*M"], limit: Float[Array, "..."]) -> tuple[Float[Array, "*M"], Float[Array, "*M"]]:
    """The segment of a border within the top speed, from t to t; both are zero where there is none."""
    square = limit * limit - c * c
    exists = square > 0.0
    half = jnp.where(exists, jnp.sqrt(jnp.where(exists, square, 1.0)), 0.0)
    return -half, half


# --- where no velocity is in all half-planes ---


def _least_violating_of_few(exists: Bool[Array, "A"], *operands: Array) -> Int[Array, "A"]:
    """``_least_violating`` of the agents for whom no velocity exists; without a meaning for others."""
    n_agents = exists.shape[0]
    size = min(n_agents, TOGETHER[n_agents > 8 * TOGETHER[0]])
    rank = jnp.cumsum(~exists, dtype=jnp.int32)
    n_batches = (rank[-1] + size - 1) // size

    def search_batch(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        batch, pairs = carry
        ranks = batch * size + jnp.arange(1, size + 1, dtype=jnp.int32)
        agents = jnp.searchsorted(rank, ranks, method="scan_unrolled")
        pair = _least_violating(*(operand.take(agents, -1, mode="clip") for operand in operands))
        return batch + 1, jax.lax.dynamic_update_slice(pairs, pair, (batch * size,))

    pairs = jnp.zeros(-(-n_agents // size) * size, jnp.int32)
    start = jnp.zeros((), jnp.int32), pairs
    _, pairs = jax.lax.while_loop(lambda carry: carry[0] < n_batches, search_batch, start)
    return pairs.take(rank - 1, mode="clip")


def _least_violating(
    nx: Array, ny: Array, c: Array, hard: Array, px: Array, py: Array, limit: Array
) -> Int[Array, "A"]:
    """The pair of half-planes on whose ``_line`` the largest violation is smallest: i + M d is the pair i, i + d mod M.

    Three dimensions, the velocity and the violation, have three bounds at their optimum: two half-planes and a third or
    the top speed, or one and the top speed (d = 0).
    """
    planes = HalfPlanes(nx, ny, c, hard)
    px, py, limit = (values[None, None] for values in (px, py, limit))
    i, j = _pairs(planes)  # (d, i, A), as all below

    # Where both are violated equally: of a hard one the border.
    pairs = zip(j[:3], i[:3], strict=True)
    ax, ay, offset = _line(*(jnp.where(j.hard, of_j, of_j - of_i) for of_j, of_i in pairs))
    lower, upper = _chord(offset, limit)
    lower, upper = _cut_by_others(planes, i, ax, ay, offset, lower, upper)
    x, y, opposite = _end(i.nx, i.ny, ax, ay, offset, lower, upper, px, py)

    # With itself, a half-plane is violated least at the top speed.
    alone = jnp.arange(len(i.c), dtype=jnp.int32)[:, None, None] == 0
    x = jnp.where(alone, limit * i.nx, x)
    y = jnp.where(alone, limit * i.ny, y)
    opposite = opposite & ~alone

    violation = _violation(planes, x, y, limit)
    violation = violation - jnp.where(opposite, TOLERANCE, 0.0)  # other velocities are ends of the segment of these
    violation = jnp.sqrt(jnp.maximum(violation, 0.0))  # as in ``_nearest``
    return _argmin(violation.reshape(-1, c.shape[1]))[0]


def _pairs(planes: HalfPlanes) -> tuple[HalfPlanes, HalfPlanes]:
    """All pairs of half-planes (d, i, A), the i-th and the one d after it; if only one is hard, it is the second."""
    offsets = range(len(planes.c) // 2 + 1)
    first = HalfPlanes(*(jnp.stack([rows for _ in offsets]) for rows in planes))
    second = HalfPlanes(*(jnp.stack([jnp.roll(rows, -d, 0) for d in offsets]) for rows in planes))
    i = HalfPlanes(*(jnp.where(first.hard, b, a) for a, b in zip(first, second, strict=True)))
    j = HalfPlanes(*(jnp.where(first.hard, a, b) for a, b in zip(first, second, strict=True)))
    return i, j


def _cut_by_others(
    planes: HalfPlanes, i: HalfPlanes, ax: Array, ay: Array, offset: Array, lower: Array, upper: Array
) -> tuple[Array, Array]:
    """The parts of segments of lines (d, i, A) where no half-plane is violated by more than i, or at all if hard."""
    hard = planes.hard[:, None, None]
    pairs = zip(planes[:3], i[:3], strict=True)
    mx, my, b = (rows[:, None, None] - jnp.where(hard, 0.0, of_i[None]) for rows, of_i in pairs)  # (k, d, i, A)
    rate = my * ax[None] - mx * ay[None]
    bound = b - offset[None] * (mx * ax[None] + my * ay[None])
    inverse = 1.0 / jnp.where(jnp.abs(rate) > PARALLEL, rate, jnp.inf)
    for k in range(len(planes.c)):
        lower, upper = _cut(lower, upper, bound[k], inverse[k])
    return lower, upper


def _violation(planes: HalfPlanes, x: Array, y: Array, limit: Array) -> Array:
    """The largest violation [m/s] by velocities (d, i, A) of all half-planes; of hard ones it counts many times."""
    soft = jnp.full_like(x, UNBOUNDED)
    forbidden = length(x, y) - limit
    for k in range(len(planes.c)):
        nx, ny, c, hard = (rows[k, None, None] for rows in planes)
        violation = c - nx * x - ny * y
        soft = jnp.where(hard | (violation < soft), soft, violation)
        forbidden = jnp.where(hard & (violation > forbidden), violation, forbidden)
    return soft + FORBIDDEN * jnp.maximum(forbidden - TOLERANCE, 0.0)


def _line(mx: Array, my: Array, b: Array) -> tuple[Array, Array, Array]:
    """The unit normal and the offset of the line m . v = b; zeros if m is."""
    size = length(mx, my)
    exists = size > 0.0
    offset = jnp.where(exists, b / jnp.where(exists, size, 1.0), 0.0)
    return *unit(mx, my), offset


def _end(
    ix: Array, iy: Array, ax: Array, ay: Array, offset: Array, lower: Array, upper: Array, px: Array, py: Array
) -> tuple[Array, Array, Array]:
    """The point (x, y) of the segment of a line that violates half-plane i least, and whether all points do.

    Then it is the point nearest to the preferred velocity.
    """
    gain = iy * ax - ix * ay
    same = jnp.abs(gain) <= PARALLEL
    upper = jnp.maximum(lower, upper)
    nearest = jnp.clip(py * ax - px * ay, lower, upper)
    t = jnp.where(same, nearest, jnp.where(gain > 0.0, upper, lower))
    return offset * ax - t * ay, offset * ay + t * ax, same


# --- the velocity, with derivatives ---


def _on_line(
    numbers: Array, i: Array, j: Array, exists: Array, planes: HalfPlanes, px: Array, py: Array, limit: Array
) -> tuple[Array, Array]:
    """The velocity that half-planes (i, j) decide.

    If a velocity exists in all half-planes, it is the nearest to the preferred one on the border of j. Otherwise it
    violates i and j equally and as little as the violations of others, which are no larger, allow. If i and j oppose
    each other, all velocities of a segment are equally good, and it is the nearest to the preferred. A hard half-plane
    is not violated, but met on its border.
    """
    # The first of the pair is the one that may be violated.
    nx, ny, c, hard = planes
    alone = ~exists & (i == j)
    swapped = _row(hard, i)
    i, j = jnp.where(swapped, j, i), jnp.where(swapped, i, j)
    ix, iy = _row(nx, i), _row(ny, i)

    # Half-plane k is violated by no more than i, where m . v >= b.
    eased = ~(hard | exists[None])
    mx, my, b = (rows - jnp.where(eased, _row(rows, i)[None], 0.0) for rows in (nx, ny, c))
    ax, ay, offset = _line(_row(mx, j), _row(my, j), _row(b, j))

    # At t along the line half-plane k is t rate >= bound, so each shortens the chord below the top speed.
    lower, upper = _chord(offset, limit)
    rate = my * ax[None] - mx * ay[None]
    bound = b - offset[None] * (mx * ax[None] + my * ay[None])

    # Nearly parallel borders cut far off or never: t would be huge, and its derivative with it.
    others = (jnp.abs(rate) > PARALLEL) & (numbers != j[None])
    t = bound / jnp.where(others, rate, 1.0)
    raises = jnp.where(others & (rate > 0.0), t, -jnp.inf)
    lowers = jnp.where(others & (rate < 0.0), t, jnp.inf)
    lower = jnp.maximum(lower, raises.max(0))
    upper = jnp.minimum(upper, lowers.min(0))

    # With i and j fixed the velocity is smooth in the half-planes: derivatives come from here, not from the choice.
    x, y, _ = _end(ix, iy, ax, ay, offset, lower, upper, px, py)  # if it exists, i is parallel to the line
    return jnp.where(alone, limit * ix, x), jnp.where(alone, limit * iy, y)


def _row(rows: Shaped[Array, "M *agents"], index: Int[Array, "*agents"]) -> Shaped[Array, "*agents"]:
    """One of the rows for each agent."""
    return jnp.take_along_axis(rows, index[None], 0, mode="clip")[0]
