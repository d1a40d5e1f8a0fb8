"""What each command of the command line does with its options.

What a command needs is imported when it is chosen.
"""

import json
import math
import shlex
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sean_jax import config
from sean_jax.core.errors import InputError
from sean_jax.io.writing import atomic_file, atomic_folder, check_file, check_new_folder

if TYPE_CHECKING:
    from rich.console import Console

    from sean_jax.core.data_types import Scenario

WRONG, FAILED, STOPPED, TERMINATED = 2, 1, 130, 143  # exit codes: bad input, broken midway, Ctrl-C, SIGTERM
PICTURES = (".png", ".svg", ".pdf", ".jpg", ".jpeg", ".webp", ".tif", ".tiff")  # that matplotlib writes
MAX_FLOORS = 40  # of a picture
EXPERIMENTS = {"table1": "table1", "ablation": "table1", "figure4": "figure4", "learning_curve": "learning_curve"}


def _run(options: config.RunConfig, console: "Console") -> int:
    with console.status("importing JAX"):
        from sean_jax import evaluation
    folder, results = evaluation.run(options, console, _outside(options.policy, console))
    _print(console, "report: ", folder / "report.html")
    if results.episodes < options.episodes:
        sentence = (
            f"stopped; the {results.episodes} finished episodes are in {folder}, "
            f"and the same command with --out {folder} resumes it."
        )
        return fail(sentence, STOPPED)
    return 0


def _outside(policy: config.Component, console: "Console") -> Any:
    """A function of a scenario that connects the controller of a policy's name; None if the policy is inside."""
    place = config.outside(policy)
    if place is None:
        return None
    from sean_jax.ros import bridge

    last: bridge.ControllerDriver | None = None

    def connect(scenario: "Scenario") -> "bridge.ControllerDriver":
        nonlocal last
        now = last.now if last else 0  # time never goes back
        last = bridge.ControllerDriver(scenario, policy.kind, place, console, now)
        return last

    return connect


def _collect(options: config.CollectConfig, console: "Console") -> None:
    from sean_jax import learning

    data = learning.collect(options, console)
    _print(console, f"{data.example_count} examples in {len(data.episodes)} episodes: ", options.folder)


def _train_imitation(options: config.ImitationConfig, console: "Console") -> None:
    from sean_jax import learning
    from sean_jax.config import user_parts

    train = learning.dagger.train if isinstance(options, config.DaggerConfig) else learning.train
    state = train(options, console)  # pyright: ignore[reportArgumentType]
    best = f"smallest loss in validation {-float(state.best.value):.4f} after {int(state.best.update)}"
    _print(console, f"{int(state.update)} epochs, {best}: ", options.folder)
    _print(console, "next: ", run_command(options.folder, bool(user_parts.digests(options))))


def _train_agents(options: config.ReinforcementConfig, console: "Console") -> None:
    if options.distributed:
        console.quiet |= _join() > 0
    import numpy as np

    from sean_jax import learning
    from sean_jax.config import user_parts
    from sean_jax.learning.trainer import read_metrics

    state = learning.reinforcement.train(options, console)
    returns, updates = map(np.asarray, (state.best.value, state.best.update))
    agent = returns.argmax()
    best = f"best evaluation: return {returns[agent]:.2f}"

    # The evaluation of the best agent, as metrics.jsonl has it.
    lines = read_metrics(options.folder)
    line = next((line for line in lines if line["epoch"] == updates[agent]), {})
    evaluation = line.get(f"agent {agent}", line.get("evaluation", {}))
    if "completed" in evaluation:
        best += f", {evaluation['completed']:.0%} completed"
    _print(console, f"{int(state.update)} updates, {best} after {updates[agent]}: ", options.folder)
    _print(console, "next: ", run_command(options.folder, bool(user_parts.digests(options)), options.as_run()))


def _join() -> int:
    """Join the other processes of the training, before any device is used; the number of this one."""
    import jax

    try:
        jax.distributed.initialize()
    except (ValueError, RuntimeError) as error:
        reason = str(error).splitlines()[0].rstrip(".")
        raise InputError(
            f"--distributed: no other processes were found ({reason}); start all of them by srun or mpirun, "
            "or leave it out."
        ) from error
    return jax.process_index()


def run_command(folder: Path, trust: bool = False, options: config.RunConfig | None = None) -> str:
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


