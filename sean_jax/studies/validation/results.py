"""Rows of checks, saved one by one, and loaded again if nothing that affects them has changed."""

import dataclasses
import functools
import hashlib
import math
import re
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sean_jax import files, writing
from sean_jax.config import ValidateConfig
from sean_jax.drawing.svg import svg
from sean_jax.flags import command
from sean_jax.studies.scenes import Model
from sean_jax.studies.validation import page
from sean_jax.studies.validation.check import FAILS, PASSES, SKIPPED, Check, CheckContext, Curve, Row, Skipped
from sean_jax.versions import fingerprint, versions

RESULTS, PARTS = "results.json", "parts"
OURS = {RESULTS, PARTS, "report.html", "table.md"}


def do(check: Check, context: CheckContext) -> Row:
    """Do a check."""
    begin = time.monotonic()
    measured, reason, numbers, curves, axes = "", "", {}, (), ("", "")
    try:
        result = check.function(context)
        verdict, measured, reason = PASSES if result.passed else FAILS, result.measured, result.reason
        numbers, curves, axes = result.numbers, result.curves, result.axes
    except Skipped as error:
        verdict, reason = SKIPPED, str(error)
    pictures = tuple(
        (caption, svg(page.trajectories(scene, tracks), f"{check.name}-{context.model.name}-{k}"))
        for k, (caption, scene, tracks) in enumerate(context.pictures)
    )
    seconds = time.monotonic() - begin
    return Row(check.name, context.model.name, verdict, measured, reason, numbers, curves, axes, pictures, seconds)


def load(folder: Path, check: Check, model: Model, options: ValidateConfig) -> Row | None:
    """The row of an earlier run with the same code, versions and model; None without one, or if it was skipped."""
    try:
        content = files.read_json(_part(folder, check, model))
        if content.pop("made_with") != _made_with(model, options) or content["verdict"] == SKIPPED:
            return None
        content["curves"] = tuple(Curve(**curve) for curve in content["curves"])
        for name in ("axes", "pictures"):
            content[name] = tuple(tuple(part) if isinstance(part, list) else part for part in content[name])
        return Row(**content)
    except (ValueError, KeyError, TypeError, AttributeError):
        return None


def save(folder: Path, check: Check, model: Model, options: ValidateConfig, row: Row) -> None:
    """Keep a row."""
    (folder / PARTS).mkdir(exist_ok=True)
    content = {"made_with": _made_with(model, options), **_finite(dataclasses.asdict(row))}
    writing.write(_part(folder, check, model), content)


def write(folder: Path, options: ValidateConfig, rows: Sequence[Row]) -> None:
    """Write results.json: the command, the versions, and for each row all but its curves and pictures."""
    left_out = ("curves", "axes", "pictures")
    table = [{name: part for name, part in dataclasses.asdict(row).items() if name not in left_out} for row in rows]
    content = {"command": command("validate", options), "versions": versions(), "rows": _finite(table)}
    writing.write(folder / RESULTS, content)


def _part(folder: Path, check: Check, model: Model) -> Path:
    name = re.sub(r"[^\w.-]", "-", model.name)  # a path, where a file of constants or of one's own moves people
    return folder / PARTS / f"{check.name}--{name}.json"


def _made_with(model: Model, options: ValidateConfig) -> dict[str, Any]:
    """All that affects a row."""
    who = f"{getattr(model.move, '__module__', '')}.{getattr(model.move, '__qualname__', '')}"
    terms = [f"{type(term).__module__}.{type(term).__name__}" for term in model.forces]  # own ones have their digest
    return {
        "model": [who, *terms, fingerprint(model.forces)],
        "quick": options.quick,
        "data": None if options.data is None else str(options.data),
        "code": _code(),
        "versions": versions(),
    }


@functools.cache
def _code() -> str:
    """A digest of the package's own modules."""
    digest = hashlib.sha256()
    for file in sorted(Path(__file__).parents[2].rglob("*.py")):
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
