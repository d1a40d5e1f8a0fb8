"""What the package does today, in digests and copies, so that a change of its code can be held against it.

python benchmarks/goldens.py write before
python benchmarks/goldens.py write after --only jaxprs help schema bad_input
python benchmarks/goldens.py compare before after

``write`` records the package that is imported: PYTHONPATH says which. ``compare`` prints what differs, and its exit
code is 1 then. Everything takes a quarter of an hour on a core. Numbers are those of one machine and its versions:
another one's differ in their last digits.
"""

import argparse
import contextlib
import difflib
import gzip
import hashlib
import io
import json
import os
import re
import shlex
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

SECTIONS = ("jaxprs", "help", "schema", "bad_input", "runs", "folders")
SHOWN = 12  # lines of a difference
WIDE = 1000  # columns in which an option's text is one line

# What an own part of each kind is, and two people who walk through the lab again and again.
MINE = """
import jax.numpy as jnp
def drive(scenario, state, key):
    return jnp.array([0.3, 0.2])
def near(before, after):
    return jnp.where(jnp.linalg.norm(after.people.position - after.position, axis=-1).min() < 2.0, after.time_step, 0.0)
def alone(moment):
    return jnp.linalg.norm(moment.people.position - moment.position, axis=-1).min() > 3.0
"""
PEOPLE = "frame,id,x,y\n" + "".join(
    f"{tick},{person},{-5.5 + 0.06 * abs(150 - (30 * person + tick) % 300):.2f},{0.8 - 0.9 * person:.2f}\n"
    for tick in range(0, 300, 3) for person in range(2)
)  # fmt: skip

SCENARIOS: dict[str, dict[str, Any]] = {
    "warehouse": {"environment": "warehouse", "task": "join_group", "people": 8, "dynamics": "twin"},
    "warehouse edge": {
        "environment": "warehouse", "task": "leave_group", "people": 8, "routing": "edge", "members": "permanent",
        "congestion_cost": 10.0, "temperature": 0.2, "walking_groups": (0.3, 0.3), "forces": "helbing1995",
    },
    "warehouse sean2": {"environment": "warehouse", "people": 8, "preset": "sean2", "task": "join_group"},
    "warehouse orca": {
        "environment": "warehouse", "behavior": "random", "people": 6, "model": "orca", "robot": "jackal",
    },
    "outdoor": {
        "environment": "outdoor", "task": "random_ab_nav", "people": 6, "robot": "warthog", "forces": "helbing2000",
    },
    "outdoor random": {
        "environment": "outdoor", "behavior": "random", "task": "busy_ab_nav", "people": 6, "warm_up": 1.0,
        "walking_groups": (0.4, 0.3), "dynamics": "twin", "robot": "pioneer3dx",
    },
    "outdoor handcrafted": {
        "environment": "outdoor", "behavior": "handcrafted", "task": "handcrafted", "sets": "join_group",
        "dynamics": "kinematic",
    },
    "lab handcrafted": {"environment": "lab", "behavior": "handcrafted", "robot": "turtlebot3", "dynamics": "twin"},
    "lab walkers": {
        "environment": "lab", "behavior": "random", "people": 4, "model": "constant_velocity", "robot": "pioneer3dx",
    },
    "lab playback": {
        "environment": "lab", "behavior": "playback", "recording": "people.csv", "frame_rate": 10.0, "robot": "kuri",
        "dynamics": "twin", "situations": "more",
    },
    "lab custom": {
        "environment": "lab", "behavior": "random", "people": 4, "start": (-5.0, 0.0, 90.0), "goal": (3.0, 1.0),
        "forces": "johansson2007", "time_step": 0.04, "substeps": 2, "dynamics": "twin", "places": "mesh",
    },
    "lab sensors": {
        "environment": "lab", "behavior": "random", "people": 4, "sensors": ("depth", "lidar"), "dynamics": "twin",
        "metrics": ("all", "mine.py:near"), "situations": ("paper", "mine.py:alone"),
    },
}  # fmt: skip
ENVS: dict[str, tuple[str, dict[str, Any]]] = {
    "env people": ("Lab-Random-RandomAbNav-v0", {"people": 4, "action_delay": (1, 3), "randomization": "behavior"}),
    "env images": (
        "Lab-Graph-Mixed-v0",
        {
            "people": 4, "observations": ("goal", "plan", "lidar", "depth", "rgb", "situations"),
            "terminations": ("collision", "obstacle"),
            "rewards": ("progress", "completed", "at_goal", "time", "acceleration", "o_space", "personal_space"),
        },
    ),
}  # fmt: skip

