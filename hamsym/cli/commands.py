"""The command line: derive, source, solve, integrate, ..., certify, verify, reproduce.

Results go to standard output, progress and complaints to standard error. The exit status is 0 if
all went well, 1 if a solution was found wanting or a proof refused, 2 on bad input, with one line
that says why.
"""

from __future__ import annotations

import os
import sys
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hamsym.cli.options import (
    hamiltonian_options,
    listed,
    output_options,
    show_methods,
    solver_options,
    span_options,
    starts_options,
    step_options,
)
from hamsym.cli.output import (
    WIDTH,
    check_figure,
    check_folder,
    echo_wrapped,
    report,
    save_figure,
    write_table,
)
from hamsym.errors import CertificationError, HamsymError, StepSizeWarning
from hamsym.support.atomic import write_atomically

if TYPE_CHECKING:  # each command imports what it runs: --help needs none of it
    import numpy as np

    from hamsym.formula.printer import FormulaPrinter
    from hamsym.hamiltonian import Hamiltonian

__all__ = ["main"]

_CERTIFICATE = ".certificate"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; the entry point of the ``hamsym`` script.

    Returns
    -------
    int
        The exit status.
    """
    # A pipe such as `| head` closes early, and a terminal may lack Greek letters.
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    try:
        with warnings.catch_warnings():
            # A line like that of an error, without the place in the source.
            warnings.simplefilter("always", StepSizeWarning)
            shown = warnings.showwarning
            warnings.showwarning = lambda message, category, *where: (
                _warn(message) if category is StepSizeWarning else shown(message, category, *where)
            )
            status = cli.main(args=arguments, prog_name="hamsym", standalone_mode=False)
        sys.stdout.flush()
        return int(status or 0)
    except click.ClickException as error:
        return _complain(error.format_message(), 2)
    except CertificationError as error:
        return _complain(str(error), 1)
    except HamsymError as error:
        return _complain(str(error), 2)
    except (click.Abort, KeyboardInterrupt):
        return _complain("interrupted", 130)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except OSError as error:
        return _complain(f"{error.filename or 'file'}: {error.strerror or error}", 2)


def _complain(message: str, status: int) -> int:
    print("hamsym: " + " ".join(message.split()), file=sys.stderr)
    return status


def _warn(message: Warning | str) -> None:
    print("hamsym: warning: " + " ".join(str(message).split()), file=sys.stderr)


@click.group(
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": WIDTH},
    invoke_without_command=True,
)
@click.version_option(package_name="hamsym")
@click.pass_context
def cli(context: click.Context) -> None:
    """From a Hamiltonian to its equations, its code, and its trajectories.

    H is a formula such as "p**2/2 + x**2/2 + x**4/4": numbers, pi, names, + - * / **, and
    functions such as sin, exp, sqrt, abs. Numbers may be formulas too: --t-end "4*pi".
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


# -- commands ------------------------------------------------------------------------------------


@cli.command()
@hamiltonian_options
def derive(H: Hamiltonian) -> None:
    """Show H, its equations of motion, its Hessian and what follows from them."""
    from hamsym.formula.printer import FormulaPrinter

    write = FormulaPrinter()
    echo_wrapped("H = ", H.formula)
    echo_wrapped("z = ", f"({', '.join(H.names)})")
    if H.parameter_names:
        values = (
            f"{name} = {H.parameters[name]:g}" if name in H.parameters else name
            for name in H.parameter_names
        )
        echo_wrapped("parameters: ", ", ".join(values))
    click.echo("\nHamilton's equations")
    left = [f"d{name}/dt" for name in H.names]
    width = max(map(len, left))
    for name, rate in zip(left, H.vector_field, strict=True):
        echo_wrapped(f"  {name:<{width}} = ", write(rate))
    click.echo("\nHessian")
    _echo_hessian(H, write)
    click.echo("")
    if H.is_separable:
        click.echo("separable: yes")
        echo_wrapped("  T = ", write(H.kinetic))
        echo_wrapped("  V = ", write(H.potential))
    else:
        click.echo("separable: no, H has mixed second derivatives in q and p")
    cyclic = ", ".join(symbol.name for symbol in H.cyclic_coordinates)
    echo_wrapped("cyclic coordinates: ", cyclic or "none")
    smallest = H.sigma_min
    closed = "no short closed form (computed along solutions)"
    echo_wrapped("sigma_min: ", closed if smallest is None else write(smallest))


