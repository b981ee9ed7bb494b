"""Figures of solutions, trajectories and ensembles."""

from __future__ import annotations

import io
from typing import Any

import matplotlib.figure
import numpy as np
import pytest
from matplotlib.colors import to_hex

import hamsym
from hamsym.errors import InputError
from hamsym.plotting import sampling
from hamsym.plotting.figure import Figure
from hamsym.plotting.motions import MAX_DRAWN, plane_title, same_scale
from hamsym.plotting.style import COLORS
from hamsym.plotting.time_axes import fill_time, largest_of_pieces
from tests.plotting.inspection import check_layout

PENDULUM = "p**2/2 - cos(theta)"
HENON_HEILES = "(p_x**2+p_y**2)/2 + (x**2+y**2)/2 + x**2*y - y**3/3"
TRAP_UNITS = {
    "x": "m", "z": "m", "p_x": "kg*m/s", "p_z": "kg*m/s", "m": "kg", "e": "C", "U_dc": "V",
    "V_ac": "V", "Omega": "1/s", "r_0": "m",
}  # fmt: skip
TRAP = hamsym.Hamiltonian(
    "(p_x**2 + p_z**2)/(2*m) + e*(U_dc + V_ac*cos(Omega*t))*(x**2 - 2*z**2)/(2*r_0**2)",
    parameters={"m": 9.1e-31, "e": -1.6e-19, "U_dc": 0.5, "V_ac": 10.0, "Omega": 2e9, "r_0": 5e-3},
    units=TRAP_UNITS,
)


UNITS = {"x": "m", "p": "kg*m/s", "m": "kg", "k": "N/m"}


def legends(figure: Any) -> list[Any]:
    return [axes.get_legend() for axes in figure.axes if axes.get_legend()]


def chain(dof: int) -> hamsym.Hamiltonian:
    kinetic = "+".join(f"p{i}**2/2" for i in range(1, dof + 1))
    springs = "+".join(f"exp(q{i} - q{i + 1})" for i in range(1, dof))
    return hamsym.Hamiltonian(f"{kinetic} + {springs or 'q1**2/2'}")


def moved(dof: int, **options: Any) -> hamsym.Trajectory:
    z0 = np.concatenate((np.linspace(0, 1, dof), np.cos(np.arange(dof))))
    return hamsym.integrate(chain(dof), z0, (0, 5), steps=200, **options)


def long_names() -> hamsym.Hamiltonian:
    names = [f"anharmonic_coefficient_of_the_term_{k}" for k in range(12)]
    terms = "+".join(f"{name}*x**{2 + 2 * (k % 3)}" for k, name in enumerate(names))
    values = {name: 0.1234567 * (k + 1) for k, name in enumerate(names)}
    return hamsym.Hamiltonian(f"p**2/2 + {terms}", parameters=values)


@pytest.fixture(scope="module")
def pendulum() -> hamsym.Solution:
    return hamsym.solve(PENDULUM, [2, 0], (0, 10), tol=1e-9)


@pytest.fixture(scope="module")
def trap() -> hamsym.Solution:
    return hamsym.solve(TRAP, {"x": 1e-4, "z": 5e-5, "p_x": 0, "p_z": 2e-26}, (0, 2e-8))


# -- layout ----------------------------------------------------------------------------------------


@pytest.mark.slow_cases("2", "1", "6")
@pytest.mark.parametrize("dof", [1, 2, 6])
def test_texts_of_an_overview_do_not_overlap(dof: int) -> None:
    check_layout(moved(dof).plot())


@pytest.mark.slow
def test_texts_of_an_overview_of_many_degrees_of_freedom_do_not_overlap() -> None:
    check_layout(moved(30).plot())


@pytest.mark.slow
def test_texts_of_a_solution_do_not_overlap(pendulum: hamsym.Solution) -> None:
    check_layout(pendulum.plot())


@pytest.mark.slow
def test_texts_in_units_do_not_overlap(trap: hamsym.Solution) -> None:
    check_layout(trap.plot())


@pytest.mark.slow
def test_texts_of_long_names_do_not_overlap() -> None:
    check_layout(hamsym.integrate(long_names(), [1, 0], (0, 5), steps=200).plot())


