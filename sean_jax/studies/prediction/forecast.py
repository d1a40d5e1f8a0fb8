"""Predicted people: observed positions in, the tracks of a pedestrian model out (section IV-D, low level).

Desired velocities are not recorded: a person has and desires the velocity of the last observed step, or a weighted mean
of the last few. The model does the rest.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Bool, Float, Int

from sean_jax import social_forces
from sean_jax.core import random_streams
from sean_jax.core.data_types import (
    Array,
    Behavior,
    Environment,
    ObstacleGrid,
    Obstacles,
    Pedestrians,
    Robot,
    RobotModel,
    Scenario,
    State,
)
from sean_jax.core.geometry import build_obstacle_grid, length
from sean_jax.people.pedestrian_models import pedestrians_at
from sean_jax.social_forces import SUBSTEP, Cohesion, Forces, Term
from sean_jax.studies import scenes

CONTROL_STEP = 0.1  # s, at most, in which a pedestrian model moves people
MARGIN = 50.0  # m of open floor around walls
MOST_SETTLED = 0.1  # maximum change of the desired velocity, as a share of the observed
COMPANION_DISTANCE = 1.2  # m, maximum distance between companions
UNLIKE_SPEED = 0.25  # m/s, by which their mean velocities differ at most
WALKING_SPEED = 0.3  # m/s; slower people stand
FAR = 1e4  # m, where the robot stands that no recording has

HABITS = {"weights": (0.98,), "settled": 0.5}  # of ``predict``; ``sean calibrate`` finds .981 and .53 in all scenes
T = TypeVar("T")
Predictable = str | Iterable[Term] | Callable[[Scenario, State], Pedestrians]


class ForecastScene(NamedTuple):
    """N people whom ``predict`` is to predict."""

    observed: Array  # (T, N, 2) m
    present: Array  # (T, N) bool
    desired_velocity: Array | None  # (N, 2) m/s
    others: Array | None  # (steps + 1, M, 2) m
    key: Array | None  # of people's differences and noise


def predict(
    model: Predictable,
    observed: Float[Array, "*batch T N 2"],
    time_step: float,
    steps: int,
    *,
    present: Bool[Array, "*batch T N"] | None = None,
    walls: Obstacles | ObstacleGrid | None = None,
    weights: Float[Array, "K"] | tuple[float, ...] = (1.0,),
    least_speed: Float[Array, ""] | float = 0.0,
    desired_velocity: Float[Array, "*batch N 2"] | None = None,
    others: Float[Array, "*batch moments M 2"] | None = None,
    settled: Float[Array, ""] | float = 0.0,
    key: Array | None = None,
) -> Float[Array, "*batch steps N 2"]:
    """Predict recorded people with a pedestrian model.

    Differentiable by positions, weights, and parameters of forces, with checkpointing. Batch axes are independent
    scenes.

    Args:
        model: a key of ``PRESETS``, a YAML file of constants, or forces; a key of ``MODELS``, or a function (scenario,
            state) -> Pedestrians.
        observed: (..., T, N, 2) m, in the order of time; NaN of people who are not observed.
        time_step: s between observed positions, and between predicted ones.
        present: (..., T, N) people observed, besides NaN.
        weights: (K,) of the velocities in the last K steps, the latest first; unobserved steps do not count. People
            start with their weighted mean, and desire it times the sum of the weights: ``(0.97,)`` slows people down.
        least_speed: m/s, lower bound of the preferred speed, which limits how fast people give way.
        desired_velocity: (..., N, 2) m/s, where it is known; by default the observed velocity.
        others: (..., steps + 1, M, 2) m, at the last observed and the predicted times: replayed people,
            such as later arrivals; NaN where they are absent.
        settled: share, from 0 to 1, of the model's acceleration at the last observed moment that is already part of the
            observed velocity (following, walking side by side): the desired velocity is corrected by it, by a tenth at
            most. Social forces only.
        key: for a sample: people differ and have noise, as the forces have it; everybody is average and steady if None.

    Returns:
        (..., steps, N, 2) m. People who are not observed at the last time stay in place.

    Raises:
        InputError: no model has that name, or the terms do not make forces.
    """
    observed = jnp.asarray(observed, float)
    known = jnp.isfinite(observed).all(-1)
    if present is not None:
        known = known & jnp.asarray(present, bool)
    people = scenes.Model("forces", model, social_forces.move) if isinstance(model, Forces) else scenes.model(model)

    # The function is static and the constants are traced, so that a fit over constants compiles once.
    move, forces = people.move, people.forces  # parameters may be traced
    grid = grid_around(walls) if isinstance(walls, Obstacles) else walls

    # Recordings are 0.4 s or so apart, too long for a step of forces; the subtraction forgives rounding.
    control = math.ceil(time_step / CONTROL_STEP - 1e-6)
    substeps = math.ceil(time_step / control / SUBSTEP - 1e-6)

    # Stiff forces need shorter substeps, but a traced constant cannot set a number of steps.
    if not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(forces)):
        substeps = social_forces.substeps(forces, time_step / control)

    # Scenes of a batch share all constants and walls; only what is observed has batch axes.
    walk = partial(_walk, move, control, substeps, steps, time_step)
    scene = ForecastScene(
        observed,
        known,
        None if desired_velocity is None else jnp.asarray(desired_velocity, float),
        None if others is None else jnp.asarray(others, float),
        None if key is None else jax.random.split(key, observed.shape[:-3]),
    )
    for _ in range(observed.ndim - 3):
        walk = jax.vmap(walk, in_axes=(None, None, None, None, None, 0))

    # Only social forces know a relaxation time; without a correction its program is smaller.
    plain = isinstance(settled, int | float) and settled == 0.0
    undone = None if plain or move is not social_forces.move else jnp.asarray(settled, float)
    return walk(forces, grid, jnp.asarray(weights, float), jnp.asarray(least_speed, float), undone, scene)


def observed_people(
    observed: Float[Array, "T N 2"],
    present: Bool[Array, "T N"],
    time_step: float,
    weights: Float[Array, "K"] | tuple[float, ...] = (1.0,),
    least_speed: Float[Array, ""] | float = 0.0,
) -> Pedestrians:
    """N people with the velocity of their last observed steps, which they also desire.

    People are present if they were observed at the last moment [T]; with one observation they stand.

    Args:
        observed: (T, N, 2) m, ``time_step`` s apart.
        weights: (K,) of the velocities in the last K steps, the latest first, as in ``predict``.
        least_speed: m/s, lower bound of the preferred speed.
    """
    weights = jnp.asarray(weights, float)
    count = min(weights.shape[0], observed.shape[0] - 1)
    both = present[1:] & present[:-1]
    steps = jnp.where(both[..., None], observed[1:] - observed[:-1], 0.0) / time_step
    share = weights[:count, None] * both[::-1][:count].astype(float)  # the latest first
    total = share.sum(0)
    share = share / jnp.where(total > 0.0, total, 1.0)[None, :]
    velocity = (share[..., None] * steps[::-1][:count]).sum(0)
    there = present[-1]
    speed = length(velocity[:, 0], velocity[:, 1])
    return pedestrians_at(
        jnp.where(there[:, None], observed[-1], 0.0),
        velocity,
        desired_velocity=weights.sum() * velocity,
        preferred_speed=jnp.maximum(speed, least_speed),
        present=there,
    )


def walking_companions(
    observed: Float[Array, "T N 2"], present: Bool[Array, "T N"], time_step: float
) -> tuple[Int[Array, "N"], Int[Array, "N 2"]]:
    """Walking groups: people who stayed near each other with similar velocities whenever both were observed.

    Companions do not repel or evade each other, like walking groups in simulations.

    Returns:
        (N,) the lowest index within four links of companions, -1 alone; and (N, 2) indices of two companions, -1 none.
    """
    # Which people belong together is a decision, and no derivative goes through it.
    count = observed.shape[1]
    position = jnp.where(present[..., None], jax.lax.stop_gradient(observed), 0.0)  # (T, N, 2)

    # Distances at every moment when both are seen: people who only pass each other were far apart before.
    both = present[:, :, None] & present[:, None, :]  # (T, N, N)
    distance = jnp.linalg.norm(position[:, :, None] - position[:, None, :], axis=-1)  # (T, N, N)
    near = (jnp.where(both, distance, 0.0).max(0) < COMPANION_DISTANCE) & both[-1]

    # Companions walk, and their mean velocities since both are there are similar.
    moment = jnp.arange(observed.shape[0], dtype=jnp.int32)
    first = jnp.argmax(both, axis=0)  # first moment with both
    duration = jnp.maximum(moment[-1] - first, 1).astype(float) * time_step  # (N, N) s
    index = jnp.arange(count, dtype=jnp.int32)
    velocity = (position[-1][:, None] - position[first, index[:, None]]) / duration[..., None]  # (N, N, 2)
    difference = jnp.linalg.norm(velocity - jnp.swapaxes(velocity, 0, 1), axis=-1)
    walking = jnp.linalg.norm(velocity, axis=-1) > WALKING_SPEED
    together = near & walking & walking.T & (difference < UNLIKE_SPEED) & (first < moment[-1] - 1)  # (N, N)
    together = together & (index[:, None] != index[None, :])

    # Companions of companions are one group, over chains of up to four links: each squaring doubles the links.
    linked = together | (index[:, None] == index[None, :])
    for _ in range(2):
        linked = (linked.astype(float) @ linked.astype(float)) > 0.5
    linked = linked & (linked.sum(1) > 1)[:, None]

    # The lowest index is the name of the group.
    group = jnp.where(linked.any(1), jnp.argmax(linked, axis=1).astype(jnp.int32), -1)

    # The two companions with the lowest indices.
    others = linked & (index[:, None] != index[None, :])
    first_companion = jnp.argmax(others, axis=1).astype(jnp.int32)
    further = others & (index[None, :] != first_companion[:, None])
    second_companion = jnp.argmax(further, axis=1).astype(jnp.int32)
    lowest = jnp.where(others.any(1), first_companion, -1), jnp.where(further.any(1), second_companion, -1)
    return group, jnp.stack(lowest, -1)


def grid_around(obstacles: Obstacles) -> ObstacleGrid:
    """The grid of some walls on a floor with much room around them. Runs on the host."""
    reach = jnp.hypot(obstacles.half_extent[:, 0], obstacles.half_extent[:, 1])[:, None]
    lower, upper = (obstacles.center - reach).min(0), (obstacles.center + reach).max(0)
    return build_obstacle_grid(obstacles, jnp.concatenate([lower - MARGIN, upper + MARGIN]))


@partial(jax.jit, static_argnums=(0, 1, 2, 3, 4))
def _walk(
    move: Callable,
    control: int,
    substeps: int,
    steps: int,
    time_step: float,
    forces: Forces,
    grid: ObstacleGrid | None,
    weights: Array,
    least_speed: Array,
    settled: Array | None,
    scene: ForecastScene,
) -> Array:
    """(steps, N, 2) of one scene."""
    # What a person wants is unknown: the observed velocity stands for it, if nothing else is known.
    people = observed_people(scene.observed, scene.present, time_step, weights, least_speed)
    if scene.desired_velocity is not None:
        desired = scene.desired_velocity
        speed = jnp.maximum(length(desired[:, 0], desired[:, 1]), least_speed)
        people = replace(people, desired_velocity=desired, preferred_speed=speed)

    # Companions who are observed walk on together; how they stay together is not to be counted twice.
    count = scene.observed.shape[1]
    group, companions = walking_companions(scene.observed, scene.present, time_step)
    people = replace(people, walking_group=group)
    if forces.get(Cohesion) is not None:  # what draws companions together in simulations is in their tracks already
        off = {f"cohesion.{name}": 0.0 for name in ("gaze", "attraction", "repulsion")}
        forces = forces.tree_replace(off)

    # Replayed people come last; nobody is their companion.
    replayed = None
    if scene.others is not None:
        recorded = jnp.isfinite(scene.others).all(-1)
        replayed = jnp.where(recorded[..., None], scene.others, 0.0), recorded
        people = jax.tree.map(lambda *parts: jnp.concatenate(parts), people, pedestrians_at(replayed[0][0]))
        nobody = jnp.full((recorded.shape[1], 2), -1, companions.dtype)
        companions = jnp.concatenate([companions, nobody])

    # Part of the observed velocity is already a reaction, which the model would add once more.
    scenario, state = _world(move, forces, people, companions, grid, time_step / control, substeps)
    if settled is not None and scene.desired_velocity is None:
        people = _without_reaction(scenario, replace(state, pedestrians=people), settled, control / time_step)

    # A sample draws traits and noise; without a key everybody is the mean of the population.
    if scene.key is not None:
        traits_key = jax.random.fold_in(scene.key, random_streams.TRAITS)
        people = social_forces.individualize(forces, people, traits_key)
        state = replace(state, streams=random_streams.streams(scene.key))

    # Checkpoints at control steps: the backward pass recomputes forces and keeps only states.
    def predict_step(people: Pedestrians, index: Array) -> tuple[Pedestrians, Array]:
        @jax.checkpoint
        def control_step(people: Pedestrians, step: Array) -> tuple[Pedestrians, None]:
            if replayed is not None:
                people = _replay(people, *replayed, index, step.astype(float) / control, time_step)
            return move(scenario, replace(state, pedestrians=people, tick=index * control + step)), None

        people = jax.lax.scan(control_step, people, jnp.arange(control, dtype=jnp.int32))[0]
        return people, people.position[:count]

    position = jax.lax.scan(predict_step, people, jnp.arange(steps, dtype=jnp.int32))[1]  # (steps, N, 2)

    # Who was absent at the last moment has no state to move on from.
    return jnp.where(people.present[None, :count, None], position, scene.observed[-1][None])


def _without_reaction(scenario: Scenario, state: State, settled: Array, rate: float) -> Pedestrians:
    """People whose desired velocity lacks the share ``settled`` of their acceleration, by ``MOST_SETTLED`` at most.

    Args:
        rate: 1/s, control steps.
    """
    people, forces = state.pedestrians, scenario.forces
    as_observed = replace(people, desired_velocity=people.velocity)
    if forces.get(Cohesion) is not None:  # the observed velocity is one's own, and not the companions' mean
        scenario = replace(scenario, forces=forces.tree_replace({"cohesion.alignment": None}))
    moved = scenario.move(scenario, replace(state, pedestrians=as_observed))
    acceleration = (moved.velocity - people.velocity) * rate

    correction = settled * forces.walking.relaxation_time * acceleration
    size = length(correction[:, 0], correction[:, 1])
    most = MOST_SETTLED * length(people.velocity[:, 0], people.velocity[:, 1])
    share = jnp.where(size > most, most / jnp.where(size > most, size, 1.0), 1.0)[:, None]
    return replace(people, desired_velocity=people.desired_velocity - share * correction)


def _replay(
    people: Pedestrians, places: Array, there: Array, index: Array, share: Array, time_step: float
) -> Pedestrians:
    """People with the last of them at their recorded positions, a fraction of a step after the time of that index."""
    before, after = places[index], places[index + 1]
    present = there[index] & there[index + 1]
    velocity = jnp.where(present[:, None], after - before, 0.0) / time_step
    position = before + velocity * (share * time_step)
    speed = length(velocity[:, 0], velocity[:, 1])
    own = pedestrians_at(position, velocity, preferred_speed=speed, present=present)
    number = people.position.shape[0] - present.shape[0]
    drawn = people.traits, people.noise, people.reaction
    traits, noise, reaction = jax.tree.map(lambda leaf: leaf[number:], drawn)
    own = replace(own, traits=traits, noise=noise, reaction=reaction)
    return jax.tree.map(lambda all_of_them, last: jnp.concatenate([all_of_them[:number], last]), people, own)


def _world(
    move: Callable,
    forces: Forces,
    people: Pedestrians,
    companions: Array,
    grid: ObstacleGrid | None,
    time_step: float,
    substeps: int,
) -> tuple[Scenario, State]:
    """A scenario and a state with all that pedestrian models read, and nothing else."""
    robot = None
    if move is not social_forces.move:  # others expect obstacles and a robot
        grid = _no_obstacles() if grid is None else grid
        still = jnp.zeros((), float)
        robot = Robot(jnp.full(2, FAR, float), jnp.asarray([1.0, 0.0], float), still, still, None)
    scenario = _blank(
        Scenario,
        environment=_blank(Environment, obstacle_grid=grid),
        behavior=_blank(Behavior, companions=companions),
        forces=forces,
        robot=_blank(RobotModel, radius=0.0),
        move=move,
        time_step=time_step,
        substeps=substeps,
        people=people.position.shape[0],
    )
    return scenario, _blank(State, pedestrians=people, robot=robot)


def _blank(kind: type[T], **known: Any) -> T:
    """A value of a data type that has only some of its fields."""
    return kind(**{**dict.fromkeys(field.name for field in dataclasses.fields(kind)), **known})  # pyright: ignore


def _no_obstacles() -> ObstacleGrid:
    """A grid that holds no obstacle."""
    rows = jnp.zeros((1, 1, 1, 6), float).at[..., :2].set(FAR).at[..., 4].set(1.0)
    return ObstacleGrid(rows, jnp.zeros(2, float), jnp.asarray(1.0, float))
