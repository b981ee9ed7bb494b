"""Lagrangians: Hamilton's equations against Euler-Lagrange's, textbook forms, refusals."""

from __future__ import annotations

import random

import numpy as np
import pytest
import sympy
from sympy.physics.mechanics import LagrangesMethod, dynamicsymbols

from hamsym import Hamiltonian, InputError
from hamsym.errors import ParameterError, ParseError, VariableError
from hamsym.symbolic import legendre
from hamsym.symbolic.lagrangian import find_velocities

TIME = dynamicsymbols._t


def random_lagrangian(seed: int) -> tuple[sympy.Expr, list[sympy.Expr]]:
    """A kinetic energy with a positive definite matrix, magnetic and time terms, a potential."""
    generator = random.Random(seed)
    dof = 1 + seed % 5
    q = [dynamicsymbols(f"x{i}") for i in range(dof)]
    v = [coordinate.diff(TIME) for coordinate in q]

    def number() -> sympy.Rational:
        return sympy.Rational(generator.randint(-6, 6), 5)

    def function() -> sympy.Expr:
        one, other = generator.choice(q), generator.choice(q)
        return generator.choice([sympy.sin(one), sympy.cos(one - other), one * other, one])

    constant = seed % 2 == 0 and seed > 4
    expr = sympy.S.Zero
    for i in range(dof):
        # A sum of squares with each velocity in one of them: positive definite.
        weight = 2 if constant else 2 + function() ** 2
        mixed = v[i]
        for j in generator.sample(range(i), min(i, 2)):
            mixed += number() * v[j] * (1 if constant else function())
        expr += weight * mixed**2 / 2
        expr += number() * function() * v[i] + number() * sympy.cos(TIME) * v[i]
        expr -= number() * q[i] ** 2 + number() * function() * sympy.sin(2 * TIME)
    return expr, q


@pytest.mark.slow_cases("6", "1", "8", "2", "3", "4", "7")
@pytest.mark.parametrize("seed", [0, 1, 2, 3, 4, 6, 7, 8])
def test_equations_equal_those_of_euler_and_lagrange(seed: int) -> None:
    expr, q = random_lagrangian(seed)
    v = [coordinate.diff(TIME) for coordinate in q]
    method = LagrangesMethod(expr, q)
    method.form_lagranges_equations()
    plain = dict(zip([*v, *q], sympy.symbols(f"v:{len(q)} x:{len(q)}"), strict=True))
    arguments = [TIME, [plain[s] for s in q], [plain[s] for s in v]]

    def compiled(entry: sympy.Expr) -> object:
        return sympy.lambdify(arguments, entry.xreplace(plain), "numpy")

    mass, forcing = compiled(method.mass_matrix), compiled(method.forcing)
    momenta = sympy.Matrix([expr.diff(rate) for rate in v])
    p_of = compiled(momenta)
    # dp/dt = dp/dq v + M a + dp/dt at fixed q, v.
    rest = momenta.xreplace({rate: plain[rate] for rate in v}).xreplace(plain)
    drift = rest.jacobian([plain[s] for s in q]) * sympy.Matrix([plain[s] for s in v])
    drift_of = sympy.lambdify(arguments, drift + rest.diff(TIME), "numpy")

    H = Hamiltonian.from_lagrangian(expr)
    assert H.names == tuple(f"{kind}x{i}" for kind in ("", "p_") for i in range(len(q)))
    system = H.compile("numpy")
    generator = np.random.default_rng(seed)
    start = generator.uniform(-0.5, 0.5, 2 * len(q))

    def rates(t: float, state: np.ndarray) -> np.ndarray:
        x, velocity = np.split(state, 2)
        acceleration = np.linalg.solve(mass(t, x, velocity), forcing(t, x, velocity)[:, 0])
        return np.concatenate([velocity, acceleration])

    state = start
    for t in np.arange(0.0, 1.0, 0.1):
        x, velocity = np.split(state, 2)
        acceleration = rates(t, state)[len(q) :]
        wanted = mass(t, x, velocity) @ acceleration + drift_of(t, x, velocity)[:, 0]
        z = np.concatenate([x, p_of(t, x, velocity)[:, 0]])
        found = system.vector_field(*system.arguments(z, t))
        wanted = np.concatenate([velocity, wanted])
        assert np.abs(found - wanted).max() <= 1e-12 * (1 + np.abs(wanted).max())
        middle = state + 0.05 * rates(t, state)
        state = state + 0.1 * rates(t + 0.05, middle)


