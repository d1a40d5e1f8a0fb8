"""Conversational formations: people on a ring around an empty o-space, with one place left open (section IV-D).

Kendon's F-formation [38], with the distances and directions measured in the Cocktail Party data [46]: 409 groups
of 2 to 6 people.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from sean_jax.core.data_types import Array
from sean_jax.core.geometry import rotate, unit_vectors

# Members' mean distance [m] from their centroid and its standard deviation, by group size.
MEASURED = {2: (0.45, 0.14), 3: (0.58, 0.19), 4: (0.67, 0.20), 5: (0.77, 0.20), 6: (0.83, 0.17)}
MAX_SIZE = 32  # people in a group, the last row of the tables below; larger groups use it too

# Angle [rad] between a member's heading and the direction to the centre, at these shares of all members: half of
# them within 30 degrees, 68 % within 45, 91 % within 90.
SHARES = (0.0, 0.5, 0.68, 0.91, 1.0)
ANGLES = tuple(np.deg2rad((0.0, 30.0, 45.0, 90.0, 180.0)).tolist())

NEIGHBOR = 0.55  # m, minimum distance of neighbouring places of the ring
APART = 0.5  # m, minimum distance of any two seats, and of a seat and the opening
JITTER = 0.12  # m, maximum distance of a seat from its place on the ring


def _tables() -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation [m] of the ring's radius by group size, (MAX_SIZE + 1,).

    With one of n + 1 places open, members' centroid is not the ring's centre: the data's distance from the centroid
    is a share of the ring's radius.
    """
    mean = np.ones(MAX_SIZE + 1)
    deviation = np.ones(MAX_SIZE + 1)
    for size in range(1, MAX_SIZE + 1):
        place = np.arange(1, size + 1)
        angle = 2 * np.pi * place / (size + 1)
        ring = np.stack([np.cos(angle), np.sin(angle)], -1)  # (size, 2), of radius 1
        from_centroid = np.linalg.norm(ring - ring.mean(0), axis=-1)
        share = 1.0
        if size > 1:
            share = float(np.mean(from_centroid))

        # Larger groups than those of the data continue their means.
        distance = 0.26 + 0.10 * size
        spread = 0.18
        if size in MEASURED:
            distance, spread = MEASURED[size]
        mean[size] = distance / share
        deviation[size] = spread / share
    return mean, deviation


MEAN, DEVIATION = _tables()


def reach(capacity: int) -> float:
    """The radius [m] of the disc in which all seats of a group lie."""
    size = min(capacity, MAX_SIZE)
    ring = float(MEAN[size] + DEVIATION[size])
    return ring + JITTER


def formation(
    key: Array, capacity: Int[Array, "G"], center: Float[Array, "G 2"], seat_group: Int[Array, "Q"]
) -> tuple[Float[Array, "Q 2"], Float[Array, "Q 2"], Float[Array, "G"], Float[Array, "G 2"]]:
    """Positions [m] and headings of seats in groups; radius [m] of each group's ring and its opening [m].

    No two seats, and no seat and the opening, are closer than 0.5 m. A group has as many seats as its capacity.
    Source: Kendon's F-formation [38], measured in the Cocktail Party data [46].
    """
    groups = capacity.shape[0]
    seats = seat_group.shape[0]
    ring_key, turn_key, order_key, jitter_key, side_key, angle_key = jax.random.split(key, 6)

    # The ring has a place more than the group has seats, which stays open.
    n_places = capacity.astype(float) + 1.0
    half_chord = jnp.sin(jnp.pi / n_places)  # half the distance of two places of a ring of radius 1
    radius = _draw_radius(ring_key, capacity, half_chord)  # (G,) m

    # The robot joins or leaves at the opening, so tasks reach groups from all sides.
    turn = jax.random.uniform(turn_key, (groups,), float, 0.0, 2.0 * jnp.pi)  # (G,) rad
    opening = center + radius[:, None] * _directions(turn)  # (G, 2) m

    # In random order, or the first member of every group would stand beside the opening.
    place = 1.0 + _random_order(order_key, seat_group)  # (Q,) counted from the opening
    step = 2.0 * jnp.pi / n_places  # (G,) rad
    angle = turn[seat_group] + place * step[seat_group]  # (Q,) rad
    outward = _directions(angle)  # (Q, 2)
    along = jnp.stack([-jnp.sin(angle), jnp.cos(angle)], -1)

    # A seat stays within a disc around its place, small enough to keep neighbours apart; 0.7071: a square in it.
    to_middle = radius * half_chord  # (G,) m, from a place halfway to the next one
    room = jnp.clip(to_middle - 0.5 * APART, 0.0, JITTER)
    half_side = room[seat_group] * 0.7071
    jitter = jax.random.uniform(jitter_key, (seats, 2), float, -1.0, 1.0)
    jitter = jitter * half_side[:, None]  # (Q, 2) m
    distance = radius[seat_group] + jitter[:, 0]
    aside = jitter[:, 1]
    offset = outward * distance[:, None] + along * aside[:, None]  # (Q, 2) m

    # People look near the centre rather than at it: half of them within 30 degrees (Cocktail Party data).
    heading = _draw_headings(side_key, angle_key, offset, outward)
    position = center[seat_group] + offset
    return position, heading, radius, opening


