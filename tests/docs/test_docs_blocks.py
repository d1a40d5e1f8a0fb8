"""Every block of code in README and docs/ runs, every command in them parses, and every YAML can be read.

A page is run from top to bottom, as a reader would, with what its text takes as given. Pages with a test of their own
are run there: environments, playback, trajectories, training, extending and the tutorial.
"""

import re
import shlex

import pytest
import yaml

from sean_jax.cli import command_line
from support import quick
from support.checkout import ROOT

pytestmark = pytest.mark.form
PAGES = {path.relative_to(ROOT).as_posix(): path for path in [ROOT / "README.md", *sorted(ROOT.glob("docs/**/*.md"))]}
ELSEWHERE = {f"docs/{name}.md" for name in ("environments", "playback", "trajectories", "training", "extending")}
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.M | re.S)

SCENARIO = """
import jax, jax.numpy as jnp, numpy as np, sean_jax
from flax import struct
from sean_jax.policies import go_to_goal as policy
"""
RUNNING = "key = jax.random.key(0); state = jax.jit(sean_jax.reset)(scenario, key)\n"
GIVEN = {
    "docs/inverse_graph.md": RUNNING
    + """
graph, time_step = scenario.behavior.data.graph, scenario.time_step
last, frames = jax.jit(lambda key: sean_jax.rollout(scenario, policy, key, 600))(key)
position, present = np.asarray(frames.people), np.ones(frames.people.shape[:2], bool)
""",
    "docs/learning.md": RUNNING
    + """
from support import learning_data
from sean_jax import learning
from sean_jax.config import ImitationConfig
learning_data.write("runs/graph")
learning.train(ImitationConfig(method="imitation", dataset="runs/graph", epochs=1, batch=16, out="runs/learned"))
scenario = learning_data.setting()[0]["join_group"]
joystick = lambda: (0.1, 0.2)
controller = lambda state: (0.1, 0.2)
""",
    "docs/sensors.md": RUNNING
    + """
import re
from pathlib import Path
page = Path(sean_jax.__file__).parent.parent / "docs" / "sensors.md"
rear = re.search(r"```yaml\\n(.*?)```", page.read_text(), re.S)[1].replace("mount: rear", "mount: depth")
Path("rear.yaml").write_text(rear)
""",
    "docs/robots.md": """
from pathlib import Path
Path("envs").symlink_to(Path(sean_jax.__file__).parent.parent / "envs")
""",
}
ALONE = {"docs/gradients.md", "docs/situations.md", "docs/validation.md"}
"""Pages whose blocks run as pasted, with nothing given; more pages may join them, and none leaves"""
LAB = '"lab", people=4, behavior="random"'
SMALLER = {
    "README.md": {
        '"warehouse", behavior="graph", task="join_group", robot="kuri", people=62': LAB, "256": "2",
        "steps=600": "steps=20", "episodes=64": "episodes=2",
    },
    "docs/behavior_graph.md": {
        '"warehouse"': '"lab"', "people=16": "people=4", "key, 100,": "key, 20,", "steps=1200": "steps=200",
    },
    "docs/coming_from.md": {
        '"lab", people=4': LAB, "env.reset": "jax.jit(env.reset)", "env.step": "jax.jit(env.step)",
    },
    "docs/devices.md": {'"warehouse"': LAB, "1024": "4", "8192": "2"},
    "docs/gradients.md": {"1000": "32", '"warehouse", behavior="graph"': LAB},
    "docs/index.md": {"people=5": "people=4", "300": "20"},
    "docs/learning.md": {"episodes=10": "episodes=2", "key, 600": "key, 20"},
    "docs/metrics.md": {"people=8": LAB, "300": "20"},
    "docs/policies.md": {'"warehouse", task="join_group"': LAB, "600": "3", "16)": "2)"},
    "docs/several_robots.md": {"100)": "10)"},
    "docs/social_forces.md": {"sean_jax.make(": f"sean_jax.make({LAB}, "},
    "docs/validation.md": {"60, seed": "6, seed", "120.0": "4.0", "60.0": "4.0", "seconds=60": "seconds=4"},
}  # fmt: skip


