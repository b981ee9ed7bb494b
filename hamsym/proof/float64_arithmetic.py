"""A check that float64 arithmetic is that of IEEE 754, which the bounds of proofs assume.

Rounding to nearest and subnormal numbers are settings of a thread: ``torch.set_flush_denormal``,
``fesetround`` or a library compiled with fast mathematics change them, also for threads that are
started afterwards. So each proof begins with a few operations whose exact results tell. Operands
and results are written as bits, because such settings falsify even the reading of a decimal.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from hamsym.errors import CertificationError
from hamsym.kernel.enclosures import enclosures


def _power(exponent: int) -> int:
    """The bits of 2**exponent; one more is the next number."""
    return (exponent + 1023) << 52


_SIGN = 1 << 63
_ONE = _power(0)
_LEAST = _power(-1022)  # the smallest number that is not subnormal; 2**-1074 has the bits 1
_NEAREST, _SUBNORMAL, _FUSED = "rounding to nearest", "subnormal numbers", "fused multiply-add"
#: Bits of a, b, c and of the result, by operation, with what it shows.
_OPERATIONS: tuple[tuple[str, int, int, int, int, str], ...] = (
    # 1 + 0.75 ulp and 1 + 0.25 ulp, of both signs; just above a tie, where extended precision ties
    ("sum", _ONE, _power(-53) + (1 << 51), 0, _ONE + 1, _NEAREST),
    ("sum", _ONE, _power(-54), 0, _ONE, _NEAREST),
    ("sum", _SIGN + _ONE, _SIGN + _power(-54), 0, _SIGN + _ONE, _NEAREST),
    ("sum", _ONE, _power(-53) + (1 << 32), 0, _ONE + 1, _NEAREST),
    # (1 + ulp)^2 = 1 + 2 ulp + ulp^2; 1.75 (1 + ulp) = 1.75 + 1.75 ulp
    ("product", _ONE + 1, _ONE + 1, 0, _ONE + 2, _NEAREST),
    ("product", _ONE + (3 << 50), _ONE + 1, 0, _ONE + (3 << 50) + 2, _NEAREST),
    # 1/3 is rounded down, 1/10 and the root of 2 are rounded up
    ("quotient", _ONE, _power(1) + (1 << 51), 0, 0x3FD5555555555555, _NEAREST),
    ("quotient", _ONE, _power(3) + (1 << 50), 0, 0x3FB999999999999A, _NEAREST),
    ("root", _power(1), 0, 0, 0x3FF6A09E667F3BCD, _NEAREST),
    # subnormal results and arguments
    ("sum", _LEAST + 1, _SIGN + _LEAST, 0, 1, _SUBNORMAL),
    ("sum", 1, 1, 0, 2, _SUBNORMAL),
    ("product", _LEAST, _power(-1), 0, 1 << 51, _SUBNORMAL),
    ("product", 1 << 51, _power(1), 0, _LEAST, _SUBNORMAL),
    # the rounding error of a product, also where it is subnormal
    ("fused", _ONE + 1, _ONE + 1, _SIGN + _ONE + 2, _power(-104), _FUSED),
    ("fused", _power(-485) + 1, _power(-485) + 1, _SIGN + _power(-970) + 2, 1, _FUSED),
)
_REMEDIES = {
    _NEAREST: "restore rounding to nearest (fesetround)",
    _SUBNORMAL: "call torch.set_flush_denormal(False)",
    _FUSED: "use another processor, or build hamsym with another compiler",
}
_COPIES, _COLUMNS = 8, 96  # of a product of matrices that is large enough for all threads of BLAS


def _column(place: int) -> np.ndarray:
    return np.array([row[place] for row in _OPERATIONS], dtype=np.uint64)


_NAMES = [row[0] for row in _OPERATIONS]
_ARGUMENTS = [_column(place).view(np.float64) for place in (1, 2, 3)]
_EXPECTED = _column(4)
_PLACES = {name: np.array([k for k, own in enumerate(_NAMES) if own == name]) for name in _NAMES}


def require_float64(basic_operations: Callable[..., Any] | None = None) -> None:
    """Require IEEE 754 arithmetic in this thread, in numpy and in the library of the kernel.

    - basic_operations: In place of that of the library: arrays a, b, c -> a + b, a b, a / b,
      sqrt(|a|) and a b + c with one rounding.

    Raises
    ------
    CertificationError
        Naming what is missing.
    """
    a, b, c = _ARGUMENTS
    with np.errstate(all="ignore"):
        found = {"sum": a + b, "product": a * b, "quotient": a / b, "root": np.sqrt(a)}
        _require(found, "numpy")
        rows, columns = _matrices()  # threads of BLAS may have settings of their own
        products = (rows @ columns).T.reshape(_COLUMNS, _COPIES, -1)
        _require({"sum": products, "product": products}, "products of matrices")
        results = (basic_operations or enclosures().basic_operations)(a, b, c)
        _require(dict(zip((*found, "fused"), results, strict=True)), "compiled code")


def _require(found: dict[str, np.ndarray], where: str) -> None:
    for name, values in found.items():
        places = _PLACES[name]
        # Bits, because a comparison may take subnormal numbers for zeros.
        wrong = values.view(np.uint64)[..., places] != _EXPECTED[places]
        if wrong.any():
            raise _refusal(_OPERATIONS[places[np.argwhere(wrong)[0, -1]]][-1], where)


@functools.cache
def _matrices() -> tuple[np.ndarray, np.ndarray]:
    """Matrices whose product has each sum and product, as long as they are, in many places."""
    a, b, _ = _ARGUMENTS
    rows, column = np.zeros((_COPIES, len(_NAMES), 2 * len(_NAMES))), np.ones(2 * len(_NAMES))
    for place, name in enumerate(_NAMES):
        rows[:, place, 2 * place] = a[place]
        if name == "sum":
            rows[:, place, 2 * place + 1] = b[place]
        else:
            column[2 * place] = b[place]
    return rows.reshape(-1, 2 * len(_NAMES)), np.repeat(column[:, None], _COLUMNS, axis=1)


def _refusal(missing: str, where: str) -> CertificationError:
    return CertificationError(
        f"proofs need IEEE 754 arithmetic, but {where} lacks {missing} in this thread; "
        f"{_REMEDIES[missing]}"
    )
