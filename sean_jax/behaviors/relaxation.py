"""Random choices on the graph with a softmax temperature, and likelihood-ratio gradients of their consequences.

Goals, routes, seats and stay times are discrete: a small change of a weight changes nothing, or everything after it.
With a temperature T each choice is sampled with a differentiable chance, and the state has the sum of the log chances
of all choices. Then

    d E[f] = E[df + (f - b) d(log chance)]

where df is the derivative with fixed samples, and b a baseline that does not depend on this episode's choices. This is
unbiased for all f, unlike a relaxation that walks a bit towards each goal. As T goes to 0 people choose as without one:
the cheapest way, the best seat, stays uniform between two limits. Without a temperature nothing of this is computed.

Source: P. W. Glynn, Likelihood ratio gradient estimation for stochastic systems, Communications of the ACM 33(10),
1990; W. Kool, H. van Hoof & M. Welling, Buy 4 REINFORCE samples, get a baseline for free!, 2019 (b: the others' mean).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int

from sean_jax.base import Array

WALK = 1.0  # m/s, converts a temperature in metres to seconds, for choices between times
SHORTEST = 1e-3  # s, minimum difference of the limits of stays


class Draws(NamedTuple):
    """The additional uniform numbers, from 0 to 1, of a step with a temperature."""

    temperature: Float[Array, ""]  # m
    hop: Float[Array, "N"]  # route
    stay: Float[Array, "N"]  # stay time beyond its limits
    seat: Float[Array, "N"]  # seat that a person asks for
    taker: Float[Array, "Q"]  # person whom a seat takes


def draw(key: Array, temperature: Float[Array, ""], people: int, seats: int) -> Draws:
    """The draws of a step with a temperature [m]."""
    person_key, seat_key = jax.random.split(key)
    hop, stay, seat = jax.random.uniform(person_key, (3, people), float)
    return Draws(temperature, hop, stay, seat, jax.random.uniform(seat_key, (seats,), float))


def sample(log_chance: Float[Array, "N K"], chance: Float[Array, "N"]) -> tuple[Int[Array, "N"], Float[Array, "N"]]:
    """One of K for each of N by a uniform number from 0 to 1, and its log chance."""
    number = log_chance.shape[1]
    below = jnp.cumsum(jnp.exp(jax.lax.stop_gradient(log_chance)), axis=1)
    index = jnp.sum(below <= chance[:, None] * below[:, -1:], axis=1, dtype=jnp.int32)
    index = jnp.minimum(index, number - 1)
    return index, jnp.take_along_axis(log_chance, index[:, None], axis=1)[:, 0]


def log_chances(score: Float[Array, "N K"], temperature: Float[Array, ""]) -> Float[Array, "N K"]:
    """Log chances by a softmax over scores [s], where lower is likelier, with a temperature [m].

    A score of inf cannot be chosen. A row without finite scores gets any finite numbers.
    """
    possible = jnp.isfinite(score)
    logits = jnp.where(possible, -jnp.where(possible, score, 0.0) * (WALK / temperature), -1e30)
    return jax.nn.log_softmax(logits, axis=1)


def sample_stay(
    limits: Float[Array, "N 2"], chance: Float[Array, "2 N"], temperature: Float[Array, ""], time_step: float
) -> tuple[Int[Array, "N"], Float[Array, "N"]]:
    """Stay times in ticks, uniform between two limits [s] with soft edges, rounded up; and their log chances.

    The time is the sum of a uniform and a logistic one, whose chances are differences of softplus functions.

    Args:
        chance: uniform from 0 to 1.
        temperature: m.
        time_step: s, of a tick.
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
    """The share of a step, from 0 to 1, that people walk towards their next target.

    People come within ``radius`` [m] of a target during a step, not at its end. With this share of the new direction
    and the rest of the old one, positions do not jump as people arrive a step earlier or later.

    Args:
        distance: m, to the target that is reached.
        before: m, how much farther it was a step ago, at the present speed.
    """
    return jnp.clip((radius - distance) / jnp.maximum(before, 1e-6), 0.0, 1.0)


def expectation(values: Float[Array, "B"], log_chance: Float[Array, "B"]) -> Float[Array, ""]:
    """The mean over two or more episodes, with an unbiased gradient of the expected value.

    Args:
        values: a measure of each episode.
        log_chance: ``state.memory.log_chance`` of each.
    """
    number = values.shape[0]
    constant = jax.lax.stop_gradient(values)
    others = (jnp.sum(constant) - constant) / max(number - 1, 1)
    weight = (constant - others) * (log_chance - jax.lax.stop_gradient(log_chance))
    return jnp.mean(values) + jnp.mean(weight)
