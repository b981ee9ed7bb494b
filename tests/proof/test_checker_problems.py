"""Random problems: every claim that is proven contains the truth, and both checkers accept it.

The truth is computed with 50 digits by the Taylor integrator of the audit, which shares no code
with hamsym. The seeds are fixed; run ``python -m tests.proof.test_checker_problems 1000 1200`` for
others.
"""

from __future__ import annotations

import dataclasses
import random
import re
import sys
import warnings
from collections import Counter
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import pairwise

import mpmath
import numpy as np
import pytest
import sympy
from flint import arb, arb_mat, arb_series, ctx

import hamsym
from hamsym.errors import CertificationError, HamsymError
from hamsym.flow_maps.expansion import Leg
from tests.audit.taylor import Equations, formula, integrate

_BITS, _DIGITS = 200, 50
_PRECISE = {"order": 44, "bits": _BITS, "digits": 52.0}
_EVERY = {"map": 40}  # problems of each kind, if not 200


@pytest.fixture(autouse=True)
def precise():
    with ctx.workprec(_BITS), mpmath.workdps(_DIGITS):
        yield


@dataclass(frozen=True)
class Problem:
    """A random Hamiltonian, as text for both programs."""

    text: str
    q: tuple[str, ...]
    p: tuple[str, ...]
    parameters: dict[str, float] = field(default_factory=dict)
    forces: dict[str, str] = field(default_factory=dict)

    @property
    def H(self):
        return hamsym.Hamiltonian(
            self.text, q=self.q, p=self.p, parameters=self.parameters, forces=self.forces
        )

    @property
    def equations(self):
        return Equations(self.text, self.q, self.p, self.parameters, forces=self.forces)

    @property
    def energy(self):
        """H as a function of the state and t, with 50 digits."""
        names = [*self.q, *self.p, "t"]
        exact = {sympy.Symbol(k, real=True): Fraction(v) for k, v in self.parameters.items()}
        expr = formula(self.text, [*names, *self.parameters]).subs(exact)
        return sympy.lambdify(sympy.symbols(names, real=True), expr, "mpmath")


def pick(r, *choices):
    return r.choice(choices)


def number(r, low, high):
    return f"{r.uniform(low, high):.4g}"


def random_problem(r, *, moving=True, most=4):
    """A Hamiltonian of up to four degrees of freedom, near an oscillator or an unbounded motion.

    - moving: Whether there may be explicit time and forces.
    """
    dof = min(r.choice((1, 1, 2, 2, 3, 4)), most)
    q, p = tuple("xyzw"[:dof]), tuple(f"p_{name}" for name in "xyzw"[:dof])
    parameters = {"k": round(r.uniform(0.3, 2), 3)} if r.random() < 0.3 else {}
    k = "k" if parameters else number(r, 0.3, 2)
    terms = []
    for x, y in zip(q, p, strict=True):
        terms.append(pick(
            r, f"{y}**2/2", f"{y}**2/2", f"{y}**2/{number(r, 0.5, 3)}", f"sqrt(1 + {y}**2)",
            f"{y}**2/(2 + {number(r, 0, 1)}*{x}**2)", f"({y} - {number(r, 0, 1)}*{x})**2/2",
        ))  # fmt: skip
        terms.append(pick(
            r, f"{k}*{x}**2/2", f"{x}**2/2 + {k}*{x}**4/4", f"({x}**2 - 1)**2/4",
            f"-{k}*cos({x})", f"{k}*sqrt(1 + {x}**2)", f"{k}*(exp({x}) - {x})",
            f"(1 - exp(-{k}*{x}))**2/2", f"-{k}/(1 + {x}**2)", f"log(1 + {k}*{x}**2)",
        ))  # fmt: skip
    for x, y in pairwise(q):
        c = number(r, -0.4, 0.4)
        terms.append(pick(
            r, f"({c})*{x}*{y}", f"({c})*{x}**2*{y}", f"({c})*cos({x} - {y})",
            f"({c})*exp({x} - {y})", f"({c})/(1 + ({x} - {y})**2)", f"({c})*{x}**2*{y}**2",
            f"({c})/sqrt({number(r, 0.2, 1)} + {x}**2 + {y}**2)", f"({c})*tanh({x} + {y})",
        ))  # fmt: skip
    forces = {}
    if moving and r.random() < 0.3:
        x, c, w = r.choice(q), number(r, -0.5, 0.5), number(r, 0.3, 3)
        terms.append(pick(r, f"({c})*{x}*cos({w}*t)", f"({c})*sin({w}*t)*{x}**2/2",
                          f"({c})*{x}*exp(-(t/3)**2)"))  # fmt: skip
    if moving and r.random() < 0.3:
        i = r.randrange(dof)
        c = number(r, 0.05, 0.5)
        forces = {p[i]: pick(r, f"-{c}*{p[i]}", f"{c}*(1 - {q[i]}**2)*{p[i]}", f"-{c}*{p[i]}**3")}
    text = " + ".join(terms)
    return Problem(text, q, p, parameters if re.search(r"\bk\b", text) else {}, forces)


