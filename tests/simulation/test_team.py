"""Several robots in a scenario (sean_jax.team)."""

import csv
import json
import signal
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import evaluation, make, make_team, metrics, reset, rollout, sensors, social_forces, step, team
from sean_jax.adapters.multi_agent import TeamEnv
from sean_jax.cli import command_line
from sean_jax.config import RunConfig, validate
from sean_jax.core.data_types import Robot, Scenario, State
from sean_jax.people.orca import orca
from sean_jax.people.pedestrian_models import pedestrians_at
from sean_jax.policies import POLICIES
from sean_jax.robots import ROBOTS
from sean_jax.robots.teammates import with_bodies
from sean_jax.simulation import making
from sean_jax.simulation.episode_runner import Callbacks, Runner
from sean_jax.simulation.scenario import snapshot
from sean_jax.simulation.scenario_stack import Stack
from support import programs
from support.replays import played
from support.runs import at_second_batch

OPTIONS = dict(behavior="random", people=6, time_limit=12.0)
CASES = 24


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    """Without metrics, which are compiled slowly; a team has its own two."""
    return make("lab", metrics="none", **OPTIONS)


def of(scenario: Scenario, number: int) -> Stack[Scenario]:
    return team.of_scenarios(Stack(scenario, {}, number))


@pytest.fixture(scope="module")
def members(scenario: Scenario) -> Stack[Scenario]:
    return of(scenario, 3)


@pytest.fixture(scope="module")
def begun(scenario: Scenario) -> State:
    """The first states of the plain scenario."""
    return jax.jit(jax.vmap(partial(reset, scenario)))(jax.random.split(jax.random.key(1), CASES))


@pytest.fixture(scope="module")
def plain_step(scenario: Scenario) -> Callable:
    return jax.jit(jax.vmap(partial(step, scenario)))


@pytest.fixture(scope="module")
def team_step(members: Stack[Scenario]) -> Callable:
    """The program of all steps of three robots here."""
    return jax.jit(jax.vmap(partial(team.step, members)))


@pytest.fixture(scope="module")
def teams(members: Stack[Scenario]) -> Callable:
    """Plain states, with three robots at places (CASES, 3, 2) with angles (CASES, 3) -> states of teams."""

    def measured(member: Scenario, state: State) -> State:
        return replace(state, metrics={name: metric.init(snapshot(member, state)) for name, metric in member.metrics})

    def one(state: State, place: jax.Array, angle: jax.Array) -> State:
        robot, heading = members.member.robot, jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1)
        placed = jax.vmap(robot.place, (None, 0, 0))(robot, place, heading)
        states = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (3, *leaf.shape)), state)
        return members.over_members(measured)(team.meet(replace(states, robot=placed)))

    return jax.jit(jax.vmap(one))


def without_people(state: State) -> State:
    return replace(state, pedestrians=replace(state.pedestrians, present=jnp.zeros((CASES, 6), bool)))


def close(one, other, tolerance: float) -> None:
    for (path, a), b in zip(jax.tree.leaves_with_path(one), jax.tree.leaves(other), strict=True):
        if jnp.issubdtype(a.dtype, jax.dtypes.prng_key):
            a, b = jax.random.key_data(a), jax.random.key_data(b)
        name = jax.tree_util.keystr(path)
        np.testing.assert_allclose(np.asarray(a, float), np.asarray(b, float), atol=tolerance, rtol=1e-5, err_msg=name)


def alone(states: State) -> State:
    """The states without what only a team has."""
    own = {name: value for name, value in states.metrics.items() if name not in metrics.OF_TEAMS}
    return replace(states, others=None, goals_of_others=None, metrics=own)


def both(before: State, after: State, action) -> tuple:
    return before, after, action


