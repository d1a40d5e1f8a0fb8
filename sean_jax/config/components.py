"""Options as pydantic models: components, checks, and errors in one sentence.

An option is one field of a class in ``sean_jax.config``. Flags and help, ``config.yaml``, manifests, the JSON Schema
and the keywords of ``make`` derive from it. A component (behavior, task, robot, policy, ...) has a ``kind`` and options
of that kind: ``{kind: graph, routing: edge}``, or ``GraphBehavior(routing="edge")``. Where a kind can stand,
``my.py:thing`` can stand (``user_parts`` loads it), or in Python the part itself.

Nothing in this package imports JAX or numpy, so that the command line answers at once.
"""

import re
import typing
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache, reduce
from operator import or_
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import pydantic
from pydantic import Discriminator, Field, GetCoreSchemaHandler, GetJsonSchemaHandler, Tag
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, ErrorDetails, core_schema

from sean_jax.config.option_types import Option, Range, Text, check_once
from sean_jax.core.errors import InputError
from sean_jax.core.messages import error_clause, listed, shorten, suggest
from sean_jax.io import files

OWN_PART = re.compile(r"(?P<file>.+\.py):(?P<name>[A-Za-z_]\w*)")


@cache
def aliases() -> dict[str, list[str]]:
    """Option -> names of it in other projects, for which it is proposed."""
    return files.read_yaml(Path(__file__).with_name("aliases.yaml"))[1]


def did_you_mean(word: str, known: Iterable[str], named: Callable[[str], str] = str) -> str:
    """The end of a message about an unknown option: the option that was probably meant."""
    known = list(known)
    alike = [name for name in known if word.lower() in aliases().get(name, ())]
    return f"; did you mean '{named(alike[0])}'?" if alike else suggest(named(word), map(named, known))


@dataclass(frozen=True)
class Origin:
    """Who wrote a description: the user himself, on the command line or in Python, or a file or message."""

    typed: bool = False
    source: Path | None = None


TYPED = Origin(typed=True)