def exactly(value):
    """A fraction as a ball."""
    return arb(value.numerator) / value.denominator


def precisely(value):
    """A ball as a number of mpmath."""
    return mpmath.mpf(value.mid().str(60, radius=False))


def accepted(certificate, result, checkers=("kernel", "independent")):
    """Require that both checkers accept a certificate."""
    for checker in checkers:
        hamsym.verify(certificate, result, checker=checker)


# -- solutions ------------------------------------------------------------------------------------


def checked_solution(seed):
    """Whether there is a solution with a certificate, which is then compared with the truth."""
    r = random.Random(f"solution {seed}")
    problem = random_problem(r)
    z0 = [round(r.uniform(-1.2, 1.2), 6) for _ in range(2 * len(problem.q))]
    start, length = r.choice((0.0, 0.0, 0.0, -3.0, 1e3)), r.uniform(0.3, 4)
    span = (start, start + length * r.choice((1, 1, 1, -1)))
    try:
        solution = hamsym.solve(problem.H, z0, span, tol=r.choice((1e-4, 1e-7, 1e-10)))
        certificate = solution.certify(rtol=r.choice((0.02, 0.02, 0.3)))
    except HamsymError:
        return False
    uppers, lowers = (
        [getattr(certificate, name), *getattr(certificate, f"component_{name}s"),
         *(getattr(certificate, f"{what}_{name}") for what in ("energy", "ell_max"))]
        for name in ("bound", "lower")
    )  # fmt: skip
    windows = len(solution.trial.readouts)
    rows = errors_of(problem, solution, [(k, c) for k in range(windows) for c in shares(24)])
    for width, count, share_of_most in ((1, 400, 0.7), (0.02, 60, 0.99), (1e-3, 60, 0.9999)):
        most = np.max([errors for *_, errors in rows], axis=0)
        closer = set()
        for n in (n for n, lower in enumerate(lowers) if most[n] < lower):
            for k, share, _, errors in rows:  # the largest one may be between the places
                if errors[n] > share_of_most * most[n]:
                    near = [width * (c - Fraction(1, 2)) + share for c in shares(count)]
                    whole = shares(count) if width == 1 else near
                    closer |= {(k, Fraction(c)) for c in whole if 0 <= c <= 1}
        if closer:
            rows += errors_of(problem, solution, sorted(closer))
    most = np.max([errors for *_, errors in rows], axis=0)
    for _, _, t, errors in rows:
        assert all(error <= upper for error, upper in zip(errors, uppers, strict=True)), seed
        assert errors[0] <= certificate.bound_at(t), seed
    for n, lower in enumerate(lowers):
        assert most[n] >= lower * (1 - mpmath.mpf("1e-5")), (seed, n)
    accepted(certificate, solution)
    return True


