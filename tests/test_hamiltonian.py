"""The Hamiltonian: derivation, identity, evaluation and rejected input."""

from __future__ import annotations

import copy
import pickle
import re

import numpy as np
import pytest
import sympy
from sympy.physics.units import kilogram

import hamsym
from hamsym import Hamiltonian, InputError
from hamsym.errors import ParameterError, VariableError
from hamsym.formula.parser import parse_expression
from hamsym.formula.printer import FormulaPrinter
from hamsym.systems import Problem

OSCILLATOR = "p**2/2 + x**2/2 + x**4/4"
HENON_HEILES = "(p_x**2+p_y**2)/2 + (x**2+y**2)/2 + x**2*y - y**3/3"
MAGNETIC = "((p_x + y/2)**2 + (p_y - x/2)**2)/2"
CENTRAL = "p_r**2/2 + p_phi**2/(2*r**2) - k/r"


def test_oscillator_of_the_paper() -> None:
    H = Hamiltonian(OSCILLATOR)
    x, p = H.z
    assert (H.q, H.p, H.dof, H.dim) == ((x,), (p,), 1, 2)
    assert list(H.gradient) == [x + x**3, p]
    assert list(H.vector_field) == [p, -x - x**3]
    assert H.hessian == sympy.Matrix([[1 + 3 * x**2, 0], [0, 1]])
    assert H.poisson_matrix == sympy.Matrix([[0, 1], [-1, 0]])
    assert [equation.rhs for equation in H.equations] == list(H.vector_field)
    assert (H.kinetic, H.potential) == (p**2 / 2, x**2 / 2 + x**4 / 4)
    assert H.sigma_min == 1


def test_henon_heiles_sigma_min() -> None:
    H = Hamiltonian(HENON_HEILES)
    x, y = H.q
    assert H.sigma_min == sympy.Min(1, sympy.Abs(2 * sympy.sqrt(x**2 + y**2) - 1))


@pytest.mark.slow_cases("double_pendulum")
def test_derivatives_agree_with_sympy(problem: Problem) -> None:
    H = problem.H
    gradient = sympy.Matrix([sympy.diff(H.expr, symbol) for symbol in H.z])
    assert sympy.simplify(H.gradient - gradient) == sympy.zeros(H.dim, 1)
    assert sympy.simplify(H.hessian - sympy.hessian(H.expr, H.z)) == sympy.zeros(H.dim)
    assert list(H.vector_field) == list(H.poisson_matrix * H.gradient)


@pytest.mark.slow_cases("kepler", "spring_pendulum")
def test_sigma_min_agrees_with_singular_values(problem: Problem) -> None:
    H = problem.H
    if H.sigma_min is None:
        assert H.dim > 2
        return
    values = {sympy.Symbol(n, real=True): v for n, v in H.parameters.items()}
    generator = np.random.default_rng(0)
    for _ in range(5):
        z = generator.normal(size=H.dim)
        system = H.compile("numpy")
        matrix = system.hessian(*system.arguments(z, 0.4))
        expected = np.linalg.svd(matrix, compute_uv=False).min()
        point = dict(zip(H.z, z, strict=True)) | values | {sympy.Symbol("t", real=True): 0.4}
        assert float(H.sigma_min.subs(point)) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("formula", "separable"),
    [
        (OSCILLATOR, True),
        ("(x + p)**2 - 2*x*p", True),
        ("(sin(x)**2 + cos(x)**2)*p**2/2 + x**2", True),
        ("x*p", False),
        (MAGNETIC, False),
        ("p**2*x**2/2", False),
    ],
)
def test_separability_by_mixed_derivatives(formula: str, separable: bool) -> None:
    H = Hamiltonian(formula)
    assert H.is_separable is separable
    if separable:
        assert not H.kinetic.free_symbols & set(H.q)
        assert not H.potential.free_symbols & set(H.p)
        assert sympy.simplify(H.kinetic + H.potential - H.expr) == 0
    else:
        assert H.kinetic is None
        assert H.potential is None


def test_cyclic_coordinates_and_conservation() -> None:
    H = Hamiltonian(CENTRAL)
    assert [symbol.name for symbol in H.cyclic_coordinates] == ["phi"]
    assert H.is_conserved("p_phi")
    assert not H.is_conserved("p_r")
    assert H.is_conserved(H.expr)
    assert Hamiltonian(HENON_HEILES).cyclic_coordinates == ()