class Config(pydantic.BaseModel):
    """Options: immutable, and without unknown keys. Values given in Python count as typed by the user."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)

    if not TYPE_CHECKING:  # a type checker takes the fields from the class

        def __init__(self, **values: Any) -> None:
            try:
                self.__pydantic_validator__.validate_python(values, self_instance=self, context=TYPED)
            except pydantic.ValidationError as error:
                raise InputError(sentence(type(self), error.errors(include_url=False)[0])) from None

        __init__.__pydantic_base_init__ = True  # validation by pydantic does not call it

    def replace(self, **changes: object) -> Self:
        """The same options with other values, checked again."""
        return type(self)(**{**_set_fields(self), **changes})

    def identity(self) -> dict[str, Any]:
        """The fields that affect results, as JSON values: to be recorded, and compared when work is resumed."""
        fields = type(self).model_fields.items()
        names = {name for name, field in fields if Option.of(field).affects_results}
        return {name: compact(value) for name, value in self.model_dump(mode="json", include=names).items()}


Described = typing.TypeVar("Described", bound=Config)


def compact(value: object) -> object:
    """A component without options as its name."""
    if isinstance(value, list):
        return [compact(each) for each in value]
    return value["kind"] if isinstance(value, dict) and value.keys() == {"kind"} else value


# ------------------------------------------------------------------ components


class Component(Config):
    """A part of a scenario or a run: its kind and its own options."""

    kind: Text

    @property
    def label(self) -> str:
        """Its name in results."""
        return getattr(self, "name", self.kind)


class Named(Component):
    """A part without options: a name of ``sean list``; for a policy also the folder of a training."""


class OwnPart(Component):
    """Your own part, ``FILE.py:NAME``. With other keys, NAME is called with them and returns the part."""

    model_config = pydantic.ConfigDict(extra="allow")

    kind: Annotated[str, Field(pattern=f"^{OWN_PART.pattern}$".replace("?P<file>", "").replace("?P<name>", ""))]
    _origin: Origin = pydantic.PrivateAttr(default=Origin())

    def model_post_init(self, context: Any, /) -> None:
        """Remember who names it: the ``context`` of ``validate``."""
        if isinstance(context, Origin):
            self._origin = context

    @property
    def is_typed(self) -> bool:
        """Whether the user names it, on the command line or in Python; only then it may run without being asked."""
        return self._origin.typed

    @property
    def named_in(self) -> Path | None:
        """The file that names it; None if the user or a message does."""
        return self._origin.source

    @property
    def file(self) -> str:
        """The path of its file, as the user wrote it."""
        return self.kind.rpartition(":")[0]

    @property
    def name(self) -> str:
        """The name in the file."""
        return self.kind.rpartition(":")[2]

    @property
    def options(self) -> dict[str, Any]:
        """The further keys."""
        return dict(self.model_extra or {})


class Value(Component):
    """A Python value, which no file can hold."""

    kind: Literal["value"] = "value"
    name: str = ""
    value: Any = Field(default=None, exclude=True, repr=False)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return {"not": {}}


class Bounds(Component):
    """Numbers that differ between episodes: name -> least and greatest value."""

    model_config = pydantic.ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Range]  # pyright: ignore

    kind: Literal["bounds"] = "bounds"

    @property
    def bounds(self) -> dict[str, Range]:
        """The further keys."""
        return dict(self.model_extra or {})


@dataclass(frozen=True)
class Family:
    """The components that a field can hold; the command line also has their options."""

    variants: tuple[type[Component], ...]
    singular: str | None = None  # the option that adds one component to a field of several
    several: bool = False  # a field of several without such an option, such as tasks

    def __get_pydantic_core_schema__(self, source: type, handler: GetCoreSchemaHandler) -> CoreSchema:
        tagged = [Annotated[each, Tag(each.__name__)] for each in (*self.variants, OwnPart, Value)]
        union: Any = Annotated[reduce(or_, tagged), Discriminator(self._tag)]  # type: ignore[arg-type]
        one = core_schema.no_info_before_validator_function(self._read, handler.generate_schema(union))
        if not (self.several or self.singular):
            return one
        many = core_schema.tuple_variable_schema(one, min_length=1 if self.several else 0)
        once = core_schema.no_info_after_validator_function(_check_components, many)
        return core_schema.no_info_before_validator_function(self._read_several, once)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return {"anyOf": [{"type": "string"}, handler(schema)]}

    def _read(self, value: object) -> object:
        """A mapping with a kind, or a component."""
        if isinstance(value, Component):
            return value
        if isinstance(value, str | Path):
            value = {"kind": str(value)}
        if not isinstance(value, Mapping):
            self._refuse_plain(value)
            name = getattr(value, "__name__", None) or getattr(value, "name", None) or type(value).__name__
            return Value(value=value, name=str(name))
        kind = value.get("kind")
        if kind == "value":
            raise ValueError("was a Python value, which no file holds; write it into a Python file: my.py:thing")
        if not isinstance(kind, str):
            mapping = shorten(repr(dict(value)))
            if not self.kinds:
                raise ValueError(f"{mapping} has no kind; give one of `sean list`")
            raise ValueError(f"{mapping} has no kind; there are {', '.join(self.kinds)}")
        if not is_own_part(kind) and self.variant(kind) is None:
            raise ValueError(f"'{kind}' is not one of {', '.join(self.kinds)}{suggest(kind, self.kinds)}")
        return dict(value)

    def _refuse_plain(self, value: object) -> None:
        """Refuse what a file may hold, but is no component; a list may be one, as the terms of a preset."""
        if value is None:
            raise ValueError("an empty value names nothing; leave the option out for its default")
        if isinstance(value, bool | int | float) or (isinstance(value, list) and self.singular is None):
            raise ValueError(f"{shorten(repr(value))} is no name; give one of `sean list`, or a mapping with a kind")

    def _read_several(self, value: object) -> object:
        """Several components: from names with commas between them, a list, or a mapping from names to values."""
        if value is None:
            return []
        if isinstance(value, str):
            return listed(value)
        if isinstance(value, Mapping) and "kind" not in value:
            named = value.items()
            return [each if isinstance(each, str) else Value(value=each, name=str(name)) for name, each in named]
        if isinstance(value, Iterable) and not isinstance(value, Component | Mapping):
            return list(value)
        return [value]

    def _tag(self, value: Component | Mapping[str, str]) -> str:
        if isinstance(value, Component):
            return type(value).__name__
        kind = value["kind"]
        variant = OwnPart if is_own_part(kind) else self.variant(kind)
        return variant.__name__ if variant is not None else ""

    @property
    def kinds(self) -> list[str]:
        """The kinds with their own class."""
        return [variant.model_fields["kind"].default for variant in self.variants if _is_one_kind(variant)]

    def variant(self, kind: str) -> type[Component] | None:
        """The class of a kind; None if the family has no such kind."""
        for variant in self.variants:
            if not _is_one_kind(variant) or variant.model_fields["kind"].default == kind:
                return variant
        return None

    def options(self) -> dict[str, list[type[Component]]]:
        """Option -> the classes that have it."""
        owners: dict[str, list[type[Component]]] = {}
        for variant in self.variants:
            for name in variant.model_fields:
                if name != "kind":
                    owners.setdefault(name, []).append(variant)
        return owners


def _check_components(parts: tuple[Component, ...]) -> tuple[Component, ...]:
    check_once([part for part in parts if not isinstance(part, Value)])
    return parts


def _is_one_kind(variant: type[Component]) -> bool:
    return not variant.model_fields["kind"].is_required()


def is_own_part(kind: object) -> bool:
    """Whether a kind names a part in a file, ``FILE.py:NAME``."""
    return isinstance(kind, str) and OWN_PART.fullmatch(kind) is not None


def family_of(field: FieldInfo) -> Family | None:
    """The family of components that a field holds; None if it holds none."""
    inside = [mark for kind in typing.get_args(field.annotation) for mark in getattr(kind, "__metadata__", ())]
    return next((mark for mark in (*field.metadata, *inside) if isinstance(mark, Family)), None)


def families(model: type[Config]) -> dict[str, Family]:
    """Field -> the family of components that it holds, without other fields."""
    each = {name: family_of(field) for name, field in model.model_fields.items()}
    return {name: family for name, family in each.items() if family is not None}


# ------------------------------------------------------------------ from values to options


def gather(
    model: type[Config],
    values: Mapping[str, object],
    base: Mapping[str, object] | None = None,
    named: Callable[[str], str] = str,
) -> dict[str, Any]:
    """Fields of ``model``, with options of components moved into their component.

    So ``behavior="graph", routing="edge"`` becomes ``behavior={"kind": "graph", "routing": "edge"}``.

    Args:
        base: values of fields that ``values`` lacks.
        named: field or option -> its name in messages.

    Raises:
        InputError: an option does not belong to the chosen component.
    """
    data, values = dict(base or {}), dict(values)
    for name, family in families(model).items():
        beside = [option for option in family.options() if option in values and option not in model.model_fields]
        options = {option: values.pop(option) for option in beside}
        if name in values:
            data[name] = values.pop(name)
        if options:
            default = model.model_fields[name].get_default()
            data[name] = _with_options(name, data.get(name), default, options, family, named)
    return data | values


def _set_fields(description: Config) -> dict[str, Any]:
    return {name: getattr(description, name) for name in description.model_fields_set}


def with_defaults(model: type[Config], data: Mapping[str, Any], defaults: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of ``model`` with other defaults; defaults of a component apply if it is chosen."""
    full = dict(data)
    behavior = _as_mapping(full.get("behavior")) or {}
    for option, value in defaults.items():
        if option == "warm_up" and behavior.get("kind") == "playback":
            continue  # a recording begins with its own people
        if option in model.model_fields:
            full.setdefault(option, value)
            continue
        for name, family in families(model).items():
            part = _as_mapping(full.get(name, model.model_fields[name].get_default())) or {}
            kind = part.get("kind")
            variant = family.variant(kind) if isinstance(kind, str) and not is_own_part(kind) else None
            if variant is not None and option in variant.model_fields:
                full[name] = {option: value, **part}
    return full


