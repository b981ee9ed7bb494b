"""The paper's experiments in miniature: what they write, not whether so little training is good."""

import json
import math
import subprocess
import sys

import numpy as np
import pytest

import hamsym
from hamsym.cli.commands import main
from hamsym.paper import (
    accuracy,
    claims,
    drawing,
    henon_heiles,
    henon_heiles_long,
    oscillator,
    oscillator_long,
    page,
)
from hamsym.paper.experiment import ARCHITECTURES, CHAIN, arguments, limit, parse
from hamsym.paper.judging import euler, judge_architectures, judge_steps
from hamsym.paper.tables import lower, markdown_table, short, spread

SCRIPTS = (oscillator, oscillator_long, henon_heiles, henon_heiles_long, accuracy, claims)


def _written(folder, scripts):
    """What these scripts and the page write, with two epochs and one seed."""
    miniature = ["--epochs=2", "--seeds=1", "--seed=4", "--certify=0", "--workers=1"]
    for script in scripts:
        script.main([*miniature, f"--out={folder}"])
    page.main([f"--out={folder}"])
    everything = json.loads((folder / "results.json").read_text())
    names = [script.__name__.rpartition(".")[2].replace("_", "-") for script in scripts]
    assert [experiment["name"] for experiment in everything] == names
    return everything


@pytest.mark.slow
def test_script_writes_table_figures_and_page(tmp_path, monkeypatch):
    """One of the five, on a short span, with small networks."""
    small = {
        name: options | {"hidden": (4, 4)} if "hidden" in options else options
        for name, options in oscillator.SETTINGS.items()
    }
    monkeypatch.setattr(oscillator, "SETTINGS", small)
    monkeypatch.setattr(oscillator, "SPAN", (0.0, 1.0))
    everything = _written(tmp_path, [oscillator])
    _check_files(tmp_path, [oscillator], everything)


@pytest.mark.slow
def test_accuracy_draws_every_method(tmp_path, monkeypatch):
    """On a short span, with small networks and two amounts of training."""
    (title, methods), *_ = accuracy.COURSES.items()
    small = {
        name: [
            o if o["method"] in ("features", CHAIN["method"]) else o | {"hidden": (4,)}
            for o in several[:2]
        ]
        for name, several in methods.items()
    }
    drawn = {}
    monkeypatch.setattr(oscillator, "SPAN", (0.0, 1.0))
    monkeypatch.setattr(accuracy, "COURSES", {title: small})
    monkeypatch.setattr(accuracy, "draw", lambda axis, values: drawn.update(values))
    miniature = ["--epochs=20", "--seeds=2", "--certify=0", "--workers=1", f"--out={tmp_path}"]
    accuracy.main(miniature)
    rows = json.loads((tmp_path / "accuracy" / "results.json").read_text())["rows"]
    assert list(drawn) == list(methods)
    place = 0
    for name, points in drawn.items():
        first, place = rows[place], place + len(small[name])
        assert points.shape == (len(small[name]), 2, 2)
        assert (points > 0).all()
        assert name.removesuffix(", one network") in first["method"]
        for column, shown in ((0, "CPU seconds"), (1, "error")):
            assert points[0, :, column].min() == pytest.approx(first[shown][1])
            assert points[0, :, column].max() == pytest.approx(first[shown][2])
    assert place == len(rows)


def test_accuracy_draws_seeds_thin_and_the_median_thick():
    points = np.array([[[1, 3.0], [2, 1.0], [3, 2.0]], [[20, 0.3], [10, 0.1], [30, 0.2]]])
    _, axes = drawing.figure(1, 1)
    accuracy.draw(axes[0, 0], {"SSBroyden": points})
    *thin, thick = axes[0, 0].lines
    assert [line.get_xydata().tolist() for line in thin] == points.swapaxes(0, 1).tolist()
    assert thick.get_xydata().tolist() == [[2, 2.0], [20, 0.2]]
    assert thick.get_linewidth() > 2 * thin[0].get_linewidth()


