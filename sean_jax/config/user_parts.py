"""The user's own parts: ``my.py:thing`` becomes the thing, and its files are recorded with a run.

The bytes whose SHA-256 is recorded are executed, never ``__pycache__``: a file is read with all neighbours that it
imports (``Content``), and executed once for its content, so equal files give equal functions and nothing compiles
again. This module imports no JAX.
"""

import ast
import builtins
import contextlib
import importlib.abc
import importlib.util
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from sean_jax.config import Component, Config, Named, OwnPart, Value, is_own_part, validate
from sean_jax.config.input_files import InputFiles, rename, sha256, texts
from sean_jax.core.errors import InputError
from sean_jax.io import files

PARTS = "parts"  # folder beside a description with the user's files
PACKAGE = __name__.partition(".")[0]
MAX_CODE = 500_000  # bytes of a file of code, as its tree takes a thousand times as many


class Source(NamedTuple):
    """A module of the user, before it is executed."""

    path: Path
    text: bytes | None  # None of a folder without __init__.py
    is_package: bool


@dataclass(frozen=True, eq=False)
class Content:
    """A file and its neighbours that it imports, at any depth, as they were read."""

    file: Path  # absolute
    sources: Mapping[str, Source]  # name as it is imported -> module; the file's own is the first

    @cached_property
    def digests(self) -> dict[str, str]:
        """Path from the folder of the file -> SHA-256 of each file; the file's own is the first."""
        read = [source for source in self.sources.values() if source.text is not None]
        return {each.path.relative_to(self.file.parent).as_posix(): sha256(each.text or b"") for each in read}

    @cached_property
    def digest(self) -> str:
        """A digest of all files, 64 hexadecimal digits."""
        return sha256(repr(self.digests).encode())

    @cached_property
    def root(self) -> str:
        """Name of the package of its modules, which no other file or content has."""
        return f"sean_jax_part_{sha256(f'{self.file}{self.digest}'.encode())[:16]}"


_LOADED: dict[str, ModuleType] = {}  # root -> the executed file
_READ: dict[Path, Content] = {}  # contents read within ``read_once``
_reading_once = _trust = 0  # blocks of ``read_once`` and of ``trust`` that are open


def resolve(component: Component, family: Mapping[str, Any], option: str) -> Any:
    """The part of a component: from the family, from a file, or the Python value itself.

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


def name_or_part(component: Component, option: str) -> Any:
    """The name of a component, which another function looks up, or the user's own part.

    Raises:
        InputError: the user's file or the thing in it does not exist.
    """
    return component.kind if isinstance(component, Named) else resolve(component, {}, option)


def chosen(
    parts: Iterable[Component],
    sets: Mapping[str, Mapping[str, Any]],
    family: Mapping[str, Any],
    option: str,
    convert: Callable[[Any, str], Any],
) -> dict[str, Any]:
    """Name -> thing, of components that are names of sets, names in a family, or the user's own.

    Args:
        convert: gives the thing of the user's own part and its name.

    Raises:
        InputError: there is no such name, file or thing.
    """
    things: dict[str, Any] = {}
    for part in parts:
        if isinstance(part, Named) and part.kind in sets:
            things |= sets[part.kind]
        elif isinstance(part, Named):
            things[part.kind] = resolve(part, {**sets, **family}, option)
        else:
            things[part.label] = convert(resolve(part, {}, option), part.label)
    return things


def load(part: OwnPart, option: str) -> Any:
    """The thing of a file; with further options of the part, the result of calling it with them.

    Raises:
        InputError: a file names the part and is not trusted, there is no such file or name, or the file or the call
            raises an error.
    """
    _check_trust(part, option)
    module = _module(part.file, option)
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


@contextlib.contextmanager
def trust() -> Iterator[None]:
    """Allow code that only a file names, such as ``FILE.py:NAME`` in the config.json of an agent, to run in the block.

    Otherwise only code runs that the user names, on the command line or in Python.
    """
    global _trust
    _trust += 1
    try:
        yield
    finally:
        _trust -= 1


def is_trusting() -> bool:
    """Whether a block of ``trust`` is open."""
    return _trust > 0


def check_trust(config: Config) -> None:
    """Refuse parts that ``load`` would refuse, before anything is built.

    Raises:
        InputError: a file names one of the parts, and is not trusted.
    """
    for field, part in _parts(config):
        _check_trust(part, field)


def _check_trust(part: OwnPart, option: str) -> None:
    if not part.is_typed and not _trust:
        namer = part.named_in or "a file or message"
        raise InputError(
            f"{option}: {part.kind} is code, and {namer} names it, not you; "
            f"read it, then add --trust (in Python: with sean_jax.trust())."
        )


# ------------------------------------------------------------------ what files hold


@contextlib.contextmanager
def read_once() -> Iterator[None]:
    """Read each of the user's files once within the block, so that a command runs what its record names."""
    global _reading_once
    _reading_once += 1
    try:
        yield
    finally:
        _reading_once -= 1
        if not _reading_once:
            _READ.clear()


