"""Settings of the gallery: which pictures a script has, and the order of the scripts."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst

_RESOLUTION = 150  # dots an inch
# Scripts that are missing here come last, by name.
_ORDER = (
    "code",
    "kepler",
    "three_bodies",
    "chaos",
    "molecule",
    "paul_trap",
    "forces",
    "families",
    "flow_map",
    "fit",
    "proof",
    "periodic_orbits",
    "manifolds",
    "equilibria",
    "own_network",
    "comparison",
)


def scrape(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Save the new figures that a block leaves in names, and return the text that shows them.

    Figures of hamsym do not belong to pyplot, so that the scraper of sphinx-gallery misses them.
    """
    drawn = block_vars["example_globals"].setdefault("_drawn", [])
    paths = []
    for value in list(block_vars["example_globals"].values()):
        if isinstance(value, Figure) and not any(value is other for other in drawn):
            drawn.append(value)
            path = next(block_vars["image_path_iterator"])
            value.savefig(path, dpi=_RESOLUTION)
            paths.append(path)
    return figure_rst(paths, gallery_conf["src_dir"]) if paths else ""


class Order:
    """Sort key of the scripts of a folder."""

    def __init__(self, folder: str) -> None:
        self.folder = folder

    def __call__(self, filename: str) -> tuple[int, str]:
        name = filename.removeprefix("plot_").removesuffix(".py")
        return (_ORDER.index(name) if name in _ORDER else len(_ORDER)), name