def _echo_hessian(H: Hamiltonian, write: FormulaPrinter) -> None:
    matrix = H.hessian
    cells = [[write(matrix[i, j]) for j in range(H.dim)] for i in range(H.dim)]
    widths = [max(len(row[j]) for row in cells) for j in range(H.dim)]
    if sum(widths) + 2 * H.dim + 4 <= WIDTH:
        for row in cells:
            padded = (cell.rjust(size) for cell, size in zip(row, widths, strict=True))
            click.echo(f"  [{'  '.join(padded)}]")
        return
    for i in range(H.dim):
        for j in range(i, H.dim):
            if matrix[i, j] != 0:
                echo_wrapped(f"  d2H/d{H.names[i]} d{H.names[j]} = ", cells[i][j])


@cli.command()
@hamiltonian_options
@click.option("--backend", type=click.Choice(["torch", "numpy", "numba"]), default="torch")
@click.option("--part", metavar="NAME", help="One function, such as loss or vector_field.")
@click.option("-o", "--output", type=click.Path(), metavar="FILE", help="Write to a file.")
def source(H: Hamiltonian, backend: str, part: str | None, output: str | None) -> None:
    """Print the generated code, or write it to a file that runs without hamsym."""
    text = H.source(backend, part).rstrip("\n") + "\n"
    if output is None:
        click.echo(text, nl=False)
    else:
        write_atomically(Path(output), text.encode())
        click.echo(f"wrote {output}")


@cli.command()
@hamiltonian_options
@span_options
@solver_options
@click.option("-o", "--output", type=click.Path(), metavar="FILE", help="For hamsym.load.")
def solve(
    H: Hamiltonian,
    z0: Any,
    span: tuple[float, float],
    figure: str | None = None,
    output: str | None = None,
    **options: Any,
) -> int:
    """Find a neural trajectory to a tolerance, or train one; exit 1 if that failed."""
    from hamsym.solving import solve as run

    check_figure(figure)
    check_folder(output)
    solution = run(H, z0, span, **options)
    if output is not None:
        solution.save(output)  # before anything is printed, which a closed pipe would end
    report(solution)
    if output is not None:
        click.echo(f"wrote {output}")
    if figure is not None:
        save_figure(solution.plot(), figure)
    return 0 if solution.success else 1


_METHODS = "hamsym integrate --list shows the methods."


@cli.command()
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
@click.option("--method", metavar="NAME", help="[blanes_moan6, or gauss6 if not separable]")
@step_options
@click.option("--save-every", type=int, help="Keep every so many steps  [1, or what fits]")
@click.option("--compensated", is_flag=True, help="Carry round-off from step to step.")
@click.option("--omega", type=float, help="Coupling of tao2 and tao4.")
@click.option("--rtol", type=float, help="Of dop853 and odeint  [1e-13]")
@click.option("--atol", type=float, help="Of dop853 and odeint  [1e-13]")
@output_options("States as .csv or .npz.")
def integrate(
    H: Hamiltonian,
    z0: Any,
    span: tuple[float, float],
    output: str | None,
    figure: str | None,
    **options: Any,
) -> int:
    """Integrate with a time-stepping method; exit 1 if it had to stop early.

    Without method and steps, steps are chosen for an energy drift of 1e-9; with a method alone
    they are 20,000. A drift that is large is a warning on standard error.
    """
    import numpy as np

    from hamsym.integrators.integrate import integrate as run

    trajectory = run(H, z0, span, **options)
    echo_wrapped("", trajectory.message)
    ensemble = trajectory.z.ndim == 3
    z, energy = (
        (trajectory.z[0], trajectory.energy[0]) if ensemble else (trajectory.z, trajectory.energy)
    )
    if ensemble:
        click.echo(f"{len(trajectory.z):,} trajectories, the first of them:")
    click.echo(f"{'':<12}{'start':>24}{'end':>24}")
    for name, values in [("t", trajectory.t), *zip(H.names, z.T, strict=True), ("H", energy)]:
        click.echo(f"{name:<12}{values[0]:>24.15g}{values[-1]:>24.15g}")
    # Where a trajectory has ended H is nan and does not count; where a state is there, nan does.
    there = np.isfinite(trajectory.z).all(axis=-1)
    change = np.abs(trajectory.energy - trajectory.energy[..., :1])[there].max()
    click.echo(f"largest change of H: {change:.3e}")
    click.echo(f"{trajectory.evaluations:,} evaluations, {trajectory.seconds:.3g} s")
    if output is not None:
        count = len(trajectory.z) if ensemble else 1
        states = trajectory.z.reshape(-1, H.dim)
        columns = [("t", np.tile(trajectory.t, count)), *zip(H.names, states.T, strict=True)]
        columns.append(("H", trajectory.energy.ravel()))
        if ensemble:
            columns.insert(0, ("trajectory", np.repeat(np.arange(count), len(trajectory.t))))
        arrays = {"t": trajectory.t, "z": trajectory.z, "energy": trajectory.energy}
        write_table(output, columns, arrays)
    if figure is not None:
        save_figure(trajectory.plot(), figure)
    return 0 if trajectory.success else 1