def content(file: str | Path) -> Content:
    """A file with its neighbours, as they are now, or as they were when this command first read them.

    Raises:
        FileError: a file cannot be read.
    """
    path = Path(file).absolute()
    if path in _READ:
        return _READ[path]
    own = path.stem if path.stem.isidentifier() else "__file__"
    sources, waiting = {own: Source(path, _bytes(path), False)}, [own]
    while waiting:
        for name in _imported(waiting.pop(), sources):
            parts = name.split(".")
            for count in range(1, len(parts) + 1):
                prefix = ".".join(parts[:count])
                if prefix not in sources:
                    source = _beside(path.parent, parts[:count])
                    if source is None:
                        break
                    sources[prefix] = source
                    waiting.append(prefix)
    code = Content(path, sources)
    if _reading_once:
        _READ[path] = code
    return code


def digest(file: Path, max_bytes: int = files.MAX_BYTES) -> str:
    """SHA-256 of a file of at most ``max_bytes``, as 64 hexadecimal digits.

    Raises:
        FileError: the file cannot be read.
    """
    return sha256(files.read_bytes(file, max_bytes))


def digests(config: Config) -> dict[str, str]:
    """File -> SHA-256, of the files of the options' parts and of their neighbours.

    Raises:
        InputError: a file cannot be read; the message begins with the option that names it.
    """
    return input_files(config).digests


def by_option(config: Config) -> dict[str, list[dict[str, Any]]]:
    """Option -> the user's own parts that it names, each as JSON values; their files are not read."""
    found: dict[str, list[dict[str, Any]]] = {}
    for field, part in _parts(config):
        found.setdefault(field, []).append(part.model_dump(mode="json"))
    return found


def by_content(config: Config) -> dict[str, Any]:
    """As ``Config.identity``, with the user's files by their content: equal for copies of a file.

    Raises:
        FileError: a file cannot be read.
    """
    return rename(config.identity(), {part.file: content(part.file).digest[:16] for _, part in _parts(config)})


def input_files(config: Config) -> InputFiles:
    """The files of the options' parts and of their neighbours; their copies are in parts, parts/2, ...

    Raises:
        InputError: a file cannot be read; the message begins with the option that names it.
    """
    read, copies = dict[str, bytes](), dict[str, str]()
    places: dict[Path, str] = {}  # folder of the user's -> folder of its copies
    for field, part in _parts(config):
        try:
            code = content(part.file)
        except InputError as error:
            raise InputError(f"{field}: {error}") from None
        place = places.setdefault(code.file.parent, f"{PARTS}/{len(places) + 1}" if places else PARTS)
        for name, source in _named(part.file, code).items():
            copies[name] = f"{place}/{source.path.relative_to(code.file.parent).as_posix()}"
            read[copies[name]] = source.text or b""
    return InputFiles(read, copies, {})


def recorded(path: Path, data: Any, hashes: Any, key: str) -> Any:
    """Saved options, with the paths of the user's files from here: first beside the file that holds the options.

    Args:
        path: the file that holds them.
        hashes: file -> SHA-256, as of ``digests`` and ``InputFiles.bundle``; None for no check.

    Raises:
        InputError: a file cannot be read, or has changed.
    """
    hashes = {} if hashes is None else hashes
    if not isinstance(hashes, dict):
        raise InputError(f"{path}: {key}: {hashes!r:.60} is no list of files; give file: digest lines, or none.")
    names = dict.fromkeys(text.rpartition(":")[0] for text in texts(data) if is_own_part(text))
    paths = {name: path.parent / name for name in names}
    paths = {name: file if file.is_file() or not Path(name).is_file() else Path(name) for name, file in paths.items()}

    def check(file: Path, text: bytes, name: str) -> None:
        if hashes.get(name) != sha256(text):
            raise InputError(
                f"{file}: is not the file that {path} was made with; "
                f"restore it, or remove {key} from {path.name} to take all files as they are."
            )

    for name in names if hashes else ():
        check(paths[name], _bytes(paths[name].absolute()), name)  # before it is parsed
        for inner, source in _named(name, content(paths[name])).items():
            check(paths[name].parent / Path(inner).relative_to(Path(name).parent), source.text or b"", inner)
    return rename(data, {name: str(file) for name, file in paths.items()})


def _named(file: str, code: Content) -> dict[str, Source]:
    """The files of a content, by paths relative to ``file``."""
    first, *others = (source for source in code.sources.values() if source.text is not None)
    beside = {(Path(file).parent / each.path.relative_to(code.file.parent)).as_posix(): each for each in others}
    return {file: first, **beside}


