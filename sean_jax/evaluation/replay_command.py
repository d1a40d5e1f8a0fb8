"""``sean replay``: simulate episodes of a run, a dataset or a training again, and write a page that plays them.

An episode is drawn from a seed and its number, so any of them can be played. Alone, it may be rounded otherwise than in
a batch; if it then ends at another time than in the folder, the page gives the cause that versions and fingerprints
show.
"""

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from rich.console import Console

from sean_jax.config import ReplayConfig, RunConfig, validate
from sean_jax.core.data_types import Array, Policy, Scenario, State, Trajectory
from sean_jax.core.errors import InputError
from sean_jax.evaluation import batches, results, run_folder
from sean_jax.io import writing
from sean_jax.io.progress import Progress, progress
from sean_jax.io.versions import fingerprint, version_mismatch
from sean_jax.learning.collection import content, load_driver, stream_floors
from sean_jax.learning.networks import CONFIG, read_method
from sean_jax.learning.policy import demonstration_config, load, load_policies, read_options
from sean_jax.simulation import making
from sean_jax.simulation.episode_runner import Batch, Callbacks, Record, Runner
from sean_jax.simulation.scenario_plan import plan_scenario
from sean_jax.simulation.scenario_stack import Stack
from sean_jax.web import replay

MANIFEST = "dataset.json"
CURE = "give a folder that `sean run`, `collect`, `train` or `validate` has written."


@dataclass(frozen=True)
class ReplaySource:
    """The episodes of a folder; a ``Runner`` simulates them by number."""

    floors: list[Stack[Scenario]]  # a stack for each scenario
    policy: Policy
    use: str  # of the seed
    seed: int
    turn: Callable[[int], int]  # the user's number of an episode -> index of its scenario
    names: list[str]  # of the scenarios, in titles
    number: Callable[[int], int] = lambda number: number  # the user's number of an episode -> the one that draws it
    ends: Callable | None = None  # (scenario, before, after) -> terminations of the training, which end episodes early
    deviation: Callable[[int, int], str] = lambda number, steps: ""  # note if the folder has other than so many steps
    place: Callable[[int], int] = lambda number: 0  # the user's number of an episode -> index of its floor
    robots: int = 1  # of a team

    def run(self, runner: Runner, number: int, callbacks: Callbacks, keep_rows: bool = True) -> Batch:
        """Simulate the episode of a number alone."""
        index = np.full(runner.size, self.turn(number))
        row = self.number(number) * self.robots
        floor = self.place(number) * len(self.floors)
        return runner.run(self.seed, row, self.robots, index, callbacks, keep_rows, turn=floor)


def write(options: ReplayConfig, console: Console) -> Path:
    """Simulate the episodes and write the page.

    Raises:
        InputError: the folder has no episodes, or none of that number.
        FloatingPointError: a number is not finite.
    """
    folder = options.folder
    numbers = list(dict.fromkeys(options.episodes))
    if options.only is not None:
        raise InputError(f"only: {folder} holds no tests of `sean validate`; name episodes with --episodes.")
    path = options.out or folder / "replay.html"
    check_source(folder)
    writing.check_file(path, (".html",))
    with console.status("preparing the scenario"):
        source = read_source(folder, numbers)

    # A player for each floor, as a page's floor does not change.
    episodes: dict[int, list[replay.ReplayEpisode]] = {}
    for number, episode in _simulate(source, numbers, console):
        episodes.setdefault(source.place(number), []).append(episode)
    title = folder.resolve().name
    first = source.floors[0]
    players = []
    for place, on_floor in episodes.items():
        name = first.names[place].replace("_", " ") if first.size > source.robots and first.names else ""
        scenario = source.floors[source.turn(numbers[0])].at(place)
        players.append((name, replay.of_scenario(scenario, on_floor, f"{title} · {name}" if name else title)))
    writing.write(path, replay.html(players[0][1]) if len(players) == 1 else replay.html_of_several(players, title))
    return path


def _simulate(source: ReplaySource, numbers: list[int], console: Console) -> Iterator[tuple[int, replay.ReplayEpisode]]:
    """Each number with its episode, simulated alone."""
    floors = source.floors[0]
    robots = source.robots
    record = batches.record(floors, robots)
    record = record if source.ends is None else until_terminated(record, source.ends)
    runner = Runner(source.floors, source.policy, 1, source.use, record)
    with progress(console) as bar:
        for number, callbacks in with_progress(runner, numbers, bar):
            yield number, _episode(source, number, source.run(runner, number, callbacks))


