"""Where each person is on the Behavior Graph, and whose its seats are (section IV-D)."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float, Int, Shaped

from sean_jax.base import Array


class Memory(NamedTuple):
    """Where each person is on the graph.

    Two people at most have the same seat: its holder, who stands there, and a successor, who walks there.
    """

    goal: Int[Array, "N"]  # node to reach in the end
    hop: Int[Array, "N"]  # node to reach next
    origin: Int[Array, "N"]  # node that was left for it; the same one before the first edge
    target: Float[Array, "N 2"]  # m, the point of the next node's disc, or the seat
    seat: Int[Array, "N"]  # seat held or walked to, -1 none
    stay: Int[Array, "N"]  # ticks left to stand at the seat at most, waiting included; 0 for who does not
    seat_position: Float[Array, "Q 2"]  # m
    seat_heading: Float[Array, "Q 2"]  # unit vector
    log_chance: Float[Array, ""] | None = None  # of all that was drawn so far; None without a temperature


class Seats(NamedTuple):
    """Whose each of the Q seats is."""

    holder: Int[Array, "Q"]  # who stands there, -1 nobody
    successor: Int[Array, "Q"]  # who walks there, -1 nobody
    time_left: Float[Array, "Q"]  # s, of the stay that was drawn; 0 or less while the holder waits, and without one


def whose(memory: Memory, patience: Int[Array, "Q"], time_step: float) -> Seats:
    """Who stands at each seat, and who walks there.

    Args:
        patience: (Q,) ticks, for which the holder of each seat waits for a successor.
        time_step: s, of control.
    """
    seat, person = jnp.arange(patience.shape[0], dtype=jnp.int32), jnp.arange(memory.seat.shape[0], dtype=jnp.int32)
    own, stands = memory.seat[:, None] == seat[None, :], (memory.stay > 0)[:, None]
    holder = jnp.max(jnp.where(own & stands, person[:, None], -1), axis=0, initial=-1)
    successor = jnp.max(jnp.where(own & ~stands, person[:, None], -1), axis=0, initial=-1)
    left = jnp.max(jnp.where(own, memory.stay[:, None], 0), axis=0, initial=0)
    return Seats(holder, successor, (left - patience).astype(float) * time_step)


def of_seat(values: Shaped[Array, "Q *shape"], seat: Int[Array, "N"]) -> Shaped[Array, "N *shape"]:
    """The values of people's seats.

    Args:
        values: (Q, ...) of each seat.
        seat: (N,) of each person, -1 none.

    Returns:
        (N, ...): any row for who has no seat, zeros if there are no seats.
    """
    if values.shape[0] == 0:
        return jnp.zeros((*seat.shape, *values.shape[1:]), values.dtype)
    return values[jnp.maximum(seat, 0)]
