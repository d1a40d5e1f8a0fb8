"""Everything works in double precision as in single: nothing mixes them, and results agree."""

import dataclasses
import functools
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import classifiers, robots, sensors, social_forces
from sean_jax.core.data_types import Policy
from sean_jax.people import pedestrian_models
from sean_jax.policies import POLICIES
from sean_jax.robots.drive import command_size
from sean_jax.simulation.episodes import init_policy, policy_step
from support import programs
from support.quick import quick

ACTION = jax.ShapeDtypeStruct((2,), np.float64)
# What make takes, beside the environment: each behavior, task and option that adds arrays.
SCENARIOS = {
    "join_group": dict(people=4),
    "leave_group": dict(people=4, task="leave_group", routing="edge", congestion_cost=1.0),
    "walking_groups": dict(people=8, walking_groups=(0.5, 0.2)),
    "random_ab_nav": dict(people=4, behavior="random", task="random_ab_nav"),
    "busy_ab_nav": dict(people=4, task="busy_ab_nav"),
    "custom": dict(people=4, task="custom", start=(0.0, 0.0), goal=(2.0, 2.0)),
    "handcrafted": dict(behavior="handcrafted", task="handcrafted"),
    "playback": dict(behavior="playback", task="random_ab_nav", frame_rate=25.0),
    "alone": dict(people=0, behavior="random", task="random_ab_nav"),
}


@pytest.fixture(scope="module", autouse=True)
def double():
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    file = tmp_path_factory.mktemp("recording") / "walk.csv"
    file.write_text("\n".join(["frame,id,x,y", *(f"{frame},1,{0.02 * frame},0.5" for frame in range(100))]))
    return file


@pytest.fixture(scope="module")
def make(recording):
    @functools.cache
    def made(name, dynamics="twin", robot="kuri", metrics="none"):
        more = {"recording": recording} if name == "playback" else {}
        return sean_jax.make("lab", robot=robot, dynamics=dynamics, metrics=metrics, **SCENARIOS[name], **more)

    return made


@pytest.fixture(scope="module")
def small(make):
    return make("join_group")


@pytest.fixture(scope="module")
def state(small):
    return jax.eval_shape(functools.partial(sean_jax.reset, small), jax.random.key(0))


def all_double(tree) -> bool:
    floats = [leaf.dtype for leaf in jax.tree.leaves(tree) if jnp.issubdtype(leaf.dtype, jnp.inexact)]
    return bool(floats) and set(floats) == {np.dtype(np.float64)}


def traced(function, *arguments):
    """What comes out, which is all in double precision; under the tests' strict promotion, so nothing was mixed."""
    found = jax.eval_shape(function, *arguments)
    assert all_double(found)
    return found


def steps(scenario):
    begun = traced(functools.partial(sean_jax.reset, scenario), jax.random.key(0))
    after = traced(functools.partial(sean_jax.step, scenario), begun, ACTION)
    assert jax.tree.map(lambda leaf: leaf.dtype, after) == jax.tree.map(lambda leaf: leaf.dtype, begun)
    return after


@pytest.mark.slow
@pytest.mark.parametrize("name", quick(SCENARIOS, next(iter(SCENARIOS))))
def test_scenarios_reset_and_step(make, name):
    scenario = make(name)
    assert all_double(scenario)
    steps(scenario)


@pytest.mark.parametrize("dynamics", robots.DYNAMICS)
@pytest.mark.parametrize("name", quick(robots.ROBOTS, "kuri"))
def test_robots_step(small, state, name, dynamics):
    model = robots.load(name, dynamics)
    placed = jax.eval_shape(functools.partial(model.place, model), state.robot.position, state.robot.heading)
    state, action = state.replace(robot=placed), jax.ShapeDtypeStruct((command_size(model),), np.float64)
    driven = traced(lambda state, action: model.drive(small.replace(robot=model), state, action), state, action)
    assert jax.tree.map(lambda leaf: leaf.dtype, driven) == jax.tree.map(lambda leaf: leaf.dtype, placed)


@pytest.mark.parametrize("name", quick(POLICIES, "go_to_goal"))
def test_policies_drive(small, state, name):
    policy = POLICIES[name]
    begun = jax.eval_shape(functools.partial(init_policy, small, policy), state)
    if isinstance(policy, Policy):
        assert all_double(begun.policy_state)
    traced(functools.partial(policy_step, small, policy), begun)


@pytest.mark.parametrize("name", quick(pedestrian_models.MODELS, "social_forces"))
def test_people_move(small, state, name):
    traced(lambda state: pedestrian_models.MODELS[name](small, state), state)


@pytest.mark.parametrize("name", quick(social_forces.PRESETS, "helbing1995"))
def test_forces_push(small, state, name):
    forceful = small.replace(forces=social_forces.preset(name))
    traced(lambda state: forceful.move(forceful, state), state)


@pytest.mark.parametrize("name", classifiers.SITUATION_SETS)
def test_situations_are_classified(small, state, name):
    rules, values = classifiers.SITUATION_SETS[name], classifiers.THRESHOLD_SETS[name]()
    other = small.replace(situations=tuple(rules.items()), thresholds=values)
    assert all_double(values)
    found = jax.eval_shape(lambda state: sean_jax.teleport(other, state, jnp.zeros(2), jnp.ones(2)), state)
    assert found.situations.shape == (len(rules),)


def test_observations_and_metrics_are_double(make):
    scenario = make("join_group", metrics="all")
    state = steps(scenario)
    traced(functools.partial(sean_jax.observe, scenario), state)
    traced(functools.partial(sean_jax.results, scenario), state)


