"""Scenes: plans against exact distances, gates against plane geometry, people who are conserved, worlds that repeat."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import InputError, preset
from sean_jax.core.geometry import signed_distances_on_host
from sean_jax.social_forces import walls as laws
from sean_jax.studies.scenes import (
    Gate,
    Scene,
    box,
    corridor,
    environment,
    join,
    model,
    room,
    scenario_of,
    simulate,
    simulation,
    source,
    spread,
    stage,
    walkers,
    wall,
)
from sean_jax.studies.scenes.walkers import ROOM, aim_at, passed
from support.tracks import moved

rng = np.random.default_rng(3)
DOOR = Gate((6.0, 3.0), (6.0, 1.5))
SIDE = [term for term in preset("helbing2000") if type(term).__name__ in ("Walking", "Repulsion")]  # no preferred side
AROUND = 12.0  # m, period


def straight(scenario, state):
    """Everybody as desired, through everything: nothing to compile."""
    people = state.pedestrians
    velocity = jnp.where(people.present[:, None], people.desired_velocity, 0.0)
    return moved(people, velocity, scenario.time_step)


def halls(seed: int, number: int = 12) -> Scene:
    """A room with a door, people inside, more who come through a gate in the other wall."""
    entry = Gate((0.0, 3.0), (0.0, 1.5))
    inside = walkers(spread((1.0, 0.5), (4.0, 4.0), number, seed), route=(1,), seed=seed)
    coming = source(entry, 6, 0.8, route=(1,), seed=seed)
    plan = room((0.0, 0.0), (6.0, 4.5), [(entry.left, entry.right), (DOOR.left, DOOR.right)])
    return Scene(walls=plan, gates=(entry, DOOR), walkers=join(inside, coming), seconds=40.0)


@pytest.mark.parametrize("seed", range(3))
def test_a_plan_has_the_distances_of_its_boxes(seed):
    draw = np.random.default_rng(seed)
    parts = [room((0, 0), (10, 8), [((10, 3), (10, 4)), ((2, 8), (3, 8))]), wall((1, 1), (4, 5), (8, 5))]
    plan = np.concatenate([*parts, box((5, 1), (6, 2)), corridor(5.0, 2.0)])
    made = environment(plan)
    points = draw.uniform((-1, -1), (11, 9), (400, 2))
    px, py = jnp.asarray(points.T, float)
    found = np.asarray(laws.distances(px, py, made.obstacle_grid)[0]).min(1)
    along = points[:, None] - plan[None, :, :2]
    cosine, sine = np.cos(plan[:, 4]), np.sin(plan[:, 4])
    x, y = along[..., 0] * cosine + along[..., 1] * sine, along[..., 1] * cosine - along[..., 0] * sine
    out = np.maximum(np.abs(np.stack([x, y], -1)) - plan[:, 2:4], 0.0)
    exact = np.hypot(*np.moveaxis(out, -1, 0)).min(1)
    near = exact < 2.0
    np.testing.assert_allclose(np.maximum(found, 0.0)[near], exact[near], atol=1e-4)
    np.testing.assert_allclose(np.maximum(signed_distances_on_host(made, points)[0], 0.0)[near], exact[near], atol=1e-4)


def test_a_room_is_open_at_its_doors_alone():
    made = environment(room((0.0, 0.0), (4.0, 3.0), [((4.0, 1.0), (4.0, 2.0))]))
    height = np.linspace(0.05, 2.95, 30)
    inside = np.asarray(signed_distances_on_host(made, np.stack([np.full(30, 4.1), height], 1))[0]) < 0.0
    np.testing.assert_array_equal(inside, (height < 1.0) | (height > 2.0))
    with pytest.raises(InputError, match="doors: .*no side"):
        room((0.0, 0.0), (4.0, 3.0), [((2.0, 1.0), (2.0, 2.0))])


@pytest.mark.parametrize("door", [((1.0, 0.0), (2.0, 1.0)), ((0.0, 1.0), (4.0, 2.0)), ((4.0, 0.0), (2.0, 3.0))])
def test_a_diagonal_door_lies_on_no_side(door):
    with pytest.raises(InputError, match="doors: .*no side"):
        room((0.0, 0.0), (4.0, 3.0), [door])


@pytest.mark.parametrize("x", [0.0, 4.0])
def test_a_door_within_a_wider_one_changes_no_wall(x):
    wide, narrow = ((x, 0.5), (x, 2.5)), ((x, 2.0), (x, 1.0))
    across = ((0.5, 3.0), (3.0, 3.0)), ((2.0, 3.0), (1.0, 3.0))
    plan = room((0.0, 0.0), (4.0, 3.0), [narrow, wide, *across])
    np.testing.assert_array_equal(plan, room((0.0, 0.0), (4.0, 3.0), [wide, across[0]]))


def test_a_gate_is_passed_in_its_direction_and_aimed_at_between_its_ends():
    number = 300
    middle, turn = rng.uniform(-5, 5, (number, 2)), rng.uniform(0, 2 * np.pi, number)
    half = rng.uniform(0.2, 2.0, number)
    ahead, left = np.stack([np.cos(turn), np.sin(turn)], -1), np.stack([-np.sin(turn), np.cos(turn)], -1)
    gate = np.stack([middle + half[:, None] * left, middle - half[:, None] * left], 1)
    out, side = rng.uniform(-3.0, 3.0, number), rng.uniform(-4.0, 4.0, number)
    place = middle + out[:, None] * ahead + side[:, None] * left
    arrays = jnp.asarray(gate, float), jnp.asarray(place, float)
    np.testing.assert_array_equal(passed(*arrays), (out > 0.0) & (out < 2.0) & (np.abs(side) < half + 0.3))
    aim = np.asarray(aim_at(*arrays)) - middle
    inner = np.maximum(half - 0.3, 0.0)
    np.testing.assert_allclose((aim * ahead).sum(-1), 0.3, atol=1e-5)
    np.testing.assert_allclose((aim * left).sum(-1), np.clip(side, -inner, inner), atol=1e-5)


def test_people_enter_when_there_is_room_and_vanish_once():
    scene = halls(0)
    tracks = simulate(scene)[0]
    present = np.asarray(tracks.present)
    assert present[0].sum() == 13 and not present[-1].any()
    changes = np.diff(present.astype(int), axis=0, prepend=0)
    assert ((changes == 1).sum(0) == 1).all() and ((changes == -1).sum(0) == 1).all()  # in once and out once
    came = present[1:] & ~present[:-1]
    for moment, person in np.argwhere(came):
        others = present[moment] & (np.arange(present.shape[1]) != person)
        gap = np.linalg.norm(tracks.position[moment][others] - scene.walkers.start[person], axis=-1)
        assert gap.min(initial=np.inf) >= ROOM - 1e-4
        assert moment * tracks.time_step >= scene.walkers.entry_time[person] - 1e-6
        moved = tracks.position[moment + 1][person] - scene.walkers.start[person]
        assert np.linalg.norm(moved) > 0.07 * scene.walkers.preferred_speed[person]  # they enter at their velocity
    out = present[:-1] & ~present[1:]
    where = np.asarray(tracks.position)[1:][out]
    assert (where[:, 0] > 6.0).all() and (where[:, 0] < 8.0).all()


def test_scenes_side_by_side_are_those_that_run_alone():
    scenes = [halls(1), halls(2), halls(3)]
    for together, scene in zip(simulate(scenes), scenes, strict=True):
        alone = simulate(scene)[0]
        steps = min(len(alone.frame), len(together.frame), 80)  # chaos makes rounding seen later
        np.testing.assert_allclose(alone.position[:steps], together.position[:steps], atol=2e-3)
        np.testing.assert_array_equal(alone.present[:steps], together.present[:steps])


def test_a_crowd_shrinks_without_a_trace(monkeypatch):
    start = spread((0.0, 0.0), (40.0, 6.0), 300, 1)
    gate = Gate((40.0, 6.0), (40.0, 0.0))
    scene = Scene(walls=np.zeros((0, 5)), gates=(gate,), walkers=walkers(start, route=(0,)), seconds=60.0)
    small = simulate(scene, model(straight))[0]
    sizes = []
    span = simulation._alone
    monkeypatch.setattr(simulation, "SMALLER", ())
    counted = lambda scenario, state: sizes.append(scenario.people) or span(scenario, state)  # noqa: E731
    monkeypatch.setattr(simulation, "_alone", counted)
    whole = simulate(scene, model(straight))[0]
    assert set(sizes) == {512}
    np.testing.assert_array_equal(small.present, whole.present)
    np.testing.assert_allclose(small.position, whole.position, atol=1e-5)
    assert not small.present[-1].any()


def ring(start: np.ndarray, people: str | list) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 2) and velocities (N, 2) one step later of people who stand at these places."""
    scene = Scene(walls=np.zeros((0, 5)), walkers=walkers(start, speed=1.3), period=AROUND)
    scenario = scenario_of(scene, model(people))
    after = STEP(scenario, stage(scenario, scene)).pedestrians
    return np.asarray(after.position)[: len(start)], np.asarray(after.velocity)[: len(start)]


