"""The command line: ``sean run``, ``collect``, ``train``, ``experiment``, ``export``, ``draw``, ``bench``, ...

Nothing heavy is imported before a command is chosen, so that ``sean --help`` answers at once.
"""

import dataclasses
import importlib.metadata
import math
import os
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from sean_jax.bench import Options as Bench
from sean_jax.experiments.options import Experiment
from sean_jax.learning.options import Collect, Export, Failed, Refused, Train
from sean_jax.main_job.options import BadInput, Options

WRONG, FAILED, STOPPED = 2, 1, 130  # exit codes: bad input, a broken simulation, Ctrl-C


@dataclasses.dataclass(frozen=True)
class List:
    """What there is to choose from for each option."""


@dataclasses.dataclass(frozen=True)
class Draw:
    """Draw what people do in the environments: their behavior graphs, or all handcrafted sets."""

    graph: bool = False
    """The behavior graph, with its groups seated."""
    handcrafted: bool = False
    """The handcrafted sets, one panel each."""
    environment: str | None = None
    """Environment: a name, or the folder of your own; all that come with the package by default."""
    out: Path | None = None
    """File to write, such as sheet.png or sheet.svg; of several environments, each adds its name."""


@dataclasses.dataclass(frozen=True)
class ImportMap:
    """Make an environment of a ROS map, the YAML file of a map_server with its image."""

    map: Annotated[Path, tyro.conf.Positional]
    """YAML file of the map."""
    out: Path
    """Folder to write; it must not exist or be empty. Its path then serves as --environment."""
    people: int | None = None
    """Default number of people; one for each 25 m2 of free floor by default."""
    height: float = 2.0
    """Height of all obstacles in metres, for a map has none."""
    unknown: Literal["obstacle", "free"] = "obstacle"
    """What cells are that the map does not know."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code: 0, or 2 for bad input, 1 for a NaN, 130 for Ctrl-C."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    if arguments in (["--version"], ["-V"]):
        print(f"sean_jax {_version()}")
        return 0
    try:
        command = _parse(arguments)
        cache_compilations()
        if isinstance(command, List):
            from sean_jax.main_job import choices

            choices.print_choices()
            return 0
        if isinstance(command, ImportMap):
            return _import_map(command)
        if isinstance(command, Draw):
            return _draw(command)
        if isinstance(command, Bench):
            return _bench(command)
        if isinstance(command, Collect | Train | Export | Experiment):
            return _learn(command)
        return _run(command)
    except (BadInput, Refused) as error:
        return _fail(str(error), WRONG)
    except Failed as error:
        return _fail(str(error), FAILED)
    except OSError as error:
        where = f" ({error.filename})" if error.filename else ""
        return _fail(f"{(error.strerror or str(error)).lower()}{where}; nothing was written.", WRONG)
    except FloatingPointError as error:
        return _fail(f"{error} Nothing was written; earlier runs are as they were.", FAILED)
    except KeyboardInterrupt:
        code = _fail("stopped before a batch of episodes was finished; nothing was written.", STOPPED)
        if any(thread.name == "sean-compiler" for thread in threading.enumerate()):
            os._exit(code)  # the compiler cannot be interrupted, and the interpreter would wait for it
        return code


def cache_compilations() -> None:
    """Let JAX keep what it compiles in the user's cache folder; what the user has set already is respected."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "sean_jax" / "xla"
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")


def _parse(arguments: list[str]) -> Options | Collect | Train | Experiment | Export | Draw | ImportMap | Bench | List:
    commands = (
        Annotated[Options, tyro.conf.subcommand("run", default=Options())]
        | Annotated[Collect, tyro.conf.subcommand("collect")]
        | Annotated[Train, tyro.conf.subcommand("train")]
        | Annotated[Experiment, tyro.conf.subcommand("experiment")]
        | Annotated[Export, tyro.conf.subcommand("export")]
        | Annotated[Draw, tyro.conf.subcommand("draw", default=Draw())]
        | Annotated[ImportMap, tyro.conf.subcommand("import-map")]
        | Annotated[Bench, tyro.conf.subcommand("bench", default=Bench())]
        | Annotated[List, tyro.conf.subcommand("list", default=List())]
    )
    return tyro.cli(
        commands,  # pyright: ignore[reportArgumentType]
        prog="sean",
        description="Social robot navigation in JAX: simulate, measure, report. `sean --version` names this version.",
        args=arguments,
        config=(tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff),
    )