def shares(count):
    """Fractions of a window, closer together near its ends."""
    return [Fraction(float(v)) for v in (1 - np.cos(np.pi * np.arange(count + 1) / count)) / 2]


def errors_of(problem, solution, places):
    """Places, times, and the errors of the norm, the components, H and the equations.

    - places: Numbers of windows and fractions of them.
    """
    trial, equations, energy = solution.trial, problem.equations, problem.energy
    edges = [Fraction(float(trial.origin)) + Fraction(edge) for edge in trial.edges.tolist()]
    times = [edges[k] + share * (edges[k + 1] - edges[k]) for k, share in places]
    truth = integrate(
        equations, solution.z0.tolist(), float(edges[0]), [*map(exactly, times)], **_PRECISE
    )
    found, tables = [], {}
    for (k, share), t, true in zip(places, times, truth.states, strict=True):
        near, slopes = exact_state(trial, k, share, edges[k + 1] - edges[k], tables)
        coefficients = [[value] for value in near]
        equations.rates(exactly(t), coefficients, [], 1)
        gaps = [precisely(a - b) for a, b in zip(near, true, strict=True)]
        rest = [precisely(a - b[1]) for a, b in zip(slopes, coefficients, strict=True)]
        own, other = (energy(*map(precisely, [*z, exactly(t)])) for z in (near, true))
        errors = [mpmath.norm(gaps), *map(abs, gaps), abs(own - other), mpmath.norm(rest)]
        found.append((k, share, float(t), errors))
    return found


def exact_state(trial, k, share, length, tables):
    """z^ and dz^/dt of the stored numbers, at a fraction of a window."""
    ctx.cap = 2
    s = arb_series([exactly(share), exactly(1 / length)], 2)
    powers = [arb_series([1], 2), 2 * s - 1]
    while len(powers) < len(trial.series):
        powers.append(2 * powers[1] * powers[-1] - powers[-2])
    if k not in tables:
        product = arb_mat(trial.series.tolist()) * arb_mat(trial.readouts[k].tolist())
        tables[k] = product.tolist()
    f, found = 1 - (-s).exp(), []
    for i, start in enumerate(trial.states[k].tolist()):
        N = sum((p * row[i] for p, row in zip(powers, tables[k], strict=True)), arb_series([0], 2))
        found.append(arb(start) + f * N)
    return [value[0] for value in found], [value[1] for value in found]


# -- periodic orbits ------------------------------------------------------------------------------


