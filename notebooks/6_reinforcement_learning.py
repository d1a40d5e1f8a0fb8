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
# # Train with reinforcement learning
# A robot in a lab learns to join a group of people from observations and rewards. After some minutes on a CPU, mostly
# compilation in the first run, it completes about four of five tasks and takes a fifth longer than the package's
# `go_to_goal`, which completes all; more updates help. It needs the extra `learning`: `pip install ".[learning]"`.
# `docs/training.md` has terms and options.
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
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import sean_jax
from sean_jax import PPOConfig, learning, make_env, mdp, metrics
from sean_jax.base import as_policy
from sean_jax.drawing import layers
from sean_jax.learning import networks, policy
from sean_jax.policies import go_to_goal

PEOPLE = 5  # in the lab
EPISODES = 32  # of the comparison
STEPS = 400  # of 0.1 s in each
UPDATES = 120  # of the training, with 2,048 scenario-steps each
folder = Path(mkdtemp()) / "ppo"

# %% [markdown]
# ## A scenario becomes an environment
# `make_env` adds observations and rewards to a scenario. An action is two numbers from -1 to 1:
# fractions of the top speed and of the top turn rate.

# %%
scenario = sean_jax.make("lab", task="join_group", people=PEOPLE, time_limit=STEPS / 10)
env = make_env(scenario)
for name, box in env.observation_space.items():
    print(f"{name:12} {box.shape!s:8} from {box.low:g} to {box.high:g}")
for name, term in env.rewards:
    print(f"{name:24} {term.weight:6g}  {'privileged' if term.privileged else ''}")

# %% [markdown]
# ## Observations and rewards
# An episode of `go_to_goal` through the environment. Left: the observation at the time when a person is
# nearest, in the robot's frame, which looks to the right. Right: cumulative rewards.


# %%
@jax.jit
def driven(key):
    """Observations and rewards (T, ...) of one episode."""

    def one(carry, tick):
        state, seen = carry
        command = go_to_goal(scenario, state.simulation, jax.random.fold_in(key, tick))
        state, after, _, terminated, truncated, info = env.advance(state, mdp.to_action(scenario.robot, command))
        return (state, after), (seen, info["rewards"], terminated | truncated)

    observation, state = env.reset(key)
    return jax.lax.scan(one, (state, observation), jnp.arange(STEPS))[1]


seen, told, over = jax.tree.map(np.asarray, driven(jax.random.key(0)))
last = int(over.argmax()) + 1 if over.any() else STEPS
gaps = np.where(seen["people"][:last, 0, 4] > 0, np.hypot(*seen["people"][:last, 0, :2].T), 99.0)
now = {name: values[gaps.argmin()] for name, values in seen.items()}
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained", width_ratios=[1, 1.2])
near = now["people"][now["people"][:, 4] > 0]
left.quiver(*near[:, :2].T, *near[:, 2:4].T, color="#2f6fb0", angles="xy", scale_units="xy", scale=1, width=0.006)
left.scatter(*near[:, :2].T, color="#2f6fb0", s=60, label="people and their velocity")
spots = now["obstacles"][:, :2] * now["obstacles"][:, 2:]
left.scatter(*spots.T, marker="s", color="#8d99b3", label="nearest obstacles")
left.plot(*np.stack([np.zeros(2), now["path"]]).T, ":", color="#f58a07")
left.plot(*now["path"], "o", color="#f58a07", label="next corner of the path")
left.plot(*now["goal"], "*", ms=14, color="#f58a07", label="goal")
left.plot(0, 0, ">", ms=10, color="#1c2333", label="robot")
left.set(aspect="equal", xlabel="ahead [m]", ylabel="to the left [m]")
left.legend(frameon=False, fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=3)
for name, values in told.items():
    if values[:last].any():
        right.plot(0.1 * np.arange(last), values[:last].cumsum(), label=name)
right.set(xlabel="time [s]", ylabel="sum of the rewards")
right.set_yscale("symlog", linthresh=0.5)
right.legend(frameon=False, fontsize=7, loc="center left", bbox_to_anchor=(1, 0.5))
plt.show()
print("without effect here:", ", ".join(name for name, values in told.items() if not values[:last].any()))

# %% [markdown]
# ## Training
# As in `sean train ppo`: 64 scenarios step together, and each update uses 32 steps of each.

# %%
asked = PPOConfig(
    method="ppo", environment="lab", task="join_group", people=PEOPLE, time_limit=STEPS / 10, minibatches=4,
    pool=256, steps=UPDATES * 64 * 32, evaluate_every=20, evaluation_episodes=32, out=folder,
)  # fmt: skip
shown = set()


def show(done):
    """A line for each quarter of the training."""
    if (quarter := int(4 * done)) not in shown:
        shown.add(quarter)
        print(f"{done:.0%} done")


state = learning.reinforcement.train(asked, show)

# %% [markdown]
# The folder holds a line for each update. The return of an episode is the sum of its rewards.

