"""The annotation of handcrafted sets (sections IV-D and IV-E): what handcrafted.yaml may say."""

from typing import Annotated, Any, Literal

import pydantic

from sean_jax import files
from sean_jax.errors import InputError
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
    """People who walk a closed loop of waypoints without end, and start spread along it."""

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
        """How many people there are, walkers and members of groups."""
        return sum(some.people for some in (*self.walkers, *self.groups.values()))


class Annotation(pydantic.BaseModel):
    """What handcrafted.yaml holds."""

    model_config = STRICT

    version: Literal[1]
    source: str = ""
    sets: Annotated[dict[str, Set], pydantic.Field(min_length=1, max_length=200)]

    def chosen(self, name: str) -> dict[str, Set]:
        """The sets that a name stands for.

        Args:
            name: of a set, of a situation, or ``all``.

        Returns:
            Name -> set.

        Raises:
            InputError: there is no such set or situation.
        """
        if name == ALL:
            return self.sets
        selected = {key: each for key, each in self.sets.items() if name in (key, each.situation)}
        if not selected:
            situations = dict.fromkeys(each.situation for each in self.sets.values())
            words = [ALL, *situations, *self.sets]
            raise InputError(files.unknown_name("sets", name, words))
        return selected
