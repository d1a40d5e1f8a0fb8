"""Flags of options: parsing, help, and the command that repeats a run.

A component is one flag (``--behavior graph``), and each of its options another (``--routing edge``). Without its flag,
an option has its value from ``--config``, or else its default. For a scenario ``key=value`` is a line of such a file.
``--help`` shows the options of the command itself; those of a class with a ``TOPIC``, which several commands have in
common, are shown by ``--help-TOPIC``. Nothing here imports JAX or numpy; tyro is imported by the functions that parse.
"""

import dataclasses
import inspect
import shlex
import types
import typing
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic.fields import FieldInfo

from sean_jax.config import components
from sean_jax.config.components import Bounds, Component, Config, Described, Family, OwnPart, Value, families, family_of
from sean_jax.config.option_types import HelpTopic, Option
from sean_jax.config.scenario_options import usual
from sean_jax.core.errors import InputError
from sean_jax.core.messages import listed
from sean_jax.io import files

LAST = ("seed", "out", "quiet")  # in the help


def flag(name: str) -> str:
    """The flag of a field: --time-limit of time_limit."""
    return "--" + name.replace("_", "-")


def field_of(word: str) -> str:
    """The field of a flag: time_limit of --time-limit, --time_limit and --time-limit=3."""
    return word.split("=")[0].removeprefix("--").replace("-", "_")


def number(value: object) -> str:
    """A value for the command line: 120 for 120.0, and always read back as the same float."""
    return repr(float(value)).removesuffix(".0") if isinstance(value, float) else str(value)


# ------------------------------------------------------------------ the flags of a command


@dataclasses.dataclass(frozen=True)
class Flag:
    """A flag of a command, or a positional word."""

    name: str  # of the field
    kind: Any  # type of the value; bool for a switch, a flag without a value
    text: str  # in the help
    choices: str | None = None  # in place of the value in the help; by default the name of the type
    topic: str = ""  # of the help that shows it; "" for --help
    positional: bool = False
    required: bool = False
    repeatable: bool = False

    def parser_field(self) -> tuple[str, Any, dataclasses.Field]:
        """The field of tyro's dataclass; without its flag it is None, [] if repeatable, False for a switch."""
        import tyro

        kind: Any = self.kind
        default: dict[str, Any] = {}
        if self.positional:
            kind = tyro.conf.Positional[kind]
        elif self.repeatable:
            kind, default = tyro.conf.UseAppendAction[list[str]], {"default_factory": list}
        elif kind is bool:
            default = {"default": False}
        elif not self.required:
            kind, default = kind | None, {"default": None}
        arg = tyro.conf.arg(help=self.text, help_behavior_hint="", metavar=self.choices or _type_name(self.kind))
        return self.name, Annotated[kind, arg], dataclasses.field(**default)


CONFIG = Flag(
    "config",
    Path,
    "A YAML file of these options, or a run's config.yaml, of which other commands take the scenario; flags override "
    "its values.",
)
TRUST = Flag(
    "trust",
    bool,
    "Run code, FILE.py:NAME, that a file names; otherwise code runs only if it is named on the command line.",
)


def flags_of(model: type[Config], configurable: bool = False, trust: bool = False) -> list[Flag]:
    """The flags of a command, in the order of its help.

    Args:
        configurable: with --config, a file with values of the other options.
        trust: with --trust, to run code that files name.
    """
    flags = [CONFIG] if configurable else []
    for name, field in sorted(model.model_fields.items(), key=lambda option: option[0] in LAST):
        family = family_of(field)
        options = _flags_of_field(name, field) if family is None else _flags_of_family(name, field, family)
        topic = topic_of(model, name)
        flags += [dataclasses.replace(option, topic=topic) for option in options]
    return [*flags, TRUST] if trust else flags


def topic_of(model: type[Config], name: str) -> str:
    """The topic of the class that defines a field; "" for a field of the command itself."""
    owner = next(base for base in model.__mro__ if name in inspect.get_annotations(base))
    return vars(owner)["TOPIC"].word if "TOPIC" in vars(owner) else ""


def topics(model: type[Config]) -> list[HelpTopic]:
    """The topics of the classes that a command embeds."""
    return [vars(base)["TOPIC"] for base in reversed(model.__mro__) if "TOPIC" in vars(base)]


