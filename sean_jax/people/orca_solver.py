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

    # The cone's half angle.
    divisor = jnp.where(apart, distance, 1.0)
    inverse = jnp.where(apart, 1.0 / divisor, 0.0)
    square = (distance - radii) * (distance + radii)  # positive, however small the gap
    square = jnp.where(apart, square, 1.0)
    sine = radii * inverse
    cosine = jnp.where(apart, jnp.sqrt(square) * inverse, 1.0)

    # Its legs begin where they touch the tip, a circle about the end of ``along``.
    along_leg = along * cosine + across * sine
    on_leg = apart & (along_leg > 0.0)

    # The normal is (na, nb) along the line and across it. In the middle of the tip it points away from the other.
    from_tip = length(along, across)
    tip_a, tip_b = unit(along, across)
    tip_a = jnp.where(from_tip == 0.0, -1.0, tip_a)
    na = jnp.where(on_leg, -sine, tip_a)
    nb = jnp.where(on_leg, cosine, tip_b)

    # ``out`` is positive inside the obstacle.
    from_axis = jnp.where(on_leg, across * cosine - along * sine, from_tip)
    out = radii / within - from_axis

    # The normal is mirrored and turned back to the floor's axes.
    nb = nb * side
    nx = na * ex - nb * ey
    ny = na * ey + nb * ex
    return nx, ny, out


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
    n_planes, *agents = c.shape
    px, py, limit = (jnp.broadcast_to(values, agents) for values in (px, py, limit))
    if not px.size:
        return px, py

    # One number of a half-plane for all agents.
    column = (n_planes, *(1 for _ in agents))
    numbers = jnp.arange(n_planes, dtype=jnp.int32).reshape(column)
    hard = jnp.broadcast_to(hard.reshape(column), c.shape)
    planes = HalfPlanes(nx, ny, c, hard)

    # The agents are the last axis, and the only one but that of the half-planes.
    flat_planes = [rows.reshape(-1, px.size) for rows in planes]
    flat_agents = [values.reshape(-1) for values in (px, py, limit)]
    fixed = jax.lax.stop_gradient((*flat_planes, *flat_agents))
    i, j, exists = (values.reshape(px.shape) for values in _deciding(*fixed))

    # The preferred velocity, no faster than the top speed, or the one that two half-planes decide.
    x, y = _on_line(numbers, i, j, exists, planes, px, py, limit)
    slower = _slower(px, py, limit)
    free = i == n_planes
    x = jnp.where(free, px * slower, x)
    y = jnp.where(free, py * slower, y)
    return x, y


