"""Mutation test: whether the quick tests notice faults that are put into the package, one at a time.

    python benchmarks/mutants.py --only classifiers --count 50   # the first 50 faults of a folder, in a drawn order
    python benchmarks/mutants.py --only classifiers --again      # those that survive without a reason, once more
    python benchmarks/mutants.py --summary                       # what is in the results

Each mutant is a line of the results, so that a run that was stopped goes on where it was. Those whose line of the
package is another one by now leave the results, and others are drawn in their place. A mutant *survives* if none of
the quick tests that are chosen for its module fails. `mutants.yaml` says why one cannot be noticed, or need not be.

The tests of a module are those of TELLING, then of the files that name most of what it defines. They run once without
a fault, for their times and the lines that they reach; a mutant has the tests that reach its line first. All runs are
forked from one process that has imported what is heavy and has started nothing (see tests/support/forked.py).
"""

import ast
import collections
import contextlib
import ctypes
import functools
import importlib
import json
import os
import random
import re
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from options import Option, parse

ROOT = Path(__file__).resolve().parent.parent
PACKAGE, TESTS = ROOT / "sean_jax", ROOT / "tests"
RESULTS, REASONS = ROOT / "results/mutants/mutants.jsonl", ROOT / "benchmarks/mutants.yaml"
FOLDERS = {
    "classifiers": ["classifiers"],
    "metrics": ["metrics/metric.py", "metrics/path.py", "metrics/proximity.py"],
    "statistics": ["metrics/bootstrap.py", "metrics/differences.py", "studies/experiments/ranks.py"],
    "graph": ["graph"],
    "behaviors": ["people/behaviors"],
    "readers": ["io/files", "people/recordings"],
    "survey": ["studies/survey"],
}
FILES, SECONDS = 4, 25.0  # test files for a module at most, and what they take at most
TELLING = {  # module or folder -> its own tests, where names alone lead to others
    "classifiers": "situations_swept situations more_situations more_situations_of_objects",
    "classifiers/conversation": "more_situations",
    "metrics": "metrics_swept metrics metric_constructors proximity",
    "metrics/bootstrap": "differences_swept bootstrap",
    "metrics/differences": "differences_swept compare",
    "studies/experiments/ranks": "differences_swept benchmark",
    "graph": "behavior_graph_swept graph",
    "graph/annotation": "behavior_graph_swept graph environments",
    "people/behaviors/graph_behavior": "graph_behavior graph_choices starts_groups",
    "people/behaviors/graph_choices": "graph_choices graph_choices_successors",
    "people/behaviors/handcrafted_behavior": "handcrafted",
    "people/behaviors/playback": "playback",
    "people/behaviors/random_behavior": "random_behavior",
    "people/behaviors/starts": "random_behavior starts_groups environment_edge",
    "io/files": "files files_bad_input",
    "io/files/database": "database export",
    "io/files/meshes": "importing whole_body files",
    "io/files/mjcf": "importing environments files_bad_input",
    "people/recordings": "recordings_swept recordings",
    "studies/survey": "export survey ratings",
    "studies/survey/ratings": "ratings",
    "studies/survey/report": "export ratings",
}
HEAVY = "scipy.stats scipy.optimize scipy.sparse.csgraph mujoco optax matplotlib.figure PIL.Image networkx pydantic"
LASTING = "navigation", "next_corner", "mesh_places"  # tables that none of the folders above has a part in

