"""Tables of docs/results/ are those of the files in results/."""

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
    texts = [page.read_text(encoding="utf-8") for page in tables.PAGES]
    assert [tables.fill(text) for text in texts] == texts, "run python docs/experiments.py"
    folders = {folder for text in texts for _, folder in re.findall(r"<!-- (\w+) ([\w-]+) -->", text)}
    origins = (tables.RESULTS / "README.md").read_text(encoding="utf-8")
    assert folders
    for folder in folders:
        results = [json.loads(file.read_text(encoding="utf-8")) for file in (tables.RESULTS / folder).glob("*.json")]
        assert any(result.get("versions") for result in results), folder
        command = r"`(sean (experiment|benchmark)|python benchmarks/\w+\.py) "
        assert re.search(rf"\| `{folder}` \| {command}", origins), folder