def with_progress(runner: Runner, numbers: list[int], bar: Progress) -> Iterator[tuple[int, Callbacks]]:
    """Compile, and give each number with callbacks that show the progress of its episode."""
    runner.compile(Callbacks(compiling=bar.stage))
    time_limit = runner.scenarios[0].time_limit
    bar.start("simulating", len(numbers) * time_limit)
    for finished, number in enumerate(numbers):

        def advanced(seconds: float, _: float, finished: int = finished, number: int = number) -> None:
            bar.update(finished * time_limit + seconds, f"episode {number}")

        yield number, Callbacks(advanced=advanced)


def _episode(source: ReplaySource, number: int, batch: Batch) -> replay.ReplayEpisode:
    """The episode of a number, with its name and its end in words."""
    floors = source.floors[0]
    robots = source.robots
    frames = batches.episode_frames(batch.rows, robots, robots)[0]  # of the first robot, with the others
    seconds = min(len(frames.active), int(batch.steps[0])) * floors.member.time_step
    if len(frames.active) < batch.steps[0]:
        outcome = f"ended in {seconds:.1f} s by a termination of the training"
    else:
        outcome = results.outcome(bool(batch.states.completed[0]), seconds)
    label = f"episode {number} {floors.names[0]}" if robots > 1 else f"episode {number}"
    name = source.names[source.turn(number)].replace("_", " ")
    return replay.ReplayEpisode(frames, f"{label} · {name}", outcome + source.deviation(number, len(frames.active)))


def check_source(folder: Path) -> str:
    """The file by which the episodes of a folder are simulated again; InputError if there is none."""
    file = next((name for name in READERS if (folder / name).is_file()), None)
    if file is None:
        raise InputError(f"{folder}: holds no {', '.join(READERS)}; {CURE}")
    return file


def read_source(folder: Path, numbers: list[int]) -> ReplaySource:
    """The episodes of a folder, of which those numbers are wanted.

    Raises:
        InputError: the folder has no episodes, or none of that number.
    """
    return READERS[check_source(folder)](folder, numbers)


def _check(numbers: list[int], count: int, folder: Path) -> None:
    for number in numbers:
        if number >= count:
            raise InputError(f"episodes: {number} is none of the {count} of {folder}; they begin at 0.")


# ------------------------------------------------------------------ a run


