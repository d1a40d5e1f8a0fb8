"""Tables of docs/results/ are those of the files in results/."""

import csv
import json
import re

import pytest

from support.checkout import ROOT, module_of

pytestmark = pytest.mark.form
DOCS = ROOT / "docs"


def generator():
    """The program that writes the tables."""
    return module_of(DOCS / "experiments.py")


def cells(line: str) -> list[str]:
    """The cells of a line of a table."""
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def test_tables_say_what_their_numbers_are_of():
    """A statement that the paper does not report is ours; tables have both presets and the paper's row."""
    tables = generator()
    head, _, *rows = map(cells, tables.claims("figure4").splitlines())
    assert head[:2] == ["statement", "paper"] and "not reported" in [row[1] for row in rows]
    assert "so are statements that the paper does not report" in sentences("results/experiments.md")

    head, _, *rows = map(cells, tables.driven("figure4").splitlines())
    by_name = {row[0]: dict(zip(head[1:], row[1:], strict=True)) for row in rows}
    for folder, column in (("figure4", "not moving, s"), ("figure4-sean2", "not moving, s, `sean2`")):
        (mean,) = tables.select(tables.read(folder, "figure4"), policy="N", behavior="mean", measure="time_not_moving")
        assert by_name["N"][column].startswith(f"{float(mean['mean']):.2f}")

    head, _, first, *_ = map(cells, tables.shares("table1").splitlines())
    assert head[-2:] == ["none", "entropy"] and first[-2:] == ["", "0.562"]


def test_tables_are_those_of_the_results():
    tables = generator()
    texts = [page.read_text(encoding="utf-8") for page in tables.PAGES]
    assert [tables.fill(text) for text in texts] == texts, "run python docs/experiments.py"
    folders = {folder for text in texts for _, folder in re.findall(r"<!-- (\w+) ([\w-]+) -->", text)}
    origins = (tables.RESULTS / "README.md").read_text(encoding="utf-8")
    assert folders
    for folder in folders:
        results = [json.loads(file.read_text(encoding="utf-8")) for file in (tables.RESULTS / folder).glob("*.json")]
        assert any(result.get("versions") for result in results), folder
        command = r"`(sean (experiment|benchmark)|python benchmarks/\w+\.py) "
        assert re.search(rf"\| `{folder}` \| {command}", origins), folder


def sentences(page: str) -> str:
    """A page without line breaks."""
    return " ".join((DOCS / page).read_text(encoding="utf-8").split())


def test_speeds_are_the_same_on_every_page():
    """README, the page of performance and the comparison, of the whole step and beside JuPedSim."""
    (step,) = re.findall(
        r"the whole step with metrics and restarts .*?\| ([\d.]+ M scenario-steps/s)", sentences("performance.md")
    )
    assert f"makes {step} with 62 people" in sentences("comparison.md")
    assert step in (DOCS.parent / "README.md").read_text(encoding="utf-8")

    peers = json.loads((DOCS.parent / "benchmarks" / "results" / "peers.json").read_text(encoding="utf-8"))
    rates = {(row["hall"], row["people"], row["simulator"]): row["rate"] for row in peers["rows"]}
    walls, opened = (rates[hall, 62, "sean_jax, B = 1"] / rates[hall, 62, "jupedsim"] for hall in ("walls", "open"))
    assert 7.5 < walls < 8.5, "an eighth among walls"
    assert f"an eighth among walls and {100 / opened:.0f} % in the open" in sentences("comparison.md")


def test_standing_in_completed_episodes_is_that_of_the_results():
    text = sentences("results/experiments.md")
    for folder, words in (
        ("figure4", "N stands {N:.1f} s, H {H:.1f}, G {G:.1f} and R {R:.1f} s"),
        ("figure4-sean2", "{N:.1f}, {H:.1f}, {G:.1f} and {R:.1f} s"),
    ):
        with (DOCS.parent / "results" / folder / "figure4.csv").open(encoding="utf-8", newline="") as stream:
            rows = [row for row in csv.DictReader(stream) if row["measure"] == "time_not_moving_of_completed"]
        rows = [row for row in rows if row["behavior"] != "mean"]
        means = {name: sum(float(row["mean"]) for row in rows if row["policy"] == name) / 3 for name in "NHGR"}
        assert words.format(**means) in text, folder
