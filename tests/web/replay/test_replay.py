"""Replays: numbers survive the page's format, the page refers to nothing outside, and a browser plays it."""

import base64
import dataclasses
import json
import re
import subprocess
import sys
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

import sean_jax
from sean_jax.cli import command_line
from sean_jax.core.data_types import Trajectory
from sean_jax.core.errors import InputError
from sean_jax.evaluation import compare
from sean_jax.web import pages, replay
from sean_jax.web.replay import CENTIMETRE, TURN, encode
from support.checkout import WEB
from support.replays import decode, lab_episodes
from support.runs import run
from support.web import browse


@pytest.fixture(scope="module")
def walked():
    """A scenario, and the frames of its first two episodes."""
    return lab_episodes()


@pytest.fixture(scope="module")
def content(walked):
    scenario, frames = walked
    shown = [replay.ReplayEpisode(each, f"episode {k}", "so </script> it ended") for k, each in enumerate(frames)]
    return replay.of_scenario(scenario, shown, "Two <episodes>")


def random_columns(seed: int) -> tuple[dict, dict, int]:
    random = np.random.default_rng(seed)
    frames = int(random.integers(1, 80))
    walk = np.cumsum(random.normal(0, 0.2, (frames, 5)), 0)
    columns = {
        "near": walk,
        "far": walk * 1e4,  # beyond what centimetres in 16 bits can tell
        "angle": random.uniform(-np.pi, np.pi, (frames, 2)),
        "index": random.integers(-1, 9, (frames, 3)),
        "flag": random.uniform(size=frames) < 0.5,
        "number": random.normal(0, 10.0 ** random.integers(-6, 6), frames),
        "none": np.zeros((frames, 0)),
    }
    return columns, {"near": "place", "far": "place", "angle": "angle", "index": "index", "flag": "index"}, frames


@pytest.mark.parametrize("seed", range(12))
def test_numbers_survive(seed):
    columns, kinds, frames = random_columns(seed)
    heads, numbers = encode(columns, kinds)
    data = base64.b64encode(zlib.compress(numbers)).decode()
    found = decode(json.loads(json.dumps({"columns": heads, "data": data})), frames)
    for name, values in columns.items():
        values = np.asarray(values, float).reshape(frames, -1)
        assert found[name].shape == values.shape
        apart = found[name] - values
        if kinds.get(name) == "angle":
            apart = (apart + np.pi) % (2 * np.pi) - np.pi
        span = np.ptp(values) if values.size else 0.0
        fine = {"place": CENTIMETRE, "angle": TURN, "index": 1e-9}.get(kinds.get(name, ""), 0.0)
        assert np.abs(apart).max(initial=0.0) <= max(0.51 * fine, span / 65_535) + 1e-9, name


def test_a_crowd_takes_few_bytes():
    """Sixty-two people for two minutes: a tenth of a megabyte of text."""
    random = np.random.default_rng(0)
    turn = np.cumsum(random.normal(0, 0.05, (1200, 62)), 0)
    x, y = (np.cumsum(0.1 * part(turn), 0) for part in (np.cos, np.sin))
    _, numbers = encode({"x": x, "y": y, "heading": turn}, {"x": "place", "y": "place", "heading": "angle"})
    assert len(base64.b64encode(zlib.compress(numbers, 9))) < 450_000


@pytest.mark.slow
def test_the_page_is_whole_and_refers_to_nothing_outside(content):
    text = replay.html(content)
    assert "://" not in text and "@import" not in text and "Two &lt;episodes&gt;" in text
    (held,) = re.findall(r'<script type="application/json" id="replay">(.*?)</script>', text, re.S)
    assert json.loads(held) == content
    ids = [part.split('"')[0] for part in text.split(' id="')[1:]]
    assert len(ids) == len(set(ids))


@pytest.mark.parametrize("seed", range(20))
def test_no_name_ends_the_pages_data_or_begins_a_comment_in_it(content, seed):
    """Of what HTML reads in a script element only "<" matters (HTML standard, 13.2.5.4 and the states it leads to)."""
    random = np.random.default_rng(seed)
    parts = ["<!--", "<script>", "</script>", "-->", "<", "&lt;", "\\u003c", "\\", '"', "name", " "]
    name = "<!--<script>" if seed == 0 else "".join(random.choice(parts, 8))
    named = content | {"title": name, "place": content["place"] | {"name": name}}
    for page in (replay.html(named), replay.html_of_several([(name, named)])):
        (held,) = re.findall(r'<script type="application/json" id="[^"]*">(.*?)</script>', page, re.S)
        assert "<" not in held and json.loads(held) == named


