"""The command line: ``sean run``, ``collect``, ``train``, ``experiment``, ``export``, ``draw``, ``bench``, ...

Nothing heavy is imported before a command is chosen, so that ``sean --help`` answers at once.
"""

import json
import logging
import math
import os
import shlex
import signal
import sys
import threading
import traceback
from collections.abc import Sequence
from contextlib import nullcontext
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sean_jax import __version__, config
from sean_jax.config import COMMANDS, GROUPS, Config
from sean_jax.core.errors import IncompleteError, InputError, PartError
from sean_jax.core.messages import suggest
from sean_jax.io import interrupts
from sean_jax.io.writing import atomic_file, atomic_folder, broken, check_file, check_new_folder, contents

if TYPE_CHECKING:
    from rich.console import Console

    from sean_jax.core.data_types import Scenario

PICTURES = (".png", ".svg", ".pdf", ".jpg", ".jpeg", ".webp", ".tif", ".tiff")  # that matplotlib writes
MAX_FLOORS = 40  # of a picture
LEARNING = ("cmaes", "optax", "orbax", "tensorstore")  # packages of the extra "learning"
RESUMABLE = ("collect", "train", "experiment", "export", "calibrate", "benchmark", "validate")
READERS = (
    "run",
    "collect",
    "train",
    "experiment",
    "export",
    "replay",
    "benchmark",
    "studio",
    "bridge",
)  # may run code that a file names
CONFIGURABLE = ("run", "train")  # take their options from a file, too
EXPERIMENTS = {"table1": "table1", "ablation": "table1", "figure4": "figure4", "learning_curve": "figure4"}  # -> module
OUT_OF_MEMORY = (
    "the device is out of memory; set XLA_PYTHON_CLIENT_MEM_FRACTION=0.95 (JAX takes 0.75 of a GPU), "
    "or choose fewer episodes or scenarios at once. The same command resumes an unfinished experiment."
)
TRACEBACK = "--traceback"  # of any command
WRONG, FAILED, STOPPED, TERMINATED = 2, 1, 130, 143  # exit codes: bad input, broken midway, Ctrl-C, SIGTERM


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: the words after ``sean``; sys.argv if None.

    Returns:
        The exit code: 0, 2 for bad input, 1 for work that broke midway, 130 for Ctrl-C and 143 for SIGTERM.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    if arguments is None:  # then the process is ours
        _mute_orbax()
    if traced := TRACEBACK in words:
        words.remove(TRACEBACK)
    code, received = STOPPED, []
    try:
        with interrupts.interruptible() as received:
            code = _main(words, traced)
    except KeyboardInterrupt:  # at the very end, while memory is freed, or a second one during the answer to the first
        pass
    except Exception as error:
        if arguments is not None or not interrupts.is_compiling():
            raise
        sys.excepthook(type(error), error, error.__traceback__)
        code = FAILED
    code = TERMINATED if code == STOPPED and signal.SIGTERM in received else code
    if arguments is None and interrupts.is_compiling():
        sys.stdout.flush()
        os._exit(code)  # the compiler cannot be interrupted, and the interpreter would wait for it
    if code in (FAILED, STOPPED, TERMINATED) and _is_joined():
        sys.stdout.flush()
        os._exit(code)  # without jax.distributed's exit barrier: other hosts may be blocked on this one
    return code


def _mute_orbax() -> None:
    """Print no traceback besides the raised error: of orbax's tasks, and of threads that find its loop closed."""
    logging.getLogger("absl").disabled = True  # orbax logs every step
    logging.getLogger("asyncio").addFilter(lambda record: "orbax" not in record.getMessage())
    hook = sys.unraisablehook

    def unraisable(event: Any) -> None:
        closed = isinstance(event.exc_value, RuntimeError) and "Event loop is closed" in str(event.exc_value)
        if not closed or threading.current_thread() is threading.main_thread():
            hook(event)

    sys.unraisablehook = unraisable


def _is_joined() -> bool:
    """Whether this process is one of several that train together."""
    jax = sys.modules.get("jax")
    return jax is not None and jax.distributed.is_initialized()