def test_accuracy_tells_methods_apart_by_colour_and_by_marker():
    for methods in accuracy.COURSES.values():
        assert {*methods} <= {*accuracy.STYLES}
    colors, markers, _ = zip(*accuracy.STYLES.values(), strict=True)
    assert len({*colors}) == len({*markers}) == len(accuracy.STYLES)


@pytest.mark.slow
def test_every_script_writes_table_figures_and_page(tmp_path):
    everything = _written(tmp_path, SCRIPTS)
    assert [experiment["name"] for experiment in everything] == list(page.EXPERIMENTS)
    _check_files(tmp_path, SCRIPTS, everything)


def _check_files(written, scripts, everything):
    text = (written / "page.md").read_text()
    for script, experiment in zip(scripts, everything, strict=True):
        folder = written / experiment["name"]
        assert json.loads((folder / "results.json").read_text()) == experiment
        table = (folder / "table.md").read_text()
        names = [row["method"] for row in experiment["rows"]]
        for name in getattr(script, "SETTINGS", {}):
            assert name in names
        for row in experiment["rows"]:
            assert f"| {row['method']} | {row['points']:,} |" in table
            middle, least, most = (float(value) for value in row["error"])
            assert 0 <= least <= middle <= most
        assert table.partition("\n\n")[2].strip() in text
        for figure in experiment["figures"]:
            assert (folder / figure["file"]).stat().st_size > 10_000
            assert f"]({experiment['name']}/{figure['file']})" in text
        assert experiment["quick"]
        for claim in experiment["claims"]:
            assert claim["says"].replace("|", "\\|") in text
            assert claim["verdict"].startswith("not ")
    assert (written / "scheme.png").exists()
    assert "This is a quick look" in text
    # Each line of the first table names rows that are there.
    for experiment in everything:
        names = {row["method"] for row in experiment["rows"]}
        for line in experiment.get("summary", ()):
            assert {name for name in line["rows"].values() if name} <= names

    # What the text names is what ran: the settings of one row, and its error measured anew.
    first = everything[0]
    row = next(row for row in first["rows"] if row["method"] == "features, tol = 1e-6")
    problem = hamsym.systems.nonlinear_oscillator()
    solution = hamsym.solve(problem.H, problem.z0, oscillator.SPAN, tol=1e-6, seed=4)
    t = np.linspace(*oscillator.SPAN, 4_001)
    error = np.linalg.norm(solution(t) - problem.exact(t), axis=-1).max()
    assert row["error"][0] == pytest.approx(error, rel=1e-6)


def test_settings_are_those_of_the_paper():
    written = oscillator.SETTINGS["as written: sin, 1 - exp(-t)"]
    assert written["epochs"] == 50_000
    assert written["points"] == 200
    assert written["hidden"] == (50, 50)
    assert written["noise"] == pytest.approx(0.06 * math.pi)
    assert written["learning_rate"] == 8e-3
    assert written["schedule"] == "constant"
    assert "betas" not in written
    assert "energy_weight" not in written
    spacing = 4 * math.pi / 200
    published = oscillator.SETTINGS["authors' code: sin, 1 - exp(-t)"]
    assert published["noise"] / spacing == pytest.approx(0.377, abs=1e-3)
    published = oscillator_long.SETTINGS["authors' code, lambda = 1"]
    assert published["noise"] / (20 * math.pi / 500) == pytest.approx(1.885, abs=1e-3)
    assert henon_heiles.SETTINGS["as written: sin, t"]["epochs"] == 30_000
    published = henon_heiles.SETTINGS["authors' code: sigmoid, t"]
    assert published["noise"] / (6 * math.pi / 100) == pytest.approx(5.65, abs=1e-2)
    assert published["activation"] == "sigmoid"
    assert published["envelope"] == "linear"


