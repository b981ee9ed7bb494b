"""Tests of the page of hamsym explore in a headless Chromium."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytest.importorskip("nicegui", reason='needs pip install "hamsym[explore]"')
expect = pytest.importorskip("playwright.sync_api", reason="needs pip install playwright").expect

pytestmark = pytest.mark.slow

PATIENCE = 150_000  # milliseconds; sections and proofs wait for compilers


def _serve(*arguments: str) -> tuple[subprocess.Popen[str], str]:
    command = [sys.executable, "-m", "hamsym", "explore", "--no-browser", *arguments]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert server.stdout is not None
    return server, server.stdout.readline().strip()


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    server, address = _serve()
    yield address
    server.send_signal(signal.SIGINT)
    assert server.wait(30) == 0


@pytest.fixture(scope="module", autouse=True)
def patience() -> Iterator[None]:
    """The page answers step by step: what is expected of it is waited for."""
    expect.set_options(timeout=PATIENCE)
    yield
    expect.set_options(timeout=None)


def _open(page: Page, address: str) -> None:
    page.set_default_timeout(PATIENCE)
    page.emulate_media(reduced_motion="reduce")
    page.goto(address)
    page.wait_for_selector(".verdict.accepted")
    page.wait_for_selector("[data-part=accuracy]:not(:empty)")


def _curve(page: Page) -> str:
    """Return the picture of what stays of the phase plane."""
    found: str = page.evaluate("document.querySelector('.views canvas[aria-hidden]').toDataURL()")
    return found


def _wait_for_new_curve(page: Page, old: str) -> None:
    page.wait_for_function(
        "(old) => document.querySelector('.views canvas[aria-hidden]').toDataURL() !== old",
        arg=old,
    )


def test_page_needs_nothing_from_elsewhere(page, address):
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    _open(page, address)
    own = address.split("?")[0]
    assert asked
    assert [url for url in asked if not url.startswith((own, "data:", "blob:"))] == []
    assert "token" not in page.url
    page.wait_for_function("document.querySelectorAll('.mathematics math').length >= 4")
    page.get_by_role("tab", name="Code").click()
    expect(page.locator(".code pre").first).to_contain_text("def vector_field")


def test_typing_changes_equations_sliders_and_picture(page, address):
    _open(page, address)
    old = _curve(page)
    page.get_by_label("Hamiltonian H").fill("p**2/(2*m) - cos(x)")
    page.get_by_label("value of m", exact=True).wait_for()
    _wait_for_new_curve(page, old)
    expect(page.locator(".mathematics").first).to_have_text(re.compile("^(?!.*cos.*cos).*cos"))
    expect(page.locator(".verdict.accepted")).to_have_count(1)


def test_error_marks_the_token_beside_the_field(page, address):
    _open(page, address)
    field = page.get_by_label("Hamiltonian H")
    field.fill("p**2/2 + x^2/2")
    expect(page.locator(".error mark")).to_have_text("^")
    expect(page.locator(".error")).to_contain_text(
        "at column 11 is not a power; write ** for powers"
    )
    expect(page.locator(".stale .player")).to_have_count(1)
    field.fill("<img src=x onerror=alert(1)>")
    expect(page.locator(".error mark")).not_to_have_text("^")
    assert page.locator(".error img").count() == 0
    field.fill("p**2/2 + x**2/2")
    page.wait_for_selector(".verdict.accepted")
    expect(page.locator(".error")).to_be_hidden()


def test_slider_redraws_and_field_takes_a_number(page, address):
    _open(page, address)
    old = _curve(page)
    slider = page.get_by_label("x", exact=True)
    slider.focus()
    for _ in range(5):
        page.keyboard.press("ArrowRight")
    _wait_for_new_curve(page, old)
    field = page.get_by_label("value of x", exact=True)
    expect(field).not_to_have_value("1.3")
    assert float(field.input_value()) > 1.3
    old = _curve(page)
    field.fill("pi/8")
    field.press("Enter")
    _wait_for_new_curve(page, old)
    page.wait_for_selector(".verdict.accepted")


def test_failed_solution_is_said_in_words(page, address):
    _open(page, address)
    page.get_by_label("Hamiltonian H").fill("p**2/2 - 1/x")
    expect(page.locator(".verdict.failed")).to_contain_text("Not accepted: ")


def test_example_has_a_section(page, address):
    _open(page, address)
    choice = page.get_by_label("Example from the catalogue")
    choice.fill("henon_heiles")
    page.get_by_role("option", name="henon_heiles", exact=True).click()
    page.get_by_label("value of p_y", exact=True).wait_for()
    expect(page.locator("[data-part=crossings-note]")).to_contain_text("crossings of y = 0")
    page.wait_for_function(
        "parseInt(document.querySelector('[data-part=crossings-note]').textContent) > 20"
    )
    expect(page.locator(".mathematics mtd")).to_have_count(16)


def test_typed_system_starts_where_it_stays(page, address):
    _open(page, address)
    formula = "(p_x**2 + p_y**2 + x**2 + y**2)/2 + x**2*y - y**3/3"
    page.get_by_label("Hamiltonian H").fill(formula)
    page.get_by_label("value of p_y", exact=True).wait_for()
    page.wait_for_selector(".verdict.accepted")
    expect(page.locator("[data-part=status]")).not_to_contain_text("leaves the pictures")


def test_address_keeps_formula_values_and_tab(page, address):
    _open(page, address)
    page.get_by_label("Hamiltonian H").fill("p_u**2/2 + k*u**4")
    field = page.get_by_label("value of k", exact=True)
    field.fill("2.5")
    field.press("Enter")
    page.get_by_role("tab", name="Code").click()
    expect(page).to_have_url(re.compile("k=2.5.*"))
    expect(page).to_have_url(re.compile(r"\.tab=Code"))
    shared = page.url.partition("#")[2]
    other = page.context.new_page()
    _open(other, f"{address}#{shared}")
    expect(other.get_by_label("Hamiltonian H")).to_have_value("p_u**2/2 + k*u**4")
    expect(other.get_by_label("value of k", exact=True)).to_have_value("2.5")
    expect(other.locator(".code pre").first).to_contain_text("def vector_field")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_no_violation(page, address, scheme):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    page.emulate_media(color_scheme=scheme)
    _open(page, address)
    found = axe.Axe().run(page).response["violations"]
    assert [(one["id"], [node["html"][:150] for node in one["nodes"]]) for one in found] == []


def test_certificate_is_shown(page, address):
    _open(page, address)
    page.get_by_role("tab", name="Prove").click()
    page.get_by_role("button", name="Certify").click()
    expect(page.locator(".result p").first).to_contain_text("Proven: ")
    first = page.locator(".result tbody tr td:first-child")
    expect(first).to_have_text(["|z|", "x", "p", "H", "ell_max"])


def test_long_run_is_cancelled_and_page_stays_live(page, address):
    _open(page, address)
    page.get_by_role("tab", name="Exponents").click()
    page.get_by_label("Time, in time spans").fill("1000000")
    page.get_by_role("button", name="Compute exponents").click()
    cancel = page.get_by_role("button", name="Cancel")
    cancel.wait_for()
    old = _curve(page)
    page.get_by_label("p", exact=True).focus()
    page.keyboard.press("ArrowRight")
    _wait_for_new_curve(page, old)  # while the run goes on
    assert cancel.is_visible()
    cancel.click()
    page.get_by_text("Cancelled.").wait_for()
    expect(cancel).to_be_hidden()
    expect(page.get_by_role("button", name="Compute exponents")).to_be_enabled()


def test_downloads_are_files_of_the_solution(page, address, tmp_path: Path):
    import hamsym

    _open(page, address)
    page.get_by_role("tab", name="Download").click()
    with page.expect_download() as started:
        page.get_by_role("button", name="Solution, for hamsym.load").click()
    path = tmp_path / "orbit.hamsym"
    started.value.save_as(path)
    assert hamsym.load(path).z0.tolist() == [1.3, 1.0]
    with page.expect_download() as started:
        page.get_by_role("button", name="Data (CSV)").click()
    started.value.save_as(tmp_path / "data.csv")
    values = np.genfromtxt(tmp_path / "data.csv", delimiter=",", names=True)
    assert values["x"][0] == 1.3
    page.get_by_role("tab", name="Code").click()
    with page.expect_download() as started:
        page.get_by_role("button", name="Download code").click()
    assert started.value.suggested_filename == "hamiltonian_numpy.py"


def test_report_is_downloaded_and_its_making_is_said(page, address, tmp_path: Path):
    _open(page, address)
    page.get_by_role("tab", name="Download").click()
    button = page.get_by_role("button", name="Report (HTML)")
    with page.expect_download() as started:
        button.click()
        page.get_by_text("Making report.html.").wait_for()
        expect(button).not_to_have_class(re.compile("q-btn--actionable"))
    started.value.save_as(tmp_path / "report.html")
    page.get_by_text("report.html is made.").wait_for()
    page.goto((tmp_path / "report.html").as_uri())
    assert "H = p**2/2 + x**2/2 + x**4/4" in page.inner_text("body")
    assert page.get_by_text("Succeeded").count() == 1


def test_two_tabs_have_states_of_their_own(page, address):
    _open(page, address)
    other = page.context.new_page()
    _open(other, address)
    other.get_by_label("Hamiltonian H").fill("p_a**2/2 + a**2")
    other.get_by_label("value of a", exact=True).wait_for()
    old = _curve(page)
    page.get_by_label("x", exact=True).focus()
    page.keyboard.press("ArrowLeft")
    _wait_for_new_curve(page, old)
    expect(page.get_by_label("Hamiltonian H")).to_have_value("p**2/2 + x**2/2 + x**4/4")
    expect(other.get_by_label("value of a", exact=True)).to_have_value("1")


@pytest.mark.parametrize("width", [390, 1280, 1920])
def test_page_fits_the_window(page, address, width):
    page.set_viewport_size({"width": width, "height": 900})
    _open(page, address)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.screenshot(path="/dev/null", type="png")
    for canvas in page.locator(".views canvas[tabindex]:visible").all():
        box = canvas.bounding_box()
        assert box is not None
        assert box["width"] >= 280


def test_requests_without_the_token_are_refused(address, errors):
    base = address.split("?")[0]
    for url, headers in (
        (base, {}),
        (f"{base}?token=wrong", {}),
        (f"{base}_nicegui_ws/socket.io/?EIO=4&transport=polling", {}),
        (address, {"Host": "evil.example"}),
    ):
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(urllib.request.Request(url, headers=headers))


def test_websocket_without_the_token_is_refused(page, address, errors):
    page.goto("about:blank")
    where = address.split("?")[0].replace("http", "ws", 1)
    outcome = page.evaluate(
        "(url) => new Promise((done) => { const socket = new WebSocket(url);"
        " socket.onopen = () => done('open'); socket.onerror = () => done('refused'); })",
        f"{where}_nicegui_ws/socket.io/?EIO=4&transport=websocket",
    )
    assert outcome == "refused"
    errors.clear()  # the browser reports the refusal


def test_formula_of_the_command_begins_the_page(page, errors):
    server, address = _serve("p_u**2/2 + u**4")
    try:
        page.set_default_timeout(PATIENCE)
        page.goto(address)
        page.wait_for_selector(".verdict.accepted")
        expect(page.get_by_label("Hamiltonian H")).to_have_value("p_u**2/2 + u**4")
    finally:
        server.send_signal(signal.SIGINT)
        _, said = server.communicate(timeout=30)
        page.close()
        # The open page may have tried to reach its server again.
        errors[:] = [line for line in errors if "ERR_CONNECTION_REFUSED" not in line]
    assert server.returncode == 0
    assert re.search("Traceback|Error", said) is None
