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
import math
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

    def oscillation(self, angle: float) -> np.ndarray:
        """Matrix of a step of p^2/2 + q^2/2, which would be exact as a turn by this angle."""
        matrix = np.eye(2)
        for drift, kick in angle * self.arrays[0][:, :2]:
            matrix = [[1.0, 0.0], [-kick, 1.0]] @ (np.array([[1.0, drift], [0.0, 1.0]]) @ matrix)
        return matrix

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
        """Shares a_ij/b_j, b, c, and the matrix that extrapolates rates to the next step's nodes.

        Of two shares that add up to 1 the larger is rounded; their sum is then exact.
        """
        with decimal.localcontext(prec=_DIGITS):
            shares = np.array(
                [[a / b for a, b in zip(row, self.weights, strict=True)] for row in self.matrix]
            ).astype(float)
        if self.is_symplectic:
            shares = np.where(shares > shares.T, shares, 1 - shares.T)
            np.fill_diagonal(shares, 0.5)
        nodes = np.array(self.nodes, dtype=float)
        powers = np.arange(self.stages)
        continued = (1 + nodes[:, None]) ** powers @ np.linalg.inv(nodes[:, None] ** powers)
        return (
            shares,
            np.array(self.weights, dtype=float),
            nodes,
            continued,
        )

    def oscillation(self, angle: float) -> np.ndarray:
        """Matrix of a step of p^2/2 + q^2/2, as for a splitting method."""
        a, b = np.array(self.matrix, dtype=float), np.array(self.weights, dtype=float)
        turn = angle * np.array([[0.0, 1.0], [-1.0, 0.0]])
        system = np.eye(2 * self.stages) - np.kron(a, turn)
        stages = np.linalg.solve(system, np.tile(turn, (self.stages, 1)))
        return np.asarray(np.eye(2) + np.kron(b, np.eye(2)) @ stages)

    def width(self, dim: int) -> int:
        """Length of the state and of the rates at the last step's stages."""
        return dim * (1 + self.stages)


@dataclass(frozen=True)
class Doubled:
    """Explicit steps for any H in the doubled phase space (q, p, x, y) of Tao (2016).

    H(q, y) + H(x, p) + omega (|q - x|^2 + |p - y|^2)/2, in units in which coordinates and momenta
    are of one size, is split into three flows A, B and C with closed forms. A step is the product
    of A(g/2) B(g/2) C(g) B(g/2) A(g/2) over the weights g. The time advances with C.
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
    """The Gauss method: collocation at the zeros of the Legendre polynomial on [0, 1].

    Source: Hairer, Lubich & Wanner 2006, section II.1.
    """
    nodes = [_legendre_zero(stages, k) for k in range(stages)]
    matrix = []
    for end in [*nodes, Decimal(1)]:
        row = []
        for j, node in enumerate(nodes):
            # The Lagrange polynomial of a node, highest power last, and its integral.
            basis = [Decimal(1)]
            for other in nodes[:j] + nodes[j + 1 :]:
                lower, upper = [*basis, Decimal(0)], [Decimal(0), *basis]
                basis = [
                    (u - other * v) / (node - other) for u, v in zip(upper, lower, strict=True)
                ]
            row.append(sum((c * end ** (n + 1) / (n + 1) for n, c in enumerate(basis)), Decimal(0)))
        matrix.append(tuple(row))
    return RungeKutta(tuple(matrix[:-1]), matrix[-1], tuple(nodes))


def _legendre_zero(degree: int, k: int) -> Decimal:
    """The zero number k of the Legendre polynomial on [0, 1], by Newton's method."""
    x = Decimal(-math.cos(math.pi * (k + 0.75) / (degree + 0.5)))
    for _ in range(8):
        last, value = Decimal(1), x
        for n in range(1, degree):
            last, value = value, ((2 * n + 1) * x * value - n * last) / (n + 1)
        x -= value * (x * x - 1) / (degree * (x * value - last))
    return (1 + x) / 2


def _numbers(text: str) -> list[Decimal]:
    """Parse decimals and fractions (-1/24), separated by blanks."""
    fractions = (word.partition("/") for word in text.split())
    return [Decimal(top) / Decimal(bottom or 1) for top, _, bottom in fractions]


IMPLICIT_MIDPOINT = gauss(1)
#: By order.
GAUSS = {2 * stages: gauss(stages) for stages in range(2, 7)}
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
SOFRONIOU_SPALETTA10 = verlet_composition(
    symmetric_weights(
        """0.0787957225216864192639076793382896066655256276640445866058926
           0.313096103415108527764812471920256821461802522051185385378781
           0.027918383235078066109520273265949447508711510702640125781217
           -0.229592841593907094151213396801122704836931043143787881706981
           0.130962061077164863174656859292158363549447682955769535763989
           -0.269733405654510714344609732217286623648099348448778038362672
           0.0749733431558914356661371056390587135037589245545697766663991
           0.111993423999810204889575080737269905277266874275823161969906
           0.366133449546226751193148123537146946009021807238593250047649
           -0.399105630136035897878629810584015556896082292092718537218809
           0.103087398527471077315802769994503872284375007634574139016422
           0.411430873955890237820704118977477786897940297741860520700319
           -0.00486636058313526176219565930774240912472426137028798140237352
           -0.392033353708639906448081936429980141629719075950432628642903
           0.051942502962449647037182904831404243147260832269700483216313
           0.0506650907599244963358743425096948739410407139914064139379195
           0.0496743706397298790545688006666647946018762932129235471119557"""
    )
)
