"""Draws docs/situations.svg: one example of each situation beyond the paper's five; python docs/situations.py.

The classifiers judge every example first, so the figure shows what the code does.
"""

from pathlib import Path

import jax
import matplotlib
import matplotlib.pyplot as plt
import numpy as np

from sean_jax import classifiers
from sean_jax.base import Moment, Obstacles, Pedestrians

RIGHT, UP, LEFT = (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0)
ROBOT, PERSON, WALL = "#f58a07", "#4477aa", "#8d99b3"
# name: robot's heading, people as (position, velocity), boxes as (center, half extent)
EXAMPLES = {
    "overtaking": (RIGHT, [((1.5, 0.4), (0.25, 0.0))], []),
    "frontal_approach": (RIGHT, [((2.8, 0.4), (-0.5, 0.0))], []),
    "following": (RIGHT, [((1.5, 0.2), (0.5, 0.0))], []),
    "crowded": (RIGHT, [((1.9 * np.cos(a), 1.9 * np.sin(a)), (0.0, 0.3)) for a in np.arange(6) * np.pi / 3 + 0.5], []),
    "blind_corner": (UP, [((-2.4, 3.5), (0.5, 0.0))], [((-2.4, 1.7), (1.6, 1.3))]),
    "narrow_passage": (RIGHT, [((2.0, 0.0), (0.0, 0.0))], [((1.0, 1.65), (0.15, 1.0)), ((1.0, -1.65), (0.15, 1.0))]),
}


def moment(heading, people, boxes) -> Moment:
    """The example as arrays: the robot at the origin, 0.5 m/s fast."""
    places, velocities = (np.array(part, np.float32) for part in zip(*people, strict=True))
    number = len(people)
    rows = np.array([*boxes, *[((90, 90), (1, 1))] * (2 - len(boxes))], np.float32)  # spare ones far away
    robot = np.array(heading, np.float32)
    speeds = np.linalg.norm(velocities, axis=1, keepdims=True)
    persons = Pedestrians(
        position=places,
        velocity=velocities,
        heading=velocities / np.maximum(speeds, np.float32(1e-6)),
        desired_velocity=velocities,
        group=np.full(number, -1, np.int32),
        walking_group=np.full(number, -1, np.int32),
        present=np.ones(number, bool),
        preferred_speed=np.ones(number, np.float32),
        robot_distance=np.zeros(number, np.float32),
    )
    nowhere, none = np.full(2, 50.0, np.float32), np.int32(-1)
    here = Moment(
        people=persons,
        position=np.zeros(2, np.float32),
        heading=robot,
        velocity=np.float32(0.5) * robot,
        start=nowhere,
        goal=nowhere,
        start_group=none,
        goal_group=none,
        geodesic=np.float32(1),
        situations=np.zeros(0, bool),
        tick=np.int32(0),
        robot_radius=np.float32(0.16),
        person_radius=np.float32(0.2),
        time_step=0.1,
        obstacles=Obstacles(rows[:, 0], rows[:, 1], np.zeros(2, np.float32), np.full(2, 2.0, np.float32)),
    )
    return jax.device_put(here)


def draw(axes, name, heading, people, boxes) -> None:
    """One panel, metres."""
    for center, half in boxes:
        corner = np.subtract(center, half)
        axes.add_patch(plt.Rectangle((corner[0], corner[1]), 2 * half[0], 2 * half[1], color=WALL, lw=0))
    if name == "crowded":
        axes.add_patch(plt.Circle((0, 0), 2.4, fill=False, color=WALL, ls=":"))
    for place, velocity, color, radius in [((0, 0), np.multiply(heading, 0.5), ROBOT, 0.16)] + [
        (place, velocity, PERSON, 0.2) for place, velocity in people
    ]:
        axes.add_patch(plt.Circle(place, radius, color=color, lw=0))
        if np.any(velocity):
            axes.annotate("", np.add(place, np.multiply(velocity, 2.2)), place, arrowprops={"arrowstyle": "->"})
    axes.set(xlim=(-2.6, 3.2) if name != "blind_corner" else (-4.2, 1.6), ylim=(-2.6, 2.6), aspect="equal")
    if name == "blind_corner":
        axes.set_ylim(-0.7, 4.5)
    axes.set_title(name.replace("_", " "), fontsize=9)
    axes.set(xticks=[], yticks=[])


def main() -> None:
    """Check the examples and draw them."""
    matplotlib.use("svg")
    matplotlib.rcParams.update({"svg.hashsalt": "situations", "svg.fonttype": "none"})
    figure, panels = plt.subplots(2, 3, figsize=(7.2, 4.6), layout="constrained")
    values = classifiers.thresholds()
    for axes, (name, example) in zip(panels.flat, EXAMPLES.items(), strict=True):
        here = moment(*example)
        situations = {other for other, law in classifiers.MORE_SITUATIONS.items() if bool(jax.jit(law)(here, values))}
        if situations != {name}:
            raise SystemExit(f"{name}: the classifiers give {sorted(situations)}.")
        draw(axes, name, *example)
    figure.savefig(Path(__file__).with_suffix(".svg"), metadata={"Date": None})


if __name__ == "__main__":
    main()
