"""Changes of an environment's files, ``graph.yaml``, ``handcrafted.yaml`` and ``scene.xml``, checked as the files are.

The texts keep their comments: only the place of a change is another one.
"""

from __future__ import annotations

import dataclasses
import difflib
import json
import math
import re
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from sean_jax.config import StudioConfig
from sean_jax.core.bounds import MAX_COORDINATE
from sean_jax.core.data_types import Scenario
from sean_jax.core.errors import FileError, InputError
from sean_jax.core.messages import shorten
from sean_jax.graph import graph_of
from sean_jax.graph.formation import reach
from sean_jax.io import files, writing
from sean_jax.people import behaviors
from sean_jax.people.behaviors.graph_behavior import Tables
from sean_jax.people.handcrafted import annotation
from sean_jax.simulation import making
from sean_jax.web import pages, replay
from sean_jax.web.studio import scene_text, yaml_text
from sean_jax.world import environment, generated
from sean_jax.world.environment import SCENE

GRAPH, SETS = "graph.yaml", annotation.FILE
FILES = GRAPH, SETS, SCENE
KEYS = ("position", "radius", "spawn", "weight", "capacity", "stay")  # of a node that can be changed
FORMS = {
    "node": [{"add", "position", "edge"}, {"remove"}, set(KEYS)],
    "edge": [{"flow"}],
    "set": [{"point", "position", "heading"}],
    "box": [{"add", "position"}, {"remove"}, {"position", "size", "height", "turn"}],
}  # what a change of each has besides its name
DIGITS = 3  # of numbers from a page
MAX_NAME = 100  # characters of a name from a page
WAYPOINT = "{{kind: waypoint, position: [{}, {}], radius: 0.5, spawn: 1}}"
GROUP = "{{kind: group, position: [{}, {}], radius: 0.5, spawn: 1, capacity: 2, stay: [5, 10]}}"


