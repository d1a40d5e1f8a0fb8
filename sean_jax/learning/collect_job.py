"""``sean collect``: demonstrations of a driver until there is as much as asked for, shard by shard (section V-B).

What has been committed is never lost: after a kill, or for more hours, the same command goes on with the next shard,
and makes those anew that were lost. The result is the same, to the byte, as that of one run. A shard is written while
the next one is simulated.
"""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from sean_jax import devices, sensors, writing
from sean_jax.learning import dataset as datasets
from sean_jax.learning import demonstrations
from sean_jax.learning.dataset import Dataset
from sean_jax.learning.options import Collect, Refused
from sean_jax.learning.progress import shown
from sean_jax.learning.protocol import Stream, check, next_stream, share, streams, who_drives
from sean_jax.options import written
from sean_jax.versions import content, differing, versions

if TYPE_CHECKING:
    from rich.console import Console

TYPICAL = 30.0  # s, of an episode: so many are simulated at once that no stream gets much more than it needs
MOST = {"cpu": 32}  # episodes at once, by kind of device
MOST_ELSEWHERE = 1024


def collect(options: Collect, console: Console | Callable[[float], None] | None = None) -> Dataset:
    """Record until every stream has its time, and give the dataset.

    Raises Refused for what cannot be asked for, Unwritable if somebody else records in the folder, Failed if something
    breaks midway, FloatingPointError for numbers that are not finite, KeyboardInterrupt; what was committed before
    stays in each case.
    """
    options.check()
    check(options)
    check_place(options.folder)
    with writing.held(options.folder):
        return _collect(options, console)


def _collect(options: Collect, console: Console | Callable[[float], None] | None) -> Dataset:
    """In a folder that nobody else writes."""
    policy = who_drives(options.driver)
    parts, tasks = streams(options)
    try:
        eye = sensors.camera(parts[0].scenario, "depth", width=options.width, height=options.height)
    except ValueError as error:
        raise Refused(str(error)) from error
    over = devices.mesh()
    if (options.batch or 0) % over.size:
        batch = options.batch
        raise Refused(f"--batch: {batch} episodes do not spread evenly over {over.size} devices; take a multiple.")
    data = _begun(options, parts, eye)
    if data.batch % over.size:
        said = f"{data.folder} was begun with --batch {data.batch}, which does"
        raise Refused(f"{said} not spread evenly over {over.size} devices; choose another --out.")
    programs = demonstrations.prepare(parts[0].scenario, tasks, policy, eye, over)
    wanted = share(options.hours, len(parts))
    total = wanted * len(parts)
    recorded, first_new = data.recorded, len(data.manifest["shards"])
    with shown(console, "recording", total) as tell, _behind(data) as commit:
        for stream, shard in _due(data, recorded, wanted):
            began = time.perf_counter()

            def watch(seconds: int, shard: int = shard) -> None:
                note = f"shard {shard}: {data.batch} episodes of {parts[0].scenario.people} people at {seconds} s"
                done = sum(min(each, wanted) for each in recorded)
                tell(done, f"{done:,} of {total:,} s · {note}")

            numbers = np.arange(shard * data.batch, (shard + 1) * data.batch)
            part = parts[stream]
            batch = demonstrations.simulate(programs, part.scenario, options.seed, part.turn, numbers, watch)
            commit(stream, batch, shard)
            if shard >= first_new:
                recorded[stream] += int(batch.lengths.sum())
            took = time.perf_counter() - began
            done = sum(min(each, wanted) for each in recorded)
            note = f"shard {shard}: {int(batch.lengths.sum())} examples in {took:.1f} s"
            tell(done, f"{done:,} of {total:,} s · {note}")
    return data


def _due(data: Dataset, recorded: list[int], wanted: int) -> Iterator[tuple[int, int]]:
    """(stream, shard) of what is to be recorded: first what was lost, then what is missing of ``recorded`` [s]."""
    shards = data.manifest["shards"]
    for shard in data.lost():
        yield shards[shard]["stream"], shard
    number = len(shards)
    while (stream := next_stream(recorded, wanted)) is not None:
        yield stream, number
        number += 1


@contextlib.contextmanager
def _behind(data: Dataset) -> Iterator[Callable[..., None]]:
    """``data.commit``, one after the other in a thread; what one of them raises is raised at the next, or at the end.

    Whatever ends the block, it waits until what was begun is committed.
    """
    with ThreadPoolExecutor(1, thread_name_prefix="sean-commit") as pool:
        last: list[Future] = []

        def commit(*arguments: Any) -> None:
            for begun in last:
                begun.result()
            last[:] = [pool.submit(data.commit, *arguments)]

        yield commit
        for begun in last:
            begun.result()


