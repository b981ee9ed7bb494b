"""Count the modules of hamsym that a formula passes on its way to a proof.

Run as ``python -m tests.passed_modules``: in this process, which has called nothing of hamsym
before, a Hamiltonian is made, solved, proven, and the proof is verified. A module counts if one of
its functions is called meanwhile; what modules do while they are imported does not count.
"""

from __future__ import annotations

import sys
import threading
from collections import Counter
from pathlib import Path
from types import FrameType
from typing import Any

_FORMULA, _Z0, _SPAN = "p**2/2 + x**2/2 + x**4/4", [1.3, 1.0], (0, 12)


def passed() -> dict[str, str]:
    """Return the modules in the order of their first calls, each with the function called."""
    found: dict[str, str] = {}

    def note(frame: FrameType, event: str, _: Any) -> None:
        if event != "call":
            return
        name = frame.f_globals.get("__name__", "")
        if name.partition(".")[0] != "hamsym" or name in found:  # generated modules: hamsym_...
            return
        above: FrameType | None = frame
        while above is not None:
            if above.f_code.co_filename.startswith("<frozen importlib"):
                return
            above = above.f_back
        found[name] = frame.f_code.co_qualname

    import hamsym

    threading.setprofile(note)
    sys.setprofile(note)
    H = hamsym.Hamiltonian(_FORMULA)
    solution = hamsym.solve(H, _Z0, _SPAN)
    certificate = hamsym.certify(solution)
    hamsym.verify(certificate, solution)
    sys.setprofile(None)
    threading.setprofile(None)  # type: ignore[arg-type]
    assert solution.success
    return found


def main() -> None:
    """Print the modules with their lines, and their number, of each room and of all."""
    found = passed()
    rooms = Counter(name.split(".")[1] if name.count(".") > 1 else "-" for name in found)
    for name, function in found.items():
        file = Path(sys.modules[name].__file__ or "") if name in sys.modules else Path()
        lines = len(file.read_text("utf-8").splitlines()) if file.is_file() else 0
        print(f"{lines:5}  {name}  ({function})")
    print(", ".join(f"{room} {count}" for room, count in rooms.items()))
    print(f"{len(found)} modules")


if __name__ == "__main__":
    main()
