"""Half-planes of velocities without a collision, and the best velocity in them.

ORCA: J. van den Berg, S. Guy, M. Lin & D. Manocha, "Reciprocal n-body collision avoidance", Robotics Research (2011).
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

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
    distance = length(dx, dy)
    ex, ey = unit(dx, dy)
    ex = jnp.where((ex == 0.0) & (ey == 0.0), jnp.where(first, 1.0, -1.0), ex)
    apart = distance > radii
    within = jnp.where(apart, horizon, time_step)
    # Along the line to the other and across it, mirrored so that the velocity lies to the left of the line.
    along, across = vx * ex + vy * ey - distance / within, vy * ex - vx * ey
    side = jnp.where(across > 0.0, 1.0, -1.0)
    across = across * side
    inverse = jnp.where(apart, 1.0 / jnp.where(apart, distance, 1.0), 0.0)
    beyond = jnp.where(apart, (distance - radii) * (distance + radii), 1.0)  # positive, however small the gap
    sine, cosine = radii * inverse, jnp.where(apart, jnp.sqrt(beyond) * inverse, 1.0)
    leg = apart & (along * cosine + across * sine > 0.0)
    size = length(along, across)
    tip_a, tip_b = unit(along, across)
    tip_a = jnp.where(size == 0.0, -1.0, tip_a)
    na, nb = jnp.where(leg, -sine, tip_a), jnp.where(leg, cosine, tip_b)
    out = radii / within - jnp.where(leg, across * cosine - along * sine, size)
    nb = nb * side
    return na * ex - nb * ey, na * ey + nb * ex, out


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
    px, py, limit = (jnp.broadcast_to(part, c.shape[1:]) for part in (px, py, limit))
    if not px.size:
        return px, py
    numbers = jnp.arange(c.shape[0], dtype=jnp.int32).reshape(-1, *(1 for _ in px.shape))
    hard = jnp.broadcast_to(hard.reshape(numbers.shape), c.shape)
    columns = (part.reshape(-1, px.size) for part in (nx, ny, c, hard))
    fixed = jax.lax.stop_gradient((*columns, px.reshape(-1), py.reshape(-1), limit.reshape(-1)))
    i, j, exists = (part.reshape(px.shape) for part in _deciding(*fixed))
    x, y = _on_line(numbers, i, j, exists, VelocityProgram(nx, ny, c, hard, px, py, limit))
    slower, free = _slower(px, py, limit), i == c.shape[0]
    return jnp.where(free, px * slower, x), jnp.where(free, py * slower, y)


def _slower(px: Array, py: Array, limit: Array) -> Array:
    """The factor that brings a velocity to the top speed, if it is faster."""
    speed = length(px, py)
    return jnp.where(speed > limit, limit / jnp.where(speed > limit, speed, 1.0), 1.0)


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
    free = (nx * (px * slower)[None] + ny * (py * slower)[None] >= c - TOLERANCE).all(0)

    def search(free: Array, *parts: Array, on_cpu: bool) -> tuple[Array, Array, Array]:
        nx, ny, c, _, px, py, limit = parts
        best, exists = _nearest(nx, ny, c, px, py, limit)
        best, exists = jnp.where(free, len(c), best), free | exists
        pair = _of_some(exists, *parts) if on_cpu else _least_violating(*parts)
        i, j = pair % len(c), (pair + pair // len(c)) % len(c)
        return jnp.where(exists, best, i), jnp.where(exists, best, j), exists

    def nothing(free: Array, *_: Array) -> tuple[Array, Array, Array]:
        preferred = jnp.full(free.shape, len(c), jnp.int32)
        return preferred, preferred, free

    def on_cpu(free: Array, *parts: Array) -> tuple[Array, Array, Array]:
        return jax.lax.cond(free.all(), nothing, partial(search, on_cpu=True), free, *parts)

    parts = free, nx, ny, c, hard, px, py, limit
    return jax.lax.platform_dependent(*parts, cpu=on_cpu, default=partial(search, on_cpu=False))


@_deciding.def_vmap
def _deciding_vmap(size: int, batched: list[bool], *parts: Array) -> tuple[tuple[Array, ...], tuple[bool, ...]]:
    rows = []
    for part, one in zip(parts, batched, strict=True):
        part = jnp.moveaxis(part, 0, -2) if one else jnp.repeat(part[..., None, :], size, -2)
        rows.append(part.reshape(*part.shape[:-2], -1))
    return tuple(part.reshape(size, -1) for part in _deciding(*rows)), (True, True, True)


def _nearest(nx: Array, ny: Array, c: Array, px: Array, py: Array, limit: Array) -> tuple[Array, Array]:
    """The half-plane (A,) whose border has the nearest velocity in all of them, and whether there is such a velocity.

    It is the preferred velocity, M, or lies on a border: on each there is one candidate, the nearest point of the
    segment that the others allow. A point of border i is c n + t (-ny, nx); there, half-plane j is rate t >= rest.
    """
    lower, upper = _chord(c, limit[None])
    possible = upper > 0.0
    rate = ny[None] * nx[:, None] - nx[None] * ny[:, None]  # (i, j, A)
    inverse = 1.0 / jnp.where(jnp.abs(rate) > PARALLEL, rate, jnp.inf)
    for j in range(len(c)):  # sums of this loop over an array (i, j, A) would not use vector instructions of a CPU
        rest = c[j, None] - c * (nx * nx[j, None] + ny * ny[j, None])
        possible = possible & ((inverse[:, j] != 0.0) | (rest <= TOLERANCE))
        lower, upper = _cut(lower, upper, rest, inverse[:, j])
    possible = possible & (lower <= upper + TOLERANCE)
    t = jnp.clip(py[None] * nx - px[None] * ny, lower, jnp.maximum(lower, upper))
    x, y = c * nx - t * ny, c * ny + t * nx
    # The square root is for XLA: it computes one only once, and would repeat all above in both reductions.
    away = jnp.sqrt(jnp.where(possible, (x - px[None]) ** 2 + (y - py[None]) ** 2, jnp.inf))
    best, least = _argmin(away)
    return best, least < jnp.inf


def _argmin(values: Float[Array, "M A"]) -> tuple[Int[Array, "A"], Float[Array, "A"]]:
    """The number of the first smallest value of each column, and the value; on a CPU quicker than ``jnp.argmin``."""
    least, numbers = values.min(0), jnp.arange(len(values), dtype=jnp.int32)
    return jnp.where(values <= least[None], numbers[:, None], len(values)).min(0), least


def _cut(lower: Array, upper: Array, rest: Array, inverse: Array) -> tuple[Array, Array]:
    """The part of a segment where t / inverse >= rest; all of it where inverse is 0."""
    bound = rest * inverse  # comparisons are quicker than ``maximum``, which passes NaN on
    return (
        jnp.where((inverse > 0.0) & (bound > lower), bound, lower),
        jnp.where((inverse < 0.0) & (bound < upper), bound, upper),
    )


def _chord(c: Float[Array, "*M"], limit: Float[Array, "..."]) -> tuple[Float[Array, "*M"], Float[Array, "*M"]]:
    """The segment of a border within the top speed, from t to t; both are zero where there is none."""
    square = limit * limit - c * c
    half = jnp.where(square > 0.0, jnp.sqrt(jnp.where(square > 0.0, square, 1.0)), 0.0)
    return -half, half


def _of_some(exists: Bool[Array, "A"], *parts: Array) -> Int[Array, "A"]:
    """``_least_violating`` of the agents for whom no velocity exists; without a meaning for others."""
    number = exists.shape[0]
    size = min(number, TOGETHER[number > 8 * TOGETHER[0]])
    rank = jnp.cumsum(~exists, dtype=jnp.int32)
    turns = (rank[-1] + size - 1) // size

    def turn(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        done, pairs = carry
        ranks = done * size + jnp.arange(1, size + 1, dtype=jnp.int32)
        agents = jnp.searchsorted(rank, ranks, method="scan_unrolled")
        pair = _least_violating(*(part.take(agents, -1, mode="clip") for part in parts))
        return done + 1, jax.lax.dynamic_update_slice(pairs, pair, (done * size,))

    pairs = jnp.zeros(-(-number // size) * size, jnp.int32)
    _, pairs = jax.lax.while_loop(lambda carry: carry[0] < turns, turn, (jnp.zeros((), jnp.int32), pairs))
    return pairs.take(rank - 1, mode="clip")


def _least_violating(
    nx: Array, ny: Array, c: Array, hard: Array, px: Array, py: Array, limit: Array
) -> Int[Array, "A"]:
    """The pair of half-planes on whose ``_line`` the largest violation is smallest: i + M d is the pair i, i + d mod M.

    Three dimensions, the velocity and the violation, have three bounds at their optimum: two half-planes and a third or
    the top speed, or one and the top speed (d = 0).
    """
    number, planes = len(c), (nx, ny, c, hard)
    px, py, limit = (part[None, None] for part in (px, py, limit))
    offsets = range(number // 2 + 1)
    first = tuple(jnp.stack([part for _ in offsets]) for part in planes)  # (d, i, A), as all below
    second = tuple(jnp.stack([jnp.roll(part, -d, 0) for d in offsets]) for part in planes)
    ix, iy, ic, _ = (jnp.where(first[3], other, own) for own, other in zip(first, second, strict=True))
    jx, jy, jc, j_hard = (jnp.where(first[3], own, other) for own, other in zip(first, second, strict=True))
    ax, ay, offset = _line(*(jnp.where(j_hard, j, j - i) for j, i in ((jx, ix), (jy, iy), (jc, ic))))
    lower, upper = _chord(offset, limit)
    mx, my, b = (
        part[:, None, None] - jnp.where(hard[:, None, None], 0.0, i[None]) for part, i in ((nx, ix), (ny, iy), (c, ic))
    )  # (k, d, i, A)
    rate, rest = my * ax[None] - mx * ay[None], b - offset[None] * (mx * ax[None] + my * ay[None])
    inverse = 1.0 / jnp.where(jnp.abs(rate) > PARALLEL, rate, jnp.inf)
    for k in range(number):
        lower, upper = _cut(lower, upper, rest[k], inverse[k])
    x, y, opposite = _end(ix, iy, ax, ay, offset, lower, upper, px, py)
    alone = jnp.arange(len(offsets), dtype=jnp.int32)[:, None, None] == 0
    x, y, opposite = jnp.where(alone, limit * ix, x), jnp.where(alone, limit * iy, y), opposite & ~alone
    soft, forbidden = jnp.full_like(x, UNBOUNDED), length(x, y) - limit
    for k in range(number):
        each = c[k, None, None] - nx[k, None, None] * x - ny[k, None, None] * y
        is_hard = hard[k, None, None]
        soft = jnp.where(is_hard | (each < soft), soft, each)
        forbidden = jnp.where(is_hard & (each > forbidden), each, forbidden)
    most = soft + FORBIDDEN * jnp.maximum(forbidden - TOLERANCE, 0.0)
    most = most - jnp.where(opposite, TOLERANCE, 0.0)  # other velocities are ends of the segment of these
    return _argmin(jnp.sqrt(jnp.maximum(most, 0.0)).reshape(-1, c.shape[1]))[0]  # the root as in ``_nearest``


def _line(mx: Array, my: Array, b: Array) -> tuple[Array, Array, Array]:
    """The unit normal and the offset of the line m . v = b; zeros if m is."""
    size = length(mx, my)
    return *unit(mx, my), jnp.where(size > 0.0, b / jnp.where(size > 0.0, size, 1.0), 0.0)


def _end(
    ix: Array, iy: Array, ax: Array, ay: Array, offset: Array, lower: Array, upper: Array, px: Array, py: Array
) -> tuple[Array, Array, Array]:
    """The point (x, y) of the segment of a line that violates half-plane i least, and whether all points do.

    Then it is the point nearest to the preferred velocity.
    """
    gain = iy * ax - ix * ay
    same = jnp.abs(gain) <= PARALLEL
    upper = jnp.maximum(lower, upper)
    t = jnp.where(same, jnp.clip(py * ax - px * ay, lower, upper), jnp.where(gain > 0.0, upper, lower))
    return offset * ax - t * ay, offset * ay + t * ax, same


def _on_line(numbers: Array, i: Array, j: Array, exists: Array, program: VelocityProgram) -> tuple[Array, Array]:
    """The velocity that half-planes (i, j) decide.

    If a velocity exists in all half-planes, it is the nearest to the preferred one on the border of j. Otherwise it
    violates i and j equally and as little as the violations of others, which are no larger, allow. If i and j oppose
    each other, all velocities of a segment are equally good, and it is the nearest to the preferred. A hard half-plane
    is not violated, but met on its border.
    """
    nx, ny, c, hard, px, py, limit = program

    def of(part: Array, index: Array) -> Array:
        return jnp.take_along_axis(part, index[None], 0, mode="clip")[0]

    swapped = of(hard, i)
    alone, (i, j) = ~exists & (i == j), (jnp.where(swapped, j, i), jnp.where(swapped, i, j))
    ix, iy = of(nx, i), of(ny, i)
    # Half-plane k is violated by no more than i, where m . v >= b.
    eased = ~(hard | exists[None])
    mx, my, b = (part - jnp.where(eased, of(part, i)[None], 0.0) for part in (nx, ny, c))
    ax, ay, offset = _line(of(mx, j), of(my, j), of(b, j))
    lower, upper = _chord(offset, limit)
    rate, rest = (
        my * ax[None] - mx * ay[None],
        b - offset[None] * (mx * ax[None] + my * ay[None]),
    )  # there, t rate >= rest
    others = (jnp.abs(rate) > PARALLEL) & (numbers != j[None])
    bound = rest / jnp.where(others, rate, 1.0)
    lower = jnp.maximum(lower, jnp.where(others & (rate > 0.0), bound, -jnp.inf).max(0))
    upper = jnp.minimum(upper, jnp.where(others & (rate < 0.0), bound, jnp.inf).min(0))
    x, y, _ = _end(ix, iy, ax, ay, offset, lower, upper, px, py)  # if it exists, i is parallel to the line
    return jnp.where(alone, limit * ix, x), jnp.where(alone, limit * iy, y)
