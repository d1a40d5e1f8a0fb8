"""Words of the package: names in docstrings exist, and the sentence of an error stands in one place."""

import ast
import builtins
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml

from support.checkout import ROOT

pytestmark = pytest.mark.form
PACKAGE = ROOT / "sean_jax"
FILES = sorted(PACKAGE.rglob("*.py"))
DEFINITION = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
FUNCTION = ast.FunctionDef | ast.AsyncFunctionDef


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def short(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()


# ------------------------------------------------------------------ names in docstrings

NAME = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*(\(\))?")

ELSEWHERE = {
    "FlattenObservationWrapper", "jax.lax.switch", "jax.random.PRNGKey", "make_vec", "obstacles_layer",
    "randomization_fn", "shard_map", "EpisodeWrapper", "min_range", "Mixed", "__pycache__", "kuri_0",
    "metric__situation", "COLLECTION", "COLLECTION_SET", "COLLECTION_SITUATION",
}  # fmt: skip
"""Names of other projects and of data, which no code of the package has."""

ENDINGS = {
    "csv",
    "db",
    "db3",
    "gif",
    "html",
    "js",
    "json",
    "jsonl",
    "mcap",
    "md",
    "npz",
    "onnx",
    "parquet",
    "pgm",
    "py",
}
ENDINGS |= {"sqlite", "ts", "xml", "yaml"}


def docstrings(tree: ast.Module) -> Iterator[tuple[ast.AST, int, str]]:
    """The owner, line and text of each docstring, also of a module's values and of a class's fields."""
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if not isinstance(body, list):
            continue
        for statement in body:
            if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
                if isinstance(statement.value.value, str):
                    yield node, statement.lineno, statement.value.value


def words_of_data(value: object) -> set[str]:
    """Keys and words of YAML."""
    if isinstance(value, dict):
        return {str(key) for key in value}.union(*map(words_of_data, value.values()))
    if isinstance(value, list):
        return set().union(*map(words_of_data, value))
    return {str(value)}


def identifiers(tree: ast.Module) -> set[str]:
    """All names that the code of a module has: what it defines, uses and imports, and texts that are one word."""
    described = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    names: set[str] = set()
    for node in ast.walk(tree):
        for field in ("id", "attr", "arg", "name", "asname", "module"):
            value = getattr(node, field, None)
            if isinstance(value, str):
                names.update(value.split("."))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in described:
            names.update(re.findall(r"[A-Za-z_]\w*", node.value) if len(node.value) < 200 else ())
    return names


@cache
def known_names() -> set[str]:
    """Names of the package's code and data, of Python and of numpy."""
    names = {*dir(builtins), *dir(np), *ELSEWHERE}
    for path in FILES:
        names |= identifiers(tree_of(path)) | set(path.relative_to(ROOT).with_suffix("").parts)
    for path in PACKAGE.rglob("*.yaml"):
        names |= words_of_data(yaml.safe_load(path.read_text(encoding="utf-8")))
    return names


@cache
def modules() -> dict[str, Path]:
    """Dotted name of a module, with and without its folders -> its file; names that are not unique are left out."""
    found: dict[str, set[Path]] = {}
    for path in FILES:
        parts = list(path.relative_to(ROOT).with_suffix("").parts)
        if parts[-1] == "__init__":
            parts.pop()
        for start in range(len(parts)):
            found.setdefault(".".join(parts[start:]), set()).add(path)
    return {name: next(iter(paths)) for name, paths in found.items() if len(paths) == 1}


@cache
def members(path: Path) -> set[str]:
    """What a module defines, imports or has as a module in its folder."""
    names = set()
    for node in ast.walk(tree_of(path)):
        if isinstance(node, DEFINITION):
            names.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            names |= {(alias.asname or alias.name).split(".")[0] for alias in node.names}
    if path.name == "__init__.py":
        names |= {entry.stem for entry in path.parent.iterdir()}
        stub = path.with_suffix(".pyi")
        names |= set(re.findall(r"\w+", stub.read_text(encoding="utf-8"))) if stub.is_file() else set()
    return names


@cache
def classes() -> dict[str, set[str]]:
    """Class of the package, by a name that is unique -> its fields and methods; those with bases are left out."""
    found: dict[str, list[ast.ClassDef]] = {}
    for path in FILES:
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.ClassDef):
                found.setdefault(node.name, []).append(node)
    return {
        name: {
            *(inner.name for inner in ast.walk(nodes[0]) if isinstance(inner, DEFINITION)),
            *(inner.id for inner in ast.walk(nodes[0]) if isinstance(inner, ast.Name)),
            *(inner.attr for inner in ast.walk(nodes[0]) if isinstance(inner, ast.Attribute)),
        }
        for name, nodes in found.items()
        if len(nodes) == 1 and all(ast.unparse(base) == "NamedTuple" for base in nodes[0].bases)
    }


def is_stale(name: str, parameters: set[str]) -> bool:
    """Whether a name of a docstring is neither in the code, nor in the module or the class that it says.

    A word that is a parameter in the same file, such as scenario, is not the module of this name.
    """
    name = name.removesuffix("()")
    head, _, last = name.rpartition(".")
    if name in ELSEWHERE or (head and last in ENDINGS):
        return False
    if head in modules() and head not in parameters:
        if last not in members(modules()[head]) and f"{head}.{last}" not in modules():
            return True
    if head in classes() and last not in classes()[head]:
        return True
    return not set(name.split(".")) <= known_names()


