"""Page of all experiments: tables, figures and claims.

Run `python examples/paper/page.py`; `--out` is the folder of the experiments.
"""

import argparse
import json
from pathlib import Path

from hamsym.paper import scheme
from hamsym.paper.tables import markdown_table, seconds, short, write

EXPERIMENTS = (
    *("oscillator", "oscillator-long", "henon-heiles", "henon-heiles-long", "accuracy"),
    "claims",
)
_FLOOR = 5e-13  # error below which the reference is not more accurate than the solution
_COLUMNS = (
    *("as written", "authors' settings", "cosine", "SSBroyden", "Levenberg-Marquardt"),
    *("Levenberg-Marquardt, chain", "features"),
)


def main(arguments=None):
    """Write the page and all results as one file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("output/paper"))
    out = parser.parse_args(arguments).out
    found = [
        json.loads(file.read_text(encoding="utf-8"))
        for file in (out / name / "results.json" for name in EXPERIMENTS)
        if file.exists()
    ]
    if not found:
        parser.error(f"'{out}' contains no results; run an experiment first")
    scheme.main(["--out", str(out)])
    write(out / "results.json", json.dumps(found, indent=1))
    write(out / "page.md", page(found))
    print(f"wrote {out / 'page.md'}")


def page(found):
    """Format the page as Markdown."""
    parts = ["# The paper, reproduced", _INTRODUCTION]
    if any(experiment["quick"] for experiment in found):
        parts.append(
            "**This is a quick look: a few hundred epochs. It has all rows of the full "
            "experiments, but its numbers are meaningless.**"
        )
    parts += [f"![]({'scheme.png'})", f"*{scheme.CAPTION}*"]
    if any("summary" in experiment for experiment in found):
        parts += ["## Summary", summary_table(found), _SUMMARY]
    claims = [(experiment, claim) for experiment in found for claim in experiment["claims"]]
    parts += ["## Claims of the paper, and measurements", claims_table(claims)]
    for experiment in found:
        quick = ", a quick look" if experiment["quick"] else ""
        parts += [f"## {experiment['title']}{quick}", markdown_table(experiment["rows"])]
        parts.append(made_with(experiment))
        if "matches" in experiment:
            parts.append(matches(experiment["matches"]))
        for figure in experiment["figures"]:
            parts += [f"![]({experiment['name']}/{figure['file']})", f"*{figure['caption']}*"]
    return "\n\n".join(parts) + "\n"


_INTRODUCTION = """\
Mattheakis, Sondak, Dogra & Protopapas, *Hamiltonian neural networks for solving equations of
motion*, Physical Review E 105, 065305 (2022): all experiments, figures and claims, with details
that the paper does not give. Errors are the largest 2-norm |z^(t) - z(t)| over the span, at 4,001
times that were not used in training, relative to the exact solution (oscillator) or to DOP853 at a
tolerance of 1e-13 (Henon-Heiles); values below about 3e-13 are errors of this reference and
round-off. For several seeds: median (minimum to maximum). A proven bound holds at all times, for
the function that the weights define, evaluated without rounding. Energy errors are |H(z^) - H(z)|.

"As written" is Adam with the settings of the text. "Authors' code" has the settings of the authors'
published scripts: betas (0.999, 0.9999) and another size of the noise; but not their float32, their
third point, which is always moved to t = 1, nor their choice of weights with the lowest noisy loss.
"Cosine" decreases the learning rate. All networks are trained with hamsym. forest_ruth is identical
to Yoshida's method of order 4. Seconds of networks are training times on one core each, with other
runs on the other cores; those of integrators exclude compilation. A claim is held, or did not hold,
only if the ranges over the seeds do not overlap."""

_SUMMARY = """\
Largest errors, median over the seeds, and CPU seconds. The authors' errors are from their published
code, run for 50,000 (A) and 30,000 (B) epochs, and for the long spans from their published results
(A-long) and saved weights (B-long: 3.7e-3 on 5,000 points; their text file gives 1.6e-3 on 500)."""


def summary_table(found):
    """Format a table with a line for each published error of the authors."""
    heads = ("experiment", "authors' own", "reached first by", *_COLUMNS, "Euler, most steps")
    lines = [f"| {' | '.join(heads)} |", "| --- " + "| ---: " * (len(heads) - 1) + "|"]
    for experiment in found:
        rows = {row["method"]: row for row in experiment["rows"]}
        for line in experiment.get("summary", ()):
            of = {column: rows.get(line["rows"].get(column)) for column in _COLUMNS}
            reached = (
                column
                for column, row in of.items()
                if row and float(row["error"][0]) <= line["published"]
            )
            cells = [line["what"], short(line["published"]), next(reached, "none")]
            cells += [cell(row) for row in of.values()]
            euler = [row for name, row in rows.items() if name.startswith("symplectic_euler")]
            cells.append(short(euler[-1]["error"]))
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def cell(row):
    """Format median error and CPU time of a row, or a proven bound below the error."""
    if row is None:
        return ""
    error, proven = row["error"], row.get("proven bound")
    shown = short(error[0])
    if proven and float(proven[0]) < float(error[0]) < _FLOOR:
        shown = f"{short(proven[0])} (proven)"
    return f"{shown}, {seconds(row['CPU seconds'])} s"


def claims_table(claims):
    """Format all claims with their experiments."""
    lines = ["| where | claim | measured | verdict |", "| --- | --- | --- | --- |"]
    for experiment, claim in claims:
        measured = claim["measured"].replace("|", "\\|")
        where = f"{claim['where']} ({experiment['title'].split(':')[0]})"
        says = claim["says"].replace("|", "\\|")
        lines.append(f"| {where} | {says} | {measured} | {claim['verdict']} |")
    return "\n".join(lines)


def made_with(experiment):
    """Format seeds, date and versions as a sentence."""
    versions = ", ".join(f"{name} {value}" for name, value in experiment["made with"].items())
    return f"Seeds {', '.join(map(str, experiment['seeds']))}; made with {versions}."


def matches(found):
    """Format the cost of integrators for the network's error as a sentence."""
    each = "; ".join(
        f"{name} {steps}"
        + (
            f" ({found['evaluations'][name]:,} evaluations, {1e3 * found['seconds'][name]:.2g} ms)"
            if found["evaluations"][name]
            else ""
        )
        for name, steps in found["steps"].items()
    )
    return f"For an error of {short(found['error'])}, that of the network drawn below: {each}."


if __name__ == "__main__":
    main()
