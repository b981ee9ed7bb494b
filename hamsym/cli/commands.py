"""The command line: derive, source, solve, integrate, fit, ..., certify, verify, reproduce.

Results go to standard output, progress and errors to standard error. The exit status is 0 on
success, 1 if a solution did not converge or a proof was refused, and 2 on invalid input, with a
message of one line.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Sequence

import click

from hamsym.cli.derivation import derive, source
from hamsym.cli.fitting import fit
from hamsym.cli.output import WIDTH
from hamsym.cli.paper import reproduce
from hamsym.cli.proofs import certify, verify
from hamsym.cli.trajectories import compare, integrate, lyapunov, section, solve
from hamsym.errors import CertificationError, HamsymError, StepSizeWarning

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; the entry point of the ``hamsym`` script.

    Returns
    -------
    int
        The exit status.
    """
    # A terminal may lack Greek letters.
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    try:
        with warnings.catch_warnings():
            # Print one line, as for an error, without the source location.
            warnings.simplefilter("always", StepSizeWarning)
            shown = warnings.showwarning
            warnings.showwarning = lambda message, category, *where: (
                _warn(message) if category is StepSizeWarning else shown(message, category, *where)
            )
            status = cli.main(args=arguments, prog_name="hamsym", standalone_mode=False)
        sys.stdout.flush()
        return int(status or 0)
    except click.ClickException as error:
        return _fail(error.format_message(), 2)
    except CertificationError as error:
        return _fail(str(error), 1)
    except HamsymError as error:
        return _fail(str(error), 2)
    except (click.Abort, KeyboardInterrupt):
        return _fail("interrupted", 130)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except OSError as error:
        return _fail(f"{error.filename or 'file'}: {error.strerror or error}", 2)


def _fail(message: str, status: int) -> int:
    """Print an error in one line and return the exit status."""
    print("hamsym: " + " ".join(message.split()), file=sys.stderr)
    return status


def _warn(message: Warning | str) -> None:
    """Print a warning in one line."""
    print("hamsym: warning: " + " ".join(str(message).split()), file=sys.stderr)


@click.group(
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": WIDTH},
    invoke_without_command=True,
)
@click.version_option(package_name="hamsym")
@click.pass_context
def cli(context: click.Context) -> None:
    """From a Hamiltonian to its equations, its code, and its trajectories.

    H is a formula, e.g. "p**2/2 + x**2/2 + x**4/4": numbers, pi, names, + - * / **, and
    functions, e.g. sin, exp, sqrt, abs. Numbers may be formulas too: --t-end "4*pi".
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


for command in (
    *(derive, source, solve, integrate, lyapunov, section, compare, fit),
    *(certify, verify, reproduce),
):
    cli.add_command(command)


if __name__ == "__main__":
    sys.exit(main())
