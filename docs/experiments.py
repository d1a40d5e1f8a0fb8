"""Tables of docs/results/ and docs/situations.md, from the files in results/: python docs/experiments.py.

A table stands between the lines `<!-- NAME FOLDER -->` and `<!-- end -->`. NAME is a key of ``TABLES``, FOLDER a
folder of results/. The tables are written anew, the text between them stays.
"""

import csv
import functools
import math
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

DOCS = Path(__file__).parent
PAGES = [DOCS / "situations.md", *sorted((DOCS / "results").glob("*.md"))]
RESULTS = DOCS.parent / "results"
BEHAVIORS = "random", "handcrafted", "graph"
SITUATIONS = "cross_path", "down_path", "join_group", "leave_group", "empty"
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


def shares(folder: str) -> str:
    """Table I: percent of all flags at the first V, and entropies, beside the paper's.

    Ratios of shares do not depend on what they are shares of. "none" is percent of the examples in no situation.
    """
    hours = read(folder, "hours")
    flags = [row for row in read(folder, "shares") if row["counting"] == "flags"]
    entropies, speed = read(folder, "entropies"), flags[0]["V"]
    rows = []
    for behavior in BEHAVIORS:
        printed = {row["figure"]: float(row["paper"]) for row in hours if row["behavior"] == behavior}
        numbers = [f"{100 * printed[name]:.1f}" for name in SITUATIONS]
        rows.append([f"**{behavior}**, paper", *numbers, "", f"{printed['entropy']:.3f}", *ratios(printed)])
        for policy in dict.fromkeys(row["policy"] for row in flags):
            mine = [r for r in flags if (r["policy"], r["behavior"], r["V"]) == (policy, behavior, speed)][:5]
            entropy = next(r for r in entropies if (r["policy"], r["behavior"], r["V"]) == (policy, behavior, speed))
            cells = [plus_minus(row, "share", 100, 1) for row in mine]
            none, shares = (
                f"{100 * float(entropy['none']):.1f}",
                {row["situation"]: float(row["share"]) for row in mine},
            )
            rows.append([f"`{policy}`", *cells, none, plus_minus(entropy, "entropy", 1, 3), *ratios(shares)])
    names = [name.replace("_", " ") for name in SITUATIONS]
    return markdown(["", *names, "none", "entropy", "down / cross", "(cross + down) / empty"], rows)


def ratios(shares: dict[str, float]) -> list[str]:
    """Down path over cross path, and both over empty; "" where there is none below."""
    cross, down, empty = (shares[name] for name in ("cross_path", "down_path", "empty"))
    return [f"{above / below:.2f}" if below else "" for above, below in ((down, cross), (cross + down, empty))]


def hours(folder: str) -> str:
    """The paper's figures beside the interval of one hour; bold where they do not fit."""
    rows, every = [], read(folder, "hours")
    for behavior in BEHAVIORS:
        for policy in dict.fromkeys(row["policy"] for row in every):
            cells = []
            for row in (r for r in every if (r["policy"], r["behavior"]) == (policy, behavior)):
                scale, digits = (1, 3) if row["figure"] == "entropy" else (100, 1)
                low, high, paper = (f"{scale * float(row[end]):.{digits}f}" for end in ("low", "high", "paper"))
                paper = f"**{paper}**" if float(row["holm"]) < 0.05 else paper
                cells.append(f"{paper} [{low}, {high}]")
            rows.append([f"{behavior}, `{policy}`", *cells])
    return markdown(["", *(name.replace("_", " ") for name in SITUATIONS), "entropy"], rows)


def orderings(folder: str) -> str:
    """Whether the paper's orderings hold, at the first V by flags, and in which share of the resamples."""
    every = [row for row in read(folder, "orderings") if row["counting"] == "flags"]
    every = [row for row in every if row["V"] == every[0]["V"]]
    policies, rows = list(dict.fromkeys(row["policy"] for row in every)), []
    for name in dict.fromkeys(row["ordering"] for row in every):
        several = {row["policy"]: row for row in every if row["ordering"] == name}
        first, cells = several[policies[0]], []
        for policy in policies:
            share = float(several[policy]["share_of_resamples"])
            words = "yes" if several[policy]["holds"] == "True" else "no"
            sure = "" if share >= 0.975 or share <= 0.025 else "perhaps "
            cells.append(f"{sure}{words}, {100 * share:.4g} %")
        rows.append([name, first["source"], first["statement"], *cells])
    return markdown(["", "source", "ordering of the paper", *(f"`{policy}`" for policy in policies)], rows)


def select(rows: list[Row], **values: str) -> list[Row]:
    """The rows with these values."""
    return [row for row in rows if all(row[name] == value for name, value in values.items())]


