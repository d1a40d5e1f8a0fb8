"""A control step of the closed-form twin on a GPU, in one kernel (Pallas, Mosaic GPU).

``LANES`` threads have one scenario: each tests its share of people and obstacles, and all do the rest.
"""

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
    Body,
    Motion,
    Surroundings,
    after_push,
    obstacle_contact,
    person_contact,
    rectangles,
    twin_step,
)

LANES = 8  # a power of two, 32 at most
COORDINATES, WHEELS, BODY, BOX = 5, 2, 5, 6  # numbers of a motion, of targets, of a person and of an obstacle


class _Shape(NamedTuple):
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
    boxes, present = rectangles(surroundings.obstacles), surroundings.present.astype(motion[0].dtype)
    shape = _Shape(steps, len(present), len(boxes[0]))
    numbers = jnp.stack([surroundings.person_radius, *_body(model)])
    people = jnp.stack([*surroundings.position.T, *surroundings.velocity.T, present]) if shape.people else numbers
    walls = jnp.stack(boxes) if shape.obstacles else numbers
    operands = numbers, jnp.concatenate([*motion, targets]), people, walls
    launch = gpu_kernels.batch(partial(_call, shape), 1)
    (result,) = launch(*(operand.reshape(1, -1) for operand in operands))
    return result[0, :COORDINATES], result[0, COORDINATES:]


def _body(model: RobotModel) -> Body:
    return Body(*(jnp.asarray(getattr(model, name), float) for name in Body._fields))


def _call(shape: _Shape, *operands: Array, interpret: bool = False) -> tuple[Array, ...]:
    """The kernel, for operands of ``kernels.Call``."""
    scenarios = max(operand.shape[0] for operand in operands)
    out = (jax.ShapeDtypeStruct((scenarios, 2 * COORDINATES), operands[0].dtype),)
    lanes = 1 if interpret else LANES
    kernel = partial(_kernel, shape, lanes)
    return gpu_kernels.launch_threads(kernel, "robot", scenarios * lanes, out, *operands, interpret=interpret)


def _kernel(shape: _Shape, lanes: int, number: Any, *references: Any) -> None:
    """One of the threads of a scenario."""
    scenario, lane, result = jax.lax.div(number, np.int32(lanes)), number & (lanes - 1), references[-1]

    def read(reference: Any, column: Any) -> Any:
        return reference[gpu_kernels.row(reference, scenario, result.shape[0]), column]

    numbers, start, people, walls = (partial(read, reference) for reference in references[:-1])
    person_radius = numbers(0)
    model = Body(*(numbers(1 + i) for i in range(len(Body._fields))))
    motion = tuple(start(i) for i in range(2 * COORDINATES))
    targets = tuple(start(2 * COORDINATES + i) for i in range(WHEELS))

    def person(index: Any) -> tuple:
        *body, present = (people(row * shape.people + index) for row in range(BODY))
        return *body, present != 0.0

    def obstacle(index: Any) -> tuple:
        return tuple(walls(row * shape.obstacles + index) for row in range(BOX))

    def touch(time_left: Any, position: tuple, vx: Any, vy: Any) -> tuple:
        def by_person(index: Any) -> tuple:
            contact = gpu_kernels.scalars(person_contact)
            return contact(model, person_radius, time_left, *position[:2], person(index))

        def by_obstacle(index: Any) -> tuple:
            return gpu_kernels.scalars(obstacle_contact)(model, *position[:2], obstacle(index))

        for contact, count, times in ((by_person, shape.people, 1), (by_obstacle, shape.obstacles, CORNER)):
            for _ in range(times if count else 0):
                vx, vy = _strongest(contact, count, lane, lanes, vx, vy)
        return vx, vy

    def step(index: Any, motion: tuple) -> tuple:
        time_left = model.time_step * (shape.steps - index).astype(person_radius.dtype)
        position, velocity = motion[:COORDINATES], motion[COORDINATES:]
        position, velocity = twin_step(
            model, partial(touch, time_left), position, velocity, targets, gpu_kernels.scalars
        )
        return *position, *velocity

    motion = jax.lax.fori_loop(0, shape.steps, step, motion)
    for column, value in enumerate(motion):
        result[scenario, column] = value


def _strongest(contact: Any, count: int, lane: Any, lanes: int, vx: Any, vy: Any) -> tuple:
    """The velocity after the most violated contact was enforced; of several the first."""

    def better(best: tuple, other: tuple) -> tuple:
        wins = (other[0] > best[0]) | ((other[0] == best[0]) & (other[1] < best[1]))
        chosen = (jnp.where(wins, new, old) for new, old in zip(other[:-1], best[:-1], strict=True))
        return *chosen, jnp.minimum(best[-1], other[-1])  # the bound is that of all

    def turn(k: Any, best: tuple) -> tuple:
        index = k * lanes + lane
        nx, ny, allowed, bound = contact(jnp.minimum(index, count - 1))
        return better(best, (-(vx * nx + vy * ny) - allowed, index, nx, ny, bound))

    number = vx.dtype.type
    nothing = (number(0.0), np.int32(-1), number(0.0), number(0.0), number(UNBOUNDED))  # no contact is violated
    best = jax.lax.fori_loop(0, -(-count // lanes), turn, nothing)
    distance = 1
    while distance < lanes:
        best = better(best, tuple(gpu_kernels.exchange(value, distance) for value in best))
        distance *= 2
    excess, _, nx, ny, bound = best
    return gpu_kernels.scalars(after_push)(vx, vy, excess, nx, ny, bound)
