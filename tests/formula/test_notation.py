"""Sums are displayed in the order in which they were written, everywhere alike."""

from __future__ import annotations

import pickle
import re

import pytest
import sympy

import hamsym
from hamsym import Hamiltonian
from hamsym.cli.derivation import _lines
from hamsym.workbench.explore.equations import equations
from hamsym.workbench.mathml import mathml
from hamsym.workbench.notebooks.cards import typeset as typeset_formula
from hamsym.workbench.reports import contents

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


def test_terms_of_equations_follow_those_of_the_formula() -> None:
    H = Hamiltonian(SPRING, forces={"p_r": "-c*p_r"})
    assert H.notation.text(H.vector_field[2]) == (
        "-k*(r - l) + g*cos(theta) + p_theta**2/r**3 - c*p_r"
    )
    other = Hamiltonian("p_r**2/2 + p_theta**2/(2*r**2) + k*(r - l)**2/2 - g*r*cos(theta)")
    assert other.notation.text(other.vector_field[2]) == (
        "p_theta**2/r**3 - k*(r - l) + g*cos(theta)"
    )


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
    report = contents.equations(H)
    typeset = [
        "".join(map(typeset_formula, described.formulas)),
        "".join(map(str, [report["H"], *report["rates"]])),
        equations(H),
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
