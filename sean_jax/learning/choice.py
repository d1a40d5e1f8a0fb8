"""Who drives, by a name, the folder of a training, a file of one's own, or as a value."""

from pathlib import Path
from typing import Any

from sean_jax import components, files
from sean_jax.base import Policy, PolicyLike, Scenario, as_policy
from sean_jax.classifiers import SITUATION_SETS
from sean_jax.config import Component, Named, RunConfig, ScenarioConfig, validate
from sean_jax.errors import InputError
from sean_jax.learning.manifests import read_method
from sean_jax.policies import POLICIES


def policy(given: PolicyLike | Component | str, scenario: Scenario, option: str = "policy") -> Policy:
    """The policy that something stands for.

    Args:
        given: a policy, a function, a name, the folder of a training, FILE.py:NAME, or a description of these.
        scenario: in which it will drive.
        option: what asks for it, for messages.

    Returns:
        The policy.

    Raises:
        InputError: there is none of that name, or it does not fit to the scenario.
    """
    description = _described(given)
    if isinstance(description, Named) and description.kind not in POLICIES:
        if not Path(description.kind).is_dir():
            raise InputError(_unknown(description.kind, option))
        return load(description.kind, scenario)
    part = components.resolve(description, POLICIES, option)
    try:
        return as_policy(part)
    except TypeError as error:
        raise InputError(str(error)) from error


def load(folder: Path | str, scenario: Scenario) -> Policy:
    """The best policy that a training has found so far.

    Args:
        folder: that ``sean train`` has written, or is writing.
        scenario: where it will drive.

    Returns:
        The policy, named after the folder.

    Raises:
        InputError: the folder has no trained network, or one that does not fit to the scenario.
        IncompleteError: the checkpoint cannot be read.
    """
    from sean_jax.learning import driving, learned, reinforcement

    folder = Path(folder)
    if read_method(folder) in ("imitation", "dagger"):
        return learned.load(folder, scenario)
    return driving.policy(*reinforcement.load(folder, scenario), name=folder.name)


def check(given: PolicyLike | Component | str, config: ScenarioConfig, option: str = "policy") -> None:
    """Refuse what ``policy`` would refuse, as far as it can be told before a scenario is made.

    Args:
        given: as of ``policy``.
        config: of the scenario.
        option: what asks for it, for messages.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    description = _described(given)
    if not isinstance(description, Named):
        part = components.resolve(description, {}, option)
        if not (isinstance(part, Policy) or callable(part)):
            raise InputError(f"{option}: {description.kind} must be a Policy or a function (scenario, state, key).")
    elif description.kind not in POLICIES:
        if not Path(description.kind).is_dir():
            raise InputError(_unknown(description.kind, option))
        from sean_jax.learning.network import read_network

        if read_method(Path(description.kind)) != "imitation":
            return
        sets = [part.kind for part in config.situations if isinstance(part, Named)]
        if len(sets) == len(config.situations) == 1 and sets[0] in SITUATION_SETS:
            read_network(Path(description.kind), list(SITUATION_SETS[sets[0]]))


def _described(given: Any) -> Component:
    return given if isinstance(given, Component) else validate(RunConfig, {"policy": given}).policy


def _unknown(name: str, option: str) -> str:
    cure = files.suggest(name, POLICIES) or ", nor is it a folder that `sean train` has written."
    return f"{option}: '{name}' is not one of {', '.join(POLICIES)}{cure}"
