"""The published social force law in float64 numpy, one person at a time: the oracle of the JAX crowd.

Written from the papers' formulas: the law shares no code with the package. At the end, the package's constants and its
crowd of the benchmarks as the law takes them.
"""

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import social_forces
from sean_jax.cli.bench import workload
from sean_jax.social_forces.forces import term_name


def length(v):
    """Length of vectors (..., 2)."""
    return np.sqrt((v**2).sum(-1))


def from_boxes(point, boxes):
    """Distance (W,) and normals (W, 2) from boxes (center (W, 2), half_extent (W, 2), yaw (W,)) to a point."""
    center, half, yaw = boxes
    distances, normals = [], []
    for c, h, a in zip(center, half, yaw, strict=True):
        axes = np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])
        local = axes @ (point - c)
        nearest = np.clip(local, -h, h)
        away = local - nearest
        if away.any():
            distance, normal = length(away), away / length(away)
        else:
            over = np.abs(local) - h
            k = int(over[0] <= over[1])
            distance, normal = over[k], np.eye(2)[k] * (1.0 if local[k] >= 0 else -1.0)
        distances.append(distance)
        normals.append(axes.T @ normal)
    return np.array(distances), np.array(normals)


def reach(d, look, p):
    """How far [m] a body reaches towards another at -d (2,): its depth along the look, its radius across."""
    c = p["walking"]
    if c["depth"] is None:
        return c["radius"]
    angle = np.arctan2(d[1], d[0]) - np.arctan2(look[1], look[0])
    return c["depth"] * np.cos(angle) ** 2 + c["radius"] * np.sin(angle) ** 2


def repulsion(d, w, v, radii, p):
    """Force (2,) of another at relative position d (2,) with velocity w on a person with velocity v."""
    r = p["repulsion"]
    if r["law"] == "surface":
        return r["strength"] * np.exp((r["reach"] + radii - length(d)) / r["range"]) * d / length(d)
    y = (w - r["own_motion"] * v) * r["anticipation"]
    if not y.any():
        return r["strength"] * np.exp((r["reach"] - length(d)) / r["range"]) * d / length(d)
    e = d - y
    reach_sum = length(d) + length(e)
    b = 0.5 * np.sqrt(np.maximum(reach_sum**2 - length(y) ** 2, 1e-30))
    push = r["strength"] * np.exp((r["reach"] - b) / r["range"]) * reach_sum / (4 * b)
    return push * (d / length(d) + e / length(e))


def sight(push, d, look, p):
    """Weight of a force (2,) from a relative position d (2,), for a person who looks along ``look`` (2,)."""
    r = p["repulsion"]
    if r["sight"] == "all_round":
        return 1.0
    if r["sight"] == "in_cone":
        return 1.0 if -(push @ look) >= r["sight_cosine"] * length(push) else r["back_weight"]
    cosine = -(d @ look) / length(d)
    return r["back_weight"] + (1 - r["back_weight"]) * (1 + cosine) / 2


def contact(d, w, v, radii, p):
    """Force (2,) of a body at relative position d (2,) with velocity w on a body with velocity v, by their overlap."""
    overlap = max(radii + (p["contact"]["margin"] or 0.0) - length(d), 0.0)
    normal = d / length(d)
    tangent = np.array([-normal[1], normal[0]])
    push = p["contact"]["stiffness"] * overlap * normal
    if p["contact"]["friction"] is not None:
        push = push + p["contact"]["friction"] * overlap * ((w - v) @ tangent) * tangent
    return push


def sidestep(d, w, v, look, p):
    """Acceleration (2,) to the right, by a person who approaches."""
    c = p["sidestep"]
    bearing = -(d @ look) / length(d)
    if (w - v) @ look >= 0 or bearing < c["cosine"] or length(d) >= c["range"]:
        return np.zeros(2)
    return c["preference"] * bearing * np.array([look[1], -look[0]])


def limit(d, w, look, radii, p):
    """The speed limit by another at -d (2,) and its weight: (gap - length), and how much they are in the way."""
    c = p["headway"]
    ahead, aside = -(d @ look), d[0] * look[1] - d[1] * look[0]
    room = max(length(d) - radii - c["length"], 0.01)
    weight = ramp(ahead / c["ramp"]) * (1 - ramp(-(w @ look))) * max(1 - (aside / c["width"]) ** 2, 0.0) ** 2
    return room, weight


def slowed(speed, time, limits):
    """The smooth minimum of a speed and of all limits room / time, each with a weight."""
    return (speed**-4.0 + sum(weight * (room / time) ** -4.0 for room, weight in limits)) ** -0.25


