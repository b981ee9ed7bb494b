"""Generated C, compiled; Julia, read by a small interpreter; and JavaScript, run by node."""

from __future__ import annotations

import ctypes
import json
import math
import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy

from hamsym import Hamiltonian, InputError
from hamsym.codegen.backends import BACKENDS
from hamsym.errors import CodeGenerationError
from hamsym.systems import CATALOGUE, Problem
from tests.codegen.test_generated_code import (
    AWKWARD,
    FORMULAS,
    REFUSED,
    SYSTEMS,
    TIME,
    states,
    sum_of_formulas,
    sympy_values,
)

FUNCTIONS = ("energy", "gradient", "vector_field", "jacobian", "hessian")
# (name, state, values of the parameters) -> the function at TIME.
Caller = Callable[[str, np.ndarray, Mapping[str, float]], np.ndarray]
x, p = sympy.symbols("x p", real=True)


def shape_of(name: str, dim: int) -> tuple[int, ...]:
    matrix = (dim, dim)
    shapes = {"energy": (), "power": (), "jacobian": matrix, "hessian": matrix}
    return shapes.get(name, (dim,))


# -- C ---------------------------------------------------------------------------------------------

_WARNINGS = ("-Wall", "-Wextra", "-Werror", "-pedantic")


@pytest.fixture(scope="module")
def cc() -> str:
    found = shutil.which("cc")
    if found is None:
        pytest.skip("needs a C compiler, cc")
    return found