FILES = {"file": "kept", "full/old": "kept", "map.yaml": "image: none.pgm\n", "mine.py": MINE, "people.csv": PEOPLE}
FILES |= {"odd.py": "number = 3\ndef sonar(scenario, state):\n    return 0.0\n", "bad.yaml": "config:\n  people: [x\n"}
FILES |= {"old.yaml": "config:\n  episods: 3\n"}
BAD_INPUT = """
rn
run --episodes x
run --episode 3
run --episodes 0
run --num-episodes 8
run --people -1
run --people 90000
run --time-limit nan
run --walking-groups 0.7 0.7
run --task-distance 4 2
run --frame-rate 30
run --task custom --start 1 --goal 2 2
run --task join_group,custom
run --task join_group,join_grup
run --task join_group --behavior random
run --task join_group,join_group
run --environment warehose
run --environment full/
run --environment=
run --behavior grph
run --behavior playback
run --behavior playback --recording nope.csv
run --behavior playback --recording file --model orca
run --behavior handcrafted --people 4
run --behavior handcrafted --sets nope --dynamics twin
run --sets all
run --routing egde
run --model orka
run --forces helbing95
run --force odd.py:number
run --situations papr
run --metric nope.py:near
run --metric mine.py:naer
run --dynamics twinn
run --robot nope.xml
run --policy go_to_gaol
run --policy runs/nope
run --policy full
run --policy mine.py:driv
run --sensors depht
run --sensor odd.py:sonar
run --camera depth --renderer unity
run --renderer mujoco
run --config nope.yaml
run --config bad.yaml
run --config old.yaml
run --preset sean3
run --out file
run --out full
collect --policy nobody
collect --rate 3
collect --behavior playback
collect --labels nobody
collect --out full
train
train reinforce full
train imitation nope
train imitation full --validation 1
train dagger nope --expert nobody
train ppo --environment lab,nope
train ppo --pretrained nope
train ppo --observations goal,gaol
train ppo --rewards progres
train ppo --termination nope.py:fall
train ppo --action-delay 3 1
train ppo --sweep clip=0.1 clip=0.2
train ppo --seed 4294967295 --seeds 2
train apg --total_timesteps=100
experiment table3
experiment table1 --policies nobody
experiment figure4 --people 90000
experiment learning_curve --rates 5 3
export agent nope --out new
export lerobot nope --out full
export zip nope --out new
benchmark --policy nobody
bench --only stepp
bench --batches 0
validate --only rimea-99
validate --models nobody
validate --data nope
calibrate --data nope
calibrate --data full --fit nope
fit-graph nope
fit-graph lab --recording nope.csv
draw
draw --graph --out sheet.docx
replay nope
compare nope full
import-map nope.yaml --out new
import-map map.yaml --out new --height nan
doctor --fast
list --all
schema --nope
""".strip().splitlines()


def plain(text: str) -> str:
    """The text without addresses, and without the places of the package, of Python and of temporary files."""
    import sean_jax

    package = Path(sean_jax.__file__).resolve().parent
    for place, name in ((os.getcwd(), "."), (package, "sean_jax"), (package.parent, ".."), (sys.prefix, "python")):
        text = text.replace(str(place), name)
    return re.sub(r"0x[0-9a-f]{6,}", "0x", text)


def folder_of_files() -> contextlib.AbstractContextManager[str]:
    """A temporary folder with the files that commands and scenarios name, as the current one."""

    @contextlib.contextmanager
    def entered() -> Iterator[str]:
        with tempfile.TemporaryDirectory() as place, contextlib.chdir(place):
            for name, text in FILES.items():
                Path(name).parent.mkdir(exist_ok=True)
                Path(name).write_text(text)
            yield place

    return entered()


# ------------------------------------------------------------------ programs


def program(traced: Any) -> str:
    """The text of a traced program: its operations, types and constants, without names of functions."""
    return "\n".join(_lines(traced.jaxpr, traced.consts, "")) + "\n"


def _lines(jaxpr: Any, constants: Iterable[Any], indent: str) -> Iterator[str]:
    """Lines of a program and, further in, of the programs that it calls; each numbers its variables anew."""
    numbers: dict[Any, str] = {}

    def word(atom: Any) -> str:
        kind = atom.aval.str_short(short_dtypes=True)
        if hasattr(atom, "val"):
            return f"{_value(atom.val)}:{kind}"
        weak = "*" if getattr(atom.aval, "weak_type", False) else ""
        return f"{numbers.setdefault(atom, f'v{len(numbers)}')}:{kind}{weak}"

    yield f"{indent}given {' '.join(map(word, jaxpr.invars))}"
    for variable, value in zip_longest(jaxpr.constvars, constants):  # without values where they are arguments
        yield f"{indent}constant {word(variable)} = {_value(value)}"
    for equation in jaxpr.eqns:
        parts, inner = [], []
        for name, value in sorted(equation.params.items()):
            programs = [each for each in (value if isinstance(value, tuple | list) else [value]) if _is_program(each)]
            if programs:
                inner += [(name, each) for each in programs]
            elif name not in ("name", "kernel_name", "debug_info"):
                parts.append(f"{name}={_value(value)}")
        given, made = (" ".join(map(word, each)) for each in (equation.invars, equation.outvars))
        yield f"{indent}{made} = {equation.primitive.name}[{' '.join(parts)}] {given}"
        for name, each in inner:
            yield f"{indent}  {name}:"
            yield from _lines(getattr(each, "jaxpr", each), getattr(each, "consts", ()), indent + "    ")
    yield f"{indent}gives {' '.join(map(word, jaxpr.outvars))}"


