"""Randomization by bounds: of people, robot and sensors; values and YAML files; delays and laws of trainings."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import mdp, registry, sensors
from sean_jax.config import EnvConfig, PPOConfig, validate
from sean_jax.core.errors import InputError
from sean_jax.learning import reinforcement
from sean_jax.mdp import Env, as_randomization, make_env
from sean_jax.mdp.observations import FAR_LIDAR
from sean_jax.simulation import making

SET = "worlds:passages:2"
FILE = """\
people: [0.25, 1.0]
speed: [0.6, 1.4]
robot.max_speed: [0.6, 1.2]
robot.max_acceleration: [0.5, 1.5]
sensors.min_deviation: [0.0, 0.02]
sensors.drop_out: [0.0, 0.05]
"""
BOUNDS = {
    "people": (0.25, 1.0), "speed": (0.6, 1.4), "robot.max_speed": (0.6, 1.2), "robot.max_acceleration": (0.5, 1.5),
    "sensors.min_deviation": (0.0, 0.02), "sensors.drop_out": (0.0, 0.05),
}  # fmt: skip
ALL = {
    name: (max(each.least, -2.0) if each.least > 0 or name == "side" else 0.0, min(each.most, 2.0))
    for name, each in mdp.PARAMETERS.items()
}


@pytest.fixture(scope="module")
def scenario():
    return sean_jax.make("lab", people=5, dynamics="twin", time_limit=3.0, metrics=[])


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "my.yaml"
    path.write_text(FILE)
    return path


# ------------------------------------------------------------------ forms of a description


def test_all_forms_are_one(file):
    wanted = as_randomization(BOUNDS)
    assert wanted.bounds == tuple((name, *BOUNDS[name]) for name in mdp.PARAMETERS if name in BOUNDS)
    assert wanted == as_randomization(file) == as_randomization(str(file))
    assert hash(wanted) == hash(as_randomization(dict(reversed(BOUNDS.items()))))
    for value in (str(file), BOUNDS, wanted, {name: list(each) for name, each in BOUNDS.items()}):
        config = validate(EnvConfig, {"environment": "lab", "randomization": value})
        assert registry.plan_env(config).randomization == wanted
        if value is not wanted:
            told = {name: each for name, each in config.identity()["randomization"].items() if name != "kind"}
            assert told == {name: list(each) for name, each in BOUNDS.items()}
            again = EnvConfig(**{"environment": "lab", "randomization": config.identity()["randomization"]})
            assert registry.plan_env(again).randomization == wanted
    assert as_randomization("behavior") is mdp.RANDOMIZATIONS["behavior"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "people: [0.5, 1.0]\nrobot.max_sped: [1, 2]",
            r"my.yaml:2:17: robot.max_sped: is not one of .*robot.max_speed'?",
        ),
        ("people: [0.5, 1.5]", r"my.yaml:1:9: people: \[0.5, 1.5\] must be .* within 0 to 1"),
        ("speed: [2, 1]", r"my.yaml:1:8: speed: \[2, 1\] must be a lesser and a greater number"),
        ("speed: [1, .inf]", r"my.yaml:1:12: speed\[1\]: inf must be from"),
        ("speed: [1, 2, 3]", r"my.yaml:1:8: speed: .* has 3 values, 2 are allowed"),
        ("speed: fast", r"my.yaml:1:8: speed: 'fast' is not a list"),
        ("robot: {max_speed: [1, 2]}", r"my.yaml:1:1: robot: .* is not a list"),
        ("{}", r"my.yaml:1:1: there are no bounds; give some"),
    ],
)
def test_wrong_files(text, message, tmp_path):
    (tmp_path / "my.yaml").write_text(text)
    with pytest.raises(InputError, match=message):
        as_randomization(tmp_path / "my.yaml")
    with pytest.raises(InputError, match=message):
        registry.plan_env(EnvConfig(environment="lab", randomization=str(tmp_path / "my.yaml")))


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({"sped": (1, 2)}, r"randomization.sped: is not one of .*did you mean 'speed'\?$"),
        ({"people": (0.5, 1.5)}, r"randomization.people: \[0.5, 1.5\] must be .* within 0 to 1\.$"),
        ({"stay": (0, float("inf"))}, r"randomization.stay: inf must be from"),
        ({"sensors.drop_out": (0.0, 1.01)}, "within 0 to 1"),
        ({"robot.friction": (0.0, 1.0)}, "within 0.05 to 20"),
        ({}, "there are no bounds"),
        ("nope.yaml", "nope.yaml; there is no such file|there is no such file"),
        ("people", "'people' is not one of behavior, nor a .yaml file"),
        (3, "3 is no function"),
    ],
)
def test_wrong_values(value, message):
    with pytest.raises(InputError, match=message):
        as_randomization(value)


# ------------------------------------------------------------------ what it changes


def test_draws_and_mutations_are_within_bounds(scenario):
    randomization = as_randomization(ALL)
    assert [name for name, _, _ in randomization.bounds] == list(mdp.PARAMETERS)
    drawn = jax.vmap(lambda key: randomization.draw(key, scenario))(jax.random.split(jax.random.key(0), 200))
    mutate = jax.vmap(lambda key, one: randomization.mutate(key, one, scenario))
    moved = mutate(jax.random.split(jax.random.key(1), 200), drawn)
    for name, (low, high) in ALL.items():
        old, new = np.asarray(drawn[name]), np.asarray(moved[name])
        for values in (old, new):
            assert values.min() >= low and values.max() <= high and np.ptp(values) > 0.5 * (high - low), name
        assert (old != new).mean() > 0.9 and np.corrcoef(old.reshape(-1), new.reshape(-1))[0, 1] > 0.6, name
    again = jax.vmap(lambda key: randomization.draw(key, scenario))(jax.random.split(jax.random.key(0), 200))
    for name in ALL:
        np.testing.assert_array_equal(drawn[name], again[name])


def test_every_parameter_changes_its_scenario(scenario):
    """And nothing else, but those of people who are present."""
    scenario = scenario.replace(
        people_present=jnp.full((), 4, jnp.int32), sensor_errors=sensors.distance_errors(0.0, 0.0, 0.0)
    )
    robot = scenario.robot.replace(max_deceleration=jnp.asarray(2.0), max_reverse_speed=jnp.asarray(0.2))
    scenario = scenario.replace(robot=robot)
    for name, (low, _) in ALL.items():
        value = max(low, 0.5)
        one = as_randomization({name: (value, value)})
        changed = one.apply(one.draw(jax.random.key(0), scenario), scenario)
        pairs = zip(jax.tree.leaves_with_path(scenario), jax.tree.leaves(changed), strict=True)
        paths = [
            jax.tree_util.keystr(path, simple=True, separator=".")
            for (path, old), new in pairs
            if not np.array_equal(old, new)
        ]
        assert paths, name
        if name.startswith(("robot.", "sensors.")):
            assert paths == [name.replace("sensors.", "sensor_errors.")]
        if name.startswith("robot."):
            leaf = name.removeprefix("robot.")
            assert float(getattr(changed.robot, leaf)) == pytest.approx(0.5 * float(getattr(robot, leaf)))


def test_limits_that_a_robot_shares_are_factors_of_the_robots_own(scenario):
    """Deceleration of the usual acceleration, in whatever order they are given."""
    robot = scenario.robot.replace(max_deceleration=None, max_reverse_speed=None)
    bounds = {"robot.max_acceleration": (2.0, 2.0), "robot.max_deceleration": (0.5, 0.5), "robot.max_speed": (0.5, 0.5)}
    one = as_randomization(bounds)
    changed = one.apply(one.draw(jax.random.key(0), scenario), scenario.replace(robot=robot)).robot
    assert float(changed.max_deceleration) == pytest.approx(0.5 * float(robot.max_acceleration))
    assert float(changed.max_acceleration) == pytest.approx(2.0 * float(robot.max_acceleration))
    assert changed.max_reverse_speed is None


@pytest.mark.night
def test_episodes_have_their_own_robots(scenario):
    """The command is a share of the top speed of the episode, which the robot reaches."""
    env = make_env(scenario, ["speeds"], randomization={"robot.max_speed": (0.5, 1.0), "robot.friction": (0.8, 1.2)})
    env = jax.jit(Env.with_pool, static_argnums=2)(env, jax.random.key(0), 4)
    step = jax.jit(jax.vmap(Env.step, (None, 0, 0, None)))
    states, keys = env.pool.states, jax.random.split(jax.random.key(1), 4)
    for _ in range(25):
        seen, states, *_ = step(env, keys, states, jnp.array([1.0, 0.0]))
    tops = states.randomization["robot.max_speed"] * scenario.robot.max_speed
    free = np.asarray(seen["speeds"][:, 0]) > 0.9 * np.asarray(tops)  # not before a person
    assert free.sum() >= 2 and np.ptp(np.asarray(tops)) > 0.05
    np.testing.assert_allclose(seen["speeds"][free, 0], tops[free], rtol=0.02)


@pytest.mark.night
def test_errors_of_the_sensors_of_observations(scenario):
    """Against the exact readings: the deviation and the share of misses of the episode, from the state alone."""
    bounds = {"sensors.min_deviation": (0.05, 0.1), "sensors.drop_out": (0.1, 0.3)}
    exact = make_env(scenario, ["lidar", "depth"])
    noisy = make_env(scenario, ["lidar", "depth"], randomization=bounds)
    keys = jax.random.split(jax.random.key(0), 12)
    reset = jax.jit(jax.vmap(Env.reset, (None, 0)))
    (seen, states), (true, _) = reset(noisy, keys), reset(exact, keys)
    image, true_image = np.asarray(seen["depth"]), np.asarray(true["depth"])
    hits = (true_image > 0.5) & (true_image < 9.0)
    missed = hits & (image == 10.0)
    deviations, shares = states.randomization["sensors.min_deviation"], states.randomization["sensors.drop_out"]
    rows = [row for row in range(12) if hits[row].sum() > 500]
    assert len(rows) > 4
    for row in rows:
        share, count = float(shares[row]), hits[row].sum()
        assert abs(missed[row].sum() - share * count) < 5.0 * np.sqrt(count * share * (1.0 - share))
        error = (image - true_image)[row][hits[row] & ~missed[row]]
        assert np.std(error) == pytest.approx(float(deviations[row]), rel=0.15)
    assert (np.asarray(seen["lidar"]) <= FAR_LIDAR).all()
    again, _ = reset(noisy, keys)
    np.testing.assert_array_equal(again["lidar"], seen["lidar"])
    assert (np.asarray(seen["lidar"]) != np.asarray(true["lidar"])).mean() > 0.3


def test_errors_of_the_scenarios_own_sensors(scenario):
    """A sensor with errors of its own keeps those that are not drawn."""
    own = sensors.lidar_sensor(sensors.lidar(scenario, count=90), sensors.distance_errors(0.5, 0.0, 0.25), "own")
    scenario = scenario.replace(sensors=(own,))
    one = as_randomization({"sensors.min_deviation": (0.01, 0.01)})
    changed = one.apply(one.draw(jax.random.key(0), scenario), scenario)
    errors = changed.sensors[0].params
    assert float(errors.min_deviation) == pytest.approx(0.01) and float(errors.drop_out) == 0.25
    assert float(changed.sensor_errors.drop_out) == 0.0
    env = make_env(scenario, {"own": mdp.observations.sensor("own", 0.0, 100.0)}, randomization=one)
    assert env.observation_space["own"].shape == (90,)


@pytest.mark.night
def test_derivatives_by_parameters_are_finite(scenario):
    """At ends of the bounds, too: of the robot's motion, and of a noisy reading."""
    bounds = {name: each for name, each in BOUNDS.items() if name != "people"} | {"robot.friction": (0.5, 2.0)}
    env = make_env(scenario, ["speeds"], randomization=bounds)
    _, state = jax.jit(Env.reset)(env, jax.random.key(0))

    def total(parameters):
        randomized = env.scenario_of(parameters)
        command = mdp.to_command(randomized.robot, jnp.array([0.8, 0.3]))
        after = sean_jax.step(randomized, state.simulation, command)
        device = sensors.lidar_sensor(sensors.lidar(scenario, count=12))
        scan = sensors.sense(randomized.replace(sensors=(device,)), after)["lidar"]
        return after.robot.speed + scan.sum()

    slope = jax.jit(jax.grad(total))
    found = [slope({name: jnp.asarray(each[end], float) for name, each in bounds.items()}) for end in (0, 1)]
    assert all(np.isfinite(np.asarray(value)) for value in jax.tree.leaves(found))
    for name in ("robot.max_speed", "sensors.min_deviation"):
        assert any(abs(float(each[name])) > 1e-4 for each in found), name


