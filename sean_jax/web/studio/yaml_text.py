"""Changes of a YAML text at the place of one value: all other characters stay, comments among them."""

from __future__ import annotations

from collections.abc import Sequence

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
    start, end = _begin(text, node), node.end_mark.index
    return text[:start] + value + text[end:]


def extended(text: str, keys: Keys, entry: str) -> str:
    """The text with another last entry, ``KEY: VALUE`` or ``VALUE``, of a mapping or list."""
    node = node_at(text, keys)
    entries = _entries(node)
    if _in_line(node):
        place = _span(node, len(entries) - 1)[1] if entries else _begin(text, node) + 1
        return text[:place] + (", " if entries else "") + entry + text[place:]
    line = " " * node.start_mark.column + ("- " if isinstance(node, yaml.SequenceNode) else "") + entry
    place = _line_end(text, _span(node, len(entries) - 1)[1])
    return text[:place] + ("" if text[:place].endswith("\n") else "\n") + line + "\n" + text[place:]


def removed(text: str, keys: Keys) -> str:
    """The text without an entry of a mapping or list, and without the comment behind it."""
    node = node_at(text, keys[:-1])
    entries = _entries(node)
    mapping = isinstance(node, yaml.MappingNode)
    index = [key.value for key, _ in entries].index(keys[-1]) if mapping else int(keys[-1])
    first, last = _span(node, index)
    if _in_line(node):
        if index + 1 < len(entries):
            last = _span(node, index + 1)[0]
        elif index:
            first = _span(node, index - 1)[1]
        return text[:first] + text[last:]
    start, end = text.rfind("\n", 0, first) + 1, _line_end(text, last)
    if text[start:first].strip() not in ("", "-"):
        raise _refusal()
    left = "" if len(entries) > 1 else " " * (node.start_mark.column + 2) + ("{}" if mapping else "[]") + "\n"
    return text[:start] + left + text[end:]


def _child(node: yaml.Node | None, key: str | int) -> yaml.Node:
    if isinstance(node, yaml.SequenceNode) and isinstance(key, int) and 0 <= key < len(node.value):
        return node.value[key]
    if isinstance(node, yaml.MappingNode):
        pairs = [(name.value, value) for name, value in node.value]
        own = [value for name, value in pairs if name == key]
        if own:
            return own[0]
        for merged in (value for name, value in pairs if name == "<<"):
            for each in merged.value if isinstance(merged, yaml.SequenceNode) else [merged]:
                try:
                    return _child(each, key)
                except KeyError:
                    continue
    raise KeyError(key)


def _with_key(text: str, keys: Keys, value: str) -> str:
    node, entry = node_at(text, keys[:-1]), f"{keys[-1]}: {value}"
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
    if text[place] == "&":
        place += len(text[place:].split(maxsplit=1)[0])
        place += len(text[place:]) - len(text[place:].lstrip())
    return place


def _span(node: yaml.Node, index: int) -> tuple[int, int]:
    """Where an entry begins, and where it ends before comments and empty lines.

    Raises:
        InputError: an alias stands there, whose value is elsewhere in the text.
    """
    entries = _entries(node)
    before = entries[index - 1][0].start_mark.index + 1 if index else node.start_mark.index
    first, value = (part.start_mark.index for part in entries[index])
    if not before <= first <= value:
        raise _refusal()
    last = entries[index][1]
    if isinstance(last, yaml.CollectionNode) and not last.flow_style and last.value:
        return first, _span(last, len(last.value) - 1)[1]
    return first, last.end_mark.index


def _line_end(text: str, place: int) -> int:
    """Behind the line of a place."""
    if text[:place].endswith("\n"):
        return place
    end = text.find("\n", place)
    return len(text) if end < 0 else end + 1


def _refusal() -> InputError:
    return InputError("edit: this part of the file has a form that the page cannot change; edit the file.")
