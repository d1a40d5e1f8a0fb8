"""Reports of the experiments: one self-contained HTML page each, with the paper's numbers and ours."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sean_jax.classifiers import MORE_SITUATIONS
from sean_jax.config import (
    AblationConfig,
    BenchmarkConfig,
    BenchmarkRankConfig,
    ExperimentConfig,
    Figure4Config,
    LearningCurveConfig,
    Table1Config,
)
from sean_jax.config.flags import command, number
from sean_jax.config.workspace import IDENTITY, read_identity
from sean_jax.core.data_types import SENSING
from sean_jax.drawing.svg import svg
from sean_jax.io import files
from sean_jax.io.versions import versions
from sean_jax.studies.experiments import pictures, shares
from sean_jax.studies.experiments.measures import MEASURES, comparisons
from sean_jax.studies.experiments.ranks import ALL
from sean_jax.studies.experiments.shares import BEHAVIORS
from sean_jax.web import pages
from sean_jax.web.pages import Cell, figure, note, section, table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from sean_jax.metrics import Estimate
    from sean_jax.studies.experiments.measures import Curve, Results, Scores
    from sean_jax.studies.experiments.ranks import Ranking
    from sean_jax.studies.experiments.shares import DemonstrationCell, Recorded

TEXTS = files.read_yaml(Path(__file__).with_name("captions.yaml"))[1]
SITUATIONS = [name.replace("_", " ") for name in shares.NAMES]


def document(title: str, sections: list[str], options: ExperimentConfig | BenchmarkConfig) -> str:
    """A page with these sections and one more: the command and the versions that reproduce it."""
    origin = (read_identity(options.folder / IDENTITY) or {}).get("versions") or versions()  # of the run
    word = "benchmark" if isinstance(options, BenchmarkConfig) else "experiment"
    return pages.page(title, f"sean_jax · {word}", [*sections, pages.origin(command(word, options), origin)])


def _interval(mean: float, low: float, high: float, form: str = ".2f", scale: float = 1.0) -> Cell:
    """A mean with its 95 % interval."""
    return Cell(f"{scale * mean:{form}}", f"{scale * low:{form}} – {scale * high:{form}}", "ours")


def _estimate(value: Estimate, form: str = ".2f") -> Cell:
    return _interval(float(value.mean), float(value.low), float(value.high), form)


def _estimates(value: Estimate, form: str = ".3f", scale: float = 1.0) -> list[Cell]:
    """An estimate for each situation."""
    numbers = zip(value.mean, value.low, value.high, strict=True)
    return [_interval(*row, form, scale) for row in numbers]


def _holds(row: dict[str, Any]) -> Cell:
    """Whether a statement holds, and in which share of the resamples."""
    sure = row["share"] >= 0.975 or row["share"] <= 0.025
    return Cell(("" if sure else "perhaps ") + ("yes" if row["holds"] else "no"), f"{100 * row['share']:.1f} %")


# ------------------------------------------------------------------ Table I


def table1(
    options: Table1Config,
    cells: list[shares.Cell],
    figures: dict[str, Figure],
    compared: list[dict[str, Any]],
    real: list[Recorded],
    driven: Sequence[DemonstrationCell] = (),
) -> str:
    """The page of Table I.

    Args:
        figures: by name, as ``pictures.table1`` draws them.
        compared: of ``shares.hours``.
    """
    by_policy = shares.by_policy(cells)
    speed, sections = f"V = {number(options.speeds[0])} m/s", []
    if cells:
        legend = pages.legend(dict(zip(SITUATIONS, pictures.shades(), strict=True)))
        rows = [_shares(cells, policy) for policy in by_policy]
        sections = [
            section("Table I", figure(svg(figures["table1-bars"], "table1-bars"), TEXTS["bars"]), legend),
            section(f"Shares at {speed}", *rows, note(TEXTS["counted"])),
            section(f"The paper's hour at {speed}", *_hours(compared), note(TEXTS["hours"])),
        ]
    if driven:
        rows = [_shares(driven, policy) for policy in dict.fromkeys(each.policy for each in driven)]
        sections.append(section("Demonstrations", *rows, note(TEXTS["demonstrated"])))
    if real:
        sections.append(section("Recorded people", _recorded(options, real), note(TEXTS["recorded"])))
    if cells or real:
        sections.append(section("Beyond the five", _more(cells, list(by_policy), real), note(TEXTS["more"])))
    if len(driven) == len(BEHAVIORS) and len({each.policy for each in driven}) == 1:
        by_policy = {**shares.by_policy(driven), **by_policy}
    if by_policy:
        statement = note(f"At {speed}, {TEXTS['orderings']}")
        sections.append(section("Orderings of the paper", _orderings(by_policy), statement))
    for name, title, notes in (
        ("table1-speeds", "When does one count as walking?", [note(TEXTS["speeds"])]),
        ("table1-crowds", "How many people?", []),
    ):
        if name in figures:
            sections.append(section(title, figure(svg(figures[name], name)), *notes))
    minutes = 60.0 * options.hours * options.seeds
    title = f"Table I: social situations in {number(minutes)} minutes of each behavior and policy"
    title = title if cells else f"Table I: social situations in {'recordings' if real else 'demonstrations'}"
    return document(title, sections, options)


def _shares(cells: Sequence[shares.Cell | DemonstrationCell], policy: str) -> str:
    rows: list[list[str | Cell]] = []
    for cell in (cell for cell in cells if cell.policy == policy):
        paper = shares.paper()[cell.behavior]
        rows.append([cell.behavior, *_figures(cell.shares()), f"{cell.ended[0]} of {int(cell.ended.sum())}"])
        numbers = (f"{100 * value:.2f}" for value in paper)
        rows.append([Cell("paper", kind="none"), *numbers, "", f"{shares.normalised_entropy(paper):.3f}", ""])
    return table([policy, *SITUATIONS, "none", "entropy", "completed"], rows)


def _hours(compared: list[dict[str, Any]]) -> list[str]:
    """A table for each policy: the paper's figures, and the interval of an hour of the policy."""
    figures, tables = [*shares.NAMES, "entropy"], []
    for policy in dict.fromkeys(row["policy"] for row in compared):
        rows = []
        for behavior in BEHAVIORS:
            by_figure = {r["figure"]: r for r in compared if (r["policy"], r["behavior"]) == (policy, behavior)}
            cells = []
            for name in figures:
                row, (scale, form) = by_figure[name], (1.0, ".3f") if name == "entropy" else (100.0, ".1f")
                apart, printed = row["holm"] < 0.05, f"{scale * row['paper']:{form}}"
                cell = _interval(row["mean"], row["low"], row["high"], form, scale)
                cells.append(cell._replace(text=f"{printed} ({cell.text})", kind="ours" if apart else ""))
            rows.append([behavior, *cells])
        tables.append(table([policy, *SITUATIONS, "entropy"], rows))
    return tables


