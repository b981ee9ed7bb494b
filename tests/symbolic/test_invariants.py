"""Known first integrals are found, none is invented, and false ones are refused."""

from __future__ import annotations

import pickle
import random
from fractions import Fraction

import mpmath
import numpy as np
import pytest
import sympy

from hamsym import Hamiltonian, Invariant
from hamsym.errors import InputError
from hamsym.symbolic.invariants import is_proven

PLANE = "(p_x**2 + p_y**2)/2"
SPACE = "(p_x**2 + p_y**2 + p_z**2)/2"
R2, R3 = "sqrt(x**2 + y**2)", "sqrt(x**2 + y**2 + z**2)"
L_X, L_Y, L_Z = "y*p_z - z*p_y", "z*p_x - x*p_z", "x*p_y - y*p_x"
LINE3 = "(p_1**2 + p_2**2 + p_3**2)/2"
LINE4 = "(p_1**2 + p_2**2 + p_3**2 + p_4**2)/2"
SUM3, SUM4 = "p_1 + p_2 + p_3", "p_1 + p_2 + p_3 + p_4"

# H, the degree of the search, and published invariants or ones derived by hand. Sources: Goldstein,
# "Classical Mechanics" (central forces, Kepler, oscillators, tops); Flaschka, Phys. Rev. B 9 (1974)
# (Toda); Moser, Adv. Math. 16 (1975) (Calogero-Moser); Ramani, Dorizzi & Grammaticos, Phys. Rev.
# Lett. 49 (1982) (cubic and quartic potentials); Holt, J. Math. Phys. 23 (1982); Fokas &
# Lagerstrom, J. Math. Anal. Appl. 74 (1980); Fris et al., Phys. Lett. 16 (1965)
# (Smorodinsky-Winternitz).
KNOWN: dict[str, tuple[str, int, list[str]]] = {
    "Kepler in the plane": (
        f"{PLANE} - 1/{R2}",
        3,
        [L_Z, f"p_y*({L_Z}) - x/{R2}", f"-p_x*({L_Z}) - y/{R2}"],
    ),
    "Kepler with a mass and a coupling": (
        f"(p_x**2 + p_y**2 + p_z**2)/(2*m) - k/{R3}",
        3,
        [
            L_X,
            L_Y,
            L_Z,
            f"p_y*({L_Z}) - p_z*({L_Y}) - m*k*x/{R3}",
            f"p_z*({L_X}) - p_x*({L_Z}) - m*k*y/{R3}",
            f"p_x*({L_Y}) - p_y*({L_X}) - m*k*z/{R3}",
        ],
    ),
    "Kepler in polar coordinates": ("p_r**2/2 + p_phi**2/(2*r**2) - 1/r", 2, ["p_phi"]),
    "Kepler in a uniform force": (
        f"{PLANE} - 1/{R2} + F*x",
        3,
        [f"p_y*({L_Z}) - x/{R2} - F*y**2/2"],
    ),
    "two centres": (
        f"{PLANE} - a/sqrt((x - 1)**2 + y**2) - b/sqrt((x + 1)**2 + y**2)",
        4,
        [
            f"({L_Z})**2 - p_y**2 - 2*a*(x - 1)/sqrt((x - 1)**2 + y**2)"
            "+ 2*b*(x + 1)/sqrt((x + 1)**2 + y**2)"
        ],
    ),
    "central quartic": (f"{PLANE} + (x**2 + y**2)**2", 2, [L_Z]),
    "central cubic root": (f"{SPACE} + (x**2 + y**2 + z**2)**(1/3)", 2, [L_X, L_Y, L_Z]),
    "logarithmic potential": (f"{SPACE} + log(x**2 + y**2 + z**2)", 2, [L_X, L_Y, L_Z]),
    "Yukawa": (f"{SPACE} - exp(-{R3})/{R3}", 2, [L_X, L_Y, L_Z]),
    "axial potential": (f"{SPACE} + (x**2 + y**2)*z**2 + z**4", 2, [L_Z]),
    "relativistic Kepler": (f"sqrt(1 + p_x**2 + p_y**2) - 1/{R2}", 2, [L_Z]),
    "isotropic oscillator": (f"{PLANE} + (x**2 + y**2)/2", 2, [L_Z, "p_x*p_y + x*y"]),
    "isotropic oscillator with symbols": (
        "(p_x**2 + p_y**2)/(2*m) + k*(x**2 + y**2)/2",
        2,
        [L_Z, "p_x*p_y + k*m*x*y", "p_x**2 + k*m*x**2"],
    ),
    "isotropic oscillator in space": (
        f"{SPACE} + (x**2 + y**2 + z**2)/2",
        2,
        [L_X, L_Y, L_Z, "p_x*p_y + x*y", "p_y*p_z + y*z", "p_x**2 + x**2"],
    ),
    "oscillator 1:2": (
        f"{PLANE} + (x**2 + 4*y**2)/2",
        3,
        ["p_x**2 + x**2", f"p_x*({L_Z}) + x**2*y"],
    ),
    "oscillator 1:3": (
        f"{PLANE} + (x**2 + 9*y**2)/2",
        4,
        ["p_x**2 + x**2", "(x**3 - 3*x*p_x**2)*y*3 + (3*x**2*p_x - p_x**3)*p_y"],
    ),
    "oscillator 2:3": (
        f"{PLANE} + (4*x**2 + 9*y**2)/2",
        5,
        [
            "p_x**2 + 4*x**2",
            "(8*x**3 - 6*x*p_x**2)*(9*y**2 - p_y**2) + (12*x**2*p_x - p_x**3)*6*y*p_y",
        ],
    ),
    "oscillator without resonance": (
        f"{PLANE} + (a*x**2 + b*y**2)/2",
        2,
        ["p_x**2 + a*x**2", "p_y**2 + b*y**2"],
    ),
    "four coupled oscillators": (
        f"{LINE4} + ((q_1-q_2)**2 + (q_2-q_3)**2 + (q_3-q_4)**2 + (q_4-q_1)**2)/2",
        2,
        [SUM4, "(p_1 - p_2 + p_3 - p_4)**2 + 4*(q_1 - q_2 + q_3 - q_4)**2"],
    ),
    "free particle in the plane": (PLANE, 2, ["p_x", "p_y", L_Z]),
    "free particle in space": (SPACE, 2, ["p_x", "p_y", "p_z", L_X, L_Y, L_Z]),
    "free fall": (f"{PLANE} + g*y", 3, ["p_x", "p_y*p_x + g*x"]),
    "separable quartic": (f"{PLANE} + x**4 + 3*y**4 + y**3", 4, ["p_x**2 + 2*x**4"]),
    "quartic 1:6:1": (f"{PLANE} + x**4 + 6*x**2*y**2 + y**4", 4, ["p_x*p_y + 4*x*y*(x**2 + y**2)"]),
    "quartic 1:12:16": (
        f"{PLANE} + x**4 + 12*x**2*y**2 + 16*y**4",
        5,
        [f"p_x*({L_Z}) + 4*x**4*y + 8*x**2*y**3"],
    ),
    "quartic 1:6:8": (
        f"{PLANE} + x**4 + 6*x**2*y**2 + 8*y**4",
        8,
        [
            "p_x**4 + 4*x**2*(x**2 + 6*y**2)*p_x**2 - 16*x**3*y*p_x*p_y + 4*x**4*p_y**2"
            "+ 4*x**4*(x**4 + 4*x**2*y**2 + 4*y**4)"
        ],
    ),
    "Garnier": (
        f"{PLANE} + (x**2 + y**2)**2 - a*x**2 - b*y**2",
        4,
        [f"({L_Z})**2 + (a - b)*(p_x**2 + 2*x**2*(x**2 + y**2) - 2*a*x**2)"],
    ),
    "Henon-Heiles 1:1 with the other sign": (
        f"{PLANE} + (x**2 + y**2)/2 + x**2*y + y**3/3",
        3,
        ["p_x*p_y + x*y + x*y**2 + x**3/3"],
    ),
    "Henon-Heiles, ratio 6": (
        f"{PLANE} + (A*x**2 + B*y**2)/2 + x**2*y + 2*y**3",
        4,
        ["x**4 + 4*x**2*y**2 + 4*p_x*(p_y*x - p_x*y) + 4*A*x**2*y+ (4*A - B)*(p_x**2 + A*x**2)"],
    ),
    "Henon-Heiles, ratio 16": (
        f"{PLANE} + (A*x**2 + 16*A*y**2)/2 + x**2*y + 16*y**3/3",
        6,
        [
            "3*p_x**4 + 6*(A + 2*y)*x**2*p_x**2 - 4*x**3*p_x*p_y"
            "- 4*x**4*(A*y + y**2) + 3*A**2*x**4 - 2*x**6/3"
        ],
    ),
    "Holt": (
        f"{PLANE} + (c*x**2 + 3*c*y**2/4)*y**(-2/3)",
        4,
        ["2*p_x**3 + 3*p_x*p_y**2 + 3*c*p_x*(2*x**2*y**(-2/3) - 3*y**(4/3))+ 18*c*p_y*x*y**(1/3)"],
    ),
    "Fokas-Lagerstrom": (
        f"{PLANE} + (x**2 - y**2)**(-2/3)",
        4,
        [f"({L_Z})*(p_x**2 - p_y**2) - 4*(y*p_x + x*p_y)*(x**2 - y**2)**(-2/3)"],
    ),
    "Smorodinsky-Winternitz": (
        f"{PLANE} + (x**2 + y**2)/2 + a/x**2 + b/y**2",
        4,
        ["p_x**2 + x**2 + 2*a/x**2", f"({L_Z})**2 + 2*a*y**2/x**2 + 2*b*x**2/y**2"],
    ),
    "two particles of Calogero": ("(p_1**2 + p_2**2)/2 + g/(q_1 - q_2)**2", 2, ["p_1 + p_2"]),
    "Calogero-Moser": (
        f"{LINE3} + g/(q_1-q_2)**2 + g/(q_2-q_3)**2 + g/(q_3-q_1)**2",
        3,
        [SUM3, "p_1*p_2*p_3 - g*(p_1/(q_2-q_3)**2 + p_2/(q_3-q_1)**2 + p_3/(q_1-q_2)**2)"],
    ),
    "two particles of Toda": ("(p_1**2 + p_2**2)/2 + exp(q_1 - q_2)", 2, ["p_1 + p_2"]),
    "open Toda": (
        f"{LINE3} + exp(q_1 - q_2) + exp(q_2 - q_3)",
        3,
        [SUM3, "p_1*p_2*p_3 - p_1*exp(q_2 - q_3) - p_3*exp(q_1 - q_2)"],
    ),
    "periodic Toda": (
        f"{LINE3} + exp(q_1 - q_2) + exp(q_2 - q_3) + exp(q_3 - q_1)",
        3,
        [
            SUM3,
            "p_1*p_2*p_3 - p_1*exp(q_2 - q_3) - p_2*exp(q_3 - q_1) - p_3*exp(q_1 - q_2)",
        ],
    ),
    "open Toda of four": (
        f"{LINE4} + exp(q_1 - q_2) + exp(q_2 - q_3) + exp(q_3 - q_4)",
        4,
        [
            SUM4,
            "p_1*p_2*p_3*p_4 - p_3*p_4*exp(q_1-q_2) - p_1*p_4*exp(q_2-q_3)"
            "- p_1*p_2*exp(q_3-q_4) + exp(q_1-q_2+q_3-q_4)",
        ],
    ),
    "chain with cubic springs": (
        f"{LINE3} + ((q_1-q_2)**2 + (q_2-q_3)**2 + (q_3-q_1)**2)/2"
        "+ a*((q_1-q_2)**3 + (q_2-q_3)**3 + (q_3-q_1)**3)",
        2,
        [SUM3],
    ),
    "chain of four with quartic springs": (
        f"{LINE4} + (q_1-q_2)**4 + (q_2-q_3)**4 + (q_3-q_4)**4 + (q_4-q_1)**4",
        2,
        [SUM4],
    ),
    "coupled rotors": ("(p_1**2 + p_2**2)/2 - cos(q_1 - q_2)", 2, ["p_1 + p_2"]),
    "three planar bodies": (
        "(px1**2 + py1**2)/(2*m1) + (px2**2 + py2**2)/(2*m2)"
        "- m1*m2/sqrt((x1 - x2)**2 + (y1 - y2)**2)",
        2,
        ["px1 + px2", "py1 + py2", "x1*py1 - y1*px1 + x2*py2 - y2*px2"],
    ),
    "two vortices": (
        "-log((x_1 - x_2)**2 + (p_1 - p_2)**2)",
        2,
        ["x_1 + x_2", "p_1 + p_2"],
    ),
    "three vortices": (
        "-log((x_1-x_2)**2 + (p_1-p_2)**2) - log((x_2-x_3)**2 + (p_2-p_3)**2)"
        "- log((x_3-x_1)**2 + (p_3-p_1)**2)",
        2,
        ["x_1 + x_2 + x_3", SUM3, "x_1**2 + x_2**2 + x_3**2 + p_1**2 + p_2**2 + p_3**2"],
    ),
    "charge in a magnetic field": (
        "((p_x + B*y/2)**2 + (p_y - B*x/2)**2)/2",
        2,
        ["p_x - B*y/2", "p_y + B*x/2"],
    ),
    "trapped charge in a magnetic field": (
        "((p_x + B*y/2)**2 + (p_y - B*x/2)**2)/2 + (x**2 + y**2)**2",
        2,
        [L_Z],
    ),
    "spherical pendulum": (
        "p_theta**2/2 + p_phi**2/(2*sin(theta)**2) + cos(theta)",
        2,
        ["p_phi"],
    ),
    "Lagrange top": (
        "p_theta**2/2 + (p_phi - p_psi*cos(theta))**2/(2*sin(theta)**2) + p_psi**2/(2*c)"
        "+ g*cos(theta)",
        2,
        ["p_phi", "p_psi"],
    ),
    "forced oscillator": ("p**2/2 + x**2/2 - x*t", 2, ["(p - 1)**2 + (x - t)**2"]),
}


