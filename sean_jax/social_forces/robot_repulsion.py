"""Repulsion by the robot (section IV-D [45]): it acts on people as a person does, from farther away while it moves."""

from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Float

from sean_jax.base import Array
from sean_jax.social_forces.repulsion import Repulsion
from sean_jax.social_forces.terms import Crowd, Force, Pair, gather, sum_pair_terms


@struct.dataclass
class RobotRepulsion:
    """All terms of pairs between each person and the robot. Without this term people do not notice the robot.

    A factor f of the repulsion A exp(-b / B) is drawn for each person and acts while the robot moves. It equals a
    distance of B ln(f), which is what ``Pedestrians.robot_distance`` says.
    """

    limits: ClassVar[dict[str, tuple[float, float]]] = {
        "factor_min": (1e-6, 1e6),
        "factor_max": (1e-6, 1e6),
        "ramp": (0.0, 100.0),
    }

    factor_min: Float[Array, ""]  # 1, of the repulsion by a moving robot, drawn uniformly per person ...
    factor_max: Float[Array, ""]  # 1, ... up to here
    moving_speed: Float[Array, ""]  # m/s, a slower robot is avoided like a person
    ramp: Float[Array, ""]  # m/s around it over which a robot comes to be felt as moving; 0: all at once

    def person(self, crowd: Crowd) -> Force | None:
        """The push of the robot on everybody.

        Returns:
            (N,) x and y parts [m/s2]; None without a robot or pair terms.
        """
        terms = crowd.forces.pair_terms
        return self._felt(crowd, partial(sum_pair_terms, terms)) if terms else None

    def gathered(self, crowd: Crowd) -> tuple[tuple[Array, ...], ...] | None:
        """What the robot adds to the sums of the gather terms.

        Returns:
            (N,) each, a tuple for each term; None without a robot.
        """
        return self._felt(crowd, partial(gather, crowd.forces.gather_terms))

    def _felt(self, crowd: Crowd, law: Callable) -> Any:
        """(N,) each: what ``law`` gives for the pair of each person and the robot; None without a robot."""
        robot, people = crowd.robot, crowd.people
        if robot is None:
            return None
        wx, wy = robot.speed * robot.heading[0], robot.speed * robot.heading[1]
        faster = jnp.abs(robot.speed) - self.moving_speed
        smooth = self.ramp > 0.0
        ramped = jnp.clip(0.5 + faster / jnp.where(smooth, self.ramp, 1.0), 0.0, 1.0)
        moving = jnp.where(smooth, ramped, (faster > 0.0).astype(float))
        repulsion, radii = crowd.forces.get(Repulsion), crowd.forces.walking.radius + crowd.robot_radius

        def push(px, py, vx, vy, look_x, look_y, standing, distance):
            dx, dy = px - robot.position[0], py - robot.position[1]
            scale = None if repulsion is None else jnp.exp(moving * distance / repulsion.range)
            pair = Pair(dx, dy, wx, wy, vx, vy, look_x, look_y, radii, standing, True, scale)
            return law(pair)

        one = people.position[:, 0], people.position[:, 1], people.velocity[:, 0], people.velocity[:, 1]
        return jax.vmap(push)(*one, crowd.look_x, crowd.look_y, people.group >= 0, people.robot_distance)
