"""The house keeps its shape: documented families, a light start, one gate for files, a clean repository."""

import ast
import inspect
import re
import sys
import tomllib
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest
import yaml

from support.checkout import ROOT, repository_files
from support.commands import python

pytestmark = pytest.mark.form
PACKAGE = ROOT / "sean_jax"
MODULES = sorted(PACKAGE.rglob("*.py"))
HEAVY = ("jax", "mujoco", "matplotlib", "flax", "optax", "orbax", "scipy")
EXTRAS = "matplotlib tyro websockets rosbags optax orbax tensorstore gymnasium".split()  # not for ``evaluate``
FAMILIES = {
    "sean_jax.social_forces": "PRESETS",
    "sean_jax.classifiers": "SITUATIONS",
    "sean_jax.people.behaviors": "BEHAVIORS",
    "sean_jax.people.pedestrian_models": "MODELS",
    "sean_jax.tasks": "TASKS",
    "sean_jax.robots": "ROBOTS",
    "sean_jax.metrics": "METRICS",
    "sean_jax.policies": "POLICIES",
    "sean_jax.sensors": "SENSORS",
}


def dotted(path: Path) -> str:
    """Module name of a file: sean_jax/graph/tables.py -> sean_jax.graph.tables."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


NAMES = {dotted(path) for path in MODULES}


def room(module: str) -> str:
    """The part that has a floor: sean_jax.graph.tables -> graph; the package itself has the empty name."""
    return (module.split(".") + [""])[1]


TRAINERS = ("ppo.py", "shac.py", "rollouts.py", "reinforcement.py", "curriculum.py", "bc.py")


def test_an_environment_is_the_place():
    """And a scenario the whole: neither is called 'env', but for the ``Env`` of reinforcement learning."""
    for path in MODULES:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        learns = room(dotted(path)) in ("mdp", "adapters") or path.name in TRAINERS
        names = {getattr(node, field, None) for node in ast.walk(tree) for field in ("id", "arg", "name")}
        assert learns or "env" not in names, path


def test_command_line_starts_without_heavy_imports():
    program = f"import sys, sean_jax.cli.command_line; print([name for name in {HEAVY!r} if name in sys.modules])"
    assert python("-c", program, cwd=ROOT).strip() == "[]"


def test_a_simulation_needs_no_package_of_reports_and_servers():
    """What is drawn, printed or served is imported with the first picture, table or server."""
    wanted = {"make, step, rollout, make_env": ("matplotlib", "tyro", "jinja2", "PIL"), "evaluate": EXTRAS}
    for names, unused in wanted.items():
        imports = f"import sys\nfrom sean_jax import {names}\n"
        loaded = python("-c", f"{imports}print([name for name in {unused!r} if name in sys.modules])", cwd=ROOT)
        assert loaded.strip() == "[]"


def test_no_import_starts_a_backend():
    """So that who imports can still choose platform and precision, join other hosts, or fork."""
    program = f"""
import importlib
for name in {sorted(name for name in NAMES if room(name) != "adapters")!r}:
    importlib.import_module(name)
from jax._src import xla_bridge
print(xla_bridge.backends_are_initialized())
"""
    assert python("-c", program, cwd=ROOT).split() == ["False"]


UNCHANGED = """
import gc, logging, os, signal, sys, warnings
import jax, numpy, scipy.sparse, scipy.special

def state_of_the_process():
    loggers = [logging.root, *(logging.getLogger(name) for name in list(logging.root.manager.loggerDict))]
    return {
        "environment": dict(os.environ),
        "jax.config": dict(jax.config.values),
        "numpy": (numpy.geterr(), numpy.get_printoptions(), numpy.random.get_state()[1].tolist()),
        "warnings": list(warnings.filters),
        "signals": {number: signal.getsignal(number) for number in signal.valid_signals()},
        "hooks": (sys.displayhook, sys.excepthook, sys.unraisablehook, sys.path, sys.getrecursionlimit()),
        "collector": (gc.isenabled(), gc.get_threshold(), gc.callbacks[:]),
        "logging": {one.name: (one.level, one.handlers[:], one.filters[:], one.disabled) for one in loggers},
    }

before = state_of_the_process()
import sean_jax
for name in sean_jax.__all__:
    getattr(sean_jax, name)
for part, now in state_of_the_process().items():
    if part == "logging":  # a logger that is new, and like any other, changes nothing
        before[part] = dict.fromkeys(now, (logging.NOTSET, [], [], False)) | before[part]
    assert now == before[part], (part, now, before[part])
