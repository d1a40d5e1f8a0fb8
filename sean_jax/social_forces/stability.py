"""How short the steps of the social forces have to be (section IV-D): stiff bodies need short ones."""

import math

import numpy as np

from sean_jax.social_forces.parameters import Parameters

SUBSTEP = 0.05  # s, at most: a tenth of the relaxation time
NEIGHBORS = 6  # whom a body touches in the densest packing; they make its stiffest mode
OVERLAP = 0.01  # m, up to which friction is stable in that packing; where fewer touch, at deeper overlaps


def longest_step(parameters: Parameters) -> float:
    """The longest step [s] with which touching bodies stay stable under these constants, 0.05 at most.

    Semi-implicit Euler of a spring of frequency w that friction damps at a rate c is stable while
    (w step)^2 + 2 c step < 4. In the densest packing the greatest w^2 is 6 k and, at an overlap g, the greatest c is
    6 kappa g, with k = ``body`` and kappa = ``friction``; that both belong to one motion is the worst case. Runs on
    the host.
    """
    stiffness = NEIGHBORS * max(float(np.max(np.asarray(parameters.body))), 1e-9)
    rubbing = 0.0 if parameters.friction is None else float(np.max(np.asarray(parameters.friction)))
    rate = NEIGHBORS * OVERLAP * rubbing
    return min(SUBSTEP, (math.sqrt(rate**2 + 4.0 * stiffness) - rate) / stiffness)


def substeps(parameters: Parameters, time_step: float) -> int:
    """Into how many steps of the social forces a step of control [s] is divided."""
    return math.ceil(time_step / longest_step(parameters) - 1e-6)