def rotated(name: str, new: dict[str, str]) -> tuple[str, int, list[str]]:
    """A known case in other canonical variables, by a rational substitution."""
    formula, degree, invariants = KNOWN[name]
    symbols = {key: sympy.Symbol(key, real=True) for key in new}
    plane = Hamiltonian("x*p_x + y*p_y")
    values = {symbols[key]: plane.function(text) for key, text in new.items()}

    def changed(text: str) -> str:
        return str(plane.function(text).xreplace(values))

    return changed(formula), degree, [changed(text) for text in invariants]


ROTATION = {
    "x": "(3*x - 4*y)/5",
    "y": "(4*x + 3*y)/5",
    "p_x": "(3*p_x - 4*p_y)/5",
    "p_y": "(4*p_x + 3*p_y)/5",
}
SCALING = {"x": "2*x", "y": "y/3", "p_x": "p_x/2", "p_y": "3*p_y"}
SHIFT = {"x": "x - 2", "y": "y + 1", "p_x": "p_x + 1 + y", "p_y": "p_y + x"}
for case, change, label in (
    ("Henon-Heiles 1:1 with the other sign", ROTATION, "rotated"),
    ("Henon-Heiles 1:1 with the other sign", SCALING, "scaled"),
    ("quartic 1:12:16", ROTATION, "rotated"),
    ("quartic 1:6:1", SCALING, "scaled"),
    ("oscillator 1:2", ROTATION, "rotated"),
    ("Kepler in the plane", SCALING, "scaled"),
    ("oscillator 1:2", SHIFT, "shifted"),
):
    KNOWN[f"{case}, {label}"] = rotated(case, change)

