"""Reports of the experiments: one self-contained HTML page each, with the paper's numbers and ours."""

from __future__ import annotations

import itertools
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
from sean_jax.studies.experiments.measures import MEAN, MEASURES
from sean_jax.studies.experiments.ranks import ALL as ALL_TRACKS
from sean_jax.studies.experiments.scores import FIGURES
from sean_jax.studies.experiments.shares import BEHAVIORS
from sean_jax.web import pages
from sean_jax.web.pages import Cell, figure, note, section, table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from sean_jax.metrics import Estimate
    from sean_jax.studies.experiments.measures import Variant
    from sean_jax.studies.experiments.ranks import Ranking
    from sean_jax.studies.experiments.results_table import Estimates, Table

TEXTS = files.read_yaml(Path(__file__).with_name("captions.yaml"))[1]
PIVOTS = TEXTS["pivots"]
SITUATIONS = [name.replace("_", " ") for name in shares.NAMES]


def document(title: str, sections: list[str], options: ExperimentConfig | BenchmarkConfig) -> str:
    """A page with these sections and one more: the command and the versions that reproduce it."""
    identity = read_identity(options.folder / IDENTITY) or {}
    made_with = identity.get("versions") or versions()  # of the run
    word = "benchmark" if isinstance(options, BenchmarkConfig) else "experiment"
    origin = pages.origin(command(word, options), made_with)
    return pages.page(title, f"sean_jax · {word}", [*sections, origin])


def sections(page: str, blocks: Mapping[str, Sequence[str]], **values: str) -> list[str]:
    """The sections of a page of captions.yaml for which there are blocks; ``values`` stand in titles and notes."""
    built = []
    for layout in TEXTS["pages"][page]:
        parts = list(blocks.get(layout["block"], ()))
        if not parts:
            continue
        if "note" in layout:
            text = TEXTS[layout["note"]].format(**values)
            parts.append(note(text))
        title = layout["title"].format(**values)
        built.append(section(title, *parts))
    return built


KEYS = "policy", "behavior", "scenario", "measure", "situation"  # the order in the labels of estimates
LEVELS = {
    "behavior": dict(zip(BEHAVIORS, BEHAVIORS, strict=True)),
    "scenario": dict(zip((*BEHAVIORS, MEAN), (*BEHAVIORS, MEAN), strict=True)),
    "measure": MEASURES,
    "situation": dict(zip(shares.NAMES, SITUATIONS, strict=True)),
}
"""Column of a table -> label -> title."""


def pivots(
    layouts: Sequence[Mapping[str, Any]], estimates: Estimates, pair: str = "", **levels: Mapping[str, str]
) -> list[str]:
    """The tables of estimates that layouts describe, as those of captions.yaml do.

    Args:
        levels: column -> label -> title, besides ``LEVELS``.
    """
    titles = LEVELS | levels
    tables = []
    for layout in layouts:
        columns = titles[layout["columns"]]
        outer = layout["rows"]
        lines = []
        for labels in itertools.product(*(titles[column] for column in outer)):
            row = dict(zip(outer, labels, strict=True))
            if "title" in layout:
                title = layout["title"].format(**row)
            else:
                title = titles[outer[0]][labels[0]]
            lines.append([title, *_pivot_cells(estimates, layout, columns, row)])

        # Below the rows: our mean, and the paper's.
        if "mean" in layout:
            means = _pivot_cells(estimates, layout, columns, {"behavior": MEAN})
            lines.append([Cell("mean", kind="none"), *means])
        if "paper" in layout:
            numbers = [layout["paper"].get(label, "") for label in columns]
            lines.append([Cell("paper, mean", kind="none"), *numbers])

        if "head" in layout:
            head = layout["head"].format(pair=pair)
        else:
            head = MEASURES[layout["where"]["measure"]]
        tables.append(table([head, *columns.values()], lines))
    return tables