def random_orbit(r):
    """A problem and the arguments of a search for a periodic orbit."""
    kind = r.choice(("plane", "plane", "mode", "across", "cycle"))
    if kind == "plane":
        k, a = number(r, 0.3, 2), round(r.uniform(0.2, 1.2), 4)
        potential = pick(r, f"x**2/2 + {k}*x**4/4", f"exp({k}*x) - {k}*x", f"-{k}*cos(x)",
                         f"{k}*sqrt(1 + x**2)", f"(1 - exp(-{k}*x))**2/2",
                         f"x**2/2 - {k}/(1 + x**2)")  # fmt: skip
        kinetic = pick(r, "p_x**2/2", f"p_x**2/{k}", "sqrt(1 + p_x**2)", f"p_x**2/(2 + {k}*x**2)")
        symmetry = pick(r, None, {"p_x": "-p_x"})
        start = [a, 0.0 if symmetry else round(r.uniform(-0.4, 0.4), 4)]
        return Problem(f"{kinetic} + {potential}", ("x",), ("p_x",)), start, {"symmetry": symmetry}
    if kind == "mode":
        dof = r.choice((2, 3))
        q, p = tuple("xyz"[:dof]), tuple(f"p_{name}" for name in "xyz"[:dof])
        others = [f"{number(r, 0.2, 2)}*{x}**2 + {number(r, -0.3, 0.3)}*x**2*{x}**2" for x in q[1:]]
        text = " + ".join([f"{y}**2/2" for y in p] + ["x**2/2 + x**4/4", *others])
        start = [round(r.uniform(0.5, 1.2), 4), *[0.0] * (2 * dof - 1)]
        symmetry = pick(r, None, dict.fromkeys(p) and {y: f"-{y}" for y in p})
        return Problem(text, q, p), start, {"symmetry": symmetry}
    if kind == "across":
        text = (
            "(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2 "
            f"+ {number(r, 0.9, 1.1)}*x**2*y - {number(r, 0.3, 0.36)}*y**3"
        )
        options = {"energy": round(r.uniform(0.06, 0.1), 5)}
        if r.random() < 0.6:
            options["symmetry"] = {"x": "-x", "p_x": "p_x", "p_y": "-p_y"}
        return Problem(text, ("x", "y"), ("p_x", "p_y")), [0, -0.15, 0.35, 0], options
    mu = round(r.choice((1, -1)) * r.uniform(0.2, 1.2), 3)
    force = {"p_x": "mu*(1 - x**2)*p_x"}
    text = "p_x**2/2 + x**2/2" + pick(r, "", " + x**4/20")
    return Problem(text, ("x",), ("p_x",), {"mu": mu}, force), ([2.0, 0.1], 6.5), {}


def checked_orbit(seed):
    """Whether there is an orbit with a certificate, which is then compared with the true one."""
    problem, guess, options = random_orbit(random.Random(f"orbit {seed}"))
    try:
        orbit = hamsym.periodic_orbit(problem.H, guess, **options)
        certificate = orbit.certify()
    except HamsymError:
        return False
    closing, dim = orbit.problem.closing, problem.H.dim
    flow = problem.equations
    z, T, derivative = true_orbit(problem, orbit, certificate)
    back = arb_mat(closing.shift.matrix.T.astype(int).tolist())
    found = {"z0": z, "period": [T], "monodromy": (back * derivative).entries()}
    for name, values in found.items():
        ball = getattr(certificate, name)
        pairs = zip(np.ravel(ball.mid).tolist(), np.ravel(ball.radius).tolist(), strict=True)
        for value, (middle, radius) in zip(values, pairs, strict=True):
            assert not abs(value - arb(middle)) > arb(radius) + arb(10) ** -30, (seed, name)
    times = [exactly(Fraction(edge)) * T / closing.parts for edge in orbit.arc.edges.tolist()]
    states = [z, *integrate(flow, z, 0.0, times[1:-1], **_PRECISE).states] if times[1:-1] else [z]
    sizes = orbit.problem.scale_of(orbit.arc).tolist()
    near = [
        all(abs(a - arb(b)) / arb(s) <= arb(certificate.bound) + arb(10) ** -30
            for a, b, s in zip(state, ends, sizes, strict=True))
        for state, ends in zip(states, orbit.arc.ends.tolist(), strict=False)
    ]  # fmt: skip
    assert near[0], seed
    assert sum(near) >= certificate.pieces, seed
    assert_stability(certificate.stability, (back * derivative), dim, bool(problem.forces))
    accepted(certificate, orbit)
    return True


