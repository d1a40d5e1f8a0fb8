"""Flags of options: parsing, and the command that repeats a run.

A component is one flag (``--behavior graph``), and each of its options another (``--routing edge``). Without its flag,
an option has its value from ``--config``, or else its default. Nothing here imports JAX or numpy; tyro is imported by
the functions that parse.
"""

import dataclasses
import shlex
import types
import typing
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from sean_jax.config import components
from sean_jax.config.components import Bounds, Config, Described, Family, OwnPart, Value, families, family_of
from sean_jax.config.option_types import Option
from sean_jax.config.scenario_options import usual
from sean_jax.core.errors import InputError
from sean_jax.core.messages import listed

LAST = ("seed", "out", "quiet")  # in the help


def flag(name: str) -> str:
    """The flag of a field: --time-limit of time_limit."""
    return "--" + name.replace("_", "-")


def number(value: object) -> str:
    """A value for the command line: 120 for 120.0, and always read back as the same float."""
    return repr(float(value)).removesuffix(".0") if isinstance(value, float) else str(value)


TRUST = "Run code, FILE.py:NAME, that a file names; otherwise code runs only if it is named on the command line."


def parser(model: type[Config], configurable: bool = False, trust: bool = False) -> type:
    """A dataclass of the flags, for tyro; each is None without its flag.

    Args:
        configurable: adds --config, a file with values of the other options.
        trust: adds --trust, to run code that files name.
    """
    import tyro

    fields: list[tuple[str, Any, Any]] = []
    if configurable:
        text = "A config.yaml, such as sean run writes; flags override its values."
        fields.append(_field("config", Path | None, text, default=None))
    for name, field in sorted(model.model_fields.items(), key=lambda option: option[0] in LAST):
        family = family_of(field)
        text = " ".join((field.description or "").split())
        if family is not None:
            fields.append(_field(name, str | None, text + _default(field.get_default()), default=None))
            if family.singular is not None:
                text = f"One of your own, FILE.py:NAME, besides those of {flag(name)}; can be repeated."
                fields.append(_field(family.singular, tyro.conf.UseAppendAction[list[str]], text, default_factory=list))
            for option, variants in family.options().items():
                kinds = [v.model_fields["kind"].default for v in variants if not v.model_fields["kind"].is_required()]
                about = variants[0].model_fields[option]
                text = f"For {name} {' or '.join(kinds)}: {about.description}" if kinds else str(about.description)
                kind, choices = _plain(about.annotation), _choices(about.annotation)
                fields.append(_field(option, kind | None, text + _default(about.default), choices, default=None))
            continue
        kind = _plain(field.annotation)
        if kind is None:  # no flag can hold it
            continue
        literal = typing.get_origin(field.annotation) is Literal
        if Option.of(field).positional:
            several = "PATH PATH ..." if typing.get_origin(kind) is tuple else None
            fields.append(_field(name, tyro.conf.Positional[field.annotation if literal else kind], text, several))
        elif kind is bool:
            fields.append(_field(name, bool, text, default=False))
        elif field.is_required():
            fields.append(_field(name, kind, text))
        else:
            text += _default(field.default)
            fields.append(_field(name, kind | None, text, _choices(field.annotation), default=None))
    if trust:
        fields.append(_field("trust", bool, TRUST, default=False))
    result = dataclasses.make_dataclass(model.__name__, fields, kw_only=True)
    result.__doc__ = model.__doc__
    return result


def _field(
    name: str, kind: Any, text: str, choices: str | None = None, **default: Any
) -> tuple[str, Any, dataclasses.Field]:
    """A field of the dataclass: ``default`` as of ``dataclasses.field``; without it the flag is required."""
    import tyro

    arg = tyro.conf.arg(help=text, help_behavior_hint="", metavar=choices or _metavar(kind))
    return name, Annotated[kind, arg], dataclasses.field(**default)


def _metavar(kind: object) -> str | None:
    """The placeholder of a flag's value in the help; None leaves it to tyro."""
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        kind = typing.get_args(kind)[0]
    if typing.get_origin(kind) is tuple:
        return " ".join("..." if each is Ellipsis else each.__name__.upper() for each in typing.get_args(kind))
    return {str: "NAME", Path: "PATH", int: "INT", float: "FLOAT"}.get(kind)


def _choices(kind: object) -> str | None:
    """The values of a Literal, which may also be None, for the help."""
    literal = next((each for each in (kind, *typing.get_args(kind)) if typing.get_origin(each) is Literal), None)
    return None if literal is None else "|".join(map(str, typing.get_args(literal)))


def _default(value: object) -> str:
    """The end of a help text."""
    if value is None or value == () or (isinstance(value, bool) and not value):
        return ""
    values = value if isinstance(value, tuple) else (value,)
    words = (each.kind if isinstance(each, components.Component) else number(each) for each in values)
    return f" (default: {' '.join(words)})"