# %%
log = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
ended = [line for line in log if line["episodes"]["number"] > 0]
judged = [line for line in log if "evaluation" in line]
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3), layout="constrained")
for panel, name in ((left, "return"), (right, "completed")):
    steps = [line["steps"] / 1000 for line in ended]
    panel.plot(steps, [line["episodes"][name] for line in ended], color="#8d99b3", label="episodes of the training")
    found = [line["evaluation"][name] for line in judged]
    panel.plot(
        [line["steps"] / 1000 for line in judged], found, "o-", color="#f58a07", label="evaluations, without chance"
    )
    panel.set(xlabel="1000 scenario-steps", ylabel=name)
left.legend(frameon=False, fontsize=8)
plt.show()
print(f"{log[-1]['steps']:,} scenario-steps at {np.median([line['per_second'] for line in log]):,.0f} a second")

# %% [markdown]
# ## Before and after
# The agent before its first update, the best agent of the training and `go_to_goal` drive the same new episodes.
# Each line is the path of a robot from its start (a dot) to its goal (a star), in the first few episodes.

# %%
network = policy.agent_network(asked, env.observation_space)
begun = networks.init_agent(network, env.observations, env.observation_space, jax.random.key(1))
trained = learning.load(folder, scenario)
untrained = trained.replace(params=policy.agent_policy(network, begun, env.observations).params)  # the same program
drivers = {"untrained": untrained, "trained": trained, "go_to_goal": go_to_goal}
keys = jax.random.split(jax.random.key(7), EPISODES)
drive = jax.jit(jax.vmap(lambda driver, key: sean_jax.rollout(scenario, driver, key, STEPS), (None, 0)))
drives = {}
figure, panels = plt.subplots(1, 3, figsize=(12, 3), layout="constrained")
for panel, (name, driver) in zip(panels, drivers.items(), strict=True):
    final, frames = drives[name] = drive(as_policy(driver), keys)
    layers.draw_obstacles(panel, scenario.environment)
    for number in range(min(8, EPISODES)):
        way = np.asarray(frames.position[number])[np.asarray(frames.active[number])]
        (line,) = panel.plot(*way.T, lw=1.2)
        panel.plot(*way[0], ".", color=line.get_color())
        panel.plot(*final.task.goal[number], "*", ms=9, color=line.get_color())
    low_x, low_y, high_x, high_y = np.asarray(scenario.environment.floor)
    panel.set(aspect="equal", xlim=(low_x, high_x), ylim=(low_y, high_y), xticks=[], yticks=[])
    panel.set_title(f"{name}: {int(final.completed.sum())} of {EPISODES} completed", fontsize=10)
plt.show()

# %% [markdown]
# One of these episodes with its people, the robot's path in the colors of the social situations:

# %%
sean_jax.view(jax.tree.map(lambda leaf: leaf[0], drives["trained"][1]), scenario)

# %% [markdown]
# ## Compared with `go_to_goal`
# Metrics of all of these episodes with 95 % bootstrap intervals. Violations of the intimate space (0.45 m) and of the
# personal space (1.2 m) by the robot are counts per episode; path efficiency is the length of the path over the
# shortest path, in completed episodes. `sean_jax.evaluate(scenario, trained)` has all metrics and a report.

# %%
names = ("path_efficiency", "personal_robot_on_person", "intimate_robot_on_person")
seconds, arrived = {}, {}
titles = ("seconds", "completed", "path efficiency", "personal, robot on person", "intimate, robot on person")
figure, panels = plt.subplots(1, 5, figsize=(12, 2.8), layout="constrained")
for row, (name, (final, _)) in enumerate(drives.items()):
    found = jax.vmap(lambda state: sean_jax.results(scenario, state))(final)
    values = [found["time_in_situation"][:, 0], final.completed, *(found[key] for key in names)]
    seconds[name], arrived[name] = values[0].mean(), values[1].mean()
    for panel, value, title in zip(panels, values, titles, strict=True):
        value = np.asarray(value, float)
        counted = np.asarray(final.completed) if title == "path efficiency" else None  # which is of whole ways
        part = metrics.aggregate(value if value.ndim == 1 else value[:, 0], counted)
        panel.bar(row, part.mean, color=("#c8cfdc", "#f58a07", "#8d99b3")[row])
        panel.errorbar(row, part.mean, [[part.mean - part.low], [part.high - part.mean]], color="#1c2333", capsize=3)
        panel.set_title(title, fontsize=9)
        panel.set_xticks(range(3), ("untrained", "trained", "go_to\n_goal"), fontsize=7)
        print(f"{name:11} {title:26} {part.mean:6.2f} ({part.low:.2f} to {part.high:.2f})")
plt.show()
assert arrived["trained"] > 0.6 > arrived["untrained"], "the robot should have learned to join a group"
assert seconds["trained"] < 1.4 * seconds["go_to_goal"], "and need little more time than go_to_goal"

# %% [markdown]
# ## Next steps
# - Other rewards: `PPOConfig(..., rewards=["default", "my.py:thing"])`, and `make_env(scenario, rewards={...})`.
# - A real robot does not know people behind walls: `observations=["goal", "path", "distance", "speeds", "time",
#   "lidar"]`.
# - Keep the agent: `learning.pack(folder, "my_agent")` writes two small files for `sean run --policy ./my_agent`.
# - The package has trained agents: `learning.load("ppo", scenario)`.