def step_aside(d, w, v, look, width, side, p):
    """Part of the force to the right, away from the closest approach to one other person at constant velocities."""
    c = p["evasion"]
    u = v - w
    if d @ u >= 0:
        return 0.0
    time = -(d @ u) / (u @ u + c["speed"] ** 2)
    offset = d + u * time
    right = offset @ np.array([look[1], -look[0]]) + side
    closing = u @ u / (u @ u + c["speed"] ** 2)
    soon, near = max(1 - time / c["horizon"], 0.0), max(1 - offset @ offset / width**2, 0.0)
    return c["gain"] * ramp(-(d @ look) / c["ramp"]) * closing * (soon * near) ** 2 * right / width


def ramp(share):
    """0 below 0, 1 above 1."""
    return min(max(share, 0.0), 1.0)


def gaze(i, others, x, v, look, p):
    """Braking (2,) of person i, who would have to turn the head to see the others (a list)."""
    c = p["cohesion"]
    middle = np.mean([x[j] for j in others], axis=0) - x[i]
    angle = np.arccos(np.clip(middle @ look[i] / length(middle), -1, 1))
    smooth = length(middle) ** 2 / (length(middle) ** 2 + 0.1**2)
    return -c["gaze"] * max(angle - c["view_angle"], 0.0) * smooth * v[i]


def cohesion(i, others, x, v, desired, look, time, p):
    """Force (2,) on person i of walking with others (a list): gaze, attraction, repulsion, alignment."""
    c = p["cohesion"]
    if not others:
        return np.zeros(2)
    force = gaze(i, others, x, v, look, p)
    centroid = np.mean([x[j] for j in [i, *others]], axis=0) - x[i]
    far = length(centroid) - len(others) / 2 * c["attraction_distance"]
    force += c["attraction"] * ramp(far / c["ramp"]) * centroid / length(centroid)
    for j in others:
        d = x[i] - x[j]
        near = c["repulsion_distance"] - length(d)
        force += c["repulsion"] * ramp(near / c["ramp"]) * d / length(d)
    if c["alignment"] is not None:
        group = [i, *others]
        force += c["alignment"] * (np.mean(desired[group], axis=0) - desired[i]) / time
        brakes = [gaze(j, [k for k in group if k != j], x, v, look, p) for j in group]
        force -= c["alignment"] * np.mean(brakes, axis=0)
    return force


def damped(force, heading, p):
    """A force (2,), weaker against the heading and across it."""
    ahead, left = force @ heading, np.array([-heading[1], heading[0]])
    across = (force @ left) / p["walking"]["lateral_damping"]
    return (ahead * p["walking"]["backward_scale"] if ahead < 0 else ahead) * heading + across * left


def bounded(force, p):
    """An acceleration (2,) shortened smoothly: a (1 + (|a| / a_max)^4)^(-1/4)."""
    return force / (1 + (length(force) / p["walking"]["acceleration"]) ** 4) ** 0.25


def exponential(trait, deviation, people):
    """Each person's factor of a parameter: exp(deviation trait); 1 where people do not differ."""
    return np.ones(people) if trait is None or deviation is None else np.exp(deviation * np.asarray(trait))


def looks(heading, desired, standing):
    """Unit vectors (N, 2): along the desired velocity, or along the heading of those who stand."""
    still = (length(desired) == 0) | standing
    return np.where(still[:, None], heading, desired / np.where(still, 1.0, length(desired))[:, None])


def stands(group, desired):
    """Whether people (N,) stand in a group: their desired speed is below .5 m/s."""
    return (np.asarray(group) >= 0) & (length(desired) < 0.5)


def turned_aside(push, d, look, c):
    """A push (2,) of a robot at -d (2,), whose part that drives people on leads to the side where they are."""
    if c["aside"] is None:
        return push
    left = np.array([-look[1], look[0]])
    offset = d @ left - 0.05
    driven = c["aside"] * max(d @ look / length(d), 0.0) * max(push @ look, 0.0)
    return push - driven * look + driven * offset / np.hypot(offset, 0.05) * left


def is_moving(motion, c):
    """How much a robot of that velocity (2,) is a moving robot, from 0 to 1."""
    if c["ramp"] == 0:
        return float(length(motion) > c["moving_speed"])
    return ramp(0.5 + (length(motion) - c["moving_speed"]) / c["ramp"])


def slowed_by_robot(i, x, v, look, evade, extra, standing, robot, p):
    """Share of the desired velocity that person i gives up before a robot (position, velocity, radius)."""
    place, w, _ = robot
    c, e, d, u = p["robot_repulsion"], p.get("evasion"), x[i] - place, v[i] - w
    if e is None or c["slowing"] is None or standing or d @ u >= 0:
        return 0.0
    moving = is_moving(w, c)
    width = 1.3 * evade[0] * (1 + moving * extra / e["width"])
    time = -(d @ u) / (u @ u + e["speed"] ** 2)
    offset = d + u * time
    closing = u @ u / (u @ u + e["speed"] ** 2)
    soon, near = max(1 - time / e["horizon"], 0.0), max(1 - offset @ offset / width**2, 0.0)
    return c["slowing"] * moving * ramp(-(d @ look) / e["ramp"]) * closing * soon * near


