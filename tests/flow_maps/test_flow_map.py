"""Flow maps: accuracy over the box, derivatives, bad input, files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

import hamsym
from hamsym import FlowMap, flow_map, solve_many
from hamsym.errors import FileError, InputError
from hamsym.flow_maps import construction, legs
from hamsym.flow_maps import flow_map as flow_map_module
from hamsym.flow_maps.box import checked_box
from hamsym.flow_maps.expansion import Chain, Leg, Split, chebyshev_slopes, chebyshev_table
from hamsym.flow_maps.judging import linear_error

OSCILLATOR = "p**2/2 + x**2/2 + x**4/4"
BOX = {"x": (1.0, 1.6), "p": (0.7, 1.3)}
KEPLER = "(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)"


@pytest.fixture(scope="module")
def oscillator() -> FlowMap:
    return flow_map(OSCILLATOR, BOX, (0, 4), tol=1e-7, points=300)


@pytest.fixture(scope="module")
def with_parameter() -> FlowMap:
    """The frequency varies, one component is fixed, and the span is backwards."""
    return flow_map(
        "p**2/2 + k*x**2/2", {"x": (1, 2), "p": 0.5}, (2, 0), {"k": (1, 2)}, tol=1e-7, points=300
    )


def worst_ratio(flow: FlowMap, count: int = 2_000) -> float:
    """Return the largest error at random places, of the allowed error of a solution there."""
    random = np.random.default_rng(99)
    box = flow.region
    y = random.uniform(-1, 1, (count, len(box)))
    y[: count // 4] = np.sign(y[: count // 4])
    inputs = box.at(y)
    exact = solve_many(
        *(flow.H, box.states(inputs), flow.span), tol=1e-12, parameters=box.values(inputs)
    )
    times = random.uniform(min(flow.span), max(flow.span), 20)
    scale = np.abs(exact(times)).max(axis=(0, 1))
    found = [flow.map.evaluate(np.full(count, t), inputs) for t in times]
    return float((np.abs(np.stack(found, axis=1) - exact(times)) / scale).max() / flow.tol)


def test_error_is_within_the_tolerance_and_the_estimate(oscillator: FlowMap) -> None:
    assert oscillator.success
    ratio = worst_ratio(oscillator)
    assert ratio <= oscillator.excess <= 1
    assert ratio > oscillator.excess / 10
    assert isinstance(oscillator.map, Leg)


def test_exact_solution_with_a_parameter(with_parameter: FlowMap) -> None:
    assert with_parameter.success
    random = np.random.default_rng(1)
    t, x, k = (random.uniform(*ends, 500) for ends in ((0, 2), (1, 2), (1, 2)))
    w = np.sqrt(k)
    exact = np.stack(
        (
            x * np.cos(w * (t - 2)) + 0.5 / w * np.sin(w * (t - 2)),
            0.5 * np.cos(w * (t - 2)) - x * w * np.sin(w * (t - 2)),
        ),
        axis=1,
    )
    found = with_parameter(t, {"x": x}, {"k": k})
    assert np.abs(found - exact).max() < 3e-7
    # Every component of z0 may be given, and the value of the fixed one is checked.
    states = np.stack((x, np.full(500, 0.5)), axis=1)
    np.testing.assert_array_equal(with_parameter(t, states, {"k": k}), found)


def test_parameter_with_a_name_of_python_varies() -> None:
    box = {"x": (1.0, 1.1), "p": 0.0}
    flow = hamsym.flow_map("p**2/2 + lambda*x**2/2", box, (0, 1), parameters={"lambda": (1, 1.1)})
    assert flow.success, flow.message
    assert abs(flow(1.0, {"x": 1.0}, {"lambda": 1.05})[0] - np.cos(np.sqrt(1.05))) < 1e-6


def test_map_is_exact_at_the_start(oscillator: FlowMap) -> None:
    starts = np.random.default_rng(2).uniform([1, 0.7], [1.6, 1.3], (50, 2))
    np.testing.assert_array_equal(oscillator(0.0, starts), starts)
    np.testing.assert_array_equal(oscillator.jacobian(0.0, starts[0]), np.eye(2))


def test_queries_on_several_cores_have_the_same_bits(
    with_parameter: FlowMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    random = np.random.default_rng(4)
    t, x, k = (random.uniform(*ends, (10, 7)) for ends in ((0, 2), (1, 2), (1, 2)))
    functions = with_parameter, with_parameter.jacobian, with_parameter.rate
    alone = [function(t, {"x": x}, {"k": k}) for function in functions]
    assert [found.shape for found in alone] == [(10, 7, 2), (10, 7, 2, 2), (10, 7, 2)]
    monkeypatch.setattr(flow_map_module, "_QUERIES", 20)
    monkeypatch.setattr("hamsym.parallel.threads.available_cores", lambda: 3)
    for function, expected in zip(functions, alone, strict=True):
        np.testing.assert_array_equal(function(t, {"x": x}, {"k": k}), expected)


def test_curve_of_starts() -> None:
    z0 = {"x": "1 - e", "y": 0, "p_x": 0, "p_y": "sqrt((1 + e)/(1 - e))"}
    flow = flow_map(KEPLER, z0, (0, 3), {"e": (0, 0.5)}, tol=1e-8, points=300)
    assert flow.success
    assert flow.inputs == ("e",)
    assert flow.symplecticity is None
    e = np.linspace(0, 0.5, 7)
    at_start = np.stack((1 - e, 0 * e, 0 * e, np.sqrt((1 + e) / (1 - e))), axis=1)
    assert np.abs(flow(0.0, parameters={"e": e}) - at_start).max() < 1e-14
    anomaly = np.linspace(0, 2.2, 7)
    t = anomaly - e * np.sin(anomaly)
    exact = np.stack((np.cos(anomaly) - e, np.sqrt(1 - e**2) * np.sin(anomaly)), axis=1)
    assert np.abs(flow(t, parameters={"e": e})[:, :2] - exact).max() < 2e-8
    slope = (flow(2.0, None, {"e": 0.3001}) - flow(2.0, None, {"e": 0.2999})) / 2e-4
    np.testing.assert_allclose(flow.jacobian(2.0, None, {"e": 0.3})[:, 0], slope, rtol=1e-5)


def test_derivatives_agree_with_torch(with_parameter: FlowMap) -> None:
    random = np.random.default_rng(3)
    values = [random.uniform(*ends, 6) for ends in ((0, 2), (1, 2), (1, 2))]
    t, x, k = (torch.tensor(value, requires_grad=True) for value in values)
    states = with_parameter(t, {"x": x}, {"k": k})
    plain = values[0], {"x": values[1]}, {"k": values[2]}
    np.testing.assert_allclose(states.detach(), with_parameter(*plain), rtol=1e-13)
    for component in range(2):
        found = torch.autograd.grad(states[:, component].sum(), (t, x, k), retain_graph=True)
        rates, jacobian = with_parameter.rate(*plain), with_parameter.jacobian(*plain)
        np.testing.assert_allclose(found[0], rates[:, component], rtol=1e-9)
        np.testing.assert_allclose(found[1], jacobian[:, component, 0], rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(found[2], jacobian[:, component, 1], rtol=1e-9, atol=1e-10)


def test_shapes_follow_the_queries(oscillator: FlowMap) -> None:
    start = [1.2, 1.0]
    assert oscillator(1.0, start).shape == (2,)
    assert oscillator([1.0, 2.0], start).shape == (2, 2)
    assert oscillator(np.zeros((3, 1)), {"x": [1.1, 1.2], "p": 0.9}).shape == (3, 2, 2)
    assert oscillator.jacobian([1.0, 2.0], start).shape == (2, 2, 2)
    # A value does not depend on the other queries.
    random = np.random.default_rng(4)
    t, starts = random.uniform(0, 4, 30_000), random.uniform([1, 0.7], [1.6, 1.3], (30_000, 2))
    whole = oscillator(t, starts)
    for place in (0, 17, 29_999):
        np.testing.assert_array_equal(whole[place], oscillator(t[place], starts[place]))


def test_compiled_values_equal_those_of_numpy(oscillator: FlowMap) -> None:
    random = np.random.default_rng(5)
    for piece in oscillator.map.pieces[:3]:
        time, y = random.uniform(-1, 1, 50), random.uniform(-1, 1, (50, 2))
        plain = super(type(piece), piece)
        np.testing.assert_allclose(piece.states(time, y, np), plain.states(time, y, np), rtol=1e-11)
        np.testing.assert_array_equal(piece.derivatives(time, y)[0], piece.states(time, y, np))


def test_map_is_symplectic(oscillator: FlowMap) -> None:
    defect = oscillator.symplecticity
    assert defect is not None
    assert 0 < defect < 1e-4
    matrix = oscillator.jacobian(3.0, [1.3, 1.0])
    assert abs(np.linalg.det(matrix) - 1) < 1e-5


def test_linear_equation_estimates_the_error(oscillator: FlowMap) -> None:
    """A map with one wrong number has the error that the linear equation gives."""
    damaged = hamsym.load(saved(oscillator))
    damaged.map.pieces[2].readouts[0, 0] *= 1.001
    damaged.map.pieces[2].__init__(
        *(getattr(damaged.map.pieces[2], name) for name in ("degrees", "readouts", "columns"))
    )
    inputs = oscillator.region.at(np.random.default_rng(6).uniform(-1, 1, (40, 2)))
    found = linear_error(damaged.map, oscillator.H, oscillator.region, oscillator.map.edges, inputs)
    times = np.linspace(0, 4, 200)
    true = [damaged.map.evaluate(np.full(40, t), inputs) - oscillator(t, inputs) for t in times]
    np.testing.assert_allclose(found, np.abs(true).max(axis=(0, 1)), rtol=0.1)


def test_estimate_is_the_same_in_unequal_units(oscillator: FlowMap) -> None:
    unit = 2.0**-73
    H = hamsym.Hamiltonian("b*((p/b)**2/2 + x**2/2 + x**4/4)", parameters={"b": unit})
    box = {"x": (1.0, 1.6), "p": (0.7 * unit, 1.3 * unit)}
    found = flow_map(H, box, (0, 4), tol=1e-7, points=300)
    assert found.largest_error / (1.0, unit) == pytest.approx(oscillator.largest_error, rel=0.01)


@pytest.mark.slow
def test_box_is_split_where_degrees_are_large(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(legs, "_LARGEST", 130)
    monkeypatch.setattr(legs, "_LINE", {2: 13})
    flow = flow_map(
        "p**2/2 + k*x**4", {"x": (1.0, 1.6), "p": 0}, (0, 4), {"k": (1, 2)}, tol=1e-5, points=300
    )
    assert isinstance(flow.map, Split)
    assert flow.success
    assert worst_ratio(flow) <= flow.excess


@pytest.mark.slow
def test_long_span_is_a_chain_of_legs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(legs, "_LARGEST", 120)
    flow = flow_map(
        "p**2/2 - cos(x)", {"x": (0.5, 1.0), "p": (0.2, 0.6)}, (0, 30), tol=1e-4, points=300
    )
    assert isinstance(flow.map, Chain)
    assert flow.success
    assert worst_ratio(flow) <= flow.excess
    again = hamsym.load(saved(flow))
    t, start = np.array([3.0, 29.0]), [0.7, 0.3]
    np.testing.assert_array_equal(again(t, start), flow(t, start))
    step = 1e-5
    left, right = flow(t, [0.7 - step, 0.3]), flow(t, [0.7 + step, 0.3])
    slope = (right - left) / (2 * step)
    np.testing.assert_allclose(flow.jacobian(t, start)[..., 0], slope, rtol=1e-4, atol=1e-5)


def test_map_across_a_separatrix_is_no_false_success() -> None:
    flow = flow_map(
        "p**2/2 - cos(x)", {"x": (3.0, 3.3), "p": (-0.2, 0.2)}, (0, 3), tol=1e-4, points=300
    )
    assert worst_ratio(flow) <= 1 or not flow.success


@pytest.mark.parametrize(
    ("force", "z0", "parameters", "place"),
    [
        ("1e4*x*exp(-((k - 0.37)/1e-6)**2)", {"x": (1, 2), "p": 0}, {"k": (0, 1)}, {"k": 0.37}),
        pytest.param(
            *("x/(1 + ((k - 0.37)/1e-7)**2)", {"x": (1, 2), "p": 0}, {"k": (0, 1)}, {"k": 0.37}),
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "x*(tanh((k - 0.6)/1e-7) - tanh((k - 0.6000002)/1e-7))",
            *({"x": (1, 2), "p": 0}, {"k": (0, 1)}, {"k": 0.6}),
            marks=pytest.mark.slow,
        ),
        (
            "x*exp(-((a - 0.37)**2 + (b - 0.61)**2)*1e12)",
            *({"x": 1.5, "p": 0}, {"a": (0, 1), "b": (0, 1)}, {"a": 0.37, "b": 0.61}),
        ),
        ("0", {"x": "1 + exp(-((k - 0.37)/1e-6)**2)", "p": 0}, {"k": (0, 1)}, {"k": 0.37}),
    ],
)
def test_narrow_feature_of_the_inputs_is_refused(
    force: str, z0: dict, parameters: dict, place: dict
) -> None:
    flow = flow_map(f"p**2/2 + x**2/2 - ({force})", z0, (0, 1), parameters, points=100, tol=1e-4)
    assert not flow.success
    assert "a narrow feature of H at " in flow.message
    worst = dict(zip(flow.inputs, flow.judgement.worst_inputs, strict=True))
    assert all(abs(worst[name] - value) < 1e-5 for name, value in place.items())


def test_narrow_feature_of_combined_inputs_is_refused() -> None:
    H = "p**2/2 + x**2/2 - x*exp(-((a + 1000*b - 300.37)/1e-6)**2)"
    flow = flow_map(H, {"x": 1.5, "p": 0}, (0, 1), {"a": (0, 1), "b": (0, 1)}, points=100, tol=1e-4)
    assert not flow.success
    a, b = flow.judgement.worst_inputs
    assert abs(a + 1000 * b - 300.37) < 1e-5


@pytest.mark.slow
def test_narrow_feature_that_is_taken_back_is_refused() -> None:
    kick = "x*2e8*(t - 0.345678)*exp(-((t - 0.345678)/1e-4)**2)"  # p is as before 1e-3 later
    H = f"p**2/2 + x**2/2 + {kick}"
    flow = flow_map(H, {"x": (1.0, 1.1), "p": (0.0, 0.1)}, (0, 1), points=100, tol=1e-2)
    assert not flow.success
    assert "a narrow feature of H at " in flow.message
    assert abs(flow.judgement.worst_time - 0.345678) < 1e-3


def test_narrow_feature_outside_the_box_is_passed_over() -> None:
    H = "p**2/2 + x**2/2 - 1e4*x*exp(-((k - 1.37)/1e-6)**2)"
    flow = flow_map(H, {"x": 1.5, "p": 0}, (0, 1), {"k": (0, 1)}, points=100, tol=1e-4)
    assert flow.success


@pytest.mark.slow
def test_map_ends_before_a_solution_that_fails() -> None:
    """The largest value, to which the tolerance refers, is that before the end of the solutions."""
    flow = flow_map("p**2/2 - x**4", {"x": (1.0, 1.1), "p": 1.0}, (0, 3), tol=1e-5, points=100)
    assert not flow.success
    assert 0.2 < flow.span[1] < 1.0
    assert "the map ends at t = " in flow.message
    x = np.linspace(1.0, 1.1, 50)
    exact = solve_many(flow.H, {"x": x, "p": 1.0}, flow.span, tol=1e-11)
    for t in np.linspace(*flow.span, 20):
        error = np.abs(flow(t, {"x": x}) - exact(t)).max(axis=0)
        assert (error <= flow.largest_error).all()


def test_more_solutions_than_allowed_are_refused() -> None:
    with pytest.raises(InputError, match="needs more than max_solutions=50 solutions; give sm"):
        flow_map(OSCILLATOR, BOX, (0, 4), max_solutions=50)


def test_error_above_the_tolerance_is_no_success(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(construction, "_ATTEMPTS", 1)
    monkeypatch.setattr(legs, "_SURPLUS", 1e4)
    monkeypatch.setattr(legs.LegBuilder, "_worst_at_random", lambda _: 0.0)
    flow = flow_map(OSCILLATOR, BOX, (0, 4), tol=1e-7, points=300)
    assert flow.excess > 1
    assert not flow.success
    assert "of the tolerance; worst found at" in flow.message


@pytest.mark.parametrize("count", [2, 3, 8])
def test_slopes_are_those_of_chebyshev_series(count: int) -> None:
    x = np.linspace(-1, 1, 9)
    found = chebyshev_slopes(x, chebyshev_table(x, count))
    for k in range(count):
        expected = np.polynomial.Chebyshev.basis(k).deriv()(x)
        np.testing.assert_allclose(found[k], expected, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
def test_attempts_end_with_the_estimate_of_the_last(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the comparison with random points the first attempt is too coarse."""
    monkeypatch.setattr(legs, "_SURPLUS", 300.0)
    monkeypatch.setattr(legs.LegBuilder, "_worst_at_random", lambda _: 0.0)
    flow = flow_map("p**2/2 - cos(x)", {"x": (0.5, 1.5), "p": 0.1}, (0, 8), tol=1e-6, points=300)
    assert flow.success == (worst_ratio(flow) <= 1)
    assert worst_ratio(flow) <= flow.excess


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (({"x": 1, "p": 0}, (0, 1)), "nothing varies; give an interval"),
        (({"x": (1, 2)}, (0, 1)), "'p' is missing in z0; give all of x, p"),
        (({"x": (1, 2), "p": 0, "y": 1}, (0, 1)), "'y' is not a component of z"),
        (({"x": (2, 1), "p": 0}, (0, 1)), r"x=\(2, 1\) is not an interval"),
        (({"x": (1, float("nan")), "p": 0}, (0, 1)), "give a number or an interval"),
        (({"x": (1, 2, 3), "p": 0}, (0, 1)), "give a number or an interval"),
        (({"x": (1, 2), "p": "a + 1"}, (0, 1)), "'a' in an expression of z0 has no interval"),
        (({"x": (1, 2), "p": "1 +"}, (0, 1)), "at column"),
        (({"x": (1, 2), "p": 0}, (0, 0)), "span"),
        ((5, (0, 1)), "z0=5 cannot be used"),
    ],
)
def test_bad_boxes_are_refused(arguments: tuple, message: str) -> None:
    with pytest.raises(InputError, match=message):
        flow_map(OSCILLATOR, *arguments)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tol": 0}, "tol=0 cannot be used; give a number from 1e-11"),
        ({"tol": float("nan")}, "tol=nan cannot be used"),
        ({"points": 3}, "points=3 cannot be used"),
        ({"max_solutions": 0}, "max_solutions=0 cannot be used"),
        ({"seed": -1}, "seed=-1 cannot be used"),
        ({"parameters": {"k": (1, 2)}}, "'k' is not a parameter of H"),
        ({"parameters": 3}, "parameters=3 is not a mapping"),
        *(({"atol": atol}, "atol=.* cannot be used") for atol in ("a", 10**400, [1, 2, 3], -1.0)),
    ],
)
def test_bad_options_are_refused(options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        flow_map(OSCILLATOR, BOX, (0, 1), **options)


def test_bad_queries_are_refused(with_parameter: FlowMap) -> None:
    flow, start, k = with_parameter, {"x": 1.5}, {"k": 1.5}
    for arguments, message in (
        ((3.0, start, k), "t = 3 is outside the span from 0 to 2"),
        ((1.0, {"x": 2.5}, k), "x = 2.5 is outside the box, from 1 to 2"),
        ((1.0, {"x": 2 + 1e-8}, k), "x = 2.00000001 is outside the box, from 1 to 2"),
        ((1.0, {"x": np.nan}, k), "not finite"),
        ((1.0, start), "'k' is missing in parameters"),
        ((1.0, None, k), "'x' is missing in z0"),
        ((1.0, {"x": 1.5, "p": 0.6}, k), "'p' is 0.5 for all starts"),
        ((1.0, {"x": 1.5, "q": 0.6}, k), "'q' is not a component of z"),
        ((1.0, start, {"k": 1.5, "m": 1}), "'m' is not a parameter that varies"),
        ((1.0, [1.0, 0.5, 0.0], k), r"z0 has shape \(3,\)"),
        (([1.0, 2.0], {"x": [1.1, 1.2, 1.3]}, k), "shapes do not broadcast"),
        *(((t, start, k), "'t' has an entry that is not a real") for t in ("now", 10**400, 1j)),
        ((1.0, "ab", k), "z0 has an entry that is not a real number"),
        ((1.0, [[1, 2], [3]], k), "z0 has an entry that is not a real number"),
        ((1.0, {"x": 1.5, "p": "q"}, k), "p has an entry that is not a real number"),
        ((1.0, start, [1]), r"parameters=\[1\] is not a mapping"),
    ):
        with pytest.raises(InputError, match=message):
            flow(*arguments)
    assert np.isfinite(flow(2.1, {"x": 2.01}, k, extrapolate=True)).all()


def saved(flow: FlowMap) -> Path:
    import tempfile

    path = Path(tempfile.mkdtemp()) / "map.hamsym"
    flow.save(path)
    return path


def test_file_restores_the_map(with_parameter: FlowMap) -> None:
    again = hamsym.load(saved(with_parameter))
    assert repr(again) == repr(with_parameter)
    assert again.box == with_parameter.box == {"x": (1.0, 2.0), "k": (1.0, 2.0)}
    assert again.fixed == {"p": 0.5}
    t = np.linspace(0, 2, 9)
    np.testing.assert_array_equal(
        again(t, {"x": 1.3}, {"k": 1.1}), with_parameter(t, {"x": 1.3}, {"k": 1.1})
    )
    np.testing.assert_array_equal(again.largest_error, with_parameter.largest_error)


def test_damaged_or_forged_files_are_refused(oscillator: FlowMap, tmp_path: Path) -> None:
    from hamsym.support.tensor_files import read_tensors, write_tensors

    path = saved(oscillator)
    content = bytearray(path.read_bytes())
    content[-100] ^= 1
    (tmp_path / "damaged.hamsym").write_bytes(content)
    with pytest.raises(FileError, match="damaged"):
        hamsym.load(tmp_path / "damaged.hamsym")
    arrays, values = read_tensors(path, "flow map")
    forged = tmp_path / "forged.hamsym"

    def refused(arrays: dict, values: dict, message: str) -> None:
        write_tensors(forged, "flow map", arrays, values)
        with pytest.raises(FileError, match=message):
            hamsym.load(forged)

    refused(arrays, {**values, "excess": 3.0}, "its error is not within")
    region = {**values["region"], "names": ["x", "y"]}
    refused(arrays, {**values, "region": region}, "not give every component")
    many = {**values["map"], "pieces": [{}] * 10**5}
    refused(arrays, {**values, "map": many}, "at most 10,000 entries")
    refused(arrays, {**values, "map": {**values["map"], "pieces": 10**6}}, "is not a list")
    refused(arrays, {**values, "more": 1}, "unknown")
    further = {**arrays, "map.pieces.9999.readouts": np.zeros(3)}
    refused(further, values, "of its arrays is unknown")
    name = "map.pieces.0.readouts"
    nan = {**arrays, name: arrays[name] * np.nan}
    refused(nan, values, "is not finite")
    edges = {**arrays, "map.edges": arrays["map.edges"][::-1].copy()}
    refused(edges, values, "not in order")
    deep = json.loads(json.dumps(values["map"]))
    for _ in range(100):
        deep = {"form": "split", "threshold": 0.0, "low": deep, "high": deep}
        if len(json.dumps(deep)) > 10_000:
            break
    refused(arrays, {**values, "map": deep}, "is not a valid file")
    deep = {}
    for _ in range(300):
        deep = {"form": "chain", "maps": [deep], "joints": None, "kept": None}
    refused(arrays, {**values, "map": deep}, "too many parts inside each other")


def test_construction_does_not_depend_on_other_maps(oscillator: FlowMap) -> None:
    again = flow_map(OSCILLATOR, BOX, (0, 4), tol=1e-7, points=300)
    t, starts = np.linspace(0, 4, 5), np.full((5, 2), [1.2, 1.0])
    np.testing.assert_array_equal(again(t, starts), oscillator(t, starts))


def test_box_converts_inputs() -> None:
    box = checked_box("p**2/2 + k*x**2/2", [(1, 2), 0.5], {"k": (0.5, 1.5)})
    assert box.names == ("x", "k")
    inputs = box.at(np.array([[-1.0, 1.0]]))
    np.testing.assert_array_equal(inputs, [[1.0, 1.5]])
    np.testing.assert_array_equal(box.states(inputs), [[1.0, 0.5]])
