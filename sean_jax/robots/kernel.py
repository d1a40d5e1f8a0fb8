"""A control step of the closed-form twin on a GPU, in one kernel (Pallas, Mosaic GPU).

``LANES`` threads have one scenario: each tests its share of people and obstacles, and all do the rest.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax.core import gpu_kernels
from sean_jax.core.data_types import Array, RobotModel
from sean_jax.robots.dynamics import (
    CORNER,
    UNBOUNDED,
    Motion,
    RobotBody,
    Surroundings,
    after_push,
    obstacle_contact,
    person_contact,
    rectangles,
    twin_step,
)

LANES = 8  # a power of two, 32 at most
COORDINATES = 5  # numbers of a position, and as many of a velocity
WHEELS = 2  # numbers of targets
BODY = 5  # numbers of a person
BOX = 6  # numbers of an obstacle


class RobotKernelShape(NamedTuple):
    """Static parameters of a kernel."""

    steps: int
    people: int
    obstacles: int


def supports(model: RobotModel, surroundings: Surroundings, motion: Motion) -> bool:
    """Whether the kernel can move the robot: in single precision."""
    floats = (leaf for leaf in jax.tree.leaves((_body(model), surroundings, motion)) if leaf.dtype != bool)
    return gpu_kernels.available() and all(leaf.dtype == np.float32 for leaf in floats)


def simulate(steps: int, model: RobotModel, surroundings: Surroundings, motion: Motion, targets: Array) -> Motion:
    """The motion after that many physics steps."""
    boxes = rectangles(surroundings.obstacles)
    present = surroundings.present.astype(motion[0].dtype)
    shape = RobotKernelShape(steps, len(present), len(boxes[0]))
    numbers = jnp.stack([surroundings.person_radius, *_body(model)])

    # Operands have at least one row, of which nothing is read without people or obstacles.
    people = numbers
    obstacles = numbers
    if shape.people:
        people = jnp.stack([*surroundings.position.T, *surroundings.velocity.T, present])
    if shape.obstacles:
        obstacles = jnp.stack(boxes)
    operands = numbers, jnp.concatenate([*motion, targets]), people, obstacles
    launch = gpu_kernels.batch(partial(_call, shape), 1)
    (result,) = launch(*(operand.reshape(1, -1) for operand in operands))
    return result[0, :COORDINATES], result[0, COORDINATES:]


def _body(model: RobotModel) -> RobotBody:
    return RobotBody(*(jnp.asarray(getattr(model, name), float) for name in RobotBody._fields))


def _call(shape: RobotKernelShape, *operands: Array, interpret: bool = False) -> tuple[Array, ...]:
    """The kernel, for operands of ``gpu_kernels.Call``."""
    scenarios = max(operand.shape[0] for operand in operands)
    out = (jax.ShapeDtypeStruct((scenarios, 2 * COORDINATES), operands[0].dtype),)
    lanes = 1 if interpret else LANES
    kernel = partial(_kernel, shape, lanes)
    return gpu_kernels.launch_threads(kernel, "robot", scenarios * lanes, out, *operands, interpret=interpret)


class Thread(NamedTuple):
    """One of the threads of a scenario, and what it reads."""

    shape: RobotKernelShape
    lane: Any
    lanes: int
    model: RobotBody
    person_radius: Any
    people: Callable[[Any], Any]  # column -> number
    obstacles: Callable[[Any], Any]


def _kernel(shape: RobotKernelShape, lanes: int, number: Any, *references: Any) -> None:
    """One of the threads of a scenario."""
    scenario = jax.lax.div(number, np.int32(lanes))
    lane = number & (lanes - 1)
    result = references[-1]

    def read(reference: Any, column: Any) -> Any:
        return reference[gpu_kernels.row(reference, scenario, result.shape[0]), column]

    numbers, start, people, obstacles = (partial(read, reference) for reference in references[:-1])
    person_radius = numbers(0)
    model = RobotBody(*(numbers(1 + i) for i in range(len(RobotBody._fields))))
    thread = Thread(shape, lane, lanes, model, person_radius, people, obstacles)
    motion = tuple(start(i) for i in range(2 * COORDINATES))
    targets = tuple(start(2 * COORDINATES + i) for i in range(WHEELS))

    def step(index: Any, motion: tuple) -> tuple:
        time_left = model.time_step * (shape.steps - index).astype(person_radius.dtype)
        touch = partial(_touch, thread, time_left)
        position = motion[:COORDINATES]
        velocity = motion[COORDINATES:]
        position, velocity = twin_step(model, touch, position, velocity, targets, gpu_kernels.scalars)
        return *position, *velocity

    motion = jax.lax.fori_loop(0, shape.steps, step, motion)
    for column, value in enumerate(motion):
        result[scenario, column] = value


def _touch(thread: Thread, time_left: Any, position: tuple, vx: Any, vy: Any) -> tuple:
    """The velocity that contacts leave, as ``dynamics.touching``."""
    shape = thread.shape
    if shape.people:
        contact = partial(_person_contact, thread, time_left, position)
        vx, vy = _enforce_strongest(contact, shape.people, thread, vx, vy)
    if shape.obstacles:
        contact = partial(_obstacle_contact, thread, position)
        for _ in range(CORNER):
            vx, vy = _enforce_strongest(contact, shape.obstacles, thread, vx, vy)
    return vx, vy


def _person_contact(thread: Thread, time_left: Any, position: tuple, index: Any) -> tuple:
    *body, present = (thread.people(row * thread.shape.people + index) for row in range(BODY))
    contact = gpu_kernels.scalars(person_contact)
    return contact(thread.model, thread.person_radius, time_left, *position[:2], (*body, present != 0.0))


def _obstacle_contact(thread: Thread, position: tuple, index: Any) -> tuple:
    rectangle = tuple(thread.obstacles(row * thread.shape.obstacles + index) for row in range(BOX))
    return gpu_kernels.scalars(obstacle_contact)(thread.model, *position[:2], rectangle)


class Violation(NamedTuple):
    """The most violated contact of those that were tested."""

    excess: Any  # m/s, of the approach speed
    index: Any
    nx: Any  # normal
    ny: Any
    bound: Any  # m/s, of all contacts


def _enforce_strongest(contact: Callable, count: int, thread: Thread, vx: Any, vy: Any) -> tuple:
    """The velocity after the most violated contact was enforced; of several the first."""

    def test(turn: Any, worst: Violation) -> Violation:
        index = turn * thread.lanes + thread.lane
        nx, ny, allowed, bound = contact(jnp.minimum(index, count - 1))
        return _worse(worst, Violation(-(vx * nx + vy * ny) - allowed, index, nx, ny, bound))

    number = vx.dtype.type
    none = Violation(number(0.0), np.int32(-1), number(0.0), number(0.0), number(UNBOUNDED))
    worst = jax.lax.fori_loop(0, -(-count // thread.lanes), test, none)

    # All threads of a scenario exchange theirs.
    distance = 1
    while distance < thread.lanes:
        worst = _worse(worst, Violation(*(gpu_kernels.exchange(value, distance) for value in worst)))
        distance *= 2
    return gpu_kernels.scalars(after_push)(vx, vy, worst.excess, worst.nx, worst.ny, worst.bound)


def _worse(first: Violation, second: Violation) -> Violation:
    """The more violated of two contacts, of equal ones that of the lower index; with the lower bound of both."""
    same = second.excess == first.excess
    wins = (second.excess > first.excess) | (same & (second.index < first.index))
    excess, index, nx, ny = (jnp.where(wins, new, old) for new, old in zip(second[:-1], first[:-1], strict=True))
    return Violation(excess, index, nx, ny, jnp.minimum(first.bound, second.bound))
