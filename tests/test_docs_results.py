"""Tables of docs/results/experiments.md are those of the files in results/."""

import importlib.util
import json
import re
from pathlib import Path

DOCS = Path(__file__).resolve().parent.parent / "docs"


def test_tables_are_those_of_the_results():
    spec = importlib.util.spec_from_file_location("docs_experiments", DOCS / "experiments.py")
    assert spec is not None and spec.loader is not None
    tables = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tables)
    text = tables.PAGE.read_text(encoding="utf-8")
    folders = {folder for _, folder in re.findall(r"<!-- (\w+) ([\w-]+) -->", text)}
    assert folders and tables.fill(text) == text, "run python docs/experiments.py"
    origins = (tables.RESULTS / "README.md").read_text(encoding="utf-8")
    for folder in folders:
        assert json.loads((tables.RESULTS / folder / "experiment.json").read_text(encoding="utf-8"))["versions"]
        assert re.search(rf"\| `{folder}` \| `(sean experiment|python benchmarks/\w+\.py) ", origins), folder
