"""Every constant of the social force model (section IV-D), with unit and source, and the named presets.

A constant is a pytree leaf, so ``jax.grad``, ``jax.vmap`` and sweeps over parameters need no wrapper; only the
two laws, which differ in form and not in a number, are static, and friction is None where it shall cost nothing.

Sources: [HM95] Helbing & Molnar, Phys. Rev. E 51, 4282 (1995). [J07] Johansson, Helbing & Shukla, Adv. Complex
Syst. 10, 271 (2007), the elliptical specification II fitted to video. [S2] SEAN 2.0's published code
(yale-sean/social_sim_unity, SFAgent.cs and Parameters.cs), forces divided by its body mass of 80 kg. [M09]
Moussaid et al., Proc. R. Soc. B 276, 2755 (2009). [M10] Moussaid et al., PLoS ONE 5, e10047 (2010). [H00] Helbing,
Farkas & Vicsek, Nature 407, 487 (2000). [K90] Kendon, Conducting Interaction (1990).
"""

import difflib
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from sean_jax.base import Array
from sean_jax.social_forces.repulsion import circular, elliptical, in_cone, in_front

NEGLIGIBLE = 1e-4  # m/s2, of a push


@struct.dataclass
class Parameters:
    """Constants of the force model; all leaves are () arrays."""

    radius: Array  # m, of a body; obstacles are kept out of it
    relaxation_time: Array  # s, in which the desired velocity is taken up
    speed_mean: Array  # m/s, of the preferred speeds drawn per person
    speed_deviation: Array  # m/s, their standard deviation
    speed_least: Array  # m/s, the draw is truncated here ...
    speed_greatest: Array  # m/s, ... and here
    speed_ratio: Array  # 1, greatest speed over preferred speed
    turn_rate: Array  # rad/s, at which a body turns into its direction of motion
    strength: Array  # m/s2, A of the repulsion A exp((reach - b) / range)
    range: Array  # m, B of the repulsion
    reach: Array  # m, added to the exponent's distance (SEAN: both radii and half a metre)
    body: Array  # 1/s2, by which overlapping bodies part: k / m of [H00]
    anticipation: Array  # s, the step that b looks ahead; 0 makes ellipses circles
    own_motion: Array  # 1, share of the own velocity in that step: 0 as in [HM95], 1 as in [J07]
    perception: Array  # m, nobody farther away is felt
    back_weight: Array  # 1, weight of what is not in sight: c of [HM95], lambda of [J07]
    sight_cosine: Array  # 1, cosine of the half angle of sight of [HM95]
    wall_strength: Array  # m/s2
    wall_range: Array  # m
    wall_reach: Array  # m
    wall_lever: Array  # 1/m or 0: 1 multiplies the wall force by the distance, as [S2] does
    side_preference: Array  # m/s2, of the sidestep from oncoming people [44]; positive to the right
    side_cosine: Array  # 1, cosine of the half angle within which somebody counts as oncoming
    side_range: Array  # m, and the distance
    robot_factor_least: Array  # 1, of the repulsion by a moving robot [45], drawn uniformly per person ...
    robot_factor_greatest: Array  # 1, ... up to here; a factor f is a distance of range * ln(f)
    robot_moving: Array  # m/s, a slower robot is avoided like a person
    group_strength: Array  # m/s2, by which an o-space keeps out those who are not members [K90]
    group_range: Array  # m
    lateral_damping: Array  # 1, divides the part of the social force across the heading
    reversing: Array  # 1, share kept of the part of the social force against the heading
    party_gaze: Array  # 1/(s rad), beta1 of [M10]: braking when those one walks with are out of view
    party_view: Array  # rad, half angle of that view
    party_attraction: Array  # m/s2, beta2 of [M10]: pull to the middle of one's party
    party_far: Array  # m, times half the number of companions: the distance from that middle where the pull begins
    party_repulsion: Array  # m/s2, beta3 of [M10]: push from a companion ...
    party_near: Array  # m, ... nearer than that
    party_ramp: Array  # m, over which pull and push fade in; [M10] has steps
    party_slowness: Array  # m/s, by which each companion lowers the preferred speed
    repulsion: Callable = struct.field(pytree_node=False)
    sight: Callable = struct.field(pytree_node=False)
    friction: Array | None = None  # 1/(m s), of bodies that slide along one another: kappa / m of [H00]; None: off


def _leaves(**values: float) -> dict[str, Any]:
    return {name: np.asarray(value, float) for name, value in values.items()}