def test_it_holds_what_was_walked(walked, content):
    scenario, frames = walked
    assert [each["frames"] for each in content["episodes"]] == [int(each.active.sum()) for each in frames]
    head, one = content["episodes"][1], frames[1]
    number = head["frames"]
    found = decode(head, number)
    np.testing.assert_allclose(found["robot x"][:, 0], one.position[:number, 0], atol=0.006)
    np.testing.assert_allclose(found["person y"], one.people[:number, :, 1], atol=0.006)
    np.testing.assert_array_equal(found["person group"], one.group[:number])
    np.testing.assert_array_equal(found["situation"], one.situations[:number])
    heading = np.arctan2(one.people_heading[:number, :, 1], one.people_heading[:number, :, 0])
    apart = (found["person heading"] - heading + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(apart).max() <= np.pi / 256 + 1e-3
    nearest = np.linalg.norm(one.people - one.position[:, None], axis=-1)[:number].min(1)
    np.testing.assert_allclose(found["nearest person"][:, 0], nearest, atol=1e-3)
    assert content["robot"]["radius"] == scenario.robot.radius
    assert content["robot"]["views"][0]["angle"] == pytest.approx(np.radians(75.2), abs=0.01)


def test_planned_paths_end_at_the_goal_and_begin_at_the_robot(walked):
    scenario, frames = walked
    plan = replay.plans(scenario, frames[0])
    assert plan.shape[0] == len(frames[0].active)
    np.testing.assert_allclose(plan[:, -1], frames[0].goal, atol=0.02)
    begins = np.linalg.norm(plan[::10, 0] - frames[0].position[::10], axis=-1)
    assert begins.max() < 0.6


def test_absent_people_are_drawn_nowhere_and_leave_no_jump():
    """Who enters late and leaves early: the columns hold a place, and the mask says when."""
    frames = 30
    present = np.zeros((frames, 3), bool)
    present[5:20, 0], present[:, 1] = True, True
    people = np.random.default_rng(0).uniform(-5, 5, (frames, 3, 2))
    still = np.zeros((frames, 2))
    arrays: Any = dict(
        position=still, heading=np.tile([1.0, 0.0], (frames, 1)), velocity=still, action=still, people=people,
        people_velocity=np.zeros_like(people), people_heading=np.ones_like(people), group=np.full((frames, 3), -1),
        present=present, goal=still, situations=np.zeros((frames, 5), bool), active=np.ones(frames, bool),
    )  # fmt: skip
    one = Trajectory(**arrays)
    (head,) = replay.recording([replay.ReplayEpisode(one, "one")], replay.drawing.empty_floor(one))["episodes"]
    found = decode(head, frames)
    np.testing.assert_array_equal(found["person present"], present)
    x = found["person x"]
    assert np.ptp(x[:6, 0]) == 0 == np.ptp(x[19:, 0]) and not x[:, 2].any()
    alone = Trajectory(**arrays | {"present": np.zeros_like(present)})
    (head,) = replay.recording([replay.ReplayEpisode(alone, "one")], replay.drawing.empty_floor(one))["episodes"]
    assert np.isfinite(decode(head, frames)["nearest person"]).all()


def test_what_cannot_be_played_is_refused(walked):
    scenario, frames = walked
    with pytest.raises(InputError, match="there is no episode"):
        replay.of_scenario(scenario, [])
    batch = jax.tree.map(lambda leaf: np.stack([leaf, leaf]), frames[0])
    with pytest.raises(InputError, match="one leading axis"):
        replay.of_scenario(scenario, [replay.ReplayEpisode(batch, "both")])


def test_a_notebook_shows_it(walked, tmp_path):
    scenario, frames = walked
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *frames)
    for given, more in ((batch, (scenario,)), (frames[0], ())):
        shown = sean_jax.view(given, *more)
        assert isinstance(shown.figure, Figure)
        text = shown._repr_html_()
        assert (
            text.startswith('<iframe data-fit="yes" srcdoc=')
            and "data:image/png;base64," in text
            and "<script" not in text
        )
        assert shown._repr_png_().startswith(b"\x89PNG"), "for readers that show no HTML"
        shown.save(tmp_path / "page.html")
        assert "data-replay" in (tmp_path / "page.html").read_text()


