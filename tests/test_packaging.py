"""The installed package carries what it needs."""

from __future__ import annotations

import importlib.resources
import tomllib
from importlib.metadata import distribution
from pathlib import Path

import pytest

import hamsym
from hamsym.codegen.backends import BACKENDS
from hamsym.kernel.library import kernel_library


def test_templates_are_package_data() -> None:
    folder = importlib.resources.files("hamsym.templates")
    for name, backend in BACKENDS.items():
        assert folder.joinpath(f"{name}.{backend.extension}.jinja").is_file()


def test_every_package_and_data_file_is_installed() -> None:
    root = Path(hamsym.__file__).parent
    project = Path(__file__).parents[1] / "pyproject.toml"
    settings = tomllib.loads(project.read_text(encoding="utf-8"))
    tools = settings["tool"]["setuptools"]
    found = {".".join(file.parent.relative_to(root.parent).parts) for file in root.rglob("*.py")}
    assert found <= set(tools["packages"])
    for file in root.rglob("*.json"):
        package = ".".join(file.parent.relative_to(root.parent).parts)
        assert file.name in tools["package-data"][package]


def test_package_is_typed_and_versioned() -> None:
    assert importlib.resources.files("hamsym").joinpath("py.typed").is_file()
    assert hamsym.__version__ == distribution("hamsym").version


def test_kernel_is_installed() -> None:
    assert kernel_library().hamsym_arithmetic() == 0


def test_command_is_installed() -> None:
    names = {entry.name: entry.value for entry in distribution("hamsym").entry_points}
    assert names["hamsym"] == "hamsym.cli.commands:main"


@pytest.mark.slow
def test_import_changes_no_global_state() -> None:
    """In a fresh process: defaults of torch and numpy, and their random states, stay."""
    import subprocess
    import sys

    script = """
import numpy as np, torch
before = (torch.get_default_dtype(), torch.get_num_threads(), np.geterr(), np.get_printoptions(),
          torch.get_rng_state().sum().item(), np.random.get_state()[1].sum())
import hamsym, hamsym.solving.solve, hamsym.study.compare, hamsym.plotting.plot, hamsym.cli.commands
after = (torch.get_default_dtype(), torch.get_num_threads(), np.geterr(), np.get_printoptions(),
         torch.get_rng_state().sum().item(), np.random.get_state()[1].sum())
assert before == after, (before, after)
"""
    subprocess.run([sys.executable, "-c", script], check=True)
