"""Parts of your own: ``my.py:thing`` of a description becomes the thing, and the record of a run can find it again.

A file is executed once for its content, so the same file gives the same functions and nothing compiles anew. Importing
this imports no JAX.
"""

import contextlib
import hashlib
import importlib.util
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from sean_jax import files
from sean_jax.config import Component, Config, OwnPart, Value, is_own_part
from sean_jax.errors import InputError

_LOADED: dict[tuple[Path, str], ModuleType] = {}


def resolve(component: Component, family: Mapping[str, Any], option: str) -> Any:
    """The part that a description stands for.

    Args:
        component: the description.
        family: name -> part, those that come with the package.
        option: what asks for it, for messages.

    Returns:
        The part of the family, the thing of a file, or the value itself.

    Raises:
        InputError: there is no such name, file or thing.
    """
    if isinstance(component, Value):
        return component.value
    if isinstance(component, OwnPart):
        return load(component, option)
    if component.kind not in family:
        raise InputError(files.unknown_name(option, component.kind, family))
    return family[component.kind]


def load(part: OwnPart, option: str) -> Any:
    """The thing of a file, or what it gives when it is called with the further options of the part.

    Args:
        part: FILE.py:NAME, with options.
        option: what asks for it, for messages.

    Returns:
        Whatever has that name in the file.

    Raises:
        InputError: there is no such file or name, or the file or the call raised something.
    """
    module = _module(Path(part.file), option)
    names = [name for name in vars(module) if not name.startswith("_")]
    if not hasattr(module, part.name):
        raise InputError(f"{option}: {part.file} has no '{part.name}'{files.suggest(part.name, names) or '.'}")
    thing = getattr(module, part.name)
    if not part.options:
        return thing
    try:
        return thing(**part.options)
    except Exception as error:
        raise InputError(f"{option}: {part.kind} cannot be made: {_reason(error)}") from error


def digest(file: Path) -> str:
    """What tells the content of a file from another: its SHA-256.

    Args:
        file: to be read.

    Returns:
        64 hexadecimal digits.

    Raises:
        FileError: the file cannot be read.
    """
    return hashlib.sha256(files.read_bytes(file)).hexdigest()


def own_files(config: Config) -> dict[str, Path]:
    """The files that a description takes parts from.

    Args:
        config: of any command.

    Returns:
        The file as it is named there -> its absolute path, in the order of the fields.
    """
    return {part.file: Path(part.file).absolute() for _, part in _parts(config)}


def digests(config: Config) -> dict[str, str]:
    """What tells the content of the files that a description takes parts from.

    Args:
        config: of any command.

    Returns:
        The file as it is named there -> its ``digest``.

    Raises:
        InputError: a file cannot be read; the message begins with the field that names it.
    """
    found: dict[str, str] = {}
    for field, part in _parts(config):
        try:
            found[part.file] = digest(Path(part.file))
        except InputError as error:
            raise InputError(f"{field}: {error}") from None
    return found


def _parts(config: Config) -> Iterator[tuple[str, OwnPart]]:
    """Each part of one's own with the field that has it."""
    for name in type(config).model_fields:
        value = getattr(config, name)
        for part in value if isinstance(value, tuple) else (value,):
            if isinstance(part, OwnPart):
                yield name, part


def relocate(data: Any, place: Mapping[str, str]) -> Any:
    """A description's JSON with its own files elsewhere.

    Args:
        data: as ``Config.model_dump`` gives it.
        place: file as it is named there -> its new name.

    Returns:
        The same with the new names.
    """
    if isinstance(data, list | tuple):
        return [relocate(each, place) for each in data]
    if isinstance(data, Mapping):
        return {name: relocate(value, place) for name, value in data.items()}
    if isinstance(data, str) and is_own_part(data):
        file, _, name = data.rpartition(":")
        return f"{place.get(file, file)}:{name}"
    return data


def _module(file: Path, option: str) -> ModuleType:
    """The executed file."""
    try:
        key = file.absolute(), digest(file)
    except InputError as error:
        raise InputError(f"{option}: {error}") from None
    if key not in _LOADED:
        name = f"sean_jax_part_{key[1][:16]}_{file.stem}"
        spec = importlib.util.spec_from_file_location(name, key[0])
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module  # dataclasses and pickle look it up
        try:
            with _importable(key[0].parent):
                spec.loader.exec_module(module)
        except Exception as error:
            del sys.modules[name]
            raise InputError(f"{option}: {file} cannot be imported: {_reason(error)}") from error
        _LOADED[key] = module
    return _LOADED[key]


@contextlib.contextmanager
def _importable(folder: Path) -> Iterator[None]:
    """So that a file finds its neighbours."""
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))


def _reason(error: Exception) -> str:
    """The error in one sentence, with the line of the user's file."""
    line, trace = "", error.__traceback__
    while trace is not None:
        if not trace.tb_frame.f_code.co_filename.startswith(str(Path(__file__).parent)):
            line = f" (line {trace.tb_lineno} of {Path(trace.tb_frame.f_code.co_filename).name})"
        trace = trace.tb_next
    text = " ".join(str(error).split()) or "no reason given"
    return f"{type(error).__name__}: {text[:300].rstrip('.')}{line}."
