"""Draws docs/pictures/several-robots.png, two robots that cross among people: python docs/several_robots.py.

Of 24 episodes in the lab, the one in which robots that drive come nearest without a contact, until a second later.
"""

from pathlib import Path

import jax
import numpy as np

import sean_jax
from sean_jax import drawing, robots, team
from sean_jax.policies import POLICIES

PICTURES = Path(__file__).resolve().parent / "pictures"

members = sean_jax.make_team("lab", robots="kuri,kuri", behavior="random", people=12)
keys = jax.random.split(jax.random.key(0), 24)
_, frames = jax.jit(jax.vmap(lambda key: team.rollout(members, POLICIES["orca"], key, 200)))(keys)  # (E, T, 2, ...)
radius, step = robots.radius(members.member.robot), members.member.time_step
gap = np.linalg.norm(frames.position[:, :, 0] - frames.position[:, :, 1], axis=-1) - 2.0 * radius
drives = (np.linalg.norm(frames.velocity, axis=-1) > 0.3).all(-1)
gap = np.where(drives & frames.active.all(-1) & (np.arange(200) * step > 5.0), gap, np.inf)
episode = int(np.argmin(np.where(gap.min(1) > 0.1, gap.min(1), np.inf)))
moment = int(gap[episode].argmin()) + round(1.0 / step)
shown = jax.tree.map(lambda leaf: np.asarray(leaf)[episode, : moment + 1, 0], frames)
names = [name for name, _ in members.member.situations]
picture = drawing.top_down(
    members.member.environment, frames=shown, situations=names, time_step=step, robot_radius=radius
)
picture.savefig(PICTURES / "several-robots.png", dpi=110, pil_kwargs={"optimize": True})
print(f"episode {episode}: {gap[episode].min():.2f} m between the robots after {moment * step - 1.0:.1f} s")