def library(cc: str, text: str, folder: Path, *options: str) -> ctypes.CDLL:
    """Compile with warnings as errors."""
    # A library of the same name would be taken from memory.
    own = Path(tempfile.mkdtemp(dir=folder))
    (own / "system.c").write_text(text, encoding="utf-8")
    command = [cc, *(options or ("-std=c99",)), *_WARNINGS, "-O1", "-shared", "-fPIC"]
    command += [str(own / "system.c"), "-o", str(own / "system.so"), "-lm"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    return ctypes.CDLL(str(own / "system.so"))


def pointer(array: np.ndarray) -> Any:
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def compiled(cc: str, H: Hamiltonian, folder: Path, *options: str) -> Caller:
    loaded = library(cc, H.source("c"), folder, *options)

    def call(name: str, z: np.ndarray, parameters: Mapping[str, float]) -> np.ndarray:
        function, out = loaded[name], np.full(shape_of(name, H.dim), np.nan)
        function.restype = None if out.shape else ctypes.c_double
        z, given = np.array(z), np.array([float(parameters[n]) for n in H.parameter_names])
        arguments = [pointer(z)]
        arguments += [] if H.time is None else [ctypes.c_double(TIME)]
        arguments += [pointer(given)] if H.parameter_names else []
        if not out.shape:
            return np.array(function(*arguments))
        function(*arguments, pointer(out))
        return out

    return call


# -- Julia -----------------------------------------------------------------------------------------

_FUNCTIONS: dict[str, Callable[..., float]] = {
    **{name: getattr(math, name) for name in "sin cos tan asin acos sinh cosh tanh".split()},
    **{name: getattr(math, name) for name in "asinh acosh atanh exp log sqrt".split()},
    "atan": lambda y, x=1.0: math.atan2(y, x),
    "sign": lambda u: (u > 0) - (u < 0),
    "abs": abs,
    "min": min,
    "max": max,
}
_KEYWORDS = set(
    "baremodule begin break catch const continue do else elseif end export false finally for "
    "function global if import in isa let local macro module quote return struct true try using "
    "where while mutable abstract primitive type".split()
)


class Julia:
    """Interpreter of the part of Julia that is generated; anything else is an error."""

    def __init__(self, text: str) -> None:
        text = re.sub(r"^#=\n.*?^=#\n", "", text, flags=re.DOTALL | re.MULTILINE)
        text, imports = re.subn(
            r"^using SpecialFunctions: erf\n", "", text, count=1, flags=re.MULTILINE
        )
        self.known = _FUNCTIONS | ({"erf": math.erf} if imports else {})
        self.functions: dict[str, tuple[str, str]] = {}
        self.defaults: dict[str, float] = {}
        function = r'^"""[^"]*"""\nfunction (\w+!?)\(([\w, ]+)\)\n(.*?)^end$'
        rest = re.sub(function, self._define, text, flags=re.DOTALL | re.MULTILINE)
        rest = re.sub(
            r"^const PARAMETERS = \(\n(.*?)^\)$", self._bind, rest, flags=re.DOTALL | re.MULTILINE
        )
        assert not rest.strip(), rest

    def _define(self, found: re.Match[str]) -> str:
        self.functions[found[1]] = found[2], found[3]
        return ""

    def _bind(self, found: re.Match[str]) -> str:
        for line in found[1].splitlines():
            name, value = re.fullmatch(r"    (\w+) = (\S+),(?:  # .*)?", line).groups()  # type: ignore[union-attr]
            self._check(name)
            self.defaults[name] = float(value)
        return ""

    @staticmethod
    def _check(name: str) -> str:
        assert name not in _KEYWORDS
        return name

    def _value(self, text: str, v: Mapping[str, Any]) -> Any:
        """Evaluate an expression; names are looked up in v, because Python has other keywords."""

        def name(found: re.Match[str]) -> str:
            if found[1]:
                return f'v["parameters"]["{self._check(found[1])}"]'
            return f'v["{self._check(found[2])}"]'

        assert not set(text) & set("{}'\"$;#&|!?:")
        pattern = r"(?<!\w)parameters\.(\w+)|(?<![\w.])([^\W\d]\w*)"
        return eval(re.sub(pattern, name, text).replace("^", "**"), {"v": v})  # noqa: S307

    def call(
        self, name: str, z: np.ndarray, parameters: Mapping[str, float], t: float
    ) -> tuple[Any, dict[Any, float]]:
        """The returned value, and the entries of ``out`` by index; 0 is the index of all others."""
        arguments, body = self.functions[name]
        out: dict[Any, float] = {}
        first = dict(enumerate(map(float, z), 1))  # indices begin with 1
        known = {"out": out, "z": first, "parameters": parameters, "t": t}
        v: dict[str, Any] = {n: known[n] for n in arguments.split(", ")} | self.known
        waiting = ""
        for line in body.splitlines():
            assert line.startswith("    ")
            waiting += " " + line.strip()
            if waiting.count("(") > waiting.count(")"):
                continue
            statement, waiting = waiting.strip(), ""
            if statement == "return nothing":
                return None, out
            if statement.startswith("return "):
                return self._value(statement[7:], v), out
            if statement == "fill!(out, 0)":
                out[0] = 0.0
                continue
            *targets, value = statement.split(" = ")
            result = self._value(value, v)
            for target in targets:
                if place := re.fullmatch(r"out\[(\d+(?:, \d+)?)\]", target):
                    out[tuple(map(int, place[1].split(", ")))] = result
                else:
                    assert target not in {"out", "z", "parameters", "t"}
                    v[self._check(target)] = result
        raise AssertionError("a function without return")


def interpreted(H: Hamiltonian) -> Caller:
    julia = Julia(H.source("julia"))

    def call(name: str, z: np.ndarray, parameters: Mapping[str, float]) -> np.ndarray:
        given = dict(zip(julia.defaults, (parameters[n] for n in H.parameter_names), strict=True))
        shape = shape_of(name, H.dim)
        result, entries = julia.call(name + "!" * bool(shape), z, given, TIME)
        if not shape:
            return np.array(result)
        out = np.full(shape, entries.pop(0, np.nan))
        for place, value in entries.items():
            out[tuple(i - 1 for i in place)] = value
        return out

    return call


# -- JavaScript ------------------------------------------------------------------------------------

_NODE = """
import { createInterface } from "node:readline";
const modules = {};
for await (const line of createInterface({ input: process.stdin })) {
  const { text, name, arguments: given } = JSON.parse(line);
  const url = "data:text/javascript;base64," + Buffer.from(text).toString("base64");
  const module = modules[text] ??= await import(url);
  const found = name in module && module[name](...given);
  console.log(JSON.stringify(typeof found === "number" ? found : Array.from(found)));
}
"""


class Node:
    """A process of node that calls functions of modules."""

    def __init__(self, path: str) -> None:
        command = [path, "--input-type=module", "-e", _NODE]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True)

    def __call__(self, text: str, name: str, *arguments: Any) -> np.ndarray:
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        print(
            json.dumps({"text": text, "name": name, "arguments": arguments}),
            file=process.stdin,
            flush=True,
        )
        line = process.stdout.readline()
        assert line, process.communicate()[1]
        return np.array(json.loads(line), dtype=float)  # null, of NaN, becomes nan

    def end(self) -> None:
        self._process.communicate()