def _figures(estimate: shares.Shares, known: Collection[str] = shares.NAMES) -> list[str | Cell]:
    """Columns of the paper's situations, none, and entropy."""
    flags, examples, entropy = estimate.of("flags"), estimate.of("examples"), estimate.entropy()
    columns: list[str | Cell] = [
        cell._replace(text=f"{cell.text} ({100 * share:.1f})") if isinstance(cell, Cell) else cell
        for cell, share in zip(_samples(flags, shares.NAMES, known), examples[0], strict=True)
    ]
    low, high = shares.interval(entropy)
    return [*columns, f"{100 * estimate.none[0]:.1f}", _interval(entropy[0], float(low), float(high), ".3f")]


def _samples(samples: np.ndarray, names: Sequence[str], known: Collection[str]) -> list[str | Cell]:
    """Percent of an estimate and its resamples (1 + R, S), of the situations that are known."""
    numbers = zip(samples[0], *shares.interval(samples), strict=True)
    return [_interval(*row, ".1f", 100.0) if name in known else "" for name, row in zip(names, numbers, strict=True)]


def _recorded(options: Table1Config, real: list[Recorded]) -> str:
    rows = [
        [f"{each.name}, V = {number(speed)} m/s", *_figures(each.shares(index), each.known), f"{each.people}"]
        for each in real
        for index, speed in enumerate(options.speeds)
    ]
    return table(["", *SITUATIONS, "none", "entropy", "people"], rows)


def _more(cells: list[shares.Cell], policies: list[str], real: list[Recorded]) -> str:
    """Situations beyond the paper's five."""
    names = list(MORE_SITUATIONS)
    estimates = [
        (f"{cell.behavior} · {cell.policy}", cell.further(), names)
        for policy in policies
        for cell in cells
        if cell.policy == policy
    ]
    estimates += [(each.name, each.further(), each.known) for each in real]
    rows = [[title, *_samples(estimate.examples, names, known)] for title, estimate, known in estimates]
    return table(["", *(name.replace("_", " ") for name in names)], rows)


