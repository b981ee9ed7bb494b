"""Certificates hold for what was computed, follow what is damaged, and cannot be edited."""

import copy
import dataclasses
import json
import math
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction

import mpmath
import numpy as np
import pytest
import sympy
import torch
from flint import arb

import hamsym
from hamsym import systems
from hamsym.certificates import Certificate, verify
from hamsym.enclosures import Enclosures
from hamsym.errors import CertificationError, FileError, InputError
from hamsym.rounding import above, exact, working
from hamsym.trial_enclosures import segments
from hamsym.validated import Deadline, validated_reference

_OPTIONS = {
    "features": {"tol": 1e-9},
    "fine features": {"tol": 1e-12},
    "levenberg-marquardt": {
        "method": "levenberg-marquardt",
        "hidden": (20, 20),
        "points": 60,
        "target_error": 1e-5,
    },
    "tanh": {"method": "adam", "epochs": 30, "hidden": (8, 8), "activation": "tanh"},
    "sigmoid": {"method": "adam", "epochs": 30, "hidden": (8,), "activation": "sigmoid"},
    "linear": {"method": "adam", "epochs": 30, "hidden": (8, 8), "envelope": "linear"},
    "apart": {"method": "adam", "epochs": 30, "hidden": (8,), "shared_weights": False},
    "float32": {"method": "adam", "epochs": 30, "hidden": (8,), "dtype": "float32"},
}


def solved(name, problem=None, span=None):
    problem = problem or systems.nonlinear_oscillator()
    return hamsym.solve(problem.H, problem.z0, span or (0.0, 4.0), **_OPTIONS[name])


def true_errors(solution, times):
    """z^ - z to thirty digits: z by a second reference, z^ by its formula in mpmath."""
    z0 = np.asarray(solution.z0, dtype=float)
    units = [(0.0, [1.0] * len(z0))]
    found = validated_reference(
        Enclosures(solution.H), z0, solution.span, units, 160, Deadline.after(None)
    )
    errors = []
    for t in times:
        truth = [_number(exact(value)) for value in found(float(t))]
        errors.append([a - b for a, b in zip(formula(solution, float(t)), truth, strict=True)])
    return errors


def _number(fraction):
    return mpmath.mpf(fraction.numerator) / fraction.denominator


def formula(solution, t):
    """z^(t) as its documentation defines it, in mpmath."""
    trial = solution.trial
    if hasattr(trial, "edges"):
        edges = trial.edges.tolist()
        sign = 1 if edges[-1] > edges[0] else -1
        k = int(
            np.clip(
                np.searchsorted(sign * np.array(edges), sign * t, "right") - 1, 0, len(edges) - 2
            )
        )
        s = (mpmath.mpf(t) - edges[k]) / (mpmath.mpf(edges[k + 1]) - edges[k])
        series = trial.series.tolist()
        polynomials = [mpmath.chebyt(degree, 2 * s - 1) for degree in range(len(series))]
        columns = [
            mpmath.fdot(polynomials, [row[m] for row in series]) for m in range(len(series[0]))
        ]
        return [
            state + (1 - mpmath.exp(-s)) * mpmath.fdot(columns, readout)
            for state, readout in zip(
                trial.states[k].tolist(), trial.readouts[k].T.tolist(), strict=True
            )
        ]
    s = (mpmath.mpf(t) - trial.t0) / mpmath.mpf(trial.tau)
    f = s if trial.envelope == "linear" else 1 - mpmath.exp(-s)
    outputs = []
    for network in getattr(trial.network, "networks", [trial.network]):
        active = {
            "sin": mpmath.sin,
            "tanh": mpmath.tanh,
            "sigmoid": lambda a: 1 / (1 + mpmath.exp(-a)),
        }[network.activation]
        h = [s]
        for depth, (matrix, bias) in enumerate(network.layers):
            h = h if depth == 0 else [active(a) for a in h]
            h = [
                mpmath.fdot(row, h) + shift
                for row, shift in zip(
                    matrix.detach().double().tolist(), bias.detach().double().tolist(), strict=True
                )
            ]
        outputs += h
    return [z + f * output for z, output in zip(trial.z0.double().tolist(), outputs, strict=True)]


