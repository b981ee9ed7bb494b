"""The results file: one section for each benchmark, with its commit and its machine."""

from __future__ import annotations

import json
import platform
import subprocess
import time
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any, TypeAlias

from hamsym.support.atomic import write_atomically

#: Results of one benchmark as JSON has them.
Section: TypeAlias = dict[str, Any]

FILE = Path(__file__).with_name("results.json")

_PACKAGES = (
    *("hamsym", "numpy", "scipy", "numba", "torch", "sympy", "python-flint"),
    *("heyoka", "numbalsoda", "CyRK", "diffrax", "pyhamsys", "neurodiffeq", "deepxde"),
)


def read(path: Path = FILE) -> dict[str, Section]:
    """Sections by the name of their benchmark."""
    sections: dict[str, Section] = json.loads(path.read_text("utf-8")) if path.exists() else {}
    return sections


def replace_section(name: str, section: Section, quick: bool, path: Path = FILE) -> None:
    """Write the results of one benchmark and leave the other sections as they are."""
    sections = read(path)
    sections[name] = {"quick": quick, "environment": environment(), **section}
    write_atomically(path, as_text(dict(sorted(sections.items()))).encode())


def as_text(sections: Mapping[str, Section]) -> str:
    """JSON with one line for each benchmark."""
    lines = [f"{json.dumps(name)}: {json.dumps(section)}" for name, section in sections.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def environment() -> dict[str, Any]:
    """Date, processor, Python, and versions of the packages that are installed."""
    versions = {}
    for package in _PACKAGES:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return {
        "date": time.strftime("%Y-%m-%d"),
        "commit": commit(),
        "processor": processor(),
        "python": platform.python_version(),
        "system": platform.system(),
        "versions": versions,
    }


def commit() -> str | None:
    """The commit that is measured, shortened; None outside a repository."""
    command = ["git", "-C", str(FILE.parent), "rev-parse", "--short=8", "HEAD"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None


def processor() -> str:
    """The processor's name as the system gives it."""
    information = Path("/proc/cpuinfo")
    if information.exists():
        for line in information.read_text("utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