def stale_names(tree: ast.Module) -> list[str]:
    """LINE: NAME of each name in backticks that does not exist."""
    parameters = {node.arg for node in ast.walk(tree) if isinstance(node, ast.arg)}
    found = []
    for _, line, text in docstrings(tree):
        for match in re.finditer(r"(?<!`)(`{1,2})([^`\n]+)\1(?!`)", text):
            if NAME.fullmatch(match[2]) and is_stale(match[2], parameters):
                found.append(f"{line}: {match[2]}")
    return found


def wrong_arguments(tree: ast.Module) -> list[str]:
    """LINE: NAME of each entry of an Args section that is no parameter of its function, or of its class's."""
    found = []
    for owner, line, text in docstrings(tree):
        section = re.search(r"^( *)Args:\n((?:\1 +.*\n|\n)*)", f"{text}\n", re.M)
        if section is None or not isinstance(owner, DEFINITION):
            continue
        taken = {node.arg for node in ast.walk(owner) if isinstance(node, ast.arg)}
        taken |= {node.id for node in ast.walk(owner) if isinstance(node, ast.Name)}
        indent = len(section[1]) + 4
        for row in section[2].splitlines():
            entry = re.match(rf" {{{indent}}}([*\w][\w, *]*):", row)
            for name in re.findall(r"\w+", entry[1]) if entry else ():
                if name not in taken:
                    found.append(f"{line}: {name}")
    return found


def test_stale_names_are_found():
    names = ["no_such_function", "geometry.no_such_function", "Traits.no_such_field", "core.no_such_module.of"]
    text = "\n".join(f'def f(x):\n    """Of ``{name}``."""' for name in names)
    assert stale_names(ast.parse(text)) == [f"{2 * k + 2}: {name}" for k, name in enumerate(names)]
    text = '"""Of ``geometry.length``, ``length()``, ``Traits.width``, ``x = 1`` and ``np.zeros``."""'
    assert stale_names(ast.parse(text)) == []
    text = 'def f(x):\n    """Of x.\n\n    Args:\n        x: m.\n        y: m.\n\n    Raises:\n        Z: no.\n    """'
    assert wrong_arguments(ast.parse(text)) == ["2: y"]


def test_names_in_docstrings_exist():
    """Parameters, functions, classes and modules; expressions, names of files and of numpy are not looked at."""
    stale = []
    for path in FILES:
        for place in stale_names(tree_of(path)) + wrong_arguments(tree_of(path)):
            stale.append(f"{short(path)}:{place}")
    assert not stale, "\n".join(stale)


# ------------------------------------------------------------------ sentences of errors


def literal_words(node: ast.expr) -> int:
    """Words that stand in a text, of the alternatives the most; 0 if it is no text."""
    if isinstance(node, ast.IfExp):
        return max(literal_words(node.body), literal_words(node.orelse))
    if isinstance(node, ast.BinOp):
        return literal_words(node.left) + literal_words(node.right)
    parts = node.values if isinstance(node, ast.JoinedStr) else [node]
    texts = [part.value for part in parts if isinstance(part, ast.Constant) and isinstance(part.value, str)]
    return len(re.findall(r"[a-z]{2,}", " ".join(texts)))


def sentence_parts(function: ast.AST) -> set[str]:
    """Variables of a function that hold two words of text or more."""
    names = set()
    for node in ast.walk(function):
        targets: list[ast.expr] = []
        if isinstance(node, ast.Assign):
            targets = node.targets
        elif isinstance(node, ast.AnnAssign | ast.AugAssign | ast.NamedExpr):
            targets = [node.target]
        for target in targets:
            value: ast.expr | None = node.value
            pairs = [(target, value)]
            if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
                pairs = list(zip(target.elts, value.elts, strict=False))
            names |= {
                name.id
                for name, content in pairs
                if isinstance(name, ast.Name) and content is not None and literal_words(content) >= 2
            }
    return names


def glued_errors(tree: ast.Module) -> list[str]:
    """LINE: NAMES of each error whose sentence is put together from variables that hold other parts of it."""
    found = []
    for function in ast.walk(tree):
        if not isinstance(function, FUNCTION):
            continue
        parts = sentence_parts(function)
        for node in ast.walk(function):
            if not (isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call)):
                continue
            texts = [text for text in ast.walk(node.exc) if isinstance(text, ast.JoinedStr | ast.BinOp)]
            names = {name.id for text in texts for name in ast.walk(text) if isinstance(name, ast.Name)} & parts
            if names:
                found.append(f"{node.lineno}: {', '.join(sorted(names))}")
    return sorted(set(found))


def test_glued_errors_are_found():
    glued = """
def f(x):
    what = f"{x} is no number"
    cure = "give one" if x else "leave it out"
    if x:
        raise ValueError(f"{what}; {cure}.")
    raise ValueError(what + "; give one.")
"""
    assert glued_errors(ast.parse(glued)) == ["6: cure, what", "7: what"]
    whole = """
def f(x):
    text = f"{x} is no number; give one."
    unit = "m"
    if x:
        raise ValueError(text)
    raise ValueError(f"{x} {unit} is too long; give less.")
"""
    assert glued_errors(ast.parse(whole)) == []


def test_a_sentence_of_an_error_stands_in_one_place():
    """So that grep finds it: values may be variables, and parts of the sentence may not."""
    glued = []
    for path in FILES:
        for place in glued_errors(tree_of(path)):
            glued.append(f"{short(path)}:{place}; write the sentence whole")
    assert not glued, "\n".join(glued)
