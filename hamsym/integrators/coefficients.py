"""Coefficients of one-step methods, to 50 digits.

Each of the three families has one generated loop, which takes the coefficients as arguments:

- :class:`Splitting`, for H = T(p, t) + V(q, t): alternating drifts of q and kicks of p;
- :class:`RungeKutta`, for any H: implicit, with stages solved by Newton's method;
- :class:`Doubled`, for any H: explicit, in a phase space of twice the dimension.

Coefficients without a closed form were published to 15 digits. Here they are refined to 50 by
Newton's method on the order conditions. Coefficients that the conditions leave free keep the
published digits.
"""

from __future__ import annotations

import decimal
import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

import numpy as np

_DIGITS = 55
_SMALL = Decimal("1e-50")


@dataclass(frozen=True)
class Splitting:
    """A splitting method: q <- q + a_1 h dT/dp, p <- p - b_1 h dV/dq, and so on, drifts first.

    The time in V advances with the drifts and that in T with the kicks, which is an exact
    splitting of the autonomous system with time as a coordinate, so the order is unchanged.
    """

    #: drifts, kicks: a_i and b_i, of equal length; zero for a flow that is omitted.
    drifts: tuple[Decimal, ...]
    kicks: tuple[Decimal, ...]
    is_symplectic = True

    @property
    def stages(self) -> int:
        """Number of force evaluations per step."""
        return sum(kick != 0 for kick in self.kicks)

    @property
    def is_symmetric(self) -> bool:
        """Whether a step of -h inverts a step of h."""
        pairs = zip(self.drifts, self.kicks, strict=True)
        flows = [(kind, size) for pair in pairs for kind, size in enumerate(pair) if size != 0]
        with decimal.localcontext(prec=_DIGITS):
            return all(
                kind == other and abs(size - mirrored) < _SMALL
                for (kind, size), (other, mirrored) in zip(flows, flows[::-1], strict=True)
            )

    @functools.cached_property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """Rows (a_i, b_i, time of the drift, time of the kick), in units of a step."""
        a, b = (np.array(side, dtype=float) for side in (self.drifts, self.kicks))
        drift_times = [float(sum(self.kicks[:i])) for i in range(len(b))]
        kick_times = [float(sum(self.drifts[: i + 1])) for i in range(len(a))]
        return (np.stack((a, b, drift_times, kick_times), axis=-1),)

    def width(self, dim: int) -> int:
        """Length of the vector that is kept for each trajectory between steps."""
        return dim


@dataclass(frozen=True)
class RungeKutta:
    """An implicit Runge-Kutta method with s stages."""

    #: a_ij, s x s.
    matrix: tuple[tuple[Decimal, ...], ...]
    #: weights, nodes: b_i and c_i.
    weights: tuple[Decimal, ...]
    nodes: tuple[Decimal, ...]

    @property
    def stages(self) -> int:
        """Number of stages; each needs a few evaluations of the vector field per step."""
        return len(self.weights)

    is_symmetric = True

    @property
    def is_symplectic(self) -> bool:
        """Whether b_i a_ij + b_j a_ji = b_i b_j (Sanz-Serna 1988, Lasagni 1988, Suris 1988)."""
        a, b = self.matrix, self.weights
        pairs = [(i, j) for i in range(self.stages) for j in range(self.stages)]
        with decimal.localcontext(prec=_DIGITS):
            return all(
                abs(b[i] * a[i][j] + b[j] * a[j][i] - b[i] * b[j]) < _SMALL for i, j in pairs
            )

    @functools.cached_property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """a, b, c, and the matrix that extrapolates rates from one step's nodes to the next's."""
        nodes = np.array(self.nodes, dtype=float)
        powers = np.arange(self.stages)
        continued = (1 + nodes[:, None]) ** powers @ np.linalg.inv(nodes[:, None] ** powers)
        return (
            np.array(self.matrix, dtype=float),
            np.array(self.weights, dtype=float),
            nodes,
            continued,
        )

    def width(self, dim: int) -> int:
        """Length of the state and of the rates at the last step's stages."""
        return dim * (1 + self.stages)


