"""Policies: each alone in a room, with a person in its way and among walkers; parts against independent oracles."""

import dataclasses
import functools
import inspect
import types
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import robots
from sean_jax.cli import command_line
from sean_jax.core.data_types import Groups, Policy
from sean_jax.evaluation.list_command import choices
from sean_jax.learning.policy import AGENTS
from sean_jax.people.constant_velocity import walk
from sean_jax.policies import POLICIES, cost_to_go, prediction, social_costmap
from sean_jax.policies.costmap import proxemic_cost
from sean_jax.policies.expert import plan_limits
from sean_jax.policies.known_people import known_people
from sean_jax.policies.sensing_expert import sensing_expert
from sean_jax.simulation import episodes
from sean_jax.world import navigation
from support import programs, scenes
from support.quick import quick

STEPS = 240
START, GOAL = (-2.5, 0.3), (2.5, 0.3)
CORNER = (-4.5, -3.7)  # where people stand who have no part in a scene
# One scene a row: (x, y, vx, vy) of people.
SCENES = [
    [],
    [(0.0, 0.3, 0.0, 0.0)],
    [(0.0, 0.35, 0.0, 0.0), (0.1, -1.0, 0.0, 0.0)],
    [(2.5, -2.0, -0.7, 0.5)],
    [(4.5, 0.3, -0.9, 0.0)],
    [(4.0, 0.8, -0.9, 0.0), (4.5, -0.4, -0.9, 0.0)],
    [(-0.5, -3.5, 0.0, 0.9)],
    [(0.5, 3.0, 0.0, -0.6), (-4.5, 0.2, 1.1, 0.0)],
]


def steadily(scenario, state):
    """People walk on at their desired velocity and mind nobody: all politeness is the robot's."""
    return walk(scenario, state.pedestrians, state.pedestrians.desired_velocity)


def undirected(scenario, state, key):
    """Nobody changes their mind."""
    return state


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """A room with one pillar, where people do as the scene says; and its scenes, stacked."""
    folder = scenes.room(tmp_path_factory.mktemp("room"), (-5, -4, 5, 4), [scenes.box((0, 3.5), (0.4, 0.4))], 6)
    made = sean_jax.make(
        folder, behavior="random", task="custom", start=START, goal=(*GOAL, 90.0), people=6, dynamics="twin"
    )
    scenario = dataclasses.replace(
        made,
        move=steadily,
        behavior=dataclasses.replace(made.behavior, direct=undirected),
        metrics=(),
        situations=made.situations[-1:],
    )
    begin = programs.reset(scenario, jax.random.key(0))
    return scenario, jax.tree.map(lambda *leaves: jnp.stack(leaves), *(staged(begin, scene) for scene in SCENES))


def staged(state, scene):
    """The state with the people of a scene, the others in a corner."""
    rows = np.array(scene + [(*CORNER, 0.0, 0.0)] * (6 - len(scene)), np.float32)
    people = dataclasses.replace(
        state.pedestrians,
        position=jnp.asarray(rows[:, :2]),
        velocity=jnp.asarray(rows[:, 2:]),
        desired_velocity=jnp.asarray(rows[:, 2:]),
        preferred_speed=jnp.full(6, 1.2, jnp.float32),
    )
    return dataclasses.replace(state, pedestrians=people)


@pytest.fixture(scope="module")
def simulated(room):
    """A function: name of a policy -> first states and the frames of all scenes; each is simulated once."""
    scenario, states = room

    @functools.cache
    def run(name):
        def one(state):
            state = episodes.init_policy(scenario, POLICIES[name], state)
            return state, episodes.simulate(scenario, POLICIES[name], state, STEPS)[1]

        return jax.jit(jax.vmap(one))(states)

    return run


@pytest.fixture(scope="module", params=quick(POLICIES, "go_to_goal"))
def driven(request, room, simulated):
    """The name of a policy, the scenario, first states, and their frames."""
    return request.param, room[0], *simulated(request.param)