@pytest.mark.slow
def test_floors_of_a_set_are_randomized():
    config = validate(EnvConfig, {"environment": SET, "people": 4, "observations": ["goal", "lidar"],
                                  "task": "random_ab_nav", "randomization": BOUNDS})  # fmt: skip
    envs = registry.build(config)

    def lacks(env, key):
        _, state = env.reset(key)
        scenario = env.scenario_of(state.randomization)
        return state.randomization["people"], state.simulation.pedestrians.present.sum(), scenario.people_present

    shares, there, said = jax.jit(lambda envs, keys: envs.vmap(lacks)(keys))(
        envs, jax.random.split(jax.random.key(0), 8)
    )
    np.testing.assert_array_equal(there, np.ceil(np.asarray(shares) * 4 - 1e-4))
    np.testing.assert_array_equal(there, said)
    assert len(np.unique(shares)) == 8


# ------------------------------------------------------------------ delays and laws


def test_delays_of_observations():
    config = EnvConfig(environment="lab", people=3, observations=["goal", "people"], observation_delay=["people=1:3"])
    env = registry.build(config).member
    assert {name: term.delay for name, term in env.observations} == {"goal": (0, 0), "people": (1, 3)}
    assert EnvConfig(observation_delay=["goal=2"]).observation_delays == {"goal": (2, 2)}
    with pytest.raises(InputError, match="observation_delay: 'people' is not one of goal"):
        registry.plan_env(config.replace(observations=["goal"]))
    for wrong in ("people", "people=", "people=3:1", "people=-1:2", "people=1:2:3", "people=0:9999"):
        with pytest.raises(InputError, match=f"observation_delay: {wrong} has no steps .* write people=0:3"):
            EnvConfig(observation_delay=[wrong])


