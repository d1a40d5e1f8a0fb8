"""The published social force law in float64 numpy, one person at a time: the oracle of the JAX crowd.

Written from the papers' formulas: it shares no code with the package.
"""

import numpy as np


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


def repulsion(d, w, v, p):
    """Forces (M, 2) of M others at relative positions d (M, 2) with velocities w (M, 2) on a person with velocity v."""
    r = p["repulsion"]
    y = (w - r["own_motion"] * v) * r["anticipation"]
    if not y.any():
        size = length(d)
        return (r["strength"] * np.exp((r["reach"] - size) / r["range"]) / size)[:, None] * d
    e = d - y
    reach_sum = length(d) + length(e)
    b = 0.5 * np.sqrt(np.maximum(reach_sum**2 - length(y) ** 2, 1e-30))
    push = r["strength"] * np.exp((r["reach"] - b) / r["range"]) * reach_sum / (4 * b)
    return push[:, None] * (d / length(d)[:, None] + e / length(e)[:, None])


def sight(push, d, look, p, law):
    """Weights (M,) of M forces (M, 2) from relative positions d (M, 2), for a person who looks along ``look`` (2,)."""
    r = p["repulsion"]
    if law == "in_cone":
        inside = -(push @ look) >= r["sight_cosine"] * length(push)
        return np.where(inside, 1.0, r["back_weight"])
    cosine = -(d @ look) / length(d)
    return r["back_weight"] + (1 - r["back_weight"]) * (1 + cosine) / 2


def contact(d, w, v, p):
    """Force (2,) of a body at relative position d (2,) with velocity w on a body with velocity v, by their overlap."""
    overlap = max(2 * p["walking"]["radius"] - length(d), 0.0)
    normal = d / length(d)
    tangent = np.array([-normal[1], normal[0]])
    push = p["contact"]["stiffness"] * overlap * normal
    if p["contact"]["friction"] is not None:
        push = push + p["contact"]["friction"] * overlap * ((w - v) @ tangent) * tangent
    return push


def sidestep(d, w, v, look, p):
    """Accelerations (n, 2) to the right, by people who approach."""
    c = p["sidestep"]
    bearing = -(d @ look) / length(d)
    oncoming = ((w - v) @ look < 0) & (bearing >= c["cosine"]) & (length(d) < c["range"])
    return np.where(oncoming, c["preference"] * bearing, 0.0)[:, None] * np.array([look[1], -look[0]])


def in_the_way(d, w, look, p):
    """Reduction of the desired velocity by a person at -d, as a fraction."""
    c = p["headway"]
    ahead, aside = -(d @ look), d[0] * look[1] - d[1] * look[0]
    gap = length(d) - 2 * p["walking"]["radius"]
    near, before = (c["range"] - gap) / (c["range"] - c["length"]), 1 - (aside / c["width"]) ** 2
    oncoming = ramp(-(w @ look))
    return ramp(ahead / c["ramp"]) * (1 - oncoming) * (max(near, 0.0) * max(before, 0.0)) ** 2


def closer(d, w, v):
    """The others who come closer: their positions and velocities, and the person's own velocity."""
    return [(one, other, v) for one, other in zip(d, w, strict=True) if one @ (v - other) < 0]


def step_aside(d, w, v, look, p):
    """Part of the force to the right, away from the closest approach to one other person at constant velocities."""
    c = p["evasion"]
    u = v - w
    time = -(d @ u) / (u @ u + c["speed"] ** 2)
    offset = d + u * time
    right = offset @ np.array([look[1], -look[0]]) + c["side"]
    closing = u @ u / (u @ u + c["speed"] ** 2)
    soon, near = max(1 - time / c["horizon"], 0.0), max(1 - offset @ offset / c["width"] ** 2, 0.0)
    return c["gain"] * ramp(-(d @ look) / c["ramp"]) * closing * (soon * near) ** 2 * right / c["width"]


def ramp(share):
    """0 below 0, 1 above 1."""
    return min(max(share, 0.0), 1.0)


