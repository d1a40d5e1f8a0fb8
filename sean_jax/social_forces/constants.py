"""Constants of the social forces in a file: a preset, what differs from it, and where the numbers come from.

    preset: calibrated
    parameters:
      repulsion.strength: 1.8
    provenance:
      command: sean calibrate --data recordings

``sean calibrate`` writes such files, and wherever a preset can stand such a file can stand: ``sean run --forces
forces.yaml``, ``make(forces="forces.yaml")``.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path

import pydantic
import yaml

from sean_jax import files
from sean_jax.errors import FileError, InputError
from sean_jax.social_forces.presets import preset
from sean_jax.social_forces.terms import Forces, Term, collect

ENDINGS = (".yaml", ".yml")


class Constants(pydantic.BaseModel):
    """The content of a file."""

    model_config = pydantic.ConfigDict(extra="forbid")

    preset: str
    parameters: dict[str, float] = {}  # term.parameter -> value in its unit
    provenance: dict[str, str] = {}  # what the numbers come from; not read


def is_file(name: str) -> bool:
    """Whether a name of forces stands for a file of constants.

    Returns:
        True or False.
    """
    return name.lower().endswith(ENDINGS)


def read(path: str | Path) -> Forces:
    """The forces of a file.

    Returns:
        Forces whose parameters are float arrays on the default device.

    Raises:
        FileError: the file cannot be read, or names a preset or a parameter that does not exist.
    """
    name, parameters = content(path)
    try:
        return collect(preset(name).tree_replace(dict(parameters)))
    except (InputError, AttributeError) as error:
        raise FileError(f"{files.short_name(Path(path))}: {str(error).rstrip('.?')}; mend the file.") from None


def content(path: str | Path) -> tuple[str, dict[str, float]]:
    """What a file says.

    Returns:
        The name of the preset, and the parameters that differ from it.

    Raises:
        FileError: the file cannot be read.
    """
    found = files.load(Path(path), Constants)
    return found.preset, found.parameters


def text(name: str, parameters: Mapping[str, float], provenance: Mapping[str, str]) -> str:
    """The content of a file."""
    values = {key: float(f"{value:.6g}") for key, value in parameters.items()}
    found = {"preset": name, "parameters": values, "provenance": dict(provenance)}
    return yaml.safe_dump(found, sort_keys=False, width=110)


def build(forces: str | Iterable[Term]) -> Forces:
    """The forces of a scenario.

    Args:
        forces: a key of ``PRESETS``, a YAML file of constants, forces, or any sequence of terms with exactly one
            ``Walking`` among them, such as ``[*preset("helbing1995"), mine]``.

    Returns:
        Forces whose parameters are float arrays on the default device.

    Raises:
        InputError: no preset or file has that name, or the terms do not make forces (see ``collect``).
    """
    if isinstance(forces, str):
        return read(forces) if is_file(forces) else preset(forces)
    return collect(forces)
