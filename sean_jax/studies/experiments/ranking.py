"""``sean benchmark rank FOLDERS``: results of the benchmark by class of sensing, with ties (``ranks``)."""

from __future__ import annotations

from pathlib import Path

from sean_jax.config import BenchmarkRankConfig
from sean_jax.core.errors import InputError
from sean_jax.io import writing
from sean_jax.studies.experiments import benchmark, page, pictures, ranks, write_csv
from sean_jax.studies.experiments.benchmark import Result
from sean_jax.studies.experiments.ranks import Entry, Ranking

REPORT, TABLE, PAIRS = "report.html", "ranking.csv", "differences.csv"


def run(options: BenchmarkRankConfig) -> Ranking:
    """Rank results, and write ranking.csv, differences.csv, situations-CLASS.png and report.html.

    Raises:
        InputError: as of ``rank``.
        IncompleteError: a file of episodes is damaged.
        WriteError: another process writes in the folder.
    """
    ranked, folder = rank(list(options.results)), options.folder
    with writing.folder_lock(folder):
        rows = []
        for row in ranked.rows:
            head = row.entry.sensing, row.first, row.last, row.entry.name, len(row.entry.measured)
            rows += [(*head, tracks, *map(float, share[:3])) for tracks, share in row.of.items()]
        write_csv(folder / TABLE, "class,first_rank,last_rank,policy,results,tracks,polite_percent,low,high", rows)
        pairs = [(pair.sensing, pair.first, pair.second, *pair.difference, f"{pair.p:.3g}") for pair in ranked.pairs]
        write_csv(folder / PAIRS, "class,first,second,difference_percent,low,high,p_holm", pairs)

        figures = {sensing: pictures.situations(rows) for sensing, rows in ranked.by_class().items()}
        pictures.save(folder, {f"situations-{sensing}": figure for sensing, figure in figures.items()})
        writing.write(folder / REPORT, page.ranking(options, ranked, figures))
    return ranked


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
    groups = {group: [track for track in names if track in tracks] for group, names in benchmark.members().items()}
    skipped = benchmark.skipped(tracks)
    return ranks.rank(entries, {group: names for group, names in groups.items() if names}, [skipped] * bool(skipped))


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
        if (other := digests.setdefault(result.policy_digest, folder)) != folder:
            raise InputError(f"{other} and {folder} have the same policy, {result.policy_digest}; rank one of them.")
        by_name.setdefault(result.name, []).append(folder)
        _check_seeds(results, by_name[result.name][0], folder)
        for file, digest in result.recordings.items():
            if results[other := recordings.setdefault(file, folder)].recordings[file] != digest:
                raise InputError(f"{other} and {folder} have different recordings {file}; run both with one.")

    entries = []
    for name, folders in by_name.items():
        measured = [benchmark.measurements(folder, results[folder]) for folder in folders]
        entries.append(Entry(name, results[folders[0]].sensing, results[folders[0]].trained, measured))
    return entries


def _check_seeds(results: dict[Path, Result], first: Path, folder: Path) -> None:
    """Refuse two results of one name that are no training seeds of one class.

    Raises:
        InputError: the folders.
    """
    ours, theirs = results[first], results[folder]
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