def _pivot_cells(
    estimates: Estimates, layout: Mapping[str, Any], columns: Collection[str], row: Mapping[str, str]
) -> list[str | Cell]:
    """The estimates of a row; what ``missing`` says, if anything, where there is no episode."""
    form = layout.get("form", ".2f")
    scale = layout.get("scale", 1.0)
    cells = []
    for column in columns:
        labels = {**layout.get("where", {}), **row, layout["columns"]: column}
        value = estimates[tuple(labels[key] for key in KEYS if key in labels)]
        cell = _estimate(value, form, scale)
        cells.append(cell if value.episodes else layout.get("missing", cell))
    return cells


def _interval(mean: float, low: float, high: float, form: str = ".2f", scale: float = 1.0) -> Cell:
    """A mean with its 95 % interval."""
    middle = f"{scale * mean:{form}}"
    ends = f"{scale * low:{form}} – {scale * high:{form}}"
    return Cell(middle, ends, "ours")


def _estimate(value: Estimate, form: str = ".2f", scale: float = 1.0) -> Cell:
    return _interval(float(value.mean), float(value.low), float(value.high), form, scale)


def _holds(test: Mapping[str, Any]) -> Cell:
    """Whether a statement holds, and in which share of the resamples."""
    share = test["share"]
    sure = share >= 0.975 or share <= 0.025
    answer = "yes" if test["holds"] else "no"
    if not sure:
        answer = f"perhaps {answer}"
    return Cell(answer, f"{100 * share:.1f} %")


def _table(head: Sequence[str], rows: Sequence[Sequence[str | Cell]]) -> list[str]:
    """A table; nothing without rows."""
    if not rows:
        return []
    return [table(head, rows)]


def _figures(samples: np.ndarray) -> np.ndarray:
    """(1 + R, 7) shares of flags, none, and entropy, of (1 + R, 6) shares of examples."""
    return np.column_stack([shares.counted(samples), samples[:, 5], shares.entropy(samples)])


COLUMNS = (*shares.NAMES, shares.NONE, "entropy")
TITLES = (*SITUATIONS, "none", "entropy")


def _scale(name: str) -> tuple[str, float]:
    """How a figure is written, and the factor before: an entropy, or a share in percent."""
    return (".3f", 1.0) if name == "entropy" else (".1f", 100.0)


# ------------------------------------------------------------------ Table I


def table1(
    options: Table1Config,
    measured: Table,
    figures: Mapping[str, Figure],
    compared: list[dict[str, Any]],
    real: Table,
    driven: Table,
) -> str:
    """The page of Table I.

    Args:
        measured: rows of ``shares.chain_rows``.
        figures: by name, as ``pictures.table1`` draws them.
        compared: of ``shares.hours``.
        real: rows of ``shares.count_recording``.
        driven: rows of ``demonstrations.examples``.
    """
    speed = number(options.speeds[0])
    cells = shares.chain_shares(measured.where(speed=speed), CELL)
    demonstrated = shares.people_shares(driven, CELL)
    by_policy = shares.by_policy(cells)
    if len(demonstrated) == len(BEHAVIORS) and len(driven.levels("policy")) == 1:
        by_policy = shares.by_policy(demonstrated) | by_policy

    captions = {"table1-bars": TEXTS["bars"]}
    blocks = {}
    for name, picture in figures.items():
        blocks[name] = [figure(svg(picture, name), captions.get(name, ""))]
    if cells:
        blocks["table1-bars"].append(pages.legend(dict(zip(SITUATIONS, pictures.shades(), strict=True))))
    blocks["shares"] = _shares(cells, measured)
    blocks["hours"] = _hours(compared)
    blocks["demonstrated"] = _shares(demonstrated, driven)
    blocks["recorded"] = _recorded(real)
    blocks["more"] = _more(measured, real)
    blocks["orderings"] = _orderings(by_policy)

    title = f"Table I: social situations in {'recordings' if len(real) else 'demonstrations'}"
    if cells:
        minutes = 60.0 * options.hours * options.seeds
        title = f"Table I: social situations in {number(minutes)} minutes of each behavior and policy"
    return document(title, sections("table1", blocks, speed=speed), options)


