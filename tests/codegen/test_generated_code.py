"""All generated functions of all backends, compared with sympy and autograd."""

from __future__ import annotations

import ast
import inspect
import itertools
import keyword
import math
import os
import re
import subprocess
import sys
import textwrap
import traceback
from collections.abc import Iterable
from pathlib import Path

import numba
import numpy as np
import pytest
import sympy
import torch

from hamsym import Hamiltonian, InputError, integrate, solve
from hamsym.codegen import generate
from hamsym.codegen.backends import FUNCTIONS, PYTHON_NAMES
from hamsym.codegen.generate import Source, _wrapped
from hamsym.codegen.system import System
from hamsym.errors import CodeGenerationError
from hamsym.formula import parser
from hamsym.symbolic import derivatives
from hamsym.systems import CATALOGUE, Problem

# One degree of freedom, explicit time, two, many temporaries, not separable.
SYSTEMS = ["nonlinear_oscillator", "driven_oscillator", "kepler", "three_bodies", "double_pendulum"]


@pytest.fixture(params=SYSTEMS)
def example(request: pytest.FixtureRequest) -> Problem:
    return CATALOGUE[request.param]()


def interpreted(H: Hamiltonian, backend: str, monkeypatch: pytest.MonkeyPatch) -> System:
    """Functions of a backend; those of numba run as plain Python."""
    if backend != "numba":
        return H.compile(backend)
    monkeypatch.setattr(numba.config, "DISABLE_JIT", True)
    system = System(Source(H.real_equations, backend))
    for name in FUNCTIONS:
        getattr(system, name)  # loads it
    return system


def array(value: object) -> np.ndarray:
    return value.detach().numpy() if isinstance(value, torch.Tensor) else np.asarray(value)


def states(H: Hamiltonian, around: np.ndarray, count: int = 5) -> np.ndarray:
    return around + 0.2 * np.random.default_rng(1).normal(size=(count, H.dim))


# Time at which the functions of a time-dependent Hamiltonian are called.
TIME = 0.4


def call(system: System, name: str, *arguments: object, **keywords: object) -> np.ndarray:
    if system.time_dependent and len(arguments) == (2 if name in ("residual", "loss") else 1):
        arguments = (*arguments, TIME)
    if system.backend == "torch":
        arguments = tuple(torch.tensor(a) if isinstance(a, np.ndarray) else a for a in arguments)
    function = getattr(system, name)
    if system.backend == "jax":
        import jax

        function = jax.jit(function)
    return array(function(*arguments, **keywords))