def _slower(px: Array, py: Array, limit: Array) -> Array:
    """The factor that brings a velocity to the top speed, if it is faster."""
    speed = length(px, py)
    too_fast = speed > limit
    divisor = jnp.where(too_fast, speed, 1.0)
    return jnp.where(too_fast, limit / divisor, 1.0)


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
    # The velocity is free if it lies in all half-planes.
    slower = _slower(px, py, limit)
    x = px * slower
    y = py * slower
    free = nx * x[None] + ny * y[None] >= c - TOLERANCE  # (M, A)

    operands = free.all(0), nx, ny, c, hard, px, py, limit
    search = partial(_search, find_least_violating=_least_violating_of_all)
    return jax.lax.platform_dependent(*operands, cpu=_search_on_cpu, default=search)


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
    n_planes = len(c)
    best, exists = _nearest(nx, ny, c, px, py, limit)
    best = jnp.where(free, n_planes, best)
    exists = free | exists

    # The pair i + M d is of the half-planes i and i + d.
    pair = find_least_violating(exists, *operands)
    i = pair % n_planes
    j = (pair + pair // n_planes) % n_planes
    i = jnp.where(exists, best, i)
    j = jnp.where(exists, best, j)
    return i, j, exists


@_deciding.def_vmap
def _deciding_vmap(size: int, batched: list[bool], *operands: Array) -> tuple[tuple[Array, ...], tuple[bool, ...]]:
    rows = []
    for operand, is_batched in zip(operands, batched, strict=True):
        if is_batched:
            operand = jnp.moveaxis(operand, 0, -2)
        else:
            operand = jnp.repeat(operand[..., None, :], size, -2)
        rows.append(operand.reshape(*operand.shape[:-2], -1))
    results = tuple(values.reshape(size, -1) for values in _deciding(*rows))
    return results, (True, True, True)


def _nearest(
    nx: Float[Array, "M A"],
    ny: Float[Array, "M A"],
    c: Float[Array, "M A"],
    px: Float[Array, "A"],
    py: Float[Array, "A"],
    limit: Float[Array, "A"],
) -> tuple[Int[Array, "A"], Bool[Array, "A"]]:
    """The half-plane whose border has the nearest velocity in all of them, and whether there is such a velocity.

    It is the preferred velocity, M, or lies on a border: on each there is one candidate, the nearest point of the
    segment that the others allow. A point of border i is c n + t (-ny, nx); there, half-plane j is rate t >= bound.
    """
    lower, upper = _chord(c, limit[None])
    possible = upper > 0.0

    # A border that is parallel to another is wholly allowed by it, or not at all.
    rate = ny[None] * nx[:, None] - nx[None] * ny[:, None]  # (i, j, A)
    inverse = _inverse(rate)
    for j in range(len(c)):  # sums of this loop over an array (i, j, A) would not use vector instructions of a CPU
        cosine = nx * nx[j, None] + ny * ny[j, None]
        bound = c[j, None] - c * cosine
        crosses = inverse[:, j] != 0.0
        possible = possible & (crosses | (bound <= TOLERANCE))
        lower, upper = _cut(lower, upper, bound, inverse[:, j])
    possible = possible & (lower <= upper + TOLERANCE)

    # The candidate of each border.
    preferred = py[None] * nx - px[None] * ny
    upper = jnp.maximum(lower, upper)
    t = jnp.clip(preferred, lower, upper)
    x = c * nx - t * ny
    y = c * ny + t * nx
    square = (x - px[None]) ** 2 + (y - py[None]) ** 2
    square = jnp.where(possible, square, jnp.inf)

    # The square root is for XLA: it computes one only once, and would repeat all above in both reductions.
    best, smallest = _argmin(jnp.sqrt(square))
    return best, smallest < jnp.inf


def _inverse(rate: Array) -> Array:
    """1 / rate of a border along another one; 0 where they count as parallel."""
    crosses = jnp.abs(rate) > PARALLEL
    return 1.0 / jnp.where(crosses, rate, jnp.inf)


def _argmin(values: Float[Array, "M A"]) -> tuple[Int[Array, "A"], Float[Array, "A"]]:
    """The index of the first smallest value of each column, and the value; on a CPU quicker than ``jnp.argmin``."""
    smallest = values.min(0)
    index = jnp.arange(len(values), dtype=jnp.int32)[:, None]
    is_smallest = values <= smallest[None]
    first = jnp.where(is_smallest, index, len(values)).min(0)
    return first, smallest


def _cut(lower: Array, upper: Array, bound: Array, inverse: Array) -> tuple[Array, Array]:
    """The part of a segment where t / inverse >= bound; all of it where inverse is 0."""
    t = bound * inverse
    raises = (inverse > 0.0) & (t > lower)  # comparisons are quicker than ``maximum``, which passes NaN on
    lowers = (inverse < 0.0) & (t < upper)
    lower = jnp.where(raises, t, lower)
    upper = jnp.where(lowers, t, upper)
    return lower, upper


def _chord(c: Float[Array, "*M"], limit: Float[Array, "..."]) -> tuple[Float[Array, "*M"], Float[Array, "*M"]]:
    """The segment of a border within the top speed, from t to t; both are zero where there is none."""
    square = limit * limit - c * c
    exists = square > 0.0
    square = jnp.where(exists, square, 1.0)
    half = jnp.where(exists, jnp.sqrt(square), 0.0)
    return -half, half


# --- where no velocity is in all half-planes ---


def _least_violating_of_all(exists: Bool[Array, "A"], *operands: Array) -> Int[Array, "A"]:
    """``_least_violating`` of all agents, though velocities exist for some."""
    return _least_violating(*operands)


def _least_violating_of_few(exists: Bool[Array, "A"], *operands: Array) -> Int[Array, "A"]:
    """``_least_violating`` of the agents for whom no velocity exists; without a meaning for others."""
    n_agents = len(exists)
    few, many = TOGETHER
    size = min(n_agents, many if n_agents > 8 * few else few)
    rank = jnp.cumsum(~exists, dtype=jnp.int32)  # 1 for the first of these agents
    n_batches = (rank[-1] + size - 1) // size

    def search_batch(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        batch, pairs = carry
        ranks = batch * size + jnp.arange(1, size + 1, dtype=jnp.int32)
        agents = jnp.searchsorted(rank, ranks, method="scan_unrolled")
        chosen = [operand.take(agents, -1, mode="clip") for operand in operands]
        pairs_of_batch = _least_violating(*chosen)
        pairs = jax.lax.dynamic_update_slice(pairs, pairs_of_batch, (batch * size,))
        return batch + 1, pairs

    def is_left(carry: tuple[Array, Array]) -> Array:
        batch, _ = carry
        return batch < n_batches

    most_batches = -(-n_agents // size)
    no_batch = jnp.zeros((), jnp.int32)
    no_pairs = jnp.zeros(most_batches * size, jnp.int32)
    _, pairs = jax.lax.while_loop(is_left, search_batch, (no_batch, no_pairs))
    return pairs.take(rank - 1, mode="clip")


def _least_violating(
    nx: Float[Array, "M A"],
    ny: Float[Array, "M A"],
    c: Float[Array, "M A"],
    hard: Bool[Array, "M A"],
    px: Float[Array, "A"],
    py: Float[Array, "A"],
    limit: Float[Array, "A"],
) -> Int[Array, "A"]:
    """The pair of half-planes on whose ``_line`` the largest violation is smallest: i + M d is the pair i, i + d mod M.

    Three dimensions, the velocity and the violation, have three bounds at their optimum: two half-planes and a third or
    the top speed, or one and the top speed (d = 0).
    """
    planes = HalfPlanes(nx, ny, c, hard)
    px, py, limit = (values[None, None] for values in (px, py, limit))
    i, j = _pairs(planes)  # (d, i, A), as all below

    # Where both are violated equally: of a hard one the border.
    mx = jnp.where(j.hard, j.nx, j.nx - i.nx)
    my = jnp.where(j.hard, j.ny, j.ny - i.ny)
    b = jnp.where(j.hard, j.c, j.c - i.c)
    ax, ay, offset = _line(mx, my, b)

    # The end of that line's segment where both are violated least.
    lower, upper = _chord(offset, limit)
    lower, upper = _cut_by_others(planes, i, ax, ay, offset, lower, upper)
    x, y, opposite = _end(i.nx, i.ny, ax, ay, offset, lower, upper, px, py)

    # With itself, a half-plane is violated least at the top speed.
    distance = jnp.arange(len(i.c), dtype=jnp.int32)[:, None, None]
    alone = distance == 0
    x = jnp.where(alone, limit * i.nx, x)
    y = jnp.where(alone, limit * i.ny, y)
    opposite = opposite & ~alone

    violation = _violation(planes, x, y, limit)
    violation = violation - jnp.where(opposite, TOLERANCE, 0.0)  # other velocities are ends of the segment of these
    violation = jnp.sqrt(jnp.maximum(violation, 0.0))  # as in ``_nearest``
    pair, _ = _argmin(violation.reshape(-1, c.shape[1]))
    return pair


def _pairs(planes: HalfPlanes) -> tuple[HalfPlanes, HalfPlanes]:
    """All pairs of half-planes (d, i, A), the i-th and the one d after it; if only one is hard, it is the second."""
    distances = range(len(planes.c) // 2 + 1)
    first, second = [], []
    for rows in planes:
        first.append(jnp.stack([rows for _ in distances]))
        second.append(jnp.stack([jnp.roll(rows, -d, 0) for d in distances]))

    # A hard one changes places with the other.
    hard = HalfPlanes(*first).hard
    i, j = [], []
    for rows, other_rows in zip(first, second, strict=True):
        i.append(jnp.where(hard, other_rows, rows))
        j.append(jnp.where(hard, rows, other_rows))
    return HalfPlanes(*i), HalfPlanes(*j)


def _cut_by_others(
    planes: HalfPlanes,
    i: HalfPlanes,
    ax: Float[Array, "D M A"],
    ay: Float[Array, "D M A"],
    offset: Float[Array, "D M A"],
    lower: Float[Array, "D M A"],
    upper: Float[Array, "D M A"],
) -> tuple[Float[Array, "D M A"], Float[Array, "D M A"]]:
    """The parts of segments of lines where no half-plane is violated by more than i, or at all if hard."""
    hard = planes.hard[:, None, None]

    def eased(rows: Array, rows_of_i: Array) -> Array:
        return rows[:, None, None] - jnp.where(hard, 0.0, rows_of_i[None])  # (k, d, i, A)

    mx = eased(planes.nx, i.nx)
    my = eased(planes.ny, i.ny)
    b = eased(planes.c, i.c)
    rate = my * ax[None] - mx * ay[None]
    bound = b - offset[None] * (mx * ax[None] + my * ay[None])
    inverse = _inverse(rate)
    for k in range(len(planes.c)):
        lower, upper = _cut(lower, upper, bound[k], inverse[k])
    return lower, upper


def _violation(
    planes: HalfPlanes, x: Float[Array, "D M A"], y: Float[Array, "D M A"], limit: Float[Array, "1 1 A"]
) -> Float[Array, "D M A"]:
    """The largest violation [m/s] by velocities of all half-planes; of hard ones it counts many times."""
    soft = jnp.full_like(x, UNBOUNDED)
    forbidden = length(x, y) - limit
    for k in range(len(planes.c)):
        nx, ny, c, hard = (rows[k, None, None] for rows in planes)
        violation = c - nx * x - ny * y
        passed_over = hard | (violation < soft)
        soft = jnp.where(passed_over, soft, violation)
        counts = hard & (violation > forbidden)
        forbidden = jnp.where(counts, violation, forbidden)

    forbidden = jnp.maximum(forbidden - TOLERANCE, 0.0)
    return soft + FORBIDDEN * forbidden


def _line(mx: Array, my: Array, b: Array) -> tuple[Array, Array, Array]:
    """The unit normal and the offset of the line m . v = b; zeros if m is."""
    size = length(mx, my)
    exists = size > 0.0
    divisor = jnp.where(exists, size, 1.0)
    offset = jnp.where(exists, b / divisor, 0.0)
    ax, ay = unit(mx, my)
    return ax, ay, offset


def _end(
    ix: Float[Array, "*shape"],
    iy: Float[Array, "*shape"],
    ax: Float[Array, "*shape"],
    ay: Float[Array, "*shape"],
    offset: Float[Array, "*shape"],
    lower: Float[Array, "*shape"],
    upper: Float[Array, "*shape"],
    px: Float[Array, "..."],
    py: Float[Array, "..."],
) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"], Bool[Array, "*shape"]]:
    """The point (x, y) of the segment of a line that violates half-plane i least, and whether all points do.

    Then it is the point nearest to the preferred velocity (px, py).
    """
    gain = iy * ax - ix * ay
    same = jnp.abs(gain) <= PARALLEL
    upper = jnp.maximum(lower, upper)
    nearest = jnp.clip(py * ax - px * ay, lower, upper)
    least = jnp.where(gain > 0.0, upper, lower)
    t = jnp.where(same, nearest, least)
    x = offset * ax - t * ay
    y = offset * ay + t * ax
    return x, y, same


# --- the velocity, with derivatives ---


def _on_line(
    numbers: Int[Array, "M ..."],
    i: Int[Array, "*agents"],
    j: Int[Array, "*agents"],
    exists: Bool[Array, "*agents"],
    planes: HalfPlanes,
    px: Float[Array, "*agents"],
    py: Float[Array, "*agents"],
    limit: Float[Array, "*agents"],
) -> tuple[Float[Array, "*agents"], Float[Array, "*agents"]]:
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
    violated = jnp.where(swapped, j, i)
    j = jnp.where(swapped, i, j)
    ix = _row(nx, violated)
    iy = _row(ny, violated)

    # Half-plane k is violated by no more than i, where m . v >= b.
    eased = ~(hard | exists[None])
    mx, my, b = (rows - jnp.where(eased, _row(rows, violated)[None], 0.0) for rows in (nx, ny, c))
    ax, ay, offset = _line(_row(mx, j), _row(my, j), _row(b, j))

    # At t along the line half-plane k is t rate >= bound, so each shortens the chord below the top speed.
    lower, upper = _chord(offset, limit)
    rate = my * ax[None] - mx * ay[None]
    bound = b - offset[None] * (mx * ax[None] + my * ay[None])

    # Nearly parallel borders cut far off or never: t would be huge, and its derivative with it.
    crosses = (jnp.abs(rate) > PARALLEL) & (numbers != j[None])
    t = bound / jnp.where(crosses, rate, 1.0)
    raises = crosses & (rate > 0.0)
    lowers = crosses & (rate < 0.0)
    lower = jnp.maximum(lower, jnp.where(raises, t, -jnp.inf).max(0))
    upper = jnp.minimum(upper, jnp.where(lowers, t, jnp.inf).min(0))

    # With i and j fixed the velocity is smooth in the half-planes: derivatives come from here, not from the choice.
    x, y, _ = _end(ix, iy, ax, ay, offset, lower, upper, px, py)  # if it exists, i is parallel to the line
    x = jnp.where(alone, limit * ix, x)
    y = jnp.where(alone, limit * iy, y)
    return x, y


def _row(rows: Shaped[Array, "M *agents"], index: Int[Array, "*agents"]) -> Shaped[Array, "*agents"]:
    """One of the rows for each agent."""
    return jnp.take_along_axis(rows, index[None], 0, mode="clip")[0]