def _main(words: list[str], traced: bool) -> int:
    """The exit code of a command; ``traced`` prints the traceback of an error before its sentence."""
    if words in (["--version"], ["-V"]):
        print(f"sean_jax {__version__}")
        return 0
    if not words or words[0] in ("--help", "-h"):
        print(_help())
        return 0 if words else WRONG
    if words[0] in GROUPS and words[1:2] in (["--help"], ["-h"]):
        print(_help(words[0]))
        return 0
    try:
        model = _model(words)
        _refuse_empty(words)
        from sean_jax.config import flags

        word, arguments = words[0], words[1:]
        parsed = flags.parse(word, model, arguments, configurable=word in CONFIGURABLE, trust=word in READERS)
        from sean_jax.cli import xla_flags
        from sean_jax.config import user_parts

        with user_parts.read_once(), user_parts.trust() if getattr(parsed, "trust", False) else nullcontext():
            xla_flags.configure()  # before JAX is imported, as by code of the user's own
            options = _read(model, parsed)
            return _execute(word, options)
    except InputError as error:
        if traced:
            traceback.print_exception(error)
        return _fail(_hinted(error, traced), WRONG)
    except (IncompleteError, FloatingPointError) as error:
        return _fail(str(error), FAILED)
    except OSError as error:
        return _fail(f"{broken(error)}; nothing was written.", WRONG)
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in LEARNING:
            raise
        return _fail(f'{error.name} is missing; pip install "sean_jax[learning]".', WRONG)
    except RuntimeError as error:
        from sean_jax.core.devices import is_out_of_memory

        if not is_out_of_memory(error):
            raise
        if traced:
            traceback.print_exception(error)
        return _fail(OUT_OF_MEMORY, FAILED)
    except KeyboardInterrupt as error:
        return _fail(str(error) or "stopped; nothing was written.", STOPPED)


def _hinted(error: InputError, traced: bool) -> str:
    """The sentence of an error; for one in the user's own code, with the option that shows its traceback."""
    if traced or not isinstance(error, PartError) or error.__cause__ is None:
        return str(error)
    return f"{str(error).rstrip('.')} ({TRACEBACK} shows where it comes from)."


def _words(group: str = "") -> dict[str, str]:
    """The words that can follow ``sean``, or ``sean train`` of a group, with their summaries."""
    start = f"{group} " if group else ""
    commands = {name.removeprefix(start): model for name, model in COMMANDS.items() if name.startswith(start)}
    return {name.split()[0]: _summary(model.__doc__) for name, model in commands.items()} | ({} if group else GROUPS)


def _summary(text: str | None) -> str:
    """The first sentence of a text."""
    return " ".join((text or "").split()).partition(". ")[0].rstrip(".") + "."


def _help(group: str = "") -> str:
    """The commands, or the commands of a group, a line each."""
    words, sean = _words(group), f"sean {group}".strip()
    width = max(map(len, words))
    lines = [f"  {word:<{width}}  {summary}" for word, summary in words.items()]
    about = GROUPS.get(group, "Social robot navigation in JAX: simulate, measure, report.")
    tail = f"For options: `{sean} COMMAND --help`; `sean --version` shows this version, {TRACEBACK} where an error is."
    return "\n".join([f"usage: {sean} COMMAND [OPTIONS]\n\n{about}\n\ncommands:", *lines, "", tail])


def _model(words: list[str]) -> type[Config]:
    """The options of a command.

    Raises:
        InputError: there is no such command.
    """
    group = words[0] if words[0] in GROUPS else ""
    name = " ".join(words[:2] if group else words[:1])
    if name not in COMMANDS:
        word, known = name.removeprefix(group).strip(), _words(group)
        cure = suggest(word, known) or f"; `{f'sean {group}'.strip()} --help` describes them."
        raise InputError(f"{group and f'{group}: '}'{word}' is not one of {', '.join(known)}{cure}")
    return COMMANDS[name]


def _read(model: type[Config], parsed: Any) -> Any:
    """The options of parsed flags, and of the file of --config."""
    from sean_jax.config import flags

    base = None
    if getattr(parsed, "config", None) is not None:
        from sean_jax.evaluation.run_folder import read_config

        saved = read_config(parsed.config)
        base = saved.description
        try:
            words = {name: getattr(parsed, name) for name in flags.positionals(model)}
            config.validate(model, base | words, source=parsed.config)
        except InputError as error:
            raise InputError(f"{parsed.config}: {error}") from None
    source = parsed.config if base is not None else None
    options = flags.read(model, parsed, base, source, typed=True)
    if source is not None:
        _refuse_open_port(options, parsed, source)
    return options