def test_limit_shortens_trainings_only():
    adam = {"method": "adam", "epochs": 50_000, "points": 3}
    assert limit(adam, None) == adam
    assert limit(adam, 20) == {"method": "adam", "epochs": 20, "points": 3}
    assert limit(lambda seed: adam, 20)(1)["epochs"] == 20
    assert limit({"method": "levenberg-marquardt", "tau": 2.0}, 300)["iterations"] == 30
    assert limit(CHAIN, 300) == CHAIN
    assert limit(CHAIN | {"windows": 1, "tol": 1e-4}, 300) == CHAIN | {"windows": 1, "tol": 1e-4}
    assert limit({"method": "levenberg-marquardt", "tol": 2e-7}, 300)["iterations"] == 30
    assert limit({"method": "ssbroyden"}, 300)["iterations"] == 30
    assert limit({"method": "lbfgs", "iterations": 5}, 300)["iterations"] == 5
    assert limit({"method": "features"}, 20) == {"method": "features"}


def test_settings_become_arguments_of_solve():
    adam = {"method": "adam", "epochs": 20, "points": 3}
    assert arguments(adam) == {"method": hamsym.Adam(epochs=20, points=3)}
    assert arguments(lambda seed: adam | {"points": seed})(5)["method"].points == 5
    chain = {"tol": 1e-4, "method": hamsym.NetworkChain(windows=1)}
    assert arguments(CHAIN | {"windows": 1, "tol": 1e-4}) == chain


def test_quick_is_a_limit_of_epochs():
    assert parse("x", ["--quick"]).epochs == 300
    assert parse("x", ["--quick", "--epochs", "7"]).epochs == 7
    assert parse("x", []).epochs is None


@pytest.mark.parametrize("name", ["seed=-1", "seeds=0", "epochs=0", "workers=0", "certify=-1"])
def test_bad_numbers_are_rejected(name, capsys):
    with pytest.raises(SystemExit) as ended:
        parse("x", [f"--{name}"])
    assert ended.value.code == 2
    assert f"--{name.replace('=', ' ')}" in capsys.readouterr().err


def test_overlapping_seeds_are_undecided():
    assert lower([2.0, 1.0, 3.0], [5.0, 4.0, 6.0]) is True
    assert lower([5.0, 4.0, 6.0], [2.0, 1.0, 3.0]) is False
    assert lower([2.0, 1.0, 4.5], [5.0, 4.0, 6.0]).startswith("undecided")


class _Claims:
    """Takes claims as an experiment does."""

    points = 200

    def __init__(self):
        self.verdicts = []

    def claim(self, where, says, measured, held):
        self.verdicts.append(held)


def _rows(losses):
    found = {}
    for recipe in ("as written", "authors' code"):
        for name, loss in zip(ARCHITECTURES, losses, strict=True):
            found[f"{recipe}: {name}"] = {"loss": loss, "error": loss}
    return found


@pytest.mark.parametrize(
    ("losses", "verdict"),
    [
        ([[1, 1, 1], [2, 2, 2], [3, 3, 3], [4, 4, 4]], True),
        ([[3, 3, 3], [2, 2, 2], [5, 5, 5], [4, 4, 4]], False),
        ([[1, 1, 3], [2, 2, 2], [5, 5, 5], [4, 4, 4]], "undecided"),
    ],
)
def test_which_architecture_is_best(losses, verdict):
    claims_taken = _Claims()
    judge_architectures(claims_taken, _rows([[float(x) for x in loss] for loss in losses]))
    for found in claims_taken.verdicts:
        assert str(found).startswith(str(verdict))


@pytest.mark.parametrize(
    ("error", "verdict"), [(6e-3, "True"), (6e-2, "False"), (6e-4, "held, and more")]
)
def test_how_many_points_euler_needs(error, verdict):
    """By one run of 100 K steps with an error of 6e-3, which falls as the steps grow."""
    problem = hamsym.systems.nonlinear_oscillator()
    solution = hamsym.solve(problem.H, problem.z0, (0, 4 * math.pi), tol=1e-6)
    comparison = hamsym.compare(
        solution, "symplectic_euler", points=200, exact=problem.exact, max_steps=20_000
    )
    assert euler(comparison, 100)[0].error == pytest.approx(6e-3, rel=0.01)
    taken = _Claims()
    judge_steps(taken, comparison, {"error": [error] * 3}, "III", 100)
    assert str(taken.verdicts[0]).startswith(verdict)