def test_integrals_in_half_angles_are_proved() -> None:
    """The swinging Atwood machine, which sympy alone does not simplify."""
    formula = "p_r**2/(2*(1 + {0})) + p_theta**2/(2*r**2) + r*({0} - cos(theta))"
    integral = (
        "p_r*p_theta*cos(theta/2)/4 - p_theta**2*sin(theta/2)/(2*r)"
        " + r**2*sin(theta/2)*cos(theta/2)**2"
    )
    assert Hamiltonian(formula.format(3)).is_conserved(integral)
    assert not Hamiltonian(formula.format(4)).is_conserved(integral)


def test_runge_lenz_vector_is_conserved() -> None:
    H = Hamiltonian("(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)")
    assert H.is_conserved("p_y*(x*p_y - y*p_x) - x/sqrt(x**2 + y**2)")


def test_explicit_time_in_conservation() -> None:
    H = Hamiltonian("p**2/2", q=["x"], p=["p"])
    assert not H.is_conserved("x")
    H = Hamiltonian("p**2/2 + x*cos(t)")
    assert H.time == sympy.Symbol("t", real=True)
    assert not H.is_conserved(H.expr)
    assert H.is_conserved("p + sin(t)")
    assert not Hamiltonian(OSCILLATOR).is_conserved("t")
    assert Hamiltonian("p**2/2", q=["x"], p=["p"]).is_conserved("x - p*t")


@pytest.mark.parametrize(
    ("formula", "force"),
    [
        ("abs(x/m)", "-sign(x/m)/m"),
        ("abs(log(x))", "-sign(log(x))/x"),
        ("x*sign(x/m - 1)", "-sign(x/m - 1)"),
        ("abs(acos(x))", "sign(acos(x))/sqrt(1 - x**2)"),
    ],
)
def test_derivatives_of_absolute_values(formula: str, force: str) -> None:
    H = Hamiltonian(f"p**2/2 + {formula}", q=["x"], p=["p"])
    assert sympy.simplify(H.vector_field[1] - parse_expression(force)) == 0


def test_split_with_singular_kinetic_energy() -> None:
    H = Hamiltonian("(sin(x)**2 + cos(x)**2)*log(p - 1) + x**2")
    x, p = H.z
    assert (H.kinetic, H.potential) == (sympy.log(p - 1), x**2)


def test_greek_spellings_are_equivalent() -> None:
    H = Hamiltonian("p_θ**2/2 + θ**2", q=["theta"], p=["p_theta"])
    assert H.names == ("θ", "p_θ")
    assert not H.is_conserved("p_theta")
    assert H.poisson_bracket("theta", "p_θ") == 1


@pytest.mark.parametrize(
    "formula", ["x + p**2/2 + 2/3/(x + y)", "p**2/2 - 5/7/(x**2 + 1)", "p**2/2 + exp(1)*x*pi/3"]
)
def test_formula_parses_back(formula: str) -> None:
    H = Hamiltonian(formula, q=["x"], p=["p"])
    assert Hamiltonian(H.formula, q=["x"], p=["p"]) == H


def test_poisson_bracket_identities() -> None:
    H = Hamiltonian(HENON_HEILES)
    f, g, h = "x*p_y", "y**2*p_x", "p_x*p_y + x"
    bracket = H.poisson_bracket
    assert sympy.expand(bracket(f, g) + bracket(g, f)) == 0
    total = bracket(f, bracket(g, h)) + bracket(g, bracket(h, f)) + bracket(h, bracket(f, g))
    assert sympy.expand(total) == 0
    with pytest.raises(VariableError, match="'w' does not occur in H"):
        bracket("w", "x")


# -- from sympy --------------------------------------------------------------------------------


@pytest.mark.parametrize("assumptions", [{}, {"real": True}, {"positive": True}])
def test_callers_symbols_are_kept(assumptions: dict[str, bool]) -> None:
    x, p, m = sympy.symbols("x p m", **assumptions)
    H = Hamiltonian(p**2 / (2 * m) + sympy.Abs(x) ** 3, parameters={m: 2.0})
    assert H.z == (x, p)
    assert H.expr.free_symbols == {x, p, m}
    assert list(H.vector_field)[0] == p / m
    assert Hamiltonian("p**2/(2*m) + abs(x)**3", parameters={"m": 2.0}) == H or assumptions == {
        "positive": True
    }


