"""The programs that are timed: the step with restarts, with a depth image each, images alone, and the crowd alone.

Scenarios are reset with keys of their own, and the robot drives in circles: a constant command.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp

from sean_jax import chance, devices, restarts, sensors, social_forces
from sean_jax.base import Array, Scenario, State
from sean_jax.bench import workload
from sean_jax.bench.timing import Program
from sean_jax.geometry import rotate
from sean_jax.scenario import reset
from sean_jax.social_forces import model

STARTS = 1024  # in the pool that ended episodes restart from
CROWD_STEP = 0.05  # s
LOOKING = 0.8, 0.6  # cosine and sine of the angle by which robots turn between two images


def circles(scenario: Scenario, state: State, key: Array) -> Array:
    """The command 0.4 m/s and 0.3 rad/s."""
    return jnp.asarray([0.4, 0.3], float)


def stepping(scenario: Scenario, batch: int, turns: int, image: tuple[int, int] | None = None, number: int = 1):
    """``Program`` of ``turns`` control steps of ``batch`` scenarios on each of ``number`` devices, restarts included.

    With an ``image`` (width, height) every scenario has its depth image made after each step.
    """
    over = devices.mesh(jax.devices()[:number])
    starts = jax.jit(restarts.pool, static_argnums=2)(scenario, chance.key("bench starts", 0), min(STARTS, batch))
    fixed = devices.everywhere(over, (scenario, starts))
    keys = devices.keys(over, chance.key("bench", 0), batch * number)
    states = devices.spread(over, lambda fixed, key: reset(fixed[0], key))(fixed, keys)
    eye = None if image is None else sensors.camera(scenario, "depth", width=image[0], height=image[1])

    def run(fixed: tuple, state: State, shown: Array) -> tuple[State, Array]:
        scenario, starts = fixed

        def turn(carry: tuple[State, Array], _) -> tuple:
            state, shown = carry
            state, _ = restarts.endless(scenario, circles, starts, state, 1, lambda *_: ())
            return (state, shown if eye is None else sensors.depth(scenario, state, eye)), None

        return jax.lax.scan(turn, (state, shown), length=turns)[0]

    size = (1, 1) if image is None else (image[1], image[0])
    blank = devices.spread(over, lambda _, tick: jnp.zeros(size, float))(fixed, states.tick)
    return Program(devices.jitted(over, run, donate=True), (fixed,), (states, blank), batch * number, turns)


def images(scenario: Scenario, name: str, batch: int, width: int, height: int, turns: int = 1) -> Program:
    """``Program`` of ``turns`` images of the camera ``name`` for each of ``batch`` scenarios; the robots look round."""
    camera = sensors.camera(scenario, name, width=width, height=height)
    states = jax.jit(jax.vmap(reset, (None, 0)))(scenario, jax.random.split(chance.key("bench", 0), batch))

    def one(scenario: Scenario, state: State) -> Array:
        if name == "depth":
            return sensors.depth(scenario, state, camera)
        return sensors.render(scenario, state, camera).rgb

    def run(scenario: Scenario, carried: tuple[State, Array]) -> tuple[State, Array]:
        def turn(carry: tuple[State, Array], _) -> tuple:
            states, _ = carry
            cosine, sine = jnp.asarray(LOOKING, float)
            x, y = rotate(states.robot.heading[:, 0], states.robot.heading[:, 1], cosine, sine)
            states = replace(states, robot=replace(states.robot, heading=jnp.stack([x, y], -1)))
            return (states, jax.vmap(one, (None, 0))(scenario, states)), None

        return jax.lax.scan(turn, carried, length=turns)[0]

    shape = jax.eval_shape(jax.vmap(one, (None, 0)), scenario, states)
    blank = jnp.zeros(shape.shape, shape.dtype)
    return Program(jax.jit(run, donate_argnums=1), (scenario,), (states, blank), batch, turns)


def crowd(people: int, batch: int, turns: int, walls: int = 32, preset: str = "helbing1995") -> Program:
    """``Program`` of ``turns`` steps of 0.05 s of ``batch`` crowds of the social forces alone, in a hall with walls.

    Each call begins with the same crowds, or they would meet in the middle of the hall, and the figure would depend on
    how long one measures. Large crowds look for neighbors every second step, as in a control step.
    """
    parameters = social_forces.preset(preset)
    single, nearby, _ = workload.crowd(people, walls)
    many = workload.repeat(single, batch)

    def twice(parameters, nearby, people):
        near = model.neighbors(parameters, people, 2 * CROWD_STEP)
        for _ in range(2):
            people = social_forces.advance(parameters, people, nearby, None, None, CROWD_STEP, near=near)
        return people

    def run(parameters, nearby, many, place):
        def turn(many, _):
            return jax.vmap(twice, (None, None, 0))(parameters, nearby, many), None

        return jax.lax.scan(turn, many, length=turns // 2)[0].position

    return Program(jax.jit(run), (parameters, nearby, many), many.position, batch * people, turns)
