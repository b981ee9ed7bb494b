"""Size of the memory."""

from __future__ import annotations

import math
import os
from pathlib import Path

# Limits of a container (cgroups 2 and 1).
_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


def memory_size() -> float:
    """Return the bytes of memory that this process may use, or infinity if they are unknown."""
    size = math.inf
    if hasattr(os, "sysconf"):
        size = float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    for path in _LIMITS:
        try:
            size = min(size, float(Path(path).read_text(encoding="ascii")))
        except (OSError, ValueError):  # there is no limit, or no such file
            continue
    return size
