"""Records of the package's behavior as digests and copies, to compare two versions of the code.

python benchmarks/goldens.py write before
python benchmarks/goldens.py write after --only jaxprs help schema bad_input
python benchmarks/goldens.py write after --only runs --runs warehouse data imitation
python benchmarks/goldens.py compare before after
python benchmarks/goldens.py open before

``write`` records the imported package (set PYTHONPATH). ``compare`` prints the differences, and its exit
code is then 1. ``open`` opens the folders of ``write`` in FOLDER/folders with the present code. The cases are
in goldens.yaml. Everything takes a quarter of an hour on a core. Numbers are for one machine and its versions:
on other machines the last digits differ.
"""

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
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

import yaml
from options import Option, add_options, parser

SECTIONS = ("jaxprs", "help", "schema", "bad_input", "runs", "folders")
SHOWN = 12  # lines of a difference
WIDE = 1000  # columns in which an option's text is one line
CASES = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
TEXTS = ("type", "const", "$ref", "default", "pattern", "format")  # of a schema, without explanations

# Two people who walk through the lab and back, and a room with a wall in it as a map.
PEOPLE = "frame,id,x,y\n" + "".join(
    f"{tick},{person},{-5.5 + 0.06 * abs(150 - (30 * person + tick) % 300):.2f},{0.8 - 0.9 * person:.2f}\n"
    for tick in range(0, 300, 3)
    for person in range(2)
)
PLAN = "P2 32 20 255\n" + "".join(
    f"{254 if 0 < x < 31 and 0 < y < 19 and not (x == 14 and y < 9) else 0}\n" for y in range(20) for x in range(32)
)

# Contents of files without durations and versions; configurations without their versions.
TOLD = ("*.csv", "summary.json", "metrics.jsonl", "dataset.json", "config.json", "experiment.json", "results.json")
TOLD += ("config.yaml", "environment.yaml", "scene.xml", "agent.json")
PASSING = {
    "summary.json": ("timing",),
    "metrics.jsonl": ("time", "seconds", "per_second"),
    "results.json": ("seconds",),
}


def plain(text: str) -> str:
    """The text without addresses, and without the paths of the package, of Python and of temporary files."""
    import sean_jax

    package = Path(sean_jax.__file__).resolve().parent
    for place, name in ((os.getcwd(), "."), (package, "sean_jax"), (package.parent, ".."), (sys.prefix, "python")):
        text = text.replace(str(place), name)
    return re.sub(r"0x[0-9a-f]{6,}", "0x", text)


def add_files() -> None:
    """Write the files that scenarios and commands name into the current folder."""
    for name, text in {**CASES["files"], "people.csv": PEOPLE, "plan.pgm": PLAN}.items():
        Path(name).parent.mkdir(exist_ok=True)
        Path(name).write_text(text)


@contextlib.contextmanager
def folder_of_files() -> Iterator[None]:
    """A temporary folder with these files, as the current one."""
    with tempfile.TemporaryDirectory() as place, contextlib.chdir(place):
        add_files()
        yield


# ------------------------------------------------------------------ programs


def program(traced: Any) -> str:
    """The text of a traced program: its operations, types and constants, without names of functions."""
    return "\n".join(_lines(traced.jaxpr, traced.consts, "")) + "\n"


def _lines(jaxpr: Any, constants: Iterable[Any], indent: str) -> Iterator[str]:
    """Lines of a program and, further in, of the programs that it calls; each with its own numbering of variables."""
    numbers: dict[Any, str] = {}

    def word(atom: Any) -> str:
        kind = atom.aval.str_short(short_dtypes=True)
        if hasattr(atom, "val"):
            return f"{_value(atom.val)}:{kind}"
        weak = "*" if getattr(atom.aval, "weak_type", False) else ""
        return f"{numbers.setdefault(atom, f'v{len(numbers)}')}:{kind}{weak}"

    yield f"{indent}given {' '.join(map(word, jaxpr.invars))}"
    for variable, value in zip_longest(jaxpr.constvars, constants):  # without values if they are arguments
        yield f"{indent}constant {word(variable)} = {_value(value)}"
    for equation in jaxpr.eqns:
        options, inner = [], []
        for name, value in sorted(equation.params.items()):
            values = value if isinstance(value, tuple | list) else [value]
            programs = [(name, part) for part in values if _is_program(part)]
            if programs:
                inner += programs
            elif name not in ("name", "kernel_name", "debug_info"):
                options.append(f"{name}={_value(value)}")
        inputs, outputs = " ".join(map(word, equation.invars)), " ".join(map(word, equation.outvars))
        yield f"{indent}{outputs} = {equation.primitive.name}[{' '.join(options)}] {inputs}"
        for name, part in inner:
            yield f"{indent}  {name}:"
            yield from _lines(getattr(part, "jaxpr", part), getattr(part, "consts", ()), indent + "    ")
    yield f"{indent}gives {' '.join(map(word, jaxpr.outvars))}"


