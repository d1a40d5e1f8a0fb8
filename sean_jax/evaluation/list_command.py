"""``sean list``: the names that options take, read from the dicts of the families."""

import inspect
import re
import textwrap
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from sean_jax import classifiers, mdp, metrics, policies, robots, social_forces, tasks
from sean_jax.config import PRESETS
from sean_jax.io import files
from sean_jax.learning.policy import AGENTS, describe_agent
from sean_jax.people import behaviors, pedestrian_models
from sean_jax.world import environment, navigation

TEXTS = files.read_yaml(Path(__file__).with_suffix(".yaml"))[1]


def print_choices() -> None:
    """Print every option of ``sean run`` and ``sean train`` that takes a name, with each name and one line on it."""
    console = Console()
    for option, names in choices():
        console.print(Text(f"--{option.replace('_', '-')}", "bold"))
        width = max(len(name) for name in names)
        for name, line in names.items():
            _print(console, f"  {name:<{width}}  ", line)
    console.print(Text.assemble(("metrics", "bold"), " that are measured"))
    _print(console, "  ", ", ".join(metrics.METRICS))


def _print(console: Console, name: str, text: str) -> None:
    """A name and its line, wrapped to the width of a terminal, not wrapped in a file."""
    if not console.is_terminal:
        console.print(Text(name + text), soft_wrap=True)
        return

    # Behind the name if there is room, else below it.
    indent = len(name)
    width = console.width - indent
    if width >= 30:
        first, *more = textwrap.wrap(text, width)
    else:
        first = ""
        indent = 4
        more = textwrap.wrap(text, max(20, console.width - indent))
    lines = [first, *(" " * indent + line for line in more)]
    paragraph = Text.assemble((name, "bold cyan"), "\n".join(lines))
    console.print(paragraph, soft_wrap=True)


def choices() -> Iterator[tuple[str, dict[str, str]]]:
    """Each option and its {name: line}."""
    # What a scenario is made of.
    yield "preset", _each(PRESETS, lambda preset: preset.summary)
    yield "environment", {name: _environment(environment.find(name)) for name in environment.available()}
    yield "behavior", _lines(behaviors.BEHAVIORS)
    yield "routing", _lines(behaviors.graph_behavior.ROUTINGS)
    yield "task", _lines(tasks.TASKS)
    yield "goal_sampling", _lines(navigation.PLACES)
    yield "robot", _each(robots.ROBOTS, _robot)

    # What moves and measures.
    yield "policy", _lines(policies.POLICIES) | TEXTS["policy"] | _each(AGENTS, describe_agent)
    yield "model", _lines(pedestrian_models.MODELS)
    yield "forces", _each(social_forces.PRESETS, _forces)
    yield "situations", {name: _situations(name) for name in classifiers.SITUATION_SETS}

    # What agents learn with.
    yield "observations", _each(mdp.OBSERVATIONS, lambda term: _sentence(term.definition))
    yield "rewards", _each(mdp.REWARDS, lambda term: _sentence(term.definition))
    yield "terminations", _lines(mdp.TERMINATIONS)
    yield "randomization", _each(mdp.RANDOMIZATIONS, _randomization)
    yield "dynamics", {name: TEXTS["dynamics"].get(name, "") for name in robots.DYNAMICS}


def _lines(family: Mapping[str, Any]) -> dict[str, str]:
    """Name -> first sentence of the docstring of a function, or of the first function among a value's fields."""

    def line(value: Any) -> str:
        functions = [value] if callable(value) else filter(callable, vars(value).values())
        texts = filter(None, map(inspect.getdoc, functions))
        first_text = next(texts, "")
        paragraph = first_text.split("\n\n")[0]
        return _sentence(paragraph)

    return _each(family, line)


def _each(family: Mapping[str, Any], line: Callable[[Any], str]) -> dict[str, str]:
    return {name: line(value) for name, value in family.items()}


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
    _, begin, rest = files.read_text(path).partition("<!--")
    comment, end, _ = rest.partition("-->")
    return _sentence(comment.strip()) if begin and end else ""


def _situations(name: str) -> str:
    return f"{TEXTS['situations'][name]}: {', '.join(classifiers.SITUATION_SETS[name])}."


def _randomization(randomization: Any) -> str:
    return f"Bounds of {', '.join(key for key, _, _ in randomization.bounds)}."


def _forces(forces: Any) -> str:
    walking = forces.walking
    repulsion = forces.repulsion
    speed = float(walking.speed_mean)
    spread = float(walking.speed_deviation)
    law = repulsion.law.__name__.capitalize()
    reach = float(repulsion.range)
    strength = f"{float(repulsion.strength):.3g} m/s² that falls by e in {reach:.3g} m"
    return f"{law} repulsion of {strength} acts between people, who walk at {speed:.2f} ± {spread:.2f} m/s."
