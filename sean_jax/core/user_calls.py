"""Calls of functions that may be the user's: errors and wrong results become one sentence.

The sentence names the part, the file and line of the innermost frame of the user's code, and the cure. The error is
raised during tracing, before anything is compiled. Errors in the package's own functions are left alone.
"""

import dataclasses
import difflib
import functools
import inspect
import linecache
import os
import re
import sysconfig
import types
import typing
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from sean_jax.core.errors import PartError, SeanError

PACKAGE = str(Path(__file__).resolve().parents[1]) + os.sep
LIBRARIES = f"{os.sep}site-packages{os.sep}", f"{os.sep}dist-packages{os.sep}"
STANDARD = sysconfig.get_paths()["stdlib"] + os.sep
MAX_TEXT = 200  # characters of a message of another's
JAX = "jnp.where(condition, a, b) for if, &, | and ~ for and, or and not, jax.lax.while_loop for while"
KINDS = {bool: "bool", float: "float"}  # of the elements of an array, as messages name them
GENERICS = {bool: (np.bool_,), float: (np.floating,), None: (np.bool_, np.integer, np.floating)}
"""Kind of elements -> its types in numpy."""


def call(part: str, function: Callable, arguments: str, *values: Any) -> Any:
    """The result of a function of a part; ``part``, such as policy, begins the message.

    Raises:
        PartError: the function is the user's and raises an error, or takes other arguments.
    """
    try:
        return function(*values)
    except (SeanError, MemoryError, jax.errors.JaxRuntimeError):
        raise
    except Exception as error:
        text = _explain(error, _plain(function), getattr(function, "arguments", arguments))
        if text is None:
            raise
        raise PartError(f"{part}: {text}") from error


def check_array(
    part: str, function: Callable, value: Any, kind: type | None, shape: tuple[int, ...] | None, cure: str
) -> None:
    """Refuse a value that is no array of a kind (``bool``, ``float``, or any number if None) and shape (any if None).

    Raises:
        PartError: it is none.
    """
    is_array = isinstance(value, jax.Array | np.ndarray | np.generic | bool | int | float)
    if is_array and (shape is None or jnp.shape(value) == shape):
        dtype = jnp.result_type(value)
        if any(jnp.issubdtype(dtype, generic) for generic in GENERICS[kind]):
            return
    expected = KINDS.get(kind, "an array of numbers")
    if shape is not None:
        expected = f"{expected} {shape}"
    raise wrong(part, function, describe(value), expected, cure)


def check_type(part: str, function: Callable, value: Any, kind: type, **sizes: int) -> None:
    """Refuse a value of another type, or with fields of other shapes than in the annotations.

    Raises:
        PartError: it is not.
    """
    if not isinstance(value, kind):
        raise wrong(part, function, describe(value), f"a {kind.__name__}", f"give a sean_jax.{kind.__name__}")
    known = dict(sizes)
    for name, dims, dtypes in _fields(kind):
        field = getattr(value, name)
        if not _fits(field, dims, dtypes, known):
            shape = ", ".join(str(known.get(dim, dim)) for dim in dims) + ("," if len(dims) == 1 else "")
            dtype = re.sub(r"\W.*|\d+", "", dtypes[-1])
            cure = f"give {kind.__name__}.{name} that shape"
            raise wrong(part, function, f"{name} = {describe(field)}", f"{dtype} ({shape})", cure)


def _fits(field: Any, dims: tuple[str, ...], dtypes: tuple[str, ...], known: dict[str, int]) -> bool:
    """Whether an array has a shape by its letters, whose sizes go to ``known``, and a type that matches a pattern."""
    if not isinstance(field, jax.Array | np.ndarray | np.generic) or jnp.ndim(field) != len(dims):
        return False
    expected = []
    for dim, size in zip(dims, jnp.shape(field), strict=True):
        expected.append(int(dim) if dim.isdigit() else known.setdefault(dim, size))
    return list(field.shape) == expected and any(re.fullmatch(dtype, str(field.dtype)) for dtype in dtypes)


def check_like(part: str, function: Callable, value: PyTree, like: PyTree, what: str) -> None:
    """Refuse a value whose structure, shapes or types differ from those of ``like``.

    Raises:
        PartError: it is not.
    """
    if jax.tree.structure(value) != jax.tree.structure(like):
        cure = "keep its structure, for steps follow one another"
        if type(value) is type(like) and not isinstance(value, tuple | list | dict):
            raise wrong(part, function, f"{what} other fields", "those that it had", cure)
        raise wrong(part, function, f"{what} {describe(value)}", describe(like), cure)
    leaves = jax.tree_util.tree_leaves_with_path(value)
    for (path, new), old in zip(leaves, jax.tree.leaves(like), strict=True):
        if jnp.shape(new) != jnp.shape(old) or jnp.result_type(new) != jnp.result_type(old):
            name = f"{what}{jax.tree_util.keystr(path)}"
            cure = "keep shape and type, for steps follow one another"
            raise wrong(part, function, f"{name} {describe(new)}", describe(old), cure)


