"""Formulas have their usual meaning; everything else raises an error with its token."""

from __future__ import annotations

import builtins
import math
import os
import subprocess

import pytest
import sympy
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hamsym import Hamiltonian, InputError
from hamsym.errors import ParseError, VariableError
from hamsym.formula.parser import (
    FUNCTIONS,
    canonical_name,
    check_name,
    parse_expression,
    parse_number,
)
from hamsym.formula.printer import FormulaPrinter

x, y, p = sympy.symbols("x y p", real=True)


@pytest.mark.parametrize(
    ("text", "meaning"),
    [
        ("x", x),
        ("  x + y ", x + y),
        ("x\n + y", x + y),
        ("2*x**3/4", x**3 / 2),
        ("-x**2", -(x**2)),
        ("2**-1*x", x / 2),
        ("0.1*x", x / 10),
        ("1e-3*x", x / 1000),
        (".5*x", x / 2),
        ("pi*x", sympy.pi * x),
        ("π*x", sympy.pi * x),
        ("sqrt(x)", sympy.sqrt(x)),
        ("ln(x)", sympy.log(x)),
        ("arctan(x)", sympy.atan(x)),
        ("atan2(y, x)", sympy.atan2(y, x)),
        ("abs(x)", sympy.Abs(x)),
        ("min(x, y, 1)", sympy.Min(x, y, 1)),
        ("max(x, y)", sympy.Max(x, y)),
        ("x**y", x**y),
        ("x - x", sympy.Integer(0)),
        ("x/y/2", x / y / 2),
        ("x - y - 1", x - y - 1),
    ],
)
def test_formula_has_its_usual_meaning(text: str, meaning: sympy.Expr) -> None:
    assert parse_expression(text) == meaning


@pytest.mark.parametrize(
    ("text", "meaning"),
    [
        ("sum(i, 1, 3, p[i]**2/2)", "p1**2/2 + p2**2/2 + p3**2/2"),
        ("sum(i, 0, 2, i*x[i + 1])", "x2 + 2*x3"),
        ("sum(i, 1, 2, sum(j, i + 1, 3, q[i]*q[j]))", "q1*q2 + q1*q3 + q2*q3"),
        ("sum(i, 1, 3, x[i])*sum(i, 1, 2, y)", "2*y*(x1 + x2 + x3)"),
        ("sum(i, 2, 1, x[i])", "0"),
        ("sum(i, 1, 2, p_x[i]*λ[2*i])", "p_x1*λ2 + p_x2*λ4"),
        ("sum(i, 1, sum(j, 1, 2, j), x[i]**i)", "x1 + x2**2 + x3**3"),
        ("sum*x", "x*sum"),
    ],
)
def test_sums_over_integers_are_expanded(text: str, meaning: str) -> None:
    assert parse_expression(text) == parse_expression(meaning)


def test_chain_as_a_sum_is_the_chain() -> None:
    H = Hamiltonian("sum(i, 1, 8, p[i]**2/2) + sum(i, 1, 7, (x[i+1] - x[i])**2/2)")
    assert H.names == tuple(f"{kind}{i}" for kind in "xp" for i in range(1, 9))
    assert Hamiltonian(H.formula) == H


