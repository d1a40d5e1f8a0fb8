"""First mistakes of who writes a part of their own: each is refused in one sentence, before anything is compiled."""

import re
import textwrap
from pathlib import Path

import pytest

import sean_jax
from sean_jax import mdp
from sean_jax.cli import command_line
from sean_jax.config import OwnPart, user_parts
from sean_jax.core.errors import PartError
from sean_jax.learning.policy import load_policy

HEAD = "import math\nimport jax\nimport jax.numpy as jnp\nimport numpy as np\nimport sean_jax\n"
LINE = HEAD.count("\n")  # lines before a part
SMALL = "--environment lab --people 4 --dynamics twin --time-limit 2 --quiet".split()


@pytest.fixture(scope="module")
def small():
    return sean_jax.make("lab", people=4, dynamics="twin", task="random_ab_nav", metrics=(), time_limit=2.0)


def write(folder: Path, text: str) -> str:
    """A file with a part; its name as an option has it."""
    (folder / "mine.py").write_text(HEAD + textwrap.dedent(text))
    return "mine.py:part"


# What a policy's author writes, the line of the mistake, and words of the sentence.
DRIVE = "def part(scenario, state, key):\n"
POLICIES = {
    "scalar": (DRIVE + "    return 0.5 * state.robot.speed", 1, r"gives float32 \(\), not float \(2,\); .*jnp.stack"),
    "number": (DRIVE + "    return 0.5", 1, r"gives float 0.5, not float \(2,\)"),
    "three": (DRIVE + "    return jnp.zeros(3)", 1, r"gives float32 \(3,\), not float \(2,\)"),
    "row": (DRIVE + "    return jnp.zeros((1, 2))", 1, r"gives float32 \(1, 2\), not float \(2,\)"),
    "none": (DRIVE + "    command = jnp.zeros(2)", 1, "gives None, .* a return is missing"),
    "list": (DRIVE + "    return [state.robot.speed, 0.0]", 1, "gives a list of 2, .*jnp.stack"),
    "tuple": (DRIVE + "    return 0.4, state.robot.turn_rate", 1, "gives a tuple of 2, .*jnp.stack"),
    "dict": (DRIVE + "    return {'v': 0.4, 'w': 0.0}", 1, "gives a dict of 2, "),
    "whole numbers": (DRIVE + "    return jnp.array([1, 0])", 1, r"gives int32 \(2,\), not float \(2,\)"),
    "truth": (DRIVE + "    return state.robot.position > 0.0", 1, r"gives bool \(2,\), not float \(2,\)"),
    "text": (DRIVE + "    return 'ahead'", 1, "gives str 'ahead', not float"),
    "two arguments": (
        "def part(scenario, state):\n    return jnp.zeros(2)",
        1,
        r"takes \(scenario, state\), and is called",
    ),
    "four arguments": ("def part(scenario, state, key, extra):\n    return jnp.zeros(2)", 1, "takes .* is called with"),
    "if": (
        DRIVE + "    if state.robot.speed > 0.1:\n        return jnp.zeros(2)\n    return jnp.ones(2)",
        2,
        "jnp.where",
    ),
    "and": (DRIVE + "    near = state.completed and state.timed_out\n    return jnp.zeros(2)", 2, "jnp.where"),
    "while": (DRIVE + "    while state.tick < 3:\n        pass\n    return jnp.zeros(2)", 2, "jnp.where"),
    "numpy": (
        DRIVE + "    v = np.linalg.norm(state.robot.position)\n    return jnp.stack([v, v])",
        2,
        r"write jnp\. for np",
    ),
    "math": (DRIVE + "    v = math.sin(state.robot.speed)\n    return jnp.stack([v, v])", 2, r"write jnp\. for math"),
    "float": (
        DRIVE + "    v = float(state.robot.speed)\n    return jnp.array([v, v])",
        2,
        r"float\(\) takes no traced",
    ),
    "item": (DRIVE + "    v = state.robot.speed.item()\n    return jnp.array([v, v])", 2, r"takes no traced value"),
    "attribute": (DRIVE + "    return state.robt.position", 2, "State has no 'robt'; did you mean 'robot'"),
    "no such thing": (DRIVE + "    return scenario.speed", 2, "Scenario has no 'speed'; "),
    "module": (DRIVE + "    return jnp.stak([0.4, 0.0])", 2, "jax.numpy has no 'stak'; did you mean 'stack'"),
    "name": (DRIVE + "    return jp.zeros(2)", 2, "'jp' is not defined"),
    "in place": (DRIVE + "    v = jnp.zeros(2)\n    v[0] = 0.4\n    return v", 3, r"x\.at\[index\]\.set"),
    "changed state": (DRIVE + "    state.robot.speed = 0.4\n    return jnp.zeros(2)", 2, r"replace\(field=\.\.\.\)"),
    "mask": (DRIVE + "    p = state.pedestrians\n    return p.position[p.present].mean(0)", 3, "jnp.where"),
    "list index": (DRIVE + "    return jnp.zeros(2) + [0.1, 0.2][state.tick]", 2, r"jnp.asarray\(values\)"),
    "shapes": (DRIVE + "    return state.robot.position + state.pedestrians.position.T", 2, r"x\.shape"),
    "range": (
        DRIVE + "    for _ in range(state.tick):\n        pass\n    return jnp.zeros(2)",
        2,
        "takes no traced value",
    ),
    "unpack": (DRIVE + "    x, y = state\n    return jnp.stack([x, y])", 2, "State"),
    "division": (DRIVE + "    return jnp.zeros(2) * (1 / 0)", 2, "ZeroDivisionError: division by zero"),
    "swapped": (
        DRIVE + "    seen = sean_jax.observe(state, scenario)\n    return seen.goal",
        2,
        "State has no 'robot|Scenario",
    ),
    "helper": (
        "def help(x):\n    return np.sin(x)\n" + DRIVE + "    return help(state.robot.position)",
        2,
        r"jnp\. for np",
    ),
    "class": ("class part:\n    def __init__(self, gain=1.0):\n        pass", 2, "takes .* is called with"),
    "jitted": ("@jax.jit\n" + DRIVE + "    return jnp.zeros(3)", 1, r"gives float32 \(3,\)"),
    "generator": (DRIVE + "    yield jnp.zeros(2)", 1, "gives a generator"),
}
BEGIN = "def begin(scenario, params, state):\n    return jnp.zeros(())\n"
REMEMBERING = {
    "no memory": ("def go(scenario, params, state, key):\n    return jnp.zeros(2)", 3, r"not \(command, memory\)"),
    "grown": (
        "def go(scenario, params, state, key):\n    return jnp.zeros(2), jnp.zeros(3)",
        3,
        r"float32 \(3,\), not float",
    ),
    "other type": (
        "def go(scenario, params, state, key):\n    return jnp.zeros(2), state.tick",
        3,
        "int32 .*, not float32",
    ),
    "other structure": (
        "def go(scenario, params, state, key):\n    return jnp.zeros(2), ()",
        3,
        "a tuple of 0, not float32",
    ),
    "plain arguments": (
        "def go(scenario, state, key):\n    return jnp.zeros(2), ()",
        3,
        "is called with .scenario, params",
    ),
}
REMEMBERING = {
    name: (f"{BEGIN}{text}\npart = sean_jax.Policy(params=(), name='mine', init=begin, apply=go)", line, words)
    for name, (text, line, words) in REMEMBERING.items()
}