CELL = "policy", "behavior", "people"  # columns of the labels


def _shares(cells: shares.Shares, measured: Table) -> list[str]:
    """A table for each policy: shares and entropy, and the paper's, by behavior."""
    ended = measured.where(measure=shares.COMPLETED).groups(CELL)
    tables = []
    for policy in dict.fromkeys(policy for policy, *_ in cells):
        rows = []
        for labels, samples in cells.items():
            if labels[0] != policy:
                continue
            behavior = labels[1]
            completed = ended[labels].value
            episodes = f"{int(completed.sum())} of {len(completed)}"
            rows.append([behavior, *_shares_of_flags(samples), episodes])

            paper = shares.paper()[behavior]
            numbers = [f"{100 * value:.2f}" for value in paper]
            entropy = f"{shares.normalised_entropy(paper):.3f}"
            rows.append([Cell("paper", kind="none"), *numbers, "", entropy, ""])
        tables.append(table([policy, *TITLES, "completed"], rows))
    return tables


def _hours(compared: list[dict[str, Any]]) -> list[str]:
    """A table for each policy: the paper's figures, and the interval of an hour of the policy."""
    tests = {(test["policy"], test["behavior"], test["figure"]): test for test in compared}

    tables = []
    for policy in dict.fromkeys(policy for policy, *_ in tests):
        rows = []
        for behavior in BEHAVIORS:
            row: list[str | Cell] = [behavior]
            for name in (*shares.NAMES, "entropy"):
                row.append(_hour(tests[policy, behavior, name], name))
            rows.append(row)
        tables.append(table([policy, *SITUATIONS, "entropy"], rows))
    return tables


def _hour(test: Mapping[str, Any], name: str) -> Cell:
    """The paper's figure of a name, and the interval of an hour: bold where they differ."""
    form, scale = _scale(name)
    ours = _interval(test["mean"], test["low"], test["high"], form, scale)
    printed = f"{scale * test['paper']:{form}}"
    kind = "ours" if test["holm"] < 0.05 else ""
    return ours._replace(text=f"{printed} ({ours.text})", kind=kind)


def _shares_of_flags(samples: np.ndarray) -> list[str | Cell]:
    """Columns of the paper's situations, in brackets their shares of the examples; of none; and of the entropy."""
    columns = _percents(shares.counted(samples))
    for k, cell in enumerate(columns):
        if isinstance(cell, Cell):
            examples = f"{100 * samples[0, k]:.1f}"
            columns[k] = cell._replace(text=f"{cell.text} ({examples})")
    none = f"{100 * samples[0, 5]:.1f}"
    entropy = shares.entropy(samples)
    low, high = shares.interval(entropy)
    return [*columns, none, _interval(entropy[0], float(low), float(high), ".3f")]


def _percents(samples: np.ndarray) -> list[str | Cell]:
    """Percent of an estimate and its resamples (1 + R, K); "" of situations that cannot occur."""
    numbers = zip(samples[0], *shares.interval(samples), strict=True)
    return ["" if np.isnan(row[0]) else _interval(*row, ".1f", 100.0) for row in numbers]


def _recorded(real: Table) -> list[str]:
    rows = []
    for labels, samples in shares.people_shares(real, ("behavior", "people", "speed")).items():
        recording, people, speed = labels
        rows.append([f"{recording}, V = {speed} m/s", *_shares_of_flags(samples), f"{people}"])
    return _table(["", *TITLES, "people"], rows)


def _more(measured: Table, real: Table) -> list[str]:
    """Situations beyond the paper's five."""
    names = tuple(MORE_SITUATIONS)
    further = {}
    for (policy, behavior, _), samples in shares.chain_shares(measured, CELL, names).items():
        further[f"{behavior} · {policy}"] = samples
    for (recording, _), samples in shares.people_shares(real, ("behavior", "speed"), names).items():
        further[recording] = samples

    rows = [[title, *_percents(samples)] for title, samples in further.items()]
    titles = [name.replace("_", " ") for name in names]
    return _table(["", *titles], rows)