# Generic systems, most of them known to be chaotic, without polynomial invariants of low degree.
NONE: dict[str, tuple[str, int]] = {
    "Henon-Heiles": (f"{PLANE} + (x**2 + y**2)/2 + x**2*y - y**3/3", 4),
    "Henon-Heiles with a coupling": (f"{PLANE} + (x**2 + y**2)/2 + e*(x**2*y - y**3/3)", 3),
    "Barbanis": (f"{PLANE} + (x**2 + y**2)/2 + x**2*y", 4),
    "Yang-Mills": (f"{PLANE} + x**2*y**2/2", 6),
    "quartic 1:3:1": (f"{PLANE} + x**4 + 3*x**2*y**2 + y**4", 4),
    "quartic 1:12:8": (f"{PLANE} + x**4 + 12*x**2*y**2 + 8*y**4", 4),
    "double pendulum": (
        "(p_1**2 + 2*p_2**2 - 2*p_1*p_2*cos(q_1 - q_2))/(2*(1 + sin(q_1 - q_2)**2))"
        "- 2*cos(q_1) - cos(q_2)",
        2,
    ),
    "anisotropic Kepler": (f"p_x**2/2 + p_y**2/3 - 1/{R2}", 3),
    "spring pendulum": ("p_r**2/2 + p_a**2/(2*r**2) + (r - 1)**2 - r*cos(a)", 3),
    "swinging Atwood": ("p_r**2/(2*(1 + M)) + p_a**2/(2*r**2) + r*(M - cos(a))", 3),
    "chain with fixed ends": (
        "(p_1**2 + p_2**2)/2 + q_1**2 + q_2**2 - q_1*q_2"
        "+ (q_1**3 + (q_2 - q_1)**3 - q_2**3)/3 + q_1**4",
        3,
    ),
    "driven Duffing": ("p**2/2 - x**2/2 + x**4/4 - x*cos(2*t)", 3),
    "Duffing": ("p**2/2 - x**2/2 + x**4/4", 4),
    "pendulum": ("p**2/2 - cos(x)", 4),
    "Paul trap": ("p**2/2 + (a - 2*q0*cos(2*t))*x**2/2", 3),
    "hydrogen in a field, reduced": (
        "(p_u**2 + p_z**2)/2 + 1/(2*u**2) - 1/sqrt(u**2 + z**2) + u**2/8",
        3,
    ),
    "Stormer": ("(p_u**2 + p_z**2)/2 + (1/u - u/(u**2 + z**2)**(3/2))**2/2", 2),
    "three charges on a line": ("(p_1**2 + p_2**2)/2 + 1/q_1 + 1/(q_2 - q_1) + q_1**2 + q_2**2", 3),
    "Lennard-Jones with a wall": (f"{PLANE} + 1/(x**2 + y**2)**6 - 1/(x**2 + y**2)**3 + x**2", 2),
    "standing waves": (f"{PLANE} - cos(x)*cos(y) - cos(x)", 3),
}


