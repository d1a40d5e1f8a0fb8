"""Draws one example of each situation: docs/situations-paper.svg has the paper's five, and docs/situations.svg the
others; python docs/situations.py.

The classifiers judge every example first, so the figures show what the code does.
"""

from pathlib import Path

import jax
import matplotlib
import matplotlib.pyplot as plt
import numpy as np

from sean_jax import classifiers
from sean_jax.core.data_types import Obstacles, Pedestrians, Snapshot

RIGHT, UP, LEFT = (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0)
ROBOT, PERSON, WALL = "#f58a07", "#4477aa", "#8d99b3"
GROUP = 1.0  # m, from its center to the members
DOWN = (0.0, -1.0)
ARROW = 2.2  # m, for 1 m/s
# name: robot's heading, people as (position, velocity) or (position, velocity, heading), boxes as (center, half extent)
PAPER = {
    "cross_path": (RIGHT, [((1.7, -1.0), (0.0, 1.5))], []),
    "down_path": (RIGHT, [((1.2, 0.7), (0.7, 0.0))], []),
    "join_group": (RIGHT, [], []),  # a group whose open place is the goal
    "leave_group": (RIGHT, [], []),  # ... or was the start
    "empty": (RIGHT, [((2.5, 1.0), (-0.1, 0.6))], []),
}
CENTER = {"join_group": (1.9, 0.0), "leave_group": (-1.4, 0.0)}  # m, of the group
EXAMPLES = {
    "overtaking": (RIGHT, [((1.5, 0.4), (0.25, 0.0))], []),
    "frontal_approach": (RIGHT, [((2.8, 0.4), (-0.5, 0.0))], []),
    "following": (RIGHT, [((1.5, 0.2), (0.5, 0.0))], []),
    "crowded": (RIGHT, [((1.9 * np.cos(a), 1.9 * np.sin(a)), (0.0, 0.3)) for a in np.arange(6) * np.pi / 3 + 0.2], []),
    "blind_corner": (UP, [((-2.4, 3.5), (0.5, 0.0))], [((-2.4, 1.7), (1.6, 1.3))]),
    "narrow_passage": (RIGHT, [((2.0, 0.0), (0.0, 0.0))], [((1.0, 1.65), (0.15, 1.0)), ((1.0, -1.65), (0.15, 1.0))]),
    "occlusion": (RIGHT, [((0.2, 1.9), (0.0, 0.0))], [((0.0, 1.0), (1.3, 0.15))]),
    "activity_space": (RIGHT, [((1.0, 1.1), (0.0, 0.0), DOWN)], [((1.0, -1.2), (1.1, 0.3))]),
    "collision_course": (RIGHT, [((1.2, -1.2), (0.0, 0.5))], []),
    "hurrying": (RIGHT, [((1.5, -2.2), (-1.2, 1.6))], []),
}


def members(center) -> list:
    """Three people around a center who leave the place towards the robot open, which is where it goes or comes from."""
    angles = np.pi * (0.5 * np.array([-1, 0, 1]) + (center[0] < 0))
    return [((center[0] + GROUP * np.cos(a), center[1] + GROUP * np.sin(a)), (0.0, 0.0)) for a in angles]


