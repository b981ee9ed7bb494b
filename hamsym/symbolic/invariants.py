"""Search for first integrals, and their proof.

Stage 1  Monomials in the state and in basis functions, up to a total degree, are candidates.
Stage 2  Their time derivatives are evaluated at random points modulo a prime; the null space of
         that matrix has the functions that may be invariant, and the terms that each consists of.
Stage 3  Products of invariants that are known are removed.
Stage 4  The coefficients of each function are computed exactly from the identity {f, H} = 0.
Stage 5  The finished formula is proven anew; a function without proof is not returned.
"""

from __future__ import annotations

import itertools
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
import sympy
from sympy.polys.matrices import DomainMatrix
from sympy.polys.rings import PolyElement

from hamsym.errors import InputError
from hamsym.formula.effort_limit import CallLimitExceededError, call_limit
from hamsym.formula.printer import FormulaPrinter
from hamsym.symbolic import brackets, derivatives
from hamsym.symbolic.differential_ring import PRIME, DifferentialRing
from hamsym.symbolic.equations import Equations
from hamsym.symbolic.exact import rational
from hamsym.symbolic.generators import UnsupportedFunctionError
from hamsym.symbolic.invariant import Invariant

_MOST_MONOMIALS = 3_000  # of one homogeneous part, whose matrix is dense
_MOST_CANDIDATES = 20_000  # monomials in all
_MOST_PRODUCTS = 3_000  # of known invariants
_MOST_TERMS = 400  # of one invariant
_STEPS = (sympy.sign, sympy.Heaviside, sympy.floor, sympy.ceiling, sympy.Mod, sympy.Piecewise)
_SPARE = 12  # points beyond the number of unknowns


def is_proven(
    f: sympy.Expr, H: sympy.Expr, z: Sequence[sympy.Symbol], time: sympy.Symbol | None
) -> bool:
    """Whether the exact normal form of {f, H} + (partial f)/(partial t) is zero.

    Floating-point numbers count as the binary fractions that they are. False is no proof of the
    contrary. The time must be given if f or H contains it: any other symbol is a constant.

    Examples
    --------
    >>> x, p = z = sympy.symbols("x p", real=True)
    >>> is_proven(p**2 + x**2, p**2 / 2 + x**2 / 2, z, None)
    True
    >>> is_proven(p**2 + (1 + sympy.Float(1e-12)) * x**2, p**2 / 2 + x**2 / 2, z, None)
    False
    """
    if _is_piecewise_constant(f, z) or _divides_by_zero(f):
        return False
    try:
        known = DifferentialRing(H, z, time, [f])
    except UnsupportedFunctionError:
        return False
    return known.vanishes(known.rate(known[f]))


def is_conserved(
    f: sympy.Expr, equations: Equations, time: sympy.Symbol | None, every: Sequence[str] = ()
) -> bool:
    """Whether f is constant along every trajectory; see Hamiltonian.is_conserved.

    Functions that are nothing but steps, as abs(x)/x, are refused, and those with a denominator
    that is identically zero.

    - f, time: In real symbols; the time must be given if f or H contains it.
    """
    if any(step.free_symbols & {*equations.z, time} for step in f.atoms(*_STEPS)):
        return False
    values = {s: value for s, value in equations.fractions.items() if s.name not in every}
    # Without the values first: their fractions are long.
    for given in ({}, values) if values else ({},):
        own, H, *forces = (e.xreplace(given) for e in (f, *equations.formulas))
        rate = brackets.evolution(own, H, equations.z, time, forces)
        # Points first: most functions are not conserved. Sympy's simplification last: it is slow,
        # and it is needed for functions without exact rules only.
        if derivatives.is_zero_at_random_points(rate) and (
            (not forces and is_proven(own, H, equations.z, time))
            or (
                derivatives.vanishes(rate)
                and not _is_piecewise_constant(own, equations.z)
                and not _divides_by_zero(own)
            )
        ):
            return True
    return False


def _is_piecewise_constant(f: sympy.Expr, z: Sequence[sympy.Symbol]) -> bool:
    """Whether the gradient of a function of the state may be zero everywhere."""
    own = f.free_symbols.intersection(z)
    return bool(own) and all(derivatives.may_vanish(sympy.diff(f, symbol)) for symbol in own)