def by_robot(i, x, v, look, evade, extra, standing, robot, p):
    """Push (2,) of a robot (position, velocity, radius), and its parts in the sums of headway and of evasion."""
    place, motion, radius = robot
    c, d = p["robot_repulsion"], x[i] - place
    radii = reach(d, look, p) + radius
    moving = is_moving(motion, c)
    factor = np.exp(moving * extra / p["repulsion"]["range"])
    push = repulsion(d, motion, v[i], radii, p)
    force = factor * sight(push, d, look, p) * push
    if "sidestep" in p and not standing:
        force = force + sidestep(d, motion, v[i], look, p) * (factor if p["sidestep"]["scaled_by_robot"] else 1.0)
    force = turned_aside(force, d, look, c) + contact(d, motion, v[i], radii, p)
    limits = [limit(d, motion, look, radii, p)] if "headway" in p else []
    if "evasion" not in p:
        return force, limits, 0.0
    wider = 1 + moving * extra / p["evasion"]["width"]
    share = step_aside(d, motion, v[i], look, evade[0] * wider, evade[1], p)
    return force, limits, wider**5 * share  # the scale of the sum is that of the usual width


def walls_push(distance, normal, p):
    """Push (2,) of obstacles at distances (W,) with normals (W, 2)."""
    near = distance < p["walking"]["perception"]
    size = p["walls"]["strength"] * np.exp((p["walls"]["reach"] - distance) / p["walls"]["range"])
    size = size * (1 + p["walls"]["distance_factor"] * (distance - 1))
    return (size[:, None] * normal)[near].sum(0)


def kept_out(u, distance, normal, p, dt):
    """The velocity u (2,) with which a body enters no obstacle within a step, after friction at those it touches."""
    gap = distance - p["walking"]["radius"]
    excess = np.maximum(-gap / dt - normal @ u, 0.0)
    u = u + (excess[:, None] * normal).sum(0)
    if p["contact"]["friction"] is not None:
        tangent = np.stack([-normal[:, 1], normal[:, 0]], 1)
        rubbed = (tangent @ u) / (1 + p["contact"]["friction"] / p["contact"]["stiffness"] * excess)
        u = u - ((tangent @ u - rubbed)[:, None] * tangent).sum(0)
    approach, allowed = -normal @ u, np.maximum(gap / dt + 1e-3, 0.0)
    return u * min([1.0, *(allowed[approach > allowed] / approach[approach > allowed])])


def turned(heading, u, desired, p, dt):
    """The heading (2,) after a step with the velocity u (2,), towards it or, with ``facing``, also the desired one."""
    facing = p["walking"]["facing"]
    u = u if facing is None else u + facing * desired
    if length(u) <= (0.1 if facing is None else 0.4):
        return heading
    turn = np.arctan2(heading[0] * u[1] - heading[1] * u[0], heading @ u)
    turn = np.clip(turn, -p["walking"]["turn_rate"] * dt, p["walking"]["turn_rate"] * dt)
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[c, -s], [s, c]]) @ heading


def by_people(i, x, v, look, strangers, evade, standing, p):
    """Push (2,) of all other people on person i, limits of the speed, and the share of the strength of evasion.

    Those who are no ``strangers`` (N,), members of the same group, act by contact alone.
    """
    push, limits, share = np.zeros(2), [], 0.0
    for j in range(len(x)):
        d = x[i] - x[j]
        if j == i or length(d) >= p["walking"]["perception"]:
            continue
        radii = reach(d, look[i], p) + reach(d, look[j], p)
        push = push + contact(d, v[j], v[i], radii, p)
        if not strangers[j]:
            continue
        one = repulsion(d, v[j], v[i], radii, p)
        push = push + sight(one, d, look[i], p) * one
        if "sidestep" in p and not standing:
            push = push + sidestep(d, v[j], v[i], look[i], p)
        if "headway" in p:
            limits.append(limit(d, v[j], look[i], radii, p))
        if "evasion" in p:
            share += step_aside(d, v[j], v[i], look[i], *evade, p)
    return push, limits, share


