"""Regularized Hamiltonians: collisions removed by another time and other coordinates.

Input:  a Hamiltonian, and how its time or its coordinates change.
Output: a :class:`Regularization` with a Hamiltonian in extended phase space, whose time is s.

The time becomes a coordinate T with the momentum P_T = -H. With dt/ds = g(z) > 0,

    Gamma = g (H + P_T)

has the solutions of H where Gamma = 0 (Poincare; Sundman 1912). About a collision at c, with
r = |u|^2 and matrices L(u) with L L^T = r,

    (x, y, ...) - c = L(u) u,    (p_x, p_y, ...) = L(u) P / (2 r),    g = r.

In the plane L = (u, -v; v, u), so that x + i y = (u + i v)^2 (Levi-Civita 1920). In space L has
three rows and four columns (Kustaanheimo & Stiefel 1965); the map is canonical where the bilinear
form l = u_1 P_4 - u_2 P_3 + u_3 P_2 - u_4 P_1 is zero, which it stays. There |p|^2 = |P|^2 / (4 r),
which is inserted for it: the difference is a multiple of l^2, which has no effect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import sympy

from hamsym.codegen.functions import compile_observable
from hamsym.errors import InputError, VariableError
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.support.shown import Shown
from hamsym.support.suggestions import checked_keywords, require_known, suggest_attributes
from hamsym.support.validation import checked_mapping, require_number
from hamsym.symbolic.checks import as_list, name_of
from hamsym.symbolic.variables import TIME
from hamsym.transformations.bodies import Bodies, without_collisions
from hamsym.transformations.canonical_maps import OldVariables, by_powers, limited
from hamsym.transformations.collisions import Collision, lifted, turning

#: Kinds of regularizations: the number of old coordinates, and the names of new ones.
KINDS = {
    "levi-civita": (2, ("u", "v")),
    "kustaanheimo-stiefel": (3, ("u1", "u2", "u3", "u4")),
}

Formulas = dict[str, sympy.Expr]


@suggest_attributes
@dataclass(frozen=True)
class Regularization(Shown):
    """A Hamiltonian in extended phase space, from :meth:`hamsym.Hamiltonian.regularized`.

    Its time is s, and the time of the original is its component ``time``.

    Attributes
    ----------
    H : Hamiltonian
    original : Hamiltonian
    formulas : mapping of str to sympy.Expr
        The old variables that change, in the new ones.
    time : str
        The component of H that is the time of the original.
    """

    H: Hamiltonian
    original: Hamiltonian
    formulas: Mapping[str, sympy.Expr]
    time: str
    _collisions: Sequence[Collision] = ()
    _others: Mapping[str, sympy.Expr] = field(default_factory=dict)  # other new ones, of the old

    def __repr__(self) -> str:
        return f"Regularization({self.original.formulas!r} -> {self.H.formulas!r})"

    def start(self, z0: Any, t: float = 0.0) -> np.ndarray:
        """Compute the states of H, shape (..., dim), of states of the original at a time.

        The momentum of the time is -H(z0), so that the new Hamiltonian is zero.

        Parameters
        ----------
        z0 : sequence, mapping or array
            A state, or states of shape (..., dim).
        t : float

        Raises
        ------
        InputError
            If H is not finite at a state, as in a collision, or dt/ds is not positive there.
        """
        require_number("t", t)
        original, dof = self.original, self.H.dof
        z = original.states_from(z0)
        form, energy = original.real_equations, original.compile("numpy").at("energy", z, float(t))
        if not np.isfinite(energy).all():
            bad = energy[~np.isfinite(energy)].flat[0]
            raise InputError(f"H is {bad} at the start; give one that is no collision")
        values = dict(zip(original.names, np.moveaxis(z, -1, 0), strict=True))

        def of(formulas: Sequence[sympy.Expr]) -> list[np.ndarray]:
            functions = (compile_observable(formula, form) for formula in formulas)
            return [np.broadcast_to(f(z, float(t)), energy.shape) for f in functions]

        for each in self._collisions:
            u, P = lifted(of(each.place), of(each.momentum))
            values |= dict(zip([*each.u, *each.P], [*u, *P], strict=True))
        values |= dict(zip(self._others, of([*self._others.values()]), strict=True))
        momentum = self.H.names[dof + self.H.names.index(self.time)]
        values |= {self.time: np.full_like(energy, t), momentum: -energy}
        found = np.stack([values[name] for name in self.H.names], axis=-1)
        rates = np.asarray(self.H.compile("numpy").vector_field(found))
        rate = float(rates[..., self.H.names.index(self.time)].min())
        if not rate > 0:
            raise InputError(f"dt/ds is {rate:g} at the start; give a formula that is positive")
        return found

    def to_old(self, z: Any) -> tuple[np.ndarray, np.ndarray]:
        """Compute the times, shape (...), and the states of the original, shape (..., dim).

        In a collision itself the momenta of the original are nan.

        Parameters
        ----------
        z : array
            States of H, shape (..., dim).

        Examples
        --------
        >>> import hamsym
        >>> kepler = Hamiltonian("(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)")
        >>> plane = kepler.regularized("levi-civita")
        >>> fall = hamsym.solve(plane.H, plane.start([1, 0, 0, 0]), (0, 5))  # through collisions
        >>> t, z = plane.to_old(fall(np.sqrt(2) * np.pi / 2 * np.array([1, 2])))
        >>> (t / (np.pi / np.sqrt(8))).round(9), z[:, 0].round(9) + 0
        (array([1., 2.]), array([0., 1.]))
        """
        states = self.H.states_from(z)
        return states[..., self.H.names.index(self.time)], self._values(states)

    @cached_property
    def _values(self) -> OldVariables:
        return OldVariables(self.original, self.H, self.formulas)


@checked_keywords
def regularize(
    H: HamiltonianLike,
    kind: str | None = None,
    *,
    sundman: str | sympy.Expr | None = None,
    coordinates: Sequence[Any] | None = None,
    about: Mapping[str, Any] | None = None,
) -> Regularization:
    """Remove collisions from a Hamiltonian; see Hamiltonian.regularized.

    Examples
    --------
    >>> regularize("(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)", "levi-civita").H.expr
    p_time*(u**2 + v**2) + p_u**2/8 + p_v**2/8 - 1
    """
    H = Hamiltonian.of(H)
    if (kind is None) == (sundman is None):
        raise InputError('give a kind, for example "levi-civita", or sundman=, dt/ds as a formula')
    if H.forces:
        raise InputError("forces are not regularized; give a Hamiltonian without forces")
    form = H.real_equations
    clock = _free("time", H)
    T, P_T = sympy.Symbol(clock, real=True), sympy.Symbol(f"p_{clock}", real=True)
    pairs = list(zip(form.z[: H.dof], form.z[H.dof :], strict=True))
    later = {} if form.time is None else {sympy.Symbol(TIME, real=True): T}
    if sundman is not None:
        if coordinates is not None or about is not None:
            raise InputError("coordinates= and about= belong to a kind, not to sundman=")
        rate = H.observable(sundman).function.xreplace(later)
        return _extended(H, rate * (form.expr.xreplace(later) + P_T), pairs, (T, P_T), {})
    require_known(kind, [*KINDS, "heggie"], "a regularization")
    if kind == "heggie":
        if about is not None:
            raise InputError("about= is the place of one collision; heggie removes all of them")
        return _of_bodies(H, coordinates, (T, P_T))
    count, names = KINDS[str(kind)]
    moved = _moved(H, coordinates, count)
    places = {name: _place(H, about, name) for name in moved}
    u = [sympy.Symbol(_free(name, H), real=True) for name in names]
    P = [sympy.Symbol(f"p_{symbol.name}", real=True) for symbol in u]
    r = sympy.Add(*(symbol**2 for symbol in u))
    matrix = sympy.Matrix(turning(u))
    shifts, turned = matrix * sympy.Matrix(u), matrix * sympy.Matrix(P) / r / 2
    momenta = [H.names[H.dof + H.names.index(name)] for name in moved]
    formulas: Formulas = {name: places[name] + shifts[k] for k, name in enumerate(moved)}
    formulas |= {name: turned[k] for k, name in enumerate(momenta)}
    replaced = {sympy.Symbol(name, real=True): f for name, f in formulas.items()}
    expr = form.expr
    added = sympy.Integer(0)
    if count == 3:
        expr, added = _without_squares(expr, momenta, sympy.Add(*(s**2 for s in P)) / r / 4)
    with limited("the regularized Hamiltonian"):
        inserted = (expr.xreplace(replaced) + added.xreplace(replaced)).xreplace(later)
        gamma = _times(r, inserted + P_T, [*P, P_T])
    pairs = [*zip(u, P, strict=True), *(pair for pair in pairs if pair[0].name not in moved)]
    symbols = dict(zip(H.names, form.z, strict=True))
    collision = Collision(
        tuple(symbol.name for symbol in u),
        tuple(symbols[name] - place for name, place in places.items()),
        tuple(symbols[name] for name in momenta),
    )
    return _extended(H, gamma, pairs, (T, P_T), formulas, [collision])


def _of_bodies(
    H: Hamiltonian, coordinates: Any, clock: tuple[sympy.Symbol, sympy.Symbol]
) -> Regularization:
    """All collisions of two of several bodies removed."""
    with limited("the regularized Hamiltonian"):
        bodies = Bodies.of(H, coordinates)
        gamma, collisions, formulas, others = without_collisions(
            bodies, lambda name: _free(name, H), clock[1]
        )
    half = len(others) // 2
    q = [*(name for each in collisions for name in each.u), *[*others][:half]]
    p = [*(name for each in collisions for name in each.P), *[*others][half:]]
    pairs = [
        (sympy.Symbol(one, real=True), sympy.Symbol(other, real=True))
        for one, other in zip(q, p, strict=True)
    ]
    return _extended(H, gamma, pairs, clock, formulas, collisions, others)


def _free(name: str, H: Hamiltonian) -> str:
    """A name that H does not have, for a coordinate and with p_ for its momentum."""
    while {name, f"p_{name}"} & {*H.names, *H.parameter_names, TIME}:
        name += "_"
    return name


def _moved(H: Hamiltonian, coordinates: Sequence[str] | None, count: int) -> list[str]:
    """The coordinates that are zero in a collision."""
    own = H.names[: H.dof]
    if coordinates is None and H.dof == count:
        return list(own)
    found = [] if coordinates is None else [*map(name_of, as_list(coordinates, "coordinates"))]
    unknown = [name for name in found if name not in own]
    if unknown or len({*found}) != count:
        raise VariableError(
            f"{count} coordinates of a collision are needed, of {', '.join(own)}; give them with "
            "coordinates=[...]"
        )
    return found


def _place(H: Hamiltonian, about: Mapping[str, Any] | None, name: str) -> sympy.Expr:
    """A coordinate of the collision: a number or a formula of parameters."""
    places = checked_mapping("about", about, '{"x": 1}')
    given = places.get(name, 0)
    unknown = sorted({*map(str, places)} - {*H.names[: H.dof]})
    if unknown:
        raise VariableError(f"about= has '{unknown[0]}', which is no coordinate of H")
    expr = H.observable(given).function if isinstance(given, (str, sympy.Expr)) else None
    if expr is None:
        require_number(f"the place of {name}", given)
        expr = sympy.Rational(*float(given).as_integer_ratio())
    if {s.name for s in expr.free_symbols} - {*H.parameter_names}:
        raise InputError(f"the place {given!r} of the collision depends on more than parameters")
    return expr


def _without_squares(
    expr: sympy.Expr, momenta: Sequence[str], square: sympy.Expr
) -> tuple[sympy.Expr, sympy.Expr]:
    """H without the squares a (p_x^2 + p_y^2 + p_z^2), and a times what is inserted for them.

    Raise InputError if H has no such form, with terms at most linear in these momenta beside.
    """
    symbols = [sympy.Symbol(name, real=True) for name in momenta]
    try:
        powers = sympy.Poly(expr, *symbols)
    except sympy.PolynomialError:
        powers = None
    second = {} if powers is None else {m: c for m, c in powers.terms() if sum(m) > 1}
    squares = {(2, 0, 0), (0, 2, 0), (0, 0, 2)}
    if powers is None or {*second} != squares or len({*second.values()}) != 1:
        raise InputError(
            "this regularization needs a kinetic energy "
            f"a*({' + '.join(f'{name}**2' for name in momenta)}), with terms linear in them"
        )
    (factor,) = {*second.values()}
    rest = sympy.expand(powers.as_expr() - factor * sympy.Add(*(s**2 for s in symbols)))
    return rest, factor * square


def _times(r: sympy.Expr, expr: sympy.Expr, momenta: Sequence[sympy.Symbol]) -> sympy.Expr:
    """r times H, term by term, so that r cancels where a term has its inverse."""
    # The root of a square, once factored, is evaluated by sympy.
    plain = expr.replace(
        lambda node: node.is_Pow and node.exp.is_Rational and not node.exp.is_Integer,
        lambda node: sympy.factor(sympy.expand(node.base)) ** node.exp,
    )
    terms = [r * term for term in sympy.Add.make_args(plain)]
    moving = sympy.Add(*(term for term in terms if term.has(*momenta)))
    resting = sympy.Add(*(term for term in terms if not term.has(*momenta)))
    short = by_powers(
        moving, momenta, lambda each: min(each, sympy.cancel(each), key=sympy.count_ops)
    )
    return resting + (moving if short is None else short)


def _extended(
    H: Hamiltonian,
    gamma: sympy.Expr,
    pairs: Sequence[tuple[sympy.Symbol, sympy.Symbol]],
    clock: tuple[sympy.Symbol, sympy.Symbol],
    formulas: Formulas,
    collisions: Sequence[Collision] = (),
    others: Mapping[str, sympy.Expr] | None = None,
) -> Regularization:
    names = {s.name for s in gamma.free_symbols}
    every = [*pairs, clock]
    new = Hamiltonian(
        gamma,
        q=[q for q, _ in every],
        p=[p for _, p in every],
        parameters={name: value for name, value in H.parameters.items() if name in names},
    )
    return Regularization(new, H, formulas, clock[0].name, collisions, others or {})
