"""Representations in notebooks: complete, escaped, bounded, and of failed results too."""

from __future__ import annotations

import copy
import dataclasses
import functools
import inspect
import math
import re
import subprocess
import sys
import warnings
from collections.abc import Callable
from fractions import Fraction
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest
import sympy

import hamsym
from hamsym import Hamiltonian
from hamsym.facts.describe import described
from hamsym.facts.proofs import ball_text
from hamsym.solving.methods import METHODS
from hamsym.workbench.notebooks.representation import representation

HENON = Hamiltonian(
    "(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2 + lam*(x**2*y - y**3/3)", parameters={"lam": 1.0}
)
START = [0.0, 0.1, 0.3, 0.0]
OSCILLATOR = Hamiltonian("p**2/2 + k*x**2/2", parameters={"k": 1.0})
FALLING = Hamiltonian("p**2/2 - x**4/4")
DUFFING = "p**2/2 - x**2/2 + x**4/4"


def _loops() -> hamsym.Connections:
    found = hamsym.equilibria(DUFFING)[2].manifolds()
    return hamsym.connections(found.unstable, found.stable, "p = 0")


SI = Hamiltonian(
    "p**2/(2*m) + m*w**2*x**2/2",
    parameters={"m": 9.1e-31, "w": 1e9},
    units={"x": "m", "p": "kg*m/s", "m": "kg", "w": "rad/s"},
)


@functools.cache
def solution() -> hamsym.Solution:
    return hamsym.solve(OSCILLATOR, [1, 0], (0, 5))


@functools.cache
def flow() -> hamsym.FlowMap:
    return hamsym.flow_map("p**2/2 + x**2/2", {"x": (1, 2), "p": (-1, 1)}, (0, 1), tol=1e-6)


@functools.cache
def orbit() -> hamsym.PeriodicOrbit:
    return hamsym.periodic_orbit("p**2/2 + x**2/2 + x**4/4", [1.0, 0.0])


def fitted() -> hamsym.Fit:
    t = np.linspace(0, 5, 40)
    noise = 0.01 * np.random.default_rng(0).normal(size=40)
    free, start = {"k": 3.8}, {"x": 1, "p": 0}
    data = {"x": np.cos(2 * t) + noise}
    return hamsym.fit(OSCILLATOR, t, data, free=free, z0=start, sigma=0.01, span=(0, 5))


