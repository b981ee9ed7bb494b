"""Functions of balls: their text, their values to forty digits and what they refuse."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import Any

import pytest
import sympy
from flint import arb, fmpq

from hamsym import Hamiltonian, InputError, systems
from hamsym.codegen import straight_line
from hamsym.codegen.functions import compile_straight_line
from hamsym.codegen.generate import generate
from hamsym.codegen.names import Names
from hamsym.codegen.system import load
from hamsym.errors import CodeGenerationError
from hamsym.proof.arithmetic import functions
from hamsym.proof.arithmetic.balls import working
from hamsym.proof.arithmetic.functions import BALLS, SingularityError
from hamsym.proof.arithmetic.generated import evaluated

_BITS, _DIGITS = 170, 40
_POWERS = {"reciprocal", "root", "reciprocal_root", "general_power"}

OSCILLATOR = '''"""Hamilton's equations in an arithmetic a.

H = p**2/2 + x**2/2 + x**4/4

The arithmetic has number(p, q), the exact p/q, and number(p); pi and e; reciprocal, root,
reciprocal_root and general_power; and the functions of H by name. Its numbers, and the other
arguments, have +, - and * with each other and with integers. A comment shows the value of a
function that is not smooth everywhere.
"""


def energy(a, x, p, t):
    """H."""
    u0 = a.number(1, 2)
    u1 = x*x
    return u0*(p*p) + u0*u1 + a.number(1, 4)*(u1*u1)


def vector_field(a, x, p, t):
    """Right-hand side J grad H of Hamilton's equations."""
    return [p, -x - x*x*x]


def hessian(a, x, p, t):
    """Second derivatives of H by (i, j), i <= j, that do not vanish."""
    return {(0, 0): 1 + 3*(x*x), (1, 1): a.number(1)}
