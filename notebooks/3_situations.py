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
# # Situations in simulations and recordings
# Section III of the paper defines in logic when a robot crosses a person's path, goes down a path with a person, joins
# a group, leaves a group, or is alone. We plot the predicates, then the five situations in scenes placed by hand,
# and then classify a recording of people: first a simulated recording, then yours.
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
import dataclasses

from sean_jax import compiler

compiler.configure()  # before jax: caches compiled programs, so a second run compiles nothing

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import sean_jax
from sean_jax import classifiers, metrics, recordings
from sean_jax.base import Pedestrians, Snapshot
from sean_jax.classifiers import predicates
from sean_jax.drawing import situation_colors
from sean_jax.policies import POLICIES

PEOPLE = 36  # of the simulated recording
EPISODES = 4  # at once
STEPS = 600  # of 0.1 s: a minute
NAMES = tuple(sean_jax.SITUATIONS)
thresholds = classifiers.thresholds()
print("D", thresholds.near, "m; V", thresholds.walking, "m/s; A", jnp.rad2deg(thresholds.angle), "degrees")

# %% [markdown]
# ## Four predicates
# They take vectors in the plane and give true or false:
#
# - *Near*: two positions are less than D = 2.4 m apart, twice Hall's personal distance.
# - *Walking*: a velocity is more than V = 1.4 m/s long, a person's usual speed.
# - *PerpTraj*: two orientations are at a right angle, give or take A = 15 degrees.
# - *ParTraj*: two orientations are the same, give or take A.
#
# `vmap` evaluates each predicate on a whole map. The robot stands in the middle and looks to the right.

# %%
axis = jnp.linspace(-3.2, 3.2, 161)
places = jnp.stack(jnp.meshgrid(axis, axis), -1)
robot, ahead = jnp.zeros(2), jnp.array([1.0, 0.0])


def over_the_map(predicate):
    """(161, 161) bool: the predicate of each vector of the map."""
    return jax.jit(jax.vmap(jax.vmap(predicate)))(places)


panels = {
    "Near: where they are": over_the_map(lambda x: predicates.near(robot, x, thresholds.near)),
    "Walking: their velocity": over_the_map(lambda v: predicates.walking(v, thresholds.walking)),
    "PerpTraj: their orientation": over_the_map(
        lambda d: predicates.perpendicular_trajectory(ahead, d, thresholds.angle)
    ),
    "ParTraj: their orientation": over_the_map(lambda d: predicates.parallel_trajectory(ahead, d, thresholds.angle)),
}
figure, axes = plt.subplots(1, 4, figsize=(12, 3.2), layout="constrained")
for panel, (title, holds) in zip(axes, panels.items(), strict=True):
    panel.imshow(holds, origin="lower", extent=(-3.2, 3.2, -3.2, 3.2), cmap="Blues", vmin=0, vmax=2)
    panel.plot(0, 0, "s", color="#f58a07", markersize=9)
    panel.annotate("", (0.9, 0), (0, 0), arrowprops={"arrowstyle": "->", "color": "#5e3200"})
    panel.set_title(title, fontsize=10)

# %% [markdown]
# ## A snapshot
# Classifiers read a `Snapshot`: a robot among people as arrays, from a simulation, from sensors or
# written by hand. Here the robot is at the origin; people are (position, orientation in degrees, speed, group), and
# the group is -1 for people outside groups. *Member* is an input: here it is the number of the group.


