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
# # Thousands of scenarios
# One jitted call steps thousands of scenarios, on one device or on several. We measure the speed of this machine and
# the time of each stage, and run two sweeps: over the number of people, and over a constant of their forces. All times
# on this page are measured on the machine that runs it; they differ on other or busy machines.
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
import os
import time
from functools import partial
from pathlib import Path

from sean_jax import compiler

compiler.configure()  # before jax: caches compiled programs, so a second run compiles nothing

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import sean_jax
from sean_jax import devices, metrics
from sean_jax import scenario as stages
from sean_jax.drawing import layers
from sean_jax.policies import go_to_goal

PEOPLE = 12  # in the lab
SCENARIOS = 1024  # at once
EPISODES = 16  # of each value of a sweep
STEPS = 300  # of 0.1 s, of the episodes of a sweep
print(f"{len(jax.devices())} devices, such as {jax.devices()[0].device_kind}; {os.cpu_count()} CPU cores")

# %% [markdown]
# ## One call
# A batch is a `vmap` over keys, and `rollout` a scan over steps. `record` selects what is stored of each step, here
# only the robot's position, since whole trajectories of so many scenarios would fill the memory.

# %%
lab = sean_jax.make("lab", task="join_group", people=PEOPLE)


def place(before, after, action):
    """The robot's position [m] and whether its episode is active."""
    return after.robot.position, before.completed | before.timed_out


@jax.jit
def batch(keys):
    """Two seconds of a scenario for each key."""
    return jax.vmap(lambda key: sean_jax.rollout(lab, go_to_goal, key, 20, place))(keys)


states, (places, over) = batch(jax.random.split(jax.random.key(0), SCENARIOS))
x0, y0, x1, y1 = np.asarray(lab.environment.floor)
found = np.asarray(places)[~np.asarray(over)]
rows, columns = round(4 * (y1 - y0)), round(4 * (x1 - x0))
seconds = 0.1 * np.histogram2d(found[:, 1], found[:, 0], (rows, columns), ((y0, y1), (x0, x1)))[0]
figure, axes = layers.canvas(lab.environment, 6.4, f"where {SCENARIOS} robots were in their first 2 s")
layers.draw_heat(axes, lab.environment, seconds * 16, "robot-seconds per m²")  # of cells of 1/16 m2
layers.draw_obstacles(axes, lab.environment)
figure

# %% [markdown]
# ## Speed by batch size
# A program is compiled for each batch size. With a single scenario most of the time is overhead between small
# operations; a batch shares the overhead. The speed grows until all cores are busy and falls again when the
# batch exceeds the caches: on a CPU after tens or hundreds of scenarios, on a GPU after tens of thousands.

# %%
command = jnp.array([0.3, 0.2])


def timed(function, states):
    """(s to compile, the lesser of two times [s], result) of a function of one state."""
    began = time.perf_counter()
    compiled = jax.jit(jax.vmap(function)).lower(states).compile()
    compiling, spent = time.perf_counter() - began, []
    for _ in range(3):  # the first warms up
        began = time.perf_counter()
        result = jax.block_until_ready(compiled(states))
        spent.append(time.perf_counter() - began)
    return compiling, min(spent[1:]), result


def a_second(lab, state):
    """Ten steps of a scenario."""
    return jax.lax.scan(lambda state, _: (sean_jax.step(lab, state, command), None), state, length=10)[0]


sizes = [size for size in (1, 256) if size < SCENARIOS] + [SCENARIOS]
part = {size: jax.tree.map(lambda leaf: leaf[:size], states) for size in sizes}  # noqa: B023
compiling, spent, (*_, after) = zip(*(timed(partial(a_second, lab), part[size]) for size in sizes), strict=True)
spent = np.array(spent)
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3), layout="constrained")
left.loglog(sizes, 10 * np.array(sizes) / spent, "o-", color="#f58a07")
left.set(xlabel="scenarios at once", ylabel="scenario-steps per second", title="together")
right.loglog(sizes, 1e5 * spent, "o-", color="#2f6fb0", label="a step of all [µs]")
right.loglog(sizes, 1e5 * spent / sizes, "o-", color="#8d99b3", label="a step of each [µs]")
right.set(xlabel="scenarios at once", title="a step")
right.legend(frameon=False, fontsize=8)
plt.show()
for size, first, each in zip(sizes, compiling, spent, strict=True):
    print(f"{size:6}: compiled in {first:4.1f} s, {10 * size / each:9,.0f} scenario-steps/s")

# %% [markdown]
# ## Time of each stage
# `step` has one line for each stage, and each stage is a function of a state. Here each is compiled separately; in the
# step XLA fuses consecutive stages. `sean bench` measures more, and `docs/performance.md` has tables.

# %%
people_key = jax.random.key(3)
alone = {
    "direct the pedestrians": lambda state: stages.direct_pedestrians(lab, state, people_key),
    "move the pedestrians": lambda state: stages.move_pedestrians(lab, state),
    "move the robot": lambda state: stages.move_robot(lab, state, command),
    "classify": lambda state: stages.classify(lab, state).situations,
    "measure": lambda state: stages.measure(lab, state, state).metrics,
    "policy": lambda state: go_to_goal(lab, state, people_key),
    "observe": lambda state: sean_jax.observe(lab, state),
}
size = min(256, SCENARIOS)
each = {name: timed(one, part[size])[1] for name, one in alone.items()}
figure, panel = plt.subplots(figsize=(7, 2.6), layout="constrained")
bars = panel.barh(list(each), 1e6 * np.array(list(each.values())) / size, color="#2f6fb0")
panel.bar_label(bars, fmt="%.1f", padding=3)
panel.set(xlabel=f"µs for each of {size} scenarios", xlim=(0, 1.15e6 * max(each.values()) / size))
panel.invert_yaxis()
plt.show()