def _divides_by_zero(f: sympy.Expr) -> bool:
    """Whether a denominator may be zero everywhere."""
    powers = (power for power in f.atoms(sympy.Pow) if power.exp.could_extract_minus_sign())
    return any(derivatives.may_vanish(power.base) for power in powers)


def suggested_basis(H: sympy.Expr, z: Sequence[sympy.Symbol]) -> list[sympy.Expr]:
    """Return the functions in H that are not polynomial, as basis functions.

    Powers of one base are those of its smallest exponent. Logarithms are left out.

    Examples
    --------
    >>> x, y, p = sympy.symbols("x y p", real=True)
    >>> suggested_basis(p**2 + (x**2 + y**2) ** sympy.Rational(-3, 2) + sympy.cos(x), (x, y, p))
    [(x**2 + y**2)**(-3/2), cos(x), sin(x)]
    """
    state = set(z)
    found: set[sympy.Expr] = set()
    powers: dict[sympy.Expr, list[sympy.Expr]] = {}
    for node in H.atoms(sympy.Pow, sympy.Function):
        if not node.free_symbols & state or isinstance(node, sympy.log):
            continue
        if node.is_Pow and node.base is not sympy.E:
            if not (node.exp.is_Integer and node.exp > 0):
                powers.setdefault(node.base, []).append(node.exp)
        elif isinstance(node, sympy.sin | sympy.cos | sympy.tan):
            found.update((sympy.sin(node.args[0]), sympy.cos(node.args[0])))
        elif isinstance(node, sympy.sinh | sympy.cosh | sympy.tanh):
            found.update((sympy.sinh(node.args[0]), sympy.cosh(node.args[0])))
        else:
            found.add(node)
    for base, exponents in powers.items():
        smallest = min(exponents, key=lambda e: (not e.is_number, abs(e) if e.is_number else 0))
        found.add(base**smallest)
    return sorted(found, key=str)


def find_invariants(
    H: sympy.Expr,
    z: Sequence[sympy.Symbol],
    time_symbol: sympy.Symbol | None,
    values: Mapping[sympy.Symbol, float],
    degree: int,
    basis: Sequence[sympy.Expr],
    seconds: float,
) -> list[Invariant]:
    """Return a reduced list of invariants of H, each with its proof done.

    Raise InputError if there are too many monomials, the time is over, or H has a function without
    exact rules.

    - H: In real symbols.
    - time_symbol: The time, whether H contains it or not; None if its name is taken.
    - values: Values of parameters: invariants for all values are searched first, then those for
      these values.
    - basis: Functions that count as variables beside the state.
    - seconds: Limit of time.
    """
    limit = (time.monotonic() + seconds, seconds)
    bound = {symbol: value for symbol, value in values.items() if symbol in H.free_symbols}
    trials = ({}, bound) if bound else ({},)
    found: list[Invariant] = []
    refused: list[UnsupportedFunctionError] = []
    for given in trials:
        exact = {symbol: rational(value) for symbol, value in given.items()}
        named = MappingProxyType({symbol.name: value for symbol, value in given.items()})
        known = [(own.expr.xreplace(exact), own.degree) for own in found]
        functions = [function.xreplace(exact) for function in basis]
        try:
            search = _Search(H.xreplace(exact), z, time_symbol, degree, functions, known, limit)
            found += [Invariant(*result, holds_for=named) for result in search.run()]
        except UnsupportedFunctionError as error:  # H may have rules with the values in exponents
            refused.append(error)
    if len(refused) == len(trials):
        raise refused[-1]
    return found


