"""Gradients of whole rollouts: finite, and equal to central differences in float64, through MJX as well."""

import operator

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import robots
from sean_jax.policies import go_to_goal
from support.float64 import in_double

pytestmark = pytest.mark.slow
STEPS = 40
STEP = 1e-5  # of the central differences


@pytest.fixture(scope="module")
def double():
    """A scenario with eight people and a state in which two of them come towards the robot, in float64."""
    scenario = sean_jax.make(people=8, dynamics="twin", metrics="none")
    state = jax.jit(sean_jax.reset)(scenario, jax.random.key(3))
    robot = state.robot.position
    ahead = state.task.goal - robot
    ahead = ahead / jnp.linalg.norm(ahead)
    side = jnp.stack([-ahead[1], ahead[0]])
    people = state.pedestrians
    spots = jnp.stack([robot + 1.5 * ahead + 0.12 * side, robot + 2.2 * ahead - 0.25 * side])
    people = people.replace(
        position=people.position.at[6:].set(spots),
        velocity=people.velocity.at[6:].set(-0.8 * ahead),
        group=people.group.at[6:].set(-1),
    )
    memory = state.memory
    onward = robot - 6.0 * ahead
    memory = memory._replace(
        stay=memory.stay.at[6:].set(0), seat=memory.seat.at[6:].set(-1), target=memory.target.at[6:].set(onward)
    )
    facing = scenario.robot.place(scenario.robot, robot, ahead)
    state = state.replace(pedestrians=people, memory=memory, robot=facing)
    with jax.enable_x64(True), jax.numpy_dtype_promotion("standard"):
        yield in_double(scenario), in_double(state)


def distance_left(scenario, state, policy, **options):
    """Distance [m] of the robot from its goal after the rollout."""
    last, _ = sean_jax.simulate(scenario, policy, state, STEPS, **options)
    gap = last.robot.position - state.task.goal
    return jnp.sqrt((gap * gap).sum())


def agree(value, gradient, at, directions):
    """Derivatives along some directions, by the gradient and by central differences."""
    for direction in directions:
        by_gradient = float((gradient * direction).sum())
        by_difference = float(value(at + STEP * direction) - value(at - STEP * direction)) / (2 * STEP)
        assert by_gradient == pytest.approx(by_difference, rel=1e-3, abs=1e-7), (by_gradient, by_difference)


@pytest.mark.night
def test_with_respect_to_actions(double):
    """Of a robot in MJX."""
    scenario, state = double
    robot = in_double(robots.load("kuri", "mjx"))
    scenario = scenario.replace(robot=robot)
    state = state.replace(robot=robot.place(robot, state.robot.position, state.robot.heading))

    def value(actions):
        def policy(scenario, state, key):
            return actions[state.tick]

        return distance_left(scenario, state, policy)

    actions = jnp.asarray(np.tile([0.35, 0.2], (STEPS, 1)) + 0.02 * np.sin(np.arange(2 * STEPS)).reshape(-1, 2))
    run = jax.jit(value)
    gradient = jax.jit(jax.grad(value))(actions)
    assert np.isfinite(np.asarray(gradient)).all() and np.abs(np.asarray(gradient)).max() > 1e-3
    random = np.random.default_rng(0)
    agree(run, gradient, actions, [jnp.asarray(random.normal(size=actions.shape)) for _ in range(4)])


def test_with_respect_to_force_parameters(double):
    scenario, state = double
    names = ("repulsion.strength", "repulsion.range", "walking.relaxation_time", "evasion.strength")
    at = jnp.stack([operator.attrgetter(name)(scenario.forces) for name in names])

    def value(constants):
        forces = scenario.forces.tree_replace(dict(zip(names, constants, strict=True)))
        return distance_left(scenario.replace(forces=forces), state, go_to_goal)

    gradient = jax.jit(jax.grad(value))(at)
    assert np.isfinite(np.asarray(gradient)).all() and np.abs(np.asarray(gradient)).max() > 1e-4
    agree(jax.jit(value), gradient, at, list(jnp.eye(len(names))))


@pytest.mark.night
def test_forward_mode_equals_reverse_mode_in_blocks(double):
    """Through people, graph and robot."""
    scenario, state = double

    def value(constants, every=None):
        forces = scenario.forces.tree_replace({"repulsion.strength": constants[0], "walls.range": constants[1]})
        return distance_left(scenario.replace(forces=forces), state, go_to_goal, checkpoint_every=every)

    at = jnp.stack([scenario.forces.repulsion.strength, scenario.forces.walls.range])
    forward, reverse = jax.jit(lambda at: (jax.jacfwd(value)(at), jax.grad(value)(at, 16)))(at)
    np.testing.assert_allclose(forward, reverse, rtol=1e-8)
    assert np.abs(np.asarray(forward)).min() > 1e-6
