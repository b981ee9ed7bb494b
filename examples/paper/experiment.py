"""What the experiments share: their command line, their tables, and the files that they write.

An experiment is one Hamiltonian, start and span, solved with many settings and several seeds by
:func:`hamsym.sweep`. It writes `results.json`, `table.md` and figures into a folder of its own;
`page.py` makes one page of them.
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
from matplotlib.figure import Figure

import hamsym
from hamsym.atomic import write_atomically
from hamsym.integrators import reference

# The first seed's colour for networks, then for integrators (Okabe and Ito).
BLUE, RED, GREEN, PINK, ORANGE, SKY = "#0072b2 #d55e00 #009e73 #cc79a7 #e69f00 #56b4e9".split()

INTEGRATORS = ("symplectic_euler", "stormer_verlet", "yoshida4", "yoshida8")
ARCHITECTURES = {
    "sin, 1 - exp(-t)": {"activation": "sin", "envelope": "exponential"},
    "sin, t": {"activation": "sin", "envelope": "linear"},
    "sigmoid, 1 - exp(-t)": {"activation": "sigmoid", "envelope": "exponential"},
    "sigmoid, t": {"activation": "sigmoid", "envelope": "linear"},
}

# Three ways to train with Adam. As the text has it:
AS_WRITTEN = {"method": "adam", "schedule": "constant", "learning_rate": 8e-3, "tau": 1.0}
# As the authors' published code has it: slower averages, and other noise, which comes with each
# experiment. (Left out are its float32, its third point, which is always moved to t = 1, and its
# choice of the weights with the lowest noisy loss.)
AUTHORS = AS_WRITTEN | {"betas": (0.999, 0.9999)}
# And with the rate falling along half a cosine, which is hamsym's own.
COSINE = {"method": "adam", "schedule": "cosine", "learning_rate": 8e-3, "betas": (0.99, 0.999)}


class Experiment:
    """One problem, its runs, and what is found out about it.

    Parameters
    ----------
    name : str
        Of its folder.
    title : str
    problem : hamsym.systems.Problem
    span : (float, float)
    points : int
        The paper's K, of which the integrators take multiples.
    arguments : argparse.Namespace
        From :func:`parse`.
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

    def sweep(self, settings, *, problem=None, span=None, prove=True):
        """Runs with these settings from every seed, each with a certificate if wanted."""
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
            limited,
            folder=self.folder / "runs",
            seeds=self.seeds,
            certify=(self.arguments.certify or None) if prove else None,
            workers=self.arguments.workers,
            progress=True,
        )

    # -- tables --------------------------------------------------------------------------------

    def add_networks(self, found, begun=None):
        """A row of the table for each of the settings of a sweep, over its seeds.

        ``begun`` has for some of them the solutions that they began with, whose cost is theirs.
        """
        rows, all_measured = [], found.rows(self.truth)
        for name, solutions in found.solutions.items():
            measured = all_measured[name]
            costs = [Cost.of(solution) for solution in solutions]
            for first, solution in enumerate((begun or {}).get(name, ())):
                costs[first] += Cost.of(solution)
            proofs = found.certificates.get(name, ())
            proven = [proof.bound for proof in proofs if not isinstance(proof, str)]
            trained = () if self.results["quick"] else solutions  # an estimate of nothing is slow
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
        """Rows of integrators with K, 10 K and 100 K steps, and what matches this solution."""
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
        """A line of the page's first table: the authors' own error, and the rows beside it."""
        names = {
            "as written": rows.get("written"),
            "authors' settings": rows.get("authors"),
            "cosine": rows.get("cosine"),
            "Levenberg-Marquardt": "Levenberg-Marquardt",
            "features": rows.get("features"),
        }
        line = {"what": what, "published": published, "rows": names}
        self.results.setdefault("summary", []).append(line)

    def claim(self, where, says, measured, held):
        """A claim of the paper, what was measured, and whether it held: a bool, or words."""
        verdict = held if isinstance(held, str) else "held" if held else "did not hold"
        if self.results["quick"] and verdict != "not tested":
            verdict = "not judged: a quick look trains too little"
        self.results["claims"].append(
            {"where": where, "says": says, "measured": measured, "verdict": verdict}
        )

    # -- files ---------------------------------------------------------------------------------

    def add_figure(self, name, figure, caption):
        """Write a figure, and keep its caption for the page."""
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
    """The options that all experiments take."""
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few epochs: the same rows in minutes")
    parser.add_argument("--seed", type=int, default=0, help="the first seed")
    parser.add_argument("--seeds", type=int, default=3, help="how many seeds")
    parser.add_argument("--epochs", type=int, help="no more than so many epochs")
    parser.add_argument("--certify", type=float, default=120, help="seconds for a proof; 0: none")
    parser.add_argument("--workers", type=int, help="processes side by side; as many as cores")
    parser.add_argument("--out", type=Path, default=Path("output/paper"))
    found = parser.parse_args(arguments)
    for name, least in (("seed", 0), ("seeds", 1), ("epochs", 1), ("workers", 1), ("certify", 0)):
        value = getattr(found, name)
        if value is not None and value < least:
            parser.error(f"--{name} {value} cannot be used; give {least} or more")
    if found.quick and found.epochs is None:
        found.epochs = 300
    return found