@pytest.mark.slow
def test_texts_of_a_failed_solution_do_not_overlap() -> None:
    figure = hamsym.solve("p**2/2 - x**4/4", [1, 1], (0, 5)).plot()
    check_layout(figure)
    assert figure.warning.startswith("Failed: stopped at t = 1.31103")


@pytest.mark.slow_cases("names2", "names0", "names1", "names3")
@pytest.mark.parametrize("names", [("x",), ("x", "z"), ("x", "p_x"), ("error",), ("energy",)])
def test_texts_of_one_panel_do_not_overlap(trap: hamsym.Solution, names: tuple[str, ...]) -> None:
    figure = trap.plot(*names)
    check_layout(figure)
    assert figure.get_size_inches()[0] * 2.54 == pytest.approx(9)


@pytest.mark.slow
def test_texts_of_a_path_in_space_do_not_overlap() -> None:
    problem = hamsym.systems.penning_trap()
    figure = hamsym.integrate(problem.H, problem.z0, problem.span, steps=400).plot("x", "y", "z")
    check_layout(figure)
    assert figure.axes[0].name == "3d"


@pytest.mark.slow
def test_bodies_in_space_are_drawn_in_space_and_along_each_axis() -> None:
    kinetic = "+".join(f"p_{k}{i}**2/2" for i in "12" for k in "xyz")
    H = hamsym.Hamiltonian(f"{kinetic} - 1/sqrt((x1-x2)**2 + (y1-y2)**2 + (z1-z2)**2)")
    start = dict.fromkeys(H.names, 0.0) | {"x1": -1, "x2": 1, "p_y1": -0.4, "p_y2": 0.4, "z1": 0.1}
    figure = hamsym.integrate(H, start, (0, 9), steps=200).plot()
    check_layout(figure)
    spatial = [axes for axes in figure.axes if axes.name == "3d"]
    assert len(spatial) == 1
    assert [axes.get_title("left") for axes in figure.axes][13:16] == [
        f"Seen along ${k}$" for k in "zyx"
    ]
    names = [text.get_text() for text in figure.axes[13].get_legend().get_texts()]
    assert names == ["($x_{1}$, $y_{1}$)", "($x_{2}$, $y_{2}$)"]


def test_kinetic_and_potential_energy_add_up() -> None:
    start = {"r": 1, "phi": 0, "p_r": 0, "p_phi": 1.1}
    found = hamsym.integrate("p_r**2/2 + p_phi**2/(2*r**2) - 1/r", start, (0, 5), tol=1e-9)
    axes = found.plot("energies").axes[0]
    lines = {line.get_label(): line.get_ydata() for line in axes.lines}
    assert list(lines) == ["$H$", "potential", "kinetic"]
    np.testing.assert_allclose(lines["kinetic"] + lines["potential"], lines["$H$"], atol=1e-14)
    assert lines["potential"][0] == pytest.approx(-1)
    many = hamsym.integrate("p**2/2 + x**2/2", [[1, 0], [2, 0]], (0, 5), steps=50)
    with pytest.raises(InputError, match="energies are drawn of one trajectory, not of 2"):
        many.plot("energies")


def test_near_values_have_different_legend_entries() -> None:
    many = hamsym.integrate(PENDULUM, {"theta": [1.00001, 1.00002, 2], "p": 0.0}, (0, 1), steps=9)
    texts = [text.get_text() for text in many.plot("theta").axes[0].get_legend().get_texts()]
    assert texts == ["1.00001", "1.00002", "2"]


@pytest.mark.slow_cases("13", "3", "12")
@pytest.mark.parametrize("count", [3, 12, 13])
def test_texts_of_ensembles_do_not_overlap(count: int) -> None:
    starts = {"theta": np.linspace(0.1, 2, count), "p": 0.0}
    figure = hamsym.integrate(PENDULUM, starts, (0, 9), steps=300).plot()
    check_layout(figure)
    assert bool(figure.axes[0].get_legend()) == (count <= 12)
    bars = [axes for axes in figure.axes if axes.get_ylabel() == r"$\theta$ at start"]
    assert len(bars) == (count > 12)


