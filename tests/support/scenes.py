"""Environments of one room: a floor with boxes, and files beside them."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from support import mjcf
from support.mjcf import box


def room(
    folder: Path, floor: Sequence[float], geoms: Iterable[str] = (), people: int = 1, *, name: str = "room",
    more: str = "", assets: str = "", **files: str,
) -> Path:  # fmt: skip
    """Write the environment of a floor (its lower and its upper corner, m) with geoms; return its folder.

    Args:
        folder: is made where it is missing.
        more: further lines of environment.yaml.
        assets: materials and textures of the scene.
        files: texts of other files, by their names without ``.yaml``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files["environment"] = f"name: {name}\nfloor: {list(floor)}\npeople: {people}\n{more}"
    for file, text in files.items():
        (folder / f"{file}.yaml").write_text(text, encoding="utf-8")
    (folder / "scene.xml").write_text(mjcf.scene(*geoms, assets=assets), encoding="utf-8")
    return folder


# A way with a bench for three beside it.
BENCH = """\
version: 1
c_min: 0.2
c_max: 100
nodes:
  west: {kind: waypoint, position: [-4, -3], radius: 1, spawn: 1}
  east: {kind: waypoint, position: [4, -3], radius: 1, spawn: 1}
  bench: {kind: group, position: [2, 3], radius: 1, spawn: 1, capacity: 3, stay: [5, 10]}
edges:
  - {between: [west, east]}
  - {between: [east, bench]}
"""
# A group between two places.
MEETING = """\
version: 1
c_min: 0.2
c_max: 100
nodes:
  here: {kind: waypoint, position: [-3, 0], radius: 1, spawn: 1}
  there: {kind: waypoint, position: [3, 0], radius: 1, spawn: 1}
  middle: {kind: group, position: [0, -2], radius: 0.8, spawn: 1, capacity: 2, stay: [5, 10]}
edges:
  - {between: [here, there], flow: medium}
  - {between: [here, middle], flow: medium}
  - {between: [there, middle], flow: medium}
"""


def meeting_room(folder: Path) -> Path:
    """A room with two boxes, where four people meet on their way."""
    boxes = box((0, 2), (0.5, 0.25)), box((-2, -2), (0.3, 0.3), height=1.0, turn=30)
    return room(folder, (-5, -4, 5, 4), boxes, 4, graph=MEETING)