@pytest.mark.slow
def test_any_episode_of_a_run_is_played_again(tmp_path, capsys):
    out = tmp_path / "out"
    words = ["run", "--environment", "lab", "--people", "3", "--dynamics", "twin", "--time-limit", "6", "--quiet"]
    assert command_line.main([*words, "--episodes", "7", "--out", str(out)]) == 0
    assert "data-replay" in (out / "report.html").read_text()
    assert command_line.main(["replay", str(out), "--episodes", "6", "0", "--quiet"]) == 0
    (held,) = re.findall(
        r'<script type="application/json" id="replay">(.*?)</script>', (out / "replay.html").read_text()
    )
    again = json.loads(held)
    assert [each["title"].split(" · ")[0] for each in again["episodes"]] == ["episode 6", "episode 0"]
    seconds = [line.split(",")[4] for line in (out / "episodes.csv").read_text().splitlines()[1:]]
    for number, each in zip((6, 0), again["episodes"], strict=True):
        assert f"{float(seconds[number]):.1f} s" in each["outcome"]
    capsys.readouterr()
    assert command_line.main(["replay", str(out), "--episodes", "7"]) == 2
    assert "7 is none of the 7" in capsys.readouterr().err
    assert command_line.main(["replay", str(tmp_path)]) == 2
    assert "holds no config.yaml" in capsys.readouterr().err


@pytest.mark.web
def test_the_built_program_is_that_of_its_source(tmp_path):
    if not (WEB / "node_modules" / ".bin" / "esbuild").is_file():
        pytest.skip("web/node_modules is not there; `npm ci` in web/ makes it")
    subprocess.run(["npm", "run", "-s", "check"], cwd=WEB, check=True, timeout=120)
    built = subprocess.run(
        ["npm", "run", "-s", "build", "--", f"--outdir={tmp_path}"], cwd=WEB, timeout=120, check=True
    )
    assert built.returncode == 0
    for page in "web/replay/page.min.js", "web/studio/page.min.js", "studies/survey/page.min.js":
        assert (tmp_path / page).read_text() == (pages.PACKAGE / page).read_text(), "run `npm run build` in web/"


@pytest.mark.web
def test_a_browser_plays_it(content, tmp_path):
    (tmp_path / "page.html").write_text(replay.html(content), encoding="utf-8")
    seen = json.loads(browse("test/page.mjs", tmp_path / "page.html"))
    assert seen["errors"] == [] and len(set(seen["requests"])) == 1, "nothing but the page itself is loaded"
    assert (seen["linked"], seen["opened"], seen["stepped"]) == (2.0, 0.1, 1.1)
    assert seen["duration"] == pytest.approx(0.1 * content["episodes"][0]["frames"]), "as the metric of the duration"
    assert seen["scrubbed"] == pytest.approx(seen["duration"] / 2, abs=0.3)
    assert "what its depth camera can see" in seen["legend"]
    assert "" in seen["named"] and any(re.match(r"obstacle, \d+\.\d × ", text) for text in seen["named"])
    assert any(re.match(r"person \d+: \d\.\d\d m/s|kuri: ", text) for text in seen["named"])
    flags, names = decode(content["episodes"][0], content["episodes"][0]["frames"])["situation"], content["situations"]
    held = flags[round(seen["scrubbed"] / 0.1) - 1]  # the first frame is of the end of the first step
    assert seen["lit"] == [each["name"].replace("_", " ") for each, on in zip(names, held, strict=True) if on]
    tops = [each["top"] for each in seen["labels"]]
    assert len(tops) == len(names) and min(np.diff(tops)) >= 17 and max(each["height"] for each in seen["labels"]) <= 17
    number = re.match(r"person \d+", seen["pinned"])
    assert number and seen["later"].startswith(number[0]) and seen["later"] != seen["pinned"] and seen["unpinned"] == ""
    assert seen["moves"] == [True, False], "#play plays, but not for readers who want no motion"
    assert seen["played"] == pytest.approx(seen["passed"], abs=0.15 + 2 * seen["slowest"]), "it plays in real time"
    assert seen["played"] > 0 and seen["drawn"] > 20


