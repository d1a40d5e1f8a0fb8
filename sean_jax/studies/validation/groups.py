"""Groups that last (section IV-D): the Behavior Graph maintains groups while their members come and go."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import assembly, environment, prng, social_forces
from sean_jax.base import Array, Scenario
from sean_jax.behaviors.graph_choices import MAX_WAIT
from sean_jax.scenario import reset
from sean_jax.studies.scenes.simulation import advance
from sean_jax.studies.validation.check import Check, Curve, Finding, Laboratory, judge
from sean_jax.studies.validation.group_occupancy import GroupOccupancy, group_occupancy

MEMBERS, FULL = 0.8, 0.5  # of the capacity on average; of the time
SECONDS, EPISODES = 300.0, 16
QUICK = 120.0, 4  # likewise
AWAY = 1e3  # m, where the robot stands


def occupancy(laboratory: Laboratory) -> Finding:
    """How full the groups of the Behavior Graph are in each environment."""
    names = ["warehouse"] if laboratory.quick else environment.available()
    found: dict[str, tuple[GroupOccupancy, np.ndarray]] = {}
    for done, name in enumerate(names):
        found[name] = in_environment(laboratory, name, *(QUICK if laboratory.quick else (SECONDS, EPISODES)))
        if laboratory.tell is not None:
            laboratory.tell((done + 1) / len(names))
    return compare(found)


def in_environment(
    laboratory: Laboratory, name: str, seconds: float, episodes: int
) -> tuple[GroupOccupancy, np.ndarray]:
    """The occupancy of groups in episodes of an environment.

    Returns:
        The occupancy, after 20 s, and (G, 2) s, shortest and longest stay that are drawn in each group.
    """
    moved_by = laboratory.model
    scenario = assembly.make(name, behavior="graph", task="random_ab_nav", robot="kuri", dynamics="twin")
    substeps = social_forces.substeps(moved_by.forces, scenario.time_step)
    scenario = replace(scenario, forces=moved_by.forces, move=moved_by.move, substeps=substeps)
    keys = jax.random.split(prng.key("groups", 0), episodes)
    group = np.asarray(_groups(round(seconds / scenario.time_step), scenario, keys))
    graph = jax.tree.map(np.asarray, scenario.behavior.data.graph)
    return group_occupancy(group, graph.capacity[graph.groups], scenario.time_step), graph.stay[graph.groups]


@partial(jax.jit, static_argnums=0)
@partial(jax.vmap, in_axes=(None, None, 0))
def _groups(steps: int, scenario: Scenario, key: Array) -> Array:
    """(steps, N) the group in which each person is, in an episode in which no robot is near."""
    state = reset(scenario, key)
    away = replace(state.robot, position=jnp.full(2, AWAY, float))

    def step(state, _):
        state = advance(scenario, state)
        return state, state.pedestrians.group

    return jax.lax.scan(step, replace(state, robot=away), length=steps)[1]


def compare(found: dict[str, tuple[GroupOccupancy, np.ndarray]]) -> Finding:
    """The finding of occupancies.

    Args:
        found: by environment, of ``in_environment``.
    """
    members = np.concatenate([each.mean for each, _ in found.values()])
    full = np.concatenate([each.full for each, _ in found.values()])
    stays = np.array([stays.mean() if len(stays) else np.inf for each, _ in found.values() for stays in each.stays])
    shortest, longest = np.concatenate([drawn for _, drawn in found.values()]).T
    changes = bool(((stays >= shortest) & (stays <= (shortest + longest) / 2 + MAX_WAIT)).all())
    names = [f"{name} {k + 1}" for name, (each, _) in found.items() for k in range(len(each.mean))]
    number = tuple(np.arange(1.0, len(names) + 1.0))
    measured = {"members": members, "full": full, "stay": stays}
    return judge(
        bool((members >= MEMBERS).all() and (full >= FULL).all() and changes),
        f"{100 * members.min():.0f} % of the members on average at least, full {100 * full.min():.0f} % of the time at "
        f"least, mean stays of {stays.min():.1f} to {stays.max():.1f} s",
        f"{100 * MEMBERS:.0f} % of the members, full {100 * FULL:.0f} % of the time, stays as drawn",
        numbers={f"{what}_{name}": float(each[k]) for what, each in measured.items() for k, name in enumerate(names)},
        curves=(
            Curve("members, share of the capacity", number, tuple(members), points=True),
            Curve("full, share of the time", number, tuple(full), points=True),
            Curve("members wanted", (number[0], number[-1]), (MEMBERS,) * 2, reference=True),
            Curve("full wanted", (number[0], number[-1]), (FULL,) * 2, reference=True),
        ),
        axes=("group: " + ", ".join(names), "share"),
    )


CHECKS = (
    Check(
        name="group-occupancy",
        title="Groups last while their members change",
        setup="62 people on the Behavior Graphs of all environments (with --quick of the warehouse), 300 s, 16 "
        "episodes (with --quick 120 s, 4 episodes), no robot.",
        measure="members over capacity, share of the time with all members, stays that end; after 20 s",
        criterion="each group: 80 % of its members on average, all of them half of the time; the mean stay not below "
        f"the shortest that is drawn, nor above the mean that is drawn by more than the {MAX_WAIT:g} s of waiting",
        source="SEAN 2.0, section IV-D: groups are maintained while people move in and out",
        function=occupancy,
    ),
)
