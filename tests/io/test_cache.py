"""Tables on disk: found by content in any process, made anew when anything they depend on or their file is wrong."""

import os
import shutil
import time
from collections import Counter
from typing import Any

import jax
import numpy as np
import pytest

import sean_jax
from sean_jax.graph.annotation import PERSON
from sean_jax.io import cache
from sean_jax.people import handcrafted
from sean_jax.people.behaviors import Place, random_behavior, starts
from sean_jax.world import environment, navigation
from sean_jax.world.navigation import tables
from support.commands import python
from support.scenes import BENCH, box, room


@pytest.fixture
def made(tmp_path, monkeypatch):
    """How often each kind of table was made, with an empty cache folder; ``made.forget()`` is a new process."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(cache, "_recent", type(cache._recent)())
    counts: Any = Counter()
    kept = cache.load_or_build

    def counted(kind, code, inputs, make):
        def one():
            counts[kind] += 1
            return make()

        return kept(kind, code, inputs, one)

    monkeypatch.setattr(cache, "load_or_build", counted)
    counts.forget = cache._recent.clear
    return counts


@pytest.fixture
def hall(tmp_path):
    return write(tmp_path / "hall", 0.0)


def write(folder, x):
    """A hall with a box at x."""
    return room(folder, (-6, -5, 6, 5), [box((x, 0), (0.5, 2))], 2, graph=BENCH)


def numbers(count):
    """A table of so many numbers, and what makes it."""
    return lambda: {"numbers": np.arange(count, dtype=np.float32), "flags": np.arange(count) % 3 == 0}


def same(one, other):
    assert sorted(one) == sorted(other)
    for name, value in one.items():
        assert other[name].dtype == value.dtype
        np.testing.assert_array_equal(other[name], value)


def test_paths_follow_the_scene_and_a_second_process_makes_nothing(made, hall):
    """An edited scene.xml changes obstacles and paths together; all that is there twice is made once."""
    make = lambda: sean_jax.make(hall, behavior="random", task="random_ab_nav", dynamics="twin")  # noqa: E731
    before = make()
    first = dict(made)
    assert set(first) == {"navigation", "goals"} and set(first.values()) == {1}
    made.forget()
    again = make()
    assert dict(made) == first
    for one, other in zip(jax.tree.leaves(before), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(other, one)
        assert other.dtype == one.dtype and other.weak_type == one.weak_type
    write(hall, 1.0)
    moved = make()
    assert all(made[kind] == 2 for kind in first)
    np.testing.assert_allclose(moved.navigation.obstacles.center[0], [1.0, 0.0])
    gap = np.asarray(moved.navigation.arcs.corner)[:, 0] - np.asarray(before.navigation.arcs.corner)[:, 0]
    np.testing.assert_allclose(gap, 1.0, atol=1e-6)
    fresh = tables._make(moved.environment, 0.25, None)
    np.testing.assert_array_equal(moved.navigation.visible.on_host(), fresh["visible"])
    write(hall, 0.0)
    make()
    assert all(made[kind] == 2 for kind in first)


def test_everything_that_tables_depend_on_tells_them_apart(made, hall):
    place: Any = environment.load(hall)
    wider = place.replace(floor=place.floor + np.asarray([-1, 0, 0, 0], np.float32))
    each: list[Any] = [(place, 0.25), (place, 0.3), (place, 0.25, 0.5), (wider, 0.25)]
    for number, arguments in enumerate(each, 1):
        for _ in range(2):
            navigation.build(*arguments)
            assert made["navigation"] == number
    cache.load_or_build("navigation", ("world/navigation",), [1.0], numbers(3))  # other code
    cache.load_or_build("navigation", ("core/geometry",), [1.0], numbers(3))
    assert made["navigation"] == number + 2
    one, two = np.zeros((2, 1)), np.zeros((1, 2))  # the same bytes in another shape
    cache.load_or_build("shape", (), [one], numbers(1))
    cache.load_or_build("shape", (), [two], numbers(2))
    cache.load_or_build("shape", (), [one.astype(np.float32)], numbers(3))  # the same in single precision
    assert made["shape"] == 2


@pytest.mark.parametrize("damage", ["truncated", "emptied", "flipped", "text", "swapped", "folder", "pickled"])
def test_a_damaged_file_is_made_anew(made, damage):
    """Whatever is in its place: truncated at any length, with any byte changed, another table, an object."""
    told = cache.load_or_build("numbers", (), [0.0], numbers(50))
    (file,) = (cache.folder() / "tables").iterdir()
    whole, generator = file.read_bytes(), np.random.default_rng(1)
    for _ in range(1 if damage in ("emptied", "text", "swapped", "folder", "pickled") else 25):
        where = int(generator.integers(1, len(whole)))
        if damage == "swapped":
            cache.load_or_build("numbers", (), [1.0], numbers(7))
            other = next(path for path in file.parent.iterdir() if path != file)
            shutil.copy(other, file)
        elif damage == "folder":
            file.unlink()
            file.mkdir()
        elif damage == "pickled":
            with file.open("wb") as stream:
                np.savez(stream, name=np.array(file.stem), numbers=np.array([object()]))
        else:
            flipped = whole[:where] + bytes([whole[where] ^ 0xFF]) + whole[where + 1 :]
            file.write_bytes({"truncated": whole[:where], "emptied": b"", "text": b"x", "flipped": flipped}[damage])
        made.forget()
        same(told, cache.load_or_build("numbers", (), [0.0], numbers(50)))
        assert not list(file.parent.glob("*.unfinished"))
    made.forget()
    if damage != "folder":
        file.touch()
        before = made["numbers"]
        same(told, cache.load_or_build("numbers", (), [0.0], numbers(50)))
        assert made["numbers"] == before


def test_no_folder_and_no_room_are_done_without(made, monkeypatch, tmp_path):
    """The cache is a file, its folder may not be written, or the disk is full: tables are there all the same."""
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    same(cache.load_or_build("a", (), [0.0], numbers(5)), numbers(5)())
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "full"))

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full)
    same(cache.load_or_build("b", (), [0.0], numbers(5)), numbers(5)())
    assert not list((tmp_path / "full").rglob("*.npz")) and not list((tmp_path / "full").rglob("*.unfinished"))
    same(cache.load_or_build("b", (), [0.0], numbers(6)), numbers(5)())  # remembered in this process
    assert made["b"] == 1


def test_the_oldest_are_removed(made, monkeypatch):
    """By number and by bytes, least recently used first; what somebody left unfinished long ago as well."""
    monkeypatch.setattr(cache, "MAX_FILES", 3)
    monkeypatch.setattr(cache, "WRITES", 1)
    old = time.time() - 10 * cache.ABANDONED_AFTER
    for number in range(3):
        cache.load_or_build("numbers", (), [number], numbers(50))
        (file,) = [path for path in (cache.folder() / "tables").iterdir() if path.stat().st_mtime > old + 20]
        os.utime(file, (old + number, old + number))
    left = file.parent / ".x.unfinished"
    left.write_text("")
    os.utime(left, (old, old))
    made.forget()
    cache.load_or_build("numbers", (), [0], numbers(50))  # used again, so it is no longer the oldest
    assert made["numbers"] == 3
    cache.load_or_build("numbers", (), [3], numbers(50))
    assert len(list(file.parent.iterdir())) == 3
    made.forget()
    for number, count in ((0, 4), (2, 4), (3, 4), (1, 5)):
        cache.load_or_build("numbers", (), [number], numbers(50))
        assert made["numbers"] == count
    monkeypatch.setattr(cache, "MAX_SIZE", 1)
    cache.load_or_build("numbers", (), [9], numbers(50))
    assert not list(file.parent.iterdir())


@pytest.mark.night
def test_another_process_reads_what_this_one_made(made, hall):
    """And gets the same scenario; in double precision as well, whose tables are its own."""
    program = """
