"""Printers of expressions for torch, numpy, numba, jax, C, Julia and JavaScript."""

from __future__ import annotations

import math

import sympy

from hamsym.formula.printer import _ATOM, _COMMON, _MUL, _POW, Printer, _table

_HALF_INTEGERS = tuple(kind(k) / 2 for k in (3, 5, 7) for kind in (sympy.Integer, sympy.Float))


class _TensorPrinter(Printer):
    """Printer of code for tensors whose results are stacked and so must have one shape."""

    module = ""

    def result(self, expr: sympy.Expr) -> str:
        """Print an expression, expanded to the batch's shape, dtype and device."""
        expr = self.lower(expr)
        if expr == 0:
            return f"{self.module}.zeros_like({self.like})"
        if expr == 1:
            return f"{self.module}.ones_like({self.like})"
        if not expr.free_symbols & self.state:
            return f"{self._wrapped(expr, _MUL)}*{self.module}.ones_like({self.like})"
        return self._render(expr)[0]


class TorchPrinter(_TensorPrinter):
    """Printer of torch code for tensors ``z`` of shape (..., dim).

    Torch functions reject Python numbers, and some reject a mixture of numbers and tensors. An
    argument that does not depend on the state is therefore expanded to the shape of the batch.
    """

    backend = module = "torch"
    functions = _table("torch.{}", abs="torch.abs", min="torch.minimum", max="torch.maximum")
    sqrt = "torch.sqrt"

    def argument(self, expr: sympy.Expr) -> str:
        return self.result(expr)


class JaxPrinter(_TensorPrinter):
    """Printer of jax code for arrays ``z`` of shape (..., dim), which may be traced."""

    backend = "jax"
    module = "jnp"
    functions = _table(
        "jnp.{}",
        **{name: f"jnp.arc{name[1:]}" for name in _COMMON if name[0] == "a"},
        abs="jnp.abs",
        min="jnp.minimum",
        max="jnp.maximum",
        erf="jax.scipy.special.erf",
    )
    sqrt = "jnp.sqrt"


class NumpyPrinter(Printer):
    """Printer of numpy code for arrays that broadcast."""

    backend = "numpy"
    functions = _table(
        "np.{}",
        **{name: f"np.arc{name[1:]}" for name in _COMMON if name[0] == "a"},
        abs="np.abs",
        min="np.minimum",
        max="np.maximum",
        erf="_erf",
    )
    sqrt = "np.sqrt"

    def power(self, base: sympy.Expr, exponent: sympy.Expr) -> tuple[str, int]:
        # numpy computes squares fast and every other integer power slowly.
        if base.is_Symbol and exponent in (3, 4):
            name = self.names[base]
            return (f"{name}*{name}**2", _MUL) if exponent == 3 else (f"({name}**2)**2", _POW)
        return super().power(base, exponent)


class NumbaPrinter(Printer):
    """Printer of scalar code for numba's compiled loops."""

    backend = "numba"
    functions = _table("math.{}", sign="np.sign", abs="abs", min="np.minimum", max="np.maximum")
    sqrt = "math.sqrt"

    def power(self, base: sympy.Expr, exponent: sympy.Expr) -> tuple[str, int]:
        # A square root is ten times faster than a general power.
        if exponent in _HALF_INTEGERS:
            factor = self._wrapped(base, _ATOM)
            factor = factor if exponent < 2 else f"{factor}**{math.floor(exponent)}"
            return f"{factor}*{self.sqrt}({self.argument(base)})", _MUL
        return super().power(base, exponent)


class CPrinter(Printer):
    """Printer of C99 for numbers of type double; integers are written as such numbers."""

    backend = "c"
    functions = _table("{}", abs="fabs", min="smaller", max="larger")
    raise_to = "pow"

    def integer(self, value: int) -> str:
        return f"{value}.0"

    def power(self, base: sympy.Expr, exponent: sympy.Expr) -> tuple[str, int]:
        if base.is_Symbol and exponent in (2, 3, 4):
            return "*".join([self.names[base]] * int(exponent)), _MUL
        is_fraction = exponent.is_Rational and not exponent.is_Integer
        written = repr(float(exponent)) if is_fraction else self.argument(exponent)
        return f"{self.raise_to}({self.argument(base)}, {written})", _ATOM


class JuliaPrinter(Printer):
    """Printer of Julia for numbers."""

    backend = "julia"
    functions = _table("{}", abs="abs", min="min", max="max", atan2="atan")
    raised = "^"


class JavaScriptPrinter(CPrinter):
    """Printer of JavaScript for numbers; its library has no erf, and -x**2 is an error in it."""

    backend = "javascript"
    functions = {
        kind: text
        for kind, text in _table("Math.{}", abs="Math.abs", min="Math.min", max="Math.max").items()
        if kind is not sympy.erf
    }
    sqrt = "Math.sqrt"
    raise_to = "Math.pow"

    def integer(self, value: int) -> str:
        return str(value)


#: Functions that numpy lacks, with the name and the definition that its modules give them.
NUMPY_DEFINITIONS: dict[type, tuple[str, str]] = {
    sympy.erf: ("_erf", "np.vectorize(math.erf, otypes=[float])")
}

#: Printer class of each backend.
PRINTERS: dict[str, type[Printer]] = {
    printer.backend: printer
    for printer in (
        *(TorchPrinter, NumpyPrinter, NumbaPrinter, JaxPrinter),
        *(CPrinter, JuliaPrinter, JavaScriptPrinter),
    )
}
