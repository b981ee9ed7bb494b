"""Proofs refuse arithmetic that does not round as IEEE 754 has it."""

import ctypes
import ctypes.util
import platform
import subprocess
import sys
import threading
from types import SimpleNamespace

import pytest

from hamsym.errors import CertificationError
from hamsym.proof.arithmetic import float64_arithmetic
from hamsym.proof.arithmetic.float64_arithmetic import require_float64

# Settings of the processor are changed in processes of their own.
_ENTRIES = """
import hamsym, ctypes, ctypes.util, threading, sys
from hamsym.proof.prove import verify
oscillator = "p**2/2 + x**2/2"
solution = hamsym.solve(oscillator, [1.0, 0.0], (0.0, 1.0), tol=1e-8)
certificate = solution.certify()
enclosure = hamsym.enclose(oscillator, [1, 0], (0, 1))
flow = hamsym.flow_map(oscillator, {"x": (1, 1.1), "p": 0}, (0, 1), tol=1e-6)
orbit = hamsym.periodic_orbit("p**2/2 + x**2/2 + x**4/4", [1.0, 0.0])
entries = {
    "certify": solution.certify,
    "verify": lambda: verify(certificate, solution),
    "enclose": lambda: hamsym.enclose(oscillator, [1, 0], (0, 1)),
    "values of an enclosure": lambda: enclosure(0.5),
    "flow map": flow.certify,
    "orbit": orbit.certify,
    "equilibria": lambda: hamsym.equilibria("p**2/2 - cos(x)", box={"x": (-1, 1), "p": (-1, 1)}),
    "prove=True": lambda: hamsym.solve(oscillator, [1, 0], (0, 1), tol=1e-8, prove=True),
}
"""
_ATTEMPT = """
def attempt():
    for name, entry in entries.items():
        try:
            found = entry()
        except hamsym.CertificationError as error:
            print(f"{name}: {error}")
        else:
            print(f"{name}: {getattr(found, 'message', 'no error')}")
"""
_UPWARD = {"x86_64": 0x800, "AMD64": 0x800, "aarch64": 0x400000}.get(platform.machine())
_CHANGES = {
    "subnormal numbers": "import torch; assert torch.set_flush_denormal(True)",
    "rounding to nearest": (
        f"assert ctypes.CDLL(ctypes.util.find_library('m')).fesetround({_UPWARD}) == 0"
    ),
}
_KNOWN = pytest.mark.skipif(
    _UPWARD is None or sys.platform == "win32", reason="no settings known for this processor"
)


@_KNOWN
@pytest.mark.slow
@pytest.mark.parametrize("missing", _CHANGES)
def test_every_proof_refuses_other_arithmetic(missing):
    """In the main thread, and in one that is started later, which inherits its settings."""
    code = f"""{_ENTRIES}{_ATTEMPT}
{_CHANGES[missing]}
attempt()
thread = threading.Thread(target=attempt)
thread.start()
thread.join()
"""
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    lines = done.stdout.splitlines()
    assert len(lines) == 16
    for line in lines:
        assert f"lacks {missing} in this thread; " in line


@_KNOWN
@pytest.mark.parametrize("missing", _CHANGES)
def test_settings_of_one_thread_are_found(missing):
    messages = []

    def change_and_require():
        exec(_CHANGES[missing], {"ctypes": ctypes})  # noqa: S102
        try:
            require_float64()
        except CertificationError as error:
            messages.append(str(error))

    thread = threading.Thread(target=change_and_require)
    thread.start()
    thread.join()
    (message,) = messages
    assert f"lacks {missing} in this thread; " in message
    require_float64()


def test_arithmetic_of_this_thread_is_accepted():
    require_float64()


@pytest.mark.parametrize("place", range(len(float64_arithmetic._SUMS)))
def test_each_wrong_sum_of_matrices_is_refused(place, monkeypatch):
    rows, columns = float64_arithmetic._matrices()
    wrong = rows.copy()
    wrong[place, 2 * place] *= 2
    monkeypatch.setattr(float64_arithmetic, "_matrices", lambda: (wrong, columns))
    with pytest.raises(CertificationError, match="products of matrices lack"):
        require_float64()


@pytest.mark.parametrize("lacking", [1, 2, 3, 4])
def test_wrong_arithmetic_of_the_kernel_is_refused(lacking, monkeypatch):
    kernel = SimpleNamespace(hamsym_arithmetic=lambda: lacking)
    monkeypatch.setattr(float64_arithmetic, "kernel_library", lambda: kernel)
    with pytest.raises(CertificationError, match="its kernel lacks"):
        require_float64()