# -- overview --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_coordinates_and_momenta_have_panels_of_their_own(trap: hamsym.Solution) -> None:
    figure = trap.plot()
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels[:4] == [
        "$x$ [m]",
        "$p_{x}$ [kg·m/s]",
        "$z$ [m]",
        "$p_{z}$ [kg·m/s]",
    ]
    figure.savefig(io.BytesIO(), format="png")
    assert figure.axes[3].get_ylabel() == "$p_{z}$\n[$10^{−26}$ kg·m/s]"
    assert figure.axes[6].get_title("left") == "Estimated error"


@pytest.mark.slow
def test_what_is_not_drawn_is_said() -> None:
    figure = moved(30).plot()
    assert "6 of 30 degrees of freedom are drawn; plot('q30', 'p30')" in figure.caption.replace(
        "\n", " "
    )
    assert "(47 more terms)" in figure.caption.replace("\n", " ")
    assert len(moved(30).plot("q30", "p30").axes[0].lines) > 0


def test_only_particles_have_orbits() -> None:
    assert plane_title(hamsym.Hamiltonian(HENON_HEILES), "x", "y") == "Orbit"
    assert plane_title(chain(3), "q1", "q2") == "Coordinates"
    trimer = hamsym.systems.lennard_jones().H
    assert plane_title(trimer, "x1", "x2") == "Coordinates"
    assert plane_title(trimer, "x2", "y2") == "Orbit"
    polar = hamsym.Hamiltonian("p_r**2/2 + p_theta**2/(2*r**2) - 1/r")
    assert plane_title(polar, "r", "theta") == "Coordinates"
    assert plane_title(polar, "r", "p_r") == "Phase plane of $r$"


@pytest.mark.slow
def test_every_body_has_its_orbit() -> None:
    problem = hamsym.systems.three_bodies()
    figure = hamsym.integrate(problem.H, problem.z0, problem.span, steps=500).plot()
    orbits = next(axes for axes in figure.axes if axes.get_title("left") == "Orbits")
    texts = [text.get_text() for text in orbits.get_legend().get_texts()]
    assert texts == ["($x_{1}$, $y_{1}$)", "($x_{2}$, $y_{2}$)", "($x_{3}$, $y_{3}$)"]


@pytest.mark.slow
def test_planes_of_one_kind_have_one_scale() -> None:
    assert same_scale(hamsym.Hamiltonian(HENON_HEILES), "x", "y")
    assert same_scale(hamsym.Hamiltonian(HENON_HEILES), "p_x", "p_y")
    assert not same_scale(hamsym.Hamiltonian(HENON_HEILES), "x", "p_x")
    assert same_scale(TRAP, "x", "z")
    polar = hamsym.Hamiltonian("p_r**2/2 + p_theta**2/(2*r**2) - 1/r")
    assert not same_scale(polar, "r", "theta")
    both = hamsym.Hamiltonian("(p_x**2 + p_theta**2)/2 + x*cos(theta)")
    assert not same_scale(both, "x", "theta")
    start = [0.1, 0.2, 0.1, 0]
    figure = hamsym.integrate(HENON_HEILES, start, (0, 20), steps=200).plot("x", "y")
    assert figure.axes[0].get_aspect() == 1
    assert moved(2).plot("q1", "p1").axes[0].get_aspect() == "auto"


def test_few_saved_states_are_joined_by_their_interpolation() -> None:
    trajectory = hamsym.integrate(PENDULUM, [2, 0], (0, 50), tol=1e-9)
    line = trajectory.plot("theta").axes[0].lines[0]
    assert len(trajectory.t) == 101
    exact = hamsym.solve(PENDULUM, [2, 0], (0, 50))(np.asarray(line.get_xdata()))[:, 0]
    assert np.abs(line.get_ydata() - exact).max() < 1e-2


@pytest.mark.slow
def test_saved_states_too_far_apart_are_dots() -> None:
    trajectory = hamsym.integrate(PENDULUM, [2, 0], (0, 300), tol=1e-9)
    figure = trajectory.plot()
    assert all(figure.axes[k].lines[0].get_linestyle() == "None" for k in (0, 1, 2))
    assert "too far apart for lines" in " ".join(figure.caption.split())
    check_layout(figure)