def random_potential(seed: int) -> tuple[str, int]:
    """A random polynomial or mixed potential of two or three degrees of freedom."""
    generator = random.Random(seed)
    names = ["x", "y", "z"][: 2 + seed % 2]
    kinetic = " + ".join(f"p_{name}**2/2" for name in names)
    terms = []
    for _ in range(5):
        powers = "*".join(f"{name}**{generator.randint(0, 2)}" for name in names)
        terms.append(f"{generator.randint(1, 9)}*{powers}/{generator.randint(1, 5)}")
    coupling = "*".join(names) + " + " + " + ".join(f"{name}**4" for name in names)
    extra = ["", " + cos(x - 2*y)", " + exp(x - y/2)", " + 1/(1 + x**2 + 2*y**2)"][seed % 4]
    return f"{kinetic} + {' + '.join(terms)} + {coupling}{extra}", 3 if seed % 2 == 0 else 2


for seed in range(30):
    NONE[f"random potential {seed}"] = random_potential(seed)


def evaluated(exprs: list[sympy.Expr], z: list[sympy.Symbol], seed: int) -> np.ndarray:
    """Values and gradients at a random point, by sympy's derivatives and 40 digits."""
    generator = random.Random(seed)
    symbols = sorted(set().union(*(expr.free_symbols for expr in exprs), z), key=str)
    point = {s: sympy.Rational(generator.randint(300, 1700), 1000) for s in symbols}
    if "x" in map(str, z):  # real powers of x^2 - y^2
        point[sympy.Symbol("x", real=True)] += 2
    with mpmath.workdps(40):
        return np.array(
            [[mpmath.mpf(e.diff(s).subs(point).evalf(40)) for s in z] for e in exprs], dtype=object
        )


