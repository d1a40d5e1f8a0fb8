"""YAML and JSON files as pydantic models: all errors of one kind at once, each with its position and its cure.

A message has one line an error, such as ``warehouse/graph.yaml:6:19: nodes.dock.kind: 'gruop' is not one of
waypoint, group; did you mean 'group'?``: file, line, column, keys, value, cure. Values are scalars, lists and mappings.
Tags, which make other types or run code, are refused, and so are aliases that expand to more than a file could hold.
"""

import json
import re
import types
import typing
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Literal, TypeVar

import pydantic
import yaml

from sean_jax.core.errors import FileError
from sean_jax.core.messages import (
    MAX_DEPTH,
    MAX_DIGITS,
    MAX_JSON_VALUES,
    count_values,
    error_clause,
    listed,
    parse_json,
    suggest,
    unknown_name,
)
from sean_jax.io.files.reading import (
    MAX_BYTES,
    MAX_RECORD,
    MAX_TABLE,
    file_error,
    open_file,
    parse_file_json,
    read_arrays,
    read_bytes,
    read_json,
    read_json_lines,
    read_rows,
    read_text,
    sentence,
    short_name,
)

MAX_ERRORS = 100  # of a file that a message names
# Values that a model is made of. Each may be wrong in several ways, for each of which pydantic needs 1 kB.
MAX_CHECKED = 500_000
MAX_DETAILS = 50_000  # errors that are looked at, which need as much again
MAX_KEY = 60  # characters of a key in a message
MAX_VALUES = 50_000  # in a file, with aliases expanded
Location = tuple[str | int, ...]  # keys and list indices that lead to a value
Model = TypeVar("Model", bound=pydantic.BaseModel)
Problem = tuple[Location, str]  # its location, and the error as one clause


def load(path: Path | str, model: type[Model], *checks: Callable[[Model], Iterable[Problem]]) -> Model:
    """Read a YAML file into a pydantic model.

    Args:
        *checks: give problems of relations between fields, once each single field is right.

    Raises:
        FileError: the file cannot be read, or its content is wrong.
    """
    root, data = read_yaml(Path(path))
    return _validate(Path(path), data, model, checks, root)


def check_json(path: Path | str, data: Any, model: type[Model], *checks: Callable[[Model], Iterable[Problem]]) -> Model:
    """The values of a JSON file as a pydantic model, with checks as in ``load``; FileError if they are wrong."""
    return _validate(Path(path), data, model, checks)


def _validate(path: Path, data: Any, model: type[Model], checks: Iterable[Callable], root: Any = None) -> Model:
    """The model of some data, or a FileError with all problems, at their positions below ``root`` if it is YAML."""
    text = json.dumps(data)
    if count_values(text) > MAX_CHECKED:
        raise file_error(path, f"has more than {MAX_CHECKED:,} values; make it smaller")
    unknown: set[Location] = set()  # keys, which are marked themselves
    more = 0  # problems that the message does not name
    try:
        value = model.model_validate_json(text, strict=True)
    except pydantic.ValidationError as error:
        if error.error_count() > MAX_DETAILS:
            raise file_error(
                path, f"has {error.error_count():,} errors; give a file of the form that is read"
            ) from None
        details = error.errors(include_url=False)
        more = len(details[MAX_ERRORS:])
        problems = [(item["loc"], _clause(item, model)) for item in details[:MAX_ERRORS]]
        unknown = {item["loc"] for item in details if item["type"] == "extra_forbidden"}
    else:
        problems = [problem for check in checks for problem in check(value)]
        if not problems:
            return value
        more = len(problems[MAX_ERRORS:])
        problems = problems[:MAX_ERRORS]

    marked = []
    for loc, clause in problems:
        keys, mark = (loc, None) if root is None else _locate(root, loc, loc in unknown)
        marked.append((mark, _sentence(keys, clause)))
    raise _in_one(path, marked, more)


def _sentence(loc: Location, clause: str) -> str:
    end = "" if clause.endswith(("?", ".")) else "."
    return f"{_key_path(loc)}: {clause}{end}" if loc else f"{clause}{end}"


def _clause(error: Any, model: type[pydantic.BaseModel]) -> str:
    """A pydantic error as one clause that names the value and the cure."""
    loc = error["loc"]
    keys: list[str] = []
    for kind in _types_at(model, loc[:-1]):
        keys += getattr(kind, "model_fields", ())
    choices: list[object] = []
    for kind in _types_at(model, loc):
        if typing.get_origin(kind) is Literal:
            choices += kind.__args__
    return error_clause(error, choices, keys)


def _types_at(model: Any, loc: Location) -> list[Any]:
    """The types that a value at that location may have, with unions split."""
    kinds = _alternatives(model)
    for part in loc:
        kinds = [inner for kind in kinds for inner in _alternatives(_inner(kind, part))]
    return kinds