COMPARISONS = {"<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "==", "in": "not in", "not in": "in"}
COMPARISONS |= {"is": "is not", "is not": "is"}
OPERATORS = {"+": "-", "-": "+", "*": "/", "/": "*", "//": "/", "%": "*", "**": "*", "&": "|", "|": "&"}
SIGNS = {
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=", ast.In: "in",
    ast.NotIn: "not in", ast.Is: "is", ast.IsNot: "is not", ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/",
    ast.FloorDiv: "//", ast.Mod: "%", ast.Pow: "**", ast.BitAnd: "&", ast.BitOr: "|",
}  # fmt: skip
PAIRS = ("min", "max"), ("minimum", "maximum"), ("argmin", "argmax"), ("floor", "ceil"), ("any", "all"), ("sin", "cos")
OTHERS = dict(PAIRS) | {second: first for first, second in PAIRS}
DROPPED = {"where": (1, 2), "clip": (0,), "abs": (0,), "maximum": (0, 1), "minimum": (0, 1)}  # call -> what stays
AXES = {"sum", "mean", "min", "max", "any", "all", "argmin", "argmax", "prod", "cumsum"}


@dataclass(frozen=True)
class Mutant:
    """A fault: bytes of a file, and what stands there instead."""

    path: str
    line: int
    begin: int
    end: int
    text: str
    before: str
    after: str

    @property
    def name(self) -> str:
        """What tells it from others, though lines be moved."""
        return f"{self.path}: {self.before} -> {self.after}"


# What can be put in


def mutants(path: str, source: bytes) -> list[Mutant]:
    """All mutants of a module, by their place."""
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    lines = source.splitlines()
    changes = {}

    def at(line: int, column: int) -> int:
        return starts[line - 1] + column

    def span(node: ast.AST) -> tuple[int, int]:
        return at(node.lineno, node.col_offset), at(node.end_lineno, node.end_col_offset)  # type: ignore

    def put(begin: int, end: int, text: bytes | str) -> None:
        """One mutant, named by the line that it changes, or by its first line."""
        text = text.encode() if isinstance(text, str) else text
        first = source.count(b"\n", 0, begin) + 1
        left, tail = source[starts[first - 1] : begin], lines[source.count(b"\n", 0, end)]
        right = tail[end - starts[source.count(b"\n", 0, end)] :]
        before = b" ".join((left + source[begin:end] + right).split()).decode()
        after = b" ".join((left + text + right).split()).decode()
        changes[begin, end, text] = Mutant(path, first, begin, end, text.decode(), before, after)

    nodes = list(_code(ast.parse(source)))
    axes = {id(axis) for node in nodes if isinstance(node, ast.Call) for axis in _axes(node)}
    for node in nodes:
        if id(node) in axes:
            put(*span(node), str(int(node.value == 0)))  # type: ignore
            continue
        for begin, end, text in _changes(node, span, source):
            put(begin, end, text)
    return [changes[key] for key in sorted(changes)]


def _code(node: ast.AST) -> Iterator[ast.AST]:
    """The nodes that compute: no annotations, no texts of errors, no lists of names."""
    if isinstance(node, ast.Raise | ast.JoinedStr | ast.Import | ast.ImportFrom):
        return
    if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
        return
    if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING":
        return
    yield node
    for field, value in ast.iter_fields(node):
        if field not in ("annotation", "returns", "type_params"):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from _code(child)


def _changes(node: ast.AST, span: Callable, source: bytes) -> Iterator[tuple[int, int, bytes | str]]:
    """Places and what is put there."""
    if isinstance(node, ast.Compare):
        for left, sign, right in zip([node.left, *node.comparators], node.ops, node.comparators, strict=False):
            yield from _sign(span(left)[1], span(right)[0], SIGNS[type(sign)], COMPARISONS, source)
    elif isinstance(node, ast.BinOp) and type(node.op) in SIGNS:
        yield from _sign(span(node.left)[1], span(node.right)[0], SIGNS[type(node.op)], OPERATORS, source)
    elif isinstance(node, ast.BoolOp):
        sign, other = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
        for left, right in zip(node.values, node.values[1:], strict=False):
            yield from _sign(span(left)[1], span(right)[0], sign, {sign: other}, source)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.Invert | ast.USub):
        (begin, end), (first, last) = span(node), span(node.operand)
        whole = last < end  # an operand in parentheses
        yield (begin, end, b"(" + source[first:last] + b")") if whole else (begin, first, b"")
    elif isinstance(node, ast.If | ast.IfExp | ast.While) and not isinstance(node.test, ast.Compare | ast.BoolOp):
        begin, end = span(node.test)
        yield begin, end, b"(not " + source[begin:end] + b")"
    elif isinstance(node, ast.Constant):
        yield from ((*span(node), text) for text in _constant(node.value))
    elif isinstance(node, ast.Call):
        yield from _call(node, span, source)


def _sign(begin: int, end: int, sign: str, others: dict[str, str], source: bytes) -> Iterator[tuple[int, int, str]]:
    """The sign between two operands, among their parentheses."""
    words = sign.replace(" ", r"\s+") if sign[0].isalpha() else re.escape(sign)
    if match := re.search(words.encode(), source[begin:end]):
        yield begin + match.start(), begin + match.end(), others[sign]