def speeds(folder: str) -> str:
    """Cross path and entropy of the first policy by V."""
    shares, entropies = read(folder, "shares"), read(folder, "entropies")
    first, every = shares[0], list(dict.fromkeys(row["V"] for row in shares))
    rows = []
    for behavior in BEHAVIORS:
        own = next(row for row in shares if row["behavior"] == behavior)
        mine = {name: own[name] for name in ("policy", "behavior", "people")}
        cross = [select(shares, **mine, V=v, counting="examples", situation="cross_path")[0]["share"] for v in every]
        rows.append([f"cross path, {behavior}, % of examples", *(f"{100 * float(share):.1f}" for share in cross)])
        entropy = [select(entropies, **mine, V=v)[0]["entropy"] for v in every]
        rows.append([f"entropy, {behavior}", *(f"{float(value):.3f}" for value in entropy)])
    return markdown([f"V, m/s (`{first['policy']}`)", *every], rows)


def crowds(folder: str) -> str:
    """Shares of examples and entropy of the first policy by the number of people, at the first V."""
    shares, entropies = read(folder, "shares"), read(folder, "entropies")
    first = {"policy": shares[0]["policy"], "V": shares[0]["V"]}
    people = sorted({int(row["people"]) for row in select(shares, **first, behavior="graph")})
    rows = []
    for behavior in ("random", "graph"):
        for situation in SITUATIONS if behavior == "graph" else ("cross_path", "down_path", "empty"):
            mine = {**first, "behavior": behavior, "counting": "examples", "situation": situation}
            cells = [f"{100 * float(select(shares, **mine, people=str(n))[0]['share']):.1f}" for n in people]
            rows.append([f"{situation.replace('_', ' ')}, {behavior}, %", *cells])
        values = [select(entropies, **first, behavior=behavior, people=str(n))[0]["entropy"] for n in people]
        rows.append([f"entropy, {behavior}", *(f"{float(value):.3f}" for value in values)])
    return markdown([f"people (`{first['policy']}`)", *map(str, people)], rows)


def driven(measure: str, folder: str) -> str:
    """A measure of Figure 4: policies by behaviors, and their mean; completed tasks in percent."""
    digits = 1 if measure == "completed" else 2
    cells = select(read(folder, "figure4"), measure=measure)
    rows = []
    for policy in dict.fromkeys(row["policy"] for row in cells):
        mine = [select(cells, policy=policy, behavior=name) for name in (*BEHAVIORS, "mean")]
        if all(mine):
            texts = [plus_minus(row, "mean", 1, digits) for (row,) in mine]
            rows.append(
                [policy if policy in PRINTED else f"`{policy}`", *texts, PRINTED.get(policy, {}).get(measure, "")]
            )
    return markdown(["", *BEHAVIORS, "mean", "paper, mean"], rows)


def standing(folder: str) -> str:
    """Time not moving of all episodes and of completed ones: the others may have been stuck until the time limit."""
    every, rows = read(folder, "figure4"), []
    for policy in dict.fromkeys(row["policy"] for row in every):
        mine = select(every, policy=policy)
        cells = [select(mine, measure="time_not_moving", behavior=name) for name in (*BEHAVIORS, "mean")]
        if not all(cells):
            continue
        texts = [plus_minus(row, "mean", 1, 2) for (row,) in cells]
        printed = PRINTED.get(policy, {}).get("time_not_moving", "")

        completed = [select(mine, measure="time_not_moving_of_completed", behavior=name) for name in BEHAVIORS]
        only = [plus_minus(row[0], "mean", 1, 2) if row else "" for row in completed]
        mean = f"{sum(float(row['mean']) for (row,) in completed) / len(BEHAVIORS):.2f}" if all(completed) else ""
        rows.append([policy if policy in PRINTED else f"`{policy}`", *texts, printed, *only, mean])
    return markdown(
        ["", *BEHAVIORS, "mean", "paper, mean", *(f"{name}, completed" for name in (*BEHAVIORS, "mean"))], rows
    )


def interval(row: Row, name: str, digits: int = 2) -> str:
    """A number and its interval."""
    return "{} [{}, {}]".format(*(f"{float(row[each]):.{digits}f}" for each in (name, "low", "high")))


def contrasts(folder: str) -> str:
    """Differences of the paper's policies over the three scenarios."""
    rows = []
    for row in read(folder, "contrasts"):
        if row["measure"] != "collisions" and row["policy"] in PRINTED:
            holm = float(row["holm"])
            p = "" if math.isnan(holm) else f"{holm:.2g}" if holm >= 1e-4 else "< 0.0001"
            measure = "completed, %" if row["measure"] == "completed" else row["measure"].replace("_", " ")
            names = f"{row['policy']} - {row['other']}", measure
            rows.append([*names, interval(row, "difference"), f"{float(row['d']):.2f}", p])
    return markdown(["policies", "measure", "difference", "d", "p (Holm)"], rows)


