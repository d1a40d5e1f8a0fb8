"""The laws of the social forces (section IV-D, low level), one term a class. Walls and contact are in ``walls``.

Laws of pairs are written in components, as printed: ``d`` leads from the other person to the person, ``w`` is the
velocity of the other and ``v`` the velocity of the person.

[HM95] D. Helbing & P. Molnar, Phys. Rev. E 51, 4282 (1995). [J07] A. Johansson, D. Helbing & P. Shukla, Adv. Complex
Syst. 10, 271 (2007). [M10] M. Moussaid, N. Perozo, S. Garnier, D. Helbing & G. Theraulaz, PLoS ONE 5(4), e10047 (2010).
"""

from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Bool, Float, Int

from sean_jax.core.data_types import Array, Pedestrians, Robot
from sean_jax.core.geometry import angle_between, ground_velocity, length, rotate, sum_vectors, unit
from sean_jax.social_forces.forces import (
    MAX_EXPONENT,
    TINY,
    Crowd,
    Force,
    Pair,
    Walking,
    components,
    gather,
    is_standing,
    sum_pair_terms,
)
from sean_jax.social_forces.reactions import heed
from sean_jax.social_forces.walls import Contact

NEGLIGIBLE = 1e-4  # m/s2, of a push
SHORTEST = 1e-3  # m, of a ramp or a width that is divided by; its tenth power is still a float
LEAST_GAP = 0.01  # m: a nearer person limits the speed as one at that gap
SLOW = 0.1  # m/s, of the preferred speed by which the share of a desired speed is divided
BERTH = 1.3  # of the width of ``Evasion``: people slow down before a robot that passes just outside that, too
RIGHT_OF = 0.05  # m, to the left of the middle of a robot behind, where people step to the right as to the left
SOFTENING = 0.01  # m2: the direction of a companion fades out below a distance of 0.1 m


@struct.dataclass
class Repulsion:
    """A push away from each other person, stronger at short distance, weaker if the other is out of sight."""

    limits: ClassVar[dict[str, tuple[float, float]]] = {
        "strength": (-1e6, 1e6),
        "range": (0.01, 1e3),
        "anticipation": (0.0, 100.0),
        "sight_cosine": (-1.0, 1.0),
    }
    relations: ClassVar[dict[str, Callable[[Any], Any]]] = {
        "reach is more than 20 times range": lambda term: term.reach > MAX_EXPONENT * term.range,
    }

    strength: Float[Array, ""]  # m/s2, A of A exp((reach - b) / range)
    range: Float[Array, ""]  # m, B
    reach: Float[Array, ""]  # m, added to the exponent's distance (SEAN: both radii and half a metre)
    anticipation: Float[Array, ""]  # s, the step that b looks ahead; 0 makes ellipses circles
    own_motion: Float[Array, ""]  # 1, share of the own velocity in that step: 0 as in [HM95], 1 as in [J07]
    back_weight: Float[Array, ""]  # 1, weight of pushes from out of sight: c of [HM95], lambda of [J07]
    sight_cosine: Float[Array, ""]  # 1, cosine of the half angle of sight of [HM95]
    law: Callable = struct.field(pytree_node=False)  # (parameters, pair) -> (fx, fy) m/s2: elliptical or circular
    sight: Callable = struct.field(pytree_node=False)  # (parameters, pair, fx, fy) -> weight, such as in_cone

    def pair(self, pair: Pair) -> Force:
        """The law's push [m/s2], weighted by sight and, for a moving robot, by the pair's scale."""
        fx, fy = self.law(self, pair)
        weight = self.sight(self, pair, fx, fy)
        if pair.repulsion_scale is not None:
            weight = weight * pair.repulsion_scale
        return weight * fx, weight * fy

    def cutoff(self, walking: Walking) -> Array | None:
        """The distance [m] beyond which the push is below 1e-4 m/s2; None for a user's law.

        A push of the elliptical law decays with b, and the ellipse of that b reaches sqrt(b^2 + (y / 2)^2) + y / 2 from
        the other person; y is their walk in the time of the anticipation.
        """
        if self.law not in (elliptical, circular, surface):
            return None
        bodies = 0.0
        if self.law is surface:
            bodies = 2.0 * walking.radius
        ratio = jnp.maximum(2.0 * self.strength / NEGLIGIBLE, 1.0)
        b = bodies + self.reach + self.range * jnp.log(ratio)
        y = (1.0 + self.own_motion) * self.anticipation * walking.speed_ratio * walking.speed_max
        return jnp.sqrt(b * b + 0.25 * y * y) + 0.5 * y