def _is_program(value: Any) -> bool:
    return hasattr(value, "eqns") or hasattr(getattr(value, "jaxpr", None), "eqns")


def _value(value: Any) -> str:
    """A constant or an option of an operation as a text; a large array by its digest, a function by its program."""
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

    key = jax.random.key(0)
    with folder_of_files():
        scenarios = {name: sean_jax.make(**options) for name, options in CASES["scenarios"].items()}
        texts = {}
        for name, scenario in scenarios.items():
            texts[f"step {name}"] = program(jax.make_jaxpr(sean_jax.step)(scenario, *_state_and_action(scenario)))
        for name in ("warehouse", "lab playback"):
            texts[f"reset {name}"] = program(jax.make_jaxpr(sean_jax.reset)(scenarios[name], key))
        return texts | _gradients(scenarios["warehouse"]) | _policies(scenarios["warehouse"]) | _environments()


def _state_and_action(scenario: Any) -> tuple[Any, Any]:
    """The shapes of a state and of an action."""
    import jax

    import sean_jax

    state = jax.eval_shape(sean_jax.reset, scenario, jax.random.key(0))
    return state, jax.ShapeDtypeStruct((2,), "float32")


def _gradients(scenario: Any) -> dict[str, str]:
    import jax

    import sean_jax

    def loss(forces: Any, state: Any, action: Any) -> Any:
        after = sean_jax.step(replace(scenario, forces=forces), state, action)
        return (after.pedestrians.position**2).sum() + (after.robot.position**2).sum()

    derivative = jax.grad(loss, allow_int=True)
    text = program(jax.make_jaxpr(derivative)(scenario.forces, *_state_and_action(scenario)))
    return {"gradient warehouse": text}


def _policies(scenario: Any) -> dict[str, str]:
    import jax

    import sean_jax

    state, _ = _state_and_action(scenario)
    texts = {}
    for name in sorted(sean_jax.POLICIES):
        policy = sean_jax.POLICIES[name]

        def drive(scenario: Any, state: Any, policy: Any = policy) -> Any:
            return sean_jax.policy_step(scenario, policy, sean_jax.init_policy(scenario, policy, state))

        texts[f"policy {name}"] = program(jax.make_jaxpr(drive)(scenario, state))
    return texts


def _environments() -> dict[str, str]:
    import jax

    import sean_jax

    key, action = jax.random.key(0), jax.ShapeDtypeStruct((2,), "float32")
    texts = {}
    for name, options in CASES["environments"].items():
        overrides = {key: value for key, value in options.items() if key != "name"}
        env = sean_jax.registry.load(options["name"], config_overrides=overrides)
        _, state = jax.eval_shape(type(env).reset, env, key)
        texts[f"step {name}"] = program(jax.make_jaxpr(type(env).step)(env, key, state, action))
    return texts


# ------------------------------------------------------------------ words


def say(words: list[str], columns: int = 100) -> tuple[str, str]:
    """Output of a command in this process: stdout; and stderr, after the exit code."""
    from sean_jax.cli import command_line

    out, err = (io.TextIOWrapper(io.BytesIO(), "utf-8", write_through=True) for _ in range(2))
    os.environ["COLUMNS"] = str(columns)
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code: Any = command_line.main(words)
        except SystemExit as end:
            code = end.code
        except Exception as error:
            code = f"{type(error).__name__}: {error}"
    printed, failed = (re.sub(r" +$", "", part.buffer.getvalue().decode(), flags=re.MULTILINE) for part in (out, err))
    return plain(printed), plain(f"exit code {code}\n{failed}")