def _constant(value: Any) -> Iterator[str]:
    if isinstance(value, bool):
        yield str(not value)
    elif isinstance(value, int):
        yield str(value + 1)
    elif isinstance(value, float):
        yield repr(1.5 * value) if value else "1.0"


def _call(node: ast.Call, span: Callable, source: bytes) -> Iterator[tuple[int, int, bytes | str]]:
    called, name = node.func, _name(node)
    whole, arguments = span(node), [span(argument) for argument in node.args]
    texts = [source[begin:end] for begin, end in arguments]
    if name in OTHERS:
        yield span(called)[1] - len(name), span(called)[1], OTHERS[name]
    for kept in DROPPED.get(name, ()):
        if len(texts) > max(kept, name != "abs"):
            yield *whole, texts[kept]
    plain = [isinstance(argument, ast.Name | ast.Attribute) for argument in node.args]
    for k in range(len(texts) - 1):
        if plain[k] and plain[k + 1] and texts[k] != texts[k + 1]:
            between = source[arguments[k][1] : arguments[k + 1][0]]
            yield arguments[k][0], arguments[k + 1][1], texts[k + 1] + between + texts[k]


def _axes(node: ast.Call) -> list[ast.Constant]:
    """The axes of jnp.sum(x, 1) and x.sum(1), which are other axes in a mutant and no others' numbers."""
    words = [word.value for word in node.keywords if word.arg == "axis"]
    candidates = [*node.args, *words] if _name(node) in AXES else words
    return [axis for axis in candidates if isinstance(axis, ast.Constant) and type(axis.value) is int]


def _name(node: ast.Call) -> str:
    return node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")


def modules(folder: str) -> list[str]:
    """The modules of one of FOLDERS, as paths inside the package."""
    paths = []
    for part in FOLDERS[folder]:
        paths += (
            [part]
            if part.endswith(".py")
            else sorted(str(p.relative_to(PACKAGE)) for p in (PACKAGE / part).rglob("*.py"))
        )
    return paths


def drawn(folder: str, count: int, seed: int, known: Iterable[str] = ()) -> list[Mutant]:
    """So many mutants of a folder, those known first; more of them begin with the same."""
    everything = [mutant for path in modules(folder) for mutant in mutants(path, (PACKAGE / path).read_bytes())]
    random.Random(f"{seed} {folder}").shuffle(everything)
    everything = list({mutant.name: mutant for mutant in everything}.values())
    names = set(known)
    return sorted(everything, key=lambda mutant: mutant.name not in names)[:count]


# Which tests