@pytest.mark.parametrize("mistake", [*POLICIES, *REMEMBERING])
def test_a_mistake_in_a_policy_is_one_sentence(mistake, small, tmp_path, monkeypatch):
    text, line, words = (POLICIES | REMEMBERING)[mistake]
    monkeypatch.chdir(tmp_path)
    kind = write(tmp_path, text)
    with pytest.raises(PartError) as refused:
        load_policy(kind, small, typed=True)
    check_sentence(str(refused.value), "policy", line, words)


def check_sentence(text: str, part: str, line: int, words: str) -> None:
    assert text.startswith(f"{part}: mine.py:{LINE + line}: "), text
    assert re.search(words, text) and text.endswith(".") and "\n" not in text and len(text) < 400, text
    assert "sean_jax/" not in text and "site-packages" not in text, text


TASK = "def part(scenario, pedestrians, groups, memory, key):\n"
FORCE = "from flax import struct\n@struct.dataclass\nclass part:\n    size: float = 1.0\n    def pair(self, pair):\n"
SENSOR = "\npart = sean_jax.Sensor(params=(), name='mine', read=read)"
STAND = """
def part(place, people):
    return sean_jax.Behavior(data=(), name='mine', reset=reset, direct=direct)
def direct(scenario, state, key):
    return state
def reset(scenario, key):
"""
PARTS = {  # option of make, text, line and words
    "metric: text": ("metrics", "def part(snapshot):\n    return 'near'", 1, "gives str 'near'"),
    "metric: if": ("metrics", "def part(before, after):\n    return 1.0 if after.tick > 3 else 0.0", 2, "jnp.where"),
    "metric: numpy": ("metrics", "def part(snapshot):\n    return np.linalg.norm(snapshot.position) < 1", 2, "jnp"),
    "situation: number": ("situations", "def part(at):\n    return at.tick", 1, r"gives int32 \(\), not bool"),
    "situation: all": ("situations", "def part(at):\n    return at.people.present", 1, r" \(4,\), not bool"),
    "situation: none": ("situations", "def part(snapshot, thresholds):\n    snapshot.tick > 3", 1, "return is missing"),
    "force: one part": ("forces", FORCE + "        return pair.dx", 5, r"gives .*, not \(fx, fy\)"),
    "force: if": ("forces", FORCE + "        return (1.0, 0.0) if pair.dx > 0 else (0.0, 0.0)", 6, "jnp.where"),
    "force: none": ("forces", FORCE + "        pair.dx * self.size", 5, "gives None"),
    "task: none": ("task", TASK + "    places = scenario.navigation.places", 1, "gives None, not a RobotTask"),
    "task: arguments": ("task", "def part(scenario, key):\n    return None", 1, "takes .* is called with"),
    "task: shape": ("task", TASK + "    p = scenario.navigation.places\n"
        "    task = sean_jax.tasks.build_task(scenario, p[0], p[1])\n"
        "    return task.replace(start=p)", 1, r"start = float32 \(1024, 2\)"),
    "model: none": ("model", "def part(scenario, state):\n    state.pedestrians", 1, "gives people whose None"),
    "model: shape": ("model", "def part(scenario, state):\n    p = state.pedestrians\n"
        "    return p.replace(velocity=p.velocity[:, 0])", 1, r"velocity float32 \(4,\), not float32 \(4, 2\)"),
    "behavior: none": ("behavior", STAND + "    pass", 6, "gives None"),
    "behavior: two": ("behavior", STAND + "    return jnp.zeros((4, 2)), ()", 6, "a tuple of 2, not .pedestrians"),
    "sensor: none": ("sensors", "def read(scenario, params, state, key):\n    state.robot" + SENSOR, 1, "gives None"),
    "sensor: arguments": ("sensors", "def read(scenario, state):\n    return state.tick" + SENSOR, 1, "is called with"),
    "sensor: numpy": ("sensors", "def read(scenario, params, state, key):\n"
        "    return np.sin(state.robot.speed)" + SENSOR, 2, "jnp"),
}  # fmt: skip
USUAL = {"metrics": ["path_length"], "situations": ["paper"], "forces": ["helbing1995"]}


