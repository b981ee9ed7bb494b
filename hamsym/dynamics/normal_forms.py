"""Birkhoff normal forms at elliptic equilibria, and nonlinear stability as a theorem.

Input:  a Hamiltonian, a proven equilibrium whose linearised motion has imaginary eigenvalues.
Output: :class:`NormalForm`: H in actions up to a degree, and the transformations both ways.

All coefficients are balls, so that what is decided holds. In complex coordinates with
{x_k, y_k} = 1 the quadratic part of H is sum_k i omega_k x_k y_k, with the signs of the energies of
the modes in omega. Degree by degree a term x^a y^b with the divisor D = i omega . (a - b) is
removed by the flow of the function chi with the coefficient of the term over D (Birkhoff 1927;
Deprit 1969); terms whose divisor may be zero stay (Gustavson 1966). With the actions
I_k = i x_k y_k = (Q_k^2 + P_k^2)/2,

    H = H_0 + omega . I + (A I_1^2 + 2 B I_1 I_2 + C I_2^2)/2 + ...

for two degrees of freedom, and an equilibrium without k . omega = 0 for 0 < |k| <= 4 is stable if
A omega_2^2 - 2 B omega_1 omega_2 + C omega_1^2 is not zero (Arnold 1961; Moser 1962).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Any

import numpy as np
import sympy
from flint import acb, acb_mat, arb

from hamsym.dynamics.equilibrium import Equilibrium
from hamsym.errors import CertificationError, InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.monomials import monomials
from hamsym.proof.arithmetic.ball import Ball
from hamsym.proof.arithmetic.ball_polynomials import BallPolynomial, Powers
from hamsym.proof.arithmetic.balls import float_balls, working
from hamsym.proof.arithmetic.functions import Arithmetic, SingularityError
from hamsym.proof.arithmetic.generated import GeneratedFunctions
from hamsym.proof.zeros.derivative_balls import DerivativeBalls
from hamsym.proof.zeros.roots import enclosed_root
from hamsym.support.shown import Shown
from hamsym.support.suggestions import checked_keywords, suggest_attributes
from hamsym.support.validation import checked_numbers, require, require_whole
from hamsym.symbolic.derivatives import connected_blocks

_BITS = 256
_MOST = 16  # degree
# Relative error of H on tori up to which the normal form is of use.
_WANTED = 1e-3
_PHASES = 24
# Sizes at which it is compared, powers of two of a unit, and how many of them in an octave.
_LEAST, _LARGEST, _SIZES = -60, 20, 8
_FURTHEST = 300  # octaves of the search for the unit, where the normal form has none
# Round-off of H, in units of its value at the equilibrium, that is less than what is wanted.
_ROUND_OFF = 1e-14


@suggest_attributes
@dataclass(frozen=True, eq=False)
class NormalForm(Shown):
    """The Birkhoff normal form at an equilibrium, from :meth:`hamsym.Equilibrium.normal_form`.

    Attributes
    ----------
    equilibrium : Equilibrium
    degree : int
        Of H in the coordinates; in the actions half of it.
    frequencies : Ball
        omega, with the signs of the energies of the modes, shape (dof,).
    coefficients : mapping of tuple of int to Ball
        Of the powers of I_1, I_2, ... in H.
    resonances : tuple of tuple of int
        Vectors k with k . omega that may be zero, up to the degree: their terms are left in H, and
        ``hamiltonian`` is then an average.
    stable : bool or None
        True if the equilibrium is proven to be stable; None if that is not decided.
    statement : str
        What is proven, and why.
    domain : float
        Estimated size sqrt(2 |I|) of the region in which H is described to one part in a thousand,
        infinite for quadratic H.
    """

    equilibrium: Equilibrium = field(repr=False)
    degree: int
    frequencies: Ball
    coefficients: Mapping[Powers, Ball] = field(repr=False)
    resonances: tuple[Powers, ...]
    stable: bool | None
    statement: str
    domain: float
    _there: _Map = field(repr=False)  # x_1, ..., x_d of the normal coordinates, and back
    _back: _Map = field(repr=False)
    _basis: np.ndarray = field(repr=False)

    @property
    def formula(self) -> sympy.Expr:
        """H in the actions I_1, I_2, ..., with coefficients in float64, without its constant."""
        actions = [sympy.Symbol(f"I_{k + 1}") for k in range(len(self.frequencies.mid))]
        terms = (
            sympy.Float(ball.mid, 15)
            * sympy.Mul(*(a**n for a, n in zip(actions, powers, strict=True)))
            for powers, ball in self.coefficients.items()
        )
        return sympy.Add(*terms)

    def hamiltonian(self, actions: Any) -> np.ndarray:
        """Evaluate H at actions, shape (..., dof) -> (...)."""
        values = self._rows("actions", actions, 1)
        found = np.full(values.shape[:-1], self.equilibrium.energy)
        for powers, ball in self.coefficients.items():
            found = found + ball.mid * np.prod(values ** np.array(powers), axis=-1)
        return np.asarray(found)

    def from_normal(self, normal: Any) -> np.ndarray:
        """Compute the states z of normal coordinates (Q, P), shape (..., dim) -> (..., dim).

        I_k = (Q_k^2 + P_k^2)/2 are the actions.
        """
        values = self._rows("normal", normal, 2)
        half = values.shape[-1] // 2
        Q, P = values[..., :half], values[..., half:]
        both = np.concatenate([Q - 1j * P, P - 1j * Q], axis=-1) / np.sqrt(2)
        # For real states y_k = -i conj(x_k), so that both halves of the sum are conjugate.
        return np.asarray(
            self.equilibrium.z + 2 * (self._there(both) @ self._basis[:, :half].T).real
        )

    def to_normal(self, z: Any) -> np.ndarray:
        """Compute the normal coordinates (Q, P) of states, shape (..., dim) -> (..., dim)."""
        apart = self._rows("z", z, 2) - self.equilibrium.z
        both = apart @ np.linalg.inv(self._basis).T
        x = self._back(both)
        return np.asarray(np.sqrt(2) * np.concatenate([x.real, -x.imag], axis=-1))

    def _rows(self, name: str, values: Any, each: int) -> np.ndarray:
        """Numbers in rows with as many for each degree of freedom."""
        found, width = checked_numbers(name, values), each * len(self.frequencies.mid)
        if found.shape[-1:] != (width,):
            raise InputError(f"{name} has shape {found.shape}; give {width} numbers in each row")
        return found


@checked_keywords
def normal_form(equilibrium: Equilibrium, degree: int = 6) -> NormalForm:
    """Compute the Birkhoff normal form at an equilibrium; see Equilibrium.normal_form.

    Examples
    --------
    >>> import hamsym
    >>> found = normal_form(hamsym.equilibria("p**2/2 + x**2/2 + x**4/4")[0], 4)
    >>> found.formula, found.stable
    (0.375*I_1**2 + 1.0*I_1, True)
    """
    require(isinstance(equilibrium, Equilibrium), "equilibrium", equilibrium, "an Equilibrium")
    H = equilibrium.H
    if H is None or H.time is not None:
        raise InputError("a normal form needs an equilibrium of a Hamiltonian without time")
    if H.forces:
        raise InputError("a normal form needs a Hamiltonian without forces")
    H.require_parameters()
    require_whole("degree", degree, 2)
    if degree > _MOST:
        raise InputError(f"degree={degree} is beyond {_MOST}, the largest that is computed")
    with working(_BITS, degree + 1):
        try:
            return _Construction(H, equilibrium, degree).normal_form()
        except SingularityError as error:
            raise CertificationError(f"H is not smooth at the equilibrium, in {error}") from None


class _Map:
    """Polynomials in numbers: an array of complex values, shape (..., 2 d) -> (..., count)."""

    def __init__(self, polynomials: Sequence[BallPolynomial]) -> None:
        terms = [one.terms() for one in polynomials]
        self._powers = np.array(list(dict.fromkeys(itertools.chain(*terms))), dtype=int)
        self._values = np.array(
            [[complex(one.get(tuple(p), 0)) for one in terms] for p in self._powers.tolist()]
        )

    def __call__(self, z: np.ndarray) -> np.ndarray:
        return np.asarray(monomials(z, self._powers) @ self._values)


# -- construction ----------------------------------------------------------------------------------


class _Construction:
    """The normal form of H at one equilibrium."""

    def __init__(self, H: Hamiltonian, equilibrium: Equilibrium, degree: int) -> None:
        self._H, self._equilibrium, self._degree = H, equilibrium, degree
        self._dof = H.dof
        self._balls = DerivativeBalls(H)
        self._point = _point(self._balls, equilibrium.z)
        self._omega, self._basis = self._modes()

    def normal_form(self) -> NormalForm:
        """Normalise degree by degree."""
        jet, generators, resonances = self._expanded(), [], set()
        for s in range(3, self._degree + 1):
            jet = jet.cleaned(s)
            if s not in jet.parts:
                continue
            divisors: dict[Powers, acb] = {}
            for powers in jet.terms(s):
                half = powers[: self._dof]
                k = tuple(a - b for a, b in zip(half, powers[self._dof :], strict=True))
                divisor = self._divisor(k)
                if not divisor.contains(0):
                    divisors[powers] = acb(0, divisor)
                elif any(k):
                    resonances.add(min(k, tuple(-n for n in k)))
            # Terms that may be zero are removed, too: they are in the error of the generator.
            every = (self._divisor(k) for n in range(s, 0, -2) for k in _vectors(self._dof, n))
            sizes = (divisor.abs_lower() for divisor in every if not divisor.contains(0))
            smallest = reduce(arb.min, sizes, arb("inf"))
            chi, left = jet.split(s, divisors, smallest)
            if chi.parts:
                generators.append(chi)
                # What is removed is exactly zero, and the bracket with the quadratic part has no
                # other terms of this degree.
                jet = jet.flowed(chi).with_part(s, left)
        coefficients = self._in_actions(jet)
        # To the degree of H, the coordinates are needed to one degree less.
        ones = ({_unit(2 * self._dof, k): 1} for k in range(self._dof))
        units = [BallPolynomial.of(one, self._degree - 1) for one in ones]
        there, back = units, units
        for chi_s in generators:
            there = [one.flowed(chi_s) for one in there]
        for chi_s in reversed(generators):
            back = [one.flowed(-chi_s) for one in back]
        stable, statement = self._stability(coefficients)
        balls = {powers: float_balls([value]) for powers, value in coefficients.items()}
        found = NormalForm(
            self._equilibrium,
            self._degree,
            Ball(*map(np.array, float_balls(self._omega))),
            {p: Ball(m[0], r[0]) for p, (m, r) in balls.items()},
            tuple(sorted(resonances)),
            stable,
            statement,
            math.nan,
            _Map(there),
            _Map(back),
            np.array([[complex(v) for v in row] for row in self._basis]),
        )
        return replace(found, domain=_domain(self._H, found))

    def _divisor(self, k: Powers) -> arb:
        """k . omega."""
        return sum((n * w for n, w in zip(k, self._omega, strict=True)), arb(0))

    def _modes(self) -> tuple[list[arb], list[list[acb]]]:
        """Signed frequencies, and the columns u_k and i conj(u_k) with u^T J i conj(u) = 1."""
        dof, dim = self._dof, 2 * self._dof
        rows = self._balls.hessian(self._point)
        matrix = [rows[dof + k] for k in range(dof)]
        matrix += [[-value for value in rows[k]] for k in range(dof)]
        indices = itertools.product(range(dim), repeat=2)
        pairs = [(i % dof, j % dof) for i, j in indices if not rows[i][j].is_zero()]
        omega: list[arb] = []
        columns: list[list[acb]] = []
        for block in connected_blocks([*pairs, *((k, k) for k in range(dof))], dof):
            own = [*block, *(dof + k for k in block)]
            unit = {k: _unit_of(rows[k][k], rows[dof + k][dof + k]) for k in block}
            unit |= {dof + k: -power for k, power in unit.items()}
            scaled = [[matrix[i][j] * arb((1, unit[i] - unit[j])) for j in own] for i in own]
            try:
                values, vectors = acb_mat(scaled).eig(right=True, algorithm="rump")
            except ValueError:
                raise CertificationError(
                    "frequencies of coupled modes are equal, zero, or too near to be separated"
                ) from None
            for k, value in enumerate(values):
                if not (value.imag > 0):
                    continue
                # With an eigenvalue -conj of it is one: the same, if its ball meets no other.
                mirrored = -value.conjugate()
                others = (other for i, other in enumerate(values) if i != k)
                if not value.real.contains(0) or any(map(mirrored.overlaps, others)):
                    raise CertificationError(
                        "the linearised motion is not bounded: an eigenvalue has a real part"
                    )
                u = [acb(0)] * dim
                for row, i in enumerate(own):
                    u[i] = vectors[row, k] * arb((1, -unit[i]))
                omega_k, u = self._signed(value.imag, u)
                omega.append(omega_k)
                columns.append(u)
        if len(omega) != dof:
            raise CertificationError(
                "the equilibrium is not elliptic: not all eigenvalues are imaginary and not zero"
            )
        basis = [*columns, *([acb(0, 1) * v.conjugate() for v in u] for u in columns)]
        return omega, [list(row) for row in zip(*basis, strict=True)]

    def _signed(self, omega: arb, u: list[acb]) -> tuple[arb, list[acb]]:
        """A mode with its sign, normalised."""
        dof = self._dof
        # u^T J conj(u) = -i s
        form = sum(
            (u[k] * u[dof + k].conjugate() - u[dof + k] * u[k].conjugate() for k in range(dof)),
            acb(0),
        )
        size = (acb(0, 1) * form).real
        if size > 0:
            return omega, [v / size.sqrt() for v in u]
        if size < 0:
            return -omega, [v.conjugate() / (-size).sqrt() for v in u]
        raise CertificationError("the sign of the energy of a mode is not decided")

    def _expanded(self) -> BallPolynomial:
        """H - H_0 in the complex coordinates, with the quadratic part of the modes."""
        dim = 2 * self._dof
        state = []
        for point, row in zip(self._point, self._basis, strict=True):
            linear = {_unit(dim, k): value for k, value in enumerate(row)}
            state.append(BallPolynomial.of({_unit(dim): point, **linear}, self._degree))
        jet = GeneratedFunctions(self._H, Arithmetic(_applied))("energy", state, arb(0))
        modes = {_unit(dim, k, self._dof + k): acb(0, 1) * w for k, w in enumerate(self._omega)}
        return jet.from_degree(3) + BallPolynomial.of(modes, self._degree)

    def _in_actions(self, jet: BallPolynomial) -> dict[Powers, arb]:
        """The coefficients of the powers of I_k = i x_k y_k."""
        found: dict[Powers, arb] = {}
        for total in range(1, self._degree // 2 + 1):
            for half in _powers(self._dof, total):
                value = (jet.coefficient(half + half) * acb(0, -1) ** total).real
                if not value.is_zero():
                    found[half] = value
        return found

    def _stability(self, coefficients: Mapping[Powers, arb]) -> tuple[bool | None, str]:
        omega = self._omega
        if all(w > 0 for w in omega) or all(w < 0 for w in omega):
            return True, "stable: the energies of all modes have one sign (Dirichlet)"
        if len(omega) != 2:
            return (
                None,
                "not decided: for more than two degrees of freedom there is no theorem here",
            )
        for k in itertools.chain(*(_vectors(2, order) for order in range(1, 5))):
            if self._divisor(k).contains(0):
                return None, f"not decided: {k[0]} omega_1 + {k[1]} omega_2 may be zero"
        if self._degree < 4:
            return None, "not decided: the degree is below 4"
        A, B, C = (coefficients.get(p, arb(0)) for p in ((2, 0), (1, 1), (0, 2)))
        # of I_1^2, I_1 I_2 and I_2^2: A/2, B and C/2
        found = 2 * (A * omega[1] ** 2 - B * omega[0] * omega[1] + C * omega[0] ** 2)
        value = found.str(6, radius=False)
        if found.contains(0):
            return None, "not decided: Arnold's determinant may be zero"
        return True, (
            f"stable: Arnold's determinant is {value}, not zero, and no k . omega = 0 for "
            "0 < |k| <= 4 (Arnold 1961; Moser 1962)"
        )


def _applied(function: Any, x: Any, *rest: Any) -> Any:
    """A function of a polynomial or a number; arguments after it are numbers."""
    if any(isinstance(other, BallPolynomial) for other in rest):
        raise SingularityError("a function of two variables")
    if isinstance(x, BallPolynomial):
        return x.applied(lambda series: function(series, *rest))
    return function(x, *rest)


def _unit_of(stiffness: arb, mobility: arb) -> int:
    """The power of two for units of a coordinate in which both second derivatives are alike."""
    sizes = [abs(value).mid() for value in (stiffness, mobility)]
    if not all(size > 0 for size in sizes):
        return 0
    return round(float((sizes[0] / sizes[1]).log()) / (4 * math.log(2)))


def _unit(count: int, *variables: int) -> Powers:
    """The powers of a product of different variables."""
    return tuple(int(k in variables) for k in range(count))


def _powers(count: int, total: int) -> Iterator[Powers]:
    """All powers of some variables with a sum."""
    for chosen in itertools.combinations_with_replacement(range(count), total):
        yield tuple(chosen.count(k) for k in range(count))


def _vectors(count: int, order: int) -> Iterator[Powers]:
    """Vectors of whole numbers with |k_1| + |k_2| + ... = order, one of k and -k."""
    for sizes in _powers(count, order):
        for k in itertools.product(*((n, -n) if n else (0,) for n in sizes)):
            if next(filter(None, k)) > 0:
                yield k


def _point(balls: DerivativeBalls, z: np.ndarray) -> list[arb]:
    """The equilibrium: exactly, or in more digits than those of float64."""
    exact = [arb(value) for value in z.tolist()]
    if all(slope == 0 for slope in balls.gradient(exact)):
        return exact
    root = enclosed_root(balls, z.tolist(), np.maximum(np.abs(z), 1e-3).tolist())
    if root is None:
        raise CertificationError("the equilibrium is not proven; a normal form needs its enclosure")
    return list(root.enclosure)


def _domain(H: Hamiltonian, form: NormalForm) -> float:
    """The size of normal coordinates up to which H agrees, estimated at random phases."""
    energy, dof = H.compile("numpy").energy, H.dof
    round_off = _ROUND_OFF * abs(float(form.hamiltonian(np.zeros(dof))))

    def agrees(size: float) -> bool:
        random = np.random.default_rng(0)
        actions = random.dirichlet(np.ones(dof), _PHASES) * size**2 / 2
        angles = random.uniform(0, 2 * np.pi, (_PHASES, dof))
        radius = np.sqrt(2 * actions)
        normal = np.concatenate([radius * np.cos(angles), radius * np.sin(angles)], axis=-1)
        with np.errstate(all="ignore"):
            found = energy(form.from_normal(normal)) - form.hamiltonian(actions)
            allowed = _WANTED * (np.abs(form.frequencies.mid) * actions).sum(axis=-1)
        return bool(((np.abs(found) <= allowed) & (allowed > round_off)).all())

    # The size at which the first term beyond the quadratic one is as large.
    beyond = [abs(ball.mid) for powers, ball in form.coefficients.items() if sum(powers) == 2]
    slowest = np.abs(form.frequencies.mid).min()
    expr, z = H.real_equations.expr, H.real_equations.z
    if expr.is_polynomial(*z) and sympy.Poly(expr, *z).total_degree() <= 2:
        return math.inf
    if any(beyond):
        unit = math.sqrt(slowest / max(beyond))
    else:
        sizes = (2.0**k for k in range(-_FURTHEST, _FURTHEST))
        above = itertools.dropwhile(lambda size: not agrees(size), sizes)
        unit = max(itertools.takewhile(agrees, above), default=1.0)
    low = 0.0
    for octave in np.arange(_LEAST, _LARGEST, 1 / _SIZES):
        size = unit * 2.0**octave
        if agrees(size):
            low = size
        elif low:  # at smaller sizes the round-off of H is larger than what is allowed
            break
    return low
