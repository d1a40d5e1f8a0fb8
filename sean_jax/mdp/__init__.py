"""A scenario as a Markov decision process: observations, actions and rewards of the agent."""

import lazy_loader

from sean_jax.config import OBSERVED
from sean_jax.mdp.env import TERMINATIONS, Env, EnvState, Pool, make_env
from sean_jax.mdp.observations import OBSERVATIONS, ObservationTerm, as_term, delayed, flatten, stacked
from sean_jax.mdp.randomization import (
    PARAMETERS,
    RANDOMIZATIONS,
    ParameterRandomization,
    Randomization,
    as_randomization,
)
from sean_jax.mdp.rewards import REWARDS, RewardTerm, in_situations, of_metric
from sean_jax.mdp.spaces import Box, action_space, to_action, to_command

__all__ = [
    "OBSERVATIONS", "OBSERVED", "PARAMETERS", "RANDOMIZATIONS", "REWARDS", "TERMINATIONS", "Box", "Env", "EnvState",
    "ObservationTerm", "ParameterRandomization", "Pool", "Randomization", "RewardTerm", "action_space",
    "as_randomization", "as_term", "delayed", "flatten", "in_situations", "make_env", "of_metric", "stacked",
    "to_action", "to_command",
]  # fmt: skip

# Public as a whole; it imports this package, and is imported at first use.
__getattr__, _, _ = lazy_loader.attach(__name__, ["registry"])