@pytest.mark.parametrize(
    ("text", "token", "problem"),
    [
        ("sum(i, 1, N, x[i])", "N", "not an integer"),
        ("sum(i, 1, 2.5, x)", "2.5", "not an integer"),
        ("sum(i, 1, 3, x[i/2])", "i/2", "not an integer"),
        ("sum(i, 1, 2, x[x[1]])", "x[1]", "not an integer"),
        ("sum(i, 1, 10**6, x)", "10**6", "too large an index"),
        ("sum(i, 1, 9999, x*i)", "sum", "more than 10000 parts"),
        ("sum(i,1,99,sum(j,1,99,sum(k,1,99,x[i]*x[k])))", "sum(k", "more than 10000 parts"),
        ("sum(i, 1, 3, i*x) + i", "i", "index of a sum and a variable"),
        ("sum(i, 1, 3, sum(i, 1, 2, x[i]))", "i", "index of the sum around it"),
        ("sum(1, 1, 3, x)", "1", "not an index"),
        ("sum(sin, 1, 3, x)", "sin", "cannot be an index"),
        ("sum(i, 1, x)", "sum", "3 arguments"),
        ("sum(i, 1, 3, i=2)", "sum", "3 arguments"),
        ("x[1]", "x[1]", "subscript"),
        ("sum(i, 1, 3, x[-i])", "x[-i]", "index -1"),
        ("sum(i, 1, 3, x[i, i])", "x[i, i]", "one index"),
        ("sum(i, 1, 3, x[1:2])", "x[1:2]", "one index"),
        ("sum(i, 1, 3, sin[i])", "sin[i]", "usable name"),
        ("sum(i, 1, 3, i[i])", "i[i]", "element of an index"),
        ("sum(i, 1, 3, 1/(i - 2))", "i - 2", "zero"),
        ("sum(i, 1, 3, x.real)", "x.real", "attribute"),
    ],
)
def test_unusable_sums_are_refused(text: str, token: str, problem: str) -> None:
    with pytest.raises(ParseError, match=problem) as caught:
        parse_expression(text)
    assert caught.value.token.startswith(token)


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
def test_every_function_evaluates_as_in_python(name: str) -> None:
    arguments = {"atan2": "x, y", "min": "x, y", "max": "x, y"}.get(name, "x")
    expr = parse_expression(f"{name}({arguments})")
    at = 1.7 if name in ("acosh", "arccosh", "acoth", "arccoth", "asec", "arcsec") else 0.4
    at = 1.7 if name in ("acsc", "arccsc") else at
    value = float(expr.evalf(subs={x: at, y: 0.9}))
    simple = name.replace("arc", "a")
    python = {"ln": math.log, "min": min, "max": max, "abs": abs, "sign": lambda v: 1.0}
    python["Heaviside"] = lambda v: 1.0
    inverse = {"asec": "acos", "acsc": "asin", "acot": "atan", "asech": "acosh"}
    inverse |= {"acsch": "asinh", "acoth": "atanh"}
    reciprocal = {"sec": "cos", "csc": "sin", "cot": "tan", "sech": "cosh", "csch": "sinh"}
    reciprocal["coth"] = "tanh"
    if simple in inverse:
        expected = getattr(math, inverse[simple])(1 / at)
    elif simple in reciprocal:
        expected = 1 / getattr(math, reciprocal[simple])(at)
    else:
        function = python.get(name) or getattr(math, simple)
        expected = function(at, 0.9) if "," in arguments else function(at)
    assert value == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("name", ["beta", "gamma", "S", "N", "Q", "E", "I", "lambda", "θ_1", "p_φ"])
def test_any_other_name_is_a_symbol(name: str) -> None:
    assert parse_expression(f"2*{name}") == 2 * sympy.Symbol(name, real=True)


@pytest.mark.slow
def test_long_sums_are_one_level_deep() -> None:
    terms = [f"x{i}**2" for i in range(2_000)]
    assert len(parse_expression(" + ".join(terms)).args) == 2_000


def test_formula_too_costly_for_sympy_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hamsym.formula.parser.MAX_EFFORT", 200)
    with pytest.raises(ParseError, match=r"'sqrt\(x\*\*2 .*' at column 1 .*too long.*; split it"):
        parse_expression("sqrt(x**2 + y**2) + exp(-x*y)")


