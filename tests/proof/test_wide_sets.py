"""Wide sets: every solution is inside, or the enclosure says until when it can."""

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hamsym
from hamsym import Ball, Hamiltonian, enclose
from hamsym.errors import CertificationError, InputError
from hamsym.proof.arithmetic.generated import ParameterSlopes
from hamsym.proof.arithmetic.taylor_models import Model, space_of
from hamsym.proof.boxes import carried_errors, wide_sets
from hamsym.proof.boxes.carried_errors import CarriedErrors
from hamsym.proof.boxes.tube import Flow, Stepper
from hamsym.proof.boxes.wide_sets import SetWindow
from hamsym.proof.windows.enclose import _Problem
from tests.audit.taylor import Equations, integrate

PENDULUM = "p**2/2 - cos(x)"
HENON_HEILES = "(px**2 + py**2 + x**2 + y**2)/2 + x**2*y - y**3/3"
KEPLER = "(px**2 + py**2)/2 - 1/sqrt(x**2 + y**2)"
SPRING = "(p_r**2 + p_theta**2/r**2)/2 - 9.8*r*cos(theta) + (r-1)**2"
SWING = "p**2/2 - g*cos(x)"
PLANE = (("x", "y"), ("px", "py"))
LINE = (("x",), ("p",))


@dataclass(frozen=True)
class Case:
    """A set of starts, and of parameters."""

    formula: str
    start: tuple[Ball, ...]
    span: tuple[float, float]
    names: tuple = LINE
    parameters: tuple[tuple[str, Ball], ...] = ()


CASES = {
    "pendulum": Case(PENDULUM, (Ball(1.0, 0.05), Ball(0.0, 0.05)), (0.0, 12.0)),
    "backward": Case(
        "p**2/2 + x**4/4 - x*cos(1.1*t)", (Ball(1.0, 0.03), Ball(0.2, 0.01)), (3.0, -3.0)
    ),
    "one component": Case(PENDULUM, (Ball(0.0, 0.0), Ball(1.5, 0.05)), (1.0, 9.0)),
    "parameter alone": Case(
        SWING, (Ball(1.0, 0), Ball(0.0, 0)), (0.0, 6.0), LINE, (("g", Ball(1.0, 0.1)),)
    ),
    "fall": Case("p**2/2 + 9.81*x", (Ball(1.0, 0.1), Ball(0.0, 0.1)), (0.0, -2.0)),
    "thin beside wide": Case(
        HENON_HEILES, (Ball(0.3, 1e-3), Ball(-0.3, 1e-13), Ball(0.3, 0), Ball(0.15, 1e-12)),
        (0.0, 6.0), PLANE,
    ),
    "units": Case(
        "p**2/(2*1e-27) + 0.5*1e-3*x**2*(1 + 1e18*x**2)", (Ball(1e-9, 3e-11), Ball(0.0, 0.0)),
        (0.0, 5e-12),
    ),
    "kepler": Case(
        KEPLER, (Ball(1.0, 1e-3), Ball(0.0, 1e-3), Ball(0.0, 1e-3), Ball(1.0, 1e-3)), (0.0, 4.0),
        PLANE,
    ),
}  # fmt: skip


def in_parts(case, most=1):
    """The enclosure by polynomials, whether or not derivatives would do."""
    parameters = dict(case.parameters)
    H = Hamiltonian(case.formula, parameters=dict.fromkeys(parameters, 1.0))
    return _Problem.checked(H, case.start, case.span, parameters, None).in_parts(most)


def drawn(rng, balls):
    """Shares s of the radii, some at the ends, and the numbers."""
    count = len(balls)
    ends, inner = rng.choice([-1.0, 1.0], count), rng.uniform(-1, 1, count)
    s = np.where(rng.random(count) < 0.4, ends, inner)
    return s, [float(ball.mid + share * ball.radius) for share, ball in zip(s, balls, strict=True)]