def _flags_of_field(name: str, field: FieldInfo) -> Iterator[Flag]:
    kind, positional = _plain(field.annotation), Option.of(field).positional
    if kind is None:  # no flag can hold it
        return
    required = positional or (field.is_required() and kind is not bool)
    text = joined(field.description) + ("" if required else _default(field.default))
    yield Flag(name, kind, text, _choices(field.annotation), positional=positional, required=required)


def _flags_of_family(name: str, field: FieldInfo, family: Family) -> Iterator[Flag]:
    """The flags of a component, of one more component of the user's own, and of the components' options."""
    yield Flag(name, str, joined(field.description) + _default(field.get_default()))
    if family.singular is not None:
        text = f"One of your own, FILE.py:NAME, besides those of {flag(name)}; can be repeated."
        yield Flag(family.singular, str, text, "FILE.py:NAME", repeatable=True)
    for option, variants in family.options().items():
        about = variants[0].model_fields[option]
        text = option_text(name, option, variants) + _default(about.default)
        yield Flag(option, _plain(about.annotation), text, _choices(about.annotation))


def option_text(name: str, option: str, variants: Sequence[type[Component]]) -> str:
    """The explanation of an option of components, with the components of field ``name`` that have it."""
    kinds = Family(tuple(variants)).kinds
    text = joined(variants[0].model_fields[option].description)
    return f"For {name} {' or '.join(kinds)}: {text}" if kinds else text


def joined(text: str | None) -> str:
    """A text as one line."""
    return " ".join((text or "").split())


def _type_name(kind: Any) -> str | None:
    """The name of a type in the help; None leaves it to tyro."""
    if typing.get_origin(kind) is tuple:
        return " ".join("..." if item is Ellipsis else item.__name__.upper() for item in typing.get_args(kind))
    return {str: "NAME", Path: "PATH", int: "INT", float: "FLOAT"}.get(kind)


def _choices(annotation: object) -> str | None:
    """The values of a Literal, which may also be None, for the help."""
    for kind in (annotation, *typing.get_args(annotation)):
        if typing.get_origin(kind) is Literal:
            return "|".join(map(str, typing.get_args(kind)))
    return None


def _default(value: object) -> str:
    """The end of a help text."""
    if value in (None, (), "") or (isinstance(value, bool) and not value):
        return ""
    words = (item.kind if isinstance(item, Component) else number(item) for item in _items(value))
    return f" (default: {' '.join(words)})"


