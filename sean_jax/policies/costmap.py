"""A cost map around the robot in layers, as ROS's navigation stack and its social layers [49] have them.

Costs are those of ROS: 0 is free, 252 the most that can be driven over, 253 touches. The layers are obstacles with
their inflation, people's bodies likewise, as a lidar sees them, and the proxemic layer (D. V. Lu, D. Hershberger &
W. D. Smart, "Layered costmaps for context-sensitive navigation", IROS 2014; the formula as in navigation_layers, the
numbers as in SEAN 2.0's configuration). A cell has the most that any layer gives it.
"""

import jax
import jax.numpy as jnp
from flax import struct

from sean_jax.base import Array, Pedestrians, Scenario
from sean_jax.geometry import from_rectangle, length, to_border
from sean_jax.nearby import around

TOUCHES = 253.0  # the disc of the robot touches something there
MOST = 252.0  # beside that


@struct.dataclass
class Layers:
    """Numbers of the layers; all leaves are () floats."""

    amplitude: Array  # A, cost in the middle of a person (77)
    cutoff: Array  # less is none (10)
    covariance: Array  # m2, C of somebody who stands (SEAN 0.1; the package's default is 0.25)
    factor: Array  # s/m, by how much more it is ahead for each m/s (5)
    inflation: Array  # m, beyond touching, within which inflation costs something (0.3)
    decay: Array  # 1/m, at which that falls (10)


@struct.dataclass
class Window:
    """A square of cells that rolls with the robot; the middle of the first cell is its origin."""

    origin: Array  # (2,) m
    cell: Array  # () m


def window(middle: Array, cell: Array, count: int) -> Window:
    """The window of ``count`` x ``count`` cells around a place (2,) [m], moved by whole cells."""
    first = jnp.round(jax.lax.stop_gradient(middle) / cell) - (count // 2)
    return Window(first * cell, cell)


def middles(over: Window, count: int) -> tuple[Array, Array]:
    """(count, count) m and m: x and y of the middles of the cells, x along the first axis."""
    steps = jnp.arange(count, dtype=float) * over.cell
    x, y = over.origin[0] + steps, over.origin[1] + steps
    return jnp.broadcast_to(x[:, None], (count, count)), jnp.broadcast_to(y[None, :], (count, count))


def cell_of(over: Window, count: int, x: Array, y: Array) -> tuple[Array, Array]:
    """int32 indices of the cells in which places x, y [m] lie, or of the nearest ones."""
    i = jnp.round((x - over.origin[0]) / over.cell).astype(jnp.int32)
    j = jnp.round((y - over.origin[1]) / over.cell).astype(jnp.int32)
    return jnp.clip(i, 0, count - 1), jnp.clip(j, 0, count - 1)


def proxemic(layers: Layers, dx: Array, dy: Array, vx: Array, vy: Array) -> Array:
    """Cost at a place that lies d [m] from somebody who walks at v [m/s]: a Gaussian that is longer ahead of them.

    A exp(-(mx^2 / (2 sx) + my^2 / (2 sy))) with m along and across the heading, sy = C, and sx = C (1 + 5 |v|) ahead
    and C behind; 0 below the cutoff. Whole numbers, as in the map, but with the gradient of the Gaussian.
    """
    speed = length(vx, vy)
    standing = speed < 1e-6
    hx = jnp.where(standing, 1.0, vx / jnp.where(standing, 1.0, speed))
    hy = jnp.where(standing, 0.0, vy / jnp.where(standing, 1.0, speed))
    along, across = dx * hx + dy * hy, dy * hx - dx * hy
    ahead = layers.covariance * jnp.where(along > 0.0, 1.0 + layers.factor * speed, 1.0)
    cost = layers.amplitude * jnp.exp(-(along * along / (2.0 * ahead) + across * across / (2.0 * layers.covariance)))
    return jnp.where(cost < layers.cutoff, 0.0, cost - jax.lax.stop_gradient(cost - jnp.floor(cost)))


def inflated(layers: Layers, gap: Array) -> Array:
    """Cost where there are ``gap`` [m] between the robot's disc and what it must not touch: costmap_2d's inflation."""
    near = MOST * jnp.exp(-layers.decay * jnp.maximum(gap, 0.0))
    return jnp.where(gap <= 0.0, TOUCHES, jnp.where(gap <= layers.inflation, near, 0.0))


def costs(scenario: Scenario, layers: Layers, people: Pedestrians, x: Array, y: Array) -> Array:
    """Costs at places x, y (...) [m] of one shape, among the people (K) that are given."""
    shape, radius = x.shape, scenario.robot.radius
    x, y = x.ravel(), y.ravel()
    rows = around(scenario.environment.nearby, x, y)
    walls = from_rectangle(x[:, None], y[:, None], *(rows[..., part] for part in range(6)))[0]
    edge = to_border(scenario.environment, x, y)
    gap = jnp.minimum(jnp.min(walls, 1), edge) - radius

    def person(px: Array, py: Array, vx: Array, vy: Array, present: Array) -> tuple[Array, Array]:
        dx, dy = x - px, y - py
        body = length(dx, dy) - radius - scenario.forces.radius
        social = proxemic(layers, dx, dy, vx, vy)
        return jnp.where(present, body, jnp.inf), jnp.where(present, social, 0.0)

    (px, py), (vx, vy) = people.position.T, people.velocity.T
    bodies, social = jax.vmap(person)(px, py, vx, vy, people.present)
    gap = jnp.minimum(gap, jnp.min(bodies, 0, initial=jnp.inf))
    return jnp.maximum(inflated(layers, gap), jnp.max(social, 0, initial=0.0)).reshape(shape)