@pytest.mark.night
def test_a_robot_far_from_the_others_is_as_the_plain_scenario(scenario, begun, plain_step, teams, team_step) -> None:
    """Robot, people, situations and task, in random drives; the other robots stand 1 km away."""
    random, state = np.random.default_rng(0), begun
    far = jnp.asarray([[1000.0, 1000.0], [1000.0, 1010.0]])
    arranged = jax.jit(lambda state: jnp.concatenate([state.robot.position[:, None], jnp.tile(far, (CASES, 1, 1))], 1))
    angle = jnp.arctan2(*state.robot.heading.T[::-1])
    states = teams(state, arranged(state), jnp.tile(angle[:, None], (1, 3)))
    first = jax.jit(lambda states: alone(jax.tree.map(lambda leaf: leaf[:, 0], states)))
    close(first(states), state, 1e-6)
    begin = np.asarray(state.robot.position)
    for _ in range(12):
        actions = random.uniform([0.0, -1.0], [1.0, 1.0], (CASES, 3, 2)).astype(np.float32)
        state, states = plain_step(state, actions[:, 0]), team_step(states, actions)
        close(first(states), state, 1e-4)
    assert np.linalg.norm(np.asarray(state.robot.position) - begin, axis=-1).max() > 0.2


@pytest.mark.slow
def test_robots_in_another_order_have_the_same_steps(begun, teams, team_step) -> None:
    """Near each other and near a person, some of them in contact."""
    random, order = np.random.default_rng(1), np.array([2, 0, 1])
    near = np.asarray(begun.pedestrians.position)[:, :1] + random.uniform(-0.6, 0.6, (CASES, 3, 2))
    angle = random.uniform(-np.pi, np.pi, (CASES, 3))
    states, turned = (teams(begun, jnp.asarray(near[:, k]), jnp.asarray(angle[:, k])) for k in (np.arange(3), order))
    for _ in range(4):
        actions = random.uniform([0.0, -1.0], [1.0, 1.0], (CASES, 3, 2)).astype(np.float32)
        states, turned = team_step(states, actions), team_step(turned, actions[:, order])
    for name in ("robot", "situations", "metrics", "pedestrians"):
        one, other = getattr(states, name), getattr(turned, name)
        close(jax.tree.map(lambda leaf: np.asarray(leaf)[:, order], one), other, 1e-4)
    gap = np.linalg.norm(states.others.position - states.robot.position[:, :, None], axis=-1)
    assert (gap < 0.33).any() and (gap > 0.5).any()
    for k, rest in enumerate(([1, 2], [0, 2], [0, 1])):
        np.testing.assert_array_equal(states.others.position[:, k], states.robot.position[:, rest])
        np.testing.assert_array_equal(states.goals_of_others[:, k], states.task.goal[:, rest])


def test_two_robots_stop_each_other(scenario, begun, teams, team_step) -> None:
    """They face each other at 0.5 m, aside by up to a radius, with nobody near; a third one is elsewhere."""
    radius, random = float(scenario.robot.radius), np.random.default_rng(2)
    aside = random.uniform(-radius, radius, CASES)
    half, zero = np.full(CASES, radius + 0.25), np.zeros(CASES)
    place = np.stack([np.stack([-half, -aside / 2], -1), np.stack([half, aside / 2], -1), np.full((CASES, 2), 1e3)], 1)
    states = teams(without_people(begun), jnp.asarray(place), jnp.asarray(np.stack([zero, zero + np.pi, zero], 1)))
    ahead, gaps = jnp.tile(jnp.array([1.0, 0.0]), (CASES, 3, 1)), []
    for _ in range(40):
        states = team_step(states, ahead)
        gaps.append(np.linalg.norm(states.robot.position[:, 0] - states.robot.position[:, 1], axis=-1) - 2 * radius)
    assert np.min(gaps) > -0.02 and np.min(gaps, 0).max() < 0.05
    counts = np.asarray(states.metrics["collision_with_robot"])[:, :, 0]
    assert (counts[:, :2] >= 1).all() and (counts[:, 0] == counts[:, 1]).all() and not counts[:, 2].any()