# Text, the token that the message names, and a word of the remedy.
REFUSED = [
    ("", "", "write a formula"),
    ("   ", "", "write a formula"),
    # code
    ("__import__('os').system('touch pwned')", "__import__('os').system", "plain names"),
    ("__import__('os')", "__import__", "known"),
    ("exec('1')", "exec", "known"),
    ("eval(x)", "eval", "known"),
    ("open(x)", "open", "known"),
    ("print(x)", "print", "known"),
    ("lambda: 0", ":", "names"),
    ("lambda x: x", "x", "*"),
    ("import os", "import", "names"),
    ("x; import os", ";", "names"),
    ("(x for x in y)", "(x for x in y)", "names"),
    ("[x for x in y]", "[x for x in y]", "names"),
    ("await x", "await x", "names"),
    ("yield x", "yield", "names"),
    ("(x := 2)", "x := 2", "right-hand side"),
    ("f'{x}'", "f'{x}'", "quotation"),
    ("'x'", "'x'", "quotation"),
    ("b'x'", "b'x'", "quotation"),
    ("x if y else p", "x if y else p", "min, max"),
    # attributes, subscripts, dunder names
    ("x.real", "x.real", "plain names"),
    ("x.__class__", "x.__class__", "plain names"),
    ("(1).__class__.__bases__", "(1).__class__.__bases__", "plain names"),
    ("__class__", "__class__", "letter"),
    ("x__y", "x__y", "letter"),
    ("_x", "_x", "letter"),
    ("x[0]", "x[0]", "q1"),
    ("x{1}", "{", "names"),
    # operators and relations
    ("x^2", "^", "**"),
    ("x//2", "//", "/"),
    ("x % 2", "%", "only"),
    ("x @ y", "@", "*"),
    ("x << 2", "<<", "only"),
    ("x >> 2", ">>", "only"),
    ("x & y", "&", "only"),
    ("|x|", "|", "names"),
    ("x | y", "|", "abs"),
    ("~x", "~", "-"),
    ("not x", "not", "-"),
    ("x and y", "x and y", "arithmetic"),
    ("x < y", "x < y", "without relations"),
    ("x == y", "x == y", "without relations"),
    ("H = p**2/2", "=", "right-hand side"),
    ("x is y", "x is y", "without relations"),
    ("x in y", "x in y", "without relations"),
    # implicit products and slips of the pen
    ("2x", "2x", "*"),
    ("x y", "y", "*"),
    ("2(x)", "2", "*"),
    ("(x+1)(x-1)", "x+1", "*"),
    ("x(1+y)", "x", "*"),
    ("x +", "+", "complete"),
    ("* x", "*", "names"),
    ("(x", "(", "missing )"),
    ("[x", "[", "missing ]"),
    ("x in", "in", "complete"),
    ("x)", ")", "remove"),
    ("(x]", "]", "remove"),
    ("1,5*x", "1,5*x", "decimals"),
    ("sin", "sin", "sin(...)"),
    ("sin x", "x", "*"),
    ("sin()", "sin", "give sin 1"),
    ("sin(x, y)", "sin", "give sin 1"),
    ("atan2(x)", "atan2", "give atan2 2"),
    ("max(x)", "max", "2 to 16"),
    ("sin(x=1)", "x", "sin(x)"),
    ("max(*x)", "max", "2 to 16"),
    ("max(*x, y)", "*x", "**"),
    ("foo(x)", "foo", "known"),
    ("x # remark", "#", "comments"),
    ("x\\", "\\", "names"),
    ("x!", "!", "names"),
    ("$x$", "$", "names"),
    # constants of Python
    ("1j*x", "1j", "real"),
    ("True*x", "True", "numbers and pi"),
    ("None", "None", "numbers and pi"),
    ("...", "...", "numbers and pi"),
    # look-alikes and characters that are no formula
    ("х**2", "х", "Latin or Greek"),  # cyrillic ha
    ("ｘ**2", "ｘ", "Latin or Greek"),  # full width
    ("Α**2", "Α", "Latin or Greek"),  # Greek capital alpha
    ("ο", "ο", "Latin or Greek"),  # omicron
    ("x²", "²", "**2"),
    ("x − y", "−", "-"),
    ("2·x", "·", "*"),
    ("√x", "√", "sqrt"),
    ("x\x00", "U+0000", "Latin or Greek"),
    ("x\u202ey", "U+202E", "Latin or Greek"),  # right-to-left override
    ("x\u200b", "U+200B", "Latin or Greek"),  # zero-width space
    ("θ + theta", "theta", "one of the two"),
    ("λ + lambda", "lambda", "one of the two"),
    # numbers that are not there
    ("1/0", "0", "divisor"),
    ("x/(1 - 1)", "1 - 1", "divisor"),
    ("x/(y - y)", "y - y", "divisor"),
    ("0**(-1)*x", "0", "divisor"),
    ("x/(sin(1)**2 + cos(1)**2 - 1)", "sin(1)**2 + cos(1)**2 - 1", "divisor"),
    ("sqrt(-1)*x", "sqrt(-1)", "real"),
    ("log(0)*x", "log(0)", "real"),
    ("acos(2)*x", "acos(2)", "real"),
    ("(-1)**x", "-1", "not real"),
    ("0**x", "0", "not real"),
    ("sqrt(-x**2)", "sqrt(-x**2)", "real"),
    # giants
    ("1e400*x", "1e400", "1e308"),
    ("9" * 400, "9" * 37 + "...", "1e308"),
    ("9" * 5_000, "9" * 37 + "...", "1e308"),
    ("9**9**9", "9**9", "1000"),
    ("9**9**9**9**9", "9**9", "1000"),
    ("x**1001", "1001", "1000"),
    ("(x**100)**100", "(x**100)**100", "1000"),
    ("10**300*10**300", "10**300*10**300", "1e308"),
    ("1.0000001**1000*x", "1.0000001**1000", "1e308"),
    ("exp(exp(exp(9)))", "exp(exp(9))", "real"),
    ("exp(1e300)", "exp(1e300)", "real"),
    ("1e-400*x", "1e-400", "1e-308"),
    ("(1e300*x)**2", "(1e300*x)**2", "1e308"),
    ("(9e4*x)**1000", "(9e4*x)**1000", "1e308"),
    ("(4*x)**(10**12 + 0.5)", "10**12 + 0.5", "1000"),
    ("exp(10**10*log(2))", "exp(10**10*log(2))", "1000"),
    ("exp(x + 10**9*log(2))", "exp(x + 10**9*log(2))", "1000"),
    ("2**(10**10*log(3)/log(2))", "2**(10**10*log(3)/log(2))", "1000"),
    ("(((2*x)**1000)**1000)**1000", "((2*x)**1000)**1000", "1e308"),
    # formulas on which sympy runs too long, or fails
    ("tanh(sqrt(" * 6 + "x" + "))" * 6, "tanh", "split"),
    ("tanh(cosh((x + log(y) + log(z))**20))", "tanh(cosh((x...", "split"),
    ("max(erf((exp(1) - 2)**999), 3)", "max(erf((exp...", "split"),
    ("+".join(f"max(a{i}, b{i})" for i in range(1_600)), "max(a0, b0)+...", "split"),
    ("sec(pi + cosh(x))", "sec(pi + cosh(x))", "simplify"),
    ("max(sqrt(-1 - x**2), 1)", "max(sqrt(-1 - x**2), 1)", "simplify"),
    ("asin(sin(1e200))", "asin(sin(1e200))", "simplify"),
    ("(" * 150 + "x" + "(" * 150, "(", "split"),
    ("(" * 1_000, "(", "split"),
    ("-" * 100 + "x", "-" * 37 + "...", "split"),
    ("-" * 40_000 + "x", "-" * 12 + "...", "split"),
    ("sin(" * 80 + "x" + ")" * 80, None, "split"),
    ("**".join(["x"] * 3_000), "x**x**x**x**...", "split"),
    ("x+" * 20_000 + "x", "x+x+x+x+x+x+...", "sympy"),
    ("x" * 1_000_000, "x" * 12 + "...", "sympy"),
    ("x" * 60, "x" * 37 + "...", "letter"),
]


