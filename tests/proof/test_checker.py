"""The independent checker: what it imports, its parts, and what it accepts."""

from __future__ import annotations

import ast
import copy
import dataclasses
import functools
import json
import math
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import mpmath
import numpy as np
import pytest
import sympy
from flint import acb, arb, arb_mat, arb_poly, arb_series, ctx

import hamsym
from hamsym.errors import CertificationError, InputError
from hamsym.flow_maps.expansion import Chain, Split
from hamsym.problems.description import described
from hamsym.proof import checker as package
from hamsym.proof.checker import flow_maps, guesses
from hamsym.proof.checker.flow_maps import check_flow_map
from hamsym.proof.checker.formulas import Formulas, NotProvenError
from hamsym.proof.checker.functions import (
    Equations,
    Interval,
    Polynomial,
    coefficients,
    expanded,
    krawczyk,
    squares,
)
from hamsym.proof.checker.guesses import Effort
from hamsym.proof.checker.invariants import check_invariant
from hamsym.proof.checker.motion import steps
from hamsym.proof.checker.polynomials import polynomials
from hamsym.proof.checker.series import Series, exponents, term
from hamsym.proof.checker.solutions import check_solution
from hamsym.proof.independent import _flow_data, _trial_data, verify_flow_map

FOLDER = Path(package.__file__).parent
QUARTIC = "p**2/2 + x**2/2 + x**4/4"
EFFORT = Effort(46, 2.0**-150)


# -- what it is -----------------------------------------------------------------------------------


def test_it_imports_flint_and_the_standard_library_alone():
    for path in FOLDER.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module]
            else:
                continue
            for name in names:
                own = name.startswith("hamsym.proof.checker")
                assert own or name.split(".")[0] in {*sys.stdlib_module_names, "flint"}, name


@pytest.fixture(scope="module")
def case():
    """A solution with its certificate."""
    solution = hamsym.solve(QUARTIC, [1.3, 1.0], (0, 1.5))
    return solution, solution.certify()


def data_of(solution, certificate):
    return {
        "H": described(solution.H),
        "z0": solution.z0.tolist(),
        "span": list(solution.span),
        "trial": _trial_data(solution),
        "claims": json.loads(certificate.to_json()),
    }


ALONE = """
import importlib.abc, json, sys
class Blocked(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        first, *rest = name.split(".")
        ours = ("hamsym", "hamsym.support", "hamsym.support.suggestions", "hamsym.errors",
                "hamsym.proof", "hamsym.proof.checker")  # hamsym itself imports lazily
        if first in ("numpy", "scipy", "sympy", "mpmath", "torch", "numba"):
            raise ImportError(name)
        if first == "hamsym" and not (name in ours or name.startswith("hamsym.proof.checker.")):
            raise ImportError(name)
sys.meta_path.insert(0, Blocked())
from hamsym.proof.checker.flow_maps import check_flow_map
from hamsym.proof.checker.formulas import NotProvenError
from hamsym.proof.checker.solutions import check_solution
data, flow = json.load(sys.stdin)
check_flow_map(**flow, check_time=lambda: None)
flow["claims"]["bound"][0] = 0
try:
    check_flow_map(**flow, check_time=lambda: None)
except NotProvenError as error:
    print(error)
check_solution(**data, check_time=lambda: None)
data["claims"]["bound"] = 0.97 * float(data["claims"]["bound"])
try:
    check_solution(**data, check_time=lambda: None)
except NotProvenError as error:
    print(error)
"""


def test_it_runs_where_nothing_else_of_hamsym_can_be_imported(case):
    flow = hamsym.flow_map("p**2/2 + x**2/2", {"x": (1, 1.1), "p": 0}, (0, 0.3), tol=1e-6)
    claims = json.loads(flow.certify().to_json())
    data = {"H": described(flow.H), "flow": _flow_data(flow), "claims": claims}
    text = json.dumps([data_of(*case), data])
    found = subprocess.run(
        [sys.executable, "-c", ALONE], input=text, capture_output=True, text=True, check=True
    )
    assert "in a small part of the box" in found.stdout
    assert "its claim about the norm is" in found.stdout


