"""YAML as nodes, which know their positions in the file, and as plain data: scalars, lists and mappings.

Other features of YAML are refused at their position: tags, which make other types or run code, and aliases that expand
to more than a file could hold.
"""

import re
from pathlib import Path
from typing import Any

import yaml

from sean_jax.errors import FileError
from sean_jax.files.reading import MAX_DEPTH, read_text, short_name

MAX_ERRORS = 100  # of a file that a message names
MAX_KEY = 60  # characters of a key in a message
MAX_VALUES = 50_000  # in a file, with aliases expanded
MAX_DIGITS = 60  # characters of a number
Location = tuple[str | int, ...]  # keys and list indices that lead to a value


class _Loader(yaml.SafeLoader):
    """YAML 1.2 scalars: ``no`` and ``on`` are words, ``1e5`` is a number, ``12:30`` and dates are text."""

    def __init__(self, stream: str):
        super().__init__(stream)
        self.depth, self.values = 0, 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose a node as SafeLoader does, if it has no tag, and values are not too deep and not too many."""
        event: Any = self.peek_event()
        tag = getattr(event, "tag", None)
        if tag is not None and not (tag == "tag:yaml.org,2002:str" and isinstance(event, yaml.ScalarEvent)):
            tag_text = tag.replace("tag:yaml.org,2002:", "!!")
            raise yaml.MarkedYAMLError(problem=f"tags such as '{tag_text}' mean nothing here; remove it",
                                       problem_mark=event.start_mark)  # fmt: skip
        self.values += 1
        if self.depth >= MAX_DEPTH or self.values > MAX_VALUES:
            what = f"nested deeper than {MAX_DEPTH} levels" if self.depth >= MAX_DEPTH else f"more than {MAX_VALUES:,}"
            raise yaml.MarkedYAMLError(problem=f"values are {what}; make it simpler", problem_mark=event.start_mark)
        self.depth += 1
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


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
        raise yaml.MarkedYAMLError(problem=f"a number has {len(value)} characters; write fewer digits",
                                   problem_mark=node.start_mark)  # fmt: skip
    return int(value) if node.tag.endswith(":int") else float(value)


def _word(_: yaml.SafeLoader, node: yaml.ScalarNode) -> str:
    if any("\ud800" <= letter <= "\udfff" for letter in node.value):
        raise yaml.MarkedYAMLError(problem="half a character, of the codes D800 to DFFF; remove it",
                                   problem_mark=node.start_mark)  # fmt: skip
    return node.value


_Loader.add_constructor("tag:yaml.org,2002:int", _number)
_Loader.add_constructor("tag:yaml.org,2002:float", _number)
_Loader.add_constructor("tag:yaml.org,2002:str", _word)


def read(path: Path) -> tuple[yaml.Node, Any]:
    """Read a YAML file.

    Raises:
        FileError: it cannot be read, or is not YAML of the plain kind.
    """
    text, loader = read_text(path), None
    try:
        loader = _Loader(text)
        root = loader.get_single_node()
        if root is None:
            raise FileError(f"{short_name(path)}:1:1: the file is empty.")
        _refuse_alias_bombs(path, root)
        _refuse_duplicate_keys(path, root)
        return root, loader.construct_document(root)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{mark.line + 1}:{mark.column + 1}" if mark else "1:1"
        start = f" that begins in line {error.context_mark.line + 1}" if error.context_mark else ""
        context = f"{error.context}{start}, " if error.context else ""
        raise FileError(f"{short_name(path)}:{place}: is not YAML: {context}{_plain(error.problem)}.") from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        what = f"character {error.position} is not allowed in YAML"
        raise FileError(f"{short_name(path)}:{line}: {what}; remove it.") from None
    except (ValueError, OverflowError) as error:  # such as of "\UFFFFFFFF"
        if isinstance(error, FileError):
            raise
        mark = loader.get_mark() if loader else None
        place = f":{mark.line + 1}:{mark.column + 1}" if mark else ""
        raise FileError(f"{short_name(path)}{place}: is not YAML: {error}.") from None


def _plain(problem: str | None) -> str:
    return "a key is a list or a mapping; write a word" if problem == "found unhashable key" else str(problem)


def _children(node: yaml.Node) -> list[yaml.Node]:
    if isinstance(node, yaml.MappingNode):
        return [part for pair in node.value for part in pair]
    return node.value if isinstance(node, yaml.SequenceNode) else []


def _refuse_alias_bombs(path: Path, root: yaml.Node) -> None:
    """Count values with aliases expanded: a few lines of aliases can stand for billions of values."""
    sizes: dict[int, int | None] = {}  # None while a node is being counted
    pending = [(root, False)]
    while pending:
        node, is_done = pending.pop()
        place = f"{short_name(path)}:{node.start_mark.line + 1}:{node.start_mark.column + 1}"
        if is_done:
            sizes[id(node)] = 1 + sum(sizes[id(child)] or 0 for child in _children(node))
            if (sizes[id(node)] or 0) > MAX_VALUES:
                raise FileError(f"{place}: aliases unfold to more than {MAX_VALUES:,} values; write fewer.")
        elif id(node) not in sizes:
            sizes[id(node)] = None
            pending += [(node, True), *((child, False) for child in _children(node))]
        elif sizes[id(node)] is None:
            raise FileError(f"{place}: an alias stands inside of its own anchor; remove it.")


def _refuse_duplicate_keys(path: Path, root: yaml.Node) -> None:
    """Refuse equal keys of a mapping, of which YAML would silently take the last."""
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
                    what = f"{key_path((*loc, name))}: the key was used in line {first[name]}; remove or rename one."
                    problems.append((here, what))
                first.setdefault(name, here.line + 1)
                pending.append(((*loc, name), value))
    if problems:
        raise FileError(lines(path, problems))


def lines(path: Path, marked: list[tuple[yaml.Mark, str]], more: int = 0) -> str:
    """Format problems in the order of their positions in the file."""
    marked = sorted(marked, key=lambda item: (item[0].line, item[0].column))
    return limit_lines(
        path, [f"{short_name(path)}:{mark.line + 1}:{mark.column + 1}: {text}" for mark, text in marked], more
    )


def limit_lines(path: Path, messages: list[str], more: int = 0) -> str:
    """Limit the number of lines of a message.

    Returns:
        The first lines, each once, and one line with the number of problems that are left out.
    """
    messages = list(dict.fromkeys(messages))
    more += len(messages[MAX_ERRORS:])
    tail = [f"{short_name(path)}: there are {more:,} more errors; mend these first."] if more else []
    return "\n".join([*messages[:MAX_ERRORS], *tail])


def locate(root: yaml.Node, loc: Location, at_key: bool) -> tuple[Location, yaml.Mark]:
    """Find the position of a value.

    A mapping is marked at its key, and a missing value at the key of the mapping or list that lacks it.

    Returns:
        The keys that the file has, and the position of the value, or of the nearest key that leads to it.
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


def key_path(loc: Location) -> str:
    """Format the keys and indices that lead to a value.

    Returns:
        Text such as nodes.dock.position[0]; of a long key its beginning.
    """
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part:.{MAX_KEY}}" for part in loc).lstrip(".")
