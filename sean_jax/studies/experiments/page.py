"""Reports of the experiments: one self-contained HTML page each, with the paper's numbers beside ours."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from sean_jax import pages
from sean_jax.classifiers import MORE_SITUATIONS
from sean_jax.config import (
    AblationConfig,
    BenchmarkConfig,
    ExperimentConfig,
    Figure4Config,
    LearningCurveConfig,
    Table1Config,
)
from sean_jax.flags import command, number
from sean_jax.pages import Cell, figure, note, section, table
from sean_jax.report import svg
from sean_jax.studies.experiments import pictures, shares
from sean_jax.studies.experiments.measures import CURVE_MEASURES, comparisons
from sean_jax.studies.experiments.shares import BEHAVIORS
from sean_jax.versions import versions
from sean_jax.workspace import IDENTITY, read_identity

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from sean_jax.metrics import Estimate
    from sean_jax.studies.experiments.measures import Claim, Curve, Results, Training, Verdict
    from sean_jax.studies.experiments.shares import Ordering, Recorded
    from sean_jax.studies.experiments.tracks import Scores

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


def _holds(row: Claim | Ordering | Verdict) -> Cell:
    """Whether a statement holds, and in how many of the resamples."""
    sure = row["share"] >= 0.975 or row["share"] <= 0.025
    return Cell(("" if sure else "perhaps ") + ("yes" if row["holds"] else "no"), f"{100 * row['share']:.1f} %")


# ------------------------------------------------------------------ Table I


def table1(options: Table1Config, cells: list[shares.Cell], figures: dict[str, Figure], real: list[Recorded]) -> str:
    """The page of Table I.

    Args:
        figures: by name, as ``pictures.table1`` draws them.
    """
    policies = list(dict.fromkeys(cell.policy for cell in cells))
    speed = options.speeds[0]
    sections = []
    if cells:
        legend = pages.legend(dict(zip(SITUATIONS, pictures.shades(), strict=True)))
        rows = [_shares(cells, policy) for policy in policies]
        sections = [
            section("Table I", figure(svg(figures["table1-bars"], "table1-bars"), BARS), legend),
            section(f"Shares at V = {number(speed)} m/s", *rows, note(COUNTED)),
        ]
    if real:
        sections.append(section("Recorded people", _recorded(options, real), note(RECORDED)))
    sections.append(section("Beyond the five", _more(cells, policies, real), note(MORE)))
    if cells:
        statement = (
            f"At V = {number(speed)} m/s, shares of flags. Below: the share of the resamples in which it holds; at "
            "least 97.5 % counts as sure. orderings.csv has the other speeds and ways of counting."
        )
        sections.append(section("Orderings of the paper", _orderings(cells, policies), note(statement)))
    for name, title, text in (
        ("table1-speeds", "When does one count as walking?", SPEEDS),
        ("table1-crowds", "How many people?", ""),
    ):
        if name in figures:
            picture = figure(svg(figures[name], name))
            sections.append(section(title, picture, note(text)) if text else section(title, picture))
    minutes = 60.0 * options.hours * options.seeds
    title = f"Table I: social situations in {number(minutes)} minutes of each behavior and policy"
    title = title if cells else "Table I: social situations in recordings"
    return document(title, sections, options)


BARS = "Dashed: the paper's Table I."
COUNTED = (
    "Percent of all flags: an example, one a second, has a flag for each situation that holds. In brackets, percent "
    "of the examples; none are the examples without a flag. Small: 95 % bootstrap interval over minutes. Entropy is "
    "over ln 5. The paper's rows are divided by their sum."
)
MORE = (
    "Percent of the examples; several situations can hold at once. The paper names urgency and the configuration of "
    "objects for later (VI). No figure: the recording does not have the places of objects."
)
RECORDED = (
    "Each person in turn plays the robot, in every row of the recording; counted as in Table I. Without companions: "
    "people who walk in one group with that person are left out. Small: 95 % bootstrap interval over these people. No "
    "figure: the recording does not have groups in conversation."
)
SPEEDS = (
    "The paper counts people as walking above 1.4 m/s. SEAN 2.0's code uses 0.4 m/s, and its people walk at 0.6 m/s. "
    "People here prefer 1.34 ± 0.26 m/s."
)


def _shares(cells: list[shares.Cell], policy: str) -> str:
    rows: list[list[str | Cell]] = []
    for cell in (cell for cell in cells if cell.policy == policy):
        paper = shares.paper()[cell.behavior]
        rows.append([cell.behavior, *_figures(cell.shares()), f"{cell.ended[0]} of {int(cell.ended.sum())}"])
        numbers = (f"{100 * value:.2f}" for value in paper)
        rows.append([Cell("paper", kind="none"), *numbers, "", f"{shares.normalised_entropy(paper):.3f}", ""])
    return table([policy, *SITUATIONS, "none", "entropy", "completed"], rows)


def _figures(estimate: shares.Shares, known: Collection[str] = shares.NAMES) -> list[str | Cell]:
    """Columns of the paper's situations, none, and entropy."""
    flags, examples, entropy = estimate.of("flags"), estimate.of("examples"), estimate.entropy()
    low, high = shares.interval(flags)
    ends = shares.interval(entropy)
    columns: list[str | Cell] = [
        Cell(f"{100 * flags[0, k]:.1f} ({100 * examples[0, k]:.1f})", f"{100 * low[k]:.1f} – {100 * high[k]:.1f}",
             "ours") if name in known else ""
        for k, name in enumerate(shares.NAMES)
    ]  # fmt: skip
    return [*columns, f"{100 * estimate.none[0]:.1f}", _interval(entropy[0], float(ends[0]), float(ends[1]), ".3f")]


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
    rows = []
    for title, estimate, known in estimates:
        numbers = zip(estimate.examples[0], *shares.interval(estimate.examples), strict=True)
        columns = [
            _interval(*row, ".1f", 100.0) if name in known else "" for name, row in zip(names, numbers, strict=True)
        ]
        rows.append([title, *columns])
    return table(["", *(name.replace("_", " ") for name in names)], rows)