# -- its parts ------------------------------------------------------------------------------------

FUNCTIONS = (
    *("sin(x)", "cos(x)", "tan(x)", "cot(x)", "sec(x)", "csc(x)", "asin(x/2)", "acos(x/2)"),
    *("atan(x)", "acot(x)", "asec(x + 2)", "acsc(x + 2)", "sinh(x)", "cosh(x)", "tanh(x)"),
    *("coth(x)", "sech(x)", "csch(x)", "asinh(x)", "acosh(x + 1)", "atanh(x/2)", "acoth(x + 2)"),
    *("asech(x/2)", "acsch(x)", "exp(x)", "log(x)", "sqrt(x)", "erf(x)", "x**(-7/2)", "x**3.2"),
    *("x**-3", "x**x", "2**x", "1e-3*x - .5*(x/3 + pi)", "(x + 1)*(x + 1)/(x - 3)"),
)


@pytest.mark.parametrize("text", FUNCTIONS)
def test_derivatives_and_series_are_those_of_sympy(text):
    x = sympy.Symbol("x", real=True)
    expr = hamsym.formula.parser.parse_expression(text)
    formulas = Formulas(["x"], {})
    place = formulas.parse(text)
    slope = formulas.gradient(place, 1)[0]
    with ctx.workprec(200):
        run = formulas.program([place, slope, formulas.gradient(slope, 1)[0]])
        point = sympy.Rational(7, 8)
        values = run([arb(7) / 8])
        complex_values = run([acb(arb(7) / 8)])
        ctx.cap = 4
        series = run([arb_series([arb(7) / 8, 1], 4)])[0]
        for k, value in enumerate(values):
            true = arb(str(expr.diff(x, k).subs(x, point).evalf(50)))
            for found in (value, complex_values[k].real, series[k] * [1, 1, 2][k]):
                assert abs(found - true) < 1e-40 * (1 + abs(true))
                assert found.rad() < 1e-40 * (1 + abs(true))


@pytest.mark.parametrize(
    "text",
    ["x.real", "x[0]", "f(x)", "x if x else 1", "abs(x)", "max(x, 1)", "y", "'a'", "x // 2", "1j",
     "__import__('os')", "x**2000", "(", "sin(x, x)", "lambda: 1", "True"],
)  # fmt: skip
def test_other_texts_are_refused(text):
    with pytest.raises(NotProvenError):
        Formulas(["x"], {}).parse(text)


@pytest.mark.parametrize("text", ["log(x)", "sqrt(x)", "1/x", "x**(1/3)", "asin(1 + x/9)"])
def test_functions_are_refused_where_they_are_not_analytic(text):
    formulas = Formulas(["x"], {})
    run = formulas.program([formulas.parse(text)])
    with pytest.raises(NotProvenError):
        expanded(lambda x: run([x + 1]), 8)


def test_taylor_remainders_contain_the_function():
    with ctx.workprec(128):
        (found,) = expanded(lambda x: [(x / 2).sin() / (x + 9)], 12)
        for k in range(-8, 9):
            x = arb(k) / 8
            value = sum((c * x**n for n, c in enumerate(found.first)), arb(0))
            gap = abs(value - (x / 2).sin() / (x + 9))
            assert gap < found.rest()
            slope = sum((n * c * x ** (n - 1) for n, c in enumerate(found.first) if n), arb(0))
            true = (x / 2).cos() / (2 * (x + 9)) - (x / 2).sin() / (x + 9) ** 2
            assert abs(slope - true) < found.rest_of_derivative()


def test_values_of_polynomials_on_rectangles_are_close():
    """Horner's rule for rectangles, which turns them, bounds these by 441."""
    with ctx.workprec(53):
        polynomial = Polynomial([arb(-1 / 8) ** k for k in range(58)])
        for square in squares(5):
            found, middle = polynomial(square), square.mid()
            assert abs(found) < 6
            for x in (-1, 0.6, 1):
                for y in (-1, -0.3, 1):
                    inner = acb(x * square.real.rad(), y * square.imag.rad())
                    assert found.contains(polynomial(middle + inner).mid())