def _of_run(folder: Path, numbers: list[int]) -> ReplaySource:
    """The episodes of ``sean run``, from its config.yaml."""
    path = folder / "config.yaml"
    before = run_folder.read_config(path)
    config = validate(RunConfig, before.description, source=path)
    _check(numbers, config.episodes, folder)
    plan = plan_scenario(config, config.team or None)
    stacks = making.build(plan, -(-config.episodes // len(plan.tasks)))
    floors = stacks[0]
    count = len(stacks)
    robots = len(plan.team) or 1
    policy = load_policies(config.policies, floors.member)
    content = floors if floors.size > 1 else floors.member
    ended = _ended(folder / "episodes.csv", robots)
    step = floors.member.time_step
    cause = _cause(before.versions, before.fingerprint, fingerprint(content, policy.params))

    def deviation(number: int, steps: int) -> str:
        if number not in ended or abs(ended[number] - steps * step) <= 0.5 * step:
            return ""
        return f" ({ended[number]:.1f} s in the run: {cause})"

    return ReplaySource(
        floors=stacks,
        policy=policy,
        use="run",
        seed=config.seed,
        turn=lambda number: number % count,
        names=[each.member.task_name for each in stacks],
        deviation=deviation,
        place=lambda number: 0 if plan.team else number // count % floors.size,
        robots=robots,
    )


def _cause(versions: Any, then: str, now: str) -> str:
    """The cause of a different episode: versions and fingerprints of scenario and policy then and now."""
    if (other := version_mismatch(versions)) is not None:
        return f"it was made with {other}"
    if not then:
        return "the folder has no fingerprint of its scenario"
    return "its rounding differs" if then == now else "its scenario or its policy was another"


def _ended(path: Path, robots: int) -> dict[int, float]:
    """Episode -> s, of the finished episodes; of a team until the episode of the last robot ends."""
    try:
        return dict(enumerate(run_folder.read_episodes(path)[1]["seconds"].reshape(-1, robots).max(1).tolist()))
    except InputError:
        return {}


# ------------------------------------------------------------------ a dataset


def _of_dataset(folder: Path, numbers: list[int]) -> ReplaySource:
    """The episodes of ``sean collect``, from its manifest; they count through all shards."""
    from sean_jax.learning.dataset import open_dataset  # which needs the extra "learning"

    data = open_dataset(folder)
    manifest = data.manifest
    size = data.batch
    config = data.description()
    _check(numbers, size * len(manifest["shards"]), folder)
    parts = stream_floors(config)
    stacks = list(parts.values())
    first = stacks[0].member
    policy = load_driver(config, first)
    cause = _cause(manifest.get("versions"), manifest.get("content", ""), content(stacks, policy))
    every = round(1.0 / first.time_step) // config.rate

    def deviation(number: int, steps: int) -> str:
        rows = manifest["shards"][number // size]["lengths"][number % size]
        if rows == -(-steps // every):
            return ""
        return f" ({rows / config.rate:.0f} s in the dataset: {cause})"

    return ReplaySource(
        floors=stacks,
        policy=policy,
        use="collect",
        seed=config.seed,
        turn=lambda number: manifest["shards"][number // size]["stream"],
        names=list(parts),
        deviation=deviation,
        place=lambda number: manifest["shards"][number // size].get("floors", [0] * size)[number % size],
    )


# ------------------------------------------------------------------ a training


def _of_training(folder: Path, numbers: list[int]) -> ReplaySource:
    """The evaluation episodes of a training, with its best network or agent as the policy."""
    if read_method(folder) in ("imitation", "dagger"):
        return _of_imitation(folder)
    from sean_jax.learning import reinforcement  # which needs the extra "learning"

    options = read_options(folder)
    scenarios, envs, _ = reinforcement.build(options)
    turns = {number % len(envs) for number in numbers}
    if len(turns) > 1:
        places = reinforcement.environment_names(options, scenarios)
        names = " and ".join(places[each] for each in sorted(turns))
        raise InputError(
            f"episodes: they take turns in {len(envs)} environments, and those are in {names}; ask for one's."
        )
    place = turns.pop()
    scenario = scenarios[place]
    envs_on_floors = envs[place]
    floors = envs_on_floors.map_member(lambda each: dataclasses.replace(each.scenario, metrics=scenario.metrics))
    mdp_env = envs_on_floors.member
    count = len(envs)
    return ReplaySource(
        floors=[floors],
        policy=load(folder, scenario),
        use="evaluation",  # its i-th key of a split is the key of number i
        seed=options.seed,
        turn=lambda number: 0,
        names=[scenario.task_name],
        number=lambda number: number // count,
        ends=mdp_env.ends if mdp_env.terminations else None,
        place=lambda number: number // count % floors.size,
    )


def _of_imitation(folder: Path) -> ReplaySource:
    """Other episodes of the scenarios of a network's demonstrations; such a network is evaluated by examples."""
    config = demonstration_config(folder)
    parts = stream_floors(config)
    stacks = list(parts.values())
    return ReplaySource(
        floors=stacks,
        policy=load(folder, stacks[0].member),
        use="evaluation",
        seed=config.seed,
        turn=lambda number: number % len(stacks),
        names=list(parts),
        place=lambda number: number // len(stacks) % stacks[0].size,
    )


def until_terminated(record: Record, ends: Callable) -> Record:
    """A record whose frames are active until a termination of the training ends the episode."""

    def init(floors: Stack[Scenario], states: State) -> tuple[Any, Array]:
        return record.init(floors, states), jnp.zeros(states.tick.shape, bool)

    def update(
        floors: Stack[Scenario], before: State, after: State, actions: Array, active: Array, total: tuple
    ) -> tuple[tuple, Trajectory]:
        inner, done = total
        ended = floors.vmap(ends)(before, after)
        inner, frames = record.update(floors, before, after, actions, active, inner)
        frames = frames.replace(active=frames.active & ~done[: frames.active.shape[0]])
        return (inner, done | jnp.stack(ended).any(0)), frames

    return Record(init, update)


READERS: dict[str, Callable[[Path, list[int]], ReplaySource]] = {
    "config.yaml": _of_run,
    MANIFEST: _of_dataset,
    CONFIG: _of_training,
}
"""File of a folder -> the reader of its episodes."""