def describe(value: Any) -> str:
    """A value in a few words, such as "float32 (2,)", "None" or "a list of 2"."""
    if value is None:
        return "None"
    if isinstance(value, jax.Array | np.ndarray | np.generic | jax.ShapeDtypeStruct):
        return f"{value.dtype} {value.shape}"
    if isinstance(value, list | tuple | dict):
        return f"a {type(value).__name__} of {len(value)}"
    if isinstance(value, str | int | float):
        return f"{type(value).__name__} {value!r:.40}"
    return f"the class {value.__name__}" if isinstance(value, type) else f"a {type(value).__name__}"


def wrong(part: str, function: Callable, actual: str, expected: str, cure: str) -> PartError:
    """The error about a function with a wrong result."""
    plain = _plain(function)
    missing = ", for a return is missing" if actual.endswith("None") else ""
    return PartError(f"{part}: {_definition(plain)}{_name(plain)} gives {actual}, not {expected}{missing}; {cure}.")


@functools.cache
def _fields(kind: type) -> tuple[tuple[str, tuple[str, ...], tuple[str, ...]], ...]:
    """Name, letters of the shape, and patterns of the types of each field with a shape in its annotation."""
    hints = typing.get_type_hints(kind)
    fields = []
    for field in dataclasses.fields(kind):
        union = typing.get_args(hints[field.name])
        hint = union[0] if union else hints[field.name]  # arrays of jax, numpy and numpy's scalars
        if hasattr(hint, "dim_str") and type(None) not in union:
            fields.append((field.name, tuple(hint.dim_str.split()), tuple(map(str, hint.dtypes))))
    return tuple(fields)


# ------------------------------------------------------------------ whose function, and where


def _plain(function: Any) -> Any:
    """A user's function without wrappers of the package or of ``functools``."""
    while True:
        if isinstance(function, functools.partial):
            function = function.func
        elif type(function).__module__.startswith("sean_jax.") and hasattr(function, "function"):
            function = function.function
        elif hasattr(function, "__wrapped__"):
            function = function.__wrapped__
        else:
            return function


def _code(function: Any) -> types.CodeType | None:
    """The code of a function, of a method, or of an object's ``__call__``."""
    method = function.__init__ if isinstance(function, type) else getattr(type(function), "__call__")  # noqa: B004, B009
    for candidate in (function, getattr(function, "__func__", None), method):
        plain = inspect.unwrap(candidate) if callable(candidate) else candidate
        code = getattr(plain, "__code__", None)
        if isinstance(code, types.CodeType):
            return code
    return None


def _is_own(function: Any) -> bool:
    """Whether a function is the user's."""
    code = _code(function)
    if code:
        return not code.co_filename.startswith(PACKAGE)
    return not str(getattr(function, "__module__", "")).startswith("sean_jax.")


def _place(file: str, line: int) -> str:
    """FILE:LINE, relative to the current folder if the file is in it."""
    try:
        near = os.path.relpath(file)
    except ValueError:  # another drive
        near = file
    return f"{file if near.startswith(os.pardir) else near}:{line}"


def _definition(function: Any) -> str:
    """The place of a function, to begin a message."""
    code = _code(function)
    return f"{_place(code.co_filename, code.co_firstlineno)}: " if code else ""


def _name(function: Any) -> str:
    return getattr(function, "__qualname__", type(function).__name__).rpartition("<locals>.")[2]


def _innermost(error: BaseException, function: Any) -> tuple[str, int] | None:
    """File and line of the innermost frame in the user's code; None if there is none."""
    code = _code(function)
    own = code.co_filename if code else None
    place = None
    trace = error.__traceback__
    while trace is not None:
        frame = trace.tb_frame.f_code
        file = frame.co_filename
        foreign = any(folder in file for folder in LIBRARIES) or file.startswith((STANDARD, "<frozen", "<@beartype"))
        foreign |= file == "<string>" and frame.co_name.startswith("__")  # methods that dataclasses writes
        if not file.startswith(PACKAGE) and (file == own or not foreign):
            place = file, trace.tb_lineno
        trace = trace.tb_next
    return place


# ------------------------------------------------------------------ what went wrong, and the cure


def _explain(error: Exception, function: Any, arguments: str) -> str | None:
    """Place, reason and cure in one sentence; None if no code of the user took part."""
    place = _innermost(error, function)
    if place is not None:
        return f"{_place(*place)}: {_reason(error, linecache.getline(*place))}."
    if not _is_own(function):
        return None
    reason = _other_arguments(function, arguments) or _reason(error, "")
    return f"{_definition(function)}{reason}."