def elliptical(parameters: Repulsion, pair: Pair) -> Force:
    """Repulsion [m/s2] that decays with the semi-minor axis b of the ellipse around the other's next step.

    With y = (w - own_motion v) anticipation, 2 b = sqrt((|d| + |d - y|)^2 - |y|^2), the push is
    A exp((reach - b) / B) (|d| + |d - y|) / (4 b) (d / |d| + (d - y) / |d - y|). The difference of squares is evaluated
    as 2 (|d| |d - y| + d . (d - y)), and that sum, where it would cancel, by way of the cross product.
    Source: the negative gradient of the potential of [HM95], eq. (3)-(4); elliptical specification II of [J07].
    """
    # d from the other, and e = d - y from where the other will be.
    dx = pair.dx
    dy = pair.dy
    ex = dx - (pair.wx - parameters.own_motion * pair.vx) * parameters.anticipation
    ey = dy - (pair.wy - parameters.own_motion * pair.vy) * parameters.anticipation

    # Their lengths.
    dd = dx * dx + dy * dy + TINY
    ee = ex * ex + ey * ey + TINY
    inverse_d = jax.lax.rsqrt(dd)
    inverse_e = jax.lax.rsqrt(ee)
    d = dd * inverse_d
    e = ee * inverse_e

    # The square of the semi-minor axis b.
    dot = dx * ex + dy * ey
    cross = dx * ey - dy * ex
    would_cancel = dot < 0.0
    by_cross = cross * cross / (d * e + jnp.abs(dot))
    bb = 0.5 * jnp.where(would_cancel, by_cross, d * e + dot) + TINY
    inverse_b = jax.lax.rsqrt(bb)

    exponent = (parameters.reach - bb * inverse_b) * (1.0 / parameters.range)
    push = parameters.strength * jnp.exp(exponent)
    push = push * (0.25 * (d + e) * inverse_b)
    fx = push * (dx * inverse_d + ex * inverse_e)
    fy = push * (dy * inverse_d + ey * inverse_e)
    return fx, fy


def circular(parameters: Repulsion, pair: Pair) -> Force:
    """Repulsion A exp((reach - |d|) / B) [m/s2] along d.

    Source: the circular specification of [J07], and SEAN 2.0's code.
    """
    dx = pair.dx
    dy = pair.dy
    dd = dx * dx + dy * dy + TINY
    inverse = jax.lax.rsqrt(dd)
    exponent = (parameters.reach - dd * inverse) * (1.0 / parameters.range)
    push = parameters.strength * jnp.exp(exponent) * inverse
    return push * dx, push * dy


def surface(parameters: Repulsion, pair: Pair) -> Force:
    """Repulsion A exp((reach + radii - |d|) / B) [m/s2] along d: from body to body.

    Source: [H00] in social_forces/presets.yaml.
    """
    dx = pair.dx
    dy = pair.dy
    dd = dx * dx + dy * dy + TINY
    inverse = jax.lax.rsqrt(dd)
    exponent = (parameters.reach + pair.radii - dd * inverse) * (1.0 / parameters.range)
    push = parameters.strength * jnp.exp(jnp.minimum(exponent, MAX_EXPONENT)) * inverse
    return push * dx, push * dy


def in_cone(parameters: Repulsion, pair: Pair, fx: Array, fy: Array) -> Array:
    """Weight of a push (fx, fy): 1 from within the angle of sight, else ``back_weight``.

    The condition h . (-f) >= |f| cos(phi) is compared by signed squares. Source: [HM95], eq. (8).
    """
    along = -(fx * pair.look_x + fy * pair.look_y)
    limit = parameters.sight_cosine * jnp.abs(parameters.sight_cosine) * (fx * fx + fy * fy)
    in_sight = along * jnp.abs(along) >= limit
    return jnp.where(in_sight, 1.0, parameters.back_weight)


def in_front(parameters: Repulsion, pair: Pair, fx: Array, fy: Array) -> Array:
    """Weight of a push: lambda + (1 - lambda) (1 + cos(phi)) / 2, phi between the look and the other person.

    Source: [J07], eq. (7).
    """
    dx = pair.dx
    dy = pair.dy
    ahead = -(dx * pair.look_x + dy * pair.look_y)
    dd = dx * dx + dy * dy + TINY
    cosine = ahead * jax.lax.rsqrt(dd)
    return parameters.back_weight + (1.0 - parameters.back_weight) * 0.5 * (1.0 + cosine)


def all_round(parameters: Repulsion, pair: Pair, fx: Array, fy: Array) -> float:
    """Weight 1 on all sides. So a uniform crowd, however dense, pushes nobody back."""
    return 1.0


