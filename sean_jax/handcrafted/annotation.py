"""The annotation of handcrafted sets (sections IV-D and IV-E): what handcrafted.yaml may say."""

from collections.abc import Iterator
from typing import Annotated, Any, Literal

import pydantic

from sean_jax import files
from sean_jax.errors import InputError
from sean_jax.quantities import Coordinate, Degrees

FILE = "handcrafted.yaml"
ALL = "all"  # any of the sets, without further collections
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
    """People who walk a closed loop of waypoints without end, and start spread along it or at waypoints of their own.

    Who starts at a waypoint takes the shortest way to the next one, so the straight way may lead through obstacles.
    """

    model_config = STRICT

    people: Annotated[int, pydantic.Field(ge=1, le=32)]
    loop: Annotated[list[Place], pydantic.Field(min_length=3, max_length=100)]  # m
    way: Literal["forward", "both"] = "forward"  # both: every second person walks the loop backwards
    start: Literal["spread", "waypoints"] = "spread"  # spread: evenly by length, from a random place on

    def first_waypoints(self) -> list[int]:
        """Where people start who start at waypoints: evenly by number, 5 people of 10 waypoints at every second one.

        Returns:
            Index of a waypoint for each person; of at most as many people as there are waypoints, all different.
        """
        count = len(self.loop)
        return [-(-person * count // self.people) % count for person in range(self.people)]


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


class Collection(pydantic.BaseModel):
    """Sets beside those of ``all``, which take part where they are asked for."""

    model_config = STRICT

    source: str = ""
    sets: Annotated[dict[str, Set], pydantic.Field(min_length=1, max_length=200)]


class Annotation(pydantic.BaseModel):
    """What handcrafted.yaml holds."""

    model_config = STRICT

    version: Literal[1]
    source: str = ""
    sets: Annotated[dict[str, Set], pydantic.Field(min_length=1, max_length=200)]
    further: Annotated[dict[str, Collection], pydantic.Field(max_length=20)] = {}

    def each(self) -> Iterator[tuple[files.Location, str, Set]]:
        """All sets, those of further collections too.

        Yields:
            Location in the file, name, and the set; a collection's name stands before those of its sets.
        """
        for name, one in self.sets.items():
            yield ("sets", name), name, one
        for collection, held in self.further.items():
            for name, one in held.sets.items():
                yield ("further", collection, "sets", name), f"{collection}_{name}", one

    def chosen(self, name: str) -> dict[str, Set]:
        """The sets that a name stands for.

        Args:
            name: of a set, of a situation, or ``all``; of a collection ``COLLECTION``, ``COLLECTION_SITUATION`` or
                ``COLLECTION_SET``.

        Raises:
            InputError: there is no such set, situation or collection.
        """
        words: dict[str, dict[str, Set]] = {}
        for where, label, one in self.each():
            collection = where[1] if where[0] == "further" else None
            situation = one.situation if collection is None else f"{collection}_{one.situation}"
            for word in (ALL if collection is None else str(collection), situation, label):
                words.setdefault(word, {})[label] = one
        if name not in words:
            raise InputError(files.unknown_name("sets", name, words))
        return words[name]
