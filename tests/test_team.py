"""Several robots in a scenario (sean_jax.team)."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import assembly, cli, make, make_team, metrics, rollout, sensors, social_forces, team
from sean_jax.adapters.multi_agent import TeamEnv
from sean_jax.base import Robot, Scenario, State
from sean_jax.config import RunConfig, validate
from sean_jax.others import with_bodies
from sean_jax.pedestrian_models import pedestrians_at
from sean_jax.policies import POLICIES
from sean_jax.robots import ROBOTS
from sean_jax.stack import Stack

OPTIONS = dict(behavior="random", people=6, time_limit=12.0)


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return make("lab", **OPTIONS)


def of(scenario: Scenario, number: int) -> Stack[Scenario]:
    return team.of_scenarios(Stack(scenario, {}, number))


def close(one, other, tolerance: float) -> None:
    for (path, a), b in zip(jax.tree.leaves_with_path(one), jax.tree.leaves(other), strict=True):
        if jnp.issubdtype(a.dtype, jax.dtypes.prng_key):
            a, b = jax.random.key_data(a), jax.random.key_data(b)
        name = jax.tree_util.keystr(path)
        np.testing.assert_allclose(np.asarray(a, float), np.asarray(b, float), atol=tolerance, rtol=1e-5, err_msg=name)


def alone(states: State) -> State:
    """The states without what only a team has."""
    own = {name: value for name, value in states.metrics.items() if name not in metrics.OF_TEAMS}
    return replace(states, others=None, metrics=own)


def both(before: State, after: State, action) -> tuple:
    return before, after, action


@pytest.fixture(scope="module")
def three(scenario: Scenario) -> tuple:
    """A team of three and the states (E, T, M, ...) of four episodes that ORCA drives, with their commands."""
    members = of(scenario, 3)
    episode = jax.jit(jax.vmap(lambda key: team.rollout(members, POLICIES["orca"], key, 40, both)[1]))
    return members, episode(jax.random.split(jax.random.key(3), 4))


def test_a_team_of_one_is_the_plain_scenario(scenario: Scenario) -> None:
    one = of(scenario, 1)
    keys = jax.random.split(jax.random.key(1), 3)
    first = jax.jit(jax.vmap(partial(team.reset, one)))(keys)
    _, (before, after, action) = jax.jit(jax.vmap(lambda key: rollout(scenario, POLICIES["orca"], key, 60, both)))(keys)
    close(alone(jax.tree.map(lambda leaf: leaf[:, 0], first)), jax.tree.map(lambda leaf: leaf[:, 0], before), 1e-6)

    def stepped(before: State, action: jax.Array, like: State) -> State:
        states = jax.tree.map(lambda leaf: leaf[None], before)
        more = {name: like.metrics[name] for name in metrics.OF_TEAMS}
        states = replace(states, others=like.others, metrics=states.metrics | more)
        return jax.tree.map(lambda leaf: leaf[0], team.step(one, states, action[None]))

    each = jax.jit(jax.vmap(jax.vmap(stepped, (0, 0, None))))
    ended = np.asarray(before.completed | before.timed_out)
    result = alone(each(before, action, first))
    here = jax.tree.map(lambda leaf: leaf[~ended], (result, after))
    assert (~ended).sum() > 100
    close(*here, 5e-6)


def test_robots_in_another_order_have_the_same_steps(three: tuple) -> None:
    members, (before, after, action) = three
    before, after, action = jax.tree.map(lambda leaf: leaf.reshape(160, *leaf.shape[2:]), (before, after, action))
    order = jnp.array([2, 0, 1])

    def stepped(states: State, actions: jax.Array) -> State:
        turned = team.meet(jax.tree.map(lambda leaf: leaf[order], states))
        return team.step(members, turned, actions[order])

    result = jax.jit(jax.vmap(stepped))(before, action)
    expected = jax.vmap(lambda states: team.meet(jax.tree.map(lambda leaf: leaf[order], states)))(after)
    close(result, expected, 2e-5)


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


def test_robots_far_apart_are_as_alone(scenario: Scenario, three: tuple) -> None:
    """The robot moves as in the plain scenario among the same people, with the same command, if no robot is near."""
    members, (before, after, action) = three
    before, after, action = jax.tree.map(lambda leaf: leaf.reshape(160, *leaf.shape[2:]), (before, after, action))
    gap = np.linalg.norm(np.asarray(before.others.position) - np.asarray(before.robot.position)[:, :, None], axis=-1)
    far = (gap.min(-1) > 1.5) & ~np.asarray(before.completed)

    def moved(before: State, after: State, action: jax.Array) -> Robot:
        state = replace(before, pedestrians=after.pedestrians)
        return scenario.robot.drive(scenario, state, action)

    robots = jax.jit(jax.vmap(jax.vmap(moved)))(before, after, action)
    assert far.sum() > 50
    close(*jax.tree.map(lambda leaf: leaf[far], (robots, after.robot)), 1e-5)


def test_starts_are_apart_and_tasks_differ(scenario: Scenario) -> None:
    members = of(scenario, 4)
    states = jax.jit(jax.vmap(partial(team.reset, members)))(jax.random.split(jax.random.key(5), 64))
    start = np.asarray(states.task.start)
    gap = np.linalg.norm(start[:, :, None] - start[:, None], axis=-1) + 1e3 * np.eye(4)
    assert gap.min() > 2.0 * float(scenario.robot.radius) + 0.29
    goal = np.asarray(states.task.goal)
    assert (np.linalg.norm(goal[:, 0] - goal[:, 1], axis=-1) > 0.1).mean() > 0.9
    np.testing.assert_array_equal(states.others.position[:, 1, 1:], states.robot.position[:, 2:])


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


@pytest.mark.parametrize("names", [("kuri", "kuri"), ("kuri", "jackal")])
def test_two_robots_stop_each_other(names: tuple[str, str]) -> None:
    members = make_team("lab", robots=names, **OPTIONS)
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


def test_rays_meet_the_solids_of_other_robots(scenario: Scenario) -> None:
    """The lidar of a robot, against MuJoCo's own rays on the file of the other robot, at random poses of both."""
    import mujoco

    members, random, cases = of(scenario, 2), np.random.default_rng(2), 12
    states = team.reset(members, jax.random.key(0))
    people = replace(states.pedestrians, present=jnp.zeros_like(states.pedestrians.present))
    places, angles = random.uniform(-0.9, 0.9, (cases, 2)), random.uniform(-np.pi, np.pi, (cases, 2))
    device = sensors.lidar(scenario, count=40, near=0.02)

    def scans(place: jax.Array, angle: jax.Array) -> tuple[jax.Array, jax.Array]:
        both = jnp.stack([jnp.zeros(2), place])
        heading = jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1)
        robot = jax.vmap(scenario.robot.place, (None, 0, 0))(scenario.robot, both, heading)
        moved = team.meet(replace(states, robot=robot, pedestrians=people))
        state = jax.tree.map(lambda leaf: leaf[0], moved)
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