def _orderings(cells: list[shares.Cell], policies: list[str]) -> str:
    by_policy = [
        shares.orderings({cell.behavior: cell.shares() for cell in cells if cell.policy == policy})
        for policy in policies
    ]
    rows = []
    for index, first in enumerate(by_policy[0]):
        words = [first["name"], Cell(first["statement"], kind="text"), "hard" if first["hard"] else "soft"]
        rows.append([*words, *(_holds(orderings[index]) for orderings in by_policy)])
    return table(["", "statement", "", *policies], rows)


# ------------------------------------------------------------------ ablation


def ablation(options: AblationConfig, by_world: dict[str, list[shares.Cell]], picture: Figure) -> str:
    """The page of Table I in several worlds.

    Args:
        by_world: world -> cells of each policy and behavior; the first world is the reference.
        picture: as ``pictures.ablation`` draws it.
    """
    policies = list(dict.fromkeys(cell.policy for cells in by_world.values() for cell in cells))
    by_cell = [_worlds(by_world, behavior, policy) for policy in policies for behavior in BEHAVIORS]
    orderings = [_changed_orderings(by_world, policy) for policy in policies]
    sections = [
        section("What each switch moves", figure(svg(picture, "ablation"), MOVED)),
        section("Orderings of the paper", *orderings, note(DECIDED)),
        section("Shares", *by_cell, note(WORLDS)),
    ]
    return document("Table I: which of SEAN's conditions moves what", sections, options)


MOVED = (
    "Difference of the shares of flags from the default world, in percentage points, means over the policies. A row "
    "is that world with one switch, the last with all of them."
)
DECIDED = (
    "The percentage of the resamples in which an ordering holds, by shares of flags. Bold: the switch reverses the "
    "default world's answer, each with 97.5 % or more. orderings.csv has the other ways of counting."
)
WORLDS = (
    "Percent of all flags; none: percent of the examples without a flag. Small: 95 % bootstrap interval over minutes. "
    "Bold: the interval of the difference from the default world leaves out 0."
)


def _worlds(by_world: dict[str, list[shares.Cell]], behavior: str, policy: str) -> str:
    estimates = {
        world: next(cell.shares() for cell in cells if (cell.behavior, cell.policy) == (behavior, policy))
        for world, cells in by_world.items()
    }
    columns = {world: _columns(estimate) for world, estimate in estimates.items()}
    default, first = next(iter(columns.items()))
    paper = shares.paper()[behavior]
    numbers = [*(f"{100 * value:.1f}" for value in paper), "", f"{shares.normalised_entropy(paper):.3f}"]
    rows: list[list[str | Cell]] = [[Cell("paper", kind="none"), *numbers]]
    for world, samples in columns.items():
        low, high = shares.interval(samples)
        below, above = shares.interval(samples - first)
        cells = []
        for k, value in enumerate(samples[0]):
            scale, form = (1.0, ".3f") if k == len(shares.NAMES) + 1 else (100.0, ".1f")
            moved = world != default and not below[k] <= 0.0 <= above[k]
            cells.append(_interval(value, low[k], high[k], form, scale)._replace(kind="ours" if moved else ""))
        rows.append([world, *cells])
    return table([f"{behavior} · {policy}", *SITUATIONS, "none", "entropy"], rows)