"""


def test_an_import_changes_nothing_in_the_process():
    """Beyond what JAX and scipy change. The command line changes its own process, and no other."""
    python("-c", UNCHANGED, cwd=ROOT)


def described_values(package: str) -> set[str]:
    """Names of a package's module-level values whose assignment is followed by a string that describes them."""
    found = set()
    for path in (ROOT / package.replace(".", "/")).glob("*.py"):
        body = ast.parse(path.read_text(encoding="utf-8")).body
        for node, after in zip(body, body[1:], strict=False):
            if isinstance(node, ast.Assign) and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
                found |= {target.id for target in node.targets if isinstance(target, ast.Name)}
    return found


@pytest.mark.parametrize("module", FAMILIES)
def test_family_is_a_plain_documented_dict(module):
    """An entry is a function, a value that holds functions, or a data file; functions are at module level."""
    from sean_jax.metrics import Metric

    family = getattr(import_module(module), FAMILIES[module])
    assert type(family) is dict and family
    for name, entry in family.items():
        assert re.fullmatch(r"[a-z][a-z0-9_]*", name)
        if isinstance(entry, Path):
            assert entry.is_file()
            continue
        values = entry if isinstance(entry, tuple) else [entry] if callable(entry) else vars(entry).values()
        if FAMILIES[module] == "PRESETS":  # whose terms hold the functions
            values = [value for term in entry for value in vars(term).values()]
        functions = [value for value in values if callable(value)]
        own_value = isinstance(entry, tuple | Metric)  # made once, at module level
        if own_value:
            assert name in described_values(module), f"{name}: its assignment is not followed by a docstring"
        assert functions, f"{name} holds no function"
        for function in functions:
            assert inspect.isfunction(function), f"{name}: {function} is not a plain function"
            if function is entry or not own_value:
                assert function is vars(sys.modules[function.__module__]).get(function.__name__), (
                    f"{name}: {function.__qualname__} is not at module level: made anew, a static field traces again"
                )
                assert inspect.getdoc(function), f"{name}: {function.__name__} has no docstring"


def test_public_names_exist_and_are_documented():
    import sean_jax

    assert sean_jax.__all__
    for name in sean_jax.__all__:
        value = getattr(sean_jax, name)
        assert name in dir(sean_jax)
        if inspect.isfunction(value) or inspect.isclass(value) or isinstance(value, ModuleType):
            assert inspect.getdoc(value), name
    with pytest.raises(AttributeError):
        sean_jax.no_such_name  # noqa: B018


OPENERS = set(
    """
    AnyReader ElementTree.fromstring ElementTree.iterparse ElementTree.parse Image.open ast.literal_eval csv.reader
    from_xml_path from_xml_string gzip.open json.load json.loads minidom.parse np.fromfile np.genfromtxt np.load
    np.loadtxt np.memmap open pickle.load pickle.loads pq.ParquetFile pq.read_schema pq.read_table read_bytes
    read_text sqlite3.connect tarfile.open urlparse urlsplit yaml.compose yaml.load yaml.safe_load zipfile.ZipFile
    """.split()
)
"""Calls that open or understand what comes from outside. ``files`` bounds it, and tells what is wrong with it."""

ALLOWED = {
    "learning/dataset.py _open_array": "tensorstore, whose files are compared with the manifest",
    "world/ros_map.py _opened": "of an open file or of bytes, of bounded size",
    "people/recordings/reading.py _read_columns": "of a text of bounded size",
    "web/studio/trial.py _recover_file": "the end of a drive that was just read, to be written",
    "web/studio/yaml_text.py node_at": "of a text that files.load has read",
    "io/trajectories.py _Csv.join": "parts that it wrote itself",
    "io/trajectories.py _Parquet.join": "parts that it wrote itself",
    "io/trajectories.py _Parquet.read": "of an open file of bounded size",
    "io/trajectories.py _Parquet.read.blocks": "of an open file of bounded size",
    "web/local_server.py split": "the gate of addresses",
    "core/messages.py parse_json": "the gate of JSON",
    "io/writing.py _holder": "200 bytes of a lock",
    "simulation/making.py make_tables": "an argument of this package's own process",
}
"""FILE FUNCTION that calls one of these outside of ``files`` -> why it may."""

