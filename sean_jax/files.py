"""YAML files read into pydantic models, with every error at once, each at its line and column, with its cure.

A message has one line an error, such as ``warehouse/graph.yaml:6:19: nodes.dock.kind: 'gruop' is not one of
waypoint, group; did you mean 'group'?``: file, line, column, keys, value, cure.
"""

import difflib
import json
import re
import types
import typing
from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from typing import Any, Literal, TypeVar

import pydantic
import yaml

Model = TypeVar("Model", bound=pydantic.BaseModel)
Location = tuple[str | int, ...]  # keys and list indices that lead to a value
Problem = tuple[Location, str]  # where, and what is wrong there, in one clause


class FileError(ValueError):
    """A file that cannot be used; the message names file, place, value and cure, one line an error."""


def load(path: Path | str, model: type[Model], *checks: Callable[[Model], Iterable[Problem]]) -> Model:
    """The YAML file as an instance of ``model``, which should forbid extra fields.

    ``checks`` look at relations between fields once every field is right by itself; what they return is reported
    at its place in the file too. Raises FileError.
    """
    path = Path(path)
    root, data = _read(path)
    try:
        value = model.model_validate_json(json.dumps(data), strict=True)
    except pydantic.ValidationError as error:
        details = error.errors(include_url=False)
        unknown = [item["loc"] for item in details if item["type"] == "extra_forbidden"]
        raise _report(path, root, [(item["loc"], _clause(item, model)) for item in details], unknown) from None
    except ValueError as error:  # an alias inside its own anchor
        raise FileError(f"{shown(path)}: cannot be used: {error}.") from None
    problems = [problem for check in checks for problem in check(value)]
    if problems:
        raise _report(path, root, problems)
    return value


def suggest(word: str, choices: Iterable[str]) -> str:
    """``; did you mean 'x'?`` for the choice most like the word, or nothing if none is like it."""
    choices = [str(choice) for choice in choices]
    lower = {choice.lower(): choice for choice in choices}
    found = difflib.get_close_matches(str(word).lower(), lower, n=1, cutoff=0.6)
    return f"; did you mean '{lower[found[0]]}'?" if found else ""


def shown(path: Path) -> str:
    """A file's name as messages give it: with the folder that it lies in."""
    return "/".join(part for part in (path.parent.name, path.name) if part)


class _Loader(yaml.SafeLoader):
    """YAML 1.2 scalars: ``no`` and ``on`` are words, ``1e5`` is a number, ``12:30`` and dates are text."""


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
    """SafeLoader's own reading takes 010 for 8."""
    text = node.value.lower().replace(".inf", "inf").replace(".nan", "nan")
    return int(text) if node.tag.endswith(":int") else float(text)


_Loader.add_constructor("tag:yaml.org,2002:int", _number)
_Loader.add_constructor("tag:yaml.org,2002:float", _number)


