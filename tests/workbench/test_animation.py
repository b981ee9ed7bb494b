"""Animations: their states, pictures and files."""

from __future__ import annotations

import re
import shutil

import numpy as np
import pytest
from PIL import Image

import hamsym
from hamsym import systems
from hamsym.errors import FileError, InputError
from hamsym.workbench.animations import animate as animations
from hamsym.workbench.animations.film import Film


@pytest.fixture(scope="module")
def pendulum():
    return hamsym.solve("p**2/2 - cos(theta)", [2.0, 0.0], (1.0, 9.0))


@pytest.fixture(scope="module")
def bodies():
    problem = systems.three_bodies()
    return hamsym.integrate(problem.H, problem.z0, problem.span, "dop853", steps=400)


@pytest.fixture(scope="module")
def oscillators():
    """An ensemble of 60 oscillators, the last with another period."""
    H = hamsym.Hamiltonian("p**2/2 + k*x**2/2")
    z0 = {"x": np.linspace(1, 2, 60), "p": 0.0}
    k = np.append(np.ones(59), 4.0)
    return hamsym.integrate(H, z0, (0, 5), "dop853", steps=500, parameters={"k": k})


def places(animation, number):
    """Places of all points in a frame, in the units of the axes."""
    dots = animation.frame(number).axes[0].collections[-1]
    return np.asarray(dots.get_offsets())


# -- states ------------------------------------------------------------------------------------


def test_frames_have_equal_times_and_states_of_the_solution(pendulum):
    animation = pendulum.animate(frames=33)
    np.testing.assert_allclose(animation.times, np.linspace(1, 9, 33), rtol=1e-15)
    np.testing.assert_allclose(animation.states[:, 0], pendulum(animation.times), atol=1e-13)


def test_frames_of_a_trajectory_lie_between_its_steps():
    trajectory = hamsym.integrate("p**2/2 + x**2/2", [1, 0], (0, 6), "dop853", dt=0.05)
    animation = trajectory.animate("x", "p", frames=77)
    exact = np.column_stack((np.cos(animation.times), -np.sin(animation.times)))
    assert np.abs(animation.states[:, 0] - exact).max() < 1e-7


def test_motion_backwards_in_time_is_played_in_its_order():
    trajectory = hamsym.integrate("p**2/2 + x**2/2", [1, 0], (0, -3), "dop853", dt=0.05)
    animation = trajectory.animate(frames=77)
    assert animation.times[-1] == -3
    exact = np.column_stack((np.cos(animation.times), -np.sin(animation.times)))
    assert np.abs(animation.states[:, 0] - exact).max() < 1e-7


def test_periodic_orbit_ends_one_frame_before_it_repeats():
    orbit = hamsym.periodic_orbit("p**2/2 + x**2/2 + x**4/4", [1.0, 0.0])
    animation = orbit.animate(frames=10)
    np.testing.assert_allclose(animation.times, np.arange(10) * orbit.period / 10, atol=1e-12)


@pytest.mark.slow
def test_tail_of_a_periodic_orbit_is_there_at_the_start():
    orbit = hamsym.periodic_orbit("p**2/2 + x**2/2 + x**4/4", [1.0, 0.0])
    animation = orbit.animate(frames=10)
    first_tail = len(animation.frame(0).axes[0].collections[-3].get_segments())
    assert first_tail > 0  # of the period before


def test_members_of_solve_many_are_drawn_together():
    many = hamsym.solve_many("p**2/2 + x**2/2", {"x": [[1.0, 2.0], [3.0, 4.0]], "p": 0.0}, (0, 2))
    animation = many.animate(frames=4)
    assert animation.states.shape == (4, 4, 2)
    ends = many(2.0)[..., 0].ravel()
    np.testing.assert_allclose(animation.states[-1, :, 0], ends, atol=1e-13)


@pytest.mark.slow
def test_number_of_members_that_are_left_out_is_said(oscillators):
    animation = oscillators.animate(frames=3)
    assert animation.states.shape == (3, 50, 2)
    assert "the first 50 of 60 members" in " ".join(animation.frame(0).caption.split())