import sys
import jax, sean_jax
from sean_jax.io import cache; from sean_jax.world import navigation
def refuse(*_): raise AssertionError("made again")
if sys.argv[2] == "reads":
    navigation.tables._make = navigation.next_corner_table._make = refuse
scenario = sean_jax.make(sys.argv[1], behavior="graph", task="random_ab_nav", dynamics="twin")
print(int(scenario.navigation.visible.values.sum()))
"""
    scenario = sean_jax.make(hall, behavior="graph", task="random_ab_nav", dynamics="twin")
    for wide, does in (("false", "reads"), ("true", "makes"), ("true", "reads")):
        said = python("-c", program, hall, does, env={"JAX_ENABLE_X64": wide})
        assert int(said.split()[-1]) == int(scenario.navigation.visible.values.sum())


def test_tables_depend_on_the_code_that_makes_them(made, hall, monkeypatch):
    """Also on the file that holds the function, which is not always among those that it calls."""
    codes = {}
    kept = cache.load_or_build

    def watched(kind, code, inputs, make):
        codes[kind] = code
        return kept(kind, code, inputs, make)

    monkeypatch.setattr(cache, "load_or_build", watched)
    place = environment.load(hall)
    way = navigation.build(place, 0.25)
    random_behavior.build(Place(hall, place, way), 2)
    monkeypatch.setattr(starts, "_reachable", lambda _, spots: np.zeros(len(spots), bool))
    starts.anywhere(place, way, 2, dense=True)
    assert "people/behaviors/random_behavior" in codes["goals"] and "people/behaviors/starts" in codes["reached"]


def test_ways_of_walkers_depend_on_the_room_that_a_person_needs(made, monkeypatch):
    """That number is not among the inputs, and stands in another file."""
    codes = {}

    def build(kind, code, inputs, make):
        codes.setdefault(kind, code)
        return make()

    monkeypatch.setattr(cache, "load_or_build", build)
    handcrafted.read_sets(environment.ENVS / "lab", environment.load("lab"))
    assert "graph/annotation" in codes["legs"] and handcrafted.annotation.PERSON is PERSON
