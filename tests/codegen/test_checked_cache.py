"""Compiled code runs only if its digest belongs to the text that is run."""

import pickle
import stat
from pathlib import Path

import pytest

from hamsym.codegen import checked_cache, numba_cache

_TEXT = """
from numba import njit

@njit(error_model="numpy", cache=True)
def value(x):
    return x + {number}
"""


@pytest.fixture
def folder(monkeypatch, tmp_path):
    monkeypatch.setenv("HAMSYM_CACHE_DIR", str(tmp_path))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "elsewhere"))
    numba_cache.cache_directory.cache_clear()
    yield tmp_path
    monkeypatch.undo()
    numba_cache.cache_directory.cache_clear()


def loaded(number: int) -> tuple[float, bool]:
    """The value at 1, and whether its code came from the cache."""
    text = _TEXT.format(number=number)
    module = checked_cache.load_compiled(text, "checked")
    return module.value(1), bool(module.value.stats.cache_hits)


def files(folder: Path) -> list[Path]:
    return sorted((folder / "__pycache__").iterdir())


def test_code_is_loaded_from_a_private_folder(folder):
    assert loaded(2) == (3, False)
    assert loaded(2) == (3, True)
    assert loaded(4) == (5, False)
    assert len(files(folder)) == 2
    assert stat.S_IMODE((folder / "__pycache__").stat().st_mode) == 0o700
    assert not [*(folder / "elsewhere").rglob("*.nb?")]


@pytest.mark.parametrize("damage", ["one bit", "cut", "empty"])
def test_damaged_code_is_compiled_again(folder, damage):
    loaded(2)
    (file,) = files(folder)
    content = file.read_bytes()
    middle = len(content) // 2
    flipped = content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]
    file.write_bytes({"one bit": flipped, "cut": content[:middle], "empty": b""}[damage])
    assert loaded(2) == (3, False)
    assert loaded(2) == (3, True)


def test_code_of_another_text_is_refused(folder):
    loaded(2)
    (own,) = files(folder)
    content = own.read_bytes()
    loaded(40)
    (other,) = [file for file in files(folder) if file != own]
    other.write_bytes(content)
    assert loaded(40) == (41, False)


class _Planted:
    def __reduce__(self):
        return pytest.fail, ("a planted pickle was loaded",)


def test_planted_pickle_is_not_read(folder):
    loaded(2)
    (file,) = files(folder)
    file.write_bytes(bytes(32) + pickle.dumps(_Planted()))
    assert loaded(2) == (3, False)


def test_code_of_other_versions_is_refused(folder, monkeypatch):
    from hamsym.codegen import checked_cache

    loaded(2)
    monkeypatch.setattr(checked_cache, "_VERSIONS", ("another version",))
    assert loaded(2) == (3, False)