def _parts(config: Config) -> Iterator[tuple[str, OwnPart]]:
    """The option and the part, of each of the user's own parts; names are separated by commas. Callbacks are none."""
    for name in type(config).model_fields:
        value = () if name == "callbacks" else getattr(config, name)
        for part in value if isinstance(value, tuple) else files.listed(value) if isinstance(value, str) else (value,):
            if isinstance(part, OwnPart):
                yield name, part
            elif is_own_part(part):
                yield name, validate(OwnPart, {"kind": part})


def _bytes(path: Path) -> bytes:
    """A file, as this command has read it already if it has."""
    sources = [source for each in _READ.values() for source in each.sources.values()]
    texts = [source.text for source in sources if source.path == path and source.text is not None]
    return texts[0] if texts else files.read_bytes(path, MAX_CODE)


def _beside(folder: Path, parts: list[str]) -> Source | None:
    """The module of that name in a folder; None where it comes from elsewhere."""
    place = folder.joinpath(*parts)
    if parts == [PACKAGE]:
        return None
    for file, is_package in ((place / "__init__.py", True), (place.with_name(f"{place.name}.py"), False)):
        if file.is_file():
            return Source(file, _bytes(file), is_package)
    if not place.is_dir() or (len(parts) == 1 and _is_installed(parts[0])):
        return None
    return Source(place, None, True)


def _is_installed(name: str) -> bool:
    """Whether there is a module of this name; a folder without __init__.py does not come before it."""
    try:
        spec = importlib.util.find_spec(name)
    except ValueError:  # such as __main__
        return True
    return spec is not None and spec.origin is not None


def _imported(name: str, sources: Mapping[str, Source]) -> Iterator[str]:
    """The names in the import statements of a module, in all its functions and branches."""
    source = sources[name]
    try:
        nodes = list(ast.walk(ast.parse(source.text or b"")))
    except (SyntaxError, ValueError, RecursionError, MemoryError):  # an error in its execution reports it
        return
    package = name.split(".") if source.is_package else name.split(".")[:-1]
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) + 1 - node.level] if node.level else []
            base = [*above, *([node.module] if node.module else [])]
            yield from (".".join([*base, alias.name]) for alias in node.names)


# ------------------------------------------------------------------ executed


def _module(name: str, option: str) -> ModuleType:
    """The executed file."""
    try:
        code = content(name)
    except InputError as error:
        raise InputError(f"{option}: {error}") from None
    if code.root not in _LOADED:
        if _FINDER not in sys.meta_path:
            sys.meta_path.insert(0, _FINDER)
        _FINDER.contents[code.root] = code
        try:
            _LOADED[code.root] = importlib.import_module(f"{code.root}.{next(iter(code.sources))}")
        except (Exception, SystemExit) as error:
            for each in [each for each in sys.modules if each.split(".")[0] == code.root]:
                del sys.modules[each]
            raise InputError(f"{option}: {name} cannot be imported: {_reason(error)}") from error
    return _LOADED[code.root]


class _Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Import of the modules of contents, which find each other and nothing else beside them."""

    def __init__(self) -> None:
        self.contents: dict[str, Content] = {}  # by root

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> ModuleSpec | None:
        root, _, name = fullname.partition(".")
        code = self.contents.get(root)
        source = code and (code.sources.get(name) if name else Source(code.file.parent, None, True))
        return source and importlib.util.spec_from_loader(fullname, self, is_package=source.is_package)

    def create_module(self, spec: ModuleSpec) -> None:
        return None

    def exec_module(self, module: ModuleType) -> None:
        root, _, name = module.__name__.partition(".")
        code = self.contents[root]
        source = code.sources.get(name)
        if source is None or source.text is None:
            return

        def find(name: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0) -> ModuleType:
            """``__import__`` for the module."""
            top = name.partition(".")[0]
            if level or top not in code.sources:
                return builtins.__import__(name, globals, locals, fromlist, level)
            imported = builtins.__import__(f"{root}.{name}", globals, locals, fromlist, 0)
            return imported if fromlist else sys.modules[f"{root}.{top}"]

        module.__file__ = str(source.path)
        vars(module)["__builtins__"] = vars(builtins) | {"__import__": find}
        exec(compile(source.text, str(source.path), "exec", dont_inherit=True), vars(module))


_FINDER = _Finder()


def _reason(error: BaseException) -> str:
    """The error as a sentence, with the line of the user's file."""
    line, trace = "", error.__traceback__
    while trace is not None:
        file = trace.tb_frame.f_code.co_filename
        if not file.startswith((str(Path(__file__).parents[1]), "<frozen ")):
            line = f" (line {trace.tb_lineno} of {Path(file).name})"
        trace = trace.tb_next
    text = re.sub(r"sean_jax_part_\w+\.", "", " ".join(str(error).split())) or "no reason given"
    return f"{type(error).__name__}: {text[:300].rstrip('.')}{line}."
