"""The kernel's tests with a library that checks every access and every operation."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import hamsym

ROOT = Path(__file__).parents[2]
CHOSEN = [
    *("bounds", "kernel/test_programs.py", "random_features/test_members.py"),
    *("proof/test_ball_arithmetic.py", "proof/test_chebyshev_models.py"),
    *("proof/test_window_steps.py", "proof/test_enclosures.py"),
]
# The package beside the tests comes before the installed one.
SCRIPT = """
import sys
sys.path.insert(0, sys.argv[1])
import hamsym, pytest
assert hamsym.__file__.startswith(sys.argv[1])
sys.exit(pytest.main(sys.argv[2:]))
"""


def _runtime() -> str | None:
    """Path of gcc's address sanitizer, None without."""
    if shutil.which("gcc") is None:
        return None
    command = ["gcc", "-print-file-name=libasan.so"]
    path = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    return path if os.path.isabs(path) else None


@pytest.mark.slow
@pytest.mark.skipif(_runtime() is None, reason="gcc with its address sanitizer is not installed")
def test_kernel_runs_under_sanitizers(tmp_path: Path) -> None:
    ignored = shutil.ignore_patterns("__pycache__", "*.so")
    shutil.copytree(Path(hamsym.__file__).parent, tmp_path / "hamsym", ignore=ignored)
    shutil.copytree(ROOT / "templates", tmp_path / "hamsym" / "templates", ignore=ignored)
    compiler = "gcc -g -fsanitize=address,undefined -fno-sanitize-recover=undefined"
    build = [sys.executable, "-P", tmp_path / "hamsym" / "kernel" / "build_backend.py"]
    subprocess.run(build, env=os.environ | {"CC": compiler}, check=True)
    # Leaks are those of Python; large systems take too long.
    settings = {"LD_PRELOAD": str(_runtime()), "ASAN_OPTIONS": "detect_leaks=0"}
    tests = [f"{ROOT}/tests/{path}" for path in CHOSEN]
    options = ["-p", "no:cacheprovider", "-m", "not slow", "-k", "not equations", *tests]
    done = subprocess.run(
        [sys.executable, "-P", "-c", SCRIPT, str(tmp_path), *options],
        env=os.environ | settings,
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
