"""Further claims of the paper: noise, neurons, shared weights, the limit form, chaos, and more.

These claims need separate runs. Networks are trained by Adam as in the authors' code, for 10,000
epochs on the oscillator and 20,000 on its long span, because the claims compare the speed of
convergence.
"""

import math
import time

import numpy as np
import torch

import hamsym
from hamsym.paper import oscillator, oscillator_long
from hamsym.paper.experiment import COSINE, Experiment, parse
from hamsym.paper.tables import lower, short, spread

BASE = oscillator.PUBLISHED | {"epochs": 10_000}
LONG = oscillator_long.PUBLISHED | {"epochs": 20_000, "energy_weight": 1.0}
SETTINGS = {
    "50 neurons, noise of the code": BASE,
    "50 neurons, noise of the text": BASE | {"noise": 0.06 * math.pi},
    "50 neurons, no noise": BASE | {"noise": 0.0},
    "20 neurons": BASE | {"hidden": (20, 20)},
    "100 neurons": BASE | {"hidden": (100, 100)},
    "three layers of 50": BASE | {"hidden": (50, 50, 50)},
    "one network per component": BASE | {"shared_weights": False},
    "accuracy = 1e-4 asked for": {
        "method": "levenberg-marquardt",
        "accuracy": 1e-4,
    },
}
LONG_SETTINGS = {
    "20 pi, 50 neurons": LONG | {"hidden": (50, 50)},
    "20 pi, 80 neurons": LONG,
}
DIMENSIONS = (1, 2, 4, 8)


def main(arguments=None):
    """Run the sweeps, test the claims and write the table."""
    experiment = Experiment(
        "claims",
        "Further claims",
        hamsym.systems.nonlinear_oscillator(),
        oscillator.SPAN,
        200,
        parse(__doc__, arguments),
    )
    found = experiment.sweep(SETTINGS)
    rows = experiment.add_networks(found, prove=False)
    long = experiment.sweep(LONG_SETTINGS, span=oscillator_long.SPAN)
    rows |= experiment.add_networks(long, prove=False)
    judge_noise(experiment, rows)
    judge_neurons(experiment, rows)
    judge_sharing(experiment, rows)
    judge_accuracy(experiment, found)
    judge_outside(experiment, found)
    judge_limit(experiment, found)
    judge_span(experiment, rows)
    judge_dimensions(experiment)
    judge_chaos(experiment)
    judge_parallel(experiment, found)
    name_untested(experiment)
    experiment.write()


def judge_noise(experiment, rows):
    """Test whether noise on the points decreases the error."""
    without = rows["50 neurons, no noise"]
    for which in ("code", "text"):
        row = rows[f"50 neurons, noise of the {which}"]
        experiment.claim(
            "II.A",
            f"noise on the points improves the solution (that of the {which})",
            f"error with {short(row['error'])}, without {short(without['error'])}",
            lower(row["error"], without["error"]),
        )


def judge_neurons(experiment, rows):
    """Compare numbers of neurons at the same K, and 80 with 50 on the long span."""
    ells = {
        "20 neurons": rows["20 neurons"]["ell_max"],
        "50 neurons": rows["50 neurons, noise of the code"]["ell_max"],
        "100 neurons": rows["100 neurons"]["ell_max"],
    }
    experiment.claim(
        "II.B",
        "more neurons at the same K give a smaller ell_max",
        "; ".join(f"{name} {short(ell)}" for name, ell in ells.items()),
        lower(ells["100 neurons"], ells["20 neurons"]),
    )
    deep = rows["three layers of 50"]["ell_max"]
    experiment.claim(
        "II.B",
        "more layers at the same K give a smaller ell_max",
        f"three layers {short(deep)}, two {short(ells['50 neurons'])}",
        lower(deep, ells["50 neurons"]),
    )
    few, many = rows["20 pi, 50 neurons"], rows["20 pi, 80 neurons"]
    experiment.claim(
        "III.A",
        "80 neurons converge faster than 50 on the long span",
        f"loss after as many epochs: 80 neurons {short(many['loss'])}, 50 {short(few['loss'])}",
        lower(many["loss"], few["loss"]),
    )


