"""Files and directories are written as a whole, or not at all."""

import os

import pytest

from hamsym.support.atomic import create_atomically, write_atomically


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