@pytest.mark.slow_cases("tanh(cosh((x + log(y", "max(a0, b0)+max(a1, ", "max(erf((exp(1) - 2)")
@pytest.mark.parametrize(("text", "token", "remedy"), REFUSED, ids=[t[0][:20] for t in REFUSED])
def test_refusal_names_token_column_and_remedy(text: str, token: str | None, remedy: str) -> None:
    with pytest.raises(ParseError) as caught:
        parse_expression(text)
    message = str(caught.value)
    if token is not None:
        assert message.startswith(f"'{token}' ")
    assert f"at column {caught.value.column}" in message
    assert remedy in message.rsplit("; ", 1)[1] or remedy in caught.value.remedy
    assert "\n" not in message


def test_there_are_enough_refusals() -> None:
    assert len({text for text, _, _ in REFUSED}) >= 60


@pytest.mark.parametrize(
    ("text", "column"),
    [("x + y^2", 6), ("p^2/2 + x^2/2", 2), ("  x^2", 4), ("θ + 2θ", 6), ("x + foo(y)", 5)],
)
def test_column_counts_characters(text: str, column: int) -> None:
    with pytest.raises(ParseError) as caught:
        parse_expression(text)
    assert caught.value.column == column


def test_other_types_are_rejected() -> None:
    with pytest.raises(InputError, match="a formula is a str, not int"):
        parse_expression(3)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("text", "value"), [("4*pi", 4 * math.pi), ("-1e-3", -1e-3), ("2**10", 1024)]
)
def test_numbers_are_evaluated(text: str, value: float) -> None:
    assert parse_number(text) == value