@pytest.mark.slow
def test_member_that_escapes_disappears_with_a_note():
    start = {"x": [0.1, 3.0], "p": 0.0}
    found = hamsym.integrate("p**2/2 - x**4", start, (0, 4), "dop853", steps=4_000)
    animation = found.animate(frames=20)
    assert np.isfinite(animation.states[:, 0]).all()
    assert np.isnan(animation.states[-1, 1]).all()
    assert animation.frame(0).warning == "1 of 2 members did not succeed."


# -- pictures ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_pendulum_hangs_from_the_origin_by_rods_of_its_lengths():
    H = hamsym.Hamiltonian(
        "p1**2/(2*l1**2) + p2**2/(2*l2**2) - l1*cos(theta1) - l2*cos(theta2)",
        parameters={"l1": 2.0, "l2": 0.5},
    )
    found = hamsym.integrate(H, [0.5, -1.0, 0, 0], (0, 3), "dop853", dt=0.01)
    with pytest.raises(InputError, match="theta1, theta2 have no usual picture"):
        found.animate()  # neither carries the other
    pivot, first, second = places(found.animate(kind="pendulum", frames=3), 0)
    np.testing.assert_allclose(pivot, 0)
    np.testing.assert_allclose(first, [2 * np.sin(0.5), -2 * np.cos(0.5)])
    np.testing.assert_allclose(second - first, [0.5 * np.sin(-1.0), -0.5 * np.cos(1.0)])


@pytest.mark.slow_cases("g-9.81", "lengths1-3", "3-3")
@pytest.mark.parametrize(("lengths", "expected"), [(3, 3), ([3.0], 3), ("g", 9.81), (["g"], 9.81)])
def test_lengths_are_numbers_or_parameters(lengths, expected):
    H = hamsym.Hamiltonian("p**2/2 - g*cos(q)", parameters={"g": 9.81})
    found = hamsym.integrate(H, [np.pi / 2, 0], (0, 1), "dop853", dt=0.1)
    at = places(found.animate(lengths=lengths, frames=2), 0)
    np.testing.assert_allclose(at[1], [expected, 0], atol=1e-12)


@pytest.mark.slow
def test_bodies_move_in_one_plane(bodies):
    animation = bodies.animate(frames=4)
    z = animation.states[2, 0]
    np.testing.assert_array_equal(places(animation, 2), np.column_stack((z[:3], z[3:6])))
    axis = animation.frame(2).axes[0]
    assert axis.get_aspect() == 1
    legend = [text.get_text() for text in axis.get_legend().get_texts()]
    assert len(legend) == 3


@pytest.mark.slow
def test_many_bodies_have_different_colours():
    problem = systems.pleiades()
    found = hamsym.integrate(problem.H, problem.z0, (0, 0.1), "dop853", dt=0.01)
    colors = found.animate(frames=2).frame(0).axes[0].collections[-1].get_facecolors()
    assert len({tuple(color) for color in colors}) == 7


@pytest.mark.slow
def test_chain_has_its_coordinates_as_heights():
    problem = systems.fermi_pasta_ulam_tsingou(n=30)
    found = hamsym.integrate(problem.H, problem.z0, (0, 10), "stormer_verlet", dt=0.05)
    animation = found.animate(frames=3)
    np.testing.assert_array_equal(places(animation, 2)[:, 0], np.arange(1, 31))
    np.testing.assert_array_equal(places(animation, 2)[:, 1], animation.states[2, 0, :30])


def test_phase_plane_of_one_coordinate_has_level_sets(pendulum):
    axis = pendulum.animate("theta", "p", frames=3).frame(0).axes[0]
    assert any(len(getattr(artist, "levels", ())) > 3 for artist in axis.collections)