def help_texts() -> dict[str, str]:
    """``--help`` of all commands, and separately the options with their values and defaults."""
    options = {"sean": say(["--help"])[0], "list": say(["list"])[0], "train": say(["train", "--help"])[0]}
    commands = [[word] for word in re.findall(r"^  ([a-z-]+)  ", options["sean"], re.MULTILINE) if word != "train"]
    commands += [["train", word] for word in re.findall(r"^  sean train ([a-z]+) ", options["train"], re.MULTILINE)]
    for words in commands:
        options[" ".join(words)] = say([*words, "--help"])[0]
        options[f"{' '.join(words)}, options"] = "\n".join(_options(say([*words, "--help"], WIDE)[0])) + "\n"
    return options


def _options(text: str) -> list[str]:
    """Options of a help text of wide lines: names and values, then the default."""
    name, texts = "", {}
    for line in text.splitlines():
        if line.startswith("│"):
            line = line.strip("│ ")
            first = re.split(r"\s{2,}", line)[0]
            name = first if re.match(r"--?\w|[A-Z]+$|\{", first) else name
            default = re.search(r"\((default: .*?|required)\)$", line)
            texts[name] = default[1] if default else texts.get(name, "")
    return [f"{name} {default}".strip() for name, default in texts.items()]


def schema() -> dict[str, str]:
    """The schema, and without its texts."""

    def bare(part: Any) -> Any:
        if isinstance(part, dict):
            return {name: bare(inner) for name, inner in part.items() if not isinstance(inner, str) or name in TEXTS}
        return [bare(inner) for inner in part] if isinstance(part, list) else part

    text = say(["schema"])[0]
    return {"schema": text, "schema, bare": json.dumps(bare(json.loads(text)), indent=1, sort_keys=True) + "\n"}


def bad_input() -> dict[str, str]:
    """Exit code and sentence of each wrong command line."""
    with folder_of_files():
        return {line: say(shlex.split(line))[1] for line in CASES["bad_input"].splitlines()}


# ------------------------------------------------------------------ runs


def words_of(line: str, out: str | None = None) -> list[str]:
    """The words of a command, with its $names expanded."""
    while "$" in line:
        line = re.sub(r"\$([A-Z]+)", lambda found: CASES["words"][found[1]], line)
    words = shlex.split(line)
    return words + (["--out", out] if out else []) + (["--quiet"] if words[0] != "import-map" else [])


def start(words: list[str]) -> subprocess.Popen[str]:
    """A process of the command line of the imported package, in the current folder."""
    import sean_jax

    package = Path(sean_jax.__file__).resolve().parent
    environment = os.environ | {"COLUMNS": "100", "PYTHONPATH": str(package.parent)}
    command = [sys.executable, "-m", "sean_jax", *words]
    return subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)


def told(folder: Path, name: str) -> dict[str, str]:
    """Contents of the files of a folder, by the name and theirs; arrays by digests of their files."""
    texts = {}
    for path in sorted(path for pattern in TOLD for path in folder.rglob(pattern)):
        texts[f"{name} {path.relative_to(folder)}"] = plain(_lasting(path))
    for path in sorted(folder.rglob("weights.npz")):
        texts[f"{name} {path.relative_to(folder)}"] = f"{hashlib.sha256(path.read_bytes()).hexdigest()}\n"
    for manifest in sorted(folder.rglob("dataset.json")):
        files = sorted(path for path in manifest.parent.rglob("*") if path.is_file() and path != manifest)
        digests = [
            f"{hashlib.sha256(path.read_bytes()).hexdigest()} {path.relative_to(manifest.parent)}" for path in files
        ]
        texts[f"{name} {manifest.parent.relative_to(folder) / 'arrays'}"] = "\n".join(digests) + "\n"
    return texts