FORMATS = {"ros/bag_opening.py": "bags, which rosbags and SQLite read"}
"""Modules that are the one reader of a format of their own, with its bounds."""


def opened(path: Path) -> set[str]:
    """FILE FUNCTION of each call of ``OPENERS`` in a module, but for ``files`` and JSON that was just written."""
    found = set()

    def visit(node: ast.AST, names: tuple[str, ...]) -> None:
        if isinstance(node, ast.Call):
            call = ast.unparse(node.func)
            of_own = call.startswith(("files.", "os.")) or call in ("read_text", "read_bytes")  # of files, imported
            of_own = of_own or (call.endswith(".open") and "orkspace(" in call)
            again = call == "json.loads" and ast.unparse(node.args[0]).startswith("json.dumps(")
            writes = any(isinstance(arg, ast.Constant) and str(arg.value)[:1] in "wax" for arg in node.args[:2])
            last = call.rpartition(".")[2]
            named = call in OPENERS or (last in {name.rpartition(".")[2] for name in OPENERS if "." not in name})
            if named and not (of_own or again or writes):
                found.add(f"{path.relative_to(PACKAGE).as_posix()} {'.'.join(names)}")
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names = (*names, node.name)
        for child in ast.iter_child_nodes(node):
            visit(child, names)

    visit(ast.parse(path.read_text(encoding="utf-8")), ())
    return found


def test_files_of_others_are_opened_in_one_place():
    found = set().union(*(opened(path) for path in MODULES if not dotted(path).startswith("sean_jax.io.files")))
    assert {name for name in found if name.split()[0] not in FORMATS} == ALLOWED.keys()


def test_no_regular_expression_goes_over_a_whole_file():
    """``.*?`` with ``re.S`` takes the square of the length of a text that never ends what it looks for."""
    for path in MODULES:
        found = re.search(r"re\.(S|DOTALL)\b", path.read_text(encoding="utf-8"))
        assert not found or path.name == "svg.py", f"{dotted(path)}: look for the begin and the end by str.find"


OBJECTS = {
    "no_memory", "direct", "drive", "move", "social_forces.move", "surface",  # functions
    "owner", "tab", "self._driver", "term", "leaves[0]", "axes[0, 0]",  # objects that are held in several places
    "before.environment", "edited", "threading.main_thread()",
}  # fmt: skip
"""Expressions, one of which is on a side of each ``is``, as are types and names of constants."""


def is_an_object(node: ast.expr) -> bool:
    """Whether an expression is None, a type, a constant by name, or one of ``OBJECTS``: no bool, number or text."""
    if isinstance(node, ast.Constant):
        return node.value is None or node.value is ...
    text = ast.unparse(node)
    last = text.rpartition(".")[2]
    named = re.fullmatch(r"[A-Z]\w*", last) or last in ("int", "float", "bool", "str", "tuple", "list", "dict", "empty")
    return bool(named) or text.startswith("type(") or text in OBJECTS


def compared_by_identity(tree: ast.AST) -> list[str]:
    """The identity tests of values that may be equal and not the same."""
    found = []
    for node in ast.walk(tree):
        if not isinstance(node, ast.Compare):
            continue
        for operator, one, other in zip(node.ops, [node.left, *node.comparators], node.comparators, strict=False):
            if isinstance(operator, ast.Is | ast.IsNot) and not (is_an_object(one) or is_an_object(other)):
                found.append(f"line {node.lineno}: {ast.unparse(node)}")
    return found


def test_values_are_compared_by_equality():
    """A bool of numpy is neither ``is True`` nor ``is False``, and an equal number or text need not be the same."""
    for text in ("row.clear is is_clear", "x is True", "x is not False", "x is 1", "a.b is c.d", "x is not y"):
        assert compared_by_identity(ast.parse(text)), text
    for text in ("x is None", "x is not ...", "type(x) is int", "kind is Literal", "x is UNSET", "part is typing.Any"):
        assert not compared_by_identity(ast.parse(text)), text
    for path in [*MODULES, *(ROOT / "docs").glob("*.py"), *(ROOT / "benchmarks").rglob("*.py")]:
        found = compared_by_identity(ast.parse(path.read_text(encoding="utf-8")))
        assert not found, f"{path.relative_to(ROOT)}: {found}; compare with ==, or by the truth of a bool"


