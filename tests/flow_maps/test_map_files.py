"""Files of flow maps whose parts do not follow each other in time are refused."""

import copy
import dataclasses

import numpy as np
import pytest

import hamsym
from hamsym.errors import CertificationError, FileError
from hamsym.flow_maps.expansion import Chain, Split
from hamsym.flow_maps.time_order import ended, require_order
from hamsym.support.tensor_files import read_tensors, write_tensors

LINEAR = "p**2/2 + x**2/2"


@pytest.fixture(scope="module")
def leg():
    return hamsym.flow_map(LINEAR, {"x": (1, 1.1), "p": (0, 0.1)}, (0, 3), tol=1e-5)


@pytest.fixture(scope="module")
def chain(leg):
    first = ended(leg.map, 1.0)
    image = {"x": (0.5, 0.7), "p": (-1, -0.7)}
    second = hamsym.flow_map(LINEAR, image, (1, 3), tol=1e-5)
    legs = Chain([first, second.map], np.array([1.0]), np.array([], dtype=int))
    return dataclasses.replace(leg, map=legs)


@pytest.fixture(scope="module")
def split(leg):
    return dataclasses.replace(leg, map=Split(np.array([1.0, 0.0]), 1.05, leg.map, leg.map))


@pytest.fixture(scope="module")
def with_parameter():
    return hamsym.flow_map("p**2/2 + k*x**2/2", {"x": (1, 2), "p": 0}, (0, 1), {"k": (1, 2)})


def forged(flow, path, edit):
    """Save a map, edit the arrays and values of its file, with a right checksum."""
    flow.save(path)
    arrays, values = read_tensors(path, "flow map")
    values = copy.deepcopy(values)
    edit(arrays, values)
    write_tensors(path, "flow map", arrays, values)
    return path


def entry(name, value):
    """An edit of one array: its new value, or a function of the old one."""

    def edit(arrays, _):
        arrays[name] = value(arrays[name]) if callable(value) else np.array(value)

    return edit


def span(*times):
    return lambda _, values: values.update(span=list(times))


def begin(number, time):
    return lambda _, values: values["map"]["maps"][number].update(begin=time)


def swapped(arrays, values):
    """Exchange the two legs of a chain."""
    values["map"]["maps"].reverse()
    legs = {name: arrays.pop(name) for name in list(arrays) if name.startswith("map.maps.")}
    for name, array in legs.items():
        arrays[f"map.maps.{1 - int(name[9])}.{name[11:]}"] = array


def moved(number, by):
    def change(edges):
        edges = edges.copy()
        edges[number] += by
        return edges

    return change


LEG = {
    "against the span": entry("map.edges", lambda edges: -edges),
    "reversed": entry("map.edges", lambda edges: edges[::-1].copy()),
    "from the end": entry("map.edges", lambda edges: edges - edges[-1]),
    "not a number": entry("map.edges", moved(1, np.nan)),
    "infinite": entry("map.edges", moved(-1, np.inf)),
    "empty piece": entry("map.edges", lambda e: np.append(np.append(e[:1], e[0]), e[2:])),
    "beyond the span": entry("map.edges", moved(-1, 1e-3)),
    "before the end": entry("map.edges", moved(-1, -1e-3)),
    "all zero": entry("map.edges", lambda edges: 0 * edges),
    "span backwards": span(0.0, -3.0),
    "span longer": span(0.0, 3.5),
    "span shorter": span(0.0, 2.0),
    "span later": span(0.5, 3.0),
    "span empty": span(0.0, 0.0),
    "begins later": lambda _, values: values["map"].update(begin=0.5),
}
CHAIN = {
    "legs exchanged": swapped,
    "gap": begin(1, 1.25),
    "overlap": begin(1, 0.75),
    "joint moved": entry("map.joints", [1.25]),
    "joint and leg moved": lambda a, v: (begin(1, 0.75)(a, v), entry("map.joints", [0.75])(a, v)),
    "joint beyond the span": lambda a, v: (begin(1, 4.0)(a, v), entry("map.joints", [4.0])(a, v)),
    "joint not a number": entry("map.joints", [np.nan]),
    "first against the span": entry("map.maps.0.edges", lambda edges: -edges),
    "second against the span": entry("map.maps.1.edges", lambda edges: -edges),
    "second beyond the span": entry("map.maps.1.edges", moved(-1, 0.1)),
    "first too long": entry("map.maps.0.edges", moved(-1, 0.1)),
}
SPLIT = {
    "one side later": lambda _, values: values["map"]["high"].update(begin=0.5),
    "one side against the span": entry("map.high.edges", lambda edges: -edges),
    "one side too long": entry("map.low.edges", moved(-1, 0.1)),
}
CASES = [
    *(("leg", name) for name in LEG),
    *(("chain", name) for name in CHAIN),
    *(("split", name) for name in SPLIT),
]


