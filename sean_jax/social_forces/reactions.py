"""Reactions of people to the robot, and people who look at a phone: the term ``Reactions``.

[H] N. Perez-Higueras, R. Otero, F. Caballero & L. Merino, HuNavSim: A ROS 2 Human Navigation Simulator, IEEE Robotics
and Automation Letters 8(11), 7130 (2023), arXiv 2305.01303: the kinds and what they do; distances are in its code.
[M21] H. Murakami, C. Feliciani, Y. Nishiyama & K. Nishinari, Science Advances 7, eabe7758 (2021): people with a phone
anticipate others less, and lanes form later.
"""

from dataclasses import replace
from enum import IntEnum
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float

from sean_jax.core.data_types import Array, Obstacles, Pedestrians, Reaction, Robot
from sean_jax.core.geometry import crosses_box, length, unit
from sean_jax.social_forces.forces import Crowd, Force, components

RAMP = 1.0  # m, over which sight ends and an approach comes to a halt
BEHIND = -0.34  # 1, cosine of 110 degrees: there sight is zero, and whole at 90; [H] has a step at 100
PACE = 0.5  # s, in which a person would walk to the place before the robot
SLOW = 0.1  # m/s, at least, of the speed by which is divided
ROUND = 0.7  # of ``block``, the distance at which threatening people walk round the robot to the place before it


class Kind(IntEnum):
    """What people do when they see the robot, after [H]."""

    INDIFFERENT = 0  # avoid it like a person, as the other terms say
    SURPRISED = 1  # stop and look at it
    CURIOUS = 2  # walk up to it slowly, stop at a distance and look at it
    CAUTIOUS = 3  # walk round it at a distance
    IMPASSIVE = 4  # take no notice of it; only its body stops theirs
    THREATENING = 5  # walk round it to a place before it and stay there, in its way


ENGAGED = Kind.SURPRISED, Kind.CURIOUS, Kind.THREATENING  # they leave their way, and face the robot
SHARES = tuple(kind.name.lower() for kind in Kind if kind)  # parameters: the shares of all kinds but indifferent people


def _constant(value: float) -> Any:
    return struct.field(default=np.float64(value))