def test_numbers_in_tables():
    assert spread([3.0, 1.0, 2.0]) == [2.0, 1.0, 3.0]
    assert spread([4.0, 1.0]) == [1.0, 1.0, 4.0]
    assert short([2.34e-3, 1e-4, 0.5]) == "2.3e-3 (1.0e-4 to 5.0e-1)"
    assert short([1.0, 1.0, 1.0]) == "1.0e0"
    assert short("inf") == short(math.inf) == "infinite"
    assert short(None) == short(math.nan) == ""
    row = {"method": "m", "points": 5, "evaluations": [1234.0] * 3, "error": [1e-3] * 3}
    row |= {
        "energy error": [1e-4] * 3,
        "CPU seconds": [12.3] * 3,
        "seconds": [9.87] * 3,
        "refused": ["why"],
    }
    last = markdown_table([row]).splitlines()[-1]
    assert last == "| m | 5 | 1,234 | 1.0e-3 | 1.0e-4 | refused | 12 | 9.9 |"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["oscilator"], "'oscilator' is not one of"),
        (["oscillator", "--seed", "-1"], "--seed=-1"),
        (["oscillator", "--seeds", "0"], "--seeds=0"),
        (["oscillator", "--workers", "0"], "--workers=0"),
        (["oscillator", "--seed", "x"], "'x' is not a valid integer"),
        (["oscillator", "--out", "FILE"], "FILE"),
    ],
)
def test_bad_command_line_is_rejected(arguments, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "FILE").write_text("")
    assert main(["reproduce", *arguments]) == 2
    complaint = capsys.readouterr().err
    assert message in complaint
    assert complaint.count("\n") == 1


def test_page_without_results_is_rejected(tmp_path, capsys):
    with pytest.raises(SystemExit):
        page.main([f"--out={tmp_path}"])
    assert "contains no results" in capsys.readouterr().err


_HOLD = """
import sys
from hamsym.support.locking import exclusive
with exclusive(sys.argv[1]):
    print("held", flush=True)
    input()
"""


def test_folder_is_locked_against_other_commands(tmp_path, monkeypatch, capsys):
    for script in (oscillator, page):
        monkeypatch.setattr(script, "main", lambda options: None)
    command = ["reproduce", "oscillator", "--out", str(tmp_path)]
    run = [sys.executable, "-c", _HOLD, str(tmp_path)]
    with subprocess.Popen(run, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout.readline() == "held\n"
        assert main(command) == 2
        complaint = capsys.readouterr().err
        assert f"'{tmp_path}' is in use by another process" in complaint
        assert complaint.count("\n") == 1
        other.communicate("\n")
    assert main(command) == 0


def test_command_runs_the_named_experiment(tmp_path, monkeypatch, capsys):
    called = []
    for script in (*SCRIPTS, page):

        def record(options, name=script.__name__):
            called.append((name, options))

        monkeypatch.setattr(script, "main", record)
    out = ["--out", str(tmp_path)]
    assert main(["reproduce", "henon-heiles", "--quick", "--seed", "7", *out]) == 0
    quick = tmp_path / "quick"  # apart from what took hours
    options = ["--seed=7", "--seeds=1", f"--out={quick}", "--quick"]
    assert called == [
        ("hamsym.paper.henon_heiles", options),
        ("hamsym.paper.page", [f"--out={quick}"]),
    ]
    called.clear()
    assert main(["reproduce", "all", "--claims", *out]) == 0
    assert [name.rpartition(".")[2] for name, _ in called] == [
        *(name.replace("-", "_") for name in page.EXPERIMENTS),
        "page",
    ]
