"""Table of the backends of generated code, with what each of them has.

The text of a backend comes from its template, ``templates/NAME.EXTENSION.jinja``, and its printer,
a row of ``PRINTERS`` in :mod:`hamsym.codegen.printers`. This module imports nothing slow, because
the command line lists the backends.
"""

from __future__ import annotations

import builtins
import functools
import keyword
from dataclasses import dataclass

#: Functions of a module, in its order.
FUNCTIONS = ("energy", "gradient", "vector_field", "hessian", "residual", "loss")

# Functions of a module for solvers of other languages, which need no loss.
_FOR_SOLVERS = ("energy", "gradient", "vector_field", "jacobian", "hessian")

#: Names in generated Python functions other than those of the state and the parameters.
PYTHON_NAMES = frozenset(
    """
    torch np jnp jax math z dz t out zero rows matrix entries positions value energy_0 energy_weight
    energy_error point times parameters coordinates momenta slopes mixed DIM _ _floating _components
    row weight terms weights _evaluate _energy _gradient _vector_field _hessian _jacobian _power
    _rate_curvature _erf
    """.split()
).union(FUNCTIONS, dir(builtins), keyword.kwlist)

# Keywords up to C23, which new compilers take by default; names of the functions and macros of
# math.h that the code calls; words that compilers define as macros; names in the template.
_C_NAMES = frozenset(
    """
    auto break case char const continue default do double else enum extern float for goto if inline
    int long register restrict return short signed sizeof static struct switch typedef union
    unsigned void volatile while alignas alignof bool constexpr false nullptr static_assert
    thread_local true typeof typeof_unqual asm fortran
    pow fabs sign smaller larger isnan NAN INFINITY HUGE HUGE_VAL HUGE_VALF HUGE_VALL MAXFLOAT
    M_E M_LOG2E M_LOG10E M_LN2 M_LN10 M_PI M_PI_2 M_PI_4 M_1_PI M_2_PI M_2_SQRTPI M_SQRT2 M_SQRT1_2
    FP_NAN FP_INFINITE FP_ZERO FP_SUBNORMAL FP_NORMAL FP_ILOGB0 FP_ILOGBNAN FP_LLOGB0 FP_LLOGBNAN
    FP_INT_DOWNWARD FP_INT_UPWARD FP_INT_TOWARDZERO FP_INT_TONEAREST FP_INT_TONEARESTFROMZERO
    FP_FAST_FMA FP_FAST_FMAF FP_FAST_FMAL MATH_ERRNO MATH_ERREXCEPT math_errhandling DOMAIN SING
    OVERFLOW UNDERFLOW PLOSS TLOSS I NULL linux unix i386 vax sun mips sparc
    z t out i DIM parameters default_parameters power
    """.split()
).union(_FOR_SOLVERS)

_JULIA_NAMES = frozenset(
    """
    baremodule begin break catch const continue do else elseif end export finally for function
    global if import let local macro module quote return struct true false try using while in isa
    where mutable abstract primitive type outer as public
    z t out parameters PARAMETERS energy power nothing
    """.split()
)

# Words that modules in strict mode reserve, globals of the language that names would hide or that
# cannot be declared, and names in the template.
_JAVASCRIPT_NAMES = frozenset(
    """
    break case catch class const continue debugger default delete do else enum export extends false
    finally for function if implements import in instanceof interface let new null package private
    protected public return static super switch this throw true try typeof var void while with
    yield await async of arguments eval undefined NaN Infinity Math Float64Array
    z t out parameters PARAMETERS DIM power
    """.split()
).union(_FOR_SOLVERS)


@dataclass(frozen=True)
class Backend:
    """A language of generated code."""

    #: Functions of the module, in its order.
    functions: tuple[str, ...] = FUNCTIONS
    #: Functions that only modules of systems with forces have.
    forced: tuple[str, ...] = ("jacobian", "power")
    #: Functions that are generated only when asked for by name.
    hidden: tuple[str, ...] = ()
    #: Of its template and of files.
    extension: str = "py"
    #: Names with a meaning in the code, from which those of the user are kept clear.
    reserved: frozenset[str] = PYTHON_NAMES
    #: Whether Greek letters are spelled out in names.
    spells_greek: bool = False
    #: Whether the module has the loops of the integrators.
    has_loops: bool = False
    #: Whether :meth:`hamsym.Hamiltonian.compile` makes functions of arrays of it.
    runs: bool = True
    #: A package that its functions import and that is installed with ``hamsym[package]``.
    package: str = ""


BACKENDS: dict[str, Backend] = {
    "torch": Backend(),
    "numpy": Backend(),
    "numba": Backend(has_loops=True),
    "jax": Backend(package="jax"),
    "c": Backend(
        _FOR_SOLVERS, ("power",), extension="c", reserved=_C_NAMES, spells_greek=True, runs=False
    ),
    "julia": Backend(_FOR_SOLVERS, ("power",), extension="jl", reserved=_JULIA_NAMES, runs=False),
    "javascript": Backend(
        _FOR_SOLVERS, ("power",), extension="js", reserved=_JAVASCRIPT_NAMES, runs=False
    ),
    # Functions of an arithmetic, which proofs run.
    "balls": Backend(
        ("energy", "vector_field", "hessian"),
        ("gradient", "jacobian"),
        hidden=("third_derivatives",),
        runs=False,
    ),
}


@functools.cache
def runnable() -> tuple[str, ...]:
    """Names of the backends that can be compiled.

    Examples
    --------
    >>> runnable()
    ('torch', 'numpy', 'numba', 'jax')
    """
    return tuple(name for name, backend in BACKENDS.items() if backend.runs)
