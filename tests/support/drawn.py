"""A yard, its graph and an episode in it that nobody simulated, and the colors of a figure."""

import io
from typing import Any

import numpy as np
from matplotlib.colors import to_hex
from PIL import Image

from sean_jax.core.data_types import Environment, Obstacles, Trajectory
from sean_jax.world.environment import plain_scenery

STEPS, PEOPLE = 41, 3


def environment() -> Environment:
    nothing: Any = ()
    boxes: Any = Obstacles(
        center=np.array([[0.0, 3.0], [-4.0, -2.0]], np.float32),
        half_extent=np.array([[2.0, 0.5], [0.5, 1.0]], np.float32),
        yaw=np.array([0.0, np.pi / 4], np.float32),
        height=np.array([4.0, 0.8], np.float32),
    )
    floor: Any = np.array([-6.0, -5.0, 6.0, 5.0], np.float32)
    return Environment(floor=floor, obstacles=boxes, obstacle_grid=nothing, scenery=plain_scenery(boxes), name="yard")


def frames() -> Any:
    time = np.linspace(0, 1, STEPS, dtype=np.float32)
    robot = np.stack([-5 + 10 * time, np.zeros(STEPS, np.float32)], -1)
    people = np.stack([np.stack([np.full(STEPS, n - 1.0), -4 + 4 * time], -1) for n in range(PEOPLE)], 1)
    situations = np.zeros((STEPS, 5), bool)
    situations[:20, 4] = True
    situations[20:30, 0] = True
    situations[25:30, 2] = True
    return Trajectory(
        position=robot,
        heading=np.tile([1.0, 0.0], (STEPS, 1)),
        velocity=np.zeros((STEPS, 2)),
        action=np.zeros((STEPS, 2)),
        people=people.astype(np.float32),
        people_velocity=np.zeros((STEPS, PEOPLE, 2)),
        people_heading=np.tile([0.0, 1.0], (STEPS, PEOPLE, 1)),
        group=np.tile(np.array([-1, 0, -1], np.int32), (STEPS, 1)),
        present=np.ones((STEPS, PEOPLE), bool),
        goal=np.tile([5.0, 0.0], (STEPS, 1)),
        situations=situations,
        active=np.arange(STEPS) < 36,
    )  # pyright: ignore[reportArgumentType]


class Graph:
    position = np.array([[-3.0, 0.0], [3.0, 0.0], [0.0, -3.0]])
    radius = np.array([1.0, 0.8, 0.6])
    is_group = np.array([False, False, True])
    flow = np.array([[-1, 3, 0], [4, -1, -1], [0, -1, -1]])  # forward from the first to the second, else medium
    names = ("west", "east", "talk")


def pixels(figure: Any) -> np.ndarray:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=100)
    return np.asarray(Image.open(stream).convert("RGB"))


def shade_at(figure: Any, x: float, y: float) -> str:
    image = pixels(figure)
    across, up = figure.axes[0].transData.transform((x, y)) * 100 / figure.dpi
    return to_hex(image[image.shape[0] - 1 - int(up), int(across)] / 255)