def _orderings(by_policy: dict[str, dict[str, np.ndarray]]) -> list[str]:
    rows = []
    for first, *others in zip(*map(shares.orderings, by_policy.values()), strict=True):
        words = [first["name"], Cell(first["statement"], kind="text"), first["source"]]
        rows.append([*words, *map(_holds, (first, *others))])
    return _table(["", "statement", "", *by_policy], rows)


# ------------------------------------------------------------------ ablation


def ablation(options: AblationConfig, tables: shares.Tables, references: Mapping[str, str], picture: Figure) -> str:
    """The page of Table I in several worlds.

    Args:
        references: world -> the world that it is compared with; the default has itself.
        picture: as ``pictures.ablation`` draws it.
    """
    policies = list(next(iter(tables.values())))
    blocks = {
        "picture": [figure(svg(picture, "ablation"), TEXTS["moved"])],
        "orderings": [_changed_orderings(tables, references, policy) for policy in policies],
        "worlds": [_worlds(tables, references, behavior, policy) for policy in policies for behavior in BEHAVIORS],
    }
    return document("Table I: which of SEAN's conditions moves what", sections("ablation", blocks), options)


def _worlds(tables: shares.Tables, references: Mapping[str, str], behavior: str, policy: str) -> str:
    """The paper's shares, and those of each world: bold where they differ from the reference's."""
    figures = {world: _figures(by_policy[policy][behavior]) for world, by_policy in tables.items()}
    paper = shares.paper()[behavior]
    numbers = [f"{100 * value:.1f}" for value in paper]
    entropy = f"{shares.normalised_entropy(paper):.3f}"
    rows: list[list[str | Cell]] = [[Cell("paper", kind="none"), *numbers, "", entropy]]
    for world, samples in figures.items():
        low, high = shares.interval(samples)
        below, above = shares.interval(samples - figures[references[world]])
        cells = []
        for k, name in enumerate(COLUMNS):
            beyond_chance = not below[k] <= 0.0 <= above[k]
            moved = world != references[world] and beyond_chance
            form, scale = _scale(name)
            cell = _interval(samples[0, k], low[k], high[k], form, scale)
            cells.append(cell._replace(kind="ours" if moved else ""))
        rows.append([world, *cells])
    return table([f"{behavior} · {policy}", *TITLES], rows)


def _changed_orderings(tables: shares.Tables, references: Mapping[str, str], policy: str) -> str:
    """In how many percent of the resamples each ordering holds: bold where a switch reverses it."""
    by_world = {world: shares.orderings(by_policy[policy]) for world, by_policy in tables.items()}
    rows = []
    for k, ordering in enumerate(shares.ORDERINGS):
        cells = []
        for world, tests in by_world.items():
            share = tests[k]["share"]
            reference = by_world[references[world]][k]["share"]
            low, high = sorted((share, reference))
            reversed_by_switch = low <= 0.025 and high >= 0.975
            cells.append(Cell(f"{100 * share:.0f}", kind="ours" if reversed_by_switch else ""))
        rows.append([ordering.name, Cell(ordering.statement, kind="text"), *cells])
    return table([policy, "statement", *tables], rows)


# ------------------------------------------------------------------ benchmark


