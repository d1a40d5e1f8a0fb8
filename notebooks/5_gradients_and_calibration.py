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
# # Gradients and calibration
# All motion is differentiable by all its inputs. Here the constants of a crowd are recovered from trajectories of
# people; then we plot the growth of derivatives with the horizon, and the remedies of rollouts.
# `docs/gradients.md` has the figures, and `sean calibrate` fits the constants to your recordings.
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
from functools import partial

from sean_jax import compiler

compiler.configure()  # before jax: caches compiled programs, so a second run compiles nothing

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import sean_jax
from sean_jax import gradients

PEOPLE = 16  # of a scene, and in the lab
EPISODES = 8  # scenes, and rollouts at once
STEPS = 150  # of 0.1 s in the lab
TRIALS = 10  # of gradient descent

# %% [markdown]
# ## A recording
# Two streams of people meet. We simulate them with constants that are unknown to the fit: each scene has two observed
# frames of 0.4 s, and eight frames to predict. People who overlap push each other apart so hard that positions are no
# smooth function of the constants, so the people of a scene begin at distances.

# %%
FRAME, SEEN_LATER = 0.4, 8
HIDDEN = {"evasion.strength": 4.0, "walking.relaxation_time": 0.3}
random = np.random.default_rng(0)
person = np.arange(PEOPLE)
side = np.where(person % 2, 1.0, -1.0)  # half of the people come from the left, half from the right

# Two rows on each side, each person at most 0.3 m from a place of the grid: nobody begins inside another.
column, row = person // 4, person // 2 % 2
places = np.stack([side * (1.6 + 1.4 * column), 1.4 * row - 0.7], -1)
begin = places + random.uniform(-0.3, 0.3, (EPISODES, PEOPLE, 2))
velocity = np.stack([-side * random.uniform(0.9, 1.4, (EPISODES, PEOPLE)), np.zeros((EPISODES, PEOPLE))], -1)
observed = jnp.asarray(np.stack([begin, begin + FRAME * velocity], 1), float)  # (EPISODES, 2, PEOPLE, 2) m


@jax.jit
def walk(constants):
    """Positions [m] of all people in the predicted frames, with two constants of the social forces."""
    forces = sean_jax.preset("calibrated").tree_replace(dict(zip(HIDDEN, constants, strict=True)))
    return sean_jax.predict(forces, observed, FRAME, SEEN_LATER)


recorded = walk(jnp.asarray(list(HIDDEN.values())))
figure, panel = plt.subplots(figsize=(8, 3), layout="constrained")
for person, to_the_right in enumerate(side < 0):
    way = np.concatenate([observed[0], recorded[0]])[:, person]
    panel.plot(*way.T, ".-", ms=4, color="#2f6fb0" if to_the_right else "#f58a07")
    panel.plot(*way[-1], "o", color="#2f6fb0" if to_the_right else "#f58a07")
panel.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title="the first scene; discs are final positions")
plt.show()

# %% [markdown]
# ## Calibration
# With two constants and many positions, forward mode gives the whole Jacobian at the cost of two rollouts, and the
# Gauss-Newton method needs a few Jacobians. (`sean calibrate` has more constants, real people and crowds, and
# needs no gradient.) The method has no limit on its steps, so it needs a start that is near enough: from half of both
# hidden values it does not arrive in eight steps.

# %%
jacobian = jax.jit(jax.jacfwd(walk))
constants = jnp.asarray([2.5, 0.5])
errors, guesses = [], []
for _ in range(6):
    apart = walk(constants) - recorded
    errors.append(1e3 * float(jnp.abs(apart).mean()))
    guesses.append(np.asarray(constants))
    print(f"{constants[0]:.3f} m/s2  {constants[1]:.3f} s   apart {errors[-1]:.3f} mm on average")
    slope = jacobian(constants).reshape(-1, constants.size)
    constants = jnp.maximum(constants - jnp.linalg.lstsq(slope, apart.reshape(-1))[0], 0.1)
print("hidden:", *HIDDEN.values())
assert np.allclose(guesses[-1], list(HIDDEN.values()), rtol=0.01), "the constants were not recovered"
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 2.8), layout="constrained")
for guess, (name, hidden), color in zip(np.stack(guesses, 1), HIDDEN.items(), ("#2f6fb0", "#f58a07"), strict=True):
    left.plot(guess / hidden, "o-", ms=4, color=color, label=name)
left.axhline(1, color="#8d99b3", linestyle=":")
left.set(xlabel="step", ylabel="share of the hidden value")
left.legend(frameon=False, fontsize=8)
right.semilogy(np.maximum(errors, 1e-4), "o-", ms=4, color="#1c2333")
right.set(xlabel="step", ylabel="apart, on average [mm]")
plt.show()