def _is_program(value: Any) -> bool:
    return hasattr(value, "eqns") or hasattr(getattr(value, "jaxpr", None), "eqns")


def _value(value: Any) -> str:
    """A constant or an option of an operation as a text; a large array by its digest, a function by what it is."""
    import numpy as np

    if hasattr(value, "dtype") and hasattr(value, "tobytes") and value.size > 8:
        array = np.asarray(value)
        return f"{array.dtype}{array.shape} {hashlib.sha256(array.tobytes()).hexdigest()[:16]}"
    if callable(value) and not isinstance(value, type):
        return f"<{type(value).__name__}>"
    return " ".join(re.sub(r"<.*?(function|method|thunk|object).*>", "<code>", repr(value)).split())


def jaxprs() -> dict[str, str]:
    """Programs of the step, its derivatives, a policy's step and an environment's step."""
    import jax

    import sean_jax

    key, action = jax.random.key(0), jax.ShapeDtypeStruct((2,), "float32")
    found, scenarios = {}, {}
    with folder_of_files():
        for name, options in SCENARIOS.items():
            scenarios[name] = scenario = sean_jax.make(**options)
            state = jax.eval_shape(sean_jax.reset, scenario, key)
            found[f"step {name}"] = program(jax.make_jaxpr(sean_jax.step)(scenario, state, action))
        for name in ("warehouse", "lab playback"):
            found[f"reset {name}"] = program(jax.make_jaxpr(sean_jax.reset)(scenarios[name], key))
        scenario = scenarios["warehouse"]
        state = jax.eval_shape(sean_jax.reset, scenario, key)

        def loss(forces: Any, state: Any, action: Any) -> Any:
            after = sean_jax.step(replace(scenario, forces=forces), state, action)
            return (after.pedestrians.position**2).sum() + (after.robot.position**2).sum()

        derivative = jax.grad(loss, allow_int=True)
        found["gradient warehouse"] = program(jax.make_jaxpr(derivative)(scenario.forces, state, action))
        for name in sorted(sean_jax.POLICIES):
            policy = sean_jax.POLICIES[name]

            def drive(scenario: Any, state: Any, policy: Any = policy) -> Any:
                return sean_jax.policy_step(scenario, policy, sean_jax.init_policy(scenario, policy, state))

            found[f"policy {name}"] = program(jax.make_jaxpr(drive)(scenario, state))
        for name, (kind, overrides) in ENVS.items():
            env = sean_jax.registry.load(kind, config_overrides=overrides)
            _, state = jax.eval_shape(type(env).reset, env, key)
            found[f"step {name}"] = program(jax.make_jaxpr(type(env).step)(env, key, state, action))
    return found


# ------------------------------------------------------------------ words


def say(words: list[str], columns: int = 100) -> tuple[str, str]:
    """What a command prints, in this process: on stdout; and on stderr, after the exit code."""
    from sean_jax import cli

    out, err = (io.TextIOWrapper(io.BytesIO(), "utf-8", write_through=True) for _ in range(2))
    os.environ["COLUMNS"] = str(columns)
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code: Any = cli.main(words)
        except SystemExit as end:
            code = end.code
        except Exception as error:
            code = f"{type(error).__name__}: {error}"
    told, failed = (re.sub(r" +$", "", each.buffer.getvalue().decode(), flags=re.MULTILINE) for each in (out, err))
    return plain(told), plain(f"exit code {code}\n{failed}")


def help_texts() -> dict[str, str]:
    """``--help`` of everything, and by themselves the options with their values and defaults."""
    found = {"sean": say(["--help"])[0], "list": say(["list"])[0], "train": say(["train", "--help"])[0]}
    commands = [[word] for word in re.findall(r"^  ([a-z-]+)  ", found["sean"], re.MULTILINE) if word != "train"]
    commands += [["train", word] for word in re.findall(r"^  sean train ([a-z]+) ", found["train"], re.MULTILINE)]
    for words in commands:
        found[" ".join(words)] = say([*words, "--help"])[0]
        found[f"{' '.join(words)}, options"] = "\n".join(_options(say([*words, "--help"], WIDE)[0])) + "\n"
    return found