MADE: dict[str, tuple[Callable[[], Any], list[str]]] = {
    "Hamiltonian": (
        lambda: HENON,
        ["2 degrees of freedom, separable, energy cons", "lam = 1"],
    ),
    "Hamiltonian in SI": (lambda: SI, ["m = 9.1e-31 kg", "p in kg*m/s"]),
    "Formulas": (lambda: HENON.equations, ["Equations of motion", "<math"]),
    "Equations": (lambda: HENON.real_equations, ["<math"]),
    "System": (lambda: HENON.compile("numpy"), ["generated functions for numpy", "vector_field"]),
    "Solution": (solution, ["converged", "largest estimated error", "tol 1.0e-09 met", "<img"]),
    "Solution that failed": (
        lambda: hamsym.solve(FALLING, [1, 0], (0, 10)),
        ["failed", "largest estimated error", "stopped at t = 1.85"],
    ),
    "Solution in SI": (
        lambda: hamsym.solve(SI, [1e-9, 0], (0, 1e-8)),
        ["kg*m/s", "parameters", "w = 1000000000.0 rad/s"],
    ),
    "Solution by training": (
        lambda: hamsym.solve(OSCILLATOR, [1, 0], (0, 1), method=hamsym.Adam(epochs=5, points=5)),
        ["failed", "largest estimated error"],
    ),
    "Solutions": (
        lambda: hamsym.solve_many(OSCILLATOR, [[1.0, 0.0], [2.0, 0.0]], (0, 5)),
        ["all 2 trajectories converged", "largest estimated error"],
    ),
    "Solutions that failed": (
        lambda: hamsym.solve_many(FALLING, [[1.0, 0.0], [0.01, 0.0]], (0, 10)),
        ["1 of 2 trajectories failed", "failed member", "stopped at t"],
    ),
    "Trajectory": (
        lambda: hamsym.integrate(OSCILLATOR, [1, 0], (0, 5), tol=1e-9),
        ["largest estimated error", "% of tol 1.0e-09", "<img"],
    ),
    "Trajectory that failed": (
        lambda: hamsym.integrate(FALLING, [1, 0], (0, 10), tol=1e-9),
        ["✗", "the error is not known"],
    ),
    "Trajectory of many": (
        lambda: hamsym.integrate(
            OSCILLATOR, [1, 0], (0, 5), "gauss4", steps=50, parameters={"k": [1.0, 4.0]}
        ),
        ["no error estimate, give tol for one", "1 to 4"],
    ),
    "Comparison": (
        lambda: hamsym.compare(solution(), "gauss4", points=20),
        ["was estimated", "gauss4"],
    ),
    "Sweep": (
        lambda: hamsym.Sweep((0,), (0.0, 5.0), {"a": (solution(),)}),
        ["1 of 1"],
    ),
    "Certificate": (lambda: solution().certify(), ["proven", "at most", "Here z is the exact"]),
    "Proofs": (
        lambda: hamsym.solve_many(OSCILLATOR, [[1.0, 0.0]], (0, 5)).certify(bound=1e-30),
        ["not all proven", "0 of 1 members"],
    ),
    "Enclosure": (
        lambda: hamsym.enclose(OSCILLATOR, ["1 +- 1e-6", 0], (0, 2), parameters={"k": (0.9, 1.1)}),
        ["proven", "1 +- 1.01e-06"],
    ),
    "FlowMap": (flow, ["converged", "x from 1.0 to 2.0", "<img"]),
    "BoxCertificate": (
        lambda: flow().certify({"x": (1.5, 1.6), "p": (0.0, 0.1)}),
        ["proven", "x from 1.5 to 1.6"],
    ),
    "Fit": (fitted, ["degrees of freedom", "95 % interval"]),
    "LyapunovExponents": (
        lambda: hamsym.lyapunov(OSCILLATOR, [1, 0], (0, 50), count=2),
        ["largest exponent", "After a time of 50", "<img"],
    ),
    "LyapunovMap": (
        lambda: hamsym.lyapunov(OSCILLATOR, [[1.0, 0.0], [2.0, 0.0]], (0, 50)),
        ["2 of 2 trajectories reached", "largest exponents run from"],
    ),
    "ChaosIndicators": (
        lambda: hamsym.chaos_indicators(OSCILLATOR, [1, 0], (0, 50)),
        ["mean MEGNO", "SALI"],
    ),
    "Section": (
        lambda: hamsym.section(OSCILLATOR, [0, 1], (0, 50), "x = 0, p > 0"),
        ["7 crossings of x = 0, p &gt; 0"],
    ),
    "SectionCertificate": (
        lambda: hamsym.section(OSCILLATOR, [0, 1], (0, 9), "x = 0, p > 0", prove=True).certificate,
        ["proven", "the exact solution of the start crosses"],
    ),
    "Frequencies": (
        lambda: hamsym.solve(OSCILLATOR, [0, 1], (0, 60)).frequencies(),
        ["frequency", "amplitude"],
    ),
    "NormalForm": (
        lambda: hamsym.equilibria("p**2/2 - cos(x)")[0].normal_form(4),
        ["Dirichlet", "I_1**2"],
    ),
    "Manifolds": (lambda: hamsym.equilibria(DUFFING)[2].manifolds(), ["grown", "unstable"]),
    "Manifold": (lambda: hamsym.equilibria(DUFFING)[2].manifolds().stable, ["exponents", "length"]),
    "Connections": (lambda: _loops(), ["2 connections", "mismatch"]),
    "Connection": (lambda: _loops()[0], ["both parts meet", "transversality"]),
    "Transformation": (
        lambda: Hamiltonian("p**2/2 + x**2/2").transformed({"x": "X/2"}),
        ["the same motion", "<math"],
    ),
    "Regularization": (
        lambda: Hamiltonian("(p_x**2+p_y**2)/2 - 1/sqrt(x**2+y**2)").regularized("levi-civita"),
        ["another time", "<math"],
    ),
    "Equilibria": (lambda: HENON.equilibria(), ["4 equilibria", "centre"]),
    "Equilibrium": (lambda: HENON.equilibria()[0], ["centre"]),
    "Invariant": (
        lambda: Hamiltonian("(p_x**2 + p_y**2)/2 + (x**2 + y**2)**2").invariants()[0],
        ["of degree 2", "<math"],
    ),
    "Invariants": (
        lambda: Hamiltonian("(p_x**2 + p_y**2)/2 + (x**2 + y**2)**2").invariants(),
        ["<math", "beyond degree 2"],
    ),
    "PeriodicOrbit": (orbit, ["converged", "period"]),
    "OrbitFamily": (lambda: orbit().family(energy=0.8), ["orbits", "energy", "0.75 to 0.8"]),
    "OrbitCertificate": (lambda: orbit().certify(), ["proven", "a periodic orbit exists"]),
}