@struct.dataclass
class Headway:
    """Limits the desired speed to (gap - length) / time behind the nearest people in the way, who may bring it to zero.

    The gap is between the surfaces of the bodies. A person beside the line of sight counts less, by (1 - (aside /
    width)^2)^2. An oncoming person counts less, the faster they come: ``Evasion`` deals with them. The minimum of the
    desired speed and of all limits is smooth: with limits v_i, v (1 + sum (v / v_i)^4)^(-1/4).

    Source: A. Tordeux, M. Chraibi & A. Seyfried, Traffic and Granular Flow '15, 225 (2016), for one person ahead.
    """

    limits: ClassVar[dict[str, tuple[float, float]]] = {
        "length": (-10.0, 10.0),
        "time": (1e-2, 100.0),
        "width": (0.0, 100.0),
        "ramp": (0.0, 100.0),
        "deviation": (0.0, 2.0),
        "noise": (0.0, 2.0),
    }

    length: Float[Array, ""]  # m, the gap at which people stand still
    time: Float[Array, ""]  # s, in which they would walk the rest of the gap
    width: Float[Array, ""]  # m, farther aside nobody is in the way
    ramp: Float[Array, ""]  # m, ahead, over which the effect rises
    deviation: Float[Array, ""] | None = None  # 1, of the logarithm of the time among people
    noise: Float[Array, ""] | None = None  # 1, and in time: by the noise of ``Noise``

    def gather(self, pair: Pair) -> tuple[Array]:
        """The part of one other in the sum of 1 / (gap - length)^4, times ``_scale`` [m], which ``act`` divides by."""
        dx = pair.dx
        dy = pair.dy
        look_x = pair.look_x
        look_y = pair.look_y
        dd = dx * dx + dy * dy + TINY
        ahead = -(dx * look_x + dy * look_y)
        aside = dx * look_y - dy * look_x
        in_way = jnp.maximum(self.width * self.width - aside * aside, 0.0)
        following = jnp.clip(1.0 + (pair.wx * look_x + pair.wy * look_y), 0.0, 1.0)

        gap = jnp.maximum(dd * jax.lax.rsqrt(dd) - pair.radii - self.length, LEAST_GAP)
        close = in_way * jax.lax.rsqrt(gap * gap) ** 2  # cheaper than a division
        in_front = jnp.clip(ahead, 0.0, self._ramp())
        return (in_front * following * close * close,)

    def act(self, crowd: Crowd, total: Float[Array, "N"]) -> Force:
        """The braking (N,) [m/s2] that takes up the limits in the relaxation time."""
        people = crowd.people
        time = self.time
        if self.deviation is not None and people.traits is not None:
            time = time * jnp.exp(self.deviation * people.traits.headway)
        if self.noise is not None and people.noise is not None:
            time = time * jnp.exp(-self.noise * people.noise[:, 0])
        if people.reaction is not None:
            time = time * people.reaction.alertness

        # The smooth minimum: (1 + sum (v / v_i)^4)^(-1/4) of the desired speed v.
        desired_x, desired_y = components(people.desired_velocity)
        square = (desired_x * desired_x + desired_y * desired_y) * time * time
        power_sum = 1.0 + square * square * total * (1.0 / self._scale())
        share = jax.lax.rsqrt(jnp.sqrt(power_sum))
        rate = (share - 1.0) / crowd.forces.walking.relaxation(people)
        return rate * desired_x, rate * desired_y

    def _ramp(self) -> Array:
        return jnp.maximum(self.ramp, SHORTEST)

    def _scale(self) -> Array:
        """The divisor of the sum over all others, so that not each pair divides."""
        return self._ramp() * jnp.maximum(self.width, SHORTEST) ** 4

    def cutoff(self, walking: Walking) -> Array:
        """The distance [m] at which the limit is four times the top speed, which takes 0.1 % of it."""
        return 2.0 * walking.radius + self.length + 4.0 * self.time * walking.speed_max


