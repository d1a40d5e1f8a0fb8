"""Several robots in one program: the same motion and readings as of each alone, gradients, one compilation."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import registry, reset, robots, sense, step
from sean_jax.config import EnvConfig, ScenarioConfig, validate
from sean_jax.core.errors import InputError
from sean_jax.robots import kernel
from sean_jax.simulation import making, scenario_stack
from sean_jax.world import generated
from sean_jax.world.environment import ENVS
from support import programs
from support.quick import slow

SET, NAMES = "worlds:passages,aisles,square:3", ("kuri", "turtlebot3", "jackal")
OWN = {"people": 3, "task": "random_ab_nav", "behavior": "random", "metrics": "none"}


def options(**more) -> ScenarioConfig:
    return validate(ScenarioConfig, {"environment": SET, **OWN, "robot": ",".join(NAMES), **more})


def build(config: ScenarioConfig) -> scenario_stack.Stack:
    return making.build(making.plan_scenario(config))[0]


@pytest.fixture(scope="module")
def small(tmp_path_factory) -> list[str]:
    """Sensors of few pixels, one of which sees the robot."""
    folder = tmp_path_factory.mktemp("sensors")
    for mount in ("depth", "overhead"):
        text = f"kind: depth\nmount: {mount}\nwidth: 16\nheight: 12\n"
        (folder / f"{mount}.yaml").write_text(text)
    return ["lidar", str(folder / "depth.yaml"), str(folder / "overhead.yaml")]


@pytest.fixture(scope="module")
def lab() -> tuple:
    """The robots on one floor, and first states of each, (6, ...)."""
    floors = build(options(environment="lab", robot=[*NAMES]))
    keys = jax.random.split(jax.random.key(1), 6)
    return floors, jax.jit(lambda floors, keys: floors.vmap(reset)(keys))(floors, keys)


def command(tick):
    """Six seconds ahead, braking, backward and turning."""
    ahead = jnp.where(tick < 25, 2.0, jnp.where(tick < 40, -2.0, 0.3))
    return jnp.stack([ahead, 0.5 * jnp.sin(0.2 * tick)])


@pytest.mark.night
def test_each_robot_moves_as_alone(lab):
    floors, states = lab

    def drive(scenario, state):
        def one(state, tick):
            state = dataclasses.replace(state, robot=scenario.robot.drive(scenario, state, command(tick)))
            return state, (state.robot.position, state.robot.speed)

        return jax.lax.scan(one, state, jnp.arange(60.0))[1]

    places, speeds = jax.jit(lambda floors, states: floors.vmap(drive)(states))(floors, states)
    alone = sean_jax.make("lab", **OWN, robot="jackal")
    own_places, own_speeds = jax.jit(jax.vmap(drive, (None, 0)))(alone, jax.tree.map(lambda leaf: leaf[4:], states))
    np.testing.assert_allclose(places[4:], own_places, atol=1e-5)
    np.testing.assert_allclose(speeds[4:], own_speeds, atol=1e-5)
    np.testing.assert_allclose(floors.at(2).navigation.radius, alone.navigation.radius, rtol=1e-6)
    reached = [float(np.abs(each).max()) for each in np.split(np.asarray(speeds), 3)]
    assert max(reached) > 0.9 and min(reached) < 0.6  # each has its own top speed


@pytest.mark.parametrize(("dynamics", "sensing"), slow([("twin", True), ("kinematic", False)], ("twin", True)))
def test_each_robot_is_as_it_is_alone(dynamics, sensing, small):
    """Whole steps, and readings at the same state; one is wider than people's clearance and has its own navigation."""
    more = {"dynamics": dynamics, "sensors": small if sensing else ()}
    floors = build(options(**more))
    keys = jax.random.split(jax.random.key(1), 6)

    def drive(scenario, key):
        def one(state, tick):
            state = step(scenario, state, command(tick))
            return state, (state.robot.position, state.robot.speed)

        return jax.lax.scan(one, reset(scenario, key), jnp.arange(60.0))

    states, (places, speeds) = jax.jit(lambda floors, keys: floors.vmap(drive)(keys))(floors, keys)
    readings = jax.jit(lambda floors, states: floors.vmap(sense)(states))(floors, states)
    folders = generated.find(SET)
    for number in (1, 2) if sensing else (2,):
        rows = slice(2 * number, 2 * number + 2)
        alone = sean_jax.make(str(folders[number]), **OWN, robot=NAMES[number], **more)
        _, (own_places, own_speeds) = jax.jit(jax.vmap(drive, (None, 0)))(alone, keys[rows])
        np.testing.assert_allclose(places[rows], own_places, atol=1e-5)
        np.testing.assert_allclose(speeds[rows], own_speeds, atol=1e-5)
        here = jax.tree.map(lambda leaf, rows=rows: leaf[rows], states)
        for sensor, alone_reading in jax.jit(jax.vmap(sense, (None, 0)))(alone, here).items():
            np.testing.assert_allclose(readings[sensor][rows], alone_reading, atol=1e-5, err_msg=sensor)
            assert np.ptp(alone_reading) > 0.1
    assert sorted(readings) == (["depth", "lidar", "overhead"] if sensing else [])


