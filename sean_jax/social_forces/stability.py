"""How short the steps of the social forces have to be (section IV-D): stiff bodies need short ones."""

import math

import numpy as np

from sean_jax.social_forces.parameters import Parameters

SUBSTEP = 0.05  # s, at most: a tenth of the relaxation time
NEIGHBORS = 6  # whom a body touches in the densest packing, whose stiffest mode has a frequency of sqrt(6 k)
OVERLAP = 0.02  # m, up to which friction is to be stable: a crowd that presses has overlaps of that size
RUBBING = 3  # neighbours that a body slides along at once


def longest_step(parameters: Parameters) -> float:
    """The longest step [s] with which touching bodies stay stable under these constants, 0.05 at most.

    Semi-implicit Euler is stable for a spring of frequency w up to 2 / w, so for bodies of stiffness k = ``body`` in
    the densest packing up to 2 / sqrt(6 k); and for a friction that damps at a rate c up to 2 / c, with c = kappa g
    from each neighbour. Runs on the host.
    """
    stiffness = float(np.max(np.asarray(parameters.body)))
    longest = min(SUBSTEP, 2.0 / math.sqrt(max(NEIGHBORS * stiffness, 1e-9)))
    if parameters.friction is None:
        return longest
    rate = RUBBING * OVERLAP * float(np.max(np.asarray(parameters.friction)))
    return min(longest, 2.0 / max(rate, 1e-9))


def substeps(parameters: Parameters, time_step: float) -> int:
    """Into how many steps of the social forces a step of control [s] is divided."""
    return math.ceil(time_step / longest_step(parameters) - 1e-6)
