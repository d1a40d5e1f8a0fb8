"""The table of all checks, and the gates that they make up."""

from dataclasses import dataclass

from sean_jax.errors import InputError
from sean_jax.files import listed, unknown_name
from sean_jax.studies.validation import diagrams, doorways, encounters, forecasts, groups, lanes, standards
from sean_jax.studies.validation.check import Check

ROOMS = standards, forecasts, diagrams, doorways, lanes, encounters, groups
CHECKS: dict[str, Check] = {check.name: check for room in ROOMS for check in room.CHECKS}
"""name -> check, in the order of the table"""


@dataclass(frozen=True)
class GateRow:
    """A gate: a promise about the default crowd, kept if all of its checks pass."""

    title: str
    promise: str
    checks: tuple[str, ...]  # names, or the beginnings of names followed by *


GATES = (
    GateRow(
        "prediction, scene left out each time",
        "ADE and FDE at most those of constant velocity in every scene, with 50 times fewer collisions; below the "
        "published social-force and GAN figures",
        ("prediction*",),
    ),
    GateRow("fundamental diagram .5 to 2.5 /m²", "within 15 % of Juelich, falling", ("fundamental-diagram*",)),
    GateRow("bottleneck .8 to 2.4 m", "within 15 % of 1.9 w", ("bottleneck*",)),
    GateRow("one person, doors of .7 m and wider", "through, at least 80 % of the free speed at 1.0 m", ("doors*",)),
    GateRow("lanes at .5, 1.0, 1.5 /m²", "order of .9 or more", ("lanes*",)),
    GateRow("head-on and crossing pairs", "bodies never overlap", ("pairs*",)),
    GateRow(
        "robot that does not react, crossing at 1 m/s",
        "touched at most 5 %, clearance within .83 ± .27 m",
        ("passing-robot*",),
    ),
    GateRow("RiMEA, IMO, NIST, ISO", "all pass", ("rimea-*", "imo-*", "nist-*", "iso-*")),
    GateRow("group occupancy", "80 % on average, full 50 % of the time", ("group-occupancy*",)),
)


def chosen(names: str | None, quick: bool = False) -> list[Check]:
    """The checks that are asked for.

    Args:
        names: separated by commas, beginnings of names followed by * among them; all if None.
        quick: leave out those that are not quick, but for those that are named in full.

    Raises:
        InputError: there is no check of a name.
    """
    if names is None:
        return [check for check in CHECKS.values() if check.quick or not quick]
    found: set[str] = set()
    for name in listed(names) or ["nothing"]:
        matching = matches(name)
        if not matching:
            raise InputError(unknown_name("--only", name, CHECKS))
        found |= {each for each in matching if each == name or CHECKS[each].quick or not quick}
    return [check for name, check in CHECKS.items() if name in found]


def matches(pattern: str) -> list[str]:
    """Names of the checks that a name or the beginning of one followed by * stands for.

    Args:
        pattern: such as rimea-1, or rimea-*.

    Returns:
        Names, none if there is no such check.
    """
    if pattern.endswith("*"):
        return [name for name in CHECKS if name.startswith(pattern[:-1])]
    return [pattern] if pattern in CHECKS else []
