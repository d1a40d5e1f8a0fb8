"""Several metrics at once, as ``scenario.measure`` updates those of a scenario."""

import jax

from sean_jax.metrics import METRICS

ALL = tuple(METRICS.items())


def init(snapshot, metrics=ALL):
    return {name: metric.init(snapshot) for name, metric in metrics}


def update(values, before, after, metrics=ALL):
    return {name: metric.update(values[name], before, after) for name, metric in metrics}


def compute(values, metrics=ALL):
    return {name: metric.compute(values[name]) for name, metric in metrics}


def along(snapshots, metrics=ALL):
    """Running values at the end of snapshots that are stacked along their first axis."""
    first, before, after = (
        jax.tree.map(lambda leaf, part=part: leaf[part], snapshots) for part in (0, slice(None, -1), slice(1, None))
    )
    step = lambda values, pair: (update(values, *pair, metrics), None)  # noqa: E731
    return jax.lax.scan(step, init(first, metrics), (before, after))[0]
