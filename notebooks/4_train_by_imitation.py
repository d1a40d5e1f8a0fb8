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
# # Train by imitation
# Section V of the paper at small scale: a policy demonstrates joining and leaving groups in the lab, a network is
# trained on the demonstrations, and drives. It takes two or three minutes on a CPU and needs the extra `learning`:
# `pip install ".[learning]"`.
#
# On Colab, clone the repository first; the next cell then installs it. Elsewhere, README's first command does.

# %%
import subprocess
import sys

if "google.colab" in sys.modules:
    package = ["./sean_jax[learning]", "-c", "./sean_jax/constraints.txt"]
    subprocess.run([sys.executable, "-m", "pip", "install", "--quiet", *package], check=True)

# %%
# %matplotlib inline
import json
from pathlib import Path
from tempfile import mkdtemp

from sean_jax import compiler

compiler.configure()  # before jax: caches compiled programs, so a second run compiles nothing

import jax
import matplotlib.pyplot as plt
import numpy as np

import sean_jax
from sean_jax import learning
from sean_jax.config import CollectConfig, ImitationConfig
from sean_jax.drawing.colors import situation_colors
from sean_jax.policies import POLICIES
from sean_jax.scenario import frame

PEOPLE = 6  # in the lab
MINUTES = 15  # of demonstrations
EPOCHS = 45  # of training
EPISODES = 12  # of the comparison
STEPS = 400  # of 0.1 s in each
TEACHER = "go_to_goal"  # "expert" is more polite, and takes longer to simulate
folder = Path(mkdtemp())

# %% [markdown]
# ## Demonstrations
# As in `sean collect`: half of the time joining groups, half leaving them, one example per second. An unfinished folder
# is resumed, so you can stop and run this cell again.

# %%
asked = CollectConfig(
    behavior="graph", environment="lab", people=PEOPLE, policy=TEACHER, hours=MINUTES / 60,
    time_limit=STEPS / 10, width=32, height=24, batch=8, out=folder / "demonstrations",
)  # fmt: skip
data = learning.collect(asked)
print(f"{data.example_count} examples in {len(data.episodes)} episodes")

# %% [markdown]
# An example: the depth images of the last five seconds, the next points of the shortest path, the positions of the
# robot in the next five seconds (the target of the network), and the situations.