def test_gradients_are_finite_and_a_step_is_traced_once(scenario: Scenario) -> None:
    """By the commands of two robots that drive into each other, one of which starts on a person."""
    members, traces = of(scenario, 2), []
    states = facing(scenario, members, 0.05)
    place = states.robot.position[:, 0]
    people = replace(states.pedestrians, position=states.pedestrians.position.at[:, 0].set(place))
    states = replace(states, pedestrians=people)

    @jax.jit
    def slope(actions: jax.Array, states: State) -> jax.Array:
        traces.append(1)

        def loss(actions: jax.Array) -> jax.Array:
            after, _ = jax.lax.scan(lambda state, action: (team.step(members, state, action), None), states, actions)
            return (after.robot.position * jnp.array([[1.0, 2.0], [3.0, 4.0]])).sum() + after.pedestrians.position.sum()

        return jax.grad(loss)(actions)

    first = slope(jnp.ones((3, 2, 2)), states)
    second = slope(0.5 * jnp.ones((3, 2, 2)), states)
    assert np.isfinite(first).all() and np.isfinite(second).all() and np.abs(first).max() > 0
    assert len(traces) == 1


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
        code = cli.main(words.split())
    except SystemExit as end:  # of the parser
        code = end.code
    told = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert code == 2 and message in told, told
    assert not list(tmp_path.iterdir())


def test_a_run_builds_robots_of_different_kinds() -> None:
    config = validate(RunConfig, {"environment": "lab", "behavior": "random", "people": 2, "robots": "kuri,jackal"})
    (members,) = assembly.build_team(config, config.team)
    assert members.names == ("kuri_0", "jackal_1")
    radii = members.over_members(lambda member: member.robot.radius)()
    assert float(radii[0]) != float(radii[1])


def test_actions_of_omnidirectional_robots_have_three_numbers() -> None:
    members = make_team("lab", robots="hsr,hsr", behavior="random", people=2)
    env = TeamEnv(members)
    assert env.action_space.shape == (3,) and env.rows({"hsr_1": [0.0, 1.0, 0.0]}).shape == (2, 3)
    result = jax.jit(lambda state, actions: env.step(state, actions)[1])
    command = result(env.reset(jax.random.key(0)), env.rows({"hsr_1": [0.0, 1.0, 0.0]})).info["command"]
    assert float(command[1, 1]) > 0.0 and not command[0].any()
