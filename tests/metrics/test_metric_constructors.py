"""Metrics of a user's own: each constructor by hand, functions as metrics, and their rows in table, CSV and report."""

import dataclasses
import io

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rich.console import Console

from sean_jax import metrics
from sean_jax.evaluation import results, table
from sean_jax.metrics import Metric, as_metric
from support import metric_values
from support.metric_snapshots import SITUATIONS, STEP, at
from support.reports import evaluation, page

X = [0.0, 1.0, 3.0, 2.0, 2.0, -1.0, 4.0, 0.5]  # m, of the robot at ticks 0, 1, ...
SNAPSHOTS = [at(tick, (x, 0.0), situations=(0,) if tick % 2 else (2,)) for tick, x in enumerate(X)]
ODD, EVEN = X[1::2], X[2::2]  # positions after steps in situation 0 and in situation 2


def place(snapshot):
    """Where the robot is."""
    return snapshot.position[0]


def right(snapshot):
    """The robot is more than 1.5 m to the right."""
    return snapshot.position[0] > 1.5


def distance(before, after):
    """Distance [m] along x."""
    return jnp.abs(after.position[0] - before.position[0])


def measured(metric: Metric, snapshots=SNAPSHOTS) -> np.ndarray:
    value = metric.init(snapshots[0])
    update = jax.jit(metric.update)
    for before, after in zip(snapshots[:-1], snapshots[1:], strict=True):
        value = update(value, before, after)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(value)), "a state holds finite numbers"
    return np.asarray(metric.compute(value))


def columns(overall, odd, even, never) -> list[float]:
    """The figure overall, in situations 0 and 2, and in those that do not occur."""
    return [overall, odd, never, even, never, never]


CASES = {
    "duration": (metrics.duration(right), columns(4 * STEP, STEP, 3 * STEP, 0.0)),
    "share_of_time": (metrics.share_of_time(right), columns(4 / 7, 1 / 4, 1.0, np.nan)),
    "count_onsets": (metrics.count_onsets(right), columns(2, 0, 2, 0)),
    "total": (metrics.total(distance), columns(15.5, 1 + 1 + 3 + 3.5, 2 + 0 + 5, 0)),
    "mean": (metrics.mean(lambda before, after: place(after)), columns(*map(np.mean, (X[1:], ODD, EVEN)), np.nan)),
    "minimum": (metrics.minimum(place), columns(-1.0, -1.0, 0.0, np.nan)),
    "maximum": (metrics.maximum(place), columns(4.0, 2.0, 4.0, np.nan)),
    "maximum, not split": (metrics.maximum(lambda snapshot: -place(snapshot), by_situation=False), 1.0),
    "minimum, not split": (metrics.minimum(place, by_situation=False), -1.0),
    "final": (metrics.final(place), 0.5),
}


@pytest.mark.parametrize("name", CASES)
def test_each_constructor_by_hand(name):
    metric, expected = CASES[name]
    np.testing.assert_allclose(measured(metric), expected, rtol=1e-6, atol=1e-6)
    assert np.shape(expected) in ((), (1 + SITUATIONS,))


def test_vmap_and_scan_equal_a_loop():
    chosen = tuple((name, metric) for name, (metric, _) in CASES.items())
    sequence = jax.tree.map(lambda *leaves: jnp.stack(leaves), *SNAPSHOTS)
    both = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf[::-1]]), dataclasses.replace(sequence))

    @jax.jit
    @jax.vmap
    def run(sequence):
        return metric_values.compute(metric_values.along(sequence, chosen), chosen)

    for name, value in run(both).items():
        for one, snapshots in zip(value, (SNAPSHOTS, SNAPSHOTS[::-1]), strict=True):
            np.testing.assert_allclose(one, measured(CASES[name][0], snapshots), rtol=1e-6, err_msg=name)


def test_events_of_each_person_count_and_can_be_chosen():
    """Three people cross x = 0 to the right, one of them twice; only those above y = 0 are of interest."""
    paths = np.array([[(-1, 1), (1, 1), (-1, 1), (1, 1)], [(-1, -1), (-1, -1), (1, -1), (1, -1)], [(1, 2)] * 4], float)
    snapshots = [at(tick, people=paths[:, tick]) for tick in range(4)]
    crossed = lambda snapshot: snapshot.people.position[:, 0] > 0  # noqa: E731
    above = lambda snapshot: snapshot.people.position[:, 1] > 0  # noqa: E731
    assert measured(metrics.count_onsets(crossed), snapshots)[0] == 3
    assert measured(metrics.count_onsets(crossed, above), snapshots)[0] == 2


