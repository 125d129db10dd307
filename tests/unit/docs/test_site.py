"""The website of the documentation: built without warnings, complete, and nothing in it asks another host."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytest.importorskip("mkdocs", reason="in the extra `dev`: builds the site")

from scripts import site

LOADED = re.compile(r"<(?:script|link|img|iframe|source)\b[^>]*?(?:src|href)=[\"']?([^\"' >]+)")


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """The site; building fails for every warning."""
    out = tmp_path_factory.mktemp("site") / "out"
    site.build(out)
    return out


def test_every_page_of_the_documentation_is_in_the_site(built) -> None:
    pages = [page.relative_to(site.ROOT) for page in (site.ROOT / "docs").rglob("*.md")]
    places = [where for page in (*pages, *map(Path, site.PAGES)) if (where := site.page_of(page)) is not None]
    missing = [where for where in places if not (built / site_name(where)).is_file()]
    assert len(places) > 40 and missing == []


def site_name(page: Path) -> Path:
    """The file that a page becomes."""
    return page.with_name("index.html") if page.name == "README.md" else page.with_suffix(".html")


def test_nothing_is_loaded_from_another_host(built) -> None:
    loaded = {target for page in built.rglob("*.html") for target in LOADED.findall(page.read_text())}
    assert len(loaded) > 10
    assert [target for target in loaded if "//" in target] == []
    styles = "".join(sheet.read_text() for sheet in built.rglob("*.css"))
    assert re.findall(r"url\([\"']?https?:", styles) == []


def test_what_is_loaded_is_there(built) -> None:
    for page in (page for page in built.rglob("*.html") if page.name != "404.html"):  # shown by servers alone
        here = [target.partition("?")[0] for target in LOADED.findall(page.read_text())]
        assert [target for target in here if not (page.parent / target).exists()] == [], page


def test_the_search_finds_words_without_a_server(built) -> None:
    index = (built / "search/search_index.js").read_text()
    assert "gravity" in index and "revisit_bridge" in index
    assert "assets/iframe-worker.js" in (built / "index.html").read_text()


def test_links_out_of_the_site_become_words_and_others_stay() -> None:
    text = (
        "See [proto](../../proto/revisit/v1), [frames](frames.md#inside), [bridge](../../ros/revisit_bridge/README.md)."
    )
    expected = "See proto, [frames](frames.md#inside), [bridge](../reference/ros-2-bridge.md)."
    assert site.rewritten(text, Path("docs/explanation/architecture.md")) == expected


def test_code_keeps_its_brackets() -> None:
    text = "```python\nmap[0](nothing.md)\n```"
    assert site.rewritten(text, Path("docs/glossary.md")) == text


def test_diagrams_are_shown_as_their_drawings() -> None:
    page = Path("docs/explanation/architecture.md")
    shown = site.rewritten((site.ROOT / page).read_text(), page)
    assert "```mermaid" not in shown and shown.count("![Diagram](../images/diagrams/") == 2


def test_a_page_without_a_place_is_an_error(tmp_path) -> None:
    (tmp_path / "stray.md").write_text("# Stray\n")
    with pytest.raises(ValueError, match=r"stray\.md"):
        site.navigation(tmp_path)