def assert_holds(certificate, solution, times=None, count=40):
    """The true error is below the bounds everywhere, and reaches the lower ones somewhere near."""
    generator = np.random.default_rng(0)
    times = generator.uniform(*sorted(solution.span), count) if times is None else times
    with mpmath.workdps(50):
        errors = true_errors(solution, times)
        norms = [mpmath.norm(error) for error in errors]
        for t, norm, bound in zip(times, norms, certificate.bound_at(np.array(times)), strict=True):
            assert norm <= bound <= certificate.bound, t
        for i, bound in enumerate(certificate.component_bounds):
            assert max(abs(error[i]) for error in errors) <= bound
    assert certificate.lower <= certificate.bound
    return float(max(norms))


@pytest.mark.parametrize("name", _OPTIONS)
def test_the_bound_holds_and_is_close(name):
    solution = solved(name)
    certificate = solution.certify()
    assert_holds(certificate, solution)
    assert certificate.bound <= 1.03 * certificate.lower
    assert certificate.ell_max_bound <= 1.03 * certificate.ell_max_lower
    assert certificate.energy_bound <= 1.03 * certificate.energy_lower
    if name != "fine features":  # whose residual is not far from round-off
        assert certificate.ell_max_bound == pytest.approx(solution.ell_max, rel=0.03)


def test_the_bound_is_within_five_percent_of_the_known_error():
    problem = systems.nonlinear_oscillator()
    solution = hamsym.solve(
        problem.H, problem.z0, problem.span, method="levenberg-marquardt", target_error=1e-5
    )
    times = np.linspace(*problem.span, 8001)
    error = np.linalg.norm(solution(times) - problem.exact(times), axis=1).max()
    assert error <= solution.certify().bound <= 1.05 * error


@pytest.mark.parametrize(
    ("problem", "span"),
    [
        (systems.henon_heiles(), (0.0, 3.0)),
        (systems.kepler(), (0.0, 2.0)),
        (systems.double_pendulum(), (0.0, 1.0)),
        (systems.driven_oscillator(), (1.0, -3.0)),
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_other_systems(problem, span):
    solution = solved("features", problem, span)
    assert_holds(solution.certify(), solution, count=15)


def test_units_of_any_size_do():
    H = hamsym.Hamiltonian("p**2/(2*m) + k*x**2/2", parameters={"m": 1e-27, "k": 1e-27})
    solution = hamsym.solve(H, [1.0, 0.0], (0.0, 5.0))
    certificate = solution.certify()
    t = np.linspace(0, 5, 1001)
    errors = np.abs(solution(t) - np.stack((np.cos(t), -1e-27 * np.sin(t)), -1)).max(axis=0)
    assert errors == pytest.approx(certificate.component_bounds, rel=0.05)


def damaged(solution, change):
    """A solution whose trial solution is changed by a function of its tensors."""
    other = copy.copy(solution)
    other.trial = copy.deepcopy(solution.trial)
    with torch.no_grad():
        change(other.trial)
    return other


def _one_weight(trial):
    trial.network.theta[37] += 1e-6


def _one_readout(trial):
    trial.readouts[3, 5, 1] += 1e-9


def _one_window(trial):
    trial.edges[4] += 1e-10


def _one_state(trial):
    trial.states[2, 0] *= 1 + 1e-9


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("levenberg-marquardt", _one_weight),
        ("fine features", _one_readout),
        ("fine features", _one_window),
        ("fine features", _one_state),
    ],
)
def test_the_bound_follows_damage(name, change):
    sound = solved(name)
    hurt = damaged(sound, change)
    certificate = hurt.certify()
    found = assert_holds(certificate, hurt, count=60)
    assert certificate.bound > 0.5 * found
    assert certificate.bound != sound.certify().bound
    with pytest.raises(CertificationError, match="another solution"):
        verify(certificate, sound)