def cohesion(i, others, x, v, look, p):
    """Force (2,) on person i of walking with others (a list): gaze, attraction, repulsion, contact."""
    c = p["cohesion"]
    force = np.zeros(2)
    if not others:
        return force
    middle = np.mean([x[j] for j in others], axis=0) - x[i]
    angle = np.arccos(np.clip(middle @ look / length(middle), -1, 1))
    smooth = length(middle) ** 2 / (length(middle) ** 2 + 0.1**2)
    force -= c["gaze"] * max(angle - c["view_angle"], 0.0) * smooth * v[i]
    centroid = np.mean([x[j] for j in [i, *others]], axis=0) - x[i]
    far = length(centroid) - len(others) / 2 * c["attraction_distance"]
    force += c["attraction"] * ramp(far / c["ramp"]) * centroid / length(centroid)
    for j in others:
        d = x[i] - x[j]
        near = c["repulsion_distance"] - length(d)
        force += c["repulsion"] * ramp(near / c["ramp"]) * d / length(d)
        force += contact(d, v[j], v[i], p)
    return force


def step(x, v, heading, desired, preferred, boxes, p, law, dt, walking_groups=()):
    """One semi-implicit Euler step of N people: positions, velocities, headings, desired velocities (N, 2).

    ``walking_groups`` are lists of the indices of companions.
    """
    n = len(x)
    new_x, new_v, new_heading = np.empty_like(x), np.empty_like(v), np.empty_like(heading)
    for i in range(n):
        companions = [j for walking_group in walking_groups if i in walking_group for j in walking_group if j != i]
        others = ~np.isin(np.arange(n), [i, *companions])
        d, w = x[i] - x[others], v[others]
        speed_wanted = length(desired[i])
        look = desired[i] / speed_wanted if speed_wanted > 0 else heading[i]
        push = repulsion(d, w, v[i], p)
        force = sight(push, d, look, p, law)[:, None] * push
        if "sidestep" in p:
            force = force + sidestep(d, w, v[i], look, p)
        force = force + np.array([contact(one, other, v[i], p) for one, other in zip(d, w, strict=True)]).reshape(-1, 2)
        felt = length(d) < p["walking"]["perception"]
        total = force[felt].sum(0)
        if "headway" in p:
            share = min(sum(in_the_way(*one, look, p) for one in zip(d[felt], w[felt], strict=True)), 0.95)
            total = total - share * desired[i] / p["walking"]["relaxation_time"]
        if "evasion" in p:
            share = sum(step_aside(one, *both, look, p) for one, *both in closer(d[felt], w[felt], v[i]))
            right = np.array([look[1], -look[0]])
            total = total + p["evasion"]["strength"] * share / np.sqrt(1 + share**2) * right
        if len(boxes[2]):
            distance, normal = from_boxes(x[i], boxes)
            near = distance < p["walking"]["perception"]
            size = p["walls"]["strength"] * np.exp((p["walls"]["reach"] - distance) / p["walls"]["range"])
            size = size * (1 + p["walls"]["distance_factor"] * (distance - 1))
            total = total + (size[:, None] * normal)[near].sum(0)
        ahead = total @ heading[i]
        left = np.array([-heading[i][1], heading[i][0]])
        across = (total @ left) / p["walking"]["lateral_damping"]
        total = (ahead * p["walking"]["backward_scale"] if ahead < 0 else ahead) * heading[i] + across * left
        total = total + cohesion(i, companions, x, v, look, p)
        u = v[i] + ((desired[i] - v[i]) / p["walking"]["relaxation_time"] + total) * dt
        u = u * min(1.0, p["walking"]["speed_ratio"] * preferred[i] / length(u)) if length(u) > 0 else u
        if len(boxes[2]):
            gap = distance - p["walking"]["radius"]
            excess = np.maximum(-gap / dt - normal @ u, 0.0)
            u = u + (excess[:, None] * normal).sum(0)
            if p["contact"]["friction"] is not None:
                tangent = np.stack([-normal[:, 1], normal[:, 0]], 1)
                slowed = (tangent @ u) / (1 + p["contact"]["friction"] / p["contact"]["stiffness"] * excess)
                u = u - ((tangent @ u - slowed)[:, None] * tangent).sum(0)
            approach, allowed = -normal @ u, np.maximum(gap / dt + 1e-3, 0.0)
            u = u * min([1.0, *(allowed[approach > allowed] / approach[approach > allowed])])
        new_v[i], new_x[i] = u, x[i] + u * dt
        turn = 0.0
        if length(u) > 0.1:
            turn = np.arctan2(heading[i][0] * u[1] - heading[i][1] * u[0], heading[i] @ u)
            turn = np.clip(turn, -p["walking"]["turn_rate"] * dt, p["walking"]["turn_rate"] * dt)
        c, s = np.cos(turn), np.sin(turn)
        new_heading[i] = np.array([[c, -s], [s, c]]) @ heading[i]
    return new_x, new_v, new_heading