def _other_arguments(function: Any, arguments: str) -> str | None:
    """A clause about a function that takes other arguments than those that it is called with; None if it takes them."""
    count = len(arguments.split(", "))
    try:
        signature = inspect.signature(function)
        signature.bind(*[None] * count)
    except TypeError:
        if not callable(function):
            return None
        parameters = str(signature).partition(" ->")[0]
        return (
            f"{_name(function)} takes {parameters}, and is called with ({arguments}); give it those {count} arguments"
        )
    except ValueError:  # a builtin without a signature
        pass
    return None


def _reason(error: Exception, line: str) -> str:
    """The meaning of an exception, with the cure; ``line`` is the source line that raised it."""
    name = type(error).__name__
    text = str(error)
    if meaning := _MEANINGS.get(name):
        return meaning if isinstance(meaning, str) else meaning(error, line)
    first = re.split(r"\n|(?<=[a-z)\]])\. ", text.strip() or "no reason given", maxsplit=1)[0]
    if "item assignment" in text or "immutable" in text:
        return "an array cannot be changed in place; write x = x.at[index].set(value)"
    if isinstance(error, TypeError | ValueError) and re.search(r"shape|broadcast|dimension|dot_general", text):
        first = f"{first[:MAX_TEXT]}; print(x.shape) where it is traced shows the shapes"
    return f"{name}: {first[: 2 * MAX_TEXT].rstrip('.')}"


def _concrete(error: Exception, line: str) -> str:
    """``float(x)`` and the like, or a size that depends on data."""
    if match := re.search(r"\b(math|np|numpy)\.\w+", line):
        return f"{match[0]} takes no traced value; write jnp. for {match[1]}."
    if match := re.search(r"\b(float|int|bool|complex|round|range|str|format)\(|\.(item|tolist)\(", line):
        if match[1] == "range":
            return (
                "range() takes no traced value, whose number is known only when the program runs; write "
                "jax.lax.fori_loop over a fixed number"
            )
        called = f"{match[1]}()" if match[1] else f".{match[2]}()"
        return (
            f"{called} takes no traced value, whose number is known only when the program runs; write the array as it "
            "is, or x.astype(...)"
        )
    return (
        "a size or an index depends on a traced value, whose number is known only when the program runs; keep the "
        "whole array, and mask it by jnp.where(mask, values, 0.0)"
    )


def _attribute(error: Exception, line: str) -> str:
    """An attribute that a value does not have."""
    thing = getattr(error, "obj", None)
    name = str(getattr(error, "name", ""))
    if thing is None or not name:
        return f"AttributeError: {str(error).splitlines()[0][:MAX_TEXT].rstrip('.')}"
    if dataclasses.is_dataclass(thing):
        names = [field.name for field in dataclasses.fields(thing)]
    else:
        names = [attribute for attribute in dir(thing) if not attribute.startswith("_")]

    # The thing as the user calls it.
    kind = getattr(thing, "__name__", "") if isinstance(thing, types.ModuleType | type) else type(thing).__name__
    if isinstance(thing, jax.Array):
        kind = "an array"

    if close := difflib.get_close_matches(name, names, 1):
        return f"{kind} has no '{name}'; did you mean '{close[0]}'"
    if len(names) < 40:
        return f"{kind} has no '{name}'; it has {', '.join(names)[:MAX_TEXT]}"
    return f"{kind} has no '{name}'; see its documentation"


def _unknown(error: Exception, line: str) -> str:
    name = str(getattr(error, "name", ""))
    modules = {"jnp": "import jax.numpy as jnp", "jax": "import jax", "np": "import jax.numpy as jnp, and write jnp."}
    modules |= {"sean_jax": "import sean_jax", "math": "import jax.numpy as jnp, and write jnp."}
    return f"'{name}' is not defined; {modules.get(name, 'define it, or correct the name')}".rstrip(".")


_MEANINGS: Mapping[str, str | Callable[[Exception, str], str]] = {
    "TracerBoolConversionError": (
        f"a condition on a traced value, whose number is known only when the program runs; write {JAX}"
    ),
    "TracerArrayConversionError": "numpy takes no traced value; write jnp. for np., with `import jax.numpy as jnp`",
    "TracerIntegerConversionError": (
        "a list, a range or a shape takes no traced value; index an array, as jnp.asarray(values)[i], or use jnp.where"
    ),
    "ConcretizationTypeError": _concrete,
    "NonConcreteBooleanIndexError": (
        "a mask as an index gives an array of unknown size; write jnp.where(mask, values, 0.0), which keeps the size"
    ),
    "UnexpectedTracerError": (
        "a traced value of another call is used, from a global or an attribute; what is remembered belongs in the "
        "memory of a sean_jax.Policy (init and apply)"
    ),
    "FrozenInstanceError": (
        "the fields of a state or a scenario cannot be changed; value.replace(field=...) gives a changed copy"
    ),
    "AttributeError": _attribute,
    "NameError": _unknown,
    "UnboundLocalError": lambda error, line: (
        f"'{getattr(error, 'name', '')}' is used before it has a value; set it first"
    ),
}
