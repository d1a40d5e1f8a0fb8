"""The command line: ``sean run``, ``collect``, ``train``, ``experiment``, ``export``, ``draw``, ``bench``, ...

Nothing heavy is imported before a command is chosen, so that ``sean --help`` answers at once.
"""

import dataclasses
import importlib.metadata
import math
import os
import shlex
import signal
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from sean_jax import stopping
from sean_jax.bench import Options as Bench
from sean_jax.experiments.options import Experiment
from sean_jax.learning.options import Collect, Export, Failed, Train
from sean_jax.main_job.options import Options
from sean_jax.options import BadInput, check_file, check_limits, check_new_folder
from sean_jax.writing import Unwritable, broken, contents, whole

PICTURES = (".png", ".svg", ".pdf", ".jpg", ".jpeg", ".webp", ".tif", ".tiff")  # of those that matplotlib writes
LEARNING = ("optax", "orbax", "tensorstore")  # what the extra "learning" brings
WRONG, FAILED, STOPPED, TERMINATED = 2, 1, 130, 143  # exit codes: bad input, what broke midway, Ctrl-C, SIGTERM


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
    """Folder to write; it must be new or empty. Its path then serves as --environment."""
    people: int | None = None
    """Default number of people; one for each 25 m2 of free floor by default."""
    height: float = 2.0
    """Height of all obstacles in metres, for a map has none."""
    unknown: Literal["obstacle", "free"] = "obstacle"
    """What cells are that the map does not know."""

    def check(self) -> None:
        """Raises BadInput for numbers and folders that cannot be."""
        check_limits(self, {"height": (0.06, 100.0)})
        check_new_folder(self.out)


