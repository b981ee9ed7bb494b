"""The installed package carries what it needs."""

from __future__ import annotations

import importlib.resources
from importlib.metadata import distribution

import hamsym
from hamsym.codegen.generate import BACKENDS


def test_templates_are_package_data() -> None:
    folder = importlib.resources.files("hamsym.templates")
    for backend in BACKENDS:
        assert folder.joinpath(f"{backend}.py.jinja").is_file()


def test_package_is_typed_and_versioned() -> None:
    assert importlib.resources.files("hamsym").joinpath("py.typed").is_file()
    assert hamsym.__version__ == distribution("hamsym").version


def test_command_is_installed() -> None:
    names = {entry.name: entry.value for entry in distribution("hamsym").entry_points}
    assert names["hamsym"] == "hamsym.cli.commands:main"


def test_import_changes_no_global_state() -> None:
    """In a fresh process: defaults of torch and numpy, and their random states, stay."""
    import subprocess
    import sys

    script = """
import numpy as np, torch
before = (torch.get_default_dtype(), torch.get_num_threads(), np.geterr(), np.get_printoptions(),
          torch.get_rng_state().sum().item(), np.random.get_state()[1].sum())
import hamsym, hamsym.solving, hamsym.study.compare, hamsym.plotting, hamsym.cli.commands
after = (torch.get_default_dtype(), torch.get_num_threads(), np.geterr(), np.get_printoptions(),
         torch.get_rng_state().sum().item(), np.random.get_state()[1].sum())
assert before == after, (before, after)
"""
    subprocess.run([sys.executable, "-c", script], check=True)
