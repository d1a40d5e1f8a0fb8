"""Measures of how people walk about a floor: half turns, curves, heads, standstill, groups, and the floor they use.

The same detectors see recorded and simulated people, so that their values can stand beside each other. All of them take
an ``Observed`` crowd, in numpy.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import gaussian_filter1d

WAY = 2.0  # s before and after a moment, whose ways are compared
LEAST_WAY = 1.2  # m, of both ways
HALF_TURN = np.radians(120.0)  # between both ways
SMOOTHING = 0.6  # s, standard deviation of the Gaussian that removes annotation noise and sway
WALKS = 0.5  # m/s; slower people do not walk
JUMP = np.radians(60.0)  # of a heading within ``HEADING_STEP``
HEADING_STEP = 0.1  # s
SPIN = np.radians(270.0)  # of a heading within ``SPIN_TIME``
SPIN_TIME = 2.0  # s
SPIN_WAY = 0.3  # m, that a person who turns on the spot moves at most
STUCK_TIME = 10.0  # s
STUCK_WAY = 1.0  # m in that time
SLOW_WAY = 3.0  # m in that time
HARD = 8.0  # m/s2
SHORT_STAY = 30.0  # s in a group
HANDOVER = 5.0  # s, for which a member who would go waits for a successor
SOON = 10.0  # s, in which a person comes back through a door
O_SPACE = 0.7  # of the radius of a group's ring
MINUTE = 60.0  # s


class Observed(NamedTuple):
    """People on a floor at ``T`` moments, ``time_step`` s apart."""

    position: Float[np.ndarray, "T N 2"]  # m
    present: Bool[np.ndarray, "T N"]
    standing: Bool[np.ndarray, "T N"]  # in a group or at an errand, or walking with others: half turns are not counted
    heading: Float[np.ndarray, "T N 2"] | None  # unit vectors; recordings have none
    time_step: float


class Liveliness(NamedTuple):
    """How people walk about a floor; rates are per person-minute."""

    walking_minutes: float  # person-minutes
    half_turns: float  # of walking people
    acceleration_p95: float  # m/s2, smoothed, of walking people
    acceleration_p99: float
    turn_rate_p95: float  # rad/s, smoothed, of walking people
    hard_accelerations: float  # above ``HARD``
    heading_jumps: float
    spins: float  # turns on the spot
    stuck_share: float  # of the moments of people who do not stand
    slow_share: float
    longest_standstill: float  # s, of a person who does not stand


class GatheredPeople(NamedTuple):
    """The G conversational groups of a floor at ``T`` moments, ``time_step`` s apart."""

    group: Int[np.ndarray, "T N"]  # of each person, -1 none
    center: Float[np.ndarray, "G 2"]  # m, of the o-space
    radius: Float[np.ndarray, "G"]  # m, of the ring on which members stand
    visit: Float[np.ndarray, "G 2"]  # s, the shortest and the longest stay that the graph has


class GroupLife(NamedTuple):
    """How long people stay in groups, and how often others walk through them; NaN where nothing counts."""

    stays: float  # completed ones
    mean_stay: float  # s, of completed stays
    shortest_stay: float  # s
    longest_stay: float  # s
    short_stays: float  # share of completed stays below ``SHORT_STAY``
    unlike_graph: float  # share of completed stays that the graph does not have, with ``HANDOVER``
    changes: float  # people who leave a group, a group-minute
    intruded: float  # share of the moments of groups at which a non-member is within ``O_SPACE`` radii of the center


def liveliness(observed: Observed) -> Liveliness:
    """All measures of an observed crowd; NaN where nobody counts."""
    time_step = observed.time_step
    minutes = observed.present.sum() * time_step / MINUTE

    # Half turns of people who walk by themselves.
    turns, walking_moments = 0, 0
    acceleration: list[np.ndarray] = []
    turn_rate: list[np.ndarray] = []
    hard = 0
    for person, stretch in _stretches(observed.present):
        position = np.asarray(observed.position[stretch, person], float)
        free = ~observed.standing[stretch, person]
        half_turn, walking = _half_turns(position, time_step)
        turns += _count_runs(half_turn & free)
        walking_moments += int((walking & free).sum())
        if len(position) * time_step > 4.0 * SMOOTHING:
            curve = _curve(position, free, time_step)
            acceleration.append(curve[0])
            turn_rate.append(curve[1])
        hard += _hard_accelerations(position, time_step)

    walking_minutes = walking_moments * time_step / MINUTE
    stuck, slow, longest = standstill(observed)
    jumps, spins = heading_events(observed)
    accelerations = np.concatenate([np.zeros(0), *acceleration])
    turn_rates = np.concatenate([np.zeros(0), *turn_rate])
    return Liveliness(
        walking_minutes=walking_minutes,
        half_turns=_rate(turns, walking_minutes),
        acceleration_p95=_quantile(accelerations, 0.95),
        acceleration_p99=_quantile(accelerations, 0.99),
        turn_rate_p95=_quantile(turn_rates, 0.95),
        hard_accelerations=_rate(hard, minutes),
        heading_jumps=_rate(jumps, minutes),
        spins=_rate(spins, minutes),
        stuck_share=stuck,
        slow_share=slow,
        longest_standstill=longest,
    )


def _stretches(present: Bool[np.ndarray, "T N"]) -> Iterator[tuple[int, slice]]:
    """Each uninterrupted presence: the person, and its moments."""
    padded = np.pad(present.astype(np.int8), [(1, 1), (0, 0)])
    change = np.diff(padded, axis=0)
    for person in range(present.shape[1]):
        begins = np.flatnonzero(change[:, person] > 0)
        ends = np.flatnonzero(change[:, person] < 0)
        for begin, end in zip(begins, ends, strict=True):
            yield person, slice(int(begin), int(end))


def _half_turns(
    position: Float[np.ndarray, "K 2"], time_step: float
) -> tuple[Bool[np.ndarray, "K"], Bool[np.ndarray, "K"]]:
    """Whether the ways before and after each moment are a half turn, and whether a person walks there."""
    span = max(1, round(WAY / time_step))
    turns = np.zeros(len(position), bool)
    walks = np.zeros(len(position), bool)
    if len(position) <= 2 * span:
        return turns, walks
    before = position[span:-span] - position[: -2 * span]
    after = position[2 * span :] - position[span:-span]
    long_before = np.linalg.norm(before, axis=-1)
    long_after = np.linalg.norm(after, axis=-1)

    both_long = (long_before > LEAST_WAY) & (long_after > LEAST_WAY)
    cosine = (before * after).sum(-1) / np.maximum(long_before * long_after, 1e-9)
    turns[span:-span] = both_long & (cosine < np.cos(HALF_TURN))
    walks[span:-span] = long_before + long_after > 2.0 * LEAST_WAY
    return turns, walks


def _curve(
    position: Float[np.ndarray, "K 2"], free: Bool[np.ndarray, "K"], time_step: float
) -> tuple[Float[np.ndarray, "A"], Float[np.ndarray, "A"]]:
    """Magnitudes of acceleration [m/s2] and turn rate [rad/s] of a smoothed way, where its person walks."""
    sigma = SMOOTHING / time_step
    velocity = gaussian_filter1d(position, sigma, axis=0, order=1, mode="nearest") / time_step
    acceleration = gaussian_filter1d(position, sigma, axis=0, order=2, mode="nearest") / time_step**2
    speed = np.linalg.norm(velocity, axis=-1)
    cross = velocity[:, 0] * acceleration[:, 1] - velocity[:, 1] * acceleration[:, 0]

    # The ends of a stretch are smoothed over positions that nobody saw.
    margin = int(np.ceil(2.0 * sigma))
    counts = free & (speed > WALKS)
    counts[:margin] = False
    counts[len(counts) - margin :] = False
    return np.linalg.norm(acceleration[counts], axis=-1), np.abs(cross[counts]) / speed[counts] ** 2


def _hard_accelerations(position: Float[np.ndarray, "K 2"], time_step: float) -> int:
    """The number of moments of accelerations above ``HARD``."""
    if len(position) < 3:
        return 0
    acceleration = np.diff(position, 2, axis=0) / time_step**2
    return int((np.linalg.norm(acceleration, axis=-1) > HARD).sum())


def heading_events(observed: Observed) -> tuple[int, int]:
    """The numbers of heading jumps and of turns on the spot."""
    if observed.heading is None:
        return 0, 0
    jumps, spins = 0, 0
    for person, stretch in _stretches(observed.present):
        heading = np.asarray(observed.heading[stretch, person], float)
        angle = np.unwrap(np.arctan2(heading[:, 1], heading[:, 0]))
        step = max(1, round(HEADING_STEP / observed.time_step))
        jumps += _count_runs(np.abs(angle[step:] - angle[:-step]) > JUMP)

        span = max(1, round(SPIN_TIME / observed.time_step))
        if len(angle) > span:
            position = observed.position[stretch, person]
            moved = np.linalg.norm(position[span:] - position[:-span], axis=-1)
            spins += _count_runs((np.abs(angle[span:] - angle[:-span]) > SPIN) & (moved < SPIN_WAY))
    return jumps, spins


def standstill(observed: Observed) -> tuple[float, float, float]:
    """Shares of the moments of people who do not stand at which they are stuck and slow, and the longest time [s]."""
    span = round(STUCK_TIME / observed.time_step)
    counted, stuck, slow, longest = 0, 0, 0, 0
    for person, stretch in _stretches(observed.present):
        position = np.asarray(observed.position[stretch, person], float)
        free = ~observed.standing[stretch, person]
        if len(position) <= span:
            continue
        way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(position, axis=0), axis=-1))])
        walked = way[span:] - way[:-span]
        whole = np.convolve(free.astype(int), np.ones(span + 1, int), "valid") == span + 1
        counted += int(whole.sum())
        stuck += int((whole & (walked < STUCK_WAY)).sum())
        is_slow = whole & (walked < SLOW_WAY)
        slow += int(is_slow.sum())
        longest = max(longest, _longest_run(is_slow) + span if is_slow.any() else 0)
    counted = max(counted, 1)
    return stuck / counted, slow / counted, longest * observed.time_step


def group_life(observed: Observed, gathered: GatheredPeople) -> GroupLife:
    """Stays that begin and end while people are observed, and non-members in the o-spaces of two or more members."""
    durations: list[float] = []  # s
    unlike, leaves, occupied, intruded = 0, 0, 0, 0
    for index, (shortest, longest) in enumerate(gathered.visit):
        is_member = (gathered.group == index) & observed.present

        # Who is there at the first or at the last moment stays for longer than is seen.
        stays = [observed.time_step * moments for member in is_member.T for moments in _completed_runs(member)]
        durations += stays
        unlike += sum(not shortest - observed.time_step <= stay <= longest + HANDOVER for stay in stays)
        leaves += int((is_member[:-1] & ~is_member[1:]).sum())

        # One person alone has no o-space.
        distance = np.linalg.norm(observed.position - gathered.center[index], axis=-1)  # (T, N) m
        is_inside = (distance < O_SPACE * gathered.radius[index]) & observed.present & ~is_member
        is_group = is_member.sum(1) >= 2
        occupied += int(is_group.sum())
        intruded += int((is_inside.any(1) & is_group).sum())

    # Without a completed stay, values of stays are NaN.
    values = np.array(durations or [np.nan])
    is_short = np.where(np.isnan(values), np.nan, values < SHORT_STAY)
    minutes = len(gathered.visit) * len(observed.present) * observed.time_step / MINUTE
    return GroupLife(
        stays=float(len(durations)),
        mean_stay=float(values.mean()),
        shortest_stay=float(values.min()),
        longest_stay=float(values.max()),
        short_stays=float(is_short.mean()),
        unlike_graph=_rate(unlike, len(durations)),
        changes=_rate(leaves, minutes),
        intruded=_rate(intruded, occupied),
    )


def longest_near(observed: Observed, place: Float[np.ndarray, "2"], distance: float) -> float:
    """The longest time [s] for which a person stays within a distance [m] of a place [m]."""
    gap = np.linalg.norm(observed.position - place, axis=-1)  # (T, N) m
    near = observed.present & (gap < distance)
    return max(_longest_run(flags) for flags in near.T) * observed.time_step


def passes(observed: Observed, left: Float[np.ndarray, "2"], right: Float[np.ndarray, "2"]) -> tuple[int, int]:
    """How often people cross the line between two points [m] in either direction; and how often they cross it and soon
    come back.
    """
    side = right - left
    width = np.hypot(*side)
    along_x, along_y = side / width
    gap = observed.position - left  # (T, N, 2) m
    along = gap[..., 0] * along_x + gap[..., 1] * along_y
    is_beyond = gap[..., 1] * along_x - gap[..., 0] * along_y > 0.0
    within = (along > 0.0) & (along < width) & observed.present
    crosses = (is_beyond[1:] != is_beyond[:-1]) & within[1:] & within[:-1]

    # Who turns round behind the line has not passed: neither crossing counts.
    returns = 0
    for flags in crosses.T:
        last = -np.inf
        for moment in np.flatnonzero(flags):
            comes_back = (moment - last) * observed.time_step < SOON
            returns += int(comes_back)
            last = -np.inf if comes_back else moment
    return int(crosses.sum()) - 2 * returns, returns


def used_cells(observed: Observed, size: float = 1.0) -> set[tuple[int, int]]:
    """The cells of a grid with ``size`` [m] in which people walk."""
    walks = observed.present & ~observed.standing
    cells = np.floor(observed.position[walks] / size).astype(int)
    return set(map(tuple, np.unique(cells, axis=0).tolist()))


def _count_runs(flags: Bool[np.ndarray, "K"]) -> int:
    """The number of uninterrupted runs of true values."""
    return int((np.diff(np.pad(flags.astype(np.int8), 1)) > 0).sum())


def _completed_runs(flags: Bool[np.ndarray, "K"]) -> list[int]:
    """The lengths of the runs of true values that begin after the first moment and end before the last."""
    change = np.diff(flags.astype(np.int8))
    begins = np.flatnonzero(change > 0)
    ends = np.flatnonzero(change < 0)
    ends = ends[ends > begins[0]] if len(begins) else ends[:0]
    return (ends - begins[: len(ends)]).tolist()


def _longest_run(flags: Bool[np.ndarray, "K"]) -> int:
    """The length of the longest run of true values."""
    change = np.diff(np.pad(flags.astype(np.int8), 1))
    length = np.flatnonzero(change < 0) - np.flatnonzero(change > 0)
    return int(length.max(initial=0))


def _rate(count: int, minutes: float) -> float:
    return count / minutes if minutes > 0.0 else float("nan")


def _quantile(values: Float[np.ndarray, "K"], share: float) -> float:
    return float(np.quantile(values, share)) if len(values) else float("nan")