def test_repository_names_no_registry_host_and_no_machine():
    # In pieces, so that this file does not contain what it looks for.
    hosts = ["py" + r"pi\.org", "python" + r"hosted\.org", "npm" + r"js\.(org|com)", "deb" + r"ian\.org"]
    hosts.append("anaconda" + r"\.org")
    folders = ["wo" + "rk", "fa" + "rm", "ro" + "ot", "ho" + r"me/\w+", "Us" + r"ers/\w+", "tmp/" + r"\w+"]
    pattern = re.compile("|".join([*hosts, rf"(?<![\w.~/:-])/(?:{'|'.join(folders)})(?=[/\"'\s)]|$)"]), re.M)
    assert pattern.search("see https://files.python" + "hosted.org/x") and pattern.search('open("/ho' + 'me/ann/x")')
    found = []
    for path in repository_files():
        data = path.read_bytes()
        if b"\0" in data:
            continue
        text = data.decode("utf-8")
        for match in pattern.finditer(text):
            found.append(f"{path.relative_to(ROOT)}:{text.count(chr(10), 0, match.start()) + 1}: {match.group()}")
    assert not found, "\n".join(found)


def test_constraints_pin_every_dependency_and_name_no_place():
    text = (ROOT / "constraints.txt").read_text(encoding="utf-8")
    assert not re.search(r"https?://|file:|--index|--find-links|@", text)
    pinned = {re.sub(r"[-_.]+", "-", name).lower() for name in re.findall(r"^([\w.-]+)==", text, re.M)}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    wanted = project["dependencies"] + [
        item for name in ("test", "dev", "learning", "notebooks") for item in extras[name]
    ]
    names = {re.sub(r"[-_.]+", "-", re.match(r"[\w.-]+", item).group()).lower() for item in wanted}
    assert names <= pinned, f"not in constraints.txt: {sorted(names - pinned)}"


def test_the_lowest_versions_are_those_that_ci_tests():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    bounds = dict(re.fullmatch(r"([\w.-]+)>=([\w.]+)", item).groups() for item in project["dependencies"])
    text = (ROOT / "constraints-lowest.txt").read_text(encoding="utf-8")
    tested = dict(re.findall(r"^([\w.-]+)==([\w.]+)$", text, re.M))
    assert {"numpy", "matplotlib", "pillow", "pydantic", "scipy"} <= tested.keys() <= bounds.keys()
    for name, version in tested.items():
        assert version == bounds[name] or version == f"{bounds[name]}.0", name


def test_readme_and_ci_run_the_same_test_command():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = "\n".join(re.findall(r"```(?:bash|console|sh)\n(.*?)```", readme, re.S))
    commands = [line.split("#")[0].strip() for line in blocks.splitlines()]
    install, test = next(line for line in commands if "&& pytest" in line).split(" && ")
    ci = [line.strip() for line in (ROOT / ".ci" / "run").read_text(encoding="utf-8").splitlines()]
    assert ci.index(install) + 1 == ci.index(test)
    assert "pip install . -c constraints.txt && sean run" in commands
    assert len(readme.splitlines()) <= 150


def test_readme_names_options_that_exist():
    """Of ``sean run`` or of the command in the same line."""
    from sean_jax.cli import command_line
    from sean_jax.config import COMMANDS, flags

    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    known: dict[str, set[str]] = {}
    for words, model in COMMANDS.items():
        word = words.split()[0]
        options = flags.flags_of(model, word in command_line.CONFIGURABLE, word in command_line.READERS)
        known.setdefault(word, set()).update(option.name.replace("_", "-") for option in options)
        known[word].update(f"help-{topic.word}" for topic in flags.topics(model))
    for line in readme.splitlines():
        named = set(re.findall(r"(?<![\w-])--([a-z][a-z-]*)", line)) - {"help"}
        words = {"run", *re.findall(r"\bsean ([a-z-]+)", line)} & set(known)
        if "benchmarks/" not in line:
            assert named <= set().union(*(known[word] for word in words)), line


def test_data_files_of_the_package():
    assert (PACKAGE / "py.typed").is_file()


def test_one_version_is_everywhere(monkeypatch):
    """In the change log and the citations; a checkout says its own, also where another version is installed."""
    import sean_jax
    from sean_jax.io.versions import versions

    version = sean_jax.__version__
    log, citation, readme = (
        (ROOT / name).read_text(encoding="utf-8") for name in ("CHANGELOG.md", "CITATION.cff", "README.md")
    )
    released = re.search(rf"^## \[{re.escape(version)}\] - (\d{{4}})-(\d\d-\d\d)$", log, re.M)
    assert released and len(log.split("\n## [")[2].splitlines()) <= 120
    year, day = released.groups()
    assert f"\nversion: {version}\ndate-released: {year}-{day}\n" in citation
    assert f"version = {{{version}}}, year = {{{year}}}" in readme
    monkeypatch.setattr("importlib.metadata.version", lambda name: "0.0.1")
    assert versions()["sean-jax"] == version and versions()["jax"] == "0.0.1"