def bracket(f: np.ndarray, h: np.ndarray) -> mpmath.mpf:
    half = len(f) // 2
    with mpmath.workdps(40):
        terms = [f[i] * h[half + i] - f[half + i] * h[i] for i in range(half)]
        return abs(mpmath.fsum(terms)) / (1 + max(abs(term) for term in terms))


@pytest.mark.slow_cases("Calogero-Moser", "open Toda of four")
@pytest.mark.sampled(14)
@pytest.mark.parametrize("name", KNOWN)
def test_published_invariants_are_found(name: str) -> None:
    formula, degree, published = KNOWN[name]
    H = Hamiltonian(formula)
    found = H.invariants(degree)
    assert len(found) >= 1
    real, z = H.real_equations.expr, list(H.real_equations.z)
    own = [H.function(invariant.expr) for invariant in found]
    known = [H.function(text) for text in published]
    for seed in range(2):
        gradients = evaluated([real, *own, *known], z, seed)
        if H.time is None:
            for gradient in gradients[1:]:
                assert bracket(gradient, gradients[0]) < mpmath.mpf(10) ** -30
        # Published ones are functions of H and of those that are found.
        numbers = gradients.astype(float)
        numbers /= np.linalg.norm(numbers, axis=1, keepdims=True)
        count = 1 + len(own) if H.time is None else len(own)
        spanning = numbers[1 - (H.time is None) :][:count]
        rank = np.linalg.matrix_rank(spanning, tol=1e-9)
        assert (
            np.linalg.matrix_rank(np.vstack((spanning, numbers[1 + len(own) :])), tol=1e-9) == rank
        )
        assert rank == sum(invariant.independent for invariant in found) + (H.time is None)