def _alternatives(kind: Any) -> list[Any]:
    origin = typing.get_origin(kind)
    if origin is typing.Annotated:
        return _alternatives(typing.get_args(kind)[0])
    if origin in (typing.Union, types.UnionType):
        return [inner for arg in typing.get_args(kind) for inner in _alternatives(arg)]
    return [kind]


def _inner(kind: Any, part: str | int) -> Any:
    """The type of an entry of a model, mapping, list or tuple; None if there is no such entry."""
    args = typing.get_args(kind)
    if isinstance(kind, type) and issubclass(kind, pydantic.BaseModel):
        field = kind.model_fields.get(str(part))
        return field.annotation if field else None
    if typing.get_origin(kind) is dict:
        return args[1]
    if typing.get_origin(kind) is tuple and isinstance(part, int) and Ellipsis not in args:
        return args[part] if part < len(args) else None
    return args[0] if args else None


# ------------------------------------------------------------------ YAML


class _Loader(yaml.SafeLoader):
    """YAML 1.2 scalars: ``no`` and ``on`` are words, ``1e5`` is a number, ``12:30`` and dates are text."""

    def __init__(self, stream: str):
        super().__init__(stream)
        self.depth = 0
        self.values = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose a node as SafeLoader does, without tags, and neither too deep nor too many."""
        event: Any = self.peek_event()
        tag = getattr(event, "tag", None)
        if tag is not None and not (tag == "tag:yaml.org,2002:str" and isinstance(event, yaml.ScalarEvent)):
            tag_text = tag.replace("tag:yaml.org,2002:", "!!")
            raise _error(f"tags such as '{tag_text}' mean nothing here; remove it", event)
        self.values += 1
        if self.depth >= MAX_DEPTH:
            raise _error(f"values are nested deeper than {MAX_DEPTH} levels; make it simpler", event)
        if self.values > MAX_VALUES:
            raise _error(f"values are more than {MAX_VALUES:,}; make it simpler", event)
        self.depth += 1
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


def _error(problem: str, place: yaml.Event | yaml.Node) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=place.start_mark)


_Loader.yaml_implicit_resolvers = {}
for _tag, _pattern, _first in (
    ("null", r"~|null|", ["~", "n", ""]),
    ("bool", r"true|false", list("tf")),
    ("int", r"[-+]?[0-9]+", list("-+0123456789")),
    ("float", r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.inf|\.nan", list("-+.0123456789")),
    ("merge", r"<<", ["<"]),
):
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(rf"^(?:{_pattern})$"), _first)


def _number(_: yaml.SafeLoader, node: yaml.ScalarNode) -> int | float:
    """A number in decimal: SafeLoader reads 010 as 8."""
    value = node.value.lower().replace(".inf", "inf").replace(".nan", "nan")
    if len(value) > MAX_DIGITS:
        raise _error(f"a number has {len(value)} characters; write fewer digits", node)
    return int(value) if node.tag.endswith(":int") else float(value)


def _word(_: yaml.SafeLoader, node: yaml.ScalarNode) -> str:
    if any("\ud800" <= letter <= "\udfff" for letter in node.value):
        raise _error("half a character, of the codes D800 to DFFF; remove it", node)
    return node.value


_Loader.add_constructor("tag:yaml.org,2002:int", _number)
_Loader.add_constructor("tag:yaml.org,2002:float", _number)
_Loader.add_constructor("tag:yaml.org,2002:str", _word)


def read_yaml(path: Path) -> tuple[yaml.Node, Any]:
    """The root node of a YAML file, and its plain data; FileError if it cannot be read or is not plain YAML."""
    text = read_text(path)
    loader = None
    try:
        loader = _Loader(text)
        root = loader.get_single_node()
        if root is None:
            raise file_error(path, "the file is empty", 1, 1)
        _refuse_alias_bombs(path, root)
        _refuse_duplicate_keys(path, root)
        return root, loader.construct_document(root)
    except yaml.MarkedYAMLError as error:
        raise _yaml_error(path, error) from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise file_error(path, f"character {error.position} is not allowed in YAML; remove it", line) from None
    except (ValueError, OverflowError) as error:  # such as of "\UFFFFFFFF"
        if isinstance(error, FileError):
            raise
        mark = loader.get_mark() if loader else None
        place = (mark.line + 1, mark.column + 1) if mark else ()
        raise file_error(path, f"is not YAML: {error}", *place) from None


def parse_yaml(text: str) -> Any:
    """The value of a YAML text that the user types; ValueError if it is none."""
    try:
        return _Loader(text).get_single_data()
    except yaml.YAMLError as error:
        raise ValueError(str(error)) from None


def _yaml_error(path: Path, error: yaml.MarkedYAMLError) -> FileError:
    """The error of PyYAML in one sentence, at its place in the file."""
    mark = error.problem_mark or error.context_mark
    place = f"{mark.line + 1}:{mark.column + 1}" if mark else "1:1"
    problem = error.problem
    if problem == "found unhashable key":
        problem = "a key is a list or a mapping; write a word"
    start = f" that begins in line {error.context_mark.line + 1}" if error.context_mark else ""
    context = f"{error.context}{start}, " if error.context else ""
    return file_error(path, f"is not YAML: {context}{problem}", place)


def _children(node: yaml.Node) -> list[yaml.Node]:
    if isinstance(node, yaml.MappingNode):
        return [part for pair in node.value for part in pair]
    return node.value if isinstance(node, yaml.SequenceNode) else []


def _refuse_alias_bombs(path: Path, root: yaml.Node) -> None:
    """Count values with aliases expanded: a few lines of aliases can expand to billions of values."""
    sizes: dict[int, int | None] = {}  # None while a node is being counted
    pending = [(root, False)]
    while pending:
        node, is_done = pending.pop()
        place = node.start_mark.line + 1, node.start_mark.column + 1
        if is_done:
            sizes[id(node)] = 1 + sum(sizes[id(child)] or 0 for child in _children(node))
            if (sizes[id(node)] or 0) > MAX_VALUES:
                raise file_error(path, f"aliases unfold to more than {MAX_VALUES:,} values; write fewer", *place)
        elif id(node) not in sizes:
            sizes[id(node)] = None
            pending += [(node, True), *((child, False) for child in _children(node))]
        elif sizes[id(node)] is None:
            raise file_error(path, "an alias stands inside of its own anchor; remove it", *place)


def _refuse_duplicate_keys(path: Path, root: yaml.Node) -> None:
    """Refuse equal keys of a mapping, of which YAML would silently take the last."""
    problems: list[tuple[yaml.Mark | None, str]] = []
    pending: list[tuple[Location, yaml.Node]] = [((), root)]
    visited = set()
    while pending:
        loc, node = pending.pop()
        if id(node) in visited:
            continue
        visited.add(id(node))
        if isinstance(node, yaml.SequenceNode):
            pending += [((*loc, index), item) for index, item in enumerate(node.value)]
        elif isinstance(node, yaml.MappingNode):
            lines: dict[str, int] = {}  # key -> where it stands first
            for key, value in node.value:
                name = str(key.value)
                inner = (*loc, name)
                if name in lines and name != "<<":
                    text = f"{_key_path(inner)}: the key was used in line {lines[name]}; remove or rename one."
                    problems.append((key.start_mark, text))
                lines.setdefault(name, key.start_mark.line + 1)
                pending.append((inner, value))
    if problems:
        raise _in_one(path, problems)


# ------------------------------------------------------------------ positions


def _in_one(path: Path, problems: list[tuple[yaml.Mark | None, str]], more: int = 0) -> FileError:
    """The first problems in the order of their positions, each once, and one line with the number of others."""
    name = short_name(path)
    texts = []
    for mark, text in sorted(problems, key=_position):
        place = f":{mark.line + 1}:{mark.column + 1}" if mark else ""
        texts.append(f"{name}{place}: {text}")
    texts = list(dict.fromkeys(texts))
    more += len(texts[MAX_ERRORS:])
    tail = [f"{name}: there are {more:,} more errors; mend these first."] if more else []
    return FileError("\n".join([*texts[:MAX_ERRORS], *tail]))


def _position(problem: tuple[yaml.Mark | None, str]) -> tuple[int, int]:
    """Line and column of a problem; the first of the file if it has none."""
    mark = problem[0]
    return (mark.line, mark.column) if mark else (0, 0)


def _locate(root: yaml.Node, loc: Location, at_key: bool) -> tuple[Location, yaml.Mark]:
    """The existing keys of a location, and its position: of the value, or of the nearest key that leads to it.

    A mapping is marked at its key, and a missing value at the key of the mapping or list that lacks it.
    """
    node = root
    mark = root.start_mark
    known = []
    for depth, part in enumerate(loc):
        if isinstance(node, yaml.MappingNode):
            pair = next(((key, value) for key, value in node.value if str(key.value) == str(part)), None)
            known.append(part)
            if pair is None:
                break
            node = pair[1]
            plain = depth == len(loc) - 1 and node.value and not isinstance(node, yaml.MappingNode)
            mark = node.start_mark if plain and not at_key else pair[0].start_mark
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int):
            known.append(part)
            if part >= len(node.value):
                break
            node = node.value[part]
            mark = node.start_mark
        else:  # pydantic names the member of a union, or a key, after the last real key
            break
    return tuple(known), mark


def _key_path(loc: Location) -> str:
    """Keys and indices as text, such as nodes.dock.position[0]; long keys are cut."""
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part:.{MAX_KEY}}" for part in loc).lstrip(".")