def test_one_compilation_serves_all_robots(lab):
    """A stack is one program, and so are its members one after the other."""
    floors, states = lab
    state = jax.tree.map(lambda leaf: leaf[0], states)

    @programs.jit_once
    def forward(scenario, state):
        return scenario.robot.drive(scenario, state, jnp.array([9.0, 0.0])).speed

    speeds = [float(forward(floors.at(number), state)) for number in range(3)]
    wider = dataclasses.replace(floors.at(0), robot=floors.at(0).robot.replace(radius=jnp.asarray(0.3, float)))
    forward(wider, state)
    assert floors.names == tuple(f"lab {name}" for name in NAMES)
    assert min(speeds) > 0.05 and len(set(speeds)) == 3
    assert floors.member.robot.name == ",".join(NAMES)


@pytest.mark.night
def test_gradients_by_everything_that_describes_a_robot(small):
    """They are finite; by the radius, of a robot that a wall has stopped, it is the whole radius."""
    floors = build(options(environment="lab", robot="turtlebot3,jackal", sensors=small))
    wall = dataclasses.replace(floors.at(0).environment.obstacles)

    def end(robot, state, scenario):
        scenario = dataclasses.replace(scenario, robot=robot)
        state = dataclasses.replace(state, robot=robot.place(robot, jnp.zeros(2), jnp.array([1.0, 0.0])))

        def one(state, _):
            return dataclasses.replace(state, robot=robot.drive(scenario, state, jnp.array([0.5, 0.0]))), None

        state = jax.lax.scan(one, state, length=30)[0]
        readings = sense(scenario, state)
        return state.robot.position[0], readings["depth"].sum() + readings["lidar"].sum()

    center = jnp.full_like(wall.center, 50.0).at[0].set(jnp.array([1.0, 0.0]))
    wall = dataclasses.replace(wall, center=center, half_extent=jnp.full_like(center, 0.1), yaw=jnp.zeros(len(center)))
    for number in range(2):
        scenario = floors.at(number)
        scenario = dataclasses.replace(scenario, environment=scenario.environment.replace(obstacles=wall))
        state = jax.jit(reset)(scenario, jax.random.key(0))
        nobody = dataclasses.replace(state.pedestrians, present=jnp.zeros_like(state.pedestrians.present))
        slopes, seen = jax.jit(jax.jacrev(end))(
            scenario.robot, dataclasses.replace(state, pedestrians=nobody), scenario
        )
        for leaf in jax.tree.leaves((slopes, seen)):
            assert np.isfinite(leaf).all()
        assert float(slopes.radius) == pytest.approx(-1.0, abs=0.02)
        assert any(np.abs(mount.origin).max() > 0.0 for mount in seen.mounts)


