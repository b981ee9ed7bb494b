"""Suggestions: similar names, keywords and attributes of scipy."""

from __future__ import annotations

import copy
import inspect
import pickle
import warnings

import numpy as np
import pytest

import hamsym
from hamsym import Hamiltonian, InputError
from hamsym.errors import KeywordError, ParseError
from hamsym.support.suggestions import similar

OSCILLATOR = "p**2/2 + x**2/2"
START = (OSCILLATOR, [1.0, 0.0], (0, 1))


@pytest.mark.parametrize(
    ("name", "names", "expected"),
    [
        ("keppler", ["kepler", "toda_chain"], "kepler"),
        ("PX", ["x", "p_x"], "p_x"),
        ("henon", ["henon_heiles", "kepler"], "henon_heiles"),
        ("y", ["x", "p"], None),
        ("rk4", ["ruth3", "gauss4"], None),
        ("", ["x"], None),
        (3, ["x"], None),
    ],
)
def test_similar_names(name: object, names: list[str], expected: str | None) -> None:
    assert similar(name, names) == expected


@pytest.mark.parametrize(
    ("function", "keywords", "answer"),
    [
        (hamsym.solve, {"rtol": 1e-9}, "'rtol' is not an argument of solve; give tol=..."),
        (hamsym.solve, {"t_eval": [1]}, "call the result with the times, solution(t)"),
        (hamsym.solve, {"dense_output": True}, "call the result with the times, solution(t)"),
        (hamsym.solve, {"max_step": 0.1}, "method=hamsym.Features(max_window=...) to solve"),
        (hamsym.solve, {"args": (1,)}, "H.with_parameters(m=1.0)"),
        (hamsym.solve, {"parameters": {}}, "H.with_parameters(m=1.0)"),
        (hamsym.solve, {"events": []}, "solution.events('x = 0, p_x > 0')"),
        (hamsym.solve, {"max_windw": 1}, "(did you mean method=hamsym.Features(max_window=1)?)"),
        (hamsym.solve, {"toll": 1e-9}, "(did you mean 'tol'?)"),
        (hamsym.solve, {"target_error": 1}, "give solve a tolerance, tol=..."),
        (hamsym.Adam, {"epoch": 9}, "(did you mean 'epochs'?)"),
        (hamsym.Features, {"tol": 1e-9}, "it has max_window"),
        (hamsym.integrate, {"t_eval": [1]}, "saves=... or save_every=..."),
        (hamsym.integrate, {"max_step": 0.1}, "give dt=... or steps=..."),
        (hamsym.integrate, {"events": []}, "section(H, z0, span"),
        (hamsym.integrate, {"stps": 9}, "(did you mean 'steps'?)"),
        (hamsym.integrate, {"spam": 9}, "it has H, z0, span, method, parameters"),
        (hamsym.lyapunov, {"rtol": 1e-9}, "dt=... or steps=..."),
        (hamsym.solve_many, {"rtol": 1e-9}, "give tol=..."),
        (hamsym.solve_many, {"epochs": 9}, "it has "),
    ],
)
def test_keywords_of_scipy_are_answered(function, keywords, answer: str) -> None:
    with pytest.raises(KeywordError) as caught:
        function(*(() if isinstance(function, type) else START), **keywords)
    message = str(caught.value)
    assert answer in message
    assert message.startswith(f"'{next(iter(keywords))}' is not an ")
    assert "\n" not in message
    assert isinstance(caught.value, InputError)
    assert isinstance(caught.value, TypeError)


@pytest.mark.parametrize(
    ("keyword", "answer"),
    [("rtol", "give tol=..."), ("widht", "'widht' is not an argument of flow_map; it has")],
)
def test_keywords_of_flow_maps_are_answered(keyword: str, answer: str) -> None:
    with pytest.raises(KeywordError, match=answer):
        hamsym.flow_map(OSCILLATOR, {"x": (0, 1), "p": 0}, (0, 1), **{keyword: 1})


@pytest.mark.parametrize("function", [hamsym.solve, hamsym.integrate, hamsym.solve_many])
def test_start_and_span_of_scipy_are_answered(function) -> None:
    with pytest.raises(KeywordError, match="initial state as the second argument, z0"):
        function(OSCILLATOR, y0=[1.0, 0.0], t_span=(0, 1))
    with pytest.raises(KeywordError, match="the third argument, the pair span"):
        function(OSCILLATOR, [1.0, 0.0], t_span=(0, 1))


def test_keywords_of_a_hamiltonian_are_answered() -> None:
    with pytest.raises(KeywordError, match=r"'args' is not an argument of Hamiltonian; .*m=1.0"):
        Hamiltonian(OSCILLATOR, args={"k": 1.0})
    with pytest.raises(KeywordError, match="did you mean 'forces'"):
        Hamiltonian(OSCILLATOR, force={"p": "-p"})