def truth(case, z0, times, parameters=None, digits=30):
    equations = Equations(case.formula, *case.names, parameters or None)
    found = integrate(
        equations, z0, case.span[0], times, order=40, bits=4 * digits + 20, digits=digits
    )
    return np.array([[float(value) for value in state] for state in found.states])


def misses(case, found, seed=5, draws=5):
    """Starts whose solutions are not in the balls, or not near the polynomials."""
    rng = np.random.default_rng(seed)
    times = np.sort(rng.uniform(*sorted(case.span), 6)).tolist()
    times = [*(times if case.span[1] > case.span[0] else times[::-1]), case.span[1]]
    every, missed = (*case.start, *dict(case.parameters).values()), []
    for _ in range(draws):
        shares, numbers = drawn(rng, every)
        dim, balls = len(case.start), found(times)
        given = dict(zip(dict(case.parameters), numbers[dim:], strict=True))
        states = truth(case, numbers[:dim], times, given)
        inside = (np.abs(states - balls.mid) <= balls.radius).all()
        for t, state in zip(times, states, strict=True):
            near = np.abs(state - polynomial(found, every, shares, t)) <= bound_at(found, t)
            if not (inside and near.all()):
                missed.append((t, numbers))
    return missed


@pytest.mark.slow_cases("kepler", "thin beside wide", "backward", "pendulum", "units")
@pytest.mark.parametrize("name", CASES)
def test_solutions_are_within_the_bounds_of_the_polynomials(name):
    assert misses(CASES[name], in_parts(CASES[name])) == []


@pytest.mark.slow_cases("kepler")
@pytest.mark.parametrize("name", ["one component", "kepler"])
def test_errors_in_turned_frames_contain_solutions(name, monkeypatch):
    monkeypatch.setattr(carried_errors, "_LARGE", 3.0)
    found = in_parts(CASES[name])
    assert misses(CASES[name], found) == []
    assert np.isfinite(found.windows[-1].V_error).all()


def support(errors, column, part, direction):
    """The largest of direction @ (w - W(s)) over what is known of a column."""
    model_radii = np.array([model.radius[part] for model in errors.columns[column]])
    edges = np.abs(direction @ errors.frame[:, :, part])
    return edges @ errors.radii[:, column, part] + np.abs(direction) @ model_radii


def some_errors(rng):
    H, space, parts = Hamiltonian(PENDULUM), space_of(2, 4, 3), 3
    stepper = Stepper(Flow(H, []), space, space.degree - 1)

    def models(size):
        coefficients = rng.normal(size=(space.count, parts)) * (space.exponents[:, :1] == 0)
        return Model(space, size * coefficients, size * rng.random(parts))

    matrices = [[[models(1.0) for _ in range(2)] for _ in range(2)] for _ in range(2)]
    frame = rng.normal(size=(2, 5, parts)) * [[[1.0]], [[1e-3]]]
    return CarriedErrors(
        stepper, ParameterSlopes(H, []), [[models(1e-2), models(1e-4)] for _ in range(3)],
        frame, rng.random((5, 3, parts)), *matrices, np.ones((2, 3, parts)),
    )  # fmt: skip


def middles(errors):
    """M at the middle of each part, shape (2, 2, 3)."""
    return np.array([[model.coefficients[0] for model in row] for row in errors.fundamental])


def test_rounding_of_turned_edges_is_counted():
    before = some_errors(np.random.default_rng(8))
    after, C = before.turned(), middles(before)
    for column, i, part in np.ndindex(3, 2, 3):
        lost = Fraction(0)
        for k in range(5):
            terms = (Fraction(C[i, j, part]) * Fraction(before.frame[j, k, part]) for j in range(2))
            off = abs(sum(terms) - Fraction(after.frame[i, k, part]))
            lost += off * Fraction(before.radii[k, column, part])
        assert 0 < lost <= Fraction(after.columns[column][i].radius[part])


