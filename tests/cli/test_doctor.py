"""``sean doctor`` says what is wrong, with a cure, and nothing where all is well."""

import shutil

import pytest

from sean_jax.cli import command_line, doctor
from sean_jax.io import cache


def by_name() -> dict[str, doctor.Finding]:
    return {finding.what: finding for finding in doctor.examine()}


def test_it_tells_versions_devices_and_folders(capsys):
    found = by_name()
    assert {"python", "jax", "numpy", "extras", "devices", "cores", "free disk", "cache"} <= set(found)
    assert "cpu" in found["devices"].value
    assert command_line.main(["doctor"]) == 0
    said = capsys.readouterr().out
    assert "jaxlib" in said and "free disk" in said


@pytest.mark.parametrize("asked", ["", "cpu"])
def test_a_gpu_that_jax_does_not_use_is_told(monkeypatch, tmp_path, asked):
    (tmp_path / "version").write_text("NVRM")
    monkeypatch.setattr(doctor, "NVIDIA", tmp_path / "version")
    monkeypatch.setenv("JAX_PLATFORMS", asked)
    cure = by_name()["devices"].cure
    assert ("unset it" if asked else "sean_jax[cuda13]") in cure
    monkeypatch.setattr(doctor, "NVIDIA", tmp_path / "nothing")
    monkeypatch.setattr(shutil, "which", lambda name: None)
    assert by_name()["devices"].cure == ""


def test_a_cache_that_cannot_be_written_is_told(monkeypatch, tmp_path):
    monkeypatch.setattr(cache, "folder", lambda: tmp_path / "cache")
    assert "empty" in by_name()["cache"].value and not by_name()["cache"].cure
    (tmp_path / "cache" / "xla").mkdir(parents=True)
    (tmp_path / "cache" / "xla" / "program").write_bytes(b"0" * 2_000_000)
    assert "1 compiled programs, 2 MB" in by_name()["cache"].value
    monkeypatch.setattr(doctor.os, "access", lambda *_: False)
    assert "XDG_CACHE_HOME" in by_name()["cache"].cure


def test_little_memory_or_disk_is_told(monkeypatch):
    monkeypatch.setattr(doctor, "_memory", lambda: 1.5)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(10**12, 10**12, 10**8))
    found = by_name()
    assert "close other programs" in found["free memory"].cure and "--out" in found["free disk"].cure
    monkeypatch.setattr(doctor, "_memory", lambda: None)
    assert "free memory" not in by_name()


def test_extras_that_are_missing_are_named(monkeypatch):
    monkeypatch.setattr(doctor.importlib.util, "find_spec", lambda name: None)
    assert by_name()["extras"].value.startswith("none; without learning, lerobot")
