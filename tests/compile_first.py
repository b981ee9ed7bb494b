"""Compile the march and the proofs side by side, into the cache of the suite.

Otherwise each worker of the suite would compile all of it, for its first case that needs it.
"""

from __future__ import annotations

import subprocess
import sys

import tests.conftest  # noqa: F401  chooses the folder of the cache

_MARCH = """
hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 1), compiled=True)
hamsym.flow_map("p**2/2 + x**2/2", {"x": (0, 1), "p": (0, 1)}, (0, 1))
"""
_PROOFS = """
for text in ("p**2/2 + x**2/2", "p**2/2 - cos(x) + exp(x/4)/(2 + x**2) + sqrt(4 + x)*cos(t)"):
    hamsym.enclose(text, ["0.5 +- 0.01", "0.25"], (0, 0.5))
hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 1)).certify()
"""


def main() -> None:
    """Run both, each in its process; what they print or raise is shown by the suite's cases."""
    running = [
        subprocess.Popen([sys.executable, "-c", f"import hamsym\n{task}"])
        for task in (_MARCH, _PROOFS)
    ]
    sys.exit(max(process.wait() for process in running))


if __name__ == "__main__":
    main()