def test_series_of_a_trial_solution_contain_it_anywhere_on_the_ball():

    for name in ("levenberg-marquardt", "tanh", "features"):
        solution = solved(name)
        part = segments(solution.trial, solution.span)[-1]
        centre, half = (part.start + part.end) / 2, (part.end - part.start) / 64
        with working(96, 4):
            around = part.series(centre, half, 4)
            for shift in (-1, Fraction(1, 3), 1):
                exactly = part.series(centre + shift * half, Fraction(0), 4)
                for wide, narrow in zip(around, exactly, strict=True):
                    assert all(wide[k].overlaps(narrow[k]) for k in range(4))
                    assert all(
                        above(abs(narrow[k] - wide[k].mid())) <= above(wide[k].rad()) * (1 + 1e-9)
                        for k in range(4)
                    )


# -- certificates as documents ------------------------------------------------------------------


@pytest.fixture(scope="module")
def case():
    solution = solved("levenberg-marquardt")
    return solution, solution.certify()


def test_a_certificate_survives_its_text(case, tmp_path):
    solution, certificate = case
    text = certificate.to_json()
    assert Certificate.from_json(text) == certificate
    assert Certificate.from_json(text).to_json() == text
    solution.save(tmp_path / "a.hamsym")
    verify(text, tmp_path / "a.hamsym")


def test_a_certificate_says_what_is_proven(case):
    statement = case[1].statement
    for word in ("Proven", "exact", "solves the equation once more", "weights", "bits", "Arb"):
        assert word in statement


@pytest.mark.parametrize(
    ("field", "factor"),
    [
        ("bound", 0.97),
        ("lower", 1.04),
        ("component_bounds", 0.97),
        ("component_lowers", 1.04),
        ("energy_bound", 0.97),
        ("energy_lower", 1.04),
        ("ell_max_bound", 0.97),
        ("ell_max_lower", 1.04),
        ("piece_bounds", 1e-3),
    ],
)
def test_an_edited_certificate_fails(case, field, factor):
    solution, certificate = case
    value = getattr(certificate, field)
    if isinstance(value, tuple):
        value = (*value[:-1], value[-1] * factor)
    else:
        value *= factor
    lowers = field.replace("bound", "lower")
    if (
        factor < 1 and lowers != field and hasattr(certificate, lowers)
    ):  # all of a kind, forged well
        low = getattr(certificate, lowers)
        low = tuple(0.9 * entry for entry in low) if isinstance(low, tuple) else 0.9 * low
        certificate = dataclasses.replace(certificate, **{lowers: low})
    elif factor > 1:
        uppers = field.replace("lower", "bound")
        high = getattr(certificate, uppers)
        high = tuple(1.1 * entry for entry in high) if isinstance(high, tuple) else 1.1 * high
        certificate = dataclasses.replace(certificate, **{uppers: high})
    forged = dataclasses.replace(certificate, **{field: value}).to_json()
    with pytest.raises(CertificationError, match="does not hold"):
        verify(forged, solution)
    # Without the statement that belongs to its numbers the text is no certificate at all.
    if field in ("bound", "lower"):
        values = json.loads(forged) | {"statement": case[1].statement}
        with pytest.raises(FileError, match="statement is not"):
            verify(json.dumps(values), solution)


def test_claims_that_are_no_numbers_fail(case):
    solution, certificate = case
    values = json.loads(certificate.to_json()) | {"bound": "nan"}
    with pytest.raises((CertificationError, FileError)):
        verify(json.dumps(values), solution)