def snapshot(heading, people, boxes, center=None) -> Snapshot:
    """The example as arrays: the robot at the origin, 0.5 m/s fast; with a group around a center."""
    grouped = [] if center is None else members(center)
    heads = [each[2] if len(each) > 2 else np.zeros(2) for each in people]
    heads += [np.subtract(center, place) for place, _ in grouped]
    people = [each[:2] for each in [*people, *grouped]]
    places, velocities = (np.array(part, np.float32) for part in zip(*people, strict=True))
    number = len(people)
    rows = np.array([*boxes, *[((90, 90), (1, 1))] * (2 - len(boxes))], np.float32)  # spare ones far away
    robot = np.array(heading, np.float32)
    speeds = np.linalg.norm(velocities, axis=1, keepdims=True)
    persons = Pedestrians(
        position=places,
        velocity=velocities,
        heading=np.where(speeds > 0, velocities, np.array(heads, np.float32)) / np.maximum(speeds, np.float32(1e-6)),
        desired_velocity=velocities,
        group=np.array([-1] * (number - len(grouped)) + [0] * len(grouped), np.int32),
        walking_group=np.full(number, -1, np.int32),
        present=np.ones(number, bool),
        preferred_speed=np.ones(number, np.float32),
        robot_distance=np.zeros(number, np.float32),
    )
    nowhere, none = np.full(2, 50.0, np.float32), np.int32(-1)
    opening = None if center is None else np.array(center, np.float32) * np.float32(1 - GROUP / abs(center[0]))
    joins, leaves = (center is not None and side * center[0] > 0 for side in (1, -1))
    here = Snapshot(
        people=persons,
        position=np.zeros(2, np.float32),
        heading=robot,
        velocity=np.float32(0.5) * robot,
        start=opening if leaves else nowhere,
        goal=opening if joins else nowhere,
        start_group=np.int32(0) if leaves else none,
        goal_group=np.int32(0) if joins else none,
        geodesic=np.float32(1),
        situations=np.zeros(0, bool),
        tick=np.int32(0),
        robot_radius=np.float32(0.16),
        person_radius=np.float32(0.2),
        time_step=0.1,
        obstacles=Obstacles(rows[:, 0], rows[:, 1], np.zeros(2, np.float32), np.full(2, 2.0, np.float32)),
    )
    return jax.device_put(here)


def draw(axes, name, heading, people, boxes, center=None) -> None:
    """One panel, metres."""
    for middle, half in boxes:
        corner = np.subtract(middle, half)
        axes.add_patch(plt.Rectangle((corner[0], corner[1]), 2 * half[0], 2 * half[1], color=WALL, lw=0))
    if center is not None:
        people = [*people, *members(center)]
        axes.add_patch(plt.Circle(center, GROUP, fill=False, color=PERSON, ls="--"))
        opening = np.multiply(center, 1 - GROUP / abs(center[0]))
        axes.plot(*opening, "x", color=ROBOT)
    for place, _, *facing in people:
        for look in facing:  # where somebody looks who stands
            axes.plot(*np.add([place, place], np.multiply([(0, 0), look], 2.0)).T, ":", color=PERSON)
    if name in ("crowded", "occlusion") or name in PAPER:
        axes.add_patch(plt.Circle((0, 0), 2.4, fill=False, color=WALL, ls=":"))
    for place, velocity, color, radius in [((0, 0), np.multiply(heading, 0.5), ROBOT, 0.16)] + [
        (place, velocity, PERSON, 0.2) for place, velocity, *_ in people
    ]:
        axes.add_patch(plt.Circle(place, radius, color=color, lw=0))
        if np.any(velocity):
            axes.annotate("", np.add(place, np.multiply(velocity, ARROW)), place, arrowprops={"arrowstyle": "->"})
    axes.set(xlim=(-2.6, 3.2) if name != "blind_corner" else (-4.2, 1.6), ylim=(-2.6, 2.6), aspect="equal")
    if name == "blind_corner":
        axes.set_ylim(-0.7, 4.5)
    axes.set_title(name.replace("_", " "), fontsize=9)
    axes.set(xticks=[], yticks=[])


def check(name, example, laws) -> None:
    """Stop if a classifier gives another situation than that of the example's name."""
    here, values = snapshot(*example, CENTER.get(name)), classifiers.thresholds()
    situations = {other for other, law in laws.items() if bool(jax.jit(law)(here, values))}
    if situations != {name}:
        raise SystemExit(f"{name}: the classifiers give {sorted(situations)}.")


def sheet(path: Path, examples: dict, laws: dict, rows: int, columns: int) -> None:
    """Check examples and draw them."""
    figure, panels = plt.subplots(rows, columns, figsize=(2.4 * columns, 2.3 * rows), layout="constrained")
    for axes, (name, example) in zip(panels.flat, examples.items(), strict=True):
        check(name, example, laws)
        draw(axes, name, *example, CENTER.get(name))
    figure.savefig(path, metadata={"Date": None})


def main() -> None:
    """Draw both figures."""
    matplotlib.use("svg")
    matplotlib.rcParams.update({"svg.hashsalt": "situations", "svg.fonttype": "none"})
    here = Path(__file__)
    sheet(here.with_name("situations-paper.svg"), PAPER, classifiers.SITUATIONS, 1, 5)
    sheet(here.with_suffix(".svg"), EXAMPLES, classifiers.MORE_SITUATIONS, 2, 5)


if __name__ == "__main__":
    main()