def chords(axes: Any) -> np.ndarray:
    """Distances from the origin of the middles of the lines of a path."""
    path = np.column_stack(max(axes.lines, key=lambda line: len(line.get_xdata())).get_data())
    return np.linalg.norm((path[1:] + path[:-1]) / 2, axis=1)


def test_lines_between_samples_look_like_the_curve() -> None:
    def turns(t: np.ndarray) -> np.ndarray:
        return np.stack([np.cos(t), np.sin(t)], axis=-1)

    t, z, apart = sampling.resolved(turns, np.linspace(0, 1_000 * np.pi, 2_001))
    assert apart == ""
    middles = turns((t[:-1] + t[1:]) / 2)
    assert np.abs((z[:-1] + z[1:]) / 2 - middles).max() < 0.015


def test_time_axis_of_a_backward_span_runs_forward() -> None:
    axes = matplotlib.figure.Figure().subplots()
    fill_time(axes, np.array([3.0, 2.0, 1.0]))
    assert axes.get_xlim() == (1.0, 3.0)


def test_errors_of_failed_members_are_crosses() -> None:
    many = hamsym.solve_many("p**2/2 - x**4/4", [[0.01, 0.0], [0.02, 0.0], [1.0, 1.0]], (0, 5))
    assert many.success.tolist() == [True, True, False]
    axes = matplotlib.figure.Figure().subplots()
    many.plot("error", ax=axes)
    counts = {line.get_marker(): len(line.get_xdata()) for line in axes.lines[:2]}
    assert counts == {".": 2, "x": 1}


@pytest.mark.slow
def test_lines_of_many_turns_look_like_curves() -> None:
    H = "p**2/2 + x**2/2"
    solution = hamsym.solve(H, [1, 0], (0, 1_000), tol=1e-6)
    assert chords(solution.plot("x", "p").axes[0]).min() > 0.98
    many = hamsym.solve_many(H, [[1.0, 0.0]], (0, 600), tol=1e-6)
    assert chords(many.plot("x", "p").axes[0]).min() > 0.98
    saved = hamsym.integrate(H, [1, 0], (0, 1_000), "gauss6", steps=10_000, save_every=10)
    assert chords(saved.plot("x", "p").axes[0]).min() > 0.98


@pytest.mark.slow
def test_turns_too_many_for_lines_are_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sampling, "_MOST", 4_100)
    solution = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 1_000), tol=1e-6)
    figure = solution.plot("x", "p")
    assert "times, too few for lines between them" in " ".join(figure.caption.split())
    assert all(line.get_linestyle() == "None" for line in figure.axes[0].lines)


def test_portrait_says_the_energy_of_its_trajectory(pendulum: hamsym.Solution) -> None:
    caption = " ".join(pendulum.plot("theta", "p").caption.split())
    assert "at the start $H$ = 0.4161" in caption  # -cos(2)


@pytest.mark.slow
def test_what_varies_has_its_unit() -> None:
    H = hamsym.Hamiltonian("p**2/(2*m) + k*x**2/2", parameters={"m": 1, "k": 1}, units=UNITS)
    many = hamsym.solve_many(H, {"x": [1.0, 2.0], "p": 0.0}, (0, 1))
    titles = [legend.get_title().get_text() for legend in legends(many.plot())]
    assert "$x$ at start [m]" in titles


def test_flat_paths_keep_their_own_scales() -> None:
    trajectory = hamsym.integrate(HENON_HEILES, [0.001, 0.2, 0.0, 0.1], (0, 5), steps=100)
    figure = trajectory.plot("x", "y")
    assert figure.axes[0].get_aspect() == "auto"
    assert "different scales" in figure.caption.replace("\n", " ")


# -- chosen panels ---------------------------------------------------------------------------------


def test_a_component_is_drawn_over_time(pendulum: hamsym.Solution) -> None:
    axes = pendulum.plot("theta").axes[0]
    t, values = axes.lines[0].get_data()
    np.testing.assert_array_equal(values, pendulum(t)[:, 0])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("$t$", r"$\theta$")
    assert axes.get_xlim() == (0, 10)
    same = pendulum.plot("t", "theta").axes[0]
    assert same.get_xlabel() == "$t$"


