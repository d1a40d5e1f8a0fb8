"""A room, and states of it about every place where a law could have no derivative."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

import sean_jax
from support.scenes import meeting_room

NUMBER, PEOPLE = 1024, 4
GOAL = (3.0, 1.0)
BOX = (0.0, 2.0, 0.5, 0.25)  # middle and half extent
THRESHOLDS = np.array(
    [0.05, 0.1, 0.16, 0.2, 0.25, 0.3, 0.32, 0.35, 0.45, 0.46, 0.5, 0.55, 0.56, 0.6, 0.7, 0.8, 1.0, 1.2, 2.0, 2.4, 3.6]
)
TINY = [0.0, 1e-30, 1e-20, 1e-15, 1e-13, 1e-12, 1.1e-12, 1e-11, 1e-9, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2]
SWEPT = np.unique(
    np.float32([*TINY, *(part for x in (-1e-3, -2e-7, 0.0, 2e-7, 1e-3) for part in THRESHOLDS * (1 + x))])
)
TINY_SPEEDS = np.float32([0.0, 1e-30, 1e-22, 1e-20, 1e-15, 1e-12, 1e-8, 1e-4, 0.1, 0.5])


def met(folder):
    """A room with two boxes, two people who stand in a group and two who walk, and a robot: scenario and state."""
    way = {"start": (-2.0, 0.0), "goal": (*GOAL, 90.0)}
    made = sean_jax.make(meeting_room(folder), task="custom", **way, people=PEOPLE, dynamics="twin")
    return made, jax.jit(sean_jax.reset)(made, jax.random.key(0))


def directions(random, count):
    """(count, 2) unit vectors; half of them exactly along an axis."""
    angle = random.uniform(0, 2 * np.pi, count)
    axis = np.array([(1, 0), (-1, 0), (0, 1), (0, -1)])[random.integers(4, size=count)]
    return np.where((random.random(count) < 0.5)[:, None], axis, np.stack([np.cos(angle), np.sin(angle)], -1))


def gaps(random, count=NUMBER):
    """(count, 2) m, in all directions and of all lengths that matter; the last half at random."""
    swept = random.permutation(np.resize(SWEPT, count))[:, None] * directions(random, count)
    anyhow = random.normal(size=(count, 2)) * random.uniform(0.1, 4, (count, 1))
    return np.where(np.arange(count)[:, None] < count // 2, swept, anyhow).astype(np.float32)


def speeds(random, count=NUMBER):
    """(count, 2) m/s."""
    slow = TINY_SPEEDS[random.integers(len(TINY_SPEEDS), size=count)][:, None] * directions(random, count)
    anyhow = random.normal(size=(count, 2)) * 0.8
    return np.where(np.arange(count)[:, None] < count // 2, slow, anyhow).astype(np.float32)


def states(seed=0):
    """What of a state can be differentiated, (NUMBER, ...) each, by name."""
    random = np.random.default_rng(seed)
    near = np.arange(NUMBER) < NUMBER // 2
    corner, face = np.add(BOX[:2], BOX[2:]), np.array([0.1, BOX[1] - BOX[3]])
    anchors = np.array([(0, 0), (0, 0), (0, 0), corner, face, face, GOAL, (-3, 0), (3, 0), (-5, -4), (0, -2), (-2, -2)])
    spot = np.where(near[:, None], anchors[random.integers(len(anchors), size=NUMBER)], 0.0)
    apart = gaps(random)
    # The robot on the spot, or the somebody at that distance from the spot; somebody at that distance from the robot.
    robot = np.where(near[:, None], spot + (random.random(NUMBER) < 0.3)[:, None] * gaps(random), 0.0)
    robot = np.where(near[:, None], robot, random.uniform((-4.8, -3.8), (4.8, 3.8), (NUMBER, 2)))
    people = random.uniform((-4.8, -3.8), (4.8, 3.8), (NUMBER, PEOPLE, 2))
    people[near, 0] = (robot + apart)[near]
    other = np.where((random.random(NUMBER) < 0.5)[:, None], people[:, 0], robot)
    people[near, 1] = (other + gaps(random)[random.permutation(NUMBER)])[near]
    people[: NUMBER // 16] = people[: NUMBER // 16, :1]  # all at one place
    velocity, desired = (np.stack([speeds(random) for _ in range(PEOPLE)], 1) for _ in range(2))
    heading = np.stack([directions(random, NUMBER) for _ in range(PEOPLE)], 1)
    ahead = directions(random, NUMBER)
    away = np.linalg.norm(apart, axis=1, keepdims=True)
    along = np.where(away > 0, apart / np.where(away > 0, away, 1.0), ahead)
    way = random.integers(4, size=NUMBER)[:, None]
    ahead = np.where(near[:, None] & (way < 2), np.where(way == 0, along, -along), ahead)  # exactly ahead, or behind
    heading[near, 0] = np.where(way == 1, -ahead, ahead)[near]
    towards = near & (random.random(NUMBER) < 0.3)
    velocity[towards, 0] = -along[towards]
    velocity[towards, 1] = velocity[towards, 0]  # the same velocity
    velocity[: NUMBER // 32] = 0.0
    speed = np.where(near, np.resize([0.0, 1e-30, 1e-12, 0.5, -0.5, 0.05], NUMBER), random.uniform(-0.2, 0.5, NUMBER))
    turn = np.where(near, np.resize([0.0, 1e-12, 3.0, -3.0, 1e-3], NUMBER), random.uniform(-2, 2, NUMBER))
    paces = np.resize([1.0, 0.1, 1.3, 0.0, -0.1], (NUMBER, 1))
    preferred = np.where(near[:, None], paces, random.uniform(0.6, 1.4, (NUMBER, 1)))
    parts = {"robot": robot, "ahead": ahead, "speed": speed, "turn": turn, "people": people, "velocity": velocity,
             "heading": heading, "desired": desired, "preferred": np.repeat(preferred, PEOPLE, 1)}  # fmt: skip
    return {name: jnp.asarray(part, jnp.float32) for name, part in parts.items()}


def state_of(room, at):
    """The state of the room with one row of ``states``; every second one has nobody in a group."""
    scenario, state = room
    alone = at["turn"] > 0.5
    people = replace(
        state.pedestrians,
        position=at["people"],
        velocity=at["velocity"],
        heading=at["heading"],
        desired_velocity=at["desired"],
        preferred_speed=at["preferred"],
        group=jnp.where(alone, -1, state.pedestrians.group),
    )
    robot = scenario.robot.place(scenario.robot, at["robot"], at["ahead"])
    return replace(state, pedestrians=people, robot=robot.replace(speed=at["speed"], turn_rate=at["turn"]))


def floats(tree):
    """The leaves of a pytree that have gradients, and a function that puts others in their place."""
    leaves, kind = jax.tree.flatten(tree)
    which = [k for k, leaf in enumerate(leaves) if jnp.issubdtype(jnp.asarray(leaf).dtype, jnp.floating)]

    def put(values):
        new = list(leaves)
        for k, value in zip(which, values, strict=True):
            new[k] = value
        return kind.unflatten(new)

    return [leaves[k] for k in which], put
