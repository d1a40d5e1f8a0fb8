"""Time of each stage of a control step, by the names of the stages in the program.

XLA_FLAGS=--xla_gpu_enable_command_buffer= python benchmarks/stages.py --batch 32768    on a GPU
python benchmarks/stages.py --batch 64                                                  on a CPU

JAX's profiler gives the time of each kernel, and the compiled program its stage. A kernel of
two stages counts for the stage with more of its operations. Command buffers would hide single kernels.
"""

import re
import tempfile
from collections import Counter, defaultdict
from pathlib import Path

import jax
from jax.profiler import ProfileData
from options import Option, parse
from timing import device

import sean_jax
from sean_jax.cli.bench import programs
from sean_jax.simulation.scenario_stack import Stack

STAGES = "direct_pedestrians", "move_pedestrians", "move_robot", "classify", "measure", "restart", "depth"
TURNS = 4


def origins(text: str) -> dict[str, str]:
    """name of an instruction -> its stage, from a compiled program's text."""
    inside: dict[str, Counter] = defaultdict(Counter)
    called: dict[str, tuple[str, str]] = {}
    computation = ""
    for line in text.splitlines():
        if line and not line.startswith(" "):
            computation = line.removeprefix("ENTRY ").lstrip("%").split(" ")[0]
            continue
        name = re.match(r"\s*(?:ROOT )?%([\w.\-]+) = ", line)
        stage = stage_of(line)
        if stage:
            inside[computation][stage] += 1
        if name and not re.search(r" (?:while|call|conditional)\(", line):  # their time is the time of their content
            calls = re.search(r"(?:calls|to_apply)=%([\w.\-]+)", line)
            called[name[1]] = stage, calls[1] if calls else ""
    return {name: most_frequent(inside[inner]) or stage for name, (stage, inner) in called.items()}


def stage_of(line: str) -> str:
    """The innermost stage in an instruction's origin, or nothing."""
    origin = re.search(r'op_name="([^"]*)"', line)
    stages = [part for part in origin[1].split("/") if part in STAGES] if origin else []
    return stages[-1] if stages else ""


def most_frequent(counts: Counter) -> str:
    """The most frequent entry, or nothing."""
    return counts.most_common(1)[0][0] if counts else ""


def kernels(folder: Path, names: dict[str, str]) -> tuple[dict[str, float], dict[str, int]]:
    """(seconds, launches) by stage, from the profiler's files."""
    seconds: dict[str, float] = defaultdict(float)
    launches: dict[str, int] = defaultdict(int)
    (file,) = folder.rglob("*.xplane.pb")
    for plane in ProfileData.from_file(str(file)).planes:
        gpu = plane.name.startswith("/device:GPU")
        for line in plane.lines if gpu or jax.devices()[0].platform == "cpu" else ():
            if gpu and "Stream" not in line.name:
                continue
            for event in line.events:
                stats = dict(pair for pair in event.stats if pair and pair[0])
                name = str(stats.get("hlo_op") or (event.name if gpu else ""))
                if name in names or gpu:
                    stage = names.get(name) or "none of these"
                    seconds[stage] += event.duration_ns * 1e-9
                    launches[stage] += 1
    return seconds, launches


def main() -> None:
    """Print the table."""
    chosen = parse(
        __doc__,
        batch=64,
        people=62,
        dynamics="twin",
        depth=Option(False, "a depth image of 64x48 after each step"),
    )
    scenario = sean_jax.make("warehouse", people=chosen.people, dynamics=chosen.dynamics)
    program = programs.stepping(Stack(scenario, {}), chosen.batch, TURNS, (64, 48) if chosen.depth else None)
    compiled = program.run.lower(*program.fixed, program.carried).compile()
    carried = jax.block_until_ready(compiled(*program.fixed, program.carried))
    with tempfile.TemporaryDirectory() as folder:
        with jax.profiler.trace(folder):
            jax.block_until_ready(compiled(*program.fixed, carried))
        seconds, launches = kernels(Path(folder), origins(compiled.as_text()))
    whole = sum(seconds.values())
    print(f"{device()}, B = {chosen.batch}, {chosen.people} people")
    print(f"{'stage':<20}{'us a step':>11}{'share':>8}{'kernels':>9}")
    for stage, spent in sorted(seconds.items(), key=lambda item: -item[1]):
        print(f"{stage:<20}{1e6 * spent / TURNS:11.1f}{100 * spent / whole:7.1f}%{launches[stage] / TURNS:9.0f}")
    print(f"{'all':<20}{1e6 * whole / TURNS:11.1f}{100:7.1f}%{sum(launches.values()) / TURNS:9.0f}")


if __name__ == "__main__":
    main()
