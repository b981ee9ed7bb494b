"""Every result that has files is read back as it was, and is read only as it was written."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hamsym
from hamsym import FileError, Hamiltonian, InputError
from hamsym.archive import CERTIFICATES, class_of_kind, kind_of_class
from hamsym.support.shown import Saved
from hamsym.support.tensor_files import kind_of, read_tensors, write_tensors

QUARTIC = "p**2/2 + x**2/2 + x**4/4"
SPRING = Hamiltonian("p**2/2 + k*x**2/2", parameters={"k": 1.0})
TIMES = np.linspace(0, 5, 20)
DATA = np.cos(2 * TIMES) + 0.01 * np.sin(99 * TIMES)


def orbit(**options: Any) -> hamsym.PeriodicOrbit:
    return hamsym.periodic_orbit(QUARTIC, [1.0, 0.0], **options)


def fit(data: np.ndarray = DATA, **options: Any) -> hamsym.Fit:
    return hamsym.fit(
        Hamiltonian("p**2/2 + k*x**2/2"),
        TIMES,
        {"x": data},
        free={"k": 3.8},
        z0={"x": 1, "p": 0},
        span=(0, 5),
        sigma=0.01,
        **options,
    )


MADE: dict[str, Callable[[], Any]] = {
    "solution": lambda: hamsym.solve(QUARTIC, [1, 0], (0, 1)),
    "solutions": lambda: hamsym.solve_many(QUARTIC, [[1, 0], [0.5, 0]], (0, 1)),
    "flow map": lambda: hamsym.flow_map(SPRING, {"x": (1, 1.1), "p": 0}, (0, 1), tol=1e-5),
    "trajectory": lambda: hamsym.integrate(SPRING, [1, 0], (0, 3), tol=1e-9),
    "section": lambda: hamsym.section(
        SPRING, [0, 1], (0, 20), "x = 0, p > 0", parameters={"k": [1.0, 1.1]}
    ),
    "periodic orbit": lambda: orbit(symmetry={"x": "-x", "p": "-p"}),
    "orbit of a period": lambda: hamsym.periodic_orbit(
        Hamiltonian(f"{QUARTIC} - x*cos(w*t)/10", parameters={"w": 2.0}), [0.1, 0], period="2*pi/w"
    ),
    "orbit family": lambda: orbit().family(energy=1.0),
    "fit": fit,
    "fit of sets": lambda: fit(np.stack((DATA, DATA))),
    "fit by a map": lambda: fit(
        flow=hamsym.flow_map("p**2/2 + k*x**2/2", {"x": 1, "p": 0}, (0, 5), {"k": (3, 5)})
    ),
    "enclosure": lambda: hamsym.enclose(
        SPRING, ["1 +- 0.01", 0], (0, 1), parameters={"k": "1 +- 0.1"}
    ),
    "certificate": lambda: MADE["solution"]().certify(),
    "certificate of a map": lambda: MADE["flow map"]().certify(),
    "certificate of an orbit": lambda: orbit().certify(),
}


def same(one: Any, other: Any) -> None:
    """Compare all public numbers and texts of two results."""
    for entry in dataclasses.fields(one):
        if entry.metadata.get("saved", True):
            first, second = getattr(one, entry.name), getattr(other, entry.name)
            assert type(first) is type(second), entry.name
            if isinstance(first, float | int | str | np.ndarray):
                np.testing.assert_array_equal(first, second, entry.name)


@pytest.mark.parametrize("name", MADE)
def test_results_are_read_back_as_they_were(name: str, tmp_path: Path) -> None:
    result = MADE[name]()
    result.save(tmp_path / "a")
    again = hamsym.load(tmp_path / "a")
    assert (type(again), repr(again)) == (type(result), repr(result))
    if dataclasses.is_dataclass(result):
        same(result, again)
    again.save(tmp_path / "b")
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_all_kinds_of_files_are_tested() -> None:
    public = {getattr(hamsym, name) for name in hamsym.__all__ if name[0].isupper()}
    for kind in public & {*_below(Saved)}:
        if kind.__name__ not in CERTIFICATES.values():
            assert kind_of_class(kind) in MADE
            assert class_of_kind(kind_of_class(kind)) is kind


@pytest.mark.parametrize(
    "kind",
    ["", "saved", "facts", "certificate", "Fit", "flowmap", "flow  map", "flow map ", "os", "load"],
)
def test_other_names_are_no_kinds(kind: str) -> None:
    """Files may state any; only public results that are saved are read."""
    assert class_of_kind(kind) is None


def _below(kind: type) -> list[type]:
    return [each for own in kind.__subclasses__() for each in (own, *_below(own))]


def test_results_are_used_after_they_are_read(tmp_path: Path) -> None:
    found = {name: MADE[name]() for name in ("periodic orbit", "fit", "enclosure")}
    for name, result in found.items():
        result.save(tmp_path / name)
    again = {name: hamsym.load(tmp_path / name) for name in found}
    orbits = found["periodic orbit"], again["periodic orbit"]
    t = np.linspace(0, 0.9, 7)
    np.testing.assert_array_equal(*(one(t) for one in orbits))
    np.testing.assert_array_equal(*(one.multipliers for one in orbits))
    np.testing.assert_array_equal(found["fit"](t)["x"], again["fit"](t)["x"])
    np.testing.assert_array_equal(found["enclosure"](t).radius, again["enclosure"](t).radius)
    hamsym.verify(orbit().certify(), _saved(orbit(), tmp_path / "plain"))


def _saved(result: Any, path: Path) -> Path:
    result.save(path)
    return path


def _array(name: str, change: Callable[[np.ndarray], Any]) -> Callable[[dict, dict], None]:
    def edit(arrays: dict[str, Any], values: dict[str, Any]) -> None:
        arrays[name] = change(arrays[name].copy())

    return edit


def _value(*way: Any, to: Any) -> Callable[[dict, dict], None]:
    def edit(arrays: dict[str, Any], values: dict[str, Any]) -> None:
        for key in way[:-1]:
            values = values[key]
        values[way[-1]] = to

    return edit


def _with(place: Any, number: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(array: np.ndarray) -> np.ndarray:
        array[place] = number
        return array

    return change


EDITS = [
    ("section", _array("t", lambda a: a[::-1]), "not in order"),
    ("section", _array("t", lambda a: a[:-1]), "has shape"),
    ("section", _array("z", _with((0, 0), math.nan)), "not finite"),
    ("section", _array("trajectory", lambda a: a + 5), "of no trajectory"),
    ("section", _array("trajectory", lambda a: a.astype(float)), "not of type int64"),
    ("section", _value("names", to=["y", "p"]), "not those of H"),
    ("section", _value("surface", to="y = 0"), "not a valid file"),
    ("section", _value("dt", to=-0.1), "not in order"),
    ("section", _value("H", to=None), "not a mapping"),
    ("periodic orbit", _array("arc.edges", lambda a: a[::-1]), "not in order"),
    ("periodic orbit", _array("arc.edges", _with(1, math.nan)), "not finite"),
    ("periodic orbit", _array("arc.values", _with((0, 0, 0), math.inf)), "not finite"),
    ("periodic orbit", _array("arc.ends", lambda a: a[:, :1]), "has shape"),
    ("periodic orbit", _array("_maps", lambda a: a[:, :1]), "has shape"),
    ("periodic orbit", _value("arc", "period", to=-1.0), "not finite"),
    (
        "periodic orbit",
        _value("problem", "closing", "shift", "places", to=[0, 0]),
        "each component once",
    ),
    ("periodic orbit", _value("problem", "closing", "shift", "signs", to=[1, 2]), "with a sign"),
    ("periodic orbit", _value("problem", "closing", "shift", "signs", to=[1, -1]), "do not close"),
    ("periodic orbit", _value("problem", "parameter", to="m"), "does not have"),
    ("periodic orbit", _value("repetitions", to=0), "out of range"),
    ("orbit family", _value("orbits", to=[]), "not those of one system"),
    ("orbit family", _value("parameter", to="m"), "does not have"),
    ("fit", _array("covariance", lambda a: a[0]), "has shape"),
    ("fit", _array("covariance", _with((0, 0), math.nan)), "not finite"),
    ("fit", _array("data.x", lambda a: a[:-1]), "has shape"),
    ("fit", _array("z0", _with(0, math.nan)), "not finite"),
    ("fit", _value("names", to=["m"]), "free quantities differ"),
    ("fit", _value("parameters", to={"k": [1.0]}), "not of type float"),
    ("fit", _value("confidence", to=2.0), "out of range"),
    ("fit", _value("solution", "success", to=1), "not of type bool"),
    ("fit", _value("expressions", "x", "formula", to="__import__('os')"), "not a valid file"),
    ("fit", _array("t", lambda a: a + 1), "not within its span"),
    ("fit", _array("sigma.x", lambda a: -a), "residuals are not those"),
    ("fit", _array("residuals.x", _with(3, math.nan)), "residuals are not those"),
    ("fit", _array("unknowns.low", _with(0, math.nan)), "not within its bounds"),
    ("fit", _value("parameters", "k", to=math.inf), "estimates are not finite"),
    ("fit", _value("span", to=[0.0, 6.0]), "another span"),
    ("fit of sets", _array("success", lambda a: a + 1), "numbers out of range"),
    ("fit of sets", _value("message", to=["one"]), "not those of its sets"),
    ("enclosure", _array("windows.0.high", _with((0, 0), math.nan)), "not finite"),
    ("enclosure", _array("windows.0.beside", lambda a: -a - 1), "out of range"),
    ("enclosure", _array("z0.1", lambda a: -a - 1), "out of range"),
    ("enclosure", _value("windows", 0, "start", to="1/3"), "do not follow each other"),
    ("enclosure", _value("windows", 0, "half", to="-1"), "do not follow each other"),
    ("enclosure", _value("windows", 0, "half", to="2/4"), "lowest terms"),
    ("enclosure", _value("span", to=[0.0, 9.0]), "end with its span"),
]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("files")
    return {name: _saved(MADE[name](), folder / name) for name in {name for name, *_ in EDITS}}


@pytest.mark.parametrize(("name", "edit", "message"), EDITS)
def test_edited_files_are_refused(
    name: str,
    edit: Callable[[dict, dict], None],
    message: str,
    files: dict[str, Path],
    tmp_path: Path,
) -> None:
    kind = str(kind_of(files[name]))
    arrays, values = read_tensors(files[name], kind)
    edit(arrays, values)
    write_tensors(tmp_path / "a", kind, arrays, values)
    with pytest.raises(FileError, match=message):
        hamsym.load(tmp_path / "a")


def test_results_without_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there are no files of dict; give a result that has"):
        hamsym.save({}, tmp_path / "a")


def test_edited_certificates_are_refused(tmp_path: Path) -> None:
    MADE["certificate"]().save(tmp_path / "a")
    text = (tmp_path / "a").read_text()
    (tmp_path / "a").write_text(text.replace('"rtol"', '"r"'))
    with pytest.raises(FileError, match="its checksum does not match"):
        hamsym.load(tmp_path / "a")
