"""``sean list``: the names that options take, read from the dicts of the families."""

import inspect
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from sean_jax import files
from sean_jax.config import PRESETS

DYNAMICS = {
    "mjx": "Rigid bodies move in MuJoCo's MJX, on wheels with tyres.",
    "twin": "The same law moves it in closed form: faster, and easier to differentiate.",
    "kinematic": "It has the speeds of its command at once, within its limits, as in SEAN 2.0.",
}

STACKS = {
    "social_costmap": "ROS's navigation stack with people and their space on its maps, as in the paper's text.",
    "move_base": "ROS's navigation stack with nobody on its maps, by SEAN 2.0's public files.",
}
SETS = {
    "paper": "Conditions and thresholds as printed",
    "sean2": "Conditions and thresholds of SEAN 2.0's code",
    "more": "Those of the paper, and further ones",
}


def print_choices() -> None:
    """Print every option of ``sean run`` and ``sean train`` that takes a name, with each name and one line on it."""
    console = Console()
    for option, names in choices():
        console.print(Text(f"--{option.replace('_', '-')}", "bold"))
        width = max(len(name) for name in names)
        for name, line in names.items():
            _print(console, f"  {name:<{width}}  ", line)
    console.print(Text.assemble(("metrics", "bold"), " that are measured"))
    _print(console, "  ", ", ".join(metric_names()))


def _print(console: Console, name: str, text: str) -> None:
    """A name and its line, wrapped to the width of a terminal, not wrapped in a file."""
    if not console.is_terminal:
        console.print(Text(name + text), soft_wrap=True)
        return
    room = console.width - len(name)
    behind = room >= 30
    lines = textwrap.wrap(text, room if behind else max(20, console.width - 4))
    indent = " " * (len(name) if behind else 4)
    first, rest = (lines[0], lines[1:]) if behind else ("", lines)
    console.print(Text.assemble((name, "bold cyan"), first, *(f"\n{indent}{line}" for line in rest)), soft_wrap=True)


def choices() -> Iterator[tuple[str, dict[str, str]]]:
    """Each option and its {name: line}."""
    from sean_jax import (
        behaviors,
        classifiers,
        environment,
        mdp,
        navigation,
        pedestrian_models,
        policies,
        robots,
        social_forces,
        tasks,
    )
    from sean_jax.learning.policy import AGENTS, describe_agent

    yield "preset", {name: preset.summary for name, preset in PRESETS.items()}
    yield "environment", {name: _environment(environment.find(name)) for name in environment.available()}
    yield "behavior", {name: _documented(value) for name, value in behaviors.BEHAVIORS.items()}
    yield "routing", {name: _documented(value) for name, value in behaviors.graph_behavior.ROUTINGS.items()}
    yield "task", {name: _documented(value) for name, value in tasks.TASKS.items()}
    yield "goal_sampling", {name: _documented(value) for name, value in navigation.PLACES.items()}
    yield "robot", {name: _robot(path) for name, path in robots.ROBOTS.items()}
    known = {name: _documented(value) for name, value in policies.POLICIES.items()} | STACKS
    yield "policy", known | {name: describe_agent(folder) for name, folder in AGENTS.items()}
    yield "model", {name: _documented(value) for name, value in pedestrian_models.MODELS.items()}
    yield "forces", {name: _forces(value) for name, value in social_forces.PRESETS.items()}
    yield "situations", {name: f"{SETS[name]}: {', '.join(each)}." for name, each in classifiers.SITUATION_SETS.items()}
    yield "observations", {name: _sentence(term.definition) for name, term in mdp.OBSERVATIONS.items()}
    yield "rewards", {name: _sentence(term.definition) for name, term in mdp.REWARDS.items()}
    yield "terminations", {name: _documented(value) for name, value in mdp.TERMINATIONS.items()}
    yield "randomization", {name: _documented(type(value)) for name, value in mdp.RANDOMIZATIONS.items()}
    yield "dynamics", {name: DYNAMICS.get(name, "") for name in robots.DYNAMICS}


def metric_names() -> list[str]:
    """The names of the metrics."""
    from sean_jax import metrics

    return list(metrics.METRICS)


def _documented(value: Any) -> str:
    """First sentence of the docstring of a function, or of the first function among a value's fields."""
    functions = [value] if callable(value) else [field for field in vars(value).values() if callable(field)]
    text = next((inspect.getdoc(function) for function in functions if inspect.getdoc(function)), None) or ""
    return _sentence(text.split("\n\n")[0])


def _sentence(text: str) -> str:
    """The first sentence, on one line."""
    words = " ".join(text.replace("``", "").split())
    return words[: end.start() + 1] if (end := re.search(r"\.(?= [A-Z]|$)", words)) else words + "."


def _environment(folder: Path) -> str:
    content = files.read_yaml(folder / "environment.yaml")[1]
    x0, y0, x1, y1 = content["floor"]
    return f"The floor has {x1 - x0:.6g} x {y1 - y0:.6g} m and, unless told otherwise, {content['people']} people."


def _robot(path: Path) -> str:
    """The first sentence of the first comment in a robot's MJCF file."""
    comment = re.search(r"<!--\s*(.*?)-->", files.read_text(path), re.DOTALL)
    return _sentence(comment.group(1)) if comment else ""


def _forces(forces: Any) -> str:
    speed, spread = float(forces.walking.speed_mean), float(forces.walking.speed_deviation)
    law, reach = forces.repulsion.law.__name__.capitalize(), float(forces.repulsion.range)
    strength = f"{float(forces.repulsion.strength):.3g} m/s² that falls by e in {reach:.3g} m"
    return f"{law} repulsion of {strength} acts between people, who walk at {speed:.2f} ± {spread:.2f} m/s."
