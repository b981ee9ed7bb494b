"""Derivatives of sparse sums, at a cost proportional to the nonzero derivatives.

A Hamiltonian of many bodies is a sum of terms in two or three variables each. Each term is
differentiated with respect to its own variables only, so that n coupled oscillators cost
O(n), not O(n**2) for the gradient and O(n**3) for the Hessian. The same holds for each factor of a
product.
"""

from __future__ import annotations

import enum
import itertools
import math
import random
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

import sympy
from sympy.utilities.iterables import connected_components

from hamsym.errors import CodeGenerationError

# Functions with a transition or a peak within one unit of their argument.
_LOCALISED = (
    sympy.exp,
    sympy.tanh,
    sympy.sech,
    sympy.csch,
    sympy.cosh,
    sympy.sinh,
    sympy.coth,
    sympy.erf,
    sympy.erfc,
    sympy.atan,
    sympy.acot,
    sympy.asinh,
)
#: Functions of one argument, other than those that bend.
_CHAINED = (
    *(sympy.exp, sympy.log, sympy.erf, sympy.erfc),
    *(sympy.sin, sympy.cos, sympy.tan, sympy.cot, sympy.sec, sympy.csc),
    *(sympy.sinh, sympy.cosh, sympy.tanh, sympy.coth, sympy.sech, sympy.csch),
)
#: Smallest limit of operations and symbols in the derivatives of H: about ten seconds of work.
MAX_OPERATIONS = 500_000
_MOST_GROWTH = 100  # the limit per operation and symbol of H; many bodies stay below it


_MOST_ANGLES = 3  # in fractions that are expanded to see whether they vanish
_MOST_FACTORED = 80  # operations of an expression that is factored for its singular values
_HIGH_POWER = 4  # exponent above which a power varies much faster than its base


class _Magnitude(sympy.Function):  # type: ignore[misc]
    """abs of a real expression; the derivative of sympy.Abs contains re and im."""

    def fdiff(self, argindex: int = 1) -> sympy.Expr:
        return _Direction(self.args[0])


class _Direction(sympy.Function):  # type: ignore[misc]
    """sign of a real expression, with derivative zero."""

    def fdiff(self, argindex: int = 1) -> sympy.Expr:
        return sympy.Integer(0)


class _Power(sympy.Function):  # type: ignore[misc]
    """b**e with a symbol in e; the derivative of sympy.Pow divides by b, which may be zero."""

    def fdiff(self, argindex: int = 1) -> sympy.Expr:
        base, exponent = self.args
        if argindex == 1:
            return exponent * _Power(base, exponent - 1)
        return sympy.log(base) * self


def _is_general_power(node: sympy.Basic) -> bool:
    return bool(node.is_Pow and node.exp.free_symbols and node.base is not sympy.E)


def _product(factors: Iterable[sympy.Expr]) -> sympy.Expr:
    """Multiply factors, with numbers taken out of sums: 2*p/(2 + 2*m) is p/(1 + m)."""
    found = []
    for factor in factors:
        base, exponent = factor.as_base_exp()
        if base.is_Add and exponent.is_Integer:
            content, base = base.primitive()
            if content.is_Integer and content != 1:
                found.append(content**exponent)
                factor = base**exponent
        found.append(factor)
    return sympy.Mul(*found)


def _sum(parts: Sequence[list[sympy.Expr]]) -> list[sympy.Expr]:
    """Add products; the sum as factors."""
    return parts[0] if len(parts) == 1 else [sympy.Add(*map(_product, parts))]


def _derivative(expr: sympy.Expr, symbol: sympy.Symbol) -> list[sympy.Expr]:
    """Differentiate an expression that contains a symbol; return the factors of the derivative.

    sympy would multiply numbers into sums on the way: the derivative of k*(r - l)**2/2 would be
    k*(2*r - 2*l)/2. The factors keep the sums of H.
    """
    if expr == symbol:
        return [sympy.Integer(1)]
    if expr.is_Add:
        return _sum([_derivative(term, symbol) for term in expr.args if term.has(symbol)])
    if expr.is_Mul:
        return _sum(
            [
                [*expr.args[:place], *_derivative(factor, symbol), *expr.args[place + 1 :]]
                for place, factor in enumerate(expr.args)
                if factor.has(symbol)
            ]
        )
    if expr.is_Pow and expr.exp.is_Rational:
        return [expr.exp, expr.base ** (expr.exp - 1), *_derivative(expr.base, symbol)]
    if isinstance(expr, _CHAINED):
        return [expr.fdiff(1), *_derivative(expr.args[0], symbol)]
    return [_diff(expr, symbol)]