STEP = jax.jit(simulation.advance)


def test_forces_act_across_the_seam_as_in_a_loop_over_pairs():
    start = np.concatenate([rng.uniform(0.0, 0.8, (5, 2)), rng.uniform((AROUND - 0.8, 0.0), (AROUND, 0.8), (5, 2))])
    law, walking = model(SIDE).forces.repulsion, model(SIDE).forces.walking
    place, velocity = start.astype(np.float64), np.zeros((10, 2))
    step = 0.1 / scenario_of(Scene(np.zeros((0, 5)), walkers(start)), model(SIDE)).substeps
    for _ in range(round(0.1 / step)):
        gap = place[:, None] - place[None]
        gap[..., 0] -= AROUND * np.round(gap[..., 0] / AROUND)
        far = np.linalg.norm(gap, axis=-1) + np.eye(10)
        size = float(law.strength) * np.exp((float(law.reach) - far) / float(law.range)) * (1 - np.eye(10))
        force = (size[..., None] * gap / far[..., None]).sum(1)
        velocity = velocity + step * (force - velocity / float(walking.relaxation_time))
        speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
        velocity *= np.minimum(1.0, float(walking.speed_ratio) * 1.3 / np.maximum(speed, 1e-9))
        place = place + step * velocity
    found, moving = ring(start, SIDE)
    np.testing.assert_allclose(moving, velocity, atol=2e-4)
    around = found - place
    np.testing.assert_allclose(around - [AROUND, 0.0] * np.round(around / AROUND), 0.0, atol=1e-4)
    assert np.abs(velocity).max() > 0.1
    assert ((found[:, 0] >= 0.0) & (found[:, 0] < AROUND)).all()