def _read(path: Path) -> tuple[yaml.Node, Any]:
    """The composed nodes, which know their places, and the plain data."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise FileError(f"{path}: there is no such file{_neighbour(path)}") from None
    except UnicodeDecodeError as error:
        raise FileError(f"{shown(path)}: byte {error.start} is not UTF-8 text; save the file as UTF-8.") from None
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}.") from None
    try:
        loader = _Loader(text)
        root = loader.get_single_node()
        if root is None:
            raise FileError(f"{shown(path)}:1:1: the file is empty.")
        _refuse_twins(path, root)
        return root, loader.construct_document(root)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{mark.line + 1}:{mark.column + 1}" if mark else "1:1"
        begun = f" that begins in line {error.context_mark.line + 1}" if error.context_mark else ""
        context = f"{error.context}{begun}, " if error.context else ""
        raise FileError(f"{shown(path)}:{place}: is not YAML: {context}{error.problem}.") from None
    except yaml.reader.ReaderError as error:
        raise FileError(f"{shown(path)}: character {error.position} is not allowed in YAML; remove it.") from None


def _neighbour(path: Path) -> str:
    """The suggestion of a file beside a missing one, or a full stop."""
    try:
        return suggest(path.name, (item.name for item in path.parent.iterdir())) or "."
    except OSError:
        return "; its folder does not exist either."


def _refuse_twins(path: Path, root: yaml.Node) -> None:
    """YAML lets the last of two equal keys win in silence; here they are an error."""
    problems: list[tuple[yaml.Mark, str]] = []
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
            first: dict[str, int] = {}
            for key, value in node.value:
                name, here = str(key.value), key.start_mark
                if name in first and name != "<<":
                    what = f"{_dotted((*loc, name))}: the key was used in line {first[name]}; remove or rename one."
                    problems.append((here, what))
                first.setdefault(name, here.line + 1)
                pending.append(((*loc, name), value))
    if problems:
        raise FileError(_lines(path, problems))


def _report(path: Path, root: yaml.Node, problems: Iterable[Problem], at_key: Collection[Location] = ()) -> FileError:
    """All problems, in the order of their places in the file; those in ``at_key`` are marked there."""
    marked = []
    for loc, clause in problems:
        known, mark = _place(root, loc, loc in at_key)
        end = "" if clause.endswith(("?", ".")) else "."
        marked.append((mark, f"{_dotted(known)}: {clause}{end}" if known else f"{clause}{end}"))
    return FileError(_lines(path, marked))


def _lines(path: Path, marked: list[tuple[yaml.Mark, str]]) -> str:
    marked = sorted(marked, key=lambda item: (item[0].line, item[0].column))
    lines = [f"{shown(path)}:{mark.line + 1}:{mark.column + 1}: {text}" for mark, text in marked]
    return "\n".join(dict.fromkeys(lines))


def _place(root: yaml.Node, loc: Location, at_key: bool) -> tuple[Location, yaml.Mark]:
    """The keys as the file has them, and the mark of the value, or of the nearest key that leads to it.

    A mapping is marked at its key, and a missing value at the key of what lacks it.
    """
    node, mark, known = root, root.start_mark, []
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


def _dotted(loc: Location) -> str:
    """nodes.dock.position[0]"""
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in loc).lstrip(".")


def _clause(error: Any, model: type[pydantic.BaseModel]) -> str:
    """pydantic's error as one clause that names the value and the cure."""
    loc, kind = error["loc"], error["type"]
    context = {key: f"{item:g}" if isinstance(item, float) else item for key, item in error.get("ctx", {}).items()}
    value = _quoted(error["input"])
    if kind == "missing":
        return "one value more is needed" if isinstance(loc[-1], int) else "is missing; add it"
    if kind == "extra_forbidden":
        keys = [key for part in _types_at(model, loc[:-1]) for key in getattr(part, "model_fields", ())]
        return f"'{loc[-1]}' is not a known key{suggest(str(loc[-1]), keys) or '; there are ' + ', '.join(keys)}"
    if kind == "literal_error":
        choices = [c for part in _types_at(model, loc) if typing.get_origin(part) is Literal for c in part.__args__]
        return f"{value} is not one of {', '.join(map(str, choices))}{suggest(str(error['input']), choices)}"
    if kind == "value_error":
        return str(context.get("error", error["msg"]))
    templates = {
        "float_type": "is not a number",
        "int_type": "is not a whole number",
        "int_from_float": "is not a whole number",
        "string_type": "is not text; put it in quotes",
        "string_too_short": "is too short a text",
        "bool_type": "is not true or false",
        "list_type": "is not a list, such as [a, b]",
        "tuple_type": "is not a list, such as [a, b]",
        "dict_type": "is not a mapping, which has lines 'key: value'",
        "model_type": "is not a mapping, which has lines 'key: value'",
        "model_attributes_type": "is not a mapping, which has lines 'key: value'",
        "finite_number": "is not a finite number",
        "greater_than": "is not greater than {gt}",
        "greater_than_equal": "is less than {ge}, the least allowed",
        "less_than": "is not less than {lt}",
        "less_than_equal": "is more than {le}, the most allowed",
        "too_short": "has {actual_length} values, {min_length} are needed",
        "too_long": "has {actual_length} values, {max_length} are allowed",
    }
    return f"{value} {templates[kind].format(**context)}" if kind in templates else f"{value}: {error['msg']}"


def _quoted(value: Any) -> str:
    text = "an empty value" if value is None else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _types_at(model: Any, loc: Location) -> list[Any]:
    """The types that a value at that place may have, unions taken apart."""
    found = _alternatives(model)
    for part in loc:
        found = [kind for outer in found for kind in _alternatives(_inner(outer, part))]
    return found


def _alternatives(kind: Any) -> list[Any]:
    origin = typing.get_origin(kind)
    if origin is typing.Annotated:
        return _alternatives(typing.get_args(kind)[0])
    if origin in (typing.Union, types.UnionType):
        return [one for arg in typing.get_args(kind) for one in _alternatives(arg)]
    return [kind]


def _inner(kind: Any, part: str | int) -> Any:
    """The type of an entry of a model, mapping, list or tuple; None if it has no such entry."""
    args = typing.get_args(kind)
    if isinstance(kind, type) and issubclass(kind, pydantic.BaseModel):
        field = kind.model_fields.get(str(part))
        return field.annotation if field else None
    if typing.get_origin(kind) is dict:
        return args[1]
    if typing.get_origin(kind) is tuple and isinstance(part, int) and Ellipsis not in args:
        return args[part] if part < len(args) else None
    return args[0] if args else None
