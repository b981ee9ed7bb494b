"""Proofs of one motion in different units: bounds change as the components do."""

import dataclasses
import math

import mpmath
import numpy as np
import pytest
import sympy

import hamsym
from hamsym.numerics.scales import coupling_shares
from hamsym.proof.windows.guessed_windows import sizes_of_all


def in_units(solution, lengths, energy, time):
    """A solution in units of powers of two, exactly, and the factors of its components.

    ``lengths`` are the exponents of the coordinates; those of the momenta follow, because they are
    energy times time divided by lengths.
    """
    H = solution.H
    two = sympy.Integer(2)
    exponents = [*lengths, *(energy + time - length for length in lengths)]
    values = {z: z / two**e for z, e in zip(H.z, exponents, strict=True)}
    if H.time is not None:
        values[H.time] = H.time / two**time
    own = hamsym.Hamiltonian(
        two**energy * H.expr.xreplace(values), q=H.q, p=H.p, parameters=H.parameters
    )
    factors, pace = 2.0 ** np.array(exponents), 2.0**time
    trial = solution.trial
    trial = dataclasses.replace(
        trial,
        edges=trial.edges * pace,
        origin=np.array(trial.origin * pace),
        states=trial.states * factors,
        readouts=trial.readouts * factors,
    )
    start, end = solution.span
    span = (start * pace, end * pace)
    return dataclasses.replace(
        solution, H=own, z0=solution.z0 * factors, span=span, trial=trial
    ), factors


_CASES = {
    "anharmonic": ("p**2/2 + x**2/2 + x**4/4", (1.0, 0.0), (0.0, 6.0)),
    "explicit time": ("p**2/2 + x**2/2 + x*cos(1.5*t)", (1.0, 0.0), (1.0, 5.0)),
    "plane motion in space": (
        "(p_x**2 + p_y**2 + p_z**2)/2 + x**2/2 + 2*y**2 + (x*z)**2 + x*y",
        (1.0, 0.0, 0.0, 0.0, 0.5, 0.0),
        (0.0, 4.0),
    ),
    "free particle at rest beside": (
        "(p_x**2 + p_y**2)/2 + x**4/4",
        (1.0, 0.0, 0.0, 0.0),
        (0.0, 4.0),
    ),
}


@pytest.mark.parametrize("case", _CASES.values(), ids=_CASES)
def test_bounds_are_the_same_in_all_units(case):
    solution = hamsym.solve(*case)
    own = solution.certify(bound=1e-8)
    # As metres, kilograms and seconds are for atoms, and the reverse.
    for sign in (1, -1):
        lengths = [sign * (-33 + 11 * k) for k in range(solution.H.dof)]
        other, factors = in_units(solution, lengths, -60 * sign, -45 * sign)
        found = other.certify(bound=2e-8 * factors)
        assert len(found.edges) == len(own.edges)
        for name in ("component_bounds", "component_lowers"):
            values = np.array(getattr(found, name)) / factors
            assert values == pytest.approx(getattr(own, name), rel=1e-3, abs=1e-100)


@pytest.mark.slow
def test_derivatives_of_an_enclosure_are_the_same_in_all_units():
    """Over so many windows that sets are boxed, of all columns of the derivative."""
    H, z0 = "p**2/2 - cos(x)", (3.0, 0.0)
    own = hamsym.enclose(H, z0, (0.0, 150.0))
    assert len(own.windows) > 70
    a, b, pace = 2.0**-33, 2.0**-79, 2.0**-45
    scaled = hamsym.Hamiltonian(
        "c*((p/b)**2/2 - cos(x/a))", parameters={"a": a, "b": b, "c": a * b / pace}
    )
    other = hamsym.enclose(scaled, (3.0 * a, 0.0), (0.0, 150.0 * pace))
    slopes, found = own.derivative(150.0), other.derivative(150.0 * pace)
    ratios = np.array([[1.0, a / b], [b / a, 1.0]])
    np.testing.assert_allclose(found.mid / ratios, slopes.mid, rtol=1e-9)
    np.testing.assert_allclose(found.radius / ratios, slopes.radius, rtol=0.1)


