"""Spaces of observations and actions: a box of numbers, or a dict of boxes; actions from -1 to 1 as commands.

An action of 0 is rest; 1 and -1 are the robot's top speeds ahead and backward.
"""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from sean_jax.base import Array, RobotModel
from sean_jax.robots.limits import max_reverse_speed


@dataclasses.dataclass(frozen=True)
class Box:
    """Arrays of one shape whose numbers lie within bounds."""

    low: float
    high: float
    shape: tuple[int, ...]

    def sample(self, key: Array) -> Float[Array, "*shape"]:
        """A random array of the box."""
        return jax.random.uniform(key, self.shape, float, self.low, self.high)

    def contains(self, value: Float[Array, "..."]) -> Array:
        """Whether a value is in the box, () bool; False for another shape, and for what is not finite."""
        if np.shape(value) != self.shape:
            return jnp.zeros((), bool)
        return ((value >= self.low) & (value <= self.high)).all()


@dataclasses.dataclass(frozen=True)
class Dict:
    """A dict of arrays, each of a box of its own."""

    spaces: tuple[tuple[str, Box], ...]

    def __getitem__(self, name: str) -> Box:
        return dict(self.spaces)[name]

    def items(self) -> tuple[tuple[str, Box], ...]:
        """(name, box) of each, in the order of the dict."""
        return self.spaces

    def sample(self, key: Array) -> dict[str, Array]:
        """A random dict of arrays."""
        keys = jax.random.split(key, len(self.spaces))
        return {name: box.sample(own) for own, (name, box) in zip(keys, self.spaces, strict=True)}

    def contains(self, value: dict[str, Array]) -> Array:
        """Whether a dict is in the space, () bool."""
        if not isinstance(value, dict) or value.keys() != dict(self.spaces).keys():
            return jnp.zeros((), bool)
        return jnp.stack([box.contains(value[name]) for name, box in self.spaces]).all()

    @property
    def size(self) -> int:
        """The number of numbers in a dict."""
        return sum(math.prod(box.shape) for _, box in self.spaces)


def to_command(robot: RobotModel, action: Float[Array, "2"]) -> Float[Array, "2"]:
    """The command (2,) [m/s, rad/s] of an action (2,), clipped to -1 to 1."""
    ahead, turn = jnp.clip(action[0], -1.0, 1.0), jnp.clip(action[1], -1.0, 1.0)
    top = jnp.where(ahead >= 0.0, robot.max_speed, max_reverse_speed(robot))
    return jnp.stack([ahead * top, turn * robot.max_turn_rate])


def to_action(robot: RobotModel, command: Float[Array, "2"]) -> Float[Array, "2"]:
    """The action (2,) from -1 to 1 of a command (2,) [m/s, rad/s]; the inverse of ``to_command``."""
    top = jnp.where(command[0] >= 0.0, robot.max_speed, max_reverse_speed(robot))
    action = jnp.stack([command[0] / jnp.maximum(top, 1e-6), command[1] / jnp.maximum(robot.max_turn_rate, 1e-6)])
    return jnp.clip(action, -1.0, 1.0)
