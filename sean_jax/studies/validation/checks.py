"""The checks of ``sean validate``: their table, checks.yaml, the context of a check, its result and its saved row.

A check's function, which the table names, simulates scenes of its ``CheckContext`` with the validated model and returns
a ``CheckResult``. Nothing is tuned for a check: the context knows models only.
"""

import dataclasses
import functools
import hashlib
import importlib
import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sean_jax.config import OwnPart, ValidateConfig, is_own_part, validate
from sean_jax.config.flags import command
from sean_jax.core.errors import InputError
from sean_jax.io import files, writing
from sean_jax.io.files import listed, unknown_name
from sean_jax.io.versions import fingerprint, versions
from sean_jax.people.recordings import Tracks
from sean_jax.studies.scenes import Model, Scene, model, simulate

PASSES, FAILS, SKIPPED = "passes", "fails", "skipped"
RESULTS, PARTS = "results.json", "parts"


@dataclass(frozen=True)
class Curve:
    """A line of a plot."""

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    reference: bool = False  # measured by others, not by the model
    points: bool = False  # drawn as points, not joined


def curve(name: str, x: Iterable[float], y: Iterable[float], points: bool = False) -> Curve:
    """A curve of the model."""
    return Curve(name, tuple(x), tuple(y), points=points)


def reference(name: str, x: Iterable[float], y: Iterable[float], points: bool = False) -> Curve:
    """A curve that others measured, or a limit."""
    return Curve(name, tuple(x), tuple(y), reference=True, points=points)


def level(name: str, x: Sequence[float], y: float) -> Curve:
    """A reference that is the same from the first to the last x."""
    return Curve(name, (x[0], x[-1]), (y, y), reference=True)


@dataclass(frozen=True)
class CheckResult:
    """The result of a check for a model."""

    passed: bool
    measured: str  # the measured values, in words and numbers with units
    reason: str = ""  # of a failure or a skip
    numbers: dict[str, float] = field(default_factory=dict)  # the measured values by name, SI units
    curves: tuple[Curve, ...] = ()
    axes: tuple[str, str] = ("", "")  # of the curves: quantity and unit along x and y


class Skipped(Exception):
    """Raised by a check that cannot be made here; the text is the reason and the cure."""


@dataclass
class CheckContext:
    """The inputs of a check: the model, the recordings, if any, and a simulator of scenes."""

    model: Model
    data: Path | None = None  # folder of recordings
    quick: bool = False  # fewer seeds and people in some checks
    report: Callable[[float], None] | None = None  # called with the share of a simulation that is done
    pictures: list[tuple[str, Scene, Tracks]] = field(default_factory=list)  # for the report, with captions

    def simulate(self, scenes: Scene | Sequence[Scene], show: str | Sequence[str] = "") -> list[Tracks]:
        """Simulate scenes with the model; scenes of one size run in parallel.

        Args:
            show: captions of the first scenes; scenes without one are not shown.

        Returns:
            For each scene T moments 0.1 s apart of its N people, as numpy arrays.
        """
        several = [scenes] if isinstance(scenes, Scene) else list(scenes)
        tracks = simulate(several, self.model, self.report)
        captions = [show] if isinstance(show, str) else show
        self.pictures += [part for part in zip(captions, several, tracks, strict=False) if part[0]]
        return tracks

    def recordings(self) -> Path:
        """The folder of recordings.

        Raises:
            Skipped: the command names none.
        """
        if self.data is None:
            raise Skipped("no recordings; give their folder with --data.")
        return self.data

    def eth_ucy(self) -> list[Path]:
        """The recordings of ETH and UCY.

        Raises:
            Skipped: there are none.
        """
        paths = sorted((self.recordings() / "eth_ucy").glob("*.csv"))
        if not paths:
            raise Skipped("no recordings in eth_ucy; give a folder with eth_ucy/eth.csv and others with --data.")
        return paths

    def progress(self, items: Sequence) -> Iterable:
        """The items one by one, each reported when it is done."""
        for done, item in enumerate(items):
            yield item
            if self.report is not None:
                self.report((done + 1) / len(items))


