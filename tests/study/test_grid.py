"""Sweeps over a grid to a store: values of the functions alone, resumed, refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hamsym
from hamsym.study import grid as grid_module
from hamsym.study.grid_stores import box_shape
from hamsym.support import atomic

xarray = pytest.importorskip("xarray")
pytest.importorskip("zarr")

H = hamsym.Hamiltonian("(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2 + k*(x**2*y - y**3/3)")
START = {"x": 0.0, "y": 0.1, "p_y": 0.0}
SPAN = (0.0, 20.0)
T = [0.0, 7.5, 20.0]
OVER = {"k": [0.2, 1.0], "energy": [0.02, 0.1, 5.0]}  # the last one escapes where k = 1


def swept(store: Path, **more: Any) -> Any:
    given = {"over": OVER, "store": store, "t": T} | more
    given = {name: value for name, value in given.items() if value is not None}
    return hamsym.sweep(H, START, SPAN, **given)


@pytest.mark.slow_cases("2", "1")
@pytest.mark.parametrize("chunk", [1, 2, 100])
def test_states_are_those_of_solve_many(tmp_path: Path, chunk: int) -> None:
    found = swept(tmp_path / "a.zarr", chunk=chunk)
    assert repr(found) == "StoredSweep('a.zarr', shape (2, 3): 6 of 6)"
    data = xarray.open_zarr(tmp_path / "a.zarr")
    k, energy = np.meshgrid(*OVER.values(), indexing="ij")
    starts = H.state_at_energy(energy, START, parameters={"k": k}, missing="nan")
    many = hamsym.solve_many(H, starts, SPAN, parameters={"k": k})
    assert data["state"].dims == ("k", "energy", "time", "component")
    np.testing.assert_array_equal(data["state"], many(T))
    for name in ("success", "message", "largest_error", "excess", "z0"):
        np.testing.assert_array_equal(data[name], getattr(many, name), name)
    assert data["state"].sel(k=1.0, energy=0.1, time=7.5, component="x") == many(T)[1, 1, 1, 0]
    assert data["done"].all()
    assert (data.attrs["H"], data.attrs["complete"]) == (H.formula, 1)


@pytest.mark.slow
def test_exponents_are_those_of_a_map(tmp_path: Path) -> None:
    options = {"count": 2, "dt": 0.1}
    swept(tmp_path / "a.zarr", task="lyapunov", t=None, **options)
    data = xarray.open_zarr(tmp_path / "a.zarr")
    for i, k in enumerate(OVER["k"]):
        own = H.with_parameters(k=k)
        starts = own.state_at_energy(np.array(OVER["energy"]), START, missing="nan")
        found = hamsym.lyapunov(own, starts, SPAN, **options)
        np.testing.assert_array_equal(data["exponent"][i], found.exponents)
        np.testing.assert_array_equal(data["message"][i], found.message)
    assert data["exponent"].sel(rank=2).shape == (2, 3)


@pytest.mark.slow
def test_crossings_are_those_of_each_point(tmp_path: Path) -> None:
    over, options = {"k": [0.2, 1.0], "y": [0.1, 0.2]}, {"surface": "x = 0, p_x > 0", "dt": 0.1}
    start = {"x": 0.0, "y": 0.0, "p_x": 0.3, "p_y": 0.0}
    hamsym.sweep(
        *(H, start, SPAN),
        over=over,
        task="section",
        store=tmp_path / "a.zarr",
        crossings=2,
        **options,
    )
    data = xarray.open_zarr(tmp_path / "a.zarr")
    for k in over["k"]:
        for y in over["y"]:
            found = hamsym.section(H.with_parameters(k=k), start | {"y": y}, SPAN, **options)
            own = data.sel(k=k, y=y)
            assert int(own["count"]) == 2 <= len(found.t)
            np.testing.assert_array_equal(own["t"], found.t[:2])
            np.testing.assert_array_equal(own["z"], found.z[:2])


def lengths(H: hamsym.Hamiltonian, z0: np.ndarray, span: Any, power: int = 1) -> dict[str, Any]:
    if not z0[0] < 2:
        raise hamsym.InputError("x is too large")
    return {"sum": z0.sum() ** power, "rows": [[H.parameters["k"], 1.0]]}


def test_functions_of_the_user(tmp_path: Path) -> None:
    found = hamsym.sweep(
        "p**2/2 + k*x**2/2",
        [0.0, 1.0],
        SPAN,
        over={"k": [1.0, 3.0], "x": [0.5, 2.5]},
        task=lengths,
        store=tmp_path / "a.zarr",
        power=2,
    )
    data = found.open()
    np.testing.assert_array_equal(data["sum"], [[2.25, np.nan]] * 2)
    np.testing.assert_array_equal(data["rows"][1, 0], [[3.0, 1.0]])
    assert data["message"][0, 1] == "x is too large"
    assert data["success"].values.tolist() == [[True, False]] * 2


@pytest.mark.slow
def test_interrupted_sweep_computes_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    points: list[int] = []
    computed = grid_module.computed

    def counted(task: Any, members: Any, *rest: Any) -> Any:
        if len(points) == 2:
            points.append(0)
            raise KeyboardInterrupt
        points.append(len(members))
        return computed(task, members, *rest)

    monkeypatch.setattr(grid_module, "computed", counted)
    store = tmp_path / "a.zarr"
    part = swept(store, chunk=1)
    assert (part.done, part.interrupted, part.complete) == (2, True, False)
    assert len(part.open()) > 0
    whole = swept(store, chunk=2)  # the boxes are those of the store
    assert (whole.done, whole.interrupted, whole.complete) == (6, False, True)
    assert points == [1, 1, 0, 1, 1, 1, 1]
    swept(store)
    assert len(points) == 7
    assert whole.open().equals(swept(tmp_path / "b.zarr").open())


def test_half_written_store_is_marked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []
    write = grid_module.GridStore.write

    def fails(store: Any, box: Any, columns: Any) -> None:
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        write(store, box, columns)

    monkeypatch.setattr(grid_module.GridStore, "write", fails)
    found = swept(tmp_path / "a.zarr", chunk=3)
    data = found.open()
    assert data["done"].values.tolist() == [[True] * 3, [False] * 3]
    assert data.attrs["complete"] == 0
    assert np.isnan(data["state"][1]).all()


@pytest.mark.parametrize("after", ["_array", "create"])
def test_sweep_killed_while_its_store_begins_is_resumed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: str
) -> None:
    """As a process that is killed, nothing is cleaned up."""
    store = tmp_path / "a.zarr"
    zarr_store = grid_module.GridStore

    def killed(*_: Any, **__: Any) -> None:
        raise SystemExit

    with monkeypatch.context() as patch:
        patch.setattr(atomic.shutil, "rmtree", lambda *_, **__: None)
        if after == "_array":
            patch.setattr(zarr_store, "_array", staticmethod(killed))
        else:
            patch.setattr(atomic.os, "rename", killed)
        with pytest.raises(SystemExit):
            swept(store)
    assert len(list(tmp_path.rglob("zarr.json"))) > 0
    assert not store.exists()
    assert swept(store).complete


def test_other_requests_are_refused(tmp_path: Path) -> None:
    store = tmp_path / "a.zarr"
    swept(store)
    for change in ({"t": [1.0]}, {"tol": 1e-8}, {"over": OVER | {"k": [0.2, 0.9]}}):
        with pytest.raises(hamsym.FileError, match="exists; give the path of a new store, or"):
            swept(store, **change)
    other = tmp_path / "b.zarr"
    other.mkdir()
    with pytest.raises(hamsym.FileError, match="exists; give the path of a new store"):
        swept(other)
    head = store / "zarr.json"
    assert json.loads(head.read_text())["attributes"]["task"] == "solve"
    head.write_text("{")
    with pytest.raises(hamsym.FileError, match="exists"):
        swept(store)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"over": {}}, "is not a mapping"),
        ({"over": {"j": [1]}}, "'j' in over is unknown; give some of k, x, y, p_x, p_y, energy"),
        ({"over": OVER | {"k": [1, 1]}}, "repeats a value"),
        ({"over": OVER | {"k": [np.nan]}}, "not a list of finite numbers"),
        ({"over": OVER | {"k": 1.0}}, "not a list of finite numbers"),
        ({"task": "solves"}, "task='solves' is unknown"),
        ({"task": lambda *_: {}}, "give a function of a module"),
        ({"tolerance": 1}, "'tolerance' is not an option of the task 'solve'"),
        ({"t": [21.0]}, "outside the span"),
        ({"tol": 0}, "tol=0"),
        ({"chunk": 0}, "chunk=0"),
        ({"store": None}, "has a store"),
        ({"folder": "a"}, "no settings or folder"),
        ({"over": None}, "give one pair"),
        ({"store": "a.nc"}, "ends .zarr"),
        ({"store": 3}, "ends .zarr"),
        ({"store": "no/such/a.zarr"}, "does not exist"),
        ({"task": "section", "t": None}, "needs a surface"),
        ({"task": "section", "t": None, "surface": "x = 0"}, "give crossings="),
        ({"over": OVER | {"p_x": [0.1]}}, "lack exactly one component"),
    ],
)
def test_bad_input_is_refused(
    tmp_path: Path, change: dict[str, Any], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(hamsym.InputError, match=message):
        swept(**{"store": Path("a.zarr")} | change)
    assert not Path("a.zarr").exists()


def test_energy_needs_a_free_component(tmp_path: Path) -> None:
    with pytest.raises(hamsym.InputError, match="as a mapping without it"):
        hamsym.sweep(H, [0, 0, 0, 0], SPAN, over=OVER, store=tmp_path / "a.zarr")
    with pytest.raises(hamsym.InputError, match="z0 is not one state"):
        hamsym.sweep(H, np.zeros((3, 4)), SPAN, over={"k": [1.0]}, store=tmp_path / "a.zarr")


def test_boxes_are_whole_rows() -> None:
    assert box_shape((10, 4, 5), 20) == (1, 4, 5)
    assert box_shape((10, 4, 5), 7) == (1, 1, 5)
    assert box_shape((10, 4, 5), 3) == (1, 1, 3)
    assert box_shape((10, 4, 5), 1_000) == (10, 4, 5)
