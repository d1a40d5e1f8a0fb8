"""Generated floors: the same for a seed, free for robots between all nodes, ordinary environments once written."""

import contextlib
import functools
import itertools
import os
import random
import subprocess
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components

import sean_jax
from sean_jax.cli import command_line
from sean_jax.core.data_types import PATTERNS
from sean_jax.core.errors import InputError
from sean_jax.graph import annotation
from sean_jax.policies import go_to_goal
from sean_jax.world import environment as environments
from sean_jax.world import generated, navigation
from sean_jax.world.generated import floor_families
from sean_jax.world.generated.floor_families import GAP, TOUCH
from support.quick import slow

QUICK = ("passages", 0), ("square", 3)
SLOW = [(family, 0) for family in generated.FAMILIES]
OTHERS = [case for case in itertools.product(generated.FAMILIES, range(5)) if case not in QUICK]
CASES = [*QUICK, *slow(OTHERS, *SLOW)]


@pytest.mark.parametrize(("family", "seed"), CASES)
def test_robots_and_people_reach_all_nodes(family, seed, tmp_path):
    """By the tables of shortest paths, for a robot of 0.38 m; the files pass all checks and give the same floor."""
    world = generated.generate(family, seed)
    environment = world.environment
    nodes = jnp.asarray([node.position for node in world.graph.nodes.values()], float)
    tables = navigation.build(environment, 0.38)
    waypoints = np.array([node.kind == "waypoint" for node in world.graph.nodes.values()])

    @jax.jit
    @functools.partial(jax.vmap, in_axes=(None, 0))
    def lengths(tables, goal):
        to_goal = navigation.build_paths_to_goal(tables, goal)
        return jax.vmap(lambda start: navigation.geodesic_approx(tables, start, goal, to_goal))(nodes)

    roomy = np.minimum(*environments.signed_distances_on_host(environment, np.asarray(nodes))) >= 0.4
    assert roomy[~waypoints].all() and roomy.sum() > 3
    assert np.isfinite(np.asarray(lengths(tables, nodes))[np.ix_(roomy, roomy)]).all()

    generated.save(world, tmp_path / "world")
    read = environments.load(tmp_path / "world")
    np.testing.assert_allclose(read.obstacles.center, environment.obstacles.center, atol=1e-5)
    np.testing.assert_allclose(read.obstacles.height, environment.obstacles.height, atol=1e-5)
    graph = annotation.read_graph(tmp_path / "world" / "graph.yaml", read)
    assert graph.names == tuple(world.graph.nodes) and len(graph.groups)
    assert environments.default_people(tmp_path / "world") == world.settings.people > 2


@pytest.mark.parametrize("family", ["lobby", "office", "rooms", "square"])
def test_gaps_between_things_are_doors_or_nothing(family):
    """Between pieces of boxes that touch each other; these boxes lie along x or y."""
    for seed in range(4):
        boxes = generated.generate(family, seed).boxes
        reach = np.where(np.abs(np.sin(boxes[:, 4:5])) > 0.5, boxes[:, 3:1:-1], boxes[:, 2:4])
        apart = np.abs(boxes[:, None, :2] - boxes[None, :, :2]) - reach[:, None] - reach[None]
        gap = np.linalg.norm(np.maximum(apart, 0.0), axis=-1)
        _, piece = connected_components(gap <= TOUCH + 1e-9)
        assert (gap[piece[:, None] != piece[None]] >= GAP - 1e-9).all()


def test_a_seed_is_a_floor_and_words_are_kept():
    one, same, other = (generated.generate("passages", seed) for seed in (7, 7, 8))
    np.testing.assert_array_equal(one.boxes, same.boxes)
    assert one.graph == same.graph and one.words == same.words
    assert one.boxes.shape != other.boxes.shape or not np.allclose(one.boxes, other.boxes)
    world = generated.generate("passages", 3, {"width": 15.0, "door": (1.2, 1.3), "furniture": 0.0})
    assert world.settings.floor[2] == 15.0 and 1.2 <= world.words["door"] <= 1.3


