"""Settings of Sphinx: the site that `make docs` builds from pages and docstrings."""

import sys
from importlib.metadata import version as version_of
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import gallery_settings  # noqa: E402

project = "hamsym"
author = "The hamsym developers"
version = release = version_of("hamsym")

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "myst_parser",
    "sphinx_click",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    # In this folder:
    "accessible",
    "docstrings",
    "mathml",
    "navigation",
    "reference",
]
root_doc = "index"
smartquotes = False
nitpicky = True
nitpick_ignore_regex = [("py:(class|obj|data|exc)", ".*")]  # names of types in docstrings

# -- pages -----------------------------------------------------------------------------------------

myst_enable_extensions = ["amsmath", "dollarmath"]
myst_heading_anchors = 4
suppress_warnings = ["config.cache"]  # settings with functions in them
linkcheck_ignore = ["https?://.*"]  # the build needs no network; the others are checked

# -- reference -------------------------------------------------------------------------------------

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # docstrings give types and shapes
napoleon_google_docstring = False
napoleon_use_rtype = False
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True
copybutton_only_copy_prompt_lines = True

# -- gallery ---------------------------------------------------------------------------------------

sphinx_gallery_conf = {
    "examples_dirs": "../gallery",
    "gallery_dirs": "generated/gallery",
    "filename_pattern": r"plot_",
    "image_scrapers": (gallery_settings.scrape,),
    "reset_modules": (),
    "capture_repr": ("_repr_html_",),
    "min_reported_time": 1,
    "show_memory": False,
    "show_signature": False,
    "download_all_examples": False,
    "within_subsection_order": gallery_settings.Order,
    "write_computation_times": False,
    "abort_on_example_error": True,
    "remove_config_comments": True,
}

# -- HTML ------------------------------------------------------------------------------------------

html_theme = "furo"
html_title = f"hamsym {version}"
html_math_renderer = "mathml"
html_copy_source = False
html_show_copyright = False
html_show_search_summary = False  # browsers fetch no pages from file://
html_show_sphinx = False
html_static_path = ["static"]
html_css_files = ["site.css"]
html_theme_options = {"navigation_with_keys": True}