@pytest.mark.slow_cases("p_x**2/2 + p_y**2/2 + x**2 + y**2")
@pytest.mark.parametrize("H", ["p**2/2 + x**2/2 + x*cos(t)", "p_x**2/2 + p_y**2/2 + x**2 + y**2"])
def test_level_sets_are_left_out_where_they_mean_nothing(H):
    z0 = [1, 0] if "t" in H else [1, 0, 0, 1]
    found = hamsym.integrate(H, z0, (0, 3), "dop853", dt=0.05)
    axis = found.animate("x", found.names[len(z0) // 2], frames=3).frame(0).axes[0]
    assert not any(hasattr(artist, "levels") for artist in axis.collections)


@pytest.mark.slow
def test_points_are_functions_of_the_state_and_the_time():
    found = hamsym.integrate("p**2/2 + x**2/2", [1, 0], (0, 2), "dop853", dt=0.05)
    one = found.animate(points=lambda z: [z[0], 2.0], frames=3)
    two = found.animate(points=lambda z, t: [[t, 0], [z[0], t]], rods=[(0, 1)], frames=3)
    np.testing.assert_allclose(places(one, 2), [[one.states[2, 0, 0], 2.0]])
    np.testing.assert_allclose(places(two, 1), [[1.0, 0.0], [two.states[1, 0, 0], 1.0]])


@pytest.mark.slow
def test_limits_hold_all_frames_and_do_not_change(bodies):
    animation = bodies.animate(frames=12)
    limits = set()
    for number in range(12):
        axis = animation.frame(number).axes[0]
        limits.add((axis.get_xlim(), axis.get_ylim()))
        at = places(animation, number)
        assert (at[:, 0] > axis.get_xlim()[0]).all()
        assert (at[:, 1] < axis.get_ylim()[1]).all()
    assert len(limits) == 1


@pytest.mark.slow
def test_tail_covers_its_part_of_the_span(pendulum):
    def oldest(tail):
        figure = pendulum.animate("theta", "p", frames=21, tail=tail).frame(-1)
        return np.array(figure.axes[0].collections[-3].get_segments())[0, 0]

    np.testing.assert_allclose(oldest(0.5), pendulum(5.0), atol=0.02)
    np.testing.assert_allclose(oldest(1.0), pendulum(1.0), atol=0.02)


@pytest.mark.slow
def test_time_is_shown_with_its_unit():
    units = {"x": "m", "p": "kg*m/s", "m": "kg", "k": "kg/s**2"}
    H = hamsym.Hamiltonian(
        "p**2/(2*m) + k*x**2/2", parameters={"m": 9.1e-31, "k": 3.6e-13}, units=units
    )
    found = hamsym.integrate(H, [1e-6, 0], (0, 1e-8), "dop853", steps=200)
    figure = found.animate(frames=5).frame(2)
    assert figure.axes[0].get_title(loc="left") == "t = 5.00e-09 s"
    figure.canvas.draw()
    assert figure.axes[0].get_ylabel() == "$p$ [$10^{−28}$ kg·m/s]"


# -- files -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_gif_has_all_frames_and_their_duration(pendulum, tmp_path):
    animation = pendulum.animate(frames=7, fps=20)
    animation.save(tmp_path / "a.gif", dpi=60)
    with Image.open(tmp_path / "a.gif") as image:
        assert image.n_frames == 7
        assert image.info["duration"] == 50
        assert image.info["loop"] == 0
        first = np.asarray(image.convert("RGB"))
        image.seek(3)
        assert (np.asarray(image.convert("RGB")) != first).any()


@pytest.mark.slow
def test_page_contains_all_frames_and_fetches_nothing(pendulum, tmp_path):
    pendulum.animate(frames=6).save(tmp_path / "a.html", dpi=60)
    text = (tmp_path / "a.html").read_text()
    assert text.startswith("<!DOCTYPE html>")
    assert not re.search(r"https?:|url\(|@import|<link(?! rel=\"icon\" href=\"data:)", text)
    assert text.count("iVBORw0KGgo") == 7  # PNG: the frames, and the first one before it plays
    assert "t = 9.0" in text


@pytest.mark.slow
def test_notebook_shows_a_player(pendulum):
    text = pendulum.animate(frames=3)._repr_html_()
    assert text.lstrip().startswith("<div")
    assert "<html" not in text


def test_film_has_the_format_of_mp4(pendulum, tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    pendulum.animate(frames=5).save(tmp_path / "a.mp4", dpi=60)
    assert (tmp_path / "a.mp4").read_bytes()[4:8] == b"ftyp"


def test_film_without_ffmpeg_is_refused_in_a_sentence(pendulum, tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setitem(__import__("sys").modules, "imageio_ffmpeg", None)
    with pytest.raises(InputError, match=r"ffmpeg, which is not installed.*\.html or \.gif"):
        pendulum.animate(frames=2).save(tmp_path / "a.mp4")


@pytest.mark.slow
def test_formula_is_no_markup(tmp_path):
    found = hamsym.integrate("p**2/2 + max(x, 0)**2", [1, 0], (0, 1), "dop853", dt=0.1)
    animation = found.animate(frames=2)
    animation._film.title = "<script>alert(1)</script>"
    animation.save(tmp_path / "a.html", dpi=40)
    assert "<script>alert" not in (tmp_path / "a.html").read_text()


def test_too_large_file_leaves_the_old_one(pendulum, tmp_path):
    path = tmp_path / "a.gif"
    path.write_text("old")
    with pytest.raises(InputError, match="fewer frames, a smaller dpi"):
        pendulum.animate(frames=2).save(path, dpi=20, largest=1e-3)
    assert path.read_text() == "old"


def test_unwritable_path_is_a_file_error(pendulum, tmp_path):
    with pytest.raises(FileError, match="cannot be written"):
        pendulum.animate(frames=2).save(tmp_path / "missing" / "a.gif", dpi=40)


# -- refusals ----------------------------------------------------------------------------------


@pytest.mark.parametrize("path", ["a.png", "a", "html", ".html.txt"])
def test_unknown_ending_is_refused(pendulum, tmp_path, path):
    with pytest.raises(InputError, match=r"ends \.html, \.gif or \.mp4"):
        pendulum.animate(frames=2).save(tmp_path / path)


@pytest.mark.parametrize(
    ("names", "options", "reason"),
    [
        (("thta", "p"), {}, "did you mean 'theta'"),
        ((5,), {}, "5 is neither a component nor a formula"),
        (("theta",), {"kind": "plane"}, "two components for each body"),
        (("theta", "p", "theta"), {"kind": "phase"}, "two components"),
        ((), {"kind": "orbit"}, "kind='orbit' is unknown"),
        (("p",), {"kind": "pendulum"}, "angles"),
        ((), {"lengths": [1, 2]}, "one for each angle"),
        ((), {"lengths": -1}, "above 0"),
        ((), {"lengths": "l"}, "'l' is no parameter"),
        ((), {"lengths": 1, "kind": "chain"}, "lengths are those of a pendulum"),
        ((), {"rods": [(0, 1)]}, "give points as well"),
        ((), {"points": 3}, "points is no function"),
        ((), {"points": lambda z: z[0]}, "pairs x, y"),
        ((), {"points": lambda z: "no"}, "pairs x, y"),
        ((), {"points": lambda z: [1, 2], "rods": [(0, 1)]}, "no pair of points"),
        (("theta",), {"points": lambda z: [1, 2]}, "leave names"),
        ((), {"frames": 1}, "from 2 to 2000"),
        ((), {"frames": 5, "seconds": 1, "fps": 5}, "two of them"),
        ((), {"seconds": np.nan}, "seconds"),
        ((), {"seconds": 1e9}, "frames cannot be drawn"),
        ((), {"seconds": 1e300, "frames": 2}, "cannot be shown"),
        ((), {"points": lambda z: [1e305, z[0]]}, "no place .* is finite"),
        ((), {"tail": 2}, "from 0 to 1"),
        ((), {"tail": np.nan}, "tail"),
    ],
)  # fmt: skip
def test_unusable_option_is_refused(pendulum, names, options, reason):
    with pytest.raises(InputError, match=reason):
        pendulum.animate(*names, **options)


@pytest.mark.slow_cases("p_r**2/2 + p_phi**2/(2*r**2) + 9*(r - 1)**2 + r*cos(phi)-direction1")
@pytest.mark.parametrize(
    ("H", "direction"),
    [
        ("p_r**2/2 + p_theta**2/(2*r**2) + 9*(r - 1)**2 - r*cos(theta)", (np.sin, -1.0)),
        ("p_r**2/2 + p_phi**2/(2*r**2) + 9*(r - 1)**2 + r*cos(phi)", (np.sin, 1.0)),
    ],
)
def test_polar_coordinates_hang_along_the_weight(H, direction):
    known = hamsym.Hamiltonian(H)
    distance, angle = sorted(known.names[:2], key=lambda name: name != "r")
    start = {distance: 1.2, angle: 0.7, f"p_{distance}": 0, f"p_{angle}": 0}
    animation = hamsym.integrate(known, start, (0, 2), "dop853", dt=0.01).animate(frames=4)
    state = dict(zip(known.names, animation.states[2, 0], strict=True))
    r, angle = state[distance], state[angle]
    pivot, body = places(animation, 2)
    np.testing.assert_allclose(pivot, 0)
    sine, sign = direction
    np.testing.assert_allclose(body, [-sign * r * sine(angle), sign * r * np.cos(angle)])


@pytest.mark.slow
def test_polar_coordinates_of_a_central_force_are_those_of_the_plane():
    H = hamsym.Hamiltonian("p_rho**2/2 + p_phi**2/(2*rho**2) - 1/rho")
    found = hamsym.integrate(
        H, {"rho": 1, "phi": 0, "p_rho": 0, "p_phi": 1}, (0, 6), "dop853", dt=0.01
    )
    animation = found.animate(frames=4)
    state = dict(zip(H.names, animation.states[3, 0], strict=True))
    expected = state["rho"] * np.array([np.cos(state["phi"]), np.sin(state["phi"])])
    np.testing.assert_allclose(places(animation, 3)[1], expected)
    assert animation.frame(0).axes[0].get_aspect() == 1


@pytest.mark.slow_cases("names0")
@pytest.mark.parametrize("names", [(), ("r", "theta"), ("r",)])
def test_distance_is_not_drawn_as_an_angle(names):
    problem = systems.swinging_atwood()
    found = hamsym.integrate(problem.H, problem.z0, (0, 1), "dop853", dt=0.1)
    with pytest.raises(InputError, match="'r' is no angle of a pendulum"):
        found.animate(*names, kind="pendulum")
    pivot, body = places(found.animate(frames=2), 0)
    assert np.hypot(*(body - pivot)) == pytest.approx(problem.z0[0])


def test_coordinates_without_a_usual_picture_are_asked_for():
    H = "p_r**2/2 + p_theta**2/2 + r**2 + theta**2"  # no polar coordinates in spite of their names
    found = hamsym.integrate(H, [1, 0, 0, 1], (0, 1), "dop853", dt=0.1)
    with pytest.raises(InputError, match=r"r, theta have no usual picture.*points=") as caught:
        found.animate()
    assert "pendulum" not in str(caught.value)
    assert "polar" not in str(caught.value)
    assert found.animate("r", "theta", frames=2).frame(0).axes[0].get_aspect() == "auto"


@pytest.mark.parametrize("result", [3, None, hamsym.Hamiltonian("p**2/2 + x**2")])
def test_only_results_with_a_motion_are_animated(result):
    with pytest.raises(InputError, match="cannot be animated"):
        hamsym.animate(result)


def test_number_of_a_frame_is_checked(pendulum):
    with pytest.raises(InputError, match="number"):
        pendulum.animate(frames=3).frame(3)


@pytest.mark.slow
def test_frames_are_drawn_once_for_the_page_and_its_palette(pendulum, monkeypatch, tmp_path):
    drawn = []
    draw = Film.draw
    monkeypatch.setattr(Film, "draw", lambda self, k: (drawn.append(k), draw(self, k))[1])
    pendulum.animate(frames=20).save(tmp_path / "a.html", dpi=40)
    assert len(drawn) <= 1 + 20 + 4
    assert animations.animate is hamsym.animate