@pytest.mark.parametrize(
    "change",
    [
        {"digest": "0" * 64},
        {"edges": (0.0, 3.0), "piece_bounds": (1.0,)},
        {"component_bounds": (1.0,), "component_lowers": (0.0,)},
    ],
)
def test_a_certificate_of_something_else_fails(case, change):
    solution, certificate = case
    other = dataclasses.replace(certificate, **change)
    with pytest.raises(CertificationError, match="another"):
        verify(other.to_json(), solution)


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"kind": "hamsym certificate", "version": 2}', "[" * 100_000]
)
def test_what_is_no_certificate_is_refused(case, text):
    with pytest.raises(FileError, match="not a certificate"):
        verify(text, case[0])


def test_looser_claims_are_implied(case):
    solution, certificate = case
    looser = dataclasses.replace(
        certificate, bound=2 * certificate.bound, lower=certificate.lower / 2
    )
    verify(looser.to_json(), solution)
    verify(looser, solution)


def test_bounds_outside_the_span_are_refused(case):
    certificate = case[1]
    for t in (-0.1, 4.1, math.nan):
        with pytest.raises(InputError, match="outside"):
            certificate.bound_at(t)
    assert certificate.bound_at(0.0) >= 0
    assert certificate.bound_at([0.0, 4.0]).shape == (2,)


# -- refusals -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("formula", "reason"),
    [
        ("p**2/2 - x**4/4", "beyond.* t = 1.85.*escape to infinity"),
        ("p**2/2 + abs(x)", "'abs'"),
        ("p**2/2 + x**(5/2)", r"beyond t = 1\.0.*'(sqrt\(x\)|x.*3/2.*)'.*not smooth"),
    ],
)
def test_what_cannot_be_proven_is_refused_with_the_reason(formula, reason):
    H = hamsym.Hamiltonian(formula)
    solution = hamsym.solve(H, [1.0, 0.0], (0.0, 3.0), method="adam", epochs=5, hidden=(4,))
    with pytest.raises(CertificationError, match=reason):
        solution.certify()


def test_a_time_limit_is_kept():
    with pytest.raises(CertificationError, match="time limit of 0.001 s"):
        solved("features").certify(time_limit=1e-3)


def test_too_few_bits_are_refused():
    with pytest.raises(CertificationError, match="64 bits are not enough"):
        solved("fine features").certify(bits=64)


@pytest.mark.parametrize("options", [{"rtol": 0}, {"time_limit": -1}, {"bits": 12}])
def test_settings_are_checked(options):
    with pytest.raises(InputError, match=next(iter(options))):
        solved("tanh").certify(**options)


def test_the_papers_bound_is_proven_false_for_a_resonant_residual():
    """z^ = (1 + eps t)(cos t, -sin t), as the solution of another system, marched."""
    end = 4 * math.pi
    forced = hamsym.Hamiltonian(
        "p**2/2 + x**2/2 + eps*(p*cos(t) + x*sin(t))", parameters={"eps": 1e-3}
    )
    other = hamsym.solve(forced, [1.0, 0.0], (0, end), tol=1e-10)
    H = systems.harmonic_oscillator().H
    solution = hamsym.Solution(
        H, other.z0, (0.0, end), other.trial, method="features", training=other.training
    )
    certificate = solution.certify()
    assert certificate.ell_max_bound < 1.02e-3
    # sigma_min is 1, exactly, for this Hessian.
    assert max(certificate.component_lowers) > 12 * certificate.ell_max_bound / 1.0


# -- claims that were once believed ------------------------------------------------------------


def test_nothing_is_verified_where_h_is_singular_along_the_solution():
    """z^ crosses the pole of 1/x, which z does not: energy and ell have no bound there."""
    free = hamsym.Hamiltonian("p**2/2 + 0*x", q=["x"], p=["p"])
    through = hamsym.solve(free, [0.5, -1.0], (0.0, 0.6), tol=1e-6)
    H = hamsym.Hamiltonian("p**2/2 + 1/x")
    solution = hamsym.Solution(
        H, through.z0, through.span, through.trial, method="features", training=through.training
    )
    honest = solution.certify()
    assert honest.energy_bound == honest.ell_max_bound == math.inf
    verify(honest, solution)
    for change in ({"energy_bound": 1e11}, {"ell_max_bound": 1e22}, {"energy_lower": 1e300}):
        with pytest.raises(CertificationError):
            verify(dataclasses.replace(honest, **change), solution)


