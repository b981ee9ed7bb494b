"""Temporary files of killed writers are removed by the next writer, and no others."""

import os
import subprocess
import sys
import uuid

import pytest

from hamsym.support import atomic
from hamsym.support.atomic import create_atomically, temporary_name, write_atomically


@pytest.fixture
def dead():
    """The number of a process that has ended."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


@pytest.fixture(autouse=True)
def _forgotten():
    atomic.remove_leftovers.cache_clear()


def named(process):
    return f".hamsym-{atomic._machine()}-{process}-{uuid.uuid4().hex}"


def test_leftovers_of_dead_writers_are_removed(tmp_path, dead):
    (tmp_path / named(dead)).write_bytes(b"half")
    (tmp_path / named(dead)).mkdir()
    (tmp_path / named(dead) / "inner").mkdir(parents=True)
    write_atomically(tmp_path / "file", b"whole")
    assert os.listdir(tmp_path) == ["file"]


def test_files_of_others_are_kept(tmp_path, dead):
    other_machine = f".hamsym-{'0' * 12}-{dead}-{uuid.uuid4().hex}"
    names = [named(os.getpid()), other_machine, ".hamsym-abcdefgh", named(dead) + ".txt", "a"]
    for name in names:
        (tmp_path / name).write_bytes(b"")
    write_atomically(tmp_path / "file", b"whole")
    assert sorted(os.listdir(tmp_path)) == sorted([*names, "file"])


def test_link_of_a_dead_writer_does_not_reach_its_target(tmp_path, dead):
    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "file").write_bytes(b"")
    place = tmp_path / "place"
    place.mkdir()
    (place / named(dead)).symlink_to(kept)
    atomic.remove_leftovers(place)
    assert os.listdir(place) == []
    assert os.listdir(kept) == ["file"]


def test_failed_writes_leave_nothing(tmp_path):
    def fails(aside):
        aside.mkdir()
        (aside / "half").write_bytes(b"")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        create_atomically(tmp_path / "store", fails)
    with pytest.raises(TypeError):
        write_atomically(tmp_path / "file", "text")
    assert os.listdir(tmp_path) == []


def test_names_of_this_process_differ(tmp_path):
    assert temporary_name() != temporary_name()
    assert atomic._NAME.fullmatch(temporary_name())["process"] == str(os.getpid())