# %% [markdown]
# ## Growth of derivatives
# In a rollout of a crowd, a derivative grows with time: centimetres decide whether two people pass left or right.
# We plot the derivative of all positions by the strength of the repulsion, in the lab, at each step.
# `between` is a function of the state between two steps: `gradients.damp` multiplies the derivative by a factor,
# `truncate` stops it at intervals, and `clip` bounds it for each body in reverse mode. None of them changes the
# simulation.

# %%
lab = sean_jax.make("lab", people=PEOPLE, forces="calibrated")
drive = lambda scenario, state, key: jnp.asarray([0.3, 0.1])  # noqa: E731
where = lambda before, after, action: after.pedestrians.position  # noqa: E731


@partial(jax.jit, static_argnames="steps")
@partial(jax.vmap, in_axes=(0, None, None))
def sensitivity(key, factor, steps):
    """(steps,) norm of the derivative [m per m/s2] of all positions, damped by a factor a step."""

    def positions(strength):
        scenario = lab.replace(forces=lab.forces.tree_replace({"repulsion.strength": strength}))
        return sean_jax.rollout(
            scenario, drive, key, steps, where, between=lambda state: gradients.damp(state, factor)
        )[1]

    strength = lab.forces.repulsion.strength
    change = jax.jvp(positions, (strength,), (jnp.ones_like(strength),))[1]
    return jnp.sqrt((change**2).sum((1, 2)))


keys = jax.random.split(jax.random.key(0), EPISODES)
growth = {}
figure, panel = plt.subplots(figsize=(6, 3.5), layout="constrained")
for factor in (1.0, 0.98, 0.9):
    norms = sensitivity(keys, factor, STEPS)
    growth[factor] = jnp.median(norms, 0)
    panel.semilogy(0.1 * np.arange(1, STEPS + 1), growth[factor] + 1e-6, label=f"damped by {factor:g} a step")
panel.set(xlabel="horizon [s]", ylabel="median norm [m per m/s2]")
panel.legend()
plt.show()
assert growth[1.0][-1] > 100 * growth[1.0][STEPS // 5], "a derivative should grow with the horizon"
assert growth[0.9][-1] < growth[0.98][-1] < growth[1.0][-1], "damping should bound it"

# %% [markdown]
# ## Reverse mode and memory
# One output and many inputs: the robot's proximity to people by each of its commands. With `checkpoint_every` reverse
# mode stores one state per block of steps, and recomputes the steps in the backward pass. A few steps of gradient
# descent keep the robot away from people if the derivative is damped; without damping, chaos dominates it.


# %%
def crowding(commands, factor):
    """Mean over the steps of exp(-distance to the nearest person), of the robot that takes the commands (STEPS, 2)."""
    policy = lambda scenario, state, key: commands[state.tick]  # noqa: E731
    between = lambda state: gradients.damp(state, factor)  # noqa: E731

    def close(before, after, action):
        gap = after.pedestrians.position - after.robot.position
        return jnp.exp(-jnp.sqrt((gap**2).sum(-1) + 1e-6).min())

    return sean_jax.rollout(lab, policy, keys[0], STEPS, close, checkpoint_every=10, between=between)[1].mean()


steady = jnp.tile(jnp.asarray([0.3, 0.0]), (STEPS, 1))
program = jax.jit(jax.value_and_grad(crowding)).lower(steady, 1.0).compile()
print(f"{program.memory_analysis().temp_size_in_bytes / 2**20:.1f} MiB for {STEPS} steps")
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 2.8), layout="constrained")
for factor, color in ((1.0, "#8d99b3"), (0.9, "#f58a07")):
    commands, values = steady, []
    for _ in range(TRIALS):
        value, slope = program(commands, factor)
        values.append(float(value))
        commands = commands - 0.2 * slope / (jnp.abs(slope).max() + 1e-9)
    print(f"damped by {factor:g} a step: crowding {values[0]:.4f} at first, {values[-1]:.4f} in the end")
    left.plot(values, "o-", ms=4, color=color, label=f"damped by {factor:g} a step")
    kept_away = values[-1] < 0.9 * values[0]
    assert kept_away == (factor < 1.0), "the damped derivative alone should keep the robot away from people"
for column, (name, color) in enumerate((("forward [m/s]", "#2f6fb0"), ("turning [rad/s]", "#f58a07"))):
    right.plot(0.1 * np.arange(STEPS), commands[:, column], color=color, label=name)
left.set(xlabel="trial", ylabel="crowding")
right.set(xlabel="time [s]", ylabel="command in the end, damped")
for panel in (left, right):
    panel.legend(frameon=False, fontsize=8)
plt.show()
