"""The timed programs: the step with restarts, the step with a depth image, images alone, and the crowd alone.

Scenarios are on the floors of a stack. Each is reset with its own key. The robot gets a constant command and drives in
circles.
"""

import dataclasses
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from sean_jax import sensors, social_forces
from sean_jax.cli.bench import workload
from sean_jax.config import DEFAULT_FORCES
from sean_jax.core import devices, random_streams
from sean_jax.core.data_types import Array, Scenario, State
from sean_jax.core.geometry import rotate
from sean_jax.simulation import episodes
from sean_jax.simulation.scenario import reset
from sean_jax.simulation.scenario_stack import Stack
from sean_jax.social_forces import model

STARTS = 1024  # in the pool that ended episodes restart from
CROWD_STEP = 0.05  # s
LOOKING = 0.8, 0.6  # cosine and sine of the angle by which robots turn between two images


@dataclasses.dataclass(frozen=True)
class Program:
    """A jitted function ``run(*fixed, carried) -> carried`` that computes ``count`` units ``turns`` times in a row."""

    run: Callable
    fixed: tuple
    carried: Any
    count: int
    turns: int


def measure(program: Program, repeats: int, seconds: float) -> dict[str, Any]:
    """Compile a program and time it ``repeats`` times for about so many seconds, after a warm-up.

    Returns:
        ``per_second``, ``microseconds`` and ``compile_seconds`` as of a row of ``sean bench``; and ``bytes``, the state
        and the temporary memory of the whole batch (NaN if the compiler does not report it).
    """
    began = time.perf_counter()
    compiled = program.run.lower(*program.fixed, program.carried).compile()
    compiling = time.perf_counter() - began

    # Donated arguments count once: the results lie where the arguments were.
    memory = compiled.memory_analysis()
    arrays = [leaf for leaf in jax.tree.leaves(program.carried) if hasattr(leaf, "itemsize")]
    size = sum(leaf.size * leaf.dtype.itemsize for leaf in arrays)
    used = memory.temp_size_in_bytes + size if memory else float("nan")

    # One call warms up, and one tells how many calls fill the time.
    carried = jax.block_until_ready(compiled(*program.fixed, program.carried))
    began = time.perf_counter()
    carried = jax.block_until_ready(compiled(*program.fixed, carried))
    one_call = max(time.perf_counter() - began, 1e-6)
    calls = max(1, round(seconds / one_call))

    spent = []
    for _ in range(repeats):
        began = time.perf_counter()
        for _ in range(calls):
            carried = compiled(*program.fixed, carried)
        jax.block_until_ready(carried)
        spent.append((time.perf_counter() - began) / calls / program.turns)
    turn_seconds = float(np.median(spent))
    return {
        "per_second": program.count / turn_seconds,
        "microseconds": 1e6 * turn_seconds,
        "compile_seconds": compiling,
        "bytes": used,
    }


def circles(scenario: Scenario, state: State, key: Array) -> Array:
    """A policy with the constant command 0.4 m/s, 0.3 rad/s."""
    return jnp.asarray([0.4, 0.3], float)


