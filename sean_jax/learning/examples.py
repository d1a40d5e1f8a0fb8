"""Examples (section V-B): what the network is shown, and what it shall answer, at one second of a demonstration.

The paper's example has 5 depth images, a local plan of 5 points of the expert's most recent trajectory, 10 points of
the global plan and a flag for each situation, at 1 Hz. The network of [50] is to *predict* the local plan: what is the
most recent trajectory at the end of five seconds lay ahead at their beginning. So what the local planner has to answer
are the places of the next five seconds, in the robot's frame of now; those of the past five are given as well.
"""

from typing import Any

import jax.numpy as jnp
from flax import struct

from sean_jax.base import Array
from sean_jax.geometry import rotate
from sean_jax.learning.rows import Row

SECONDS = 5  # of depth images, and of the local plan


@struct.dataclass
class Recording:
    """Demonstrations, one after the other."""

    rows: Row  # (R, ...)
    first: Array  # (R,) int32 row at which the episode of this row begins
    end: Array  # (R,) int32 row after its last


@struct.dataclass
class Example:
    images: Array  # (5, H, W) uint16 mm, the oldest first and that of now last; the first of the episode before it
    plan: Array  # (10, 2) m, global plan in the robot's frame
    situations: Array  # (S,) bool
    past: Array  # (5, 2) m, where the robot was 5 to 1 s ago, in its frame of now
    future: Array  # (5, 2) m, where it is in 1 to 5 s: the local plan that is to be predicted
    known: Array  # (5,) bool, whether the episode lasted until then
    command: Array  # (2,) m/s, rad/s, that is to be predicted


def example(recording: Recording, index: Any, xp: Any = jnp) -> Example:
    """The example at one row () of a recording, or those at rows (B,).

    ``xp`` is numpy where the recording is of numpy arrays.
    """
    rows, first, last = recording.rows, recording.first[index][..., None], recording.end[index][..., None] - 1
    ages = xp.arange(SECONDS, dtype=xp.int32).reshape((1,) * (first.ndim - 1) + (SECONDS,))
    here = index[..., None]
    seen = xp.maximum(here - (SECONDS - 1) + ages, first)
    before = xp.maximum(here - SECONDS + ages, first)
    after = here + 1 + ages
    pose = rows.pose[index]
    return Example(
        images=rows.depth[seen],
        plan=rows.plan[index],
        situations=rows.situations[index],
        past=in_frame(pose, rows.pose[before, :2], xp),
        future=in_frame(pose, rows.pose[xp.minimum(after, last), :2], xp),
        known=after <= last,
        command=rows.command[index],
    )


def in_frame(pose: Array, places: Array, xp: Any = jnp) -> Array:
    """(..., K, 2) m: places (..., K, 2) of the floor as seen from a pose (..., 4), x ahead and y to the left."""
    dx, dy = places[..., 0] - pose[..., 0:1], places[..., 1] - pose[..., 1:2]
    return xp.stack(rotate(dx, dy, pose[..., 2:3], -pose[..., 3:4]), -1)