def command_of(scenario, name):
    """A function: places of the robot and of people, state -> sum of the command, and the command (2,)."""
    policy = POLICIES[name]

    def command(places, state):
        here, people = places
        state = state.replace(
            robot=state.robot.replace(position=here), pedestrians=state.pedestrians.replace(position=people)
        )
        key = jax.random.fold_in(state.streams.policy, state.tick)
        if isinstance(policy, Policy):
            action = policy.apply(scenario, policy.params, state, key)[0]
        else:
            action = policy(scenario, state, key)
        return action.sum(), action

    return command


def gaps(frames):
    """(scenes, steps, people) m between the robot's centre and people's."""
    return np.linalg.norm(np.asarray(frames.position)[:, :, None] - np.asarray(frames.people), axis=-1)


@pytest.mark.night
def test_reaches_its_goal_and_stays(driven):
    name, _, _, frames = driven
    away = np.linalg.norm(np.asarray(frames.position) - GOAL, axis=-1)
    assert (away[0, -20:] < 0.4).all(), away[0, -1]
    assert np.abs(np.diff(np.asarray(frames.position)[0, -20:], axis=0)).max() < 0.01
    if name not in ("move_base", "social_costmap"):  # one sees nobody, the other may stand before people (move_base.md)
        assert (away[1:3, -1] < 0.6).all(), away[:, -1]


def test_touches_nobody_who_stands_in_its_way(driven):
    name, scenario, _, frames = driven
    if name == "move_base":
        pytest.skip("it does not see them")
    assert gaps(frames)[1:3].min() > scenario.robot.radius + float(scenario.forces.walking.radius) + 0.02


def test_commands_are_finite_and_within_the_limits(driven):
    _, scenario, _, frames = driven
    actions = np.asarray(frames.action)
    assert np.isfinite(actions).all()
    assert np.abs(actions[..., 0]).max() <= float(scenario.robot.max_speed) + 1e-5
    assert np.abs(actions[..., 1]).max() <= float(scenario.robot.max_turn_rate) + 1e-5


def test_one_by_one_equals_all_at_once_and_is_traced_once(driven):
    name, scenario, states, frames = driven
    command = programs.jit_once(command_of(scenario, name))
    for scene in range(len(SCENES)):
        state = jax.tree.map(lambda leaf: leaf[scene], states)  # noqa: B023
        _, action = command((state.robot.position, state.pedestrians.position), state)
        np.testing.assert_allclose(action, np.asarray(frames.action)[scene, 0], atol=2e-4)


@pytest.mark.slow
def test_the_expert_is_more_polite_than_go_to_goal(simulated):
    """People who mind nobody: it comes nearer than 0.45 m to none of them, and arrives as well."""
    close = {name: (gaps(simulated(name)[1]) < 0.45).any((1, 2)) for name in ("go_to_goal", "expert")}
    assert close["expert"].sum() == 0 < close["go_to_goal"].sum()
    away = np.linalg.norm(np.asarray(simulated("expert")[1].position)[:, -1] - GOAL, axis=-1)
    assert (away < 0.4).all()


@pytest.fixture(scope="module")
def sensing(room):
    """The command and memory of `sensing_expert`, compiled once; and a state with its memory, of a robot in the room.

    The robot is at (-2.5, 0.3) and looks along x; all people are in the corner behind it.
    """
    scenario, states = room
    state = jax.tree.map(lambda leaf: leaf[0], states)
    state = state.replace(robot=facing(state.robot, START, 0.0))
    apply = jax.jit(lambda state: sensing_expert.apply(scenario, sensing_expert.params, state, jax.random.key(5)))
    return apply, jax.jit(lambda state: episodes.init_policy(scenario, sensing_expert, state))(state)