DOUBLE_PENDULUM = (
    "(m1 + m2)*l1**2*dtheta1**2/2 + m2*l2**2*dtheta2**2/2 + m2*l1*l2*dtheta1*dtheta2*"
    "cos(theta1 - theta2) + (m1 + m2)*g*l1*cos(theta1) + m2*g*l2*cos(theta2)"
)


@pytest.mark.slow
def test_double_pendulum_is_that_of_textbooks() -> None:
    known = Hamiltonian(
        "(m2*l2**2*p_theta1**2 + (m1 + m2)*l1**2*p_theta2**2 - 2*m2*l1*l2*p_theta1*p_theta2*"
        "cos(theta1 - theta2))/(2*m2*l1**2*l2**2*(m1 + m2*sin(theta1 - theta2)**2))"
        "- (m1 + m2)*g*l1*cos(theta1) - m2*g*l2*cos(theta2)"
    )
    found = Hamiltonian.from_lagrangian(DOUBLE_PENDULUM)
    assert found.z == known.z
    assert sympy.simplify(found.expr - known.expr) == 0


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("m*(rdot**2 + r**2*phi_dot**2)/2 + k/r", "p_r**2/(2*m) + p_phi**2/(2*m*r**2) - k/r"),
        (
            "m*(dx**2 + dy**2)/2 + B*(x*dy - y*dx)/2 - k*cos(t)*x",
            "((p_x + B*y/2)**2 + (p_y - B*x/2)**2)/(2*m) + k*cos(t)*x",
        ),
        ("exp(t)*(xdot**2 - x**2)/2", "exp(-t)*p_x**2/2 + exp(t)*x**2/2"),
        ("xdot*ydot - x*y", "p_x*p_y + x*y"),
        ("(xdot + t)**2/2", "p_x**2/2 - t*p_x"),
        ("m*l**2*(dθ**2*(sin(φ)**2 + cos(φ)**2) + dφ**2)/2", "(p_θ**2 + p_φ**2)/(2*m*l**2)"),
        ("0.1*xdot**2", "2.5*p_x**2"),
    ],
)
def test_transform_of_quadratic_lagrangians(text: str, expected: str) -> None:
    H = Hamiltonian.from_lagrangian(text)
    known = Hamiltonian(expected, q=[s.name for s in H.q], p=[s.name for s in H.p])
    assert sympy.simplify(H.expr - known.expr) == 0


@pytest.mark.parametrize(
    "text",
    [
        "-m*c**2*sqrt(1 - xdot**2/c**2) - k*x",
        "xdot**4/4 + a*xdot**2/2 - x**2/2",
        "xdot**2/(1 + xdot**2) - x",
        "sin(xdot)/xdot + ydot**2",
        "exp(xdot) + ydot**2/2 - x",
        "xdot**2/2 + xdot*ydot**2",
    ],
)
def test_lagrangians_that_are_not_quadratic_are_refused(text: str) -> None:
    with pytest.raises(
        InputError, match="L is not quadratic in the velocities xdot.*give H itself"
    ):
        Hamiltonian.from_lagrangian(text)


def test_hamiltonian_keeps_the_symbols_of_the_caller() -> None:
    x, m, xdot = sympy.symbols("x m xdot")
    H = Hamiltonian.from_lagrangian(m * xdot**2 / 2 - x**2)
    assert {x, m} < H.expr.free_symbols


@pytest.mark.slow
def test_functions_of_time_of_sympy() -> None:
    x, theta = dynamicsymbols("x theta")
    m, length, g = sympy.symbols("m l g", positive=True)
    position = sympy.Matrix([x + length * sympy.sin(theta), -length * sympy.cos(theta)])
    velocity = position.diff(TIME)
    expr = m * velocity.dot(velocity) / 2 + x.diff(TIME) ** 2 - m * g * position[1]
    H = Hamiltonian.from_lagrangian(expr, q=[x, theta], parameters={m: 2.0, "g": 9.81})
    assert H.names == ("x", "theta", "p_x", "p_theta")
    assert dict(H.parameters) == {"g": 9.81, "m": 2.0}
    known = Hamiltonian(
        "(p_x - p_theta*cos(theta)/l)**2/(2*(2 + m*sin(theta)**2)) + p_theta**2/(2*m*l**2)"
        "- m*g*l*cos(theta)",
        q=["x", "theta"],
        p=["p_x", "p_theta"],
    )
    difference = H.real_equations.expr.subs({m: sympy.Symbol("m", real=True)}) - known.expr
    same = {symbol: sympy.Symbol(symbol.name, real=True) for symbol in (m, length, g)}
    assert sympy.simplify(difference.xreplace(same)) == 0