def test_absolute_value_without_assumptions() -> None:
    x, p = sympy.symbols("x p")
    H = Hamiltonian(p**2 / 2 + sympy.Abs(x))
    assert H.vector_field[1] == -sympy.sign(x)


def test_order_of_given_pairs() -> None:
    a, b, pa, pb = sympy.symbols("a b u v")
    H = Hamiltonian(pa**2 + pb**2 + a**2 + b**2, q=[b, a], p=[pb, pa])
    assert H.names == ("b", "a", "v", "u")
    assert Hamiltonian("u**2 + a**2 + c", q=["a"], p=["u"]).parameter_names == ("c",)


def test_coordinate_absent_from_formula() -> None:
    H = Hamiltonian("p**2/2", q=["s"], p=["p"])
    assert H.names == ("s", "p")
    assert H.cyclic_coordinates == (sympy.Symbol("s", real=True),)


t = sympy.Symbol("t")
BAD_EXPRESSIONS = [
    (sympy.Symbol("x; import os") + sympy.Symbol("p"), "not a usable name"),
    (sympy.Symbol("__import__('os')") * sympy.Symbol("p"), "not a usable name"),
    (sympy.Symbol("x\n") * sympy.Symbol("p"), "not a usable name"),
    (sympy.Symbol('"""') * sympy.Symbol("p"), "not a usable name"),
    (sympy.Symbol(r"\theta") * sympy.Symbol("p"), "not a usable name"),
    (sympy.Symbol("sin") * sympy.Symbol("p"), "function or constant"),
    (sympy.Function("x")(2 * t) ** 2, "not a plain symbol"),
    (sympy.IndexedBase("q")[0] * sympy.Symbol("p"), "not a plain symbol"),
    (sympy.MatrixSymbol("q", 2, 1)[0, 0] * sympy.Symbol("p"), "not a plain symbol"),
    (sympy.Symbol("p") ** 2 * kilogram, r"is a unit of sympy.*units=\{"),
    (sympy.Integral(t, (t, 0, sympy.Symbol("p"))), "not a plain symbol"),
    (sympy.Sum(sympy.Symbol('"""+evil+"""'), (sympy.Symbol('"""+evil+"""'), 1, 3)), "bound"),
    (sympy.Subs(sympy.sin(t), t, 1) * sympy.Symbol("x"), "bound"),
    (sympy.Symbol("x") * sympy.I, "real"),
    (sympy.Symbol("x") * sympy.oo, "real"),
    (sympy.Symbol("x") + sympy.Symbol("x", real=True) + sympy.Symbol("p"), "twice"),
    (sympy.Symbol("x", imaginary=True) * sympy.Symbol("p"), "not to be real"),
    (sympy.Symbol("θ") * sympy.Symbol("theta") + sympy.Symbol("p"), "another spelling"),
    (sympy.Matrix([1]), "str or a sympy expression"),
    (sympy.Symbol("x") < 1, "str or a sympy expression"),
    (None, "str or a sympy expression"),
    (b"p**2", "str or a sympy expression"),
]