def test_a_function_is_a_metric():
    """Of one moment: the time during which it holds. Of two: the sum over steps. Its docstring says what it means."""
    time, amount = as_metric(right, "time_right"), as_metric(distance, "way_along_x")
    np.testing.assert_array_equal(measured(time), measured(metrics.duration(right)))
    np.testing.assert_array_equal(measured(amount), measured(metrics.total(distance)))
    assert (time.unit, time.title, time.definition) == (
        "s", "time right", "The robot is more than 1.5 m to the right."
    )  # fmt: skip
    assert as_metric(right, "time_right") is time, "or a scenario made again would be compiled again"
    path_length = metrics.METRICS["path_length"]
    assert as_metric(path_length, "path_length") is path_length
    own = as_metric(Metric(place, lambda value, before, after: value + 1.0, lambda value: value), "steps_and_start")
    assert own.title == "steps and start" and own.definition and own.headline
    assert as_metric(own, "steps_and_start") is own
    with_default = as_metric(lambda snapshot, limit=1.5: snapshot.position[0] > limit, "of_one_moment")
    np.testing.assert_array_equal(measured(with_default), measured(time))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: as_metric(right, "seconds"), "'seconds' is a column of episodes.csv already"),
        (lambda: as_metric([3], "three"), r"three is \[3\]; give a Metric"),
        (lambda: as_metric(lambda: 0.0, "none"), "give a Metric, a condition snapshot -> bool, or an amount"),
        (
            lambda: measured(
                metrics.count_onsets(lambda snapshot: snapshot.position[:, None] > snapshot.position[None])
            ),
            r"gives bool \(2, 2\), not \(\) bool or \(N,\) bool",
        ),
        (lambda: measured(as_metric(place)), r"place\(snapshot\) gives float32 \(\), not \(\) bool; for numbers take"),
        (
            lambda: measured(metrics.minimum(lambda snapshot: snapshot.position)),
            r"gives an array \(2,\), not one number",
        ),
    ],
)
def test_what_is_no_metric_is_refused_in_one_sentence(call, words):
    with pytest.raises(ValueError, match=words) as refused:
        call()
    assert "\n" not in str(refused.value)


def test_a_metric_and_a_situation_of_a_user_are_in_table_csv_and_report(tmp_path):
    """Nothing but the scenario's tuples knows of them; a count is whole, a share is in percent."""
    given = evaluation()
    own = {
        "near_misses": metrics.count_onsets(right, title="near misses", definition="Times that it was close."),
        "time_right": as_metric(right, "time_right"),
        "share_right": metrics.share_of_time(right, headline=False),
        "mean_x": metrics.mean(distance, unit="m/s2", title="mean <x>", digits=3),
    }
    number, situations = len(given.tasks), (*given.situations[:-1], "my_own")
    given.situations = situations
    values = np.arange(number * 6).reshape(number, 6) / 64
    given.metrics |= {"near_misses": np.floor(values), "time_right": values, "share_right": values, "mean_x": values}
    given.definitions |= own
    summary = results.aggregate_episodes(given)
    rows = {row.name: row for row in table.table_rows(summary, given.definitions, complete=True)}
    assert list(rows)[-4:] == list(own), "rows stand in the scenario's order"
    assert (rows["near_misses"].title, rows["near_misses"].definition) == ("near misses", "Times that it was close.")
    assert rows["share_right"].unit == "%" and rows["mean_x"].unit == "m/s²" and rows["time_right"].unit == "s"
    assert rows["share_right"].cells[0] == f"{100 * values[:, 0].mean():.1f}"
    assert rows["mean_x"].cells[5] == f"{values[:, 5].mean():.3f}"
    console = Console(width=120, file=io.StringIO())
    table.print_table(console, summary, given.definitions, "runs", 0.25)
    text = console.file.getvalue()  # pyright: ignore[reportAttributeAccessIssue]
    assert all(words in text for words in ("near misses", "time right s", "mean <x> m/s²", "own"))
    assert "share right" not in text, "it is no headline"
    results.write_episodes(tmp_path / "episodes.csv", given)
    header, first = (tmp_path / "episodes.csv").read_text().splitlines()[:2]
    cells = dict(zip(header.split(","), first.split(","), strict=True))
    assert cells["near_misses__my_own"] == "0" and cells["mean_x__my_own"] == f"{values[0, 5]:.6f}"
    html = page(given)
    for words in ("near misses", "mean &lt;x&gt;", "Times that it was close.", "my own", "share right"):
        assert words in html, words


def test_without_the_time_in_situations_figures_that_depend_on_it_are_left_out():
    given, full = evaluation(), results.aggregate_episodes(evaluation())
    del given.metrics["time_in_situation"]
    summary = results.aggregate_episodes(given)
    assert summary["situations"] == dict.fromkeys(given.situations)
    for name in ("completed", "path_efficiency"):
        assert summary["metrics"][name] == {"overall": full["metrics"][name]["overall"]}
    assert summary["metrics"]["intimate_robot_on_person"] == full["metrics"]["intimate_robot_on_person"]
    rows = table.table_rows(summary, given.definitions, complete=True)
    assert rows[0].cells == ["100.0", "", "", "", "", ""] and rows[1].cells[1:] == [""] * 5
