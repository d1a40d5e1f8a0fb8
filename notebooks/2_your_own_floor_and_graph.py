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
# # Your own floor and graph
# A floor plan is a picture with dark obstacles; here it is an array with a hall and two routes around a block of
# shelves. A Behavior Graph defines people's goals: they walk between *waypoints* and stand and talk at *groups*, and
# edges with a cost are their routes. We simulate, change one word and simulate again.
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
import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

import sean_jax
from sean_jax import maps
from sean_jax.drawing import congestion_map, graph_sheet
from sean_jax.graph import graph_of
from sean_jax.policies import POLICIES

PEOPLE = 20  # in the hall
EPISODES = 8  # at once
STEPS = 1200  # of 0.1 s: two minutes

# %% [markdown]
# ## The floor
# 240 by 120 cells of 0.1 m, dark for obstacles. A picture of your own floor or a map from a robot also works.
# `map.yaml` has the size of a cell and the position of the lower left corner, as in ROS.

# %%
drawn = Path(mkdtemp())
plan = np.full((120, 240), 254, np.uint8)  # rows from the top, all free
plan[35:85, 90:190] = 0  # the shelves, 10 x 5 m
plan[20:28, 12:20] = plan[92:100, 12:20] = 0  # two pillars
Image.fromarray(plan).save(drawn / "plan.png")
(drawn / "map.yaml").write_text(
    "image: plan.png\nresolution: 0.1\norigin: [-4, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
)
figure, panel = plt.subplots(figsize=(6, 3), layout="constrained")
panel.imshow(plan, cmap="gray", extent=(-4, 20, 0, 12))
panel.set(title="plan.png", xlabel="x [m]", ylabel="y [m]")
plt.show()

# %% [markdown]
# `import_map` covers the dark cells with few upright boxes and writes an environment, a folder with two files: the
# floor, and the boxes as MJCF. `sean import-map map.yaml --out hall` does the same. You can also write the files by
# hand ([docs/environments.md](../docs/environments.md)).

# %%
folder = drawn / "hall"
made = maps.import_map(drawn / "map.yaml", folder, people=PEOPLE)
print(f"{made.boxes} boxes agree with {made.agreement:.2%} of the cells\n")
print((folder / "environment.yaml").read_text())
print((folder / "scene.xml").read_text())

# %% [markdown]
# ## The graph
# `graph.yaml` is the third file: places in metres with x to the right and y up, and the edges between them.

# %%
GRAPH = """
version: 1
c_min: 0.2
c_max: 100
nodes:
  south_west: {kind: waypoint, position: [2.5, 1.8], radius: 1, spawn: 1}
  south_east: {kind: waypoint, position: [17.5, 1.8], radius: 1, spawn: 1}
  north_east: {kind: waypoint, position: [17.5, 10.2], radius: 1, spawn: 1}
  north_west: {kind: waypoint, position: [2.5, 10.2], radius: 1, spawn: 1}
  desk: {kind: group, position: [-1.5, 6], radius: 1, capacity: 3, stay: [10, 20]}
edges:
  - {between: [south_west, south_east], flow: SOUTH}
  - {between: [south_east, north_east], flow: medium}
  - {between: [north_east, north_west], flow: medium}
  - {between: [north_west, south_west], flow: medium}
  - {between: [north_west, desk]}
  - {between: [south_west, desk]}
"""


def hall(south):
    """The scenario with that word on the southern edge: medium, high, low, forward or backward."""
    (folder / "graph.yaml").write_text(GRAPH.replace("SOUTH", south))
    return sean_jax.make(folder, behavior="graph", task="join_group", people=PEOPLE)


# %% [markdown]
# A mistake in these files is reported with the line, the word and a cure:

# %%
try:
    hall("foward")
except ValueError as error:
    print(str(error).replace(str(folder), "hall"))

# %% [markdown]
# The graph: discs in which people aim at points, edges, and a group of three with a free place.

# %%
scenario = hall("medium")
graph = graph_of(scenario)
graph_sheet(scenario.environment, graph)

# %% [markdown]
# ## Density and flow
# A batch of episodes, then the density of people over the floor and the flow along each edge, computed from positions.
# The width of a directed edge is its flow, drawn on the right in walking direction.

# %%
policy = POLICIES["go_to_goal"]
episodes = jax.jit(jax.vmap(lambda scenario, key: sean_jax.rollout(scenario, policy, key, STEPS)[1], (None, 0)))


def watch(scenario):
    """Density (rows, columns) in people per m2 and flow (M, M) in people per minute, means of the episodes."""
    frames = episodes(scenario, jax.random.split(jax.random.key(1), EPISODES))
    found = sean_jax.congestion(scenario, frames, span=STEPS * scenario.time_step)
    return found.density.mean((0, 1)), found.flow.mean((0, 1))


density, flow = watch(scenario)
congestion_map(scenario.environment, density, graph=graph, flow=flow, title="all edges alike")

# %% [markdown]
# ## One word
# With `forward` people take the southern edge from west to east; the opposite direction costs a hundred times as much,
# so they return in the north. Other words are `high` and `low`, for both directions. The graph consists of leaves of
# the scenario, so the program from above runs with the new graph without compiling again.

# %%
oneway = hall("forward")
density_oneway, flow_oneway = watch(oneway)
congestion_map(oneway.environment, density_oneway, graph=graph, flow=flow_oneway, title="south only eastward")

# %%
corners = ["south_west", "south_east", "north_east", "north_west"]
number = {name: index for index, name in enumerate(graph.names)}
for one, other in zip(corners, corners[1:] + corners[:1], strict=True):
    for here, there in ((one, other), (other, one)):
        before, now = (table[number[here], number[there]] for table in (flow, flow_oneway))
        print(f"{here} to {there}: {before:4.1f} people a minute before, {now:4.1f} now")

# What this page says: nobody walks west in the south any more, and more people walk west in the north.
south, north = (number["south_east"], number["south_west"]), (number["north_east"], number["north_west"])
assert flow_oneway[south] < 0.1 * flow[south] and flow_oneway[north] > 1.2 * flow[north]
assert episodes._cache_size() == 1, "the new graph should not compile the program again"

# %% [markdown]
# Two other options belong to `make`, not to the file: with `routing="edge"` people choose again at every node, as in
# SEAN 2.0's code, and with `congestion_cost=20` the cost of an edge increases with the people on it. Your folder also
# works in `sean run --environment path/to/hall`.
