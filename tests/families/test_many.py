"""Many members in one call: each is what solve returns, and no member changes another."""

from __future__ import annotations

import os
import pickle
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import scipy.integrate

import hamsym
from hamsym import FileError, Hamiltonian, InputError, Solutions
from hamsym.families import many as many_module
from hamsym.families import solutions as solutions_module
from hamsym.families.blocks import BlockSolver
from hamsym.families.windows import ACCEPTED, MARCHED
from hamsym.random_features.basis import feature_basis
from hamsym.solution import acceptance
from hamsym.support import tensor_files
from hamsym.systems import double_pendulum, driven_oscillator, henon_heiles

HENON = henon_heiles().H
SPAN = (0.0, 6 * np.pi)
# Cubic forces let states with much energy escape in finite time.
CUBIC = Hamiltonian("p**2/2 + k*x**2/2 + x**3/3", parameters={"k": 1.0})
KEPLER = Hamiltonian("(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)")


def random_starts(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.2, 0.2, (count, 4))


def same_solution(one: hamsym.Solution, other: hamsym.Solution) -> None:
    """Compare all that two solutions contain, but for the time that they took."""
    for name in ("H", "span", "method", "success", "message"):
        assert getattr(one, name) == getattr(other, name), name
    for part in ("trial", "record", "error"):
        for name, value in vars(getattr(one, part)).items():
            if name not in ("seconds", "cpu_seconds") and not name.startswith("_"):
                expected = getattr(getattr(other, part), name)
                np.testing.assert_array_equal(value, expected, name)
                assert type(value) is type(expected), name


def same_solutions(one: Solutions, other: Solutions) -> None:
    t = np.linspace(*one.span, 7)
    np.testing.assert_array_equal(one(t), other(t))
    for name in ("success", "message", "largest_error", "excess", "z0"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name)
    assert (one.shape, one.span, one.H) == (other.shape, other.span, other.H)
    assert list(one.parameters) == list(other.parameters)


@pytest.fixture(scope="module")
def henon() -> Solutions:
    return hamsym.solve_many(HENON, random_starts(300), SPAN)


@pytest.fixture(scope="module")
def mixed() -> Solutions:
    """Good members, escapes, and starts that are not finite."""
    starts = {"x": [[0.1, -3.0, 0.2, np.nan, 0.5]], "p": [[0.0], [0.3]]}
    return hamsym.solve_many(CUBIC, starts, (0, 10), parameters={"k": [[1.0], [2.0]]})


# -- members ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("H", "starts", "span", "options"),
    [
        (HENON, random_starts(6), SPAN, {}),
        (HENON, random_starts(4), (7.0, -3.0), {"tol": 1e-11, "max_window": 0.7}),
        (driven_oscillator().H, [[1.0, 0.0], [0.3, -2.0]], (2.0, 9.0), {"tol": 1e-6, "seed": 3}),
        (Hamiltonian("p**2/2 + abs(x)"), [[1.0, 0.0], [0.2, 1.0]], (0, 1.3), {"atol": 1e-9}),
        (CUBIC, [[0.1, 0.0], [-3.0, 0.0]], (0, 10), {}),
    ],
    ids=["henon", "backwards", "driven", "switches", "escape"],
)
def test_members_are_those_of_solve(
    H: Hamiltonian, starts: np.ndarray, span: tuple[float, float], options: dict
) -> None:
    many = hamsym.solve_many(H, starts, span, **options)
    t = np.linspace(*span, 23)
    for i, z0 in enumerate(starts):
        asked = dict(options)
        method = hamsym.Features(max_window=asked.pop("max_window", None))
        alone = hamsym.solve(H, z0, span, method=method, **asked)
        same_solution(many[i], alone)
        assert (many.success[i], many.message[i]) == (alone.success, alone.message)
        np.testing.assert_array_equal(many.largest_error[i], alone.largest_error)
        inside = (t - alone.span[0]) / (alone.span[1] - alone.span[0]) <= 1
        np.testing.assert_array_equal(many(t[inside])[i], alone(t[inside]))
        edges = alone.trial.edges  # where a window begins, the next one counts
        np.testing.assert_array_equal(many(edges)[i], alone(edges))
        np.testing.assert_array_equal(many.energy(t[inside])[i], alone.energy(t[inside]))
        assert np.isnan(many(t)[i, ~inside]).all()