@pytest.mark.night
def test_a_team_of_one_is_the_plain_scenario() -> None:
    """Its reset, and each step from a state of the plain scenario, with all metrics."""
    scenario = make("lab", **OPTIONS)
    one = of(scenario, 1)
    keys = jax.random.split(jax.random.key(1), 3)
    first = jax.jit(jax.vmap(partial(team.reset, one)))(keys)
    _, (before, after, action) = jax.jit(jax.vmap(lambda key: rollout(scenario, POLICIES["orca"], key, 60, both)))(keys)
    close(alone(jax.tree.map(lambda leaf: leaf[:, 0], first)), jax.tree.map(lambda leaf: leaf[:, 0], before), 1e-6)

    def stepped(before: State, action: jax.Array, like: State) -> State:
        states = jax.tree.map(lambda leaf: leaf[None], before)
        more = {name: like.metrics[name] for name in metrics.OF_TEAMS}
        states = team.meet(replace(states, metrics=states.metrics | more))
        return jax.tree.map(lambda leaf: leaf[0], team.step(one, states, action[None]))

    each = jax.jit(jax.vmap(jax.vmap(stepped, (0, 0, None))))
    ended = np.asarray(before.completed | before.timed_out)
    result = alone(each(before, action, first))
    here = jax.tree.map(lambda leaf: leaf[~ended], (result, after))
    assert (~ended).sum() > 100
    close(*here, 5e-6)


def test_people_react_to_each_robot_as_to_one_alone() -> None:
    """The float64 loop of Helbing & Molnar (1995) with the package's factor of moving robots."""
    terms = social_forces.preset("helbing1995")
    forces = social_forces.build([terms.walking, terms.repulsion, terms.contact, terms.robot_repulsion])
    random = np.random.default_rng(0)
    cases, number = 300, 4
    place, robots = random.uniform(-1.5, 1.5, (cases, 2)), random.uniform(-2, 2, (cases, number, 2))
    velocity, desired = random.normal(0, 0.8, (cases, 2)), random.normal(0, 1.0, (cases, 2))
    angle, speed = random.uniform(-np.pi, np.pi, (cases, number)), random.uniform(-0.1, 1.5, (cases, number))
    speed[np.abs(np.abs(speed) - 0.1) < 1e-3] = 0.0
    radius, extra = np.array([0.16, 0.25, 0.3, 0.45]), random.uniform(0.0, 0.6, cases)
    heading = np.stack([np.cos(angle), np.sin(angle)], -1)

    def one(place, velocity, desired, extra, robots, heading, speed):
        people = pedestrians_at(place[None], velocity[None], desired_velocity=desired[None], preferred_speed=1.3)
        people = replace(people, robot_distance=extra[None])
        group = Robot(robots, heading, speed, jnp.zeros_like(speed), ())
        return social_forces.integrate(forces, people, None, None, group, 0.05, jnp.asarray(radius, float)).velocity[0]

    arguments = (jnp.asarray(part, float) for part in (place, velocity, desired, extra, robots, heading, speed))
    result = jax.jit(jax.vmap(one))(*arguments)
    a, b = float(terms.repulsion.strength), float(terms.repulsion.range)
    cosine, weight = float(terms.repulsion.sight_cosine), float(terms.repulsion.back_weight)
    expected = np.zeros((cases, 2))
    for i in range(cases):
        force = (desired[i] - velocity[i]) / float(terms.walking.relaxation_time)
        look = desired[i] / np.linalg.norm(desired[i])
        for k in range(number):
            d = place[i] - robots[i, k]
            e = d - speed[i, k] * heading[i, k] * float(terms.repulsion.anticipation)
            dn, en = np.linalg.norm(d), np.linalg.norm(e)
            half = 0.5 * np.sqrt(max((dn + en) ** 2 - np.sum((d - e) ** 2), 0.0))
            push = a * np.exp(-half / b) * (dn + en) / (4.0 * half) * (d / dn + e / en)
            seen = look @ -push >= cosine * np.linalg.norm(push)
            push = push * (1.0 if seen else weight)
            if abs(speed[i, k]) > 0.1:
                push = push * np.exp(extra[i] / b)
            overlap = max(0.2 + radius[k] - dn, 0.0)
            force = force + push + float(terms.contact.stiffness) * overlap * d / dn
        new = velocity[i] + 0.05 * force
        top = 1.3 * float(terms.walking.speed_ratio)
        expected[i] = new * min(1.0, top / np.linalg.norm(new))
    np.testing.assert_allclose(result, expected, atol=2e-4)