@pytest.fixture(scope="module")
def node() -> Iterator[Node]:
    path = shutil.which("node") or shutil.which("nodejs")
    if path is None:
        pytest.skip("needs node, the system's package nodejs")
    process = Node(path)
    yield process
    process.end()


def run_by_node(node: Node, H: Hamiltonian) -> Caller:
    text = H.source("javascript")
    keys = re.findall(r"^    (\w+): ", text.partition("\n};\n")[0], flags=re.MULTILINE)
    assert len(keys) == len(H.parameter_names)

    def call(name: str, z: np.ndarray, parameters: Mapping[str, float]) -> np.ndarray:
        given = dict(zip(keys, (float(parameters[n]) for n in H.parameter_names), strict=True))
        return node(text, name, z.tolist(), TIME, given).reshape(shape_of(name, H.dim))

    return call


# -- all -------------------------------------------------------------------------------------------


@pytest.fixture(params=["c", "julia", "javascript"])
def caller(
    request: pytest.FixtureRequest, tmp_path: Path
) -> Callable[[Hamiltonian], tuple[str, Caller]]:
    """Makes functions of a Hamiltonian in one of the languages."""
    if request.param == "julia":
        return interpreted  # type: ignore[return-value]
    if request.param == "javascript":
        node = request.getfixturevalue("node")
        return lambda H: run_by_node(node, H)  # type: ignore[return-value]
    cc = request.getfixturevalue("cc")
    return lambda H: compiled(cc, H, tmp_path)  # type: ignore[return-value]


def check(H: Hamiltonian, call: Caller, z: np.ndarray, **close: float) -> None:
    close = {"rtol": 1e-12, "atol": 1e-13} | close
    J = np.array(H.poisson_matrix, dtype=float)
    for point, energy, gradient, hessian in zip(z, *sympy_values(H, z), strict=True):
        expected = (energy, gradient, J @ gradient, J @ hessian, hessian)
        for name, value in zip(FUNCTIONS, expected, strict=True):
            found = call(name, point, H.parameters)
            np.testing.assert_allclose(found, value, **close, err_msg=name)


@pytest.mark.sampled(12)
def test_all_functions_match_sympy(problem: Problem, caller: Callable[..., Caller]) -> None:
    check(problem.H, caller(problem.H), states(problem.H, np.array(problem.z0), count=2))


@pytest.mark.slow_cases("c")
def test_every_function_of_formulas(
    caller: Callable[..., Caller], request: pytest.FixtureRequest
) -> None:
    lacks_erf = request.node.callspec.params["caller"] == "javascript"
    formulas = {f: at for f, at in FORMULAS.items() if not (lacks_erf and "erf" in f)}
    H = sum_of_formulas(formulas)
    call, n = caller(H), len(formulas)
    z = np.array([*formulas.values(), *n * [0.8]])
    J = np.array(H.poisson_matrix, dtype=float)
    # Sympy takes long for the sum; each term has variables of its own.
    energy, gradient, hessian = 0.0, np.zeros(2 * n), np.zeros((2 * n, 2 * n))
    for i, formula in enumerate(formulas):
        given = {"k": 1.3} if "k" in formula else {}
        one = Hamiltonian(f"p**2/2 + {formula}", q=["x"], p=["p"], parameters=given)
        own = [i, n + i]
        value, first, second = sympy_values(one, z[None, own])
        energy += value[0]
        gradient[own], hessian[np.ix_(own, own)] = first[0], second[0]
    close = {"rtol": 1e-12, "atol": 1e-13}
    expected = (energy, gradient, J @ gradient, J @ hessian, hessian)
    for name, value in zip(FUNCTIONS, expected, strict=True):
        np.testing.assert_allclose(call(name, z, H.parameters), value, **close, err_msg=name)


# Keywords, functions and macros of the two languages, beside those of Python.
_WORDS = (
    "let var new this arguments eval undefined NaN Infinity Math Float64Array void typeof "
    "double int long register struct pow fabs isnan NULL NAN M_E linux sign_ smaller larger DIM "
    "end function begin let local in isa where true out parameters default_parameters PARAMETERS "
    "energy hessian jacobian nothing i y0 gamma out_"
).split()
NAMES = [
    *AWKWARD,
    *(  # the parser refuses keywords of Python
        (p**2 / 2 + symbol * x**2 + symbol * sympy.cos(x), {symbol.name: 1.5})
        for symbol in sympy.symbols(_WORDS, real=True)
    ),
    ("p_I**2/2 + I**2*(1 + lambda*p_I**2)", {"lambda": 0.5}),
    ("p_double**2/2 + double**4 + end*double**2*p_double", {"end": 2.0}),
    ("p_θ**2/2 + ω**2*θ**2 + λ*cos(θ) + t*θ*Ω", {"ω": 2.0, "λ": 0.5, "Ω": 1.5}),
]


