"""Tables of docs/results/ and docs/situations.md, from the files in results/: python docs/experiments.py.

A table stands between the lines `<!-- NAME FOLDER -->` and `<!-- end -->`. NAME is a key of ``TABLES``, FOLDER a
folder of results/. The tables are written anew, the text between them stays.
"""

import csv
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

DOCS = Path(__file__).parent
PAGES = [DOCS / "situations.md", *sorted((DOCS / "results").glob("*.md"))]
RESULTS = DOCS.parent / "results"
BEHAVIORS = "random", "handcrafted", "graph"
SITUATIONS = "cross_path", "down_path", "join_group", "leave_group", "empty"
PAPERS = "G", "R", "H", "B", "N", "E"
"""Policies with a letter: those of the paper's Figure 4, G with balanced examples, and the expert."""
Row = dict[str, str]


def read(folder: str, name: str) -> list[Row]:
    """The rows of a table in results/."""
    with (RESULTS / folder / f"{name}.csv").open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def plus_minus(row: Row, mean: str, scale: float, digits: int) -> str:
    """A mean and half of its interval, unless that is 0.0; the interval itself if the mean is far from its middle."""
    middle, low, high = (scale * float(row[name]) for name in (mean, "low", "high"))
    texts = [f"{value:.{digits}f}" for value in (middle, low, high, (high - low) / 2)]
    if not float(texts[3]):
        return texts[0]
    form = "{0} ± {3}" if 0.3 <= (middle - low) / (high - low) <= 0.7 else "{0} [{1}, {2}]"
    return form.format(*texts)


def presets(folder: str) -> tuple[str, str]:
    """The folders of an experiment with the default conditions and with SEAN's."""
    return folder, f"{folder}-sean2"


def bold(text: str, *, marked: bool) -> str:
    """A cell, bold if it is marked."""
    return f"**{text}**" if marked else text


def shares(folder: str) -> str:
    """Table I: percent of all flags at the first V, and entropies, beside the paper's; of `sean2` the first policy.

    Figures are bold where the paper's does not fit an hour. "none" is percent of the examples in no situation.
    """
    rows = []
    for behavior in BEHAVIORS:
        printed = {row["figure"]: float(row["paper"]) for row in read(folder, "hours") if row["behavior"] == behavior}
        numbers = [f"{100 * printed[name]:.1f}" for name in SITUATIONS]
        rows.append([f"**{behavior}**, paper", *numbers, "", f"{printed['entropy']:.3f}"])
        rows += _shares(folder, behavior, "")
        rows += _shares(f"{folder}-sean2", behavior, ", `sean2`")[:1]
    names = [name.replace("_", " ") for name in SITUATIONS]
    return markdown(["", *names, "none", "entropy"], rows)


def _shares(folder: str, behavior: str, preset: str) -> list[list[str]]:
    """A row for each policy."""
    hours, entropies = read(folder, "hours"), read(folder, "entropies")
    flags = select(read(folder, "shares"), counting="flags")
    rows = []
    for policy in dict.fromkeys(row["policy"] for row in flags):
        own = {"policy": policy, "behavior": behavior}
        misfits = {row["figure"] for row in select(hours, **own) if float(row["holm"]) < 0.05}
        mine = select(flags, **own, V=flags[0]["V"])[:5]
        cells = [bold(plus_minus(row, "share", 100, 1), marked=row["situation"] in misfits) for row in mine]

        (entropy,) = select(entropies, **own, V=flags[0]["V"], people=mine[0]["people"])
        mixture = bold(plus_minus(entropy, "entropy", 1, 3), marked="entropy" in misfits)
        none = f"{100 * float(entropy['none']):.1f}"
        rows.append([f"`{policy}`{preset}", *cells, none, mixture])
    return rows


def orderings(folder: str) -> str:
    """The share of resamples, in percent, in which each of the paper's orderings holds, at the first V by flags."""
    first, others = (
        [row for row in rows if row["counting"] == "flags" and row["V"] == rows[0]["V"]]
        for rows in (read(each, "orderings") for each in presets(folder))
    )
    policies, rows = list(dict.fromkeys(row["policy"] for row in first)), []
    for name in dict.fromkeys(row["ordering"] for row in first):
        cells = [
            f"{100 * float(select(every, policy=policy, ordering=name)[0]['share_of_resamples']):.4g}"
            for every in (first, others)
            for policy in policies
        ]
        (row, *_) = select(first, ordering=name)
        rows.append([name, row["statement"], *cells])
    names = [f"`{policy}`{preset}" for preset in ("", ", `sean2`") for policy in policies]
    return markdown(["", "ordering of the paper", *names], rows)


