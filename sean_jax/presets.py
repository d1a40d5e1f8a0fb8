"""Presets of options: the conditions of another simulator, for options that the user leaves out.

Each entry is an option by its name in ``make`` and on the command line.
"""

import math
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Preset:
    """Values of options."""

    summary: str  # for ``sean list``
    options: dict[str, Any]  # option -> value; one of a component holds where that component is chosen


PRESETS: dict[str, Preset] = {
    "sean2": Preset(
        "The world of SEAN 2.0 as its public files have it, in place of this package's defaults.",
        {
            "routing": "edge",  # INavigable.cs: people choose anew at each node
            "group_membership": "permanent",  # GroupNavNode.cs: who starts in a group stays
            "forces": "sean2",  # SFAgent.cs and Parameters.cs
            "situations": "sean2",  # SituationRuleBased.cs, with V = 0.4 m/s as in its prefab
            "goal_sampling": "mesh",  # Navmesh.cs
            "task_distance": (0.0, math.inf),  # RandomABNav.cs: independent start and goal
            "dynamics": "kinematic",  # VelocityController.cs
            "warm_up": 120.0,  # tasks follow one another in one lasting crowd, which is older than a task
            "goal_radius": 1.2,  # Tasks.prefab: completionDistance
            "hold_time": 5.0,  # Tasks.prefab: debounceTimeoutSec
            "time_limit": 120.0,  # Tasks.prefab
        },
    ),
}


def usual(name: object, option: str, default: Any) -> Any:
    """The default of an option under a preset; ``default`` if there is no such preset, or it lacks the option."""
    preset = PRESETS.get(name) if isinstance(name, str) else None
    return default if preset is None else preset.options.get(option, default)