def test_units_of_components_at_rest_follow_from_their_couplings():
    """A free electron at rest in SI units, beside one in an oscillator, in one window."""
    H = "(p_x**2 + p_y**2)/(2*9.1e-31) + 9.1e-31*1e30*x**2/2"
    enclosure = hamsym.enclose(H, (1e-10, 0.0, 0.0, 0.0), (0.0, 1e-15))
    t = 1e-15
    error = np.abs(enclosure(t).mid - [1e-10 * math.cos(1.0), 0.0, -9.1e-26 * math.sin(1.0), 0.0])
    assert error[0] < 1e-25
    assert error[2] < 1e-40
    assert (enclosure(t).radius[[1, 3]] < 1e-15 * enclosure(t).radius[[0, 2]]).all()


def test_pendulum_at_rest_does_not_widen_its_neighbour():
    """Roundings of the sine of 0 are many units of a component that is exactly at rest."""
    alone = hamsym.enclose("p_x**2/2 + 0.9*x**2", (0.6, 0.3), (0.0, 5.0))
    H = "(p_x**2 + p_y**2)/2 + 0.9*x**2 - 0.8*cos(y) + (x*y)**2/5"
    both = hamsym.enclose(H, (0.6, 0.0, 0.3, 0.0), (0.0, 5.0))
    assert (both(5.0).radius[[0, 2]] <= 3 * alone(5.0).radius).all()
    assert (both(5.0).radius[[1, 3]] < 1e-24).all()
    assert both.derivative(5.0).radius.max() < 1e-5


def test_pendulum_at_rest_alone_is_enclosed():
    enclosure = hamsym.enclose("p**2/2 - 0.8*cos(x)", (0.0, 0.0), (0.0, 5.0))
    assert (enclosure(5.0).radius < 1e-24).all()


def test_constants_have_the_units_of_what_they_move():
    """Over so many windows that sets are boxed, with a mass in kilograms."""
    radii = []
    for unit in (1.0, 2.0**-100):
        H = hamsym.Hamiltonian(
            "p**2/(2*m) + k*x**2/2 + k*x**4/4", parameters={"m": unit, "k": unit}
        )
        mass = hamsym.Ball(unit, 1e-13 * unit)
        enclosure = hamsym.enclose(H, (1.0, 0.0), (0.0, 100.0), parameters={"m": mass})
        assert len(enclosure.windows) > 70
        radii.append(enclosure(100.0).radius / (1.0, unit))
    assert radii[1] == pytest.approx(radii[0], rel=0.01)


def test_sizes_that_underflow_are_still_positive():
    """x moves p = 1e-150 by its own size from 1e-350 on."""
    for coupling in (1e200, math.inf):
        couplings = np.array([[0.0, 0.0], [coupling, 0.0]])
        shares = coupling_shares(couplings, 1.0)
        found = sizes_of_all(np.array([0.0, 1e-150]), couplings, shares, 1.0)
        assert (found > 0).all()


# -- a proton in a magnetic bottle --------------------------------------------------------------

M, Q, B, L = 1.67e-27, 1.6e-19, 0.1, 0.3
SPAN = 5e-5


def bottle(m, q):
    """H with A_phi = B r (1 + z^2/L^2)/2."""
    half = "q*B/2*(1 + z**2/L**2)"
    return hamsym.Hamiltonian(
        f"((p_x + {half}*y)**2 + (p_y - {half}*x)**2 + p_z**2)/(2*m)",
        parameters={"m": m, "q": q, "B": B, "L": L},
    )


def orbit_of_the_proton(start, times):
    """States at times by Taylor series of m v' = q v x B to 40 digits, without H."""
    mp = mpmath.mp.clone()
    mp.dps = 40
    m, q, field, length = (mp.mpf(value) for value in (M, Q, B, L))
    ratio = q / m
    order = 40

    def product(a, b, k):
        return mp.fsum(a[i] * b[k - i] for i in range(k + 1))

    def potential(z):
        return field / 2 * (1 + (z / length) ** 2)

    x, y, z, *p = (mp.mpf(value) for value in start)
    v = [(p[0] + q * potential(z) * y) / m, (p[1] - q * potential(z) * x) / m, p[2] / m]
    state, now, found = [x, y, z, *v], mp.mpf(0), []
    for t in times:
        end = mp.mpf(t)
        count = int(mp.ceil((end - now) * ratio * field * 2))
        h = (end - now) / count
        for _ in range(count):
            s = [[value] for value in state]  # x, y, z and velocities times h^k
            steep, strong, bx, by = [], [], [], []
            for k in range(order):
                steep.append(field * s[2][k] / length**2)  # d(potential)/dz
                strong.append(field * product(s[2], s[2], k) / length**2 + (field if k == 0 else 0))
                bx.append(-product(steep, s[0], k))
                by.append(-product(steep, s[1], k))
                forces = (
                    product(s[4], strong, k) - product(s[5], by, k),
                    product(s[5], bx, k) - product(s[3], strong, k),
                    product(s[3], by, k) - product(s[4], bx, k),
                )
                for i in range(3):
                    s[i].append(h * s[i + 3][k] / (k + 1))
                for i in range(3):
                    s[i + 3].append(h * ratio * forces[i] / (k + 1))
            state = [mp.fsum(series) for series in s]
        now = end
        x, y, z, *v = state
        a = q * potential(z)
        found.append([x, y, z, m * v[0] - a * y, m * v[1] + a * x, m * v[2]])
    return found


