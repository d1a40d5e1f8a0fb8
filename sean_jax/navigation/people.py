"""Ways of many people to a few points: which bend to head for from each cell, found once on the host."""

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from sean_jax import cache
from sean_jax.base import Array
from sean_jax.geometry import from_box, length
from sean_jax.navigation.bends import ANGLE, of_one, tangents
from sean_jax.navigation.sight import in_parts, led_out, sees, sees_each
from sean_jax.navigation.tables import CELL, CODE, Navigation, inputs
from sean_jax.navigation.ways import last_bends
from sean_jax.platforms import put

CLOSE = 0.8  # of the radius, as near as people come to obstacles: their bodies have 0.2 m, and their paths 0.25 m
REACH = 0.5  # m, at least, how far ahead they aim
TRIES = 4  # bends that are looked at
LONGER = 0.3  # m
AROUND = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1))  # cells around one


@struct.dataclass
class Towards:
    """What to head for on the way to each of M points: the index of a bend, or V for the point itself."""

    point: Array  # (M, 2) m
    first: Array  # (X, Y, M) int16, from a cell of 0.25 m; V also where there is no way
    onward: Array  # (M, V) int16, after a bend
    leave: Array  # (M, V) rad, where that is left


def towards(navigation: Navigation, points: Array) -> Towards:
    """The tables for the points (M, 2) [m]; made on the host, once for all processes."""
    made = cache.kept("towards", CODE, [*inputs(navigation), points], lambda: _make(navigation, points))
    return Towards(**put({"point": points, **made}))


def _make(navigation: Navigation, points: Array) -> dict[str, np.ndarray]:
    """The fields of ``Towards``.

    A cell takes what is best from the middle of its cell of the visibility grid, if from all its own corners the way
    begins clear. Else, of this and of what the cells around take, it takes that for which it does from most; but
    nothing that is much longer, or people would walk to and fro between two cells.
    """
    wide = round(float(navigation.cell) / CELL)
    best, lengths, leave, onward, ends = _best(navigation, points)
    best = np.repeat(np.repeat(np.asarray(best), wide, 0), wide, 1)  # (X, Y, M)
    ways = Towards(point=jnp.asarray(points, float), first=jnp.asarray(best), onward=onward, leave=leave)
    corners = [np.arange(count + 1, dtype=np.float32) * CELL for count in best.shape[:2]]
    spots = np.stack(np.meshgrid(*corners, indexing="ij"), -1).reshape(-1, 2) + np.asarray(navigation.origin)
    out, near, weight = in_parts(_spots, (navigation.obstacles, navigation.radius), spots)
    row = best.shape[1] + 1

    def ask(cells: np.ndarray, bend: np.ndarray) -> tuple[np.ndarray, ...]:
        """The corners of the cells (K, 3) for heading to a bend (K,), those against it, and the mean length [m]."""
        yes, no, far = np.zeros(len(cells)), np.zeros(len(cells)), np.zeros(len(cells))
        for corner in (0, 1, row, row + 1):
            spot = cells[:, 0] * row + cells[:, 1] + corner
            shared = navigation, ways, lengths, ends
            clear, length = in_parts(_begin, shared, out[spot], near[spot], cells[:, 2].astype(np.int32), bend)
            yes += weight[spot] * clear
            no += weight[spot] * ~clear
            far += weight[spot] * length
        return yes, no, far / np.maximum(yes + no, 1e-3)

    every = np.stack(np.meshgrid(*map(np.arange, best.shape), indexing="ij"), -1).reshape(-1, 3)
    yes, no, far = ask(every, best.reshape(-1))
    unsure = no > 0
    cells, yes, far = every[unsure], yes[unsure], far[unsure]
    result = best.copy()
    for step in AROUND:
        i, j = np.clip(cells[:, :2] + wide * np.array(step), 0, np.array(best.shape[:2]) - 1).T
        other = best[i, j, cells[:, 2]]
        more, _, farther = ask(cells, other)
        better = (more > yes + 1e-3) & (farther < far + LONGER)
        result[tuple(cells[better].T)] = other[better]
        yes = np.where(better, more, yes)
    return {"first": result, "onward": np.asarray(onward), "leave": np.asarray(leave)}


def ahead(navigation: Navigation, ways: Towards, position: Array, index: Array) -> Array:
    """(2,) [m] a point ahead on the way from the position (2,) to the point of that index (); a look-up."""
    most = jnp.asarray(ways.first.shape[:2], jnp.int32) - 1
    cell = jnp.clip(jnp.floor((position - navigation.origin) / CELL).astype(jnp.int32), 0, most)
    bend, _, _, touch, onward = _heading(navigation, ways, position, index, ways.first[cell[0], cell[1], index])
    return jnp.where(bend < navigation.bends.side.shape[0], _beyond(position, touch, onward), ways.point[index])