@pytest.mark.parametrize(
    ("call", "answer"),
    [
        (
            lambda: hamsym.solve(OSCILLATOR, [1.0, 0.0], tol=1e-3),
            "solve is called without span; give solve(H, z0, span)",
        ),
        (
            hamsym.sweep,
            "sweep is called without H, z0, span, settings, folder; give sweep(H, z0, span, "
            "settings, folder=...)",
        ),
        (hamsym.flow_map, "flow_map is called without H, z0, span; give flow_map(H, z0, span)"),
        (Hamiltonian, "Hamiltonian is called without expression; give Hamiltonian(expression)"),
    ],
)
def test_missing_arguments_are_named(call, answer: str) -> None:
    with pytest.raises(KeywordError) as caught:
        call()
    assert str(caught.value) == answer


@pytest.mark.parametrize("method", ["plot", "summary", "to_dataframe"])
def test_methods_of_results_answer_keywords(method: str) -> None:
    found = hamsym.section(*START, "x = 0")
    with pytest.raises(KeywordError, match=f"'zzz' is not an argument of {method}; it has"):
        getattr(found, method)(zzz=1)


def test_keywords_of_figures_are_answered() -> None:
    solution = hamsym.solve(*START)
    answer = r"of plot \(did you mean 'certificate'\?\); it has ax, certificate"
    for draw in (solution.plot, lambda **given: hamsym.plot(solution, **given)):
        with pytest.raises(KeywordError, match=answer):
            draw(certificat=None)


def test_checked_functions_keep_signature_and_pickle() -> None:
    assert list(inspect.signature(hamsym.integrate).parameters)[:4] == ["H", "z0", "span", "method"]
    assert pickle.loads(pickle.dumps(hamsym.integrate)) is hamsym.integrate


def test_step_size_warning_is_that_of_the_caller() -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        hamsym.integrate(OSCILLATOR, [1.0, 0.0], (0, 40), "symplectic_euler", dt=0.5)
    assert [one.filename for one in caught] == [__file__]


@pytest.mark.parametrize(
    ("make", "error", "answer"),
    [
        (lambda: hamsym.integrate(*START, "yoshida_4"), InputError, "did you mean 'yoshida4'"),
        (lambda: hamsym.solve(*START, method="featurs"), InputError, "did you mean 'features'"),
        (lambda: hamsym.solve(*START, method="gauss6"), InputError, "a method of integrate"),
        (
            lambda: hamsym.solve(OSCILLATOR, {"X": 1, "p": 0}, (0, 1)),
            InputError,
            "did you mean 'x'",
        ),
        (lambda: Hamiltonian(OSCILLATOR).source("nunpy"), InputError, "did you mean 'numpy'"),
        (lambda: Hamiltonian(OSCILLATOR).source("numpy", "los"), InputError, "mean 'loss'"),
        (lambda: Hamiltonian("p**2/2 + sine(x)"), ParseError, "did you mean 'sin'"),
        (
            lambda: Hamiltonian("p**2/2 + mass*x**2", parameters={"mas": 1}),
            InputError,
            "did you mean 'mass'",
        ),
        (
            lambda: hamsym.solve(*START, method=hamsym.Adam(activation="tan")),
            InputError,
            "did you mean 'tanh'",
        ),
    ],
)
def test_unknown_names_get_a_similar_one(make, error: type[Exception], answer: str) -> None:
    with pytest.raises(error, match=answer):
        make()


def test_unknown_attributes_get_a_similar_one() -> None:
    solution = hamsym.solve(*START)
    trajectory = hamsym.integrate(*START, steps=10)
    for thing, name, answer in [
        (hamsym, "slove", "module 'hamsym' has no attribute 'slove' (did you mean 'solve'?)"),
        (hamsym.systems, "keppler", "did you mean 'kepler'"),
        (solution, "y", "call it, solution(t)"),
        (solution, "sucess", "'Solution' object has no attribute 'sucess' (did you mean 'succes"),
        (trajectory, "y", "the states are z"),
        (trajectory, "nfev", "the number is evaluations"),
        (solution.H, "hessan", "did you mean 'hessian'"),
        (hamsym.systems.kepler(), "h", "did you mean 'H'"),
    ]:
        with pytest.raises(AttributeError) as caught:
            getattr(thing, name)
        assert answer in str(caught.value)
        assert not hasattr(thing, name)


def test_errors_of_properties_keep_their_message() -> None:
    found = hamsym.equilibria("p**2/2 + k*x**2/2")
    with pytest.raises(AttributeError, match="the stability is unknown"):
        _ = found[0].frequencies


def test_results_with_suggestions_are_copied_and_pickled() -> None:
    solution = hamsym.solve(*START)
    for again in (copy.deepcopy(solution), pickle.loads(pickle.dumps(solution))):
        np.testing.assert_array_equal(again(0.5), solution(0.5))


def test_backends_that_compile_are_suggested_for_compiling() -> None:
    H = Hamiltonian(OSCILLATOR)
    with pytest.raises(InputError) as caught:
        H.compile("juli")
    assert "julia" not in str(caught.value)
    with pytest.raises(InputError, match="did you mean 'julia'"):
        H.source("juli")


@pytest.mark.parametrize(
    "function", [hamsym.animate, hamsym.export, hamsym.load, hamsym.report, hamsym.save]
)
def test_keywords_of_files_are_answered(function) -> None:
    with pytest.raises(KeywordError, match=f"'pth' is not an argument of {function.__name__}"):
        function(pth="a")
