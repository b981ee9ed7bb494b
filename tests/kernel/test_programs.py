"""Straight-line programs in the library: values, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
import sympy

from hamsym.codegen.programs import program_of, programs_of
from hamsym.errors import CodeGenerationError
from hamsym.kernel import loops
from hamsym.systems import CATALOGUE

X, Y = sympy.symbols("x y", real=True)
SINE, COSINE = 11, 12  # operations of the library


@pytest.mark.slow_cases("argon_crystal", "pleiades")
@pytest.mark.parametrize("name", CATALOGUE)
def test_programs_are_the_equations(name: str) -> None:
    problem = CATALOGUE[name]()
    H, system = problem.H, problem.H.compile("numpy")
    programs = programs_of(H.real_equations)
    noise = np.random.default_rng(0).uniform(0.98, 1.02, (11, H.dim))
    z, t = np.array(problem.z0) * noise + 1e-3, np.linspace(0.1, 0.9, 11)
    values = np.array([H.parameters[name] for name in H.parameter_names], dtype=float)
    arguments = system.arguments(z, t)
    second = system.curvature(*arguments) if H.forces else system.hessian(*arguments)
    wanted = {
        "velocity": system.vector_field(*arguments)[:, : H.dof],
        "force": system.vector_field(*arguments)[:, H.dof :],
        "hessian": second[(slice(None), *np.transpose([*H.real_equations.stored_curvature]))],
        "energy": system.energy(*arguments)[:, None],
    }
    for part, exact in wanted.items():
        if part in programs.arrays:
            found = programs.program(part)(z.T, t, values).T
            np.testing.assert_allclose(found, exact, rtol=1e-11, atol=1e-12 * np.abs(exact).max())


@pytest.mark.parametrize(
    "formula",
    """x*y - 3*x/7; x**5 + y**(-3); x**2.5 - 1/sqrt(y); x**y; pi*x + sqrt(2); atan2(x, y);
    abs(x - 2); sign(x - 1); Min(x, y, 1); Max(x, y, 2); tan(x) + acot(y); E**x; tanh(x);
    sinh(x) - cosh(y); asinh(x) + acosh(y + 1); atanh(x/9); erf(x); asin(x/9) - acos(y/9); log(x);
    sec(x) + csc(y); x; 3; Heaviside(x - 1); cos(x)*sin(y*cos(x)) + sin(x);
    cos(sin(x)) + sin(sin(x)) + sin(cos(x)) - cos(cos(x))""".split(";"),
)
def test_formulas_have_the_values_of_sympy(formula: str) -> None:
    expression = sympy.sympify(formula, {"x": X, "y": Y})
    z = np.random.default_rng(1).uniform(0.5, 2.5, (2, 13))
    found = program_of([expression], [X, Y], None, [])(z, np.zeros(13), np.empty(0))
    wanted = [expression.evalf(20, subs={X: x, Y: y}) for x, y in z.T]
    np.testing.assert_allclose(found[0], np.array(wanted, dtype=float), rtol=1e-14, atol=1e-15)


def test_sine_and_cosine_of_a_row_follow_each_other() -> None:
    program = program_of([sympy.cos(X * Y) + Y * sympy.sin(X * Y)], [X, Y], None, [])
    kinds = program.arrays["step"][:, 0].tolist()
    assert kinds.index(SINE) + 1 == kinds.index(COSINE)


@pytest.mark.parametrize(
    ("rows", "wanted"),
    [
        (((2, 3), (4, 3)), np.sin),  # (row of the result, row of the argument)
        (((2, 3), (3, 3)), np.sin),  # the cosine replaces the argument
        (((2, 3), (2, 3)), np.cos),  # or the sine
        (((3, 3), (2, 3)), lambda x: np.cos(np.sin(x))),
        (((2, 3), (2, 2)), lambda x: np.cos(np.sin(x))),
    ],
)
def test_pairs_have_the_values_of_steps_one_by_one(rows, wanted) -> None:
    """Rows are x, the time, the result and two intermediate values, the first of which is x."""
    (sine, of), (cosine, of_other) = rows
    steps = [(0, 3, 0, 0), (SINE, sine, of, of), (COSINE, cosine, of_other, of_other)]
    program = loops.Program(1, 0, 1, intermediates=2, steps=steps)
    x = np.linspace(-4.0, 4.0, 8)
    found = program(x[None], np.zeros(8), np.empty(0))[0]
    np.testing.assert_allclose(found, wanted(x), atol=1e-15)


def test_results_may_repeat_inputs_and_numbers() -> None:
    program = program_of([X, X, sympy.Integer(3), X * Y, X * Y], [X, Y], None, [])
    z = np.array([[1.0, 2.0], [5.0, 7.0]])
    found = program(z, np.zeros(2), np.empty(0))
    np.testing.assert_array_equal(found, [z[0], z[0], [3, 3], z[0] * z[1], z[0] * z[1]])


def test_function_that_the_library_lacks_is_named() -> None:
    with pytest.raises(CodeGenerationError, match="gamma"):
        program_of([sympy.gamma(X)], [X, Y], None, [])


def _is_sound(inputs: int, results: int, rows: int, steps: np.ndarray) -> bool:
    written = set(range(inputs))
    for operation, out, first, second in steps:
        sound = 0 <= operation < 28 and inputs <= out < rows and {first, second} <= written
        if not sound:
            return False
        written.add(out)
    return written >= set(range(inputs, inputs + results))


@pytest.mark.parametrize("seed", range(100))
def test_random_programs_run_or_are_refused(seed: int) -> None:
    """A program reads and writes rows of its own only, each after it was written."""
    random = np.random.default_rng(seed)
    dim, parameters, results, intermediates = random.integers([1, 0, 1, 0], 5)
    numbers = random.normal(size=random.integers(0, 3))
    inputs = int(dim + 1 + parameters + len(numbers))
    rows = int(inputs + results + intermediates)
    wild = random.random() < 0.5
    low, high = (-3, rows + 3) if wild else (0, inputs)
    steps = np.stack(
        [
            random.integers(-2, 31, 12) if wild else random.integers(0, 28, 12),
            random.integers(*((low, high) if wild else (inputs, rows)), 12),
            random.integers(low, high, 12),
            random.integers(low, high, 12),
        ],
        axis=1,
    )
    steps = steps[: random.integers(0, 13)]
    given = {"numbers": numbers, "intermediates": int(intermediates), "steps": steps}
    if not _is_sound(inputs, int(results), rows, steps):
        with pytest.raises(ValueError, match="row"):
            loops.Program(int(dim), int(parameters), int(results), **given)
        return
    program = loops.Program(int(dim), int(parameters), int(results), **given)
    found = program(random.normal(size=(dim, 5)), np.arange(5.0), random.normal(size=parameters))
    assert found.shape == (results, 5)


@pytest.mark.parametrize("operands", [(0, 3), (3, 0)])
def test_rows_are_written_before_they_are_read(operands: tuple[int, int]) -> None:
    """The state, the time, a result and an intermediate value are rows 0 to 3."""
    with pytest.raises(ValueError, match="row"):
        loops.Program(1, 0, 1, intermediates=1, steps=[(2, 2, *operands)])


@pytest.mark.parametrize("counts", [(-1, 0, 1), (1, -1, 1), (2**40, 0, 1), (1, 0, 2**62)])
def test_impossible_numbers_of_rows_are_refused(counts: tuple[int, int, int]) -> None:
    with pytest.raises(ValueError, match="row"):
        loops.Program(*counts)