'''


def test_text_of_the_oscillator() -> None:
    assert Hamiltonian("p**2/2 + x**2/2 + x**4/4").source("balls") == OSCILLATOR


def test_kepler_shares_its_root_and_names_it() -> None:
    H = Hamiltonian("(p_x**2 + p_y**2)/2 - k/sqrt(x**2 + y**2)", parameters={"k": 0.1})
    assert H.source("balls", "vector_field") == (
        "def vector_field(a, x, y, p_x, p_y, t, *, k):\n"
        '    """Right-hand side J grad H of Hamilton\'s equations."""\n'
        "    # 1/sqrt(x**2 + y**2)\n"
        "    u0 = a.reciprocal_root(x*x + y*y)\n"
        "    u1 = k*(u0*u0*u0)\n"
        "    return [p_x, p_y, -x*u1, -y*u1]"
    )


# -- values ----------------------------------------------------------------------------------------

# A function and a point inside its domain.
VALUES = {
    **{f"{name}(x)": "7/10" for name in "exp sin cos atan erf sinh cosh tanh asinh log".split()},
    **{f"{name}(x)": "2/5" for name in "tan asin acos atanh sqrt".split()},
    **{f"{name}(x)": "7/10" for name in "sec csc cot sech csch coth acot asech acsch".split()},
    **{f"{name}(x)": "17/10" for name in "acosh asec acsc acoth".split()},
    "atan2(x, p)": "-7/10",
    "x**k": "6/5",
    "x**3.5*k**x": "6/5",
    "x**(-3/2)": "6/5",
    "1/x**5": "-6/5",
    "x**(1/3)": "6/5",
    "x**n": "6/5",
    "pi*x*exp(1) - x**6/3 - 1": "6/5",
    "sqrt(2)*x*sin(1)": "6/5",
    "log(cosh(k*x*p - t)) + 0.1*x": "6/5",
}
_PARAMETERS = {"k": 1.3, "n": -2.0}
_TIME = sympy.Rational(2, 7)


def _exact(value: float) -> sympy.Rational:
    return sympy.Rational(*float(value).as_integer_ratio())


def _ball(value: sympy.Rational) -> arb:
    return arb(fmpq(int(value.p), int(value.q)))


@pytest.fixture(params=VALUES)
def case(request: pytest.FixtureRequest) -> tuple[Hamiltonian, list[sympy.Rational]]:
    formula = request.param
    used = {node.id for node in ast.walk(ast.parse(formula)) if isinstance(node, ast.Name)}
    parameters = {name: value for name, value in _PARAMETERS.items() if name in used}
    H = Hamiltonian(f"p**2/2 + {formula}", q=["x"], p=["p"], parameters=parameters)
    return H, [sympy.Rational(VALUES[formula]), sympy.Rational(3, 11)]


def _derivatives(H: Hamiltonian, z: list[sympy.Rational]) -> Iterator[tuple[str, Any, sympy.Expr]]:
    """The derivatives of H by sympy: function, index and value to more than forty digits."""
    real = {symbol: sympy.Symbol(symbol.name, real=True) for symbol in H.expr.free_symbols}
    expr, (x, p) = H.expr.xreplace(real), sympy.symbols("x p", real=True)
    expr = expr.xreplace({number: _exact(number) for number in expr.atoms(sympy.Float)})
    at = {x: z[0], p: z[1], sympy.Symbol("t", real=True): _TIME}
    at |= {sympy.Symbol(name, real=True): _exact(v) for name, v in H.parameters.items()}

    def value(expression: sympy.Expr) -> sympy.Expr:
        return expression.subs(at).evalf(_DIGITS + 10)

    slopes = [expr.diff(symbol) for symbol in (x, p)]
    yield "energy", None, value(expr)
    yield "vector_field", 0, value(slopes[1])
    yield "vector_field", 1, value(-slopes[0])
    for index in ((0, 0), (0, 1), (1, 1)):
        yield "hessian", index, value(slopes[index[0]].diff((x, p)[index[1]]))
    for index3 in ((0, 0, 0), (0, 0, 1), (0, 1, 1), (1, 1, 1)):
        first, second, third = ((x, p)[i] for i in index3)
        yield "third_derivatives", index3, value(expr.diff(first, second, third))


def test_values_to_forty_digits(case: tuple[Hamiltonian, list[sympy.Rational]]) -> None:
    H, z = case
    system = load(generate(H.real_equations, "balls"))
    inserted = straight_line.inserted_parameters(H.real_equations)
    with working(_BITS):
        of = {name: _ball(_exact(v)) for name, v in H.parameters.items() if name not in inserted}
        balls = [*map(_ball, z), _ball(_TIME)]
        found = {
            name: system.function(name)(BALLS, *balls, **of)
            for name in ("energy", "vector_field", "hessian", "third_derivatives")
        }
        for name, index, value in _derivatives(H, z):
            values = found[name]
            if index is None:
                mine = values
            elif isinstance(index, int):
                mine = values[index]
            else:
                mine = values.get(index, arb(0))
            assert isinstance(mine, arb)
            slack = arb(10) ** -_DIGITS * (1 + abs(mine))
            assert abs(mine - arb(str(value))) < slack, (name, index)


def test_arithmetic_of_balls_has_every_function() -> None:
    assert {*straight_line.FUNCTIONS.values(), *_POWERS} == functions.FUNCTIONS.keys()
    assert all(callable(getattr(BALLS, name)) for name in functions.FUNCTIONS)


# -- the text --------------------------------------------------------------------------------------

SYSTEMS = ["kepler", "henon_heiles", "driven_oscillator", "double_pendulum", "three_bodies"]


@pytest.mark.slow_cases("three_bodies")
@pytest.mark.parametrize("name", SYSTEMS)
def test_text_has_only_arithmetic_without_branches(name: str) -> None:
    H = systems.CATALOGUE[name]().H
    text = H.source("balls") + "\n" + H.source("balls", "third_derivatives")
    allowed = (ast.Constant, ast.Name, ast.BinOp, ast.UnaryOp, ast.Call, ast.Attribute)
    containers = (ast.List, ast.Dict, ast.Tuple)
    for function in ast.parse(text).body[1:]:
        assert isinstance(function, ast.FunctionDef)
        first = function.args.args[0].arg
        for statement in function.body[1:]:
            assert isinstance(statement, ast.Assign | ast.Return)
            for node in ast.walk(statement):
                if isinstance(node, ast.expr):
                    assert isinstance(node, (*allowed, *containers))
                if isinstance(node, ast.Attribute):
                    assert isinstance(node.value, ast.Name)
                    assert node.value.id == first
                if isinstance(node, ast.BinOp):
                    assert isinstance(node.op, ast.Add | ast.Sub | ast.Mult)
                if isinstance(node, ast.Constant) and not isinstance(node.value, str):
                    assert isinstance(node.value, int)
    assert max(map(len, text.splitlines())) <= 100


def test_text_is_the_same_for_all_parameters() -> None:
    texts = {
        Hamiltonian("p**2/2 + k*cos(x) + x**n", parameters={"k": k, "n": n}).source("balls")
        for k, n in ((1.0, 3.0), (0.1, 3.0), (0.1, 2.0))
    }
    assert len(texts) == 2  # n is in an exponent
    assert all("*, k):" in text and "n = " in text for text in texts)


def test_exponents_without_values_are_general_powers() -> None:
    text = Hamiltonian("p**2/2 + x**n").source("balls", "energy")
    assert "(a, x, p, t, *, n)" in text
    assert "a.general_power(x, n)" in text


@pytest.mark.parametrize("n", [2001.0, -2001.0, 2000.5])
def test_large_exponents_are_powers_of_their_kind(n: float) -> None:
    H = Hamiltonian("p**2/2 + n*x**n", parameters={"n": n})
    with working(_BITS):
        found = load(generate(H.real_equations, "balls")).function("energy")
        value = found(BALLS, BALLS.number(3, 2), arb(0), arb(0))
        assert (value / (arb(n) * arb(1.5) ** arb(n)) - 1).contains(0)
    assert "a.general_power(" not in H.source("balls")


@pytest.mark.parametrize(
    ("formula", "parameters"),
    [
        ("p_a**2/2 + a**2*u0/2", {"u0": 2.0}),
        ("p_lambda**2/2 + lambda**2*z/2", {"z": 2.0}),
        ("p_x**2/2 + x**2*energy/2", {"energy": 2.0}),
        ("p_θ**2/2 + θ**2*ω/2", {"ω": 2.0}),
    ],
)
def test_names_of_the_user_do_not_collide(formula: str, parameters: dict[str, float]) -> None:
    H = Hamiltonian(formula, parameters=parameters)
    system = load(generate(H.real_equations, "balls"))
    (name,) = (name for name, _ in Names(H.real_equations).parameters)
    rate = system.function("vector_field")(BALLS, arb(3), arb(5), arb(0), **{name: arb(2)})
    assert rate == [arb(5), arb(-6)]


def test_names_that_collide_twice_differ() -> None:
    # z is reserved, and z_ is the coordinate
    H = Hamiltonian("p**2/2 + z*z_**2", q=["z_"], p=["p"], parameters={"z": 2.0})
    names = Names(H.real_equations)
    assert len({*names.state, *(name for name, _ in names.parameters)}) == 3


def test_constant_results_are_numbers_of_the_arithmetic() -> None:
    text = Hamiltonian("p + 2*x").source("balls", "vector_field")
    assert "return [a.number(1), a.number(-2)]" in text


def test_long_products_and_sums_have_short_lines() -> None:
    n = 12
    product = "*".join(f"(q{i} + p{i})" for i in range(n))
    total = " + ".join(f"q{i}**3*p{i}/7" for i in range(n))
    text = Hamiltonian(f"{product} + {total}").source("balls")
    assert max(map(len, text.splitlines())) <= 100
    compile(text, "text", "exec")


# -- what is refused or fails ----------------------------------------------------------------------


@pytest.mark.parametrize("function", ["abs", "sign", "min", "max"])
def test_functions_with_kinks_are_refused(function: str) -> None:
    argument = "(x, p)" if function in ("min", "max") else "(x)"
    with pytest.raises(CodeGenerationError, match=f"'{function}' cannot be generated for balls"):
        Hamiltonian(f"p**2/2 + {function}{argument}").source("balls")


def test_functions_without_arithmetic_are_refused() -> None:
    x, p = sympy.symbols("x p", real=True)
    with pytest.raises(CodeGenerationError, match="gamma"):
        Hamiltonian(p**2 / 2 + sympy.gamma(x), q=[x], p=[p]).source("balls")


def test_constants_without_arithmetic_are_refused() -> None:
    x, p = sympy.symbols("x p", real=True)
    with pytest.raises(CodeGenerationError, match="GoldenRatio"):
        Hamiltonian(p**2 / 2 + sympy.GoldenRatio * x, q=[x], p=[p]).source("balls")


def test_symbols_without_value_are_refused() -> None:
    x, y = sympy.symbols("x y", real=True)
    with pytest.raises(CodeGenerationError, match="'y' has no value"):
        compile_straight_line([x * y], [x])


def test_balls_are_shown_but_not_compiled() -> None:
    H = Hamiltonian("p**2/2 + x**2/2")
    with pytest.raises(InputError, match="only generated, by H.source"):
        H.compile("balls")
    for part in ("loss", "head"):
        with pytest.raises(InputError, match=f"'{part}' is not a function of the module.*energy"):
            H.source("balls", part)


@pytest.mark.parametrize(
    ("formula", "name"),
    [
        ("sqrt(x**2 + p**2 - 4)*x + 1/sqrt(x**2 + p**2 - 4)", "sqrt(p**2 + x**2 - 4)"),
        ("p/(x - 1)", "1/(x - 1)"),
        ("sin(log(x - 1)) + p", "log(x - 1)"),
        ("(x - 1)**pi + p", "(x - 1)**pi"),
    ],
)
def test_failures_name_the_subexpression(formula: str, name: str) -> None:
    system = load(generate(Hamiltonian(formula, q=["x"], p=["p"]).real_equations, "balls"))
    with pytest.raises(SingularityError) as caught:
        evaluated(system.function("energy"), BALLS, arb(1), arb(1), arb(0))
    assert name in str(caught.value)


def test_failure_of_a_long_subexpression_is_shortened() -> None:
    inner = " + ".join(f"x**{k}" for k in range(2, 40))
    H = Hamiltonian(f"log({inner})*p + p**2*sqrt({inner})", q=["x"], p=["p"])
    energy = load(generate(H.real_equations, "balls")).function("energy")
    with pytest.raises(SingularityError) as caught:
        evaluated(energy, BALLS, arb(0), arb(0), arb(0))
    assert str(caught.value) in ("log(...)", "sqrt(...)")
