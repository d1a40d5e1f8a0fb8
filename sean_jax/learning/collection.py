"""``sean collect``: demonstrations of a driver until there is as much as asked for, shard by shard (section V-B).

What has been committed is never lost: after a kill, or for more hours, the same command goes on with the next shard,
and makes those anew that were lost. The result is the same, to the byte, as that of one run. A shard is written while
the next one is simulated.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax

from sean_jax import components, devices, sensors, writing
from sean_jax.base import Policy, Scenario
from sean_jax.config import CollectConfig, present_names
from sean_jax.errors import InputError
from sean_jax.flags import command, flag, number
from sean_jax.learning import choice, demonstrations, labels
from sean_jax.learning import dataset as datasets
from sean_jax.learning.dataset import Dataset
from sean_jax.learning.protocol import check, next_stream, seconds_of_each, streams
from sean_jax.progress import progress
from sean_jax.runner import Runner
from sean_jax.versions import fingerprint, version_mismatch, versions

if TYPE_CHECKING:
    from rich.console import Console

TYPICAL = 30.0  # s, of an episode: so many are simulated at once that no stream gets much more than it needs
MAX_BATCH = {"cpu": 32}  # episodes at once, by kind of device
MAX_BATCH_ELSEWHERE = 1024
MIN_BATCH = 32  # at a high rate, at which so many as otherwise would fill the memory with their images


def collect(config: CollectConfig, console: Console | Callable[[float], None] | None = None) -> Dataset:
    """Record until every stream has its time. What was committed stays, whatever is raised.

    Args:
        console: shows the progress; a function is told the share that is done.

    Raises:
        InputError: what is asked for cannot be.
        WriteError: another process records in the folder.
        IncompleteError: something broke midway.
        FloatingPointError: a number is not finite.
    """
    with components.read_once():
        check(config)
        check_place(config.folder)
        with writing.folder_lock(config.folder):
            return _collect(config, console)


def _collect(config: CollectConfig, console: Console | Callable[[float], None] | None) -> Dataset:
    """In a folder that nobody else writes."""
    parts = streams(config)
    scenarios = list(parts.values())
    policy, command_of = choice.policy(config.policy, scenarios[0]), None
    if config.noise is not None:
        policy, command_of = labels.disturbed(policy, config.noise), labels.label
    if config.labels is not None:
        policy = labels.labelled(policy, choice.policy(config.labels, scenarios[0], "labels"))
        command_of = labels.label
    try:
        camera = sensors.camera(scenarios[0], "depth", width=config.width, height=config.height)
    except ValueError as error:
        raise InputError(str(error)) from error
    mesh = devices.mesh()
    if (config.batch or 0) % mesh.size:
        uneven = f"{config.batch} episodes do not spread evenly over {mesh.size} devices"
        raise InputError(f"--batch: {uneven}; take a multiple.")
    data = _opened(config, parts, policy, camera)
    if data.batch % mesh.size:
        text = (
            f"{data.folder} was begun with --batch {data.batch}, which does not spread evenly over {mesh.size} devices"
        )
        raise InputError(f"{text}; choose another --out.")
    record = demonstrations.record(scenarios[0], camera, command_of, config.rate)
    runner = Runner(scenarios, policy, data.batch, "collect", record, mesh)
    wanted = config.rate * seconds_of_each(config.hours, len(parts))
    total = wanted * len(parts) // config.rate
    recorded, first_new = data.stream_rows, len(data.manifest["shards"])
    with progress(console) as tell, _behind(data) as commit:
        tell.start("recording", total)

        def show(note: str) -> None:
            done = sum(min(each, wanted) for each in recorded) // config.rate
            tell.update(done, f"{done:,} of {total:,} s · {note}")

        show("compiling")
        for stream, shard in _due(data, recorded, wanted):
            began = time.perf_counter()

            def watch(seconds: int, shard: int = shard) -> None:
                show(f"shard {shard}: {data.batch} episodes of {scenarios[0].people} people at {seconds} s")

            batch = demonstrations.simulate(runner, config.seed, shard, stream, watch)
            commit(stream, batch, shard)
            if shard >= first_new:
                recorded[stream] += int(batch.lengths.sum())
            show(f"shard {shard}: {int(batch.lengths.sum())} examples in {time.perf_counter() - began:.1f} s")
    return data


def _due(data: Dataset, recorded: list[int], wanted: int) -> Iterator[tuple[int, int]]:
    """(stream, shard) of what is to be recorded: first what was lost, then what is missing of ``recorded`` rows."""
    shards = data.manifest["shards"]
    for shard in data.damaged_shards():
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


def _opened(config: CollectConfig, parts: dict[str, Scenario], policy: Policy, camera: sensors.Camera) -> Dataset:
    """The dataset of the folder, if it was begun with the same description and content, or an empty one."""
    folder, manifest = config.folder, _manifest(config, parts, policy, camera)
    check_place(folder)
    if (folder / datasets.MANIFEST).exists():
        data = datasets.open_dataset(folder)
        _check_same(config, data)
        _check_made_with(data, manifest)
        if config.hours > data.manifest["hours"]:
            data.save({**data.manifest, "command": _command(config, data.batch), "hours": config.hours})
        return data
    return datasets.create_dataset(folder, manifest)


def check_place(folder: Path) -> None:
    """Refuse a folder that holds something else than a dataset, or what a kill at the very beginning left of one.

    Raises:
        InputError: it holds something else.
    """
    if not any((folder / name).is_file() for name in (datasets.MANIFEST, "zarr.json")):
        if not set(writing.contents(folder)) <= set(datasets.fields(1, 1, 1)):
            raise InputError(f"the folder {folder} holds something else already, choose another with --out.")


def _check_same(config: CollectConfig, data: Dataset) -> None:
    asked = config.identity()
    had = {"rate": 1, **present_names(data.manifest["options"])}  # earlier versions have no other rate
    for name in asked:
        if asked[name] != had.get(name):
            text = f"{flag(name)} {_short(had.get(name))}, not {_short(asked[name])}"
            raise InputError(f"{data.folder} was begun with {text}; ask for the same or choose another --out.")
    if config.batch not in (None, data.batch):
        raise InputError(f"{data.folder} was begun with --batch {data.batch}, not {config.batch}; ask for the same.")
    if config.hours < data.manifest["hours"]:
        had_hours, asked_hours = number(data.manifest["hours"]), number(config.hours)
        raise InputError(
            f"{data.folder} was begun with --hours {had_hours}, not {asked_hours}; ask for as much or more."
        )


def _check_made_with(data: Dataset, now: dict[str, Any]) -> None:
    """Refuse to go on where the description is the same, but not what it stands for: it would be two datasets in one.

    What a dataset of an earlier version does not tell is not asked.
    """
    had = data.manifest
    if (other := version_mismatch(had.get("versions"))) is not None:
        raise InputError(f"{data.folder} was begun with {other}; go on with the same, or choose another --out.")
    for name in ("environment", "people", "robot", "camera", "situations", "parts", "content"):
        if name in had and had[name] != now[name]:
            what = {"content": "content of scenario or policy", "parts": "file of your own"}.get(name, name)
            raise InputError(f"{data.folder} was begun with another {what}; restore it, or choose another --out.")


def _short(value: Any) -> str:
    """A value of a description as messages give it."""
    if isinstance(value, dict):
        rest = " ".join(f"{flag(name)} {_short(each)}" for name, each in value.items() if name != "kind")
        return f"{value.get('kind')} {rest}".strip()
    return " ".join(number(each) if not isinstance(each, dict) else _short(each) for each in _listed(value))


def _listed(value: Any) -> list:
    return value if isinstance(value, list) else [value]


def _manifest(
    config: CollectConfig, parts: dict[str, Scenario], policy: Policy, camera: sensors.Camera
) -> dict[str, Any]:
    scenarios, size = list(parts.values()), _size(config, len(parts))
    return {
        "command": _command(config, size),
        "options": config.identity(),
        **scenario_facts(scenarios[0], camera, config.policy.kind, config.rate),
        "content": fingerprint(scenarios[0], [scenario.behavior for scenario in scenarios], policy.params),
        "parts": components.digests(config),
        "hours": config.hours,
        "batch": size,
        "streams": list(parts),
    }


def _command(config: CollectConfig, batch: int) -> str:
    """That records this dataset again, in full."""
    return f"{command('collect', config)} --hours {number(config.hours)} --batch {batch}"


def scenario_facts(scenario: Scenario, camera: sensors.Camera, policy: str, rate: int = 1) -> dict[str, Any]:
    """What a manifest says of a scenario and of who drives there.

    Args:
        rate: rows a second.
    """
    image = {"width": camera.width, "height": camera.height, "fovy": camera.fovy, "far": camera.far}
    limits = {"max_speed": float(scenario.robot.max_speed), "max_turn_rate": float(scenario.robot.max_turn_rate)}
    return {
        "versions": versions(),
        "environment": scenario.environment.name,
        "behavior": scenario.behavior.name,
        "policy": policy,
        "people": scenario.people,
        "robot": {"name": scenario.robot.name, **limits},
        "camera": image,
        "situations": [name for name, _ in scenario.situations],
        "rate": float(rate),
        "seconds": math.ceil(scenario.time_limit - 1e-6),
    }


def _size(config: CollectConfig, parts: int) -> int:
    """Episodes at once, a multiple of the number of devices."""
    count = len(jax.devices())
    if config.batch is not None:
        return config.batch
    largest = MAX_BATCH.get(jax.default_backend(), MAX_BATCH_ELSEWHERE)
    largest = min(largest, max(MIN_BATCH, largest // config.rate))
    needed = math.ceil(seconds_of_each(config.hours, parts) / TYPICAL)
    return math.ceil(min(largest, max(4, needed)) / count) * count