def result(passed: bool, measured: str, criterion: str, **fields) -> CheckResult:
    """A result whose reason, if it has not passed, is the missed criterion.

    Args:
        **fields: further ones of ``CheckResult``.
    """
    return CheckResult(bool(passed), measured, "" if passed else f"measured {measured}; wanted {criterion}", **fields)


def listing(values: Iterable[float], at: Iterable[float] = (), form: str = ".2f", unit: str = "") -> str:
    """Values, with where they were measured if that is in ``at``, such as "0.98 at 1 m, 0.71 at 2 m"."""
    if not (places := list(at)):
        return ", ".join(f"{value:{form}}" for value in values)
    return ", ".join(f"{value:{form}} at {place:g}{unit}" for value, place in zip(values, places, strict=True))


def numbered(names: Iterable[str]) -> tuple[tuple[float, ...], str]:
    """Numbers of names from 1 on, for the axis of a plot, and what they mean, such as "1 eth, 2 hotel"."""
    words = [f"{k + 1} {name}" for k, name in enumerate(names)]
    return tuple(np.arange(1.0, len(words) + 1.0).tolist()), ", ".join(words)


def by_name(name: str, at: Iterable[float], values: Iterable[float]) -> dict[str, float]:
    """The numbers of a result that were measured at several places: name and place -> value."""
    return {f"{name}{place:g}": float(value) for place, value in zip(at, values, strict=True)}


# ------------------------------------------------------------------ the table


@dataclass(frozen=True)
class Check:
    """One row of ``sean validate``."""

    name: str  # such as rimea-1
    title: str
    setup: str  # geometry and people
    measure: str
    criterion: str  # when it passes
    source: str
    function: str  # such as guidelines.walk_time
    arguments: dict[str, Any] = field(default_factory=dict)  # of the function, besides the context
    quick: bool = True  # whether ``--quick`` has it
    fitted: bool = False  # whether the loss of ``sean calibrate`` has the same measurement

    @property
    def data(self) -> str:
        """How its measurement was used: ``fitted``, or ``held out`` of every fit."""
        return "fitted" if self.fitted else "held out"

    def run(self, context: CheckContext) -> CheckResult:
        """Simulate and measure.

        Raises:
            Skipped: this cannot be done here.
        """
        module, name = self.function.split(".")
        return getattr(importlib.import_module(f"{__package__}.{module}"), name)(context, **self.arguments)


@dataclass(frozen=True)
class CheckGate:
    """A promise about the default crowd, fulfilled if all of its checks pass."""

    title: str
    promise: str
    checks: tuple[str, ...]  # names, or the beginnings of names followed by *


PUBLISHED: Any = files.read_yaml(Path(__file__).with_name("published.yaml"))[1]
"""Measurements of people: table -> its values; the file has units and sources"""
_TABLE: Any = files.read_yaml(Path(__file__).with_suffix(".yaml"))[1]
CHECKS: dict[str, Check] = {name: Check(name, **row) for name, row in _TABLE["checks"].items()}
"""name -> check, in the order of the table"""
GATES = tuple(CheckGate(title, row["promise"], tuple(row["checks"])) for title, row in _TABLE["gates"].items())


def select(names: str | None, quick: bool = False) -> list[Check]:
    """The checks of a command.

    Args:
        names: separated by commas; ``rimea-*`` names all that begin so; all checks if None.
        quick: leave out checks that are not quick, unless they are named in full.

    Raises:
        InputError: there is no check of a name.
    """
    if names is None:
        return [check for check in CHECKS.values() if check.quick or not quick]
    selected: set[str] = set()
    for name in listed(names) or ["nothing"]:
        matching = matches(name)
        if not matching:
            raise InputError(unknown_name("--only", name, CHECKS))
        selected |= {check for check in matching if check == name or CHECKS[check].quick or not quick}
    return [check for name, check in CHECKS.items() if name in selected]


def matches(pattern: str) -> list[str]:
    """Names of the checks of a pattern such as rimea-1 or rimea-*; none if there is no such check."""
    if pattern.endswith("*"):
        return [name for name in CHECKS if name.startswith(pattern[:-1])]
    return [pattern] if pattern in CHECKS else []