def _diff(expr: sympy.Expr, symbol: sympy.Symbol) -> sympy.Expr:
    own, back = expr, []
    if expr.has(sympy.Abs, sympy.sign):
        own = own.replace(sympy.Abs, _Magnitude).replace(sympy.sign, _Direction)
        back += [(_Magnitude, sympy.Abs), (_Direction, sympy.sign)]
    if any(_is_general_power(power) for power in expr.atoms(sympy.Pow)):
        own = own.replace(_is_general_power, lambda power: _Power(*power.args))
        back += [(_Power, sympy.Pow)]
    found = own.diff(symbol)
    for replacement, original in back:
        found = found.replace(replacement, original)
    return found


def _partial_derivatives(
    term: sympy.Expr, symbols: Collection[sympy.Symbol], effort: Effort | None = None
) -> Iterator[tuple[sympy.Symbol, sympy.Expr]]:
    """Yield derivatives of a term with respect to the given symbols that it contains."""
    for symbol in term.free_symbols & symbols:
        derivative = _product(_derivative(term, symbol))
        if effort:
            effort.spend(derivative)
        yield symbol, derivative


class Effort:
    """Counter of operations and symbols in derivatives, with a limit proportional to H.

    - expr: H.
    """

    def __init__(self, expr: sympy.Expr) -> None:
        self._sizes: dict[sympy.Basic, int] = {}
        self._left = self._most = max(MAX_OPERATIONS, _MOST_GROWTH * self._size(expr))

    def spend(self, derivative: sympy.Expr) -> None:
        """Add a derivative to the count.

        Raise CodeGenerationError if the count exceeds the limit.
        """
        self._left -= self._size(derivative)
        if self._left < 0:
            raise CodeGenerationError(
                f"the derivatives of H have more than {self._most} operations, because single "
                "terms contain many variables; write H as a sum of terms in fewer variables each"
            )

    def _size(self, expr: sympy.Expr) -> int:
        # Iterative, because the caller's expressions may exceed the recursion limit.
        waiting = [expr]
        while waiting:
            node = waiting[-1]
            if node not in self._sizes:
                if unknown := [part for part in node.args if part not in self._sizes]:
                    waiting += unknown
                    continue
                self._sizes[node] = 1 + sum(self._sizes[part] for part in node.args)
            waiting.pop()
        return self._sizes[expr]


def gradient(
    expr: sympy.Expr, variables: Sequence[sympy.Symbol], effort: Effort | None = None
) -> list[sympy.Expr]:
    """Compute first derivatives, in the order of the variables.

    Examples
    --------
    >>> x, y = sympy.symbols("x y")
    >>> gradient(x**2 + x*y, (x, y))
    [2*x + y, x]
    """
    position = {variable: i for i, variable in enumerate(variables)}
    parts: list[list[sympy.Expr]] = [[] for _ in variables]
    for term in sympy.Add.make_args(expr):
        for symbol, derivative in _partial_derivatives(term, position.keys(), effort):
            parts[position[symbol]].append(derivative)
    return [sympy.Add(*part) for part in parts]


def term_places(
    terms: Iterable[sympy.Expr], variables: Sequence[sympy.Symbol]
) -> list[dict[sympy.Expr, int]]:
    """Positions in a sum of the first terms whose derivatives contain a term, for each variable.

    Terms of derivatives are without their coefficients.

    Examples
    --------
    >>> x, y = sympy.symbols("x y")
    >>> term_places([x*y, x**3/3], (x, y))
    [{y: 0, x**2: 1}, {x: 0}]
    """
    position = {variable: i for i, variable in enumerate(variables)}
    found: list[dict[sympy.Expr, int]] = [{} for _ in variables]
    for place, term in enumerate(terms):
        for symbol, derivative in _partial_derivatives(term, position.keys()):
            for part in sympy.Add.make_args(derivative):
                found[position[symbol]].setdefault(part.as_coeff_Mul()[1], place)
    return found


