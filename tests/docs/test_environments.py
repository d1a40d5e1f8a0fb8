"""docs/environments.md: its example builds and runs, and its tables have every key, default and limit of the code."""

import re
from typing import Any

import numpy as np
import pydantic
import pytest

from sean_jax.graph import annotation as graph
from sean_jax.io.files import mjcf
from sean_jax.people.handcrafted import annotation as handcrafted
from sean_jax.robots import description
from sean_jax.world import environment
from support.checkout import ROOT
from support.files import write_all

pytestmark = pytest.mark.form
PAGE = (ROOT / "docs" / "environments.md").read_text(encoding="utf-8")
MODELS: dict[str, type[pydantic.BaseModel]] = {
    "`environment.yaml`": environment.Settings,
    "`graph.yaml`": graph.Annotation,
    "`nodes.NAME`": graph.Node,
    "`entrance`": graph.Entrance,
    "`edges[]`": graph.Edge,
    "`trips`": graph.Trips,
    "`handcrafted.yaml`": handcrafted.HandcraftedAnnotation,
    "`further.NAME`": handcrafted.Collection,
    "`sets.NAME`": handcrafted.Set,
    "`walkers[]`": handcrafted.LoopWalkers,
    "`groups.NAME`": handcrafted.Group,
}
BOUNDS = (
    "minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum", "minItems", "maxItems", "minLength",
    "minProperties", "maxProperties",
)  # fmt: skip


def example() -> dict[str, str]:
    """Name of a file -> its content."""
    return dict(re.findall(r"^`(my_place/[\w.]+)`\n\n```\w+\n(.*?)^```", PAGE, re.M | re.S))


def table(heading: str) -> dict[str, list[str]]:
    """The first table below a heading: key -> the other cells of its row."""
    section = re.split(r"^#+ ", PAGE.split(f"# {heading}\n")[1], flags=re.M)[0]
    rows = [line.strip("|").split("|") for line in section.splitlines() if line.startswith("|")]
    end = next((k for k, row in enumerate(rows) if k > 1 and set(row[0].strip()) <= {"-"}), len(rows) + 1) - 1
    return {row[0].strip().strip("`"): [cell.strip() for cell in row[1:]] for row in rows[2:end]}


def bounds(schema: Any, definitions: dict[str, Any]) -> set[float]:
    """The numbers that limit a value, its items or its members; keys of models of their own are left out."""
    if isinstance(schema, list):
        return set().union(*(bounds(item, definitions) for item in schema))
    if not isinstance(schema, dict) or "$ref" in schema:
        return set()
    found = {schema[name] for name in BOUNDS if name in schema}
    if schema.get("minItems") is not None and "prefixItems" in schema:
        found -= {schema["minItems"], schema.get("maxItems")}  # the length of a pair or a rectangle
    for name in ("items", "prefixItems", "anyOf", "oneOf"):
        found |= bounds(schema.get(name), definitions)
    return found


def number_in(value: float, text: str) -> bool:
    return re.search(rf"(?<![\d.,]){re.escape(f'{value:,}'.removesuffix('.0'))}(?![\d]|[.,]\d)", text) is not None


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """The folder of the example, beside which its program runs."""
    return write_all(tmp_path_factory.mktemp("docs"), example()) / "my_place"


@pytest.mark.parametrize("heading", MODELS)
def test_tables_name_every_key_with_its_default_and_limits(heading):
    model, rows = MODELS[heading], table(heading)
    assert list(rows) == list(model.model_fields)
    schema = model.model_json_schema()
    for name, field in model.model_fields.items():
        kind, default, limits, meaning = rows[name]
        if field.is_required():
            assert default == "required", name
        elif field.default not in (None, "", [], {}):
            assert default.strip("`") == str(field.default).lower().removesuffix(".0"), name
        else:
            assert default in ("empty", "none", "`medium`") or default.startswith("required of"), name
        assert meaning
        words = re.findall(r"'(\w+)'", str(field.annotation)) if "Literal" in str(field.annotation) else []
        assert all(f"`{word}`" in limits for word in words), name
        property_ = schema["properties"][name]
        if name not in ("starts", "goals"):  # their poses are explained in the text
            for bound in bounds(property_, schema.get("$defs", {})):
                assert number_in(bound, f"{limits} {kind}"), f"{heading} {name}: {bound} is not in '{limits}'"