def training(out, **more) -> PPOConfig:
    return PPOConfig(
        method="ppo", people=3, task="random_ab_nav", observations=["goal", "people"], width=8, layers=1, horizon=8,
        minibatches=2, evaluation_episodes=4, time_limit=0.5, metrics=[], out=out, **more,
    )  # fmt: skip


@pytest.mark.night
def test_laws_are_environments():
    config = training(
        None, environment="lab", laws="calibrated,sean2,orca", scenarios=12, observation_delay=["people=1"]
    )
    scenarios, envs, _ = reinforcement.build(config)
    alone = [
        making.scenarios(validate(EnvConfig, {"environment": "lab", "people": 3, **law}))[0]
        for law in ({}, {"forces": "sean2"}, {"model": "orca"})
    ]
    for scenario, wanted in zip(scenarios, alone, strict=True):
        assert scenario.move is wanted.move
        assert jax.tree.structure(scenario.forces) == jax.tree.structure(wanted.forces)
    assert [dict(env.member.observations)["people"].delay for env in envs] == [(1, 1)] * 3
    names = reinforcement.environment_names(config, scenarios)
    assert names == ["lab, calibrated", "lab, sean2", "lab, orca"]
    with pytest.raises(InputError, match="laws: 'orka' is not one of .*did you mean 'orca'"):
        reinforcement.build(config.replace(laws="calibrated,sean2,orka"))
    with pytest.raises(InputError, match="laws: 'orca' is listed twice"):
        config.replace(laws="orca,orca")
    with pytest.raises(InputError, match="scenarios: 16 do not divide equally among 3 environments with their laws"):
        config.replace(scenarios=16)
    with pytest.raises(InputError, match="curriculum: regret samples .* not of the laws calibrated"):
        config.replace(curriculum="regret")


