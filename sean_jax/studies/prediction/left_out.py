"""The preset ``calibrated`` and its habits as they are fitted without a scene, so that the scene can judge them.

They are what ``sean calibrate`` found; docs/calibration.md has the command.
"""

from typing import Any

from sean_jax.social_forces import Forces, preset
from sean_jax.versions import fingerprint

_FITTED = (
    "walking.relaxation_time", "repulsion.strength", "repulsion.range", "evasion.strength", "evasion.gain",
    "evasion.horizon", "evasion.width", "walls.strength", "walls.range",
)  # fmt: skip
_WITHOUT = {
    "eth": (0.2002, 5.504, 0.08717, 5.322, 5.108, 2.102, 0.7204, 1.999, 0.1080),
    "hotel": (0.1876, 5.559, 0.08085, 4.971, 5.470, 2.240, 0.7715, 1.705, 0.09483),
    "zara01": (0.2238, 6.119, 0.09279, 5.616, 5.702, 2.097, 0.7639, 2.301, 0.09072),
}
_HABITS = {"eth": (0.972, 0.724), "hotel": (0.964, 0.560), "zara01": (0.965, 0.381)}  # weights, settled


def fitted_without(scene: str, forces: Forces) -> tuple[Forces, dict[str, Any]] | None:
    """Constants that have not seen a scene.

    Args:
        scene: its name, such as eth.

    Returns:
        Forces and arguments of ``predict``; None unless the forces are ``calibrated`` and the scene was fitted to.
    """
    if scene not in _WITHOUT or fingerprint(forces) != fingerprint(preset("calibrated")):
        return None
    weight, settled = _HABITS[scene]
    constants: dict[str, Any] = dict(zip(_FITTED, _WITHOUT[scene], strict=True))
    return forces.tree_replace(constants), {"weights": (weight,), "settled": settled}
