"""Names, numbers and captions as they are drawn, and the figure itself."""

from __future__ import annotations

import io
import pickle
from itertools import pairwise
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.font_manager import FontProperties

import hamsym
from hamsym.errors import InputError
from hamsym.plotting.captions import caption_words, parameter_words
from hamsym.plotting.figure import Figure, label, one_panel, wrapped_words
from hamsym.plotting.names import (
    known_name,
    math_name,
    math_unit,
    number,
    quantity,
    with_unit,
    words_of,
)
from hamsym.plotting.style import (
    MAX_LINES,
    WARNING,
    line_style,
    line_styles,
    positive,
    styled,
)

FONT = FontProperties(family="DejaVu Sans", size=7.5)
HOSTILE = [
    "a$b",
    "x^2",
    "{",
    "\\frac",
    "$",
    "p_",
    "_x",
    "ż",
    "x y",
    "%",
    "#1",
    "\\",
    "a" * 300,
    "θ",
]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("p_theta", r"$p_{\theta}$"),
        ("x1", "$x_{1}$"),
        ("p_x1", "$p_{x_{1}}$"),
        ("px1", "$p_{x_{1}}$"),
        ("omega_0", r"$\omega_{0}$"),
        ("x1_2", "$x_{1,2}$"),
        ("spring", r"$\mathrm{spring}$"),
        ("mass_of_it", r"$\mathrm{mass\_of\_it}$"),
        ("psi", r"$\psi$"),
    ],
)
def test_names_are_drawn_as_mathematics(name: str, expected: str) -> None:
    assert math_name(name) == expected


@pytest.mark.slow_cases("\\u017c", "_x", "$", "{", "\\\\frac", "x^2", "p_", "a$b")
@pytest.mark.parametrize("name", HOSTILE)
def test_any_name_can_be_drawn(name: str) -> None:
    figure = Figure.of_size(9, 6)
    with styled():
        axes = figure.subplots()
        axes.plot([0, 1e-24], label=math_name(name))
        label(axes.yaxis, math_name(name), "m")
        axes.legend()
    figure.savefig(io.BytesIO(), format="svg")


@pytest.mark.slow
@given(st.text(max_size=60))
@settings(max_examples=30, deadline=None)
def test_no_line_of_a_caption_is_wider_than_asked(text: str) -> None:
    text = "".join(letter for letter in text if letter.isascii() and letter.isprintable())
    words = [word.replace("$", r"\$") for word in text.split()]
    canvas = matplotlib.figure.Figure(figsize=(4, 4), dpi=200)
    for line in wrapped_words(words, 1.5, FONT):
        shown = canvas.text(0, 0, line, fontproperties=FONT)
        assert shown.get_window_extent().width / 200 <= 1.55
    assert "".join(wrapped_words(words, 1.5, FONT)).replace(" ", "") == "".join(words)


def test_words_are_broken_at_the_width() -> None:
    canvas = matplotlib.figure.Figure(figsize=(4, 4), dpi=200)
    words = ["word", "a", "$x^2$", "longer"] * 5
    lines = wrapped_words(words, 1.5, FONT)
    assert " ".join(lines) == " ".join(words)

    def width(line: str) -> float:
        return canvas.text(0, 0, line, fontproperties=FONT).get_window_extent().width / 200

    assert all(width(line) <= 1.55 for line in lines)
    # The first word of the next line has no room.
    assert all(width(f"{line} {after.split()[0]}") > 1.45 for line, after in pairwise(lines))


def test_axes_of_the_user_keep_their_style() -> None:
    with matplotlib.rc_context({"lines.linewidth": 7.0}):
        with one_panel(matplotlib.figure.Figure().subplots()):
            assert matplotlib.rcParams["lines.linewidth"] == 7.0
        with one_panel(None):
            assert matplotlib.rcParams["lines.linewidth"] == 1.0


def test_units_and_powers() -> None:
    assert math_unit("kg*m**2/s**2") == "kg·m$^{2}$/s$^{2}$"
    assert number(-2e-24) == r"$-2\times10^{-24}$"
    assert number(1e9) == "$10^{9}$"
    units = {"x": "m", "p": "kg*m/s", "m": "kg", "k": "N/m"}
    H = hamsym.Hamiltonian("p**2/(2*m) + k*x**2/2", units=units)
    assert with_unit(*quantity(H, "p")) == "$p$ [kg·m/s]"


def test_lines_are_distinct_before_they_repeat() -> None:
    styles = [tuple(sorted(line_style(index).items())) for index in range(24)]
    assert len(set(styles)) == 24
    assert len({style["color"] for style in line_styles(MAX_LINES + 30)}) == MAX_LINES + 30


def test_logarithmic_values_keep_small_ones() -> None:
    assert positive(np.array([1e-40, 0.0, -1.0, np.inf]))[0] == 1e-40
    assert np.isnan(positive(np.array([0.0, -1.0, np.inf, np.nan]))).all()


def test_long_lists_of_parameters_are_counted() -> None:
    H = hamsym.Hamiltonian("p**2/2 + x**2/2")
    words = parameter_words(H, {f"k{i}": float(i) for i in range(12)})
    assert " ".join(words).endswith("and 2 more parameters")