def benchmark(
    options: BenchmarkConfig,
    whole: Estimates,
    by_group: dict[str, Estimates],
    by_track: dict[str, Estimates],
    skipped: str,
) -> str:
    """The page of a benchmark.

    Args:
        skipped: a sentence on tracks that are left out, or "".
    """
    groups = {"all": whole, **by_group}
    tracks = {"all": whole, **by_track}
    blocks = {}
    for name in ("groups", "tracks", "violations", "time"):
        members = groups if name == "groups" else tracks
        estimates = {}
        for track, scores in members.items():
            estimates |= {(track, *labels): value for labels, value in scores.items()}
        behaviors = {track: track for track in members}
        blocks[name] = pivots(PIVOTS[name], estimates, behavior=behaviors, measure=FIGURES)
    if skipped:
        blocks["groups"].append(note(skipped))
    title = f"{options.policy}: {len(by_track)} tracks, {options.episodes} episodes each"
    return document(title, sections("benchmark", blocks), options)


def ranking(options: BenchmarkRankConfig, ranks: Ranking, figures: dict[str, Figure]) -> str:
    """The page of a ranking.

    Args:
        figures: class of sensing -> the figure that ``pictures.situations`` draws.
    """
    classes = []
    for sensing, rows in ranks.by_class().items():
        table_rows = []
        for row in rows:
            policy = Cell(row.entry.name, kind="text")
            table_rows.append([row.rank, policy, row.seeds, *map(_estimate, row.of.values())])
        parts = [table(["rank", "policy", "seeds", *ranks.groups], table_rows)]

        pairs = []
        for pair in ranks.pairs:
            if pair.sensing == sensing:
                names = Cell(f"{pair.second} - {pair.first}", kind="text")
                pairs.append([names, _interval(*pair.difference), f"{pair.p:.2g}"])
        if pairs:
            parts.append(table(["difference", "politely completed, % points", "p"], pairs))

        picture = svg(figures[sensing], f"ranking-{sensing}")
        parts.append(figure(picture, TEXTS["ranked_situations"]))
        classes.append(section(f"{sensing}: {SENSING[sensing]}", *parts))
    notes = [TEXTS["ranked"], *ranks.notes]
    classes.append(section("How ranks are made", *map(note, notes)))
    title = f"Ranking of {len(ranks.rows)} policies on {len(ranks.groups[ALL_TRACKS])} tracks"
    words = command("benchmark", options)
    return pages.page(title, "sean_jax · benchmark", [*classes, pages.origin(words, versions())])


# ------------------------------------------------------------------ Figure 4


def figure4(
    options: Figure4Config,
    policies: Sequence[str],
    estimates: Estimates,
    contrasts: list[dict[str, Any]],
    claims: list[dict[str, Any]],
    training: Mapping[str, dict[str, float]],
    grids: Figure,
    driven: Table,
) -> str:
    """The page of Figure 4.

    Args:
        estimates: of ``measures.figure4_estimates``.
        contrasts, claims: of the functions of these names in ``measures``.
        training: policy -> means over its networks.
        grids: the figure that ``pictures.grids`` draws.
        driven: rows of ``demonstrations.examples``.
    """
    titles = dict(zip(policies, policies, strict=True))
    blocks = {
        "picture": [figure(svg(grids, "figure4-grids"))],
        "numbers": pivots(PIVOTS["numbers"], estimates, policy=titles),
        "by_situation": pivots(PIVOTS["by_situation"], estimates, policy=titles),
        "contrasts": [_contrasts(contrasts)],
        "claims": [_claims(claims)],
        "driven": _driven(driven),
        "training": [_training(training)],
    }
    count = options.datasets * options.trainings
    networks = f"; {count} networks of each learner" if count > 1 else ""
    episodes = count * math.ceil(options.episodes / count)
    scenarios = f"{len(BEHAVIORS)} scenarios, {episodes} episodes each"
    title = f"Figure 4: {len(policies)} policies in {scenarios}{networks}"
    return document(title, sections("figure4", blocks), options)


def _driven(driven: Table) -> list[str]:
    """Episodes of demonstrations, and how many were completed."""
    ended = driven.where(measure=shares.COMPLETED).groups(["behavior", "policy"])
    rows = []
    for labels, episodes in ended.items():
        rows.append([*labels, f"{len(episodes)}", f"{int(episodes.value.sum())}"])
    return _table(["people", "driver", "episodes", "completed"], rows)