@struct.dataclass
class Evasion:
    """A push across the look that makes the closest approach to others wider. Standing members of groups feel none.

    If both keep their velocities, the closest approach is in a time t at an offset m. The push is the part of m across
    the look, stronger if it is sooner and nearer: (1 - t / horizon)^2 (1 - m^2 / width^2)^2, for others ahead who
    come closer faster than about ``speed``. ``side`` is added to the offset, so that both step to their right where
    they would meet exactly. Pushes of all others together are at most ``strength``. Unlike ``Sidestep`` it has no
    jumps and is bounded however many people come.

    Source: F. Zanlungo, T. Ikeda & T. Kanda, EPL 93, 68005 (2011).
    """

    limits: ClassVar[dict[str, tuple[float, float]]] = {
        "horizon": (1e-3, 100.0),
        "width": (0.0, 100.0),
        "speed": (1e-3, 100.0),
        "ramp": (0.0, 100.0),
        "width_deviation": (0.0, 2.0),
        "side_deviation": (0.0, 10.0),
    }

    strength: Float[Array, ""]  # m/s2, of the push when many come
    gain: Float[Array, ""]  # 1, share of it for one person on a collision course
    horizon: Float[Array, ""]  # s, a later approach does not count
    width: Float[Array, ""]  # m, nor does a wider one
    side: Float[Array, ""]  # m, by which people keep to the right
    speed: Float[Array, ""]  # m/s, of the relative speed at which an approach counts by half
    ramp: Float[Array, ""]  # m, ahead, over which the effect rises
    width_deviation: Float[Array, ""] | None = None  # 1, of the logarithm of the width among people
    side_deviation: Float[Array, ""] | None = None  # m, of the side among people

    def gather(self, pair: Pair) -> tuple[Array]:
        """The share of the push to the right (negative: left) by one other, times ``_scale`` [m6 s2]."""
        from_ahead, closeness, right = self._approach(pair, self.width * pair.width)
        return (from_ahead * closeness**2 * right,)

    def urgency(self, pair: Pair) -> Array:
        """How soon and how near another comes, from 0 at the horizon or ``BERTH`` widths away to 1."""
        width = jnp.maximum(BERTH * self.width * pair.width, SHORTEST)
        from_ahead, closeness, _ = self._approach(pair, width)
        return from_ahead * closeness / (self._ramp() * self.horizon * pair.alertness * width * width)

    def _approach(self, pair: Pair, width: Array) -> tuple[Array, Array, Array]:
        """The closest approach: whether from ahead [m], (time left) (room left) [s m2], how far to the right [m]."""
        dx = pair.dx
        dy = pair.dy
        look_x = pair.look_x
        look_y = pair.look_y
        ux = pair.vx - pair.wx
        uy = pair.vy - pair.wy
        uu = ux * ux + uy * uy
        inverse = jax.lax.rsqrt(uu + self.speed * self.speed) ** 2  # cheaper than a division

        # The time t and the offset m of the closest approach.
        approach = -(dx * ux + dy * uy)
        time = jnp.maximum(approach, 0.0) * inverse
        mx = dx + ux * time
        my = dy + uy * time

        soon = jnp.maximum(self.horizon * pair.alertness - time, 0.0)
        near = jnp.maximum(width * width - (mx * mx + my * my), 0.0)
        ahead = -(dx * look_x + dy * look_y)
        in_sight = jnp.clip(ahead, 0.0, self._ramp())
        right = mx * look_y - my * look_x + (self.side + pair.side)
        closing = jnp.where(approach > 0.0, uu * inverse, 0.0)
        return in_sight * closing, soon * near, right

    def act(self, crowd: Crowd, share: Float[Array, "N"]) -> Force:
        """The push to the side (N,) [m/s2], ``strength`` at most, from the sum of ``gather``."""
        share = share * (self.gain / self._scale())
        factor, _, alertness = self.individual(crowd.people)
        width_power = (factor * factor) ** 2
        share = share / width_power / factor / alertness**2
        push = self.strength * share * jax.lax.rsqrt(1.0 + share * share)
        standing = is_standing(crowd.people)
        push = jnp.where(standing, 0.0, push)
        return push * crowd.look_y, -push * crowd.look_x

    def _ramp(self) -> Array:
        return jnp.maximum(self.ramp, SHORTEST)

    def _scale(self) -> Array:
        """As in ``Headway``."""
        return self._ramp() * self.horizon**2 * jnp.maximum(self.width, SHORTEST) ** 5

    def individual(self, people: Pedestrians) -> tuple[Array | float, Array | float, Array | float]:
        """Each person's factor of the width, what is added to the side [m], and the factor of the horizon.

        They are 1, 0 and 1 where people do not differ.
        """
        factor = 1.0
        side = 0.0
        alertness = 1.0
        if people.traits is not None and self.width_deviation is not None:
            factor = jnp.exp(self.width_deviation * people.traits.width)
        if people.traits is not None and self.side_deviation is not None:
            side = self.side_deviation * people.traits.side
        if people.reaction is not None:
            alertness = people.reaction.alertness
        return factor, side, alertness

    def cutoff(self, walking: Walking) -> Array:
        """The distance [m] beyond which nobody can come near within the horizon."""
        return self.width + 2.0 * walking.speed_ratio * walking.speed_max * self.horizon


def evasion_factors(crowd: Crowd) -> tuple[Array | float, Array | float, Array | float]:
    """The numbers of ``Evasion.individual``, which are 1, 0 and 1 without the term."""
    evasion = crowd.forces.get(Evasion)
    if evasion is None:
        return 1.0, 0.0, 1.0
    return evasion.individual(crowd.people)