def _run(options: Options) -> int:
    from rich.console import Console

    from sean_jax import main_job

    console = Console(quiet=options.quiet)
    folder, episodes = main_job.run(options, console)
    console.print(f"report: [bold]{folder / 'report.html'}[/]", highlight=False, soft_wrap=True)
    if episodes < options.episodes:
        return _fail(f"stopped; the {episodes} episodes finished until then are in {folder}.", STOPPED)
    return 0


def _draw(command: Draw) -> int:
    if command.graph == command.handcrafted:
        return _fail("draw: give either --graph or --handcrafted.", WRONG)
    from sean_jax import assembly, drawing, environment

    what = "graph" if command.graph else "handcrafted"
    names = environment.available() if command.environment is None else [command.environment]
    for name in names:
        task = "handcrafted" if command.handcrafted else "random_ab_nav"
        try:
            scenario = assembly.make(name, behavior=what, task=task, dynamics="twin")
            graph = drawing.graph_of(scenario)
            sheet = drawing.graph_sheet(scenario.environment, graph) if graph else drawing.handcrafted_sheet(scenario)
            file = command.out or Path(f"{what}.png")
            if command.out is None or len(names) > 1:
                file = file.with_stem(f"{file.stem}-{scenario.environment.name}")
            sheet.savefig(file, dpi=150)
        except ValueError as error:
            return _fail(str(error), WRONG)
        print(file)
    return 0


def _bench(options: Bench) -> int:
    from rich.console import Console

    from sean_jax import bench

    console = Console(quiet=options.quiet)
    folder = bench.run(options, console)
    console.print(f"picture: [bold]{folder / 'bench.png'}[/]", highlight=False, soft_wrap=True)
    return 0


def _learn(command: Collect | Train | Export | Experiment) -> int:
    """Collect, train, export or experiment; what is done when something goes wrong, or at Ctrl-C, is kept."""
    from rich.console import Console

    from sean_jax import learning

    console = Console(quiet=command.quiet)
    folder = command.folder
    try:
        if isinstance(command, Collect):
            data = learning.collect(command, console)
            said = f"{data.examples} examples in {len(data.episodes)} episodes: [bold]{folder}[/]"
        elif isinstance(command, Train):
            state = learning.train(command, console)
            best = f"least loss in validation {float(state.best):.4f} after {int(state.best_epoch)}"
            said = f"{int(state.epoch)} epochs, {best}: [bold]{folder}[/]\nnext: sean run --policy {folder}"
        elif isinstance(command, Experiment):
            said = f"report: [bold]{_experiment(command, console) / 'report.html'}[/]"
        else:
            said = f"written: [bold]{learning.export(command.dataset, command.out)}[/]"
    except FloatingPointError as error:
        return _fail(str(error), FAILED)
    except ModuleNotFoundError as error:
        return _fail(f'{error.name} is missing; pip install "sean_jax[learning]".', WRONG)
    except KeyboardInterrupt:
        return _fail(f"stopped; what was finished until then is in {folder}, and the same command goes on.", STOPPED)
    console.print(said, highlight=False, soft_wrap=True)
    return 0


def _experiment(command: Experiment, console: Any) -> Path:
    if command.which == "table1":
        from sean_jax.experiments import table1

        return table1.run(command, console)
    from sean_jax.experiments import figure4

    return figure4.run(command, console)


def _import_map(command: ImportMap) -> int:
    from sean_jax import maps

    options = dataclasses.asdict(command)
    try:
        made = maps.import_map(options.pop("map"), options.pop("out"), **options)
    except ValueError as error:
        return _fail(str(error), WRONG)
    share = math.floor(made.agreement * 1e4) / 1e2  # rounded up, 99.999 % would read as all
    print(f"{made.folder}: {made.boxes} boxes describe {share:.2f} % of the map's {made.cells} cells.")
    print(f"next: sean run --environment {made.folder} --behavior random --task random_ab_nav, or write a graph.yaml.")
    return 0


def _fail(sentence: str, code: int) -> int:
    from rich.console import Console

    sys.stdout.flush()
    Console(stderr=True).print(f"[bold red]sean:[/] {_escape(sentence)}", highlight=False, soft_wrap=True)
    return code


def _escape(text: str) -> str:
    from rich.markup import escape

    return escape(text)


def _version() -> str:
    try:
        return importlib.metadata.version("sean-jax")
    except importlib.metadata.PackageNotFoundError:
        return "(not installed)"


if __name__ == "__main__":
    sys.exit(main())