@pytest.mark.sampled(25)
@pytest.mark.parametrize(("formula", "parameters"), NAMES)
def test_reserved_names_are_usable(
    formula: str | sympy.Expr, parameters: dict[str, float], caller: Callable[..., Caller]
) -> None:
    q = ["dx", "x"] if "dx**2" in str(formula) else None
    H = Hamiltonian(formula, q=q, p=["p_dx", "p_x"] if q else None, parameters=parameters)
    check(H, caller(H), states(H, np.ones(H.dim), count=1))


def test_greek_letters_of_c_are_spelled_out() -> None:
    source = Hamiltonian("p_θ**2/2 + ω**2*cos(θ)").source("c", part="energy")
    assert source.isascii()
    assert "omega*omega*cos(theta)" in source


def test_forces_are_in_rates_and_power(caller: Callable[..., Caller]) -> None:
    """With dp/dt = -sin(x) + F by hand; the gradient and the Hessian are those of H."""
    H = Hamiltonian(
        "p**2/2 - cos(x)",
        forces={"p": "-c*p*abs(p) + atan(x)*cos(w*t)"},
        parameters={"c": 0.3, "w": 2.0},
    )
    call, z = caller(H), np.array([0.4, -1.5])
    force = 0.3 * 1.5**2 + math.atan(0.4) * math.cos(2 * TIME)
    rate = force - math.sin(0.4)
    slope = math.cos(2 * TIME) / (1 + 0.4**2)
    jacobian = [[0, 1], [slope - math.cos(0.4), -2 * 0.3 * 1.5]]
    close = {"rtol": 1e-14}
    np.testing.assert_allclose(call("vector_field", z, H.parameters), [-1.5, rate], **close)
    np.testing.assert_allclose(call("jacobian", z, H.parameters), jacobian, **close)
    np.testing.assert_allclose(call("gradient", z, H.parameters), [math.sin(0.4), -1.5], **close)
    hessian = np.diag([math.cos(0.4), 1.0])
    np.testing.assert_allclose(call("hessian", z, H.parameters), hessian, **close)
    np.testing.assert_allclose(call("power", z, H.parameters), -1.5 * force, **close)


def test_linear_hamiltonian_has_no_second_derivatives(caller: Callable[..., Caller]) -> None:
    H = Hamiltonian("x + 2*p")
    call = caller(H)
    np.testing.assert_array_equal(call("vector_field", np.ones(2), {}), [2, -1])
    np.testing.assert_array_equal(call("jacobian", np.ones(2), {}), np.zeros((2, 2)))
    np.testing.assert_array_equal(call("hessian", np.ones(2), {}), np.zeros((2, 2)))


def test_many_arguments_and_nested_rewrites(caller: Callable[..., Caller]) -> None:
    q = sympy.symbols("q1:13", real=True)
    H = Hamiltonian(p**2 / 2 + sympy.Max(*q) * x, q=["x"], p=["p"])
    H = H.with_parameters(**{symbol.name: float(i) for i, symbol in enumerate(q)})
    assert caller(H)("energy", np.array([2.0, 0.0]), H.parameters) == pytest.approx(22)
    H = Hamiltonian("p**2/2 + csc(cot(x) - atan(2))")
    check(H, caller(H), np.array([[0.4, 0.3]]))


@pytest.mark.parametrize("n", [2.0, 3.0, 4.0])
def test_powers_with_parameter_have_derivatives_at_zero(
    n: float, caller: Callable[..., Caller]
) -> None:
    H = Hamiltonian("p**2/2 + x**n/n", parameters={"n": n})
    call = caller(H)
    for at in (0.0, -0.5):
        gradient = call("gradient", np.array([at, 1.0]), H.parameters)
        np.testing.assert_allclose(gradient, [at ** (n - 1), 1.0])
        hessian = call("hessian", np.array([at, 1.0]), H.parameters)
        np.testing.assert_allclose(hessian, [[(n - 1) * at ** (n - 2), 0], [0, 1]])


