"""The colors of all pictures, tables and pages: situations, policies, people, robot, obstacles.

Situations have the colors of Paul Tol's "bright" scheme, which colorblind readers can tell apart.
"""

import colorsys
from collections.abc import Mapping, Sequence

SITUATION_COLORS = {
    "cross_path": "#ee6677",
    "down_path": "#4477aa",
    "join_group": "#228833",
    "leave_group": "#aa3377",
    "empty": "#b4b6ba",
}
SPARE_COLORS = (  # for situations beyond the paper's five, and the user's own
    "#66ccee", "#ccbb44", "#332288", "#44aa99", "#8c510a", "#ff9da7", "#999933", "#11c638"
)  # fmt: skip
NO_SITUATION = "#5a6274"
POLICY_COLORS = {
    "go_to_goal": "#4477aa",
    "social_costmap": "#ee6677",
    "move_base": "#ff9da7",
    "orca": "#228833",
    "social_force": "#44aa99",
    "dwa": "#66ccee",
    "mppi": "#332288",
    "expert": "#aa3377",
    "sensing_expert": "#ccbb44",
}

PAPER = "#fffffe"  # odd values, so that a page can replace them in a drawing by its own light or dark ones
FLOOR = "#f4f6f9"
INK = "#1c2333"
MUTED = "#6c7589"
ROBOT = "#f58a07"
ROBOT_EDGE = "#5e3200"
PERSON = "#fdfefd"
MEMBER = "#6fd0ea"  # of a group
PERSON_EDGE = "#2b3448"
TRAIL = "#6a80b4"
EDGE = "#8d99b3"  # of the behavior graph
FAINT_EDGE = "#c3cad8"
OBSTACLE = "#4d5b78"  # drawn the more opaque the higher it is
FLOW = "#2f6fb0"  # of people along edges, over a heat map
FLOW_EDGE = "#173a5e"
HEAT = ("#ffe8c400", "#fdcf94", "#f78d4f", "#dd3a25", "#a3082f")


def situation_colors(names: Sequence[str]) -> list[str]:
    """Colors of situations, the paper's and the user's own."""
    return category_colors(names, SITUATION_COLORS)


def policy_colors(names: Sequence[str]) -> list[str]:
    """Colors of policies, the package's and the user's own."""
    return category_colors(names, POLICY_COLORS)


def category_colors(names: Sequence[str], reserved: Mapping[str, str]) -> list[str]:
    """One color for each name: the reserved one, or the spare colors in turn, then hues between them."""
    others = list(dict.fromkeys(name for name in names if name not in reserved))
    taken = {*reserved.values()}
    spare = [color for color in SPARE_COLORS if color not in taken]
    spare += [_hue(index) for index in range(len(others) - len(spare))]
    others_colors = dict(zip(others, spare, strict=False))
    return [reserved[name] if name in reserved else others_colors[name] for name in names]


def _hue(index: int) -> str:
    """One of a sequence of colors whose hues are a golden angle apart."""
    share = colorsys.hsv_to_rgb((0.11 + 0.618034 * index) % 1.0, 0.55 + 0.15 * (index % 3), 0.80 - 0.12 * (index % 4))
    return "#" + "".join(f"{round(255 * part):02x}" for part in share)