def _begun(options: Collect, parts: list[Stream], eye: sensors.Camera) -> Dataset:
    """The dataset of the folder, if it was begun with the same options and content, or an empty one."""
    folder, manifest = options.folder, _manifest(options, parts, eye)
    check_place(folder)
    if (folder / datasets.MANIFEST).exists():
        data = datasets.open_dataset(folder)
        _check_same(options, data)
        _check_made_with(data, manifest)
        if options.hours > data.manifest["hours"]:
            data.save({**data.manifest, "command": _command(options, data.batch), "hours": options.hours})
        return data
    return datasets.create_dataset(folder, manifest)


def check_place(folder: Path) -> None:
    """Refuse a folder that holds something else than a dataset, or what a kill at the very beginning left of one."""
    if not any((folder / name).is_file() for name in (datasets.MANIFEST, "zarr.json")):
        if not set(writing.contents(folder)) <= set(datasets.fields(1, 1, 1)):
            raise Refused(f"the folder {folder} holds something else already, choose another with --out.")


def _check_same(options: Collect, data: Dataset) -> None:
    asked = options.fixed()
    had = {"parties": [0.0, 0.0], **data.manifest["options"]}  # which datasets made before there were any do not name
    for name in asked:
        if asked[name] != had.get(name):
            said = f"--{name.replace('_', '-')} {_said(had.get(name))}, not {_said(asked[name])}"
            raise Refused(f"{data.folder} was begun with {said}; ask for the same or choose another --out.")
    if options.batch not in (None, data.batch):
        raise Refused(f"{data.folder} was begun with --batch {data.batch}, not {options.batch}; ask for the same.")
    if options.hours < data.manifest["hours"]:
        had_hours, asked_hours = written(data.manifest["hours"]), written(options.hours)
        raise Refused(f"{data.folder} was begun with --hours {had_hours}, not {asked_hours}; ask for as much or more.")


def _check_made_with(data: Dataset, now: dict[str, Any]) -> None:
    """Refuse to go on where the options are the same, but not what they stand for: it would be two datasets in one.

    What a dataset of an earlier version does not tell is not asked.
    """
    had = data.manifest
    if (other := differing(had.get("versions"))) is not None:
        raise Refused(f"{data.folder} was begun with {other}; go on with the same, or choose another --out.")
    for name in ("environment", "people", "robot", "camera", "situations", "content"):
        if name in had and had[name] != now[name]:
            what = "content of scenario or driver" if name == "content" else name
            raise Refused(f"{data.folder} was begun with another {what}; restore it, or choose another --out.")


def _said(value: Any) -> str:
    return " ".join(written(each) for each in (value if isinstance(value, list) else [value]))


def _manifest(options: Collect, parts: list[Stream], eye: sensors.Camera) -> dict[str, Any]:
    scenario, size = parts[0].scenario, _size(options, len(parts))
    driver: Any = who_drives(options.driver)
    return {
        "command": _command(options, size),
        "options": options.fixed(),
        **described(scenario, eye, options.driver),
        "content": content(scenario, [part.scenario.behavior for part in parts], getattr(driver, "data", None)),
        "hours": options.hours,
        "batch": size,
        "streams": [part.name for part in parts],
    }


def _command(options: Collect, batch: int) -> str:
    return dataclasses.replace(options, batch=batch).command


def described(scenario: Any, eye: sensors.Camera, driver: str) -> dict[str, Any]:
    """What a manifest says of a scenario and of who drives there."""
    camera = {"width": eye.width, "height": eye.height, "fovy": eye.fovy, "far": eye.far}
    limits = {"max_speed": float(scenario.robot.max_speed), "max_turn_rate": float(scenario.robot.max_turn_rate)}
    return {
        "versions": versions(),
        "environment": scenario.environment.name,
        "behavior": scenario.behavior.name,
        "driver": driver,
        "people": scenario.people,
        "robot": {"name": scenario.robot.name, **limits},
        "camera": camera,
        "situations": [name for name, _ in scenario.situations],
        "rate": 1.0,
        "seconds": int(np.ceil(scenario.time_limit - 1e-6)),
    }


def _size(options: Collect, parts: int) -> int:
    """Episodes at once, a multiple of the number of devices."""
    count = len(jax.devices())
    if options.batch is not None:
        return options.batch
    most = MOST.get(jax.default_backend(), MOST_ELSEWHERE)
    needed = int(np.ceil(share(options.hours, parts) / TYPICAL))
    return int(np.ceil(min(most, max(4, needed)) / count) * count)