def hessian(
    first: Sequence[sympy.Expr], variables: Sequence[sympy.Symbol], effort: Effort | None = None
) -> dict[tuple[int, int], sympy.Expr]:
    """Compute nonzero second derivatives by (i, j), both triangles, from the first ones."""
    position = {variable: i for i, variable in enumerate(variables)}
    parts: dict[tuple[int, int], list[sympy.Expr]] = defaultdict(list)
    for i, slope in enumerate(first):
        later = {variable: j for variable, j in position.items() if j >= i}
        for term in sympy.Add.make_args(slope):
            for symbol, derivative in _partial_derivatives(term, later.keys(), effort):
                parts[i, later[symbol]].append(derivative)
    entries: dict[tuple[int, int], sympy.Expr] = {}
    for (i, j), part in sorted(parts.items()):
        entry = sympy.Add(*part)
        if entry != 0:
            entries[i, j] = entries[j, i] = entry
    return entries


def poisson_rows(
    entries: Mapping[tuple[int, int], sympy.Expr], half: int
) -> dict[tuple[int, int], sympy.Expr]:
    """Multiply a sparse matrix with 2 half rows by J from the left; sorted by (i, j).

    Examples
    --------
    >>> x = sympy.Symbol("x")
    >>> poisson_rows({(0, 1): x}, 1)
    {(1, 1): -x}
    """
    found = {
        (i - half, j) if i >= half else (i + half, j): entry if i >= half else -entry
        for (i, j), entry in entries.items()
    }
    return dict(sorted(found.items()))


def connected_blocks(pairs: Sequence[tuple[int, int]], size: int) -> list[list[int]]:
    """Connected components of a symmetric sparsity pattern, as sorted index lists.

    Examples
    --------
    >>> connected_blocks([(0, 2), (2, 0)], 3)
    [[0, 2], [1]]
    """
    return sorted(map(sorted, connected_components((list(range(size)), pairs))))


def smallest_singular_value(
    entries: dict[tuple[int, int], sympy.Expr], size: int
) -> sympy.Expr | None:
    """Smallest singular value of a symmetric matrix with blocks of at most 2 x 2, else None.

    Examples
    --------
    >>> x = sympy.Symbol("x", real=True)
    >>> smallest_singular_value({(0, 1): x, (1, 0): x, (2, 2): 1 + x**2}, 3)
    Min(x**2 + 1, Abs(x))
    """
    zero = sympy.Integer(0)
    magnitudes = set()
    for block in connected_blocks(list(entries), size):
        if len(block) > 2:
            return None
        if len(block) == 1:
            magnitudes.add(sympy.Abs(entries.get((block[0], block[0]), zero)))
            continue
        i, j = block
        a, b, c = (entries.get(index, zero) for index in ((i, i), (i, j), (j, j)))
        # The eigenvalues are middle +- radius.
        middle = _factored((a + c) / 2)
        radius = sympy.sqrt(_factored(((a - c) / 2) ** 2 + b**2))
        magnitudes.add(sympy.Abs(sympy.Abs(middle) - radius) if middle else radius)
    return sympy.Min(*magnitudes)


def _factored(expr: sympy.Expr) -> sympy.Expr:
    """An expression over one denominator and in factors, if it is short and becomes shorter."""
    plain = sympy.factor_terms(expr)
    if expr.count_ops() > _MOST_FACTORED:
        return plain
    return min(plain, sympy.factor(sympy.together(expr)), key=sympy.count_ops)


def split(
    expr: sympy.Expr, q: Sequence[sympy.Symbol], p: Sequence[sympy.Symbol]
) -> tuple[sympy.Expr, sympy.Expr]:
    """Split a sum into T(p) and V(q); V contains the terms without p."""
    for form in (lambda e: e, sympy.expand, sympy.simplify):
        terms = sympy.Add.make_args(form(expr))
        with_p = [term for term in terms if term.free_symbols & set(p)]
        if not any(term.free_symbols & set(q) for term in with_p):
            return sympy.Add(*with_p), sympy.Add(*(t for t in terms if t not in with_p))
    infinite = (sympy.zoo, sympy.nan, sympy.oo, -sympy.oo, sympy.I)
    for numerator in (2, 1, 3, 5, 7, 11):
        potential = expr.xreplace(dict.fromkeys(p, sympy.Rational(numerator, 2)))
        if not potential.has(*infinite):
            break
    return sympy.simplify(expr - potential), potential