@cli.command(epilog=_METHODS)
@hamiltonian_options
@span_options
@click.option("--method", metavar="NAME", help="[blanes_moan6, or gauss6 if not separable]")
@step_options
@click.option("--count", default=1, show_default=True, help="How many exponents.")
@click.option("--seed", default=0, show_default=True)
@output_options("History, .csv or .npz.")
def lyapunov(
    H: Hamiltonian,
    z0: Any,
    span: tuple[float, float],
    output: str | None,
    figure: str | None,
    **options: Any,
) -> int:
    """Lyapunov exponents, and what a finite time says of them."""
    import numpy as np

    from hamsym.dynamics.lyapunov import lyapunov as run

    found = run(H, z0, span, **options)
    echo_wrapped("", found.statement)
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
    if output is not None:
        columns = [("t", found.t), *zip(names, found.exponents.T, strict=True)]
        write_table(output, columns, {"t": found.t, "exponents": found.exponents})
    if figure is not None:
        save_figure(found.plot(), figure)
    return 0 if found.success else 1


def _decades(found: Any) -> np.ndarray:
    """Times at which the table has a line: ten in each tenfold of time at most, and the end."""
    import numpy as np

    end = abs(found.t[-1] - found.start)
    return np.append(end * 10.0 ** np.arange(-3, 0, 0.5), end * (1 - 1e-12))


@cli.command("section", epilog=_METHODS)
@hamiltonian_options
@starts_options
@click.option("--at", "surface", required=True, metavar="SURFACE", help='"x = 0, p_x > 0"')
@click.option("--energy", metavar="NUMBER", help="Of starts that lack one component.")
@click.option("--method", metavar="NAME", help="[blanes_moan6, or gauss6 if not separable]")
@step_options
@click.option("--crossings", type=int, help="Stop when each trajectory has so many.")
@output_options("Crossings, .csv or .npz.")
def section_command(
    H: Hamiltonian,
    z0: Any,
    span: tuple[float, float],
    output: str | None,
    figure: str | None,
    **options: Any,
) -> int:
    """A Poincare section: where trajectories cross a surface, to round-off."""
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
    if output is not None:
        columns = [("trajectory", found.trajectory), ("t", found.t)]
        columns += zip(H.names, found.z.T, strict=True)
        arrays = {"trajectory": found.trajectory, "t": found.t, "z": found.z}
        write_table(output, columns, arrays)
    if figure is not None:
        save_figure(found.plot(), figure)
    return 0 if found.success else 1


