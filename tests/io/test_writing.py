"""Results are whole or not there, a folder has one writer at a time, and who was killed is not in the way."""

import os
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from sean_jax.core.errors import WriteError
from sean_jax.io import writing


def names(folder) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError(28, "No space left on device")])
def test_a_file_is_as_it_was_or_new(tmp_path, error):
    file = tmp_path / "results.json"
    writing.write(file, "old")
    with pytest.raises(type(error)), writing.atomic_file(file) as stream:
        stream.write(b"half of it")
        stream.flush()
        raise error
    assert file.read_text() == "old" and names(tmp_path) == ["results.json"]
    (tmp_path / ".results.json.new").write_text("what one who was killed left, and it is longer")
    writing.write(file, "new")
    assert file.read_text() == "new" and names(tmp_path) == ["results.json"]


def test_two_cannot_write_one_file_at_once(tmp_path):
    with writing.atomic_file(tmp_path / "a") as stream:
        stream.write(b"first")
        with pytest.raises(WriteError, match="is being written by another process"):
            writing.write(tmp_path / "a", "second")
    assert (tmp_path / "a").read_text() == "first" and names(tmp_path) == ["a"]


def test_a_held_folder_says_by_whom_and_vanishes_if_nothing_was_written(tmp_path):
    folder = tmp_path / "deep" / "run"
    with writing.folder_lock(folder):
        for refused in (writing.folder_lock(folder), writing.folder_lock(tmp_path / "deep" / ".." / "deep" / "run")):
            with pytest.raises(WriteError, match=r"run is being written by process \d+ on \S+ since 20\d\d-"), refused:
                pass
        assert names(tmp_path) == ["deep", "deep/run", "deep/run/.lock"] and writing.contents(folder) == []
    assert names(tmp_path) == []
    with pytest.raises(KeyboardInterrupt), writing.folder_lock(folder):
        (folder / "kept").write_text("1")
        raise KeyboardInterrupt
    assert names(folder) == ["kept"]


def test_what_cannot_be_a_folder_is_refused(tmp_path):
    (tmp_path / "file").write_text("kept")
    for place, said in (("file", "is a file"), ("file/run", "cannot write"), ("a" * 300, "cannot write")):
        with pytest.raises(WriteError, match=said), writing.folder_lock(tmp_path / place):
            pass
    assert names(tmp_path) == ["file"]