def _orderings(by_policy: dict[str, dict[str, shares.Shares]]) -> str:
    rows = []
    for first, *others in zip(*map(shares.orderings, by_policy.values()), strict=True):
        words = [first["name"], Cell(first["statement"], kind="text"), first["source"]]
        rows.append([*words, *map(_holds, (first, *others))])
    return table(["", "statement", "", *by_policy], rows)


# ------------------------------------------------------------------ ablation


def ablation(
    options: AblationConfig, by_world: dict[str, list[shares.Cell]], references: dict[str, str], picture: Figure
) -> str:
    """The page of Table I in several worlds.

    Args:
        by_world: world -> cells of each policy and behavior.
        references: world -> the world that it is compared with; the default has itself.
        picture: as ``pictures.ablation`` draws it.
    """
    tables = {world: shares.by_policy(cells) for world, cells in by_world.items()}
    policies = list(next(iter(tables.values())))
    by_cell = [_worlds(tables, references, behavior, policy) for policy in policies for behavior in BEHAVIORS]
    orderings = [_changed_orderings(tables, references, policy) for policy in policies]
    sections = [
        section("What each switch moves", figure(svg(picture, "ablation"), TEXTS["moved"])),
        section("Orderings of the paper", *orderings, note(TEXTS["decided"])),
        section("Shares", *by_cell, note(TEXTS["worlds"])),
    ]
    return document("Table I: which of SEAN's conditions moves what", sections, options)


Tables = dict[str, dict[str, dict[str, shares.Shares]]]  # world -> policy -> behavior -> shares


def _worlds(tables: Tables, references: dict[str, str], behavior: str, policy: str) -> str:
    columns = {world: _columns(by_policy[policy][behavior]) for world, by_policy in tables.items()}
    paper = shares.paper()[behavior]
    numbers = [*(f"{100 * value:.1f}" for value in paper), "", f"{shares.normalised_entropy(paper):.3f}"]
    rows: list[list[str | Cell]] = [[Cell("paper", kind="none"), *numbers]]
    for world, samples in columns.items():
        low, high = shares.interval(samples)
        below, above = shares.interval(samples - columns[references[world]])
        cells = []
        for k, value in enumerate(samples[0]):
            scale, form = (1.0, ".3f") if k == len(shares.NAMES) + 1 else (100.0, ".1f")
            moved = world != references[world] and not below[k] <= 0.0 <= above[k]
            cells.append(_interval(value, low[k], high[k], form, scale)._replace(kind="ours" if moved else ""))
        rows.append([world, *cells])
    return table([f"{behavior} · {policy}", *SITUATIONS, "none", "entropy"], rows)


def _columns(estimate: shares.Shares) -> np.ndarray:
    """(1 + R, 7) shares of flags, none, and entropy."""
    return np.concatenate([estimate.of("flags"), estimate.none[:, None], estimate.entropy()[:, None]], axis=1)


def _changed_orderings(tables: Tables, references: dict[str, str], policy: str) -> str:
    rows, by_world = [], {world: shares.orderings(by_policy[policy]) for world, by_policy in tables.items()}
    for k, first in enumerate(next(iter(by_world.values()))):
        cells = []
        for world, orderings in by_world.items():
            share = orderings[k]["share"]
            ends = sorted((share, by_world[references[world]][k]["share"]))
            reversal = ends[0] <= 0.025 and ends[1] >= 0.975
            cells.append(Cell(f"{100 * share:.0f}", kind="ours" if reversal else ""))
        rows.append([first["name"], Cell(first["statement"], kind="text"), *cells])
    return table([policy, "statement", *tables], rows)


# ------------------------------------------------------------------ benchmark


def benchmark(
    options: BenchmarkConfig,
    whole: Scores,
    by_group: dict[str, Scores],
    by_track: dict[str, Scores],
    skipped: str,
) -> str:
    """The page of a benchmark.

    Args:
        skipped: a sentence on tracks that are left out, or "".
    """
    tracks = {"all": whole, **by_track}
    groups = [[name, *map(_estimate, scores.figures.values())] for name, scores in {"all": whole, **by_group}.items()]
    figures = [[name, *map(_estimate, scores.figures.values())] for name, scores in tracks.items()]
    violations = [[name, *_estimates(scores.violations)] for name, scores in tracks.items()]
    time = [[name, *_estimates(scores.shares, ".1f", 100.0)] for name, scores in tracks.items()]
    head = ["track", *SITUATIONS]
    sections = [
        section(
            "By group of tracks",
            table(["group", *whole.FIGURES.values()], groups),
            *([note(skipped)] if skipped else []),
            note(TEXTS["polite"]),
        ),
        section("By track", table(["track", *whole.FIGURES.values()], figures)),
        section("By situation: times a minute within 0.45 m, by the robot", table(head, violations)),
        section("By situation: percent of the time", table(head, time)),
    ]
    title = f"{options.policy}: {len(by_track)} tracks, {options.episodes} episodes each"
    return document(title, sections, options)


