"""Changes of a YAML text at the place of one value: all other characters stay, comments among them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import yaml

from sean_jax.core.errors import InputError

Keys = Sequence[str | int]  # and indices, from the root to a value


def node_at(text: str, keys: Keys) -> yaml.Node:
    """The node of a value, also one that an alias or a merge key takes from elsewhere in the text.

    Raises:
        KeyError: there is none.
    """
    node = yaml.compose(text, Loader=yaml.SafeLoader)
    for key in keys:
        node = _child(node, key)
    return node


def names_at(text: str, keys: Keys) -> list[str]:
    """The keys of a mapping of the text itself; none if it is no mapping."""
    node = node_at(text, keys)
    return [key.value for key, _ in node.value] if isinstance(node, yaml.MappingNode) else []


def replaced(text: str, keys: Keys, value: str) -> str:
    """The text with another scalar, or with a key that its mapping does not have yet."""
    try:
        node = node_at(text, keys)
    except KeyError:
        return _with_key(text, keys, value)
    return text[: _begin(text, node)] + value + text[node.end_mark.index :]


def extended(text: str, keys: Keys, entry: str) -> str:
    """The text with another last entry, ``KEY: VALUE`` of a mapping or a value of a list."""
    node = node_at(text, keys)
    entries = _entries(node)
    if _in_line(node):
        if not entries:
            place = _begin(text, node) + 1
            return text[:place] + entry + text[place:]
        place = _span(node, len(entries) - 1)[1]
        return f"{text[:place]}, {entry}{text[place:]}"

    # In a block, a line behind the last entry's, with its indentation.
    mark = "- " if isinstance(node, yaml.SequenceNode) else ""
    line = " " * node.start_mark.column + mark + entry
    place = _line_end(text, _span(node, len(entries) - 1)[1])
    before = text[:place]
    if not before.endswith("\n"):
        before += "\n"
    return f"{before}{line}\n{text[place:]}"


def removed(text: str, keys: Keys) -> str:
    """The text without an entry of a mapping or list, and without the comment behind it."""
    node = node_at(text, keys[:-1])
    index = _index(node, keys[-1])
    if _in_line(node):
        return _removed_in_line(text, node, index)

    # In a block, the lines of the entry, which must hold nothing else.
    first, last = _span(node, index)
    start = text.rfind("\n", 0, first) + 1
    end = _line_end(text, last)
    if text[start:first].strip() not in ("", "-"):
        raise _refusal()
    if len(node.value) > 1:
        return text[:start] + text[end:]
    empty = "{}" if isinstance(node, yaml.MappingNode) else "[]"
    indent = " " * (node.start_mark.column + 2)
    return f"{text[:start]}{indent}{empty}\n{text[end:]}"


def _index(node: yaml.Node, key: str | int) -> int:
    """The number of an entry of a mapping or list."""
    if isinstance(node, yaml.MappingNode):
        return [name.value for name, _ in node.value].index(key)
    return int(key)


def _removed_in_line(text: str, node: yaml.Node, index: int) -> str:
    """The text without an entry in braces or brackets, and without the comma behind it, or else before it."""
    first, last = _span(node, index)
    if index + 1 < len(node.value):
        last = _span(node, index + 1)[0]
    elif index:
        first = _span(node, index - 1)[1]
    return text[:first] + text[last:]


def _child(node: yaml.Node | None, key: str | int) -> yaml.Node:
    """The value of an entry, also one of a mapping that is merged; KeyError if there is none."""
    if isinstance(node, yaml.SequenceNode) and isinstance(key, int) and 0 <= key < len(node.value):
        return node.value[key]
    if not isinstance(node, yaml.MappingNode):
        raise KeyError(key)
    for name, value in node.value:
        if name.value == key:
            return value
    for merged in _merged(node):
        try:
            return _child(merged, key)
        except KeyError:
            continue
    raise KeyError(key)


def _merged(node: yaml.MappingNode) -> Iterator[yaml.Node]:
    """The mappings that merge keys of a mapping name."""
    for name, value in node.value:
        if name.value == "<<":
            yield from value.value if isinstance(value, yaml.SequenceNode) else [value]


def _with_key(text: str, keys: Keys, value: str) -> str:
    node = node_at(text, keys[:-1])
    entry = f"{keys[-1]}: {value}"
    if not isinstance(node, yaml.MappingNode):
        raise KeyError(keys[-1])
    if _in_line(node) or not node.value:
        return extended(text, keys[:-1], entry)
    first = node.value[0][0].start_mark
    return text[: first.index] + entry + "\n" + " " * first.column + text[first.index :]


def _entries(node: yaml.Node) -> list[tuple[yaml.Node, yaml.Node]]:
    """First and last node of each entry."""
    if isinstance(node, yaml.MappingNode):
        return node.value
    return [(value, value) for value in node.value]


def _in_line(node: yaml.Node) -> bool:
    """Whether a mapping or list is in braces or brackets."""
    return isinstance(node, yaml.CollectionNode) and bool(node.flow_style)


def _begin(text: str, node: yaml.Node) -> int:
    """Where a node begins, behind its anchor."""
    place = node.start_mark.index
    anchor = re.compile(r"&\S+\s*").match(text, place)
    return anchor.end() if anchor else place


def _span(node: yaml.Node, index: int) -> tuple[int, int]:
    """Where an entry begins, and where it ends before comments and empty lines.

    Raises:
        InputError: an alias stands there, whose value is elsewhere in the text.
    """
    entries = _entries(node)
    before = entries[index - 1][0].start_mark.index + 1 if index else node.start_mark.index
    key, value = entries[index]
    begin = key.start_mark.index
    if not before <= begin <= value.start_mark.index:
        raise _refusal()
    if isinstance(value, yaml.CollectionNode) and not value.flow_style and value.value:
        return begin, _span(value, len(value.value) - 1)[1]
    return begin, value.end_mark.index


def _line_end(text: str, place: int) -> int:
    """Behind the line of a place."""
    if text[:place].endswith("\n"):
        return place
    end = text.find("\n", place)
    return len(text) if end < 0 else end + 1


def _refusal() -> InputError:
    return InputError("edit: this part of the file has a form that the page cannot change; edit the file.")
