"""The bodies around a sensor, in its frame: obstacles, what else stands in the environment, people, the robot."""

import jax.numpy as jnp
from flax import struct

from sean_jax.base import Array, Solids

AWAY = 1e6  # m, where somebody absent stands


@struct.dataclass
class View:
    """Bodies about a sensor, turned as the robot is: x ahead, y to the left, z up, from the sensor.

    Bodies are numbered through: boxes, cylinders, spheres, people; then come the floor and the sky.
    """

    boxes: Array  # (B, 8): middle x, y, z, half extent x, y, z [m], cosine and sine of the yaw
    cylinders: Array  # (C, 8): middle x, y, z [m], axis x, y, z, radius, half length [m]
    spheres: Array  # (S, 4): middle x, y, z, radius [m]
    people: Array  # (N, 2) m
    radius: Array  # () m, of a person's body
    height: Array  # () m, of the sensor above the floor

    @property
    def counts(self) -> tuple[int, int, int, int]:
        """How many boxes, cylinders, spheres and people there are."""
        return self.boxes.shape[0], self.cylinders.shape[0], self.spheres.shape[0], self.people.shape[0]


def look(solids: Solids, people: Array, present: Array, radius: Array, position: Array, heading: Array, origin) -> View:
    """The view of a sensor at ``origin`` (3,) m in the frame of a robot at ``position`` (2,) m with ``heading`` (2,).

    ``solids`` and ``people`` (N, 2) m, of whom those ``present`` (N,) are seen, are given over the ground.
    """
    cosine, sine = heading[0], heading[1]
    place = jnp.asarray(origin, float)

    def seen(x: Array, y: Array) -> tuple[Array, Array]:
        x, y = x - position[0], y - position[1]
        return cosine * x + sine * y - place[0], cosine * y - sine * x - place[1]

    boxes, cylinders, spheres = solids.boxes, solids.cylinders, solids.spheres
    bx, by = seen(boxes[:, 0], boxes[:, 1])
    cx, cy = seen(cylinders[:, 0], cylinders[:, 1])
    sx, sy = seen(spheres[:, 0], spheres[:, 1])
    px, py = seen(people[:, 0], people[:, 1])
    turned = cosine * boxes[:, 6] + sine * boxes[:, 7], cosine * boxes[:, 7] - sine * boxes[:, 6]
    ax, ay = cosine * cylinders[:, 3] + sine * cylinders[:, 4], cosine * cylinders[:, 4] - sine * cylinders[:, 3]
    return View(
        boxes=jnp.stack([bx, by, boxes[:, 2] - place[2], *boxes[:, 3:6].T, *turned], -1),
        cylinders=jnp.stack([cx, cy, cylinders[:, 2] - place[2], ax, ay, *cylinders[:, 5:].T], -1),
        spheres=jnp.stack([sx, sy, spheres[:, 2] - place[2], spheres[:, 3]], -1),
        people=jnp.where(present[:, None], jnp.stack([px, py], -1), AWAY),
        radius=radius,
        height=place[2],
    )
