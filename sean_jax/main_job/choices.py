"""What there is to choose from: ``sean list``, read from the dicts that hold the choices."""

import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.console import Console

DYNAMICS = {
    "mjx": "rigid bodies in MuJoCo's MJX, on wheels with tyres",
    "twin": "the same law in closed form: faster, and easier to differentiate",
}


def print_choices() -> None:
    """Every option of ``sean run`` that takes a name, each of its names and one line on it."""
    console = Console()
    for option, choices in offered():
        console.print(f"[bold]--{option}[/]", highlight=False, soft_wrap=True)
        width = max(len(name) for name in choices)
        for name, line in choices.items():
            console.print(f"  [bold cyan]{name:<{width}}[/]  {line}", highlight=False, soft_wrap=True)
    console.print("[bold]metrics[/] that are measured", highlight=False, soft_wrap=True)
    console.print("  " + ", ".join(measured()), highlight=False, soft_wrap=True)


def offered() -> Iterator[tuple[str, dict[str, str]]]:
    """Option and {name: line} for each."""
    from sean_jax import behaviors, classifiers, environment, pedestrian_models, policies, robots, social_forces, tasks

    yield "environment", {name: _environment(environment.find(name)) for name in environment.available()}
    yield "behavior", {name: _documented(value) for name, value in behaviors.BEHAVIORS.items()}
    yield "paths", {name: _documented(value) for name, value in behaviors.graph_behavior.PATHS.items()}
    yield "task", {name: _documented(value) for name, value in tasks.TASKS.items()}
    yield "robot", {name: _robot(path) for name, path in robots.ROBOTS.items()}
    yield "policy", {name: _documented(value) for name, value in policies.POLICIES.items()}
    yield "model", {name: _documented(value) for name, value in pedestrian_models.MODELS.items()}
    yield "forces", {name: _forces(value) for name, value in social_forces.PRESETS.items()}
    yield "situations", {name: ", ".join(held) for name, held in classifiers.SITUATION_SETS.items()}
    yield "dynamics", {name: DYNAMICS.get(name, "") for name in robots.DYNAMICS}


def measured() -> list[str]:
    """The names of the metrics."""
    from sean_jax import metrics

    return list(metrics.METRICS)


def _documented(value: Any) -> str:
    """First line of a function's docstring, or of that of the first function that a value holds."""
    functions = [value] if callable(value) else [held for held in vars(value).values() if callable(held)]
    text = next((inspect.getdoc(function) for function in functions if inspect.getdoc(function)), None) or ""
    return text.split("\n")[0].rstrip(".")


def _environment(folder: Path) -> str:
    import yaml

    content = yaml.safe_load((folder / "environment.yaml").read_text(encoding="utf-8"))
    x0, y0, x1, y1 = content["floor"]
    return f"{x1 - x0:g} x {y1 - y0:g} m, {content['people']} people"


def _robot(path: Path) -> str:
    """The first words of the first comment in a robot's MJCF file."""
    found = re.search(r"<!--\s*(.*?)[.:]\s", path.read_text(encoding="utf-8"), re.DOTALL)
    return " ".join(found.group(1).split()) if found else ""


def _forces(parameters: Any) -> str:
    speed, spread = float(parameters.speed_mean), float(parameters.speed_deviation)
    return f"{parameters.repulsion.__name__} repulsion, people walk at {speed:.2f} ± {spread:.2f} m/s"
