"""Reports of the experiments: one self-contained HTML page each, with the paper's numbers beside ours."""

from __future__ import annotations

import html as markup
from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np

import sean_jax.report as reports
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
from sean_jax.studies.experiments import parts, pictures, shares
from sean_jax.studies.experiments.shares import BEHAVIORS
from sean_jax.studies.experiments.variants import MEASURES, comparisons
from sean_jax.versions import versions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from sean_jax.metrics import Estimate
    from sean_jax.studies.experiments.benchmark import Scores
    from sean_jax.studies.experiments.claims import Claim, Results, Training
    from sean_jax.studies.experiments.recorded import Recorded
    from sean_jax.studies.experiments.shares import Ordering
    from sean_jax.studies.experiments.table1 import Cell
    from sean_jax.studies.experiments.variants import Curve, Verdict

STYLE = "td:nth-child(2){font-weight:400}td.ours{font-weight:650}td.text,th.text{text-align:left;white-space:normal}"


def document(
    title: str, kicker: str, sections: list[tuple[str, str]], options: ExperimentConfig | BenchmarkConfig
) -> str:
    """A page with these sections and one more: the command and the versions that reproduce it.

    Returns:
        HTML without references to other files.
    """
    origin = (parts.load(options.folder / parts.OPTIONS) or {}).get("versions") or versions()  # of the run
    word = "benchmark" if isinstance(options, BenchmarkConfig) else "experiment"
    again = f"<pre>{markup.escape(command(word, options))}</pre>"
    facts = "".join(f"<dt>{markup.escape(k)}</dt><dd>{markup.escape(str(v))}</dd>" for k, v in origin.items())
    sections = [*sections, ("How to get this again", again + f"<dl>{facts}</dl>")]
    body = (f"<section><h2>{name}</h2>\n{text}</section>" for name, text in sections)
    return reports.page(title, kicker, body, STYLE)


def _cell(text: str, small: str = "", kind: str = "") -> str:
    note = f"<small>{small}</small>" if small else ""
    return f"<td{f' class={kind}' if kind else ''}>{text}{note}</td>"


def _table(head: list[str], rows: list[str]) -> str:
    first = "".join(f"<th>{name}</th>" for name in head)
    return f"<div class=wide><table><thead><tr>{first}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"


def table1(options: Table1Config, cells: list[Cell], figures: dict[str, Figure], real: list[Recorded]) -> str:
    """The page of Table I.

    Args:
        figures: by name, as ``pictures.table1`` draws them.
    """
    policies = list(dict.fromkeys(cell.policy for cell in cells))
    speed = options.speeds[0]
    html = {name: pictures.embed(figure, name) for name, figure in figures.items()}
    sections = []
    if cells:
        sections = [
            ("Table I", html["table1-bars"] + BARS + _legend()),
            (f"Shares at V = {number(speed)} m/s", "".join(_shares(cells, policy) for policy in policies) + COUNTED),
        ]
    if real:
        sections.append(("Recorded people", _recorded(options, real) + RECORDED))
    sections.append(("Beyond the five", _further(cells, policies, real) + FURTHER))
    if cells:
        sections.append(("Orderings of the paper", _orderings(cells, policies, speed)))
    if "table1-speeds" in html:
        sections.append(("When does one count as walking?", html["table1-speeds"] + SPEEDS))
    if "table1-crowds" in html:
        sections.append(("How many people?", html["table1-crowds"]))
    minutes = 60.0 * options.hours * options.seeds
    title = f"Table I: social situations in {number(minutes)} minutes of each behavior and policy"
    title = title if cells else "Table I: social situations in recordings"
    return document(title, "sean_jax · experiment", sections, options)


BARS = "<figcaption>Dashed: the paper's Table I.</figcaption>"
COUNTED = (
    "<p class=note>Percent of all flags: an example, one a second, has a flag for each situation that holds. In "
    "brackets, percent of the examples; <i>none</i> are the examples without a flag. Small: the middle 95 % of a "
    "bootstrap over minutes. Entropy is over ln 5. The paper's rows are divided by their sum.</p>"
)
FURTHER = (
    "<p class=note>Percent of the examples; several situations can hold at once. Urgency and the configuration of "
    "objects are factors that the paper names for later (VI). No figure: the recording does not tell where objects "
    "are.</p>"
)
RECORDED = (
    "<p class=note>Each person in turn plays the robot, in every row of the recording; counted as in Table I. Without "
    "companions: whoever walks in one group with that person is left out. Small: the middle 95 % of a bootstrap over "
    "these people. No figure: the recording does not tell groups in conversation.</p>"
)
SPEEDS = (
    "<p class=note>The paper counts people as walking above 1.4 m/s. SEAN 2.0's code uses 0.4 m/s, and its people walk "
    "at 0.6 m/s. People here prefer 1.34 ± 0.26 m/s.</p>"
)


