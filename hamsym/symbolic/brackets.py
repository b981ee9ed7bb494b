"""Functions on phase space: Poisson brackets, conservation and the variational equations."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import sympy

from hamsym.errors import VariableError
from hamsym.formula.parser import Written, canonical_name, parse_written
from hamsym.support.suggestions import did_you_mean
from hamsym.symbolic import derivatives
from hamsym.symbolic.checks import checked_expression, quoted

_LISTED = 14  # names in a message


def phase_function(f: str | sympy.Expr, names: Iterable[str]) -> sympy.Expr:
    """Convert a function on phase space to real symbols.

    Raise VariableError if f has a symbol with another name.

    - names: Names of the state, the parameters and the time.

    Examples
    --------
    >>> phase_function("theta*p", ["θ", "p"])
    p*θ
    """
    return written_function(f, names)[0]


def written_function(
    f: str | sympy.Expr, names: Iterable[str], others: Iterable[str] = ()
) -> tuple[sympy.Expr, Written]:
    """Convert a function on phase space; return the terms of its sums in the order of a text too.

    - others: Further names, which the message about an unknown one does not list.
    """
    expr, written = (
        parse_written(f) if isinstance(f, str) else (checked_expression(f, "a formula"), {})
    )
    listed = list(names)
    known = {canonical_name(name): name for name in (*listed, *others)}
    spelled = [*listed, *map(canonical_name, listed)]
    replaced = {}
    for symbol in sorted(expr.free_symbols, key=str):
        name = known.get(canonical_name(symbol.name))
        if name is None:
            raise VariableError(
                f"{quoted(symbol.name)} does not occur in H{did_you_mean(symbol.name, spelled)}; "
                f"use only {', '.join(listed[:_LISTED])}{', ...' * (len(listed) > _LISTED)}"
            )
        replaced[symbol] = sympy.Symbol(name, real=True)
    return renamed(expr, written, {own: new for own, new in replaced.items() if own != new})


def renamed(
    expr: sympy.Expr, written: Written, symbols: Mapping[sympy.Symbol, sympy.Symbol]
) -> tuple[sympy.Expr, Written]:
    """Replace symbols in an expression, and in the terms of its sums."""
    if not symbols:
        return expr, written
    return expr.xreplace(symbols), {
        total.xreplace(symbols): tuple(term.xreplace(symbols) for term in terms)
        for total, terms in written.items()
    }


def poisson_bracket(f: sympy.Expr, g: sympy.Expr, z: Sequence[sympy.Symbol]) -> sympy.Expr:
    """Poisson bracket {f, g} = sum_i df/dq_i dg/dp_i - df/dp_i dg/dq_i, for z = (q, p).

    Examples
    --------
    >>> x, p = sympy.symbols("x p")
    >>> poisson_bracket(x**2, p, (x, p))
    2*x
    """
    d = len(z) // 2
    of_f, of_g = derivatives.gradient(f, z), derivatives.gradient(g, z)
    return sympy.Add(*(of_f[i] * of_g[d + i] - of_f[d + i] * of_g[i] for i in range(d)))


def evolution(
    f: sympy.Expr,
    H: sympy.Expr,
    z: Sequence[sympy.Symbol],
    time: sympy.Symbol | None,
    forces: Sequence[sympy.Expr] = (),
) -> sympy.Expr:
    """Time derivative df/dt = {f, H} + F . df/dp + (partial f)/(partial t) along trajectories."""
    rate = poisson_bracket(f, H, z)
    if forces:
        slopes = derivatives.gradient(f, z[len(z) // 2 :])
        rate += sympy.Add(*(force * slope for force, slope in zip(forces, slopes, strict=True)))
    return rate if time is None else rate + f.diff(time)


def variational_equations(
    generator: sympy.Matrix, names: Sequence[str], time: sympy.Symbol, taken: Iterable[str]
) -> list[sympy.Eq]:
    """Linear equations d(delta)/dt = A(z) delta of a small deviation delta.

    - generator: The derivatives A of the rates, J Hess(z) without forces, dim x dim.
    - names: Names of the state; the deviations are named ``delta_x`` or similar.
    - taken: Names that the deviations must avoid.
    """
    used, mark = {*names, *taken}, "delta_"
    while any(mark + name in used for name in names):
        mark = "d" + mark
    delta = sympy.Matrix([sympy.Symbol(mark + name, real=True) for name in names])
    return [
        sympy.Eq(sympy.Derivative(entry, time, evaluate=False), rate, evaluate=False)
        for entry, rate in zip(delta, generator * delta, strict=True)
    ]