class Editor:
    """The texts of an environment's files, with their earlier texts."""

    def __init__(self, config: StudioConfig):
        self.config, self.folder = config, generated.find(config.environment)[0]
        self.saved = {name: files.read_text(self.folder / name) for name in FILES if (self.folder / name).is_file()}
        self.texts, self.history = dict(self.saved), list[tuple[str, str]]()  # file, and its text before a change
        self._scratch = tempfile.TemporaryDirectory(prefix="sean-studio-")
        folder = self.folder.resolve()
        for path in map(Path.resolve, environment.sources(self.folder)):
            if path.is_relative_to(folder):  # a change of a scene that reads others is refused
                copy = Path(self._scratch.name) / path.relative_to(folder)
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, copy)
        self.boxes: dict[str, scene_text.Box] = {}  # obstacles that can be changed
        self.sets: annotation.Annotation | None = None  # of behavior handcrafted
        for name in self.texts:
            self._take(self.folder / name)

    @property
    def changed(self) -> bool:
        """Whether there are changes that are not in the files."""
        return self.texts != self.saved

    def change(
        self, change: Mapping[str, Any], scenario: Scenario, prepare: Callable[[Scenario], None] = lambda made: None
    ) -> Scenario:
        """The scenario with a change of a ``node``, an ``edge``, a ``set`` or a ``box``; docs/studio.md has their keys.

        Args:
            prepare: is called with the new scenario before the texts are changed, and may refuse it.

        Raises:
            InputError: the change or a file has a mistake; the texts stay as they were.
        """
        word = next((word for word in ("node", "edge", "set", "box") if word in change), None)
        if word is None:
            raise InputError("edit: it names no node, edge, set or box; reload the page.")
        _check_form(word, change)
        if word in ("node", "edge"):
            if graph_of(scenario) is None:
                raise InputError(f"edit: behavior '{scenario.behavior.name}' has no graph.")
            name, text = GRAPH, changed_graph(self.texts[GRAPH], change)
        elif word == "set":
            if self.sets is None:
                raise InputError(f"edit: behavior '{scenario.behavior.name}' has no sets.")
            name, text = SETS, changed_sets(self.texts[SETS], self.sets, change)
        else:
            self._check_own()
            name, text = SCENE, changed_scene(self.texts[SCENE], self.boxes, change)
        if text == self.texts[name]:
            return scenario
        made = self._build(name, text, scenario, prepare)
        self.history.append((name, self.texts[name]))
        self.texts[name] = text
        self._take(Path(self._scratch.name) / name)
        return made

    def undo(self, scenario: Scenario, prepare: Callable[[Scenario], None] = lambda made: None) -> Scenario:
        """The scenario without the latest change; ``prepare`` as of ``change``.

        Raises:
            InputError: there is none.
        """
        if not self.history:
            raise InputError("undo: there is no change.")
        name, text = self.history[-1]
        made = self._build(name, text, scenario, prepare)
        self.texts[name] = text
        self._take(Path(self._scratch.name) / name)
        self.history.pop()
        return made

    def difference(self) -> str:
        """The changes that are not in the files, line by line."""
        parts = []
        for name, text in self.texts.items():
            old, new = self.saved[name].splitlines(), text.splitlines()
            parts += difflib.unified_diff(old, new, name, f"{name}, changed", lineterm="", n=1)
        return "\n".join(parts)

    def save(self) -> list[Path]:
        """Write the files that have changes.

        Raises:
            InputError: they are the package's, or one has changed since it was read; then none is written.
        """
        self._check_own()
        changed = [name for name in self.texts if self.texts[name] != self.saved[name]]
        for name in changed:
            if files.read_text(self.folder / name) != self.saved[name]:
                file = self.folder / name
                raise InputError(f"save: {file} has changed meanwhile; start the studio again to see it.")
        for name in changed:
            writing.write(self.folder / name, self.texts[name])
            self.saved[name] = self.texts[name]
        return [self.folder / name for name in changed]

    def of_page(self, scenario: Scenario) -> dict[str, Any]:
        """What the page draws and changes: graph, sets and boxes where there are any, and what is not saved."""
        graph = graph_of(scenario)
        names = ("spawn", "weight", "capacity", "stay")
        boxes = {
            name: [round(value, 4) for value in (*box.center[:2], *box.half[:2], math.radians(box.yaw),
                                                 box.center[2] + box.half[2])]
            for name, box in self.boxes.items()
        }  # fmt: skip
        return {
            "place": replay.place_of_page(scenario.environment),
            "graph": None if graph is None else replay.graph_of_page(graph),
            "numbers": {} if graph is None else {name: np.asarray(getattr(graph, name)).tolist() for name in names},
            "sets": None if self.sets is None else _sets_of_page(self.sets),
            "boxes": boxes if self._refusal is None else None,
            "difference": self.difference(),
            "changes": len(self.history),
        }

    @property
    def _refusal(self) -> str | None:
        """Why the folder is not the user's own."""
        file = (self.folder / SCENE).resolve()
        of_package = pages.PACKAGE in file.parents or pages.PACKAGE.parent / "envs" in file.parents
        if not of_package and generated.parse_set(self.config.environment) is None:
            return None
        what = "an environment of the package" if of_package else "made from a seed"
        return f"{self.folder.name} is {what}; copy the folder {self.folder} and name the copy with --environment."

    def _check_own(self) -> None:
        if self._refusal is not None:
            raise InputError(f"save: {self._refusal}")

    def _take(self, file: Path) -> None:
        """Read what the page changes in a file that is checked."""
        if file.name == SCENE and self._refusal is None:
            self.boxes = scene_text.boxes(file, self.texts[SCENE])
        elif file.name == SETS and self.config.behavior.kind == "handcrafted":
            self.sets = files.load(file, annotation.Annotation)

    def _build(self, name: str, text: str, scenario: Scenario, prepare: Callable[[Scenario], None]) -> Scenario:
        """The scenario with another text of a file; the files in the scratch folder stay if it has a mistake."""
        folder = Path(self._scratch.name)
        writing.write(folder / name, text)
        try:
            try:
                made = self._made(name, scenario)
            except (InputError, FileError) as error:
                known = "|".join(map(re.escape, FILES))
                raise InputError(re.sub(rf"\S*?({known})", r"\1", str(error))) from None
            prepare(made)
        except BaseException:
            writing.write(folder / name, self.texts[name])
            raise
        return made

    def _made(self, name: str, scenario: Scenario) -> Scenario:
        """The scenario with a file of the scratch folder."""
        folder = Path(self._scratch.name)
        if name == SCENE:
            return making.scenarios(self.config.replace(environment=str(folder)))[0]
        tables = scenario.behavior.data if name == GRAPH else scenario.behavior.data.ways or scenario
        place = behaviors.Place(folder, scenario.environment, tables.navigation, scenario.time_step)
        made = making.behavior_of(making.plan_scenario(self.config), place)
        if name == GRAPH:
            made = dataclasses.replace(made, data=_with_starts_like(scenario.behavior.data, made.data))
        return dataclasses.replace(scenario, behavior=made)


def _check_form(word: str, change: Mapping[str, Any]) -> None:
    """Refuse names that are too long, and keys that a node, an edge, a set or a box does not have.

    Raises:
        InputError: it names the key.
    """
    keys = change.keys() - {word}
    forms = FORMS[word]
    if not any(keys <= form for form in forms):
        known = set.union(*forms)
        unknown = sorted(keys - known) or sorted(keys)
        name = shorten(repr(change[word]))
        raise InputError(f"edit: {shorten(unknown[0])!r} of {word} {name} is not for the page; edit the file.")
    named = [change[word], *(change[key] for key in ("edge", "flow", "point") if key in change)]
    for value in [part for each in named for part in (each if isinstance(each, list) else [each])]:
        if isinstance(value, str) and len(value) > MAX_NAME:
            length = f"{len(value):,} characters, and a name has {MAX_NAME} at most"
            raise InputError(f"edit: {shorten(value)!r} has {length}; give another name.")