def sympy_values(H: Hamiltonian, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Energy, gradient and Hessian at states (n, dim), by sympy to 30 digits."""
    own = {symbol.name: symbol for symbol in H.expr.free_symbols}
    real = {symbol: sympy.Symbol(name, real=True) for name, symbol in own.items()}
    expr = H.expr.xreplace(real)
    variables = [sympy.Symbol(name, real=True) for name in H.names]
    first = [sympy.diff(expr, v) for v in variables]
    second = [[sympy.diff(f, v) for v in variables] for f in first]
    values = {sympy.Symbol(name, real=True): v for name, v in H.parameters.items()}
    values[sympy.Symbol("t", real=True)] = TIME

    def at(e: sympy.Expr, point: np.ndarray) -> float:
        exact = dict(zip(variables, map(sympy.Float, point), strict=True))
        return float(e.subs({k: sympy.Float(v) for k, v in values.items()}).evalf(30, subs=exact))

    energy = np.array([at(expr, point) for point in z])
    gradient = np.array([[at(f, point) for f in first] for point in z])
    hessian = np.array([[[at(s, point) for s in row] for row in second] for point in z])
    return energy, gradient, hessian


def spellings(H: Hamiltonian) -> list[Hamiltonian]:
    """The same Hamiltonian from text, and from sympy with three kinds of assumptions."""
    variants = [H]
    for assumptions in ({}, {"real": True}, {"positive": True}):
        symbols = {s: sympy.Symbol(s.name, **assumptions) for s in H.expr.free_symbols}
        names = {symbol.name: symbol for symbol in symbols.values()}
        variants.append(
            Hamiltonian(
                H.expr.xreplace(symbols),
                q=[names.get(n, n) for n in H.names[: H.dof]],
                p=[names.get(n, n) for n in H.names[H.dof :]],
                parameters=dict(H.parameters),
            )
        )
    return variants


def check_against_sympy(H: Hamiltonian, z: np.ndarray, system: System) -> None:
    dz = np.random.default_rng(2).normal(size=z.shape)
    energy, gradient, hessian = sympy_values(H, z)
    J = np.array(H.poisson_matrix, dtype=float)
    residual = dz - gradient @ J.T
    loss = (residual**2).sum(axis=1).mean()
    close = {"rtol": 1e-12, "atol": 1e-13}
    np.testing.assert_allclose(call(system, "energy", z), energy, **close)
    np.testing.assert_allclose(call(system, "gradient", z), gradient, **close)
    np.testing.assert_allclose(call(system, "vector_field", z), gradient @ J.T, **close)
    np.testing.assert_allclose(call(system, "hessian", z), hessian, **close)
    np.testing.assert_allclose(call(system, "residual", z, dz), residual, **close)
    if H.time is not None:  # the loss has no energy penalty
        np.testing.assert_allclose(call(system, "loss", z, dz), loss, **close)
        return
    np.testing.assert_allclose(call(system, "loss", z, dz, 0.7), loss, **close)
    weighted = loss + 2.5 * ((energy - 0.7) ** 2).mean()
    np.testing.assert_allclose(call(system, "loss", z, dz, 0.7, 2.5), weighted, **close)


def test_all_functions_match_sympy(
    problem: Problem, backend: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    z = states(problem.H, np.array(problem.z0), count=2)
    check_against_sympy(problem.H, z, interpreted(problem.H, backend, monkeypatch))


@pytest.mark.slow_cases("driven_oscillator")
@pytest.mark.parametrize("name", ["driven_oscillator", "double_pendulum"])
def test_compiled_functions_match_sympy(name: str) -> None:
    problem = CATALOGUE[name]()
    z = states(problem.H, np.array(problem.z0), count=2)
    check_against_sympy(problem.H, z, problem.H.compile("numba"))


@pytest.mark.slow_cases("three_bodies")
def test_assumptions_of_symbols_are_ignored(example: Problem) -> None:
    H = example.H
    z = states(H, np.array(example.z0), count=2)
    sources = {variant.source("numpy") for variant in spellings(H)}
    assert len(sources) == 1
    check_against_sympy(H, z, spellings(H)[-1].compile("numpy"))


def test_torch_derivatives_match_autograd(problem: Problem) -> None:
    system = problem.H.compile("torch")
    for point in states(problem.H, np.array(problem.z0), count=2):
        arguments = system.arguments(torch.tensor(point), TIME)
        gradient = torch.func.grad(system.energy)(*arguments).numpy()
        hessian = torch.func.hessian(system.energy)(*arguments).numpy()
        np.testing.assert_allclose(call(system, "gradient", point), gradient, atol=1e-12)
        np.testing.assert_allclose(call(system, "hessian", point), hessian, atol=1e-11)


@pytest.mark.slow_cases("numba-driven_oscillator", "numba-henon_heiles")
@pytest.mark.parametrize("name", ["driven_oscillator", "henon_heiles"])
def test_shapes_and_dtypes_follow_the_state(name: str, backend: str) -> None:
    problem = CATALOGUE[name]()
    H = problem.H
    system, dim = H.compile(backend), H.dim
    for dtype in (np.float32, np.float64):
        for batch in ((), (2, 3)):
            z = np.broadcast_to(np.array(problem.z0, dtype), (*batch, dim)).copy()
            for function, shape in [
                ("energy", batch),
                ("gradient", (*batch, dim)),
                ("vector_field", (*batch, dim)),
                ("hessian", (*batch, dim, dim)),
            ]:
                value = call(system, function, z)
                assert (value.shape, value.dtype) == (shape, dtype), function
            assert call(system, "residual", z, z).shape == (*batch, dim)
            assert call(system, "residual", z, z).dtype == dtype
            penalty = (0.5, 1.0) if H.time is None else ()
            assert call(system, "loss", z, z, *penalty).shape == ()


def test_states_of_wrong_length_are_rejected(backend: str) -> None:
    system = Hamiltonian("p**2/2 + x**2/2").compile(backend)
    for shape in ((3,), (2, 5), ()):
        with pytest.raises((ValueError, RuntimeError, IndexError)):
            call(system, "vector_field", np.ones(shape))


# -- every function ------------------------------------------------------------------------------

# Function, a point inside its domain.
ELEMENTARY = {
    **dict.fromkeys("sin cos tan sec csc asin acos atan acot sinh cosh tanh".split(), 0.4),
    **dict.fromkeys("coth sech csch asinh atanh asech acsch exp log sqrt abs erf".split(), 0.4),
    **dict.fromkeys("acosh acoth asec acsc cot sign".split(), 1.7),
}
FORMULAS = {
    **{f"{name}(x)": at for name, at in ELEMENTARY.items()},
    "abs(x)*x": -0.7,
    "atan2(x, p)": 0.3,
    "atan2(x, k)": 0.3,
    "atan2(2, x)": 0.3,
    "max(x, 1)": 1.4,
    "max(x, p, k)": 0.3,
    "min(x**2, k, 0.2)": 0.3,
    "x**k": 0.6,
    "k**x": 0.6,
    "2**x": 0.6,
    "x**2.5": 0.6,
    "x**(-1/3)": 0.6,
    "x**(-2)": -0.6,
    "sqrt(k)*x**3": 0.6,
    "exp(-k)*erf(k*x)": 0.6,
    "max(k, 2)*x**2": 0.6,
    "sqrt(2)*pi*x**3": 0.6,
    "x": 0.6,
    "3": 0.6,
    "exp(x*p)/(1 + x**2)": 0.5,
    "log(cosh(x))": 0.5,
}


def sum_of_formulas(formulas: Iterable[str] = FORMULAS) -> Hamiltonian:
    """Return a Hamiltonian with one formula for each degree of freedom."""
    terms = []
    for i, formula in enumerate(formulas):
        own = re.sub(r"\b[xp]\b", lambda name, i=i: f"{name.group()}{i}", formula)
        terms.append(f"p{i}**2/2 + {own}")
    names = [[f"{letter}{i}" for i in range(len(terms))] for letter in "xp"]
    return Hamiltonian(" + ".join(terms), q=names[0], p=names[1], parameters={"k": 1.3})


@pytest.fixture(scope="module")
def every_function() -> tuple[Hamiltonian, np.ndarray]:
    """The sum of all formulas, and states inside their domains."""
    H = sum_of_formulas()
    at = np.array(list(FORMULAS.values()))
    z = np.stack((np.concatenate((at, 0 * at + 0.8)), np.concatenate((at + 0.01, 0 * at - 0.4))))
    return H, z


@pytest.mark.slow_cases("numpy", "torch", "numba")
def test_every_function_in_every_backend(
    every_function: tuple[Hamiltonian, np.ndarray], backend: str
) -> None:
    H, z = every_function
    own = [Hamiltonian(f"p**2/2 + {formula}", q=["x"], p=["p"], parameters={"k": 1.3} if "k" in
                       formula else {}) for formula in FORMULAS]  # fmt: skip
    n = len(FORMULAS)
    energy, gradient, hessian = np.zeros(2), np.zeros((2, 2 * n)), np.zeros((2, 2 * n, 2 * n))
    for i, one in enumerate(own):
        value, first, second = sympy_values(one, z[:, [i, n + i]])
        energy += value
        gradient[:, [i, n + i]] = first
        hessian[np.ix_([0, 1], [i, n + i], [i, n + i])] = second
    system = H.compile(backend)
    np.testing.assert_allclose(call(system, "energy", z), energy, rtol=1e-13)
    np.testing.assert_allclose(call(system, "gradient", z), gradient, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(call(system, "hessian", z), hessian, rtol=1e-12, atol=1e-13)


@pytest.mark.slow
def test_gradients_flow_twice_through_every_function(
    every_function: tuple[Hamiltonian, np.ndarray],
) -> None:
    H, states = every_function
    system = H.compile("torch")
    z = torch.tensor(states[:1], requires_grad=True)

    def slope(value: torch.Tensor) -> torch.Tensor:
        return torch.autograd.grad(value, z, create_graph=True, materialize_grads=True)[0]

    first = slope(system.energy(z).sum())
    torch.testing.assert_close(first, system.gradient(z))
    rows = [slope(entry)[0] for entry in first[0]]
    torch.testing.assert_close(torch.stack(rows), system.hessian(z)[0])
    assert torch.isfinite(slope(system.hessian(z).sum())).all()
    twice = slope(slope(system.loss(z, z, 0.0, 1.0)).sum())
    assert torch.isfinite(twice).all()
    n = len(FORMULAS)
    assert (twice[0, :n] != 0).sum() >= n - 3  # except constant and linear formulas


x, p = sympy.symbols("x p", real=True)
REFUSED = {
    "gamma": sympy.gamma(x),
    "sinc": sympy.sinc(x),
    "besselj": sympy.besselj(0, x),
    "LambertW": sympy.LambertW(x),
    "floor": sympy.floor(x),
    "zeta": sympy.zeta(x),
}


@pytest.mark.parametrize("name", REFUSED)
def test_missing_functions_are_named_in_errors(name: str, backend: str) -> None:
    H = Hamiltonian(p**2 / 2 + REFUSED[name])
    with pytest.raises(CodeGenerationError, match=f"'{name}' cannot be generated for {backend}"):
        H.source(backend)


@pytest.mark.parametrize(
    "expr", [sympy.asin(2) * x, sympy.Rational(-2) ** sympy.Rational(1, 3) * x]
)
def test_complex_coefficients_are_rejected(expr: sympy.Expr, backend: str) -> None:
    with pytest.raises(InputError):
        Hamiltonian(p**2 / 2 + expr).compile(backend)


def test_coefficients_beyond_float64_are_rejected(backend: str) -> None:
    for power in (400, -400):
        H = Hamiltonian(p**2 / 2 + sympy.Integer(10) ** power * x)
        with pytest.raises(CodeGenerationError, match="choose other units"):
            H.compile(backend)


def test_many_arguments_and_nested_rewrites(backend: str) -> None:
    q = sympy.symbols("q1:13", real=True)
    H = Hamiltonian(p**2 / 2 + sympy.Max(*q) * x, q=["x"], p=["p"])
    values = {symbol.name: float(i) for i, symbol in enumerate(q)}
    H = H.with_parameters(**values)
    assert call(H.compile(backend), "energy", np.array([2.0, 0.0])) == pytest.approx(2 * 11)
    H = Hamiltonian("p**2/2 + csc(cot(x) - atan(2))")
    z = np.array([[0.4, 0.3]])
    np.testing.assert_allclose(call(H.compile(backend), "energy", z), sympy_values(H, z)[0])


# -- parameters and time -------------------------------------------------------------------------


def test_parameters_are_keywords_with_the_bound_values(backend: str) -> None:
    H = Hamiltonian("p**2/(2*m) + k*x**2/2 + c", parameters={"k": 4.0, "m": 1})
    system = H.compile(backend)
    for name in FUNCTIONS:
        signature = inspect.signature(getattr(system, name))
        leading = {"residual": ["z", "dz"], "loss": ["z", "dz", "energy_0", "energy_weight"]}
        assert list(signature.parameters) == [*leading.get(name, ["z"]), "c", "k", "m"]
        kinds = [signature.parameters[n].kind for n in ("c", "k", "m")]
        assert kinds == [inspect.Parameter.KEYWORD_ONLY] * 3
        assert signature.parameters["c"].default is inspect.Parameter.empty
        assert signature.parameters["k"].default == 4.0
        assert signature.parameters["m"].default == 1.0
    z = np.array([1.0, 2.0])
    assert call(system, "energy", z, c=0.5) == pytest.approx(4.5)
    assert call(system, "energy", z, c=0.5, k=0.0, m=2.0) == pytest.approx(1.5)
    with pytest.raises(TypeError, match="'c'"):
        call(system, "energy", z)


@pytest.mark.parametrize(
    ("formula", "value"),
    [
        ("p**2/2 + x**2/k", 0.0),
        ("sqrt(p**2 + k**2) + x**2", 1e300),
        ("p**2/2 + x**2*k**(3/2)", -1.0),
    ],
)
def test_parameters_without_a_finite_H_are_refused_in_one_sentence(
    formula: str, value: float
) -> None:
    """Operations on Python's numbers raise ZeroDivisionError and OverflowError, or are complex."""
    H = Hamiltonian(formula, parameters={"k": value})
    with np.errstate(all="ignore"):
        assert not np.isfinite(H.compile("numpy").energy([1.0, 1.0]))
        assert not np.isfinite(H.observable(H.expr)([1.0, 1.0]))
    with pytest.raises(InputError, match="H or its gradient is not finite at z0"):
        solve(H, [1.0, 1.0], (0, 1))
    assert not integrate(H, [1.0, 1.0], (0, 1), tol=1e-6).success


def test_gradients_flow_to_parameters() -> None:
    system = Hamiltonian("p**2/2 + sqrt(k)*x + k").compile("torch")
    k = torch.tensor(4.0, dtype=torch.float64, requires_grad=True)
    z = torch.tensor([[2.0, 0.0]], dtype=torch.float64)
    (slope,) = torch.autograd.grad(system.energy(z, k=k).sum(), k)
    assert slope.item() == pytest.approx(2 / (2 * 2.0) + 1)
    (slope,) = torch.autograd.grad(system.gradient(z, k=k).sum(), k)
    assert slope.item() == pytest.approx(1 / 4)


@pytest.mark.slow_cases("numba")
def test_time_follows_the_state(backend: str) -> None:
    H = Hamiltonian("p**2/2 + F*x*cos(w*t)", parameters={"F": 2.0, "w": 3.0})
    system = H.compile(backend)
    assert system.time_dependent
    z = np.array([[1.0, 2.0], [0.5, 0.0]])
    for t in (0.3, np.array([0.3, 0.4])):
        force = -2 * np.cos(3 * np.broadcast_to(t, 2))
        rate = np.stack((z[:, 1], force), axis=1)
        np.testing.assert_allclose(call(system, "vector_field", z, t), rate, rtol=1e-14)
        np.testing.assert_allclose(call(system, "residual", z, 0 * z, t), -rate, rtol=1e-14)
        mean = (rate**2).sum(axis=1).mean()
        np.testing.assert_allclose(call(system, "loss", z, 0 * z, t), mean, rtol=1e-14)
    assert "energy_weight" not in inspect.signature(system.loss).parameters


# -- the text ------------------------------------------------------------------------------------


def test_oscillator_loss_has_the_papers_form() -> None:
    H = Hamiltonian("p**2/2 + x**2/2 + x**4/4")
    assert H.source("torch", part="loss") == textwrap.dedent('''\
        def loss(z, dz, energy_0, energy_weight=0.0):
            """Loss of a trajectory at K points, a scalar.

            L = 1/K sum_n |dz_n - J grad H(z_n)|**2 + energy_weight/K sum_n (H(z_n) - energy_0)**2

            H = p**2/2 + x**2/2 + x**4/4
            z = (x, p), shape (K, 2)
            dz, its time derivative, shape (K, 2)
            """
            x, p = z.unbind(-1)
            dx, dp = dz.unbind(-1)
            value = torch.mean((dx - p)**2 + (dp + x + x**3)**2)
            if energy_weight:
                energy_error = energy(z) - energy_0
                value = value + energy_weight*torch.mean(energy_error**2)
            return value''')


def test_source_is_the_executed_text(example: Problem, backend: str) -> None:
    system = example.H.compile(backend)
    assert system.source == example.H.source(backend)
    for name in FUNCTIONS:
        assert example.H.source(backend, part=name) == inspect.getsource(
            getattr(system, name)
        ).rstrip("\n")
    assert example.H.compile(backend) is system


@pytest.mark.parametrize("backend", ["numpy", "torch"])
def test_values_in_signatures_are_those_that_were_rendered(
    example: Problem, backend: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    shared = Source(example.H.real_equations, backend).text
    monkeypatch.setattr(generate, "_VALUES_IN_SIGNATURES", frozenset())
    assert Source(example.H.real_equations, backend).text == shared


@pytest.mark.slow_cases("nonlinear_oscillator-numba")
def test_generated_text_is_tidy(example: Problem, backend: str) -> None:
    source = example.H.source(backend)
    assert max(map(len, source.splitlines())) <= 96
    assert all(line == line.rstrip() for line in source.splitlines())
    assert "\n\n\n\n" not in source
    assert source.endswith("\n")
    assert not source.endswith("\n\n")
    for node in ast.parse(source).body:
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            assert ast.get_docstring(node)


def test_tracebacks_show_the_generated_line() -> None:
    system = Hamiltonian("p**2/2 + x**2/2").compile("torch")
    with pytest.raises(ValueError, match="unpack") as caught:
        system.energy(torch.zeros(3))
    assert "x, p = z.unbind(-1)" in "".join(traceback.format_tb(caught.tb))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("rust",), "'rust' is not a backend; choose one of torch, numpy, numba, jax, c, julia"),
        (
            ("torch", "lagrangian"),
            "'lagrangian' is not a function of the module; choose one of energy",
        ),
        (("torch", "_private"), "'_private' is not a function"),
    ],
)
def test_unknown_backend_or_part(arguments: tuple[str, ...], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Hamiltonian("p**2 + x**2").source(*arguments)


def test_kernels_and_loops_are_parts() -> None:
    H = Hamiltonian("p**2 + x**2")
    assert "return (2*p,)" in H.source("numba", part="velocity")
    assert "return (2*x,)" in H.source("numba", part="slope")
    assert "velocity(q, p, t, values)" in H.source("numba", part="splitting")


def test_only_used_components_are_unpacked() -> None:
    H = CATALOGUE["kepler"]().H
    polar = Hamiltonian("p_r**2/2 + p_phi**2/(2*r**2) - 1/r")
    assert "_, r, p_phi, p_r = z.unbind(-1)" in polar.source("torch", part="energy")
    assert "r, p_phi = z[..., 1], z[..., 2]" not in H.source("numpy", part="energy")
    assert "phi" not in re.sub("p_phi", "", polar.source("numpy", part="gradient"))


def test_functions_are_derived_on_first_use(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("Hessian derived")

    H = Hamiltonian("p**2/2 + x**2/2 + x**8/8 - 1/1001")
    monkeypatch.setattr(derivatives, "hessian", refuse)
    z = integrate(H, [1.0, 0.2], (0, 1), "forest_ruth", steps=10).z
    assert H.compile("numpy").gradient(z).shape == z.shape
    with pytest.raises(AssertionError, match="Hessian derived"):
        H.compile("numpy").hessian(z)


# -- names ---------------------------------------------------------------------------------------


def test_names_in_templates_are_reserved(example: Problem, backend: str) -> None:
    """Tested in every function that contains names of the user."""
    H = example.H
    users = {f"{mark}{name}" for name in H.names for mark in ("", "d")} | set(H.parameter_names)
    for node in ast.parse(H.source(backend)).body:
        bound = {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}
        bound |= {a.arg for a in ast.walk(node) if isinstance(a, ast.arg)}
        if not isinstance(node, ast.FunctionDef) or not bound & users:
            continue
        if {a.arg for a in ast.walk(node) if isinstance(a, ast.arg)} & {"states", "tangents", "x"}:
            continue  # a loop of the integrators, or a kernel of tuples
        own = {name for name in bound - users if not re.fullmatch(r"u\d+", name)}
        assert own - {"njit"} <= PYTHON_NAMES, node.name


AWKWARD = [
    ("p_z**2/2 + z**2/2 + x**2 + p_x**2", {}),
    ("p_dx**2/2 + dx**2/2 + x**2 + p_x**2", {}),
    ("p**2/2 + lambda*x**2", {"lambda": 2.0}),
    ("p**2/2 + torch*np*math*x**2", {"torch": 1.0, "np": 2.0, "math": 3.0}),
    (
        "p**2/2 + z*dz*energy_0*energy_weight*x**2",
        dict.fromkeys("z dz energy_0 energy_weight".split(), 1.5),
    ),
    ("p**2/2 + out*value*abs(x)*u0*u1", {"out": 1.0, "value": 2.0, "u0": 1.0, "u1": 1.0}),
    ("p**2/2 + step_size*steps*start*x**2", {"step_size": 2.0, "steps": 1.0, "start": 3.0}),
    ("p**2/2 + E*I*S*N*Q*x**2", dict.fromkeys("EISNQ", 1.1)),
    (
        "p**2/2 + energy*loss*range*print*x**2",
        dict.fromkeys("energy loss range print".split(), 1.2),
    ),
    ("p**2/2 + z*z_*x**2", {"z": 2.0, "z_": 3.0}),
    ("p_θ**2/2 + ω**2*θ**2", {"ω": 2.0}),
]


@pytest.mark.sampled(15)
@pytest.mark.parametrize(("formula", "parameters"), AWKWARD)
def test_reserved_names_are_usable_in_formulas(
    formula: str,
    parameters: dict[str, float],
    backend: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    q = ["dx", "x"] if "dx**2" in formula else None
    H = Hamiltonian(formula, q=q, p=["p_dx", "p_x"] if q else None, parameters=parameters)
    z = states(H, np.ones(H.dim), count=2)
    energy, gradient, hessian = sympy_values(H, z)
    system = interpreted(H, backend, monkeypatch)
    np.testing.assert_allclose(call(system, "energy", z), energy, rtol=1e-13)
    np.testing.assert_allclose(call(system, "gradient", z), gradient, rtol=1e-13)
    np.testing.assert_allclose(call(system, "hessian", z), hessian, rtol=1e-13, atol=1e-14)
    residual = z - call(system, "vector_field", z)
    np.testing.assert_allclose(call(system, "residual", z, z), residual, rtol=1e-13)
    loss = (residual**2).sum(axis=1).mean() + 2 * ((energy - 0.5) ** 2).mean()
    assert call(system, "loss", z, z, 0.5, 2.0) == pytest.approx(loss, rel=1e-13)
    identifiers = {n.id for n in ast.walk(ast.parse(system.source)) if isinstance(n, ast.Name)}
    assert not any(keyword.iskeyword(name) for name in identifiers)
    if backend == "numba":
        for method in ("symplectic_euler", "gauss4", "tao2"):
            first = integrate(H, z[0], (0, 1e-3), method, steps=1).z[-1]
            np.testing.assert_allclose((first - z[0]) / 1e-3, z[0] - residual[0], atol=0.1)


@pytest.mark.slow_cases("numpy", "torch", "numba")
def test_large_systems_extract_common_subexpressions(backend: str) -> None:
    """Results with temporaries equal sympy's."""
    terms = " + ".join(f"exp(-(q{i} - q{i + 1})**2)*cos(q{i} - q{i + 1})" for i in range(1, 8))
    kinetic = " + ".join(f"p{i}**2/2" for i in range(1, 9))
    H = Hamiltonian(f"{kinetic} + {terms}")
    assert "u0 = " in H.source("torch", part="gradient")
    z = states(H, np.zeros(H.dim), count=2)
    _, gradient, hessian = sympy_values(H, z)
    np.testing.assert_allclose(call(H.compile(backend), "gradient", z), gradient, atol=1e-13)
    np.testing.assert_allclose(call(H.compile(backend), "hessian", z), hessian, atol=1e-12)


@pytest.mark.parametrize("dof", [1, 4])
def test_linear_hamiltonian_has_no_second_derivatives(dof: int, backend: str) -> None:
    H = Hamiltonian(" + ".join(f"x{i} + 2*p{i}" for i in range(dof)))
    system = H.compile(backend)
    field = call(system, "vector_field", np.ones((3, 2 * dof)))
    np.testing.assert_array_equal(field, [[2] * dof + [-1] * dof] * 3)
    hessian = call(system, "hessian", np.ones((3, 2 * dof)))
    np.testing.assert_array_equal(hessian, np.zeros((3, 2 * dof, 2 * dof)))


_SHAPES = {
    "sum": ("({0})", lambda s: s, lambda s: 1 + 0 * s, lambda s: 0 * s),
    "sine": ("sin({0})", np.sin, np.cos, lambda s: -np.sin(s)),
    "cube": ("({0})**3", lambda s: s**3, lambda s: 3 * s**2, lambda s: 6 * s),
    "quotient": ("1/({0})", lambda s: 1 / s, lambda s: -1 / s**2, lambda s: 2 / s**3),
}


@pytest.mark.parametrize("backend", ["torch", "numpy"])  # numba compilation takes a minute
@pytest.mark.parametrize("shape", _SHAPES)
def test_derivatives_of_long_products_are_those_of_their_factors(shape: str, backend: str) -> None:
    n = 11
    text, value, slope, curvature = _SHAPES[shape]
    H = Hamiltonian("2*" + "*".join(text.format(f"q{i} + p{i}") for i in range(n)))
    system = H.compile(backend)
    z = np.random.default_rng(3).uniform(0.4, 0.9, (3, 2 * n))
    for point in z:
        sums = point[:n] + point[n:]
        f, product = value(sums), 2 * np.prod(value(sums))
        log_slopes = slope(sums) / f
        gradient = product * np.tile(log_slopes, 2)
        block = product * np.outer(log_slopes, log_slopes)
        np.fill_diagonal(block, product * curvature(sums) / f)
        np.testing.assert_allclose(call(system, "gradient", point), gradient, rtol=1e-13)
        np.testing.assert_allclose(
            call(system, "hessian", point), np.tile(block, (2, 2)), rtol=1e-13, atol=1e-15
        )


@pytest.mark.parametrize("length", range(20, 100, 5))
def test_lines_end_before_products_but_not_inside_powers(length: int) -> None:
    sums = "a1 + " * (length // 5) + "b2"
    text = f"c*({sums})**(-np.tanh({sums}))/(25 + {sums})*({sums})"
    expected = ast.dump(ast.parse(text, mode="eval"))
    assert ast.dump(ast.parse(_wrapped(text, 4), mode="eval")) == expected


@pytest.mark.slow
def test_sources_do_not_depend_on_the_process() -> None:
    formula = "*".join(f"sin(q{i} + p{i})" for i in range(5))
    script = f"import hamsym; print(hamsym.Hamiltonian('{formula}').source('numpy'))"
    texts = [
        subprocess.run(
            [sys.executable, "-c", script],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "PYTHONHASHSEED": seed},
        ).stdout
        for seed in ("1", "2")
    ]
    assert texts[0] == texts[1]


# -- effort --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_derivatives_beyond_the_limit_are_rejected() -> None:
    H = Hamiltonian("*".join(f"(q{i} + p{i})" for i in range(60)))
    with pytest.raises(CodeGenerationError, match="single terms contain many variables"):
        H.source("numpy")


def test_catalogue_is_far_below_the_limit(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(derivatives, "MAX_OPERATIONS", derivatives.MAX_OPERATIONS // 10)
    H = problem.H
    assert Hamiltonian(H.expr, q=H.q, p=H.p, parameters=dict(H.parameters)).hessian.shape


def _chain(n: int) -> str:
    q = ["0", *(f"q{i}" for i in range(n)), "0"]
    stretches = [f"({b} - {a})" for a, b in itertools.pairwise(q)]
    bonds = [f"{s}**2/2 + {s}**3/4 + {s}**4/8" for s in stretches]
    return " + ".join([*(f"p{i}**2/2" for i in range(n)), *bonds])


def _bodies(n: int) -> str:
    kinetic = " + ".join(f"p_{axis}{i}**2/2" for i in range(n) for axis in "xyz")
    distances = [
        "sqrt(" + " + ".join(f"({axis}{i} - {axis}{j})**2" for axis in "xyz") + " + 1/100)"
        for i, j in itertools.combinations(range(n), 2)
    ]
    return kinetic + "".join(f" - 1/{distance}" for distance in distances)


@pytest.mark.slow
@pytest.mark.parametrize("formula", [_chain(64), _bodies(10)], ids=["chain", "bodies"])
def test_many_particles_are_far_below_the_limit(
    formula: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(derivatives, "MAX_OPERATIONS", derivatives.MAX_OPERATIONS // 8)
    monkeypatch.setattr(derivatives, "_MOST_GROWTH", 0)
    monkeypatch.setattr(parser, "MAX_SECONDS", 60.0)
    assert Hamiltonian(formula).hessian.shape


# -- powers ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [2.0, 3.0, 4.0])
def test_powers_with_parameter_have_derivatives_at_zero(n: float, backend: str) -> None:
    system = Hamiltonian("p**2/2 + x**n/n", parameters={"n": n}).compile(backend)
    for x in (0.0, -0.5):
        z = np.array([[x, 1.0]])
        np.testing.assert_allclose(call(system, "gradient", z), [[x ** (n - 1), 1.0]])
        curvature = (n - 1) * x ** (n - 2)
        np.testing.assert_allclose(call(system, "hessian", z), [[[curvature, 0], [0, 1]]])


# -- torch ---------------------------------------------------------------------------------------


def test_torch_functions_with_vmap_and_devices(example: Problem) -> None:
    system = example.H.compile("torch")
    z = torch.tensor(states(example.H, np.array(example.z0)))
    for name in ("energy", "gradient", "vector_field", "hessian"):
        arguments = system.arguments((), torch.tensor(TIME, dtype=z.dtype))[1:]
        function = getattr(system, name)
        each = torch.func.vmap(lambda point, f=function, a=arguments: f(point, *a))(z)
        torch.testing.assert_close(each, function(z, *arguments))
        # The meta device computes only shapes and rejects tensors of other devices.
        assert function(z.to("meta"), *arguments).device.type == "meta"
    more = arguments or (0.0, 1.0)
    assert system.loss(z.to("meta"), z.to("meta"), *more).device.type == "meta"


# -- without hamsym --------------------------------------------------------------------------------

_ALONE = """
import sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {forbidden!r}:
            raise ImportError("not installed here: " + name)
sys.meta_path.insert(0, Refuse())
sys.path.insert(0, {folder!r})
import generated
z = {make}
print(float(generated.loss(z, z, 0.5, 1.0)))
print(float(generated.hessian(z).sum()))
"""


@pytest.mark.slow_cases("numba", "torch", "jax")
def test_source_file_runs_without_hamsym(backend: str, tmp_path: Path) -> None:
    H = Hamiltonian("p**2/2 + x**4/4 + erf(x) + x*p")
    (tmp_path / "generated.py").write_text(H.source(backend), encoding="utf-8")
    script, make = "import numpy as np\n", "np.array([[1.0, 2.0], [0.5, 0.1]])"
    if backend == "torch":
        script = "import torch\n"
        make = "torch.tensor([[1.0, 2.0], [0.5, 0.1]], dtype=torch.float64)"
    elif backend == "jax":
        script += 'import jax\njax.config.update("jax_enable_x64", True)\n'
    forbidden = {"hamsym", "jinja2", "scipy", "torch", "numba"} - {backend}
    if backend == "jax":
        forbidden -= {"scipy"}  # jax may import it
    script += _ALONE.format(forbidden=sorted(forbidden), folder=str(tmp_path), make=make)
    result = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert result.returncode == 0, result.stderr
    z = np.array([[1.0, 2.0], [0.5, 0.1]])
    system = H.compile("numpy")
    loss, total = map(float, result.stdout.split())
    assert loss == pytest.approx(float(system.loss(z, z, 0.5, 1.0)), rel=1e-12)
    assert total == pytest.approx(float(system.hessian(z).sum()), rel=1e-12)
    assert math.isfinite(loss)
