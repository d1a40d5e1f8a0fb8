"""``sean benchmark rank FOLDERS``: results of the benchmark by class of sensing, with ties (``ranks``)."""

from __future__ import annotations

from pathlib import Path

from sean_jax.config import BenchmarkRankConfig
from sean_jax.core.errors import InputError
from sean_jax.io import writing
from sean_jax.studies.experiments import benchmark, page, pictures, ranks, write_csv
from sean_jax.studies.experiments.benchmark import Result
from sean_jax.studies.experiments.ranks import Entry, Ranking

REPORT = "report.html"
TABLE = "ranking.csv"
PAIRS = "differences.csv"


def run(options: BenchmarkRankConfig) -> Ranking:
    """Rank results, and write ranking.csv, differences.csv, situations-CLASS.png and report.html.

    Raises:
        InputError: as of ``rank``.
        IncompleteError: a file of episodes is damaged.
        WriteError: another process writes in the folder.
    """
    ranked = rank(list(options.results))
    folder = options.folder
    with writing.folder_lock(folder):
        _write_tables(folder, ranked)
        figures = {sensing: pictures.situations(rows) for sensing, rows in ranked.by_class().items()}
        named = {f"situations-{sensing}": figure for sensing, figure in figures.items()}
        pictures.save(folder, named)
        writing.write(folder / REPORT, page.ranking(options, ranked, figures))
    return ranked


def _write_tables(folder: Path, ranked: Ranking) -> None:
    rows = []
    for row in ranked.rows:
        entry = row.entry
        head = entry.sensing, row.first, row.last, entry.name, len(entry.measured)
        for tracks, share in row.of.items():
            rows.append((*head, tracks, *map(float, share[:3])))
    write_csv(folder / TABLE, "class,first_rank,last_rank,policy,results,tracks,polite_percent,low,high", rows)

    pairs = []
    for pair in ranked.pairs:
        pairs.append((pair.sensing, pair.first, pair.second, *pair.difference, f"{pair.p:.3g}"))
    write_csv(folder / PAIRS, "class,first,second,difference_percent,low,high,p_holm", pairs)


def rank(folders: list[Path]) -> Ranking:
    """The ranking of results, on the tracks that all of them have.

    Raises:
        InputError: ``benchmark.check`` refuses a result, one has fewer episodes than the protocol, two are of one
            policy, results of one name are no training seeds of one class, or recordings differ.
        IncompleteError: as in ``benchmark.check``.
    """
    results = {folder: benchmark.check(folder) for folder in folders}
    entries = _entries(results)
    tracks = [track for track in benchmark.TRACKS if all(track in result.tracks for result in results.values())]

    groups = {}
    for group, names in benchmark.members().items():
        members = [track for track in names if track in tracks]
        if members:
            groups[group] = members

    skipped = benchmark.skipped(tracks)
    notes = [skipped] if skipped else []
    return ranks.rank(entries, groups, notes)


def _entries(results: dict[Path, Result]) -> list[Entry]:
    """The results by name.

    Raises:
        InputError: as of ``rank``.
    """
    by_name: dict[str, list[Path]] = {}
    digests: dict[str, Path] = {}
    recordings: dict[str, Path] = {}
    for folder, result in results.items():
        if not result.complete:
            raise InputError(f"{folder} has {result.episodes} episodes a track, too few to rank it; run it in full.")
        other = digests.setdefault(result.policy_digest, folder)
        if other != folder:
            raise InputError(f"{other} and {folder} have the same policy, {result.policy_digest}; rank one of them.")
        by_name.setdefault(result.name, []).append(folder)
        _check_seeds(results, by_name[result.name][0], folder)
        for file, digest in result.recordings.items():
            other = recordings.setdefault(file, folder)
            if results[other].recordings[file] != digest:
                raise InputError(f"{other} and {folder} have different recordings {file}; run both with one.")

    entries = []
    for name, folders in by_name.items():
        measured = [benchmark.measurements(folder, results[folder]) for folder in folders]
        first = results[folders[0]]
        entries.append(Entry(name, first.sensing, first.trained, measured))
    return entries


def _check_seeds(results: dict[Path, Result], first: Path, folder: Path) -> None:
    """Refuse two results of one name that are no training seeds of one class.

    Raises:
        InputError: the folders.
    """
    ours = results[first]
    theirs = results[folder]
    if first != folder and not (ours.trained and theirs.trained):
        raise InputError(
            f"{first} and {folder} have the same name, {theirs.name}, but are no trainings; "
            "run one with another --name."
        )
    if ours.sensing != theirs.sensing:
        raise InputError(
            f"{first} and {folder} have the same name, {theirs.name}, but their sensing is {ours.sensing} and "
            f"{theirs.sensing}; run one with another --name."
        )