def _with_starts_like(before: Tables, after: Tables) -> Tables:
    """The tables with as many starts as before, so that programs fit: starts matter at the next reset alone."""
    number, found = len(before.start), len(after.start)
    rows = np.round(np.linspace(0, found - 1, number)).astype(int) if found >= number else np.arange(number) % found
    chance = np.where(np.arange(number) < found, np.asarray(after.start_log_chance)[rows], -np.inf)
    parts = {name: np.asarray(getattr(after, name))[rows] for name in ("start", "start_node")}
    return after.replace(**jax.tree.map(jax.numpy.asarray, parts | {"start_log_chance": chance}))  # pyright: ignore


def same_shapes(one: Any, other: Any) -> bool:
    """Whether compiled programs take one pytree in place of the other."""
    shapes = [[(np.shape(leaf), np.asarray(leaf).dtype) for leaf in jax.tree.leaves(each)] for each in (one, other)]
    return shapes[0] == shapes[1] and jax.tree.structure(one) == jax.tree.structure(other)


# ------------------------------------------------------------------ graph.yaml


def changed_graph(text: str, change: Mapping[str, Any]) -> str:
    """The text of a graph.yaml with a change of a ``node`` or an ``edge``.

    A node has ``KEYS``; or ``add`` with its kind, a ``position`` and the name of another node for an ``edge``; or
    ``remove``. An edge, two names, has a ``flow``; None removes it.

    Raises:
        InputError: there is no such node, edge or key, or a value is no number.
    """
    names = yaml_text.names_at(text, ["nodes"])
    if "node" not in change:
        return _changed_edge(text, change["edge"], change.get("flow"), names)
    name = change["node"]
    if "add" in change:
        return _with_node(text, name, change, names)
    if name not in names:
        raise InputError(f"edit: there is no node {shorten(repr(name))}; reload the page.")
    if change.get("remove"):
        for index in reversed(range(len(yaml_text.node_at(text, ["edges"]).value))):
            if name in _ends(text, index):
                text = yaml_text.removed(text, ["edges", index])
        return yaml_text.removed(text, ["nodes", name])
    for key in (key for key in change if key != "node"):
        value = change[key]
        if key not in KEYS:
            raise InputError(f"edit: {key!r} of a node is not for the page; edit the file.")
        if isinstance(value, list):
            if len(value) != 2:
                raise InputError(f"edit: {key} has two numbers; reload the page.")
            for index in (0, 1):
                try:
                    yaml_text.node_at(text, ["nodes", name, key, index])
                except KeyError:
                    raise InputError(f"edit: {name} has no {key}; edit the file.") from None
                text = yaml_text.replaced(text, ["nodes", name, key, index], _number(key, value[index]))
        else:
            text = yaml_text.replaced(text, ["nodes", name, key], _number(key, value))
    return text


def _with_node(text: str, name: Any, change: Mapping[str, Any], names: list[str]) -> str:
    if not isinstance(name, str) or _word(name) != name:
        raise InputError(f"edit: {shorten(repr(name))} is no name for a node; give letters, digits and _.")
    if name in names:
        raise InputError(f"edit: there is a node {name!r} already; give another name.")
    form = GROUP if change["add"] == "group" else WAYPOINT
    entry = form.format(*_pair("position", change.get("position")))
    text = yaml_text.extended(text, ["nodes"], f"{name}: {entry}")
    return _changed_edge(text, [change.get("edge"), name], "medium", [*names, name])


def _changed_edge(text: str, pair: Any, flow: Any, names: list[str]) -> str:
    if not (isinstance(pair, list) and len(pair) == 2 and all(name in names for name in pair)):
        raise InputError(f"edit: {shorten(repr(pair))} are no two nodes; reload the page.")
    count = len(yaml_text.node_at(text, ["edges"]).value)
    index = next((k for k in range(count) if set(_ends(text, k)) == set(pair)), None)
    if flow is None:
        if index is None:
            raise InputError(f"edit: there is no edge between {pair[0]} and {pair[1]}.")
        return yaml_text.removed(text, ["edges", index])
    if index is None:
        entry = f"{{between: [{_word(pair[0])}, {_word(pair[1])}], flow: {_word(str(flow))}}}"
        return yaml_text.extended(text, ["edges"], entry)
    if "weights" in yaml_text.names_at(text, ["edges", index]):
        text = yaml_text.removed(text, ["edges", index, "weights"])
    return yaml_text.replaced(text, ["edges", index, "flow"], _word(str(flow)))