COMMANDS: dict[str, Any] = {
    "run": Options,
    "collect": Collect,
    "train": Train,
    "experiment": Experiment,
    "export": Export,
    "draw": Draw,
    "import-map": ImportMap,
    "bench": Bench,
    "list": List,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    That is 0, 2 for bad input, 1 for what broke midway, 130 for Ctrl-C and 143 for SIGTERM.
    """
    with stopping.stoppable() as received:
        code = _main(arguments)
        code = TERMINATED if code == STOPPED and signal.SIGTERM in received else code
        if code in (STOPPED, TERMINATED) and any(thread.name == stopping.COMPILER for thread in threading.enumerate()):
            os._exit(code)  # the compiler cannot be interrupted, and the interpreter would wait for it
    return code


def _main(arguments: Sequence[str] | None) -> int:
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    if arguments in (["--version"], ["-V"]):
        print(f"sean_jax {_version()}")
        return 0
    try:
        command = _parse(arguments)
        from sean_jax import compiler

        compiler.set_up()
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
    except (BadInput, Unwritable) as error:
        return _fail(str(error), WRONG)
    except Failed as error:
        return _fail(str(error), FAILED)
    except OSError as error:
        return _fail(f"{broken(error)}; nothing was written.", WRONG)
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in LEARNING:
            raise
        return _fail(f'{error.name} is missing; pip install "sean_jax[learning]".', WRONG)
    except FloatingPointError as error:
        return _fail(str(error), FAILED)
    except KeyboardInterrupt as error:
        return _fail(str(error) or "stopped; nothing was written.", STOPPED)


def _parse(arguments: list[str]) -> Any:
    """An instance of one of ``COMMANDS``. A command's own parser tells of its own help alone, where words are wrong."""
    _refuse_empty(arguments)
    config = (tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff)
    if arguments and arguments[0] in COMMANDS:
        word = arguments[0]
        return tyro.cli(COMMANDS[word], prog=f"sean {word}", args=arguments[1:], config=config)
    return tyro.extras.subcommand_cli_from_dict(
        COMMANDS,
        prog="sean",
        description="Social robot navigation in JAX: simulate, measure, report. `sean --version` names this version.",
        args=arguments,
        config=config,
    )


def _refuse_empty(arguments: list[str]) -> None:
    """An empty text is what a shell makes of a variable that is not set; as a path it would be the current folder."""
    for before, word in zip(["", *arguments], arguments, strict=False):
        option, equals, value = word.partition("=")
        if not word.strip() or (option.startswith("--") and equals and not value.strip()):
            named = option if equals else before if before.startswith("--") else "an argument"
            raise BadInput(f"{named} is an empty text; give a value, or leave the option out for its default.")


def _run(options: Options) -> int:
    from rich.console import Console

    from sean_jax import main_job

    console = Console(quiet=options.quiet)
    folder, episodes = main_job.run(options, console)
    _say(console, "report: ", folder / "report.html")
    if episodes < options.episodes:
        said = f"stopped; the {episodes} episodes finished until then are in {folder}"
        return _fail(f"{said}, and the same command with --out {folder} goes on.", STOPPED)
    return 0


def _draw(command: Draw) -> int:
    if command.graph == command.handcrafted:
        return _fail("draw: give either --graph or --handcrafted.", WRONG)
    what = "graph" if command.graph else "handcrafted"
    check_file(command.out or Path(f"{what}.png"), PICTURES)
    from sean_jax import assembly, drawing, environment

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
                check_file(file, PICTURES)
            with whole(file) as stream:
                sheet.savefig(stream, dpi=150, format=file.suffix[1:].lower())
        except ValueError as error:
            return _fail(str(error), WRONG)
        print(file)
    return 0


def _bench(options: Bench) -> int:
    from rich.console import Console

    from sean_jax import bench

    console = Console(quiet=options.quiet)
    folder = bench.run(options, console)
    _say(console, "picture: ", folder / "bench.png")
    return 0


def _learn(command: Collect | Train | Export | Experiment) -> int:
    """Collect, train, export or experiment; what is done when something goes wrong, or at Ctrl-C, is kept."""
    command.check()
    from rich.console import Console

    from sean_jax import learning

    console = Console(quiet=command.quiet)
    folder = command.folder
    try:
        if isinstance(command, Collect):
            data = learning.collect(command, console)
            _say(console, f"{data.examples} examples in {len(data.episodes)} episodes: ", folder)
        elif isinstance(command, Train):
            state = learning.train(command, console)
            best = f"least loss in validation {float(state.best):.4f} after {int(state.best_epoch)}"
            _say(console, f"{int(state.epoch)} epochs, {best}: ", folder)
            _say(console, "next: ", shlex.join(["sean", "run", "--policy", str(folder)]))
        elif isinstance(command, Experiment):
            _say(console, "report: ", _experiment(command, console) / "report.html")
        else:
            _say(console, "written: ", learning.export(command.dataset, command.out))
    except FloatingPointError as error:
        return _fail(str(error), FAILED)
    except (OSError, KeyboardInterrupt) as error:
        kept = f"what was finished until then is in {folder}, and the same command goes on"
        kept = f"{kept if contents(folder) else 'nothing was written'}."
        if isinstance(error, KeyboardInterrupt):
            return _fail(f"stopped; {kept}", STOPPED)
        return _fail(f"{broken(error)}; {kept}", FAILED)
    return 0


def _experiment(command: Experiment, console: Any) -> Path:
    if command.which == "table1":
        from sean_jax.experiments import table1

        return table1.run(command, console)
    from sean_jax.experiments import figure4

    return figure4.run(command, console)


def _import_map(command: ImportMap) -> int:
    command.check()
    from sean_jax import maps

    options = dataclasses.asdict(command)
    try:
        made = maps.import_map(options.pop("map"), options.pop("out"), **options)
    except ValueError as error:
        return _fail(str(error), WRONG)
    share = math.floor(made.agreement * 1e4) / 1e2  # rounded up, 99.999 % would read as all
    print(f"{made.folder}: {made.boxes} boxes describe {share:.2f} % of the map's {made.cells} cells.")
    again = shlex.join(["sean", "run", "--environment", str(made.folder), "--behavior", "random"])
    print(f"next: {again}, or write a graph.yaml.")
    return 0


def _say(console: Any, what: str, where: Path | str) -> None:
    """A line whose words rich takes for neither markup nor emoji, as a path may hold both."""
    from rich.text import Text

    console.print(Text.assemble(what, (str(where), "bold")), soft_wrap=True)


def _fail(sentence: str, code: int) -> int:
    from rich.console import Console
    from rich.text import Text

    sys.stdout.flush()
    Console(stderr=True).print(Text.assemble(("sean:", "bold red"), " ", sentence), soft_wrap=True)
    return code


def _version() -> str:
    try:
        return importlib.metadata.version("sean-jax")
    except importlib.metadata.PackageNotFoundError:
        return "(not installed)"


if __name__ == "__main__":
    sys.exit(main())
