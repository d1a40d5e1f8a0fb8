"""The program that fits people's habits on the way to their goals."""

import numpy as np
import pytest

from sean_jax.studies.validation.streets import Street
from support.checkout import benchmark

intent = benchmark("intent")


def test_known_habits_are_found_again():
    """Of people who keep 0.6 of the difference to the usual speed, and turn to their goal in 1.5 s."""
    draw = np.random.default_rng(0)
    people, moments = 30, 20
    first_speed, angle = draw.uniform(0.8, 1.8, people), draw.uniform(-1.0, 1.0, people)
    direction = np.stack([np.cos(angle), np.sin(angle)], 1)
    goal = np.stack([np.full(people, 15.0), np.zeros(people)], 1)
    speed = np.median(first_speed) + 0.6 * (first_speed - np.median(first_speed))
    velocity, place, position = first_speed[:, None] * direction, np.zeros((people, 2)), []
    for step in range(4 * moments):
        if step % 4 == 0:
            position.append(place)
        way = goal - place
        direction = direction + 0.1 / 1.5 * (way / np.hypot(*way.T)[:, None] - direction)
        direction = direction / np.hypot(*direction.T)[:, None]
        place = place + 0.1 * speed[:, None] * direction
    there = np.ones((moments, people), bool)
    street = Street(np.stack(position), there, goal, first_speed, np.full(people, -1), velocity)
    scenes = {"made": [(street, there)]}
    share, turn_time = intent.fit(scenes, {"made": intent.error(scenes["made"], 1.0, 0.0)})
    assert share == pytest.approx(0.6, abs=0.05) and turn_time == pytest.approx(1.5, abs=0.1)
    assert intent.error(scenes["made"], share, turn_time) < 0.05
