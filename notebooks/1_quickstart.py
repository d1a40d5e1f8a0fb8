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
# A robot crosses a warehouse full of people and joins a group. We make the scenario, step it, run a batch of episodes
# at once, look at where everybody went and which social situations arose, and differentiate through it all.
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
import jax
import jax.numpy as jnp

import sean_jax
from sean_jax.policies import POLICIES

PEOPLE = 62  # in the warehouse
EPISODES = 8  # at once
STEPS = 600  # of 0.1 s: a minute

# %% [markdown]
# ## A scenario
# It is a physical environment, a pedestrian behavior and a robot task, and holds all that stays the same. A *state*
# holds all that moves. Both are pytrees, so `jit`, `vmap` and `grad` take them as they are.

# %%
scenario = sean_jax.make("warehouse", behavior="graph", task="join_group", robot="kuri", people=PEOPLE)
state = jax.jit(sean_jax.reset)(scenario, jax.random.key(0))
print("robot at", state.robot.position, "m, to go to", state.task.goal, "m,", state.task.geodesic, "m away by foot")

# %% [markdown]
# One step is 0.1 s. The action is a linear speed in m/s and a turn rate in rad/s, counter-clockwise.

# %%
step = jax.jit(sean_jax.step)
for _ in range(10):
    state = step(scenario, state, jnp.array([0.1, 0.5]))
print("after", state.tick, "steps at", state.robot.position, "m, at", state.robot.speed, "m/s")

# %% [markdown]
# What the robot perceives is computed when asked for, and not otherwise.

# %%
observation = sean_jax.observe(scenario, state)
jax.tree.map(jnp.shape, observation)

# %% [markdown]
# ## Many episodes at once
# `rollout` is a `lax.scan` of steps under a policy, and a batch is a `vmap` over keys. `final` is the last state,
# `trajectory` what was kept of each step, here with the axes (episode, step, ...).

# %%
policy = POLICIES["go_to_goal"]


@jax.jit
def episodes(keys):
    return jax.vmap(lambda key: sean_jax.rollout(scenario, policy, key, steps=STEPS))(keys)


final, trajectory = episodes(jax.random.split(jax.random.key(1), EPISODES))
print(f"{int(final.completed.sum())} of {EPISODES} robots have reached their group after {STEPS / 10:g} s")

# %% [markdown]
# The first episode from above: people's trails, and the robot's path in the colours of the situations on its way.

# %%
sean_jax.view(trajectory, scenario)

# %% [markdown]
# How much of the robots' time was spent in each situation? Several can hold at once, so the shares need not add up
# to one.

# %%
active = trajectory.active[..., None]
shares = jnp.sum(trajectory.situations & active, axis=(0, 1)) / jnp.sum(active)
for name, share in zip(sean_jax.SITUATIONS, shares, strict=True):
    print(f"{name:12} {share:6.1%}")

# %% [markdown]
# ## Gradients
# The robot's closed-form twin compiles faster than the MJX model and moves alike. From the start of an episode we ask
# how far the robot is from its goal after 4 s, as a function of its 40 actions, and let the gradient improve them.

# %%
twin = sean_jax.make("warehouse", behavior="graph", task="join_group", robot="kuri", people=PEOPLE, dynamics="twin")
start = jax.jit(sean_jax.reset)(twin, jax.random.key(0))


def distance(actions, forces):
    """Distance [m] to the goal after the actions (T, 2), with those constants of the social forces."""
    changed = twin.replace(forces=forces)
    last, _ = jax.lax.scan(lambda state, action: (sean_jax.step(changed, state, action), None), start, actions)
    return jnp.linalg.norm(last.robot.position - last.task.goal)


# %%
improve = jax.jit(jax.value_and_grad(distance))
actions = jnp.tile(jnp.array([0.2, 0.0]), (40, 1))
for trial in range(20):
    value, gradient = improve(actions, twin.forces)
    if trial % 5 == 0:
        print(f"{value:.3f} m")
    actions = actions - 2.0 * gradient

# %% [markdown]
# The same gradient reaches every constant of the crowd: how far is the nearest person from the robot in the end, and
# how does that change with the strength and the range of the forces between people?


# %%
def nearest(forces):
    """Distance [m] from the robot to the nearest person after the actions, with those constants."""
    changed = twin.replace(forces=forces)
    last, _ = jax.lax.scan(lambda state, action: (sean_jax.step(changed, state, action), None), start, actions)
    return jnp.linalg.norm(last.pedestrians.position - last.robot.position[None], axis=-1).min()


sensitivity = jax.jit(jax.grad(nearest))(twin.forces).repulsion
print("per m/s2 of strength:", sensitivity.strength, "m; per m of range:", sensitivity.range, "m")
