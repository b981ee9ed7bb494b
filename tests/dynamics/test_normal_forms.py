"""Birkhoff normal forms: published coefficients, transformations, theorems, what is refused."""

from __future__ import annotations

import numpy as np
import pytest

import hamsym
from hamsym import CertificationError, Hamiltonian, InputError
from hamsym.dynamics.equilibrium import Equilibrium

RESTRICTED = (
    "(p_x**2+p_y**2)/2 + y*p_x - x*p_y - (1-mu)/sqrt((x+mu)**2+y**2) - mu/sqrt((x-1+mu)**2+y**2)"
)


def _L4(mu: float) -> Equilibrium:
    H = Hamiltonian(RESTRICTED, parameters={"mu": mu})
    height = np.sqrt(3) / 2
    return H.equilibria({"x": 0.5 - mu, "y": height, "p_x": -height, "p_y": 0.5 - mu})[0]


def _at_origin(text: str) -> Equilibrium:
    H = Hamiltonian(text)
    return H.equilibria(dict.fromkeys(H.names, 0.0))[0]


def test_pendulum_and_quartic_oscillator() -> None:
    # H(I) of the pendulum: I - I**2/16 - I**3/256 - 5 I**4/8192 - 33 I**5/262144
    form = _at_origin("p**2/2 - cos(x)").normal_form(10)
    exact = {(1,): 1.0, (2,): -1 / 16, (3,): -1 / 256, (4,): -5 / 8192, (5,): -33 / 262144}
    for powers, value in exact.items():
        assert form.coefficients[powers].contains(value)
    assert form.stable


def test_three_coupled_modes_are_the_three_that_they_were_made_of() -> None:
    # Pendulum-like modes in turned coordinates: the actions are those of each alone.
    alone = ["p**2/2 + x**2/2 + x**3/5", "sqrt(2)*(p**2 + x**2)/2 - x**4/3", "p**2 - cos(2*x)/3"]
    turned = ["(2*{0}_1+{0}_2-2*{0}_3)/3", "(2*{0}_1-2*{0}_2+{0}_3)/3", "({0}_1+2*{0}_2+2*{0}_3)/3"]
    parts = [
        text.replace("x", f"({row.format('x')})").replace("p**", f"({row.format('p')})**")
        for text, row in zip(alone, turned, strict=True)
    ]
    form = _at_origin(" + ".join(parts)).normal_form(8)
    for text in alone:
        one = _at_origin(text).normal_form(8)
        k = int(np.abs(form.frequencies.mid - one.frequencies.mid).argmin())
        for (n,), ball in one.coefficients.items():
            powers = tuple(n * int(i == k) for i in range(3))
            both = form.coefficients[powers]
            assert abs(both.mid - ball.mid) <= both.radius + ball.radius
    mixed = [b for powers, b in form.coefficients.items() if sum(map(bool, powers)) > 1]
    assert all(b.contains(0.0) for b in mixed)
    assert not form.resonances


def test_henon_heiles_keeps_its_resonant_terms() -> None:
    form = _at_origin("(p_x**2+p_y**2)/2 + (x**2+y**2)/2 + x**2*y - y**3/3").normal_form(4)
    mid = {powers: ball.mid for powers, ball in form.coefficients.items()}
    assert mid[2, 0] == pytest.approx(-5 / 12, abs=1e-15)
    assert mid[0, 2] == pytest.approx(-5 / 12, abs=1e-15)
    assert mid[1, 1] == pytest.approx(1 / 3, abs=1e-15)
    # x -> -x is a symmetry, so that nothing is left with k = (-1, 1).
    assert set(form.resonances) == {(-2, 2)}


@pytest.mark.parametrize("mu", [0.001, 0.01, 0.0109, 0.01092, 0.02])
def test_determinant_of_the_triangular_points_is_the_published_one(mu: float) -> None:
    form = _L4(mu).normal_form(4)
    w = form.frequencies.mid
    s = (w[0] * w[1]) ** 2
    published = (36 - 541 * s + 644 * s * s) / (8 * (1 - 4 * s) * (4 - 25 * s))
    c = {powers: ball.mid for powers, ball in form.coefficients.items()}
    found = 2 * (c[2, 0] * w[1] ** 2 - c[1, 1] * w[0] * w[1] + c[0, 2] * w[0] ** 2)
    assert found == pytest.approx(published, rel=1e-9)
    assert form.stable
    assert "Arnold" in form.statement