@cli.command()
@hamiltonian_options
@span_options
@solver_options
@click.option(
    "--with",
    "methods",
    metavar="NAMES",
    default="symplectic_euler",
    show_default=True,
    help="Integrators, such as yoshida4,gauss6,dop853.",
)
@click.option("--max-steps", default=100_000_000, show_default=True, help="Of the search.")
def compare(
    H: Hamiltonian,
    z0: Any,
    span: tuple[float, float],
    methods: str,
    max_steps: int,
    figure: str | None = None,
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


@cli.command()
@click.argument("file", type=click.Path())
@click.option("--rtol", default=0.02, show_default=True, help="How close the bounds come.")
@click.option("--bits", type=int, help="Working precision  [as much as it takes]")
@click.option("--time-limit", type=float, metavar="SECONDS", help="Refuse after so much time.")
@click.option("-o", "--output", type=click.Path(), metavar="CERTIFICATE", help="[FILE.certificate]")
def certify(file: str, output: str | None, **options: Any) -> None:
    """Prove how wrong a saved solution is, and write the certificate beside it.

    FILE is what `hamsym solve -o FILE` wrote. Exit 1 if nothing could be proven.
    """
    from hamsym.archive import load

    check_folder(output)
    solution = load(file)
    found = solution.certify(**options)
    echo_wrapped("", found.statement)
    names = ["|z|", *solution.H.names, "H", "ell_max"]
    lowers = [found.lower, *found.component_lowers, found.energy_lower, found.ell_max_lower]
    bounds = [found.bound, *found.component_bounds, found.energy_bound, found.ell_max_bound]
    width = max(map(len, names))
    click.echo(f"\n{'error of':<{max(width, 8)}}{'at least':>16}{'at most':>16}")
    for name, lower, bound in zip(names, lowers, bounds, strict=True):
        click.echo(f"{name:<{max(width, 8)}}{lower:>16.8e}{bound:>16.8e}")
    click.echo(f"proven in {found.seconds:.2f} s")
    path = output or f"{file}{_CERTIFICATE}"
    write_atomically(Path(path), found.to_json().encode())
    click.echo(f"wrote {path}")


@cli.command()
@click.argument("file", type=click.Path())
@click.option("--certificate", type=click.Path(), metavar="CERTIFICATE", help="[FILE.certificate]")
@click.option("--time-limit", type=float, metavar="SECONDS", help="Refuse after so much time.")
def verify(file: str, certificate: str | None, time_limit: float | None) -> None:
    """Run the whole proof of a certificate again, from the saved solution alone.

    Exit 1 if the certificate claims what is not proven.
    """
    from hamsym.proof.prove import verify as run

    path = Path(certificate or f"{file}{_CERTIFICATE}")
    run(path.read_text(encoding="utf-8"), file, time_limit)
    click.echo("verified: every bound of the certificate is proven")


_EXPERIMENTS = ("oscillator", "oscillator-long", "henon-heiles", "henon-heiles-long")


@cli.command()
@click.argument(
    "experiments", nargs=-1, type=click.Choice([*_EXPERIMENTS, "all"]), metavar="[EXPERIMENTS]..."
)
@click.option("--quick", is_flag=True, help="Few epochs: the same rows in minutes.")
@click.option("--claims", is_flag=True, help="Test the paper's further claims too.")
@click.option("--seed", default=0, show_default=True, help="The first seed.")
@click.option("--seeds", type=int, help="How many seeds  [3, or 1 with --quick]")
@click.option("--workers", type=int, help="Processes side by side  [as many as cores]")
@click.option("--out", type=click.Path(), default="output/paper", show_default=True)
def reproduce(
    experiments: tuple[str, ...],
    quick: bool,
    claims: bool,
    seed: int,
    seeds: int | None,
    workers: int | None,
    out: str,
) -> None:
    """Reproduce the paper's experiments, and what it left out beside them.

    Each writes its table, its figures and its results; page.md ties them together. What was
    stopped goes on where it was; what is there already is not run again. With --quick all goes
    into a folder "quick" of its own. EXPERIMENTS are oscillator, oscillator-long, henon-heiles,
    henon-heiles-long or all, the default.
    """
    import importlib

    from hamsym.support.locking import exclusive
    from hamsym.support.validation import require_whole

    require_whole("--seed", seed, 0)
    if seeds is None:
        seeds = 1 if quick else 3
    require_whole("--seeds", seeds, 1)
    if workers is not None:
        require_whole("--workers", workers, 1)
    chosen = [name for name in _EXPERIMENTS if not experiments or {name, "all"} & {*experiments}]
    if claims:
        chosen.append("claims")
    place = Path(out) / "quick" if quick else Path(out)
    place.mkdir(parents=True, exist_ok=True)
    options = [f"--seed={seed}", f"--seeds={seeds}", f"--out={place}"] + ["--quick"] * quick
    if workers is not None:
        options.append(f"--workers={workers}")
    began = time.monotonic()
    with exclusive(place):
        for name in chosen:
            script = importlib.import_module(f"hamsym.paper.{name.replace('-', '_')}")
            script.main(options)
        importlib.import_module("hamsym.paper.page").main([f"--out={place}"])
    click.echo(f"{(time.monotonic() - began) / 60:.1f} minutes")


if __name__ == "__main__":
    sys.exit(main())