def _refuse_open_port(options: config.Config, parsed: Any, source: Path) -> None:
    """Refuse a port that other computers reach, unless the user types its address or trusts the file that has it."""
    if isinstance(options, config.BridgeConfig):
        field, place = "address", options.place
    else:
        field, policy = "policy", getattr(options, "policy", None)
        place = config.outside(policy) if isinstance(policy, config.Component) else None
    if place is None or getattr(parsed, field, None) is not None:
        return
    from sean_jax.config import user_parts
    from sean_jax.ros.names import is_open

    if user_parts.is_trusting() or not is_open(place):
        return
    raise InputError(
        f"{field}: {source} opens {place[1]} to other computers, and you did not; "
        f"type --{field} yourself, or add --trust."
    )


def _refuse_empty(arguments: list[str]) -> None:
    """Refuse an empty text, as from a shell variable that is not set: as a path it would be the current folder."""
    for before, word in zip(["", *arguments], arguments, strict=False):
        option, equals, value = word.partition("=")
        if not word.strip() or (option.startswith("--") and equals and not value.strip()):
            name = option if equals else before if before.startswith("--") else "an argument"
            raise InputError(f"{name} is an empty text; give a value, or leave the option out for its default.")


def _execute(word: str, options: Any) -> int:
    """The exit code of a command; resumable work keeps its finished parts after an error or Ctrl-C."""
    from rich.console import Console

    try:
        with interrupts.unwrapped():
            return _DO[word](options, Console(quiet=getattr(options, "quiet", False))) or 0
    except (OSError, KeyboardInterrupt) as error:
        if word not in RESUMABLE or isinstance(options, config.BenchmarkRankConfig | config.BenchmarkVerifyConfig):
            raise
        rest = f"finished parts are in {options.folder}, and the same command resumes"
        rest = f"{rest if contents(options.folder) else 'nothing was written'}."
        if isinstance(error, KeyboardInterrupt):
            return _fail(f"stopped; {rest}", STOPPED)
        return _fail(f"{broken(error)}; {rest}", FAILED)


def _run(options: config.RunConfig, console: "Console") -> int:
    with console.status("importing JAX"):
        from sean_jax import evaluation
    folder, results = evaluation.run(options, console, _outside(options.policy, console))
    _print(console, "report: ", folder / "report.html")
    if results.episodes < options.episodes:
        text = f"stopped; the {results.episodes} finished episodes are in {folder}"
        return _fail(f"{text}, and the same command with --out {folder} resumes it.", STOPPED)
    return 0


def _outside(policy: config.Component, console: "Console") -> Any:
    """A function of a scenario that connects the controller of a policy's name; None if the policy is inside."""
    place = config.outside(policy)
    if place is None:
        return None
    from sean_jax.ros import bridge

    last: bridge.Driver | None = None

    def connect(scenario: "Scenario") -> "bridge.Driver":
        nonlocal last
        last = bridge.Driver(scenario, policy.kind, place, console, last.now if last else 0)  # time never goes back
        return last

    return connect


def _collect(options: config.CollectConfig, console: "Console") -> None:
    from sean_jax import learning

    data = learning.collect(options, console)
    _print(console, f"{data.example_count} examples in {len(data.episodes)} episodes: ", options.folder)


def _train(options: config.ImitationConfig | config.ReinforcementConfig, console: "Console") -> None:
    if isinstance(options, config.ReinforcementConfig) and options.distributed:
        console.quiet |= _join() > 0
    from sean_jax import learning
    from sean_jax.config import user_parts

    if isinstance(options, config.ImitationConfig):
        train = learning.dagger.train if isinstance(options, config.DaggerConfig) else learning.train
        state = train(options, console)  # pyright: ignore[reportArgumentType]
        best = f"smallest loss in validation {float(state.best):.4f} after {int(state.best_epoch)}"
        _print(console, f"{int(state.epoch)} epochs, {best}: ", options.folder)
    else:
        import numpy as np

        from sean_jax.learning.trainer import read_metrics

        state = learning.reinforcement.train(options, console)
        value, after = map(np.asarray, (state.best.value, state.best.update))
        best = f"best evaluation: return {value.max():.2f}"
        lines = read_metrics(options.folder)
        line = next((line for line in lines if line["epoch"] == after[value.argmax()]), {})
        own = line.get(f"agent {value.argmax()}", line.get("evaluation", {}))
        if "completed" in own:
            best += f", {own['completed']:.0%} completed"
        _print(console, f"{int(state.update)} updates, {best} after {after[value.argmax()]}: ", options.folder)
    trained = options.as_run() if isinstance(options, config.ReinforcementConfig) else None
    _print(console, "next: ", _drive(options.folder, bool(user_parts.digests(options)), trained))