def test_floats_of_sympy_are_the_numbers_that_they_are():
    """Of three digits here: differentiating would round 3 times 0.1 to three digits again."""
    x, p = sympy.symbols("x p", real=True)
    number = sympy.Float("0.1", 3)
    H = hamsym.Hamiltonian(p**2 / 2 + x**2 / 2 + number * x**3, q=[x], p=[p])
    _, mantissa, exponent, _ = number._mpf_
    exactly = sympy.Rational(int(mantissa)) * sympy.Integer(2) ** int(exponent)
    twin = hamsym.Hamiltonian(p**2 / 2 + x**2 / 2 + exactly * x**3, q=[x], p=[p])
    state, clock = [arb(1), arb(2)], arb(0)
    for name in ("energy", "vector_field"):
        mine, right = (getattr(Enclosures(h), name)(state, clock) for h in (H, twin))
        pairs = zip(mine, right, strict=True) if isinstance(mine, list) else [(mine, right)]
        assert all(abs(a - b).upper() < 1e-12 for a, b in pairs)


def test_a_jump_of_h_with_smooth_derivatives_is_refused():
    H = hamsym.Hamiltonian("p**2/2 + acot(x)")
    solution = hamsym.solve(H, [-0.5, 0.6], (0.0, 2.0), tol=1e-6)
    assert solution(2.0)[0] > 0.1
    with pytest.raises(CertificationError, match="t = "):
        solution.certify()


def test_windows_that_do_not_cover_the_span_are_refused():
    solution = solved("features")
    longer = hamsym.Solution(
        solution.H, solution.z0, (0.0, 4.01), solution.trial,
        method="features", training=solution.training,
    )  # fmt: skip
    with pytest.raises(CertificationError, match="do not cover the span"):
        longer.certify()


@pytest.mark.parametrize(
    "edit",
    [
        lambda values: values.update(statement="Proven: at most 1e-30."),
        lambda values: values.update(extra="1"),
        lambda values: values.update(lower=values["lower"] + "1"),
        lambda values: values.update(lower=values["bound"] + "1"),
        lambda values: values.update(energy_lower="1e300"),
    ],
    ids=["statement", "more", "more digits", "a last digit", "out of order"],
)
def test_texts_that_say_more_than_their_numbers_are_refused(case, edit):
    values = json.loads(case[1].to_json())
    edit(values)
    with pytest.raises(FileError):
        Certificate.from_json(json.dumps(values))


def test_a_name_twice_is_refused(case):
    text = case[1].to_json().replace("{", '{"lower": "0",', 1)
    with pytest.raises(FileError, match="occurs twice"):
        Certificate.from_json(text)


def test_threads_wait_for_each_other():
    """Precision and series length are global to the process."""
    solution = solved("features", span=(0.0, 1.0))
    alone = solution.certify()
    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(lambda _: solution.certify(), range(6)))
    assert all(certificate == alone for certificate in found)


@pytest.mark.parametrize("name", ["levenberg-marquardt", "tanh", "sigmoid", "linear", "apart"])
def test_the_bound_holds_at_a_thousand_times(name):
    """Of each piece too; the exact solution and its evaluation are good to 1e-13."""
    solution = solved(name)
    certificate = solution.certify()
    t = np.random.default_rng(0).uniform(0.0, 4.0, 1_000)
    error = np.linalg.norm(solution(t) - systems.nonlinear_oscillator().exact(t), axis=-1)
    assert certificate.lower > 1e-9
    assert np.all(error <= certificate.bound_at(t) + 1e-12)
    assert error.max() <= certificate.bound + 1e-12
    assert error.max() > 0.9 * certificate.lower
