"""A curriculum: starts of episodes are drawn so that the agent's worst situations occur more often.

``Env.with_pool`` takes all starts equally often. A curriculum has a pool whose weights follow the agent's own record:

- ``situations``: a situation weighs as much as the agent costs people in it, per second, and a start as much as it
  leads to such situations. Starts that seldom do so make room for new ones that do so more.
- ``regret``: a start weighs by the agent's best return from it minus its mean return. Starts with low
  regret are replaced by new starts and mutations of the best starts: the same start among people who behave a little
  differently (``mdp.RANDOMIZATIONS``).

All functions are pure and of fixed shapes. A ``Curriculum`` is a pytree of arrays with everything that the rest depends
on, and all chance comes from keys: a training that was stopped is resumed to the same curve.

Source: M. Jiang, E. Grefenstette & T. Rocktaschel, "Prioritized level replay", ICML 2021; J. Parker-Holder et al.,
"Evolving curricula with regret-based environment design", ICML 2022.
"""

import functools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Bool, Float, Int, PyTree

from sean_jax import mdp
from sean_jax.core.data_types import Array, PolicyLike, State
from sean_jax.core.errors import InputError
from sean_jax.io import files
from sean_jax.simulation.episodes import init_policy, policy_step

SOCIAL = ("personal_space", "o_space", "personal_", "intimate_", "collision_", "contact_")
"""Prefixes of rewards whose negative part is the cost that an agent causes to people."""
FEW_EPISODES = 2  # from one start, before its regret is known
PRIOR = 5.0  # s, for which a situation that has not been met counts as costly as all together
TINY = 1e-9
WHOLE = 2**30  # into which sums by start are divided