def _plain(annotation: Any) -> Any:
    """The type of a flag: an annotation without marks for pydantic; None if no flag can hold it."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is Annotated:
        return _plain(arguments[0])
    if origin in (typing.Union, types.UnionType):
        return next(_plain(kind) for kind in arguments if kind is not type(None))
    if origin is tuple:
        items = tuple(item if item is Ellipsis else _plain(item) for item in arguments)
        return None if None in items else tuple[items]
    if origin is Literal:
        return str  # pydantic refuses other values, with a suggestion
    return annotation if annotation in (str, int, float, bool, Path) else None


# ------------------------------------------------------------------ from words to options


def parse(
    word: str, model: type[Config], arguments: Sequence[str], configurable: bool = False, trust: bool = False
) -> dict[str, Any]:
    """The values of the words after a command, by field.

    Args:
        configurable: accept --config, a file with values of the other options, and for a scenario key=value.
        trust: accept --trust, to run code that files name.

    Raises:
        InputError: an option is given twice, a flag has another name here, or a key is unknown.
        SystemExit: the words ask for help, or the parser refuses them.
    """
    known = flags_of(model, configurable, trust)
    _show_help(word, model, known, arguments)
    _check_once(model, arguments)
    _check_known(known, arguments)

    values, unknown = _call_tyro(word, known, arguments)
    keys = [text for text in unknown if "=" in text and not text.startswith("--")]
    keys = keys if configurable and topics(model) else []
    if len(keys) < len(unknown):
        _call_tyro(word, known, [text for text in arguments if text not in keys], strict=True)
    switched_off = {name for name, value in values.items() if isinstance(value, bool) and not value}
    typed = {name: value for name, value in values.items() if value is not None and name not in switched_off}
    assigned = _assigned(word, model, known, keys)
    for name in assigned.keys() & typed.keys():
        raise InputError(f"{name}: {flag(name)} is given as well; leave one of the two out.")
    return typed | assigned


def _show_help(word: str, model: type[Config], known: Sequence[Flag], arguments: Sequence[str]) -> None:
    """Print the options of the command, or of a topic, and exit; do nothing if the words ask for no help."""
    about = [model.__doc__ or ""]
    for topic in topics(model):
        about.append(f"--help-{topic.word} lists the options of {topic.subject}.")
        if f"--help-{topic.word}" in arguments:
            chosen = [option for option in known if option.topic == topic.word]
            _call_tyro(word, chosen, ["--help"], f"Options of {topic.subject}.")
    if {"--help", "-h"} & set(arguments):
        chosen = [option for option in known if not option.topic]
        _call_tyro(word, chosen, ["--help"], "\n".join(about))


def _call_tyro(
    word: str, known: Sequence[Flag], words: Sequence[str], about: str = "", strict: bool = False
) -> tuple[dict[str, Any], list[str]]:
    """The values of the words, by field, and the words that are no flags; ``strict`` refuses these."""
    import tyro

    values, unknown = tyro.cli(
        dataclasses.make_dataclass("Flags", [option.parser_field() for option in known], kw_only=True),
        prog=f"sean {word.split()[0]}",  # the rest is positional
        description=about,
        args=words,
        return_unknown_args=not strict,
        config=(tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff),
    )
    return vars(values), unknown


def _assigned(word: str, model: type[Config], known: Iterable[Flag], words: Iterable[str]) -> dict[str, Any]:
    """Field -> value of words such as time_limit=20, as a file would have it.

    Raises:
        InputError: a key is unknown or given twice, or a value is empty.
    """
    kinds = dict.fromkeys(model.model_fields) | {option.name: option.kind for option in known if not option.repeatable}
    values = {}
    for argument in words:
        key, _, text = argument.partition("=")
        if not key:
            raise InputError(f"{argument} has no key; write key=value, such as people=8.")
        check_text(key, text)
        name = field_of(key)
        if name not in kinds:
            meant = name.rpartition(".")[2]  # routing of behavior.routing
            cure = components.did_you_mean(meant, kinds) or f"; `sean {word} --help` lists the options."
            raise InputError(f"{key}: there is no such option{cure}")
        if name in values:
            raise InputError(f"{key}: the key is given twice; leave one of the two out.")
        is_structure = name in families(model) and text.startswith(("[", "{"))
        values[name] = _file_value(None if is_structure else kinds[name], text)
    return values


def _file_value(kind: Any, text: str) -> Any:
    """The value of a text as a file has it. Numbers of a list have commas between them, texts have spaces."""
    if kind in (str, Path):
        return kind(text)
    if typing.get_origin(kind) is tuple:
        item = typing.get_args(kind)[0]
        return [_file_value(item, word) for word in text.strip("[]").split(None if item is str else ",")]
    try:
        return files.parse_yaml(text)
    except ValueError:
        return text


def check_text(name: str, text: str) -> None:
    """Refuse an empty text, as from a shell variable that is not set: as a path it would be the current folder."""
    if not text.strip():
        raise InputError(f"{name} is an empty text; give a value, or leave the option out for its default.")


def _check_once(model: type[Config], arguments: Sequence[str]) -> None:
    """Refuse a flag of several values that is repeated, of which the parser would drop the first."""
    names = [word.split("=")[0] for word in arguments if word.startswith("--")]
    if names.count(flag(CONFIG.name)) > 1:
        raise InputError(f"{flag(CONFIG.name)} is repeated; give one file, and other values as flags.")
    for name, field in model.model_fields.items():
        family = family_of(field)
        several = family.singular is not None if family else Ellipsis in typing.get_args(_plain(field.annotation))
        if several and names.count(flag(name)) > 1:
            raise InputError(f"{flag(name)} is repeated; give it once, with all of its values.")


def _check_known(known: Sequence[Flag], arguments: Sequence[str]) -> None:
    """Refuse a flag by its name in another project, and a switch with a value; the parser refuses other words."""
    names = [option.name for option in known]
    switches = {option.name for option in known if option.kind is bool}
    aliases = {alias for name in names for alias in components.aliases().get(name, ())}
    for word in arguments:
        if not word.startswith("--"):
            continue
        name = field_of(word)
        if name in aliases.difference(names):
            cure = components.did_you_mean(name, names, flag)
            raise InputError(f"{word.split('=')[0]}: there is no such option{cure}")
        if name in switches and "=" in word:
            raise InputError(f"{word}: a switch has no value; write {flag(name)} alone, or leave it out.")


def read(
    model: type[Described],
    parsed: Mapping[str, Any],
    base: Mapping[str, object] | None = None,
    source: Path | None = None,
    *,
    typed: bool = False,
) -> Described:
    """The options of parsed words, as of ``parse``.

    Args:
        base: JSON values of options without a flag.
        source: file of ``base``, as of ``validate``.
        typed: whether the user typed the flags; those of a command that a file holds are not.

    Raises:
        InputError: a value is wrong, or an option does not belong to the chosen component; it names the flag.
    """
    values = {name: value for name, value in parsed.items() if name not in (CONFIG.name, TRUST.name)}
    data = dict(base or {})
    preset = values.get("preset", data.get("preset"))
    for name, family in families(model).items():
        if typed:
            values |= {option: _own(values[option], family) for option in {name, family.singular} & values.keys()}
        if family.singular is not None:
            default = usual(preset, name, ",".join(part.kind for part in model.model_fields[name].default))
            _gather_several(name, family.singular, values, data, default)
    values = components.gather(model, values, data, flag)
    return components.validate(model, values, flag, source, typed=typed and base is None)


def _gather_several(name: str, singular: str, values: dict[str, Any], data: dict[str, Any], default: str) -> None:
    """Move the components of a field of several, and those of the user's own, from ``values`` to ``data``."""
    if name in values:
        data[name] = values.pop(name)
    if added := values.pop(singular, []):
        present = data.get(name, default)  # of a file, which may hold a single one
        parts = listed(present) if isinstance(present, str) else present
        data[name] = [*(parts if isinstance(parts, list) else [parts]), *added]