@struct.dataclass
class Reactions:
    """Reactions to the robot: each person draws one of the kinds of ``Kind``, and whether they look at a phone.

    People see the robot within ``sight``, ahead or beside them and with no obstacle between. Then their attention
    rises. Surprised, curious and threatening people want another velocity in its measure, until their patience ends.
    An inattentive person notices others, and the robot, only within the share ``phone`` of the time and distance
    ahead: ``Evasion`` and ``Headway`` act later. Standing members of groups do not react.

    Source: [H] and [M21] above; constants without a name are ours.
    """

    limits: ClassVar[dict[str, tuple[float, float]]] = {
        **dict.fromkeys(SHARES, (0.0, 1.0)),
        "inattentive": (0.0, 1.0),
        "phone": (0.01, 1.0),
        "sight": (0.0, 1e3),
        "delay": (1e-2, 100.0),
        "duration": (0.0, 1e6),
        "approach": (0.0, 10.0),
        "stop": (0.0, 100.0),
        "block": (0.0, 100.0),
        "caution": (0.0, 100.0),
        "clearance": (1e-2, 100.0),
    }
    relations: ClassVar[dict] = {
        "the shares of surprised, curious, cautious, impassive and threatening people sum to more than 1": (
            lambda term: np.sum(term.shares, 0) > 1.0 + 1e-6
        ),
    }

    surprised: Float[Array, ""] = _constant(0.0)  # 1, shares of people; the others are indifferent
    curious: Float[Array, ""] = _constant(0.0)
    cautious: Float[Array, ""] = _constant(0.0)
    impassive: Float[Array, ""] = _constant(0.0)
    threatening: Float[Array, ""] = _constant(0.0)
    inattentive: Float[Array, ""] = _constant(0.0)  # 1, share of people with a phone, of any kind
    phone: Float[Array, ""] = _constant(0.6)  # 1, of the time and distance ahead in which they notice others
    sight: Float[Array, ""] = _constant(5.0)  # m, from where people see the robot; [H] has 3 to 10
    delay: Float[Array, ""] = _constant(0.4)  # s, in which attention rises and falls
    duration: Float[Array, ""] = _constant(30.0)  # s, of attention until people lose interest [H]
    approach: Float[Array, ""] = _constant(0.6)  # m/s, of curious people
    stop: Float[Array, ""] = _constant(1.5)  # m, from the robot, where they stop [H]
    block: Float[Array, ""] = _constant(0.9)  # m, before the robot, where threatening people walk to
    caution: Float[Array, ""] = _constant(2.5)  # m/s, by which cautious people want to get away from where it is ...
    clearance: Float[Array, ""] = _constant(3.0)  # m, ... less at a distance, and not at all from here on [H]

    @property
    def shares(self) -> list[Array]:
        """The shares of all kinds but indifferent people."""
        return [getattr(self, name) for name in SHARES]

    def draw(self, key: Array, people: int) -> Reaction:
        """The reactions of people at the start of an episode."""
        kind_key, phone_key = jax.random.split(key)
        shares = jnp.stack([jnp.asarray(share, float) for share in self.shares])  # (kinds,)
        bounds = jnp.cumsum(shares[::-1])  # so the last interval is that of indifferent people
        chance = jax.random.uniform(kind_key, (people,), float)
        above = chance[:, None] >= bounds[None]  # (N, kinds)
        kind = len(shares) - above.sum(1, dtype=jnp.int32)

        chance = jax.random.uniform(phone_key, (people,), float)
        has_phone = chance < self.inattentive
        alertness = jnp.where(has_phone, self.phone, 1.0).astype(float)
        attention = jnp.zeros(people, float)
        patience = jnp.broadcast_to(self.duration, (people,)).astype(float)
        return Reaction(kind, alertness, attention, patience)

    def attend(
        self, people: Pedestrians, robot: Robot, obstacles: Obstacles | None, time_step: Float[Array, ""] | float
    ) -> Pedestrians:
        """People with the attention and the patience that they have ``time_step`` [s] later."""
        reaction = people.reaction
        if reaction is None:
            return people

        # People see the robot if it is near, not behind them, and not behind an obstacle.
        dx, dy = _to_robot(people, robot)
        ux, uy = unit(dx, dy)
        heading_x, heading_y = components(people.heading)
        sight = self.sight * reaction.alertness  # (N,) m
        near = jnp.clip((sight - length(dx, dy)) / RAMP, 0.0, 1.0)
        cosine = ux * heading_x + uy * heading_y
        seen = near * jnp.clip(1.0 - cosine / BEHIND, 0.0, 1.0)
        if obstacles is not None:
            hidden = _hidden(people, robot, obstacles)
            seen = jnp.where(hidden, 0.0, seen)

        # All but cautious people lose interest.
        interest = jnp.clip(reaction.patience / self.delay, 0.0, 1.0)
        goal = jnp.where(reaction.kind == Kind.CAUTIOUS, seen, seen * interest)
        rise = 1.0 - jnp.exp(-time_step / self.delay)
        attention = reaction.attention + rise * (goal - reaction.attention)
        patience = jnp.maximum(reaction.patience - time_step * attention, 0.0)
        reaction = replace(reaction, attention=attention, patience=patience)
        return replace(people, reaction=reaction)

    def desire(self, people: Pedestrians, robot: Robot) -> Float[Array, "N 2"]:
        """The desired velocities [m/s] of people who see the robot."""
        reaction = people.reaction
        if reaction is None:
            return people.desired_velocity

        # Curious people walk up to the robot and stop at a distance.
        dx, dy = _to_robot(people, robot)
        ux, uy = unit(dx, dy)
        excess = length(dx, dy) - self.stop  # (N,) m
        speed = self.approach * jnp.clip(excess / RAMP, -1.0, 1.0)
        approaches = reaction.kind == Kind.CURIOUS
        x = jnp.where(approaches, speed * ux, 0.0)
        y = jnp.where(approaches, speed * uy, 0.0)

        # Threatening people walk to a place before it.
        place_x, place_y = self._to_place_before(people, robot)
        blocks = reaction.kind == Kind.THREATENING
        x = jnp.where(blocks, place_x, x)
        y = jnp.where(blocks, place_y, y)

        # Cautious people go where they want, but far round it.
        desired_x, desired_y = components(people.desired_velocity)
        detour_x, detour_y = _around(desired_x, desired_y, dx, dy, self.clearance, RAMP)
        is_cautious = reaction.kind == Kind.CAUTIOUS
        x = jnp.where(is_cautious, detour_x, x)
        y = jnp.where(is_cautious, detour_y, y)

        share = _share(people, reaction, *ENGAGED, Kind.CAUTIOUS)  # (N,)
        velocity = jnp.stack([x, y], -1)  # (N, 2)
        return people.desired_velocity + share[:, None] * (velocity - people.desired_velocity)

    def _to_place_before(self, people: Pedestrians, robot: Robot) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
        """Velocities [m/s] to the place ``block`` before the robot, round it and slower near the place."""
        dx, dy = _to_robot(people, robot)
        x = (dx + self.block * robot.heading[0]) / PACE
        y = (dy + self.block * robot.heading[1]) / PACE
        preferred = jnp.maximum(people.preferred_speed, SLOW)
        slower = jax.lax.rsqrt(1.0 + (x * x + y * y) / (preferred * preferred))

        # The circle ends before the place: people walk straight up to it.
        radius = ROUND * self.block
        return _around(x * slower, y * slower, dx, dy, radius, self.block - radius)

    def gaze(self, people: Pedestrians, robot: Robot) -> Float[Array, "N 2"]:
        """What is added to the velocity [m/s] to which the body turns, so that people who attend face the robot."""
        reaction = people.reaction
        if reaction is None:
            return jnp.zeros_like(people.heading)
        ux, uy = unit(*_to_robot(people, robot))
        share = _share(people, reaction, *ENGAGED)  # (N,)
        return share[:, None] * jnp.stack([ux, uy], -1)

    def person(self, crowd: Crowd) -> Force | None:
        """The push (N,) [m/s2] on cautious people, away from the robot; None without one."""
        people = crowd.people
        robot = crowd.robot
        reaction = people.reaction
        if robot is None or reaction is None:
            return None

        dx, dy = _to_robot(people, robot)
        ux, uy = unit(dx, dy)
        near = jnp.maximum(1.0 - length(dx, dy) / self.clearance, 0.0)
        share = _share(people, reaction, Kind.CAUTIOUS)
        push = self.caution / crowd.forces.walking.relaxation(people) * near * share
        return -push * ux, -push * uy