def _legend() -> str:
    dots = "".join(
        f'<li><i class=dot style="background:{color}"></i>{name.replace("_", " ")}</li>'
        for name, color in zip(shares.NAMES, pictures.shades(), strict=True)
    )
    return f"<ul class=legend>{dots}</ul>"


def _shares(cells: list[Cell], policy: str) -> str:
    rows = []
    for cell in (cell for cell in cells if cell.policy == policy):
        ended = int(cell.ended.sum())
        rows.append(f"<tr><td>{cell.behavior}</td>{_figures(cell.shares())}{_cell(f'{cell.ended[0]} of {ended}')}</tr>")
        reference = shares.paper()[cell.behavior]
        theirs = "".join(_cell(f"{100 * value:.2f}") for value in reference)
        rows.append(
            f"<tr><td class=none>paper</td>{theirs}<td></td>"
            f"{_cell(f'{shares.normalised_entropy(reference):.3f}')}<td></td></tr>"
        )
    head = [policy, *(name.replace("_", " ") for name in shares.NAMES), "none", "entropy", "completed"]
    return _table(head, rows)


def _figures(estimate: shares.Shares, known: Collection[str] = shares.NAMES) -> str:
    """Columns of the paper's situations, none, and entropy."""
    flags, examples, entropy = estimate.of("flags"), estimate.of("examples"), estimate.entropy()
    low, high = shares.interval(flags)
    ends = shares.interval(entropy)
    columns = [
        _cell(f"{100 * flags[0, k]:.1f} ({100 * examples[0, k]:.1f})",
              f"{100 * low[k]:.1f} – {100 * high[k]:.1f}", "ours")
        if name in known else _cell("")
        for k, name in enumerate(shares.NAMES)
    ]  # fmt: skip
    columns.append(_cell(f"{100 * estimate.none[0]:.1f}"))
    return "".join(columns) + _cell(f"{entropy[0]:.3f}", f"{ends[0]:.3f} – {ends[1]:.3f}", "ours")


def _recorded(options: Table1Config, real: list[Recorded]) -> str:
    rows = [
        f"<tr><td>{markup.escape(each.name)}, V = {number(speed)} m/s</td>{_figures(each.shares(index), each.known)}"
        f"{_cell(f'{each.people}')}</tr>"
        for each in real
        for index, speed in enumerate(options.speeds)
    ]
    names = (name.replace("_", " ") for name in shares.NAMES)
    return _table(["", *names, "none", "entropy", "people"], rows)


def _further(cells: list[Cell], policies: list[str], real: list[Recorded]) -> str:
    names = list(MORE_SITUATIONS)
    found = [
        (f"{cell.behavior} · {cell.policy}", cell.further(), names)
        for policy in policies
        for cell in cells
        if cell.policy == policy
    ]
    found += [(each.name, each.further(), each.known) for each in real]
    rows = []
    for title, estimate, known in found:
        low, high = shares.interval(estimate.examples)
        columns = [
            _cell(f"{100 * estimate.examples[0, k]:.1f}", f"{100 * low[k]:.1f} – {100 * high[k]:.1f}", "ours")
            if name in known else _cell("")
            for k, name in enumerate(names)
        ]  # fmt: skip
        rows.append(f"<tr><td>{markup.escape(title)}</td>{''.join(columns)}</tr>")
    return _table(["", *(name.replace("_", " ") for name in names)], rows)


def _orderings(cells: list[Cell], policies: list[str], speed: float) -> str:
    rows = []
    by_policy = {}
    for policy in policies:
        by_policy[policy] = shares.orderings({cell.behavior: cell.shares() for cell in cells if cell.policy == policy})
    for index, first in enumerate(by_policy[policies[0]]):
        values = "".join(_cell(*_verdict(by_policy[policy][index])) for policy in policies)
        kind = "hard" if first["hard"] else "soft"
        rows.append(f"<tr><td>{first['name']}</td><td class=text>{markup.escape(first['statement'])}</td>"
                    f"<td>{kind}</td>{values}</tr>")  # fmt: skip
    note = (
        f"<p class=note>At V = {number(speed)} m/s, shares of flags. Below: in how many of the resamples it holds; "
        "at least 97.5 % is counted as surely. orderings.csv has the other speeds and ways of counting.</p>"
    )
    return _table(["", "statement", "", *policies], rows) + note