def test_numbers_with_variables_are_rejected() -> None:
    with pytest.raises(ParseError, match="'x' at column 3 is a variable"):
        parse_number("2*x")
    with pytest.raises(ParseError, match="'x' at column 5 is a variable"):
        parse_number("exp(x)")


@pytest.mark.parametrize(
    "name", ["x; import os", "x.y", "x-1", "", "1x", "_", "x'", "a b", "__x", "sin"]
)
def test_unusable_names_are_rejected(name: str) -> None:
    with pytest.raises(VariableError):
        check_name(name)


def test_greek_names_are_spelled_out() -> None:
    assert canonical_name("θ") == "theta"
    assert canonical_name("Δx_λ") == "Deltax_lambda"


_PIECES = st.sampled_from(
    "x y p p_x q1 p1 m k t theta θ π pi 1 2 0.5 1e3 1e300 9 + - * / ** ^ ( ) , . sin cos exp log "
    "sqrt abs atan2 max min tan asin acosh sign erf lambda __import__ os ' \" [ ] { } : ; = == if "
    "else for in and not @ % ~ ! \\ \n # j".split()
)
_TEXTS = st.one_of(
    st.text(max_size=60),
    st.lists(_PIECES, max_size=25).map(" ".join),
    st.lists(_PIECES, max_size=25).map("".join),
)
_FORMULAS = st.recursive(
    st.sampled_from(["x", "p", "y", "2", "0.3", "pi", "7", "1e5"]),
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from("+ - * / **".split()), inner).map(
            lambda parts: f"({parts[0]} {parts[1]} {parts[2]})"
        ),
        st.tuples(
            st.sampled_from([n for n in sorted(FUNCTIONS) if FUNCTIONS[n].most == 1]), inner
        ).map(lambda parts: f"{parts[0]}({parts[1]})"),
        st.tuples(st.sampled_from(["atan2", "min", "max"]), inner, inner).map(
            lambda parts: f"{parts[0]}({parts[1]}, {parts[2]})"
        ),
    ),
    max_leaves=12,
)


@pytest.fixture(scope="module")
def traps() -> object:
    """Replace the functions that an executed text would call."""
    patch = pytest.MonkeyPatch()

    def sprung(*_: object, **__: object) -> None:
        raise AssertionError("a formula was executed")

    patch.setattr(builtins, "eval", sprung)
    patch.setattr(os, "system", sprung)
    patch.setattr(subprocess, "Popen", sprung)
    yield
    patch.undo()


@pytest.mark.slow
@settings(
    max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(text=_TEXTS)
def test_any_text_is_a_hamiltonian_or_one_clear_error(traps: object, text: str) -> None:
    _hamiltonian_or_error(text)


@pytest.mark.slow
@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(text=_FORMULAS)
def test_any_formula_is_a_hamiltonian_or_one_clear_error(traps: object, text: str) -> None:
    _hamiltonian_or_error(text)


def _hamiltonian_or_error(text: str) -> None:
    try:
        H = Hamiltonian(text)
        assert parse_expression(FormulaPrinter()(H.expr)) is not None
    except InputError as error:
        assert str(error)
        assert "\n" not in str(error)