def _as_mapping(part: Any) -> dict[str, Any] | None:
    """The kind and options of a component; None for anything else and for a Python value."""
    if isinstance(part, Component) and not isinstance(part, Value):
        return {**_set_fields(part), "kind": part.kind}
    if isinstance(part, str):
        return {"kind": part}
    return dict(part) if isinstance(part, Mapping) else None


def _with_options(
    name: str, chosen: Any, default: object, options: dict[str, object], family: Family, named: Callable[[str], str]
) -> Any:
    """A component with its separate options."""
    if isinstance(chosen, OwnPart):
        return chosen.model_copy(update=options)

    # The component that is meant: the only one, the default, or the one that has all of the options.
    owners = family.options()
    if family.several:
        chosen = chosen[0] if isinstance(chosen, list | tuple) and len(chosen) == 1 else chosen
        if chosen is None and len(options) == len(owners):
            chosen = family.kinds[0]
    elif chosen is None:
        chosen = default
    chosen = _as_mapping(chosen) or chosen

    kind = chosen.get("kind") if isinstance(chosen, Mapping) else None
    variant = family.variant(kind) if isinstance(kind, str) else None
    if is_own_part(kind) or (kind and variant is None):  # which takes any, or is refused later
        return {**chosen, **options}
    for option in options:
        if variant is None or variant not in owners[option]:
            kinds = " or ".join(f"'{owner.model_fields['kind'].default}'" for owner in owners[option])
            if kind:
                raise InputError(f"{named(option)}: {name} '{kind}' has no such option; choose {name} {kinds}.")
            if chosen is None:
                raise InputError(f"{named(option)}: the default {name} has no such option; choose {name} {kinds}.")
            raise InputError(f"{named(option)}: a {name} of your own has no such option; choose {name} {kinds}.")
    return {**chosen, **options}


