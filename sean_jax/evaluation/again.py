"""``sean replay``: episodes of a run once more, from its config.yaml, on a page that plays them.

An episode is drawn from the run's seed and its number, so any of them can be seen, not only those whose frames were
kept. Simulated by itself, its numbers are rounded otherwise than in a batch; where it then ends at another time than
episodes.csv says, the page tells.
"""

import csv
from pathlib import Path

from rich.console import Console

from sean_jax import assembly, files, replay, writing
from sean_jax.config import ReplayConfig, RunConfig, validate
from sean_jax.errors import InputError
from sean_jax.evaluation import output, tally
from sean_jax.learning import choice
from sean_jax.progress import progress
from sean_jax.runner import Runner, Watch


def write(options: ReplayConfig, console: Console) -> Path:
    """Simulate the episodes and write the page.

    Args:
        options: which run and which episodes.
        console: shows the progress.

    Returns:
        The file.

    Raises:
        InputError: the folder holds no run, or has no episode of that number.
        FloatingPointError: a number is not finite.
    """
    folder = options.run
    if not (folder / "config.yaml").is_file():
        raise InputError(f"{folder}: holds no config.yaml; give a folder that `sean run` has written.")
    path = options.out or folder / "replay.html"
    writing.check_file(path, (".html",))
    config = validate(RunConfig, output.read_config(folder / "config.yaml"))
    ended = _ended(folder / "episodes.csv")
    for number in options.episodes:
        if number >= config.episodes:
            raise InputError(f"episodes: {number} is none of the {config.episodes} of {folder}; they begin at 0.")
    with console.status("preparing the scenario"):
        scenarios = assembly.build(config)
        policy = choice.policy(config.policy, scenarios[0])
    runner = Runner(scenarios, policy, 1, "run", tally.record(scenarios[0], 1))
    shown = []
    with progress(console) as tell:
        runner.compile(Watch(compiling=tell.stage))
        limit = scenarios[0].time_limit
        tell.start("simulating", len(options.episodes) * limit)
        for done, number in enumerate(dict.fromkeys(options.episodes)):

            def advanced(seconds: float, _: float, done: int = done, number: int = number) -> None:
                tell.update(done * limit + seconds, f"episode {number}")

            batch = runner.run(config.seed, number, 1, watch=Watch(advanced=advanced))
            (frames,) = tally.episodes(batch.rows, 1)
            seconds = float(batch.steps[0]) * scenarios[0].time_step
            outcome = output.outcome(bool(batch.states.completed[0]), seconds)
            if number in ended and abs(ended[number] - seconds) > 0.5 * scenarios[0].time_step:
                outcome += f" ({ended[number]:.1f} s in the run, where numbers were rounded otherwise)"
            task = scenarios[number % len(scenarios)].task_name.replace("_", " ")
            shown.append(replay.Episode(frames, f"episode {number} · {task}", outcome))
    writing.write(path, replay.html(replay.of_scenario(scenarios[0], shown, folder.resolve().name)))
    return path


def _ended(path: Path) -> dict[int, float]:
    """Episode -> s, as far as the run has told."""
    try:
        rows = csv.DictReader(files.read_text(path).splitlines())
        return {int(row["episode"]): float(row["seconds"]) for row in rows}
    except (InputError, KeyError, TypeError, ValueError):
        return {}