def test_names_may_be_symbols(pendulum: hamsym.Solution) -> None:
    assert pendulum.plot(pendulum.H.p[0]).axes[0].get_ylabel() == "$p$"


def test_the_portrait_has_level_sets_of_H(pendulum: hamsym.Solution) -> None:
    figure = pendulum.plot("theta", "p")
    axes = figure.axes[0]
    assert len(axes.collections) == 1
    assert "level sets of $H$" in figure.caption.replace("\n", " ")
    contour = axes.collections[0]
    system = pendulum.H.compile("numpy")
    for level, path in zip(contour.levels, contour.get_paths(), strict=True):
        energies = system.energy(*system.arguments(path.vertices, np.zeros(len(path.vertices))))
        np.testing.assert_allclose(energies, level, atol=2e-3)


@pytest.mark.slow
def test_level_sets_of_driven_systems_are_refused_in_words() -> None:
    problem = hamsym.systems.driven_duffing()
    figure = hamsym.integrate(problem.H, problem.z0, (0, 10), steps=200).plot("x", "p")
    assert not figure.axes[0].collections
    assert "Level sets of H are not drawn: H depends on time" in figure.caption.replace("\n", " ")


def test_the_error_is_beside_what_was_asked(pendulum: hamsym.Solution) -> None:
    axes = pendulum.plot("error").axes[0]
    assert [text.get_text() for text in axes.texts] == ["asked for"]
    assert axes.lines[-1].get_ydata()[0] == pytest.approx(1e-9)
    drawn = max(np.nanmax(line.get_ydata()) for line in axes.lines[:2])
    times = pendulum.record.times(pendulum.span, 2_001)
    sizes = pendulum.error.scale
    assert drawn == pytest.approx((np.abs(pendulum.error_estimate(times)) / sizes).max())


def test_the_proven_bound_is_drawn(pendulum: hamsym.Solution) -> None:
    bounds = 1e-11 * pendulum.error.scale * np.array([1, 2])
    certificate = hamsym.Certificate(
        *(1e-11, 0.5e-11, tuple(bounds), tuple(bounds / 2), 1e-11, 0.0, 1e-11, 0.0),
        (0.0, 10.0),
        (1e-11,),
        rtol=0.02,
        digest="",
        seconds=1.0,
        components=tuple(pendulum.H.names),
    )
    figure = pendulum.plot("error", certificate=certificate)
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert texts == ["asked for", "proven bound"]
    assert "Proven: no error" in figure.caption.replace("\n", " ")
    assert figure.axes[0].lines[-1].get_ydata()[0] == pytest.approx(2e-11)
    assert figure.axes[0].patches  # the band from the lower bound to the upper


@pytest.mark.slow_cases("energy", "residual")
@pytest.mark.parametrize("name", ["residual", "energy", "search"])
def test_other_panels_can_be_drawn_alone(pendulum: hamsym.Solution, name: str) -> None:
    figure = pendulum.plot(name)
    assert len(figure.axes) == 1
    check_layout(figure)


def test_a_component_may_have_the_name_of_a_panel() -> None:
    H = hamsym.Hamiltonian("p**2/2 + energy**2/2", q=["energy"], p=["p"])
    figure = hamsym.integrate(H, [1, 0], (0, 5), steps=50).plot("energy")
    assert figure.axes[0].get_ylabel() == r"$\mathrm{energy}$"


def test_exact_conservation_is_said_in_words() -> None:
    H = hamsym.Hamiltonian("p**2/2", q=["x"], p=["p"])
    figure = hamsym.integrate(H, [1, 0.5], (0, 1), "stormer_verlet", steps=4).plot("energy")
    assert [text.get_text() for text in figure.axes[0].texts] == ["zero at all times"]


@pytest.mark.slow
def test_backward_time_is_drawn() -> None:
    figure = hamsym.solve(PENDULUM, [1, 0], (0, -5)).plot()
    check_layout(figure)
    assert figure.axes[0].get_xlim() == (-5, 0)


def test_peaks_of_many_times_are_kept() -> None:
    values = np.ones(10_001)
    values[7_777] = 5.0
    t, largest = largest_of_pieces(np.linspace(0, 1, 10_001), values)
    assert len(t) == len(largest) == 200
    assert largest.max() == 5.0