@pytest.mark.parametrize(
    ("family", "words", "sentence"),
    [
        ("room", {}, "'room' is not one of rooms, office"),
        ("rooms", {"doors": 1.2}, "rooms has no word 'doors'; its words are width, depth, corridor, door"),
        ("rooms", {"door": (1.4, 1.0)}, "door"),
        ("passages", {"door": 0.5}, "none of [0-9]+ floors of passages"),
        ("rooms", {"depth": 1e300}, r"depth: 1e\+300 must be from 4 to 100"),
        ("rooms", {"width": float("inf")}, "width: inf must be from 4 to 100"),
        ("rooms", {"width": float("nan")}, "width: nan must be from 4 to 100"),
        ("rooms", {"width": 100, "depth": 100}, "width 100 by depth 100 m are 10,000 m2, and at most 1,000 are made"),
        ("rooms", {"room": 1e-6}, "room: 1e-06 must be from 2 to 50"),
        ("rooms", {"corridor": 20, "depth": 5}, "none of 50 floors of rooms"),
        ("lobby", {"furniture": 1e6}, "furniture: 1000000.0 must be from 0 to 0.5"),
        ("clutter", {"density": 50}, "density: 50 must be from 0 to 0.5"),
    ],
)
def test_mistakes_are_one_sentence(family, words, sentence):
    with pytest.raises(InputError, match=sentence):
        generated.generate(family, 0, words)


def test_large_floors_are_drawn_less_often(monkeypatch):
    """The search for a graph takes seconds where hundreds of things stand, so that 50 draws would take minutes."""
    drawn = []
    monkeypatch.setattr(generated, "_world", lambda *given: drawn.append(len(given[3].things)))
    with pytest.raises(InputError, match="none of 3 floors of aisles"):
        generated.generate("aisles", 0, {"width": 31.6, "depth": 31.6, "aisle": 1.2, "cross": 1.1, "shelf": 1.0})
    assert len(drawn) == 3 and max(drawn) <= floor_families.MAX_THINGS
    with pytest.raises(InputError, match="none of 50 floors of office .* has at most 300 things"):
        generated.generate("office", 0, {"width": 10, "depth": 100, "aisle": 0.5, "desks": 1})
    assert len(drawn) == 3


def random_words(chance, family):
    """Words within their limits, often at one of them, and no larger floor than is made."""
    words = {}
    for word in (*generated.SIZE, *generated.FAMILIES[family][1]):
        least, most = floor_families.LIMITS[word]
        if chance.random() < 0.8:
            words[word] = chance.choice((least, most, chance.uniform(least, most)))
    whole = {word: words.get(word, most) for word, (_, most) in generated.SIZE.items()}
    too_large = whole["width"] * whole["depth"] / floor_families.MAX_AREA
    if too_large > 1:
        least, most = floor_families.LIMITS["width"]
        words |= {word: min(most, max(least, value * 0.99 / too_large**0.5)) for word, value in whole.items()}
    return words


@pytest.mark.night
@pytest.mark.parametrize("seed", range(8))
def test_any_words_end_within_seconds(seed):
    """In a floor, or in one sentence; the first floor, with which programs are compiled, does not count."""
    chance = random.Random(seed)
    generated.generate("rooms", 0)
    for _ in range(40):
        family = chance.choice(list(generated.FAMILIES))
        words, begin = random_words(chance, family), time.process_time()
        with contextlib.suppress(InputError):
            generated.generate(family, seed, words)
        assert time.process_time() - begin < 20, (family, words)


def test_each_word_has_limits_around_its_range():
    for word, (low, high) in {
        **generated.SIZE,
        **{k: v for _, words in generated.FAMILIES.values() for k, v in words.items()},
    }.items():
        assert generated.LIMITS[word][0] <= low <= high <= generated.LIMITS[word][1], word


