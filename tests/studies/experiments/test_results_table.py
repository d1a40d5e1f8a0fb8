"""The table of results against loops: its rows, equal episodes of two policies, and estimates with their units."""

import dataclasses

import numpy as np
import pytest

from sean_jax.core.errors import InputError
from sean_jax.metrics import aggregate, aggregate_ratio
from sean_jax.metrics.bootstrap import hierarchical_resamples, resamples
from sean_jax.studies.experiments.results_table import (
    ALL,
    Table,
    averaged,
    contrast,
    estimate,
    join,
    rows,
    samples,
)

FLOORS, SITUATIONS = ("lab", "yard"), ("near", "far")


def study(random: np.random.Generator) -> tuple[Table, dict]:
    """Two networks of each of three datasets, and a policy that does not learn, drive 12 episodes on each floor."""
    tables, values = [], {}
    for policy in ("net", "orca"):
        network = np.arange(12) // 2 if policy == "net" else np.zeros(12, int)
        labels = {"policy": policy, "dataset": network // 2, "seed": network % 2, "people": 4}
        for floor in FLOORS:
            values[policy, floor] = random.normal(size=12), random.poisson(2.0, (12, 2))
            overall, by_situation = values[policy, floor]
            tables.append(rows(overall, measure="delay", behavior=floor, **labels))
            tables.append(rows(by_situation, SITUATIONS, measure="events", behavior=floor, **labels))
    return join(tables), values


def test_rows_are_found_by_their_labels():
    table, values = study(np.random.default_rng(0))
    assert len(table) == 2 * 2 * (12 + 24)
    assert table.levels("policy") == ["net", "orca"] and table.levels("situation") == [ALL, *SITUATIONS]
    assert table.levels("people") == [4] and table.levels("dataset") == [0, 1, 2]
    far = table.where(policy="net", behavior=["yard", "moon"], situation="far")
    np.testing.assert_array_equal(far.value, values["net", "yard"][1][:, 1])
    assert [far.label("episode", k) for k in (0, 11)] == [0, 11] and far.label("seed", 3) == 1
    groups = table.where(measure="events").groups(["behavior", "situation"])
    assert list(groups) == [(floor, situation) for floor in FLOORS for situation in SITUATIONS]
    assert not len(table.where(policy="expert")) and table.where(policy="expert").groups(["policy"]) == {}
    assert len(join([])) == 0 and join([]).where(policy="net").levels("policy") == []


def test_values_are_in_the_order_of_their_units():
    table, values = study(np.random.default_rng(1))
    events = table.where(policy="net", behavior="lab", measure="events")
    shuffled = events.take(np.random.default_rng(2).permutation(len(events)))
    matrix, sizes = shuffled.matrix("situation")
    np.testing.assert_array_equal(matrix, values["net", "lab"][1])
    assert sizes == (3, 2, 2)
    assert table.where(policy="orca", behavior="lab", measure="delay").matrix(None)[1] == (1, 1, 12)
    with pytest.raises(InputError, match="table: 23 rows are not 3 x 2 x 1 x 2 of dataset, seed, episode, situation"):
        events.take(np.arange(23)).matrix("situation")


def test_equal_episodes_are_averaged_and_compared():
    table, values = study(np.random.default_rng(3))
    mean = averaged(table, "behavior", "mean")
    expected = np.mean([values["orca", floor][0] for floor in FLOORS], 0)
    np.testing.assert_array_equal(mean.where(policy="orca", measure="delay").value, expected)
    pair = contrast(table, "net", "orca")
    assert pair.levels("policy") == ["net-orca"] and pair.levels("dataset") == [0, 1, 2]
    gap = values["net", "yard"][0] - values["orca", "yard"][0]
    np.testing.assert_array_equal(pair.where(behavior="yard", measure="delay").value, gap)
    np.testing.assert_array_equal(contrast(table, "orca", "net").columns["seed"], pair.columns["seed"])
    without = table.where(policy="net", behavior="lab", episode=range(5))
    with pytest.raises(InputError, match="table: net and orca differ in column .*; compare equal episodes"):
        contrast(join([without, table.where(policy="orca")]), "net", "orca")


def test_networks_are_drawn_by_datasets_and_other_policies_by_episodes():
    table, values = study(np.random.default_rng(4))
    found = estimate(table, ["policy", "behavior", "measure", "situation"], bounds={"events": (0.0, np.inf)})
    assert len(found) == 2 * 2 * 3
    for policy, weights in (("net", hierarchical_resamples((3, 2, 2))), ("orca", resamples(12))):
        for floor in FLOORS:
            delay, events = values[policy, floor]
            assert found[policy, floor, "delay", ALL] == aggregate(delay, weights=weights)
            bounded = aggregate(events[:, 1].copy(), weights=weights, bounds=(0.0, np.inf))
            assert found[policy, floor, "events", "far"] == bounded
    several = estimate(table.where(measure="events"), ["policy", "behavior"], across="situation")
    np.testing.assert_array_equal(
        several["net", "lab"].mean, [found["net", "lab", "events", name].mean for name in SITUATIONS]
    )
    one_dataset = table.where(policy="net", dataset=1, measure="delay", behavior="lab")
    (value,) = estimate(one_dataset, []).values()
    assert value == aggregate(values["net", "lab"][0][4:8], weights=hierarchical_resamples((1, 2, 2)))


def test_ratios_and_samples():
    table, values = study(np.random.default_rng(5))
    far, near = (table.where(policy="orca", situation=name).relabel(situation="any") for name in ("far", "near"))
    more = dataclasses.replace(near, value=near.value + 1.0)
    found = estimate(far, ["behavior"], per=more)
    events = values["orca", "lab"][1].astype(float)
    assert found["lab",] == aggregate_ratio(events[:, 1], events[:, 0] + 1.0, weights=resamples(12))
    drawn = np.ones((3, 24)) * [[1.0], [2.0], [0.0]]
    (means,) = samples(
        far, [], ["behavior", "episode"], draw=lambda sizes: drawn if sizes == (2, 12) else None
    ).values()
    np.testing.assert_allclose(means, far.value.mean() * np.array([1.0, 1.0, 2.0, 0.0]))
