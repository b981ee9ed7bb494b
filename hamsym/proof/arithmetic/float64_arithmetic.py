"""A check that float64 arithmetic is that of IEEE 754, which the bounds of proofs assume.

Rounding to nearest and subnormal numbers are settings of a thread: ``torch.set_flush_denormal``,
``fesetround`` or a library compiled with fast mathematics change them, also for threads that are
started afterwards. So each proof begins with a few operations whose exact results tell: those of
the kernel in this thread, and a product of matrices, since the threads of BLAS may have settings of
their own. Operands and results are written as bits, because such settings falsify even the reading
of a decimal.
"""

from __future__ import annotations

import functools

import numpy as np

from hamsym.errors import CertificationError, FileError, HamsymError, InputError
from hamsym.kernel.library import kernel_library, require_arithmetic

_SIGN, _ONE, _UNIT = 1 << 63, 1023 << 52, 970 << 52  # the bits of -0, 1 and 2^-53
_LEAST = 1 << 52  # the smallest number that is not subnormal; 2^-1074 has the bits 1
#: Bits of two numbers and of their sum: 1 + 0.25 ulp and 1 + 0.75 ulp, of both signs, a subnormal
#: result, and subnormal arguments.
_SUMS = np.array(
    [
        (_ONE, _UNIT - _LEAST, _ONE),
        (_ONE, _UNIT + (1 << 51), _ONE + 1),
        (_SIGN + _ONE, _SIGN + _UNIT - _LEAST, _SIGN + _ONE),
        (_SIGN + _ONE, _SIGN + _UNIT + (1 << 51), _SIGN + _ONE + 1),
        (_LEAST + 1, _SIGN + _LEAST, 1),
        (1, 1, 2),
    ],
    dtype=np.uint64,
)
_COPIES, _COLUMNS = 48, 96  # of a product that is large enough for all threads of BLAS


def require_float64() -> None:
    """Require IEEE 754 arithmetic in this thread, and in those of BLAS.

    Raises
    ------
    CertificationError
        Naming what is missing.
    """
    try:
        require_arithmetic(kernel_library())
    except (FileError, InputError):
        raise
    except HamsymError as error:
        raise CertificationError(f"a proof is not possible: {error}") from None
    rows, columns = _matrices()
    found = (rows @ columns).reshape(_COPIES, len(_SUMS), _COLUMNS)
    # Bits, because a comparison may take subnormal numbers for zeros.
    if (found.view(np.uint64) != _SUMS[:, 2, None]).any():
        raise CertificationError(
            "proofs need IEEE 754 arithmetic, but products of matrices lack rounding to nearest or "
            "subnormal numbers; use numpy with another BLAS, or restore the settings of its threads"
        )


@functools.cache
def _matrices() -> tuple[np.ndarray, np.ndarray]:
    """Matrices whose product has each sum, in many places."""
    pairs = _SUMS[:, :2].copy().view(np.float64)
    rows = np.einsum("km,kj->kmj", np.eye(len(pairs)), pairs).reshape(len(pairs), -1)
    return np.tile(rows, (_COPIES, 1)), np.ones((rows.shape[1], _COLUMNS))