def _directions(angle: Float[Array, "*N"]) -> Float[Array, "*N 2"]:
    """Unit vectors at angles [rad]."""
    x = jnp.cos(angle)
    y = jnp.sin(angle)
    return jnp.stack([x, y], -1)


def _draw_radius(key: Array, capacity: Int[Array, "G"], half_chord: Float[Array, "G"]) -> Float[Array, "G"]:
    """Radius [m] of the ring of each group, normal as measured, but no smaller than neighbors allow."""
    size = jnp.clip(capacity, 0, MAX_SIZE)
    mean = jnp.asarray(MEAN, float)[size]
    deviation = jnp.asarray(DEVIATION, float)[size]
    smallest = 0.5 * NEIGHBOR / half_chord  # (G,) m

    # Within a standard deviation of the mean.
    lower = jnp.clip((smallest - mean) / deviation, -1.0, 0.999)
    normal = jax.random.truncated_normal(key, lower, 1.0, capacity.shape, float)
    return mean + deviation * normal


def _random_order(key: Array, seat_group: Int[Array, "Q"]) -> Float[Array, "Q"]:
    """The rank of each seat in a random order of the seats of its group, from 0."""
    seats = seat_group.shape[0]
    score = jax.random.uniform(key, (seats,), float)
    index = jnp.arange(seats)

    # Of two equal scores the one with the lower index comes first.
    own_score = score[:, None]
    other_score = score[None, :]
    lower = other_score < own_score  # (Q, Q)
    tie = other_score == own_score
    earlier = index[None, :] < index[:, None]
    tie = tie & earlier
    same_group = seat_group[None, :] == seat_group[:, None]
    before = (lower | tie) & same_group  # (Q, Q)
    return jnp.sum(before, axis=1, dtype=float)


def _draw_headings(
    side_key: Array, angle_key: Array, offset: Float[Array, "Q 2"], outward: Float[Array, "Q 2"]
) -> Float[Array, "Q 2"]:
    """Headings of seats at an offset [m] from the centre, turned away from it to either side as measured."""
    seats = offset.shape[0]
    share = jax.random.uniform(angle_key, (seats,), float)
    shares = jnp.asarray(SHARES, float)
    angles = jnp.asarray(ANGLES, float)
    angle = jnp.interp(share, shares, angles)
    to_left = jax.random.bernoulli(side_key, 0.5, (seats,))
    angle = jnp.where(to_left, angle, -angle)  # (Q,) rad
    cosine = jnp.cos(angle)
    sine = jnp.sin(angle)

    # From the way to the centre, and from the outward direction where a seat lies at the centre itself.
    inward = unit_vectors(-offset, outward)  # (Q, 2)
    x = inward[:, 0]
    y = inward[:, 1]
    turned = rotate(x, y, cosine, sine)
    return jnp.stack(turned, -1)