def stepping(
    stack: Stack[Scenario], batch: int, turns: int, image: tuple[int, int] | None = None, number: int = 1
) -> Program:
    """Control steps with restarts on ``number`` devices; the unit is one step of one scenario.

    Each device has ``batch`` scenarios, of which each floor of the stack has as many. ``image`` is the width and height
    [px] of a depth image of each scenario after each step.
    """
    # Floors take turns of equal length, so each has as many scenarios on every device.
    mesh = devices.mesh(jax.devices()[:number])
    stack = replace(stack, names=(), turn=batch // stack.size)

    # Scenarios restart from a pool of starts on their floor.
    size = max(1, min(STARTS, batch) // stack.size)
    draw = jax.jit(lambda stack, key: stack.over_members(lambda one: episodes.reset_pool(one, key, size))())
    starts = draw(stack, random_streams.key("bench starts", 0))
    stack = devices.replicate(mesh, stack.paired(starts))

    # Scenarios differ in their keys, or ended episodes would restart all at once.
    keys = devices.keys(mesh, random_streams.key("bench", 0), batch * number)
    states = _on_floors(mesh, lambda fixed, key: reset(fixed[0], key))(stack, (keys,))

    # The camera is a part of the robot, which is the same on all floors.
    scenario: Scenario = stack.member[0]  # pyright: ignore
    camera = None if image is None else sensors.camera(scenario, "depth", width=image[0], height=image[1])

    # The image is carried along, or the compiler would drop the rendering, which nothing else reads.
    def run(fixed: tuple, state: State, last: Array) -> tuple[State, Array]:
        scenario, starts = fixed

        def turn(carry: tuple[State, Array], _) -> tuple:
            state, last = carry
            state, _ = episodes.rollout_autoreset(scenario, circles, starts, state, 1, lambda *_: ())
            return (state, last if camera is None else sensors.depth(scenario, state, camera)), None

        return jax.lax.scan(turn, (state, last), length=turns)[0]

    # The carried arrays are split over the devices like the states, also where no image is drawn.
    size_of_image = (1, 1) if image is None else (image[1], image[0])
    blank = _on_floors(mesh, lambda _, tick: jnp.zeros(size_of_image, float))(stack, (states.tick,))
    return Program(_on_floors(mesh, run, donate=True), (stack,), (states, blank), batch * number, turns)


def _on_floors(mesh: Mesh, function: Callable, donate: bool = False) -> Any:
    """``jit`` of a stack's ``vmap``, as ``devices.shard_jit`` of a function of one scenario."""
    split = NamedSharding(mesh, PartitionSpec(devices.AXIS))
    whole = NamedSharding(mesh, PartitionSpec())

    def on_all(stack: Stack, rows: tuple) -> Any:
        return stack.vmap(function)(*rows)

    donated = (1,) if donate else ()
    return jax.jit(on_all, in_shardings=(whole, split), out_shardings=split, donate_argnums=donated)


def images(stack: Stack[Scenario], name: str, batch: int, width: int, height: int, turns: int = 1) -> Program:
    """Images of ``width`` x ``height`` [px] alone; the unit is one image. Robots turn between two images.

    The camera "depth" gives depth images, any other color images. Each floor of the stack has as many of the batch.
    """
    scenario = stack.member
    stack = replace(stack, names=())
    camera = sensors.camera(scenario, name, width=width, height=height)
    keys = jax.random.split(random_streams.key("bench", 0), batch)
    states = jax.jit(lambda stack, keys: stack.vmap(reset)(keys))(stack, keys)

    def image(scenario: Scenario, state: State) -> Array:
        if name == "depth":
            return sensors.depth(scenario, state, camera)
        return sensors.render(scenario, state, camera).rgb

    def run(stack: Stack[Scenario], carried: tuple[State, Array]) -> tuple[State, Array]:
        def turn(carry: tuple[State, Array], _) -> tuple:
            states, _ = carry
            cosine, sine = jnp.asarray(LOOKING, float)
            x, y = rotate(states.robot.heading[:, 0], states.robot.heading[:, 1], cosine, sine)
            states = replace(states, robot=replace(states.robot, heading=jnp.stack([x, y], -1)))
            return (states, stack.vmap(image)(states)), None

        return jax.lax.scan(turn, carried, length=turns)[0]

    shape = jax.eval_shape(lambda stack, states: stack.vmap(image)(states), stack, states)
    blank = jnp.zeros(shape.shape, shape.dtype)
    return Program(jax.jit(run, donate_argnums=1), (stack,), (states, blank), batch, turns)


def crowd(people: int, batch: int, turns: int, walls: int = 32, preset: str = DEFAULT_FORCES) -> Program:
    """Steps of 0.05 s of the social forces alone, in a hall with 0 or at least 4 walls; the unit is a person's step.

    Each call begins with the same crowds. Otherwise they would meet in the middle of the hall, and the result would
    depend on the length of the measurement. Large crowds look for neighbors every second step, as in a control step.
    """
    parameters = social_forces.preset(preset)
    single, grid, _ = workload.crowd(people, walls)
    many = workload.repeat(single, batch)

    def twice(parameters, grid, people):
        near = model.neighbors(parameters, people, 2 * CROWD_STEP)
        for _ in range(2):
            people = social_forces.integrate(parameters, people, grid, None, None, CROWD_STEP, near=near)
        return people

    def run(parameters, grid, many, place):
        def turn(many, _):
            return jax.vmap(twice, (None, None, 0))(parameters, grid, many), None

        return jax.lax.scan(turn, many, length=turns // 2)[0].position

    return Program(jax.jit(run), (parameters, grid, many), many.position, batch * people, turns)
