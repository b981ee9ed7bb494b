"""Three point masses that attract each other, without collisions of pairs (Heggie 1974).

Input:  H = sum |p_i|^2/(2 m_i) - sum k_ij/|r_i - r_j|, in the plane or in space.
Output: Gamma, the old variables in the new ones, and the pairs.

The vectors q_ij = r_j - r_i between all pairs are taken as coordinates, with momenta p_ij of which
p_i = (m_i/M) p + sum_j (p_ji - p_ij), with the momentum p of the whole. The q_ij are more than are
needed, and keep their relations. Each pair then has its own u_ij as in a collision of two bodies,
and 1/(dt/ds) is the sum of all 1/r_ij: near a collision ds is that of its pair, and it does not
depend on who is far away. Since |p_ij|^2 = |P_ij|^2/(4 r_ij), Gamma is a quotient of polynomials,
regular in every collision of two bodies and singular in those of more.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import sympy

from hamsym.errors import InputError, VariableError
from hamsym.hamiltonian import Hamiltonian
from hamsym.symbolic.checks import name_of
from hamsym.transformations.collisions import Collision, turning


@dataclass(frozen=True)
class Bodies:
    """Masses, coupling constants, and the coordinates and momenta of point masses."""

    masses: list[sympy.Expr]
    couplings: dict[tuple[int, int], sympy.Expr]
    places: list[sympy.Matrix]
    momenta: list[sympy.Matrix]

    @classmethod
    def of(cls, H: Hamiltonian, coordinates: Sequence[Sequence[str]] | None) -> Bodies:
        """Find them in a Hamiltonian.

        Raise InputError if it has another form, VariableError if its coordinates are not those of
        three bodies in the plane or in space.
        """
        groups = _groups(H, coordinates)
        form, names = H.real_equations, list(H.names)
        symbols = dict(zip(names, form.z, strict=True))
        partner = {q: names[H.dof + k] for k, q in enumerate(names[: H.dof])}
        places = [sympy.Matrix([symbols[name] for name in group]) for group in groups]
        momenta = [sympy.Matrix([symbols[partner[name]] for name in group]) for group in groups]
        rest, masses = form.expr, []
        for own in momenta:
            inverse = sympy.simplify(sympy.diff(rest, own[0], 2))
            if inverse == 0 or inverse.free_symbols & {*form.z}:
                raise _error()
            masses.append(1 / inverse)
            rest -= own.dot(own) * inverse / 2
        rest = sympy.expand(rest)
        squares = {
            (i, j): sympy.expand((places[j] - places[i]).dot(places[j] - places[i]))
            for i, j in itertools.combinations(range(len(groups)), 2)
        }
        near = {pair: sympy.Symbol(f"s{pair[0]}_{pair[1]}", positive=True) for pair in squares}
        potential = rest.replace(
            lambda node: node.is_Pow and node.exp == -sympy.S.Half,
            lambda node: _inverse_distance(node, squares, near),
        )
        couplings = {pair: -sympy.diff(potential, s) for pair, s in near.items()}
        left = sympy.expand(potential + sum(k * near[pair] for pair, k in couplings.items()))
        moving = {*form.z, *near.values(), *([] if form.time is None else [form.time])}
        if left != 0 or any(k.free_symbols & moving for k in couplings.values()):
            raise _error()
        return cls(masses, couplings, places, momenta)


def without_collisions(
    bodies: Bodies, free: Callable[[str], str], clock: sympy.Symbol
) -> tuple[sympy.Expr, list[Collision], dict[str, sympy.Expr], dict[str, sympy.Expr]]:
    """Return Gamma, the collisions, the old variables in the new, and other new ones in the old.

    - free: A name that H does not have.
    - clock: The momentum of the time.
    """
    count, dim, total = len(bodies.masses), bodies.places[0].rows, sympy.Add(*bodies.masses)
    middles = [free(f"{'xyz'[k]}_cm") for k in range(dim)]
    center = sympy.Matrix([sympy.Symbol(name, real=True) for name in middles])
    whole = sympy.Matrix([sympy.Symbol(f"p_{name}", real=True) for name in middles])
    pairs = [*itertools.combinations(range(count), 2)]
    collisions, products, sizes, relative, turned = [], {}, {}, {}, {}
    for i, j in pairs:
        letters = ("u", "v") if dim == 2 else ("u", "v", "w", "h")
        names = [free(f"{letter}{i + 1}{j + 1}") for letter in letters]
        u = [sympy.Symbol(name, real=True) for name in names]
        P = [sympy.Symbol(f"p_{name}", real=True) for name in names]
        L = sympy.Matrix(turning(u))
        sizes[i, j] = sympy.Add(*(s**2 for s in u))
        products[i, j] = sympy.Add(*(s**2 for s in P))
        relative[i, j], turned[i, j] = L * sympy.Matrix(u), L * sympy.Matrix(P)
        shares = [m / total for m in bodies.masses]
        apart = (bodies.momenta[j] - bodies.momenta[i]) / count
        apart -= (shares[j] - shares[i]) * _sum(bodies.momenta) / count
        place = bodies.places[j] - bodies.places[i]
        collisions.append(Collision(tuple(names), (*place,), (*apart,)))

    def others(*left_out: tuple[int, int]) -> sympy.Expr:
        return sympy.Mul(*(r for pair, r in sizes.items() if pair not in left_out))

    gamma = others() * (clock + whole.dot(whole) / (2 * total))
    gamma -= sympy.Add(*(k * others(pair) for pair, k in bodies.couplings.items()))
    formulas: dict[str, sympy.Expr] = {}
    for i, mass in enumerate(bodies.masses):
        own = [(pair, 1 if pair[1] == i else -1) for pair in pairs if i in pair]
        square = sum(products[pair] * others(pair) for pair, _ in own)
        for (one, a), (other, b) in itertools.combinations(own, 2):
            square += 2 * a * b * turned[one].dot(turned[other]) * others(one, other)
        gamma += square / (8 * mass)
        momentum = whole * mass / total
        place = center
        for pair, sign in own:
            momentum += sign * turned[pair] / sizes[pair] / 2
            mate = pair[0] if sign > 0 else pair[1]
            place += sign * relative[pair] * bodies.masses[mate] / total
        formulas |= dict(zip(map(str, bodies.places[i]), place, strict=True))
        formulas |= dict(zip(map(str, bodies.momenta[i]), momentum, strict=True))
    gamma /= sympy.Add(*(others(pair) for pair in pairs))
    weighted = _sum([r * m / total for r, m in zip(bodies.places, bodies.masses, strict=True)])
    new: dict[str, sympy.Expr] = dict(zip(middles, weighted, strict=True))
    new |= dict(zip(map(str, whole), _sum(bodies.momenta), strict=True))
    return gamma, collisions, formulas, new


def _sum(vectors: Sequence[sympy.Matrix]) -> sympy.Matrix:
    return sum(vectors[1:], start=vectors[0])


def _groups(H: Hamiltonian, coordinates: Sequence[Sequence[str]] | None) -> list[list[str]]:
    """The coordinates of each body: as given, or by the numbers at the ends of names."""
    own = H.names[: H.dof]
    if coordinates is None:
        found: dict[str, list[str]] = {}
        for name in sorted(own):
            found.setdefault("".join(re.findall(r"\d+$", name)), []).append(name)
        groups = [found[key] for key in sorted(found, key=lambda key: (len(key), key))]
    else:
        groups = [[name_of(name) for name in group] for group in coordinates]
    sizes = {len(group) for group in groups}
    if (
        sorted(itertools.chain(*groups)) != sorted(own)
        or sizes not in ({2}, {3})
        or len(groups) < 3
    ):
        raise VariableError(
            "three bodies in the plane or in space are needed; name the coordinates of "
            'each: coordinates=[["x1", "y1"], ["x2", "y2"], ["x3", "y3"]]'
        )
    return groups


def _inverse_distance(
    node: sympy.Expr,
    squares: Mapping[tuple[int, int], sympy.Expr],
    near: Mapping[tuple[int, int], sympy.Symbol],
) -> sympy.Expr:
    """An inverse root as a multiple of an inverse distance; itself if it is none."""
    base = sympy.expand(node.base)
    for pair, square in squares.items():
        ratio = sympy.cancel(base / square)
        if not ratio.free_symbols & square.free_symbols:
            return near[pair] / sympy.sqrt(ratio)
    return node


def _error() -> InputError:
    return InputError(
        "this regularization needs point masses with potentials -k/r between them: "
        "H = sum |p_i|**2/(2*m_i) - sum k_ij/|r_i - r_j|"
    )
