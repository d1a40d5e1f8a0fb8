"""Entries from others' papers, dwa, social_force and mppi: against float64 loops, and among people."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax.policies import POLICIES, dwa, mppi, social_force
from sean_jax.policies.dwa import FORBIDDEN, INTERVAL, PEOPLE_MARGIN, STEPS, objective, window
from sean_jax.policies.expert import OBSTACLE_MARGIN
from sean_jax.policies.mppi import weighted_mean
from sean_jax.simulation import episodes
from support import programs
from support.scenes import box, room

NAMES = ("dwa", "social_force", "mppi")
FLOOR, BOX = (-5.0, -4.0, 5.0, 4.0), (0.0, 2.5, 0.4, 0.4)  # m; middle and half extent
PEOPLE = 3


@pytest.fixture(scope="module")
def make(tmp_path_factory):
    """A function: name of a robot -> a scenario in a room with one pillar, and its first state."""
    folder = room(tmp_path_factory.mktemp("room"), FLOOR, [box(BOX[:2], BOX[2:])], PEOPLE)

    @functools.cache
    def scenario_of(robot, double):
        scenario = sean_jax.make(
            folder, behavior="random", task="custom", start=(-2.5, 0.3), goal=(2.5, 0.3, 90.0), people=PEOPLE,
            robot=robot, dynamics="twin", metrics="none",
        )  # fmt: skip
        scenario = dataclasses.replace(scenario, situations=scenario.situations[-1:])
        return scenario, programs.reset(scenario, jax.random.key(0))

    return lambda robot="kuri": scenario_of(robot, jax.config.jax_enable_x64)


def placed(scenario, state, random, near=1.5):
    """The state with robot and people at random, the people around the robot."""
    here = random.uniform((-3.5, -2.5), (3.5, 1.5))
    angle = random.uniform(-np.pi, np.pi)
    robot = scenario.robot.place(scenario.robot, jnp.asarray(here), jnp.asarray([np.cos(angle), np.sin(angle)]))
    robot = robot.replace(speed=jnp.asarray(random.uniform(0.0, 0.5)), turn_rate=jnp.asarray(random.uniform(-1, 1)))
    if robot.sideways is not None:
        robot = robot.replace(sideways=jnp.asarray(random.uniform(-0.3, 0.3)))
    people = dataclasses.replace(
        state.pedestrians,
        position=jnp.asarray(here + random.normal(0.0, near, (PEOPLE, 2))),
        velocity=jnp.asarray(random.normal(0.0, 0.7, (PEOPLE, 2))),
        present=jnp.asarray(random.random(PEOPLE) < 0.8),
    )
    return state.replace(robot=robot, pedestrians=people)


def box_gap(x, y):
    """Distance [m] from the pillar, and the unit normal there."""
    dx, dy = x - BOX[0], y - BOX[1]
    out = np.array([np.sign(dx) * max(abs(dx) - BOX[2], 0.0), np.sign(dy) * max(abs(dy) - BOX[3], 0.0)])
    return np.hypot(*out), out / np.maximum(np.hypot(*out), 1e-12)


# ------------------------------------------------------------------ dwa


def value_by_hand(scenario, state, target, command):
    """The objective of one command before it is smoothed, and what its speed exceeds the admissible one by."""
    model, robot = scenario.robot, state.robot
    omni = len(command) == 3
    left = model.lateral
    parts = [
        (model.max_acceleration, model.max_speed, robot.speed),
        *([(left.max_acceleration, left.max_speed, robot.sideways)] if omni else []),
        (model.max_turn_acceleration, model.max_turn_rate, robot.turn_rate),
    ]
    change, most, now = np.array(parts, float).T
    change = INTERVAL * change
    place, yaw = np.array(robot.position, float), np.arctan2(*np.array(robot.heading, float)[::-1])
    start = yaw
    people = [(np.array(p, float), np.array(v, float)) for p, v, here in zip(
        state.pedestrians.position, state.pedestrians.velocity, state.pedestrians.present, strict=True) if here
    ]  # fmt: skip

    def gap(place, time):
        x, y = place
        radius = float(model.radius)
        to_people = [np.hypot(*(place - p - time * v)) for p, v in people]
        reach = radius + float(scenario.forces.walking.radius) + PEOPLE_MARGIN
        edge = min(x - FLOOR[0], FLOOR[2] - x, y - FLOOR[1], FLOOR[3] - y)
        return min([to - reach for to in to_people] + [min(box_gap(x, y)[0], edge) - radius - OBSTACLE_MARGIN])

    nearest, way, free, heading = min(gap(place, 0.0), 0.0), 0.0, True, None
    for step in range(STEPS):
        now = np.clip(np.clip(command, now - change, now + change), -most, most)
        turn = INTERVAL * now[-1]
        middle = yaw + 0.5 * turn
        ahead = np.array([np.cos(middle), np.sin(middle)])
        move = now[0] * ahead + (now[1] * np.array([-ahead[1], ahead[0]]) if omni else 0.0)
        place, yaw = place + INTERVAL * move, yaw + turn
        if heading is None:
            braked = yaw - start + now[-1] * abs(now[-1]) / (2.0 * float(model.max_turn_acceleration))
            course = np.arctan2(command[1], command[0]) if omni else braked
            off = np.arctan2(target[1], target[0]) - course
            heading = 1.0 - abs(np.arctan2(np.sin(off), np.cos(off))) / np.pi
            toward = np.cos(off) if omni else 1.0
        free = free and not gap(place, (step + 1) * INTERVAL) < nearest
        way += INTERVAL * np.hypot(*move) if free else 0.0
    longest = float(model.max_speed) * STEPS * INTERVAL
    way = longest if free else way
    speed = np.hypot(*command[:-1]) if omni else command[0]
    excess = max(speed - np.sqrt(2.0 * float(model.max_acceleration) * way), 0.0)
    return 0.4 * heading + 0.4 * way / longest + 0.2 * toward * speed / float(model.max_speed), excess


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["kuri", "a1"])
def test_the_objective_of_dwa_is_that_of_a_loop(make, robot):
    random, blocked = np.random.default_rng(1), 0
    with jax.enable_x64(True):
        scenario, state = make(robot)
        run = jax.jit(functools.partial(objective, scenario, dwa.params))
        reachable = jax.jit(functools.partial(window, scenario.robot))
        for _ in range(4):
            now = placed(scenario, state, random, near=0.6)
            observation = programs.observe(scenario, now)
            commands = reachable(now.robot, observation)
            target = np.asarray(observation.path)
            mine = np.asarray(run(now, observation.path, commands))
            rows = np.stack([np.asarray(part) for part in commands], -1)
            value, excess = np.vectorize(
                functools.partial(value_by_hand, scenario, now, target), signature="(n)->(),()"
            )(rows)
            padded = np.pad(value, 1, mode="edge")
            smooth = np.mean(
                [padded[i : i + rows.shape[0], j : j + rows.shape[1]] for i in range(3) for j in range(3)], 0
            )
            np.testing.assert_allclose(mine, smooth - FORBIDDEN * excess, atol=1e-6, rtol=1e-6)
            blocked += (excess > 0).sum()
    assert blocked > 20


def test_the_window_is_what_the_robot_reaches(make):
    scenario, state = make("fetch")
    state = placed(scenario, state, np.random.default_rng(2))
    model, robot = scenario.robot, state.robot.replace(speed=jnp.asarray(0.4), turn_rate=jnp.asarray(-1.2))
    ahead, turn = map(np.asarray, window(model, robot, programs.observe(scenario, state)))
    np.testing.assert_allclose([ahead.min(), ahead.max()], [0.4 - 0.25 * 0.75, 0.4 + 0.25 * 0.75], rtol=1e-5)
    np.testing.assert_allclose([turn.min(), turn.max()], [-1.5, -1.2 + 0.25 * 3.0], rtol=1e-5)


# ------------------------------------------------------------------ social_force


def potential(d, walked):
    """[HM95] (3), (4): V0 exp(-b / sigma) of the semi-minor axis of the ellipse of the other's next step."""
    b = 0.5 * np.sqrt((np.hypot(*d) + np.hypot(*(d - walked))) ** 2 - walked @ walked)
    return 2.1 * np.exp(-b / 0.3)


