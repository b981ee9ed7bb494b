"""The command line: derive, source, solve, integrate, ..., systems, certify, export, reproduce.

Results go to standard output, progress, warnings and errors to standard error. The exit status is

- 0 on success,
- 1 if a solution, a search or a proof did not succeed; its result is printed all the same, except
  that a refused proof is one line on standard error,
- 2 on invalid input or an unusable file, with a message of one line,
- 130 after Ctrl-C, with one line, and 141 if standard output was closed, as by ``head``.

With ``--json`` standard output has one JSON object; an error is its only entry, ``error``.
"""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Sequence

import click
from click.shell_completion import shell_complete

from hamsym.cli.catalogue import systems
from hamsym.cli.command import HELP, Group
from hamsym.cli.derivation import derive, invariants, source
from hamsym.cli.dynamics import equilibria, lyapunov, orbit, section
from hamsym.cli.fitting import fit
from hamsym.cli.paper import reproduce
from hamsym.cli.proofs import certify, verify
from hamsym.cli.sharing import explore, export, report
from hamsym.cli.trajectories import compare, integrate, solve
from hamsym.errors import CertificationError, HamsymError, StepSizeWarning
from hamsym.support.text_tables import WIDTH


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; the entry point of the ``hamsym`` script.

    - returns: The exit status.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    as_json = "--json" in given[: given.index("--") if "--" in given else None]
    # A terminal may lack Greek letters.
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    try:
        try:
            status = _run(given)
        except click.ClickException as error:
            status = _fail(error.format_message(), 2, as_json)
        except CertificationError as error:
            status = _fail(str(error), 1, as_json)
        except HamsymError as error:
            status = _fail(str(error), 2, as_json)
        except (click.Abort, KeyboardInterrupt):
            # A terminal shows ^C in the line of the cursor.
            print(end="\n" if sys.stderr.isatty() else "", file=sys.stderr)
            status = _fail("interrupted", 130, as_json)
        except BrokenPipeError:
            raise
        except OSError as error:
            status = _fail(f"{error.filename or 'file'}: {error.strerror or error}", 2, as_json)
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    return status


def _run(arguments: list[str]) -> int:
    """Run a command, as ``cli.main`` does, which would answer Ctrl-C and closed pipes itself."""
    if instruction := os.environ.get("_HAMSYM_COMPLETE"):
        sys.exit(shell_complete(cli, {}, "hamsym", "_HAMSYM_COMPLETE", instruction))
    with warnings.catch_warnings():
        # Print one line, as for an error, without the source location.
        warnings.simplefilter("always", StepSizeWarning)
        shown = warnings.showwarning
        warnings.showwarning = lambda message, category, *where: (
            _warn(message) if category is StepSizeWarning else shown(message, category, *where)
        )
        try:
            with cli.make_context("hamsym", arguments) as context:
                return int(cli.invoke(context) or 0)
        except click.exceptions.Exit as ended:  # after --help
            return ended.exit_code


def _fail(message: str, status: int, as_json: bool) -> int:
    """Print an error in one line, or as a JSON object, and return the exit status."""
    line = " ".join(message.split())
    if as_json:
        print(json.dumps({"error": line}, ensure_ascii=False))
    else:
        print(f"hamsym: {line}", file=sys.stderr)
    return status


def _warn(message: Warning | str) -> None:
    """Print a warning in one line."""
    print("hamsym: warning: " + " ".join(str(message).split()), file=sys.stderr)


@click.group(
    cls=Group,
    subjects={
        "Derive": (derive, source, invariants, equilibria, systems),
        "Solve": (solve, integrate, compare, fit),
        "Dynamics": (lyapunov, section, orbit),
        "Prove": (certify, verify),
        "Show and share": (report, export, explore),
        "Others": (reproduce,),
    },
    context_settings={**HELP, "max_content_width": WIDTH},
    invoke_without_command=True,
    epilog="Exit status: 0 success, 1 not converged or not proven, 2 invalid input, 130 Ctrl-C.",
)
@click.version_option(package_name="hamsym")
@click.pass_context
def cli(context: click.Context) -> None:
    """From a Hamiltonian to its equations, its code, and its trajectories.

    H is a formula, e.g. "p**2/2 + x**2/2 + x**4/4": numbers, pi, names, + - * / **, and
    functions, e.g. sin, exp, sqrt, abs. Numbers may be formulas too: --t-end "4*pi". Results are
    one JSON object with --json.
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


if __name__ == "__main__":
    sys.exit(main())
