"""Experiment: its settings, its runs and its output files.

An experiment solves one Hamiltonian, start and span with many settings and several seeds by
:func:`hamsym.sweep`. It writes `results.json`, `table.md` and figures into its folder; `page.py`
makes one page of all experiments.
"""

import argparse
import datetime
import json
import math
import platform
import textwrap
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

import hamsym
from hamsym.integrators.adaptive import reference
from hamsym.paper.tables import console_table, finite, markdown_table, spread, write
from hamsym.solving.methods import made_method

INTEGRATORS = ("symplectic_euler", "stormer_verlet", "yoshida4", "yoshida8")
ARCHITECTURES = {
    "sin, 1 - exp(-t)": {"activation": "sin", "envelope": "exponential"},
    "sin, t": {"activation": "sin", "envelope": "linear"},
    "sigmoid, 1 - exp(-t)": {"activation": "sigmoid", "envelope": "exponential"},
    "sigmoid, t": {"activation": "sigmoid", "envelope": "linear"},
}

# Three ways to train with Adam. First, as in the text:
AS_WRITTEN = {"method": "adam", "schedule": "constant", "learning_rate": 8e-3, "tau": 1.0}
# Second, as in the authors' published code: slower averages, and another noise, set by each
# experiment. (Not adopted: float32, the third point, which is always moved to t = 1, and the choice
# of the weights with the lowest noisy loss.)
AUTHORS = AS_WRITTEN | {"betas": (0.999, 0.9999)}
# Third, with hamsym's schedule: the rate decreases along half a cosine.
COSINE = {"method": "adam", "schedule": "cosine", "learning_rate": 8e-3, "betas": (0.99, 0.999)}

# Levenberg-Marquardt on a chain of networks, to its default tolerance.
CHAIN = {"method": "network-chain"}