def limit(settings, epochs):
    """The same settings with no more than so many epochs, for a quick look."""
    if epochs is None:
        return settings
    if callable(settings):
        return lambda seed: limit(settings(seed), epochs)
    if settings["method"] == "adam":
        return settings | {"epochs": min(settings["epochs"], epochs)}
    if settings["method"] == "levenberg-marquardt":
        return settings | {"iterations": max(1, epochs // 10)}
    return settings


# -- numbers -----------------------------------------------------------------------------------


def spread(values):
    """Median (of an even number the lower middle), least and greatest."""
    ordered = sorted(float(value) for value in values)
    return [ordered[(len(ordered) - 1) // 2], ordered[0], ordered[-1]]


def largest_estimate(solution):
    """The largest estimated |z - z^| at 2,001 times, or infinity where there is no estimate."""
    t = np.linspace(*solution.span, 2_001)
    return float(np.linalg.norm(solution.error_estimate(t), axis=-1).max())


def best_loss(solution):
    """The loss of the weights that were kept, at points not trained on."""
    return getattr(solution.training, "best_loss", math.nan)


@dataclass(frozen=True)
class Cost:
    """What a solution took; a march runs on one thread."""

    evaluations: int
    seconds: float
    cpu_seconds: float

    @classmethod
    def of(cls, solution):
        """The cost of one solution."""
        seconds = solution.training.seconds
        spent = getattr(solution.training, "cpu_seconds", seconds)
        return cls(solution.evaluations, seconds, spent)

    def __add__(self, other):
        return Cost(
            self.evaluations + other.evaluations,
            self.seconds + other.seconds,
            self.cpu_seconds + other.cpu_seconds,
        )


def lower(one, other):
    """Whether one spread is lower than another: words if the seeds of both overlap."""
    if one[2] < other[1]:
        return True
    if one[1] > other[2]:
        return False
    return f"undecided: the seeds overlap, the median is {'lower' if one < other else 'not lower'}"


def finite(value):
    """The same for JSON, which has no infinity."""
    if isinstance(value, dict):
        return {key: finite(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(part) for part in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else "inf"
    return value


def short(value):
    """A number in two digits; a median with its range in parentheses."""
    if value is None:
        return ""
    if isinstance(value, list):
        middle, least, most = value
        if least == most:
            return short(middle)
        return f"{short(middle)} ({short(least)} to {short(most)})"
    if value == "inf" or math.isinf(value):
        return "infinite"
    return "" if math.isnan(value) else f"{value:.1e}".replace("e-0", "e-").replace("e+0", "e")


def seconds(value):
    """Times, as people write them."""
    return "" if value is None else f"{value[0]:,.0f}" if value[0] >= 10 else f"{value[0]:.2g}"


def markdown_table(rows):
    """The table of an experiment."""
    heads = (
        "method",
        "points",
        "evaluations",
        "error",
        "energy error",
        "proven bound",
        "CPU s",
        "wall s",
    )
    lines = [f"| {' | '.join(heads)} |", "| --- " + "| ---: " * (len(heads) - 1) + "|"]
    for row in rows:
        cells = (
            row["method"],
            f"{row['points']:,}",
            f"{row['evaluations'][0]:,.0f}",
            short(row["error"]),
            short(row["energy error"]),
            short(row.get("proven bound")) or ("refused" if row.get("refused") else ""),
            seconds(row["CPU seconds"]),
            seconds(row["seconds"]),
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def console_table(rows):
    """The same for a terminal of 80 columns, medians alone."""
    heads = ("error", "energy", "proven", "CPU s")
    lines = [f"{'method':<40}" + "".join(f"{head:>10}" for head in heads)]
    for row in rows:
        proven = row.get("proven bound")
        cells = (
            short(row["error"][0]),
            short(row["energy error"][0]),
            short(proven[0]) if proven else "",
            seconds(row["CPU seconds"]),
        )
        lines.append(f"{row['method']:<40}" + "".join(f"{cell:>10}" for cell in cells))
    return "\n".join(lines)


def write(path, text):
    """Write a file in one step: whoever looks sees the old one or the new one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, text.encode())


# -- figures -----------------------------------------------------------------------------------


def figure(rows, columns, width=10.0, height=4.2, **more):
    """A figure with a grid of axes."""
    drawn = Figure(figsize=(width, height), layout="constrained")
    axes = drawn.subplots(rows, columns, squeeze=False, **more)
    for axis in axes.flat:
        axis.grid(alpha=0.25)
        axis.ticklabel_format(style="sci", scilimits=(-2, 5))
    return drawn, axes


def draw_losses(axis, solutions, colors=(BLUE, RED, GREEN, PINK, ORANGE, SKY)):
    """Loss at the training points against the epoch, each smoothed over a 200th of them."""
    for (label, solution), color in zip(solutions.items(), colors, strict=False):
        loss = solution.history.loss
        width = max(1, len(loss) // 200)
        blocks = np.exp(np.log(loss[: len(loss) // width * width]).reshape(-1, width).mean(axis=1))
        epochs = width * (np.arange(len(blocks)) + 0.5)
        axis.semilogy(epochs, blocks, color=color, linewidth=1.2, label=label)
    axis.set(xlabel="epoch", ylabel="loss")
    axis.legend(fontsize=8)


def draw_architectures(experiment, found):
    """The paper's figure of the four loss curves, once for each way to train."""
    drawn, axes = figure(1, 2, sharey=True)
    recipes = {"as written": "Adam as written", "authors' code": "Adam as in the authors' code"}
    for axis, (recipe, title) in zip(axes[0], recipes.items(), strict=True):
        shown = {
            name: found.median(f"{recipe}: {name}", experiment.truth) for name in ARCHITECTURES
        }
        draw_losses(axis, shown)
        axis.set_title(title)
    experiment.add_figure(
        "loss", drawn, "Loss during training for the four architectures (median seed)."
    )


# -- claims that several experiments test ------------------------------------------------------


def euler(comparison, factor):
    """Row and trajectory of symplectic Euler with so many times K steps."""
    pairs = [
        pair
        for pair in zip(comparison.rows[1:], comparison.trajectories, strict=True)
        if pair[0].label == "symplectic_euler"
    ]
    return pairs[(1, 10, 100).index(factor)]


def judge_architectures(experiment, rows):
    """Whether sin with 1 - exp(-t) has the lowest loss of the four."""
    for recipe in ("as written", "authors' code"):
        of = {name: rows[f"{recipe}: {name}"] for name in ARCHITECTURES}
        listed = "; ".join(
            f"{name}: loss {short(row['loss'])}, error {short(row['error'])}"
            for name, row in of.items()
        )
        verdicts = [
            lower(of["sin, 1 - exp(-t)"]["loss"], row["loss"])
            for name, row in of.items()
            if name != "sin, 1 - exp(-t)"
        ]
        undecided = [verdict for verdict in verdicts if isinstance(verdict, str)]
        experiment.claim(
            "III",
            f"sin with 1 - exp(-t) converges best of the four (Adam, {recipe})",
            listed,
            False if False in verdicts else undecided[0] if undecided else True,
        )


def judge_steps(experiment, comparison, row, where, factor):
    """Whether symplectic Euler needs at least about so many times K points for the same error.

    Its error falls with the number of steps, so that what each seed needs follows from one run.
    """
    fine, _ = euler(comparison, 100)
    needed = [fine.error * fine.points / error / experiment.points for error in row["error"]]
    experiment.claim(
        where,
        f"symplectic Euler needs about {factor} K = {factor * experiment.points:,} points for the "
        "network's error",
        f"{needed[0]:,.0f} K ({needed[2]:,.0f} K to {needed[1]:,.0f} K) for {short(row['error'])}",
        lower([factor / math.sqrt(10)] * 3, [needed[0], needed[2], needed[1]])
        if needed[0] <= factor * math.sqrt(10)
        else f"held, and more: {needed[0] / factor:,.0f} times as many",
    )


def judge_bound(experiment, found):
    """Whether |dz_i| <= ell_max / sigma_min in every run that trained a network."""
    t = np.linspace(*experiment.span, 4_001)
    trained = [
        solution
        for solutions in found.solutions.values()
        for solution in solutions
        if solution.method != "features"
    ]
    ratios = [np.abs(experiment.truth(t) - z(t)).max() / z.analysis.bound for z in trained]
    broken, vacuous = sum(ratio > 1 for ratio in ratios), sum(z.sigma_min == 0 for z in trained)
    measured = f"largest error over bound {max(ratios):.2g}, above 1 in {broken} of {len(ratios)}"
    verdict = broken == 0
    if vacuous:
        measured += f"; the Hessian is singular on the way, and the bound infinite, in {vacuous}"
        verdict = "says nothing" if not broken else False
    experiment.claim("II.B", "no component's error exceeds ell_max / sigma_min", measured, verdict)


def judge_estimate(experiment, rows):
    """Whether the equation of the error, integrated, gives the error."""
    known = [row for row in rows.values() if row["estimate"]]
    ratios = [row["estimate"][0] / row["error"][0] for row in known if row["error"][0] > 1e-9]
    experiment.claim(
        "II.B",
        "the equation of the error (eq. ell, here with all orders) gives the error of a trained "
        "network",
        f"estimated over true error from {min(ratios, default=math.nan):.3f} to "
        f"{max(ratios, default=math.nan):.3f} in {len(ratios)} rows",
        bool(ratios) and min(ratios) >= 0.9 and max(ratios) <= 1.1,
    )


def judge_integrators(experiment, comparison):
    """What the paper says of other integrators, which it does not try."""
    of = comparison.matches
    experiment.claim(
        "IV",
        "higher-order symplectic integrators have a larger computational cost than Euler's",
        "evaluations for the network's error: "
        + "; ".join(
            f"{name} {of[name].evaluations:,}" if of[name].evaluations else f"{name} {of[name]}"
            for name in of
        ),
        not 0 < of["forest_ruth"].evaluations < (of["symplectic_euler"].evaluations or math.inf),
    )
    network = comparison.rows[0]
    best = min(
        (row for row in comparison.rows[1:] if row.points == 10 * experiment.points),
        key=lambda row: row.energy_error,
    )
    experiment.claim(
        "IV",
        "where conserving the energy is crucial the network performs better than symplectic "
        "integrators",
        f"max |dE| {network.energy_error:.1e} of the network, {best.energy_error:.1e} of "
        f"{best.label} with 10 K steps",
        network.energy_error < best.energy_error,
    )