def test_poses_of_the_robot_are_five():
    rows = table("`sets.NAME`")
    assert all(f"{handcrafted.POSES} to {handcrafted.POSES}" in rows[name][2] for name in ("starts", "goals"))


def test_factors_of_the_flows_are_those_of_the_code():
    factors = graph.Annotation.model_construct(c_min=0.2, c_max=100.0).flow_factors()
    values = {"1": 1.0, "`c_min`": 0.2, "`c_max`": 100.0}
    rows = re.findall(r"^\| `(\w+)` \| (\S+) \| (\S+) \|$", PAGE, re.M)
    found = {name: (values[there], values[back]) for name, there, back in rows if name in factors}
    assert found == factors


def test_rooms_of_groups_are_those_of_the_code():
    from sean_jax.graph.annotation import PERSON
    from sean_jax.graph.formation import reach

    sizes, rooms = (
        [float(cell) for cell in re.search(rf"^\| {re.escape(name)} \|(.*)\|$", PAGE, re.M).group(1).split("|")]
        for name in ("capacity", "free radius [m]")
    )
    np.testing.assert_allclose(rooms, [reach(int(size)) + PERSON for size in sizes], atol=0.0051)


def test_figures_of_robots_are_those_of_the_code():
    section = PAGE.split("## Robots\n")[1]
    rows = re.findall(r"^\| `(\w+)` \| ([^|]+) \| ([^|]+) \|", section, re.M)
    assert [name for name, _, _ in rows] == list(description.RANGES)
    for name, unit, limits in rows:
        least, most, expected = description.RANGES[name]
        low, high = (float(value.replace(",", "")) for value in limits.split(" to "))
        assert (low, high, unit.strip()) == (least, most, expected or "1"), name
    for name in description.NUMERICS:
        assert re.search(rf"^\| `{name}` \|[^|]*\|[^|]*\| required \|", section, re.M), name
    for name in description.OPTIONAL:
        assert re.search(rf"^\| `{name}` \|[^|]*\|[^|]*\| `max_\w+` \|", section, re.M), name


def test_what_mjcf_files_may_not_have_is_that_of_the_code():
    section = PAGE.split("## `scene.xml`\n")[1].split("## `graph.yaml`")[0]
    (refused,) = re.findall(r"^\| (<attach>.*|`<attach>`.*), a document type \| none allowed \|$", section, re.M)
    assert tuple(re.findall(r"<(\w+)>", refused)) == mjcf.REFUSED
    for value in (mjcf.MAX_ELEMENTS, mjcf.MAX_JOINTS, mjcf.MAX_PIXELS, mjcf.MAX_COUNTS["replicate", "count"]):
        assert f"| {value:,} |" in section
    assert f"| {mjcf.MAX_TEXT // 10**6} MB, {mjcf.MAX_ASSET // 10**6} MB |" in section
    assert f"finite, at most {mjcf.MAX_MAGNITUDE:g}" in section
    assert f"at most {environment.MAX_OBSTACLES:,} obstacles" in section
    assert f"at most {environment.MAX_BOTTOM:g} m above" in section


def test_the_example_has_each_file_and_every_file_is_read(place):
    assert {path.name for path in place.iterdir()} == {
        "environment.yaml", "scene.xml", "graph.yaml", "handcrafted.yaml", "my_robot.xml",
    }  # fmt: skip
    here = environment.load(place)
    assert environment.default_people(place) == 6 and here.name == "my_place"
    assert int((np.asarray(here.obstacles.height) > 0).sum()) == 2, "the lamp is decoration"
    sets = handcrafted.read_sets(place, here).sets
    assert list(sets) == ["cross_path_1", "join_group_1"]


@pytest.mark.night
def test_the_example_runs(place, monkeypatch):
    (program,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
    monkeypatch.chdir(place.parent)
    names: dict[str, Any] = {}
    exec(compile(program, "docs/environments.md", "exec"), names)
    trajectory = names["trajectory"]
    assert trajectory.position.shape == (20, 2) and np.isfinite(np.asarray(trajectory.position)).all()
    assert np.isfinite(np.asarray(trajectory.people)).all() and trajectory.people.shape[1] == 6
    assert names["scenario"].robot.name == "my_robot" and float(names["scenario"].robot.max_reverse_speed) < 0.6
    assert names["state"].pedestrians.position.shape == (3, 2)