def comparison(folder: Path, replays: Sequence[dict]) -> str:
    """The page of two runs with random figures and these replays."""
    runs = [dataclasses.replace(compare.read_run(run(folder / name, 0, shift)), replay=each)
            for name, shift, each in zip(("one", "two"), (0.0, 5.0), replays, strict=True)]  # fmt: skip
    return compare.page(compare.differences(runs), runs, compare.summarize(runs))


@pytest.mark.web
def test_players_of_a_comparison_share_one_clock(walked, content, tmp_path):
    """Play, pause, time and episode; they go to 2 s before the robots part, here after 4 s. Situations are chosen."""
    scenario, frames = walked
    late = np.arange(60)[:, None] >= 40
    others = [each.replace(position=each.position + np.where(late, 0.6, 0.0)) for each in frames]
    shown = [replay.ReplayEpisode(each, f"episode {k}") for k, each in enumerate(others)]
    page = comparison(tmp_path, (content, replay.of_scenario(scenario, shown, "other")))
    (tmp_path / "page.html").write_text(page, encoding="utf-8")
    seen = json.loads(browse("test/compare.mjs", tmp_path / "page.html"))
    assert seen["errors"] == []
    for moment in "played", "sought", "parted", "opened":
        assert seen[moment][0] == pytest.approx(seen[moment][1], abs=0.2), moment
    assert 0.3 < seen["played"][0] and seen["sought"][0] == 3.1 and seen["opened"][0] == 0.1
    assert seen["parted"][0] == pytest.approx(2.1, abs=0.11)
    assert seen["views"] == [["overall"], ["empty"]]
    assert seen["plain"] == ["overall", "empty"] and seen["folded"] == ["Within empty"], "it needs no script"
    assert seen["right"] < 420, "the difference is in sight on a telephone"


@pytest.mark.web
def test_two_that_never_part_say_how_near_they_stay(walked, content, tmp_path):
    """And nothing jumps to the beginning."""
    scenario, frames = walked
    near = np.arange(60)[:, None] == 40
    others = [each.replace(position=each.position + np.where(near, [0.3, 0.0], 0.0)) for each in frames]
    shown = [replay.ReplayEpisode(each, f"episode {k}") for k, each in enumerate(others)]
    page = comparison(tmp_path, (content, replay.of_scenario(scenario, shown, "other")))
    (tmp_path / "page.html").write_text(page, encoding="utf-8")
    seen = json.loads(browse("test/apart.mjs", tmp_path / "page.html"))
    assert re.fullmatch(r"they stay within 0.5 m of each other \(at most 0\.\d\d m at 4\.1 s\)", seen["said"])
    assert [text.split(" ")[0] for text in seen["clocks"]] == ["3.1", "3.1"]


@pytest.mark.web
def test_everybody_can_read_the_pages(content, tmp_path):
    """No serious finding of axe: contrast in light and dark, names of controls, keyboards."""
    table = pages.table(["name", "value"], [["one", "1.0"]])
    (tmp_path / "page.html").write_text(replay.html(content), encoding="utf-8")
    report = pages.page("A report", "kicker", [pages.section("Table", table, replay.element(content))])
    (tmp_path / "report.html").write_text(report, encoding="utf-8")
    (tmp_path / "compare.html").write_text(comparison(tmp_path, (content, content)), encoding="utf-8")
    for name in "page.html", "report.html", "compare.html":
        assert json.loads(browse("test/axe.mjs", (tmp_path / name).as_uri())) == [], name