@pytest.mark.night
def test_starts_are_apart_and_tasks_differ(scenario: Scenario, begun: State) -> None:
    """The first robot begins as alone."""
    four = of(scenario, 4)
    states = jax.jit(jax.vmap(partial(team.reset, four)))(jax.random.split(jax.random.key(1), CASES))
    start = np.asarray(states.task.start)
    gap = np.linalg.norm(start[:, :, None] - start[:, None], axis=-1) + 1e3 * np.eye(4)
    assert gap.min() > 2.0 * float(scenario.robot.radius) + 0.29
    goal = np.asarray(states.task.goal)
    assert (np.linalg.norm(goal[:, 0] - goal[:, 1], axis=-1) > 0.1).mean() > 0.9
    np.testing.assert_array_equal(states.others.position[:, 1, 1:], states.robot.position[:, 2:])
    close(alone(jax.tree.map(lambda leaf: leaf[:, 0], states)), begun, 1e-6)


def facing(scenario: Scenario, members: Stack[Scenario], gap: float, offset: float = 0.0) -> State:
    """Two robots that face each other on free floor, with that gap between their bodies, and nobody else near."""
    states = team.reset(members, jax.random.key(0))
    people = replace(states.pedestrians, present=jnp.zeros_like(states.pedestrians.present))
    radii = np.asarray(members.over_members(lambda member: member.robot.radius)())
    middle, away = jnp.asarray(FREE, float), float(radii.sum()) + gap
    place = middle[None] + jnp.array([[-0.5 * away, -offset], [0.5 * away, offset]])
    heading = jnp.array([[1.0, 0.0], [-1.0, 0.0]])
    robot = jax.vmap(scenario.robot.place, (None, 0, 0))(scenario.robot, place, heading)
    return team.meet(replace(states, robot=robot, pedestrians=people))


FREE = (0.0, 0.0)


@pytest.mark.night
def test_robots_of_different_size_stop_each_other() -> None:
    members = make_team("lab", robots="kuri,jackal", **OPTIONS)
    scenario = members.member
    states = facing(scenario, members, 0.5)
    ahead = jnp.array([[1.0, 0.0], [1.0, 0.0]])

    def one(states: State, _: None) -> tuple[State, tuple]:
        after = team.step(members, states, ahead)
        return after, (after.robot.position, after.robot.speed)

    states, (position, speed) = jax.jit(lambda states: jax.lax.scan(one, states, length=60))(states)
    radii = np.asarray(members.over_members(lambda member: member.robot.radius)())
    gap = np.linalg.norm(position[:, 0] - position[:, 1], axis=-1) - radii.sum()
    assert gap.min() > -0.02 and gap[-1] < 0.05
    assert np.abs(speed[-10:].sum(1)).max() < 2.0
    counts = np.asarray(team.results(members, states)["collision_with_robot"])[:, 0]
    assert (counts >= 1).all() and counts[0] == counts[1]