def test_transformations_are_inverse_and_normalise() -> None:
    equilibrium = _at_origin("p_1**2/2 + q_1**2 + p_2**2/2 + q_2**2/3 + q_1**2*q_2 + q_1*q_2**3/5")
    random = np.random.default_rng(3)
    for degree, room in ((4, 3e-5), (6, 1e-6), (10, 2e-9)):
        form = equilibrium.normal_form(degree)
        assert equilibrium.H is not None
        energy = equilibrium.H.compile("numpy").energy
        normal = 0.05 * random.uniform(-1, 1, (40, 4))
        actions = (normal[:, :2] ** 2 + normal[:, 2:] ** 2) / 2
        z = form.from_normal(normal)
        assert np.abs(form.to_normal(z) - normal).max() < 20 * room
        assert np.abs(energy(z) - form.hamiltonian(actions)).max() < room
    # along a trajectory the actions stay, to the degree that was reached
    start = form.from_normal([0.03, 0.02, -0.01, 0.04])
    path = hamsym.solve(equilibrium.H, start, (0, 50))(np.linspace(0, 50, 100))
    Q, P = np.split(form.to_normal(path), 2, axis=1)
    assert np.ptp((Q**2 + P**2) / 2, axis=0).max() < 3e-6
    assert np.ptp((path[:, :2] ** 2), axis=0).max() > 1e-4
    assert form.domain > 0.05


def test_transformation_is_canonical_to_its_degree() -> None:
    form = _at_origin("p**2/2 - cos(x)").normal_form(8)
    point, step = np.array([0.2, 0.1]), 1e-5
    columns = [
        (form.from_normal(point + d) - form.from_normal(point - d)) / (2 * step)
        for d in step * np.eye(2)
    ]
    assert np.linalg.det(np.array(columns)) == pytest.approx(1, abs=1e-7)


def test_signs_of_modes_and_what_is_not_decided() -> None:
    # 1:2 with energies of both signs: the resonance k = (2, -1) up to order four
    form = _at_origin("(p_1**2 + q_1**2)/2 - (p_2**2 + q_2**2) + q_1**2*q_2").normal_form(4)
    assert sorted(form.frequencies.mid.round(12)) == [-2.0, 1.0]
    assert form.stable is None
    assert "may be zero" in form.statement
    three = _at_origin(
        "(p_1**2+q_1**2)/2 - sqrt(2)*(p_2**2+q_2**2)/2 + sqrt(3)*(p_3**2+q_3**2)/2 + q_1*q_2*q_3"
    ).normal_form(4)
    assert three.stable is None
    assert "no theorem" in three.statement
    # isochronous: the determinant is zero
    flat = _at_origin("(p_1**2 + q_1**2)/2 - sqrt(2)*(p_2**2 + q_2**2)/2").normal_form(4)
    assert flat.stable is None


def test_cubic_terms_within_round_off_count_beside_a_resonance() -> None:
    # With u = x - sqrt(2) the cubic part is c u^2 y, hidden by the round-off of (x^2 - 2)^3 y: its
    # effect c^2/(2 omega_1 - omega_2) on the degree four is as large as that of the last term.
    text = (
        "p**2/2 + (x - sqrt(2))**2/2 - q**2/2 - (2 + 2**(-235))**2*y**2/2"
        " + 2**(-196)*(x**2 - 2)**2*y/8 + (x**2 - 2)**3*y - 2**(-156)*y**4"
    )
    H = Hamiltonian(text, q=["x", "y"], p=["p", "q"])
    form = H.equilibria([2**0.5, 0, 0, 0])[0].normal_form(4)
    # -1/4 of the sum of k . d/dI (h_k^2 / (k . omega)) for k = (2, -1)
    mixed = 4 * (2.0**-196) ** 2 / 4 / 2.0**-235 / 4
    assert form.coefficients[1, 1].contains(mixed)
    assert form.stable is None
    assert "determinant may be zero" in form.statement


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("p**2/2 - x**2/2 + x**4/4", "an eigenvalue has a real part|not elliptic"),
        ("p**2/2 + x**4/4", "equal, zero, or too near"),
    ],
)
def test_equilibria_without_a_normal_form(text: str, message: str) -> None:
    H = Hamiltonian(text)
    found = H.equilibria(dict.fromkeys(H.names, 0.0))
    with pytest.raises(CertificationError, match=message):
        found[0].normal_form(4)