def facing(robot, place, angle):
    """The robot elsewhere."""
    heading = jnp.asarray([np.cos(angle), np.sin(angle)], jnp.float32)
    return robot.replace(position=jnp.asarray(place, jnp.float32), heading=heading)


def same(one, other):
    return all(np.array_equal(a, b) for a, b in zip(*map(jax.tree.leaves, (one, other)), strict=True))


def test_only_who_is_in_sight_changes_what_it_does(sensing):
    """A person who comes near: behind it, beside it, behind a pillar, and in front of it."""
    apply, alone = sensing
    beside_pillar = alone.replace(robot=facing(alone.robot, (-2.0, 3.5), 0.0))
    angle = np.deg2rad(37.6)  # of the edge of the picture, from the camera, which is near the middle of the robot
    outside, inside = ((START[0] + 2 * np.cos(a), START[1] + 2 * np.sin(a)) for a in (angle + 0.25, angle - 0.25))
    for state, place, seen in [
        (alone, (-3.2, 0.3), False),
        (alone, (-2.5, 1.0), False),
        (alone, outside, False),
        (alone, inside, True),
        (alone, (-1.3, 0.3), True),
        (beside_pillar, (0.9, 3.5), False),
        (beside_pillar, (-0.8, 3.4), True),
    ]:
        command, memory = apply(staged(state, [(*place, -0.5, 0.0)]))
        nobody, _ = apply(state)
        assert np.array_equal(memory.people.known, [seen] + [False] * 5), place
        assert np.array_equal(command, nobody) != seen, place


def test_it_knows_no_more_than_the_picture(room, sensing):
    """Anywhere in the room: people out of sight may as well not be there, and nobody's wish is known."""
    (scenario, _), (apply, start), random = room, sensing, np.random.default_rng(2)
    eye = sean_jax.sensors.camera(scenario, "depth", width=64, height=48)
    look = jax.jit(lambda state: sean_jax.sensors.pixels_of_people(scenario, state, eye))
    hidden = 0
    for _ in range(12):
        people = [(*random.uniform([-3, -2], [3, 2]), *random.normal(0, 0.7, 2)) for _ in range(6)]
        state = staged(start, people)
        state = state.replace(robot=facing(state.robot, random.uniform([-3, -2], [3, 2]), random.uniform(0, 6.3)))
        in_sight = look(state) > 0
        fewer = state.pedestrians.replace(
            present=in_sight, desired_velocity=jnp.asarray(random.normal(0, 1, (6, 2)), jnp.float32)
        )
        assert same(apply(state)[0], apply(state.replace(pedestrians=fewer))[0])
        hidden += int((~in_sight).sum())
    assert 20 < hidden < 70


def test_who_leaves_the_picture_is_remembered_for_two_seconds(room, sensing):
    (scenario, _), (apply, start) = room, sensing
    know = jax.jit(functools.partial(known_people, scenario, sensing_expert.params))
    left, velocity = (-1.5, 0.3), np.array([-0.4, 0.9])
    known = know(staged(start, [(*left, *velocity)]), start.policy_state.people)
    nobody, _ = apply(start)
    for ticks in range(1, 30):
        state = start.replace(policy_state=start.policy_state._replace(people=known))
        known = know(start, known)
        assert bool(known.known[0]) == (ticks <= 20) and not known.known[1:].any()
        if ticks <= 20:
            np.testing.assert_allclose(known.position[0], left + 0.1 * ticks * velocity, atol=1e-5)
            np.testing.assert_allclose(known.velocity[0], velocity, atol=1e-6)
        if ticks in (1, 21):
            assert np.array_equal(apply(state)[0], nobody) == (ticks > 20)
    back = know(staged(start, [(*left, 0.0, 0.0)]), known)
    np.testing.assert_array_equal(back.position[0], np.asarray(left, np.float32))
    assert back.known[0] and back.unseen_ticks[0] == 0


