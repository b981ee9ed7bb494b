"""Commands that compute trajectories: solve, compare, integrate, lyapunov, section."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from hamsym.cli.options import (
    figure_option,
    hamiltonian_options,
    integrator_options,
    output_options,
    show_methods,
    span_options,
    starts_options,
)
from hamsym.cli.output import (
    check_directory,
    check_figure,
    echo_wrapped,
    report,
    save_figure,
    write_certificate,
)
from hamsym.cli.solver_options import SolverCommand
from hamsym.cli.texts import listed

if TYPE_CHECKING:
    import numpy as np

    from hamsym.dynamics.lyapunov import LyapunovExponents
    from hamsym.hamiltonian import Hamiltonian

__all__ = ["compare", "integrate", "lyapunov", "section", "solve"]

#: A result, the columns of its table, and its arrays.
Output = tuple[Any, list[tuple[str, Any]], dict[str, Any]]


@click.command(cls=SolverCommand)
@hamiltonian_options
@span_options
@figure_option
@click.option("-o", "--output", type=click.Path(), metavar="FILE", help="For hamsym.load.")
@click.option("--prove", is_flag=True, help="Prove that the error is within the tolerance.")
def solve(
    H: Hamiltonian,
    z0: Any,
    span: tuple[float, float],
    figure: str | None,
    output: str | None,
    prove: bool,
    **options: Any,
) -> int:
    """Compute a neural trajectory to a tolerance, or train one; exit 1 if that failed.

    With --prove and -o FILE the proof is written to FILE.certificate.
    """
    from hamsym.solving import solve as run

    check_figure(figure)
    check_directory(output)
    solution = run(H, z0, span, prove=prove, **options)
    written = []
    if output is not None:  # before printing, which fails on a closed pipe
        solution.save(output)
        written.append(output)
        if solution.certificate is not None:
            written.append(write_certificate(solution.certificate, output))
    report(solution)
    for path in written:
        click.echo(f"wrote {path}")
    if figure is not None:
        save_figure(solution.plot(), figure)
    return 0 if solution.success else 1


@click.command(cls=SolverCommand)
@hamiltonian_options
@span_options
@figure_option
@click.option(
    "--with",
    "methods",
    metavar="NAMES",
    default="symplectic_euler",
    show_default=True,
    help="Integrators, e.g. yoshida4,gauss6,dop853.",
)
@click.option("--max-steps", default=100_000_000, show_default=True, help="Limit of the search.")
def compare(
    H: Hamiltonian,
    z0: Any,
    span: tuple[float, float],
    methods: str,
    max_steps: int,
    figure: str | None,
    **options: Any,
) -> int:
    """Solve, and compare with integrators at K, 10 K and 100 K steps."""
    from hamsym.integrators.integrate import usable_method
    from hamsym.solving import solve as run
    from hamsym.study.compare import compare as run_comparison

    check_figure(figure)
    for name in listed(methods):
        usable_method(H, name)
    solution = run(H, z0, span, **options)
    report(solution)
    comparison = run_comparison(solution, listed(methods), max_steps=max_steps)
    click.echo(f"\n{comparison}")
    if figure is not None:
        save_figure(comparison.plot(), figure)
    return 0 if solution.success else 1


@click.command()
@click.option(
    "--list",
    is_eager=True,
    is_flag=True,
    expose_value=False,
    callback=show_methods,
    help="Show the methods and exit.",
)
@hamiltonian_options
@starts_options
@integrator_options
@click.option("--tol", type=float, help="Choose the steps for this relative error.")
@click.option("--saves", type=int, help="With --tol: intervals between saved states  [100]")
@click.option("--save-every", type=int, help="Steps between saved states  [1, more for long runs]")
@click.option("--compensated", is_flag=True, help="Use compensated summation.")
@click.option("--omega", type=float, help="Coupling of tao2 and tao4.")
@click.option("--rtol", type=float, help="For dop853 and odeint  [1e-13]")
@click.option("--atol", type=float, help="For dop853 and odeint  [1e-13]")
@output_options("States as .csv or .npz.")
def integrate(H: Hamiltonian, z0: Any, span: tuple[float, float], **options: Any) -> Output:
    """Integrate with a time-stepping method; exit 1 if it had to stop early.

    Without method and steps, steps are chosen for an energy drift of 1e-9; with a method alone
    there are 20,000 steps. A large drift is a warning on standard error. With --tol the steps of
    each trajectory are chosen for an estimated error; exit 1 if one does not meet it.
    """
    import numpy as np

    from hamsym.integrators.integrate import integrate as run

    trajectory = run(H, z0, span, **options)
    echo_wrapped("", trajectory.message)
    ensemble = trajectory.z.ndim > 2
    count = len(trajectory.ensemble)
    z = trajectory.z.reshape(count, -1, H.dim)[0]
    energy = trajectory.energy.reshape(count, -1)[0]
    if ensemble:
        click.echo(f"{count:,} trajectories, the first of them:")
    click.echo(f"{'':<12}{'start':>24}{'end':>24}")
    for name, values in [("t", trajectory.t), *zip(H.names, z.T, strict=True), ("H", energy)]:
        click.echo(f"{name:<12}{values[0]:>24.15g}{values[-1]:>24.15g}")
    # Rows after the end of a trajectory are nan and are ignored; nan of H at a state is reported.
    exists = np.isfinite(trajectory.z).all(axis=-1)
    change = np.abs(trajectory.energy - trajectory.energy[..., :1])[exists].max()
    click.echo(f"largest change of H: {change:.3e}")
    click.echo(f"{trajectory.evaluations:,} evaluations, {trajectory.seconds:.3g} s")
    states = trajectory.z.reshape(-1, H.dim)
    columns = [("t", np.tile(trajectory.t, count)), *zip(H.names, states.T, strict=True)]
    columns.append(("H", trajectory.energy.ravel()))
    if ensemble:
        columns.insert(0, ("trajectory", np.repeat(np.arange(count), len(trajectory.t))))
    arrays = {"t": trajectory.t, "z": trajectory.z, "energy": trajectory.energy}
    if trajectory.error_estimate is not None:
        arrays["error_estimate"] = trajectory.error_estimate
        arrays["success"] = np.asarray(trajectory.success)
    return trajectory, columns, arrays


_METHODS = "hamsym integrate --list shows the methods."


@click.command(epilog=_METHODS)
@hamiltonian_options
@starts_options
@integrator_options
@click.option("--count", default=1, show_default=True, help="Number of exponents.")
@click.option("--seed", default=0, show_default=True, help="Seed of the tangent vectors.")
@output_options("History, or exponents of several starts, as .csv or .npz.")
def lyapunov(H: Hamiltonian, z0: Any, span: tuple[float, float], **options: Any) -> Output:
    """Compute finite-time Lyapunov exponents and judge whether the trajectory is chaotic.

    Of several starts, the exponents at the end are computed.
    """
    from hamsym.dynamics.lyapunov import LyapunovExponents
    from hamsym.dynamics.lyapunov import lyapunov as run

    found = run(H, z0, span, **options)
    echo_wrapped("", found.statement)
    if isinstance(found, LyapunovExponents):
        return _history(H, found)
    names = [f"exponent {k + 1}" for k in range(found.exponents.shape[1])]
    click.echo("\n" + "".join(f"{name:>14}" for name in ("trajectory", *names[:4])))
    for number, (values, problem) in enumerate(zip(found.exponents, found.message, strict=True)):
        row = "".join(f"{value:>14.4e}" for value in values[:4])
        click.echo(f"{number:>14}{row}")
        if not found.success[number]:
            echo_wrapped(" " * 14, problem)
    click.echo(f"{found.method}: {found.steps.max():,} steps or fewer, {found.seconds:.2g} s")
    columns = [*zip(H.names, found.z0.T, strict=True), *zip(names, found.exponents.T, strict=True)]
    arrays = {"z0": found.z0, "exponents": found.exponents, "success": found.success}
    return found, columns, arrays


def _history(H: Hamiltonian, found: LyapunovExponents) -> Output:
    """Print the exponents of one trajectory over time."""
    import numpy as np

    names = [f"exponent {k + 1}" for k in range(found.exponents.shape[1])]
    if len(names) > 1:
        click.echo("at the end: " + ", ".join(f"{value:.4g}" for value in found.exponents[-1]))
    click.echo(f"\n{'t':>14}" + "".join(f"{name:>14}" for name in names[:4]))
    shown = np.unique(np.searchsorted(np.abs(found.t - found.start), _decades(found)))
    for row in shown[shown < len(found.t)]:
        values = "".join(f"{value:>14.4e}" for value in found.exponents[row, :4])
        click.echo(f"{found.t[row]:>14.6g}{values}")
    if H.time is None:
        click.echo(f"largest change of H: {found.energy_error:.1e}")
    click.echo(f"{found.message}, {found.seconds:.2g} s")
    columns = [("t", found.t), *zip(names, found.exponents.T, strict=True)]
    return found, columns, {"t": found.t, "exponents": found.exponents}


def _decades(found: Any) -> np.ndarray:
    """Return the times of the rows of the table: two in each decade, and the end."""
    import numpy as np

    end = abs(found.t[-1] - found.start)
    return np.append(end * 10.0 ** np.arange(-3, 0, 0.5), end * (1 - 1e-12))


@click.command(epilog=_METHODS)
@hamiltonian_options
@starts_options
@click.option("--at", "surface", required=True, metavar="SURFACE", help='"x = 0, p_x > 0"')
@click.option("--energy", metavar="NUMBER", help="Energy of states that lack one component.")
@integrator_options
@click.option("--crossings", type=int, help="Stop at this number for each trajectory.")
@output_options("Crossings as .csv or .npz.")
def section(H: Hamiltonian, z0: Any, span: tuple[float, float], **options: Any) -> Output:
    """Compute a Poincare section: crossings of a surface, to round-off."""
    from hamsym.dynamics.sections import section as run

    found = run(H, z0, span, **options)
    echo_wrapped("", found.message)
    if H.time is None and len(found.t):
        click.echo(f"largest change of H: {found.energy_error:.1e}")
    click.echo("".join(f"{name:>13}" for name in ("trajectory", "t", *H.names[:4])))
    for number, t, z in list(zip(found.trajectory, found.t, found.z, strict=True))[:5]:
        click.echo(f"{number:>13}{t:>13.6g}" + "".join(f"{value:>13.5g}" for value in z[:4]))
    if len(found.t) > 5:
        click.echo(f"{'...':>13}")
    columns = [("trajectory", found.trajectory), ("t", found.t)]
    columns += zip(H.names, found.z.T, strict=True)
    return found, columns, {"trajectory": found.trajectory, "t": found.t, "z": found.z}
