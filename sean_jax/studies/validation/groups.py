"""Checks of people on Behavior Graphs (section IV-D): how full their groups are, and how their bodies move."""

from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from sean_jax import social_forces
from sean_jax.core import random_streams
from sean_jax.core.data_types import Array, Scenario, State
from sean_jax.people.behaviors.graph_choices import MAX_WAIT
from sean_jax.simulation import making
from sean_jax.simulation.scenario import reset
from sean_jax.social_forces.forces import look_direction
from sean_jax.studies.scenes import Model
from sean_jax.studies.scenes.simulation import advance
from sean_jax.studies.validation.checks import (
    CheckContext,
    CheckResult,
    curve,
    level,
    result,
)
from sean_jax.studies.validation.measures import accelerations, overlap
from sean_jax.world import environment

MEMBERS, FULL = 0.8, 0.5  # of the capacity on average; of the time
SECONDS, EPISODES = 300.0, 16
QUICK = 120.0, 4  # s, episodes
AWAY = 1e3  # m, where the robot stands
BODIES = "warehouse", "lab"  # environments in which bodies are measured
DEPTH = 0.01  # m, by which two members of a group overlap at most
STRONG = 8.0  # m/s2, which no person has
LATER = 4  # control steps, over which accelerations are measured as in recordings


@dataclass(frozen=True)
class GroupOccupancy:
    """Occupancy of G conversational groups (section IV-D) over time, and the stays that ended."""

    mean: Float[np.ndarray, "G"]  # members over capacity, from 0 to 1
    full: Float[np.ndarray, "G"]  # share of the time with all members
    empty: Float[np.ndarray, "G"]  # share of the time without any
    largest: Int[np.ndarray, "G"]  # most members at once
    stays: tuple[Float[np.ndarray, "K"], ...]  # s, of each group: stays that were measured as a whole


def group_occupancy(
    group: Int[np.ndarray, "*B T N"],
    capacity: Int[np.ndarray, "G"],
    time_step: float,
    warm_up: float = 20.0,
) -> GroupOccupancy:
    """Occupancy of groups, and stays of their members.

    Args:
        group: (..., T, N) the group in which each person is at each step, -1 none; of one or more episodes.
        capacity: (G,) people that each group is for.
        warm_up: s, at the beginning of each episode, that do not count.
    """
    group = np.asarray(group)
    group = group.reshape(-1, *group.shape[-2:])[:, round(warm_up / time_step) :]
    capacity = np.asarray(capacity)
    members = np.stack([(group == g).sum(-1) for g in range(len(capacity))], -1).reshape(-1, len(capacity))
    return GroupOccupancy(
        mean=members.mean(0) / capacity,
        full=(members >= capacity).mean(0),
        empty=(members == 0).mean(0),
        largest=members.max(0),
        stays=tuple(_stays(group == g) * time_step for g in range(len(capacity))),
    )


def _stays(inside: np.ndarray) -> np.ndarray:
    """(K,) steps of each whole stay in (B, T, N); stays cut by the beginning or the end do not count."""
    outside = np.zeros((len(inside), 1, inside.shape[-1]), bool)
    padded = np.concatenate([outside, inside, outside], axis=1).swapaxes(1, 2)  # (B, N, T + 2)
    change = np.diff(padded.astype(np.int8), axis=-1)
    began, ended = np.nonzero(change == 1)[-1], np.nonzero(change == -1)[-1]  # in pairs, as people come in their order
    complete = (began > 0) & (ended < inside.shape[1])
    return (ended - began)[complete]


def occupancy(context: CheckContext) -> CheckResult:
    """How full the groups of the Behavior Graph are in each environment."""
    names = ["warehouse"] if context.quick else environment.available()
    seconds, episodes = QUICK if context.quick else (SECONDS, EPISODES)
    measured = {}
    for name in context.progress(names):
        measured[name] = in_environment(context.model, name, seconds, episodes)
    return compare_occupancy(measured)


def in_environment(model: Model, name: str, seconds: float, episodes: int) -> tuple[GroupOccupancy, np.ndarray]:
    """The occupancy of groups in episodes after 20 s, and (G, 2) s, shortest and longest stay that are drawn."""
    scenario = graph_scenario(model, name)
    group = np.asarray(_walk(scenario, seconds, episodes).group)
    graph = jax.tree.map(np.asarray, scenario.behavior.data.graph)
    return group_occupancy(group, graph.capacity[graph.groups], scenario.time_step), graph.stay[graph.groups]


def graph_scenario(model: Model, name: str) -> Scenario:
    """People of a model in an environment on its Behavior Graph, with a robot beside them."""
    scenario = making.make(name, behavior="graph", task="random_ab_nav", robot="kuri")
    substeps = social_forces.substeps(model.forces, scenario.time_step)
    return replace(scenario, forces=model.forces, move=model.move, substeps=substeps)


