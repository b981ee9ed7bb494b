"""Random Hamiltonians: an independent integrator confirms every success of solve."""

from __future__ import annotations

import random
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
import scipy.integrate
import sympy

import hamsym

from .taylor import Equations, StoppedError, formula, integrate

_CASES, _CHUNK = 300, 25
_FAST = (0, 1, 2, 4, 5, 7)  # each takes half a second
_TIMES = 40
_UNJUDGED = "not judged"
_CLOSE = 0.2  # of the allowed error: above it float64 is not accurate enough to decide
_DIGITS = {"order": 24, "bits": 96, "digits": 20.0, "most": 4_000}


@dataclass(frozen=True)
class Case:
    """Random H in random units: H = action/time h(q/lengths, p lengths/action, t/time)."""

    text: str
    plain: str
    q: tuple[str, ...]
    p: tuple[str, ...]
    z0: tuple[float, ...]
    span: tuple[float, float]
    tol: float
    units: tuple[float, ...]
    time: float
    focus: tuple[tuple[str, float], ...]


def case(seed: int) -> Case:
    """Make the case of a seed; it must not change between versions."""
    r = random.Random(f"hamsym {seed}")
    dof = r.choice((1, 1, 2, 2, 3))
    q, p = [f"q{k + 1}" for k in range(dof)], [f"p{k + 1}" for k in range(dof)]

    def number(low: float, high: float) -> str:
        return f"{r.uniform(low, high):.3g}"

    terms, narrow = [], []
    for x, y in zip(q, p, strict=True):
        terms.append(
            r.choice(
                (
                    f"{y}**2/2",
                    f"{y}**2/2",
                    f"{y}**2/{number(0.5, 4)}",
                    f"{y}**2/(2+{number(0, 1)}*{x}**2)",
                    f"sqrt(1+{y}**2)",
                    f"({y}-{number(0, 1)}*{r.choice(q)})**2/2",
                )
            )
        )
        # A confining term, so that most motions are bounded.
        terms.append(
            r.choice(
                (
                    f"{number(0.2, 4)}*{x}**2/2",
                    f"{number(0.2, 4)}*{x}**2/2",
                    f"{number(0.2, 2)}*{x}**4/4",
                    f"{number(0.2, 2)}*({x}**2-1)**2/4",
                    f"-{number(0.5, 2)}*cos({x})",
                    f"{number(0.5, 2)}*sqrt({number(0.1, 2)}+{x}**2)",
                    f"{number(0.2, 1)}*({x}**2+{x}**6/6)",
                )
            )
        )
    for _ in range(r.randrange(4)):
        x, y = r.choice(q), r.choice(q)
        c, a = number(-0.5, 0.5), number(0.5, 3)
        terms.append(
            r.choice(
                (
                    f"({c})*{x}*{y}",
                    f"({c})*{x}**2*{y}/4",
                    f"({c})*sin({a}*{x}+{number(-1, 1)}*{y})",
                    f"({c})*cos({a}*{x}-{y})",
                    f"({c})*exp(-{a}*{x}**2)",
                    f"({c})*exp(-{a}*({x}-{y})**2-{y}**2)",
                    f"({c})*tanh({a}*{x})",
                    f"({c})*tanh({number(10, 60)}*({x}-{number(-1, 1)}))/4",
                    f"({c})/(1+{a}*{x}**2)",
                    f"({c})/({number(0.02, 0.3)}+({x}-{y})**2+{x}**2)/8",
                    f"({c})*sqrt(1+{a}*({x}-{y})**2)",
                    f"({c})*{x}**2*{y}**2",
                )
            )
        )
    length = 10.0 ** r.uniform(0, 1.7)
    start = r.choice((0.0, 0.0, 0.0, r.uniform(-5, 5)))
    if r.random() < 0.3:
        x, c = r.choice(q), number(-0.5, 0.5)
        kind = r.randrange(4)
        if kind == 3:
            when = f"{start + r.uniform(0.1, 0.9) * length:.4f}"
            width = 10.0 ** r.uniform(-3, 0)
            terms.append(f"({c})*{x}*exp(-((t-({when}))/{width:.3g})**2)")
            narrow.append((f"t-({when})", width))
        else:
            terms.append(
                (
                    f"({c})*{x}*cos({number(0.3, 3)}*t)",
                    f"({c})*sin({number(0.3, 3)}*t)*{x}**2/2",
                    f"({c})*{x}*tanh({number(0.3, 3)}*t)",
                )[kind]
            )
    if r.random() < 0.15:
        x, c, at = r.choice(q), number(-0.5, 0.5), number(-0.8, 0.8)
        steep = 10.0 ** r.uniform(1.5, 3.5)
        shape = r.choice(("tanh({})", "exp(-({})**2)", "erf({})"))
        terms.append(f"({c})*" + shape.format(f"{steep:.4g}*({x}-({at}))") + "/8")
        narrow.append((f"{x}-({at})", 1 / steep))
    plain = "+".join(terms).replace("+-", "-")
    z0 = [r.uniform(-1.5, 1.5) for _ in range(2 * dof)]
    if r.random() < 0.15:
        z0[r.randrange(2 * dof)] = 0.0
    end = start + length
    span = (end, start) if r.random() < 0.2 else (start, end)
    tol = r.choice((1e-4, 1e-8, 1e-11))

    powers = [r.randint(-6, 6) if r.random() < 0.5 else 0 for _ in range(dof + 2)]
    lengths, action, unit = powers[:dof], powers[dof], powers[dof + 1]
    exponents = {
        **dict(zip(q, lengths, strict=True)),
        **{y: action - k for y, k in zip(p, lengths, strict=True)},
        "t": unit,
    }
    # No name contains another one: q1 is not part of q2.
    marked = plain
    for name, exponent in exponents.items():
        if exponent:
            marked = _replaced(marked, name, f"({name}*1e{-exponent})")
    text = f"1e{action - unit}*({marked})" if action != unit else marked
    focus = []
    for scaled, width in narrow:
        for name, exponent in exponents.items():
            scaled = _replaced(scaled, name, f"({name}*1e{-exponent})")
        focus.append((scaled, width))
    units = tuple(10.0 ** exponents[name] for name in (*q, *p))
    return Case(
        text,
        plain,
        tuple(q),
        tuple(p),
        tuple(value * u for value, u in zip(z0, units, strict=True)),
        (span[0] * 10.0**unit, span[1] * 10.0**unit),
        tol,
        units,
        10.0**unit,
        tuple(focus),
    )


