"""Situations that obstacles make, beyond the paper's five: blind corner and narrow passage.

From the taxonomy of Francis et al., "Principles and Guidelines for Evaluating Social Robot Navigation Algorithms"
(2023), Fig. 7; the inequalities are ours. Both read ``moment.obstacles`` and do not hold where nothing is known of
them (None). They cost some W rays or N times W segments, so they are worth having only where they are wanted.
"""

import jax
import jax.numpy as jnp

from sean_jax.base import Array, Moment, Obstacles, Pedestrians
from sean_jax.classifiers.predicates import any_person, near, walking
from sean_jax.classifiers.situations import Thresholds
from sean_jax.geometry import crosses_box, rotate

STEPS = 4  # places ahead, besides the robot's own, at which the width of its way is measured
FAR = 1e3  # m, to what a ray does not hit


def blind_corner(moment: Moment, thresholds: Thresholds) -> Array:
    """Francis et al. Fig. 7 i: robot and person cannot see each other, and their ways meet behind the corner.

    Both moving and within 2 ``reach``; an obstacle at least ``hides`` high stands on the line between them; their
    ways, followed straight on, cross at more than the angle A, within ``reach`` of each, and no obstacle of any
    height stands on either way before that place.
    """
    obstacles = moment.obstacles
    if obstacles is None:
        return jnp.zeros((), bool)
    high = obstacles.height >= thresholds.hides

    def holds(agent: Pedestrians) -> Array:
        to_meet, agent_to_meet, cross = _meeting(moment.position, moment.heading, agent.position, agent.heading)
        place = moment.position + to_meet * moment.heading
        return (
            walking(moment.velocity, thresholds.moving)
            & walking(agent.velocity, thresholds.moving)
            & near(moment.position, agent.position, 2 * thresholds.reach)
            & (jnp.abs(cross) > jnp.sin(thresholds.angle))
            & (to_meet > 0)
            & (to_meet < thresholds.reach)
            & (agent_to_meet > 0)
            & (agent_to_meet < thresholds.reach)
            & (_blocks(obstacles, moment.position, agent.position) & high).any()
            & ~_blocks(obstacles, moment.position, place).any()
            & ~_blocks(obstacles, agent.position, place).any()
        )

    return any_person(moment, holds)


def narrow_passage(moment: Moment, thresholds: Thresholds) -> Array:
    """Francis et al. Fig. 7 j and k, hallway and doorway: with somebody near where two cannot pass without closeness.

    The way is narrow where obstacles to the left and right leave less than both radii and ``personal`` across: each
    keeping to its wall, the centres would still come within ``personal``. It is measured at right angles to the
    heading, at the robot and at four places up to ``personal`` ahead, as far as the way is free.
    """
    obstacles = moment.obstacles
    if obstacles is None:
        return jnp.zeros((), bool)
    dx, dy = moment.heading[0], moment.heading[1]
    left, right = jnp.stack([-dy, dx]), jnp.stack([dy, -dx])
    free = _to_nearest(obstacles, moment.position, moment.heading)
    limit = moment.robot_radius + moment.person_radius + thresholds.personal

    def narrow(ahead: Array) -> Array:
        place = moment.position + ahead * moment.heading
        width = _to_nearest(obstacles, place, left) + _to_nearest(obstacles, place, right)
        return (width < limit) & (ahead <= free)

    places = jnp.arange(STEPS + 1).astype(float) * (thresholds.personal / STEPS)
    somebody = any_person(moment, lambda agent: near(moment.position, agent.position, thresholds.near))
    return somebody & jax.vmap(narrow)(places).any()


def _meeting(x1: Array, d1: Array, x2: Array, d2: Array) -> tuple[Array, Array, Array]:
    """Distances [m] along two unit headings to where the lines cross, and the sine of the angle between them."""
    cross = d1[0] * d2[1] - d1[1] * d2[0]
    parallel = jnp.abs(cross) < 1e-6
    inverse = 1.0 / jnp.where(parallel, 1.0, cross)
    gap = x2 - x1
    first = (gap[0] * d2[1] - gap[1] * d2[0]) * inverse
    second = (gap[0] * d1[1] - gap[1] * d1[0]) * inverse
    return first, second, jnp.where(parallel, 0.0, cross)


def _blocks(obstacles: Obstacles, p: Array, q: Array) -> Array:
    """(W,) bool: which obstacles the straight line from p (2,) to q (2,) crosses."""
    return jax.vmap(lambda box: crosses_box(p[0], p[1], q[0], q[1], box, 0.0))(obstacles)


def _to_nearest(obstacles: Obstacles, place: Array, direction: Array) -> Array:
    """() m from a place (2,) along a unit direction (2,) to the nearest obstacle, ``FAR`` if none; 0 inside one."""

    def distance(box: Obstacles) -> Array:
        cosine, sine = jnp.cos(box.yaw), jnp.sin(box.yaw)
        x, y = rotate(place[0] - box.center[0], place[1] - box.center[1], cosine, -sine)
        dx, dy = rotate(direction[0], direction[1], cosine, -sine)
        near_x, far_x = _slab(x, dx, box.half_extent[0])
        near_y, far_y = _slab(y, dy, box.half_extent[1])
        enter, leave = jnp.maximum(near_x, near_y), jnp.minimum(far_x, far_y)
        return jnp.where((enter < leave) & (leave > 0), jnp.maximum(enter, 0.0), FAR)

    return jnp.min(jax.vmap(distance)(obstacles), initial=FAR)


def _slab(x: Array, dx: Array, half: Array) -> tuple[Array, Array]:
    """Where a ray enters and leaves |x| < half [m]."""
    steep = jnp.abs(dx) > 1e-9
    inverse = 1.0 / jnp.where(steep, dx, 1.0)
    one, other = (-half - x) * inverse, (half - x) * inverse
    within = jnp.abs(x) < half
    enter = jnp.where(steep, jnp.minimum(one, other), jnp.where(within, -FAR, FAR))
    return enter, jnp.where(steep, jnp.maximum(one, other), jnp.where(within, FAR, -FAR))