def select(rows: list[Row], **values: str) -> list[Row]:
    """The rows with these values."""
    return [row for row in rows if all(row[name] == value for name, value in values.items())]


def speeds(folder: str) -> str:
    """Cross path and entropy of the first policy by V."""
    shares, entropies = read(folder, "shares"), read(folder, "entropies")
    first, every = shares[0], list(dict.fromkeys(row["V"] for row in shares))
    rows = []
    for behavior in ("random", "graph"):
        own = next(row for row in shares if row["behavior"] == behavior)
        mine = {name: own[name] for name in ("policy", "behavior", "people")}
        cross = [select(shares, **mine, V=v, counting="examples", situation="cross_path")[0]["share"] for v in every]
        rows.append([f"cross path, {behavior}, % of examples", *(f"{100 * float(share):.1f}" for share in cross)])
        entropy = [select(entropies, **mine, V=v)[0]["entropy"] for v in every]
        rows.append([f"entropy, {behavior}", *(f"{float(value):.3f}" for value in entropy)])
    return markdown([f"V, m/s (`{first['policy']}`)", *every], rows)


def crowds(folder: str) -> str:
    """Entropy of the first policy by the number of people, at the first V."""
    entropies = read(folder, "entropies")
    first = {"policy": entropies[0]["policy"], "V": entropies[0]["V"]}
    people = sorted({int(row["people"]) for row in select(entropies, **first, behavior="graph")})
    rows = []
    for behavior in ("random", "graph"):
        values = [select(entropies, **first, behavior=behavior, people=str(n))[0]["entropy"] for n in people]
        rows.append([f"entropy, {behavior}", *(f"{float(value):.3f}" for value in values)])
    return markdown([f"people (`{first['policy']}`)", *map(str, people)], rows)


def driven(folder: str) -> str:
    """Figure 4 under both presets: means over the behaviors of people."""
    both = [select(read(each, "figure4"), behavior="mean") for each in presets(folder)]
    rows = []
    for policy in dict.fromkeys(row["policy"] for row in both[0]):
        if "-" in policy:
            continue
        cells = [select(every, policy=policy, measure=name)[0] for every in both for name in MEASURES]
        texts = [plus_minus(cell, "mean", 1, digits) for cell, digits in zip(cells, (1, 2, 2) * 2, strict=True)]
        rows.append([policy if policy in PAPERS else f"`{policy}`", *texts])
    return markdown(["", *under_presets()], rows)


def under_presets() -> list[str]:
    """Columns of the measures of Figure 4, by default and under SEAN's conditions."""
    titles = [title for title, *_ in MEASURES.values()]
    return [*titles, *(f"{title}, `sean2`" for title in titles)]


def interval(row: Row, name: str, digits: int = 2) -> str:
    """A number and its interval."""
    return "{} [{}, {}]".format(*(f"{float(row[each]):.{digits}f}" for each in (name, "low", "high")))


def contrasts(folder: str) -> str:
    """Differences of G from R and H over the three scenarios; bold where they are certain."""
    every = {each: read(each, "contrasts") for each in presets(folder)}
    rows = []
    for other in "RH":
        cells = []
        for each in presets(folder):
            for measure in MEASURES:
                (row,) = select(every[each], policy="G", other=other, measure=measure)
                cells.append(bold(interval(row, "difference"), marked=float(row["holm"]) < 0.05))
        rows.append([f"G - {other}", *cells])
    return markdown(["", *under_presets()], rows)


def claims(folder: str) -> str:
    """Statements on Figure 4, the paper's and ours, and the share of the resamples in which each holds."""
    both = [read(each, "claims") for each in presets(folder)]
    rows = []
    for pair in zip(*both, strict=True):
        cells = []
        for row in pair:
            share = float(row["share_of_resamples"])
            sure = "" if share >= 0.975 or share <= 0.025 else "perhaps "
            cells += [row["ours"], f"{sure}{'yes' if row['holds'] == 'True' else 'no'}, {100 * share:.4g} %"]
        rows.append([pair[0]["statement"], pair[0]["paper"], *cells])
    return markdown(["statement", "paper", "default", "holds", "`sean2`", "holds"], rows)