def test_bounds_of_polynomials_are_their_maxima():
    rng, axis = np.random.default_rng(0), np.linspace(-1, 1, 81)
    space, count = polynomials(1, 3, 4), 4
    for _ in range(5):
        rows = rng.normal(size=(len(exponents(1, 3)), count))
        values = np.polynomial.polynomial.polyval2d(*np.meshgrid(axis, axis), rows)
        largest, whole = float(abs(values).max()), arb_mat(rows.tolist())
        nearly = 1.02 * largest  # it may be larger between the points
        space.require_below(whole, arb(nearly), arb(0), "g")
        space.require_below(whole, arb(nearly + 1), arb(1), "g")
        for bound, distance in ((0.99 * largest, 0), (nearly, 0.04 * largest)):
            with pytest.raises(NotProvenError, match="g is"):
                space.require_below(whole, arb(bound), arb(distance), "g")
    line, of_x = arb_mat([[2.0, 0.5, -0.25]]), polynomials(0, 0, 3)
    assert of_x.reaches(line, arb(2.25))
    assert not of_x.reaches(line, arb(2.2501))


def truth(text, z0, span):
    """The state at the end of a span, to 40 digits, by mpmath's Taylor series."""
    H = hamsym.Hamiltonian(text)
    rates = [sympy.lambdify([*H.z, sympy.Symbol("t")], rate, "mpmath") for rate in H.vector_field]
    with mpmath.workdps(50):
        solve = mpmath.odefun(
            lambda t, z: [rate(*z, t) for rate in rates], mpmath.mpf(span[0]), list(z0), tol=1e-45
        )
        return [sympy.Float(value, 50) for value in solve(mpmath.mpf(span[1]))]


RANDOM = (
    "p**2/2 + {a}*x**4/4 + {b}*x**2/2 + {c}*x",
    "p**2/2 - {a}*cos(x) + {b}*x**2*p/9",
    "p**2/(2 + {b}*x**2) + exp({a}*x/2) + exp(-x)",
    "(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2 + {a}*x**2*y - {b}*y**3/3",
    "(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2 + {a}) + {c}*x*p_y",
)


def random_problem(seed):
    rng = np.random.default_rng(seed)
    values = dict(zip("abc", map(float, rng.uniform(0.2, 1, 3).round(3)), strict=True))
    text = RANDOM[seed % len(RANDOM)].format(**values)
    z0 = rng.uniform(0.3, 1, hamsym.Hamiltonian(text).dim).tolist()
    return text, z0, (0.0, float(rng.uniform(0.5, 1.5)))


def assert_encloses(seed):
    text, z0, span = random_problem(seed)
    with ctx.workprec(208):
        equations = Equations(described(hamsym.Hamiltonian(text)))
        *_, last = steps(equations, z0, span, EFFORT, lambda: None)
        for part, tube, true in zip(last.y, last.tube, truth(text, z0, span), strict=True):
            assert abs(part(arb(1)) - arb(str(true))) <= tube + arb(2) ** -130
            assert tube < 1e-25


def test_steps_enclose_the_solution():
    assert_encloses(0)


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, 200, 10))
def test_steps_enclose_random_solutions(first):
    for seed in range(first, first + 10):
        assert_encloses(seed)


def test_a_step_holds_for_every_polynomial(monkeypatch):
    """A wrong y makes a wide tube or no proof, never a wrong one."""
    guess = guesses.guess

    def worse(*arguments):
        found = guess(*arguments)
        y = [Polynomial([c * (1 + arb(2) ** -40) for c in p.real.coeffs()]) for p in found.y]
        return dataclasses.replace(found, y=y)

    monkeypatch.setattr(guesses, "guess", worse)
    with ctx.workprec(208):
        equations = Equations(described(hamsym.Hamiltonian(QUARTIC)))
        *_, last = steps(equations, [1.3, 1.0], (0.0, 1.0), EFFORT, lambda: None)
        true = truth(QUARTIC, [1.3, 1.0], (0.0, 1.0))
        for part, tube, value in zip(last.y, last.tube, true, strict=True):
            assert 1e-14 < abs(part(arb(1)) - arb(str(value))) <= tube