# -- axes of the user ------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_panel_is_drawn_into_axes_of_the_user(pendulum: hamsym.Solution) -> None:
    own = matplotlib.figure.Figure()
    left, right = own.subplots(1, 2)
    assert pendulum.plot("theta", "p", ax=left) is own
    assert pendulum.plot("error", ax=right) is own
    assert left.lines
    assert right.lines
    assert not own.texts
    own.savefig(io.BytesIO(), format="png")


@pytest.mark.parametrize(
    ("names", "options", "message"),
    [
        (("thetta",), {}, r"'thetta' does not occur in H \(did you mean 'theta'\?\)"),
        (("theta", "p", "theta", "p"), {}, "4 components cannot be drawn in one panel"),
        ((), {"ax": matplotlib.figure.Figure().subplots()}, "the overview has several panels"),
        (("theta",), {"ax": "left"}, "is not an Axes of matplotlib"),
        (("error",), {"certificate": 3}, "certificate is a int"),
        (("theta", "error"), {}, "'error' is drawn alone"),
        (("errors",), {}, r"'errors' is not a component \(did you mean 'error'\?\)"),
    ],
)
def test_unusable_arguments_are_refused(
    pendulum: hamsym.Solution, names: tuple[str, ...], options: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        pendulum.plot(*names, **options)


@pytest.mark.slow
def test_flat_axes_are_refused_for_space() -> None:
    problem = hamsym.systems.penning_trap()
    trajectory = hamsym.integrate(problem.H, problem.z0, (0, 1), steps=20)
    with pytest.raises(InputError, match="axes of three dimensions"):
        trajectory.plot("x", "y", "z", ax=matplotlib.figure.Figure().subplots())


@pytest.mark.slow
def test_a_trajectory_without_estimate_says_how_to_get_one() -> None:
    with pytest.raises(InputError, match="integrate with tol="):
        moved(1).plot("error")
    estimated = hamsym.integrate(PENDULUM, [1, 0], (0, 5), tol=1e-8)
    check_layout(estimated.plot())
    check_layout(estimated.plot("error"))


# -- ensembles -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_members_of_an_ensemble_have_a_legend_entry_each() -> None:
    many = hamsym.solve_many("p**2/2 - k*cos(x)", [1.0, 0.0], (0, 5), parameters={"k": [1, 2, 3]})
    figure = many.plot("x")
    legend = figure.axes[0].get_legend()
    assert [text.get_text() for text in legend.get_texts()] == ["1", "2", "3"]
    assert legend.get_title().get_text() == "$k$"
    assert "$k$ from 1 to 3" in figure.caption
    check_layout(many.plot())


@pytest.mark.slow
def test_a_choice_of_many_members_is_said() -> None:
    starts = {"x": np.linspace(0.1, 2, 300), "p": 0.0}
    many = hamsym.solve_many("p**2/2 - cos(x)", starts, (0, 3))
    figure = many.plot("x", "p")
    assert f"{MAX_DRAWN} of 300 trajectories are drawn" in figure.caption.replace("\n", " ")
    colors = {to_hex(line.get_color()) for line in figure.axes[0].lines}
    assert len(colors) > 100
    assert not colors & set(COLORS)
    assert len(many.plot("error").axes[0].lines[0].get_xdata()) == 300


@pytest.mark.slow
def test_failed_members_are_marked() -> None:
    many = hamsym.solve_many("p**2/2 - x**4/4", {"x": [0.01, 1.0], "p": [0.0, 1.0]}, (0, 3))
    figure = many.plot()
    check_layout(figure)
    assert figure.warning.startswith("1 of 2 trajectories failed, the first is [1]: stopped at t")


def test_no_members_are_refused() -> None:
    many = hamsym.solve_many("p**2/2 - cos(x)", [[1.0, 0.0], [0.5, 0.0]], (0, 1))
    with pytest.raises(InputError, match="no trajectories to draw"):
        many[:0].plot()


def test_figures_belong_to_no_window() -> None:
    figure = moved(1).plot("q1")
    assert type(figure) is Figure
    assert figure.canvas.manager is None