def test_the_command_writes_environments_and_a_picture(tmp_path, capsys):
    arguments = ["worlds", "square", "--number", "2", "--seed", "5", "--out", str(tmp_path / "floors")]
    assert command_line.main([*arguments, "--words", "stalls=2:3,width=14"]) == 0
    assert "square_5" in capsys.readouterr().out
    assert sorted(path.name for path in (tmp_path / "floors").iterdir()) == ["floors.png", "square_5", "square_6"]
    assert environments.floor(tmp_path / "floors" / "square_6")[2] == 14.0
    assert command_line.main([*arguments[:-1], str(tmp_path / "no"), "--words", "stalls"]) == 2
    assert "'stalls' is no word with a number" in capsys.readouterr().err and not (tmp_path / "no").exists()


@pytest.mark.slow
def test_two_processes_make_the_same_set(tmp_path):
    """Both have it, whichever was first, and nothing else remains."""
    code = (
        "import sys, time; from sean_jax.world import generated;"
        " time.sleep(max(0, float(sys.argv[1]) - time.time()));"
        " print(*generated.find('worlds:passages,clutter:4:20'))"
    )
    variables = {**os.environ, "XDG_CACHE_HOME": str(tmp_path), "JAX_PLATFORMS": "cpu"}
    command = [sys.executable, "-c", code, str(time.time() + 6.0)]
    both = [subprocess.Popen(command, env=variables, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    said = [process.communicate(timeout=300)[0].split() for process in both]
    assert [process.returncode for process in both] == [0, 0] and said[0] == said[1] and len(said[0]) == 4
    assert sorted(Path(said[0][0]).parent.iterdir()) == sorted(map(Path, said[0]))
    for folder in said[0]:
        assert sorted(path.name for path in Path(folder).iterdir()) == ["environment.yaml", "graph.yaml", "scene.xml"]


def test_a_floor_of_another_process_is_kept(tmp_path, monkeypatch):
    """It was made between the look for it and the end of writing."""
    world = generated.generate("square", 3)

    def generate(*_):
        (tmp_path / "square_3").mkdir()
        (tmp_path / "square_3" / "first").touch()
        return world

    monkeypatch.setattr(generated, "generate", generate)
    generated.save_all(str(tmp_path / "square_3"))
    assert [path.name for path in tmp_path.rglob("*")] == ["square_3", "first"]


@pytest.mark.night
def test_people_and_a_robot_walk_there(tmp_path):
    generated.save(generated.generate("rooms", 2), tmp_path / "rooms")
    scenario = sean_jax.make(str(tmp_path / "rooms"), task="join_group", dynamics="twin")
    last, frames = jax.jit(lambda key: sean_jax.rollout(scenario, go_to_goal, key, 300))(jax.random.key(0))
    assert np.isfinite(np.asarray(frames.people)).all() and bool(last.completed | (last.tick == 300))
    moved = np.linalg.norm(np.asarray(frames.people)[-1] - np.asarray(frames.people)[0], axis=-1)
    assert np.median(moved) > 1.0


@pytest.mark.parametrize(("family", "ceiling"), [("aisles", floor_families.WALL_HEIGHT), ("square", 0.0)])
def test_pictures_of_a_written_world_have_its_ceiling_and_shelves(tmp_path, family, ceiling):
    world = generated.generate(family, 3)
    generated.save(world, tmp_path / "place")
    looks = environments.load(tmp_path / "place").scenery
    assert float(looks.ceiling) == ceiling
    patterns = [PATTERNS[int(number)] for number in np.asarray(looks.solids.color)[:, 3]]
    tall = np.isclose(world.boxes[:, 5], floor_families.SHELF) & np.isclose(world.colors, floor_families.METAL).all(1)
    np.testing.assert_array_equal([name == "shelf" for name in patterns], tall)
    assert tall.any() == (family == "aisles")


@pytest.mark.parametrize("text", ["width=16,width=17", "width=16,depth=9, width =16"])
def test_a_word_that_is_given_twice_is_refused(text):
    with pytest.raises(InputError, match="words: 'width' is there twice; give it once"):
        generated.parse(text)


@pytest.mark.parametrize("text", ["a" * 20_000, f"{'b' * 20_000}=1", f"{'c' * 20_000}=1,{'c' * 20_000}=2"])
def test_a_sentence_on_words_is_short(text):
    with pytest.raises(InputError) as told:
        generated.generate("rooms", 0, generated.parse(text))
    assert len(str(told.value)) < 300