def push_by_hand(scenario, state, point, look):
    total = np.zeros(2)
    for index in np.flatnonzero(np.asarray(state.pedestrians.present)):
        d = point - np.array(state.pedestrians.position[index], float)
        walked = 2.0 * np.array(state.pedestrians.velocity[index], float)
        step = 1e-6 * np.eye(2)
        force = -np.array([potential(d + e, walked) - potential(d - e, walked) for e in step]) / 2e-6
        seen = look @ -force >= np.hypot(*force) * np.cos(np.deg2rad(100.0))
        total += force * (1.0 if seen else 0.5)
    x, y = point
    edges = [(x - FLOOR[0], (1, 0)), (FLOOR[2] - x, (-1, 0)), (y - FLOOR[1], (0, 1)), (FLOOR[3] - y, (0, -1))]
    for distance, normal in [box_gap(x, y), *edges]:
        total += 25.0 * np.exp((float(scenario.robot.radius) - distance) / 0.08) * np.array(normal)
    return total


@pytest.mark.parametrize("robot", ["kuri", "a1"])
def test_the_command_of_social_force_is_that_of_a_loop(make, robot):
    """Everybody is visible; the direction of the goal has the noise of the key."""
    random = np.random.default_rng(3)
    with jax.enable_x64(True):
        scenario, state = make(robot)
        everybody = dataclasses.replace(social_force.params, min_pixels=jnp.zeros(()))
        state = episodes.init_policy(scenario, social_force, state)
        run = jax.jit(functools.partial(social_force.apply, scenario, everybody))
        for number in range(8):
            now, key, model = placed(scenario, state, random), jax.random.key(number), scenario.robot
            x, y = np.array(now.robot.heading, float)
            speed = float(now.robot.speed)
            omni, top = now.robot.sideways is not None, float(model.max_speed)
            lever = 0.0 if omni else 0.6 * float(model.radius)
            aside = float(now.robot.sideways) if omni else lever * float(now.robot.turn_rate)
            frame = np.array([[x, -y], [y, x]])  # columns: ahead and left
            goal = np.array(programs.observe(scenario, now).path, float)
            noise = 0.3 * (1.0 - min(speed / top, 1.0)) * float(jax.random.normal(key, ()))
            angle = np.arctan2(goal[1], goal[0]) + noise
            look = np.array([np.cos(angle), np.sin(angle)])
            point = np.array(now.robot.position, float) + lever * frame[:, 0]
            pushed = frame.T @ push_by_hand(scenario, now, point, frame @ look)
            after = np.array([speed, aside]) + 0.1 * ((top * look - [speed, aside]) / 0.5 + pushed)
            if omni:
                turn = 2.0 * np.arctan2(goal[1], goal[0])
                wanted = np.array([*np.clip(after, -top, top), turn])
            else:
                wanted = np.array([np.clip(after[0], -top, top), after[1] / lever])
            wanted[-1] = np.clip(wanted[-1], -float(model.max_turn_rate), float(model.max_turn_rate))
            np.testing.assert_allclose(run(now, key)[0], wanted, atol=2e-6)