def test_the_citation_and_readme_name_the_same_paper():
    (paper,) = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))["references"]
    entry = (ROOT / "README.md").read_text(encoding="utf-8").partition("@article{")[2].partition("```")[0]
    for key in ("doi", "year", "journal", "volume", "start"):
        assert f"{{{paper[key]}" in entry, key
    names = re.findall(r"(?:author\s+= \{|and )(\w+),", entry.replace("{\\'a}", "á"))
    assert names == [author["family-names"] for author in paper["authors"]]


def test_no_test_imports_a_test_or_a_benchmark():
    """What several tests use lies in tests/support."""
    banned = {path.stem for path in (ROOT / "benchmarks").glob("*.py")} | {"benchmarks", "tests"}
    for path in (ROOT / "tests").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [each.name for each in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            tops = {name.split(".")[0] for name in names}
            assert not tops & banned and not any(top.startswith("test_") for top in tops), f"{path.name}: {tops}"


def test_a_test_file_has_the_name_of_what_it_tests():
    """tests/metrics/test_proximity.py tests sean_jax/metrics/proximity.py; a further word says the aspect."""
    for path in (ROOT / "tests").rglob("test_*.py"):
        folder = path.parent.relative_to(ROOT / "tests")
        if folder.name == "repository":  # its own files: .ci, pyproject.toml, the built wheel
            continue
        places = (PACKAGE / folder, ROOT / folder, path.parent)
        tested = next(place for place in places if place.is_dir())
        names = {folder.name, *(entry.stem for entry in tested.iterdir() if not entry.name.startswith("test_"))}
        about = path.stem.removeprefix("test_")
        assert any(about == name or about.startswith(f"{name}_") for name in names), path


MOST_NODES = 700  # of syntax in a function: one idea
MANY_NODES, COMMENTS = 400, 3  # above so many nodes a function has so many lines of comment
IN_EACH_ADAPTER = {"SocialNavigation", "VecSocialNavigation"}  # the other project's kind of environment


def without_annotations(tree: ast.Module) -> ast.Module:
    """The tree without annotations and docstrings, which are no burden to a reader."""
    for node in ast.walk(tree):
        for field in ("annotation", "returns"):
            if getattr(node, field, None) is not None:
                setattr(node, field, None)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and ast.get_docstring(node) is not None:
            del node.body[0]
    return tree


def heavy_functions(text: str) -> list[str]:
    """Functions of a module that are more than one idea, or say too little about why."""
    lines, heavy = text.splitlines(), []
    for node in ast.walk(without_annotations(ast.parse(text))):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        nodes = sum(1 for _ in ast.walk(node))
        comments = sum(line.lstrip().startswith("#") for line in lines[node.lineno - 1 : node.end_lineno])
        if nodes > MOST_NODES:
            heavy.append(
                f"{node.name} has {nodes} nodes of syntax, and {MOST_NODES} are the most; give its steps names"
            )
        elif nodes > MANY_NODES and comments < COMMENTS:
            heavy.append(f"{node.name} has {nodes} nodes of syntax and {comments} comments; say why above its blocks")
    return heavy


def test_a_function_is_one_idea():
    statement, comments = "    x = 1 + 2 * 3\n", "    # why\n" * COMMENTS
    assert heavy_functions("def f():\n" + 60 * statement)
    assert not heavy_functions("def f():\n" + comments + 60 * statement)
    assert heavy_functions("def f():\n" + comments + 90 * statement)
    for path in MODULES:
        heavy = heavy_functions(path.read_text(encoding="utf-8"))
        assert not heavy, f"{path.relative_to(ROOT)}: {heavy}"


def test_a_name_of_a_class_occurs_once():
    """So that grep finds the right one."""
    places: dict[str, list[str]] = {}
    for path in MODULES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name, []).append(str(path.relative_to(ROOT)))
    several = {name: paths for name, paths in places.items() if len(paths) > 1}
    assert several.keys() == IN_EACH_ADAPTER, several
