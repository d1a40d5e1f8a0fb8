"""Presets of the social forces (section IV-D): named constants, each with its source, and YAML files of constants.

[HM95] Helbing & Molnar, Phys. Rev. E 51, 4282 (1995). [J07] Johansson, Helbing & Shukla, Adv. Complex Syst. 10, 271
(2007), the elliptical specification II fitted to video. [S2] SEAN 2.0's published code (yale-sean/social_sim_unity,
SFAgent.cs and Parameters.cs), forces divided by its body mass of 80 kg. [M09] Moussaid et al., Proc. R. Soc. B 276,
2755 (2009). [M10] Moussaid et al., PLoS ONE 5, e10047 (2010). [H00] Helbing, Farkas & Vicsek, Nature 407, 487 (2000).
[K90] Kendon, Conducting Interaction (1990). [C] Fitted to recordings by ``sean calibrate``, and rounded. [D] Found
before that, to meet measured diagrams of speed and density, and distances from a robot. docs/calibration.md tells how.

``sean calibrate`` writes files of constants. Such a file stands wherever a preset can stand: ``sean run --forces
forces.yaml``, ``make(forces="forces.yaml")``.

    preset: calibrated
    parameters:
      repulsion.strength: 1.8
    provenance:
      command: sean calibrate --data recordings
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pydantic
import yaml

from sean_jax import files
from sean_jax.errors import FileError, InputError
from sean_jax.social_forces.forces import Forces, Term, collect
from sean_jax.social_forces.terms import (
    Cohesion,
    Evasion,
    GroupSpace,
    Headway,
    Repulsion,
    RobotRepulsion,
    Sidestep,
    all_round,
    circular,
    elliptical,
    in_cone,
    in_front,
)
from sean_jax.social_forces.walking import Walking
from sean_jax.social_forces.walls import Contact, Walls


def _arrays(**values: float) -> dict[str, Any]:
    """Numbers as arrays of numpy: tables are made at import, before the precision is chosen."""
    return {name: np.asarray(value, float) for name, value in values.items()}


_HELBING_1995 = Forces((
    Walking(**_arrays(
        radius=0.2,  # m: the body that [S2] uses; [HM95] has points
        relaxation_time=0.5,  # [HM95]
        speed_mean=1.34,  # [HM95]
        speed_deviation=0.26,  # [HM95]
        speed_min=0.5,  # ours: about three deviations either side
        speed_max=2.2,
        speed_ratio=1.3,  # [HM95]
        companion_slowdown=0.06,  # between the two populations of [M10], 0.04 and 0.08
        turn_rate=2 * np.pi,  # ours: [HM95] turns at once
        perception=1e6,
        lateral_damping=1.0,
        backward_scale=1.0,
    )),
    Repulsion(law=elliptical, sight=in_cone, **_arrays(
        strength=2.1 / 0.3,  # [HM95] V0 / sigma
        range=0.3,  # [HM95] sigma
        reach=0.0,
        anticipation=2.0,  # [HM95]
        own_motion=0.0,  # [HM95]
        back_weight=0.5,  # [HM95] c
        sight_cosine=np.cos(np.deg2rad(100.0)),  # [HM95] 2 phi = 200 degrees
    )),
    Sidestep(**_arrays(
        preference=0.3,  # ours: half of [S2]'s, to the right as [M09] observed
        cosine=0.5,  # [S2]
        range=4.0,  # ours: two people who close at 2.7 m/s have a second and a half
    )),
    Contact(**_arrays(
        stiffness=200.0,  # ours: [H00] has 1500, too stiff for a step of 0.05 s (see longest_step)
    )),
    RobotRepulsion(**_arrays(
        factor_min=1.0,  # ours, up to 0.6 m farther than from a person: Vassallo et al. (2017) saw people
        factor_max=8.0,  # pass a robot at 0.83 +- 0.27 m
        moving_speed=0.1,  # [S2]
        ramp=0.0,
    )),
    GroupSpace(**_arrays(
        strength=1.0,  # ours: bends a path around the ring, does not stop a member who comes to stand on it
        range=0.3,  # ours
    )),
    Walls(**_arrays(
        strength=10.0 / 0.2,  # [HM95] U0 / R
        range=0.2,  # [HM95] R
        reach=0.0,
        distance_factor=0.0,
    )),
    Cohesion(**_arrays(
        gaze=4.0,  # [M10]
        view_angle=np.deg2rad(90.0),  # [M10]
        attraction=3.0,  # [M10]
        attraction_distance=0.8,  # ours, as repulsion_distance; [M10] has 1, and pairs .1 m farther apart
        repulsion=1.0,  # [M10]
        repulsion_distance=0.8,  # [M10] d0
        ramp=0.2,  # ours
    )),
))  # fmt: skip

_JOHANSSON_2007 = _HELBING_1995.tree_replace({
    "repulsion.sight": in_front,
    "repulsion.strength": 0.04,  # [J07] elliptical II: A
    "repulsion.range": 3.22,  # [J07] B
    "repulsion.anticipation": 0.5,  # [J07]
    "repulsion.own_motion": 1.0,  # [J07]
    "repulsion.back_weight": 0.06,  # [J07] lambda
})  # fmt: skip

_HELBING_2000 = _HELBING_1995.tree_replace({
    "repulsion.law": circular,
    "repulsion.sight": in_front,
    "repulsion.strength": 2000.0 / 80.0,  # [H00] A / m
    "repulsion.range": 0.08,  # [H00] B
    "repulsion.reach": 0.2 + 0.2,  # [H00] both radii
    "repulsion.anticipation": 0.0,
    "repulsion.back_weight": 1.0,  # [H00] feels in all directions
    "contact.stiffness": 1.2e5 / 80.0,  # [H00] k / m
    "contact.friction": 2.4e5 / 80.0,  # [H00] kappa / m
    "walls.strength": 2000.0 / 80.0,  # [H00] A / m
    "walls.range": 0.08,  # [H00] B
    "walls.reach": 0.2,  # [H00] the radius
})  # fmt: skip

_SEAN2 = _HELBING_1995.tree_replace({
    "walking.relaxation_time": 0.5,  # [S2] T
    "walking.speed_mean": 0.6,  # [S2] DESIRED_SPEED, the same for all
    "walking.speed_deviation": 0.0,
    "walking.speed_min": 0.6,
    "walking.speed_max": 0.6,
    "walking.speed_ratio": 1.0,  # [S2] MAX_VEL
    "walking.turn_rate": np.deg2rad(120.0),  # [S2]
    "walking.perception": 2.0,  # [S2]
    "walking.lateral_damping": 5.0,  # [S2] LATERAL_DAMPENING
    "walking.backward_scale": 0.0,  # [S2]
    "repulsion.law": circular,
    "repulsion.sight": in_front,
    "repulsion.strength": 500.0 / 80.0,  # [S2] A / m
    "repulsion.range": 0.16,  # [S2] B
    "repulsion.reach": 0.2 + 0.2 + 0.5,  # [S2] both radii and 0.5 m
    "repulsion.anticipation": 0.0,
    "repulsion.back_weight": 1.0,  # [S2] looks in all directions
    "sidestep.preference": -50.0 / 80.0,  # [S2] A / 10 / m, to the left
    "sidestep.range": 2.0,  # [S2] perception
    "sidestep.scaled_by_robot": True,  # [S2] ROBOT_REPULSION_DAMPENING is a factor of both forces
    "robot_repulsion.factor_min": 0.5,  # [S2] people come nearer to a robot that moves than to one that stands
    "robot_repulsion.factor_max": 1.0,  # [S2]
    "walls.strength": 8000.0 / 80.0,  # [S2] WALL_A / m
    "walls.range": 0.24,  # [S2] WALL_B
    "walls.reach": 0.2,  # [S2]
    "walls.distance_factor": 1.0,  # [S2]
})  # fmt: skip

_HASTE = 0.5 / 0.2  # ratio of relaxation times: terms made for the drive of [HM95] are scaled to the stronger one

_CALIBRATED = Forces((
    replace(_HELBING_1995.walking, **_arrays(
        relaxation_time=0.2,  # [C]
        perception=6.5,  # beyond what Evasion sees: people who close at 2.8 m/s for its horizon
    )),
    Repulsion(law=circular, sight=all_round, **_arrays(
        strength=5.5,  # [C]
        range=0.09,  # [C]
        reach=0.2 + 0.2,  # both radii
        anticipation=0.0,
        own_motion=0.0,
        back_weight=1.0,
        sight_cosine=-1.0,
    )),
    Headway(**_arrays(length=-0.22, range=1.8, width=0.45, ramp=0.15)),  # [D]
    Evasion(**_arrays(
        strength=5.4,  # [C]
        gain=5.7,  # [C]
        horizon=2.1,  # [C]
        width=0.73,  # [C]
        side=0.05,  # [D]
        speed=0.23,  # [D]
        ramp=0.13,  # [D]
    )),
    _HELBING_1995.contact,
    replace(_HELBING_1995.robot_repulsion, **_arrays(
        factor_max=24.0,  # [D]
        moving_speed=0.05,  # ours, with the ramp: from 0.1 m/s on, as in [S2], a robot is felt as moving
        ramp=0.1,
    )),
    replace(_HELBING_1995.group_space, **_arrays(strength=1.0 * _HASTE)),
    Walls(**_arrays(
        strength=2.1,  # [C]
        range=0.11,  # [C]
        reach=0.2,  # the radius
        distance_factor=0.0,
    )),
    replace(_HELBING_1995.cohesion, **_arrays(gaze=4.0 * _HASTE, attraction=3.0 * _HASTE, repulsion=1.0 * _HASTE)),
))  # fmt: skip

PRESETS: dict[str, Forces] = {
    "calibrated": _CALIBRATED,
    "helbing1995": _HELBING_1995,
    "johansson2007": _JOHANSSON_2007,
    "helbing2000": _HELBING_2000,
    "sean2": _SEAN2,
}
"""name -> the forces of a published or fitted model"""


def preset(name: str) -> Forces:
    """The forces of a key of ``PRESETS``, with float arrays on the default device.

    Raises:
        InputError: no preset has that name.
    """
    if name not in PRESETS:
        raise InputError(files.unknown_name("forces", name, PRESETS))
    return collect(PRESETS[name])


class Constants(pydantic.BaseModel):
    """The content of a file of constants."""

    model_config = pydantic.ConfigDict(extra="forbid")

    preset: str
    parameters: dict[str, float] = {}  # term.parameter -> value in its unit
    provenance: dict[str, str] = {}  # where the numbers come from; not read


def is_file(name: str) -> bool:
    """Whether a name of forces is that of a YAML file of constants."""
    return name.lower().endswith((".yaml", ".yml"))


def read(path: str | Path) -> Constants:
    """The content of a file of constants.

    Raises:
        FileError: the file cannot be read.
    """
    return files.load(Path(path), Constants)


def text(name: str, parameters: Mapping[str, float], provenance: Mapping[str, str]) -> str:
    """The text of a file of constants: a preset, and the parameters that differ from it, with 6 digits."""
    values = {key: float(f"{value:.6g}") for key, value in parameters.items()}
    content = {"preset": name, "parameters": values, "provenance": dict(provenance)}
    return yaml.safe_dump(content, sort_keys=False, width=110)


def build(forces: str | Iterable[Term]) -> Forces:
    """The forces of a scenario, with float arrays on the default device.

    Args:
        forces: a key of ``PRESETS``, a YAML file of constants, forces, or any sequence of terms with exactly one
            ``Walking`` among them, such as ``[*preset("helbing1995"), mine]``.

    Raises:
        FileError: the file cannot be read, or names a preset or a parameter that does not exist.
        InputError: no preset has that name, or the terms do not make forces (see ``collect``).
    """
    if not isinstance(forces, str):
        return collect(forces)
    if not is_file(forces):
        return preset(forces)
    constants = read(forces)
    try:
        return collect(preset(constants.preset).tree_replace(dict(constants.parameters)))
    except (InputError, AttributeError) as error:
        raise FileError(f"{files.short_name(Path(forces))}: {str(error).rstrip('.?')}; mend the file.") from None