# %%
def scene(*people, start_group=-1, goal_group=-1, goal=(9.0, 0.0)) -> Snapshot:
    """A robot at the origin that looks along x, and people around it."""
    places, degrees, speeds, groups = (np.array(part, np.float32) for part in zip(*people, strict=True))
    facing = np.stack([np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))], -1).astype(np.float32)
    number = len(people)
    persons = Pedestrians(
        position=jnp.asarray(places),
        velocity=jnp.asarray(facing * speeds[:, None]),
        heading=jnp.asarray(facing),
        desired_velocity=jnp.zeros((number, 2)),
        group=jnp.asarray(groups, jnp.int32),
        walking_group=jnp.full(number, -1),
        present=jnp.ones(number, bool),
        preferred_speed=jnp.ones(number),
        robot_distance=jnp.zeros(number),
    )
    return Snapshot(
        people=persons,
        position=jnp.zeros(2),
        heading=jnp.array([1.0, 0.0]),
        velocity=jnp.array([0.5, 0.0]),
        start=jnp.zeros(2),
        goal=jnp.asarray(goal, jnp.float32),
        start_group=jnp.int32(start_group),
        goal_group=jnp.int32(goal_group),
        geodesic=jnp.float32(9.0),
        situations=jnp.zeros(len(NAMES), bool),
        tick=jnp.int32(0),
        robot_radius=jnp.float32(0.16),
        person_radius=jnp.float32(0.2),
        time_step=0.1,
    )


classify = jax.jit(lambda snapshot: classifiers.classify(snapshot, thresholds))
two_talking = (((1.6, 0.5), 200, 0.0, 0), ((0.9, 1.5), 280, 0.0, 0))
examples = [
    scene(((1.5, -0.8), 90, 1.5, -1)),
    scene(((1.2, 0.9), 8, 1.0, -1)),
    scene(*two_talking, goal_group=0, goal=(0.7, 0.7)),
    scene(*two_talking, start_group=0),
    scene(((2.6, 0.6), 180, 1.5, -1)),
]
for snapshot in examples:
    print([name for name, holds in zip(NAMES, classify(snapshot), strict=True) if holds])
assert (np.array([classify(snapshot) for snapshot in examples]) == np.eye(5, dtype=bool)).all(), "each is in one alone"

# %% [markdown]
# ## The five situations
# Pictures of the same snapshots: the robot is the orange square, people are discs with their orientation, an arrow is
# the motion in one second, members of a group are blue, and the circle is D. The titles are the classified situations.


# %%
def draw(panel, snapshot):
    """One panel: robot, people, and the names of the situations, in their colors."""
    names = [name for name, holds in zip(NAMES, classify(snapshot), strict=True) if holds]
    panel.add_patch(plt.Circle((0, 0), float(thresholds.near), fill=False, linestyle=":", color="#6c7589"))
    panel.add_patch(plt.Rectangle((-0.16, -0.16), 0.32, 0.32, color="#f58a07"))
    panel.annotate("", (0.5, 0), (0.16, 0), arrowprops={"arrowstyle": "->", "color": "#5e3200"})
    people = snapshot.people
    for place, velocity, facing, group in zip(
        people.position, people.velocity, people.heading, people.group, strict=True
    ):
        face = "#6fd0ea" if group >= 0 else "#fdfefd"
        panel.plot(*np.stack([place, place + 0.42 * facing]).T, color="#2b3448", linewidth=2)
        panel.add_patch(plt.Circle(place, 0.2, facecolor=face, edgecolor="#2b3448", zorder=3))
        if jnp.any(velocity != 0):
            panel.annotate("", place + velocity, place, arrowprops={"arrowstyle": "->", "color": "#2b3448"}, zorder=4)
    if snapshot.goal_group >= 0:
        panel.add_patch(plt.Circle(snapshot.goal, 0.16, fill=False, color="#f58a07", linewidth=2))
    panel.set(xlim=(-2.7, 3.2), ylim=(-2.7, 2.7), aspect="equal", xticks=[], yticks=[])
    color = situation_colors((names[0],))[0] if names else "#5a6274"
    panel.set_title(" and ".join(names).replace("_", " ") or "none", color=color, fontsize=11, weight="bold")


figure, axes = plt.subplots(1, 5, figsize=(14, 2.9), layout="constrained")
for panel, snapshot in zip(axes, examples, strict=True):
    draw(panel, snapshot)