def test_a_ring_has_no_place_of_its_own_and_keeps_momentum():
    start = rng.uniform((0.0, 0.0), (AROUND, 1.5), (16, 2))
    for people in (SIDE, None):
        place, velocity = ring(start, people)
        for shift in (2.0, 5.5, 10.9):
            moved, same = ring(np.stack([(start[:, 0] + shift) % AROUND, start[:, 1]], 1), people)
            np.testing.assert_allclose(same, velocity, atol=1e-3)
            around = moved[:, 0] - place[:, 0] - shift
            np.testing.assert_allclose(around - AROUND * np.round(around / AROUND), 0.0, atol=1e-3)
    spaced = spread((0.0, 0.0), (AROUND, 1.5), 16, 2, apart=0.6)  # so that nobody is as fast as can be
    np.testing.assert_allclose(ring(spaced, SIDE)[1].sum(0), 0.0, atol=2e-4)


def test_people_in_a_ring_stay_there_for_good():
    start = spread((0.0, 0.3), (AROUND, 1.5), 16, 4)
    gates = Gate((1e4, 1.8), (1e4, 0.0)), Gate((-1e4, 0.0), (-1e4, 1.8))
    people = join(walkers(start[:8], route=(0,), speed=1.5), walkers(start[8:], route=(1,), speed=1.5))
    plan = corridor(AROUND, 1.8, AROUND / 2)
    tracks = simulate(Scene(walls=plan, gates=gates, walkers=people, seconds=25.0, period=AROUND))[0]
    assert np.asarray(tracks.present).all() and len(tracks.frame) == 251
    x = np.asarray(tracks.position)[..., 0]
    assert (x >= 0.0).all() and (x <= AROUND).all()
    step = np.diff(x, axis=0)
    step -= AROUND * np.round(step / AROUND)
    assert step.sum(0)[:8].min() > 0.5 * AROUND and step.sum(0)[8:].max() < -0.5 * AROUND


