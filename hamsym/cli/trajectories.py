"""Commands that compute trajectories: solve, compare, integrate."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from hamsym.cli.command import Report, command, completing, report_of
from hamsym.cli.options import (
    Draw,
    Output,
    figure_options,
    hamiltonian_options,
    integrator_options,
    integrators,
    output_options,
    rows_option,
    show_methods,
    start_options,
)
from hamsym.cli.output import check_directory, write_certificate
from hamsym.cli.sharing import check_export
from hamsym.cli.solver_options import SolverCommand
from hamsym.cli.texts import NAMES

if TYPE_CHECKING:
    from hamsym.hamiltonian import Hamiltonian


@command(
    "Compute a trajectory to a tolerance, with its error.",
    'hamsym solve "p**2/2 + x**2/2 + x**4/4" --z0 x=1.3,p=1 --t-end "4*pi" --tol 1e-9',
    "hamsym solve pendulum",
    'hamsym solve "p**2/2 - cos(x)" --z0 1,0 --t-end 20 -o orbit.hamsym --plot orbit.png',
    'hamsym solve "p**2/2 - cos(x)" --z0 1,0 --t-end 20 --plot it.png --draw "x, p**2/2"',
    'hamsym solve "p**2/2 + k*x**2/2" -P k=2 --z0 1,0 --t-end 3 --method adam --epochs 200',
    cls=SolverCommand,
)
@hamiltonian_options
@start_options(several=False)
@click.option("--prove", is_flag=True, help="Prove that the error is within the tolerance.")
@click.option(
    "--invariant",
    "invariants",
    multiple=True,
    metavar="FORMULA",
    help="A conserved function, e.g. x*p_y-y*p_x; repeat it.",
)
@click.option("-o", "--output", type=click.Path(), metavar="FILE", help="For hamsym.load.")
@click.option("--export", type=click.Path(), metavar="FILE", help="Code: .py, .json or .h.")
@figure_options
@rows_option
def solve(
    H: Hamiltonian,
    z0: Any,
    span: tuple[float, float],
    draw: Draw,
    output: str | None,
    export: str | None,
    prove: bool,
    rows: int | None,
    **options: Any,
) -> Report:
    """Compute a neural trajectory to a tolerance, or train one; exit 1 if that failed.

    With --prove and -o FILE the proof is written to FILE.certificate.
    """
    from hamsym.solving.solve import solve as run

    check_directory(output)
    check_export(export)
    solution = run(H, z0, span, prove=prove, **options)
    report = report_of(solution, rows)
    if output is not None:  # before printing, which fails on a closed pipe
        solution.save(output)
        report.files.append(output)
        if solution.certificate is not None:
            report.files.append(write_certificate(solution.certificate, output))
    if export is not None and solution.success:
        solution.export(export)
        report.files.append(export)
    elif export is not None:
        report = replace(
            report, text=f"{report.text}\n{export} is not written: the solution failed"
        )
    draw(solution, report)
    return report


@command(
    "Solve, and compare with integrators.",
    'hamsym compare "p**2/2 + x**2/2" --z0 1,0 --t-end 10',
    'hamsym compare "p**2/2 + x**2/2" --z0 1,0 --t-end 10 --with yoshida4,gauss6',
    'hamsym compare "p**2/2 - cos(x)" --z0 1,0 --t-end 5 --tol 1e-6 --max-steps 100000',
    cls=SolverCommand,
)
@hamiltonian_options
@start_options(several=False)
@click.option(
    "--with",
    "methods",
    type=NAMES,
    default="usual",
    help="Integrators, e.g. symplectic_euler,gauss6,dop853.  [three in common use]",
    shell_complete=completing(integrators),
)
@click.option("--max-steps", default=100_000_000, show_default=True, help="Limit of the search.")
@figure_options
def compare(
    H: Hamiltonian,
    z0: Any,
    span: tuple[float, float],
    methods: list[str],
    max_steps: int,
    draw: Draw,
    **options: Any,
) -> Report:
    """Solve, and compare with integrators at K, 10 K and 100 K steps."""
    from hamsym.solving.solve import solve as run
    from hamsym.study.compare import chosen_methods
    from hamsym.study.compare import compare as run_comparison

    names = chosen_methods(H, methods)
    solution = run(H, z0, span, **options)
    comparison = run_comparison(solution, names, max_steps=max_steps)
    report = report_of(comparison)
    draw(comparison, report)
    return report


@command(
    "Integrate with a time-stepping method.",
    'hamsym integrate "p**2/2 + x**2/2 + x**4/4" --z0 x=1.3,p=1 --t-end 20 --tol 1e-9',
    'hamsym integrate "p**2/2 - cos(x)" --z0 1,0 --t-end 9 --method gauss4 --dt 0.01 -o s.csv',
)
@click.option(
    "--list",
    is_eager=True,
    is_flag=True,
    expose_value=False,
    callback=show_methods,
    help="Show the methods and exit.",
)
@hamiltonian_options
@start_options(several=True)
@integrator_options
@click.option("--tol", type=float, help="Choose the steps for this relative error.")
@click.option("--saves", type=int, help="With --tol: intervals between saved states  [100]")
@click.option("--save-every", type=int, help="Steps between saved states  [1, more for long runs]")
@click.option("--compensated", is_flag=True, help="Use compensated summation.")
@click.option("--omega", type=float, help="Coupling of tao2 and tao4.")
@click.option("--rtol", type=float, help="For dop853 and odeint  [1e-13]")
@click.option("--atol", type=float, help="For dop853 and odeint  [1e-13]")
@output_options("States as .csv or .npz.")
@rows_option
def integrate(
    H: Hamiltonian, z0: Any, span: tuple[float, float], rows: int | None, **options: Any
) -> Output:
    """Integrate with a time-stepping method; exit 1 if it had to stop early.

    Without method and steps, steps are chosen for an energy drift of 1e-9; with a method alone
    there are 20,000 steps. A large drift is a warning on standard error. With --tol the steps of
    each trajectory are chosen for an estimated error; exit 1 if one does not meet it.
    """
    import numpy as np

    from hamsym.integrators.integrate import integrate as run

    trajectory = run(H, z0, span, **options)
    count = len(trajectory.ensemble)
    states = trajectory.z.reshape(-1, H.dim)
    columns = [("t", np.tile(trajectory.t, count)), *zip(H.names, states.T, strict=True)]
    columns.append(("H", trajectory.energy.ravel()))
    if trajectory.z.ndim > 2:
        columns.insert(0, ("trajectory", np.repeat(np.arange(count), len(trajectory.t))))
    arrays = {"t": trajectory.t, "z": trajectory.z, "energy": trajectory.energy}
    if trajectory.errors is not None:
        arrays["errors"] = trajectory.errors
        arrays["success"] = np.asarray(trajectory.success)
    return trajectory, report_of(trajectory, rows), columns, arrays