def test_files(path: str) -> list[str]:
    """Its own, and the files that name most of what a module defines, names that few files have counting more."""
    tree = ast.parse((PACKAGE / path).read_bytes())
    names = {node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    names |= {
        t.id for node in tree.body if isinstance(node, ast.Assign) for t in node.targets if isinstance(t, ast.Name)
    }
    names.add(path.removesuffix(".py").removesuffix("/__init__").replace("/", "."))
    words = _words()
    score: dict[str, float] = collections.defaultdict(float)
    for name in names:
        having = [file for file, known in words.items() if name in known]
        for file in having:
            score[file] += 1 / len(having)
    telling = TELLING.get(path.removesuffix(".py")) or TELLING.get(str(Path(path).parent), "")
    named = [file for name in telling.split() for file in words if Path(file).stem == f"test_{name}"]
    others = [file for file in sorted(score, key=lambda file: -score[file])[:FILES] if score[file] > 0.2]
    return list(dict.fromkeys([*named, *others]))[:FILES]


@functools.cache
def _words() -> dict[str, set[str]]:
    """File of tests, in whatever folder -> the words in it."""
    files = [file for file in TESTS.rglob("test_*.py") if file.name not in ("test_structure.py", "test_mutants.py")]
    return {
        file.relative_to(TESTS).as_posix(): set(re.findall(r"[\w.]+", text)) | set(re.findall(r"\w+", text))
        for file in files
        for text in [file.read_text()]
    }


@dataclass
class Choice:
    """The tests of a module: nodes in the order of their files, each with its seconds and the lines that it reaches."""

    seconds: dict[str, float]
    reach: dict[str, list[int]]

    def order(self, line: int) -> list[str]:
        """Files by the time of what reaches the line, and within them what reaches it, the quickest first."""

        def cost(node: str) -> tuple[bool, float]:
            return line not in self.reach[node], self.seconds[node]

        files = collections.defaultdict(list)
        for node in self.seconds:
            files[node.split("::")[0]].append(node)
        return [
            node
            for nodes in sorted(files.values(), key=lambda n: min(map(cost, n)))
            for node in sorted(nodes, key=cost)
        ]


# Runs, each in a process of its own


def _run(work: Callable[[], Any], limit: float) -> Any:
    """What the work returns in a child; None if it takes too long, a number if a signal or an exit ended it."""
    reader, writer = os.pipe()
    child = os.fork()
    if not child:
        code = 1
        with contextlib.suppress(BaseException):
            _end_with_parent()
            os.setsid()
            os.close(reader)
            for descriptor in (0, 1, 2):
                os.dup2(os.open(os.devnull, os.O_RDWR), descriptor)
            answer = json.dumps(work()).encode()
            with os.fdopen(writer, "wb") as stream:
                stream.write(answer)
            code = 0
        os._exit(code)
    os.close(writer)
    signal.signal(signal.SIGALRM, _late)
    signal.alarm(int(limit) + 1)
    try:
        with os.fdopen(reader, "rb") as stream:
            answer = stream.read()
    except TimeoutError:
        answer = None
    finally:
        signal.alarm(0)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return None if answer is None else json.loads(answer) if answer else status


def _end_with_parent() -> None:
    """Have Linux end this process when the one that forked it ends."""
    getattr(ctypes.CDLL(None), "prctl", lambda *_: None)(1, signal.SIGKILL)


def _late(*_) -> None:
    raise TimeoutError


class _Watch:
    """What pytest is told, and what it tells."""

    def __init__(self, order: list[str] | None = None, watched: str = "", most: float = SECONDS):
        self.order, self.watched, self.most = order, watched, most
        self.failed: list[str] = []
        self.seconds, self.lines = collections.defaultdict(float), collections.defaultdict(set)
        self.now: set[int] = set()

    def pytest_collection_modifyitems(self, config, items) -> None:
        if self.order is not None:
            place = {node: k for k, node in enumerate(self.order)}
            items[:] = sorted((item for item in items if item.nodeid in place), key=lambda item: place[item.nodeid])

    def pytest_runtest_protocol(self, item, nextitem) -> bool | None:
        # Without an order the times are asked for; files are in the order of what they tell.
        if self.order is None and self.seconds and sum(self.seconds.values()) > self.most:
            return True

    def pytest_runtest_logstart(self, nodeid, location) -> None:
        self.now = self.lines[nodeid]
        if self.watched:
            sys.settrace(self._call)

    def pytest_runtest_logfinish(self, nodeid, location) -> None:
        sys.settrace(None)

    def pytest_runtest_logreport(self, report) -> None:
        self.seconds[report.nodeid] += report.duration
        if report.failed:
            self.failed.append(report.nodeid)

    def pytest_collectreport(self, report) -> None:
        if report.failed:
            self.failed.append(f"{report.nodeid}, at import")

    def _call(self, frame, event, argument):
        return self._line if frame.f_code.co_filename == self.watched else None

    def _line(self, frame, event, argument):
        self.now.add(frame.f_lineno)
        return self._line


def _pytest(files: list[str], watch: _Watch, folder: Path) -> int:
    import pytest

    importlib.import_module("support.shapes").install = lambda package: None  # this process has done it
    shutil.copytree(Path(os.environ["XDG_CACHE_HOME"]), folder / "user", ignore=_not_lasting)
    os.environ["XDG_CACHE_HOME"] = str(folder / "user")
    paths = [str(TESTS / file) for file in files]
    outside = ["-p", "no:cacheprovider", "-p", "no:xdist", f"--basetemp={folder}/tmp"]
    options = ["-q", "-m", "not slow and not night", "-o", "addopts=", "--import-mode=importlib", *outside]
    first = ["-x"] if watch.order else []  # of a mutant, one that notices it is enough
    return int(pytest.main([*options, *first, *paths], plugins=[watch]))


def _not_lasting(folder: str, names: list[str]) -> list[str]:
    return [name for name in names if name.endswith(".npz") and not name.startswith(LASTING)]


def _install(path: str, source: bytes) -> None:
    """Has a module compiled from this source, and nothing written beside it."""
    from importlib.machinery import SourceFileLoader

    sys.dont_write_bytecode = True
    whole, stem, read = str(PACKAGE / path), Path(path).stem, SourceFileLoader.get_data

    def get_data(self, wanted):
        wanted = str(wanted)
        if wanted == whole:
            return source
        if wanted.endswith(".pyc") and getattr(self, "path", "") == whole and stem in wanted:
            raise OSError
        return read(self, wanted)

    setattr(SourceFileLoader, "get_data", get_data)  # noqa: B010 its type has another name for the argument


def baseline(path: str, most: float = SECONDS) -> Choice:
    """The tests of a module, without a fault."""
    files = test_files(path)

    def work():
        with tempfile.TemporaryDirectory() as folder:
            watch = _Watch(watched=str(PACKAGE / path), most=most)
            _pytest(files, watch, Path(folder))
        return {
            node: [watch.seconds[node], sorted(watch.lines[node])] for node in watch.seconds if node not in watch.failed
        }

    timings = _run(work, 600.0)
    if not isinstance(timings, dict):
        raise SystemExit(f"{path}: its tests ended with {timings}; run {' '.join(files)}")
    reaching = {node.split("::")[0] for node in timings if timings[node][1]}
    chosen = [node for node in timings if node.split("::")[0] in reaching]
    return Choice({node: timings[node][0] for node in chosen}, {node: timings[node][1] for node in chosen})


def attempt(mutant: Mutant, choice: Choice) -> tuple[str | None, float]:
    """The test that notices it, or None; and the seconds that it took."""
    source = (PACKAGE / mutant.path).read_bytes()
    source = source[: mutant.begin] + mutant.text.encode() + source[mutant.end :]
    order = choice.order(mutant.line)
    if not order:  # pytest would end with another code than 0 for the lack of tests
        return None, 0.0
    files = list(dict.fromkeys(node.split("::")[0].split("/")[-1] for node in order))

    def work():
        with tempfile.TemporaryDirectory() as folder:
            _install(mutant.path, source)
            watch = _Watch(order)
            return [_pytest(files, watch, Path(folder)), watch.failed[:1]]

    began = time.perf_counter()
    outcome = _run(work, 30.0 + 3.0 * sum(choice.seconds.values()))
    seconds = time.perf_counter() - began
    if not isinstance(outcome, list):
        return "the time limit" if outcome is None else f"the end of the process, {outcome}", seconds
    code, failed = outcome
    return (failed[0] if failed else f"pytest's exit code {code}") if code else None, seconds


def independent(path: str) -> list[str]:
    """The modules of the package that do not import this one, also not through others; they are imported once."""
    names = {_module(str(file.relative_to(PACKAGE))): file for file in PACKAGE.rglob("*.py")}
    uses = {name: _imports(name, file, names) for name, file in names.items()}
    depends, importers = set(), {_module(path)}
    while importers:
        depends |= importers
        importers = {name for name, used in uses.items() if used & depends} - depends
    # Importing a module imports the packages that it is in.
    names.pop("sean_jax.__main__", None)
    return [name for name in names if not any(f"{name}.".startswith(f"{other}.") for other in depends)]


def _module(path: str) -> str:
    return ".".join(["sean_jax", *Path(path).with_suffix("").parts]).removesuffix(".__init__")


def _imports(name: str, file: Path, names: dict[str, Path]) -> set[str]:
    used = set()
    for node in ast.walk(ast.parse(file.read_bytes())):
        if isinstance(node, ast.ImportFrom) and node.module:
            used |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            used |= {alias.name for alias in node.names}
    parents = {".".join(part.split(".")[:k]) for part in used for k in range(2, part.count(".") + 1)}
    return {part for part in used | parents if part in names and part != name}


# Results


def results(path: Path) -> dict[str, dict]:
    """The last line about each mutant."""
    lines = map(json.loads, path.read_text().splitlines()) if path.is_file() else ()
    return {line["name"]: line for line in lines}


def tidy(path: Path) -> None:
    """Write the results anew: one line for each mutant that can still be put in, by its place."""
    known = results(path)
    lines = []
    for folder in FOLDERS:
        for module in modules(folder):
            present = {mutant.name: mutant for mutant in mutants(module, (PACKAGE / module).read_bytes())}
            lines += [known[name] | {"line": mutant.line} for name, mutant in present.items() if name in known]
    # A run that is stopped here leaves the old results.
    new = path.with_suffix(".new")
    new.write_text("".join(json.dumps(line) + "\n" for line in lines))
    new.replace(path)


def reasons() -> dict[str, str]:
    """Why mutants are not noticed: name -> sentence."""
    return yaml.safe_load(REASONS.read_text()) or {} if REASONS.is_file() else {}


def summary(known: dict[str, dict]) -> list[str]:
    """A line for each folder, and one for each mutant that survives without a reason."""
    why, lines = reasons(), [f"{'folder':12} mutants noticed explained survived"]
    counts, survived = collections.defaultdict(lambda: [0, 0, 0, 0]), []
    for name, line in known.items():
        kind = 1 if line["noticed"] else 2 if name in why else 3
        for folder in (line["folder"], "all"):
            counts[folder][0] += 1
            counts[folder][kind] += 1
        path, change = name.split(": ", 1)
        survived += [f"{path}:{line['line']}: {change}"] * (kind == 3)
    order = [folder for folder in (*FOLDERS, "all") if folder in counts]
    lines += [
        f"{folder:12} {' '.join(f'{n:{w}d}' for n, w in zip(counts[folder], (7, 7, 9, 8), strict=True))}"
        for folder in order
    ]
    return [*lines, *sorted(survived)]


def _module_run(folder: str, path: str, chosen: list[Mutant], out: Path, most: float) -> int:
    for name in independent(path):
        with contextlib.suppress(ImportError):  # of a package that is not installed
            importlib.import_module(name)
    choice = baseline(path, most)
    print(f"{path}: {len(choice.seconds)} tests, {sum(choice.seconds.values()):.0f} s", flush=True)
    for mutant in chosen:
        noticed, seconds = attempt(mutant, choice)
        line = {"folder": folder, "name": mutant.name, "line": mutant.line}
        line |= {"noticed": noticed, "seconds": round(seconds, 1)}
        with out.open("a") as stream:
            stream.write(json.dumps(line) + "\n")
        said = "noticed " if noticed else "SURVIVED"
        print(f"{seconds:5.1f} s  {said}  {path}:{mutant.line}: {mutant.before} -> {mutant.after}", flush=True)
    return 0


def main() -> None:
    """Run the command."""
    chosen = parse(
        __doc__,
        only=Option(list(FOLDERS), "folders (all)", choices=FOLDERS),
        count=Option(400, "mutants, of all seven folders (400)"),
        seed=0,
        again=Option(False, "run those that survive without a reason once more"),
        seconds=Option(SECONDS, f"of the tests of a module, about ({SECONDS:g})", kind=float),
        out=Option(RESULTS, str(RESULTS), kind=Path),
        summary=Option(False, "print what is in the results, and run nothing"),
    )
    if not chosen.summary:
        _begin()
        chosen.out.parent.mkdir(parents=True, exist_ok=True)
        tidy(chosen.out)
        known = results(chosen.out)
        count = -(-chosen.count // len(FOLDERS))
        for folder in chosen.only:
            waiting = [m for m in drawn(folder, count, chosen.seed, known) if _open(m, known, chosen.again)]
            for path in sorted({mutant.path for mutant in waiting}):
                of_module = [mutant for mutant in waiting if mutant.path == path]
                _fork(
                    lambda path=path, some=of_module, folder=folder: _module_run(
                        folder, path, some, chosen.out, chosen.seconds
                    )
                )
        tidy(chosen.out)
    print(*summary(results(chosen.out)), sep="\n")


def _open(mutant: Mutant, known: dict[str, dict], again: bool) -> bool:
    """Whether it is to be run: not known, or with ``--again`` not noticed and not explained."""
    if again:
        return mutant.name in known and not known[mutant.name]["noticed"] and mutant.name not in reasons()
    return mutant.name not in known


def _begin() -> None:
    """Import what is heavy, as the tests do, and start nothing."""
    sys.path[:0] = [str(TESTS), str(ROOT)]
    os.chdir(ROOT)
    for name in ("conftest", *HEAVY.split()):
        importlib.import_module(name)


def _fork(work: Callable[[], int]) -> None:
    child = os.fork()
    if not child:
        code = 1
        try:
            _end_with_parent()
            code = work()
        except BaseException:
            import traceback

            traceback.print_exc()
        finally:
            sys.stdout.flush()
            os._exit(code)
    if os.waitpid(child, 0)[1]:
        raise SystemExit("a module's run ended in an error; see above")


if __name__ == "__main__":
    main()
