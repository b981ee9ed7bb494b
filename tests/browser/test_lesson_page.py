"""Lessons in a browser: without network, moving, operable by keys, accessible, in print."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import hamsym
from tests.workbench.test_lesson import SYSTEMS, solved

if TYPE_CHECKING:
    from playwright.sync_api import Page

_ATTACK = "<img src=x onerror=\"document.title='attacked'\"></script><script>1</script>"
_CHAIN = "+".join(f"p{i}**2/2 + (x{i} - x{(i + 1) % 30})**2/2" for i in range(30))


@pytest.fixture(scope="module", params=["Henon-Heiles", "chain"])
def written(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("lesson") / "a b.html"
    if request.param == "chain":
        hamsym.export(_CHAIN, path, z0=[0.5] * 7 + [0] * 53, title=_ATTACK, text=_ATTACK)
    else:
        solved(request.param).export(path, title="Stars in a galaxy", text="They move.")
    return path


def opened(page: Page, path: Path, values: str = "") -> None:
    """Open a lesson with the network off, paused."""
    page.context.set_offline(True)
    page.emulate_media(reduced_motion="reduce")
    page.goto(path.as_uri() + values)
    until(page, "document.querySelector('[data-part=accuracy]').textContent")


def until(page: Page, script: str) -> None:
    """Wait for a condition; playwright's own way needs eval, which lessons forbid."""
    for _ in range(400):
        if page.evaluate(f"() => Boolean({script})"):
            return
        page.wait_for_timeout(50)
    raise AssertionError(f"not within 20 s: {script}")


def number(page: Page, name: str) -> float:
    return float(page.get_by_label(f"value of {name}", exact=True).input_value())


@pytest.mark.parametrize("name", SYSTEMS)
def test_page_has_the_trajectory_of_solve(name: str, page: Page, tmp_path: Path) -> None:
    solved(name).export(tmp_path / "a.html")
    opened(page, tmp_path / "a.html")
    assert float(page.locator(".player").get_attribute("data-difference") or "nan") < 1e-8
    assert "differs from hamsym.solve by at most" in page.inner_text("[data-part=accuracy]")


def test_page_fetches_nothing_and_texts_are_texts(written: Path, page: Page) -> None:
    requests: list[str] = []
    page.on("request", lambda request: requests.append(request.url))
    opened(page, written)
    assert requests == [written.as_uri()]
    assert page.title() in ("Stars in a galaxy", _ATTACK)
    assert page.locator("h1").inner_text() == page.title()
    assert page.locator("img").count() == 0


def test_axe_finds_no_violation(written: Path, page: Page) -> None:
    sync_playwright = pytest.importorskip("axe_playwright_python.sync_playwright")
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
        opened(page, written)
        found = sync_playwright.Axe().run(page).response["violations"]
        assert [(one["id"], [node["html"] for node in one["nodes"]]) for one in found] == []


@pytest.mark.parametrize("width", [390, 800, 1400])
def test_page_is_not_wider_than_the_window(written: Path, page: Page, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 900})
    opened(page, written)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    boxes = [canvas.bounding_box() for canvas in page.locator("canvas:visible").all()]
    assert all(box and box["x"] >= 0 and box["x"] + box["width"] <= width for box in boxes)


def test_it_plays_pauses_and_is_scrubbed(written: Path, page: Page) -> None:
    opened(page, written)
    play = page.get_by_role("button", name="Play")
    assert page.inner_text("[data-part=now]") == "t = 0.00"
    play.click()
    until(page, "document.querySelector('[data-part=now]').textContent > 't = 0.1'")
    page.get_by_role("button", name="Pause").click()
    stopped = page.inner_text("[data-part=now]")
    page.wait_for_timeout(100)
    assert page.inner_text("[data-part=now]") == stopped
    page.get_by_label("time", exact=True).fill("500")
    end = number(page, "time span")
    assert page.inner_text("[data-part=now]") == f"t = {end / 2:.2f}"


def test_motion_is_seen(written: Path, page: Page) -> None:
    opened(page, written)
    look = "document.querySelector('[data-part=motion]').toDataURL()"
    first = page.evaluate(look)
    page.get_by_label("time", exact=True).fill("300")
    assert page.evaluate(look) != first