@pytest.mark.parametrize("language", ["c", "julia", "javascript"])
@pytest.mark.parametrize("name", [*REFUSED, "erf"])
def test_missing_functions_are_named_in_errors(name: str, language: str) -> None:
    if name == "erf" and language != "javascript":
        assert "erf(x)" in Hamiltonian("p**2/2 + x", forces={"p": "erf(x)"}).source(language)
        return
    H = Hamiltonian(p**2 / 2 + REFUSED.get(name, sympy.erf(x)))
    with pytest.raises(CodeGenerationError, match=f"'{name}' cannot be generated for {language}"):
        H.source(language)


@pytest.mark.parametrize("language", ["c", "julia", "javascript"])
def test_unusable_coefficients_are_rejected(language: str) -> None:
    for power in (400, -400):
        with pytest.raises(CodeGenerationError, match="choose other units"):
            Hamiltonian(p**2 / 2 + sympy.Integer(10) ** power * x).source(language)
    with pytest.raises(CodeGenerationError, match="not a real number"):
        Hamiltonian(p**2 / 2 + sympy.asin(2) * x).source(language)


@pytest.mark.parametrize("language", ["c", "julia", "javascript"])
def test_missing_parts_and_compilation_are_refused(language: str) -> None:
    H = Hamiltonian("p**2/2 + x**2/2")
    for part in ("loss", "residual", "head", "velocity"):
        with pytest.raises(InputError, match=f"'{part}' is not a function of the module; choose"):
            H.source(language, part=part)
    with pytest.raises(InputError, match=f"'{language}' is only generated, by H.source"):
        H.compile(language)


@pytest.mark.parametrize("language", ["c", "julia", "javascript"])
@pytest.mark.parametrize("name", SYSTEMS)
def test_generated_text_is_tidy(name: str, language: str) -> None:
    H = CATALOGUE[name]().H
    source = H.source(language)
    assert max(map(len, source.splitlines())) <= 96
    assert all(line == line.rstrip() for line in source.splitlines())
    assert "\n\n\n\n" not in source
    assert source.endswith("\n")
    assert not source.endswith("\n\n")
    for part in BACKENDS[language].functions:
        assert f"\n\n\n{H.source(language, part=part)}\n" in source


# -- C alone ---------------------------------------------------------------------------------------


def test_c_functions_read_as_written_by_hand() -> None:
    H = Hamiltonian("p**2/(2*m) + 2/3*k*abs(x)**2.5*cos(w*t)", parameters={"k": 4.0, "m": 1})
    assert H.source("c", part="vector_field") == (
        """\
/* Right-hand side J grad H of Hamilton's equations. */
void vector_field(
    const double z[DIM],
    double t,
    const struct parameters *parameters,
    double out[DIM])
{
    const double x = z[0];
    const double p = z[1];
    const double k = parameters->k;
    const double m = parameters->m;
    const double w = parameters->w;
    out[0] = p/m;
    out[1] = -5.0*k*cos(t*w)*pow(fabs(x), 1.5)*sign(x)/3.0;
}"""
    )


def test_c_parameters_have_the_bound_values(cc: str, tmp_path: Path) -> None:
    H = Hamiltonian("p**2/(2*m) + k*x**2/2 + c10*x + c9", parameters={"k": 4.0, "m": 0.1})
    loaded = library(cc, H.source("c"), tmp_path)
    values = (ctypes.c_double * 4).in_dll(loaded, "default_parameters")
    assert H.parameter_names == ("c9", "c10", "k", "m")
    np.testing.assert_array_equal(list(values), [math.nan, math.nan, 4.0, 0.1])


def test_results_may_replace_the_state(cc: str, tmp_path: Path) -> None:
    loaded = library(cc, Hamiltonian("p**2*x**2/2").source("c"), tmp_path)
    z = np.array([2.0, 3.0])
    loaded.vector_field(pointer(z), pointer(z))
    np.testing.assert_array_equal(z, [12.0, -18.0])


@pytest.mark.parametrize("formula", ["max(x, p)", "min(x, p)", "max(p, x, 0)", "sign(x)*abs(x)"])
def test_undefined_states_have_undefined_energy(cc: str, formula: str, tmp_path: Path) -> None:
    H = Hamiltonian(formula, q=["x"], p=["p"])
    call = compiled(cc, H, tmp_path)
    assert math.isnan(call("energy", np.array([math.nan, 1.0]), {}))
    if "p" in formula:
        assert math.isnan(call("energy", np.array([1.0, math.nan]), {}))


