"""Flow maps by trained networks: evaluation, training, files, several processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import hamsym
from hamsym import FlowMap, InputError, flow_map
from hamsym.errors import FileError
from hamsym.flow_maps import network_training, storage
from hamsym.flow_maps.box import Box, checked_box
from hamsym.flow_maps.domain import box_domain
from hamsym.flow_maps.expansion import Chain
from hamsym.flow_maps.network_map import NetworkMap
from hamsym.flow_maps.network_residual import Points, Residual, Window
from hamsym.flow_maps.network_training import WindowTraining
from hamsym.support.tensor_files import read_tensors, write_tensors

OSCILLATOR = "p**2/2 + x**2/2"
STARTS = {"x": (1.0, 1.4), "p": (-0.2, 0.2)}
SMALL: dict[str, Any] = {"method": "network", "hidden": (8, 8), "points": 100, "stages": 2}
CPU = torch.device("cpu")


def trained(**options: Any) -> FlowMap:
    return flow_map(OSCILLATOR, STARTS, (0, 1), **{"tol": 1e-3, **SMALL, **options})


def weights(flow: FlowMap) -> np.ndarray:
    arrays = flow.map.arrays()
    return np.concatenate([arrays[name].ravel() for name in sorted(arrays)])


def window_of(box: Box, envelope: str = "exponential", end: float = 1.5) -> Window:
    return Window(box_domain(box), box.at, 0.5, end, (5, 4), envelope, 0.7)


def random_weights(window: Window) -> torch.Tensor:
    generator = torch.Generator().manual_seed(3)
    return torch.randn(window.count, generator=generator, dtype=torch.float64)


@pytest.fixture(scope="module")
def flow() -> FlowMap:
    return trained()


# -- evaluation ----------------------------------------------------------------------------------


@pytest.mark.parametrize("envelope", ["exponential", "linear"])
@pytest.mark.parametrize("end", [1.5, -1.0])
def test_derivatives_agree_with_automatic_ones(envelope: str, end: float) -> None:
    box = checked_box("p**2/2 + k*x**2/2", {"x": "k**2", "p": (0, 1)}, {"k": (0.5, 1.5)})
    window = window_of(box, envelope, end)
    map = window.map(random_weights(window))
    random = np.random.default_rng(0)
    t, inputs = random.uniform(*sorted((0.5, end)), 6), box.at(random.uniform(-1, 1, (6, 2)))
    states, rates, jacobian = map.derivatives(t, inputs)

    def one(time: torch.Tensor, given: torch.Tensor) -> torch.Tensor:
        return map.evaluate(time[None], given[None], torch)[0]

    by_time, by_input = torch.func.vmap(torch.func.jacrev(one, (0, 1)))(
        torch.tensor(t), torch.tensor(inputs)
    )
    assert np.allclose(states, map.evaluate(t, inputs), rtol=0, atol=1e-13)
    assert np.allclose(rates, by_time.numpy(), rtol=0, atol=1e-12)
    assert np.allclose(jacobian, by_input.numpy(), rtol=0, atol=1e-12)


def test_any_weights_start_exactly() -> None:
    box = checked_box("p**2/2 + k*x**2/2", {"x": "k**2", "p": (0, 1)}, {"k": (0.5, 1.5)})
    window = window_of(box)
    inputs = box.at(np.random.default_rng(1).uniform(-1, 1, (20, 2)))
    found = window.map(random_weights(window)).evaluate(np.full(20, 0.5), inputs)
    assert np.allclose(found, box.states(inputs), rtol=0, atol=1e-14)


def test_many_queries_equal_single_ones(flow: FlowMap) -> None:
    y = np.random.default_rng(0).uniform(-1, 1, (9_000, 2))
    inputs, times = flow.region.at(y), np.linspace(0, 1, 9_000)
    found = flow.map.evaluate(times, inputs)
    few = [0, 4_095, 4_096, 8_999]
    assert np.allclose(found[few], flow.map.evaluate(times[few], inputs[few]), rtol=0, atol=1e-14)


# -- residual ------------------------------------------------------------------------------------


@pytest.mark.parametrize("envelope", ["exponential", "linear"])
def test_derivative_of_rows_agrees_with_automatic_one(envelope: str) -> None:
    H = "p_x**2/2 + p_y**2/2 + k*x**2*y**2 + x*cos(t) + p_x*y"
    box = checked_box(H, {"x": (0, 1), "y": 0.3, "p_x": (0, 1), "p_y": -0.2}, {"k": (1, 2)})
    window = window_of(box, envelope)
    scale = np.array([1.0, 2.0, 3.0, 4.0])
    residual, theta = Residual(window, box.H, scale, CPU), random_weights(window)
    points = Points(window, 7, 0.8, [0], CPU)
    with torch.no_grad():
        rates = residual.derivative(theta, points)
        gram = rates.gram()
        products = rates.transposed(residual.rows(theta, points)[0])
    J = torch.func.jacrev(lambda weights: residual.rows(weights, points)[0])(theta)
    J = J.reshape(-1, window.count)
    rows = residual.rows(theta, points)[0].reshape(-1)
    assert torch.allclose(gram, (J.T @ J).tril(), rtol=1e-10, atol=1e-10)
    assert torch.allclose(products, J.T @ rows, rtol=1e-10, atol=1e-10)


def test_rows_are_the_residual_of_the_map() -> None:
    box = checked_box("p**2/2 + k*x**4", STARTS, {"k": (1, 2)})
    window, scale = window_of(box), np.array([2.0, 3.0])
    theta, points = random_weights(window), Points(window_of(box), 30, 1.0, [4], CPU)
    rows, _ = Residual(window, box.H, scale, CPU).rows(theta, points)
    inputs = window.domain.at(points.x[:, 1:].numpy())
    states, rates, _ = window.map(theta).derivatives(points.t.numpy(), inputs)
    (x, p), k = states.T, inputs[:, 2]
    expected = rates - np.stack((p, -4 * k * x**3), axis=1)
    assert np.allclose(rows.numpy(), expected / scale, rtol=0, atol=1e-11)


# -- training ------------------------------------------------------------------------------------


def test_success_means_error_within_the_tolerance(flow: FlowMap) -> None:
    assert flow.success
    assert "converged" in flow.message
    starts = np.random.default_rng(5).uniform([1, -0.2], [1.4, 0.2], (500, 2))
    t = np.linspace(0, 1, 500)
    (x, p), c, s = starts.T, np.cos(t), np.sin(t)
    error = np.abs(flow(t, starts) - np.stack((c * x + s * p, c * p - s * x), axis=1))
    assert (error.max(axis=0) <= flow.error_estimate).all()
    assert (flow.error_estimate <= 1e-3 * np.array([1.42, 1.42])).all()


@pytest.mark.slow
def test_parameters_and_time_enter_the_training() -> None:
    # x = x0 + g t**2 / 2 + sin(t) - t from rest, with H = p**2/2 - g x + x sin(t).
    flow = flow_map(
        "p**2/2 - g*x + x*sin(t)", {"x": (0, 1), "p": 0}, (0, 1), {"g": (1, 2)}, tol=1e-2, **SMALL
    )
    assert flow.success
    found = flow([0.4, 1.0], {"x": [0.2, 0.9]}, {"g": [1.1, 1.8]})[:, 0]
    exact = [0.2 + 1.1 * 0.08 + np.sin(0.4) - 0.4, 0.9 + 0.9 + np.sin(1) - 1]
    assert np.allclose(found, exact, rtol=0, atol=0.02)


def test_adam_lowers_the_error() -> None:
    few = trained(optimizer="adam", iterations=50, collocation_points=100, stages=1)
    many = trained(optimizer="adam", iterations=600, collocation_points=100, stages=1)
    assert many.excess < 0.3 * few.excess
    assert "600 iterations, all iterations done" in many.message


def test_windows_follow_each_other() -> None:
    flow = flow_map(OSCILLATOR, STARTS, (0, -2), tol=1e-2, windows=2, **SMALL)
    assert flow.success
    assert isinstance(flow.map, Chain)
    assert "converged in 2 of 2 windows" in flow.message
    start = [1.2, 0.1]
    before, after = flow([-1 + 1e-9, -1 - 1e-9], [start, start])
    assert np.allclose(before, after, rtol=0, atol=1e-7)
    assert np.allclose(flow(-2.0, start)[0], 1.2 * np.cos(2) - 0.1 * np.sin(2), atol=0.02)


def test_time_limit_ends_the_training() -> None:
    flow = trained(tol=1e-9, time_limit=0.3)
    assert not flow.success
    assert "time limit reached" in flow.message
    assert flow.span == (0, 1)
    assert np.isfinite(flow.error_estimate).all()


def test_patience_ends_the_training() -> None:
    flow = trained(tol=1e-9, hidden=(3,), patience=10, iterations=400)
    assert "no lower loss in the last iterations" in flow.message


def test_interruption_keeps_what_there_is(monkeypatch: pytest.MonkeyPatch) -> None:
    iterate = WindowTraining._iterate

    def interrupted(self: WindowTraining, *arguments: Any) -> Any:
        if self.progress.iteration == 2:
            signal.raise_signal(signal.SIGINT)
        return iterate(self, *arguments)

    monkeypatch.setattr(WindowTraining, "_iterate", interrupted)
    handler = signal.getsignal(signal.SIGINT)
    flow = trained(stages=100)
    assert not flow.success
    assert "interrupted" in flow.message
    assert 0 < flow.span[1] < 0.1
    assert signal.getsignal(signal.SIGINT) is handler


def test_same_seed_gives_the_same_weights() -> None:
    one, again, other = (trained(iterations=8, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(weights(one), weights(again))
    assert not np.array_equal(weights(one), weights(other))


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"max_solutions": 5}, "of method 'features'"),
        ({"width": 5}, "'width' is not an argument of flow_map; give hidden="),
        ({"hidden": ()}, "hidden="),
        ({"hidden": (8, 0)}, "hidden="),
        ({"hidden": "8"}, "hidden="),
        ({"optimizer": "sgd"}, "levenberg-marquardt"),
        ({"envelope": "sine"}, "exponential"),
        ({"device": "tpu"}, "cpu"),
        ({"windows": 0}, "windows=0"),
        ({"stages": 1.5}, "stages=1.5"),
        ({"collocation_points": 0}, "collocation_points=0"),
        ({"frequency": float("nan")}, "frequency=nan"),
        ({"learning_rate": -1}, "learning_rate=-1"),
        ({"time_limit": 0}, "time_limit=0"),
        ({"tau": -2.0}, "tau=-2.0"),
    ],
)
def test_unusable_options_are_refused(options: dict[str, Any], text: str) -> None:
    with pytest.raises(InputError, match=text):
        trained(**options)


def test_options_of_networks_are_refused_with_features() -> None:
    with pytest.raises(InputError, match="of method 'network'"):
        flow_map(OSCILLATOR, STARTS, (0, 1), hidden=(8, 8))
    with pytest.raises(InputError, match='"features" or "network"'):
        flow_map(OSCILLATOR, STARTS, (0, 1), method="bundle")


def test_windows_need_a_whole_box() -> None:
    with pytest.raises(InputError, match="give windows=1"):
        flow_map(OSCILLATOR, {"x": (1, 2), "p": 0}, (0, 1), **SMALL, windows=2)


# -- files ---------------------------------------------------------------------------------------


def test_saved_map_is_the_same(flow: FlowMap, tmp_path: Path) -> None:
    flow.save(tmp_path / "map")
    again = hamsym.load(tmp_path / "map")
    assert isinstance(again.map, NetworkMap)
    assert (again.method, again.message) == ("network", flow.message)
    queries = np.linspace(0, 1, 7), flow.region.at(np.random.default_rng(0).uniform(-1, 1, (7, 2)))
    assert np.array_equal(again(*queries), flow(*queries))


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda arrays, form: arrays.update({"map.1.bias": np.zeros(7)}), "bias|matrix"),
        (lambda arrays, form: arrays.update({"map.0.matrix": np.zeros((8, 2))}), "matrix"),
        (lambda arrays, form: arrays["map.2.bias"].fill(np.nan), "not finite"),
        (lambda arrays, form: arrays.pop("map.2.bias"), "bias"),
        (lambda arrays, form: form.update(layers=2), "shape|not a part"),
        (lambda arrays, form: form.update(layers=0), "no hidden layer"),
        (lambda arrays, form: form.update(tau=-1.0), "signs differ"),
        (lambda arrays, form: form.update(envelope="none"), "envelope"),
        (lambda arrays, form: form.update(extra=1), "extra"),
    ],
)
def test_damaged_files_are_refused(flow: FlowMap, tmp_path: Path, change: Any, text: str) -> None:
    path = tmp_path / "map"
    flow.save(path)
    arrays, values = read_tensors(path, storage.KIND)
    change(arrays, values["map"])
    write_tensors(path, storage.KIND, arrays, values)
    with pytest.raises(FileError, match=text):
        hamsym.load(path)


# -- checkpoints ---------------------------------------------------------------------------------


@pytest.mark.parametrize("optimizer", ["levenberg-marquardt", "adam"])
def test_resumed_training_has_the_same_bits(
    optimizer: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = {
        "tol": 1e-9, "iterations": 14, "optimizer": optimizer, "windows": 2, "checkpoint_every": 4
    }  # fmt: skip
    whole = trained(**settings)
    path = tmp_path / "checkpoint"
    iterate = WindowTraining._iterate

    class LostError(Exception):
        pass

    def lost(self: WindowTraining, *arguments: Any) -> Any:
        if self.window.begin > 0 and self.progress.iteration == 6:
            raise LostError
        return iterate(self, *arguments)

    monkeypatch.setattr(WindowTraining, "_iterate", lost)
    with pytest.raises(LostError):
        trained(**settings, checkpoint=path)
    monkeypatch.undo()
    assert np.array_equal(weights(trained(**settings, checkpoint=path)), weights(whole))
    # What is done is not done again.
    monkeypatch.setattr(WindowTraining, "_iterate", lost)
    assert np.array_equal(weights(trained(**settings, checkpoint=path)), weights(whole))


def test_checkpoint_of_another_training_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint"
    trained(iterations=2, checkpoint=path)
    with pytest.raises(FileError, match="another file"):
        trained(iterations=2, checkpoint=path, hidden=(9, 9))
    with pytest.raises(FileError, match="does not exist"):
        trained(iterations=2, checkpoint=tmp_path / "none" / "checkpoint")
    with pytest.raises(InputError, match="not a path"):
        trained(iterations=2, checkpoint=5)


@pytest.mark.parametrize(
    "change",
    [
        lambda arrays, values: arrays.update({"best.0": np.zeros(3)}),
        lambda arrays, values: arrays["now.theta"].fill(np.inf),
        lambda arrays, values: arrays.update({"now.other": np.zeros(3)}),
        lambda arrays, values: values["optimizer"].update(mu=-1.0),
        lambda arrays, values: values.update(reasons=["tired"]),
        lambda arrays, values: values["progress"][0].update(stage=9),
        lambda arrays, values: values.update(progress=[], reasons=[]),
        lambda arrays, values: values.pop("seconds"),
    ],
)
def test_damaged_checkpoints_are_refused(change: Any, tmp_path: Path) -> None:
    path = tmp_path / "checkpoint"
    trained(iterations=2, checkpoint=path)
    arrays, values = read_tensors(path, "checkpoint")
    change(arrays, values)
    write_tensors(path, "checkpoint", arrays, values)
    with pytest.raises(FileError, match="not a valid checkpoint"):
        trained(iterations=2, checkpoint=path)


# -- several processes ---------------------------------------------------------------------------

SCRIPT = """
import os, signal, sys
import numpy as np
from hamsym import flow_map
from hamsym.flow_maps.network_training import WindowTraining

