"""Changes of a Behavior Graph in ``graph.yaml`` that keep its comments, checked as the file is."""

from __future__ import annotations

import dataclasses
import difflib
import io
import math
import re
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from sean_jax import assembly, behaviors, files, pages, writing
from sean_jax.base import Behavior, Scenario
from sean_jax.behaviors.graph_behavior import Tables
from sean_jax.config import StudioConfig
from sean_jax.errors import FileError, InputError

FILE = "graph.yaml"
KEYS = ("position", "radius", "spawn", "weight", "capacity", "stay")  # of a node that can be changed
DIGITS = 3  # of numbers from a page


class Editor:
    """The text of a graph, with its earlier texts."""

    def __init__(self, folder: Path):
        self.folder = folder
        self._read()
        self._scratch = tempfile.TemporaryDirectory(prefix="sean-studio-")
        shutil.copytree(folder, self._scratch.name, dirs_exist_ok=True)

    def _read(self) -> None:
        self.saved = files.read_text(self.folder / FILE)
        self.text, self.history = self.saved, list[str]()

    @property
    def changed(self) -> bool:
        """Whether there are changes that are not in the file."""
        return self.text != self.saved

    def change(self, change: Mapping[str, Any], config: StudioConfig, scenario: Scenario) -> Behavior:
        """The behavior on the graph with a change: keys of a ``node``, or the ``flow`` of an ``edge``; None removes it.

        Raises:
            InputError: the change or the graph has a mistake; the text stays as it was.
        """
        text = changed(self.text, change)
        behavior = self._build(text, config, scenario)
        self.history.append(self.text)
        self.text = text
        return behavior

    def undo(self, config: StudioConfig, scenario: Scenario) -> Behavior:
        """The behavior without the latest change.

        Raises:
            InputError: there is none.
        """
        if not self.history:
            raise InputError("undo: there is no change.")
        behavior = self._build(self.history[-1], config, scenario)
        self.text = self.history.pop()
        return behavior

    def difference(self) -> str:
        """The changes that are not in the file, line by line."""
        lines = [text.splitlines() for text in (self.saved, self.text)]
        return "\n".join(difflib.unified_diff(lines[0], lines[1], FILE, f"{FILE}, changed", lineterm="", n=1))

    def save(self) -> Path:
        """Write the file.

        Raises:
            InputError: it is the package's, or has changed since it was read.
        """
        file = self.folder / FILE
        if pages.PACKAGE in file.resolve().parents or pages.PACKAGE.parent / "envs" in file.resolve().parents:
            copy = f"copy the folder {self.folder} and name the copy with --environment"
            raise InputError(f"save: {self.folder.name} is an environment of the package; {copy}.")
        if files.read_text(file) != self.saved:
            raise InputError(f"save: {file} has changed meanwhile; start the studio again to see it.")
        writing.write(file, self.text)
        self.saved = self.text
        return file

    def _build(self, text: str, config: StudioConfig, scenario: Scenario) -> Behavior:
        folder = Path(self._scratch.name)
        writing.write(folder / FILE, text)
        tables: Tables = scenario.behavior.data
        place = behaviors.Place(folder, scenario.environment, tables.navigation, scenario.time_step)
        try:
            made = assembly.behavior_of(config, place)
        except FileError as error:
            raise InputError(re.sub(rf"\S*{re.escape(FILE)}", FILE, str(error))) from None
        return dataclasses.replace(made, data=_with_starts_like(tables, made.data))


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


def changed(text: str, change: Mapping[str, Any]) -> str:
    """The text of a graph.yaml with a change; comments and layout stay.

    Raises:
        InputError: there is no such node, edge or key, or a value is no number.
    """
    from ruamel.yaml import YAML

    document = YAML()
    document.preserve_quotes, document.width = True, 10_000
    document.indent(mapping=2, sequence=4, offset=2)
    content = document.load(text)
    if "node" in change:
        _change_node(content, change)
    elif "edge" in change:
        _change_edge(content, change)
    else:
        raise InputError("edit: it names no node and no edge; reload the page.")
    stream = io.StringIO()
    document.dump(content, stream)
    before = {" ".join(line.split()): line for line in text.split("\n")}  # with the author's spaces
    return "\n".join(before.get(" ".join(line.split()), line) for line in stream.getvalue().split("\n"))


def _change_node(content: Any, change: Mapping[str, Any]) -> None:
    name = change["node"]
    if name not in content["nodes"]:
        raise InputError(f"edit: there is no node {name!r}; reload the page.")
    node = content["nodes"][name]
    for key in (key for key in change if key != "node"):
        value = change[key]
        if key not in KEYS:
            raise InputError(f"edit: {key!r} of a node is not for the page; edit the file.")
        if isinstance(value, list):
            if len(value) != 2:
                raise InputError(f"edit: {key} has two numbers; reload the page.")
            if key not in node:
                raise InputError(f"edit: {name} has no {key}; edit the file.")
            for index in (0, 1):
                node[key][index] = _number(key, value[index])
        else:
            node[key] = _number(key, value)


def _change_edge(content: Any, change: Mapping[str, Any]) -> None:
    pair, flow = change["edge"], change.get("flow")
    if not (isinstance(pair, list) and len(pair) == 2 and all(name in content["nodes"] for name in pair)):
        raise InputError(f"edit: {pair!r} are no two nodes; reload the page.")
    index = next((k for k, each in enumerate(content["edges"]) if set(each["between"]) == set(pair)), None)
    if flow is None:
        if index is None:
            raise InputError(f"edit: there is no edge between {pair[0]} and {pair[1]}.")
        del content["edges"][index]
        return
    if index is None:
        from ruamel.yaml.comments import CommentedMap, CommentedSeq

        names = CommentedSeq(pair)
        edge = CommentedMap({"between": names, "flow": flow})
        for part in (names, edge):
            part.fa.set_flow_style()
        content["edges"].append(edge)
        return
    edge = content["edges"][index]
    edge.pop("weights", None)
    edge["flow"] = flow


def _number(key: str, value: Any) -> float | int:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{key}: {value!r} is no number.")
    value = round(float(value), DIGITS)
    return int(value) if value.is_integer() else value