def _join() -> int:
    """Join the other processes of the training, before any device is used; the number of this one."""
    import jax

    try:
        jax.distributed.initialize()
    except (ValueError, RuntimeError) as error:
        why = str(error).splitlines()[0].rstrip(".")
        text = f"--distributed: no other processes were found ({why})"
        raise InputError(f"{text}; start all of them by srun or mpirun, or leave it out.") from error
    return jax.process_index()


def _drive(folder: Path, trust: bool = False, options: config.RunConfig | None = None) -> str:
    """The command for episodes of the policy in a folder; a name alone could be a policy of the package.

    Args:
        options: of the scenario, all by default.
    """
    from sean_jax.config import flags

    policy = str(folder) if folder.name != str(folder) else f"./{folder}"
    scenario = shlex.split(flags.command("run", options, chosen=True))[2:] if options is not None else []
    return shlex.join(["sean", "run", "--policy", policy, *scenario, *["--trust"] * trust])


def _experiment(options: config.ExperimentConfig, console: "Console") -> None:
    module = import_module(f"sean_jax.studies.experiments.{EXPERIMENTS[options.which]}")
    folder = getattr(module, f"run_{options.which}")(options, console)
    _print(console, "report: ", folder / "report.html")


def _benchmark(
    options: config.BenchmarkConfig | config.BenchmarkRankConfig | config.BenchmarkVerifyConfig, console: "Console"
) -> int:
    if isinstance(options, config.BenchmarkRankConfig):
        from sean_jax.studies.experiments import ranking

        console.print(ranking.run(options).table(), highlight=False, markup=False)
        _print(console, "report: ", options.folder / ranking.REPORT)
        return 0
    if isinstance(options, config.BenchmarkVerifyConfig):
        from sean_jax.studies.experiments import verification

        lines, failed = verification.verify(options, console)
        console.print("\n".join(lines), highlight=False, markup=False)
        return _fail(f"{options.result}: {failed}", FAILED) if failed else 0
    from sean_jax.studies.experiments import benchmark

    outside = _outside(config.Named(kind=options.policy), console)
    folder = benchmark.run(options, console, outside)
    console.print(benchmark.table(benchmark.check(folder)), highlight=False, markup=False)
    _print(console, "report: ", folder / benchmark.REPORT)
    return 0


def _export(options: config.ExportConfig, console: "Console") -> None:
    if isinstance(options, config.ExportMapConfig):
        return _export_map(options, console)
    if isinstance(options, config.ExportBagConfig):
        check_new_folder(options.out)
        from sean_jax.evaluation import bag_command

        folder, count = bag_command.write(options, console)
        return _print(console, f"{count} messages: ", folder)
    if options.format == "onnx":
        check_file(options.out, [".onnx"])
        from sean_jax.learning import onnx

        return _print(console, "written: ", onnx.export(options.source, options.out))
    check_new_folder(options.out)
    from sean_jax import learning
    from sean_jax.config import user_parts

    write = learning.pack if options.format == "agent" else learning.export
    _print(console, "written: ", write(options.source, options.out))
    if options.format == "agent":
        _print(console, "next: ", _drive(options.out, (options.out / user_parts.PARTS).is_dir()))


def _export_map(options: config.ExportMapConfig, console: "Console") -> None:
    check_file(options.out, [".yaml"])
    from sean_jax.world import environment, ros_map

    raster = ros_map.export_map(environment.load(options.source), options.out, options.resolution, options.height)
    rows, columns = raster.occupied.shape
    _print(console, f"{columns} x {rows} cells of {options.resolution:g} m: ", options.out)


def _calibrate(options: config.CalibrateConfig, console: "Console") -> None:
    from sean_jax.studies import calibration

    folder = calibration.run(options, console)
    _print(console, "report: ", folder / "report.html")
    _print(console, "next: ", shlex.join(["sean", "run", "--forces", str(folder / "forces.yaml")]))


def _fit_graph(options: config.FitGraphConfig, console: "Console") -> None:
    check_new_folder(options.folder)
    with console.status("importing JAX"):
        from sean_jax.studies import inverse_graph
    for line in inverse_graph.run(options, console):
        _print(console, line, "")
    _print(console, "written: ", options.folder)
    _print(console, "next: ", shlex.join(["sean", "run", "--environment", str(options.folder), "--behavior", "graph"]))


