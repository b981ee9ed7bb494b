"""Files and tables of trajectories."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hamsym
from hamsym import FileError, Hamiltonian, InputError, Trajectory
from hamsym.support.tensor_files import read_tensors, write_tensors

K = Hamiltonian(
    "p**2/2 + k*x**2/2", parameters={"k": 1.0}, units={"x": "m", "p": "m/s", "k": "1/s**2"}
)
FALLING = Hamiltonian("p**2/2 - x**4/4")
GRID = {"x": [[1.0, 2.0], [3.0, 4.0]], "p": 0.0}
MADE: dict[str, Callable[[], Trajectory]] = {
    "one": lambda: hamsym.integrate(K, [1, 0], (0, 10), "blanes_moan6", steps=100),
    "backwards": lambda: hamsym.integrate(K, [1, 0], (10, 0), tol=1e-9),
    "grid": lambda: hamsym.integrate(K, GRID, (0, 3), tol=1e-9),
    "parameters": lambda: hamsym.integrate(
        K, [1, 0], (0, 3), "blanes_moan6", steps=30, parameters={"k": [1.0, 2.0, 3.0]}
    ),
    "stopped": lambda: hamsym.integrate(FALLING, [1, 0], (0, 10), tol=1e-9),
    "members that stopped": lambda: hamsym.integrate(
        FALLING, [[1.0, 0.0], [0.1, 0.0], [np.nan, 0.0]], (0, 10), tol=1e-9
    ),
    "adaptive": lambda: hamsym.integrate(K, [1, 0], (0, 10), "dop853", steps=20),
}


@pytest.mark.parametrize("name", MADE)
def test_files_are_exact_to_the_last_bit(name: str, tmp_path: Path) -> None:
    trajectory = MADE[name]()
    trajectory.save(tmp_path / "a.hamsym")
    again = hamsym.load(tmp_path / "a.hamsym")
    assert isinstance(again, Trajectory)
    assert again.ensemble.H == trajectory.ensemble.H
    assert dict(again.ensemble.H.units) == dict(trajectory.ensemble.H.units)
    for field in dataclasses.fields(Trajectory):
        if field.name not in ("ensemble", "verdicts", "invariant_drift"):
            one, other = getattr(trajectory, field.name), getattr(again, field.name)
            np.testing.assert_array_equal(np.asarray(one), np.asarray(other), field.name)
            assert np.asarray(one).dtype == np.asarray(other).dtype, field.name
    for part in ("states", "parameters"):
        np.testing.assert_array_equal(
            getattr(again.ensemble, part), getattr(trajectory.ensemble, part)
        )
    assert again.ensemble.shape == trajectory.ensemble.shape
    assert again.ensemble.varied == trajectory.ensemble.varied
    np.testing.assert_array_equal(again.messages, trajectory.messages)
    np.testing.assert_array_equal(again.energy, trajectory.energy)
    assert again.summary() == trajectory.summary()


def _set(array: np.ndarray, place: Any, value: Any) -> np.ndarray:
    changed = array.copy()
    changed[place] = value
    return changed


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a, v: a.update(t=a["t"][::-1].copy()), "times are not in order"),
        (lambda a, v: a.update(t=_set(a["t"], 3, np.nan)), "'t' is not finite"),
        (lambda a, v: a.update(t=a["t"].astype(np.float32)), "not of type float64"),
        (lambda a, v: a.update(z=a["z"][..., :1].copy()), "has shape|another number|its dim is"),
        (lambda a, v: a.update(z=_set(a["z"], (0, 0, 5), np.nan)), "finite after one that is not"),
        (lambda a, v: a.update(z=_set(a["z"], (0, 0, -1), np.inf)), "success is true, but a state"),
        (lambda a, v: a.update(z=_set(a["z"], (0, 0, 0, 0), 7.0)), "not begin at its starts"),
        (lambda a, v: a.update(success=a["success"] * np.uint8(2)), "numbers out of range"),
        (lambda a, v: a.update(success=a["success"] * np.uint8(0)), "contradicts its messages"),
        (lambda a, v: a.update(errors=-a["errors"] - 1), "negative"),
        (
            lambda a, v: a.update({"verdicts.largest": a["verdicts.largest"] * np.nan}),
            "above its tolerance",
        ),
        (
            lambda a, v: a.update({"ensemble.parameters": a["ensemble.parameters"] + 1}),
            "'k' differs from its value",
        ),
        (lambda a, v: a.update(extra=a["t"]), "'extra' of its arrays is unknown"),
        (lambda a, v: v.update(method="magic"), "'magic' is not a method"),
        (lambda a, v: v.update(steps=-1), "'steps' is out of range"),
        (lambda a, v: v.update(steps=1.5), "'steps' is not of type int"),
        (lambda a, v: v.update(seconds=float("nan")), "'seconds' is not finite"),
        (lambda a, v: v.update(dt=float("nan")), "'dt' is not finite"),
        (lambda a, v: v.update(drift=-1.0), "drift is negative"),
        (lambda a, v: v["ensemble"].update(varied=["m"]), "varies that H does not have"),
        (lambda a, v: v["ensemble"].update(shape=[2, -2]), "out of range"),
        (lambda a, v: v["ensemble"].update(shape=[5]), "shape differs from its number"),
        (lambda a, v: v["verdicts"].update(problems={"9": "lost"}), "belongs to no trajectory"),
        (lambda a, v: v["verdicts"].update(tol=1e-300), "an error is above its tolerance"),
        (lambda a, v: v.update(more=1), "'more' of its values is unknown"),
        (
            lambda a, v: v["ensemble"]["H"]["formula"].update(formula="p**2/2 + k*y**2/2"),
            "is not a valid file",
        ),
    ],
)
def test_files_that_are_not_exactly_valid_are_refused(
    change: Callable[[dict[str, Any], dict[str, Any]], None], message: str, tmp_path: Path
) -> None:
    path = tmp_path / "a.hamsym"
    MADE["grid"]().save(path)
    arrays, values = read_tensors(path, "trajectory")
    change(arrays, values)
    write_tensors(path, "trajectory", arrays, values)
    with pytest.raises(FileError, match=message):
        hamsym.load(path)


def test_a_damaged_byte_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.hamsym"
    MADE["one"]().save(path)
    content = bytearray(path.read_bytes())
    content[-9] ^= 1
    path.write_bytes(content)
    with pytest.raises(FileError, match="is damaged"):
        hamsym.load(path)


def test_an_invalid_trajectory_is_not_written(tmp_path: Path) -> None:
    trajectory = dataclasses.replace(MADE["one"](), names=("a", "b"))
    with pytest.raises(FileError, match="was not written, because the trajectory is not valid"):
        trajectory.save(tmp_path / "a.hamsym")
    assert not (tmp_path / "a.hamsym").exists()


# -- tables ----------------------------------------------------------------------------------------


def test_tables_have_times_names_and_units() -> None:
    pytest.importorskip("pandas")
    trajectory = MADE["one"]()
    table = trajectory.to_dataframe()
    assert list(table.columns) == ["x", "p"]
    assert table.index.name == "t"
    np.testing.assert_array_equal(table.index, trajectory.t)
    np.testing.assert_array_equal(table, trajectory.z)
    assert table.attrs["H"] == K.formula
    assert (table.attrs["k"], table.attrs["unit of x"]) == (1.0, "m")
    assert table.attrs["method"] == "blanes_moan6"
    assert table.attrs["hamsym"] == hamsym.__version__


def test_tables_of_ensembles_have_a_level_for_each_axis() -> None:
    pytest.importorskip("pandas")
    grid, row = MADE["grid"](), MADE["parameters"]()
    table = grid.to_dataframe()
    assert table.index.names == ["axis_0", "axis_1", "t"]
    np.testing.assert_array_equal(table.loc[1, 0], grid.z[1, 0])
    table = row.to_dataframe()
    assert table.loc[2]["k"].unique().tolist() == [3.0]
    assert "k" not in table.attrs


def test_datasets_have_names_and_coordinates() -> None:
    pytest.importorskip("xarray")
    row = MADE["parameters"]()
    data = row.to_xarray()
    assert data["state"].dims == ("member", "time", "component")
    np.testing.assert_array_equal(data["state"].sel(component="p"), row["p"])
    np.testing.assert_array_equal(data["energy"], row.energy)
    np.testing.assert_array_equal(data["k"], [1.0, 2.0, 3.0])
    grid = MADE["grid"]()
    np.testing.assert_array_equal(grid.to_xarray()["errors"], grid.errors)
    assert data.attrs["unit of p"] == "m/s"


def test_a_component_called_t_keeps_its_name() -> None:
    pytest.importorskip("pandas")
    H = Hamiltonian("p_t**2/2 + t**2/2", q=["t"], p=["p_t"])
    table = hamsym.integrate(H, [1, 0], (0, 1), "dop853", steps=2).to_dataframe()
    assert table.index.name == "time"
    assert list(table.columns) == ["t", "p_t"]


def test_parameters_with_names_of_attributes_are_kept() -> None:
    pytest.importorskip("pandas")
    H = Hamiltonian("p**2/2 + span*x**2/2", parameters={"span": 4.0})
    table = hamsym.solve(H, [1, 0], (0, 1)).to_dataframe([0.5])
    assert table.attrs["parameter span"] == 4.0
    assert table.attrs["span"] == [0.0, 1.0]


@pytest.mark.parametrize("package", ["pandas", "xarray"])
def test_missing_packages_are_named(package: str, monkeypatch: pytest.MonkeyPatch) -> None:
    trajectory = MADE["one"]()
    monkeypatch.setitem(sys.modules, package, None)
    wanted = {"pandas": trajectory.to_dataframe, "xarray": trajectory.to_xarray}[package]
    with pytest.raises(InputError, match=f"needs the package {package}, .* pip install {package}"):
        wanted()