@pytest.mark.parametrize("mistake", PARTS)
def test_a_mistake_in_a_part_of_a_scenario_is_one_sentence(mistake, tmp_path, monkeypatch):
    option, text, line, words = PARTS[mistake]
    monkeypatch.chdir(tmp_path)
    kind = write(tmp_path, text)
    if option == "forces":
        (tmp_path / "mine.py").write_text((tmp_path / "mine.py").read_text() + "\npart = part()\n")
    several = option in ("metrics", "situations", "forces", "sensors")
    options = {"task": "random_ab_nav", "metrics": (), option: [*USUAL.get(option, []), kind] if several else kind}
    with pytest.raises(PartError) as refused:
        sean_jax.make("lab", people=4, dynamics="twin", **options)
    check_sentence(str(refused.value), option, line, words)


STEP = "def part(scenario, before, after):\n"
OF_ENV = {
    "reward: vector": ("rewards", STEP + "    return after.robot.position", 1, r"float32 \(2,\), not .* \(\)"),
    "reward: if": ("rewards", STEP + "    return 1.0 if after.completed else 0.0", 2, "jnp.where"),
    "reward: arguments": ("rewards", "def part(state):\n    return 0.0", 1, "is called with .scenario, before, after"),
    "observation: none": ("observations", "def part(scenario, state):\n    state.robot", 1, "gives None"),
    "observation: numpy": ("observations", "def part(scenario, state):\n    return np.sin(state.tick)", 2, "jnp"),
    "observation: list": ("observations", "def part(scenario, state):\n    return [state.tick]", 1, "a list of 1"),
    "termination: number": ("terminations", STEP + "    return after.tick", 1, r"int32 \(\), not bool \(\)"),
    "termination: if": ("terminations", STEP + "    return after.tick > 3 and after.completed", 2, "jnp.where"),
    "randomization: none": ("randomization", "def part(key, scenario):\n    pass", 1, "gives .*None"),
    "randomization: if": ("randomization", "def part(key, scenario):\n    if jax.random.bernoulli(key):\n"
        "        return scenario\n    return scenario", 2, "jnp.where"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", OF_ENV)
def test_a_mistake_in_a_part_of_an_environment_is_one_sentence(mistake, small, tmp_path, monkeypatch):
    option, text, line, words = OF_ENV[mistake]
    monkeypatch.chdir(tmp_path)
    part = user_parts.load(OwnPart(kind=write(tmp_path, text)), option)
    value = {"terminations": [part], "randomization": part}.get(option, {"mine": part})
    with pytest.raises(PartError) as refused:
        mdp.make_env(small, **{"observations": ("goal",), option: value})
    check_sentence(str(refused.value), option, line, words)


@pytest.mark.parametrize("mistake", ["scalar", "if"])
def test_the_command_line_says_it_with_code_2_and_the_rest_if_told(mistake, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text, line, words = POLICIES[mistake]
    command = ["run", *SMALL, "--policy", write(tmp_path, text), "--task", "random_ab_nav", "--out", "never"]
    assert command_line.main(command) == 2
    error = " ".join(capsys.readouterr().err.split())
    assert re.search(words, error) and f"sean: policy: mine.py:{LINE + line}: " in error and "Traceback" not in error
    assert not (tmp_path / "never").exists()
    assert command_line.main([*command, "--traceback"]) == 2
    assert "Traceback" in capsys.readouterr().err
