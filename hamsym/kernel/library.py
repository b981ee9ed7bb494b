"""The compiled library of the kernel, loaded when it is first used.

There is one library for each level of instructions, compiled from the same sources; all compute
the same bits. The environment variable ``HAMSYM_KERNEL_LEVEL`` chooses a lower one than the
processor has.
"""

from __future__ import annotations

import ctypes
import functools
import os
import platform
from pathlib import Path

from hamsym.errors import FileError, HamsymError, InputError

LEVEL_VARIABLE = "HAMSYM_KERNEL_LEVEL"
_FOLDER = Path(__file__).parent
_X86 = platform.machine().lower() in ("x86_64", "amd64")
_LEVELS = ("v2", "v3", "v4") if _X86 else ("generic",)
# By the number that hamsym_arithmetic returns.
_LACKING = {
    1: "rounding to nearest in this thread; restore it (fesetround)",
    2: "subnormal numbers in this thread; call torch.set_flush_denormal(False)",
    3: "operations rounded one by one; build it without flags for fast mathematics",
    4: "a correct fused multiply-add; build it with another compiler",
}


@functools.cache
def kernel_library() -> ctypes.CDLL:
    """Load the library for this processor.

    Raise FileError if it was not compiled. Raise InputError if ``HAMSYM_KERNEL_LEVEL`` names no
    level, or one that the processor lacks. Raise HamsymError if the processor is older than all
    levels, or its arithmetic is not that of IEEE 754.
    """
    library = open_library(chosen_level())
    require_arithmetic(library)
    return library


def chosen_level() -> str:
    """Choose the level that ``HAMSYM_KERNEL_LEVEL`` names, or else the highest of the processor."""
    levels = supported_levels()
    level = os.environ.get(LEVEL_VARIABLE) or levels[-1]
    if level not in levels:
        raise InputError(
            f"{LEVEL_VARIABLE} must be one of {', '.join(levels)} on this processor, not '{level}'"
        )
    return level


def supported_levels() -> tuple[str, ...]:
    """Return the levels that this processor runs, from the lowest to the highest."""
    if not _X86:
        return _LEVELS
    levels = _LEVELS[: open_library(_LEVELS[0]).hamsym_level() - 1]
    if not levels:
        raise HamsymError(
            "hamsym needs an x86-64 processor with the instructions of x86-64-v2 (SSE4.2), which "
            "this one lacks; use a processor made after 2009"
        )
    return levels


def open_library(level: str) -> ctypes.CDLL:
    """Open the library of a level, also of one whose functions this processor cannot run."""
    path = _FOLDER / f"kernel.{level}.so"
    try:
        return ctypes.CDLL(str(path))
    except OSError as error:
        reason = "cannot be loaded" if path.exists() else "was not compiled"
        raise FileError(
            f"the library {path} of hamsym's kernel {reason} ({error}); compile it by "
            "'pip install -e .' in a checkout, or install a wheel"
        ) from error


def require_arithmetic(library: ctypes.CDLL) -> None:
    """Require that a library computes as IEEE 754 has it, in this thread."""
    lacking = library.hamsym_arithmetic()
    if lacking:
        raise HamsymError(
            f"hamsym needs IEEE 754 arithmetic, but its kernel lacks {_LACKING[lacking]}"
        )
