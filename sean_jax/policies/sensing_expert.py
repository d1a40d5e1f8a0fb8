"""sensing_expert: the expert's search with a robot's knowledge of people.

``expert`` knows all people, also behind walls and behind its back, and their goals. Networks that see a depth image
(section V) cannot imitate its consequences. This expert knows the people in its depth image, remembers them for a
while after, and expects everybody to walk on at constant velocity. Search and costs are the same as in ``expert``.
"""

from dataclasses import replace
from typing import NamedTuple

from flax import struct
from jaxtyping import Float

from sean_jax.core.data_types import Array, Policy, Scenario, State
from sean_jax.policies.expert import MAX_PEOPLE, STEPS, TIME_STEP, ExpertMemory, ExpertParams, expert, plan
from sean_jax.policies.known_people import KnownPeople, Sight, as_known, known_people, nobody
from sean_jax.policies.prediction import nearest_people, predict_straight


@struct.dataclass
class SensingParams(Sight):
    """Parameters of the sensing expert; all leaves are () floats."""

    expert: ExpertParams = struct.field(default_factory=ExpertParams)


class SensingMemory(NamedTuple):
    """The sensing expert's memory."""

    search: ExpertMemory
    people: KnownPeople


def init(scenario: Scenario, params: SensingParams, state: State) -> SensingMemory:
    """Plans as ``expert`` does, with a robot's knowledge: people whom its depth camera shows or has just shown."""
    return SensingMemory(expert.init(scenario, params.expert, state), nobody(state))


def apply(
    scenario: Scenario, params: SensingParams, state: State, key: Array
) -> tuple[Float[Array, "command"], SensingMemory]:
    """The command [m/s, rad/s] of the best plan among the known people, and the new memory."""
    memory: SensingMemory = state.policy_state
    people = known_people(scenario, params, state, memory.people)
    state = replace(as_known(state, people), policy_state=memory.search)
    motion = predict_straight(nearest_people(state, MAX_PEOPLE), STEPS, TIME_STEP)
    command, search = plan(scenario, params.expert, state, motion, key)
    return command, SensingMemory(search, people)


sensing_expert = Policy(params=SensingParams(), name="sensing_expert", init=init, apply=apply, sensing="tracks")
"""The sensing expert with its usual parameters; others by ``replace(sensing_expert, params=...)``."""
