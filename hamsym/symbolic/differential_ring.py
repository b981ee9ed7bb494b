"""Exact derivatives and proofs of identities of functions on phase space.

A formula is rewritten as a polynomial in generators: the symbols, and one generator for each root,
inverse, exponential, angle and logarithm in it. True relations between generators (r^2 = x^2 + y^2,
u r = 1, sin^2 + cos^2 = 1) and their derivatives turn the time derivative of a function into
polynomial arithmetic over the rational numbers. A polynomial whose normal form is zero is zero as a
function; relations that are not listed, such as that of sqrt(x) and sqrt(4 x), can only leave a
zero unrecognised.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import sympy
from sympy.polys.rings import PolyElement, PolyRing, ring

from hamsym.symbolic.generators import Generators, UnsupportedFunctionError

#: A prime p with (p - 1)/2 prime: roots of odd order exist and are unique, squares have (p+1)/4.
PRIME = 2147483579


class DifferentialRing:
    """Polynomials in generators that represent given formulas, with the derivative along H.

    Raise UnsupportedFunctionError if a formula has a function without exact rules.

    - z: The state (q, p).
    - time: The time, whose derivative is 1.
    - formulas: Further formulas to represent.

    Examples
    --------
    >>> x, y, p, w = z = sympy.symbols("x y p w", real=True)
    >>> H = (p**2 + w**2) / 2 - 1 / sympy.sqrt(x**2 + y**2)
    >>> momentum = x * w - y * p
    >>> known = DifferentialRing(H, z, None, [momentum, p])
    >>> known.vanishes(known.rate(known[momentum])), known.vanishes(known.rate(known[p]))
    (True, False)
    """

    def __init__(
        self,
        H: sympy.Expr,
        z: Sequence[sympy.Symbol],
        time: sympy.Symbol | None,
        formulas: Iterable[sympy.Expr] = (),
    ) -> None:
        self.z, self.time = tuple(z), time
        wanted = [H, *formulas]
        self.generators = Generators(z, time, wanted)
        self._generators = self.generators.of
        self.symbols = tuple(self._generators)
        self.ring: PolyRing = ring(self.symbols, sympy.QQ)[0]
        self._index = {symbol: i for i, symbol in enumerate(self.symbols)}
        self._parts = {
            symbol: tuple(map(self.ring.from_expr, generator.parts))
            for symbol, generator in self._generators.items()
        }
        self._elements = {
            expr: self.ring.from_expr(element)
            for expr, element in zip(wanted, self.generators.formulas, strict=True)
        }
        d = len(self.z) // 2
        #: Derivatives of every generator with respect to each component of the state.
        self._partial = [
            self._derivation({symbol: self.ring(int(symbol == own)) for symbol in self.z}, 0)
            for own in self.z
        ]
        slopes = [self._derive(self._elements[H], rates) for rates in self._partial]
        flow = dict(zip(self.z, [*slopes[d:], *(-slope for slope in slopes[:d])], strict=True))
        self._rates = self._derivation(flow, 1)
        self._fixed: dict[int, int] | None = None  # values of constants modulo PRIME

    def __getitem__(self, expr: sympy.Expr) -> PolyElement:
        """The polynomial of one of the given formulas."""
        return self._elements[expr]

    @property
    def constants(self) -> list[int]:
        """Places of the generators that do not depend on the state or the time."""
        return [
            i
            for i, symbol in enumerate(self.symbols)
            if symbol not in self.z
            and symbol != self.time
            and not self._rates[symbol]
            and not any(rates[symbol] for rates in self._partial)
        ]

    # -- derivatives -------------------------------------------------------------------------

    def _derivation(
        self, states: Mapping[sympy.Symbol, PolyElement], of_time: int
    ) -> dict[sympy.Symbol, PolyElement]:
        """Return the derivatives of all generators from those of the state and the time."""
        rates: dict[sympy.Symbol, PolyElement] = {}
        for symbol, generator in self._generators.items():
            own, parts = self._gen(symbol), self._parts[symbol]
            slope = self._derive(parts[0], rates) if parts else self.ring(0)
            match generator.kind:
                case "state":
                    rates[symbol] = states[symbol]
                case "time":
                    rates[symbol] = self.ring(of_time)
                case "parameter" | "constant":
                    rates[symbol] = self.ring(0)
                case _ if not slope:
                    rates[symbol] = slope
                case "root":
                    inverse = self._gen(self.generators.named("inverse", (symbol,)))
                    factor = sympy.QQ(1, generator.order)
                    rates[symbol] = slope * inverse ** (generator.order - 1) * factor
                case "inverse":
                    rates[symbol] = -slope * own**2
                case "exp":
                    rates[symbol] = slope * own
                case "cos":
                    partner = self.generators.named("sin", generator.parts)
                    rates[symbol] = -slope * self._gen(partner)
                case "sin":
                    assert generator.partner is not None
                    rates[symbol] = slope * self._gen(generator.partner)
                case "log":
                    inverse = self.generators.inverse(generator.parts[0])
                    rates[symbol] = slope * self.ring.from_expr(inverse)
                case _:
                    rates[symbol] = slope * parts[1]
        return rates

    def _gen(self, symbol: sympy.Symbol) -> PolyElement:
        return self.ring.gens[self._index[symbol]]

    def _derive(
        self, polynomial: PolyElement, rates: Mapping[sympy.Symbol, PolyElement]
    ) -> PolyElement:
        """Differentiate by the chain rule; generators without a rate yet do not occur."""
        total = self.ring(0)
        used = {i for exponents in polynomial for i, e in enumerate(exponents) if e}
        for i in sorted(used):
            rate = rates[self.symbols[i]]
            if rate:
                total += polynomial.diff(self.ring.gens[i]) * rate
        return self._cancelled(total)

    def rate(self, polynomial: PolyElement) -> PolyElement:
        """Return the time derivative {f, H} + (partial f)/(partial t)."""
        return self._derive(polynomial, self._rates)

    def gradient(self, polynomial: PolyElement) -> list[PolyElement]:
        """Return the derivatives with respect to the state."""
        return [self._derive(polynomial, rates) for rates in self._partial]

    # -- normal form -------------------------------------------------------------------------

    def _cancelled(self, polynomial: PolyElement) -> PolyElement:
        """Cancel generators against their inverses."""
        pairs = [
            (self._index[symbol], self._index[generator.parts[0]])
            for symbol, generator in self._generators.items()
            if generator.kind == "inverse" and generator.parts[0].is_Symbol
        ]
        if not pairs:
            return polynomial
        found = self.ring(0)
        for exponents, coefficient in polynomial.items():
            reduced = list(exponents)
            for w, g in pairs:
                common = min(reduced[w], reduced[g])
                reduced[w] -= common
                reduced[g] -= common
            key = tuple(reduced)
            value = found.get(key, sympy.QQ(0)) + coefficient
            if value:
                found[key] = value
            else:
                found.pop(key, None)
        return found

    def normal_forms(self, polynomials: Sequence[PolyElement]) -> list[PolyElement]:
        """Return normal forms of the polynomials, all multiplied by one common denominator.

        Generators are eliminated from the last to the first, because relations contain earlier
        ones only. The map is linear, and a combination whose image is zero is the zero function.
        """
        found = [self._cancelled(polynomial) for polynomial in polynomials]
        for symbol in reversed(self.symbols):
            generator, place = self._generators[symbol], self._index[symbol]
            if generator.kind == "inverse":
                degree = max(max((e[place] for e in poly), default=0) for poly in found)
                found = [self._cleared(poly, place, symbol, degree) for poly in found]
            elif generator.kind in ("root", "sin"):
                found = [self._reduced(poly, place, symbol) for poly in found]
        return found

    def vanishes(self, polynomial: PolyElement) -> bool:
        """Whether the normal form is zero, which proves that the function is."""
        return not polynomial or not self.normal_forms([polynomial])[0]

    def _by_power(self, polynomial: PolyElement, place: int) -> dict[int, PolyElement]:
        """Return the coefficients of a polynomial in one generator."""
        found: dict[int, PolyElement] = {}
        for exponents, coefficient in polynomial.items():
            rest = (*exponents[:place], 0, *exponents[place + 1 :])
            found.setdefault(exponents[place], self.ring(0))[rest] = coefficient
        return found

    def _cleared(
        self, polynomial: PolyElement, place: int, symbol: sympy.Symbol, degree: int
    ) -> PolyElement:
        """Multiply by the denominator to the given power."""
        if not degree:
            return polynomial
        (denominator,) = self._parts[symbol]
        total = self.ring(0)
        for power, coefficient in self._by_power(polynomial, place).items():
            total += coefficient * denominator ** (degree - power)
        return total

    def _reduced(self, polynomial: PolyElement, place: int, symbol: sympy.Symbol) -> PolyElement:
        """Replace powers of a root or a sine by its relation."""
        generator = self._generators[symbol]
        own = self._gen(symbol)
        if generator.kind == "root":
            order, value = generator.order, self._parts[symbol][0]
        else:
            assert generator.partner is not None
            order, value = 2, 1 - self._gen(generator.partner) ** 2
        total = self.ring(0)
        for power, coefficient in self._by_power(polynomial, place).items():
            times, rest = divmod(power, order)
            total += coefficient * value**times * own**rest
        return total

    # -- values modulo the prime -------------------------------------------------------------

    def points(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Return random values of all generators that satisfy the relations, modulo PRIME.

        Constants have the same values at all points.

        Raise UnsupportedFunctionError if too many roots make such points rare.

        - returns: Shape (count, generators), int64.
        """
        if self._fixed is None:
            self._fixed = {}
            point = self.points(1, random)[0]
            self._fixed = {place: int(point[place]) for place in self.constants}
        kept, parts = 0, []
        for _ in range(4_000):
            found = self._some_points(max(4 * count, 512), random)
            parts.append(found)
            kept += len(found)
            if kept >= count:
                return np.concatenate(parts)[:count]
        raise UnsupportedFunctionError(
            "H has too many different roots for an exact search; use fewer"
        )

    def _some_points(self, count: int, random: np.random.Generator) -> np.ndarray:
        values = np.zeros((count, len(self.symbols)), dtype=np.int64)
        good = np.ones(count, dtype=bool)
        fixed = self._fixed or {}
        for symbol, generator in self._generators.items():
            place = self._index[symbol]
            if place in fixed:
                values[:, place] = fixed[place]
                continue
            part = self.values((*self._parts[symbol], self.ring(0))[0], values)
            if generator.kind == "root":
                # wrong ones where there is none
                n = generator.order
                power = (PRIME + 1) // 4 if n == 2 else pow(n, -1, PRIME - 1)
                values[:, place] = root = _power_modulo(part, power)
                good &= _power_modulo(root, generator.order) == part
                good &= root != 0
            elif generator.kind == "inverse":
                values[:, place] = _power_modulo(part, PRIME - 2)
                good &= part != 0
            elif generator.kind == "cos":
                tangent = random.integers(1, PRIME, count)
                square = tangent * tangent % PRIME
                norm = _power_modulo((1 + square) % PRIME, PRIME - 2)
                good &= norm != 0
                sine = self._index[self.generators.named("sin", generator.parts)]
                values[:, place] = (1 - square) % PRIME * norm % PRIME
                values[:, sine] = 2 * tangent % PRIME * norm % PRIME
            elif generator.kind != "sin":
                values[:, place] = random.integers(1, PRIME, count)
        return values[good]

    def values(self, polynomial: PolyElement, points: np.ndarray) -> np.ndarray:
        """Return the values of a polynomial at points, modulo PRIME, shape (count,)."""
        total = np.zeros(len(points), dtype=np.int64)
        powers: dict[tuple[int, int], np.ndarray] = {}
        for exponents, coefficient in polynomial.items():
            numerator, denominator = int(coefficient.numerator), int(coefficient.denominator)
            term = np.full(
                len(points), numerator * pow(denominator, -1, PRIME) % PRIME, dtype=np.int64
            )
            for i, exponent in enumerate(exponents):
                if exponent:
                    if (i, exponent) not in powers:
                        powers[i, exponent] = _power_modulo(points[:, i], exponent)
                    term = term * powers[i, exponent] % PRIME
            total = (total + term) % PRIME
        return total

    def is_even_in(self, symbols: Sequence[sympy.Symbol], polynomial: PolyElement) -> bool:
        """Whether a polynomial is even in some components of the state, and roots free of them."""
        places = [self._index[symbol] for symbol in symbols]
        for symbol in symbols:
            rates = self._partial[self.z.index(symbol)]
            if any(rates[other] for other in self.symbols if other not in self.z):
                return False
        return all(sum(exponents[i] for i in places) % 2 == 0 for exponents in polynomial)

    # -- gradings ----------------------------------------------------------------------------

    def gradings(self) -> list[list[int]]:
        """Return weights of the generators for which the time derivative is homogeneous.

        Then the homogeneous parts of an invariant are invariants. Each grading is a list of
        integers, one for each generator.
        """
        count = len(self.symbols)
        rows: set[tuple[int, ...]] = set()

        def homogeneous(polynomial: PolyElement, weight: Sequence[int], shift: int) -> None:
            """Require weight(term) = weight + shift * degree of the derivative, for each term."""
            for exponents in polynomial:
                row = [e - w for e, w in zip(exponents, weight, strict=True)]
                rows.add((*row, -shift))

        for symbol, generator in self._generators.items():
            place = self._index[symbol]
            unit = [int(i == place) for i in range(count)]
            homogeneous(self._rates[symbol], unit, 1)
            if generator.kind == "root":
                homogeneous(self._parts[symbol][0], [generator.order * e for e in unit], 0)
            elif generator.kind == "inverse":
                homogeneous(self._parts[symbol][0], [-e for e in unit], 0)
            elif generator.kind in ("cos", "sin"):
                rows.add((*unit, 0))
        for place in self.constants:
            rows.add((*(int(i == place) for i in range(count)), 0))
        if not rows:
            return []
        null = sympy.polys.matrices.DomainMatrix(
            [[sympy.ZZ(e) for e in row] for row in sorted(rows)], (len(rows), count + 1), sympy.ZZ
        ).convert_to(sympy.QQ)
        found = []
        for row in null.nullspace().to_list():
            scale = math.lcm(1, *(int(entry.denominator) for entry in row))
            found.append([int(entry * scale) for entry in row[:count]])
        return found


def _power_modulo(values: np.ndarray, exponent: int) -> np.ndarray:
    """Return powers modulo PRIME."""
    result, square = np.ones_like(values), values % PRIME
    while exponent:
        if exponent & 1:
            result = result * square % PRIME
        square = square * square % PRIME
        exponent >>= 1
    return result