def _ends(text: str, index: int) -> list[str]:
    return [node.value for node in yaml_text.node_at(text, ["edges", index, "between"]).value]


def _word(name: str) -> str:
    """A word as YAML has it."""
    plain = re.fullmatch(r"[A-Za-z_][\w-]*", name, re.ASCII) and name not in ("null", "true", "false")
    return name if plain else json.dumps(name)


def _number(key: str, value: Any) -> str:
    # an integer of many digits is no float, so it is compared before anything else
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= MAX_COORDINATE:
        raise InputError(f"{key}: {shorten(repr(value))} is no number from -{MAX_COORDINATE:g} to {MAX_COORDINATE:g}.")
    value = round(float(value), DIGITS)
    return str(int(value) if value.is_integer() else value)


def _pair(key: str, value: Any) -> tuple[str, str]:
    if not isinstance(value, list) or len(value) != 2:
        raise InputError(f"edit: {key} has two numbers; reload the page.")
    return _number(key, value[0]), _number(key, value[1])


# ------------------------------------------------------------------ handcrafted.yaml


def changed_sets(text: str, sets: annotation.Annotation, change: Mapping[str, Any]) -> str:
    """The text of a handcrafted.yaml with a ``position`` or a ``heading`` of a ``point`` of a ``set``.

    A point is ``["starts", 0]``, ``["goals", 0]``, ``["walkers", 0, "loop", 0]`` or ``["groups", NAME, "center"]``.

    Raises:
        InputError: there is no such point, or a value is no number.
    """
    place = next((where for where, label, _ in sets.each() if label == change["set"]), None)
    point = change.get("point")
    forms = (("starts", int), ("goals", int), ("walkers", int, "loop", int), ("groups", str, "center"))
    if place is None or not isinstance(point, list) or not any(_has_form(point, form) for form in forms):
        raise InputError(_no_point(point, change["set"]))
    values = {}
    if "position" in change:
        values |= dict(enumerate(_pair("position", change["position"])))
    if "heading" in change:
        values[2] = _number("heading", change["heading"])
    try:
        for index, value in values.items():
            keys = [*place, *point, index]
            yaml_text.node_at(text, keys)
            text = yaml_text.replaced(text, keys, value)
    except KeyError:
        raise InputError(_no_point(point, change["set"])) from None
    return text


def _no_point(point: Any, label: Any) -> str:
    return f"edit: there is no point {shorten(repr(point))} in set {shorten(repr(label))}; reload the page."


def _has_form(point: list, form: tuple) -> bool:
    """Whether the parts of a point are the words and of the types of a form."""
    pairs = list(zip(point, form, strict=False))
    return len(point) == len(form) and all(type(a) is b if isinstance(b, type) else a == b for a, b in pairs)


def _sets_of_page(sets: annotation.Annotation) -> dict[str, Any]:
    return {
        label: {
            "situation": one.situation,
            "starts": one.starts,
            "goals": one.goals,
            "loops": [walkers.loop for walkers in one.walkers],
            "groups": {name: [*group.center, reach(group.people)] for name, group in one.groups.items()},
        }
        for _, label, one in sets.each()
    }


# ------------------------------------------------------------------ scene.xml


def changed_scene(text: str, boxes: Mapping[str, scene_text.Box], change: Mapping[str, Any]) -> str:
    """The text of a scene.xml with a change of a ``box``.

    A box has a ``position`` [m], a ``size`` of two sides [m], a ``height`` [m] and a ``turn`` [degrees], or ``add``
    with a ``position``, or ``remove``.

    Raises:
        InputError: there is no such box, or a value is no number.
    """
    name = change["box"]
    if not isinstance(name, str):
        raise InputError(f"edit: {shorten(repr(name))} is no name for a box; give letters, digits and _.")
    if change.get("add"):
        x, y = _pair("position", change.get("position"))
        return scene_text.added(text, name, float(x), float(y))
    if name not in boxes:
        raise InputError(f"edit: there is no box {name!r} that the page can change; edit the file.")
    if change.get("remove"):
        return scene_text.removed(text, name)
    before = after = boxes[name]
    if "position" in change:
        x, y = map(float, _pair("position", change["position"]))
        after = after._replace(center=(x, y, after.center[2]))
    if "size" in change:
        x, y = (float(side) / 2 for side in _pair("size", change["size"]))
        after = after._replace(half=(x, y, after.half[2]))
    if "height" in change:
        z = float(_number("height", change["height"])) / 2
        after = after._replace(center=(*after.center[:2], z), half=(*after.half[:2], z))
    if "turn" in change:
        after = after._replace(yaw=float(_number("turn", change["turn"])))
    return scene_text.moved(text, name, before, after)
