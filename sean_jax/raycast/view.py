"""The bodies around a sensor, in its frame: obstacles, decoration, people, the robot."""

import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float

from sean_jax.base import Array, Solids

AWAY = 1e6  # m, where absent people stand


@struct.dataclass
class View:
    """Bodies around a sensor, in the robot's axes and from the sensor: x ahead, y to the left, z up.

    Bodies have numbers: first boxes, then cylinders, spheres and people, then the floor, then the sky.
    """

    boxes: Float[Array, "boxes 8"]  # middle x, y, z, half extent x, y, z [m], cosine and sine of the yaw
    cylinders: Float[Array, "cylinders 8"]  # middle x, y, z [m], axis x, y, z, radius, half length [m]
    spheres: Float[Array, "spheres 4"]  # middle x, y, z, radius [m]
    people: Float[Array, "N 2"]  # m
    radius: Float[Array, ""]  # m, of a person's body
    height: Float[Array, ""]  # m, of the sensor above the floor

    @property
    def counts(self) -> tuple[int, int, int, int]:
        """Numbers of boxes, cylinders, spheres and people."""
        return self.boxes.shape[0], self.cylinders.shape[0], self.spheres.shape[0], self.people.shape[0]


def make_view(
    solids: Solids,
    people: Float[Array, "N 2"],
    present: Bool[Array, "N"],
    radius: Float[Array, ""],
    position: Float[Array, "2"],
    heading: Float[Array, "2"],
    origin: Float[np.ndarray, "3"],
) -> View:
    """Transform the bodies of the world to the frame of a sensor.

    Args:
        people: (N, 2) m, in the world.
        present: (N,) whether each person is there; absent ones are not seen.
        radius: m, of a person's body.
        position: (2,) m, of the robot.
        heading: (2,) unit vector, of the robot.
        origin: (3,) m, of the sensor in the robot's frame.
    """
    cosine, sine = heading[0], heading[1]
    place = jnp.asarray(origin, float)

    def transform(x: Array, y: Array) -> tuple[Array, Array]:
        x, y = x - position[0], y - position[1]
        return cosine * x + sine * y - place[0], cosine * y - sine * x - place[1]

    boxes, cylinders, spheres = solids.boxes, solids.cylinders, solids.spheres
    bx, by = transform(boxes[:, 0], boxes[:, 1])
    cx, cy = transform(cylinders[:, 0], cylinders[:, 1])
    sx, sy = transform(spheres[:, 0], spheres[:, 1])
    px, py = transform(people[:, 0], people[:, 1])
    yaw = cosine * boxes[:, 6] + sine * boxes[:, 7], cosine * boxes[:, 7] - sine * boxes[:, 6]
    ax, ay = cosine * cylinders[:, 3] + sine * cylinders[:, 4], cosine * cylinders[:, 4] - sine * cylinders[:, 3]
    return View(
        boxes=jnp.stack([bx, by, boxes[:, 2] - place[2], *boxes[:, 3:6].T, *yaw], -1),
        cylinders=jnp.stack([cx, cy, cylinders[:, 2] - place[2], ax, ay, *cylinders[:, 5:].T], -1),
        spheres=jnp.stack([sx, sy, spheres[:, 2] - place[2], spheres[:, 3]], -1),
        people=jnp.where(present[:, None], jnp.stack([px, py], -1), AWAY),
        radius=radius,
        height=place[2],
    )