def test_people_attend_to_the_nearest_robot() -> None:
    """With the term Reactions they move as with the nearest of three alone; each robot pushes cautious people."""
    reactions = social_forces.Reactions()
    forces = social_forces.build([social_forces.preset("calibrated").walking, reactions])
    random, cases, kind = np.random.default_rng(3), 200, social_forces.Kind
    places, angles = random.uniform(-3.0, 3.0, (cases, 3, 2)), random.uniform(-np.pi, np.pi, (cases, 3))
    kinds = random.integers(len(kind), size=cases)

    def one(place: jax.Array, angle: jax.Array, kind: jax.Array) -> jax.Array:
        people = pedestrians_at(jnp.zeros((1, 2)), jnp.array([[0.6, 0.0]]), preferred_speed=jnp.array([1.3]))
        reaction = reactions.draw(jax.random.key(0), 1)
        people = replace(people, reaction=replace(reaction, kind=kind[None], attention=jnp.ones(1)))

        # Cautious people who want to go nowhere are only pushed: they walk round the nearest robot alone.
        stands = kind == social_forces.Kind.CAUTIOUS
        people = replace(people, desired_velocity=jnp.where(stands, 0.0, people.desired_velocity))
        robots = Robot(place, jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1), jnp.zeros(3), jnp.zeros(3), ())

        def after(robot: Robot | None, radius: jax.Array) -> jax.Array:
            return social_forces.integrate(forces, people, None, None, robot, 0.02, radius).velocity[0]

        radii = jnp.full(3, 0.2)
        each = jax.vmap(after)(robots, radii)
        return jnp.concatenate([after(robots, radii)[None], after(None, radii[0])[None], each])

    result = np.asarray(jax.jit(jax.vmap(one))(jnp.asarray(places), jnp.asarray(angles), jnp.asarray(kinds)))
    nearest = result[np.arange(cases), 2 + (places**2).sum(-1).argmin(1)]
    cautious = kinds == kind.CAUTIOUS
    np.testing.assert_allclose(result[~cautious, 0], nearest[~cautious], atol=1e-6)
    added = result[:, 1] + (result[:, 2:] - result[:, 1:2]).sum(1) - nearest  # by the other two
    pushed = cautious & (np.linalg.norm(added, axis=-1) > 0.01)
    assert pushed.sum() > 10 and (((result[:, 0] - nearest) * added).sum(-1) > 0.0)[pushed].all()


def test_people_of_the_model_orca_avoid_all_robots(scenario: Scenario, begun: State) -> None:
    """A person comes no nearer than their radii to any of three robots that keep their velocities for a second."""
    random, radius = np.random.default_rng(4), 0.3
    people, others = np.asarray(begun.pedestrians.position), np.zeros((CASES, 3, 2))
    angle = random.uniform(-np.pi, np.pi, (CASES, 3))
    others = people[:, :1] + random.uniform(0.9, 1.6, (CASES, 3, 1)) * np.stack([np.cos(angle), np.sin(angle)], -1)
    present = np.arange(6)[None] == np.zeros((CASES, 1))
    wide = replace(scenario, robot=replace(scenario.robot, radius=jnp.full(3, radius)))

    def one(state: State, place: jax.Array, angle: jax.Array, present: jax.Array) -> jax.Array:
        heading = jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1)
        robot = jax.vmap(scenario.robot.place, (None, 0, 0))(scenario.robot, place, heading)
        robot = replace(robot, speed=jnp.full(3, -0.4))  # towards the person
        desired = jnp.zeros((6, 2)).at[0].set(1.2 * heading[0])
        walkers = replace(state.pedestrians, present=present, velocity=desired, desired_velocity=desired)
        return orca(wide, replace(state, pedestrians=walkers, robot=robot)).velocity[0]

    arguments = jnp.asarray(others), jnp.asarray(angle), jnp.asarray(present)
    velocity = np.asarray(jax.jit(jax.vmap(one))(begun, *arguments))
    own = -0.4 * np.stack([np.cos(angle), np.sin(angle)], -1)
    seconds = np.linspace(0.0, 1.0, 21)[:, None, None, None]
    gap = np.linalg.norm(others - people[:, :1] + seconds * (own - velocity[:, None]), axis=-1) - 0.2 - radius
    straight = 1.2 * np.stack([np.cos(angle[:, :1]), np.sin(angle[:, :1])], -1)
    without = np.linalg.norm(others - people[:, :1] + seconds * (own - straight), axis=-1) - 0.2 - radius
    assert gap.min() > 0.05 and (without.min((0, 1)) < 0.0).all()