# ------------------------------------------------------------------ mppi


def test_the_plan_of_mppi_is_the_weighted_mean_of_a_loop():
    random = np.random.default_rng(4)
    last, costs = random.uniform(-1, 1, (5, 2)), random.uniform(3.0, 3.1, 64)
    plans = last + 0.3 * random.normal(size=(64, 5, 2))
    temperature, deviation, gamma = (
        float(mppi.params.search.temperature),
        float(mppi.params.deviation),
        float(mppi.params.control_cost),
    )
    total = np.array(
        [
            cost + gamma * sum(u * (v - u) / deviation**2 for u, v in zip(last.flat, plan.flat, strict=True))
            for cost, plan in zip(costs, plans, strict=True)
        ]
    )
    weights = np.exp(-(total - total.min()) / temperature)
    expected = sum(weight * plan for weight, plan in zip(weights, plans, strict=True)) / weights.sum()
    with jax.enable_x64(True):
        mine = weighted_mean(mppi.params, *map(jnp.asarray, (last, plans, costs)))
        np.testing.assert_allclose(mine, expected, atol=1e-12)
    assert weights.sum() > 3.0  # several matter


@pytest.mark.slow
def test_mppi_begins_at_its_last_plan(make):
    """With hardly any noise the plan is the remembered one, with its beginning removed."""
    scenario, state = make()
    calm = dataclasses.replace(mppi, params=dataclasses.replace(mppi.params, deviation=jnp.asarray(1e-6)))
    state = episodes.init_policy(scenario, calm, state)
    knots = jnp.asarray([[0.5, 0.0], [0.7, 0.4], [0.3, 0.0], [0.1, -0.4], [0.0, 0.0]])
    search = state.policy_state.search._replace(knots=knots)
    state = state.replace(policy_state=state.policy_state._replace(search=search))
    command, memory = jax.jit(functools.partial(calm.apply, scenario, calm.params))(state, jax.random.key(1))
    part = scenario.time_step / (3.2 / 4)
    after = [knots[k] + part * (knots[min(k + 1, 4)] - knots[k]) for k in range(5)]
    np.testing.assert_allclose(memory.search.knots, np.stack(after), atol=1e-4)
    np.testing.assert_allclose(command, after[0] * np.array([0.5, 2.0]), atol=1e-3)


# ------------------------------------------------------------------ among people


@pytest.mark.parametrize("name", NAMES)
def test_only_visible_people_matter(make, name):
    (scenario, state), policy = make(), POLICIES[name]
    state = episodes.init_policy(scenario, policy, state)
    heading = jnp.asarray([1.0, 0.0])
    state = state.replace(robot=scenario.robot.place(scenario.robot, jnp.asarray([-2.5, 0.3]), heading))
    apply = jax.jit(lambda state: policy.apply(scenario, policy.params, state, jax.random.key(5))[0])

    def command(*place):
        position = jnp.asarray([place, *[(-4.8, -3.8)] * (PEOPLE - 1)])
        people = state.pedestrians.replace(position=position, velocity=jnp.zeros((PEOPLE, 2)))
        return np.asarray(apply(state.replace(pedestrians=people)))

    alone = command(-4.8, -3.8)
    np.testing.assert_array_equal(command(-3.2, 0.3), alone)  # behind it
    assert not np.array_equal(command(-1.98, 0.35), alone)


@pytest.mark.night
@pytest.mark.parametrize("name", NAMES)
def test_tasks_in_the_lab_are_completed_without_collisions(name):
    touched = ["collision_robot_on_person", "collision_with_obstacle"]
    scenario = sean_jax.make("lab", metrics=touched, time_limit=60.0)
    result = sean_jax.evaluate(scenario, POLICIES[name], episodes=24)
    assert result.completed.mean() > 0.9
    assert not any(result.metrics[metric].any() for metric in touched)