def _options(text: str) -> list[str]:
    """Options of a help text of wide lines: names and values, then the default."""
    name, found = "", {}
    for line in text.splitlines():
        if line.startswith("│"):
            line = line.strip("│ ")
            first = re.split(r"\s{2,}", line)[0]
            name = first if re.match(r"--?\w|[A-Z]+$|\{", first) else name
            default = re.search(r"\((default: .*?|required)\)$", line)
            found[name] = default[1] if default else found.get(name, "")
    return [f"{name} {default}".strip() for name, default in found.items()]


def schema() -> dict[str, str]:
    """The schema, and without its texts."""

    def bare(part: Any) -> Any:
        if isinstance(part, dict):
            return {name: bare(each) for name, each in part.items() if not isinstance(each, str) or name in KEPT}
        return [bare(each) for each in part] if isinstance(part, list) else part

    KEPT = ("type", "const", "$ref", "default", "pattern", "format", "propertyName")
    text = say(["schema"])[0]
    return {"schema": text, "schema, bare": json.dumps(bare(json.loads(text)), indent=1, sort_keys=True) + "\n"}


def bad_input() -> dict[str, str]:
    """Exit code and sentence of each wrong command line."""
    with folder_of_files():
        return {line: say(shlex.split(line))[1] for line in BAD_INPUT}


# ------------------------------------------------------------------ commands


def file_of(folder: Path, section: str, name: str) -> Path:
    """Where the copy of what has that name is."""
    slug = re.sub(r"[^\w.,=-]+", "_", name).strip("_")[:100]
    return folder / section / (f"{slug}.txt.gz" if section == "jaxprs" else f"{slug}.txt")


def write(folder: Path, only: Iterable[str]) -> None:
    """Record the sections: a copy of each text, and goldens.json with their digests."""
    kept = read(folder) if (folder / "goldens.json").is_file() else {}
    folder.mkdir(parents=True, exist_ok=True)
    for section in only:
        began = time.monotonic()
        found = WRITERS[section](folder)
        shutil.rmtree(folder / section, ignore_errors=True)
        (folder / section).mkdir()
        for name, text in found.items():
            data = text.encode()
            file_of(folder, section, name).write_bytes(gzip.compress(data, mtime=0) if section == "jaxprs" else data)
        kept[section] = {name: hashlib.sha256(text.encode()).hexdigest() for name, text in found.items()}
        (folder / "goldens.json").write_text(json.dumps(kept, indent=1, sort_keys=True) + "\n")
        print(f"{section}: {len(found)} in {time.monotonic() - began:.0f} s", flush=True)


def read(path: Path) -> dict[str, dict[str, str]]:
    """The digests in a folder, or in a file: by section and by name."""
    return json.loads((path / "goldens.json" if path.is_dir() else path).read_text())


def compare(before: Path, after: Path) -> int:
    """Print what differs, with the first lines of the difference; 1 if anything does. Sections of both are compared."""
    one, other = read(before), read(after)
    differing = 0
    for section in sorted({*one, *other}):
        if section not in one or section not in other:
            print(f"{section}: only in {before if section in one else after}")
            continue
        names = sorted({*one[section], *other[section]})
        changed = [name for name in names if one[section].get(name) != other[section].get(name)]
        print(f"{section}: {len(changed)} of {len(names)} differ")
        differing += len(changed)
        for name in changed:
            where = [place for place, found in ((before, one), (after, other)) if name not in found[section]]
            print(f"  {name}: {f'not in {where[0]}' if where else 'differs'}")
            copies = [file_of(place, section, name) for place in (before, after)]
            if all(copy.is_file() for copy in copies):
                texts = [_text(copy).splitlines() for copy in copies]
                lines = list(difflib.unified_diff(*texts, lineterm="", n=0))[2:]
                print("\n".join(f"    {line[:160]}" for line in lines[:SHOWN]))
    return int(differing > 0)


def _text(path: Path) -> str:
    data = path.read_bytes()
    return (gzip.decompress(data) if path.suffix == ".gz" else data).decode()


WRITERS: dict[str, Callable[[Path], dict[str, str]]] = {
    "jaxprs": lambda _: jaxprs(),
    "help": lambda _: help_texts(),
    "schema": lambda _: schema(),
    "bad_input": lambda _: bad_input(),
}


def main() -> int:
    """Write, compare or open."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    writing = commands.add_parser("write")
    writing.add_argument("folder", type=Path)
    writing.add_argument("--only", nargs="+", choices=SECTIONS, default=SECTIONS)
    comparing = commands.add_parser("compare")
    comparing.add_argument("before", type=Path)
    comparing.add_argument("after", type=Path)
    chosen = parser.parse_args()
    if chosen.command == "compare":
        return compare(chosen.before, chosen.after)
    write(chosen.folder.resolve(), chosen.only)
    return 0


if __name__ == "__main__":
    sys.exit(main())