@pytest.mark.parametrize("edges", [6, 7])  # a new frame, or more columns
def test_turned_columns_contain_the_columns_before(edges, monkeypatch):
    monkeypatch.setattr(carried_errors, "_MOST_EDGES", edges)
    rng, parts = np.random.default_rng(7), 3
    before = some_errors(rng)
    after = before.turned()
    assert after.frame.shape[1] == (7 if edges == 7 else 2)
    C = middles(before)
    for column, part in np.ndindex(3, parts):
        old, new = (
            np.array([model.coefficients[:, part] for model in errors.columns[column]])
            for errors in (before, after)
        )
        turn = C[:, :, part]
        assert np.allclose(turn @ old, new, rtol=1e-12, atol=1e-15)
        for direction in rng.normal(size=(50, 2)):
            least = support(before, column, part, turn.T @ direction)
            assert least <= support(after, column, part, direction) * (1 + 1e-12)
    for part in range(parts):
        S, moved = (
            np.array([[m.coefficients[:, part] for m in row] for row in errors.adjoint])
            for errors in (before, after)
        )
        assert np.allclose(np.einsum("ij,jkt->ikt", C[:, :, part], S), moved, rtol=1e-12)
        assert after.fundamental[0][0].coefficients[0, part] == pytest.approx(1)
        assert after.fundamental[0][1].coefficients[0, part] == pytest.approx(0, abs=1e-9)


def window_at(found, t):
    k, x = found._place(t)
    return found.windows[k], float(x)


def bound_at(found, t):
    window, _ = window_at(found, t)
    sizes = np.abs(window.polynomials).sum(axis=(1, 2))
    return window.bound[:, 0] + 1e-15 * sizes


def polynomial(found, balls, shares, t):
    """P(x, s) of a set in one part."""
    window, x = window_at(found, t)
    exponents = space_of(window.inputs, window.time_degree, window.degree).exponents
    wide = [i for i, ball in enumerate(balls) if ball.radius > 1e-10 * abs(ball.mid)]
    assert len(wide) == window.inputs
    terms = np.prod(np.array([x, *shares[wide]]) ** exponents, axis=1)
    return window.polynomials[:, :, 0] @ terms


def test_polynomials_are_much_sharper_than_the_set():
    found = in_parts(CASES["pendulum"])
    assert all((w.bound < 0.05 * 0.05).all() for w in found.windows)


@pytest.mark.slow
@pytest.mark.parametrize("large", [3.0, 1e5])
def test_derivatives_of_solutions_are_inside(large, monkeypatch):
    monkeypatch.setattr(carried_errors, "_LARGE", large)
    wide = Case(
        SWING,
        (Ball(1.0, 0.01), Ball(0.0, 0.02)),
        (0.0, 4.0),
        LINE,
        (("g", Ball(1.0, 0.02)),),
    )
    found = in_parts(wide)
    rng = np.random.default_rng(1)
    every = (*wide.start, Ball(1.0, 0.02))
    step = 2.0**-40
    for _ in range(3):
        _, numbers = drawn(rng, every)
        columns = []
        for k in range(3):
            moved = list(numbers)
            ends = []
            for sign in (1, -1):
                moved[k] = numbers[k] + sign * step
                equations = Equations(wide.formula, *wide.names, {"g": moved[2]})
                ends.append(
                    integrate(
                        equations, moved[:2], 0.0, [4.0], order=40, bits=200, digits=40
                    ).states[0]
                )
            columns.append([float((a - b) / (2 * step)) for a, b in zip(*ends, strict=True)])
        exact = np.array(columns).T
        balls, more = found.derivative(4.0), found.parameter_derivative(4.0)
        assert (np.abs(exact[:, :2] - balls.mid) <= balls.radius).all()
        assert (np.abs(exact[:, 2:] - more.mid) <= more.radius).all()
        assert (balls.radius < 0.3).all()
        assert (more.radius < 0.3).all()