def test_long_sums_are_counted() -> None:
    terms = "+".join(f"x**{i}/{i}" for i in range(2, 40))
    H = hamsym.Hamiltonian(f"p**2/2 + {terms}")
    assert "(27 more terms)" in " ".join(caption_words(H))


def test_powers_of_ten_and_offsets_are_in_the_label() -> None:
    figure = Figure.of_size(9, 6)
    axes = figure.subplots()
    axes.plot(1e9 + np.linspace(0, 5e-3, 9), np.linspace(-1e-24, 1e-24, 9))
    label(axes.xaxis, "$t$", "s")
    label(axes.yaxis, "$p$", "kg m/s")
    figure.savefig(io.BytesIO(), format="png")
    assert axes.get_xlabel() == "$t$ − $10^{9}$ [$10^{−3}$ s]"
    assert axes.get_ylabel() == "$p$ [$10^{−24}$ kg m/s]"
    axes.set_ylabel("momentum")
    figure.savefig(io.BytesIO(), format="png")
    assert axes.get_ylabel() == "momentum [$10^{−24}$]"
    assert not axes.yaxis.offsetText.get_text()


def test_caption_is_broken_again_when_the_width_changes() -> None:
    figure = Figure.of_size(18, 6, ["word"] * 60)
    lines = figure.caption.count("\n")
    figure.set_size_inches(2.5, 6)
    assert figure.caption.count("\n") > lines


def test_figure_grows_with_its_caption() -> None:
    plain = Figure.of_size(9, 6).get_size_inches()[1]
    assert plain == pytest.approx(6 / 2.54)
    figure = Figure.of_size(9, 6, ["word"] * 60, "It failed.")
    assert figure.get_size_inches()[1] > plain + 0.5
    assert figure.warning == "It failed."
    assert figure.texts[-1].get_color() == WARNING
    figure.set_caption()
    assert figure.get_size_inches()[1] == pytest.approx(plain)


@pytest.mark.slow
def test_settings_of_the_user_are_kept() -> None:
    with matplotlib.rc_context({"font.size": 31.0, "axes.grid": False, "text.usetex": False}):
        before = dict(matplotlib.rcParams)
        figure = hamsym.integrate("p**2/2 + x**2/2", [1, 0], (0, 6), steps=50).plot("x")
        figure.savefig(io.BytesIO(), format="png")
        assert dict(matplotlib.rcParams) == before
    assert figure.axes[0].xaxis.label.get_fontsize() == 8


@pytest.mark.slow
def test_figure_appears_in_a_notebook_once() -> None:
    formatter = pytest.importorskip("IPython.core.formatters").DisplayFormatter()
    figure = hamsym.integrate("p**2/2 + x**2/2", [1, 0], (0, 6), steps=50).plot("x")
    data, metadata = formatter.format(figure)
    assert isinstance(data["image/png"], str)
    assert metadata["image/png"]["width"] == pytest.approx(9 / 2.54 * 120, abs=1)
    assert set(data) <= {"image/png", "text/plain"}
    assert figure._repr_png_()[:4] == b"\x89PNG"
    pyplot = pytest.importorskip("matplotlib.pyplot")
    assert not pyplot.get_fignums()


@pytest.mark.slow
def test_pickled_figure_is_the_same() -> None:
    figure = hamsym.integrate("p**2/2 + x**2/2", [1, 0], (0, 6), steps=50).plot("x", "p")
    again = pickle.loads(pickle.dumps(figure))
    assert isinstance(again, Figure)
    assert again.caption == figure.caption
    assert again._repr_png_()[:4] == b"\x89PNG"


@pytest.mark.slow_cases("svg-<", "pdf-%PDF")
@pytest.mark.parametrize(
    ("suffix", "start"), [("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<")]
)
def test_files_do_not_depend_on_the_run(tmp_path: Path, suffix: str, start: bytes) -> None:
    figure = hamsym.integrate("p**2/2 + x**2/2", [1, 0], (0, 6), steps=50).plot("x")
    paths = [tmp_path / f"{k}.{suffix}" for k in range(2)]
    for path in paths:
        figure.savefig(path)
    first, second = (path.read_bytes() for path in paths)
    assert first.startswith(start)
    assert first == second


def test_unknown_names_are_answered_with_the_nearest() -> None:
    with pytest.raises(
        InputError, match=r"'thetta' is not a component of z \(did you mean 'theta'"
    ):
        known_name("thetta", ["theta", "p"], "a component of z")
    with pytest.raises(InputError, match=r"choose one of q0, .*, \.\.\."):
        known_name("zzz", [f"q{k}" for k in range(40)], "a component of z")


@pytest.mark.slow
def test_long_texts_of_files_are_shortened() -> None:
    figure = Figure.of_size(8, 6, words_of("abc " * 100_000), "x" * 100_000)
    assert "... (400,000 characters)" in " ".join(figure.caption.split())
    assert "... (100,000 characters)" in " ".join(figure.warning.split())
