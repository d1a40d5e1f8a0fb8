"""Replays: episodes on a page that plays them, as one file of HTML that needs no network.

The plan from above with people's headings and trails, their groups, the robot with what its sensors have in sight, its
planned path, the graph, a timeline of the situations (Fig. 2), whose labels are their lights, and metrics as curves.
``page.min.js`` is built of the TypeScript in ``web/`` (``npm run build``).

The page reads episodes as whole numbers: differences from frame to frame, deflated, as text. A column is T numbers.
They are rounded to 16 bits, and each is the difference from the one before it, modulo 2**16: differences of people who
walk are small and alike, so that they deflate to a seventh of their size. Low bytes of all columns come first, then
high bytes, which are mostly 0 or 255. ``web/src/recording.ts`` reads them.
"""

import base64
import dataclasses
import html as markup
import io
import json
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import drawing, robots
from sean_jax.core.data_types import FAR, Environment, Scenario, Trajectory
from sean_jax.core.errors import InputError
from sean_jax.drawing import colors
from sean_jax.drawing.layers import first_episode, one_episode, situation_names
from sean_jax.graph import FLOWS, NO_EDGE, BehaviorGraph, graph_of
from sean_jax.io import files, writing
from sean_jax.metrics.proximity import INTIMATE, PERSONAL
from sean_jax.web import pages
from sean_jax.world import navigation

VERSION = 1
LEVELS = 2**16 - 1
TURN = 2.0 * np.pi / 2**16  # rad, of a level of an angle
COARSE = 2.0 * np.pi / 256  # rad, of people's headings: finer ones cannot be seen, and take a third more bytes
CENTIMETRE = 0.01
LOWEST = -300.0  # m: 655 m from there on are what places in whole centimetres can be
TEMPLATE = "web/replay/page.html"
PLAN_POINTS, PLAN_SPACING = 24, 0.5  # of the planned path; m
NOBODY = 20.0  # m, drawn as the distance of the nearest person where there is none
KINDS = {
    "robot x": "place", "robot y": "place", "robot heading": "angle", "goal x": "place", "goal y": "place",
    "other x": "place", "other y": "place", "other heading": "angle", "other goal x": "place", "other goal y": "place",
    "person x": "place", "person y": "place", "person heading": "angle", "person group": "index",
    "person present": "index", "situation": "index", "plan x": "place", "plan y": "place",
}  # fmt: skip
CURVES = (
    {"name": "speed", "unit": "m/s", "marks": []},
    {"name": "nearest person", "unit": "m", "marks": [[INTIMATE, "intimate"], [PERSONAL, "personal"]]},
    {"name": "distance to goal", "unit": "m", "marks": []},
)
OF_PEOPLE = (
    {"name": "people", "unit": "", "marks": []},
    {"name": "mean speed", "unit": "m/s", "marks": []},
)
"""curves where there is no robot"""


@dataclasses.dataclass(frozen=True)
class ReplayEpisode:
    """An episode, its title and its outcome."""

    frames: Trajectory  # (T, ...)
    title: str
    outcome: str = ""
    plan: np.ndarray | None = None  # (T, K, 2) m, the planned path ahead of the robot
    begin: int = 1  # steps before the first frame: a trajectory begins after the first step


def recording(
    episodes: Sequence[ReplayEpisode],
    environment: Environment,
    *,
    title: str = "",
    graph: BehaviorGraph | None = None,
    scenario: Scenario | None = None,
    situations: Sequence[str] | None = None,
    time_step: float = 0.1,
    robot: bool = True,
    live: str = "",
) -> dict[str, Any]:
    """The content of the page as JSON values, which ``web/src/recording.ts`` describes.

    Args:
        episodes: one or more, with as many situations each; none with ``live``.
        scenario: for the robot's size and sensors; without it, they are not drawn.
        situations: their names; the paper's five, or numbers, if None.
        robot: whether there is one; else only people are drawn.
        live: address from which the page asks for the frames of one more episode.

    Raises:
        InputError: there is no episode, or one has a batch axis or other situations.
    """
    if not (episodes or live):
        raise InputError("replay: there is no episode; give one or more.")
    names = situation_names(episodes[0].frames, situations) if episodes else tuple(situations or ())
    shades = colors.situation_colors(names)
    content = {
        "version": VERSION,
        "title": title,
        "place": place_of_page(environment),
        "graph": None if graph is None else graph_of_page(graph),
        "robot": _robot(scenario) if robot else None,
        "person": {"radius": 0.2 if scenario is None else float(scenario.forces.walking.radius)},
        "situations": [{"name": name, "color": shade} for name, shade in zip(names, shades, strict=True)],
        "curves": list(CURVES if robot else OF_PEOPLE),
        "timeStep": time_step,
        "episodes": [encoded(episode, names, robot) for episode in episodes],
    }
    if live:
        content["live"] = live
    return content