def test_keys_move_sliders_and_the_address_keeps_them(written: Path, page: Page) -> None:
    opened(page, written)
    name = "x" if page.title() == "Stars in a galaxy" else "x0"
    old = number(page, name)
    slider = page.get_by_label(name, exact=True)
    slider.focus()
    for _ in range(5):
        page.keyboard.press("ArrowRight")
    new = number(page, name)
    assert new > old
    until(page, f"location.hash.includes('{name}={new:g}')")
    # Coarser steps while a slider moves are followed by those of the tolerance.
    drift = re.search(
        r"constant to (.*?) of", page.inner_text("[data-part=status]").replace("−", "-")
    )
    assert drift
    assert float(drift[1]) < 1e-9
    page.reload()
    until(page, "document.querySelector('[data-part=accuracy]').textContent")
    assert number(page, name) == new
    # The accuracy is that of the start of the lesson, not of the address.
    assert float(page.locator(".player").get_attribute("data-difference") or "nan") < 1e-7
    page.get_by_role("button", name="Reset").click()
    assert number(page, name) == old


def test_click_in_the_phase_plane_starts_there(written: Path, page: Page) -> None:
    opened(page, written)
    q, p = ("x", "p_x") if page.title() == "Stars in a galaxy" else ("x0", "p0")
    old = number(page, q), number(page, p)
    canvas = page.locator("[data-part=phase]")
    box = canvas.bounding_box()
    assert box is not None
    canvas.click(position={"x": 0.75 * box["width"], "y": 0.3 * box["height"]})
    new = number(page, q), number(page, p)
    assert new != old
    assert new[1] > 0
    canvas.press("ArrowLeft")
    assert number(page, q) < new[0]


def test_fields_take_numbers_and_refuse_words(written: Path, page: Page) -> None:
    opened(page, written)
    name = "p_y" if page.title() == "Stars in a galaxy" else "p29"
    field = page.get_by_label(f"value of {name}", exact=True)
    field.fill("0.125")
    field.press("Enter")
    until(page, f"location.hash.includes('{name}=0.125')")
    field.fill("alert(1)")
    field.press("Tab")
    assert field.get_attribute("aria-invalid") == "true"
    assert f"{name}=0.125" in page.evaluate("location.hash")


def test_escape_is_clipped_and_said(page: Page, tmp_path: Path) -> None:
    solved("Henon-Heiles").export(tmp_path / "a.html")
    opened(page, tmp_path / "a.html", "#x=1&y=0.54&p_x=0&p_y=0.67")
    until(page, "document.querySelector('[data-part=status]').textContent")
    said = page.inner_text("[data-part=status]")
    assert "they end at ten times the size of the start" in said
    assert re.search("ends at t = .*: it (collides or escapes|takes too many steps)", said)


def test_section_fills_itself(page: Page, tmp_path: Path) -> None:
    solved("Henon-Heiles").export(tmp_path / "a.html")
    opened(page, tmp_path / "a.html")
    note = "document.querySelector('[data-part=crossings-note]').textContent"
    until(page, f"parseInt({note}) > 100")
    assert re.match(r"\d+ crossings of y = 0, rising", page.evaluate(note))


def test_print_is_light_and_has_few_pages(written: Path, page: Page) -> None:
    page.emulate_media(color_scheme="dark")
    opened(page, written)
    pages = re.findall(rb"/Type\s*/Page[^s]", page.pdf(format="A4"))
    assert 1 <= len(pages) <= 8


def test_values_of_the_address_are_numbers_or_left_out(page: Page, tmp_path: Path) -> None:
    hamsym.export("p**2/2 + k*x**2/2", tmp_path / "a.html", z0=[1, 0], parameters={"k": (1, 3)})
    opened(page, tmp_path / "a.html", "#k=%3Cimg%3E&x=0.5&p=&time span=Infinity&q=1")
    values: dict[str, Any] = {name: number(page, name) for name in ("x", "p", "k", "time span")}
    assert values == {"x": 0.5, "p": 0, "k": 2, "time span": 20}