def test_rays_meet_the_solids_of_other_robots(scenario: Scenario, begun: State) -> None:
    """The lidar of a robot, against MuJoCo's own rays on the file of the other robot, at random poses of both."""
    import mujoco

    members, random, cases = of(scenario, 2), np.random.default_rng(2), 12
    first = jax.tree.map(lambda leaf: leaf[0], without_people(begun))
    places, angles = random.uniform(-0.9, 0.9, (cases, 2)), random.uniform(-np.pi, np.pi, (cases, 2))
    device = sensors.lidar(scenario, count=40, near=0.02)

    def scans(place: jax.Array, angle: jax.Array) -> tuple[jax.Array, jax.Array]:
        both = jnp.stack([jnp.zeros(2), place])
        heading = jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1)
        robot = jax.vmap(scenario.robot.place, (None, 0, 0))(scenario.robot, both, heading)
        states = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (2, *leaf.shape)), first)
        state = jax.tree.map(lambda leaf: leaf[0], team.meet(replace(states, robot=robot)))
        return sensors.scan(*with_bodies(members.at(0), state), device), sensors.scan(scenario, state, device)

    seen, empty = jax.jit(jax.vmap(scans))(jnp.asarray(places, float), jnp.asarray(angles, float))
    model = mujoco.MjModel.from_xml_path(str(ROBOTS["kuri"]))
    data, origin = mujoco.MjData(model), next(m for m in scenario.robot.mounts if m.name == "lidar").origin
    ends = device.first + device.span * np.arange(device.count) / device.count
    met = 0
    for i in range(cases):
        data.qpos[:3] = *places[i], angles[i, 1]
        mujoco.mj_forward(model, data)
        cosine, sine = np.cos(angles[i, 0]), np.sin(angles[i, 0])
        start = np.array([cosine * origin[0] - sine * origin[1], sine * origin[0] + cosine * origin[1], origin[2]])
        for k, end in enumerate(ends + angles[i, 0]):
            hit = np.zeros(1, np.int32)
            far = mujoco.mj_ray(model, data, start, np.array([np.cos(end), np.sin(end), 0.0]), None, 1, -1, hit)
            expected = min(far, float(empty[i, k])) if far > 0.02 else float(empty[i, k])
            met += 0.02 < far < float(empty[i, k])
            assert abs(float(seen[i, k]) - expected) < 2e-3, (i, k)
    assert met > 30


@pytest.mark.night
def test_gradients_are_finite_and_a_step_is_traced_once(scenario: Scenario) -> None:
    """By the commands of two robots that drive into each other, one of which starts on a person."""
    members = of(scenario, 2)
    states = facing(scenario, members, 0.05)
    place = states.robot.position[:, 0]
    people = replace(states.pedestrians, position=states.pedestrians.position.at[:, 0].set(place))
    states = replace(states, pedestrians=people)

    @programs.jit_once
    def slope(actions: jax.Array, states: State) -> jax.Array:
        def loss(actions: jax.Array) -> jax.Array:
            after, _ = jax.lax.scan(lambda state, action: (team.step(members, state, action), None), states, actions)
            return (after.robot.position * jnp.array([[1.0, 2.0], [3.0, 4.0]])).sum() + after.pedestrians.position.sum()

        return jax.grad(loss)(actions)

    first = slope(jnp.ones((3, 2, 2)), states)
    second = slope(0.5 * jnp.ones((3, 2, 2)), states)
    assert np.isfinite(first).all() and np.isfinite(second).all() and np.abs(first).max() > 0