def _verdict(row: Claim | Ordering | Verdict) -> tuple[str, str]:
    sure = row["share"] >= 0.975 or row["share"] <= 0.025
    return ("" if sure else "perhaps ") + ("yes" if row["holds"] else "no"), f"{100 * row['share']:.1f} %"


def ablation(options: AblationConfig, by_world: dict[str, list[Cell]], figure: Figure) -> str:
    """The page of Table I in several worlds.

    Args:
        by_world: world -> cells of each policy and behavior, the world that others are compared with first.
        figure: as ``pictures.ablation`` draws it.
    """
    policies = list(dict.fromkeys(cell.policy for cells in by_world.values() for cell in cells))
    tables = [
        _table([f"{behavior} · {policy}", *(name.replace("_", " ") for name in shares.NAMES), "none", "entropy"],
               _worlds(by_world, behavior, policy))
        for policy in policies
        for behavior in BEHAVIORS
    ]  # fmt: skip
    sections = [
        ("What each switch moves", pictures.embed(figure, "ablation") + MOVED),
        ("Orderings of the paper", "".join(_decided(by_world, policy) for policy in policies) + DECIDED),
        ("Shares", "".join(tables) + WORLDS),
    ]
    return document("Table I: which of SEAN's conditions moves what", "sean_jax · experiment", sections, options)


MOVED = (
    "<figcaption>Points by which shares of flags differ from those of the default world, means over the policies. A "
    "row is that world with one switch, the last with all of them.</figcaption>"
)
DECIDED = (
    "<p class=note>In how many percent of the resamples an ordering holds, by shares of flags. Bold: the switch "
    "decides otherwise than the default world, each with 97.5 % or more. orderings.csv has the other ways of "
    "counting.</p>"
)
WORLDS = (
    "<p class=note>Percent of all flags; none: percent of the examples without a flag. Small: the middle 95 % of a "
    "bootstrap over minutes. Bold: the interval of the difference from the default world does not hold 0.</p>"
)


def _worlds(by_world: dict[str, list[Cell]], behavior: str, policy: str) -> list[str]:
    found = {
        world: next(cell.shares() for cell in cells if (cell.behavior, cell.policy) == (behavior, policy))
        for world, cells in by_world.items()
    }
    columns = {world: _columns(each) for world, each in found.items()}
    first = next(iter(columns.values()))
    reference = shares.paper()[behavior]
    theirs = [*(f"{100 * value:.1f}" for value in reference), "", f"{shares.normalised_entropy(reference):.3f}"]
    rows = [f"<tr><td class=none>paper</td>{''.join(map(_cell, theirs))}</tr>"]
    for world, samples in columns.items():
        low, high = shares.interval(samples)
        below, above = shares.interval(samples - first)
        cells = []
        for k, value in enumerate(samples[0]):
            scale, form = (1.0, ".3f") if k == len(shares.NAMES) + 1 else (100.0, ".1f")
            moved = world != next(iter(columns)) and not below[k] <= 0.0 <= above[k]
            ends = f"{scale * low[k]:{form}} – {scale * high[k]:{form}}"
            cells.append(_cell(f"{scale * value:{form}}", ends, "ours" if moved else ""))
        rows.append(f"<tr><td>{markup.escape(world)}</td>{''.join(cells)}</tr>")
    return rows


def _columns(estimate: shares.Shares) -> np.ndarray:
    """(1 + R, 7) shares of flags, none, and entropy."""
    return np.concatenate([estimate.of("flags"), estimate.none[:, None], estimate.entropy()[:, None]], axis=1)


def _decided(by_world: dict[str, list[Cell]], policy: str) -> str:
    told = {
        world: shares.orderings({cell.behavior: cell.shares() for cell in cells if cell.policy == policy})
        for world, cells in by_world.items()
    }
    first = next(iter(told.values()))
    rows = []
    for index, row in enumerate(first):
        cells = []
        for each in told.values():
            share = each[index]["share"]
            other = min(share, row["share"]) <= 0.025 and max(share, row["share"]) >= 0.975
            cells.append(_cell(f"{100 * share:.0f}", "", "ours" if other else ""))
        rows.append(
            f"<tr><td>{row['name']}</td><td class=text>{markup.escape(row['statement'])}</td>{''.join(cells)}</tr>"
        )
    return _table([policy, "statement", *map(markup.escape, told)], rows)