def _plain(kind: Any) -> Any:
    """The type of a flag: an annotation without marks for pydantic; None if no flag can hold it."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin is Annotated:
        return _plain(inner[0])
    if origin in (typing.Union, types.UnionType):
        return next(_plain(each) for each in inner if each is not type(None))
    if origin is tuple:
        parts = tuple(each if each is Ellipsis else _plain(each) for each in inner)
        return None if None in parts else tuple[parts]
    if origin is Literal:
        return str  # pydantic refuses other values, with a suggestion
    return kind if kind in (str, int, float, bool, Path) else None


def read(
    model: type[Described],
    parsed: object,
    base: Mapping[str, object] | None = None,
    source: Path | None = None,
    *,
    typed: bool = False,
) -> Described:
    """The options of parsed flags, an instance of ``parser(model)``.

    Args:
        base: JSON values of options without a flag.
        source: file of ``base``, as of ``validate``.
        typed: whether the user typed the flags; those of a command that a file holds are not.

    Raises:
        InputError: a value is wrong, or an option does not belong to the chosen component; it names the flag.
    """
    words = {
        name: value for name, value in vars(parsed).items() if value is not None and name not in ("config", "trust")
    }
    switches = {name for name, value in words.items() if isinstance(value, bool) and not value}  # off by default
    data = dict(base or {})
    preset = words.get("preset", data.get("preset"))
    for name, family in families(model).items():
        for option in {name, family.singular} & words.keys():
            words[option] = _own(words[option], family) if typed else words[option]
        if family.singular is not None:
            default = usual(preset, name, ",".join(each.kind for each in model.model_fields[name].default))
            if name in words:
                data[name] = words.pop(name)
            if added := words.pop(family.singular, []):
                present = data.get(name, default)  # of a file, which may hold a single one
                several = listed(present) if isinstance(present, str) else present
                data[name] = [*(several if isinstance(several, list) else [several]), *added]
    words = {name: value for name, value in words.items() if name not in switches}
    return components.validate(
        model, components.gather(model, words, data, flag), flag, source, typed=typed and base is None
    )


def positionals(model: type[Config]) -> list[str]:
    """The fields of a command that are words without a flag."""
    return [name for name, field in model.model_fields.items() if Option.of(field).positional]


def _own(value: Any, family: Family) -> Any:
    """Components of flags; parts in the user's own files are marked as named by the user."""
    if not (family.several or family.singular):
        return OwnPart(kind=value) if components.is_own_part(value) else value
    words = listed(value) if isinstance(value, str) else value
    return [OwnPart(kind=word) if components.is_own_part(word) else word for word in words]


def command(word: str, config: Config, chosen: bool = False) -> str:
    """The command that gives the same results, without options that do not affect them.

    Args:
        word: such as ``run``.
        chosen: leave out options with their default value, as this version of the package has it.
    """
    first, words = ["sean", word], []
    for name, field in type(config).model_fields.items():
        value = getattr(config, name)
        mark = Option.of(field)
        if mark.positional:
            first += map(str, value if isinstance(value, tuple) else (value,))
            continue
        if value is None or not mark.affects_results or (chosen and name not in config.model_fields_set):
            continue
        family = family_of(field)
        if family is not None:
            words += _words_of_parts(name, value, family)
        elif _plain(field.annotation) is not None:
            words += _words(name, value)
    return shlex.join([*first, *words])


def _words_of_parts(name: str, value: Any, family: Family) -> list[str]:
    parts = value if isinstance(value, tuple) else (value,)
    if family.singular is not None:
        own = [part for part in parts if isinstance(part, OwnPart)]
        known = [part.kind for part in parts if not isinstance(part, OwnPart | Value)]
        words = _words(name, ",".join(known)) if known else []
        return words + [word for part in own for word in _words(family.singular, part.kind)]
    words = _words(name, ",".join(part.kind for part in parts if not isinstance(part, Value | Bounds)))
    for part in parts:
        for option in type(part).model_fields if not isinstance(part, Value) else ():
            if option != "kind" and getattr(part, option) is not None:
                words += _words(option, getattr(part, option))
    return words


def _words(name: str, value: object) -> list[str]:
    if isinstance(value, bool):
        return [flag(name)] if value else []
    if value == () or value == "":
        return []
    words = [number(each) for each in (value if isinstance(value, tuple) else (value,))]
    if isinstance(value, str | Path) and words[0].startswith("-"):  # else it would be read as an option
        return [f"{flag(name)}={words[0]}"]
    return [flag(name), *words]


def _check_once(model: type[Config], arguments: Sequence[str]) -> None:
    """Refuse a flag of several values that is repeated, of which the parser would drop the first."""
    names = [word.split("=")[0] for word in arguments if word.startswith("--")]
    for name, field in model.model_fields.items():
        family = family_of(field)
        several = family.singular is not None if family else Ellipsis in typing.get_args(_plain(field.annotation))
        if several and names.count(flag(name)) > 1:
            raise InputError(f"{flag(name)} is repeated; give it once, with all of its values.")


def _check_known(known: Sequence[str], arguments: Sequence[str]) -> None:
    """Refuse a flag by its name in another project; the parser refuses other unknown flags."""
    for word in arguments:
        name = word.split("=")[0].removeprefix("--").replace("-", "_")
        if not word.startswith("--") or name in (*known, "help"):
            continue
        if any(name in components.aliases().get(option, ()) for option in known):
            raise InputError(
                f"{word.split('=')[0]}: there is no such option{components.did_you_mean(name, known, flag)}"
            )


def parse(
    word: str, model: type[Config], arguments: Sequence[str], configurable: bool = False, trust: bool = False
) -> Any:
    """An instance of ``parser(model, configurable, trust)`` from the words after the command.

    Raises:
        InputError: a flag of several values is repeated, or a flag has another name here.
        SystemExit: the parser refuses the words.
    """
    import tyro

    result = parser(model, configurable, trust)
    _check_once(model, arguments)
    _check_known([field.name for field in dataclasses.fields(result)], arguments)
    settings = tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff
    return tyro.cli(result, prog=f"sean {word}", description=model.__doc__, args=list(arguments), config=settings)
