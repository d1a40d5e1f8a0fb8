"""The constants of people's intent, fitted to recorded people who walk to where they left.

The loss of a scene is the energy score of several draws of everybody (Gneiting & Raftery, JASA 102, 359 (2007)) and the
error of average people, both in shares of the error of constant velocity. People walk *alone*, or in the *crowd*: the
ordinary simulator.
"""

import itertools
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int

from sean_jax.core import random_streams
from sean_jax.core.data_types import Array, Scenario
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import length
from sean_jax.people.intent import Intent, advance, draw, lasting_speed, wanted_velocity
from sean_jax.studies.calibration.fitting import from_free
from sean_jax.studies.scenes import Model, scenario_of, simulation
from sean_jax.studies.scenes.scene import first_state
from sean_jax.studies.scenes.walkers import AWAY
from sean_jax.studies.validation import recorded
from sean_jax.studies.validation.streets import STRIDE, TIME_STEP, Street, streets, walked_again

FIELDS = tuple(Intent.__dataclass_fields__)
NAMES = tuple(f"intent.{field}" for field in FIELDS)
DRAWS = 8
QUICK_WINDOWS = 2  # of each recording
STEP = 0.2  # s, of people who walk alone
ARRIVED = 0.3  # m
LENGTHS = 16, 24, 36, 56, 151  # moments; people who are seen as long walk together


class RecordedScene(NamedTuple):
    """A recording, in windows; in each (T, N) the people and moments that count."""

    windows: list[Street]
    counted: list[Bool[np.ndarray, "T N"]]


def recorded_scenes(folder: str | Path, quick: bool = False) -> dict[str, RecordedScene]:
    """The clips in grand_central and the recordings in eth_ucy of a folder, with the speed of everybody's first 2 s.

    Raises:
        InputError: there are none.
    """
    scenes = {}
    for path in sorted((Path(folder) / "grand_central").glob("*.csv")):
        street = recorded.clip(path)
        scenes[path.stem] = RecordedScene([street], [street.present])
    for path in sorted((Path(folder) / "eth_ucy").glob("*.csv")):
        windows = [recorded.with_first_speeds(street) for street in streets(path)]
        windows = windows[: QUICK_WINDOWS if quick else None]
        scenes[path.stem] = RecordedScene(windows, [recorded.counted(street) for street in windows])
    if not scenes:
        raise InputError(
            f"data: {folder} has no clips in grand_central and no recordings in eth_ucy; give a folder with either."
        )
    return scenes


def energy_score(
    draws: Float[Array, "K T N 2"], places: Float[Array, "T N 2"]
) -> tuple[Float[Array, "T N"], Float[Array, "T N"]]:
    """The energy score [m] of K draws of everybody's place, and the mean distance of a draw; lower is better.

    The score is unbiased: it leaves out the distance of a draw from itself. Of one draw it is the distance.
    """
    number = draws.shape[0]
    error = draws - places[None]
    distance = length(error[..., 0], error[..., 1]).mean(0)
    if number == 1:
        return distance, distance

    # Each pair of draws is met twice as one is rolled past the other.
    apart = jnp.zeros_like(distance)
    for shift in range(1, number):
        gap = draws - jnp.roll(draws, shift, 0)
        apart = apart + length(gap[..., 0], gap[..., 1]).mean(0) / (number - 1)
    return distance - 0.5 * apart, distance


# ------------------------------------------------------------------ alone


@struct.dataclass
class Walks:
    """N people who walk alone, each from their first moment on."""

    start: Float[Array, "N 2"]  # m
    velocity: Float[Array, "N 2"]  # m/s, at the first moment
    speed: Float[Array, "N"]  # m/s, of the first 2 s
    usual: Float[Array, "N"]  # m/s, median of the scene
    goal: Float[Array, "N 2"]  # m
    place: Float[Array, "T N 2"]  # m, where they really were
    counted: Bool[Array, "T N"]
    scene: Int[Array, "N"]


def walks_of(scenes: dict[str, RecordedScene]) -> list[Walks]:
    """Everybody in the scenes, in groups of people who are seen about equally long."""
    parts = []
    for number, (windows, moments) in enumerate(scenes.values()):
        usual = recorded.usual_speed(windows)
        for street, counted in zip(windows, moments, strict=True):
            parts.append(_walks_in(street, counted, usual, number))
    everybody = {field: [getattr(part, field) for part in parts] for field in Walks.__dataclass_fields__}
    everybody = {field: np.concatenate(rows) for field, rows in everybody.items()}

    # The last moment that counts decides how long a person has to walk.
    last = LENGTHS[-1] - everybody["counted"][:, ::-1].argmax(1)
    last = np.where(everybody["counted"].any(1), last, 0)
    groups = []
    for shortest, longest in itertools.pairwise((0, *LENGTHS)):
        chosen = (last > shortest) & (last <= longest)
        if chosen.any():
            people = {field: rows[chosen] for field, rows in everybody.items()}
            people["place"] = np.moveaxis(people["place"][:, :longest], 0, 1)
            people["counted"] = people["counted"][:, :longest].T
            groups.append(Walks(**jax.tree.map(_on_device, people)))
    return groups


