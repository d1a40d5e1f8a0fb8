"""Walls and contact (section IV-D, low level): the wall force, the guarantee that no body enters an obstacle, bodies
that touch, and how short the steps of stiff bodies must be.

[HM95] D. Helbing & P. Molnar, Phys. Rev. E 51, 4282 (1995). [H00] D. Helbing, I. Farkas & T. Vicsek, Nature 407, 487
(2000). [S2] SEAN 2.0's published code.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Float

from sean_jax.core import gpu_kernels
from sean_jax.core.data_types import Array, ObstacleGrid
from sean_jax.core.devices import by_platform
from sean_jax.core.geometry import from_rectangle, length, nearby_obstacles, rotate, sum_vectors
from sean_jax.social_forces import kernel
from sean_jax.social_forces.forces import MAX_EXPONENT, TINY, Crowd, Force, Forces, Pair, Walking, components

SUBSTEP = 0.05  # s, at most: a tenth of the relaxation time
NEIGHBORS = 6  # bodies that touch a body in the densest packing; they make its stiffest mode
OVERLAP = 0.01  # m, up to which friction is stable in that packing; where fewer touch, at deeper overlaps
SLACK = 1e-3  # m/s, or rounding would stop people along a wall: 0.05 mm in a step of 0.05 s
SWAY = 0.08  # m, by which bodies may leave their straight way: through a door that is so much wider they go freely
MIN_APPROACH = 1e-9  # m/s, a slower approach is none, for the gradient of a share of it would overflow


@struct.dataclass
class Walls:
    """A push A exp((reach - distance) / R) of each obstacle along its normal.

    Source: [HM95], eq. (5): the negative gradient of U(d) = U0 exp(-d / R), with A = U0 / R.
    """

    limits: ClassVar[dict[str, tuple[float, float]]] = {
        "strength": (-1e6, 1e6),
        "range": (1e-3, 1e3),
    }

    strength: Float[Array, ""]  # m/s2, A
    range: Float[Array, ""]  # m, R
    reach: Float[Array, ""]  # m
    distance_factor: Float[Array, ""]  # 1/m or 0: 1 multiplies the force by the distance, as [S2] does

    def person(self, crowd: Crowd) -> Force | None:
        """The push (N,) [m/s2] of all obstacles on each person; None if there are no obstacles."""
        if crowd.obstacle_grid is None:
            return None
        px, py = components(crowd.people.position)
        return wall_forces(self, px, py, crowd.obstacle_grid, crowd.forces.walking.perception)


def distances(
    px: Float[Array, "N"], py: Float[Array, "N"], grid: ObstacleGrid
) -> tuple[Float[Array, "N K"], Float[Array, "N K"], Float[Array, "N K"]]:
    """Signed distances [m] of people from the surfaces of the obstacles near them, and the unit normals there."""
    rows = nearby_obstacles(grid, px, py)  # (N, K, 6)
    columns = [rows[..., column] for column in range(6)]
    return from_rectangle(px[:, None], py[:, None], *columns)


def wall_forces(
    parameters: Walls,
    px: Float[Array, "N"],
    py: Float[Array, "N"],
    grid: ObstacleGrid,
    perception: Float[Array, ""] | float,
) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
    """The push [m/s2] of all obstacles within ``perception`` [m] on people at (px, py) [m]."""
    return _at_obstacles(_total_push, px, py, grid, parameters, perception)


def _total_push(total: Callable, smallest: Callable, parameters: Walls, perception: Array) -> Force:
    return total(_wall_push, parameters, perception)


def _wall_push(distance: Array, nx: Array, ny: Array, parameters: Walls, perception: Array) -> Force:
    """The push [m/s2] of one obstacle at that distance [m] and normal."""
    exponent = (parameters.reach - distance) * (1.0 / parameters.range)  # a hundred and more in a wide wall
    size = parameters.strength * jnp.exp(jnp.minimum(exponent, MAX_EXPONENT))
    size = size * (1.0 + parameters.distance_factor * (distance - 1.0))
    size = jnp.where(distance < perception, size, 0.0)
    return size * nx, size * ny


def project_velocity(
    px: Float[Array, "N"],
    py: Float[Array, "N"],
    vx: Float[Array, "N"],
    vy: Float[Array, "N"],
    grid: ObstacleGrid,
    radius: Float[Array, ""] | float,
    time_step: Float[Array, ""] | float,
    friction: Float[Array, ""] | float | None = None,
) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
    """Velocities [m/s] projected so that no body ends the step inside an obstacle.

    A body may approach an obstacle by no more than its gap [m] in one step: n . v >= -gap / time_step. For a convex
    obstacle this linear bound is exact or stricter. All violated bounds are met together, which is exact at the inner
    corner of two walls and moves a body out that is inside (a negative gap). Where that violates another bound, as in
    an acute corner, the velocity is shortened until it does not.

    Friction: the guarantee replaces the body force k g of [H00] at walls. Where it takes away n . v = u in a step, it
    has pushed with u / time_step, so the friction kappa g is (kappa / k) u / time_step. An implicit step of it divides
    the speed along the wall by 1 + (kappa / k) u, which reverses nobody, however long the step.

    Args:
        radius: m, of the bodies.
        friction: s/m, kappa / k of [H00]; None without friction.
    """
    return _at_obstacles(_project, px, py, grid, vx, vy, radius, time_step, friction)


def limit_approach(
    px: Float[Array, "N"],
    py: Float[Array, "N"],
    vx: Float[Array, "N"],
    vy: Float[Array, "N"],
    grid: ObstacleGrid,
    radius: Float[Array, ""] | float,
    time: Float[Array, ""] | float,
) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
    """Velocities [m/s] of bodies that do not approach what lies on their way faster than their gap in some time [s].

    An obstacle beside the way, such as the posts of a door, limits nothing. In an acute corner the result may still
    approach an obstacle too fast; ``project_velocity`` guarantees that none is entered.

    Args:
        radius: m, of the bodies.
    """
    return _at_obstacles(_limit, px, py, grid, px, py, vx, vy, radius, time)


def _limit(
    total: Callable,
    smallest: Callable,
    px: Array,
    py: Array,
    vx: Array,
    vy: Array,
    radius: Array | float,
    time: Array | float,
) -> tuple[Array, Array]:
    """``limit_approach`` of one person."""
    x, y = total(_correction_ahead, px, py, vx, vy, radius, time)
    return vx + x, vy + y


def _correction_ahead(row, px, py, vx, vy, radius, time) -> tuple[Array, Array]:
    """``_correction`` of an obstacle on the way of a body that goes straight on, else 0."""
    # It lies beside the way if the line of motion passes its corners at the radius or more, in the obstacle's own axes.
    cx, cy, hx, hy, cosine, sine = row
    pu, pv = rotate(px - cx, py - cy, cosine, -sine)
    du, dv = rotate(vx, vy, cosine, -sine)
    offset = jnp.abs(pu * dv - pv * du)  # m, times the speed, as are the others
    reach = hx * jnp.abs(dv) + hy * jnp.abs(du) + (radius + SWAY) * length(vx, vy)

    distance, nx, ny = from_rectangle(px, py, *row)
    x, y = _correction(distance, nx, ny, vx, vy, radius, time)
    is_ahead = offset < reach
    return jnp.where(is_ahead, x, 0.0), jnp.where(is_ahead, y, 0.0)


_correction_ahead.of_row = True  # it takes the obstacle itself, not the distance and the normal


def _project(
    total: Callable,
    smallest: Callable,
    vx: Array,
    vy: Array,
    radius: Array | float,
    time_step: Array | float,
    friction: Array | float | None,
) -> tuple[Array, Array]:
    """``project_velocity`` of one person."""
    free_x = vx
    free_y = vy
    x, y = total(_correction, vx, vy, radius, time_step)
    vx = vx + x
    vy = vy + y
    if friction is not None:
        x, y = total(_rubbing, free_x, free_y, vx, vy, radius, time_step, friction)
        vx = vx + x
        vy = vy + y
    share = smallest(_allowed_share, vx, vy, radius, time_step)
    return vx * share, vy * share


def _excess(distance, nx, ny, vx, vy, radius, time_step) -> Array:
    """The speed [m/s] by which a velocity approaches one obstacle too fast."""
    least = (radius - distance) / time_step  # m/s, of the velocity along the normal
    return jnp.maximum(least - (nx * vx + ny * vy), 0.0)


def _correction(distance, nx, ny, vx, vy, radius, time_step) -> tuple[Array, Array]:
    """The change of velocity [m/s] that meets the bound of one obstacle."""
    excess = _excess(distance, nx, ny, vx, vy, radius, time_step)
    return excess * nx, excess * ny


def _rubbing(distance, nx, ny, free_x, free_y, vx, vy, radius, time_step, friction) -> tuple[Array, Array]:
    """The change of velocity [m/s] by friction at an obstacle that has stopped the velocity (free_x, free_y)."""
    excess = _excess(distance, nx, ny, free_x, free_y, radius, time_step)
    decrease = (ny * vx - nx * vy) * (1.0 - 1.0 / (1.0 + friction * excess))
    return -decrease * ny, decrease * nx


def _allowed_share(distance, nx, ny, vx, vy, radius, time_step) -> Array:
    """The share of a velocity, at most 1, with which no body reaches one obstacle."""
    approach = -(nx * vx + ny * vy)
    gap = distance - radius
    allowed = jnp.maximum(gap / time_step + SLACK, MIN_APPROACH)
    too_fast = approach > allowed
    divisor = jnp.where(too_fast, approach, 1.0)
    return jnp.where(too_fast, allowed / divisor, 1.0)


def _at_obstacles(function: Callable, px: Array, py: Array, grid: ObstacleGrid, *arguments: Any) -> tuple[Array, Array]:
    """``function(total, smallest, *arguments)`` of each person, elementwise; arguments are (N,) or for all people.

    ``total(law, *arguments)`` gives the sums x and y, over the obstacles near the person, of
    ``law(distance, nx, ny, *arguments)``; ``smallest`` gives the minimum of a law, at most 1.
    """

    def at_once(px: Array, py: Array, grid: ObstacleGrid, *arguments: Any) -> tuple[Array, Array]:
        over = partial(_at_once, px, py, nearby_obstacles(grid, px, py))
        total = partial(over, lambda pushes: sum_vectors(pushes[0], pushes[1], 1))
        smallest = partial(over, lambda values: values.min(1))
        return function(total, smallest, *arguments)

    def one_by_one(px: Array, py: Array, grid: ObstacleGrid, *arguments: Any) -> tuple[Array, Array]:
        over = partial(_one_by_one, px, py, nearby_obstacles(grid, px, py))
        total = partial(over, _add, (jnp.zeros_like(px),) * 2)
        smallest = partial(over, jnp.minimum, jnp.ones_like(px))
        return function(total, smallest, *arguments)

    default = one_by_one
    single = all(jnp.result_type(leaf) == np.float32 for leaf in jax.tree.leaves((px, arguments)))
    if single and len(px) and gpu_kernels.available():
        default = partial(kernel.at_obstacles, partial(_in_kernel, function))
    return by_platform(at_once, default)(px, py, grid, *arguments)


def _value(law: Callable, px: Array, py: Array, row: Any, arguments: tuple) -> Any:
    """The law of one person and one obstacle."""
    if getattr(law, "of_row", False):
        return law(row, *arguments)
    distance, nx, ny = from_rectangle(px, py, *row)
    return law(distance, nx, ny, *arguments)


def _add(total: tuple, push: tuple) -> tuple:
    return total[0] + push[0], total[1] + push[1]


def _at_once(px: Array, py: Array, rows: Array, reduce: Callable, law: Callable, *arguments: Any) -> Any:
    """The law for all obstacles (N, K), then reduced."""
    by_obstacles = jax.vmap(partial(_value, law), (None, None, 0, None))
    argument_axes = jax.tree.map(lambda leaf: 0 if jnp.ndim(leaf) else None, arguments)
    on_people = jax.vmap(by_obstacles, (0, 0, 0, argument_axes))
    return reduce(on_people(px, py, rows, arguments))


def _one_by_one(px: Array, py: Array, rows: Array, join: Callable, start: Any, law: Callable, *arguments: Any) -> Any:
    """The law joined to the start for one obstacle after the other.

    XLA for a GPU writes arrays (N, K) to memory and reads them again for each sum over K; one by one it makes a single
    kernel, which would be slow on a CPU.
    """

    def join_next(total: Any, row: tuple) -> tuple:
        value = _value(law, px, py, row, arguments)
        return join(total, value), None

    columns = tuple(rows[..., column].T for column in range(rows.shape[2]))
    total, _ = jax.lax.scan(join_next, start, columns, unroll=rows.shape[1])
    return total


def _in_kernel(function: Callable, over: Callable, px: Any, py: Any, *arguments: Any) -> tuple:
    """The function of one person in a kernel; ``over(step, start)`` goes through the rows of the obstacles."""

    def join(add: Callable, start: Any, law: Callable, *arguments: Any) -> Any:
        value = gpu_kernels.scalars(partial(_value, law))

        def step(total: Any, row: Any) -> Any:
            return add(total, value(px, py, row, arguments))

        return over(step, start)

    zero = px.dtype.type(0.0)
    one = px.dtype.type(1.0)
    total = partial(join, _add, (zero, zero))
    smallest = partial(join, jnp.minimum, one)
    return function(total, smallest, *arguments)


@struct.dataclass
class Contact:
    """A push of two discs in proportion to their overlap g, and sliding friction between them.

    As printed in [H00]: the body force k g n and the sliding friction kappa g ((w - v) . t) t, with n along d and t
    across it. At obstacles ``walls.project_velocity`` takes the place of the body force.
    """

    limits: ClassVar[dict[str, tuple[float, float]]] = {
        "stiffness": (0.0, 1e6),
        "friction": (0.0, 1e6),
        "margin": (0.0, 10.0),
    }

    relations: ClassVar[dict[str, Callable[[Any], Any]]] = {
        "friction of bodies without stiffness": lambda term: term.friction is not None and term.stiffness <= 0,
    }

    stiffness: Float[Array, ""]  # 1/s2, by which overlapping bodies part: k / m of [H00]
    friction: Float[Array, ""] | None = None  # 1/(m s), of bodies that slide: kappa / m of [H00]; None: not computed
    margin: Float[Array, ""] | None = None  # m, the gap at which bodies begin to push: clothes and arms; None: 0

    def pair(self, pair: Pair) -> Force:
        """The push and the friction [m/s2], zero unless the two touch or are within ``margin``."""
        dx = pair.dx
        dy = pair.dy
        dd = dx * dx + dy * dy + TINY
        inverse = jax.lax.rsqrt(dd)
        reach = pair.radii
        if self.margin is not None:
            reach = reach + self.margin
        overlap = jnp.maximum(reach - dd * inverse, 0.0)
        push = self.stiffness * overlap * inverse
        if self.friction is None:
            return push * dx, push * dy
        slide = (pair.wy - pair.vy) * dx - (pair.wx - pair.vx) * dy
        rub = self.friction * overlap * inverse * inverse * slide
        return push * dx - rub * dy, push * dy + rub * dx

    def cutoff(self, walking: Walking) -> Array:
        """The distance [m] at which bodies begin to push."""
        margin = 0.0
        if self.margin is not None:
            margin = self.margin
        return 2.0 * walking.radius + margin


def longest_step(forces: Forces) -> float:
    """The longest step [s] with which touching bodies stay stable, ``SUBSTEP`` at most. Runs on the host.

    Semi-implicit Euler of a spring of frequency w that friction damps at a rate c is stable while
    (w step)^2 + 2 c step < 4. In the densest packing the largest w^2 is 6 k and, at an overlap g, the largest c is
    6 kappa g, with k = ``stiffness`` and kappa = ``friction``; that both belong to one motion is the worst case.
    """
    contact = forces.get(Contact)
    if contact is None:
        return SUBSTEP
    largest = float(np.max(np.asarray(contact.stiffness)))
    stiffness = NEIGHBORS * max(largest, 1e-9)
    friction = 0.0
    if contact.friction is not None:
        friction = float(np.max(np.asarray(contact.friction)))
    rate = NEIGHBORS * OVERLAP * friction
    stable = (math.sqrt(rate**2 + 4.0 * stiffness) - rate) / stiffness
    return min(SUBSTEP, stable)


def substeps(forces: Forces, time_step: float) -> int:
    """The number of steps of the social forces, 1 or more, in a control step of ``time_step`` [s]."""
    return math.ceil(time_step / longest_step(forces) - 1e-6)