def next_point_roughly(navigation: Navigation, position: Array, goal: Array, to_goal: Array) -> Array:
    """As ``next_point``, for many people: of the best bends that are seen from the cells around, the first in sight."""
    boxes, radius = navigation.obstacles, navigation.radius
    most = jnp.asarray(navigation.visible.shape[:2], jnp.int32) - 1
    cell = jnp.floor((position - navigation.origin) / navigation.cell - 0.5).astype(jnp.int32)
    (i, j), (k, m) = jnp.clip(cell, 0, most), jnp.clip(cell + 1, 0, most)
    visible = navigation.visible
    seen = visible[i, j] | visible[k, j] | visible[i, m] | visible[k, m]
    spot, _ = led_out(boxes, position, radius)
    far, angle, _, _, on = tangents(navigation.bends, spot, radius, True)
    total = jnp.where(seen & on & (angle <= to_goal[1] + ANGLE), far - radius * angle + to_goal[0], jnp.inf)
    shortest, index = jax.lax.top_k(-total, min(TRIES, total.shape[0]))
    lost = ~jnp.isfinite(jnp.max(shortest))  # their first would be found anew, ten times slower on a CPU
    some = jax.tree.map(lambda part: part[index], navigation.bends)
    _, _, x, y, _ = tangents(some, spot, radius, True)
    x, y = jnp.append(x, goal[0]), jnp.append(y, goal[1])
    clear = sees_each(boxes, position, x, y, CLOSE * radius)
    chosen = index[jnp.argmax(clear[:-1])]  # the best, if none is in sight
    _, _, touch, onward = of_one(navigation.bends, chosen, spot, radius)
    return jnp.where(clear[-1] | lost, goal, _beyond(position, touch, onward))


def _beyond(position: Array, touch: Array, onward: Array) -> Array:
    """(2,) [m] the place (2,) where a tangent from the position (2,) touches, or farther along it."""
    gap = touch - position
    return touch + jnp.maximum(REACH - length(gap[0], gap[1]), 0.0) * onward


def _heading(navigation: Navigation, ways: Towards, position: Array, index: Array, bend: Array) -> tuple[Array, ...]:
    """() int32 the bend, or if the position (2,) is past it, what follows.

    And of the tangent to that what ``of_one`` gives.
    """
    none, radius = navigation.bends.side.shape[0], navigation.radius
    before = jnp.minimum(bend.astype(jnp.int32), none - 1)
    past = (bend < none) & (of_one(navigation.bends, before, position, radius)[0] > ways.leave[index, before])
    bend = jnp.where(past, ways.onward[index, before], bend).astype(jnp.int32)
    return bend, *of_one(navigation.bends, jnp.minimum(bend, none - 1), position, radius)


def _begin(shared: tuple, out: Array, near: Array, index: Array, bend: Array) -> tuple[Array, Array]:
    """() bool whether heading for that bend from a place (2,) that is led out of obstacles meets none before it.

    And () the length [m] of the way by that bend, in sight or not.
    """
    navigation, ways, lengths, (ends, end_near) = shared
    none = navigation.bends.side.shape[0]
    bend, angle, on, touch, _ = _heading(navigation, ways, out, index, bend)
    at_bend = bend < none
    touch = jnp.where(at_bend, touch, ends[index])
    near = jnp.where(at_bend, near, jnp.minimum(near, end_near[index]))
    rest = lengths[index, jnp.minimum(bend, none - 1)] - navigation.radius * angle
    far = length(touch[0] - out[0], touch[1] - out[1]) + jnp.where(at_bend, rest, 0.0)
    return (on | ~at_bend) & sees(navigation.obstacles, out, touch, near), far


@jax.jit
def _best(navigation: Navigation, points: Array) -> tuple:
    """(X, Y, M) int16 the best bend from the middle of each cell of the visibility grid.

    And (M, V) lengths [m] from the bends, ``leave`` and ``onward``; and the points, led out of obstacles.
    """
    none, obstacles, radius = navigation.bends.side.shape[0], navigation.obstacles, navigation.radius
    lengths, last, leave = jax.vmap(last_bends, in_axes=(None, 0))(navigation, points)
    own = jnp.arange(none, dtype=jnp.int32)[None, :]
    onward = jnp.where(last == own, none, navigation.onward[own, last].astype(jnp.int32)).astype(jnp.int16)
    ends, end_near = jax.vmap(led_out, in_axes=(None, 0, None))(obstacles, points, radius)

    def one(cell: Array) -> Array:
        spot = navigation.origin + (cell.astype(float) + 0.5) * navigation.cell
        out, near = led_out(obstacles, spot, radius)
        clear = jax.vmap(sees, in_axes=(None, None, 0, 0))(obstacles, out, ends, jnp.minimum(near, end_near))
        far, angle, *_ = tangents(navigation.bends, out, radius, True)
        seen = navigation.visible[cell[0], cell[1]][None, :] & (angle[None, :] <= leave + ANGLE)
        total = jnp.where(seen, (far - radius * angle)[None, :] + lengths, jnp.inf)
        lost = ~jnp.isfinite(jnp.min(total, axis=1))
        return jnp.where(clear | lost, none, jnp.argmin(total, axis=1).astype(jnp.int32)).astype(jnp.int16)

    count = navigation.visible.shape[:2]
    cells = jnp.stack(jnp.meshgrid(*(jnp.arange(n, dtype=jnp.int32) for n in count), indexing="ij"), -1)
    best = jax.lax.map(one, cells.reshape(-1, 2), batch_size=1024)
    return best.reshape(*count, points.shape[0]), lengths, leave, onward, (ends, end_near)


def _spots(shared: tuple, spot: Array) -> tuple[Array, Array, Array]:
    """The spot (2,) led out of obstacles, how near ways from there may pass, and how much it counts.

    Little where nobody can be, and nothing inside obstacles.
    """
    boxes, radius = shared
    room = jnp.min(jax.vmap(from_box, in_axes=(None, None, 0))(spot[0], spot[1], boxes)[0], initial=jnp.inf)
    weight = jnp.where(room >= CLOSE * radius, 1.0, jnp.where(room > 0.0, 0.01, 0.0))
    return *led_out(boxes, spot, radius), weight