# %%
recording = data.recording(data.episodes)
one = learning.example(recording, np.int32(data.example_count // 2), np)
figure, axes = plt.subplots(1, 6, figsize=(13, 2.2), layout="constrained", width_ratios=[1.3] * 5 + [1.6])
for age, (panel, image) in enumerate(zip(axes, one.images, strict=False)):
    panel.imshow(image / 1000, cmap="viridis_r", vmin=0, vmax=8)
    panel.set(title=f"{4 - age} s ago" if age < 4 else "now", xticks=[], yticks=[])
axes[5].plot(*one.plan.T, "o-", ms=3, color="#8d99b3", label="plan")
axes[5].plot(*one.future[one.future_valid].T, "o-", ms=3, color="#f58a07", label="driven")
axes[5].plot(0, 0, ">", color="#1c2333")
axes[5].set(aspect="equal", title="in the robot's frame, m")
axes[5].legend(frameon=False, fontsize=7)
plt.show()
print(dict(zip(data.manifest["situations"], one.situations.tolist(), strict=True)))

# %% [markdown]
# ## Training
# As in `sean train imitation`. Each epoch is one program; the best network is kept.

# %%
trained = ImitationConfig(
    method="imitation", dataset=asked.folder, batch=128, epochs=EPOCHS, out=folder / "network"
)  # fmt: skip
state = learning.train(trained)
log = [json.loads(line) for line in (folder / "network" / "metrics.jsonl").read_text().splitlines()]
figure, panel = plt.subplots(figsize=(6, 2.4), layout="constrained")
for part, color in (("train", "#2f6fb0"), ("validation", "#f58a07")):
    panel.semilogy([row["epoch"] for row in log], [row[part]["loss"] for row in log], color=color, label=part)
panel.set(xlabel="epoch", ylabel="loss")
panel.legend(frameon=False)
plt.show()
print(f"least loss in validation {float(state.best):.3f} after epoch {int(state.best_epoch)}")
assert float(state.best) < 0.8 * log[0]["validation"]["loss"], "training should have reduced the loss"

# %% [markdown]
# ## Driving
# A trained network is a policy like any other. Teacher and network drive the same new episodes.

# %%
scenario = sean_jax.make("lab", task="join_group", people=PEOPLE, time_limit=STEPS / 10)
pupil = learning.load(folder / "network", scenario)
keys = jax.random.split(jax.random.key(7), EPISODES)


def drive(policy):
    """Final states, and the decision of the network in each step or nothing, for all keys."""

    def record(before, after, action):
        seen = after.policy_state.decision if hasattr(after.policy_state, "decision") else ()
        return frame(before, after, action), seen

    run = jax.jit(jax.vmap(lambda key: sean_jax.rollout(scenario, policy, key, STEPS, record)))
    return run(keys)


drives = {TEACHER: drive(POLICIES[TEACHER]), "network": drive(pupil)}
for name, (final, _) in drives.items():
    measured = jax.vmap(lambda state: sean_jax.results(scenario, state))(final)
    close = measured["intimate_robot_on_person"][:, 0].mean()
    stood = measured["time_not_moving"][:, 0].mean()
    print(f"{name:11} completed {int(final.completed.sum())} of {EPISODES}, "
          f"stood {stood:.1f} s, {close:.2f} intimate violations an episode")  # fmt: skip
assert drives["network"][0].completed.mean() >= 0.5, "the network should complete half of the episodes or more"

# %% [markdown]
# ## Attention
# In each step the velocity controller divides its attention over the images, its local plan, and the
# global plan. One episode, with the situations below:

# %%
frames, decisions = drives["network"][1]
active = np.asarray(frames.active[0])
attention = np.asarray(decisions.controller_attention[0])[active]
time = 0.1 * np.arange(len(attention))
names = [name for name, _ in scenario.situations]
figure, (above, below) = plt.subplots(2, 1, figsize=(10, 4), sharex=True, layout="constrained")
colors = ("#2f6fb0", "#f58a07", "#8d99b3")
above.stackplot(time, attention.T, labels=pupil.params.network.controller_sources, colors=colors)
above.set(ylabel="attention", ylim=(0, 1))
above.legend(loc="upper left", fontsize=8)
for k, color in enumerate(situation_colors(tuple(names))):
    told = np.asarray(frames.situations[0])[active][:, k]
    below.bar(time[told], 0.8, width=0.1, bottom=k + 0.1, align="edge", color=color)
below.set_yticks(np.arange(len(names)) + 0.5, [name.replace("_", " ") for name in names], fontsize=8)
below.set(ylim=(len(names), 0), xlabel="time [s]")
plt.show()

# %% [markdown]
# ## Table I's bars
# Frequency of each situation in the demonstrations, with intervals, and the paper's numbers for its
# Behavior Graph (in a warehouse of 62 people). `sean experiment table1` does this for all behaviors, `figure4` all of
# section V.

# %%
from sean_jax.metrics import bootstrap  # noqa: E402
from sean_jax.studies.experiments import shares  # noqa: E402

flags = recording.rows.situations
blocks = flags[: len(flags) // 30 * 30].reshape(-1, 30, flags.shape[-1])  # of 30 s, which are nearly independent
found = shares.count(blocks, bootstrap.resamples(len(blocks))).of("flags")  # two situations in one second are two flags
low, high = shares.interval(found)
figure, panel = plt.subplots(figsize=(6, 2.8), layout="constrained")
x = np.arange(5)
panel.bar(x, 100 * found[0], color=situation_colors(shares.NAMES))
panel.errorbar(x, 50 * (low + high), 50 * (high - low), fmt="none", ecolor="#1c2333", capsize=3)
paper = 100 * shares.paper()["graph"]
panel.hlines(paper, x - 0.4, x + 0.4, color="#1c2333", linestyles="dashed", label="paper, graph")
panel.set_xticks(x, [name.replace("_", "\n") for name in shares.NAMES])
panel.set(ylabel="% of flags")
panel.legend(frameon=False)
plt.show()