@pytest.mark.slow
def test_proton_in_a_magnetic_bottle_is_proven_in_units_of_the_si():
    start = [0.005, 0.002, 0.0, 1e-22, 0.0, 5e-23]
    solution = hamsym.solve(bottle(M, Q), start, (0.0, SPAN))
    certificate = solution.certify(time_limit=300)
    assert certificate.bound < 1e-11
    momentum = M * 1e6
    scaled = hamsym.solve(
        bottle(1.0, Q * 1e-6 / M),
        [*start[:3], *(value / momentum for value in start[3:])],
        (0.0, SPAN * 1e6),
    )
    # Both solutions have errors of their own, of the same size.
    units = np.array([1.0, 1.0, 1.0, *[momentum] * 3])
    other = np.array(scaled.certify(time_limit=300).component_bounds) * units
    ratios = np.array(certificate.component_bounds) / other
    assert ((ratios > 0.1) & (ratios < 10)).all()
    times = np.linspace(0, SPAN, 101)[1:]
    exact = orbit_of_the_proton(start, times.tolist())
    values = [[mpmath.mpf(v) for v in row] for row in solution(times).tolist()]
    errors = np.array(
        [
            [float(abs(a - b)) for a, b in zip(*rows, strict=True)]
            for rows in zip(values, exact, strict=True)
        ]
    )
    rounding = 1e-15 * np.abs(solution(times)).max(axis=0)  # of evaluations in floating point
    assert (errors.max(axis=0) <= np.array(certificate.component_bounds) + rounding).all()
    assert (errors.max(axis=0) >= 0.3 * np.array(certificate.component_lowers)).all()


_PENDULUM = "c*((p/b)**2/2 - cos(x/a))"
_ATOMIC = {"a": 2.0**-33, "b": 2.0**-73, "c": 2.0**-66}  # and 2^-40 for time
_OWN = dict.fromkeys("abc", 1.0)


@pytest.mark.slow
def test_certificates_of_orbits_are_the_same_in_all_units():
    found = []
    for values, time in ((_OWN, 1.0), (_ATOMIC, 2.0**-40)):
        H = hamsym.Hamiltonian(_PENDULUM, parameters=values)
        certificate = hamsym.periodic_orbit(H, ([values["a"], 0.0], 6.7 * time)).certify()
        found.append((certificate.period.mid / time, certificate.period.radius / time))
    assert found[1][0] == pytest.approx(found[0][0], rel=1e-14)
    assert found[1][1] == pytest.approx(found[0][1], rel=0.5)


def test_certificates_of_flow_maps_are_the_same_in_all_units():
    # the last ones have unequal units of coordinates and momenta
    found = []
    for a, b, time in ((1.0, 1.0, 1.0), (2.0**-33, 2.0**-73, 2.0**-40), (2.0**-33, 1.0, 1.0)):
        H = hamsym.Hamiltonian(_PENDULUM, parameters={"a": a, "b": b, "c": a * b / time})
        box = {"x": (0.5 * a, 0.7 * a), "p": (-0.1 * b, 0.1 * b)}
        certificate = hamsym.flow_map(H, box, (0.0, time), tol=1e-6).certify(time_limit=200)
        found.append([*np.array(certificate.bound) / (a, b), certificate.parts])
    assert found[1] == pytest.approx(found[0], rel=0.01)
    assert found[2] == pytest.approx(found[0], rel=0.01)