def test_another_symbol_of_time_becomes_t() -> None:
    tau = sympy.Symbol("tau")
    x = sympy.Function("x")(tau)
    H = Hamiltonian.from_lagrangian(x.diff(tau) ** 2 / 2 - tau * x)
    assert H.time is not None
    assert H.time.name == "t"


def test_parameters_that_cancel_are_left_out() -> None:
    H = Hamiltonian.from_lagrangian("xdot**2/2 + a*xdot - a*xdot", parameters=None)
    assert H.parameter_names == ()
    H = Hamiltonian.from_lagrangian("m*xdot**2/2", parameters={"m": 2})
    assert dict(H.parameters) == {"m": 2.0}


@pytest.mark.parametrize(
    ("names", "pairs"),
    [
        ("xdot", [("x", "xdot")]),
        ("x_dot x m", [("x", "x_dot")]),
        ("dx x", [("x", "dx")]),
        ("dx", [("x", "dx")]),
        ("d_theta1 theta1", [("theta1", "d_theta1")]),
        ("x_1 x1dot", [("x_1", "x1dot")]),
        ("xdot1 x2dot x_dot_3", [("x1", "xdot1"), ("x2", "x2dot"), ("x_3", "x_dot_3")]),
        ("θ dtheta", [("θ", "dtheta")]),
        ("u udot delta d dt", [("u", "udot")]),
        ("Rdot R", [("R", "Rdot")]),
        ("xdot dm", [("x", "xdot")]),
    ],
)
def test_velocities_pair_by_name(names: str, pairs: list[tuple[str, str]]) -> None:
    assert find_velocities(names.split()) == pairs


@pytest.mark.parametrize(
    ("text", "mentions"),
    [
        ("m*v**2/2", ["no velocity", "m, v", "xdot"]),
        ("xdot**2 + dx*x", ["'dx' and 'xdot'", "velocity of x", "velocities=[...]"]),
        ("x1dot**2 + x1*x_1", ["'x1dot'", "x1 or x_1"]),
        ("xdot**2/2 + p_x*x", ["'p_x'", "p=[...]"]),
        ("xdot**2/2 + x*xddot", ["'xddot'", "second derivative"]),
    ],
)
def test_ambiguous_velocities_are_refused(text: str, mentions: list[str]) -> None:
    with pytest.raises(VariableError) as caught:
        Hamiltonian.from_lagrangian(text)
    for mention in mentions:
        assert mention in str(caught.value)


@pytest.mark.parametrize(
    ("text", "mentions"),
    [
        ("xdot - x", ["singular", "xdot"]),
        ("xdot**2/2 + x*ydot", ["singular", "quadratic in ydot"]),
        ("(xdot + ydot)**2/2 + zdot**2", ["singular", "xdot - ydot"]),
        ("(a*xdot + ydot)**2/2", ["singular", "-a*ydot + xdot"]),
        ("sin(u)**2*xdot**2 + cos(u)**2*xdot**2 - xdot**2 + x", ["singular", "xdot"]),
        ("xdot**3/3 - x", ["not quadratic in the velocities xdot", "give H"]),
        ("(xdot**2 + ydot**2)*xdot**2", ["not quadratic in the velocities xdot, ydot"]),
        ("abs(xdot) + xdot**2", ["Abs(xdot)", "velocities"]),
    ],
)
def test_lagrangians_without_transform_are_refused(text: str, mentions: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        Hamiltonian.from_lagrangian(text)
    for mention in mentions:
        assert mention in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "error", "mention"),
    [
        ({"expression": "xdot^2"}, ParseError, "column 5"),
        ({"expression": "xdot**2", "q": ["x"]}, VariableError, "q is given without velocities"),
        ({"expression": "u**2", "q": ["x", "y"], "velocities": ["u"]}, VariableError, "pair"),
        ({"expression": "u**2", "q": ["x"], "velocities": ["u"], "p": ["u"]}, VariableError, "u"),
        ({"expression": "u**2", "q": ["x"], "velocities": ["w"]}, VariableError, "'w'"),
        ({"expression": "xdot**2", "parameters": {"k": 1}}, ParameterError, "occur in L"),
        ({"expression": "m*xdot**2", "parameters": {"m": "a"}}, ParameterError, "finite"),
        ({"expression": None}, InputError, "a Lagrangian must be"),
    ],
)
def test_unusable_arguments_are_refused(
    arguments: dict[str, object], error: type[Exception], mention: str
) -> None:
    with pytest.raises(error, match=mention):
        Hamiltonian.from_lagrangian(**arguments)


