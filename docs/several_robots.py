"""Draws docs/pictures/several-robots.png, two robots that cross among people: python docs/several_robots.py.

Of 24 episodes in the lab, the one in which two robots that drive in opposite directions, each more than 1.5 m from its
start, come nearest without a contact, until 1.5 seconds later.
"""

from pathlib import Path

import jax
import numpy as np

import sean_jax
from sean_jax import drawing, robots, team
from sean_jax.policies import POLICIES

PICTURES = Path(__file__).resolve().parent / "pictures"

members = sean_jax.make_team("lab", robots="kuri,kuri", behavior="random", people=6)
keys = jax.random.split(jax.random.key(0), 24)
_, frames = jax.jit(jax.vmap(lambda key: team.rollout(members, POLICIES["orca"], key, 200)))(keys)  # (E, T, 2, ...)
radius, step = robots.radius(members.member.robot), members.member.time_step
gap = np.linalg.norm(frames.position[:, :, 0] - frames.position[:, :, 1], axis=-1) - 2.0 * radius
velocity = frames.velocity
driven = np.linalg.norm(frames.position - frames.position[:, :1], axis=-1) > 1.5
passes = (velocity[:, :, 0] * velocity[:, :, 1]).sum(-1) < 0.0
later = round(1.5 / step)
active = np.roll(frames.active.all(-1), -later, axis=1) & (np.arange(200) < 200 - later)
gap = np.where(passes & driven.all(-1) & active, gap, np.inf)
episode = int(np.argmin(np.where(gap.min(1) > 0.1, gap.min(1), np.inf)))
moment = int(gap[episode].argmin()) + later
shown = jax.tree.map(lambda leaf: np.asarray(leaf)[episode, : moment + 1, 0], frames)
names = [name for name, _ in members.member.situations]
picture = drawing.top_down(
    members.member.environment, frames=shown, situations=names, time_step=step, robot_radius=radius
)
picture.savefig(PICTURES / "several-robots.png", dpi=110, pil_kwargs={"optimize": True})
print(f"episode {episode}: {gap[episode].min():.2f} m between the robots after {(moment - later) * step:.1f} s")