def test_arguments_are_checked() -> None:
    one = _at_origin("p**2/2 - cos(x)")
    with pytest.raises(InputError, match="degree"):
        one.normal_form(1)
    with pytest.raises(InputError, match="beyond 16"):
        one.normal_form(17)
    with pytest.raises(InputError, match="digits='a' cannot be used"):
        one.coordinates("a")  # type: ignore[arg-type]
    form = one.normal_form(4)
    assert "stable" in form.summary()
    for evaluate in (form.hamiltonian, form.to_normal, form.from_normal):
        for given in ("a", 10**400, [1.0, 2.0, 3.0], 1.0):
            with pytest.raises(InputError, match="an entry that is not|numbers in each row"):
                evaluate(given)
    with pytest.raises(InputError, match="equilibrium=3 cannot be used; give an Equilibrium"):
        hamsym.normal_form(3)  # type: ignore[arg-type]


@pytest.mark.parametrize("units", [(1e-27, 1e-10, 9.81), (6e24, 1e8, 1e-3)])
def test_normal_forms_in_other_units(units: tuple[float, float, float]) -> None:
    m, length, g = units
    H = Hamiltonian("p**2/(2*m*l**2) - m*g*l*cos(x)", parameters={"m": m, "l": length, "g": g})
    form = H.equilibria({"x": 0, "p": 0})[0].normal_form(6)
    rate = np.sqrt(g / length)
    action = m * length**2 * rate
    assert form.stable
    assert form.frequencies.mid[0] == pytest.approx(rate, rel=1e-14)
    for (n,), value in {(1,): 1.0, (2,): -1 / 16, (3,): -1 / 256}.items():
        found = form.coefficients[(n,)].mid * action ** (n - 1) / rate
        assert found == pytest.approx(value, rel=1e-13)
    assert form.domain / np.sqrt(action) == pytest.approx(
        _at_origin("p**2/2 - cos(x)").normal_form(6).domain, rel=0.02
    )


@pytest.mark.parametrize("unit", [2.0**-60, 2.0**60])
def test_domain_without_a_second_term_has_the_unit_of_the_actions(unit: float) -> None:
    domains = [
        Hamiltonian(f"{a}**2*((p/{a})**2/2 + (x/{a})**2/2 + (x/{a})**3/3)")
        .equilibria({"x": 0, "p": 0})[0]
        .normal_form(3)
        .domain
        / a
        for a in (1.0, unit)
    ]
    assert 0.01 < domains[0] == pytest.approx(domains[1], rel=1e-12)


def test_domain_of_a_quadratic_form_is_infinite() -> None:
    assert _at_origin("p**2/2 + x**2/2").normal_form(4).domain == np.inf


@pytest.mark.parametrize(
    ("formula", "within"),
    [
        ("(p**2 + x**2)/2 + 0.2*exp(-20*(p**2 + x**2 - 1)**2)", 0.7),
        ("p**2/2 + x**2/2 + 0.05*exp(-(4*(x - 2))**2)", 1.6),
    ],
)
def test_domain_ends_before_a_feature_beyond_which_the_form_agrees_again(
    formula: str, within: float
) -> None:
    for degree in (2, 6):
        assert 0.8 * within < _at_origin(formula).normal_form(degree).domain < within


def test_domain_far_from_the_origin_begins_above_round_off() -> None:
    near, far = (Hamiltonian(f"p**2/2 - cos(x - {shift}) + {shift}") for shift in (0, 1_000))
    sizes = [
        H.equilibria({"x": shift, "p": 0})[0].normal_form(6).domain
        for H, shift in ((near, 0), (far, 1_000))
    ]
    assert sizes[0] == pytest.approx(sizes[1], rel=0.1)