def test_forced_sets_contain_solutions():
    H = Hamiltonian(PENDULUM, forces={"p": "-0.1*p + 0.3*cos(t)"})
    found = _Problem.checked(H, ["1 +- 0.05", "0 +- 0.02"], (0, 8), None, None).in_parts(1)
    rng = np.random.default_rng(2)
    for _ in range(6):
        _, z0 = drawn(rng, [Ball(1.0, 0.05), Ball(0.0, 0.02)])
        state = solve_ivp(
            lambda t, z: [z[1], -math.sin(z[0]) - 0.1 * z[1] + 0.3 * math.cos(t)],
            (0, 8), z0, "DOP853", rtol=1e-12, atol=1e-12,
        ).y[:, -1]  # fmt: skip
        assert (np.abs(state - found(8.0).mid) <= found(8.0).radius).all()


@pytest.mark.slow
def test_split_sets_contain_solutions():
    case = Case(PENDULUM, (Ball(2.5, 0.2), Ball(0.0, 0.1)), (0.0, 4.0))
    found = in_parts(case, 8)
    assert found.windows[-1].parts > 1
    rng = np.random.default_rng(3)
    for _ in range(12):
        _, z0 = drawn(rng, case.start)
        for t, state in zip([3.0, 4.0], truth(case, z0, [3.0, 4.0]), strict=True):
            assert (np.abs(state - found(t).mid) <= found(t).radius).all()


def test_last_step_is_not_halved_without_end(monkeypatch):
    monkeypatch.setattr(wide_sets, "_FINE", np.inf)  # shorter steps are tried, and do not help
    for end in (2.4, 2.6):
        found = in_parts(Case(PENDULUM, (Ball(2.5, 0.2), Ball(0.0, 0.1)), (0.0, end)))
        assert found.windows[-1].half > 1e-3


@pytest.mark.slow
def test_more_parts_reach_further():
    case = Case(PENDULUM, (Ball(2.5, 0.2), Ball(0.0, 0.1)), (0.0, 6.0))
    with pytest.raises(CertificationError, match="became too wide for 1 part;.*max_parts"):
        in_parts(case, 1)


def test_thin_sets_stay_on_windows():
    found = enclose(PENDULUM, ["1 +- 1e-6", 0], (0, 5))
    assert not any(isinstance(window, SetWindow) for window in found.windows)


@pytest.mark.slow
def test_wide_set_goes_on_where_windows_end(tmp_path):
    found = enclose(PENDULUM, ["1 +- 0.05", "0 +- 0.05"], (0, 30))
    assert (found(30.0).radius < [0.06, 0.25]).all()
    found.save(tmp_path / "set")
    again = hamsym.load(tmp_path / "set")
    assert (again(17.3).mid == found(17.3).mid).all()
    assert (again.derivative(9.0).radius == found.derivative(9.0).radius).all()
    assert found.facts["parts"].value == 1
    assert found.plot()


def test_set_that_touches_a_singularity_is_refused():
    case = Case(
        KEPLER, (Ball(0.1, 0.2), Ball(0.0, 0.1), Ball(0.0, 0.0), Ball(1.0, 0.0)), (0.0, 1.0), PLANE
    )
    with pytest.raises(CertificationError, match="no enclosure beyond t = 0"):
        in_parts(case, 4)


@pytest.mark.parametrize("most", [0, -1, 1.5, "many"])
def test_numbers_of_parts_are_checked(most):
    with pytest.raises(InputError, match="max_parts"):
        enclose(PENDULUM, ["1 +- 0.01", 0], (0, 1), max_parts=most)


def test_time_limit_stops_a_set():
    problem = _Problem.checked(PENDULUM, ["1 +- 0.05", 0], (0, 300), None, 1e-3)
    with pytest.raises(CertificationError, match="time limit of 0.001 s"):
        problem.in_parts(64)