def _benchmark_run(options: config.BenchmarkConfig, console: "Console") -> None:
    from sean_jax.studies.experiments import benchmark

    outside = _outside(config.Named(kind=options.policy), console)
    folder = benchmark.run(options, console, outside)
    console.print(benchmark.table(benchmark.check(folder)), highlight=False, markup=False)
    _print(console, "report: ", folder / benchmark.REPORT)


def _benchmark_rank(options: config.BenchmarkRankConfig, console: "Console") -> None:
    from sean_jax.studies.experiments import ranking

    console.print(ranking.run(options).table(), highlight=False, markup=False)
    _print(console, "report: ", options.folder / ranking.REPORT)


def _benchmark_verify(options: config.BenchmarkVerifyConfig, console: "Console") -> int:
    from sean_jax.studies.experiments import verification

    lines, failed = verification.verify(options, console)
    console.print("\n".join(lines), highlight=False, markup=False)
    return fail(f"{options.result}: {failed}", FAILED) if failed else 0


def _export_lerobot(options: config.ExportConfig, console: "Console") -> None:
    check_new_folder(options.out)
    from sean_jax import learning

    _print(console, "written: ", learning.export(options.source, options.out))


def _export_agent(options: config.ExportConfig, console: "Console") -> None:
    check_new_folder(options.out)
    from sean_jax import learning
    from sean_jax.config import user_parts

    _print(console, "written: ", learning.pack(options.source, options.out))
    _print(console, "next: ", run_command(options.out, (options.out / user_parts.PARTS).is_dir()))


def _export_bag(options: config.ExportBagConfig, console: "Console") -> None:
    check_new_folder(options.out)
    from sean_jax.evaluation import bag_command

    folder, count = bag_command.write(options, console)
    _print(console, f"{count} messages: ", folder)


def _export_onnx(options: config.ExportConfig, console: "Console") -> None:
    check_file(options.out, [".onnx"])
    from sean_jax.learning import onnx

    _print(console, "written: ", onnx.export(options.source, options.out))


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
        return fail("draw: give either --graph or --handcrafted.", WRONG)
    behavior = "graph" if options.graph else "handcrafted"
    out = options.out or Path(f"{behavior}.png")
    check_file(out, PICTURES)
    from sean_jax.world import environment

    names = environment.available() if options.environment is None else [options.environment]
    for name in names:
        sheet, label = _sheet(name, behavior, options.sets)
        file = out
        if options.out is None or len(names) > 1:
            file = out.with_stem(f"{out.stem}-{label}")
            check_file(file, PICTURES)
        with atomic_file(file) as stream:
            sheet.savefig(stream, dpi=150, format=file.suffix[1:].lower())
        print(file)
    return 0


def _sheet(environment: str, behavior: str, sets: str) -> tuple[Any, str]:
    """The drawing of an environment's behavior graph or handcrafted sets, and the environment's name."""
    from sean_jax import drawing
    from sean_jax.simulation import making

    if behavior == "handcrafted":
        scenario = making.make(environment, behavior=behavior, task="handcrafted", sets=sets)
    else:
        scenario = making.make(environment, behavior=behavior, task="random_ab_nav")
    graph = drawing.graph_of(scenario)
    sheet = drawing.graph_sheet(scenario.environment, graph) if graph else drawing.handcrafted_sheet(scenario)
    return sheet, scenario.environment.name


def _replay(options: config.ReplayConfig, console: "Console") -> None:
    if (options.folder / "results.json").is_file():
        from sean_jax.studies.validation.replay import write_replay as write
    else:
        from sean_jax.evaluation.replay_command import write

    _print(console, "replay: ", write(options, console))


def _studio(options: config.StudioConfig, console: "Console") -> None:
    if options.survey is not None:
        from sean_jax.studies import survey

        return survey.run(options, console)
    from sean_jax.web import studio

    studio.run_studio(options, console)


def _bridge(options: config.BridgeConfig, console: "Console") -> None:
    from sean_jax.ros import bridge

    bridge.run_bridge(options, console)


def _survey_export(options: config.SurveyExportConfig, console: "Console") -> None:
    from sean_jax.studies.survey import export
    from sean_jax.studies.survey.answers import FILE, Answers

    for file in export.export(Answers(options.folder / FILE), options.out or options.folder / "tables"):
        print(file)