@pytest.mark.night
def test_a_training_keeps_its_randomization(file, tmp_path):
    """On the floors of a set, under two laws: logged by law, refused with other bounds; its agent needs no file."""
    from sean_jax import learning
    from sean_jax.evaluation import replay_command

    config = training(
        tmp_path / "run", environment=SET, laws="calibrated,orca", randomization=str(file), scenarios=8, pool=8,
        observation_delay=["people=0:2"], steps=8 * 8,
    )  # fmt: skip
    state = reinforcement.train(config)
    line = learning.trainer.read_metrics(tmp_path / "run")[-1]
    returns = [line[f"evaluation in {SET}, {law}"]["return"] for law in ("calibrated", "orca")]
    assert line["evaluation"]["return"] == pytest.approx(np.mean(returns), abs=1e-5)
    for env in state.rows.envs:
        assert set(env.randomization) == set(BOUNDS) and env.randomization["people"].shape == (1, 4)
    file.write_text(FILE.replace("0.25", "0.5"))
    with pytest.raises(InputError, match="randomization"):
        reinforcement.train(config)
    file.unlink()
    saved = learning.policy.read_options(tmp_path / "run")
    assert registry.plan_env(saved).randomization == as_randomization(BOUNDS)
    assert learning.load(tmp_path / "run", sean_jax.make("lab", people=3)).name == "run"
    source = replay_command._of_training(tmp_path / "run", [1, 3])  # of the second law
    assert source.floors[0].member.move is sean_jax.people.pedestrian_models.MODELS["orca"]
    with pytest.raises(InputError, match=f"in {SET}, calibrated and {SET}, orca"):
        replay_command._of_training(tmp_path / "run", [0, 1])
    learning.pack(tmp_path / "run", tmp_path / "packed")
    assert registry.plan_env(learning.policy.read_options(tmp_path / "packed"))["randomization"] == as_randomization(
        BOUNDS
    )
