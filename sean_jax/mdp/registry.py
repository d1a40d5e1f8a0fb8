"""Environments of reinforcement learning by name, as in MuJoCo Playground: ``registry.load(name, config_overrides=)``.

A name such as Warehouse-Graph-JoinGroup-v0 has an environment, a pedestrian behavior and a robot task. ``Mixed``
means the tasks of the paper's protocol in turn (section V-B).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from sean_jax import mdp, social_forces, tasks
from sean_jax.config import (
    USUAL_TASKS,
    Bounds,
    Component,
    EnvConfig,
    Named,
    ReinforcementConfig,
    gather,
    user_parts,
    validate,
)  # fmt: skip
from sean_jax.core.data_types import Scenario
from sean_jax.core.errors import InputError
from sean_jax.core.messages import listed
from sean_jax.io import files
from sean_jax.mdp import observations, rewards
from sean_jax.mdp.env import as_termination
from sean_jax.mdp.randomization import as_randomization
from sean_jax.people import pedestrian_models
from sean_jax.simulation import making, scenario_plan
from sean_jax.simulation.scenario_plan import ScenarioPlan
from sean_jax.simulation.scenario_stack import Stack
from sean_jax.social_forces.presets import is_file

PLACES = ("warehouse", "lab", "outdoor")
TASKS = {
    "graph": ("mixed", "join_group", "leave_group", "random_ab_nav"),
    "random": ("random_ab_nav",),
    "handcrafted": ("handcrafted",),
}
"""behavior -> the tasks of names; mixed means the default tasks in turn."""


def _word(name: str) -> str:
    return "".join(part.capitalize() for part in name.split("_"))


_OPTIONS: dict[str, dict[str, Any]] = {
    f"{_word(place)}-{_word(behavior)}-{_word(task)}-v0": {
        "environment": place,
        "behavior": behavior,
        "task": ",".join(USUAL_TASKS[behavior]) if task == "mixed" else task,
    }
    for place in PLACES
    for behavior, names in TASKS.items()
    for task in names
}

ALL_ENVS = tuple(_OPTIONS)
"""The names."""


def get_default_config(name: str) -> EnvConfig:
    """The options of an environment, one of ``ALL_ENVS``; ``config.replace(people=20)`` changes them.

    Raises:
        InputError: there is no such name.
    """
    if name not in _OPTIONS:
        hint = files.suggest(name, ALL_ENVS) or f"; there are {', '.join(ALL_ENVS)}."
        raise InputError(f"env: '{name}' is no environment{hint}")
    return validate(EnvConfig, gather(EnvConfig, _OPTIONS[name]))


def load(name: str, config: EnvConfig | None = None, config_overrides: Mapping[str, Any] | None = None) -> mdp.Env:
    """An environment by its name, one of ``ALL_ENVS``, without a pool of starts.

    Args:
        config: options besides the options of the name.
        config_overrides: option -> value, such as ``{"people": 20, "rewards.progress": 2.0}``.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    config = get_default_config(name) if config is None else config
    overrides = dict(config_overrides or {})
    weights = {key: overrides.pop(key) for key in list(overrides) if key.startswith("rewards.")}
    for key in overrides:
        if key not in EnvConfig.model_fields:
            cure = files.suggest(key, EnvConfig.model_fields) or "."
            raise InputError(f"config_overrides: '{key}' is no field{cure}")
    options = {key: getattr(config, key) for key in EnvConfig.model_fields} | overrides
    plan = plan_env(validate(EnvConfig, options, typed=True))
    making.check_single(plan.scenario)
    if weights:
        changed = rewards.as_terms({key.removeprefix("rewards."): weight for key, weight in weights.items()})
        plan = plan._replace(rewards=plan.rewards | dict(changed))
    return build(plan).member


class EnvPlan(NamedTuple):
    """A description of environments, with its names resolved."""

    scenario: ScenarioPlan
    observations: dict[str, Any]
    rewards: dict[str, Any]
    terminations: list[Any]
    randomization: Any
    action_delay: tuple[int, int]