def _survey_report(options: config.SurveyReportConfig, console: "Console") -> None:
    from sean_jax.studies.survey import report
    from sean_jax.studies.survey.answers import FILE, Answers

    _print(console, "report: ", report.run(Answers(options.folder / FILE), options, console))


def _survey_ratings(options: config.SurveyRatingsConfig, console: "Console") -> None:
    check_new_folder(options.out)
    with console.status("importing JAX"):
        from sean_jax.studies.survey import ratings

    _print(console, "report: ", ratings.run(options, console))


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
        return fail(f"{len(failed)} checks fail: {', '.join(failed)}.", FAILED)
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
    frame = f"in frame {result.frame!r}" if result.frame else "in one frame"
    print(f"{result.folder}: {result.frames} rows of {result.people} people, {robot}, {frame}.")
    for note in result.notes:
        print(f"note: {note}")


def _import_robot(options: config.ImportRobotConfig, console: "Console") -> None:
    check_file(options.out, (".xml",))
    with console.status("importing JAX"):
        from sean_jax.drawing.robot_sheet import robot_sheet
        from sean_jax.robots import importing

    wheels = tuple(name.strip() for name in options.wheels.split(",")) if options.wheels else ()
    settings = importing.ImportSettings(**options.model_dump(exclude={"file", "out", "wheels"}), wheels=wheels)
    with console.status("driving it in MJX"):
        robot = importing.import_robot(options.file, options.out, settings)

    # Numbers of the robot with their sources, and how far its closed form is from MJX.
    width = max(len(name) for name, _, _ in robot.numbers)
    for name, value, source in robot.numbers:
        print(f"{name:{width}}  {value} ({source})")
    for note in robot.notes:
        print(f"note: {note}.")
    gap, lag = (f"{1e3 * distance:.2g} mm" for distance in (robot.gap, robot.lag))
    print(f"3 s in MJX end {gap} from the closed form, {lag} from a robot without inertia.")

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

    words = generated.parse(options.words) if options.words else None
    sheet = []
    with progress(console) as bar, atomic_folder(options.out) as folder:
        bar.start(f"{options.number} floors of {options.family}", options.number)
        for index in range(options.number):
            world = generated.generate(options.family, options.seed + index, words)
            generated.save(world, folder / world.settings.name)
            if index < MAX_FLOORS:
                sheet.append((world.environment, annotation.build_graph(world.graph, None)))
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


DO: dict[str, Callable[[Any, "Console"], int | None]] = {
    "run": _run,
    "collect": _collect,
    "train imitation": _train_imitation,
    "train dagger": _train_imitation,
    "train ppo": _train_agents,
    "train apg": _train_agents,
    **{f"experiment {name}": _experiment for name in EXPERIMENTS},
    "export lerobot": _export_lerobot,
    "export agent": _export_agent,
    "export onnx": _export_onnx,
    "export bag": _export_bag,
    "export map": _export_map,
    "fit-graph": _fit_graph,
    "calibrate": _calibrate,
    "draw": _draw,
    "replay": _replay,
    "studio": _studio,
    "bridge": _bridge,
    "survey export": _survey_export,
    "survey report": _survey_report,
    "survey ratings": _survey_ratings,
    "compare": _compare,
    "import-map": _import_map,
    "import-bag": _import_bag,
    "import-robot": _import_robot,
    "worlds": _worlds,
    "benchmark run": _benchmark_run,
    "benchmark rank": _benchmark_rank,
    "benchmark verify": _benchmark_verify,
    "bench": _bench,
    "validate": _validate,
    "doctor": _doctor,
    "list": _list,
    "schema": _schema,
}
"""Words of the command line -> function of options and console; its exit code is 0 for None."""


def _print(console: Any, label: str, text: Path | str) -> None:
    """Print a line without markup or emoji, as a path may hold both."""
    from rich.text import Text

    console.print(Text.assemble(label, (str(text), "bold")), soft_wrap=True)


def fail(sentence: str, code: int) -> int:
    """Print the sentence of an error, and return its exit code."""
    from rich.console import Console
    from rich.text import Text

    sys.stdout.flush()
    Console(stderr=True).print(Text.assemble(("sean:", "bold red"), " ", sentence), soft_wrap=True)
    return code
