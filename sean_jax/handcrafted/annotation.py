"""The annotation of handcrafted sets (sections IV-D and IV-E): what handcrafted.yaml may say."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import pydantic

from sean_jax import files
from sean_jax.base import Environment
from sean_jax.handcrafted import room
from sean_jax.quantities import Coordinate, Degrees

FILE = "handcrafted.yaml"
ALL = "all"  # any of the sets
POSES = 5  # starts, and as many goals, of a set (SEAN 2.0)
STRICT = pydantic.ConfigDict(extra="forbid", allow_inf_nan=False)
Place = tuple[Coordinate, Coordinate]  # m
Situation = Literal["empty", "join_group", "leave_group", "down_path", "cross_path"]


def _kind(pose: Any) -> str:
    """So that a mistake in a pose is reported once, and not for each form that a pose can have."""
    return "group" if isinstance(pose, str) else "pose"


Pose = Annotated[
    Annotated[tuple[Coordinate, Coordinate, Degrees], pydantic.Tag("pose")] | Annotated[str, pydantic.Tag("group")],
    pydantic.Discriminator(_kind),
]  # x [m], y [m], heading [degrees]; or the name of a group: its open place, facing its centre
Poses = Annotated[list[Pose], pydantic.Field(min_length=POSES, max_length=POSES)]


class Walkers(pydantic.BaseModel):
    """People who walk a closed loop of waypoints for ever, and start spread along it."""

    model_config = STRICT

    people: Annotated[int, pydantic.Field(ge=1, le=32)]
    loop: Annotated[list[Place], pydantic.Field(min_length=3, max_length=100)]  # m
    way: Literal["forward", "both"] = "forward"  # both: every second person walks the loop backwards


class Group(pydantic.BaseModel):
    """People who stand and talk."""

    model_config = STRICT

    center: Place  # m
    people: Annotated[int, pydantic.Field(ge=2, le=32)]


class Set(pydantic.BaseModel):
    """One handcrafted set: the people, and where the robot starts and goes among them."""

    model_config = STRICT

    situation: Situation
    starts: Poses
    goals: Poses
    walkers: Annotated[list[Walkers], pydantic.Field(max_length=32)] = []
    groups: Annotated[dict[str, Group], pydantic.Field(max_length=32)] = {}

    @property
    def people(self) -> int:
        """How many people there are."""
        return sum(some.people for some in (*self.walkers, *self.groups.values()))


class Annotation(pydantic.BaseModel):
    """What handcrafted.yaml holds."""

    model_config = STRICT

    version: Literal[1]
    source: str = ""
    sets: Annotated[dict[str, Set], pydantic.Field(min_length=1, max_length=200)]

    def chosen(self, name: str) -> dict[str, Set]:
        """The set of that name, the sets of that situation, or with ``all`` every one.

        Raises:
            ValueError: there is none.
        """
        if name == ALL:
            return self.sets
        found = {key: each for key, each in self.sets.items() if name in (key, each.situation)}
        if not found:
            situations = dict.fromkeys(each.situation for each in self.sets.values())
            words = [ALL, *situations, *self.sets]
            raise ValueError(f"handcrafted: '{name}' is not one of {', '.join(words)}{files.suggest(name, words)}")
        return found


def read(folder: Path, environment: Environment) -> Annotation:
    """The sets of handcrafted.yaml in an environment's folder.

    Raises:
        ValueError: there is no such file; as files.FileError it lists all that is wrong with it.
    """
    file = folder / FILE
    if not file.is_file():
        raise ValueError(f"{file}: there is no such file, and behavior 'handcrafted' needs it; write one.")
    return files.load(file, Annotation, check, lambda found: room.check_against(found, environment))


def check(annotation: Annotation) -> Iterator[files.Problem]:
    """What is wrong between the fields of an annotation, wherever its places lie."""
    for name, each in annotation.sets.items():
        here = ("sets", name)
        if name in (ALL, *get_args(Situation)):
            yield here, f"'{name}' stands for several sets; give the set a name of its own, such as '{name}_1'"
        if each.people == 0 and each.situation != "empty":
            yield here, "there is nobody; give the set walkers or groups, or make its situation empty"
        if each.situation in ("down_path", "cross_path") and not each.walkers:
            yield here, f"nobody walks, without which {each.situation} does not occur; give the set walkers"
        yield from _check_poses(name, each)
        yield from room.check_apart(here, each)


def _check_poses(name: str, each: Set) -> Iterator[files.Problem]:
    """Poses in groups belong to join_group, as goals, and to leave_group, as starts."""
    for key, poses, asked in (("starts", each.starts, "leave_group"), ("goals", each.goals, "join_group")):
        for number, pose in enumerate(poses):
            here = ("sets", name, key, number)
            if isinstance(pose, str) and pose not in each.groups:
                hint = files.suggest(pose, each.groups) or "; add it to groups or give x, y and a heading"
                yield here, f"there is no group '{pose}'{hint}"
            elif isinstance(pose, str) and each.situation != asked:
                yield (
                    here,
                    f"only {key} of {asked} lie in a group and this is {each.situation}; give x, y and a heading",
                )
            elif not isinstance(pose, str) and each.situation == asked:
                yield here, f"{key} of {asked} lie in a group; give the name of one instead of a place"
