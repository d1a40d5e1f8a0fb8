"""People of an environment on its Behavior Graph: members of groups who press each other, and how derivatives grow."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from operator import attrgetter

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from sean_jax.core import random_streams
from sean_jax.core.data_types import Array, Scenario, State
from sean_jax.simulation.scenario import reset
from sean_jax.social_forces import Forces, move
from sean_jax.social_forces.forces import look_direction
from sean_jax.studies.calibration.families import Rows
from sean_jax.studies.scenes import Model
from sean_jax.studies.scenes.simulation import advance
from sean_jax.studies.validation import groups
from sean_jax.studies.validation.measures import accelerations, body_gaps

ENVIRONMENT = "warehouse"
EPISODES, SECONDS = 8, 20.0
PROBES = "repulsion.strength", "repulsion.range", "walking.relaxation_time"  # constants, as in docs/gradients.py


class CrowdedFloor:
    """Episodes of the warehouse.

    Args:
        forces_of: the forces by parameters (P,).
    """

    def __init__(self, forces: Forces, forces_of: Callable[[Array], Forces]):
        scenario = groups.graph_scenario(Model("floor", forces, move), ENVIRONMENT)
        measure = partial(_measure, scenario, forces_of)
        self._run = jax.jit(lambda parameters: jax.lax.map(measure, parameters))

    def rows(self, parameters: Float[Array, "L P"]) -> Rows:
        """The measured rows (L,) of L candidates."""
        names = "growth", "members overlap", "members strong"
        return dict(zip(names, map(np.asarray, self._run(parameters)), strict=True))


def _measure(
    scenario: Scenario, forces_of: Callable[[Array], Forces], parameters: Float[Array, "P"]
) -> tuple[Array, Array, Array]:
    """Growth of derivatives, depth of overlap [m] and strong accelerations a minute, of all episodes."""
    keys = jax.random.split(random_streams.key("groups", 0), EPISODES)
    forces = forces_of(parameters)

    def episode(key: Array) -> tuple[Array, Array, Array]:
        zero = jnp.zeros((), float)
        walk = partial(_walk, scenario, forces, key)
        _, derivative, (depth, strong) = jax.jvp(walk, (zero,), (zero + 1.0,), has_aux=True)
        return jnp.log10(jnp.sqrt((derivative * derivative).sum())), depth, strong

    growth, depth, strong = jax.vmap(episode)(keys)
    return jnp.median(growth), depth.max(), strong.mean()


def _walk(scenario: Scenario, forces: Forces, key: Array, change: Array) -> tuple[Array, tuple[Array, Array]]:
    """Places (N, 2) m at the end of an episode, with ``PROBES`` changed; depth of overlap, strong accelerations."""
    changed = forces.tree_replace({name: attrgetter(name)(forces) + change for name in PROBES})
    scenario = replace(scenario, forces=changed)
    steps = round(SECONDS / scenario.time_step)

    start = reset(scenario, key)
    start = replace(start, robot=replace(start.robot, position=jnp.full(2, groups.AWAY, float)))

    def turn(state: State, _: None) -> tuple[State, tuple[Array, Array]]:
        after = advance(scenario, state)
        people = after.pedestrians
        facing = jnp.stack(look_direction(people), -1)
        gap = body_gaps(people.position, facing, people.present, changed.walking, people.group)

        velocity = jnp.stack([state.pedestrians.velocity, people.velocity])  # (2, N, 2)
        strong = accelerations(velocity, scenario.time_step) > groups.STRONG
        return after, (jnp.maximum(-gap.min(), 0.0), strong.astype(float).mean())

    state, (depth, strong) = jax.lax.scan(turn, start, length=steps)
    return state.pedestrians.position, (depth.max(), 60.0 / scenario.time_step * strong.mean())