@struct.dataclass
class Noise:
    """Noise of the desired velocity of each person who walks, correlated in time (Ornstein-Uhlenbeck).

    It makes stop-and-go waves, and keeps people from straight files. ``Pedestrians.noise`` has unit variance.

    Source: A. Tordeux & A. Schadschneider, J. Phys. A 49, 185101 (2016).
    """

    limits: ClassVar[dict[str, tuple[float, float]]] = {
        "speed": (0.0, 10.0),
        "side": (0.0, 10.0),
        "time": (1e-2, 1e6),
    }

    speed: Float[Array, ""]  # m/s, standard deviation forward
    side: Float[Array, ""]  # m/s, and across
    time: Float[Array, ""]  # s, in which the correlation decays to 1/e

    def person(self, crowd: Crowd) -> Force | None:
        """The accelerations (N,) [m/s2] by noise; None if people have none."""
        people = crowd.people
        if people.noise is None:
            return None
        desired = length(*components(people.desired_velocity))
        preferred = jnp.maximum(people.preferred_speed, SLOW)
        share = jnp.minimum(desired / preferred, 1.0)
        rate = share / crowd.forces.walking.relaxation(people)

        forward = rate * self.speed * people.noise[:, 0]
        left = rate * self.side * people.noise[:, 1]
        return rotate(forward, left, crowd.look_x, crowd.look_y)

    def advance(self, noise: Float[Array, "N 2"], key: Array, time_step: Float[Array, ""] | float) -> Array:
        """The noise (N, 2) ``time_step`` [s] later.

        The steps are uniform numbers of 16 bits. Their sum over the correlation time is normal.
        """
        bits = jax.random.bits(key, noise.shape[:1], jnp.uint32)
        low = bits & 0xFFFF
        high = bits >> 16
        halves = jnp.stack([low, high], -1).astype(noise.dtype)  # (N, 2)
        step = (halves * (1.0 / 0x8000) - (1.0 - 1.0 / 0x10000)) * 3.0**0.5  # of unit variance
        share = jnp.exp(-time_step / self.time)
        kept = share * noise
        added = jnp.sqrt(1.0 - share * share) * step
        return kept + added


@struct.dataclass
class Sidestep:
    """A force across the look of a person whom another approaches [44]. Standing members of groups do not step aside.

    In SEAN 2.0's form: ``preference`` times the cosine of the bearing, while the other is within ``range`` and
    ``cosine`` ahead and the two are closing.
    """

    preference: Float[Array, ""]  # m/s2; positive to the right
    cosine: Float[Array, ""]  # 1, cosine of the half angle within which a person counts as oncoming
    range: Float[Array, ""]  # m, and the distance
    scaled_by_robot: bool = struct.field(pytree_node=False, default=False)  # whether by a moving robot's factor, too

    def pair(self, pair: Pair) -> Force:
        """The push to the side [m/s2], zero unless the other is oncoming."""
        dx = pair.dx
        dy = pair.dy
        look_x = pair.look_x
        look_y = pair.look_y
        dd = dx * dx + dy * dy + TINY
        bearing = -(dx * look_x + dy * look_y) * jax.lax.rsqrt(dd)  # its cosine
        closing = (pair.wx - pair.vx) * look_x + (pair.wy - pair.vy) * look_y < 0.0
        ahead = bearing >= self.cosine
        near = dd < self.range * self.range
        oncoming = closing & ahead & near
        preference = jnp.where(pair.standing, 0.0, self.preference)
        push = jnp.where(oncoming, preference * bearing, 0.0)
        if self.scaled_by_robot and pair.repulsion_scale is not None:
            push = push * pair.repulsion_scale
        return push * look_y, -push * look_x

    def cutoff(self, walking: Walking) -> Array:
        """The distance [m] within which people step aside."""
        return self.range


@struct.dataclass
class GroupSpace:
    """A push A exp((radius - distance) / B) away from the centre of each group, on all but its standing members.

    People walk around the o-spaces of conversational groups. Source: A. Kendon, Conducting Interaction (1990).
    """

    limits: ClassVar[dict[str, tuple[float, float]]] = {
        "strength": (-1e6, 1e6),
        "range": (0.05, 1e3),
    }

    strength: Float[Array, ""]  # m/s2, A
    range: Float[Array, ""]  # m, B

    def person(self, crowd: Crowd) -> Force | None:
        """The push (N,) [m/s2] of all groups on each person; None if there are no groups."""
        groups = crowd.groups
        if groups is None:
            return None
        index = jnp.arange(groups.radius.shape[0], dtype=jnp.int32)
        by_groups = jax.vmap(self._push, in_axes=(None, None, None, 0, 0, 0, 0))
        on_people = jax.vmap(by_groups, in_axes=(0, 0, 0, None, None, None, None))
        member_of = crowd.people.group
        x, y = components(crowd.people.position)
        fx, fy = on_people(x, y, member_of, index, groups.center, groups.radius, groups.present)  # (N, G)
        return sum_vectors(fx, fy, 1)

    def _push(
        self, px: Array, py: Array, member_of: Array, group: Array, center: Array, radius: Array, present: Array
    ) -> Force:
        """The push [m/s2] of one group on one person."""
        dx = px - center[0]
        dy = py - center[1]
        dd = dx * dx + dy * dy + TINY
        inverse = jax.lax.rsqrt(dd)
        exponent = (radius - dd * inverse) / self.range
        size = self.strength * jnp.exp(exponent) * inverse
        felt = present & (member_of != group)
        size = jnp.where(felt, size, 0.0)
        return size * dx, size * dy


