"""The report of a calibration: rows of the loss and constants before and after, errors in scenes left out."""

from typing import Any

import matplotlib
from matplotlib.figure import Figure

from sean_jax.config import CalibrateConfig
from sean_jax.config.flags import command
from sean_jax.drawing import colors
from sean_jax.drawing.svg import svg
from sean_jax.io.versions import versions
from sean_jax.web import pages

SHADES = [*colors.SITUATION_COLORS.values()][:4] + [*colors.SPARE_COLORS]
HABITS = {
    "speed": "desired speed in corridors, m/s",
    "persistence": "desired velocity elsewhere, as a share of the last observed one",
    "settled": "share of the model's acceleration that the observed velocity already holds",
}
CLOCKS = {
    "social_gan": "moments ten frames apart, as in the usual benchmark",
    "recorded": "moments 0.4 s apart",
}


def html(options: CalibrateConfig, results: dict[str, Any]) -> str:
    """The page."""
    sections = [
        pages.section("The loss, row by row", _rows(results), pages.note(ROWS)),
        pages.section("Prediction, each scene left out once", *_scores(results)),
        pages.section("Constants", _parameters(results)),
        pages.section("Losses", pages.figure(svg(_losses(results), "losses"), narrow=True), pages.note(LOSSES)),
        pages.origin(command("calibrate", options), versions()),
    ]
    return pages.page("Social forces fitted to recorded people", "sean_jax · calibration", sections)


SCORES = (
    "Mean and last error in metres over 12 predicted moments after 8 observed ones, and the share of the tracks that "
    "come within 0.2 m of another. Left out: by constants fitted to all scenes but this one."
)
ROWS = (
    "Measured values, and in brackets how many tolerances they are off. The last line is the loss of all rows; fits "
    "without a scene have not seen its row."
)
LOSSES = "The best loss of each generation of a fit."


def _scores(results: dict[str, Any]) -> list[str]:
    parts = []
    for clock, title in CLOCKS.items():
        scores = {scene: models for scene, models in results["scores"].items() if scene.endswith(f"({clock})")}
        if not scores:
            continue
        names = list(dict.fromkeys(name for models in scores.values() for name in models))
        rows = []
        for scene, models in scores.items():
            cells = [_score(models[name]) if name in models else "–" for name in names]
            tracks = next(iter(models.values()))["tracks"]
            rows.append([pages.Cell(scene.partition(" (")[0], f"{tracks:,} tracks"), *cells])
        parts += [pages.heading(title), pages.table(["", *names], rows)]
    return [*parts, pages.note(SCORES)] if parts else [pages.note("No scene of prediction is among the recordings.")]


def _score(score: dict[str, Any]) -> pages.Cell:
    return pages.Cell(f"{score['ade']:.3f} / {score['fde']:.3f}", f"{100 * score['collisions']:.2f} % collide")


def _parameters(results: dict[str, Any]) -> str:
    fits = results["parameters"]
    rows = []
    for name in results["names"]:
        low, high = results["bounds"][name]
        rows.append([name, f"{low:g} – {high:g}", *(f"{values[name]:.3g}" for values in fits.values())])
    habits = results["habits"]
    for name, words in HABITS.items():
        rows.append([words, "", *(f"{habits[fit][name]:.3g}" if fit in habits else "–" for fit in fits)])
    return pages.table(["", "bounds", *_names(fits)], rows)


def _rows(results: dict[str, Any]) -> str:
    fits = results["loss"]
    lines = []
    for row, values in results["rows"].items():
        if (aim := values["target"]) is None:
            continue
        side = {"most": "≤ ", "least": "≥ "}.get(aim["side"], "")
        cells = [f"{values[fit]:.3g} ({values['miss'][fit]:+.1f})" for fit in fits]
        lines.append([row, f"{side}{aim['target']:.3g} ± {aim['tolerance']:.2g}", *cells])
    lines.append(["loss", "", *(f"{loss:.2f}" for loss in fits.values())])
    return pages.table(["", "target", *_names(fits)], lines)


def _names(fits: dict[str, Any]) -> list[str]:
    """The columns of fits: before, all scenes, and each scene left out."""
    return ["before", "all scenes", *(f"without {name}" for name in list(fits)[2:])]


def _losses(results: dict[str, Any]) -> Figure:
    with matplotlib.rc_context({"font.size": 9, "axes.edgecolor": colors.MUTED, "svg.fonttype": "none"}):
        figure = Figure(figsize=(8.0, 3.2), layout="constrained", facecolor=colors.PAPER)
        axes = figure.subplots()
    axes.set_facecolor(colors.PAPER)
    for (what, history), shade in zip(results["losses"].items(), SHADES, strict=False):
        label = "all scenes" if what == "all" else f"without {what}"
        axes.plot([min(generation) for generation in history], color=shade, lw=1.4, label=label)
    axes.set_xlabel("generation", color=colors.MUTED)
    axes.set_ylabel("loss", color=colors.MUTED)
    axes.tick_params(colors=colors.MUTED)
    axes.legend(frameon=False)
    return figure
