"""Periodic scenes: who walks out at one end comes in at the other, and forces act across the seam."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from sean_jax.base import Pedestrians, Scenario, State


@dataclass(frozen=True)
class Periodic:
    """A pedestrian model in a world that repeats along x; equal for equal models, so that programs are shared.

    Each person has an image one period away, on the side of the seam that is nearer. So of two people each sees the
    other over the shorter way, if that is less than half a period; farther, forces do not reach across the seam.
    People are at x from 0 to the period, and walls must go on for half a period at both ends.
    """

    move: Callable[[Scenario, State], Pedestrians]

    def __call__(self, scenario: Scenario, state: State) -> Pedestrians:
        """Everybody one control step later.

        Args:
            scenario: of ``walkers_behavior`` with a period.
            state: with N people, at x from 0 to the period, none of whom walks in company.

        Returns:
            N people, at x from 0 to the period.
        """
        people, period = state.pedestrians, scenario.behavior.data.period
        number = people.group.shape[0]
        side = jnp.where(people.position[:, 0] < 0.5 * period, period, -period)
        images = replace(people, position=people.position.at[:, 0].add(side))
        both = jax.tree.map(lambda one, other: jnp.concatenate([one, other]), people, images)
        after = self.move(replace(scenario, people=2 * number), replace(state, pedestrians=both))
        after = jax.tree.map(lambda leaf: leaf[:number], after)
        x = after.position[:, 0]
        return replace(after, position=after.position.at[:, 0].set(x - period * jnp.floor(x / period)))
