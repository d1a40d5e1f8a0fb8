"""People of an environment on its Behavior Graph: members of groups who press each other, and how derivatives grow."""

from collections.abc import Callable
from dataclasses import replace
from operator import attrgetter
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from sean_jax.core import random_streams
from sean_jax.core.data_types import Array
from sean_jax.core.geometry import length
from sean_jax.simulation.scenario import reset
from sean_jax.social_forces import Forces, move
from sean_jax.studies.calibration.families import Rows, gaps
from sean_jax.studies.scenes import Model
from sean_jax.studies.scenes.simulation import advance
from sean_jax.studies.validation import groups

ENVIRONMENT = "warehouse"
EPISODES, SECONDS = 8, 20.0
PROBES = "repulsion.strength", "repulsion.range", "walking.relaxation_time"  # constants, as in docs/gradients.py


class Floor:
    """Episodes of the warehouse.

    Args:
        forces_of: the forces by parameters (P,).
    """

    def __init__(self, forces: Forces, forces_of: Callable[[Array], Forces]):
        scenario: Any = groups.graph_scenario(Model("floor", forces, move), ENVIRONMENT)
        keys = jax.random.split(random_streams.key("groups", 0), EPISODES)
        steps = round(SECONDS / scenario.time_step)

        def walk(forces: Forces, change: Array, key: Array) -> tuple[Array, tuple[Array, Array]]:
            changed = forces.tree_replace({name: attrgetter(name)(forces) + change for name in PROBES})
            own = replace(scenario, forces=changed)
            start = reset(own, key)
            start = replace(start, robot=replace(start.robot, position=jnp.full(2, groups.AWAY, float)))

            def turn(state: Any, _: None) -> tuple[Any, tuple[Array, Array]]:
                after = advance(own, state)
                people, step = after.pedestrians, after.pedestrians.velocity - state.pedestrians.velocity
                together = (people.group[:, None] == people.group[None]) & (people.group[:, None] >= 0)
                deep = -jnp.where(together, gaps(own, people), 0.0).min()
                strong = length(step[:, 0], step[:, 1]) > groups.STRONG * own.time_step
                return after, (deep, strong.astype(float).mean())

            state, (deep, strong) = jax.lax.scan(turn, start, length=steps)
            return state.pedestrians.position, (deep.max(), 60.0 / scenario.time_step * strong.mean())

        def one(values: Array) -> tuple[Array, Array, Array]:
            def episode(key: Array) -> tuple[Array, Array, Array]:
                nothing = jnp.zeros((), float)
                derive = lambda change: walk(forces_of(values), change, key)  # noqa: E731
                _, moved, (deep, strong) = jax.jvp(derive, (nothing,), (nothing + 1.0,), has_aux=True)
                return jnp.log10(jnp.sqrt((moved * moved).sum())), deep, strong

            growth, deep, strong = jax.vmap(episode)(keys)
            return jnp.median(growth), deep.max(), strong.mean()

        self._run = jax.jit(lambda values: jax.lax.map(one, values))

    def rows(self, values: Float[Array, "L P"]) -> Rows:
        """The measured rows (L,) of L candidates."""
        names = "growth", "members overlap", "members strong"
        return dict(zip(names, map(np.asarray, self._run(values)), strict=True))