@pytest.mark.parametrize(("expression", "message"), BAD_EXPRESSIONS)
def test_invalid_expressions_are_rejected(expression: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Hamiltonian(expression)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"q": ["x"]}, "q is given without p"),
        ({"q": ["x"], "p": []}, "do not pair"),
        ({"q": [], "p": []}, "do not pair"),
        ({"q": ["x", "x"], "p": ["p", "r"]}, "twice"),
        ({"q": ["x"], "p": ["x"]}, "twice"),
        ({"q": ["x y"], "p": ["p"]}, "not a usable name"),
        ({"q": [3], "p": ["p"]}, "not a name"),
        ({"q": ["x"], "p": ["p"], "parameters": {"x": 1.0}}, "variable and a parameter"),
    ],
)
def test_invalid_pairs_are_rejected(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(VariableError, match=message):
        Hamiltonian("p**2 + x**2", **arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "value", [float("nan"), float("inf"), "one", None, 1j, pytest.param(10**5000, id="huge")]
)
def test_invalid_parameter_values_are_rejected(value: object) -> None:
    with pytest.raises(ParameterError, match="'k' has the value"):
        Hamiltonian("p**2 + k*x**2", parameters={"k": value})  # type: ignore[dict-item]


@pytest.mark.parametrize("options", [{"q": 3, "p": "p"}, {"parameters": 3}, {"forces": 3}])
def test_numbers_in_place_of_names_are_rejected(options: dict) -> None:
    with pytest.raises(InputError, match="=3 (is not a mapping|cannot be used)"):
        Hamiltonian("p**2 + x**2", **options)


def test_unknown_and_missing_parameters() -> None:
    with pytest.raises(ParameterError, match="'w' does not occur in H"):
        Hamiltonian("p**2 + k*x**2", parameters={"w": 1.0})
    H = Hamiltonian("p**2/m + k*x**2", parameters={"k": 2})
    assert H.unbound_parameters == ("m",)
    with pytest.raises(ParameterError, match="m has no value; use H.with_parameters"):
        hamsym.integrate(H, [1, 0], (0, 1))
    assert dict(H.with_parameters(m=3).parameters) == {"k": 2.0, "m": 3.0}


# -- identity ----------------------------------------------------------------------------------


def test_languages_that_python_does_not_run_are_only_generated() -> None:
    with pytest.raises(InputError, match="'c' is only generated, by H.source"):
        Hamiltonian("p**2/2 + x**2/2").compile("c")


def test_equality_and_hash() -> None:
    assert Hamiltonian(OSCILLATOR) == Hamiltonian("x**4/4 + p**2/2 + x**2/2")
    assert hash(Hamiltonian(OSCILLATOR)) == hash(Hamiltonian("x**4/4 + p**2/2 + x**2/2"))
    x, p = sympy.symbols("x p")
    assert Hamiltonian(p**2 / 2 + x**2 / 2 + x**4 / 4) == Hamiltonian(OSCILLATOR)
    assert Hamiltonian("p**2 + x**2") != Hamiltonian("p**2 + x**2", q=["p"], p=["x"])
    k = Hamiltonian("p**2 + k*x**2")
    assert k != k.with_parameters(k=1)
    assert k != "p**2 + k*x**2"


def test_immutable() -> None:
    H = Hamiltonian("p**2 + k*x**2", parameters={"k": 1})
    with pytest.raises(AttributeError, match="immutable"):
        H.expr = H.expr + 1
    with pytest.raises(AttributeError, match="immutable"):
        del H.q
    with pytest.raises(TypeError):
        H.parameters["k"] = 2  # type: ignore[index]


def test_copies_and_pickles_are_equal() -> None:
    H = Hamiltonian("p**2 + k*x**2", parameters={"k": 1})
    H.compile("numpy")
    assert copy.deepcopy(H) == H
    assert pickle.loads(pickle.dumps(H)) == H


def test_string_representations(problem: Problem) -> None:
    H = problem.H
    assert parse_expression(str(H)) == H.expr
    assert H.formula in repr(H)
    assert H._repr_latex_().startswith("$")
    assert FormulaPrinter()(H.expr) == H.formula


# -- states ------------------------------------------------------------------------------------


def test_states_by_name_and_by_order() -> None:
    H = Hamiltonian("(p_θ**2 + p_x**2)/2 + θ**2 + x**2")
    assert H.names == ("θ", "x", "p_θ", "p_x")
    named = {"x": 2, "theta": 1, "p_theta": 3, "p_x": 4}
    np.testing.assert_array_equal(H.state_from(named), [1, 2, 3, 4])
    np.testing.assert_array_equal(H.state_from((1, 2, 3, 4)), [1, 2, 3, 4])
    by_symbol = dict(zip(H.z, [1, 2, 3, 4], strict=True))
    np.testing.assert_array_equal(H.state_from(by_symbol), [1, 2, 3, 4])


@pytest.mark.parametrize(
    ("z0", "message"),
    [
        ([1.0], "shape"),
        ([1.0, 2.0, 3.0], "shape"),
        ([[1.0, 2.0]], "shape"),
        ([1.0, float("nan")], "'p' is not finite"),
        ([float("inf"), 0.0], "'x' is not finite"),
        ({"x": 1}, "'p' is missing"),
        ({"x": 1, "p": 1, "y": 0}, "'y' is not a component"),
        (["a", "b"], "not a number"),
        ([1j, 0], "not a number"),
        (None, "shape"),
        ("12", "shape"),
    ],
)
def test_invalid_states_are_rejected(z0: object, message: str) -> None:
    with pytest.raises(VariableError, match=message):
        Hamiltonian(OSCILLATOR).state_from(z0)  # type: ignore[arg-type]


# -- functions of the state ----------------------------------------------------------------------


def test_observables_evaluate() -> None:
    H = Hamiltonian("p**2/(2*m) + k*x**2/2 - x*cos(t)", parameters={"m": 2.0, "k": 3.0})
    z = np.array([[1.0, 2.0], [0.5, -1.0]])
    np.testing.assert_allclose(H.observable("p/m + x*k")(z), [4.0, 1.0])
    np.testing.assert_allclose(H.observable("x*t")(z, np.array([2.0, 4.0])), [2.0, 2.0])
    x = sympy.Symbol("x", positive=True)
    np.testing.assert_allclose(H.observable(x**2)(z), [1.0, 0.25])
    assert H.observable("7")(z).tolist() == [7.0, 7.0]


def test_observables_take_parameters_of_each_state() -> None:
    H = Hamiltonian("p**2/(2*m) + lambda*x**2/2", parameters={"m": 2.0, "lambda": 1.0})
    force = H.observable("-lambda*x + t")
    assert force([3.0, 0.0], 1.0) == -2.0
    rows = np.array([[2.0, 5.0], [7.0, 5.0]])  # lambda, m
    np.testing.assert_array_equal(force([[3.0, 0.0], [1.0, 0.0]], 1.0, rows), [-5.0, -6.0])


def test_observables_with_unknown_symbols() -> None:
    H = Hamiltonian("p**2/(2*m) + x**2/2")
    with pytest.raises(VariableError, match="'v' does not occur in H"):
        H.observable("v")
    with pytest.raises(ParameterError, match="m has no value"):
        H.observable("p/m")


def test_state_at_energy() -> None:
    H = Hamiltonian("p_x**2/(2*m) + p_y**2/2 + x**4/4 + y**2/2", parameters={"m": 2.0})
    state = H.state_at_energy(3.0, {"x": 1.0, "p_y": 0.5, "y": 0.25})
    assert H.compile("numpy").energy(state) == pytest.approx(3.0, rel=4e-15)
    assert state[2] > 0
    state = H.state_at_energy(0.25, {"p_x": 0, "p_y": 0, "y": 0})
    np.testing.assert_allclose(state, [1, 0, 0, 0])
    assert H.state_at_energy(0.0, {"p_x": 0, "p_y": 0, "y": 0}).tolist() == [0, 0, 0, 0]
    driven = Hamiltonian("p**2/2 + x*t")
    assert driven.state_at_energy(3.5, {"x": 1.0}, t=1.5).tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("energy", "start", "message"),
    [
        (1.0, {"x": 0, "p_x": 0}, "missing: y, p_y"),
        (1.0, {"x": 0, "p_x": 0, "y": 0, "p_y": 0}, "missing: none"),
        (-1.0, {"x": 0, "p_x": 0, "y": 0}, "no p_y >= 0 gives the energy -1"),
        (1.0, {"x": 0, "p_x": 0, "q": 0}, "must lack exactly one|not a component"),
    ],
)
def test_unreachable_energies_are_rejected(energy: float, start: dict, message: str) -> None:
    H = Hamiltonian("(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2")
    with pytest.raises(VariableError, match=message):
        H.state_at_energy(energy, start)


