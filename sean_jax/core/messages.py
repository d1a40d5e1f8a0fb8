"""Sentences about wrong values: what messages on options, files and Python arguments have in common.

``parse_json`` stands here, since files and messages of a socket are the same JSON of strangers.
"""

import difflib
import json
import math
import re
from collections.abc import Iterable, Mapping
from typing import Any


def listed(text: str | None) -> list[str]:
    """The names in a text with commas between them; None has none."""
    return [name.strip() for name in (text or "").split(",") if name.strip()]


def shorten(text: str, length: int = 60) -> str:
    """A text, cut to ``length`` characters."""
    return text if len(text) <= length else text[: length - 3] + "..."


MAX_DEPTH = 60  # of values within values
MAX_DIGITS = 60  # characters of a whole number
MAX_JSON_VALUES = 4_000_000  # of a JSON text: a value of two characters takes a hundred times as many bytes
HALF = re.compile(r"\\u[dD][89a-fA-F]")  # how half a character, of the codes D800 to DFFF, is written in JSON


def parse_json(content: str | bytes, strict: bool = True, finite: bool = True) -> Any:
    """The value of a JSON text of a stranger.

    Args:
        strict: words must not contain the ends of lines and other control characters.
        finite: NaN and infinities are refused.

    Raises:
        ValueError: it is no JSON, or holds numbers, words or levels that no file or message needs; a clause.
    """

    def refuse(word: str) -> None:
        raise ValueError(f"{word} is not JSON")

    def decimal(word: str) -> float:
        if finite and not math.isfinite(float(word)):
            raise ValueError(f"{shorten(word)} is too large a number")
        return float(word)

    def whole(word: str) -> int:
        if len(word) > MAX_DIGITS:
            raise ValueError(f"a number has {len(word):,} digits; write fewer")
        return int(word)

    text = content.decode("utf-8-sig") if isinstance(content, bytes) else content  # json itself lets halves through
    if count_values(text) > MAX_JSON_VALUES:
        raise ValueError(f"it has more than {MAX_JSON_VALUES:,} values; make it smaller")
    numbers: dict[str, Any] = {"parse_constant": refuse} if finite else {}
    try:
        value = json.loads(text, strict=strict, parse_float=decimal, parse_int=whole, **numbers)
    except RecursionError:
        raise ValueError("values are nested too deeply") from None
    _check_depth(value)
    if HALF.search(text):
        _check_letters(value)
    return value


def count_values(text: str) -> int:
    """The number of values of a JSON text at most, without parsing it: its opening brackets and commas."""
    return sum(map(text.count, "{[,"))


def _check_depth(value: Any) -> None:
    level = [value] if isinstance(value, dict | list) else []
    for _ in range(MAX_DEPTH):
        if not level:
            return
        deeper = []
        for value in level:
            values = value.values() if isinstance(value, dict) else value
            deeper += [inner for inner in values if isinstance(inner, dict | list)]
        level = deeper
    raise ValueError("values are nested too deeply")


def _check_letters(value: Any) -> None:
    """Two halves that follow each other are one character for ``json``; a half alone cannot be written as UTF-8."""
    try:
        json.dumps(value, ensure_ascii=False).encode("utf-8")
    except UnicodeEncodeError:
        raise ValueError("half a character, of the codes D800 to DFFF; remove it") from None


def suggest(word: str, choices: Iterable[str]) -> str:
    """The end of a message about an unknown name: "; did you mean 'x'?", or nothing if no choice is like it."""
    choices = [str(choice) for choice in choices]
    lower = {choice.lower(): choice for choice in choices}
    close = difflib.get_close_matches(str(word).lower()[:100], lower, n=1, cutoff=0.6)
    return f"; did you mean '{lower[close[0]]}'?" if close else ""


def unknown_name(option: str, name: str, choices: Iterable[str]) -> str:
    """The sentence about an unknown name, with all choices and a suggestion."""
    choices = list(choices)
    return f"{option}: '{name}' is not one of {', '.join(choices)}{suggest(name, choices) or '.'}"


_TEXTS = {
    "float_type": "is not a number",
    "int_type": "is not a whole number",
    "int_from_float": "is not a whole number",
    "string_type": "is not text; put it in quotes",
    "string_too_short": "is too short a text",
    "string_too_long": "is too long a text; {max_length:,} characters are allowed",
    "bool_type": "is not true or false",
    "bool_parsing": "is not true or false",
    "path_type": "is not a path",
    "list_type": "is not a list, such as [a, b]",
    "tuple_type": "is not a list, such as [a, b]",
    "dict_type": "is not a mapping, which has lines 'key: value'",
    "model_type": "is not a mapping, which has lines 'key: value'",
    "model_attributes_type": "is not a mapping, which has lines 'key: value'",
    "finite_number": "is not a finite number",
    "greater_than": "is not greater than {gt:g}",
    "greater_than_equal": "is less than {ge:g}, the least allowed",
    "less_than": "is not less than {lt:g}",
    "less_than_equal": "is more than {le:g}, the most allowed",
    "too_short": "has {actual_length} values, {min_length} are needed",
    "too_long": "has {actual_length} values, {max_length} are allowed",
}


def error_clause(
    error: Mapping[str, Any], choices: Iterable[object] = (), keys: Iterable[str] = (), hint: str = ""
) -> str:
    """One of the errors of a ``pydantic.ValidationError``, as a clause with the value and the cure.

    Args:
        choices: of a Literal.
        keys: that a mapping may have, for an unknown key; a ``hint`` at the right one replaces their list.
    """
    kind = error["type"]
    context = error.get("ctx", {})
    place = error["loc"]
    entry = error["input"]
    value = "an empty value" if entry is None else shorten(repr(entry))
    if kind == "missing":
        return "one value more is needed" if isinstance(place[-1], int) else "is missing; add it"
    if kind == "extra_forbidden":
        key = str(place[-1])
        keys = list(keys)
        cure = hint or suggest(key, keys) or f"; there are {', '.join(keys)}"
        return f"{shorten(repr(key))} is not a known key{cure}"
    if kind == "literal_error":
        names = [str(choice) for choice in choices]
        return f"{value} is not one of {', '.join(names)}{suggest(str(entry), names)}"
    if kind == "value_error":
        return str(context.get("error", error["msg"]))
    if kind == "invalid_key":
        return f"the key {shorten(repr(place[-1]))} is not text; put it in quotes"
    return f"{value} {_TEXTS[kind].format(**context)}" if kind in _TEXTS else f"{value}: {error['msg']}"