def curve(folder: str) -> str:
    """The learning curve: means over the three scenarios."""
    both = [select(read(each, "learning_curve"), behavior="mean") for each in presets(folder)]
    rows = []
    for variant in dict.fromkeys(row["variant"] for row in both[0]):
        cells = [select(every, variant=variant, measure=name)[0] for every in both for name in MEASURES]
        texts = [plus_minus(cell, "mean", 1, digits) for cell, digits in zip(cells, (1, 2, 2) * 2, strict=True)]
        rows.append([f"`{variant}`", *texts])
    return markdown(["demonstrations", *under_presets()], rows)


def more(folder: str) -> str:
    """The situations beyond the five: percent of the examples of the first policy, and their intervals."""
    every = read(folder, "more")
    policy = every[0]["policy"]
    usual = {"random": "62", "handcrafted": "21", "graph": "62"}  # people
    rows = []
    for situation in dict.fromkeys(row["situation"] for row in every):
        cells = []
        for behavior in BEHAVIORS:
            (row,) = select(every, policy=policy, behavior=behavior, people=usual[behavior], situation=situation)
            share, low, high = (f"{100 * float(row[name]):.1f}" for name in ("share", "low", "high"))
            cells.append(share if low == high else f"{share} [{low}, {high}]")
        rows.append([situation.replace("_", " "), *cells])
    return markdown([f"`{policy}` among", "random people", "handcrafted", "graph"], rows)


def ranking(folder: str) -> str:
    """The benchmark: rank and percent of tasks completed politely, by class of sensing and group of tracks."""
    every = read(folder, "ranking")
    groups, rows = list(dict.fromkeys(row["tracks"] for row in every)), []
    for row in select(every, tracks="all"):
        mine = {name: row[name] for name in ("class", "policy")}
        cells = [select(every, **mine, tracks=name)[0] for name in groups]
        texts = [plus_minus(cell, "polite_percent", 1, 1) for cell in cells]
        rank = row["first_rank"] + (f"-{row['last_rank']}" if row["last_rank"] != row["first_rank"] else "")
        several = f" ({row['results']})" if row["results"] != "1" else ""
        rows.append([row["class"], rank, f"`{row['policy']}`{several}", *texts])
    return markdown(["class", "rank", "policy", *groups], rows)


MEASURES = {  # title; scale and digits in `stacks`
    "completed": ("completed, %", 100, 0),
    "time_not_moving": ("not moving, s", 1, 1),
    "violations": ("violations", 1, 2),
}


def stacks(folder: str) -> str:
    """The real move_base beside its re-makes in the same episodes, and the differences; bold where they are certain."""
    cells, contrasts, rows = read(folder, "figure4"), read(folder, "contrasts"), []

    def text(row: Row, mean: str, sign: str = "") -> str:
        _, scale, digits = MEASURES[row["measure"]]
        middle, low, high = (f"{scale * float(row[end]) + 0.0:{sign}.{digits}f}" for end in (mean, "low", "high"))
        return f"{middle} [{low}, {high}]"

    for measure, (title, *_) in MEASURES.items():
        place = {"behavior": "mean", "measure": measure}
        own = [select(cells, policy=name, **place)[0] for name in ("real", "N", "move_base")]
        gaps = [select(contrasts, other=name, **place)[0] for name in ("N", "move_base")]
        texts = [bold(text(gap, "difference", "+"), marked=float(gap["holm"]) < 0.05) for gap in gaps]
        rows.append([title, *(text(row, "mean") for row in own), *texts])
    head = ["", "real move_base", "N", "`move_base`", "real less N", "real less `move_base`"]
    return markdown(head, rows)


TABLES: dict[str, Callable[[str], str]] = {
    "shares": shares,
    "orderings": orderings,
    "speeds": speeds,
    "crowds": crowds,
    "driven": driven,
    "contrasts": contrasts,
    "claims": claims,
    "curve": curve,
    "more": more,
    "ranking": ranking,
    "stacks": stacks,
}
MARK = re.compile(r"(<!-- (\w+) ([\w-]+) -->\n).*?(<!-- end -->)", re.S)


def fill(text: str) -> str:
    """The page with the tables of results/."""
    return MARK.sub(lambda match: match[1] + TABLES[match[2]](match[3]) + match[4], text)


if __name__ == "__main__":
    for page in PAGES:
        page.write_text(fill(page.read_text(encoding="utf-8")), encoding="utf-8")
