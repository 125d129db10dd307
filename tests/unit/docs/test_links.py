"""Every relative link of the documentation leads to a file, and every anchor to a heading of it."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PAGES = [path for where in ("docs/**/*.md", "ros/**/*.md", "*.md") for path in sorted(ROOT.glob(where))]


def without_code(text: str) -> str:
    return re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)


def anchors(text: str) -> set[str]:
    """The anchors that GitHub gives to the headings of a page: lower case, hyphens for spaces, numbered repeats."""
    met: Counter[str] = Counter()
    found = set()
    for heading in re.findall(r"^#+ +(.+?)\s*$", without_code(text), re.MULTILINE):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
        slug = re.sub(r"[^\w\- ]", "", plain).replace(" ", "-")
        found.add(f"{slug}-{met[slug]}" if met[slug] else slug)
        met[slug] += 1
    return found


def broken(page: Path) -> list[str]:
    """The relative links of `page` that lead nowhere."""
    wrong = []
    for link in re.findall(r"\]\(([^)\s]+)\)", without_code(page.read_text())):
        file, _, anchor = link.partition("#")
        target = page.parent / file if file else page
        if "://" in link or link.startswith("mailto:"):
            continue
        if not target.exists() or (anchor and anchor not in anchors(target.read_text())):
            wrong.append(link)
    return wrong


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_relative_link_and_anchor_resolves(page):
    assert broken(page) == []


NAMED_FILE = re.compile(r"`((?:[\w.-]+/)+[\w.-]+\.(?:py|c|sh|proto|toml|yaml|svg))`")
"""A file of the repository in the text, from its top or, for short, from service or tests."""


@pytest.mark.parametrize("page", [page for page in PAGES if page.name != "CHANGELOG.md"], ids=lambda page: page.name)
def test_every_file_that_a_page_names_exists(page):
    bases = (ROOT, ROOT / "service", ROOT / "tests")
    named = set(NAMED_FILE.findall(page.read_text()))
    assert {name for name in named if not any((base / name).exists() for base in bases)} == set()


def test_a_missing_file_and_a_missing_heading_are_found(tmp_path):
    (tmp_path / "there.md").write_text("# One `two`, three\n\n# Twice\n\n# Twice\n")
    page = tmp_path / "page.md"
    links = ["there.md", "there.md#one-two-three", "there.md#twice-1", "there.md#four", "gone.md", "https://a.test/b"]
    page.write_text("".join(f"[x]({link})\n" for link in links))
    assert broken(page) == ["there.md#four", "gone.md"]