def blocks(page: str, *languages: str) -> list[str]:
    return [code for language, code in BLOCK.findall(PAGES[page].read_text(encoding="utf-8")) if language in languages]


PROGRAMS = [page for page in PAGES if blocks(page, "python") and page not in ELSEWHERE]
TRAINING = "gradients", "learning", "calibration", "inverse_graph"
SIMULATION = "behavior_graph", "coming_from", "devices", "policies", "several_robots", "worlds"
LONG = {f"docs/{name}.md" for name in TRAINING + SIMULATION}
"""Pages whose programs are left to the night"""


@pytest.mark.parametrize("page", quick.slow(PROGRAMS, *(page for page in PROGRAMS if page not in LONG)))
def test_programs_run(page, scenario, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scope: dict = {"__name__": page}
    if page not in ALONE:
        scope["scenario"] = scenario
        exec(SCENARIO + GIVEN.get(page, ""), scope)  # noqa: S102
    smaller = SMALLER.get(page, {})
    text = "\n".join(blocks(page, "python"))
    for long in smaller:
        assert long in text, f"{page} has no {long} any more"
    for code in blocks(page, "python"):
        for long, short in smaller.items():
            code = code.replace(long, short)
        exec(compile(code, page, "exec"), scope)  # noqa: S102


def indented(page: str) -> list[str]:
    """Blocks that four spaces mark, below an empty line; not those of lists, which are indented text."""
    text = BLOCK.sub("", PAGES[page].read_text(encoding="utf-8"))
    return [re.sub("^    ", "", code, flags=re.M) for code in re.findall(r"(?<=\n\n)((?:    \S.*\n)+)", text)]


def commands() -> list[tuple[str, str]]:
    """(page, words) of each `sean ...` in a block of shell, of no language, or of indented lines."""
    found = []
    for page in PAGES:
        for code in blocks(page, "bash", "console", "") + indented(page):
            lines = re.sub(r"<<'END'\n.*?\nEND\n", "\n", code.replace("\\\n", " "), flags=re.S).splitlines()
            for line in lines:
                for part in line.split(" # ")[0].split("&&"):
                    words = part.replace("srun --kill-on-bad-exit=1 ", "").strip()
                    if words.startswith("sean "):
                        found.append((page, words))
    return found


def test_there_are_commands():
    assert len(commands()) > 40


@pytest.mark.parametrize(("page", "words"), commands())
def test_commands_parse(page, words, tmp_path, monkeypatch):
    """Their options are there; files that they name are not, here."""
    from sean_jax.config import COMMANDS, flags

    monkeypatch.chdir(tmp_path)
    _, word, *arguments = shlex.split(words, comments=True)
    model = COMMANDS[command_line._name([word, *arguments])]
    given = flags.parse(
        word, model, arguments, configurable=word in command_line.CONFIGURABLE, trust=word in command_line.READERS
    )
    if "config" not in given:
        flags.read(model, given)


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "yaml")])
def test_yaml_can_be_read(page):
    assert all(isinstance(yaml.safe_load(code), dict) for code in blocks(page, "yaml"))


def test_programs_are_in_fences():
    """So that they are run: what is indented is tried as commands only."""
    for page in PAGES:
        for code in indented(page):
            assert not re.search(r"^(from \w|import \w|def |\w+ = )", code, re.M), f"{page}: {code}"


def test_pages_alone_are_given_nothing():
    assert not ALONE & set(GIVEN) and set(PROGRAMS) >= ALONE


def test_every_block_is_of_a_language_that_is_tried():
    known = {"python", "bash", "console", "yaml", "xml", "bibtex", ""}  # xml: test_docs_environments.py
    for page in PAGES:
        assert {language for language, _ in BLOCK.findall(PAGES[page].read_text(encoding="utf-8"))} <= known, page
