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
# # Your own force, metric and policy, in a report
# Your own value works wherever a name works: nothing in the package is changed or registered. Here
# people keep a distance by our own force, a robot drives by our own policy, and our own metric gets a column
# in the table and a row in the report. `docs/extending.md` has an example of every family.
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
from pathlib import Path
from tempfile import mkdtemp

from sean_jax import compiler

compiler.configure()  # before jax: caches compiled programs, so a second run compiles nothing

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from flax import struct

import sean_jax
from sean_jax import metrics

PEOPLE = 16  # in the lab
EPISODES = 8  # at once
STEPS = 600  # of 0.1 s: the longest episode

# %% [markdown]
# ## A force
# A term of the sum of social forces is a small class whose fields are its parameters. `pair` gives the acceleration
# of one person by one other; all pairs of all terms are summed in one pass.


# %%
@struct.dataclass
class Distancing:
    """People repel one another within a distance, in proportion to their penetration of it."""

    strength: jax.Array  # m/s2
    distance: jax.Array  # m

    def pair(self, pair):
        apart = jnp.sqrt(pair.dx * pair.dx + pair.dy * pair.dy + 1e-6)
        size = self.strength * jnp.maximum(1.0 - apart / self.distance, 0.0) / apart
        return size * pair.dx, size * pair.dy


# %% [markdown]
# ## A metric
# A condition of one snapshot becomes a duration: the time with a person within a metre of the robot, overall and in
# each social situation.


# %%
def near(snapshot):
    gap = snapshot.people.position - snapshot.position[None, :]
    return (snapshot.people.present & ((gap * gap).sum(-1) < 1.0)).any()


near_time = metrics.duration(near, title="time near people", definition="Somebody is within 1 m of the robot.")

# %% [markdown]
# ## A policy
# A function returns the command: m/s ahead and rad/s to the left. `observe` gives the observation in the robot's
# frame. This policy heads for the next point of the shortest path and slows down for the nearest person ahead.


# %%
def careful(scenario, state, key):
    observation = sean_jax.observe(scenario, state)
    bearing = jnp.arctan2(observation.path[1], observation.path[0])
    ahead = observation.people_present & (observation.people[:, 0] > 0.0)
    distance = jnp.sqrt((observation.people * observation.people).sum(-1) + 1e-6)
    room = jnp.min(jnp.where(ahead, distance, 2.0), initial=2.0) - 0.6
    speed = 0.5 * jnp.clip(room, 0.0, 1.0) * jnp.maximum(jnp.cos(bearing), 0.0)
    return jnp.stack([speed, jnp.clip(2.0 * bearing, -1.0, 1.0)])


# %% [markdown]
# ## All parts together
# `make` takes the parts, and `evaluate` runs the episodes: `sean run` as a function.

# %%
scenario = sean_jax.make(
    "lab",
    people=PEOPLE,
    time_limit=STEPS / 10,
    forces=[*sean_jax.preset("helbing1995"), Distancing(strength=1.0, distance=1.5)],
    metrics={**sean_jax.METRICS, "near_time": near_time},
)
evaluation = sean_jax.evaluate(scenario, careful, episodes=EPISODES, seed=0)
print(evaluation.table(100))

# %% [markdown]
# The same episodes with a policy of the package, for comparison: arrays with one value per episode. A robot that slows
# down takes longer, and may be near people for longer.

# %%
other = sean_jax.evaluate(scenario, "go_to_goal", episodes=EPISODES, seed=0)
for name, found in (("careful", evaluation), ("go_to_goal", other)):
    print(f"{name:>10}: near people for {found.metrics['near_time'][:, 0].mean():.1f} s of an episode, on average")
assert evaluation.seconds.mean() > other.seconds.mean(), "a robot that slows down should take longer"
figure, panels = plt.subplots(1, 2, figsize=(9, 2.8), layout="constrained")
for row, (name, found) in enumerate((("careful", evaluation), ("go_to_goal", other))):
    for panel, values in zip(panels, (found.metrics["near_time"][:, 0], found.seconds), strict=True):
        panel.bar(np.arange(EPISODES) + 0.4 * row, values, 0.4, label=name, color=("#f58a07", "#8d99b3")[row])
panels[0].set(xlabel="episode", ylabel="near people [s]")
panels[1].set(xlabel="episode", ylabel="length of the episode [s]")
panels[1].legend(frameon=False, fontsize=8)
plt.show()

# %% [markdown]
# ## The report
# `save` writes the files of `sean run`: a page with pictures, `episodes.csv`, `summary.json` and an animation. This
# is the first episode from above; the page includes our metric.

# %%
folder = evaluation.save(Path(mkdtemp()) / "careful")
assert "time near people" in (folder / "report.html").read_text()
print(sorted(path.name for path in folder.iterdir()))
sean_jax.view(evaluation.frames[0], scenario)