def ranking(options: BenchmarkRankConfig, ranks: Ranking, figures: dict[str, Figure]) -> str:
    """The page of a ranking.

    Args:
        figures: class of sensing -> the figure that ``pictures.situations`` draws.
    """
    sections = []
    for sensing, rows in ranks.by_class().items():
        head = ["rank", "policy", "seeds", *ranks.groups]
        table_rows = [
            [row.rank, Cell(row.entry.name, kind="text"), row.seeds, *(_estimate(row.of[each]) for each in row.of)]
            for row in rows
        ]
        pairs = [
            [Cell(f"{each.second} - {each.first}", kind="text"), _interval(*each.difference), f"{each.p:.2g}"]
            for each in ranks.pairs
            if each.sensing == sensing
        ]
        title = f"{sensing}: {SENSING[sensing]}"
        parts = [
            table(head, table_rows),
            figure(svg(figures[sensing], f"ranking-{sensing}"), TEXTS["ranked_situations"]),
        ]
        if pairs:
            parts.insert(1, table(["difference", "politely completed, % points", "p"], pairs))
        sections.append(section(title, *parts))
    notes = [TEXTS["ranked"], *ranks.notes]
    sections.append(section("How ranks are made", *map(note, notes)))
    title = f"Ranking of {len(ranks.rows)} policies on {len(ranks.groups[ALL])} tracks"
    words = command("benchmark", options)
    return pages.page(title, "sean_jax · benchmark", [*sections, pages.origin(words, versions())])


# ------------------------------------------------------------------ Figure 4


def figure4(
    options: Figure4Config,
    results: Results,
    claims: list[dict[str, Any]],
    grids: Figure,
    driven: Sequence[DemonstrationCell] = (),
) -> str:
    """The page of Figure 4.

    Args:
        claims: of ``measures.claims``.
        grids: the figure that ``pictures.grids`` draws.
    """
    rows = [
        [
            Cell(claim["statement"], kind="text"),
            "ours" if claim["paper"] == "not reported" else "paper",
            claim["paper"],
            Cell(claim["ours"], kind="ours"),
            _holds(claim),
        ]
        for claim in claims
    ]
    sections = [
        section("Figure 4", figure(svg(grids, "figure4-grids")), note(TEXTS["figure4"])),
        section("Numbers", *_numbers(results), note(TEXTS["bootstrap"])),
        section("By situation", *_by_situation(results), note(TEXTS["bootstrap"])),
        section("Differences", _contrasts(results), note(TEXTS["contrasts"])),
        section("What the paper reports", table(["statement", "whose", "paper", "here", "holds"], rows)),
    ]
    if driven:
        counts = [[each.behavior, each.policy, f"{each.ended.sum()}", f"{each.ended[0]}"] for each in driven]
        head = ["people", "driver", "episodes", "completed"]
        sections.append(section("Demonstrations", table(head, counts), note(TEXTS["replaced"])))
    if results.training:
        sections.append(section("Training", _training(results.training)))
    datasets, trainings, _ = results.sizes
    networks = f"; {datasets * trainings} networks of each learner" if datasets * trainings > 1 else ""
    scenarios = f"{len(BEHAVIORS)} scenarios, {results.episodes} episodes each"
    return document(f"Figure 4: {len(results.values)} policies in {scenarios}{networks}", sections, options)


def _contrasts(results: Results) -> str:
    """A row for each pair of policies, a column for each measure."""
    rows = []
    for pair in dict.fromkeys((row["one"], row["other"]) for row in results.contrasts):
        cells = []
        for row in (row for row in results.contrasts if (row["one"], row["other"]) == pair):
            cell = _estimate(row["difference"], "+.3g")
            p = "" if math.isnan(row["holm"]) else f", d {row['effect']:+.2f}, p {row['holm']:.2g}"
            kind = "ours" if row["holm"] < 0.05 else ""
            cells.append(cell._replace(small=f"{cell.small}{p}", kind=kind))
        rows.append([" − ".join(pair), *cells])
    return table(["", *MEASURES.values()], rows)


