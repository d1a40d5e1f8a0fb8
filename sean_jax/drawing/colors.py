"""The colours of every picture, table and page: situations, people, robot, obstacles.

The situations wear Paul Tol's "bright" scheme, which colour-blind readers can tell apart.
"""

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

PAPER = "#fffffe"  # odd values, so that a page can replace them in a drawing by its own light or dark ones
FLOOR = "#f4f6f9"
INK = "#1c2333"
MUTED = "#6c7589"
ROBOT, ROBOT_EDGE = "#f58a07", "#5e3200"
PERSON, MEMBER, PERSON_EDGE = "#fdfefd", "#6fd0ea", "#2b3448"
TRAIL = "#6a80b4"
EDGE, FAINT_EDGE = "#8d99b3", "#c3cad8"  # of the behavior graph
OBSTACLE = "#4d5b78"  # drawn the more opaque the higher it is
FLOW, FLOW_EDGE = "#2f6fb0", "#173a5e"  # of people along edges, over a heat map
HEAT = ("#ffe8c400", "#fdcf94", "#f78d4f", "#dd3a25", "#a3082f")


def situation_colors(names: tuple[str, ...]) -> list[str]:
    """One colour for each situation; names that are not the paper's get the spare ones in turn."""
    spare = [name for name in names if name not in SITUATION_COLORS]
    return [SITUATION_COLORS.get(name) or SPARE_COLORS[spare.index(name) % len(SPARE_COLORS)] for name in names]
