"""The report of a calibration: losses, constants before and after, and errors in scenes that were left out."""

from typing import Any

import matplotlib
from matplotlib.figure import Figure

from sean_jax import pages
from sean_jax.config import CalibrateConfig
from sean_jax.drawing import colors
from sean_jax.drawing.svg import svg
from sean_jax.flags import command
from sean_jax.versions import versions

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
        pages.section("Prediction, each scene left out once", *_scores(results)),
        pages.section("Constants", _parameters(results)),
        pages.section("Errors in all scenes", _errors(results), pages.note(ERRORS)),
        pages.section("Losses", pages.figure(svg(_losses(results), "losses"), narrow=True), pages.note(LOSSES)),
        pages.origin(command("calibrate", options), versions()),
    ]
    return pages.page("Social forces fitted to recorded people", "sean_jax · calibration", sections)


SCORES = (
    "Mean and last error in metres over 12 predicted moments after 8 observed ones, and the share of the tracks that "
    "come within 0.2 m of another. Left out: by constants fitted to all scenes but this one."
)
ERRORS = "Half of the mean and half of the final error, relative to constant velocity."
LOSSES = (
    "The mean over scenes of the errors of prediction, relative to constant velocity, and a cost of "
    "predicted pairs nearer than 0.4 m. Each step draws new windows. One line for each start of a fit."
)


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


def _errors(results: dict[str, Any]) -> str:
    fits = results["errors"]
    rows = [[scene, *(f"{values[scene]:.3f}" for values in fits.values())] for scene in fits["before"]]
    return pages.table(["", *_names(fits)], rows)


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
        best = results["best_start"][what]
        for start in range(len(history[0])):
            values = [row[start] for row in history]
            smooth = [sum(values[max(0, k - 9) : k + 1]) / min(k + 1, 10) for k in range(len(values))]
            axes.plot(smooth, color=shade, lw=1.6 if start == best else 0.6, label=label if start == best else None)
    axes.set_xlabel("step", color=colors.MUTED)
    axes.set_ylabel("loss, mean of 10 steps", color=colors.MUTED)
    axes.tick_params(colors=colors.MUTED)
    axes.legend(frameon=False)
    return figure