def _walks_in(street: Street, counted: np.ndarray, usual: float, scene: int) -> Walks:
    """The people of a window, who come first; moments after the window do not count."""
    moments, people = street.present.shape
    person = np.arange(people)
    first = street.present.argmax(0)
    moment = first[:, None] + np.arange(LENGTHS[-1])  # (N, T)
    inside = moment < moments
    moment = np.minimum(moment, moments - 1)

    start = street.position[first, person]
    velocity = street.velocity
    if velocity is None:
        velocity = (street.position[first + 1, person] - start) / TIME_STEP
    counts = counted[moment, person[:, None]] & inside
    place = street.position[moment, person[:, None]]
    return Walks(
        start=start,  # pyright: ignore[reportArgumentType]
        velocity=velocity,  # pyright: ignore[reportArgumentType]
        speed=street.speed,  # pyright: ignore[reportArgumentType]
        usual=np.full(people, usual),  # pyright: ignore[reportArgumentType]
        goal=street.goal,  # pyright: ignore[reportArgumentType]
        place=np.where(counts[..., None], place, 0.0),  # pyright: ignore[reportArgumentType]
        counted=counts,  # pyright: ignore[reportArgumentType]
        scene=np.full(people, scene, np.int32),  # pyright: ignore[reportArgumentType]
    )


def _on_device(rows: np.ndarray) -> Array:
    return jnp.asarray(rows, float) if rows.dtype.kind == "f" else jnp.asarray(rows)


def walk_alone(intent: Intent, walks: Walks, key: Array) -> Float[Array, "T N 2"]:
    """Where people are at each moment [m] who have nobody around; who has arrived stays."""
    speed = lasting_speed(intent, walks.speed, walks.usual)
    latents_key, noise_key = jax.random.split(key)

    def step(carry: tuple, index: Array) -> tuple[tuple, Array]:
        place, wanted, latents, arrived = carry
        latents = advance(intent, latents, jax.random.fold_in(noise_key, index), STEP)
        wanted = wanted_velocity(intent, latents, wanted, walks.goal - place, speed, STEP)
        after = jnp.where(arrived[:, None], place, place + STEP * wanted)

        # A step may be longer than the rest of the way.
        rest = walks.goal - after
        reach = jnp.maximum(STEP * length(wanted[:, 0], wanted[:, 1]), ARRIVED)
        arrived = arrived | (length(rest[:, 0], rest[:, 1]) < reach)
        return (after, wanted, latents, arrived), place

    latents = draw(intent, latents_key, walks.speed.shape[0])
    start = walks.start, walks.velocity, latents, jnp.zeros(walks.speed.shape, bool)
    steps = round(TIME_STEP / STEP)
    index = jnp.arange(steps * walks.place.shape[0], dtype=jnp.uint32)
    return jax.lax.scan(step, start, index)[1][::steps]


# ------------------------------------------------------------------ in the crowd


@struct.dataclass
class CrowdWindows:
    """B windows whose scenarios have equal shapes, and where their people really were."""

    scenarios: Scenario  # (B,)
    usual: Float[Array, "B"]  # m/s
    place: Float[Array, "B T N 2"]  # m
    counted: Bool[Array, "B T N"]
    scene: Int[Array, "B"]


def crowds_of(scenes: dict[str, RecordedScene], model: Model) -> list[CrowdWindows]:
    """The windows of all scenes, in groups of equal shapes, moved by a model."""
    rows: dict[Any, list[tuple]] = {}
    for number, (windows, moments) in enumerate(scenes.values()):
        usual = recorded.usual_speed(windows)
        for street, counted in zip(windows, moments, strict=True):
            scenario = scenario_of(walked_again(street, Intent()), model)
            kind = jax.tree.structure(scenario), len(counted)
            rows.setdefault(kind, []).append((scenario, usual, street.position, counted, number))

    crowds = []
    for (_, moments), members in rows.items():
        scenarios, usual, position, counted, scene = zip(*members, strict=True)
        people = scenarios[0].people
        place = np.zeros((len(members), moments, people, 2))
        counts = np.zeros((len(members), moments, people), bool)
        for k, chosen in enumerate(counted):
            number = chosen.shape[1]
            counts[k, :, :number] = chosen
            place[k, :, :number] = np.where(chosen[..., None], position[k], 0.0)
        arrays = np.array(usual), place, counts, np.array(scene, np.int32)
        crowds.append(CrowdWindows(simulation.stacked(scenarios), *map(_on_device, arrays)))
    return crowds


def with_intent(scenario: Scenario, intent: Intent, usual: Float[Array, ""]) -> Scenario:
    """The scenario of people who prefer the speed of their first 2 s, with an intent."""
    plan = scenario.behavior.data
    speed = lasting_speed(intent, plan.walkers.preferred_speed, usual)
    plan = replace(plan, walkers=replace(plan.walkers, preferred_speed=speed), intent=intent)
    return replace(scenario, behavior=replace(scenario.behavior, data=plan))


