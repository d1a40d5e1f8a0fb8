"""A check of ``sean validate``: its description, the function that simulates and measures, and its result.

A check's function simulates scenes of its ``CheckContext`` with the validated model and returns a ``CheckResult``.
Nothing is tuned for a check: the context knows models only.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from sean_jax.config import OwnPart, is_own_part, validate
from sean_jax.files import listed
from sean_jax.recordings import Tracks
from sean_jax.studies.scenes import Model, Scene, model, simulate

PASSES, FAILS, SKIPPED = "passes", "fails", "skipped"


@dataclass(frozen=True)
class Curve:
    """A line of a plot."""

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    reference: bool = False  # measured by others, not by the model
    points: bool = False  # drawn as points, not joined


@dataclass(frozen=True)
class CheckResult:
    """The result of a check for a model."""

    passed: bool
    measured: str  # the measured values, in words and numbers with units
    reason: str = ""  # if it has not passed: what is missing
    numbers: dict[str, float] = field(default_factory=dict)  # the measured values by name, SI units
    curves: tuple[Curve, ...] = ()
    axes: tuple[str, str] = ("", "")  # of the curves: quantity and unit along x and y


class Skipped(Exception):
    """Raised by a check that cannot be made here; the text is the reason and the cure."""


@dataclass(frozen=True)
class Check:
    """One row of ``sean validate``."""

    name: str  # such as rimea-1
    title: str
    setup: str  # geometry and people
    measure: str
    criterion: str  # when it passes
    source: str
    function: Callable[["CheckContext"], CheckResult]
    quick: bool = True  # whether ``--quick`` has it


@dataclass(frozen=True)
class Row:
    """A check done for a model, as it is saved."""

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


@dataclass
class CheckContext:
    """What a check may use: the model, the recordings, if there are any, and a simulator of scenes."""

    model: Model
    data: Path | None = None  # folder of recordings
    quick: bool = False  # fewer seeds and people where a check says so
    report: Callable[[float], None] | None = None  # called with the share of a simulation that is done
    pictures: list[tuple[str, Scene, Tracks]] = field(default_factory=list)  # for the report, with captions

    def simulate(self, scenes: Scene | Sequence[Scene], show: str | Sequence[str] = "") -> list[Tracks]:
        """Simulate scenes with the model; scenes of one size run side by side.

        Args:
            show: captions of the first scenes; scenes without one are not shown.

        Returns:
            For each scene T moments 0.1 s apart of its N people, as numpy arrays.
        """
        several = [scenes] if isinstance(scenes, Scene) else list(scenes)
        tracks = simulate(several, self.model, self.report)
        captions = [show] if isinstance(show, str) else list(show)
        self.pictures += [part for part in zip(captions, several, tracks, strict=False) if part[0]]
        return tracks

    def recordings(self) -> Path:
        """The folder of recordings.

        Raises:
            Skipped: none is given.
        """
        if self.data is None:
            raise Skipped("no recordings; give their folder with --data.")
        return self.data


def result(passed: bool, measured: str, criterion: str, **fields) -> CheckResult:
    """A result whose reason, if it has not passed, is the missed criterion.

    Args:
        **fields: further ones of ``CheckResult``.
    """
    return CheckResult(bool(passed), measured, "" if passed else f"measured {measured}; wanted {criterion}", **fields)


def models_of(names: str | None, source: Path | None = None) -> list[Model]:
    """The models of a list of names.

    Args:
        names: separated by commas: presets, files of constants, pedestrian models, FILE.py:NAME; the default forces if
            None.
        source: the file that holds the names; None for names of the command line.

    Raises:
        InputError: there is none of a name, or a file gives no model.
    """
    models = []
    for name in listed(names):
        if is_own_part(name):
            from sean_jax.components import load

            part = validate(OwnPart, {"kind": name}, source=source)
            models.append(model(load(part, "models"), part.name))
        else:
            models.append(model(name))
    return models or [model()]