@pytest.mark.sampled(12)
@pytest.mark.parametrize("name", NONE)
def test_nothing_is_found_where_nothing_is_known(name: str) -> None:
    formula, degree = NONE[name]
    assert Hamiltonian(formula).invariants(degree) == []


def test_both_tables_are_long_enough() -> None:
    assert len(KNOWN) >= 50
    assert len(NONE) >= 50


@pytest.mark.slow
def test_generators_are_not_repeated() -> None:
    # Products such as L^2, L H and p_x^2 of lower degree are left out.
    H = Hamiltonian(f"{PLANE} + (x**2 + y**2)**2")
    assert [str(found) for found in H.invariants(6)] == ["p_x*y - p_y*x"]
    # U(3) has nine generators, H is one of them; five are independent.
    found = Hamiltonian(f"{SPACE} + (x**2 + y**2 + z**2)/2").invariants(4)
    assert len(found) == 8
    assert sum(own.independent for own in found) == 4


def test_invariants_have_the_symbols_of_the_caller() -> None:
    q, p = sympy.symbols("q1:3"), sympy.symbols("p1:3")
    H = Hamiltonian((p[0] ** 2 + p[1] ** 2) / 2 + (q[0] - q[1]) ** 4, q=q, p=p)
    (found,) = H.invariants(1)
    assert found.expr == p[0] + p[1]