def judge_sharing(experiment, rows):
    """Compare one network for all components with one network each."""
    shared, apart = rows["50 neurons, noise of the code"], rows["one network per component"]
    experiment.claim(
        "IV",
        "sharing weights improves the network's predictions",
        f"error shared {short(shared['error'])}, apart {short(apart['error'])}",
        lower(shared["error"], apart["error"]),
    )


def judge_accuracy(experiment, found):
    """Test the stopping rule ell_max = sigma_min * accuracy."""
    solutions = found.solutions["accuracy = 1e-4 asked for"]
    t = np.linspace(*experiment.span, 4_001)
    errors = spread(np.abs(z(t) - experiment.truth(t)).max() for z in solutions)
    reached = all(z.record.stopped == "accuracy" for z in solutions)
    experiment.claim(
        "II.B",
        "training can be stopped at an accuracy chosen beforehand, here 1e-4",
        f"largest component error {short(errors)}" + ("" if reached else "; not reached by all"),
        reached and errors[2] <= 1e-4,
    )


def judge_outside(experiment, found):
    """Measure the error beyond the span."""
    start, end = experiment.span
    inside, beyond = np.linspace(start, end, 2_001), np.linspace(end, 1.1 * end, 400)[1:]
    solutions = found.solutions["accuracy = 1e-4 asked for"]
    factors = spread(
        np.abs(z(beyond, extrapolate=True) - experiment.truth(beyond)).max()
        / np.abs(z(inside) - experiment.truth(inside)).max()
        for z in solutions
    )
    experiment.claim(
        "II.A",
        "the error increases rapidly outside the span",
        f"a tenth of the span beyond its end it is {short(factors)} times as large",
        factors[1] > 10,
    )


def judge_limit(experiment, found):
    """Test dN/dt = J grad H(N), with z0 added to N, where exp(-t) is small."""
    start, end = experiment.span
    t = np.linspace(start + 0.5 * (end - start), end, 2_001)
    late, whole = [], []
    for z in found.solutions["50 neurons, noise of the code"]:
        with torch.no_grad():
            value, rate = z.trial.network(torch.from_numpy((t - start) / z.trial.tau))
            rate = rate / z.trial.tau
        H = experiment.problem.H.compile("numpy")
        residual = H.residual(z.z0 + value.numpy(), rate.numpy())
        late.append(np.linalg.norm(residual, axis=-1).max())
        whole.append(z.ell_max)
    late, whole = spread(late), spread(whole)
    experiment.claim(
        "II.A",
        "the network itself obeys dN/dt = J grad H(N) once exp(-t) is small",
        f"residual of z0 + N in the second half {short(late)}, of z^ over the span {short(whole)}; "
        f"exp(-t) is {math.exp(-t[0]):.0e} there at most; one trajectory is no symplectic map",
        late[0] < 10 * max(whole[0], math.exp(-t[0])),
    )


def judge_span(experiment, rows):
    """Measure the cost of a longer span."""
    near, far = rows["50 neurons, noise of the code"], rows["20 pi, 50 neurons"]
    large = rows["20 pi, 80 neurons"]
    H, z0 = experiment.problem.H, experiment.problem.z0
    windows = [len(hamsym.solve(H, z0, (0, 4 * math.pi * n)).history.edges) - 1 for n in (1, 5)]
    experiment.claim(
        "IV",
        "longer spans need more neurons and points, and cost more",
        f"error of 50 neurons on 4 pi (200 points, 10,000 epochs) {short(near['error'])} in "
        f"{near['CPU seconds'][0]:.0f} s, on 20 pi (500 points, 20,000 epochs) "
        f"{short(far['error'])} in {far['CPU seconds'][0]:.0f} s; of 80 neurons "
        f"{short(large['error'])} in {large['CPU seconds'][0]:.0f} s; features take {windows[0]} "
        f"and {windows[1]} windows",
        lower(near["error"], far["error"]),
    )