def acceleration(i, x, v, heading, desired, preferred, walls, p, companions=(), group=None, groups=(), traits=None,
                 noise=None, robot=None, extra=None):  # fmt: skip
    """The acceleration (2,) of person i: the bounded part, and the pushes of people. Arguments as of ``step``."""
    n, c = len(x), p["walking"]
    traits, group = traits or {}, np.full(n, -1) if group is None else np.asarray(group)
    still = stands(group, desired)
    look, standing = looks(heading, desired, still), still[i]
    time = c["relaxation_time"] * exponential(traits.get("relaxation"), c["relaxation_deviation"], n)[i]
    evade = ()
    if "evasion" in p:
        e = p["evasion"]
        side = traits["side"][i] * e["side_deviation"] if traits and e["side_deviation"] is not None else 0.0
        evade = e["width"] * exponential(traits.get("width"), e["width_deviation"], n)[i], e["side"] + side
    strangers = ~np.isin(np.arange(n), list(companions)) & ~((group == group[i]) & (group[i] >= 0))
    push, limits, share = by_people(i, x, v, look, strangers, evade, standing, p)
    total = push
    if robot is not None and "robot_repulsion" in p:
        one = i, x, v, look[i], evade, 0.0 if extra is None else extra[i], standing, robot, p
        force, more, part = by_robot(*one)
        total, limits, share = total + force - slowed_by_robot(*one) * desired[i] / time, limits + more, share + part
    speed = length(desired[i])
    if "headway" in p and speed > 0:
        h = p["headway"]
        gap_time = h["time"] * exponential(traits.get("headway"), h["deviation"], n)[i]
        if noise is not None and h["noise"] is not None:
            gap_time = gap_time / np.exp(h["noise"] * noise[i][0])
        total = total + (slowed(speed, gap_time, limits) - speed) / time * desired[i] / speed
    if "evasion" in p and not standing:
        total = total + p["evasion"]["strength"] * share / np.hypot(1, share) * np.array([look[i][1], -look[i][0]])
    if "noise" in p and noise is not None:
        drive = p["noise"]["speed"] * noise[i][0] * look[i]
        drive = drive + p["noise"]["side"] * noise[i][1] * np.array([-look[i][1], look[i][0]])
        total = total + ramp(speed / max(preferred[i], 0.1)) * drive / time
    for g, (center, radius) in enumerate(groups):
        if g != group[i]:
            away = x[i] - center
            size = p["group_space"]["strength"] * np.exp((radius - length(away)) / p["group_space"]["range"])
            total = total + size * away / length(away)
    if walls is not None:
        total = total + walls_push(*walls, p)
    intent = damped(total, heading[i], p) + (desired[i] - v[i]) / time
    intent = intent + cohesion(i, companions, x, v, desired, look, time, p)
    pushed = damped(push, heading[i], p)
    return bounded(intent - pushed, p), pushed


def step(x, v, heading, desired, preferred, boxes, p, dt, walking_groups=(), **others):
    """One semi-implicit Euler step of N people: positions, velocities, headings (N, 2).

    ``walking_groups`` are lists of the indices of companions. Others: ``group`` (N,) the standing group of each, -1
    none; ``groups`` their centers and radii; ``traits`` by name (N,); ``noise`` (N, 2); ``robot`` its position,
    velocity and radius; ``extra`` (N,) m, the added distances to a moving robot.
    """
    new_x, new_v, new_heading = np.empty_like(x), np.empty_like(v), np.empty_like(heading)
    for i in range(len(x)):
        companions = [j for walking_group in walking_groups if i in walking_group for j in walking_group if j != i]
        walls = from_boxes(x[i], boxes) if len(boxes[2]) else None
        u = v[i] + dt * sum(acceleration(i, x, v, heading, desired, preferred, walls, p, companions, **others))
        u = u * min(1.0, p["walking"]["speed_ratio"] * preferred[i] / length(u)) if length(u) > 0 else u
        u = kept_out(u, *walls, p, dt) if walls is not None else u
        new_v[i], new_x[i] = u, x[i] + u * dt
        standing = "group" in others and stands(others["group"][i], desired[i])
        new_heading[i] = heading[i] if standing else turned(heading[i], u, desired[i], p, dt)
    return new_x, new_v, new_heading


def constants(forces: social_forces.Forces) -> dict[str, dict[str, float | str | None]]:
    """The parameters of each term by name, in float64, and the names of its laws."""

    def value(parameter):
        return parameter.__name__ if callable(parameter) else None if parameter is None else float(parameter)

    return {term_name(term): {name: value(one) for name, one in vars(term).items()} for term in forces}


def crowd(people: int, walls: int, preset: str):
    """Constants, state and boxes of the workload in float64."""
    forces = social_forces.preset(preset)
    numbers = workload.crowd(people, walls)[2]
    state = numbers["x"], numbers["v"], numbers["heading"], numbers["desired"], numbers["preferred"]
    return constants(forces), state, (numbers["center"], numbers["half"], numbers["yaw"])


def in_double(tree):
    """The tree with all its floating-point leaves in float64."""

    def cast(leaf):
        if not hasattr(leaf, "dtype") or not jnp.issubdtype(leaf.dtype, jnp.floating):
            return leaf
        return jnp.asarray(leaf, jnp.float64)

    return jax.tree.map(cast, tree)