def positionals(model: type[Config]) -> list[str]:
    """The fields of a command that are words without a flag."""
    return [name for name, field in model.model_fields.items() if Option.of(field).positional]


def _own(value: Any, family: Family) -> Any:
    """Components of flags; parts in the user's own files are marked as named by the user."""
    if isinstance(value, Mapping):  # with options, of a key
        return value
    if not (family.several or family.singular):
        return OwnPart(kind=value) if components.is_own_part(value) else value
    words = listed(value) if isinstance(value, str) else value
    return [OwnPart(kind=word) if components.is_own_part(word) else word for word in words]


# ------------------------------------------------------------------ from options to words


def command(word: str, config: Config, chosen: bool = False) -> str:
    """The command that gives the same results, without options that do not affect them.

    Args:
        word: such as ``run``.
        chosen: leave out options with their default value, as this version of the package has it.
    """
    first, words = ["sean", word], []
    for name, field in type(config).model_fields.items():
        value, mark = getattr(config, name), Option.of(field)
        if mark.positional:
            first += map(str, _items(value))
        elif value is not None and mark.affects_results and (name in config.model_fields_set or not chosen):
            for option, text in _values(name, field, value):
                words += _words(option, text)
    return shlex.join([*first, *words])


def _items(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) else (value,)


def _values(name: str, field: FieldInfo, value: Any) -> Iterator[tuple[str, Any]]:
    """The flags of a field and their values: those of components, of the user's own, and of the components' options."""
    family = family_of(field)
    if family is None:
        if _plain(field.annotation) is not None:
            yield name, value
        return

    # Python values have no flag, and bounds only stand in files.
    chosen = [component for component in _items(value) if not isinstance(component, Value)]
    apart = OwnPart if family.singular is not None else Bounds
    yield name, ",".join(component.kind for component in chosen if not isinstance(component, apart))
    for component in chosen:
        if family.singular is None:
            yield from (
                (option, getattr(component, option)) for option in type(component).model_fields if option != "kind"
            )
        elif isinstance(component, OwnPart):
            yield family.singular, component.kind


def _words(name: str, value: Any) -> list[str]:
    """The words of a flag and its value; none for a switch that is off, and for no value."""
    if value in (None, (), "") or (isinstance(value, bool) and not value):
        return []
    if isinstance(value, bool):
        return [flag(name)]
    words = [number(item) for item in _items(value)]
    if isinstance(value, str | Path) and words[0].startswith("-"):  # else it would be read as an option
        return [f"{flag(name)}={words[0]}"]
    return [flag(name), *words]