@pytest.mark.web
def test_the_film_of_a_page_follows_the_robot(content, tmp_path):
    """900 x 500 pixels, the robot in the middle, 0.2 s of the episode from one picture to the next."""
    (tmp_path / "page.html").write_text(replay.html(content), encoding="utf-8")
    browse("film.mjs", tmp_path / "page.html", tmp_path / "film", 1, 1.0, 3.0)
    subprocess.run([sys.executable, "film.py", str(tmp_path / "film"), str(tmp_path / "film.gif")], cwd=WEB, check=True)
    with Image.open(tmp_path / "film.gif") as film:
        assert film.size == (900, 500) and getattr(film, "n_frames", 1) == 11
        for number in range(11):
            film.seek(number)
            pixels = np.asarray(film.convert("RGB"), int)[240:260, 440:460].reshape(-1, 3)
            assert (np.abs(pixels - [0xF5, 0x8A, 0x07]).max(1) < 12).sum() > 50, "the robot is orange"


@pytest.fixture(scope="module")
def notebook(walked, tmp_path_factory):
    """What a notebook's frame shows in Chromium."""
    scenario, frames = walked
    page = tmp_path_factory.mktemp("notebook") / "cell.html"
    page.write_text(replay.view(frames[0], scenario)._repr_html_(), encoding="utf-8")
    return json.loads(browse("test/frame.mjs", page))


def test_a_notebook_shows_the_whole_page(notebook):
    """Wide and narrow: the frame has the height of the page."""
    for frame, inside in notebook["heights"]:
        assert inside > 400 and abs(frame - inside) <= 2


@pytest.mark.web
def test_a_notebook_opens_in_a_situation(notebook, walked):
    """The first that holds after 3 s and is not "empty"; without one, the middle of the episode."""
    scenario, frames = walked
    names = [name for name, _ in scenario.situations]
    flags = frames[0].situations[frames[0].active][:, [name != "empty" for name in names]].any(1)
    moments = [t for t in range(30, len(flags)) if flags[t]]
    expected = moments[0] * 0.1 if moments else (len(flags) - 1) * 0.05
    assert notebook["opened"] == pytest.approx(expected + 0.1, abs=0.06) and notebook["paused"] == 1


@pytest.mark.web
def test_the_replay_follows_the_theme_of_its_host(notebook):
    """JupyterLab, mkdocs-material, VS Code and Colab over the system's; the plan is drawn again."""
    dark = {"false", "slate", "vscode-dark", "dark"}
    assert len(notebook["themes"]) == 18
    for each in notebook["themes"]:
        is_dark = each["value"] in dark
        assert each["paper"] == ("rgb(24, 29, 39)" if is_dark else "rgb(255, 255, 254)"), each
        if each["name"]:
            assert (each["floor"] < 128) == is_dark, each