_HELBING_1995 = dict(
    radius=0.2,  # m: the body that [S2] uses; [HM95] has points
    relaxation_time=0.5,  # [HM95]
    speed_mean=1.34,  # [HM95]
    speed_deviation=0.26,  # [HM95]
    speed_least=0.5,  # ours: about three deviations either side
    speed_greatest=2.2,
    speed_ratio=1.3,  # [HM95]
    turn_rate=2 * np.pi,  # ours: [HM95] turns at once
    strength=2.1 / 0.3,  # [HM95] V0 / sigma
    range=0.3,  # [HM95] sigma
    reach=0.0,
    body=200.0,  # ours: [H00] has 1500, too stiff for a step of 0.05 s (see longest_step)
    anticipation=2.0,  # [HM95]
    own_motion=0.0,  # [HM95]
    perception=1e6,
    back_weight=0.5,  # [HM95] c
    sight_cosine=np.cos(np.deg2rad(100.0)),  # [HM95] 2 phi = 200 degrees
    wall_strength=10.0 / 0.2,  # [HM95] U0 / R
    wall_range=0.2,  # [HM95] R
    wall_reach=0.0,
    wall_lever=0.0,
    side_preference=0.3,  # ours: half of [S2]'s, to the right as [M09] observed
    side_cosine=0.5,  # [S2]
    side_range=4.0,  # ours: two people who close at 2.7 m/s have a second and a half
    robot_factor_least=1.0,  # ours, up to 0.6 m farther than from a person: Vassallo et al. (2017) saw people
    robot_factor_greatest=8.0,  # pass a robot at 0.83 +- 0.27 m
    robot_moving=0.1,  # [S2]
    group_strength=1.0,  # ours: bends a path around the ring, does not stop a member who comes to stand on it
    group_range=0.3,  # ours
    lateral_damping=1.0,
    reversing=1.0,
    party_gaze=4.0,  # [M10]
    party_view=np.deg2rad(90.0),  # [M10]
    party_attraction=3.0,  # [M10]
    party_far=0.8,  # ours, as near; [M10] has 1, and pairs .1 m farther apart
    party_repulsion=1.0,  # [M10]
    party_near=0.8,  # [M10] d0
    party_ramp=0.2,  # ours
    party_slowness=0.06,  # between the two populations of [M10], 0.04 and 0.08
)

_JOHANSSON_2007 = _HELBING_1995 | dict(
    strength=0.04,  # [J07] elliptical II: A
    range=3.22,  # [J07] B
    anticipation=0.5,  # [J07]
    own_motion=1.0,  # [J07]
    back_weight=0.06,  # [J07] lambda
)

_SEAN2 = _HELBING_1995 | dict(
    relaxation_time=0.5,  # [S2] T
    speed_mean=0.6,  # [S2] DESIRED_SPEED, the same for all
    speed_deviation=0.0,
    speed_least=0.6,
    speed_greatest=0.6,
    speed_ratio=1.0,  # [S2] MAX_VEL
    turn_rate=np.deg2rad(120.0),  # [S2]
    strength=500.0 / 80.0,  # [S2] A / m
    range=0.16,  # [S2] B
    reach=0.2 + 0.2 + 0.5,  # [S2] both radii and 0.5 m
    anticipation=0.0,
    perception=2.0,  # [S2]
    back_weight=1.0,  # [S2] looks in all directions
    wall_strength=8000.0 / 80.0,  # [S2] WALL_A / m
    wall_range=0.24,  # [S2] WALL_B
    wall_reach=0.2,  # [S2]
    wall_lever=1.0,  # [S2]
    side_preference=-50.0 / 80.0,  # [S2] A / 10 / m, to the left
    side_range=2.0,  # [S2] perception
    robot_factor_least=0.5,  # [S2]
    robot_factor_greatest=1.0,  # [S2]
    lateral_damping=5.0,  # [S2] LATERAL_DAMPENING
    reversing=0.0,  # [S2]
)

_HELBING_2000 = _HELBING_1995 | dict(
    strength=2000.0 / 80.0,  # [H00] A / m
    range=0.08,  # [H00] B
    reach=0.2 + 0.2,  # [H00] both radii
    body=1.2e5 / 80.0,  # [H00] k / m
    friction=2.4e5 / 80.0,  # [H00] kappa / m
    anticipation=0.0,
    back_weight=1.0,  # [H00] feels in all directions
    wall_strength=2000.0 / 80.0,  # [H00] A / m
    wall_range=0.08,  # [H00] B
    wall_reach=0.2,  # [H00] the radius
)

PRESETS: dict[str, Parameters] = {
    "helbing1995": Parameters(**_leaves(**_HELBING_1995), repulsion=elliptical, sight=in_cone),
    "johansson2007": Parameters(**_leaves(**_JOHANSSON_2007), repulsion=elliptical, sight=in_front),
    "helbing2000": Parameters(**_leaves(**_HELBING_2000), repulsion=circular, sight=in_front),
    "sean2": Parameters(**_leaves(**_SEAN2), repulsion=circular, sight=in_front),
}


def felt_within(parameters: Parameters) -> Array | None:
    """() m, beyond which nobody is felt by more than 1e-4 m/s2; None if the law is not one of ours.

    A push of the elliptical law decays with b, and the ellipse of that b reaches sqrt(b^2 + (y / 2)^2) + y / 2 from the
    other person, y being how far they walk in the time of the anticipation.
    """
    if parameters.repulsion not in (elliptical, circular):
        return None
    b = parameters.reach + parameters.range * jnp.log(jnp.maximum(2.0 * parameters.strength / NEGLIGIBLE, 1.0))
    y = (1.0 + parameters.own_motion) * parameters.anticipation * parameters.speed_ratio * parameters.speed_greatest
    pushed = jnp.sqrt(b * b + 0.25 * y * y) + 0.5 * y
    least = jnp.maximum(parameters.side_range, 2.0 * parameters.radius)
    return jnp.minimum(parameters.perception, jnp.maximum(pushed, least))


def preset(name: str) -> Parameters:
    """The named constants as arrays on the default device.

    Raises:
        ValueError: no preset has that name.
    """
    if name not in PRESETS:
        near = difflib.get_close_matches(name, PRESETS, 1)
        hint = f"; did you mean '{near[0]}'?" if near else ""
        raise ValueError(f"forces: '{name}' is not one of {', '.join(PRESETS)}{hint}")
    return jax.tree.map(lambda value: jnp.asarray(value, float), PRESETS[name])