def vanishes(expr: sympy.Expr) -> bool:
    """Whether an expression is identically zero.

    The expression is simplified only if it is zero at random points, which is cheap to test.
    """
    if expr.is_zero is not None:
        return bool(expr.is_zero)
    return is_zero_at_random_points(expr) and (_cancels(expr) or bool(sympy.simplify(expr) == 0))


def is_zero_at_random_points(expr: sympy.Expr) -> bool:
    """Whether an expression is zero to 20 digits at three random points, or has no value there."""
    return not any(value.is_Float and abs(value) > 1e-20 for value in _random_values(expr))


def may_vanish(expr: sympy.Expr) -> bool:
    """Whether no digit of an expression is known at three random points, in whatever units.

    Examples
    --------
    >>> x = sympy.Symbol("x", real=True)
    >>> may_vanish(sympy.atan(x) + sympy.atan(1 / x) - sympy.pi / 2), may_vanish(x / 10**40)
    (True, False)
    """
    parts = (part for value in _random_values(expr) for part in value.as_real_imag())
    # Sympy gives one bit to what it cannot tell from zero.
    return not any(part.is_Float and part != 0 and part._prec > 1 for part in parts)


def _random_values(expr: sympy.Expr) -> Iterator[sympy.Expr]:
    generator = random.Random(0)
    symbols = sorted(expr.free_symbols, key=str)
    for _ in range(3):
        point = {symbol: sympy.Rational(generator.randint(1, 999), 500) for symbol in symbols}
        yield expr.xreplace(point).evalf(30)


def _cancels(expr: sympy.Expr) -> bool:
    """Whether all terms cancel once expanded, or as a fraction of polynomials in sines and cosines.

    That is all it takes for most brackets, and far faster than to simplify them.
    """
    if sympy.expand(expr) == 0:
        return True
    angles = [function.args[0] for function in expr.atoms(sympy.sin, sympy.cos)]
    # sin(x/2) beside sin(x): with x twice as long, both are polynomials in sin(x) and cos(x).
    parts = {symbol: 1 for angle in angles for symbol in angle.free_symbols}
    for angle, symbol in itertools.product(angles, parts):
        if (factor := angle.coeff(symbol)).is_Rational:
            parts[symbol] = math.lcm(parts[symbol], factor.q)
    expr = sympy.expand_trig(expr.xreplace({s: part * s for s, part in parts.items()}))
    arguments = {function.args[0] for function in expr.atoms(sympy.sin, sympy.cos)}
    if not arguments or len(arguments) > _MOST_ANGLES:
        return False
    pairs = {argument: (sympy.Dummy(), sympy.Dummy()) for argument in arguments}
    values = {
        function(argument): symbol
        for argument, pair in pairs.items()
        for function, symbol in zip((sympy.sin, sympy.cos), pair, strict=True)
    }
    rest = sympy.expand(sympy.numer(sympy.together(expr.xreplace(values))))
    for sine, cosine in pairs.values():
        rest = sympy.expand(sympy.rem(rest, sine**2 + cosine**2 - 1, sine))
    return bool(rest == 0)


def switches(
    expr: sympy.Expr, gradient: Sequence[sympy.Expr], z: Sequence[sympy.Symbol]
) -> list[tuple[sympy.Expr, list[sympy.Expr]]]:
    """Discontinuities of H and its gradient: pairs (function, jumps where the function is zero).

    The jumps are those of the gradient, followed by that of H. Where the gradient does not jump at
    the cut of an angle atan2, the constant by which H jumps there is left out: with the angle that
    is continued, H is smooth.
    """
    jumping = [*gradient, expr]
    steps = {
        step
        for term in jumping
        for step in term.atoms(sympy.sign, sympy.Heaviside)
        if step.args[0].free_symbols & set(z)
    }
    found = []
    for step in sorted(steps, key=str):
        high, low = sympy.Integer(1), sympy.Integer(-1 if isinstance(step, sympy.sign) else 0)
        jumps = [term.xreplace({step: high}) - term.xreplace({step: low}) for term in jumping]
        found.append((step.args[0], jumps))
    for angle, jumps in angle_jumps(expr, gradient, z):
        if any(jump != 0 for jump in jumps[:-1]):
            beyond = sympy.Heaviside(-angle.args[1])  # the cut is the negative half of an axis
            found.append((angle.args[0], [beyond * jump for jump in jumps]))
    return found