def test_a_group_is_known_by_its_members(sensing):
    """An o-space ahead: of nobody, of somebody behind the robot, and of somebody in sight."""
    apply, start = sensing
    there = jnp.ones((1,), bool)
    group = Groups(
        center=jnp.asarray([[-1.2, 0.3]], jnp.float32), radius=jnp.ones(1), opening=jnp.zeros((1, 2)), present=there
    )

    def command(place, member):
        state = staged(start, [(*place, 0.0, 0.0)])
        of_group = jnp.full(6, -1, jnp.int32).at[0].set(member)
        return apply(state.replace(groups=group, pedestrians=state.pedestrians.replace(group=of_group)))[0]

    behind, ahead = (-3.5, 0.3), (0.5, 1.0)
    assert np.array_equal(command(behind, 0), command(behind, -1))
    assert not np.array_equal(command(ahead, 0), command(ahead, -1))


def test_people_of_unknown_aims_keep_their_velocity(room):
    people = jax.tree.map(lambda leaf: leaf[7], room[1]).pedestrians
    people = people.replace(present=jnp.arange(6) != 1)
    x, y, vx, vy = jax.jit(lambda people: prediction.predict_straight(people, 5, 0.2))(people)
    np.testing.assert_allclose(x[:, 0], np.full(5, 0.5), atol=1e-6)
    np.testing.assert_allclose(y[:, 0], 3.0 - 0.6 * 0.2 * np.arange(1, 6), atol=1e-6)
    np.testing.assert_allclose(vy[:, 0], np.full(5, -0.6), atol=1e-6)
    assert (np.asarray(x)[:, 1] == prediction.ABSENT_DISTANCE).all() and not np.asarray(vx)[:, 0].any()


def test_the_proxemic_layer_is_the_printed_formula():
    layers = social_costmap.params.global_costmap
    random = np.random.default_rng(0)
    d, v = random.uniform(-1.5, 1.5, (400, 2)), random.uniform(-1.5, 1.5, (400, 2))
    v[:40] = 0.0
    run = jax.jit(jax.vmap(proxemic_cost, in_axes=(None, 0, 0, 0, 0)))
    mine = np.asarray(run(layers, *(jnp.asarray(part, jnp.float32) for part in (*d.T, *v.T))))
    costly = 0
    for (dx, dy), (vx, vy), cost in zip(d, v, mine, strict=True):
        theta, angle, distance = np.arctan2(vy, vx), np.arctan2(dy, dx), np.hypot(dx, dy)
        off = (angle - theta + np.pi) % (2 * np.pi) - np.pi
        sx = 0.1 * (1 + 5 * np.hypot(vx, vy)) if abs(off) < np.pi / 2 else 0.1
        mx, my = distance * np.cos(off), distance * np.sin(off)
        exact = 77 * np.exp(-(mx**2 / (2 * sx) + my**2 / (2 * 0.1)))
        wanted = np.floor(exact) if exact >= 10 else 0.0
        if abs(exact - 10) > 1e-3 and abs(exact - np.round(exact)) > 1e-3:
            assert cost == wanted
            costly += cost > 0
    assert costly > 50
    at_rest = np.asarray(run(layers, *jnp.asarray([[0.64, 0.65], [0, 0], [0, 0], [0, 0]], jnp.float32)))
    np.testing.assert_array_equal(at_rest, [0, 0] if at_rest[0] == 0 else [10, 0])  # 0.64 m at rest (C = 0.1)


