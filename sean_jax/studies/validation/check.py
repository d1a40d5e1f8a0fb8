"""What a validation test is: a description, a function that simulates and measures, a finding.

A check is one entry of a table (``suite``). Its function is given a ``Laboratory``, which simulates scenes with the
model that is validated, and gives a ``Finding``. Nothing is tuned for a check: the laboratory knows models, not checks.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sean_jax.recordings import Tracks
from sean_jax.studies.scenes import Model, Scene, simulate


@dataclass(frozen=True)
class Curve:
    """A line of a plot."""

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    reference: bool = False  # measured by others, not by the model
    points: bool = False  # drawn as points, not joined


@dataclass(frozen=True)
class Finding:
    """What a check has found about a model."""

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
    measure: str  # what is measured
    criterion: str  # when it passes
    source: str
    function: Callable[["Laboratory"], Finding]
    quick: bool = True  # whether ``--quick`` has it


@dataclass
class Laboratory:
    """What a check may use: the model, a place to simulate in, and the recordings, if there are any."""

    model: Model
    data: Path | None = None  # folder of recordings
    quick: bool = False  # fewer seeds and people where a check says so
    tell: Callable[[float], None] | None = None  # is told the share of a simulation that is done
    shown: list[tuple[str, Scene, Tracks]] = field(default_factory=list)  # of what is simulated, for the report

    def simulate(self, scenes: Scene | Sequence[Scene], show: str | Sequence[str] = "") -> list[Tracks]:
        """Simulate scenes with the model; those of one size run side by side.

        Args:
            scenes: one or several.
            show: captions of those that the report shows, the first ones.

        Returns:
            For each scene T moments 0.1 s apart of its N people, as numpy arrays.
        """
        listed = [scenes] if isinstance(scenes, Scene) else list(scenes)
        found = simulate(listed, self.model, self.tell)
        captions = [show] if isinstance(show, str) else list(show)
        self.shown += [part for part in zip(captions, listed, found, strict=False) if part[0]]
        return found

    def recordings(self) -> Path:
        """The folder of recordings.

        Raises:
            Skipped: none is given.
        """
        if self.data is None:
            raise Skipped("no recordings; give their folder with --data.")
        return self.data


def judge(passed: bool, measured: str, criterion: str, **more) -> Finding:
    """A finding whose reason, if it has not passed, is the criterion that is missed.

    Args:
        **more: further fields of ``Finding``.
    """
    return Finding(bool(passed), measured, "" if passed else f"measured {measured}; wanted {criterion}", **more)


def speeds(tracks: Tracks) -> np.ndarray:
    """Speeds between moments.

    Args:
        tracks: T moments of N people, not of a periodic scene.

    Returns:
        (T - 1, N) m/s, NaN where a person is absent at one of both moments.
    """
    position, present = np.asarray(tracks.position), np.asarray(tracks.present)
    step = np.linalg.norm(np.diff(position, axis=0), axis=-1) / tracks.time_step
    return np.where(present[1:] & present[:-1], step, np.nan)
