"""Presets of the social forces (section IV-D) from presets.yaml, which has their sources; YAML files of constants.

``sean calibrate`` writes files of constants. Such a file stands wherever a preset can stand: ``sean run --forces
forces.yaml``, ``make(forces="forces.yaml")``.

    preset: calibrated
    parameters:
      repulsion.strength: 1.8
      reactions.curious: 0.1
    provenance:
      command: sean calibrate --data recordings

No preset has ``Reactions``; a file that names one of its parameters adds the term.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pydantic
import yaml

from sean_jax.core.errors import FileError, InputError
from sean_jax.io import files
from sean_jax.social_forces import terms, walls
from sean_jax.social_forces.forces import Forces, Term, Walking, class_name, collect
from sean_jax.social_forces.reactions import Reactions

TERMS: tuple[type, ...] = (
    Walking,
    terms.Repulsion,
    terms.Headway,
    terms.Evasion,
    terms.Noise,
    terms.Sidestep,
    walls.Contact,
    terms.RobotRepulsion,
    terms.GroupSpace,
    walls.Walls,
    terms.Cohesion,
)
LAWS = (terms.elliptical, terms.circular, terms.surface, terms.in_cone, terms.in_front, terms.all_round)


def _read_presets() -> dict[str, Forces]:
    """The forces of presets.yaml, with arrays of numpy: they are made at import, before the precision is chosen."""
    classes = {class_name(term): term for term in TERMS}
    laws = {law.__name__: law for law in LAWS}
    presets = files.read_yaml(Path(__file__).with_name("presets.yaml"))[1]

    def term(name: str, fields: dict[str, Any]) -> Term:
        numbers = {field: np.asarray(value, float) for field, value in fields.items() if isinstance(value, float)}
        named = {field: laws[value] for field, value in fields.items() if isinstance(value, str)}
        return classes[name](**{**fields, **numbers, **named})

    order = ("calibrated", *presets)  # the default first
    return {name: Forces(tuple(term(*item) for item in presets[name].items())) for name in order}


PRESETS = _read_presets()
"""name -> the forces of a published or fitted model"""


def preset(name: str) -> Forces:
    """The forces of a key of ``PRESETS``, with float arrays on the default device.

    Raises:
        InputError: no preset has that name.
    """
    if name not in PRESETS:
        raise InputError(files.unknown_name("forces", name, PRESETS))
    return collect(PRESETS[name])


class Constants(pydantic.BaseModel):
    """The content of a file of constants."""

    model_config = pydantic.ConfigDict(extra="forbid")

    preset: str
    parameters: dict[str, float] = {}  # term.parameter -> value in its unit
    provenance: dict[str, str] = {}  # where the numbers come from; not read


def is_file(name: str) -> bool:
    """Whether a name of forces names a YAML file of constants."""
    return name.lower().endswith((".yaml", ".yml"))


def read_constants(path: str | Path) -> Constants:
    """The content of a file of constants.

    Raises:
        FileError: the file cannot be read.
    """
    return files.load(Path(path), Constants)


def text(name: str, parameters: Mapping[str, float], provenance: Mapping[str, str]) -> str:
    """The text of a file of constants: a preset, and the parameters that differ from it, with 6 digits."""
    values = {key: float(f"{value:.6g}") for key, value in parameters.items()}
    content = {"preset": name, "parameters": values, "provenance": dict(provenance)}
    return yaml.safe_dump(content, sort_keys=False, width=110)


def with_parameters(name: str, parameters: Mapping[str, float]) -> Forces:
    """The forces of a key of ``PRESETS`` with other values of some parameters, term.parameter -> value in its unit.

    Raises:
        AttributeError: there is no such parameter.
        InputError: no preset has that name, or a value is out of range.
    """
    terms = list(preset(name))
    if any(key.startswith(f"{class_name(Reactions)}.") for key in parameters):
        terms.append(Reactions())
    return collect(collect(terms).tree_replace(dict(parameters)))


def build(forces: str | Iterable[Term]) -> Forces:
    """The forces of a scenario, with float arrays on the default device.

    Args:
        forces: a key of ``PRESETS``, a YAML file of constants, forces, or any sequence of terms with exactly one
            ``Walking`` among them, such as ``[*preset("helbing1995"), mine]``.

    Raises:
        FileError: the file cannot be read, or names a preset or a parameter that does not exist.
        InputError: no preset has that name, or the terms do not make forces (see ``collect``).
    """
    if not isinstance(forces, str):
        return collect(forces)
    if not is_file(forces):
        return preset(forces)
    constants = read_constants(forces)
    try:
        return with_parameters(constants.preset, constants.parameters)
    except (InputError, AttributeError) as error:
        raise FileError(f"{files.short_name(Path(forces))}: {str(error).rstrip('.?')}; mend the file.") from None