def walk_in_crowd(scenario: Scenario, key: Array, moments: int) -> Float[Array, "T N 2"]:
    """Where people are at each moment [m], by the ordinary simulator; who has left stays."""

    def step(state: Any, _: None) -> tuple[Any, None]:
        return simulation.advance(scenario, state), None

    def moment(state: Any, _: None) -> tuple[Any, Array]:
        after, _ = jax.lax.scan(step, state, length=STRIDE)
        return after, state.pedestrians.position

    # Gradients need the states of moments alone: those between are computed again.
    state = first_state(scenario, key, jnp.full(2, AWAY, float), jnp.zeros(2, float))
    return jax.lax.scan(jax.checkpoint(moment), state, length=moments)[1]


# ------------------------------------------------------------------ the loss


def losses_alone(intent: Intent, walks: Walks, keys: Array, scenes: int) -> Float[Array, "E"]:
    """Sums [m] over the people and moments of each of E scenes: half the energy score, half the average's error."""
    drawn = jax.vmap(partial(walk_alone, intent, walks))(keys)  # (K, T, N, 2)
    average = walk_alone(intent.average(), walks, keys[0])
    both = _both(drawn, average, walks.place, walks.counted).sum(0)
    return jax.ops.segment_sum(both, walks.scene, scenes)


def losses_in_crowd(intent: Intent, crowd: CrowdWindows, keys: Array, scenes: int) -> Float[Array, "E"]:
    """As ``losses_alone``, of people who meet others."""

    def window(scenario: Scenario, usual: Array, place: Array, counted: Array) -> Array:
        moments = place.shape[0]
        drawn = jax.vmap(lambda key: walk_in_crowd(with_intent(scenario, intent, usual), key, moments))(keys)
        alike = replace(scenario, move=recorded.Average(scenario.move))
        average = walk_in_crowd(with_intent(alike, intent.average(), usual), keys[0], moments)
        return _both(drawn, average, place, counted).sum()

    both = jax.vmap(window)(crowd.scenarios, crowd.usual, crowd.place, crowd.counted)
    return jax.ops.segment_sum(both, crowd.scene, scenes)


def _both(drawn: Array, average: Array, place: Array, counted: Array) -> Float[Array, "T N"]:
    score, _ = energy_score(drawn, place)
    error = average - place
    distance = length(error[..., 0], error[..., 1])
    return jnp.where(counted, 0.5 * (score + distance), 0.0)


class IntentJudge:
    """The row of each recorded scene by constants of intent, ``NAMES``, as free parameters.

    Args:
        crowd: how others move; alone if None.
    """

    names = NAMES

    def __init__(self, scenes: dict[str, RecordedScene], crowd: Model | None = None, draws: int = DRAWS, seed: int = 0):
        self.scenes = tuple(scenes)
        self._keys = jax.random.split(random_streams.key("calibrate", seed), draws)
        walks = walks_of(scenes)
        self._parts: list[Walks] | list[CrowdWindows] = walks
        self._losses = losses_alone
        if crowd is not None:
            self._parts = crowds_of(scenes, crowd)
            self._losses = losses_in_crowd

        # Constant velocity goes straight to the goal at the first speed.
        straight = Intent(speed_share=1.0, turn_time=0.0).average()
        straight = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), straight)
        one = jax.jit(losses_alone, static_argnums=3)
        sums = [np.asarray(one(straight, part, self._keys[:1], len(self.scenes))) for part in walks]
        self.reference = np.sum(sums, axis=0)  # (E,) m, of all people and moments

    @property
    def start(self) -> Float[np.ndarray, "P"]:
        """The middle of the bounds."""
        return np.zeros(len(NAMES))

    def rows(self, free: Float[np.ndarray, "L P"]) -> dict[str, np.ndarray]:
        """The loss (L,) of each scene by the free parameters of L candidates."""
        values = jnp.asarray(free, float)
        sums = []
        for part in self._parts:
            sums.append(np.asarray(_candidates(self._losses, len(self.scenes), values, part, self._keys)))
        shares = np.sum(sums, axis=0) / self.reference  # (L, E)
        return {f"intent {name}": shares[:, k] for k, name in enumerate(self.scenes)}


@partial(jax.jit, static_argnums=(0, 1))
def _candidates(losses: Callable[..., Array], scenes: int, free: Array, part: Any, keys: Array) -> Float[Array, "L E"]:
    """The sums of L candidates, one after the other: together they would need much memory."""
    return jax.lax.map(lambda row: losses(intent_of(row), part, keys, scenes), free)


def intent_of(free: Float[Array, "P"]) -> Intent:
    """The intent of free parameters."""
    values = from_free(NAMES, free)
    return Intent(*(values[k] for k in range(len(NAMES))))