def _columns(estimate: shares.Shares) -> np.ndarray:
    """(1 + R, 7) shares of flags, none, and entropy."""
    return np.concatenate([estimate.of("flags"), estimate.none[:, None], estimate.entropy()[:, None]], axis=1)


def _changed_orderings(by_world: dict[str, list[shares.Cell]], policy: str) -> str:
    orderings = {
        world: shares.orderings({cell.behavior: cell.shares() for cell in cells if cell.policy == policy})
        for world, cells in by_world.items()
    }
    rows = []
    for index, first in enumerate(next(iter(orderings.values()))):
        cells = []
        for each in orderings.values():
            share = each[index]["share"]
            reversed_ = min(share, first["share"]) <= 0.025 and max(share, first["share"]) >= 0.975
            cells.append(Cell(f"{100 * share:.0f}", kind="ours" if reversed_ else ""))
        rows.append([first["name"], Cell(first["statement"], kind="text"), *cells])
    return table([policy, "statement", *orderings], rows)


# ------------------------------------------------------------------ benchmark


def benchmark(options: BenchmarkConfig, whole: Scores, by_track: dict[str, Scores]) -> str:
    """The page of a benchmark."""
    tracks = {"all": whole, **by_track}
    figures = [[name, *map(_estimate, scores.figures.values())] for name, scores in tracks.items()]
    violations = [[name, *_estimates(scores.violations)] for name, scores in tracks.items()]
    time = [[name, *_estimates(scores.shares, ".1f", 100.0)] for name, scores in tracks.items()]
    head = ["track", *SITUATIONS]
    sections = [
        section("By track", table(["track", *whole.FIGURES.values()], figures), note(POLITE)),
        section("By situation: times a minute within 0.45 m, by the robot", table(head, violations)),
        section("By situation: percent of the time", table(head, time)),
    ]
    title = f"{options.policy}: {len(by_track)} tracks, {options.episodes} episodes each"
    return document(title, sections, options)


POLITE = (
    "Politely: without coming within 0.45 m of a person, touching a person or touching an obstacle by the robot's "
    "fault. Events are times an episode. Small: 95 % bootstrap interval over episodes."
)


# ------------------------------------------------------------------ Figure 4


def figure4(options: Figure4Config, results: Results, grids: Figure) -> str:
    """The page of Figure 4.

    Args:
        grids: the figure that ``pictures.grids`` draws.
    """
    claims = [
        [Cell(claim["statement"], kind="text"), claim["paper"], Cell(claim["ours"], kind="ours"), _holds(claim)]
        for claim in results.claims
    ]
    sections = [
        section("Figure 4", figure(svg(grids, "figure4-grids")), note(FIGURE)),
        section("Numbers", *_numbers(results), note(BOOTSTRAP)),
        section("By situation", *_by_situation(results), note(BOOTSTRAP)),
        section("What the paper reports", table(["statement", "paper", "here", "holds"], claims)),
    ]
    if results.training:
        sections.append(section("Training", _training(results.training.items())))
    datasets, trainings, _ = results.sizes
    networks = f"; {datasets * trainings} networks of each learner" if datasets * trainings > 1 else ""
    scenarios = f"{len(BEHAVIORS)} scenarios, {results.episodes} episodes each"
    return document(f"Figure 4: {len(results.policies)} policies in {scenarios}{networks}", sections, options)


def _training(trainings: Iterable[tuple[str, Training]]) -> str:
    rows = []
    for name, row in trainings:
        counts = f"{row['examples']:.0f}", f"{row['entropy']:.3f}", f"{row['epochs']:.0f}", f"{row['best_epoch']:.0f}"
        rows.append([name, *counts, f"{row['loss']:.4f}", f"{row['seconds']:.0f}"])
    head = ["policy", "examples", "entropy of situations", "epochs", "best", "validation loss", "seconds"]
    return table(head, rows)