def test_grids_of_starts_and_parameters(mixed: Solutions) -> None:
    assert (mixed.shape, len(mixed), mixed.size, mixed.ndim) == ((2, 5), 2, 10, 2)
    assert mixed([0.0, 1.0, 2.0]).shape == (2, 5, 3, 2)
    assert mixed(1.0).shape == (2, 5, 2)
    assert mixed.energy([1.0, 2.0]).shape == (2, 5, 2)
    assert mixed.largest_error.shape == mixed.z0.shape == (2, 5, 2)
    np.testing.assert_array_equal(mixed.parameters["k"], [[1.0] * 5, [2.0] * 5])
    for row, k in enumerate((1.0, 2.0)):
        for column in (0, 1, 2, 4):
            H = CUBIC.with_parameters(k=k)
            alone = hamsym.solve(H, mixed.z0[row, column], (0, 10))
            same_solution(mixed[row, column], alone)
            until = alone.span[1]
            np.testing.assert_array_equal(mixed(until / 2)[row, column], alone(until / 2))


def test_one_start_is_a_family_without_axes() -> None:
    many = hamsym.solve_many(HENON, [0.1, 0.2, 0.0, 0.1], SPAN)
    assert (many.shape, many.success.shape, many(1.0).shape) == ((), (), (4,))
    same_solution(many[()], hamsym.solve(HENON, [0.1, 0.2, 0.0, 0.1], SPAN))
    with pytest.raises(TypeError):
        len(many)


def test_selections_keep_their_members(henon: Solutions) -> None:
    values = henon([0.5, 18.0])
    mask = henon.z0[:, 0] > 0
    for key in (slice(5, 50, 3), mask, [299, 0, 7, 7], (slice(None), None)):
        selected = henon[key]
        np.testing.assert_array_equal(selected([0.5, 18.0]), values[key])
        np.testing.assert_array_equal(selected.excess, henon.excess[key])
        np.testing.assert_array_equal(selected.message, henon.message[key])
    same_solution(henon[mask][4], henon[int(np.flatnonzero(mask)[4])])
    assert henon[:0](1.0).shape == (0, 4)
    rows = list(henon[:6][np.array([[0, 1, 2], [3, 4, 5]])])
    assert [row.shape for row in rows] == [(3,), (3,)]
    assert [type(member) for member in henon[:2]] == [hamsym.Solution] * 2
    with pytest.raises(IndexError):
        henon[300]


def test_evaluation_in_small_groups_is_equal(
    henon: Solutions, monkeypatch: pytest.MonkeyPatch
) -> None:
    t = np.linspace(*SPAN, 100)
    expected, energies = henon(t), henon.energy(t)
    monkeypatch.setattr("hamsym.families.evaluation._STATES", 300)
    monkeypatch.setattr("hamsym.families.evaluation._WINDOWS", 17)
    np.testing.assert_array_equal(henon[::-1](t), expected[::-1])
    np.testing.assert_array_equal(henon.energy(t), energies)


def test_times_outside_the_span_are_refused(henon: Solutions) -> None:
    for evaluate in (henon, henon.energy):
        with pytest.raises(InputError, match="t = 20 is outside the span from 0 to 18.8495559"):
            evaluate([1.0, 20.0])
    beyond = henon[:3](20.0, extrapolate=True)
    np.testing.assert_array_equal(beyond[1], henon[1](20.0, extrapolate=True))


def test_members_are_certified(henon: Solutions) -> None:
    member = henon[3]
    short = hamsym.solve_many("p**2/2 + x**2/2", [[1.0, 0.0], [0.5, 0.5]], (0, 5))[1]
    certificate = short.certify()
    assert certificate.lower <= certificate.bound < 1e-9
    t = np.linspace(*SPAN, 11)
    assert np.abs(member.error_estimate(t)).max() <= henon.largest_error[3].max()


