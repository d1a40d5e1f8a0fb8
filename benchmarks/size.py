"""Size of the package, and number of words to avoid: python benchmarks/size.py [PATH ...]."""

import ast
import io
import re
import sys
import tokenize
from pathlib import Path
from statistics import median

PACKAGE = Path(__file__).resolve().parent.parent / "sean_jax"
LAYOUT = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
LONG = 60  # lines of code of a function
WORDS = ("who", "told", "found", "seen", "held", "kept", "asked", "made", "given", "wanted", "said", "judge")


def lines_of_code(text: str, tree: ast.AST) -> tuple[set[int], set[int]]:
    """The numbers of the lines of code, and of the lines of docstrings."""
    docs: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            docs |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    code: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in LAYOUT:
            code |= set(range(token.start[0], token.end[0] + 1))
    return code - docs, docs


def size(files: list[Path]) -> dict[str, float]:
    """Counts over files: lines, code, docstrings, comments and blank lines, functions, long functions."""
    count = dict.fromkeys(("files", "lines", "code", "docstrings", "functions", f"above {LONG}"), 0)
    lengths = []
    for file in files:
        text = file.read_text(encoding="utf-8")
        tree = ast.parse(text)
        code, docs = lines_of_code(text, tree)
        lengths.append(text.count("\n"))
        count["files"] += 1
        count["lines"] += lengths[-1]
        count["code"] += len(code)
        count["docstrings"] += len(docs)
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                count["functions"] += 1
                inside = range(node.lineno, (node.end_lineno or node.lineno) + 1)
                count[f"above {LONG}"] += len(code.intersection(inside)) > LONG
    return {**count, "median": median(lengths) if lengths else 0}


def words(files: list[Path]) -> dict[str, tuple[int, int]]:
    """How often each of ``WORDS`` stands in the texts of the files, and in their identifiers."""
    counts = {word: [0, 0] for word in WORDS}
    for file in files:
        text = file.read_text(encoding="utf-8")
        names = [
            token.string
            for token in tokenize.generate_tokens(io.StringIO(text).readline)
            if token.type == tokenize.NAME
        ]
        for word, count in counts.items():
            pattern = re.compile(rf"(?<![A-Za-z]){word}(?![A-Za-z])")
            identifiers = sum(pattern.search(name) is not None for name in names)
            count[0] += len(pattern.findall(text)) - identifiers
            count[1] += identifiers
    return {word: (count[0], count[1]) for word, count in counts.items()}


def main() -> None:
    """Print a row for each folder, and the words of all."""
    paths = [Path(word) for word in sys.argv[1:]]
    roots = paths or [PACKAGE, *sorted(path for path in PACKAGE.iterdir() if any(path.glob("*.py")))]
    every: list[Path] = []
    for root in roots:
        files = sorted(root.rglob("*.py")) if root.is_dir() else [root]
        every += files
        row = " ".join(f"{name} {value:>6,.0f}" for name, value in size(files).items())
        print(f"{root.name or str(root):24} {row}")
    print("words (text + identifiers):", ", ".join(f"{w} {t}+{n}" for w, (t, n) in words(sorted(set(every))).items()))


if __name__ == "__main__":
    main()
