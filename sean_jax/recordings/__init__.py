"""Recorded people: readers of trajectory files, motion from noisy positions, snapshots that classifiers can read.

A recording serves as evidence for the situations of section III, which speak of positions, orientations and
velocities "provided in simulation or estimated in the real world".
"""

from sean_jax.recordings.motion import (
    fit_motion,
    headings,
    motion_between_rows,
    snapshots_along,
    snapshots_of,
    windowed_mean,
)
from sean_jax.recordings.reading import (
    READERS,
    Tracks,
    check_clock,
    read,
    read_companions,
    read_csv,
    read_eth_ucy,
    read_groups,
    read_juelich,
)

__all__ = [
    "READERS",
    "Tracks",
    "check_clock",
    "fit_motion",
    "headings",
    "snapshots_along",
    "snapshots_of",
    "motion_between_rows",
    "read",
    "read_companions",
    "read_csv",
    "read_eth_ucy",
    "read_groups",
    "read_juelich",
    "windowed_mean",
]
