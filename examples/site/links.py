"""Check of the built site: every link leads to a page and a place that exist, nothing is fetched.

Run `python examples/site/links.py output/site`; the exit status is 1 if a link is broken.
"""

from __future__ import annotations

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

# Elements that a browser fetches by itself.
_FETCHED = {"script", "img", "link", "iframe", "source", "video", "audio", "object", "embed"}
_NAVIGATION = {"canonical", "next", "prev", "index", "search"}  # of <link>: never fetched


class _Page(HTMLParser):
    """Links and places of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.places: set[str] = set()
        self.outside: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.places |= {value for key in ("id", "name") if (value := given.get(key))}
        address = given.get("href") or given.get("src") or ""
        if urlsplit(address).scheme in ("http", "https") or address.startswith("//"):
            if tag in _FETCHED and given.get("rel") not in _NAVIGATION:
                self.outside.append(address)
        elif address and urlsplit(address).scheme == "":
            self.links.append(address)


def problems(site: Path) -> list[str]:
    """Return what is wrong with the links of a site, one line for each."""
    pages = {
        path.resolve(): _Page(path.read_text(encoding="utf-8")) for path in site.rglob("*.html")
    }
    found = [] if pages else [f"{site}: no pages"]
    for path, page in pages.items():
        name = path.relative_to(site.resolve())
        found += [f"{name}: fetches {address}" for address in page.outside]
        for link in dict.fromkeys(page.links):
            parts = urlsplit(link)
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.exists():
                found.append(f"{name}: {link} does not exist")
            elif target in pages and unquote(parts.fragment) not in pages[target].places | {""}:
                found.append(f"{name}: {link} has no such place")
    return found


if __name__ == "__main__":
    broken = problems(Path(sys.argv[1]))
    print("\n".join(broken) if broken else "every link of the site leads somewhere")
    sys.exit(bool(broken))