def benchmark(options: BenchmarkConfig, whole: Scores, by_track: dict[str, Scores]) -> str:
    """The page of a benchmark."""
    tracks = {"all": whole, **by_track}
    figures = [
        f"<tr><td>{name}</td>{''.join(_between(each) for each in found.figures.values())}</tr>"
        for name, found in tracks.items()
    ]
    names = [name.replace("_", " ") for name in shares.NAMES]
    situations = [_in_situations(name, found.violations) for name, found in tracks.items()]
    time = [
        _in_situations(name, found.shares._replace(**{end: 100.0 * getattr(found.shares, end) for end in ENDS}), ".1f")
        for name, found in tracks.items()
    ]
    sections = [
        ("By track", _table(["track", *whole.FIGURES.values()], figures) + POLITE),
        ("By situation: times a minute within 0.45 m, by the robot", _table(["track", *names], situations)),
        ("By situation: percent of the time", _table(["track", *names], time)),
    ]
    title = f"{options.policy}: {len(by_track)} tracks, {options.episodes} episodes each"
    return document(title, "sean_jax · benchmark", sections, options)


ENDS = "mean", "low", "high"
POLITE = (
    "<p class=note>Politely: without coming within 0.45 m of somebody, touching them or touching an obstacle by the "
    "robot's fault. Events are times an episode. Small: the middle 95 % of a bootstrap over episodes.</p>"
)


def figure4(options: Figure4Config, results: Results, grids: Figure) -> str:
    """The page of Figure 4.

    Args:
        grids: the figure that ``pictures.grids`` draws.
    """
    sections = [
        ("Figure 4", pictures.embed(grids, "figure4-grids") + FIGURE),
        ("Numbers", _numbers(results)),
        ("By situation", _by_situation(results)),
        ("What the paper reports", _claims(results)),
    ]
    if results.training:
        sections.append(("Training", _training(results.training)))
    datasets, trainings, _ = results.sizes
    networks = f"; {datasets * trainings} networks of each learner" if datasets * trainings > 1 else ""
    scenarios = f"{len(BEHAVIORS)} scenarios, {results.episodes} episodes each"
    title = f"Figure 4: {len(results.policies)} policies in {scenarios}{networks}"
    return document(title, "sean_jax · experiment", sections, options)


def _training(by_policy: dict[str, Training]) -> str:
    rows = []
    for name, row in by_policy.items():
        values = f"{row['examples']:.0f}", f"{row['entropy']:.3f}", f"{row['epochs']:.0f}", f"{row['best_epoch']:.0f}"
        values = *values, f"{row['loss']:.4f}", f"{row['seconds']:.0f}"
        rows.append(f"<tr><td>{name}</td>{''.join(map(_cell, values))}</tr>")
    head = ["policy", "examples", "entropy of situations", "epochs", "best", "loss in validation", "seconds"]
    return _table(head, rows)


PAPER = {  # section V-C: means over the three scenarios
    "completed": {"G": "112.7", "H": "112.7"},
    "time_not_moving": {"G": "11", "R": "16.3", "H": "22", "N": "28.7"},
}
FIGURE = (
    "<p class=note>G, R and H learned from demonstrations among people of the behavior graph, at random and "
    "handcrafted, B from those of G drawn so that all situations are equally frequent; N is social_costmap, for the "
    "paper's navigation stack, E the demonstrator. Darker is more.</p>"
)
BOOTSTRAP = (
    "<p class=note>Small: the middle 95 % of a bootstrap over datasets, seeds of training of each, and episodes of "
    "each.</p>"
)


def _numbers(results: Results) -> str:
    tables = []
    for name, words in results.MEASURES.items():
        rows = []
        for behavior in BEHAVIORS:
            values = "".join(_between(results.cells[policy][behavior][name]) for policy in results.policies)
            rows.append(f"<tr><td>in {behavior}</td>{values}</tr>")
        mean = "".join(_between(results.means[policy][name]) for policy in results.policies)
        rows.append(f"<tr><td class=none>mean</td>{mean}</tr>")
        if name in PAPER:
            theirs = "".join(_cell(PAPER[name].get(policy, "")) for policy in results.policies)
            rows.append(f"<tr><td class=none>paper, mean</td>{theirs}</tr>")
        tables.append(_table([words, *results.policies], rows))
        if name == "time_not_moving":
            tables.append(_table(["the same, of completed tasks", *results.policies], _waiting(results)))
    return "".join(tables) + BOOTSTRAP


def _between(cell: Estimate, form: str = ".2f") -> str:
    return _cell(f"{cell.mean:{form}}", f"{cell.low:{form}} – {cell.high:{form}}", "ours")


