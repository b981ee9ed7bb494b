"""Facts of Hamiltonians, their equations and invariants, and of generated code."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hamsym.facts.facts import Column, Fact, Facts, Formula, Table
from hamsym.facts.wording import counted, formulas_of, listed, problem_facts
from hamsym.symbolic.equations import Formulas

if TYPE_CHECKING:
    from hamsym.codegen.system import System
    from hamsym.hamiltonian import Hamiltonian
    from hamsym.symbolic.equations import Equations
    from hamsym.symbolic.invariant import Invariant, Invariants
    from hamsym.transformations.regularization import Regularization
    from hamsym.transformations.transformation import Transformation

_DERIVED = 2_000  # operations of an H whose equations of motion are derived for a description


def _hamiltonian(H: Hamiltonian) -> Facts:
    import sympy

    words = [counted(H.dof, "degree of freedom", "degrees of freedom")]
    formulas, cyclic = formulas_of(H), list[str]()
    if sum(sympy.count_ops(formula.expr) for formula in formulas) <= _DERIVED:
        words.append("separable" if H.is_separable else "not separable")
        formulas += _equations_of(H.equations)
        cyclic = [symbol.name for symbol in H.cyclic_coordinates]
    why = "forces act" if H.forces else "H depends on time"
    words.append("energy conserved" if H.conserves_energy else f"energy not conserved: {why}")
    pairs = [f"({q}, {p})" for q, p in zip(H.q, H.p, strict=True)]
    given = (
        Fact("names", "pairs", H.names, listed(pairs)),
        Fact("cyclic", "cyclic coordinates", cyclic, listed(cyclic)),
        *problem_facts(H),
    )
    return Facts("Hamiltonian", ", ".join(words), formulas=formulas, given=given)


def _transformation(found: Transformation) -> Facts:
    return _changed(found, "the same motion in other variables")


def _regularization(found: Regularization) -> Facts:
    return _changed(found, f"the same motion in another time; {found.time} is that of the original")


def _changed(found: Any, headline: str) -> Facts:
    """The new Hamiltonian, and the old variables in the new ones."""
    H = found.H
    maps = tuple(
        Formula(name, expr, H.notation.text(expr), H.notation)
        for name, expr in found.formulas.items()
    )
    given = problem_facts(H)
    kind = type(found).__name__
    return Facts(kind, headline, formulas=(*formulas_of(H), *maps), given=given)


def _equations_of(equations: Formulas) -> tuple[Formula, ...]:
    notation = equations.notation
    return tuple(
        Formula("", each, f"d{each.lhs.expr}/dt = {notation.text(each.rhs)}", notation)
        for each in equations
    )


def _formulas(equations: Formulas) -> Facts:
    return Facts("Equations of motion", formulas=_equations_of(equations))


def _equations(equations: Equations) -> Facts:
    rates = zip(equations.z, equations.vector_field, strict=True)
    formulas = (Formula(f"d{symbol}/dt", rate, str(rate)) for symbol, rate in rates)
    first = Formula("H", equations.expr, str(equations.expr))
    return Facts("Equations", formulas=(first, *formulas))


def _invariant(found: Invariant) -> Facts:
    headline = f"conserved, of degree {found.degree}"
    held = ", ".join(f"{name} = {value!r}" for name, value in found.holds_for.items())
    if not found.independent:
        headline += ", a function of H and the invariants before it"
    return Facts(
        "Invariant",
        headline,
        formulas=(Formula("", found.expr, found.formula),),
        given=(Fact("holds_for", "holds for", dict(found.holds_for), held),),
        entries=(
            Fact("formula", value=found.formula),
            Fact("degree", value=found.degree),
            Fact("independent", value=found.independent),
        ),
    )


def _invariants(found: Invariants) -> Facts:
    names = [f"I_{k}" for k in range(1, len(found) + 1)]
    columns = (
        Column("degree", [one.degree for one in found]),
        Column("independent", ["yes" if one.independent else "no" for one in found]),
        Column("formula", list(map(str, found)), left=True),
    )
    values = [{**_invariant(one).values()} for one in found]
    return Facts(
        "Invariants",
        formulas=tuple(
            Formula(name, one.expr, one.formula) for name, one in zip(names, found, strict=True)
        ),
        entries=(
            Table("invariants", names, columns),
            Fact("message", "", found.message, found.message),
            Fact("invariants", value=values),
        ),
    )


def _system(system: System) -> Facts:
    lines = system.source.count("\n")
    return Facts(
        "System",
        f"generated functions for {system.backend}",
        given=(
            Fact("names", "state", system.names, listed(system.names)),
            Fact("lines", "lines", lines, f"{lines:,}"),
            Fact("source", value=system.source),
        ),
    )