@pytest.mark.parametrize(
    "words, message",
    [
        ("run --robots kuri,kurri", "did you mean 'kuri'"),
        ("run --robots kuri,kuri --robot jackal", "robots: a robot is given as well"),
        ("run --robots kuri,kuri --policy orca,orca,orca", "policy: 3 policies for 2 robots"),
        ("run --robots kuri,hsr", "robots of one program need the same drive"),
        ("run --robots kuri,kuri --live", "live: is for one robot"),
        ("run --robots kuri,kuri --dynamics mjx", "dynamics: MJX moves one robot"),
        ("run --robots kuri,kuri --behavior handcrafted", "task: 'handcrafted' with behavior 'handcrafted'"),
        ("run --robots kuri,kuri --environment worlds:rooms:3", "environment: worlds:rooms:3 is several floors"),
        ("collect --robots kuri,kuri --out x", "Unrecognized options: --robots"),
    ],
)
def test_a_team_that_cannot_be_is_refused_in_one_sentence(words, message, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    try:
        code = command_line.main(words.split())
    except SystemExit as end:  # of the parser
        code = end.code
    told = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert code == 2 and message in told, told
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_run_of_a_team_is_resumed_and_replayed(monkeypatch, tmp_path, capsys) -> None:
    """The second of two batches is interrupted; the replay shows what the report does; a bag is refused."""
    monkeypatch.chdir(tmp_path)
    scenario = "--environment lab --behavior random --people 2 --time-limit 1 --metrics none --robots kuri,jackal"
    words = ["run", *scenario.split(), "--policy", "go_to_goal,orca", "--episodes", "2", "--batch", "1", "--quiet"]
    made = list[Runner]()

    def once(*arguments, **named) -> Runner:
        """All runs here have one program."""
        if not made:
            made.append(Runner(*arguments, **named))
            made[0].compile(Callbacks())
            monkeypatch.setattr(made[0], "compile", lambda callbacks: None)
        return made[0]

    with monkeypatch.context() as patched:
        patched.setattr(evaluation, "Runner", once)
        assert command_line.main([*words, "--out", "whole"]) == 0
        with monkeypatch.context() as disturbed:
            at_second_batch(disturbed, lambda _: signal.raise_signal(signal.SIGTERM))
            assert command_line.main([*words, "--out", "made"]) == 143
        assert "the 1 finished episodes are in" in capsys.readouterr().err
        assert command_line.main([*words, "--out", "made"]) == 0
    assert not Path("made/unfinished").exists()
    for name in ("episodes.csv", "episode.gif"):
        assert Path("made", name).read_bytes() == Path("whole", name).read_bytes()
    rows = list(csv.DictReader(Path("made/episodes.csv").open()))
    assert [(row["episode"], row["robot"]) for row in rows] == [
        (episode, robot) for episode in "01" for robot in ("kuri_0", "jackal_1")
    ]
    summary = json.loads(Path("made/summary.json").read_text())
    assert summary["episodes"] == 2 and summary["robots"] == ["kuri_0", "jackal_1"]
    report = Path("made/report.html").read_text()
    assert "Episode 0 kuri 0 · random ab nav" in report and "Episode 0 jackal 1 · random ab nav" in report
    assert command_line.main(["replay", "made", "--episodes", "1", "0", "--quiet"]) == 0
    ((shown,), (first, *_)) = (played(Path("made", name)) for name in ("replay.html", "report.html"))
    assert [each["title"] for each in shown["episodes"]] == [f"episode {k} kuri_0 · random ab nav" for k in (1, 0)]
    one, other = shown["episodes"][1], first["episodes"][0]
    assert one["outcome"] == other["outcome"] == "not completed in 1.0 s" and shown["robot"] == first["robot"]
    assert {"robot x", "other x", "other goal x", "person x"} < one["columns"].keys()
    for name, values in one["columns"].items():
        np.testing.assert_allclose(values, other["columns"][name], atol=0.02, err_msg=name)
    assert command_line.main(["export", "bag", "made", "--out", "bags", "--quiet"]) == 2
    assert "made: has a team of robots; a bag is of one robot" in capsys.readouterr().err


def test_a_run_builds_robots_of_different_kinds() -> None:
    config = validate(RunConfig, {"environment": "lab", "behavior": "random", "people": 2, "robots": "kuri,jackal"})
    (members,) = making.build(making.plan_scenario(config, config.team))
    assert members.names == ("kuri_0", "jackal_1")
    radii = members.over_members(lambda member: member.robot.radius)()
    assert float(radii[0]) != float(radii[1])


def test_actions_of_omnidirectional_robots_have_three_numbers() -> None:
    members = make_team("lab", robots="hsr,hsr", behavior="random", people=2)
    env = TeamEnv(members)
    assert env.action_space.shape == (3,) and env.rows({"hsr_1": [0.0, 1.0, 0.0]}).shape == (2, 3)


@pytest.mark.night
def test_omnidirectional_robots_of_a_team_move_aside() -> None:
    env = TeamEnv(make_team("lab", robots="hsr,hsr", behavior="random", people=2))
    result = jax.jit(lambda state, actions: env.step(state, actions)[1])
    command = result(env.reset(jax.random.key(0)), env.rows({"hsr_1": [0.0, 1.0, 0.0]})).info["command"]
    assert float(command[1, 1]) > 0.0 and not command[0].any()
