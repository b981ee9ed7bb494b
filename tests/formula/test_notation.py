"""Sums are displayed in the order in which they were written, everywhere alike."""

from __future__ import annotations

import pickle
import re

import numpy as np
import pytest
import sympy

import hamsym
from hamsym import Hamiltonian
from hamsym.cli.derivation import _lines
from hamsym.formula.parser import parse_expression
from hamsym.formula.printer import FormulaPrinter
from hamsym.workbench.mathml import equations, mathml
from hamsym.workbench.notebooks.representation import typeset as typeset_formula

SPRING = "k*(r - l)**2/2 - g*r*cos(theta) + p_theta**2/(2*r**2) + p_r**2/2"


def test_formula_is_displayed_as_it_was_written() -> None:
    for formula in (
        SPRING,
        "x**4/4 - x**2/2 + p**2/2",
        "p**2/2 - a/sqrt((x - 1 + a)**2 + 1)",
        "sum(i, 1, 3, q[i]**2/2 + p[i]**2/2) + sum(i, 1, 2, c*(q[i+1] - q[i])**2/2)",
    ):
        H = Hamiltonian(formula)
        expected = formula
        if formula.startswith("sum"):
            expected = "q1**2/2 + p1**2/2 + q2**2/2 + p2**2/2 + q3**2/2 + p3**2/2"
            expected += " + c*(q2 - q1)**2/2 + c*(q3 - q2)**2/2"
        assert H.notation.text(H.expr) == expected


def test_potential_has_the_order_of_the_formula() -> None:
    H = Hamiltonian("-x**2/2 + x**4/4 + p**2/2")
    assert H.potential is not None
    assert H.notation.text(H.potential) == "-x**2/2 + x**4/4"


def test_terms_of_equations_follow_those_of_the_formula() -> None:
    H = Hamiltonian(SPRING, forces={"p_r": "-c*p_r"})
    assert H.notation.text(H.vector_field[2]) == (
        "-k*(r - l) + g*cos(theta) + p_theta**2/r**3 - c*p_r"
    )
    other = Hamiltonian("p_r**2/2 + p_theta**2/(2*r**2) + k*(r - l)**2/2 - g*r*cos(theta)")
    assert other.notation.text(other.vector_field[2]) == (
        "p_theta**2/r**3 - k*(r - l) + g*cos(theta)"
    )


@pytest.mark.parametrize(
    ("formula", "number", "expected"),
    [
        ("4*e*((s/r)**12 - (s/r)**6) + p_r**2/2", 1, "24*e*(2*s**12/r**13 - s**6/r**7)"),
        ("p**2/2 + (a*cos(k*x) + b*cos(x))*c", 1, "c*(a*k*sin(k*x) + b*sin(x))"),
        ("(p_y**2/2 - (a*cos(x) + b*cos(2*x))*c*y)", 2, "-c*y*(a*sin(x) + 2*b*sin(2*x))"),
        ("p**2/2 + (1/x - x**2)**2/2", 1, "(1/x**2 + 2*x)*(1/x - x**2)"),
        ("p**2/2 + (1 - x)**3/3 - a*(b - x)", 1, "(1 - x)**2 - a"),
        ("p**2/2 + k*(l - x)**2/2", 1, "k*(l - x)"),
    ],
)
def test_products_have_as_few_minus_signs_as_they_can(
    formula: str, number: int, expected: str
) -> None:
    H = Hamiltonian(formula, **({"q": ["x", "y"], "p": ["p_x", "p_y"]} if "p_y" in formula else {}))
    assert H.notation.text(H.vector_field[number]) == expected
    assert H.notation.latex(H.vector_field[number]).count("-") == expected.count("-")
    assert Hamiltonian(H.formula, q=H.q, p=H.p).formula == H.formula


def test_denominators_have_the_sign_of_most_terms() -> None:
    cart = Hamiltonian.from_lagrangian(
        "(m1 + m2)*xdot**2/2 + m2*l*xdot*thetadot*cos(theta) + m2*l**2*thetadot**2/2"
    )
    text = cart.notation.text(cart.vector_field[0])
    assert text.endswith("/(l**2*m2*(m1 + m2 - m2*cos(theta)**2))")
    assert not text.startswith("-")


