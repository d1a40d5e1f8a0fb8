"""Replays: numbers survive the page's format, the page refers to nothing outside, and a browser plays it."""

import base64
import json
import re
import shutil
import subprocess
import zlib
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure
from replay_columns import decode

import sean_jax
from sean_jax import cli, pages, replay
from sean_jax.base import Trajectory
from sean_jax.errors import InputError
from sean_jax.policies import go_to_goal
from sean_jax.replay import CENTIMETRE, TURN, encode

WEB = Path(__file__).parent.parent / "web"
CHROMIUM = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None
)


@pytest.fixture(scope="module")
def walked():
    """A scenario with its first two episodes, and their frames."""
    scenario = sean_jax.make("lab", people=3, dynamics="twin", time_limit=8.0)
    roll = jax.jit(lambda key: sean_jax.rollout(scenario, go_to_goal, key, steps=60)[1])
    return scenario, [jax.tree.map(np.asarray, roll(jax.random.key(k))) for k in (0, 1)]


@pytest.fixture(scope="module")
def content(walked):
    scenario, frames = walked
    shown = [replay.Episode(each, f"episode {k}", "so </script> it ended") for k, each in enumerate(frames)]
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
    (head,) = replay.recording([replay.Episode(one, "one")], replay.drawing.empty_floor(one))["episodes"]
    found = decode(head, frames)
    np.testing.assert_array_equal(found["person present"], present)
    x = found["person x"]
    assert np.ptp(x[:6, 0]) == 0 == np.ptp(x[19:, 0]) and not x[:, 2].any()
    alone = Trajectory(**arrays | {"present": np.zeros_like(present)})
    (head,) = replay.recording([replay.Episode(alone, "one")], replay.drawing.empty_floor(one))["episodes"]
    assert np.isfinite(decode(head, frames)["nearest person"]).all()


def test_what_cannot_be_played_is_refused(walked):
    scenario, frames = walked
    with pytest.raises(InputError, match="there is no episode"):
        replay.of_scenario(scenario, [])
    batch = jax.tree.map(lambda leaf: np.stack([leaf, leaf]), frames[0])
    with pytest.raises(InputError, match="one leading axis"):
        replay.of_scenario(scenario, [replay.Episode(batch, "both")])


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
    assert cli.main([*words, "--episodes", "7", "--out", str(out)]) == 0
    assert "data-replay" in (out / "report.html").read_text()
    assert cli.main(["replay", str(out), "--episodes", "6", "0", "--quiet"]) == 0
    (held,) = re.findall(
        r'<script type="application/json" id="replay">(.*?)</script>', (out / "replay.html").read_text()
    )
    again = json.loads(held)
    assert [each["title"].split(" · ")[0] for each in again["episodes"]] == ["episode 6", "episode 0"]
    seconds = [line.split(",")[4] for line in (out / "episodes.csv").read_text().splitlines()[1:]]
    for number, each in zip((6, 0), again["episodes"], strict=True):
        assert f"{float(seconds[number]):.1f} s" in each["outcome"]
    capsys.readouterr()
    assert cli.main(["replay", str(out), "--episodes", "7"]) == 2
    assert "7 is none of the 7" in capsys.readouterr().err
    assert cli.main(["replay", str(tmp_path)]) == 2
    assert "holds no config.yaml" in capsys.readouterr().err


def test_the_built_program_is_that_of_its_source(tmp_path):
    if not (WEB / "node_modules" / ".bin" / "esbuild").is_file():
        pytest.skip("web/node_modules is not there; `npm ci` in web/ makes it")
    subprocess.run(["npm", "run", "-s", "check"], cwd=WEB, check=True, timeout=120)
    built = subprocess.run(
        ["npm", "run", "-s", "build", "--", f"--outdir={tmp_path}"], cwd=WEB, timeout=120, check=True
    )
    assert built.returncode == 0
    for page in "replay/page.js", "studio/page.js":
        assert (tmp_path / page).read_text() == (pages.PACKAGE / page).read_text(), "run `npm run build` in web/"