def judge_dimensions(experiment):
    """Compare a network on chains of 1 to 8 oscillators with Yoshida's method of order 8."""
    errors, costs, rivals = [], [], []
    for n in DIMENSIONS:
        problem = hamsym.systems.coupled_oscillators(n)
        options = COSINE | {"tau": 0.25, "epochs": 5_000}
        found = experiment.sweep({f"chain of {n}": options}, problem=problem)
        solution = found.median(f"chain of {n}", problem.exact)
        comparison = hamsym.compare(solution, "yoshida8", exact=problem.exact)
        errors.append(comparison.rows[0].error)
        costs.append(solution.record.cpu_seconds)
        match = comparison.matches["yoshida8"]
        rivals.append(math.nan if match.reason else match.seconds)
    listed = "; ".join(
        f"{2 * n} dimensions: error {error:.0e}, {cost:.1f} s, yoshida8 {1e6 * rival:.0f} us"
        for n, error, cost, rival in zip(DIMENSIONS, errors, costs, rivals, strict=True)
    )
    experiment.claim(
        "IV",
        "networks outperform integrators in many dimensions",
        f"chains of oscillators, 5,000 epochs, and the time for the same error: {listed}",
        costs[-1] < rivals[-1],
    )


def judge_chaos(experiment):
    """Compute the maximal Lyapunov exponent at the paper's Henon-Heiles start."""
    problem = hamsym.systems.henon_heiles()
    end = 1e4 if experiment.results["quick"] else 1e6
    found = hamsym.lyapunov(problem.H, problem.z0, (0, end))
    if not found.success:  # interrupted: the exponents end at an earlier time
        raise KeyboardInterrupt
    values = [np.interp(t, found.t, found.exponents[:, 0]) for t in (300, 1e4, end)]
    experiment.claim(
        "III.B",
        "the Henon-Heiles orbit is chaotic, with maximal exponent 0.069 (so that 6 pi and 12 pi "
        "are 1.3 and 2.6 Lyapunov times)",
        f"{values[0]:.1e} at t = 300, {values[1]:.1e} at 1e4, {values[2]:.1e} at {end:.0e}: "
        f"{found.statement}",
        0.5 < values[2] / 0.069 < 2,
    )


def judge_parallel(experiment, found):
    """Time the evaluation at many times on one thread and on two."""
    solution = found.solutions["50 neurons, noise of the code"][0]
    count = 10_000 if experiment.results["quick"] else 1_000_000
    t = torch.linspace(*experiment.span, count, dtype=torch.float64)
    threads, seconds = torch.get_num_threads(), {1: [], 2: []}
    try:
        for number in (1, 2) * 3:
            torch.set_num_threads(number)
            began = time.perf_counter()
            solution(t)
            seconds[number].append(time.perf_counter() - began)
    finally:
        torch.set_num_threads(threads)
    ratio = min(seconds[1]) / min(seconds[2])
    experiment.claim(
        "II.A, IV",
        "the network is parallel in time",
        f"{count:,} states take {min(seconds[1]):.2g} s on one thread, {ratio:.1f} times less on "
        "two",
        "held for evaluation" if ratio > 1.2 else False,
    )


def name_untested(experiment):
    """List claims without a test, with the reason."""
    for where, says, reason in (
        (
            "II.A",
            "any regularisation term may take the place of the energy penalty",
            "no other is proposed; solve takes any as Regularizer(weight, function)",
        ),
        (
            "IV",
            "parallel hardware drastically accelerates training",
            "needs hardware with many more cores than two",
        ),
        (
            "III.B",
            "the energy penalty helps the long Henon-Heiles solution",
            "the paper shows that solution with the penalty alone, and so does B-long here",
        ),
        ("IV", "data can be added in a semi-supervised fashion", "no method is given"),
    ):
        experiment.claim(where, says, reason, "not tested")


if __name__ == "__main__":
    main()
