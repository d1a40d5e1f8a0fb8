"""Draws docs/pictures/move_base-fixed-point.png, where ROS's move_base stands: python docs/move_base.py."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.colors import ListedColormap
from matplotlib.patches import Polygon

import sean_jax
from sean_jax.policies import costmap
from sean_jax.policies.ros_move_base import apply, init, sean2_params

PICTURE = Path(__file__).resolve().parent / "pictures" / "move_base-fixed-point.png"
PLACE, GOAL = (9.315, 5.453), (-11.90, -14.50)
HEADINGS = np.array([-1, -2, -3, -4, 6]) * np.pi / 8
SPAN = 0.75  # m, to each side of the robot
COLORS = ["#ffffff", "#f2b27a", "#5b6470"]  # free, 253, 254

scenario = sean_jax.make("warehouse", task="join_group", preset="sean2")
grid = scenario.environment.obstacle_grid  # the map of the real runs has the shelf's last cell filled
grid = grid.replace(rows=grid.rows.at[..., 2].add(1e-3))
scenario = scenario.replace(environment=scenario.environment.replace(obstacle_grid=grid))
params, begin = sean2_params(), jax.jit(sean_jax.reset)(scenario, jax.random.key(0))


def command(heading):
    """The command (2,) [m/s, rad/s] at rest, and the costs of the window's cells."""
    ahead = jnp.stack([jnp.cos(heading), jnp.sin(heading)])
    robot = scenario.robot.place(scenario.robot, jnp.asarray(PLACE), ahead)
    state = begin.replace(robot=robot, task=begin.task.replace(goal=jnp.asarray(GOAL)))
    memory = init(scenario, params, state)
    window = costmap.window_around(scenario.environment, robot.position)
    lethal = costmap.crop(memory.obstacles, window)
    costs = costmap.inflate(params.local_costmap, scenario.robot.radius, window.cell, lethal)
    return apply(scenario, params, state.replace(policy_state=memory), jax.random.key(0))[0], costs, window.origin


commands, costs, origin = map(np.asarray, jax.jit(jax.vmap(command))(jnp.asarray(HEADINGS)))
figure, axes = plt.subplots(1, len(HEADINGS), figsize=(14, 3.6), sharey=True, layout="constrained")
kinds = np.select([costs[0] >= 254, costs[0] >= 253], [2, 1], 0)
edges = origin[0][:, None] + 0.1 * np.arange(costmap.WINDOW + 1)
for axis, heading, (speed, rate) in zip(axes, HEADINGS, commands, strict=True):
    axis.pcolormesh(*edges, kinds.T, cmap=ListedColormap(COLORS), vmin=0, vmax=2, edgecolors="#d8dbe0", linewidth=0.4)
    angles = heading + 2 * np.pi / 16 * np.arange(16)
    corners = np.array(PLACE) + 0.16 * np.stack([np.cos(angles), np.sin(angles)], -1)
    axis.add_patch(Polygon(corners, facecolor="#4477aa55", edgecolor="#4477aa", linewidth=1.5))
    axis.plot(*corners.T, ".", color="#224466", markersize=5)
    ahead = 0.34 * np.array([np.cos(heading), np.sin(heading)])
    axis.annotate("", np.array(PLACE) + ahead, PLACE, arrowprops={"arrowstyle": "->", "color": "#224466", "lw": 1.5})
    to_goal = np.array(GOAL) - PLACE
    tip = np.array(PLACE) + 0.62 * to_goal / np.hypot(*to_goal)
    axis.plot(*np.stack([PLACE, tip]).T, ":", color="#44bb55", linewidth=1.8)
    axis.text(tip[0] + 0.04, tip[1], "to the goal", color="#ffffff", fontsize=8)
    stands = not np.any(np.abs([speed, rate]) > 1e-6)
    axis.set_title(f"heading {heading:+.2f}\n" + ("(0, 0): stands" if stands else f"({speed:.2f}, {rate:.2f})"),
                   color="#bb2233" if stands else "black")  # fmt: skip
    axis.set_xlim(PLACE[0] - SPAN, PLACE[0] + SPAN)
    axis.set_ylim(PLACE[1] - SPAN, PLACE[1] + SPAN)
    axis.set_aspect("equal")
    axis.set_xlabel("x, m")
axes[0].set_ylabel("y, m")
figure.savefig(PICTURE, dpi=90, pil_kwargs={"optimize": True})
