"""The social force law as printed, in float64 numpy, one person at a time: the oracle of the JAX crowd.

Written apart from sean_jax from the papers' formulas: it shares no code with the package.
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
    """Pushes (M, 2) of M others at relative positions d (M, 2) with velocities w (M, 2) on one with velocity v."""
    y = (w - p["own_motion"] * v) * p["anticipation"]
    if not y.any():
        size = length(d)
        return (p["strength"] * np.exp((p["reach"] - size) / p["range"]) / size)[:, None] * d
    e = d - y
    reach_sum = length(d) + length(e)
    b = 0.5 * np.sqrt(np.maximum(reach_sum**2 - length(y) ** 2, 1e-30))
    push = p["strength"] * np.exp((p["reach"] - b) / p["range"]) * reach_sum / (4 * b)
    return push[:, None] * (d / length(d)[:, None] + e / length(e)[:, None])


def sight(push, d, look, p, law):
    """Weights (M,) of M pushes (M, 2) from relative positions d (M, 2), for somebody who looks along ``look`` (2,)."""
    if law == "in_cone":
        inside = -(push @ look) >= p["sight_cosine"] * length(push)
        return np.where(inside, 1.0, p["back_weight"])
    cosine = -(d @ look) / length(d)
    return p["back_weight"] + (1 - p["back_weight"]) * (1 + cosine) / 2


def step(x, v, heading, desired, preferred, boxes, p, law, dt):
    """One semi-implicit Euler step of N people: positions, velocities, headings, desired velocities (N, 2)."""
    n = len(x)
    new_x, new_v, new_heading = np.empty_like(x), np.empty_like(v), np.empty_like(heading)
    for i in range(n):
        others = np.arange(n) != i
        d, w = x[i] - x[others], v[others]
        speed_wanted = length(desired[i])
        look = desired[i] / speed_wanted if speed_wanted > 0 else heading[i]
        push = repulsion(d, w, v[i], p)
        force = sight(push, d, look, p, law)[:, None] * push
        bearing = -(d @ look) / length(d)
        oncoming = ((w - v[i]) @ look < 0) & (bearing >= p["side_cosine"]) & (length(d) < p["side_range"])
        right = np.array([look[1], -look[0]])
        force = force + np.where(oncoming, p["side_preference"] * bearing, 0.0)[:, None] * right
        overlap = np.maximum(2 * p["radius"] - length(d), 0.0)
        force = force + (p["body"] * overlap / length(d))[:, None] * d
        total = force[length(d) < p["perception"]].sum(0)
        if len(boxes[2]):
            distance, normal = from_boxes(x[i], boxes)
            near = distance < p["perception"]
            size = p["wall_strength"] * np.exp((p["wall_reach"] - distance) / p["wall_range"])
            size = size * (1 + p["wall_lever"] * (distance - 1))
            total = total + (size[:, None] * normal)[near].sum(0)
        ahead = total @ heading[i]
        left = np.array([-heading[i][1], heading[i][0]])
        across = (total @ left) / p["lateral_damping"]
        total = (ahead * p["reversing"] if ahead < 0 else ahead) * heading[i] + across * left
        u = v[i] + ((desired[i] - v[i]) / p["relaxation_time"] + total) * dt
        u = u * min(1.0, p["speed_ratio"] * preferred[i] / length(u)) if length(u) > 0 else u
        if len(boxes[2]):
            gap = distance - p["radius"]
            excess = np.maximum(-gap / dt - normal @ u, 0.0)
            u = u + (excess[:, None] * normal).sum(0)
            approach, allowed = -normal @ u, np.maximum(gap / dt + 1e-3, 0.0)
            u = u * min([1.0, *(allowed[approach > allowed] / approach[approach > allowed])])
        new_v[i], new_x[i] = u, x[i] + u * dt
        turn = 0.0
        if length(u) > 0.1:
            turn = np.arctan2(heading[i][0] * u[1] - heading[i][1] * u[0], heading[i] @ u)
            turn = np.clip(turn, -p["turn_rate"] * dt, p["turn_rate"] * dt)
        c, s = np.cos(turn), np.sin(turn)
        new_heading[i] = np.array([[c, -s], [s, c]]) @ heading[i]
    return new_x, new_v, new_heading