def test_state_at_energy_skips_poles() -> None:
    assert Hamiltonian("p**2/2 + 1/(x - 1)").state_at_energy(0.5, {"p": 0}).tolist() == [3.0, 0.0]
    oscillator = Hamiltonian("p**2/2 + x**2/2")
    assert oscillator.state_at_energy(1e20, {"x": 0})[1] == pytest.approx(2**0.5 * 1e10)
    assert oscillator.state_at_energy(1e-40, {"x": 0})[1] == pytest.approx(2**0.5 * 1e-20)
    polar = Hamiltonian("p_r**2/2 + p_phi**2/(2*r**2) - 1/r")
    state = polar.state_at_energy(-0.3, {"phi": 0, "p_phi": 1, "p_r": 0})
    assert polar.compile("numpy").energy(state) == pytest.approx(-0.3, rel=1e-12)
    with pytest.raises(InputError, match="energy='a' cannot be used"):
        oscillator.state_at_energy("a", {"x": 0})
    with pytest.raises(InputError, match="energy=nan cannot be used"):
        oscillator.state_at_energy(float("nan"), {"x": 0})


def test_states_of_a_grid_have_its_energies() -> None:
    """Arrays of energies, components, times and parameters against the closed form."""
    H = Hamiltonian("p**2/(2*m) + k*x**2/2 + x*t", parameters={"m": 2.0, "k": 1.0})
    energy, x = np.array([[2.0], [3.0]]), np.array([0.0, 0.5, 1.0])
    k, t = np.array([1.0, 2.0, 3.0]), np.array([[0.5], [1.0]])
    states = H.state_at_energy(energy, {"x": x}, t, {"k": k})
    expected = np.sqrt(4.0 * (energy - k * x**2 / 2 - x * t))
    np.testing.assert_allclose(states[..., 1], expected, rtol=4e-15)
    np.testing.assert_array_equal(states[..., 0], np.broadcast_to(x, (2, 3)))
    unbound = Hamiltonian("p**2/2 + lambda*x**2/2")
    found = unbound.state_at_energy(1.0, {"p": 0}, parameters={"lambda": [2.0, 8.0]})
    np.testing.assert_allclose(found, [[1.0, 0.0], [0.5, 0.0]], rtol=4e-16)


