"""Moments of a robot among three people, 0.1 s apart, and what all metrics measure along them."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax.core.data_types import Snapshot
from support import metric_values
from support.people import people_at, snapshot_of

PEOPLE, SITUATIONS, STEP = 3, 5, 0.1
ROBOT_RADIUS, PERSON_RADIUS = 0.16, 0.2

init = jax.jit(metric_values.init)
update = jax.jit(metric_values.update)
compute = jax.jit(metric_values.compute)


def at(tick=0, position=(0, 0), velocity=(0, 0), people=(), situations=(), goal=(0, 0), geodesic=1.0) -> Snapshot:
    """A snapshot with up to three people; the others are absent, and stand where the robot is."""
    occurring = np.zeros(SITUATIONS, bool)
    occurring[list(situations)] = True
    places, there = [*people, *[position] * (PEOPLE - len(people))], np.arange(PEOPLE) < len(people)
    persons = people_at(places, heading=np.ones((PEOPLE, 2)), present=there)
    return jax.device_put(
        snapshot_of(persons, position, velocity=velocity, goal=goal, geodesic=geodesic, situations=occurring, tick=tick)
    )


def measure(snapshots: list[Snapshot]) -> dict[str, np.ndarray]:
    """The metrics over a sequence of snapshots, by the package."""
    values = init(snapshots[0])
    for before, after in zip(snapshots[:-1], snapshots[1:], strict=True):
        values = update(values, before, after)
    return {name: np.asarray(value) for name, value in compute(values).items()}


def along(*corners, speed=0.5):
    """Positions every 0.1 s on the straight lines between corners."""
    found = [np.array(corners[0], float)]
    for one, other in zip(corners[:-1], corners[1:], strict=True):
        steps = round(np.linalg.norm(np.subtract(other, one)) / speed / STEP)
        found += [one + np.subtract(other, one) * k / steps for k in range(1, steps + 1)]
    return found


def wander(seed: int, steps: int = 153):
    random = np.random.default_rng(seed)
    speed = random.uniform(0, 1.5, steps)[:, None] * (random.uniform(size=steps) > 0.3)[:, None]
    angle = np.cumsum(random.normal(0, 0.4, steps))
    velocity = speed * np.stack([np.cos(angle), np.sin(angle)], -1)
    velocity[np.arange(steps) % 40 > 24] = 0.0
    position = np.cumsum(velocity * STEP, 0)
    people = (
        position[:, None] + np.cumsum(random.normal(0, 0.25, (steps, PEOPLE, 2)), 0) + random.normal(0, 0.5, (3, 2))
    )
    present = random.uniform(size=(steps, PEOPLE)) < 0.95
    occurring = random.uniform(size=(steps, SITUATIONS)) < 0.4
    return [
        dict(
            position=position[k].astype(np.float32).astype(float),
            velocity=velocity[k].astype(np.float32).astype(float),
            people=people[k].astype(np.float32).astype(float),
            present=present[k],
            situations=occurring[k],
            goal=np.array([1.0, 2.0]),
            geodesic=3.0,
        )
        for k in range(steps)
    ]


def as_snapshot(tick: int, now: dict) -> Snapshot:
    one = at(tick, now["position"], now["velocity"], now["people"], np.flatnonzero(now["situations"]), now["goal"], 3.0)
    return replace(one, people=replace(one.people, present=jnp.asarray(now["present"])))