def validate(
    model: type[Described],
    data: Mapping[str, object],
    named: Callable[[str], str] = str,
    source: Path | None = None,
    *,
    typed: bool = False,
) -> Described:
    """Options, checked. Their own parts run if the user trusts them (``user_parts.trust``) or has typed them.

    Args:
        source: the file with the values.
        typed: whether the user typed the values, on the command line or as arguments in Python. Only what reads these
            says so (``tests/config/test_user_parts_trust.py`` has the list).

    Raises:
        InputError: one sentence for the first mistake: field, value, cure.
    """
    try:
        return model.model_validate(dict(data), context=Origin(typed, source))
    except pydantic.ValidationError as error:
        raise InputError(sentence(model, error.errors(include_url=False)[0], named)) from None


def sentence(model: type[Config], error: ErrorDetails, named: Callable[[str], str] = str) -> str:
    """One of the errors of a ``pydantic.ValidationError`` as a sentence."""
    classes = {each.__name__: each for each in _component_classes(model)}
    path = [part for part in error["loc"] if part not in classes]
    owner = next((classes[part] for part in reversed(error["loc"]) if part in classes), model)
    option, key = _subject(path, owner, error["type"], named)

    # The clause, with what was probably meant.
    last = str(error["loc"][-1]) if error["loc"] else ""
    known = list(owner.model_fields)
    beside = [name for family in families(owner).values() for name in family.options()]
    hint = _place(owner, last) or did_you_mean(last, [*known, *beside])
    text = error_clause(error, _choices(owner, last), known, hint)
    if error["type"] == "value_error" and not path:  # of a whole class; the clause begins with the option
        option, _, text = text.partition(": ")
        option = named(option)
    elif error["type"] == "too_short":
        text = "names nothing; `sean list` shows what there is"

    start = ".".join(filter(None, (option, key)))
    end = "" if text.endswith(("?", ".")) else "."
    return f"{start}: {text}{end}" if start else f"{text}{end}"


def _place(owner: type[Config], option: str) -> str:
    """The end of a message about an option of a component outside of it; "" for any other option."""
    for name, family in families(owner).items():
        if option in family.options():
            kind = family.options()[option][0].model_fields["kind"].default
            return f"; write it into {name}, as {name}: {{kind: {kind}, {option}: ...}}"
    return ""


def _subject(path: list[Any], owner: type[Config], kind: str, named: Callable[[str], str]) -> tuple[str, str]:
    """The option and the key in it that an error is about, as messages name them."""
    option = named(str(path[0])) if path else ""
    key = ".".join(str(part) for part in path[1:] if isinstance(part, str))
    if key and key in owner.model_fields and named is not str:
        option, key = named(key), ""  # an option of a component is a separate flag
    if kind == "extra_forbidden":
        return ("", "") if len(path) == 1 else (option, ".".join(map(str, path[1:-1])))
    return ("", key) if kind == "invalid_key" and len(path) == 1 else (option, key)


def _component_classes(model: type[Config]) -> list[type[Component]]:
    return [OwnPart, Value, *(variant for family in families(model).values() for variant in family.variants)]


def _choices(owner: type[Config], name: str) -> tuple[object, ...]:
    field = owner.model_fields.get(name)
    kinds = [field.annotation, *typing.get_args(field.annotation)] if field is not None else []
    return next((typing.get_args(kind) for kind in kinds if typing.get_origin(kind) is Literal), ())