@struct.dataclass
class Cohesion:
    """Gaze, attraction and repulsion among companions, between whom contact is the only pair term.

    In walking groups [M10] people slow down when they would have to turn their heads to see the others (gaze), are
    pulled to the middle of the group from afar (attraction), and keep a distance (repulsion). As printed the last two
    switch on and off. Here they fade in over ``ramp``, so that people do not jerk and the law is differentiable.
    With ``alignment`` people desire the mean velocity of their group rather than their own, and gaze does not slow the
    group: as much as one in front brakes, the others hurry.
    """

    damped: ClassVar[bool] = False
    limits: ClassVar[dict[str, tuple[float, float]]] = {
        "alignment": (0.0, 1.0),
        "ramp": (1e-3, 1e3),
    }

    gaze: Float[Array, ""]  # 1/(s rad), beta1 of [M10]: braking when companions are out of view
    view_angle: Float[Array, ""]  # rad, half angle of that view
    attraction: Float[Array, ""]  # m/s2, beta2 of [M10]: pull to the middle of one's walking group
    attraction_distance: Float[Array, ""]  # m, times half the number of companions: from the middle to where it begins
    repulsion: Float[Array, ""]  # m/s2, beta3 of [M10]: push from a companion ...
    repulsion_distance: Float[Array, ""]  # m, ... nearer than that
    ramp: Float[Array, ""]  # m, over which pull and push fade in; [M10] has steps
    alignment: Float[Array, ""] | None = None  # 1, share of the group's mean in desired velocity and gaze; not in [M10]

    def person(self, crowd: Crowd) -> Force | None:
        """The force (N,) [m/s2] by companions, zero for single people; None if nobody has companions."""
        people = crowd.people
        companions = crowd.companions
        if companions is None:
            return None

        # [M10] counts from each companion, and to the middle of all. Index -1 reads the last person: a mask hides it.
        exists = (companions >= 0) & people.present[companions]  # (N, 2)
        x, y = components(people.position)
        dx = x[:, None] - people.position[companions, 0]  # (N, 2) m
        dx = jnp.where(exists, dx, 0.0)
        dy = y[:, None] - people.position[companions, 1]
        dy = jnp.where(exists, dy, 0.0)

        # A person without companions would divide by 0, and the middle is that of the others, without oneself.
        count = exists.sum(1, dtype=jnp.int32).astype(float)
        share = 1.0 / jnp.maximum(count, 1.0)
        cx = -dx.sum(1) * share
        cy = -dy.sum(1) * share

        # Gaze and attraction see the group as one, repulsion each companion; alignment may share the gaze's braking.
        vx, vy = components(people.velocity)
        fx, fy = gaze(self, cx, cy, vx, vy, crowd.look_x, crowd.look_y)
        ax, ay = attraction(self, cx, cy, count)
        if self.alignment is not None:
            ax, ay = self._align(crowd, fx, fy, ax, ay, exists)
        rx, ry = companion_repulsion(self, dx, dy)
        px = jnp.where(exists, rx, 0.0).sum(1)
        py = jnp.where(exists, ry, 0.0).sum(1)

        # Walkers and singles are in one array, so the force of singles is computed, too, and left out here.
        in_group = count > 0.0
        force_x = jnp.where(in_group, fx + ax + px, 0.0)
        force_y = jnp.where(in_group, fy + ay + py, 0.0)
        return force_x, force_y

    def _align(self, crowd: Crowd, fx: Array, fy: Array, ax: Array, ay: Array, exists: Bool[Array, "N 2"]) -> Force:
        """The attraction a with what takes people to the group's mean desired velocity, and gaze f off the group."""
        assert self.alignment is not None and crowd.companions is not None
        desired_x, desired_y = components(crowd.people.desired_velocity)
        rate = self.alignment / crowd.forces.walking.relaxation(crowd.people)
        mx, my = _to_mean(desired_x, desired_y, crowd.companions, exists)
        bx, by = _to_mean(fx, fy, crowd.companions, exists)
        ax = ax + rate * mx - self.alignment * (fx + bx)
        ay = ay + rate * my - self.alignment * (fy + by)
        return ax, ay


def _to_mean(
    x: Float[Array, "N"], y: Float[Array, "N"], companions: Int[Array, "N 2"], exists: Bool[Array, "N 2"]
) -> Force:
    """(N,) each: from one's own vector (x, y) to the mean of it and the companions'."""
    count = exists.sum(1, dtype=jnp.int32).astype(float)
    share = 1.0 / (1.0 + count)
    to_x = jnp.where(exists, x[companions] - x[:, None], 0.0)  # (N, 2)
    to_y = jnp.where(exists, y[companions] - y[:, None], 0.0)
    return share * to_x.sum(1), share * to_y.sum(1)


def gaze(
    parameters: Cohesion,
    cx: Float[Array, "*N"],
    cy: Float[Array, "*N"],
    vx: Float[Array, "*N"],
    vy: Float[Array, "*N"],
    look_x: Float[Array, "*N"],
    look_y: Float[Array, "*N"],
) -> Force:
    """Push -beta1 alpha v [m/s2] against one's own velocity v; c leads to the middle of the others [m].

    alpha [rad] is the angle of that middle beyond ``view_angle`` off the look. Source: [M10], eq. (2).
    """
    look = jnp.stack([look_x, look_y], -1)  # (*N, 2)
    to_middle = jnp.stack([cx, cy], -1)
    angle = jnp.abs(angle_between(look, to_middle))
    beyond = jnp.maximum(angle - parameters.view_angle, 0.0)
    square = cx * cx + cy * cy
    size = parameters.gaze * beyond * square / (square + SOFTENING)
    return -size * vx, -size * vy


