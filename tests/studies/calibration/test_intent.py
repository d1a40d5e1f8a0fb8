"""The constants of people's intent from recorded people."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax.config import CalibrateConfig
from sean_jax.core.errors import InputError
from sean_jax.people.intent import Intent
from sean_jax.studies import calibration
from sean_jax.studies.calibration import intent as fitting
from sean_jax.studies.calibration.fitting import from_free
from sean_jax.studies.calibration.intent import IntentJudge, RecordedScene
from sean_jax.studies.calibration.search import Search
from sean_jax.studies.scenes import model
from sean_jax.studies.validation.streets import Street
from support.files import write


def street(people: int, moments: int) -> RecordedScene:
    """People who keep .6 of the difference to the usual speed and turn in 1.5 s; a loop in numpy moves them.

    The logarithm of their speed wanders by .2 in 5 s, and their routes bend by .1 rad.
    """
    draw = np.random.default_rng(0)
    first_speed, angle = draw.uniform(0.8, 1.8, people), draw.uniform(-1.0, 1.0, people)
    wander, bend = np.zeros(people), draw.normal(0.0, 0.1, people)
    goal = np.stack([np.full(people, 15.0), np.zeros(people)], 1)
    speed = np.median(first_speed) + 0.6 * (first_speed - np.median(first_speed))
    direction = np.exp(1j * angle)
    velocity, place, position = first_speed * direction, np.zeros(people, complex), []
    for step in range(4 * moments):
        if step % 4 == 0:
            position.append(place)
        way = 15.0 - place
        to_goal = way / np.abs(way) * np.exp(1j * bend * np.minimum(np.abs(way) / 2.0, 1.0))
        direction = direction + 0.1 / 1.5 * (to_goal - direction)
        direction = direction / np.abs(direction)
        fresh = 0.2 * np.sqrt(1.0 - np.exp(-0.2 / 5.0)) * draw.normal(size=people)
        wander = np.exp(-0.1 / 5.0) * wander + fresh
        place = place + 0.1 * speed * np.exp(wander) * direction
    there = np.ones((moments, people), bool)
    vectors = lambda numbers: np.stack([np.real(numbers), np.imag(numbers)], -1)  # noqa: E731
    made = Street(vectors(np.array(position)), there, goal, first_speed, np.full(people, -1), vectors(velocity))
    return RecordedScene([made], [there])


def test_the_energy_score_is_as_defined():
    draws = np.random.default_rng(0).normal(size=(4, 3, 2, 2))
    place = np.random.default_rng(1).normal(size=(3, 2, 2))
    far = np.mean([np.linalg.norm(one - place, axis=-1) for one in draws], axis=0)
    pairs = [np.linalg.norm(draws[i] - draws[j], axis=-1) for i in range(4) for j in range(4) if i != j]
    score, distance = fitting.energy_score(jnp.asarray(draws), jnp.asarray(place))
    np.testing.assert_allclose(distance, far, rtol=1e-5)
    np.testing.assert_allclose(score, far - 0.5 * np.mean(pairs, axis=0), rtol=1e-4, atol=1e-6)
    alone, _ = fitting.energy_score(jnp.asarray(draws[:1]), jnp.asarray(place))
    np.testing.assert_allclose(alone, np.linalg.norm(draws[0] - place, axis=-1), rtol=1e-5)


def test_people_who_walk_alone_begin_when_they_come():
    """One comes two moments later, and is compared from then on."""
    place = np.cumsum(np.full((6, 2, 2), [0.5, 0.0]), 0)
    there = np.ones((6, 2), bool)
    there[:2, 1] = False
    goal = place[-1] + [5.0, 0.0]  # who is near the goal has arrived
    scene = RecordedScene([Street(place, there, goal, np.full(2, 1.25), np.full(2, -1))], [there])
    (walks,) = fitting.walks_of({"made": scene})
    np.testing.assert_allclose(walks.start[:, 0], [0.5, 1.5])
    np.testing.assert_array_equal(np.asarray(walks.counted).sum(0), [6, 4])
    straight = Intent(speed_share=1.0, turn_time=0.0).average()
    walked = np.asarray(fitting.walk_alone(straight, walks, jax.random.key(0)))
    counted = np.asarray(walks.counted)
    np.testing.assert_allclose(walked[counted], np.asarray(walks.place)[counted], atol=1e-4)


@pytest.mark.slow
def test_known_constants_are_found_again():
    judge = IntentJudge({"made": street(600, 16)}, draws=4)
    search = Search(judge.rows, judge.start, [None], 10, 0)
    for _ in range(25):
        search.generation()
    found = dict(zip(fitting.FIELDS, np.asarray(from_free(judge.names, jnp.asarray(search.best()[0, 0]))), strict=True))
    assert found["speed_share"] == pytest.approx(0.6, abs=0.15)
    assert found["turn_time"] == pytest.approx(1.5, abs=0.3)
    assert found["route_deviation"] == pytest.approx(0.1, abs=0.03)

    # Of a wider process that takes longer nobody can tell within 6 s; what it is then can be told.
    after = found["speed_deviation"] * np.sqrt(1.0 - np.exp(-2.0 * 6.0 / found["speed_time"]))
    assert after == pytest.approx(0.2 * np.sqrt(1.0 - np.exp(-2.0 * 6.0 / 5.0)), abs=0.05)


@pytest.mark.slow
def test_the_crowd_has_a_gradient_and_is_as_alone_without_forces():
    """Of four people for 2.4 s: with ``constant_velocity`` they walk as alone, by other draws."""
    scenes = {"made": street(4, 7)}
    keys = jax.random.split(jax.random.key(0), 2)
    habits = jax.tree.map(jnp.asarray, Intent(0.6, 0.0, 20.0, 1.5, 0.0))
    (alone,) = fitting.walks_of(scenes)
    (free,) = fitting.crowds_of(scenes, model("constant_velocity"))
    by_step = fitting.losses_in_crowd(habits, free, keys, 1)
    np.testing.assert_allclose(by_step, fitting.losses_alone(habits, alone, keys, 1), rtol=0.1)

    (crowd,) = fitting.crowds_of(scenes, model())
    differ = jax.tree.map(jnp.asarray, Intent(0.6, 0.2, 5.0, 1.5, 0.1))
    gradient = jax.grad(lambda intent: fitting.losses_in_crowd(intent, crowd, keys, 1).sum())(differ)
    values = np.array(jax.tree.leaves(gradient))
    assert np.isfinite(values).all() and (values != 0.0).all()


def test_intent_needs_recordings(tmp_path):
    with pytest.raises(InputError, match="grand_central"):
        calibration.run(CalibrateConfig(data=tmp_path, fit="intent", out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_command_fits_intent(tmp_path):
    """To two recordings, each left out once."""
    for name, speed in (("north", 0.5), ("south", 0.6)):
        lines = []
        for k in range(20):
            lines += [f"{10 * k},1,{speed * k},{0.01 * k * k},0,0", f"{10 * k},2,{12 - speed * k},3,0,0"]
        text = "frame,ped_id,x_m,y_m,vx_mps,vy_mps\n" + "\n".join(lines) + "\n"
        write(tmp_path / "eth_ucy" / f"{name}.csv", text)
    options = CalibrateConfig(
        data=tmp_path, fit="intent", generations=2, population=4, quick=True, out=tmp_path / "out"
    )
    results = json.loads((calibration.run(options) / "results.json").read_text())
    assert list(results["parameters"]) == ["before", "all", "north", "south"]
    assert set(results["rows"]) == {"intent north", "intent south"}
    assert set(results["parameters"]["all"]) == set(fitting.NAMES)
    assert "intent.turn_time" in (tmp_path / "out" / "report.html").read_text()