def heed(people: Pedestrians, robot: Robot | None) -> Float[Array, "N"] | None:
    """The factor (N,) of all pair terms but contact of the robot on each person; None without reactions or robot.

    Impassive people take no notice of it, and threatening people do not give way to it once they are before it.
    """
    reaction = people.reaction
    if reaction is None or robot is None:
        return None
    ux, uy = unit(*_to_robot(people, robot))
    before = jnp.maximum(-(ux * robot.heading[0] + uy * robot.heading[1]), 0.0)
    stays = _share(people, reaction, Kind.THREATENING) * before
    return jnp.where(reaction.kind == Kind.IMPASSIVE, 0.0, 1.0 - stays)


def _around(
    x: Float[Array, "N"],
    y: Float[Array, "N"],
    dx: Float[Array, "N"],
    dy: Float[Array, "N"],
    radius: Float[Array, ""],
    ramp: Float[Array, ""] | float,
) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
    """Velocities (x, y) [m/s] that turn to the side before a robot, so that people walk along a circle around it.

    Args:
        dx: m, to the robot.
        dy: m.
        radius: m, of the circle.
        ramp: m, outside it, over which velocities begin to turn.
    """
    ux, uy = unit(dx, dy)
    approach = x * ux + y * uy  # m/s
    across = y * ux - x * uy  # m/s, to the left

    # At the circle all of the approach has turned to the nearer side.
    gap = length(dx, dy) - radius
    near = jnp.clip(1.0 - gap / jnp.maximum(ramp, 1e-3), 0.0, 1.0)
    forward = jnp.maximum(approach, 0.0)
    speed = length(forward, across)
    on_circle = jnp.where(across >= 0.0, speed, -speed)
    approach = approach - near * forward
    across = across + near * (on_circle - across)
    return approach * ux - across * uy, approach * uy + across * ux


def _share(people: Pedestrians, reaction: Reaction, *kinds: Kind) -> Float[Array, "N"]:
    """The attention (N,) of people of these kinds who do not stand in a group; zero of all others."""
    is_kind = reaction.kind[:, None] == jnp.asarray([kinds], jnp.int32)  # (N, kinds)
    reacts = is_kind.any(1) & (people.group < 0)
    return jnp.where(reacts, reaction.attention, 0.0)


def _to_robot(people: Pedestrians, robot: Robot) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
    """From each person to the robot, dx and dy [m]."""
    x, y = components(people.position)
    return robot.position[0] - x, robot.position[1] - y


def nearest_robot(people: Pedestrians, robot: Robot) -> Robot:
    """The robot; of several (M, ...) the nearest to each person, with people as the last axis (2, N)."""
    if robot.position.ndim == 1:
        return robot
    dx = robot.position[:, 0, None] - people.position[None, :, 0]  # (M, N) m
    dy = robot.position[:, 1, None] - people.position[None, :, 1]
    square = jax.lax.stop_gradient(dx * dx + dy * dy)
    index = square.argmin(0)  # (N,)
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf[index], 0, -1), robot)


def _hidden(people: Pedestrians, robot: Robot, obstacles: Obstacles) -> Bool[Array, "N"]:
    """Whether an obstacle, other than an edge of the floor, is on the line from each person to the robot."""
    x, y = components(people.position)
    cross_boxes = jax.vmap(crosses_box, in_axes=(None, None, None, None, 0, None))
    robot_axis = None if robot.position.ndim == 1 else 0
    lines_cross = jax.vmap(cross_boxes, in_axes=(0, 0, robot_axis, robot_axis, None, None))
    hits = lines_cross(x, y, robot.position[0], robot.position[1], obstacles, 0.0)  # (N, W)
    is_obstacle = obstacles.height > 0.0  # (W,)
    return (hits & is_obstacle[None]).any(1)