def claims(folder: str) -> str:
    """Statements on Figure 4, the paper's and ours, and the share of the resamples in which each holds."""
    rows = []
    for row in read(folder, "claims"):
        share = float(row["share_of_resamples"])
        sure = "" if share >= 0.975 or share <= 0.025 else "perhaps "
        holds = f"{sure}{'yes' if row['holds'] == 'True' else 'no'}, {100 * share:.4g} %"
        source = "ours" if row["paper"] == "not reported" else "paper"
        limit = re.search(r"by half|within 5 %", row["statement"])
        source += f', "{limit[0]}" ours' if limit else ""
        rows.append([row["statement"], source, row["paper"], row["ours"], holds])
    return markdown(["statement", "whose", "paper", "here", "holds"], rows)


def switches(folder: str) -> str:
    """The ablation: the share of resamples, in percent, in which each ordering holds under each world's conditions."""
    every = select(read(folder, "orderings"), counting="flags")
    every = select(every, policy=every[0]["policy"])
    names = list(dict.fromkeys(row["ordering"] for row in every))
    rows = []
    for world in dict.fromkeys(row["world"] for row in every):
        cells = {row["ordering"]: f"{100 * float(row['share_of_resamples']):.4g}" for row in select(every, world=world)}
        rows.append([f"`{world}`", *(cells[name] for name in names)])
    return markdown(["conditions", *names], rows)


def verdicts(folder: str) -> str:
    """Differences between networks of the learning curve, over the three scenarios."""
    rows = []
    for row in read(folder, "verdicts"):
        share = float(row["share_of_resamples"])
        names = row["variant"], row["other"], row["measure"].replace("_", " ")
        rows.append([*names, interval(row, "difference"), f"{100 * share:.4g} %"])
    return markdown(["networks with", "against", "measure", "difference", "better in"], rows)


def curve(folder: str) -> str:
    """The learning curve: means over the three scenarios."""
    every = select(read(folder, "learning_curve"), behavior="mean")
    rows = []
    for variant in dict.fromkeys(row["variant"] for row in every):
        cells = [
            select(every, variant=variant, measure=name)[0] for name in ("completed", "time_not_moving", "violations")
        ]
        texts = [plus_minus(cell, "mean", 1, digits) for cell, digits in zip(cells, (1, 2, 2), strict=True)]
        rows.append([f"`{variant}`", *texts])
    return markdown(["demonstrations", "completed, %", "time not moving, s", "violations"], rows)


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
        rows.append([row["class"], rank, f"`{row['policy']}`", row["results"], *texts])
    return markdown(["class", "rank", "policy", "results", *groups], rows)


PRINTED = {  # Section V-C: means over the scenarios, of 123 tasks and in seconds
    "G": {"completed": "91.6", "time_not_moving": "11"},
    "R": {"time_not_moving": "16.3"},
    "H": {"completed": "91.6", "time_not_moving": "22"},
    "N": {"time_not_moving": "28.7"},
    "E": {},
    "B": {},
}


MEASURES = {  # of `stacks`: title, scale, digits
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
        for behavior in ("graph", "random", "handcrafted", "mean"):
            place = {"behavior": behavior, "measure": measure}
            own = [select(cells, policy=name, **place)[0] for name in ("real", "N", "move_base")]
            gaps = [select(contrasts, other=name, **place)[0] for name in ("N", "move_base")]
            sure = ("**" if float(gap["holm"]) < 0.05 else "" for gap in gaps)
            differences = [f"{mark}{text(gap, 'difference', '+')}{mark}" for mark, gap in zip(sure, gaps, strict=True)]
            name = f"**{title}**, {behavior}" if behavior == "graph" else behavior
            counts = own[0]["episodes"], gaps[0]["episodes"]
            rows.append([name, *counts, *(text(row, "mean") for row in own), *differences])
    head = ["", "episodes", "the same", "real move_base", "N", "`move_base`", "real less N", "real less `move_base`"]
    return markdown(head, rows)


TABLES: dict[str, Callable[[str], str]] = {
    "shares": shares,
    "hours": hours,
    "orderings": orderings,
    "speeds": speeds,
    "crowds": crowds,
    "completed": functools.partial(driven, "completed"),
    "time_not_moving": standing,
    "violations": functools.partial(driven, "violations"),
    "contrasts": contrasts,
    "claims": claims,
    "switches": switches,
    "curve": curve,
    "verdicts": verdicts,
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