def test_matrices_without_use_prove_nothing(monkeypatch):
    """V = 0 leaves |1 - V W| = 1."""
    guess = guesses.guess

    def useless(*arguments):
        found = guess(*arguments)
        return dataclasses.replace(found, V=[0 * part for part in found.V])

    monkeypatch.setattr(guesses, "guess", useless)
    equations = Equations(described(hamsym.Hamiltonian(QUARTIC)))
    with ctx.workprec(208), pytest.raises(NotProvenError, match="no proof beyond t = 0"):
        list(steps(equations, [1.3, 1.0], (0.0, 1.0), EFFORT, lambda: None))


# -- solutions ------------------------------------------------------------------------------------

MEMBERS = {
    "backward": lambda: hamsym.solve(QUARTIC, [1.3, 1.0], (3.0, 1.5)),
    "driven": lambda: hamsym.solve("p**2/2 + x**2/2 - 0.3*x*cos(1.3*t)", [1.3, 1], (1e6, 1e6 + 2)),
    "forces": lambda: hamsym.solve(
        hamsym.Hamiltonian("p**2/2 + k*x**2/2", parameters={"k": 1.1}, forces={"p": "-p/10"}),
        [1.3, 1.0],
        (0, 2),
    ),
    "at rest": lambda: hamsym.solve("(px**2 + py**2 + x**2 + y**2*x)/2", [1, 0, 0, 0], (0, 2)),
    "units": lambda: hamsym.solve("p**2/(2*1.67e-27) + 1e-5*x**2/2", [1e-3, 0], (0, 2e-11)),
    "functions": lambda: hamsym.solve(
        "p**2/2 + log(1 + x**2) + tanh(x)*atan(x) + sqrt(2 + x)", [0.3, 1], (0, 1)
    ),
    "network": lambda: hamsym.solve(
        QUARTIC, [1.3, 1], (0, 0.1), method=hamsym.Adam(epochs=30, hidden=(2,))
    ),
    "tanh": lambda: hamsym.solve(
        QUARTIC, [1.3, 1], (0, 0.5), method=hamsym.Adam(epochs=30, hidden=(4, 4), activation="tanh")
    ),
    "sigmoid": lambda: hamsym.solve(
        QUARTIC,
        [1.3, 1],
        (1, 0.5),
        method=hamsym.Adam(
            epochs=30, hidden=(3,), activation="sigmoid", envelope="linear", shared_weights=False
        ),
    ),
    "chain": lambda: hamsym.solve(QUARTIC, [1.3, 1], (0, 1), method=hamsym.NetworkChain()),
}


@pytest.mark.slow_cases("chain", "functions", "tanh", "sigmoid", "at rest", "backward")
@pytest.mark.parametrize("name", MEMBERS)
def test_certificates_are_verified(name):
    solution = MEMBERS[name]()
    certificate = solution.certify()
    hamsym.verify(certificate.to_json(), solution, checker="independent")
    claims = dataclasses.asdict(certificate)
    k = int(np.argmax(claims["component_lowers"]))
    forged = list(claims["component_bounds"])
    forged[k] = 0.97 * claims["component_lowers"][k]
    data = data_of(solution, certificate) | {"claims": claims | {"component_bounds": forged}}
    with pytest.raises(NotProvenError, match=f"the error of {solution.H.names[k]} is false"):
        check_solution(**data, check_time=lambda: None)


def test_bounds_that_were_asked_for_are_verified(case):
    certificate = case[0].certify(bound=1e-9)
    hamsym.verify(certificate, case[0], checker="independent")


# -- equilibria and invariants --------------------------------------------------------------------