def models_of(names: str | None, source: Path | None = None, *, typed: bool = False) -> list[Model]:
    """The models of a list of names.

    Args:
        names: separated by commas: presets, files of constants, pedestrian models, FILE.py:NAME; the default forces if
            None.
        source: the file that holds the names.
        typed: whether the user typed them.

    Raises:
        InputError: there is none of a name, or a file gives no model.
    """
    models = []
    for name in listed(names):
        if is_own_part(name):
            from sean_jax.config.user_parts import load

            part = validate(OwnPart, {"kind": name}, source=source, typed=typed)
            models.append(model(load(part, "models"), part.name))
        else:
            models.append(model(name))
    return models or [model()]


# ------------------------------------------------------------------ rows on disk


@dataclass(frozen=True)
class CheckRow:
    """The saved result of a check of a model."""

    check: str
    model: str
    verdict: str  # passes, fails or skipped
    measured: str
    reason: str
    numbers: dict[str, float]
    curves: tuple[Curve, ...]
    axes: tuple[str, str]
    pictures: tuple[tuple[str, str], ...]  # captions and SVG
    seconds: float  # s that it took


def load(folder: Path, check: Check, model: Model, options: ValidateConfig) -> CheckRow | None:
    """The row of an earlier run with the same code, versions and model; None without one, or if it was skipped."""
    try:
        content = files.read_json(_part(folder, check, model))
        if content.pop("made_with") != _provenance(model, options) or content["verdict"] == SKIPPED:
            return None
        content["curves"] = tuple(Curve(**curve) for curve in content["curves"])
        for name in ("axes", "pictures"):
            content[name] = tuple(tuple(part) if isinstance(part, list) else part for part in content[name])
        return CheckRow(**content)
    except (ValueError, KeyError, TypeError, AttributeError):
        return None


def save(folder: Path, check: Check, model: Model, options: ValidateConfig, row: CheckRow) -> None:
    """Keep a row."""
    (folder / PARTS).mkdir(exist_ok=True)
    content = {"made_with": _provenance(model, options), **_finite(dataclasses.asdict(row))}
    writing.write(_part(folder, check, model), content)


def write(folder: Path, options: ValidateConfig, rows: Sequence[CheckRow]) -> None:
    """Write results.json: the command, the versions, and for each row its data and all but curves and pictures."""
    left_out = ("curves", "axes", "pictures")
    table = [{name: part for name, part in dataclasses.asdict(row).items() if name not in left_out} for row in rows]
    table = [row | {"data": CHECKS[row["check"]].data} for row in table]
    content = {"command": command("validate", options), "versions": versions(), "rows": _finite(table)}
    writing.write(folder / RESULTS, content)


def _part(folder: Path, check: Check, model: Model) -> Path:
    name = re.sub(r"[^\w.-]", "-", model.name)  # a path, where a file of constants or of one's own moves people
    return folder / PARTS / f"{check.name}--{name}.json"


def _provenance(model: Model, options: ValidateConfig) -> dict[str, Any]:
    """All that affects a row."""
    move = f"{getattr(model.move, '__module__', '')}.{getattr(model.move, '__qualname__', '')}"
    terms = [f"{type(term).__module__}.{type(term).__name__}" for term in model.forces]  # own ones have their digest
    return {
        "model": [move, *terms, fingerprint(model.forces)],
        "quick": options.quick,
        "data": None if options.data is None else str(options.data),
        "code": _code(),
        "versions": versions(),
    }


@functools.cache
def _code() -> str:
    """A digest of the package's own modules and tables."""
    digest = hashlib.sha256()
    package = Path(__file__).parents[2]
    for file in sorted([*package.rglob("*.py"), *package.rglob("*.yaml")]):
        digest.update(files.read_bytes(file))
    return digest.hexdigest()[:16]


def _finite(value: Any) -> Any:
    """The same with plain numbers; None for numbers that are not finite, which JSON does not have."""
    if isinstance(value, dict):
        return {name: _finite(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(part) for part in value]
    if isinstance(value, str | bool | int) or value is None:
        return value
    number = float(value)
    return number if math.isfinite(number) else None
