# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Quickstart
# A robot crosses a warehouse full of people and joins a group. We make the scenario, step it, run a batch of episodes,
# plot trajectories and social situations, and differentiate through all of it.
#
# On Colab, clone the repository first; the next cell then installs it. Elsewhere, README's first command does.

# %%
import subprocess
import sys

if "google.colab" in sys.modules:
    install = [sys.executable, "-m", "pip", "install", "--quiet", "./sean_jax", "-c", "./sean_jax/constraints.txt"]
    subprocess.run(install, check=True)

# %%
# %matplotlib inline
from sean_jax import compiler

compiler.configure()  # before jax: caches compiled programs, so a second run compiles nothing

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import sean_jax
from sean_jax.drawing import layers, situation_colors
from sean_jax.policies import POLICIES

PEOPLE = 62  # in the warehouse
EPISODES = 8  # at once
STEPS = 600  # of 0.1 s: a minute
TRIALS = 20  # of the gradient

# %% [markdown]
# ## A scenario
# A scenario is a physical environment, a pedestrian behavior and a robot task: everything that is constant. A *state*
# holds everything that changes. Both are pytrees, so `jit`, `vmap` and `grad` accept them.

# %%
scenario = sean_jax.make("warehouse", behavior="graph", task="join_group", robot="kuri", people=PEOPLE)
start = state = jax.jit(sean_jax.reset)(scenario, jax.random.key(0))
print("robot at", state.robot.position, "m, to go to", state.task.goal, "m,", state.task.geodesic, "m away by foot")

# %% [markdown]
# One step is 0.1 s. The action is a linear speed in m/s and a turn rate in rad/s, counter-clockwise.

# %%
step = jax.jit(sean_jax.step)
for _ in range(10):
    state = step(scenario, state, jnp.array([0.1, 0.5]))
print("after", state.tick, "steps at", state.robot.position, "m, at", state.robot.speed, "m/s")

# %% [markdown]
# Observations are computed only if you call `observe`.

# %%
observation = jax.jit(sean_jax.observe)(scenario, state)
jax.tree.map(jnp.shape, observation)

# %% [markdown]
# ## Many episodes at once
# `rollout` is a `lax.scan` of steps under a policy, and a batch is a `vmap` over keys. `final` is the last state,
# `trajectory` the record of each step, here with the axes (episode, step, ...).

# %%
policy = POLICIES["go_to_goal"]


@jax.jit
def episodes(keys):
    return jax.vmap(lambda key: sean_jax.rollout(scenario, policy, key, steps=STEPS))(keys)


final, trajectory = episodes(jax.random.split(jax.random.key(1), EPISODES))
print(f"{int(final.completed.sum())} of {EPISODES} robots have reached their group after {STEPS / 10:g} s")
assert final.completed.mean() > 0.5, "most robots should have reached their group"

# %% [markdown]
# The first episode from above: people's trails, and the robot's path in the colors of the situations.

# %%
sean_jax.view(trajectory, scenario)

# %% [markdown]
# Share of the robots' time in each situation. Several can hold at once, so the shares need not add up to one.

# %%
active = trajectory.active[..., None]
shares = jnp.sum(trajectory.situations & active, axis=(0, 1)) / jnp.sum(active)
names = [name.replace("_", " ") for name in sean_jax.SITUATIONS]
figure, panel = plt.subplots(figsize=(6, 2.4), layout="constrained")
bars = panel.barh(names, 100 * shares, color=situation_colors(tuple(sean_jax.SITUATIONS)))
panel.bar_label(bars, fmt="%.0f %%", padding=3)
panel.set(xlabel="% of the robots' time", xlim=(0, 100))
panel.invert_yaxis()
plt.show()

# %% [markdown]
# ## Gradients
# The distance between robot and goal after 4 s is a function of its 40 commands, and gradient descent improves them.
# The gradient passes through the robot, the people and their forces. Notebook 5 has more.


# %%
def distance(actions):
    """Distance [m] to the goal after the actions (T, 2), and the robot's path (T, 2)."""

    def one(state, action):
        after = sean_jax.step(scenario, state, action)
        return after, after.robot.position

    last, way = jax.lax.scan(one, start, actions)
    return jnp.linalg.norm(last.robot.position - last.task.goal), way


improve = jax.jit(jax.value_and_grad(distance, has_aux=True))
actions = jnp.tile(jnp.array([0.2, 0.0]), (40, 1))
ways, distances = [], []
for _ in range(TRIALS):
    (value, way), gradient = improve(actions)
    ways.append(np.asarray(way))
    distances.append(float(value))
    actions = actions - 2.0 * gradient
print(f"{distances[0]:.2f} m from the goal at first, {distances[-1]:.2f} m in the end")
assert distances[-1] < distances[0] - 0.5, "the gradient should have brought the robot nearer to its goal"

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.2), layout="constrained", width_ratios=[1, 1.6])
left.plot(distances, "o-", ms=3, color="#f58a07")
left.set(xlabel="trial", ylabel="distance to the goal after 4 s [m]")
layers.draw_obstacles(right, scenario.environment)
for way, shade in zip(ways, plt.get_cmap("YlOrBr")(np.linspace(0.25, 0.9, len(ways))), strict=True):
    right.plot(*way.T, color=shade)
end = ways[-1][-1]
toward = np.asarray(start.task.goal) - end
right.annotate(
    "", end + 0.7 * toward / np.linalg.norm(toward), end, arrowprops={"arrowstyle": "->", "color": "#1c2333"}
)
right.plot(*ways[0][0], "o", color="#1c2333")
right.set(aspect="equal", xlim=end[0] + np.array([-2.2, 1.2]), ylim=end[1] + np.array([-0.9, 0.7]))
right.set(xlabel="x [m]", ylabel="y [m]")
right.set_title("the robot's ways, later ones darker; the arrow points to the goal", fontsize=9)
plt.show()
