"""Who drives, by a name, the folder of a training, a file of one's own, or as a value."""

from pathlib import Path
from typing import Any

from sean_jax import components, files
from sean_jax.base import Policy, PolicyLike, Scenario, as_policy
from sean_jax.classifiers import SITUATION_SETS
from sean_jax.config import METHODS, Component, Named, ReinforcementConfig, RunConfig, ScenarioConfig, validate
from sean_jax.episodes import check_policy
from sean_jax.errors import InputError
from sean_jax.learning import agents
from sean_jax.learning.agents import AGENTS
from sean_jax.learning.manifests import CONFIG, read_method
from sean_jax.policies import POLICIES


def policy(given: PolicyLike | Component | str, scenario: Scenario, option: str = "policy") -> Policy:
    """The policy that something stands for.

    Args:
        given: a policy, a function, a name of ``POLICIES`` or ``AGENTS``, the folder of a training or a packed agent,
            FILE.py:NAME, or a description of these.

    Raises:
        InputError: there is none of that name, or it does not fit to the scenario.
        PartError: a policy of the user's own fails, as ``episodes.check_policy`` finds.
    """
    description = _described(given)
    if isinstance(description, Named) and description.kind not in POLICIES:
        return load(_found(description.kind, option), scenario)
    part = components.resolve(description, POLICIES, option)
    try:
        policy = as_policy(part)
    except TypeError as error:
        raise InputError(str(error)) from error
    if not isinstance(description, Named):
        check_policy(scenario, policy)
    return policy


def load(folder: Path | str, scenario: Scenario) -> Policy:
    """The best policy that a training has found so far, a packed agent, or one that comes with the package.

    Args:
        folder: that ``sean train`` has written, or is writing, or that ``sean export agent`` has; as text also a name
            of ``AGENTS``, unless an agent's folder of that name is here, too.

    Raises:
        InputError: the folder has no trained network, or one that does not fit to the scenario.
        IncompleteError: the checkpoint cannot be read.
    """
    from sean_jax.learning import driving

    if isinstance(folder, str) and folder in AGENTS:
        folder = _found(folder, "folder")
    folder = Path(folder)
    if agents.is_packed(folder):
        return driving.policy(*agents.load(folder, scenario), name=folder.name)
    from sean_jax.learning import learned, trained  # which need the extra "learning"

    if read_method(folder) in ("imitation", "dagger"):
        return learned.load(folder, scenario)
    return driving.policy(*trained.load(folder, scenario), name=folder.name)


def check(given: PolicyLike | Component | str, config: ScenarioConfig, option: str = "policy") -> None:
    """Refuse what ``policy`` would refuse, as far as it can be told before a scenario is made.

    Args:
        given: as of ``policy``.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    description = _described(given)
    if not isinstance(description, Named):
        part = components.resolve(description, {}, option)
        if not (isinstance(part, Policy) or callable(part)):
            raise InputError(f"{option}: {description.kind} must be a Policy or a function (scenario, state, key).")
    elif description.kind not in POLICIES:
        from sean_jax.learning.network import read_network

        folder = _found(description.kind, option)
        method = read_method(folder)
        if issubclass(METHODS[method], ReinforcementConfig):
            agents.terms(agents.read_options(folder))
        if method != "imitation":
            return
        sets = [part.kind for part in config.situations if isinstance(part, Named)]
        if len(sets) == len(config.situations) == 1 and sets[0] in SITUATION_SETS:
            read_network(folder, list(SITUATION_SETS[sets[0]]))


def _described(given: Any) -> Component:
    return given if isinstance(given, Component) else validate(RunConfig, {"policy": given}).policy


def _found(name: str, option: str) -> Path:
    """The folder of an agent of the package, or of one's own; a name that may mean both is refused."""
    own = Path(name)
    if name in AGENTS:
        if (own / CONFIG).is_file():
            both = f"'{name}' is an agent of the package and a folder here"
            raise InputError(f"{option}: {both}; write ./{name} for the folder, {AGENTS[name]} for the other.")
        return AGENTS[name]
    if not own.is_dir():
        known = [*POLICIES, *AGENTS]
        cure = files.suggest(name, known) or ", nor is it a folder that `sean train` has written."
        raise InputError(f"{option}: '{name}' is not one of {', '.join(known)}{cure}")
    return own
