"""Draws the pictures of docs/sensors.md, docs/pictures/sensors-*.png: python docs/sensors.py.

All cameras in all environments, the third-person view of all robots, a lidar scan over the floor plan, and a point
cloud. It takes a minute or two, most of it compiling.
"""

import dataclasses
import io
from pathlib import Path

import jax
import matplotlib
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.collections import LineCollection
from PIL import Image

import sean_jax
from sean_jax import robots, sensors
from sean_jax.policies import POLICIES

FOLDER = Path(__file__).parent / "pictures"
WIDTH, HEIGHT, FINER = 288, 216, 2  # pixels of a panel, drawn twice as fine
TRIES = 32  # moments of which the one with most to see is shown
NEAR = 6.0  # m, people farther away are too small to count
MOST = 0.3  # of the picture that people may fill


def moments(scenario):
    """States of some episodes, 10 s after their start, stacked."""
    policy = POLICIES["go_to_goal"]
    keys = jax.random.split(jax.random.key(5), TRIES)
    return jax.jit(jax.vmap(lambda key: sean_jax.rollout(scenario, policy, key, 100)[0]))(keys)


def best(scenario, states) -> int:
    """The moment in which most people near by are seen by the first-person camera, but none fills it."""
    eye = sensors.camera(scenario, "first_person", width=32, height=24)
    pictures = jax.jit(jax.vmap(lambda state: sensors.render(scenario, state, eye)))(states)
    person = np.asarray(pictures.semantic) == sensors.CLASSES.index("person")
    share = person.mean((1, 2))
    seen = [
        len(np.unique(instance[here])) for instance, here in zip(np.asarray(pictures.instance), person, strict=True)
    ]
    return int(np.argmax(np.where(share < MOST, np.array(seen) + share, -1.0)))


def smooth(scenario, state, name: str) -> np.ndarray:
    """(H, W, 3) the picture of a camera."""
    eye = sensors.camera(scenario, name, width=FINER * WIDTH, height=FINER * HEIGHT)
    rgb = np.asarray(jax.jit(lambda state: sensors.render(scenario, state, eye).rgb)(state))
    return rgb.reshape(HEIGHT, FINER, WIDTH, FINER, 3).mean((1, 3))


def cameras(stages: dict) -> None:
    """One row for each environment, one column for each camera."""
    figure, panels = plt.subplots(len(stages), 4, figsize=(12, 2.35 * len(stages)), layout="constrained")
    image = None
    for row, (name, (scenario, state)) in zip(panels, stages.items(), strict=True):
        eye = sensors.camera(scenario, "depth", width=WIDTH, height=HEIGHT)
        depth = np.asarray(jax.jit(lambda state, s=scenario, e=eye: sensors.depth(s, state, e))(state))
        seen = np.ma.masked_greater_equal(depth, eye.far)
        for axes, kind in zip(row, ("first_person", "depth", "third_person", "overhead"), strict=True):
            axes.set(xticks=[], yticks=[])
            if kind == "depth":
                image = axes.imshow(seen, cmap="turbo", norm=matplotlib.colors.PowerNorm(0.5, 0.0, eye.far))
                axes.set_facecolor("#333333")
            else:
                axes.imshow(smooth(scenario, state, kind))
            if name == next(iter(stages)):
                axes.set_title(kind.replace("_", " "), fontsize=10)
        row[0].set_ylabel(name, fontsize=10)
    assert image is not None
    figure.colorbar(image, ax=panels, label="depth [m], dark: nothing nearer than 20 m", shrink=0.6, pad=0.01,
                    ticks=[0, 1, 2, 5, 10, 20])  # fmt: skip
    save(figure, "sensors-cameras.png")


def third_person(scenario, state) -> None:
    """All robots at one place, each from behind."""
    figure, panels = plt.subplots(1, len(robots.ROBOTS), figsize=(12, 2.2), layout="constrained")
    for axes, name in zip(panels, robots.ROBOTS, strict=True):
        axes.imshow(smooth(dataclasses.replace(scenario, robot=robots.load(name)), state, "third_person"))
        axes.set(xticks=[], yticks=[])
        axes.set_title(name, fontsize=10)
    save(figure, "sensors-robots.png")