def test_who_can_choose_takes_the_exit_that_promises_more():
    gates = Gate((0.0, 0.0), (0.0, 1.0)), Gate((12.0, 1.0), (12.0, 0.0))
    start = spread((2.0, -2.0), (4.0, 3.0), 48, 1)
    scene = Scene(walls=np.zeros((0, 5)), gates=gates, walkers=walkers(start, route=(0,)), exits=(0, 1), seconds=40.0)
    chosen = simulate(scene, model(straight))[0].position[-1, :, 0] > 6.0
    assert 0 < chosen.sum() < 48
    assert start[chosen, 0].mean() > start[~chosen, 0].mean()
    few = Scene(walls=np.zeros((0, 5)), gates=gates, walkers=walkers(start[:2], route=(0,)), exits=(0, 1), seconds=40.0)
    assert not (simulate(few, model(straight))[0].position[-1, :, 0] > 6.0).any()


def test_the_robot_of_a_scene_keeps_its_velocity():
    scene = Scene(np.zeros((0, 5)), walkers(np.array([[50.0, 0.0]])), robot=((1.0, 2.0), (0.3, -0.4)))
    scenario = scenario_of(scene, model(straight))
    state = stage(scenario, scene)
    for _ in range(3):
        state = STEP(scenario, state)
    np.testing.assert_allclose(state.robot.position, scene.robot_path(np.array([0.3]))[0], atol=1e-5)
    assert float(state.robot.speed) == pytest.approx(0.5)


def test_a_walking_group_is_a_chain_at_the_speed_of_its_slowest_member():
    group = walkers(np.zeros((4, 2)), speed=np.array([1.2, 0.7, 1.5, 1.0]), together=True)
    people = join(walkers(np.zeros((2, 2)), speed=1.0), group)
    np.testing.assert_allclose(people.preferred_speed, [1.0, 1.0, 0.7, 0.7, 0.7, 0.7])
    np.testing.assert_array_equal(people.companion, [[-1, -1], [-1, -1], [-1, 3], [2, 4], [3, 5], [4, -1]])
    scene = Scene(np.zeros((0, 5)), people)
    scenario = scenario_of(scene, model(straight))
    np.testing.assert_array_equal(stage(scenario, scene).pedestrians.walking_group[:6], [-1, -1, 2, 2, 2, 2])


def test_mistakes_are_told():
    with pytest.raises(InputError, match="route: names gate 3"):
        scenario_of(Scene(np.zeros((0, 5)), walkers(np.zeros((1, 2)), route=(3,))))
    with pytest.raises(InputError, match="model: 'nobody'"):
        model("nobody")
    with pytest.raises(InputError, match="model: 3 is no name"):
        model(3)
    with pytest.raises(InputError, match="walls: "):
        environment(np.concatenate([box((k, 0.0), (k + 0.5, 1.0)) for k in range(200)]))