class Experiment:
    """One problem, its runs and their results.

    Parameters
    ----------
    name : str
        Name of the folder.
    title : str
    problem : hamsym.systems.Problem
    span : (float, float)
    points : int
        The paper's K; the integrators take multiples of it as steps.
    arguments : argparse.Namespace
        Result of :func:`parse`.
    """

    def __init__(self, name, title, problem, span, points, arguments):
        self.problem, self.span, self.points, self.arguments = problem, span, points, arguments
        self.folder = arguments.out / name
        self.truth = problem.exact or reference(problem.H, problem.z0, span)
        self.seeds = range(arguments.seed, arguments.seed + arguments.seeds)
        self.results = {"name": name, "title": title, "rows": [], "claims": [], "figures": []}
        self.results |= {"quick": False, "settings": {}, "seeds": list(self.seeds)}
        self.results["made with"] = {
            "date": datetime.date.today().isoformat(),
            "python": platform.python_version(),
            **{name: version(name) for name in ("hamsym", "numpy", "scipy", "torch")},
        }
        print(f"\n{title}", flush=True)

    def sweep(self, settings, *, problem=None, span=None):
        """Run all settings with every seed."""
        problem = problem or self.problem
        limited = {name: limit(given, self.arguments.epochs) for name, given in settings.items()}
        for name, given in limited.items():
            known = given(self.seeds[0]) if callable(given) else given
            wanted = settings[name](self.seeds[0]) if callable(given) else settings[name]
            self.results["quick"] |= known != wanted
            self.results["settings"][name] = {
                key: "the first stage" if key == "initial" else str(value)
                for key, value in known.items()
            }
        return hamsym.sweep(
            problem.H,
            problem.z0,
            span or self.span,
            {name: arguments(given) for name, given in limited.items()},
            folder=self.folder / "runs",
            seeds=self.seeds,
            workers=self.arguments.workers,
            progress=True,
        )

    # -- tables --------------------------------------------------------------------------------

    def add_networks(self, found, begun=None, truth=None, prove=True):
        """Add a row to the table for each of the settings of a sweep, over its seeds.

        ``begun`` maps names of settings to their initial solutions, whose cost is added. ``truth``
        is the reference of another problem than the experiment's. With ``prove`` each solution is
        certified, within the seconds of ``--certify``.
        """
        rows, all_measured = [], found.rows(truth or self.truth)
        for name, solutions in found.solutions.items():
            measured = all_measured[name]
            costs = [Cost.of(solution) for solution in solutions]
            for first, solution in enumerate((begun or {}).get(name, ())):
                costs[first] += Cost.of(solution)
            seconds = self.arguments.certify if prove else 0
            proofs = [bound_or_reason(s, seconds) for s in solutions] if seconds else []
            proven = [proof for proof in proofs if not isinstance(proof, str)]
            trained = () if self.results["quick"] else solutions  # slow for untrained networks
            estimates = [largest_estimate(solution) for solution in trained]
            rows.append(
                {
                    "method": name,
                    "seeds": len(solutions),
                    "points": measured[0].points,
                    "evaluations": spread(cost.evaluations for cost in costs),
                    "error": spread(row.error for row in measured),
                    "component error": spread(row.component_errors.max() for row in measured),
                    "energy error": spread(row.energy_error for row in measured),
                    "loss": spread(best_loss(solution) for solution in solutions),
                    "ell_max": spread(solution.ell_max for solution in solutions),
                    "paper's bound": spread(solution.analysis.bound for solution in solutions),
                    "estimate": spread(estimates) if estimates else None,
                    "proven bound": spread(proven) if len(proven) == len(solutions) else None,
                    "refused": [proof for proof in proofs if isinstance(proof, str)],
                    "seconds": spread(cost.seconds for cost in costs),
                    "CPU seconds": spread(cost.cpu_seconds for cost in costs),
                }
            )
        self.results["rows"] += rows
        return {row["method"]: row for row in rows}

    def add_integrators(self, solution):
        """Add rows of integrators with K, 10 K and 100 K steps, and the steps of equal error."""
        comparison = hamsym.compare(
            solution, (*INTEGRATORS, "dop853"), points=self.points, exact=self.problem.exact
        )
        for row in comparison.rows[1:]:
            amount = f"{row.points:,} steps"
            if row.tolerance is not None:
                amount = f"tolerance {row.tolerance:.0e}"
            self.results["rows"].append(
                {
                    "method": f"{row.label}, {amount}",
                    "seeds": None,
                    "points": row.points,
                    "evaluations": spread([row.evaluations]),
                    "error": spread([row.error]),
                    "component error": spread([row.component_errors.max()]),
                    "energy error": spread([row.energy_error]),
                    "seconds": spread([row.seconds]),
                    "CPU seconds": spread([row.seconds]),
                }
            )
        self.results["matches"] = {
            "error": comparison.rows[0].error,
            "steps": {name: str(match) for name, match in comparison.matches.items()},
            "evaluations": {name: match.evaluations for name, match in comparison.matches.items()},
            "seconds": {name: match.seconds for name, match in comparison.matches.items()},
        }
        return comparison

    def beside(self, what, published, **rows):
        """Add a line to the page's first table: the authors' error and the rows to compare."""
        names = {
            "as written": rows.get("written"),
            "authors' settings": rows.get("authors"),
            "cosine": rows.get("cosine"),
            "SSBroyden": rows.get("ssbroyden"),
            "Levenberg-Marquardt": "Levenberg-Marquardt",
            "Levenberg-Marquardt, chain": "Levenberg-Marquardt, chain",
            "features": rows.get("features"),
        }
        line = {"what": what, "published": published, "rows": names}
        self.results.setdefault("summary", []).append(line)

    def claim(self, where, says, measured, held):
        """Add a claim of the paper, the measurement, and the verdict as a bool or text."""
        verdict = held if isinstance(held, str) else "held" if held else "did not hold"
        if self.results["quick"] and verdict != "not tested":
            verdict = "not judged: a quick look trains too little"
        self.results["claims"].append(
            {"where": where, "says": says, "measured": measured, "verdict": verdict}
        )

    # -- files ---------------------------------------------------------------------------------

    def add_figure(self, name, figure, caption):
        """Write a figure and store its caption for the page."""
        self.folder.mkdir(parents=True, exist_ok=True)
        figure.savefig(self.folder / f"{name}.png", dpi=110)
        self.results["figures"].append({"file": f"{name}.png", "caption": caption})

    def write(self):
        """Write the results and the table; print the table and the claims."""
        self.folder.mkdir(parents=True, exist_ok=True)
        text = markdown_table(self.results["rows"])
        write(self.folder / "table.md", f"# {self.results['title']}\n\n{text}\n")
        write(self.folder / "results.json", json.dumps(finite(self.results), indent=1))
        print(console_table(self.results["rows"]))
        for claim in self.results["claims"]:
            line = f"{claim['verdict']}: {claim['says']}; {claim['measured']}"
            print(textwrap.fill(line, 80, subsequent_indent="  "))
        print(f"wrote {self.folder / 'results.json'}", flush=True)