def attraction(
    parameters: Cohesion, cx: Float[Array, "*N"], cy: Float[Array, "*N"], number: Float[Array, "*N"] | float
) -> Force:
    """Pull beta2 [m/s2] towards the middle of a walking group of 1 + number people, from afar.

    That middle lies at number / (1 + number) of the way c [m] to the middle of the others; far is number / 2 times
    ``attraction_distance``. Source: [M10], eq. (3).
    """
    distance = length(cx, cy) * number / (1.0 + number)
    away = distance - 0.5 * number * parameters.attraction_distance
    ux, uy = unit(cx, cy)
    share = jnp.clip(away / parameters.ramp, 0.0, 1.0)
    pull = parameters.attraction * share
    return pull * ux, pull * uy


def companion_repulsion(parameters: Cohesion, dx: Float[Array, "*N"], dy: Float[Array, "*N"]) -> Force:
    """Push beta3 [m/s2] along d [m], away from a companion nearer than ``repulsion_distance``.

    Source: [M10], eq. (4).
    """
    ux, uy = unit(dx, dy)
    overlap = parameters.repulsion_distance - length(dx, dy)
    share = jnp.clip(overlap / parameters.ramp, 0.0, 1.0)
    push = parameters.repulsion * share
    return push * ux, push * uy