EQUILIBRIA = (
    "p**2/2 - cos(x)",
    "(px**2 + py**2 + x**2 + y**2)/2 + x**2*y - y**3/3",
    "px*y - py*x + (px**2 + py**2)/2 - 0.9/sqrt((x + 0.1)**2 + y**2)"
    " - 0.1/sqrt((x - 0.9)**2 + y**2)",
    "p**2/(2*1.67e-27) + 1e-5*(x - 1e-3)**2/2",
    "x*y + px*py + 0.1*(x**2 - y**2) + 0.3*px**2",
    "(p_x**2 + p_y**2 + x**2)/2 - 1.458*cos(y) - 0.3612*cos(x - y)",  # x = 0 is known better than y
)


@functools.cache
def enclosed_equilibria(text):
    H = hamsym.Hamiltonian(text)
    box = dict.fromkeys(H.names, (-2, 2)) if H.dim == 2 else None
    found = [each for each in hamsym.equilibria(H, box=box) if each.enclosure is not None]
    assert found
    return [(H, each) for each in found]


@pytest.mark.slow_cases(EQUILIBRIA[2])
@pytest.mark.parametrize("text", EQUILIBRIA)
def test_equilibria_are_verified(text):
    for H, found in enclosed_equilibria(text):
        hamsym.verify(found, H, checker="independent")


def test_a_degenerate_equilibrium_claims_no_zero():
    H = hamsym.Hamiltonian("p**2/2 + x**4/4")
    found = hamsym.equilibria("p**2/2 + x**2/2 + x**4/4", box={"x": (-1, 1), "p": (-1, 1)})[0]
    with pytest.raises(CertificationError, match="not proven|singular"):
        hamsym.verify(found, H, checker="independent")


INVARIANTS = (
    "(p_x**2 + p_y**2)/2 + (x**2 + y**2)**2",
    "(px**2 + py**2)/2 - k/sqrt(x**2 + y**2)",
    "(p1**2 + p2**2 + p3**2)/2 + exp(q1 - q2) + exp(q2 - q3) + exp(q3 - q1)",
    "p_th**2/2 + p_f**2/(2*sin(th)**2) + cos(th)",
    "(p_x**2 + p_y**2 + x**2 + y**2)/2",
)


@pytest.mark.parametrize("text", INVARIANTS)
def test_invariants_are_verified(text):
    H = hamsym.Hamiltonian(text)
    energy = hamsym.Invariant(H.expr, 2)
    for found in [energy, *H.invariants()]:
        hamsym.verify(found, H, checker="independent")


def test_an_invariant_for_some_values_is_none_for_others():
    H = hamsym.Hamiltonian(
        "(px**2 + py**2)/2 + (a*x**2 + b*y**2)/2", parameters={"a": 1.0, "b": 1.0}
    )
    expr = H.q[0] * H.p[1] - H.q[1] * H.p[0]
    some = hamsym.Invariant(expr, 2, holds_for={"a": 1.0, "b": 1.0})
    hamsym.verify(some, H, checker="independent")
    for values in ({}, {"a": 1.0}, {"a": 1.0, "b": 1.0 + 1e-15}):
        other = dataclasses.replace(some, holds_for=values)
        with pytest.raises(CertificationError):
            hamsym.verify(other, H, checker="independent")


def test_functions_of_opposite_arguments_are_related():
    H = described(hamsym.Hamiltonian("p**2/2 + x**2/2"))
    zero = "(p**2 + x**2)*(sin(x - 1) + sin(1 - x) + cos(2*p) - cos(-2*p) + exp(x)*exp(-x))"
    check_invariant(H, [], {"formula": zero, "floats": {}})
    for own, other in (
        ("sin(1", "2*sin(1"), ("cos(-2*p)", "cos(-3*p)"), ("exp(-x)", "exp(-2*x)")
    ):  # fmt: skip
        false = zero.replace(own, other)
        with pytest.raises(NotProvenError, match="conserved"):
            check_invariant(H, [], {"formula": false, "floats": {}})