class GraphWalk(NamedTuple):
    """People in B episodes of T steps."""

    group: Int[Array, "*B T N"]
    position: Float[Array, "*B T N 2"]  # m
    velocity: Float[Array, "*B T N 2"]  # m/s
    facing: Float[Array, "*B T N 2"]  # unit vectors


def _walk(scenario: Scenario, seconds: float, episodes: int) -> GraphWalk:
    """Some episodes in which no robot is near, as numpy arrays."""
    keys = jax.random.split(random_streams.key("groups", 0), episodes)
    return jax.tree.map(np.asarray, _episodes(round(seconds / scenario.time_step), scenario, keys))


@partial(jax.jit, static_argnums=0)
@partial(jax.vmap, in_axes=(None, None, 0))
def _episodes(steps: int, scenario: Scenario, key: Array) -> GraphWalk:
    state = reset(scenario, key)
    away = replace(state.robot, position=jnp.full(2, AWAY, float))

    def step(state: State, _: None) -> tuple[State, GraphWalk]:
        state = advance(scenario, state)
        people = state.pedestrians
        facing = jnp.stack(look_direction(people), -1)
        return state, GraphWalk(people.group, people.position, people.velocity, facing)

    return jax.lax.scan(step, replace(state, robot=away), length=steps)[1]


def compare_occupancy(by_name: dict[str, tuple[GroupOccupancy, np.ndarray]]) -> CheckResult:
    """The result of occupancies by environment, of ``in_environment``."""
    # Groups are numbered within each environment; a group that nobody has left counts as an endless stay.
    names, stays = [], []
    for name, (occupied, _) in by_name.items():
        names += [f"{name} {k + 1}" for k in range(len(occupied.mean))]
        stays += [group_stays.mean() if len(group_stays) else np.inf for group_stays in occupied.stays]

    # Stays are uniform, so their mean is in the middle; who waits for a successor adds MAX_WAIT at most.
    stay = np.array(stays)
    members = np.concatenate([occupied.mean for occupied, _ in by_name.values()])
    full = np.concatenate([occupied.full for occupied, _ in by_name.values()])
    shortest, longest = np.concatenate([drawn for _, drawn in by_name.values()]).T  # (G,) s each
    changes = bool(((stay >= shortest) & (stay <= (shortest + longest) / 2 + MAX_WAIT)).all())

    # Environments differ in their numbers of groups, so the plot has all groups in a row.
    number = tuple(np.arange(1.0, len(names) + 1.0))
    numbers: dict[str, float] = {}
    for word, values in (("members", members), ("full", full), ("stay", stay)):
        numbers |= {f"{word}_{name}": float(value) for name, value in zip(names, values, strict=True)}

    # Members alone could be steady with a seat that is always free: both shares have to be large.
    return result(
        bool((members >= MEMBERS).all() and (full >= FULL).all() and changes),
        f"{100 * members.min():.0f} % of the members on average at least, full {100 * full.min():.0f} % of the time at "
        f"least, mean stays of {stay.min():.1f} to {stay.max():.1f} s",
        f"{100 * MEMBERS:.0f} % of the members, full {100 * FULL:.0f} % of the time, stays as drawn",
        numbers=numbers,
        curves=(
            curve("members, share of the capacity", number, members, points=True),
            curve("full, share of the time", number, full, points=True),
            level("members wanted", number, MEMBERS),
            level("full wanted", number, FULL),
        ),
        axes=("group: " + ", ".join(names), "share"),
    )


def bodies(context: CheckContext) -> CheckResult:
    """How deep members of one group overlap, and the accelerations of all, in two environments."""
    walking = context.model.forces.walking
    numbers: dict[str, float] = {}
    words = []
    for name in context.progress(BODIES):
        scenario = graph_scenario(context.model, name)
        walk = _walk(scenario, *QUICK)
        present = np.ones(walk.group.shape[1:], bool)
        episodes = zip(walk.position, walk.facing, walk.group, strict=True)
        deepest = max(overlap(position, facing, present, walking, group) for position, facing, group in episodes)

        size = accelerations(walk.velocity, scenario.time_step)
        as_recorded = accelerations(walk.velocity[:, ::LATER], LATER * scenario.time_step)
        usual, rare = np.quantile(as_recorded, [0.95, 0.99])
        strong = 60.0 / scenario.time_step * float((size > STRONG).mean())
        values = {"overlap": deepest, "strong": strong, "largest": size.max(), "p95": usual, "p99": rare}
        numbers |= {f"{word}_{name}": float(value) for word, value in values.items()}
        words.append(
            f"{name}: members overlap by {1000 * deepest:.0f} mm at most; above {STRONG:g} m/s² {strong:.2f} times a "
            f"person and minute, {size.max():.0f} at most; at 0.4 s 95 % below {usual:.2f}, 99 % below {rare:.2f} m/s²"
        )
    return result(
        all(numbers[f"overlap_{name}"] <= DEPTH and numbers[f"strong_{name}"] == 0.0 for name in BODIES),
        "; ".join(words),
        f"{1000 * DEPTH:g} mm at most, never above {STRONG:g} m/s²",
        numbers=numbers,
    )