@struct.dataclass
class RobotRepulsion:
    """All pair terms between each person and the robot [45]. Without this term people do not notice the robot.

    A factor f of the repulsion A exp(-b / B) is drawn for each person and acts while the robot moves. It equals a
    distance of B ln(f), which is ``Pedestrians.robot_distance``. With ``aside`` a robot that follows does not drive
    people on: they step out of its way. With ``slowing`` people slow down before a moving robot that comes near.

    Source of slowing, without a figure: C. Vassallo et al., Gait & Posture 51, 97 (2017); Z. Chen et al., arXiv
    1802.05730 (2018).
    """

    limits: ClassVar[dict[str, tuple[float, float]]] = {
        "factor_min": (1e-6, 1e6),
        "factor_max": (1e-6, 1e6),
        "ramp": (0.0, 100.0),
        "aside": (0.0, 1.0),
        "slowing": (0.0, 1.0),
    }

    factor_min: Float[Array, ""]  # 1, of the repulsion by a moving robot, drawn uniformly per person ...
    factor_max: Float[Array, ""]  # 1, ... up to here
    moving_speed: Float[Array, ""]  # m/s, a slower robot is avoided like a person
    ramp: Float[Array, ""]  # m/s around it over which a robot becomes a moving robot; 0: a step
    aside: Float[Array, ""] | None = None  # 1, share of a push from behind that turns to the side
    slowing: Float[Array, ""] | None = None  # 1, share of the speed that people give up before it

    def person(self, crowd: Crowd) -> Force | None:
        """The push (N,) [m/s2] of the robot on each person; None without a robot or pair terms."""
        terms = crowd.forces.pair_terms
        contact = crowd.forces.get(Contact)
        factor = heed(crowd.people, crowd.robot)
        if not terms:
            return None
        force = self._over_people(crowd, partial(sum_pair_terms, terms))
        if force is None or (factor is None and self.aside is None and self.slowing is None):
            return force

        # Whoever takes no notice of the robot, or steps aside, still feels its body.
        touch = 0.0, 0.0
        if contact is not None:
            touch = self._over_people(crowd, contact.pair)
        touch_x, touch_y = touch
        fx = force[0] - touch_x
        fy = force[1] - touch_y
        if self.aside is not None:
            fx, fy = self._turn_aside(crowd, fx, fy)
        if self.slowing is not None:
            brake_x, brake_y = self._slow_down(crowd)
            fx = fx + brake_x
            fy = fy + brake_y
        if factor is not None:
            fx = factor * fx
            fy = factor * fy
        return fx + touch_x, fy + touch_y

    def _turn_aside(self, crowd: Crowd, fx: Array, fy: Array) -> Force:
        """The push (N,) [m/s2] of the robot, whose part that drives people on is turned to the side."""
        assert crowd.robot is not None and self.aside is not None
        x, y = components(crowd.people.position)
        dx = x - crowd.robot.position[0]
        dy = y - crowd.robot.position[1]
        look_x = crowd.look_x
        look_y = crowd.look_y

        # The more a robot is behind, the more of its push turns.
        way_x, way_y = unit(dx, dy)
        behind = jnp.maximum(way_x * look_x + way_y * look_y, 0.0)
        forward = jnp.maximum(fx * look_x + fy * look_y, 0.0)
        turned = self.aside * behind * forward

        # To the side on which a person is already, and to the right before the middle of the robot.
        left = look_x * dy - look_y * dx - RIGHT_OF  # m
        side = left / jnp.sqrt(left * left + RIGHT_OF * RIGHT_OF)
        fx = fx - turned * (look_x + side * look_y)
        fy = fy - turned * (look_y - side * look_x)
        return fx, fy

    def _slow_down(self, crowd: Crowd) -> Force:
        """The braking (N,) [m/s2] before a moving robot on a collision course; zero without ``Evasion``."""
        assert crowd.robot is not None and self.slowing is not None
        people = crowd.people
        evasion = crowd.forces.get(Evasion)
        if evasion is None:
            zero = jnp.zeros_like(crowd.look_x)
            return zero, zero

        # A robot that stands brakes nobody, so that no two wait for each other.
        _, _, moving = self._motion(crowd.robot)
        share = self.slowing * moving * self._over_people(crowd, evasion.urgency)
        share = jnp.where(is_standing(people), 0.0, share)
        rate = share / crowd.forces.walking.relaxation(people)
        desired_x, desired_y = components(people.desired_velocity)
        return -rate * desired_x, -rate * desired_y

    def gathered(self, crowd: Crowd) -> tuple[tuple[Array, ...], ...] | None:
        """The robot's contributions (N,) to the sums of each gather term; None without a robot."""
        sums = self._over_people(crowd, partial(gather, crowd.forces.gather_terms))
        factor = heed(crowd.people, crowd.robot)
        if factor is None:
            return sums
        return jax.tree.map(partial(jnp.multiply, factor), sums)

    def _over_people(self, crowd: Crowd, law: Callable) -> Any:
        """(N,) each: the law for the pairs of each person and the robot; None without a robot."""
        robot = crowd.robot
        people = crowd.people
        if robot is None:
            return None

        wx, wy, moving = self._motion(robot)

        # How each person differs in ``Evasion``.
        evasion = crowd.forces.get(Evasion)
        shape = people.present.shape
        factors = [jnp.broadcast_to(jnp.asarray(factor, float), shape) for factor in evasion_factors(crowd)]

        # The robot's body is a disc, and its radius replaces half of the sum for two people.
        def with_robot(px, py, vx, vy, look_x, look_y, standing, distance, *factors):
            dx = px - robot.position[0]
            dy = py - robot.position[1]
            scale = self._scale(crowd, moving, distance)
            radii = _robot_radii(crowd, dx, dy, look_x, look_y)
            pair = Pair(dx, dy, wx, wy, vx, vy, look_x, look_y, radii, standing, True, scale, *factors)
            if evasion is not None:  # the extra distance widens the berth, too
                wider = 1.0 + moving * distance / jnp.maximum(evasion.width, SHORTEST)
                pair = pair._replace(width=pair.width * wider)
            return law(pair)

        # The law is that of one pair in scalars, as between people, so vmap goes over the people.
        x, y = components(people.position)
        vx, vy = components(people.velocity)
        standing = is_standing(people)
        rows = x, y, vx, vy, crowd.look_x, crowd.look_y, standing, people.robot_distance
        on_people = jax.vmap(with_robot)
        return on_people(*rows, *factors)

    def _motion(self, robot: Robot) -> tuple[Array, Array, Array]:
        """The velocity [m/s] of a robot over the ground, and how much () it is a moving robot, from 0 to 1."""
        wx = robot.speed * robot.heading[0]
        wy = robot.speed * robot.heading[1]
        speed = jnp.abs(robot.speed)
        if robot.sideways is not None:  # the heading alone does not give the velocity
            wx, wy = ground_velocity(robot)
            speed = length(wx, wy)
        return wx, wy, self._moving(speed)

    def _moving(self, speed: Array) -> Array:
        """How much () a robot of that speed [m/s] is a moving robot, from 0 to 1."""
        faster = speed - self.moving_speed
        smooth = self.ramp > 0.0
        ramp = jnp.where(smooth, self.ramp, 1.0)
        ramped = jnp.clip(0.5 + faster / ramp, 0.0, 1.0)
        step = (faster > 0.0).astype(float)
        return jnp.where(smooth, ramped, step)

    def _scale(self, crowd: Crowd, moving: Array, distance: Array) -> Array | None:
        """The factor of the repulsion for a person with that extra distance [m]."""
        repulsion = crowd.forces.get(Repulsion)
        if repulsion is None:
            return None
        return jnp.exp(moving * distance / repulsion.range)


def _robot_radii(crowd: Crowd, dx: Array, dy: Array, look_x: Array, look_y: Array) -> Array:
    """The sum of the radii [m] of a person with that look and of the robot."""
    walking = crowd.forces.walking
    shape = walking.shape(look_x, look_y)
    if shape is not None:
        shape = 2.0 * shape[0], 2.0 * shape[1]  # as of two people, of whom one is the robot
    return 0.5 * walking.radii(dx, dy, shape) + crowd.robot_radius