# %% [markdown]
# Three details. *Down path* does not require that the person walks, and a person who comes the other way is in no
# situation. *Join group* ends when the robot is at its goal, *leave group* only when it is far from the group. And one
# person is enough: a situation holds if its equation holds for any person, so several can hold at once.
#
# How sharp are the limits? We turn one person who stands 1.5 m away, and change how fast they walk.

# %%
degrees, speeds = jnp.linspace(-180.0, 180.0, 361), jnp.linspace(0.0, 2.0, 100)
one = scene(((1.5, 0.0), 0, 0.0, -1))


def turned(angle, speed):
    """(5,) bool: the situations if the person looks and walks in that direction."""
    facing = jnp.stack([jnp.cos(jnp.deg2rad(angle)), jnp.sin(jnp.deg2rad(angle))])
    people = dataclasses.replace(one.people, heading=facing[None], velocity=speed * facing[None])
    return classifiers.classify(dataclasses.replace(one, people=people), thresholds)


held = jax.jit(jax.vmap(jax.vmap(turned, (0, None)), (None, 0)))(degrees, speeds)  # (speed, angle, situation)
assert held[0, 180, NAMES.index("down_path")], "a person who stands and looks the robot's way is enough"
assert not held[:, 0].any(), "a person who comes the other way is in no situation"
figure, panel = plt.subplots(figsize=(8, 2.8), layout="constrained")
for name, color in zip(NAMES[:2], situation_colors(NAMES[:2]), strict=True):
    panel.contourf(degrees, speeds, held[..., NAMES.index(name)], levels=[0.5, 1.5], colors=[color])
    panel.plot([], [], "s", color=color, label=name.replace("_", " "))
panel.set(xlabel="orientation relative to the robot's [degrees]", ylabel="speed [m/s]", xticks=range(-180, 181, 45))
panel.legend(loc="upper left", frameon=False)
plt.show()

# %% [markdown]
# ## A recording
# To need no data, we simulate a recording: robots that join groups in the warehouse. The people of the first
# episode are written in the usual format, a table of frame, person, x and y, here every 0.4 s.

# %%
scenario = sean_jax.make("warehouse", behavior="graph", task="join_group", people=PEOPLE)


@jax.jit
def episodes(keys):
    return jax.vmap(lambda key: sean_jax.rollout(scenario, POLICIES["go_to_goal"], key, steps=STEPS))(keys)


last, trajectory = episodes(jax.random.split(jax.random.key(1), EPISODES))
EVERY = 4  # steps from one frame to the next
shown = slice(0, int(trajectory.active[0].sum()), EVERY)  # until the robot has been at its goal for 5 s
people = np.asarray(trajectory.people[0, shown])
rows = [f"{EVERY * t},{n},{x:.3f},{y:.3f}" for t, frame in enumerate(people) for n, (x, y) in enumerate(frame)]
with open("people.csv", "w") as file:
    file.write("\n".join(["frame,id,x,y", *rows]) + "\n")
print(len(rows), "lines, such as", rows[0])

# %% [markdown]
# The same line reads your own file. The formats `eth_ucy` and `juelich` have their own clocks and need no frame rate.
# Positions are noisy, so velocities are slopes of lines fitted to a few positions, and orientations are directions of
# motion.

# %%
tracks = recordings.read("people.csv", frame_rate=10)
path = trajectory.position[0, shown]  # any path (T, 2) can play the robot
snapshots = recordings.snapshots_along(tracks, path, window=1)  # lines through three frames
flags = np.asarray(jax.jit(jax.vmap(lambda snapshot: classifiers.classify(snapshot, thresholds)))(snapshots))
simulated = np.asarray(trajectory.situations[0, shown])
for k, name in enumerate(NAMES):
    print(f"{name:12} {flags[:, k].mean():6.1%} recorded {simulated[:, k].mean():6.1%} simulated, "
          f"equal in {(flags[:, k] == simulated[:, k]).mean():6.1%} of the frames")  # fmt: skip