class Tags(HTMLParser):
    """The tags of a page; an error unless each that is opened is closed in order."""

    _VOID = frozenset({"img", "br", "meta"})

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: set[str] = set()
        self.links: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.add(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href")]
        if tag not in self._VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def tags_of(text: str) -> Tags:
    found = Tags()
    found.feed(text)
    found.close()
    assert not found.open
    return found


@pytest.mark.slow_cases(
    "LyapunovMap",
    "Section",
    "ChaosIndicators",
    "Fit",
    "Trajectory",
    "FlowMap",
    "Solution",
    "Solutions",
    "Solution that failed",
    "Solutions that failed",
    "Trajectory that failed",
    "Solution by training",
    "LyapunovExponents",
    "OrbitFamily",
    "Trajectory of many",
    "Solution in SI",
    "Comparison",
    "BoxCertificate",
    "PeriodicOrbit",
)
@pytest.mark.parametrize("name", MADE)
def test_representations_say_what_is_asked_first(name: str) -> None:
    make, texts = MADE[name]
    result = make()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        text = result._repr_html_()
    assert not text.startswith("<pre>")
    for part in texts:
        assert part in text, part
    tags = tags_of(text)
    assert "script" not in tags.seen
    assert all(link.startswith("data:image/png;base64,") for link in tags.links)
    assert len(text) < 60_000
    # Plain text: at most a few lines, which begin with the type.
    if name not in ("Formulas", "Invariants"):  # which are lists
        assert re.match(type(result).__name__, repr(result))
        assert len(repr(result)) < 500


def test_every_result_has_a_card() -> None:
    classes = [getattr(hamsym, name) for name in hamsym.__all__]
    results = {kind for kind in classes if inspect.isclass(kind) and "Error" not in kind.__name__}
    without = {hamsym.Animation, hamsym.Ball, hamsym.Facts, hamsym.Regularizer, *METHODS.values()}
    missing = [kind for kind in results - without if not hasattr(kind, "_repr_html_")]
    assert not missing
    made = {name.split(" ")[0] for name in MADE}
    assert {kind.__name__ for kind in results - without} <= made


def test_every_description_belongs_to_a_result() -> None:
    made = {name.split(" ")[0] for name in MADE}
    assert made == described().keys()


HOSTILE = "<script>alert('1')</script> & <img src=http://x onerror=y> \"'$x$"


@pytest.mark.slow
def test_hostile_texts_are_escaped() -> None:
    plain = solution()
    for result in (
        plain.judged(False, HOSTILE),
        dataclasses.replace(hamsym.section(OSCILLATOR, [0, 1], (0, 9), "x = 0"), surface=HOSTILE),
        dataclasses.replace(hamsym.lyapunov(OSCILLATOR, [1, 0], (0, 9)), message=HOSTILE),
        hamsym.Sweep((0,), (0.0, 5.0), {HOSTILE: (plain,)}),
        dataclasses.replace(
            hamsym.integrate(OSCILLATOR, [1, 0], (0, 1), tol=1e-6), message=HOSTILE
        ),
        type("Unknown", (), {"__repr__": lambda self: HOSTILE})(),
    ):
        text = representation(result)
        tags = tags_of(text)
        assert "script" not in tags.seen
        assert all(link.startswith("data:") for link in tags.links)
        assert "&lt;script&gt;" in text


def test_names_that_mathml_would_not_escape_are_text() -> None:
    x, p = sympy.symbols("x p")
    named = sympy.Symbol("<b>k</b>")
    found = hamsym.Invariant(p**2 + named * x**2, 2)
    text = representation(found)
    assert "<math" not in text
    assert "&lt;b&gt;" in text


def test_nothing_that_is_broken_raises() -> None:
    class Broken:
        def __repr__(self) -> str:
            raise RuntimeError("no text")

    assert representation(Broken()) == "<pre>Broken</pre>"
    empty = copy.copy(solution())
    object.__setattr__(empty, "record", None)
    assert representation(empty).startswith("<pre>Solution(")


@pytest.mark.slow
def test_numbers_that_are_not_finite_are_shown() -> None:
    found = hamsym.lyapunov(OSCILLATOR, [1, 0], (0, 9))
    lost = dataclasses.replace(found, exponents=np.full_like(found.exponents, np.nan))
    assert "largest exponent is nan" in representation(lost)
    trajectory = hamsym.integrate(OSCILLATOR, [1, 0], (0, 1), "gauss4", steps=4)
    lost = dataclasses.replace(trajectory, drift=math.inf, success=False)
    assert "it is not finite" in representation(lost)


def test_large_results_have_no_figure(monkeypatch: pytest.MonkeyPatch) -> None:
    result = solution()
    monkeypatch.setattr("hamsym.workbench.notebooks.representation._MOST_DRAWN", 1_000)
    assert "<img" not in representation(result)


def test_a_figure_that_fails_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    result = solution()

    def fail(*_: Any) -> None:
        raise ValueError("nothing to draw")

    monkeypatch.setattr(hamsym.Solution, "plot", fail)
    assert "converged" in representation(result)
    assert "<img" not in representation(result)


@pytest.mark.slow
def test_many_components_are_counted_not_drawn_out() -> None:
    names = [f"x_{k}" for k in range(1, 31)]
    H = Hamiltonian(" + ".join(f"p_{n}**2/2 + {n}**2/2" for n in names))
    text = representation(H)
    assert "30 degrees of freedom" in text
    assert "... and 49 equations" in text
    assert "and 18 more" in text
    trajectory = hamsym.integrate(H, np.ones(60), (0, 0.1), "dop853", steps=4)
    assert "... and 50 components" in representation(trajectory)


@pytest.mark.slow
def test_huge_formulas_are_not_derived(monkeypatch: pytest.MonkeyPatch) -> None:
    x, y, p_x, p_y = sympy.symbols("x y p_x p_y")
    terms = [sympy.sin(k * x) * sympy.cos(k * y) * sympy.exp(-(x**2) / k) for k in range(1, 300)]
    H = Hamiltonian((p_x**2 + p_y**2) / 2 + sympy.Add(*terms))
    monkeypatch.setattr(Hamiltonian, "equations", property(lambda self: pytest.fail("derived")))
    text = representation(H)
    assert "2 degrees of freedom, energy conserved" in text
    assert len(text) < 10_000


@pytest.mark.parametrize(
    ("mid", "radius"),
    [(1 / 3, 1e-9), (6.1388024332458153, 7.56e-16), (1e-24, 1e-26), (-2.5, 0.7), (0.0, 1e-300),
     (1.0, 0.0), (-6.7e-18, 2.77e-17), (1e300, 1e290)],
)  # fmt: skip
def test_balls_as_written_contain_the_ball(mid: float, radius: float) -> None:
    middle, _, width = ball_text(mid, radius).partition(" +- ")
    written = Fraction(middle)
    reach = Fraction(width or "0")
    assert written - reach <= Fraction(mid) - Fraction(radius)
    assert written + reach >= Fraction(mid) + Fraction(radius)
    assert reach <= 2 * Fraction(radius)


def test_bounds_are_written_as_they_are_proven() -> None:
    above, below = 2.68374571e-12, 1.00000001e-12  # decimals of nine digits, as certify has them
    certificate = hamsym.Certificate(
        bound=above,
        lower=below,
        component_bounds=(above,),
        component_lowers=(below,),
        energy_bound=above,
        energy_lower=below,
        ell_max_bound=math.inf,
        ell_max_lower=0.0,
        edges=(0.0, 1.0),
        piece_bounds=(above,),
        rtol=0.02,
        digest="0" * 64,
        seconds=1.0,
        components=("x",),
    )
    facts = certificate.facts
    found = re.search(r"at most (\S+) \(2-norm\)", facts.headline)
    assert found is not None
    low, high = facts.tables[0].cells().rows[0][1:]
    assert found[1] == high == "2.68374571e-12"
    assert low == "1.00000001e-12"


def test_bounds_over_a_box_are_rounded_outward() -> None:
    proven = dataclasses.replace(
        flow().certify({"x": (1.5, 1.6), "p": (0.0, 0.1)}), bound=(math.nextafter(1e-12, 1), 1e-9)
    )
    for (_, text), bound in zip(proven.facts.tables[0].cells().rows, proven.bound, strict=True):
        assert bound <= Fraction(text) <= 1.0000001 * bound


def test_formulas_have_latex_too() -> None:
    assert HENON._repr_latex_().startswith(r"$\displaystyle H(x, y, p_{x}, p_{y}) =")
    assert r"\begin{aligned}\frac{d x}{d t} &= p_{x} \\ " in HENON.equations._repr_latex_()
    assert r"\dot{x} &= p_{x}" in HENON.real_equations._repr_latex_()
    found = Hamiltonian("(p_x**2 + p_y**2)/2 + (x**2 + y**2)**2").invariants()[0]
    assert found._repr_latex_() == r"$\displaystyle p_{x} y - p_{y} x$"


@pytest.mark.slow
def test_a_formula_is_shown_without_loading_solvers() -> None:
    script = (
        "import sys, hamsym\n"
        "hamsym.Hamiltonian('p**2/2 + x**2/2')._repr_html_()\n"
        "print(*(name for name in ('torch', 'numba', 'hamsym.plotting') if name in sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == ""


def test_errors_of_the_user_have_no_internal_frames() -> None:
    try:
        hamsym.solve(OSCILLATOR, [1.0], (0, 3))
    except hamsym.InputError as error:
        lines = "".join(error._render_traceback_())
    assert "test_notebook.py" in lines
    assert "suggestions.py" not in lines
    assert lines.rstrip().endswith("z0 has shape (1,); give the 2 numbers x, p")