# %% [markdown]
# ## Several devices
# `devices.mesh()` is a mesh of all devices, and `devices.shard` distributes the scenarios over it: `jit` of `vmap`,
# with the first argument on every device and the others split. It also works with one device. `devices.keys` draws the
# keys of the episodes on the devices, each from its number, so the results do not depend on the number of devices,
# except for rounding. `docs/devices.md` continues with several hosts. To try several devices on a CPU, set
# `XLA_FLAGS=--xla_force_host_platform_device_count=2` before jax is imported.

# %%
mesh = devices.mesh()
run = devices.shard(mesh, a_second)
spread = run(devices.replicate(mesh, lab), devices.split(mesh, states)).pedestrians.position
share = spread.addressable_shards[0].data.shape[0]
print(f"{SCENARIOS} scenarios over the mesh {dict(mesh.shape)}, {share} on each device")
apart = np.abs(np.asarray(spread) - np.asarray(after.pedestrians.position)).max()
print(f"people at most {apart:.1g} m from where the program above had them")
assert apart < 1e-3, "the results should not depend on the devices"

# %% [markdown]
# ## Sweeps
# Parameters of experiments are leaves of the scenario, so a sweep is a `vmap` over scenarios: all values and all
# episodes are one call. `people_present` is the number of people present, and `forces.tree_replace` changes a
# constant of the social forces by its name. Each value has the same episodes.


# %%
TITLES = (
    f"length of the episode, at most {STEPS / 10:g} s",
    "the robot in a personal space, times",
    "people's mean speed [m/s]",
)


def measured(number, strength, key):
    """Three numbers of an episode with this number of people and this strength of repulsion [m/s2]."""
    forces = lab.forces.tree_replace({"repulsion.strength": strength})
    scenario = lab.replace(people_present=number, forces=forces)

    def speed(before, after, action):
        people = after.pedestrians
        return jnp.where(people.present, jnp.linalg.norm(people.velocity, axis=-1), 0.0).sum() / people.present.sum()

    last, speeds = sean_jax.rollout(scenario, go_to_goal, key, STEPS, speed)
    found = sean_jax.results(scenario, last)
    return found["time_in_situation"][0], found["personal_robot_on_person"][0], speeds.mean()


@jax.jit
def sweep(numbers, strengths):
    """Three arrays (values, EPISODES)."""
    episodes = jax.vmap(measured, (None, None, 0))
    return jax.vmap(episodes, (0, 0, None))(numbers, strengths, jax.random.split(jax.random.key(1), EPISODES))


usual = lab.forces.repulsion.strength
values = 6
numbers = jnp.linspace(2, PEOPLE, values).round().astype(int)
strengths = jnp.linspace(0.0, 3.0, values) * usual
began = time.perf_counter()
program = sweep.lower(numbers, strengths).compile()
compiled = time.perf_counter()
by_number = program(numbers, jnp.full(values, usual))
by_strength = jax.block_until_ready(program(jnp.full(values, PEOPLE), strengths))
print(f"compiled in {compiled - began:.1f} s")
print(f"{2 * values * EPISODES} episodes of {STEPS / 10:g} s ran in {time.perf_counter() - compiled:.1f} s")

# %% [markdown]
# Means over the episodes, with 95 % bootstrap intervals: with more people the robot needs more time and people come
# closer. A slope within its intervals is not significant without more episodes.

# %%
rows = (("people who are there", numbers, by_number), ("strength of the repulsion [m/s2]", strengths, by_strength))
figure, panels = plt.subplots(2, 3, figsize=(11, 5), layout="constrained", sharey="col")
for row, (name, x, columns), color in zip(panels, rows, ("#2f6fb0", "#f58a07"), strict=True):
    for panel, title, one in zip(row, TITLES, columns, strict=True):
        told = [metrics.aggregate(np.asarray(value)) for value in one]
        panel.plot(x, [each.mean for each in told], "o-", ms=4, color=color)
        panel.fill_between(x, [each.low for each in told], [each.high for each in told], color=color, alpha=0.2)
        panel.set_xlabel(name)
        panel.set_title(title, fontsize=9)
plt.show()
length, violations, _ = by_number
assert length[-1].mean() > length[0].mean(), "with more people the robot should need more time"
assert violations[-1].mean() > violations[0].mean(), "and they should come closer"

# %% [markdown]
# ## The compilation cache
# Compilation takes longer than a run, unless the batch is large or the episode long. `compiler.configure()` caches
# compiled programs on disk, like the command line, keyed by their content: after `jax.clear_caches()`,
# as in a new process, a function is traced again and its program is read from disk.

# %%
jax.clear_caches()
began = time.perf_counter()
jax.jit(jax.vmap(partial(a_second, lab))).lower(states).compile()
again = time.perf_counter() - began
print(f"a second of {SCENARIOS} scenarios: compiled in {compiling[-1]:.1f} s, traced and read again in {again:.1f} s")
kept = [path for path in Path(jax.config.jax_compilation_cache_dir).iterdir() if path.is_file()]
print(f"{len(kept)} files of programs, {sum(path.stat().st_size for path in kept) / 2**20:.0f} MiB, are kept")