class _Search:
    """The search for one Hamiltonian, with all numbers exact."""

    def __init__(
        self,
        H: sympy.Expr,
        z: Sequence[sympy.Symbol],
        time_symbol: sympy.Symbol | None,
        degree: int,
        basis: Sequence[sympy.Expr],
        known: Sequence[tuple[sympy.Expr, int]],
        limit: tuple[float, float],
    ) -> None:
        self._H, self._z, self._time, self._degree = H, tuple(z), time_symbol, degree
        timed = any(time_symbol in expr.free_symbols for expr in (H, *basis))
        variables = [*z, *([time_symbol] if timed else []), *basis]
        self._variables = list(dict.fromkeys(variables))
        self._limit = limit
        count = sum(1 for _ in itertools.islice(self._exponents(degree), _MOST_CANDIDATES + 1))
        if count > _MOST_CANDIDATES:
            raise InputError(
                f"degree={degree} in {len(self._variables)} variables and basis functions has more "
                f"than {_MOST_CANDIDATES:,} monomials; use a lower degree or fewer basis functions"
            )
        self._ring = DifferentialRing(H, z, time_symbol, [*basis, *(expr for expr, _ in known)])
        self._elements = [
            self._ring.ring.from_expr(variable) if variable.is_Symbol else self._ring[variable]
            for variable in self._variables
        ]
        self._random = np.random.default_rng(0)
        #: Known invariants as polynomials of the ring, with their degrees.
        self._known = [(self._ring[expr], order) for expr, order in known]
        if time_symbol not in H.free_symbols:
            self._known.insert(0, (self._ring[H], 1))

    def _exponents(self, degree: int) -> Iterator[tuple[int, ...]]:
        """Yield exponents of all monomials up to the degree, the lowest degrees first."""
        count = len(self._variables)
        for total in range(degree + 1):
            for chosen in itertools.combinations_with_replacement(range(count), total):
                exponents = [0] * count
                for i in chosen:
                    exponents[i] += 1
                yield tuple(exponents)

    def run(self) -> list[tuple[sympy.Expr, int, bool]]:
        """Return the invariants: formula, degree, and whether it is functionally independent."""
        found = []
        for degree in range(1, self._degree + 1):
            for group in self._groups(degree):
                for polynomial, expr in self._new(group, degree):
                    independent = self._is_independent(polynomial)
                    self._known.append((polynomial, degree))
                    found.append((expr, degree, independent))
        return found

    def _check_time(self) -> None:
        if not time.monotonic() <= self._limit[0]:
            raise InputError(self._late)

    @property
    def _late(self) -> str:
        return (
            f"the search for invariants did not end in {self._limit[1]:g} s; use a lower degree, "
            "fewer basis functions or a larger time_limit"
        )

    # -- monomials ---------------------------------------------------------------------------

    def _groups(self, degree: int) -> list[list[tuple[int, ...]]]:
        """Return the monomials in homogeneous parts, each of which is searched by itself."""
        groups: dict[tuple[int, ...], list[tuple[int, ...]]] = {}
        momenta = self._z[len(self._z) // 2 :]
        # A reversible motion: even and odd parts in p are invariants.
        timed = self._time in self._variables
        even = not timed and self._ring.is_even_in(momenta, self._ring[self._H])
        odd = [int(even and variable in momenta) for variable in self._variables]
        for exponents in self._exponents(degree):
            key = (*(_dot(exponents, weight) for weight in self._weights), _dot(exponents, odd) % 2)
            groups.setdefault(key, []).append(exponents)
        largest = max(len(group) for group in groups.values())
        if largest > _MOST_MONOMIALS:
            raise InputError(
                f"degree={self._degree} in {len(self._variables)} variables and basis functions "
                f"has {largest:,} monomials that cannot be separated, more than "
                f"{_MOST_MONOMIALS:,}; use a lower degree or fewer basis functions"
            )
        return [group for group in groups.values() if any(sum(e) == degree for e in group)]

    @cached_property
    def _weights(self) -> list[list[int]]:
        """Weights of the variables for which the equations are homogeneous."""
        found = []
        for grading in self._ring.gradings():
            sums = [{_dot(exponents, grading) for exponents in each} for each in self._elements]
            if all(len(own) == 1 for own in sums):
                found.append([own.pop() for own in sums])
        return found

    # -- one homogeneous part ----------------------------------------------------------------

    def _new(
        self, group: list[tuple[int, ...]], degree: int
    ) -> Iterator[tuple[PolyElement, sympy.Expr]]:
        """Yield the invariants in a part that products of known ones do not span."""
        self._check_time()
        count = len(group) + len([*self._choices(degree)]) + _SPARE
        points = self._ring.points(count, self._random)
        values, rates = self._matrices(group, points)
        # Monomials that are linear combinations of earlier ones as functions.
        _, pivots = _echelon(values)
        group = [group[i] for i in pivots]
        values, rates = values[:, pivots], rates[:, pivots]
        self._check_time()
        null = _null_space(rates)
        if not null:
            return
        functions = [_combination(values, vector) for vector in null]
        products = self._products(degree, points)
        columns = [np.ones(count, dtype=np.int64), *products]
        _, pivots = _echelon(np.stack([*columns, *functions], axis=1))
        for place in pivots:
            if place < len(columns):
                continue
            self._check_time()
            terms = [group[i] for i in sorted(null[place - len(columns)])]
            with self._limited():
                found = self._proven(terms)
            if found is not None:
                yield found

    @contextmanager
    def _limited(self) -> Iterator[None]:
        """Stop a computation when the time is over."""
        try:
            with call_limit(sys.maxsize, max(self._limit[0] - time.monotonic(), 0.0)):
                yield
        except CallLimitExceededError:
            raise InputError(self._late) from None

    def _proven(self, terms: Sequence[tuple[int, ...]]) -> tuple[PolyElement, sympy.Expr] | None:
        """Return the invariant that consists of the terms, or None if there is no proof."""
        exact = self._exact(terms)
        if exact is None:
            return None
        expr = self._formula(terms, exact)
        if FormulaPrinter()(expr).startswith("-"):
            expr, exact = -expr, [-coefficient for coefficient in exact]
        if not is_proven(expr, self._H, self._z, self._time):
            return None
        return self._polynomial(terms, exact), expr

    def _matrices(
        self, group: Sequence[tuple[int, ...]], points: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return values and time derivatives of monomials at points, shape (points, monomials)."""
        bases = [self._ring.values(element, points) for element in self._elements]
        slopes = [self._ring.values(self._ring.rate(element), points) for element in self._elements]
        most = max(max(exponents) for exponents in group)
        powers = []
        for base in bases:
            own = [np.ones_like(base)]
            for _ in range(most):
                own.append(own[-1] * base % PRIME)
            powers.append(own)
        values, rates = np.zeros((2, len(points), len(group)), dtype=np.int64)
        for j, exponents in enumerate(group):
            factors = [powers[i][e] for i, e in enumerate(exponents) if e]
            values[:, j] = _product(factors, len(points))
            for i, e in enumerate(exponents):
                if e:
                    others = [powers[k][f] for k, f in enumerate(exponents) if f and k != i]
                    slope = _product([powers[i][e - 1], slopes[i], *others], len(points))
                    rates[:, j] = (rates[:, j] + e * slope) % PRIME
        return values, rates

    def _choices(self, degree: int) -> Iterator[tuple[int, ...]]:
        """Yield the products of known invariants up to a degree, as multisets."""

        def extended(first: int, left: int) -> Iterator[tuple[int, ...]]:
            for i in range(first, len(self._known)):
                order = self._known[i][1]
                if order <= left:
                    yield (i,)
                    for rest in extended(i, left - order):
                        yield (i, *rest)

        return itertools.islice(extended(0, degree), _MOST_PRODUCTS)

    def _products(self, degree: int, points: np.ndarray) -> list[np.ndarray]:
        values = [self._ring.values(polynomial, points) for polynomial, _ in self._known]
        return [
            _product([values[i] for i in chosen], len(points)) for chosen in self._choices(degree)
        ]

    # -- exact coefficients ------------------------------------------------------------------

    def _monomial(self, exponents: Sequence[int]) -> PolyElement:
        value = self._ring.ring(1)
        for element, exponent in zip(self._elements, exponents, strict=True):
            if exponent:
                value *= element**exponent
        return value

    def _exact(self, terms: Sequence[tuple[int, ...]]) -> list[sympy.Expr] | None:
        """Return coefficients with which the terms are an invariant, or None."""
        if len(terms) > _MOST_TERMS:
            return None
        rates = [self._ring.rate(self._monomial(term)) for term in terms]
        # Often no relation between generators is needed, and normal forms may be long.
        found = self._identity(rates)
        return self._identity(self._ring.normal_forms(rates)) if found is None else found

    def _identity(self, rates: Sequence[PolyElement]) -> list[sympy.Expr] | None:
        """Return the coefficients with which polynomials add up to zero, if they are unique."""
        ring = self._ring
        constants = ring.constants
        domain = sympy.QQ
        if constants:
            domain = sympy.QQ.frac_field(*(ring.symbols[i] for i in constants))
        rows: dict[tuple[int, ...], dict[int, Any]] = {}
        for j, rate in enumerate(rates):
            for exponents, coefficient in rate.items():
                key = tuple(0 if i in constants else e for i, e in enumerate(exponents))
                entry = domain(coefficient)
                for place, i in enumerate(constants):
                    entry *= domain.gens[place] ** exponents[i]
                row = rows.setdefault(key, {})
                row[j] = row.get(j, domain.zero) + entry
        matrix = DomainMatrix(dict(enumerate(rows.values())), (len(rows), len(rates)), domain)
        null = matrix.nullspace()
        if null.shape[0] != 1:
            return None
        vector = [
            ring.generators.with_fractions(domain.to_sympy(entry)) for entry in null.to_list()[0]
        ]
        return self._cleared(vector)

    def _cleared(self, vector: Sequence[sympy.Expr]) -> list[sympy.Expr]:
        """Return coefficients without common factors and denominators."""
        common = sympy.lcm_list([sympy.fraction(sympy.together(entry))[1] for entry in vector])
        whole = [sympy.cancel(entry * common) for entry in vector]
        factor = sympy.gcd_list(whole)
        return [sympy.cancel(entry / factor) for entry in whole]

    def _polynomial(
        self, terms: Sequence[tuple[int, ...]], coefficients: Sequence[sympy.Expr]
    ) -> PolyElement:
        total = self._ring.ring(0)
        for term, coefficient in zip(terms, coefficients, strict=True):
            total += self._ring.ring.from_expr(coefficient) * self._monomial(term)
        return total

    def _formula(
        self, terms: Sequence[tuple[int, ...]], coefficients: Sequence[sympy.Expr]
    ) -> sympy.Expr:
        """Return the invariant in the symbols of H."""
        return sympy.Add(
            *(
                sympy.expand(self._ring.generators.formula(coefficient))
                * sympy.Mul(*(v**e for v, e in zip(self._variables, term, strict=True) if e))
                for term, coefficient in zip(terms, coefficients, strict=True)
            )
        )

    def _is_independent(self, polynomial: PolyElement) -> bool:
        """Whether the gradient is independent of those of known invariants at a random point."""
        point = self._ring.points(1, self._random)
        gradients = np.array(
            [
                [self._ring.values(slope, point)[0] for slope in self._ring.gradient(own)]
                for own in (*(known for known, _ in self._known), polynomial)
            ]
        )
        return len(_echelon(gradients)[1]) > len(_echelon(gradients[:-1])[1])


def _dot(exponents: Sequence[int], weights: Sequence[int]) -> int:
    return sum(e * w for e, w in zip(exponents, weights, strict=True))


def _product(factors: Sequence[np.ndarray], count: int) -> np.ndarray:
    value = np.ones(count, dtype=np.int64)
    for factor in factors:
        value = value * factor % PRIME
    return value


def _echelon(matrix: np.ndarray) -> tuple[Any, list[int]]:
    """Return the reduced row echelon form modulo PRIME, and the columns of its pivots."""
    import flint

    rows, columns = matrix.shape
    if not rows or not columns:
        return None, []
    reduced, rank = flint.nmod_mat(rows, columns, matrix.ravel().tolist(), PRIME).rref()
    pivots, column = [], 0
    for row in range(rank):
        while int(reduced[row, column]) == 0:
            column += 1
        pivots.append(column)
    return reduced, pivots


def _null_space(matrix: np.ndarray) -> list[dict[int, int]]:
    """Return the null vectors modulo PRIME by their entries that are not zero."""
    reduced, pivots = _echelon(matrix)
    found = []
    for free in sorted(set(range(matrix.shape[1])) - set(pivots)):
        vector = {free: 1}
        for row, pivot in enumerate(pivots):
            if pivot > free:
                break
            if entry := int(reduced[row, free]):
                vector[pivot] = PRIME - entry
        found.append(vector)
    return found


def _combination(values: np.ndarray, vector: Mapping[int, int]) -> np.ndarray:
    total = np.zeros(len(values), dtype=np.int64)
    for place, coefficient in vector.items():
        total = (total + values[:, place] * coefficient) % PRIME
    return total
