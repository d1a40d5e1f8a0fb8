"""Vectors in components: arrays of x, of y and of z, each of any shape."""

from typing import Any, NamedTuple

from sean_jax.core.data_types import Array


class Vector(NamedTuple):
    """A vector in space, or one for each ray. ``+`` adds vectors, and ``*`` multiplies by a number or an array."""

    x: Array
    y: Array
    z: Array

    def __add__(self, other: Any) -> "Vector":
        return Vector(self.x + other.x, self.y + other.y, self.z + other.z)

    def __sub__(self, other: Any) -> "Vector":
        return Vector(self.x - other.x, self.y - other.y, self.z - other.z)

    def __mul__(self, factor: Any) -> "Vector":
        return Vector(factor * self.x, factor * self.y, factor * self.z)

    def scaled(self, factors: "Vector") -> "Vector":
        """The vector with each component multiplied by one of its own."""
        return Vector(self.x * factors.x, self.y * factors.y, self.z * factors.z)

    def raised(self, height: Any) -> "Vector":
        """The vector to a place that is higher."""
        return Vector(self.x, self.y, self.z + height)


def dot(a: Vector, b: Vector) -> Array:
    """The inner product."""
    products = a.scaled(b)
    return products.x + products.y + products.z


def to_frame(x: Array, y: Array, cosine: Array, sine: Array) -> tuple[Array, Array]:
    """(x, y) in a frame that is turned counter-clockwise by the angle of that cosine and sine."""
    u = cosine * x + sine * y
    v = cosine * y - sine * x
    return u, v