@dataclass(frozen=True)
class Doubled:
    """Explicit steps for any H in the doubled phase space (q, p, x, y) of Tao (2016).

    H(q, y) + H(x, p) + omega (|q - x|^2 + |p - y|^2)/2 is split into three flows A, B and C with
    closed forms. A step is the product of A(g/2) B(g/2) C(g) B(g/2) A(g/2) over the weights g. The
    time advances with C.
    """

    weights: tuple[Decimal, ...]

    @property
    def stages(self) -> int:
        """Number of gradient evaluations per step; the last is reused by the next step."""
        return 3 * len(self.weights)

    is_symmetric = True
    is_symplectic = False  # symplectic in the doubled phase space only

    @functools.cached_property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """The weights."""
        return (np.array(self.weights, dtype=float),)

    def width(self, dim: int) -> int:
        """Length of (q, p, x, y)."""
        return 2 * dim


Scheme = Splitting | RungeKutta | Doubled


# -- coefficients ------------------------------------------------------------------------------


def _to_50_digits(make: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(make)
    def wrapped(*arguments: Any) -> Any:
        with decimal.localcontext(prec=_DIGITS):
            return make(*arguments)

    return wrapped


@_to_50_digits
def splitting(drifts: str, kicks: str) -> Splitting:
    """Make a splitting method from coefficients as text; the last kick may be omitted."""
    a, b = _numbers(drifts), _numbers(kicks)
    return Splitting(tuple(a), (*b, *[Decimal(0)] * (len(a) - len(b))))


@_to_50_digits
def symmetric_splitting(drifts: str, kicks: str) -> Splitting:
    """Make a symmetric splitting from the first half; the middle ones follow from the sum 1."""
    a, b = _numbers(drifts), _numbers(kicks)
    b.append(Decimal("0.5") - sum(b, Decimal(0)))
    return Splitting((*a, 1 - 2 * sum(a, Decimal(0)), *a[::-1]), (*b, *b[::-1], Decimal(0)))


@_to_50_digits
def euler_composition(weights: Sequence[Decimal], adjoint: Sequence[Decimal]) -> Splitting:
    """Compose symplectic Euler (drift, kick) with its adjoint (kick, drift), in alternation."""
    ends = zip([Decimal(0), *adjoint], [*weights, Decimal(0)], strict=True)
    kicks = [first + second for first, second in zip(weights, adjoint, strict=True)]
    return Splitting(tuple(left + right for left, right in ends), (*kicks, Decimal(0)))


@_to_50_digits
def verlet_composition(weights: Sequence[Decimal]) -> Splitting:
    """Compose Stormer-Verlet steps (drift, kick, drift) of lengths weight_i h."""
    halves = [weight / 2 for weight in weights]
    return euler_composition(halves, halves)


@_to_50_digits
def symmetric_weights(outer: str) -> list[Decimal]:
    """Weights of a symmetric composition, from the outer ones; the middle one follows."""
    half = _numbers(outer)
    return [*half, 1 - 2 * sum(half, Decimal(0)), *half[::-1]]


@_to_50_digits
def triple_jump() -> list[Decimal]:
    """Weights of the composition that raises a symmetric method from order 2 to 4."""
    outer = 1 / (2 - Decimal(2) ** (Decimal(1) / 3))
    return [outer, 1 - 2 * outer, outer]


@_to_50_digits
def mclachlan4() -> Splitting:
    root = Decimal(19).sqrt()
    weights = [
        (14 - root) / 108,
        (-23 - 20 * root) / 270,
        Decimal("0.2"),
        (-2 + 10 * root) / 135,
        (146 + 5 * root) / 540,
    ]
    return euler_composition(weights, weights[::-1])


@_to_50_digits
def gauss(stages: int) -> RungeKutta:
    """The Gauss method with 1, 2 or 3 stages (Hairer, Lubich & Wanner 2006, section II.1)."""
    half = Decimal("0.5")
    if stages == 1:
        return RungeKutta(((half,),), (Decimal(1),), (half,))
    if stages == 2:
        r = Decimal(3).sqrt() / 6
        quarter = half / 2
        return RungeKutta(
            ((quarter, quarter - r), (quarter + r, quarter)), (half, half), (half - r, half + r)
        )
    if stages != 3:
        raise ValueError(f"a Gauss method with 1, 2 or 3 stages is known, not with {stages}")
    r = Decimal(15).sqrt()
    outer, inner = Decimal(5) / 18, Decimal(4) / 9
    return RungeKutta(
        (
            (outer / 2, inner / 2 - r / 15, outer / 2 - r / 30),
            (outer / 2 + r / 24, inner / 2, outer / 2 - r / 24),
            (outer / 2 + r / 30, inner / 2 + r / 15, outer / 2),
        ),
        (outer, inner, outer),
        (half - r / 10, half, half + r / 10),
    )


def _numbers(text: str) -> list[Decimal]:
    """Parse decimals and fractions (-1/24), separated by blanks."""
    fractions = (word.partition("/") for word in text.split())
    return [Decimal(top) / Decimal(bottom or 1) for top, _, bottom in fractions]


IMPLICIT_MIDPOINT, GAUSS4, GAUSS6 = gauss(1), gauss(2), gauss(3)
TAO2, TAO4 = Doubled((Decimal(1),)), Doubled(tuple(triple_jump()))
SYMPLECTIC_EULER = splitting("1", "1")
SYMPLECTIC_EULER_P = splitting("0 1", "1")
STORMER_VERLET = splitting("1/2 1/2", "1")
RUTH3 = splitting("7/24 3/4 -1/24", "2/3 -2/3 1")
FOREST_RUTH = verlet_composition(triple_jump())
MCLACHLAN4 = mclachlan4()
# S6; the first two drifts and the first kick keep the published digits.
BLANES_MOAN4 = symmetric_splitting(
    """0.0792036964311957 0.353172906049774
       -0.0420650803577197044759166922696745685688995160526154967467412""",
    """0.209515106613362
       -0.143851773179817469134513970208481911492218292343651085879701""",
)
# S10; the first drift keeps the published digits.
BLANES_MOAN6 = symmetric_splitting(
    """0.0502627644003922
       0.413514300428348280764209253255138114149686464525552807624476
       0.0450798897943974211608542852757026623955981398108019838182022
       -0.188054853819572834204124900735074375035274205588129870472198
       0.541960678450781754723292263234705650176816914276740213892356""",
    """0.14881644790104258990818728053732371285961725859300461898581
       -0.132385865767782209619702251588944972760032019791736300649796
       0.0673076046921852373718361905790506189051134050121833401599636
       0.432666402578172088198748915901779274874621282362445469752141""",
)
YOSHIDA6 = verlet_composition(
    symmetric_weights(
        """0.784513610477557263819497633866349875776824417451493384567948
           0.235573213359358133684793182978534601686468082103401119003493
           -1.17767998417887100694641568096431573463926925263459848447537"""
    )
)
YOSHIDA8 = verlet_composition(
    symmetric_weights(
        """0.91484424622979156674879348984750960451811970872885837179726
           0.253693336566211354146146020689942076097653164732474096632268
           -1.44485223686060515769473065753739035495591010179550560248891
           -0.158240635368050175204066776759754247755445115675751568082098
           1.93813913762252598657918648744364176095359335744765027207279
           -1.96061023297531080760763337639966364079243281982600530191041
           0.102799849391796440698115131601225862911015601278442768271702"""
    )
)