def test_c_compiles_in_the_default_dialect_too(cc: str, tmp_path: Path) -> None:
    """Compilers then define more words."""
    words = sum(sympy.symbols(_WORDS, real=True))
    H = Hamiltonian(p**2 / 2 + x**2 * words, parameters=dict.fromkeys(_WORDS, 0.5))
    call = compiled(cc, H, tmp_path, "-O0")
    assert call("energy", np.array([1.0, 2.0]), H.parameters) == 2 + len(_WORDS) / 2


def test_macros_of_the_compiler_are_reserved(cc: str, tmp_path: Path) -> None:
    (tmp_path / "empty.c").write_text("#include <math.h>\n")
    for standard in ("c99", "gnu11", "gnu17"):
        command = [cc, f"-std={standard}", "-dM", "-E", str(tmp_path / "empty.c")]
        listed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        macros = set(re.findall(r"^#define ([A-Za-z]\w*)(?![\w(])", listed, flags=re.MULTILINE))
        assert macros
        assert {m for m in macros if "__" not in m} <= BACKENDS["c"].reserved


# -- Julia alone -----------------------------------------------------------------------------------


def test_julia_file_reads_as_written_by_hand() -> None:
    H = Hamiltonian("p**2/(2*m) + k*x**2/2 + 2/3*erf(x)*cos(w*t)", parameters={"k": 4.0, "m": 1})
    assert H.source("julia").partition("\n\n\n")[0] == (
        """\
#=
Hamilton's equations in Julia.

H = p**2/(2*m) + k*x**2/2 + 2*cos(t*w)*erf(x)/3

The state is z = (x, p), a vector. The functions have the arguments that
DifferentialEquations.jl expects. Parameters are a NamedTuple, or anything else with these
fields; PARAMETERS has the values in the Hamiltonian:

    f = ODEFunction(vector_field!; jac = jacobian!)
    solve(ODEProblem(f, z0, (0.0, 10.0), PARAMETERS), Vern9(); reltol = 1e-10)
=#

using SpecialFunctions: erf

const PARAMETERS = (
    k = 4.0,
    m = 1.0,
    w = NaN,  # has no value in the Hamiltonian
)"""
    )
    assert H.source("julia", part="jacobian") == (
        '''\
"""Derivatives of the vector field: d out_i / d z_j in row i."""
function jacobian!(out, z, parameters, t)
    x = z[1]
    k = parameters.k
    m = parameters.m
    w = parameters.w
    fill!(out, 0)
    out[1, 2] = 1/m
    out[2, 1] = 1.5045055561273502*x*exp(-x^2)*cos(t*w) - k
    return nothing
end'''
    )


# -- JavaScript alone ------------------------------------------------------------------------------


def test_javascript_module_reads_as_written_by_hand() -> None:
    H = Hamiltonian("p**2/(2*m) + k*(x - 1)**4*cos(w*t) - x**2", parameters={"k": 4.0, "m": 1})
    assert H.source("javascript").partition("\n\n\n")[0] == (
        """\
/* Hamilton's equations in JavaScript: an ES module.

   H = -x**2 + p**2/(2*m) + k*(x - 1)**4*cos(t*w)

   The state is z = (x, p), DIM numbers; out may be z. Matrices have rows and columns in this
   order, one row after the other in out. PARAMETERS has the values in the Hamiltonian. */

export const DIM = 2;

export const PARAMETERS = {
    k: 4.0,
    m: 1.0,
    w: NaN,  // has no value in the Hamiltonian
};"""
    )
    assert H.source("javascript", part="vector_field") == (
        """\
/** Right-hand side J grad H of Hamilton's equations. */
export function vector_field(z, t = 0, parameters = PARAMETERS, out = new Float64Array(DIM)) {
    const x = z[0];
    const p = z[1];
    const k = parameters.k;
    const m = parameters.m;
    const w = parameters.w;
    out[0] = p/m;
    out[1] = 2*x - 4*k*Math.pow(x - 1, 3)*Math.cos(t*w);
    return out;
}"""
    )


def test_javascript_arguments_have_defaults(node: Node) -> None:
    H = Hamiltonian("p**2/(2*m) + x**2/2", parameters={"m": 4.0})
    assert node(H.source("javascript"), "energy", [2.0, 4.0]) == 4.0
    without = Hamiltonian("p**2/2 + x").source("javascript")
    assert node(without, "energy", [2.0, 4.0]) == 10.0