# -- the command line --------------------------------------------------------------------------


def parse(description, arguments=None):
    """Parse the options of all experiments."""
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="train for few epochs, in minutes")
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument("--seeds", type=int, default=3, help="number of seeds")
    parser.add_argument("--epochs", type=int, help="largest number of epochs")
    parser.add_argument(
        "--certify", type=float, default=120, help="seconds per proof; 0: no proofs"
    )
    parser.add_argument("--workers", type=int, help="number of processes; default: cores")
    parser.add_argument("--out", type=Path, default=Path("output/paper"))
    found = parser.parse_args(arguments)
    for name, least in (("seed", 0), ("seeds", 1), ("epochs", 1), ("workers", 1), ("certify", 0)):
        value = getattr(found, name)
        if value is not None and value < least:
            parser.error(f"--{name} {value} is too small; give {least} or more")
    if found.quick and found.epochs is None:
        found.epochs = 300
    return found


def limit(settings, epochs):
    """Limit the number of epochs or iterations of settings, for a quick run."""
    if epochs is None:
        return settings
    if callable(settings):
        return lambda seed: limit(settings(seed), epochs)
    if settings["method"] == "adam":
        return settings | {"epochs": min(settings["epochs"], epochs)}
    if settings["method"] in ("features", "network-chain"):
        return settings  # a number of windows, not of iterations, reaches a tolerance
    given = settings.get("iterations", epochs)
    return settings | {"iterations": max(1, min(given, epochs // 10))}


def arguments(settings):
    """Return settings, options of a method among them, as arguments of :func:`hamsym.solve`."""
    if callable(settings):
        return lambda seed: arguments(settings(seed))
    options = dict(settings)
    tolerance = {"tol": options.pop("tol")} if "tol" in options else {}
    return tolerance | {"method": made_method(options.pop("method"), options)}


# -- numbers -----------------------------------------------------------------------------------


def bound_or_reason(solution, seconds):
    """The proven bound on the error of a solution, or the reason for which there is none."""
    try:
        return solution.certify(time_limit=seconds).bound
    except hamsym.CertificationError as error:
        return str(error)


def largest_estimate(solution):
    """Largest estimated |z - z^| at 2,001 times; infinite if there is no estimate."""
    t = np.linspace(*solution.span, 2_001)
    return float(np.linalg.norm(solution.error_estimate(t), axis=-1).max())


def best_loss(solution):
    """Loss of the final weights, at points not used in training."""
    return getattr(solution.record, "best_loss", math.nan)


@dataclass(frozen=True)
class Cost:
    """Cost of a solution; a march runs on one thread."""

    evaluations: int
    seconds: float
    cpu_seconds: float

    @classmethod
    def of(cls, solution):
        """Cost of one solution."""
        seconds = solution.record.seconds
        spent = getattr(solution.record, "cpu_seconds", seconds)
        return cls(solution.evaluations, seconds, spent)

    def __add__(self, other):
        return Cost(
            self.evaluations + other.evaluations,
            self.seconds + other.seconds,
            self.cpu_seconds + other.cpu_seconds,
        )
