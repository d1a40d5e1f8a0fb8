"""Choices with a chance: how people choose on the graph with a temperature, and derivatives of what follows from it.

Which goal, which way, who takes which seat and how long somebody stays are discrete: a small change of a weight changes
nothing, or all that follows. With a temperature T each choice is a draw with a chance that has a derivative, and the
state keeps the sum of the logarithms of the chances of all that was drawn. Then

    d E[f] = E[df + (f - b) d(log chance)]

where df is the derivative with all draws held fixed, and b anything that does not depend on this episode's draws. This
is unbiased, whatever f is, as is no relaxation that walks a bit towards each goal. As T goes to 0 people choose as
without one: the cheapest way, the seat that suits best, stays uniform between two limits. Without a temperature nothing
of this is computed.

Source: P. W. Glynn, Likelihood ratio gradient estimation for stochastic systems, Communications of the ACM 33(10),
1990; W. Kool, H. van Hoof & M. Welling, Buy 4 REINFORCE samples, get a baseline for free!, 2019 (b: the others' mean).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int

from sean_jax.base import Array
from sean_jax.behaviors.graph_memory import Memory

WALK = 1.0  # m/s, by which a temperature in metres is one in seconds, for choices between times
SHORTEST = 1e-3  # s, the least by which the limits of stays differ


class Draws(NamedTuple):
    """What is drawn in a step with a temperature, beside what is drawn without."""

    temperature: Float[Array, ""]  # m
    hop: Float[Array, "N"]  # uniform from 0 to 1: which way
    stay: Float[Array, "N"]  # likewise: how far beyond the limits of stays
    seat: Float[Array, "N"]  # likewise: for which seat somebody asks
    taker: Float[Array, "Q"]  # likewise: whom a seat takes


def draw(key: Array, temperature: Float[Array, ""], people: int, seats: int) -> Draws:
    """The draws of a step.

    Args:
        temperature: m.
    """
    person_key, seat_key = jax.random.split(key)
    hop, stay, seat = jax.random.uniform(person_key, (3, people), float)
    return Draws(temperature, hop, stay, seat, jax.random.uniform(seat_key, (seats,), float))


def added(memory: Memory, log_chance: Float[Array, ""]) -> Memory:
    """The memory after further choices.

    Args:
        log_chance: () sum of the logarithms of the chances of what was drawn.
    """
    assert memory.log_chance is not None  # reset has made it
    return memory._replace(log_chance=memory.log_chance + log_chance)


def drawn(log_chance: Float[Array, "N K"], chance: Float[Array, "N"]) -> tuple[Int[Array, "N"], Float[Array, "N"]]:
    """One of K for each of N, at a place of their cumulated chances.

    Args:
        log_chance: (N, K) logarithms of chances that add up to 1.
        chance: (N,) uniform from 0 to 1.

    Returns:
        (N,) which one, and (N,) the logarithm of its chance.
    """
    number = log_chance.shape[1]
    below = jnp.cumsum(jnp.exp(jax.lax.stop_gradient(log_chance)), axis=1)
    index = jnp.sum(below <= chance[:, None] * below[:, -1:], axis=1, dtype=jnp.int32)
    index = jnp.minimum(index, number - 1)
    return index, jnp.take_along_axis(log_chance, index[:, None], axis=1)[:, 0]


def log_chances(score: Float[Array, "N K"], temperature: Float[Array, ""]) -> Float[Array, "N K"]:
    """With what chance each of N chooses each of K: the smaller the score, the likelier.

    Args:
        score: (N, K) s, inf for what cannot be chosen.
        temperature: m.

    Returns:
        (N, K) logarithms; of a row in which nothing can be chosen any finite numbers.
    """
    possible = jnp.isfinite(score)
    logits = jnp.where(possible, -jnp.where(possible, score, 0.0) * (WALK / temperature), -1e30)
    return jax.nn.log_softmax(logits, axis=1)


def drawn_stay(
    limits: Float[Array, "N 2"], chance: Float[Array, "2 N"], temperature: Float[Array, ""], time_step: float
) -> tuple[Int[Array, "N"], Float[Array, "N"]]:
    """How many ticks people stay: uniform between two limits whose edges are soft, rounded up.

    The sum of a uniform time and of a logistic one, whose chances are differences of softplus functions.

    Args:
        limits: (N, 2) s.
        chance: (2, N) uniform from 0 to 1.
        temperature: m.
        time_step: s, of a tick.

    Returns:
        (N,) ticks, 0 or more, and (N,) the logarithm of their chance.
    """
    width = temperature / WALK
    low, high = limits[:, 0], jnp.maximum(limits[:, 1], limits[:, 0] + SHORTEST)
    noise = jnp.clip(chance[1], 1e-6, 1.0 - 1e-6)
    time = low + chance[0] * (high - low) + width * (jnp.log(noise) - jnp.log1p(-noise))
    ticks = jax.lax.stop_gradient(jnp.ceil(jnp.maximum(time, 0.0) / time_step))

    def below(time: Array) -> Array:
        return width * (jax.nn.softplus((time - low) / width) - jax.nn.softplus((time - high) / width)) / (high - low)

    share = below(ticks * time_step) - jnp.where(ticks > 0.0, below((ticks - 1.0) * time_step), 0.0)
    return ticks.astype(jnp.int32), jnp.log(jnp.maximum(share, 1e-12))


def switched_share(distance: Float[Array, "N"], before: Float[Array, "N"], radius: float) -> Float[Array, "N"]:
    """The share of a step for which somebody is already on the way to their next target.

    Somebody who comes within ``radius`` of a target does so within a step, and not at its end. With this share of the
    new direction and the rest of the old one, where people are does not jump as they arrive a step earlier or later.

    Args:
        distance: (N,) m, to the target that is reached.
        before: (N,) m, by how much it was farther a step ago, at the speed of now.
        radius: m, at which it counts as reached.

    Returns:
        (N,) from 0, reached now, to 1, reached a step ago.
    """
    return jnp.clip((radius - distance) / jnp.maximum(before, 1e-6), 0.0, 1.0)


def expectation(values: Float[Array, "B"], log_chance: Float[Array, "B"]) -> Float[Array, ""]:
    """The mean over episodes, with the derivative that it has because choices change too.

    Args:
        values: (B,) what is measured of each of two or more episodes.
        log_chance: (B,) logarithm of the chance of all that was drawn in each, ``state.memory.log_chance``.

    Returns:
        () the mean. Its gradient is that of the expected value, without a bias.
    """
    number = values.shape[0]
    held = jax.lax.stop_gradient(values)
    others = (jnp.sum(held) - held) / max(number - 1, 1)
    weight = (held - others) * (log_chance - jax.lax.stop_gradient(log_chance))
    return jnp.mean(values) + jnp.mean(weight)
