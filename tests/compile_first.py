"""Compile proofs and flow maps into the cache of the suite.

Otherwise each worker of the suite would compile them, for its first case that needs them.
"""

from __future__ import annotations

import hamsym
import tests.conftest  # noqa: F401  chooses the folder of the cache


def main() -> None:
    """Prove and map; what fails is shown by the suite's cases."""
    for text in ("p**2/2 + x**2/2", "p**2/2 - cos(x) + exp(x/4)/(2 + x**2) + sqrt(4 + x)*cos(t)"):
        hamsym.enclose(text, ["0.5 +- 0.01", "0.25"], (0, 0.5))
    hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 1)).certify()
    hamsym.flow_map("p**2/2 + x**2/2", {"x": (0, 1), "p": (0, 1)}, (0, 1))


if __name__ == "__main__":
    main()