@pytest.mark.parametrize(
    ("formula", "energy", "free"),
    [
        ("(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2 + x**2*y - y**3/3", 0.1, "p_x"),
        ("p**2/2 - cos(x)", 0.3, "p"),
        ("p**2/2 + 1/(x - 1)", 0.5, "x"),
    ],
)
def test_array_of_states_is_loop_of_states(formula: str, energy: float, free: str) -> None:
    H, generator = Hamiltonian(formula), np.random.default_rng(0)
    grid = {name: generator.uniform(-1, 1, 30) for name in H.names if name != free}
    together = H.state_at_energy(energy, grid, missing="nan")
    for i, state in enumerate(together):
        one = {name: values[i] for name, values in grid.items()}
        np.testing.assert_array_equal(state, H.state_at_energy(energy, one, missing="nan"))
    there = ~np.isnan(together[:, 0])
    assert there.any()
    np.testing.assert_allclose(H.compile("numpy").energy(together[there]), energy, rtol=1e-13)


def test_unreachable_members_are_counted_or_nan() -> None:
    H = Hamiltonian("(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2")
    start = {"x": 0, "y": [[0.1, 2.0], [0.5, 3.0]], "p_y": 0}
    with pytest.raises(VariableError, match=re.escape(
        "no p_x >= 0 gives the energy of 2 of 4 states, the first of them [0, 1] with energy 0.5; "
    )):  # fmt: skip
        H.state_at_energy(0.5, start)
    found = H.state_at_energy(0.5, start, missing="nan")
    assert np.isnan(found[:, 1]).all()
    np.testing.assert_array_equal(found[1, 0], H.state_at_energy(0.5, {"x": 0, "y": 0.5, "p_y": 0}))
    assert np.isnan(H.state_at_energy(-1.0, {"x": 0, "y": 0, "p_y": 0}, missing="nan")).all()


@pytest.mark.parametrize(
    ("energy", "options", "message"),
    [
        ([0.1, np.inf], {}, "energy contains a value that is not a finite number"),
        ([0.1, 0.2, 0.3], {}, r"have shapes \(2,\), \(3,\), \(\), which do not broadcast"),
        (0.1, {"missing": "none"}, "missing='none' cannot be used"),
        (0.1, {"z0": 3}, "z0=3 is not a mapping"),
        (0.1, {"parameters": {"q": 1.0}}, "'q' is not a parameter of H; it has none"),
    ],
)
def test_unusable_arrays_of_energies_are_rejected(
    energy: object, options: dict, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        Hamiltonian("p**2/2 + x**2/2").state_at_energy(
            energy, **{"z0": {"x": [0.1, 0.2]}} | options
        )


def test_discontinuous_steps_are_rejected() -> None:
    x, p, t = sympy.symbols("x p t", real=True)
    for step in (sympy.Heaviside(x - 1), sympy.DiracDelta(x), sympy.DiracDelta(t)):
        with pytest.raises(
            InputError,
            match=re.escape(f"derivative of '{step}' is not a regular function") + ".*smooth",
        ):
            Hamiltonian(p**2 / 2 + x**2 + step * x)
    H = Hamiltonian(p**2 / 2 + x * sympy.Heaviside(t - 1))  # a force that is switched on
    solution = hamsym.solve(H, [0, 0], (0, 3), breakpoints=[1])
    assert solution.success
    np.testing.assert_allclose(solution(3.0), [-2.0, -2.0], atol=1e-9)
