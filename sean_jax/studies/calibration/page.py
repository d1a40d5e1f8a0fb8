"""The report of a calibration: losses, constants before and after, and errors in scenes that were left out."""

import html as markup
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from sean_jax.config import CalibrateConfig
from sean_jax.drawing import colors
from sean_jax.flags import command
from sean_jax.report import page
from sean_jax.report.figures import svg
from sean_jax.versions import versions

SHADES = [*colors.SITUATION_COLORS.values()][:4] + [*colors.SPARE_COLORS]
HABITS = {
    "speed": "speed that people in corridors want, m/s",
    "persistence": "share of the velocity last seen that people want elsewhere",
    "settled": "share of what the model makes people do that is part of that velocity",
}
CLOCKS = {
    "social_gan": "moments ten frames apart, as in the usual benchmark",
    "recorded": "moments 0.4 s apart",
}


def html(options: CalibrateConfig, results: dict[str, Any]) -> str:
    """The page."""
    facts = "".join(f"<dt>{name}</dt><dd>{version}</dd>" for name, version in versions().items())
    sections = [
        _section("Prediction, each scene left out once", _scores(results)),
        _section("Constants", _parameters(results)),
        _section("Errors in all scenes", _errors(results)),
        _section("Losses", f"<div class=alone><figure>{svg(_losses(results), 'losses')}</figure></div>" + LOSS),
        _section("How to get this again", f"<pre>{markup.escape(command('calibrate', options))}</pre><dl>{facts}</dl>"),
    ]
    return page("Social forces fitted to recorded people", "sean_jax · calibration", sections)


LOSS = (
    "<p class=note>The mean over scenes of the errors of prediction, in shares of those of constant velocity, and a "
    "cost of predicted pairs nearer than 0.4 m. Windows are drawn anew for each step. One line for each "
    "start of a fit.</p>"
)


def _section(title: str, body: str) -> str:
    return f"<section><h2>{title}</h2>\n{body}</section>"


def _table(head: list[str], rows: list[list[str]]) -> str:
    first = "".join(f"<th>{name}</th>" for name in head)
    body = "".join(f"<tr><th>{row[0]}</th>{''.join(f'<td>{cell}</td>' for cell in row[1:])}</tr>" for row in rows)
    return f"<div class=wide><table><thead><tr>{first}</tr></thead><tbody>{body}</tbody></table></div>"


def _scores(results: dict[str, Any]) -> str:
    parts = []
    for clock, words in CLOCKS.items():
        own = {scene: found for scene, found in results["scores"].items() if scene.endswith(f"({clock})")}
        if not own:
            continue
        models = list(dict.fromkeys(model for found in own.values() for model in found))
        rows = []
        for scene, found in own.items():
            cells = [
                f"{found[model]['ade']:.3f} / {found[model]['fde']:.3f}<small>{100 * found[model]['collisions']:.2f} % "
                "collide</small>"
                if model in found
                else "–"
                for model in models
            ]
            tracks = next(iter(found.values()))["tracks"]
            rows.append([f"{markup.escape(scene.partition(' (')[0])}<small>{tracks:,} tracks</small>", *cells])
        parts.append(f"<h3>{words}</h3>" + _table(["", *models], rows))
    note = (
        "<p class=note>Mean and last error in metres over 12 moments after 8 that were seen, and the share of the "
        "tracks that come within 0.2 m of another. <i>Left out</i>: by constants fitted to all scenes but this one.</p>"
    )
    return "".join(parts) + note if parts else "<p class=note>There is no scene of prediction among the recordings.</p>"


def _parameters(results: dict[str, Any]) -> str:
    found = results["parameters"]
    rows = []
    for name in results["names"]:
        low, high = results["bounds"][name]
        rows.append([name, f"{low:g} – {high:g}", *(f"{values[name]:.3g}" for values in found.values())])
    habits = results["habits"]
    for name, words in HABITS.items():
        rows.append([words, "", *(f"{habits[what][name]:.3g}" if what in habits else "–" for what in found)])
    head = ["", "bounds", "before", "all scenes", *(f"without {what}" for what in list(found)[2:])]
    return _table([markup.escape(name) for name in head], rows)


def _errors(results: dict[str, Any]) -> str:
    found = results["errors"]
    rows = [[scene, *(f"{values[scene]:.3f}" for values in found.values())] for scene in found["before"]]
    head = ["", "before", "all scenes", *(f"without {what}" for what in list(found)[2:])]
    note = "<p class=note>Half of mean and half of last error, in shares of those of constant velocity.</p>"
    return _table([markup.escape(name) for name in head], rows) + note


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