folder, kill = sys.argv[1], sys.argv[2] == "kill"
rank, restarts = os.environ["RANK"], os.environ["TORCHELASTIC_RESTART_COUNT"]
iterate = WindowTraining._iterate

def lost(self, *arguments):
    if kill and rank == "1" and restarts == "0" and self.progress.iteration == 13:
        os.kill(os.getpid(), signal.SIGKILL)
    return iterate(self, *arguments)

WindowTraining._iterate = lost
flow = flow_map(
    "p**2/2 + x**2/2", {"x": (1.0, 1.4), "p": (-0.2, 0.2)}, (0, 1), tol=1e-9, method="network",
    hidden=(8, 8), points=100, stages=2, iterations=20, checkpoint=folder + "/checkpoint",
    checkpoint_every=5, progress=True,
)
arrays = flow.map.arrays()
np.savez(f"{folder}/{rank}", excess=flow.excess, restarts=int(restarts), **arrays)
print(flow.message)
"""


def run_on_two(folder: Path, mode: str) -> list[dict[str, np.ndarray]]:
    """Run the script in two processes; return what each of them saved."""
    folder.mkdir()
    (folder / "script.py").write_text(SCRIPT)
    command = [
        *(sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"),
        *("--max-restarts", "1", str(folder / "script.py"), str(folder), mode),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert "by 2 processes" in done.stdout
    assert done.stderr.count("iteration 20: held-out") <= 1  # of the first process alone
    return [dict(np.load(folder / f"{rank}.npz")) for rank in (0, 1)]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="gloo on localhost")
def test_a_lost_process_is_restarted_to_the_same_weights(tmp_path: Path) -> None:
    first, second = run_on_two(tmp_path / "whole", "whole")
    names = set(first) - {"restarts"}
    assert first["restarts"] == 0
    assert all(np.array_equal(first[name], second[name]) for name in names)
    for found in run_on_two(tmp_path / "killed", "kill"):
        assert found["restarts"] == 1
        assert all(np.array_equal(first[name], found[name]) for name in names)
    alone = trained(tol=1e-9, iterations=20).map.arrays()
    assert not np.array_equal(alone["0.matrix"], first["0.matrix"])  # half of the rows


def test_world_size_must_be_a_number(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(os.environ, "WORLD_SIZE", "many")
    with pytest.raises(InputError, match="WORLD_SIZE"):
        trained(iterations=1)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_missing_gpu_is_refused() -> None:
    with pytest.raises(InputError, match="no GPU"):
        trained(device="cuda")


def test_pieces_resolve_the_fastest_neuron() -> None:
    box = checked_box(OSCILLATOR, STARTS, None)
    window = window_of(box)
    theta = random_weights(window)
    slow = network_training.pieces(window.map(0.01 * theta))
    fast = network_training.pieces(window.map(100 * theta))
    assert len(fast) > 4 * len(slow)
    assert (slow[0], slow[-1]) == (0.5, 1.5)