def _claims(claims: list[dict[str, Any]]) -> str:
    rows = []
    for claim in claims:
        whose = "ours" if claim["paper"] == "not reported" else "paper"
        statement = Cell(claim["statement"], kind="text")
        ours = Cell(claim["ours"], kind="ours")
        rows.append([statement, whose, claim["paper"], ours, _holds(claim)])
    return table(["statement", "whose", "paper", "here", "holds"], rows)


def _contrasts(contrasts: list[dict[str, Any]]) -> str:
    """A row for each pair of policies, a column for each measure."""
    tests = {(test["one"], test["other"], test["measure"]): test for test in contrasts}

    def cell(pair: tuple[str, str], measure: str) -> Cell:
        test = tests[*pair, measure]
        difference = _estimate(test["difference"], "+.3g")
        p = test["holm"]
        small = difference.small
        if not math.isnan(p):
            small += f", d {test['effect']:+.2f}, p {p:.2g}"
        return difference._replace(small=small, kind="ours" if p < 0.05 else "")

    rows = []
    for pair in dict.fromkeys((one, other) for one, other, _ in tests):
        cells = [cell(pair, measure) for measure in MEASURES]
        rows.append([" − ".join(pair), *cells])
    return table(["", *MEASURES.values()], rows)


TRAINING = {
    "examples": ("examples", ".0f"),
    "entropy": ("entropy of situations", ".3f"),
    "epochs": ("epochs", ".0f"),
    "best_epoch": ("best", ".0f"),
    "loss": ("validation loss", ".4f"),
    "seconds": ("seconds", ".0f"),
}
"""Number of a training -> its title and form."""


def _training(training: Mapping[str, dict[str, float]]) -> str:
    rows = []
    for name, means in training.items():
        numbers = [f"{means[key]:{form}}" for key, (_, form) in TRAINING.items()]
        rows.append([name, *numbers])
    return table(["policy", *(title for title, _ in TRAINING.values())], rows)


# ------------------------------------------------------------------ learning curve


def learning_curve(
    options: LearningCurveConfig,
    variants: Sequence[Variant],
    estimates: Estimates,
    differences: Mapping[tuple[Variant, Variant], Estimates],
    verdicts: list[dict[str, Any]],
    training: Mapping[str, dict[str, float]],
    picture: Figure,
) -> str:
    """The page of the learning curve of policy G.

    Args:
        estimates: (variant, behavior, measure) -> estimate.
        differences: pair of variants -> (behavior, measure) -> difference.
        verdicts: of ``learning_curve.verdicts``.
        training: variant -> means over its networks.
        picture: as ``pictures.learning_curve`` draws it.
    """
    titles = {variant.name: variant.title for variant in variants}
    rows = []
    for verdict in verdicts:
        words = f"{verdict['variant']} better than {verdict['other']}: {MEASURES[verdict['measure']]}"
        rows.append([Cell(words, kind="text"), _estimate(verdict["difference"], "+.2f"), _holds(verdict)])
    by_pair = []
    for (one, other), gaps in differences.items():
        by_pair += pivots(PIVOTS["differences"], gaps, f"{one.title} minus {other.title}")
    blocks = {
        "picture": [figure(svg(picture, "learning-curve"), TEXTS["curve"])],
        "better": [table(["over the three scenarios", "difference", "holds"], rows)],
        "numbers": pivots(PIVOTS["learning_curve"], estimates, policy=titles),
        "differences": by_pair,
        "training": [_training({titles[name]: means for name, means in training.items()})],
    }
    datasets = options.datasets
    trainings = options.trainings
    count = datasets * trainings
    networks = f"{datasets} dataset{'s' * (datasets > 1)}, {trainings} network{'s' * (trainings > 1)} on each"
    episodes = count * math.ceil(options.episodes / count)
    title = f"Policy G and its data: {networks}, {episodes} episodes in each cell"
    return document(title, sections("learning_curve", blocks), options)