def test_no_float_is_asked_for_by_size():
    """But for recordings, networks and other projects: ``float`` is of the precision that is set."""
    package = Path(sean_jax.__file__).parent
    sized = [path for path in package.rglob("*.py") if "jnp.float32" in path.read_text(encoding="utf-8")]
    assert {path.relative_to(package).parts[0] for path in sized} == {"adapters", "learning"}


@pytest.mark.night
def test_gradients_are_double(small):
    """Of a depth image and of a step of the robot, by both of its dynamics."""
    eye, start = sensors.camera(small, "depth", width=8, height=6), jax.random.key(0)

    def seen(spot):
        return jnp.mean(sensors.depth(small, sean_jax.teleport(small, sean_jax.reset(small, start), spot, spot), eye))

    traced(jax.grad(seen), ACTION)
    for dynamics in robots.DYNAMICS:
        scenario = small.replace(robot=robots.load("kuri", dynamics))

        def moved(action, scenario=scenario):
            after = sean_jax.step(scenario, sean_jax.reset(scenario, start), action)
            return jnp.sum(after.robot.position)

        traced(jax.grad(moved), ACTION)


@pytest.mark.parametrize("name", quick(sensors.CAMERAS, "depth"))
def test_cameras_see(small, state, name):
    eye = sensors.camera(small, name, width=8, height=6)
    traced(lambda state: sensors.depth(small, state, eye), state)
    traced(lambda state: sensors.render(small, state, eye), state)


@pytest.mark.parametrize("name", quick([*sensors.CAMERAS, "lidar"], "lidar"))
def test_sensors_see_the_same(name):
    """Run, not traced: in double precision as in single.

    The programs in single precision stay: while they do, jax 0.10 converts the constants that they use to single
    precision in double precision too, unless a type is given.
    """
    found, jitted = {}, []
    for precise in (False, True):
        with jax.enable_x64(precise):
            scenario = sean_jax.make("lab", people=4, dynamics="twin", metrics="none")
            state = jax.tree.map(
                lambda leaf: jnp.zeros(leaf.shape, leaf.dtype),
                jax.eval_shape(functools.partial(_without_key, scenario), jax.random.key(0)),
            )
            people = jnp.asarray([[2.0, 0.3], [3.0, -1.0], [-1.0, 1.0], [4.0, 4.0]], float)
            heading = jnp.asarray([0.8, 0.6], float)
            state = state.replace(
                pedestrians=state.pedestrians.replace(position=people, present=jnp.ones(4, bool)),
                robot=state.robot.replace(heading=heading),
            )
            if name == "lidar":
                scan = sensors.lidar(scenario, count=90)
                jitted.append(jax.jit(lambda s: sensors.scan(scenario, s, scan)))  # noqa: B023
                seen = jitted[-1](state)
            else:
                eye = sensors.camera(scenario, name, width=16, height=12)
                jitted.append(jax.jit(lambda s: (sensors.depth(scenario, s, eye), sensors.render(scenario, s, eye))))  # noqa: B023
                seen, rendered = jitted[-1](state)
                assert rendered.rgb.dtype == seen.dtype
            assert seen.dtype == (np.float64 if precise else np.float32)
            found[precise] = np.asarray(seen)
    off = np.abs(found[True] - found[False])
    assert np.quantile(off, 0.97) < 1e-4 and np.ptp(found[True]) > 0.5  # a ray at an edge may pass it


def _without_key(scenario, key):
    return dataclasses.replace(sean_jax.reset(scenario, key), streams=())


@pytest.mark.night
@pytest.mark.parametrize("name", SCENARIOS)
def test_scenarios_run(make, name):
    """A second of each, compiled and run; finite, and the robot gets somewhere."""
    scenario = make(name, metrics="all")
    last, frames = programs.rollout(scenario, POLICIES["go_to_goal"], jax.random.key(0), 10)
    assert all_double(last) and all_double(frames)
    assert np.isfinite(frames.position).all() and np.isfinite(frames.people).all()
    assert np.linalg.norm(frames.position[-1] - frames.position[0]) + np.abs(np.diff(frames.heading, axis=0)).sum() > 0


@pytest.mark.night
@pytest.mark.parametrize(("name", "dynamics"), [*((name, "twin") for name in robots.ROBOTS), ("kuri", "mjx")])
def test_robots_run(make, name, dynamics):
    """One step of each robot, and its gradient, where its task begins: nothing touches a robot of its size there."""
    scenario = make("alone", dynamics, name)
    state = jax.jit(functools.partial(sean_jax.reset, scenario))(jax.random.key(0))

    @jax.jit
    @jax.value_and_grad
    def run(action):
        return scenario.robot.drive(scenario, state, action).speed

    speed, slope = run(jnp.full(command_size(scenario.robot), 0.2).at[0].set(0.3))
    assert speed.dtype == np.float64 and slope.dtype == np.float64
    assert float(speed) > 0.0 and np.isfinite(slope).all()


def test_single_precision_still_works_beside(small):
    """What was made in one precision is not handed out in the other, in the same process."""
    with jax.enable_x64(False):
        single = sean_jax.make("lab", people=4, dynamics="twin", metrics="none")
        kinds = {leaf.dtype for leaf in jax.tree.leaves(single) if jnp.issubdtype(leaf.dtype, jnp.inexact)}
        assert kinds == {np.dtype(np.float32)}
        state = jax.eval_shape(functools.partial(sean_jax.reset, single), jax.random.key(0))
    assert all_double(sean_jax.make("lab", people=4, dynamics="twin", metrics="none"))
    for name, policy in POLICIES.items():
        if isinstance(policy, Policy):
            with jax.enable_x64(False):
                jax.eval_shape(functools.partial(init_policy, single, policy), state)
            assert all_double(jax.tree.map(jnp.asarray, policy.params)), name