@dataclass(frozen=True)
class CurriculumPlan:
    """How a curriculum weighs starts.

    Args:
        by: "situations" or "regret".
        situations: weights of chosen situations, such as ``(("join_group", 1.0),)``; None: their cost.
        temperature: the weight of a situation is its cost to the power of 1 / temperature, of a start its rank
            by regret to the power of -1 / temperature. Low: the worst alone; high: all alike.
        floor: share of the episodes that begin anywhere in the pool.
        replaced: share of the pool that is replaced at most at a time.
        mutated: share of the replacements, by regret, that are mutations of the best.
        ahead: s, simulated from a start to see which situations occur.
        memory: decay factor of the record at each observation.
    """

    by: Literal["situations", "regret"] = "situations"
    situations: tuple[tuple[str, float], ...] | None = None
    temperature: float = 1.0
    floor: float = 0.2
    replaced: float = 0.25
    mutated: float = 0.5
    ahead: float = 10.0
    memory: float = 0.95

    def __post_init__(self) -> None:
        if self.by not in ("situations", "regret"):
            raise InputError(f"curriculum: by '{self.by}' is not one of situations, regret.")
        if isinstance(self.situations, Mapping):
            object.__setattr__(self, "situations", tuple(self.situations.items()))
        for name in ("floor", "replaced", "mutated", "memory"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InputError(f"curriculum: {name} {getattr(self, name):g} must be a share from 0 to 1.")
        for name in ("temperature", "ahead"):
            if not 0.0 < getattr(self, name) < float("inf"):
                raise InputError(f"curriculum: {name} {getattr(self, name):g} must be above 0.")
        if self.situations is None:
            return
        weights = [weight for _, weight in self.situations]
        if not (sum(weights) > 0.0 and min(weights) >= 0.0):
            raise InputError("curriculum: situations need weights of 0 or more, and one above 0.")


@struct.dataclass
class Curriculum:
    """A pool, and the record of its starts and of situations, whose sums fade by ``CurriculumPlan.memory``."""

    pool: mdp.Pool
    keys: Array  # (K,) typed PRNG keys of the starts
    occurs: Float[Array, "K S"]  # s spent in each situation, from each start
    seconds: Float[Array, "K"]  # s of it, all together
    cost: Float[Array, "S"]  # of people, in each situation
    time: Float[Array, "S"]  # s in each
    total_cost: Float[Array, ""]  # anywhere
    total_time: Float[Array, ""]
    episodes: Float[Array, "K"]  # that have ended, from each start; it does not fade
    best: Float[Array, "K"]  # highest return of those; 0 if there is none
    returns: Float[Array, "K"]  # sum of their returns, which fades
    ended: Float[Array, "K"]  # number of these
    guess: Float[Array, "K"]  # of the regret, until it is known


class StepRecord(NamedTuple):
    """T steps of B scenarios, of the episode that each step belongs to."""

    start: Int[Array, "T B"]  # ``info["start"]``
    situations: Bool[Array, "T B S"]  # ``info["situations"]``
    cost: Float[Array, "T B"]  # of ``social_cost``
    done: Bool[Array, "T B"]  # the episode ended with this step
    episode_return: Float[Array, "T B"]  # ``info["episode_return"]``


def social_cost(parts: Mapping[str, Float[Array, "*batch"]]) -> Float[Array, "*batch"]:
    """The cost (...) to people, 0 or more: the negative parts of the terms of ``info["rewards"]`` about people and
    contact.

    Raises:
        InputError: there is no such term.
    """
    costs = [jnp.maximum(-part, 0.0) for name, part in parts.items() if name.startswith(SOCIAL)]
    if not costs:
        raise InputError("curriculum: no term of the reward is about people; add one, such as personal_space.")
    first, *others = costs
    return sum(others, first)


# ------------------------------------------------------------------ in a trainer


def prepare(env: mdp.Env, name: str) -> mdp.Env:
    """An environment, without a pool, in which the plan of that name has something to vary: by regret, with
    ``mdp.RANDOMIZATIONS["behavior"]`` unless it has its own randomization.

    Raises:
        InputError: by situations, no term of the reward is about people.
    """
    if name == "situations":
        social_cost({name: jnp.zeros(()) for name, _ in env.rewards})
    if name == "regret" and env.randomization is None:
        env = replace(env, randomization=mdp.RANDOMIZATIONS["behavior"])
    return env


def follow(
    env: mdp.Env,
    plan: CurriculumPlan | None,
    curriculum: Curriculum | None,
    info: Mapping[str, PyTree],
    done: Bool[Array, "T B"],
) -> tuple[Curriculum | None, dict[str, dict[str, Array]]]:
    """The curriculum after an update of a trainer, and numbers for its log: the effective number of starts, how often
    each has been replaced, and the weights of situations or the mean regret.

    Args:
        info: (T, B, ...) of ``Env.step``: rewards, start, situations, episode_return.
    """
    if plan is None or curriculum is None:
        return None, {}
    if plan.by == "situations":
        cost = social_cost(info["rewards"])
    else:
        cost = jnp.zeros(done.shape, float)
    record = StepRecord(info["start"], info["situations"], cost, done, info["episode_return"])
    after = observe(env, plan, curriculum, record)
    return after, {"curriculum": _numbers(env, plan, after)}


def _numbers(env: mdp.Env, plan: CurriculumPlan, curriculum: Curriculum) -> dict[str, Array]:
    weights = curriculum.pool.weights.astype(jnp.float32)
    effective = weights.sum() ** 2 / (weights * weights).sum()
    replacements = curriculum.pool.states.start // len(weights)
    numbers = {"starts": effective, "replaced": replacements.astype(jnp.float32).mean()}
    if plan.by == "regret":
        return numbers | {"regret": _mean_regret(curriculum)}
    shares = situation_weights(env, plan, curriculum)
    return numbers | {name: shares[index] for index, (name, _) in enumerate(env.scenario.situations)}


# ------------------------------------------------------------------ begin, observe, refill


def init(env: mdp.Env, plan: CurriculumPlan, key: Array, size: int, policy: PolicyLike | None = None) -> Curriculum:
    """A curriculum whose starts are drawn now; jit it with ``plan`` and ``size`` static.

    Args:
        env: ``replace(env, pool=curriculum.pool)`` trains on it.
        policy: drives to find out which situations occur; None: only the record shows that. Regret needs none.

    Raises:
        InputError: a chosen situation is none of the scenario's.
    """
    names = [name for name, _ in env.scenario.situations]
    for name, _ in plan.situations or ():
        if name not in names:
            hint = files.suggest(name, names) or "."
            raise InputError(f"curriculum: situation '{name}' is not one of {', '.join(names)}{hint}")
    unknown = jnp.zeros(len(names), jnp.float32)
    zero = jnp.zeros((), jnp.float32)
    starts = _draw(env, plan, policy, jax.random.split(key, size))
    curriculum = Curriculum(**starts, cost=unknown, time=unknown, total_cost=zero, total_time=zero)
    return _weighed(env, plan, curriculum)


def observe(env: mdp.Env, plan: CurriculumPlan, curriculum: Curriculum, record: StepRecord) -> Curriculum:
    """The curriculum with the weights that follow from further steps. Episodes from starts that are no longer in the
    pool count for situations alone.
    """
    second = jnp.asarray(env.scenario.time_step, jnp.float32)
    situations = record.situations.astype(jnp.float32)  # (T, B, S)
    cost = record.cost.astype(jnp.float32)  # (T, B)
    in_situations = situations * second  # (T, B, S) s
    cost_in_situations = cost[..., None] * situations
    starts = _sum_by_start(curriculum, record, in_situations, second)

    before = jnp.where(curriculum.episodes > 0.0, curriculum.best, starts.best)
    best = jnp.maximum(before, starts.best)

    # A start's record fades only if something takes its place.
    keep = jnp.asarray(plan.memory, jnp.float32)
    faded = jnp.where(starts.steps > 0.0, keep, 1.0)
    ended = jnp.where(starts.ended > 0.0, keep, 1.0)
    after = replace(
        curriculum,
        occurs=faded[:, None] * curriculum.occurs + starts.occurs,
        seconds=faded * curriculum.seconds + starts.seconds,
        cost=keep * curriculum.cost + cost_in_situations.sum((0, 1)),
        time=keep * curriculum.time + in_situations.sum((0, 1)),
        total_cost=keep * curriculum.total_cost + cost.sum(),
        total_time=keep * curriculum.total_time + second * cost.size,
        episodes=curriculum.episodes + starts.ended,
        best=jnp.where(jnp.isfinite(best), best, 0.0),
        returns=ended * curriculum.returns + starts.returns,
        ended=ended * curriculum.ended + starts.ended,
    )
    return _weighed(env, plan, after)


class StartSums(NamedTuple):
    """Sums over a record, of each start of the pool."""

    seconds: Float[Array, "K"]
    ended: Float[Array, "K"]  # episodes
    returns: Float[Array, "K"]  # of these
    steps: Float[Array, "K"]
    occurs: Float[Array, "K S"]  # s in each situation
    best: Float[Array, "K"]  # the highest return; minus infinity if no episode ended


def _sum_by_start(
    curriculum: Curriculum, record: StepRecord, occurs: Float[Array, "T B S"], second: Float[Array, ""]
) -> StartSums:
    """The sums of a record, whose steps are ``second`` s long."""
    # A slot of the pool may have another start by now.
    size = len(curriculum.keys)
    slot = jnp.maximum(record.start, 0) % size
    start_in_slot = curriculum.pool.states.start[slot]
    known = (record.start >= 0) & (start_in_slot == record.start)
    counted = known.astype(jnp.float32)  # (T, B)
    ends = (known & record.done).astype(jnp.float32)

    returns = record.episode_return.astype(jnp.float32)
    columns = jnp.stack([counted * second, ends, ends * returns, counted], -1)
    columns = jnp.concatenate([columns, counted[..., None] * occurs], -1)  # (T, B, 4 + S)
    sums = _by_start(columns, slot, size)

    highest = jnp.where(ends > 0.0, returns, -jnp.inf)
    none = jnp.full(size, -jnp.inf, jnp.float32)
    best = none.at[slot.reshape(-1)].max(highest.reshape(-1))
    return StartSums(*sums[:, :4].T, occurs=sums[:, 4:], best=best)


def refill(
    env: mdp.Env, plan: CurriculumPlan, curriculum: Curriculum, key: Array, policy: PolicyLike | None = None
) -> Curriculum:
    """The curriculum with new starts in the places of the starts with the least weight; jit it with ``plan`` static.

    By situations, a new start replaces an old one only if it weighs more. By regret, the starts with the least known
    regret make room for mutations of the best and for new ones.

    Args:
        key: () typed PRNG key, another one each time.
        policy: as in ``init``.
    """
    number = int(plan.replaced * curriculum.keys.shape[0])
    if not number:
        return curriculum
    fresh = _new_starts(env, plan, curriculum, key, policy, number)
    if plan.by == "situations":
        exchange = _exchange_by_situations(env, plan, curriculum, fresh)
    else:
        exchange = _exchange_by_regret(curriculum, number)
    return _weighed(env, plan, _put(curriculum, fresh, exchange))


class Exchange(NamedTuple):
    """Which new starts replace which of the pool, R pairs."""

    out: Int[Array, "R"]  # slots of the pool
    order: Int[Array, "R"]  # new starts for them
    better: Bool[Array, "R"]  # whether the new one takes the place


def _new_starts(
    env: mdp.Env, plan: CurriculumPlan, curriculum: Curriculum, key: Array, policy: PolicyLike | None, number: int
) -> dict[str, Any]:
    """New starts; by regret some of them are mutations of the best."""
    new_key, choice_key, parent_key, mutation_key = jax.random.split(key, 4)
    keys = jax.random.split(new_key, number)
    if plan.by != "regret":
        return _draw(env, plan, policy, keys) | {"guess": jnp.zeros(number, jnp.float32)}

    # The regret of a new start is guessed to be the mean, that of a mutation its parent's.
    guess = jnp.full(number, _mean_regret(curriculum), jnp.float32)
    if env.randomization is None:
        return _draw(env, plan, policy, keys) | {"guess": guess}

    # Starts of great regret have more offspring.
    weights = _by_regret(plan, curriculum)
    chances = jnp.log(jnp.maximum(weights, 1e-30))
    parent = jax.random.categorical(parent_key, chances, shape=(number,))
    mutates = jax.random.uniform(choice_key, (number,), float) < plan.mutated
    keys, parameters = _offspring(env, curriculum, keys, parent, mutates, mutation_key)
    guess = jnp.where(mutates, regret(curriculum)[parent], guess)
    return _draw(env, plan, policy, keys, parameters) | {"guess": guess}


def _exchange_by_situations(
    env: mdp.Env, plan: CurriculumPlan, curriculum: Curriculum, fresh: dict[str, Any]
) -> Exchange:
    """The best new start for the worst old one, and so on, all of them weighed as one pool."""
    size = len(curriculum.keys)
    number = len(fresh["keys"])
    occurs = jnp.concatenate([curriculum.occurs, fresh["occurs"]])
    seconds = jnp.concatenate([curriculum.seconds, fresh["seconds"]])
    share = _shares(occurs, seconds)
    weights = situation_weights(env, plan, curriculum)
    values = _by_situations(share, share.sum(0), weights)

    old_values = values[:size]
    new_values = values[size:]
    out = jnp.argsort(old_values)[:number]
    order = jnp.argsort(-new_values)
    highest_first = jnp.sort(new_values)[::-1]
    return Exchange(out, order, better=highest_first > old_values[out])


def _exchange_by_regret(curriculum: Curriculum, number: int) -> Exchange:
    """Any new start for one of the least regret."""
    is_known = _is_known(curriculum)
    known_regret = jnp.where(is_known, regret(curriculum), jnp.inf)
    out = jnp.argsort(known_regret)[:number]
    order = jnp.arange(number, dtype=jnp.int32)
    return Exchange(out, order, better=is_known[out])


# ------------------------------------------------------------------ statistics of the record


def situation_weights(env: mdp.Env, plan: CurriculumPlan, curriculum: Curriculum) -> Float[Array, "S"]:
    """The target shares (S,) of situations; they add up to 1."""
    names = [name for name, _ in env.scenario.situations]
    if plan.situations is not None:
        chosen = dict(plan.situations)
        weights = jnp.asarray([chosen.get(name, 0.0) for name in names], jnp.float32)
        return weights / weights.sum()
    overall = curriculum.total_cost / jnp.maximum(curriculum.total_time, TINY)
    rate = (curriculum.cost + PRIOR * overall) / (curriculum.time + PRIOR)
    log_rate = jnp.log(jnp.maximum(rate, TINY))
    return jax.nn.softmax(log_rate / plan.temperature)


def occurrences(curriculum: Curriculum) -> Float[Array, "K S"]:
    """Shares (K, S) of the time in each situation, from each start; the shares of all starts for unknown starts."""
    return _shares(curriculum.occurs, curriculum.seconds)


def regret(curriculum: Curriculum) -> Float[Array, "K"]:
    """The regret (K,) of starts: the best return less their mean; a guess if too few episodes have ended."""
    mean = curriculum.returns / jnp.maximum(curriculum.ended, TINY)
    gap = jnp.maximum(curriculum.best - mean, 0.0)
    return jnp.where(_is_known(curriculum), gap, curriculum.guess)


def _is_known(curriculum: Curriculum) -> Bool[Array, "K"]:
    return curriculum.episodes >= FEW_EPISODES


def _mean_regret(curriculum: Curriculum) -> Array:
    known = _is_known(curriculum).astype(jnp.float32)
    return (known * regret(curriculum)).sum() / jnp.maximum(known.sum(), 1.0)


# ------------------------------------------------------------------ weights of starts


def _weighed(env: mdp.Env, plan: CurriculumPlan, curriculum: Curriculum) -> Curriculum:
    """The curriculum with updated weights in its pool."""
    if plan.by == "regret":
        weights = _by_regret(plan, curriculum)
    else:
        share = occurrences(curriculum)
        weights = _by_situations(share, share.sum(0), situation_weights(env, plan, curriculum))

    # Some episodes begin anywhere in the pool.
    total = jnp.maximum(weights.sum(), TINY)
    weights = (1.0 - plan.floor) * weights / total + plan.floor / len(weights)
    pool = replace(curriculum.pool, weights=weights.astype(float))
    return replace(curriculum, pool=pool)


def _by_situations(share: Array, total: Float[Array, "S"], weights: Float[Array, "S"]) -> Array:
    """(...) the chance that a start is drawn for a situation, by the shares (..., S) of time and their sums."""
    met = total > TINY
    divisor = jnp.where(met, total, 1.0)
    weight = jnp.where(met, weights / divisor, 0.0)

    # The weight of situations that have not been met goes to all alike.
    met_weights = jnp.where(met, weights, 0.0)
    not_met = 1.0 - met_weights.sum() / jnp.maximum(weights.sum(), TINY)
    return share @ weight + not_met / len(share)


def _by_regret(plan: CurriculumPlan, curriculum: Curriculum) -> Float[Array, "K"]:
    score = regret(curriculum)
    has_score = _is_known(curriculum) | (curriculum.guess > 0.0)
    score = jnp.where(has_score, score, _mean_regret(curriculum))

    # The rank is 1 for the greatest, and equal for equals.
    ordered = jnp.sort(score)
    below = jnp.searchsorted(ordered, score, side="right")
    rank = len(score) - below + 1
    weights = rank.astype(jnp.float32) ** (-1.0 / plan.temperature)
    return weights / weights.sum()


def _shares(occurs: Float[Array, "K S"], seconds: Float[Array, "K"]) -> Float[Array, "K S"]:
    overall = occurs.sum(0) / jnp.maximum(seconds.sum(), TINY)
    return (occurs + overall[None, :]) / (seconds + 1.0)[:, None]  # with one second more


# ------------------------------------------------------------------ parts


def _draw(
    env: mdp.Env, plan: CurriculumPlan, policy: PolicyLike | None, keys: Array, randomization: PyTree = None
) -> dict[str, Any]:
    """The fields of a curriculum that have a row for each start, of new starts."""
    pool = env.draw_pool(keys, randomization)
    occurs, seconds = _occurrences(env, plan, pool, policy)
    record = ("episodes", "best", "returns", "ended", "guess")
    none = dict.fromkeys(record, jnp.zeros(keys.shape, jnp.float32))
    return {"pool": pool, "keys": keys, "occurs": occurs, "seconds": seconds, **none}


def _occurrences(env: mdp.Env, plan: CurriculumPlan, pool: mdp.Pool, policy: PolicyLike | None) -> tuple[Array, Array]:
    """(K, S) s that a policy spends in each situation, and (K,) s of all, from each start for a short while."""
    size = len(pool.weights)
    number = len(env.scenario.situations)
    if policy is None or plan.by == "regret":
        return jnp.zeros((size, number), jnp.float32), jnp.zeros(size, jnp.float32)
    look_ahead = functools.partial(_look_ahead, env, plan, policy)
    return jax.vmap(look_ahead)(pool.states)


def _look_ahead(env: mdp.Env, plan: CurriculumPlan, policy: PolicyLike, start: mdp.EnvState) -> tuple[Array, Array]:
    """(S,) s in each situation, and () s of all, from one start."""
    scenario = env.scenario_of(start.randomization)

    def advance(carry: tuple[State, Array, Array], step: None) -> tuple[tuple[State, Array, Array], None]:
        before, occurs, seconds = carry
        after, _ = policy_step(scenario, policy, before)
        is_over = before.completed | before.timed_out
        duration = jnp.where(is_over, 0.0, scenario.time_step).astype(jnp.float32)
        in_situations = duration * after.situations.astype(jnp.float32)
        return (after, occurs + in_situations, seconds + duration), None

    state = init_policy(scenario, policy, start.simulation)
    occurs = jnp.zeros(len(env.scenario.situations), jnp.float32)
    seconds = jnp.zeros((), jnp.float32)
    steps = max(1, round(plan.ahead / env.scenario.time_step))
    (_, occurs, seconds), _ = jax.lax.scan(advance, (state, occurs, seconds), length=steps)
    return occurs, seconds


def _offspring(
    env: mdp.Env,
    curriculum: Curriculum,
    keys: Array,
    parent: Int[Array, "R"],
    mutates: Bool[Array, "R"],
    key: Array,
) -> tuple[Array, PyTree]:
    """(R,) keys and (R, ...) parameters of starts that are new, or like their parents."""
    randomization = env.randomization
    assert randomization is not None
    split_keys = jax.vmap(lambda key: jax.random.split(key, 3))(keys)  # (R, 3)
    _, draw_keys, _ = jnp.moveaxis(split_keys, 1, 0)
    drawn = jax.vmap(lambda key: randomization.draw(key, env.scenario))(draw_keys)

    mutate = jax.vmap(lambda key, parameters: randomization.mutate(key, parameters, env.scenario))
    of_parents = jax.tree.map(lambda leaf: leaf[parent], curriculum.pool.states.randomization)
    mutated = mutate(jax.random.split(key, len(parent)), of_parents)

    def select(mutation: Array, new: Array) -> Array:
        return jnp.where(_as_column(mutates, new), mutation, new)

    keys = jnp.where(mutates, curriculum.keys[parent], keys)
    return keys, jax.tree.map(select, mutated, drawn)


def _as_column(condition: Bool[Array, "R"], rows: Array) -> Array:
    """A condition on each of the rows (R, ...), of their number of axes."""
    return condition.reshape(-1, *[1] * (rows.ndim - 1))


def _put(curriculum: Curriculum, fresh: dict[str, Any], exchange: Exchange) -> Curriculum:
    """The curriculum with ``fresh`` starts in the slots where they are better."""
    size = len(curriculum.keys)
    out, order, better = exchange

    def put(old: Array, new: Array) -> Array:
        chosen = jnp.where(_as_column(better, old), new[order], old[out])
        return old.at[out].set(chosen)

    numbers = curriculum.pool.states.start
    new_numbers = jnp.where(better, numbers[out] + size, numbers[out])
    replaced = numbers.at[out].set(new_numbers)
    before = {name: getattr(curriculum, name) for name in fresh}
    starts = jax.tree.map(put, before, fresh)
    pool = starts["pool"]
    pool = replace(pool, states=replace(pool.states, start=replaced))
    return replace(curriculum, **starts | {"pool": pool})


def _by_start(values: Float[Array, "T B C"], slot: Int[Array, "T B"], size: int) -> Float[Array, "K C"]:
    """Sums by start, of whole numbers: sums of floats would depend on the order of additions on a GPU."""
    rows = values.reshape(-1, values.shape[-1])  # (T B, C)
    largest = jnp.maximum(jnp.abs(rows).sum(0), TINY)
    unit = largest / WHOLE  # (C,)
    whole = jnp.round(rows / unit[None, :]).astype(jnp.int32)
    none = jnp.zeros((size, rows.shape[-1]), jnp.int32)
    sums = none.at[slot.reshape(-1)].add(whole)
    return sums.astype(jnp.float32) * unit[None, :]