def test_values_are_named_where_an_invariant_needs_them() -> None:
    H = Hamiltonian(f"{PLANE} + (x**2 + y**2)/2 + x**2*y + c*y**3", parameters={"c": 0.25})
    assert H.invariants(4) == []
    (found,) = H.with_parameters(c=2.0).invariants(4)
    assert dict(found.holds_for) == {"c": 2.0}
    assert str(found).endswith("(for c = 2.0)")
    assert pickle.loads(pickle.dumps(found)) == found
    # The nearest number is not the value itself.
    assert H.with_parameters(c=np.nextafter(2.0, 3)).invariants(4) == []
    # An invariant for all values has no values.
    (momentum,) = Hamiltonian("(p_1**2+p_2**2)/2 + k*(q_1-q_2)**4", parameters={"k": 3}).invariants(
        1
    )
    assert not momentum.holds_for


def test_basis_functions_of_the_caller_count() -> None:
    H = Hamiltonian("p_r**2/2 + p_phi**2/(2*r**2) - 1/r")
    assert [str(found) for found in H.invariants(4)] == ["p_phi"]
    found = H.invariants(4, basis=["cos(phi)", "sin(phi)"])
    assert len(found) == 3
    assert all(H.is_conserved(own.expr) for own in found)
    assert H.is_conserved("p_phi**2*cos(phi)/r - cos(phi) + p_r*p_phi*sin(phi)")


def test_time_in_a_basis_function_is_time() -> None:
    H = Hamiltonian("p**2/2 + x**2/2")
    found = H.invariants(2, basis=["cos(t)", "sin(t)"])
    assert found
    assert all(H.is_conserved(own.expr) for own in found)
    assert H.is_conserved("x*cos(t) - p*sin(t)")
    assert not H.is_conserved("cos(t)")
    assert not is_proven(
        sympy.Symbol("t", real=True),
        H.real_equations.expr,
        H.real_equations.z,
        sympy.Symbol("t", real=True),
    )


@pytest.mark.parametrize(
    "name", ["Kepler in the plane", "open Toda", "Henon-Heiles, ratio 6", "Holt"]
)
@pytest.mark.parametrize("change", ["coefficient", "term", "system"])
def test_near_invariants_are_refused(name: str, change: str) -> None:
    formula, _, published = KNOWN[name]
    H = Hamiltonian(formula)
    f, h = H.function(published[-1]), H.real_equations.expr
    proven = (H.real_equations.z, sympy.Symbol("t", real=True))
    assert is_proven(f, h, *proven)
    terms = list(sympy.Add.make_args(sympy.expand(f)))
    if change == "coefficient":
        for k in range(len(terms)):
            for factor in (1 + Fraction(1, 10**12), 1 - Fraction(1, 10**30)):
                other = [*terms[:k], sympy.Rational(factor) * terms[k], *terms[k + 1 :]]
                assert not is_proven(sympy.Add(*other), h, *proven)
    elif change == "term":
        for extra in (*H.real_equations.z, *(1e-300 * s for s in H.real_equations.z)):
            assert not is_proven(f + extra, h, *proven)
    else:
        first = H.real_equations.z[0]
        assert not is_proven(f, h + sympy.Float(1e-12) * first**2, *proven)
        for symbol in H.real_equations.parameters:
            value = {sympy.Symbol(symbol, real=True): sympy.Rational(1, 3)}
            nearly = {sympy.Symbol(symbol, real=True): sympy.Float(1 / 3)}
            assert not is_proven(f.xreplace(value), h.xreplace(nearly), *proven)


