"""YAML files as pydantic models: all errors of one kind at once, each with its line, its column and its cure.

A message has one line an error, such as ``warehouse/graph.yaml:6:19: nodes.dock.kind: 'gruop' is not one of
waypoint, group; did you mean 'group'?``: file, line, column, keys, value, cure.
"""

import json
import types
import typing
from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from typing import Any, Literal, TypeVar

import pydantic
import yaml

from sean_jax.errors import FileError
from sean_jax.files import nodes
from sean_jax.files.nodes import Location
from sean_jax.files.reading import (
    MAX_BYTES,
    MAX_DEPTH,
    MAX_RECORD,
    MAX_TABLE,
    open_file,
    read_arrays,
    read_bytes,
    read_json,
    read_rows,
    read_text,
    sentence,
    short_name,
)
from sean_jax.messages import error_clause, listed, suggest, unknown_name

__all__ = [
    "MAX_BYTES",
    "MAX_DEPTH",
    "MAX_RECORD",
    "MAX_TABLE",
    "FileError",
    "Location",
    "Problem",
    "check_json",
    "open_file",
    "read_arrays",
    "read_bytes",
    "listed",
    "load",
    "read_json",
    "read_rows",
    "sentence",
    "short_name",
    "suggest",
    "unknown_name",
    "read_text",
]

Model = TypeVar("Model", bound=pydantic.BaseModel)
Problem = tuple[Location, str]  # where, and what is wrong there, in one clause


def load(path: Path | str, model: type[Model], *checks: Callable[[Model], Iterable[Problem]]) -> Model:
    """Read a YAML file into a pydantic model.

    Args:
        *checks: of relations between fields, once each field is right by itself. They give problems, which are
            reported at their positions in the file.

    Raises:
        FileError: the file cannot be read, or its content is wrong.
    """
    path = Path(path)
    root, data = nodes.read(path)
    try:
        value = model.model_validate_json(json.dumps(data), strict=True)
    except pydantic.ValidationError as error:
        details = error.errors(include_url=False)
        first, more = details[: nodes.MAX_ERRORS], len(details[nodes.MAX_ERRORS :])
        unknown = {item["loc"] for item in first if item["type"] == "extra_forbidden"}
        raise _report(path, root, [(item["loc"], _clause(item, model)) for item in first], unknown, more) from None
    problems = [problem for check in checks for problem in check(value)]
    if problems:
        raise _report(path, root, problems[: nodes.MAX_ERRORS], more=len(problems[nodes.MAX_ERRORS :]))
    return value


def check_json(path: Path | str, data: Any, model: type[Model], *checks: Callable[[Model], Iterable[Problem]]) -> Model:
    """Check the values of a JSON file.

    Args:
        *checks: as of ``load``.

    Raises:
        FileError: the content is wrong.
    """
    path = Path(path)
    try:
        value = model.model_validate_json(json.dumps(data), strict=True)
    except pydantic.ValidationError as error:
        details = error.errors(include_url=False)
        more = len(details[nodes.MAX_ERRORS :])
        problems = [(item["loc"], _clause(item, model)) for item in details[: nodes.MAX_ERRORS]]
    else:
        problems, more = [problem for check in checks for problem in check(value)], 0
        if not problems:
            return value
    lines = [f"{short_name(path)}: {_sentence(loc, clause)}" for loc, clause in problems]
    raise FileError(nodes.limit_lines(path, lines, more))


def _report(
    path: Path, root: yaml.Node, problems: Iterable[Problem], at_key: Collection[Location] = (), more: int = 0
) -> FileError:
    """A FileError of problems at their positions in the file; those in ``at_key`` are marked at their key."""
    marked = []
    for loc, clause in problems:
        keys, mark = nodes.locate(root, loc, loc in at_key)
        marked.append((mark, _sentence(keys, clause)))
    return FileError(nodes.lines(path, marked, more))


def _sentence(loc: Location, clause: str) -> str:
    end = "" if clause.endswith(("?", ".")) else "."
    return f"{nodes.key_path(loc)}: {clause}{end}" if loc else f"{clause}{end}"


def _clause(error: Any, model: type[pydantic.BaseModel]) -> str:
    """A pydantic error as one clause that names the value and the cure."""
    loc = error["loc"]
    keys = [key for part in _types_at(model, loc[:-1]) for key in getattr(part, "model_fields", ())]
    choices = [c for part in _types_at(model, loc) if typing.get_origin(part) is Literal for c in part.__args__]
    return error_clause(error, choices, keys)


def _types_at(model: Any, loc: Location) -> list[Any]:
    """The types that a value at that location may have, with unions split."""
    kinds = _alternatives(model)
    for part in loc:
        kinds = [kind for outer in kinds for kind in _alternatives(_inner(outer, part))]
    return kinds


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