def test_krawczyks_operator_contains_the_zero():
    box = [arb(1.5, 0.5)]
    for centre in (1.25, 1.5, 1.75):
        value, slope = arb_mat([[centre**2 - 2]]), arb_mat([[2 * box[0]]])
        (found,) = krawczyk([arb(centre)], box, value, slope)
        assert found.contains(arb(2).sqrt().mid())


# -- flow maps ------------------------------------------------------------------------------------

HENON = "(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2 + x**2*y - y**3/3"
KEPLER = "(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)"
ECCENTRIC = {"x": "1 - e", "y": 0, "p_x": 0, "p_y": "sqrt((1 + e)/(1 - e))"}
FLOWS = {
    "oscillator": lambda: hamsym.flow_map(
        "p**2/2 + x**2/2", {"x": (1, 2), "p": (-1, 1)}, (0, 1), tol=1e-8
    ),
    "pendulum": lambda: hamsym.flow_map(
        "p**2/2 - cos(x)", {"x": (0.5, 0.7), "p": (-0.2, 0.2)}, (0, 2), tol=1e-6
    ),
    "quartic": lambda: hamsym.flow_map(QUARTIC, {"x": (1.29, 1.31), "p": (0.99, 1.01)}, (0, 1)),
    "henon": lambda: hamsym.flow_map(
        HENON, dict.fromkeys(("x", "y", "p_x", "p_y"), (0.1, 0.11)), (0, 0.5), tol=1e-6
    ),
    "parameter": lambda: hamsym.flow_map(
        "p**2/2 - k*cos(x)", {"x": (1, 1.1), "p": 0}, (0, 1), {"k": (0.5, 0.7)}, tol=1e-6
    ),
    "driven": lambda: hamsym.flow_map(
        "p**2/2 - cos(x) - x*sin(t)", {"x": (0, 0.1), "p": 0}, (1, 0)
    ),
    "forces": lambda: hamsym.flow_map(
        hamsym.Hamiltonian("p**2/2 + x**2/2", forces={"p": "(1 - x**2)*p"}),
        {"x": (1, 1.1), "p": 0.3}, (0, 0.5), tol=1e-6,
    ),
    "expressions": lambda: hamsym.flow_map(
        KEPLER, ECCENTRIC, (0, 0.5), {"e": (0.1, 0.12)}, tol=1e-7
    ),
    "functions": lambda: hamsym.flow_map(
        "p**2/2 + log(1 + x**2) + tanh(x)*atan(x) + asin(x/3) + exp(-x) + erf(x) + sqrt(2 + x)",
        {"x": (0.3, 0.4), "p": 1}, (0, 0.4), tol=1e-6,
    ),
}  # fmt: skip


@pytest.mark.slow_cases(*(name for name in FLOWS if name not in ("oscillator", "driven")))
@pytest.mark.parametrize("name", FLOWS)
def test_flow_maps_are_verified(name):
    flow = FLOWS[name]()
    certificate = flow.certify()
    hamsym.verify(certificate.to_json(), flow, checker="independent")
    bounds = [1e-4 * bound for bound in certificate.bound]
    forged = json.loads(certificate.to_json()) | {"bound": bounds}
    with pytest.raises(NotProvenError) as refusal:
        check_flow_map(described(flow.H), _flow_data(flow), forged, lambda: None)
    assert "another form" not in str(refusal.value)


@pytest.mark.parametrize(("in_x", "in_s"), [(0.5, 0.0), (0.0, 2.0)])
def test_bounds_of_defects_contain_what_series_leave_out(monkeypatch, in_x, in_s):
    """Of exp, whose terms are all positive, and which is largest at x = s = 1."""
    monkeypatch.setattr(flow_maps, "_ORDER", 4)
    flow = hamsym.flow_map("p**2/2 + exp(x)", {"x": (-1, 1), "p": 0}, (0, 0.1), tol=1e-2)
    claims, data = {"bound": [1e6, 1e6], "box": {"x": [-1, 1]}}, _flow_data(flow)
    check = flow_maps._Check(described(flow.H), data, claims, lambda: None)
    check.degree = 2
    cell, (_, linear) = flow_maps._Cell(check, data["map"], check._box), exponents(1, 1)
    y = [{0: arb_poly([0, in_x]), linear: arb_poly([in_s])}, {0: arb_poly()}]
    ranges = [Polynomial(flow_maps._range_of(terms)) for terms in y]
    part = Interval(Fraction(0), Fraction(1))
    found = cell._defect(y, guesses.Guess(part, ranges, [], [], 1.0))
    assert math.exp(in_x + in_s) < found[1] < 1.25 * math.exp(in_x + in_s)