def of_scenario(
    scenario: Scenario, episodes: Sequence[ReplayEpisode], title: str = "", live: str = ""
) -> dict[str, Any]:
    """A recording of episodes of a scenario, with planned paths; arguments and errors as of ``recording``."""
    planned = []
    for episode in episodes:
        plan = plans(scenario, one_episode(episode.frames))
        planned.append(dataclasses.replace(episode, plan=plan))
    return recording(
        planned,
        scenario.environment,
        title=title,
        graph=graph_of(scenario),
        scenario=scenario,
        situations=[name for name, _ in scenario.situations],
        time_step=scenario.time_step,
        live=live,
    )


def plans(scenario: Scenario, frames: Trajectory) -> np.ndarray:
    """(T, K, 2) m, the remaining shortest path of an episode's frames (T, ...), once a second; beyond it, the goal."""
    every = max(1, round(1.0 / scenario.time_step))
    places = np.asarray(frames.position)[::every]  # (P, 2)
    goals = np.asarray(frames.goal)[::every]
    padded = 128 * -(-len(places) // 128), 2  # so that episodes of like length share a program
    points = _plans(
        scenario.navigation,
        jnp.asarray(np.resize(places, padded), float),
        jnp.asarray(np.resize(goals, padded), float),
    )
    each_second = np.asarray(points)[: len(places)]
    return np.repeat(each_second, every, axis=0)[: len(frames.active)]


@jax.jit
def _plans(table: navigation.Navigation, places: jax.Array, goals: jax.Array) -> jax.Array:
    def plan(row: tuple[jax.Array, jax.Array]) -> jax.Array:
        place, goal = row
        paths = navigation.build_paths_to_goal(table, goal)
        last_arc = navigation.last_arc_to_goal(table, goal)
        return navigation.plan(table, place, goal, paths, last_arc, points=PLAN_POINTS, apart=PLAN_SPACING)

    return jax.lax.map(plan, (places, goals))


def place_of_page(environment: Environment) -> dict[str, Any]:
    """The floor and the obstacles of an environment as the page draws them."""
    boxes = jax.tree.map(np.asarray, environment.obstacles)
    rows = np.concatenate([boxes.center, boxes.half_extent, boxes.yaw[:, None], boxes.height[:, None]], 1)  # (W, 6)
    rows = rows[boxes.center[:, 0] < FAR]  # without padding
    return {
        "name": environment.name,
        "floor": [round(float(value), 3) for value in np.asarray(environment.floor)],
        "obstacles": np.round(rows.astype(float), 3).tolist(),
    }


def graph_of_page(graph: BehaviorGraph) -> dict[str, Any]:
    """A graph as the page draws it."""
    count = len(graph.names) or graph.nodes
    flows = np.asarray(graph.flow)
    edges = []
    for u, v in np.argwhere(np.triu(flows != NO_EDGE, 1)):
        edges.append([int(u), int(v), FLOWS[flows[u, v]]])
    return {
        "names": list(graph.names) or [f"node {number}" for number in range(count)],
        "position": np.round(np.asarray(graph.position, float)[:count], 2).tolist(),
        "radius": np.round(np.asarray(graph.radius, float)[:count], 2).tolist(),
        "group": np.asarray(graph.is_group, bool)[:count].tolist(),
        "edges": edges,
    }


def _robot(scenario: Scenario | None) -> dict[str, Any]:
    if scenario is None:
        return {"name": "robot", "radius": 0.2, "views": []}
    robot = scenario.robot
    views = []
    for mount in robot.mounts:
        if mount.name == "depth" and mount.fovy > 0.0:
            half = np.tan(np.radians(mount.fovy) / 2.0) * 4.0 / 3.0  # of its pictures' sides
            views.append({"name": "depth", "angle": round(float(2.0 * np.arctan(half)), 4), "range": 20.0})
    radius, *others = robots.radii(scenario)
    content = {"name": robot.name, "radius": radius, "views": views}
    if others:
        content["others"] = others
    return content


def encoded(episode: ReplayEpisode, names: Sequence[str], robot: bool = True) -> dict[str, Any]:
    """An episode, or a part of one, as JSON values for the page.

    Raises:
        InputError: it has a batch axis or other situations.
    """
    head, numbers = packed(episode, names, robot)
    return head | {"data": base64.b64encode(zlib.compress(numbers, 9)).decode("ascii")}


def packed(episode: ReplayEpisode, names: Sequence[str], robot: bool = True) -> tuple[dict[str, Any], bytes]:
    """An episode, or a part of one, as a head of JSON values and bytes; errors as of ``encoded``."""
    frames: Any = one_episode(episode.frames)  # numpy arrays
    situation_names(frames, names)  # refuses another number
    columns = {
        "person x": _filled(frames.people[..., 0], frames.present),
        "person y": _filled(frames.people[..., 1], frames.present),
        "person heading": np.round(_angle(frames.people_heading) / COARSE) * COARSE,
        "person group": frames.group,
        "person present": frames.present,
        "situation": frames.situations,
        **(_of_robot(frames) if robot else _of_people(frames)),
    }
    if episode.plan is not None:
        columns |= {"plan x": episode.plan[..., 0], "plan y": episode.plan[..., 1]}
    head = {
        "title": episode.title,
        "outcome": episode.outcome,
        "frames": len(frames.active),
        "begin": episode.begin,
    }
    columns, numbers = encode(columns, KINDS)
    return head | {"columns": columns}, numbers


def _of_people(frames: Any) -> dict[str, np.ndarray]:
    """The curves of people alone."""
    count = np.sum(frames.present, -1)  # (T,)
    speed = np.linalg.norm(frames.people_velocity, axis=-1)  # (T, N)
    total = np.sum(speed, -1, where=frames.present)
    return {"people": count, "mean speed": total / np.maximum(count, 1)}


def _of_robot(frames: Any) -> dict[str, np.ndarray]:
    gaps = np.linalg.norm(frames.people - frames.position[:, None], axis=-1)
    nearest = np.min(np.where(frames.present, gaps, NOBODY), 1, initial=NOBODY)
    others = {}
    if frames.robots is not None:  # of a team
        x, y, hx, hy, gx, gy = np.moveaxis(frames.robots, -1, 0)
        others = {
            "other x": x,
            "other y": y,
            "other heading": np.arctan2(hy, hx),
            "other goal x": gx,
            "other goal y": gy,
        }
    return {
        **others,
        "robot x": frames.position[:, 0],
        "robot y": frames.position[:, 1],
        "robot heading": _angle(frames.heading),
        "goal x": frames.goal[:, 0],
        "goal y": frames.goal[:, 1],
        "speed": np.linalg.norm(frames.velocity, axis=-1),
        "nearest person": nearest,
        "distance to goal": np.linalg.norm(frames.goal - frames.position, axis=-1),
    }


def _angle(heading: np.ndarray) -> np.ndarray:
    return np.arctan2(heading[..., 1], heading[..., 0])


def _filled(values: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Positions (T, N); those of absent people are their last ones, or the ones where they will appear."""
    frames = np.arange(len(values))[:, None]
    last = np.maximum.accumulate(np.where(present, frames, -1), 0)
    first = np.where(present.any(0), present.argmax(0), 0)
    filled = np.take_along_axis(values, np.where(last < 0, first[None], last), 0)
    return np.where(present.any(0), filled, 0.0)


def encode(columns: Mapping[str, np.ndarray], kinds: Mapping[str, str]) -> tuple[list[dict[str, Any]], bytes]:
    """Columns of an episode, (T,) or (T, K) by name, as the list of (name, count, scale, offset) and their numbers.

    Args:
        kinds: name -> ``place`` [m], to a centimetre; ``angle`` [rad]; ``index``, whole numbers from -1 on; any other
            name is a number, whose range is divided into 65,535 levels.
    """
    heads = []
    numbers = [np.zeros(0, np.uint16)]
    for name, column in columns.items():
        values = np.asarray(column, float)
        if values.ndim == 1:
            values = values[:, None]
        scale, offset = _scale(values, kinds.get(name, "number"))
        heads.append({"name": name, "count": values.shape[1], "scale": scale, "offset": offset})
        levels = np.round((values.T - offset) / scale).astype(np.int64)  # (K, T)
        numbers.append(np.diff(levels, axis=1, prepend=0).astype(np.uint16).ravel())

    # All low bytes, then all high ones, which are mostly alike and deflate well.
    whole = np.concatenate(numbers)
    return heads, np.concatenate([whole & 0xFF, whole >> 8]).astype(np.uint8).tobytes()


def _scale(values: np.ndarray, kind: str) -> tuple[float, float]:
    """The scale of a level, and the value of level 0."""
    if kind == "place":
        inside = values.size == 0 or (values.min() > LOWEST and values.max() < LOWEST + LEVELS * CENTIMETRE)
        if inside:
            return CENTIMETRE, LOWEST
    if kind == "angle":
        return TURN, 0.0
    if kind == "index":
        return 1.0, -1.0
    low = float(values.min()) if values.size else 0.0
    high = float(values.max()) if values.size else 1.0
    return max((high - low) / LEVELS, 1e-9), low


def element(
    content: dict[str, Any], name: str = "replay", linked: bool = True, program: bool = True, clock: bool = False
) -> str:
    """A player of a recording inside a page.

    Args:
        program: whether the script follows; a page of several players has it once, after the last of them.
        clock: whether it shares one clock with the others that do: episode, moment and speed.
    """
    after = script() if program else ""
    return pages.macro("web/replay/player.html", "player", name, embedded(content), linked, after, clock)


def embedded(content: Any) -> str:
    """JSON for a page's script element: it has no "<", so it can neither end the element nor begin a comment."""
    return json.dumps(content, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def script() -> str:
    """The JavaScript of a player, which a page has once."""
    return files.read_text(Path(__file__).with_name("page.min.js"))


def html(content: dict[str, Any], picture: str = "", linked: bool = True) -> str:
    """A page with one player of a recording.

    Args:
        picture: HTML for readers without JavaScript.
    """
    instead = f"<noscript>{picture or 'This page needs JavaScript.'}</noscript>"
    players = [("", element(content, linked=linked))]
    return pages.render(TEMPLATE, title=content["title"], kicker="", players=players, instead=instead, script="")


def html_of_several(players: Sequence[tuple[str, dict[str, Any]]], title: str = "") -> str:
    """A page of several players, captions and recordings, one below the other."""
    elements = [
        (caption, element(content, f"replay-{k}", linked=False, program=False))
        for k, (caption, content) in enumerate(players)
    ]
    return pages.render(TEMPLATE, title=title, kicker="", players=elements, instead="", script=script())


class Replay:
    """Episodes that a notebook plays, and shows as a picture where there is no JavaScript."""

    def __init__(self, content: dict[str, Any], figure: Any):
        self.content = content
        self.figure = figure

    def save(self, path: Path | str) -> None:
        """Write the page.

        Raises:
            WriteError: another process writes the file.
        """
        writing.write(Path(path), html(self.content))

    def _repr_png_(self) -> bytes:
        """The picture, for readers that show no HTML."""
        stream = io.BytesIO()
        self.figure.savefig(stream, format="png", dpi=110)
        return stream.getvalue()

    def _repr_html_(self) -> str:
        data = base64.b64encode(self._repr_png_()).decode("ascii")
        picture = f'<img alt="episode from above" style="max-width:100%" src="data:image/png;base64,{data}">'
        page = markup.escape(html(self.content, picture, linked=False))
        x0, y0, x1, y1 = self.content["place"]["floor"]
        below = 18 * len(self.content["situations"]) + 54 * len(self.content["curves"])
        height = round(min(640, 900 * (y1 - y0) / (x1 - x0))) + below + 140  # until the page sets it, if it may
        return f'<iframe data-fit="yes" srcdoc="{page}" width="100%" height="{height}" style="border:0"></iframe>'


def view(trajectory: Trajectory, scenario: Scenario | None = None, animate: bool = False) -> Any:
    """Show a trajectory (T, ...) in a notebook, with a timeline to play it; of a batch (B, T, ...) the first episode.

    The behavior graph, the robot's camera and its planned path are drawn with a scenario. Without a scenario,
    people and robot are drawn on an empty floor.

    Returns:
        A ``Replay``, whose ``figure`` is the picture from above and whose ``save`` writes the page; with ``animate`` a
        moving IPython ``Image``.
    """
    picture = drawing.view(trajectory, scenario, animate)
    if animate:
        return picture
    frames = first_episode(trajectory)
    episode = ReplayEpisode(frames, "episode")
    if scenario is None:
        return Replay(recording([episode], drawing.empty_floor(frames)), picture)
    return Replay(of_scenario(scenario, [episode]), picture)