# %% [markdown]
# A table of positions has no groups, so the recording has no join group. `snapshots_of` puts a recorded person in place
# of the robot and takes annotated groups, and `classifiers.o_space_groups` estimates groups from positions and
# orientations.
#
# Over time, the simulation above and the recording below:

# %%
time = 0.1 * EVERY * np.arange(len(flags))
figure, axes = plt.subplots(2, 1, figsize=(11, 3.6), sharex=True, layout="constrained")
for panel, told, title in zip(axes, (simulated, flags), ("simulated", "recorded"), strict=True):
    for k, color in enumerate(situation_colors(NAMES)):
        panel.bar(time[told[:, k]], 0.8, width=0.1 * EVERY, bottom=k + 0.1, align="edge", color=color)
    panel.set_yticks(np.arange(len(NAMES)) + 0.5, [name.replace("_", " ") for name in NAMES], fontsize=8)
    panel.set(ylim=(len(NAMES), 0), ylabel=title)
axes[1].set_xlabel("time [s]")
plt.show()

# %% [markdown]
# ## Other definitions
# SEAN 2.0's code differs from its paper, and the package has more than five situations. Each set is a dict of such
# functions, and `make(situations=...)` takes its name or your own dict. On the same recording:

# %%
for name, laws in classifiers.SITUATION_SETS.items():
    values, chosen = classifiers.THRESHOLD_SETS[name](), tuple(laws.items())
    told = jax.jit(jax.vmap(lambda snapshot: classifiers.classify(snapshot, values, chosen)))(snapshots)  # noqa: B023
    print(name + ":", ", ".join(f"{law} {share:.0%}" for law, share in zip(laws, told.mean(0), strict=True)))

# %% [markdown]
# And the simulated episodes, with intervals over episodes: shares of the robots' time, as in Table I of the paper.

# %%
spent = jax.vmap(lambda state: sean_jax.results(scenario, state))(last)["time_in_situation"]
for k, name in enumerate(NAMES):
    share = metrics.aggregate_ratio(spent[:, 1 + k], spent[:, 0])
    print(f"{name:12} {share.mean:6.1%}, from {share.low:.1%} to {share.high:.1%}")

# %% [markdown]
# ## Your own
# Your own situation is a function of a snapshot. Your own metric is a constructor applied to a function: the
# time during which a condition holds, the number of its onsets, the sum or the mean of an amount, an extreme of a
# quantity ([docs/metrics.md](../docs/metrics.md)). Both work on recordings and in scenarios.


# %%
def watched(snapshot, thresholds):
    """A person within 3.6 m looks at the robot, to within the angle A."""

    def looks(person):
        toward = predicates.cosine(person.heading, snapshot.position - person.position)
        near = predicates.near(snapshot.position, person.position, thresholds.reach)
        return near & (toward >= jnp.cos(thresholds.angle))

    return predicates.any_person(snapshot, looks)


def watched_now(snapshot):
    """A person looks at the robot."""
    return watched(snapshot, thresholds)


own = (("time_watched", metrics.duration(watched_now)), ("times_watched", metrics.count_onsets(watched_now)))


@jax.jit
def measure(snapshots):
    """Our metrics along a recording."""
    first, before, after = (
        jax.tree.map(lambda x, part=part: x[part], snapshots) for part in (0, np.s_[:-1], np.s_[1:])
    )

    def update(values, pair):
        return {name: metric.update(values[name], *pair) for name, metric in own}, None

    values, _ = jax.lax.scan(update, {name: metric.init(first) for name, metric in own}, (before, after))
    return {name: metric.compute(values[name]) for name, metric in own}


found = measure(snapshots)
print(f"in the recording: watched {found['times_watched'][0]:.0f} times, for {found['time_watched'][0]:.1f} s")
mine = scenario.replace(situations=(*scenario.situations, ("watched", watched)), metrics=(*scenario.metrics, *own))
print("in a scenario:", ", ".join(name for name, _ in mine.situations), "and", len(mine.metrics), "metrics")