def test_a_kernel_gets_the_radius_as_a_row(monkeypatch):
    """Robots of several sizes in one launch, each as the loop moves it."""
    monkeypatch.setattr(kernel, "_call", functools.partial(kernel._call, interpret=True))
    from sean_jax.robots import drive as driving
    from sean_jax.robots.dynamics import Surroundings

    models = scenario_stack.stack(robots.alike([robots.load(name) for name in NAMES]))
    boxes = sean_jax.make("lab", people=1).environment.obstacles
    boxes = jax.tree.map(lambda leaf: leaf[:1], boxes)
    boxes = dataclasses.replace(boxes, center=jnp.array([[1.0, 0.0]]), half_extent=jnp.array([[0.5, 5.0]]))
    boxes = dataclasses.replace(boxes, yaw=jnp.zeros(1))
    near = Surroundings(boxes, jnp.zeros((1, 2)), jnp.zeros((1, 2)), jnp.zeros(1, bool), jnp.asarray(0.2))

    def run(form, model, x):
        motion = jnp.zeros(5).at[0].set(x), jnp.zeros(5).at[0].set(0.5).at[3:].set(0.5 / model.wheel_radius)
        return form(5, model, near, motion, jnp.full(2, 0.5) / model.wheel_radius)[0]

    places = jnp.tile(jnp.array([0.2, 0.35]), 3)
    ours, theirs = (
        jax.jit(models.vmap(functools.partial(run, form)))(places) for form in (kernel.simulate, driving._simulate_twin)
    )
    np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=2e-5)
    assert len({round(float(x), 3) for x in ours[1::2, 0]}) == 3  # they stop at their own distance


def test_robots_that_do_not_go_together_are_refused(tmp_path):
    with pytest.raises(InputError, match="MJX moves one robot"):
        making.build_members(making.plan_scenario(options(dynamics="mjx")))
    with pytest.raises(InputError, match="kuri,jackal are 2 robots; this takes one"):
        sean_jax.make("lab", robot="kuri,jackal")
    with pytest.raises(InputError, match="robot: 'kuri' is listed twice"):
        options(robot="kuri,kuri")
    with pytest.raises(InputError, match="unknown robot 'kurri'.*kuri"):
        making.build_members(making.plan_scenario(options(robot="jackal,kurri")))
    with pytest.raises(InputError, match="'handcrafted' is not for several floors or robots"):
        making.build_members(
            making.plan_scenario(options(environment="lab", behavior="handcrafted", task="handcrafted", people=None))
        )
    text = (ENVS / "robots" / "kuri.xml").read_text(encoding="utf-8")
    (tmp_path / "slow.xml").write_text(text.replace('timestep="0.02"', 'timestep="0.01"'))
    with pytest.raises(InputError, match="kuri and slow have physics steps of 0.02 and 0.01 s"):
        robots.alike([robots.load("kuri"), robots.load(tmp_path / "slow.xml")])
    (tmp_path / "low.xml").write_text(text.replace("-0.0872 0 0.9962", "-0.1736 0 0.9848", 1))
    both = robots.alike([robots.load("kuri"), robots.load(tmp_path / "low.xml")])
    assert {mount.name for mount in both[0].mounts} == {"first_person", "third_person", "overhead", "lidar"}
    with pytest.raises(InputError, match="robot 'kuri,low' has no 'depth'"):
        sean_jax.sensors.camera(both[0], "depth")


def test_environments_have_several_robots():
    config = validate(EnvConfig, {"environment": "lab", **OWN, "robot": "kuri,jackal", "observations": ["goal"]})
    envs = registry.build(config)
    radii = [float(envs.at(number).scenario.robot.radius) for number in range(2)]
    assert envs.size == 2 and radii == pytest.approx([0.16, 0.27])
    assert registry.build(config, limit=1).member.scenario.robot.name == "kuri"