def test_explicit_names() -> None:
    H = Hamiltonian.from_lagrangian(
        "m*u**2/2 + u*w + w**2 - a*b", q=["a", "b"], velocities=["u", "w"]
    )
    assert H.names == ("a", "b", "p_a", "p_b")
    H = Hamiltonian.from_lagrangian("u**2/2 - a", q=["a"], velocities=["u"], p=["w"])
    assert str(H.expr) == "a + w**2/2"


@pytest.mark.parametrize(
    "make",
    [
        lambda x, t: x.diff(t, 2) * x,
        lambda x, t: x.diff(t) ** 2 + sympy.Function("y")(t),
        lambda x, t: x.diff(t) ** 2 + sympy.Symbol("x"),
        lambda x, t: x.diff(t) ** 2 + sympy.Function("y")(2 * t),
    ],
)
def test_unusable_functions_of_time_are_refused(make) -> None:  # type: ignore[no-untyped-def]
    t = sympy.Symbol("t")
    with pytest.raises(VariableError, match=r"x|y"):
        Hamiltonian.from_lagrangian(make(sympy.Function("x")(t), t))


CHAIN = " + ".join(f"m{i}*x{i}dot**2/2 - (x{i} - x{i + 1})**4" for i in range(10))
COUPLED = f"{CHAIN} + x10dot**2 + " + " + ".join(f"a{i}*x{i}dot*x{i + 1}dot" for i in range(9))
PENDULA = "M*xdot**2/2 + " + " + ".join(
    f"m{i}*(l{i}**2*dtheta{i}**2 + 2*l{i}*xdot*dtheta{i}*cos(theta{i}) + xdot**2)/2"
    for i in range(1, 10)
)


@pytest.mark.slow
def test_cart_with_nine_pendula_has_a_short_hamiltonian() -> None:
    """The pendula are eliminated first: T is a sum of nine squares and that of the cart."""
    H = Hamiltonian.from_lagrangian(PENDULA)
    assert sympy.count_ops(H.expr) < 500
    at = {symbol: sympy.Rational(k + 3, 7) for k, symbol in enumerate(H.expr.free_symbols)}
    named = {symbol.name: value for symbol, value in at.items()}
    moving = named["M"] + sum(
        named[f"m{i}"] * sympy.sin(named[f"theta{i}"]) ** 2 for i in range(1, 10)
    )
    cart = H.expr.diff(sympy.Symbol("p_x", real=True), 2).xreplace(at)
    assert abs((1 / cart - moving).evalf(30)) < 1e-25


@pytest.mark.slow
def test_ten_coupled_velocities_with_symbolic_masses() -> None:
    H = Hamiltonian.from_lagrangian(COUPLED)
    generator = random.Random(2)
    at = {
        symbol: sympy.Rational(generator.randint(100, 300), 100)
        for symbol in sorted(H.expr.free_symbols, key=str)
    }
    mass = sympy.zeros(11)
    named = {symbol.name: value for symbol, value in at.items()}
    for i in range(10):
        mass[i, i] = named[f"m{i}"]
        if i < 9:
            mass[i, i + 1] = mass[i + 1, i] = named[f"a{i}"]
    mass[10, 10] = 2
    momenta = sympy.Matrix([at[p] for p in H.p])
    potential = H.expr.xreplace(dict.fromkeys(H.p, 0))
    kinetic = (momenta.T * mass.LUsolve(momenta))[0] / 2
    assert (H.expr - potential).xreplace(at) == kinetic


@pytest.mark.slow
def test_dense_constant_matrix_of_ten() -> None:
    generator = random.Random(0)
    mass = sympy.Matrix(10, 10, lambda *_: generator.randint(-3, 3))
    mass = mass.T * mass + sympy.eye(10)
    rates = sympy.Matrix(sympy.symbols("x:10dot"))
    H = Hamiltonian.from_lagrangian(sympy.expand((rates.T * mass * rates)[0] / 2))
    assert H.hessian[10:, 10:] == mass.inv()


def test_effort_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(legendre, "MAX_EFFORT", 10_000)
    with pytest.raises(InputError, match="too long to solve symbolically"):
        Hamiltonian.from_lagrangian(DOUBLE_PENDULUM)


def test_values_of_parameters_that_make_the_mass_matrix_singular_are_refused() -> None:
    coupled = "(xdot**2 + ydot**2)/2 + k*xdot*ydot - x*y"
    with pytest.raises(InputError, match="singular for k = 1"):
        Hamiltonian.from_lagrangian(coupled, parameters={"k": 1})
    found = Hamiltonian.from_lagrangian(coupled, parameters={"k": 0.5})
    assert found.parameters == {"k": 0.5}