def test_splits_are_verified_on_both_sides():
    flow = FLOWS["oscillator"]()
    certificate, other = flow.certify(), copy.deepcopy(flow.map)
    other.offset = other.offset + 1e-6
    for normal, threshold in (([-2.0, 0.0], -3.0), ([0.0, 1.0], 0.25)):
        for low, high in ((flow.map, flow.map), (other, flow.map), (flow.map, other)):
            split = Split(np.array(normal), threshold, low, high)
            halves = dataclasses.replace(flow, map=split)
            if low is high:
                verify_flow_map(certificate, halves, lambda _: None)
                continue
            with pytest.raises(CertificationError, match="is false"):
                verify_flow_map(certificate, halves, lambda _: None)


@pytest.mark.parametrize("text", FUNCTIONS)
def test_series_in_inputs_are_those_of_sympy(text):
    """Up to degree 4 in two inputs, about a series in x."""
    u, v, x = sympy.symbols("u v x", real=True)
    expr = hamsym.formula.parser.parse_expression(text)
    formulas = Formulas(["x"], {})
    with ctx.workprec(200):
        ctx.cap = 3
        start = arb_series([arb(7) / 8, 1], 3)
        inputs = Series.line(2, 4, start, {0: arb(1) / 4, 1: arb_series([2, 1], 3)})
        (found,) = formulas.program([formulas.parse(text)])([inputs])
        inner = sympy.Rational(7, 8) + x + u / 4 + (2 + x) * v
        whole = expr.subs(next(iter(expr.free_symbols)), inner)
        for key, nu in exponents(2, 4).items():
            if sum(nu) in (1, 3, 4):
                continue
            for k in range(3 if sum(nu) == 0 else 2):
                true = whole.diff(u, nu[0], v, nu[1], x, k).subs({u: 0, v: 0, x: 0}).evalf(50)
                factor = math.prod(map(math.factorial, (*nu, k)))
                own = coefficients(term(found, key), 3)[k]
                assert abs(own - arb(str(true)) / factor) < 1e-35 * (1 + abs(own))
                assert own.rad() < 1e-35 * (1 + abs(own))


# -- other arguments ------------------------------------------------------------------------------


def test_what_is_not_covered_is_said():
    flow = hamsym.flow_map("p**2/2 + x**2/2", {"x": (1, 1.1), "p": 0}, (0, 0.3), tol=1e-6)
    legs = Chain([flow.map, flow.map], np.array([0.1]), np.array([], dtype=int))
    plane = Split(np.array([1.0, 1.0]), 0.0, flow.map, flow.map)
    certificate = flow.certify()
    for map in (legs, plane):
        with pytest.raises(CertificationError, match="several legs, or is split along a slanted"):
            verify_flow_map(certificate, dataclasses.replace(flow, map=map), lambda _: None)


def test_unknown_checkers_are_refused(case):
    with pytest.raises(InputError, match="independent"):
        hamsym.verify(case[1], case[0], checker="independant")


def test_time_limit_of_the_checker(case):
    with pytest.raises(CertificationError, match="time limit"):
        hamsym.verify(case[1], case[0], time_limit=1e-3, checker="independent")


def test_intervals_know_their_place():
    line = Interval(Fraction(1), Fraction(1, 2)).line(Interval(Fraction(2), Fraction(1, 4)))
    assert [float(c.mid()) for c in line.coeffs()] == [2.0, 0.5]