@pytest.mark.slow_cases("leg against the span", "chain legs exchanged")
@pytest.mark.parametrize(("kind", "name"), CASES, ids=[" ".join(case) for case in CASES])
def test_parts_out_of_order_are_refused(request, tmp_path, kind, name):
    edit = {"leg": LEG, "chain": CHAIN, "split": SPLIT}[kind][name]
    path = forged(request.getfixturevalue(kind), tmp_path / "map.hamsym", edit)
    with pytest.raises(FileError, match="not a valid file of a flow map"):
        hamsym.load(path)


def test_maps_of_each_form_are_read_back(leg, chain, split, tmp_path):
    t, start = np.linspace(0, 3, 31), [1.02, 0.03]
    for flow in (leg, chain, split):
        flow.save(tmp_path / "map.hamsym")
        np.testing.assert_array_equal(
            hamsym.load(tmp_path / "map.hamsym")(t, start), flow(t, start)
        )


@pytest.mark.parametrize("kind", ["leg", "chain", "split"])
def test_maps_out_of_order_have_no_proof(request, kind):
    flow = request.getfixturevalue(kind)
    wrong = copy.deepcopy(flow.map)
    part = {"leg": wrong, "chain": getattr(wrong, "maps", [None])[-1], "split": None}[kind]
    part = wrong.high if kind == "split" else part
    part.edges = -part.edges
    with pytest.raises(CertificationError, match="not in order"):
        dataclasses.replace(flow, map=wrong).certify()


def test_box_with_parameters_before_components_is_refused(with_parameter, tmp_path):
    def edit(arrays, values):
        values["region"]["names"].reverse()

    with pytest.raises(FileError, match="after parameters"):
        hamsym.load(forged(with_parameter, tmp_path / "map.hamsym", edit))
    wrong = dataclasses.replace(with_parameter.region, names=("k", "x"))
    with pytest.raises(CertificationError, match="after parameters"):
        dataclasses.replace(with_parameter, region=wrong).certify()


def test_box_varies_only_what_the_equation_has(with_parameter, tmp_path):
    def edit(arrays, values):
        values["region"]["names"][1] = "m"

    with pytest.raises(FileError, match="neither H nor an expression"):
        hamsym.load(forged(with_parameter, tmp_path / "map.hamsym", edit))


@pytest.mark.parametrize("end", [0.3, 1.0, 2.0, 2.999])
def test_map_that_ends_earlier_is_the_same(leg, chain, split, end):
    random = np.random.default_rng(1)
    inputs, times = leg.region.at(random.uniform(-1, 1, (50, 2))), random.uniform(0, end, 50)
    for flow in (leg, chain, split):
        found = ended(flow.map, end)
        require_order(found, (0.0, end))
        np.testing.assert_allclose(
            found.evaluate(times, inputs), flow.map.evaluate(times, inputs), rtol=0, atol=1e-13
        )
