"""The first call in a fresh process after its imports, beside scipy's DOP853.

Henon-Heiles to t = 300.
"""

from __future__ import annotations

import subprocess
import sys

from . import markdown
from .measuring import median
from .results import Section

_HAMSYM = """
from hamsym import solve
from hamsym.systems import henon_heiles
began = time.process_time()
problem = henon_heiles()
derived = time.process_time()
solve(problem.H, problem.z0, (0, {end}), tol=1e-9)
"""
_DOP853 = """
from scipy.integrate import solve_ivp
def field(t, z):
    x, y, px, py = z.tolist()
    return px, py, -x - 2*x*y, -y - x*x + y*y
began = derived = time.process_time()
solve_ivp(field, (0, {end}), (0.3, -0.3, 0.3, 0.15), method="DOP853", dense_output=True,
          rtol={tol}, atol={tol})
"""


def measure(quick: bool) -> Section:
    repeats, end = (1, 20.0) if quick else (5, 300.0)
    scripts = {"hamsym, tol 1e-9": _HAMSYM.format(end=end)}
    for tol in () if quick else ("1e-9", "1e-12"):
        scripts[f"DOP853, rtol = atol = {tol}"] = _DOP853.format(end=end, tol=tol)
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in scripts}
    for _ in range(repeats):
        for name, script in scripts.items():
            ending = "\nprint(derived - began, time.process_time() - began)"
            output = subprocess.run(
                [sys.executable, "-c", "import time" + script + ending],
                check=True,
                capture_output=True,
                text=True,
            ).stdout
            derived, total = map(float, output.split())
            found[name].append((derived, total))
    rows = [
        {
            "call": name,
            "derivation": median(derived for derived, _ in times),
            "seconds": median(total for _, total in times),
        }
        for name, times in found.items()
    ]
    return {"repeats": repeats, "end": end, "rows": rows}


def table(section: Section) -> str:
    rows = [
        [row["call"], f"{1e3 * row['seconds']:.0f}", f"{1e3 * row['derivation']:.0f}"]
        for row in section["rows"]
    ]
    return markdown.table(["first call", "ms", "of it from text to Hamiltonian"], rows)