@pytest.mark.parametrize("name", ["stormer", "double_pendulum", "toda_chain"])
def test_displayed_equations_mean_what_is_derived(name: str) -> None:
    H = getattr(hamsym.systems, name)().H
    z = np.linspace(0.3, 0.9, H.dim)
    rates = [H.observable(H.notation.text(rate))(z, 0.4) for rate in H.vector_field]
    system = H.compile("numpy")
    np.testing.assert_allclose(rates, system.vector_field(*system.arguments(z, 0.4)), rtol=1e-12)


def test_order_does_not_change_the_identity() -> None:
    H = Hamiltonian(SPRING)
    other = Hamiltonian("p_theta**2/(2*r**2) + p_r**2/2 - g*r*cos(theta) + (l - r)**2*k/2")
    assert Hamiltonian(H.formula) == H
    assert H.formula == Hamiltonian(H.formula).formula != H.notation.text(H.expr)
    assert other.formula == H.formula.replace("r - l", "l - r")
    assert H.source("numpy") == Hamiltonian(H.formula).source("numpy")


def test_order_is_kept_by_copies_and_other_parameters() -> None:
    H = Hamiltonian(SPRING, parameters={"k": 1.0, "l": 1.0, "g": 1.0})
    for again in (pickle.loads(pickle.dumps(H)), H.with_parameters(k=2.0)):
        assert again.notation.text(again.expr) == SPRING


def test_every_display_has_one_order() -> None:
    H = Hamiltonian(SPRING)
    described = hamsym.describe(H)
    page = equations(H)
    typeset = [
        "".join(map(typeset_formula, described.formulas)),
        "".join(map(str, [page["H"], *page["rates"]])),
    ]
    displays = [
        ("\n".join(_lines(H, None)), H.notation.text),
        ("\n".join(formula.text for formula in described.formulas), H.notation.text),
        (H._repr_latex_() + H.equations._repr_latex_(), H.notation.latex),
        *((page, lambda term: mathml(term, H.notation)) for page in typeset),
    ]
    for page, write in displays:
        for expr in (H.expr, H.vector_field[2]):
            terms = [-t if t.could_extract_minus_sign() else t for t in H.notation.terms(expr)]
            places = [_plain(page).find(_plain(write(term))) for term in terms]
            assert min(places) >= 0
            assert places == sorted(places)


def _plain(page: str) -> str:
    return re.sub(r"<[^>]+>|\s", "", page)


@pytest.mark.parametrize("formula", ["p**2/2 + x**2/2", SPRING])
def test_displayed_text_parses_to_the_same_formula(formula: str) -> None:
    H = Hamiltonian(formula)
    assert sympy.simplify(Hamiltonian(H.notation.text(H.expr)).expr - H.expr) == 0
    assert re.search(r"1/\d+\*", H.notation.text(H.expr)) is None


@pytest.mark.parametrize(
    "number", [0.3, -0.1, 0.5, 3.0, 1e23, 1e-300, -5e-324, sympy.Float("0.1", 50)]
)
def test_printed_floats_are_parsed_to_the_numbers_that_proofs_take(number) -> None:
    x, p = sympy.symbols("x p", real=True)
    for expr in (number * x + p, x**2 / (p + number), sympy.exp(number * x - 3000)):
        exact = expr.xreplace({f: sympy.Rational(f) for f in expr.atoms(sympy.Float)})
        assert parse_expression(FormulaPrinter()(expr)) == exact


def test_floats_are_short_where_they_are_displayed() -> None:
    x, p = sympy.symbols("x p", real=True)
    H = Hamiltonian(p**2 / 2 + 0.3 * x - 0.1 * x**2, q=["x"], p=["p"])
    assert H.notation.text(H.expr) == "0.3*x + p**2/2 - 0.1*x**2"
    assert H.formula == "5404319552844595/2**54*x + p**2/2 - 3602879701896397/2**55*x**2"
