"""Reports in a browser: readable at every width and in print, without a request or an error."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import hamsym

if TYPE_CHECKING:
    from playwright.sync_api import Page

CHAIN = "+".join(f"p{i}**2/2 + (x{i} - x{(i + 1) % 30})**2/2" for i in range(30))
TRAP = hamsym.Hamiltonian(
    "(p_x**2 + p_y**2)/(2*m) + Q*(U + V*cos(Omega*t))*(x**2 - y**2)/(2*r_0**2)",
    parameters={"m": 9.1e-31, "Q": -1.6e-19, "U": 0.5, "V": 60.0, "Omega": 4.2e9, "r_0": 2e-3},
    units={"x": "m", "y": "m", "p_x": "kg*m/s", "p_y": "kg*m/s", "m": "kg", "Q": "C"}
    | {"U": "V", "V": "V", "Omega": "1/s", "r_0": "m"},
)
CASES: dict[str, tuple[Any, Any, tuple[float, float]]] = {
    "one degree of freedom": ("p**2/2 + x**2/2 + x**4/4", [1.3, 1], (0, 4)),
    "SI units": (TRAP, [1e-5, 2e-5, 1e-26, 1e-25], (0, 2e-9)),
    "30 degrees of freedom": (CHAIN, np.linspace(0, 1, 60), (0, 0.5)),
    "failed": ("p**2/2 - x**4/4", [1.3, 1], (0, 5)),
}


@pytest.fixture(scope="module", params=CASES)
def written(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    H, z0, span = CASES[request.param]
    solution = hamsym.solve(H, z0, span, tol=1e-6)
    path = tmp_path_factory.mktemp("report") / "a b.html"
    hamsym.report(solution, path, compare=False)
    return path


def test_report_is_shown_without_requests(written: Path, page: Page) -> None:
    requests: list[str] = []
    page.on("request", lambda request: requests.append(request.url))
    page.goto(written.as_uri())
    assert requests == [written.as_uri()]
    sizes = page.evaluate(
        "[...document.querySelectorAll('math, svg')]"
        ".map(e => e.getBoundingClientRect()).map(r => [r.width, r.height])"
    )
    assert len(sizes) >= 5
    assert all(width > 0 and height > 0 for width, height in sizes)
    assert page.locator("figure svg[role=img]").count() == 1


@pytest.mark.parametrize("width", [320, 390, 1280, 1920])
def test_page_is_not_wider_than_the_window(written: Path, page: Page, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 800})
    page.goto(written.as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    # Whatever is wider scrolls inside its own box.
    outside = page.evaluate(
        "[...document.querySelectorAll('main *')]"
        f".filter(e => e.getBoundingClientRect().right > {width} + 1 && !e.closest('.scroll'))"
        ".map(e => e.outerHTML.slice(0, 80))"
    )
    assert outside == []


def test_boxes_that_scroll_take_the_keyboard(written: Path, page: Page) -> None:
    page.set_viewport_size({"width": 390, "height": 800})
    page.goto(written.as_uri())
    names = page.evaluate(
        "[...document.querySelectorAll('.scroll')]"
        ".map(e => [e.tabIndex, e.getAttribute('aria-label') || ''])"
    )
    assert all(index == 0 and name for index, name in names)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_has_contrast(written: Path, page: Page, scheme: Any) -> None:
    page.emulate_media(color_scheme=scheme)
    page.goto(written.as_uri())
    ratios = page.evaluate(
        """() => {
          const rgb = text => text.match(/[\\d.]+/g).map(Number);
          const light = ([r, g, b]) => [r, g, b].map(v => v / 255)
            .map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
            .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
          const behind = e => {
            for (; e; e = e.parentElement) {
              const colour = rgb(getComputedStyle(e).backgroundColor);
              if (colour.length < 4 || colour[3] > 0) return light(colour);
            }
            return 1;
          };
          return [...document.querySelectorAll('p, dt, dd, th, td, a, h1, h2, h3, pre span')]
            .map(e => [light(rgb(getComputedStyle(e).color)), behind(e)])
            .map(([a, b]) => (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05));
        }"""
    )
    assert min(ratios) >= 4.5


def test_print_has_few_pages(written: Path, page: Page) -> None:
    page.goto(written.as_uri())
    pages = re.findall(rb"/Type\s*/Page[^s]", page.pdf(format="A4"))
    assert 2 <= len(pages) <= 24


def test_failure_is_red_and_first(page: Page, tmp_path: Path) -> None:
    failed = hamsym.solve("p**2/2 - x**4/4", [1.3, 1], (0, 5))
    hamsym.report(failed, tmp_path / "a.html", compare=False)
    page.goto((tmp_path / "a.html").as_uri())
    first = page.locator("body p").first
    assert first.inner_text().startswith("Failed")
    red, green, blue = page.evaluate(
        "getComputedStyle(document.querySelector('.outcome')).color.match(/\\d+/g).map(Number)"
    )
    assert red > 2 * max(green, blue)


def test_markup_in_names_does_nothing(page: Page, tmp_path: Path) -> None:
    solution = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 1))
    attack = "<img src=x onerror=\"document.title='attacked'\"><script>document.title=1</script>"
    hamsym.report(solution, tmp_path / "a.html", compare=False, title=attack)
    page.goto((tmp_path / "a.html").as_uri())
    assert page.title() == attack
    assert page.locator("img, script").count() == 0
    assert page.locator("h1").inner_text() == attack


@pytest.mark.slow
def test_comparison_has_a_figure_of_its_own(page: Page, tmp_path: Path) -> None:
    solution = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 5))
    hamsym.report(solution, tmp_path / "a.html", certify=True)
    page.goto((tmp_path / "a.html").as_uri())
    assert page.locator("figure svg[role=img]").count() == 2
    assert "Proven" in page.locator("#summary + dl").inner_text()