def lidar(scenario, state) -> None:
    """A scan over the floor plan."""
    device = sensors.lidar(scenario)
    scan = np.asarray(jax.jit(lambda state: sensors.scan(scenario, state, device))(state))
    place, heading = np.asarray(state.robot.position), np.asarray(state.robot.heading)
    turn = np.arctan2(heading[1], heading[0]) + device.span * np.arange(device.count) / device.count
    ends = place + scan[:, None] * np.stack([np.cos(turn), np.sin(turn)], -1)
    hits, extent = scan < device.far, 4.0
    figure, axes = plt.subplots(figsize=(5.4, 5.6), layout="constrained")
    fan = plt.Polygon(ends, fc="#4477aa", alpha=0.14, lw=0, zorder=1, label="free along the rays")
    axes.add_patch(fan)
    axes.add_collection(LineCollection([(place, end) for end in ends[::6]], color="#4477aa", lw=0.4, alpha=0.5))
    obstacles = jax.tree.map(np.asarray, scenario.environment.obstacles)
    for center, half, yaw, height in zip(*jax.tree.leaves(obstacles), strict=True):
        if height > 0:
            box = plt.Rectangle(
                center - half, *(2 * half), angle=np.rad2deg(yaw), rotation_point="center", fc="#8a94a6", ec="#4c5566"
            )
            axes.add_patch(box)
    box.set_label("obstacle")
    for person in np.asarray(state.pedestrians.position)[np.asarray(state.pedestrians.present)]:
        body = plt.Circle(person, float(scenario.forces.walking.radius), fc="#ddcc77", ec="#665500", lw=1, zorder=3)
        axes.add_patch(body)
    body.set_label("person")
    axes.add_patch(plt.Circle(place, scenario.robot.radius, fc="#222222", lw=0, zorder=4, label="robot and heading"))
    axes.plot(*zip(place, place + 0.45 * heading, strict=True), color="#222222", lw=2, zorder=4)
    axes.scatter(*ends[hits].T, s=9, color="#cc1133", lw=0, zorder=5, label="hit")
    far = plt.Circle(place, device.far, fill=False, ec="#4477aa", lw=1, ls="--", label=f"range, {device.far:g} m")
    axes.add_patch(far)
    axes.set(xlim=place[0] + np.array([-extent, extent]), ylim=place[1] + np.array([-extent, extent]), aspect="equal")
    axes.set(xlabel="x [m]", ylabel="y [m]")
    figure.legend(loc="outside lower center", ncols=3, fontsize=9, frameon=False)
    save(figure, "sensors-lidar.png")


def point_cloud(scenario, state) -> None:
    """The points of a VLP-16 on a Jackal, by what they lie on."""
    scenario = dataclasses.replace(scenario, robot=robots.load("jackal"))
    device = sensors.lidar(scenario, **sensors.VLP16)
    scan = np.asarray(jax.jit(lambda state: sensors.scan(scenario, state, device))(state))
    points, ring = sensors.point_cloud(device, scan)
    (mount,) = [np.asarray(each.origin) for each in scenario.robot.mounts if each.name == "lidar"]
    ahead, left, height = (points + mount).T
    heading, position = np.asarray(state.robot.heading), np.asarray(state.robot.position)
    people = np.asarray(state.pedestrians.position)[np.asarray(state.pedestrians.present)] - position
    people = people @ np.stack([heading, [-heading[1], heading[0]]], -1)  # in the robot's frame
    radius = float(scenario.forces.walking.radius) + 0.02
    on_people = (np.hypot(ahead[:, None] - people[:, 0], left[:, None] - people[:, 1]) < radius).any(1) & (
        height > 0.02
    )
    floor = (height < 0.02) & ~on_people
    near = (np.abs(ahead - 2.0) < 7.0) & (np.abs(left) < 7.0) & (height < 3.0)
    figure = plt.figure(figsize=(9, 5.4))
    axes = figure.add_axes((-0.14, -0.3, 1.28, 1.62), projection="3d")
    axes.set_axis_off()
    for chosen, color, size, label in (
        (floor, "#6b7385", 0.9, "floor"),
        (~floor & ~on_people, "#4477aa", 0.9, "obstacle"),
        (on_people, "#cc1133", 2.5, "person"),
    ):
        shown = chosen & near
        places = ahead[shown], left[shown], height[shown]
        axes.scatter(*places, s=size, color=color, lw=0, depthshade=False, label=label)
    axes.scatter([mount[0]], [mount[1]], [mount[2]], s=40, color="#222222", depthshade=False, label="lidar")
    axes.quiver(*mount, 1.0, 0.0, 0.0, color="#222222", lw=1.5)
    axes.set(xlim=(-5, 9), ylim=(-7, 7), zlim=(0, 3))
    axes.set_box_aspect((14, 14, 3))
    axes.view_init(elev=28, azim=205)
    legend = figure.legend(loc="lower center", ncols=4, fontsize=9, frameon=False, markerscale=1.0)
    for handle in legend.legend_handles:
        handle.set_sizes([24])
    save(figure, "sensors-points.png")
    print(f"{len(points)} points, {on_people.sum()} on people, {len(np.unique(ring))} rings")


def save(figure, name: str) -> None:
    """Without transparency, as small as it gets."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110)
    image = Image.open(stream).convert("RGB")
    FOLDER.mkdir(exist_ok=True)
    image.save(FOLDER / name, optimize=True)
    print(FOLDER / name, f"{(FOLDER / name).stat().st_size / 1000:.0f} kB", flush=True)


def main() -> None:
    """Draw everything."""
    matplotlib.use("agg")
    stages = {}
    for name in ("warehouse", "lab", "outdoor"):
        scenario = sean_jax.make(name, task="busy_ab_nav")
        states = moments(scenario)
        index = best(scenario, states)
        stages[name] = scenario, jax.tree.map(lambda leaf, i=index: leaf[i], states)
    cameras(stages)
    third_person(*stages["warehouse"])
    lidar(*stages["warehouse"])
    point_cloud(*stages["warehouse"])


if __name__ == "__main__":
    main()