def _draw(options: config.DrawConfig, console: "Console") -> int:
    if options.graph == options.handcrafted:
        return _fail("draw: give either --graph or --handcrafted.", WRONG)
    what = "graph" if options.graph else "handcrafted"
    check_file(options.out or Path(f"{what}.png"), PICTURES)
    from sean_jax import drawing
    from sean_jax.simulation import making
    from sean_jax.world import environment

    names = environment.available() if options.environment is None else [options.environment]
    for name in names:
        task = "handcrafted" if options.handcrafted else "random_ab_nav"
        own = {"sets": options.sets} if options.handcrafted else {}
        scenario = making.make(name, behavior=what, task=task, **own)
        graph = drawing.graph_of(scenario)
        sheet = drawing.graph_sheet(scenario.environment, graph) if graph else drawing.handcrafted_sheet(scenario)
        file = options.out or Path(f"{what}.png")
        if options.out is None or len(names) > 1:
            file = file.with_stem(f"{file.stem}-{scenario.environment.name}")
            check_file(file, PICTURES)
        with atomic_file(file) as stream:
            sheet.savefig(stream, dpi=150, format=file.suffix[1:].lower())
        print(file)
    return 0


def _replay(options: config.ReplayConfig, console: "Console") -> None:
    if (options.folder / "results.json").is_file():
        from sean_jax.studies.validation.page import write_replay as write
    else:
        from sean_jax.evaluation.replay_command import write

    _print(console, "replay: ", write(options, console))


def _studio(options: config.StudioConfig, console: "Console") -> None:
    if options.survey is not None:
        from sean_jax.studies import survey

        return survey.run(options, console)
    from sean_jax.web import studio

    studio.run(options, console)


def _bridge(options: config.BridgeConfig, console: "Console") -> None:
    from sean_jax.ros import bridge

    bridge.run(options, console)


def _survey(
    options: config.SurveyExportConfig | config.SurveyReportConfig | config.SurveyRatingsConfig, console: "Console"
) -> None:
    if isinstance(options, config.SurveyRatingsConfig):
        check_new_folder(options.out)
        with console.status("importing JAX"):
            from sean_jax.studies.survey import ratings

        return _print(console, "report: ", ratings.run(options, console))
    from sean_jax.studies.survey.answers import FILE, Answers

    answers = Answers(options.folder / FILE)
    if isinstance(options, config.SurveyReportConfig):
        from sean_jax.studies.survey import report

        return _print(console, "report: ", report.run(answers, options, console))
    from sean_jax.studies.survey import export

    for file in export.export(answers, options.out or options.folder / "tables"):
        print(file)


def _compare(options: config.CompareConfig, console: "Console") -> None:
    from sean_jax.evaluation import compare

    _print(console, "page: ", compare.compare(options, console))


def _doctor(options: config.DoctorConfig, console: "Console") -> None:
    from rich.table import Table
    from rich.text import Text

    from sean_jax.cli import doctor

    table = Table(box=None, pad_edge=False, show_header=False)
    for finding in doctor.examine():
        text = Text(finding.value)
        if finding.cure:
            text.append(f"\n{finding.cure}", "bold yellow")
        table.add_row(Text(finding.what, "dim"), text)
    console.print(table)


def _bench(options: config.BenchConfig, console: "Console") -> None:
    with console.status("importing JAX"):
        from sean_jax.cli import bench
    _print(console, "picture: ", bench.run(options, console) / "bench.png")


def _validate(options: config.ValidateConfig, console: "Console") -> int:
    with console.status("importing JAX"):
        from sean_jax.studies import validation
    failed = validation.run(options, console)
    _print(console, "report: ", options.folder / "report.html")
    if failed and options.strict:
        return _fail(f"{len(failed)} checks fail: {', '.join(failed)}.", FAILED)
    return 0


def _import_map(options: config.ImportMapConfig, console: "Console") -> None:
    check_new_folder(options.out)
    from sean_jax.world import ros_map

    result = ros_map.import_map(
        options.map, options.out, people=options.people, height=options.height, unknown=options.unknown
    )
    share = math.floor(result.agreement * 1e4) / 1e2  # rounded up, 99.999 % would read as all
    print(f"{result.folder}: {result.boxes} boxes describe {share:.2f} % of the map's {result.cells} cells.")
    command = shlex.join(["sean", "run", "--environment", str(result.folder), "--behavior", "random"])
    print(f"next: {command}, or write a graph.yaml.")