def test_a_browser_plays_it(content, tmp_path):
    if CHROMIUM is None or not (WEB / "node_modules" / "playwright-core").is_dir():
        pytest.skip("there is no Chromium, or web/node_modules is not there")
    (tmp_path / "page.html").write_text(replay.html(content), encoding="utf-8")
    words = ["node", "test/page.mjs", str(tmp_path / "page.html"), CHROMIUM]
    seen = json.loads(subprocess.run(words, cwd=WEB, check=True, capture_output=True, timeout=120).stdout)
    assert seen["errors"] == [] and len(seen["requests"]) == 1, "nothing but the page itself is loaded"
    assert (seen["linked"], seen["opened"], seen["stepped"]) == (2.0, 0.0, 1.0)
    assert seen["scrubbed"] == pytest.approx(seen["duration"] / 2, abs=0.3)
    assert "what its depth camera can see" in seen["legend"]
    assert "" in seen["named"] and any(re.match(r"obstacle, \d+\.\d × ", text) for text in seen["named"])
    assert any(re.match(r"person \d+: \d\.\d\d m/s|kuri: ", text) for text in seen["named"])
    assert 0.5 < seen["played"] < 3.0 and seen["frames"] > 5 and seen["drawn"] > 20


def test_players_of_a_comparison_share_one_clock(walked, content, tmp_path):
    """Play, pause, time and episode; and they go to 2 s before the robots part, here after 4 s."""
    if CHROMIUM is None or not (WEB / "node_modules" / "playwright-core").is_dir():
        pytest.skip("there is no Chromium, or web/node_modules is not there")
    scenario, frames = walked
    late = np.arange(60)[:, None] >= 40
    others = [each.replace(position=each.position + np.where(late, 0.6, 0.0)) for each in frames]
    shown = [replay.Episode(each, f"episode {k}") for k, each in enumerate(others)]
    contents = content, replay.of_scenario(scenario, shown, "other")
    players = [replay.element(each, f"r{k}", False, k == 1, True) for k, each in enumerate(contents)]
    page = pages.render(
        replay.TEMPLATE, title="", kicker="", players=[("", each) for each in players], instead="", script=""
    )
    (tmp_path / "page.html").write_text(page, encoding="utf-8")
    words = ["node", "test/compare.mjs", str(tmp_path / "page.html"), CHROMIUM]
    seen = json.loads(subprocess.run(words, cwd=WEB, check=True, capture_output=True, timeout=120).stdout)
    assert seen["errors"] == []
    for moment in "played", "sought", "parted", "opened":
        assert seen[moment][0] == pytest.approx(seen[moment][1], abs=0.2), moment
    assert 0.3 < seen["played"][0] and seen["sought"][0] == 3.0 and seen["opened"][0] == 0.0
    assert seen["parted"][0] == pytest.approx(2.0, abs=0.11)


def test_everybody_can_read_the_pages(content, tmp_path):
    """No serious finding of axe: contrast in light and dark, names of controls, keyboards."""
    if CHROMIUM is None or not (WEB / "node_modules" / "axe-core").is_dir():
        pytest.skip("there is no Chromium, or web/node_modules is not there")
    table = pages.table(["name", "value"], [["one", "1.0"]])
    (tmp_path / "page.html").write_text(replay.html(content), encoding="utf-8")
    report = pages.page("A report", "kicker", [pages.section("Table", table, replay.element(content))])
    (tmp_path / "report.html").write_text(report, encoding="utf-8")
    for name in "page.html", "report.html":
        words = ["node", "test/axe.mjs", (tmp_path / name).as_uri(), CHROMIUM]
        done = subprocess.run(words, cwd=WEB, check=True, capture_output=True, timeout=120)
        assert json.loads(done.stdout) == [], name


def test_a_notebook_shows_the_whole_page(walked, tmp_path):
    """Wide and narrow: the frame has the height of the page."""
    if CHROMIUM is None or not (WEB / "node_modules" / "playwright-core").is_dir():
        pytest.skip("there is no Chromium, or web/node_modules is not there")
    scenario, frames = walked
    (tmp_path / "cell.html").write_text(replay.view(frames[0], scenario)._repr_html_(), encoding="utf-8")
    words = ["node", "test/frame.mjs", str(tmp_path / "cell.html"), CHROMIUM]
    heights = json.loads(subprocess.run(words, cwd=WEB, check=True, capture_output=True, timeout=120).stdout)
    for frame, inside in heights:
        assert inside > 400 and abs(frame - inside) <= 2
