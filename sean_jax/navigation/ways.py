"""Ways to a goal, looked up inside jit: how long the shortest is, where it goes next and how much it turns."""

import jax
import jax.numpy as jnp

from sean_jax.base import Array
from sean_jax.geometry import angle_between, length
from sean_jax.navigation.bends import ANGLE, of_one, tangents
from sean_jax.navigation.sight import led_out, sees, sees_each
from sean_jax.navigation.tables import Navigation

STRIDE = 10.0  # degrees: how far ahead on the circle of a bend one aims, so that aiming there adds 1 % to the arc
LEAST = 5e-3  # m, that one aims ahead in any case


def to_goal(navigation: Navigation, goal: Array) -> Array:
    """(2, V) ways from each bend to a goal (2,) [m].

    Their lengths [m] from the middle of the bend, inf where there is none; and where they leave the bend [rad].
    """
    length, _, leave = last_bends(navigation, goal)
    return jnp.stack([length, leave])


def geodesic(navigation: Navigation, position: Array, goal: Array, to_goal: Array) -> Array:
    """() length [m] of the shortest path from the position (2,) to the goal (2,), whose ``to_goal`` (2, V) is given."""
    ahead = goal - position
    straight, around, *_ = first_bend(navigation, position, goal, to_goal)
    return jnp.where(straight, length(ahead[0], ahead[1]), around)


def geodesic_roughly(navigation: Navigation, position: Array, goal: Array, to_goal: Array) -> Array:
    """As ``geodesic``, but within about a cell: cheap enough for many positions at once."""
    ahead = goal - position
    straight = sees(navigation.obstacles, position, goal, 0.7 * navigation.radius)
    most = jnp.asarray(navigation.visible.shape[:2], jnp.int32) - 1
    index = jnp.clip(jnp.floor((position - navigation.origin) / navigation.cell).astype(jnp.int32), 0, most)
    far, angle, *_ = tangents(navigation.bends, position, navigation.radius, True)
    begin = jnp.where(navigation.visible[index[0], index[1]], far - navigation.radius * angle, jnp.inf)
    # Kept apart: the minimum of a sum is found some 20 times faster on a CPU than that of a choice.
    around = jnp.min(jax.lax.optimization_barrier(begin) + to_goal[0])
    return jnp.where(straight, length(ahead[0], ahead[1]), around)


def next_point(navigation: Navigation, position: Array, goal: Array, to_goal: Array) -> Array:
    """(2,) [m] a point ahead on the shortest path from the position (2,): the goal (2,) if it lies in sight.

    Else it is in the direction of the tangent to the next bend, up to 10 degrees farther than where that touches: who
    goes there, and from there to the next point, walks a path that is at most 1 % longer than the shortest.
    """
    straight, around, first, spot, near = first_bend(navigation, position, goal, to_goal)
    angle, _, touch, onward = of_one(navigation.bends, first, spot, navigation.radius)
    turn = jnp.clip(to_goal[1, first] - angle, 0.0, 2 * jnp.radians(STRIDE))
    far = touch + jnp.maximum(navigation.radius * jnp.tan(0.5 * turn), LEAST) * onward
    aim = jnp.where(sees(navigation.obstacles, spot, far, near), far, touch + LEAST * onward)
    return jnp.where(straight | ~jnp.isfinite(around), goal, aim)


def first_bend(navigation: Navigation, position: Array, goal: Array, to_goal: Array) -> tuple[Array, ...]:
    """How the way from the position (2,) to the goal (2,) [m] begins.

    () bool whether it is straight; () length [m] of the best way by a bend, inf if there is none; () int32 that bend;
    and (2,) [m] the position, led out of obstacles, with () [m] how near ways from there may pass.
    """
    bends, radius = navigation.bends, navigation.radius
    spot, near = led_out(navigation.obstacles, position, radius)
    end, end_near = led_out(navigation.obstacles, goal, radius)
    straight = sees(navigation.obstacles, spot, end, jnp.minimum(near, end_near))
    far, angle, x, y, on = tangents(bends, spot, radius, True)
    total = jnp.where(on & (angle <= to_goal[1] + ANGLE), far - radius * angle + to_goal[0], jnp.inf)
    # Of a corner's two bends only the better can be on the shortest path.
    half = total.shape[0] // 2
    right = total[half:] < total[:half]
    total, x, y = (jnp.where(right, part[half:], part[:half]) for part in (total, x, y))
    total = jnp.where(sees_each(navigation.obstacles, spot, x, y, near), total, jnp.inf)
    best = jnp.argmin(total).astype(jnp.int32)
    return straight, total[best], best + jnp.where(right[best], half, 0), spot, near


def turning(navigation: Navigation, position: Array, heading: Array, goal: Array, to_goal: Array) -> Array:
    """() rad: how much one turns, left and right added up, on the shortest path, beginning with the heading (2,).

    From the position (2,) to the goal (2,) [m], whose ``to_goal`` (2, V) is given; no turning at the goal.
    """
    bends, radius = navigation.bends, navigation.radius
    straight, around, first, spot, _ = first_bend(navigation, position, goal, to_goal)
    last = last_bends(navigation, goal)[1][first]
    enter, _, _, onward = of_one(bends, first, spot, radius)
    leave = tangents(bends, led_out(navigation.obstacles, goal, radius)[0], radius, False)[1][last]
    directly = straight | ~jnp.isfinite(around)
    begin = jnp.abs(angle_between(heading, jnp.where(directly, goal - position, onward)))
    return begin + jnp.where(directly, 0.0, navigation.turn[first, last] + leave - enter)


def last_bends(navigation: Navigation, goal: Array) -> tuple[Array, Array, Array]:
    """The shortest ways from the middle of each bend to the goal (2,) [m].

    (V,) lengths [m], inf where there is none; (V,) int32 last bends; (V,) rad where they leave the first one.
    """
    radius = navigation.radius
    end, near = led_out(navigation.obstacles, goal, radius)
    far, angle, x, y, on = tangents(navigation.bends, end, radius, False)
    seen = sees_each(navigation.obstacles, end, x, y, near)
    rest = jnp.where(on & seen, far + radius * angle, jnp.inf)
    own = jnp.arange(rest.shape[0], dtype=jnp.int32)

    def by(best: tuple, bend: tuple) -> tuple:
        index, distance, enter, angle, rest = bend
        total = jnp.where(enter <= angle + ANGLE, distance + rest, jnp.inf)
        shorter = total < best[0]
        return (jnp.where(shorter, total, best[0]), jnp.where(shorter, index, best[1])), None

    # One after the other: XLA on a CPU takes 30 times longer for an argmin over a square of them.
    rows = own, navigation.distance.T, navigation.enter.T, angle, rest
    (total, last), _ = jax.lax.scan(by, (jnp.full_like(rest, jnp.inf), own), rows)
    return total, last, jnp.where(last == own, angle[last], navigation.leave[own, last])