@pytest.mark.web
def test_states_and_next_nodes_of_people(tmp_path):
    """Random walks against loops of the definitions: of the legend, and the node that a person enters next."""
    if not (WEB / "node_modules" / "esbuild").is_dir():
        pytest.skip("web/node_modules is not there")
    random = np.random.default_rng(3)
    frames, people = 120, 12
    speed = np.repeat(random.choice([0.05, 0.4, 0.9, 1.3], (frames // 20, people)), 20, 0)
    angle = np.cumsum(random.normal(0, 0.15, (frames, people)), 0) + random.uniform(-3, 3, people)
    heading = np.stack([np.cos(angle), np.sin(angle)], -1)
    places = np.cumsum(0.1 * speed[..., None] * heading, 0) + random.uniform(-2, 2, (people, 2))
    present = np.ones((frames, people), bool)
    present[:40, 0], present[80:, 1] = False, False
    group = np.where(random.uniform(size=(frames // 20, people)) < 0.2, 1, -1).repeat(20, 0)
    robot = np.cumsum(random.normal(0, 0.05, (frames, 2)), 0)
    arrays: Any = dict(
        position=robot, heading=np.tile([1.0, 0.0], (frames, 1)), velocity=robot, action=robot, people=places,
        people_velocity=heading, people_heading=heading, group=group, present=present, goal=robot,
        situations=np.zeros((frames, 5), bool), active=np.ones(frames, bool),
    )  # fmt: skip
    one = Trajectory(**arrays)
    nodes = random.uniform(-3, 3, (6, 2)).round(2)
    graph = {
        "names": list("abcdef"),
        "position": nodes.tolist(),
        "radius": [0.8] * 6,
        "group": [False] * 6,
        "edges": [],
    }
    content = replay.recording([replay.ReplayEpisode(one, "one")], replay.drawing.empty_floor(one)) | {"graph": graph}
    (tmp_path / "page.html").write_text(replay.html(content), encoding="utf-8")
    words = ["node", "test/state.mjs", str(tmp_path / "page.html")]
    seen = json.loads(subprocess.run(words, cwd=WEB, check=True, capture_output=True, timeout=60).stdout)
    states, following = np.array(seen["states"]).T, np.array(seen["next"]).T
    columns = decode(content["episodes"][0], frames)
    x, y, turn = columns["person x"], columns["person y"], columns["person heading"]
    around = np.zeros((frames, people))
    for t, n in np.argwhere(present):
        some = [s for s in range(max(0, t - 3), min(frames, t + 4)) if present[s, n]]
        way = np.hypot(x[some[-1], n] - x[some[0], n], y[some[-1], n] - y[some[0], n])
        around[t, n] = way / (0.1 * (len(some) - 1))
    expected = np.full((frames, people), "person", dtype=object)
    unsure = ~present
    for n in range(people):
        walked = sorted(value for value in around[::5, n] if value > 0.3)
        usual = walked[len(walked) // 2] if walked else 0.0
        for t in range(frames):
            gap = np.array([columns["robot x"][t, 0] - x[t, n], columns["robot y"][t, 0] - y[t, n]])
            ahead = gap @ [np.cos(turn[t, n]), np.sin(turn[t, n])]
            unsure[t, n] |= min(abs(np.hypot(*gap) - 2.0), abs(ahead), abs(around[t, n] - usual / 2)) < 1e-3
            if group[t, n] >= 0:
                expected[t, n] = "member"
            elif np.hypot(*gap) <= 2.0 and ahead > 0.0 and around[t, n] < usual / 2:
                expected[t, n] = "yielding"
    assert (states == expected)[~unsure].all()
    assert all(np.sum(expected[~unsure] == name) > 20 for name in ("person", "member", "yielding"))
    apart = np.linalg.norm(np.stack([x, y], -1)[:, :, None] - nodes, axis=-1) - 0.8
    inside = np.where((apart < 0).any(-1), (apart < 0).argmax(-1), -1)
    for t, n in np.argwhere(present & (np.abs(apart) > 1e-3).all(-1).all(0)):
        ends = np.flatnonzero(~present[t:, n])
        later = inside[t + 1 : t + ends[0] if len(ends) else None, n]
        enters = later[(later >= 0) & (later != inside[t, n])]
        assert following[t, n] == (enters[0] if len(enters) else -1)
    assert len(np.unique(following)) > 4


MACHADO = {
    "all": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.3039]],
}
"""linear RGB as people see it; source: Machado, Oliveira and Fernandes 2009, table 1, severity 1"""


@pytest.mark.parametrize("sight", MACHADO)
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_states_differ_for_all_eyes(sight, dark):
    """States and the robot differ from one another, and people from the floor by 3 to 1 (WCAG 1.4.11)."""
    style = (pages.PACKAGE / "web/pages/style.css").read_text()

    def linear(name: str) -> np.ndarray:
        (value,) = re.findall(rf"--{name}:(?:light-dark\()?(#\w{{6}}(?:,#\w{{6}})?)", style)
        digits = value.split(",")[-1 if dark else 0]
        code = np.array([int(digits[k : k + 2], 16) for k in (1, 3, 5)]) / 255
        plain = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
        return np.clip(np.array(MACHADO[sight]) @ plain, 0.0, 1.0)

    def lab(color: np.ndarray) -> np.ndarray:
        xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ color
        f = np.cbrt(np.maximum(xyz / [0.9505, 1.0, 1.089], 0.00886))
        return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])

    shades = {name: linear(name) for name in ("person", "member", "yielding", "robot")}
    for one in shades:
        for other in shades:
            assert one == other or np.linalg.norm(lab(shades[one]) - lab(shades[other])) > 20, (one, other)
    light = [0.2126, 0.7152, 0.0722]
    for name in ("person", "member", "yielding"):
        pair = sorted([light @ linear(name) + 0.05, light @ linear("floor") + 0.05])
        assert pair[1] / pair[0] >= 3.0, name