def angle_jumps(
    expr: sympy.Expr, gradient: Sequence[sympy.Expr], z: Sequence[sympy.Symbol]
) -> Iterator[tuple[sympy.Expr, list[sympy.Expr]]]:
    """Jumps of the gradient, then of H, at the cut of each angle atan2."""
    jumping = [*gradient, expr]
    angles = {angle for term in jumping for angle in term.atoms(sympy.atan2)}
    for angle in sorted(angles, key=str):
        if angle.free_symbols & set(z):
            jumps = [
                term.xreplace({angle: sympy.pi}) - term.xreplace({angle: -sympy.pi})
                for term in jumping
            ]
            yield angle, [sympy.Integer(0) if vanishes(jump) else jump for jump in jumps]


def switch_arguments(
    expr: sympy.Expr, wanted: Collection[sympy.Symbol], excluded: Collection[sympy.Symbol]
) -> list[sympy.Expr]:
    """Arguments of abs, sign, Heaviside, Min and Max that contain some symbols and not others.

    Examples
    --------
    >>> x, t = sympy.symbols("x t", real=True)
    >>> switch_arguments(x*sympy.sign(t - 1) + abs(x) + sympy.Max(t, 2), {t}, {x})
    [t - 1, t - 2]
    """
    found = {f.args[0] for f in expr.atoms(sympy.Abs, sympy.sign, sympy.Heaviside)}
    for choice in expr.atoms(sympy.Min, sympy.Max):
        ordered = sorted(choice.args, key=str, reverse=True)
        found |= {one - other for one, other in itertools.combinations(ordered, 2)}
    known, others = {*wanted}, {*excluded}
    kept = (g for g in found if g.free_symbols & known and not g.free_symbols & others)
    return sorted(kept, key=str)


class Narrow(enum.IntEnum):
    """Kind of an argument, which determines where its function varies and on which scale.

    FUNCTION, an argument of exp, tanh and similar functions: near its zeros and extrema, on the
    scale of a change by 1. BASE, the base of a negative or fractional power or an argument whose
    zero is a pole or the end of a domain: near its zeros and extrema, on the scale of its own size.
    SWITCH, an argument of abs, sign, Min or Max: the same as BASE.
    """

    FUNCTION, BASE, SWITCH = range(3)


def narrow_arguments(
    expr: sympy.Expr, variables: Sequence[sympy.Symbol]
) -> list[tuple[sympy.Expr, Narrow]]:
    """Arguments of functions that may vary only in a small part of phase space or of time.

    Pulses, steps and poles are near the zeros and extrema of these arguments.

    Examples
    --------
    >>> x, t = sympy.symbols("x t", real=True)
    >>> [(str(g), kind.name) for g, kind in narrow_arguments(sympy.exp(-t**2) / x, [x, t])]
    [('-t**2', 'FUNCTION'), ('x', 'BASE')]
    """
    known = set(variables)
    found = {(function.args[0], Narrow.FUNCTION) for function in expr.atoms(*_LOCALISED)}
    for power in expr.atoms(sympy.Pow):
        exponent = power.exp
        if not exponent.is_number:
            found.add((exponent * sympy.log(power.base), Narrow.FUNCTION))
        elif exponent.is_negative or not exponent.is_integer:
            found.add((power.base, Narrow.BASE))
        if exponent.is_number and abs(exponent) > _HIGH_POWER:
            found.add((exponent * sympy.log(sympy.Abs(power.base)), Narrow.FUNCTION))
    found |= {(f.args[0], Narrow.BASE) for f in expr.atoms(sympy.log, sympy.coth, sympy.csch)}
    found |= {(sympy.cos(f.args[0]), Narrow.BASE) for f in expr.atoms(sympy.tan, sympy.sec)}
    found |= {(sympy.sin(f.args[0]), Narrow.BASE) for f in expr.atoms(sympy.cot, sympy.csc)}
    switches = (sympy.Abs, sympy.sign, sympy.Heaviside)
    found |= {(switch.args[0], Narrow.SWITCH) for switch in expr.atoms(*switches)}
    for choice in expr.atoms(sympy.Min, sympy.Max):
        pairs = itertools.combinations(choice.args, 2)
        found |= {(one - other, Narrow.SWITCH) for one, other in pairs}
    return sorted((entry for entry in found if entry[0].free_symbols & known), key=str)