def test_rolls_are_where_the_twin_goes(room):
    """A planner's belief against the robot's own physics, from rest, over three seconds."""
    scenario, states = room
    state = jax.tree.map(lambda leaf: leaf[0], states)
    model = scenario.robot

    def physics(state, command):
        def one(state, _):
            robot = model.drive(scenario, state, command)
            return dataclasses.replace(state, robot=robot), robot.position

        return jax.lax.scan(one, state, length=30)[1][1::2]

    commands = jnp.asarray([[0.5, 0.0], [0.4, 1.0], [0.3, -2.0], [-0.3, 0.5]], jnp.float32)
    exact = np.asarray(jax.jit(jax.vmap(physics, in_axes=(None, 0)))(state, commands))
    zero = jnp.zeros((), jnp.float32)
    steps = jnp.broadcast_to(commands, (15, 4, 2))
    predict = jax.jit(lambda a, b: prediction.predict_robot(model, (zero, zero), (a, b), 0.2))
    x, y, *_ = predict(steps[..., 0], steps[..., 1])
    x, y = prediction.to_world(state.robot.position, state.robot.heading, x, y)
    assert np.hypot(np.asarray(x).T - exact[..., 0], np.asarray(y).T - exact[..., 1]).max() < 0.06


def test_the_way_that_is_left_is_that_of_the_tables(scenario):
    """Around robots anywhere in the warehouse, from places within 1.5 m of each: against the exact geodesic."""
    table, random = scenario.navigation, np.random.default_rng(3)
    here, goals = (random.choice(np.asarray(table.places), 24) for _ in range(2))
    places = (here[:, None] + random.uniform(-1.5, 1.5, (24, 24, 2))).astype(np.float32)

    def one(each):
        here, goal, place = each
        task = types.SimpleNamespace(goal=goal, paths_to_goal=navigation.build_paths_to_goal(table, goal))
        state: Any = types.SimpleNamespace(task=task)
        successors = cost_to_go.corner_successors(scenario, state)
        chosen = cost_to_go.build_cost_to_go(scenario, state, successors, *here[:, None])
        left = cost_to_go.distance_to_goal(scenario, state, chosen, *place.T)
        exact = jax.lax.map(lambda spot: navigation.geodesic(table, spot, goal, task.paths_to_goal), place)
        near = jax.vmap(lambda spot: navigation.segment_is_free(table.obstacles, here, spot, table.radius))(place)
        return left, exact, near

    given = jnp.asarray(here), jnp.asarray(goals), jnp.asarray(places)
    left, exact, near = (np.asarray(part) for part in jax.jit(lambda given: jax.lax.map(one, given))(given))
    there = near & np.isfinite(exact)
    assert there.sum() > 200
    error = np.where(np.isfinite(left), left - exact, 99.0)[there]
    assert error.min() > -0.01  # never shorter than it is
    assert np.quantile(error, 0.95) < 0.001  # by a bend that was not chosen it may be longer


def test_plans_keep_to_the_limits_of_every_robot():
    for name in robots.ROBOTS:
        model = robots.load(name, "twin")
        mocked: Any = types.SimpleNamespace(robot=model)
        ahead, back, turn = plan_limits(mocked)
        assert 0 < float(back) <= float(ahead) <= float(model.max_speed) and 0 < float(turn) <= model.max_turn_rate


def test_each_is_documented_and_on_the_list():
    lines = dict(choices())["policy"]
    assert set(lines) == {*POLICIES, *AGENTS}
    known = {"go_to_goal", "social_costmap", "orca", "expert", "sensing_expert", "move_base", "ppo", "dwa", "mppi"}
    assert known | {"social_force"} <= set(lines)
    assert all(line for line in lines.values())
    for policy in POLICIES.values():
        for function in (policy.init, policy.apply) if isinstance(policy, Policy) else (policy,):
            assert inspect.getdoc(function)


@pytest.mark.night
@pytest.mark.parametrize("name", ["expert", "sensing_expert"])
def test_sean_run_takes_one_that_remembers(name, tmp_path, capsys):
    command = ["run", "--environment", "lab", "--policy", name, "--people", "4", "--episodes", "2", "--time-limit", "5"]
    command += ["--dynamics", "twin", "--metrics", "path_length", "--out", str(tmp_path / "out")]
    assert command_line.main(command) == 0
    assert (tmp_path / "out" / "summary.json").is_file()