HOLD = """
import sys, time
from pathlib import Path
from sean_jax.io import writing
folder = Path(sys.argv[1])
with getattr(writing, sys.argv[2])(folder) as made:
    if made:
        (made / "half").write_text("of it")
    print("held", flush=True)
    time.sleep(600)
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system has no SIGKILL")
@pytest.mark.parametrize("way", ["folder_lock", "atomic_folder"])
def test_a_killed_process_holds_nothing_and_leaves_nothing_after_the_next_start(tmp_path, way):
    folder = tmp_path / "run"
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(folder), way], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "held\n"
    with (
        pytest.raises(WriteError, match=f"is being written by process {process.pid} on "),
        getattr(writing, way)(folder),
    ):
        pass
    process.kill()
    process.wait()
    assert names(tmp_path), "a kill leaves something"
    with getattr(writing, way)(folder) as made:
        assert made is None or names(made) == []
    assert names(tmp_path) == ([] if way == "folder_lock" else ["run"])


def test_never_two_at_once_although_the_lock_comes_and_goes(tmp_path):
    """Threads as well as processes: the lock belongs to the open file, and the file is removed each time."""
    folder, inside, most, turns = tmp_path / "run", [], [], []

    def work() -> None:
        for _ in range(150):
            try:
                with writing.folder_lock(folder):
                    inside.append(1)
                    most.append(len(inside))
                    inside.pop()
                turns.append(1)
            except WriteError:
                pass

    with ThreadPoolExecutor(6) as pool:
        for each in [pool.submit(work) for _ in range(6)]:
            each.result()
    assert max(most) == 1 and len(turns) >= 6 and names(tmp_path) in ([], ["run"])


def test_a_whole_folder_appears_whole_or_not_at_all(tmp_path):
    with writing.atomic_folder(tmp_path / "deep" / "run") as folder:
        (folder / "a").write_text("1")
        assert not (tmp_path / "deep" / "run").exists()
        with pytest.raises(WriteError, match="is being written by process"):
            with writing.atomic_folder(tmp_path / "deep" / "run"):
                pass
    assert names(tmp_path) == ["deep", "deep/run", "deep/run/a"]
    with pytest.raises(WriteError, match="is not empty"), writing.atomic_folder(tmp_path / "deep" / "run"):
        pass
    with pytest.raises(KeyboardInterrupt), writing.atomic_folder(tmp_path / "other" / "run") as folder:
        (folder / "a").write_text("1")
        raise KeyboardInterrupt
    assert names(tmp_path) == ["deep", "deep/run", "deep/run/a"]


def test_what_a_killed_writer_left_in_the_folder_is_in_nobodys_way(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    for name in (writing.LOCK, ".summary.json.new"):
        (folder / name).write_text("process 1 on a machine that is no more")
    with writing.atomic_folder(folder) as made:
        (made / "a").write_text("1")
    assert names(tmp_path) == ["run", "run/a"]
    (tmp_path / "other").mkdir()
    with writing.folder_lock(tmp_path / "other"):  # told before the work, not after it
        with pytest.raises(WriteError, match="other is being written by process"):
            with writing.atomic_folder(tmp_path / "other"):
                raise AssertionError


@pytest.mark.skipif(writing.fcntl is None, reason="this system locks no folders")
def test_who_looks_disturbs_nobody(tmp_path):
    lock = tmp_path / writing.LOCK
    lock.touch()
    with lock.open("rb") as look:
        writing.fcntl.flock(look, writing.fcntl.LOCK_SH)
        timer = threading.Timer(0.02, lambda: writing.fcntl.flock(look, writing.fcntl.LOCK_UN))
        timer.start()
        with writing.folder_lock(tmp_path):
            assert writing.is_locked(tmp_path)
        timer.join()
    assert not writing.is_locked(tmp_path)


def test_a_lock_that_cannot_be_read_is_nobodys(tmp_path, monkeypatch):
    def refused(*arguments):
        raise PermissionError(13, "Permission denied")

    (tmp_path / writing.LOCK).touch()
    monkeypatch.setattr(writing.os, "open", refused)
    assert not writing.is_locked(tmp_path)


def put_link(place, target, kind):
    """Something at a place through which the target, or nothing at all, would be written."""
    if kind == "pipe":
        os.mkfifo(place)
    else:
        (place.symlink_to if kind == "symbolic" else place.hardlink_to)(target)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes with names")
@pytest.mark.parametrize("kind", ["symbolic", "hard", "pipe"])
@pytest.mark.parametrize("name", [".a.new", ".lock"])
def test_nothing_is_written_through_a_link_that_lies_at_a_temporary_name(tmp_path, kind, name):
    target, work = tmp_path / "target", tmp_path / "work"
    target.write_text("precious")
    work.mkdir()
    put_link(work / name, target, kind)
    with pytest.raises(WriteError, match=rf"work/\{name} is a link or no regular file, .*; remove it\.$"):
        if name == ".lock":
            with writing.folder_lock(work):
                raise AssertionError
        writing.write(work / "a", "new")
    assert target.read_text() == "precious" and names(work) == [name] and not writing.is_locked(work)


def test_a_half_written_folder_that_is_a_link_is_not_written_through(tmp_path):
    (tmp_path / "target" / "whole").mkdir(parents=True)
    (tmp_path / "target" / "whole" / "precious").touch()
    (tmp_path / ".run.unfinished").symlink_to(tmp_path / "target")
    with pytest.raises(WriteError, match="run.unfinished is a link"), writing.atomic_folder(tmp_path / "run"):
        raise AssertionError
    assert names(tmp_path / "target") == ["whole", "whole/precious"]


@pytest.mark.parametrize("there", [True, False])
@pytest.mark.parametrize("way", ["folder_lock", "atomic_folder"])
def test_a_link_to_a_folder_stands_for_that_folder(tmp_path, way, there):
    """An empty one, or one that is yet to be made: the link stays, and what it leads to is written."""
    target, link = tmp_path / "elsewhere" / "real", tmp_path / "link"
    target.parent.mkdir()
    if there:
        target.mkdir()
    link.symlink_to(target)
    with getattr(writing, way)(link) as made:
        ((made or link) / "a").write_text("1")
    assert link.is_symlink() and names(target) == ["a"] and names(tmp_path) == ["elsewhere", "elsewhere/real",
                                                                               "elsewhere/real/a", "link"]  # fmt: skip


def test_a_mount_point_is_refused_before_the_work(tmp_path, monkeypatch):
    monkeypatch.setattr(os.path, "ismount", lambda path: str(path) == str(tmp_path / "disk"))
    with pytest.raises(WriteError, match="is a mount point"), writing.atomic_folder(tmp_path / "disk"):
        raise AssertionError
    with writing.atomic_folder(tmp_path / "disk" / "run") as made:
        (made / "a").touch()


@pytest.mark.parametrize(
    ("content", "said"),
    [(b"\xff\xfe\x00 me", "me"), (b"", "another process"), (b"\x1b[2J", "[2J"), (b"a\n" * 9000, "a a a")],
)
def test_the_holder_of_a_lock_is_a_line_whatever_it_wrote(tmp_path, content, said):
    (tmp_path / ".lock").write_bytes(content)
    found = writing._holder(tmp_path / ".lock")
    assert said in found and found.isprintable() and len(found) <= writing.MAX_HOLDER