def _replaced(text: str, name: str, new: str) -> str:
    return re.sub(rf"\b{name}\b", new, text)


def verdict(seed: int) -> tuple[bool, str]:
    """Whether solve succeeded, and a description of a defect or ""."""
    one = case(seed)
    shown = f"seed {seed}, tol {one.tol:.0e}, {one.text}, {one.z0}, {one.span}: "
    names = (*one.q, *one.p)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            H = hamsym.Hamiltonian(one.text)
            start = dict(zip(names, one.z0, strict=True))
            solution = hamsym.solve(H, start, one.span, tol=one.tol, progress=False)
    except hamsym.InputError as error:
        return False, "" if "t = " in str(error) else f"{shown}refused without a time: {error}"
    except Exception as error:
        return False, f"{shown}raised {type(error).__name__}: {error}"
    if not solution.success:
        said = "t = " in solution.message
        return False, "" if said else f"{shown}refused without a time: {solution.message}"
    columns = [[str(name) for name in H.z].index(name) for name in names]
    times = one.span[0] + (one.span[1] - one.span[0]) * np.linspace(0, 1, _TIMES) ** 0.8
    times[-1] = one.span[1]
    found = solution(times)[:, columns]
    # At smaller tolerances float64 is not accurate enough.
    if one.tol > 1e-10 and not one.focus and _ratio(found, *_rough(one, times), one) <= _CLOSE:
        return True, ""
    try:
        truth = _ratio(found, *_exact(one, times), one)
    except StoppedError as error:
        return True, f"{shown}{_UNJUDGED}: {error}"
    return True, "" if truth <= 1 else f"{shown}{truth:.3g} of the allowed error"


def _ratio(found: np.ndarray, states: np.ndarray, scales: np.ndarray, one: Case) -> float:
    halves = np.repeat(scales.reshape(2, -1).max(axis=1), len(one.q))
    allowed = one.tol * np.where(scales > 0, scales, 1e-8 * halves)
    ratio = float((np.abs(found - states) / allowed).max())
    return ratio if ratio == ratio else np.inf


def _rough(one: Case, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """States and scales by DOP853, in the units of the plain formula."""
    symbols = [sympy.Symbol(name, real=True) for name in (*one.q, *one.p)]
    H, dof = formula(one.plain, [*one.q, *one.p, "t"]), len(one.q)
    gradient = [H.diff(s) for s in symbols]
    rates = sympy.lambdify(
        [sympy.Symbol("t", real=True), *symbols],
        [*gradient[dof:], *(-g for g in gradient[:dof])],
        modules="numpy",
        cse=True,
    )
    units = np.array(one.units)
    result = scipy.integrate.solve_ivp(
        lambda t, z: rates(t, *z),
        np.array(one.span) / one.time,
        np.array(one.z0) / units,
        method="DOP853",
        t_eval=np.clip(times / one.time, *sorted(np.array(one.span) / one.time)),
        rtol=1e-13,
        atol=1e-15,
    )
    if not result.success:
        return np.full((len(times), 2 * dof), np.nan), np.ones(2 * dof)
    states = result.y.T * units
    return states, np.abs(states).max(axis=0)


def _exact(one: Case, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """States and scales by Taylor series in 96 bits."""
    equations = Equations(one.text, one.q, one.p, focus=one.focus)
    orbit = integrate(equations, one.z0, one.span[0], [float(t) for t in times], **_DIGITS)
    states = np.array([[float(value) for value in row] for row in orbit.states])
    return states, np.array(orbit.scales)


@pytest.mark.parametrize(
    "seeds",
    [
        pytest.param(_FAST, id="fast"),
        *(
            pytest.param(range(k, k + _CHUNK), id=f"from_{k}", marks=pytest.mark.slow)
            for k in range(0, _CASES, _CHUNK)
        ),
    ],
)
def test_successes_are_confirmed(seeds: Sequence[int]) -> None:
    verdicts = [verdict(seed) for seed in seeds]
    complaints = [wrong for _, wrong in verdicts if wrong]
    assert [wrong for wrong in complaints if _UNJUDGED not in wrong] == []
    # The Taylor integrator gives up on motions that accelerate without bound.
    assert len(complaints) <= 1, complaints
    # A solver that always refuses would pass the test above.
    assert sum(success for success, _ in verdicts) > 0.6 * len(seeds)


def test_cases_do_not_change() -> None:
    one = case(7)
    assert one == case(7)
    assert len({case(seed).text for seed in range(50)}) == 50
