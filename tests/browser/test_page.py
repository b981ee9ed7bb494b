"""The browser itself: it shows formulas, and errors of a page do not go unseen."""

from __future__ import annotations


def test_mathml_is_shown_as_a_formula(page):
    page.set_content("<math><mfrac><mi>p</mi><mn>2</mn></mfrac></math>")
    size = page.locator("mfrac").bounding_box()
    assert size["width"] > 2
    assert size["height"] > 1.5 * page.locator("mi").bounding_box()["height"]


def test_errors_of_scripts_are_seen(page, errors):
    page.set_content("<script>console.error('one'); throw new Error('two')</script>")
    page.wait_for_timeout(50)
    assert sorted(errors) == ["one", "two"]
    errors.clear()