def _training(trainings: Mapping[str, dict[str, float]]) -> str:
    rows = []
    for name, row in trainings.items():
        counts = f"{row['examples']:.0f}", f"{row['entropy']:.3f}", f"{row['epochs']:.0f}", f"{row['best_epoch']:.0f}"
        rows.append([name, *counts, f"{row['loss']:.4f}", f"{row['seconds']:.0f}"])
    head = ["policy", "examples", "entropy of situations", "epochs", "best", "validation loss", "seconds"]
    return table(head, rows)


def _numbers(results: Results) -> list[str]:
    policies, blocks = list(results.values), []
    for name, words in MEASURES.items():
        rows: list[list[str | Cell]] = [
            [f"in {behavior}", *(_estimate(results.cells[policy][behavior][name]) for policy in policies)]
            for behavior in BEHAVIORS
        ]
        rows.append([Cell("mean", kind="none"), *(_estimate(results.means[policy][name]) for policy in policies)])
        if name in TEXTS["paper"]:
            rows.append(
                [Cell("paper, mean", kind="none"), *(TEXTS["paper"][name].get(policy, "") for policy in policies)]
            )
        blocks.append(table([words, *policies], rows))
        if name == "time_not_moving":
            rows = []
            for behavior in BEHAVIORS:
                cells = (results.waiting[policy][behavior] for policy in policies)
                rows.append([f"in {behavior}", *(_estimate(cell) if cell.episodes else "-" for cell in cells)])
            blocks.append(table(["the same, of completed tasks", *policies], rows))
    return blocks


def _by_situation(results: Results) -> list[str]:
    rows = [
        [f"{policy} in {behavior}", *_estimates(results.by_situation[policy][behavior])]
        for behavior in BEHAVIORS
        for policy in results.values
    ]
    balanced = [[f"in {behavior}", *_estimates(row, "+.3f")] for behavior, row in results.balancing.items()]
    measures = [
        [f"in {behavior}", *(_estimate(row[name], "+.2f") for name in MEASURES)]
        for behavior, row in results.more.items()
    ]
    return [
        table(["intimate distance violations per episode", *SITUATIONS], rows),
        table(["B minus G, in the same episodes", *SITUATIONS], balanced),
        table(["likewise", *MEASURES.values()], measures),
    ]


# ------------------------------------------------------------------ learning curve


def learning_curve(options: LearningCurveConfig, curve: Curve, picture: Figure) -> str:
    """The page of the learning curve of policy G.

    Args:
        picture: as ``pictures.learning_curve`` draws it.
    """
    columns = list(curve.cells[curve.variants[0].name])
    numbers = []
    for name, words in MEASURES.items():
        rows = [[each.title, *_row(curve.cells[each.name], columns, name)] for each in curve.variants]
        numbers.append(table([words, *columns], rows))
    differences = []
    for one, other in comparisons(curve.variants):
        cells = curve.differences(one, other)
        rows = [[words, *_row(cells, columns, name, "+.2f")] for name, words in MEASURES.items()]
        differences.append(table([f"{one.title} minus {other.title}", *columns], rows))
    verdicts = [
        [Cell(f"{row['variant']} better than {row['other']}: {MEASURES[row['measure']]}", kind="text"),
         _estimate(row["difference"], "+.2f"), _holds(row)]
        for row in curve.verdicts
    ]  # fmt: skip
    titles = {each.name: each.title for each in curve.variants}
    sections = [
        section("What more data does", figure(svg(picture, "learning-curve"), TEXTS["curve"])),
        section(
            "Is it better?", table(["over the three scenarios", "difference", "holds"], verdicts), note(TEXTS["sure"])
        ),
        section("Numbers", *numbers, note(TEXTS["bootstrap"])),
        section("Differences in the same episodes", *differences, note(TEXTS["bootstrap"])),
        section("Training", _training({titles[name]: row for name, row in curve.training.items()})),
    ]
    datasets, trainings, each = curve.sizes
    several = f"{datasets} dataset{'s' * (datasets > 1)}, {trainings} network{'s' * (trainings > 1)} on each"
    whole = f"{several}, {datasets * trainings * each} episodes in each cell"
    return document(f"Policy G and its data: {whole}", sections, options)


def _row(cells: Mapping[str, Mapping], columns: Sequence[str], name: str, form: str = ".2f") -> list[Cell]:
    return [_estimate(cells[column][name], form) for column in columns]