def true_orbit(problem, orbit, certificate):
    """The start, the period and the derivative over a shift, by Newton's method."""
    closing, flow, dim = orbit.problem.closing, problem.equations, problem.H.dim
    sizes = [arb(size) for size in orbit.problem.scale_of(orbit.arc).tolist()]
    start = [arb(value) for value in orbit.arc.ends[0].tolist()]
    slopes = [[value] for value in start]
    flow.rates(arb(0), slopes, [], 1)
    normal = [slope[1] / size**2 for slope, size in zip(slopes, sizes, strict=True)]
    first = None if closing.first is None else closing.first.matrix.astype(int).tolist()
    turned = closing.shift.matrix.astype(int).tolist()
    energy = problem.energy

    def image(z, T):
        end = integrate(flow, z, 0.0, [T / closing.order], **_PRECISE).states[0]
        conditions = [a - dot(row, z) for a, row in zip(end, turned, strict=True)]
        if first is None:
            gaps = [a - b for a, b in zip(z, start, strict=True)]
            conditions.append(dot(normal, gaps))
        else:
            conditions += [dot(row, z) - a for row, a in zip(first, z, strict=True)]
        if orbit.problem.energy is not None:
            value = energy(*map(precisely, z), 0)
            conditions.append(arb(mpmath.nstr(value, 60)) - arb(orbit.problem.energy))
        return end, conditions

    # Newton's method with the derivative that is claimed: a false one would not converge.
    S, N = arb_mat(turned), arb_mat(certificate.monodromy.mid.tolist())
    field = [slope[1] for slope in slopes]
    rows = [
        [*row, rate / closing.order]
        for row, rate in zip((S * N - S).tolist(), [dot(row, field) for row in turned], strict=True)
    ]
    if first is None:
        rows.append([*normal, arb(0)])
    else:
        rows += [
            [*(arb(v) - (i == k) for k, v in enumerate(row)), arb(0)] for i, row in enumerate(first)
        ]
    if orbit.problem.energy is not None:
        rows.append([*(-v for v in field[dim // 2 :]), *field[: dim // 2], arb(0)])
    z = [arb(value) for value in certificate.z0.mid.tolist()]
    T = arb(float(certificate.period.mid))
    units = [*sizes, T]
    A = arb_mat([[v * unit for v, unit in zip(row, units, strict=True)] for row in rows])
    step = [arb(1)]
    for _ in range(8):
        if max(abs(s) for s in step) < arb(10) ** -34:
            break
        end, values = image(z, T)
        right = A.transpose() * arb_mat([[v] for v in values])
        step = (A.transpose() * A).mid().solve(right).entries()
        z = [(v - s * size).mid() for v, s, size in zip(z, step, sizes, strict=False)]
        T = (T - step[-1] * T).mid()
    assert max(abs(s) for s in step) < arb(10) ** -34
    end, moved = image(z, T)[0], []
    for k, size in enumerate(sizes):
        h = (size * arb(10) ** -22).mid()
        other, _ = image([v + h if i == k else v for i, v in enumerate(z)], T)
        moved.append([(a - b) / h for a, b in zip(other, end, strict=True)])
    return z, T, arb_mat(moved).transpose()


def dot(row, values):
    return sum((a * b for a, b in zip(row, values, strict=True)), arb(0))


def assert_stability(word, matrix, dim, forced):
    """Require that the word for the stability is that of the multipliers."""
    rows = [[precisely(value) for value in row] for row in matrix.tolist()]
    multipliers = sorted(mpmath.eig(mpmath.matrix(rows))[0], key=lambda m: abs(m - 1))
    kinds = set()
    for m in multipliers[1 if forced else 2 :]:
        on = abs(abs(m) - 1) < mpmath.mpf("1e-14")
        off = ("inside" if abs(m) < 1 else "outside") if forced else (
            "real" if abs(mpmath.im(m)) < mpmath.mpf("1e-14") else "complex")  # fmt: skip
        kinds.add("circle" if on else off)
    known = {
        "elliptic": {"circle"}, "hyperbolic": {"real"}, "mixed": {"circle", "real"},
        "complex unstable": {"complex"}, "attracting": {"inside"}, "repelling": {"outside"},
        "parabolic": set(),
    }  # fmt: skip
    if word == "unstable":
        assert kinds & {"real", "complex", "outside"}
    elif word != "undecided":
        assert kinds == known[word]
    if word == "parabolic":
        assert any(abs(rows[i][k] - (i == k)) > 1e-20 for i in range(dim) for k in range(dim))


# -- flow maps ------------------------------------------------------------------------------------


def checked_map(seed):
    """Whether there is a flow map with a certificate, which is then compared with the truth."""
    r = random.Random(f"map {seed}")
    problem = random_problem(r, most=2)
    names = [*problem.q, *problem.p]
    middles = {name: round(r.uniform(-1, 1), 4) for name in names}
    varied = r.sample(names, min(r.choice((1, 1, 2, 2, 3)), len(names)))
    wide = len(varied) + len(problem.parameters) < 3
    z0 = {
        name: (x, round(x + r.choice((0.02, 0.1 if wide else 0.01)), 4)) if name in varied else x
        for name, x in middles.items()
    }
    factor = 1.1 if wide else 1.01
    parameters = {k: (v, round(factor * v, 4)) for k, v in problem.parameters.items()} or None
    start, length = r.choice((0.0, 0.0, -3.0)), r.uniform(0.2, 1.2)
    span = (start, start + length * r.choice((1, 1, -1)))
    H = hamsym.Hamiltonian(
        problem.text, q=problem.q, p=problem.p, parameters={}, forces=problem.forces
    )
    try:
        flow = hamsym.flow_map(H, z0, span, parameters, tol=r.choice((1e-3, 1e-5, 1e-7)))
        certificate = flow.certify(time_limit=20)
    except HamsymError:
        return False
    if not isinstance(flow.map, Leg):
        return False
    largest = [0.0] * len(names)
    for _ in range(6):
        inputs = [pick(r, low, high, r.uniform(low, high)) for low, high in flow.box.values()]
        given = dict(zip(flow.inputs, inputs, strict=True))
        known = {k: given[k] for k in problem.parameters}
        equations = Equations(problem.text, problem.q, problem.p, known, forces=problem.forces)
        inner = sorted((r.uniform(*span) for _ in range(5)), reverse=span[1] < span[0])
        times = [*inner, span[1]]
        starts = [given.get(name, middles[name]) for name in names]
        truth = integrate(equations, starts, span[0], times, **_PRECISE).states
        for t, true in zip(times, truth, strict=True):
            near = exact_leg(flow.map, t, inputs)
            errors = [abs(a - precisely(b)) for a, b in zip(near, true, strict=True)]
            largest = [max(pair) for pair in zip(largest, errors, strict=True)]
    bounds = list(certificate.bound)
    assert all(error <= bound for error, bound in zip(largest, bounds, strict=True)), seed
    accepted(certificate, flow)
    k = max(range(len(names)), key=lambda i: largest[i] / bounds[i])
    false = (*bounds[:k], 0.97 * float(largest[k]), *bounds[k + 1 :])
    with pytest.raises(CertificationError, match=r"is false|is not proven"):
        hamsym.verify(dataclasses.replace(certificate, bound=false), flow, checker="independent")
    return True


def exact_leg(leg, t, inputs):
    """z^ of the stored numbers."""
    exact = [mpmath.mpf(value) for value in inputs]
    y = [
        mpmath.fdot(row, exact) + b for row, b in zip(leg.scaling.tolist(), leg.shift, strict=True)
    ]
    elapsed = mpmath.mpf(t) - mpmath.mpf(float(leg.begin))
    inner = [float(edge) for edge in leg.edges[1:-1]]
    number = sum(abs(elapsed) > abs(edge) for edge in inner)
    low, high = (mpmath.mpf(float(edge)) for edge in leg.edges[number : number + 2])
    piece, tau = leg.pieces[number], (2 * elapsed - low - high) / (high - low)

    def sums(degrees, weights):
        values = [mpmath.fprod(map(mpmath.chebyt, nu, y)) for nu in degrees.tolist()]
        return [mpmath.fdot(values, column) for column in weights.T.tolist()]

    found = [
        mpmath.fdot(row, exact) + float(b)
        for row, b in zip(leg.selection.tolist(), leg.offset, strict=True)
    ]
    if len(leg.start):
        more = sums(leg.start_degrees, leg.start)
        found = [a + b for a, b in zip(found, more, strict=True)]
    series = [mpmath.chebyt(n, tau) for n in range(piece.columns.shape[1])]
    readouts = sums(piece.degrees, piece.readouts)
    for i in range(len(found)):
        columns = [mpmath.fdot(series, column) for column in piece.columns[:, :, i].tolist()]
        found[i] += elapsed * mpmath.fdot(readouts, columns)
    return found


# -- equilibria -----------------------------------------------------------------------------------


def checked_equilibrium(seed):
    """Whether there are equilibria with a ball, which are then compared with the true ones."""
    r = random.Random(f"equilibrium {seed}")
    problem = random_problem(r, moving=False, most=3)
    H, names = problem.H, [*problem.q, *problem.p]
    box = dict.fromkeys(names, (-2.5, 2.5)) if len(names) == 2 else None
    found = [each for each in hamsym.equilibria(H, box=box) if each.enclosure is not None]
    symbols = sympy.symbols(names, real=True)
    exact = {sympy.Symbol(k, real=True): Fraction(v) for k, v in problem.parameters.items()}
    expr = formula(problem.text, [*names, *problem.parameters]).subs(exact)
    slopes = [expr.diff(symbol) for symbol in symbols]
    gradient = sympy.lambdify(symbols, slopes, "mpmath")
    hessian = sympy.lambdify(
        symbols, [[s.diff(symbol) for symbol in symbols] for s in slopes], "mpmath"
    )
    for each in found[:6]:
        root = [mpmath.mpf(value) for value in each.enclosure.mid.tolist()]
        for _ in range(8):
            step = mpmath.lu_solve(mpmath.matrix(hessian(*root)), mpmath.matrix(gradient(*root)))
            root = [a - b for a, b in zip(root, step, strict=True)]
        ball = zip(each.enclosure.mid.tolist(), each.enclosure.radius.tolist(), strict=True)
        for value, (middle, radius) in zip(root, ball, strict=True):
            assert abs(value - mpmath.mpf(middle)) <= radius + mpmath.mpf("1e-40"), seed
        assert_type(each, hessian(*root), seed)
        accepted(each, H, ("independent",))
    return bool(found)


def assert_type(found, rows, seed):
    """Require that the type is that of the eigenvalues of the linear motion."""
    if found.type == "degenerate":
        return  # nothing is claimed
    dim = len(rows)
    rates = [*rows[dim // 2 :], *([-v for v in row] for row in rows[: dim // 2])]
    counts, close = Counter(), mpmath.mpf("1e-20")
    for value in mpmath.eig(mpmath.matrix(rates))[0]:
        real, imaginary = (abs(part) > close for part in (mpmath.re(value), mpmath.im(value)))
        counts["focus" if real and imaginary else "saddle" if real else "centre"] += 1
    named = re.sub(r"(\d+) x (\w+)", lambda m: "-".join([m[2]] * int(m[1])), found.type)
    pairs = {"centre": 2, "saddle": 2, "focus": 4}
    words = Counter(re.sub("focus-focus", "focus", named).split("-"))
    assert words == {name: count // pairs[name] for name, count in counts.items()}, seed
    assert found.linear.stable is (counts.keys() == {"centre"}), seed
    values = mpmath.eigsy(mpmath.matrix(rows), eigvals_only=True)
    sign = 1 if min(values) > 0 else -1 if max(values) < 0 else 0
    assert found.linear.definite in (0, sign), seed


# -- invariants -----------------------------------------------------------------------------------


def random_symmetric(r):
    """A problem with invariants."""
    k, c = number(r, 0.3, 2), number(r, 0.2, 0.9)
    kind, pairs = r.randrange(5), ("x", "y", "z")
    dof = 3 if kind == 2 else 2 if kind == 3 else r.choice((2, 2, 3))
    q, p = pairs[:dof], tuple(f"p_{name}" for name in pairs[:dof])
    kinetic = "(" + " + ".join(f"{y}**2" for y in p) + ")/2"
    radius = "(" + " + ".join(f"{x}**2" for x in q) + ")"
    if kind == 0:
        potential = pick(r, f"-{k}/sqrt{radius}", f"{k}*{radius}**2", f"{k}*exp(-{c}*{radius})",
                         f"log({c} + {radius})", f"{radius}/2",
                         f"{k}/({c} + {radius})")  # fmt: skip
        return Problem(f"{kinetic} + {potential}", q, p)
    if kind == 1:
        a, b = r.choice(((3, 4), (5, 12), (8, 15)))
        length = {3: 5, 5: 13, 8: 17}[a]
        u, v = f"({a}*x + {b}*y)/{length}", f"({b}*x - {a}*y)/{length}"
        rest = f" + {k}*z**2" if dof == 3 else ""
        return Problem(f"{kinetic} + {c}*({u})**4 + {k}*({v})**2{rest}", q, p)
    if kind == 2:
        return Problem(f"{kinetic} + {k}*(exp(x - y) + exp(y - z) + exp(z - x))", q, p)
    if kind == 3:
        return Problem(f"p_x**2/2 + (p_y - {k}*x{pick(r, '', '**2')})**2/2 + {c}*x**4", q, p)
    n = r.choice((1, 2))
    rest = f" + p_z**2/2 + {k}*cos(z)" if dof == 3 else ""
    return Problem(f"p_x**2/2 + x**2/2 + p_y**2/2 + {n}**2*y**2/2{rest}", q, p)


def checked_invariant(seed):
    """Whether there are invariants, which are then followed along a true trajectory."""
    r = random.Random(f"invariant {seed}")
    problem = random_symmetric(r)
    H = problem.H
    try:
        found = H.invariants()
    except HamsymError:
        return False
    z0 = [round(r.uniform(0.3, 1.1), 4) for _ in range(H.dim)]
    times = np.linspace(0, r.uniform(0.5, 2), 5)[1:].tolist()
    truth = integrate(problem.equations, z0, 0.0, times, **_PRECISE)
    for each in found:
        value = sympy.lambdify(H.z, sympy.nsimplify(each.expr, rational=True), "mpmath")
        start = value(*map(mpmath.mpf, z0))
        for state in truth.states:
            gap = abs(value(*map(precisely, state)) - start)
            assert gap <= mpmath.mpf("1e-42") * (1 + abs(start)), (seed, each)
        accepted(each, H, ("independent",))
    return len(found) > 0


# -- all kinds ------------------------------------------------------------------------------------

KINDS = {
    "solution": checked_solution,
    "orbit": checked_orbit,
    "map": checked_map,
    "equilibrium": checked_equilibrium,
    "invariant": checked_invariant,
}
_QUICK = {
    "solution": (3,),
    "orbit": (148,),
    "map": (19,),
    "equilibrium": (10, 13),
    "invariant": (2, 6),
}


@pytest.mark.parametrize("kind", KINDS)
def test_claims_about_random_problems_are_true(kind):
    for seed in _QUICK[kind]:
        assert KINDS[kind](seed)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "first"), [(kind, k) for kind in KINDS for k in range(0, _EVERY.get(kind, 200), 20)]
)
def test_claims_about_many_random_problems_are_true(kind, first):
    """A problem without a proof is none of the claims, but most have one."""
    assert sum(KINDS[kind](seed) for seed in range(first, first + 20)) >= 12


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    ctx.prec, mpmath.mp.dps = _BITS, _DIGITS
    for name, checked in KINDS.items():
        proven = sum(checked(seed) for seed in range(*map(int, sys.argv[1:3])))
        print(f"{name}: {proven} proven, all claims true")