def plan_env(config: EnvConfig) -> EnvPlan:
    """The plan of a description; refuses options as ``scenario_plan.plan_scenario``.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    scenario = scenario_plan.plan_scenario(config)
    terminations = [user_parts.name_or_part(part, "terminations") for part in config.terminations]
    for termination in terminations:
        as_termination(termination)
    terms = observations.with_delays(observation_terms(config.observations), config.observation_delays)
    return EnvPlan(
        scenario=scenario,
        observations=dict(terms),
        rewards=dict(rewards.weighted(_rewards(config), config.reward_weights)),
        terminations=terminations,
        randomization=as_randomization(_randomization(config.randomization)),
        action_delay=config.action_delay,
    )


def plan_envs(options: ReinforcementConfig) -> list[EnvPlan]:
    """The plans of the environments of a training, each with each of its laws of people's motion.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    configs: list[EnvConfig] = list(options.per_environment)
    if options.laws is not None:
        plain = [config.replace(laws=None) for config in configs]
        configs = [with_law(config, law) for config in plain for law in listed(options.laws)]
    return [plan_env(config) for config in configs]


def build(plan: EnvPlan | EnvConfig, limit: int | None = None) -> Stack[mdp.Env]:
    """The environments of a plan on each floor, without pools of starts, for one program.

    One of several tasks is drawn for each episode.

    Args:
        limit: maximum number of floors; the first ones.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    plan = plan if isinstance(plan, EnvPlan) else plan_env(plan)
    floors = making.build_members(plan.scenario, limit)
    if len(plan.scenario.robots) > 1:  # a start or goal of the user's needs room for the widest
        radii = floors.over_members(lambda scenario: scenario.robot.radius)()
        making.with_tasks(plan.scenario, floors.at(int(radii.argmax())))
    scenario = _mixed(making.with_tasks(plan.scenario, floors.member))
    env = mdp.make_env(
        scenario,
        plan.observations,
        plan.rewards,
        terminations=plan.terminations,
        randomization=plan.randomization,
        action_delay=plan.action_delay,
    )
    return replace(floors, member=env)  # pyright: ignore[reportReturnType]  # the scenario's leaves come first in an environment


def _mixed(scenarios: Sequence[Scenario]) -> Scenario:
    """One scenario, with one of several tasks in each episode."""
    if len(scenarios) == 1:
        return scenarios[0]
    mixed = tasks.Mixture(tuple(each.task for each in scenarios))
    return replace(scenarios[0], task=mixed, task_name=",".join(each.task_name for each in scenarios))


def _randomization(part: Component | None) -> Any:
    """Bounds, or the name or file of some, or the user's own; None for none."""
    return part if part is None or isinstance(part, Bounds) else user_parts.name_or_part(part, "randomization")


def with_law(config: EnvConfig, law: str) -> EnvConfig:
    """The options with a law of people's motion: a model, a preset of social forces, or a file of constants.

    Raises:
        InputError: there is no such law.
    """
    if law in pedestrian_models.MODELS:
        return config.replace(model=Named(kind=law))
    if law not in social_forces.PRESETS and not is_file(law):
        raise InputError(files.unknown_name("laws", law, (*social_forces.PRESETS, *pedestrian_models.MODELS)))
    return config.replace(model=Named(kind="social_forces"), forces=Named(kind=law))


def observation_terms(parts: Sequence[Component], option: str = "observations") -> observations.Terms:
    """The terms of an observation: names in ``OBSERVATIONS``, or the user's own parts.

    Raises:
        InputError: there is no such name.
    """
    terms = {part.label: user_parts.resolve(part, observations.OBSERVATIONS, option) for part in parts}
    return observations.as_terms(terms) if terms else ()


def _rewards(config: EnvConfig) -> dict[str, Any]:
    terms: dict[str, Any] = {}
    for part in config.reward_parts:
        if isinstance(part, Named) and part.kind == "default":
            terms |= rewards.DEFAULT
            continue
        term = user_parts.resolve(part, {"default": None, **rewards.REWARDS}, "rewards")
        terms |= term if isinstance(term, dict) else {part.label: term}
    return terms