def _lasting(path: Path) -> str:
    """The text of a file, without parts that differ between two equal runs."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".yaml":
        return re.sub(r"^versions:\n(  .*\n)+", "", text, flags=re.MULTILINE)
    if path.suffix not in (".json", ".jsonl"):
        return text
    passing = (*PASSING.get(path.name, ()), "versions")

    def bare(part: Any) -> Any:
        return {name: value for name, value in part.items() if name not in passing} if isinstance(part, dict) else part

    parts = [bare(json.loads(line)) for line in (text.splitlines() if path.suffix == ".jsonl" else [text])]
    for part in parts:
        part |= {name: [bare(row) for row in rows] for name, rows in part.items() if isinstance(rows, list)}
    return "".join(json.dumps(part, indent=1, sort_keys=True) + "\n" for part in parts)


def runs(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """Output of small commands; the folders of some are kept."""
    (folder / "folders").mkdir(exist_ok=True)
    texts = {}
    with contextlib.chdir(folder / "folders"):
        add_files()
        for name in names:
            shutil.rmtree(name, ignore_errors=True)
            began = time.monotonic()
            process = start(words_of(CASES["runs"][name], name))
            said = plain(process.communicate()[1])
            texts[f"{name} exit"] = f"exit code {process.returncode}\n{said}"
            texts |= told(Path(name), name)
            print(f"  {name}: exit code {process.returncode} after {time.monotonic() - began:.0f} s", flush=True)
            if name not in CASES["kept"]:
                shutil.rmtree(name, ignore_errors=True)
    return texts


def folders(folder: Path) -> dict[str, str]:
    """Keep folders of killed commands, in addition to the folders of ``runs``."""
    if not (folder / "folders" / "data").is_dir():
        sys.exit(f"{folder}: there are no folders of runs; write these first.")
    with contextlib.chdir(folder / "folders"):
        for name, pattern in CASES["killed"].items():
            shutil.rmtree(f"half-{name}", ignore_errors=True)
            process = start(words_of(CASES["runs"][name], f"half-{name}"))
            while process.poll() is None and not list(Path(f"half-{name}").glob(pattern)):
                time.sleep(0.002)
            process.kill()
            process.communicate()
            print(f"  half-{name}: {'killed' if process.returncode < 0 else 'FINISHED'}", flush=True)
    return {}


def reopen(folder: Path) -> int:
    """Open a copy of the folders with the present code, and print its output; 1 if it is wrong."""
    records, wrong = read(folder)["runs"], 0
    with tempfile.TemporaryDirectory() as place:
        shutil.copytree(folder / "folders", place, dirs_exist_ok=True)
        with contextlib.chdir(place):
            cases = {name: line.partition(" = ")[::2] for name, line in CASES["opened"].items()}
            for name in CASES["killed"]:
                cases[f"unfinished {name}"] = (f"{CASES['runs'][name]} --out half-{name}", name)
            for name, (line, same) in cases.items():
                result = _opened(words_of(line), same, records)
                wrong += "BROKEN" in result or "differs" in result
                print(f"{name}: {result}", flush=True)
    return int(wrong > 0)


def _opened(words: list[str], same: str, records: dict[str, str]) -> str:
    """What became of a command; its files should be those of the records whose names begin with ``same``, if any."""
    process = start(words)
    said = plain(process.communicate()[1]).strip()
    code = process.returncode
    if code:
        return f"{'BROKEN' if 'Traceback' in said else 'refused'}, {code}: {said.splitlines()[-1:]}"
    if not same:
        return "opened"
    texts = told(Path(words[words.index("--out") + 1]), same.split()[0])
    names = {name for name in {*texts, *records} if f"{name} ".startswith(f"{same} ")} - {f"{same} exit"}
    differing = [name for name in names if digest(texts.get(name, "")) != records.get(name)]
    return f"opened, but differs in {', '.join(sorted(differing))}" if differing else "opened, equal"


# ------------------------------------------------------------------ commands


def file_of(folder: Path, section: str, name: str) -> Path:
    """The path of the copy of a name."""
    slug = re.sub(r"[^\w.,=-]+", "_", name).strip("_")[:100]
    return folder / section / (f"{slug}.txt.gz" if section == "jaxprs" else f"{slug}.txt")


def write(folder: Path, only: Iterable[str], names: Iterable[str] = ()) -> None:
    """Record the sections, with the named runs: a copy of each text, and goldens.json with the digests."""
    kept = read(folder) if (folder / "goldens.json").is_file() else {}
    folder.mkdir(parents=True, exist_ok=True)
    for section in only:
        began = time.monotonic()
        if section == "runs":
            texts = runs(folder, names or CASES["runs"])
        else:
            texts = WRITERS[section](folder)
        if not (section == "runs" and names):  # records of other runs are kept
            kept[section] = {}
            if section != "folders":
                shutil.rmtree(folder / section, ignore_errors=True)
        (folder / section).mkdir(exist_ok=True)
        for name, text in texts.items():
            data = text.encode()
            file_of(folder, section, name).write_bytes(gzip.compress(data, mtime=0) if section == "jaxprs" else data)
        kept[section] = kept.get(section, {}) | {name: digest(text) for name, text in texts.items()}
        (folder / "goldens.json").write_text(json.dumps(kept, indent=1, sort_keys=True) + "\n")
        print(f"{section}: {len(texts)} in {time.monotonic() - began:.0f} s", flush=True)


def digest(text: str) -> str:
    """SHA-256 of a text."""
    return hashlib.sha256(text.encode()).hexdigest()


def read(path: Path) -> dict[str, dict[str, str]]:
    """The digests in a folder, or in a file: by section and by name."""
    return json.loads((path / "goldens.json" if path.is_dir() else path).read_text())


def compare(before: Path, after: Path) -> int:
    """Print differences between the common sections, with their first lines; 1 if there are any."""
    first, second = read(before), read(after)
    differing = 0
    for section in sorted({*first, *second}):
        if section not in first or section not in second:
            print(f"{section}: only in {before if section in first else after}")
            continue
        old, new = first[section], second[section]
        names = sorted({*old, *new})
        if section == "runs":  # some may be missing, with --runs
            names = _in_both(old, new, names)
        changed = [name for name in names if old.get(name) != new.get(name)]
        print(f"{section}: {len(changed)} of {len(names)} differ")
        differing += len(changed)
        for name in changed:
            missing = [place for place, records in ((before, old), (after, new)) if name not in records]
            print(f"  {name}: {f'not in {missing[0]}' if missing else 'differs'}")
            _show_lines([file_of(place, section, name) for place in (before, after)])
    return int(differing > 0)


def _in_both(old: dict[str, str], new: dict[str, str], names: list[str]) -> list[str]:
    """The names of runs that both records have; prints the others."""
    old_runs, new_runs = ({name.split()[0] for name in records} for records in (old, new))
    if old_runs != new_runs:
        print(f"not in both: {', '.join(sorted(old_runs ^ new_runs))}")
    return [name for name in names if name.split()[0] in old_runs & new_runs]


def _show_lines(copies: list[Path]) -> None:
    """Print the first lines in which two copies differ, if there are both."""
    if all(copy.is_file() for copy in copies):
        texts = [_text(copy).splitlines() for copy in copies]
        lines = list(difflib.unified_diff(*texts, lineterm="", n=0))[2:]
        print("\n".join(f"    {line[:160]}" for line in lines[:SHOWN]))


def _text(path: Path) -> str:
    data = path.read_bytes()
    return (gzip.decompress(data) if path.suffix == ".gz" else data).decode()


WRITERS: dict[str, Callable[[Path], dict[str, str]]] = {
    "jaxprs": lambda _: jaxprs(),
    "help": lambda _: help_texts(),
    "schema": lambda _: schema(),
    "bad_input": lambda _: bad_input(),
    "folders": folders,
}


def main() -> int:
    """Write, compare or open."""
    arguments = parser(__doc__)
    commands = arguments.add_subparsers(dest="command", required=True)
    writing = commands.add_parser("write")
    writing.add_argument("folder", type=Path)
    runs = Option([], "some of goldens.yaml", choices=CASES["runs"], metavar="NAME")
    add_options(writing, only=Option(list(SECTIONS), choices=SECTIONS), runs=runs)
    comparing = commands.add_parser("compare")
    comparing.add_argument("before", type=Path)
    comparing.add_argument("after", type=Path)
    opening = commands.add_parser("open")
    opening.add_argument("folder", type=Path)
    chosen = arguments.parse_args()
    if chosen.command == "compare":
        return compare(chosen.before, chosen.after)
    if chosen.command == "open":
        return reopen(chosen.folder.resolve())
    folder = chosen.folder.resolve()
    os.environ.setdefault("XDG_CACHE_HOME", str(folder / "cache"))  # tables of an older cache have other roundings
    write(folder, chosen.only, chosen.runs)
    return 0


if __name__ == "__main__":
    sys.exit(main())