PAPER = {  # section V-C: means over the three scenarios
    "completed": {"G": "112.7", "H": "112.7"},
    "time_not_moving": {"G": "11", "R": "16.3", "H": "22", "N": "28.7"},
}
FIGURE = (
    "G, R and H learned from demonstrations with the behaviors graph, random and handcrafted; B from those "
    "of G resampled so that all situations are equally frequent. N is social_costmap, for the paper's navigation "
    "stack, and E the demonstrator. Darker is more."
)
BOOTSTRAP = "Small: 95 % bootstrap interval over datasets, training seeds of each, and episodes of each."


def _numbers(results: Results) -> list[str]:
    policies, blocks = results.policies, []
    for name, words in results.MEASURES.items():
        rows: list[list[str | Cell]] = [
            [f"in {behavior}", *(_estimate(results.cells[policy][behavior][name]) for policy in policies)]
            for behavior in BEHAVIORS
        ]
        rows.append([Cell("mean", kind="none"), *(_estimate(results.means[policy][name]) for policy in policies)])
        if name in PAPER:
            rows.append([Cell("paper, mean", kind="none"), *(PAPER[name].get(policy, "") for policy in policies)])
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
        for policy in results.policies
    ]
    balanced = [[f"in {behavior}", *_estimates(row, "+.3f")] for behavior, row in results.balancing.items()]
    measures = [
        [f"in {behavior}", *(_estimate(row[name], "+.2f") for name in results.MEASURES)]
        for behavior, row in results.more.items()
    ]
    return [
        table(["intimate distance violations per episode", *SITUATIONS], rows),
        table(["B minus G, in the same episodes", *SITUATIONS], balanced),
        table(["likewise", *results.MEASURES.values()], measures),
    ]


# ------------------------------------------------------------------ learning curve


def learning_curve(options: LearningCurveConfig, curve: Curve, picture: Figure) -> str:
    """The page of the learning curve of policy G.

    Args:
        picture: as ``pictures.learning_curve`` draws it.
    """
    columns = list(curve.cells[curve.variants[0].name])
    numbers = []
    for name, words in CURVE_MEASURES.items():
        rows = [[each.title, *_row(curve.cells[each.name], columns, name)] for each in curve.variants]
        numbers.append(table([words, *columns], rows))
    differences = []
    for one, other in comparisons(curve.variants):
        cells = curve.differences(one, other)
        rows = [[words, *_row(cells, columns, name, "+.2f")] for name, words in CURVE_MEASURES.items()]
        differences.append(table([f"{one.title} minus {other.title}", *columns], rows))
    verdicts = [
        [Cell(f"{row['variant']} better than {row['other']}: {CURVE_MEASURES[row['measure']]}", kind="text"),
         _estimate(row["difference"], "+.2f"), _holds(row)]
        for row in curve.verdicts
    ]  # fmt: skip
    titles = {each.name: each.title for each in curve.variants}
    sections = [
        section("What more data does", figure(svg(picture, "learning-curve"), CURVE)),
        section("Is it better?", table(["over the three scenarios", "difference", "holds"], verdicts), note(SURE)),
        section("Numbers", *numbers, note(BOOTSTRAP)),
        section("Differences in the same episodes", *differences, note(BOOTSTRAP)),
        section("Training", _training((titles[name], row) for name, row in curve.training.items())),
    ]
    datasets, trainings, each = curve.sizes
    several = f"{datasets} dataset{'s' * (datasets > 1)}, {trainings} network{'s' * (trainings > 1)} on each"
    whole = f"{several}, {datasets * trainings * each} episodes in each cell"
    return document(f"Policy G and its data: {whole}", sections, options)


def _row(cells: Mapping[str, Mapping], columns: Sequence[str], name: str, form: str = ".2f") -> list[Cell]:
    return [_estimate(cells[column][name], form) for column in columns]


CURVE = (
    "Imitation of the demonstrator on the behavior graph, in three scenarios and their mean, by hours of "
    "demonstrations. Bars are 95 % bootstrap intervals over datasets, training seeds of each, and episodes of each; "
    "with few datasets they are too short."
)
SURE = (
    "Below: the share of the resamples in which it holds; at least 97.5 % counts as sure. verdicts.csv and "
    "differences.csv have these numbers."
)