def test_windows_of_other_machines_are_estimated_again(
    henon: Solutions, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the basis is rounded otherwise, the windows stay and their error is estimated."""
    expected = henon[5]
    monkeypatch.setattr(solutions_module, "basis_for", lambda *_: feature_basis(1, 16))
    again = henon[5]
    assert again.success
    np.testing.assert_array_equal(again.trial.readouts, expected.trial.readouts)
    np.testing.assert_allclose(again.largest_error, expected.largest_error, rtol=0.5)
    table = solutions_module.Solutions(henon.family, henon.table, henon.windows, henon.members)
    monkeypatch.setattr(acceptance, "excess", lambda _: float("nan"))
    assert not table[5].success
    assert "estimated again" in table[5].message


# -- bad members -----------------------------------------------------------------------------------


def test_bad_members_leave_others_unchanged(mixed: Solutions) -> None:
    good = [0, 2, 4]
    np.testing.assert_array_equal(mixed.success, [[True, False, True, False, True]] * 2)
    assert all("stopped at t = " in message for message in mixed.message[:, 1])
    assert (mixed.message[:, 3] == "'x' is not finite in z0; give finite numbers").all()
    starts = {"x": mixed.z0[:, good, 0], "p": mixed.z0[:, good, 1]}
    alone = hamsym.solve_many(CUBIC, starts, (0, 10), parameters={"k": [[1.0], [2.0]]})
    same_solutions(mixed[:, good], alone)
    t = np.linspace(0, 10, 50)
    assert np.isfinite(mixed(t)[:, good]).all()
    assert np.isnan(mixed(t)[:, 3]).all()
    assert np.isinf(mixed.largest_error[:, 3]).all()
    assert not (mixed.excess[:, [1, 3]] <= 1).any()
    with pytest.raises(InputError, match="'x' is not finite in z0"):
        mixed[0, 3]


def test_collisions_fail_alone() -> None:
    starts = np.array([[1, 0, 0, 1], [1, 0, 0, 0], [0, 0, 1, 0], [1, 0, 0, 1.1]], dtype=float)
    many = hamsym.solve_many(KEPLER, starts, (0, 5))
    assert many.success.tolist() == [True, False, False, True]
    assert many.message[2] == "H or its gradient is not finite at z0; choose another initial state"
    assert 1.0 < many[1].span[1] <= np.pi / np.sqrt(8) + 1e-6  # the time of the fall
    same_solution(many[3], hamsym.solve(KEPLER, starts[3], (0, 5)))
    np.testing.assert_allclose(many(5.0)[0], [np.cos(5), np.sin(5), -np.sin(5), np.cos(5)])


def test_loose_members_that_are_solved_by_themselves_keep_their_error() -> None:
    H = Hamiltonian("p**2/2 + x**2/2 - x*1e4*exp(-((t - 3.37)/1e-5)**2)")
    starts = [[1.1, 0.0], [1.0, 0.0]]
    many = hamsym.solve_many(H, starts, (0, 10), tol=1e-4)
    assert (many.table.status == MARCHED).all()
    for member, start in zip(many, starts, strict=True):
        same_solution(member, hamsym.solve(H, start, (0, 10), tol=1e-4))


def test_impossible_energies_are_members_that_fail() -> None:
    plane = {"x": 0, "y": [0.0, 0.1, 0.9], "p_y": [[0.0], [0.1]]}
    starts = HENON.state_at_energy(1 / 8, plane, missing="nan")
    many = hamsym.solve_many(HENON, starts, SPAN)
    np.testing.assert_array_equal(many.success, [[True, True, False]] * 2)
    np.testing.assert_allclose(many.energy(18.0)[:, :2], 1 / 8, rtol=1e-9)
    assert np.isnan(many.energy(18.0)[:, 2]).all()


def test_all_members_may_fail() -> None:
    many = hamsym.solve_many(HENON, np.full((3, 4), np.nan), SPAN)
    assert not many.success.any()
    assert np.isnan(many(1.0)).all()
    assert "0 succeeded, 3 failed" in repr(many)


def test_threads_and_chunks_change_no_bit(
    henon: Solutions, monkeypatch: pytest.MonkeyPatch
) -> None:
    starts = random_starts(300)
    for first, most, cores in ((1, 1, 1), (7, 50, 4), (300, 300, 1)):
        monkeypatch.setattr(many_module, "_FIRST", first)
        monkeypatch.setattr(many_module, "_MOST", most)
        monkeypatch.setattr("hamsym.parallel.threads.available_cores", lambda cores=cores: cores)
        same_solutions(hamsym.solve_many(HENON, starts, SPAN), henon)


def test_narrow_forces_are_checked_in_threads() -> None:
    """Windows with functions that act briefly are checked in Python, with own parameters."""
    H = Hamiltonian("p**2/2 + x**2/2 + exp(-(x/w)**2)", parameters={"w": 1.0})
    w = np.linspace(0.05, 1, 12)
    many = hamsym.solve_many(H, [1.0, 0.3], (0, 5), parameters={"w": w})
    for i in (0, 5, 11):
        own = H.with_parameters(w=float(w[i]))
        same_solution(many[i], hamsym.solve(own, [1.0, 0.3], (0, 5)))


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        ((HENON, np.zeros((3, 3)), SPAN), {}, "z0 has shape"),
        ((HENON, np.zeros((3, 4)), (1, 1)), {}, "span="),
        ((HENON, np.zeros((3, 4)), SPAN), {"tol": 0}, "tol=0 cannot be used"),
        ((HENON, np.zeros((3, 4)), SPAN), {"seed": -1}, "seed=-1 cannot be used"),
        ((HENON, np.zeros((3, 4)), SPAN), {"atol": [1, 2]}, "atol="),
        ((HENON, np.zeros((3, 4)), SPAN), {"max_window": -1}, "max_window=-1"),
        ((HENON, np.zeros((3, 4)), SPAN), {"parameters": {"j": 1}}, "'j' is not a parameter"),
        ((CUBIC, np.zeros((3, 2)), SPAN), {"parameters": {"k": [1, 2]}}, "do not broadcast"),
    ],
)
def test_invalid_arguments_are_refused(arguments: tuple, options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        hamsym.solve_many(*arguments, **options)


def test_other_things_than_paths_are_no_stores() -> None:
    with pytest.raises(FileError, match="'3' cannot be written: expected str"):
        hamsym.solve_many(HENON, np.zeros((3, 4)), SPAN, store=3)  # type: ignore[arg-type]


# -- interruption and memory -----------------------------------------------------------------------


@contextmanager
def interrupting(after: int) -> Iterator[None]:
    """Ctrl-C in the report of progress, once a number of members is done."""

    @contextmanager
    def progress(*_: object) -> Iterator[Callable[[int], None]]:
        done = 0

        def report(more: int) -> None:
            nonlocal done
            done += more
            if done >= after:
                raise KeyboardInterrupt

        yield report

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(many_module, "stepping_progress", progress)
        patch.setattr(many_module, "_MOST", 50)
        yield


def test_interruption_returns_finished_members(henon: Solutions, tmp_path: Path) -> None:
    with interrupting(120):
        many = hamsym.solve_many(HENON, random_starts(300), SPAN)
    done = many.success
    assert 120 <= done.sum() < 300
    assert set(many.message[~done]) == {"interrupted"}
    same_solutions(many[done], henon[done])
    assert np.isnan(many(1.0)[~done]).all()
    many.save(tmp_path / "part")
    same_solutions(hamsym.load(tmp_path / "part"), many)


def test_interruption_among_difficult_members() -> None:
    starts = {"x": [0.1, -3.0, 0.2, -3.1, 0.3, -3.2], "p": 0.0}
    with interrupting(2):
        many = hamsym.solve_many(CUBIC, starts, (0, 10))
    assert many.success.tolist() == [True, False, True, False, True, False]
    assert [message[:11] for message in many.message[1::2]] == ["stopped at ", "stopped at ",
                                                                "interrupted"]  # fmt: skip


def test_interruption_of_a_store(henon: Solutions, tmp_path: Path) -> None:
    with interrupting(120):
        many = hamsym.solve_many(HENON, random_starts(300), SPAN, store=tmp_path / "a")
    assert 120 <= many.success.sum() < 300
    again = hamsym.load(tmp_path / "a")
    same_solutions(again, many)
    same_solutions(again[many.success], henon[many.success])


def test_resumed_store_solves_what_is_missing(
    henon: Solutions, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, starts, solved = tmp_path / "a", random_starts(300), []
    with interrupting(120):
        part = hamsym.solve_many(HENON, starts, SPAN, store=path)
    solve = BlockSolver.batch

    def counted(solver: BlockSolver, chunk: np.ndarray) -> object:
        solved.extend(chunk.tolist())
        return solve(solver, chunk)

    monkeypatch.setattr(BlockSolver, "batch", counted)
    whole = hamsym.solve_many(HENON, starts, SPAN, store=path)
    assert sorted(solved) == np.flatnonzero(~part.success).tolist()
    same_solutions(whole, henon)
    written = (path / "solutions.hamsym").stat().st_mtime_ns
    same_solutions(hamsym.solve_many(HENON, starts, SPAN, store=path), henon)
    assert (path / "solutions.hamsym").stat().st_mtime_ns == written
    same_solutions(hamsym.load(path), henon)
    assert len(solved) == 300 - part.success.sum()
    whole.save(tmp_path / "one file")
    same_solutions(hamsym.load(tmp_path / "one file"), henon)
    damaged = next(path.glob("parts/*.table"))
    damaged.write_bytes(damaged.read_bytes()[:-1])
    with pytest.raises(FileError, match="is damaged.*remove it, and its members are solved again"):
        hamsym.solve_many(HENON, starts, SPAN, store=path)


def test_resumed_store_keeps_members_between_others(henon: Solutions, tmp_path: Path) -> None:
    """Parts of a cluster come in any order."""
    starts = random_starts(300)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(many_module, "_FIRST", 40)
        patch.setattr(many_module, "_MOST", 40)
        hamsym.solve_many(HENON, starts, SPAN, store=tmp_path / "b")
    parts = sorted((tmp_path / "b" / "parts").glob("*.table"))
    for part in parts[1::3]:
        part.unlink()
    whole = hamsym.solve_many(HENON, starts, SPAN, store=tmp_path / "b")
    same_solutions(whole, henon)
    same_solution(whole[45], henon[45])
    whole.save(tmp_path / "one file")
    same_solutions(hamsym.load(tmp_path / "one file"), henon)


def test_too_little_memory_is_refused_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(many_module, "memory_size", lambda: 2e6)
    solved = []
    solve = BlockSolver.batch
    monkeypatch.setattr(
        BlockSolver,
        "batch",
        lambda run, chunk: solved.append(len(chunk)) or solve(run, chunk),
    )
    message = r"300 members would need about 0.00\d+ GB, more than half .*, 0.001 GB; give store="
    with pytest.raises(InputError, match=message):
        hamsym.solve_many(HENON, random_starts(300), SPAN)
    assert solved == [32]


def test_full_memory_keeps_what_is_done(henon: Solutions, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first members rest and have few windows; those that follow fill the memory."""
    starts = random_starts(300)
    starts[:32] = 0.0
    monkeypatch.setattr(many_module, "memory_size", lambda: 2.8e6)
    monkeypatch.setattr(many_module, "_MOST", 50)
    many = hamsym.solve_many(HENON, starts, SPAN)
    assert 32 < many.success.sum() < 300
    assert set(many.message[~many.success]) == {
        'stopped: windows fill half of the memory, 0.0014 GB; give store="windows" to write '
        "them to a store"
    }
    done = many.success & (np.arange(300) >= 32)
    np.testing.assert_array_equal(many(3.0)[done], henon(3.0)[done])


def test_progress_counts_all_members(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    counted = []

    @contextmanager
    def progress(total: int, *_: object) -> Iterator[Callable[[int], None]]:
        yield counted.append
        assert sum(counted) == total

    monkeypatch.setattr(many_module, "stepping_progress", progress)
    starts = {"x": [0.1, -3.0, np.nan] * 20, "p": 0.0}
    many = hamsym.solve_many(CUBIC, starts, (0, 10))
    assert (many.success.sum(), sum(counted)) == (20, 60)
    assert capsys.readouterr() == ("", "")


# -- files -----------------------------------------------------------------------------------------


def test_files_are_exact_to_the_last_bit(mixed: Solutions, tmp_path: Path) -> None:
    mixed.save(tmp_path / "a")
    again = hamsym.load(tmp_path / "a")
    same_solutions(again, mixed)
    for index in ((0, 0), (0, 1), (1, 2)):
        same_solution(again[index], mixed[index])
    again.save(tmp_path / "b")
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    with pytest.raises(FileError, match="of kind solutions, not solution"):
        hamsym.verify(mixed[0, 0].certify().to_json(), tmp_path / "a")


def test_copies_are_exact(mixed: Solutions) -> None:
    again = pickle.loads(pickle.dumps(mixed))
    same_solutions(again, mixed)
    same_solution(again[0, 0], mixed[0, 0])


def test_files_of_selections_hold_their_members(mixed: Solutions, tmp_path: Path) -> None:
    selected = mixed[::-1, [4, 1, 3, 1]]
    selected.save(tmp_path / "a")
    again = hamsym.load(tmp_path / "a")
    same_solutions(again, selected)
    assert again.table.status.size == 8
    same_solution(again[0, 1], mixed[1, 1])


def test_damaged_files_are_refused(mixed: Solutions, tmp_path: Path) -> None:
    path = tmp_path / "a"
    mixed.save(path)
    whole = bytearray(path.read_bytes())
    for place in (len(whole) // 2, len(whole) - 9, 40):
        damaged = whole.copy()
        damaged[place] ^= 1
        path.write_bytes(damaged)
        with pytest.raises(FileError, match="damaged"):
            hamsym.load(path)
    path.write_bytes(whole[:-8])
    with pytest.raises(FileError, match="damaged"):
        hamsym.load(path)


def _edited(name: str, value: object) -> Callable[[dict, dict], None]:
    def edit(arrays: dict, values: dict) -> None:
        arrays[name] = value(arrays[name].copy()) if callable(value) else value

    return edit


def _at(place: object, value: object) -> Callable[[np.ndarray], np.ndarray]:
    def put(array: np.ndarray) -> np.ndarray:
        array[place] = value
        return array

    return put


def _valued(**values: object) -> Callable[[dict, dict], None]:
    return lambda _, own: own.update(values)


def _tabled(**values: object) -> Callable[[dict, dict], None]:
    return lambda _, own: own["table"].update(values)


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (_edited("edges", lambda a: a[:-1]), "has shape"),
        (_edited("edges", lambda a: a[::-1].copy()), "not in order"),
        (_edited("edges", _at(1, np.nan)), "'edges' is not finite"),
        (_edited("states", _at((0, 0), 0.125)), "does not start at its z0"),
        (_edited("readouts", _at((0, 0, 0), np.inf)), "'readouts' is not finite"),
        (_edited("readouts", lambda a: a.astype("f4")), "'readouts' is not of type"),
        (_edited("table.success", _at(1, 1)), "exceeds the tolerance"),
        (_edited("table.success", _at(0, 0)), "contradicts"),
        (_edited("table.success", _at(0, 2)), "out of range"),
        (_edited("table.status", _at(0, MARCHED)), "messages"),
        (_edited("table.status", _at(0, 0)), "contradicts|without windows"),
        (_edited("table.status", _at(3, ACCEPTED)), "without windows"),
        (_edited("table.counts", _at(0, -1)), "counts' has numbers out of range"),
        (_edited("table.excess", _at(0, np.nan)), "excess' has numbers out of range"),
        (_edited("table.excess", _at(0, 1.5)), "exceeds the tolerance"),
        (_edited("table.largest", _at((0, 0), np.inf)), "exceeds the tolerance"),
        (_edited("table.sizes", _at((0, 0), -1.0)), "sizes' has numbers out of range"),
        (_edited("table.parameters", _at((0, 0), np.nan)), "parameters' is not finite"),
        (_edited("table.z0", _at((0, 0), np.nan)), "not finite"),
        (_edited("basis", lambda a: a[:-1]), "'basis' has shape"),
        (_edited("more", np.zeros(1)), "'more' of its arrays is unknown"),
        (_edited("table.notes", lambda a: a[:-1]), "not a valid"),
        (_valued(shape=[10]), None),
        (_valued(shape=[3, 5]), "differs from its number"),
        (_tabled(stopped="interrupted"), "without a reason"),
        (_valued(varied=["j"]), "a parameter varies"),
        (_valued(varied=[]), "differs from its value in H"),
        (_valued(seed=-1), "seed"),
        (_valued(span=[0.0, 11.0]), "ends before the span"),
        (_valued(tol=2.0), "tol=2.0"),
        (_valued(more=1), "'more' of its values is unknown"),
    ],
)
def test_other_contents_are_refused(
    mixed: Solutions, tmp_path: Path, edit: Callable[[dict, dict], None], message: str | None
) -> None:
    """Files with a correct checksum that solve_many cannot have written."""
    mixed.save(tmp_path / "a")
    arrays, values = tensor_files.read_tensors(tmp_path / "a", "solutions")
    edit(arrays, values)
    tensor_files.write_tensors(tmp_path / "a", "solutions", arrays, values)
    if message is None:
        assert hamsym.load(tmp_path / "a").shape == (10,)
        return
    with pytest.raises(FileError, match=message):
        hamsym.load(tmp_path / "a")


def test_formulas_without_text_are_not_saved(tmp_path: Path) -> None:
    import sympy

    x, p = sympy.symbols("x p")
    H = Hamiltonian(p**2 / 2 + sympy.EulerGamma * x**2, q=[x], p=[p])
    many = hamsym.solve_many(H, [[1.0, 0.0]], (0, 1))
    with pytest.raises(FileError, match="the constant EulerGamma has no text"):
        many.save(tmp_path / "a")
    with pytest.raises(FileError, match="the constant EulerGamma has no text"):
        hamsym.solve_many(H, [[1.0, 0.0]], (0, 1), store=tmp_path / "a")
    assert not os.listdir(tmp_path)


# -- stores ----------------------------------------------------------------------------------------


@pytest.fixture
def store(mixed: Solutions, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The members of ``mixed``, written in several parts."""
    monkeypatch.setattr(many_module, "_FIRST", 2)
    monkeypatch.setattr(many_module, "_MOST", 3)
    path = tmp_path / "windows"
    parameters = {"k": mixed.parameters["k"]}
    many = hamsym.solve_many(CUBIC, mixed.z0, mixed.span, parameters=parameters, store=path)
    same_solutions(many, mixed)
    return path


def test_stores_are_exact_to_the_last_bit(store: Path, mixed: Solutions, tmp_path: Path) -> None:
    again = hamsym.load(store)
    same_solutions(again, mixed)
    for index in ((0, 0), (0, 1), (1, 2)):
        same_solution(again[index], mixed[index])
    again.save(tmp_path / "one file")
    same_solutions(hamsym.load(tmp_path / "one file"), mixed)


def test_windows_of_stores_are_read_late(store: Path) -> None:
    many = hamsym.load(store)
    file = max(store.glob("parts/*.windows"))
    damaged = bytearray(file.read_bytes())
    damaged[-1] ^= 1
    file.write_bytes(damaged)
    assert np.isfinite(many[0, 0](1.0)).all()
    with pytest.raises(FileError, match="is damaged"):
        many(1.0)
    file.unlink()
    with pytest.raises(FileError, match="is damaged: windows are missing"):
        hamsym.load(store)


def test_windows_of_another_part_are_refused(store: Path) -> None:
    first, second = sorted(store.glob("parts/*.windows"))[:2]
    first.write_bytes(second.read_bytes())
    with pytest.raises(FileError, match="is damaged: 'edges' is not of float64 and"):
        hamsym.load(store)(1.0)


def test_damaged_stores_are_refused(store: Path) -> None:
    head = store / "solutions.hamsym"
    whole = head.read_bytes()
    for old, new in ((b"interrupted", b"interrupter"), (b"sha256", b"sha255"), (b"000000", b"0")):
        head.write_bytes(whole.replace(old, new))
        if old in whole:
            with pytest.raises(FileError, match="damaged"):
                hamsym.load(store)
    head.write_bytes(whole[:-1])
    with pytest.raises(FileError, match="damaged"):
        hamsym.load(store)
    head.unlink()
    with pytest.raises(FileError, match="was not finished"):
        hamsym.load(store)
    (store / "begun.json").unlink()
    with pytest.raises(FileError, match="not a regular file"):
        hamsym.load(store)


def test_existing_stores_are_kept(store: Path) -> None:
    with pytest.raises(FileError, match="exists; give the path of a new store"):
        hamsym.solve_many(HENON, random_starts(2), SPAN, store=store)
    hamsym.load(store)
    with pytest.raises(FileError, match="cannot be written"):
        hamsym.solve_many(HENON, random_starts(2), SPAN, store="/proc/no/such")


def test_optional_packages_are_named(henon: Solutions, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(InputError, match="needs the package xarray, which is not installed"):
        henon.to_xarray([1.0])


# -- xarray ----------------------------------------------------------------------------------------


def test_datasets_have_names_and_coordinates(mixed: Solutions) -> None:
    pytest.importorskip("xarray")
    data = mixed.to_xarray([0.0, 1.0, 2.5])
    assert data["state"].dims == ("axis_0", "axis_1", "time", "component")
    np.testing.assert_array_equal(data["state"], mixed([0.0, 1.0, 2.5]))
    momenta = data["state"].sel(component="p", time=1.0)
    np.testing.assert_array_equal(momenta, mixed([0.0, 1.0, 2.5])[..., 1, 1])
    np.testing.assert_array_equal(data["k"], mixed.parameters["k"])
    np.testing.assert_array_equal(data["success"], mixed.success)
    assert data.attrs["H"] == CUBIC.formula
    assert mixed[0].to_xarray(1.0)["state"].dims == ("member", "time", "component")


# -- truth -----------------------------------------------------------------------------------------


def errors(many: Solutions, t: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """max_t of the error of each component, over its scale."""
    scale = np.abs(many(np.linspace(*many.span, 400))).max(axis=-2)
    return (np.abs(many(t) - truth).max(axis=-2) / scale).max(axis=-1)


def dop853(H: Hamiltonian, starts: np.ndarray, t: np.ndarray, group: int) -> np.ndarray:
    """States of all members by DOP853 to its limit, in groups with common steps."""
    field = H.compile("numpy").vector_field
    found = []
    for first in range(0, len(starts), group):
        own = starts[first : first + group]
        shape = own.shape
        solved = scipy.integrate.solve_ivp(
            lambda _, z, shape=shape: field(z.reshape(shape)).ravel(),
            (t[0], t[-1]),
            own.ravel(),
            "DOP853",
            t,
            rtol=2.3e-14,
            atol=1e-16,
        )
        found.append(np.moveaxis(solved.y.reshape(*shape, -1), -1, 1))
    return np.concatenate(found)


def bound_starts(count: int) -> np.ndarray:
    """Bound states of Henon-Heiles with energies from 0.02 to 1/6."""
    random = np.random.default_rng(1)
    plane = {
        "x": 0,
        "y": random.uniform(-0.5, 1, 8 * count),
        "p_y": random.uniform(-0.6, 0.6, 8 * count),
    }
    starts = HENON.state_at_energy(random.uniform(0.02, 1 / 6, 8 * count), plane, missing="nan")
    return starts[np.isfinite(starts).all(axis=1)][:count]


def pendulum_starts(count: int) -> np.ndarray:
    return np.random.default_rng(2).uniform(-1, 1, (count, 4)) * [2.0, 2.0, 1.0, 1.0]


def kepler_orbits(eccentricity: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Orbits from the pericentre, by Kepler's equation; shape (members, times, 4)."""
    e, t = eccentricity[:, None].astype(np.longdouble), t[None].astype(np.longdouble)
    low, high = t - 1, t + 1
    for _ in range(80):
        middle = (low + high) / 2
        late = middle - e * np.sin(middle) > t
        low, high = np.where(late, low, middle), np.where(late, middle, high)
    E = (low + high) / 2
    r, b = 1 - e * np.cos(E), np.sqrt(1 - e**2)
    orbit = [np.cos(E) - e, b * np.sin(E), -np.sin(E) / r, b * np.cos(E) / r]
    return np.stack(orbit, axis=-1).astype(float)


def survey_henon(count: int) -> None:
    starts, t = bound_starts(count), np.linspace(*SPAN, 40)
    many = hamsym.solve_many(HENON, starts, SPAN)
    assert many.success.all()
    assert errors(many, t, dop853(HENON, starts, t, 100)).max() <= 1e-9


def survey_pendulum(count: int) -> None:
    H, starts, t = double_pendulum().H, pendulum_starts(count), np.linspace(0, 10, 60)
    many = hamsym.solve_many(H, starts, (0, 10))
    good = many.success
    assert good.mean() > 0.95
    # Where motions part fast the truth is not sharp enough either.
    fine = hamsym.solve_many(H, starts, (0, 10), tol=1e-12, seed=1)
    sure = fine.excess <= 300
    assert sure.mean() > 0.9
    assert errors(many, t, fine(t))[good & sure].max() <= 1e-9
    own = np.flatnonzero(good & sure)[:10]
    assert errors(many[own], t, dop853(H, starts[own], t, 10)).max() <= 1e-9


def survey_kepler(count: int) -> None:
    e = np.linspace(0, 0.95, count)
    starts = np.stack([1 - e, 0 * e, 0 * e, np.sqrt((1 + e) / (1 - e))], axis=-1)
    exact_starts = kepler_orbits(e, np.zeros(1))[:, 0]
    np.testing.assert_allclose(starts, exact_starts, rtol=1e-14, atol=1e-14)
    many, t = hamsym.solve_many(KEPLER, starts, (0, 20)), np.linspace(0, 20, 200)
    good = many.success
    assert good.mean() > 0.95
    assert errors(many, t, kepler_orbits(e, t))[good].max() <= 1e-9


def survey_parameters(count: int) -> None:
    """Anharmonic oscillators: the truth is solve at 1e-12, with other windows and basis."""
    H = Hamiltonian("p**2/(2*m) + k*x**2/2 + c*x**4", parameters={"m": 1.0, "k": 1.0, "c": 0.0})
    random, t = np.random.default_rng(3), np.linspace(0, 15, 100)
    parameters = {"m": random.uniform(0.3, 3, count), "k": random.uniform(-1, 4, count),
                  "c": random.uniform(0.1, 1, count)}  # fmt: skip
    starts = random.uniform(-1.5, 1.5, (count, 2))
    many = hamsym.solve_many(H, starts, (0, 15), parameters=parameters)
    fine = hamsym.solve_many(H, starts, (0, 15), parameters=parameters, tol=1e-12, seed=1)
    assert many.success.all()
    assert (fine.excess < 100).all()
    assert errors(many, t, fine(t)).max() <= 1e-9
    single = hamsym.solve(many[0].H, starts[0], (0, 15), tol=1e-12)
    assert errors(many[:1], t, single(t)[None]).max() <= 1e-9


@pytest.mark.slow_cases("kepler", "pendulum")
@pytest.mark.parametrize(
    ("survey", "count"),
    [(survey_henon, 300), (survey_pendulum, 100), (survey_kepler, 100), (survey_parameters, 50)],
    ids=["henon", "pendulum", "kepler", "parameters"],
)
def test_successes_are_true(survey: Callable[[int], None], count: int) -> None:
    survey(count)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("survey", "count"),
    [
        (survey_henon, 10_000),
        (survey_pendulum, 2_000),
        (survey_kepler, 2_000),
        (survey_parameters, 1_000),
    ],
    ids=["henon", "pendulum", "kepler", "parameters"],
)
def test_every_success_of_many_is_true(survey: Callable[[int], None], count: int) -> None:
    survey(count)