def test_what_the_search_proposes_is_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    from hamsym.symbolic import invariants

    exact = invariants._Search._exact

    def wrong(self: object, terms: list[tuple[int, ...]]) -> list[sympy.Expr]:
        first, *rest = exact(self, terms)  # type: ignore[arg-type, misc]
        return [first * (1 + sympy.Rational(1, 10**12)), *rest]

    H = Hamiltonian(f"{PLANE} + (x**2 + y**2)**2")
    assert len(H.invariants(2)) == 1
    monkeypatch.setattr(invariants._Search, "_exact", wrong)
    assert H.invariants(2) == []


@pytest.mark.parametrize(
    ("formula", "options", "sentence"),
    [
        (PLANE, {"degree": 0}, "degree=0 cannot be used"),
        (PLANE, {"degree": 2.0}, "degree=2.0 cannot be used"),
        (PLANE, {"time_limit": 0}, "time_limit=0 cannot be used"),
        (PLANE, {"degree": 40}, "more than 20,000 monomials"),
        (PLANE, {"basis": ["2"]}, "does not depend on the state"),
        (PLANE, {"basis": ["u"]}, "'u' does not occur in H"),
        (f"{PLANE} + max(x, y)", {}, "has no exact rules"),
        (f"{PLANE} + x**(1/97)", {}, "too large for an exact search"),
        (f"{SPACE} + (x + y*z + z**2 + x*y)**4", {"degree": 4, "time_limit": 1e-9}, "did not end"),
    ],
)
def test_unusable_arguments_are_refused(
    formula: str, options: dict[str, object], sentence: str
) -> None:
    with pytest.raises(InputError, match=sentence):
        Hamiltonian(formula).invariants(**options)  # type: ignore[arg-type]


def test_an_invariant_is_printed_as_it_is_parsed() -> None:
    H = Hamiltonian(f"{PLANE} - 1/{R2}")
    for found in H.invariants(3):
        assert isinstance(found, Invariant)
        assert H.function(found.formula) == H.function(found.expr)


def test_results_are_a_list_with_a_table() -> None:
    H = Hamiltonian(
        "(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2 + x**2*y + c*y**3", parameters={"c": 2.0}
    )
    found = H.invariants(4)
    assert isinstance(found, list)
    assert found == list(found)
    again = pickle.loads(pickle.dumps(found))
    assert (again, again.message) == (found, found.message)
    lines = str(found).splitlines()
    assert lines[1].startswith("I_1       4          yes  3*p_x**2 + 3*x**2")
    assert "(for c = 2.0)" in str(found)
    assert max(map(len, lines)) <= 80
    assert "... and 1 invariants" in found.summary(rows=0)
    assert "is no proof of chaos" in H.with_parameters(c=2.1).invariants(2).summary()


STEPS = ["sign(x)", "Heaviside(x - 1)", "x*sign(p)"]
# whose derivatives cancel
HIDDEN_STEPS = ["abs(x)/x", "sqrt(x**2)/x", "atan(tan(x)) - x", "1e-30*(atan(x) + atan(1/x))"]


@pytest.mark.parametrize("step", [*STEPS, *HIDDEN_STEPS])
def test_steps_are_not_conserved(step):
    assert not Hamiltonian("p**2/2 + x**2/2").is_conserved(step)


@pytest.mark.parametrize("forces", [{}, {"p_y": "-y"}])
def test_denominators_that_are_zero_prove_nothing(forces):
    H = Hamiltonian("(p_x**2 + p_y**2)/2", forces=forces)
    assert H.is_conserved("1e-40*p_x/sin(1)")
    for zero in ("sin(x)**2 + cos(x)**2 - 1", "atan(x) + atan(1/x) - pi/2", "log(x**2) - 2*log(x)"):
        assert not H.is_conserved(f"p_x/({zero})")
