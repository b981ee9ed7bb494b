"""Run pytest with the code that libraries have for an older processor.

``python -m tests.older_processor [arguments of pytest]``: sums in another order, no fused
multiply-add and other elementary functions, so that what rests on last digits fails here too.
"""

from __future__ import annotations

import os
import platform
import sys

_X86 = platform.machine().lower() in ("x86_64", "amd64")


def dispatched() -> list[str]:
    """The extensions of this processor, beyond the least, that numpy has code for."""
    from numpy._core import _multiarray_umath as numpy_code

    found = numpy_code.__cpu_features__
    return [name for name in numpy_code.__cpu_dispatch__ if found[name]]


def settings() -> dict[str, str]:
    """Environment variables that are valid on this processor; programs started later read them."""
    chosen = {
        # numpy warns of extensions that it or the processor lacks.
        "NPY_DISABLE_CPU_FEATURES": " ".join(dispatched()),
        "OPENBLAS_CORETYPE": "Nehalem" if _X86 else "ARMV8",
        # The least of the architecture; without the second, extensions of this processor stay.
        "NUMBA_CPU_NAME": "generic",
        "NUMBA_CPU_FEATURES": "",
        "ATEN_CPU_CAPABILITY": "default",
        "MKL_CBWR": "COMPATIBLE",
        "ONEDNN_MAX_CPU_ISA": "SSE41",
    }
    if _X86:
        chosen["HAMSYM_KERNEL_LEVEL"] = "v2"
        # sin, exp and others of glibc, which Python, scipy and numba call
        chosen["GLIBC_TUNABLES"] = "glibc.cpu.hwcaps=-AVX2,-AVX,-FMA,-FMA4"
    return chosen


if __name__ == "__main__":
    command = [sys.executable, "-m", "pytest", *sys.argv[1:]]
    os.execve(sys.executable, command, os.environ | settings())