def _waiting(results: Results) -> list[str]:
    rows = []
    for behavior in BEHAVIORS:
        cells = (results.waiting[policy][behavior] for policy in results.policies)
        values = "".join(_between(cell) if cell.episodes else _cell("-") for cell in cells)
        rows.append(f"<tr><td>in {behavior}</td>{values}</tr>")
    return rows


def _by_situation(results: Results) -> str:
    names = [name.replace("_", " ") for name in shares.NAMES]
    rows = [
        _in_situations(f"{policy} in {behavior}", results.by_situation[policy][behavior])
        for behavior in BEHAVIORS
        for policy in results.policies
    ]
    less = [
        f"<tr><td>in {behavior}</td>{''.join(_between(measured[name], '+.2f') for name in results.MEASURES)}</tr>"
        for behavior, measured in results.more.items()
    ]
    more = [_in_situations(f"in {behavior}", less, "+.3f") for behavior, less in results.balancing.items()]
    return (
        _table(["intimate distance violations per episode", *names], rows)
        + _table(["of B more than of G, in the same episodes", *names], more)
        + _table(["likewise", *results.MEASURES.values()], less)
        + BOOTSTRAP
    )


def _in_situations(name: str, estimate: Estimate, form: str = ".3f") -> str:
    cells = zip(estimate.mean, estimate.low, estimate.high, strict=True)
    values = "".join(_cell(f"{mean:{form}}", f"{low:{form}} – {high:{form}}", "ours") for mean, low, high in cells)
    return f"<tr><td>{name}</td>{values}</tr>"


def _claims(results: Results) -> str:
    rows = [
        f"<tr><td class=text>{markup.escape(claim['statement'])}</td>{_cell(claim['paper'])}"
        f"{_cell(claim['ours'], '', 'ours')}{_cell(*_verdict(claim))}</tr>"
        for claim in results.claims
    ]
    return _table(["statement", "paper", "here", "holds"], rows)


def learning_curve(options: LearningCurveConfig, curve: Curve, figure: Figure) -> str:
    """The page of the learning curve of policy G.

    Args:
        figure: as ``pictures.learning_curve`` draws it.
    """
    first = curve.variants[0].name
    places = list(curve.cells[first])
    numbers = []
    for name, words in MEASURES.items():
        rows = [
            f"<tr><td>{each.title}</td>"
            f"{''.join(_between(curve.cells[each.name][place][name]) for place in places)}</tr>"
            for each in curve.variants
        ]
        numbers.append(_table([words, *places], rows))
    apart = []
    for one, other in comparisons(curve.variants):
        found = curve.differences(one, other)
        rows = [
            f"<tr><td>{words}</td>{''.join(_between(found[place][name], '+.2f') for place in places)}</tr>"
            for name, words in MEASURES.items()
        ]
        apart.append(_table([f"{one.title} less {other.title}", *places], rows))
    rows = [
        f"<tr><td class=text>{row['variant']} better than {row['other']}: {MEASURES[row['measure']]}</td>"
        f"{_between(row['difference'], '+.2f')}{_cell(*_verdict(row))}</tr>"
        for row in curve.verdicts
    ]
    titles = {each.name: each.title for each in curve.variants}
    sections = [
        ("What more data does", pictures.embed(figure, "learning-curve") + CURVE),
        ("Is it better?", _table(["over the three scenarios", "difference", "holds"], rows) + SURE),
        ("Numbers", "".join(numbers) + BOOTSTRAP),
        ("Differences in the same episodes", "".join(apart) + BOOTSTRAP),
        ("Training", _training({titles[name]: row for name, row in curve.training.items()})),
    ]
    datasets, trainings, each = curve.sizes
    several = f"{datasets} dataset{'s' * (datasets > 1)}, {trainings} network{'s' * (trainings > 1)} on each"
    whole = f"{several}, {datasets * trainings * each} episodes in each cell"
    return document(f"Policy G and its data: {whole}", "sean_jax · experiment", sections, options)


CURVE = (
    "<figcaption>Imitation of the demonstrator on the behavior graph, in three scenarios and their mean, by hours of "
    "demonstrations. Bars are the middle 95 % of a bootstrap over datasets, seeds of training of each, and episodes of "
    "each; with few datasets they are too short.</figcaption>"
)
SURE = (
    "<p class=note>Below: in how many of the resamples it holds; at least 97.5 % is counted as surely. verdicts.csv "
    "and differences.csv have these numbers.</p>"
)