def _import_bag(options: config.ImportBagConfig, console: "Console") -> None:
    check_new_folder(options.out)
    from sean_jax.ros import bag_import

    topics = options.people_topic, options.robot_topic
    result = bag_import.import_bag(options.bag, options.out, options.time_step, *topics)
    robot = "with a robot" if result.robot else "without a robot"
    where = f"in frame {result.frame!r}" if result.frame else "in one frame"
    print(f"{result.folder}: {result.frames} rows of {result.people} people, {robot}, {where}.")
    for note in result.notes:
        print(f"note: {note}")


def _import_robot(options: config.ImportRobotConfig, console: "Console") -> None:
    check_file(options.out, (".xml",))
    with console.status("importing JAX"):
        from sean_jax.drawing.robot_sheet import robot_sheet
        from sean_jax.robots import importing
    given = options.model_dump(exclude={"file", "out", "wheels"})
    wheels = tuple(name.strip() for name in options.wheels.split(",")) if options.wheels else ()
    with console.status("driving it in MJX"):
        robot = importing.import_robot(options.file, options.out, importing.Settings(**given, wheels=wheels))
    width = max(len(name) for name, _, _ in robot.numbers)
    for name, value, source in robot.numbers:
        print(f"{name:{width}}  {value} ({source})")
    for note in robot.notes:
        print(f"note: {note}.")
    ends = f"{1e3 * robot.gap:.2g} mm from the closed form, {1e3 * robot.lag:.2g} mm from a robot without inertia"
    print(f"3 s in MJX end {ends}.")
    picture = options.out.with_suffix(".png")
    with atomic_file(picture) as stream:
        robot_sheet(robot).savefig(stream, dpi=110, format="png")
    _print(console, "picture: ", picture)
    print(f"next: {shlex.join(['sean', 'run', '--robot', str(options.out)])}")


def _worlds(options: config.WorldsConfig, console: "Console") -> None:
    check_new_folder(options.out)
    with console.status("importing JAX"):
        from sean_jax import drawing
        from sean_jax.graph import annotation
        from sean_jax.io.progress import progress
        from sean_jax.world import generated
    words, sheet = generated.parse(options.words) if options.words else None, []
    with progress(console) as bar, atomic_folder(options.out) as folder:
        bar.start(f"{options.number} floors of {options.family}", options.number)
        for index in range(options.number):
            world = generated.generate(options.family, options.seed + index, words)
            generated.save(world, folder / world.settings.name)
            if index < MAX_FLOORS:
                sheet.append((world.environment, annotation.build(world.graph, None)))
            bar.update(index + 1)
        with atomic_file(folder / "floors.png") as stream:
            drawing.floors_sheet(sheet).savefig(stream, dpi=130, format="png")
    _print(console, "picture: ", options.out / "floors.png")
    first = f"{options.family}_{options.seed}"
    print(f"next: {shlex.join(['sean', 'run', '--environment', str(options.out / first)])}")


def _list(options: config.ListConfig, console: "Console") -> None:
    from sean_jax.evaluation import list_command

    list_command.print_choices()


def _schema(options: config.SchemaConfig, console: "Console") -> None:
    print(json.dumps(config.RunConfig.model_json_schema(), indent=2))


_COMMANDS = _run, _collect, _train, _experiment, _export, _fit_graph, _calibrate, _draw, _replay, _studio, _survey
_COMMANDS += _bridge, _compare, _import_map, _import_bag, _import_robot, _worlds
_COMMANDS += _benchmark, _bench, _validate, _doctor, _list, _schema
_DO: dict[str, Any] = {command.__name__[1:].replace("_", "-"): command for command in _COMMANDS}


def _print(console: Any, what: str, where: Path | str) -> None:
    """Print a line without markup or emoji, as a path may hold both."""
    from rich.text import Text

    console.print(Text.assemble(what, (str(where), "bold")), soft_wrap=True)


def _fail(sentence: str, code: int) -> int:
    from rich.console import Console
    from rich.text import Text

    sys.stdout.flush()
    Console(stderr=True).print(Text.assemble(("sean:", "bold red"), " ", sentence), soft_wrap=True)
    return code


if __name__ == "__main__":
    sys.exit(main())
